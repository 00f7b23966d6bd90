"""Problems that other programs are asked too: blocks of tissue and chains of joints, with our answers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.rotation import cross_matrix, exp_so3
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import LoadCase, no_load
from spinestiff.verification.blocks import holds, jittered_box, point_bone_block, young_poisson
from spinestiff.verification.models import make_torso

MU, LAMBDA = 0.02, 0.15
SIZE = (30.0, 25.0, 50.0)


@dataclass(frozen=True)
class Block:
    """A block of tissue: nodes (N, 3), elements (T, n), fixed nodes and where all nodes end, by our engine."""

    nodes: np.ndarray
    elements: np.ndarray
    fixed: np.ndarray
    found: np.ndarray


@dataclass(frozen=True)
class Chain:
    """Bones along y, ``length`` apart, the first held, and a joint halfway between each two.

    stiffness : (n, 6) of the joints. arm, force : a dead force at a point of the last bone. Results, by our engine:
    positions (n + 1, 3) and rotations (n + 1, 3, 3) of the bones.
    """

    length: float
    stiffness: np.ndarray
    arm: np.ndarray
    force: np.ndarray
    positions: np.ndarray
    rotations: np.ndarray


def solved_chain(stiffness, force, arm=(0.0, 12.0, 5.0), length=30.0) -> Chain:
    """Our answer for a chain with joints (n, 6) under ``force`` at ``arm`` of its last bone."""
    stiffness, force, arm = (np.array(v, dtype=float) for v in (stiffness, force, arm))
    n = len(stiffness)
    places = np.zeros((n + 1, 3))
    places[:, 1] = length * np.arange(n + 1)
    torso = make_torso(places, [(i, i + 1) for i in range(n)], stiffness)
    held = np.zeros((n + 1, 6), dtype=bool)
    held[0] = True
    load = LoadCase(PointsOnBones(np.array([n]), arm[None]), force[None])
    state = EquilibriumProblem(torso, holds(held)).solve(load, tolerance=1e-9).require().state
    return Chain(length, stiffness, arm, force, state.bone_positions, state.bone_rotations)


# Stiffnesses of a joint that moves in the plane of x and y; the others are never asked.
PLANE = (80.0, 300.0, 1e3, 1e6, 1e6, 9e3)


@pytest.fixture(scope="session", params=[(1e-3, "small"), (1.0, "large")], ids=lambda p: p[1])
def hinge(request) -> Chain:
    """One joint that gives to a turn about z: its angle is small, or above half a radian."""
    stiff = [1e5, 1e5, 1e5, 1e7, 1e7, 9e3]
    return solved_chain([stiff], request.param[0] * np.array([400.0, 50.0, 0.0]), arm=(0.0, 5.0, 0.0))


@pytest.fixture(scope="session")
def slider() -> Chain:
    """One joint that gives along y alone."""
    return solved_chain([[1e5, 40.0, 1e5, 1e7, 1e7, 1e7]], [0.0, 150.0, 0.0], arm=(0.0, 5.0, 0.0))


@pytest.fixture(scope="session", params=[(0.02, "small"), (1.0, "large")], ids=lambda p: p[1])
def planar_chain(request) -> Chain:
    """Five joints in a plane, bent far by an end force, with shifts and turns of each joint together."""
    joints = [np.array(PLANE) * (1.0 + 0.1 * i) for i in range(5)]
    return solved_chain(joints, request.param[0] * np.array([60.0, -25.0, 0.0]), arm=(0.0, 12.0, 0.0))


@pytest.fixture(scope="session")
def spatial_chain() -> Chain:
    """Five joints whose three turns are as stiff as each other, under a skew force, in space."""
    joints = [np.array([80.0, 300.0, 120.0, 9e3, 9e3, 9e3]) * (1.0 + 0.1 * i) for i in range(5)]
    return solved_chain(joints, [40.0, -15.0, 30.0])


@pytest.fixture(scope="session")
def wound_chain() -> tuple[Chain, float]:
    """Four joints under an end moment (N mm) about z, which a last joint at rest elsewhere exerts; no force."""
    stiffness = np.array([np.array(PLANE) * (1.0 + 0.2 * i) for i in range(4)])
    moment, motor = 4000.0, 5e3
    turn = moment * float(np.sum(1.0 / stiffness[:, 5]))
    places = np.zeros((6, 3))
    places[:, 1] = [0.0, 30.0, 60.0, 90.0, 120.0, 160.0]
    links = [(i, i + 1) for i in range(4)] + [(5, 4)]
    torso = make_torso(places, links, np.vstack([stiffness, [0.0] * 5 + [motor]]))
    axes = torso.joints.child_axes.copy()
    axes[-1] = exp_so3(np.array([0.0, 0.0, -(turn + moment / motor)]))
    torso = replace(torso, joints=replace(torso.joints, child_axes=axes))
    held = np.zeros((6, 6), dtype=bool)
    held[[0, 5]] = True
    state = EquilibriumProblem(torso, holds(held)).solve(no_load(), tolerance=1e-11).require().state
    none = np.zeros(3)
    return Chain(30.0, stiffness, none, none, state.bone_positions[:5], state.bone_rotations[:5]), moment


@dataclass(frozen=True)
class BoneBlock:
    """The same with a bone: tied nodes at (P, 3) from its origin, a force at an arm, and where it ends."""

    block: Block
    origin: np.ndarray
    tied: np.ndarray
    arm: np.ndarray
    force: np.ndarray
    place: np.ndarray
    turn: np.ndarray


def _mesh(nodes: int) -> tuple[np.ndarray, np.ndarray]:
    return jittered_box((2, 2, 3), SIZE, nodes)


@pytest.fixture(scope="session", params=[4, 10], ids=["tet4", "tet10"])
def block(request) -> Block:
    """Bottom held, top shifted, turned and pressed: strains of some ten per cent."""
    nodes, elements = _mesh(request.param)
    top = nodes[:, 2] > SIZE[2] - 1e-9
    fixed = np.flatnonzero((nodes[:, 2] < 1e-9) | top)
    held = np.zeros((len(nodes), 3), dtype=bool)
    held[fixed] = True
    model = point_bone_block((nodes, elements), held, MU, LAMBDA)
    moved = nodes.copy()
    middle = np.array([0.5 * SIZE[0], 0.5 * SIZE[1], SIZE[2]])
    moved[top] = middle + (nodes[top] - middle) @ exp_so3(np.array([0.2, -0.15, 0.4])).T + np.array([4.0, 2.0, -7.0])
    problem = EquilibriumProblem(model.torso, model.supports)
    # Towards the end in steps, each from the last: a top that jumps would turn elements inside out.
    state = None
    for share in (0.25, 0.5, 0.75, 1.0):
        aim = nodes + share * (moved - nodes)
        inner = aim if state is None else model.torso.node_positions(state)
        height = (nodes[:, 2:] / SIZE[2]) * (moved - nodes)[top].mean(0)
        inner = nodes + share * height if state is None else inner + 0.25 * height
        state = problem.solve(no_load(), start=model.start(aim[model.nodes], inner), tolerance=1e-12).require().state
    return Block(nodes, elements, fixed, model.torso.node_positions(state))


@pytest.fixture(scope="session")
def bone_block() -> BoneBlock:
    """A block held at its bottom with a bone in its upper part, which a force at an arm pulls and turns."""
    nodes, elements = _mesh(10)
    origin, arm, force = np.array([14.0, 13.0, 36.0]), np.array([6.0, -3.0, 8.0]), np.array([2.5, 1.0, -1.5])
    bottom = nodes[:, 2] < 1e-9
    tied = np.flatnonzero(np.linalg.norm(nodes - origin, axis=1) < 10.0)
    owner = np.full(len(nodes), -1)
    owner[bottom], owner[tied] = 1, 0
    places = np.vstack([origin, [15.0, 12.0, 0.0]])
    torso = make_torso(places, [], np.zeros(6), (nodes, elements), owner, *young_poisson(MU, LAMBDA))
    held = np.zeros((2, 6), dtype=bool)
    held[1] = True
    load = LoadCase(PointsOnBones(np.array([0]), arm[None]), force[None])
    state = EquilibriumProblem(torso, holds(held)).solve(load, tolerance=1e-12).require().state
    block = Block(nodes, elements, np.flatnonzero(bottom), torso.node_positions(state))
    return BoneBlock(block, origin, tied, arm, force, state.bone_positions[0], state.bone_rotations[0])


class Reduced:
    """Newton's method for a foreign program's force and tangent with some nodes on a rigid bone, none of ours in it.

    ``assemble(x)`` gives the force (N, 3) = dE/dx and the tangent (3 N, 3 N) at node places x.
    """

    def __init__(self, problem: BoneBlock, assemble) -> None:
        self.problem, self.assemble = problem, assemble
        n = len(problem.block.nodes)
        inner = np.ones(n, dtype=bool)
        inner[problem.block.fixed] = inner[problem.tied] = False
        self.free = np.flatnonzero(inner)

    def solve(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Node places, the bone's place and turn."""
        p = self.problem
        x, place, turn = p.block.nodes.copy(), p.origin.copy(), np.eye(3)
        rest = p.block.nodes[p.tied] - p.origin
        for _ in range(40):
            x[p.tied] = place + rest @ turn.T
            force, tangent = self.assemble(x)
            arms, arm = rest @ turn.T, turn @ p.arm
            onto = np.zeros((x.size, 6 + 3 * len(self.free)))
            for node, a in zip(p.tied, arms):
                onto[3 * node : 3 * node + 3, :6] = np.hstack([np.eye(3), -cross_matrix(a)])
            for i, node in enumerate(self.free):
                onto[3 * node : 3 * node + 3, 6 + 3 * i : 9 + 3 * i] = np.eye(3)
            residual = onto.T @ force.ravel()
            residual[:3] -= p.force
            residual[3:6] -= np.cross(arm, p.force)
            if np.abs(residual).max() < 1e-12:
                return x, place, turn
            matrix = onto.T @ (tangent @ onto)
            # What a force does to a bone that turns under it.
            for a, f in [*zip(arms, force[p.tied]), (arm, -p.force)]:
                matrix[3:6, 3:6] += 0.5 * (np.outer(f, a) + np.outer(a, f)) - (f @ a) * np.eye(3)
            step = -np.linalg.solve(matrix, residual)
            step *= min(1.0, 0.2 / np.linalg.norm(step[3:6]))
            place, turn = place + step[:3], exp_so3(step[3:6]) @ turn
            x[self.free] += step[6:].reshape(-1, 3)
        raise AssertionError("the other program's forces found no balance")


@pytest.fixture(scope="session")
def reduced() -> type[Reduced]:
    return Reduced
