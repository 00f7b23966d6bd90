"""Static equilibrium (Eqs. 4-5) by Newton's method with line search on the exact Hessian."""

from __future__ import annotations

import enum
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from spinestiff.anatomy.stiffness import StiffnessRatios
from spinestiff.anatomy.torso import TorsoModel, TorsoState, advance
from spinestiff.arrays import Floats
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.factor import Analysis, Factor
from spinestiff.mechanics.loads import LoadCase
from spinestiff.mechanics.potential import Potential, Stiffness
from spinestiff.mechanics.sensitivity import Linearisation
from spinestiff.mechanics.supports import Reaction, Supports
from spinestiff.mechanics.terms import BoneTerm

# A moment counts as a force at this arm, mm, so that one number measures both.
ROTATION_LENGTH = 30.0
RELATIVE_TOLERANCE = 1e-10
ABSOLUTE_TOLERANCE = 1e-8  # N
LARGEST_TURN = 0.5  # rad in one step
LARGEST_MOVE = 100.0  # mm in one step


class SolveStatus(enum.Enum):
    """How a solve ended; the text holds cause and remedy."""

    CONVERGED = "converged"
    ITERATION_LIMIT = (
        "not converged within the iteration limit; the load may exceed what this softness can carry: "
        "reduce the force or raise the ratios"
    )
    STALLED = (
        "the line search found no lower energy; the state may be a fold or a limit point: "
        "reduce the force or start from a nearer state"
    )
    INVERTED_START = "the start state has an inverted element; start from the rest pose"
    SINGULAR = "the stiffness matrix is singular; a bone is held by nothing or a stiffness is zero"
    SADDLE = "force balance without stability: the state is no energy minimum; start from a nearer state"


@dataclass(frozen=True)
class NewtonStep:
    """One iteration: residual N, energy N mm, smallest J, step length and whether the tangent was projected."""

    iteration: int
    residual: float
    energy: float
    smallest_j: float
    step: float
    projected: bool


@dataclass(frozen=True)
class Equilibrium:
    """The result of a solve; plain data.

    Attributes
    ----------
    state : the last accepted state, an equilibrium only if ``converged``.
    status : how the solve ended.
    energy : N mm, the loads' potential included.
    residual_norm : N, largest unbalanced force (moments over 30 mm).
    tolerance : N, what ``residual_norm`` was asked to reach.
    reactions : what the supports exert.
    history : one entry an iteration, of all attempts. factorisations : numeric factorisations of all attempts.
    smallest_j : smallest volume ratio at the integration points.
    """

    state: TorsoState
    status: SolveStatus
    energy: float
    residual_norm: float
    tolerance: float
    reactions: tuple[Reaction, ...]
    history: tuple[NewtonStep, ...] = field(repr=False)
    factorisations: int
    smallest_j: float

    @property
    def converged(self) -> bool:
        return self.status is SolveStatus.CONVERGED

    @property
    def iterations(self) -> int:
        return sum(step.step > 0.0 for step in self.history)

    def require(self) -> Equilibrium:
        """This equilibrium; raises EquilibriumError with cause and remedy unless it converged."""
        if not self.converged:
            raise EquilibriumError(f"{self.status.value} (residual {self.residual_norm:.2e} N)")
        return self

    def reaction(self, name: str) -> Floats:
        """(3,) N, the summed force of all supports whose name starts with ``name``; EquilibriumError if none does."""
        forces = [r.force for r in self.reactions if r.name.startswith(name)]
        if not forces:
            known = ", ".join(dict.fromkeys(r.name for r in self.reactions))
            raise EquilibriumError(f"no support '{name}'; there are {known}")
        return np.sum(forces, axis=0)


Observer = Callable[[NewtonStep], None]


