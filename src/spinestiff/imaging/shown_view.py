"""Whether a radiograph of a trunk looks frontal or lateral: a suggestion, for where nothing states the view.

From the front, spine and mediastinum are a bright band between two darker fields, the lungs. From the side the lungs
lie one behind the other and in front of the spine: right across the trunk the chest is darker than the shoulders above
and the belly below it, most of all in the middle. Both are measured in a small picture of the trunk whose grey values
go from 0 to 1:

- the band, by how much of its brightness is lost on both sides, within ``REACH``, before it is met again at the wall of
  the chest: air beside a trunk is no field;
- the field, by how far the mean of the trunk's middle falls from one row to another and rises again. Where a part
  beside the middle falls as far, it is no field: so it is in a frontal picture whose neck and belly are bright.

Where neither is much larger than the other nothing is suggested: of parts of a trunk, of other parts of the body, and
of lateral views that are cut within the trunk, where the field can't be told from a lung beside the spine.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from spinestiff.arrays import Floats, Ints

Image = NDArray[np.float32]

SIDE = 96
"""Rows and columns of the small picture: a rib cage has some 30 rows even where all from head to knee is seen."""
BLUR = 1.2
"""Standard deviation, columns and rows of the small picture: the mediastinum's border stays, ribs hardly do."""
PERCENTILES = (1.0, 99.0)
"""Grey values that become 0 and 1."""
TRUNK = 0.25
"""Grey value above which a row shows the trunk."""
EVEN, OUTER = 0.05, 0.3
"""Spread over a row or column that shows nothing but black or white (air, a shutter, a collimator's blade), and how far
such ones are looked for from each edge, as a share of the picture."""
JUMP, STRAIGHT = 0.1, 0.7
"""How much darker it is within a collimator's blade, which scattered rays leave uneven, and in which share of rows."""
EDGE, CUT = 3, 0.5
"""Columns at an edge of the small picture, and the share of their rows that show the trunk where the picture cuts it;
shoulders and hips touch an edge in fewer."""
REACH, TALL = 0.2, 0.1
"""How far from the band the fields are looked for, share of the width, and the share of rows that have to show it."""
ALIKE, STEADY, MOST = 0.6, 11.0, 0.7
"""Of all rows that show ``ALIKE`` of what the share of rows does, so many have the band within so many columns of its
middle place, scoliosis included. In patterns that are no trunk, bands are all over the place."""
DARKEST = 0.3
"""Grey values below it count as it where the band's brightness is what a loss is measured by."""
MIDDLE, BESIDE = (-0.2, 0.2), (0.25, 0.4)
"""Where the trunk's middle and the part beside it lie, from its centre, shares of its width."""
WIDE = 0.8
"""How wide the trunk is where a field is, over what it mostly is: a mediastinum between black lungs is narrower."""
BAND_LEAST, BAND_LEAST_CUT, FIELD_LEAST = 0.16, 0.35, 0.2
"""Least size of what is told; of a band where the picture cuts the trunk, since any middle is brighter than what lies
beside it."""
CLEARER, DEEPER = 1.5, 1.25
"""How many times larger than the other it has to be, and a field than what falls beside the middle."""


@dataclass(frozen=True)
class ShownView:
    """What a radiograph looks like.

    Attributes
    ----------
    view : "frontal" or "lateral".
    why : what was seen, in words.
    """

    view: Literal["frontal", "lateral"]
    why: str

    @property
    def words(self) -> str:
        return f"looks like a {self.view} view: {self.why}"


def shown_view(pixels: ArrayLike) -> ShownView | None:
    """Whether a radiograph (H, W), bone bright, looks frontal or lateral; None: neither is clear.

    The picture is upright, in any grey values that grow with what the beam went through.
    """
    trunk = _trunk(np.asarray(pixels, dtype=np.float32))
    if min(trunk.shape) < 2:
        return None
    small = np.asarray(cv2.resize(trunk, (SIDE, SIDE), interpolation=cv2.INTER_AREA), dtype=np.float32)
    small = np.asarray(cv2.GaussianBlur(small, (0, 0), BLUR, borderType=cv2.BORDER_REPLICATE), dtype=np.float32)
    cut = [float(np.mean(edge.mean(axis=1) > TRUNK)) > CUT for edge in (small[:, :EDGE], small[:, -EDGE:])]
    band, field = _band(small, cut), _field(small)
    if band >= (BAND_LEAST_CUT if any(cut) else BAND_LEAST) and band >= CLEARER * field:
        return ShownView("frontal", f"a bright band between two fields that are {_percent(band)} darker")
    if field >= FIELD_LEAST and field >= CLEARER * band and not any(cut):
        return ShownView("lateral", f"one field across the trunk, darker by {_percent(field)} of the contrast")
    return None


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"


