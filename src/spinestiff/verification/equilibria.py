"""Checks of the equilibrium solver: convergence, balance, symmetries of physics, limits, and both sparse solvers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.stiffness import StiffnessRatios, stiffness_ratios
from spinestiff.anatomy.torso import TorsoModel, TorsoState, retract
from spinestiff.arrays import Floats
from spinestiff.mechanics.equilibrium import Equilibrium, EquilibriumProblem, SolveStatus
from spinestiff.mechanics.factor import Analysis, default_backend
from spinestiff.mechanics.loads import LoadCase, no_load
from spinestiff.mechanics.supports import Supports
from spinestiff.mechanics.terms import PointSprings
from spinestiff.verification.energies import dense, two_bones
from spinestiff.verification.models import shaken, toy_torso
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


def toy_load(size: float = 30.0) -> LoadCase:
    """Two oblique forces on arms of the first and the second bone."""
    points = PointsOnBones(np.array([1, 0]), np.array([[5.0, 0.0, 2.0], [-3.0, 4.0, 0.0]]))
    return LoadCase(points, size * np.array([[0.8, 0.1, 0.2], [0.3, -0.2, 0.4]]))


def _soft(torso: TorsoModel) -> StiffnessRatios:
    return stiffness_ratios(SOFT, torso.joints.kinds)


def _solve(torso: TorsoModel, supports: Supports, load: LoadCase, ratios: StiffnessRatios | None) -> Equilibrium:
    return EquilibriumProblem(torso, supports).solve(load, ratios).require()


def _places(state: TorsoState) -> Floats:
    return np.vstack([state.bone_positions, state.tissue_positions])


def newton() -> Iterator[Check]:
    """Quadratic convergence, falling energy, a minimum in the end, and the answer from random starts."""
    for nodes in (4, 10):
        torso = toy_torso(1, nodes)
        problem, load, ratios = EquilibriumProblem(torso, toy_supports(torso)), toy_load(60.0), _soft(torso)
        found = problem.solve(load, ratios).require()
        order = _newton_order(problem, found, load, ratios)
        yield judged(f"Newton: order of convergence less 2, {nodes} nodes", np.abs(order - 2.0).max(), 0.02)
        energies = np.array([step.energy for step in found.history])
        rises = np.diff(energies) > 1e-12 * np.abs(energies).max()
        yield counted(f"Newton: energy never rises, {nodes} nodes", int(rises.sum()), len(rises))
        stiffness, terms = problem.potential.stiffness(ratios), problem.all_terms(load)
        hessian = dense(problem.potential, problem.potential.hessian(found.state, stiffness, terms))
        free = np.setdiff1d(np.arange(problem.potential.dofs), problem.held)
        values = np.linalg.eigvalsh(hessian[np.ix_(free, free)])
        yield counted(f"Newton: the end is a minimum, {nodes} nodes", int(np.sum(values <= 0.0)), len(values))
        starts = [_held_back(shaken(torso, seed, turn=0.05, move=1.0), torso) for seed in range(3)]
        ends = [problem.solve(load, ratios, start=s) for s in starts]
        far = max(float(np.abs(_places(e.state) - _places(found.state)).max()) for e in ends)
        moved = float(np.abs(_places(found.state) - _places(torso.rest_pose)).max())
        ok = all(e.converged and not np.allclose(_places(s), _places(e.state), atol=0.1) for e, s in zip(ends, starts))
        yield vanishing(f"Newton: same answer from 3 random starts, {nodes} nodes", far if ok else np.inf, moved, 1e-8)


def _newton_order(problem: EquilibriumProblem, found: Equilibrium, load: LoadCase, ratios: StiffnessRatios) -> Floats:
    """Orders at which one step's remaining error falls as its first error is quartered, started around ``found``."""
    stiffness, terms = problem.potential.stiffness(ratios), problem.all_terms(load)
    away = np.random.default_rng(2).normal(size=problem.potential.dofs)
    away[: 6 * problem.potential.bones].reshape(-1, 6)[:, 3:] *= 0.03
    away[problem.held] = 0.0
    left = []
    for halving in range(0, 13, 2):
        # From 0.2 mm down to where rounding begins: a slightly wrong tangent shows only near the solution.
        state = retract(found.state, 0.2 * 0.5**halving * away)
        gradient, _ = problem.free_gradient(state, stiffness, terms)
        after = retract(state, -problem.factorise(state, stiffness, terms).solve(gradient))
        left.append(float(np.linalg.norm(_places(after) - _places(found.state))))
    return 0.5 * np.log2(np.array(left[:-1]) / np.array(left[1:]))[1:]


