"""Checks of whole solutions against closed forms, finite strains and large turns included."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import scipy.optimize as so
import scipy.special as ss

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.rotation import exp_so3, log_so3
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import TABLE_1
from spinestiff.anatomy.torso import TissueMesh, TorsoModel
from spinestiff.arrays import Floats
from spinestiff.mechanics.equilibrium import Equilibrium, EquilibriumProblem
from spinestiff.mechanics.loads import LoadCase, no_load, three_point_reactions
from spinestiff.mechanics.tissue import element_data, element_energies, element_gradients
from spinestiff.verification.blocks import (
    PointBoneBlock,
    holds,
    jittered_box,
    point_bone_block,
    stacked_block,
    young_poisson,
)
from spinestiff.verification.models import box_mesh, make_torso
from spinestiff.verification.oracle import Complexes, complex_step_gradient
from spinestiff.verification.outcome import Check, compared, counted, judged

# Nominal stress of a bar free to thin, mu = 1, lambda = 2 -> its axial and lateral stretch: the root of
# mu (t^2 - 1) + lambda ln(s t^2) = 0, P = mu (s - 1/s) + lambda ln(s t^2) / s, found to 30 digits.
UNIAXIAL = {
    -0.5: (0.83839710502611857, 1.05929611451625445),
    -0.2: (0.92937871197425419, 1.02450989876417229),
    0.2: (1.07967526840103386, 0.97455817246413656),
    0.5: (1.21790091485338819, 0.93505731427224600),
    1.0: (1.50166669674083103, 0.86794940599078935),
}
FINITE = np.array([[1.15, 0.20, -0.05], [0.10, 0.90, 0.15], [-0.08, 0.12, 1.10]])
OBLIQUE = exp_so3(np.array([0.4, -0.7, 0.5]))


def _element_stress(f: Floats, nodes: int, mu: float, lambda_: float) -> Floats:
    """(3, 3) mean nominal stress of a curved element under the affine map ``f``, from its nodal forces alone."""
    positions, elements = box_mesh((1, 1, 1), (2.0, 3.0, 1.5), nodes)
    if nodes == 10:
        positions = positions + np.random.default_rng(2).uniform(-0.05, 0.05, positions.shape)
    one = elements[:1]
    mesh = TissueMesh(positions, one, np.full(len(positions), -1), np.array([mu]), np.array([lambda_]))
    data = element_data(mesh)
    parts = element_gradients(positions @ f.T, data.elements, data.gradients, data.weights)[0]
    forces = mu * parts[0] + lambda_ * parts[1]
    return np.asarray(forces.T @ positions[one[0]] / data.weights.sum())


def material_points() -> Iterator[Check]:
    """One element under a given deformation gradient: its nodal forces are those of the closed-form stress."""
    for nodes in (4, 10):
        for stress, (axial, lateral) in UNIAXIAL.items():
            found = _element_stress(OBLIQUE @ np.diag([lateral, axial, lateral]), nodes, 1.0, 2.0)
            wanted = OBLIQUE @ np.diag([0.0, stress, 0.0])
            yield compared(f"A7 material point: uniaxial stress {stress:g}, {nodes} nodes", found, wanted, 1e-12)
        for strain in (0.1, 0.7):
            shear = np.eye(3) + strain * np.outer([1.0, 0, 0], [0, 1.0, 0])
            wanted = strain * (np.outer([1.0, 0, 0], [0, 1.0, 0]) + np.outer([0, 1.0, 0], [1.0, 0, 0]))
            found = _element_stress(shear, nodes, 1.0, 2.0)
            yield compared(f"A8 material point: simple shear {strain:g}, {nodes} nodes", found, wanted, 1e-12)
        for stretch, stress in ((0.8, -2.123576634856573), (1.2, 1.278274450636440)):
            found = _element_stress(stretch * np.eye(3), nodes, 1.0, 2.0)
            yield compared(
                f"A8 material point: hydrostatic {stretch:g}, {nodes} nodes", found, stress * np.eye(3), 1e-12
            )
    # Small strain: the stress of Hooke's law with the E and nu of the Lame parameters.
    young, poisson = young_poisson(1.0, 2.0)
    stiffness, strain = young / (2.0 * (1.0 + poisson)), 1e-6
    bulk = young / (3.0 * (1.0 - 2.0 * poisson))
    oblique = np.array([[0.0, 0.5, 0.0], [0.5, 0.0, 0.5], [0.0, 0.5, 0.0]])
    for name, direction, wanted in (
        ("uniaxial stress, E and nu", np.diag([-poisson, 1.0, -poisson]), np.diag([0.0, young, 0.0])),
        ("shear, E / 2 (1 + nu)", oblique, 2.0 * stiffness * oblique),
        ("compression, E / 3 (1 - 2 nu)", -np.eye(3), -3.0 * bulk * np.eye(3)),
    ):
        ends = [_element_stress(np.eye(3) + s * strain * direction, 10, 1.0, 2.0) for s in (1.0, -1.0)]
        slope = (ends[0] - ends[1]) / (2.0 * strain)
        yield compared(f"A6 material point: Hooke's law at strain 1e-6, {name}", slope, wanted, 1e-6)


def element_energy() -> Iterator[Check]:
    """Volume and energy of a whole irregular mesh under an affine map; curved elements to their quadrature's error."""
    for nodes, curve, tolerance in ((4, 0.0, 1e-12), (10, 0.0, 1e-12), (10, 0.05, 1e-4)):
        size = (20.0, 30.0, 25.0)
        positions, elements = jittered_box((2, 3, 2), size, nodes, curve=curve)
        t = len(elements)
        data = element_data(TissueMesh(positions, elements, np.full(len(positions), -1), np.ones(t), np.ones(t)))
        name = f"{nodes} nodes{', curved' if curve else ''}"
        yield compared(f"A7 mesh: volume of a box, {name}", data.weights.sum(), np.prod(size), tolerance)
        energy, _ = element_energies(positions @ FINITE.T, data.elements, data.gradients, data.weights)
        log_j = np.log(np.linalg.det(FINITE))
        wanted = np.prod(size) * np.array([0.5 * (np.sum(FINITE**2) - 3.0) - log_j, 0.5 * log_j**2])
        yield compared(f"A7 mesh: energy of a finite affine map, {name}", energy.sum(0), wanted, tolerance)


