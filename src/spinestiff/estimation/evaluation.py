"""All trials of a fit in equilibrium at one set of ratios, and first order around it (paper 4.2, Eqs. 6-8, 10).

A displacement under a given force goes with the compliance 1/xi, so the linear model of a step is taken in
p = 1 - xi/xi_new, which equals the step in log xi for small ones. From default stiffness to a ten times softer spine,
the model in log xi would overshoot by a factor of e^7; in p it is exact for a single spring.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import ParameterGroup, StiffnessRatios
from spinestiff.arrays import Floats, ShortRepr
from spinestiff.errors import EquilibriumError
from spinestiff.estimation.objective import (
    Residuals,
    Trial,
    make_target,
    push_height_change,
    residuals,
    root_mean_square,
)
from spinestiff.estimation.uncertainty import Nuisance, ResidualLayout, UncertaintySettings
from spinestiff.imaging.features import FEATURE_COUNT, Orientation
from spinestiff.mechanics.equilibrium import Equilibrium, EquilibriumProblem

if TYPE_CHECKING:
    from spinestiff.mechanics.sensitivity import Linearisation


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
    loss : mm^2, NaN where no equilibrium was found.
    rmse_mm : corner RMSE of places; not what the loss is made of where trials have an unloaded reference.
    accepted : whether the fit moved there.
    damping : Levenberg-Marquardt's; NaN for L-BFGS-B.
    """

    iteration: int
    ratios: Mapping[str, float]
    loss: float
    rmse_mm: float
    accepted: bool
    damping: float


OnFitStep = Callable[[FitStep], None]


@dataclass
class FitCost:
    """What a fit took: equilibria solved, Newton iterations, numeric factorisations, seconds of wall time."""

    equilibria: int = 0
    newton_iterations: int = 0
    factorisations: int = 0
    seconds: float = 0.0


