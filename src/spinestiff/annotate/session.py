"""One subject folder being annotated: its radiographs, its marks, and every change saved at once."""

from __future__ import annotations

import hashlib
import os
import re
from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock, RLock

import numpy as np
from pydantic import ValidationError

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.annotate.draft import DRAFT_FILE, Draft, DraftImage, read_draft
from spinestiff.curves.cobb import CobbReading, read_cobb
from spinestiff.curves.corner_files import ImageCorners, Side
from spinestiff.errors import ChangedElsewhere, RadiographError, SpinestiffError, SubjectError
from spinestiff.files import write_json
from spinestiff.imaging.dicom.tags import MissingValue
from spinestiff.imaging.features import picture_axes, view_kind
from spinestiff.imaging.projection import XRayView
from spinestiff.imaging.proposal import leans_of
from spinestiff.imaging.radiograph import Radiograph
from spinestiff.subject.annotation_record import (
    FEWEST_OF_VIEW,
    FEWEST_VERTEBRAE,
    FURTHER_VIEW,
    Annotation,
    ImageAnnotation,
)
from spinestiff.subject.folder import (
    Subject,
    annotatable,
    annotatable_views,
    check_image_name,
    check_radiograph_path,
    image_corners,
    image_pedicles,
    open_push,
    read_annotation,
    read_rest,
    read_unannotated,
    read_view,
    write_annotation,
)
from spinestiff.subject.record_reading import complaint_of
from spinestiff.subject.records import (
    ANNOTATION_FILE,
    LATERAL,
    REST_IMAGES,
    SCHEMA_VERSION,
    SUBJECT_FILE,
    ScaleRecord,
)
from spinestiff.words import counted

# Images whose frames stay in memory; a push of 1024 x 1024 has a few megabytes a frame.
KEPT = 3
FRONTAL = "rest/frontal"
STAND_IN = ScaleRecord(object_mm=6.0, object_px=((0.0, 0.0), (40.0, 0.0)), plane="detector")
"""A pixel 0.15 mm wide, where millimetres come from a vertebra still to be marked; no length is shown or kept."""
SHOWN = 3
"""Of the values that subject.json does not know yet; ``spinestiff inspect`` lists all."""
Pictures = tuple[tuple[str, int, int, int], ...]
_WRITING: dict[Path, AbstractContextManager[object]] = {}
_WRITING_LOCK = Lock()


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


@dataclass(frozen=True)
class _OnDisk:
    """What marks are made on: the rest radiographs, and digests of ``annotation.json`` and the draft."""

    pictures: Pictures
    annotation: str
    draft: str


