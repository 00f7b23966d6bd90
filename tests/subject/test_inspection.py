"""What ``spinestiff inspect`` tells: of files, of folders, of subjects; never of the patient."""

from __future__ import annotations

import copy
import json
import os
import re
import warnings
from pathlib import Path

import numpy as np
import pydicom
import pytest

from hospital import trunk
from spinestiff.app import cli
from spinestiff.errors import RadiographError, SubjectError
from spinestiff.imaging.projection import frontal_view, lateral_view
from spinestiff.imaging.radiograph import write_radiographs
from spinestiff.subject.folder import read_push, read_rest, read_subject, read_view
from spinestiff.subject.inspection import inspect
from spinestiff.subject.records import SubjectRecord

DOCUMENT = (Path(__file__).parents[2] / "docs/subject-folder.md").read_text(encoding="utf-8")
SUBJECT, ANNOTATION = (json.loads(block) for block in re.findall(r"```json\n(.*?)```", DOCUMENT, re.S))
CANARY = "SECRETCANARY"


@pytest.fixture
def folder(tmp_path):
    """The documented subject with large enough radiographs for its corners."""
    front, side = frontal_view(shape=(800, 800)), lateral_view(shape=(800, 800))
    grey = np.zeros((4, 800, 800), np.uint16)
    for name, pixels, view in (("rest/frontal", grey[:1], front), ("rest/lateral", grey[:1], side),
                               ("pushes/right-8", grey, front)):  # fmt: skip
        path = tmp_path / "03" / f"{name}.dcm"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_radiographs(path, pixels, view, description=name, frame_time_ms=250.0)
    write(tmp_path / "03", SUBJECT, ANNOTATION)
    return tmp_path / "03"


def write(folder, subject=None, annotation=None):
    for name, content in (("subject.json", subject), ("annotation.json", annotation)):
        if content is not None:
            (folder / name).write_text(json.dumps(content))


