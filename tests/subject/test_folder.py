"""The subject folder: the documented example, and one clear line for everything that can be wrong with it."""

from __future__ import annotations

import copy
import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

from spinestiff.anatomy.template import template_torso
from spinestiff.errors import SubjectError, TorsoError
from spinestiff.imaging.projection import frontal_view, lateral_view, placed_view
from spinestiff.imaging.radiograph import write_radiographs
from spinestiff.study.subject_body import body_notes, subject_template
from spinestiff.subject.annotated_points import image_corners, image_pedicles, image_supports, push_corners
from spinestiff.subject.annotation_record import Annotation, ImageAnnotation
from spinestiff.subject.folder import (
    check_frames,
    read_annotation,
    read_push,
    read_rest,
    read_subject,
    write_annotation,
    write_subject,
)
from spinestiff.subject.output_places import check_output_apart, check_output_beside
from spinestiff.subject.records import SubjectRecord

DOCUMENT = (Path(__file__).parents[2] / "docs/subject-folder.md").read_text(encoding="utf-8")
SUBJECT, ANNOTATION = (json.loads(block) for block in re.findall(r"```json\n(.*?)```", DOCUMENT, re.S))
FRONTAL, LATERAL = frontal_view(), lateral_view()


@pytest.fixture
def folder(tmp_path):
    """The documented example; radiographs are only there, not readable."""
    return lay_out(tmp_path / "03")


def lay_out(folder, subject=SUBJECT, annotation=ANNOTATION):
    for name in ("rest/frontal.dcm", "rest/lateral.dcm", "pushes/right-8.dcm"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"")
    (folder / "subject.json").write_text(json.dumps(subject))
    (folder / "annotation.json").write_text(json.dumps(annotation))
    return folder


def changed(content, path, value):
    """A copy of nested JSON with the entry at ``path`` replaced, or removed if ``value`` is ``...``."""
    content = copy.deepcopy(content)
    inner = content
    for key in path[:-1]:
        inner = inner[key]
    if value is ...:
        del inner[path[-1]]
    else:
        inner[path[-1]] = value
    return content


def refusal(folder):
    with pytest.raises(SubjectError) as caught:
        read_subject(folder)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_the_documented_example_is_read(folder):
    subject = read_subject(folder)
    assert subject.record.height_cm == 152
    assert subject.warnings == ()
    (push,) = subject.pushes
    assert (push.side, push.sign, push.level, push.frames_of("training")) == ("right", 1, 8.5, (1, 2))
    assert subject.image_path("push/right-8") == folder / "pushes/right-8.dcm"
    assert set(image_supports(subject, "push/right-8")) == {"pelvis", "shoulder"}
    assert image_supports(subject, "rest/frontal") == {}


def test_a_folder_that_may_not_be_looked_into_is_told_so(folder, monkeypatch):
    real = Path.lstat

    def closed(self):
        if self.name == "right-8.dcm":
            raise PermissionError(13, "Permission denied")
        return real(self)

    monkeypatch.setattr(Path, "lstat", closed)
    assert "right-8.dcm: can't be read (no permission); wanted the radiograph of push/right-8" in refusal(folder)


@pytest.mark.parametrize("name", ["annotation.json", "subject.json", "rest/new.png", "results/tracked.json"])
def test_an_output_of_another_command_loses_nothing_in_a_subject_folder(folder, name):
    with pytest.raises(SubjectError, match=r"lies among the inputs|this command reads it"):
        check_output_apart(folder / name, "--out", force=True)
    with pytest.raises(SubjectError, match=r"lies among the inputs|this command reads it"):
        check_output_beside(folder.parent / "other", folder / name, "--out", force=True)
    check_output_apart(folder / "results" / "curve.png", "--out", force=True)
    check_output_apart(folder.parent / "curve.png", "--out", force=True)


def test_the_documented_python_runs(folder, monkeypatch, capsys):
    (code,) = re.findall(r"```python\n(.*?)```", DOCUMENT, re.S)
    monkeypatch.chdir(folder.parent)
    exec(code, {})
    assert "right-8 right" in capsys.readouterr().out


def test_every_key_is_documented():
    from spinestiff.subject.records import PushRecord, XRayRecord

    for record in (SubjectRecord, PushRecord, XRayRecord):
        for key in record.model_fields:
            assert f"| `{key}`" in DOCUMENT, key


def test_written_records_read_back_the_same(folder, tmp_path):
    subject = read_subject(folder)
    again = lay_out(tmp_path / "again")
    write_subject(again, subject.record)
    write_annotation(again, subject.annotation)
    back = read_subject(again)
    assert (back.record, back.annotation) == (subject.record, subject.annotation)


