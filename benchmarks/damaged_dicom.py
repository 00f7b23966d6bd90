"""Are damaged DICOM files read rightly or refused in one line, whatever was done to them?

``python benchmarks/damaged_dicom.py [--files 5000] [--seed 0] [--write]``: ten small radiographs (CR, DX, RF, XA and
secondary capture; uncompressed in three byte orders, deflated, RLE, JPEG 2000, JPEG-LS, baseline JPEG; single and
multi-frame, 8 to 16 bits, signed, tables) are damaged in six ways

    cut       truncated anywhere
    bits      one to eight bits flipped anywhere
    header    one to four bytes overwritten before the pixels
    vr        the value representation of an element overwritten by another, or by letters
    lengths   the length of an element overwritten
    sizes     rows, columns, frames, bits, spacing or distances set to other values

and read in a child process under a time limit a file. A file is refused (one printable line that starts with its name),
read, or at fault: any other exception, a line of another form, a crash, more than the time limit, another size than
that of the pixels, an implausible spacing or distance. What was read is held against the sound file: same, or which of
its quantities changed without a reader being able to see it; these are counted.
"""

from __future__ import annotations

import argparse
import datetime
import json
import multiprocessing
import multiprocessing.connection
import struct
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pydicom
from jpeg_ls import encode_pixel_data
from openjpeg.utils import encode_array
from PIL import Image
from pydicom.dataset import Dataset
from pydicom.encaps import encapsulate
from pydicom.filebase import DicomBytesIO
from pydicom.sequence import Sequence

from spinestiff.errors import RadiographError
from spinestiff.imaging.projection import frontal_view, lateral_view
from spinestiff.imaging.radiograph import Radiograph, read_radiographs, write_radiographs

MOST_SECONDS = 10.0
WAYS = ("cut", "bits", "header", "vr", "lengths", "sizes")
# What any reader may call implausible, said here independently of the reader.
PITCH_MM = (0.02, 2.0)
DISTANCE_MM = (300.0, 10_000.0)
ODD = ("0", "1", "-1", "nan", "inf", "1e9", "0.0001", "", "x", "7", "64", "65535", "4\\4", "0.4\\nan", "0.01\\0.4")
NUMBERS = ("Rows", "Columns", "NumberOfFrames", "BitsAllocated", "BitsStored", "HighBit", "PixelRepresentation",
           "SamplesPerPixel")  # fmt: skip
TEXTS = ("ImagerPixelSpacing", "PixelSpacing", "DistanceSourceToDetector", "DistanceSourceToPatient", "NumberOfFrames",
         "RescaleSlope", "RescaleIntercept", "WindowWidth", "FrameTime", "PatientOrientation")  # fmt: skip
VRS = (b"US", b"UL", b"SQ", b"OB", b"OW", b"DS", b"IS", b"UN", b"FD", b"AT", b"??", b"\0\0")


class Seed(NamedTuple):
    """A sound file, and where its pixels begin."""

    name: str
    content: bytes
    header: int


class Judged(NamedTuple):
    """What became of a damaged file."""

    outcome: str  # refused, same, a list of what changed, or a fault that starts with "FAULT"
    detail: str


def smooth(count: int, shape: tuple[int, int], bits: int) -> np.ndarray:
    """(count, H, W) pixels that every codec keeps well enough: waves and a little noise."""
    random = np.random.default_rng(3)
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    waves = [0.5 + 0.35 * np.sin(rows / 7.0 + i) * np.cos(columns / 5.0) for i in range(count)]
    noisy = np.array(waves) + 0.01 * random.normal(size=(count, *shape))
    return np.round(np.clip(noisy, 0.0, 1.0) * (2**bits - 1)).astype(np.uint16)


def seeds() -> list[Seed]:
    """The sound files."""
    front = frontal_view(shape=(48, 40), pixel=(0.4, 0.42))
    side = lateral_view(shape=(48, 40), pixel=0.4)
    return [
        _seed("dx", front, 1, 16, "ExplicitVRLittleEndian"),
        _seed("rf", front, 3, 16, "ExplicitVRLittleEndian"),
        _seed("cr-implicit", front, 1, 10, "ImplicitVRLittleEndian", _calibrated, Modality="CR",
              PhotometricInterpretation="MONOCHROME1"),
        _seed("xa-big-endian", side, 2, 12, "ExplicitVRBigEndian", Modality="XA"),
        _seed("sc-deflated", front, 1, 8, "DeflatedExplicitVRLittleEndian", Modality="OT",
              SOPClassUID="1.2.840.10008.5.1.4.1.1.7"),
        _seed("rf-rle", front, 3, 16, "RLELossless"),
        _seed("dx-j2k", front, 2, 12, "JPEG2000Lossless"),
        _seed("cr-jpegls", front, 1, 12, "JPEGLSLossless", Modality="CR"),
        _seed("xa-jpeg", side, 3, 8, "JPEGBaseline8Bit", Modality="XA"),
        _seed("dx-tables", front, 1, 8, "ExplicitVRLittleEndian", _tables),
    ]  # fmt: skip


