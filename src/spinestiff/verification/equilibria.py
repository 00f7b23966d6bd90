"""Checks of equilibria: the coordinates of a step, balance, symmetries of physics, limits, reciprocity."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.rotation import exp_so3, log_so3
from spinestiff.anatomy.state import TorsoState, retract
from spinestiff.anatomy.stiffness import StiffnessRatios, stiffness_ratios
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.mechanics.equilibrium import Equilibrium, EquilibriumProblem
from spinestiff.mechanics.loads import LoadCase, no_load, tissue_load
from spinestiff.mechanics.supports import Supports
from spinestiff.mechanics.terms import PointSprings
from spinestiff.verification.blocks import young_poisson
from spinestiff.verification.energies import two_bones
from spinestiff.verification.models import make_torso, shaken, toy_torso
from spinestiff.verification.outcome import Check, compared, counted, judged, vanishing
from spinestiff.verification.transforms import (
    MIRROR,
    in_units,
    mirrored_load,
    mirrored_state,
    mirrored_torso,
    moved_state,
    moved_torso,
    renumbered_torso,
)

# Soft enough for a finite deformation under some tens of newtons.
SOFT = {"tissue": 0.2, "lateral_bending": 0.3, "axial_rotation": 0.5}


def toy_supports(torso: TorsoModel, spring: bool = True) -> Supports:
    """The last bone held, and the first on a spring along an oblique direction."""
    held = np.zeros((len(torso.bone_names), 6), dtype=bool)
    held[-1] = True
    points = PointsOnBones(np.zeros(int(spring), np.int64), np.full((int(spring), 3), [2.0, -3.0, 1.0]))
    directions = np.tile(np.array([0.8, 0.0, 0.6]), (len(points), 1))
    springs = PointSprings(points, points.positions(torso.rest_pose), directions, np.full(len(points), 100.0))
    return Supports(held, springs, ("side",) * len(points))


def tissue_pressure(torso: TorsoModel, size: float) -> LoadCase:
    """Oblique forces of ``size`` N on every fourth node of the tissue, tied ones and free ones."""
    nodes = np.arange(0, len(torso.tissue.rest_positions), 4)
    directions = np.random.default_rng(5).normal(size=(len(nodes), 3))
    return tissue_load(torso, nodes, size * directions / np.linalg.norm(directions, axis=1, keepdims=True))


def toy_load(size: float = 30.0) -> LoadCase:
    """Two oblique forces on arms of the first and the second bone."""
    points = PointsOnBones(np.array([1, 0]), np.array([[5.0, 0.0, 2.0], [-3.0, 4.0, 0.0]]))
    return LoadCase(points, size * np.array([[0.8, 0.1, 0.2], [0.3, -0.2, 0.4]]))


def soft_ratios(torso: TorsoModel) -> StiffnessRatios:
    """``SOFT`` for a torso's joints."""
    return stiffness_ratios(SOFT, torso.joints.kinds)


def _solve(torso: TorsoModel, supports: Supports, load: LoadCase, ratios: StiffnessRatios | None) -> Equilibrium:
    # Tighter than the default 1e-10 of the load: answers are compared to 1e-9 and 1e-10.
    return EquilibriumProblem(torso, supports).solve(load, ratios, tolerance=1e-12 * load.size).require()


def places_of(state: TorsoState) -> Floats:
    """(bones + free nodes, 3) mm."""
    return np.vstack([state.bone_positions, state.tissue_positions])


def frames() -> Iterator[Check]:
    """Relative coordinates: their map T is a step's first order; its transpose and its inverse belong to it."""
    for nodes in (4, 10):
        torso = toy_torso(3, nodes)
        # The spring is stiffer than any joint, so that the bone it holds is a root of the tree as the held one is.
        supports = toy_supports(torso)
        stiff = replace(supports.springs, stiffness=np.full(len(supports.springs.points), 1e4))
        problem = EquilibriumProblem(torso, replace(supports, springs=stiff))
        state, random = shaken(torso, 4), np.random.default_rng(19)
        frame, dofs = problem.kinematics.at(state), problem.potential.dofs
        y, force = random.normal(size=(2, dofs))
        y[: 6 * problem.potential.bones].reshape(-1, 6)[:, 3:] *= 0.03
        y[problem.held] = force[problem.held] = 0.0
        world, step = frame.to_world(y), 1e-2
        ends = [motion(state, frame.move(k * step * y)) for k in (-2, -1, 1, 2)]
        slope = (ends[0] - 8.0 * ends[1] + 8.0 * ends[2] - ends[3]) / (12.0 * step)
        yield compared(f"C1 step: relative coordinates to first order, {nodes} nodes", world, slope, 1e-7)
        work = float(force @ world)
        yield compared(f"C1 step: forces per relative coordinate, {nodes} nodes", frame.pull(force) @ y, work, 1e-12)
        yield compared(f"C1 step: back from world coordinates, {nodes} nodes", frame.from_world(world), y, 1e-9)
        back = frame.push(frame.pull(force))
        yield compared(f"C1 step: forces back to world coordinates, {nodes} nodes", back, force, 1e-9)


