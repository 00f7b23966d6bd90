"""``spinestiff cobb FILE``: table, JSON, picture, and how it ends."""

from __future__ import annotations

import csv
import json
import re
import shutil

import pytest

from spine_images import image
from spinestiff.curves.corner_files import write_corners
from spinestiff.curves.pushes import cobb_frames, cobb_rows, push_responses
from spinestiff.files import read_json, write_json
from spinestiff.study.report.clinician import clinician_content
from spinestiff.study.report.viewer.page import component
from spinestiff.study.visit import open_visit
from spinestiff.study.wording.steps import response_lines
from spinestiff.subject.assessment_outcome import Assessment
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.folder import read_subject
from spinestiff.subject.outcomes import Responses
from spinestiff.subject.run_record import read_outcome

TILTS = [12, 6, 0, -8, -16, -12, -4, 6, 12]


@pytest.fixture
def cobb(spinestiff):
    """Run ``spinestiff cobb``; gives its exit status, output and complaints."""

    def call(*arguments):
        ran = spinestiff("cobb", *arguments)
        return ran.status, ran.out, ran.err

    return call


@pytest.fixture
def corners(tmp_path):
    path = tmp_path / "corners.csv"
    write_corners(path, [image(TILTS, start=4, name="good"), image(TILTS[::-1], start=4, name="other [bold]")])
    return path


def spoil(path, name, count):
    """The first ``count`` rows of an image without their numbers."""
    lines = path.read_text().splitlines()
    rows = [i for i, line in enumerate(lines) if line.startswith(name)][:count]
    for i in rows:
        lines[i] = ",".join([*lines[i].split(",")[:3], "nan", "nan"])
    path.write_text("\n".join(lines))


def test_the_table_says_angle_ends_and_side(cobb, corners):
    status, out, err = cobb(corners)
    assert (status, err) == (0, "")
    for words in (
        "good",
        "other [bold]",
        "to the right)",
        "Cobb angles (endplates), ± half",
        "main thoracic",
        "apex T11)",
    ):
        assert words in " ".join(out.split()), words
    # The levels stand below the angle.
    row = next(i for i, line in enumerate(out.splitlines()) if line.startswith("good"))
    assert [out.splitlines()[row + i].split()[k] for i, k in ((0, 2), (1, 0), (2, 0))] == [
        "28.0°",
        "(T5–T9,",
        "to",
    ]
    # What all angles have in common is told once.
    assert out.count("endplates") == 1 and out.count("convex") == 1
    assert "left-convex)" in cobb(corners, "--patient-left", "right")[1]


def test_the_csv_says_what_the_table_says(cobb, corners, tmp_path):
    spoil(corners, "other", 1)
    path = tmp_path / "angles.csv"
    status, out, _ = cobb(corners, "--csv", path)
    rows = list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))
    good = [row for row in rows if row["image"] == "good"]
    (largest,) = [row for row in good if row["largest"] == "yes"]
    # A cell has a line for each part.
    size, _, levels = largest["words"].split(", ")[0].partition(" (")
    assert status == 0 and size in out and f"({levels}," in out
    assert (largest["degrees"], largest["upper_level"], largest["lower_level"]) == ("28.00", "T5", "T9")
    assert f"± {float(largest['half_width95']):.1f}°" in largest["words"] and largest["signed_change"] == ""
    assert len(good) > 1 and {row["definition"] for row in rows} == {"endplate"}
    assert rows[-1]["status"] == "refused" and "x is 'nan'" in rows[-1]["words"]
    # No row is lost or overwritten without a word.
    assert cobb(corners, "--csv", path)[0] == 2 and cobb(corners, "--csv", corners, "--force")[0] == 2
    assert cobb(corners, "--csv", path, "--force")[0] == 0


def test_json_has_a_record_an_image(cobb, corners):
    spoil(corners, "other", 1)
    status, out, _ = cobb(corners, "--json", "--definition", "midline", "--noise-px", 3)
    good, bad = json.loads(out)
    assert status == 0
    assert (good["image"], good["status"], good["definition"], good["noise"]) == ("good", "ok", "midline", 3.0)
    assert good["largest_deg"] == pytest.approx(28.0)
    assert (good["upper_level"], good["lower_level"], good["warnings"]) == ("T5", "T9", [])
    assert (bad["status"], bad["largest_deg"]) == ("refused", None)
    assert "x is 'nan'" in bad["warnings"][0]


def test_the_status_is_2_if_nothing_could_be_measured(cobb, corners):
    spoil(corners, "good", 1)
    status, out, _ = cobb(corners)
    assert status == 0 and "good: refused: row 2: x is 'nan'" in out
    spoil(corners, "other", 1)
    status, out, _ = cobb(corners, "--json")
    assert status == 2 and [record["status"] for record in json.loads(out)] == ["refused", "refused"]


def test_a_picture_is_written(cobb, corners, tmp_path):
    assert cobb(corners, "--picture", tmp_path / "new" / "out.png")[0] == 0
    assert (tmp_path / "new" / "out.png").stat().st_size > 10_000


