import numpy as np
import pytest

from spinestiff.anatomy.points import PointsOnBones, rotation_second_derivative
from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.state import TorsoState, retract
from spinestiff.errors import TorsoError

STEP = 1e-5


@pytest.fixture
def state():
    rng = np.random.default_rng(2)
    return TorsoState(rng.normal(scale=50.0, size=(3, 3)), exp_so3(rng.normal(size=(3, 3))), np.zeros((0, 3)))


@pytest.fixture
def points():
    rng = np.random.default_rng(4)
    return PointsOnBones(np.array([0, 2, 2, 1]), rng.normal(scale=30.0, size=(4, 3)))


def test_at_undoes_positions(state, points):
    again = PointsOnBones.at(state, points.bone, points.positions(state))
    np.testing.assert_allclose(again.offset, points.offset, atol=1e-12)


def test_jacobian_agrees_with_central_differences(state, points):
    exact = points.jacobian(state)
    numeric = np.zeros_like(exact)
    for bone in range(3):
        for k in range(6):
            dx = np.zeros(18)
            dx[6 * bone + k] = STEP
            change = points.positions(retract(state, dx)) - points.positions(retract(state, -dx))
            numeric[points.bone == bone, :, k] = change[points.bone == bone] / (2.0 * STEP)
            assert not change[points.bone != bone].any()
    assert np.abs(exact[:, :, 3:]).max() > 10.0
    np.testing.assert_allclose(numeric, exact, atol=1e-6)


def test_second_derivative_agrees_with_central_differences(state, points):
    gradient = np.random.default_rng(5).normal(size=(4, 3))
    exact = rotation_second_derivative(gradient, points.arms(state))

    def value(w):
        turned = np.einsum("ij,pj->pi", exp_so3(w), points.arms(state))
        return np.einsum("pi,pi->p", gradient, turned)

    step, e = 1e-3, np.eye(3)
    numeric = np.zeros_like(exact)
    for i in range(3):
        for j in range(3):
            a, b = step * e[i], step * e[j]
            numeric[:, i, j] = (value(a + b) - value(a - b) - value(b - a) + value(-a - b)) / (4.0 * step**2)
    assert np.abs(exact).max() > 5.0
    np.testing.assert_allclose(numeric, exact, atol=1e-4)


def test_part_of_the_points(points):
    assert len(points[1]) == 1
    np.testing.assert_array_equal(points[points.bone == 2].offset, points.offset[[1, 2]])


def test_wrong_shapes_are_refused():
    with pytest.raises(TorsoError, match="offset"):
        PointsOnBones(np.array([0, 1]), np.zeros((3, 3)))
    with pytest.raises(TorsoError, match="finite"):
        PointsOnBones(np.array([0]), np.full((1, 3), np.nan))


def test_points_are_read_only(points):
    with pytest.raises(ValueError):
        points.offset[0, 0] = 1.0


def test_a_point_on_a_negative_bone_is_refused():
    """NumPy would take -1 for the last bone."""
    with pytest.raises(TorsoError, match=r"^a point rides on bone -1; wanted numbers from 0$"):
        PointsOnBones(np.array([0, -1]), np.zeros((2, 3)))
