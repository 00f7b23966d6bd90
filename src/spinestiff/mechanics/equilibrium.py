"""Static equilibrium (Eqs. 4-5): the problem, its solution, and what is linear about it."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from spinestiff.anatomy.rotation import log_so3
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import StiffnessRatios
from spinestiff.anatomy.torso import check_rotations
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.diagnosis import fault_of
from spinestiff.mechanics.loads import LoadCase
from spinestiff.mechanics.newton import Run
from spinestiff.mechanics.result import Equilibrium, NewtonStep, OnNewtonStep, SolveStatus
from spinestiff.mechanics.sensitivity import Linearisation
from spinestiff.mechanics.system import System
from spinestiff.parallel import blas_on_one_thread

__all__ = ["Equilibrium", "EquilibriumProblem", "NewtonStep", "OnNewtonStep", "SolveStatus"]

MAX_ITERATIONS = 60
_log = logging.getLogger(__name__)


class EquilibriumProblem(System):
    """A torso on its supports, ready to be loaded; its parameters are those of ``mechanics.system.System``."""

    def solve(
        self,
        load: LoadCase,
        ratios: StiffnessRatios | None = None,
        start: TorsoState | Linearisation | None = None,
        observer: OnNewtonStep | None = None,
        max_iterations: int = MAX_ITERATIONS,
        tolerance: float | None = None,
        largest_turn: float = np.inf,
        most_factorisations: float = np.inf,
    ) -> Equilibrium:
        """The state of least energy under ``load`` (Eq. 4), from ``start`` or the rest pose.

        Parameters
        ----------
        start : a state, or a linearisation near by, whose factor then serves for the first steps.
        observer : sees every iteration; a true answer cancels.
        max_iterations : of each attempt; descent may take twice as many.
        tolerance : residual to reach, N; default: 1e-10 of the load or 1e-8 N, the larger.
        largest_turn : rad, of a bone from its place at rest; where one turns farther the solve ends as ``FOLDED``.
        most_factorisations : of all attempts together; the solve ends as ``ITERATION_LIMIT`` after the step that has
            exceeded them.

        Held degrees of freedom stay where the start has them, so that bones can be moved to where they are wanted; with
        a ``place`` (``with_place``) the pelvis is turned to it first, and the start with it.
        What is returned says by its status whether it is an equilibrium; ``require()`` turns a failure into an error.
        Where a start fails, the rest pose is tried, then the load in steps, then descent; only descent where what is
        held is not at rest in the start.

        Raises
        ------
        EquilibriumError : a part of the torso can move freely (``mechanics.mechanisms``), the start belongs to another
            torso, or the tolerance is not a finite one above 0.
        """
        run = Run(self, ratios, observer, max_iterations, tolerance, False, largest_turn, most_factorisations)
        return self._solved(run, load, start)

    def solve_linearised(
        self,
        load: LoadCase,
        ratios: StiffnessRatios | None = None,
        start: TorsoState | Linearisation | None = None,
        observer: OnNewtonStep | None = None,
        largest_turn: float = np.inf,
        most_factorisations: float = np.inf,
    ) -> tuple[Equilibrium, Linearisation]:
        """``solve`` and ``linearise`` at once: one factorisation fewer, or what tells that it can be spared.

        Raises
        ------
        EquilibriumError : no equilibrium was found.
        """
        run = Run(self, ratios, observer, MAX_ITERATIONS, None, True, largest_turn, most_factorisations)
        found = self._solved(run, load, start).require()
        return found, Linearisation(self, found, load, ratios, run.tangent)

    def _solved(self, run: Run, load: LoadCase, start: TorsoState | Linearisation | None) -> Equilibrium:
        rest, factor = self.placed(self.torso.rest_pose), None
        if isinstance(start, Linearisation):
            if start.system.kinematics is not self.kinematics:
                raise EquilibriumError("the linearisation to start from is another problem's; start from its state")
            state, factor = self.placed(start.state), start.new_frame_factor()
        else:
            state = rest if start is None else self.placed(self._checked(start))
        with blas_on_one_thread():
            found = run.newton(load, state, factor)
            if self._held_as_in(rest, state):
                if run.wants_more(found) and state is not rest:
                    found = run.newton(load, rest)
                if run.wants_more(found):
                    found = run.in_steps(load)
            if run.wants_more(found):
                found = run.descend(load, found.state if found.smallest_j > 0.0 else state)
        fault = fault_of(self, found, run.stiffness, self.all_terms(load))
        found = replace(found, history=tuple(run.history), factorisations=run.factorisations, fault=fault)
        _log.debug(
            "%s after %d iterations and %d factorisations, residual %.1e N",
            found.status.name, found.iterations, found.factorisations, found.residual_norm,
        )  # fmt: skip
        return found

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

    def _held_as_in(self, rest: TorsoState, state: TorsoState) -> bool:
        turned = log_so3(state.bone_rotations @ np.swapaxes(rest.bone_rotations, 1, 2))
        moved = np.hstack([state.bone_positions - rest.bone_positions, turned])
        return bool(np.abs(moved[self.supports.held]).max(initial=0.0) < 1e-9)

    def linearise(
        self, equilibrium: Equilibrium, load: LoadCase, ratios: StiffnessRatios | None = None
    ) -> Linearisation:
        """The tangent at a converged equilibrium, factorised, for sensitivities (Eqs. 6-7)."""
        return Linearisation(self, equilibrium, load, ratios)
