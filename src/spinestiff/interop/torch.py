"""Equilibrium as a PyTorch operation: reverse mode (Eq. 7), forward mode (Eq. 6), on the CPU in float64.

Needs the extra: pip install "spinestiff[torch]".
"""

from __future__ import annotations

from typing import Any

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.mechanics.differentiable import DifferentiableEquilibrium, Pose
from spinestiff.mechanics.sensitivity import Linearisation

try:
    import torch
except ImportError:
    raise ImportError('spinestiff.interop.torch needs PyTorch; try: pip install "spinestiff[torch]"') from None


class _Equilibrium(torch.autograd.Function):  # type: ignore[misc]
    @staticmethod
    def forward(
        ctx: Any, parameters: Any, model: DifferentiableEquilibrium, start: TorsoState | Linearisation | None
    ) -> Any:
        ctx.solution = model.solve(_array(parameters), start)
        ctx.device = parameters.device
        # A pose is never written to, but torch's users may write into their tensors: copies.
        return tuple(torch.tensor(values, dtype=torch.float64) for values in ctx.solution.pose)

    @staticmethod
    def backward(ctx: Any, *cotangents: Any) -> Any:
        # With a graph wanted, a constant in its place would lose terms in silence.
        if torch.is_grad_enabled():
            raise NotImplementedError("an equilibrium has first derivatives only; leave out create_graph")
        derivative = ctx.solution.vjp(Pose(*map(_array, cotangents)))
        return torch.tensor(derivative, device=ctx.device), None, None

    @staticmethod
    def jvp(ctx: Any, tangent: Any, *_: None) -> Any:
        return tuple(map(torch.from_numpy, ctx.solution.jvp(_array(tangent))))


def torch_equilibrium(
    model: DifferentiableEquilibrium, parameters: torch.Tensor, start: TorsoState | Linearisation | None = None
) -> Pose:
    """Pose in equilibrium at ``parameters`` (P,): float64 tensors (B, 3), (B, 3, 3), (F, 3) on the CPU.

    First derivatives only. ``start`` as in ``DifferentiableEquilibrium.solve``.

    Raises
    ------
    EquilibriumError : as ``DifferentiableEquilibrium.solve``.
    """
    return Pose(*_Equilibrium.apply(parameters, model, start))


def _array(tensor: Any) -> Any:
    return np.array(tensor.detach().cpu().numpy(), dtype=np.float64)
