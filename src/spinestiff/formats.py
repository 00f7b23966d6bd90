"""JSON and CSV as text: read strictly, said what is wrong in words of the file, written alike from the same data."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from typing import Any, NoReturn

from spinestiff.errors import SubjectError
from spinestiff.words import counted, printable

_CURLY = ("\u201c", "\u201d", "\u201e", "\u2018", "\u2019")
"""Quotes as word processors set them."""
_MOST_DIGITS = 20
"""On either side of a decimal comma, in a number of JSON."""
SEPARATORS = (";", "\t", ",")
"""Of fields in tables that people make, in the order in which a header is tried."""
_SEPARATOR_LINE = re.compile(r'"?sep=[^\n]"?(?=\r?\n)', re.IGNORECASE)
"""By which a spreadsheet says above the header what separates the fields; the header shows that, too."""
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d{1,3})?", re.ASCII)

# Of a fault at a place the beginning of Python's words, and ours.
_JSON_FAULTS = (
    ("Expecting ',' delimiter", "a comma is missing before this place, or a bracket that closes"),
    ("Expecting ':' delimiter", "wanted a colon after the key"),
    ("Expecting property name", "wanted a key in double quotes; a comma before it may be one too many"),
    ("Illegal trailing comma", "a comma too many: nothing follows it"),
    ("Expecting value", "wanted a value: a number with a decimal point, text in double quotes, null, or a list"),
    ("Unterminated string", "the text that begins here has no closing double quotes in its line"),
    ("Invalid control character", "a line ends within a text; close its double quotes"),
    ("Extra data", "the file goes on after its end; a closing bracket may be one too many"),
)


def parse_json(text: str, name: str) -> Any:
    """JSON text with what the standard lets pass refused: a key twice in an object, NaN, numbers out of range."""

    def refuse(constant: str) -> NoReturn:
        raise SubjectError(f"{name}: found {constant}, wanted a finite number")

    def number(literal: str) -> float:
        value = float(literal)
        return value if math.isfinite(value) else refuse(literal)

    def keys_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        content = dict(pairs)
        if len(content) < len(pairs):
            twice = Counter(key for key, _ in pairs).most_common(1)[0][0]
            raise SubjectError(f"{name}: key '{twice}' is given twice in one object; keep one")
        return content

    if not text.strip():
        raise SubjectError(f"{name}: is empty, wanted JSON")
    try:
        return json.loads(text, object_pairs_hook=keys_once, parse_constant=refuse, parse_float=number)
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise SubjectError(f"{name}: not JSON at {where}: {_json_fault(text, error)}") from None
    except RecursionError:
        raise SubjectError(f"{name}: nested too deeply") from None
    except ValueError:
        # Python's own limit on the digits of an integer.
        raise SubjectError(f"{name}: holds a number with too many digits") from None


def _json_fault(text: str, error: json.JSONDecodeError) -> str:
    """What is wrong, in words of the file rather than of Python's parser."""
    # Longer numbers are none that somebody typed, and looking through all of a text's digits would take for ever.
    beside = _MOST_DIGITS + 2
    before = re.search(rf"(?<!\d)\d{{1,{_MOST_DIGITS}}},$", text[max(error.pos - beside, 0) : error.pos])
    after = re.match(rf"\d{{1,{_MOST_DIGITS}}}(?!\d)", text[error.pos : error.pos + beside])
    if before and after:
        found = before[0] + after[0]
        return f"found {found}, wanted a decimal point ({found.replace(',', '.')})"
    rest = text[error.pos : error.pos + 2]
    if rest in ("//", "/*") or rest[:1] == "#":
        return "found a comment, which JSON has not; take it out"
    if rest[:1] in _CURLY:
        return f'found {rest[:1]}, wanted straight double quotes (")'
    known = (told for beginning, told in _JSON_FAULTS if error.msg.startswith(beginning))
    return next(known, error.msg)


