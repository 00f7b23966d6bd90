"""De-identified files: the same picture, and nothing hidden beside it, in every way that pixels are stored."""

from __future__ import annotations

import importlib.util
import json
import logging
import re
import subprocess
import sys
import warnings
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import pydicom
import pytest
from openjpeg.utils import encode_array
from pydicom.encaps import encapsulate
from pydicom.pixels.decoders.base import Decoder
from pydicom.uid import (
    UID,
    ExplicitVRBigEndian,
    JPEG2000Lossless,
    JPEGBaseline8Bit,
    JPEGLosslessSV1,
    JPEGLSLossless,
    RLELossless,
)

from spinestiff.errors import RadiographError
from spinestiff.imaging.deidentification.allow_list import KEPT
from spinestiff.imaging.deidentification.burned_in import inspection_row, sheet
from spinestiff.imaging.deidentification.codestreams import without_comments
from spinestiff.imaging.deidentification.deidentify import deidentify
from spinestiff.imaging.deidentification.pseudonyms import Key, key_of, moment
from spinestiff.imaging.projection import frontal_view
from spinestiff.imaging.radiograph import write_radiographs

KEY = Key(b"0123456789abcdef")
VIEW = frontal_view(sid=1500.0, source_to_patient=1340.0, shape=(48, 40), pixel=(0.3, 0.4))
CANARY = b"ZQXJ was here"
DOCUMENT = Path(__file__).parents[3] / "docs" / "deidentify.md"


def smooth(depth: int) -> np.ndarray:
    rows, columns = np.mgrid[: VIEW.shape[0], : VIEW.shape[1]]
    values = 2.0 ** (depth - 1) * (1.0 + 0.9 * np.sin(rows / 7.0) * np.cos(columns / 5.0))
    return values.astype(np.uint16 if depth > 8 else np.uint8)


def plain(tmp_path: Path, pixels: np.ndarray | None = None) -> pydicom.Dataset:
    path = tmp_path / "plain.dcm"
    write_radiographs(path, smooth(12) if pixels is None else pixels, VIEW)
    return pydicom.dcmread(path)


def saved(dataset: pydicom.Dataset) -> bytes:
    file = BytesIO()
    dataset.save_as(file)
    return file.getvalue()


def jpeg(pixels: np.ndarray) -> bytes:
    return cv2.imencode(".jpg", pixels)[1].tobytes()


def with_segment(stream: bytes, marker: int, at: int = 2) -> bytes:
    return stream[:at] + bytes((0xFF, marker)) + (len(CANARY) + 2).to_bytes(2, "big") + CANARY + stream[at:]


def jpeg_2000(pixels: np.ndarray) -> bytes:
    return encode_array(pixels, photometric_interpretation=2)


def jpeg_ls(tmp_path: Path, pixels: np.ndarray) -> bytes:
    dataset = plain(tmp_path, pixels)
    dataset.compress(JPEGLSLossless, encoding_plugin="pyjpegls", generate_instance_uid=False)
    return next(pydicom.encaps.generate_frames(dataset.PixelData, number_of_frames=1))


def coded(tmp_path: Path, kind: str) -> tuple[pydicom.Dataset, np.ndarray]:
    """A file with coded pixels that carries a canary beside them, and the pixels it decodes to."""
    depth = 8 if kind == "jpeg" else 12
    pixels = smooth(depth)
    dataset = plain(tmp_path)
    dataset.BitsStored, dataset.HighBit = depth, depth - 1
    if kind == "jpeg":
        dataset.BitsAllocated = 8
        stream, syntax = with_segment(with_segment(jpeg(pixels), 0xFE), 0xE1) + CANARY, JPEGBaseline8Bit
    elif kind == "jpeg-ls":
        stream, syntax = with_segment(with_segment(jpeg_ls(tmp_path, pixels), 0xFE), 0xE8), JPEGLSLossless
    else:
        stream = jpeg_2000(pixels)
        at = 4 + int.from_bytes(stream[4:6], "big")
        comment = b"\xff\x64" + (len(CANARY) + 4).to_bytes(2, "big") + b"\0\1" + CANARY
        stream, syntax = stream[:at] + comment + stream[at:] + CANARY, JPEG2000Lossless
    stream += b"\0" * (len(stream) % 2)
    dataset.PixelData = encapsulate([stream])
    dataset["PixelData"].VR = "OB"
    dataset["PixelData"].is_undefined_length = True
    dataset.file_meta.TransferSyntaxUID = UID(syntax)
    return dataset, pydicom.dcmread(BytesIO(saved(dataset))).pixel_array