def motion(before: TorsoState, after: TorsoState) -> Floats:
    """(dofs,) from one state to another: shifts, rotation vectors in world axes, shifts of nodes."""
    turns = log_so3(after.bone_rotations @ np.swapaxes(before.bone_rotations, 1, 2))
    bones = np.hstack([after.bone_positions - before.bone_positions, turns])
    return np.concatenate([bones.ravel(), (after.tissue_positions - before.tissue_positions).ravel()])


def astray(torso: TorsoModel, seed: int) -> TorsoState:
    """Bones but the last within 5 mm and 5 degrees of rest, nodes between them carried along, up to 1 mm astray."""
    random = np.random.default_rng(seed)
    rest, turn = torso.rest_pose, np.deg2rad(5.0)
    b = len(rest.bone_positions)
    shifts, turns = random.uniform(-5.0, 5.0, (b, 3)), random.uniform(-turn, turn, (b, 3))
    shifts[-1], turns[-1] = 0.0, 0.0
    away = rest.tissue_positions[:, None] - rest.bone_positions
    carried = shifts + np.einsum("bij,nbj->nbi", exp_so3(turns) - np.eye(3), away)
    share = 1.0 / np.sum(away**2, axis=2)
    nodes = np.einsum("nb,nbi->ni", share / share.sum(1, keepdims=True), carried)
    nodes = nodes + random.uniform(-1.0, 1.0, nodes.shape)
    return TorsoState(rest.bone_positions + shifts, exp_so3(turns) @ rest.bone_rotations, rest.tissue_positions + nodes)


def out_of_balance(found: Equilibrium, load: LoadCase) -> tuple[Floats, Floats]:
    """Sum of loads and reactions, (3,) N, and of their moments about the world's origin, (3,) N mm."""
    force = load.total + sum(r.force for r in found.reactions)
    moment = load.moment(found.state) + sum(np.cross(r.point, r.force) + r.moment for r in found.reactions)
    return force, moment


def balance() -> Iterator[Check]:
    """Loads and reactions cancel in force and in moment; errors over the load, and the load at 100 mm."""
    for nodes in (4, 10):
        for name, values in (("default", None), ("soft", SOFT)):
            torso = toy_torso(2, nodes)
            ratios = stiffness_ratios(values, torso.joints.kinds) if values else None
            load = toy_load(30.0)
            found = _solve(torso, toy_supports(torso), load, ratios)
            force, moment = out_of_balance(found, load)
            scale = load.size * float(min(np.abs(r.force).max() for r in found.reactions) > 0.1)
            yield vanishing(f"C3 balance: loads and reactions, force, {name}, {nodes} nodes", force, scale, 1e-10)
            arm = f"C3 balance: loads and reactions, moment, {name}, {nodes} nodes"
            yield vanishing(arm, moment, 100.0 * scale, 1e-10)
    torso = toy_torso(2, 10)
    pressed = tissue_pressure(torso, 0.4)
    found = _solve(torso, toy_supports(torso), pressed, None)
    force, moment = out_of_balance(found, pressed)
    yield vanishing("C3 balance: forces on tissue nodes and reactions, force", force, pressed.size, 1e-10)
    yield vanishing("C3 balance: forces on tissue nodes and reactions, moment", moment, 100.0 * pressed.size, 1e-10)
    yield from _anchors()


