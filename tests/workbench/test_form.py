"""The form beside the single values: views from other sides, skin markers, priors."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from hospital import export
from spinestiff.errors import SubjectError
from spinestiff.files import read_json
from spinestiff.study.trials import usual_priors
from spinestiff.subject.annotation_record import Annotation, ImageAnnotation
from spinestiff.subject.folder import write_annotation
from spinestiff.subject.intake import adding
from spinestiff.subject.intake.collecting import collect
from spinestiff.workbench.form import form_record, judged, save_form
from spinestiff.workbench.form_words import WORDS
from unannotated import drawn

AXES = {"left": "+x", "up": "+z", "front": "-y"}


def save(folder, change):
    form = form_record(folder)
    values = json.loads(json.dumps(form["values"]))
    change(values["pushes"][0], values)
    save_form(folder, values, form["revision"])
    return read_json(folder / "subject.json")


@pytest.fixture
def girl(root, tmp_path):
    """A subject whose push has a lateral view of frames 0 and 2 and skin markers."""
    folder = root / "girl"
    files = collect([export(tmp_path / f"I{i}", "lateral", patient="", time=f"10300{i}") for i in range(2)])[0]
    push = adding.read_standing(folder)
    adding.add_view(push, 0, {"id": "side", "kind": "lateral", "frames": [0, 2]}, files)
    table = "\n".join(["marker,frame,x,y,z", *(f"{name},{frame},1,2,3" for name in "abc" for frame in range(3))])
    markers = {"unit": "mm", "axes": AXES, "side": "front", "shown": {"a": [20.0, 30.0]}}
    adding.add_markers(adding.read_standing(folder), 0, markers, table)
    return folder


def test_words_of_priors_are_those_of_the_documents():
    page = (Path(__file__).parents[2] / "docs" / "subject-folder.md").read_text(encoding="utf-8")
    units = dict(re.findall(r"^\| `(\w+)` \| [\d.]+ \| ([\w ]+) \|", page, re.MULTILINE))
    told = {name.removeprefix("priors."): one["unit"] for name, one in WORDS.items() if name.startswith("priors.")}
    assert told == units and set(told) == set(usual_priors())


def test_priors_are_judged_as_a_fit_judges_them(girl):
    form = form_record(girl)
    assert form["priors"]["force_scale"] == 0.02 and "trunk_power" not in form["priors"]
    for given, field, words in (
        ({"force_scale": -1}, "priors.force_scale", "greater than or equal to 0"),
        ({"force_scale": "much"}, "priors.force_scale", "found 'much'"),
        ({"tracking_mm": 0}, "priors", "wanted above 0"),
        ({"obliquity_deg": 0.5}, "priors", "is a part of obliquity_deg 0.5"),
        ({"luck": 1}, "priors", "unknown prior"),
    ):
        (problem,) = judged({**form["values"], "priors": given})["problems"]
        assert problem["field"] == field and words in problem["text"]
        with pytest.raises(SubjectError):
            save(girl, lambda _, values, given=given: values.update(priors=given))
    assert save(girl, lambda _, values: values.update(priors={"force_scale": 0.005}))["priors"] == {
        "force_scale": 0.005
    }


def test_views_and_markers_are_edited_taken_out_and_put_back(girl):
    whole = read_json(girl / "subject.json")["pushes"][0]
    changed = save(girl, lambda push, _: push["views"][0].update(turned_deg=10.0, frames=[1, 2]))
    assert changed["pushes"][0]["views"][0]["turned_deg"] == 10.0

    def bare(push, _):
        del push["views"], push["markers"]

    assert not {"views", "markers"} & set(save(girl, bare)["pushes"][0])
    assert (girl / "pushes" / "a-side" / "001.dcm").is_file() and (girl / "pushes" / "a-markers.csv").is_file()
    assert save(girl, lambda push, _: push.update(views=whole["views"], markers=whole["markers"]))["pushes"][0] == whole


@pytest.mark.parametrize(
    "change",
    [
        lambda push, _: push["views"][0].update(files="rest"),
        lambda push, _: push["views"][0].update(id="other"),
        lambda push, _: push["views"].append({"id": "b", "kind": "lateral", "files": "pushes/a-b.dcm", "frames": [1]}),
        lambda push, _: push["markers"].update(file="rest/frontal.dcm"),
        lambda push, _: push.update(frames="pushes/a-side"),
    ],
)
def test_no_other_file_is_named(girl, change):
    before = (girl / "subject.json").read_bytes()
    with pytest.raises(SubjectError, match="can't be changed here"):
        save(girl, change)
    assert (girl / "subject.json").read_bytes() == before


def test_a_view_that_is_annotated_stays(girl):
    quads = dict(list(drawn("rest/lateral").named().items())[:4])
    image = ImageAnnotation.model_validate({"vertebrae": quads})
    write_annotation(girl, Annotation(schema_version=1, images={"push/a/2/side": image}))
    for change in (lambda push, _: push.pop("views"), lambda push, _: push["views"][0].update(frames=[0, 1])):
        with pytest.raises(SubjectError, match="push/a/2/side is annotated; remove its marks"):
            save(girl, change)
