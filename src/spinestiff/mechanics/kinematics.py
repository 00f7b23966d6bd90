"""Relative coordinates, in which the steps to an equilibrium are taken.

Stiff joints and large turns make straight steps expensive: two bones that turn by different amounts are pulled apart
by w^2 r / 2, and a joint of 1,700 N/mm answers with thousands of newtons. In the coordinates y of a *frame* (a state
with a spanning tree of joints and supports over it) the stiff strains change linearly instead:

    bone        turn w' in its own axes: R <- R exp(w')
    its place   strain d of the joint that ties it to its parent in the tree, in the joint's axes on the parent
                (a bone without parent, a root: the displacement in world axes of its origin or of where a spring
                holds it)
    free node   displacement z in the axes of the bones around it, on top of being carried along by them:
                x <- sum_b W_b (t_b + R_b r_b) + A z, with W harmonic weights and A their mean rotation

``dx = T y`` to first order, dx as in ``anatomy.state.retract``. T and its inverse are sweeps along the tree. The
tangent stiffness hardly changes in these coordinates when a part of the torso turns as a whole, so that the factor of
an earlier state goes on serving (``quasi_newton.FrameFactor``).
"""

from __future__ import annotations

import numba
import numpy as np

from spinestiff.anatomy.rotation import cross, exp_so3
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, Ints
from spinestiff.mechanics.factor import Analysis
from spinestiff.mechanics.supports import Supports

# Added to the diagonal of the weights' Laplacian: tissue that hangs on no bone is carried by none.
_LOOSE = 1e-9


class Kinematics:
    """The spanning tree and the weights of a torso on its supports; constant.

    Parameters
    ----------
    torso : bones, joints, tissue.
    supports : a bone of which a translation is held is a root of the tree, and so is one that a spring holds more
        stiffly than any joint ties it to the rest.
    """

    def __init__(self, torso: TorsoModel, supports: Supports) -> None:
        self.torso = torso
        self.held = supports.held
        self.bones = len(torso.bone_names)
        self.order, self.parent, joint, spring = _spanning_tree(torso, supports)
        joints = torso.joints
        tied, anchored = np.flatnonzero(joint >= 0), np.flatnonzero(spring >= 0)
        j = joint[tied]
        # The tree may run against a joint's own direction, from its child to its parent.
        along = (joints.child[j] == tied)[:, None]
        self.arm = np.zeros((self.bones, 3))
        self.axes = np.tile(np.eye(3), (self.bones, 1, 1))
        self.arm[tied] = np.where(along, joints.child_position[j], joints.parent_position[j])
        self.arm[anchored] = supports.springs.points.offset[spring[anchored]]
        self.axes[tied] = np.where(along[..., None], joints.parent_axes[j], joints.child_axes[j])
        self.weights = _harmonic_weights(torso)

    def at(self, state: TorsoState) -> Frame:
        return Frame(self, state)


