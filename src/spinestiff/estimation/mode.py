"""The search for the most probable ratios and nuisances of a weighed fit.

Gauss-Newton steps end it in a few evaluations where phi is as the linear model has it. Where ratios trade against each
other it is a curved valley, across which such a step leaves the floor: then the emulator (``emulator``) through all
places that were solved, the refused one among them, tells where the floor is.

The estimate is where psi is least (``weighed``), phi and half a log determinant. The second changes slowly: it is
solved for a little beside phi's least, and carried from there (``likeliest``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear, minimize

from spinestiff.arrays import Floats
from spinestiff.errors import EquilibriumError
from spinestiff.estimation.emulator import Emulator, Place, by_differences
from spinestiff.estimation.evaluation import compliance_step, log_step
from spinestiff.estimation.kriging import Kriging
from spinestiff.estimation.point import WeighedPoint, WeighedSlope
from spinestiff.estimation.status import FitStatus
from spinestiff.estimation.weighed import Reduced, WeighedFit, WeighedProblem, Weights, phi, reduced

# The search ends once an undamped step is shorter than so many standard deviations.
CLOSE_SD = 1e-3
# So near is near enough where another search goes on from there: phi's least, from which psi's lies a few tenths of a
# standard deviation off, or the estimate on a coarser mesh.
ROUGHLY_SD = 0.02
# Steps that promise less than this (three sds) are mixed with so many before, to at most so many times the step.
SMALL, MIXED, MOST_SHARE = 4.5, 3, 8.0
# Where so many steps in a row promise less than ``NEARLY`` (a twentieth of an sd) and no less than half of the one
# before, equilibria that jump by more than that are as near as the search can come.
NEARLY, ENOUGH = 1e-3, 6
# Soft tissue that is pressed together creases, and where a crease appears phi jumps. Where a step that promises less
# than this (a tenth of an sd) is refused, it is shortened once; if that is refused, too, the search is as near as it
# can come.
SETTLED = 5e-3
# Where one that promises less than this (an sd) is refused at every length, and the emulator knows no better place,
# that is as near as the search can come, too.
NEAR_ENOUGH = 0.5
# So is a place that promises less than ``CREASED`` (a quarter of an sd) where so many such steps were refused in all.
CREASED, MOST_REFUSED = 1.0 / 32.0, 6
# And so is one after so many steps none of which promised less than half of the least before: where equilibria jump,
# the weights of either side may lead to the other one for ever.
MOST_WANDERED = 12
# A solve that takes more factorisations is on its way to another equilibrium than the one before; it is given up, and a
# shorter step is tried. Useful ones took up to 52 (of a step by a factor of 3.5), most one to four.
MOST_FACTORISATIONS = 60
# One step changes a ratio by at most these factors: beyond, the linear model says nothing.
LARGEST_SOFTENING, LARGEST_STIFFENING = 8.0, 8.0
SHORTEST_STEP = 1.0 / 64.0
# Places that a search has refused lead to the next one so many times; then steps are shortened.
MOST_GUIDED = 4
SAME = 1e-4  # of log ratios
# How far beside a place, in log ratio, the nuisances' precision is solved for to know how it changes: far enough that
# jumps between equilibria matter little.
BESIDE = 0.25
# It is solved for again where the search has gone farther from there than so many standard deviations or in log ratio,
# so many times in all.
CHANGED_SD, CHANGED_LOG, MOST_TILTS = 0.5, 0.3, 3
# How far, in log ratio, the emulator is believed beyond the places it was made from.
BEYOND = 0.2
# Weight of a step's own length: along a direction that the data say nothing of, a step is short and not as long as
# rounding makes it; its cost is below the smallest decrease.
SHORT = 1e-4


def likeliest(
    problem: WeighedProblem,
    start: WeighedPoint,
    max_evaluations: int,
    close_sd: float = CLOSE_SD,
    tilt: Kriging | None = None,
) -> WeighedFit:
    """The likeliest ratios, nuisances integrated out, and the most probable nuisances there; see ``search``.

    Parameters
    ----------
    max_evaluations : of each search.
    tilt : half the log determinant of the nuisances' precision, if it is known, as from a coarser mesh.
    """
    if tilt is not None:
        return search(problem, start, max_evaluations, close_sd, tilt)
    found = search(problem, start, max_evaluations, max(close_sd, ROUGHLY_SD))
    known: list[tuple[Floats, float, Floats]] = []
    for _ in range(MOST_TILTS):
        if not found.status.usable:
            break
        before, model = found, reduced(found.point, found.slope, found.weights)
        slope, beside = _precision_slope(problem, found, model)
        known.append((found.point.log_ratios, model.log_precision, slope))
        places, values, slopes = (np.array(part) for part in zip(*known))
        tilt = Kriging(places, values[:, None], slopes[:, None, :])
        found = search(problem, found.point, max_evaluations, close_sd, tilt, (found.slope, found.weights))
        found = replace(found, visited=(*before.visited, *_pairs(beside), *found.visited))
        moved = found.point.log_ratios - before.point.log_ratios
        far = float(np.linalg.norm(model.ratios @ moved))
        if far < CHANGED_SD and np.abs(moved).max() < CHANGED_LOG:
            break
    else:
        # The slope of the last round is that of a place so far off.
        found = replace(found, carried=far)
    return found


def _precision_slope(problem: WeighedProblem, fit: WeighedFit, model: Reduced) -> tuple[Floats, list[Place]]:
    """(P,) of half the log determinant of the nuisances' precision in log ratio, by differences, and the places beside
    the fit's that were solved for it. Where there is no equilibrium on either side, it is taken as 0."""
    point, slope, beside = fit.point, np.zeros(len(fit.point.log_ratios)), list[Place]()
    for i, axis in enumerate(np.eye(len(slope))):
        for sign in (1.0, -1.0) if point.log_ratios[i] + BESIDE <= problem.limits[1] else (-1.0,):
            target = point.log_ratios + sign * BESIDE * axis
            if target[i] < problem.limits[0]:
                continue
            nuisances = model.nuisances + model.follow @ compliance_step(target - point.log_ratios)
            try:
                place = problem.solve(target, nuisances, point, fit.slope, most_factorisations=MOST_FACTORISATIONS)
            except EquilibriumError:
                problem.trial_set.note(target, float("nan"), None, False)
                continue
            problem.trial_set.note(target, phi(place, fit.weights), place.evaluation, False)
            beside.append(Place(place, problem.slope(place).light))
            changed = reduced(place, beside[-1].slope, fit.weights).log_precision - model.log_precision
            slope[i] = changed / (sign * BESIDE)
            break
    return slope, beside


