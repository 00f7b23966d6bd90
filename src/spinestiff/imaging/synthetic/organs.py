"""Soft organs that a radiograph of the trunk shows: lungs with vessels, heart, diaphragm, trachea, psoas muscles.

They are built around the bones of a state, with sizes of our own design: they need to look and to cover bones as real
ones do, not to be anyone's. The heart and the domes of the diaphragm are where the lungs are not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.names import SIDES, VERTEBRAE
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.template.surfaces import Surface, joined, loft, outward, tube
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.imaging.synthetic.rendering import Absorber
from spinestiff.imaging.synthetic.texture import Texture

_LUNG = -0.74  # soft tissue that an inflated lung lacks
_AROUND, _ALONG, _CAP = 48, 44, 6
_RIBS_AROUND = tuple(f"R{i}" for i in range(1, 11))
_LEVELS = range(1, 13)  # thoracic vertebrae beside which there is lung
_VESSELS = 46  # of a lung


@dataclass(frozen=True)
class Chest:
    """The inside of the rib cage at the heights of some thoracic vertebrae.

    Attributes
    ----------
    middle : (k, 3) mm, vertebra centres, from above.
    reach : dict of side to (k,) mm, from the middle to the inside of that side's ribs.
    back, front : (k,) mm, z of the inside.
    half_width : (k,) mm, of the vertebral bodies.
    """

    middle: Floats
    reach: dict[str, Floats]
    back: Floats
    front: Floats
    half_width: Floats


def chest(torso: TorsoModel, state: TorsoState) -> Chest | None:
    """The chest of a torso that has ribs on both sides, else None."""
    points = {}
    for side in SIDES:
        names = [f"{rib}_{side}" for rib in _RIBS_AROUND if f"{rib}_{side}" in torso.bone_names]
        if not names:
            return None
        points[side] = np.vstack([torso.surface_positions(state, torso.bone(name)) for name in names])
    rows, every = [], np.vstack(list(points.values()))
    for level in _LEVELS:
        centre = state.bone_positions[torso.bone(f"T{level}")]
        near = {side: p[np.abs(p[:, 1] - centre[1]) < 14.0] for side, p in points.items()}
        if not all(len(p) for p in near.values()):
            continue
        both = every[np.abs(every[:, 1] - centre[1]) < 14.0]
        width = 0.5 * float(np.ptp(torso.vertebra_boxes[level - 1][:, 0]))
        left, right = (float(np.max(sign * (near[s][:, 0] - centre[0]))) - 7.0 for s, sign in (("L", 1), ("R", -1)))
        rows.append((*centre, left, right, both[:, 2].min() + 9.0, both[:, 2].max() - 12.0, width))
    if len(rows) < 4:
        return None
    x, y, z, left, right, back, front, width = np.array(rows).T
    return Chest(np.stack([x, y, z], -1), {"L": left, "R": right}, back, front, width)


def lungs(torso: TorsoModel, state: TorsoState, seed: int, breath: float) -> list[Absorber]:
    """Two lungs and their vessels; ``breath`` mm is how much lower than at rest the diaphragm stands."""
    cage = chest(torso, state)
    if cage is None:
        return []
    bodies = []
    for number, side in enumerate(SIDES):
        rings = _lung_rings(cage, side)
        shaped = _beside_heart(_over_diaphragm(rings, cage, side, breath), cage, side)
        air = Texture(0.22, 9.0, seed + 2000 + number)
        bodies.append(Absorber(*outward(loft(shaped)), density=_LUNG, texture=air, smoothing=1.0))
        random = np.random.default_rng([seed, number])
        bodies.append(Absorber(*_vessels(shaped, random), density=-_LUNG))
    return bodies


def trachea(torso: TorsoModel, state: TorsoState) -> list[Absorber]:
    """The air of trachea and main bronchi, before T1 to T5."""
    if chest(torso, state) is None:
        return []
    t = [state.bone_positions[torso.bone(f"T{i}")] for i in (1, 3, 5, 6)]
    ahead = np.array([2.0, 0.0, 30.0])
    windpipe = tube(
        np.array([t[0] + [0, 60, 24], t[0] + ahead, t[1] + ahead, t[2] + ahead]),
        np.array([6.0, 7.0]), np.array([0.0, 0.0, 1.0]), 12,
    )  # fmt: skip
    right = tube(np.array([t[2] + ahead, t[3] + ahead + [-22.0, 4.0, -4.0]]), np.array([5.0, 5.0]), np.eye(3)[2], 10)
    left = tube(np.array([t[2] + ahead, t[3] + ahead + [30.0, 2.0, -6.0]]), np.array([4.5, 4.5]), np.eye(3)[2], 10)
    return [Absorber(*joined(windpipe, right, left), density=-0.9, smoothing=0.8)]


def muscles(torso: TorsoModel, state: TorsoState) -> list[Absorber]:
    """The psoas muscles beside the lumbar spine, denser than the fat they lie in."""
    if "pelvis" not in torso.bone_names:
        return []
    spine = state.bone_positions[[torso.bone(f"L{i}") for i in (1, 2, 3, 4, 5)]]
    width = 0.5 * np.ptp(torso.vertebra_boxes[[VERTEBRAE.index(f"L{i}") for i in (1, 2, 3, 4, 5)], :, 0], axis=1)
    bodies = []
    for sign in (1.0, -1.0):
        beside = np.stack([sign * (width + [-3.0, 4.0, 11.0, 19.0, 29.0]), np.zeros(5), np.full(5, -8.0)], -1)
        curve = np.vstack([spine + beside, spine[-1] + beside[-1] + [sign * 12.0, -50.0, 18.0]])
        radii = np.array([[5.0, 8.0], [9.0, 12.0], [13.0, 15.0], [16.0, 17.0], [18.0, 18.0], [18.0, 18.0]])
        bodies.append(Absorber(*tube(curve, radii, np.eye(3)[2], 20), density=0.06, smoothing=1.5))
    return bodies


def diaphragm_top(cage: Chest, side: str, breath: float) -> Floats:
    """(3,) mm, the top of a dome of the diaphragm; the right one, over the liver, is higher."""
    y = cage.middle[:, 1]
    sign = 1.0 if side == "L" else -1.0
    low = y[-1] + (0.29 if side == "R" else 0.23) * (y[0] - y[-1]) - breath
    at = float(np.interp(-low, -y, np.arange(len(y))))
    k = min(round(at), len(y) - 1)
    x = cage.middle[k, 0] + sign * 0.52 * cage.reach[side][k]
    return np.array([x, low, 0.45 * cage.back[k] + 0.55 * cage.front[k]])


def _lung_rings(cage: Chest, side: str) -> Floats:
    """(rings, 48, 3) mm from above: ovals between the mediastinum and the ribs of one side, closed to both ends."""
    sign = 1.0 if side == "L" else -1.0
    k = np.arange(len(cage.middle))
    at = np.linspace(0.0, k[-1], _ALONG)
    x, y = (np.interp(at, k, cage.middle[:, i]) for i in (0, 1))
    # The spine's own kinks must not show on the lung's border.
    smooth = np.ones(9) / 9.0
    inner, outer, back, front = (
        np.convolve(np.pad(np.interp(at, k, v), 4, mode="edge"), smooth, mode="valid")
        for v in (cage.half_width + 5.0, cage.reach[side], cage.back, cage.front)
    )
    inner = np.minimum(inner, 0.5 * outer)
    angle = 2.0 * np.pi * np.arange(_AROUND) / _AROUND
    # A superellipse: lungs fill the chest's corners better than an ellipse does.
    across, along = (np.sign(f) * np.abs(f) ** 0.7 for f in (np.cos(angle), np.sin(angle)))
    half, middle = 0.5 * (outer - inner), 0.5 * (outer + inner)
    deep, centre = 0.5 * (front - back), 0.5 * (front + back)
    u = middle[:, None] + half[:, None] * across
    z = centre[:, None] + deep[:, None] * along
    rings = np.stack([x[:, None] + sign * u, np.broadcast_to(y[:, None], u.shape), z], -1)
    # A domed apex over the first ring; the last is closed by a plate that the diaphragm lifts.
    first, last = rings[0].mean(axis=0), rings[-1].mean(axis=0)
    share = np.linspace(0.0, 1.0, _CAP + 1)[1:, None, None]
    apex = [first + s * (rings[0] - first) + [0.0, 24.0 * np.sqrt(1.0 - s * s), 0.0] for s in share[:-1, 0, 0]]
    base = [last + s * (rings[-1] - last) for s in share[-2::-1, 0, 0]]
    return np.vstack([apex, rings, base])


def _over_diaphragm(rings: Floats, cage: Chest, side: str, breath: float) -> Floats:
    """The rings lifted to the dome where they lie below it."""
    top = diaphragm_top(cage, side, breath)
    u = (rings[..., 0] - top[0]) / 52.0
    v = (rings[..., 2] - top[2]) / np.where(rings[..., 2] < top[2], 62.0, 85.0)
    dome = top[1] - 34.0 * (u * u + v * v)
    return np.stack([rings[..., 0], np.maximum(rings[..., 1], dome), rings[..., 2]], -1)


def _beside_heart(rings: Floats, cage: Chest, side: str) -> Floats:
    """The rings pushed aside where the heart and the great vessels are."""
    sign = 1.0 if side == "L" else -1.0
    y, k = cage.middle[:, 1], np.arange(len(cage.middle))
    middle = float(np.mean(cage.middle[:, 0]))
    back, front = float(np.median(cage.back)), float(np.median(cage.front))
    size = float(np.median(cage.reach[side])) / 105.0

    def height(level: float) -> float:
        return float(np.interp(level, k + 1.0, y))

    u = sign * (rings[..., 0] - middle)
    # Heart, aortic arch and descending aorta on the left; right atrium and upper caval vein on the right.
    if side == "L":
        parts = [
            (14, height(8.6), 0.68, 54, 58, 48),
            (8, height(4.2), 0.42, 24, 13, 22),
            (6, height(5.6), 0.5, 25, 14, 18),
        ]
    else:
        parts = [(8, height(8.8), 0.64, 27, 46, 38), (4, height(4.0), 0.5, 21, 38, 20)]
    for x0, y0, share, a, b, c in parts:
        z0 = back + share * (front - back)
        room = 1.0 - ((rings[..., 1] - y0) / (b * size)) ** 2 - ((rings[..., 2] - z0) / (c * size)) ** 2
        border = size * (x0 + a * np.sqrt(np.maximum(room, 0.0)))
        u = np.where(room > 0.0, np.maximum(u, border), u)
    return np.stack([middle + sign * u, rings[..., 1], rings[..., 2]], -1)


def _vessels(rings: Floats, random: np.random.Generator) -> Surface:
    """Branching tubes from the hilum outward, placed in terms of the lung so that they deform with it."""
    count = len(rings)
    hilum = 0.5 * (rings[count * 2 // 5].mean(axis=0) + rings[count * 2 // 5, _AROUND // 2])
    share = np.linspace(0.0, 1.0, 7)[:, None]
    ring, around = random.integers(4, count - 8, _VESSELS), random.integers(0, _AROUND, _VESSELS)
    centre = rings[ring].mean(axis=1)
    end = centre + random.uniform(0.55, 0.93, (_VESSELS, 1)) * (rings[ring, around] - centre)
    start = hilum + random.normal(0.0, 5.0, (_VESSELS, 3))
    bend = random.normal(0.0, 7.0, (_VESSELS, 1, 3))
    trunks = start[:, None] + share * (end - start)[:, None] + np.sin(np.pi * share) * bend
    radius = random.uniform(1.2, 3.2, (_VESSELS, 1, 1))
    # Three twigs a trunk, from somewhere in its middle.
    origin = np.repeat(np.arange(_VESSELS), 3)
    fork = trunks[origin, random.integers(2, 5, len(origin))]
    twig_end = 0.6 * (end[origin] - fork) + random.normal(0.0, 16.0, (len(origin), 3))
    twigs = fork[:, None] + share * twig_end[:, None]
    widths = np.concatenate([radius * (1.0 - 0.75 * share), 0.55 * radius[origin] * (1.0 - 0.7 * share)])
    return _thin_tubes(np.concatenate([trunks, twigs]), widths)


def _thin_tubes(curves: Floats, radii: Floats) -> Surface:
    """Tubes of six sides along curves (n, k, 3) with radii (n, k, 1) mm, as one surface."""
    along = np.gradient(curves, axis=1)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    away = np.eye(3)[np.argmin(np.abs(curves[:, -1] - curves[:, 0]), axis=-1)][:, None]
    first = np.cross(away, along)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    second = np.cross(along, first)
    angle = 2.0 * np.pi * np.arange(6)[:, None] / 6.0
    round_it = np.cos(angle) * first[:, :, None] + np.sin(angle) * second[:, :, None]
    rings = curves[:, :, None] + radii[:, :, None] * round_it
    n, k = rings.shape[:2]
    _, faces = loft(rings[0])
    vertices = np.concatenate([rings.reshape(n, -1, 3), rings[:, 0].mean(axis=1)[:, None],
                               rings[:, -1].mean(axis=1)[:, None]], axis=1)  # fmt: skip
    return vertices.reshape(-1, 3), (faces + (6 * k + 2) * np.arange(n)[:, None, None]).reshape(-1, 3)
