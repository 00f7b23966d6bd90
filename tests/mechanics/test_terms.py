"""spinestiff.mechanics.terms: energies of bones alone."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import retract
from spinestiff.errors import TorsoError
from spinestiff.mechanics.terms import PointSprings, point_blocks
from spinestiff.verification.energies import bent, two_bones
from spinestiff.verification.models import points_on


def _springs(torso, stiffness=(1.0, 20.0, 300.0)):
    random = np.random.default_rng(2)
    directions = random.normal(size=(3, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return PointSprings(points_on(torso, 3, 1), random.uniform(0, 40, (3, 3)), directions, np.array(stiffness))


def test_spring_energy_force_and_extension():
    torso = two_bones(np.zeros(6))
    point = PointsOnBones(np.array([1]), np.array([[1.0, 2.0, 3.0]]))
    place = point.positions(torso.rest_pose)
    spring = PointSprings(point, place - [0.0, 4.0, 0.0], np.array([[0.0, 1.0, 0.0]]), np.array([2.5]))
    assert spring.extension(torso.rest_pose) == pytest.approx([4.0])
    assert spring.energy(torso.rest_pose) == pytest.approx(0.5 * 2.5 * 16.0)
    assert spring.forces(torso.rest_pose)[0] == pytest.approx([0.0, -10.0, 0.0])


def test_blocks_are_derivatives_of_the_energy_of_each_bone():
    torso = two_bones(np.zeros(6))
    state, springs = bent(torso, 0.7), _springs(torso)
    blocks = springs.blocks(state)
    gradient, hessian = np.zeros((2, 6)), np.zeros((2, 6, 6))
    np.add.at(gradient, blocks.bone, blocks.gradient)
    np.add.at(hessian, blocks.bone, blocks.hessian)
    direction = np.random.default_rng(4).normal(size=12) * np.tile([1, 1, 1, 0.05, 0.05, 0.05], 2)
    h = 1e-3
    up, mid, down = (springs.energy(retract(state, s * direction)) for s in (h, 0.0, -h))
    assert gradient.ravel() @ direction == pytest.approx((up - down) / (2 * h), rel=1e-7)
    wanted = (up - 2 * mid + down) / h**2
    rows = direction.reshape(2, 6)
    assert np.einsum("bi,bij,bj->", rows, hessian, rows) == pytest.approx(wanted, rel=1e-5)


def test_point_blocks_keep_the_second_derivative_of_the_turn_without_a_hessian():
    torso = two_bones(np.zeros(6))
    points = PointsOnBones(np.array([0]), np.array([[10.0, 0.0, 0.0]]))
    blocks = point_blocks(points, torso.rest_pose, np.array([[1.0, 2.0, 3.0]]), None)
    assert np.abs(blocks.hessian[0, :3]).max() == 0.0
    assert np.abs(blocks.hessian[0, 3:, 3:]).max() > 1.0


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("directions", np.array([[1.0, 1.0, 0.0]]), "unit length"),
        ("stiffness", np.array([-1.0]), "negative"),
        ("targets", np.array([[np.nan, 0.0, 0.0]]), "not finite"),
        ("targets", np.zeros((2, 3)), "shape"),
    ],
)
def test_bad_springs_are_refused(field, value, message):
    fields = {
        "points": PointsOnBones(np.array([0]), np.zeros((1, 3))),
        "targets": np.zeros((1, 3)),
        "directions": np.array([[1.0, 0.0, 0.0]]),
        "stiffness": np.array([1.0]),
    }
    with pytest.raises(TorsoError, match=message):
        PointSprings(**{**fields, field: value})
