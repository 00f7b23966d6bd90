"""Every transfer syntax gives the pixels that were coded; streams that lie about their size are refused."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pydicom
import pytest
from pydicom.dataset import Dataset
from pydicom.encaps import encapsulate, generate_frames

from spinestiff.errors import RadiographError
from spinestiff.imaging.dicom import lossless
from spinestiff.imaging.dicom.runlength import decode_rle
from spinestiff.imaging.dicom.streams import stream_header
from spinestiff.imaging.radiograph import read_radiographs

EXACT = [
    ("ImplicitVRLittleEndian", 10), ("ExplicitVRBigEndian", 16), ("ExplicitVRBigEndian", 8),
    ("DeflatedExplicitVRLittleEndian", 8), ("RLELossless", 8), ("RLELossless", 12), ("RLELossless", 16),
    ("JPEG2000Lossless", 8), ("JPEG2000Lossless", 12), ("JPEG2000Lossless", 16),
    ("JPEGLSLossless", 8), ("JPEGLSLossless", 10), ("JPEGLSLossless", 16),
]  # fmt: skip


@pytest.fixture
def coded(file, campaign_module):
    """A file of three smooth frames, coded; tags set after that."""

    def make(syntax: str, bits: int, **declared: object) -> tuple[Path, np.ndarray]:
        pixels = campaign_module.smooth(3, (40, 36), bits)

        def change(dataset: Dataset) -> None:
            dataset.BitsStored, dataset.HighBit = bits, bits - 1
            dataset.BitsAllocated = 8 if bits == 8 else 16
            campaign_module.code_pixels(dataset, pixels, syntax)
            for keyword, value in declared.items():
                setattr(dataset, keyword, value)

        path = file(pixels)
        dataset = pydicom.dcmread(path)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            change(dataset)
            little, implicit = syntax != "ExplicitVRBigEndian", syntax == "ImplicitVRLittleEndian"
            pydicom.dcmwrite(path, dataset, implicit_vr=implicit, little_endian=little, force_encoding=True)
        return path, pixels

    return make


@pytest.mark.parametrize(("syntax", "bits"), EXACT)
def test_lossless_codings_give_the_pixels(coded, syntax, bits):
    path, pixels = coded(syntax, bits)
    read = read_radiographs(path)
    assert len(read) == 3
    np.testing.assert_array_equal([radiograph.pixels for radiograph in read], pixels)


def test_baseline_jpeg_is_near_and_unscaled(coded):
    path, pixels = coded("JPEGBaseline8Bit", 8)
    errors = np.array([radiograph.pixels for radiograph in read_radiographs(path)]) - pixels
    assert 0.0 < np.abs(errors).max() <= 6.0  # quality 95 on noise of 2.5 levels
    assert abs(errors.mean()) < 0.2


def test_signed_pixels_survive_coding(file):
    signed = np.linspace(-2000, 2047, 40 * 36).astype(np.int16).reshape(40, 36)

    def change(dataset: Dataset) -> None:
        dataset.BitsStored, dataset.HighBit, dataset.PixelRepresentation = 12, 11, 1
        dataset.PixelData = signed.tobytes()
        dataset.compress(pydicom.uid.RLELossless)

    np.testing.assert_array_equal(read_radiographs(file(change=change))[0].pixels, signed)


@pytest.mark.parametrize(
    ("syntax", "declared", "message"),
    [
        ("JPEG2000Lossless", {"Rows": 12}, "a coded frame of 40 x 36, wanted 12 x 36"),
        ("JPEGLSLossless", {"Columns": 40}, "a coded frame of 40 x 36, wanted 40 x 40"),
        ("JPEGBaseline8Bit", {"Rows": 41}, "a coded frame of 40 x 36, wanted 41 x 36"),
        ("RLELossless", {"Rows": 39}, "a coded frame of more than 1404 pixels|of 14.. pixels, wanted 1404"),
        ("RLELossless", {"Rows": 41}, "a coded frame of 1440 pixels, wanted 1476"),
        ("JPEG2000Lossless", {"BitsStored": 10, "HighBit": 9}, "of 12 bits, wanted 10"),
        ("JPEGLSLossless", {"BitsAllocated": 8, "BitsStored": 8, "HighBit": 7}, "of 12 bits, wanted 8"),
    ],
)
def test_a_stream_of_another_size_is_refused(coded, syntax, declared, message):
    path, _ = coded(syntax, 8 if syntax.startswith("JPEGB") else 12, **declared)
    with pytest.raises(RadiographError, match=message):
        read_radiographs(path)


@pytest.mark.parametrize("offsets", [True, False])
@pytest.mark.parametrize("count", [1, 2, 4])
@pytest.mark.parametrize("syntax", ["JPEG2000Lossless", "JPEGLSLossless", "RLELossless"])
def test_another_number_of_frames_is_refused(coded, syntax, count, offsets):
    path, _ = coded(syntax, 12, NumberOfFrames=count)
    dataset = pydicom.dcmread(path)
    parts = list(generate_frames(dataset.PixelData, number_of_frames=3))
    dataset.PixelData = encapsulate(parts, has_bot=offsets)
    dataset.save_as(path)
    wanted = f"found 3 coded frames, wanted {count} as declared"
    if count == 1 and not offsets:  # all fragments are one frame's
        wanted = "goes on behind its end|of more than 1440 pixels"
    with pytest.raises(RadiographError, match=wanted):
        read_radiographs(path)


def test_joined_fragments_of_several_frames_are_not_one_frame(coded):
    path, _ = coded("JPEGLSLossless", 12)
    dataset = pydicom.dcmread(path)
    parts = list(generate_frames(dataset.PixelData, number_of_frames=3))
    dataset.PixelData, dataset.NumberOfFrames = encapsulate([b"".join(parts)]), 1
    dataset.save_as(path)
    with pytest.raises(RadiographError, match="goes on behind its end"):
        read_radiographs(path)


def test_more_pixels_than_declared_are_refused(file):
    with pytest.raises(RadiographError, match="PixelData: found 2880 bytes, wanted 2592 as declared"):
        read_radiographs(file(Rows=36))


def test_a_stream_of_another_coding_is_refused(coded):
    path, _ = coded("JPEG2000Lossless", 12)
    dataset = pydicom.dcmread(path)
    dataset.file_meta.TransferSyntaxUID = pydicom.uid.JPEGLSLossless
    dataset.save_as(path)
    with pytest.raises(RadiographError, match="found a coded frame of JPEG 2000, wanted JPEG-LS"):
        read_radiographs(path)


@pytest.mark.parametrize("syntax", ["JPEG2000Lossless", "JPEGLSLossless", "JPEGBaseline8Bit"])
def test_every_cut_of_a_stream_is_seen(coded, syntax):
    path, _ = coded(syntax, 8)
    stream = next(generate_frames(pydicom.dcmread(path).PixelData, number_of_frames=3)).rstrip(b"\0")
    assert stream_header(stream).rows == 40
    for end in range(len(stream)):
        late = "a coded frame is cut short; copy" if end > len(stream) - 100 else "a coded frame"
        with pytest.raises(RadiographError, match=late):
            stream_header(stream[:end])


CODED = ["JPEG2000Lossless", "JPEGLSLossless", "JPEGBaseline8Bit", "RLELossless"]
FILLERS = [b"\xff", b"\0" * 3, b"\xff" * 40, b"\0" * 5000, b"\0\xff" * 20]


def refilled(path: Path, parts: list[bytes], pieces: int, offsets: bool, frames: int) -> None:
    dataset = pydicom.dcmread(path)
    dataset.NumberOfFrames = frames
    dataset.PixelData = encapsulate(parts, fragments_per_frame=pieces, has_bot=offsets)
    dataset.save_as(path)


def frames_of(path: Path, count: int) -> list[bytes]:
    return list(generate_frames(pydicom.dcmread(path).PixelData, number_of_frames=count))


@pytest.mark.parametrize("filler", FILLERS)
@pytest.mark.parametrize(("pieces", "offsets"), [(1, False), (2, False), (2, True)])
@pytest.mark.parametrize("syntax", CODED)
def test_filler_behind_the_end_of_a_frame_is_passed_by(coded, syntax, pieces, offsets, filler):
    path, _ = coded(syntax, 8)
    sound = [radiograph.pixels for radiograph in read_radiographs(path)]
    parts = frames_of(path, 3)
    if syntax == "RLELossless":
        pieces = 1  # no other is allowed
    refilled(path, [part + filler for part in parts], pieces, offsets, 3)
    np.testing.assert_array_equal([radiograph.pixels for radiograph in read_radiographs(path)], sound)


@pytest.mark.parametrize("syntax", CODED)
def test_a_cine_of_96_frames_with_filler_is_read(coded, syntax):
    path, _ = coded(syntax, 8)
    first = read_radiographs(path)[0].pixels
    parts = [frames_of(path, 3)[0] + b"\xff" * (i % 13) for i in range(96)]
    refilled(path, parts, 1 if syntax == "RLELossless" else 3, False, 96)
    read = read_radiographs(path)
    assert len(read) == 96
    assert all((radiograph.pixels == first).all() for radiograph in read)


@pytest.mark.parametrize("filler", FILLERS[:4])
@pytest.mark.parametrize("syntax", CODED)
def test_filler_hides_no_cut_of_a_frame(coded, syntax, filler):
    path, _ = coded(syntax, 8)
    parts = frames_of(path, 3)
    whole = len(parts[1].rstrip(b"\0"))
    for cut in (3, 20, whole // 2):
        refilled(path, [parts[0], parts[1][: whole - cut] + filler, parts[2]], 1, False, 3)
        if syntax == "RLELossless" and len(filler) <= cut == 3:
            continue  # runs have no end mark: what takes the place of the rest to the byte can't be told from it
        with pytest.raises(
            RadiographError, match=r"^a\.dcm: PixelData: (a coded frame is cut short|found a coded frame of)"
        ):
            read_radiographs(path)


def test_twelve_bit_jpeg_says_so(coded):
    path, _ = coded("JPEGBaseline8Bit", 8)
    dataset = pydicom.dcmread(path)
    parts = [bytearray(part) for part in generate_frames(dataset.PixelData, number_of_frames=3)]
    for part in parts:
        place = part.find(b"\xff\xc0")
        part[place + 1], part[place + 4] = 0xC1, 12
    dataset.PixelData = encapsulate([bytes(part) for part in parts])
    dataset.file_meta.TransferSyntaxUID = pydicom.uid.JPEGExtended12Bit
    dataset.save_as(path)
    with pytest.raises(RadiographError, match="found JPEG of 12 bits, wanted 8; export it uncompressed"):
        read_radiographs(path)


def test_a_stream_that_its_codec_refuses_is_one_line(coded):
    path, _ = coded("JPEGLSLossless", 12)
    dataset = pydicom.dcmread(path)
    parts = [bytearray(part) for part in generate_frames(dataset.PixelData, number_of_frames=3)]
    parts[1][200:230] = b"\x55" * 30
    dataset.PixelData = encapsulate([bytes(part) for part in parts])
    dataset.save_as(path)
    with pytest.raises(RadiographError, match=r"^a.dcm: PixelData: JPEG-LS .* pixels that can't be decoded; copy it"):
        read_radiographs(path)


def test_an_unread_syntax_is_named(coded):
    path, _ = coded("JPEG2000Lossless", 12)
    dataset = pydicom.dcmread(path)
    dataset.file_meta.TransferSyntaxUID = pydicom.uid.MPEG2MPML
    dataset.save_as(path)
    with pytest.raises(RadiographError, match=r"TransferSyntaxUID: found MPEG2 .*, which is not read"):
        read_radiographs(path)


@pytest.mark.parametrize("coded_bytes", [b"", b"\x02" + b"\0" * 70, b"\x01\0\0\0\x40\0\0\0" + b"\0" * 56 + b"\x81"])
def test_broken_runs_are_refused(coded_bytes):
    with pytest.raises(RadiographError):
        decode_rle(coded_bytes, 4, 4, 1)


def test_runs_literals_and_padding_of_rle():
    header = (1).to_bytes(4, "little") + (64).to_bytes(4, "little") + b"\0" * 56
    runs = b"\xfe\x07" + b"\x80" + b"\x00\x09" + b"\0"  # 7 three times, nothing, 9 once, padding
    np.testing.assert_array_equal(decode_rle(header + runs, 2, 2, 1), [[7, 7], [7, 9]])


# JPEG Lossless


def lossless_file(coded) -> Path:
    """Declared as JPEG Lossless; what is in the stream only GDCM would mind."""
    path, _ = coded("JPEGBaseline8Bit", 8)
    dataset = pydicom.dcmread(path)
    parts = [bytearray(part) for part in generate_frames(dataset.PixelData, number_of_frames=3)]
    for part in parts:
        part[part.find(b"\xff\xc0") + 1] = 0xC3
    dataset.PixelData = encapsulate([bytes(part) for part in parts])
    dataset.file_meta.TransferSyntaxUID = pydicom.uid.JPEGLosslessSV1
    dataset.save_as(path)
    return path


def test_jpeg_lossless_without_gdcm_names_the_extra(coded, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(
        RadiographError, match=r"a.dcm: PixelData: JPEG Lossless needs GDCM.*pip install 'spinestiff\[dicom\]'"
    ):
        read_radiographs(lossless_file(coded))


def test_a_child_that_fails_or_hangs_is_one_line(coded, monkeypatch):
    path = lossless_file(coded)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    answers = [subprocess.CompletedProcess([], -11, b"", b"secret"), subprocess.CompletedProcess([], 0, b"short", b"")]
    for answer in answers:
        monkeypatch.setattr(subprocess, "run", lambda *args, answer=answer, **kwargs: answer)
        with pytest.raises(RadiographError, match=r"^a.dcm: PixelData: JPEG Lossless pixels that can't be decoded"):
            read_radiographs(path)

    def hang(*args, **kwargs):
        raise subprocess.TimeoutExpired("child", kwargs["timeout"])

    monkeypatch.setattr(subprocess, "run", hang)
    with pytest.raises(RadiographError, match=r"^a.dcm: PixelData: JPEG Lossless took more than 120 s"):
        read_radiographs(path)


def test_the_child_limits_itself():
    resource = pytest.importorskip("resource", reason="limits of a process are set on Unix only")
    code = (
        "import resource\nfrom spinestiff.imaging.dicom.lossless import _limit\n_limit()\n"
        "print(*[resource.getrlimit(k)[0] for k in (resource.RLIMIT_AS, resource.RLIMIT_CPU, resource.RLIMIT_FSIZE)])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    space, seconds, written = map(int, done.stdout.split())
    assert 0 < space <= lossless.MOST_CHILD_BYTES and seconds <= lossless.MOST_SECONDS and written == 0
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] != 0


@pytest.mark.parametrize(("bits", "signed"), [(8, False), (12, False), (16, False), (12, True)])
def test_jpeg_lossless_by_gdcm_is_exact(file, campaign_module, bits, signed):
    gdcm = pytest.importorskip("gdcm", reason="JPEG Lossless needs the extra [dicom] (python-gdcm)")
    pixels = campaign_module.smooth(2, (40, 36), bits)

    def change(dataset: Dataset) -> None:
        dataset.BitsStored, dataset.HighBit = bits, bits - 1
        dataset.BitsAllocated = 8 if bits == 8 else 16
        dataset.PixelData = pixels.astype(np.uint8 if bits == 8 else np.uint16).tobytes()

    path = file(pixels, change=change)
    reader = gdcm.ImageReader()
    reader.SetFileName(str(path))
    assert reader.Read()
    changer = gdcm.ImageChangeTransferSyntax()
    changer.SetTransferSyntax(gdcm.TransferSyntax(gdcm.TransferSyntax.JPEGLosslessProcess14_1))
    changer.SetInput(reader.GetImage())
    assert changer.Change()
    writer = gdcm.ImageWriter()
    writer.SetFileName(str(path))
    writer.SetFile(reader.GetFile())
    writer.SetImage(changer.GetOutput())
    assert writer.Write()
    dataset = pydicom.dcmread(path)
    assert dataset.file_meta.TransferSyntaxUID == pydicom.uid.JPEGLosslessSV1
    dataset.PixelRepresentation = int(signed)
    dataset.save_as(path)
    wanted = pixels.astype(int)
    if signed:
        wanted[wanted >= 2 ** (bits - 1)] -= 2**bits
    np.testing.assert_array_equal([radiograph.pixels for radiograph in read_radiographs(path)], wanted)
