"""Vertebra boxes proposed from a few points clicked along a spine (paper 2.2 starts from boxes placed by hand).

1. A smooth curve through the points, and a picture straightened along it: one row for each step along the spine. In
   between the points the spine's middle follows both side walls.
2. Levels by the template's bodies and discs as the view shows them (``expected_spine``), between the first point (in
   the first named vertebra) and the last point (in the last named one). The size of the person follows from these.
3. Endplates where the straightened picture turns from disc to bone and back, and how they are tilted: the best sequence
   of all endplates together (dynamic programming) under what anatomy expects of heights, discs and tilts.
4. Side walls where bone ends to the left and right of each vertebra and endplates with it, again all together.
5. Once more from 3 on, along the middle that the walls tell.

What it can't see (arms, heart, gas, low contrast) it leaves where anatomy expects it; somebody has to look at it all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter1d

from spinestiff.arrays import Floats
from spinestiff.errors import TrackingError
from spinestiff.imaging.expected_spine import ExpectedSpine
from spinestiff.imaging.features import picture_axes
from spinestiff.imaging.projection import XRayView
from spinestiff.imaging.radiograph import Radiograph
from spinestiff.imaging.straightening import STEP, SpineCurve, Strip
from spinestiff.imaging.tracking.pictures import inside
from spinestiff.words import counted

FEWEST_POINTS = 3
# Points nearer than this, pixels, are one.
NEAREST = 2.0
# All lengths below are mm of the template's spine: the person's size has been taken out by then.
# The spine's middle: how far it is looked for; its standard deviation beside the curve at a click, midway between two,
# and from row to row. Rows beside each other show the same: so many mm count as one look, of that weight.
ASIDE, CLICK_SD, BETWEEN_SD, ASIDE_DRIFT = 8.0, 1.4, 3.5, 0.35
ONE_LOOK, MIDDLE = 8.0, 0.4
# The person's width over the template's, as tried there; and how far inside the corners a body ends on average.
SIZES, WAIST = (0.85, 0.92, 1.0, 1.08, 1.16), 1.2
# Endplates: reach and step of places (mm) and tilts (rad) that are tried, roughly, then finely.
PLACES = ((13.0, 0.5), (1.5, 0.25))
TILTS = ((np.radians(24.0), np.radians(3.0)), (np.radians(3.0), np.radians(1.0)))
# What anatomy expects, as standard deviations: an endplate's place, the clicked ends, heights of bodies and discs as
# shares, tilts against the curve, wedges of bodies and discs.
PLACE_SD, END_SD = 9.0, 2.5
BODY_SD, DISC_SD = 0.13, 0.35
TILT_SD, WEDGE_SD = np.radians(9.0), np.radians((6.0, 6.0))
# Weight of an edge against that, both in units where 1 is one standard deviation of either.
EDGE, WALL = 1.2, 1.0
EDGE_UNIT = 0.1
INNER = 0.42
# So far outside its corners an endplate's edge lies, mm.
RISE = 0.5
# Corners that somebody put right lie at most this far beside the edge that they mean.
HABIT_REACH = 3.0
# Side walls: reach and step; standard deviations of their middle beside the curve, of their distance, and of the change
# from one endplate to the next, over a body and over a disc.
WALL_REACH, WALL_STEP, WALL_SD, WIDTH_SD, WALL_DRIFT = 5.0, 0.25, 1.5, 1.5, (1.2, 0.9)
# An endplate's edge ends so far inside its corner, mm; the weight of a mm of it; what counts as an edge.
END_INSIDE, EXTENT, LEAST_RISE = 1.2, 2.0, 0.1
# How far a person's width over the template's is believed to grow or shrink along the spine as the walls say.
TREND = 0.7
# The picture is straightened along the clicks' curve, then along the middle, then along what the walls tell of it.
ROUNDS = 2


def propose_boxes(
    radiograph: Radiograph,
    points: Floats,
    vertebrae: Sequence[str],
    kept: Mapping[str, Floats] | None = None,
    leans: Mapping[str, float] | None = None,
) -> Floats:
    """Boxes (n, 4, 2) in pixels, in the corner order of ``VertebraCorners``, for n vertebrae head to foot.

    Parameters
    ----------
    radiograph : frontal or lateral.
    points : (k, 2) pixels (column, row) along the spine, k at least 3, in any order; the uppermost lies in the first
        of ``vertebrae``, the lowest in the last, each near the vertebra's middle.
    vertebrae : names, neighbours of each other.
    kept : boxes (4, 2) that stay as they are and guide the others: where levels lie, and how far beside the picture's
        edges this person sets corners.
    leans : of a lateral radiograph, how far vertebrae lean to the side, rad, where a frontal one was marked before.

    Raises
    ------
    TrackingError : too few points, points outside the radiograph, fewer than two vertebrae, names out of order.
    """
    first, up = picture_axes(radiograph.view)
    # Of a picture with square pixels, from here on.
    square = radiograph.squared()
    stretch = radiograph.view.pixel_spacing / square.view.pixel_spacing
    clicks = _checked(radiograph, points, up) * stretch
    expected = ExpectedSpine.of(vertebrae, square.view, 0.5 * (clicks[0] + clicks[-1]), leans)
    curve = SpineCurve.through(clicks, first)
    scale = curve.length / expected.length
    strip = Strip.along(square.pixels, curve, scale, expected.length)
    rows, aside = strip.rows, _middle(strip, expected, curve.coordinates(clicks)[:, 0] / scale)
    for _ in range(ROUNDS):
        curve = curve.beside(rows * scale, aside * scale)
        scale = curve.length / expected.length
        strip = Strip.along(square.pixels, curve, scale, expected.length)
        given = {
            list(vertebrae).index(name): curve.coordinates(np.asarray(quad, dtype=float) * stretch) / scale
            for name, quad in (kept or {}).items()
            if name in vertebrae
        }
        held = {i: quad for i, quad in given.items() if _guides(quad)}
        places, tilts = _endplates(strip, expected, held)
        walls = _walls(strip, expected, places, tilts, held)
        # What the walls tell of the middle, for the next round.
        rows, aside = places, gaussian_filter1d(walls.mean(axis=1), 1.0)
    if held:
        ends, sides = _habit(strip, expected, places, tilts, walls, held)
        free = np.array([k // 2 not in held for k in range(len(places))])
        places = places + free * np.tile(ends, len(places) // 2)
        walls = walls + free[:, None] * sides
    places = places + RISE * np.tile([1.0, -1.0], len(places) // 2)
    corners = np.stack([places[:, None] + walls * np.tan(tilts)[:, None], walls], axis=2).reshape(-1, 4, 2)
    boxes = curve.at(corners[..., 0] * scale, corners[..., 1] * scale)[:, [0, 1, 3, 2]] / stretch
    for name, quad in (kept or {}).items():
        if name in vertebrae:
            boxes[list(vertebrae).index(name)] = quad
    return boxes


def leans_of(view: XRayView, vertebrae: Mapping[str, ArrayLike]) -> dict[str, float]:
    """How far vertebrae, marked in a frontal view by four pixels each, lean to the side, rad (``propose_boxes``)."""
    first, up = picture_axes(view)
    found = {}
    for name, quad in vertebrae.items():
        a, b, c, d = view.from_pixels(quad)
        across = a + d - b - c
        found[name] = float(np.arctan2(across @ up, across @ first))
    return found


def _middle(strip: Strip, expected: ExpectedSpine, clicks: Floats) -> Floats:
    """(R,) mm by which the spine's middle lies beside the curve: where both side walls fit best, row after row.

    ``clicks`` are their places along the curve, mm. There the curve is right but for the hand that clicked; it may be
    farther off in between.
    """
    inside = (strip.rows > expected.places[0]) & (strip.rows < expected.places[-1])
    rows = strip.rows[inside]
    halves = np.interp(rows, expected.places, expected.halves) - WAIST
    shifts = np.arange(-ASIDE, ASIDE + 0.5 * STEP, STEP)
    after = np.clip(np.searchsorted(clicks, rows), 1, len(clicks) - 1)
    share = np.clip((rows - clicks[after - 1]) / (clicks[after] - clicks[after - 1]), 0.0, 1.0)
    sd = CLICK_SD + (BETWEEN_SD - CLICK_SD) * 4.0 * share * (1.0 - share)
    prior = 0.5 * (shifts / sd[:, None]) ** 2
    drift = 0.5 * ((shifts[:, None] - shifts[None]) / ASIDE_DRIFT) ** 2
    ways = []
    for size in SIZES:
        edge = np.zeros((len(rows), len(shifts)))
        for side in (1, -1):
            edge -= side * strip.sampled(strip.aside, rows[:, None], shifts[None] + side * size * halves[:, None])
        cost = list(STEP / ONE_LOOK * (prior - MIDDLE * gaussian_filter1d(edge, 3.0 / STEP, axis=0) / EDGE_UNIT))
        way = _cheapest(cost, [drift] * (len(cost) - 1))
        ways.append((sum(c[i] for c, i in zip(cost, way)), way))
    way = min(ways, key=lambda found: found[0])[1]
    found = gaussian_filter1d(shifts[way], 8.0 / STEP)
    return np.asarray(np.interp(strip.rows, rows, found))


def _guides(quad: Floats) -> bool:
    """Whether a box (4, 2), along and beside the curve, lies across the spine; what doesn't stays but guides nobody."""
    upper, lower = quad[0] - quad[1], quad[3] - quad[2]
    across = all(plate[1] > abs(plate[0]) for plate in (upper, lower))
    return across and bool(quad[:2, 0].mean() < quad[2:, 0].mean())


