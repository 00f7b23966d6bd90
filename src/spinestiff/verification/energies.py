"""Checks of energies and their derivatives against the complex-step oracle, and of what physics demands of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from spinestiff.anatomy.rotation import exp_so3, log_so3
from spinestiff.anatomy.torso import TorsoModel, TorsoState, retract
from spinestiff.arrays import Floats
from spinestiff.mechanics.loads import LoadCase
from spinestiff.mechanics.potential import Potential, Stiffness
from spinestiff.mechanics.terms import BoneTerm, PointSprings
from spinestiff.verification.models import make_torso, points_on, shaken, toy_torso
from spinestiff.verification.oracle import EnergyOracle, complex_step_gradient, hessian_times
from spinestiff.verification.outcome import Check, compared, counted, judged, vanishing
from spinestiff.verification.transforms import moved_state, moved_torso

GRADIENT_TOLERANCE = 1e-12
HESSIAN_TOLERANCE = 1e-9
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
    terms: tuple[BoneTerm, ...],
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
    errors = [np.abs(g - r).max() / np.abs(r).max() for g, r in parts if np.abs(r).max(initial=0.0) > 0.0]
    yield judged(f"gradient: {name}", max(errors) if len(errors) > 0 else np.inf, GRADIENT_TOLERANCE)
    hessian = dense(potential, potential.hessian(state, stiffness, terms))
    worst = 0.0
    for _ in range(directions):
        direction = random.normal(size=dofs)
        direction[:bones].reshape(-1, 6)[:, 3:] *= 0.03
        wanted = hessian_times(oracle, direction, which.tolist())
        found = (hessian @ direction)[which]
        for rows in (turning, ~turning):
            size = np.abs(wanted[rows]).max(initial=0.0)
            worst = max(worst, float(np.abs(found - wanted)[rows].max(initial=0.0)) / size if size > 0.0 else worst)
        worst = worst if np.abs(wanted).max() > 0.0 else np.inf
    yield judged(f"Hessian: {name}", worst, HESSIAN_TOLERANCE)


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
    """Dead forces and springs on bones alone, each with its second derivative in the bones' turns."""
    torso = two_bones(np.zeros(6))
    state = bent(torso, 0.7)
    load, springs = _terms(torso, 5)
    stiffness = Potential(torso).stiffness(None)
    oracle = EnergyOracle(torso, state, forces=(load.points, load.forces))
    yield from _against_oracle("dead forces at points of bones", torso, state, stiffness, (load,), oracle, 2)
    held = (springs.points, springs.targets, springs.directions, springs.stiffness)
    oracle = EnergyOracle(torso, state, springs=held)
    yield from _against_oracle("springs at points of bones", torso, state, stiffness, (springs,), oracle, 2)


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
        yield compared(f"energy: all terms, {nodes} nodes", energy, reference, 1e-12)
        yield from _against_oracle(f"all terms, {nodes} nodes", torso, state, stiffness, (load, springs), oracle)


def hessian_symmetry() -> Iterator[Check]:
    """The Hessian's upper half, which is never stored, from the gradient's differences."""
    torso = toy_torso(3, 4)
    state, potential = shaken(torso, 8), Potential(torso)
    load, springs = _terms(torso, 9)
    stiffness = potential.stiffness(None)
    hessian = dense(potential, potential.hessian(state, stiffness, (load, springs)))
    random = np.random.default_rng(11)
    direction = random.normal(size=potential.dofs)
    direction[: 6 * potential.bones].reshape(-1, 6)[:, 3:] *= 0.03
    energies = [
        potential.energy(retract(state, step * direction), stiffness, (load, springs))[0]
        for step in (-2e-3, -1e-3, 0.0, 1e-3, 2e-3)
    ]
    # Fourth-order second difference along one line.
    curvature = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) @ energies / (12.0 * 1e-6)
    yield compared("Hessian: curvature of the energy along a line", direction @ hessian @ direction, curvature, 1e-6)


