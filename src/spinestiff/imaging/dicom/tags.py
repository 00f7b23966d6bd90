"""Tags of a picture: everything that reading a radiograph needs, as plain Python values.

What a radiofluoroscopic or angiographic file of the enhanced kind keeps in functional groups is found there, if all
frames share it. Tags are touched here and in ``person_tags`` only; texts and numbers of the patient leave neither:
identities are kept as hashes.
"""

from __future__ import annotations

import datetime
import hashlib
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from spinestiff.errors import RadiographError
from spinestiff.imaging.dicom.files import named
from spinestiff.imaging.dicom.ordering import DAY_S

if TYPE_CHECKING:
    from pydicom.dataset import Dataset

MOST_TABLE_ENTRIES = 65536
BIG_ENDIAN = "1.2.840.10008.1.2.2"
"""The one transfer syntax whose words have their more significant byte first."""
# SNOMED CT and SRT codes of the view (CID 4010).
_VIEW_CODES = {
    "399348003": "AP", "R-10206": "AP", "272479007": "PA", "R-40888": "PA",
    "399173006": "LL", "R-10236": "LL", "399198007": "RL", "R-10232": "RL",
}  # fmt: skip


# Coded words that may be shown. Any other may be what somebody typed into the wrong field.
_WORDS = frozenset(
    {
        "CR", "DX", "RF", "XA", "SC", "OT", "CT", "MR", "US", "MG", "NM", "PT", "IO", "PX", "RG", "ES", "XC",
        "SR", "PR", "SEG", "RTIMAGE", "RTDOSE", "RTPLAN", "MONOCHROME1", "MONOCHROME2", "RGB", "YBR_FULL",
        "YBR_FULL_422", "YBR_ICT", "YBR_RCT", "LINEAR", "LINEAR_EXACT", "SIGMOID", "GEOMETRY", "FIDUCIAL", "AP",
        "PA", "LL", "RL", "L", "R", "U", "B", "PALETTE COLOR",
    }
)  # fmt: skip


_DISPLAY = frozenset({"WindowCenter", "WindowWidth", "VOILUTFunction", "VOILUTSequence"})


class MissingValue(RadiographError):
    """A radiograph lacks something that the user can give in subject.json."""


@dataclass(frozen=True)
class Table:
    """A look-up table: ``values[i]`` is the output for input ``first + i``; what lies outside takes the end's."""

    first: int
    values: NDArray[np.uint16]


SLOT_MAKERS = ("eos imaging", "biospace med", "lodox")


@dataclass(frozen=True)
class Tags:
    """What a file says, before anything is concluded from it. None: the file does not say.

    Spacings are (between rows, between columns) in mm, distances mm, times seconds. ``identity`` is a hash.
    """

    modality: str
    image_type: str
    syntax: str
    syntax_name: str
    frames: int
    rows: int
    columns: int
    samples: int
    photometric: str
    allocated: int
    stored: int
    high_bit: int
    signed: bool
    slope: float
    intercept: float
    modality_table: Table | None
    beam_sign: float | None
    window: tuple[float, float] | None
    window_function: str
    window_table: Table | None
    imager_spacing: tuple[float, float] | None
    pixel_spacing: tuple[float, float] | None
    calibration: str
    scanned_spacing: tuple[float, float] | None
    aspect: float | None
    source_detector: float | None
    source_patient: float | None
    magnification: float | None
    orientation: tuple[str, str] | None
    view_position: str
    image_laterality: str
    laterality: str
    times: tuple[float | None, ...]
    clock: float | None
    content_clock: float | None
    instance: int | None
    identity: str
    slot_scanner: bool = False


