"""A weighed fit that has ended, looked at again: how likely other ratios are, and what unseen frames should show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from spinestiff.anatomy.regions import parameter_groups
from spinestiff.anatomy.state import TorsoState
from spinestiff.errors import EquilibriumError
from spinestiff.estimation.asked import weighed_problem
from spinestiff.estimation.fitted import FitEnd
from spinestiff.estimation.forecast import Forecast, forecast
from spinestiff.estimation.known import Known
from spinestiff.estimation.noise import lower_root
from spinestiff.estimation.objective import Trial
from spinestiff.estimation.point import WeighedPoint
from spinestiff.estimation.profiles import rise_at
from spinestiff.estimation.status import FitStatus
from spinestiff.estimation.weighed import WeighedFit, WeighedProblem, Weights
from spinestiff.imaging.features import Orientation
from spinestiff.mechanics.equilibrium import EquilibriumProblem

# Share by which the corners' error may differ where an estimate is solved again: digits of a stored one.
SAME_RMSE = 0.01


def likelihood_rise(
    problems: Sequence[EquilibriumProblem],
    trials: Sequence[Trial],
    estimate: FitEnd,
    others: Mapping[str, float],
    orientation: Orientation = "procrustes",
    known: Known | None = None,
    rmse_mm: float | None = None,
    starts: Sequence[TorsoState] | None = None,
) -> float:
    """By how much twice the negative log likelihood is higher at other ratios than at an estimate, weighed as it was.

    Parameters
    ----------
    estimate : where a weighed fit of these trials ended.
    others : by the estimate's names.
    rmse_mm : of that fit. A soft spine may have two equilibria under one push; the fit's error tells whether its own
        were found again. starts : the fit's states of the loaded trials to solve from; default rest.

    Raises
    ------
    EquilibriumError : there is no equilibrium at one of the two, or the estimate's are others than the fit's.
    """
    groups = parameter_groups(problems[0].torso, tuple(estimate.ratios))
    asked = weighed_problem(problems, trials, groups, orientation, None, known or Known())
    point = _at_end(asked, estimate, starts)
    if rmse_mm is not None and abs(point.evaluation.rmse - rmse_mm) > SAME_RMSE * rmse_mm:
        raise EquilibriumError(
            f"the estimate's equilibria are not found again: corners off by {point.evaluation.rmse:.3g} mm, "
            f"in the fit by {rmse_mm:.3g} mm"
        )
    found = WeighedFit(point, asked.slope(point), _weights_of(asked, point, estimate), FitStatus.CONVERGED, ())
    return rise_at(asked, found, np.log([others[name] for name in estimate.ratios]))


def forecast_unseen(
    problems: Sequence[EquilibriumProblem],
    trials: Sequence[Trial],
    unseen: Sequence[int],
    estimate: FitEnd,
    orientation: Orientation = "procrustes",
    known: Known | None = None,
    starts: Sequence[TorsoState] | None = None,
) -> tuple[Forecast, ...]:
    """What the ``unseen`` of these trials should show, from a weighed fit of the others.

    Parameters
    ----------
    unseen : their numbers among the trials; all are under load.
    estimate : where the fit ended.
    starts : states of the loaded trials to solve from.

    Raises
    ------
    EquilibriumError : there is no equilibrium at the estimate.
    """
    groups = parameter_groups(problems[0].torso, tuple(estimate.ratios))
    asked = weighed_problem(problems, trials, groups, orientation, None, known or Known())
    loaded = [i for i, trial in enumerate(trials) if trial.load.size > 0.0]
    point = _at_end(asked, estimate, starts)
    numbers, inflation = [loaded.index(i) for i in unseen], asked.inflation(estimate.outlying)
    return forecast(asked, point, asked.slope(point), estimate.tracking_factor, numbers, inflation)


def _at_end(asked: WeighedProblem, estimate: FitEnd, starts: Sequence[TorsoState] | None) -> WeighedPoint:
    """The trials where a fit ended."""
    nuisances = np.array([estimate.nuisances.get(name, 0.0) for name in asked.unknowns.names])
    return asked.solve(np.log(list(estimate.ratios.values())), nuisances, starts=starts)


def _weights_of(asked: WeighedProblem, point: WeighedPoint, estimate: FitEnd) -> Weights:
    """The weights that a fit ended with."""
    inflation = asked.inflation(estimate.outlying)
    covariance = asked.covariance(point, estimate.tracking_factor, inflation)
    return Weights(lower_root(covariance), estimate.tracking_factor, inflation)
