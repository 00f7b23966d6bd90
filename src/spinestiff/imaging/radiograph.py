"""Radiographs from and to DICOM, with millimetres that are never guessed (paper 2.1).

DICOM's patient axes are LPS: x to the patient's left, y posterior, z superior. The world of this package is x left,
y superior, z anterior; ``lps_from_world`` is the one place where the two meet. A radiograph doesn't say where the
patient stood, so a view is placed with its principal ray through a given ``centre`` and the image's middle.
"""

from __future__ import annotations

import contextlib
import datetime
import hashlib
import logging
import math
import re
import struct
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spinestiff.arrays import Floats, read_only
from spinestiff.errors import RadiographError
from spinestiff.imaging.projection import XRayView, placed_view

if TYPE_CHECKING:
    from pydicom.dataset import Dataset
    from pydicom.uid import UID

MODALITIES = ("CR", "DX", "RF", "XA", "OT")
MOST_PIXELS_A_SIDE = 8192
MOST_FRAMES = 128
MOST_BYTES = 512 * 1024**2
LARGEST_PIXEL_MM = 2.0
AGREEMENT = 0.01  # relative difference up to which the file and the given geometry agree

_DEFLATED = "1.2.840.10008.1.2.1.99"
_RLE = "1.2.840.10008.1.2.5"
_RF_STORAGE = "1.2.840.10008.5.1.4.1.1.12.2"
_DX_STORAGE = "1.2.840.10008.5.1.4.1.1.1.1"
# Signs of LPS directions by letter (PatientOrientation).
_LETTERS = {"L": (1, 0, 0), "R": (-1, 0, 0), "P": (0, 1, 0), "A": (0, -1, 0), "H": (0, 0, 1), "F": (0, 0, -1)}
_BEAMS = {"AP": "P", "PA": "A", "LL": "L", "RL": "R"}  # where the beam of a ViewPosition goes to


@dataclass(frozen=True)
class Geometry:
    """What a file may lack; a value that contradicts the file by more than 1 % is refused.

    Attributes
    ----------
    source_detector_mm, source_patient_mm : distances along the detector's normal.
    imager_pixel_mm : pixel pitch at the detector.
    view : which side is seen, for files without PatientOrientation.
    """

    source_detector_mm: float | None = None
    source_patient_mm: float | None = None
    imager_pixel_mm: float | None = None
    view: Literal["frontal", "lateral"] | None = None


@dataclass(frozen=True)
class Radiograph:
    """One picture with its geometry.

    Attributes
    ----------
    pixels : (H, W) float32, bone bright.
    view : the X-ray view it was taken in.
    source : name of the file.
    sha256 : of the file.
    frame : index in its file or folder, from 0.
    time_s : since the first frame; None if the file doesn't tell.
    provenance : where the millimetres, the directions and the grey values came from.
    """

    pixels: NDArray[np.float32]
    view: XRayView
    source: str = ""
    sha256: str = ""
    frame: int = 0
    time_s: float | None = None
    provenance: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        pixels = read_only("pixels", self.pixels, self.view.shape, RadiographError, np.float32)
        object.__setattr__(self, "pixels", pixels)
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))


def lps_from_world(vectors: ArrayLike) -> Floats:
    """DICOM patient coordinates (left, posterior, superior) of world vectors (left, superior, anterior), (..., 3)."""
    v = np.asarray(vectors, dtype=float)
    return np.stack([v[..., 0], -v[..., 2], v[..., 1]], axis=-1)


def world_from_lps(vectors: ArrayLike) -> Floats:
    """Inverse of ``lps_from_world``."""
    v = np.asarray(vectors, dtype=float)
    return np.stack([v[..., 0], v[..., 2], -v[..., 1]], axis=-1)


