"""Where the patient stood: a known motion of the view is found again."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.anatomy.template import template_torso
from spinestiff.errors import TrackingError
from spinestiff.imaging.features import VertebraCorners, silhouette_shares, state_features
from spinestiff.imaging.projection import frontal_view, lateral_view
from spinestiff.personalise.pose import Stance, align_view, posed


@pytest.fixture(scope="module")
def torso():
    return template_torso(157.0, "coarse")


def seen(torso, view, shares, rows=slice(None)):
    corners = state_features(torso, view, torso.rest_pose, shares).corners
    return VertebraCorners(torso.vertebrae[rows], corners[rows])


@pytest.mark.parametrize("make", [frontal_view, lateral_view])
def test_a_patient_moved_looks_as_from_a_moved_view(make):
    """Both ways to say how the patient stood give one picture, and the way's slope is its own."""
    nominal, pose = make(), np.array([7.0, -4.0, 0.05, 0.1])
    points = np.random.default_rng(0).normal(0.0, 80.0, (9, 3)) + [0.0, 200.0, 0.0]
    stance, view = Stance(nominal, pose), posed(nominal, pose[:2], pose[2], pose[3])
    assert np.abs(nominal.project(points) - view.project(points)).max() > 3.0
    assert nominal.project(stance.moved(points)) == pytest.approx(view.project(points), abs=1e-10)
    slope = stance.jacobian(stance.moved(points))
    for i, step in enumerate(1e-5 * np.eye(4)):
        wanted = (Stance(nominal, pose + step).moved(points) - Stance(nominal, pose - step).moved(points)) / 2e-5
        assert slope[:, :, i] == pytest.approx(wanted, abs=1e-6)


def test_a_yaw_turns_the_patient_to_the_left():
    """Facing the source of a frontal view and turned left, the nose is seen at larger columns."""
    view = frontal_view()
    nose = np.array([0.0, 200.0, 100.0])
    assert posed(view, np.zeros(2), 0.0, 0.1).project(nose)[0] > view.project(nose)[0] + 5.0


@pytest.mark.parametrize("make", [frontal_view, lateral_view])
@pytest.mark.parametrize(("shift", "roll"), [((8.0, -5.0), 0.03), ((-20.0, 12.0), -0.08), ((0.0, 0.0), 0.0)])
def test_a_moved_view_is_found(torso, make, shift, roll):
    nominal = make()
    shares = silhouette_shares(torso, nominal, torso.rest_pose)
    true = nominal.moved(shift, roll)
    found, pose = align_view(torso, torso.rest_pose, nominal, seen(torso, true, shares), shares)
    assert pose.shift == pytest.approx(shift, abs=1e-6)
    assert pose.roll == pytest.approx(roll, abs=1e-8)
    assert pose.rms_mm < 1e-6
    assert found.source == pytest.approx(true.source, abs=1e-5)
    assert found.detector_origin == pytest.approx(true.detector_origin, abs=1e-5)
    assert found.detector_axes == pytest.approx(true.detector_axes, abs=1e-8)


def test_corners_that_were_lost_shift_nothing(torso):
    """Both boxes are placed by the corners that were followed; what a lost one was guessed to be says nothing."""
    nominal = frontal_view()
    shares = silhouette_shares(torso, nominal, torso.rest_pose)
    corners = seen(torso, nominal.moved((8.0, -5.0), 0.03), shares)
    places, quality = corners.corners.copy(), corners.quality.copy()
    places[:, 0] += 30.0
    quality[:, 0] = 0.0
    lost = VertebraCorners(torso.vertebrae, places, quality)
    _, pose = align_view(torso, torso.rest_pose, nominal, lost, shares)
    assert pose.shift == pytest.approx((8.0, -5.0), abs=1e-6)
    assert pose.roll == pytest.approx(0.03, abs=1e-8)
    assert pose.rms_mm < 1e-6


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_a_roll_may_be_left_to_the_torso(torso, share):
    """The view takes its share; the middles of both pictures meet all the same."""
    nominal = frontal_view()
    shares = silhouette_shares(torso, nominal, torso.rest_pose)
    corners = seen(torso, nominal.moved((8.0, -5.0), 0.05), shares)
    view, pose = align_view(torso, torso.rest_pose, nominal, corners, shares, roll_share=share)
    assert pose.roll == pytest.approx(share * 0.05, abs=1e-4)
    assert pose.rms_mm > 1.0
    shown, wanted = (
        view.to_patient_plane(c).reshape(-1, 2).mean(0) for c in (seen(torso, view, shares).corners, corners.corners)
    )
    assert shown == pytest.approx(wanted, abs=1e-3)


def test_part_of_the_spine_is_enough(torso):
    nominal = frontal_view()
    shares = silhouette_shares(torso, nominal, torso.rest_pose)
    corners = seen(torso, nominal.moved((6.0, 3.0), 0.05), shares, slice(2, 11))
    _, pose = align_view(torso, torso.rest_pose, nominal, corners, shares)
    assert pose.shift == pytest.approx((6.0, 3.0), abs=1e-6)
    assert pose.roll == pytest.approx(0.05, abs=1e-8)


def test_what_no_pose_explains_is_reported(torso):
    """Every other vertebra 1 mm aside (at the patient plane): the pose stays and 1 mm remains."""
    nominal = frontal_view()
    shares = silhouette_shares(torso, nominal, torso.rest_pose)
    corners = seen(torso, nominal, shares, slice(0, 16))
    aside = np.where(np.arange(16) % 2, 1.0, -1.0)[:, None, None] * [1.0, 0.0] * nominal.magnification
    _, pose = align_view(
        torso, torso.rest_pose, nominal, VertebraCorners(corners.vertebrae, corners.corners + aside), shares
    )
    assert pose.rms_mm == pytest.approx(1.0, abs=0.05)
    assert np.abs(pose.shift).max() < 0.1


def test_no_vertebra_at_all_is_refused(torso):
    with pytest.raises(TrackingError, match="no vertebra is left"):
        align_view(torso, torso.rest_pose, frontal_view(), VertebraCorners((), np.empty((0, 4, 2))))
