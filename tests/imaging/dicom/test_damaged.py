"""Public test files have the outcome they should; damaged files give radiographs or one line, never worse."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pydicom
import pytest
from pydicom.dataset import Dataset
from pydicom.sequence import Sequence

from spinestiff.errors import RadiographError
from spinestiff.imaging.dicom.person_tags import identity_tags
from spinestiff.imaging.dicom.tags import read_tags
from spinestiff.imaging.radiograph import Geometry, read_radiographs

PUBLIC = Path(__file__).resolve().parents[3].parent / "shared" / "data" / "dicom"
GIVEN = Geometry(1000.0, 900.0, 0.2, "frontal")
MR = "Modality: found MR, wanted a projection radiograph"
HEADERLESS = "no DICOM file"
GUARDS = ("reading.one_clear_line", "files.named", "tags.named")
OUTCOMES = {
    "gdcm-CR-MONO1-10-chest.dcm": (440, 440),
    "RG3_J2KR_CR_extremity.dcm": (1760, 1760),
    "highdicom_dx_thorax.dcm": (169, 211),
    "emri_small.dcm": MR,
    "emri_small_RLE.dcm": MR,
    "MR_truncated.dcm": MR,
    "badVR.dcm": "Modality: found RTDOSE, wanted a projection radiograph",
    "no_meta.dcm": HEADERLESS,
    "zipMR.gz": HEADERLESS,
    "README.md": HEADERLESS,
}


@pytest.mark.skipif(not PUBLIC.is_dir(), reason="needs the files of ../shared/data/dicom")
@pytest.mark.parametrize("name", OUTCOMES)
def test_public_files_have_their_outcome(name):
    wanted = OUTCOMES[name]
    given = Geometry(None, 900.0) if name.startswith("highdicom") else GIVEN
    if isinstance(wanted, str):
        with pytest.raises(RadiographError, match=f"^{name}: {wanted}"):
            read_radiographs(PUBLIC / name, geometry=given)
        return
    (radiograph,) = read_radiographs(PUBLIC / name, geometry=given)
    assert radiograph.pixels.shape == wanted
    # All three are MONOCHROME1 or say that larger values are more beam: the collimated or empty rim is dark.
    assert radiograph.provenance["grey values"].endswith("inverted")
    spacing = [1.201199999999, 1.2] if name.startswith("highdicom") else [0.2, 0.2]
    np.testing.assert_array_equal(radiograph.view.pixel_spacing, spacing)


@pytest.mark.skipif(not PUBLIC.is_dir(), reason="needs the files of ../shared/data/dicom")
def test_every_public_file_has_an_outcome():
    assert {path.name for path in PUBLIC.iterdir()} == set(OUTCOMES)


def test_a_share_of_the_campaign_finds_no_fault(campaign_module, tmp_path):
    path = tmp_path / "damaged.dcm"
    sound = campaign_module.seeds()
    sounds = {}
    for one in sound:
        path.write_bytes(one.content)
        sounds[one.name] = campaign_module.quantities(read_radiographs(path))
        assert campaign_module.judged(path, sounds[one.name]).outcome == "same"
    random = np.random.default_rng(11)
    rows = []
    for number in range(240):
        one = sound[number % len(sound)]
        way = campaign_module.WAYS[number // len(sound) % len(campaign_module.WAYS)]
        path.write_bytes(campaign_module.damaged(one, way, random))
        rows.append((one.name, way, campaign_module.judged(path, sounds[one.name]), 0.0))
    found = campaign_module.summary(rows)
    assert found["faults"] == {}, rows
    assert found["refused"] > 120
    assert found["refused by way"]["cut"] == "40 of 40"


@pytest.mark.parametrize(
    ("fault", "change"),
    [
        ("another form", lambda m: m.setattr("spinestiff.imaging.dicom.reading.one_clear_line", _nothing)),
        ("traceback", lambda m: [m.setattr(f"spinestiff.imaging.dicom.{name}", _nothing) for name in GUARDS]),
        ("size disagrees", lambda m: m.setattr("spinestiff.imaging.dicom.decoding.check_native", lambda *_: None)),
    ],
)
def test_the_campaign_would_see_a_fault(campaign_module, tmp_path, monkeypatch, fault, change):
    path = tmp_path / "damaged.dcm"
    one = campaign_module.seeds()[1]
    path.write_bytes(one.content)
    sound = campaign_module.quantities(read_radiographs(path))
    change(monkeypatch)
    random = np.random.default_rng(2)
    outcomes = set()
    for number in range(200):
        path.write_bytes(campaign_module.damaged(one, ("header", "sizes")[number % 2], random))
        outcomes.add(campaign_module.judged(path, sound).outcome)
    assert any(fault in outcome for outcome in outcomes), outcomes


class _nothing:
    """Stands in for the one place where failures become a line."""

    def __init__(self, name: str) -> None:
        pass

    def __enter__(self) -> None:
        pass

    def __exit__(self, *args: object) -> None:
        pass


def test_no_path_of_a_file_is_followed(file, tmp_path):
    secret = tmp_path / "secret.dcm"
    secret.write_bytes(b"\0" * 200)

    def refer(dataset: Dataset) -> None:
        record = Dataset()
        record.ReferencedFileID = ["..", "secret.dcm"]
        dataset.DirectoryRecordSequence = Sequence([record])

    assert len(read_radiographs(file(change=refer))) == 1
    directory = file(change=lambda d: setattr(d.file_meta, "MediaStorageSOPClassUID", "1.2.840.10008.1.3.10"))
    with pytest.raises(RadiographError, match="found a DICOMDIR, wanted a radiograph"):
        read_radiographs(directory)


def test_enhanced_files_keep_their_geometry_in_groups(file):
    def move(dataset: Dataset) -> None:
        inner, group = Dataset(), Dataset()
        inner.ImagerPixelSpacing = dataset.ImagerPixelSpacing
        inner.DistanceSourceToDetector = dataset.DistanceSourceToDetector
        del dataset.ImagerPixelSpacing, dataset.DistanceSourceToDetector
        group.FramePixelDataPropertiesSequence = Sequence([inner])
        dataset.SharedFunctionalGroupsSequence = Sequence([group])

    (radiograph,) = read_radiographs(file(change=move))
    np.testing.assert_array_equal(radiograph.view.pixel_spacing, [0.4, 0.4])

    def differ(dataset: Dataset) -> None:
        move(dataset)
        other, group = Dataset(), Dataset()
        other.ImagerPixelSpacing = ["0.3", "0.3"]
        group.FramePixelDataPropertiesSequence = Sequence([other])
        dataset.PerFrameFunctionalGroupsSequence = Sequence([group])

    with pytest.raises(RadiographError, match="ImagerPixelSpacing: found values that differ from frame to frame"):
        read_radiographs(file(change=differ))


def test_secondary_captures_are_read(file):
    (radiograph,) = read_radiographs(file(Modality="OT", SOPClassUID="1.2.840.10008.5.1.4.1.1.7"))
    assert radiograph.pixels.shape == (40, 36)


# What is in a file is named where it is at fault


def element(keyword: str, vr: str, content: bytes):
    """A change that leaves the bytes of an element as they are, so that they are parsed when it is read."""

    def change(dataset: Dataset) -> None:
        tag = pydicom.tag.Tag(keyword)
        dataset.pop(tag, None)
        dataset._dict[tag] = pydicom.dataelem.RawDataElement(tag, vr, len(content), content, 0, False, True)

    return change


@pytest.mark.parametrize(
    ("keyword", "vr", "content", "message"),
    [
        ("Rows", "US", b"\x01\x02\x03\x04\x05", "Rows: found bytes that can't be read, wanted valid DICOM"),
        ("PixelSpacing", "DS", b"0.4\\x ", "PixelSpacing: found no number, wanted one"),
        ("PatientID", "US", b"\x01\x02\x03", "PatientID: found bytes that can't be read"),
        ("AcquisitionDate", "US", b"\x01\x02\x03", "AcquisitionDate: found bytes that can't be read"),
        ("WindowCenter", "US", b"\x01\x02\x03", "WindowCenter: found bytes that can't be read"),
        ("ViewCodeSequence", "LO", b"SECRET", "ViewCodeSequence: found bytes that can't be read"),
        ("SharedFunctionalGroupsSequence", "LO", b"SECRET", "the frames' functional groups: found bytes"),
        ("ModalityLUTSequence", "LO", b"SECRET", "ModalityLUTSequence: found bytes that can't be read"),
        ("FrameTimeVector", "DS", b"0\\1", "FrameTimeVector: found 2 entries, wanted 3, one a frame"),
    ],
)
def test_a_damaged_element_is_named(tmp_path, file, keyword, vr, content, message):
    path = file(np.zeros((3, 40, 36), np.uint16), DistanceSourceToPatient=None)
    dataset = pydicom.dcmread(path)
    element(keyword, vr, content)(dataset)
    with pytest.raises(RadiographError, match=f"^{message}") as refusal:
        (identity_tags if keyword == "PatientID" else read_tags)(dataset)
    assert "SECRET" not in str(refusal.value)


@pytest.mark.parametrize("keyword", ["WindowCenter", "ModalityLUTSequence", "Laterality"])
def test_a_damaged_item_inside_an_element_is_named(file, keyword):
    dataset, item = pydicom.dcmread(file()), Dataset()
    element("Rows", "??", b"\x01\x02")(item)
    dataset.pop(keyword, None)
    dataset.add_new(keyword, "SQ", Sequence([item]))
    with pytest.raises(RadiographError, match=f"^{keyword}: found bytes that can't be read"):
        read_tags(dataset)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"SamplesPerPixel": 3}, "SamplesPerPixel: found 3, wanted 1, since PhotometricInterpretation is MONOCHROME2"),
        (
            {"PhotometricInterpretation": "RGB", "SamplesPerPixel": 3},
            "PhotometricInterpretation: found RGB, wanted MONOCHROME1 or MONOCHROME2; export the original",
        ),
        ({"PhotometricInterpretation": "SECRET"}, "PhotometricInterpretation: found an unlisted word, wanted MONO"),
        ({"PhotometricInterpretation": None}, "PhotometricInterpretation: found none, wanted MONOCHROME1"),
        ({"Modality": "SECRET"}, "Modality: found an unlisted word, wanted a projection radiograph"),
        ({"Modality": "SR", "PixelData": None}, "Modality: found SR, wanted a projection radiograph"),
        ({"HighBit": 3}, "HighBit: found 3, wanted 15 as BitsStored says"),
    ],
)
def test_what_is_no_grey_radiograph_is_told_by_the_field_that_says_so(file, values, message):
    with pytest.raises(RadiographError, match=rf"^a\.dcm: {message}") as refusal:
        read_radiographs(file(**values))
    assert "SECRET" not in str(refusal.value)


@pytest.mark.parametrize("where", ["header", "elements", "deflated"])
def test_a_file_that_cannot_be_parsed_names_the_part_and_no_error_of_python(file, campaign_module, where):
    path = file()
    content = bytearray(path.read_bytes())
    if where == "header":
        place = content.find(b"UI", 140)
        content[place : place + 2] = b"??"
    elif where == "elements":
        content = content[: content.find(b"\x28\x00\x10\x00") + 9]
    else:
        content = bytearray(campaign_module.seeds()[4].content)
        content[-400:-200] = b"\x55" * 200
    path.write_bytes(content)
    with pytest.raises(RadiographError) as refusal:
        read_radiographs(path)
    line = str(refusal.value)
    assert line.startswith("a.dcm: ") and re.search("found|missing", line)
    assert not re.search(r"Error|Exception|\(error\)|NoneType|object", line)


# What is told before anything is decoded


def test_what_is_no_radiograph_is_said_before_it_is_too_large(file):
    path = file(Modality="CT")
    with path.open("r+b") as stream:
        stream.truncate(600 * 2**20)  # sparse
    with pytest.raises(RadiographError, match=r"^a\.dcm: Modality: found CT, wanted a projection radiograph"):
        read_radiographs(path)
    path = file(name="c.dcm")
    with path.open("r+b") as stream:
        stream.truncate(600 * 2**20)
    with pytest.raises(RadiographError, match=r"^c\.dcm: found 600 MB behind the pixels, wanted none"):
        read_radiographs(path)

    def deflate(dataset):
        dataset.file_meta.TransferSyntaxUID = pydicom.uid.DeflatedExplicitVRLittleEndian

    path = file(name="b.dcm", change=deflate)
    with path.open("r+b") as stream:
        stream.truncate(600 * 2**20)
    with pytest.raises(RadiographError, match=r"^b\.dcm: found 600 MB, wanted at most 512 MB"):
        read_radiographs(path)


@pytest.mark.parametrize("size", ["few", "many", "large"])
def test_a_folder_of_ct_is_said_to_be_ct_of_whatever_size(file, tmp_path, size):
    content = file(Modality="CT").read_bytes()
    for i in range(130 if size == "many" else 3):
        with (tmp_path / f"{i:03d}.dcm").open("wb") as stream:
            stream.write(content)
            if size == "large":
                stream.truncate(200 * 2**20)
    (tmp_path / "a.dcm").unlink()
    count = 130 if size == "many" else 3
    message = rf"^{tmp_path.name}: Modality: found CT in {count} files, wanted projection radiographs \(CR"
    with pytest.raises(RadiographError, match=message):
        read_radiographs(tmp_path)
    file(name="003.dcm")  # a radiograph among them: it is not all CT
    with pytest.raises(RadiographError) as refusal:
        read_radiographs(tmp_path)
    assert "Modality: found CT in" not in str(refusal.value)


@pytest.mark.skipif(os.name == "nt", reason="pipes, devices and links of Unix")
@pytest.mark.parametrize("kind", ["pipe", "link to itself", "link out", "link to nothing"])
@pytest.mark.parametrize("alone", [True, False])
def test_what_is_no_regular_file_is_told_before_anything_is_opened(file, tmp_path, monkeypatch, kind, alone):
    folder = tmp_path / "push"
    folder.mkdir()
    file(AcquisitionTime="120000").rename(folder / "a.dcm")
    odd, outside = folder / "b.dcm", file(name="outside.dcm")
    if kind == "pipe":
        os.mkfifo(odd)
    else:
        odd.symlink_to({"link to itself": odd, "link out": outside, "link to nothing": folder / "gone.dcm"}[kind])
    words = {
        "pipe": "found a named pipe, wanted a file", "link to itself": "a link that leads to itself",
        "link out": "leads out of the folder push", "link to nothing": "a link to a file that is not there",
    }  # fmt: skip
    monkeypatch.setattr("io.open", None)
    monkeypatch.setattr(Path, "open", None)
    with pytest.raises(RadiographError, match=rf"^b\.dcm: {words[kind]}"):
        read_radiographs(odd if alone else folder, within=folder)


def test_a_folder_of_folders_names_one_of_them(file, tmp_path):
    (tmp_path / "push" / "series").mkdir(parents=True)
    file().rename(tmp_path / "push" / "series" / "a.dcm")
    with pytest.raises(
        RadiographError, match=r"^push: found no radiographs in this folder, but in it the folder series"
    ):
        read_radiographs(tmp_path / "push")