def without(path, *keywords, **values):
    dataset = pydicom.dcmread(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for keyword in keywords:
            delattr(dataset, keyword)
        for keyword, value in values.items():
            setattr(dataset, keyword, value)
        dataset.save_as(path)


def scaled(**scales):
    return {**SUBJECT, "xray": {**SUBJECT["xray"], "scale": {key.replace("__", "/"): s for key, s in scales.items()}}}


OBJECT = {"object_mm": 25.0, "object_px": [[100, 200], [160, 280]]}


def test_an_object_sets_the_scale_of_its_image(folder):
    without(folder / "rest/frontal.dcm", "ImagerPixelSpacing")
    write(folder, scaled(rest__frontal=OBJECT))
    picture = read_rest(read_subject(folder), "frontal")
    np.testing.assert_allclose(picture.view.pixel_spacing, 0.25 * 1500.0 / 1340.0)
    source = picture.provenance["pixel spacing"]
    assert source == "calibration object of 25 mm over 100.0 pixels at the patient plane, times the magnification"
    write(folder, scaled(rest__frontal={**OBJECT, "plane": "detector"}))
    np.testing.assert_allclose(read_rest(read_subject(folder), "frontal").view.pixel_spacing, 0.25)


def test_a_vertebra_sets_the_scale_of_its_image(folder):
    without(folder / "pushes/right-8.dcm", "ImagerPixelSpacing")
    write(folder, scaled(**{"push__right-8": {"vertebra": "T12", "width_mm": 30.0}}))
    subject = read_subject(folder)
    for picture in read_push(subject, subject.pushes[0]):
        np.testing.assert_allclose(picture.view.pixel_spacing, 30.0 / 49.0 * 1500.0 / 1340.0)
        assert picture.provenance["pixel spacing"].startswith("vertebra T12 of 30 mm over 49.0 pixels")


def test_a_vertebra_that_contradicts_the_file_is_refused(folder):
    true = 49 * 0.417 * 1340.0 / 1500.0
    write(folder, scaled(rest__frontal={"vertebra": "T12", "width_mm": 1.09 * true}))
    read_rest(read_subject(folder), "frontal")
    write(folder, scaled(rest__frontal={"vertebra": "T12", "width_mm": 1.2 * true}))
    (one, *_) = inspect(folder)
    assert one.status == "refused" and "found 18.25 mm for the vertebra T12, wanted 21.9042 mm" in one.reason


@pytest.mark.parametrize(
    ("scale", "message"),
    [
        ({"rest/frontal": {"object_mm": 25.0}}, "wanted object_mm, object_px and perhaps plane; or vertebra and width"),
        ({"rest/frontal": {**OBJECT, "vertebra": "L1", "width_mm": 40}}, "wanted object_mm, object_px"),
        ({"rest/frontal": {"vertebra": "L1", "width_mm": 40, "plane": "patient"}}, "wanted object_mm, object_px"),
        ({"rest/front": OBJECT}, "xray.scale.'rest/front': unknown image; wanted one of rest/frontal"),
        ({"rest/frontal": {**OBJECT, "object_mm": 2}}, "greater than or equal to 5"),
    ],
)
def test_a_scale_that_says_too_little_or_too_much_is_refused(folder, scale, message):
    write(folder, {**SUBJECT, "xray": {"scale": scale}})
    with pytest.raises(SubjectError, match=re.escape(message)):
        read_subject(folder)


def test_a_vertebra_without_corners_sets_no_scale(folder):
    write(folder, scaled(rest__frontal={"vertebra": "L5", "width_mm": 45}))
    with pytest.raises(SubjectError, match=r"xray.scale.rest/frontal: L5 is not annotated in this image"):
        read_rest(read_subject(folder), "frontal")
    assert inspect(folder)[0].reason.startswith("xray.scale.rest/frontal: L5")


def test_an_image_may_have_a_geometry_of_its_own(folder):
    for name in ("rest/frontal", "rest/lateral", "pushes/right-8"):
        without(folder / f"{name}.dcm", "DistanceSourceToDetector", "DistanceSourceToPatient")
    without(folder / "rest" / "lateral.dcm", "ImagerPixelSpacing")
    usual = {"source_detector_mm": 1500.0, "source_patient_mm": 1340.0}
    own = {"source_detector_mm": 1830.0, "imager_pixel_mm": 0.25}
    write(folder, {**SUBJECT, "xray": {**usual, "images": {"rest/lateral": own}}})
    subject = read_subject(folder)
    lateral, frontal = (read_rest(subject, which).view for which in ("lateral", "frontal"))
    assert (lateral.source_to_detector, lateral.source_to_patient) == (1830.0, 1340.0)
    np.testing.assert_allclose(lateral.pixel_spacing, 0.25)
    assert (frontal.source_to_detector, frontal.source_to_patient) == (1500.0, 1340.0)
    assert read_push(subject, subject.pushes[0])[0].view.source_to_detector == 1500.0
    assert not any(one.reason or one.missing for one in inspect(folder))
    own_only = {**SUBJECT, "xray": {**usual, "images": {"rest/lateral": {**own, "source_patient_mm": 1900.0}}}}
    write(folder, own_only)
    with pytest.raises(RadiographError, match="wanted the patient nearer to the source"):
        read_rest(read_subject(folder), "lateral")
    write(folder, {**SUBJECT, "xray": {**usual, "images": {"rest/lateral": own}}})
    assert "1830" in str(next(one.seen for one in inspect(folder) if one.image == "rest/lateral"))


def test_what_is_given_for_all_images_may_be_taken_to_be_one_s_alone(folder):
    without(folder / "rest" / "lateral.dcm", "ImagerPixelSpacing")
    write(folder, {**SUBJECT, "xray": {"imager_pixel_mm": 0.9}})
    with pytest.raises(
        RadiographError, match=r"wanted 0\.9 mm .* or give what holds for single pictures in xray\.images"
    ):
        read_rest(read_subject(folder), "frontal")
    write(folder, {**SUBJECT, "xray": {"images": {"rest/lateral": {"imager_pixel_mm": 0.9}}}})
    subject = read_subject(folder)
    np.testing.assert_allclose(read_rest(subject, "lateral").view.pixel_spacing, 0.9)
    read_rest(subject, "frontal")


def test_a_further_view_has_its_geometry_by_its_first_radiograph(folder):
    view = {"id": "side", "kind": "lateral", "files": "pushes/side.dcm", "frames": [2]}
    write_radiographs(folder / "pushes" / "side.dcm", np.zeros((800, 800), np.uint16), lateral_view(shape=(800, 800)))
    without(folder / "pushes" / "side.dcm", "DistanceSourceToDetector", "DistanceSourceToPatient")
    (push,) = SUBJECT["pushes"]
    own = {"source_detector_mm": 1830.0, "source_patient_mm": 1600.0}
    record = {**SUBJECT, "pushes": [{**push, "views": [view]}], "xray": {"images": {"push/right-8/2/side": own}}}
    images = {**ANNOTATION["images"], "push/right-8/2/side": ANNOTATION["images"]["rest/lateral"]}
    write(folder, record, {**ANNOTATION, "images": images})
    subject = read_subject(folder)
    (side,) = read_view(subject, subject.pushes[0], subject.pushes[0].views[0])
    assert (side.view.source_to_detector, side.view.source_to_patient) == (1830.0, 1600.0)
    assert not any(one.missing for one in inspect(folder) if one.image.endswith("view side"))
    write(folder, {**record, "xray": {"images": {"push/right-8/0/side": own}}})
    with pytest.raises(SubjectError, match=r"xray\.images\.'push/right-8/0/side': unknown image; wanted one of"):
        read_subject(folder)


def test_of_a_further_view_the_radiograph_of_the_least_force_has_to_be_marked(folder):
    (push,) = SUBJECT["pushes"]
    view = {"id": "side", "kind": "lateral", "files": "pushes/side.dcm", "frames": [2, 1]}
    pixels, seen = np.zeros((2, 800, 800), np.uint16), lateral_view(shape=(800, 800))
    write_radiographs(folder / "pushes/side.dcm", pixels, seen, frame_time_ms=250.0)
    record = {**SUBJECT, "pushes": [{**push, "views": [view]}]}
    for frame in (1, 2):
        images = {**ANNOTATION["images"], f"push/right-8/{frame}/side": ANNOTATION["images"]["rest/lateral"]}
        write(folder, record, {**ANNOTATION, "images": images})
        (side,) = [one for one in inspect(folder) if one.image.endswith("view side")]
        if frame == 1:  # the other one is followed from it
            assert read_subject(folder) and side.status == "ok"
        else:
            words = "images.push/right-8/1/side: missing"
            with pytest.raises(SubjectError, match=words):
                read_subject(folder)
            assert side.missing == ("no corners of push/right-8/1/side in annotation.json",)


@pytest.mark.parametrize(("most", "odd"), [(6.1, True), (14.9, True), (15, False), (150, False), (151, True)])
def test_forces_that_may_be_in_another_unit_are_told(folder, most, odd):
    (push,) = SUBJECT["pushes"]
    count = len(push["forces_n"])
    write(folder, {**SUBJECT, "pushes": [{**push, "forces_n": [0, *[most] * (count - 1)]}]})
    (one,) = [one for one in inspect(folder) if one.image == "push/right-8"]
    told = [line for line in one.warnings if "look whether they are in N" in line]
    assert len(told) == odd and not one.reason
    # What is not known yet is not judged.
    write(folder, {**SUBJECT, "pushes": [{**push, "forces_n": [0, *[None] * (count - 1)]}]})
    assert not any("look whether" in line for one in inspect(folder) for line in one.warnings)


def test_a_picture_in_which_no_spine_has_room_is_told(folder):
    """Its pitch is in cm, say."""
    path = folder / "pushes/right-8.dcm"
    without(path, ImagerPixelSpacing=[0.04, 0.04])
    (one,) = [one for one in inspect(folder) if one.image == "push/right-8"]
    assert (
        "is 32 mm wide and 32 mm high, where no spine has room: look whether its pixel pitch is in mm" in one.warnings
    )
    (rest,) = [one for one in inspect(folder) if one.image == "rest/frontal"]
    assert not any("no spine has room" in line for line in rest.warnings)
    # In an export, too.
    told = {one.image: one.warnings for one in inspect(folder / "pushes")}
    assert any("no spine has room" in line for lines in told.values() for line in lines), told


@pytest.mark.parametrize(
    ("tags", "slot"),
    [
        ({"Manufacturer": "EOS imaging"}, True),
        ({"Manufacturer": "?", "ManufacturerModelName": "EOSedge"}, True),
        ({"Manufacturer": "Canon", "ManufacturerModelName": "EOS 5D"}, False),
        ({"Manufacturer": "Siemens", "ManufacturerModelName": "Eosin"}, False),
    ],
)
def test_a_slot_scanner_is_told(folder, tags, slot):
    path = folder / "pushes/right-8.dcm"
    without(path, **tags)
    words = "comes from a slot scanner (EOS or the like), whose pictures grow across the body only"
    (one,) = [one for one in inspect(folder) if one.image == "push/right-8"]
    assert any(line.startswith(words) for line in one.warnings) == slot
    subject = read_subject(folder)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read_push(subject, subject.pushes[0])
    assert any(f"right-8.dcm {words}" in str(one.message) for one in caught) == slot


def test_a_push_without_any_force_is_told(folder):
    (push,) = SUBJECT["pushes"]
    none = {"forces_n": [0] * len(push["forces_n"]), "roles": ["unused"] * len(push["forces_n"])}
    write(folder, {**SUBJECT, "pushes": [{**push, **none}]})
    (one,) = [one for one in inspect(folder) if one.image == "push/right-8"]
    assert any(line.startswith("all forces are 0 N: look whether the gauge was on") for line in one.warnings)


def test_records_without_a_scale_are_written_without(folder):
    record = SubjectRecord.model_validate_json(json.dumps(SUBJECT))
    assert "scale" not in record.model_dump(exclude_none=True)["xray"]


# Inspection


def test_a_whole_subject_is_seen(folder):
    found = {one.image: one for one in inspect(folder)}
    assert list(found) == ["rest/frontal", "rest/lateral", "push/right-8"]
    assert {one.status for one in found.values()} == {"ok"}
    push = found["push/right-8"].seen
    assert (push["frames"], push["rows"], push["bits"], push["modality"]) == (4, 800, 16, "RF")
    assert push["times_s"] == [0.0, 0.25, 0.5, 0.75]
    assert push["pixel_mm_at_patient"] == pytest.approx([0.417 * 1340 / 1500] * 2, abs=1e-6)
    assert found["rest/lateral"].seen["view"] == "lateral"


def test_what_a_fit_lacks_is_listed(folder):
    (folder / "annotation.json").unlink()
    (folder / "rest/lateral.dcm").unlink()
    without(folder / "rest/frontal.dcm", "ImagerPixelSpacing", "PatientOrientation")
    rest, push = inspect(folder)
    assert rest.status == push.status == "incomplete"
    assert [line.split(";")[0] for line in rest.missing] == [
        "no ImagerPixelSpacing", "no PatientOrientation", "no corners of rest/frontal in annotation.json",
    ]  # fmt: skip
    assert rest.seen["pixel_mm_at_detector"] is None and rest.seen["source_detector_mm"] == 1500.0


def test_a_distance_that_the_file_has_is_shown_where_the_other_is_missing(tmp_path):
    write_radiographs(
        tmp_path / "a.dcm", np.arange(400, dtype=np.uint16).reshape(1, 20, 20), frontal_view(shape=(20, 20))
    )
    without(tmp_path / "a.dcm", "DistanceSourceToPatient", DistanceSourceToDetector="1500")
    (one,) = inspect(tmp_path)
    assert (one.seen["source_detector_mm"], one.seen["source_patient_mm"]) == (1500.0, None)
    assert one.seen["sources"]["source to detector"] == "DICOM DistanceSourceToDetector"
    assert one.missing[0].startswith("no DistanceSourceToPatient;")
    without(tmp_path / "a.dcm", DistanceSourceToDetector="0", DistanceSourceToPatient="1340")
    (one,) = inspect(tmp_path)
    assert (one.seen["source_detector_mm"], one.seen["source_patient_mm"]) == (None, 1340.0)
    assert "source to detector" not in one.seen["sources"]


def test_images_of_an_annotation_that_the_subject_has_not_are_refused(folder):
    annotation = json.loads((folder / "annotation.json").read_text())
    for name in ("push/other", "push/right-8/99"):
        images = {**annotation["images"], name: annotation["images"]["rest/frontal"]}
        write(folder, annotation={**annotation, "images": images})
        (one,) = [one for one in inspect(folder) if one.image == "annotation.json"]
        assert one.status == "refused" and f"annotation.json: images.{name}: " in one.reason


def test_marks_that_a_step_would_refuse_are_refused(folder):
    annotation = json.loads((folder / "annotation.json").read_text())

    def reason_of(image, change, source=None):
        changed = copy.deepcopy(annotation)
        images = changed["images"]
        images[image] = copy.deepcopy(images[source or image])
        if source:
            images[image].pop("supports", None)
        change(images[image]["vertebrae"])
        write(folder, annotation=changed)
        return {one.image: one.reason for one in inspect(folder) if one.reason}

    def mirrored(vertebrae):
        for name, (a, b, c, d) in vertebrae.items():
            vertebrae[name] = [b, a, d, c]

    def outside(vertebrae):
        vertebrae.update({name: np.add(quad, [5000.0, 0.0]).tolist() for name, quad in vertebrae.items()})

    (found,) = reason_of("rest/frontal", mirrored).items()
    assert found[0] == "rest/frontal" and "images.rest/frontal." in found[1] and "corners are mirrored" in found[1]
    for image, source, shown in (
        ("rest/lateral", None, "rest/lateral"),
        ("push/right-8/2", "push/right-8", "push/right-8"),
    ):
        (found,) = reason_of(image, outside, source).items()
        assert found[0] == shown and f"images.{image}." in found[1]
        assert "wanted it in the image of 800 columns" in found[1]


def test_a_picture_that_looks_like_the_other_view_is_told(tmp_path):
    for stated, view, other in (("lateral", lateral_view, "frontal"), ("frontal", frontal_view, "lateral")):
        for shown, warned in ((other, 1), (stated, 0)):
            path = tmp_path / f"{stated}-{shown}.dcm"
            pixels = trunk(shown).astype(np.uint16)
            write_radiographs(path, pixels, view(shape=pixels.shape[1:]))
            (one,) = inspect(path)
            assert sum(line.startswith("stated as") for line in one.warnings) == warned and one.status == "ok"
            if warned:
                assert one.warnings[0].startswith(f"stated as {stated}, but it looks like a {other} view: ")


def test_what_does_not_fit_the_subject_is_refused(folder):
    (folder / "rest/lateral.dcm").write_bytes((folder / "rest/frontal.dcm").read_bytes())
    write_radiographs(folder / "pushes/right-8.dcm", np.zeros((2, 800, 800), np.uint16), frontal_view(shape=(800, 800)))
    (folder / "rest/frontal.dcm").unlink()
    reasons = {one.image: one.reason for one in inspect(folder)}
    assert reasons == {
        "rest/frontal": "frontal.dcm: no such file",
        "rest/lateral": "lateral.dcm: found a frontal radiograph, wanted a lateral one",
        "push/right-8": "right-8.dcm: found 2 frames, wanted 4, one for each of forces_n in subject.json",
    }


def test_a_folder_is_a_sequence_or_single_files(tmp_path):
    view = frontal_view(shape=(20, 20))
    for i, name in enumerate("ab"):
        pixels = np.full((1, 20, 20), i, np.uint16)
        write_radiographs(tmp_path / f"{name}.dcm", pixels, view, instance_number=2 - i, description=name,
                          acquisition_time=f"12000{i}")  # fmt: skip
    (series,) = inspect(tmp_path)
    assert (series.image, series.seen["frames"], series.seen["files"]) == (tmp_path.name, 2, 2)
    assert series.seen["times_s"] == [0.0, 1.0]
    assert series.warnings[0] == f"{tmp_path.name}: acquisition times and instance numbers disagree; ordered by time"
    without(tmp_path / "b.dcm", AcquisitionTime="120000", InstanceNumber=2)
    a, b = inspect(tmp_path)
    assert (a.image, b.image, a.status) == ("a.dcm", "b.dcm", "ok")
    assert a.warnings[0].startswith("not one sequence: ") and "the same acquisition time" in a.warnings[0]
    (tmp_path / "b.dcm").write_bytes(b"no")
    assert [one.status for one in inspect(tmp_path)] == ["ok", "refused"]


def picture(path, number=0, shape=(20, 20), **values):
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.full((1, *shape), number, np.uint16)
    write_radiographs(path, pixels, frontal_view(shape=shape), instance_number=number, description=str(path),
                      acquisition_time=f"12000{number}")  # fmt: skip
    if values:
        without(path, **values)


def test_folders_in_folders_are_found_in_the_order_of_their_paths(tmp_path):
    top = tmp_path / "disc"
    for name, number in (("s2/a.dcm", 0), ("s2/b.dcm", 1), ("s10/deep/er/c.dcm", 0), ("z.dcm", 0)):
        picture(top / name, number)
    picture(top / "ct" / "1.dcm", Modality="CT")
    picture(top / "ct" / "2.dcm", Modality="CT")
    (top / ".hidden").mkdir()
    (top / "empty").mkdir()
    (top / ".hidden" / "x.dcm").write_bytes(b"no")
    found = inspect(top)
    assert [(one.image, one.status) for one in found] == [
        ("z.dcm", "ok"), ("ct", "refused"), ("s10/deep/er/c.dcm", "ok"), ("s2", "ok"),
    ]  # fmt: skip
    assert found[-1].seen["files"] == 2
    assert found[1].reason.startswith("ct: Modality: found CT in 2 files, wanted projection radiographs")
    assert inspect(top) == found


def test_a_file_of_a_nested_folder_is_named_with_its_path(tmp_path):
    picture(tmp_path / "disc" / "a" / "1.dcm")
    (tmp_path / "disc" / "a" / "2.dcm").write_bytes(b"no")
    assert [one.image for one in inspect(tmp_path / "disc")] == ["a/1.dcm", "a/2.dcm"]


@pytest.mark.skipif(os.name == "nt", reason="pipes and links of Unix")
def test_links_and_pipes_in_a_folder_are_named_and_not_followed(tmp_path):
    top, outside = tmp_path / "disc", tmp_path / "outside"
    picture(top / "a" / "1.dcm")
    picture(outside / "secret.dcm")
    (top / "a" / "2.dcm").symlink_to(outside / "secret.dcm")
    (top / "a" / "3.dcm").symlink_to(top / "a" / "3.dcm")
    os.mkfifo(top / "a" / "4.dcm")
    (top / "b").symlink_to(outside)
    (top / "c").mkdir()
    (top / "c" / "up").symlink_to(top)
    (top / "c" / "loop").symlink_to(top / "c" / "loop")
    assert {one.image: one.reason for one in inspect(top)} == {
        "a/1.dcm": "",
        "a/2.dcm": "2.dcm: leads out of the folder disc; copy the file into it",
        "a/3.dcm": "3.dcm: a link that leads to itself; copy the file itself here",
        "a/4.dcm": "4.dcm: found a named pipe, wanted a file",
        "b": "b: found a link to a folder, which is not followed; name that folder itself",
        "c/loop": "loop: a link that leads to itself; copy the file itself here",
        "c/up": "up: found a link to a folder, which is not followed; name that folder itself",
    }
    # Named itself, a link to a folder is that folder.
    assert [one.image for one in inspect(top / "b")] == ["secret.dcm"]


def test_the_folder_one_is_in_has_its_name(tmp_path, monkeypatch):
    top = tmp_path / "disc"
    picture(top / "a.dcm", 0)
    picture(top / "b.dcm", 1)
    (top / "inner").mkdir()
    for place, path in ((top, "."), (top / "inner", "..")):
        monkeypatch.chdir(place)
        assert [one.image for one in inspect(Path(path))] == ["disc"]


def test_too_many_or_too_deep_folders_are_refused_in_one_line(tmp_path):
    deep = tmp_path / "disc"
    picture(deep / "/".join("12345678") / "a.dcm")
    assert [one.image for one in inspect(deep)] == ["1/2/3/4/5/6/7/8/a.dcm"]
    (deep / "/".join("123456789")).mkdir()
    with pytest.raises(RadiographError, match=r"^disc: found folders more than 8 deep in it, wanted fewer; name one"):
        inspect(deep)
    for i in range(256):
        (tmp_path / "many" / str(i)).mkdir(parents=True)
    with pytest.raises(RadiographError, match=r"^many: found more than 256 folders in it, wanted fewer; name one"):
        inspect(tmp_path / "many")


def test_a_folder_without_files_at_all_says_so(tmp_path):
    (tmp_path / "disc" / "a").mkdir(parents=True)
    with pytest.raises(RadiographError, match=r"^disc: found no radiographs in this folder or those in it"):
        inspect(tmp_path / "disc")


def test_subjects_in_a_folder_are_inspected_as_subjects(folder):
    names = ["03/rest/frontal", "03/rest/lateral", "03/push/right-8"]
    assert [one.image for one in inspect(folder.parent)] == names
    write(folder, {**SUBJECT, "extra": 1})
    (one,) = inspect(folder.parent)
    assert one.image == "03" and "extra" in one.reason


@pytest.mark.skipif(os.name == "nt", reason="links of Unix")
def test_a_lateral_link_to_nothing_is_not_taken_for_none(folder):
    (folder / "rest/lateral.dcm").unlink()
    (folder / "rest/lateral.dcm").symlink_to(folder / "gone.dcm")
    reasons = {one.image: one.reason for one in inspect(folder)}
    assert reasons["rest/lateral"].startswith("lateral.dcm: a link to a file that is not there")
    with pytest.raises(SubjectError, match=r"lateral\.dcm: a link to a file that is not there"):
        read_subject(folder)


def test_a_lateral_radiograph_that_is_marked_and_not_there_is_told(folder):
    (folder / "rest/lateral.dcm").unlink()
    reasons = {one.image: one.reason for one in inspect(folder)}
    assert reasons["rest/lateral"].startswith("lateral.dcm: no such file")
    with pytest.raises(SubjectError, match=r"lateral\.dcm: no such file"):
        read_subject(folder)
    rest = {name: image for name, image in ANNOTATION["images"].items() if name != "rest/lateral"}
    write(folder, None, {**ANNOTATION, "images": rest})
    assert "rest/lateral" not in {one.image for one in inspect(folder)}


# The command


@pytest.fixture
def run(monkeypatch, capsys):
    def call(*arguments):
        monkeypatch.setattr("sys.argv", ["spinestiff", "inspect", *map(str, arguments)])
        try:
            cli.main()
            status = 0
        except SystemExit as end:
            status = end.code or 0
        out, err = capsys.readouterr()
        return status, out, err

    return call


def test_the_command_tells_what_it_sees(run, folder):
    status, out, err = run(folder)
    assert (status, err) == (0, "")
    assert out.count(": ok\n") == 3
    assert "  pixel pitch  0.417 x 0.417 mm at the detector, 0.3725 x 0.3725 mm at the patient (DICOM Imager" in out
    assert "  orientation  lateral, columns grow to A, rows to F (DICOM PatientOrientation A\\F), beam to L" in out
    assert "  times        4 frames in 0.75 s" in out
    status, out, _ = run(folder, "--json")
    records = json.loads(out)
    assert status == 0 and [one["status"] for one in records] == ["ok"] * 3
    assert records[2]["seen"]["sources"]["pixel spacing"] == "DICOM ImagerPixelSpacing, at the detector"


@pytest.mark.parametrize("option", [(), ("--json",)])
def test_the_command_refuses_with_one_line_and_status_2(run, folder, option):
    path = folder / "rest/frontal.dcm"
    without(path, Modality="CT")
    status, out, err = run(path, *option)
    assert status == 2
    assert err.startswith("spinestiff: frontal.dcm: Modality: found CT, wanted a projection radiograph (CR, DX, RF")
    assert err.count("\n") == 1
    assert out == "" if not option else json.loads(out)[0]["status"] == "refused"
    status, out, _ = run(folder, *option)
    assert status == 2
    assert out.count("refused") >= 1 and out.count("right-8") >= 1
    assert run(folder / "nothing", *option)[0] == 2


@pytest.mark.parametrize("annotated", [True, False])
def test_radiographs_of_another_patient_or_visit_are_told(run, folder, annotated):
    if not annotated:
        (folder / "annotation.json").unlink()
    for name, person, day in (("rest/frontal", "A", "20240102"), ("rest/lateral", "B", "20240102"),
                              ("pushes/right-8", "A", "20250102")):  # fmt: skip
        path = folder / f"{name}.dcm"
        without(path, PatientIdentityRemoved="", PatientID=person, AcquisitionDate=day, AcquisitionTime="101500")
    status, out, _ = run(folder)
    assert status == 0 and "subject.json: ok" in out
    assert "  warning      rest/frontal and rest/lateral name different patients; look for a radiograph in the" in out
    assert "  warning      rest/frontal and push/right-8 were taken more than 30 days apart; look for" in out
    without(folder / "rest/lateral.dcm", PatientID="A")
    without(folder / "pushes/right-8.dcm", AcquisitionDate="20240103")
    assert "warning" not in run(folder)[1]


def test_nothing_of_the_patient_is_told(run, folder):
    hidden = {"PatientName": CANARY, "PatientID": CANARY, "StudyDescription": CANARY, "InstitutionName": CANARY,
              "PatientBirthDate": "19870605", "StudyDate": "20240102", "AcquisitionDate": "20240103",
              "AcquisitionTime": "131415", "AccessionNumber": CANARY, "ProtocolName": CANARY}  # fmt: skip
    path = folder / "rest/frontal.dcm"
    without(path, **hidden)
    uid = str(pydicom.dcmread(path).SOPInstanceUID)
    for broken in ({}, {"ViewPosition": CANARY}, {"PatientOrientation": [CANARY, "F"]},
                   {"PixelSpacingCalibrationType": CANARY}, {"Modality": CANARY}):  # fmt: skip
        without(path, **broken)
        for option in ((), ("--json",)):
            _, out, err = run(path, *option)
            told = out + err
            assert told
            for secret in (CANARY, CANARY[:6], "19870605", "20240102", "20240103", "131415", uid):
                assert secret not in told