def test_records_take_lists_but_no_other_types():
    image = ImageAnnotation.model_validate(ANNOTATION["images"]["rest/frontal"])
    assert image.pixels().shape == (8, 4, 2)
    with pytest.raises(ValueError, match="height_cm"):
        SubjectRecord.model_validate({**SUBJECT, "height_cm": "152"})


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (["colour"], "red", ["colour: unknown key; check its spelling against docs/subject-folder.md"]),
        (["heigth_cm"], 152, ["heigth_cm: unknown key; did you mean height_cm?"]),
        (["pushes", 0, "sied"], "left", ["pushes[0].sied: unknown key; did you mean side?"]),
        (["pushes", 0, "force_n"], 40, ["pushes[0].force_n: unknown key; did you mean forces_n?"]),
        (["weight_kg"], 44, ["weight_kg: unknown key; did you mean mass_kg?"]),
        (["pushes", 0, "load"], 40, ["pushes[0].load: unknown key; did you mean forces_n?"]),
        (["pushes", 0, "rib"], 8, ["pushes[0].rib: unknown key; did you mean level?"]),
        (["forces_n"], [40], ["forces_n: unknown key; check its spelling"]),
        (["xray", "sid"], 1500, ["xray.sid: unknown key"]),
        (["xray", "source_detector"], 1500, ["xray.source_detector: unknown key; did you mean source_detector_mm?"]),
        (["schema_version"], 2, ["schema_version: found 2, wanted 1"]),
        (["age"], ..., ["age: missing"]),
        (["sex"], "f", ["sex: found 'f'", "'female' or 'male'"]),
        (["id"], "../x", ["id: found '../x'"]),
        (["height_cm"], 119.9, ["height_cm: found 119.9, wanted greater than or equal to 120 cm"]),
        (["height_cm"], 1.55, ["height_cm: found 1.55"]),
        (["height_cm"], 201, ["height_cm: found 201", "200"]),
        (["height_cm"], "152", ["height_cm: found '152'", "wanted a number without quotes: 152"]),
        (["height_cm"], "152,5", ["found '152,5'", "without quotes, with a decimal point: 152.5"]),
        (["height_cm"], True, ["height_cm: found true"]),
        (["mass_kg"], 4.5, ["mass_kg: body mass 4.5 kg at 152 cm", "here 28 to 92 kg"]),
        (["xray"], {"source_detector_mm": 1.5}, ["xray.source_detector_mm: found 1.5", "300"]),
        (["xray"], {"imager_pixel_mm": 0.0005}, ["xray.imager_pixel_mm: found 0.0005", "0.02"]),
        (["pushes"], [], ["images.push/right-8: unknown image"]),
        (["pushes"], None, ["pushes: found null"]),
        (["pushes", 0, "side"], "rigth", ["pushes[0].side: found 'rigth'", "'left' or 'right'"]),
        (["pushes", 0, "level"], 13, ["pushes[0].level: found 13"]),
        (["pushes", 0, "d21_mm"], 1200, ["pushes[0].d21_mm: found 1200", "1000"]),
        (["pushes", 0, "d31_mm"], 0, ["pushes[0].d31_mm: found 0", "30"]),
        (["pushes", 0, "d31_mm"], -220, ["pushes[0].d31_mm: found -220"]),
        (["pushes", 0, "d31_mm"], 395, ["d31_mm 395 is not below d21_mm 395"]),
        (["pushes", 0, "d31_mm"], 400, ["d31_mm 400 is not below d21_mm 395", "Eqs. 1-2"]),
        (["pushes", 0, "forces_n"], [0, 20, 41], ["3 forces_n and 4 roles"]),
        (["pushes", 0, "forces_n", 2], -41, ["pushes[0].forces_n", "frame 2 has -41 N", "magnitudes", "side"]),
        (["pushes", 0, "forces_n", 3], 501, ["frame 3 has 501 N", "500"]),
        (["pushes", 0, "forces_n"], [0, 0, 0, 0], ["pushes[0]", "zero", "nothing to identify"]),
        (["pushes", 0, "forces_n"], [0, 0, 0, 9], ["training forces are zero", "nothing to identify"]),
        (["pushes", 0, "roles"], ["unused"] * 3 + ["validation"], ["role training", "at least one"]),
        (["pushes", 0, "roles", 1], "train", ["pushes[0].roles[1]: found 'train'", "'training'"]),
        (["pushes", 0, "frames"], "../04/pushes/a.dcm", ["pushes[0].frames", "inside the subject folder"]),
        (["pushes", 0, "frames"], "/data/a.dcm", ["pushes[0].frames", "inside the subject folder"]),
        (["pushes", 0, "frames"], "C:\\a.dcm", ["pushes[0].frames", "inside the subject folder"]),
        (["pushes", 0, "frames"], "pushes\\..\\..\\a.dcm", ["pushes[0].frames", "inside the subject folder"]),
        (["pushes", 0, "frames"], " ", ["pushes[0].frames", "inside the subject folder"]),
        (["pushes", 0, "frames"], "pushes/lost.dcm", ["lost.dcm: no such file", "push/right-8"]),
    ],
)
def test_subject_file_refusals(folder, path, value, words):
    lay_out(folder, subject=changed(SUBJECT, path, value))
    message = refusal(folder)
    for word in ("subject" if "no such file" not in message else "", *words):
        assert word in message


