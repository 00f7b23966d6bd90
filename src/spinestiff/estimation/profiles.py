"""Intervals, joint region and draws of the ratios, from the profile of the likelihood (``weighed``).

An end of ratio i's 95 % interval is where the least psi with that ratio given has risen by 3.84/2, times the square of
one width factor that simulated subjects have told; the joint region of two is where it has risen by 5.99/2. Ends are
looked for on the emulator, solved on the model, and looked for again until both agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from skimage.measure import find_contours

from spinestiff.arrays import Floats, ShortRepr
from spinestiff.errors import EquilibriumError
from spinestiff.estimation.emulator import Emulator, Place, tells
from spinestiff.estimation.mode import MOST_FACTORISATIONS
from spinestiff.estimation.point import WeighedPoint
from spinestiff.estimation.tracing import Profile, Tracer, profile_kind
from spinestiff.estimation.weighed import Reduced, WeighedFit, WeighedProblem, Weights, phi, reduced

CONFIDENCE = 0.95
WIDTH_FACTOR = 1.05
# Ends agree once the emulator's psi and the model's differ by less than this there; on a coarser mesh, where they tell
# the shape alone, once they differ by less than ``ROUGHLY``.
CLOSE_ENOUGH, ROUGHLY = 0.1, 0.5
MOST_ROUNDS = 8
# A place as near as this to a solved one, in the estimate's standard deviations, is not solved, since the emulator
# knows psi and its slope next to it, unless that is farther in log ratio than ``NEAR_LOG``; one farther than
# ``FARTHEST_STEP`` from all of them is approached first. None is solved twice, give or take ``SAME``.
NEAR, NEAR_LOG, FARTHEST_STEP, SAME = 0.15, 0.15, 1.2, 1e-3
# So many standard deviations around a place without equilibrium nothing is tried again; around one whose most probable
# nuisances were not found once more, from where the emulator has them then.
HOPELESS = 0.5
# Nuisances that the emulator has so wrong that the place would tell it nothing are solved for again, so many times, by
# steps of at most so many prior standard deviations, from the best of them; where phi rises, by so much less.
MOST_AGAIN, LONGEST_STEP, SHORTENED = 3, 0.6, 0.4
DRAWS, CANDIDATES = 500, 4000
GRID = 61


@dataclass(frozen=True, kw_only=True, repr=False)
class Likely(ShortRepr):
    """What the data leave of the ratios.

    Attributes
    ----------
    low, high : (P,) ends of the 95 % intervals, log. open_low, open_high : (P,) the end is the fit's bound.
    kinds : (P,) "bounded", "one-sided", "flat", "at a bound" or "several minima".
    profiles : (P,).
    region : (n, 2) outline of the joint 95 % region of two ratios, not cut at the bounds; None for another number.
    draws : (D, P) log ratios and (D, M) nuisances, equally probable. effective : independent draws they are worth.
    emulator : of psi.
    settled : emulator and model agreed at the ends in the end, and the model has an equilibrium at each, and where the
        emulator was lower than at the estimate.
    likelier : the likeliest place that was solved, if it is likelier than the estimate by more than ``CLOSE_ENOUGH``.
    """

    low: Floats
    high: Floats
    open_low: np.ndarray
    open_high: np.ndarray
    kinds: tuple[str, ...]
    profiles: tuple[Profile, ...]
    region: Floats | None
    draws: tuple[Floats, Floats]
    effective: float
    emulator: Emulator
    settled: bool = True
    likelier: WeighedPoint | None = None


@dataclass(frozen=True)
class _Explored:
    """Where psi is known after the model was solved at the ends of the intervals.

    Attributes
    ----------
    places : that were solved, the estimate first. emulator : through them. profiles : (P,) on it.
    ends : low and high one of each ratio, all log ratios and whether it is the fit's bound.
    settled : as ``Likely`` has it. candidates, density : places inside the bounds, as ``_candidates`` has them.
    """

    places: list[Place]
    emulator: Emulator
    profiles: tuple[Profile, ...]
    ends: list[tuple[Floats, bool]]
    settled: bool
    candidates: Floats
    density: Floats


def likely_ratios(
    problem: WeighedProblem, fit: WeighedFit, visited: list[Place], rough: Sequence[Place] = ()
) -> tuple[Likely, tuple[Place, ...]]:
    """Intervals, region and draws, and the places that they come from; solves the model at the intervals' ends.

    Parameters
    ----------
    visited : places that the search solved.
    rough : places that are known on a coarser mesh (``Emulator``).
    """
    found = _explored(problem, fit, visited, rough, CLOSE_ENOUGH)
    best, ends, emulator = fit.point.log_ratios, found.ends, found.emulator
    low, high = (np.array([where[i // 2] for i, (where, _) in enumerate(ends) if i % 2 == side]) for side in (0, 1))
    open_low, open_high = (
        np.array([is_open for i, (_, is_open) in enumerate(ends) if i % 2 == side]) for side in (0, 1)
    )
    rise = 0.5 * region_rise(1)
    kinds = tuple(
        profile_kind(profile, best[i], bool(open_low[i]), bool(open_high[i]), problem.limits, rise)
        for i, profile in enumerate(found.profiles)
    )
    draws, effective = _draws(emulator, found.candidates, found.density)
    return (
        Likely(
            low=low,
            high=high,
            open_low=open_low,
            open_high=open_high,
            kinds=kinds,
            profiles=found.profiles,
            region=_region(emulator, best, low, high) if len(best) == 2 else None,
            draws=draws,
            effective=effective,
            emulator=emulator,
            settled=found.settled,
            likelier=_likelier(found.places, fit.weights),
        ),
        tuple(found.places),
    )


def telling_places(problem: WeighedProblem, fit: WeighedFit, visited: list[Place]) -> tuple[Place, ...]:
    """Places that tell the shape of psi to somebody who solves the intervals' ends on a finer mesh: of this one's ends
    no more is wanted than ``ROUGHLY``. Parameters as ``likely_ratios`` has them."""
    return tuple(_explored(problem, fit, visited, (), ROUGHLY).places)


def _explored(
    problem: WeighedProblem,
    fit: WeighedFit,
    visited: list[Place],
    rough: Sequence[Place],
    close_enough: float,
) -> _Explored:
    """Ends, solved until emulator and model agree there by ``close_enough``."""
    places = [Place(fit.point, fit.slope.light), *visited]
    model = reduced(fit.point, fit.slope, fit.weights)
    precision, covariance = bounded_precision(model, problem.limits)
    rise = 0.5 * region_rise(1)
    candidates, density = _candidates(fit.point.log_ratios, covariance, problem.limits)
    failed: list[Floats] = []
    for solved in range(MOST_ROUNDS + 1):
        emulator = Emulator(places, fit.weights, rough=rough)
        scouts = np.vstack([candidates, *(place.point.log_ratios for place in places)])
        tracer = Tracer(emulator, fit.point.log_ratios, covariance, problem.limits, scouts)
        profiles = tuple(tracer.profile(i, rise) for i in range(len(precision)))
        ends = [tracer.end(profile, i, sign, rise) for i, profile in enumerate(profiles) for sign in (-1.0, 1.0)]
        wanted = [where for where, _ in ends]
        heights = tracer.heights[: len(candidates)]
        if heights.min() < -close_enough:
            # Lower than the estimate: a hole between places, which would draw the draws.
            wanted.append(candidates[int(np.argmin(heights))])
        if solved == MOST_ROUNDS:
            settled = False
            break
        wrong, unsolved = _solve_ends(problem, fit, emulator, places, wanted, precision, failed, close_enough)
        if not wrong:
            settled = not unsolved
            break
    return _Explored(places, emulator, profiles, ends, settled, candidates, density)


def bounded_precision(model: Reduced, limits: tuple[float, float]) -> tuple[Floats, Floats]:
    """(P, P) of the log ratios to first order, and its inverse; what nothing tells is known by the bounds' width."""
    precision = model.ratios.T @ model.ratios + np.eye(model.ratios.shape[1]) / (limits[1] - limits[0]) ** 2
    return precision, np.asarray(np.linalg.inv(precision), float)


