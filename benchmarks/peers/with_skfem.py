"""scikit-fem: forms, Newton's method and adjoint by hand, symmetric Pardiso.

The three components share one scalar basis, and a tangent is nine scalar blocks (six by symmetry): an eighth of the
work of one form on a vector element, which asks for every pair of its basis functions.

With ``SPINESTIFF_KEEP_FACTOR=1`` a warm solve takes steps with the factor it finds as long as each makes the force ten
times smaller: what a user gains who writes by hand what this engine does by itself.
"""

from __future__ import annotations

import os

import numpy as np
import scipy.sparse as sp
import skfem
from common import TOLERANCE, Floats, Problem, Solver, main
from symmetric_pardiso import SymmetricPardiso

KEEP_FACTOR = os.environ.get("SPINESTIFF_KEEP_FACTOR") == "1"


@skfem.LinearForm
def force(v, w):  # type: ignore[no-untyped-def]
    """One component of the internal force; ``stress`` is that row of the first Piola-Kirchhoff stress."""
    return w["x"] * v.grad[0] + w["y"] * v.grad[1] + w["z"] * v.grad[2]


@skfem.BilinearForm
def tangent(u, v, w):  # type: ignore[no-untyped-def]
    """Block of components c (of v) and d (of u), from rows ``c`` and ``d`` of F^-T."""
    c, d = w["c"], w["d"]
    vc = c[0] * v.grad[0] + c[1] * v.grad[1] + c[2] * v.grad[2]
    ud = d[0] * u.grad[0] + d[1] * u.grad[1] + d[2] * u.grad[2]
    if w["same"]:
        return w["mu"] * (u.grad[0] * v.grad[0] + u.grad[1] * v.grad[1] + u.grad[2] * v.grad[2]) + w["sum"] * vc * ud
    vd = d[0] * v.grad[0] + d[1] * v.grad[1] + d[2] * v.grad[2]
    uc = c[0] * u.grad[0] + c[1] * u.grad[1] + c[2] * u.grad[2]
    return w["mix"] * vd * uc + w["lambda_"] * vc * ud


class Skfem(Solver):
    def __init__(self, problem: Problem) -> None:
        linear = problem.cells.shape[1] == 4
        corners = np.unique(problem.cells[:, :4])
        number = np.full(len(problem.points), -1)
        number[corners] = np.arange(len(corners))
        mesh = skfem.MeshTet1(
            np.ascontiguousarray(problem.points[corners].T), np.ascontiguousarray(number[problem.cells[:, :4]].T)
        )
        element = skfem.ElementTetP1() if linear else skfem.ElementTetP2()
        rule = (np.ascontiguousarray(problem.quadrature_points.T), problem.quadrature_weights)
        self._basis = skfem.Basis(mesh, element, quadrature=rule)
        # scikit-fem numbers edges itself: nodes are found by where they are, to a thousandth of a micrometre.
        place = {tuple(p): n for n, p in enumerate(np.round(1e6 * problem.points).astype(np.int64).tolist())}
        self._node = np.array(
            [place[tuple(p)] for p in np.round(1e6 * self._basis.doflocs.T).astype(np.int64).tolist()]
        )
        self._free = np.flatnonzero(np.tile(~problem.fixed[self._node], 3))
        self._shape = problem.points.shape
        self._pardiso: SymmetricPardiso | None = None

    def _deform(self, u: Floats) -> None:
        """F, F^-T and log J at the integration points of displacement ``u`` (3, n)."""
        f = np.stack([self._basis.interpolate(component).grad for component in u]) + np.eye(3)[:, :, None, None]
        cofactor = np.empty_like(f)
        for i in range(3):
            for j in range(3):
                (p, q), (r, s) = ((i + 1) % 3, (i + 2) % 3), ((j + 1) % 3, (j + 2) % 3)
                cofactor[i, j] = f[p, r] * f[q, s] - f[p, s] * f[q, r]
        j = f[0, 0] * cofactor[0, 0] + f[0, 1] * cofactor[0, 1] + f[0, 2] * cofactor[0, 2]
        self._f, self._inverse, self._log_j = f, cofactor / j, np.log(j)

    def _assemble_force(self, stress: Floats) -> Floats:
        return np.concatenate([force.assemble(self._basis, x=row[0], y=row[1], z=row[2]) for row in stress])

    def _assemble_tangent(self) -> Floats:
        """Values of the whole tangent."""
        mu, lambda_ = self._moduli
        mix = mu - lambda_ * self._log_j
        blocks: list[list[sp.csr_matrix]] = [[None] * 3 for _ in range(3)]
        for c in range(3):
            for d in range(c + 1):
                block = tangent.assemble(
                    self._basis,
                    c=self._inverse[c],
                    d=self._inverse[d],
                    same=c == d,
                    mix=mix,
                    sum=mix + lambda_,
                    mu=mu,
                    lambda_=lambda_,
                )
                blocks[c][d], blocks[d][c] = block, block if c == d else block.T.tocsr()
        matrix = sp.bmat(blocks, format="csr")
        if self._pardiso is None:
            self._pattern = matrix
            self._pardiso = SymmetricPardiso(matrix, self._free)
        assert matrix.nnz == self._pattern.nnz, "the analysis belongs to another pattern"
        return matrix.data

    def solve(self, mu: float, lambda_: float, start: Floats, warm: bool) -> tuple[Floats, int]:
        self._moduli = (mu, lambda_)
        u = np.ascontiguousarray(start[self._node].T)
        flat = u.reshape(-1)
        before, systems = np.inf, 0
        keep = KEEP_FACTOR and warm
        for _ in range(30):
            self._deform(u)
            residual = self._assemble_force(mu * self._f + (lambda_ * self._log_j - mu) * self._inverse)[self._free]
            largest = float(np.abs(residual).max())
            if largest <= TOLERANCE:
                found = np.empty(self._shape)
                found[self._node] = u.T
                return found, systems
            keep = keep and largest < 0.1 * before
            if not keep:
                values = self._assemble_tangent()
                self._pardiso.factor(values)
                systems += 1
            before = largest
            flat[self._free] -= self._pardiso.solve(residual)
        raise RuntimeError("Newton's method did not converge")

    def gradient(self, weights: Floats) -> tuple[float, float]:
        rhs = np.ascontiguousarray(weights[self._node].T).ravel()[self._free]
        values = self._assemble_tangent()
        assert self._pardiso is not None
        adjoint = self._pardiso.solve_near(values, rhs, 1e-10)
        stresses = (self._f - self._inverse, self._log_j * self._inverse)
        mu, lambda_ = (-float(adjoint @ self._assemble_force(stress)[self._free]) for stress in stresses)
        return mu, lambda_


if __name__ == "__main__":
    main(Skfem, ("scikit-fem", "pypardiso", "mkl", "numpy"))
