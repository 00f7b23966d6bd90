"""Are a frontal image's corners in order, from head to foot and round each vertebra? What can safely be put right is.

In order means, as seen in the image: each vertebra's corners run clockwise round a convex quadrilateral from its top
left, and each vertebra lies below the one above it. Explanations of what is not so are compared by how odd a spine they
leave (``spine_shape``): one is taken where it is clearly ahead and leaves a spine as sound spines are; otherwise the
image is refused, with the vertebra that stands out (docs/cobb.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.arrays import Floats
from spinestiff.curves.corner_files import CORNERS, ImageCorners
from spinestiff.errors import SubjectError
from spinestiff.imaging.planar import cross
from spinestiff.imaging.spine_shape import (
    CLEARLY,
    Measure,
    Oddity,
    across,
    oddities,
    quarter_turns,
    sizes,
    spine_axes,
)

OVERLAP = 0.15
"""Of the mean height by which two neighbours may lie over one another: 0.05 in all but one of a thousand."""
REPAIRED = 0.5
"""Of the oddest of the sound spines: how far a vertebra whose corners were changed may be from what its neighbours
foretell. By each measure 99 of 100 sound vertebrae are nearer; one that was itself turned by 90 degrees seldom is."""
NOISE_DEG = (3.2, 2.2)
"""Of an endplate's tilt and of that of the line across, for a vertebra of median width: what corner noise of 2 % of
that width makes of them in 19 of 20 cases."""
BEYOND = 1.5
"""Over the oddest of the sound spines: corners beyond that are no vertebra's."""
WIDEST = 2.35
"""Median width of vertebrae over their median distance: 0.90 to 2.33 in 481 radiographs."""
STOPPING: tuple[Measure, ...] = ("sideways", "turned", "wide", "wedged")
"""Measures for which an image in order is refused. Heights vary by more, and a level named twice or left out, which the
places along the spine show, changes no angle between the others: both are warned of."""


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
    """The corners from head to foot, repaired where one explanation is clearly the most plausible.

    Raises
    ------
    SubjectError : a lateral image, fewer than two vertebrae, corners out of order beyond a safe repair, or in order but
        odder than those of any vertebra; says which.
    """
    if image.lateral:
        raise SubjectError("a lateral image; curves of a scoliosis are read in frontal ones")
    if len(image.levels) < 2:
        raise SubjectError(f"only {image.levels[0]}; a curve needs at least two vertebrae")
    rank = np.argsort([VERTEBRAE.index(level) for level in image.levels])
    levels, corners = tuple(image.levels[i] for i in rank), image.corners[rank]
    places = [VERTEBRAE.index(level) for level in levels]
    _refuse_turned(levels, corners)
    corners, renamed = _stacked(levels, corners)
    named = corners
    corners, turned = _rounded(levels, named)
    repairs, over = (*renamed, *turned.values()), _overlaps(levels, corners)
    odd = oddities(corners, places)
    if repairs:
        # A vertebra whose corners were put in order has to fit in well: the first that does not is the one to name.
        misfits = [f"{levels[o.row]} {o.words}" for o in odd if o.row in turned and o.ratio > REPAIRED]
        misfits += [doubt for row in turned for doubt in _turned_itself(levels, named, corners, row)]
        doubts = over + misfits + _outstanding(levels, corners, [o for o in odd if o.ratio > 1.0])
        if doubts:
            raise SubjectError(f"corners out of order, and no repair is safe: {'; '.join(repairs)}; but {doubts[0]}")
        return OrderedCorners(levels, corners, repairs, (*_squashed(places, corners), *_missing(levels)))
    stopping = [o for o in odd if o.measure in STOPPING and o.ratio > BEYOND]
    if stopping:
        raise SubjectError(f"{_outstanding(levels, corners, stopping)[0]}; correct its corners")
    # A level that lies over its neighbour is out of its place along the spine, too: said once.
    left = [o for o in odd if o.ratio > 1.0 and not (over and o.measure == "along")]
    warnings = over + [f"{words}; look at its corners" for words in _outstanding(levels, corners, left)]
    return OrderedCorners(levels, corners, (), (*_squashed(places, corners), *warnings, *_missing(levels)))


