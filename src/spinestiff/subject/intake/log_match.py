"""When a gauge's log began, against the radiographs: found from how the picture moves, with its uncertainty.

The clocks of a gauge and of an X-ray unit differ. At the right offset the motion of the picture is a smooth function of
the force, so each offset is judged by how far the motion lies from the best such function. Offsets that explain the
motion as well as the best one, at 95 %, are possible; what force they give each frame says whether that is enough.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import f as f_distribution

from spinestiff.arrays import Floats
from spinestiff.subject.intake.force_log import ForceLog

FEWEST_FRAMES = 4
"""Fewer leave nothing over beside a line and an offset."""
QUADRATIC_FROM = 8
"""Frames from which on the motion may bend with the force, as that of a stiffening trunk does."""
LEVEL_OF_POSSIBLE = 0.95
UNLIKE = 0.02
"""Of the largest motion: no motion follows the force better, since tissue creeps and people breathe."""
LEAST_EXPLAINED = 0.8
"""Of the motion's variance, by the force."""
MOST_OFFSETS = 4000
LAG_S = 0.1
"""At either end of the interval: the motion of a trunk that creeps by a tenth within a second lags so far behind."""
ENOUGH_N, ENOUGH = 5.0, 0.1
"""A frame's force is known well enough within so many N, or this share of the largest."""
MOST_OPEN, SURE_FORCE = 0.1, 0.5
"""One frame, or so many of all, may stay open alone, where another is sure of this share of the log's largest force."""
LEAST_RISE_N = 2.0
"""A log that changes less shows no push."""
LEAST_MOTION_PX = 0.5
MOST_ALIKE = 0.8
"""Of neighbouring residuals, as a correlation."""


@dataclass(frozen=True)
class LogMatch:
    """A log beside a push's frames.

    Attributes
    ----------
    offset_s : time of the log at the first frame. low_s, high_s : its 95 % interval.
    determined : whether it is known well enough for the forces.
    why : it is not, in words; empty if it is.
    explained : share of the motion's variance that the force explains.
    forces_n : (F,) at the frames; NaN where the log tells none (``ForceLog.told``), or the offset leaves it open.
    forces_low_n, forces_high_n : (F,) over the interval.
    given : the offset is the user's. against : how the motion contradicts it, in words; empty if it does not.
    uncertain : frames whose force the offset leaves open, where it is determined for most others.
    """

    offset_s: float
    low_s: float
    high_s: float
    determined: bool
    why: str
    explained: float
    forces_n: Floats
    forces_low_n: Floats
    forces_high_n: Floats
    given: bool = False
    against: str = ""
    uncertain: tuple[int, ...] = ()

    @property
    def open_n(self) -> float:
        """By how much the offset leaves a frame's force open either way, N, at most, but for ``uncertain`` ones."""
        return 0.5 * float(np.delete(self.forces_high_n - self.forces_low_n, self.uncertain).max())


def match_log(log: ForceLog, times_s: Floats, motion: Floats) -> LogMatch:
    """The offset of a log.

    Parameters
    ----------
    times_s : (F,) of the frames since the first, growing.
    motion : (F,) of the picture since the first frame, of any sign and unit (``imaging.motion``), pixels.
    """
    offsets = _offsets(log, times_s)
    if offsets is None:
        took, lasts = times_s[-1] - times_s[0], log.times_s[-1] - log.times_s[0]
        return _unknown(log, times_s, f"the log lasts {lasts:.1f} s, the frames {took:.1f} s")
    rise = float(np.ptp(log.forces_n))
    if rise < LEAST_RISE_N:
        return _unknown(log, times_s, f"the log's force changes by {rise:.1f} N only")
    if len(times_s) < FEWEST_FRAMES:
        return _unknown(log, times_s, f"{len(times_s)} frames are too few, wanted {FEWEST_FRAMES} or more")
    if np.ptp(motion) < LEAST_MOTION_PX:
        return _unknown(log, times_s, f"the picture moves by {np.ptp(motion):.2f} pixels only")
    degree = 2 if len(times_s) >= QUADRATIC_FROM else 1
    squares = np.array([_left_over(log.at(times_s + offset), motion, degree)[0] for offset in offsets])
    best = int(np.argmin(squares))
    spread = float(np.sum((motion - motion.mean()) ** 2))
    explained = 1.0 - squares[best] / spread
    _, residuals = _left_over(log.at(times_s + offsets[best]), motion, degree)
    free = len(times_s) - degree - 2
    floor = len(times_s) * (UNLIKE * np.ptp(motion)) ** 2
    alike = float(np.clip(_correlation(residuals), 0.0, MOST_ALIKE))
    worse = f_distribution.ppf(LEVEL_OF_POSSIBLE, 1, free) / free * (1.0 + alike) / (1.0 - alike)
    possible = offsets[squares <= squares[best] + max(squares[best], floor) * worse]
    forces = np.stack([log.at(times_s + offset) for offset in possible])
    slack = LAG_S + 0.5 * max(log.step_s, float(offsets[1] - offsets[0]))
    low, high = float(possible[0]) - slack, float(possible[-1]) + slack
    at_ends = np.stack([log.at(times_s + low), log.at(times_s + high)])
    forces = np.concatenate([forces, at_ends])
    force_low, force_high = forces.min(0), forces.max(0)
    enough = max(ENOUGH_N, ENOUGH * float(log.forces_n.max()))
    open_still = force_high - force_low > 2.0 * enough
    sure = np.delete(force_low, np.flatnonzero(open_still))
    few = len(times_s) - len(sure) <= max(1.0, MOST_OPEN * len(times_s))
    most = few and sure.max() >= SURE_FORCE * float(log.forces_n.max())
    why = ""
    if explained < LEAST_EXPLAINED:
        why = f"the force explains {100.0 * max(explained, 0.0):.0f} % of the motion at best"
    elif possible[0] <= offsets[0] or possible[-1] >= offsets[-1]:
        why = "the match lies at an end of the log; wanted a log that begins before the frames and ends after them"
    elif open_still.any() and not most:
        why = (
            f"any offset from {low:.2f} to {high:.2f} s is possible, which leaves a frame's force open by ± "
            f"{0.5 * float((force_high - force_low).max()):.1f} N, wanted ± {enough:.1f} N or less"
        )
    at_best = np.where(open_still, np.nan, log.told(times_s + offsets[best]))
    uncertain = tuple(np.flatnonzero(open_still).tolist())
    return LogMatch(
        float(offsets[best]), low, high, not why, why, float(explained), at_best, force_low, force_high,
        uncertain=() if why else uncertain,
    )  # fmt: skip