def _seed(
    name: str, view: Any, count: int, bits: int, syntax: str, change: Callable[[Dataset], None] | None = None,
    **values: Any,
) -> Seed:  # fmt: skip
    stream = BytesIO()
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path = Path(folder) / "seed.dcm"
        pixels = smooth(count, view.shape, bits)
        write_radiographs(path, pixels, view, frame_time_ms=40.0, acquisition_time="120000.5")
        dataset = pydicom.dcmread(path)
        dataset.BitsStored, dataset.HighBit = bits, bits - 1
        dataset.BitsAllocated = 8 if bits <= 8 else 16
        for keyword, value in values.items():
            setattr(dataset, keyword, value)
        if change is not None:
            change(dataset)
        code_pixels(dataset, pixels, syntax)
        little, implicit = syntax != "ExplicitVRBigEndian", syntax == "ImplicitVRLittleEndian"
        pydicom.dcmwrite(stream, dataset, implicit_vr=implicit, little_endian=little, force_encoding=True)
    content = stream.getvalue()
    # Deflated, there is no header to be told from pixels.
    tag = struct.pack("<HH" if little else ">HH", 0x7FE0, 0x0010)
    place = content.rfind(tag)
    return Seed(name, content, place if place > 0 else len(content))


def code_pixels(dataset: Dataset, pixels: np.ndarray, syntax: str) -> None:
    """Set the pixel data of a dataset, coded."""
    if dataset.BitsAllocated == 8:
        pixels = pixels.astype(np.uint8)
    coders: dict[str, Callable[[np.ndarray], bytes]] = {
        "JPEG2000Lossless": lambda frame: bytes(encode_array(frame, bits_stored=dataset.BitsStored)),
        "JPEGBaseline8Bit": _jpeg,
        "JPEGLSLossless": lambda frame: bytes(
            encode_pixel_data(
                frame.tobytes(), rows=frame.shape[0], columns=frame.shape[1], samples_per_pixel=1,
                bits_stored=dataset.BitsStored, bits_allocated=dataset.BitsAllocated,
                photometric_interpretation="MONOCHROME2", pixel_representation=0,
            )
        ),
    }  # fmt: skip
    dataset.file_meta.TransferSyntaxUID = getattr(pydicom.uid, syntax)
    if syntax == "RLELossless":
        dataset.file_meta.TransferSyntaxUID = pydicom.uid.ExplicitVRLittleEndian
        dataset.PixelData = pixels.tobytes()
        dataset.compress(pydicom.uid.RLELossless)
    elif syntax in coders:
        dataset.PixelData = encapsulate([coders[syntax](frame) for frame in pixels])
        dataset["PixelData"].VR = "OB"
    else:
        swapped = pixels.byteswap() if syntax == "ExplicitVRBigEndian" and dataset.BitsAllocated == 16 else pixels
        data = swapped.tobytes()
        dataset.PixelData = data + b"\0" * (len(data) % 2)
        dataset["PixelData"].VR = "OW" if dataset.BitsAllocated == 16 else "OB"


def _jpeg(frame: np.ndarray) -> bytes:
    stream = BytesIO()
    Image.fromarray(frame).save(stream, "JPEG", quality=95)
    return stream.getvalue()


def _calibrated(dataset: Dataset) -> None:
    del dataset.ImagerPixelSpacing
    dataset.PixelSpacing, dataset.PixelSpacingCalibrationType = ["0.36", "0.36"], "FIDUCIAL"


def _tables(dataset: Dataset) -> None:
    for keyword in ("RescaleSlope", "RescaleIntercept", "RescaleType"):
        delattr(dataset, keyword)
    for keyword, curve in (("ModalityLUTSequence", 1.0), ("VOILUTSequence", 2.0)):
        item = Dataset()
        item.add_new("LUTDescriptor", "US", [256, 0, 16])
        table = np.round(65535 * np.linspace(0.0, 1.0, 256) ** curve).astype("<u2")
        item.add_new("LUTData", "OW", table.tobytes())
        setattr(dataset, keyword, Sequence([item]))


