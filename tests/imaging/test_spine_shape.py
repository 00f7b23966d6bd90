"""Odd vertebrae: the measures against known faults, and the choice of corners against all choices tried one by one."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from spine_images import boxes
from spinestiff.imaging.spine_shape import (
    CHANGED,
    MOST_OF_A_LEAN,
    ODDEST,
    ODDEST_LEAN_DEG,
    ODDEST_STEP_DEG,
    oddities,
    quarter_turns,
    spine_axes,
)

BENT = [12.0, 9.0, 6.0, 3.0, 0.0, -3.0, -6.0, -9.0, -12.0]


def measured(corners, row, measure, places=None):
    """A vertebra's measure in its own unit."""
    found = oddities(corners, range(len(corners)) if places is None else places)
    return next(o.ratio * ODDEST[measure] for o in found if (o.row, o.measure) == (row, measure))


def turned_by(quad, degrees):
    turn = np.radians(degrees)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    middle = quad.mean(axis=0)
    return middle + (quad - middle) @ rotation.T


# (row, |c|^2 of the forecast): cubic between two either side, parabola beside the end, line beyond it.
@pytest.mark.parametrize(("row", "weights"), [(4, 34 / 36), (1, 11 / 9), (0, 5.0)])
def test_measures_are_the_fault_over_the_forecasts_uncertainty(row, weights):
    straight, spread = boxes([0.0] * 9), np.sqrt(1.0 + weights)
    assert oddities(straight, range(9))[0].ratio == pytest.approx(0.0, abs=1e-9)
    for measure, quad, value in (
        ("sideways", straight[row] + [30.0, 0.0], 30.0 / 120.0),
        ("along", straight[row] + [0.0, 24.5], 24.5 / 98.0),
        ("turned", turned_by(straight[row], 25.0), 25.0),
        ("wide", straight[row].mean(0) + (straight[row] - straight[row].mean(0)) * [1.5, 1.0], np.log(1.5)),
    ):
        spoiled = straight.copy()
        spoiled[row] = quad
        assert measured(spoiled, row, measure) == pytest.approx(value / spread), measure
    taller = straight.copy()
    for at, by in ((row, 1.5), (row + 1, 2.0)):
        taller[at] = straight[at].mean(0) + (straight[at] - straight[at].mean(0)) * [1.0, by]
    neighbours = min(row, 2) + 2
    assert measured(taller, row, "high") == pytest.approx(abs(np.log(1.5) - np.log(2.0) / neighbours))
    wedged = boxes([0.0] * 9, wedge=4.0)
    assert measured(wedged, row, "wedged") == pytest.approx(8.0)


def test_an_even_bend_is_foretold_with_levels_missing_too():
    places = [0, 1, 2, 5, 6, 8]
    spine = boxes(BENT)[places]
    assert all(measured(spine, row, "turned", places) == pytest.approx(0.0, abs=1e-9) for row in range(6))


def test_a_vertebra_between_two_is_told_what_two_can_tell():
    assert {o.measure for o in oddities(boxes([3.0, 9.0]), range(2))} == {"wide", "high", "wedged"}


@pytest.mark.parametrize("seed", range(6))
def test_the_least_odd_choice_is_that_of_all_choices(seed):
    rng = np.random.default_rng(seed)
    places = sorted(rng.choice(9, 4, replace=False))
    spine = boxes(rng.uniform(-40.0, 40.0, 9))[places]
    spine = np.array([np.roll(quad, rng.integers(4), axis=0) for quad in spine])
    given = rng.integers(0, 2, 4).astype(bool)
    costs = {}
    axes = spine_axes(spine)
    for choice in product(range(4), repeat=4):
        quads = np.array([np.roll(quad, -k, axis=0) for quad, k in zip(spine, choice)])
        line = quads[:, 1] + quads[:, 2] - quads[:, 0] - quads[:, 3]
        tilts, spines = np.angle(line @ [1.0, 1j]), np.angle(axes @ [1.0, 1j]) - 0.5 * np.pi
        lean = np.degrees(np.abs(np.angle(np.exp(1j * (tilts - spines)))))
        steps = np.degrees(np.abs(np.angle(np.exp(1j * np.diff(tilts)))))
        most = np.minimum(ODDEST_STEP_DEG * np.diff(places), 45.0)
        costs[choice] = (
            np.minimum((lean / ODDEST_LEAN_DEG) ** 2, MOST_OF_A_LEAN).sum()
            + CHANGED * np.sum(given & (np.array(choice) > 0))
            + ((steps / most) ** 2).sum()
        )
    found = quarter_turns(spine, places, given.tolist())
    best = min(costs, key=costs.get)
    assert tuple(found.turns) == best
    for row in range(4):
        other = min(cost for choice, cost in costs.items() if choice[row] != best[row])
        assert found.ahead[row] == pytest.approx(other - costs[best])
