"""Estimation of stiffness ratios from radiographs under known pushes (paper 4, Eq. 8).

Levenberg-Marquardt in log ratios with forward sensitivities is the default; L-BFGS-B with the adjoint gradient is the
paper's way (``search``). Both end with the same statistics.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from spinestiff.anatomy.stiffness import RATIO_BOUNDS, StiffnessRatios, parameter_group
from spinestiff.arrays import Floats, ShortRepr
from spinestiff.errors import EquilibriumError, FitError
from spinestiff.estimation.evaluation import (
    Evaluation,
    FitCost,
    FitStep,
    OnFitStep,
    TrialSet,
)
from spinestiff.estimation.intervals import Intervals, inverted_intervals, linear_intervals
from spinestiff.estimation.objective import Residuals, Trial, residuals, undetermined_vertebrae
from spinestiff.estimation.search import FitStatus, lbfgsb, levenberg_marquardt
from spinestiff.estimation.uncertainty import Uncertainty, UncertaintySettings, estimator_uncertainty
from spinestiff.imaging.features import Orientation
from spinestiff.mechanics.equilibrium import Equilibrium, EquilibriumProblem

__all__ = [
    "METHODS",
    "FitCost",
    "FitStatus",
    "FitStep",
    "IntervalKind",
    "Method",
    "OnFitStep",
    "StiffnessFit",
    "fit_stiffness",
]

Method = Literal["lm", "lbfgsb"]
METHODS: tuple[Method, ...] = ("lm", "lbfgsb")
# An interval that covers more of the bounds (in log) than this says that the data can't tell.
WIDEST_INTERVAL = 0.9
IntervalKind = Literal["inverted", "linear"]


@dataclass(frozen=True, repr=False)
class StiffnessFit(ShortRepr):
    """Estimated ratios and how well they are known.

    Attributes
    ----------
    ratios : the estimate.
    status : how the fit ended; ``status.value`` holds cause and remedy.
    uncertainty : covariance of the log ratios, correlation, condition.
    intervals : 95 % intervals of the log ratios.
    at_bound : name -> at its bound.
    rmse_mm, default_rmse_mm : training RMSE at the patient plane, fitted and with all ratios 1 (NaN without
        an equilibrium there).
    residuals : one a trial, simulated minus measured.
    equilibria, default_equilibria : one a trial.
    jacobian : (n, P) derivative of the stacked weighted residuals in log ratio.
    history : every evaluation. cost : what it took.
    warnings : what a reader of the result must know.
    """

    ratios: StiffnessRatios
    status: FitStatus
    uncertainty: Uncertainty
    intervals: Intervals
    at_bound: Mapping[str, bool]
    rmse_mm: float
    default_rmse_mm: float
    residuals: tuple[Residuals, ...] = field(repr=False)
    equilibria: tuple[Equilibrium, ...] = field(repr=False)
    default_equilibria: tuple[Equilibrium, ...] = field(repr=False)
    jacobian: Floats = field(repr=False)
    history: tuple[FitStep, ...] = field(repr=False)
    cost: FitCost
    method: str
    orientation: Orientation
    bounds: tuple[float, float]
    warnings: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        return self.ratios.names

    @property
    def intervals95(self) -> dict[str, tuple[float, float]]:
        """Name -> lower and upper end of the 95 % interval of the ratio; an end at the fit's bound is open."""
        low, high = np.exp(self.intervals.low), np.exp(self.intervals.high)
        return {name: (float(a), float(b)) for name, a, b in zip(self.names, low, high)}

    @property
    def correlation(self) -> Floats:
        """(P, P) correlation of the log ratios' estimates."""
        return self.uncertainty.correlation

    @property
    def condition(self) -> float:
        """Condition number of the Gauss-Newton Hessian in log ratios."""
        return self.uncertainty.condition

    @property
    def loss_history(self) -> tuple[float, ...]:
        """Loss, mm^2, at the start and after each accepted step."""
        return tuple(step.loss for step in self.history if step.accepted)

    def __str__(self) -> str:
        lines = [f"{self.status.name}: training RMSE {self.rmse_mm:.2f} mm (default {self.default_rmse_mm:.2f} mm)"]
        for name, value in self.ratios.as_dict().items():
            low, high = self.intervals95[name]
            bound = " at bound" if self.at_bound[name] else ""
            lines.append(f"  {name} {value:.4g} (95 % {low:.3g} to {high:.3g}){bound}")
        return "\n".join([*lines, *(f"  warning: {text}" for text in self.warnings)])

    def _facts(self) -> Iterator[str]:
        yield self.status.name
        for name, value in self.ratios.as_dict().items():
            low, high = self.intervals95[name]
            yield f"{name}={value:.4g} ({low:.3g} to {high:.3g})"
        yield f"training RMSE {self.rmse_mm:.2f} mm"