def read_radiographs(
    path: str | Path, *, geometry: Geometry | None = None, centre: ArrayLike = (0.0, 200.0, 0.0)
) -> tuple[Radiograph, ...]:
    """The frames of a DICOM file, or of a folder of single-frame files, in order of time.

    Parameters
    ----------
    path : file or folder. In a folder the ``.dcm`` files are taken, or all files if there are none.
    geometry : what the files lack.
    centre : (3,) mm, the world point that the principal ray passes in the patient plane.

    Raises
    ------
    RadiographError : whatever is wrong with a file, in one line with its name.
    """
    path, given = Path(path), geometry or Geometry()
    if path.is_dir():
        return _read_folder(path, given, centre)
    return tuple(picture.radiograph for picture in _read_file(path, given, centre))


def write_radiographs(
    path: str | Path,
    pixels: ArrayLike,
    view: XRayView,
    *,
    frame_time_ms: float | Sequence[float] = 100.0,
    orientation: tuple[str, str] | None = None,
    patient_id: str = "synthetic",
    description: str = "",
    instance_number: int = 1,
    acquisition_time: str | None = None,
    kvp: float = 71.0,
) -> None:
    """Write uncompressed 16-bit DICOM: X-Ray Radiofluoroscopic for a series, Digital X-Ray for one frame.

    Parameters
    ----------
    pixels : (F, H, W) or (H, W) uint16, bone bright.
    view : its principal point must be the image's middle, as reading assumes.
    frame_time_ms : between frames, or the F increments (the first is 0).
    orientation : PatientOrientation, e.g. ("L", "F"); from the view if None.
    acquisition_time : "HHMMSS.ffffff".

    Unique identifiers are made from ``patient_id``, ``description``, ``instance_number`` and the pixels, so the same
    call writes the same bytes.

    Raises
    ------
    RadiographError : pixels that don't fit the view; a file that can't be written.
    """
    frames = np.asarray(pixels)
    frames = frames[None] if frames.ndim == 2 else frames
    if frames.dtype != np.uint16 or frames.shape[1:] != view.shape or not len(frames):
        wanted = f"(F, {view.shape[0]}, {view.shape[1]}) uint16"
        raise RadiographError(f"pixels are {frames.shape} {frames.dtype}, wanted {wanted}")
    middle = 0.5 * (np.array(view.shape[::-1]) - 1.0) * view.pixel_spacing
    if np.abs(view.principal_point - middle).max() > 0.5 * view.pixel_spacing.max():
        raise RadiographError("the view's principal point is off the image's middle; DICOM has no place for it")
    letters = orientation or (_letter(view.detector_axes[0]), _letter(view.detector_axes[1]))
    dataset = _new_dataset(frames, view, patient_id, description, instance_number)
    dataset.PatientOrientation = list(letters)
    beam = _letter(view.normal)
    dataset.ViewPosition = {towards: name for name, towards in _BEAMS.items()}.get(beam, "")
    dataset.KVP = f"{kvp:g}"
    if acquisition_time is not None:
        dataset.AcquisitionTime = acquisition_time
    if len(frames) > 1:
        _write_times(dataset, frame_time_ms, len(frames))
    try:
        dataset.save_as(Path(path), enforce_file_format=True)
    except OSError as problem:
        raise RadiographError(f"{Path(path).name}: can't be written ({problem.strerror})") from None


# Reading: one file


@dataclass(frozen=True)
class _Picture:
    """A frame with what ordering a folder needs."""

    radiograph: Radiograph
    clock_s: float | None
    instance: int | None


@dataclass(frozen=True)
class _Layout:
    """How the pixel data are stored, checked."""

    frames: int
    rows: int
    columns: int
    allocated: int
    stored: int
    signed: bool


def _read_file(path: Path, given: Geometry, centre: ArrayLike) -> list[_Picture]:
    # The one place where tags are touched: pydicom raises all sorts, at any access. Its messages may quote patient
    # data, so only the kind of problem is passed on.
    try:
        with _quiet():
            return _pictures(path, given, centre)
    except RadiographError as problem:
        raise RadiographError(f"{path.name}: {problem}") from None
    except FileNotFoundError:
        raise RadiographError(f"{path.name}: no such file") from None
    except OSError as problem:
        raise RadiographError(f"{path.name}: can't be opened ({problem.strerror or type(problem).__name__})") from None
    except Exception as problem:
        raise RadiographError(
            f"{path.name}: damaged or unsupported DICOM ({type(problem).__name__}); export it again, uncompressed"
        ) from None


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """No warnings or log lines of the DICOM library: they quote the file's values, patient data too."""
    logger = logging.getLogger("pydicom")
    was = logger.disabled
    logger.disabled = True
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.disabled = was