@pytest.mark.parametrize("kind", ["jpeg", "jpeg-ls", "jpeg-2000"])
def test_coded_pixels_pass_and_their_comments_do_not(tmp_path, kind):
    dataset, pixels = coded(tmp_path, kind)
    content = saved(dataset)
    assert CANARY in content
    found = deidentify(content, KEY)
    new = pydicom.dcmread(BytesIO(found.content))
    assert CANARY not in found.content
    assert new.file_meta.TransferSyntaxUID == dataset.file_meta.TransferSyntaxUID
    np.testing.assert_array_equal(new.pixel_array, pixels)
    np.testing.assert_array_equal(found.frames[0], pixels)


def test_streams_with_room_for_text_are_refused():
    stream = jpeg(smooth(8))
    assert without_comments(stream).content.rstrip(b"\0").startswith(stream[:2])
    clean = without_comments(stream).content
    for wrong, why in (
        (with_segment(stream, 0xF3), "unknown segment"),
        (stream[:-30], "cut short"),
        (stream[:40], "cut short"),
        (clean[:2] + CANARY + clean[2:], "bytes between"),
        (b"\0\0\0\x0cjP  \r\n\x87\n" + jpeg_2000(smooth(12)), "no known header"),
        (b"", "no known header"),
    ):
        with pytest.raises(RadiographError, match=why):
            without_comments(wrong)
    stream = jpeg_2000(smooth(12))
    tile = stream.index(b"\xff\x90") + 12
    with pytest.raises(RadiographError, match="comments inside its tiles"):
        without_comments(stream[:tile] + b"\xff\x64\0\x06\0\1ZQ" + stream[tile:])
    with pytest.raises(RadiographError, match=r"cut short|where it ends"):
        without_comments(stream[:-40])


@pytest.mark.parametrize("signed", [False, True])
def test_old_overlays_above_the_stored_bits_go(tmp_path, signed):
    pixels = smooth(12)
    dataset = plain(tmp_path, pixels | np.uint16(0x8000) * (np.arange(40) % 3 == 0).astype(np.uint16))
    dataset.BitsStored, dataset.HighBit, dataset.PixelRepresentation = 12, 11, int(signed)
    new = pydicom.dcmread(BytesIO(deidentify(saved(dataset), KEY).content))
    expected = (pixels.astype(np.int16) << 4) >> 4 if signed else pixels
    # The bytes themselves: the library would hide what stands above.
    np.testing.assert_array_equal(np.frombuffer(new.PixelData, expected.dtype).reshape(VIEW.shape), expected)


def test_compressed_overlays_above_the_stored_bits_are_refused(tmp_path):
    dataset, _ = coded(tmp_path, "jpeg-2000")
    pixels = smooth(12) | np.uint16(0x8000)
    dataset.PixelData = encapsulate([jpeg_2000(pixels)])
    with pytest.raises(RadiographError, match="bits above those stored"):
        deidentify(saved(dataset), KEY)


@pytest.mark.parametrize("kind", ["jpeg-2000", "jpeg-ls"])
def test_signed_values_whose_bits_above_are_clear_pass(tmp_path, kind):
    dataset, pixels = coded(tmp_path, kind)
    dataset.PixelRepresentation = 1
    assert pixels.max() > 2047
    found = deidentify(saved(dataset), KEY)
    np.testing.assert_array_equal(found.frames[0], (pixels.astype(np.int16) << 4) >> 4)