def patch() -> Iterator[Check]:
    """Boundary moved by a finite affine map: every inner node follows it (irregular mesh)."""
    for nodes, cells in ((4, (3, 3, 3)), (10, (2, 2, 2))):
        size = (30.0, 40.0, 35.0)
        positions, elements = jittered_box(cells, size, nodes)
        outer = np.any((positions < 1e-9) | (positions > np.array(size) - 1e-9), axis=1, keepdims=True)
        block = point_bone_block((positions, elements), np.repeat(outer, 3, 1), 0.02, 0.05)
        target = positions @ FINITE.T
        bumped = target + np.random.default_rng(1).uniform(-0.8, 0.8, target.shape)
        start = block.start(target[block.nodes], bumped)
        found = EquilibriumProblem(block.torso, block.supports).solve(no_load(), start=start, tolerance=1e-13)
        free = block.torso.tissue.free_nodes
        moves = found.state.tissue_positions - positions[free]
        yield _solved(f"B1 patch: finite affine map, {nodes} nodes", found, moves, (target - positions)[free], 1e-12)


def rigid_patch() -> Iterator[Check]:
    """Boundary moved as a rigid whole, with a free bone inside: bone and nodes follow, nothing is strained."""
    size = (40.0, 40.0, 40.0)
    positions, elements = jittered_box((2, 2, 2), size, 10)
    outer = ((positions < 1e-9) | (positions > np.array(size) - 1e-9)).any(1)
    centre = np.full(3, 20.0)
    inside = np.linalg.norm(positions - centre, axis=1) < 13.0
    boundary = np.flatnonzero(outer)
    owner = np.where(inside, len(boundary), -1)
    owner[boundary] = np.arange(len(boundary))
    torso = make_torso(np.vstack([positions[boundary], centre]), [], np.zeros(6), (positions, elements), owner)
    held = np.ones((len(boundary) + 1, 6), dtype=bool)
    held[-1] = False
    turn, shift = exp_so3(np.array([0.3, -0.5, 0.6])), np.array([5.0, -3.0, 2.0])
    rest = torso.rest_pose
    moved = rest.bone_positions @ turn.T + shift
    turns = np.vstack([turn @ rest.bone_rotations[:-1], exp_so3(np.array([[0.4, -0.4, 0.5]]))])
    moved[-1] += [0.4, -0.3, 0.2]
    start = TorsoState(moved, turns, rest.tissue_positions @ turn.T + shift)
    found = EquilibriumProblem(torso, holds(held)).solve(no_load(), start=start, tolerance=1e-13)
    place, pose = found.state.bone_positions[-1], found.state.bone_rotations[-1]
    free = torso.tissue.free_nodes
    yield _solved(
        "B1 patch: rigid motion, inner nodes",
        found,
        found.state.tissue_positions,
        positions[free] @ turn.T + shift,
        1e-12,
    )
    yield _solved("B1 patch: rigid motion, place of the bone inside", found, place, centre @ turn.T + shift, 1e-12)
    yield _solved("B1 patch: rigid motion, turn of the bone inside", found, pose, turn, 1e-12)


