"""Forces on the torso: the three-point push (paper 2.1, 2.3, Eqs. 1-2)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from spinestiff.anatomy.names import RIBS
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, read_only
from spinestiff.errors import TorsoError
from spinestiff.mechanics.terms import BoneBlocks, point_blocks

# A push from the patient's right drives the spine to the left: +x, positive in the paper's Table 2.
PUSH_DIRECTION = {"right": 1.0, "left": -1.0}


@dataclass(frozen=True)
class LoadCase:
    """Dead forces at material points of bones; E_ext = -f . x (paper 3.1).

    Attributes
    ----------
    points : (P,) points on bones.
    forces : (P, 3) N, world axes.
    label : for messages and tables.
    """

    points: PointsOnBones
    forces: Floats
    label: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "forces", read_only("forces", self.forces, (len(self.points), 3), TorsoError))

    @property
    def size(self) -> float:
        """Sum of the forces' lengths, N."""
        return float(np.linalg.norm(self.forces, axis=1).sum())

    def scaled(self, factor: float) -> LoadCase:
        return replace(self, forces=factor * self.forces)

    def energy(self, state: TorsoState) -> float:
        return -float(np.sum(self.forces * self.points.positions(state)))

    def blocks(self, state: TorsoState) -> BoneBlocks:
        return point_blocks(self.points, state, -self.forces, None)


def no_load() -> LoadCase:
    """The unloaded torso."""
    return LoadCase(PointsOnBones(np.empty(0, np.int64), np.empty((0, 3))), np.empty((0, 3)), "unloaded")


def rib_push(
    torso: TorsoModel, side: str, level: float, force_n: float, anterior_mm: float = 0.0, label: str = ""
) -> LoadCase:
    """The gauge's force F3 on the ribs of one side, split over the two ribs nearest in height by the lever rule.

    Parameters
    ----------
    side : "left" or "right", the patient's side that is pushed; the force points to the other side.
    level : rib number, e.g. 7.25 = a quarter of the way from rib 7 to rib 8.
    force_n : magnitude, N, >= 0.
    anterior_mm : the point's distance in front of the rib's most lateral point.

    Raises
    ------
    TorsoError : unknown side, level outside 1-12, negative force.
    """
    if side not in PUSH_DIRECTION:
        raise TorsoError(f"push side '{side}'; wanted 'left' or 'right'")
    if not 1.0 <= level <= 12.0:
        raise TorsoError(f"push level {level}; wanted a rib number from 1 to 12")
    if not force_n >= 0.0:
        raise TorsoError(f"push force {force_n} N; wanted a magnitude, the sign comes from the side")
    upper = min(int(level), 11)
    share = level - upper
    rows = [RIBS.index(f"R{upper + i}_{side[0].upper()}") for i in (0, 1)]
    lateral = torso.landmarks["rib_lateral"][rows]
    places = lateral.positions(torso.rest_pose) + np.array([0.0, 0.0, anterior_mm])
    points = PointsOnBones.at(torso.rest_pose, lateral.bone, places)
    forces = np.zeros((2, 3))
    forces[:, 0] = PUSH_DIRECTION[side] * force_n * np.array([1.0 - share, share])
    return LoadCase(points, forces, label)


def three_point_reactions(force_n: float, d21_mm: float, d31_mm: float) -> tuple[float, float]:
    """F1 on the shoulder and F2 on the pelvis that balance the push F3 in the frontal plane (Eqs. 1-2).

    F2 = d31/d21 F3 and F1 = (d21 - d31)/d21 F3, d measured downward from the shoulder to pelvis and ribs.

    Raises
    ------
    TorsoError : the ribs don't lie between shoulder and pelvis.
    """
    if not 0.0 < d31_mm < d21_mm:
        raise TorsoError(
            f"d31 = {d31_mm} mm, d21 = {d21_mm} mm; wanted 0 < d31 < d21 (ribs between shoulder and pelvis)"
        )
    f2 = d31_mm / d21_mm * force_n
    return force_n - f2, f2
