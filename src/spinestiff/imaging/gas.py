"""Gas in stomach and bowel: bubbles in front of the spine that move from one radiograph to the next."""

from __future__ import annotations

import numpy as np

from spinestiff.anatomy.template.surfaces import Surface, joined, loft
from spinestiff.anatomy.torso import TorsoModel, TorsoState
from spinestiff.arrays import Floats
from spinestiff.imaging.organs import chest, diaphragm_top
from spinestiff.imaging.rendering import Absorber
from spinestiff.imaging.torso_absorbers import skin_surface

_AIR = -0.97  # soft tissue that a bubble lacks; its wall's folds are left out
_ROWS, _AROUND = 12, 20


def bowel_gas(
    torso: TorsoModel, state: TorsoState, seed: int, amount: float, motion: float, frame: np.random.Generator
) -> list[Absorber]:
    """Bubbles of gas.

    Parameters
    ----------
    state : the bubbles lie between its ribs and its pelvis.
    seed : of the person, decides where gas is.
    amount : relative to a common picture (about 24 bubbles and the stomach's); 0 for none.
    motion : mm, standard deviation of a bubble's way, and of its change of size, from frame to frame.
    frame : random numbers of this frame.
    """
    if amount <= 0.0:
        return []
    random = np.random.default_rng([seed, 77])
    top, low = (state.bone_positions[torso.bone(name)] for name in ("T12", "L5"))
    tall = float(top[1] - low[1])
    skin, _ = skin_surface(torso, state)
    waist = skin[np.abs(skin[:, 1] - 0.5 * (top[1] + low[1])) < 0.3 * tall]
    half = float(np.quantile(np.abs(waist[:, 0] - top[0]), 0.75))
    deep = float(waist[:, 2].max() - low[2])
    pieces = []
    # Colon: flanks, and the transverse part before the upper lumbar spine. Small bowel: anywhere between.
    for _ in range(round(24 * amount)):
        place = random.uniform()
        side = random.choice([-1.0, 1.0])
        if place < 0.6:
            centre, size = [side * random.uniform(0.52, 0.74), random.uniform(0.0, 0.75), 0.4], random.uniform(8, 19)
        elif place < 0.8:
            centre, size = [random.uniform(-0.6, 0.6), random.uniform(0.55, 0.75), 0.65], random.uniform(6, 15)
        else:
            centre, size = [random.uniform(-0.5, 0.5), random.uniform(-0.1, 0.5), 0.55], random.uniform(4, 11)
        across, up, ahead = centre
        middle = np.array([0.5 * (top[0] + low[0]) + across * half, low[1] + up * tall, low[2] + ahead * deep])
        axes = size * random.uniform(0.7, 1.4, 3) * [1.0, 1.0, 0.7]
        lumps = random.normal(0.0, 0.12, (3, 3))
        middle = middle + motion * frame.standard_normal(3)
        pieces.append(_bubble(middle, axes + 0.15 * motion * frame.standard_normal(3), lumps))
    cage = chest(torso, state)
    if cage is not None:
        dome = diaphragm_top(cage, "L", 0.0)
        lumps = random.normal(0.0, 0.08, (3, 3))
        middle = dome + [2.0, -27.0, -5.0] + 0.5 * motion * frame.standard_normal(3)
        pieces.append(_bubble(middle, np.array([34.0, 17.0, 22.0]), lumps))
    return [Absorber(*joined(*pieces), density=_AIR, smoothing=0.8)]


def _bubble(centre: Floats, half: Floats, lumps: Floats) -> Surface:
    """A lumpy ellipsoid (closed, outward)."""
    latitude = np.linspace(0.5 * np.pi, -0.5 * np.pi, _ROWS + 2)[1:-1, None]
    angle = 2.0 * np.pi * np.arange(_AROUND) / _AROUND
    unit = np.stack(
        [np.cos(latitude) * np.cos(angle), np.broadcast_to(np.sin(latitude), (_ROWS, _AROUND)),
         np.cos(latitude) * np.sin(angle)], -1,
    )  # fmt: skip
    waves = sum(np.sin(3.0 * unit @ lumps[i] * 9.0 + i) for i in range(3))
    vertices, faces = loft(unit * (1.0 + 0.09 * waves)[..., None])
    return centre + vertices * np.maximum(half, 2.0), faces
