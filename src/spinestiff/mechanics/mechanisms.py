"""Motions of a torso at rest that neither a stiffness nor a support resists, found before a solve and named.

Connected tissue resists every small motion but the six rigid ones, so each piece of it counts as one more rigid body.
Bodies move by twists t = (v, L w) about the torso's middle. What connects two bodies, or a body with the ground,
resists their relative twist by a positive semidefinite matrix: the sum of s s^T over the axes of a joint with
stiffness > 0, the tied nodes (three directions each), the held degrees of freedom and the springs, with

    s = (n, (x x n) / L)  along n at a point x,      s = (0, n)  about n.

Further laws of an energy couple bodies as their Hessian W at rest says: bodies a and b by -W_ab, which is what a law of
the two alone resists with, and a body with the ground by its row's sum, which is zero where a shift or a turn of
everything costs nothing.

Only the range of such a matrix counts. Bodies that cannot move against each other are welded to one; the null space
of what is left holds the mechanisms. Forces at rest and loads stiffen nothing here: a pendulum is a mechanism.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.rotation import cross_matrix
from spinestiff.anatomy.stiffness import JOINT_AXES
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, Ints
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.assembly import (
    ROTATION_LENGTH,
    Configuration,
    Law,
    Stiffness,
    Tangent,
    Unknowns,
    build_pattern,
)
from spinestiff.mechanics.potential import Potential
from spinestiff.mechanics.supports import Supports
from spinestiff.mechanics.terms import Term, TermBlocks

# Share of the largest eigenvalue below which one counts as zero: of one connection, and of all that is left.
ZERO, ALL_ZERO = 1e-9, 1e-11
# Of (dt, L dw), in which twists are, to (dt, dw), in which Hessians are.
_SCALE = np.array([1.0, 1.0, 1.0, *3 * [1.0 / ROTATION_LENGTH]])
WORLD_AXES = ("lateral (x)", "vertical (y)", "AP (z)")
LONGEST_LIST = 5  # names, and mechanisms, in one message


@dataclass(frozen=True)
class Mechanism:
    """Motions that nothing resists.

    Attributes
    ----------
    bones : the bones that move; none where a piece of tissue moves alone.
    modes : number of independent motions.
    text : one sentence: what can move, how, and what lacks.
    """

    bones: tuple[str, ...]
    modes: int
    text: str


class _Links(NamedTuple):
    """Connections of bodies first (n,) and second (n,), which resist by matrices resist (n, 6, 6)."""

    first: Ints
    second: Ints
    resist: Floats


class _Tissue(NamedTuple):
    """Stiff elements (T', n), the piece (T',) of each, number of pieces; free nodes of no stiff element."""

    elements: Ints
    piece: Ints
    pieces: int
    loose: Ints


def mechanisms(
    torso: TorsoModel,
    supports: Supports,
    stiffness: Stiffness | None = None,
    terms: Sequence[Term] = (),
    laws: Sequence[Law] = (),
) -> tuple[Mechanism, ...]:
    """All mechanisms of a torso at rest on its supports: loose nodes, free pieces, then what moves inside.

    Parameters
    ----------
    stiffness : which joint axes and which elements have any; default: the torso's own.
    terms, laws : further energies of single bones and nodes, e.g. image terms, and of several; what they curve at
        rest, either way, counts as resisted.
    """
    system = _System(torso, supports, stiffness, terms, laws)
    return (*system.loose_nodes(), *system.free_pieces(), *system.inner())


def require_no_mechanism(
    torso: TorsoModel,
    supports: Supports,
    stiffness: Stiffness | None = None,
    terms: Sequence[Term] = (),
    laws: Sequence[Law] = (),
) -> None:
    """Raise EquilibriumError, in one line that names bones and joints, if there is a mechanism."""
    found = mechanisms(torso, supports, stiffness, terms, laws)
    if found:
        more = f"; and {len(found) - LONGEST_LIST} more" if len(found) > LONGEST_LIST else ""
        raise EquilibriumError(
            "no equilibrium is determined: " + "; ".join(m.text for m in found[:LONGEST_LIST]) + more
        )


class _System:
    """Bodies: bones, then pieces of tissue, then the ground."""

    def __init__(
        self,
        torso: TorsoModel,
        supports: Supports,
        stiffness: Stiffness | None,
        terms: Sequence[Term],
        laws: Sequence[Law],
    ) -> None:
        self.torso, self.supports = torso, supports
        rest, mesh = torso.rest_pose, torso.tissue
        self.bones = len(torso.bone_names)
        self.joint_stiffness = torso.joints.stiffness if stiffness is None else stiffness.joints
        self.tissue = _stiff_tissue(torso, stiffness)
        self.ground = self.bones + self.tissue.pieces
        self.middle = rest.bone_positions.mean(0) if self.bones else np.zeros(3)
        joints = torso.joints
        self.centres = PointsOnBones(joints.parent, joints.parent_position).positions(rest)
        self.axes = rest.bone_rotations[joints.parent] @ joints.parent_axes
        # Tied nodes of stiff elements, and nodes where two pieces touch: shared points of two bodies.
        count = max(self.tissue.pieces, 1)
        node, piece = np.divmod(np.unique(self.tissue.elements * count + self.tissue.piece[:, None]), count)
        piece += self.bones
        owner = mesh.bone_of_node[node]
        self.first_piece = first_piece = np.full(len(mesh.bone_of_node), self.ground)
        np.minimum.at(first_piece, node, piece)
        tied, touching = owner >= 0, (owner < 0) & (first_piece[node] != piece)
        self.tied_bone, self.tied_node = owner[tied], node[tied]
        shared = np.concatenate([np.flatnonzero(tied), np.flatnonzero(touching)])
        partner = np.concatenate([owner[tied], first_piece[node[touching]]])
        self.curvature = _curvature(torso, laws, stiffness) if laws else None
        self.terms = [term.blocks(rest) for term in terms]
        self.links = _joined(
            [
                self._joint_links(),
                self._shared_points(partner, piece[shared], mesh.rest_positions[node[shared]]),
                self._support_links(),
                *(self._term_links(blocks) for blocks in self.terms),
                *([] if self.curvature is None else [self._law_links(self.curvature)]),
            ]
        )
        names = self.ground + 1
        graph = sp.coo_array((np.ones(len(self.links.first)), self.links[:2]), shape=(names, names))
        self.part = connected_components(graph, directed=False)[1]

    def loose_nodes(self) -> list[Mechanism]:
        """Free nodes that no stiff element, term or law holds."""
        loose = self.tissue.loose
        if len(loose):
            loose = loose[~self._held_nodes()[np.searchsorted(self.torso.tissue.free_nodes, loose)]]
        if not len(loose):
            return []
        node = int(loose[0])
        place = self.torso.tissue.rest_positions[node]
        what = f"free tissue node {node}" if len(loose) == 1 else f"{len(loose)} free tissue nodes (first {node}"
        what += f" at {_place(place)}" + ("" if len(loose) == 1 else ")")
        verb = "belongs" if len(loose) == 1 else "belong"
        return [Mechanism((), 3 * len(loose), f"{what} {verb} to no element with stiffness")]

    def _held_nodes(self) -> np.ndarray:
        """(F,) bool, free nodes that terms and laws hold all ways."""
        resist = np.zeros((len(self.torso.tissue.free_nodes), 3, 3))
        for blocks in self.terms:
            np.add.at(resist, blocks.node, _range(blocks.node_hessian))
        if self.curvature is not None:
            blocks_of_three = self.curvature.tobsr((3, 3))
            row = np.repeat(np.arange(len(blocks_of_three.indptr) - 1), np.diff(blocks_of_three.indptr))
            own = (row == blocks_of_three.indices) & (row >= 2 * self.bones)
            resist[row[own] - 2 * self.bones] += _range(blocks_of_three.data[own])
        held: np.ndarray = np.linalg.eigvalsh(resist)[:, 0] > ZERO
        return held

    def free_pieces(self) -> list[Mechanism]:
        """Parts that are connected with the ground by nothing."""
        found = []
        for part in np.unique(self.part[self.part != self.part[self.ground]]):
            members = np.flatnonzero(self.part == part)
            bones = self._names(members)
            if not bones:
                text = f"tissue around {_place(self._centre(members))} is tied to no bone"
            elif len(bones) == self.bones:
                text = "the whole torso is held by no support (six free motions)"
            elif len(bones) == 1:
                text = f"{bones[0]} is connected to nothing: no joint, tissue or support holds it"
            else:
                text = f"{_listed(bones)} are connected with each other and with nothing else (six free motions)"
            joints = self.torso.joints
            touching = np.isin(joints.parent, members) | np.isin(joints.child, members)
            dead = self._say_dead(self._dead_joints(np.flatnonzero(touching)))
            found.append(Mechanism(bones, 6, text + (f" ({dead[0]})" if dead else "")))
        return found

    def inner(self) -> list[Mechanism]:
        """Mechanisms that are left where every part that the ground does not hold is held at one of its bodies."""
        first, second, resist = self.links
        _, pinned = np.unique(self.part, return_index=True)
        pinned = pinned[self.part[pinned] != self.part[self.ground]]
        first = np.concatenate([first, pinned])
        second = np.concatenate([second, np.full(len(pinned), self.ground)])
        resist = np.concatenate([resist, np.broadcast_to(np.eye(6), (len(pinned), 6, 6))])
        label, merged = _welded(_Links(first, second, resist), self.ground + 1)
        twists = _null_twists(merged, label)  # (bodies, 6, modes)
        modes = twists.shape[2]
        if not modes:
            return []
        # Mechanisms of different parts mix in a null space's basis; the projector onto it shows which bodies belong.
        moving = np.flatnonzero(np.linalg.norm(twists, axis=(1, 2)) > 1e-6)
        rows = twists[moving].reshape(-1, modes)
        coupled = np.abs(rows @ rows.T).reshape(len(moving), 6, len(moving), 6).max(axis=(1, 3)) > 1e-6
        _, group = connected_components(sp.coo_array(coupled), directed=False)
        found = []
        for g in range(group.max() + 1):
            members = moving[group == g]
            _, size, basis = np.linalg.svd(twists[members].reshape(-1, modes), full_matrices=False)
            basis = basis[size > 1e-6]
            found.append(self._described(members, twists[members] @ basis.T))
        return found

    def _described(self, members: Ints, twists: Floats) -> Mechanism:
        """One mechanism from its moving bodies and their twists (n, 6, modes)."""
        modes = twists.shape[2]
        bones = self._names(members)
        all_twists = np.zeros((self.ground + 1, 6, modes))
        all_twists[members] = twists
        joints, causes = self._slack_joints(all_twists)
        rigid = bool(np.abs(twists - twists[:1]).max() < 1e-6 * np.abs(twists).max())
        if rigid:
            who = "the whole torso" if len(bones) == self.bones and self.bones > 1 else _listed(bones)
            who = who or f"tissue around {_place(self._centre(members))}"
            text = f"{who} can {self._motion(twists[0], joints, members)}"
        else:
            who = _listed(bones) if bones else f"tissue around {_place(self._centre(members))}"
            ways = "one way" if modes == 1 else f"{modes} ways"
            text = f"{who} can move {'against each other ' if len(bones) > 1 else ''}in {ways}"
        causes += self._tissue_of(members) if len(bones) < self.bones else []
        causes = causes or ["no support resists that"]
        return Mechanism(bones, modes, f"{text}: {_and(causes)}")

    def _motion(self, twist: Floats, joints: Ints, members: Ints) -> str:
        """The motion of one rigid piece, twist (6, modes), in words."""
        modes = twist.shape[1]
        shift, turn = twist[:3], twist[3:] / ROTATION_LENGTH
        if np.abs(turn).max() * ROTATION_LENGTH < 1e-6 * np.abs(shift).max():
            return f"shift along {_direction(shift[:, 0])}" if modes == 1 else f"shift along {modes} directions"
        # Points that stay: v + w x p = 0 for every mode; the one nearest to the piece's middle.
        centre = self._centre(members) - self.middle
        rows = np.concatenate([cross_matrix(w) for w in turn.T])
        still = centre + np.linalg.lstsq(rows, -shift.T.ravel() - rows @ centre, rcond=1e-6)[0]
        left = np.abs(shift.T.ravel() + rows @ still).max()
        if left > 1e-6 * np.abs(shift).max() + 1e-9:
            return "move along a screw" if modes == 1 else f"move in {modes} ways"
        place = self._place_on(still + self.middle, turn, joints)
        if modes == 1:
            return f"turn about {_direction(turn[:, 0])} through {place}"
        return f"turn about {'all axes' if modes == 3 else 'two axes'} through {place}"

    def _place_on(self, point: Floats, turn: Floats, joints: Ints) -> str:
        """The joint or held bone whose centre stays in a turn, else the point's coordinates."""
        held = np.flatnonzero(self.supports.held.any(1))
        places = np.concatenate([self.centres[joints], self.torso.rest_pose.bone_positions[held]])
        names = [f"joint {self.torso.joints.names[j]}" for j in joints]
        names += [f"{self.torso.bone_names[b]}'s origin" for b in held]
        if len(places):
            off = np.linalg.norm(np.cross((places - point)[:, None], turn.T[None]), axis=2).max(1)
            nearest = int(np.argmin(off))
            if off[nearest] < 1e-3 * np.linalg.norm(turn):
                return names[nearest]
        return _place(point)

    def _slack_joints(self, twists: Floats) -> tuple[Ints, list[str]]:
        """Joints that a motion, twists (bodies, 6, modes), works without effort: which, and as sentences."""
        joints = self.torso.joints
        relative = twists[joints.child] - twists[joints.parent]
        wrenches = self._joint_wrenches()
        effortless = (np.abs(np.einsum("jai,jim->jam", wrenches, relative)).max(2, initial=0.0)) > 1e-6
        which = np.flatnonzero(effortless.any(1))
        dead = self._dead_joints(which)
        said = []
        for j in np.setdiff1d(which, dead):
            axes = [JOINT_AXES[a] for a in np.flatnonzero(effortless[j])]
            said.append(f"joint {joints.names[j]} has no stiffness in {', '.join(axes)}")
        if len(said) > LONGEST_LIST:
            said = [*said[: LONGEST_LIST - 1], f"{len(said) - LONGEST_LIST + 1} more joints likewise"]
        return which, [*said, *self._say_dead(dead)]

    def _dead_joints(self, among: Ints) -> Ints:
        """Those joints that have no stiffness at all."""
        return among[~(self.joint_stiffness[among] > 0.0).any(1)]

    def _say_dead(self, dead: Ints) -> list[str]:
        names = [self.torso.joints.names[j] for j in dead]
        return [f"joint{'s' * (len(names) > 1)} {_listed(names)} without any stiffness"] if names else []

    def _tissue_of(self, members: Ints) -> list[str]:
        """What tissue does for moving bones, as a sentence."""
        bones = members[members < self.bones]
        if not len(self.torso.tissue.elements) or not len(bones):
            return []
        nodes = len(np.unique(self.tied_node[np.isin(self.tied_bone, bones)]))
        if not nodes:
            return ["no tissue node holds it"]
        return [f"{nodes} tissue node{'s do' if nodes > 1 else ' does'} not resist that"]

    def _names(self, members: Ints) -> tuple[str, ...]:
        return tuple(self.torso.bone_names[b] for b in members if b < self.bones)

    def _centre(self, members: Ints) -> Floats:
        """(3,) mm, middle of bodies at rest."""
        bones = members[members < self.bones]
        if len(bones):
            return self.torso.rest_pose.bone_positions[bones].mean(0)
        nodes = self.tissue.elements[np.isin(self.tissue.piece + self.bones, members)]
        return self.torso.tissue.rest_positions[nodes.ravel()].mean(0)

    def _joint_wrenches(self) -> Floats:
        """(J, 6, 6): one row an axis of a joint, stiff or not."""
        directions = np.swapaxes(self.axes, 1, 2)  # (J, axis, 3)
        arms = np.broadcast_to((self.centres - self.middle)[:, None], directions.shape)
        return np.concatenate([_along(arms, directions), _about(directions)], axis=1)

    def _joint_links(self) -> _Links:
        rows = self._joint_wrenches() * (self.joint_stiffness > 0.0)[:, :, None]
        return _Links(self.torso.joints.parent, self.torso.joints.child, np.swapaxes(rows, 1, 2) @ rows)

    def _shared_points(self, first: Ints, second: Ints, positions: Floats) -> _Links:
        """Bodies that share points move these alike. One link a pair of bodies, its range found about their middle."""
        bodies = self.ground + 1
        key, index, count = np.unique(first * bodies + second, return_inverse=True, return_counts=True)
        middle = np.stack([np.bincount(index, positions[:, i], minlength=len(key)) for i in range(3)], 1)
        middle = middle / count[:, None]
        rows = _along((positions - middle[index])[:, None], np.broadcast_to(np.eye(3), (len(positions), 3, 3)))
        local = np.zeros((len(key), 6, 6))
        np.add.at(local, index, np.swapaxes(rows, 1, 2) @ rows)
        carried = np.tile(np.eye(6), (len(key), 1, 1))
        carried[:, :3, 3:] = -cross_matrix(middle - self.middle) / ROTATION_LENGTH
        return _Links(key // bodies, key % bodies, np.swapaxes(carried, 1, 2) @ _range(local) @ carried)

    def _support_links(self) -> _Links:
        bone, column = np.nonzero(self.supports.held)
        arms = self.torso.rest_pose.bone_positions[bone] - self.middle
        directions = np.eye(3)[column % 3]
        held = np.where((column < 3)[:, None], _along(arms, directions), _about(directions))
        springs = self.supports.springs
        stiff = np.flatnonzero(springs.stiffness > 0.0)
        places = springs.points.positions(self.torso.rest_pose)[stiff] - self.middle
        rows = np.concatenate([held, _along(places, springs.directions[stiff])])
        bones = np.concatenate([bone, springs.points.bone[stiff]])
        return _Links(bones, np.full(len(bones), self.ground), rows[:, :, None] * rows[:, None, :])

    def _term_links(self, blocks: TermBlocks) -> _Links:
        carried = self._bone_motion(blocks.bone)
        resist = np.swapaxes(carried, 1, 2) @ _range(_SCALE[:, None] * blocks.hessian * _SCALE) @ carried
        nodes = self.torso.tissue.free_nodes[blocks.node]
        carried = self._node_motion(nodes)
        resist = np.concatenate([resist, np.swapaxes(carried, 1, 2) @ _range(blocks.node_hessian) @ carried])
        body = np.concatenate([blocks.bone, self.first_piece[nodes]])
        return _Links(body, np.full(len(body), self.ground), resist)

    def _law_links(self, curvature: sp.csr_array) -> _Links:
        """What laws of a ``curvature`` (dofs, dofs) at rest resist, between bodies and against the ground."""
        bones, nodes, bodies = np.arange(self.bones), self.torso.tissue.free_nodes, self.ground + 1
        on_bones = sp.bsr_array(
            (_SCALE[:, None] * self._bone_motion(bones), bones, np.arange(len(bones) + 1)),
            shape=(6 * len(bones), 6 * bodies),
        )
        on_nodes = sp.bsr_array(
            (self._node_motion(nodes), self.first_piece[nodes], np.arange(len(nodes) + 1)),
            shape=(3 * len(nodes), 6 * bodies),
        )
        motion = sp.vstack([on_bones, on_nodes]).tocsr()
        blocks = (motion.T @ curvature @ motion).tocsr().tobsr((6, 6))
        first, second = np.repeat(np.arange(bodies), np.diff(blocks.indptr)), blocks.indices
        own = np.zeros((bodies, 6, 6))
        np.add.at(own, first, blocks.data)
        own[np.abs(own).max(axis=(1, 2)) <= ZERO * np.abs(blocks.data).max(initial=0.0)] = 0.0
        pair = first < second
        resist = np.concatenate([-blocks.data[pair], own])
        ends = (
            np.concatenate([first[pair], np.arange(bodies)]),
            np.concatenate([second[pair], np.full(bodies, self.ground)]),
        )
        return _Links(*ends, _range(0.5 * (resist + np.swapaxes(resist, 1, 2))))

    def _bone_motion(self, bones: Ints) -> Floats:
        """(n, 6, 6) of bones' (dt, L dw) by the twist of each."""
        motion = np.tile(np.eye(6), (len(bones), 1, 1))
        arms = self.torso.rest_pose.bone_positions[bones] - self.middle
        motion[:, :3, 3:] = -cross_matrix(arms) / ROTATION_LENGTH
        return motion

    def _node_motion(self, nodes: Ints) -> Floats:
        """(n, 3, 6) of mesh nodes by the twist of each one's body."""
        motion = np.tile(np.eye(3, 6), (len(nodes), 1, 1))
        motion[:, :, 3:] = -cross_matrix(self.torso.tissue.rest_positions[nodes] - self.middle) / ROTATION_LENGTH
        return motion


def _curvature(torso: TorsoModel, laws: Sequence[Law], stiffness: Stiffness | None) -> sp.csr_array:
    """(dofs, dofs) Hessian of laws at rest."""
    stiffness = Potential(torso).stiffness(None) if stiffness is None else stiffness
    unknowns = Unknowns(torso)
    pairs = [law.pairs(unknowns) for law in laws]
    pattern = build_pattern(np.concatenate(pairs), unknowns.sizes)
    at, tangent = Configuration(unknowns, torso.rest_pose), Tangent(unknowns, pattern)
    for law, own in zip(laws, pairs):
        law.add_hessian(at, stiffness, tangent, pattern.offset(*own.T), False)
    shape = (unknowns.dofs, unknowns.dofs)
    lower = sp.csc_array((tangent.finished(False), pattern.indices, pattern.indptr), shape=shape)
    return sp.csr_array(lower + sp.tril(lower, -1).T)


def _stiff_tissue(torso: TorsoModel, stiffness: Stiffness | None) -> _Tissue:
    """Elements that deform and have a shear stiffness, in pieces that hang together by faces."""
    mesh = torso.tissue
    deformable = mesh.deformable
    mu = mesh.lame_mu[deformable] if stiffness is None else stiffness.mu
    elements = mesh.elements[deformable[mu > 0.0]]
    t, n = len(elements), len(mesh.bone_of_node)
    corners = np.sort(elements[:, :4], axis=1)
    faces = corners[:, [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]].reshape(-1, 3)
    key = (faces[:, 0] * n + faces[:, 1]) * n + faces[:, 2]
    order = np.argsort(key)
    same = np.flatnonzero(key[order[1:]] == key[order[:-1]])
    sides = order[same] // 4, order[same + 1] // 4
    pieces, piece = connected_components(sp.coo_array((np.ones(len(same)), sides), shape=(t, t)), directed=False)
    loose = np.setdiff1d(mesh.free_nodes, elements)
    return _Tissue(elements, piece.astype(np.int64), int(pieces), loose)


def _along(arms: Floats, directions: Floats) -> Floats:
    """(..., 6) wrenches of unit forces along directions (..., 3) at arms (..., 3)."""
    return np.concatenate([directions, np.cross(arms, directions) / ROTATION_LENGTH], axis=-1)


def _about(directions: Floats) -> Floats:
    return np.concatenate([np.zeros_like(directions), directions], axis=-1)


def _range(matrices: Floats) -> Floats:
    """Projectors onto the ranges of symmetric (n, k, k)."""
    values, vectors = np.linalg.eigh(matrices)
    values = np.abs(values)
    kept = values > ZERO * values.max(axis=-1, initial=0.0, keepdims=True)
    return (vectors * kept[..., None, :]) @ np.swapaxes(vectors, -1, -2)


def _joined(links: list[_Links]) -> _Links:
    """All connections as one, without those that resist nothing."""
    first, second, resist = (np.concatenate(parts) for parts in zip(*links))
    some = np.abs(resist).max(axis=(1, 2), initial=0.0) > 0.0
    return _Links(first[some].astype(np.int64), second[some].astype(np.int64), resist[some])


def _summed(links: _Links, label: Ints) -> _Links:
    """Connections between bodies of different label, parallel ones added."""
    a, b = label[links.first], label[links.second]
    low, high = np.minimum(a, b), np.maximum(a, b)
    apart = low != high
    key, index = np.unique(np.stack([low[apart], high[apart]], 1), axis=0, return_inverse=True)
    resist = np.zeros((len(key), 6, 6))
    np.add.at(resist, index.ravel(), links.resist[apart])
    return _Links(key[:, 0], key[:, 1], resist)


def _welded(links: _Links, bodies: int) -> tuple[Ints, _Links]:
    """Bodies that cannot move against each other get one label; returns labels and what is left between them."""
    label = np.arange(bodies)
    while True:
        left = _summed(links, label)
        values = np.linalg.eigvalsh(left.resist) if len(left.first) else np.empty((0, 6))
        full = np.flatnonzero(values[:, 0] > ZERO * values[:, -1])
        if not len(full):
            return label, left
        shape = (label.max() + 1,) * 2
        graph = sp.coo_array((np.ones(len(full)), (left.first[full], left.second[full])), shape=shape)
        label = connected_components(graph, directed=False)[1][label]


def _null_twists(links: _Links, label: Ints) -> Floats:
    """(bodies, 6, modes) twists that no connection resists; the last body, the ground, stays."""
    count, ground = int(label.max()) + 1, int(label[-1])
    at_ground = (links.first == ground) | (links.second == ground)
    held = np.zeros((count, 6, 6))
    held[np.where(links.first == ground, links.second, links.first)[at_ground]] = links.resist[at_ground]
    values, vectors = np.linalg.eigh(held)
    free = values <= ZERO * values.max(axis=1, keepdims=True)
    free[ground] = False
    basis = [vectors[c][:, free[c]] for c in range(count)]
    start = np.concatenate([[0], np.cumsum(free.sum(1))])
    gram = np.zeros((start[-1], start[-1]))
    for a, b, resist in zip(links.first[~at_ground], links.second[~at_ground], links.resist[~at_ground]):
        for i, j, sign in ((a, a, 1.0), (b, b, 1.0), (a, b, -1.0), (b, a, -1.0)):
            gram[start[i] : start[i + 1], start[j] : start[j + 1]] += sign * basis[i].T @ resist @ basis[j]
    values, vectors = np.linalg.eigh(gram) if len(gram) else (np.empty(0), np.empty((0, 0)))
    null = vectors[:, values <= ALL_ZERO * max(values.max(initial=0.0), 1.0)]
    twists = np.zeros((count, 6, null.shape[1]))
    for c in range(count):
        twists[c] = basis[c] @ null[start[c] : start[c + 1]]
    return twists[label]


def _place(point: Floats) -> str:
    return "({:.0f}, {:.0f}, {:.0f}) mm".format(*(point.round() + 0.0))


def _direction(vector: Floats) -> str:
    unit = vector / np.linalg.norm(vector)
    main = int(np.argmax(np.abs(unit)))
    if abs(unit[main]) > 0.9999:
        return f"the {WORLD_AXES[main]} axis"
    unit = unit * np.sign(unit[main])
    return "the axis ({:.2f}, {:.2f}, {:.2f})".format(*(unit.round(2) + 0.0))


def _listed(names: Sequence[str]) -> str:
    if len(names) <= LONGEST_LIST:
        return ", ".join(names)
    return f"{', '.join(names[: LONGEST_LIST - 1])}, ... ({len(names)} in all)"


def _and(parts: list[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])}, and {parts[-1]}"