def search(
    problem: WeighedProblem,
    start: WeighedPoint,
    max_evaluations: int,
    close_sd: float = CLOSE_SD,
    tilt: Kriging | None = None,
    known: tuple[WeighedSlope, Weights] | None = None,
) -> WeighedFit:
    """Ratios and nuisances of the least phi, and ``tilt`` if there is one, from ``start``.

    Parameters
    ----------
    max_evaluations : equilibria of all trials, the start's among them.
    close_sd : the length of an undamped step, in standard deviations, below which the search ends.
    tilt : of the log ratios, added to phi. known : first order around the start, and the weights there.
    """
    slope, weights = (problem.slope(start), None) if known is None else known
    point = start
    visited: list[Place] = []
    evaluations, near, rough, wandered, least = 1, 0, 0, 0, np.inf
    trail = list[tuple[Floats, Floats]]()
    promised = np.inf
    while True:
        weights = problem.weights(point, slope, weights)
        step, nuisances, predicted = gauss_newton_step(point, slope, weights, problem.limits, _steepness(tilt, point))
        near = near + 1 if 0.5 * promised < predicted < NEARLY else 0
        wandered, least = (0, predicted) if predicted < 0.5 * least else (wandered + 1, least)
        promised, short = predicted, float(np.sqrt(2.0 * predicted))
        lost = rough > MOST_REFUSED or wandered > MOST_WANDERED
        settled = near > ENOUGH or (lost and predicted < CREASED)
        if predicted < 0.5 * close_sd**2 or settled:
            return WeighedFit(point, slope, weights, FitStatus.CONVERGED, _pairs(visited), short, tilt)
        before = phi(point, weights) + _added(tilt, point.log_ratios)
        trail = _ahead(trail, point, step, nuisances) if predicted < SMALL else []
        mixed = _mixed(trail, slope, weights) if len(trail) > 1 else None
        places, nearly = [Place(point, slope), *visited], predicted < SETTLED
        ahead = _Ahead(problem, places, weights, step, nuisances, mixed, nearly, tilt)
        moved: WeighedPoint | None = None
        while moved is None and (target := ahead.target()) is not None:
            if evaluations >= max_evaluations:
                return WeighedFit(point, slope, weights, FitStatus.ITERATION_LIMIT, _pairs(visited), short, tilt)
            evaluations += 1
            try:
                trial = problem.solve(*target, point, slope, most_factorisations=MOST_FACTORISATIONS)
                after = phi(trial, weights) + _added(tilt, trial.log_ratios)
            except EquilibriumError:
                problem.trial_set.note(target[0], float("nan"), None, False)
                ahead.refuse(None)
                continue
            # Below rounding of the equilibria a decrease is none.
            taken = after <= before - 1e-4 * ahead.share * predicted or (predicted < 1e-4 and after <= before + 1e-4)
            problem.trial_set.note(target[0], after, trial.evaluation, taken)
            if taken:
                moved = trial
                break
            rough += predicted < CREASED and not ahead.mixing
            ahead.refuse(trial)
        visited = [*visited, Place(point, slope.light), *ahead.refused]
        if moved is None:
            status = FitStatus.CONVERGED if predicted < NEAR_ENOUGH else FitStatus.STALLED
            return WeighedFit(point, slope, weights, status, _pairs(visited), short, tilt)
        point, slope = moved, problem.slope(moved)


