"""Who belongs to a cohort: ``participants.tsv``, read strictly (docs/cohort.md)."""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from spinestiff.errors import SubjectError
from spinestiff.files import LARGEST_JSON, no_folder, read_text
from spinestiff.words import counted, printable

if TYPE_CHECKING:
    from _csv import Reader

PARTICIPANTS_FILE = "participants.tsv"
COLUMN = "participant_id"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
_OWN = ("cohort", "ledger")
"""Beginnings of the names that a cohort's own files have beside the participants' folders."""
_WINDOWS = re.compile(r"(?:con|prn|aux|nul|com[0-9]|lpt[0-9])(?:\..*)?|.*\.", re.IGNORECASE)
"""Names that some systems can't make a folder of."""


def read_participants(folder: Path) -> tuple[str, ...]:
    """The participants of a cohort, in the order of its table; each is the name of a subject folder beside it.

    Raises
    ------
    SubjectError : no such table, another separator, no column ``participant_id``, a row with another number of fields,
        no row at all, or a name that is none, is given twice or differs from another in case alone.
    """
    path = folder / PARTICIPANTS_FILE
    if not folder.is_dir():
        raise SubjectError(f"{folder}: {no_folder(folder)}; wanted one with {PARTICIPANTS_FILE} and a folder a subject")
    if not os.path.lexists(path):
        raise SubjectError(f"{path}: no such file; wanted the table of participants, with a column {COLUMN}")
    reader = csv.reader(io.StringIO(read_text(path, LARGEST_JSON), newline=""), delimiter="\t", quoting=csv.QUOTE_NONE)
    header = [column.strip() for column in next(_rows(reader, path), [])]
    if header.count(COLUMN) != 1:
        shown = printable(", ".join(header))
        raise SubjectError(
            f"{path}: row 1: found columns {shown or 'none'}, wanted one {COLUMN}; separate columns by tabs"
        )
    names: list[str] = []
    rows: dict[str, int] = {}
    for row in _rows(reader, path):
        if not any(field.strip() for field in row):
            continue
        where = f"{path}: row {reader.line_num}"
        if len(row) != len(header):
            raise SubjectError(f"{where}: {counted(len(row), 'field')}, wanted {len(header)}; separate them by tabs")
        name = row[header.index(COLUMN)].strip()
        _check_name(where, name)
        if name.casefold() in rows:
            raise SubjectError(f"{where}: '{name}' is in row {rows[name.casefold()]}, too; keep one of them")
        rows[name.casefold()] = reader.line_num
        names.append(name)
    if not names:
        raise SubjectError(f"{path}: names nobody; wanted a row a participant")
    return tuple(names)


def _rows(reader: Reader, path: Path) -> Iterator[list[str]]:
    try:
        yield from reader
    except csv.Error as error:
        raise SubjectError(f"{path}: row {reader.line_num}: no table ({error}); separate columns by tabs") from None


def _check_name(where: str, name: str) -> None:
    if not _NAME.fullmatch(name) or _WINDOWS.fullmatch(name):
        raise SubjectError(
            f"{where}: {COLUMN} '{printable(name)}': wanted 1 to 64 letters (A to Z), digits, '.', '_' or '-', "
            "the first a letter or digit, the last no '.'"
        )
    if name.casefold().split(".")[0] in _OWN:
        raise SubjectError(f"{where}: {COLUMN} '{name}' is the name of a file of the cohort itself; choose another")
