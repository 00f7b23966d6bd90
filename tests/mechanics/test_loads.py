"""spinestiff.mechanics.loads: dead forces and the three-point push."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import retract
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import TorsoError
from spinestiff.mechanics.assembly import Stiffness
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import LoadCase, no_load, rib_push, three_point_reactions, tissue_load
from spinestiff.mechanics.potential import Potential
from spinestiff.verification.energies import bent, dense, two_bones
from spinestiff.verification.equilibria import tissue_pressure, toy_supports
from spinestiff.verification.models import shaken, toy_torso


@pytest.fixture(scope="module")
def torso():
    return template_torso(157.0, "coarse")


@pytest.mark.parametrize(("force", "d21", "d31"), [(76.7, 400.0, 220.0), (31.0, 380.0, 90.0), (114.0, 455.0, 430.0)])
def test_eq1_eq2_three_point_reactions_balance_in_force_and_moment(force, d21, d31):
    f1, f2 = three_point_reactions(force, d21, d31)
    assert f1 + f2 == pytest.approx(force, rel=1e-14)
    # About the shoulder, about the ribs and about the pelvis.
    assert f2 * d21 == pytest.approx(force * d31, rel=1e-14)
    assert f1 * d31 == pytest.approx(f2 * (d21 - d31), rel=1e-13)
    assert f1 * d21 == pytest.approx(force * (d21 - d31), rel=1e-13)


def test_eq1_eq2_numbers():
    assert three_point_reactions(76.7, 400.0, 220.0) == pytest.approx((34.515, 42.185), rel=1e-14)


@pytest.mark.parametrize(
    ("d21", "d31"), [(400.0, 500.0), (400.0, 400.0), (400.0, 0.0), (400.0, -5.0), (-4.0, -2.0), (400.0, np.nan)]
)
def test_eq1_eq2_refuse_ribs_that_are_not_between_shoulder_and_pelvis(d21, d31):
    with pytest.raises(TorsoError, match="between shoulder and pelvis"):
        three_point_reactions(50.0, d21, d31)


@pytest.mark.parametrize(("side", "sign"), [("right", 1.0), ("left", -1.0)])
def test_push_points_to_the_other_side(torso, side, sign):
    push = rib_push(torso, side, 7.25, 60.0)
    assert push.forces.sum(0) == pytest.approx([sign * 60.0, 0.0, 0.0])
    assert push.size == pytest.approx(60.0)
    # It presses on the outer side: from the left at positive x.
    assert (np.sign(push.points.positions(torso.rest_pose)[:, 0]) == -sign).all()


def test_lever_rule_puts_the_push_at_its_level(torso):
    push = rib_push(torso, "right", 7.25, 60.0)
    names = [torso.bone_names[b] for b in push.points.bone]
    assert names == ["R7_R", "R8_R"]
    assert push.forces[:, 0] == pytest.approx([45.0, 15.0])
    assert rib_push(torso, "right", 12.0, 60.0).forces[:, 0] == pytest.approx([0.0, 60.0])
    assert rib_push(torso, "right", 1.0, 60.0).forces[:, 0] == pytest.approx([60.0, 0.0])


def test_anterior_moves_the_points_forward(torso):
    back, front = (
        rib_push(torso, "left", 6.0, 40.0, anterior_mm=a).points.positions(torso.rest_pose) for a in (0.0, 12.0)
    )
    assert front - back == pytest.approx(np.tile([0.0, 0.0, 12.0], (2, 1)))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("middle", 7.0, 10.0), "push side 'middle'"),
        (("left", 0.5, 10.0), "push level 0.5"),
        (("left", 12.5, 10.0), "push level 12.5"),
        (("left", np.nan, 10.0), "push level nan"),
        (("left", 7.0, -10.0), "push force -10"),
        (("left", 7.0, np.nan), "push force nan"),
    ],
)
def test_bad_pushes_are_refused(torso, arguments, message):
    with pytest.raises(TorsoError, match=message):
        rib_push(torso, *arguments)


def test_energy_is_minus_the_work_and_a_scaled_load_scales_it():
    torso = two_bones(np.zeros(6))
    load = LoadCase(PointsOnBones(np.array([1]), np.array([[2.0, 1.0, 0.0]])), np.array([[3.0, -4.0, 0.0]]))
    before, after = torso.rest_pose, bent(torso, 0.5)
    way = (load.points.positions(after) - load.points.positions(before))[0]
    assert load.energy(before) - load.energy(after) == pytest.approx(3.0 * way[0] - 4.0 * way[1])
    assert load.scaled(0.25).size == pytest.approx(1.25)
    assert load.scaled(0.25).energy(after) == pytest.approx(0.25 * load.energy(after))


def test_no_load_is_empty_and_wrong_shapes_are_refused():
    assert no_load().size == 0.0
    assert len(no_load().points) == 0
    with pytest.raises(TorsoError, match="forces has shape"):
        LoadCase(PointsOnBones(np.array([0]), np.zeros((1, 3))), np.zeros((2, 3)))
    with pytest.raises(TorsoError, match="not finite"):
        LoadCase(PointsOnBones(np.array([0]), np.zeros((1, 3))), np.array([[np.inf, 0.0, 0.0]]))


def test_forces_on_tissue_nodes_act_on_free_nodes_and_on_the_bones_of_tied_ones():
    body = toy_torso(1, 10)
    mesh = body.tissue
    nodes = np.array([np.flatnonzero(mesh.bone_of_node < 0)[7], np.flatnonzero(mesh.bone_of_node >= 0)[3]])
    forces = np.array([[1.0, 2.0, -3.0], [0.0, -4.0, 0.0]])
    load = tissue_load(body, nodes, forces, "pressed")
    assert load.points.bone.tolist() == [mesh.bone_of_node[nodes[1]]]
    assert load.nodes.tolist() == [7]
    assert load.size == pytest.approx(np.sqrt(14.0) + 4.0)
    state = shaken(body, 2)
    places = body.node_positions(state)[nodes]
    assert load.energy(state) == pytest.approx(-np.sum(forces * places))
    assert load.total == pytest.approx(forces.sum(0))
    assert load.moment(state) == pytest.approx(np.cross(places, forces).sum(0))
    assert load.scaled(2.0).node_forces == pytest.approx(2.0 * forces[:1])


def test_the_derivatives_of_a_load_on_tissue_nodes_agree_with_differences():
    body = toy_torso(1, 10)
    load = tissue_pressure(body, 2.0)
    potential, state = Potential(body), shaken(body, 3)
    none = Stiffness(*(np.zeros_like(values) for values in potential.stiffness(None)))
    direction = np.random.default_rng(4).normal(size=potential.dofs)
    direction[: 6 * potential.bones].reshape(-1, 6)[:, 3:] *= 0.03
    h = 1e-3
    up, mid, down = (load.energy(retract(state, s * direction)) for s in (h, 0.0, -h))
    slope = potential.gradient(state, none, [load]) @ direction
    assert slope == pytest.approx((up - down) / (2 * h), rel=1e-7)
    hessian = dense(potential, potential.hessian(state, none, [load]))
    assert direction @ hessian @ direction == pytest.approx((up - 2 * mid + down) / h**2, rel=1e-4)


def test_the_equilibrium_follows_a_load_on_tissue_nodes():
    """Balance of forces, and the derivative in the load against differences of solves."""
    body = toy_torso(1, 10)
    load = tissue_pressure(body, 0.3)
    problem = EquilibriumProblem(body, toy_supports(body))
    found, tangent = problem.solve_linearised(load)
    assert load.total + sum(r.force for r in found.reactions) == pytest.approx(np.zeros(3), abs=1e-8 * load.size)
    slope = problem.potential.unknowns.node_rows(tangent.load_derivative(load))
    h = 1e-3
    up, down = (problem.solve(load.scaled(1.0 + s * h), tolerance=1e-9).require().state for s in (1, -1))
    difference = (up.tissue_positions - down.tissue_positions) / (2 * h)
    assert np.abs(slope - difference).max() < 1e-5 * np.abs(slope).max()


@pytest.mark.parametrize("node", [-1, 10**6])
def test_a_load_on_a_node_that_the_mesh_lacks_is_refused(torso, node):
    with pytest.raises(TorsoError, match=f"a load acts on tissue node {node}; the mesh has nodes 0 to"):
        tissue_load(torso, np.array([node]), np.zeros((1, 3)))
