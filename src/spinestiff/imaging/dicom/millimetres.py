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
SOURCE_MM = (300.0, 10_000.0)
"""Of an X-ray source from detector or patient."""
LARGEST_IMAGE_MM = 2500.0
LARGEST_ASPECT = 1.5
LARGEST_MAGNIFICATION = 3.0
AGREEMENT = 0.01
"""Relative difference up to which two statements of the same quantity agree."""
AGREEMENT_OF_CALIBRATION = 0.05
"""The same where one was calibrated on an object, whose plane is that of the patient only nearly."""
DEEPEST_MM = 300.0
"""By how much a spine may be nearer to the source than the table or bucky at which the patient is."""
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
    """What a file may lack; a value that contradicts the file by more than 1 % is refused, but for the distance of a
    spine before the table or bucky of a digital radiograph (``_before_support``).

    Attributes
    ----------
    source_detector_mm, source_patient_mm : distances along the detector's normal.
    imager_pixel_mm : pixel pitch at the detector.
    view : which side is seen, for files without PatientOrientation.
    scale : a known length in the image, for files without a spacing; one that the file contradicts is refused.
    beam : which way it goes through the patient, for frontal files without ViewPosition.
    """

    source_detector_mm: float | None = None
    source_patient_mm: float | None = None
    imager_pixel_mm: float | None = None
    view: Literal["frontal", "lateral"] | None = None
    scale: Scale | None = None
    beam: Literal["AP", "PA"] | None = None


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

    A 0 in the file counts as unknown; the source says so.

    Raises
    ------
    MissingValue : one of them can't be told.
    RadiographError : one is implausible, or two statements contradict each other.
    """
    detector = _distance("DistanceSourceToDetector", tags.source_detector, "source_detector_mm",
                         given.source_detector_mm)  # fmt: skip
    spine = _before_support(tags, given)
    patient = _distance("DistanceSourceToPatient", tags.source_patient, "source_patient_mm",
                        given.source_patient_mm if spine is None else None)  # fmt: skip
    factors = _magnifications(tags)
    if detector is not None and patient is None and factors:
        factor, words = factors[0]
        patient = detector[0] / factor, f"source to detector over {words} {factor:.4g}"
    elif detector is None and patient is not None and factors:
        factor, words = factors[0]
        detector = patient[0] * factor, f"source to patient times {words} {factor:.4g}"
    support = patient
    if spine is not None and support is not None:
        words = f"since DistanceSourceToPatient {support[0]:g} mm of such a file is that of table or bucky"
        patient = spine, f"given source_patient_mm, {words}"
    elif patient is not None and tags.source_patient and given.source_patient_mm is None and _digital(tags):
        words = "of such a file that of table or bucky; source_patient_mm takes the spine's"
        patient = patient[0], f"{patient[1]}: {words}"
    if detector is None or patient is None:
        lacking = [(f"no {keyword}" if tag is None else f"{keyword} is 0", key) for keyword, tag, key, known in (
            ("DistanceSourceToDetector", tags.source_detector, "xray.source_detector_mm", detector),
            ("DistanceSourceToPatient", tags.source_patient, "xray.source_patient_mm", patient),
        ) if known is None]  # fmt: skip
        words = " and ".join(words for words, _ in lacking)
        keys = " and ".join(key for _, key in lacking)
        raise MissingValue(f"{words}; add {keys} to subject.json, as read at the X-ray system")
    if patient[0] >= detector[0]:
        raise RadiographError(
            f"found source to patient {patient[0]:g} mm ({patient[1]}), source to detector {detector[0]:g} mm "
            f"({detector[1]}), wanted the patient nearer to the source; correct the distances"
        )
    found = Distances(detector[0], patient[0], (detector[1], patient[1]))
    if found.magnification > LARGEST_MAGNIFICATION:
        raise RadiographError(
            f"source to detector {found.detector:g} mm ({detector[1]}) over source to patient {found.patient:g} mm "
            f"({patient[1]}) magnifies {found.magnification:.3g} times, wanted at most {LARGEST_MAGNIFICATION:g}; "
            "correct the distances"
        )
    for factor, words in factors:
        most = AGREEMENT if words == _ESTIMATED else AGREEMENT_OF_CALIBRATION
        wanted = found.detector / support[0] if support and words == _ESTIMATED else found.magnification
        if abs(factor / wanted - 1.0) > most:
            raise RadiographError(
                f"{words}: found {factor:.4g}, wanted {wanted:.4g} as the distances say "
                f"({found.sources[0]}, {found.sources[1]}); correct what is wrong"
            )
    return found


_ESTIMATED = "EstimatedRadiographicMagnificationFactor"


def _magnifications(tags: Tags) -> list[tuple[float, str]]:
    found = []
    # Systems write 1 where they don't know: no patient is of no thickness.
    if tags.magnification not in (None, 0.0, 1.0):
        found.append((float(tags.magnification or 0.0), _ESTIMATED))
    imager, calibrated = _known(tags.imager_spacing), _calibrated(tags)
    if imager is not None and calibrated is not None:
        _check_spacing("ImagerPixelSpacing", imager)
        _check_spacing("PixelSpacing", calibrated)
        found.append((imager[0] / calibrated[0], "ImagerPixelSpacing over calibrated PixelSpacing"))
    for factor, words in found:
        if not 1.0 - AGREEMENT <= factor <= LARGEST_MAGNIFICATION:
            raise RadiographError(
                f"{words}: found {factor:.4g}, wanted 1 to {LARGEST_MAGNIFICATION:g}; correct it at the source"
            )
    return found


def _before_support(tags: Tags, given: Geometry) -> float | None:
    """The given distance source to patient of a digital radiograph, where a spine may be there before what the file's
    own is that of: by PS3.3 C.8.11.5 the side of table or bucky next to the patient. Else None."""
    told, spine = tags.source_patient, given.source_patient_mm
    if told is None or spine is None or not _digital(tags):
        return None
    return spine if spine >= SOURCE_MM[0] and AGREEMENT * told < told - spine <= DEEPEST_MM else None


def _digital(tags: Tags) -> bool:
    """Whether the file is of the kind DX, whose DistanceSourceToPatient is that of table or bucky."""
    return tags.image_type.startswith("Digital X-Ray")


def _distance(keyword: str, tag: float | None, key: str, given: float | None) -> tuple[float, str] | None:
    zero = tag == 0.0  # systems write 0 where they don't know
    if tag is not None and not zero:
        _check_distance(keyword, tag)
        if given is not None:
            _check_agreement(keyword, tag, key, given, AGREEMENT)
        return tag, f"DICOM {keyword}"
    if given is None:
        return None
    _check_distance(f"given {key}", given)
    return given, f"given {key}" + (f" since {keyword} is 0" if zero else "")


def _check_distance(what: str, value: float) -> None:
    if not SOURCE_MM[0] <= value <= SOURCE_MM[1]:
        raise RadiographError(f"{what}: found {value:g} mm, wanted {SOURCE_MM[0]:g} to {SOURCE_MM[1]:g} mm; correct it")


def spacing(tags: Tags, given: Geometry, magnification: float | None) -> Spacing:
    """Pixel pitch at the detector.

    A spacing of 0\\0 in the file counts as unknown; the source says so.

    Parameters
    ----------
    magnification : of the patient plane; None if the distances are not known, which only a spacing at the detector
        can do without.

    Raises
    ------
    MissingValue : it can't be told.
    RadiographError : it is implausible, or two statements contradict each other.
    """
    shape = pixel_shape(tags)
    found = _found_spacing(tags, given, magnification, shape)
    _check_spacing(_first_words(found), (found.row, found.column))
    if given.imager_pixel_mm is not None:
        most = AGREEMENT_OF_CALIBRATION if found.source.startswith("DICOM PixelSpacing") else AGREEMENT
        for value in (found.row, found.column):
            _check_agreement(_first_words(found), value, "imager_pixel_mm", given.imager_pixel_mm, most)
    if given.scale is not None:
        _check_scale(found, given.scale, magnification)
    extent = max(tags.rows * found.row, tags.columns * found.column)
    if extent > LARGEST_IMAGE_MM:
        raise RadiographError(
            f"{_first_words(found)}: found an image of {extent:.0f} mm, wanted at most {LARGEST_IMAGE_MM:g} mm; "
            "correct the pitch"
        )
    return found


def _found_spacing(
    tags: Tags, given: Geometry, magnification: float | None, shape: tuple[float, str] | None
) -> Spacing:
    imager, calibrated = _known(tags.imager_spacing), _calibrated(tags)
    if imager is not None:
        _check_spacing("ImagerPixelSpacing", imager)
        return Spacing(*imager, "DICOM ImagerPixelSpacing, at the detector")
    others = _others(tags, calibrated is not None)
    unused = f"; not used: {', '.join(others)}" if others else ""
    if calibrated is not None:
        _check_spacing("PixelSpacing", calibrated)
        if magnification is None:
            raise MissingValue("PixelSpacing is at the patient, and the magnification is not known; add the distances")
        words = f"calibrated by {tags.calibration} at the patient plane, times the magnification{unused}"
        return Spacing(calibrated[0] * magnification, calibrated[1] * magnification, f"DICOM PixelSpacing, {words}")
    aspect, says = shape or (1.0, "")
    if given.imager_pixel_mm is not None:
        if abs(aspect - 1.0) > AGREEMENT:
            raise RadiographError(
                f"{says}, pixels {aspect:.4g} times as high as wide, wanted square ones for the given imager_pixel_mm "
                f"{given.imager_pixel_mm:g}; take it out of subject.json and give a scale"
            )
        pitch = given.imager_pixel_mm
        _check_spacing("given imager_pixel_mm", (pitch, pitch))
        return Spacing(pitch, pitch, f"given imager_pixel_mm, at the detector{unused}")
    if given.scale is not None:
        return _scaled(given.scale, aspect, magnification, tags, unused)
    words = f"found {' and '.join(others)}, wanted ImagerPixelSpacing" if others else "no ImagerPixelSpacing"
    raise MissingValue(
        f"{words}; add xray.imager_pixel_mm (pixel pitch at the detector) to subject.json, or xray.scale (a known "
        "length in this image)"
    )


def _first_words(found: Spacing) -> str:
    return found.source.partition(";")[0].partition(",")[0]


def _known(pair: tuple[float, float] | None) -> tuple[float, float] | None:
    """A spacing of the file; None where systems wrote 0 since they didn't know."""
    return None if pair == (0.0, 0.0) else pair


