"""FElupe: its neo-Hookean body and Newton's method, symmetric Pardiso through ``solve``; adjoint by hand."""

from __future__ import annotations

import felupe as fem
import numpy as np
from common import TOLERANCE, Floats, Problem, Solver, main
from symmetric_pardiso import SymmetricPardiso


class Felupe(Solver):
    def __init__(self, problem: Problem) -> None:
        linear = problem.cells.shape[1] == 4
        mesh = fem.Mesh(problem.points, problem.cells, "tetra" if linear else "tetra10")
        # FElupe's own second-order rule has eight digits; the problem's has all.
        rule = fem.quadrature.Scheme(problem.quadrature_points, problem.quadrature_weights)
        region = (fem.RegionTetra if linear else fem.RegionQuadraticTetra)(mesh, quadrature=rule)
        self._field = fem.FieldContainer([fem.Field(region, dim=3)])
        self._free = problem.free_dofs
        self._fixed = np.setdiff1d(np.arange(problem.points.size), self._free)
        self._pardiso: SymmetricPardiso | None = None

    def _body(self, mu: float, lambda_: float) -> fem.SolidBody:
        return fem.SolidBody(fem.NeoHookeCompressible(mu=mu, lmbda=lambda_), self._field)

    def _linear_solve(self, tangent, negative_force):  # type: ignore[no-untyped-def]
        if self._pardiso is None:
            self._pardiso = SymmetricPardiso(tangent, self._free)
        self._pardiso.factor(tangent.data)
        step = np.zeros(len(negative_force))
        step[self._free] = self._pardiso.solve(negative_force[self._free])
        return step

    def _check(self, dx, x, f, xtol, ftol, dof1=None, dof0=None, items=None):  # type: ignore[no-untyped-def]
        largest = float(np.abs(f[self._free]).max())
        return float(np.abs(dx).max()), largest, largest <= ftol

    def solve(self, mu: float, lambda_: float, start: Floats, warm: bool) -> tuple[Floats, int]:
        self._field[0].values = start.copy()
        self._body_now = self._body(mu, lambda_)
        found = fem.newtonraphson(
            items=[self._body_now],
            solve=self._linear_solve,
            check=self._check,
            tol=TOLERANCE,
            dof1=self._free,
            dof0=self._fixed,
            verbose=0,
        )
        return found.x[0].values.copy(), found.iterations

    def gradient(self, weights: Floats) -> tuple[float, float]:
        assert self._pardiso is not None
        tangent = self._body_now.assemble.matrix()
        rhs = weights.ravel()[self._free]
        adjoint = self._pardiso.solve_near(tangent.data, rhs, 1e-10)
        shares = [
            self._body(*unit).assemble.vector().toarray().ravel()[self._free] for unit in ((1.0, 0.0), (0.0, 1.0))
        ]
        return -float(adjoint @ shares[0]), -float(adjoint @ shares[1])


if __name__ == "__main__":
    main(Felupe, ("felupe", "pypardiso", "mkl", "numpy"))
