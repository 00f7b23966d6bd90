"""spinestiff.study.support_notes: supports that would have to pull, and a pelvis that turned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.template import template_torso
from spinestiff.mechanics.supports import SupportKind, three_point_supports
from spinestiff.study.support_notes import strongest_notes, support_notes


@pytest.fixture(scope="module")
def torso():
    return template_torso(157.0, "coarse")


def notes(torso, side="right", shoulder=0.0, wall=(), pelvis_deg=0.0):
    """With a sideways force at the shoulder, N, forces at the wall's first points, and the pelvis turned."""
    supports, rest, pelvis = three_point_supports(torso, side), torso.rest_pose, torso.bone("pelvis")
    rotations = rest.bone_rotations.copy()
    rotations[pelvis] = exp_so3(np.array([0.0, 0.0, np.radians(pelvis_deg)])) @ rotations[pelvis]
    forces = np.zeros((len(supports.names), 3))
    forces[supports.of_kind(SupportKind.SHOULDER), 0] = shoulder
    forces[np.flatnonzero(supports.of_kind(SupportKind.WALL))[: len(wall)], 2] = wall
    return support_notes(torso, supports, replace(rest, bone_rotations=rotations), forces, side), supports


@pytest.mark.parametrize(("side", "push"), [("right", 1.0), ("left", -1.0)])
def test_a_shoulder_that_pulls_is_told(torso, side, push):
    """A push to +x is borne by a shoulder that pushes to -x; the wall behind can only push forward."""
    assert notes(torso, side, -10.0 * push, (4.0,))[0] == {}
    assert notes(torso, side, 3.0 * push)[0] == {"shoulder": "the shoulder's support pulls with 3.0 N"}
    assert notes(torso, side, 1.9 * push)[0] == {}


def test_a_wall_that_pulls_is_told_with_the_bone_where_it_pulls_most(torso):
    told, supports = notes(torso, wall=(-2.5, -7.0, -1.0))
    bone = supports.names[np.flatnonzero(supports.of_kind(SupportKind.WALL))[1]]
    assert told["wall"].startswith(f"the back wall pulls at 2 points (most at {bone}, 7.0 N)")
    assert notes(torso, wall=(-2.5,))[0]["wall"].startswith("the back wall pulls at 1 point (most at ")


def test_a_pelvis_that_turns_is_told(torso):
    assert notes(torso, pelvis_deg=-4.0)[0] == {"pelvis": "the pelvis tilts by -4.0 degrees (limit 3)"}
    assert notes(torso, pelvis_deg=2.0)[0] == {}


def test_one_line_a_push_and_support():
    """From the frame of the largest force, wherever it stands; another push has lines of its own."""
    frames = [
        ("main", 2, 20.0, {"wall": "pulls with 3 N"}),
        ("main", 4, 60.0, {"wall": "pulls with 9 N", "pelvis": "tilts by 5 degrees"}),
        ("main", 3, 40.0, {"wall": "pulls with 6 N"}),
        ("low", 1, 20.0, {}),
        ("high", 1, 30.0, {"shoulder": "pulls with 4 N"}),
    ]
    assert strongest_notes(frames) == [
        "push 'main' frame 4 and 2 other frames: pulls with 9 N",
        "push 'main' frame 4: tilts by 5 degrees",
        "push 'high' frame 1: pulls with 4 N",
    ]
