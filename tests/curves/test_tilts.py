"""RMSE, tilt and Cobb angle: exact cases, signs, ties, mirror, and labelled radiographs."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.curves.tilts import SpineTilts, cobb_angle, cobb_change, tilts, tilts_from_points
from spinestiff.errors import SpinestiffError
from spinestiff.imaging.features import rmse
from spinestiff.imaging.projection import frontal_view, lateral_view, placed_view

LABELLED = Path(__file__).parents[3] / "shared/data/scoliosis_radiographs"


def boxes(degrees, heights=25.0, widths=40.0, wedge=0.0):
    """Corners (n, 4, 2) as (left, up) of a stack of boxes with the given tilts; ``wedge`` opens each to the left."""
    turn = np.radians(np.asarray(degrees, dtype=float))
    centres = np.zeros((len(turn), 2))
    for i in range(1, len(turn)):
        half = 0.5 * (turn[i - 1] + turn[i])
        centres[i] = centres[i - 1] - heights * 1.3 * np.array([-np.sin(half), np.cos(half)])
    plates = []
    for sign in (1.0, -1.0):
        angle = turn + sign * np.radians(wedge)
        along = 0.5 * widths * np.stack([np.cos(angle), np.sin(angle)], 1)
        middle = centres + sign * 0.5 * heights * np.stack([-np.sin(turn), np.cos(turn)], 1)
        plates.append((middle + along, middle - along))
    (sl, sr), (il, ir) = plates
    return np.stack([sl, sr, ir, il], 1)


def spine(degrees, **shape):
    names = VERTEBRAE[: len(degrees)]
    return tilts_from_points(names, boxes(degrees, **shape))


def test_rmse_counts_corners_not_coordinates():
    a = np.zeros((2, 2, 2))
    b = a.copy()
    b[0, 0] = [3.0, 4.0]
    assert rmse(a, b) == pytest.approx(2.5)
    assert rmse(a, a) == 0.0


@pytest.mark.parametrize(
    ("a", "b", "message"),
    [
        (np.zeros((2, 2)), np.zeros((3, 2)), "same shape"),
        (np.zeros((4, 3)), np.zeros((4, 3)), "same shape"),
        (np.zeros((0, 2)), np.zeros((0, 2)), "no corners"),
        (np.zeros((1, 2)), np.full((1, 2), np.nan), "not finite"),
    ],
)
def test_rmse_refuses(a, b, message):
    with pytest.raises(SpinestiffError, match=message):
        rmse(a, b)


def test_tilt_is_positive_with_the_left_side_higher():
    corners = np.array([[[20.0, 12.0], [-20.0, 8.0], [-20.0, -12.0], [20.0, -8.0]]] * 2)
    found = tilts_from_points(("T1", "T2"), corners)
    assert found.superior == pytest.approx(np.arctan2(4.0, 40.0))
    assert found.inferior == pytest.approx(np.arctan2(4.0, 40.0))


def test_tilt_of_the_world_is_the_rotation_about_z():
    world = np.array([[[1.0, 0.5], [-1.0, 0.5], [-1.0, -0.5], [1.0, -0.5]]] * 2)
    angle = 0.3
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    assert tilts_from_points(("T1", "T2"), world @ turn.T).superior == pytest.approx(0.3, abs=1e-14)


def views():
    common = {"sid": 1500.0, "source_to_patient": 1340.0, "shape": (600, 500), "pixel": 0.5, "centre": (0, 0, 0)}
    x, y, z = np.eye(3)
    return {
        "from the front": frontal_view(centre=(0.0, 0.0, 0.0)),
        "from behind": placed_view(-x, -y, z, **common),
        "seen mirrored": placed_view(-x, -y, -z, **common),
        "head down": placed_view(x, y, -z, **common),
    }


@pytest.mark.parametrize("which", views())
def test_a_view_changes_no_sign(which):
    view = views()[which]
    degrees = [8.0, 5.0, -3.0, -9.0]
    flat = boxes(degrees)
    world = np.concatenate([flat, np.zeros((4, 4, 1))], axis=2)
    seen = tilts(VERTEBRAE[:4], view.project(world), view)
    assert np.degrees(seen.superior) == pytest.approx(degrees, abs=1e-9)
    assert cobb_angle(seen).degrees == pytest.approx(17.0, abs=1e-9)
    plane = view.to_patient_plane(view.project(world))
    assert cobb_angle(tilts(VERTEBRAE[:4], plane, view)).degrees == pytest.approx(17.0, abs=1e-9)


def test_left_convex_is_positive():
    """The middle of the spine moved to the patient's left (x above 0) between two ends that stay."""
    height = np.linspace(0.0, 400.0, 17)[::-1]
    left = 40.0 * np.sin(np.pi * height / 400.0)
    slope = np.gradient(left, height)
    # A vertebra that stands on the curve is turned so that its own axis follows (slope, 1).
    degrees = np.degrees(np.arctan2(-slope, 1.0))
    angle = cobb_angle(spine(degrees))
    assert angle.degrees > 20.0
    assert (angle.convexity, angle.upper, angle.lower) == ("left", "T1", "L5")