def _squashed(places: Sequence[int], corners: Floats) -> list[str]:
    """A word on vertebrae that are too wide for their distance, as in a picture that was made square."""
    apart = np.linalg.norm(np.diff(corners.mean(axis=1), axis=0), axis=1) / np.diff(places)
    wide = np.linalg.norm(corners[:, [1, 2]] - corners[:, [0, 3]], axis=-1).mean(axis=1)
    ratio = float(np.median(wide) / np.median(apart))
    if ratio <= WIDEST:
        return []
    return [
        f"vertebrae are {ratio:.1f} times as wide as they are apart, where {WIDEST:g} is much: was the picture "
        "squashed, or are corners shares of its size?"
    ]


def _refuse_turned(levels: tuple[str, ...], corners: Floats) -> None:
    """Refuse what is wrong with the image as a whole: there, nothing in it tells what would be right."""
    middles = corners.mean(axis=1)
    leftwards = (corners[:, 1] + corners[:, 2] - corners[:, 0] - corners[:, 3])[:, 0] < 0.0
    upwards = (corners[:, 2] + corners[:, 3] - corners[:, 0] - corners[:, 1])[:, 1] < 0.0
    rises = np.diff(middles[:, 1]) < 0.0
    most = 0.5 * len(levels)
    along = middles[-1] - middles[0]
    if abs(along[0]) > abs(along[1]):
        raise SubjectError(
            "the spine lies across the image: turn it so that the head is at the top, or exchange x and y if they are "
            "rows and columns"
        )
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


def _stacked(levels: tuple[str, ...], corners: Floats) -> tuple[Floats, tuple[str, ...]]:
    """Corners from top to bottom, levels renamed where one is out of place or two are exchanged, and what was done."""
    heights = corners.mean(axis=1)[:, 1]
    if (np.diff(heights) > 0.0).all():
        return corners, ()
    order = np.argsort(heights, kind="stable")
    for i, j in zip(order, order[1:]):
        if heights[i] == heights[j]:
            raise SubjectError(f"{levels[i]} and {levels[j]} lie at the same height; is one vertebra labelled twice?")
    above = next(i for i in range(len(levels) - 1) if heights[i + 1] < heights[i])
    fault = f"{levels[above + 1]} lies above {levels[above]}"
    one_moved = any((np.diff(np.delete(heights, i)) > 0.0).all() for i in range(len(levels)))
    if not one_moved and (order != np.arange(len(levels))).sum() > 2:
        raise SubjectError(f"{fault}, and moving or exchanging one pair puts the levels in no order from head to foot")
    first = VERTEBRAE.index(levels[0])
    if VERTEBRAE[first : first + len(levels)] != levels:
        raise SubjectError(f"{fault}, and as levels are missing it can't be told which is which")
    repair = f"levels renamed from head to foot, {levels[0]} to {levels[-1]}, as {fault}; check the names"
    return corners[order], (repair,)


def _rounded(levels: tuple[str, ...], corners: Floats) -> tuple[Floats, dict[int, str]]:
    """Corners clockwise from the top left in every vertebra, and what was done to which."""
    given = _clockwise_and_convex(corners)
    found = np.tile(np.arange(4), (len(levels), 1))
    for i in np.flatnonzero(~given).tolist():
        out = corners[i] - corners[i].mean(axis=0)
        found[i] = np.argsort(np.arctan2(out[:, 1], out[:, 0]))
        if not _clockwise_and_convex(corners[i, found[i]]):
            raise SubjectError(f"{levels[i]}: the corners make no vertebra in any order")
    round_each = np.take_along_axis(corners, found[:, :, None], axis=1)
    best = quarter_turns(round_each, [VERTEBRAE.index(level) for level in levels], given.tolist())
    orders = np.array([np.roll(order, -turn) for order, turn in zip(found, best.turns)])
    faulty = np.flatnonzero((orders != np.arange(4)).any(axis=1)).tolist()
    if faulty and 2 * len(faulty) >= len(levels):
        raise SubjectError(
            f"corners of {len(faulty)} of {len(levels)} vertebrae are out of order ({levels[faulty[0]]} first); "
            f"wanted {', '.join(CORNERS)} as seen in the image"
        )
    ordered = np.take_along_axis(corners, orders[:, :, None], axis=1)
    repairs = {}
    for i in faulty:
        if best.ahead[i] < CLEARLY:
            raise SubjectError(f"{levels[i]}: its corners are out of order, and which is which can't be told")
        named = ", ".join(f"{CORNERS[old]} is {CORNERS[new]}" for new, old in enumerate(orders[i]) if new != old)
        repairs[i] = f"{levels[i]} corners were out of order: what was named {named}"
    return ordered, repairs


