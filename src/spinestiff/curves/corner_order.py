"""Are a frontal image's corners in order, from head to foot and round each vertebra? What can safely be put right is.

In order means, as seen in the image: each vertebra's corners run clockwise round a convex quadrilateral that stands
along the spine, and each vertebra lies below the one above it. A repair must be the only one there is, change few
vertebrae, and lead to a spine without any doubt; otherwise the image is refused with the reason (docs/cobb.md).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.arrays import Floats
from spinestiff.curves.corner_files import CORNERS, ImageCorners
from spinestiff.errors import SubjectError

# The limits below stand beside what 454 labelled spines in order (7,718 vertebrae) show: docs/cobb.md.
STANDS_ALONG_DEG = 50.0
"""Between a vertebra's own axis and the spine's: 42 at most. Corners named a quarter turn off lie near 90."""
OVERLAP = 0.15
"""Of the mean height by which two neighbours may lie over one another: 0.05 in all but one of a thousand."""
WIDTHS = (1 / 3, 3.0)
"""Over the median width of the image: 0.55 to 1.9."""
REPAIRED_WIDTHS, REPAIRED_HEIGHTS, REPAIRED_GAPS = (0.6, 1.6), (0.4, 2.0), (0.5, 1.9)
"""Of a repaired vertebra over its neighbours' median, and of distances between centres over the image's median."""
REPAIRED_WEDGE_DEG = 25.0
"""Between a repaired vertebra's endplates: 29 at most."""


@dataclass(frozen=True)
class OrderedCorners:
    """Corners in order.

    Attributes
    ----------
    levels : (V,) head to foot.
    corners : (V, 4, 2) top left, top right, bottom right, bottom left as seen, rows growing downwards.
    repairs : what was changed, in words; empty = nothing.
    warnings : what is odd, but was left alone.
    """

    levels: tuple[str, ...]
    corners: Floats
    repairs: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def in_order(image: ImageCorners) -> OrderedCorners:
    """The corners from head to foot, repaired where that is unique and safe.

    Raises
    ------
    SubjectError : a lateral image, fewer than two vertebrae, or corners out of order beyond a safe repair; says which.
    """
    if image.lateral:
        raise SubjectError("a lateral image; curves of a scoliosis are read in frontal ones")
    if len(image.levels) < 2:
        raise SubjectError(f"only {image.levels[0]}; a curve needs at least two vertebrae")
    rank = np.argsort([VERTEBRAE.index(level) for level in image.levels])
    levels, corners = tuple(image.levels[i] for i in rank), image.corners[rank]
    _refuse_turned(levels, corners)
    corners, renamed = _stacked(levels, corners)
    corners, turned = _rounded(levels, corners)
    _refuse_odd_widths(levels, corners)
    repairs, doubts = (*renamed, *turned.values()), _overlaps(levels, corners)
    if repairs:
        doubts += _misfits(levels, corners, turned) + (_uneven(levels, corners) if renamed else [])
        if doubts:
            raise SubjectError(f"corners out of order, and no repair is safe: {'; '.join(repairs)}; but {doubts[0]}")
    return OrderedCorners(levels, corners, repairs, tuple(doubts + _missing(levels)))


def _refuse_turned(levels: tuple[str, ...], corners: Floats) -> None:
    """Refuse what is wrong with the image as a whole: there, nothing in it tells what would be right."""
    middles = corners.mean(axis=1)
    leftwards = (corners[:, 1] + corners[:, 2] - corners[:, 0] - corners[:, 3])[:, 0] < 0.0
    upwards = (corners[:, 2] + corners[:, 3] - corners[:, 0] - corners[:, 1])[:, 1] < 0.0
    rises = np.diff(middles[:, 1]) < 0.0
    most = 0.5 * len(levels)
    if rises.sum() > 0.5 * len(rises) and upwards.sum() > most:
        raise SubjectError("y grows upwards; wanted image rows, which grow downwards")
    if rises.sum() > 0.5 * len(rises):
        raise SubjectError(f"{levels[0]} lies below {levels[-1]}: upside down, or the levels are named from below")
    if upwards.sum() > most:
        raise SubjectError("top and bottom corners are exchanged in most vertebrae; name them as seen in the image")
    if leftwards.sum() > most:
        raise SubjectError(
            "left and right corners are exchanged in most vertebrae: the image is mirrored, or the corners are named "
            "by the patient's sides; name them as seen in the image"
        )
    along = middles[-1] - middles[0]
    if abs(along[0]) > abs(along[1]):
        raise SubjectError("the spine lies across the image; turn it so that the head is at the top")


