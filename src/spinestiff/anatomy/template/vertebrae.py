"""The spine: frames of 17 vertebrae on a sagittal curve, their boxes and surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.template import sizes
from spinestiff.anatomy.template.surfaces import Surface, joined, loft, mirrored, superellipse, tube
from spinestiff.arrays import Floats


@dataclass(frozen=True)
class Spine:
    """Frames in the world, whose origin is the middle of the sacral endplate.

    Attributes
    ----------
    centres : (17, 3) mm, body centres, T1 first.
    rotations : (17, 3, 3) world_from_vertebra.
    discs : (17, 3) mm, centre of the disc below each vertebra.
    disc_rotations : (17, 3, 3) mean of the two endplates' frames.
    """

    centres: Floats
    rotations: Floats
    discs: Floats
    disc_rotations: Floats


def tilts() -> Floats:
    """(18,) rad, forward tilt of T1 ... L5 and of the sacral endplate."""
    thoracic = sizes.THORACIC_SHARES * sizes.KYPHOSIS_DEG / sizes.THORACIC_SHARES.sum()
    lumbar = -sizes.LUMBAR_SHARES * sizes.LORDOSIS_DEG / sizes.LUMBAR_SHARES.sum()
    # Kyphosis tilts the upper vertebra of a disc forward, lordosis backward.
    discs = np.concatenate([thoracic, [sizes.THORACOLUMBAR_DEG], lumbar])
    upwards = np.cumsum(discs[::-1])[::-1]
    return np.deg2rad(sizes.SACRAL_SLOPE_DEG + np.append(upwards, 0.0))


def _tilted(angle: Floats) -> Floats:
    return exp_so3(np.multiply.outer(angle, [1.0, 0.0, 0.0]))


def build_spine() -> Spine:
    """The reference spine, stacked from the sacral endplate upwards."""
    angle = tilts()
    rotations, disc_rotations = _tilted(angle[:-1]), _tilted(0.5 * (angle[:-1] + angle[1:]))
    centres, discs = np.zeros((17, 3)), np.zeros((17, 3))
    endplate = np.zeros(3)
    for i in reversed(range(17)):
        height, disc = sizes.VERTEBRA_SIZES[i, 4:]
        up = disc_rotations[i, :, 1]
        discs[i] = endplate + 0.5 * disc * up
        lower = endplate + disc * up
        centres[i] = lower + 0.5 * height * rotations[i, :, 1]
        endplate = lower + height * rotations[i, :, 1]
    return Spine(centres, rotations, discs, disc_rotations)


def vertebra_boxes() -> Floats:
    """(17, 8, 3) mm in the vertebra's frame; order as ``TorsoModel.vertebra_boxes``."""
    wu, du, wl, dl, height, _ = sizes.VERTEBRA_SIZES.T
    half = 0.5 * np.stack([0.5 * (wu + wl), height, 0.5 * (du + dl)], -1)
    signs = np.array([(x, y, z) for y in (1, -1) for x in (1, -1) for z in (1, -1)], dtype=float)
    return half[:, None] * signs


def costovertebral(level: int) -> Floats:
    """(3,) mm in the vertebra's frame, left rib head's middle: at the disc above, or on the body (T1, T11, T12)."""
    width, depth, _, _, height, _ = sizes.VERTEBRA_SIZES[level]
    up = {0: 0.25, 10: 0.25, 11: 0.15}.get(level, 0.56) * height
    return np.array([0.5 * width + 2.5, up, -0.32 * depth])


def costotransverse(level: int) -> Floats:
    """(3,) mm in the vertebra's frame, left rib tubercle's middle: before the tip of the transverse process."""
    head = costovertebral(level)
    if level >= 10:  # floating ribs have no such joint; a point on the neck stands for it
        return head + np.array([9.0, -3.5, -9.0])
    tip = transverse_tip(level)
    return tip + np.array([3.0 if level == 1 else 0.5, -1.0, 9.0])


def transverse_tip(level: int) -> Floats:
    """(3,) mm in the vertebra's frame, tip of the left transverse process."""
    depth, height = sizes.VERTEBRA_SIZES[level, 3], sizes.VERTEBRA_SIZES[level, 4]
    thoracic = level < 12
    back = -0.5 * depth - (0.8 if thoracic else 0.35) * sizes.CANAL_DEPTH - (4.0 if thoracic else 0.0)
    return np.array([sizes.TRANSVERSE_HALF[level], (0.22 if thoracic else 0.1) * height, back])


