"""Where millimetres come from: distances and pixel spacing, of the file or given, and never guessed.

``ImagerPixelSpacing`` is the pitch at the detector. ``PixelSpacing`` is one at the patient only where
``PixelSpacingCalibrationType`` says so; then the magnification leads back to the detector (PS3.3 10.7).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from spinestiff.errors import RadiographError
from spinestiff.imaging.dicom.tags import MissingValue, Tags

PIXEL_MM = (0.02, 2.0)
"""Plausible pixel pitch at the detector, mm."""
DISTANCES_MM = (300.0, 10_000.0)
LARGEST_IMAGE_MM = 2500.0
LARGEST_ASPECT = 1.5
LARGEST_MAGNIFICATION = 3.0
AGREEMENT = 0.01
"""Relative difference up to which two statements of the same quantity agree."""
AGREEMENT_OF_CALIBRATION = 0.05
"""The same where one was calibrated on an object, whose plane is that of the patient only nearly."""
FEWEST_PIXELS = 20.0
"""Length in the image below which a known length says too little: an end half a pixel off is 5 %."""


@dataclass(frozen=True)
class Scale:
    """A known length in the image.

    Attributes
    ----------
    length_mm : its length.
    ends_px : its two ends, (column, row), the first pixel's centre at (0, 0).
    plane : where it lay; "patient" is the plane at the distance source to patient.
    what : what it is, in words.
    agreement : relative difference up to which a file's own spacing agrees with it.
    """

    length_mm: float
    ends_px: tuple[tuple[float, float], tuple[float, float]]
    plane: Literal["patient", "detector"] = "patient"
    what: str = "object"
    agreement: float = AGREEMENT_OF_CALIBRATION


@dataclass(frozen=True)
class Geometry:
    """What a file may lack; a value that contradicts the file by more than 1 % is refused.

    Attributes
    ----------
    source_detector_mm, source_patient_mm : distances along the detector's normal.
    imager_pixel_mm : pixel pitch at the detector.
    view : which side is seen, for files without PatientOrientation.
    scale : a known length in the image, for files without a spacing; one that the file contradicts is refused.
    """

    source_detector_mm: float | None = None
    source_patient_mm: float | None = None
    imager_pixel_mm: float | None = None
    view: Literal["frontal", "lateral"] | None = None
    scale: Scale | None = None


@dataclass(frozen=True)
class Distances:
    """From the source, mm, and where each came from."""

    detector: float
    patient: float
    sources: tuple[str, str]

    @property
    def magnification(self) -> float:
        """Of the patient plane."""
        return self.detector / self.patient


@dataclass(frozen=True)
class Spacing:
    """At the detector, mm, and where it came from."""

    row: float
    column: float
    source: str


def distances(tags: Tags, given: Geometry) -> Distances:
    """Source to detector and source to patient.

    Raises
    ------
    MissingValue : one of them can't be told.
    RadiographError : one is implausible, or two statements contradict each other.
    """
    detector = _distance("DistanceSourceToDetector", tags.source_detector, "source_detector_mm",
                         given.source_detector_mm)  # fmt: skip
    patient = _distance("DistanceSourceToPatient", tags.source_patient, "source_patient_mm", given.source_patient_mm)
    factors = _magnifications(tags)
    if detector is not None and patient is None and factors:
        factor, words = factors[0]
        patient = detector[0] / factor, f"source to detector over {words} {factor:.4g}"
    elif detector is None and patient is not None and factors:
        factor, words = factors[0]
        detector = patient[0] * factor, f"source to patient times {words} {factor:.4g}"
    if detector is None or patient is None:
        lacking = [(keyword, key) for keyword, key, known in (
            ("DistanceSourceToDetector", "source_detector_mm", detector),
            ("DistanceSourceToPatient", "source_patient_mm", patient),
        ) if known is None]  # fmt: skip
        keywords = " and no ".join(keyword for keyword, _ in lacking)
        keys = " and ".join(key for _, key in lacking)
        raise MissingValue(f"no {keywords}; add {keys} to subject.json, as read at the X-ray system")
    if patient[0] >= detector[0]:
        raise RadiographError(f"source to patient {patient[0]:g} mm is not below source to detector {detector[0]:g} mm")
    found = Distances(detector[0], patient[0], (detector[1], patient[1]))
    if found.magnification > LARGEST_MAGNIFICATION:
        raise RadiographError(
            f"source to detector {found.detector:g} mm over source to patient {found.patient:g} mm magnifies "
            f"{found.magnification:.3g} times; wanted at most {LARGEST_MAGNIFICATION:g}; correct the distances"
        )
    for factor, words in factors:
        most = AGREEMENT if words == _ESTIMATED else AGREEMENT_OF_CALIBRATION
        if abs(factor / found.magnification - 1.0) > most:
            raise RadiographError(
                f"{words} is {factor:.4g}, but the distances magnify {found.magnification:.4g} times; "
                "correct what is wrong"
            )
    return found


_ESTIMATED = "EstimatedRadiographicMagnificationFactor"


def _magnifications(tags: Tags) -> list[tuple[float, str]]:
    found = []
    # Systems write 1 where they don't know: no patient is of no thickness.
    if tags.magnification not in (None, 0.0, 1.0):
        found.append((float(tags.magnification or 0.0), _ESTIMATED))
    calibrated = _calibrated(tags)
    if tags.imager_spacing is not None and calibrated is not None:
        _check_spacing("ImagerPixelSpacing", tags.imager_spacing, tags)
        _check_spacing("PixelSpacing", calibrated, tags)
        found.append((tags.imager_spacing[0] / calibrated[0], "ImagerPixelSpacing over calibrated PixelSpacing"))
    for factor, words in found:
        if not 1.0 - AGREEMENT <= factor <= LARGEST_MAGNIFICATION:
            raise RadiographError(f"{words} is {factor:.4g}; wanted 1 to {LARGEST_MAGNIFICATION:g}")
    return found


def _distance(keyword: str, tag: float | None, key: str, given: float | None) -> tuple[float, str] | None:
    if tag == 0.0:
        tag = None  # systems write 0 where they don't know
    if tag is None and given is None:
        return None
    if tag is not None and given is not None:
        _check_agreement(keyword, tag, key, given)
    value, source = (tag, f"DICOM {keyword}") if tag is not None else (given or 0.0, f"given {key}")
    if not DISTANCES_MM[0] <= value <= DISTANCES_MM[1]:
        raise RadiographError(f"{keyword} {value:g} mm; wanted {DISTANCES_MM[0]:g} to {DISTANCES_MM[1]:g} (in mm)")
    return value, source


def spacing(tags: Tags, given: Geometry, magnification: float | None) -> Spacing:
    """Pixel pitch at the detector.

    Parameters
    ----------
    magnification : of the patient plane; None if the distances are not known, which only a spacing at the detector
        can do without.

    Raises
    ------
    MissingValue : it can't be told.
    RadiographError : it is implausible, or two statements contradict each other.
    """
    found = _found_spacing(tags, given, magnification)
    _check_spacing("pixel pitch", (found.row, found.column), tags)
    if given.imager_pixel_mm is not None:
        for value in (found.row, found.column):
            _check_agreement(found.source.split(",")[0], value, "imager_pixel_mm", given.imager_pixel_mm)
    if given.scale is not None:
        _check_scale(found, given.scale, magnification)
    extent = max(tags.rows * found.row, tags.columns * found.column)
    if extent > LARGEST_IMAGE_MM:
        raise RadiographError(f"an image of {extent:.0f} mm; wanted at most {LARGEST_IMAGE_MM:g}; check the pitch")
    return found


def _found_spacing(tags: Tags, given: Geometry, magnification: float | None) -> Spacing:
    if tags.imager_spacing is not None:
        _check_spacing("ImagerPixelSpacing", tags.imager_spacing, tags)
        return Spacing(*tags.imager_spacing, "DICOM ImagerPixelSpacing, at the detector")
    calibrated = _calibrated(tags)
    if calibrated is not None:
        _check_spacing("PixelSpacing", calibrated, tags)
        if magnification is None:
            raise MissingValue("PixelSpacing is at the patient, and the magnification is not known; add the distances")
        words = f"calibrated by {tags.calibration} at the patient plane, times the magnification"
        return Spacing(calibrated[0] * magnification, calibrated[1] * magnification, f"DICOM PixelSpacing, {words}")
    aspect = tags.aspect or 1.0
    if given.imager_pixel_mm is not None:
        if abs(aspect - 1.0) > AGREEMENT:
            raise RadiographError("PixelAspectRatio says that pixels aren't square, so imager_pixel_mm can't hold; "
                                  "give a scale in subject.json instead")  # fmt: skip
        pitch = given.imager_pixel_mm
        _check_spacing("imager_pixel_mm", (pitch, pitch), tags)
        return Spacing(pitch, pitch, "given imager_pixel_mm, at the detector")
    if given.scale is not None:
        return _scaled(given.scale, aspect, magnification, tags)
    raise MissingValue(f"{_lacking(tags)}; add imager_pixel_mm (pixel pitch at the detector) to subject.json")


def _calibrated(tags: Tags) -> tuple[float, float] | None:
    return tags.pixel_spacing if tags.calibration in ("GEOMETRY", "FIDUCIAL") else None


def _lacking(tags: Tags) -> str:
    if tags.pixel_spacing is not None:
        return "PixelSpacing doesn't say for which plane"
    if tags.scanned_spacing is not None:
        return f"no ImagerPixelSpacing (NominalScannedPixelSpacing {tags.scanned_spacing[0]:g} mm is on the film)"
    return "no ImagerPixelSpacing"


def _check_spacing(what: str, pair: tuple[float, float], tags: Tags) -> None:
    for value in pair:
        if not PIXEL_MM[0] <= value <= PIXEL_MM[1]:
            raise RadiographError(f"{what} {value:g} mm; wanted {PIXEL_MM[0]:g} to {PIXEL_MM[1]:g}")
    ratio = pair[0] / pair[1]
    if not 1.0 / LARGEST_ASPECT <= ratio <= LARGEST_ASPECT:
        raise RadiographError(f"{what} {pair[0]:g} x {pair[1]:g} mm: no detector has pixels so far from square")
    if tags.aspect is not None and abs(tags.aspect / ratio - 1.0) > AGREEMENT:
        raise RadiographError(f"{what} {pair[0]:g} x {pair[1]:g} mm, but PixelAspectRatio is {tags.aspect:.4g}")


def _check_agreement(what: str, value: float, key: str, given: float) -> None:
    if not math.isfinite(given) or abs(value - given) > AGREEMENT * abs(value):
        raise RadiographError(f"{what} is {value:g} mm, but subject.json gives {key} {given:g} mm; correct that value")


def _span(scale: Scale, aspect: float, tags: Tags | None = None) -> float:
    """Of the scale in the image, in widths of a pixel."""
    (c0, r0), (c1, r1) = scale.ends_px
    if tags is not None and not (
        max(c0, c1) <= tags.columns - 0.5 and max(r0, r1) <= tags.rows - 0.5 and min(c0, c1, r0, r1) >= -0.5
    ):
        raise RadiographError(f"scale: an end of the {scale.what} lies outside the image")
    return math.hypot(c1 - c0, aspect * (r1 - r0))


def _scaled(scale: Scale, aspect: float, magnification: float | None, tags: Tags) -> Spacing:
    pixels = _span(scale, aspect, tags)
    if not pixels >= FEWEST_PIXELS:
        raise RadiographError(
            f"scale: the {scale.what} spans {pixels:.3g} pixels; wanted {FEWEST_PIXELS:g} or more, to be within 5 %"
        )
    column = scale.length_mm / pixels * _to_detector(scale, magnification)
    words = "at the detector" if scale.plane == "detector" else "at the patient plane, times the magnification"
    source = f"{scale.what} of {scale.length_mm:g} mm over {pixels:.1f} pixels {words}"
    return Spacing(aspect * column, column, source)


def _to_detector(scale: Scale, magnification: float | None) -> float:
    if scale.plane == "detector":
        return 1.0
    if magnification is None:
        raise MissingValue("the scale is at the patient, and the magnification is not known; add the distances")
    return magnification


def _check_scale(found: Spacing, scale: Scale, magnification: float | None) -> None:
    length = _span(scale, found.row / found.column) * found.column / _to_detector(scale, magnification)
    if not abs(length - scale.length_mm) <= scale.agreement * scale.length_mm:
        raise RadiographError(
            f"{found.source.split(',')[0]} makes the {scale.what} {length:.4g} mm long, but subject.json says "
            f"{scale.length_mm:g} mm; correct what is wrong"
        )
