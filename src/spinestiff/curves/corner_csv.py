"""Rows of a CSV of vertebra corners: columns checked strictly, names that a spreadsheet would run made harmless."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from spinestiff.formats import parse_csv

COLUMNS = ("image", "level", "corner", "x", "y")
FORMULA = ("=", "+", "-", "@")
"""What a spreadsheet takes for the start of a formula (OWASP, "CSV Injection")."""


class CsvRow(NamedTuple):
    """One row, nothing of its texts checked yet; ``line`` is its last line in the file."""

    line: int
    image: str
    level: str
    corner: str
    x: str
    y: str


def parse(text: str, name: str) -> Iterator[CsvRow]:
    """The rows of a CSV with the columns ``COLUMNS`` in any order (``formats.parse_csv``); empty lines are skipped.

    Parameters
    ----------
    text : of the file.
    name : of the file, for messages.

    Raises
    ------
    SubjectError : other columns, a row with another number of fields, no CSV at all.
    """
    for line, (image, *rest) in parse_csv(text, name, COLUMNS, numbers=("x", "y")):
        yield CsvRow(line, image[1:] if _is_guarded(image) else image, *rest)


def text(rows: Iterable[tuple[str, str, str, float, float]]) -> str:
    """A CSV of (image, level, corner, x, y). A name that begins like a formula gets an apostrophe in front."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(COLUMNS)
    for image, level, corner, x, y in rows:
        writer.writerow((guarded(image), level, corner, repr(x), repr(y)))
    return stream.getvalue()


def guarded(name: str) -> str:
    """A name that no spreadsheet runs as a formula: where it begins like one, with an apostrophe in front."""
    found = f"'{name}"
    return found if _is_guarded(found) else name


def _is_guarded(name: str) -> bool:
    """Whether a name has an apostrophe in front that is not its own."""
    return name.startswith("'") and name[1:].startswith((*FORMULA, "'"))
