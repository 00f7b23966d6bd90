"""JAX-FEM: its Newton's method and its own adjoint, with symmetric Pardiso as ``custom_solver``."""

from __future__ import annotations

import logging

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from common import NORM_TOLERANCE, Floats, Solver, main
from common import Problem as TissueProblem
from jax_fem.generate_mesh import Mesh
from jax_fem.problem import Problem
from jax_fem.solver import ad_wrapper
from symmetric_pardiso import SymmetricPardiso

logging.getLogger("jax_fem").setLevel(logging.ERROR)


class Tissue(Problem):
    def get_tensor_map(self):  # type: ignore[no-untyped-def]
        def stress(u_grad, mu, lambda_):  # type: ignore[no-untyped-def]
            f = u_grad + jnp.eye(3)
            cofactor = jnp.stack([jnp.cross(f[1], f[2]), jnp.cross(f[2], f[0]), jnp.cross(f[0], f[1])])
            j = f[0] @ cofactor[0]
            return mu * f + (lambda_ * jnp.log(j) - mu) * cofactor / j

        return stress

    def set_params(self, params):  # type: ignore[no-untyped-def]
        shape = (self.fes[0].num_cells, self.fes[0].num_quads)
        self.internal_vars = [jnp.full(shape, params[0]), jnp.full(shape, params[1])]


class JaxFem(Solver):
    def __init__(self, problem: TissueProblem) -> None:
        kind = "TET4" if problem.cells.shape[1] == 4 else "TET10"
        mesh = Mesh(problem.points, problem.cells, ele_type=kind)
        fixed = jnp.asarray(problem.fixed)
        places = [lambda point, index: fixed[index]] * 3
        zero = [lambda point: 0.0] * 3
        self._problem = Tissue(mesh, vec=3, dim=3, ele_type=kind, dirichlet_bc_info=[places, [0, 1, 2], zero])
        self._nodes = np.flatnonzero(problem.fixed)
        self._free = problem.free_dofs
        self._pardiso: SymmetricPardiso | None = None
        self._systems = 0
        self._options = {"custom_solver": self._linear_solve, "tol": NORM_TOLERANCE, "rel_tol": 0.0}
        self._equilibrium = ad_wrapper(self._problem, self._options, {"custom_solver": self._adjoint_solve})

    def _linear_solve(self, matrix, rhs, guess, options):  # type: ignore[no-untyped-def]
        """Rows of fixed degrees of freedom are the identity's and their right-hand side is zero here."""
        indptr, indices, data = matrix.getValuesCSR()
        if self._pardiso is None:
            shape = (len(indptr) - 1,) * 2
            self._pattern = indptr, indices
            self._pardiso = SymmetricPardiso(sp.csr_matrix((data, indices, indptr), shape=shape), self._free)
        self._pardiso.factor(data)
        self._systems += 1
        step = np.zeros(len(indptr) - 1)
        step[self._free] = self._pardiso.solve(np.asarray(rhs)[self._free])
        return step

    def _adjoint_solve(self, matrix, rhs, guess, options):  # type: ignore[no-untyped-def]
        """The transposed system: the free block is symmetric, and fixed rows carry no parameter."""
        indptr, indices, data = matrix.getValuesCSR()
        whole = sp.csr_matrix((data, indices, indptr), shape=(len(indptr) - 1,) * 2).T.tocsr()
        assert self._pardiso is not None
        adjoint = np.zeros(len(indptr) - 1)
        adjoint[self._free] = self._pardiso.solve_near(whole.data, np.asarray(rhs)[self._free], 1e-10)
        return adjoint

    def solve(self, mu: float, lambda_: float, start: Floats, warm: bool) -> tuple[Floats, int]:
        self._problem.fes[0].vals_list = [jnp.asarray(start[self._nodes, axis]) for axis in range(3)]
        self._options["initial_guess"] = [jnp.asarray(start)]
        self._systems = 0
        moduli = jnp.array([mu, lambda_])
        if warm:
            found, self._back = jax.vjp(self._equilibrium, moduli)
        else:
            found = self._equilibrium(moduli)
        return np.array(found[0]), self._systems

    def gradient(self, weights: Floats) -> tuple[float, float]:
        (moduli,) = self._back([jnp.asarray(weights)])
        return float(moduli[0]), float(moduli[1])


if __name__ == "__main__":
    main(JaxFem, ("jax-fem", "jax", "petsc4py", "pypardiso", "mkl"))