def _anchors() -> Iterator[Check]:
    """Held elsewhere, by a bone that needs no holding: the same answer.

    One solve gives a state and what its support exerts. The same forces as loads, and another bone held where it is:
    that one has nothing to do, and the state stays, though solved for from elsewhere.
    """
    torso = toy_torso(2, 10)
    ratios, load = soft_ratios(torso), toy_load(30.0)
    first = _solve(torso, toy_supports(torso, spring=False), load, ratios)
    (support,) = first.reactions
    arms = PointsOnBones.at(
        first.state, np.full(4, 2), support.point + np.array([[0, 0, 0], [20.0, 0, 0], [0, 20.0, 0], [0, 0, 20.0]])
    )
    # Forces on three arms that make the support's moment, and at its place what is left of its force.
    x, y, z = support.moment / 20.0
    couples = np.array([[0.0, z, 0.0], [0.0, 0.0, x], [y, 0.0, 0.0]])
    forces = np.vstack([support.force - couples.sum(0), couples])
    both = _with(load, LoadCase(arms, forces))
    held = np.zeros((3, 6), dtype=bool)
    held[1] = True
    problem = EquilibriumProblem(torso, replace(toy_supports(torso, spring=False), held=held))
    random = np.random.default_rng(9)
    away = random.uniform(-0.3, 0.3, problem.potential.dofs)
    away[: 6 * problem.potential.bones].reshape(-1, 6)[:, 3:] *= 0.02
    away[problem.held] = 0.0
    again = problem.solve(both, ratios, start=retract(first.state, away), tolerance=1e-10)
    (idle,) = again.reactions
    force = np.concatenate([idle.force, idle.moment / 30.0])
    ok = again.converged and np.abs(support.force).max() > 1.0
    yield judged(
        "C3 anchor: reaction of a support that has nothing to do, N", np.abs(force).max() if ok else np.inf, 1e-8
    )
    apart = np.abs(places_of(again.state) - places_of(first.state)).max() if ok else np.inf
    yield judged("C3 anchor: places with another bone held, mm", apart, 1e-6)


def symmetries() -> Iterator[Check]:
    """Turned and shifted, mirrored, in centimetres, renumbered: the same answer."""
    turn, shift = exp_so3(np.array([0.6, -0.9, 1.3])), np.array([250.0, -90.0, 40.0])
    for nodes in (4, 10):
        torso = toy_torso(1, nodes)
        supports, load, ratios = toy_supports(torso), toy_load(), soft_ratios(torso)
        springs = supports.springs
        found = _solve(torso, supports, load, ratios).state

        other = moved_torso(torso, turn, shift)
        moved_springs = replace(
            springs, targets=springs.targets @ turn.T + shift, directions=springs.directions @ turn.T
        )
        again = _solve(
            other, replace(supports, springs=moved_springs), replace(load, forces=load.forces @ turn.T), ratios
        )
        wanted = moved_state(found, turn, shift)
        yield from _same(f"moved as a whole, {nodes} nodes", again.state, wanted, other.rest_pose)

        other = mirrored_torso(torso)
        points = PointsOnBones(springs.points.bone, springs.points.offset @ MIRROR)
        moved_springs = PointSprings(points, springs.targets @ MIRROR, springs.directions @ MIRROR, springs.stiffness)
        again = _solve(other, replace(supports, springs=moved_springs), mirrored_load(load), ratios)
        yield from _same(f"mirrored, {nodes} nodes", again.state, mirrored_state(found), other.rest_pose)

        for unit, length in (("centimetres", 0.1), ("metres", 0.001)):
            other = in_units(torso, length)
            points = PointsOnBones(springs.points.bone, length * springs.points.offset)
            stiffness = springs.stiffness / length
            moved_springs = PointSprings(points, length * springs.targets, springs.directions, stiffness)
            measured = LoadCase(PointsOnBones(load.points.bone, length * load.points.offset), load.forces)
            problem = EquilibriumProblem(other, replace(supports, springs=moved_springs))
            # Moments count over an arm of 30 units of length, so they are asked for less strictly in larger ones.
            again = problem.solve(measured, ratios, tolerance=1e-10 * load.size * length).require()
            wanted = TorsoState(length * found.bone_positions, found.bone_rotations, length * found.tissue_positions)
            yield from _same(f"in {unit}, {nodes} nodes", again.state, wanted, other.rest_pose)

        yield from _renumbered(torso, supports, load, ratios, found, nodes)


