"""The pelvis as one bone: sacrum, iliac wings, ischium and pubis."""

from __future__ import annotations

import numpy as np

from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.template import sizes
from spinestiff.anatomy.template.surfaces import (
    Surface,
    ball,
    joined,
    loft,
    mirrored,
    slab,
    smooth_curve,
    superellipse,
    tube,
)
from spinestiff.arrays import Floats

# Half distance of the iliac crests' outer lips: half the bi-iliac breadth less 8 mm of soft tissue a side.
CREST_HALF = 0.5 * sizes.BI_ILIAC - 8.0


def _sacrum() -> Surface:
    # Its face is the sacral endplate; then it curves down and back (adult 100 to 110 mm long), narrowing to the coccyx.
    width, depth = sizes.VERTEBRA_SIZES[-1, 2:4]
    slope = np.deg2rad(sizes.SACRAL_SLOPE_DEG)
    # along the sacrum from the endplate, half width, half depth, tilt of the section beyond the endplate's
    w, d = 0.5 * width, 0.5 * depth
    rows = [(-0.5, w - 2, d - 1, 0), (1, w, d, 0), (4, w + 6, d, 0), (7, 41, 16, 2), (12, 49, 15, 4), (22, 50, 15, 8),
            (34, 46, 14, 12), (48, 37, 11, 13), (62, 28, 9, 6), (76, 20, 7, -8), (88, 12, 5, -26), (98, 6, 4, -42),
            (106, 3, 3, -50)]  # fmt: skip
    rings, centre, last = [], np.zeros(3), 0.0
    for along, a, b, tilt in rows:
        frame = exp_so3(np.array([slope + np.deg2rad(tilt), 0.0, 0.0]))
        centre = centre - (along - last) * frame[:, 1]
        last = along
        x, z = superellipse(a, b, b, 2.4, 14).T
        back = -0.25 * max(0.0, a - 24.0) * (np.abs(x) / a) ** 2  # the wings lie behind the promontory
        rings.append(centre + np.stack([x, np.zeros(14), z + back], -1) @ frame.T)
    return loft(np.array(rings))


def left_crest() -> Floats:
    """(9, 3) mm, the left iliac crest from the posterior to the anterior superior spine."""
    c = CREST_HALF
    points = [(41, -14, -70), (48, 4, -68), (62, 20, -58), (88, 32, -36), (c - 5, 35, -8), (c, 27, 16), (c - 4, 12, 36),
              (c - 9, -4, 48), (c - 15, -17, 51)]  # fmt: skip
    return np.array(points, dtype=float)


def _left_wing() -> Surface:
    crest = smooth_curve(left_crest(), 13)
    # From the posterior inferior spine over the greater notch and the acetabulum's roof to the anterior inferior spine.
    foot_points = [(42, -34, -72), (49, -44, -60), (58, -48, -42), (70, -56, -24), (80, -62, -4), (87, -61, 13),
                   (93, -52, 28), (99, -38, 39)]  # fmt: skip
    foot = smooth_curve(np.array(foot_points, dtype=float), 13)
    share = np.linspace(0.0, 1.0, 6)[None, :, None]
    sheet = foot[:, None] + share * (crest - foot)[:, None]
    sheet[..., 0] -= 7.0 * np.sin(np.pi * share[..., 0])  # the iliac fossa
    return slab(sheet, np.array([9.0, 7.0, 5.0, 5.0, 6.5, 8.0]))


def _left_lower() -> Surface:
    # The hip's centre lies before the sacral endplate's: a pelvic tilt of 7 degrees (Mac-Thiong 2004: 7.2).
    acetabulum = np.array([84.0, -75.0, 9.0])
    cup = ball(acetabulum, np.array([15.0, 24.0, 24.0]), 6, 10)
    up = np.array([0.0, 1.0, 0.0])
    iliac = tube(
        smooth_curve(np.array([acetabulum + [-3, 6, -6], (77, -52, -12), (67, -36, -28), (58, -26, -46)]), 6),
        np.array([[13, 17], [12, 16], [10, 15], [9, 14], [8, 13], [6, 10]], dtype=float),
        np.array([0.0, 0.4, 1.0]),
        8,
    )
    ischium = tube(
        smooth_curve(np.array([acetabulum + [-2, -8, -12], (74, -106, -20), (63, -131, -19), (53, -141, -5)]), 8),
        np.array([[14, 15], [13, 14], [11, 12], [10, 11], [11, 12], [12, 13], [11, 12], [7, 8]], dtype=float),
        np.array([1.0, 0.0, 0.2]),
        8,
    )
    upper = tube(
        smooth_curve(np.array([acetabulum + [-6, 0, 14], (60, -72, 40), (34, -74, 53), (12, -80, 57)]), 8),
        np.array([[12, 12], [10, 10], [8.5, 8.5], [7.5, 7.5], [7, 7.5], [7, 8], [7, 9], [6, 8]]),
        up,
        8,
    )
    body = tube(
        np.array([(9.5, -72, 57), (10, -82, 56), (10, -94, 52), (10.5, -106, 46)], dtype=float),
        np.array([[6.5, 5.5], [7.5, 6.5], [7.5, 6.5], [6.5, 5.5]]),
        np.array([0.0, 0.0, 1.0]),
        8,
    )
    lower = tube(
        smooth_curve(np.array([(12, -99, 49), (25, -117, 33), (40, -133, 11), (53, -141, -5)], dtype=float), 7),
        np.array([[5, 8], [5, 8], [4.5, 7.5], [4.5, 7.5], [5, 8], [5.5, 8], [5, 7]]),
        up,
        8,
    )
    return joined(cup, iliac, ischium, upper, body, lower)


def _sacral_crest() -> Surface:
    # The median crest: what is left of the sacral spinous processes.
    slope = np.deg2rad(sizes.SACRAL_SLOPE_DEG)
    along, behind = np.array([14.0, 24.0, 38.0, 52.0, 64.0]), np.array([18.0, 20.0, 19.0, 15.0, 10.0])
    tilt = slope + np.deg2rad(np.array([4.0, 5.0, 7.0, 8.0, 7.0]))
    points = np.stack([0.0 * along, -along * np.cos(tilt) + behind * np.sin(tilt), 0.0 * along], -1)
    points[:, 2] = -along * np.sin(tilt) - behind * np.cos(tilt)
    return tube(points, np.array([[3, 4], [3.5, 6], [3.5, 6], [3, 5], [2, 3]]), np.array([0.0, 0.4, -1.0]), 8)


def pelvis_surface() -> Surface:
    """The whole pelvis, world mm (origin: middle of the sacral endplate)."""
    left = joined(_left_wing(), _left_lower())
    return joined(_sacrum(), _sacral_crest(), left, mirrored(left))


def pelvis_bounds() -> tuple[float, float]:
    """(bottom, top) mm of the pelvis."""
    y = pelvis_surface()[0][:, 1]
    return float(y.min()), float(y.max())