def _pictures(path: Path, given: Geometry, centre: ArrayLike) -> list[_Picture]:
    if path.stat().st_size > MOST_BYTES + 2**20:
        raise RadiographError(f"{path.stat().st_size / 2**20:.0f} MB; at most {MOST_BYTES // 2**20} MB are read")
    content = path.read_bytes()
    dataset = _dataset(path, content)
    layout = _checked_layout(dataset)
    view, provenance = _placed(dataset, layout, given, centre)
    pixels, provenance["grey values"] = _bone_bright(dataset, layout)
    times, clock = _frame_times(dataset, layout.frames), _clock(dataset)
    instance = _number(dataset, "InstanceNumber")
    sha256 = hashlib.sha256(content).hexdigest()
    return [
        _Picture(
            Radiograph(pixels[i], view, path.name, sha256, i, times[i], provenance),
            clock,
            None if instance is None else int(instance),
        )
        for i in range(layout.frames)
    ]


def _dataset(path: Path, content: bytes) -> Dataset:
    from pydicom import dcmread
    from pydicom.errors import InvalidDicomError
    from pydicom.filereader import read_file_meta_info

    if not content:
        raise RadiographError("the file is empty")
    try:
        meta = read_file_meta_info(path)
    except InvalidDicomError:
        raise RadiographError("no DICOM file (its header is missing); export the radiograph as DICOM Part 10") from None
    if meta.get("TransferSyntaxUID") == _DEFLATED:
        raise RadiographError("deflated DICOM isn't read, since its size can't be checked; export it uncompressed")
    return dcmread(BytesIO(content))


def _checked_layout(dataset: Dataset) -> _Layout:
    modality = _code(dataset, "Modality")
    if modality not in MODALITIES:
        named = f"modality {modality}" if modality else "no modality"
        raise RadiographError(f"{named} is no projection radiograph; wanted one of {', '.join(MODALITIES)}")
    if "PixelData" not in dataset:
        raise RadiographError("no picture in it (PixelData is missing); is the file complete?")
    photometric = _code(dataset, "PhotometricInterpretation")
    if _integer(dataset, "SamplesPerPixel", 1) != 1 or not photometric.startswith("MONOCHROME"):
        raise RadiographError(f"colour picture ({photometric or 'unknown'}); export the original, no screenshot")
    layout = _Layout(
        frames=_integer(dataset, "NumberOfFrames", 1),
        rows=_integer(dataset, "Rows"),
        columns=_integer(dataset, "Columns"),
        allocated=_integer(dataset, "BitsAllocated"),
        stored=_integer(dataset, "BitsStored"),
        signed=bool(_integer(dataset, "PixelRepresentation", 0)),
    )
    size = f"{layout.frames} frames of {layout.rows} x {layout.columns}"
    if min(layout.frames, layout.rows, layout.columns) < 1:
        raise RadiographError(f"declares {size}; wanted at least one pixel")
    if max(layout.rows, layout.columns) > MOST_PIXELS_A_SIDE or layout.frames > MOST_FRAMES:
        most = f"{MOST_FRAMES} frames of {MOST_PIXELS_A_SIDE} x {MOST_PIXELS_A_SIDE}"
        raise RadiographError(f"declares {size}; at most {most}")
    if layout.allocated not in (8, 16) or not 0 < layout.stored <= layout.allocated:
        raise RadiographError(f"{layout.stored} bits stored in {layout.allocated}; wanted 8 or 16 bits a pixel")
    if _integer(dataset, "HighBit", layout.stored - 1) != layout.stored - 1:
        raise RadiographError(f"high bit other than the last of {layout.stored} bits stored; export it again")
    count = layout.frames * layout.rows * layout.columns * layout.allocated // 8
    if count > MOST_BYTES:
        raise RadiographError(f"declares {size}, {count / 2**20:.0f} MB; at most {MOST_BYTES // 2**20} MB are read")
    _check_pixel_data(dataset, layout, count)
    return layout


