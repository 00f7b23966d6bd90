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
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.template.sizes import VERTEBRA_SIZES
from spinestiff.arrays import Floats
from spinestiff.errors import TrackingError
from spinestiff.imaging.features import picture_axes, view_kind
from spinestiff.imaging.radiograph import Radiograph

FEWEST_POINTS = 3
# Points nearer than this, pixels, are one.
NEAREST = 2.0
# All lengths below are mm of the template's spine: the person's size has been taken out by then.
STEP = 0.5
MARGIN_ALONG, MARGIN_ASIDE = 30.0, 34.0
# Standard deviations: smoothing of what is looked at, and the shading taken off it.
SMOOTH, SHADING = 0.9, 9.0
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
    kept : boxes (4, 2) that stay as they are and guide the others.

    Raises
    ------
    TrackingError : too few points, points outside the radiograph, fewer than two vertebrae, names out of order.
    """
    first, up = picture_axes(radiograph.view)
    expected = _Expected.of(vertebrae, view_kind(radiograph.view))
    curve = _Curve.through(_checked(radiograph, points, up), first)
    scale = curve.length / expected.length
    strip = _Strip.along(radiograph.pixels, curve, scale, expected.length)
    curve = curve.beside(strip.rows * scale, _middle(strip, expected) * scale)
    scale = curve.length / expected.length
    strip = _Strip.along(radiograph.pixels, curve, scale, expected.length)
    held = {
        list(vertebrae).index(name): curve.coordinates(np.asarray(quad, dtype=float)) / scale
        for name, quad in (kept or {}).items()
        if name in vertebrae
    }
    places, tilts = _endplates(strip, expected, held)
    walls = _walls(strip, expected, places, tilts, held)
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


@dataclass(frozen=True)
class _Curve:
    """A smooth curve down the spine by its length, in pixels, and beyond its ends in a straight line.

    Attributes
    ----------
    spline : (length) to (column, row).
    length : from the first to the last point.
    first : (2,) the direction that is "first" in the picture.
    """

    spline: CubicSpline
    length: float
    first: Floats

    @staticmethod
    def through(points: Floats, first: Floats) -> _Curve:
        chords = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        rough = CubicSpline(chords, points, bc_type="natural")
        fine = rough(np.linspace(0.0, chords[-1], 200))
        lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(fine, axis=0), axis=1))])
        return _Curve(CubicSpline(lengths, fine, bc_type="natural"), float(lengths[-1]), first)

    def at(self, along: Floats, aside: Floats) -> Floats:
        """Pixels at a length along the curve and a distance to the "first" side of it; broadcast, (..., 2)."""
        along, aside = np.broadcast_arrays(np.asarray(along, dtype=float), np.asarray(aside, dtype=float))
        inside = np.clip(along, 0.0, self.length)
        tangent, normal = self._frame(inside)
        return np.asarray(self.spline(inside) + (along - inside)[..., None] * tangent + aside[..., None] * normal)

    def _frame(self, along: Floats) -> tuple[Floats, Floats]:
        tangent = self.spline(along, 1)
        tangent = tangent / np.linalg.norm(tangent, axis=-1, keepdims=True)
        normal = np.stack([tangent[..., 1], -tangent[..., 0]], axis=-1)
        return tangent, np.where((normal @ self.first > 0.0)[..., None], normal, -normal)

    def beside(self, along: Floats, aside: Floats) -> _Curve:
        """The curve that runs at these distances beside this one, between the same ends."""
        chosen = np.linspace(0.0, self.length, 60)
        return _Curve.through(self.at(chosen, np.interp(chosen, along, aside)), self.first)

    def coordinates(self, pixels: Floats) -> Floats:
        """(n, 2) length along and distance beside of pixels (n, 2): the inverse of ``at`` near the curve."""
        along = np.linspace(-0.15 * self.length, 1.15 * self.length, 4000)
        line = self.at(along, np.zeros(1))
        nearest = along[np.argmin(np.linalg.norm(pixels[:, None] - line, axis=2), axis=1)]
        tangent, normal = self._frame(np.clip(nearest, 0.0, self.length))
        away = pixels - self.at(nearest, np.zeros(1))
        return np.stack([nearest + np.sum(away * tangent, axis=1), np.sum(away * normal, axis=1)], axis=1)


@dataclass(frozen=True)
class _Strip:
    """The picture straightened along a curve: contrast alone, in units of its own local standard deviation.

    Attributes
    ----------
    rows : (R,) mm along the spine. columns : (C,) mm beside it, growing to "first".
    down, aside : (R, C) change of grey a mm along the spine, and towards "first".
    """

    rows: Floats
    columns: Floats
    down: Floats
    aside: Floats

    @staticmethod
    def along(pixels: NDArray[np.float32], curve: _Curve, scale: float, length: float) -> _Strip:
        import cv2

        rows = np.arange(-MARGIN_ALONG, length + MARGIN_ALONG, STEP)
        columns = np.arange(-MARGIN_ASIDE, MARGIN_ASIDE + 0.5 * STEP, STEP)
        where = curve.at(rows[:, None] * scale, columns[None] * scale).astype(np.float32)
        # Where the strip's step is coarser than a pixel, pixels in between have to count, too.
        blurred = cv2.GaussianBlur(pixels, (0, 0), max(0.3, 0.5 * STEP * scale))
        grey = cv2.remap(blurred, where[..., 0], where[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        flat = grey - cv2.GaussianBlur(grey, (0, 0), SHADING / STEP)
        spread = np.sqrt(cv2.GaussianBlur(flat**2, (0, 0), SHADING / STEP)) + 1e-3 * float(np.std(grey)) + 1e-9
        smooth = cv2.GaussianBlur(flat / spread, (0, 0), SMOOTH / STEP)
        down, aside = np.gradient(smooth, STEP)
        return _Strip(rows, columns, down, aside)

    def sampled(self, values: Floats, along: Floats, aside: Floats) -> Floats:
        """``values`` at places; broadcast, the border's beyond it."""
        import cv2

        along, aside = np.broadcast_arrays(along, aside)
        shape = along.shape
        y = ((along - self.rows[0]) / STEP).astype(np.float32).reshape(-1, shape[-1])
        x = ((aside - self.columns[0]) / STEP).astype(np.float32).reshape(-1, shape[-1])
        found = [
            cv2.remap(values.astype(np.float32), x[i : i + 20000], y[i : i + 20000], cv2.INTER_LINEAR,
                      borderMode=cv2.BORDER_REPLICATE)
            for i in range(0, len(x), 20000)
        ]  # fmt: skip
        return np.asarray(np.concatenate(found).reshape(shape), dtype=np.float64)


def _middle(strip: _Strip, expected: _Expected) -> Floats:
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


def _endplates(strip: _Strip, expected: _Expected, held: Mapping[int, Floats]) -> tuple[Floats, Floats]:
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


def _endplate_cost(strip: _Strip, expected: _Expected, k: int, s: Floats, a: Floats, target: float) -> Floats:
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


def _walls(strip: _Strip, expected: _Expected, places: Floats, tilts: Floats, held: Mapping[int, Floats]) -> Floats:
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


def _wall_cost(strip: _Strip, places: Floats, tilts: Floats, k: int, here: Floats, side: float, half: float) -> Floats:
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