class Frame:
    """Relative coordinates about one state; every method takes or gives (dofs,) arrays."""

    def __init__(self, kinematics: Kinematics, state: TorsoState) -> None:
        self._k = k = kinematics
        self.state = state
        rotations = state.bone_rotations
        self._arm = np.einsum("bij,bj->bi", rotations, k.arm)
        above = np.maximum(k.parent, 0)
        self._axes = rotations[above] @ k.axes
        self._axes[k.parent < 0] = np.eye(3)
        # The joint's centre on the bone, from the parent's origin.
        self._gap = state.bone_positions + self._arm - state.bone_positions[above]
        turned = rotations @ np.swapaxes(k.torso.rest_pose.bone_rotations, 1, 2)
        self._blend = _polar((k.weights @ turned.reshape(-1, 9)).reshape(-1, 3, 3))

    def to_world(self, y: Floats) -> Floats:
        """dx = T y."""
        rows = self._world_rows(y)
        carried = self._carry(rows)
        z = np.einsum("fij,fj->fi", self._blend, self._nodes(y))
        return np.concatenate([rows.ravel(), (carried + z).ravel()])

    def from_world(self, dx: Floats) -> Floats:
        """y = T^-1 dx."""
        rows, k = dx[: 6 * self._k.bones].reshape(-1, 6), self._k
        y = np.empty((k.bones, 6))
        y[:, 3:] = np.einsum("bji,bj->bi", self.state.bone_rotations, rows[:, 3:])
        above = np.maximum(k.parent, 0)
        own = rows[:, :3] + cross(rows[:, 3:], self._arm)
        carried = rows[above, :3] + cross(rows[above, 3:], self._gap)
        strain = np.einsum("bji,bj->bi", self._axes, own - carried)
        y[:, :3] = np.where((k.parent < 0)[:, None], own, strain)
        z = np.einsum("fji,fj->fi", self._blend, self._nodes(dx) - self._carry(rows))
        return np.concatenate([y.ravel(), z.ravel()])

    def pull(self, force: Floats) -> Floats:
        """T^T of a gradient: per dx in, per y out."""
        nodes, k = self._nodes(force), self._k
        rows = force[: 6 * k.bones].reshape(-1, 6) + self._carry_transposed(nodes)
        y = np.empty((k.bones, 6))
        _pull_tree(k.order, k.parent, self._arm, self._gap, self._axes, rows, y)
        y[:, 3:] = np.einsum("bji,bj->bi", self.state.bone_rotations, rows[:, 3:])
        return np.concatenate([y.ravel(), np.einsum("fji,fj->fi", self._blend, nodes).ravel()])

    def push(self, force: Floats) -> Floats:
        """T^-T of a gradient: per y in, per dx out."""
        y, k = force[: 6 * self._k.bones].reshape(-1, 6), self._k
        nodes = np.einsum("fij,fj->fi", self._blend, self._nodes(force))
        rows = -self._carry_transposed(nodes)
        rows[:, 3:] += np.einsum("bij,bj->bi", self.state.bone_rotations, y[:, 3:])
        strain = np.einsum("bij,bj->bi", self._axes, y[:, :3])
        rows[:, :3] += strain
        rows[:, 3:] += cross(self._arm, strain)
        tied = np.flatnonzero(k.parent >= 0)
        np.add.at(rows, k.parent[tied], np.hstack([-strain[tied], -cross(self._gap[tied], strain[tied])]))
        return np.concatenate([rows.ravel(), nodes.ravel()])

    def move(self, y: Floats) -> TorsoState:
        """The state after the finite step ``y``."""
        k, before = self._k, self.state
        w = np.einsum("bij,bj->bi", before.bone_rotations, y[: 6 * k.bones].reshape(-1, 6)[:, 3:])
        w[k.held[:, 3:]] = 0.0
        turn = exp_so3(w)
        strain = np.einsum("bij,bj->bi", self._axes, y[: 6 * k.bones].reshape(-1, 6)[:, :3])
        strain[k.held[:, :3]] = 0.0
        positions = np.empty_like(before.bone_positions)
        _move_tree(k.order, k.parent, self._arm, self._gap, turn, strain, before.bone_positions, positions)
        offsets = positions - np.einsum("bij,bj->bi", turn, before.bone_positions)
        blended = k.weights @ np.hstack([turn.reshape(-1, 9), offsets])
        x = before.tissue_positions
        left = 1.0 - k.weights.sum(1, keepdims=True)  # of tissue on no bone
        nodes = np.einsum("fij,fj->fi", blended[:, :9].reshape(-1, 3, 3), x) + blended[:, 9:] + left * x
        nodes += np.einsum("fij,fj->fi", self._blend, self._nodes(y))
        return TorsoState(positions, turn @ before.bone_rotations, nodes)

    def _nodes(self, values: Floats) -> Floats:
        return values[6 * self._k.bones :].reshape(-1, 3)

    def _world_rows(self, y: Floats) -> Floats:
        k, y = self._k, y[: 6 * self._k.bones].reshape(-1, 6)
        rows = np.empty((k.bones, 6))
        rows[:, 3:] = np.einsum("bij,bj->bi", self.state.bone_rotations, y[:, 3:])
        strain = np.einsum("bij,bj->bi", self._axes, y[:, :3])
        _push_tree(k.order, k.parent, self._arm, self._gap, strain, rows)
        rows[k.held] = 0.0
        return rows

    def _carry(self, rows: Floats) -> Floats:
        # sum_b W_b (dt + dw x (x - t)) for every free node.
        offsets = rows[:, :3] - cross(rows[:, 3:], self.state.bone_positions)
        blended = self._k.weights @ np.hstack([offsets, rows[:, 3:]])
        return blended[:, :3] + cross(blended[:, 3:], self.state.tissue_positions)

    def _carry_transposed(self, nodes: Floats) -> Floats:
        rows = self._k.weights.T @ np.hstack([nodes, cross(self.state.tissue_positions, nodes)])
        rows[:, 3:] -= cross(self.state.bone_positions, rows[:, :3])
        return rows