def fit_stiffness(
    problem: EquilibriumProblem | Sequence[EquilibriumProblem],
    trials: Sequence[Trial],
    names: Sequence[str] = ("lateral_bending", "tissue"),
    method: Method = "lm",
    start: Mapping[str, float] | None = None,
    bounds: tuple[float, float] = RATIO_BOUNDS,
    orientation: Orientation = "procrustes",
    observer: OnFitStep | None = None,
    max_iterations: int = 80,
    uncertainty: UncertaintySettings | None = None,
    intervals: IntervalKind = "inverted",
) -> StiffnessFit:
    """Stiffness ratios whose equilibria show what the radiographs show (Eq. 8).

    Parameters
    ----------
    problem : one for all trials or one a trial (supports depend on the pushed side).
    trials : radiographs under known pushes.
    names : parameters to estimate, see ``anatomy.stiffness.parameter_group``; ("everything",) is the one-ratio model.
    method : "lm" (forward sensitivities) or "lbfgsb" (adjoint gradient, the paper's).
    start : name -> ratio to start from; default 1.
    bounds : lowest and highest ratio.
    orientation : of a vertebra in the picture, "procrustes" or "covariance".
    observer : called after every evaluation.
    max_iterations : evaluations of all trials (L-BFGS-B: iterations, and three times as many evaluations).
    uncertainty : what is known about the inputs' errors.
    intervals : "inverted" solves for their ends on the model (costs about as much as the fit), "linear" takes the
        slope at the estimate.

    Raises
    ------
    FitError : no trials, no force, impossible bounds or names, or no equilibrium at the start.
    TrackingError : a trial's corners fit no vertebra.
    """
    began = time.perf_counter()
    problems = _problems(problem, trials)
    _check(trials, names, method, bounds)
    settings = uncertainty or UncertaintySettings()
    groups = tuple(parameter_group(name, problems[0].torso.joints.kinds) for name in names)
    trial_set = TrialSet(problems, trials, groups, orientation, observer)
    first = _start(names, start, bounds)
    default = _default_point(trial_set)
    point = default if default is not None and not first.any() else _first_point(trial_set, first, default)
    trial_set.note(point.log_ratios, point, True)
    limits = (np.log(bounds[0]), np.log(bounds[1]))
    search = levenberg_marquardt if method == "lm" else lbfgsb
    point, slope, status = search(trial_set, point, limits, max_iterations)
    nuisances = trial_set.nuisances(slope, settings)
    spread = estimator_uncertainty(slope.jacobian, point.values, trial_set.layout(), nuisances, settings)
    ends = linear_intervals(point.log_ratios, spread, limits)
    if intervals == "inverted":
        ends = inverted_intervals(trial_set, point, slope, spread, limits)
    edge = np.minimum(point.log_ratios - limits[0], limits[1] - point.log_ratios) < 1e-6
    if status is FitStatus.CONVERGED:
        if edge.any():
            status = FitStatus.AT_BOUND
        elif not ends.width.max() < WIDEST_INTERVAL * (limits[1] - limits[0]):
            status = FitStatus.NOT_IDENTIFIABLE
    trial_set.cost.seconds = time.perf_counter() - began
    return StiffnessFit(
        ratios=trial_set.ratios(point.log_ratios),
        status=status,
        uncertainty=spread,
        intervals=ends,
        at_bound={name: bool(flag) for name, flag in zip(names, edge)},
        rmse_mm=point.rmse,
        default_rmse_mm=float("nan") if default is None else default.rmse,
        residuals=point.residuals,
        equilibria=point.equilibria,
        default_equilibria=() if default is None else default.equilibria,
        jacobian=slope.jacobian,
        history=tuple(trial_set.history),
        cost=trial_set.cost,
        method=method,
        orientation=orientation,
        bounds=(float(bounds[0]), float(bounds[1])),
        warnings=(*_warnings(trial_set, default, point), *_open_ends(names, ends, bounds)),
    )


