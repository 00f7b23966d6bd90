"""What a radiograph may keep when its patient is taken out: attributes by name, each with a rule for its value.

Words are kept only if they are on a list, numbers are written anew as numbers. So nothing that a person could have
typed gets through, whatever attribute it was typed into.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from spinestiff.imaging.dicom.layout import MODALITIES, MOST_FRAMES, MOST_PIXELS_A_SIDE

Rule = Callable[[Any], Any]
"""A value fit to be kept, made anew from what the file holds; None or an error for any other."""

CLASSES = frozenset(
    f"1.2.840.10008.5.1.4.1.1.{number}"
    for number in (
        "1",  # Computed Radiography
        "1.1",  # Digital X-Ray, for presentation
        "1.1.1",  # Digital X-Ray, for processing
        "7",  # Secondary Capture
        "7.2",  # Multi-frame Grayscale Byte Secondary Capture
        "7.3",  # Multi-frame Grayscale Word Secondary Capture
        "12.1",  # X-Ray Angiographic
        "12.2",  # X-Ray Radiofluoroscopic
    )
)
"""Kinds of files that are pictures of one X-ray system (SOP classes, PS3.4 B.5)."""
ENHANCED = frozenset(f"1.2.840.10008.5.1.4.1.1.{number}" for number in ("12.1.1", "12.2.1"))
"""Enhanced X-Ray Angiographic and Radiofluoroscopic, which are read, but not de-identified."""


def one_of(*words: str) -> Rule:
    """One of some words, in capitals."""
    return lambda value: word if (word := str(value).strip().upper()) in words else None


def _image_type(values: Any) -> list[str] | None:
    known = [str(value).strip().upper() for value in listed(values)]
    if len(known) < 2 or known[0] not in ("ORIGINAL", "DERIVED") or known[1] not in ("PRIMARY", "SECONDARY"):
        return None
    plane = [word for word in known[2:3] if word in ("SINGLE PLANE", "BIPLANE A", "BIPLANE B", "SINGLE A", "SINGLE B")]
    return known[:2] + plane


def _directions(values: Any) -> list[str] | None:
    letters = [str(value).strip().upper() for value in listed(values)]
    return letters if len(letters) == 2 and all(re.fullmatch("[LRAPHF]{1,3}", part) for part in letters) else None


def _whole(low: int, high: int) -> Rule:
    return lambda value: number if low <= (number := int(value)) <= high and number == float(value) else None


def _decimal(low: float, high: float) -> Rule:
    # Written anew with at most 16 characters, which is what DS may have.
    return lambda value: f"{number:.10g}" if low <= (number := float(value)) <= high else None


def _decimals(low: float, high: float, fewest: int, most: int) -> Rule:
    one = _decimal(low, high)

    def rule(values: Any) -> list[str] | None:
        numbers = [one(value) for value in listed(values)]
        return numbers if fewest <= len(numbers) <= most and None not in numbers else None

    return rule


def _aspect(values: Any) -> list[str] | None:
    numbers = [int(value) for value in listed(values)]
    return [str(n) for n in numbers] if len(numbers) == 2 and all(0 < n <= 10_000 for n in numbers) else None


def _pointer(value: Any) -> int | None:
    return int(value) if int(value) in (0x00181063, 0x00181065) else None  # FrameTime, FrameTimeVector


def listed(values: Any) -> list[Any]:
    """The values of an attribute that may have one or several."""
    return [values] if isinstance(values, (str, int, float)) else list(values)


_GREY = _decimals(-1e6, 1e6, 1, 8)
_MM = _decimals(1e-4, 10.0, 2, 2)
_DISTANCE = _decimal(1.0, 20000.0)
_COUNTER = _whole(0, 99999)

KEPT: Mapping[str, Rule] = MappingProxyType({
    "Modality": one_of(*MODALITIES),
    "ImageType": _image_type,
    "PresentationIntentType": one_of("FOR PRESENTATION", "FOR PROCESSING"),
    "BurnedInAnnotation": one_of("YES", "NO"),
    "SeriesNumber": _COUNTER,
    "AcquisitionNumber": _COUNTER,
    "InstanceNumber": _COUNTER,
    "SamplesPerPixel": _whole(1, 1),
    "PhotometricInterpretation": one_of("MONOCHROME1", "MONOCHROME2"),
    "NumberOfFrames": _whole(1, MOST_FRAMES),
    "Rows": _whole(1, MOST_PIXELS_A_SIDE),
    "Columns": _whole(1, MOST_PIXELS_A_SIDE),
    "BitsAllocated": lambda value: {8: 8, 16: 16}.get(int(value)),
    "BitsStored": _whole(1, 16),
    "HighBit": _whole(0, 15),
    "PixelRepresentation": _whole(0, 1),
    "RescaleSlope": _decimal(-1e6, 1e6),
    "RescaleIntercept": _decimal(-1e6, 1e6),
    "RescaleType": one_of("US", "OD", "HU"),
    "PixelIntensityRelationship": one_of("LIN", "LOG", "DISP"),
    "PixelIntensityRelationshipSign": _whole(-1, 1),
    "PresentationLUTShape": one_of("IDENTITY", "INVERSE"),
    "WindowCenter": _GREY,
    "WindowWidth": _GREY,
    "VOILUTFunction": one_of("LINEAR", "LINEAR_EXACT", "SIGMOID"),
    "LossyImageCompression": one_of("00", "01"),
    "LossyImageCompressionRatio": _decimals(1.0, 1000.0, 1, 8),
    "KVP": _decimal(0.0, 500.0),
    "ImagerPixelSpacing": _MM,
    "PixelSpacing": _MM,
    "NominalScannedPixelSpacing": _MM,
    "PixelAspectRatio": _aspect,
    "PixelSpacingCalibrationType": one_of("GEOMETRY", "FIDUCIAL"),
    "EstimatedRadiographicMagnificationFactor": _decimal(1.0, 10.0),
    "DistanceSourceToDetector": _DISTANCE,
    "DistanceSourceToPatient": _DISTANCE,
    "PatientOrientation": _directions,
    "ViewPosition": one_of("AP", "PA", "LL", "RL", "RLD", "LLD", "RLO", "LLO"),
    "Laterality": one_of("L", "R"),
    "ImageLaterality": one_of("L", "R", "U", "B"),
    "FrameTime": _decimal(0.0, 1e7),
    "FrameTimeVector": _decimals(0.0, 1e7, 1, MOST_FRAMES),
    "FrameIncrementPointer": _pointer,
})  # fmt: skip
"""Attributes whose values are kept, and what each may be. Beside them: look-up tables and pixel data."""


VIEW_CODES: Mapping[str, tuple[str, str]] = MappingProxyType({
    "399348003": ("SCT", "antero-posterior"),
    "R-10206": ("SRT", "antero-posterior"),
    "272479007": ("SCT", "postero-anterior"),
    "R-40888": ("SRT", "postero-anterior"),
    "399173006": ("SCT", "left lateral"),
    "R-10236": ("SRT", "left lateral"),
    "399198007": ("SCT", "right lateral"),
    "R-10232": ("SRT", "right lateral"),
})  # fmt: skip
"""Scheme and meaning of the codes that ViewCodeSequence may hold (PS3.16, context group 4010)."""


def ruled(rule: Rule, value: Any) -> Any:
    """What a rule makes of a value; None for a value that it doesn't allow."""
    try:
        return rule(value)
    except Exception:  # values are converted when they are touched, and what DICOM files hold raises all sorts
        return None
