"""Estimation of stiffness ratios from radiographs under known pushes (paper 4, Eq. 8).

The weighed fit (``weighed``) is the default. The paper's own, equal weights and L-BFGS-B with the adjoint gradient
(``search``), stays beside it; it has no intervals.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.regions import parameter_groups
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import RATIO_BOUNDS
from spinestiff.arrays import Floats
from spinestiff.errors import EquilibriumError, FitError, NoMinimum
from spinestiff.estimation.asked import (
    Extent,
    Start,
    check_asked,
    check_known,
    first_logs,
    one_a_trial,
    weighed_problem,
)
from spinestiff.estimation.emulator import Place
from spinestiff.estimation.evaluation import Evaluation, OnFitStep, TrialSet
from spinestiff.estimation.fitted import Method, StiffnessFit, Weighed
from spinestiff.estimation.known import Known
from spinestiff.estimation.linear import MOST_PROFILED, linear_ratios
from spinestiff.estimation.mode import CLOSE_SD, MOST_FACTORISATIONS, likeliest, search
from spinestiff.estimation.objective import Trial
from spinestiff.estimation.point import WeighedPoint
from spinestiff.estimation.profiles import Likely, likely_ratios, telling_places
from spinestiff.estimation.search import lbfgsb
from spinestiff.estimation.status import FitStatus
from spinestiff.estimation.told import (
    open_end_warnings,
    ratio_covariance,
    told,
    trial_warnings,
    unsettled_warnings,
)
from spinestiff.estimation.weighed import AT_LIMIT, WeighedFit, WeighedProblem
from spinestiff.imaging.features import Orientation
from spinestiff.mechanics.equilibrium import EquilibriumProblem

# An interval that covers more of the bounds (in log) than this says that the data can't tell.
WIDEST_INTERVAL = 0.9
# Shares of the log ratios to start from, tried in this order.
NEARER_STARTS = (1.0, 0.75, 0.5, 0.25)


def fit_stiffness(
    problem: EquilibriumProblem | Sequence[EquilibriumProblem],
    trials: Sequence[Trial],
    names: Sequence[str] = ("lateral_bending", "tissue"),
    method: Method = "weighed",
    start: Start | Mapping[str, float] | None = None,
    *,
    known: Known | None = None,
    bounds: tuple[float, float] = RATIO_BOUNDS,
    orientation: Orientation = "procrustes",
    extent: Extent = "everything",
    observer: OnFitStep | None = None,
    max_iterations: int = 80,
    close_sd: float = CLOSE_SD,
) -> StiffnessFit:
    """Stiffness ratios whose equilibria show what the radiographs show (Eq. 8).

    Parameters
    ----------
    problem : one for all trials or one a trial (supports depend on the pushed side).
    trials : radiographs under known pushes, unloaded ones of the same sequences among them: they show where the
        patient stood and how corners were annotated.
    names : parameters to estimate, see ``anatomy.stiffness.parameter_group`` and, of regions and levels,
        ``anatomy.regions.parameter_groups``; ("everything",) is the one-ratio model.
    method : "weighed" (``estimation.weighed``) or "paper" (equal weights, L-BFGS-B with the adjoint gradient).
    start : where the search begins, or no more of it than its ratios by name.
    known : beside the trials; default the usual priors and an exact geometry.
    bounds : lowest and highest ratio.
    orientation : of a vertebra in the picture, "procrustes" or "covariance".
    extent : "estimate" alone; with the "shape" of the likelihood, for a fit on a finer mesh; with "intervals"; or
        "everything": variance budget and, of ratios with profiles, other priors as well.
    observer : called after every evaluation but that of the default ratios.
    max_iterations : evaluations of all trials by each of at most four searches, those beside their ends not counted
        (L-BFGS-B: iterations, and three times as many evaluations).
    close_sd : the weighed search ends once a step is shorter than so many standard deviations.

    Raises
    ------
    FitError : no trials, two of one label, no force, impossible bounds or names, a population that is not known or not
        of these ratios, no equilibrium at the start, or priors that leave residuals without a covariance.
    TorsoError : an unknown parameter, or one that the torso has nothing of.
    TrackingError : a trial's corners fit no vertebra.
    """
    began = time.perf_counter()
    problems = one_a_trial(problem, trials)
    check_asked(trials, names, method, bounds, extent)
    begin = start if isinstance(start, Start) else Start(start or {})
    known = known or Known()
    check_known(problems, trials, known.geometry, begin.states)
    groups = parameter_groups(problems[0].torso, names)
    names = tuple(group.name for group in groups)
    if known.population is not None and method != "weighed":
        raise FitError(f"population '{known.population}' with method '{method}', which knows no priors; wanted weighed")
    limits = (float(np.log(bounds[0])), float(np.log(bounds[1])))
    asked = weighed_problem(problems, trials, groups, orientation, observer, known, limits)
    trial_set = asked.trial_set
    first = first_logs(names, begin.ratios, bounds)
    default = None if begin.states is not None and method == "weighed" else _default_point(trial_set)
    if method == "weighed":
        nuisances = np.array([begin.nuisances.get(name, 0.0) for name in asked.unknowns.names])
        start_point = _start_point(asked, first, nuisances, default, begin.states)
        end = _weighed_end(asked, start_point, begin.rough, extent, max_iterations, close_sd)
    else:
        end = _paper_end(trial_set, first, default, limits, max_iterations)
    point, likely = end.point, None if end.weighed is None else end.weighed.likely
    intervals, opens = _ends(names, likely)
    edge = np.minimum(point.log_ratios - limits[0], limits[1] - point.log_ratios) < AT_LIMIT
    trial_set.cost.seconds = time.perf_counter() - began
    return StiffnessFit(
        ratios=trial_set.ratios(point.log_ratios),
        status=_status(end, edge, limits),
        covariance=end.covariance,
        intervals95=intervals,
        open_ends=opens,
        at_bound={name: bool(flag) for name, flag in zip(names, edge)},
        rmse_mm=point.rmse,
        default_rmse_mm=float("nan") if default is None else default.rmse,
        residuals=point.residuals,
        equilibria=point.equilibria,
        default_equilibria=() if default is None else default.equilibria,
        history=tuple(trial_set.history),
        cost=trial_set.cost,
        method=method,
        orientation=orientation,
        bounds=(float(bounds[0]), float(bounds[1])),
        warnings=(
            *trial_warnings(asked, default, point),
            *open_end_warnings(opens, bounds),
            *unsettled_warnings(end.search, likely, names, close_sd),
        ),
        weighed=end.weighed,
    )


@dataclass(frozen=True)
class _End:
    """Where a method's search ended.

    Attributes
    ----------
    status : of the search. covariance : (P, P) of the log ratios, NaN without one.
    search, weighed : of the weighed method.
    """

    point: Evaluation
    status: FitStatus
    covariance: Floats
    search: WeighedFit | None = None
    weighed: Weighed | None = None


def _weighed_end(
    asked: WeighedProblem,
    start: WeighedPoint,
    rough: StiffnessFit | None,
    extent: Extent,
    max_iterations: int,
    close_sd: float,
) -> _End:
    coarser = _of_the_same(asked, rough)
    places = () if coarser is None else coarser.places
    if len(start.log_ratios) > MOST_PROFILED:
        found = search(asked, start, max_iterations, close_sd)
    else:
        tilt = None if coarser is None else coarser.tilt
        found = likeliest(asked, start, max_iterations, close_sd, tilt)
    likely, known = _likely(asked, found, extent, places)
    weighed = told(asked, found, likely, known, places, extent == "everything")
    return _End(found.point.evaluation, found.status, ratio_covariance(found), found, weighed)


def _paper_end(
    trial_set: TrialSet, first: Floats, default: Evaluation | None, limits: tuple[float, float], max_iterations: int
) -> _End:
    point = default if default is not None and not first.any() else _first_point(trial_set, first, default)
    trial_set.note(point.log_ratios, point.loss, point, True)
    point, status = lbfgsb(trial_set, point, limits, max_iterations)
    return _End(point, status, np.full((len(first),) * 2, np.nan))


def _status(end: _End, edge: np.ndarray, limits: tuple[float, float]) -> FitStatus:
    """Of the fit: a search that converged may have found that the radiographs can't tell; ``edge``: (P,) at a bound."""
    if end.status is not FitStatus.CONVERGED:
        return end.status
    # An estimate may end at a bound for no reason but that nothing holds it elsewhere.
    likely = None if end.weighed is None else end.weighed.likely
    widest = 0.0 if likely is None else (likely.high - likely.low).max() / (limits[1] - limits[0])
    if widest >= WIDEST_INTERVAL or np.isinf(end.covariance).any():
        return FitStatus.NOT_IDENTIFIABLE
    return FitStatus.AT_BOUND if edge.any() else FitStatus.CONVERGED


