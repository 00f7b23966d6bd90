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
from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.stiffness import StiffnessRatios
from spinestiff.arrays import Floats
from spinestiff.errors import EquilibriumError
from spinestiff.estimation.evaluation import Evaluation, Slope, TrialSet, compliance_step, log_step
from spinestiff.estimation.objective import Trial
from spinestiff.estimation.uncertainty import Uncertainty
from spinestiff.imaging.features import Orientation
from spinestiff.mechanics.equilibrium import EquilibriumProblem

# Of the half-width, in h: from here the last linear step is taken without another solve.
CLOSE_ENOUGH = 0.15
LARGEST_FACTOR = 8.0  # change of a ratio in one step
MOST_STEPS = 5


@dataclass(frozen=True)
class Intervals:
    """95 % intervals of log ratios.

    Attributes
    ----------
    low, high : (P,) ends, log.
    open_low, open_high : (P,) bool, the end is the fit's bound: the radiographs allow what lies beyond.
    """

    low: Floats
    high: Floats
    open_low: np.ndarray
    open_high: np.ndarray

    @property
    def width(self) -> Floats:
        """(P,) length in log ratio, infinite where both ends are open."""
        both = self.open_low & self.open_high
        return np.asarray(np.where(both, np.inf, self.high - self.low))


def linear_intervals(log_ratios: Floats, spread: Uncertainty, limits: tuple[float, float]) -> Intervals:
    """Estimate +- t sd in log ratio, cut at the bounds."""
    low, high = log_ratios - spread.half_width, log_ratios + spread.half_width
    return Intervals(np.maximum(low, limits[0]), np.minimum(high, limits[1]), low < limits[0], high > limits[1])


def inverted_intervals(
    trial_set: TrialSet, point: Evaluation, slope: Slope, spread: Uncertainty, limits: tuple[float, float]
) -> Intervals:
    """Ends solved for on the model; where an equilibrium fails, the linear end stays."""
    linear = linear_intervals(point.log_ratios, spread, limits)
    if not np.isfinite(spread.covariance).all():
        return linear
    ends = {"low": linear.low.copy(), "high": linear.high.copy()}
    opens = {"low": linear.open_low.copy(), "high": linear.open_high.copy()}
    sd = np.sqrt(np.diag(spread.covariance))
    for i in range(len(sd)):
        for side, sign in (("low", -1.0), ("high", 1.0)):
            wanted = sign * spread.half_width[i] * spread.covariance[:, i] / sd[i] ** 2
            found = _solve_end(trial_set, point, slope, wanted, i, limits)
            if found is not None:
                ends[side][i], opens[side][i] = found
    return Intervals(ends["low"], ends["high"], opens["low"], opens["high"])


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


def _solve_end(
    trial_set: TrialSet, point: Evaluation, slope: Slope, wanted: Floats, i: int, limits: tuple[float, float]
) -> tuple[float, bool] | None:
    """Log ratio i where h reaches ``wanted``, and whether it is the bound; None without an answer."""
    at, around = point, slope
    largest = np.log(LARGEST_FACTOR)
    edge = limits[1] if wanted[i] > 0.0 else limits[0]
    free = np.ones(len(wanted), dtype=bool)
    for _ in range(MOST_STEPS):
        left = (wanted - estimator_offset(point, slope, at))[free]
        gain = np.linalg.lstsq(slope.jacobian, around.jacobian, rcond=None)[0][np.ix_(free, free)]
        step = np.zeros(len(wanted))
        step[free] = np.linalg.lstsq(gain, left, rcond=1e-9)[0]
        ceiling = compliance_step(np.full(len(step), largest))
        change = np.clip(log_step(np.minimum(step, ceiling)), -largest, largest)
        goal = np.clip(at.log_ratios + change, *limits)
        if np.abs(left).max() < CLOSE_ENOUGH * np.abs(wanted[free]).max():
            return float(goal[i]), bool(goal[i] == edge)
        stuck = (goal == at.log_ratios) & free
        if stuck[i]:
            return float(goal[i]), True
        # Another ratio at its bound can't follow any more; the end is then sought without it.
        free &= ~stuck
        try:
            at = trial_set.solve(goal, at, around)
            around = trial_set.slope(at)
        except EquilibriumError:
            return None
    return None