def _likelier(places: Sequence[Place], weights: Weights) -> WeighedPoint | None:
    """Of places, the estimate first, the likeliest as solved, if it is likelier than the estimate."""
    heights = [phi(place.point, weights) + reduced(place.point, place.slope, weights).log_precision for place in places]
    least = int(np.argmin(heights))
    return places[least].point if heights[least] < heights[0] - CLOSE_ENOUGH else None


def region_rise(count: int) -> float:
    """By how much 2 psi rises at the outline of the joint 95 % region of ``count`` ratios."""
    from scipy.stats import chi2

    return float(WIDTH_FACTOR**2 * chi2.ppf(CONFIDENCE, count))


def rise_at(problem: WeighedProblem, fit: WeighedFit, log_ratios: Floats) -> float:
    """By how much 2 psi is higher at other log ratios than at the estimate; solves the model.

    Raises
    ------
    EquilibriumError : it has no equilibrium there, or none was found with ``MOST_FACTORISATIONS`` a step.
    """
    point, slope, nuisances = fit.point, fit.slope, fit.point.nuisances
    # In two steps: ratios far off take their nuisances along.
    for share in (0.5, 1.0, 1.0):
        where = fit.point.log_ratios + share * (log_ratios - fit.point.log_ratios)
        point = problem.solve(where, nuisances, point, slope, most_factorisations=MOST_FACTORISATIONS)
        slope = problem.slope(point)
        model = reduced(point, slope, fit.weights)
        nuisances = model.nuisances
    return 2.0 * (model.psi - reduced(fit.point, fit.slope, fit.weights).psi)


