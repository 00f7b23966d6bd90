"""Blocks of tissue with closed-form answers, built from nothing but what a torso has: bones, ties, holds, joints.

A node that has to slide or to be moved is a bone of its own, with its turn held: so a hold of a bone's degree of
freedom becomes any boundary condition, and the checks run through the same code as a patient's torso.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.grid_mesh import quadratic
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, Ints
from spinestiff.mechanics.supports import Supports
from spinestiff.mechanics.terms import PointSprings
from spinestiff.verification.models import box_mesh, make_torso


def young_poisson(mu: float, lambda_: float) -> tuple[float, float]:
    """Young's modulus and Poisson's ratio of Lame's parameters."""
    return mu * (3.0 * lambda_ + 2.0 * mu) / (lambda_ + mu), 0.5 * lambda_ / (lambda_ + mu)


def holds(held: np.ndarray) -> Supports:
    """Supports that hold the given degrees of freedom, (B, 6) bool, and have no springs."""
    none = PointsOnBones(np.empty(0, np.int64), np.empty((0, 3)))
    return Supports(held, PointSprings(none, np.empty((0, 3)), np.empty((0, 3)), np.empty(0)), ())


def jittered_box(
    cells: tuple[int, int, int], size: tuple[float, float, float], nodes: int, jitter: float = 0.2, curve: float = 0.0
) -> tuple[Floats, Ints]:
    """``box_mesh`` whose inner corners are moved at random by up to ``jitter`` of their spacing; the box stays a box.

    Ten-node elements stay straight unless ``curve`` moves the inner middles of edges by that share of the spacing:
    the four-point rule integrates straight elements exactly, curved ones to about 1e-5.
    """
    random = np.random.default_rng(5)
    spacing = np.array(size) / cells
    positions, elements = box_mesh(cells, size, 4)
    positions = positions + random.uniform(-jitter, jitter, positions.shape) * spacing * _inner(positions, size)
    if nodes == 4:
        return positions, elements
    corners = len(positions)
    positions, elements = quadratic(positions, elements)
    move = random.uniform(-curve, curve, positions.shape) * spacing * _inner(positions, size)
    move[:corners] = 0.0
    return positions + move, elements


def _inner(positions: Floats, size: tuple[float, float, float]) -> np.ndarray:
    inner: np.ndarray = np.all((positions > 1e-9) & (positions < np.array(size) - 1e-9), axis=1, keepdims=True)
    return inner


@dataclass(frozen=True)
class PointBoneBlock:
    """A block of tissue some of whose nodes are bones.

    Attributes
    ----------
    torso, supports : what is solved.
    nodes : (B,) mesh node of each point bone. positions, elements : the mesh.
    """

    torso: TorsoModel
    supports: Supports
    nodes: Ints
    positions: Floats
    elements: Ints

    def start(self, bone_positions: Floats, node_positions: Floats) -> TorsoState:
        """A state from world positions of the point bones (B, 3) and of all mesh nodes (N, 3)."""
        free = self.torso.tissue.free_nodes
        return TorsoState(bone_positions, self.torso.rest_pose.bone_rotations, node_positions[free])


def point_bone_block(mesh: tuple[Floats, Ints], held: np.ndarray, mu: float, lambda_: float) -> PointBoneBlock:
    """A block whose nodes with any of ``held`` (N, 3) are point bones held in those directions, and in their turn."""
    positions, elements = mesh
    chosen = np.flatnonzero(held.any(1))
    owner = np.full(len(positions), -1)
    owner[chosen] = np.arange(len(chosen))
    torso = make_torso(positions[chosen], [], np.zeros(6), mesh, owner, *young_poisson(mu, lambda_))
    six = np.ones((len(chosen), 6), dtype=bool)
    six[:, :3] = held[chosen]
    return PointBoneBlock(torso, holds(six), chosen, positions, elements)


def stacked_block(
    cells: tuple[int, int, int],
    size: tuple[float, float, float],
    mu: float,
    lambda_: float,
    extra_bones: Floats,
    links: list[tuple[int, int]],
    stiffness: Floats,
    nodes: int = 10,
) -> tuple[TorsoModel, int]:
    """A laterally confined block along z: bottom and top are bones, and so is the rim of each layer between.

    A rim cannot widen, so the block deforms along z alone; the layers' inner nodes are free. Bones are the layers from
    the bottom (0) to the top, then ``extra_bones`` (n, 3). Returns the torso and the number of layers.
    """
    positions, elements = jittered_box(cells, size, nodes)
    heights = np.unique(box_mesh(cells, size, nodes)[0][:, 2].round(9))
    rim = ((positions < 1e-9) | (positions > np.array(size) - 1e-9)).any(1)
    layer = np.abs(positions[:, 2:] - heights).argmin(1)
    middles = np.column_stack([np.full((len(heights), 2), 0.5 * np.array(size[:2])), heights])
    young, poisson = young_poisson(mu, lambda_)
    torso = make_torso(
        np.vstack([middles, extra_bones.reshape(-1, 3)]),
        links,
        stiffness,
        (positions, elements),
        np.where(rim, layer, -1),
        young,
        poisson,
    )
    return torso, len(heights)