def damaged(seed: Seed, way: str, random: np.random.Generator) -> bytes:
    """A copy of a sound file, damaged."""
    content = bytearray(seed.content)
    if way == "cut":
        return bytes(content[: random.integers(len(content))])
    if way == "bits":
        for place in random.integers(len(content), size=random.integers(1, 9)):
            content[place] ^= 1 << int(random.integers(8))
    elif way == "header":
        for place in random.integers(132, seed.header, size=random.integers(1, 5)):
            content[place] = int(random.integers(256))
    elif way in ("vr", "lengths"):
        # Elements start with a group and an element number, then two letters.
        places = _elements(content, seed.header)
        if not places:
            return damaged(seed, "bits", random)
        at = places[int(random.integers(len(places)))]
        if way == "vr":
            content[at + 4 : at + 6] = VRS[int(random.integers(len(VRS)))]
        else:
            content[at + 6 : at + 8] = random.integers(256, size=2, dtype=np.uint8).tobytes()
    else:
        return _lying(seed, random)
    return bytes(content)


def _elements(content: bytearray, end: int) -> list[int]:
    known = (
        b"AE",
        b"AS",
        b"CS",
        b"DA",
        b"DS",
        b"IS",
        b"LO",
        b"OB",
        b"OW",
        b"PN",
        b"SH",
        b"SQ",
        b"TM",
        b"UI",
        b"UL",
        b"US",
    )
    return [at for at in range(132, end - 8) if bytes(content[at + 4 : at + 6]) in known]


def _lying(seed: Seed, random: np.random.Generator) -> bytes:
    """Other values in elements that are well-formed."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        dataset = pydicom.dcmread(BytesIO(seed.content))
        sound = {keyword: int(dataset.get(keyword) or 1) for keyword in NUMBERS}
        for _ in range(random.integers(1, 3)):
            if random.random() < 0.6:
                keyword = str(random.choice(NUMBERS))
                was = sound[keyword]
                values = [0, 1, 2, 7, 8, 12, 16, was - 1, was + 1, 2 * was, was // 2, 65535, random.integers(65536)]
                dataset.pop(keyword, None)
                vr = "IS" if keyword == "NumberOfFrames" else "US"
                dataset.add_new(keyword, vr, max(int(values[int(random.integers(len(values)))]), 0))
            else:
                keyword = str(random.choice(TEXTS))
                dataset.pop(keyword, None)
                value = ODD[int(random.integers(len(ODD)))]
                dataset.add_new(keyword, "LO", value.split("\\"))
        stream = DicomBytesIO()
        syntax = dataset.file_meta.TransferSyntaxUID
        try:
            pydicom.dcmwrite(stream, dataset, implicit_vr=syntax.is_implicit_VR, little_endian=syntax.is_little_endian,
                             force_encoding=True)  # fmt: skip
        except Exception:  # the writer refuses this lie; tell another
            return _lying(seed, random)
    return stream.getvalue()


def quantities(radiographs: tuple[Radiograph, ...]) -> dict[str, Any]:
    """What is compared with the sound file."""
    view = radiographs[0].view
    return {
        "pixels": np.stack([radiograph.pixels for radiograph in radiographs]),
        "spacing": view.pixel_spacing,
        "distances": np.array([view.source_to_detector, view.source_to_patient]),
        "orientation": np.concatenate([view.detector_axes, [view.normal]]),
        "times": np.array([np.nan if r.time_s is None else r.time_s for r in radiographs]),
    }


def judged(path: Path, sound: dict[str, Any]) -> Judged:
    """What the reader makes of a file."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            radiographs = read_radiographs(path)
    except RadiographError as refusal:
        line = str(refusal)
        fit = line.startswith(f"{path.name}: ") and line.isprintable() and len(line) < 250
        return Judged("refused" if fit else "FAULT: a refusal of another form", line)
    except BaseException as problem:
        return Judged("FAULT: traceback", f"{type(problem).__name__}: {problem}")
    found = quantities(radiographs)
    if found["pixels"].shape != sound["pixels"].shape:
        return Judged("FAULT: size disagrees with the pixels", str(found["pixels"].shape))
    pitch, far = found["spacing"], found["distances"]
    if not (PITCH_MM[0] <= pitch.min() and pitch.max() <= PITCH_MM[1] and far.max() <= DISTANCE_MM[1]
            and far.min() >= DISTANCE_MM[0] and far[1] < far[0]):  # fmt: skip
        return Judged("FAULT: implausible millimetres", f"{pitch} {far}")
    other = [key for key in sound if not np.array_equal(found[key], sound[key], equal_nan=True)]
    return Judged(" and ".join(other) or "same", "")


