"""The form beside the single values: views from other sides, skin markers and scan, trunk, ratios, priors."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pydicom
import pytest

from bench_page import box
from hospital import export
from spinestiff.anatomy.regions import LEVELS, SPINE_REGIONS, TISSUE_REGIONS, check_parameters
from spinestiff.anatomy.stiffness import DIRECTIONS, INTERVERTEBRAL_BENDING, RIB_ROTATION, TISSUE_PARAMETERS
from spinestiff.errors import SubjectError
from spinestiff.files import read_json
from spinestiff.study.trials import usual_priors
from spinestiff.subject.annotation_record import Annotation, ImageAnnotation
from spinestiff.subject.folder import write_annotation
from spinestiff.subject.intake import adding
from spinestiff.subject.intake.collecting import collect
from spinestiff.subject.records import ScaleRecord
from spinestiff.workbench.form import form_record, judged, save_form
from spinestiff.workbench.form_words import RATIO_GROUPS, RATIO_PARTS, WORDS
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


def test_each_picture_that_a_field_names_is_drawn():
    sources = Path(__file__).parents[2] / "web" / "workbench" / "src"
    marks = "".join((sources / name).read_text(encoding="utf-8") for name in ("torso.ts", "beam.ts"))
    named = {one["picture"] for one in WORDS.values() if "picture" in one}
    assert named == set(re.findall(r"""(?:mark\(|dimension\(|focus === )"(\w+)\"""", marks))


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


def test_words_of_ratios_are_of_what_an_estimate_takes():
    directions = {*DIRECTIONS, INTERVERTEBRAL_BENDING, RIB_ROTATION}
    assert {name for name, (_, of) in RATIO_GROUPS.items() if of == "joints"} == directions
    assert {name for name, (_, of) in RATIO_GROUPS.items() if of == "tissue"} == set(TISSUE_PARAMETERS)
    for name, (_, of) in RATIO_GROUPS.items():
        check_parameters([f"{name}@{part}" if part else name for part in RATIO_PARTS[of]])
    assert set(RATIO_PARTS["tissue"]) == {"", *TISSUE_REGIONS}
    assert set(RATIO_PARTS["joints"]) == {"", *SPINE_REGIONS, LEVELS}


def test_trunk_ratios_and_population_are_judged_where_they_stand(root):
    folder, sizes = root / "girl", {"breadth_mm": 245, "depth_mm": 172}
    values = form_record(folder)["values"]
    for change, field, words in (
        ({"trunk": {"T9": {"breadth_mm": 245}}}, "trunk.T9.depth_mm", "missing"),
        ({"trunk": {"T9": {**sizes, "breadth_mm": 24}}}, "trunk.T9.breadth_mm", "greater than or equal to 100"),
        ({"trunk": {"T9": {**sizes, "depth_mm": "a"}}}, "trunk.T9.depth_mm", "found 'a'"),
        ({"parameters": ["tissue", "tissue"]}, "parameters", "named twice"),
        ({"parameters": ["lateral_bending@T9-T8"]}, "parameters", "unknown part 'T9-T8'"),
        ({"population": "nobody"}, "population", "unknown population 'nobody'; known are koutras2025"),
    ):
        (problem,) = judged({**values, **change})["problems"]
        assert problem["field"] == field and words in problem["text"], problem
        with pytest.raises(SubjectError):
            save(folder, lambda _, values, change=change: values.update(change))
    good = {"trunk": {"T9": sizes}, "parameters": ["lateral_bending@T5-T9", "tissue"], "population": "koutras2025"}
    saved = save(folder, lambda _, values: values.update(good))
    assert {key: saved[key] for key in good} == good


def test_a_skin_scan_comes_is_changed_taken_out_and_put_back(served, root):
    folder, content, scan = root / "girl", box(280.0, 190.0, 450.0), {"unit": "mm", "axes": AXES}
    before = (folder / "subject.json").read_bytes()

    def sent(files, **other):
        body = {"upload": served.upload(files), "scan": {**scan, **other}}
        return served.json("POST", f"/api/subjects/{served.key()}/scan", body)

    for files, other, words in (
        ({"a.obj": content}, {"unit": "cm"}, "check unit (cm) and axes"),
        ({"a.obj": content}, {"axes": {**AXES, "left": "-x"}}, "mirror"),
        ({"a.obj": content}, {"unit": None}, "the skin scan: unit"),
        ({"a.obj": content, "b.stl": content}, {}, "found 2 scans in the upload, wanted one"),
        ({"a.txt": content}, {}, "found 0 scans"),
        ({"a.obj": b"nothing"}, {}, "a.obj"),
    ):
        status, body = sent(files, **other)
        assert status == 422 and words in body["error"] and str(root) not in body["error"], body
    assert (folder / "subject.json").read_bytes() == before and not list(folder.glob("skin*"))
    assert sent({"Back.OBJ": content}) == (200, {})
    assert read_json(folder / "subject.json")["skin_scan"] == {**scan, "file": "skin-scan.obj"}
    assert (folder / "skin-scan.obj").read_bytes() == content
    assert "has a skin scan already" in sent({"a.obj": content})[1]["error"]
    for file in ("rest/frontal.dcm", "skin-scan-2.obj", "../girl/skin-scan.obj"):
        with pytest.raises(SubjectError, match="can't be changed here"):
            save(folder, lambda _, values, file=file: values["skin_scan"].update(file=file))
    whole = save(folder, lambda _, values: values["skin_scan"].update(unit="cm"))["skin_scan"]
    assert "skin_scan" not in save(folder, lambda _, values: values.pop("skin_scan"))
    assert save(folder, lambda _, values: values.update(skin_scan=whole))["skin_scan"] == whole
    save(folder, lambda _, values: values.update(skin_scan=None, height_cm=None))
    assert "height_cm is not known yet" in sent({"a.obj": content})[1]["error"]
    save(folder, lambda _, values: values.update(height_cm=157))
    assert sent({"a.obj": content})[0] == 200
    assert read_json(folder / "subject.json")["skin_scan"]["file"] == "skin-scan-2.obj"