def _turned_itself(levels: tuple[str, ...], named: Floats, ordered: Floats, row: int) -> list[str]:
    """The doubt, if there is one, whether a vertebra was put in turned rather than its corners begun at another.

    Both explanations keep the neighbours' tilts. They differ by how far the vertebra is from a rectangle: where that is
    more than corner noise, and turned back it would fit in as well, there is no telling which is right.
    """
    if not _clockwise_and_convex(named[row]):
        return []
    quarters = next(k for k in range(4) if np.array_equal(np.roll(named[row], -k, axis=0), ordered[row]))
    middle, out = named[row].mean(axis=0), named[row] - named[row].mean(axis=0)
    for _ in range(quarters):
        out = np.stack([-out[:, 1], out[:, 0]], axis=1)
    back = ordered.copy()
    back[row] = middle + out
    widths, _ = sizes(ordered)
    scale = float(np.median(widths) / widths[row])
    endplates, line = NOISE_DEG
    off = [_between(_lines(back[row])[i], _lines(ordered[row])[i]) for i in range(3)]
    places = [VERTEBRAE.index(level) for level in levels]
    fits = all(o.ratio <= REPAIRED for o in oddities(back, places) if o.row == row)
    if not fits or (max(off[:2]) <= endplates * scale and off[2] <= line * scale):
        return []
    # 270 degrees one way are 90 the other way.
    degrees = 180 if quarters == 2 else 90
    return [f"{levels[row]} may as well be turned itself, by {degrees} degrees, its tilt {max(off):.0f} degrees off"]


def _lines(quad: Floats) -> Floats:
    """(3, 2) along the upper and the lower endplate, and across between the middles of the sides."""
    return np.array([quad[1] - quad[0], quad[2] - quad[3], across(quad)])


def _between(a: Floats, b: Floats) -> float:
    """Degrees between two directions."""
    return float(np.degrees(np.abs(np.arctan2(cross(a, b), a @ b))))


def _clockwise_and_convex(quads: Floats) -> np.ndarray:
    """(...) whether quads (..., 4, 2) run clockwise as seen (rows grow downwards) and are convex."""
    edges = np.roll(quads, -1, axis=-2) - quads
    return np.asarray((cross(edges, np.roll(edges, -1, axis=-2)) > 0.0).all(axis=-1))


def _outstanding(levels: tuple[str, ...], corners: Floats, odd: Sequence[Oddity]) -> list[str]:
    """The vertebra behind these oddities, and what is odd about it; empty if there are none.

    A vertebra out of place makes its neighbours odd, too: it is the one without which the others are least odd.
    """
    if not odd:
        return []
    places = [VERTEBRAE.index(level) for level in levels]
    rows = sorted({o.row for o in odd})
    if len(levels) > 3 and len(rows) > 1:
        measures = {o.measure for o in odd}

        def left(row: int) -> float:
            rest = oddities(np.delete(corners, row, axis=0), [*places[:row], *places[row + 1 :]])
            return max(o.ratio for o in rest if o.measure in measures)

        worst = min(rows, key=left)
    else:
        worst = rows[0]
    return [f"{levels[worst]} {next(o for o in odd if o.row == worst).words}"]


def _overlaps(levels: tuple[str, ...], corners: Floats) -> list[str]:
    """Neighbours that lie over one another: one vertebra labelled twice, as a rule."""
    # The spine's axis, not the line between two middles: of one vertebra labelled twice that points anywhere.
    axes = spine_axes(corners)
    down = axes[1:] + axes[:-1]
    down = down / np.hypot(*down.T)[:, None]
    gaps = np.einsum("ij,ij->i", 0.5 * (corners[1:, :2].sum(1) - corners[:-1, 2:].sum(1)), down)
    _, heights = sizes(corners)
    over = -gaps / (0.5 * (heights[1:] + heights[:-1]))
    return [
        f"{levels[i + 1]} lies over {levels[i]} by {over[i]:.0%} of their height; is one vertebra labelled twice?"
        for i in np.flatnonzero(over > OVERLAP)
    ]


def _missing(levels: tuple[str, ...]) -> list[str]:
    span = VERTEBRAE[VERTEBRAE.index(levels[0]) : VERTEBRAE.index(levels[-1]) + 1]
    missing = [level for level in span if level not in levels]
    return [f"no corners of {', '.join(missing)}; a larger angle may end there"] if missing else []
