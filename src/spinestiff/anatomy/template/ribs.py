"""Ribs as swept tubes along centrelines that meet their vertebra and, from 1 to 10, the sternum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.template import sizes
from spinestiff.anatomy.template.surfaces import Surface, arc_length, resampled, smooth_curve, tangents, tube
from spinestiff.anatomy.template.vertebrae import Spine, costotransverse, costovertebral
from spinestiff.arrays import Floats

SAMPLES = 37  # points of a centreline
FLOATING = 10  # from the eleventh rib on
ARCH = 4  # from the fifth rib on the cartilages bend upwards, side by side
ARCH_SPACING = {4: 9.5, 5: 9.0, 6: 8.0, 7: 6.5, 8: 6.0, 9: 6.0}  # mm, centreline to that of the cartilage above
CARTILAGE_HALF_HEIGHT = (3.7, 5.3, 5.3, 4.8, 4.4, 3.8, 2.8, 2.4, 2.4, 2.4)  # mm
SHORT = 1.5  # mm between a cartilage's end and the middle of its joint
_OUTWARDS = np.array([0.3, 0.0, 0.95])  # normal of the chest wall beside the sternum
# Arc lengths scale like the chest: a mean of the three directions' scales, weighted by a rib's run in them.
ARC_SCALE = 0.79
BULGES = (0.7, 2.2)


@dataclass(frozen=True)
class LeftRib:
    """The left rib of a pair, world mm.

    Attributes
    ----------
    head, tubercle : (3,) middles of the costovertebral and costotransverse joints.
    curve : (SAMPLES, 3) centreline from the head to the front end, equal steps.
    bony : share of the curve that is bone; the rest is cartilage.
    notch : (3,) where the cartilage meets the sternum; for floating ribs the free end.
    """

    head: Floats
    tubercle: Floats
    curve: Floats
    bony: float
    notch: Floats


def costal_notches(spine: Spine) -> Floats:
    """(10, 3) mm, left costal notches of the sternum."""
    down = sizes.COSTAL_NOTCHES_DOWN
    top = jugular_notch(spine)
    forward = sizes.STERNUM_SLOPE * down
    return top + np.stack([sizes.COSTAL_NOTCHES_HALF, -down, forward], -1)


def jugular_notch(spine: Spine) -> Floats:
    """(3,) mm, top of the sternum in the middle plane."""
    return spine.discs[0] + np.array([0.0, *sizes.JUGULAR_NOTCH])


def _bony_points(level: int, head: Floats, tubercle: Floats, bulge: float) -> Floats:
    # Shape: back from the tubercle to the angle, round the side, forward and down to the costochondral junction.
    _, forward, drop, end, reach = sizes.ADULT_RIBS[level]
    scale = np.array([sizes.RIB_SCALE_LATERAL, -sizes.RIB_SCALE_DOWN, sizes.RIB_SCALE_FORWARD])
    if level >= 10:
        wanted = [
            (0.50 * reach, 0.22 * drop, -15.0 * bulge),
            (0.82 * reach, 0.58 * drop, -8.0 * bulge),
            (end, drop, forward),
        ]
    else:
        wanted = [
            (0.50 * reach, 0.10 * drop, -0.22 * forward * bulge),
            (0.86 * reach, 0.30 * drop, -0.02 * forward * bulge),
            (reach, 0.55 * drop, 0.36 * forward),
            (0.62 * reach + 0.38 * end, 0.83 * drop, 0.80 * forward),
            (end, drop, forward),
        ]
    points = np.array([[0.0, head[1], head[2]]]) + np.array(wanted) * scale
    return np.vstack([head, tubercle, points])


def _bony_curve(level: int, head: Floats, tubercle: Floats) -> Floats:
    # The backward bulge of the angle is what the table leaves open: it brings the arc to the scaled adult length.
    from scipy.optimize import brentq

    def curve(bulge: float) -> Floats:
        return smooth_curve(_bony_points(level, head, tubercle, bulge), 200)

    def excess(bulge: float) -> float:
        return arc_length(curve(bulge)) - wanted

    wanted = ARC_SCALE * sizes.ADULT_RIBS[level, 0]
    low, high = BULGES
    if excess(low) > 0.0:
        return curve(low)
    return curve(brentq(excess, low, high) if excess(high) > 0.0 else high)


def _cartilage(level: int, bony: Floats, notch: Floats) -> Floats:
    # A cubic that leaves along the bone and arrives at the sternum from the side and below.
    start, direction = bony[-1], tangents(bony)[-1]
    gap = float(np.linalg.norm(notch - start))
    # The lower a rib, the more its cartilage bends upwards (the costal arch).
    climb = np.clip((level - 2) / 5.0, 0.0, 1.0)
    arrive = np.array([-1.0, 1.1 * climb - 0.1, 0.18])
    arrive /= np.linalg.norm(arrive)
    t = np.linspace(0.0, 1.0, 80)[:, None]
    a, b = start + 0.42 * gap * direction, notch - 0.40 * gap * arrive
    return (1 - t) ** 3 * start + 3 * t * (1 - t) ** 2 * a + 3 * t**2 * (1 - t) * b + t**3 * notch


def _clear_of(above: Floats, curve: Floats, apart: float) -> Floats:
    # The cartilage moved so that it stays ``apart`` mm below and inwards of the rib above it; its ends stay.
    from scipy.spatial import cKDTree

    below = np.cross(_OUTWARDS, tangents(above))
    below /= np.linalg.norm(below, axis=1, keepdims=True)
    fade = np.minimum(1.0, np.linspace(0.0, 12.0, len(curve)))
    for _ in range(8):
        nearest = cKDTree(above).query(curve)[1]
        across = np.einsum("ni,ni->n", curve - above[nearest], below[nearest])
        lack = fade * np.maximum(apart - across, 0.0)
        lack[-1] = 0.0
        curve = curve + lack[:, None] * below[nearest]
        middle = 0.25 * curve[:-2] + 0.5 * curve[1:-1] + 0.25 * curve[2:]
        curve = np.vstack([curve[:1], middle, curve[-1:]])
    return curve


def left_ribs(spine: Spine) -> tuple[LeftRib, ...]:
    """The left ribs, 1 to 12; a cartilage keeps clear of the one above it."""
    ribs: list[LeftRib] = []
    for level in range(12):
        rotation, centre = spine.rotations[level], spine.centres[level]
        head, tubercle = (centre + rotation @ point(level) for point in (costovertebral, costotransverse))
        bony = _bony_curve(level, head, tubercle)
        if level >= FLOATING:
            ribs.append(LeftRib(head, tubercle, resampled(bony, SAMPLES), 1.0, bony[-1]))
            continue
        notch = costal_notches(spine)[level]
        cartilage = _cartilage(level, bony, notch)
        if level >= ARCH:
            cartilage = _clear_of(resampled(ribs[-1].curve, 400), cartilage, ARCH_SPACING[level])
        cartilage = cartilage[: -max(1, round(SHORT * len(cartilage) / arc_length(cartilage)))]
        whole = np.vstack([bony, cartilage[1:]])
        share = arc_length(bony) / arc_length(whole)
        ribs.append(LeftRib(head, tubercle, resampled(whole, SAMPLES), share, notch))
    return tuple(ribs)


def rib_surface(rib: LeftRib, level: int) -> Surface:
    """Left rib and its cartilage as one closed tube, world mm."""
    n = len(rib.curve)
    share = np.linspace(0.0, 1.0, n)
    # Flat side against the chest wall: outward is away from the middle of the curve.
    middle = rib.curve.mean(0) * np.array([0.0, 1.0, 1.0])
    t = tangents(rib.curve)
    away = rib.curve - middle
    tall = np.cross(t, away)
    tall = tall / np.linalg.norm(tall, axis=1, keepdims=True)
    neck = np.clip((share - 0.02) / 0.12, 0.0, 1.0)
    thick = sizes.RIB_HALF_THICKNESS * np.ones(n)
    high = 3.6 + (sizes.RIB_HALF_HEIGHT - 3.6) * neck
    if level == 0:  # the first rib lies flat: broad in its own plane
        thick, high = thick + 1.6 * neck, high - 1.6 * neck
    if level in (10, 11):
        high = high * np.interp(share, [0.0, 0.6, 1.0], [1.0, 0.9, 0.45])
    if level < FLOATING:  # cartilages are as thick as their bone but share the height of the sternum's side
        end = CARTILAGE_HALF_HEIGHT[level]
        bony = rib.bony
        high = np.interp(share, [0.0, bony, bony + 0.4 * (1.0 - bony), 1.0], [1.0, 1.0, 0.0, 0.0]) * (high - end) + end
    radii = np.stack([thick, high], -1)
    radii[0] *= 0.8
    radii[-1] *= 0.7
    return tube(rib.curve, radii, tall, 8)