def _calibrated(tags: Tags) -> tuple[float, float] | None:
    return _known(tags.pixel_spacing) if tags.calibration in ("GEOMETRY", "FIDUCIAL") else None


def _others(tags: Tags, calibrated: bool) -> list[str]:
    """What the file says about spacing without its being a pitch at the detector, and why it is none."""
    found = []
    for keyword, pair, why in (
        ("ImagerPixelSpacing", tags.imager_spacing, ""),
        ("PixelSpacing", None if calibrated else tags.pixel_spacing, " of no known plane"),
        ("NominalScannedPixelSpacing", tags.scanned_spacing, " on the film"),
    ):
        if pair is not None:
            found.append(f"{keyword} {_pair(pair)}{why if _known(pair) else ' (zero)'}")
    return found


def _pair(pair: tuple[float, float]) -> str:
    return "{:g}\\{:g} mm".format(*pair)


def pixel_shape(tags: Tags) -> tuple[float, str] | None:
    """Height of a pixel over its width as the file says it, and where; None if it doesn't.

    Raises
    ------
    RadiographError : a side of 0 or less, or two statements that contradict each other.
    """
    shapes = [] if tags.aspect is None else [(tags.aspect, f"PixelAspectRatio: found {tags.aspect:.4g}")]
    for keyword, pair in (
        ("ImagerPixelSpacing", tags.imager_spacing),
        ("PixelSpacing", tags.pixel_spacing),
        ("NominalScannedPixelSpacing", tags.scanned_spacing),
    ):
        if pair is None or _known(pair) is None:
            continue
        if min(pair) <= 0.0:
            raise RadiographError(f"{keyword}: found {_pair(pair)}, wanted two lengths above 0 mm; correct it")
        shapes.append((pair[0] / pair[1], f"{keyword}: found {_pair(pair)}"))
    for aspect, says in shapes[1:]:
        if abs(aspect / shapes[0][0] - 1.0) > AGREEMENT:
            first = shapes[0][1].replace(": found", "")
            raise RadiographError(f"{says}, wanted pixels of the same shape as {first} says; correct what is wrong")
    return shapes[0] if shapes else None


