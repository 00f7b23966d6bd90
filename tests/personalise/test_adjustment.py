"""The bundle adjustment: a known shape is found, wrong corners are set aside, and the covariance means what it says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.rotation import exp_so3, log_so3
from spinestiff.errors import FitError
from spinestiff.imaging.features import VertebraCorners
from spinestiff.imaging.pedicles import PediclePoints
from spinestiff.imaging.projection import frontal_view, lateral_view
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.personalise.adjustment import _System, adjust
from spinestiff.personalise.image_terms import Shape, image_points, shape_of
from spinestiff.personalise.placing import pulled
from spinestiff.personalise.prior import elastic_prior, pelvis_on_springs

VIEWS = (frontal_view(shape=(1536, 1024)), lateral_view(shape=(1536, 1024)))
KNOWN = np.zeros((2, 4))
STANCE = np.array([[6.0, -4.0, 0.01, 0.0], [-5.0, 3.0, -0.008, 0.05]])


@pytest.fixture(scope="module")
def prior(template):
    return elastic_prior(EquilibriumProblem(template, pelvis_on_springs(template, frontal=True)), template.rest_pose)


def bent(template, aside_mm, waves):
    """A spine of its own sizes whose middle line is so many half waves."""
    rest = shape_of(template, template.rest_pose)
    height = (rest.positions[:, 1] - rest.positions[-1, 1]) / np.ptp(rest.positions[:, 1])
    aside = aside_mm * np.sin(waves * np.pi * height)
    tilt = -np.arctan(np.gradient(aside, rest.positions[:, 1]))
    random = np.random.default_rng(5)
    return Shape(
        rest.positions + np.outer(aside, [1.0, 0.0, 0.3]),
        exp_so3(np.outer(tilt, [0.0, 0.0, 1.0])) @ rest.rotations,
        random.normal(0.03, 0.03, (17, 3)),
        random.normal(0.0, 1.0, (17, 3)),
        random.normal(0.0, 0.02, (17, 3)),
    )


@pytest.fixture(scope="module")
def girl(template):
    """A curve of about 20 degrees, half a standard deviation of size."""
    return bent(template, 8.0, 1)


def pictures(template, girl, noise, seed=0, stance=KNOWN):
    """Annotated points with Gaussian noise (mm at the patient plane along each axis)."""
    random = np.random.default_rng(seed)
    found = []
    for view, pose in zip(VIEWS, stance):
        points = image_points(template, view, VertebraCorners(template.vertebrae, np.zeros((17, 4, 2))))
        seen = points.residuals(girl, pose) * view.magnification
        found.append(replace(points, measured=seen + random.normal(0.0, noise * view.magnification, seen.shape)))
    return found


def start(template):
    return shape_of(template, template.rest_pose)


def centre_errors(found, girl):
    return np.linalg.norm(found.shape.positions - girl.positions, axis=1)


def turn_errors(found, girl):
    return log_so3(found.shape.rotations @ np.swapaxes(girl.rotations, 1, 2))


def test_exact_corners_give_the_shape(template, prior, girl):
    found = adjust(pictures(template, girl, 0.0), prior, start(template), KNOWN, KNOWN)
    assert centre_errors(found, girl).max() < 0.3
    assert np.degrees(np.abs(turn_errors(found, girl)[:, [0, 2]])).max() < 0.7
    assert np.exp(found.shape.log_sizes) == pytest.approx(np.exp(girl.log_sizes), abs=0.03)
    assert min(weights.min() for weights in found.weights) > 0.5


def test_the_noise_is_read_from_the_residuals(template, prior, girl):
    for noise in (0.5, 1.5):
        found = adjust(pictures(template, girl, noise), prior, start(template), KNOWN, KNOWN)
        assert found.corner_sd == pytest.approx(noise, rel=0.15)


def test_answers_of_unlike_noise_are_compared_by_the_density_of_their_residuals(template, prior, girl):
    """With residuals of nothing the cost is the logarithm of the variances: a pedicle's own scatter is part of its."""
    view, pose = VIEWS[0], KNOWN[0]
    marked = PediclePoints(template.vertebrae[3:9], np.zeros((6, 2, 2)))
    points = image_points(template, view, VertebraCorners(template.vertebrae, np.zeros((17, 4, 2))), marked)
    exact = replace(points, measured=points.residuals(girl, pose) * view.magnification)
    system = _System([exact], prior, KNOWN[:1])
    low, high = (system.normal(girl, KNOWN[:1], sd).cost for sd in (0.5, 2.0))
    corners, pedicles = 17 * 4, 6 * 2
    wanted = corners * np.log(2.0**2 / 0.5**2) + pedicles * np.log((2.0**2 + 1.0) / (0.5**2 + 1.0))
    assert high - low == pytest.approx(wanted)


