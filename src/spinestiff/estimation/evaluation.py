"""All trials of a fit in equilibrium at one set of ratios, and first order around it (paper 4.2, Eqs. 6-8, 10).

A displacement under a given force goes with the compliance 1/xi, so the linear model of a step is taken in
p = 1 - xi/xi_new, which equals the step in log xi for small ones. From default stiffness to a ten times softer spine,
the model in log xi would overshoot by a factor of e^7; in p it is exact for a single spring.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import ParameterGroup, StiffnessRatios, parameter_group
from spinestiff.arrays import Floats, ShortRepr
from spinestiff.errors import EquilibriumError
from spinestiff.estimation.load_acts import changed_load, load_changes
from spinestiff.estimation.objective import Residuals, Trial, make_target, residuals, root_mean_square
from spinestiff.estimation.unknowns import ACTS, LOADING, PLACING, POWERS, SCALED, place_of
from spinestiff.imaging.features import Orientation
from spinestiff.mechanics.equilibrium import Equilibrium, EquilibriumProblem
from spinestiff.mechanics.loads import LoadCase
from spinestiff.mechanics.places import shoulder_force
from spinestiff.mechanics.terms import Term
from spinestiff.parallel import in_parallel

if TYPE_CHECKING:
    from spinestiff.mechanics.sensitivity import Linearisation

# No person folds under a push. A torso whose bones turn farther than this from their place at rest, rad, has given way:
# the way to where it comes to rest is long, and tells nothing of the person.
FOLDED = math.radians(90.0)


def compliance_step(change: Floats) -> Floats:
    """p = 1 - xi/xi_new for a change of log xi; dx/d log xi times p predicts a displacement under a given force."""
    return -np.expm1(-np.asarray(change))


def log_step(p: Floats) -> Floats:
    """Inverse of ``compliance_step``."""
    return -np.log1p(-np.asarray(p))


@dataclass(frozen=True)
class FitStep:
    """One evaluation during a fit, for progress and history.

    Attributes
    ----------
    iteration : evaluations so far, 0 = start.
    ratios : name -> value tried.
    loss : mm^2 (equal weights) or without unit (weighed), NaN where no equilibrium was found.
    rmse_mm : corner RMSE of places; not what the loss is made of.
    accepted : whether the fit moved there.
    """

    iteration: int
    ratios: Mapping[str, float]
    loss: float
    rmse_mm: float
    accepted: bool


OnFitStep = Callable[[FitStep], None]


@dataclass
class FitCost:
    """What a fit took: seconds of wall time, and equilibria, Newton iterations and numeric factorisations of those
    evaluations that had an equilibrium in each trial."""

    equilibria: int = 0
    newton_iterations: int = 0
    factorisations: int = 0
    seconds: float = 0.0


@dataclass(frozen=True, repr=False)
class Evaluation(ShortRepr):
    """All trials in equilibrium at one set of log ratios and of acts (T, len(ACTS))."""

    log_ratios: Floats
    acts: Floats
    equilibria: tuple[Equilibrium, ...]
    residuals: tuple[Residuals, ...]

    @property
    def loss(self) -> float:
        """Of equal weights, mm^2 (Eq. 8)."""
        return sum(part.loss for part in self.residuals)

    @property
    def values(self) -> Floats:
        return np.concatenate([part.values for part in self.residuals])

    @property
    def rmse(self) -> float:
        return root_mean_square(self.residuals)


@dataclass(frozen=True, repr=False)
class Slope(ShortRepr):
    """First order around a point.

    Attributes
    ----------
    tangents : of each trial.
    moves : of each trial (dofs, P), its state in log ratio.
    acted : of each trial (dofs, len(ACTS)), its state in its acts; None where they were not asked for. The act
        "motion" moves no state.
    """

    tangents: tuple[Linearisation, ...]
    moves: tuple[Floats, ...]
    acted: tuple[Floats, ...] | None = None


def acted(
    problem: EquilibriumProblem,
    load: LoadCase,
    ratios: StiffnessRatios | None,
    acts: Floats,
    changes: Sequence[LoadCase] | None = None,
) -> tuple[EquilibriumProblem, LoadCase, StiffnessRatios | None]:
    """What has to be solved where a trial's acts (len(ACTS),) are not 0. ``changes``: of ``load``, if known."""
    if not acts.any():
        return problem, load, ratios
    scaled = tuple(parameter_group(name, problem.torso.joints.kinds) for name in SCALED)
    groups, values = ((), np.empty(0)) if ratios is None else (ratios.groups, ratios.values)
    ratios = StiffnessRatios((*groups, *scaled), np.concatenate([values, np.exp(POWERS @ acts)]))
    changes = load_changes(load, problem.torso) if changes is None else changes
    return problem.with_place(place_of(acts)), changed_load(load, changes, acts), ratios


