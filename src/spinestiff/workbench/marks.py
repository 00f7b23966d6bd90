"""What was said of a subject's radiographs, in the three files that hold it: taken out of them, and put back.

Pixels that were marked in one picture say nothing of another. So what was said of a radiograph goes where it goes.
"""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spinestiff.annotate.draft import DRAFT_FILE
from spinestiff.errors import SubjectError
from spinestiff.files import read_text, write_json, write_text
from spinestiff.formats import parse_json
from spinestiff.subject.gaps import check_open_record
from spinestiff.subject.image_names import frame_image
from spinestiff.subject.records import ANNOTATION_FILE, SUBJECT_FILE

FILES = (SUBJECT_FILE, ANNOTATION_FILE, DRAFT_FILE)
XRAY_KEYS = ("scale", "images")
"""Under which ``xray`` in ``subject.json`` says something of single images."""
Contents = dict[str, Any]
"""By name of the file its JSON; None where it is not there."""


@dataclass(frozen=True)
class Marks:
    """What was said of one radiograph, as JSON in the subject's files; None: nothing.

    Attributes
    ----------
    annotation, draft : of ``annotation.json`` and ``annotation.draft.json``: corners and pedicles in pixels.
    scale : a known length in pixels, of ``xray.scale`` in ``subject.json``.
    geometry : distances and pixel of its own, of ``xray.images``.
    """

    annotation: Any = None
    draft: Any = None
    scale: Any = None
    geometry: Any = None

    @property
    def vertebrae(self) -> int:
        """How many have corners; where both files have some, those of the draft count."""
        shown = self.annotation if self.draft is None else self.draft
        marked = shown.get("vertebrae") if isinstance(shown, dict) else None
        return len(marked) if isinstance(marked, dict) else 0


def marks_of(folder: Path, image: str) -> Marks:
    """What is marked in a radiograph. Raises SubjectError for files that can't be read."""
    return parted(contents_of(texts_of(folder)), image)[1]


def texts_of(folder: Path) -> dict[str, str | None]:
    """The files as they are; None where one is not there."""
    return {name: read_text(folder / name) if os.path.lexists(folder / name) else None for name in FILES}


def contents_of(texts: dict[str, str | None]) -> Contents:
    """The files as JSON.

    Raises
    ------
    SubjectError : one is no object, or the schema does not allow the subject.
    """
    found = {name: None if text is None else parse_json(text, name) for name, text in texts.items()}
    if name := next((name for name, one in found.items() if one is not None and not isinstance(one, dict)), None):
        raise SubjectError(f"{name}: wanted an object")
    check_open_record(found[SUBJECT_FILE] or {})
    return found


def put_back(folder: Path, texts: dict[str, str | None]) -> None:
    """The files as they were, as far as they can be written."""
    for name, text in texts.items():
        with suppress(SubjectError):
            if text is None:
                (folder / name).unlink(missing_ok=True)
            elif read_text(folder / name) != text:
                write_text(folder / name, text)


def _images(content: Any) -> dict[str, Any]:
    images = content.get("images") if isinstance(content, dict) else None
    return images if isinstance(images, dict) else {}


def _of_xray(content: Any, key: str) -> dict[str, Any]:
    """What ``xray`` says under a key of ``XRAY_KEYS``, by image."""
    xray = content.get("xray") if isinstance(content, dict) else None
    found = xray.get(key) if isinstance(xray, dict) else None
    return found if isinstance(found, dict) else {}


def parted(contents: Contents, image: str) -> tuple[Contents, Marks]:
    """The files without what is marked in an image, and that."""
    subject, annotation, draft = (contents[name] for name in (SUBJECT_FILE, ANNOTATION_FILE, DRAFT_FILE))
    scale, geometry = (_of_xray(subject, key).get(image) for key in XRAY_KEYS)
    marks = Marks(_images(annotation).get(image), _images(draft).get(image), scale, geometry)
    return joined(contents, image, Marks()), marks


def joined(contents: Contents, image: str, marks: Marks) -> Contents:
    """The files with these marks in an image and no others. Raises SubjectError as ``check_open_record``."""
    found = dict(contents)
    for name, marked in ((ANNOTATION_FILE, marks.annotation), (DRAFT_FILE, marks.draft)):
        content = contents[name] or {"schema_version": 1, "images": {}}
        images = {key: value for key, value in _images(content).items() if key != image}
        images |= {} if marked is None else {image: marked}
        if images != _images(content):
            found[name] = {**content, "images": images} if images else None
    subject = contents[SUBJECT_FILE]
    for key, said in zip(XRAY_KEYS, (marks.scale, marks.geometry)):
        subject = found[SUBJECT_FILE]
        others = {name: value for name, value in _of_xray(subject, key).items() if name != image}
        others |= {} if said is None else {image: said}
        if others != _of_xray(subject, key):
            xray = {name: value for name, value in (subject.get("xray") or {}).items() if name != key}
            found[SUBJECT_FILE] = {**subject, "xray": {**xray, key: others} if others else xray}
    if found[SUBJECT_FILE] != contents[SUBJECT_FILE]:
        check_open_record(found[SUBJECT_FILE])
    return found


def write_changed(folder: Path, now: Contents, wanted: Contents) -> None:
    """Write the files that are not as wanted, and remove those that are wanted no longer."""
    for name, content in wanted.items():
        if content == now[name]:
            continue
        if content is None:
            (folder / name).unlink(missing_ok=True)
        else:
            write_json(folder / name, content)


def marked_images(contents: Contents, push: str) -> tuple[str, ...]:
    """Names of a push's frames and views of which something is said, by its id."""
    subject, annotation, draft = (contents[name] for name in FILES)
    of_xray = [image for key in XRAY_KEYS for image in _of_xray(subject, key)]
    found = dict.fromkeys((*_images(annotation), *_images(draft), *of_xray))
    own = frame_image(push)
    return tuple(name for name in found if name == own or name.startswith(f"{own}/"))
