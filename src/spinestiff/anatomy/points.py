"""Points that ride on bones.

A point is ``x = t + R r``. With ``a = R r`` and the update ``R <- exp(w) R``: ``dx/dt = I``, ``dx/dw = -[a]x``,
and for a force gradient ``g`` on the point the second derivative of ``g . x`` in ``w`` is
``(g a^T + a g^T)/2 - (g . a) I``. This one formula serves tissue coupling, loads, supports and image corners.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from spinestiff.anatomy.rotation import cross_matrix
from spinestiff.anatomy.state import TorsoState
from spinestiff.arrays import ByFields, Floats, Ints, ShortRepr, read_only
from spinestiff.errors import TorsoError


@dataclass(frozen=True, repr=False)
class PointsOnBones(ByFields, ShortRepr):
    """Points fixed to bones.

    Attributes
    ----------
    bone : (P,) index into the torso's bones.
    offset : (P, 3) mm in the bone's frame.

    Raises
    ------
    TorsoError : a negative bone.
    """

    bone: Ints
    offset: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "bone", read_only("bone", self.bone, (None,), TorsoError, np.int64))
        object.__setattr__(self, "offset", read_only("offset", self.offset, (len(self.bone), 3), TorsoError))
        if len(self.bone) and self.bone.min() < 0:
            raise TorsoError(f"a point rides on bone {self.bone.min()}; wanted numbers from 0")

    def __len__(self) -> int:
        return len(self.bone)

    def __getitem__(self, which: Any) -> PointsOnBones:
        chosen = np.atleast_1d(np.arange(len(self))[which])
        return PointsOnBones(self.bone[chosen], self.offset[chosen])

    def arms(self, state: TorsoState) -> Floats:
        """``a = R r``, (P, 3) mm, in world axes."""
        return np.einsum("pij,pj->pi", state.bone_rotations[self.bone], self.offset)

    def positions(self, state: TorsoState) -> Floats:
        """World positions, (P, 3) mm."""
        return state.bone_positions[self.bone] + self.arms(state)

    def jacobian(self, state: TorsoState) -> Floats:
        """d position / d (dt, dw) of the point's own bone, (P, 3, 6)."""
        identity = np.broadcast_to(np.eye(3), (len(self), 3, 3))
        return np.concatenate([identity, -cross_matrix(self.arms(state))], axis=2)

    @staticmethod
    def at(state: TorsoState, bone: Ints, positions: Floats) -> PointsOnBones:
        """The points that lie at world ``positions`` (P, 3) in ``state``."""
        bone = np.asarray(bone, dtype=np.int64)
        relative = np.asarray(positions, dtype=float) - state.bone_positions[bone]
        return PointsOnBones(bone, np.einsum("pji,pj->pi", state.bone_rotations[bone], relative))


def rotation_second_derivative(gradient: Floats, arm: Floats) -> Floats:
    """``(g a^T + a g^T)/2 - (g . a) I``: second derivative of ``g . (t + exp(w) a)`` in ``w`` at 0. (P, 3, 3)."""
    outer = gradient[:, :, None] * arm[:, None, :]
    dot = np.einsum("pi,pi->p", gradient, arm)
    return 0.5 * (outer + outer.transpose(0, 2, 1)) - dot[:, None, None] * np.eye(3)