def lossless(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pixels: np.ndarray) -> tuple[bytes, list[list[str]]]:
    """A file declared as JPEG Lossless of 12 bits, for which GDCM's child process would give these pixels; and the
    command lines of the children that are started, each followed by the number of bits it is to keep."""
    dataset, _ = coded(tmp_path, "jpeg")
    stream = with_segment(jpeg(smooth(8)), 0xFE).replace(b"\xff\xc0", b"\xff\xc3", 1)
    dataset.PixelData = encapsulate([stream + b"\0" * (len(stream) % 2)])
    dataset.file_meta.TransferSyntaxUID = JPEGLosslessSV1
    dataset.BitsAllocated, dataset.BitsStored, dataset.HighBit = 16, 12, 11
    children = []

    def run(command, **given):
        options = json.loads(given["input"].partition(b"\n")[0])["options"]
        children.append([*command, options["bits_stored"]])
        return subprocess.CompletedProcess(command, 0, pixels.astype("<u2").tobytes(), b"")

    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    monkeypatch.setattr(subprocess, "run", run)
    return saved(dataset), children


def test_jpeg_lossless_is_decoded_in_a_child(tmp_path, monkeypatch):
    content, children = lossless(tmp_path, monkeypatch, smooth(12))
    found = deidentify(content, KEY)
    assert children == [[sys.executable, "-P", "-m", "spinestiff.imaging.dicom.lossless", 16]]
    np.testing.assert_array_equal(found.frames[0], smooth(12))
    new = pydicom.dcmread(BytesIO(found.content))
    assert new.file_meta.TransferSyntaxUID == JPEGLosslessSV1
    stream = jpeg(smooth(8)).replace(b"\xff\xc0", b"\xff\xc3", 1)
    assert new.PixelData == encapsulate([without_comments(stream).content])
    assert CANARY in content and CANARY not in found.content
    content, _ = lossless(tmp_path, monkeypatch, smooth(12) | np.uint16(0x8000))
    with pytest.raises(RadiographError, match="bits above those stored"):
        deidentify(content, KEY)


def test_jpeg_lossless_without_gdcm_names_the_extra(tmp_path, monkeypatch):
    content, children = lossless(tmp_path, monkeypatch, smooth(12))
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(RadiographError, match=r"JPEG Lossless needs GDCM.*pip install 'spinestiff\[dicom\]'"):
        deidentify(content, KEY)
    assert children == []


@pytest.mark.parametrize("kind", ["jpeg", "jpeg-ls", "jpeg-2000", "rle"])
def test_no_decoder_is_chosen_by_what_is_installed(tmp_path, monkeypatch, kind):
    """The library takes GDCM for every coding where it is there."""
    if kind == "rle":
        dataset, pixels = plain(tmp_path), smooth(12)
        dataset.compress(RLELossless, generate_instance_uid=False)
    else:
        dataset, pixels = coded(tmp_path, kind)
    for name in ("as_array", "as_buffer", "iter_array", "iter_buffer"):
        monkeypatch.setattr(Decoder, name, None)
    np.testing.assert_array_equal(deidentify(saved(dataset), KEY).frames[0], pixels)


def test_rle_becomes_uncompressed(tmp_path):
    dataset = plain(tmp_path)
    dataset.compress(RLELossless, generate_instance_uid=False)
    new = pydicom.dcmread(BytesIO(deidentify(saved(dataset), KEY).content))
    assert not new.file_meta.TransferSyntaxUID.is_compressed
    np.testing.assert_array_equal(new.pixel_array, smooth(12))


