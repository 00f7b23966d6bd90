"""Points on the tissue's boundary: where they are in a state, and how they move with it."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.anatomy.state import retract
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.tissue_points import PointsOnTissue, face_functions
from spinestiff.errors import TorsoError


@pytest.fixture(scope="module")
def torso():
    return template_torso(157.0, "coarse")


@pytest.fixture(scope="module")
def points(torso):
    """Six nodes a point: of the skin, of bones, and of both."""
    random = np.random.default_rng(0)
    bone = torso.tissue.bone_of_node
    free, tied = np.flatnonzero(bone < 0), np.flatnonzero(bone >= 0)
    nodes = np.array(
        [random.choice(free, 6), random.choice(tied, 6), [*random.choice(free, 3), *random.choice(tied, 3)]]
    )
    shares = random.normal(size=(3, 6))
    shares[:, 0] += 1.0 - shares.sum(1)
    return PointsOnTissue(nodes, shares)


def test_points_lie_where_their_nodes_put_them(torso, points):
    rest = torso.rest_pose
    by_hand = [share @ torso.tissue.rest_positions[nodes] for nodes, share in zip(points.nodes, points.shares)]
    assert np.allclose(points.positions(torso, rest), by_hand, atol=1e-9)
    assert len(points[1:]) == 2
    assert np.array_equal(points[[2]].nodes, points.nodes[2:])


def test_points_move_as_their_derivative_says(torso, points):
    random = np.random.default_rng(1)
    start = retract(torso.rest_pose, 0.02 * random.normal(size=torso.rest_pose.dofs))
    step = random.normal(size=start.dofs)
    ahead, behind = (points.positions(torso, retract(start, sign * 1e-4 * step)) for sign in (1, -1))
    quotient = (ahead - behind) / 2e-4
    exact = (points.jacobian(torso, start) @ step).reshape(-1, 3)
    # Nodes on bones turn with them, at arms of many mm.
    assert np.abs(quotient[1]).max() > 10.0
    assert np.allclose(exact, quotient, atol=1e-5)


def test_shares_that_do_not_add_up_and_other_shapes_are_refused():
    with pytest.raises(TorsoError, match="do not add up to 1"):
        PointsOnTissue(np.zeros((1, 3), dtype=int), np.full((1, 3), 0.3))
    with pytest.raises(TorsoError, match="shares of points has shape"):
        PointsOnTissue(np.zeros((1, 3), dtype=int), np.full((1, 2), 0.5))


@pytest.mark.parametrize("nodes", [3, 6])
def test_shape_functions_reproduce_what_they_can_and_their_derivatives(nodes):
    share = np.random.default_rng(2).dirichlet(np.ones(3), size=5)
    corners = np.eye(3)
    places = np.vstack([corners, [corners[[0, 1]].mean(0), corners[[1, 2]].mean(0), corners[[2, 0]].mean(0)]])[:nodes]

    def field(at):
        a, b, c = at.T
        return 2.0 * a - b + (3.0 * a * b - c * c if nodes == 6 else 0.0)

    value, slope = face_functions(share, nodes)
    assert np.allclose(value @ field(places), field(share), atol=1e-12)
    for number, direction in enumerate(([-1.0, 1.0, 0.0], [-1.0, 0.0, 1.0])):
        step = 1e-6 * np.array(direction)
        quotient = (face_functions(share + step, nodes)[0] - face_functions(share - step, nodes)[0]) / 2e-6
        assert np.allclose(slope[:, number], quotient, atol=1e-8)
