"""Residuals of trials and their derivatives (Eqs. 8-12)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.state import retract
from spinestiff.errors import FitError
from spinestiff.estimation.objective import Trial, make_target, residuals, root_mean_square
from spinestiff.imaging.features import VertebraCorners


@pytest.fixture(scope="module")
def trial(column) -> Trial:
    return column.trials(forces=(50.0,), tracking=0.5)[1]


def test_eq_9_residuals_vanish_where_the_radiograph_was_taken(column) -> None:
    exact = column.trials(forces=(50.0,))[1]
    target = make_target(column.torso, exact)
    state = column.problem.solve(exact.load, column.ratios(column.truth)).state
    assert residuals(column.torso, target, state).rmse < 1e-10
    assert residuals(column.torso, target, column.torso.rest_pose).rmse > 2.0


@pytest.mark.parametrize("orientation", ["procrustes", "covariance"])
def test_eqs_10_11_gradient_and_jacobian_by_differences(column, trial, orientation) -> None:
    rng = np.random.default_rng(4)
    corners = trial.corners
    judged = VertebraCorners(corners.vertebrae, corners.corners, rng.uniform(0.2, 1.0, (len(corners), 4)))
    target = make_target(column.torso, Trial(trial.load, judged, trial.view), orientation)
    state = retract(column.torso.rest_pose, 0.1 * rng.standard_normal(column.torso.rest_pose.dofs))
    here = residuals(column.torso, target, state)
    directions = rng.standard_normal((state.dofs, 3))
    gradient, along, step = here.gradient(state.dofs), here.along(directions), 1e-4
    for p in range(3):
        ahead, behind = (residuals(column.torso, target, retract(state, s * step * directions[:, p])) for s in (1, -1))
        slope = (ahead.loss - behind.loss) / (2.0 * step)
        assert abs(slope) > 1.0
        assert gradient @ directions[:, p] == pytest.approx(slope, rel=1e-6, abs=1e-5)
        assert here.values @ along[:, p] == pytest.approx(slope, rel=1e-6, abs=1e-5)
        assert np.allclose((ahead.values - behind.values) / (2.0 * step), along[:, p], atol=1e-5)


def test_quality_drops_corners_and_weighs_nothing_in_the_papers_loss(column, trial) -> None:
    corners = VertebraCorners(trial.corners.vertebrae, trial.corners.corners)
    quality = np.ones(corners.quality.shape)
    quality[2], quality[5, 1] = 0.25, 0.0
    broken = corners.corners.copy()
    broken[5, 1] += 30.0
    weighted = Trial(trial.load, VertebraCorners(corners.vertebrae, broken, quality), trial.view, "weighted")
    plain, other = (
        residuals(column.torso, make_target(column.torso, t), column.torso.rest_pose)
        for t in (replace(trial, corners=corners), weighted)
    )
    assert np.allclose(other.values.reshape(-1, 8)[2], plain.values.reshape(-1, 8)[2])
    assert np.abs(other.difference[5] - plain.difference[5]).max() < 2.0
    assert other.quality[[2, 5]].tolist() == [0.25, 1.0]


def test_rmse_is_the_root_of_mean_squared_distances(column, trial) -> None:
    part = residuals(column.torso, make_target(column.torso, trial), column.torso.rest_pose)
    distance2 = np.sum(part.difference**2, axis=2)
    assert part.rmse == pytest.approx(np.sqrt(distance2.mean()))
    assert root_mean_square([part, part]) == pytest.approx(part.rmse)


def test_too_few_vertebrae_are_refused(column, trial) -> None:
    few = Trial(trial.load, trial.corners.selected(("T9", "T10")), trial.view, "frame 1")
    with pytest.raises(FitError, match="frame 1 shows 2 vertebrae"):
        make_target(column.torso, few)


@pytest.mark.parametrize(
    ("supports", "text"),
    [
        ({"pelvis": (0.1, 0.01)}, "support 'pelvis' at 0.1"),
        ({"obliquity": (np.nan, 0.01)}, "'obliquity' at nan"),
        ({"shoulder": (1.0, 0.0)}, "'shoulder' at 1 with sd 0"),
        ({"shoulder": (1.0, np.inf)}, "with sd inf"),
    ],
)
def test_measured_supports_that_mean_nothing_are_refused(trial, supports, text) -> None:
    with pytest.raises(FitError, match=text):
        Trial(trial.load, trial.corners, trial.view, "frame 1", supports=supports)


def test_push_is_the_label_unless_given(trial) -> None:
    assert Trial(trial.load, trial.corners, trial.view, "a").push == "a"
    assert Trial(trial.load, trial.corners, trial.view, "a", "b").push == "b"
