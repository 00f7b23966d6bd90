"""Frames of a large uncompressed file read one by one: the same as all at once, and refused where those are."""

from __future__ import annotations

import hashlib

import numpy as np
import pydicom
import pytest

from spinestiff.errors import RadiographError
from spinestiff.imaging import radiograph
from spinestiff.imaging.dicom import files, reading
from spinestiff.imaging.dicom.export import read_exported
from spinestiff.imaging.dicom.identity import read_identity
from spinestiff.imaging.motion import motion_course
from spinestiff.imaging.radiograph import KEPT, open_radiographs, read_radiographs, read_scans
from spinestiff.subject.intake.pictures import pixel_digest

SERIES = (np.arange(6 * 40 * 36).reshape(6, 40, 36) * 7 % 4096).astype(np.uint16)


@pytest.fixture(autouse=True)
def every_file_is_large(monkeypatch):
    monkeypatch.setattr(reading, "LEAST_BYTES", 1)


@pytest.mark.parametrize(
    "tags",
    [
        {},
        {"PhotometricInterpretation": "MONOCHROME1", "PixelIntensityRelationshipSign": None},
        {"RescaleSlope": 2.0, "RescaleIntercept": -100.0},
        # What lies above the stored bits is no part of a pixel.
        {"BitsStored": 8, "HighBit": 7},
        {"PixelRepresentation": 1},
    ],
    ids=["plain", "inverted", "rescaled", "eight bits stored", "signed"],
)
@pytest.mark.parametrize("frames", [1, 6])
def test_each_frame_is_as_in_the_file_read_whole(file, tags, frames):
    path = file(SERIES[:frames], **tags)
    whole, single = read_radiographs(path), open_radiographs(path)
    assert not isinstance(single, tuple) and len(single) == frames
    for one, other in zip(single, whole, strict=True):
        np.testing.assert_array_equal(one.pixels, other.pixels)
        assert (one.frame, one.time_s, one.provenance) == (other.frame, other.time_s, other.provenance)
        np.testing.assert_array_equal(one.view.source, other.view.source)
    assert single[-1].frame == frames - 1
    with pytest.raises(IndexError):
        single[frames]


def test_only_the_frame_that_is_asked_for_is_read_and_few_stay(file, monkeypatch):
    read = []
    fromfile = np.fromfile
    monkeypatch.setattr(np, "fromfile", lambda *args, **more: read.append(args[2]) or fromfile(*args, **more))
    single = open_radiographs(file(SERIES))
    assert read == []
    assert [single[3].frame, single[3].frame] == [3, 3] and read == [40 * 36]
    for one in single:
        assert one.pixels.shape == (40, 36)
    assert len(single._kept) == KEPT < len(SERIES)


def deflate(dataset):
    dataset.file_meta.TransferSyntaxUID = pydicom.uid.DeflatedExplicitVRLittleEndian


def test_a_coded_file_is_read_whole(file):
    assert len(open_radiographs(file(SERIES, change=deflate))) == 6


@pytest.mark.parametrize("implicit", [True, False])
def test_a_file_whose_elements_are_not_coded_as_its_header_says_is_read_whole(file, implicit):
    """As the DICOM library reads it: a large one was told to be cut short."""
    path = file(SERIES)
    whole = read_radiographs(path)
    dataset = pydicom.dcmread(path)
    told = pydicom.uid.ExplicitVRLittleEndian if implicit else pydicom.uid.ImplicitVRLittleEndian
    dataset.file_meta.TransferSyntaxUID = told
    pydicom.dcmwrite(path, dataset, implicit_vr=implicit, little_endian=True, force_encoding=True)
    for one, other in zip(open_radiographs(path), whole, strict=True):
        np.testing.assert_array_equal(one.pixels, other.pixels)


def overlaid(dataset):
    dataset.add_new(0x60000010, "US", 36)
    dataset.add_new(0x60000011, "US", 40)
    dataset.add_new(0x50003000, "OW", bytes(files.MOST_HEADER_BYTES + 1))


def test_a_file_whose_pixels_begin_late_is_read_whole_where_it_is_small_enough(file, monkeypatch):
    path = file(SERIES, change=overlaid)
    found = open_radiographs(path)
    assert isinstance(found, tuple) and len(found) == 6
    monkeypatch.setattr(files, "MOST_BYTES", 2**20)
    with pytest.raises(RadiographError, match=r"a\.dcm: found a header of 1 MB, wanted a radiograph"):
        open_radiographs(path)


@pytest.fixture
def little_is_read_whole(monkeypatch):
    """Files of more than one small frame are too large to be read whole."""
    for module in (reading, files, radiograph):
        monkeypatch.setattr(module, "MOST_BYTES", 5000)
    monkeypatch.setattr(files, "MOST_HEADER_BYTES", 2000)


def same_pictures(found, wanted):
    for one, other in zip(found, wanted, strict=True):
        np.testing.assert_array_equal(one.pixels, other.pixels)
        assert (one.frame, one.time_s, one.sha256) == (other.frame, other.time_s, other.sha256)
        assert (one.provenance, one.source) == (other.provenance, other.source)


