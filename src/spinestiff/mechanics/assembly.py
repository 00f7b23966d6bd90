"""What the laws of an energy are made of: unknowns, a fixed pattern of the Hessian, and how parts get into both.

Degrees of freedom are 6 a bone (dt, dw), then 3 a free node, as in ``anatomy.state.retract``. An *entity* is a bone
(6 DoFs) or a free node (3). The Hessian is written into the values of a fixed lower-triangular pattern.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numba
import numpy as np

from spinestiff.anatomy.rotation import cross
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import ParameterGroup
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, Ints

# A moment counts as a force, and a turn as a shift, at this arm, mm, so that one number measures both.
ROTATION_LENGTH = 30.0


class Stiffness(NamedTuple):
    """Actual stiffnesses: joints (J, 6) N/mm and N mm/rad; mu, lambda (T,) MPa of the deformable elements."""

    joints: Floats
    mu: Floats
    lambda_: Floats


class Unknowns:
    """Which unknown is whose.

    Attributes
    ----------
    torso : whose unknowns these are. bones, dofs : how many bones and unknowns there are.
    tied, free : mesh nodes on bones and off them. tied_points : the tied ones as points of their bones.
    entity : (N,) entity of each mesh node. sizes : (E,) DoFs of each entity. first_dof : (E + 1,) where they begin.
    """

    def __init__(self, torso: TorsoModel) -> None:
        self.torso = torso
        self.bones = len(torso.bone_names)
        self.tied = np.flatnonzero(torso.tissue.bone_of_node >= 0)
        self.free = torso.tissue.free_nodes
        self.tied_points = torso.tied_nodes
        self.entity = np.where(torso.tissue.bone_of_node >= 0, torso.tissue.bone_of_node, 0)
        self.entity[self.free] = self.bones + np.arange(len(self.free))
        self.sizes = np.concatenate([np.full(self.bones, 6), np.full(len(self.free), 3)])
        self.first_dof = np.concatenate([[0], np.cumsum(self.sizes)])
        self.dofs = int(self.first_dof[-1])

    def bone_rows(self, values: Floats) -> Floats:
        """(B, 6) view of the bones' part of values (dofs,)."""
        return values[: 6 * self.bones].reshape(self.bones, 6)

    def node_rows(self, values: Floats) -> Floats:
        """(F, 3) view of the free nodes' part of values (dofs,)."""
        return values[6 * self.bones :].reshape(-1, 3)


class Configuration:
    """A state with what several laws need of it.

    Attributes
    ----------
    unknowns, state : of what, and where. nodes : (N, 3) mm, all tissue nodes.
    """

    def __init__(self, unknowns: Unknowns, state: TorsoState) -> None:
        self.unknowns, self.state = unknowns, state
        self.nodes = np.empty_like(unknowns.torso.tissue.rest_positions)
        self.nodes[unknowns.tied] = unknowns.tied_points.positions(state)
        self.nodes[unknowns.free] = state.tissue_positions

    @cached_property
    def tied_arms(self) -> Floats:
        """(P, 3) mm, from its bone's origin to each tied node."""
        return self.unknowns.tied_points.arms(self.state)

    def add_nodal(self, nodal: Floats, gradient: Floats) -> None:
        """Add derivatives in the positions of all mesh nodes (N, 3) to a gradient (dofs,)."""
        of = self.unknowns
        on_bones = nodal[of.tied]
        rows = np.hstack([on_bones, cross(self.tied_arms, on_bones)])
        np.add.at(of.bone_rows(gradient), of.tied_points.bone, rows)
        of.node_rows(gradient)[:] += nodal[of.free]

    def nodal_motion(self, direction: Floats) -> Floats:
        """(N, 3) how all mesh nodes move, to first order, with the unknowns' ``direction`` (dofs,)."""
        of, nodes = self.unknowns, np.empty_like(self.nodes)
        on = of.bone_rows(direction)[of.tied_points.bone]
        nodes[of.tied] = on[:, :3] + cross(on[:, 3:], self.tied_arms)
        nodes[of.free] = of.node_rows(direction)
        return nodes


class Pattern(NamedTuple):
    """A fixed lower-triangular compressed-column pattern and where blocks of entities lie in it.

    indptr (n + 1,), indices (nnz,) as in SciPy. keys: sorted entity pairs ``column * E + row`` with row >= column;
    offsets: rows that precede the pair's block in its columns, were the diagonal block full.
    """

    indptr: Ints
    indices: Ints
    keys: Ints
    offsets: Ints
    entities: int

    def offset(self, row: Ints, column: Ints) -> Ints:
        """Block offsets of entity pairs; pairs are swapped to row >= column."""
        low, high = np.minimum(row, column), np.maximum(row, column)
        return self.offsets[np.searchsorted(self.keys, low * self.entities + high)]


