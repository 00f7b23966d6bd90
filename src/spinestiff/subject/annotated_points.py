"""What an annotation marks in an image: corners and pedicles in mm on the detector, points on what is held in pixels.

Each point has to lie in the picture, and left, right, head and foot where its view has them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.arrays import Floats
from spinestiff.errors import SubjectError
from spinestiff.imaging.features import VertebraCorners, picture_axes, view_kind
from spinestiff.subject.annotation_record import ImageAnnotation
from spinestiff.subject.folder import Subject
from spinestiff.subject.records import ANNOTATION_FILE, PushRecord

if TYPE_CHECKING:
    from spinestiff.imaging.projection import XRayView


def image_corners(subject: Subject, image: str, view: XRayView) -> VertebraCorners:
    """Annotated corners of an image in mm on the detector.

    Raises
    ------
    SubjectError : the image has no annotation, a corner lies outside it, left and right (anterior and posterior) or
        head and foot are swapped for this view.
    """
    where, annotated = _annotated(subject, image)
    names, pixels = tuple(annotated.vertebrae), annotated.pixels()
    for name, quad in zip(names, pixels):
        check_inside(f"{where}.vertebrae.{name}", "corner", quad, view, "leave out a vertebra that is not wholly in it")
    corners = view.from_pixels(pixels)
    first, up = picture_axes(view)
    for name, quad in zip(names, corners):
        if (quad[0] + quad[1] - quad[2] - quad[3]) @ up <= 0.0:
            raise SubjectError(f"{where}.{name}: the superior corners lie below the inferior ones; check their order")
        if (quad[0] + quad[3] - quad[1] - quad[2]) @ first <= 0.0:
            raise SubjectError(
                f"{where}.{name}: corners are mirrored for this view (patient's left, in a lateral view anterior, "
                "comes first); check their order and the orientation of the image"
            )
    return VertebraCorners(names, corners)


def push_corners(subject: Subject, push: PushRecord, view: XRayView) -> Mapping[int, VertebraCorners]:
    """Annotated corners of a push by frame (0-based), the first among them, in mm on the detector.

    Raises
    ------
    SubjectError : as ``image_corners``.
    """
    names = {frame: push.frame_image(frame) for frame in range(len(push.forces_n))}
    return {
        frame: image_corners(subject, name, view)
        for frame, name in names.items()
        if frame == 0 or (name in subject.annotation.images and subject.annotation.images[name].vertebrae)
    }


def image_pedicles(subject: Subject, image: str, view: XRayView) -> tuple[tuple[str, ...], Floats]:
    """Names and marked pedicles (Nv, 2, 2), left and right, in mm on the detector of ``view``; none if none are given.

    Raises
    ------
    SubjectError : a pedicle lies outside the image, or a left one on the right of the patient in this view.
    """
    where, annotated = _annotated(subject, image)
    names = tuple(sorted(annotated.pedicles, key=VERTEBRAE.index))
    points = np.array([annotated.pedicles[name] for name in names], dtype=float).reshape(-1, 2, 2)
    for name, pair in zip(names, points):
        check_inside(f"{where}.pedicles.{name}", "pedicle", pair, view, "leave out pedicles that can't be seen")
    points = view.from_pixels(points)
    first, _ = picture_axes(view)
    for name, (left, right) in zip(names, points):
        if view_kind(view) == "frontal" and (left - right) @ first <= 0.0:
            raise SubjectError(f"{where}.pedicles.{name}: the left one lies right of the right one; check their order")
    return names, points


def check_inside(where: str, what: str, points: Floats, view: XRayView, advice: str) -> None:
    """Raise SubjectError unless points (n, 2), column and row, lie in the picture, up to its pixels' outer edges."""
    rows, columns = view.shape
    for column, row in points:
        if not (-0.5 <= column <= columns - 0.5 and -0.5 <= row <= rows - 0.5):
            raise SubjectError(
                f"{where}: found a {what} at column {column:g}, row {row:g}, wanted it in the image of {columns} "
                f"columns and {rows} rows; {advice}"
            )


def image_supports(subject: Subject, image: str, view: XRayView | None = None) -> Mapping[str, Floats]:
    """Annotated support points (n, 2) in pixels (column, row), by "pelvis" and "shoulder"; empty if none are given.

    Raises
    ------
    SubjectError : a point lies outside the image of ``view``, if that is given.
    """
    where, annotated = _annotated(subject, image)
    found: dict[str, Floats] = {name: np.array(points) for name, points in annotated.supports.items()}
    if view is not None:
        for name, points in found.items():
            check_inside(f"{where}.supports.{name}", "point", points, view, "leave out points that can't be seen")
    return found


def _annotated(subject: Subject, image: str) -> tuple[str, ImageAnnotation]:
    where = f"{subject.folder / ANNOTATION_FILE}: images.{image}"
    if image not in subject.annotation.images:
        raise SubjectError(f"{where}: missing; wanted the vertebra corners of this image")
    return where, subject.annotation.images[image]
