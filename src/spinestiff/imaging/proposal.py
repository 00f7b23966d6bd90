"""Vertebra boxes proposed from a few points clicked along a spine (paper 2.2 starts from boxes placed by hand).

1. A smooth curve through the points, and a picture straightened along it: one row for each step along the spine.
2. Levels by the published heights of bodies and discs behind anatomy's template, between the first point (in the first
   named vertebra) and the last point (in the last named one). The person's size follows from the points alone.
3. Endplates where the straightened picture turns from disc to bone and back, and how they are tilted: the best sequence
   of all endplates together (dynamic programming) under what anatomy expects of heights, discs and tilts.
4. Side walls where bone ends to the left and right of each vertebra, again all together.

What it can't see (arms, heart, gas, low contrast) it leaves where anatomy expects it; somebody has to look at it all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.template.sizes import VERTEBRA_SIZES
from spinestiff.arrays import Floats
from spinestiff.errors import TrackingError
from spinestiff.imaging.features import picture_axes, view_kind
from spinestiff.imaging.radiograph import Radiograph
from spinestiff.imaging.straightening import STEP, SpineCurve, Strip

FEWEST_POINTS = 3
# Points nearer than this, pixels, are one.
NEAREST = 2.0
# All lengths below are mm of the template's spine: the person's size has been taken out by then.
# How far the middle of the spine may lie beside the curve, and how quickly that changes from row to row.
ASIDE, ASIDE_DRIFT = 8.0, 0.12
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
# Corners that somebody put right lie at most this far beside the edge that they mean.
HABIT_REACH = 3.0
WALL_REACH, WALL_SD, WALL_DRIFT = 7.0, 2.5, 0.8


def propose_boxes(
    radiograph: Radiograph,
    points: Floats,
    vertebrae: Sequence[str],
    kept: Mapping[str, Floats] | None = None,
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

    Raises
    ------
    TrackingError : too few points, points outside the radiograph, fewer than two vertebrae, names out of order.
    """
    first, up = picture_axes(radiograph.view)
    expected = _Expected.of(vertebrae, view_kind(radiograph.view))
    curve = SpineCurve.through(_checked(radiograph, points, up), first)
    scale = curve.length / expected.length
    strip = Strip.along(radiograph.pixels, curve, scale, expected.length)
    curve = curve.beside(strip.rows * scale, _middle(strip, expected) * scale)
    scale = curve.length / expected.length
    strip = Strip.along(radiograph.pixels, curve, scale, expected.length)
    given = {
        list(vertebrae).index(name): curve.coordinates(np.asarray(quad, dtype=float)) / scale
        for name, quad in (kept or {}).items()
        if name in vertebrae
    }
    held = {i: quad for i, quad in given.items() if _guides(quad)}
    places, tilts = _endplates(strip, expected, held)
    walls = _walls(strip, expected, places, tilts, held)
    if held:
        ends, sides = _habit(strip, expected, places, tilts, walls, held)
        free = np.array([k // 2 not in held for k in range(len(places))])
        places = places + free * np.tile(ends, len(places) // 2)
        walls = walls + free[:, None] * sides
    corners = np.stack([places[:, None] + walls * np.tan(tilts)[:, None], walls], axis=2).reshape(-1, 4, 2)
    boxes = curve.at(corners[..., 0] * scale, corners[..., 1] * scale)[:, [0, 1, 3, 2]]
    for name, quad in (kept or {}).items():
        if name in vertebrae:
            boxes[list(vertebrae).index(name)] = quad
    return boxes


@dataclass(frozen=True)
class _Expected:
    """What anatomy expects of n vertebrae, in mm of the template along the spine, 0 = middle of the first.

    Attributes
    ----------
    places : (2n,) of the endplates, upper and lower of each vertebra in turn.
    halves : (2n,) half the endplates' width, as seen in the view.
    """

    places: Floats
    halves: Floats

    @property
    def length(self) -> float:
        """From the middle of the first to the middle of the last."""
        return float(0.5 * (self.places[-2:].sum() - self.places[:2].sum()))

    @staticmethod
    def of(vertebrae: Sequence[str], kind: str) -> _Expected:
        rows = [VERTEBRAE.index(name) for name in vertebrae if name in VERTEBRAE]
        if len(rows) != len(vertebrae) or len(rows) < 2 or (np.diff(rows) != 1).any():
            raise TrackingError(f"can't propose {', '.join(vertebrae) or 'nothing'}; wanted two or more neighbours")
        sizes = VERTEBRA_SIZES[rows]
        edges = np.concatenate([[0.0], np.cumsum(sizes[:, 4:6].ravel())[:-1]])
        halves = 0.5 * sizes[:, [0, 2] if kind == "frontal" else [1, 3]].ravel()
        return _Expected(edges - 0.5 * sizes[0, 4], halves)


def _middle(strip: Strip, expected: _Expected) -> Floats:
    """(R,) mm by which the spine's middle lies beside the curve: where both side walls fit best, row after row."""
    halves = np.interp(strip.rows, expected.places, expected.halves)
    shifts = np.arange(-ASIDE, ASIDE + 0.5 * STEP, STEP)
    wall = np.zeros((len(strip.rows), len(shifts)))
    for side in (1, -1):
        wall -= side * strip.sampled(strip.aside, strip.rows[:, None], shifts[None] + side * halves[:, None])
    inside = (strip.rows > -10.0) & (strip.rows < expected.length + 10.0)
    cost = -wall / (np.std(wall) + 1e-9) * inside[:, None] * 0.1 + 0.5 * (shifts / ASIDE) ** 2 * 0.1
    drift = 0.5 * ((shifts[:, None] - shifts[None]) / (ASIDE_DRIFT * 4)) ** 2
    return np.asarray(gaussian_filter1d(shifts[_cheapest(list(cost), [drift] * (len(cost) - 1))], 6.0 / STEP))


def _guides(quad: Floats) -> bool:
    """Whether a box (4, 2), along and beside the curve, lies across the spine; what doesn't stays but guides nobody."""
    upper, lower = quad[0] - quad[1], quad[3] - quad[2]
    across = all(plate[1] > abs(plate[0]) for plate in (upper, lower))
    return across and bool(quad[:2, 0].mean() < quad[2:, 0].mean())


def _endplates(strip: Strip, expected: _Expected, held: Mapping[int, Floats]) -> tuple[Floats, Floats]:
    """Place (2n,) mm and tilt (2n,) rad of every endplate: the cheapest sequence of all."""
    places, tilts = expected.places.copy(), np.zeros(len(expected.places))
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


def _endplate_cost(strip: Strip, expected: _Expected, k: int, s: Floats, a: Floats, target: float) -> Floats:
    """(places, tilts) cost of an endplate: little where grey rises into the bone all along its line."""
    half = INNER * 2.0 * expected.halves[k]
    across = np.linspace(-half, half, 25)
    rise = strip.sampled(
        strip.down, s[:, None, None] + across * np.tan(a)[None, :, None], np.broadcast_to(across, (1, 1, 25))
    ).mean(axis=2)
    rise = rise if k % 2 == 0 else -rise
    sd = END_SD if k in (0, 1, len(expected.places) - 2, len(expected.places) - 1) else PLACE_SD
    prior = 0.5 * ((s - target) / sd)[:, None] ** 2 + 0.5 * (a / TILT_SD)[None] ** 2
    return np.asarray(prior - EDGE * rise / EDGE_UNIT)


def _sequence(expected: _Expected, unary: list[Floats], s: list[Floats], a: list[Floats]) -> tuple[Floats, Floats]:
    """The cheapest (2n,) places and tilts. Steps cost by place and by tilt separately, so each is minimised in turn."""
    total, back = unary[0], []
    for k in range(1, len(unary)):
        gap = expected.places[k] - expected.places[k - 1]
        sd = BODY_SD * gap if k % 2 else DISC_SD * gap + 0.4
        by_tilt = 0.5 * ((a[k][:, None] - a[k - 1][None]) / WEDGE_SD[(k + 1) % 2]) ** 2
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


def _walls(strip: Strip, expected: _Expected, places: Floats, tilts: Floats, held: Mapping[int, Floats]) -> Floats:
    """(2n, 2) mm beside the curve where the endplates end, "first" side and other side."""
    reach = np.arange(-WALL_REACH, WALL_REACH + 0.1, 0.25)
    found = np.zeros((len(places), 2))
    halves = expected.halves
    for _ in range(2):
        for column, side in enumerate((1.0, -1.0)):
            costs, tried = [], []
            for k in range(len(places)):
                here = side * (halves[k] + reach)
                if k // 2 in held:
                    quad = held[k // 2]
                    here = quad[[0, 1] if k % 2 == 0 else [3, 2], 1][column : column + 1]
                    costs.append(np.zeros(1))
                else:
                    costs.append(_wall_cost(strip, places, tilts, k, here, side, halves[k]))
                tried.append(here - side * halves[k])
            steps = [0.5 * ((tried[k][:, None] - tried[k - 1][None]) / WALL_DRIFT) ** 2 for k in range(1, len(places))]
            way = _cheapest(costs, steps)
            found[:, column] = [tried[k][i] + side * halves[k] for k, i in enumerate(way)]
        # The person's own width, over the template's, is one number; with it the walls are looked for again.
        halves = expected.halves * float(np.median((found[:, 0] - found[:, 1]) / (2.0 * expected.halves)))
    return found


def _habit(
    strip: Strip, expected: _Expected, places: Floats, tilts: Floats, walls: Floats, held: Mapping[int, Floats]
) -> tuple[Floats, Floats]:
    """How far beside the edges of the picture somebody sets corners: (2,) mm above and below, (2,) mm on either side.

    The median over the vertebrae that were put right, and less than that where they are few.
    """
    near = np.arange(-HABIT_REACH, HABIT_REACH + 0.1, 0.25)
    ends: list[list[float]] = [[], []]
    sides: list[list[float]] = [[], []]
    for k in (2 * i + j for i in held for j in (0, 1)):
        cost = _endplate_cost(strip, expected, k, places[k] + near, tilts[k : k + 1], places[k])[:, 0]
        ends[k % 2].append(-float(near[cost.argmin()]))
        for column, side in enumerate((1.0, -1.0)):
            here = walls[k, column] + side * near
            cost = _wall_cost(strip, places, tilts, k, here, side, abs(walls[k, column]))
            sides[column].append(-side * float(near[cost.argmin()]))
    trust = len(held) / (len(held) + 1.0)
    return trust * np.median(ends, axis=1), trust * np.median(sides, axis=1)


def _wall_cost(strip: Strip, places: Floats, tilts: Floats, k: int, here: Floats, side: float, half: float) -> Floats:
    """Cost of the end of an endplate: little where grey falls to the outside all along the body's nearer half."""
    other = k + 1 if k % 2 == 0 else k - 1
    share = np.linspace(0.05, 0.5, 10)
    along = (1.0 - share) * places[k] + share * places[other]
    slope = (1.0 - share) * np.tan(tilts[k]) + share * np.tan(tilts[other])
    fall = -side * strip.sampled(
        strip.aside, along + here[:, None] * slope, np.broadcast_to(here[:, None], (len(here), 10))
    )
    prior = 0.5 * ((np.abs(here) - half) / WALL_SD) ** 2
    return np.asarray(prior - WALL * fall.mean(axis=1) / EDGE_UNIT)


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
    outside = (points < -0.5).any(1) | (points[:, 0] > columns - 0.5) | (points[:, 1] > rows - 0.5)
    if outside.any():
        raise TrackingError(f"a point along the spine lies outside the radiograph of {columns} columns, {rows} rows")
    points = points[np.argsort(points @ -up, kind="stable")]
    apart = np.concatenate([[True], np.linalg.norm(np.diff(points, axis=0), axis=1) > NEAREST])
    if apart.sum() < FEWEST_POINTS:
        raise TrackingError(f"{int(apart.sum())} points along the spine, wanted {FEWEST_POINTS} or more, each apart")
    return points[apart]