def test_a_file_that_the_schema_does_not_allow_is_mended_by_the_form(girl):
    path = girl / "subject.json"
    whole = read_json(path)

    def broken(change):
        values = json.loads(json.dumps(whole))
        change(values, values["pushes"][0])
        path.write_text(json.dumps(values), encoding="utf-8")
        return form_record(girl)["revision"]

    for change in (
        lambda values, _: values.pop("pushes"),
        lambda values, _: values.update(pushes=None),
        lambda values, _: values.update(pushes=[None]),
    ):
        save_form(girl, {**whole, "pushes": []}, broken(change))
        assert read_json(path)["pushes"] == []
    for change in (
        lambda _, push: push["views"][0].pop("files"),
        lambda _, push: push["views"][0].update(files=["a"]),
        lambda _, push: push["views"][0].pop("frames"),
        lambda _, push: push["views"][0].update(frames=3),
        lambda _, push: push.update(views="none"),
        lambda _, push: push.update(views=["none"]),
        lambda _, push: push.update(markers="none"),
    ):
        save_form(girl, whole, broken(change))
        assert read_json(path) == whole


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


def test_a_known_length_is_judged_where_it_stands(root):
    folder = root / "girl"
    values, whole = form_record(folder)["values"], {"object_mm": 25.4, "object_px": [[10, 20], [40.5, 20]]}
    for scale, field, words in (
        ({"rest/frontal": {"object_mm": 25.4}}, "xray.scale.rest/frontal", "wanted length and both ends"),
        ({"push/a": {**whole, "object_mm": 2}}, "xray.scale.push/a.object_mm", "greater than or equal to 5"),
        ({"push/a": {**whole, "object_px": [[1, 2]]}}, "xray.scale.push/a.object_px[1]", "missing"),
        ({"push/a": {**whole, "object_px": [["x", 2], [3, 4]]}}, "xray.scale.push/a.object_px[0][0]", "found 'x'"),
        ({"push/a": {"vertebra": "L1", "width_mm": 420}}, "xray.scale.push/a.width_mm", "less than or equal to 80"),
    ):
        problems = judged({**values, "xray": {"scale": scale}})["problems"]
        assert [one["field"] for one in problems] == [field] and words in problems[0]["text"], problems
    scale = {"push/a": {**whole, "plane": "detector"}, "rest/lateral": {"vertebra": "L1", "width_mm": 42}}
    assert save(folder, lambda _, values: values.update(xray={"scale": scale}))["xray"]["scale"] == scale


def test_each_value_of_a_known_length_has_words():
    assert {name.removeprefix("xray.scale.") for name in WORDS if name.startswith("xray.scale.")} == set(
        ScaleRecord.model_fields
    )


def test_a_radiograph_is_shown_whatever_is_known_of_its_millimetres(served, root):
    path = root / "girl" / "rest" / "frontal.dcm"
    dataset = pydicom.dcmread(path)
    del dataset.ImagerPixelSpacing
    dataset.PixelAspectRatio = [6, 5]
    dataset.save_as(path)
    key, whole = served.key(), "image=rest/frontal&wide=96&tall=128"
    assert served.json("GET", f"/annotate/{key}/api/radiograph?{whole}")[0] == 422
    status, headers, content = served.ask("GET", f"/api/subjects/{key}/radiograph?{whole}")
    about = json.loads(headers["x-radiograph"])
    assert (status, about["rows"], about["columns"]) == (200, *dataset.pixel_array.shape) and len(content) > 1000
    assert about["shape"] == [1.0, 1.2]
    part = f"/api/subjects/{key}/radiograph?image=rest/frontal&wide=160&tall=160&part=100,200,260,360"
    assert json.loads(served.ask("GET", part)[1]["x-radiograph"])["part"] == [100, 200, 260, 360]
    assert served.json("GET", f"/api/subjects/{key}/radiograph?image=push/b&wide=96&tall=128")[0] == 404
    assert served.json("GET", f"/api/subjects/{key}/radiograph?{whole}&part=0,0,9999,1")[0] == 422


def test_so_is_a_view_from_another_side(served, girl):
    for number, path in enumerate(sorted((girl / "pushes" / "a-side").iterdir())):
        dataset = pydicom.dcmread(path)
        del dataset.ImagerPixelSpacing
        dataset.InstanceNumber = number
        dataset.save_as(path)
    key = served.key()
    listed = served.good("GET", f"/api/subjects/{key}/radiographs")
    (image,) = [one["image"] for one in listed["files"] if one["use"] == "push a, view side"]
    whole = f"image={image}&wide=96&tall=128"
    assert served.json("GET", f"/annotate/{key}/api/radiograph?{whole}")[0] == 422
    status, headers, content = served.ask("GET", f"/api/subjects/{key}/radiograph?{whole}")
    about = json.loads(headers.get("x-radiograph", "null"))
    assert status == 200 and (about["rows"], about["columns"]) == dataset.pixel_array.shape and len(content) > 1000
    assert listed["lacking"] == ["push a, view side: no ImagerPixelSpacing"]