def test_ids_are_unique_on_any_file_system(folder):
    twice = [SUBJECT["pushes"][0], {**SUBJECT["pushes"][0], "id": "Right-8"}]
    lay_out(folder, subject={**SUBJECT, "pushes": twice})
    assert "pushes[1].id: 'Right-8' is used twice" in refusal(folder)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, "pushes[1].frames: found 'pushes/right-8.dcm', which pushes[0].frames has already"),
        ({"frames": "./pushes/right-8.dcm"}, "pushes[1].frames: found './pushes/right-8.dcm', which pushes[0].frames"),
        (
            {"frames": "b.dcm", "views": [{"id": "side", "kind": "frontal", "files": "b.dcm", "frames": [1]}]},
            "pushes[1].views[0].files: found 'b.dcm', which pushes[1].frames has already",
        ),
    ],
)
def test_the_same_radiographs_do_not_count_twice(folder, change, words):
    twice = [SUBJECT["pushes"][0], {**SUBJECT["pushes"][0], "id": "left-8", **change}]
    lay_out(folder, subject={**SUBJECT, "pushes": twice})
    assert words in refusal(folder)


def test_more_force_than_anybody_measured_is_a_warning(folder):
    lay_out(folder, subject=changed(SUBJECT, ["pushes", 0, "forces_n", 3], 120))
    (warning,) = read_subject(folder).warnings
    assert "120 N" in warning
    assert "114 N" in warning


def test_several_complaints_are_counted(folder):
    lay_out(folder, subject={**SUBJECT, "age": -1, "sex": "x", "colour": 1})
    assert refusal(folder).endswith("(and 2 more)")


@pytest.mark.parametrize("name", ["subject.json", "annotation.json"])
@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("{", "not JSON at line 1"),
        ('{"schema_version": 1, "schema_version": 1}', "'schema_version' is given twice"),
        ('{"age": NaN}', "found NaN"),
        ('{"age": -Infinity}', "found -Infinity"),
        ('{"age": 1e999}', "found 1e999"),
        ('{"age": ' + "9" * 5000 + "}", "too many digits"),
        ("[" * 100_000, "nested too deeply"),
        ("[]", "found []"),
        ("", "is empty, wanted JSON"),
        (" " * (10 * 2**20 + 1), "10.0 MB; at most 10 MB are read"),
    ],
)
def test_broken_json_is_one_line(folder, name, text, word):
    (folder / name).write_text(text)
    message = refusal(folder)
    assert word in message
    assert name in message


def test_text_that_is_not_utf8_is_refused_and_a_byte_order_mark_is_not(folder):
    (folder / "subject.json").write_bytes(b'{"id": "\xff"}')
    assert "not UTF-8" in refusal(folder)
    (folder / "subject.json").write_text(json.dumps(SUBJECT), encoding="utf-8-sig")
    assert read_subject(folder).record.id == "03"


@pytest.mark.parametrize(("value", "wanted"), [([], "at least 1 item"), ("tissue", "a list")])
def test_a_list_is_told_in_words_of_the_file(folder, value, wanted):
    (folder / "subject.json").write_text(json.dumps({**SUBJECT, "parameters": value}), encoding="utf-8")
    assert refusal(folder).endswith(f"parameters: found {value!r}, wanted {wanted}")


def test_what_is_missing_is_named(folder):
    assert "nowhere: no such folder; wanted a subject folder" in refusal(folder / "nowhere")
    assert "subject.json: no folder; wanted a subject folder" in refusal(folder / "subject.json")
    (folder / "rest/lateral.dcm").unlink()
    assert "lateral.dcm: no such file" in refusal(folder)
    (folder / "annotation.json").unlink()
    assert "no annotation" in refusal(folder)
    (folder / "subject.json").unlink()
    assert "subject.json: no such file" in refusal(folder)


def test_a_link_out_of_the_folder_is_refused(folder):
    outside = folder.parent / "elsewhere.dcm"
    outside.write_bytes(b"")
    (folder / "pushes/right-8.dcm").unlink()
    (folder / "pushes/right-8.dcm").symlink_to(outside)
    assert f"leads out of the folder {folder.name}; copy the file into it" in refusal(folder)


# Annotation

IMAGE = ("images", "rest/frontal", "vertebrae")


def test_shares_of_an_images_size_are_no_corners(folder):
    """As in a file of corners; every step would take them for a spine of one pixel."""
    vertebrae = ANNOTATION["images"]["rest/frontal"]["vertebrae"]
    shares = {name: [[x / 2500.0, y / 2500.0] for x, y in quad] for name, quad in vertebrae.items()}
    lay_out(folder, annotation=changed(ANNOTATION, ["images", "rest/frontal", "vertebrae"], shares))
    message = refusal(folder)
    assert "annotation.json: images.rest/frontal.vertebrae: all corners lie within 0." in message
    assert message.endswith("shares of the image's size, wanted pixels; multiply x by its columns and y by its rows")


FIRST, SECOND = (ANNOTATION["images"]["rest/frontal"]["vertebrae"][name] for name in ("T5", "T6"))


def reordered(order):
    return changed(
        ANNOTATION, [*IMAGE, "T7"], [ANNOTATION["images"]["rest/frontal"]["vertebrae"]["T7"][i] for i in order]
    )