def _solved(
    name: str, equilibrium: Equilibrium, values: Floats | float, reference: Floats | float, tolerance: float
) -> Check:
    """As ``compared``, but an equilibrium that did not converge fails."""
    return compared(name, values, reference, tolerance) if equilibrium.converged else judged(name, np.inf, tolerance)


def _bar(nodes: int) -> PointBoneBlock:
    """A bar along z: bottom held along z and top to be moved along z, two sides sliding; the rest free to thin."""
    size = (10.0, 10.0, 20.0)
    mesh = jittered_box((1, 1, 2), size, nodes)
    p = mesh[0]
    held = p < 1e-9
    held[:, 2] |= p[:, 2] > size[2] - 1e-9
    return point_bone_block(mesh, held, 1.0, 2.0)


def uniaxial() -> Iterator[Check]:
    """A block pulled or pressed along one axis and free to thin: lateral stretch and reaction in closed form."""
    for nodes in (4, 10):
        block = _bar(nodes)
        problem = EquilibriumProblem(block.torso, block.supports)
        for stress, (axial, lateral) in UNIAXIAL.items():
            bones, all_nodes = block.positions[block.nodes] * [1, 1, axial], block.positions * [1, 1, axial]
            found = problem.solve(no_load(), start=block.start(bones, all_nodes), tolerance=1e-10)
            free = block.torso.tissue.free_nodes
            widths = np.concatenate([found.state.tissue_positions[:, :2], found.state.bone_positions[:, :2]])
            rest = np.concatenate([block.positions[free, :2], block.positions[block.nodes, :2]])
            top = block.positions[block.nodes, 2] > 19.0
            force = sum(r.force[2] for r, above in zip(found.reactions, top) if above)
            name = f"{stress:g}, {nodes} nodes"
            yield _solved(
                f"B2 uniaxial block: widths at stress {name}", found, widths - rest, (lateral - 1.0) * rest, 1e-10
            )
            yield _solved(f"B2 uniaxial block: force at stress {name}", found, force, 100.0 * stress, 1e-10)


# A confined block, mu = 5 kPa, lambda = 20 kPa, 100 x 100 x 100 mm, and a joint of 50 N/mm, under -30 N.
CONFINED = {"block": -8.953884960480311, "series": -9.553884960480311, "parallel": -0.5658248776502177}


