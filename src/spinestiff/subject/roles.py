"""Roles of frames put into ``subject.json``: nothing else in the file changes, not even its layout."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from spinestiff.errors import SubjectError
from spinestiff.files import read_text, write_text
from spinestiff.formats import parse_json
from spinestiff.subject.record_reading import parse_record
from spinestiff.subject.records import SUBJECT_FILE, Role, SubjectRecord

_SPACE = " \t\r\n"


def write_roles(folder: Path, roles: Mapping[str, Sequence[Role]]) -> None:
    """Replace the roles of some pushes in ``subject.json``, whole or not at all.

    Parameters
    ----------
    folder : the subject's.
    roles : by id of the push, one role a frame.

    Raises
    ------
    SubjectError : no such push, another number of frames, roles without a training frame; the file stays as it was.
    """
    path = folder / SUBJECT_FILE
    text = read_text(path)
    known = {push.id for push in parse_record(text, str(path), SubjectRecord).pushes}
    if wrong := set(roles) - known:
        raise SubjectError(f"{path}: no push '{min(wrong)}'; there are {', '.join(sorted(known))}")
    changed = _replaced(text, roles)
    # Checked as a whole before anything is written.
    parse_record(changed, str(path), SubjectRecord)
    write_text(path, changed)


def _replaced(text: str, roles: Mapping[str, Sequence[Role]]) -> str:
    """The text with new lists of roles, the last first, so that positions before them stay."""
    pushes = dict(_members(text, _past_space(text, 0)))["pushes"]
    for start in reversed(list(_items(text, pushes[0]))):
        members = dict(_members(text, start))
        name = parse_json(text[slice(*members["id"])], SUBJECT_FILE)
        if name in roles:
            chosen = json.dumps(list(roles[name]))
            if "roles" in members:
                first, last = members["roles"]
            else:
                first = last = members["forces_n"][1]
                chosen = f', "roles": {chosen}'
            text = text[:first] + chosen + text[last:]
    return text


def _members(text: str, at: int) -> Iterator[tuple[str, tuple[int, int]]]:
    """Keys of the object that begins at a position, and where each value begins and ends."""
    decoder = json.JSONDecoder()
    at = _past_space(text, at + 1)
    while text[at] != "}":
        key, at = decoder.raw_decode(text, at)
        at = _past_space(text, _past_space(text, at) + 1)
        _, end = decoder.raw_decode(text, at)
        yield key, (at, end)
        at = _past_space(text, end)
        if text[at] == ",":
            at = _past_space(text, at + 1)


def _items(text: str, at: int) -> Iterator[int]:
    """Where each value of the list that begins at a position begins."""
    decoder = json.JSONDecoder()
    at = _past_space(text, at + 1)
    while text[at] != "]":
        yield at
        _, at = decoder.raw_decode(text, at)
        at = _past_space(text, at)
        if text[at] == ",":
            at = _past_space(text, at + 1)


def _past_space(text: str, at: int) -> int:
    while text[at] in _SPACE:
        at += 1
    return at
