"""Static equilibrium (Eqs. 4-5): the problem, its solution, and what is linear about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from spinestiff.anatomy.rotation import log_so3
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import StiffnessRatios
from spinestiff.anatomy.torso import TorsoModel, check_rotations
from spinestiff.arrays import Floats
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.factor import Analysis, Factor
from spinestiff.mechanics.kinematics import Kinematics
from spinestiff.mechanics.loads import LoadCase
from spinestiff.mechanics.mechanisms import require_no_mechanism
from spinestiff.mechanics.multilevel import MANY_DOFS, TWO_LEVEL, TwoLevelAnalysis, corner_prolongation
from spinestiff.mechanics.newton import Run
from spinestiff.mechanics.potential import ROTATION_LENGTH, Potential, Stiffness
from spinestiff.mechanics.sensitivity import Linearisation
from spinestiff.mechanics.solution import Equilibrium, NewtonStep, Observer, SolveStatus
from spinestiff.mechanics.supports import Reaction, Supports
from spinestiff.mechanics.terms import BoneTerm

__all__ = ["Equilibrium", "EquilibriumProblem", "NewtonStep", "Observer", "SolveStatus"]

RELATIVE_TOLERANCE = 1e-10
ABSOLUTE_TOLERANCE = 1e-8  # N
MAX_ITERATIONS = 60


class EquilibriumProblem:
    """A torso on its supports, ready to be loaded: pattern, analysis and constant data are built once.

    Parameters
    ----------
    torso, supports : what is solved.
    terms : further energies of bones, e.g. image terms (``mechanics.terms.BoneTerm``).
    backend : sparse solver, see ``mechanics.factor.Analysis``, or "two-level" (``mechanics.multilevel``), which is also
        taken where none is named and there are more than 80,000 unknowns.
    """

    def __init__(
        self, torso: TorsoModel, supports: Supports, terms: Sequence[BoneTerm] = (), backend: str | None = None
    ) -> None:
        self.torso = torso
        self.supports = supports
        self.terms = tuple(terms)
        self.potential = Potential(torso)
        self.kinematics = Kinematics(torso, supports)
        scale = np.ones(self.potential.dofs)
        scale[: 6 * self.potential.bones].reshape(-1, 6)[:, 3:] /= ROTATION_LENGTH
        pattern = self.potential.pattern
        many = backend is None and self.potential.dofs > MANY_DOFS and torso.tissue.elements.shape[1] == 10
        self._analysis: Analysis | TwoLevelAnalysis
        if many or backend == TWO_LEVEL:
            prolongation = corner_prolongation(self.potential)
            self._analysis = TwoLevelAnalysis(pattern.indptr, pattern.indices, prolongation, scale)
        else:
            self._analysis = Analysis(pattern.indptr, pattern.indices, backend, scale)
        held = np.flatnonzero(supports.held.ravel())
        self.held = held
        columns = np.repeat(np.arange(self.potential.dofs), np.diff(self.potential.pattern.indptr))
        mask = np.zeros(self.potential.dofs, dtype=bool)
        mask[held] = True
        self._held_entries = np.flatnonzero(mask[columns] | mask[self.potential.pattern.indices])
        self._held_diagonal = self.potential.pattern.indptr[held]
        self._held_with: tuple[np.ndarray, np.ndarray] | None = None  # what was stiff when mechanisms were looked for

    @property
    def backend(self) -> str:
        """The linear solver in use."""
        return self._analysis.backend

    def with_terms(self, terms: Sequence[BoneTerm]) -> EquilibriumProblem:
        """The same problem with other ``terms``; shares pattern and analysis."""
        other = object.__new__(EquilibriumProblem)
        other.__dict__.update(self.__dict__)
        other.terms = tuple(terms)
        other._held_with = None
        return other

    def with_supports(self, supports: Supports) -> EquilibriumProblem:
        """The same problem on other springs; shares pattern and analysis.

        Raises
        ------
        EquilibriumError : other degrees of freedom are held.
        """
        if not np.array_equal(supports.held, self.supports.held):
            raise EquilibriumError("the supports hold other degrees of freedom than the problem's; build a new problem")
        other = self.with_terms(self.terms)
        other.supports = supports
        return other

    def all_terms(self, load: LoadCase) -> tuple[BoneTerm, ...]:
        return (load, self.supports.springs, *self.terms)

    def solve(
        self,
        load: LoadCase,
        ratios: StiffnessRatios | None = None,
        start: TorsoState | Linearisation | None = None,
        observer: Observer | None = None,
        max_iterations: int = MAX_ITERATIONS,
        tolerance: float | None = None,
    ) -> Equilibrium:
        """The state of least energy under ``load`` (Eq. 4), from ``start`` or the rest pose.

        Parameters
        ----------
        start : a state, or a linearisation near by, whose factor then serves for the first steps.
        observer : sees every iteration; a true answer cancels.
        max_iterations : of each attempt.
        tolerance : residual to reach, N; default: 1e-10 of the load or 1e-8 N, the larger.

        Held degrees of freedom stay where the start has them, so that bones can be moved to where they are wanted.
        What is returned says by its status whether it is an equilibrium; ``require()`` turns a failure into an error.
        Where a start fails, the rest pose is tried, then the load in steps, then descent; only descent where what is
        held is not at rest in the start.

        Raises
        ------
        EquilibriumError : a part of the torso can move freely (``mechanics.mechanisms``), the start belongs to another
            torso, or the tolerance is not a finite one above 0.
        """
        run = Run(self, ratios, observer, max_iterations, tolerance)
        return self._solved(run, load, start)

    def solve_linearised(
        self,
        load: LoadCase,
        ratios: StiffnessRatios | None = None,
        start: TorsoState | Linearisation | None = None,
        observer: Observer | None = None,
    ) -> tuple[Equilibrium, Linearisation]:
        """``solve`` and ``linearise`` at once: one factorisation fewer, or what tells that it can be spared.

        Raises
        ------
        EquilibriumError : no equilibrium was found.
        """
        run = Run(self, ratios, observer, MAX_ITERATIONS, None, always_factorise=True)
        found = self._solved(run, load, start).require()
        return found, Linearisation(self, found, load, ratios, run.tangent)

    def _solved(self, run: Run, load: LoadCase, start: TorsoState | Linearisation | None) -> Equilibrium:
        rest, factor = self.torso.rest_pose, None
        if isinstance(start, Linearisation):
            if start.problem.kinematics is not self.kinematics:
                raise EquilibriumError("the linearisation to start from is another problem's; start from its state")
            state, factor = start.state, start.new_frame_factor()
        else:
            state = rest if start is None else self._checked(start)
        found = run.newton(load, state, factor)
        if self._held_at_rest(state):
            if run.wants_more(found) and state is not rest:
                found = run.newton(load, rest)
            if run.wants_more(found):
                found = run.in_steps(load)
        if run.wants_more(found):
            found = run.descend(load, found.state if found.smallest_j > 0.0 else state)
        return replace(found, history=tuple(run.history), factorisations=run.factorisations)

    def _checked(self, start: TorsoState) -> TorsoState:
        rest = self.torso.rest_pose
        if not isinstance(start, TorsoState):
            raise EquilibriumError(f"a solve starts from a TorsoState or a Linearisation, not a {type(start).__name__}")
        shapes = [(s.bone_positions.shape, s.tissue_positions.shape) for s in (start, rest)]
        if shapes[0] != shapes[1]:
            raise EquilibriumError(
                f"the start has {len(start.bone_positions)} bones and {len(start.tissue_positions)} free nodes, "
                f"the torso {len(rest.bone_positions)} and {len(rest.tissue_positions)}"
            )
        check_rotations("start rotation of bone", start.bone_rotations, self.torso.bone_names)
        return start

    def _held_at_rest(self, state: TorsoState) -> bool:
        rest = self.torso.rest_pose
        turned = log_so3(state.bone_rotations @ np.swapaxes(rest.bone_rotations, 1, 2))
        moved = np.hstack([state.bone_positions - rest.bone_positions, turned])
        return bool(np.abs(moved[self.supports.held]).max(initial=0.0) < 1e-9)

    def linearise(
        self, equilibrium: Equilibrium, load: LoadCase, ratios: StiffnessRatios | None = None
    ) -> Linearisation:
        """The tangent at a converged equilibrium, factorised, for sensitivities (Eqs. 6-7)."""
        return Linearisation(self, equilibrium, load, ratios)

    def require_held(self, stiffness: Stiffness) -> None:
        """Raise EquilibriumError, naming it, if a part of the torso can move freely at rest; asked once a stiffness."""
        present = (stiffness.joints > 0.0, stiffness.mu > 0.0)
        if self._held_with is None or not all(map(np.array_equal, self._held_with, present)):
            require_no_mechanism(self.torso, self.supports, stiffness, self.terms)
            self._held_with = present

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
        return float(np.max([np.abs(bones[:, :3]).max(initial=0.0), turning, rest]))  # not max(): it can lose a NaN

    def reactions(self, state: TorsoState, gradient: Floats) -> tuple[Reaction, ...]:
        """What the supports exert in ``state``, for the gradient there with held DoFs as they are."""
        reactions = []
        held = np.where(self.supports.held, gradient[: 6 * self.potential.bones].reshape(-1, 6), 0.0)
        for bone in np.flatnonzero(self.supports.held.any(1)):
            name = self.torso.bone_names[bone]
            reactions.append(Reaction(name, state.bone_positions[bone], held[bone, :3], held[bone, 3:]))
        springs = self.supports.springs
        places, forces = springs.points.positions(state), springs.forces(state)
        reactions += [Reaction(n, p, f, np.zeros(3)) for n, p, f in zip(self.supports.names, places, forces)]
        return tuple(reactions)
