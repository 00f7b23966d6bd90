"""Where what holds the torso is: a pelvis that stands askew and a shoulder that gave way (paper 2.1).

The belt holds the pelvis and a pad the opposite shoulder, but neither holds them still. An equilibrium can be solved,
and differentiated (``mechanics.sensitivity``), at any place of the two.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from spinestiff.anatomy.rotation import exp_so3, log_so3
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.loads import LoadCase
from spinestiff.mechanics.supports import SupportKind, Supports
from spinestiff.mechanics.terms import PointSprings

OBLIQUITY = 5  # of a bone's six degrees of freedom (dt, dw): turning about the AP axis
FARTHEST_TURN, FARTHEST_MM = 0.5, 100.0


@dataclass(frozen=True)
class SupportPlace:
    """Where the supports are, from where they are at rest.

    Attributes
    ----------
    obliquity : rad, turn of the pelvis about the AP axis (+z) through its own origin; above 0 the left side is higher.
    shoulder_mm : mm, lateral place of the held shoulder, to the patient's left (+x).

    Raises
    ------
    EquilibriumError : more than half a radian or 100 mm.
    """

    obliquity: float = 0.0
    shoulder_mm: float = 0.0

    def __post_init__(self) -> None:
        if not (abs(self.obliquity) <= FARTHEST_TURN and abs(self.shoulder_mm) <= FARTHEST_MM):
            raise EquilibriumError(
                f"supports at an obliquity of {self.obliquity:g} rad and {self.shoulder_mm:g} mm; wanted at most "
                f"{FARTHEST_TURN:g} rad and {FARTHEST_MM:g} mm either way"
            )


AT_REST = SupportPlace()


def held_pelvis(torso: TorsoModel, supports: Supports) -> int:
    """The pelvis' turning degree of freedom, if it is held. Raises EquilibriumError where it is free to turn."""
    pelvis = torso.bone("pelvis")
    if not supports.held[pelvis].all():
        raise EquilibriumError("the pelvis is free to turn, so that it has no obliquity of its own; hold it level")
    return 6 * pelvis + OBLIQUITY


def place_of_pelvis(torso: TorsoModel, state: TorsoState) -> float:
    """The pelvis' obliquity in a state, rad: the AP part of its turn from rest."""
    pelvis = torso.bone("pelvis")
    turned = state.bone_rotations[pelvis] @ torso.rest_pose.bone_rotations[pelvis].T
    return float(log_so3(turned[None])[0, 2])


def turned_with_pelvis(torso: TorsoModel, state: TorsoState, obliquity: float) -> TorsoState:
    """``state`` turned as a whole about the pelvis' origin until the pelvis stands at ``obliquity``.

    Exact where the pelvis is turned about the AP axis alone, as a held one is. Nothing is strained by that but the
    supports' springs.
    """
    angle = obliquity - place_of_pelvis(torso, state)
    if angle == 0.0:
        return state
    turn = exp_so3(np.array([[0.0, 0.0, angle]]))[0]
    about = state.bone_positions[torso.bone("pelvis")]
    return TorsoState(
        about + (state.bone_positions - about) @ turn.T,
        turn @ state.bone_rotations,
        about + (state.tissue_positions - about) @ turn.T,
    )


def shifted_shoulder(supports: Supports, shoulder_mm: float) -> Supports:
    """The supports with the shoulder's pad moved from where it is. Raises EquilibriumError where there is none."""
    springs, moved = supports.springs, supports.of_kind(SupportKind.SHOULDER)
    if shoulder_mm and not moved.any():
        raise EquilibriumError(f"no pad holds a shoulder, so none can be moved by {shoulder_mm:g} mm; ask for 0 mm")
    targets = springs.targets + np.where(moved[:, None], shoulder_mm * _lateral(springs), 0.0)
    return replace(supports, springs=replace(springs, targets=targets))


def shoulder_force(supports: Supports) -> LoadCase:
    """What a mm of the pad's motion adds to the forces on the torso, to first order and exactly: k n (n . x)."""
    springs, moved = supports.springs, np.flatnonzero(supports.of_kind(SupportKind.SHOULDER))
    along = _lateral(springs)
    share = np.einsum("si,si->s", springs.directions, along)
    forces = (springs.stiffness * share)[:, None] * springs.directions
    return LoadCase(springs.points[moved], forces[moved])


def _lateral(springs: PointSprings) -> Floats:
    return np.tile([1.0, 0.0, 0.0], (len(springs.points), 1))
