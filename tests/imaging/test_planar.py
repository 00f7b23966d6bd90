"""spinestiff.imaging.planar: turns of figures in the plane."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.imaging.planar import cross, rotation, turns

SQUARE = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]])


def test_a_rotation_goes_from_the_first_axis_to_the_second() -> None:
    np.testing.assert_allclose(rotation(0.5 * np.pi) @ [1.0, 0.0], [0.0, 1.0], atol=1e-15)
    assert cross(np.array([1.0, 0.0]), np.array([0.0, 1.0])) == 1.0


@pytest.mark.parametrize("weights", [None, np.array([1.0, 0.1, 3.0, 0.5])])
@pytest.mark.parametrize("angle", [-3.0, -0.4, 0.0, 1.2])
def test_what_was_turned_and_shifted_has_turned_by_that(angle, weights) -> None:
    figures = SQUARE + np.array([[[0.0, 0.0]], [[40.0, -7.0]]])
    moved = figures @ rotation(angle).T + [3.0, -200.0]
    np.testing.assert_allclose(turns(figures, moved, weights), [angle, angle], atol=1e-12)


def test_the_turn_has_the_least_squares() -> None:
    """Against a search; and a point of no weight is as one that is not there."""
    moved = SQUARE @ rotation(0.3).T + np.random.default_rng(3).normal(0.0, 0.2, SQUARE.shape)
    weights = np.array([1.0, 2.0, 0.5, 1.5])

    def left(angle, start, end, weights):
        share = weights / weights.sum()
        a, b = start - share @ start, end - share @ end
        return float(weights @ np.sum((a @ rotation(angle).T - b) ** 2, axis=1))

    angles = np.linspace(-0.5, 1.5, 4001)
    best = min(angles, key=lambda angle: left(angle, SQUARE, moved, weights))
    assert float(turns(SQUARE, moved, weights)) == pytest.approx(best, abs=1e-3)
    lame = np.array([1.0, 1.0, 1.0, 0.0])
    assert float(turns(SQUARE, moved, lame)) == pytest.approx(float(turns(SQUARE[:3], moved[:3])))
