"""Forces on the torso: the three-point push (paper 2.1, 2.3, Eqs. 1-2)."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from spinestiff.anatomy.names import RIBS
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, Ints, ShortRepr, read_only
from spinestiff.errors import OutsideWarning, TorsoError
from spinestiff.mechanics.terms import TermBlocks, point_blocks

# A push from the patient's right drives the spine to the left: +x, positive in the paper's Table 2.
PUSH_DIRECTION = {"right": 1.0, "left": -1.0}
USUAL_LIMIT_N = 114.0
"""The largest force of the paper's measurements (paper 2.1)."""


@dataclass(frozen=True, repr=False)
class LoadCase(ShortRepr):
    """Dead forces at material points of bones and at tissue nodes; E_ext = -f . x (paper 3.1).

    Attributes
    ----------
    points : (P,) points on bones.
    forces : (P, 3) N, world axes.
    label : for messages and tables.
    nodes : (M,) free tissue nodes, as rows of ``TorsoState.tissue_positions``; see ``tissue_load``.
    node_forces : (M, 3) N.
    against : how many of the last points carry what holds the torso against the push, as dead loads F1 and F2 do.
    """

    points: PointsOnBones
    forces: Floats
    label: str = ""
    nodes: Ints = field(default_factory=lambda: np.empty(0, np.int64))
    node_forces: Floats = field(default_factory=lambda: np.empty((0, 3)))
    against: int = 0

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "forces", read_only("forces", self.forces, (len(self.points), 3), TorsoError))
        set_(self, "nodes", read_only("nodes", self.nodes, (None,), TorsoError, np.int64))
        set_(self, "node_forces", read_only("node_forces", self.node_forces, (len(self.nodes), 3), TorsoError))
        if len(self.nodes) and self.nodes.min() < 0:
            raise TorsoError(f"a load acts on free node {self.nodes.min()}; wanted numbers from 0")

    @property
    def size(self) -> float:
        """Sum of the forces' lengths, N."""
        return float(np.linalg.norm(np.vstack([self.forces, self.node_forces]), axis=1).sum())

    @property
    def total(self) -> Floats:
        """(3,) N, the sum of all forces."""
        return self.forces.sum(axis=0) + self.node_forces.sum(axis=0)

    @property
    def push(self) -> LoadCase:
        """Without what holds against it."""
        if not self.against:
            return self
        count = len(self.points) - self.against
        return replace(self, points=self.points[np.arange(count)], forces=self.forces[:count], against=0)

    def moment(self, state: TorsoState) -> Floats:
        """(3,) N mm, the moment of all forces about the world's origin in ``state``."""
        on_bones = np.cross(self.points.positions(state), self.forces).sum(axis=0)
        return on_bones + np.cross(state.tissue_positions[self.nodes], self.node_forces).sum(axis=0)

    def scaled(self, factor: float) -> LoadCase:
        return replace(self, forces=factor * self.forces, node_forces=factor * self.node_forces)

    def energy(self, state: TorsoState) -> float:
        on_nodes = float(np.sum(self.node_forces * state.tissue_positions[self.nodes]))
        return -float(np.sum(self.forces * self.points.positions(state))) - on_nodes

    def require_on(self, state: TorsoState) -> None:
        """Raise TorsoError unless ``state`` has the bones and the free nodes that this load acts on."""
        kinds = (("bone", self.points.bone, state.bone_positions), ("free node", self.nodes, state.tissue_positions))
        for what, acting, present in kinds:
            if acting.max(initial=-1) >= len(present):
                raise TorsoError(f"a load acts on {what} {acting.max()}, but the torso has {len(present)}")

    def blocks(self, state: TorsoState) -> TermBlocks:
        on_bones = point_blocks(self.points, state, -self.forces, None)
        curved = np.zeros((len(self.nodes), 3, 3))
        return replace(on_bones, node=self.nodes, node_gradient=-self.node_forces, node_hessian=curved)

    def _facts(self) -> Iterator[str]:
        if self.label:
            yield repr(self.label)
        yield f"{self.size:.6g} N at {len(self.points)} points and {len(self.nodes)} tissue nodes"


def tissue_load(torso: TorsoModel, nodes: Ints, forces: Floats, label: str = "") -> LoadCase:
    """Dead ``forces`` (M, 3) N at ``nodes`` (M,) of the tissue mesh; tied ones carry theirs to their bones.

    Raises
    ------
    TorsoError : a node that the mesh does not have.
    """
    mesh = torso.tissue
    nodes = read_only("nodes", nodes, (None,), TorsoError, np.int64)
    forces = read_only("forces", forces, (len(nodes), 3), TorsoError)
    strange = nodes[(nodes < 0) | (nodes >= len(mesh.rest_positions))]
    if len(strange):
        raise TorsoError(
            f"a load acts on tissue node {strange[0]}; the mesh has nodes 0 to {len(mesh.rest_positions) - 1}"
        )
    bone = mesh.bone_of_node[nodes]
    tied, free = bone >= 0, bone < 0
    points = PointsOnBones.at(torso.rest_pose, bone[tied], mesh.rest_positions[nodes[tied]])
    rows = np.searchsorted(mesh.free_nodes, nodes[free])
    return LoadCase(points, forces[tied], label, rows, forces[free])


def no_load() -> LoadCase:
    """The unloaded torso."""
    return LoadCase(PointsOnBones(np.empty(0, np.int64), np.empty((0, 3))), np.empty((0, 3)), "unloaded")


def rib_push(
    torso: TorsoModel, side: str, level: float, force_n: float, anterior_mm: float = 0.0, label: str = ""
) -> LoadCase:
    """The gauge's force F3 on the ribs of one side, split over the two ribs beside its level by the lever rule.

    Warns (``OutsideWarning``) above ``USUAL_LIMIT_N``: nothing that the model was compared with was pushed harder.

    Parameters
    ----------
    side : "left" or "right", the patient's side that is pushed; the force points to the other side.
    level : rib number, e.g. 7.25 = a quarter of the way from rib 7 to rib 8.
    force_n : magnitude, N, >= 0.
    anterior_mm : the point's distance in front of the rib's most lateral point.

    Raises
    ------
    TorsoError : unknown side, level outside 1-12, negative force, a torso without the landmark "rib_lateral".
    """
    if force_n > USUAL_LIMIT_N:
        warnings.warn(
            f"a push of {force_n:g} N: the model was made for up to {USUAL_LIMIT_N:g} N, the largest that was measured",
            OutsideWarning,
            stacklevel=2,
        )
    return rib_load(torso, side, level, force_n, anterior_mm, label)


def rib_load(
    torso: TorsoModel, side: str, level: float, force_n: float, anterior_mm: float = 0.0, label: str = ""
) -> LoadCase:
    """As ``rib_push``, for what has judged the force by itself: no warning."""
    if side not in PUSH_DIRECTION:
        raise TorsoError(f"push side '{side}'; wanted 'left' or 'right'")
    if not 1.0 <= level <= 12.0:
        raise TorsoError(f"push level {level}; wanted a rib number from 1 to 12")
    if not force_n >= 0.0:
        raise TorsoError(f"push force {force_n} N; wanted a magnitude, the sign comes from the side")
    upper = min(int(level), 11)
    share = level - upper
    rows = [RIBS.index(f"R{upper + i}_{side[0].upper()}") for i in (0, 1)]
    lateral = torso.landmark("rib_lateral")[rows]
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
