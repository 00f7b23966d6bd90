"""The profile of the likelihood over one log ratio: followed outward from the estimate, and the word for its shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq, minimize

from spinestiff.arrays import Floats, ShortRepr
from spinestiff.estimation.emulator import Emulator, by_differences

# Steps of a profile, in standard deviations and at most in log ratio; each is so much longer than the last one, so that
# the bounds are reached.
STEP, LONGEST, LONGER = 0.35, 0.5, 1.05
# A profile goes over to another valley where a candidate or a solved place within so many standard deviations of the
# given ratio, and as many of the others' from its own place, is no higher than the valley it is in by so much.
BESIDE, APART, RIVAL = 0.25, 2.0, 1.0
# A profile that rises by less than this anywhere inside the bounds is flat.
FLAT = 0.5
# Another minimum is one that a ridge of this height parts from the estimate.
RIDGE = 0.5


@dataclass(frozen=True, repr=False)
class Profile(ShortRepr):
    """The least psi over one log ratio.

    Attributes
    ----------
    log_ratios : (n,) rising. others : (n, P) all log ratios there. rise : (n,) of psi over the estimate's.
    """

    log_ratios: Floats
    others: Floats
    rise: Floats


class Tracer:
    """Profiles on an emulator, followed outward from the estimate.

    Parameters
    ----------
    scouts : (S, P) log ratios inside the limits, which show valleys beside the one that is followed.
    """

    def __init__(
        self, emulator: Emulator, best: Floats, covariance: Floats, limits: tuple[float, float], scouts: Floats
    ) -> None:
        self._emulator, self._best, self._covariance, self._limits = emulator, best, covariance, limits
        self._least = float(emulator.psi(best)[0])
        self._sd = np.sqrt(np.diag(covariance))
        self._scouts, self.heights = scouts, emulator.psi(scouts) - self._least

    def profile(self, i: int, rise: float) -> Profile:
        """Outward until psi has risen by twice ``rise``, with no scout inside any farther, or to the bounds."""
        found = [(self._best, 0.0)]
        inside = self._scouts[self.heights <= rise]
        for sign in (-1.0, 1.0):
            at, before, step = self._best, 0.0, min(STEP * self._sd[i], LONGEST)
            farthest = float(np.max(sign * inside[:, i], initial=-np.inf))
            while True:
                value = float(np.clip(at[i] + sign * step, *self._limits))
                if value == at[i]:
                    break
                step = min(LONGER * step, LONGEST)
                at, height = self._lowest(i, value, at)
                found.append((at, height))
                if height > 2.0 * rise and height > before and sign * value > farthest:
                    break
                before = height
            if farthest > max(sign * place[i] for place, height in found if height <= rise):
                # Between two steps, in a valley of its own.
                scout = inside[int(np.argmax(sign * inside[:, i]))]
                found.append(self._lowest(i, float(scout[i]), scout))
        found.sort(key=lambda one: float(one[0][i]))
        others = np.array([where for where, _ in found])
        return Profile(others[:, i], others, np.array([height for _, height in found]))

    def end(self, profile: Profile, i: int, sign: float, rise: float) -> tuple[Floats, bool]:
        """All log ratios at an end of ratio i's interval, and whether it is the fit's bound."""
        own, bound = profile.log_ratios, self._limits[int(sign > 0.0)]
        order = np.argsort(sign * own)
        # The outermost place inside: several minima belong to one interval.
        last = next(k for k in order[::-1] if profile.rise[k] <= rise)
        start = profile.others[last]

        def over(value: float) -> float:
            return self._lowest(i, value, start)[1] - rise

        for value in [*own[order[sign * own[order] > sign * own[last]]], bound]:
            if value != start[i] and over(value) > 0.0:
                root = brentq(over, start[i], value, xtol=1e-3 * self._sd[i])
                return self._lowest(i, float(root), start)[0], False
            start = self._lowest(i, value, start)[0]
        return start, True

    def _lowest(self, i: int, value: float, near: Floats) -> tuple[Floats, float]:
        """Place and height of the least psi with log ratio i given, from ``near`` or in a valley that scouts show."""
        others = [j for j in range(len(near)) if j != i]
        start = near.copy()
        start[i] = value
        if not others:
            return start, float(self._emulator.psi(start)[0]) - self._least
        follow = self._covariance[others, i] / self._covariance[i, i]
        start[others] = np.clip(start[others] + follow * (value - near[i]), *self._limits)
        scale = np.sqrt(np.maximum(self._sd[others] ** 2 - follow * self._covariance[others, i], 1e-8))
        found, height = self._downhill(start, others, scale)
        beside = np.abs(self._scouts[:, i] - value) < BESIDE * self._sd[i]
        apart = np.abs((self._scouts[:, others] - found[others]) / scale).max(axis=1)
        rivals = np.flatnonzero(beside & (apart > APART) & (self.heights < height + RIVAL))
        if len(rivals):
            start = self._scouts[rivals[np.argmin(self.heights[rivals])]].copy()
            start[i] = value
            other, lower = self._downhill(start, others, scale)
            if lower < height:
                return other, lower
        return found, height

    def _downhill(self, start: Floats, others: list[int], scale: Floats) -> tuple[Floats, float]:
        """Place and height of the next least psi over some of the log ratios."""

        def heights(x: Floats) -> Floats:
            where = np.tile(start, (len(x), 1))
            where[:, others] += scale * x
            return self._emulator.psi(where)

        bounds = [((self._limits[0] - start[j]) / s, (self._limits[1] - start[j]) / s) for j, s in zip(others, scale)]
        found = minimize(
            by_differences(heights, 1e-3), np.zeros(len(others)), jac=True, method="L-BFGS-B", bounds=bounds
        )
        place = start.copy()
        place[others] = np.clip(start[others] + scale * found.x, *self._limits)
        return place, float(found.fun) - self._least


def interval_kind(best: float, open_low: bool, open_high: bool, limits: tuple[float, float]) -> str:
    """The word (``profiles.Likely.kinds``) for an estimate (log) whose interval ends at the fit's bounds or not."""
    if open_low and open_high:
        return "flat"
    if min(best - limits[0], limits[1] - best) < 1e-6:
        return "at a bound"
    return "one-sided" if open_low or open_high else "bounded"


def profile_kind(
    profile: Profile, best: float, open_low: bool, open_high: bool, limits: tuple[float, float], rise: float
) -> str:
    """The word for a profile (``profiles.Likely.kinds``).

    Parameters
    ----------
    best : the estimate, log. open_low, open_high : the interval's end is the fit's bound.
    limits : the fit's bounds, log. rise : of psi at an interval's end.
    """
    kind = "flat" if profile.rise.max() < FLAT else interval_kind(best, open_low, open_high, limits)
    if kind != "bounded":
        return kind
    ends = np.flatnonzero(profile.rise <= rise)[[0, -1]]
    # With ridges that are higher than the interval's ends.
    inside = profile.rise[ends[0] : ends[1] + 1]
    falls = np.diff(inside)
    turns = np.flatnonzero((falls[:-1] > 0.0) & (falls[1:] < 0.0)) + 1
    if any(inside[t] - max(inside[:t].min(), inside[t:].min()) > RIDGE for t in turns):
        return "several minima"
    return "bounded"