def _solve_ends(
    problem: WeighedProblem,
    fit: WeighedFit,
    emulator: Emulator,
    places: list[Place],
    ends: list[Floats],
    precision: Floats,
    failed: list[Floats],
    close_enough: float,
) -> tuple[bool, list[int]]:
    """Solve the model at those ends where the emulator may be wrong: whether it was, and which could not be solved.

    ``places`` and ``failed``, log ratios where the most probable nuisances were not found, and
    twice those without equilibrium, are added to.
    """
    wrong, unsolved = False, []
    solved = list(emulator.log_ratios)
    for k, end in enumerate(ends):
        apart = np.array(solved) - end
        nearest = int(np.argmin(np.abs(apart).max(axis=1)))
        near = np.einsum("ki,ij,kj->k", apart, precision, apart) < NEAR**2
        if (near & (np.abs(apart).max(axis=1) < NEAR_LOG)).any():
            continue
        if min(np.abs(place.point.log_ratios - end).max() for place in places) < SAME:
            # Solved before, too far from its most probable nuisances to tell anything.
            unsolved.append(k)
            continue
        farther = np.abs(apart[nearest]).max() / FARTHEST_STEP
        where = end if farther <= 1.0 else end + apart[nearest] * (1.0 - 1.0 / farther)
        if sum((where - other) @ precision @ (where - other) < HOPELESS**2 for other in failed) > 1:
            unsolved.append(k)
            continue
        wrong |= farther > 1.0
        solved.append(where)
        try:
            near_by = _much_nearer(places, where, precision)
            place, height, found = solved_place(problem, fit, where, emulator.nuisances(where)[0], near_by)
        except EquilibriumError:
            problem.trial_set.note(where, float("nan"), None, False)
            unsolved.append(k)
            failed += [where, where]
            continue
        places.append(place)
        if found:
            wrong |= abs(height - float(emulator.psi(where)[0])) > close_enough
        else:  # the emulator has no use for it
            unsolved.append(k)
            failed.append(where)
    return wrong, unsolved


def _much_nearer(places: Sequence[Place], where: Floats, precision: Floats) -> WeighedPoint | None:
    """Of solved places, the estimate first, the nearest one, if the estimate is more than twice as far off."""
    apart = np.array([place.point.log_ratios for place in places]) - where
    squared = np.einsum("ki,ij,kj->k", apart, precision, apart)
    nearest = int(np.argmin(squared))
    return places[nearest].point if squared[nearest] < 0.25 * squared[0] else None


