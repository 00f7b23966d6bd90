"""One subject folder being annotated: its marks, and every change saved at once."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from threading import Lock, RLock

from spinestiff.annotate.draft import DRAFT_FILE, Draft, DraftImage, read_draft
from spinestiff.annotate.judging import Judge
from spinestiff.annotate.radiographs import KeptRadiographs, Pictures, pictures_on_disk
from spinestiff.errors import ChangedElsewhere, SubjectError
from spinestiff.files import write_json
from spinestiff.imaging.features import view_kind
from spinestiff.imaging.proposal import leans_of
from spinestiff.subject.annotation_record import Annotation, ImageAnnotation
from spinestiff.subject.folder import (
    Subject,
    annotatable,
    annotatable_views,
    check_image_name,
    check_radiograph_path,
    read_annotation,
    read_unannotated,
    write_annotation,
)
from spinestiff.subject.image_names import FRONTAL, LATERAL
from spinestiff.subject.records import ANNOTATION_FILE, REST_IMAGES, SCHEMA_VERSION, SUBJECT_FILE

_WRITING: dict[Path, AbstractContextManager[object]] = {}
_WRITING_LOCK = Lock()


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
    radiographs, judge : the images, and what can be told of marks in them.
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
        self.views = annotatable_views(self.subject)
        self.images = tuple(name for name in (*wanted, *self.views) if self._offered(name))
        needed = (*wanted, *(name for name, needed in self.views.items() if needed))
        self.absent = tuple(name for name in needed if name != LATERAL and name not in self.images)
        if not self.images:
            raise SubjectError(f"{folder}: no radiograph to annotate; wanted {', '.join(REST_IMAGES.values())}")
        self.radiographs = KeptRadiographs(self.subject)
        self.judge = Judge(self.subject, self.radiographs, self.images, self.absent, self.views)
        self.lock = RLock()
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
                self.radiographs.forget()
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
            whole = self.judge.complete(marked)
            annotation = self.judge.with_marks(whole).annotation
            partial = {name: image for name, image in marked.items() if name not in whole}
            try:
                # What moves from one file to the other is in both for a moment, never in none.
                self._write_draft(partial | {name: marked[name] for name in self._drafted if name in marked})
                if whole or self.annotation_path.is_file():
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
        marked = {name: image for name, image in marks.items() if not image.empty}
        return marked | self.judge.complete(marked)

    def leans(self, name: str) -> dict[str, float]:
        """How far vertebrae lean to the side, rad, as the frontal rest radiograph's marks tell a lateral radiograph."""
        front = self.marks.get(FRONTAL, DraftImage()).vertebrae
        if not front or FRONTAL not in self.images or view_kind(self.radiographs.view(name)) != "lateral":
            return {}
        return leans_of(self.radiographs.view(FRONTAL), {str(level): quad for level, quad in front.items()})

    def annotated(self) -> Subject:
        """The subject with what is complete of its annotation."""
        with self.lock:
            return self.judge.with_marks(self.judge.complete(self.marks))

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