def _serve(connection: multiprocessing.connection.Connection, sounds: dict[str, dict[str, Any]]) -> None:
    while True:
        path, name = connection.recv()
        began = time.perf_counter()
        verdict = judged(Path(path), sounds[name])
        connection.send((verdict, time.perf_counter() - began))


def campaign(files: int, seed: int) -> Iterator[tuple[str, str, Judged, float]]:
    """Seed's name, way, verdict and seconds of each damaged file."""
    sound = seeds()
    random = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "damaged.dcm"
        sounds = {}
        for one in sound:
            path.write_bytes(one.content)
            sounds[one.name] = quantities(read_radiographs(path))
        child = _Child(sounds)
        for number in range(files):
            one, way = sound[number % len(sound)], WAYS[number // len(sound) % len(WAYS)]
            path.write_bytes(damaged(one, way, random))
            yield one.name, way, *child.ask(path, one.name)
        child.end()


class _Child:
    """The process that reads; a new one after a crash or a hang."""

    def __init__(self, sounds: dict[str, dict[str, Any]]) -> None:
        self.sounds = sounds
        self.start()

    def start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, other = context.Pipe()
        self.process = context.Process(target=_serve, args=(other, self.sounds), daemon=True)
        self.process.start()
        other.close()

    def end(self) -> None:
        self.process.kill()
        self.process.join()

    def ask(self, path: Path, name: str) -> tuple[Judged, float]:
        self.connection.send((str(path), name))
        # The first answer waits for the imports.
        if not self.connection.poll(MOST_SECONDS + 20.0):
            self.end()
            self.start()
            return Judged("FAULT: hang", ""), MOST_SECONDS
        try:
            verdict, seconds = self.connection.recv()
        except EOFError:
            self.end()
            code = self.process.exitcode
            self.start()
            return Judged("FAULT: crash", f"exit status {code}"), 0.0
        return (Judged("FAULT: hang", f"{seconds:.1f} s") if seconds > MOST_SECONDS else verdict), seconds


def summary(rows: list[tuple[str, str, Judged, float]]) -> dict[str, Any]:
    """Counts of outcomes, by way and by seed, and the longest time."""
    outcomes = Counter(verdict.outcome for _, _, verdict, _ in rows)
    unseen = {key: n for key, n in outcomes.items() if key not in ("refused", "same") and not key.startswith("FAULT")}
    return {
        "files": len(rows),
        "refused": outcomes["refused"],
        "read, as the sound file": outcomes["same"],
        "read, with a change that no reader can see": sum(unseen.values()),
        "of these in": dict(sorted(unseen.items(), key=lambda item: -item[1])),
        "faults": {key: n for key, n in outcomes.items() if key.startswith("FAULT")},
        "refused by way": _shares(rows, 1),
        "refused by file": _shares(rows, 0),
        "longest seconds": round(max(seconds for *_, seconds in rows), 3),
        "mean milliseconds": round(1000.0 * float(np.mean([seconds for *_, seconds in rows])), 2),
        "refusals worded": len({verdict.detail.partition(": ")[2] for _, _, verdict, _ in rows if verdict.detail}),
        "unforeseen refusals": sum("damaged or unsupported DICOM" in verdict.detail for _, _, verdict, _ in rows),
    }


def _shares(rows: list[tuple[str, str, Judged, float]], key: int) -> dict[str, str]:
    names = dict.fromkeys(str(row[key]) for row in rows)
    of = {name: [row[2].outcome == "refused" for row in rows if row[key] == name] for name in names}
    return {name: f"{sum(refused)} of {len(refused)}" for name, refused in of.items()}


def main() -> None:
    """Run the campaign and print what came out."""
    parser = argparse.ArgumentParser(description="damaged DICOM files against the reader")
    parser.add_argument("--files", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--write", action="store_true", help="store the figures in results/damaged_dicom.json")
    options = parser.parse_args()
    rows = list(campaign(options.files, options.seed))
    found = {"date": datetime.date.today().isoformat(), "seed": options.seed, **summary(rows)}
    print(json.dumps(found, indent=1))
    for name, way, verdict, _ in rows:
        if verdict.outcome.startswith("FAULT"):
            print(name, way, *verdict)
    if options.write:
        path = Path(__file__).parent / "results" / "damaged_dicom.json"
        path.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
