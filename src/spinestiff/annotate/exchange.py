"""Corners of a session to and from files of other programs: CSV and Slicer markups (``study.corner_files``)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

from spinestiff.annotate.draft import DraftImage
from spinestiff.annotate.session import AnnotationSession, first_on
from spinestiff.curves.corner_files import UnreadableImage, read_corner_file, write_corners
from spinestiff.errors import SubjectError
from spinestiff.subject.folder import check_image_name

Form = Literal["csv", "slicer"]
# Names of our own: nothing of a name that a page sends becomes a path.
FILES: Mapping[Form, str] = {"csv": "corners.csv", "slicer": "corners.mrk.json"}


def exported(session: AnnotationSession, form: Form) -> bytes:
    """All marked vertebrae as a file. Raises SubjectError where nothing is marked."""
    images = [session.seen(name, marks) for name, marks in session.marks.items() if marks.vertebrae]
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
    SubjectError : no such format, a fault of the file, images that this subject has not, corners in mm.
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
        check_image_name(session.subject, name)
        if image.unit == "mm":
            raise SubjectError(f"{image.image}: the corners are in mm of a scene, wanted pixels (column, row)")
        if image.unit == "unstated":
            said.append(f"{image.image} names no unit; its corners were taken for pixels.")
        quads = replace(image, first_on=first_on(session.view(name)), unit="px").annotation_quads()
        before = session.marks.get(name, DraftImage())
        vertebrae = {level: tuple(map(tuple, quad)) for level, quad in zip(image.levels, quads.tolist())}
        marks[name] = DraftImage.model_validate({**before.model_dump(), "vertebrae": vertebrae})
    if not marks:
        raise SubjectError(" ".join(said) or "the file holds no image")
    return marks, said


def _known(session: AnnotationSession, name: str) -> bool:
    try:
        check_image_name(session.subject, name)
    except SubjectError:
        return False
    return True
