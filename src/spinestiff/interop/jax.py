"""Equilibrium as a JAX function: reverse mode (Eq. 7), also under ``jit`` and ``vmap``, on the host in float64.

Needs the extra: pip install "spinestiff[jax]", and 64 bits: jax.config.update("jax_enable_x64", True).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.differentiable import DifferentiableEquilibrium, Pose
from spinestiff.mechanics.sensitivity import Linearisation

try:
    import jax
except ImportError:
    raise ImportError('spinestiff.interop.jax needs JAX; try: pip install "spinestiff[jax]"') from None


def jax_equilibrium(
    model: DifferentiableEquilibrium, start: TorsoState | Linearisation | None = None
) -> Callable[[Any], Pose]:
    """The function from parameters (P,) to the pose in equilibrium, arrays (B, 3), (B, 3, 3), (F, 3).

    Differentiable once, in reverse mode (``jax.grad``, ``jax.vjp``, ``jax.jacrev``). Where there is no equilibrium,
    JAX raises an error of its own whose text holds ours. ``start`` as in ``DifferentiableEquilibrium.solve``.

    Raises
    ------
    EquilibriumError : JAX works with 32 bits.
    """
    if not jax.config.jax_enable_x64:
        raise EquilibriumError('equilibria need 64 bits; set jax.config.update("jax_enable_x64", True) first')
    rest = model.problem.torso.rest_pose
    arrays = (rest.bone_positions, rest.bone_rotations, rest.tissue_positions)
    shapes = Pose(*(jax.ShapeDtypeStruct(a.shape, np.float64) for a in arrays))
    slope = jax.ShapeDtypeStruct((len(model.names),), np.float64)

    def solve(parameters: Any) -> Pose:
        return model.solve(np.asarray(parameters), start).pose

    def pull_back(parameters: Any, pose: Any, cotangent: Any) -> Any:
        there = model.at(np.asarray(parameters), Pose(*map(np.asarray, pose)))
        return there.vjp(Pose(*map(np.asarray, cotangent)))

    @jax.custom_vjp  # type: ignore[untyped-decorator]
    def pose_of(parameters: Any) -> Any:
        return jax.pure_callback(solve, shapes, parameters, vmap_method="sequential")

    def forward(parameters: Any) -> Any:
        pose = pose_of(parameters)
        return pose, (parameters, pose)

    def backward(kept: Any, cotangent: Any) -> Any:
        return (jax.pure_callback(pull_back, slope, *kept, cotangent, vmap_method="sequential"),)

    pose_of.defvjp(forward, backward)
    result: Callable[[Any], Pose] = pose_of
    return result
