"""Frames of a large uncompressed file read one by one: the same as all at once, and refused where those are."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.errors import RadiographError
from spinestiff.imaging.dicom import reading
from spinestiff.imaging.radiograph import KEPT, open_radiographs, read_radiographs

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
    for radiograph in single:
        assert radiograph.pixels.shape == (40, 36)
    assert len(single._kept) == KEPT < len(SERIES)


def test_a_coded_file_is_read_whole(file):
    import pydicom

    def deflate(dataset):
        dataset.file_meta.TransferSyntaxUID = pydicom.uid.DeflatedExplicitVRLittleEndian

    assert len(open_radiographs(file(SERIES, change=deflate))) == 6


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