class AnnotationSession:
    """The annotation of a subject folder, in work.

    Parameters
    ----------
    folder : with ``subject.json``, complete or not, and at least one radiograph; ``annotation.json`` may be missing, a
        draft is taken up.

    Attributes
    ----------
    revision : a hash of ``subject.json`` and the rest radiographs, then one of the marks as they were read or saved,
        the same in every session of the same files. A page saves on the revision that it was given; on another one of
        the same radiographs nothing but what is there already.
    images : names of those that are there. absent : of those that a fit needs and that are not there yet.
    views : names of radiographs of pushes from other sides, and whether a fit needs their marks.

    Raises
    ------
    SubjectError : the folder can't be annotated, in one line.
    """

    def __init__(self, folder: str | Path) -> None:
        self._made_of = _digest(Path(folder) / SUBJECT_FILE)
        self.subject = read_unannotated(folder)
        wanted = annotatable(self.subject.record)
        self.views = annotatable_views(self.subject.record)
        self.images = tuple(name for name in (*wanted, *self.views) if self._offered(name))
        needed = (*wanted, *(name for name, needed in self.views.items() if needed))
        self.absent = tuple(name for name in needed if name != LATERAL and name not in self.images)
        if not self.images:
            raise SubjectError(f"{folder}: no radiograph to annotate; wanted {', '.join(REST_IMAGES.values())}")
        self.lock = RLock()
        self._frames: OrderedDict[str, Sequence[Radiograph]] = OrderedDict()
        self._views: dict[str, XRayView] = {}
        self._drafted: dict[str, DraftImage] = {}
        self._seen = self._on_disk()
        self.reload()

    def _offered(self, name: str) -> bool:
        if not os.path.lexists(self.subject.image_path(name)):
            return False
        check_radiograph_path(self.subject, name)
        return True

    @property
    def annotation_path(self) -> Path:
        return self.subject.folder / ANNOTATION_FILE

    @property
    def draft_path(self) -> Path:
        return self.subject.folder / DRAFT_FILE

    def reload(self) -> None:
        """Take what is on disk: the draft if there is one, else ``annotation.json``, else nothing.

        Where it is not what was there, another rest radiograph included, pages that show that can no longer save.
        """
        with self.lock, writing(self.subject.folder):
            # Before anything is read: what is written meanwhile is noticed by the next save.
            found = self._on_disk()
            if self._seen.pictures != found.pictures:
                self._frames.clear()
                self._views.clear()
            images, self._drafted = self._read_marks()
            self._refuse_unknown(images)
            self.marks = images
            self._seen = found
            self.revision = self._token()

    def _read_marks(self) -> tuple[dict[str, DraftImage], dict[str, DraftImage]]:
        """All marks on disk, and those of the draft."""
        whole = _drafted(read_annotation(self.annotation_path)) if self.annotation_path.is_file() else {}
        drafted = read_draft(self.draft_path).images if self.draft_path.is_file() else {}
        return whole | drafted, drafted

    def save(self, draft: Draft, revision: str) -> str:
        """Write what the page holds, each file whole or not at all; returns the new revision.

        What is there already may be saved again on a revision from before: its page may have missed the answer.

        Raises
        ------
        ChangedElsewhere : another window or program has written since ``revision``, or replaced a rest radiograph.
        SubjectError : an unknown image, or a file can't be written.
        """
        with self.lock, writing(self.subject.folder):
            if revision != self.revision:
                if self._is_there(draft, revision):
                    return self.revision
                raise ChangedElsewhere(
                    "another window or program has changed the annotation; reload this page to go on"
                )
            found = self._on_disk()
            if self._seen.pictures != found.pictures:
                raise ChangedElsewhere(
                    "a radiograph at rest was replaced meanwhile; reload this page to mark the new one"
                )
            if self._seen != found:
                raise ChangedElsewhere(
                    f"{ANNOTATION_FILE} was changed by another program; reload this page to go on from there"
                )
            self._refuse_unknown(draft.images)
            marked = {name: image for name, image in draft.images.items() if not image.empty}
            whole = {name: image for name, marks in marked.items() if (image := self._complete(name, marks))}
            partial = {name: image for name, image in marked.items() if name not in whole}
            try:
                # What moves from one file to the other is in both for a moment, never in none.
                self._write_draft(partial | {name: marked[name] for name in self._drafted if name in marked})
                if whole or self.annotation_path.is_file():
                    annotation = Annotation(schema_version=SCHEMA_VERSION, images=whole)
                    write_annotation(self.subject.folder, annotation)
                self._write_draft(partial)
            finally:
                self._seen = self._on_disk()
            self.marks = marked
            self.revision = self._token()
            return self.revision

    def _is_there(self, draft: Draft, revision: str) -> bool:
        """Whether a page that shows these radiographs saves what the files hold, which are read anew."""
        if self._seen != self._on_disk():
            self.reload()
        same = _radiographs_of(revision) == _radiographs_of(self.revision)
        return same and self._as_kept(draft.images) == self._as_kept(self.marks)

    def _as_kept(self, marks: Mapping[str, DraftImage]) -> dict[str, ImageAnnotation | DraftImage]:
        """Marks as the files keep them: what only proposes goes with the draft."""
        return {name: self._complete(name, image) or image for name, image in marks.items() if not image.empty}

    def frames(self, name: str) -> Sequence[Radiograph]:
        """The radiographs of an image by its name in the annotation; of a push all, whichever frame is named.

        Those of a large file are read one by one, when they are asked for.

        Raises
        ------
        SubjectError : no image of that name. RadiographError : see ``read_radiographs``.
        """
        check_image_name(self.subject, name)
        image = image_of(name)
        with self.lock:
            if image not in self._frames:
                self._frames[image] = self._read(image)
                while len(self._frames) > KEPT:
                    self._frames.popitem(last=False)
            self._frames.move_to_end(image)
            return self._frames[image]

    def view(self, name: str) -> XRayView:
        """The view of an image, kept for good: every change of a mark asks for it. Raises as ``frames``."""
        image = image_of(name)
        with self.lock:
            if image not in self._views:
                self._views[image] = self.frames(name)[0].view
            return self._views[image]

    def leans(self, name: str) -> dict[str, float]:
        """How far vertebrae lean to the side, rad, as the frontal rest radiograph's marks tell a lateral radiograph."""
        front = self.marks.get(FRONTAL, DraftImage()).vertebrae
        if not front or FRONTAL not in self.images or view_kind(self.view(name)) != "lateral":
            return {}
        return leans_of(self.view(FRONTAL), {str(level): quad for level, quad in front.items()})

    def annotated(self) -> Subject:
        """The subject with what is complete of its annotation."""
        with self.lock:
            whole = {name: image for name, marks in self.marks.items() if (image := self._complete(name, marks))}
        return self._with(whole)

    def judged(self, name: str, marks: DraftImage) -> Judged:
        """What can be told of marks in an image: complete or why not, and its Cobb angle."""
        problem, cobb = "", None
        try:
            cobb = self._cobb(name, marks)
            self._checked(name, marks.whole())
            self.view(name)
        except SpinestiffError as error:
            problem = str(error)
        for where in (f"{self.annotation_path}: images.{name}.", f"{name}.vertebrae: "):
            problem = problem.removeprefix(where)
        return Judged(len(marks.vertebrae), problem, cobb)

    def missing(self, marks: Mapping[str, DraftImage]) -> list[str]:
        """What a fit still needs, a line each, in words; empty when there is all."""
        lines = [f"{name}: no radiograph in the folder yet" for name in self.absent]
        if open_ := [gap.field for gap in self.subject.gaps]:
            more = f" and {len(open_) - SHOWN} more" if len(open_) > SHOWN else ""
            lines.append(f"{SUBJECT_FILE}: not known yet: {', '.join(open_[:SHOWN])}{more}")
        for name in self.images:
            image = marks.get(name, DraftImage())
            if image.empty and not self.views.get(name, True):
                continue
            fewest = FEWEST_OF_VIEW if name in self.views else FEWEST_VERTEBRAE
            problem = self.judged(name, image).problem
            if not image.vertebrae:
                lines.append(f"{name}: no vertebra marked yet")
            elif len(image.vertebrae) < fewest:
                found = counted(len(image.vertebrae), "vertebra", "vertebrae")
                lines.append(f"{name}: {found}, wanted at least {fewest}")
            elif problem:
                lines.append(f"{name}: {problem}")
        for name in sorted(set(marks) - set(self.images)):
            problem = "" if marks[name].empty else self.judged(name, marks[name]).problem
            if problem:
                lines.append(f"{name}: {problem}")
        return lines

    def _with(self, images: dict[str, ImageAnnotation]) -> Subject:
        return replace(self.subject, annotation=Annotation(schema_version=SCHEMA_VERSION, images=images))

    def _read(self, name: str) -> Sequence[Radiograph]:
        xray = self.subject.record.xray
        scale = (xray.scale or {}).get(name)
        if scale is None or scale.vertebra is None:
            return _frames_of(self.subject, name)
        # The vertebra whose width is known is marked here, so that the picture has to be shown without its millimetres.
        others = {key: one for key, one in (xray.scale or {}).items() if key != name}
        try:
            return _frames_of(self._scaled(others), name)
        except MissingValue:
            return _frames_of(self._scaled({**others, name: STAND_IN}), name)

    def _scaled(self, scale: dict[str, ScaleRecord]) -> Subject:
        xray = self.subject.record.xray.model_copy(update={"scale": scale})
        return replace(self.subject, record=self.subject.record.model_copy(update={"xray": xray}))

    def _complete(self, name: str, marks: DraftImage) -> ImageAnnotation | None:
        try:
            return self._checked(name, marks.whole())
        except SubjectError:
            return None

    def _checked(self, name: str, image: ImageAnnotation) -> ImageAnnotation:
        """The image itself, checked as a fit will. Raises SubjectError."""
        try:
            Annotation(schema_version=SCHEMA_VERSION, images={name: image})
        except ValidationError as error:
            raise SubjectError(complaint_of(error).removeprefix("images: ")) from None
        try:
            view = self.view(name)
        except RadiographError:
            # A radiograph that can't be read today doesn't make its annotation a draft.
            return image
        subject = self._with({name: image})
        image_corners(subject, name, view)
        image_pedicles(subject, name, view)
        return image

    def seen(self, name: str, marks: DraftImage) -> ImageCorners:
        """Marked vertebrae as other programs take them: corners as seen in the image, head to foot.

        Raises
        ------
        SubjectError : no vertebra is marked, or as ``first_on``. RadiographError : as ``frames``.
        """
        side = first_on(self.view(name))
        levels = tuple(level for level in VERTEBRAE if level in marks.vertebrae)
        quads = np.array([marks.vertebrae[level] for level in levels], dtype=float).reshape(-1, 4, 2)
        # The other order is its own inverse: left and right change places.
        seen = quads[:, [0, 1, 2, 3] if side == "left" else [1, 0, 3, 2]]
        return ImageCorners(name, levels, seen, "", "px", side)

    def _cobb(self, name: str, marks: DraftImage) -> CobbReading | None:
        view = self.view(name)
        if view_kind(view) != "frontal" or not upright(view) or len(marks.vertebrae) < 2:
            return None
        seen = self.seen(name, marks)
        # Angles are those of the body: of pixels that are not square, as tall as they are wide.
        square = view.pixel_spacing / view.pixel_spacing[0]
        reading = read_cobb(replace(seen, corners=seen.corners * square))
        return None if reading.largest is None else reading

    def _refuse_unknown(self, names: Iterable[str]) -> None:
        for name in names:
            check_image_name(self.subject, name)

    def _write_draft(self, images: dict[str, DraftImage]) -> None:
        if images and images != self._drafted:
            write_json(self.draft_path, Draft(schema_version=SCHEMA_VERSION, images=images).record())
        elif not images:
            self.draft_path.unlink(missing_ok=True)
        self._drafted = images

    def _on_disk(self) -> _OnDisk:
        return _OnDisk(pictures_on_disk(self.subject.folder), _digest(self.annotation_path), _digest(self.draft_path))

    def _token(self) -> str:
        seen = self._seen
        return _half((self._made_of, seen.pictures)) + _half((seen.annotation, seen.draft))