def _stacked(levels: tuple[str, ...], corners: Floats) -> tuple[Floats, tuple[str, ...]]:
    """Corners from top to bottom, so that levels change where just one vertebra was out of place, and what was done."""
    heights = corners.mean(axis=1)[:, 1]
    if (np.diff(heights) > 0.0).all():
        return corners, ()
    order = np.argsort(heights, kind="stable")
    for i, j in zip(order, order[1:]):
        if heights[i] == heights[j]:
            raise SubjectError(f"{levels[i]} and {levels[j]} lie at the same height; is one vertebra labelled twice?")
    above = next(i for i in range(len(levels) - 1) if heights[i + 1] < heights[i])
    fault = f"{levels[above + 1]} lies above {levels[above]}"
    if not any((np.diff(np.delete(heights, i)) > 0.0).all() for i in range(len(levels))):
        raise SubjectError(f"{fault}, and moving one vertebra puts the levels in no order from head to foot")
    first = VERTEBRAE.index(levels[0])
    if VERTEBRAE[first : first + len(levels)] != levels:
        raise SubjectError(f"{fault}, and as levels are missing it can't be told which is which")
    repair = f"levels renamed from head to foot, {levels[0]} to {levels[-1]}, as {fault}; check the names"
    return corners[order], (repair,)


def _rounded(levels: tuple[str, ...], corners: Floats) -> tuple[Floats, dict[int, str]]:
    """Corners clockwise from the top left in every vertebra, and what was done to which."""
    axes = _spine_axes(corners)
    faulty = np.flatnonzero(~_go_round(corners, axes)).tolist()
    if not faulty:
        return corners, {}
    if 2 * len(faulty) >= len(levels):
        raise SubjectError(
            f"corners of {len(faulty)} of {len(levels)} vertebrae are out of order ({levels[faulty[0]]} first); "
            f"wanted {', '.join(CORNERS)} as seen in the image"
        )
    corners, repairs = corners.copy(), {}
    for i in faulty:
        found = _clockwise(corners[i])
        choices = [np.roll(found, -k) for k in range(4)]
        choices = [order for order in choices if _go_round(corners[i, order], axes[i])]
        if len(choices) != 1:
            raise SubjectError(f"{levels[i]}: the corners make no vertebra in any order")
        named = ", ".join(f"{CORNERS[old]} is {CORNERS[new]}" for new, old in enumerate(choices[0]) if new != old)
        repairs[i] = f"{levels[i]} corners were out of order: what was named {named}"
        corners[i] = corners[i, choices[0]]
    return corners, repairs


def _spine_axes(corners: Floats) -> Floats:
    """(V, 2) from head to foot along the spine at each vertebra, from the two neighbours to either side."""
    middles = corners.mean(axis=1)
    each = np.arange(len(middles))
    return middles[np.minimum(each + 2, each[-1])] - middles[np.maximum(each - 2, 0)]


def _go_round(quads: Floats, axes: Floats) -> np.ndarray:
    """(...) whether quads (..., 4, 2) run clockwise (rows grow downwards), are convex and stand along ``axes``."""
    edges = np.roll(quads, -1, axis=-2) - quads
    convex = (_cross(edges, np.roll(edges, -1, axis=-2)) > 0.0).all(axis=-1)
    across = quads[..., 1, :] + quads[..., 2, :] - quads[..., 0, :] - quads[..., 3, :]
    angle = np.arctan2(np.sum(across * axes, axis=-1), _cross(across, axes))
    return np.asarray(convex & (np.abs(angle) < np.radians(STANDS_ALONG_DEG)))