def _problems(
    problem: EquilibriumProblem | Sequence[EquilibriumProblem], trials: Sequence[Trial]
) -> tuple[EquilibriumProblem, ...]:
    if not len(trials):
        raise FitError("no trials to fit: mark at least one frame as training")
    if not isinstance(problem, Sequence):
        return (problem,) * len(trials)
    if len(problem) != len(trials):
        raise FitError(f"{len(problem)} problems for {len(trials)} trials; wanted one, or one a trial")
    if any(other.torso.joints.kinds != problem[0].torso.joints.kinds for other in problem):
        raise FitError("the problems' torsos differ in their joints")
    return tuple(problem)


def _check(trials: Sequence[Trial], names: Sequence[str], method: str, bounds: tuple[float, float]) -> None:
    if method not in METHODS:
        raise FitError(f"unknown fit method '{method}'; wanted one of {', '.join(METHODS)}")
    if not names or len(set(names)) != len(names):
        raise FitError(f"parameters to fit: {', '.join(names) or 'none'}; wanted at least one, each once")
    if not 0.0 < bounds[0] < bounds[1] < np.inf:
        raise FitError(f"bounds {bounds[0]}..{bounds[1]} of the ratios; wanted 0 < lower < upper")
    if not any(trial.load.size > 0.0 for trial in trials):
        raise FitError("no trial has a force, so that nothing says how stiff the torso is")


def _start(names: Sequence[str], start: Mapping[str, float] | None, bounds: tuple[float, float]) -> Floats:
    values = np.array([(start or {}).get(name, 1.0) for name in names])
    for name in start or {}:
        if name not in names:
            raise FitError(f"start names '{name}', which is not fitted; fitted are {', '.join(names)}")
    if not ((values >= bounds[0]) & (values <= bounds[1])).all():
        raise FitError(f"start {values.tolist()} lies outside the bounds {bounds[0]}..{bounds[1]}")
    return np.asarray(np.log(values))


def _default_point(trial_set: TrialSet) -> Evaluation | None:
    default = np.zeros(len(trial_set.groups))
    try:
        point = trial_set.solve(default)
    except EquilibriumError:
        return None
    return point


def _first_point(trial_set: TrialSet, first: Floats, default: Evaluation | None) -> Evaluation:
    try:
        return trial_set.solve(first, default)
    except EquilibriumError as error:
        raise FitError(f"no equilibrium at the start of the fit, {error}") from None


def _warnings(trial_set: TrialSet, default: Evaluation | None, point: Evaluation) -> tuple[str, ...]:
    found = []
    for i, (problem, target) in enumerate(zip(trial_set.problems, trial_set.targets)):
        name = trial_set.trials[i].label or f"trial {i + 1}"
        rest = residuals(problem.torso, target, problem.torso.rest_pose).values
        measured, simulated = -rest, (default or point).residuals[i].values - rest
        if measured @ simulated < 0.0:
            found.append(f"{name}: the spine moved against the push; check the side of the push and of the picture")
        square = undetermined_vertebrae(problem.torso, target)
        if square:
            found.append(f"{name}: orientation by covariance means little for {', '.join(square)} (near-square box)")
    return tuple(found)


def _open_ends(names: Sequence[str], ends: Intervals, bounds: tuple[float, float]) -> list[str]:
    found = []
    for name, low, high in zip(names, ends.open_low, ends.open_high):
        sides = [
            f"{side} {bound:g}"
            for side, bound, is_open in (("below", bounds[0], low), ("above", bounds[1], high))
            if is_open
        ]
        if sides:
            found.append(f"{name}: the radiographs also allow ratios {' and '.join(sides)}, the bounds of the fit")
    return found
