"""Estimation of stiffness ratios from radiographs under known pushes (paper 4, Eq. 8).

Levenberg-Marquardt in log ratios with forward sensitivities is the default; L-BFGS-B with the adjoint gradient is the
paper's way. Both stay inside bounds, start each equilibrium from the last one, and end with the same statistics.
"""

from __future__ import annotations

import enum
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.optimize import lsq_linear, minimize

from spinestiff.anatomy.stiffness import RATIO_BOUNDS, StiffnessRatios, parameter_group
from spinestiff.arrays import Floats
from spinestiff.errors import EquilibriumError, FitError
from spinestiff.estimation.evaluation import (
    Evaluation,
    FitCost,
    FitStep,
    Observer,
    Slope,
    TrialSet,
    compliance_step,
    log_step,
)
from spinestiff.estimation.intervals import Intervals, inverted_intervals, linear_intervals
from spinestiff.estimation.objective import Residuals, Trial, residuals, undetermined_vertebrae
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
    "Observer",
    "StiffnessFit",
    "fit_stiffness",
]

Method = Literal["lm", "lbfgsb"]
METHODS: tuple[Method, ...] = ("lm", "lbfgsb")
PREDICTED_DECREASE = 1e-8  # relative to the loss
STALLED_DECREASE = 1e-5  # the same, where no step gains any more
SMALLEST_STEP = 1e-5  # in log ratio
SMALLEST_RMSE = 1e-7  # mm; equilibria are no more exact than this
# One step changes a ratio by at most these factors: beyond, the linear model says nothing.
LARGEST_SOFTENING, LARGEST_STIFFENING = 20.0, 10.0
FIRST_DAMPING, LARGEST_DAMPING = 1e-3, 1e12
# An interval that covers more of the bounds (in log) than this says that the data can't tell.
WIDEST_INTERVAL = 0.9
IntervalKind = Literal["inverted", "linear"]


class FitStatus(enum.Enum):
    """How a fit ended; the text holds cause and remedy."""

    CONVERGED = "converged"
    AT_BOUND = (
        "converged with a ratio at its bound; the radiographs ask for a value outside: "
        "check force, pushed point and rest geometry, or widen the bounds"
    )
    NOT_IDENTIFIABLE = (
        "these radiographs can't tell the ratios apart (an interval covers nearly all that the bounds "
        "allow): use larger forces, more vertebrae or fewer ratios"
    )
    ITERATION_LIMIT = "not converged within the iteration limit; raise it or start from the ratios reached"
    STALLED = (
        "no step lowers the loss further, though the gradient is not zero: equilibria near the ratios reached fail "
        "or are inexact; reduce the force or raise the lower bound"
    )

    @property
    def usable(self) -> bool:
        """Whether the ratios are a minimum of the loss inside the bounds."""
        return self in (FitStatus.CONVERGED, FitStatus.AT_BOUND, FitStatus.NOT_IDENTIFIABLE)


@dataclass(frozen=True)
class StiffnessFit:
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