def _endplates(strip: Strip, expected: ExpectedSpine, held: Mapping[int, Floats]) -> tuple[Floats, Floats]:
    """Place (2n,) mm and tilt (2n,) rad of every endplate: the cheapest sequence of all."""
    places, tilts = expected.places.copy(), expected.tilts.copy()
    for i, quad in held.items():
        for k, (a, b) in ((2 * i, (quad[0], quad[1])), (2 * i + 1, (quad[3], quad[2]))):
            slope = (a[0] - b[0]) / (a[1] - b[1])
            places[k], tilts[k] = a[0] - slope * a[1], np.arctan(slope)
    if held:
        # Between vertebrae that stay, and beyond the last of them, the others move along.
        known = sorted(2 * i + j for i in held for j in (0, 1))
        moved = np.interp(expected.places, expected.places[known], (places - expected.places)[known])
        places = expected.places + moved
    target = places.copy()
    fixed = {2 * i + j for i in held for j in (0, 1)}
    for (reach, step), (most, turn) in zip(PLACES, TILTS):
        ds, da = np.arange(-reach, reach + 0.5 * step, step), np.arange(-most, most + 0.5 * turn, turn)
        unary, s, a = [], [], []
        for k in range(len(places)):
            still = k in fixed
            s.append(places[k] + (0.0 * ds[:1] if still else ds))
            a.append(tilts[k] + (0.0 * da[:1] if still else da))
            unary.append(np.zeros((1, 1)) if still else _endplate_cost(strip, expected, k, s[k], a[k], target[k]))
        places, tilts = _sequence(expected, unary, s, a)
    return places, tilts