def _renumbered(
    torso: TorsoModel, supports: Supports, load: LoadCase, ratios: StiffnessRatios, found: TorsoState, nodes: int
) -> Iterator[Check]:
    random = np.random.default_rng(4)
    bones, joints = np.array([2, 0, 1]), np.array([1, 0])
    mesh = torso.tissue
    order, elements = random.permutation(len(mesh.rest_positions)), random.permutation(len(mesh.elements))
    other = renumbered_torso(torso, bones, order, elements, joints)
    new = np.argsort(bones)

    def points(old: PointsOnBones) -> PointsOnBones:
        return PointsOnBones(new[old.bone], old.offset)

    held = Supports(
        supports.held[bones], replace(supports.springs, points=points(supports.springs.points)), supports.names
    )
    kinds = stiffness_ratios(ratios.as_dict(), other.joints.kinds)
    again = _solve(other, held, replace(load, points=points(load.points)), kinds)
    place = torso.node_positions(found)[order][other.tissue.free_nodes]
    wanted = TorsoState(found.bone_positions[bones], found.bone_rotations[bones], place)
    yield from _same(f"renumbered, {nodes} nodes", again.state, wanted, other.rest_pose)


def _same(name: str, state: TorsoState, wanted: TorsoState, rest: TorsoState) -> Iterator[Check]:
    moves = places_of(wanted) - places_of(rest)
    item = "C5" if name.startswith("renumbered") else "C4"
    yield compared(f"{item} symmetry: {name}, displacements", places_of(state) - places_of(rest), moves, 1e-9)
    turns = wanted.bone_rotations - rest.bone_rotations
    yield compared(f"{item} symmetry: {name}, turns", state.bone_rotations - rest.bone_rotations, turns, 1e-9)


def limits() -> Iterator[Check]:
    """No load, no motion; stiffness and load trade exactly; stiffer moves less; a stiff joint is a weld."""
    torso = toy_torso(1, 10)
    supports, load = toy_supports(torso, spring=False), toy_load()
    problem = EquilibriumProblem(torso, supports)
    unloaded = problem.solve(no_load()).require()
    size = float(np.abs(places_of(torso.rest_pose)).max())
    yield vanishing(
        "C6 limits: no load, no displacement", places_of(unloaded.state) - places_of(torso.rest_pose), size, 1e-14
    )
    twice = stiffness_ratios({"everything": 2.0}, torso.joints.kinds)
    full = places_of(problem.solve(load, twice).require().state) - places_of(torso.rest_pose)
    half = places_of(problem.solve(load.scaled(0.5)).require().state) - places_of(torso.rest_pose)
    yield compared("C8 limits: twice as stiff under twice the load", full, half, 1e-9)
    small = load.scaled(1e-5)
    whole, doubled = (
        places_of(problem.solve(small, r, tolerance=1e-11).require().state) - places_of(torso.rest_pose)
        for r in (None, twice)
    )
    yield compared("C8 limits: a small load, twice as stiff, half the displacement", doubled, 0.5 * whole, 1e-6)
    direction, gives = load.forces / load.size, []
    for ratio in (0.05, 0.1, 0.3, 1.0, 3.0, 10.0):
        ratios = stiffness_ratios({"everything": ratio}, torso.joints.kinds)
        state = problem.solve(load, ratios).require().state
        gives.append(float(np.sum(direction * (load.points.positions(state) - load.points.positions(torso.rest_pose)))))
    yield counted("C8 limits: stiffer torsos give way less", int(np.sum(np.diff(gives) >= 0.0)), len(gives))
    gaps = []
    for stiffness in (1e3, 1e4, 1e5):
        values = np.full(6, stiffness) * np.array([1, 1, 1, 1e3, 1e3, 1e3])
        pair = two_bones(values)
        held = np.zeros((2, 6), dtype=bool)
        held[0] = True
        push = LoadCase(PointsOnBones(np.array([1]), np.array([[10.0, 5.0, 2.0]])), np.array([[20.0, -30.0, 10.0]]))
        state = EquilibriumProblem(pair, replace(toy_supports(pair, False), held=held)).solve(push).require().state
        gaps.append(float(np.abs(state.bone_positions[1] - pair.rest_pose.bone_positions[1]).max()))
    yield compared(
        "C8 limits: ten times the stiffness, a tenth of a joint's give", gaps[1:], np.array(gaps[:-1]) / 10.0, 1e-2
    )


