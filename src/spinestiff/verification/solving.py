"""Checks of how an equilibrium is found: Newton's convergence, descent, what is refused, and the sparse solvers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import TorsoState, retract
from spinestiff.anatomy.stiffness import StiffnessRatios
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.equilibrium import Equilibrium, EquilibriumProblem, SolveStatus
from spinestiff.mechanics.factor import Analysis, default_backend
from spinestiff.mechanics.loads import LoadCase
from spinestiff.mechanics.newton import Run
from spinestiff.mechanics.potential import Potential
from spinestiff.mechanics.supports import Supports
from spinestiff.verification.energies import dense, small_torso, zero_mode_count
from spinestiff.verification.equilibria import astray, places_of, soft_ratios, toy_load, toy_supports
from spinestiff.verification.models import shaken, toy_torso
from spinestiff.verification.oracle import EnergyOracle, complex_step_gradient, volume_ratios
from spinestiff.verification.outcome import Check, compared, counted, judged, vanishing


def newton() -> Iterator[Check]:
    """Quadratic convergence, falling energy, a minimum in the end, and the answer from random starts."""
    for nodes in (4, 10):
        torso = toy_torso(1, nodes)
        problem, load, ratios = EquilibriumProblem(torso, toy_supports(torso)), toy_load(60.0), soft_ratios(torso)
        fine = 1e-12 * load.size
        found = problem.solve(load, ratios, tolerance=fine).require()
        order = _newton_order(problem, found, load, ratios)
        yield judged(f"C1 Newton: order of convergence less 2, {nodes} nodes", np.abs(order - 2.0).max(), 0.02)
        energies = np.array([step.energy for step in found.history])
        size = np.abs(energies).max() + abs(load.energy(found.state)) + abs(load.energy(torso.rest_pose))
        # Mixed steps may overshoot on the way (mechanics/equilibrium.py), never below where they end.
        below = energies < energies[-1] - 1e-13 * size
        yield counted(
            f"C2 Newton: no state on the way has less energy than the end, {nodes} nodes", int(below.sum()), len(below)
        )
        stiffness, terms = problem.potential.stiffness(ratios), problem.all_terms(load)
        hessian = dense(problem.potential, problem.potential.hessian(found.state, stiffness, terms))
        free = np.setdiff1d(np.arange(problem.potential.dofs), problem.held)
        values = np.linalg.eigvalsh(hessian[np.ix_(free, free)])
        yield counted(f"C2 Newton: the end is a minimum, {nodes} nodes", int(np.sum(values <= 0.0)), len(values))
        left = _oracle_residual(problem, found.state, load, ratios)
        yield judged(f"C2 Newton: residual over the load, by the second energy, {nodes} nodes", left / load.size, 1e-10)
        starts = [astray(torso, seed) for seed in range(5)]
        ends = [problem.solve(load, ratios, start=s, tolerance=fine) for s in starts]
        far = float(np.max([np.abs(places_of(e.state) - places_of(found.state)).max() for e in ends]))
        moved = float(np.abs(places_of(found.state) - places_of(torso.rest_pose)).max())
        # A start that is refused, or one at the answer, would prove nothing.
        ok = all(e.converged and e.history[0].smallest_j > 0.0 and e.history[0].residual > 1.0 for e in ends)
        name = f"C5 Newton: same answer from 5 random starts within 5 mm and 5 degrees, {nodes} nodes"
        yield vanishing(name, far if ok else np.inf, moved, 1e-8)


def _oracle_residual(
    problem: EquilibriumProblem, state: TorsoState, load: LoadCase, ratios: StiffnessRatios | None
) -> float:
    """Largest unbalanced force, N, by complex steps of the second energy; moments over 30 mm."""
    springs = problem.supports.springs
    held = (springs.points, springs.targets, springs.directions, springs.stiffness)
    oracle = EnergyOracle(problem.torso, state, ratios, (load.points, load.forces), held)
    dofs = problem.potential.dofs
    gradient = complex_step_gradient(oracle, np.zeros(dofs), range(dofs))
    gradient[problem.held] = 0.0
    gradient[: 6 * problem.potential.bones].reshape(-1, 6)[:, 3:] /= 30.0
    return float(np.abs(gradient).max())


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
        gradient = problem.free(problem.potential.gradient(state, stiffness, terms))
        after = retract(state, -problem.factorise(state, stiffness, terms).solve(gradient))
        turned = 30.0 * np.linalg.norm(after.bone_rotations - found.state.bone_rotations)
        left.append(float(np.linalg.norm(places_of(after) - places_of(found.state)) + turned))
    return 0.5 * np.log2(np.array(left[:-1]) / np.array(left[1:]))[1:]


def refusals() -> Iterator[Check]:
    """What is no equilibrium is not called one: a body held by nothing, too few iterations, an inverted start."""
    torso = toy_torso(1, 10)
    nothing = replace(toy_supports(torso, spring=False), held=np.zeros((3, 6), dtype=bool))
    backends = sorted({default_backend(), "superlu"})
    wrong = sum(not _refused(torso, nothing, backend, "whole torso") for backend in backends)
    yield counted("A5 refusal: a torso held by nothing under load", wrong, len(backends))
    # A bone more, tied to nothing: the torso has six motions more, and they have a name.
    stray = _with_stray(torso)
    potential = Potential(stray)
    hessian = dense(potential, potential.hessian(stray.rest_pose, potential.stiffness(None), ()))
    modes = zero_mode_count(hessian, potential.bones)
    yield counted("A5 zero modes: with a bone that nothing holds", abs(modes - 12), 1)
    held = np.zeros((4, 6), dtype=bool)
    held[2] = True
    supports = replace(toy_supports(torso, spring=False), held=held)
    named = _refused(stray, supports, backends[0], "stray")
    yield counted("A5 refusal: names a bone that nothing holds", int(not named), 1)
    problem = EquilibriumProblem(torso, toy_supports(torso))
    short = problem.solve(toy_load(), soft_ratios(torso), max_iterations=1)
    yield counted("C2 refusal: one iteration is not enough", int(short.status is not SolveStatus.ITERATION_LIMIT), 1)
    inverted = TorsoState(
        torso.rest_pose.bone_positions, torso.rest_pose.bone_rotations, -torso.rest_pose.tissue_positions
    )
    rescued = problem.solve(toy_load(), start=inverted)
    direct = problem.solve(toy_load())
    move = places_of(direct.state) - places_of(torso.rest_pose)
    yield compared(
        "A9 refusal: an inverted start falls back to rest",
        places_of(rescued.state) - places_of(torso.rest_pose),
        move,
        1e-8,
    )


STEPS = 500


def _refused(torso: TorsoModel, supports: Supports, backend: str, name: str) -> bool:
    """Whether no equilibrium is given, with an error that names what is free."""
    try:
        EquilibriumProblem(torso, supports, backend=backend).solve(toy_load()).require()
    except EquilibriumError as error:
        return name in str(error)
    return False


def _with_stray(torso: TorsoModel) -> TorsoModel:
    """The torso with one bone more that has neither joint nor tissue."""
    rest = torso.rest_pose
    places = np.vstack([rest.bone_positions, [[200.0, 0.0, 0.0]]])
    turns = np.concatenate([rest.bone_rotations, np.eye(3)[None]])
    pose = TorsoState(places, turns, rest.tissue_positions)
    return replace(torso, bone_names=(*torso.bone_names, "stray"), rest_pose=pose)


def descent() -> Iterator[Check]:
    """The last resort, from wild starts under a large load: every step lowers the energy."""
    for nodes, move in ((4, 4.0), (10, 2.5)):
        torso = toy_torso(1, nodes)
        problem, load, ratios = EquilibriumProblem(torso, toy_supports(torso)), toy_load(120.0), soft_ratios(torso)
        rises = steps = 0
        for seed in range(20):
            wild = shaken(torso, seed, turn=0.4, move=move)
            positions, rotations = wild.bone_positions.copy(), wild.bone_rotations.copy()
            positions[-1], rotations[-1] = torso.rest_pose.bone_positions[-1], torso.rest_pose.bone_rotations[-1]
            run = Run(problem, ratios, None, 30, None)
            run.descend(load, TorsoState(positions, rotations, wild.tissue_positions))
            energies = np.array([entry.energy for entry in run.history])
            steps += max(len(energies) - 1, 0)
            rises += int(np.sum(np.diff(energies) > 1e-13 * np.abs(energies).max(initial=0.0)))
        yield counted(f"C2 descent: energy never rises, {nodes} nodes", rises, steps)


def inverting_steps() -> Iterator[Check]:
    """Loads whose first Newton step turns elements inside out, 500 a kind of element: no such state is accepted."""
    for nodes in (4, 10):
        torso = small_torso(nodes)
        # The joint lets the bones shift but not turn, so that a step is long.
        soft = np.array([[1.0, 1.0, 1.0, 1e6, 1e6, 1e6]])
        torso = replace(torso, joints=replace(torso.joints, stiffness=soft))
        held = np.zeros((2, 6), dtype=bool)
        held[1] = True
        supports = replace(toy_supports(torso, spring=False), held=held)
        problem = EquilibriumProblem(torso, supports, backend="superlu")  # the quicker one on 30 unknowns
        potential, rest, mesh = problem.potential, torso.rest_pose, torso.tissue
        frame = problem.kinematics.at(rest)
        hessian = dense(potential, potential.hessian(rest, potential.stiffness(None), ()))
        free = np.setdiff1d(np.arange(potential.dofs), problem.held)
        inverse = np.linalg.inv(hessian[np.ix_(free, free)])
        random, trials, tried, accepted = np.random.default_rng(10), 0, 0, 0
        while trials < STEPS and tried < 8 * STEPS:
            tried += 1
            points = PointsOnBones(np.zeros(2, np.int64), random.uniform(-20.0, 20.0, (2, 3)))
            forces = random.normal(size=(2, 3)) * 10.0 ** random.uniform(3.0, 5.0)
            load, step = LoadCase(points, forces), np.zeros(potential.dofs)
            gradient = np.zeros(potential.dofs)
            gradient[:6] = load.blocks(rest).gradient.sum(0)
            step[free] = -inverse @ gradient[free]
            step /= max(1.0, float(np.linalg.norm(step[3:6])) / 0.5, float(np.abs(step).max()) / 100.0)
            ahead = volume_ratios(
                mesh.rest_positions, torso.node_positions(frame.move(frame.from_world(step))), mesh.elements
            )
            if ahead.min() > 0.0:
                continue
            trials += 1
            # Most are cancelled after this step; some go on to what is tried next, a step of each, descent at last.
            cancelled = trials % 5 > 0
            found = problem.solve(load, observer=lambda _, end=cancelled: end, max_iterations=1)  # type: ignore[misc]
            reached = volume_ratios(mesh.rest_positions, torso.node_positions(found.state), mesh.elements)
            fell = all(entry.smallest_j > 0.0 for entry in found.history)
            accepted += not (reached.min() > 0.0 and fell and np.isfinite(found.energy))
        yield counted(
            f"A9 inversion: {trials} inverting steps, accepted, {nodes} nodes", accepted, int(trials == STEPS)
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
            worst = float(np.maximum(worst, error))
            wrong += factor.positive_definite != definite
            trials += 1
    mixed = 0 < indefinite < 12
    yield counted("C7 sparse solvers: definite told from indefinite", wrong, trials if mixed else 0)
    yield judged("C7 sparse solvers: solutions against dense algebra", worst, 1e-9)
    torso = toy_torso(1, 10)
    load, ratios = toy_load(), soft_ratios(torso)
    states = [EquilibriumProblem(torso, toy_supports(torso), backend=b).solve(load, ratios) for b in backends]
    if len(backends) > 1:
        moves = [places_of(s.state) - places_of(torso.rest_pose) for s in states]
        yield compared("C7 sparse solvers: the same equilibrium by both", moves[0], moves[1], 1e-9)
    problem = EquilibriumProblem(torso, toy_supports(torso))
    stiffness, terms = problem.potential.stiffness(ratios), problem.all_terms(load)
    free = np.setdiff1d(np.arange(problem.potential.dofs), problem.held)
    hessian = dense(problem.potential, problem.potential.hessian(states[0].state, stiffness, terms))[np.ix_(free, free)]
    right = np.zeros(problem.potential.dofs)
    right[free] = random.normal(size=len(free))
    scale = np.sqrt(np.diag(hessian))
    answer, _ = spla.cg(hessian / np.outer(scale, scale), right[free] / scale, rtol=1e-13, maxiter=5000)
    direct = problem.factorise(states[0].state, stiffness, terms).solve(right)[free]
    yield compared("C7 sparse solvers: tangent against conjugate gradients", direct, answer / scale, 1e-8)


GROUPS = (newton, descent, refusals, solvers)
