"""The force gauge's pad as a radiograph shows it: a disc on the skin over the pushed ribs, and the rod behind it."""

from __future__ import annotations

import numpy as np

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.template.surfaces import Surface, loft, outward, tube
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.imaging.synthetic.materials import Material
from spinestiff.imaging.synthetic.rendering import Absorber
from spinestiff.imaging.synthetic.torso_absorbers import skin_surface

PAD_RADIUS = 32.0  # mm
_CUSHION, _PLATE = 14.0, 3.0  # mm of rubber, of aluminium
_RUBBER = 0.9  # of soft tissue


def gauge_pad(torso: TorsoModel, state: TorsoState, points: PointsOnBones, forces: Floats) -> list[Absorber]:
    """Cushion, plate and rod, pressed on the skin beside ``points``.

    Parameters
    ----------
    points : the push's points on the ribs.
    forces : (n, 3) on them; the pad moves with the point where their resultant acts. Any unit.
    """
    push = forces.sum(axis=0)
    inward = push / np.linalg.norm(push)
    along = forces @ inward
    place = along @ points.positions(state) / along.sum()
    skin, _ = skin_surface(torso, state)
    aside = skin - place
    aside = aside - np.outer(aside @ inward, inward)
    near = skin[(np.linalg.norm(aside, axis=1) < PAD_RADIUS) & ((skin - place) @ inward < 0.0)]
    # Pressed in a little: the cushion's face lies on the mean of the skin under it.
    outside = float(np.mean(-(near - place) @ inward)) if len(near) else 15.0
    face = place - max(outside, 8.0) * inward
    upright = np.array([0.0, 1.0, 0.0])
    cushion = _disc(face, face - _CUSHION * inward, PAD_RADIUS, upright)
    back = face - _CUSHION * inward
    plate = _disc(back, back - _PLATE * inward, PAD_RADIUS, upright)
    rod_start = back - _PLATE * inward
    rod = tube(rod_start - np.outer([0.0, 40.0, 150.0], inward), np.array([7.0, 7.0]), upright, 16)
    aluminium = Material.ALUMINIUM
    return [
        Absorber(cushion[0], cushion[1], density=_RUBBER),
        Absorber(plate[0], plate[1], aluminium),
        Absorber(rod[0], rod[1], aluminium),
    ]


def _disc(start: Floats, end: Floats, radius: float, upright: Floats) -> Surface:
    axis = (end - start) / np.linalg.norm(end - start)
    first = upright - (upright @ axis) * axis
    first = first / np.linalg.norm(first)
    second = np.cross(axis, first)
    angle = 2.0 * np.pi * np.arange(48) / 48
    ring = radius * (np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second)
    return outward(loft(np.stack([start + 0.97 * ring, start + 0.2 * (end - start) + ring,
                                  end - 0.2 * (end - start) + ring, end + 0.97 * ring])))  # fmt: skip