class _Ahead:
    """Where a search goes from a place: by the mixed steps, then by its own one, led by the emulator, in shorter ones.

    Parameters
    ----------
    places : this one, and those visited before. step : of the compliances (P,), to ``nuisances`` (M,).
    mixed : the way (P + M,) by ``_mixed``. nearly : the step promises so little that it is shortened once, not led.

    Attributes
    ----------
    share : of the step that is tried. refused : places that tell the emulator where to go.
    """

    def __init__(
        self,
        problem: WeighedProblem,
        places: list[Place],
        weights: Weights,
        step: Floats,
        nuisances: Floats,
        mixed: Floats | None,
        nearly: bool,
        tilt: Kriging | None,
    ) -> None:
        self._problem, self._places, self._weights = problem, places, weights
        self._step, self._nuisances, self._mixed = step, nuisances, mixed
        self._tilt = tilt
        self._guiding, self._shortest = not nearly, 0.25 if nearly else SHORTEST_STEP
        self.share, self.refused = 1.0, list[Place]()

    @property
    def mixing(self) -> bool:
        """The target is that of the mixed steps."""
        return self._mixed is not None

    def target(self) -> tuple[Floats, Floats] | None:
        """Log ratios and nuisances to try next; None where nothing is left."""
        here = self._places[0].point
        if self._mixed is not None:
            p = len(self._step)
            return np.clip(here.log_ratios + self._mixed[:p], *self._problem.limits), here.nuisances + self._mixed[p:]
        while self.share >= self._shortest:
            if not (self._guiding and self.refused):
                target = np.clip(here.log_ratios + log_step(self.share * self._step), *self._problem.limits)
                return target, here.nuisances + self.share * (self._nuisances - here.nuisances)
            guided = _guided([*self._places, *self.refused], self._weights, self._problem.limits, self._tilt)
            tried = [here.log_ratios, *(place.point.log_ratios for place in self.refused)]
            if not any(np.allclose(guided[0], where, rtol=0.0, atol=SAME) for where in tried):
                return guided
            # It has nothing new to tell, as where ratios are at their bounds.
            self._guiding, self.share = False, 0.25 * self.share
        return None

    def refuse(self, trial: WeighedPoint | None) -> None:
        """The last target led nowhere: to a place that is no better, or to none (None)."""
        if self._mixed is not None:
            self._mixed = None
        elif trial is None:
            self.share *= 0.25
            # Led to a place without equilibrium, the search would be led there again.
            self._guiding = self._guiding and not self.refused
        else:
            if self._guiding:
                self.refused.append(Place(trial, self._problem.slope(trial).light))
                self._guiding = len(self.refused) <= MOST_GUIDED
            if not self._guiding:
                self.share *= 0.25


def _added(tilt: Kriging | None, log_ratios: Floats) -> float:
    return 0.0 if tilt is None else float(tilt.at(log_ratios[None])[0, 0])


def _steepness(tilt: Kriging | None, point: WeighedPoint) -> Floats:
    """(P,) of the tilt."""
    return np.zeros(len(point.log_ratios)) if tilt is None else tilt.slopes(point.log_ratios[None])[0, 0]