@pytest.mark.parametrize(
    ("annotation", "words"),
    [
        (changed(ANNOTATION, [*IMAGE, "T7"], ...), ["rest/frontal", "7 vertebrae", "at least 8"]),
        (changed(ANNOTATION, ["images", "rest/lateral"], ...), ["images.rest/lateral: missing"]),
        (changed(ANNOTATION, ["images", "push/right-8"], ...), ["images.push/right-8: missing"]),
        (
            changed(ANNOTATION, ["images", "push/right-9"], ANNOTATION["images"]["push/right-8"]),
            ["images.push/right-9: unknown image"],
        ),
        (changed(ANNOTATION, [*IMAGE, "C7"], FIRST), ["rest/frontal.vertebrae.C7", "'T1'"]),
        (changed(ANNOTATION, [*IMAGE, "T7"], FIRST[:3]), ["rest/frontal.vertebrae.T7"]),
        (changed(ANNOTATION, [*IMAGE, "T7", 0], [1, 2, 3]), ["rest/frontal.vertebrae.T7[0]"]),
        (changed(ANNOTATION, [*IMAGE, "T7", 0], ["1", 2]), ["rest/frontal.vertebrae.T7[0][0]: found '1'"]),
        (changed(ANNOTATION, ["schema_version"], 3), ["schema_version: found 3"]),
        (changed(ANNOTATION, ["images", "rest/frontal", "notes"], ""), ["rest/frontal.notes: unknown key"]),
        (changed(ANNOTATION, ["images", "rest/frontal", "vertebra"], {}), ["did you mean vertebrae?"]),
        (reordered([0, 1, 3, 2]), ["rest/frontal", "T7", "no convex quadrilateral"]),
        (changed(ANNOTATION, [*IMAGE, "T7"], [[500, 340]] * 4), ["rest/frontal", "T7", "no convex"]),
        (reordered([1, 0, 3, 2]), ["rest/frontal", "T7", "mirrored"]),
        (reordered([2, 3, 0, 1]), ["rest/frontal", "T7", "superior corners lie below"]),
        (
            changed(changed(ANNOTATION, [*IMAGE, "T5"], SECOND), [*IMAGE, "T6"], FIRST),
            ["rest/frontal", "T6", "does not lie below T5"],
        ),
        (
            changed(ANNOTATION, ["images", "rest/frontal", "supports"], {"pelvis": [[400, 700]]}),
            ["rest/frontal has supports"],
        ),
        (changed(ANNOTATION, ["images", "push/right-8", "supports", "hip"], [[1, 2]]), ["supports.hip"]),
        (changed(ANNOTATION, ["images", "push/right-8", "supports", "pelvis"], []), ["supports.pelvis"]),
    ],
)
def test_annotation_refusals(folder, annotation, words):
    lay_out(folder, annotation=annotation)
    message = refusal(folder)
    for word in ("annotation.json", *words):
        assert word in message


FURTHER = {"vertebrae": {"T8": ANNOTATION["images"]["push/right-8"]["vertebrae"]["T8"]}}


def test_further_frames_of_a_push(folder):
    """One vertebra corrected in the third frame; the first stays what a push needs."""
    lay_out(folder, annotation=changed(ANNOTATION, ["images", "push/right-8/2"], FURTHER))
    subject = read_subject(folder)
    (push,) = subject.pushes
    assert subject.image_path("push/right-8/2") == subject.image_path("push/right-8")
    corners = push_corners(subject, push, FRONTAL)
    assert list(corners) == [0, 2]
    assert (len(corners[0].vertebrae), corners[2].vertebrae) == (8, ("T8",))
    write_annotation(folder, subject.annotation)
    assert read_subject(folder).annotation == subject.annotation


@pytest.mark.parametrize(
    ("name", "image", "words"),
    [
        ("push/right-8/4", FURTHER, "push/right-8/4: the push has 4 frames, counted from 0"),
        ("push/right-8/0", FURTHER, "push/right-8/0"),
        ("push/right-8/02", FURTHER, "push/right-8/02"),
        ("push/left-8/2", FURTHER, "images.push/left-8/2: unknown image"),
        ("push/right-8/2", {"vertebrae": {}}, "found no vertebra, wanted at least one"),
        ("push/right-8/2", {**FURTHER, "supports": {"pelvis": [[1, 2]]}}, "wanted them in the push's first frame"),
        (
            "push/right-8/2",
            {"vertebrae": {"T8": FURTHER["vertebrae"]["T8"][::-1]}},
            "T8: the superior corners",
        ),
    ],
)
def test_further_frames_that_are_refused(folder, name, image, words):
    lay_out(folder, annotation=changed(ANNOTATION, ["images", name], image))
    with pytest.raises(SubjectError, match=re.escape(words)):
        subject = read_subject(folder)
        push_corners(subject, subject.pushes[0], FRONTAL)