def _spanning_tree(torso: TorsoModel, supports: Supports) -> tuple[Ints, Ints, Ints, Ints]:
    """Bones in an order in which parents come first; parent, joint and spring of each, or -1.

    A maximum spanning tree (Kruskal 1956) of bones and ground, an edge's weight being its largest stiffness along an
    axis. Pieces that hang on nothing get a root of their own.
    """
    joints, springs, n = torso.joints, supports.springs, len(torso.bone_names)
    ground = n
    tree = list(range(n + 1))

    def top(i: int) -> int:
        while tree[i] != i:
            i = tree[i]
        return i

    for bone in np.flatnonzero(supports.held[:, :3].any(axis=1)).tolist():
        tree[top(bone)] = top(ground)
    edges = [(k, 0, j) for j, k in enumerate(joints.stiffness[:, :3].max(axis=1).tolist())]
    edges += [(k, 1, s) for s, k in enumerate(springs.stiffness.tolist())]
    beside: list[list[tuple[int, int]]] = [[] for _ in range(n)]
    spring = np.full(n, -1, dtype=np.int64)
    for weight, of_spring, i in sorted(edges, key=lambda edge: (-edge[0], edge[1:])):
        a, b = (int(springs.points.bone[i]), ground) if of_spring else (int(joints.parent[i]), int(joints.child[i]))
        if weight <= 0.0 or top(a) == top(b):
            continue
        tree[top(a)] = top(b)
        if of_spring:
            spring[a] = i
        else:
            beside[a].append((b, i))
            beside[b].append((a, i))
    parent, joint = np.full(n, -1, dtype=np.int64), np.full(n, -1, dtype=np.int64)
    placed, order = np.zeros(n, dtype=bool), []
    roots = np.flatnonzero(supports.held[:, :3].any(axis=1) | (spring >= 0)).tolist()
    for root in [*roots, *range(n)]:
        ahead = [] if placed[root] else [root]
        placed[ahead] = True
        while ahead:
            bone = ahead.pop()
            order.append(bone)
            for other, j in beside[bone]:
                if not placed[other]:
                    placed[other], parent[other], joint[other] = True, bone, j
                    ahead.append(other)
    return np.array(order, dtype=np.int64), parent, joint, spring


def _harmonic_weights(torso: TorsoModel) -> Floats:
    """(F, B) how much each bone carries each free node: 1 on the bone's own nodes, harmonic between."""
    mesh, bones = torso.tissue, len(torso.bone_names)
    free = mesh.free_nodes
    if not len(free):
        return np.zeros((0, bones))
    a, b = np.triu_indices(mesh.elements.shape[1], 1)
    edges = np.stack([mesh.elements[:, a].ravel(), mesh.elements[:, b].ravel()], 1)
    edges = np.unique(np.sort(edges, axis=1), axis=0)
    length2 = np.sum((mesh.rest_positions[edges[:, 0]] - mesh.rest_positions[edges[:, 1]]) ** 2, axis=1)
    weight = length2.mean() / length2
    number = np.full(len(mesh.rest_positions), -1)
    number[free] = np.arange(len(free))
    diagonal = np.zeros(len(free))
    rhs = np.zeros((len(free), bones))
    for one, other in ((0, 1), (1, 0)):
        here, there = edges[:, one], edges[:, other]
        mine = number[here] >= 0
        np.add.at(diagonal, number[here[mine]], weight[mine])
        bone = mesh.bone_of_node[there]
        on_bone = mine & (bone >= 0)
        np.add.at(rhs, (number[here[on_bone]], bone[on_bone]), weight[on_bone])
    inside = (number[edges] >= 0).all(1)
    low, high = np.sort(number[edges[inside]], axis=1).T
    column = np.concatenate([np.arange(len(free)), low])
    row = np.concatenate([np.arange(len(free)), high])
    values = np.concatenate([diagonal + _LOOSE, -weight[inside]])
    by_column = np.lexsort((row, column))
    indptr = np.concatenate([[0], np.cumsum(np.bincount(column, minlength=len(free)))])
    return Analysis(indptr, row[by_column]).factor(values[by_column]).solve(rhs)