def test_big_endian_becomes_little(tmp_path):
    dataset, file = plain(tmp_path), BytesIO()
    dataset.file_meta.TransferSyntaxUID = ExplicitVRBigEndian
    dataset.PixelData = smooth(12).astype(">u2").tobytes()
    pydicom.dcmwrite(file, dataset, implicit_vr=False, little_endian=False, force_encoding=True)
    np.testing.assert_array_equal(pydicom.dcmread(BytesIO(file.getvalue())).pixel_array, smooth(12))
    new = pydicom.dcmread(BytesIO(deidentify(file.getvalue(), KEY).content))
    np.testing.assert_array_equal(np.frombuffer(new.PixelData, "<u2").reshape(VIEW.shape), smooth(12))


@pytest.mark.parametrize(("bits", "kind"), [(12, "u2"), (8, "u1")])
def test_a_table_of_a_big_endian_file_becomes_little(tmp_path, bits, kind):
    dataset, table, file = plain(tmp_path), pydicom.Dataset(), BytesIO()
    entries = np.array([0, 5, 9, 200], dtype=kind)
    table.add_new("LUTDescriptor", "US", [4, 0, bits])
    table.add_new("LUTData", "OW", np.frombuffer(entries.tobytes(), "<u2").astype(">u2").tobytes())
    dataset.VOILUTSequence = [table]
    dataset.file_meta.TransferSyntaxUID = ExplicitVRBigEndian
    dataset.PixelData = smooth(12).astype(">u2").tobytes()
    pydicom.dcmwrite(file, dataset, implicit_vr=False, little_endian=False, force_encoding=True)
    new = pydicom.dcmread(BytesIO(deidentify(file.getvalue(), KEY).content)).VOILUTSequence[0]
    assert np.frombuffer(new.LUTData, "<u2").tolist() == entries.tolist()


def test_look_up_tables_are_as_long_as_they_say(tmp_path):
    dataset, table = plain(tmp_path), pydicom.Dataset()
    table.add_new("LUTDescriptor", "US", [4, 0, 12])
    table.LUTExplanation = CANARY.decode()
    table.add_new("LUTData", "OW", np.array([0, 5, 9, 4000], "<u2").tobytes() + CANARY + b"\0")
    dataset.VOILUTSequence = [table]
    found = deidentify(saved(dataset), KEY)
    new = pydicom.dcmread(BytesIO(found.content)).VOILUTSequence[0]
    assert np.frombuffer(new.LUTData, "<u2").tolist() == [0, 5, 9, 4000]
    assert list(new.LUTDescriptor) == [4, 0, 12]
    assert CANARY not in found.content
    table.LUTDescriptor = [400, 0, 12]
    found = deidentify(saved(dataset), KEY)
    assert found.left_out == ("VOILUTSequence",)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"SOPClassUID": "1.2.840.10008.5.1.4.1.1.88.11"}, "no radiograph"),
        ({"SOPClassUID": "1.2.840.10008.5.1.4.1.1.12.2.1"}, "an enhanced file; export it as the plain kind, XA or RF"),
        ({"SOPClassUID": "1.2.840.10008.5.1.4.1.1.104.1"}, "no radiograph"),
        ({"EncapsulatedDocument": b"%PDF"}, "holds a document"),
        ({"ContentSequence": [pydicom.Dataset()]}, "holds a document"),
        ({"Modality": "MR"}, "no modality"),
        ({"PhotometricInterpretation": "RGB", "SamplesPerPixel": 3}, "SamplesPerPixel isn't"),
        ({"Rows": 60000}, "Rows isn't"),
        ({"Rows": 47, "BitsStored": 17}, "BitsStored isn't"),
        ({"Rows": 49}, "cut short"),
        ({"BitsStored": 12}, "contradict"),
        ({"StudyInstanceUID": ""}, "StudyInstanceUID is missing"),
    ],
)
def test_what_is_no_radiograph_is_refused(tmp_path, change, why):
    dataset = plain(tmp_path)
    for keyword, value in change.items():
        setattr(dataset, keyword, value)
    with pytest.raises(RadiographError, match=why):
        deidentify(saved(dataset), KEY)


