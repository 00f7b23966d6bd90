"""The bowel in front of the spine: mottled contents, and gas in bubbles that move from one radiograph to the next."""

from __future__ import annotations

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.template.surfaces import Surface, joined, loft
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.imaging.synthetic.organs import chest, diaphragm_top
from spinestiff.imaging.synthetic.rendering import Absorber
from spinestiff.imaging.synthetic.texture import Texture
from spinestiff.imaging.synthetic.torso_absorbers import skin_surface

_AIR = -0.97  # soft tissue that a bubble lacks; its wall's folds are left out
_BUBBLES = 15
_ROWS, _AROUND = 12, 20
# Contents as what they differ from the tissue around: a faint ellipsoid whose texture is stronger than itself.
_CONTENTS, _MOTTLING, _GRAIN = 0.02, 2.5, 11.0


def bowel(
    torso: TorsoModel, state: TorsoState, seed: int, gas: float, motion: float, frame: np.random.Generator
) -> list[Absorber]:
    """Contents and gas of stomach and bowel.

    Parameters
    ----------
    state : they lie between its ribs and its pelvis.
    seed : of the person, decides where gas is.
    gas : amount relative to a common picture (15 bubbles and the stomach's); 0 for none.
    motion : mm, standard deviation of the way of contents and bubbles from frame to frame.
    frame : random numbers of this frame.
    """
    random = np.random.default_rng([seed, 77])
    top, low = (state.bone_positions[torso.bone(name)] for name in ("T12", "L5"))
    tall = float(top[1] - low[1])
    skin, _ = skin_surface(torso, state)
    waist = skin[np.abs(skin[:, 1] - 0.5 * (top[1] + low[1])) < 0.3 * tall]
    half = float(np.quantile(np.abs(waist[:, 0] - top[0]), 0.75))
    deep = float(waist[:, 2].max() - low[2])
    origin = np.array([0.5 * (top[0] + low[0]), low[1], low[2]])
    scale = np.array([half, tall, deep])
    belly = origin + scale * [0.0, 0.35, 0.45] + motion * frame.standard_normal(3)
    contents = _bubble(belly, scale * [0.8, 0.85, 0.42], np.zeros((3, 3)))
    mottling = Texture(_MOTTLING, _GRAIN, seed + 3000, belly)
    bodies = [Absorber(*contents, density=_CONTENTS, texture=mottling, smoothing=1.0)]
    if gas <= 0.0:
        return bodies
    pieces = []
    # Colon: flanks, and the transverse part before the upper lumbar spine. Small bowel: anywhere between.
    for _ in range(round(_BUBBLES * gas)):
        place, side = random.uniform(), random.choice([-1.0, 1.0])
        if place < 0.6:
            at, size = [side * random.uniform(0.52, 0.74), random.uniform(0.0, 0.75), 0.4], random.uniform(7.0, 17.0)
        elif place < 0.8:
            at, size = [random.uniform(-0.6, 0.6), random.uniform(0.55, 0.75), 0.65], random.uniform(6.0, 14.0)
        else:
            at, size = [random.uniform(-0.5, 0.5), random.uniform(-0.1, 0.5), 0.55], random.uniform(4.0, 10.0)
        axes = size * random.uniform(0.7, 1.4, 3) * [1.0, 1.0, 0.7]
        lumps = random.normal(0.0, 0.12, (3, 3))
        middle = origin + scale * at + motion * frame.standard_normal(3)
        pieces.append(_bubble(middle, axes + 0.15 * motion * frame.standard_normal(3), lumps))
    cage = chest(torso, state)
    if cage is not None:
        dome = diaphragm_top(cage, "L", 0.0)
        lumps = random.normal(0.0, 0.08, (3, 3))
        middle = dome + [2.0, -27.0, -5.0] + 0.5 * motion * frame.standard_normal(3)
        pieces.append(_bubble(middle, np.array([34.0, 17.0, 22.0]), lumps))
    return [*bodies, Absorber(*joined(*pieces), density=_AIR, smoothing=0.8)] if pieces else bodies


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