def parse_csv(
    text: str, name: str, columns: Sequence[str], optional: Sequence[str] = (), numbers: Collection[str] = ()
) -> Iterator[tuple[int, tuple[str, ...]]]:
    """Rows of a CSV with just these columns, in any order; rows without anything are skipped.

    Fields are separated by commas, semicolons or tabs, by which the first line has these columns, in small letters or
    capitals. What spreadsheets add is passed by: a line that names the separator, and cells without anything at the end
    of lines.

    Parameters
    ----------
    text : of the file.
    name : of the file, for messages.
    optional : columns that may be there besides.
    numbers : columns whose decimal commas become points where commas do not separate fields.

    Yields
    ------
    The row's last line in the file, and its texts without blanks around them, in the order of ``columns`` and then of
    ``optional``; "" for a column that is not there.

    Raises
    ------
    SubjectError : other columns, a row with another number of fields, no CSV at all.
    """
    text = _SEPARATOR_LINE.sub("", text, count=1) if _SEPARATOR_LINE.match(text) else text
    separator = _separator(text, columns, optional)
    reader = csv.reader(io.StringIO(text, newline=""), strict=True, delimiter=separator)
    wanted = ",".join(columns) + (f" and perhaps {','.join(optional)}" if optional else "")
    try:
        header = _names(next((row for row in reader if any(map(str.strip, row))), []))
        if not header:
            raise SubjectError(f"{name}: is empty, wanted a row with the columns {wanted} and rows below it")
        if sorted(column for column in header if column not in optional) != sorted(columns) or (
            len(set(header)) < len(header)
        ):
            shown = printable(",".join(header))
            odd = _odd_columns(header, columns, optional)
            raise SubjectError(f"{name}: row {reader.line_num}: columns {shown}, wanted {wanted}{odd}")
        at = [header.index(column) if column in header else None for column in (*columns, *optional)]
        for full in reader:
            row = full[: len(header)] if not any(map(str.strip, full[len(header) :])) else full
            if not any(map(str.strip, row)):
                continue
            if len(row) != len(header):
                fields = f"{counted(len(row), 'field')}, wanted {len(header)} ({','.join(header)})"
                comma = separator == "," and len(row) > len(header)
                hint = "; numbers with decimal commas need semicolons between the fields" if comma else ""
                raise SubjectError(f"{name}: row {reader.line_num}: {fields}{hint}")
            texts = ("" if i is None else row[i].strip() for i in at)
            yield (
                reader.line_num,
                tuple(
                    decimal_point(one, separator) if column in numbers else one
                    for column, one in zip((*columns, *optional), texts)
                ),
            )
    except csv.Error as error:
        raise SubjectError(f"{name}: row {reader.line_num}: not CSV ({error})") from None


def decimal_point(text: str, separator: str) -> str:
    """A number's text with a decimal comma as a point; commas that separate fields are none."""
    return text if separator == "," else text.replace(",", ".")


def plain_number(text: str) -> float:
    """A number as people write it, with a decimal point; NaN for anything else, also for Python's own "1_000"."""
    return float(text) if _NUMBER.fullmatch(text.strip()) else math.nan


def plain_word(text: str, words: Collection[str]) -> str | None:
    """Which of these words a text is, or begins, in small letters or capitals; None where it is none, or several."""
    found = [word for word in words if text and word.casefold().startswith(text.casefold())]
    return found[0] if len(found) == 1 else None


def _separator(text: str, columns: Sequence[str], optional: Sequence[str]) -> str:
    """By which the first line has all columns and no other; a comma where none does."""
    first = text.lstrip("\r\n").partition("\n")[0].rstrip("\r")
    for separator in SEPARATORS:
        with suppress(csv.Error):
            header = set(_names(next(csv.reader([first], delimiter=separator), [])))
            if set(columns) <= header <= {*columns, *optional}:
                return separator
    return ","


def _names(cells: Sequence[str]) -> list[str]:
    """Of a header's columns, without empty cells at its end."""
    names = [cell.strip() for cell in cells]
    while names and not names[-1]:
        names.pop()
    return [name.casefold() for name in names]


def _odd_columns(header: Sequence[str], columns: Sequence[str], optional: Sequence[str]) -> str:
    """What a header lacks, or has too much, where it is a header at all."""
    known = {*columns, *optional}
    if not known & set(header):
        return "; the first row has to name the columns"
    lacking = ",".join(column for column in columns if column not in header)
    foreign = printable(",".join(column for column in header if column not in known)) if not lacking else ""
    return f"; lacking: {lacking}" if lacking else f"; leave out: {foreign}" if foreign else ""


def json_text(data: Any) -> str:
    """``data`` as JSON, the same text from the same data. Raises ValueError or TypeError for what JSON lacks."""
    return encodable(json.dumps(data, sort_keys=True, indent=1, allow_nan=False, ensure_ascii=False, default=_plain))


def encodable(text: str) -> str:
    r"""Text as UTF-8 can hold it: what stands for a byte of a file's name that is no UTF-8 is told by its code.

    As ``\udcfc``, which in JSON is the same text when it is read again.
    """
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no JSON form")
