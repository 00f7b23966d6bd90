"""Image residuals: zero where the picture is met, and derivatives that are the residuals' own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.state import TorsoState
from spinestiff.errors import TrackingError
from spinestiff.imaging.features import VertebraCorners, silhouette_shares, state_features
from spinestiff.imaging.pedicles import PediclePoints, pedicle_centres
from spinestiff.imaging.projection import frontal_view, lateral_view
from spinestiff.personalise.image_terms import UNKNOWNS, Shape, image_points, own_boxes, shape_of
from spinestiff.personalise.pose import posed

VIEWS = {"frontal": frontal_view(), "lateral": lateral_view()}
POSE = np.array([4.0, -7.0, 0.03, -0.06])


def pedicles_of(torso, view):
    rest = torso.rest_pose
    bones = torso.vertebra_bones
    local = pedicle_centres(torso)
    world = rest.bone_positions[bones][:, None] + np.einsum("vij,vsj->vsi", rest.bone_rotations[bones], local)
    return PediclePoints(torso.vertebrae, view.project(world))


def points_of(torso, view, corners, pedicles=None):
    return image_points(torso, view, corners, pedicles)


@pytest.fixture(scope="module")
def moved(template):
    """The template's vertebrae with every unknown off."""
    random = np.random.default_rng(0)
    shape = shape_of(template, template.rest_pose)
    return Shape(
        shape.positions + random.normal(0.0, 2.0, (17, 3)),
        exp_so3(random.normal(0.0, 0.05, (17, 3))) @ shape.rotations,
        random.normal(0.0, 0.05, (17, 3)),
        random.normal(0.0, 1.0, (17, 3)),
        random.normal(0.0, 0.03, (17, 3)),
    )


def stepped(shape, vertebra, unknown, step):
    own = np.zeros((17, UNKNOWNS))
    own[vertebra, unknown] = step
    return Shape(
        shape.positions + own[:, :3],
        exp_so3(own[:, 3:6]) @ shape.rotations,
        shape.log_sizes + own[:, 6:9],
        shape.pedicles + own[:, 9:12],
        shape.tapers + own[:, 12:],
    )


@pytest.mark.parametrize("name", VIEWS)
def test_a_torso_meets_its_own_picture(template, see, name):
    view = VIEWS[name]
    true = posed(view, POSE[:2], POSE[2], POSE[3])
    points = points_of(template, view, see(template, true), pedicles_of(template, true))
    residual = points.residuals(shape_of(template, template.rest_pose), POSE)
    assert residual.shape == (17 * 6, 2)
    assert np.abs(residual).max() < 1e-9
    assert np.abs(points.residuals(shape_of(template, template.rest_pose), 0.0 * POSE)).max() > 1.0


@pytest.mark.parametrize("name", VIEWS)
def test_the_silhouette_is_that_of_the_shape(template, name):
    """Bent by 30 degrees to one side and forwards, a spine shows corners at another depth than upright."""
    view, rest = VIEWS[name], template.rest_pose
    bones, turn = template.vertebra_bones, exp_so3(np.outer(np.linspace(-0.5, 0.5, 17), [0.7, 0.0, 1.0]))
    rotations = rest.bone_rotations.copy()
    rotations[bones] = turn @ rotations[bones]
    bent = TorsoState(rest.bone_positions, rotations, rest.tissue_positions)
    upright, shares = (silhouette_shares(template, view, state) for state in (rest, bent))
    assert (np.abs(upright - shares) > 0.3).sum() > 3
    corners = VertebraCorners(template.vertebrae, state_features(template, view, bent, shares).corners)
    residual = points_of(template, view, corners).residuals(shape_of(template, bent), np.zeros(4))
    assert np.abs(residual).max() < 1e-9


def test_a_residual_is_in_mm_at_the_patient_plane(template, see):
    """A corner 1 mm aside on the patient is 1.12 mm on the detector and 1 mm here."""
    view = VIEWS["frontal"]
    corners = see(template, view)
    off = VertebraCorners(corners.vertebrae, corners.corners - [view.magnification, 0.0])
    residual = points_of(template, view, off).residuals(shape_of(template, template.rest_pose), np.zeros(4))
    assert residual == pytest.approx(np.tile([1.0, 0.0], (68, 1)), abs=1e-9)


