"""Steps of the search that are mixed with those before."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from spinestiff.estimation.mode import LONGEST, mixed_step
from spinestiff.estimation.weighed import Weights

# One ratio and two nuisances; full steps leave a third, two thirds and minus a half of what is left to go.
LEFT = np.diag([1 / 3, 2 / 3, -1 / 2])
GOAL = np.array([0.4, -1.0, 0.7])
WEIGHTS = Weights(np.diag([0.5, 2.0]), 1.0, np.ones(2))
SLOPE = SimpleNamespace(ratios=np.array([[1.0], [3.0]]))


def wishes(count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Places of plain steps from 0 and what each of them wishes for."""
    found, place = [], np.zeros(3)
    for _ in range(count):
        step = (np.eye(3) - LEFT) @ (GOAL - place)
        found.append((place, step))
        place = place + step
    return found


def test_one_more_step_than_directions_ends_a_linear_iteration() -> None:
    known = wishes(4)
    assert known[-1][0] + mixed_step(known, SLOPE, WEIGHTS) == pytest.approx(GOAL, abs=1e-9)
    plain = known[-1][0] + known[-1][1]
    assert np.abs(plain - GOAL).max() > 0.1


def test_a_first_step_is_as_it_was_wished_for() -> None:
    (known,) = wishes(1)
    assert mixed_step([known], SLOPE, WEIGHTS) == pytest.approx(known[1])


def test_steps_that_hardly_change_lead_no_farther_than_believed() -> None:
    """Two wishes that agree to a ten-thousandth would lead ten thousand steps ahead."""
    step = np.array([0.0, 0.1, 0.0])
    known = [(np.zeros(3), step), (step, 0.9999 * step)]
    assert mixed_step(known, SLOPE, WEIGHTS) == pytest.approx(LONGEST * 0.9999 * step)
