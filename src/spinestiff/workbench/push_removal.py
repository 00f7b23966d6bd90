"""A push that is no longer one of a subject's: taken out with what was marked in it, and put back.

Its radiographs stay where they are.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from spinestiff.annotate.session import writing
from spinestiff.errors import NotThere, SubjectError
from spinestiff.files import trouble
from spinestiff.subject.gaps import check_open_record
from spinestiff.subject.lock import sole_run
from spinestiff.subject.records import RESULTS, SUBJECT_FILE
from spinestiff.subject.run_record import RUN_FILE
from spinestiff.words import counted, push_named, sentence
from spinestiff.workbench.marks import (
    Contents,
    Marks,
    contents_of,
    joined,
    marked_images,
    parted,
    put_back,
    texts_of,
    write_changed,
)
from spinestiff.workbench.owner import Owner


@dataclass(frozen=True)
class RemovedPush:
    """A push that was taken out.

    Attributes
    ----------
    position : where it stood among the pushes, from 0.
    push : its record in ``subject.json``.
    marks : what was marked in its frames and views, by their names in the annotation.
    """

    position: int
    push: Mapping[str, Any]
    marks: Mapping[str, Marks] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return str(self.push["id"])

    @property
    def vertebrae(self) -> int:
        """How many are marked in all its pictures."""
        return sum(one.vertebrae for one in self.marks.values())


def remove_push(folder: Path, push: str, keep: Callable[[RemovedPush], object]) -> list[str]:
    """Take a push out of ``subject.json``, and what was marked in it out of the files that hold it; returns what that
    entails, a line each.

    Parameters
    ----------
    keep : takes it down, before anything changes.

    Raises
    ------
    InUseError : a run is at work on the subject. NotThere : no such push.
    SubjectError : without it the schema does not allow the others; a file that can't be read or written.
    """
    with sole_run(folder), writing(folder):
        texts = texts_of(folder)
        before = contents_of(texts)
        pushes = before[SUBJECT_FILE]["pushes"]
        position = next((i for i, one in enumerate(pushes) if one["id"] == push), None)
        if position is None:
            raise NotThere("this push is not there, or no longer")
        bare, marks = before, dict[str, Marks]()
        for image in marked_images(before, push):
            bare, marks[image] = parted(bare, image)
        after = _with_pushes(bare, [one for one in pushes if one["id"] != push])
        try:
            check_open_record(after[SUBJECT_FILE])
        except SubjectError as problem:
            words = str(problem).removeprefix(f"{SUBJECT_FILE}: ")
            raise SubjectError(
                f"{push_named(push)} can't be removed, since without it: {words}; first change the use of the other "
                "pushes' frames"
            ) from None
        removed = RemovedPush(position, pushes[position], marks)
        keep(removed)
        _write_all(folder, texts, (before, bare, after))
        return _entails(folder, removed)


def return_push(folder: Path, removed: RemovedPush) -> None:
    """Put a push back where it stood, with its marks.

    Whoever was killed while it was taken out may have left it there without them: then its marks alone come back, but
    to pictures that have been marked since.

    Raises
    ------
    InUseError : a run is at work on the subject.
    SubjectError : its name is taken, or the schema does not allow it for another reason; a file that can't be written.
    """
    with sole_run(folder), writing(folder):
        texts = texts_of(folder)
        before = contents_of(texts)
        pushes = list(before[SUBJECT_FILE]["pushes"])
        there = removed.push in pushes
        if not there:
            pushes.insert(removed.position, removed.push)
        bare = _with_pushes(before, pushes)
        check_open_record(bare[SUBJECT_FILE])
        after = bare
        for image, marks in removed.marks.items():
            if not there or parted(after, image)[1] == Marks():
                after = joined(after, image, marks)
        _write_all(folder, texts, (before, bare, after))


def _with_pushes(contents: Contents, pushes: list[Any]) -> Contents:
    return {**contents, SUBJECT_FILE: {**contents[SUBJECT_FILE], "pushes": pushes}}


def _write_all(folder: Path, texts: dict[str, str | None], stages: tuple[Contents, ...]) -> None:
    """Write one stage after the other, so that at no time something is marked in a push that is not there."""
    try:
        for now, wanted in zip(stages, stages[1:]):
            write_changed(folder, now, wanted)
    except BaseException as problem:
        put_back(folder, texts)
        if isinstance(problem, OSError):
            raise SubjectError(f"{SUBJECT_FILE} can't be written ({trouble(problem)}); nothing was changed") from None
        raise


def _entails(folder: Path, removed: RemovedPush) -> list[str]:
    name = sentence(push_named(removed.name))
    lines = [f"{name} was removed. Its radiographs stay in the folder ({removed.push['frames']})."]
    if removed.marks:
        vertebrae = counted(removed.vertebrae, "marked vertebra", "marked vertebrae")
        lines.append(f"What was marked in them went to the trash ({vertebrae}).")
    if (folder / RESULTS / RUN_FILE).is_file():
        lines.append("Results that came from it stay, and count as out of date until the next run.")
    return lines


def record_of(owner: Owner, removed: RemovedPush) -> dict[str, Any]:
    """As JSON."""
    marks = {image: vars(one) for image, one in removed.marks.items()}
    return {**owner.record, "position": removed.position, "push": dict(removed.push), "marks": marks}


def read_removed(record: Any) -> tuple[Owner, RemovedPush]:
    """Whose it was, and the push. Raises SubjectError where it is not as ``record_of`` made it."""
    try:
        owner, position, push = Owner.of_record(record), record["position"], record["push"]
        marks = {image: Marks(**one) for image, one in record["marks"].items()}
        json.dumps(push["id"])
        whole = isinstance(position, int) and position >= 0
    except (KeyError, TypeError, AttributeError, SubjectError):
        whole = False
    if not whole:
        raise SubjectError("this push's record in the trash is damaged; it can't be put back")
    return owner, RemovedPush(position, push, marks)
