"""Intervals by inverting the estimator: which true ratios could have led to this estimate?

The linear interval, estimate times exp(+-t sd), trusts the slope at the estimate over its whole width. Softness does
not work like that: below some stiffness a spring carries nothing and the radiographs no longer change, above some
they change fast. So each end of an interval is solved for on the model itself. With ratios q, features z(q), estimate
q0 and its Jacobian J, an error e of the radiographs of true ratios q leads to the estimate where
J^T (z(q0) - z(q) - e) = 0. Hence

    h(q) = (J^T J)^-1 J^T (z(q) - z(q0))

has the estimator's covariance C at the true q, whatever the curvature of z. The end of ratio i's interval is where
h(q) = +-t C_i / sd_i, with C_i the i-th column: as far as h_i may go, the others following it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from skimage.measure import find_contours, points_in_poly

from spinestiff.anatomy.stiffness import StiffnessRatios
from spinestiff.arrays import Floats, ShortRepr
from spinestiff.errors import EquilibriumError
from spinestiff.estimation.evaluation import Evaluation, Slope, TrialSet, compliance_step, log_step
from spinestiff.estimation.objective import Trial
from spinestiff.estimation.uncertainty import Uncertainty
from spinestiff.imaging.features import Orientation
from spinestiff.mechanics.equilibrium import EquilibriumProblem

# Of the half-width, in h: from here the last linear step is taken without another solve.
CLOSE_ENOUGH = 0.05
LARGEST_FACTOR = 2.5  # change of a ratio in one step
MOST_STEPS, MOST_CORRECTIONS = 8, 5
SMALL_CORRECTION = 0.02  # log ratio
BEYOND = float(np.log(3.0))  # log ratio beyond a bound up to which the joint region is followed
BEYOND_ENDS = 2.0  # times the farthest place known, up to which it is followed
FEWEST_PLACES = 4  # for a cubic: 10 coefficients of each value, 3 equations a place
GRID = 401


@dataclass(frozen=True, repr=False)
class Intervals(ShortRepr):
    """95 % intervals of log ratios.

    Attributes
    ----------
    low, high : (P,) ends, log.
    open_low, open_high : (P,) bool, the end is the fit's bound: the radiographs allow what lies beyond.
    region : (n, 2) log ratios, outline of the 95 % joint region of two ratios, not cut at the bounds; None for
        another number of ratios, or where the radiographs don't tell them apart.
    """

    low: Floats
    high: Floats
    open_low: np.ndarray
    open_high: np.ndarray
    region: Floats | None = None

    @property
    def width(self) -> Floats:
        """(P,) length in log ratio, infinite where both ends are open."""
        both = self.open_low & self.open_high
        return np.asarray(np.where(both, np.inf, self.high - self.low))


def linear_intervals(log_ratios: Floats, spread: Uncertainty, limits: tuple[float, float]) -> Intervals:
    """Estimate +- t sd in log ratio, cut at the bounds."""
    low, high = log_ratios - spread.half_width, log_ratios + spread.half_width
    return Intervals(
        np.maximum(low, limits[0]),
        np.minimum(high, limits[1]),
        low < limits[0],
        high > limits[1],
        joint_region(log_ratios, spread, (), limits),
    )


def inverted_intervals(
    trial_set: TrialSet, point: Evaluation, slope: Slope, spread: Uncertainty, limits: tuple[float, float]
) -> Intervals:
    """Ends solved for on the model.

    Where one can't be reached, as where another ratio meets its bound on the way, the joint region's end is taken,
    which lies further out; without a region the linear end stays.
    """
    linear = linear_intervals(point.log_ratios, spread, limits)
    if not np.isfinite(spread.covariance).all():
        return linear
    inversion = _Inversion(trial_set, point, slope, limits)
    sd = np.sqrt(np.diag(spread.covariance))
    found = {
        (i, sign): inversion.end(sign * spread.half_width[i] * spread.covariance[:, i] / sd[i] ** 2, i)
        for i in range(len(sd))
        for sign in (-1.0, 1.0)
    }
    region = joint_region(point.log_ratios, spread, inversion.visited, limits)
    ends = {-1.0: linear.low.copy(), 1.0: linear.high.copy()}
    opens = {-1.0: linear.open_low.copy(), 1.0: linear.open_high.copy()}
    for (i, sign), end in found.items():
        if end is None and region is not None:
            outermost = float(np.clip(sign * (sign * _within(region, limits)[:, i]).max(), *limits))
            end = outermost, outermost in limits
        if end is not None:
            ends[sign][i], opens[sign][i] = end
    return Intervals(ends[-1.0], ends[1.0], opens[-1.0], opens[1.0], region)


def _within(outline: Floats, limits: tuple[float, float]) -> Floats:
    """The points of an outline (n, 2) inside the limits, and those where it crosses them; all of it if none are."""
    onward = np.roll(outline, -1, axis=0) - outline
    points = [outline]
    for limit in limits:
        with np.errstate(divide="ignore", invalid="ignore"):
            share = (limit - outline) / onward
        points += [(outline + share[:, [i]] * onward)[(share[:, i] > 0.0) & (share[:, i] < 1.0)] for i in (0, 1)]
    found = np.concatenate(points)
    inside = found[((found >= limits[0] - 1e-9) & (found <= limits[1] + 1e-9)).all(1)]
    return inside if len(inside) else outline


@dataclass(frozen=True)
class Place:
    """Somewhere among the log ratios (P,): h there (P,), and the derivative of h in them (P, P)."""

    log_ratios: Floats
    offset: Floats
    gain: Floats


@dataclass(frozen=True)
class _Solved:
    """A place with the model's solution and slope there."""

    at: Evaluation
    slope: Slope
    place: Place