def _check_spacing(what: str, pair: tuple[float, float]) -> None:
    if not all(PIXEL_MM[0] <= value <= PIXEL_MM[1] for value in pair):
        raise RadiographError(
            f"{what}: found {_pair(pair)}, wanted {PIXEL_MM[0]:g} to {PIXEL_MM[1]:g} mm; correct it at the source"
        )
    if not 1.0 / LARGEST_ASPECT <= pair[0] / pair[1] <= LARGEST_ASPECT:
        raise RadiographError(f"{what}: found {_pair(pair)}, wanted sides of at most {LARGEST_ASPECT:g} to 1")


def _check_agreement(what: str, value: float, key: str, given: float, most: float) -> None:
    if not math.isfinite(given) or abs(value - given) > most * abs(value):
        raise RadiographError(
            f"{what}: found {value:g} mm, wanted {given:g} mm to {100 * most:g} % as xray.{key} of subject.json says, "
            "or xray.images for this picture; correct what is wrong, or give what holds for single pictures "
            "in xray.images"
        )


def _span(scale: Scale, aspect: float, tags: Tags | None = None) -> float:
    """Of the scale in the image, in widths of a pixel."""
    (c0, r0), (c1, r1) = scale.ends_px
    if tags is not None and not (
        max(c0, c1) <= tags.columns - 0.5 and max(r0, r1) <= tags.rows - 0.5 and min(c0, c1, r0, r1) >= -0.5
    ):
        raise RadiographError(
            f"scale: found an end of the {scale.what} outside the image, wanted both in its {tags.columns} columns and "
            f"{tags.rows} rows"
        )
    return math.hypot(c1 - c0, aspect * (r1 - r0))


def _scaled(scale: Scale, aspect: float, magnification: float | None, tags: Tags, unused: str) -> Spacing:
    pixels = _span(scale, aspect, tags)
    if not pixels >= FEWEST_PIXELS:
        raise RadiographError(
            f"scale: found {pixels:.3g} pixels over the {scale.what}, wanted {FEWEST_PIXELS:g} or more (5 % of error)"
        )
    column = scale.length_mm / pixels * _to_detector(scale, magnification)
    words = "at the detector" if scale.plane == "detector" else "at the patient plane, times the magnification"
    source = f"{scale.what} of {scale.length_mm:g} mm over {pixels:.1f} pixels {words}{unused}"
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
            f"{_first_words(found)}: found {length:.4g} mm for the {scale.what}, wanted {scale.length_mm:g} "
            "mm as xray.scale of subject.json says; correct what is wrong"
        )
