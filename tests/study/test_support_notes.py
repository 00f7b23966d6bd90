"""Supports that pull and a pelvis that tilts are told, beyond their limits and from both sides."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.torso import TorsoState
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.study.support_notes import support_notes


@pytest.fixture(scope="module")
def torso():
    return template_torso(157.0, "coarse")


def notes(torso, side, *forces, pelvis_deg=0.0):
    """Of springs by name, each with its force, N, on the torso; ``pelvis_deg``: the pelvis turned in the picture."""
    rest, pelvis = torso.rest_pose, torso.bone("pelvis")
    rotations = rest.bone_rotations.copy()
    rotations[pelvis] = exp_so3(np.array([0.0, 0.0, np.radians(pelvis_deg)])) @ rotations[pelvis]
    state = TorsoState(rest.bone_positions, rotations, rest.tissue_positions)
    supports = SimpleNamespace(names=tuple(name for name, _ in forces))
    return support_notes(torso, supports, state, np.array([force for _, force in forces]).reshape(-1, 3), side)


@pytest.mark.parametrize(("side", "push"), [("right", 1.0), ("left", -1.0)])
def test_supports_that_pull_are_told(torso, side, push):
    """A push to +x is borne by a shoulder that pushes to -x; the wall behind can only push forward."""
    assert notes(torso, side, ("shoulder", (-10.0 * push, 0, 0)), ("wall_T5", (0, 0, 4.0))) == []
    assert notes(torso, side, ("shoulder", (3.0 * push, 0, 0))) == ["the shoulder's support pulls with 3.0 N"]
    assert notes(torso, side, ("shoulder", (1.9 * push, 0, 0))) == []


def test_a_wall_that_pulls_and_a_tilted_pelvis_are_told(torso):
    pulls = [("wall_R5_L", (0, 0, -2.5)), ("wall_R6_L", (0, 0, -7.0)), ("wall_R7_L", (0, 0, -1.0))]
    (note,) = notes(torso, "right", *pulls)
    assert note.startswith("the back wall pulls at 2 points (most at R6_L, 7.0 N)")
    (single,) = notes(torso, "right", pulls[0])
    assert single.startswith("the back wall pulls at 1 point (most at R5_L, 2.5 N)")
    assert notes(torso, "right", pelvis_deg=-4.0) == ["the pelvis tilts by -4.0 degrees (limit 3)"]
    assert notes(torso, "right", pelvis_deg=2.0) == []


def test_the_names_are_those_of_the_supports(torso):
    """What the rules look for is what the three-point supports call their springs."""
    names = three_point_supports(torso, "left").names
    assert sum(name.startswith("shoulder") for name in names) >= 1
    assert sum(name.startswith("wall_") for name in names) > 10