def read_tags(dataset: Dataset) -> Tags:
    """The tags of a dataset.

    Raises
    ------
    RadiographError : a value that is no number, a wrong count of values, a table that does not fit its descriptor.
    """
    from pydicom.uid import UID

    modality = code(dataset, "Modality")
    if "PixelData" not in dataset:
        raise RadiographError("PixelData: missing, wanted a picture; copy the file again, or name another")
    frames = _integer(dataset, "NumberOfFrames", 1)
    stored = _integer(dataset, "BitsStored")
    signed = _integer(dataset, "PixelRepresentation", 0)
    if signed not in (0, 1):
        raise RadiographError(f"PixelRepresentation: found {signed}, wanted 0 or 1; export it again")
    syntax = UID(str(own(dataset.file_meta, "TransferSyntaxUID") or ""))
    if not syntax:
        raise RadiographError("TransferSyntaxUID: missing, wanted how the pixels are coded; export it again")
    kind = UID(str(own(dataset, "SOPClassUID") or ""))
    instance = _number(dataset, "InstanceNumber")
    return Tags(
        modality=modality,
        image_type=kind.name if not kind.is_private and kind.name != kind else "unknown",
        syntax=str(syntax),
        syntax_name=syntax.name if syntax.is_transfer_syntax else "unknown transfer syntax",
        frames=frames,
        rows=_integer(dataset, "Rows"),
        columns=_integer(dataset, "Columns"),
        samples=_integer(dataset, "SamplesPerPixel", 1),
        photometric=code(dataset, "PhotometricInterpretation"),
        allocated=_integer(dataset, "BitsAllocated"),
        stored=stored,
        high_bit=_integer(dataset, "HighBit", stored - 1),
        signed=bool(signed),
        slope=_number(dataset, "RescaleSlope", 1.0) or 0.0,
        intercept=_number(dataset, "RescaleIntercept", 0.0) or 0.0,
        modality_table=_table(dataset, "ModalityLUTSequence"),
        beam_sign=_number(dataset, "PixelIntensityRelationshipSign"),
        window=_window(dataset),
        window_function=code(dataset, "VOILUTFunction") or "LINEAR",
        window_table=_table(dataset, "VOILUTSequence"),
        imager_spacing=_two(dataset, "ImagerPixelSpacing"),
        pixel_spacing=_two(dataset, "PixelSpacing"),
        calibration=code(dataset, "PixelSpacingCalibrationType"),
        scanned_spacing=_two(dataset, "NominalScannedPixelSpacing"),
        aspect=_aspect(dataset),
        source_detector=_number(dataset, "DistanceSourceToDetector"),
        source_patient=_number(dataset, "DistanceSourceToPatient"),
        magnification=_number(dataset, "EstimatedRadiographicMagnificationFactor"),
        orientation=_orientation(dataset),
        view_position=_view_position(dataset),
        image_laterality=code(dataset, "ImageLaterality"),
        laterality=code(dataset, "Laterality"),
        times=_frame_times(dataset, frames),
        clock=clock_of(partial(text, dataset), "Acquisition"),
        content_clock=clock_of(partial(told, dataset), "Content"),
        instance=None if instance is None else int(instance),
        identity=hashed(dataset, "SOPInstanceUID"),
        slot_scanner=_by_a_slot(dataset),
    )


def _by_a_slot(dataset: Dataset) -> bool:
    """Whether maker or model is one of scanners that move a fan of X-rays along the body."""
    maker, model = (told(dataset, keyword).casefold() for keyword in ("Manufacturer", "ManufacturerModelName"))
    known = any(re.search(rf"\b{word}\b", maker) for word in SLOT_MAKERS)
    return known or ("canon" not in maker and bool(re.match(r"(eos|eosedge|statscan)\b", model)))


def code(dataset: Dataset, keyword: str) -> str:
    """A coded word of the file, fit to be shown: "?" for one that is not known, "" for none."""
    value = _value(dataset, keyword)
    with named(keyword):
        return coded_word(str(value or "").strip())


def coded_word(word: str) -> str:
    """A word fit to be shown: itself if it is known, "?" if it is not."""
    return word if word in _WORDS or not word else "?"


def shown(word: str) -> str:
    """A coded word as messages have it."""
    return {"": "none", "?": "an unlisted word"}.get(word, word)


def own(dataset: Dataset, keyword: str) -> Any:
    """Of the dataset itself, where pydicom parses an element at its first use."""
    with named(keyword):
        return dataset.get(keyword)


def _value(dataset: Dataset, keyword: str) -> Any:
    """Of the dataset itself, or of the functional groups, where every frame has to have the same; of what is a matter
    of display only, the first frame's."""
    if keyword in dataset:
        return own(dataset, keyword)
    with named("the frames' functional groups"):
        found = [_grouped(group, keyword) for group in (dataset.get("SharedFunctionalGroupsSequence") or [])[:1]]
        found += [_grouped(group, keyword) for group in dataset.get("PerFrameFunctionalGroupsSequence") or []]
    there = [value for value in found if value is not None]
    if keyword not in _DISPLAY and any(str(value) != str(there[0]) for value in there[1:]):
        raise RadiographError(
            f"{keyword}: found values that differ from frame to frame, wanted one; export the frames as single files"
        )
    return there[0] if there else None