def _held_back(state: TorsoState, torso: TorsoModel) -> TorsoState:
    positions, rotations = state.bone_positions.copy(), state.bone_rotations.copy()
    positions[-1], rotations[-1] = torso.rest_pose.bone_positions[-1], torso.rest_pose.bone_rotations[-1]
    return TorsoState(positions, rotations, state.tissue_positions)


def out_of_balance(found: Equilibrium, load: LoadCase) -> tuple[Floats, Floats]:
    """Sum of loads and reactions, (3,) N, and of their moments about the world's origin, (3,) N mm."""
    places = load.points.positions(found.state)
    force = load.forces.sum(0) + sum(r.force for r in found.reactions)
    moment = np.cross(places, load.forces).sum(0) + sum(np.cross(r.point, r.force) + r.moment for r in found.reactions)
    return force, moment


def balance() -> Iterator[Check]:
    """Loads and reactions cancel in force and in moment; errors here are N, and N mm over 100 mm."""
    for nodes in (4, 10):
        for name, values in (("default", None), ("soft", SOFT)):
            torso = toy_torso(2, nodes)
            ratios = stiffness_ratios(values, torso.joints.kinds) if values else None
            load = toy_load(30.0)
            found = _solve(torso, toy_supports(torso), load, ratios)
            force, moment = out_of_balance(found, load)
            scale = float(min(np.abs(r.force).max() for r in found.reactions) > 0.1)
            yield vanishing(f"balance: loads and reactions, force, {name}, {nodes} nodes", force, scale, 1e-8)
            yield vanishing(f"balance: loads and reactions, moment, {name}, {nodes} nodes", moment, 100.0 * scale, 1e-8)


def symmetries() -> Iterator[Check]:
    """Turned and shifted, mirrored, in centimetres, renumbered: the same answer."""
    turn, shift = exp_so3(np.array([0.6, -0.9, 1.3])), np.array([250.0, -90.0, 40.0])
    for nodes in (4, 10):
        torso = toy_torso(1, nodes)
        supports, load, ratios = toy_supports(torso), toy_load(), _soft(torso)
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

        other = in_units(torso, 0.1)
        points = PointsOnBones(springs.points.bone, 0.1 * springs.points.offset)
        moved_springs = PointSprings(points, 0.1 * springs.targets, springs.directions, 10.0 * springs.stiffness)
        centimetres = LoadCase(PointsOnBones(load.points.bone, 0.1 * load.points.offset), load.forces)
        again = _solve(other, replace(supports, springs=moved_springs), centimetres, ratios)
        wanted = TorsoState(0.1 * found.bone_positions, found.bone_rotations, 0.1 * found.tissue_positions)
        yield from _same(f"in centimetres, {nodes} nodes", again.state, wanted, other.rest_pose)

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
    moves = _places(wanted) - _places(rest)
    yield compared(f"symmetry: {name}, displacements", _places(state) - _places(rest), moves, 1e-9)
    turns = wanted.bone_rotations - rest.bone_rotations
    yield compared(f"symmetry: {name}, turns", state.bone_rotations - rest.bone_rotations, turns, 1e-9)