def test_a_coded_view_keeps_its_code_and_not_its_words(tmp_path):
    dataset, code = plain(tmp_path), pydicom.Dataset()
    code.CodeValue, code.CodingSchemeDesignator, code.CodeMeaning = "272479007", CANARY.decode(), CANARY.decode()
    dataset.ViewCodeSequence = [code]
    found = deidentify(saved(dataset), KEY)
    (view,) = pydicom.dcmread(BytesIO(found.content)).ViewCodeSequence
    assert (view.CodeValue, view.CodingSchemeDesignator, view.CodeMeaning) == ("272479007", "SCT", "postero-anterior")
    code.CodeValue = CANARY.decode()
    found = deidentify(saved(dataset), KEY)
    assert found.left_out == ("ViewCodeSequence",)
    assert CANARY not in found.content


@pytest.mark.parametrize(
    ("both", "time"), [("20240501", "101530"), ("", "101530"), ("20240501101530.5", "101530.5"), ("202405", "101530")]
)
def test_a_date_alone_takes_no_acquisition_time_away(tmp_path, both, time):
    dataset = plain(tmp_path)
    dataset.AcquisitionDate, dataset.AcquisitionTime, dataset.AcquisitionDateTime = "20240501", "101530", both
    dataset.ContentDate, dataset.ContentTime = "20240501", time
    found = pydicom.dcmread(BytesIO(deidentify(saved(dataset), KEY).content))
    assert found.AcquisitionTime == found.ContentTime != ""
    assert found.AcquisitionDate == found.ContentDate


def test_a_time_without_a_date_is_of_the_day_that_the_moment_has(tmp_path):
    dataset = plain(tmp_path)
    dataset.StudyDate, dataset.AcquisitionTime, dataset.AcquisitionDateTime = "20240430", "101530", "20240501"
    dataset.ContentDate, dataset.ContentTime = "20240501", "101530"
    if "AcquisitionDate" in dataset:
        del dataset.AcquisitionDate
    found = pydicom.dcmread(BytesIO(deidentify(saved(dataset), KEY).content))
    assert (found.AcquisitionDate, found.AcquisitionTime) == (found.ContentDate, found.ContentTime)


@pytest.mark.parametrize("speaker", ["pydicom", "PIL", "pylibjpeg"])
def test_no_library_or_codec_gets_a_word_in(tmp_path, monkeypatch, caplog, recwarn, speaker):
    """Their warnings and log lines quote values of the file."""

    def talkative(*_):
        logging.getLogger(speaker).error("Doe^Jane")
        warnings.warn("Doe^Jane", stacklevel=1)
        raise RadiographError("refused")

    monkeypatch.setattr("spinestiff.imaging.deidentification.deidentify._deidentified", talkative)
    with pytest.raises(RadiographError, match="refused"):
        deidentify(saved(plain(tmp_path)), KEY)
    assert not caplog.records
    assert not [warning for warning in recwarn if "Doe" in str(warning.message)]
    logging.getLogger(speaker).error("aloud again")
    assert [record.message for record in caplog.records] == ["aloud again"]


def test_damaged_files_end_in_one_kind_of_error(tmp_path):
    dataset = plain(tmp_path)
    dataset.PatientName = CANARY.decode()
    content, rng = saved(dataset), np.random.default_rng(7)
    refused = 0
    for number in range(300):
        damaged = bytearray(content)
        if number % 3 == 0:
            del damaged[int(rng.integers(len(damaged))) :]
        for at in rng.integers(132, 1400, 6):
            if at < len(damaged):
                damaged[at] = int(rng.integers(256))
        try:
            said = deidentify(bytes(damaged), KEY).content
        except RadiographError as problem:
            refused += 1
            said = str(problem).encode()
        assert CANARY[:4] not in said
    assert 100 < refused < 300


