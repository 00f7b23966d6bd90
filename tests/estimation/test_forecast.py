"""Radiographs that no fit has seen: expected from the others, never from their own vertebrae."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.estimation.ended import forecast_unseen
from spinestiff.estimation.fitted import FitEnd
from spinestiff.estimation.forecast import forecast
from spinestiff.imaging.features import VertebraCorners

UNSEEN = 1  # among the loaded trials of 40, 70 and 100 N
HERE = np.log([0.35, 0.36])


def seen(column, **facts):
    return column.trials(forces=(40.0, 70.0, 100.0), **facts)


def of(column, trials, factor=1.0):
    asked = column.weighed(trials)
    point = asked.solve(HERE, np.zeros(len(asked.unknowns)))
    return forecast(asked, point, asked.slope(point), factor, [UNSEEN])[0]


def moved(trial, shift):
    corners = trial.corners.corners + shift
    return replace(trial, corners=VertebraCorners(trial.corners.vertebrae, corners, trial.corners.quality))


def test_its_own_vertebrae_are_not_used(column) -> None:
    """But for where in the picture they are about, which says what a roll of the patient does."""
    trials = seen(column, annotation=0.3, tracking=0.2)
    found = of(column, trials)
    other = of(column, [*trials[:2], moved(trials[2], [5.0, -3.0]), trials[3]])
    assert np.allclose(other.expected, found.expected, atol=0.01)
    assert np.allclose(other.covariance, found.covariance, atol=0.02)
    assert np.abs(other.found - found.found).max() > 3.0


def test_what_all_radiographs_share_is_expected_again(column) -> None:
    """The patient stood 5 mm aside for the whole sequence."""
    trials = seen(column, tracking=0.1)
    plain, aside = of(column, trials), of(column, [moved(trial, [5.0, 2.0]) for trial in trials])
    assert np.abs(aside.found - plain.found).max() > 5.0
    assert np.allclose(aside.corner_errors, plain.corner_errors, atol=0.05)


def test_outlying_vertebrae_count_as_little_as_in_the_fit(column) -> None:
    """T12 of the frame of 40 N was followed wrongly, by 3 mm."""
    trials = seen(column, tracking=0.05)
    corners = trials[1].corners.corners.copy()
    corners[3] += [3.0, 0.0]
    trials[1] = replace(
        trials[1], corners=VertebraCorners(trials[1].corners.vertebrae, corners, trials[1].corners.quality)
    )
    fitted = [trials[i] for i in (0, 1, 3)]
    asked = column.weighed(fitted)
    found = column.searched(asked)
    outlying = asked.outlying(found.weights.inflation)
    assert [(label, name) for label, name, _ in outlying] == [("push 1 40 N", "T12")]
    np.testing.assert_allclose(asked.inflation(outlying), found.weights.inflation)
    end = FitEnd(
        dict(zip(("lateral_bending", "tissue"), np.exp(found.point.log_ratios))),
        dict(zip(asked.unknowns.names, found.point.nuisances)),
        found.weights.tracking_factor,
        tuple(outlying),
    )
    problems = [column.problem] * 4
    ours, plain = (forecast_unseen(problems, trials, [2], one)[0] for one in (end, replace(end, outlying=())))
    at_it = np.abs(ours.corner_errors[3]).max()
    assert at_it < 0.2 < 0.5 * np.abs(plain.corner_errors[3]).max()


def test_without_errors_the_radiograph_is_as_expected(column, clean) -> None:
    """Though looked for from other ratios than the true ones."""
    found = of(column, seen(column))
    assert np.abs(found.found).max() > 1.0
    assert np.abs(found.corner_errors).max() < 0.1
    assert found.inside95 == 1.0


def test_intervals_hold_a_radiograph_and_not_one_of_a_patient_who_moved(column) -> None:
    held, left = [], []
    for seed in range(12):
        trials = seen(column, annotation=0.3, tracking=0.15, seed=seed)
        held.append(of(column, trials).inside95)
        left.append(of(column, [*trials[:2], moved(trials[2], [8.0, 0.0]), trials[3]]).inside95)
    assert np.mean(held) > 0.9
    assert np.mean(left) < 0.8


def test_a_turn_between_two_vertebrae_is_that_of_the_channels(column) -> None:
    """All corners of one vertebra turned by 0.02 rad in its picture."""
    trials = seen(column, tracking=0.1)
    plain = of(column, trials)
    corners = np.array(trials[2].corners.corners)
    middle, turn = corners[1].mean(axis=0), np.array([[np.cos(0.02), -np.sin(0.02)], [np.sin(0.02), np.cos(0.02)]])
    corners[1] = middle + (corners[1] - middle) @ turn.T
    turned = replace(
        trials[2], corners=VertebraCorners(trials[2].corners.vertebrae, corners, trials[2].corners.quality)
    )
    other = of(column, [*trials[:2], turned, trials[3]])
    expected, sd, found = plain.turn(1, 5)
    again, same, changed = other.turn(1, 5)
    assert (again, same) == pytest.approx((expected, sd), rel=1e-3)
    assert abs(changed - found) == pytest.approx(0.02, rel=0.02)
    assert sd > 0.001
    assert abs(found - expected) < 3.0 * sd


def test_a_ratio_that_nothing_shows_does_not_stop_the_rest(column) -> None:
    """The column has no ribs, so that a ratio of theirs moves nothing."""
    asked = column.weighed(seen(column, tracking=0.1), names=("lateral_bending", "tissue", "rib_vertebra"))
    point = asked.solve(np.append(HERE, 0.0), np.zeros(len(asked.unknowns)))
    found = forecast(asked, point, asked.slope(point), 1.0, [UNSEEN])[0]
    wanted = of(column, seen(column, tracking=0.1))
    assert np.allclose(found.expected, wanted.expected, atol=1e-6)
    assert np.allclose(found.covariance, wanted.covariance, atol=1e-6)
