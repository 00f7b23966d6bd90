"""One picture in two files: what counts as the same, and what does not."""

from __future__ import annotations

import pydicom
import pytest

from hospital import export
from spinestiff.imaging.deidentification.deidentify import deidentify
from spinestiff.imaging.deidentification.pseudonyms import random_key
from spinestiff.subject.intake import adding, making, pictures
from spinestiff.subject.intake.collecting import collect
from spinestiff.subject.intake.sorting import sort_files


def freed(path, target):
    """A copy without its patient."""
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(deidentify(path.read_bytes(), random_key(), burned_in_ok=True).content)
    return target


def renamed(path, target, spoil=False):
    """A copy of another patient and another instance; spoilt, one pixel of it is another."""
    dataset = pydicom.dcmread(path)
    dataset.PatientID, dataset.PatientName, dataset.SOPInstanceUID = "P9", "ROE^RICHARD", "1.2.3.9"
    dataset.file_meta.MediaStorageSOPInstanceUID = "1.2.3.9"
    if spoil:
        pixels = dataset.pixel_array.copy()
        pixels.flat[-1] += 1
        dataset.PixelData = pixels.tobytes()
    target.parent.mkdir(parents=True, exist_ok=True)
    dataset.save_as(target)
    return target


@pytest.mark.parametrize("frames", [1, 3])
def test_a_copy_without_its_patient_is_the_same_image(tmp_path, frames):
    first = export(tmp_path / "in" / "a", frames=frames)
    freed(first, tmp_path / "in" / "b")
    renamed(first, tmp_path / "in" / "c")
    found, refused = collect([tmp_path / "in"])
    assert [one.name for one in found] == ["a"]
    assert [(one.name, one.why) for one in refused] == [(name, "the same image as a") for name in "bc"]


def test_one_pixel_makes_another_image(tmp_path):
    first = export(tmp_path / "in" / "a", frames=2)
    renamed(first, tmp_path / "in" / "b", spoil=True)
    assert [one.name for one in collect([tmp_path / "in"])[0]] == ["a", "b"]


def test_pixels_are_read_only_of_what_may_be_the_same(tmp_path, monkeypatch):
    read = []
    monkeypatch.setattr(pictures, "read_scan", lambda path, given: read.append(path.name) or real(path, given))
    first = export(tmp_path / "in" / "a")
    export(tmp_path / "in" / "b", frames=2)
    (tmp_path / "in" / "c").write_bytes(first.read_bytes())
    collect([tmp_path / "in"])
    assert read == []
    export(tmp_path / "in" / "d")
    collect([tmp_path / "in"])
    assert sorted(read) == ["a", "d"]


real = pictures.read_scan


def test_a_file_that_changed_since_it_was_read_is_like_no_other(tmp_path):
    first = export(tmp_path / "a", frames=2)
    ((one,), _), ((other,), _) = collect([first]), collect([export(tmp_path / "b", frames=2)])
    renamed(first, other.path)
    assert pictures.Album([one]).same(other) is None


def test_a_subject_says_which_of_its_images_a_copy_is(tmp_path):
    first = export(tmp_path / "first" / "I1", time="101500")
    push = export(tmp_path / "first" / "I7", frames=3, time="102200")
    sorting = sort_files(collect([tmp_path / "first"])[0])
    making.make_folder(tmp_path / "girl", making.subject_data("girl", sorting), sorting)
    freed(first, tmp_path / "more" / "F1")
    renamed(push, tmp_path / "other" / "F7")
    for source, held in (("more", {"F1": "rest/frontal.dcm"}), ("other", {"F7": "pushes/push-1.dcm"})):
        addition = adding.sort_addition(adding.read_standing(tmp_path / "girl"), collect([tmp_path / source])[0])
        assert dict(addition.held) == held and addition.sorting.pushes == ()
        for name, other in held.items():
            assert addition.sorting.reasons[name] == f"the same image as {other}, which the subject has"