def solved_place(
    problem: WeighedProblem,
    fit: WeighedFit,
    log_ratios: Floats,
    nuisances: Floats,
    near: WeighedPoint | None = None,
) -> tuple[Place, float, bool]:
    """The model solved at log ratios (P,), psi at the most probable nuisances there, and whether those were found.

    Parameters
    ----------
    nuisances : (M,) to begin with. near : a place to start from; None: the estimate, on its tangents.

    Raises
    ------
    EquilibriumError : it has no equilibrium there.
    """
    least = reduced(fit.point, fit.slope, fit.weights).psi
    point, slope = (fit.point, fit.slope) if near is None else (near, None)
    lowest, longest = np.inf, LONGEST_STEP
    for number in range(1 + MOST_AGAIN):
        try:
            tried = problem.solve(log_ratios, nuisances, point, slope, most_factorisations=MOST_FACTORISATIONS)
            height = phi(tried, fit.weights)
            problem.trial_set.note(log_ratios, height, tried.evaluation, False)
        except EquilibriumError:
            if not number:
                raise
            problem.trial_set.note(log_ratios, float("nan"), None, False)
            height = np.inf
        if not number or height <= lowest:
            point, slope, lowest = tried, problem.slope(tried), height
            model = reduced(point, slope, fit.weights)
            if tells(point, model, least):
                return Place(point, slope.light), model.psi, True
        else:
            longest *= SHORTENED
        step = model.nuisances - point.nuisances
        nuisances = point.nuisances + min(1.0, longest / float(np.abs(step).max())) * step
    assert slope is not None
    return Place(point, slope.light), model.psi, False


def _region(emulator: Emulator, best: Floats, low: Floats, high: Floats) -> Floats | None:
    """The outline on a grid around the intervals."""
    rise = 0.5 * region_rise(2)
    reach = 0.45 * (high - low)
    axes = [np.linspace(low[i] - reach[i], high[i] + reach[i], GRID) for i in (0, 1)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    height = emulator.psi(grid.reshape(-1, 2)).reshape(GRID, GRID) - float(emulator.psi(best)[0])
    outlines: list[Floats] = find_contours(height, rise)  # type: ignore[no-untyped-call]
    if not outlines:
        return None
    outline = max(outlines, key=len)
    steps = np.array([axis[1] - axis[0] for axis in axes])
    return np.asarray(np.array([axis[0] for axis in axes]) + outline * steps)


def _candidates(best: Floats, covariance: Floats, limits: tuple[float, float]) -> tuple[Floats, Floats]:
    """Places (C, P) inside the bounds, more widely spread than draws will be, and their log density (C,)."""
    from scipy.stats import multivariate_t

    wide = multivariate_t(best, 1.3 * WIDTH_FACTOR**2 * covariance, df=4, seed=np.random.default_rng(0))
    candidates = np.atleast_2d(wide.rvs(CANDIDATES).reshape(CANDIDATES, -1))
    candidates = candidates[np.all((candidates >= limits[0]) & (candidates <= limits[1]), axis=1)]
    return candidates, np.atleast_1d(wide.logpdf(candidates))


def _draws(emulator: Emulator, candidates: Floats, density: Floats) -> tuple[tuple[Floats, Floats], float]:
    """Equally probable draws: candidates weighed by exp(-psi) over their own density, and drawn again."""
    random = np.random.default_rng(1)
    log_weight = -emulator.psi(candidates) / WIDTH_FACTOR**2 - density
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    # Systematic resampling: one uniform number, evenly spaced places on the cumulative weight along the direction in
    # which candidates spread most; chance leaves each place its share of that direction. Mixed again at the end.
    centred = candidates - candidates.mean(axis=0)
    order = np.argsort(centred @ np.linalg.svd(centred, full_matrices=False)[2][0], kind="stable")
    places = (np.arange(DRAWS) + random.uniform()) / DRAWS
    chosen = order[np.minimum(np.searchsorted(np.cumsum(weight[order]), places), len(candidates) - 1)]
    chosen = candidates[random.permutation(chosen)]
    nuisances = []
    for where in chosen:
        middle, spread = emulator.nuisances(where)
        root = np.linalg.cholesky(spread + 1e-12 * np.eye(len(spread)))
        nuisances.append(middle + WIDTH_FACTOR * root @ random.normal(size=len(middle)))
    effective = 1.0 / float(np.sum(weight**2))
    return (chosen, np.array(nuisances).reshape(len(chosen), -1)), effective
