"""The table of pushes that ``spinestiff init`` reads: a row a frame, read strictly (docs/from-hospital.md)."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from spinestiff.errors import SubjectError
from spinestiff.files import read_exported_text
from spinestiff.formats import parse_csv, plain_number, plain_word
from spinestiff.imaging.dicom.export import Exported
from spinestiff.subject.intake.collecting import Refused, Study, by_name
from spinestiff.subject.record_reading import IDENTIFIER, WANTED_ID
from spinestiff.subject.records import DISTANCES_MM, GAUGE_LIMIT_N, LEVELS, Role
from spinestiff.words import counted, printable

COLUMNS = ("file", "frame", "force_n", "side", "level", "d21_mm", "d31_mm")
NEEDED = COLUMNS[:5]
OPTIONAL = (*COLUMNS[5:], "role", "push")
"""Columns that may be left out."""
LARGEST_BYTES = 2**20
_RANGES = {
    "force_n": (0.0, GAUGE_LIMIT_N, "N"), "level": (*LEVELS, "ribs"), "d21_mm": (*DISTANCES_MM, "mm"),
    "d31_mm": (*DISTANCES_MM, "mm"),
}  # fmt: skip
_WORDS = {"side": ("left", "right"), "role": get_args(Role)}
SHARED = ("side", "level", "d21_mm", "d31_mm")
"""What all frames of a push have in common."""


@dataclass(frozen=True)
class TableRow:
    """A row; None for an empty cell. ``line`` is its last line in the file, ``push`` the name of the push it is of."""

    line: int
    file: str
    frame: int | None
    force_n: float | None
    side: str | None
    level: float | None
    d21_mm: float | None
    d31_mm: float | None
    role: str | None
    push: str | None


@dataclass(frozen=True)
class TablePush:
    """A push as the table tells it.

    Attributes
    ----------
    files : its radiographs: one of several frames, or some of one frame each.
    rows : by file and frame.
    shared : of ``SHARED``, what the table tells.
    name : of the push; None if the table gives none.
    """

    files: tuple[Exported, ...]
    rows: dict[tuple[str, int], TableRow]
    shared: dict[str, Any]
    name: str | None


_Groups = dict[tuple[Any, ...], list[tuple[TableRow, tuple[Exported, ...]]]]


def read_push_table(path: Path) -> tuple[TableRow, ...]:
    """The rows of a table of pushes. Raises SubjectError as ``parse_push_table``."""
    return parse_push_table(read_exported_text(path, LARGEST_BYTES), str(path))


def parse_push_table(text: str, name: str) -> tuple[TableRow, ...]:
    """The rows of a table of pushes from the text of a file of that name.

    Raises
    ------
    SubjectError : other columns, no rows, a cell that is no value of its column (row, column, found, wanted).
    """
    rows = []
    columns = (*NEEDED, *OPTIONAL)
    for line, texts in parse_csv(text, name, NEEDED, OPTIONAL, _RANGES):
        cells = dict(zip(columns, texts))
        where = f"{name}: row {line}"
        if not cells["file"]:
            raise SubjectError(f"{where}: file: found nothing, wanted the name of a radiograph or a folder of some")
        force, level, d21, d31 = (_number(cells[key], key, where) for key in _RANGES)
        side, role = (_word(cells[key], key, where) for key in _WORDS)
        frame, push = _frame(cells["frame"], where), cells["push"] or None
        if push is not None and not re.fullmatch(IDENTIFIER, push):
            raise SubjectError(f"{where}: push: found {_shown(push)}, wanted {WANTED_ID}")
        rows.append(TableRow(line, cells["file"], frame, force, side, level, d21, d31, role, push))
    if not rows:
        raise SubjectError(f"{name}: no rows; wanted one for each frame of a push")
    return tuple(rows)


def _frame(text: str, where: str) -> int | None:
    if not text:
        return None
    if not (text.isascii() and text.isdigit() and len(text) <= 4):
        raise SubjectError(f"{where}: frame: found {_shown(text)}, wanted a whole number, the first frame being 0")
    return int(text)


def _number(text: str, key: str, where: str) -> float | None:
    if not text:
        return None
    low, high, unit = _RANGES[key]
    value = plain_number(text)
    if not low <= value <= high:
        comma = ", with a decimal point" if re.fullmatch(r"\d+,\d+", text) else ""
        raise SubjectError(
            f"{where}: {key}: found {_shown(text)}, wanted {low:g} to {high:g} {unit}{comma}, or nothing"
        )
    return value


def _word(text: str, key: str, where: str) -> str | None:
    found = plain_word(text, _WORDS[key])
    if text and found is None:
        wanted = ", ".join(_WORDS[key])
        raise SubjectError(f"{where}: {key}: found {_shown(text)}, wanted {wanted}, or nothing")
    return found


def _shown(text: str) -> str:
    return repr(printable(text, 40))


def pushes_of(
    path: Path | str,
    rows: Sequence[TableRow],
    found: Sequence[Exported],
    others: Sequence[Study] = (),
    refused: Sequence[Refused] = (),
) -> tuple[TablePush, ...]:
    """The pushes of a table, which messages call ``path``, in its order.

    Rows of one file of several frames, or of one folder, are one push. Rows of files of one frame each are one push
    where their ``push`` is the same or, without one, all that they have in common is the same. ``others`` and
    ``refused`` as in ``by_name``.

    Raises
    ------
    SubjectError : a file or frame that is not there, a row twice, rows of one push that contradict each other, or that
        may be of one push or of two.
    """
    groups: _Groups = {}
    for row in rows:
        where = f"{path}: row {row.line}"
        files = by_name(row.file, found, where, others, refused)
        frames = files[0].frames if len(files) == 1 else len(files)
        if row.frame is None and frames > 1 and (row.force_n is not None or row.role is not None):
            raise SubjectError(
                f"{where}: frame: found nothing, but {row.file} has {counted(frames, 'frame')}; wanted which of them "
                "the row is of, the first being 0"
            )
        if row.frame is not None and row.frame >= frames:
            raise SubjectError(f"{where}: frame {row.frame}, but {row.file} has {counted(frames, 'frame')}, from 0 on")
        if len(files) > 1 and any(one.frames > 1 for one in files):
            raise SubjectError(f"{where}: the folder {row.file} holds files of several frames; name them one by one")
        if row.push is not None:
            key: tuple[Any, ...] = ("push", row.push)
        elif len(files) > 1 or files[0].frames > 1:
            key = ("file", files[0].name)
        else:
            key = ("alike", *(getattr(row, shared) for shared in SHARED))
        groups.setdefault(key, []).append((row, files))
    _refuse_open(path, groups)
    pushes = tuple(_push(path, group) for group in groups.values())
    owners: dict[str, int] = {}
    for number, push in enumerate(pushes):
        for one in push.files:
            if owners.setdefault(one.name, number) != number:
                line = next(iter(push.rows.values())).line
                raise SubjectError(f"{path}: row {line}: {one.name} is part of another push already; wanted it in one")
    return pushes


def _refuse_open(path: Path | str, groups: _Groups) -> None:
    """Refuse rows of single frames, none without force, that don't contradict other such rows: of that push, or not?"""
    single = {
        key: tuple(next((told for row, _ in rows if (told := getattr(row, name)) is not None), None) for name in SHARED)
        for key, rows in groups.items()
        if all(len(files) == 1 and files[0].frames == 1 for _, files in rows)
    }
    for key, mine in single.items():
        # A push with a frame without force is one by itself.
        if key[0] != "alike" or any(row.force_n == 0.0 for row, _ in groups[key]):
            continue
        for other, its in single.items():
            if key != other and all(None in pair or pair[0] == pair[1] for pair in zip(mine, its)):
                row, like = groups[key][0][0], groups[other][0][0]
                raise SubjectError(
                    f"{path}: row {row.line}: {row.file} may be of the push of row {like.line} or of another, since "
                    f"cells are empty; tell {', '.join(SHARED)} alike in each row of a push of single files, or its "
                    "name in the column push"
                )