def hybrid() -> Iterator[Check]:
    """Rigid bones, ties, tissue and a joint in one exact problem: block and joint in series, and in parallel."""
    size, stiffness = (100.0, 100.0, 100.0), np.array([3e3, 3e3, 50.0, 4e6, 4e6, 4e6])
    for nodes, cells in ((4, (2, 2, 2)), (10, (2, 2, 1))):
        layers = len(np.unique(box_mesh(cells, size, nodes)[0][:, 2].round(9)))
        top = layers - 1
        above = np.array([[50.0, 50.0, 130.0]])
        torso, _ = stacked_block(cells, size, 0.005, 0.020, above, [(top, top + 1)], stiffness, nodes)
        found = _pressed(torso, top + 1)
        moves = (found.state.bone_positions - torso.rest_pose.bone_positions)[:, 2]
        yield _solved(
            f"B3 hybrid: block in series with a joint, {nodes} nodes", found, moves[top], CONFINED["block"], 1e-10
        )
        yield _solved(
            f"B3 hybrid: series, end of the joint, {nodes} nodes", found, moves[-1], CONFINED["series"], 1e-10
        )
        yield _solved(
            f"B3 hybrid: series, reaction, {nodes} nodes",
            found,
            found.reaction("bone0"),
            np.array([0.0, 0.0, 30.0]),
            1e-10,
        )
        inner = torso.tissue.rest_positions[torso.tissue.free_nodes]
        stretch = 1.0 + CONFINED["block"] / 100.0
        yield _solved(
            f"B3 hybrid: series, inner nodes, {nodes} nodes",
            found,
            found.state.tissue_positions,
            inner * [1, 1, stretch],
            1e-10,
        )
        torso, _ = stacked_block(cells, size, 0.005, 0.020, np.empty((0, 3)), [(0, top)], stiffness, nodes)
        found = _pressed(torso, top)
        moves = (found.state.bone_positions - torso.rest_pose.bone_positions)[:, 2]
        yield _solved(f"B3 hybrid: block beside a joint, {nodes} nodes", found, moves[top], CONFINED["parallel"], 1e-10)


def _pressed(torso: TorsoModel, bone: int) -> Equilibrium:
    held = np.zeros((len(torso.bone_names), 6), dtype=bool)
    held[0] = True
    # Guided along z: a free column of this softness buckles under 30 N.
    held[-2:] = (True, True, False, True, True, True)
    load = LoadCase(PointsOnBones(np.array([bone]), np.zeros((1, 3))), np.array([[0.0, 0.0, -30.0]]))
    # Tighter than the default 1e-10 of the load, which beside the joint would be 5e-11 of the answer.
    return EquilibriumProblem(torso, holds(held)).solve(load, tolerance=1e-11)


def _wound_chain(stiffnesses: Floats, motor: float, winding: float) -> TorsoModel:
    """A chain of bones along y with joints (n, 6), its last bone held by a joint that rests at ``winding`` about z.

    The last joint turns freely apart from one spring about z and carries no force, so what it exerts is a pure moment
    at any turn: an end moment without a following force.
    """
    n = len(stiffnesses)
    places = np.zeros((n + 2, 3))
    places[: n + 1, 1] = 30.0 * np.arange(n + 1)
    places[n + 1] = places[n] + [0.0, 40.0, 0.0]
    links = [(i, i + 1) for i in range(n)] + [(n + 1, n)]
    values = np.vstack([stiffnesses, [0.0, 0.0, 0.0, 0.0, 0.0, motor]])
    torso = make_torso(places, links, values)
    child = torso.joints.child_axes.copy()
    child[-1] = exp_so3(np.array([0.0, 0.0, -winding]))
    return replace(torso, joints=replace(torso.joints, child_axes=child))