def _ahead(
    trail: list[tuple[Floats, Floats]], point: WeighedPoint, step: Floats, nuisances: Floats
) -> list[tuple[Floats, Floats]]:
    """The last places of a search, log ratios and nuisances (P + M,), with the steps wished there, and this one."""
    here = np.concatenate([point.log_ratios, point.nuisances])
    return [*trail[-MIXED:], (here, np.concatenate([log_step(step), nuisances - point.nuisances]))]


def _mixed(trail: Sequence[tuple[Floats, Floats]], slope: WeighedSlope, weights: Weights) -> Floats | None:
    """The way (P + M,) to where the steps of a fixed-point iteration would vanish, or None.

    What the steps change by along the trail is taken as linear (Anderson 1965; Walker and Ni 2011). A step that has
    grown leads away from a place where it would vanish, as on a ridge between two valleys; then as much of it as may be
    is taken.
    """
    p, columns = slope.ratios.shape[1], weights.whiten(np.column_stack([slope.ratios, slope.nuisances]))
    places, steps = (np.array(part).T for part in zip(*trail))
    sized = np.vstack([columns @ steps, steps[p:]])
    step, longest = steps[:, -1], MOST_SHARE * float(np.linalg.norm(sized[:, -1]))
    if float(sized[:, -2] @ (sized[:, -1] - sized[:, -2])) >= 0.0:
        return np.asarray(MOST_SHARE * step)
    shares = np.linalg.lstsq(np.diff(sized, axis=1), sized[:, -1])[0]
    way = step - np.diff(places + steps, axis=1) @ shares
    long = np.concatenate([columns @ way, way[p:]])
    if not float(long @ sized[:, -1]) > 0.0:
        return None
    return np.asarray(min(1.0, longest / float(np.linalg.norm(long))) * way)


def _pairs(places: list[Place]) -> tuple[tuple[WeighedPoint, WeighedSlope], ...]:
    return tuple((place.point, place.slope) for place in places)


def _guided(
    places: list[Place], weights: Weights, limits: tuple[float, float], tilt: Kriging | None
) -> tuple[Floats, Floats]:
    """Where the emulator through all places, the best one first, has the least phi with ``tilt``, and its nuisances."""
    emulator = Emulator(places, weights, telling=False)
    known = emulator.log_ratios
    low = np.maximum(known.min(axis=0) - BEYOND, limits[0])
    high = np.minimum(known.max(axis=0) + BEYOND, limits[1])

    def wanted(where: Floats) -> Floats:
        return emulator.phi(where) if tilt is None else emulator.phi(where) + tilt.at(where)[:, 0]

    # From the best of the places between the best one and the others, too: the floor may lie behind a rise.
    between = np.concatenate([known[:1] + part * (known - known[:1]) for part in (0.0, 0.25, 0.5, 0.75)])
    start = between[int(np.argmin(wanted(between)))]
    found = minimize(by_differences(wanted, 1e-3), start, jac=True, method="L-BFGS-B", bounds=list(zip(low, high))).x
    return found, emulator.nuisances(found)[0]


def gauss_newton_step(
    point: WeighedPoint, slope: WeighedSlope, weights: Weights, limits: tuple[float, float], steepness: Floats
) -> tuple[Floats, Floats, float]:
    """Compliance step (P,) inside the bounds, the nuisances (M,) there, and the decrease it promises of phi and of what
    rises by ``steepness`` (P,) a log ratio."""
    model = reduced(point, slope, weights)
    low = np.maximum(limits[0] - point.log_ratios, -np.log(LARGEST_SOFTENING))
    high = np.minimum(limits[1] - point.log_ratios, np.log(LARGEST_STIFFENING))
    floor, ceiling = compliance_step(low) - 1e-14, compliance_step(high) + 1e-14
    kept_short = np.hstack([SHORT * np.eye(len(low)), np.zeros((len(low), 1))])
    rows = np.vstack([np.column_stack([model.ratios, model.values]), kept_short])
    triangle = np.asarray(np.linalg.qr(rows, mode="r"))
    # |T p + t|^2 / 2 + g p is that of t + T^-T g, give or take a constant.
    tilted = solve_triangular(triangle[:-1, :-1], steepness, trans="T")
    p = lsq_linear(triangle[:-1, :-1], -triangle[:-1, -1] - tilted, (floor, ceiling), method="bvls").x
    left = model.values + model.ratios @ p
    predicted = phi(point, weights) - 0.5 * float(left @ left) - float(steepness @ p)
    return p, model.nuisances + model.follow @ p, max(predicted, 0.0)