def test_messages_of_the_dicom_library_are_not_passed_on(tmp_path, monkeypatch):
    def complain(*_: object) -> None:
        raise ValueError(f"Invalid value {CANARY.decode()}")

    content = saved(plain(tmp_path))
    monkeypatch.setattr(pydicom, "dcmread", complain)
    with pytest.raises(RadiographError, match=r"damaged or unsupported DICOM \(ValueError\)") as caught:
        deidentify(content, KEY)
    assert caught.value.__cause__ is None
    assert "ZQXJ" not in str(caught.value)


def test_moments_of_dicom():
    assert f"{moment('20240229', '235959.5')}" == "2024-02-29 23:59:59.500000"
    assert f"{moment('2024.02.29', '17:58:01')}" == "2024-02-29 17:58:01"
    assert f"{moment('', '0102')}" == "1900-01-01 01:02:00"
    assert f"{moment('20240229', '')}" == "2024-02-29 12:00:00"
    for date, time in (("20240230", ""), ("today", "1200"), ("20240229", "noon"), ("", ""), ("20240229", "2500")):
        assert moment(date, time) is None


def test_keys_are_secret():
    assert "0123456789" not in repr(KEY)
    with pytest.raises(RadiographError, match="a key of 3 bytes"):
        Key(b"abc")


@pytest.mark.parametrize(
    "content",
    [
        b'\xef\xbb\xbf{"schema_version": 1, "id": "anna"}',
        b"frame,force_n\n0,0\n1,20\n",
        b"<?xml version='1.0'?>",
        b"[" * 4000,
        bytes(128) + b"DICM",
    ],
    ids=["json", "csv", "xml", "brackets", "dicom"],
)
def test_data_are_no_key(tmp_path, content):
    path = tmp_path / "file"
    path.write_bytes(content)
    with pytest.raises(RadiographError, match="key file: holds data or text, not a key"):
        key_of(path)
    assert path.read_bytes() == content


@pytest.mark.parametrize(
    "content",
    [
        bytes(range(200, 232)),
        b"0123456789abcdef0123456789abcdef\r\n",
        "ein langer Schlüssel\n".encode(),
        b"<[{x7/9!lkq-Ypq(w]",
        b"q83vEiM0VniavN7w\nq83vEiM0VniavN7wESIz==\n",
        b"-----BEGIN PRIVATE KEY-----\nMC4CAQAwBQYDK2VwBCIEIA==\n-----END PRIVATE KEY-----\n",
    ],
)
def test_random_bytes_and_a_line_of_text_are_keys(tmp_path, content):
    path = tmp_path / "file"
    path.write_bytes(content)
    assert key_of(path) == (Key(content.strip()), False)


def test_text_shows_in_the_picture_whatever_its_grey():
    """Faint text in a corner of one of several frames is seen in the sheet's bands."""
    frames = np.full((3, 400, 400), 2000, np.uint16)
    quiet = cv2.imdecode(np.frombuffer(sheet([inspection_row(frames, "x")]), np.uint8), 0)
    text = np.zeros((400, 400), np.uint8)
    cv2.putText(text, "DOE", (5, 40), cv2.FONT_HERSHEY_SIMPLEX, 1.0, 40, 2)
    frames[1] += text
    frames[0, 200, 200] = 4095  # what the window would otherwise be set to
    shown = cv2.imdecode(np.frombuffer(sheet([inspection_row(frames, "x")]), np.uint8), 0)
    top_band = (slice(32, 140), slice(660, 1300))
    assert np.ptp(quiet[top_band]) < 3
    assert np.ptp(shown[top_band]) > 20


def test_the_document_lists_what_is_kept():
    table = re.findall(r"^\| (.+?) \| .+? \|$", DOCUMENT.read_text(encoding="utf-8"), re.MULTILINE)
    listed = {word for row in table for word in re.findall(r"`(\w+)`", row)}
    assert listed == {*KEPT, "ViewCodeSequence", "ModalityLUTSequence", "VOILUTSequence", "PixelData", "SOPClassUID"}
