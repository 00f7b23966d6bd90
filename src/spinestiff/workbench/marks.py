"""What was marked in a subject's radiographs, in the three files that hold it: taken out of them, and put back.

Pixels that were marked in one picture say nothing of another. So what was marked in a radiograph goes where it goes.
"""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spinestiff.annotate.draft import DRAFT_FILE
from spinestiff.errors import SubjectError
from spinestiff.files import parse_json, read_text, write_json, write_text
from spinestiff.subject.gaps import check_open_record
from spinestiff.subject.records import ANNOTATION_FILE, SUBJECT_FILE

FILES = (SUBJECT_FILE, ANNOTATION_FILE, DRAFT_FILE)
Contents = dict[str, Any]
"""By name of the file its JSON; None where it is not there."""


@dataclass(frozen=True)
class Marks:
    """What was marked in one radiograph, as JSON in the subject's files; None: nothing.

    Attributes
    ----------
    annotation, draft : of ``annotation.json`` and ``annotation.draft.json``: corners and pedicles in pixels.
    scale : a known length in pixels, of ``xray.scale`` in ``subject.json``.
    """

    annotation: Any = None
    draft: Any = None
    scale: Any = None

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


def _scales(content: Any) -> dict[str, Any]:
    xray = content.get("xray") if isinstance(content, dict) else None
    scales = xray.get("scale") if isinstance(xray, dict) else None
    return scales if isinstance(scales, dict) else {}


def parted(contents: Contents, image: str) -> tuple[Contents, Marks]:
    """The files without what is marked in an image, and that."""
    subject, annotation, draft = (contents[name] for name in (SUBJECT_FILE, ANNOTATION_FILE, DRAFT_FILE))
    marks = Marks(_images(annotation).get(image), _images(draft).get(image), _scales(subject).get(image))
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
    scales = {key: value for key, value in _scales(subject).items() if key != image}
    scales |= {} if marks.scale is None else {image: marks.scale}
    if scales != _scales(subject):
        xray = {key: value for key, value in (subject.get("xray") or {}).items() if key != "scale"}
        found[SUBJECT_FILE] = {**subject, "xray": {**xray, "scale": scales} if scales else xray}
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
    """Names of a push's frames and views in which something is marked, by its id."""
    subject, annotation, draft = (contents[name] for name in FILES)
    found = dict.fromkeys((*_images(annotation), *_images(draft), *_scales(subject)))
    return tuple(name for name in found if name == f"push/{push}" or name.startswith(f"push/{push}/"))