@dataclass(frozen=True, repr=False)
class Evaluation(ShortRepr):
    """All trials in equilibrium at one set of log ratios."""

    log_ratios: Floats
    equilibria: tuple[Equilibrium, ...]
    residuals: tuple[Residuals, ...]

    @property
    def loss(self) -> float:
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
    jacobian : (n, P) of the stacked residuals in log ratio.
    responses : (n_i, 4) of each trial, its residuals per log force, per mm of the pushed point's height, per relative
        error of the simulated motion, and per such an error that grows from -1 at the lowest to 1 at the highest
        vertebra.
    """

    tangents: tuple[Linearisation, ...]
    jacobian: Floats
    responses: tuple[Floats, ...]


class TrialSet:
    """Trials with their problems and targets; solves them and counts what it costs."""

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

    def ratios(self, log_ratios: Floats) -> StiffnessRatios:
        return StiffnessRatios(self.groups, np.exp(log_ratios))

    def solve(self, log_ratios: Floats, near: Evaluation | None = None, slope: Slope | None = None) -> Evaluation:
        """Equilibria of all trials, each from its last one and on its factor.

        Raises
        ------
        EquilibriumError : a trial has none.
        """
        ratios, found, parts = self.ratios(log_ratios), [], []
        for i, (problem, trial, target) in enumerate(zip(self.problems, self.trials, self.targets)):
            start: TorsoState | Linearisation | None = None if near is None else near.equilibria[i].state
            if slope is not None:
                start = slope.tangents[i]
            try:
                equilibrium = problem.solve(trial.load, ratios, start=start)
            except EquilibriumError as error:
                raise EquilibriumError(f"{trial.label or f'trial {i + 1}'}: {error}") from None
            self.cost.equilibria += 1
            self.cost.newton_iterations += equilibrium.iterations
            self.cost.factorisations += equilibrium.factorisations
            if not equilibrium.converged:
                raise EquilibriumError(f"{trial.label or f'trial {i + 1}'}: {equilibrium.status.value}")
            found.append(equilibrium)
            parts.append(residuals(problem.torso, target, equilibrium.state))
        return Evaluation(np.array(log_ratios), tuple(found), tuple(parts))

    def slope(self, point: Evaluation) -> Slope:
        """Forward sensitivities (Eq. 6) at a point, of ratios and of what is uncertain in the push."""
        tangents, rows, responses = [], [], []
        for i, part in enumerate(point.residuals):
            linearisation = self._linearise(point, i)
            tangents.append(linearisation)
            rows.append(part.along(linearisation.forward(self.groups)))
            load = self.trials[i].load
            changes = (load, push_height_change(load, self.problems[i].torso.rest_pose))
            loaded = part.along(np.stack([linearisation.load_derivative(c) for c in changes], axis=1))
            responses.append(np.column_stack([loaded, *self._motion_errors(i, part)]))
        return Slope(tuple(tangents), np.concatenate(rows), tuple(responses))

    def gradient(self, point: Evaluation) -> Floats:
        """df/d log ratio by the adjoint (Eqs. 7, 10)."""
        total = np.zeros(len(self.groups))
        for i, part in enumerate(point.residuals):
            g = part.gradient(point.equilibria[i].state.dofs)
            total += self._linearise(point, i).adjoint(g, self.groups)
        return total

    def nuisances(self, slope: Slope, settings: UncertaintySettings) -> tuple[Nuisance, ...]:
        """Errors of gauge, pushed point and model, each common to the frames of a push."""
        pushes = [trial.push or f"trial {i + 1}" for i, trial in enumerate(self.trials)]
        found = []
        known = {
            "force": settings.force_sd,
            "push height": settings.push_height_sd_mm,
            "motion": settings.motion_sd,
            "motion along the spine": settings.motion_sd,
        }
        for j, (name, sd) in enumerate(known.items()):
            for push in dict.fromkeys(pushes):
                columns = [part[:, j] * (push == mine) for part, mine in zip(slope.responses, pushes)]
                found.append(Nuisance(f"{name} of {push}", np.concatenate(columns), sd))
        return (*found, *self._picture_shifts(pushes, settings.picture_shift_sd_mm))

    def _motion_errors(self, i: int, part: Residuals) -> tuple[Floats, Floats]:
        """What mesh and geometry do to a simulated motion: scale it, and scale it differently up and down the spine."""
        torso, target = self.problems[i].torso, self.targets[i]
        motion = part.values - residuals(torso, target, torso.rest_pose).values
        height = 1.0 - 2.0 * target.rows / max(len(torso.vertebrae) - 1, 1)
        return motion, motion * np.repeat(height, FEATURE_COUNT)

    def _picture_shifts(self, pushes: Sequence[str], sd: float) -> list[Nuisance]:
        """The patient stands a little elsewhere in each radiograph than at rest."""
        found = []
        for axis, name in enumerate(("along columns", "along rows")):
            for i, push in enumerate(pushes):
                columns = []
                for j, target in enumerate(self.targets):
                    shift = np.zeros_like(target.z)
                    shift[..., axis] = np.sqrt(target.weights)[:, None] * (i == j)
                    columns.append(shift.reshape(-1))
                found.append(Nuisance(f"place {name}, {push} radiograph {i + 1}", np.concatenate(columns), sd))
        return found

    def _linearise(self, point: Evaluation, i: int) -> Linearisation:
        self.cost.factorisations += 1
        return self.problems[i].linearise(point.equilibria[i], self.trials[i].load, self.ratios(point.log_ratios))

    def layout(self) -> ResidualLayout:
        """What the stacked residuals belong to."""
        return ResidualLayout(
            np.concatenate([target.rows for target in self.targets]),
            np.concatenate([np.full(len(target.rows), i) for i, target in enumerate(self.targets)]),
            np.concatenate([target.z - target.z.mean(axis=1, keepdims=True) for target in self.targets]),
        )

    def note(self, log_ratios: Floats, point: Evaluation | None, accepted: bool, damping: float = float("nan")) -> None:
        values = self.ratios(log_ratios).as_dict()
        loss, rmse = (float("nan"),) * 2 if point is None else (point.loss, point.rmse)
        self.history.append(FitStep(len(self.history), values, loss, rmse, accepted, damping))
        if self._observer:
            self._observer(self.history[-1])