@numba.njit(cache=True, nogil=True)
def _polar(matrices):  # type: ignore[no-untyped-def]
    """The rotation nearest to each (3, 3), in place, by Newton-Schulz steps; the identity where there is none near."""
    off, step = np.empty((3, 3)), np.empty((3, 3))
    for f in range(len(matrices)):
        m = matrices[f]
        largest = np.inf
        for _ in range(20):
            last, largest = largest, 0.0
            for i in range(3):
                for j in range(i + 1):
                    value = m[0, i] * m[0, j] + m[1, i] * m[1, j] + m[2, i] * m[2, j]
                    if i == j:
                        value -= 1.0
                    off[i, j] = off[j, i] = value
                    largest = max(largest, abs(value))
            if largest < 1e-12 or not largest < min(last, 1.0):
                break
            for i in range(3):
                for j in range(3):
                    step[i, j] = m[i, 0] * off[0, j] + m[i, 1] * off[1, j] + m[i, 2] * off[2, j]
            for i in range(3):
                for j in range(3):
                    m[i, j] -= 0.5 * step[i, j]
        if not largest < 1e-9:
            for i in range(3):
                for j in range(3):
                    m[i, j] = 1.0 if i == j else 0.0
    return matrices


@numba.njit(cache=True, nogil=True)
def _push_tree(order, parent, arm, gap, strain, rows):  # type: ignore[no-untyped-def]
    # Turns in rows[:, 3:] are given; displacements follow from the parents and the strains.
    for b in order:
        p = parent[b]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            rows[b, i] = strain[b, i] - rows[b, 3 + j] * arm[b, k] + rows[b, 3 + k] * arm[b, j]
            if p >= 0:
                rows[b, i] += rows[p, i] + rows[p, 3 + j] * gap[b, k] - rows[p, 3 + k] * gap[b, j]


@numba.njit(cache=True, nogil=True)
def _pull_tree(order, parent, arm, gap, axes, rows, y):  # type: ignore[no-untyped-def]
    # Forces and moments in ``rows`` are handed down to the roots; y[:, :3] takes each joint's force.
    for n in range(len(order) - 1, -1, -1):
        b = order[n]
        p = parent[b]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            y[b, i] = axes[b, 0, i] * rows[b, 0] + axes[b, 1, i] * rows[b, 1] + axes[b, 2, i] * rows[b, 2]
            if p >= 0:
                rows[p, i] += rows[b, i]
                rows[p, 3 + i] += gap[b, j] * rows[b, k] - gap[b, k] * rows[b, j]
            rows[b, 3 + i] -= arm[b, j] * rows[b, k] - arm[b, k] * rows[b, j]


@numba.njit(cache=True, nogil=True)
def _move_tree(order, parent, arm, gap, turn, strain, before, after):  # type: ignore[no-untyped-def]
    for b in order:
        p = parent[b]
        for i in range(3):
            after[b, i] = before[b, i] + arm[b, i] + strain[b, i] if p < 0 else after[p, i]
            for k in range(3):
                after[b, i] -= turn[b, i, k] * arm[b, k]
                if p >= 0:
                    after[b, i] += turn[p, i, k] * (gap[b, k] + strain[b, k])