def objectivity() -> Iterator[Check]:
    """A torso moved as a whole has the same energy, and forces that turn with it."""
    turn, shift = exp_so3(np.array([0.7, -1.1, 0.4])), np.array([120.0, -40.0, 15.0])
    for nodes in (4, 10):
        torso = toy_torso(2, nodes)
        state, potential = shaken(torso, 5), Potential(torso)
        stiffness = potential.stiffness(None)
        moved = moved_state(state, turn, shift)
        before, after = (potential.energy(s, stiffness, ())[0] for s in (state, moved))
        yield compared(f"objectivity: energy, {nodes} nodes", after, before, 1e-12)
        forces, turned = (potential.gradient(s, stiffness, ()).reshape(-1, 3) for s in (state, moved))
        yield compared(f"objectivity: forces and moments, {nodes} nodes", turned, forces @ turn.T, 1e-12)
        elsewhere = Potential(moved_torso(torso, turn, shift))
        again = elsewhere.energy(moved, stiffness, ())[0]
        yield compared(f"objectivity: rest pose moved too, {nodes} nodes", again, before, 1e-12)


def internal_balance() -> Iterator[Check]:
    """Internal forces of any state have no resultant and no moment."""
    for nodes in (4, 10):
        torso = toy_torso(4, nodes)
        state, potential = shaken(torso, 6), Potential(torso)
        gradient = potential.gradient(state, potential.stiffness(None), ())
        bones = gradient[: 6 * potential.bones].reshape(-1, 6)
        free = gradient[6 * potential.bones :].reshape(-1, 3)
        forces = np.vstack([bones[:, :3], free])
        places = np.vstack([state.bone_positions, state.tissue_positions])
        moments = np.cross(places, forces)
        size = float(np.abs(forces).max())
        yield vanishing(f"internal balance: force, {nodes} nodes", forces.sum(0), size, 1e-12)
        total = moments.sum(0) + bones[:, 3:].sum(0)
        yield vanishing(f"internal balance: moment, {nodes} nodes", total, float(np.abs(moments).max()), 1e-12)


def zero_modes() -> Iterator[Check]:
    """A free torso has six motions without energy at rest, one more for each absent joint stiffness, none when held."""
    torso = toy_torso(1, 10)
    potential = Potential(torso)
    stiffness = potential.stiffness(None)
    cases = [
        ("whole torso, free", torso, stiffness, 6),
        ("tissue without joints, free", torso, stiffness._replace(joints=np.zeros_like(stiffness.joints)), 6),
    ]
    for missing in range(1, 4):
        values = np.array([26.0, 170.0, 31.0, 15e3, 13e3, 11e3])
        values[[0, 4, 5][:missing]] = 0.0
        two = two_bones(values)
        cases.append(
            (f"two bones, joint without {missing} of 6 stiffnesses", two, Potential(two).stiffness(None), 6 + missing)
        )
    for name, model, stiff, wanted in cases:
        p = Potential(model)
        found = zero_mode_count(dense(p, p.hessian(model.rest_pose, stiff, ())), p.bones)
        yield counted(f"zero modes: {name}", abs(found - wanted), 1)
    held = dense(potential, potential.hessian(torso.rest_pose, stiffness, ()))[6:, 6:]
    yield counted("zero modes: first bone held", zero_mode_count(held, potential.bones - 1), 1)


def zero_mode_count(hessian: Floats, bones: int) -> int:
    """How many eigenvalues are nought (or negative) beside the largest, turns measured over an arm of 30 mm."""
    scale = np.ones(len(hessian))
    scale[: 6 * bones].reshape(-1, 6)[:, 3:] = 1.0 / 30.0
    values = np.linalg.eigvalsh(scale[:, None] * hessian * scale)
    return int(np.sum(values < 1e-10 * values[-1]))


def inversion() -> Iterator[Check]:
    """States with a turned-out element have infinite energy, never NaN, whichever way they are reached."""
    torso = toy_torso(1, 10)
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
    yield counted("inversion: infinite energy exactly where J <= 0", wrong, min(trials, 300 - trials))


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
        yield compared(f"joint: energy along axis {axis + 1} of 6", energy, 0.5 * values[axis] * amount**2, 1e-12)
    axis3 = np.array([0.48, -0.6, 0.64])
    for angle, tolerance in ((1e-9, 1e-12), (1e-4, 1e-12), (1.0, 1e-13), (3.0, 1e-12), (np.pi - 1e-6, 1e-8)):
        yield compared(
            f"rotation vector: log exp at {angle:.7g} rad", log_so3(exp_so3(angle * axis3)), angle * axis3, tolerance
        )
    turn, step = np.eye(3), exp_so3(np.array([0.01, -0.02, 0.015]))
    for _ in range(10_000):
        turn = step @ turn
    yield judged("rotation: orthonormal after 10,000 updates", np.abs(turn @ turn.T - np.eye(3)).max(), 1e-11)


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
