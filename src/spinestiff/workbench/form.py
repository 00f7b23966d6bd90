"""A subject's values as a form: the schema that ``subject.json`` has to follow, its values, and what is wrong."""

from __future__ import annotations

import copy
import hashlib
import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from spinestiff.anatomy.regions import CHAIN
from spinestiff.annotate.draft import DRAFT_FILE, read_draft
from spinestiff.errors import ChangedElsewhere, FitError, SubjectError
from spinestiff.estimation.ratio_priors import POPULATIONS, check_population
from spinestiff.files import read_json, read_text, write_json
from spinestiff.study.trials import given_priors, usual_priors
from spinestiff.subject.folder import read_annotation
from spinestiff.subject.gaps import Gap, check_open_record, gaps_of, open_complaints
from spinestiff.subject.image_names import view_image
from spinestiff.subject.intake.adding import is_place, is_scan_place, markers_place, side_places
from spinestiff.subject.lock import sole_run
from spinestiff.subject.records import ANNOTATION_FILE, SUBJECT_FILE, SubjectRecord
from spinestiff.workbench.form_words import RATIO_GROUPS, RATIO_PARTS, WORDS
from spinestiff.workbench.page_words import page_words

FIXED = frozenset({"schema_version", "frames", "files", "file", "torso"})
"""Keys whose values no page may set: the form's version, and names of files."""
BESIDE = frozenset({"views", "markers"})
"""Keys of a push whose records may be taken out and put back, with the names that ``intake.adding`` gave."""
SCAN = "skin_scan"
"""The same of the subject."""
CHOICES = {
    "groups": [{"name": name, "title": title, "of": of} for name, (title, of) in RATIO_GROUPS.items()],
    "parts": {of: [{"name": name, "title": title} for name, title in told.items()] for of, told in RATIO_PARTS.items()},
    "chain": list(CHAIN),
    "populations": list(POPULATIONS),
}
"""What may be chosen where the schema takes any word: ratios as groups and parts, the latter also between two of
``chain``; its last, the sacrum, is no vertebra."""
_CHECKS: dict[str, Callable[[Any], object]] = {"priors": given_priors, "population": check_population}
NAMES_STAY = "names of files, pushes and views can't be changed here"


def form_record(folder: Path) -> dict[str, Any]:
    """Schema, words, values and complaints, as JSON. Raises SubjectError where the file is no JSON."""
    text = read_text(folder / SUBJECT_FILE)
    values = read_json(folder / SUBJECT_FILE)
    if not isinstance(values, dict):
        raise SubjectError(f"{SUBJECT_FILE}: wanted an object")
    return {
        "schema": SubjectRecord.model_json_schema(),
        "words": WORDS,
        "priors": usual_priors(),
        "choices": CHOICES,
        "values": values,
        "revision": _digest(text),
        **judged(values),
    }


def judged(values: dict[str, Any]) -> dict[str, Any]:
    """What is wrong with values, and what is still open, by field."""
    complaints = open_complaints(values)
    complaints += _beyond_schema(values, complaints)
    return {
        "problems": [{"field": field, "text": page_words(text)} for field, text in complaints],
        "open": [{"field": field, "text": gap.words} for gap in gaps_of(values) for field in _fields(gap)],
    }


def _beyond_schema(values: dict[str, Any], complaints: Sequence[tuple[str, str]] = ()) -> list[tuple[str, str]]:
    """What is wrong with values that the schema allows: the key and the words. Of ``complaints`` are those that it does
    not allow, by field."""
    found = []
    for key, check in _CHECKS.items():
        value = values.get(key)
        if value is None or any(field.startswith(key) for field, _ in complaints):
            continue
        try:
            check(value)
        except (SubjectError, FitError) as error:
            found.append((key, str(error)))
    return found


def _fields(gap: Gap) -> list[str]:
    """The fields of a gap: of forces one a frame."""
    return [f"pushes[{gap.push}].{gap.key}[{frame}]" for frame in gap.frames] or [gap.field]