def _check_pixel_data(dataset: Dataset, layout: _Layout, count: int) -> None:
    """Before any decoding: is it all there, and does each coded frame have the size that the file declares?"""
    if not dataset.file_meta.TransferSyntaxUID.is_compressed:
        there = len(dataset.PixelData)
        if there < count:
            raise RadiographError(f"pixel data cut short: {there} of {count} bytes; copy the file again")
        return
    if dataset.file_meta.TransferSyntaxUID == _RLE:
        return  # grows to the declared size at most
    from pydicom.encaps import generate_frames

    for frame in generate_frames(dataset.PixelData, number_of_frames=layout.frames):
        rows, columns, components = _coded_size(frame)
        if (rows, columns) != (layout.rows, layout.columns):
            declared = f"{layout.rows} x {layout.columns} is declared"
            raise RadiographError(f"a coded frame is {rows} x {columns}, but {declared}")
        if components != 1:
            raise RadiographError(f"a coded frame has {components} colours; export the original, no screenshot")


def _coded_size(frame: bytes) -> tuple[int, int, int]:
    """Rows, columns and components in the header of a JPEG 2000, JPEG-LS or JPEG stream."""
    if frame[:2] != b"\xff\xd8":
        start = frame.find(b"\xff\x4f\xff\x51")
        if start < 0:
            raise RadiographError("a coded frame has no known header; export it uncompressed")
        right, bottom, left, top = struct.unpack(">4I", frame[start + 8 : start + 24])
        return bottom - top, right - left, struct.unpack(">H", frame[start + 40 : start + 42])[0]
    at = 2
    while at + 10 <= len(frame) and frame[at] == 0xFF:
        marker, length = frame[at + 1], struct.unpack(">H", frame[at + 2 : at + 4])[0]
        if marker == 0xF7 or (0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC)):
            return *struct.unpack(">2H", frame[at + 5 : at + 9]), frame[at + 9]
        at += 2 + length
    raise RadiographError("a coded frame has no size in its header; export it uncompressed")


def _bone_bright(dataset: Dataset, layout: _Layout) -> tuple[NDArray[np.float32], str]:
    """(F, H, W) and how bone was made bright."""
    stored = _decoded(dataset).reshape(layout.frames, layout.rows, layout.columns)
    # What lies above the stored bits (old overlays) goes; the sign comes back by the same shift.
    unused = stored.dtype.itemsize * 8 - layout.stored
    if unused:
        stored = (stored << unused) >> unused
    slope, intercept = _number(dataset, "RescaleSlope", 1.0), _number(dataset, "RescaleIntercept", 0.0)
    if not slope:
        raise RadiographError("RescaleSlope is 0")
    pixels = stored.astype(np.float32)
    photometric = _code(dataset, "PhotometricInterpretation")
    sign = _number(dataset, "PixelIntensityRelationshipSign")
    # Sign -1: larger values mean less beam, which is bone bright whatever the display makes of it.
    inverted = photometric == "MONOCHROME1" if sign is None else sign > 0
    how = photometric if sign is None else f"PixelIntensityRelationshipSign {sign:+.0f}"
    if inverted:
        ends = -1 if layout.signed else 2**layout.stored - 1
        pixels = np.float32(ends) - pixels
    if (slope, intercept) != (1.0, 0.0):
        pixels = np.float32(slope) * pixels + np.float32(intercept)
        how += f", rescaled by {slope:g} and {intercept:g}"
    return pixels, how + (", inverted" if inverted else "")


def _decoded(dataset: Dataset) -> NDArray[Any]:
    from pydicom.uid import UID

    syntax = UID(dataset.file_meta.TransferSyntaxUID)
    try:
        return np.asarray(dataset.pixel_array)
    except (NotImplementedError, RuntimeError, AttributeError, ImportError):
        raise RadiographError(
            f"its pixels ({_syntax_name(syntax)}) can't be decoded; export it uncompressed, "
            "or install python-gdcm for JPEG Lossless"
        ) from None