@pytest.mark.parametrize("degrees", [0.0, 10.0, 45.0, 90.0])
@pytest.mark.parametrize("method", ["endplates", "midline"])
def test_exact_angles(degrees, method):
    tilt = degrees * np.linspace(0.5, -0.5, 17)
    found = cobb_angle(tilts_from_points(VERTEBRAE, boxes(tilt), method))
    assert found.degrees == pytest.approx(degrees, abs=1e-9)


def test_endplates_see_the_wedge_and_the_midline_does_not():
    tilt = 20.0 * np.linspace(0.5, -0.5, 9)
    corners = boxes(tilt, wedge=1.5)
    assert cobb_angle(tilts_from_points(VERTEBRAE[:9], corners)).degrees == pytest.approx(23.0, abs=1e-9)
    midline = cobb_angle(tilts_from_points(VERTEBRAE[:9], corners, "midline")).degrees
    assert midline == pytest.approx(20.0, abs=1e-9)


def test_mirror_flips_the_sign_and_keeps_the_levels():
    tilt = np.array([3.0, 9.0, 4.0, -6.0, -2.0, 5.0, 1.0])
    corners = boxes(tilt, wedge=0.4)
    mirrored = (corners * [-1.0, 1.0])[:, [1, 0, 3, 2]]
    here, there = (cobb_angle(tilts_from_points(VERTEBRAE[:7], c)) for c in (corners, mirrored))
    assert there.degrees == pytest.approx(-here.degrees, abs=1e-9)
    assert (here.upper, here.lower) == (there.upper, there.lower) == ("T2", "T4")
    assert (here.convexity, there.convexity) == ("left", "right")


def test_s_curve_names_the_larger_curve():
    upper_left = np.array([0.0, 12.0, 0.0, -12.0, -3.0, 7.0, 2.0])
    found = cobb_angle(spine(upper_left))
    assert (found.upper, found.lower) == ("T2", "T4")
    assert found.degrees == pytest.approx(24.0, abs=1e-9)
    found = cobb_angle(spine(-upper_left))
    assert found.degrees == pytest.approx(-24.0, abs=1e-9)


def test_ties_take_the_shortest_then_the_uppermost_span():
    straight_ends = [10.0, 10.0, 10.0, 0.0, -10.0, -10.0]
    found = cobb_angle(spine(straight_ends))
    assert (found.upper, found.lower, found.degrees) == ("T3", "T5", pytest.approx(20.0, abs=1e-9))
    two_equal = [8.0, 0.0, -8.0, 0.0, 8.0, 0.0, -8.0]
    found = cobb_angle(spine(two_equal))
    assert (found.upper, found.lower) == ("T1", "T3")
    assert cobb_angle(SpineTilts(VERTEBRAE[:3], np.zeros(3), np.zeros(3))).convexity == "none"


def test_ties_do_not_depend_on_rounding():
    tilt = np.radians([8.0, 0.0, -8.0, 0.0, 8.0])
    for noise in (1e-15, -1e-15):
        nudged = tilt + noise * np.array([0.0, 0.0, 0.0, 0.0, 1.0])
        found = cobb_angle(SpineTilts(VERTEBRAE[:5], nudged, nudged))
        assert (found.upper, found.lower) == ("T1", "T3")