def save_form(folder: Path, values: dict[str, Any], revision: str) -> str:
    """Write the values; returns the new revision.

    What is there already may be saved again: its page may have missed the answer.

    Raises
    ------
    ChangedElsewhere : the file is no longer the one that the form was made from.
    InUseError : a run is at work on the subject.
    SubjectError : values that the schema does not allow, another name of a file, push or view, or a view taken out that
        somebody has annotated. A skin scan may be taken out and put back.
    """
    path = folder / SUBJECT_FILE
    with sole_run(folder):
        text, before = read_text(path), read_json(path)
        if _digest(text) != revision:
            if before == values:
                return _digest(text)
            raise ChangedElsewhere(
                f"{SUBJECT_FILE} was changed meanwhile, in another window or by a command; load what is there now"
            )
        scan, last = (_scan_file(one) for one in (values, before))
        if _fixed(before) != _fixed(values) or (scan not in (None, last) and not is_scan_place(folder, scan)):
            raise SubjectError(NAMES_STAY)
        check_open_record(values)
        for _, problem in _beyond_schema(values):
            raise SubjectError(problem)
        _check_beside(folder, before, values)
        write_json(path, values)
        return _digest(read_text(path))


def _fixed(values: Any, where: str = "") -> dict[str, Any]:
    """What no page may set, by its place."""
    found: dict[str, Any] = {}
    if isinstance(values, dict):
        for key, value in values.items():
            if (key in BESIDE and where.startswith(".pushes[")) or (key == SCAN and not where):
                continue  # ``_check_beside`` and ``_scan_file``
            if (key in FIXED and not isinstance(value, list)) or (key == "id" and where):
                found[f"{where}.{key}"] = copy.deepcopy(value)
            else:
                found |= _fixed(value, f"{where}.{key}")
    elif isinstance(values, list):
        for number, value in enumerate(values):
            found |= _fixed(value, f"{where}[{number}]")
    return found


def _scan_file(values: dict[str, Any]) -> Any:
    scan = values.get(SCAN)
    return _file_of(scan)


def _file_of(record: Any) -> Any:
    return record.get("file") if isinstance(record, dict) else None


def _records(values: dict[str, Any], key: str) -> list[dict[str, Any]]:
    """Those of a list, of a file that may be wrong."""
    found = values.get(key)
    return [one for one in found if isinstance(one, dict)] if isinstance(found, list) else []


def _check_beside(folder: Path, before: dict[str, Any], values: dict[str, Any]) -> None:
    """Raise SubjectError where views or markers name other files than they did, or than lie where they belong, and
    where a view is taken out that is annotated. ``values`` are ones that the schema allows, of the same pushes.
    """
    for old, new in zip(_records(before, "pushes"), _records(values, "pushes")):
        named = [(view.get("id"), view.get("files")) for view in _records(old, "views")]
        for view in new.get("views") or ():
            usual = side_places(new["id"], view["id"])
            if (view["id"], view["files"]) not in named and not _lies_in(folder, view["files"], usual):
                raise SubjectError(NAMES_STAY)
        file, last = (_file_of(push.get("markers")) for push in (new, old))
        if file not in (None, last) and not _lies_in(folder, file, (markers_place(new["id"]),)):
            raise SubjectError(NAMES_STAY)
    lost = _views(before) - _views(values)
    for image in _annotated(folder):
        if image in lost:
            raise SubjectError(f"{image} is annotated; remove its marks on the annotation page first")


def _lies_in(folder: Path, place: str, allowed: tuple[str, ...]) -> bool:
    return any(is_place(place, usual) for usual in allowed) and (folder / place).exists()


def _views(values: dict[str, Any]) -> set[str]:
    """Names in the annotation of all radiographs from other sides, of a file that may be wrong."""
    return {
        view_image(push.get("id", ""), frame, view.get("id", ""))
        for push in _records(values, "pushes")
        for view in _records(push, "views")
        for frame in (view["frames"] if isinstance(view.get("frames"), list) else ())
    }


def _annotated(folder: Path) -> set[str]:
    """Names of the images that somebody has marked, as far as they can be read."""
    found: set[str] = set()
    with suppress(SubjectError):
        found |= set(read_annotation(folder / ANNOTATION_FILE).images)
    with suppress(SubjectError):
        found |= set(read_draft(folder / DRAFT_FILE).images)
    return found


def _digest(text: str) -> str:
    return hashlib.sha256(json.dumps(text).encode()).hexdigest()