def limits() -> Iterator[Check]:
    """No load, no motion; stiffness and load trade exactly; stiffer moves less; a stiff joint is a weld."""
    torso = toy_torso(1, 10)
    supports, load = toy_supports(torso, spring=False), toy_load()
    problem = EquilibriumProblem(torso, supports)
    unloaded = problem.solve(no_load()).require()
    size = float(np.abs(_places(torso.rest_pose)).max())
    yield vanishing("limits: no load, no displacement", _places(unloaded.state) - _places(torso.rest_pose), size, 1e-14)
    twice = stiffness_ratios({"everything": 2.0}, torso.joints.kinds)
    full = _places(problem.solve(load, twice).require().state) - _places(torso.rest_pose)
    half = _places(problem.solve(load.scaled(0.5)).require().state) - _places(torso.rest_pose)
    yield compared("limits: twice as stiff under twice the load", full, half, 1e-9)
    direction, gives = load.forces / load.size, []
    for ratio in (0.05, 0.1, 0.3, 1.0, 3.0, 10.0):
        ratios = stiffness_ratios({"everything": ratio}, torso.joints.kinds)
        state = problem.solve(load, ratios).require().state
        gives.append(float(np.sum(direction * (load.points.positions(state) - load.points.positions(torso.rest_pose)))))
    yield counted("limits: stiffer torsos give way less", int(np.sum(np.diff(gives) >= 0.0)), len(gives))
    gaps = []
    for stiffness in (1e3, 1e4, 1e5):
        values = np.full(6, stiffness) * np.array([1, 1, 1, 1e3, 1e3, 1e3])
        pair = two_bones(values)
        held = np.zeros((2, 6), dtype=bool)
        held[0] = True
        push = LoadCase(PointsOnBones(np.array([1]), np.array([[10.0, 5.0, 2.0]])), np.array([[20.0, -30.0, 10.0]]))
        state = _solve(pair, replace(toy_supports(pair, False), held=held), push, None).state
        gaps.append(float(np.abs(state.bone_positions[1] - pair.rest_pose.bone_positions[1]).max()))
    yield compared(
        "limits: ten times the stiffness, a tenth of a joint's give", gaps[1:], np.array(gaps[:-1]) / 10.0, 1e-2
    )


def reciprocity() -> Iterator[Check]:
    """Betti: what a small force at a does at b is what the same force at b does at a, by whole solves; so the tangent.

    The tangent is stored as one triangle, so that its own reciprocity would prove nothing.
    """
    places = [(0, [4.0, 1.0, -2.0], [0.2, 0.9, -0.4]), (1, [-6.0, 8.0, 3.0], [-0.7, 0.1, 0.6])]
    small = [LoadCase(PointsOnBones(np.array([b]), np.array([o])), np.array([f])) for b, o, f in places]
    for nodes in (4, 10):
        torso = toy_torso(1, nodes)
        problem, load, ratios = EquilibriumProblem(torso, toy_supports(torso)), toy_load(), _soft(torso)
        found = problem.solve(load, ratios).require()
        step, works = 0.05, []
        for cause, effect in ((small[0], small[1]), (small[1], small[0])):
            ends = [problem.solve(_with(load, cause.scaled(k * step)), ratios).require() for k in (-2, -1, 1, 2)]
            # Work of the other force between the ends, fourth order in the step.
            values = [-effect.energy(end.state) for end in ends]
            works.append(float(np.array([1.0, -8.0, 8.0, -1.0]) @ values) / (12.0 * step))
        yield compared(f"reciprocity: by whole solves, {nodes} nodes", works[0], works[1], 1e-9)
        moves = problem.linearise(found, load, ratios).load_derivative(small[0])[6:12]
        work = float(small[1].forces[0] @ small[1].points.jacobian(found.state)[0] @ moves)
        yield compared(f"reciprocity: the tangent's answer, {nodes} nodes", work, works[0], 1e-9)


def _with(load: LoadCase, extra: LoadCase) -> LoadCase:
    bone = np.concatenate([load.points.bone, extra.points.bone])
    points = PointsOnBones(bone, np.vstack([load.points.offset, extra.points.offset]))
    return LoadCase(points, np.vstack([load.forces, extra.forces]))