def chains() -> Iterator[Check]:
    """Joints in a row: under an end moment the turns add up, M sum(1/k); under a force the shifts do."""
    moment, motor = 5000.0, 8000.0
    for lumbar, printed in ((6, 31.998841), (5, 31.936417)):
        thoracic, name = 17 - lumbar, f"{17 - lumbar} thoracic and {lumbar} lumbar joints"
        exact = moment * (lumbar / 149e3 + thoracic / 154e3)
        digits = np.deg2rad(printed)
        yield compared(f"B4 chain: {name} of Table 1 under 5 N m, printed digits", exact, digits, 5e-8)
        rows = np.array([TABLE_1["lumbar"]] * lumbar + [TABLE_1["thoracic"]] * thoracic)
        rows[:, 3:] *= 1000.0
        torso = _wound_chain(rows, motor, exact + moment / motor)
        held = np.zeros((len(torso.bone_names), 6), dtype=bool)
        held[[0, -1]] = True
        found = EquilibriumProblem(torso, holds(held)).solve(no_load())
        turns = log_so3(found.state.bone_rotations[:-1])
        wanted = np.zeros((18, 3))
        wanted[1:, 2] = moment * np.cumsum(1.0 / rows[:, 5])
        yield _solved(f"B4 chain: turns under an end moment of 5 N m, {name}", found, turns, wanted, 1e-9)
        moments = np.array([r.moment[2] for r in found.reactions])
        yield _solved(f"B4 chain: moments at both ends, {name}", found, moments, np.array([-moment, moment]), 1e-9)
        # Every joint turns its upper neighbour about the midpoint: the ends' positions follow from the turns.
        place, heading = np.zeros(2), 0.0
        for step in np.diff(np.concatenate([[0.0], wanted[1:, 2]])):
            place = place + 15.0 * np.array([-np.sin(heading), np.cos(heading)])
            heading += step
            place = place + 15.0 * np.array([-np.sin(heading), np.cos(heading)])
        end = found.state.bone_positions[17, :2]
        yield _solved(f"B4 chain: place of the upper end, {name}", found, end, place, 1e-9)


def joint_axes_turned() -> Iterator[Check]:
    """Joints with different stiffnesses along axes turned by 30 degrees, in series and in parallel."""
    turn = exp_so3(np.array([0.0, 0.0, np.deg2rad(30.0)]))
    first, second = np.array([20.0, 170.0, 35.0, 1e5, 1e5, 1e5]), np.array([60.0, 25.0, 90.0, 1e5, 1e5, 1e5])
    compliance = [turn @ np.diag(1.0 / k[:3]) @ turn.T for k in (first, second)]
    force = np.array([[12.0, -7.0, 4.0]])
    places = np.array([[0.0, 0, 0], [0.0, 40, 0], [0.0, 80, 0]])
    held = np.zeros((3, 6), dtype=bool)
    held[0], held[1:, 3:] = True, True
    for name, links, wanted in (
        ("series", [(0, 1), (1, 2)], (compliance[0] + compliance[1]) @ force[0]),
        ("parallel", [(0, 2), (0, 2)], np.linalg.inv(sum(np.linalg.inv(c) for c in compliance)) @ force[0]),
    ):
        loaded = held.copy()
        loaded[1] |= name == "parallel"
        torso = make_torso(places, links, np.stack([first, second]), axes=np.stack([turn, turn]))
        load = LoadCase(PointsOnBones(np.array([2]), np.zeros((1, 3))), force)
        found = EquilibriumProblem(torso, holds(loaded)).solve(load)
        shift = found.state.bone_positions[2] - places[2]
        yield _solved(f"B4 joint axes turned by 30 deg: {name}", found, shift, wanted, 1e-10)


def planar_chain() -> Iterator[Check]:
    """A chain bent far by an end force, against the minimum of its planar energy found by another solver."""
    n, length, force = 6, 30.0, np.array([60.0, -25.0])
    shear, axial, turn = 200.0, 900.0, 9e3
    places = np.zeros((n + 1, 3))
    places[:, 1] = length * np.arange(n + 1)
    stiffness = np.array([shear, axial, shear, 2e4, 2e4, turn])
    torso = make_torso(places, [(i, i + 1) for i in range(n)], stiffness)
    held = np.zeros((n + 1, 6), dtype=bool)
    held[0] = True
    load = LoadCase(PointsOnBones(np.array([n]), np.array([[0.0, 10.0, 0.0]])), np.array([[*force, 0.0]]))
    found = EquilibriumProblem(torso, holds(held)).solve(load)

    def energy(q: Complexes) -> complex:
        x, y, angle = np.concatenate([[[0.0, 0.0, 0.0]], q.reshape(n, 3)]).T
        c, s = np.cos(angle), np.sin(angle)
        gap_x = (x[1:] + 0.5 * length * s[1:]) - (x[:-1] - 0.5 * length * s[:-1])
        gap_y = (y[1:] - 0.5 * length * c[1:]) - (y[:-1] + 0.5 * length * c[:-1])
        across, along = c[:-1] * gap_x + s[:-1] * gap_y, -s[:-1] * gap_x + c[:-1] * gap_y
        total = 0.5 * np.sum(shear * across**2 + axial * along**2 + turn * (angle[1:] - angle[:-1]) ** 2)
        return complex(total - force[0] * (x[-1] - 10.0 * s[-1]) - force[1] * (y[-1] + 10.0 * c[-1]))

    angles = log_so3(found.state.bone_rotations)[:, 2]
    rest = np.column_stack([places[1:, 0], places[1:, 1], np.zeros(n)]).ravel()
    every = list(range(3 * n))
    other = rest
    for share in (0.25, 0.5, 0.75, 1.0):
        # The load grows so that a plain root finder follows; the reference is the last step alone.
        other = so.root(
            lambda q, s=share: complex_step_gradient(lambda z: energy(z) + (1 - s) * _work(z, n, force), q, every),
            other,
            tol=1e-13,
        ).x
    wanted = other.reshape(n, 3)
    yield _solved(
        "B5 planar chain: places against another minimiser",
        found,
        found.state.bone_positions[1:, :2],
        wanted[:, :2],
        1e-9,
    )
    yield _solved("B5 planar chain: turns against another minimiser", found, angles[1:], wanted[:, 2], 1e-9)


