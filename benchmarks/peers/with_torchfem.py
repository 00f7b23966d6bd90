"""torch-fem: its Newton's method and its own adjoint.

``Solid.solve`` always begins at rest, so the start is handed to ``newton_solve``, which it calls itself. Linear systems
are solved by its conjugate gradients with multigrid: 15 to 18 % below its direct solver (an unsymmetric Pardiso) at
3,000 and 10,000 nodes. ``SPINESTIFF_TORCHFEM_METHOD=direct`` takes that one.
"""

from __future__ import annotations

import os
from functools import partial

import numpy as np
import torch
from common import NORM_TOLERANCE, Floats, Problem, Solver, main
from torchfem import Solid
from torchfem.elements import Tetra2, classproperty
from torchfem.materials import Hyperelastic3D
from torchfem.sparse import newton_solve

torch.set_default_dtype(torch.float64)
METHOD = os.environ.get("SPINESTIFF_TORCHFEM_METHOD", "cg")


def energy(f: torch.Tensor, moduli: torch.Tensor) -> torch.Tensor:
    # det written out: torch.det has no second derivative at rest, logdet fails where batches are solved at once.
    j = (
        f[0, 0] * (f[1, 1] * f[2, 2] - f[1, 2] * f[2, 1])
        - f[0, 1] * (f[1, 0] * f[2, 2] - f[1, 2] * f[2, 0])
        + f[0, 2] * (f[1, 0] * f[2, 1] - f[1, 1] * f[2, 0])
    )
    log_j = torch.log(j)
    return 0.5 * moduli[0] * ((f * f).sum() - 3.0) - moduli[0] * log_j + 0.5 * moduli[1] * log_j**2


def exact_rule(points: Floats, weights: Floats) -> type[Tetra2]:
    """The ten-node element with the problem's rule; torch-fem's own has eight digits."""

    class Exact(Tetra2):
        @classproperty
        def ipoints(cls) -> torch.Tensor:
            return torch.tensor(points)

        @classproperty
        def iweights(cls) -> torch.Tensor:
            return torch.tensor(weights)

    return Exact


class TorchFem(Solver):
    def __init__(self, problem: Problem) -> None:
        self._mesh = torch.tensor(problem.points), torch.tensor(problem.cells)
        self._fixed = torch.tensor(np.repeat(problem.fixed[:, None], 3, axis=1))
        self._element = None
        if problem.cells.shape[1] == 10:
            self._element = exact_rule(problem.quadrature_points, problem.quadrature_weights)
        self._body = self._solid(Hyperelastic3D(energy, torch.tensor([problem.mu, problem.lambda_])))
        self._null_space = self._body.near_null_space()

    def _solid(self, material: Hyperelastic3D) -> Solid:
        kind = Solid
        if self._element is not None:
            kind = type("ExactSolid", (Solid,), {"element_types": (self._element,)})
        body = kind(*self._mesh, material)
        body.constraints = self._fixed
        return body

    def solve(self, mu: float, lambda_: float, start: Floats, warm: bool) -> tuple[Floats, int]:
        self._moduli = [torch.tensor(value, requires_grad=warm) for value in (mu, lambda_)]
        body = self._body
        body.material = Hyperelastic3D(energy, torch.stack(self._moduli)).vectorize(body.n_elem)
        body.K = torch.empty(0)
        displacement = torch.tensor(start).ravel()
        prescribed = torch.where(self._fixed.ravel(), displacement, 0.0)
        fixed = torch.nonzero(self._fixed.ravel()).ravel()
        no_force, no_strain = torch.zeros(body.n_dofs), torch.zeros(body.n_elem, 3, 3)
        at_rest = torch.zeros(body.n_int, body.n_elem, 3, 3)
        residual = partial(body._residual, no_force, prescribed, no_strain, None, None, fixed)
        calls = []

        def counted(*arguments):  # type: ignore[no-untyped-def]
            calls.append(arguments[1])
            return residual(*arguments)

        self._found = newton_solve(
            counted,
            displacement,
            self._null_space,
            30,
            0.0,
            NORM_TOLERANCE,
            1e-10,
            None,
            METHOD,
            None,
            None,
            torch.zeros(body.n_nod, 3),
            at_rest + torch.eye(3),
            at_rest,
            torch.zeros(body.n_int, body.n_elem, 0),
            *(self._moduli if warm else ()),
        )
        return self._found.detach().numpy().reshape(-1, 3).copy(), len(calls) - 1

    def gradient(self, weights: Floats) -> tuple[float, float]:
        mu, lambda_ = torch.autograd.grad(self._found @ torch.tensor(weights.ravel()), self._moduli)
        return float(mu), float(lambda_)


if __name__ == "__main__":
    main(TorchFem, ("torch-fem", "torch", "pypardiso", "mkl"))