def _start_point(
    asked: WeighedProblem,
    first: Floats,
    nuisances: Floats,
    default: Evaluation | None,
    starts: Sequence[TorsoState] | None,
) -> WeighedPoint:
    if starts is not None:
        try:
            start = asked.solve(first, nuisances, starts=starts, most_factorisations=MOST_FACTORISATIONS)
        except EquilibriumError:
            asked.trial_set.note(first, float("nan"), None, False)
        else:
            asked.trial_set.note(start.log_ratios, float("nan"), start.evaluation, True)
            return start
    near = None if default is None else asked.at(default)
    # A start may lie where tissue creases, and take hundreds of factorisations; nearer to the default it does not.
    for share in NEARER_STARTS if first.any() else ():
        nearer = np.clip(share * first, *asked.limits)
        try:
            start = asked.solve(nearer, nuisances, near, most_factorisations=MOST_FACTORISATIONS)
            break
        except EquilibriumError:
            asked.trial_set.note(nearer, float("nan"), None, False)
    else:
        try:
            start = asked.solve(first, nuisances, near)
        except EquilibriumError as error:
            raise NoMinimum(f"no equilibrium at the start of the fit, {error}") from None
    asked.trial_set.note(start.log_ratios, float("nan"), start.evaluation, True)
    return start