class EquilibriumProblem:
    """A torso on its supports, ready to be loaded: pattern, analysis and constant data are built once.

    Parameters
    ----------
    torso, supports : what is solved.
    terms : further energies of bones, e.g. image terms (``mechanics.terms.BoneTerm``).
    backend : sparse solver, see ``mechanics.factor.Analysis``.
    """

    def __init__(
        self, torso: TorsoModel, supports: Supports, terms: Sequence[BoneTerm] = (), backend: str | None = None
    ) -> None:
        self.torso = torso
        self.supports = supports
        self.terms = tuple(terms)
        self.potential = Potential(torso)
        self._analysis = Analysis(self.potential.pattern.indptr, self.potential.pattern.indices, backend)
        held = np.flatnonzero(supports.held.ravel())
        self.held = held
        columns = np.repeat(np.arange(self.potential.dofs), np.diff(self.potential.pattern.indptr))
        mask = np.zeros(self.potential.dofs, dtype=bool)
        mask[held] = True
        self._held_entries = np.flatnonzero(mask[columns] | mask[self.potential.pattern.indices])
        self._held_diagonal = self.potential.pattern.indptr[held]

    def with_terms(self, terms: Sequence[BoneTerm]) -> EquilibriumProblem:
        """The same problem with other ``terms``; shares pattern and analysis."""
        other = object.__new__(EquilibriumProblem)
        other.__dict__.update(self.__dict__)
        other.terms = tuple(terms)
        return other

    def all_terms(self, load: LoadCase) -> tuple[BoneTerm, ...]:
        return (load, self.supports.springs, *self.terms)

    def solve(
        self,
        load: LoadCase,
        ratios: StiffnessRatios | None = None,
        start: TorsoState | None = None,
        observer: Observer | None = None,
        max_iterations: int = 100,
        tolerance: float | None = None,
    ) -> Equilibrium:
        """The state of least energy under ``load`` (Eq. 4), from ``start`` or the rest pose.

        ``tolerance`` is the residual to reach, N; default: 1e-10 of the load or 1e-8 N, the larger.

        Where a start fails, the rest pose is tried, then the load in four steps. What is returned says by its
        status whether it is an equilibrium; ``require()`` turns a failure into an error.
        """

        def newton(load: LoadCase, state: TorsoState) -> Equilibrium:
            wanted = self.tolerance(load) if tolerance is None else tolerance
            return self._newton(load, ratios, state, observer, max_iterations, wanted)

        attempts = [newton(load, start or self.torso.rest_pose)]
        if not attempts[-1].converged and start is not None:
            attempts.append(newton(load, self.torso.rest_pose))
        best = attempts[-1]
        if not best.converged:
            state = self.torso.rest_pose
            for share in (0.25, 0.5, 0.75, 1.0):
                attempts.append(newton(load.scaled(share), state))
                if not attempts[-1].converged:
                    break
                state = attempts[-1].state
            else:
                best = attempts[-1]
        return replace(
            best,
            history=tuple(step for attempt in attempts for step in attempt.history),
            factorisations=sum(attempt.factorisations for attempt in attempts),
        )

    def linearise(
        self, equilibrium: Equilibrium, load: LoadCase, ratios: StiffnessRatios | None = None
    ) -> Linearisation:
        """The tangent at a converged equilibrium, factorised, for sensitivities (Eqs. 6-7)."""
        return Linearisation(self, equilibrium, load, ratios)

    def free_gradient(
        self, state: TorsoState, stiffness: Stiffness, terms: Sequence[BoneTerm]
    ) -> tuple[Floats, Floats]:
        """The energy's gradient (dofs,), once with held DoFs set to zero and once as it is."""
        full = self.potential.gradient(state, stiffness, terms)
        free = full.copy()
        free[self.held] = 0.0
        return free, full

    def factorise(
        self, state: TorsoState, stiffness: Stiffness, terms: Sequence[BoneTerm], project: bool = False
    ) -> Factor:
        """The tangent stiffness with held DoFs replaced by the identity, factorised."""
        return self.numeric_factor(self.potential.hessian(state, stiffness, terms, project))

    def numeric_factor(self, values: Floats) -> Factor:
        """Factor of a Hessian's values (in the potential's pattern) with held DoFs replaced by the identity."""
        values = values.copy()
        values[self._held_entries] = 0.0
        values[self._held_diagonal] = 1.0
        return self._analysis.factor(values)

    def tolerance(self, load: LoadCase) -> float:
        """Residual, N, at which a state counts as an equilibrium."""
        return max(RELATIVE_TOLERANCE * load.size, ABSOLUTE_TOLERANCE)

    def residual_norm(self, gradient: Floats) -> float:
        """Largest force of a gradient (dofs,), moments over ``ROTATION_LENGTH``."""
        bones = gradient[: 6 * self.potential.bones].reshape(-1, 6)
        turning = np.abs(bones[:, 3:]).max(initial=0.0) / ROTATION_LENGTH
        rest = np.abs(gradient[6 * self.potential.bones :]).max(initial=0.0)
        return float(max(np.abs(bones[:, :3]).max(initial=0.0), turning, rest))

    def _newton(
        self,
        load: LoadCase,
        ratios: StiffnessRatios | None,
        state: TorsoState,
        observer: Observer | None,
        max_iterations: int,
        tolerance: float,
    ) -> Equilibrium:
        stiffness, terms = self.potential.stiffness(ratios), self.all_terms(load)
        energy, smallest_j = self.potential.energy(state, stiffness, terms)
        history: list[NewtonStep] = []
        factorisations, stable, status = 0, True, SolveStatus.ITERATION_LIMIT
        gradient, full = (np.zeros(self.potential.dofs),) * 2
        residual = np.inf
        if not np.isfinite(energy):
            status, max_iterations = SolveStatus.INVERTED_START, -1
        for iteration in range(max_iterations + 1):
            gradient, full = self.free_gradient(state, stiffness, terms)
            residual = self.residual_norm(gradient)
            step, projected = 0.0, False
            if residual <= tolerance:
                if iteration == 0 or not stable:
                    # The last tangent was asked a step ago, or none was: a balance may be a saddle or not.
                    stable = self._is_minimum(state, stiffness, terms)
                    factorisations += 1
                status = SolveStatus.CONVERGED if stable else SolveStatus.SADDLE
            elif iteration < max_iterations:
                try:
                    factor = self.factorise(state, stiffness, terms)
                    factorisations += 1
                    stable = factor.positive_definite
                    if not stable:
                        projected = True
                        factor = self.factorise(state, stiffness, terms, project=True)
                        factorisations += 1
                    direction = _capped(-factor.solve(gradient), self.potential.bones)
                except EquilibriumError:
                    status = SolveStatus.SINGULAR
                else:
                    found = self._line_search(state, energy, gradient, direction, residual, stiffness, terms)
                    if found is None:
                        status = SolveStatus.STALLED
                    else:
                        step, state, energy, smallest_j = found
            history.append(NewtonStep(iteration, residual, energy, smallest_j, step, projected))
            if observer:
                observer(history[-1])
            if step == 0.0:
                break
        return Equilibrium(
            state,
            status,
            energy,
            residual,
            tolerance,
            self._reactions(state, full),
            tuple(history),
            factorisations,
            smallest_j,
        )

    def _is_minimum(self, state: TorsoState, stiffness: Stiffness, terms: Sequence[BoneTerm]) -> bool:
        try:
            return self.factorise(state, stiffness, terms).positive_definite
        except EquilibriumError:
            return False

    def _line_search(
        self,
        state: TorsoState,
        energy: float,
        gradient: Floats,
        direction: Floats,
        residual: float,
        stiffness: Stiffness,
        terms: Sequence[BoneTerm],
    ) -> tuple[float, TorsoState, float, float] | None:
        slope = float(gradient @ direction)
        if not slope < 0.0:
            return None
        # Near the solution energy differences drown in rounding; there a smaller residual decides.
        outside = sum(abs(term.energy(state)) for term in terms)
        rounding = 1e-12 * (abs(energy) + outside)
        step = 1.0
        for _ in range(40):
            trial = advance(state, step * direction)
            trial_energy, smallest_j = self.potential.energy(trial, stiffness, terms)
            if smallest_j > 0.0:
                if trial_energy <= energy + 1e-4 * step * slope:
                    return step, trial, trial_energy, smallest_j
                if trial_energy <= energy + rounding:
                    trial_gradient, _ = self.free_gradient(trial, stiffness, terms)
                    if self.residual_norm(trial_gradient) < residual:
                        return step, trial, trial_energy, smallest_j
            step *= 0.5
        return None

    def _reactions(self, state: TorsoState, gradient: Floats) -> tuple[Reaction, ...]:
        reactions = []
        held = np.where(self.supports.held, gradient[: 6 * self.potential.bones].reshape(-1, 6), 0.0)
        for bone in np.flatnonzero(self.supports.held.any(1)):
            name = self.torso.bone_names[bone]
            reactions.append(Reaction(name, state.bone_positions[bone], held[bone, :3], held[bone, 3:]))
        springs = self.supports.springs
        places, forces = springs.points.positions(state), springs.forces(state)
        reactions += [Reaction(n, p, f, np.zeros(3)) for n, p, f in zip(self.supports.names, places, forces)]
        return tuple(reactions)


def _capped(direction: Floats, bones: int) -> Floats:
    rows = direction[: 6 * bones].reshape(-1, 6)
    turn = np.linalg.norm(rows[:, 3:], axis=1).max(initial=0.0) / LARGEST_TURN
    move = max(np.abs(rows[:, :3]).max(initial=0.0), np.abs(direction[6 * bones :]).max(initial=0.0)) / LARGEST_MOVE
    return direction / max(1.0, turn, move)
