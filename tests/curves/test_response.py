"""N per degree and flexibility from simulated corners: values, intervals that hold, and nothing that is not known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.curves.response import FrameCorners, GaugeError, push_response
from spinestiff.curves.tilts import tilts_from_points
from spinestiff.errors import SpinestiffError
from spinestiff.imaging.tracking.quality import quality_of

PLACE = np.linspace(0.0, 1.0, 17)
CURVE = 0.5 * np.cos(np.pi * np.clip((PLACE - 0.2) / 0.6, 0.0, 1.0))
"""Tilts of a spine with a curve of 1 degree, degrees."""
BENDING = -0.5 * np.cos(np.pi * np.clip((PLACE - 0.3) / 0.5, 0.0, 1.0))
"""Change of the tilts by a push that takes 1 degree from the curve; its ends lie elsewhere."""
BODY = np.array([[17.0, 9.0], [-17.0, 9.0], [-17.0, -9.0], [17.0, -9.0]])
ANNOTATION_MM = 0.68
TRACKING_MM = 0.2
STEPS = (0.0, 20.0, 40.0, 60.0)


def corners_of(tilt_deg, marked=0.0):
    """Corners (17, 4, 2) of these tilts; ``marked`` is how far beside the truth they were marked, on the bodies."""
    a = np.radians(tilt_deg)
    turn = np.stack([np.cos(a), -np.sin(a), np.sin(a), np.cos(a)], axis=1).reshape(-1, 2, 2)
    middles = np.stack([np.zeros(17), -25.0 * np.arange(17)], axis=1)
    return (BODY + marked) @ turn.transpose(0, 2, 1) + middles[:, None]


def frames_of(angles, forces=STEPS, random=None, origins=None):
    """A frame for each tilt profile; with ``random`` annotated and tracked with errors, the first frame annotated."""
    origins = origins or [0] * len(angles)
    marks = {
        origin: 0.0 if random is None else random.normal(0.0, ANNOTATION_MM, (17, 4, 2))
        for origin in sorted({*origins})
    }
    frames = []
    for index, (angle, force, origin) in enumerate(zip(angles, forces, origins, strict=True)):
        points, error = corners_of(angle, marks[origin]), 0.0 if index == origin else TRACKING_MM
        if random is not None:
            points = points + random.normal(0.0, error / np.sqrt(2.0), points.shape)
        quality = np.full((17, 4), float(quality_of(np.array(error))))
        frames.append(FrameCorners(index, force, VERTEBRAE, points, quality, origin))
    return frames


def rest_of(cobb_deg, random=None):
    noise = 0.0 if random is None else random.normal(0.0, ANNOTATION_MM, (17, 4, 2))
    return tilts_from_points(VERTEBRAE, corners_of(cobb_deg * CURVE) + noise)


def between(profile, levels):
    upper, lower = (VERTEBRAE.index(level) for level in levels)
    return float(profile[upper] - profile[lower])


def holds(interval, value):
    return interval.low <= value and (interval.high is None or value <= interval.high)


def test_without_errors_the_numbers_are_the_true_ones():
    found = push_response(frames_of([25.0 * CURVE + 0.2 * force * BENDING for force in STEPS]), rest_of(25.0))
    assert found.missing == "" and found.force_n == 60.0
    assert found.tilt.levels == ("T5", "L2") and found.tilt.frames == (0, 1, 2, 3)
    assert found.tilt.n_per_degree.value == pytest.approx(1.0 / 0.2)
    assert found.tilt.change_deg == pytest.approx(-12.0)
    assert found.curve.levels == ("T4", "L2") and found.curve.rest_deg == pytest.approx(25.0)
    assert found.curve.n_per_degree.value == pytest.approx(1.0 / 0.2)
    assert found.curve.scatter == pytest.approx(0.0, abs=1e-6)
    assert found.flexibility.percent == pytest.approx(100.0 * 12.0 / 25.0)
    for interval, value in ((found.tilt.n_per_degree, 5.0), (found.curve.n_per_degree, 5.0), (found.flexibility, 48.0)):
        assert interval.low < value < interval.high


def test_the_order_of_the_frames_changes_nothing():
    """A push that is let go frame by frame, or comes back to no force at its end."""
    frames = frames_of([30.0 * CURVE + force * 0.2 * BENDING for force in STEPS], random=np.random.default_rng(3))
    up = push_response(frames, rest_of(30.0))
    for order in ((3, 2, 1, 0), (1, 3, 0, 2)):
        found = push_response([frames[i] for i in order], rest_of(30.0))
        for angle in ("tilt", "curve"):
            one, other = getattr(found, angle), getattr(up, angle)
            assert one.frames == order
            for name in ("rest_deg", "change_deg", "change_sd_deg", "scatter"):
                assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-6)
            assert one.n_per_degree.value == pytest.approx(other.n_per_degree.value, rel=1e-6)
        assert found.flexibility.percent == pytest.approx(up.flexibility.percent, rel=1e-6)
        assert found.flexibility.low == pytest.approx(up.flexibility.low, rel=1e-6)
    assert up.curve.change_deg < -5.0


def test_a_push_that_makes_the_curve_larger_has_a_flexibility_below_zero():
    found = push_response(frames_of([25.0 * CURVE - 0.1 * force * BENDING for force in STEPS]), rest_of(25.0))
    assert found.flexibility.percent == pytest.approx(-100.0 * 6.0 / 25.0)
    assert found.flexibility.high < 0.0
    assert found.curve.n_per_degree.value == pytest.approx(10.0)


@pytest.mark.parametrize(
    ("per_n", "forces"),
    [(0.3, STEPS), (0.3, (0.0, 60.0)), (0.03, STEPS), (0.0, STEPS)],
    ids=["large", "one frame", "small", "none"],
)
def test_intervals_hold_the_truth(per_n, forces):
    """Of 400 pushes with errors of corners, annotation and gauge: 95 %, within what 400 draws leave open."""
    random, cobb, draws = np.random.default_rng(5), 25.0, 400
    held, told = np.zeros(3), np.zeros(2)
    for _ in range(draws):
        scale, zero = 1.0 + 0.02 * random.standard_normal(), 1.5 * random.standard_normal()
        true = [force * scale + zero if force else 0.0 for force in forces]
        found = push_response(
            frames_of([cobb * CURVE + per_n * force * BENDING for force in true], forces, random), rest_of(cobb, random)
        )
        bent, curve = per_n * BENDING, cobb * CURVE
        for row, one in enumerate((found.tilt, found.curve)):
            change = abs(between(bent, one.levels))
            held[row] += holds(one.n_per_degree, 1.0 / change if change else np.inf)
            told[row] += one.n_per_degree.value is not None
        share = -between(bent, found.curve.levels) * true[-1] / between(curve, found.curve.levels)
        held[2] += holds(found.flexibility, 100.0 * share)
    assert np.all(held / draws >= 0.925)
    # The curve's levels are chosen in another picture, so that its intervals are no wider than they have to be.
    assert np.all(held[1:] / draws <= 0.985)
    if per_n == 0.0:
        assert np.all(told / draws <= 0.075)
    if per_n == 0.3:
        assert np.all(told == draws)


def test_an_angle_that_does_not_change_has_one_end():
    random = np.random.default_rng(8)
    found = push_response(frames_of([25.0 * CURVE] * 4, random=random), rest_of(25.0))
    for one in (found.tilt, found.curve):
        assert one.n_per_degree.value is None and one.n_per_degree.high is None
        # What hides in errors of half a degree under 60 N.
        assert 20.0 < one.n_per_degree.low < 300.0


def test_the_gauge_s_errors_widen_the_interval_and_nothing_else():
    frames, rest = frames_of([25.0 * CURVE + 0.2 * force * BENDING for force in STEPS]), rest_of(25.0)
    ends = [push_response(frames, rest, gauge).curve for gauge in (GaugeError(0.0, 0.0), GaugeError(0.1, 0.0))]
    sharp, blunt = (np.log(one.n_per_degree.high / one.n_per_degree.low) / 4.0 for one in ends)
    assert blunt == pytest.approx(np.hypot(sharp, 0.1), rel=0.03)


def test_a_zero_that_is_not_known_leaves_what_the_loaded_frames_say_of_each_other():
    frames, rest = frames_of([25.0 * CURVE + 0.2 * force * BENDING for force in STEPS]), rest_of(25.0)
    for count, low in ((4, 4.0), (2, 0.0)):
        found = push_response(frames[:count], rest, GaugeError(0.0, 1000.0)).curve.n_per_degree
        assert found.low > low and (count == 4) == (found.high is not None)


def test_annotating_a_second_frame_widens_what_the_first_alone_told():
    angles, rest = [25.0 * CURVE + 0.2 * force * BENDING for force in STEPS], rest_of(25.0)
    once = push_response(frames_of(angles), rest).curve
    twice = push_response(frames_of(angles, origins=[0, 0, 3, 3]), rest).curve
    assert twice.change_sd_deg > 3.0 * once.change_sd_deg
    assert twice.n_per_degree.low < once.n_per_degree.low < once.n_per_degree.high < twice.n_per_degree.high


def test_the_annotation_s_error_is_that_of_the_picture_s_median_width():
    """Two broad end vertebrae are no reason for a larger error of their corners."""
    frames = frames_of([25.0 * CURVE + 0.2 * force * BENDING for force in STEPS])
    broad = np.ones((17, 1, 1))
    broad[[VERTEBRAE.index(level) for level in ("T4", "L2")]] = 2.0
    wide = []
    for frame in frames:
        middles = frame.points.mean(axis=1, keepdims=True)
        wide.append(replace(frame, points=middles + broad * (frame.points - middles)))
    usual, widened = (push_response(each, rest_of(25.0)).flexibility for each in (frames, wide))
    # Twice as broad, with the same error of a corner: the angle at rest is known twice as well.
    assert widened.high - widened.low < 0.7 * (usual.high - usual.low)


def test_frames_off_a_line_widen_the_interval():
    angles = [25.0 * CURVE + bent * BENDING for bent in (0.0, 4.0, 8.0, 12.0)]
    bent = [*angles[:2], angles[1], angles[3]]
    straight, off = (push_response(frames_of(one), rest_of(25.0)).curve for one in (angles, bent))
    assert straight.scatter < 1.0 < 3.0 < off.scatter
    widths = [np.log(one.n_per_degree.high / one.n_per_degree.low) for one in (straight, off)]
    assert widths[1] > 2.0 * widths[0]


def test_a_vertebra_that_a_frame_lost_is_none_of_its_ends():
    frames = frames_of([25.0 * CURVE + 0.2 * force * BENDING for force in STEPS])
    middle = push_response([frames[0], without(frames[1], "T5"), *frames[2:]], rest_of(25.0))
    assert middle.tilt.levels == ("T5", "L2") and middle.tilt.frames == (0, 2, 3)
    assert middle.curve.frames == (0, 1, 2, 3)
    last = push_response([*frames[:3], without(frames[3], "T5")], rest_of(25.0))
    assert "T5" not in last.tilt.levels


def without(frame, *levels):
    """The frame with one corner of each of these vertebrae lost."""
    quality = np.array(frame.quality)
    quality[[VERTEBRAE.index(level) for level in levels], 2] = 0.0
    return replace(frame, quality=quality)


def test_a_corner_that_is_lost_under_the_largest_force_leaves_the_levels():
    """The curve stays between the rest picture's end vertebrae, up to the largest force that shows both."""
    frames = frames_of([25.0 * CURVE + 0.2 * force * BENDING for force in STEPS])
    whole = push_response(frames, rest_of(25.0))
    lost = push_response([*frames[:3], without(frames[3], "T4")], rest_of(25.0))
    assert lost.force_n == 40.0 and lost.instead_of is whole.instead_of is None
    assert lost.curve.levels == whole.curve.levels == ("T4", "L2") and lost.curve.frames == (0, 1, 2)
    assert lost.curve.change_deg == pytest.approx(-8.0) and lost.flexibility.percent == pytest.approx(32.0)
    # Tilt goes on to the largest force, where its own two vertebrae are shown.
    assert lost.tilt.levels == whole.tilt.levels and lost.tilt.frames == (0, 1, 2, 3)
    assert lost.tilt.change_deg == pytest.approx(-12.0)
    first = push_response([without(frames[0], "T4"), *frames[1:], replace(frames[0], frame=4)], rest_of(25.0))
    assert first.curve.levels == ("T4", "L2") and first.curve.frames == (1, 2, 3, 4)


