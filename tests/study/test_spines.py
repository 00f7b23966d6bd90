"""Rest shapes of synthetic subjects: the curve that was asked for, and a measured spine from a table."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.template import template_torso
from spinestiff.curves.tilts import cobb_angle, tilts, tilts_from_points
from spinestiff.errors import SubjectError
from spinestiff.imaging.features import silhouette_shares, state_features
from spinestiff.imaging.projection import frontal_view
from spinestiff.personalise.placing import place_vertebrae
from spinestiff.study.synthetic.spines import (
    CURVES,
    SECONDARY,
    curved_spine,
    real_spine,
    rest_vertebrae,
    torso_from_lps,
)

COLUMNS = ("id", "level", "keypoint", "x_mm", "y_mm", "z_mm")
MEASURED = Path(__file__).parents[3] / "shared" / "data" / "ct_spines" / "spines.csv"


@pytest.fixture(scope="module")
def torso():
    return template_torso(157.0, "coarse")


def cobb(torso, poses):
    """Read from the front edges of the placed boxes, seen from infinity."""
    positions, rotations = poses
    boxes = torso.vertebra_boxes.reshape(-1, 2, 2, 2, 3).mean(3)  # (V, superior/inferior, left/right, 3)
    corners = positions[:, None, None] + np.einsum("vij,vabj->vabi", rotations, boxes)
    quads = np.stack([corners[:, 0, 0], corners[:, 0, 1], corners[:, 1, 1], corners[:, 1, 0]], 1)
    return cobb_angle(tilts_from_points(VERTEBRAE, quads[..., :2]))


@pytest.mark.parametrize("curve", CURVES)
@pytest.mark.parametrize("degrees", [12.0, -25.0, 80.0])
def test_the_curve_has_the_wanted_cobb_angle(torso, curve, degrees):
    found = cobb(torso, curved_spine(torso, degrees, curve))
    assert abs(found.degrees) == pytest.approx(abs(degrees), abs=1.0 + 0.02 * abs(degrees))
    if curve != "double":  # of two opposite curves either may be the larger
        assert found.degrees * degrees > 0.0
        assert found.convexity == ("left" if degrees > 0.0 else "right")


def test_left_convex_means_bulging_to_the_left(torso):
    positions, rotations = curved_spine(torso, 20.0, "thoracic")
    rest, upright = rest_vertebrae(torso)
    aside = (positions - rest)[:, 0]
    assert VERTEBRAE[int(np.argmax(aside))] in ("T6", "T7", "T8", "T9")
    assert aside.max() > 5.0
    assert abs(aside[0]) < 1e-9
    assert abs(aside[-1]) < 1e-9
    assert positions[:, 2] == pytest.approx(rest[:, 2])
    # Bodies turn towards the convexity: what pointed forward at the apex points left, too.
    apex = int(np.argmax(aside))
    assert (rotations[apex] @ upright[apex].T @ [0.0, 0.0, 1.0])[0] > 0.02


@pytest.mark.parametrize("curve", CURVES)
def test_a_curve_costs_height_and_leaves_the_spines_length(torso, curve):
    """Bodies are pulled apart by none: a spine of 80 degrees that kept its height would be a tenth longer."""
    rest, _ = rest_vertebrae(torso)
    positions, _ = curved_spine(torso, 80.0, curve)
    apart, wanted = (np.linalg.norm(np.diff(places, axis=0), axis=1) for places in (positions, rest))
    assert apart == pytest.approx(wanted)
    assert positions[-1] == pytest.approx(rest[-1])
    assert 20.0 < rest[0, 1] - positions[0, 1] < 60.0


def test_no_curve_is_the_template(torso):
    for found, rest in zip(curved_spine(torso, 0.0, "lumbar"), rest_vertebrae(torso)):
        assert found == pytest.approx(rest, abs=1e-12)


def test_a_placed_torso_shows_the_wanted_angle_in_its_radiograph(torso):
    """Up to what perspective and the vertebrae's axial turn do to a picture."""
    placed = place_vertebrae(torso, *curved_spine(torso, 20.0, "thoracic"))
    view = frontal_view()
    corners = state_features(placed, view, placed.rest_pose, silhouette_shares(placed, view, placed.rest_pose)).z
    assert cobb_angle(tilts(VERTEBRAE, corners, view)).degrees == pytest.approx(20.0, abs=2.0)


@pytest.mark.parametrize(
    ("cobb_deg", "curve", "words"),
    [
        (10.0, "sideways", "unknown curve 'sideways'; wanted one of thoracic, thoracolumbar, lumbar, double"),
        (81.0, "lumbar", "Cobb angle 81.0 degrees; wanted at most 80"),
        (float("nan"), "lumbar", "Cobb angle nan degrees"),
    ],
)
def test_impossible_curves_are_refused(torso, cobb_deg, curve, words):
    with pytest.raises(SubjectError, match=words):
        curved_spine(torso, cobb_deg, curve)