def fit_stiffness(
    problem: EquilibriumProblem | Sequence[EquilibriumProblem],
    trials: Sequence[Trial],
    names: Sequence[str] = ("lateral_bending", "tissue"),
    method: Method = "lm",
    start: Mapping[str, float] | None = None,
    bounds: tuple[float, float] = RATIO_BOUNDS,
    orientation: Orientation = "procrustes",
    observer: Observer | None = None,
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
    search = _levenberg_marquardt if method == "lm" else _lbfgsb
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


def _levenberg_marquardt(
    trial_set: TrialSet, point: Evaluation, limits: tuple[float, float], max_iterations: int
) -> tuple[Evaluation, Slope, FitStatus]:
    slope, damping, growth = trial_set.slope(point), FIRST_DAMPING, 4.0
    curvature, bent = np.zeros((len(point.log_ratios),) * 2), False
    refused: tuple[Floats, Evaluation] | None = None
    for _ in range(max_iterations):
        model = curvature if bent else None
        if _finished(point, slope, limits, model):
            return point, slope, FitStatus.CONVERGED
        if refused is None:
            change, predicted = _damped_step(point, slope, limits, damping, model)
        else:
            change, predicted = _arc(point, slope, limits, damping, *refused)
        target = np.clip(point.log_ratios + change, *limits)
        try:
            trial = trial_set.solve(target, point, slope)
            decrease = point.loss - trial.loss
            # More than promised counts as promised: a promise can be as small as rounding.
            gain = min(decrease / max(predicted, 1e-300), 1.0)
            after = trial_set.slope(trial) if gain > 1e-4 else None
        except EquilibriumError:
            trial_set.note(target, None, False, damping)
            damping, refused = max(10.0 * damping, 0.1), None
        else:
            trial_set.note(target, trial, after is not None, damping)
            if after is not None:
                straight, curved = (_predicted(point, slope, compliance_step(change), c) for c in (None, curvature))
                bent = bool(curvature.any()) and abs(curved - decrease) < abs(straight - decrease)
                curvature, first = _secant(curvature, change, point, slope, trial, after), not curvature.any()
                # A first curvature has not predicted anything yet; it is tried where the straight model was poor.
                bent = bent or (first and not 0.75 < decrease / max(predicted, 1e-300) < 1.5)
                point, slope = trial, after
                damping, growth = damping * max(1.0 / 5.0, 1.0 - (2.0 * gain - 1.0) ** 3), 4.0
                refused = None
            elif refused is None:
                # A step that was refused has told how the residuals curve along it.
                refused, bent = (change, trial), False
            else:
                damping, growth, refused = max(damping, 3e-3) * growth, 2.0 * growth, None
        if damping > LARGEST_DAMPING:
            # At the rounding of the equilibria no step gains any more: that is a minimum, as well as it can be had.
            done = _finished(point, slope, limits, None, STALLED_DECREASE)
            return point, slope, FitStatus.CONVERGED if done else FitStatus.STALLED
    done = _finished(point, slope, limits, curvature if bent else None)
    return point, slope, FitStatus.CONVERGED if done else FitStatus.ITERATION_LIMIT


def _arc(
    point: Evaluation,
    slope: Slope,
    limits: tuple[float, float],
    damping: float,
    refused: Floats,
    trial: Evaluation,
) -> tuple[Floats, float]:
    """Change of log ratios along the arc that a refused step tells of, and the decrease that it promises.

    Ratios that trade against each other make a narrow, curved valley, in which every straight step leaves the floor.
    With the residuals r + t J p + t^2 h along the refused step p, h known from its end, the floor is followed by
    t p + t^2 a, J a = -h in the damped least squares (geodesic acceleration; Transtrum and Sethna 2012), as far as
    that model falls.
    """
    jacobian, values = slope.jacobian, point.values
    p = compliance_step(refused)
    curved = trial.values - values - jacobian @ p
    columns = np.maximum(np.sum(jacobian**2, axis=0), 1e-300)
    rows = np.vstack([jacobian, np.diag(np.sqrt(damping * columns))])
    aside = np.linalg.lstsq(rows, np.concatenate([-curved, np.zeros(len(p))]), rcond=None)[0]
    share = np.linspace(0.0, 1.0, 201)[1:, None]
    model = values + share * (jacobian @ p) + share**2 * (curved + jacobian @ aside)
    losses = 0.5 * np.sum(model**2, axis=1)
    best = float(share[np.argmin(losses), 0])
    low = np.maximum(limits[0] - point.log_ratios, -np.log(LARGEST_SOFTENING))
    high = np.minimum(limits[1] - point.log_ratios, np.log(LARGEST_STIFFENING))
    arc = best * p + best**2 * aside
    # A compliance step of 1 would be a stiffness without end.
    inside = np.clip(arc, compliance_step(low), compliance_step(high))
    return np.clip(log_step(inside), low, high), max(float(point.loss - losses.min()), 0.0)


def _secant(
    curvature: Floats, change: Floats, point: Evaluation, slope: Slope, trial: Evaluation, after: Slope
) -> Floats:
    """What Gauss-Newton leaves out, sum r d2r, by the sized secant update of Dennis, Gay and Welsch (1981).

    Ratios that trade against each other change the residuals little, so that there the left-out part can be as large
    as J^T J, and plain Gauss-Newton steps overshoot to and fro.
    """
    wanted = (after.jacobian - slope.jacobian).T @ trial.values
    grown = after.jacobian.T @ trial.values - slope.jacobian.T @ point.values
    along = float(grown @ change)
    if not along > 1e-12 * float(np.linalg.norm(grown) * np.linalg.norm(change)):
        return np.zeros_like(curvature)
    old = float(change @ curvature @ change)
    size = min(1.0, abs(float(change @ wanted)) / abs(old)) if old != 0.0 else 1.0
    miss = wanted - size * curvature @ change
    update = (np.outer(miss, grown) + np.outer(grown, miss)) / along
    return np.asarray(size * curvature + update - float(miss @ change) * np.outer(grown, grown) / along**2)


def _finished(
    point: Evaluation,
    slope: Slope,
    limits: tuple[float, float],
    curvature: Floats | None,
    decrease: float = PREDICTED_DECREASE,
) -> bool:
    """Whether the undamped step would gain (relative to the loss) or move next to nothing."""
    if point.rmse < SMALLEST_RMSE:
        return True
    change, predicted = _damped_step(point, slope, limits, 1e-10, curvature)
    return bool(predicted <= decrease * point.loss or np.abs(change).max() < SMALLEST_STEP)


def _predicted(point: Evaluation, slope: Slope, p: Floats, curvature: Floats | None) -> float:
    """Decrease of the loss that the model promises for a step p."""
    moved = slope.jacobian @ p
    bend = 0.0 if curvature is None else 0.5 * float(p @ curvature @ p)
    return -float(point.values @ moved) - 0.5 * float(moved @ moved) - bend


def _damped_step(
    point: Evaluation, slope: Slope, limits: tuple[float, float], damping: float, curvature: Floats | None
) -> tuple[Floats, float]:
    """Change of log ratios inside the box, and the decrease of the loss that the model promises.

    Marquardt's scaling: the damping is relative to each column, so that the units of a ratio don't matter.
    """
    jacobian, values = slope.jacobian, point.values
    low = np.maximum(limits[0] - point.log_ratios, -np.log(LARGEST_SOFTENING))
    high = np.minimum(limits[1] - point.log_ratios, np.log(LARGEST_STIFFENING))
    columns = np.sum(jacobian**2, axis=0)
    columns = np.maximum(columns, 1e-12 * columns.max(initial=0.0) + 1e-300)
    # The QR's triangle holds all that the step needs; the rows are hundreds, the columns a few.
    triangle = np.asarray(np.linalg.qr(np.column_stack([jacobian, values]), mode="r"))
    root, wanted = triangle[:, :-1], -triangle[:, -1]
    if curvature is not None:
        scale = np.sqrt(columns)
        sizes, axes = np.linalg.eigh((jacobian.T @ jacobian + curvature) / np.outer(scale, scale))
        # Downhill only: a direction that curves down is taken as nearly straight.
        roots = np.sqrt(np.maximum(sizes, 1e-6))
        root = (roots * axes).T * scale
        wanted = -(axes / roots).T @ ((jacobian.T @ values) / scale)
    rows = np.vstack([root, np.diag(np.sqrt(damping * columns))])
    wanted = np.concatenate([wanted, np.zeros(len(low))])
    # A bound that is reached leaves no room; the solver wants some.
    floor, ceiling = compliance_step(low) - 1e-14, compliance_step(high) + 1e-14
    p = lsq_linear(rows, wanted, (floor, ceiling), method="bvls").x
    change = np.clip(log_step(p), low, high)
    return change, max(_predicted(point, slope, compliance_step(change), curvature), 0.0)


def _lbfgsb(
    trial_set: TrialSet, point: Evaluation, limits: tuple[float, float], max_iterations: int
) -> tuple[Evaluation, Slope, FitStatus]:
    best, scale = point, max(point.loss, 1e-300)
    last = [point]

    def objective(log_ratios: Floats) -> tuple[float, Floats]:
        nonlocal best
        if np.array_equal(log_ratios, point.log_ratios):
            found, gradient = point, trial_set.gradient(point)
        else:
            try:
                found = trial_set.solve(log_ratios, last[0])
                gradient = trial_set.gradient(found)
            except EquilibriumError:
                trial_set.note(log_ratios, None, False)
                # A wall: the line search turns back from it.
                return 10.0 * (1.0 + float(np.sum((log_ratios - best.log_ratios) ** 2))), np.zeros(len(log_ratios))
            trial_set.note(log_ratios, found, found.loss < best.loss)
        last[0] = found
        best = found if found.loss < best.loss else best
        return found.loss / scale, gradient / scale

    result = minimize(
        objective,
        point.log_ratios,
        jac=True,
        method="L-BFGS-B",
        bounds=[limits] * len(point.log_ratios),
        options={"maxiter": max_iterations, "maxfun": 3 * max_iterations, "ftol": 1e-12, "gtol": 1e-7},
    )
    outcomes = {0: FitStatus.CONVERGED, 1: FitStatus.ITERATION_LIMIT}
    return best, trial_set.slope(best), outcomes.get(int(result.status), FitStatus.STALLED)


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