def test_change_in_three_forms():
    rest = spine([5.0, 0.0, -5.0, -2.0, 1.0])
    pushed = spine([-9.0, -2.0, 6.0, 1.0, 1.0])
    change = cobb_change(rest, pushed)
    assert (change.rest.upper, change.rest.lower) == ("T1", "T3")
    assert change.signed == pytest.approx(-15.0 - 10.0, abs=1e-9)
    assert change.fixed_levels == pytest.approx(-15.0 - 10.0, abs=1e-9)
    assert change.tilt == pytest.approx(-14.0 - 11.0, abs=1e-9)
    assert change.tilt_levels == ("T1", "T3")


def test_signed_change_can_jump_where_the_tilt_change_does_not():
    """The double curve's other half becomes the largest: 0.2 deg of motion reads as -20 deg (paper's form)."""
    rest = spine([10.0, 0.0, 9.9])
    pushed = spine([10.0, 0.0, 10.1])
    change = cobb_change(rest, pushed)
    assert change.signed == pytest.approx(-20.1, abs=1e-6)
    assert change.fixed_levels == pytest.approx(0.0, abs=1e-9)
    assert abs(change.tilt) == pytest.approx(0.2, abs=1e-9)


def test_change_uses_the_common_vertebrae():
    whole = spine([6.0, 3.0, 0.0, -3.0, -6.0])
    part = SpineTilts(VERTEBRAE[1:4], *(np.radians([4.0, 0.0, -4.0]),) * 2)
    change = cobb_change(whole, part)
    assert (change.rest.upper, change.rest.lower) == ("T2", "T4")
    assert change.signed == pytest.approx(2.0, abs=1e-9)
    with pytest.raises(SpinestiffError, match="at least 2 vertebrae"):
        cobb_change(whole, SpineTilts(("L4", "L5"), np.zeros(2), np.zeros(2)))


def test_refusals():
    with pytest.raises(SpinestiffError, match="frontal"):
        tilts(VERTEBRAE[:2], np.zeros((2, 4, 2)), lateral_view())
    with pytest.raises(SpinestiffError, match=r"corners has shape \(2, 4, 3\), wanted \(2, 4, 2\)"):
        tilts(VERTEBRAE[:2], np.zeros((2, 4, 3)), frontal_view())
    with pytest.raises(SpinestiffError, match="T2 coincide"):
        corners = boxes([0.0, 0.0])
        corners[1, 0] = corners[1, 1]
        tilts_from_points(("T1", "T2"), corners)
    with pytest.raises(SpinestiffError, match="unknown tilt method"):
        tilts_from_points(("T1", "T2"), boxes([0.0, 0.0]), "plates")  # type: ignore[arg-type]
    with pytest.raises(SpinestiffError, match="not lie above"):
        spine([1.0, 2.0]).cobb_degrees("T2", "T1")
    with pytest.raises(SpinestiffError, match="no tilt of L5"):
        spine([1.0, 2.0]).cobb_degrees("T1", "L5")


@pytest.mark.skipif(not LABELLED.is_dir(), reason="the labelled scoliosis radiographs are not here")
def test_largest_angles_of_labelled_radiographs():
    """Mid-line formula on 481 labelled spines against the labels' largest angle, computed in pixels."""
    with (LABELLED / "images.csv").open() as file:
        size = np.array([[float(row["width_px"]), float(row["height_px"])] for row in csv.DictReader(file)])
    landmarks = np.loadtxt(LABELLED / "landmarks.csv", delimiter=",").reshape(-1, 2, 17, 4)
    labelled = np.loadtxt(LABELLED / "angles.csv", delimiter=",")[:, 0]
    # Picture: top-left, top-right, bottom-left, bottom-right, rows down, the patient's left at growing columns.
    pixels = landmarks.transpose(0, 2, 3, 1) * size[:, None, None, :] * [1.0, -1.0]
    corners = pixels[:, :, [1, 0, 2, 3]]
    found = np.array([abs(cobb_angle(tilts_from_points(VERTEBRAE, c, "midline")).degrees) for c in corners])
    assert np.sum(np.abs(found - labelled) < 0.02) >= 475
