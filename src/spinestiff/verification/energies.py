"""Checks of energies and their derivatives against the complex-step oracle, and of what physics demands of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from spinestiff.anatomy.rotation import exp_so3, log_so3
from spinestiff.anatomy.state import TorsoState, retract
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.mechanics.assembly import Stiffness
from spinestiff.mechanics.joints import joint_hessians
from spinestiff.mechanics.loads import LoadCase, tissue_load
from spinestiff.mechanics.potential import Potential
from spinestiff.mechanics.terms import PointSprings, Term
from spinestiff.verification.models import box_mesh, make_torso, points_on, shaken, toy_torso
from spinestiff.verification.oracle import (
    EnergyOracle,
    complex_step_gradient,
    curvature_along,
    hessian_times,
    slope_along,
)
from spinestiff.verification.outcome import Check, compared, counted, judged, vanishing
from spinestiff.verification.transforms import moved_state, moved_torso

GRADIENT_TOLERANCE = 1e-13
HESSIAN_TOLERANCE = 1e-12
STATES = 100  # random ones of a sweep
# 0 and tiny: series; 0.4 and 0.6: either side of the switch to the closed form at 0.5.
JOINT_ANGLES = (0.0, 1e-9, 1e-4, 0.4, 0.6, 1.0, 2.5)
_SOME_NODE_DOFS = 24


def dense(potential: Potential, values: Floats) -> Floats:
    """The full matrix (dofs, dofs) of the lower triangle's ``values``."""
    shape = (potential.dofs, potential.dofs)
    lower = sp.csc_array((values, potential.pattern.indices, potential.pattern.indptr), shape=shape)
    full: Floats = (lower + sp.tril(lower, -1).T).toarray()
    return full


def two_bones(stiffness: Floats, axes: Floats | None = None) -> TorsoModel:
    """Two bones and a joint off both their origins; no tissue."""
    places = np.array([[0.0, 0.0, 0.0], [4.0, 35.0, -3.0]])
    return make_torso(
        places,
        [(0, 1)],
        stiffness,
        centres=np.array([[3.0, 14.0, 6.0]]),
        axes=exp_so3(np.array([[0.3, -0.2, 0.5]])) if axes is None else axes[None],
        rotations=exp_so3(np.array([[0.2, 0.1, -0.3], [-0.1, 0.4, 0.2]])),
    )


def bent(torso: TorsoModel, angle: float, gap: float = 3.0) -> TorsoState:
    """The second bone turned by ``angle`` about an oblique axis and shifted; both bones moved as a whole."""
    rest = torso.rest_pose
    axis = np.array([0.48, -0.6, 0.64])
    turns = np.stack([np.eye(3), exp_so3(angle * axis)])
    shifts = gap * np.array([[0.0, 0.0, 0.0], [0.7, -0.4, 0.5]])
    state = TorsoState(rest.bone_positions + shifts, turns @ rest.bone_rotations, rest.tissue_positions)
    return moved_state(state, exp_so3(np.array([0.5, -0.3, 0.2])), np.array([3.0, -2.0, 1.0]))