def joint_region(
    log_ratios: Floats, spread: Uncertainty, places: Sequence[Place], limits: tuple[float, float], points: int = 120
) -> Floats | None:
    """Outline (n, 2) of the 95 % joint region of two log ratios: where h has the region's size.

    h is known with its slopes at the places that the intervals' search has visited; a cubic through them stands for it
    elsewhere. Without any it is taken as linear, which gives an ellipse.

    Parameters
    ----------
    places : see above. limits : of the log ratios; the outline is followed a little beyond.
    points : about how many.
    """
    if len(log_ratios) != 2 or not np.isfinite(spread.covariance).all():
        return None
    root, radius = np.linalg.cholesky(spread.covariance), np.sqrt(spread.region_size)
    turn = np.linspace(0.0, 2.0 * np.pi, points, endpoint=False)
    ellipse = log_ratios + radius * np.column_stack([np.cos(turn), np.sin(turn)]) @ root.T
    if len(places) < FEWEST_PLACES:
        return np.asarray(ellipse)
    known = np.array([place.log_ratios for place in places])
    reach = np.maximum(np.abs(known - log_ratios).max(0), 1e-9)
    cubic = _Cubic.through(
        (known - log_ratios) / reach,
        np.array([np.linalg.solve(root, place.offset) for place in places]),
        np.array([np.linalg.solve(root, place.gain) * reach for place in places]),
    )
    low, high = (
        np.maximum(-BEYOND_ENDS, (limits[0] - BEYOND - log_ratios) / reach),
        np.minimum(BEYOND_ENDS, (limits[1] + BEYOND - log_ratios) / reach),
    )
    axes = [np.linspace(low[i], high[i], GRID) for i in (0, 1)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
    size = np.linalg.norm(cubic(grid), axis=1).reshape(GRID, GRID)
    # Beyond the edge of the grid nothing is known: the outline closes along it.
    size[[0, -1], :] = size[:, [0, -1]] = np.maximum(size.max(), 2.0 * radius)
    start = [float(np.interp(0.0, axes[i], np.arange(GRID))) for i in (0, 1)]
    lines = find_contours(size, radius)  # type: ignore[no-untyped-call]
    around = [line for line in lines if points_in_poly([start], line)[0]]  # type: ignore[no-untyped-call]
    if not around:
        return np.asarray(ellipse)
    outline = max(around, key=len)[:-1]
    outline = outline[:: max(len(outline) // points, 1)]
    steps = np.array([np.interp(outline[:, i], np.arange(GRID), axes[i]) for i in (0, 1)]).T
    return np.asarray(log_ratios + steps * reach)


@dataclass(frozen=True)
class _Cubic:
    """A cubic of two variables with two values, (10, 2) coefficients."""

    coefficients: Floats

    @classmethod
    def through(cls, x: Floats, values: Floats, slopes: Floats) -> _Cubic:
        """Least squares through values (n, 2) and slopes (n, 2, 2) at x (n, 2); nothing and that of x = 0 at 0."""
        powers = np.array(_POWERS)
        rows = [np.prod(x[:, None] ** powers, axis=2)]
        wanted = [values]
        for i in (0, 1):
            lowered = np.maximum(powers - np.eye(2, dtype=int)[i], 0)
            rows.append(powers[:, i] * np.prod(x[:, None] ** lowered, axis=2))
            wanted.append(slopes[:, :, i])
        found = np.linalg.lstsq(np.concatenate(rows), np.concatenate(wanted), rcond=None)[0]
        return cls(np.asarray(found))

    def __call__(self, x: Floats) -> Floats:
        return np.asarray(np.prod(x[:, None] ** np.array(_POWERS), axis=2) @ self.coefficients)


_POWERS = [(i, j) for i in range(4) for j in range(4 - i)]


def estimator_offset(point: Evaluation, slope: Slope, other: Evaluation) -> Floats:
    """h(q) (P,) of another evaluation of the same trials: distributed as the estimate's error if q is the truth."""
    return np.asarray(np.linalg.lstsq(slope.jacobian, other.values - point.values, rcond=None)[0])


def offset_from(
    problems: Sequence[EquilibriumProblem],
    trials: Sequence[Trial],
    estimate: StiffnessRatios,
    true_ratios: Mapping[str, float],
    orientation: Orientation,
) -> Floats:
    """h(q) (P,) of known true ratios: what the joint region has to hold if it holds the truth.

    Raises
    ------
    EquilibriumError : no equilibrium at the estimate or at the truth.
    """
    trial_set = TrialSet(problems, trials, estimate.groups, orientation, None)
    centre = trial_set.solve(np.log(estimate.values))
    slope = trial_set.slope(centre)
    truth = np.log([true_ratios[name] for name in estimate.names])
    return estimator_offset(centre, slope, trial_set.solve(truth, centre, slope))


@dataclass(frozen=True)
class _Inversion:
    """Where h takes given values; ``point`` and ``slope`` are the estimate's, ``limits`` bound the log ratios,
    ``visited`` collects the places on the way."""

    trial_set: TrialSet
    point: Evaluation
    slope: Slope
    limits: tuple[float, float]
    visited: list[Place] = field(default_factory=list)

    def end(self, wanted: Floats, i: int) -> tuple[float, bool] | None:
        """Log ratio i where h reaches ``wanted`` (P,), and whether it is the bound; None without an answer, as where
        another ratio meets its bound first.

        The least certain ratio leads, at most by ``LARGEST_FACTOR`` at a time; at each place the others are brought to
        where h points the way that is wanted. That way is a narrow valley that bends: Newton's method in all at once
        loses it, and any other ratio may go back and forth along it.
        """
        lead = int(np.argmax(np.abs(wanted)))
        others = np.delete(np.arange(len(wanted)), lead)
        way = wanted / wanted[lead]
        sign, edge = np.sign(wanted[lead]), self.limits[1] if wanted[lead] > 0.0 else self.limits[0]
        start = Place(self.point.log_ratios, np.zeros(len(wanted)), np.eye(len(wanted)))
        here = _Solved(self.point, self.slope, start)
        self.visited.append(start)
        for _ in range(MOST_STEPS):
            along = np.zeros(len(wanted))
            along[lead] = 1.0
            across = here.place.gain - np.outer(way, here.place.gain[lead])
            along[others] = -np.linalg.lstsq(across[np.ix_(others, others)], across[others, lead], rcond=1e-9)[0]
            speed, left = here.place.gain[lead] @ along, wanted[lead] - here.place.offset[lead]
            change = _log_change(left / speed if speed > 0.0 else np.inf * sign)
            goal = float(np.clip(here.at.log_ratios[lead] + change, *self.limits))
            ahead = here.at.log_ratios + along * (goal - here.at.log_ratios[lead])
            if abs(left) < CLOSE_ENOUGH * abs(wanted[lead]):
                end = float(np.clip(ahead[i], *self.limits))
                return end, end in self.limits
            if goal == here.at.log_ratios[lead]:
                return (edge, True) if i == lead else None
            try:
                here = self._brought_over(ahead, here, lead, way)
            except EquilibriumError:
                return None
            short = (wanted[lead] - here.place.offset[lead]) * sign > 0.0
            if short and np.isin(here.at.log_ratios[others], self.limits).any():
                return None
        return None

    def _brought_over(self, start: Floats, near: _Solved, lead: int, way: Floats) -> _Solved:
        """The place with ratio ``lead`` as at ``start`` and the others, from there on, where h points along ``way``."""
        here, goal = near, np.clip(start, *self.limits)
        others = np.delete(np.arange(len(way)), lead)
        for _ in range(MOST_CORRECTIONS):
            here = self._place(goal, here)
            off = here.place.offset - way * here.place.offset[lead]
            across = here.place.gain - np.outer(way, here.place.gain[lead])
            steps = -np.linalg.lstsq(across[np.ix_(others, others)], off[others], rcond=1e-9)[0]
            change = np.array([_log_change(step) for step in steps])
            goal = here.at.log_ratios.copy()
            goal[others] = np.clip(goal[others] + change, *self.limits)
            if np.abs(goal - here.at.log_ratios).max() < SMALL_CORRECTION:
                break
        return here

    def _place(self, log_ratios: Floats, near: _Solved) -> _Solved:
        at = self.trial_set.solve(log_ratios, near.at, near.slope)
        slope = self.trial_set.slope(at)
        gain = np.linalg.lstsq(self.slope.jacobian, slope.jacobian, rcond=None)[0]
        # Kept without its factors, which are large.
        place = Place(log_ratios, estimator_offset(self.point, self.slope, at), np.asarray(gain, dtype=np.float64))
        self.visited.append(place)
        return _Solved(at, slope, place)


def _log_change(step: float) -> float:
    """Change of log ratio for a step in compliance, at most ``LARGEST_FACTOR`` either way."""
    largest = float(np.log(LARGEST_FACTOR))
    ceiling = float(compliance_step(np.array(largest)))
    return float(np.clip(log_step(np.array(min(step, ceiling))), -largest, largest))
