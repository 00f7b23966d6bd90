"""What of an estimate's error through rendered radiographs is tracking's."""

from __future__ import annotations

import numpy as np
import pytest

from programs import benchmark
from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.imaging.features import VertebraCorners
from spinestiff.imaging.projection import frontal_view
from spinestiff.subject.outcomes import TrackedPush

share = benchmark("rendered_share")
NAMES = VERTEBRAE[3:]


@pytest.fixture
def truth():
    """(3, 17, 4, 2) mm on the detector: vertebrae that move and turn from frame to frame."""
    box = np.array([[-20.0, -12.0], [20.0, -12.0], [20.0, 12.0], [-20.0, 12.0]])
    middle = np.stack([np.zeros(17), 30.0 * np.arange(17.0)], axis=1)
    frames = []
    for size in (0.0, 1.0, 2.0):
        turns = size * 0.01 * np.cos(np.arange(17.0))
        turned = box + turns[:, None, None] * np.stack([-box[:, 1], box[:, 0]], axis=1)
        moved = middle + size * np.stack([3.0 * np.sin(np.arange(17.0) / 5.0), np.zeros(17)], axis=1)
        frames.append(moved[:, None] + turned)
    return np.stack(frames)


def tracked(truth, marks, drag=0.0):
    view, kept = frontal_view(), [VERTEBRAE.index(name) for name in NAMES]
    seen = truth[0] + (1.0 + drag) * (truth - truth[0]) + marks
    frames = [VertebraCorners(NAMES, corners[kept]) for corners in seen]
    return TrackedPush.of(view, frames)


def test_drag_is_the_share_of_the_motion_that_was_not_followed(truth):
    marks = np.random.default_rng(0).normal(0.0, 0.3, truth.shape[1:])
    exact = share.followed(tracked(truth, marks), truth)
    assert max(abs(value) for value in exact.values()) < 0.02
    found = share.followed(tracked(truth, marks, -0.05), truth)
    assert found["drag"] == pytest.approx(-0.05, abs=2e-3)
    assert found["drag_of_turns"] == pytest.approx(-0.05, abs=0.02)
    moved = (truth[1:, 3:] - truth[0, 3:]).mean(axis=2)[..., 0] / frontal_view().magnification
    assert found["shift_error_mm"] == pytest.approx(0.05 * np.sqrt(np.mean(moved**2)), abs=2e-3)


def test_errors_can_be_left_out_or_reversed_and_start_at_the_marks(truth):
    marks = np.random.default_rng(1).normal(0.0, 0.3, truth.shape[1:])
    found = tracked(truth, marks, -0.2)
    moved = share.with_errors(found, truth, 0.0)
    np.testing.assert_allclose(moved.corners(0).corners, found.corners(0).corners, atol=1e-3)
    np.testing.assert_allclose(moved.corners(2).corners, (truth[2] + marks)[3:], atol=1e-3)
    assert np.abs(found.corners(2).corners - moved.corners(2).corners).max() > 0.5
    reversed_ = share.with_errors(found, truth, -1.0)
    between = 0.5 * (found.corners(2).corners + reversed_.corners(2).corners)
    np.testing.assert_allclose(between, moved.corners(2).corners, atol=1e-3)


def test_supports_are_left_out(truth):
    told = tracked(truth, 0.0).model_dump()
    for frame in told["frames"][1:]:
        frame |= {"obliquity_deg": {"value": 1.0, "sd": 0.2}, "shoulder_mm": {"value": 2.0, "sd": 0.3}}
    found = share.without_supports(TrackedPush.model_validate(told))
    assert all(frame.obliquity_deg is None and frame.shoulder_mm is None for frame in found.frames)
    assert found.frames[1].corners_px == TrackedPush.model_validate(told).frames[1].corners_px


def test_figures_are_those_of_people_that_could_be_made():
    followed = {"low": {"drag": -0.01}, "high": {"drag": -0.03}}
    rows = [
        {"seed": seed, "code": "x", "followed": followed}
        | {kind: {"z": [size * (number + 1.0), 0.0], "p_value": 0.5} for number, kind in enumerate(share.KINDS)}
        for seed, size in ((1, 1.0), (2, 3.0))
    ]
    found = share.summed_up([*rows, {"seed": 3, "code": "x", "not made": "no"}])
    assert found["seeds"] == [1, 2] and found["not_made"] == [3]
    assert found["mean_z"]["as tracked"]["lateral_bending"] == [2.0, 1.0]
    assert found["z_apart"]["no supports less true motion"]["lateral_bending"] == [-4.0, 2.0]
    assert found["followed_median"] == {"drag": -0.02}
    with pytest.raises(SystemExit, match="no row has figures"):
        share.summed_up([{"seed": 3, "code": "x", "not made": "no"}])
    assert share._told([[1.0, 2.0]])["tissue"] == [2.0, None]
