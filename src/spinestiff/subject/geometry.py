"""What subject.json says about the X-ray geometry of one image, as the reader of radiographs takes it."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from spinestiff.errors import SubjectError
from spinestiff.imaging.dicom.millimetres import Geometry, Scale
from spinestiff.subject.annotation_record import Annotation
from spinestiff.subject.records import ScaleRecord, SubjectRecord, XRayRecord

AGREEMENT_OF_VERTEBRA = 0.1
"""Relative difference up to which a file's spacing agrees with a vertebra's known size; edges are seen no better."""


def image_geometry(
    record: SubjectRecord, annotation: Annotation | None, image: str, kind: Literal["frontal", "lateral"]
) -> Geometry:
    """The geometry given for an image.

    Parameters
    ----------
    annotation : resolves the vertebra of a scale; None if there is none yet.
    image : its name in the annotation. kind : what it is to be.

    Raises
    ------
    SubjectError : a scale by a vertebra that is not annotated in this image.
    """
    scale = (record.xray.scale or {}).get(image)
    found = geometry_without_scale(record.xray, image, kind)
    return found if scale is None else replace(found, scale=_scale(scale, annotation, image))


def geometry_without_scale(xray: XRayRecord, image: str, kind: Literal["frontal", "lateral"]) -> Geometry:
    """The same without a length that is marked in the image."""
    own = xray.of(image)
    return Geometry(
        source_detector_mm=own.source_detector_mm,
        source_patient_mm=own.source_patient_mm,
        imager_pixel_mm=own.imager_pixel_mm,
        view=kind if xray.orientation == "standard" else None,
        beam=own.beam if kind == "frontal" else None,
    )


def _scale(record: ScaleRecord, annotation: Annotation | None, image: str) -> Scale:
    if record.object_mm is not None and record.object_px is not None:
        return Scale(record.object_mm, record.object_px, record.plane or "patient", "calibration object")
    name, width = record.vertebra, record.width_mm
    annotated = None if annotation is None else annotation.images.get(image)
    if name is None or width is None or annotated is None or name not in annotated.vertebrae:
        raise SubjectError(f"xray.scale.{image}: {name} is not annotated in this image; wanted its corners")
    quad = np.array(annotated.vertebrae[name])
    # Corners go round: the first and the last lie on one side.
    one, other = (tuple(map(float, 0.5 * (quad[i] + quad[j]))) for i, j in ((0, 3), (1, 2)))
    return Scale(width, ((one[0], one[1]), (other[0], other[1])), "patient", f"vertebra {name}", AGREEMENT_OF_VERTEBRA)
