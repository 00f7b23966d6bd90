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
from scipy.interpolate import CubicSpline

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.template.sizes import VERTEBRA_SIZES
from spinestiff.arrays import Floats
from spinestiff.errors import TrackingError
from spinestiff.imaging.features import picture_axes, view_kind
from spinestiff.imaging.radiograph import Radiograph

FEWEST_POINTS = 3
# Points nearer than this, pixels, are one.
NEAREST = 2.0


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
    kept = {name: np.asarray(quad, dtype=float) for name, quad in (kept or {}).items() if name in vertebrae}
    first, up = picture_axes(radiograph.view)
    curve = _Curve.through(_checked(radiograph, points, up), first)
    expected = _Expected.of(vertebrae, "lateral" if view_kind(radiograph.view) == "lateral" else "frontal")
    mm = curve.length / (expected.centres[-1] - expected.centres[0])
    boxes = []
    for centre, height, width in zip(expected.centres - expected.centres[0], expected.heights, expected.widths):
        along = centre * mm
        boxes.append(
            [
                curve.at(along + sign * 0.5 * height * mm, side * 0.5 * w * mm)
                for sign, side, w in ((-1, 1, width[0]), (-1, -1, width[0]), (1, -1, width[1]), (1, 1, width[1]))
            ]
        )
    found = np.array(boxes)
    for i, name in enumerate(vertebrae):
        if name in kept:
            found[i] = kept[name]
    return found


@dataclass(frozen=True)
class _Expected:
    """What anatomy expects of n vertebrae, in mm of the template.

    Attributes
    ----------
    centres : (n,) along the spine. heights : (n,). widths : (n, 2) above and below, as seen in the view.
    """

    centres: Floats
    heights: Floats
    widths: Floats

    @staticmethod
    def of(vertebrae: Sequence[str], kind: str) -> _Expected:
        rows = [VERTEBRAE.index(name) for name in vertebrae if name in VERTEBRAE]
        if len(rows) != len(vertebrae) or len(rows) < 2 or (np.diff(rows) != 1).any():
            raise TrackingError(f"can't propose {', '.join(vertebrae) or 'nothing'}; wanted two or more neighbours")
        sizes = VERTEBRA_SIZES[rows]
        heights, discs = sizes[:, 4], sizes[:, 5]
        tops = np.concatenate([[0.0], np.cumsum(heights + discs)[:-1]])
        return _Expected(tops + 0.5 * heights, heights, sizes[:, [0, 2]] if kind == "frontal" else sizes[:, [1, 3]])


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
        fine = rough(np.linspace(0.0, chords[-1], 400))
        lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(fine, axis=0), axis=1))])
        return _Curve(CubicSpline(lengths, fine, bc_type="natural"), float(lengths[-1]), first)

    def at(self, along: Floats | float, aside: Floats | float) -> Floats:
        """Pixels at a length along the curve and a distance to the "first" side of it; broadcast, (..., 2)."""
        along, aside = np.broadcast_arrays(np.asarray(along, dtype=float), np.asarray(aside, dtype=float))
        inside = np.clip(along, 0.0, self.length)
        tangent = self.spline(inside, 1)
        tangent = tangent / np.linalg.norm(tangent, axis=-1, keepdims=True)
        normal = np.stack([tangent[..., 1], -tangent[..., 0]], axis=-1)
        normal = np.where((normal @ self.first > 0.0)[..., None], normal, -normal)
        return np.asarray(self.spline(inside) + (along - inside)[..., None] * tangent + aside[..., None] * normal)


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