def _syntax_name(syntax: UID) -> str:
    return syntax.name if syntax.is_transfer_syntax else "unknown transfer syntax"


# Reading: millimetres and directions


def _placed(dataset: Dataset, layout: _Layout, given: Geometry, centre: ArrayLike) -> tuple[XRayView, dict[str, str]]:
    provenance: dict[str, str] = {}
    detector, provenance["source to detector"] = _distance(
        dataset, "DistanceSourceToDetector", given.source_detector_mm, "source_detector_mm"
    )
    patient, provenance["source to patient"] = _distance(
        dataset, "DistanceSourceToPatient", given.source_patient_mm, "source_patient_mm"
    )
    if patient >= detector:
        raise RadiographError(f"source to patient {patient:g} mm is not below source to detector {detector:g} mm")
    (row_mm, column_mm), provenance["pixel spacing"] = _spacing(dataset, given, detector / patient)
    columns, rows, beam, provenance["orientation"], provenance["beam"] = _directions(dataset, given)
    view = placed_view(
        columns, rows, beam,
        sid=detector, source_to_patient=patient, shape=(layout.rows, layout.columns),
        pixel=(column_mm, row_mm), centre=centre,
    )  # fmt: skip
    return view, provenance


def _distance(dataset: Dataset, keyword: str, given: float | None, key: str) -> tuple[float, str]:
    tag = _number(dataset, keyword)
    if tag is None and given is None:
        raise RadiographError(f"no {keyword}; add {key} to subject.json, as read at the X-ray system")
    if tag is not None and given is not None:
        _check_agreement(keyword, tag, key, given)
    value = float(tag if tag is not None else given)  # type: ignore[arg-type]
    if not 300.0 <= value <= 10000.0:
        raise RadiographError(f"{keyword} {value:g} mm; wanted 300 to 10000 (in mm)")
    return value, f"DICOM {keyword}" if tag is not None else f"given {key}"


def _spacing(dataset: Dataset, given: Geometry, magnification: float) -> tuple[tuple[float, float], str]:
    """(Between rows, between columns) mm at the detector, and where they came from."""
    tag = _spacing_tag(dataset, "ImagerPixelSpacing")
    pixel = given.imager_pixel_mm
    if tag is not None:
        if pixel is not None:
            for value in tag:
                _check_agreement("ImagerPixelSpacing", value, "imager_pixel_mm", pixel)
        return tag, "DICOM ImagerPixelSpacing, at the detector"
    calibrated = _spacing_tag(dataset, "PixelSpacing")
    kind = _code(dataset, "PixelSpacingCalibrationType")
    if calibrated is not None and kind in ("GEOMETRY", "FIDUCIAL"):
        at_detector = (calibrated[0] * magnification, calibrated[1] * magnification)
        if pixel is not None:
            for value in at_detector:
                _check_agreement("PixelSpacing times the magnification", value, "imager_pixel_mm", pixel)
        return at_detector, f"DICOM PixelSpacing, calibrated by {kind} at the patient plane, times the magnification"
    if pixel is not None:
        _check_spacing("imager_pixel_mm", pixel)
        return (pixel, pixel), "given imager_pixel_mm, at the detector"
    found = "PixelSpacing doesn't say for which plane" if calibrated is not None else "no ImagerPixelSpacing"
    raise RadiographError(f"{found}; add imager_pixel_mm (pixel pitch at the detector) to subject.json")


def _spacing_tag(dataset: Dataset, keyword: str) -> tuple[float, float] | None:
    values = dataset.get(keyword)
    if values is None or (isinstance(values, str) and not values.strip()):
        return None
    if isinstance(values, (str, float, int)) or len(values) != 2:
        raise RadiographError(f"{keyword} isn't two numbers")
    row, column = (_as_number(keyword, value) for value in values)
    _check_spacing(keyword, row)
    _check_spacing(keyword, column)
    return row, column