def tilted(image, degrees, shift, only=None):
    """The example with an image's vertebrae tilted in place, and all, or ``only`` one, begun ``shift`` corners on."""
    turn = np.radians(degrees)
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    vertebrae = {}
    for name, quad in ANNOTATION["images"][image]["vertebrae"].items():
        points = np.array(quad)
        points = points.mean(axis=0) + (points - points.mean(axis=0)) @ rotation
        vertebrae[name] = np.roll(points, -shift if only in (None, name) else 0, axis=0).tolist()
    return changed(ANNOTATION, ["images", image, "vertebrae"], vertebrae)


@pytest.mark.parametrize("image", ["rest/frontal", "rest/lateral", "push/right-8"])
@pytest.mark.parametrize("degrees", [-12.0, 0.0, 12.0])
@pytest.mark.parametrize("shift", [1, 3])
def test_corners_begun_at_the_wrong_one_are_refused(folder, image, degrees, shift):
    """Of every vertebra or of one, at rest and under a push; tilted, "superior" may well lie above "inferior"."""
    lay_out(folder, annotation=tilted(image, degrees, 0))
    read_subject(folder)
    for only in (None, "T5", "T9"):
        lay_out(folder, annotation=tilted(image, degrees, shift, only))
        message = refusal(folder)
        assert image in message and (only or "T5") in message and "begin at the wrong one" in message


@pytest.mark.parametrize("shift", [1, 2, 3])
def test_a_further_frame_is_compared_with_the_first(folder, shift):
    """One vertebra alone: only the first frame can tell how it stands."""
    one = {"vertebrae": {"T8": np.roll(FURTHER["vertebrae"]["T8"], -shift, axis=0).tolist()}}
    lay_out(folder, annotation=changed(ANNOTATION, ["images", "push/right-8/2"], one))
    message = refusal(folder)
    assert "push/right-8/2.vertebrae.T8: turned by" in message and "since the push's first frame" in message


def test_one_vertebra_is_one(folder):
    few = {"T5": FIRST}
    lay_out(folder, annotation=changed(ANNOTATION, IMAGE, few))
    assert "found 1 vertebra, wanted at least 8" in refusal(folder)


def test_vertebrae_may_be_written_in_any_order(folder):
    shuffled = dict(reversed(ANNOTATION["images"]["rest/frontal"]["vertebrae"].items()))
    lay_out(folder, annotation=changed(ANNOTATION, IMAGE, shuffled))
    assert tuple(read_annotation(folder / "annotation.json").images["rest/frontal"].vertebrae)[:2] == ("T5", "T6")


def test_corners_become_millimetres_on_the_detector(folder):
    corners = image_corners(read_subject(folder), "rest/frontal", FRONTAL)
    assert corners.vertebrae[0] == "T5"
    np.testing.assert_allclose(corners.corners[0], np.array(FIRST) * 0.417)
    assert image_corners(read_subject(folder), "rest/lateral", LATERAL).vertebrae[-1] == "T12"


def test_the_trunk_by_tape(folder):
    assert read_subject(folder).record.trunk == {}
    size = {"breadth_mm": 245, "depth_mm": 172.5}
    lay_out(folder, subject=changed(SUBJECT, ["trunk"], {"T9": size}))
    record = read_subject(folder).record
    assert record.trunk["T9"].depth_mm == 172.5
    write_subject(folder, record)
    assert read_subject(folder).record == record
    lay_out(folder, subject=changed(SUBJECT, ["trunk"], {"T9": {**size, "breadth_mm": 24.5}}))
    assert "trunk.T9.breadth_mm: found 24.5, wanted greater than or equal to 100" in refusal(folder)


def test_the_skin_scan(folder):
    assert read_subject(folder).scan_path is None
    scan = {"file": "scan.stl", "unit": "cm", "axes": {"left": "+x", "up": "+z", "front": "-y"}}
    lay_out(folder, subject=changed(SUBJECT, ["skin_scan"], scan))
    assert "scan.stl: no such file; wanted the skin scan" in refusal(folder)
    (folder / "scan.stl").write_bytes(b"solid")
    subject = read_subject(folder)
    assert subject.scan_path == folder / "scan.stl"
    write_subject(folder, subject.record)
    assert read_subject(folder).record == subject.record
    wrong = {
        "skin_scan.unit: found 'inch', wanted 'mm', 'cm' or 'm'": {**scan, "unit": "inch"},
        "skin_scan.unit: missing": {key: value for key, value in scan.items() if key != "unit"},
        "skin_scan.file: found '../scan.stl', wanted a path inside the subject folder": {**scan, "file": "../scan.stl"},
        "in a mirror": {**scan, "axes": {"left": "+x", "up": "+z", "front": "+y"}},
        "skin_scan.axes.front: missing": {**scan, "axes": {"left": "+x", "up": "+z"}},
    }
    for line, record in wrong.items():
        lay_out(folder, subject=changed(SUBJECT, ["skin_scan"], record))
        assert line in refusal(folder)
    outside = folder.parent / "elsewhere.stl"
    outside.write_bytes(b"solid")
    (folder / "link.stl").symlink_to(outside)
    lay_out(folder, subject=changed(SUBJECT, ["skin_scan"], {**scan, "file": "link.stl"}))
    assert f"leads out of the folder {folder.name}" in refusal(folder)


