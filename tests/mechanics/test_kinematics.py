"""spinestiff.mechanics.kinematics: relative coordinates and the factor that goes on serving in them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.rotation import exp_so3, log_so3
from spinestiff.anatomy.state import TorsoState, retract
from spinestiff.anatomy.template import template_torso
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.joints import joint_pose
from spinestiff.mechanics.kinematics import Kinematics, _polar
from spinestiff.mechanics.quasi_newton import FrameFactor
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.verification.equilibria import toy_load, toy_supports
from spinestiff.verification.models import shaken, toy_torso


@pytest.fixture(scope="module")
def torso():
    return toy_torso(1, 10)


@pytest.fixture(scope="module")
def kinematics(torso):
    return Kinematics(torso, toy_supports(torso))


@pytest.fixture(scope="module")
def frame(torso, kinematics):
    return kinematics.at(shaken(torso, 3, turn=0.2, move=1.0))


def _vectors(frame, kinematics, count):
    """World steps that leave held degrees of freedom alone."""
    held = np.zeros(frame.state.dofs, dtype=bool)
    held[: kinematics.held.size] = kinematics.held.ravel()
    found = np.random.default_rng(4).normal(size=(count, frame.state.dofs))
    found[:, held] = 0.0
    return found


def test_inverse_and_transposes_belong_together(frame, kinematics):
    dx, force = _vectors(frame, kinematics, 2)
    y = frame.from_world(dx)
    assert frame.to_world(y) == pytest.approx(dx, abs=1e-12)
    assert y @ frame.pull(force) == pytest.approx(dx @ force, rel=1e-12)
    assert frame.push(frame.pull(force)) == pytest.approx(force, abs=1e-9)


def test_a_finite_step_is_the_linear_one_to_first_order(frame, kinematics):
    (dx,) = _vectors(frame, kinematics, 1)
    y, before = frame.from_world(dx), frame.state

    def error(h):
        moved, straight = frame.move(h * y), retract(before, h * dx)
        return max(
            np.abs(moved.bone_positions - straight.bone_positions).max(),
            np.abs(moved.tissue_positions - straight.tissue_positions).max(),
            30.0 * np.abs(log_so3(np.swapaxes(straight.bone_rotations, 1, 2) @ moved.bone_rotations)).max(),
        )

    assert error(1e-3) < 1e-3
    assert error(1e-3) / error(5e-4) == pytest.approx(4.0, rel=0.05)


def test_strains_of_the_tree_change_linearly_in_steps_of_any_size(torso, kinematics, frame):
    """The point of the coordinates: a stiff joint is not pulled apart by a large turn."""
    joint = np.array(
        [
            next(
                (
                    j
                    for j in range(len(torso.joints))
                    if {int(torso.joints.parent[j]), int(torso.joints.child[j])} == {b, int(kinematics.parent[b])}
                ),
                -1,
            )
            for b in range(len(torso.bone_names))
        ]
    )
    tied = joint[kinematics.parent >= 0]
    assert len(tied) > 0
    (dx,) = _vectors(frame, kinematics, 1)
    y = frame.from_world(dx)
    turned = y[: 6 * len(torso.bone_names)].reshape(-1, 6)
    turned[:, :3], turned[:, 3:] = 0.0, 0.6 * turned[:, 3:]
    before = joint_pose(torso.joints, frame.state).translation[tied]
    after = joint_pose(torso.joints, frame.move(y)).translation[tied]
    assert np.abs(turned[:, 3:]).max() > 0.5
    assert after == pytest.approx(before, abs=1e-10)
    straight = joint_pose(torso.joints, retract(frame.state, frame.to_world(y))).translation[tied]
    assert np.abs(straight - before).max() > 1.0


def test_tissue_is_carried_along_by_bones_that_turn_as_one(torso):
    supports = replace(toy_supports(torso, spring=False), held=np.zeros((3, 6), dtype=bool))
    frame = Kinematics(torso, supports).at(torso.rest_pose)
    w, centre = np.array([0.3, -0.5, 0.4]), np.array([10.0, 20.0, -5.0])
    rest, dofs = torso.rest_pose, torso.rest_pose.dofs
    rows = np.hstack([np.cross(w, rest.bone_positions - centre), np.tile(w, (3, 1))])
    dx = np.concatenate([rows.ravel(), np.cross(w, rest.tissue_positions - centre).ravel()])
    y = frame.from_world(dx)
    assert np.abs(y[18:]).max() < 1e-6  # nothing of their own is left for the nodes to move
    assert dofs == len(y)
    moved = frame.move(y)
    # The root goes straight, everything else turns with it.
    turn = exp_so3(w)
    root = int(np.flatnonzero(Kinematics(torso, supports).parent < 0)[0])
    shift = moved.bone_positions[root] - turn @ rest.bone_positions[root]
    assert moved.bone_positions == pytest.approx(rest.bone_positions @ turn.T + shift, abs=1e-9)
    assert moved.tissue_positions == pytest.approx(rest.tissue_positions @ turn.T + shift, abs=1e-6)


def test_held_degrees_of_freedom_do_not_move(torso, kinematics, frame):
    y = np.random.default_rng(0).normal(size=frame.state.dofs) * 0.1
    moved = frame.move(y)
    assert kinematics.held.any()
    assert np.abs(frame.to_world(y)[: kinematics.held.size][kinematics.held.ravel()]).max() == 0.0
    bone = int(np.flatnonzero(kinematics.held.all(axis=1))[0])
    assert (moved.bone_positions[bone] == frame.state.bone_positions[bone]).all()
    assert moved.bone_rotations[bone] == pytest.approx(frame.state.bone_rotations[bone], abs=1e-15)


def test_the_shoulder_girdle_hangs_on_its_support_and_the_ribs_on_the_spine():
    torso = template_torso(157.0, "coarse")
    kinematics = Kinematics(torso, three_point_supports(torso, "left"))
    parent = {
        name: torso.bone_names[p] if p >= 0 else None for name, p in zip(torso.bone_names, kinematics.parent.tolist())
    }
    assert [name for name, above in parent.items() if above is None] == ["pelvis", "humerus_R"]
    assert parent["sternum"] == "clavicle_R"
    assert parent["R7_L"] == "T7"
    assert parent["T12"] == "L1"
    assert kinematics.weights.sum(axis=1) == pytest.approx(1.0, abs=1e-6)
    assert kinematics.weights.min() > -1e-9
    places = {int(b): i for i, b in enumerate(kinematics.order)}
    assert all(places[int(p)] < places[b] for b, p in enumerate(kinematics.parent) if p >= 0)


def test_polar_rotations_are_the_nearest_and_the_identity_where_there_is_none():
    random = np.random.default_rng(1)
    near = exp_so3(random.normal(size=(5, 3))) + 0.1 * random.normal(size=(5, 3, 3))
    u, _, vt = np.linalg.svd(near)
    assert _polar(near.copy()) == pytest.approx(u @ vt, abs=1e-9)
    assert _polar(np.zeros((1, 3, 3)))[0] == pytest.approx(np.eye(3))


def test_a_factor_learns_what_its_steps_have_brought(torso):
    problem = EquilibriumProblem(torso, toy_supports(torso))
    stiffness, terms = problem.potential.stiffness(None), problem.all_terms(toy_load())
    frame = problem.kinematics.at(torso.rest_pose)
    factor = FrameFactor(frame, problem.factorise(torso.rest_pose, stiffness, terms), problem.held)
    step, change = (frame.from_world(v) for v in _vectors(frame, problem.kinematics, 2))
    change = change if step @ change > 0 else -change
    gradient = frame.pull(_vectors(frame, problem.kinematics, 3)[2])
    assert factor.solve(gradient) == pytest.approx(factor.apply(gradient))
    factor.learn(step, -change)  # negative curvature is left aside
    assert factor.solve(gradient) == pytest.approx(factor.apply(gradient))
    factor.learn(step, change)
    assert factor.solve(change) == pytest.approx(step, rel=1e-9, abs=1e-9)  # the secant condition
    assert np.abs(factor.solve(gradient) - factor.apply(gradient)).max() > 1e-6


def test_a_state_without_tissue_has_frames_too(torso):
    bare = replace(
        torso,
        tissue=replace(
            torso.tissue,
            elements=np.zeros((0, 10), dtype=int),
            rest_positions=np.zeros((0, 3)),
            bone_of_node=np.zeros(0, dtype=int),
            lame_mu=np.zeros(0),
            lame_lambda=np.zeros(0),
        ),
        rest_pose=TorsoState(torso.rest_pose.bone_positions, torso.rest_pose.bone_rotations, np.zeros((0, 3))),
    )
    frame = Kinematics(bare, toy_supports(bare)).at(bare.rest_pose)
    dx = _vectors(frame, frame._k, 1)[0]
    assert frame.to_world(frame.from_world(dx)) == pytest.approx(dx, abs=1e-12)
