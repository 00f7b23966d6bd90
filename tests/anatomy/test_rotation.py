import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from spinestiff.anatomy.rotation import cross_matrix, exp_so3, log_so3, mean_rotation

ANGLES = (0.0, 1e-9, 1e-6, 1e-4, 0.9e-4, 1.1e-4, 1.0, 3.0, 3.13, 3.14, np.pi - 1e-4, np.pi - 1e-6, np.pi - 1e-8)


@pytest.fixture
def axes():
    a = np.random.default_rng(3).normal(size=(40, 3))
    a = np.vstack([a, np.eye(3), -np.eye(3), [[1, 1e-9, 0], [0, 1, 1e-9]]])
    return a / np.linalg.norm(a, axis=1, keepdims=True)


def test_cross_matrix_is_the_cross_product():
    a, b = np.random.default_rng(0).normal(size=(2, 5, 3))
    np.testing.assert_allclose(np.einsum("nij,nj->ni", cross_matrix(a), b), np.cross(a, b), atol=1e-14)


@pytest.mark.parametrize("angle", ANGLES)
def test_exp_agrees_with_scipy(axes, angle):
    w = angle * axes
    np.testing.assert_allclose(exp_so3(w), Rotation.from_rotvec(w).as_matrix(), atol=4e-15)


@pytest.mark.parametrize("angle", ANGLES)
def test_log_undoes_exp(axes, angle):
    w = angle * axes
    np.testing.assert_allclose(log_so3(exp_so3(w)), w, atol=1e-15 + 1e-12 * angle)


def test_exp_turns_the_right_way():
    # A quarter turn about x takes y to z: flexion, forwards.
    np.testing.assert_allclose(
        exp_so3(np.array([0.5 * np.pi, 0.0, 0.0])) @ [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], atol=1e-15
    )


def test_ten_thousand_updates_stay_orthonormal():
    rng = np.random.default_rng(1)
    r = np.eye(3)
    for w in rng.normal(scale=0.3, size=(10_000, 3)):
        r = exp_so3(w) @ r
    np.testing.assert_allclose(r @ r.T, np.eye(3), atol=1e-11)
    assert np.linalg.det(r) > 0.0


def test_mean_rotation_is_halfway_from_either_side():
    a, b = exp_so3(np.array([0.2, 0.5, -0.1])), exp_so3(np.array([-0.7, 0.3, 1.1]))
    mean = mean_rotation(a, b)
    np.testing.assert_allclose(mean, mean_rotation(b, a), atol=1e-14)
    np.testing.assert_allclose(mean @ a.T @ mean, b, atol=1e-14)
