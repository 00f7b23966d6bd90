"""Marks that no step takes are told before anything long is done, in the words of ``inspect``."""

from __future__ import annotations

import shutil

import pytest

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


def test_marks_as_they_should_be_are_taken(girl):
    check_marks(read_subject(girl))
