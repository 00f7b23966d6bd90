"""Energy terms that act on one bone or one free node each: loads, springs of supports, and image terms from outside.

What couples bones or nodes with each other is a law (``mechanics.assembly.Law``).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from spinestiff.anatomy.points import PointsOnBones, rotation_second_derivative
from spinestiff.anatomy.state import TorsoState
from spinestiff.arrays import Floats, Ints, ShortRepr, read_only
from spinestiff.errors import TorsoError


@dataclass(frozen=True, repr=False)
class TermBlocks(ShortRepr):
    """Derivatives of a term, one block a point.

    Attributes
    ----------
    bone, gradient, hessian : (n,) bones, with (n, 6) and (n, 6, 6) in (dt, dw).
    node, node_gradient, node_hessian : (m,) rows of ``TorsoState.tissue_positions``, with (m, 3) and (m, 3, 3).
    """

    bone: Ints
    gradient: Floats
    hessian: Floats
    node: Ints = field(default_factory=lambda: np.empty(0, np.int64))
    node_gradient: Floats = field(default_factory=lambda: np.empty((0, 3)))
    node_hessian: Floats = field(default_factory=lambda: np.empty((0, 3, 3)))


class Term(Protocol):
    """An energy that is a sum over points of functions of one bone's pose or one free node's position each."""

    def energy(self, state: TorsoState) -> float: ...

    def blocks(self, state: TorsoState) -> TermBlocks: ...


def point_blocks(points: PointsOnBones, state: TorsoState, gradient: Floats, hessian: Floats | None) -> TermBlocks:
    """Pull derivatives in a point's position, (n, 3) and (n, 3, 3) or None, back to its bone's pose.

    The second derivative of the rotation is part of it (anatomy/points.py).
    """
    jacobian = points.jacobian(state)
    blocks = np.zeros((len(points), 6, 6))
    if hessian is not None:
        blocks = np.swapaxes(jacobian, 1, 2) @ hessian @ jacobian
    blocks[:, 3:, 3:] += rotation_second_derivative(gradient, points.arms(state))
    return TermBlocks(points.bone, np.einsum("pij,pi->pj", jacobian, gradient), blocks)


@dataclass(frozen=True, repr=False)
class PointSprings(ShortRepr):
    """Springs from points on bones to fixed places: E = sum k (n . (x - x0))^2 / 2.

    Attributes
    ----------
    points : (S,) points on bones.
    targets : (S, 3) mm, x0.
    directions : (S, 3) unit vectors n.
    stiffness : (S,) N/mm.
    """

    points: PointsOnBones
    targets: Floats
    directions: Floats
    stiffness: Floats

    def __post_init__(self) -> None:
        n = len(self.points)
        for key, shape in (("targets", (n, 3)), ("directions", (n, 3)), ("stiffness", (n,))):
            object.__setattr__(self, key, read_only(key, getattr(self, key), shape, TorsoError))
        if n and np.abs(np.linalg.norm(self.directions, axis=1) - 1.0).max() > 1e-9:
            raise TorsoError("a spring's direction is not of unit length")
        if (self.stiffness < 0.0).any():
            raise TorsoError("a spring's stiffness is negative")

    def extension(self, state: TorsoState) -> Floats:
        """(S,) mm, n . (x - x0)."""
        return np.einsum("si,si->s", self.directions, self.points.positions(state) - self.targets)

    def forces(self, state: TorsoState) -> Floats:
        """(S, 3) N, what the springs exert on the bones."""
        return -(self.stiffness * self.extension(state))[:, None] * self.directions

    def energy(self, state: TorsoState) -> float:
        return 0.5 * float(np.sum(self.stiffness * self.extension(state) ** 2))

    def blocks(self, state: TorsoState) -> TermBlocks:
        outer = self.directions[:, :, None] * self.directions[:, None, :]
        return point_blocks(self.points, state, -self.forces(state), self.stiffness[:, None, None] * outer)

    def extended(self, state: TorsoState, dx: Floats) -> Floats:
        """(S,) mm, the extension to first order after a step ``dx`` (dofs,)."""
        rows = dx[: 6 * len(state.bone_positions)].reshape(-1, 6)[self.points.bone]
        return self.extension(state) + np.einsum("si,sij,sj->s", self.directions, self.points.jacobian(state), rows)


@dataclass(frozen=True, repr=False)
class PredictedSprings(ShortRepr):
    """Springs whose force turns with their points as if they were extended by ``extension`` (S,) mm.

    Their energy and gradient are those of ``springs``; in the Hessian, k d^2 x times the force is taken with the
    force that the last step predicted. A stiff spring's own force is far off after a large step, k times an error of
    second order, and so would be the tangent (mechanics/newton.py).
    """

    springs: PointSprings
    extension: Floats

    def energy(self, state: TorsoState) -> float:
        return self.springs.energy(state)

    def blocks(self, state: TorsoState) -> TermBlocks:
        own = self.springs.blocks(state)
        wrong = self.springs.stiffness * (self.extension - self.springs.extension(state))
        hessian = own.hessian.copy()
        hessian[:, 3:, 3:] += rotation_second_derivative(
            wrong[:, None] * self.springs.directions, self.springs.points.arms(state)
        )
        return TermBlocks(own.bone, own.gradient, hessian)
