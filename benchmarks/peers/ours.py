"""spinestiff on the tissue-only problem: a torso without joints whose bones are all held where they have been moved."""

from __future__ import annotations

import functools
import statistics

import numpy as np
import rslab
from common import Floats, Problem, Solver, cpu_seconds, main

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import ParameterGroup, StiffnessRatios
from spinestiff.anatomy.torso import JointTable, TissueMesh, TorsoModel
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import no_load
from spinestiff.mechanics.supports import Supports
from spinestiff.mechanics.terms import PointSprings

# One thread, as all codes here: rslab reads no environment variable for that.
rslab.analyze = functools.partial(rslab.analyze, threads=1)
NO_JOINTS = np.zeros((0, 6), dtype=bool)
GROUPS = (
    ParameterGroup("mu", NO_JOINTS, mu=True, lambda_=False),
    ParameterGroup("lambda", NO_JOINTS, mu=False, lambda_=True),
)


class Ours(Solver):
    """The engine with its defaults."""

    def __init__(self, problem: Problem) -> None:
        bones, elements = len(problem.bone_rest), len(problem.cells)
        upright = np.broadcast_to(np.eye(3), (bones, 3, 3))
        free = problem.bone_of_node < 0
        rest = TorsoState(problem.bone_rest, upright, problem.points[free])
        no_axes, no_points, none = np.empty((0, 3, 3)), np.empty((0, 3)), np.empty(0, np.int64)
        joints = JointTable((), (), none, none, no_points, no_axes, no_points, no_axes, np.empty((0, 6)))
        tissue = TissueMesh(
            problem.points,
            problem.cells,
            problem.bone_of_node,
            np.full(elements, problem.mu),
            np.full(elements, problem.lambda_),
        )
        self._torso = TorsoModel(
            tuple(f"bone{i}" for i in range(bones)), rest, joints, tissue, np.empty((0, 8, 3)), (), {}, 0.0, ()
        )
        self._load = no_load()
        springs = PointSprings(self._load.points, no_points, no_points, np.empty(0))
        self._engine = EquilibriumProblem(self._torso, Supports(np.ones((bones, 6), dtype=bool), springs, ()))
        self._problem, self._free = problem, free

    def solve(self, mu: float, lambda_: float, start: Floats, warm: bool) -> tuple[Floats, int]:
        p = self._problem
        self._ratios = StiffnessRatios(GROUPS, np.array([mu / p.mu, lambda_ / p.lambda_]))
        if warm:
            # The solve and the tangent of its gradient share what they cost, so "warm" holds both.
            self._found, self._linear = self._engine.solve_linearised(self._load, self._ratios, self._linear)
        else:
            state = TorsoState(p.bone_moved, p.bone_turned, (p.points + start)[self._free])
            self._found = self._engine.solve(self._load, self._ratios, state).require()
        return self._torso.node_positions(self._found.state) - p.points, self._found.factorisations

    def settle(self) -> None:
        self._linear = self._engine.linearise(self._found, self._load, self._ratios)

    def gradient(self, weights: Floats) -> tuple[float, float]:
        full = np.concatenate([np.zeros(6 * len(self._problem.bone_rest)), weights[self._free].ravel()])
        by_log = self._linear.adjoint(full, GROUPS)
        mu, lambda_ = by_log / self._ratios.values / [self._problem.mu, self._problem.lambda_]
        return float(mu), float(lambda_)

    def factor_seconds(self) -> dict[str, float]:
        """CPU seconds of one numeric factorisation of the tangent at the cold solution."""
        p = self._problem
        _, used = self.solve(p.mu, p.lambda_, p.start, False)
        potential, state = self._engine.potential, self._found.state
        values = potential.hessian(state, potential.stiffness(None), self._engine.all_terms(self._load))
        unit = statistics.median(cpu_seconds(lambda: self._engine.numeric_factor(values)) for _ in range(7))
        return {"factor_cpu_s": unit, "factorisations": used}


if __name__ == "__main__":
    main(Ours, ("spinestiff", "rslab", "numba"), lambda solver: solver.factor_seconds())