def test_end_vertebrae_that_no_loaded_frame_shows_give_way_to_others_and_are_told():
    frames = frames_of([25.0 * CURVE + 0.2 * force * BENDING for force in STEPS])
    found = push_response([frames[0], *(without(frame, "T4", "T5") for frame in frames[1:])], rest_of(25.0))
    assert found.instead_of == ("T4", "L2") and found.force_n == 60.0
    assert found.curve.levels == ("T3", "L2") and found.curve.frames == (0, 1, 2, 3)


def test_end_vertebrae_that_a_small_force_alone_shows_give_way_too():
    """T4 leaves the picture above a twelfth of the largest force: what is left says nothing of the push."""
    forces = (0.0, 5.0, 20.0, 40.0, 60.0)
    frames = frames_of([25.0 * CURVE + 0.2 * force * BENDING for force in forces], forces)
    found = push_response([*frames[:2], *(without(frame, "T4") for frame in frames[2:])], rest_of(25.0))
    assert found.instead_of == ("T4", "L2") and found.force_n == 60.0
    assert found.tilt.frames[-1] == 4 and found.tilt.change_deg == pytest.approx(-12.0, abs=1.5)
    assert found.flexibility.percent > 30.0


def test_a_straight_spine_has_no_flexibility():
    random = np.random.default_rng(2)
    found = push_response(frames_of([0.2 * force * BENDING for force in STEPS], random=random), rest_of(0.5, random))
    assert found.flexibility.percent is None and found.flexibility.low is None
    assert found.tilt.n_per_degree.value is not None