def _endplate_cost(strip: Strip, expected: ExpectedSpine, k: int, s: Floats, a: Floats, target: float) -> Floats:
    """(places, tilts) cost of an endplate: little where grey rises into the bone all along its line."""
    half = INNER * 2.0 * expected.halves[k]
    across = np.linspace(-half, half, 25)
    rise = strip.sampled(
        strip.down, s[:, None, None] + across * np.tan(a)[None, :, None], np.broadcast_to(across, (1, 1, 25))
    ).mean(axis=2)
    rise = rise if k % 2 == 0 else -rise
    sd = END_SD if k in (0, 1, len(expected.places) - 2, len(expected.places) - 1) else PLACE_SD
    prior = 0.5 * ((s - target) / sd)[:, None] ** 2 + 0.5 * ((a - expected.tilts[k]) / TILT_SD)[None] ** 2
    return np.asarray(prior - EDGE * rise / EDGE_UNIT)


def _sequence(expected: ExpectedSpine, unary: list[Floats], s: list[Floats], a: list[Floats]) -> tuple[Floats, Floats]:
    """The cheapest (2n,) places and tilts. Steps cost by place and by tilt separately, so each is minimised in turn."""
    total, back = unary[0], []
    for k in range(1, len(unary)):
        gap = expected.places[k] - expected.places[k - 1]
        # Where vertebrae lean, discs are seen as no gap at all.
        sd = BODY_SD * gap if k % 2 else DISC_SD * max(gap, 0.0) + 0.4
        by_tilt = (
            0.5
            * ((a[k][:, None] - a[k - 1][None] - expected.tilts[k] + expected.tilts[k - 1]) / WEDGE_SD[(k + 1) % 2])
            ** 2
        )
        turned = total[:, None, :] + by_tilt[None]  # (previous place, tilt, previous tilt)
        from_tilt = turned.argmin(axis=2)
        best = np.take_along_axis(turned, from_tilt[..., None], axis=2)[..., 0]
        by_place = 0.5 * ((s[k][:, None] - s[k - 1][None] - gap) / sd) ** 2
        moved = best[None] + by_place[..., None]  # (place, previous place, tilt)
        from_place = moved.argmin(axis=1)
        total = unary[k] + np.take_along_axis(moved, from_place[:, None], axis=1)[:, 0]
        back.append((from_place, from_tilt))
    last = int(total.argmin())
    chosen = [(last // total.shape[1], last % total.shape[1])]
    for from_place, from_tilt in reversed(back):
        i, j = chosen[-1]
        before = int(from_place[i, j])
        chosen.append((before, int(from_tilt[before, j])))
    chosen.reverse()
    return (
        np.array([s[k][i] for k, (i, _) in enumerate(chosen)]),
        np.array([a[k][j] for k, (_, j) in enumerate(chosen)]),
    )


def _walls(strip: Strip, expected: ExpectedSpine, places: Floats, tilts: Floats, held: Mapping[int, Floats]) -> Floats:
    """(2n, 2) mm beside the curve where the endplates end, "first" side and other side.

    Both walls are looked for together, because their distance is known better than their place.
    """
    size = np.ones(len(places))
    reach = np.arange(-WALL_REACH, WALL_REACH + 0.5 * WALL_STEP, WALL_STEP)
    for _ in range(2):
        halves = expected.halves * size
        costs, tried = [], []
        for k in range(len(places)):
            if k // 2 in held:
                quad = held[k // 2][[0, 1] if k % 2 == 0 else [3, 2], 1]
                tried.append([np.array([quad[0] - halves[k]]), np.array([quad[1] + halves[k]])])
                costs.append(np.zeros((1, 1)))
                continue
            tried.append([reach, -reach])
            first = _wall_cost(strip, expected, places, tilts, k, halves[k] + reach, 1.0)
            other = _wall_cost(strip, expected, places, tilts, k, -halves[k] - reach, -1.0)
            wider, aside = reach[:, None] + reach[None], 0.5 * (reach[:, None] - reach[None])
            prior = 0.5 * (wider / WIDTH_SD) ** 2 + 0.5 * (aside / WALL_SD) ** 2
            costs.append(first[:, None] + other[None] + prior)
        found = _pairs(costs, tried) + halves[:, None] * [1.0, -1.0]
        # The person's width over the template's changes little along the spine; with it walls are looked for again.
        size = _along_a_line((found[:, 0] - found[:, 1]) / (2.0 * expected.halves))
    return found


def _along_a_line(values: Floats) -> Floats:
    """(n,) the line through values (n,) whose slope is the median of all slopes, and half of them above it."""
    at = np.arange(len(values)) - 0.5 * (len(values) - 1)
    i, j = np.triu_indices(len(values), max(1, len(values) // 3))
    slope = TREND * float(np.median((values[j] - values[i]) / (at[j] - at[i])))
    return np.asarray(slope * at + np.median(values - slope * at))


def _pairs(costs: list[Floats], tried: list[list[Floats]]) -> Floats:
    """(2n, 2) the cheapest way through pairs of offsets. A step costs by each of the two, minimised in turn."""
    total, back = costs[0], []
    for k in range(1, len(costs)):
        by = [0.5 * ((tried[k][j][:, None] - tried[k - 1][j][None]) / WALL_DRIFT[k % 2]) ** 2 for j in (0, 1)]
        turned = total[:, None, :] + by[1][None]  # (previous first, other, previous other)
        from_other = turned.argmin(axis=2)
        best = np.take_along_axis(turned, from_other[..., None], axis=2)[..., 0]
        moved = best[None] + by[0][..., None]  # (first, previous first, other)
        from_first = moved.argmin(axis=1)
        total = costs[k] + np.take_along_axis(moved, from_first[:, None], axis=1)[:, 0]
        back.append((from_first, from_other))
    last = int(total.argmin())
    chosen = [(last // total.shape[1], last % total.shape[1])]
    for from_first, from_other in reversed(back):
        i, j = chosen[-1]
        before = int(from_first[i, j])
        chosen.append((before, int(from_other[before, j])))
    chosen.reverse()
    return np.array([[tried[k][0][i], tried[k][1][j]] for k, (i, j) in enumerate(chosen)])


def _habit(
    strip: Strip, expected: ExpectedSpine, places: Floats, tilts: Floats, walls: Floats, held: Mapping[int, Floats]
) -> tuple[Floats, Floats]:
    """How far beside where the edges of the picture put them somebody sets corners: (2,) mm above and below, (2,) mm on
    either side.

    The median over the vertebrae that were put right, and less than that where they are few.
    """
    near = np.arange(-HABIT_REACH, HABIT_REACH + 0.1, 0.25)
    ends: list[list[float]] = [[], []]
    sides: list[list[float]] = [[], []]
    for k in (2 * i + j for i in held for j in (0, 1)):
        cost = _endplate_cost(strip, expected, k, places[k] + near, tilts[k : k + 1], places[k])[:, 0]
        ends[k % 2].append(-float(near[cost.argmin()]) - (RISE if k % 2 == 0 else -RISE))
        for column, side in enumerate((1.0, -1.0)):
            here = walls[k, column] + side * near
            cost = _wall_cost(strip, expected, places, tilts, k, here, side)
            sides[column].append(-side * float(near[cost.argmin()]))
    trust = len(held) / (len(held) + 1.0)
    return trust * np.median(ends, axis=1), trust * np.median(sides, axis=1)


def _wall_cost(
    strip: Strip, expected: ExpectedSpine, places: Floats, tilts: Floats, k: int, here: Floats, side: float
) -> Floats:
    """Cost of the end of an endplate: little where grey falls to the outside all along the body's nearer half."""
    other = k + 1 if k % 2 == 0 else k - 1
    share = np.linspace(0.05, 0.5, 10)
    along = (1.0 - share) * places[k] + share * places[other]
    slope = (1.0 - share) * np.tan(tilts[k]) + share * np.tan(tilts[other])
    inward = expected.depths[0 if side > 0.0 else 1]
    edge = here[:, None] - side * (inward[0] + (inward[1] - inward[0]) * 4.0 * share * (1.0 - share))
    fall = -side * strip.sampled(strip.aside, along + edge * slope, edge)
    return np.asarray(-WALL * fall.mean(axis=1) / EDGE_UNIT) + _extent_cost(
        strip, expected, places, tilts, k, here, side
    )


def _extent_cost(
    strip: Strip, expected: ExpectedSpine, places: Floats, tilts: Floats, k: int, here: Floats, side: float
) -> Floats:
    """Cost of the end of an endplate: little where all that shows an endplate's edge is on it and no more."""
    half = expected.halves[k]
    aside = np.arange(0.0, half + WALL_REACH + 4.0, WALL_STEP)
    up = 1.0 if k % 2 == 0 else -1.0
    along = places[k] + side * aside * np.tan(tilts[k]) - up * np.array([0.0, 0.5, 1.0])[:, None]
    rise = up * strip.sampled(strip.down, along, np.broadcast_to(side * aside, along.shape)).mean(axis=0)
    usual = max(float(rise[aside < 0.7 * half].mean()), LEAST_RISE)
    shown = np.cumsum(np.clip(rise / usual, -0.5, 1.5) - 0.5) * WALL_STEP
    return np.asarray(-EXTENT * min(usual / LEAST_RISE / 2.0, 1.0) * np.interp(side * here - END_INSIDE, aside, shown))


def _cheapest(costs: list[Floats], steps: list[Floats]) -> list[int]:
    """Indices of the cheapest way through states: ``costs[k]`` (m_k,), ``steps[k]`` (m_k+1, m_k)."""
    total, back = costs[0], []
    for cost, step in zip(costs[1:], steps):
        through = step + total[None]
        back.append(through.argmin(axis=1))
        total = cost + through.min(axis=1)
    way = [int(total.argmin())]
    for before in reversed(back):
        way.append(int(before[way[-1]]))
    return way[::-1]


def _checked(radiograph: Radiograph, points: Floats, up: Floats) -> Floats:
    points = np.asarray(points, dtype=float).reshape(-1, 2)
    rows, columns = radiograph.pixels.shape
    if not inside(points, (rows, columns)).all():
        raise TrackingError(f"a point along the spine lies outside the radiograph of {columns} columns, {rows} rows")
    points = points[np.argsort(points @ -up, kind="stable")]
    apart = [*points[:1]]
    for point in points[1:]:
        if np.linalg.norm(point - apart[-1]) > NEAREST:
            apart.append(point)
    if len(apart) < FEWEST_POINTS:
        found = counted(len(apart), "point")
        raise TrackingError(f"{found} along the spine, wanted {FEWEST_POINTS} or more, each apart")
    return np.array(apart)
