"""Marks that no step takes are told before anything long is done, in the words of ``inspect``."""

from __future__ import annotations

import shutil

import pytest
from typer.testing import CliRunner

from spinestiff.app.cli import app
from spinestiff.errors import SubjectError
from spinestiff.files import read_json, write_json
from spinestiff.study import steps
from spinestiff.study.runner import run_steps
from spinestiff.study.visit import open_visit
from spinestiff.subject.folder import read_subject
from spinestiff.subject.inspection import inspect
from spinestiff.subject.marks import check_marks


@pytest.fixture
def girl(radiographed, tmp_path):
    """A copy of the subject before any step."""
    return shutil.copytree(radiographed, tmp_path / radiographed.name)


def mirrored(vertebrae):
    for name, (a, b, c, d) in vertebrae.items():
        vertebrae[name] = [b, a, d, c]


def outside(vertebrae):
    for name, quad in vertebrae.items():
        vertebrae[name] = [[column + 5000.0, row] for column, row in quad]


@pytest.mark.parametrize(
    ("image", "source", "change", "words"),
    [
        ("rest/frontal", None, mirrored, "corners are mirrored for this view"),
        ("rest/lateral", None, mirrored, "corners are mirrored for this view"),
        ("push/second", None, mirrored, "corners are mirrored for this view"),
        ("push/second/1", "push/second", outside, "wanted it in the image of 512 columns"),
    ],
)
def test_marks_that_a_later_step_refuses_are_refused_before_corners_are_followed(
    girl, monkeypatch, image, source, change, words
):
    followed = []
    monkeypatch.setattr(steps, "track", lambda *args, **kwargs: followed.append(args))
    content = read_json(girl / "annotation.json")
    content["images"][image] = {"vertebrae": dict(content["images"][source or image]["vertebrae"])}
    change(content["images"][image]["vertebrae"])
    write_json(girl / "annotation.json", content)
    with pytest.raises(SubjectError, match=words) as refused:
        run_steps(open_visit(girl))
    assert followed == [] and not (girl / "results" / "tracked.json").exists()
    assert f"annotation.json: images.{image}" in str(refused.value)
    assert [one.reason for one in inspect(girl) if one.reason] == [str(refused.value)]


def test_support_points_out_of_the_picture_are_refused_before_corners_are_followed(girl, monkeypatch):
    monkeypatch.setattr(steps, "track", lambda *args, **kwargs: pytest.fail("followed"))
    content = read_json(girl / "annotation.json")
    content["images"]["push/main"]["supports"] = {"pelvis": [[200.0, 300.0], [4000.0, 300.0]]}
    write_json(girl / "annotation.json", content)
    words = r"images.push/main.supports.pelvis: found a point at column 4000, row 300, wanted it in the image of 512"
    with pytest.raises(SubjectError, match=words) as refused:
        run_steps(open_visit(girl))
    assert [one.reason for one in inspect(girl) if one.reason] == [str(refused.value)]


def test_a_wrong_table_of_markers_is_refused_before_corners_are_followed(girl, monkeypatch):
    monkeypatch.setattr(steps, "track", lambda *args, **kwargs: pytest.fail("followed"))
    content = read_json(girl / "subject.json")
    axes = {"left": "+x", "up": "+y", "front": "+z"}
    content["pushes"][1]["markers"] = {
        "file": "skin.csv",
        "unit": "mm",
        "axes": axes,
        "side": "front",
        "shown": {"a": [9.0, 9.0]},
    }
    write_json(girl / "subject.json", content)
    (girl / "skin.csv").write_text("marker,frame,x,y,z\na,0,1,2,3\n")
    words = r"skin\.csv: found 1 marker, wanted 3 to 60"
    with pytest.raises(SubjectError, match=words):
        run_steps(open_visit(girl))
    assert "skin.csv: found 1 marker" in CliRunner().invoke(app, ["inspect", str(girl)]).output


def test_a_radiograph_counts_in_one_push_alone(girl, monkeypatch):
    """Whatever its file is called; without load, or unused, it may stand in two."""
    monkeypatch.setattr(steps, "track", lambda *args, **kwargs: pytest.fail("followed"))
    content, marks = read_json(girl / "subject.json"), read_json(girl / "annotation.json")
    main, second = content["pushes"]
    second |= {name: main[name] for name in ("forces_n", "roles")}
    shutil.copy(girl / main["frames"], girl / second["frames"])
    marks["images"]["push/second"] = marks["images"]["push/main"]
    write_json(girl / "subject.json", content)
    write_json(girl / "annotation.json", marks)
    used = next(i for i, (force, role) in enumerate(zip(main["forces_n"], main["roles"])) if force and role != "unused")
    words = f"push 'second' frame {used} is the same picture as push 'main' frame {used}, and would count twice"
    with pytest.raises(SubjectError, match=words):
        run_steps(open_visit(girl))
    ran = CliRunner().invoke(app, ["inspect", str(girl)])
    assert ran.exit_code == 2 and "would count twice" in ran.output
    second["roles"] = ["unused"] * len(second["roles"])
    write_json(girl / "subject.json", content)
    check_marks(read_subject(girl))


def test_marks_as_they_should_be_are_taken(girl):
    check_marks(read_subject(girl))