def _body(level: int) -> Surface:
    wu, du, wl, dl, height, _ = sizes.VERTEBRA_SIZES[level]
    rings = []
    # Endplate rims bulge, the waist is drawn in by about a tenth.
    for y, girth in ((-0.5, 0.93), (-0.42, 1.0), (-0.22, 0.92), (0.0, 0.88), (0.22, 0.92), (0.42, 1.0), (0.5, 0.93)):
        share = y + 0.5
        a, b = 0.5 * girth * (wl + share * (wu - wl)), 0.5 * girth * (dl + share * (du - dl))
        x, z = superellipse(a, b, b, 2.3, 16).T
        hollow = 0.22 * b * np.exp(-((x / (0.45 * a)) ** 2)) * (z < 0.0)  # the canal's front wall
        rings.append(np.stack([x, np.full(16, y * height), z + hollow], -1))
    return loft(np.array(rings))


def _left_arch(level: int) -> Surface:
    width, _, _, depth, height, _ = sizes.VERTEBRA_SIZES[level]
    thoracic = level < 12
    canal = sizes.CANAL_DEPTH
    wall, rear = -0.5 * depth, -0.5 * depth - canal
    # Canal width: 15 to 18 mm thoracic, to 24 mm at L5 (Panjabi).
    side = (0.36 if thoracic else 0.3) * width + 2.0
    top = 0.18 * height
    pillar = np.array([side + 1.5, top, wall - 0.62 * canal])
    pedicle = tube(
        np.array([[0.9 * side, top + 1.0, wall + 4.0], [side, top, wall - 3.0], pillar]),
        np.array([2.8, 0.26 * height]),
        np.array([0.0, 1.0, 0.0]),
        6,
    )
    lamina = tube(
        np.array(
            [pillar + [0.5, 0.0, 0.0], [0.55 * side, -0.1 * height, rear - 0.5], [-1.0, -0.25 * height, rear - 2.5]]
        ),
        np.array([2.4, 0.36 * height]),
        np.array([0.0, 1.0, 0.2]),
        6,
    )
    reach = 0.62 if thoracic else 0.66
    facets = tube(
        pillar + np.array([[0.0, reach * height, 2.5], [0.0, 0.0, 0.0], [-1.5, -reach * height, -3.5]]),
        np.array([[2.1, 3.0], [3.2, 4.0], [2.1, 3.0]]),
        np.array([1.0, 0.0, 0.0]),
        6,
    )
    tip = transverse_tip(level)
    process = tube(
        np.array([pillar + [-1.0, 0.0, 0.5], 0.5 * (pillar + tip), tip - [1.0, 0.0, 0.0], tip + [0.5, 0.0, -1.0]]),
        np.array([[3.0, 4.5], [2.4, 3.8], [2.8, 4.4], [1.4, 2.4]]) * (1.0 if thoracic else 0.9),
        np.array([0.0, 1.0, 0.0]),
        6,
    )
    return joined(pedicle, lamina, facets, process)


def _spinous(level: int) -> Surface:
    _, _, _, depth, height, _ = sizes.VERTEBRA_SIZES[level]
    drop = np.deg2rad(sizes.SPINOUS_DROP_DEG[level])
    base = np.array([0.0, -0.1 * height, -0.5 * depth - sizes.CANAL_DEPTH])
    direction = np.array([0.0, -np.sin(drop), -np.cos(drop)])
    curve = base + np.outer([0.0, 0.45, 0.92, 1.0], sizes.SPINOUS_LENGTH[level] * direction)
    tall = (0.32 if level < 11 else 0.45) * height
    radii = np.array([[3.2, 1.1 * tall], [2.2, tall], [3.0, 0.85 * tall], [1.6, 0.5 * tall]])
    return tube(curve, radii, np.array([0.0, np.cos(drop), -np.sin(drop)]), 6)


def vertebra_surface(level: int) -> Surface:
    """Body, arch and processes of vertebra ``level`` (0 = T1), in the vertebra's frame."""
    left = _left_arch(level)
    return joined(_body(level), left, mirrored(left), _spinous(level))
