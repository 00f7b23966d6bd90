"""spinestiff.mechanics.diagnosis: the bone, joint, node or element that is named is the one at fault."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.mechanics.diagnosis import (
    at_fault,
    largest_joint_motion,
    largest_residual,
    softest_motion,
    worst_element,
)
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import LoadCase, no_load, rib_push
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.verification.blocks import holds
from spinestiff.verification.energies import dense
from spinestiff.verification.models import box_mesh, make_torso, shaken, toy_torso


@pytest.fixture(scope="module")
def torso():
    return template_torso(157.0, "coarse")


@pytest.mark.parametrize(
    ("bone", "component", "text"),
    [("R8_L", 1, "force of 2.0e+00 N on R8_L"), ("T4", 5, "moment of 9.0e+01 N mm on T4")],
)
def test_the_bone_with_the_largest_residual_is_named(torso, bone, component, text):
    gradient = np.zeros(torso.rest_pose.dofs)
    gradient[6 * torso.bone("L3")] = -1.9
    gradient[6 * torso.bone("L4") + 4] = 56.0
    gradient[-1] = 1.9
    gradient[6 * torso.bone(bone) + component] = {1: -2.0, 5: 90.0}[component]
    assert largest_residual(torso, torso.rest_pose, gradient) == text


def test_a_node_is_named_by_number_place_and_the_nearest_bone(torso):
    gradient = np.zeros(torso.rest_pose.dofs)
    chosen = 7
    gradient[6 * len(torso.bone_names) + 3 * chosen + 2] = -0.5
    gradient[0] = 0.4
    node = torso.tissue.free_nodes[chosen]
    vertices = [torso.surface_positions(torso.rest_pose, b) for b in range(len(torso.bone_names))]
    gaps = [np.linalg.norm(v - torso.tissue.rest_positions[node], axis=1).min() for v in vertices]
    text = largest_residual(torso, torso.rest_pose, gradient)
    assert text.startswith(f"force of 5.0e-01 N on tissue node {node} at (")
    assert text.endswith(f"near {torso.bone_names[int(np.argmin(gaps))]}")


def flattened_cube():
    """Two cubes of tissue side by side along y, the first on a bone; free nodes of the second to be squeezed."""
    mesh = box_mesh((1, 2, 1), (10.0, 20.0, 10.0), 4)
    owner = np.where(mesh[0][:, 1] < 1.0, 0, -1)
    return make_torso(np.zeros((2, 3)) + [[0.0, 0, 0], [0, 30.0, 0]], [], np.zeros(6), mesh, owner)


def test_the_element_with_the_smallest_volume_ratio_is_named_with_its_bone_or_the_nearest():
    torso = flattened_cube()
    nodes = torso.tissue.rest_positions[torso.tissue.free_nodes]
    squeezed = np.where(nodes[:, 1:2] > 15.0, nodes * [1.0, 0.0, 1.0] + [0.0, 12.0, 0.0], nodes)
    text = worst_element(torso, replace(torso.rest_pose, tissue_positions=squeezed))
    number = int(text.split("element ")[1].split()[0])
    assert text.startswith("J = 0.2 in tissue element")
    assert (torso.tissue.bone_of_node[torso.tissue.elements[number]] < 0).all()
    assert text.endswith("near bone0")
    lifted = replace(torso.rest_pose, tissue_positions=nodes - [0.0, 7.0, 0.0])
    text = worst_element(torso, lifted)
    assert text.startswith("J = 0.3 in tissue element")
    assert text.endswith("tied to bone0")


def test_volume_ratios_are_those_of_the_potential():
    torso = toy_torso(3)
    state = shaken(torso, 1)
    smallest = EquilibriumProblem(torso, holds(np.ones((3, 6), dtype=bool))).potential
    _, j = smallest.energy(state, smallest.stiffness(None), ())
    assert worst_element(torso, state).startswith(f"J = {j:.2g} in")


def test_an_inverted_element_is_found():
    torso = flattened_cube()
    nodes = torso.tissue.rest_positions[torso.tissue.free_nodes]
    assert worst_element(torso, replace(torso.rest_pose, tissue_positions=nodes - [0.0, 12.0, 0.0])).startswith(
        "J = -0.2"
    )


def test_the_joint_that_has_turned_most_is_named_with_degrees_and_axis(torso):
    rotations = np.array(torso.rest_pose.bone_rotations)
    for name, degrees in (("humerus_L", 20.0), ("R12_R", 25.0)):
        rotations[torso.bone(name)] = exp_so3(np.radians([0.0, 0.0, degrees])) @ rotations[torso.bone(name)]
    text = largest_joint_motion(torso, replace(torso.rest_pose, bone_rotations=rotations))
    assert text.startswith("joint T12-R12_R has turned 25.0 deg, most of it about")
    joint = torso.joints.names.index("pelvis-L5")
    axis = (torso.rest_pose.bone_rotations[torso.joints.parent[joint]] @ torso.joints.parent_axes[joint])[:, 1]
    above = [i for i, name in enumerate(torso.bone_names) if name != "pelvis"]
    rotations = np.array(torso.rest_pose.bone_rotations)
    rotations[above] = exp_so3(0.5 * axis) @ rotations[above]
    text = largest_joint_motion(torso, replace(torso.rest_pose, bone_rotations=rotations))
    assert text == "joint pelvis-L5 has turned 28.6 deg, most of it about beta (axial rotation)"


@pytest.mark.parametrize(("weight", "sign"), [(60.0, 1.0), (81.0, -1.0), (16e3, -1.0)])
def test_the_softest_motion_of_a_column_is_its_fall_to_the_side(weight, sign):
    """A weight 50 mm above a joint of 4 N m/rad about z: above k / L = 80 N it falls.

    At 16 kN the turn about x has the eigenvalue nearest to zero, (1e6 - 8e5) / 900; the lowest is still that about z.
    """
    stiffness = np.array([[1e3, 1e3, 1e3, 1e6, 1e6, 9e4], [1e3, 1e3, 1e3, 1e6, 1e6, 4e3]])
    torso = make_torso(np.array([[0.0, 0, 0], [0, 10.0, 0], [0, 10.0, 0]]), [(0, 1), (1, 2)], stiffness)
    held = np.zeros((3, 6), dtype=bool)
    held[:2] = True
    load = LoadCase(PointsOnBones(np.array([2]), np.array([[0.0, 50.0, 0.0]])), np.array([[0.0, -weight, 0.0]]))
    problem = EquilibriumProblem(torso, holds(held))
    values = problem.potential.hessian(torso.rest_pose, problem.potential.stiffness(None), problem.all_terms(load))
    text = softest_motion(problem, values)
    stiffness_there = (4e3 - 50.0 * weight) / 30.0**2
    assert float(text.split()[1]) == pytest.approx(stiffness_there, rel=0.05)
    assert np.sign(stiffness_there) == sign
    assert text.endswith("in which bone2 turns most, along (0.00, 0.00, 1.00)")


def test_the_softest_motion_agrees_with_the_whole_spectrum():
    torso = toy_torso(2)
    held = np.zeros((3, 6), dtype=bool)
    held[2] = True
    problem = EquilibriumProblem(torso, holds(held))
    values = problem.potential.hessian(torso.rest_pose, problem.potential.stiffness(None), ())
    scale = np.ones(problem.potential.dofs)
    scale[:18].reshape(3, 6)[:, 3:] = 30.0
    free = np.setdiff1d(np.arange(problem.potential.dofs), problem.held)
    matrix = dense(problem.potential, values) / scale / scale[:, None]
    lowest = np.linalg.eigvalsh(matrix[np.ix_(free, free)])[0]
    assert softest_motion(problem, values).startswith(f"stiffness {lowest:.1e} N/mm in the motion")


def test_the_softest_motion_of_the_torso_at_rest_is_stiff(torso):
    problem = EquilibriumProblem(torso, three_point_supports(torso, "right"))
    values = problem.potential.hessian(torso.rest_pose, problem.potential.stiffness(None), problem.all_terms(no_load()))
    assert float(softest_motion(problem, values).split()[1]) > 0.0


def test_a_failed_solve_of_the_torso_is_told_in_one_line(torso):
    """Stopped after two iterations: what is named lies where the push acts and the torso gives way."""
    problem = EquilibriumProblem(torso, three_point_supports(torso, "right"))
    load, ratios = rib_push(torso, "right", 8.0, 60.0), stiffness_ratios({"lateral_bending": 0.05, "tissue": 0.01})
    short = problem.solve(load, ratios, max_iterations=2)
    assert not short.converged
    stiffness = problem.potential.stiffness(ratios)
    gradient = problem.free(problem.potential.gradient(short.state, stiffness, problem.all_terms(load)))
    residual, element, joint = at_fault(torso, short.state, gradient).split("; ")
    assert float(residual.split(" of ")[1].split()[0]) == pytest.approx(
        short.residual_norm * (30.0 if "moment" in residual else 1.0), rel=0.05
    )
    assert element.startswith(f"J = {short.smallest_j:.2g} in")
    assert joint.startswith("joint ")
