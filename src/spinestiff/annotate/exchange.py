"""Corners of a session to and from files of other programs: CSV and Slicer markups (``curves.corner_files``)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np

from spinestiff.annotate.draft import DraftImage
from spinestiff.annotate.judging import as_seen
from spinestiff.annotate.radiographs import first_on
from spinestiff.annotate.session import AnnotationSession
from spinestiff.arrays import Floats
from spinestiff.curves.corner_files import ImageCorners, UnreadableImage, read_corner_file, write_corners
from spinestiff.curves.corner_markups import UNIT_KEY
from spinestiff.errors import SubjectError
from spinestiff.imaging.radiograph import Radiograph
from spinestiff.subject.folder import check_image_name
from spinestiff.words import printable

Form = Literal["csv", "slicer"]
WIDTHS_MM = (14.0, 75.0)
"""Of a vertebral body on a detector, from a small child's T1 from the side to a large man's L5, magnified 1.3 times."""
NEARLY_ONE = 0.005
"""By which a pixel may differ from a millimetre for both to be the same place: 5 pixels in 1,000."""
SLICERS_SPACING = "DICOM ImagerPixelSpacing"
"""Beginning of the source of the spacing that Slicer gives a radiograph, too."""
# Names of our own: nothing of a name that a page sends becomes a path.
FILES: Mapping[Form, str] = {"csv": "corners.csv", "slicer": "corners.mrk.json"}


def exported(session: AnnotationSession, form: Form) -> bytes:
    """All marked vertebrae as a file. Raises SubjectError where nothing is marked."""
    images = [
        as_seen(session.radiographs.view(name), name, marks) for name, marks in session.marks.items() if marks.vertebrae
    ]
    if not images:
        raise SubjectError("no vertebra is marked yet; there is nothing to export")
    with TemporaryDirectory() as folder:
        path = Path(folder) / FILES[form]
        write_corners(path, images)
        return path.read_bytes()


def imported(
    session: AnnotationSession, file_name: str, text: str, shown: str
) -> tuple[dict[str, DraftImage], list[str]]:
    """Marks with the file's vertebrae in place of those there were, by image, and what should be known of it.

    Parameters
    ----------
    file_name : tells the format by its end, nothing else.
    shown : the image that a file with one image of another name is meant for.

    Raises
    ------
    SubjectError : no such format, a fault of the file, images that this subject has not, corners in mm of a
        scene or of a unit that can't be told.
    """
    end = file_name.lower()
    kind = next((kind for kind in (".csv", ".mrk.json", ".json") if end.endswith(kind)), None)
    if kind is None:
        raise SubjectError("a file of corners ends in .csv, .mrk.json or .json")
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"corners{kind}"
        path.write_text(text, encoding="utf-8")
        try:
            found = read_corner_file(path)
        except SubjectError as error:
            raise SubjectError(str(error).replace(str(path), "the file")) from None
    marks, said = {}, []
    for image in found.images:
        if isinstance(image, UnreadableImage):
            said.append(f"{image.image} is left out: {image.reason}.")
            continue
        name = shown if len(found.images) == 1 and not _known(session, image.image) else image.image
        check_image_name(session.subject, name, printable(file_name))
        has_mm = session.radiographs.has_mm(name)
        pixels, words = in_pixels(image, session.radiographs.frames(name)[0] if has_mm else None)
        said += words
        quads = replace(pixels, first_on=first_on(session.radiographs.view(name))).annotation_quads()
        before = session.marks.get(name, DraftImage())
        vertebrae = {level: tuple(map(tuple, quad)) for level, quad in zip(image.levels, quads.tolist())}
        marks[name] = DraftImage.model_validate({**before.model_dump(), "vertebrae": vertebrae})
    if not marks:
        raise SubjectError(" ".join(said) or "the file holds no image")
    return marks, said


def in_pixels(image: ImageCorners, radiograph: Radiograph | None) -> tuple[ImageCorners, list[str]]:
    """Corners of a file in the radiograph's pixels, and what should be known of the unit they had.

    ``radiograph`` : None where its millimetres are not known yet.

    Slicer writes those of a picture in mm where the picture has a spacing, and does not say so. A vertebra is too wide
    or too narrow in one of the two units, unless a pixel is nearly a millimetre.

    Raises
    ------
    SubjectError : which unit it is can't be told, or how many mm a pixel had where the file was made.
    """
    if image.unit == "px":
        return image, []
    if image.unit == "mm":
        raise SubjectError(
            f"{image.image}: the corners are in mm of a scene, and where the radiograph lay in it is not known; wanted "
            "pixels (column, row), e.g. as CSV"
        )
    if radiograph is None:
        raise SubjectError(
            f"{image.image}: the file does not say whether its corners are pixels or mm, and the radiograph not how "
            f"many mm a pixel has; write CSV in pixels, or add {UNIT_KEY!r}: 'pixel' to the list if they are pixels"
        )
    a_pixel = radiograph.view.pixel_spacing
    mm_of = {"px": a_pixel, "mm": np.ones(2)}
    if np.abs(a_pixel - 1.0).max() <= NEARLY_ONE:
        return replace(image, unit="px"), []
    may_be = [unit for unit, scale in mm_of.items() if WIDTHS_MM[0] <= _width(image.corners * scale) <= WIDTHS_MM[1]]
    if may_be == ["px"]:
        return replace(image, unit="px"), [f"{image.image} names no unit; its vertebrae are as wide as in pixels."]
    if may_be != ["mm"]:
        wide = " or ".join(f"{_width(image.corners * scale):.0f} mm (in {unit})" for unit, scale in mm_of.items())
        raise SubjectError(
            f"{image.image}: the file does not say whether its corners are pixels or mm, and the vertebrae would be "
            f"{wide} wide; write them as CSV in pixels, or add {UNIT_KEY!r}: 'pixel' to the list if they are pixels"
        )
    source = radiograph.provenance.get("pixel spacing", "")
    if not source.startswith(SLICERS_SPACING):
        raise SubjectError(
            f"{image.image}: the corners are in mm, but the radiograph has no ImagerPixelSpacing (its pixel: "
            f"{source or 'not known'}), so that the mm of a pixel in Slicer are not known; write them as CSV in pixels"
        )
    told = (
        f"{image.image} is in mm by the width of its vertebrae; converted by {a_pixel[0]:.4g} mm a pixel: look at it."
    )
    return replace(image, corners=image.corners / a_pixel, unit="px"), [told]


def _width(corners: Floats) -> float:
    """Of the middle one of the vertebrae (V, 4, 2), mean of top and bottom."""
    edges = np.linalg.norm(corners[:, [1, 2]] - corners[:, [0, 3]], axis=-1)
    return float(np.median(edges.mean(1)))


def _known(session: AnnotationSession, name: str) -> bool:
    try:
        check_image_name(session.subject, name)
    except SubjectError:
        return False
    return True