def _work(q: Complexes, n: int, force: Floats) -> complex:
    x, y, angle = q.reshape(n, 3)[-1]
    return complex(force[0] * (x - 10.0 * np.sin(angle)) + force[1] * (y + 10.0 * np.cos(angle)))


def _elastica(load: float) -> tuple[float, float, float]:
    """End turn, end deflection / L and end height / L of a clamped inextensible rod under an end force P across it.

    ``load`` = P L^2 / E I. Elliptic integrals, e.g. Bisshopp and Drucker 1945.
    """

    def integrals(turn: float) -> tuple[float, float]:
        m = 0.5 * (1.0 + np.sin(turn))
        start = np.arcsin(1.0 / np.sqrt(2.0 * m))
        return ss.ellipk(m) - ss.ellipkinc(start, m), ss.ellipe(m) - ss.ellipeinc(start, m)

    root = np.sqrt(load)
    turn = so.brentq(lambda t: integrals(t)[0] - root, 1e-6, 0.5 * np.pi - 1e-9, xtol=1e-14)
    return float(turn), float(1.0 - 2.0 * integrals(turn)[1] / root), float(np.sqrt(2.0 * np.sin(turn)) / root)


def _chain_end(n: int, shift_stiffness: float, length: float, bending: float, force: float) -> Floats:
    """(3,) turn, deflection / L and height / L of the end of a chain of ``n`` joints; NaN if unsolved."""
    places = np.zeros((n + 1, 3))
    places[:, 1] = np.linspace(0.0, length, n + 1)
    stiffness = np.array([*[shift_stiffness] * 3, 1e6, 1e6, n * bending / length])
    torso = make_torso(places, [(i, i + 1) for i in range(n)], stiffness)
    held = np.zeros((n + 1, 6), dtype=bool)
    held[0] = True
    problem, state = EquilibriumProblem(torso, holds(held)), None
    for part in (0.25, 0.5, 0.75, 1.0):
        load = LoadCase(PointsOnBones(np.array([n]), np.zeros((1, 3))), np.array([[part * force, 0.0, 0.0]]))
        found = problem.solve(load, start=state, tolerance=1e-6)
        state = found.state
    if not found.converged:
        return np.full(3, np.nan)
    x, y, _ = found.state.bone_positions[-1] / length
    return np.array([-log_so3(found.state.bone_rotations[-1])[2], x, y])


