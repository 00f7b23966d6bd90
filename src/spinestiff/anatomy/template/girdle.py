"""Sternum and shoulder girdle: sternum, left clavicle, scapula and humeral head."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.template import sizes
from spinestiff.anatomy.template.proportions import REFERENCE, Proportions
from spinestiff.anatomy.template.ribs import jugular_notch, sternum_slope
from spinestiff.anatomy.template.surfaces import Surface, ball, joined, loft, slab, smooth_curve, superellipse, tube
from spinestiff.anatomy.template.vertebrae import Spine
from spinestiff.arrays import Floats

# From the sternoclavicular to the acromioclavicular joint, direction (left, up, forward): the generic adult's vector
# (126, 19, -13) mm yawed back by a further 16 degrees and lowered by 3 (design), which brings the scapula behind ribs 2
# to 7.
_CLAVICLE_DIRECTION = np.array([0.925, 0.10, -0.366])
_CLAVICLE_CHORD = 0.95 * sizes.CLAVICLE_LENGTH  # the S bends take about 5 % of the length


@dataclass(frozen=True)
class LeftGirdle:
    """Joint centres of the left shoulder, world mm."""

    sternoclavicular: Floats
    acromioclavicular: Floats
    glenohumeral: Floats


def left_girdle(spine: Spine, size: Proportions = REFERENCE) -> LeftGirdle:
    """Where the left shoulder's joints lie."""
    notch = jugular_notch(spine, size)
    sternal = notch + np.array([size.thorax[0] * sizes.STERNOCLAVICULAR_HALF, size.spine, 0.0])
    direction = _CLAVICLE_DIRECTION / np.linalg.norm(_CLAVICLE_DIRECTION)
    acromial = sternal + size.shoulder * _CLAVICLE_CHORD * direction
    # Acromioclavicular joint to humeral head: (8, -30, -8) mm in the generic adult; here 0.87 of it, 5 mm further
    # forward (design).
    return LeftGirdle(sternal, acromial, acromial + size.shoulder * np.array([7.0, -26.0, -2.0]))


def sternum_surface(spine: Spine, size: Proportions = REFERENCE) -> Surface:
    """Manubrium, body and xiphoid process, world mm."""
    top = jugular_notch(spine, size)
    scale = np.array([size.thorax[0], size.spine, size.thorax[1]])
    slope = sternum_slope(spine, size)
    # down, half width, half thickness
    rows = [(-2, 17, 3.5), (3, 22, 5), (12, 21, 5), (26, 14, 4.5), (38, 12, 4.5), (46, 12.5, 4.5), (75, 14, 4.5),
            (105, 16, 4.5), (128, 13, 4), (138, 7, 3), (152, 4, 2), (158, 2, 1)]  # fmt: skip
    rings = []
    for down, width, thickness in rows:
        x, z = superellipse(width, thickness, thickness, 2.5, 12).T
        rings.append(top + scale * np.stack([x, np.full(12, -float(down)), z + slope * down], -1))
    return loft(np.array(rings))


def clavicle_curve(girdle: LeftGirdle, size: Proportions = REFERENCE) -> Floats:
    """(12, 3) mm, S-shaped centreline of the left clavicle: bowed forwards near the sternum, back near the acromion."""
    along = girdle.acromioclavicular - girdle.sternoclavicular
    bend = size.shoulder * np.array([0.36, 0.0, 0.93])
    shape = [(0.0, 0.0), (0.25, 9.0), (0.5, 2.0), (0.78, -9.0), (1.0, 0.0)]
    return smooth_curve(np.array([girdle.sternoclavicular + s * along + d * bend for s, d in shape]), 12)


def clavicle_surface(girdle: LeftGirdle, size: Proportions = REFERENCE) -> Surface:
    """Left clavicle, world mm."""
    radii = np.interp(np.linspace(0, 1, 12), [0, 0.12, 0.5, 0.85, 1], [7.5, 5.5, 4.5, 5.0, 5.0])
    flat = np.interp(np.linspace(0, 1, 12), [0, 0.12, 0.5, 0.85, 1], [8.0, 5.5, 4.5, 4.0, 3.5])
    return tube(clavicle_curve(girdle, size), size.shoulder * np.stack([radii, flat], -1), np.array([0.0, 1.0, 0.0]), 8)


@dataclass(frozen=True)
class LeftScapula:
    """Corners of the left scapula, world mm."""

    superior: Floats
    inferior: Floats
    spine_root: Floats
    glenoid: Floats
    acromion: Floats


