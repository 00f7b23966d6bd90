"""spinestiff.verification.oracle: the second implementation is independent, analytic and right by itself."""

from __future__ import annotations

import ast
import inspect

import mpmath
import numpy as np
import pytest

from spinestiff.anatomy.rotation import exp_so3, log_so3
from spinestiff.verification import oracle
from spinestiff.verification.models import box_mesh, shaken, toy_torso


def test_it_shares_no_code_with_mechanics():
    tree = ast.parse(inspect.getsource(oracle))
    imported = {n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) if n.module}
    imported |= {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
    assert not [name for name in imported if "mechanics" in name or "rotation" in name]


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.5, 1.0, 2.5])
def test_rotations_against_mpmath_at_40_digits(angle):
    axis = np.array([0.48, -0.6, 0.64])
    with mpmath.workdps(40):
        w = [mpmath.mpf(float(angle)) * mpmath.mpf(float(c)) for c in axis]
        k = mpmath.matrix([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        exact = np.array(mpmath.expm(k).tolist(), dtype=float)
    found = oracle.rotation((angle * axis)[None].astype(complex))[0].real
    assert found == pytest.approx(exact, abs=2e-15)
    assert exp_so3(angle * axis) == pytest.approx(exact, abs=2e-15)
    back = oracle.rotation_vector(found[None].astype(complex))[0].real
    assert back == pytest.approx(angle * axis, rel=1e-12, abs=1e-16)
    assert back == pytest.approx(log_so3(found), rel=1e-12, abs=1e-16)


def test_complex_step_is_exact_to_rounding():
    def function(x):
        return complex(np.exp(x[0]) * np.sin(x[1]) / x[2] ** 3)

    at = np.array([0.3, 1.1, 0.7])
    wanted = np.exp(0.3) / 0.7**3 * np.array([np.sin(1.1), np.cos(1.1), -3 * np.sin(1.1) / 0.7])
    assert oracle.complex_step_gradient(function, at, [0, 1, 2]) == pytest.approx(wanted, rel=1e-15)


def test_a_dual_number_knows_the_derivative_of_what_is_done_to_it():
    def function(x):
        a, b = x[0] + 0.8, x[1] - 1.7
        return np.sqrt(a) * np.log(a * a + 1.0) / b - np.arctan(a - 2.0 * b) * b + (3.0 - a) / 7.0

    first, second = np.array([0.7, -0.4]), np.array([0.3, 1.1])
    with mpmath.workdps(40):

        def exact(s, t):
            a = mpmath.mpf("0.8") + s * mpmath.mpf(first[0]) + t * mpmath.mpf(second[0])
            b = -mpmath.mpf("1.7") + s * mpmath.mpf(first[1]) + t * mpmath.mpf(second[1])
            return mpmath.sqrt(a) * mpmath.log(a**2 + 1) / b - mpmath.atan(a - 2 * b) * b + (3 - a) / 7

        mixed, slope = float(mpmath.diff(exact, (0, 0), (1, 1))), float(mpmath.diff(exact, (0, 0), (1, 0)))
    assert oracle.curvature_along(function, first, second) == pytest.approx(mixed, rel=1e-14)
    assert oracle.curvature_along(function, second, first) == pytest.approx(mixed, rel=1e-14)
    assert oracle.slope_along(function, first) == pytest.approx(slope, rel=1e-14)


def test_a_dual_array_refuses_what_it_has_no_rule_for():
    z = oracle.Dual(np.ones(3, dtype=complex), np.ones(3, dtype=complex))
    with pytest.raises(TypeError):
        np.exp(z)
    with pytest.raises(TypeError):
        np.linalg.inv(z)
    with pytest.raises(TypeError):
        np.add.reduce(z)


def test_hessian_times_a_vector_in_closed_form():
    def function(x):
        # x^3 y + e^(x + 2 y), by its series, which dual numbers take.
        s, term = x[0] + 2.0 * x[1], 1.0
        total = x[0] * x[0] * x[0] * x[1]
        for k in range(1, 20):
            term = term * s / k
            total = total + term
        return total

    # At 0 the Hessian is [[1, 2], [2, 4]].
    found = oracle.hessian_times(function, np.array([0.7, -0.4]), [0, 1])
    assert found == pytest.approx([-0.1, -0.2], rel=1e-13)


@pytest.mark.parametrize("nodes", [4, 10])
def test_tissue_energy_of_an_affine_map_in_closed_form(nodes):
    positions, elements = box_mesh((2, 1, 1), (10.0, 20.0, 30.0), nodes)
    f = np.array([[1.15, 0.20, -0.05], [0.10, 0.90, 0.15], [-0.08, 0.12, 1.10]])
    mu, lam = np.full(len(elements), 0.7), np.full(len(elements), 1.9)
    log_j = np.log(np.linalg.det(f))
    wanted = 6000.0 * (0.35 * (np.sum(f**2) - 3) - 0.7 * log_j + 0.95 * log_j**2)
    found = oracle.tissue_energy(positions, (positions @ f.T).astype(complex), elements, mu, lam)
    assert found.real == pytest.approx(wanted, rel=1e-13)


def test_parts_add_up_and_none_is_nought():
    torso = toy_torso(1, 4)
    state = shaken(torso, 3)
    points = torso.tied_nodes[:2]
    directions = np.array([[1.0, 0, 0], [0, 0.6, 0.8]])
    whole = oracle.EnergyOracle(
        torso, state, None, (points, np.ones((2, 3))), (points, np.zeros((2, 3)), directions, np.array([1.0, 2.0]))
    )
    zero = np.zeros(state.dofs, dtype=complex)
    total, parts = whole(zero).real, []
    for part in ("joints", "tissue", "loads", "springs"):
        whole.parts = (part,)
        parts.append(whole(zero).real)
    assert sum(parts) == pytest.approx(total, rel=1e-14)
    assert np.abs(parts).min() > 1.0
