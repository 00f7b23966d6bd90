"""How odd is a row of vertebrae, and how must each vertebra's corners be turned to make it least odd?

Every measure compares a vertebra with what its neighbours foretell, in units of the oddest vertebra of 452 labelled
spines (7,684 vertebrae). docs/cobb.md has the measures, the limits and how often sound and spoiled spines exceed them.
All corners are (V, 4, 2), clockwise from the top left as seen, rows growing downwards; ``places`` (V,) are the
vertebrae's places in ``anatomy.names.VERTEBRAE``, increasing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from spinestiff.arrays import Floats
from spinestiff.imaging.planar import cross

Measure = Literal["sideways", "along", "turned", "wide", "high", "wedged"]
ODDEST: dict[Measure, float] = {
    "sideways": 0.28,  # widths
    "along": 0.30,  # distances between neighbouring levels
    "turned": 13.0,  # degrees
    "wide": 0.35,  # natural logarithm of the ratio
    "high": 0.9,  # natural logarithm of the ratio; one L5 lies far beyond
    "wedged": 29.0,  # degrees
}
"""The largest value of each measure among the sound spines, rounded; of the heights the largest but one."""
ODDEST_STEP_DEG = 33.0
"""Largest difference in tilt of two neighbouring levels among them."""
ODDEST_LEAN_DEG = 42.0
"""Largest angle between a vertebra's own axis and the spine's among them."""
MOST_OF_A_LEAN = 2.0
"""Limit of a lean's share: the spine's axis goes wrong where a neighbour is out of place."""
CHANGED = 1.0
"""What changing a vertebra's corners counts: as much as one step as large as the largest of the sound spines."""

CLEARLY = 4.0
"""By how much the next best order of a vertebra's corners must be odder for its own to be known: by two steps in tilt
that are 1.4 times the largest of sound spines. The least of any vertebra in the 452 sound spines is 5.9."""


@dataclass(frozen=True)
class Oddity:
    """A vertebra that does not look like what its neighbours foretell.

    Attributes
    ----------
    row : of the vertebra.
    measure : which one.
    ratio : how large the measure is over that of the oddest vertebra of the sound spines.
    words : what is odd, to stand behind the vertebra's name.
    """

    row: int
    measure: Measure
    ratio: float
    words: str


def oddities(corners: Floats, places: Sequence[int]) -> tuple[Oddity, ...]:
    """Every vertebra's measures, the oddest first.

    The neighbours are the nearest two to either side. A polynomial through them, exact for each, foretells middle, tilt
    and log width; such a forecast has weights c and is as uncertain as sqrt(1 + |c|^2) of one vertebra's own value,
    by which a difference is divided. Heights are compared with the neighbours' mean. Wedging needs no neighbour.
    """
    at = np.asarray(places, dtype=float)
    middles, tilts, (widths, heights), wedges = corners.mean(axis=1), _tilts(corners), sizes(corners), wedging(corners)
    found = []
    for i in range(len(corners)):
        near = [j for j in (i - 2, i - 1, i + 1, i + 2) if 0 <= j < len(corners)]
        weights = _interpolation(at[near], at[i])
        spread = float(np.sqrt(1.0 + weights @ weights))
        wide = float(np.log(widths[i]) - weights @ np.log(widths[near]))
        high = float(np.log(heights[i]) - np.log(heights[near]).mean())
        values: dict[Measure, tuple[float, str]] = {
            "wide": (wide / spread, f"is {np.exp(wide):.2g} times as wide as its neighbours foretell"),
            "high": (high, f"is {np.exp(high):.2g} times as high as its neighbours"),
            "wedged": (float(wedges[i]), f"is wedged by {abs(wedges[i]):.0f} degrees"),
        }
        if len(near) > 1:
            axis = middles[near[-1]] - middles[near[0]]
            step = float(np.hypot(*axis)) / (at[near[-1]] - at[near[0]])
            off = middles[i] - weights @ middles[near]
            aside = float(cross(axis, off) / np.hypot(*axis) / widths[near].mean())
            down = float(axis @ off / np.hypot(*axis) / step)
            turned = float(np.degrees(tilts[i] - weights @ tilts[near]))
            where = "below" if down > 0.0 else "above"
            values |= {
                "sideways": (aside / spread, f"lies {abs(aside):.2f} widths beside its neighbours' line"),
                "along": (down / spread, f"lies {abs(down):.2f} level distances {where} where its neighbours foretell"),
                "turned": (turned / spread, f"is turned by {abs(turned):.0f} degrees against its neighbours"),
            }
        found += [Oddity(i, name, abs(value) / ODDEST[name], words) for name, (value, words) in values.items()]
    return tuple(sorted(found, key=lambda odd: -odd.ratio))