def test_markups_and_annotations_are_read(cobb, tmp_path):
    spine = image(TILTS, start=4, name="rest/frontal", first_on="right")
    for name in ("a.mrk.json", "annotation.json"):
        write_corners(tmp_path / name, [spine])
        (record,) = json.loads(cobb(tmp_path / name, "--json")[1])
        assert record["largest_deg"] == pytest.approx(28.0, abs=1e-3)
        known = name == "annotation.json"
        assert (
            record["convexity"] == f"convex to the {'patient' if known else 'image'}'s {'left' if known else 'right'}"
        )


def test_a_noise_in_pixels_is_none_of_corners_in_millimetres(cobb, tmp_path):
    path = tmp_path / "coronal.mrk.json"
    write_corners(path, [image(TILTS, start=4, unit="mm", first_on="right")])
    assert cobb(path)[0] == 0
    status, out, err = cobb(path, "--noise-px", 2)
    assert (status, out) == (2, "") and err.count("\n") == 1
    assert "coronal.mrk.json: spine: its corners are in mm, not pixels; leave out --noise-px" in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--definition", "cobb"), "--definition cobb: wanted endplate or midline"),
        (("--noise-px", "0"), "--noise-px 0: wanted above 0 and at most 1000 pixels"),
        (("--noise-px", "nan"), "--noise-px nan: wanted"),
        (("--patient-left", "up"), "--patient-left up: wanted left or right"),
        (("--picture", "out.svg"), "wanted a name that ends in .png"),
        (("--picture", "same.png", "--csv", "./same.png"), "--picture and --csv are both same.png; name two files"),
    ],
)
def test_bad_options_are_one_line(cobb, corners, monkeypatch, arguments, words):
    monkeypatch.chdir(corners.parent)
    status, out, err = cobb(corners, *arguments)
    assert (status, out) == (2, "")
    assert err.startswith("spinestiff: ") and words in err and err.count("\n") == 1
    assert [path.name for path in corners.parent.iterdir()] == ["corners.csv"]


def test_what_is_no_file_of_corners_is_one_line(cobb, tmp_path):
    (tmp_path / "a.csv").write_text("a,b\n")
    (tmp_path / "a.txt").write_text("a")
    cases = {
        "a.csv": "wanted image,level",
        "none.csv": "no such file",
        "none": "no such folder",
        "a.txt": "wanted a .csv",
    }
    for name, words in cases.items():
        status, out, err = cobb(tmp_path / name)
        assert (status, out) == (2, "") and words in err and err.count("\n") == 1, err
    status, _, err = cobb(tmp_path, "--patient-left", "left")
    assert status == 2 and "--patient-left is for files of corners" in err


def test_noise_and_definition_are_those_of_all_lines_or_it_is_told(finished, spinestiff):
    """N per degree takes the corner noise of the table; by mid-lines there is none, which a line says."""
    told = spinestiff("cobb", finished.folder, "--definition", "midline", "--noise-px", 8).out.splitlines()
    lines = response_lines(push_responses(read_subject(finished.folder), noise_px=8.0))
    assert lines != response_lines(push_responses(read_subject(finished.folder)))
    assert told[-len(lines) - 1 :] == [
        "N per degree and flexibility are by endplates, whatever the table is by",
        *lines,
    ]


def test_the_cobb_angle_is_the_same_everywhere(finished, viewed, spinestiff, tmp_path):
    """First page, table, CSV, JSON and the viewer: size, ±, levels, definition and side."""
    frames = cobb_frames(read_subject(finished.folder))
    words = frames[0].reading.words()
    assert re.fullmatch(r"\d+\.\d° ± \d+\.\d° \([TL]\d+–[TL]\d+, endplates, (left|right)-convex\)", words)
    visit = open_visit(finished.folder)
    outcomes = [read_outcome(visit.subject, kind) for kind in (Estimate, Assessment, Responses)]
    assert clinician_content(visit, *outcomes)["curve"] == words
    table = tmp_path / "angles.csv"
    printed = spinestiff("cobb", finished.folder, "--csv", table)
    assert printed.status == 0 and words in " ".join(printed.out.split())
    assert words in table.read_text(encoding="utf-8")
    lines = response_lines(push_responses(read_subject(finished.folder)))
    assert printed.out.splitlines()[-len(lines) :] == lines and "are by endplates" not in printed.out
    record = json.loads(spinestiff("cobb", finished.folder, "--json").out)[0]
    assert f"{record['largest_deg']:.1f}° ± {1.96 * record['sd_deg']:.1f}°" in words
    shown = {row[0]: row[1] for row in cobb_rows(frames)}
    rows = component(viewed.scene).rows
    assert len(rows) > 4
    for push, frame, force, *_, said in rows:
        assert shown[f"{push} frame {frame}, {float(force):.0f} N"] == said


def test_forces_that_may_be_in_another_unit_are_told(spinestiff, radiographed, tmp_path):
    folder = shutil.copytree(radiographed, tmp_path / "girl")
    record = read_json(folder / "subject.json")
    for push in record["pushes"]:
        push["forces_n"] = [round(force / 9.81, 2) for force in push["forces_n"]]
    write_json(folder / "subject.json", record)
    words = "warning: push 'main': forces up to 3.06 N, where pushes on the ribs have 15 to 150 N: look whether"
    for command in ("cobb", "response"):
        assert words in spinestiff(command, folder).err
