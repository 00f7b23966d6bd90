"""A new subject from an upload or a folder on this machine, as ``spinestiff init`` makes it."""

from __future__ import annotations

import hashlib
import hmac
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from spinestiff.errors import NotThere, SpinestiffError, SubjectError
from spinestiff.files import listed
from spinestiff.imaging.dicom.export import Exported
from spinestiff.loopback.asking import sendable
from spinestiff.subject.gaps import PERSON
from spinestiff.subject.intake import making
from spinestiff.subject.intake.adding import TABLE
from spinestiff.subject.intake.collecting import Refused, Study, by_name, chosen_studies, collect, studies
from spinestiff.subject.intake.making import Given
from spinestiff.subject.intake.push_table import LARGEST_BYTES, TableRow, parse_push_table, pushes_of
from spinestiff.subject.intake.sorting import Sorting, sort_files, uses_of
from spinestiff.words import counted
from spinestiff.workbench.page_words import page_words
from spinestiff.workbench.rooms import Root

MOST_LEFT_OUT = 200
LEFT_OUT = "left out"
"""What a radiograph becomes that is of no use."""


@dataclass(frozen=True)
class Wish:
    """What somebody says of radiographs: which study, which are the rest ones and which single ones are one push each,
    by names as they were shown, and the text of a table of pushes.
    """

    study: str | None = None
    frontal: str | None = None
    lateral: str | None = None
    table: str | None = None
    joined: tuple[tuple[str, ...], ...] = ()

    @property
    def rows(self) -> tuple[TableRow, ...] | None:
        """Of the table. Raises SubjectError."""
        if self.table is None:
            return None
        if len(self.table.encode()) > LARGEST_BYTES:
            raise SubjectError(f"{TABLE}: more than {LARGEST_BYTES // 2**20} MB, no table of pushes")
        return parse_push_table(self.table, TABLE)

    def rest(self, found: Sequence[Exported]) -> tuple[Exported | None, Exported | None]:
        """The frontal and the lateral radiograph at rest that are named, among those found. Raises SubjectError."""
        names = (self.frontal, self.lateral)
        frontal, lateral = (None if name is None else _one(by_name(name, found, "the request")) for name in names)
        return frontal, lateral

    def pushes(self, found: Sequence[Exported]) -> list[list[Exported]]:
        """The radiographs of each push of single ones, among those found. Raises SubjectError."""
        by_names = {one.name: one for one in found}
        for name in [name for names in self.joined for name in names if name not in by_names]:
            raise SubjectError(f"the request: no radiograph {name[:80]!r}")
        return [[by_names[name] for name in dict.fromkeys(names)] for names in self.joined]


@dataclass(frozen=True)
class Export:
    """What lies in folders: radiographs, and files that are none."""

    found: tuple[Exported, ...] = ()
    refused: tuple[Refused, ...] = ()

    def study(self, wish: Wish) -> tuple[Exported, ...]:
        """The radiographs of the study that is wished for. Raises SubjectError, OptionError."""
        return chosen_studies(self.found, wish.study)[0] if self.found else ()


def read_export(places: Sequence[Path]) -> Export:
    """Read what lies in folders, by names as a page sends them back. Raises SpinestiffError, without names of the
    folders."""
    try:
        found, refused = collect(places)
    except SpinestiffError as error:
        words = str(error)
        for place in places:
            words = words.replace(str(place), "the upload")
        raise type(error)(words) from None
    named = tuple(replace(one, name=sendable(one.name)) for one in found)
    return Export(named, tuple(replace(one, name=sendable(one.name)) for one in refused))


def looked_at(export: Export, wish: Wish) -> dict[str, Any]:
    """The studies in an export, and what each radiograph of the chosen one becomes, as JSON."""
    groups = studies(export.found)
    if wish.study is None and len(groups) > 1:
        return {**look_record(export), "study": None}
    chosen, sorting = _sorted(export, wish)
    told, notes = making.person_of(chosen)
    uses = uses_of(sorting, [str(number) for number in range(1, len(sorting.pushes) + 1)])
    record = look_record(export, chosen, uses, sorting.reasons)
    return {**record, "study": wish.study or groups[0].label, "told": told, "notes": list(notes.values())}