def build_pattern(pairs: Ints, sizes: Ints) -> Pattern:
    """The pattern of entity ``pairs`` (n, 2) in any order, with every diagonal, for entities of ``sizes`` DoFs."""
    entities = len(sizes)
    first_dof = np.concatenate([[0], np.cumsum(sizes)])
    low, high = pairs.min(1), pairs.max(1)
    diagonal = np.arange(entities) * (entities + 1)
    keys = np.unique(np.concatenate([low * entities + high, diagonal]))
    column, row = keys // entities, keys % entities
    heights = sizes[row]
    running = np.concatenate([[0], np.cumsum(heights)])
    start_of_column = running[np.searchsorted(column, np.arange(entities))]
    offsets = running[:-1] - start_of_column[column]
    height_of_column = np.add.reduceat(heights, np.searchsorted(column, np.arange(entities)))
    # Column k of an entity starts at its own diagonal, so it is k rows shorter than the full block column.
    entity_of_dof = np.repeat(np.arange(entities), sizes)
    within = np.arange(first_dof[-1]) - first_dof[entity_of_dof]
    indptr = np.concatenate([[0], np.cumsum(height_of_column[entity_of_dof] - within)])
    indices = np.empty(indptr[-1], dtype=np.int64)
    _fill_indices(indices, indptr, keys, offsets, sizes, first_dof, entities)
    return Pattern(indptr, indices, keys, offsets, entities)


@numba.njit(cache=True, nogil=True)
def _fill_indices(indices, indptr, keys, offsets, sizes, first_dof, entities):  # type: ignore[no-untyped-def]
    for p in range(len(keys)):
        column, row = keys[p] // entities, keys[p] % entities
        for k in range(sizes[column]):
            base = indptr[first_dof[column] + k] + offsets[p] - k
            for r in range(k if row == column else 0, sizes[row]):
                indices[base + r] = first_dof[row] + r


@numba.njit(cache=True, nogil=True)
def _scatter_dense_blocks(data, indptr, blocks, row_dof, column_dof, offset):  # type: ignore[no-untyped-def]
    """Add dense (n, 6, 6) bone blocks, given as row >= column; a diagonal block adds its lower triangle."""
    for p in range(len(blocks)):
        for k in range(blocks.shape[2]):
            base = indptr[column_dof[p] + k] + offset[p] - k
            for r in range(k if row_dof[p] == column_dof[p] else 0, blocks.shape[1]):
                data[base + r] += blocks[p, r, k]


class Tangent:
    """A Hessian while its parts are added up.

    Attributes
    ----------
    values : (nnz,) in the pattern.
    bones : (B, 6, 6) what depends on one bone's pose alone; it counts as one part of each bone.
    nodes : (F, 3, 3) likewise of free nodes.
    """

    def __init__(self, unknowns: Unknowns, pattern: Pattern) -> None:
        self.unknowns, self.pattern = unknowns, pattern
        self.values = np.zeros(len(pattern.indices))
        self.bones = np.zeros((unknowns.bones, 6, 6))
        self.nodes = np.zeros((len(unknowns.free), 3, 3))

    def add(self, blocks: Floats, row: Ints, column: Ints, offsets: Ints | None = None) -> None:
        """Add blocks (n, r, c) of entity pairs with row >= column at their ``offsets``; none: on the diagonal."""
        first = self.unknowns.first_dof
        offsets = np.zeros(len(blocks), dtype=np.int64) if offsets is None else offsets
        _scatter_dense_blocks(self.values, self.pattern.indptr, blocks, first[row], first[column], offsets)

    def finished(self, project: bool) -> Floats:
        """(nnz,) all of it, with the parts of one bone or node at last."""
        for blocks, first in ((self.bones, 0), (self.nodes, self.unknowns.bones)):
            if blocks.any():
                entity = first + np.arange(len(blocks))
                self.add(positive_part(blocks) if project else blocks, entity, entity)
        return self.values


class Law(ABC):
    """A part of the energy that couples entities: tissue, joints, or one's own (``Potential``)."""

    def pairs(self, unknowns: Unknowns) -> Ints:
        """(n, 2) entities that it couples, in any order."""
        return np.empty((0, 2), dtype=np.int64)

    @abstractmethod
    def energy(self, at: Configuration, stiffness: Stiffness) -> tuple[float, float]:
        """Energy, N mm, and the smallest volume ratio J (infinite where there is no volume); infinite for J <= 0."""

    @abstractmethod
    def add_gradient(self, at: Configuration, stiffness: Stiffness, gradient: Floats) -> None:
        """Add the derivative in the unknowns to ``gradient`` (dofs,)."""

    @abstractmethod
    def add_hessian(
        self, at: Configuration, stiffness: Stiffness, tangent: Tangent, offsets: Ints, project: bool
    ) -> None:
        """Add the second derivative; ``offsets`` (n,) are those of ``pairs``; ``project``: no negative curvature."""


class ScaledLaw(Law):
    """A law whose stiffnesses are scaled by ratios: each group's share of its force is known by itself."""

    @abstractmethod
    def add_shares(
        self, at: Configuration, stiffness: Stiffness, groups: Sequence[ParameterGroup], columns: Floats
    ) -> None:
        """Add d gradient / d log ratio of each group to ``columns`` (dofs, P), contiguous in a column."""

    @abstractmethod
    def share_products(
        self, at: Configuration, stiffness: Stiffness, groups: Sequence[ParameterGroup], direction: Floats
    ) -> Floats:
        """(P,) the columns of ``add_shares`` times ``direction`` (dofs,)."""


def positive_part(blocks: Floats) -> Floats:
    """Symmetric (n, k, k) without their negative eigenvalues."""
    values, vectors = np.linalg.eigh(blocks)
    return (vectors * np.maximum(values, 0.0)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