class TrialSet:
    """Trials under load with their problems and targets; solves them and counts what it costs."""

    def __init__(
        self,
        problems: Sequence[EquilibriumProblem],
        trials: Sequence[Trial],
        groups: tuple[ParameterGroup, ...],
        orientation: Orientation,
        observer: OnFitStep | None,
    ) -> None:
        self.problems, self.trials, self.groups = tuple(problems), tuple(trials), groups
        self.targets = tuple(make_target(p.torso, t, orientation) for p, t in zip(problems, trials))
        self.cost = FitCost()
        self.history: list[FitStep] = []
        self._observer = observer
        # Of the last point alone: they are large.
        self._tangents: tuple[Evaluation, list[Linearisation]] | None = None
        self._scaled = tuple(parameter_group(name, problems[0].torso.joints.kinds) for name in SCALED)
        self._changes = [load_changes(t.load, p.torso) for p, t in zip(problems, trials)]

    def ratios(self, log_ratios: Floats) -> StiffnessRatios:
        return StiffnessRatios(self.groups, np.exp(log_ratios))

    def solve(
        self,
        log_ratios: Floats,
        near: Evaluation | None = None,
        slope: Slope | None = None,
        acts: Floats | None = None,
        starts: Sequence[TorsoState] | None = None,
        linearised: bool = False,
        most_factorisations: float = np.inf,
    ) -> Evaluation:
        """Equilibria of all trials, each from its last one and on its factor.

        Parameters
        ----------
        acts : (T, len(ACTS)) of what is not quite known; default none.
        starts : states where nothing is near.
        linearised : ``slope`` of what is found comes next; the tangents that tell that it is stable are kept for it.
        most_factorisations : of a trial; one that needs more is given up.

        Raises
        ------
        EquilibriumError : a trial has none, or none was found with so many factorisations.
        """
        acts = np.zeros((len(self.trials), len(ACTS))) if acts is None else acts
        self._tangents = None

        def solved(i: int) -> tuple[Equilibrium, Linearisation | None]:
            start: TorsoState | Linearisation | None = None if starts is None else starts[i]
            if near is not None:
                start = near.equilibria[i].state
            if slope is not None:
                start = slope.tangents[i]
            try:
                problem, load, ratios = self._asked(i, log_ratios, acts[i])
                if linearised:
                    return problem.solve_linearised(
                        load, ratios, start, largest_turn=FOLDED, most_factorisations=most_factorisations
                    )
                equilibrium = problem.solve(
                    load, ratios, start, largest_turn=FOLDED, most_factorisations=most_factorisations
                )
                return equilibrium.require(), None
            except EquilibriumError as error:
                raise EquilibriumError(f"{self.trials[i].label or f'trial {i + 1}'}: {error}") from None

        # The largest load first: where it has no equilibrium, which may take long to see, the others are not solved.
        order = sorted(range(len(self.trials)), key=lambda i: -self.trials[i].load.size)
        outcomes = dict(zip(order, in_parallel(solved, order)))
        found, parts, tangents = [], [], []
        for i in range(len(self.trials)):
            equilibrium, tangent = outcomes[i]
            self.cost.equilibria += 1
            self.cost.newton_iterations += equilibrium.iterations
            self.cost.factorisations += equilibrium.factorisations
            found.append(equilibrium)
            parts.append(residuals(self.problems[i].torso, self.targets[i], equilibrium.state))
            if tangent is not None:
                tangents.append(tangent)
        point = Evaluation(np.array(log_ratios), np.array(acts), tuple(found), tuple(parts))
        self._tangents = (point, tangents) if linearised else None
        return point

    def slope(self, point: Evaluation, with_acts: bool = False) -> Slope:
        """Forward sensitivities (Eq. 6) at a point, of ratios and, ``with_acts``, of what is not quite known."""

        def of_trial(i: int) -> tuple[Linearisation, Floats, Floats]:
            linearisation = self._linearised(point, i)
            if not with_acts:
                return linearisation, linearisation.forward(self.groups), np.empty(0)
            return linearisation, *self._moved(i, linearisation, point.acts[i])

        self._count_linearised(point)
        tangents, moves, acted = zip(*in_parallel(of_trial, range(len(self.trials))))
        return Slope(tangents, moves, acted if with_acts else None)

    def jacobian(self, point: Evaluation, slope: Slope) -> Floats:
        """(n, P) of the stacked equally weighed residuals in log ratio."""
        return np.concatenate([part.along(moves) for part, moves in zip(point.residuals, slope.moves)])

    def gradient(self, point: Evaluation) -> Floats:
        """df/d log ratio by the adjoint (Eqs. 7, 10)."""

        def of_trial(i: int) -> Floats:
            g = point.residuals[i].gradient(point.equilibria[i].state.dofs)
            return self._linearised(point, i).adjoint(g, self.groups)

        self._count_linearised(point)
        return np.asarray(np.sum(in_parallel(of_trial, range(len(self.trials))), axis=0))

    def note(self, log_ratios: Floats, loss: float, point: Evaluation | None, accepted: bool) -> None:
        """Keep an evaluation, and tell it."""
        values = self.ratios(log_ratios).as_dict()
        rmse = float("nan") if point is None else point.rmse
        self.history.append(FitStep(len(self.history), values, loss, rmse, accepted))
        if self._observer:
            self._observer(self.history[-1])

    def _asked(
        self, i: int, log_ratios: Floats, acts: Floats
    ) -> tuple[EquilibriumProblem, LoadCase, StiffnessRatios | None]:
        """Problem, load and ratios of a trial with its acts (len(ACTS),)."""
        return acted(self.problems[i], self.trials[i].load, self.ratios(log_ratios), acts, self._changes[i])

    def _count_linearised(self, point: Evaluation) -> None:
        """Count the factorisations that ``_linearised`` of all trials takes."""
        if self._tangents is None or self._tangents[0] is not point:
            self.cost.factorisations += len(self.trials)

    def _linearised(self, point: Evaluation, i: int) -> Linearisation:
        if self._tangents is not None and self._tangents[0] is point:
            return self._tangents[1][i]
        problem, load, ratios = self._asked(i, point.log_ratios, point.acts[i])
        return problem.linearise(point.equilibria[i], load, ratios)

    def _moved(self, i: int, linearisation: Linearisation, acts: Floats) -> tuple[Floats, Floats]:
        """(dofs, P) a trial's state in log ratio, and (dofs, len(ACTS)) in its acts."""
        problem, groups = linearisation.system, (*self.groups, *self._scaled)
        # The force acts by its log on the load alone, which it scales.
        changes: list[Term] = [self._changes[i][0].scaled(float(np.exp(acts[0]))), *self._changes[i][1:]]
        turns = bool(problem.supports.held[problem.torso.bone("pelvis")].all())
        if not turns:
            changes.append(shoulder_force(problem.supports))
        columns = linearisation.forward(groups, changes, place=turns)
        moves, scaled, rest = np.split(columns, [len(self.groups), len(groups)], axis=1)
        acted = scaled @ POWERS
        acted[:, : len(LOADING)] = rest[:, : len(LOADING)]
        places = [ACTS.index(name) for name in PLACING]
        acted[:, places if turns else places[1:]] = rest[:, len(LOADING) :]
        return moves, acted