PEDICLES = {"T6": [[523, 312], [502, 312.5]], "T5": [[522, 280], [503, 280]]}


def test_pedicles_become_millimetres_on_the_detector(folder):
    assert image_pedicles(read_subject(folder), "rest/frontal", FRONTAL)[0] == ()
    lay_out(folder, annotation=changed(ANNOTATION, ["images", "rest/frontal", "pedicles"], PEDICLES))
    names, points = image_pedicles(read_subject(folder), "rest/frontal", FRONTAL)
    assert names == ("T5", "T6")
    np.testing.assert_allclose(points[0], np.array(PEDICLES["T5"]) * 0.417)


def test_pedicles_out_of_place_are_refused(folder):
    swapped = {"T5": PEDICLES["T5"][::-1]}
    lay_out(folder, annotation=changed(ANNOTATION, ["images", "rest/frontal", "pedicles"], swapped))
    with pytest.raises(SubjectError, match=r"rest/frontal.pedicles.T5: the left one lies right of the right one"):
        image_pedicles(read_subject(folder), "rest/frontal", FRONTAL)
    one = {"T5": PEDICLES["T5"][:1]}
    lay_out(folder, annotation=changed(ANNOTATION, ["images", "rest/frontal", "pedicles"], one))
    assert "rest/frontal.pedicles.T5" in refusal(folder)


def test_pedicles_of_a_push_may_stand_alone_in_its_later_frames(folder):
    more = changed(ANNOTATION, ["images", "push/right-8", "pedicles"], PEDICLES)
    more = changed(more, ["images", "push/right-8/2"], {"vertebrae": {}, "pedicles": PEDICLES})
    subject = read_subject(lay_out(folder, annotation=more))
    assert image_pedicles(subject, "push/right-8/2", FRONTAL)[0] == ("T5", "T6")
    # What holds pedicles alone is no frame that tracking starts from.
    assert list(push_corners(subject, subject.pushes[0], FRONTAL)) == [0]
    lay_out(folder, annotation=changed(more, ["images", "push/right-8/2"], {"vertebrae": {}}))
    assert "push/right-8/2: vertebrae: found no vertebra, wanted at least one" in refusal(folder)
    lay_out(folder, annotation=changed(more, ["images", "push/right-8", "vertebrae"], {}))
    assert "push/right-8.vertebrae: found 0 vertebrae, wanted at least 8" in refusal(folder)


VIEW = {"id": "side", "kind": "lateral", "files": "pushes/right-8-side.dcm", "frames": [0, 2]}
SIDE_MARKS = {"vertebrae": ANNOTATION["images"]["rest/lateral"]["vertebrae"]}


def with_view(folder, marks=(0, 2), **changes):
    """The example with a lateral radiograph of two frames of its push."""
    images = {**ANNOTATION["images"], **{f"push/right-8/{frame}/side": SIDE_MARKS for frame in marks}}
    (folder / "pushes").mkdir(parents=True, exist_ok=True)
    (folder / "pushes/right-8-side.dcm").write_bytes(b"")
    subject = changed(SUBJECT, ["pushes", 0, "views"], [{**VIEW, **changes}])
    return lay_out(folder, subject=subject, annotation={**ANNOTATION, "images": images})


def test_radiographs_from_other_sides_belong_to_frames_of_a_push(folder):
    subject = read_subject(with_view(folder))
    (push,) = subject.pushes
    assert push.view_image(2, "side") == "push/right-8/2/side"
    assert subject.image_path("push/right-8/2/side") == folder / "pushes/right-8-side.dcm"
    assert len(image_corners(subject, "push/right-8/2/side", LATERAL)) == 8
    written = folder.parent / "again"
    write_subject(with_view(written), subject.record)
    assert read_subject(written).record == subject.record


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"frames": [0, 4]}, "pushes[0]: views[0].frames: found frame 4, but the push has 4 frames, counted from 0"),
        ({"frames": [0, 0]}, "views[0].frames: found frame 0 twice, wanted each once"),
        ({"frames": [-1]}, "views[0].frames[0]: found -1, wanted greater than or equal to 0"),
        ({"kind": "oblique"}, "views[0].kind: found 'oblique', wanted 'frontal' or 'lateral'"),
        ({"turned_deg": 45}, "views[0].turned_deg: found 45, wanted less than or equal to 40"),
        ({"files": "../side.dcm"}, "views[0].files: found '../side.dcm', wanted a path inside the subject folder"),
        ({"files": "elsewhere.dcm"}, "elsewhere.dcm: no such file; wanted the radiograph of push/right-8/0/side"),
        ({"frames": [0, 1]}, "images.push/right-8/2/side: no such view of this frame in subject.json"),
        ({"id": "left side"}, "views[0].id: found 'left side', wanted 1 to 64 letters"),
    ],
)
def test_impossible_views_are_refused(folder, changes, words):
    assert words in refusal(with_view(folder, **changes))