def _trunk(pixels: Image) -> Image:
    """The picture without what shows nothing at its edges, from 0 to 1, at most some times finer than needed."""
    factor = max(1, min(pixels.shape) // (2 * SIDE))
    rows, columns = (max(1, n // factor) for n in pixels.shape)
    found = np.asarray(cv2.resize(pixels, (columns, rows), interpolation=cv2.INTER_AREA), dtype=np.float32)
    # Bright blades leave little contrast for the trunk, so that what lies inside them is looked at once more.
    for _ in range(2):
        if not found.size:
            break
        low, high = np.percentile(found, PERCENTILES)
        found = np.clip((found - low) / max(float(high - low), 1e-6), 0.0, 1.0)
        for _ in range(2):
            found = _without_empty_columns(found).T
    return found


def _without_empty_columns(picture: Image) -> Image:
    count, mean = picture.shape[1], picture.mean(axis=0)
    if count < 3:
        return picture
    empty = (picture.std(axis=0) < EVEN) & ((mean < TRUNK) | (mean > 1.0 - EVEN))
    step = np.pad(picture[:, 2:] - picture[:, :-2], ((0, 0), (1, 1)))
    outer = int(OUTER * count)
    left = np.flatnonzero((empty | (np.mean(step < -JUMP, axis=0) > STRAIGHT))[:outer])
    right = np.flatnonzero((empty | (np.mean(step > JUMP, axis=0) > STRAIGHT))[count - outer :])
    return picture[:, left[-1] + 1 if left.size else 0 : count - outer + right[0] if right.size else count]


def _band(small: Image, cut: list[bool]) -> float:
    """How much of its brightness a band loses on both sides, in the rows where it is most so; 0: all over the place."""
    # The wall that a field has on its outer side; beyond a cut there may be one.
    wall = [np.maximum.accumulate(small, axis=1), np.maximum.accumulate(small[:, ::-1], axis=1)[:, ::-1]]
    wall = [np.full_like(small, np.inf) if beyond else found for found, beyond in zip(wall, cut)]
    reach, band = int(REACH * SIDE), np.zeros_like(small)
    for column in range(SIDE // 8, SIDE - SIDE // 8):
        here = small[:, column]
        sides = (slice(max(0, column - reach), column), slice(column + 1, column + 1 + reach))
        lost = [
            (np.minimum(outer[:, side], here[:, None]) - small[:, side]).max(axis=1) for outer, side in zip(wall, sides)
        ]
        band[:, column] = np.minimum(*lost) / np.maximum(here, DARKEST)
    most, place = band.max(axis=1), band.argmax(axis=1)
    told = float(np.quantile(most, 1.0 - TALL))
    places = place[most >= ALIKE * told]
    return told if np.quantile(np.abs(places - np.median(places)), MOST) <= STEADY else 0.0


def _field(small: Image) -> float:
    """How much darker than something above and below it the trunk's middle is where it is most so; 0: no more than a
    part beside it, or what looks like the trunk is narrow there."""
    first, last = _ends(small)
    middle, *beside = (_mean_of(small, first, last, part) for part in (MIDDLE, BESIDE, (-BESIDE[1], -BESIDE[0])))
    falls, width = _falls(middle), last - first
    row = int(falls.argmax())
    deep = max(float(_falls(part)[row]) for part in beside)
    is_field = falls[row] >= DEEPER * deep and width[row] >= WIDE * np.median(width)
    return float(falls[row]) if is_field else 0.0


def _falls(values: Floats) -> Floats:
    """How far below the largest value before it, and the largest after it, each value lies, whichever is less."""
    before, after = np.maximum.accumulate(values), np.maximum.accumulate(values[::-1])[::-1]
    return np.asarray(np.minimum(before, after) - values)


def _ends(small: Image) -> tuple[Ints, Ints]:
    """(SIDE,) first and last column of the trunk in each row; both 0 in rows that show hardly any."""
    shown = small > TRUNK
    some = shown.sum(axis=1) >= SIDE // 8
    return np.where(some, shown.argmax(axis=1), 0), np.where(some, SIDE - 1 - shown[:, ::-1].argmax(axis=1), 0)


def _mean_of(small: Image, first: Ints, last: Ints, part: tuple[float, float]) -> Floats:
    """(SIDE,) mean grey value by row of a part of the trunk, which its width and its centre place."""
    ends = 0.5 * (first + last)[:, None] + np.array(part) * (last - first)[:, None]
    return np.array([row[int(low) : int(high) + 1].mean() for row, (low, high) in zip(small, ends)])
