"""A subject's values as a form: the schema that ``subject.json`` has to follow, its values, and what is wrong."""

from __future__ import annotations

import copy
import hashlib
import json
from pathlib import Path
from typing import Any

from spinestiff.errors import ChangedElsewhere, SubjectError
from spinestiff.files import read_json, read_text, write_json
from spinestiff.subject.gaps import Gap, check_open_record, gaps_of, open_complaints
from spinestiff.subject.lock import sole_run
from spinestiff.subject.records import SUBJECT_FILE, SubjectRecord
from spinestiff.workbench.form_words import WORDS

FIXED = frozenset({"schema_version", "frames", "files", "file", "torso"})
"""Keys whose values no page may set: the form's version, and names of files."""


def form_record(folder: Path) -> dict[str, Any]:
    """Schema, words, values and complaints, as JSON. Raises SubjectError where the file is no JSON."""
    text = read_text(folder / SUBJECT_FILE)
    values = read_json(folder / SUBJECT_FILE)
    if not isinstance(values, dict):
        raise SubjectError(f"{SUBJECT_FILE}: wanted an object")
    return {
        "schema": SubjectRecord.model_json_schema(),
        "words": WORDS,
        "values": values,
        "revision": _digest(text),
        **judged(values),
    }


def judged(values: dict[str, Any]) -> dict[str, Any]:
    """What is wrong with values, and what is still open, by field."""
    return {
        "problems": [{"field": field, "text": text} for field, text in open_complaints(values)],
        "open": [{"field": field, "text": gap.words} for gap in gaps_of(values) for field in _fields(gap)],
    }


def _fields(gap: Gap) -> list[str]:
    """The fields of a gap: of forces one a frame."""
    return [f"pushes[{gap.push}].{gap.key}[{frame}]" for frame in gap.frames] or [gap.field]


def save_form(folder: Path, values: dict[str, Any], revision: str) -> str:
    """Write the values; returns the new revision.

    Raises
    ------
    ChangedElsewhere : the file is no longer the one that the form was made from.
    InUseError : a run is at work on the subject.
    SubjectError : values that the schema does not allow, or another name of a file, push or view.
    """
    path = folder / SUBJECT_FILE
    with sole_run(folder):
        if _digest(read_text(path)) != revision:
            raise ChangedElsewhere(f"{SUBJECT_FILE} was changed meanwhile; reload the form to go on from there")
        if _fixed(read_json(path)) != _fixed(values):
            raise SubjectError("names of files, pushes and views can't be changed here")
        check_open_record(values)
        write_json(path, values)
        return _digest(read_text(path))


def _fixed(values: Any, where: str = "") -> dict[str, Any]:
    """What no page may set, by its place."""
    found: dict[str, Any] = {}
    if isinstance(values, dict):
        for key, value in values.items():
            if (key in FIXED and not isinstance(value, list)) or (key == "id" and where):
                found[f"{where}.{key}"] = copy.deepcopy(value)
            else:
                found |= _fixed(value, f"{where}.{key}")
    elif isinstance(values, list):
        for number, value in enumerate(values):
            found |= _fixed(value, f"{where}[{number}]")
    return found


def _digest(text: str) -> str:
    return hashlib.sha256(json.dumps(text).encode()).hexdigest()