def test_dicom_axes_become_the_torsos():
    left, posterior, superior = torso_from_lps(np.eye(3))
    assert left.tolist() == [1.0, 0.0, 0.0]
    assert posterior.tolist() == [0.0, 0.0, -1.0]
    assert superior.tolist() == [0.0, 1.0, 0.0]


def lps_table(torso, poses, scale=1.2, offset=(30.0, -80.0, 400.0)):
    """Rows as measured on a bigger patient elsewhere in the scanner: bodies and pedicles."""
    positions, rotations = poses
    rows = []
    for name, place, turn in zip(VERTEBRAE, positions, rotations):
        for keypoint, point in (("body", (0, 0, 0)), ("left", (12, 0, -20)), ("right", (-12, 0, -20))):
            x, y, z = scale * (place + turn @ np.array(point, dtype=float))
            lps = np.array([x, -z, y]) + offset
            rows.append(["a", name, keypoint, *(f"{value:.4f}" for value in lps)])
    return rows


def write_table(path, rows, columns=COLUMNS):
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([columns, *rows])
    return path


def test_a_real_spine_comes_back(torso, tmp_path):
    """Scaled to the straight spine's length, so a little shorter, and smoothed, which costs a few degrees."""
    poses = curved_spine(torso, 25.0, "thoracolumbar")
    table = write_table(tmp_path / "spines.csv", lps_table(torso, poses))
    positions, rotations = real_spine(torso, table, "a")
    assert positions == pytest.approx(poses[0], abs=5.0)
    assert positions[-1] == pytest.approx(poses[0][-1], abs=1e-9)
    found, wanted = cobb(torso, (positions, rotations)), cobb(torso, poses)
    assert found.degrees == pytest.approx(wanted.degrees, abs=5.0)
    assert rotations @ np.swapaxes(rotations, 1, 2) == pytest.approx(np.tile(np.eye(3), (17, 1, 1)), abs=1e-12)
    assert np.linalg.det(rotations) == pytest.approx(np.ones(17))
    # Upright: up points up, left points left.
    assert rotations[:, 1, 1].min() > 0.6
    assert rotations[:, 0, 0].min() > 0.6


def test_axial_rotation_comes_from_the_pedicles(torso, tmp_path):
    positions, rotations = rest_vertebrae(torso)
    turn = np.where(np.arange(17) < 8, 0.15, -0.15)  # to the left above, to the right below
    turned = exp_so3(np.outer(turn, [0.0, 1.0, 0.0])) @ rotations
    table = write_table(tmp_path / "spines.csv", lps_table(torso, (positions, turned)))
    forward = real_spine(torso, table, "a")[1] @ np.array([0.0, 0.0, 1.0])
    assert forward[2, 0] - forward[14, 0] == pytest.approx(0.3, abs=0.05)
    bodies = [row for row in lps_table(torso, (positions, turned)) if row[2] == "body"]
    straight = real_spine(torso, write_table(tmp_path / "bodies.csv", bodies), "a")[1] @ np.array([0.0, 0.0, 1.0])
    assert np.abs(straight[:, 0]).max() < 0.01


def changed_rows(torso, change):
    rows = lps_table(torso, rest_vertebrae(torso))
    return change(rows)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda rows: [row for row in rows if row[1:3] != ["T9", "body"]], "spine 'a' has no body point for T9"),
        (lambda rows: [["b", *row[1:]] for row in rows], "no spine 'a'"),
        (lambda rows: [rows[0][:4] + ["high", "0"], *rows[1:]], "line 2: not a number"),
        (lambda rows: [rows[0][:4] + ["nan", "0"], *rows[1:]], "line 2: not a number"),
        (lambda rows: [rows[0][:4] + ["1_0", "0"], *rows[1:]], "line 2: not a number"),
        (lambda rows: [rows[0][:4], *rows[1:]], "line 2: not a number"),
        (lambda rows: [], "no spine 'a'"),
        (
            lambda rows: [*rows[:3], [*rows[0][:3], "5", "5", "5"], *rows[3:]],
            f"line 5: body of {VERTEBRAE[0]} is given twice",
        ),
        (lambda rows: [["a", "T1", "x" * 140_000, "0", "0", "0"], *rows], r"after line 1: not CSV \(field larger than"),
    ],
)
def test_incomplete_tables_are_refused(torso, tmp_path, change, words):
    table = write_table(tmp_path / "spines.csv", changed_rows(torso, change))
    with pytest.raises(SubjectError, match=words) as caught:
        real_spine(torso, table, "a")
    assert str(table) in str(caught.value)


def test_a_point_far_off_the_line_is_refused(torso, tmp_path):
    rows = lps_table(torso, rest_vertebrae(torso))
    for row in rows:
        if row[1:3] == ["T7", "body"]:
            row[3] = f"{float(row[3]) + 30.0:.3f}"
    with pytest.raises(SubjectError, match=r"lies .* mm off the others"):
        real_spine(torso, write_table(tmp_path / "spines.csv", rows), "a")