@pytest.mark.parametrize("name", VIEWS)
def test_derivatives_agree_with_differences(template, see, moved, name):
    view = VIEWS[name]
    points = points_of(template, view, see(template, view), pedicles_of(template, view))
    _, own, nuisance = points.linearised(moved, POSE)
    assert points.linearised(moved, POSE)[0] == pytest.approx(points.residuals(moved, POSE), abs=1e-12)
    for vertebra in (0, 8, 16):
        rows = points.vertebra == vertebra
        for unknown in range(UNKNOWNS):
            ahead, behind = (points.residuals(stepped(moved, vertebra, unknown, h), POSE) for h in (1e-5, -1e-5))
            wanted = (ahead - behind) / 2e-5
            assert own[rows][:, :, unknown] == pytest.approx(wanted[rows], abs=1e-5)
            assert not wanted[~rows].any()
    for unknown in range(4):
        step = 1e-6 * np.eye(4)[unknown]
        wanted = (points.residuals(moved, POSE + step) - points.residuals(moved, POSE - step)) / 2e-6
        assert nuisance[:, :, unknown] == pytest.approx(wanted, abs=1e-4)


def test_tapers_widen_and_deepen_the_upper_endplate_and_raise_the_front(template):
    zero = np.zeros((17, 3))
    sides = template.vertebra_boxes.reshape(17, 2, 2, 2, 3)

    def tapered(which):
        shape = shape_of(template, template.rest_pose)
        tapers = zero.copy()
        tapers[:, which] = 0.1
        return own_boxes(template, replace(shape, tapers=tapers)).reshape(17, 2, 2, 2, 3) / sides

    above = np.array([1.1, 0.9])[:, None, None] * np.ones((2, 2, 2))
    front = np.array([1.1, 0.9]) * np.ones((2, 2, 2))
    for which, axis, wanted in ((0, 0, above), (1, 2, above), (2, 1, front)):
        found = tapered(which)
        assert found[..., axis] == pytest.approx(np.broadcast_to(wanted, (17, 2, 2, 2)))
        assert np.delete(found, axis, -1) == pytest.approx(np.ones((17, 2, 2, 2, 2)))


@pytest.mark.parametrize("name", VIEWS)
def test_corners_are_those_of_the_shapes_own_boxes(template, see, moved, name):
    """A torso that has the boxes, seen as any torso is, leaves no residual."""
    view = VIEWS[name]
    torso = replace(template, vertebra_boxes=own_boxes(template, moved))
    poses = [template.rest_pose.bone_positions.copy(), template.rest_pose.bone_rotations.copy()]
    poses[0][template.vertebra_bones], poses[1][template.vertebra_bones] = moved.positions, moved.rotations
    state = TorsoState(*poses, template.rest_pose.tissue_positions)
    shares = silhouette_shares(torso, view, state)
    corners = VertebraCorners(torso.vertebrae, state_features(torso, view, state, shares).corners)
    points = image_points(template, view, corners)
    assert np.abs(points.residuals(moved, np.zeros(4))).max() < 1e-9


def test_what_was_not_seen_is_left_out(template, see):
    view = VIEWS["frontal"]
    corners = see(template, view, ("T5", "T6", "T7"))
    quality = np.ones((3, 4))
    quality[1, 2] = 0.0
    marked = pedicles_of(template, view)
    lost = np.array(marked.points)
    lost[:16] = np.nan
    lost[16, 0] = np.nan
    points = points_of(template, view, replace(corners, quality=quality), PediclePoints(marked.vertebrae, lost))
    assert len(points) == 12
    assert points.vertebra.tolist() == [4] * 4 + [5] * 3 + [6] * 4 + [16]
    assert points.outward.tolist() == [0.0] * 11 + [-1.0]


@pytest.mark.parametrize(
    ("names", "points", "message"),
    [
        (("T5", "T5"), np.zeros((2, 2, 2)), "more than once"),
        (("T5",), np.zeros((1, 2)), r"shape \(1, 2\), wanted \(1, 2, 2\)"),
    ],
)
def test_pedicles_that_make_no_sense_are_refused(names, points, message):
    with pytest.raises(TrackingError, match=message):
        PediclePoints(names, points)


def test_pedicles_of_an_unknown_vertebra_are_refused(template, see):
    view = VIEWS["frontal"]
    with pytest.raises(TrackingError, match="pedicles name T13"):
        points_of(template, view, see(template, view), PediclePoints(("T13",), np.zeros((1, 2, 2))))