def given_offset(
    log: ForceLog, times_s: Floats, offset_s: float, motion: Floats, found: LogMatch | None = None
) -> LogMatch:
    """A log at the offset that the user gives; what the force explains is NaN where too few frames tell.

    Parameters
    ----------
    found : the match by the motion, which the given offset is held against.
    """
    forces = log.at(times_s + offset_s)
    explained = math.nan
    spread = float(np.sum((motion - motion.mean()) ** 2))
    if len(times_s) >= FEWEST_FRAMES and spread > 0.0:
        degree = 2 if len(times_s) >= QUADRATIC_FROM else 1
        explained = 1.0 - _left_over(forces, motion, degree)[0] / spread
    against = ""
    if found is not None and found.determined and not found.low_s <= offset_s <= found.high_s:
        against = f"the motion says {found.offset_s:.2f} s (95 % {found.low_s:.2f} to {found.high_s:.2f} s)"
    elif explained < LEAST_EXPLAINED:
        against = f"at this offset the force explains {100.0 * max(explained, 0.0):.0f} % of the motion only"
    told = log.told(times_s + offset_s)
    return LogMatch(offset_s, offset_s, offset_s, True, "", explained, told, forces, forces, True, against)


def outside(log: ForceLog, times_s: Floats, offset_s: float) -> float:
    """How far the frames reach beyond the log, s; 0 if they don't."""
    before, after = log.times_s[0] - times_s[0] - offset_s, times_s[-1] + offset_s - log.times_s[-1]
    return float(max(before, after, 0.0))


def _unknown(log: ForceLog, times_s: Floats, why: str) -> LogMatch:
    nothing = np.full(len(times_s), np.nan)
    low, high = float(log.times_s[0]), float(log.times_s[-1])
    return LogMatch(np.nan, low, high, False, why, 0.0, nothing, nothing, nothing)


def _offsets(log: ForceLog, times_s: Floats) -> Floats | None:
    """Times of the log at which the first frame may lie: the frames inside it, but for two frame intervals at its ends,
    since a log may begin with the first frame.
    """
    # Beyond its ends a log has the ends' forces.
    slack = 2.0 * float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.0
    first, last = log.times_s[0] - times_s[0] - slack, log.times_s[-1] - times_s[-1] + slack
    if last - first <= 0.0:
        return None
    finest = 0.5 * min(log.step_s, float(np.diff(times_s).min()) / 5.0 if len(times_s) > 1 else log.step_s)
    count = int(np.clip(np.ceil((last - first) / max(finest, 1e-6)), 20, MOST_OFFSETS))
    return np.linspace(first, last, count + 1)


def _left_over(forces: Floats, motion: Floats, degree: int) -> tuple[float, Floats]:
    """Sum of squares and residuals (F,) of the motion beside the best monotone polynomial of the force."""
    best = motion - motion.mean()
    size = float(np.ptp(forces))
    if size < 1e-9:
        return float(best @ best), best
    x = (forces - forces.min()) / size
    for power in range(degree, 0, -1):
        design = np.vander(x, power + 1, increasing=True)
        found = np.linalg.lstsq(design, motion, rcond=1e-9)[0]
        if power == 2 and found[1] * (found[1] + 2.0 * found[2]) < 0.0:
            continue  # it turns back within these forces
        best = motion - design @ found
        break
    return float(best @ best), best


def _correlation(residuals: Floats) -> float:
    """Of neighbours."""
    total = float(residuals @ residuals)
    return float(residuals[1:] @ residuals[:-1]) / total if total > 0.0 else 0.0
