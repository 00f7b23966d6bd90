"""A new subject from an upload or from a folder on this machine, by the code of ``spinestiff init``."""

from __future__ import annotations

import hashlib
import hmac
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spinestiff.errors import NotThere, SpinestiffError, SubjectError
from spinestiff.files import listed
from spinestiff.imaging.dicom.export import Exported
from spinestiff.subject.gaps import PERSON
from spinestiff.subject.intake import making
from spinestiff.subject.intake.collecting import Refused, by_name, chosen_studies, collect, studies
from spinestiff.subject.intake.making import Given
from spinestiff.subject.intake.sorting import Sorting, sort_files, uses_of
from spinestiff.workbench.rooms import Root

MOST_SOURCES = 500


@dataclass(frozen=True)
class Wish:
    """What somebody says of radiographs: which study, which are the rest ones (names as they were shown)."""

    study: str | None = None
    frontal: str | None = None
    lateral: str | None = None


@dataclass(frozen=True)
class Export:
    """What lies in folders: radiographs, and files that are none."""

    found: tuple[Exported, ...]
    refused: tuple[Refused, ...]


def read_export(places: Sequence[Path]) -> Export:
    """Read what lies in folders. Raises SpinestiffError, without names of the folders."""
    try:
        return Export(*collect(places))
    except SpinestiffError as error:
        words = str(error)
        for place in places:
            words = words.replace(str(place), "the upload")
        raise type(error)(words) from None


def looked_at(export: Export, wish: Wish) -> dict[str, Any]:
    """The studies in an export, and what each radiograph of the chosen one becomes, as JSON."""
    groups = studies(export.found)
    record: dict[str, Any] = {"studies": [{"label": one.label, "words": one.words} for one in groups]}
    if wish.study is None and len(groups) > 1:
        return {**record, "study": None, "files": [], "left_out": _left_out(export), "told": {}, "notes": []}
    chosen, sorting = _sorted(export, wish)
    told, notes = making.person_of(chosen)
    uses = uses_of(sorting, [str(number) for number in range(1, len(sorting.pushes) + 1)])
    rows = [
        {
            "name": one.name,
            "frames": one.frames,
            "view": one.view or "",
            "use": uses.get(one.name, "left out"),
            "why": sorting.reasons[one.name],
        }
        for one in sorted(chosen, key=lambda one: (one.name not in uses, one.tags.moment or 0.0, one.name))
    ]
    study = wish.study or groups[0].label
    return {**record, "study": study, "files": rows, "left_out": _left_out(export), "told": told, "notes": notes}


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
    chosen, _ = chosen_studies(export.found, wish.study)
    frontal, lateral = (
        None if given is None else _one(by_name(given, chosen, "the request")) for given in (wish.frontal, wish.lateral)
    )
    return chosen, sort_files(chosen, None, frontal, lateral)


def _one(found: Sequence[Exported]) -> Exported:
    if len(found) != 1 or found[0].frames != 1:
        raise SubjectError("a rest radiograph has one frame; choose another file")
    return found[0]


def _left_out(export: Export) -> list[dict[str, str]]:
    return [{"name": one.name, "why": one.why} for one in export.refused[:200]]


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
            for place in [folder, *(one for one in inside if not one.name.startswith("."))][:MOST_SOURCES]:
                name = folder.name if place == folder else f"{folder.name}/{place.name}"
                key = hmac.new(self.root.secret, os.fsencode(place), hashlib.sha256).hexdigest()[:16]
                found.append((key, name, place))
        return found

    def place(self, key: str) -> Path:
        """The folder of a key. Raises NotThere."""
        for found, _, place in self.offered():
            if hmac.compare_digest(found, key):
                return place
        raise NotThere("this folder is not there, or no longer")