def elastica() -> Iterator[Check]:
    """A chain of ever more joints, k = n E I / L each, becomes Euler's elastica: order 2, and the limit itself."""
    length, bending, share = 100.0, 1e5, 4.0
    force = share * bending / length**2
    ends = []
    for n in (8, 16, 32):
        # Joints give way to shifts as well: what is linear in that is extrapolated away.
        stiff, soft = (_chain_end(n, n / 32 * k, length, bending, force) for k in (1e5, 5e4))
        ends.append(2.0 * stiff - soft)
    coarse, middle, fine = ends
    exact = np.array(_elastica(share))
    orders = np.log2(np.abs((coarse - exact) / (middle - exact)))
    off = np.abs(orders - 2.0).max()
    yield judged("B5 elastica: order of a chain's error in the number of joints, less 2", off, 0.05)
    limit = fine + (fine - middle) / 3.0
    for name, value, wanted in zip(("end turn", "deflection", "height"), limit, exact):
        yield compared(f"B5 elastica: {name} of a chain of many joints (extrapolated)", value, wanted, 1e-5)


def buckling() -> Iterator[Check]:
    """A bone on a joint under a dead weight topples at k / L: it stands below and is not called stable above."""
    length, spring = 50.0, 4e3
    places = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    torso = make_torso(places, [(0, 1)], np.array([1e3, 1e3, 1e3, 1e6, 1e6, spring]))
    held = np.zeros((2, 6), dtype=bool)
    held[0] = True
    problem = EquilibriumProblem(torso, holds(held))
    critical = LoadCase(
        PointsOnBones(np.array([1]), np.array([[0.0, length, 0.0]])), np.array([[0.0, -spring / length, 0.0]])
    )

    def upright(found: Equilibrium) -> bool:
        return bool(np.abs(log_so3(found.state.bone_rotations[1])).max() < 1e-6)

    wrong = 0
    for share in (0.9, 0.999, 1.001, 1.1):
        weight = critical.scaled(share)
        found = problem.solve(weight)
        wrong += found.converged != (share < 1.0 or not upright(found))
        # Restarted at itself, a saddle balances from the first moment on; it is still none.
        wrong += problem.solve(weight, start=found.state).converged != found.converged
    yield counted("C2 buckling: a column stands below k / L and is unstable above", wrong, 4)
    below = critical.scaled(0.9)
    tangent, wrong = problem.linearise(problem.solve(below), below), 0
    for share in (0.99, 1.01, 1.1):
        # On the factor of a stable state the steps upright converge; what they lead to is looked at all the same.
        found = problem.solve(critical.scaled(share), start=tangent)
        wrong += found.converged != (share < 1.0 or not upright(found))
    yield counted("C2 buckling: so it is where a stable state's factor has served for the steps", wrong, 3)


def beams() -> Iterator[Check]:
    """A clamped beam (Poisson's ratio 0, so that clamps cost nothing): small end moment and force."""
    length, side, young = 100.0, 10.0, 2.0
    inertia, area = side**4 / 12.0, side**2
    positions, elements = box_mesh((2, 2, 10), (side, side, length), 10)
    owner = np.where(positions[:, 2] < 1e-9, 0, np.where(positions[:, 2] > length - 1e-9, 1, -1))
    ends = np.array([[5.0, 5.0, 0.0], [5.0, 5.0, length]])
    torso = make_torso(ends, [], np.zeros(6), (positions, elements), owner, young, 0.0)
    held = np.zeros((2, 6), dtype=bool)
    held[0] = True
    problem = EquilibriumProblem(torso, holds(held))
    rest = problem.solve(no_load())
    tangent = problem.linearise(rest, no_load())
    # Two forces on arms of one bone: at rest their derivative is a pure couple about x of 2 x 3 x 7 N mm.
    arms = np.array([[0.0, 0.0, 7.0], [0.0, 0.0, -7.0]])
    couple = LoadCase(PointsOnBones(np.array([1, 1]), arms), np.array([[0.0, 3.0, 0.0], [0.0, -3.0, 0.0]]))
    moment = -42.0
    bend = tangent.load_derivative(couple)
    yield compared(
        "B6 beam: end turn under an end moment, M L / E I", bend[9], moment * length / (young * inertia), 1e-9
    )
    tip = -moment * length**2 / (2.0 * young * inertia)
    yield compared("B6 beam: end deflection under an end moment, M L^2 / 2 E I", bend[7], tip, 1e-9)
    free = torso.tissue.free_nodes
    p = positions[free]
    wanted = (
        -moment
        / (young * inertia)
        * np.column_stack([np.zeros(len(p)), 0.5 * p[:, 2] ** 2, -(p[:, 1] - 5.0) * p[:, 2]])
    )
    yield compared("B6 beam: whole field under an end moment", bend[12:].reshape(-1, 3), wanted, 1e-9)
    pull = tangent.load_derivative(
        LoadCase(PointsOnBones(np.array([1]), np.zeros((1, 3))), np.array([[0.0, 0.0, 5.0]]))
    )
    yield compared("B6 beam: stretch under an end force, F L / E A", pull[8], 5.0 * length / (young * area), 1e-9)
    yield from _cantilevers()