def test_a_file_too_large_to_be_read_whole_is_read_frame_by_frame(file, request):
    path = file(SERIES)
    whole = read_radiographs(path)
    motion = motion_course(frame.pixels for frame in whole)
    exported = read_exported(path, path.name, path.parent)
    digest = pixel_digest(exported)
    request.getfixturevalue("little_is_read_whole")
    apart = read_radiographs(path)
    assert isinstance(whole, tuple) and not isinstance(apart, tuple)
    assert apart[0].sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    same_pictures(apart, whole)
    (scan,), _ = read_scans(path, reading.Geometry())
    np.testing.assert_array_equal(motion_course(iter(scan.pixels)), motion)
    # What an export's files are told apart by is the same, too.
    again = read_exported(path, path.name, path.parent)
    assert (again.scan.sha256, again.tags, again.looks) == (exported.scan.sha256, exported.tags, exported.looks)
    pixel_digest.__globals__["_digest"].cache_clear()
    assert pixel_digest(again) == digest != ""


def test_a_small_file_may_have_a_long_header(file, request):
    def long_header(dataset):
        dataset.private_block(0x0099, "LONG", create=True).add_new(1, "OB", bytes(3000))

    path = file(SERIES[:1], change=long_header)
    request.getfixturevalue("little_is_read_whole")
    for module in (files, reading, radiograph):
        request.getfixturevalue("monkeypatch").setattr(module, "MOST_BYTES", 50_000)
    assert read_exported(path, path.name, path.parent).frames == 1
    read_identity(path)


def test_files_that_are_too_large_together_are_read_one_by_one(file, request):
    for number in range(3):
        folder = file(SERIES[number : number + 1], f"{number}.dcm", InstanceNumber=number).parent
    whole = read_radiographs(folder)
    request.getfixturevalue("little_is_read_whole")
    apart = read_radiographs(folder)
    assert isinstance(whole, tuple) and not isinstance(apart, tuple)
    same_pictures(apart, whole)


@pytest.mark.parametrize("bits", [8, 16])
def test_a_folder_may_hold_as_many_pixels_uncompressed_as_a_file(file, monkeypatch, bits):
    """However many bits a pixel has; those of compressed files count as uncompressed."""

    def even(dataset):
        dataset.Rows = dataset.Columns = 300
        dataset.BitsAllocated = dataset.BitsStored = bits
        dataset.HighBit = bits - 1
        dataset.PixelData = bytes(300 * 300 * bits // 8)

    paths = [file(SERIES[:1], f"{number}.dcm", change=even, InstanceNumber=number) for number in range(3)]
    monkeypatch.setattr(radiograph, "MOST_BYTES", sum(path.stat().st_size for path in paths))
    assert len(read_radiographs(paths[0].parent)) == 3
    for number in range(3):
        file(SERIES[:1], f"{number}.dcm", change=lambda one: (even(one), deflate(one)), InstanceNumber=number)
    monkeypatch.setattr(radiograph, "MOST_BYTES", 3 * 300 * 300 * bits // 8 - 1)
    with pytest.raises(RadiographError, match="MB of pixels in 3 files, wanted less of files that are compressed"):
        read_radiographs(paths[0].parent)


def test_of_a_coded_file_that_is_too_large_it_is_said_what_to_do(file, little_is_read_whole):
    noise = np.random.default_rng(0).integers(0, 4096, SERIES.shape).astype(np.uint16)
    with pytest.raises(RadiographError, match=r"a\.dcm: found 0 MB, wanted .* uncompressed DICOM.*; export it unc"):
        read_radiographs(file(noise, change=deflate))


@pytest.mark.usefixtures("little_is_read_whole")
def test_of_a_large_file_one_grey_value_is_told(file):
    path = file(np.full_like(SERIES, 700))
    with pytest.raises(RadiographError, match="one grey value"):
        read_exported(path, path.name, path.parent)


@pytest.mark.parametrize("most", [0.0, 0.5, 0.97])
def test_a_file_that_is_cut_short_is_refused_before_a_frame_is_shown(file, most):
    path = file(SERIES)
    content = path.read_bytes()
    pixels = 2 * SERIES.size
    path.write_bytes(content[: len(content) - pixels + int(most * pixels)])
    with pytest.raises(RadiographError, match=r"a\.dcm: .*(cut short|can't be read)") as refused:
        open_radiographs(path)
    assert "\n" not in str(refused.value)


def test_what_is_no_radiograph_is_refused(file, tmp_path):
    with pytest.raises(RadiographError, match="Modality: found CT"):
        open_radiographs(file(SERIES, Modality="CT"))
    text = tmp_path / "b.dcm"
    text.write_bytes(b"no DICOM at all " * 50)
    with pytest.raises(RadiographError, match=r"b\.dcm: "):
        open_radiographs(text)