def _cross(a: Floats, b: Floats) -> Floats:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _clockwise(quad: Floats) -> np.ndarray:
    """(4,) the order in which four points lie clockwise round their middle."""
    out = quad - quad.mean(axis=0)
    return np.argsort(np.arctan2(out[:, 1], out[:, 0]))


def _sizes(corners: Floats) -> tuple[Floats, Floats]:
    """(V,) width and height of each vertebra, between the middles of its sides."""
    across = 0.5 * (corners[:, 1] + corners[:, 2] - corners[:, 0] - corners[:, 3])
    down = 0.5 * (corners[:, 2] + corners[:, 3] - corners[:, 0] - corners[:, 1])
    return np.hypot(*across.T), np.hypot(*down.T)


def _refuse_odd_widths(levels: tuple[str, ...], corners: Floats) -> None:
    widths, _ = _sizes(corners)
    for level, ratio in zip(levels, widths / np.median(widths)):
        if not WIDTHS[0] <= ratio <= WIDTHS[1]:
            raise SubjectError(f"{level} is {ratio:.2g} times as wide as the other vertebrae; correct its corners")


def _overlaps(levels: tuple[str, ...], corners: Floats) -> list[str]:
    """Neighbours that lie over one another: one vertebra labelled twice, as a rule."""
    # The spine's axis, not the line between two middles: of one vertebra labelled twice that points anywhere.
    axes = _spine_axes(corners)
    down = axes[1:] + axes[:-1]
    down = down / np.hypot(*down.T)[:, None]
    gaps = np.einsum("ij,ij->i", 0.5 * (corners[1:, :2].sum(1) - corners[:-1, 2:].sum(1)), down)
    _, heights = _sizes(corners)
    over = -gaps / (0.5 * (heights[1:] + heights[:-1]))
    return [
        f"{levels[i + 1]} lies over {levels[i]} by {over[i]:.0%} of their height; is one vertebra labelled twice?"
        for i in np.flatnonzero(over > OVERLAP)
    ]


def _misfits(levels: tuple[str, ...], corners: Floats, repaired: Iterable[int]) -> list[str]:
    """What of vertebrae whose corners were repaired does not look like their neighbours."""
    found = []
    top, bottom = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 3]
    wedge = np.degrees(np.abs(np.arctan2(_cross(top, bottom), np.einsum("ij,ij->i", top, bottom))))
    for i in repaired:
        near = [j for j in (i - 2, i - 1, i + 1, i + 2) if 0 <= j < len(levels)]
        for sizes, (low, high), what in zip(_sizes(corners), (REPAIRED_WIDTHS, REPAIRED_HEIGHTS), ("wide", "high")):
            ratio = sizes[i] / np.median(sizes[near])
            if not low <= ratio <= high:
                found.append(f"{levels[i]} is then {ratio:.2g} times as {what} as its neighbours")
        if wedge[i] > REPAIRED_WEDGE_DEG:
            found.append(f"{levels[i]} is then wedged by {wedge[i]:.0f} degrees")
    return found


def _uneven(levels: tuple[str, ...], corners: Floats) -> list[str]:
    """Neighbours that are much nearer to or farther from each other than the others."""
    gaps = np.hypot(*np.diff(corners.mean(axis=1), axis=0).T)
    ratios = gaps / np.median(gaps)
    return [
        f"{levels[i]} and {levels[i + 1]} are then {ratios[i]:.2g} times as far apart as the others"
        for i in np.flatnonzero((ratios < REPAIRED_GAPS[0]) | (ratios > REPAIRED_GAPS[1]))
    ]


def _missing(levels: tuple[str, ...]) -> list[str]:
    span = VERTEBRAE[VERTEBRAE.index(levels[0]) : VERTEBRAE.index(levels[-1]) + 1]
    missing = [level for level in span if level not in levels]
    return [f"no corners of {', '.join(missing)}; a larger angle may end there"] if missing else []
