"""The skin from the base of the neck to the hips: horizontal superellipses (breadths and depths of real children)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from spinestiff.anatomy.template import sizes
from spinestiff.anatomy.template.girdle import LeftGirdle
from spinestiff.anatomy.template.proportions import Proportions
from spinestiff.anatomy.template.surfaces import Surface, loft, superellipse
from spinestiff.anatomy.template.vertebrae import Spine
from spinestiff.arrays import Floats
from spinestiff.errors import TorsoError
from spinestiff.words import counted

COVER = 5.0  # mm of skin and fat over any bone, at least, times the scale of the spine
# Whose scale a row of the reference skin takes at which height, mm: over the sacral endplate, over the shoulder joint.
_BELOW_CHEST = ((-156.0, "hips"), (-95.0, "hips"), (25.0, "waist"), (112.0, "waist"), (200.0, "chest"))
_FROM_SHOULDER = ((-70.0, "chest"), (-40.0, "shoulder"), (32.0, "shoulder"), (66.0, "neck"))


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


def fitted_skin(
    skin: Skin, spines: tuple[Spine, Spine], girdles: tuple[LeftGirdle, LeftGirdle], size: Proportions
) -> Skin:
    """The reference skin made another body's, row by row.

    Parameters
    ----------
    skin : the reference's.
    spines, girdles : the reference's and the other body's.
    size : the other body over the reference.
    """
    shoulders = [float(girdle.glenohumeral[1]) for girdle in girdles]
    over_shoulder = skin.y - shoulders[0]
    upper = over_shoulder > -93.0
    heights, forward = zip(*(_sagittal_line(spine, scale) for spine, scale in zip(spines, (1.0, size.spine))))
    y = np.where(skin.y < 0.0, size.spine * skin.y, np.interp(skin.y, heights[0], heights[1]))
    y = np.where(upper, shoulders[1] + size.spine * over_shoulder, y)
    if (np.diff(y) <= 0.0).any():
        raise TorsoError("the skin's rows cross each other for this body; its curves and sizes do not go together")
    scale = {"hips": size.hips, "waist": size.waist, "chest": size.chest, "neck": size.neck}
    scale["shoulder"] = (size.shoulder, size.chest[1])

    def at(height: Floats, stops: tuple[tuple[float, str], ...], axis: int) -> Floats:
        return np.asarray(np.interp(height, [h for h, _ in stops], [scale[name][axis] for _, name in stops]))

    across, deep = (
        np.where(upper, at(over_shoulder, _FROM_SHOULDER, axis), at(skin.y, _BELOW_CHEST, axis)) for axis in (0, 1)
    )
    # The back follows the spine; the front of the chest half as much, as the sternum does; the belly does not.
    was = np.where(skin.y > 0.0, np.interp(skin.y, heights[0], forward[0]), 0.0)
    now = np.where(skin.y > 0.0, np.interp(y, heights[1], forward[1]), 0.0)
    return Skin(
        y=y,
        half_width=skin.half_width * across,
        front=skin.front * deep + 0.5 * np.interp(skin.y, [100.0, 200.0], [0.0, 1.0]) * (now - size.spine * was),
        back=skin.back + (now - was) + (was - skin.back) * (1.0 - deep),
        centre=skin.centre * deep + 0.5 * (now - was * deep),
        exponent=skin.exponent,
    )


def _sagittal_line(spine: Spine, scale: float) -> tuple[Floats, Floats]:
    # Heights and forward places of the spine's middle line, from the sacral endplate to the neck.
    y, z = spine.centres[::-1, 1], spine.centres[::-1, 2]
    return np.concatenate([[0.0], y, [y[-1] + 100.0 * scale]]), np.concatenate([[0.0], z, [z[-1]]])


def covering(skin: Skin, bones: Floats, cover: float) -> Skin:
    """The skin moved outwards where points (n, 3) of bones come closer than ``cover`` mm to it.

    Raises
    ------
    TorsoError : bones stay bare.
    """
    for _ in range(40):
        lack = cover - skin.depth(bones)
        short = lack > 0.0
        if not short.any():
            return skin
        points, lack = bones[short], lack[short] + 0.05
        w, front, back, centre, n = skin.row(points[:, 1])
        ahead = points[:, 2] >= centre
        side = (np.abs(points[:, 0]) / w) ** n
        sagittal = (np.abs(points[:, 2] - centre) / np.where(ahead, front - centre, centre - back)) ** n
        share = side / (side + sagittal)
        upper = np.clip(np.searchsorted(skin.y, points[:, 1]), 1, len(skin.y) - 1)
        grow = np.zeros((3, len(skin.y)))
        near = (points[:, 1] - skin.y[upper - 1]) / (skin.y[upper] - skin.y[upper - 1])
        for rows, weight in ((upper - 1, 1.0 - near), (upper, near)):
            wanted = lack * np.clip(2.0 * weight, 0.0, 1.0)  # the nearer of two rows gives way first
            np.maximum.at(grow[0], rows, wanted * share)
            np.maximum.at(grow[1], rows[ahead], (wanted * (1.0 - share))[ahead])
            np.maximum.at(grow[2], rows[~ahead], (wanted * (1.0 - share))[~ahead])
        skin = replace(skin, half_width=skin.half_width + grow[0], front=skin.front + grow[1], back=skin.back - grow[2])
    raise TorsoError(
        f"under the skin of this body, {counted(int(short.sum()), 'point')} of bones less than {cover:.1f} mm deep"
    )
