"""The skin from the base of the neck to the hips: horizontal superellipses (breadths and depths of real children)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.template import sizes
from spinestiff.anatomy.template.girdle import LeftGirdle
from spinestiff.anatomy.template.surfaces import Surface, loft, superellipse
from spinestiff.anatomy.template.vertebrae import Spine
from spinestiff.arrays import Floats


@dataclass(frozen=True)
class Skin:
    """Rows of the skin, world mm, bottom first.

    Attributes
    ----------
    y : (R,) height of the row.
    half_width, front, back : (R,) where the row ends at x, and at +z and -z in the middle plane.
    centre : (R,) z of the row's widest point.
    exponent : (R,) of the superellipse.
    """

    y: Floats
    half_width: Floats
    front: Floats
    back: Floats
    centre: Floats
    exponent: Floats

    def row(self, y: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """Half width, front, back, centre and exponent at heights ``y``, by monotone cubics."""
        from scipy.interpolate import PchipInterpolator

        y = np.clip(y, self.y[0], self.y[-1])
        columns = (self.half_width, self.front, self.back, self.centre, self.exponent)
        w, f, b, c, n = (PchipInterpolator(self.y, column)(y) for column in columns)
        return w, f, b, c, n

    def depth(self, points: Floats) -> Floats:
        """Signed depth under the skin of points (..., 3), mm, first order; negative outside, floor and lid included."""
        x, y, z = np.moveaxis(np.asarray(points), -1, 0)
        w, f, b, c, n = self.row(y)
        d = np.where(z >= c, f - c, c - b)
        r = ((np.abs(x) / w) ** n + (np.abs(z - c) / d) ** n) ** (1.0 / n)
        radial = np.hypot(x, z - c)
        # Distance along the ray from the row's centre.
        reach = np.where(r > 1e-9, radial / np.maximum(r, 1e-9) * (1.0 - r), np.minimum(w, d))
        return np.minimum(reach, np.minimum(y - self.y[0], self.y[-1] - y))

    def ring(self, y: float, sides: int) -> Floats:
        """(sides, 3) points of the row at height ``y``."""
        w, f, b, c, n = (float(v) for v in self.row(np.array(y)))
        x, z = superellipse(w, f - c, c - b, n, sides).T
        return np.stack([x, np.full(sides, y), z + c], -1)

    def surface(self, rows: int = 40, sides: int = 48) -> Surface:
        """The closed skin as triangles."""
        return loft(np.array([self.ring(y, sides) for y in np.linspace(self.y[0], self.y[-1], rows)]))


def build_skin(spine: Spine, girdle: LeftGirdle) -> Skin:
    """The reference skin."""
    shoulder = girdle.glenohumeral
    y = spine.centres[:, 1]
    half_shoulder = shoulder[0] + 0.5 * sizes.HUMERAL_HEAD + 13.0
    waist = 0.5 * sizes.WAIST[0]
    z = spine.centres[:, 2]
    rows = [
        # y, half width, front, back, centre, exponent
        (-156.0, 152.0, 76.0, -110.0, -16.0, 2.5),
        (-140.0, 155.0, 82.0, -113.0, -16.0, 2.5),  # hips: bitrochanteric 31 cm (ANSUR shape, scaled)
        (-95.0, 153.0, 92.0, -113.0, -12.0, 2.5),
        (-20.0, 145.0, 98.0, -106.0, -4.0, 2.6),
        (30.0, 138.0, 99.0, -92.0, 2.0, 2.6),  # iliac crests, bi-iliac 26.6 cm
        (y[14], waist, 100.0, z[14] - 74.0, 6.0, 2.5),  # waist, L3
        (y[11], 130.0, 114.0, z[11] - 78.0, 8.0, 2.6),
        (y[8], 134.5, 117.0, z[8] - 80.0, 8.0, 2.6),
        (shoulder[1] - 92.0, 136.0, 115.0, -90.0, 6.0, 2.6),  # chest
        (shoulder[1] - 76.0, 138.5, 113.0, -89.0, 4.0, 2.6),  # axilla
        (shoulder[1] - 62.0, 146.0, 110.0, -87.0, 2.0, 2.6),
        (shoulder[1] - 46.0, 160.0, 107.0, -85.0, 0.0, 2.6),
        (shoulder[1] - 26.0, half_shoulder - 8.0, 103.0, -81.0, -2.0, 2.6),  # the cut through the arm's root
        (shoulder[1] - 6.0, half_shoulder, 97.0, -74.5, 0.0, 2.7),
        (shoulder[1] + 8.0, half_shoulder, 94.0, -68.5, 2.0, 2.7),
        (shoulder[1] + 22.0, half_shoulder - 4.0, 91.0, -61.5, 4.0, 2.7),
        (shoulder[1] + 32.0, half_shoulder - 12.0, 88.0, -56.0, 6.0, 2.6),  # over the acromion
        (shoulder[1] + 38.0, 155.0, 86.5, -52.5, 8.0, 2.5),  # from here the slope of trapezius, 20 degrees
        (shoulder[1] + 46.0, 128.0, 84.5, -48.0, 10.0, 2.4),
        (shoulder[1] + 55.0, 100.0, 82.0, -43.5, 12.0, 2.3),
        (shoulder[1] + 64.0, 76.0, 80.0, -40.0, 15.0, 2.2),
        (shoulder[1] + 72.0, 62.0, 78.0, -37.0, 17.0, 2.2),
        (shoulder[1] + 78.0, 56.0, 77.0, -35.0, 18.0, 2.2),  # base of the neck
    ]
    columns = np.array(sorted(rows), dtype=float).T
    return Skin(*columns)
