"""``spinestiff deidentify``: nothing that was put into files, their names or their folders' names comes out again."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pydicom
import pytest
from pydicom.datadict import DicomDictionary
from pydicom.dataset import Dataset
from pydicom.tag import Tag

from canaries import CANARY, NUMBER, UID, infest, traces
from spinestiff.imaging.projection import frontal_view
from spinestiff.imaging.radiograph import Geometry, read_radiographs, write_radiographs

VIEW = frontal_view(sid=1500.0, source_to_patient=1340.0, shape=(40, 36), pixel=(0.3, 0.4))


@pytest.fixture
def patient(tmp_path):
    """Makes a folder of three infested frames and a sidecar, everything named after the patient."""

    def make(most: int) -> SimpleNamespace:
        folder = tmp_path / "in" / f"{CANARY}_Jane" / f"push {NUMBER}"
        folder.mkdir(parents=True)
        rng = np.random.default_rng(5)
        count = 0
        for i in range(3):
            path = folder / f"{CANARY}_{i}.dcm"
            pixels = rng.integers(0, 60000, VIEW.shape, dtype=np.uint16)
            write_radiographs(path, pixels, VIEW, instance_number=i + 1)
            count += infest(path, rng, 2 if i else most, in_kept=True)
        (folder / f"{CANARY}.txt").write_text(f"{CANARY} was here")
        return SimpleNamespace(folder=tmp_path / "in", count=count, out=tmp_path / "out")

    return make


def sheets_of(out: Path) -> Path:
    return out.with_name(f"{out.name}-look-for-burned-in-text")


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_no_canary_comes_out(spinestiff, patient):
    patient = patient(most=10_000)  # every attribute that DICOM knows
    assert patient.count > 2000
    ran = spinestiff("deidentify", patient.folder, patient.out)
    assert ran.status == 0, ran.out
    assert "3 of 4 files written to out; patients: 1" in ran.out
    assert "left out: no DICOM file (its header is missing): number 1" in ran.out
    assert not traces(patient.out, sheets_of(patient.out), ran.out, ran.err)
    # The canaries were there, in what was read.
    assert len(traces(patient.folder)) >= 8


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("keyword", ["SOPClassUID", "Modality", "Rows", "BitsStored", "PhotometricInterpretation",
                                     "NumberOfFrames", "SOPInstanceUID", "PixelData", "TransferSyntaxUID"])  # fmt: skip
def test_refusals_name_nobody(spinestiff, patient, keyword):
    patient = patient(most=1)
    broken = sorted(patient.folder.rglob("*.dcm"))[1]
    content = bytearray(broken.read_bytes())
    dataset = pydicom.dcmread(broken)
    if keyword == "TransferSyntaxUID":
        dataset.file_meta.TransferSyntaxUID = f"{UID}.1"
    elif keyword in ("SOPInstanceUID", "PixelData"):
        delattr(dataset, keyword)
    else:
        # In the raw bytes, where no library objects: tag, VR, length, value.
        tag = Tag(keyword)
        head = tag.group.to_bytes(2, "little") + tag.element.to_bytes(2, "little")
        if keyword == "NumberOfFrames":
            dataset.NumberOfFrames = 1
            dataset.save_as(broken)
            content = bytearray(broken.read_bytes())
        at = content.index(head + DicomDictionary[tag][0][:2].encode())
        length = int.from_bytes(content[at + 6 : at + 8], "little")
        content[at + 4 : at + 8 + length] = b"LO" + (14).to_bytes(2, "little") + f"{CANARY}{CANARY}{CANARY}XX".encode()
        broken.write_bytes(content)
    if keyword in ("SOPInstanceUID", "PixelData", "TransferSyntaxUID"):
        dataset.save_as(broken, enforce_file_format=keyword == "PixelData")
    ran = spinestiff("deidentify", patient.folder, patient.out)
    assert ran.status == 2
    assert "2 of 4 files written" in ran.out
    assert "number 3 in the order of names" in ran.out
    assert not traces(patient.out, ran.out, ran.err)


@pytest.fixture
def series(tmp_path):
    """Three frames of a push in single files, around midnight, in a folder with a name."""
    folder = tmp_path / "Jane Doe"
    folder.mkdir()
    rng = np.random.default_rng(2)
    moments = (("20210101", "235959.500"), ("20210101", "235959.900"), ("20210102", "000000.300"))
    for i, (date, time) in enumerate(moments):
        pixels = rng.integers(0, 60000, VIEW.shape, dtype=np.uint16)
        write_radiographs(folder / f"{i}.dcm", pixels, VIEW, instance_number=i + 1, patient_id="4711")
        dataset = pydicom.dcmread(folder / f"{i}.dcm")
        dataset.AcquisitionDate, dataset.AcquisitionTime, dataset.StudyDate = date, time, "20210101"
        dataset.save_as(folder / f"{i}.dcm")
    return folder


def datasets(out: Path) -> list[Dataset]:
    return [pydicom.dcmread(path) for path in sorted(out.rglob("*.dcm"))]


def test_a_series_reads_as_before(spinestiff, series, tmp_path):
    ran = spinestiff("deidentify", series, tmp_path / "out")
    assert ran.status == 0
    assert "burned-in text: 3 say there is none" in ran.out
    old = read_radiographs(series, geometry=Geometry())
    (folder,) = {path.parent for path in (tmp_path / "out").rglob("*.dcm")}
    new = read_radiographs(folder)
    for before, after in zip(old, new, strict=True):
        np.testing.assert_array_equal(after.pixels, before.pixels)
        assert repr(after.view) == repr(before.view)
        assert after.time_s == pytest.approx(before.time_s, abs=1e-5)
        assert after.provenance == before.provenance
    assert [picture.time_s for picture in new] == pytest.approx([0.0, 0.4, 0.8], abs=1e-5)
    found = datasets(tmp_path / "out")
    assert {dataset.StudyInstanceUID for dataset in found} != {pydicom.dcmread(series / "0.dcm").StudyInstanceUID}
    assert len({dataset.StudyInstanceUID for dataset in found}) == 1
    assert len({dataset.SOPInstanceUID for dataset in found}) == 3
    for dataset in found:
        assert dataset.preamble == bytes(128)
        assert dataset.PatientIdentityRemoved == "YES"
        assert [code.CodeValue for code in dataset.DeidentificationMethodCodeSequence] == ["113100", "113107"]
        assert all(dataset[f"{level}InstanceUID"].value.is_valid for level in ("SOP", "Series", "Study"))
        assert all(1 <= 2021 - int(dataset[f"{part}Date"].value[:4]) <= 11 for part in ("Study", "Acquisition"))


def test_a_key_gives_the_same_pseudonyms_again(spinestiff, series, tmp_path):
    assert "key: a new one" in spinestiff("deidentify", series, tmp_path / "a", "--key", tmp_path / "key").out
    assert (tmp_path / "key").stat().st_mode & 0o077 == 0
    again = spinestiff("deidentify", series / "1.dcm", tmp_path / "b", "--key", tmp_path / "key")
    assert again.status == 0
    assert "key:" not in again.out
    other = spinestiff("deidentify", series / "1.dcm", tmp_path / "c")
    assert other.status == 0
    first, second, third = (datasets(tmp_path / name) for name in "abc")
    assert second[0] == first[1]
    for keyword in ("PatientID", "SOPInstanceUID", "StudyInstanceUID", "AcquisitionDate"):
        assert third[0][keyword].value != first[1][keyword].value
    secret = (tmp_path / "key").read_text().strip()
    assert not any(secret.encode() in path.read_bytes() for path in (tmp_path / "a").rglob("*.dcm"))


def test_burned_in_text_needs_a_look(spinestiff, series, tmp_path):
    dataset = pydicom.dcmread(series / "2.dcm")
    dataset.BurnedInAnnotation = "YES"
    dataset.save_as(series / "2.dcm")
    ran = spinestiff("deidentify", series, tmp_path / "a")
    assert ran.status == 2
    assert "refused: says that text is burned into its pixels" in ran.out
    assert len(datasets(tmp_path / "a")) == 2
    ran = spinestiff("deidentify", series, tmp_path / "b", "--burned-in-ok")
    assert ran.status == 0
    assert datasets(tmp_path / "b")[2].BurnedInAnnotation == "YES"
    assert "1 say there is;" in ran.out
    assert len(list(sheets_of(tmp_path / "b").glob("*.png"))) == 1


def test_numbers_follow_the_order_of_names(spinestiff, series, tmp_path):
    """As ``LC_ALL=C sort`` has it: a space before a slash; hidden files and links have no number."""
    (series / "b").mkdir()
    (series / "b c").mkdir()
    (series / ".hidden").mkdir()
    (series / "0.dcm").rename(series / "b" / "x.dcm")
    (series / "1.dcm").rename(series / "b c" / "x.dcm")
    (series / ".hidden" / "x.dcm").write_bytes((series / "2.dcm").read_bytes())
    (series / "a.dcm").symlink_to(series / "2.dcm")
    uids = [pydicom.dcmread(series / name).InstanceNumber for name in ("2.dcm", "b c/x.dcm", "b/x.dcm")]
    ran = spinestiff("deidentify", series, tmp_path / "out")
    assert ran.status == 0
    found = sorted((tmp_path / "out").rglob("*.dcm"))
    assert [path.parts[-2:] for path in found] == [
        (f"folder-00{i}", f"image-0000{i}.dcm") for i in (1, 2, 3)
    ]  # fmt: skip
    assert [pydicom.dcmread(path).InstanceNumber for path in found] == uids


def test_a_folder_without_radiographs_is_no_success(spinestiff, tmp_path):
    place = tmp_path / "photos"
    place.mkdir()
    for name in ("a.txt", "b.txt"):
        (place / name).write_text("no radiograph")
    ran = spinestiff("deidentify", place, tmp_path / "out")
    assert (ran.status, ran.out) == (2, "")
    assert "IN: 2 files, none of them DICOM; name the folder of the radiographs" in ran.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("place", ["IN", "OUT"])
def test_a_place_that_cannot_be_looked_at_is_not_named(spinestiff, series, tmp_path, place):
    name = f"{CANARY}_" + "x" * 300
    source, out = (tmp_path / name, tmp_path / "out") if place == "IN" else (series, tmp_path / name)
    ran = spinestiff("deidentify", source, out)
    assert ran.status == 2 and ran.err.count("\n") == 1
    assert "IN or OUT, or something in them, can't be read" in ran.err
    assert not traces(ran.out, ran.err)


def test_nothing_is_overwritten(spinestiff, series, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    (tmp_path / "short").write_text("secret")
    (sheets_of(tmp_path / "other")).mkdir()
    (sheets_of(tmp_path / "other") / "mine.png").touch()
    for arguments, why in (
        ((series, out), "OUT is there already and not empty"),
        ((series, out / "mine.txt"), "OUT is there already"),
        ((series, "."), "OUT is no name of a folder"),
        ((series, tmp_path / "other"), "OUT-look-for-burned-in-text is there already"),
        ((series, series / "new"), "OUT lies in IN"),
        ((tmp_path / "none", tmp_path / "new"), "no such file"),
        ((series, tmp_path / "new", "--key", tmp_path / "new" / "key"), "the key lies in OUT"),
        ((series, tmp_path / "new", "--key", tmp_path / "short"), "a key of 6 bytes"),
    ):
        ran = spinestiff("deidentify", *arguments)
        assert ran.status == 2
        assert why in ran.err
    assert [path.name for path in out.iterdir()] == ["mine.txt"]
    assert not (tmp_path / "new").exists()
    (out / "mine.txt").unlink()
    assert spinestiff("deidentify", series, out).status == 0