@dataclass(frozen=True)
class QuarterTurns:
    """By how many places each vertebra's corners must be moved on to make the spine least odd.

    Attributes
    ----------
    turns : (V,) 0 to 3; ``numpy.roll(quad, -turns)`` begins at the top left.
    ahead : (V,) how much odder the spine is, at least, with this vertebra's corners in any other order.
    """

    turns: np.ndarray
    ahead: Floats


def quarter_turns(corners: Floats, places: Sequence[int], given: Sequence[bool]) -> QuarterTurns:
    """The most plausible top-left corner of each vertebra, its neighbours' tilts and the spine's axis considered.

    Of all 4^V choices that with the least sum over vertebrae of (angle between own and spine's axis / 42 deg)^2, 2 at
    most, and 1 where corners are changed, and over neighbours of (difference in tilt / 33 deg)^2. As the sum runs over
    a chain, its minimum, and that with one vertebra's choice held, follow exactly from one sweep each way.

    Parameters
    ----------
    corners : of two vertebrae or more, each clockwise and convex, begun at any corner.
    given : (V,) whether a vertebra's corners are in the order in which they were given; changing others counts nothing.
    """
    quarters = 0.5 * np.pi * np.arange(4)
    # Begun at the k-th corner, what was the side to the right of the top left leads the way: k quarter turns clockwise.
    tilts = _tilts(corners)[:, None] + quarters
    axes = spine_axes(corners)
    lean = _wrapped(tilts - np.arctan2(axes[:, 1], axes[:, 0])[:, None] + 0.5 * np.pi)
    cost = np.minimum((np.degrees(lean) / ODDEST_LEAN_DEG) ** 2, MOST_OF_A_LEAN)
    cost[:, 1:] += CHANGED * np.asarray(given, dtype=float)[:, None]
    steps = np.degrees(_wrapped(tilts[1:, None, :] - tilts[:-1, :, None]))
    # Levels that are missing in between make the tilts less alike; from 45 degrees on a quarter turn can't be told.
    most = np.minimum(ODDEST_STEP_DEG * np.diff(np.asarray(places, dtype=float)), 45.0)
    steps = (steps / most[:, None, None]) ** 2
    down, up = np.zeros_like(cost), np.zeros_like(cost)
    for i in range(1, len(cost)):
        down[i] = ((down[i - 1] + cost[i - 1])[:, None] + steps[i - 1]).min(axis=0)
        j = len(cost) - 1 - i
        up[j] = ((up[j + 1] + cost[j + 1])[None, :] + steps[j]).min(axis=1)
    total = down + cost + up
    ranked = np.sort(total, axis=1)
    return QuarterTurns(total.argmin(axis=1), ranked[:, 1] - ranked[:, 0])


def spine_axes(corners: Floats) -> Floats:
    """(V, 2) from head to foot along the spine at each vertebra, from the two neighbours to either side."""
    middles = corners.mean(axis=1)
    each = np.arange(len(middles))
    return np.asarray(middles[np.minimum(each + 2, each[-1])] - middles[np.maximum(each - 2, 0)])


def sizes(corners: Floats) -> tuple[Floats, Floats]:
    """(V,) width and height of each vertebra, between the middles of its sides."""
    down = 0.5 * (corners[:, 2] + corners[:, 3] - corners[:, 0] - corners[:, 1])
    return np.hypot(*across(corners).T), np.hypot(*down.T)


def wedging(corners: Floats) -> Floats:
    """(...) degrees from the upper to the lower endplate, clockwise as seen, of corners (..., 4, 2)."""
    top, bottom = corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 3, :]
    return np.asarray(np.degrees(np.arctan2(cross(top, bottom), np.sum(top * bottom, axis=-1))))


def across(corners: Floats) -> Floats:
    """(..., 2) from the middle of the left side to that of the right one."""
    return np.asarray(0.5 * (corners[..., 1, :] + corners[..., 2, :] - corners[..., 0, :] - corners[..., 3, :]))


def _tilts(corners: Floats) -> Floats:
    """(V,) rad, of the line across each vertebra, clockwise as seen, without jumps of a full turn."""
    line = across(corners)
    return np.unwrap(np.arctan2(line[:, 1], line[:, 0]))


def _interpolation(at: Floats, wanted: float) -> Floats:
    """Weights of values at places ``at`` that give the polynomial through them at the place ``wanted``."""
    return np.array([np.prod((wanted - np.delete(at, j)) / (at[j] - np.delete(at, j))) for j in range(len(at))])


def _wrapped(angle: Floats) -> Floats:
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)