def _grouped(group: Dataset, keyword: str) -> Any:
    for element in group:
        if element.VR == "SQ":
            for item in element.value[:1]:
                if keyword in item:
                    return item.get(keyword)
    return None


def _as_number(keyword: str, value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise RadiographError(f"{keyword}: found no number, wanted one; export it again")
    return number


def _absent(value: Any) -> bool:
    return value is None or (hasattr(value, "__len__") and not len(value)) or not str(value).strip()


def _values(keyword: str, value: Any) -> list[Any]:
    """The values of an element of any number of them; items are parsed, so that they may be at fault."""
    with named(keyword):
        if _absent(value):
            return []
        return list(value) if isinstance(value, Sequence) and not isinstance(value, (str, bytes)) else [value]


def _number(dataset: Dataset, keyword: str, default: float | None = None) -> float | None:
    value = _value(dataset, keyword)
    with named(keyword):
        absent = _absent(value)
    return default if absent else _as_number(keyword, value)


def _integer(dataset: Dataset, keyword: str, default: int | None = None) -> int:
    value = _number(dataset, keyword)
    if value is None:
        if default is None:
            raise RadiographError(f"{keyword}: missing, wanted a number; export it again")
        return default
    if value != int(value):
        raise RadiographError(f"{keyword}: found {value:g}, wanted a whole number; export it again")
    return int(value)


def _two(dataset: Dataset, keyword: str) -> tuple[float, float] | None:
    values = _values(keyword, _value(dataset, keyword))
    if not values:
        return None
    if len(values) != 2:
        count = f"{len(values)} value" + ("s" if len(values) > 1 else "")
        raise RadiographError(f"{keyword}: found {count}, wanted two numbers; correct it at the source")
    first, second = (_as_number(keyword, value) for value in values)
    return first, second


def _aspect(dataset: Dataset) -> float | None:
    """Of a pixel, its height over its width."""
    values = _two(dataset, "PixelAspectRatio")
    if values is None:
        return None
    if min(values) <= 0.0:
        raise RadiographError(
            "PixelAspectRatio: found {:g}\\{:g}, wanted two numbers above 0; correct it at the source".format(*values)
        )
    return values[0] / values[1]


def _window(dataset: Dataset) -> tuple[float, float] | None:
    """Centre and width of the first window."""
    both: list[float] = []
    for keyword in ("WindowCenter", "WindowWidth"):
        values = _values(keyword, _value(dataset, keyword))
        if not values:
            return None
        both.append(_as_number(keyword, values[0]))
    return both[0], both[1]


def _table(dataset: Dataset, keyword: str) -> Table | None:
    items = _values(keyword, _value(dataset, keyword))
    if not items:
        return None
    with named(keyword):
        descriptor, data = _values("LUTDescriptor", items[0].get("LUTDescriptor")), items[0].get("LUTData")
    if _absent(data) or len(descriptor) != 3:
        raise RadiographError(f"{keyword}: found no table, wanted LUTDescriptor and LUTData; export it again")
    count, first, bits = (int(_as_number(keyword, value)) for value in descriptor)
    count = count % MOST_TABLE_ENTRIES or MOST_TABLE_ENTRIES
    if not 8 <= bits <= 16:
        raise RadiographError(f"{keyword}: found entries of {bits} bits, wanted 8 to 16; export it again")
    if isinstance(data, bytes):
        data = little_endian(data, str(own(dataset.file_meta, "TransferSyntaxUID") or ""))
        narrow = bits == 8 and len(data) - count in (0, 1)
        values = np.frombuffer(data, dtype=np.uint8 if narrow else "<u2")
        values = values[:count] if narrow else values
    else:
        with named(keyword):
            values = np.asarray(_values(keyword, data), dtype=np.int64) % 65536
    if len(values) != count:
        raise RadiographError(f"{keyword}: found {len(values)} entries, wanted {count} as declared; export it again")
    if first >= 32768 and _integer(dataset, "PixelRepresentation", 0):
        first -= 65536
    return Table(first, values.astype(np.uint16))


def little_endian(words: bytes, syntax: str) -> bytes:
    """Words (VR OW) of a file of some transfer syntax, the less significant byte first, without half a word at the end.

    The DICOM library leaves their bytes as they are in the file.
    """
    whole = words[: len(words) // 2 * 2]
    return np.frombuffer(whole, ">u2").astype("<u2").tobytes() if syntax == BIG_ENDIAN else whole


def _orientation(dataset: Dataset) -> tuple[str, str] | None:
    values = _values("PatientOrientation", _value(dataset, "PatientOrientation"))
    if len(values) != 2:
        return None
    column, row = (str(part).strip()[:1] for part in values)
    return (_direction(column), _direction(row)) if column and row else None


def _direction(letter: str) -> str:
    return letter if letter in "LRAPHF" else "?"


def _view_position(dataset: Dataset) -> str:
    word = code(dataset, "ViewPosition")
    items = _values("ViewCodeSequence", _value(dataset, "ViewCodeSequence"))
    with named("ViewCodeSequence"):
        coded = _VIEW_CODES.get(str(items[0].get("CodeValue", "")), "") if items else ""
    if word in _VIEW_CODES.values() and coded and word != coded:
        raise RadiographError(f"ViewPosition: found {word}, wanted {coded} as ViewCodeSequence says; correct either")
    return word if word in _VIEW_CODES.values() else coded or word


def _frame_times(dataset: Dataset, frames: int) -> tuple[float | None, ...]:
    """Seconds since the first frame."""
    if not 1 < frames <= 100_000:
        return (0.0,)
    increments = _values("FrameTimeVector", _value(dataset, "FrameTimeVector"))
    if len(increments) > 1:
        if len(increments) != frames:
            raise RadiographError(
                f"FrameTimeVector: found {len(increments)} entries, wanted {frames}, one a frame; export it again"
            )
        steps = [_as_number("FrameTimeVector", step) for step in increments]
        steps[0] = 0.0
    else:
        step = _number(dataset, "FrameTime")
        if step is None:
            return (None,) * frames
        steps = [0.0] + [step] * (frames - 1)
    if min(steps) < 0.0:
        raise RadiographError(f"FrameTime: found {min(steps):g} ms, wanted 0 or more; correct it at the source")
    return tuple(float(t) for t in np.cumsum(steps) / 1000.0)


def clock_of(value: Callable[[str], str], what: Literal["Acquisition", "Content", "Series"]) -> float | None:
    """Seconds of that date and time since the year 1, or since midnight without a date; None if the file tells none.

    ``value`` : of a keyword, "" for none.
    """
    # Read by hand: values like 17:58:00 of old systems are worth having, and a bad time is no reason to refuse.
    both = value("AcquisitionDateTime") if what == "Acquisition" else ""
    date, seconds = both[:8], _seconds_of(both[8:])
    if seconds is None:
        date, seconds = value(f"{what}Date"), _seconds_of(value(f"{what}Time"))
    return None if seconds is None else DAY_S * (ordinal(date) or 0) + seconds


def text(dataset: Dataset, keyword: str) -> str:
    """A value as text; "" where there is none."""
    return str(own(dataset, keyword) or "").strip()


def told(dataset: Dataset, keyword: str) -> str:
    """A value as text; "" where there is none, or none that can be read."""
    try:
        return str(dataset.get(keyword) or "").strip()
    except Exception:  # what pydicom can't parse raises all sorts; such a value tells nothing
        return ""


def _seconds_of(time: str) -> float | None:
    """Since midnight; None of what is no time of day."""
    found = re.match(r"(\d\d):?(\d\d)?:?(\d\d(?:\.\d+)?)?", time)
    if found is None:
        return None
    hours, minutes, seconds = (float(part or 0.0) for part in found.groups())
    total = 3600.0 * hours + 60.0 * minutes + seconds
    # A second of 60 is a leap second.
    return total if minutes < 60.0 and seconds < 61.0 and total < DAY_S else None


def ordinal(date: str) -> int | None:
    """Day since the year 1."""
    try:
        return datetime.date.fromisoformat(date.replace(".", "").strip()).toordinal()
    except ValueError:
        return None


def hashed(dataset: Dataset, keyword: str) -> str:
    """Hash of a text; "" if there is none."""
    value = text(dataset, keyword)
    return hash_of(value) if value else ""


def hash_of(text: str) -> str:
    """What tells texts apart, without the text."""
    return hashlib.sha256(text.encode("utf-8", "replace")).hexdigest()