def test_the_covariance_is_the_errors(template, prior, girl):
    """Over draws of the noise: errors of place and tilt over their own standard deviations are about 1."""
    scaled = []
    for seed in range(4):
        found = adjust(pictures(template, girl, 0.7, seed), prior, start(template), KNOWN, KNOWN)
        sd = np.sqrt(np.diag(found.covariance)).reshape(17, 15)[:, :6]
        error = np.hstack([found.shape.positions - girl.positions, turn_errors(found, girl)])
        scaled.append((error / sd)[:, [0, 1, 2, 3, 5]])
    rms = np.sqrt(np.mean(np.square(scaled), axis=(0, 1)))
    assert (rms > 0.6).all()
    assert (rms < 1.4).all()


def test_a_wrong_corner_is_set_aside(template, prior, girl):
    views = pictures(template, girl, 0.5)
    clean = adjust(views, prior, start(template), KNOWN, KNOWN)
    measured = views[0].measured.copy()
    measured[4 * 8 + 1] += [12.0, -9.0]
    found = adjust([replace(views[0], measured=measured), views[1]], prior, start(template), KNOWN, KNOWN)
    wrong = np.flatnonzero(found.weights[0] < 0.1)
    assert wrong.tolist() == [4 * 8 + 1]
    assert found.weights[1].min() > 0.1
    assert np.linalg.norm(found.shape.positions - clean.shape.positions, axis=1).max() < 0.4


def test_a_wrong_pedicle_is_set_aside_as_a_wrong_corner_is(template, prior, girl):
    """8 mm off, eight times as far as pedicles lie beside their places."""
    random, yaws = np.random.default_rng(3), []
    marked = PediclePoints(template.vertebrae, np.zeros((17, 2, 2)))
    points = image_points(template, VIEWS[0], VertebraCorners(template.vertebrae, np.zeros((17, 4, 2))), marked)
    seen = points.residuals(girl, KNOWN[0])
    seen += random.normal(size=seen.shape) * np.where(points.outward == 0.0, 0.5, np.hypot(0.5, 1.0))[:, None]
    lateral, wrong = pictures(template, girl, 0.5)[1], 17 * 4 + 2 * 9
    for off in (0.0, 8.0):
        seen[wrong, 0] += off
        frontal = replace(points, measured=seen * VIEWS[0].magnification)
        found = adjust([frontal, lateral], prior, start(template), KNOWN, KNOWN)
        assert np.flatnonzero(found.weights[0] < 0.1).tolist() == ([wrong] if off else [])
        yaws.append(turn_errors(found, girl)[9, 1])
    assert np.degrees(np.abs(np.diff(yaws))) < 2.0


def test_a_residual_as_far_as_the_cutoff_has_a_quarter_of_its_weight(template, prior, girl):
    """Four standard deviations, a pedicle's own scatter among them, or 3 mm where that is more."""
    marked = PediclePoints(template.vertebrae[9:10], np.zeros((1, 2, 2)))
    points = image_points(template, VIEWS[0], VertebraCorners(template.vertebrae, np.zeros((17, 4, 2))), marked)
    for sd, corner, pedicle in ((0.25, 3.0, 4.0 * np.hypot(0.25, 1.0)), (2.0, 8.0, 4.0 * np.hypot(2.0, 1.0))):
        seen = points.residuals(girl, KNOWN[0])
        seen[:, 0] += np.where(points.outward == 0.0, corner, pedicle)
        system = _System([replace(points, measured=seen * VIEWS[0].magnification)], prior, KNOWN[:1])
        assert system.normal(girl, KNOWN[:1], sd).weights == pytest.approx(np.full(len(points), 0.25))


