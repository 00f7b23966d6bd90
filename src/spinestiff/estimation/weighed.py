"""The weighed fit: the most probable ratios and nuisances, with errors as large and as shared as they are.

With log ratios q (flat inside their bounds), nuisances n ~ N(0, 1) and residuals r(q, n) of the channels,

    phi(q, n) = r^T Sigma^-1 r / 2 + n^T n / 2

is minimised by Gauss-Newton steps. Nuisances that act on an equilibrium (forces, supports, the trunk's size) are solved
for as the ratios are, at no further equilibrium: each step ends in one at the ratios and nuisances that it found. What
is added to a picture (place, stance, annotation, rest geometry, model discrepancy) is eliminated in closed form, as
covariance. Sigma depends on the ratios through the size of the model's motion; it is that of the last iterate, so that
the fit solves the estimating equation J^T Sigma^-1 r = 0 and no ratio is chosen for the error that it would excuse.

Nor is a ratio chosen for the nuisances' reach: a softer torso moves farther under each of them, so that they explain
more of any residuals. The likelihood of the ratios is that with nuisances integrated out, to second order around the
most probable ones (Laplace's approximation; Tierney and Kadane, J Am Stat Assoc 1986; 81:82),

    psi(q) = min over n of phi(q, n) + log det H(q) / 2,   H = I + K^T Sigma^-1 K,   K = dr/dn,

and the estimate its minimum (``mode.likeliest``).

What is held of the ratios themselves, if anything (``ratio_priors``), is rows of r with variance 1, linear in q.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, orth, solve_triangular

from spinestiff.anatomy.state import TorsoState
from spinestiff.arrays import Floats, Ints, ShortRepr
from spinestiff.estimation.evaluation import Evaluation, TrialSet
from spinestiff.estimation.known import Known
from spinestiff.estimation.kriging import Kriging
from spinestiff.estimation.moving import Moving
from spinestiff.estimation.noise import Noise, Seen, lower_root, restricted_factor
from spinestiff.estimation.objective import Target, Trial, make_target, residuals
from spinestiff.estimation.point import WeighedPoint, WeighedSlope
from spinestiff.estimation.ratio_priors import RatioPrior
from spinestiff.estimation.sights import (
    MarkerResiduals,
    MarkerTarget,
    PedicleTarget,
    SightResiduals,
    further_sights,
    marked_anew,
    sight_residuals,
)
from spinestiff.estimation.status import FitStatus
from spinestiff.estimation.unknowns import ACTS, Unknowns, is_placed, unknowns_of
from spinestiff.imaging.features import Orientation
from spinestiff.mechanics.equilibrium import EquilibriumProblem

AT_LIMIT = 1e-6  # of a log ratio
TINY = np.finfo(np.float64).tiny
_MOTION = ACTS.index("motion")


@dataclass(frozen=True, repr=False)
class Weights(ShortRepr):
    """The covariance of the residuals that a step is taken with, and what it was made with.

    Attributes
    ----------
    root : (n, n) lower Cholesky factor. tracking_factor : of tracking's errors.
    inflation : (n of channels,) of a vertebra's own variance.
    """

    root: Floats
    tracking_factor: float
    inflation: Floats

    def whiten(self, columns: Floats) -> Floats:
        """Root^-1 columns."""
        return np.asarray(solve_triangular(self.root, columns, lower=True))


class WeighedProblem:
    """Trials with all that is not quite known about them.

    Parameters
    ----------
    trial_set : the trials under load. still : those without, and their torso's problems.
    known : beside the trials.
    ratio_prior : what is held of the ratios; None: they are flat in log.
    limits : of the log ratios, in search and intervals. What one at a limit can't explain no chance explains
        (``p_value``).

    Attributes
    ----------
    moving : what the loaded trials show, and the errors that grow with its motion.
    shown : numbers of each trial's radiographs, its own first. Own ones are numbered as the trials are, the loaded
        first; those from other sides come after them.
    """

    def __init__(
        self,
        trial_set: TrialSet,
        still: Sequence[tuple[EquilibriumProblem, Trial]],
        orientation: Orientation,
        known: Known,
        ratio_prior: RatioPrior | None = None,
        limits: tuple[float, float] = (-np.inf, np.inf),
    ) -> None:
        self.trial_set, self.priors, self.limits = trial_set, known.priors, limits
        count = len(trial_set.groups)
        self.ratio_prior = ratio_prior or RatioPrior(np.zeros((0, count)), np.zeros(0), {})
        self.unknowns: Unknowns = unknowns_of(
            trial_set.problems, trial_set.trials, known.priors, known.taped, trial_set.groups
        )
        targets = [make_target(problem.torso, trial, orientation) for problem, trial in still]
        both = (*trial_set.targets, *targets)
        problems = (*trial_set.problems, *(problem for problem, _ in still))
        at_rest: list[SightResiduals] = [
            residuals(p.torso, target, p.torso.rest_pose) for p, target in zip(problems, both)
        ]
        sequences = [target.trial.push or f"trial {i + 1}" for i, target in enumerate(both)]
        marked = marked_anew([target.trial for target in both], sequences)
        seen = [
            Seen(target, sequence, target.trial.annotated, marked=mark)
            for target, sequence, mark in zip(both, sequences, marked)
        ]
        further = further_sights([problem.torso for problem in problems], both, orientation)
        for one in further:
            torso = problems[one.trial].torso
            at_rest.append(sight_residuals(torso, one.target, torso.rest_pose))
            by_hand = isinstance(one.target, MarkerTarget | PedicleTarget) or one.target.trial.annotated
            seen.append(Seen(one.target, one.sequence or sequences[one.trial], by_hand, one.radiograph, one.marked))
        more = any(not isinstance(one.target, MarkerTarget) for one in further)
        rest = problems[0].torso.rest_pose.bone_positions[problems[0].torso.vertebra_bones] if more else None
        self.noise = Noise(seen, at_rest, known.geometry, known.priors, rest)
        self._constant = self.noise.constant
        aside = [(one.radiograph, one.trial) for one in further if one.radiograph >= len(both)]
        self.shown = tuple((i, *dict.fromkeys(n for n, trial in aside if trial == i)) for i in range(len(both)))
        self._further = tuple((len(both) + number, one.trial) for number, one in enumerate(further))
        """Place among what is seen, and trial, of what trials show beside their own corners."""
        sights = [
            (row, trial, one.target)
            for (row, trial), one in zip(self._further, further)
            if trial < len(trial_set.trials)
        ]
        self.moving = Moving(trial_set, self.noise, at_rest, sights, known.priors)
        self._resting = np.zeros(self.noise.size)
        for row, part in enumerate(at_rest):
            if row not in self.moving.rows:
                self._resting[self.noise.of(row)] = self.noise.channels[row].apply(part.difference)
        self._measured = [
            (i, ACTS.index(name), value, sd)
            for i, trial in enumerate(trial_set.trials)
            for name, (value, sd) in trial.supports.items()
            # What nothing holds is where the forces leave it, which the model says by itself.
            if is_placed(name, trial_set.problems[i])
        ]
        self.data = self.noise.size + len(self._measured)
        self.size = self.data + len(self.ratio_prior.rows)

    def solve(
        self,
        log_ratios: Floats,
        nuisances: Floats,
        near: WeighedPoint | None = None,
        slope: WeighedSlope | None = None,
        starts: Sequence[TorsoState] | None = None,
        most_factorisations: float = np.inf,
    ) -> WeighedPoint:
        """All trials in equilibrium, from what is near or from ``starts``.

        EquilibriumError where one has none, or where none is found with ``most_factorisations``.
        """
        acts = self.unknowns.acts @ nuisances
        found = self.trial_set.solve(
            log_ratios,
            None if near is None else near.evaluation,
            None if slope is None else slope.slope,
            acts,
            starts,
            linearised=True,
            most_factorisations=most_factorisations,
        )
        further = tuple(
            sight_residuals(self.trial_set.problems[trial].torso, target, found.equilibria[trial].state)
            for _, trial, target in self.moving.sights
        )
        channels = self._resting.copy()
        for row, trial, part in self.moving.parts(found, further):
            moved = part.difference + _larger(part, acts[trial]) * self.moving.motion(part, row)
            channels[self.noise.of(row)] = self.noise.channels[row].apply(moved)
        supports = np.array([(acts[i, act] - value) / sd for i, act, value, sd in self._measured])
        held = self.ratio_prior.residuals(log_ratios)
        return WeighedPoint(np.array(nuisances), found, np.concatenate([channels, supports, held]), further)

    def at(self, evaluation: Evaluation) -> WeighedPoint:
        """A point to start others from: what was solved with all nuisances 0."""
        return WeighedPoint(np.zeros(len(self.unknowns)), evaluation, np.full(self.size, np.nan))

    def slope(self, point: WeighedPoint) -> WeighedSlope:
        """First order around a point."""
        found = self.trial_set.slope(point.evaluation, with_acts=True)
        assert found.acted is not None
        ratios = np.zeros((self.size, len(point.log_ratios)))
        nuisances = np.zeros((self.size, len(self.unknowns)))
        for row, i, part in self.moving.parts(point.evaluation, point.further):
            channels, acts = self.noise.channels[row], point.evaluation.acts[i]
            rows = self.noise.of(row)
            larger = 1.0 + _larger(part, acts)
            ratios[rows] = larger * channels.apply(part.moved(found.moves[i]))
            columns = larger * channels.apply(part.moved(found.acted[i]))
            columns[:, _MOTION] = (
                0.0 if isinstance(part, MarkerResiduals) else channels.apply(self.moving.motion(part, row))
            )
            nuisances[rows] = columns @ self.unknowns.acts[i]
        for row, (i, act, _, sd) in enumerate(self._measured):
            nuisances[self.noise.size + row] = self.unknowns.acts[i, act] / sd
        ratios[self.data :] = self.ratio_prior.rows
        return WeighedSlope(found, ratios, nuisances)

    def further_rows(self, trial: int) -> Ints:
        """Rows of what a trial shows beside its own corners; the loaded trials come first, then those without load."""
        rows = [np.arange(self.size)[self.noise.of(row)] for row, of in self._further if of == trial]
        return np.concatenate([np.zeros(0, dtype=np.int64), *rows])

    @property
    def radiographs(self) -> tuple[Ints, ...]:
        """Rows of each radiograph, by its number (``shown``): of its corners, then of its pedicles."""
        rows: dict[int, list[Ints]] = {}
        for i, one in enumerate(self.noise.seen):
            number = i if one.radiograph is None else one.radiograph
            rows.setdefault(number, []).append(np.arange(self.size)[self.noise.of(i)])
        return tuple(np.concatenate(rows[number]) for number in sorted(rows))

    @property
    def showing_more(self) -> frozenset[int]:
        """Numbers of the radiographs that show more than corners of frontal ones."""
        found = (self.noise.seen[row] for row, _ in self._further)
        pictures = (one.radiograph for one in found if not isinstance(one.target, MarkerTarget))
        return frozenset(number for number in pictures if number is not None)

    @property
    def trials(self) -> int:
        """How many there are, loaded and without load."""
        return len(self.noise.seen) - len(self._further)

    def weights(self, point: WeighedPoint, slope: WeighedSlope, before: Weights | None) -> Weights:
        """The covariance at a point: tracking's size by restricted likelihood, outlying vertebrae with less weight."""
        rest, channels = self._untracked(point), slice(0, self.noise.size)
        free = point.values - slope.nuisances @ point.nuisances
        inflation = np.ones(self.noise.size) if before is None else before.inflation
        marginal = (rest + slope.nuisances @ slope.nuisances.T)[channels, channels]
        factor = restricted_factor(
            self.noise,
            marginal,
            free[channels],
            slope.ratios[channels],
            self.priors.tracking_factor,
            inflation,
            (slope.ratios[self.data :], free[self.data :]),
        )
        if before is not None:
            inflation = self._inflation(marginal, free, slope.ratios, factor, inflation)
        rest[channels, channels] += self.noise.tracking(factor, inflation)
        return Weights(lower_root(rest), factor, inflation)

    def outlying(self, inflation: Floats) -> list[tuple[str, str, float]]:
        """Radiographs and vertebrae whose own errors are larger than usual by ``inflation`` (n,), and by how much."""
        found = []
        for i, label, names in self._named():
            factors = inflation[self.noise.of(i)].reshape(len(names), -1)[:, 0]
            found += [(label, name, float(np.sqrt(factor))) for name, factor in zip(names, factors) if factor > 1.0]
        return found

    def inflation(self, outlying: Iterable[tuple[str, str, float]]) -> Floats:
        """(n,) inverse of ``outlying``; of radiographs and vertebrae that are not there it is 1."""
        known = {(label, name): factor**2 for label, name, factor in outlying}
        found = np.ones(self.noise.size)
        for i, label, names in self._named():
            mine = found[self.noise.of(i)].reshape(len(names), -1)
            mine *= np.array([known.get((label, name), 1.0) for name in names])[:, None]
        return found

    def _named(self) -> list[tuple[int, str, tuple[str, ...]]]:
        """Of each radiograph's corners the place among what is seen, its label and its vertebrae."""
        corners = [(i, one.target.trial) for i, one in enumerate(self.noise.seen) if isinstance(one.target, Target)]
        return [(i, trial.label or f"trial {i + 1}", trial.corners.vertebrae) for i, trial in corners]

    def covariance(self, point: WeighedPoint, tracking_factor: float = 1.0, inflation: Floats | None = None) -> Floats:
        """(n, n) of all residuals at given nuisances, with tracking's errors ``tracking_factor`` times as predicted and
        ``inflation`` (n,) of a vertebra's own variance."""
        whole, channels = self._untracked(point), slice(0, self.noise.size)
        whole[channels, channels] += self.noise.tracking(tracking_factor, inflation)
        return whole

    def _untracked(self, point: WeighedPoint) -> Floats:
        """(n, n) covariance of all residuals without tracking's errors."""
        whole = np.eye(self.size)
        channels = slice(0, self.noise.size)
        whole[channels, channels] = self._constant + self.moving.discrepancy(point) + self.moving.drag(point)
        return whole

    def as_expected(self, point: WeighedPoint) -> Weights:
        """The covariance at a point with tracking's errors as large as predicted."""
        return Weights(lower_root(self.covariance(point)), 1.0, np.ones(self.noise.size))

    def p_value(self, point: WeighedPoint, slope: WeighedSlope) -> float:
        """Of residuals as large, with the covariance before any scale or weight is fitted.

        Of what neither a change of the ratios within their limits takes away of the data's nor another place of a
        sequence in the picture, which a study fits beforehand; what is held of ratios is no data. NaN where nothing
        is left.
        """
        from scipy.stats import chi2

        low, high = point.log_ratios - self.limits[0], self.limits[1] - point.log_ratios
        ratios = slope.ratios[:, np.minimum(low, high) > AT_LIMIT]
        data = slice(0, self.data)
        placed = np.zeros((self.data, self.noise.placed.shape[1]))
        placed[: self.noise.size] = self.noise.placed
        expected = self.as_expected(point).root[data, data]
        root = lower_root(expected @ expected.T + slope.nuisances[data] @ slope.nuisances[data].T)
        free = point.values[data] - slope.nuisances[data] @ point.nuisances
        values, taken = (solve_triangular(root, a, lower=True) for a in (free, np.hstack([ratios[data], placed])))
        q = orth(taken / np.maximum(np.linalg.norm(taken, axis=0), TINY))
        if self.data <= q.shape[1]:
            return float("nan")
        left = values - q @ (q.T @ values)
        return float(chi2.sf(float(left @ left), self.data - q.shape[1]))

    def log_likelihood(self, point: WeighedPoint, slope: WeighedSlope, weights: Weights) -> float:
        """Of the data at a fit's end, nuisances integrated out to first order; what is held of ratios is no data."""
        data = slice(0, self.data)
        own = (weights.root @ weights.root.T)[data, data]
        root = lower_root(own + slope.nuisances[data] @ slope.nuisances[data].T)
        free = point.values[data] - slope.nuisances[data] @ point.nuisances
        left = solve_triangular(root, free, lower=True)
        size = 2.0 * np.sum(np.log(np.diag(root))) + self.data * np.log(2.0 * np.pi)
        return -0.5 * float(left @ left + size)

    def _inflation(self, marginal: Floats, values: Floats, slopes: Floats, factor: float, before: Floats) -> Floats:
        whole = lower_root(marginal + self.noise.tracking(factor, before)), True
        free, fixed = (a[: self.noise.size] for a in (values, slopes))
        held, rows = (a[self.data :] for a in (values, slopes))
        both = cho_solve(whole, np.column_stack([fixed, free]))
        precision = fixed.T @ both[:, :-1] + rows.T @ rows
        p = np.linalg.lstsq(precision, -fixed.T @ both[:, -1] - rows.T @ held, rcond=None)[0]
        solved = both[:, -1] + both[:, :-1] @ p
        return self.noise.inflation(self.noise.own_errors(solved, factor, before), factor)