@pytest.mark.parametrize(
    ("kept", "said"),
    [((1, 2, 3), "no usable frame without force"), ((0,), "no usable frame under a force"), ((), "without force")],
)
def test_what_is_missing_is_said(kept, said):
    frames = frames_of([25.0 * CURVE + 0.2 * force * BENDING for force in STEPS])
    found = push_response([frames[i] for i in kept], rest_of(25.0))
    assert said in found.missing and found.curve is None and found.tilt is None and found.flexibility is None


def test_frames_without_a_vertebra_in_common_are_said():
    frames = frames_of([25.0 * CURVE, 20.0 * CURVE], (0.0, 60.0))
    upper = np.where(np.arange(17)[:, None] < 8, 1.0, 0.0) * np.ones(4)
    parts = [replace(frames[0], quality=upper), replace(frames[1], quality=1.0 - upper)]
    assert "frames 0 and 1 show fewer than two" in push_response(parts, rest_of(25.0)).missing


def test_a_frame_that_was_lost_leaves_the_others_their_say():
    """The largest force, or the first frame without force: what is left is as if the frame had not been taken."""
    forces = (0.0, *STEPS)
    frames = frames_of([25.0 * CURVE + 0.2 * force * BENDING for force in forces], forces)
    for number in (0, 4):
        lost = replace(frames[number], quality=np.zeros((17, 4)))
        found = push_response([lost if i == number else frame for i, frame in enumerate(frames)], rest_of(25.0))
        assert found == push_response([*frames[:number], *frames[number + 1 :]], rest_of(25.0))
        assert found.curve.n_per_degree.value == pytest.approx(5.0) and found.force_n == (40.0 if number else 60.0)
    nothing = [replace(frame, quality=np.zeros((17, 4))) if frame.force_n else frame for frame in frames]
    assert push_response(nothing, rest_of(25.0)).missing == "no usable frame under a force"


@pytest.mark.parametrize("wrong", [(-0.1, 1.0), (0.02, float("nan"))])
def test_impossible_errors_of_a_gauge_are_refused(wrong):
    with pytest.raises(SpinestiffError, match="gauge errors: wanted >= 0"):
        GaugeError(*wrong)
