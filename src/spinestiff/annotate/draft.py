"""An annotation in work: what ``annotation.json`` can't hold yet waits beside it in ``annotation.draft.json``.

``annotation.json`` holds whole images only: at least eight vertebrae, in order. Whatever else was marked is a draft.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, ValidationError

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.errors import SubjectError
from spinestiff.files import read_text
from spinestiff.formats import parse_json
from spinestiff.subject.annotation_record import ImageAnnotation
from spinestiff.subject.record_reading import Record, complaint_of
from spinestiff.subject.records import Point, VertebraName

DRAFT_FILE = "annotation.draft.json"
MOST_POINTS = 50
LARGEST_PIXEL = 100_000.0
"""No radiograph has as many rows or columns; larger coordinates are accidents."""


def _near(point: Point) -> Point:
    if max(abs(point[0]), abs(point[1])) > LARGEST_PIXEL:
        raise ValueError(f"found a point at {point}, wanted pixels of the image")
    return point


Near = Annotated[Point, AfterValidator(_near)]
Points = Annotated[tuple[Near, ...], Field(strict=False, max_length=MOST_POINTS)]
Corners = Annotated[tuple[Near, Near, Near, Near], Field(strict=False)]
Centres = Annotated[tuple[Near, Near], Field(strict=False)]


class DraftImage(Record):
    """Marks in one image, in pixels as in ``ImageAnnotation``, complete or not.

    Attributes
    ----------
    vertebrae : four corners each, in the order of ``ImageAnnotation``; any number of vertebrae.
    supports, pedicles : as in ``ImageAnnotation``.
    spine : points along the spine from which boxes are proposed.
    ends : the vertebrae of the first and the last of ``spine``; None where nobody has said, and the outermost count.
    unseen : of the vertebrae, those that were proposed and that nobody has looked at or moved yet.
    guessed : of vertebrae with one pedicle set by hand the other, 0 left or 1 right, which is guessed.
    """

    vertebrae: dict[VertebraName, Corners] = Field(default_factory=dict)
    supports: dict[Literal["pelvis", "shoulder"], Points] = Field(default_factory=dict)
    pedicles: dict[VertebraName, Centres] = Field(default_factory=dict)
    spine: Points = ()
    ends: Annotated[tuple[VertebraName, VertebraName], Field(strict=False)] | None = None
    unseen: Annotated[tuple[VertebraName, ...], Field(strict=False)] = ()
    guessed: dict[VertebraName, Literal[0, 1]] = Field(default_factory=dict)

    @property
    def empty(self) -> bool:
        """Whether nothing at all is marked."""
        return not (self.vertebrae or self.supports or self.pedicles or self.spine)

    def whole(self) -> ImageAnnotation:
        """The image as ``annotation.json`` takes it.

        Raises
        ------
        SubjectError : in words, where it is not complete; a proposal that nobody has looked at and a guess are none.
        """
        if unseen := [name for name in self.vertebrae if name in self.unseen]:
            raise SubjectError(f"{len(unseen)} of {len(self.vertebrae)} vertebrae are proposed and not looked at yet")
        if half := [name for name in VERTEBRAE if name in self.pedicles and name in self.guessed]:
            raise SubjectError(f"one pedicle of {', '.join(half)} is only guessed yet; choose it, or click where it is")
        marks = self.model_dump(mode="json", exclude={"spine", "ends", "unseen", "guessed"})
        marks["supports"] = {name: points for name, points in self.supports.items() if points}
        try:
            return ImageAnnotation.model_validate(marks)
        except ValidationError as error:
            raise SubjectError(complaint_of(error)) from None


class Draft(Record):
    """``annotation.draft.json``, and what the page sends.

    Attributes
    ----------
    schema_version : 1.
    images : by name, as in ``Annotation``. In the file, those alone that ``annotation.json`` can't hold yet; one that
        is in both counts as here.
    """

    schema_version: Literal[1]
    images: dict[str, DraftImage]

    def record(self) -> dict[str, Any]:
        """As JSON, without what is empty."""
        images = {
            name: image.model_dump(mode="json", exclude_defaults=True)
            for name, image in self.images.items()
            if not image.empty
        }
        return {"schema_version": self.schema_version, "images": images}


def parse_draft(text: str, where: str) -> Draft:
    """A draft from JSON text.

    Raises
    ------
    SubjectError : no JSON, unknown keys, names that are no vertebra, numbers out of range (field, found, wanted).
    """
    parse_json(text, where)
    try:
        draft = Draft.model_validate_json(text)
    except ValidationError as error:
        raise SubjectError(f"{where}: {complaint_of(error)}") from None
    return draft


def read_draft(path: Path) -> Draft:
    """A draft from a file. Raises SubjectError."""
    return parse_draft(read_text(path), str(path))