def _check_spacing(what: str, value: float) -> None:
    if not 0.0 < value <= LARGEST_PIXEL_MM:
        raise RadiographError(f"{what} {value:g} mm; wanted above 0 and at most {LARGEST_PIXEL_MM:g}")


def _check_agreement(what: str, value: float, key: str, given: float) -> None:
    if not math.isfinite(given) or abs(value - given) > AGREEMENT * abs(value):
        raise RadiographError(f"{what} is {value:g} mm, but subject.json gives {key} {given:g} mm; correct that value")


def _directions(dataset: Dataset, given: Geometry) -> tuple[Floats, Floats, Floats, str, str]:
    """World directions of growing columns, growing rows and the beam, and where they came from."""
    column, row, source = _orientation(dataset, given)
    frontal = column in "LR"
    position = _code(dataset, "ViewPosition")
    towards = _BEAMS.get(position)
    if towards is not None and (towards in "AP") == frontal:
        beam, beam_source = towards, f"DICOM ViewPosition {position}"
    else:
        beam, beam_source = ("P", "assumed anterior to posterior") if frontal else ("L", "assumed right to left")
    letters = (column, row, beam)
    axes = [world_from_lps(_LETTERS[letter]) + 0.0 for letter in letters]
    return axes[0], axes[1], axes[2], source, beam_source


def _orientation(dataset: Dataset, given: Geometry) -> tuple[str, str, str]:
    tag = dataset.get("PatientOrientation")
    if given.view not in (None, "frontal", "lateral"):
        raise RadiographError(f"view '{given.view}'; wanted frontal or lateral")
    if not tag or len(tag) != 2 or not all(str(part).strip() for part in tag):
        if given.view is None:
            raise RadiographError(
                "no PatientOrientation; if the image is shown as usual, add xray.orientation 'standard' to subject.json"
            )
        assumed = ("L", "F") if given.view == "frontal" else ("A", "F")
        return *assumed, f"given view {given.view}, columns taken to grow to {assumed[0]}, rows to {assumed[1]}"
    column, row = (_plain(part)[:1] for part in tag)
    if column not in tuple("LRAP") or row not in tuple("HF"):
        raise RadiographError(f"PatientOrientation {column}\\{row}: not upright; columns must go to L, R, A or P")
    shown = "frontal" if column in "LR" else "lateral"
    if given.view not in (None, shown):
        raise RadiographError(f"PatientOrientation {column}\\{row} is {shown}, but subject.json has view {given.view}")
    return column, row, f"DICOM PatientOrientation {column}\\{row}"


def _letter(direction: Floats) -> str:
    """Letter of the anatomical direction nearest to a world vector."""
    lps = lps_from_world(direction)
    return max(_LETTERS, key=lambda letter: float(np.dot(_LETTERS[letter], lps)))


# Reading: numbers and times


def _code(dataset: Dataset, keyword: str) -> str:
    """A coded word of the file, fit to be shown."""
    return _plain(dataset.get(keyword) or "")


def _plain(value: Any) -> str:
    return re.sub(r"[^A-Z0-9_ ]", "?", str(value).strip())[:16]