def subject_view(folder):
    return read_subject(folder).pushes[0].views[0]


def test_what_is_marked_in_a_view_is_checked(folder):
    # Tracking follows corners into frame 2, not into the one without force.
    assert read_subject(with_view(folder, (0,))).pushes[0].least_of(subject_view(folder)) == 0
    assert "images.push/right-8/0/side: missing; wanted the vertebra corners" in refusal(with_view(folder, (2,)))
    few = {"vertebrae": dict(list(SIDE_MARKS["vertebrae"].items())[:2])}
    with_view(folder)
    content = json.loads((folder / "annotation.json").read_text())
    for marks, words in (
        (few, "push/right-8/2/side.vertebrae: found 2 vertebrae, wanted at least 3"),
        ({**SIDE_MARKS, "supports": {"pelvis": [[1, 2]]}}, "push/right-8/2/side has supports; wanted them in the"),
    ):
        wrong = changed(content, ["images", "push/right-8/2/side"], marks)
        (folder / "annotation.json").write_text(json.dumps(wrong))
        assert words in refusal(folder)
    subject = changed(SUBJECT, ["pushes", 0, "views"], [VIEW, {**VIEW, "id": "Side"}])
    (folder / "subject.json").write_text(json.dumps(subject))
    assert "views[1].id: 'Side' is used twice" in refusal(folder)


@pytest.mark.parametrize("place", [[-3.0, 300.0], [1024.0, 300.0], [500.0, -0.6], [500.0, 1023.6]])
@pytest.mark.parametrize("which", [0, 1])
def test_pedicles_outside_the_picture_are_refused(folder, place, which):
    pair = [[521.0, 378.0], [503.0, 378.5]]
    pair[which] = place
    lay_out(folder, annotation=changed(ANNOTATION, ["images", "rest/frontal", "pedicles"], {"T8": pair}))
    words = (
        f"annotation.json: images.rest/frontal.pedicles.T8: found a pedicle at column {place[0]:g}, row {place[1]:g}, "
        "wanted it in the image of 1024 columns and 1024 rows"
    )
    with pytest.raises(SubjectError, match=re.escape(words)):
        image_pedicles(read_subject(folder), "rest/frontal", FRONTAL)


def test_the_lateral_radiograph_may_be_missing(folder):
    """Neither radiograph nor annotation: the frontal one is used alone. One of the two without the other is refused."""
    assert read_subject(folder).rest_views == ("frontal", "lateral")
    lay_out(folder, annotation=changed(ANNOTATION, ["images", "rest/lateral"], ...))
    assert "images.rest/lateral: missing" in refusal(folder)
    (folder / "rest/lateral.dcm").unlink()
    subject = read_subject(folder)
    assert subject.rest_views == ("frontal",)


def test_corners_are_checked_against_the_view(folder):
    subject = read_subject(folder)
    common = {"sid": 1500.0, "source_to_patient": 1340.0, "shape": (1024, 1024), "pixel": 0.417, "centre": (0, 0, 0)}
    x, y, z = np.eye(3)
    with pytest.raises(SubjectError, match=r"rest/frontal.T5: corners are mirrored"):
        image_corners(subject, "rest/frontal", placed_view(-x, -y, z, **common))
    with pytest.raises(SubjectError, match=r"rest/frontal.T5: the superior corners lie below"):
        image_corners(subject, "rest/frontal", placed_view(-x, y, z, **common))
    with pytest.raises(SubjectError, match=r"vertebrae.T10: found a corner at .*, wanted it in the image of 1024"):
        image_corners(subject, "rest/frontal", frontal_view(shape=(460, 1024)))
    with pytest.raises(SubjectError, match=r"images.push/left: missing"):
        image_corners(subject, "push/left", FRONTAL)


# Radiographs


@pytest.fixture
def imaged(folder):
    """The example with small radiographs: a frontal, a lateral and four frames of a push."""
    front, side = frontal_view(shape=(40, 30)), lateral_view(shape=(40, 30))
    grey = np.arange(4 * 40 * 30, dtype=np.uint16).reshape(4, 40, 30)
    write_radiographs(folder / "rest/frontal.dcm", grey[:1], front)
    write_radiographs(folder / "rest/lateral.dcm", grey[:1], side)
    write_radiographs(folder / "pushes/right-8.dcm", grey, front)
    return folder


def test_radiographs_are_read(imaged):
    subject = read_subject(imaged)
    assert read_rest(subject, "frontal").pixels.shape == (40, 30)
    assert read_rest(subject, "lateral").view.detector_axes[0] @ [0, 0, 1] > 0.9
    assert len(read_push(subject, subject.push("right-8"))) == 4
    with pytest.raises(SubjectError, match=r"no push 'left'; there are right-8"):
        subject.push("left")


