"""The search for the ratios of least loss (Eq. 8): Levenberg-Marquardt, or the paper's L-BFGS-B, inside bounds.

Both start each equilibrium from the last one.
"""

from __future__ import annotations

import enum

import numpy as np
from scipy.optimize import lsq_linear, minimize

from spinestiff.arrays import Floats
from spinestiff.errors import EquilibriumError
from spinestiff.estimation.evaluation import Evaluation, Slope, TrialSet, compliance_step, log_step

PREDICTED_DECREASE = 1e-8  # relative to the loss
STALLED_DECREASE = 1e-5  # the same, where no step gains any more
SMALLEST_STEP = 1e-5  # in log ratio
SMALLEST_RMSE = 1e-7  # mm; equilibria are no more exact than this
# One step changes a ratio by at most these factors: beyond, the linear model says nothing.
LARGEST_SOFTENING, LARGEST_STIFFENING = 20.0, 10.0
FIRST_DAMPING, LARGEST_DAMPING = 1e-3, 1e12


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


def levenberg_marquardt(
    trial_set: TrialSet, point: Evaluation, limits: tuple[float, float], max_iterations: int
) -> tuple[Evaluation, Slope, FitStatus]:
    """The least loss by damped Gauss-Newton steps in log ratios, with forward sensitivities.

    Parameters
    ----------
    trial_set : what is evaluated.
    point : where to begin.
    limits : of the log ratios.
    max_iterations : evaluations.

    Returns
    -------
    Where it ended, the slope there, and how: CONVERGED, ITERATION_LIMIT or STALLED.
    """
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


def lbfgsb(
    trial_set: TrialSet, point: Evaluation, limits: tuple[float, float], max_iterations: int
) -> tuple[Evaluation, Slope, FitStatus]:
    """The same by L-BFGS-B with the adjoint gradient, the paper's way; three evaluations an iteration at most."""
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
