"""spinestiff.mechanics.truncated: Newton steps by conjugate gradients inside a ball, on tangents of any sign."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.truncated import truncated_step


def _matrices(seed, *eigenvalues):
    """A symmetric matrix of these eigenvalues, and a positive definite one."""
    random = np.random.default_rng(seed)
    n = len(eigenvalues)
    turn = np.linalg.qr(random.normal(size=(n, n)))[0]
    root = random.normal(size=(n, n)) + 3.0 * np.eye(n)
    return turn * eigenvalues @ turn.T, root @ root.T, random.normal(size=n)


def _model(tangent, gradient, y):
    return float(gradient @ y + 0.5 * y @ tangent @ y)


def _step(tangent, metric, gradient, radius=np.inf, most=20, gain=1e-20):
    inverse = np.linalg.inv(metric)
    return truncated_step(gradient, lambda v: tangent @ v, lambda v: inverse @ v, radius, most, gain)


@pytest.mark.parametrize("seed", range(4))
def test_a_positive_definite_tangent_gets_newtons_step(seed):
    tangent, metric, gradient = _matrices(seed, 0.1, 1.0, 2.0, 5.0, 9.0)
    found = _step(tangent, metric, gradient)
    assert found.y == pytest.approx(-np.linalg.solve(tangent, gradient), rel=1e-6)
    assert found.size == pytest.approx(np.sqrt(found.y @ metric @ found.y), rel=1e-6)
    assert found.concave is None and found.products <= 6
    # Fewer products, a worse step; with as good a preconditioner as the tangent itself one is enough.
    short = _step(tangent, metric, gradient, most=2)
    assert short.products == 2
    assert _model(tangent, gradient, found.y) < _model(tangent, gradient, short.y) < 0.0
    assert _step(tangent, tangent, gradient, gain=1e-3).products == 1


def test_one_product_takes_one_solve_and_goes_as_far_as_the_model_falls():
    tangent, metric, gradient = _matrices(0, 0.1, 1.0, 2.0, 5.0, 9.0)
    solved = []

    def precondition(v):
        solved.append(v)
        return np.linalg.solve(metric, v)

    found = truncated_step(gradient, lambda v: tangent @ v, precondition, np.inf, 1, 1e-3)
    assert found.products == len(solved) == 1
    heights = [_model(tangent, gradient, share * found.y) for share in (0.9, 1.0, 1.1)]
    assert heights[1] < min(heights[0], heights[2])


@pytest.mark.parametrize("seed", range(4))
def test_a_step_ends_at_the_ball_and_goes_on_falling_up_to_there(seed):
    tangent, metric, gradient = _matrices(seed, 0.1, 1.0, 2.0, 5.0, 9.0)
    whole = _step(tangent, metric, gradient)
    heights = []
    for share in (0.2, 0.5, 0.9):
        part = _step(tangent, metric, gradient, radius=share * whole.size)
        assert np.sqrt(part.y @ metric @ part.y) == pytest.approx(share * whole.size, rel=1e-9)
        assert part.size == share * whole.size and part.concave is None
        heights.append(_model(tangent, gradient, part.y))
    assert 0.0 > heights[0] > heights[1] > heights[2] > _model(tangent, gradient, whole.y)


@pytest.mark.parametrize("seed", range(6))
def test_what_is_concave_is_found_and_leads_down(seed):
    tangent, metric, gradient = _matrices(seed, -0.3, 0.5, 2.0, 5.0, 9.0)
    found = _step(tangent, metric, gradient)
    assert found.concave @ tangent @ found.concave < 0.0
    assert found.concave @ gradient < 0.0
    assert found.y @ gradient < 0.0 and _model(tangent, gradient, found.y) < 0.0
    assert found.size == pytest.approx(np.sqrt(found.y @ metric @ found.y), rel=1e-9)


def test_where_all_is_concave_the_step_is_steepest_descent():
    tangent, metric, gradient = _matrices(0, -3.0, -2.0, -1.0)
    found = _step(tangent, metric, gradient)
    assert found.products == 1
    assert found.y == pytest.approx(-np.linalg.solve(metric, gradient))
    assert found.concave is found.y


def test_a_preconditioner_that_is_not_positive_definite_is_an_error():
    tangent, _, gradient = _matrices(0, 0.1, 1.0, 2.0, 5.0, 9.0)
    with pytest.raises(EquilibriumError, match="not positive definite"):
        _step(tangent, -np.eye(5), gradient)