def _larger(part: SightResiduals, acts: Floats) -> float:
    """By how much of itself a motion is seen larger than it is; cameras know nothing of the X-ray source."""
    return 0.0 if isinstance(part, MarkerResiduals) else float(acts[_MOTION])


def phi(point: WeighedPoint, weights: Weights) -> float:
    """Of ratios and nuisances; see the module's text."""
    whitened = weights.whiten(point.values)
    return 0.5 * float(whitened @ whitened + point.nuisances @ point.nuisances)


@dataclass(frozen=True, repr=False)
class Reduced(ShortRepr):
    """The linear model around a point with nuisances eliminated: |values + ratios p|^2 / 2 over compliance steps p.

    Attributes
    ----------
    values : (n + M,). ratios : (n + M, P).
    nuisances, follow : the most probable ones (M,) and their change per step (M, P).
    log_precision : half the log determinant of their precision (M, M).
    gain : by how much phi is less at the most probable nuisances than at the point's.
    """

    values: Floats
    ratios: Floats
    nuisances: Floats
    follow: Floats
    log_precision: float
    gain: float

    @property
    def psi(self) -> float:
        """Of the ratios, nuisances integrated out; see the module's text."""
        return 0.5 * float(self.values @ self.values) + self.log_precision


def reduced(point: WeighedPoint, slope: WeighedSlope, weights: Weights) -> Reduced:
    """Nuisances eliminated in closed form."""
    both = weights.whiten(
        np.column_stack([slope.nuisances, slope.ratios, point.values - slope.nuisances @ point.nuisances])
    )
    m = slope.nuisances.shape[1]
    stacked = np.vstack([both[:, :m], np.eye(m)])
    others = np.vstack([both[:, m:], np.zeros((m, both.shape[1] - m))])
    q, triangle = np.linalg.qr(stacked)
    solved = np.linalg.solve(triangle, q.T @ others)
    left = others - stacked @ solved
    log_precision = float(np.sum(np.log(np.abs(np.diag(triangle)))))
    here = np.concatenate([both[:, -1] + both[:, :m] @ point.nuisances, point.nuisances])
    gain = 0.5 * float(here @ here - left[:, -1] @ left[:, -1])
    return Reduced(left[:, -1], left[:, :-1], -solved[:, -1], -solved[:, :-1], log_precision, gain)


@dataclass(frozen=True, repr=False)
class WeighedFit(ShortRepr):
    """Where the search (``mode``) ended.

    Attributes
    ----------
    visited : the places on the way there, in their order.
    tilt : half the log determinant of the nuisances' precision, over the log ratios; None: phi was minimised, not psi.
    short : by how many standard deviations the last step, which was not taken, would have gone on.
    carried : by how many it went on in the last round for the tilt's slope, which was not the last that was wanted.
    """

    point: WeighedPoint
    slope: WeighedSlope
    weights: Weights
    status: FitStatus
    visited: tuple[tuple[WeighedPoint, WeighedSlope], ...]
    short: float = 0.0
    tilt: Kriging | None = None
    carried: float = 0.0