def refusals() -> Iterator[Check]:
    """What is no equilibrium is not called one: a body held by nothing, too few iterations, an inverted start."""
    torso = toy_torso(1, 10)
    nothing = replace(toy_supports(torso, spring=False), held=np.zeros((3, 6), dtype=bool))
    backends = sorted({default_backend(), "superlu"})
    wrong = sum(EquilibriumProblem(torso, nothing, backend=b).solve(toy_load()).converged for b in backends)
    yield counted("refusal: a torso held by nothing under load", wrong, len(backends))
    problem = EquilibriumProblem(torso, toy_supports(torso))
    short = problem.solve(toy_load(), _soft(torso), max_iterations=1)
    yield counted("refusal: one iteration is not enough", int(short.status is not SolveStatus.ITERATION_LIMIT), 1)
    inverted = TorsoState(
        torso.rest_pose.bone_positions, torso.rest_pose.bone_rotations, -torso.rest_pose.tissue_positions
    )
    rescued = problem.solve(toy_load(), start=inverted)
    direct = problem.solve(toy_load())
    move = _places(direct.state) - _places(torso.rest_pose)
    yield compared(
        "refusal: an inverted start falls back to rest", _places(rescued.state) - _places(torso.rest_pose), move, 1e-8
    )


def solvers() -> Iterator[Check]:
    """The sparse solvers against dense algebra and conjugate gradients: also definite told from indefinite."""
    backends = sorted({default_backend(), "superlu"})
    random = np.random.default_rng(8)
    wrong, trials, worst, indefinite = 0, 0, 0.0, 0
    for trial in range(12):
        n = 30
        lower = sp.tril(sp.random_array((n, n), density=0.15, rng=random), -1)
        shift = (4.0, 1.2, 0.6)[trial % 3]
        matrix = sp.csc_array(lower + sp.diags_array(shift * np.ones(n)))
        matrix.sort_indices()
        full = (matrix + sp.tril(matrix, -1).T).toarray()
        definite = bool(np.linalg.eigvalsh(full)[0] > 0.0)
        indefinite += not definite
        rhs = random.normal(size=(n, 2))
        for backend in backends:
            factor = Analysis(matrix.indptr.astype(np.int64), matrix.indices.astype(np.int64), backend).factor(
                matrix.data
            )
            error = (
                np.abs(factor.solve(rhs) - np.linalg.solve(full, rhs)).max() / np.abs(np.linalg.solve(full, rhs)).max()
            )
            worst = max(worst, float(error))
            wrong += factor.positive_definite != definite
            trials += 1
    mixed = 0 < indefinite < 12
    yield counted("sparse solvers: definite told from indefinite", wrong, trials if mixed else 0)
    yield judged("sparse solvers: solutions against dense algebra", worst, 1e-9)
    torso = toy_torso(1, 10)
    load, ratios = toy_load(), _soft(torso)
    states = [EquilibriumProblem(torso, toy_supports(torso), backend=b).solve(load, ratios) for b in backends]
    if len(backends) > 1:
        moves = [_places(s.state) - _places(torso.rest_pose) for s in states]
        yield compared("sparse solvers: the same equilibrium by both", moves[0], moves[1], 1e-9)
    problem = EquilibriumProblem(torso, toy_supports(torso))
    stiffness, terms = problem.potential.stiffness(ratios), problem.all_terms(load)
    free = np.setdiff1d(np.arange(problem.potential.dofs), problem.held)
    hessian = dense(problem.potential, problem.potential.hessian(states[0].state, stiffness, terms))[np.ix_(free, free)]
    right = np.zeros(problem.potential.dofs)
    right[free] = random.normal(size=len(free))
    scale = np.sqrt(np.diag(hessian))
    answer, _ = spla.cg(hessian / np.outer(scale, scale), right[free] / scale, rtol=1e-13, maxiter=5000)
    direct = problem.factorise(states[0].state, stiffness, terms).solve(right)[free]
    yield compared("sparse solvers: tangent against conjugate gradients", direct, answer / scale, 1e-8)


GROUPS = (newton, balance, symmetries, limits, reciprocity, refusals, solvers)