def test_swapped_names_are_told_by_the_other_view(template, prior, girl):
    """T8 and T9 exchanged in the lateral picture: the frontal one and the neighbours outvote it."""
    views = pictures(template, girl, 0.5)
    measured = views[1].measured.reshape(17, 4, 2).copy()
    measured[[7, 8]] = measured[[8, 7]]
    found = adjust(
        [views[0], replace(views[1], measured=measured.reshape(-1, 2))], prior, start(template), KNOWN, KNOWN
    )
    assert np.flatnonzero((found.weights[1].reshape(17, 4) < 0.1).all(1)).tolist() == [7, 8]
    assert found.weights[0].min() > 0.1
    assert centre_errors(found, girl).max() < 2.5
    assert np.delete(centre_errors(found, girl), [7, 8]).max() < 1.2


def test_an_unusual_vertebra_is_no_wrong_one(template, prior, girl):
    """T12 is 15 mm nearer to T11 than in anybody: both views agree on it, so it is where they say."""
    places = girl.positions.copy()
    places[11] += 15.0 * girl.rotations[11, :, 1]
    odd = replace(girl, positions=places)
    found = adjust(pictures(template, odd, 0.5), prior, start(template), KNOWN, KNOWN)
    assert min(weights.min() for weights in found.weights) > 0.1
    assert centre_errors(found, odd).max() < 1.2


def test_nor_is_it_under_a_prior_around_a_moved_state(template, girl):
    """Such a prior has a slope, which its density is normalised by as well."""
    problem = EquilibriumProblem(template, pelvis_on_springs(template, frontal=True))
    places = girl.positions.copy()
    places[11] += 15.0 * girl.rotations[11, :, 1]
    odd = replace(girl, positions=places)
    there = elastic_prior(problem, pulled(problem, template.rest_pose, odd.positions, odd.rotations, (1e2, 1e4)))
    found = adjust(pictures(template, odd, 0.5), there, odd, KNOWN, KNOWN)
    assert min(weights.min() for weights in found.weights) > 0.1
    assert centre_errors(found, odd).max() < 1.2


def test_a_curve_of_eighty_degrees_is_no_turned_body(template, prior):
    """Far from the template a spine looks like wrong corners, or like one whose kyphosis is seen from aside."""
    strong = bent(template, 50.0, 2)
    tilt = np.degrees(np.arcsin(strong.rotations[:, 0, 1]))
    assert np.ptp(tilt) > 75.0
    found = adjust(pictures(template, strong, 0.5), prior, start(template), KNOWN, KNOWN)
    assert min(weights.min() for weights in found.weights) > 0.1
    assert centre_errors(found, strong).max() < 1.5
    assert np.degrees(np.abs(turn_errors(found, strong)[:, 1])).max() < 15.0


def test_a_stance_is_found_with_its_prior(template, prior, girl):
    sd = np.array([[200.0, 200.0, 0.012, 0.0], [200.0, 200.0, 0.012, 0.05]])
    found = adjust(pictures(template, girl, 0.3, stance=STANCE), prior, start(template), KNOWN, sd)
    assert found.poses[0, 3] == 0.0
    # What is a shift of the person and what of the spine is told apart by the elastic prior alone.
    assert found.poses[:, :2] == pytest.approx(STANCE[:, :2], abs=2.0)
    assert found.pose_covariance[3].tolist() == [0.0] * 8
    assert np.sqrt(found.pose_covariance[2, 2]) < 0.012


def test_what_no_image_shows_is_the_priors(template, prior, girl):
    """T1 to T3 in no picture: held by the prior alone, and far less certain than what is seen."""
    views = []
    for view in pictures(template, girl, 0.5):
        keep = view.vertebra > 2
        parts = {key: getattr(view, key)[keep] for key in ("vertebra", "pair", "outward", "measured")}
        views.append(replace(view, **parts))
    found = adjust(views, prior, start(template), KNOWN, KNOWN)
    assert found.prior_share[:3] == pytest.approx(np.ones((3, 6)), abs=1e-9)
    assert (found.prior_share[3:, :4] < 0.5).all()
    sd = np.sqrt(np.diag(found.covariance)).reshape(17, 15)
    assert sd[0, 0] > 10.0 * sd[8, 0]
    assert centre_errors(found, girl)[0] < 4.0 * sd[0, :3].max()


def test_corners_of_something_else_are_refused(template, prior, girl):
    views = pictures(template, girl, 0.5)
    random = np.random.default_rng(1)
    nonsense = [replace(v, measured=v.measured + random.uniform(-200.0, 200.0, v.measured.shape)) for v in views]
    with pytest.raises(FitError, match="contradict each other"):
        adjust(nonsense, prior, start(template), KNOWN, KNOWN)