def left_scapula(girdle: LeftGirdle, spine: Spine, size: Proportions = REFERENCE, behind: float = 0.0) -> LeftScapula:
    """Medial border behind ribs 2 to 7, in the reference body about 65 mm from the middle and 130 mm high (adult 140 to
    160); ``behind`` mm moves it back."""
    glenoid = girdle.glenohumeral + size.shoulder * np.array([-22.0, -2.0, -6.0])
    y2, y7 = spine.centres[1, 1], spine.centres[6, 1]
    out, up, back = size.shoulder, size.spine, np.array([0.0, 0.0, behind])
    superior = np.array([out * 62.0, y2 + up * 4.0, glenoid[2] - out * 54.0]) - back
    root = np.array([out * 58.0, y2 - up * 24.0, glenoid[2] - out * 66.0]) - back
    inferior = np.array([out * 74.0, y7 - up * 16.0, glenoid[2] - out * 75.0]) - back
    acromion = girdle.acromioclavicular + size.shoulder * np.array([17.0, -1.0, -10.0])
    return LeftScapula(superior, inferior, root, glenoid, acromion)


def scapula_surface(girdle: LeftGirdle, spine: Spine, size: Proportions = REFERENCE, behind: float = 0.0) -> Surface:
    """Left scapula, world mm: blade, spine with acromion, coracoid process and glenoid."""
    s = left_scapula(girdle, spine, size, behind)
    k = size.shoulder
    medial = smooth_curve(np.array([s.superior, s.spine_root, 0.45 * s.spine_root + 0.55 * s.inferior, s.inferior]), 8)
    neck = s.glenoid + k * np.array([-7.0, 0.0, -3.0])
    above = neck + k * np.array([0.0, 14.0, 0.0])
    below = neck - k * np.array([0.0, 13.0, 0.0])
    border = [
        0.5 * (above + s.superior) + k * np.array([0.0, 4.0, 3.0]),
        above,
        neck,
        below,
        0.7 * below + 0.3 * s.inferior,
        0.4 * neck + 0.6 * s.inferior + k * np.array([1.0, -3.0, -2.0]),
        0.18 * neck + 0.82 * s.inferior + k * np.array([3.0, -4.0, -3.0]),
        s.inferior + k * np.array([8.0, -3.0, 1.0]),
    ]
    lateral = np.array(border)
    share = np.linspace(0.0, 1.0, 5)[None, :, None]
    sheet = medial[:, None] + share * (lateral - medial)[:, None]
    # The blade bulges backwards, following the ribs.
    sheet[..., 2] -= 5.0 * k * np.sin(np.pi * share[..., 0])
    blade = slab(sheet, k * np.array([5.0, 3.5, 3.5, 4.5, 7.0]))
    ridge_points = [
        s.spine_root + k * np.array([6.0, 0.0, -2.0]),
        0.6 * s.spine_root + 0.4 * s.acromion + k * np.array([0.0, 0.0, -14.0]),
        0.25 * s.spine_root + 0.75 * s.acromion + k * np.array([0.0, 2.0, -14.0]),
        s.acromion + k * np.array([4.0, 0.0, -4.0]),
        s.acromion + k * np.array([0.0, 1.0, 12.0]),
    ]
    along = np.linspace(0.0, 1.0, 9)
    thick = np.interp(along, [0.0, 0.4, 1.0], [2.5, 6.0, 6.5])
    high = np.interp(along, [0.0, 0.4, 0.7, 1.0], [4.0, 5.0, 4.0, 3.5])
    up = np.array([0.0, 1.0, 0.0])
    ridge = tube(smooth_curve(np.array(ridge_points), 9), k * np.stack([thick, high], -1), up, 8)
    beak = neck + k * np.array([[-6.0, 9.0, 2.0], [-8.0, 14.0, 12.0], [-2.0, 12.0, 25.0], [4.0, 7.0, 30.0]])
    coracoid = tube(smooth_curve(beak, 6), k * np.array([5.0, 5.0]), np.array([0.3, 1.0, 0.0]), 8)
    cup = ball(s.glenoid + k * np.array([-2.0, 0.0, 0.0]), k * np.array([5.0, 16.0, 11.0]), 5, 10)
    return joined(blade, ridge, coracoid, cup)


def humerus_surface(girdle: LeftGirdle, size: Proportions = REFERENCE) -> Surface:
    """Left humeral head with a stump of the shaft, world mm; the arm is cut below it."""
    k = size.shoulder
    r = 0.5 * k * sizes.HUMERAL_HEAD
    c = girdle.glenohumeral
    neck = np.array([[3.0, 4.0, 0.0], [5.0, -10.0, 0.0], [6.0, -17.0, 0.0], [6.5, -24.0, 0.0]])
    radii = np.array([[15.0, 15.0], [14.0, 14.0], [11.0, 11.0], [10.0, 10.0]])
    return joined(ball(c, r, 7, 12), tube(c + k * neck, k * radii, np.array([0.0, 0.0, 1.0]), 10))
