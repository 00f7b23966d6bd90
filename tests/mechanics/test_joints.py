"""spinestiff.mechanics.joints: the six-DoF compliant joint."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.anatomy.rotation import exp_so3, log_so3, mean_rotation
from spinestiff.anatomy.state import retract
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.joints import (
    joint_energies,
    joint_gradients,
    joint_hessians,
    joint_pose,
    left_jacobian_inverse,
)
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.verification.energies import JOINT_ANGLES, bent, two_bones

STIFFNESS = np.array([26.0, 170.0, 31.0, 15e3, 13e3, 11e3])


def test_rest_pose_has_no_strain_no_energy_and_no_force():
    torso = two_bones(STIFFNESS)
    pose = joint_pose(torso.joints, torso.rest_pose)
    assert np.abs(pose.translation).max() < 1e-13
    assert np.abs(pose.rotation).max() < 1e-15
    assert joint_energies(torso.joints, torso.rest_pose, torso.joints.stiffness)[0] < 1e-24
    assert np.abs(joint_gradients(torso.joints, torso.rest_pose, torso.joints.stiffness)).max() < 1e-9


@pytest.mark.parametrize("angle", JOINT_ANGLES)
def test_rotation_strain_is_the_angle_turned(angle):
    torso = two_bones(STIFFNESS)
    pose = joint_pose(torso.joints, bent(torso, angle))
    assert np.linalg.norm(pose.rotation[0]) == pytest.approx(angle, rel=1e-12, abs=1e-15)


def test_rotation_vector_reads_the_same_from_parent_child_and_midway():
    torso = two_bones(STIFFNESS)
    state = bent(torso, 0.8)
    pose = joint_pose(torso.joints, state)
    child = (state.bone_rotations[1] @ torso.joints.child_axes[0])[None]
    world = log_so3(child @ np.swapaxes(pose.axes, 1, 2))[0]
    for axes in (pose.axes, child, mean_rotation(pose.axes, child)):
        assert axes[0].T @ world == pytest.approx(pose.rotation[0], abs=1e-13)


@pytest.mark.parametrize("angle", JOINT_ANGLES)
def test_hessian_is_the_derivative_of_the_gradient(angle):
    torso = two_bones(STIFFNESS)
    state, k = bent(torso, angle), torso.joints.stiffness
    hessian = joint_hessians(torso.joints, state, k)[0]
    assert np.abs(hessian - hessian.T).max() < 1e-14 * np.abs(hessian).max()
    # Second differences of the energy in two directions at once need no gradient at all.
    random = np.random.default_rng(1)
    a, b = (random.normal(size=12) * np.tile([1, 1, 1, 0.03, 0.03, 0.03], 2) for _ in range(2))

    def energy(s, t):
        return joint_energies(torso.joints, retract(state, s * a + t * b), k)[0]

    h = 2e-3
    mixed = (energy(h, h) - energy(h, -h) - energy(-h, h) + energy(-h, -h)) / (4 * h * h)
    assert a @ hessian @ b == pytest.approx(mixed, rel=1e-4, abs=1e-4 * np.abs(a @ hessian @ a))


def test_gradient_is_linear_in_stiffness():
    torso = two_bones(STIFFNESS)
    state = bent(torso, 0.9)
    whole = joint_gradients(torso.joints, state, torso.joints.stiffness)
    parts = [
        joint_gradients(torso.joints, state, np.where(np.arange(6) == i, torso.joints.stiffness, 0.0)) for i in range(6)
    ]
    assert np.sum(parts, axis=0) == pytest.approx(whole, rel=1e-13)
    assert all(np.abs(part).max() > 1.0 for part in parts)


def test_left_jacobian_inverse_on_both_sides_of_its_switch():
    axis = np.array([0.48, -0.6, 0.64])
    below, above = (left_jacobian_inverse(p * axis[None])[0] for p in (0.5 - 1e-12, 0.5 + 1e-12))
    assert above == pytest.approx(below, abs=1e-11)
    # d log(exp(e) exp(theta)) / de by a central difference.
    theta, e, h = 1.3 * axis, np.array([0.3, -0.5, 0.2]), 1e-5
    slope = (log_so3(exp_so3(h * e) @ exp_so3(theta)) - log_so3(exp_so3(-h * e) @ exp_so3(theta))) / (2 * h)
    assert left_jacobian_inverse(theta[None])[0] @ e == pytest.approx(slope, abs=1e-9)


def test_translation_axes_midway_instead_of_on_the_parent_change_little():
    """The choice that the module's docstring names, measured on the whole torso under the largest push of the study."""
    torso = template_torso(157.0, "coarse")
    ratios = stiffness_ratios({"lateral_bending": 0.02, "tissue": 0.02})
    problem = EquilibriumProblem(torso, three_point_supports(torso, "right"))
    state = problem.solve(rib_push(torso, "right", 7.25, 76.7), ratios).require().state
    k = problem.potential.stiffness(ratios).joints
    pose = joint_pose(torso.joints, state)
    child = state.bone_rotations[torso.joints.child] @ torso.joints.child_axes
    world = np.einsum("jab,jb->ja", pose.axes, pose.translation)
    midway = np.einsum("jba,jb->ja", mean_rotation(pose.axes, child), world)
    parent_energy, mid_energy = (0.5 * np.sum(k[:, :3] * d**2, axis=1) for d in (pose.translation, midway))
    spine = np.isin(torso.joints.kinds, ("thoracic", "lumbar"))
    whole = joint_energies(torso.joints, state, k)
    # Measured: 0.09 of 88.6 N mm in the spine's joints (0.1 %), 0.6 of 248 N mm in all; turns up to 10.8 degrees.
    assert np.degrees(np.linalg.norm(pose.rotation, axis=1).max()) > 2.0
    assert 0.0 < abs(np.sum((mid_energy - parent_energy)[spine])) < 2e-3 * whole[spine].sum()
    assert 0.0 < abs(np.sum(mid_energy - parent_energy)) < 5e-3 * whole.sum()