def writing(folder: Path) -> AbstractContextManager[object]:
    """Held by whatever in this program writes a subject's marks or puts a radiograph in another's place: what was read
    is still there when it writes. Other programs are told by what they have written."""
    with _WRITING_LOCK:
        return _WRITING.setdefault(folder.resolve(), RLock())


def pictures_on_disk(folder: Path) -> Pictures:
    """What tells the rest radiographs of a subject from others in their places, without reading them: of each that is
    there its name, number in the file system, size and time of change."""
    found = {name: folder / place for name, place in REST_IMAGES.items()}
    there = {name: path.stat() for name, path in found.items() if path.exists()}
    return tuple((name, one.st_ino, one.st_size, one.st_mtime_ns) for name, one in there.items())


def _frames_of(subject: Subject, name: str) -> Sequence[Radiograph]:
    if name in REST_IMAGES:
        return (read_rest(subject, "lateral" if name == LATERAL else "frontal"),)
    if re.fullmatch(FURTHER_VIEW, name):
        frame, view = subject.view(name)
        push = subject.push(name.split("/")[1])
        return (read_view(subject, push, view)[view.frames.index(frame)],)
    return open_push(subject, subject.push(name.removeprefix("push/")))


def image_of(name: str) -> str:
    """The image that a name of the annotation belongs to: of a push's later frame the push."""
    return name if name in REST_IMAGES or re.fullmatch(FURTHER_VIEW, name) else "/".join(name.split("/")[:2])


def upright(view: XRayView) -> bool:
    """Whether the head is up in the picture."""
    return bool(picture_axes(view)[1][1] <= 0.0)


def first_on(view: XRayView) -> Side:
    """The side of the image where the patient's left, in a lateral image the front, is seen.

    Raises
    ------
    SubjectError : the radiograph stands on its head, for which files of other programs have no words.
    """
    if not upright(view):
        raise SubjectError("the radiograph stands on its head; such corners can't be exchanged")
    return "right" if picture_axes(view)[0][0] > 0.0 else "left"


def _drafted(annotation: Annotation) -> dict[str, DraftImage]:
    return {
        name: DraftImage(vertebrae=image.vertebrae, supports=image.supports, pedicles=image.pedicles)
        for name, image in annotation.images.items()
    }


def _half(of: object) -> str:
    return hashlib.sha256(repr(of).encode()).hexdigest()[:32]


def _radiographs_of(revision: str) -> str:
    return revision[:32]


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