def _as_number(keyword: str, value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise RadiographError(f"{keyword} is no number")
    return number


def _number(dataset: Dataset, keyword: str, default: float | None = None) -> float | None:
    value = dataset.get(keyword)
    if value is None or (isinstance(value, str) and not value.strip()):
        return default
    return _as_number(keyword, value)


def _integer(dataset: Dataset, keyword: str, default: int | None = None) -> int:
    value = _number(dataset, keyword)
    if value is None:
        if default is None:
            raise RadiographError(f"{keyword} is missing")
        return default
    return int(value)


def _frame_times(dataset: Dataset, frames: int) -> list[float | None]:
    """Seconds since the first frame."""
    if frames == 1:
        return [0.0]
    increments = dataset.get("FrameTimeVector")
    if increments is not None and not isinstance(increments, (str, float, int)) and len(increments) == frames:
        steps = [_as_number("FrameTimeVector", step) for step in increments]
        steps[0] = 0.0
    else:
        step = _number(dataset, "FrameTime")
        if step is None:
            return [None] * frames
        steps = [0.0] + [step] * (frames - 1)
    if min(steps) < 0.0:
        raise RadiographError("frame times go backwards")
    return [float(t) for t in np.cumsum(steps) / 1000.0]


def _clock(dataset: Dataset) -> float | None:
    """Seconds of the acquisition since the year 1, or since midnight without a date; None if the file doesn't tell."""
    # Read by hand: values like 17:58:00 of old systems are worth having, and a bad time is no reason to refuse.
    moment = str(dataset.get("AcquisitionDateTime") or "")
    date, time = (moment[:8], moment[8:]) if len(moment) > 8 else (
        str(dataset.get("AcquisitionDate") or ""), str(dataset.get("AcquisitionTime") or "")
    )  # fmt: skip
    found = re.match(r"(\d\d):?(\d\d)?:?(\d\d(?:\.\d+)?)?", time)
    if found is None:
        return None
    hours, minutes, seconds = (float(part or 0.0) for part in found.groups())
    try:
        day = datetime.date.fromisoformat(date.replace(".", "").strip()).toordinal()
    except ValueError:
        day = 0
    return 86400.0 * day + 3600.0 * hours + 60.0 * minutes + seconds


# Reading: a folder


def _read_folder(folder: Path, given: Geometry, centre: ArrayLike) -> tuple[Radiograph, ...]:
    files = sorted(file for file in folder.iterdir() if file.is_file() and not file.name.startswith("."))
    files = [file for file in files if file.suffix.lower() == ".dcm"] or files
    if not files:
        raise RadiographError(f"{folder.name}: no radiographs in this folder")
    if len(files) > MOST_FRAMES:
        raise RadiographError(f"{folder.name}: {len(files)} files; at most {MOST_FRAMES} are read")
    if sum(file.stat().st_size for file in files) > MOST_BYTES:
        raise RadiographError(f"{folder.name}: more than {MOST_BYTES // 2**20} MB of radiographs")
    pictures: list[_Picture] = []
    for file in files:
        found = _read_file(file, given, centre)
        if len(found) > 1 and len(files) > 1:
            raise RadiographError(f"{file.name}: {len(found)} frames in a folder of single frames; keep it apart")
        pictures += found
        if sum(picture.radiograph.pixels.nbytes for picture in pictures) > 2 * MOST_BYTES:
            raise RadiographError(f"{folder.name}: more than {MOST_BYTES // 2**20} MB of pixels")
    if len(files) == 1:
        return tuple(picture.radiograph for picture in pictures)
    first = pictures[0].radiograph
    for picture in pictures[1:]:
        if picture.radiograph.view.shape != first.view.shape:
            raise RadiographError(f"{picture.radiograph.source}: another size than {first.source} in the same folder")
    return _numbered(_ordered(pictures, folder.name))


def _ordered(pictures: list[_Picture], folder: str) -> list[_Picture]:
    """By time, then by instance number; by the one that all have."""
    timed = all(picture.clock_s is not None for picture in pictures)
    counted = all(picture.instance is not None for picture in pictures)
    if not timed and not counted:
        warnings.warn(f"{folder}: no acquisition times or instance numbers; ordered by file name", stacklevel=4)
        return pictures
    clock = [picture.clock_s or 0.0 if timed else 0.0 for picture in pictures]
    instance = [picture.instance or 0 if counted else 0 for picture in pictures]
    order = sorted(range(len(pictures)), key=lambda i: (clock[i], instance[i]))
    numbers = [instance[i] for i in order]
    if timed and counted and numbers != sorted(numbers):
        warnings.warn(f"{folder}: acquisition times and instance numbers disagree; ordered by time", stacklevel=4)
    return [pictures[i] for i in order]


def _numbered(pictures: list[_Picture]) -> tuple[Radiograph, ...]:
    start = pictures[0].clock_s
    times = [
        picture.clock_s - start if picture.clock_s is not None and start is not None else None for picture in pictures
    ]
    return tuple(replace(picture.radiograph, frame=i, time_s=times[i]) for i, picture in enumerate(pictures))


# Writing


def _new_dataset(
    frames: NDArray[np.uint16], view: XRayView, patient_id: str, description: str, instance_number: int
) -> Dataset:
    from pydicom.dataset import Dataset, FileMetaDataset
    from pydicom.uid import UID, ExplicitVRLittleEndian, generate_uid

    content = np.ascontiguousarray(frames, dtype="<u2").tobytes()
    series = [patient_id, description]
    picture = [*series, str(instance_number), hashlib.sha256(content).hexdigest()]
    several = len(frames) > 1
    dataset = Dataset()
    dataset.file_meta = FileMetaDataset()
    dataset.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    dataset.SOPClassUID = UID(_RF_STORAGE if several else _DX_STORAGE)
    dataset.SOPInstanceUID = generate_uid(entropy_srcs=[*picture, "instance"])
    dataset.StudyInstanceUID = generate_uid(entropy_srcs=[patient_id, "study"])
    dataset.SeriesInstanceUID = generate_uid(entropy_srcs=[*series, "series"])
    dataset.file_meta.MediaStorageSOPClassUID = dataset.SOPClassUID
    dataset.file_meta.MediaStorageSOPInstanceUID = dataset.SOPInstanceUID
    dataset.Modality = "RF" if several else "DX"
    dataset.ImageType = ["DERIVED", "PRIMARY", "SINGLE PLANE"] if several else ["DERIVED", "PRIMARY"]
    dataset.PatientID, dataset.PatientName = patient_id, patient_id
    for empty in ("PatientBirthDate", "PatientSex", "StudyDate", "StudyTime", "StudyID", "AccessionNumber",
                  "ReferringPhysicianName"):  # fmt: skip
        setattr(dataset, empty, "")
    dataset.Manufacturer = "spinestiff"
    dataset.PatientIdentityRemoved, dataset.BurnedInAnnotation = "YES", "NO"
    dataset.SeriesDescription = description[:64]
    dataset.SeriesNumber, dataset.InstanceNumber = 1, instance_number
    dataset.SamplesPerPixel, dataset.PhotometricInterpretation = 1, "MONOCHROME2"
    dataset.Rows, dataset.Columns = view.shape
    dataset.BitsAllocated, dataset.BitsStored, dataset.HighBit, dataset.PixelRepresentation = 16, 16, 15, 0
    dataset.PixelIntensityRelationship, dataset.PixelIntensityRelationshipSign = "LOG", -1
    low, high = np.percentile(frames[0][::4, ::4], [2.0, 99.5])
    dataset.WindowCenter, dataset.WindowWidth = f"{0.5 * (low + high):.0f}", f"{max(high - low, 1.0):.0f}"
    dataset.ImagerPixelSpacing = [f"{mm:.10g}" for mm in view.pixel_spacing[::-1]]
    dataset.DistanceSourceToDetector = f"{view.source_to_detector:.10g}"
    dataset.DistanceSourceToPatient = f"{view.source_to_patient:.10g}"
    if several:
        dataset.NumberOfFrames = len(frames)
        dataset.RadiationSetting = "SC"
    else:
        dataset.PresentationIntentType = "FOR PRESENTATION"
        dataset.RescaleSlope, dataset.RescaleIntercept, dataset.RescaleType = "1", "0", "US"
    dataset.PixelData = content
    dataset["PixelData"].VR = "OW"
    return dataset


def _write_times(dataset: Dataset, frame_time_ms: float | Sequence[float], frames: int) -> None:
    from pydicom.tag import Tag

    steps = np.asarray(frame_time_ms, dtype=float)
    if not np.isfinite(steps).all() or (steps < 0.0).any() or steps.shape not in ((), (frames,)):
        raise RadiographError(f"frame times {steps.shape}; wanted one number or {frames}, in ms and not negative")
    if steps.ndim == 0:
        dataset.FrameTime = f"{float(steps):.10g}"
        dataset.FrameIncrementPointer = Tag("FrameTime")
    else:
        dataset.FrameTimeVector = [f"{step:.10g}" for step in steps]
        dataset.FrameIncrementPointer = Tag("FrameTimeVector")