def _terms(torso: TorsoModel, seed: int) -> tuple[LoadCase, PointSprings]:
    random = np.random.default_rng(seed)
    load = LoadCase(points_on(torso, 4, seed), random.uniform(-20.0, 20.0, (4, 3)))
    directions = random.normal(size=(3, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    springs = PointSprings(
        points_on(torso, 3, seed + 1), random.uniform(0.0, 60.0, (3, 3)), directions, np.array([1.0, 20.0, 300.0])
    )
    return load, springs


def _against_oracle(
    name: str,
    torso: TorsoModel,
    state: TorsoState,
    stiffness: Stiffness,
    terms: tuple[Term, ...],
    oracle: EnergyOracle,
    directions: int = 1,
) -> Iterator[Check]:
    potential = Potential(torso)
    bones, dofs = 6 * potential.bones, potential.dofs
    random = np.random.default_rng(7)
    some = random.permutation(np.arange(bones, dofs))[:_SOME_NODE_DOFS]
    which = np.concatenate([np.arange(bones), some])
    reference = complex_step_gradient(oracle, np.zeros(dofs), which.tolist())
    gradient = potential.gradient(state, stiffness, terms)[which]
    # Forces and moments differ by the size of an arm: each is held to its own scale.
    turning = np.zeros(dofs, dtype=bool)
    turning[:bones].reshape(-1, 6)[:, 3:] = True
    turning = turning[which]
    parts = [(gradient[rows], reference[rows]) for rows in (turning, ~turning)]
    errors = [np.abs(g - r).max() / np.abs(r).max() for g, r in parts if np.abs(r).max(initial=0.0) != 0.0]
    yield judged(f"A1 gradient: {name}", np.max(errors) if len(errors) > 0 else np.inf, GRADIENT_TOLERANCE)
    hessian = dense(potential, potential.hessian(state, stiffness, terms))
    worst = 0.0
    for _ in range(directions):
        direction = random.normal(size=dofs)
        direction[:bones].reshape(-1, 6)[:, 3:] *= 0.03
        wanted = hessian_times(oracle, direction, which.tolist())
        found = (hessian @ direction)[which]
        for rows in (turning, ~turning):
            size = np.abs(wanted[rows]).max(initial=0.0)
            error = float(np.abs(found - wanted)[rows].max(initial=0.0)) / size if size > 0.0 else 0.0
            # Not Python's max, which passes NaN by.
            worst = float(np.maximum(worst, error))
        worst = worst if np.abs(wanted).max() > 0.0 else np.inf
    yield judged(f"A2 Hessian: {name}", worst, HESSIAN_TOLERANCE)


def joint_derivatives() -> Iterator[Check]:
    """Joints alone, at every branch of the angle, with six different stiffnesses about tilted axes."""
    torso = two_bones(np.array([26.0, 170.0, 31.0, 15e3, 13e3, 11e3]))
    stiffness = Potential(torso).stiffness(None)
    for angle in JOINT_ANGLES:
        state = bent(torso, angle)
        oracle = EnergyOracle(torso, state)
        oracle.parts = ("joints",)
        yield from _against_oracle(f"joint turned by {angle:g} rad", torso, state, stiffness, (), oracle, 2)


def tissue_derivatives() -> Iterator[Check]:
    """Both parts of the tissue's energy, in straight four-node and curved ten-node elements, tied and free nodes."""
    for nodes in (4, 10):
        torso = toy_torso(1, nodes)
        for part in ("mu", "lambda"):
            nought = np.zeros(len(torso.tissue.elements))
            mesh = torso.tissue
            mesh = replace(mesh, lame_lambda=nought) if part == "mu" else replace(mesh, lame_mu=nought)
            one = replace(torso, tissue=mesh)
            state = shaken(torso, 3)
            full = Potential(one).stiffness(None)
            oracle = EnergyOracle(one, state)
            oracle.parts = ("tissue",)
            stiffness = full._replace(joints=np.zeros_like(full.joints))
            yield from _against_oracle(f"tissue, {part} part, {nodes} nodes", one, state, stiffness, (), oracle)


def term_derivatives() -> Iterator[Check]:
    """Dead forces and springs on bones and tissue nodes, each with its second derivative in the bones' turns."""
    torso = two_bones(np.zeros(6))
    state = bent(torso, 0.7)
    load, springs = _terms(torso, 5)
    stiffness = Potential(torso).stiffness(None)
    oracle = EnergyOracle(torso, state, forces=(load.points, load.forces))
    yield from _against_oracle("dead forces at points of bones", torso, state, stiffness, (load,), oracle, 2)
    held = (springs.points, springs.targets, springs.directions, springs.stiffness)
    oracle = EnergyOracle(torso, state, springs=held)
    yield from _against_oracle("springs at points of bones", torso, state, stiffness, (springs,), oracle, 2)
    torso = small_torso(10)
    state, nodes = shaken(torso, 4), np.arange(0, len(torso.tissue.rest_positions), 2)
    load = tissue_load(torso, nodes, np.random.default_rng(6).uniform(-20.0, 20.0, (len(nodes), 3)))
    stiffness = Stiffness(*(np.zeros_like(values) for values in Potential(torso).stiffness(None)))
    oracle = EnergyOracle(torso, state, forces=(load.points, load.forces), node_forces=(load.nodes, load.node_forces))
    oracle.parts = ("loads",)
    yield from _against_oracle("dead forces at tissue nodes", torso, state, stiffness, (load,), oracle, 2)


def whole_derivatives() -> Iterator[Check]:
    """All terms together; also the energy itself."""
    for seed, nodes in ((1, 4), (2, 10)):
        torso = toy_torso(seed, nodes)
        state = shaken(torso, seed + 3)
        load, springs = _terms(torso, seed)
        potential = Potential(torso)
        held = (springs.points, springs.targets, springs.directions, springs.stiffness)
        oracle = EnergyOracle(torso, state, None, (load.points, load.forces), held)
        stiffness = potential.stiffness(None)
        energy, _ = potential.energy(state, stiffness, (load, springs))
        reference = oracle(np.zeros(potential.dofs, dtype=complex)).real
        yield compared(f"A1 energy: all terms, {nodes} nodes", energy, reference, 1e-12)
        yield from _against_oracle(f"all terms, {nodes} nodes", torso, state, stiffness, (load, springs), oracle)


def small_torso(nodes: int) -> TorsoModel:
    """Two bones in a box of six elements, a joint between them: every term, and quick."""
    positions, elements = box_mesh((1, 1, 1), (30.0, 40.0, 25.0), nodes)
    positions = positions + np.random.default_rng(8).uniform(-0.5, 0.5, positions.shape)
    owner = np.where(positions[:, 1] < 1.0, 0, np.where(positions[:, 1] > 39.0, 1, -1))
    owner[positions[:, 0] > 29.0] = -1
    places = np.array([[12.0, -4.0, 11.0], [14.0, 46.0, 13.0]])
    return make_torso(places, [(1, 0)], np.array([26.0, 170.0, 31.0, 15e3, 13e3, 11e3]), (positions, elements), owner)


def _parts(dofs: int, bones: int) -> tuple[np.ndarray, ...]:
    """Masks (dofs,) of bones' shifts, bones' turns and free nodes: each is held to its own scale."""
    kind = np.full(dofs, 2)
    kind[: 6 * bones].reshape(-1, 6)[:] = [0, 0, 0, 1, 1, 1]
    return tuple(kind == i for i in range(3))


def sweep() -> Iterator[Check]:
    """Each term's slope and curvature in random directions of 100 random states: the worst of all.

    Tissue's part in the bones' directions is the coupling of tied nodes.
    """
    bare = two_bones(np.array([26.0, 170.0, 31.0, 15e3, 13e3, 11e3]))
    load, springs = _terms(bare, 2)
    cases: list[tuple[str, str, TorsoModel, tuple[Term, ...]]] = [
        ("joint", "joints", bare, ()),
        ("dead forces", "loads", bare, (load,)),
        ("springs", "springs", bare, (springs,)),
    ]
    for nodes in (4, 10):
        torso = small_torso(nodes)
        nought = np.zeros(len(torso.tissue.elements))
        for part, key in (("mu", "lame_lambda"), ("lambda", "lame_mu")):
            one = replace(torso, tissue=replace(torso.tissue, **{key: nought}))  # type: ignore[arg-type]
            cases.append((f"tissue, {part} part, {nodes} nodes", "tissue", one, ()))
    for name, part, torso, terms in cases:
        potential = Potential(torso)
        stiffness = potential.stiffness(None)
        if part != "joints":
            stiffness = stiffness._replace(joints=np.zeros_like(stiffness.joints))
        errors = []
        for seed in range(STATES):
            state = shaken(torso, seed, turn=0.3 if part == "tissue" else 0.8, move=1.5)
            held = (springs.points, springs.targets, springs.directions, springs.stiffness)
            oracle = EnergyOracle(torso, state, None, (load.points, load.forces), held)
            oracle.parts = (part,)
            errors.append(_worst_of_state(potential, state, stiffness, terms, oracle, seed))
        slopes, curvatures = np.max(errors, axis=0)
        yield judged(f"A1 gradient: {name}, worst of {STATES} random states", slopes, GRADIENT_TOLERANCE)
        yield judged(f"A2 Hessian: {name}, worst of {STATES} random states", curvatures, HESSIAN_TOLERANCE)


def _worst_of_state(
    potential: Potential,
    state: TorsoState,
    stiffness: Stiffness,
    terms: tuple[Term, ...],
    oracle: EnergyOracle,
    seed: int,
) -> tuple[float, float]:
    """Errors of slope and curvature over the root of the sum of squares of what they are sums of."""
    random = np.random.default_rng(seed)
    first, second = random.normal(size=(2, potential.dofs))
    masks = _parts(potential.dofs, potential.bones)
    for vector in (first, second):
        vector[masks[1]] *= 0.03
    gradient = potential.gradient(state, stiffness, terms)
    moved = dense(potential, potential.hessian(state, stiffness, terms)) @ second
    worst = [0.0, 0.0] if np.any(moved) and np.any(gradient) else [np.inf, np.inf]
    for mask in masks:
        if not mask.any():
            continue
        along = np.where(mask, first, 0.0)
        references = (slope_along(oracle, along), curvature_along(oracle, along, second))
        for i, (found, wanted) in enumerate(zip((gradient, moved), references)):
            size = float(np.linalg.norm(found * along))
            error = abs(float(found @ along) - wanted)
            # A dead force has no curvature in shifts: there both are nought.
            share = error / size if size > 0.0 else (np.inf if wanted else error)
            worst[i] = float(np.maximum(worst[i], share))
    return worst[0], worst[1]


def hessian_symmetry() -> Iterator[Check]:
    """The Hessian's upper half, which is stored only for blocks on the diagonal, and from the energy itself."""
    torso = toy_torso(3, 4)
    state, potential = shaken(torso, 8), Potential(torso)
    load, springs = _terms(torso, 9)
    blocks = np.concatenate(
        [
            joint_hessians(torso.joints, shaken(torso, seed, turn=0.8), torso.joints.stiffness)
            for seed in range(STATES // len(torso.joints))
        ]
    )
    yield _symmetric("joints", blocks)
    for name, term in (("dead forces", load), ("springs", springs)):
        yield _symmetric(name, term.blocks(state).hessian)
    stiffness = potential.stiffness(None)
    oracle = EnergyOracle(
        torso,
        state,
        None,
        (load.points, load.forces),
        (springs.points, springs.targets, springs.directions, springs.stiffness),
    )
    random = np.random.default_rng(11)
    first, second = random.normal(size=(2, potential.dofs))
    turning = _parts(potential.dofs, potential.bones)[1]
    first[turning] *= 0.03
    second[turning] *= 0.03
    hessian = dense(potential, potential.hessian(state, stiffness, (load, springs)))
    both = [curvature_along(oracle, first, second), curvature_along(oracle, second, first)]
    yield compared(
        "A2 Hessian: mixed curvature of all terms, either order", [first @ hessian @ second] * 2, both, 1e-12
    )


def _symmetric(name: str, blocks: Floats) -> Check:
    gap, size = np.abs(blocks - np.swapaxes(blocks, 1, 2)).max(), np.abs(blocks).max()
    return vanishing(f"A2 Hessian: symmetry, {name}", gap, float(size), 1e-14)


def objectivity() -> Iterator[Check]:
    """A torso moved as a whole has the same energy, and forces that turn with it."""
    random = np.random.default_rng(12)
    for nodes in (4, 10):
        torso = toy_torso(2, nodes)
        potential = Potential(torso)
        stiffness = potential.stiffness(None)
        energies, forces, again = [], [], []
        for seed in range(STATES):
            turn, shift = exp_so3(random.uniform(-2.0, 2.0, 3)), random.uniform(-200.0, 200.0, 3)
            state = shaken(torso, seed, turn=0.1, move=1.5)
            moved = moved_state(state, turn, shift)
            before, after = (potential.energy(s, stiffness, ())[0] for s in (state, moved))
            energies.append(after / before - 1.0)
            here, there = (potential.gradient(s, stiffness, ()).reshape(-1, 3) for s in (state, moved))
            forces.append(np.abs(there - here @ turn.T).max() / np.abs(here).max())
            if seed < 10:
                elsewhere = Potential(moved_torso(torso, turn, shift))
                again.append(elsewhere.energy(moved, stiffness, ())[0] / before - 1.0)
        many = f"{nodes} nodes, {STATES} states"
        yield judged(f"A3 objectivity: energy, {many}", np.abs(energies).max(), 1e-12)
        yield judged(f"A3 objectivity: forces and moments, {many}", np.max(forces), 1e-12)
        yield judged(f"A3 objectivity: rest pose moved too, {nodes} nodes, 10 states", np.abs(again).max(), 1e-12)


def internal_balance() -> Iterator[Check]:
    """Internal forces of any state have no resultant, and no moment about any point."""
    random = np.random.default_rng(13)
    for nodes in (4, 10):
        torso = toy_torso(4, nodes)
        potential = Potential(torso)
        stiffness = potential.stiffness(None)
        force, moment = [], []
        for seed in range(STATES):
            state = shaken(torso, seed, turn=0.1, move=1.5)
            gradient = potential.gradient(state, stiffness, ())
            bones = gradient[: 6 * potential.bones].reshape(-1, 6)
            free = gradient[6 * potential.bones :].reshape(-1, 3)
            forces = np.vstack([bones[:, :3], free])
            places = np.vstack([state.bone_positions, state.tissue_positions]) - random.uniform(-300.0, 300.0, 3)
            moments = np.cross(places, forces)
            force.append(np.abs(forces.sum(0)).max() / np.abs(forces).max())
            moment.append(np.abs(moments.sum(0) + bones[:, 3:].sum(0)).max() / np.abs(moments).max())
        many = f"{nodes} nodes, {STATES} states"
        yield judged(f"A4 internal balance: force, {many}", np.max(force), 1e-12)
        yield judged(f"A4 internal balance: moment about any point, {many}", np.max(moment), 1e-12)


def zero_modes() -> Iterator[Check]:
    """A free torso has six motions without energy at rest, one more for each absent joint stiffness, none when held."""
    torso = toy_torso(1, 10)
    potential = Potential(torso)
    stiffness = potential.stiffness(None)
    cases = [
        ("whole torso, free", torso, stiffness, 6),
        ("tissue without joints, free", torso, stiffness._replace(joints=np.zeros_like(stiffness.joints)), 6),
    ]
    for missing in range(1, 7):
        values = np.array([26.0, 170.0, 31.0, 15e3, 13e3, 11e3])
        values[[0, 4, 5, 2, 3, 1][:missing]] = 0.0
        two = two_bones(values)
        cases.append(
            (f"two bones, joint without {missing} of 6 stiffnesses", two, Potential(two).stiffness(None), 6 + missing)
        )
    for name, model, stiff, wanted in cases:
        p = Potential(model)
        found = zero_mode_count(dense(p, p.hessian(model.rest_pose, stiff, ())), p.bones)
        yield counted(f"A5 zero modes: {name}", abs(found - wanted), 1)
    held = dense(potential, potential.hessian(torso.rest_pose, stiffness, ()))[6:, 6:]
    yield counted("A5 zero modes: first bone held", zero_mode_count(held, potential.bones - 1), 1)


def zero_mode_count(hessian: Floats, bones: int) -> int:
    """How many eigenvalues are nought (or negative) beside the largest, turns measured over an arm of 30 mm."""
    scale = np.ones(len(hessian))
    scale[: 6 * bones].reshape(-1, 6)[:, 3:] = 1.0 / 30.0
    values = np.linalg.eigvalsh(scale[:, None] * hessian * scale)
    return int(np.sum(values < 1e-10 * values[-1])) if values[-1] > 0.0 else len(values)


def inversion() -> Iterator[Check]:
    """States with a turned-out element have infinite energy, never NaN, whichever way they are reached."""
    for nodes in (4, 10):
        torso = toy_torso(1, nodes)
        potential = Potential(torso)
        stiffness = potential.stiffness(None)
        random = np.random.default_rng(3)
        wrong = trials = 0
        for _ in range(300):
            dx = random.normal(size=potential.dofs) * random.choice([2.0, 20.0, 200.0])
            dx[: 6 * potential.bones].reshape(-1, 6)[:, 3:] *= 0.01
            energy, smallest = potential.energy(retract(torso.rest_pose, dx), stiffness, ())
            trials += smallest <= 0.0
            wrong += not (energy == np.inf if smallest <= 0.0 else np.isfinite(energy))
        yield counted(
            f"A9 inversion: infinite energy exactly where J <= 0, {nodes} nodes", wrong, min(trials, 300 - trials)
        )


def joint_axes() -> Iterator[Check]:
    """k d^2 / 2 and k theta^2 / 2 about each tilted axis of a joint alone, and the rotation vector near pi."""
    values = np.array([26.0, 170.0, 31.0, 15e3, 13e3, 11e3])
    tilted = exp_so3(np.array([0.3, -0.2, 0.5]))
    for axis in range(6):
        torso = two_bones(values, tilted)
        direction, amount = tilted[:, axis % 3], 4.0 if axis < 3 else 0.8
        rest = torso.rest_pose
        positions, rotations = rest.bone_positions.copy(), rest.bone_rotations.copy()
        if axis < 3:
            positions[1] += amount * direction
        else:
            turn, centre = exp_so3(amount * direction), np.array([3.0, 14.0, 6.0])
            rotations[1] = turn @ rotations[1]
            positions[1] = centre + turn @ (positions[1] - centre)
        potential = Potential(torso)
        state = TorsoState(positions, rotations, rest.tissue_positions)
        energy, _ = potential.energy(state, potential.stiffness(None), ())
        yield compared(f"A10 joint: energy along axis {axis + 1} of 6", energy, 0.5 * values[axis] * amount**2, 1e-12)
    yield from _frames(values, tilted)
    axis3 = np.array([0.48, -0.6, 0.64])
    for angle, tolerance in ((1e-9, 1e-12), (1e-4, 1e-12), (1.0, 1e-13), (3.0, 1e-12), (np.pi - 1e-6, 1e-12)):
        found = log_so3(exp_so3(angle * axis3))
        yield compared(f"A10 rotation vector: log exp at {angle:.7g} rad", found, angle * axis3, tolerance)
    yield vanishing("A10 rotation vector: log of no rotation", log_so3(np.eye(3)), 1.0, 0.0)
    random = np.random.default_rng(6)
    drift = _drift(lambda: random.uniform(-0.02, 0.02, 3))
    yield judged("A10 rotation: orthonormal after 10,000 random updates", drift, UPDATE_DRIFT)


# exp(w) R is multiplied out and not made orthonormal again, so that rounding adds up like a random walk of 1e-16 an
# update: about 1e-14 after 10,000. An equilibrium takes tens.
UPDATE_DRIFT = 5e-14


def _drift(step: Callable[[], Floats]) -> float:
    """Error of orthonormality after 10,000 updates of a bone as ``retract`` makes them."""
    none = np.empty((0, 3))
    state = TorsoState(np.zeros((1, 3)), np.eye(3)[None], none)
    for _ in range(10_000):
        state = retract(state, np.concatenate([np.zeros(3), step()]))
    turn = state.bone_rotations[0]
    return float(np.abs(turn @ turn.T - np.eye(3)).max())


def _frames(values: Floats, tilted: Floats) -> Iterator[Check]:
    """Shift and turn together: shifts are measured along the parent's axes, so it matters which bone that is."""
    torso = two_bones(values, tilted)
    rest, shift, angle = torso.rest_pose, np.array([1.5, -2.0, 1.0]), np.array([0.3, -0.4, 0.25])
    turn, centre = exp_so3(angle), np.array([3.0, 14.0, 6.0])
    positions, rotations = rest.bone_positions.copy(), rest.bone_rotations.copy()
    rotations[1] = turn @ rotations[1]
    positions[1] = centre + turn @ (positions[1] - centre) + shift
    potential = Potential(torso)
    state = TorsoState(positions, rotations, rest.tissue_positions)
    energy, _ = potential.energy(state, potential.stiffness(None), ())
    turning = 0.5 * np.sum(values[3:] * (tilted.T @ angle) ** 2)
    wanted = 0.5 * np.sum(values[:3] * (tilted.T @ shift) ** 2) + turning
    yield compared("A10 joint: shift and turn together, shift along the parent's axes", energy, wanted, 1e-12)
    swapped = replace(
        torso,
        joints=replace(
            torso.joints,
            parent=torso.joints.child,
            child=torso.joints.parent,
            parent_position=torso.joints.child_position,
            child_position=torso.joints.parent_position,
            parent_axes=torso.joints.child_axes,
            child_axes=torso.joints.parent_axes,
        ),
    )
    child, _ = Potential(swapped).energy(state, potential.stiffness(None), ())
    wanted = 0.5 * np.sum(values[:3] * ((turn @ tilted).T @ shift) ** 2) + turning
    yield compared("A10 joint: parent and child exchanged, shift along the child's axes", child, wanted, 1e-12)


GROUPS = (
    joint_derivatives,
    tissue_derivatives,
    term_derivatives,
    whole_derivatives,
    hessian_symmetry,
    objectivity,
    internal_balance,
    zero_modes,
    inversion,
    joint_axes,
)