@pytest.mark.parametrize(
    ("up_mm", "words"),
    [
        (
            35.0,
            r"T12 and L1 lie [67]\d mm apart; wanted 2\d to [56]\d mm, 1 to 2\.2 of their height; is a level missing",
        ),
        (
            -20.0,
            r"T12 and L1 lie 1\d mm apart; wanted 2\d to [56]\d mm, 1 to 2\.2 of their height; do they overlap, or",
        ),
    ],
)
def test_levels_too_far_apart_or_in_each_other_are_refused_by_name(torso, tmp_path, up_mm, words):
    """Everything from T12 upwards is moved; smoothed, the gap would seem to be a neighbour's that strays."""
    rows = lps_table(torso, rest_vertebrae(torso))
    for row in rows:
        if row[1].startswith("T"):
            row[5] = f"{float(row[5]) + up_mm:.3f}"
    table = write_table(tmp_path / "spines.csv", rows)
    with pytest.raises(SubjectError, match=f"spine 'a': {words}") as caught:
        real_spine(torso, table, "a")
    assert str(caught.value).startswith(f"{table}: ")


def test_files_that_are_no_table_are_refused(torso, tmp_path):
    with pytest.raises(SubjectError, match="no such file"):
        real_spine(torso, tmp_path / "none.csv", "a")
    with pytest.raises(SubjectError, match="column 'z_mm' is missing"):
        real_spine(torso, write_table(tmp_path / "short.csv", [], COLUMNS[:-1]), "a")
    picture = tmp_path / "picture.csv"
    picture.write_bytes(b"\x00\xff\xd8\xfe")
    with pytest.raises(SubjectError, match="not UTF-8"):
        real_spine(torso, picture, "a")


@pytest.mark.skipif(not MEASURED.is_file(), reason="the table of measured spines (shared/data/ct_spines) is not here")
def test_of_the_measured_spines_those_with_a_gap_or_a_stray_point_are_refused(torso):
    with MEASURED.open(newline="", encoding="utf-8") as file:
        ids = list(dict.fromkeys(row["id"] for row in csv.DictReader(file)))
    refused = {}
    for name in ids:
        try:
            real_spine(torso, MEASURED, name)
        except SubjectError as error:
            refused[name] = str(error).removeprefix(f"{MEASURED}: spine '{name}': ")
    gaps = {name: text.split(" lie ")[0] for name, text in refused.items() if " mm apart; " in text}
    assert gaps == {
        "5mmFflb3esYK": "T2 and T3",
        "72PbvI2oElrX": "T12 and L1",
        "D4dXQUj3dyMy": "T12 and L1",
        "L150kaW3wToW": "T12 and L1",
        "aMCHApVy6tuw": "T12 and L1",
        "i5FG8DBxwsBz": "T12 and L1",
    }
    assert set(refused) - set(gaps) == {"59a7IebdZp3u", "5ToT2KEY6ufV", "bPA1XnT4q7rh"}


@pytest.mark.skipif(not MEASURED.is_file(), reason="the table of measured spines (shared/data/ct_spines) is not here")
def test_measured_spines_become_plausible_rest_shapes(torso):
    with MEASURED.open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["keypoint"] == "body" and row["x_mm"]]
    levels = {}
    for row in rows:
        levels.setdefault(row["id"], set()).add(row["level"])
    complete = [name for name, found in levels.items() if found >= set(VERTEBRAE)]
    assert len(complete) > 5
    usable = 0
    for name in complete[:12]:
        try:
            poses = real_spine(torso, MEASURED, name)
        except SubjectError:  # a point far off the others' line
            continue
        usable += 1
        length = np.linalg.norm(np.diff(poses[0], axis=0), axis=1).sum()
        wanted = np.linalg.norm(np.diff(rest_vertebrae(torso)[0], axis=0), axis=1).sum()
        assert length == pytest.approx(wanted, rel=0.03)
        assert abs(cobb(torso, poses).degrees) < 45.0
        assert (np.diff(poses[0][:, 1]) < 0.0).all()
    assert usable > 5


@pytest.mark.parametrize("name", SECONDARY)
def test_a_secondary_curve_is_smaller_and_to_the_other_side(torso, name):
    one, two = (curved_spine(torso, 20.0, name, share) for share in (0.0, 0.4))
    lean = [np.degrees(np.arctan2(-rotations[:, 0, 1], rotations[:, 1, 1])) for _, rotations in (one, two)]
    for found in lean:
        assert np.ptp(found) == pytest.approx(20.0, abs=1.0)
    aside = two[0][:, 0] - np.linspace(two[0][0, 0], two[0][-1, 0], 17)
    assert aside.max() > 1.5 * -aside.min() > 1.5
    assert (one[0][:, 0] - one[0][-1, 0]).min() > 0.25 * aside.min()


def test_a_secondary_curve_goes_with_a_single_one(torso):
    with pytest.raises(SubjectError, match="curve 'double' with a secondary one"):
        curved_spine(torso, 20.0, "double", 0.3)