def test_frames_and_forces_are_counted(imaged):
    grey = np.arange(3 * 40 * 30, dtype=np.uint16).reshape(3, 40, 30)
    write_radiographs(imaged / "pushes/right-8.dcm", grey, frontal_view(shape=(40, 30)))
    subject = read_subject(imaged)
    with pytest.raises(SubjectError, match=r"push 'right-8' has 4 forces_n, but pushes/right-8.dcm holds 3 frames"):
        read_push(subject, subject.pushes[0])
    check_frames(subject, subject.pushes[0], 4)
    write_radiographs(imaged / "rest/frontal.dcm", grey, frontal_view(shape=(40, 30)))
    with pytest.raises(SubjectError, match="found 3 frames, wanted one rest radiograph"):
        read_rest(subject, "frontal")


def test_a_lateral_in_the_place_of_a_frontal_is_refused(imaged):
    (imaged / "rest/frontal.dcm").write_bytes((imaged / "rest/lateral.dcm").read_bytes())
    with pytest.raises(SubjectError, match="a lateral radiograph, wanted a frontal one"):
        read_rest(read_subject(imaged), "frontal")


def test_annotation_needs_no_file_to_be_built(tmp_path):
    images = {name: ImageAnnotation.model_validate(image) for name, image in ANNOTATION["images"].items()}
    write_annotation(tmp_path, Annotation(schema_version=1, images=images))
    assert read_annotation(tmp_path / "annotation.json").images == images


def test_the_template_is_a_body_of_the_subjects_age_sex_and_mass(folder):
    record = read_subject(folder).record.model_copy(update={"age": 15.0, "sex": "male"})

    def same(found, **body):
        wanted = template_torso(152.0, **body).tissue.rest_positions
        return np.array_equal(found.tissue.rest_positions, wanted)

    usual = subject_template(record, "coarse")
    own = subject_template(record.model_copy(update={"mass_kg": 60.0}), "coarse")
    assert same(usual, age_years=15.0, sex="male")
    assert not same(usual)
    assert same(own, age_years=15.0, sex="male", mass_kg=60.0)
    assert own.tissue.corner_volumes().sum() > 1.1 * usual.tissue.corner_volumes().sum()


@pytest.mark.parametrize(("age", "taken"), [(6.0, 8.0), (110.0, 100.0)])
def test_who_is_younger_or_older_than_the_template_has_its_youngest_or_oldest(folder, age, taken):
    record = read_subject(folder).record
    found = [subject_template(record.model_copy(update={"age": years}), "coarse") for years in (age, taken)]
    np.testing.assert_array_equal(found[0].tissue.rest_positions, found[1].tissue.rest_positions)
    assert body_notes(record.model_copy(update={"age": age})) == [
        f"age {age:g}: the template's body is one of {taken:g} years"
    ]
    assert body_notes(record.model_copy(update={"age": taken})) == []


def test_a_body_that_the_template_has_not_is_named_by_its_sizes(folder):
    record = read_subject(folder).record.model_copy(update={"age": 8.0, "sex": "male", "height_cm": 198.0})
    with pytest.raises(TorsoError, match=r"no body of 8 years, male, 198 cm: the tissue mesh .*; see whether subject"):
        subject_template(record, "coarse")


def test_keys_and_paths_that_are_odd_are_shown_in_short(folder):
    for key, shown in (("a" * 5000, "'aaa"), ("a\0b", r"'a\x00b'"), ("", "''"), ("\n", r"'\n'")):
        lay_out(folder, subject={**SUBJECT, key: 1})
        message = refusal(folder)
        assert f"subject.json: {shown}" in message and "unknown key" in message
        assert len(message) < 200 + len(str(folder)) and message.isprintable()
    lay_out(folder, subject=changed(SUBJECT, ["pushes", 0, "frames"], "a" * 5000))
    assert "wanted at most 250 characters that can be printed" in refusal(folder)
    lay_out(folder, subject=changed(SUBJECT, ["schema_version"], None))
    assert "schema_version: found null" in refusal(folder)
    lay_out(folder, subject=changed(SUBJECT, ["id"], "a b"))
    assert "id: found 'a b', wanted 1 to 64 letters" in refusal(folder)


@pytest.mark.skipif(os.name == "nt", reason="pipes and links of Unix")
def test_a_frame_that_is_no_file_is_refused_unopened(folder):
    path = folder / "pushes/right-8.dcm"
    path.unlink()
    os.mkfifo(path)
    assert "right-8.dcm: found a named pipe, wanted a file" in refusal(folder)
    path.unlink()
    path.mkdir()
    assert "right-8.dcm: found an empty folder, wanted the radiograph of push/" in refusal(folder)
    os.mkfifo(path / "1.dcm")
    assert "1.dcm: found a named pipe, wanted a file" in refusal(folder)
    (path / "1.dcm").unlink()
    with (path / "1.dcm").open("wb") as file:
        file.truncate(2**40)
    assert "1.dcm: 1048576.0 MB; at most 4097 MB are read" in refusal(folder)


def test_inputs_do_not_lie_where_results_are_written(folder):
    (folder / "results").mkdir()
    (folder / "pushes/right-8.dcm").rename(folder / "results/right-8.dcm")
    lay_out(folder, subject=changed(SUBJECT, ["pushes", 0, "frames"], "results/right-8.dcm"))
    assert "right-8.dcm: lies where results are written" in refusal(folder)
