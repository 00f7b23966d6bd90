"""JSON files and the record of a run: read strictly, written whole or not at all.

``results/run.json`` says what each step was made from, so that a step is redone only when something changed.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import secrets
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NoReturn

from spinestiff import __version__
from spinestiff.errors import SpinestiffError, SubjectError

LARGEST_JSON = 10_000_000
"""Bytes. A subject's files are a few kilobytes; anything larger is another file or an accident."""
RESULTS = "results"
RUN_SCHEMA = 1


def read_json(path: Path) -> Any:
    """The content of a JSON file.

    Raises
    ------
    SubjectError : no such file, over 10 MB, not UTF-8, not JSON, a key given twice, a number that is not finite.
    """
    return parse_json(read_text(path), path.name)


def read_text(path: Path, largest: int = LARGEST_JSON) -> str:
    """A text file of at most ``largest`` bytes, not yet parsed. Raises SubjectError as ``read_json`` does."""
    if not path.is_file():
        raise SubjectError(f"{path}: no such file")
    try:
        size = path.stat().st_size
        if size > largest:
            raise SubjectError(f"{path}: {size} bytes, wanted at most {largest}; is this the right file?")
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise SubjectError(f"{path}: not UTF-8 text (byte {error.start}); save it as UTF-8") from None
    except OSError as error:
        raise SubjectError(f"{path}: can't be read ({error.strerror})") from None


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
            keys = [key for key, _ in pairs]
            twice = next(key for key in keys if keys.count(key) > 1)
            raise SubjectError(f"{name}: key '{twice}' is given twice in one object; keep one")
        return content

    try:
        return json.loads(text, object_pairs_hook=keys_once, parse_constant=refuse, parse_float=number)
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise SubjectError(f"{name}: not JSON at {where}: {error.msg}") from None
    except RecursionError:
        raise SubjectError(f"{name}: nested too deeply") from None
    except ValueError:
        # Python's own limit on the digits of an integer.
        raise SubjectError(f"{name}: holds a number with too many digits") from None


def write_json(path: Path, data: Any) -> None:
    """Write ``data`` as JSON: whole or not at all, so that an interrupted run leaves the old file.

    Keys are sorted; NumPy arrays and numbers are written as lists and numbers.

    Raises
    ------
    SpinestiffError : a number that is not finite, or a type that JSON lacks.
    SubjectError : the file can't be written.
    """
    try:
        text = json.dumps(data, sort_keys=True, indent=1, allow_nan=False, ensure_ascii=False, default=_plain)
    except (ValueError, TypeError) as error:
        raise SpinestiffError(f"{path.name} is not written: {error}") from None
    write_text(path, text + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a text file as UTF-8, whole or not at all. Raises SubjectError if it can't be written."""
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file, whole or not at all. Raises SubjectError if it can't be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _replace(path, content)
    except OSError as error:
        raise SubjectError(f"{path}: can't be written ({error.strerror})") from None


def _replace(path: Path, content: bytes) -> None:
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    try:
        with temporary.open("xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no JSON form")


def package_version() -> str:
    """The version of spinestiff that runs."""
    return __version__


def inputs_digest(folder: Path, paths: Iterable[Path]) -> dict[str, str]:
    """SHA-256 of every file in ``paths`` (folders are searched), by path relative to ``folder``, sorted."""
    files = (file for path in paths for file in (sorted(path.rglob("*")) if path.is_dir() else [path]))
    return dict(sorted((_relative(folder, file), file_digest(file)) for file in files if not file.is_dir()))


def file_digest(path: Path) -> str:
    """SHA-256 of a file's bytes. Raises SubjectError if it can't be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise SubjectError(f"{path}: can't be read ({error.strerror})") from None


def _relative(folder: Path, file: Path) -> str:
    return Path(os.path.relpath(file, folder)).as_posix()


def step_digest(inputs: Mapping[str, str], settings: Mapping[str, Any]) -> str:
    """One hash of all that a step depends on: its input files' hashes, its settings and this program's version."""
    parts = {"inputs": dict(inputs), "settings": dict(settings), "version": package_version()}
    text = json.dumps(parts, sort_keys=True, allow_nan=False, default=_plain)
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True)
class StepRecord:
    """How one step of the pipeline came about.

    Attributes
    ----------
    digest : from ``step_digest``.
    inputs : SHA-256 by path relative to the subject folder.
    settings : what the step was asked.
    seconds : wall-clock time.
    outputs : SHA-256 by path relative to the subject folder.
    """

    digest: str
    inputs: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    seconds: float = 0.0
    outputs: Mapping[str, str] = field(default_factory=dict)


def record_step(folder: Path, step: str, record: StepRecord) -> None:
    """Write a step into the folder's ``results/run.json`` beside the other steps."""
    steps = {**_recorded_steps(folder), step: asdict(record)}
    write_json(_run_file(folder), {"schema_version": RUN_SCHEMA, "version": package_version(), "steps": steps})


def is_current(folder: Path, step: str, digest: str) -> bool:
    """Whether the step was made from just this (``step_digest``) and its outputs are still as it left them."""
    recorded = _recorded_steps(folder).get(step)
    if not isinstance(recorded, dict) or recorded.get("digest") != digest:
        return False
    outputs = recorded.get("outputs", {})
    return all((folder / name).is_file() and file_digest(folder / name) == sha for name, sha in outputs.items())


def changed_inputs(folder: Path, step: str) -> tuple[str, ...]:
    """Input files of a recorded step that have changed or gone since it ran, by path relative to ``folder``."""
    recorded = _recorded_steps(folder).get(step)
    inputs = recorded.get("inputs", {}) if isinstance(recorded, dict) else {}
    return tuple(
        name for name, sha in inputs.items() if not (folder / name).is_file() or file_digest(folder / name) != sha
    )


def _run_file(folder: Path) -> Path:
    return folder / RESULTS / "run.json"


def _recorded_steps(folder: Path) -> dict[str, Any]:
    # A damaged record only means that the steps are redone.
    try:
        run = read_json(_run_file(folder))
    except SubjectError:
        return {}
    known = isinstance(run, dict) and run.get("schema_version") == RUN_SCHEMA and isinstance(run.get("steps"), dict)
    return run["steps"] if known else {}