def _of_the_same(asked: WeighedProblem, rough: StiffnessFit | None) -> Weighed | None:
    """What the rough fit tells, if it is of the same ratios, trials and nuisances."""
    if rough is None or rough.weighed is None or rough.names != tuple(group.name for group in asked.trial_set.groups):
        return None
    found, names = rough.weighed, tuple(one.name for one in rough.weighed.nuisances)
    same = names == asked.unknowns.names and len(rough.residuals) == len(asked.trial_set.trials)
    return found if same and all(len(place.slope.nuisances) == asked.size for place in found.places) else None


def _likely(
    asked: WeighedProblem, found: WeighedFit, extent: Extent, rough: tuple[Place, ...]
) -> tuple[Likely | None, tuple[Place, ...]]:
    """Intervals and draws, where they are asked for, and the places that they, or the shape, come from."""
    if extent == "estimate" or not found.status.usable:
        return None, ()
    places = [Place(*place) for place in found.visited]
    if len(found.point.log_ratios) > MOST_PROFILED:
        return (None if extent == "shape" else linear_ratios(found, places, asked.limits)), ()
    if extent == "shape":
        return None, telling_places(asked, found, places)
    return likely_ratios(asked, found, places, rough)


def _ends(
    names: Sequence[str], likely: Likely | None
) -> tuple[dict[str, tuple[float, float]], dict[str, tuple[bool, bool]]]:
    if likely is None:
        return dict.fromkeys(names, (float("nan"), float("nan"))), dict.fromkeys(names, (False, False))
    low, high = np.exp(likely.low), np.exp(likely.high)
    intervals = {name: (float(a), float(b)) for name, a, b in zip(names, low, high)}
    return intervals, {name: (bool(a), bool(b)) for name, a, b in zip(names, likely.open_low, likely.open_high)}


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
        raise NoMinimum(f"no equilibrium at the start of the fit, {error}") from None
