"""The total energy (Eq. 3), its gradient and Hessian: the one place where terms are assembled.

Degrees of freedom are 6 a bone (dt, dw), then 3 a free node, as in ``anatomy.state.retract``. The Hessian is
written into the values of a fixed lower-triangular pattern. An *entity* is a bone (6 DoFs) or a free node (3).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np

from spinestiff.anatomy.points import rotation_second_derivative
from spinestiff.anatomy.rotation import cross
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import ParameterGroup, StiffnessRatios
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, Ints
from spinestiff.mechanics import joints as joint_law
from spinestiff.mechanics import tissue as tissue_law
from spinestiff.mechanics.terms import BoneTerm

# A moment counts as a force, and a turn as a shift, at this arm, mm, so that one number measures both.
ROTATION_LENGTH = 30.0


class Stiffness(NamedTuple):
    """Actual stiffnesses: joints (J, 6) N/mm and N mm/rad; mu, lambda (T,) MPa of the deformable elements."""

    joints: Floats
    mu: Floats
    lambda_: Floats


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


@numba.njit(cache=True)
def _fill_indices(indices, indptr, keys, offsets, sizes, first_dof, entities):  # type: ignore[no-untyped-def]
    for p in range(len(keys)):
        column, row = keys[p] // entities, keys[p] % entities
        for k in range(sizes[column]):
            base = indptr[first_dof[column] + k] + offsets[p] - k
            for r in range(k if row == column else 0, sizes[row]):
                indices[base + r] = first_dof[row] + r


@numba.njit(cache=True)
def _scatter_dense_blocks(data, indptr, blocks, row_dof, column_dof, offset):  # type: ignore[no-untyped-def]
    """Add dense (n, 6, 6) bone blocks, given as row >= column; a diagonal block adds its lower triangle."""
    for p in range(len(blocks)):
        for k in range(blocks.shape[2]):
            base = indptr[column_dof[p] + k] + offset[p] - k
            for r in range(k if row_dof[p] == column_dof[p] else 0, blocks.shape[1]):
                data[base + r] += blocks[p, r, k]


@numba.njit(cache=True)
def _scatter_elements(data, indptr, hessians, elements, entity, first_dof, arms, bones, offsets):  # type: ignore[no-untyped-def]
    """Add element Hessians (T, pairs, 3, 3) as ``tissue.element_hessians``, pulling tied nodes back to their bones.

    A tied node moves by dt - [arm]x dw, so its rows become [K; [arm]x K] and its columns [K, -K [arm]x].
    """
    n = elements.shape[1]
    block = np.empty((6, 6))
    for t in range(len(elements)):
        pair = 0
        for a in range(n):
            for b in range(a + 1):
                node_a, node_b = elements[t, a], elements[t, b]
                row, column = entity[node_a], entity[node_b]
                swap = row < column
                if swap:
                    node_a, node_b, row, column = node_b, node_a, column, row
                rows = 6 if row < bones else 3
                columns = 6 if column < bones else 3
                for i in range(3):
                    for j in range(3):
                        block[i, j] = hessians[t, pair, j, i] if swap else hessians[t, pair, i, j]
                if rows == 6:
                    x, y, z = arms[node_a, 0], arms[node_a, 1], arms[node_a, 2]
                    for j in range(3):
                        block[3, j] = y * block[2, j] - z * block[1, j]
                        block[4, j] = z * block[0, j] - x * block[2, j]
                        block[5, j] = x * block[1, j] - y * block[0, j]
                if columns == 6:
                    x, y, z = arms[node_b, 0], arms[node_b, 1], arms[node_b, 2]
                    for i in range(rows):
                        block[i, 3] = y * block[i, 2] - z * block[i, 1]
                        block[i, 4] = z * block[i, 0] - x * block[i, 2]
                        block[i, 5] = x * block[i, 1] - y * block[i, 0]
                offset = offsets[t, pair]
                pair += 1
                for k in range(columns):
                    base = indptr[first_dof[column] + k] + offset - k
                    if row == column:
                        for r in range(k, rows):
                            # Nodes a and b of one bone couple twice: K_ab and its transpose.
                            data[base + r] += block[r, k] if a == b else block[r, k] + block[k, r]
                    else:
                        for r in range(rows):
                            data[base + r] += block[r, k]


@numba.njit(cache=True)
def _add_to_nodes(nodes, elements, parts, mu, lambda_):  # type: ignore[no-untyped-def]
    for t in range(len(elements)):
        for a in range(elements.shape[1]):
            for i in range(3):
                nodes[elements[t, a], i] += mu[t] * parts[t, 0, a, i] + lambda_[t] * parts[t, 1, a, i]


class Potential:
    """Energy of a torso as a function of its state. Built once a torso; holds constant arrays only.

    Parameters
    ----------
    torso : rest geometry, joints and tissue.
    """

    def __init__(self, torso: TorsoModel) -> None:
        self.torso = torso
        self.tissue = tissue_law.element_data(torso.tissue)
        self.bones = len(torso.bone_names)
        self.tied = np.flatnonzero(torso.tissue.bone_of_node >= 0)
        self.free = torso.tissue.free_nodes
        self.tied_points = torso.tied_nodes
        self.dofs = 6 * self.bones + 3 * len(self.free)
        self._entity = np.where(torso.tissue.bone_of_node >= 0, torso.tissue.bone_of_node, 0)
        self._entity[self.free] = self.bones + np.arange(len(self.free))
        sizes = np.concatenate([np.full(self.bones, 6), np.full(len(self.free), 3)])
        self._first_dof = np.concatenate([[0], np.cumsum(sizes)])
        n = self.tissue.elements.shape[1]
        a, b = np.tril_indices(n)
        entities = self._entity[self.tissue.elements]
        joints = np.stack([torso.joints.parent, torso.joints.child], 1)
        pairs = np.concatenate([np.stack([entities[:, a], entities[:, b]], -1).reshape(-1, 2), joints])
        self.pattern = build_pattern(pairs, sizes)
        self._element_offsets = self.pattern.offset(entities[:, a], entities[:, b])
        self._joint_offsets = self.pattern.offset(joints[:, 0], joints[:, 1])

    def stiffness(self, ratios: StiffnessRatios | None) -> Stiffness:
        """Stiffnesses at the given ratios; ``None`` is the default model."""
        mu, lambda_ = ratios.tissue if ratios else (1.0, 1.0)
        joints = self.torso.joints.stiffness
        mesh, number = self.torso.tissue, self.tissue.number
        return Stiffness(
            ratios.scale_joints(joints) if ratios else joints,
            mu * mesh.lame_mu[number],
            lambda_ * mesh.lame_lambda[number],
        )

    def nodes(self, state: TorsoState) -> Floats:
        """(N, 3) mm, all tissue nodes."""
        x = np.empty_like(self.torso.tissue.rest_positions)
        x[self.tied] = self.tied_points.positions(state)
        x[self.free] = state.tissue_positions
        return x

    def energy(self, state: TorsoState, stiffness: Stiffness, terms: Sequence[BoneTerm]) -> tuple[float, float]:
        """Total energy (Eq. 3), N mm, and the smallest J at an integration point. Infinite where J <= 0."""
        d = self.tissue
        energy, smallest = tissue_law.element_energies(self.nodes(state), d.elements, d.gradients, d.weights)
        j = float(smallest.min(initial=np.inf))
        if not j > 0.0:
            return np.inf, j
        total = float(stiffness.mu @ energy[:, 0] + stiffness.lambda_ @ energy[:, 1])
        total += float(joint_law.joint_energies(self.torso.joints, state, stiffness.joints).sum())
        return total + sum(term.energy(state) for term in terms), j

    def gradient(self, state: TorsoState, stiffness: Stiffness, terms: Sequence[BoneTerm]) -> Floats:
        """(dofs,) gradient of the total energy, N and N mm; minus the net force of Eq. 5."""
        gradient = self._scatter_nodes(state, self._node_gradient(state, stiffness))
        self._add_joints(gradient, joint_law.joint_gradients(self.torso.joints, state, stiffness.joints))
        for term in terms:
            blocks = term.blocks(state)
            np.add.at(self._bone_rows(gradient), blocks.bone, blocks.gradient)
        return gradient

    def hessian(
        self, state: TorsoState, stiffness: Stiffness, terms: Sequence[BoneTerm], project: bool = False
    ) -> Floats:
        """Values of the Hessian in ``pattern``; with ``project`` every term's negative curvature is left out."""
        p, d = self.pattern, self.tissue
        data = np.zeros(len(p.indices))
        x = self.nodes(state)
        if project:
            elements = tissue_law.projected_element_hessians(x, d, stiffness.mu, stiffness.lambda_)
        else:
            elements = tissue_law.element_hessians(
                x, d.elements, d.gradients, d.weights, stiffness.mu, stiffness.lambda_
            )
        arms = np.zeros_like(x)
        arms[self.tied] = self.tied_points.arms(state)
        _scatter_elements(
            data, p.indptr, elements, d.elements, self._entity, self._first_dof, arms, self.bones, self._element_offsets
        )
        joints = joint_law.joint_hessians(self.torso.joints, state, stiffness.joints)
        self._scatter_joints(data, _positive_part(joints) if project else joints)
        bones = self._bone_blocks(state, stiffness, terms)
        dof, offset = 6 * np.arange(self.bones), np.zeros(self.bones, dtype=np.int64)
        _scatter_dense_blocks(data, p.indptr, _positive_part(bones) if project else bones, dof, dof, offset)
        return data

    def ratio_gradients(self, state: TorsoState, stiffness: Stiffness, groups: Sequence[ParameterGroup]) -> Floats:
        """(dofs, P) d gradient / d log ratio of each group: the group's own share of the force (paper 3.3)."""
        d = self.tissue
        parts = tissue_law.element_gradients(self.nodes(state), d.elements, d.gradients, d.weights)
        none = np.zeros_like(stiffness.mu)
        moduli = (stiffness.mu, none), (none, stiffness.lambda_)
        shares = [self._scatter_nodes(state, self._assemble(parts, *pair)) for pair in moduli]
        columns = np.zeros((self.dofs, len(groups)))
        joints = joint_law.joint_gradient_shares(self.torso.joints, state, stiffness.joints)
        for column, group in enumerate(groups):
            one = group.mu * shares[0] + group.lambda_ * shares[1]
            self._add_joints(one, np.einsum("js,jsd->jd", group.joints, joints))
            columns[:, column] = one
        return columns

    def ratio_products(
        self, state: TorsoState, stiffness: Stiffness, groups: Sequence[ParameterGroup], direction: Floats
    ) -> Floats:
        """(P,) ``ratio_gradients`` times ``direction`` (dofs,), in one pass for any number of groups."""
        d = self.tissue
        rows = direction[: 6 * self.bones].reshape(-1, 6)
        nodes = np.empty_like(self.torso.tissue.rest_positions)
        on = rows[self.tied_points.bone]
        nodes[self.tied] = on[:, :3] + cross(on[:, 3:], self.tied_points.arms(state))
        nodes[self.free] = direction[6 * self.bones :].reshape(-1, 3)
        parts = tissue_law.element_gradient_products(self.nodes(state), d.elements, d.gradients, d.weights, nodes)
        mu, lambda_ = stiffness.mu @ parts[:, 0], stiffness.lambda_ @ parts[:, 1]
        joints = self.torso.joints
        along = np.hstack([rows[joints.parent], rows[joints.child]])
        shares = np.einsum("jsd,jd->js", joint_law.joint_gradient_shares(joints, state, stiffness.joints), along)
        return np.array([g.mu * mu + g.lambda_ * lambda_ + shares[g.joints].sum() for g in groups])

    def _bone_rows(self, gradient: Floats) -> Floats:
        return gradient[: 6 * self.bones].reshape(self.bones, 6)

    def _node_gradient(self, state: TorsoState, stiffness: Stiffness) -> Floats:
        d = self.tissue
        parts = tissue_law.element_gradients(self.nodes(state), d.elements, d.gradients, d.weights)
        return self._assemble(parts, stiffness.mu, stiffness.lambda_)

    def _assemble(self, parts: Floats, mu: Floats, lambda_: Floats) -> Floats:
        """Element gradients per unit mu and lambda (T, 2, n, 3), times the moduli, summed to nodes (N, 3)."""
        nodes = np.zeros_like(self.torso.tissue.rest_positions)
        _add_to_nodes(nodes, self.tissue.elements, parts, mu, lambda_)
        return nodes

    def _scatter_nodes(self, state: TorsoState, node_gradient: Floats) -> Floats:
        gradient = np.zeros(self.dofs)
        on_bones = node_gradient[self.tied]
        rows = np.hstack([on_bones, cross(self.tied_points.arms(state), on_bones)])
        np.add.at(self._bone_rows(gradient), self.tied_points.bone, rows)
        gradient[6 * self.bones :] = node_gradient[self.free].ravel()
        return gradient

    def _add_joints(self, gradient: Floats, joints: Floats) -> None:
        rows = self._bone_rows(gradient)
        np.add.at(rows, self.torso.joints.parent, joints[:, :6])
        np.add.at(rows, self.torso.joints.child, joints[:, 6:])

    def _scatter_joints(self, data: Floats, joints: Floats) -> None:
        parent, child = self.torso.joints.parent, self.torso.joints.child
        zero = np.zeros(len(parent), dtype=np.int64)
        indptr = self.pattern.indptr
        _scatter_dense_blocks(data, indptr, joints[:, :6, :6].copy(), 6 * parent, 6 * parent, zero)
        _scatter_dense_blocks(data, indptr, joints[:, 6:, 6:].copy(), 6 * child, 6 * child, zero)
        lower = np.where((parent > child)[:, None, None], joints[:, :6, 6:], joints[:, 6:, :6])
        row, column = np.maximum(parent, child), np.minimum(parent, child)
        _scatter_dense_blocks(data, indptr, lower, 6 * row, 6 * column, self._joint_offsets)

    def _bone_blocks(self, state: TorsoState, stiffness: Stiffness, terms: Sequence[BoneTerm]) -> Floats:
        """(B, 6, 6): the tied nodes' rotation terms, and everything that acts on one bone alone."""
        blocks = np.zeros((self.bones, 6, 6))
        node_gradient = self._node_gradient(state, stiffness)[self.tied]
        turning = rotation_second_derivative(node_gradient, self.tied_points.arms(state))
        np.add.at(blocks[:, 3:, 3:], self.tied_points.bone, turning)
        for term in terms:
            own = term.blocks(state)
            np.add.at(blocks, own.bone, own.hessian)
        return blocks


def _positive_part(blocks: Floats) -> Floats:
    values, vectors = np.linalg.eigh(blocks)
    return (vectors * np.maximum(values, 0.0)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
