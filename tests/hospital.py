"""Radiographs as a hospital exports them: nested folders, names without meaning, headers of a patient and a study."""

from __future__ import annotations

import warnings
import zlib
from pathlib import Path

import cv2
import numpy as np
import pydicom

from spinestiff.imaging.projection import frontal_view, lateral_view
from spinestiff.imaging.radiograph import write_radiographs

SHAPE = (192, 160)
CANARY = "DOE^JANE"
DAY = "20250612"


def texture(seed: int = 0, shape: tuple[int, int] = SHAPE) -> np.ndarray:
    """(H, W) float32, smooth on the scale of some pixels."""
    noise = np.random.default_rng(seed).standard_normal(shape).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 3.0)
    return 20_000.0 + 8_000.0 * smooth / float(np.abs(smooth).max())


def shifted(pixels: np.ndarray, columns: float) -> np.ndarray:
    """The picture with everything moved along the columns."""
    move = np.array([[1.0, 0.0, columns], [0.0, 1.0, 0.0]], np.float32)
    return cv2.warpAffine(pixels, move, pixels.shape[::-1], flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)


def export(
    path: Path,
    kind: str = "frontal",
    frames: int = 1,
    *,
    patient: str = "P1",
    study: str = "1.2.1",
    series: str | None = None,
    time: str | None = "101500",
    pixels: np.ndarray | None = None,
    without: tuple[str, ...] = (),
    **tags: object,
) -> Path:
    """Write a radiograph; each path has a picture, an instance and, if none is given, a series of its own."""
    path.parent.mkdir(parents=True, exist_ok=True)
    view = (frontal_view if kind == "frontal" else lateral_view)(shape=SHAPE if pixels is None else pixels.shape[1:])
    own = zlib.crc32(str(path).encode())
    if pixels is None:
        pixels = np.stack([shifted(texture(own), 2.0 * i) for i in range(frames)])
    write_radiographs(path, np.clip(pixels, 0, 65535).astype(np.uint16), view, frame_time_ms=250.0)
    return headed(path, path, patient=patient, study=study, series=series, time=time, without=without, **tags)


def headed(
    source: Path,
    path: Path,
    *,
    patient: str = "P1",
    study: str = "1.2.1",
    series: str | None = None,
    time: str | None = "101500",
    without: tuple[str, ...] = (),
    **tags: object,
) -> Path:
    """A radiograph with the header of a hospital's patient and study, as ``path``: an instance and, if none is given, a
    series of its own.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    own = zlib.crc32(str(path).encode())
    dataset = pydicom.dcmread(source)
    dataset.PatientID, dataset.PatientName, dataset.StudyInstanceUID = patient, CANARY, study
    dataset.SeriesInstanceUID, dataset.SOPInstanceUID = series or f"1.2.3.{own}", f"1.2.4.{own}"
    dataset.PatientIdentityRemoved = ""
    if time is not None:
        dataset.AcquisitionDate, dataset.AcquisitionTime = DAY, time
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for keyword, value in tags.items():
            setattr(dataset, keyword, value)
    for keyword in without:
        delattr(dataset, keyword)
    dataset.save_as(path)
    return path


def disc(folder: Path) -> Path:
    """A whole export of one study: two rest radiographs, a push of three frames and one of two, and what else lies on
    a disc.
    """
    inside = folder / "DICOM" / "PA000001" / "ST000001"
    export(inside / "SE000003" / "IM000001", time="101500")
    export(inside / "SE000004" / "IM000001", "lateral", time="101630")
    export(inside / "SE000007" / "IM000001", frames=3, time="102200")
    export(inside / "SE000008" / "IM000001", frames=2, time="102800")
    (folder / "autorun.inf").write_text("[autorun]", encoding="utf-8")
    (folder / "VIEWER").mkdir()
    for number in range(5):
        (folder / "VIEWER" / f"lib{number}.dll").write_bytes(b"MZ" * 100)
    ct = export(inside / "SE000011" / "IM000001")
    dataset = pydicom.dcmread(ct)
    dataset.Modality = "CT"
    dataset.save_as(ct)
    return folder


def gauged(folder: Path) -> np.ndarray:
    """An export in ``in`` with a push of 30 frames at 4 a second, its first frame 3.1 s after the start of the log
    ``gauge.csv``; gives the frames' true forces.
    """
    start = 3.1
    rng = np.random.default_rng(0)
    times = np.arange(0.0, 16.0, 0.02)
    forces = np.interp(times, [0.0, 4.5, 7.5, 11.0, 12.5], [0.0, 0.0, 58.0, 58.0, 0.0])
    picture = texture(5)
    seen = [shifted(picture, 0.15 * np.interp(start + i / 4.0, times, forces)) for i in range(30)]
    noisy = np.stack([one + 150.0 * rng.standard_normal(one.shape) for one in seen])
    export(folder / "in" / "x" / "I7", frames=30, pixels=noisy)
    export(folder / "in" / "x" / "I2")
    path = folder / "gauge.csv"
    rows = [f"{1000 * t:.0f};{(f + 0.1 * rng.standard_normal()) / 9.80665:.4f}".replace(".", ",")
            for t, f in zip(times, forces)]  # fmt: skip
    path.write_text("\n".join(["Time (ms);Load (kgf)", *rows]), encoding="utf-8")
    return np.interp(start + np.arange(30) / 4.0, times, forces)


def trunk(view: str, shape: tuple[int, int] = SHAPE) -> np.ndarray:
    """(1, H, W) what a trunk shows, drawn: shoulders, waist and belly, lungs beside a bright band or in one field."""
    rows, columns = (np.indices(shape) + 0.5) / np.array(shape)[:, None, None] - 0.5
    width = (0.48 if view == "frontal" else 0.27) * (0.9 + 0.1 * np.cos(4.0 * np.pi * rows))
    picture = np.sqrt(np.clip(1.0 - (columns / width) ** 2, 0.0, 1.0))
    for place in (-0.22, 0.22) if view == "frontal" else (0.0,):
        picture *= 1.0 - 0.6 * np.exp(-(((columns - place) / 0.09) ** 4) - ((rows + 0.1) / 0.2) ** 4)
    return 4000.0 + 40_000.0 * cv2.GaussianBlur(picture, (0, 0), 1.5)[None]
