"""The paper's search for the ratios of least loss (Eq. 8): L-BFGS-B with the adjoint gradient, inside bounds.

Each equilibrium starts from the last one.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from spinestiff.arrays import Floats
from spinestiff.errors import EquilibriumError
from spinestiff.estimation.evaluation import Evaluation, TrialSet
from spinestiff.estimation.status import FitStatus


def lbfgsb(
    trial_set: TrialSet, point: Evaluation, limits: tuple[float, float], max_iterations: int
) -> tuple[Evaluation, FitStatus]:
    """Where the search ended, and how; three evaluations an iteration at most."""
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
                trial_set.note(log_ratios, float("nan"), None, False)
                # A wall: the line search turns back from it.
                return 10.0 * (1.0 + float(np.sum((log_ratios - best.log_ratios) ** 2))), np.zeros(len(log_ratios))
            trial_set.note(log_ratios, found.loss, found, found.loss < best.loss)
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
    return best, outcomes.get(int(result.status), FitStatus.STALLED)
