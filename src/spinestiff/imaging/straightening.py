"""A radiograph straightened along a spine: a curve through points, and the picture's edges along and beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from spinestiff.arrays import Floats

STEP = 0.5
"""Of a strip, along and beside the spine, in the unit that its scale makes of pixels (mm of the template)."""
MARGIN_ALONG, MARGIN_ASIDE = 30.0, 34.0
# Standard deviations: smoothing of what is looked at, and the shading taken off it.
SMOOTH, SHADING = 0.9, 9.0


@dataclass(frozen=True)
class SpineCurve:
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
    def through(points: Floats, first: Floats) -> SpineCurve:
        """Through points (n, 2), n at least 3, in order."""
        chords = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        rough = CubicSpline(chords, points, bc_type="natural")
        fine = rough(np.linspace(0.0, chords[-1], 200))
        lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(fine, axis=0), axis=1))])
        return SpineCurve(CubicSpline(lengths, fine, bc_type="natural"), float(lengths[-1]), first)

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

    def beside(self, along: Floats, aside: Floats) -> SpineCurve:
        """The curve that runs at these distances beside this one, between the same ends."""
        chosen = np.linspace(0.0, self.length, 60)
        return SpineCurve.through(self.at(chosen, np.interp(chosen, along, aside)), self.first)

    def coordinates(self, pixels: Floats) -> Floats:
        """(n, 2) length along and distance beside of pixels (n, 2): the inverse of ``at`` near the curve."""
        along = np.linspace(-0.15 * self.length, 1.15 * self.length, 4000)
        line = self.at(along, np.zeros(1))
        nearest = along[np.argmin(np.linalg.norm(pixels[:, None] - line, axis=2), axis=1)]
        tangent, normal = self._frame(np.clip(nearest, 0.0, self.length))
        away = pixels - self.at(nearest, np.zeros(1))
        return np.stack([nearest + np.sum(away * tangent, axis=1), np.sum(away * normal, axis=1)], axis=1)


@dataclass(frozen=True)
class Strip:
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
    def along(pixels: NDArray[np.float32], curve: SpineCurve, scale: float, length: float) -> Strip:
        """Of a picture (H, W); ``scale`` is pixels a mm, ``length`` mm from the curve's start to its end."""
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
        return Strip(rows, columns, down, aside)

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