def _push(path: Path | str, group: list[tuple[TableRow, tuple[Exported, ...]]]) -> TablePush:
    files = {one.name: one for _, several in group for one in several}
    rows: dict[tuple[str, int], TableRow] = {}
    tells_frames = any(row.frame is not None for row, _ in group)
    for row, several in group:
        where = f"{path}: row {row.line}"
        if len(files) > 1 and any(one.frames > 1 for one in files.values()):
            raise SubjectError(
                f"{where}: {row.file} is in a push of several files, one of which has several frames; wanted either "
                "one file of several frames or files of one frame each"
            )
        # A folder's frames count in order of time, which ``sorting`` knows; until then they go by the folder's name.
        key = (several[0].name if len(several) == 1 else "", row.frame or 0)
        if row.frame is None and (len(several) > 1 or several[0].frames > 1) and tells_frames:
            continue  # of all frames, none of which it tells
        if key in rows:
            raise SubjectError(f"{where}: {row.file}, frame {key[1]} is in row {rows[key].line} already; keep one")
        rows[key] = row
    if len({name for name, _ in rows if not name}) and len({name for name, _ in rows}) > 1:
        raise SubjectError(f"{path}: row {group[0][0].line}: names a folder beside single files in it; keep either")
    shared: dict[str, Any] = {}
    for name in SHARED:
        told = {getattr(row, name): row.line for row, _ in group if getattr(row, name) is not None}
        if len(told) > 1:
            values = " and ".join(f"{value} (row {line})" for value, line in list(told.items())[:2])
            raise SubjectError(f"{path}: {name}: found {values} for frames of one push, wanted one value")
        shared |= dict.fromkeys([name], next(iter(told))) if told else {}
    line = group[0][0].line
    if shared.get("d31_mm", 0.0) >= shared.get("d21_mm", math.inf):
        raise SubjectError(
            f"{path}: row {line}: d31_mm {shared['d31_mm']:g} is not below d21_mm {shared['d21_mm']:g}; wanted the "
            "push between shoulder and pelvis"
        )
    return TablePush(tuple(files.values()), rows, shared, group[0][0].push)