def _cantilever(cells: tuple[int, int, int], nodes: int, length: float, side: float, young: float) -> float:
    """End deflection, mm/N, of a clamped beam (Poisson's ratio 0) whose end is a bone, from the tangent at rest."""
    positions, elements = box_mesh(cells, (side, side, length), nodes)
    owner = np.where(positions[:, 2] < 1e-9, 0, np.where(positions[:, 2] > length - 1e-9, 1, -1))
    middle = 0.5 * side
    ends = np.array([[middle, middle, 0.0], [middle, middle, length]])
    torso = make_torso(ends, [], np.zeros(6), (positions, elements), owner, young, 0.0)
    held = np.zeros((2, 6), dtype=bool)
    held[0] = True
    problem = EquilibriumProblem(torso, holds(held))
    tangent = problem.linearise(problem.solve(no_load()), no_load())
    pull = LoadCase(PointsOnBones(np.array([1]), np.zeros((1, 3))), np.array([[0.0, 1.0, 0.0]]))
    return float(tangent.load_derivative(pull)[7])


def _cantilevers() -> Iterator[Check]:
    """End force, against Timoshenko's beam: ten-node elements as they are, four-node ones, which lock, extrapolated."""
    length, side, young = 50.0, 10.0, 2.0
    inertia, area, shear = side**4 / 12.0, side**2, young / 2.0
    timoshenko = length**3 / (3.0 * young * inertia) + length / (5.0 / 6.0 * shear * area)
    found = _cantilever((2, 2, 10), 10, length, side, young)
    yield compared("B6 beam: end force, ten nodes, against Timoshenko", found, timoshenko, 0.01)
    # Locking adds stiffness in proportion to the square of the element size.
    coarse, middle, fine = (1.0 / _cantilever((n, n, 5 * n), 4, length, side, young) for n in (2, 4, 8))
    order = np.log2((coarse - middle) / (middle - fine))
    limit, locked = fine + (fine - middle) / 3.0, 100.0 * (fine * timoshenko - 1.0)
    yield judged("B6 beam: end force, four nodes, order of the excess stiffness less 2", abs(order - 2.0), 0.15)
    name = f"B6 beam: end force, four nodes ({locked:.0f} % too stiff on the finest mesh), extrapolated"
    yield compared(name, limit, 1.0 / timoshenko, 0.02)


def push_reactions() -> Iterator[Check]:
    """Eqs. 1-2: the numbers, and that the three forces balance in force and moment."""
    f1, f2 = three_point_reactions(76.7, 400.0, 220.0)
    yield compared("B8 three-point reactions: 76.7 N, d21 = 0.40 m, d31 = 0.22 m", [f1, f2], [34.515, 42.185], 1e-12)
    yield compared("B8 three-point reactions: moment about the shoulder", f2 * 400.0, 76.7 * 220.0, 1e-12)
    wrong = 0
    for d21, d31 in ((400.0, 500.0), (400.0, -1.0), (-400.0, 100.0), (400.0, 0.0), (400.0, np.nan)):
        try:
            three_point_reactions(76.7, d21, d31)
        except ValueError:
            wrong += 1
        except Exception as error:
            wrong += type(error).__name__ != "TorsoError"
        else:
            wrong += 1
    yield counted("B8 three-point reactions: impossible distances refused", wrong, 5)


GROUPS = (
    material_points,
    element_energy,
    patch,
    rigid_patch,
    uniaxial,
    hybrid,
    chains,
    buckling,
    joint_axes_turned,
    planar_chain,
    elastica,
    beams,
    push_reactions,
)
