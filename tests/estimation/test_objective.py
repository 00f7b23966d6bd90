"""Residuals of trials and their derivatives (Eqs. 8-12)."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import retract
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.errors import FitError
from spinestiff.estimation.objective import Trial, make_target, push_height_change, residuals, root_mean_square
from spinestiff.imaging.features import VertebraCorners
from spinestiff.mechanics.loads import LoadCase

SOFT = {"lateral_bending": 0.1, "tissue": 0.03}


@pytest.fixture
def trial(spine, show, push_by) -> Trial:
    return show(spine, push_by(50.0), stiffness_ratios(SOFT, spine.torso.joints.kinds), 0.5)


def test_eq_9_residuals_vanish_where_the_radiograph_was_taken(spine, show, push_by) -> None:
    ratios = stiffness_ratios(SOFT, spine.torso.joints.kinds)
    exact = show(spine, push_by(50.0), ratios)
    target = make_target(spine.torso, exact)
    state = spine.solve(exact.load, ratios).state
    assert residuals(spine.torso, target, state).rmse < 1e-10
    assert residuals(spine.torso, target, spine.torso.rest_pose).rmse > 5.0


@pytest.mark.parametrize("orientation", ["procrustes", "covariance"])
def test_eqs_10_11_gradient_and_jacobian_by_differences(spine, trial, orientation) -> None:
    rng = np.random.default_rng(4)
    corners = trial.corners
    judged = VertebraCorners(corners.vertebrae, corners.corners, rng.uniform(0.2, 1.0, (len(corners), 4)))
    target = make_target(spine.torso, Trial(trial.load, judged, trial.view), orientation)
    state = retract(spine.torso.rest_pose, 0.1 * rng.standard_normal(spine.torso.rest_pose.dofs))
    here = residuals(spine.torso, target, state)
    directions = rng.standard_normal((state.dofs, 3))
    gradient, along, step = here.gradient(state.dofs), here.along(directions), 1e-4
    for p in range(3):
        ahead, behind = (residuals(spine.torso, target, retract(state, s * step * directions[:, p])) for s in (1, -1))
        slope = (ahead.loss - behind.loss) / (2.0 * step)
        assert abs(slope) > 1.0
        assert gradient @ directions[:, p] == pytest.approx(slope, rel=1e-6, abs=1e-5)
        assert here.values @ along[:, p] == pytest.approx(slope, rel=1e-6, abs=1e-5)
        assert np.allclose((ahead.values - behind.values) / (2.0 * step), along[:, p], atol=1e-5)


def test_quality_weighs_vertebrae_and_drops_corners(spine, trial) -> None:
    corners = trial.corners
    quality = np.ones(corners.quality.shape)
    quality[2], quality[5, 1] = 0.25, 0.0
    broken = corners.corners.copy()
    broken[5, 1] += 30.0
    weighted = Trial(trial.load, VertebraCorners(corners.vertebrae, broken, quality), trial.view, "weighted")
    plain, other = (
        residuals(spine.torso, make_target(spine.torso, t), spine.torso.rest_pose) for t in (trial, weighted)
    )
    assert np.allclose(other.values.reshape(-1, 8)[2], 0.5 * plain.values.reshape(-1, 8)[2])
    assert np.allclose(other.difference[2], plain.difference[2])
    assert np.abs(other.difference[5] - plain.difference[5]).max() < 2.0
    assert other.weights[5] == 1.0


def test_rmse_is_the_root_of_mean_squared_distances_without_weights(spine, trial) -> None:
    part = residuals(spine.torso, make_target(spine.torso, trial), spine.torso.rest_pose)
    distance2 = np.sum(part.difference**2, axis=2)
    assert part.rmse == pytest.approx(np.sqrt(distance2.mean()))
    assert root_mean_square([part, part]) == pytest.approx(part.rmse)


def test_too_few_vertebrae_are_refused(spine, trial) -> None:
    few = Trial(trial.load, trial.corners.selected(("T8", "T9")), trial.view, "frame 1")
    with pytest.raises(FitError, match="frame 1 shows 2 vertebrae"):
        make_target(spine.torso, few)


def test_push_is_the_label_unless_given(trial) -> None:
    assert Trial(trial.load, trial.corners, trial.view, "a").push == "a"
    assert Trial(trial.load, trial.corners, trial.view, "a", "b").push == "b"


@pytest.mark.parametrize("bones", [[3], [3, 5]])
def test_a_higher_push_keeps_the_force_and_raises_its_line(spine, bones) -> None:
    """One mm higher: same resultant, its moment about the AP axis grows by -F_x times one mm."""
    rest = spine.torso.rest_pose
    points = PointsOnBones(np.array(bones), np.tile([-40.0, 3.0, 0.0], (len(bones), 1)))
    load = LoadCase(points, np.tile([20.0, 0, 0], (len(bones), 1)))
    change = push_height_change(load, rest)
    assert np.abs(change.forces.sum(0)).max() < 1e-12
    moment = np.cross(change.points.positions(rest), change.forces).sum(0)
    assert moment == pytest.approx([0.0, 0.0, -load.forces.sum(0)[0]])


def test_a_push_on_tissue_nodes_has_no_height(spine) -> None:
    none = PointsOnBones(np.empty(0, np.int64), np.empty((0, 3)))
    load = LoadCase(none, np.empty((0, 3)), "pressed", np.array([0]), np.ones((1, 3)))
    with pytest.raises(FitError, match="the load acts on tissue nodes"):
        push_height_change(load, spine.torso.rest_pose)


def test_an_unloaded_reference_removes_errors_that_all_radiographs_share(spine, show, push_by) -> None:
    """Vertebrae annotated 2 mm off in every radiograph: places are wrong, motions are right."""
    ratios = stiffness_ratios(SOFT, spine.torso.joints.kinds)
    loaded, still = (show(spine, push_by(force), ratios) for force in (50.0, 0.0))
    offset = 2.0 * loaded.view.magnification * np.random.default_rng(6).standard_normal((len(loaded.corners), 1, 2))
    wrong, rest = (VertebraCorners(t.corners.vertebrae, t.corners.corners + offset) for t in (loaded, still))
    state = spine.solve(loaded.load, ratios).state
    found = [
        residuals(spine.torso, make_target(spine.torso, Trial(loaded.load, wrong, loaded.view, reference=r)), state)
        for r in (None, rest, rest.selected(rest.vertebrae[3:]))
    ]
    assert found[0].rmse == pytest.approx(found[1].rmse)
    assert found[0].loss > 10.0
    assert found[1].loss < 1e-16
    assert np.abs(found[2].fitted[:3]).max() > 0.1
    assert np.abs(found[2].fitted[3:]).max() < 1e-10
