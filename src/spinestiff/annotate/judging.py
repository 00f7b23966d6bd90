"""What can be told of marks: whether an image is complete, its Cobb angle, what a fit still lacks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from pydantic import ValidationError

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.annotate.draft import DraftImage
from spinestiff.annotate.radiographs import KeptRadiographs, first_on, upright
from spinestiff.curves.cobb import CobbReading, read_cobb
from spinestiff.curves.corner_files import ImageCorners
from spinestiff.errors import RadiographError, SpinestiffError, SubjectError
from spinestiff.imaging.features import view_kind
from spinestiff.imaging.projection import XRayView
from spinestiff.subject.annotation_record import (
    FEWEST_OF_VIEW,
    FEWEST_VERTEBRAE,
    Annotation,
    ImageAnnotation,
)
from spinestiff.subject.folder import Subject
from spinestiff.subject.image_names import PushImage, frame_image
from spinestiff.subject.marks import check_marks_in
from spinestiff.subject.record_reading import complaint_of
from spinestiff.subject.records import ANNOTATION_FILE, SCHEMA_VERSION, SUBJECT_FILE
from spinestiff.words import counted

SHOWN = 3
"""Of the values that subject.json does not know yet; ``spinestiff inspect`` lists all."""


@dataclass(frozen=True)
class Judged:
    """What can be told of the marks in one image.

    Attributes
    ----------
    vertebrae : how many have corners.
    problem : why the image is not complete, in words; empty where it is.
    cobb : what ``spinestiff cobb`` reads, in frontal images with two vertebrae or more that can be read and do not
        stand on their heads.
    """

    vertebrae: int
    problem: str
    cobb: CobbReading | None


class Judge:
    """Judges the marks of one subject.

    Parameters
    ----------
    images : names of those that are there. absent : of those that a fit needs and that are not there yet.
    views : names of radiographs of pushes from other sides, and whether a fit needs their marks.
    """

    def __init__(
        self,
        subject: Subject,
        radiographs: KeptRadiographs,
        images: Sequence[str],
        absent: Sequence[str],
        views: Mapping[str, bool],
    ) -> None:
        self._subject, self._radiographs = subject, radiographs
        self._images, self._absent, self._views = images, absent, views

    def told(self, name: str, marks: Mapping[str, DraftImage]) -> Judged:
        """What can be told of the marks in an image: complete or why not, and its Cobb angle.

        Parameters
        ----------
        marks : of all images, by name; a push's further frames are held against its first.
        """
        problem, cobb = "", None
        try:
            cobb = self._cobb(name, marks[name])
            self._checked(name, marks)
            self._radiographs.view(name)
        except SpinestiffError as error:
            problem = str(error)
        for where in (f"{self._subject.folder / ANNOTATION_FILE}: ", f"images.{name}.", f"{name}.", "vertebrae: "):
            problem = problem.removeprefix(where)
        return Judged(len(marks[name].vertebrae), problem, cobb)

    def missing(self, marks: Mapping[str, DraftImage]) -> list[str]:
        """What a fit still needs, a line each, in words; empty when there is all."""
        lines = [f"{name}: no radiograph in the folder yet" for name in self._absent]
        if open_ := [gap.field for gap in self._subject.gaps]:
            more = f" and {len(open_) - SHOWN} more" if len(open_) > SHOWN else ""
            lines.append(f"{SUBJECT_FILE}: not known yet: {', '.join(open_[:SHOWN])}{more}")
        for name in self._images:
            image = marks.get(name, DraftImage())
            if image.empty and not self._views.get(name, True):
                continue
            fewest = FEWEST_OF_VIEW if name in self._views else FEWEST_VERTEBRAE
            problem = self.told(name, {**marks, name: image}).problem
            if not image.vertebrae:
                lines.append(f"{name}: no vertebra marked yet")
            elif len(image.vertebrae) < fewest:
                found = counted(len(image.vertebrae), "vertebra", "vertebrae")
                lines.append(f"{name}: {found}, wanted at least {fewest}")
            elif problem:
                lines.append(f"{name}: {problem}")
        for name in sorted(set(marks) - set(self._images)):
            problem = "" if marks[name].empty else self.told(name, marks).problem
            if problem:
                lines.append(f"{name}: {problem}")
        return lines

    def complete(self, marks: Mapping[str, DraftImage]) -> dict[str, ImageAnnotation]:
        """The images as a fit will take them, those alone that are complete, beside each other."""
        found = {name: self._complete(name, marks) for name in marks}
        return {name: image for name, image in found.items() if image is not None}

    def _complete(self, name: str, marks: Mapping[str, DraftImage]) -> ImageAnnotation | None:
        try:
            return self._checked(name, marks)
        except SubjectError:
            return None

    def _checked(self, name: str, marks: Mapping[str, DraftImage]) -> ImageAnnotation:
        """The image, checked as a fit will, beside the push's first frame if that is complete. Raises SubjectError."""
        image = marks[name].whole()
        of_push = PushImage.named(name)
        push = frame_image(of_push.push) if of_push and of_push.later else ""
        first = self._complete(push, marks) if push in marks else None
        beside = {push: first} if first else {}
        subject = self.with_marks({**beside, name: image})
        # A radiograph that can't be read today doesn't make its annotation a draft.
        with suppress(RadiographError):
            check_marks_in(subject, (name,), self._radiographs.view(name))
        return image

    def with_marks(self, images: dict[str, ImageAnnotation]) -> Subject:
        """The subject with these annotated images and no others. Raises SubjectError where they contradict another."""
        try:
            return replace(self._subject, annotation=Annotation(schema_version=SCHEMA_VERSION, images=images))
        except ValidationError as error:
            raise SubjectError(complaint_of(error).removeprefix("images: ")) from None

    def _cobb(self, name: str, marks: DraftImage) -> CobbReading | None:
        view = self._radiographs.view(name)
        if view_kind(view) != "frontal" or not upright(view) or len(marks.vertebrae) < 2:
            return None
        seen = as_seen(view, name, marks)
        # Angles are those of the body: of pixels that are not square, as tall as they are wide.
        square = view.pixel_spacing / view.pixel_spacing[0]
        reading = read_cobb(replace(seen, corners=seen.corners * square))
        return None if reading.largest is None else reading


def as_seen(view: XRayView, name: str, marks: DraftImage) -> ImageCorners:
    """Marked vertebrae of an image as other programs take them: corners as seen in it, head to foot.

    Raises
    ------
    SubjectError : no vertebra is marked, or as ``first_on``.
    """
    side = first_on(view)
    levels = tuple(level for level in VERTEBRAE if level in marks.vertebrae)
    quads = np.array([marks.vertebrae[level] for level in levels], dtype=float).reshape(-1, 4, 2)
    # The other order is its own inverse: left and right change places.
    seen = quads[:, [0, 1, 2, 3] if side == "left" else [1, 0, 3, 2]]
    return ImageCorners(name, levels, seen, "", "px", side)