def look_record(
    export: Export,
    chosen: Sequence[Exported] = (),
    uses: Mapping[str, str] | None = None,
    reasons: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """An export as JSON: its studies, the radiographs of the chosen one, those of use first, and what is left out."""
    uses, reasons = uses or {}, reasons or {}
    rows = [
        {
            "name": one.name,
            "frames": one.frames,
            "view": one.view or "",
            "use": uses.get(one.name, LEFT_OUT),
            "why": page_words(reasons[one.name]),
        }
        for one in sorted(chosen, key=lambda one: (one.name not in uses, one.tags.moment or 0.0, one.name))
    ]
    return {
        "studies": offered_studies(studies(export.found)),
        "files": rows,
        "left_out": [{"name": one.name, "why": one.why} for one in export.refused[:MOST_LEFT_OUT]],
        "left_out_in_all": len(export.refused),
        "told": {},
        "notes": [],
    }


def offered_studies(groups: Sequence[Study]) -> list[dict[str, str]]:
    """Studies as JSON, each by what people know of it: the day, what the hospital calls it and how many pictures it
    has; by a file, too, where this tells nothing or not enough. With several patients a letter stands for each. Of one
    study alone nobody asks, so that nothing of its header is told.
    """
    if len(groups) == 1:
        return [{"label": groups[0].label, "words": groups[0].words}]
    patients = len({one.patient for one in groups})
    told = [_known_of(one, patients > 1) for one in groups]
    words = [
        text if told.count(text) == 1 and (one.when or one.description) else f"{text} ({one.first})"
        for one, text in zip(groups, told)
    ]
    return [{"label": one.label, "words": text} for one, text in zip(groups, words)]


def _known_of(study: Study, several: bool) -> str:
    who = f"Patient {study.patient}" if several else ""
    about = ", ".join(filter(None, (who, study.when or "no date", study.description)))
    return f"{about}: {counted(len(study.files), 'picture')}" + (f", {study.kinds}" if study.kinds else "")


def make_newcomer(root: Root, name: str, export: Export, wish: Wish, person: Mapping[str, Any]) -> str:
    """Make the subject folder, whole or not at all; returns its key.

    Raises
    ------
    SpinestiffError : a name that is none or taken, or as ``spinestiff init``.
    """
    out = root.new_subject(name)
    chosen, sorting = _sorted(export, wish)
    data = making.subject_data(name, sorting)
    if set(person) - set(PERSON):
        raise SubjectError("the request: wanted age, sex and height_cm of the person")
    making.fill(data, Given(person))
    told, _ = making.person_of(chosen)
    making.fill(data, Given({key: value for key, value in told.items() if key not in person}))
    making.make_folder(out, data, sorting)
    return root.key_of(name)


def _sorted(export: Export, wish: Wish) -> tuple[tuple[Exported, ...], Sorting]:
    chosen, rows = export.study(wish), wish.rows
    table = None if rows is None else pushes_of(TABLE, rows, chosen, refused=export.refused)
    return chosen, sort_files(chosen, table, *wish.rest(chosen), wish.pushes(chosen))


def _one(found: Sequence[Exported]) -> Exported:
    if len(found) != 1 or found[0].frames != 1:
        raise SubjectError("a rest radiograph has one frame; choose another file")
    return found[0]


@dataclass(frozen=True)
class Sources:
    """Folders on this machine that subjects may be made from, as whoever started the server named them."""

    root: Root
    folders: tuple[Path, ...]

    def offered(self) -> list[tuple[str, str, Path]]:
        """Key, name and place of each folder, and of those directly in it."""
        found = []
        for folder in self.folders:
            inside = [one for one in listed(folder, SubjectError) if one.is_dir() and not one.is_symlink()]
            for place in [folder, *(one for one in inside if not one.name.startswith("."))]:
                name = folder.name if place == folder else f"{folder.name}/{place.name}"
                key = hmac.new(self.root.secret, os.fsencode(place), hashlib.sha256).hexdigest()[:16]
                found.append((key, name, place))
        return found

    def place(self, key: str) -> Path:
        """The folder of a key. Raises NotThere."""
        for found, _, place in self.offered():
            if hmac.compare_digest(found.encode(), key.encode()):
                return place
        raise NotThere("this folder is not there, or no longer")
