"""A state of a torso: where its bones and its free tissue nodes are, how one moves it, and whether two are the same.

Units: mm, rad. World frame, right-handed: x to the patient's left, y superior, z anterior.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.rotation import exp_so3
from spinestiff.arrays import ByFields, Floats, ShortRepr, read_only
from spinestiff.errors import TorsoError


@dataclass(frozen=True, repr=False)
class TorsoState(ByFields, ShortRepr):
    """Where everything is.

    Attributes
    ----------
    bone_positions : (B, 3) mm, world position of each bone's origin.
    bone_rotations : (B, 3, 3) world_from_bone.
    tissue_positions : (F, 3) mm, the free nodes.
    """

    bone_positions: Floats
    bone_rotations: Floats
    tissue_positions: Floats

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "bone_positions", read_only("bone_positions", self.bone_positions, (None, 3), TorsoError))
        b = len(self.bone_positions)
        set_(self, "bone_rotations", read_only("bone_rotations", self.bone_rotations, (b, 3, 3), TorsoError))
        set_(self, "tissue_positions", read_only("tissue_positions", self.tissue_positions, (None, 3), TorsoError))

    @property
    def dofs(self) -> int:
        """6 a bone (dt, dw), then 3 a free node."""
        return 6 * len(self.bone_positions) + 3 * len(self.tissue_positions)

    def _facts(self) -> Iterator[str]:
        yield f"{len(self.bone_positions)} bones"
        yield f"{len(self.tissue_positions)} free nodes"


def retract(state: TorsoState, dx: Floats) -> TorsoState:
    """The state moved by ``dx`` (dofs,): t <- t + dt, R <- exp(dw) R, free nodes x <- x + dx."""
    b = len(state.bone_positions)
    bones = dx[: 6 * b].reshape(b, 6)
    return TorsoState(
        state.bone_positions + bones[:, :3],
        exp_so3(bones[:, 3:]) @ state.bone_rotations,
        state.tissue_positions + dx[6 * b :].reshape(-1, 3),
    )


def state_digest(state: TorsoState) -> str:
    """SHA-256 of a state's numbers: two states are the same or not."""
    digest = hashlib.sha256()
    for array in (state.bone_positions, state.bone_rotations, state.tissue_positions):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
