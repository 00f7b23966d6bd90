"""JSON files read as strict records; each refusal is one line: file, field, found, wanted."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

from spinestiff.errors import SubjectError
from spinestiff.files import read_text
from spinestiff.formats import parse_json
from spinestiff.words import did_you_mean

SUBJECT_PAGE = "docs/subject-folder.md"
IDENTIFIER = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$"
_WANTED_NAME = "1 to {} letters (A to Z), digits, '.', '_' or '-', the first a letter or digit"
WANTED_ID = _WANTED_NAME.format(64)
WANTED_MARKER = _WANTED_NAME.format(32)


class Record(BaseModel):
    """The base of files and requests: no unknown key, no other type, nothing that is not finite."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


R = TypeVar("R", bound=BaseModel)


def read_record(path: Path, kind: type[R], page: str = SUBJECT_PAGE) -> R:
    """A record from a JSON file that ``page`` of the documents describes.

    Raises
    ------
    SubjectError : no such file, no JSON, or anything the record does not allow (field, found, wanted).
    """
    return parse_record(read_text(path), str(path), kind, page)


def parse_record(text: str, name: str, kind: type[R], page: str = SUBJECT_PAGE) -> R:
    """A record from the text of a JSON file of that name. Raises SubjectError as ``read_record`` does."""
    parse_json(text, name)
    try:
        return kind.model_validate_json(text)
    except ValidationError as error:
        raise SubjectError(f"{name}: {complaint_of(error, page, kind)}") from None


def complaint_of(error: ValidationError, page: str = SUBJECT_PAGE, kind: type[BaseModel] | None = None) -> str:
    """The most telling of pydantic's complaints as "field: found, wanted".

    ``kind`` : what was read, so that an unknown key is told with the known one that it resembles.
    """
    # A misspelled key shows up twice, as unknown and as missing: the first says more.
    complaints = sorted(error.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")
    first = complaints[0]
    field = _field_path(first)
    more = f" (and {len(complaints) - 1} more)" if len(complaints) > 1 else ""
    told = _complaint(first, page, kind)
    return f"{field}: {told}{more}" if field else f"{told}{more}"


def complaints_of(error: ValidationError, kind: type[BaseModel]) -> list[tuple[str, str]]:
    """All of pydantic's complaints of a record of that kind, each as the field and what is wrong with it."""
    return [(_field_path(one), _complaint(one, SUBJECT_PAGE, kind)) for one in error.errors(include_url=False)]


def _field_path(complaint: ErrorDetails) -> str:
    path = ""
    for part in complaint["loc"]:
        # pydantic adds this to the path when a key of a dictionary is wrong.
        if part == "[key]":
            continue
        path += f"[{part}]" if isinstance(part, int) else f".{shown_key(part)}"
    return path.removeprefix(".")


def shown_key(key: str) -> str:
    """A key as it stands in the file, if it can be printed in one line; else quoted and shortened."""
    return key if key.isprintable() and 0 < len(key) <= 40 else shown_value(key, 30)


UNITS = {"cm": " cm", "mm": " mm", "kg": " kg", "n": " N", "deg": " degrees", "s": " s", "px": " pixels"}
"""What a value is told in whose key ends so."""
MEANT = (
    (("weight", "mass", "gewicht"), "mass_kg"),
    (("force", "forces", "load", "loads"), "forces_n"),
    (("rib", "height"), "level"),
    (("height", "size"), "height_cm"),
)
"""Words of people for keys of the schema, by the part before a unit."""


def _complaint(complaint: ErrorDetails, page: str, record: type[BaseModel] | None = None) -> str:
    kind, message = complaint["type"], complaint["msg"]
    if kind == "extra_forbidden":
        key, known = str(complaint["loc"][-1]), _keys_beside(complaint["loc"], record)
        meant = [other for words, other in MEANT if key.casefold().split("_")[0] in words and other in known]
        near = f"; did you mean {meant[0]}?" if meant else did_you_mean(key, known)
        return f"unknown key{near or f'; check its spelling against {page}'}"
    if kind == "missing":
        return "missing"
    if kind == "value_error":
        return message.removeprefix("Value error, ")
    if kind == "string_pattern_mismatch":
        return f"found {shown_value(complaint['input'])}, wanted {WANTED_ID}"
    if kind.endswith(("_parsing", "_type")) and (told := _quoted_number(kind, complaint["input"])):
        return told
    wanted = re.sub(r"^(Input|String|Tuple|Dictionary) should (be |have |match )?", "", message)
    wanted = re.sub(r" after validation, not \d+$", "", wanted).replace("a valid array", "a list")
    if kind in ("greater_than", "greater_than_equal", "less_than", "less_than_equal"):
        key = next((part for part in reversed(complaint["loc"]) if isinstance(part, str)), "")
        wanted += UNITS.get(key.rpartition("_")[2], "")
    return f"found {shown_value(complaint['input'])}, wanted {wanted}"


def _keys_beside(place: Sequence[int | str], record: type[BaseModel] | None) -> list[str]:
    """The keys that the object may have which holds the key at a place of a record."""
    kinds = [] if record is None else [record]
    for part in place[:-1]:
        # Numbers of a list and keys of a dictionary stay among the same kinds of record.
        inside = [kind.model_fields[part].annotation for kind in kinds if part in kind.model_fields]
        kinds = [kind for annotation in inside for kind in _records_in(annotation)] or kinds
    return [key for kind in kinds for key in kind.model_fields]


def _records_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """The records that a field of that type may hold, e.g. those of ``tuple[PushRecord, ...] | None``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _records_in(part)


def _quoted_number(kind: str, value: Any) -> str:
    """What is wrong with a number that is written as a text; "" for anything else."""
    if not kind.startswith(("float", "int")) or not isinstance(value, str):
        return ""
    plain = value.strip().replace(",", ".")
    if not re.fullmatch(r"[+-]?\d+(\.\d+)?", plain):
        return ""
    comma = ", with a decimal point" if "," in value else ""
    return f"found {shown_value(value)}, wanted a number without quotes{comma}: {plain}"


def shown_value(value: Any, longest: int = 60) -> str:
    """A value as the file has it, shortened."""
    # As JSON writes them.
    text = json.dumps(value) if value is None or isinstance(value, bool) else repr(value)
    return text if len(text) <= longest else text[: longest - 3] + "..."