def weld() -> Iterator[Check]:
    """Joints of a stiffness without end against bones that are one: the same answer, tissue and all."""
    for nodes in (4, 10):
        torso = toy_torso(1, nodes)
        stiffness = torso.joints.stiffness.copy()
        stiffness[0] = [1e7, 1e7, 1e7, 1e10, 1e10, 1e10]
        stiff = replace(torso, joints=replace(torso.joints, stiffness=stiffness))
        # Forces of 1e7 N/mm are known to 1e-7 N: places are the difference of numbers of 100 mm.
        problem = EquilibriumProblem(stiff, toy_supports(torso, spring=False))
        jointed = problem.solve(toy_load(), tolerance=1e-6).require().state
        # Bones 0 and 1 as one, in the frame of bone 0; the joint between them, the first, is gone.
        rest, table, mesh = torso.rest_pose, torso.joints, torso.tissue
        onto = np.array([0, 0, 1])
        owner = np.where(mesh.bone_of_node >= 0, onto[mesh.bone_of_node], -1)
        centre = PointsOnBones(table.parent[1:], table.parent_position[1:]).positions(rest)
        axes = (rest.bone_rotations[table.parent] @ table.parent_axes)[1:]
        kept = np.array([0, 2])
        one = make_torso(
            rest.bone_positions[kept],
            [(int(onto[table.parent[1]]), int(onto[table.child[1]]))],
            table.stiffness[1:],
            (mesh.rest_positions, mesh.elements),
            owner,
            *young_poisson(float(mesh.lame_mu[0]), float(mesh.lame_lambda[0])),
            centres=centre,
            axes=axes,
            rotations=rest.bone_rotations[kept],
        )
        load = toy_load()
        places = PointsOnBones.at(one.rest_pose, onto[load.points.bone], load.points.positions(rest))
        welded = _solve(one, toy_supports(one, spring=False), LoadCase(places, load.forces), None).state
        moves = np.vstack([welded.bone_positions[:1] - rest.bone_positions[:1], welded.tissue_positions])
        moves[1:] -= one.rest_pose.tissue_positions
        found = np.vstack([jointed.bone_positions[:1] - rest.bone_positions[:1], jointed.tissue_positions])
        found[1:] -= rest.tissue_positions
        yield compared(f"C8 limits: a joint without give is a weld, {nodes} nodes", found, moves, 1e-6)


def reciprocity() -> Iterator[Check]:
    """Betti: what a small force at a does at b is what the same force at b does at a, by whole solves; so the tangent.

    The tangent is stored as one triangle, so that its own reciprocity would prove nothing.
    """
    places = [(0, [4.0, 1.0, -2.0], [0.2, 0.9, -0.4]), (1, [-6.0, 8.0, 3.0], [-0.7, 0.1, 0.6])]
    small = [LoadCase(PointsOnBones(np.array([b]), np.array([o])), np.array([f])) for b, o, f in places]
    for nodes in (4, 10):
        torso = toy_torso(1, nodes)
        problem, load, ratios = EquilibriumProblem(torso, toy_supports(torso)), toy_load(), soft_ratios(torso)
        fine = 1e-12 * load.size
        found = problem.solve(load, ratios, tolerance=fine).require()
        step, works = 0.3, []
        for cause, effect in ((small[0], small[1]), (small[1], small[0])):
            loads = [_with(load, cause.scaled(k * step)) for k in (-3, -2, -1, 1, 2, 3)]
            ends = [problem.solve(both, ratios, tolerance=fine).require() for both in loads]
            # Work of the other force between the ends, sixth order in the step.
            values = [-effect.energy(end.state) for end in ends]
            works.append(float(np.array([-1.0, 9.0, -45.0, 45.0, -9.0, 1.0]) @ values) / (60.0 * step))
        yield compared(f"C6 reciprocity: by whole solves, {nodes} nodes", works[0], works[1], 1e-9)
        tangent, crossed = problem.linearise(found, load, ratios), []
        for cause, effect in ((small[0], small[1]), (small[1], small[0])):
            bone = int(effect.points.bone[0])
            moves = tangent.load_derivative(cause)[6 * bone : 6 * bone + 6]
            crossed.append(float(effect.forces[0] @ effect.points.jacobian(found.state)[0] @ moves))
        yield compared(f"C6 reciprocity: of the tangent, {nodes} nodes", crossed[0], crossed[1], 1e-10)
        yield compared(
            f"C6 reciprocity: the tangent's answer and whole solves, {nodes} nodes", crossed[0], works[0], 1e-9
        )


def _with(load: LoadCase, extra: LoadCase) -> LoadCase:
    bone = np.concatenate([load.points.bone, extra.points.bone])
    points = PointsOnBones(bone, np.vstack([load.points.offset, extra.points.offset]))
    return LoadCase(points, np.vstack([load.forces, extra.forces]))


GROUPS = (frames, balance, symmetries, limits, weld, reciprocity)
