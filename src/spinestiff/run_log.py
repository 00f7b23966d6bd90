"""The log of a run: ``logs/*.jsonl``, a JSON object a line, with versions and settings, without patient data.

A run is named by when it began. Its first line says what was asked of which versions, its last how it ended; between
them is what the library logs. Names of files and folders, which may be a patient's, and the subject's id are taken out.
A run that had nothing to do leaves no log, one that was killed all lines so far.
"""

from __future__ import annotations

import json
import logging
import platform
import re
import sys
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TextIO

from spinestiff.errors import SpinestiffError
from spinestiff.formats import encodable
from spinestiff.observer import LOGGER
from spinestiff.subject.folder import Subject
from spinestiff.subject.program import program
from spinestiff.subject.records import ANNOTATION_FILE, RESULTS, SUBJECT_FILE
from spinestiff.versions import LIBRARIES, installed

LOGS = "logs"
"""The folder of all logs, usually in ``results/``."""
_EXTRAS = ("event", "step", "seconds")
_LEAST = 3  # characters of a name that can be told from other words and numbers
_OWN_NAMES = {SUBJECT_FILE, ANNOTATION_FILE, "subject", "annotation", "rest", "pushes", "frontal", "lateral"}


@contextmanager
def run_log(
    subject: Subject,
    command: str,
    settings: Mapping[str, Any],
    folder: Path | None = None,
    names: Iterable[str] = (),
) -> Iterator[None]:
    """Log what happens inside to a new file beside the subject's results.

    All that the library logs as information, and what is below that where somebody has asked the logger for it.

    Parameters
    ----------
    command : as on the command line, without its arguments. settings : what the steps were asked, as JSON.
    folder : of the log; None: ``logs`` in the subject's ``results/``. names : further ones that must not be told.
    """
    began, start = datetime.now(UTC), time.perf_counter()
    name = f"{began:%Y%m%dT%H%M%S}-{began.microsecond:06d}-{command.replace(' ', '-')}.jsonl"
    lines = _Lines((folder or subject.results / LOGS) / name, _scrubbed(subject, names))
    asked = {"command": command, "settings": dict(settings), "versions": versions()}
    lines.write({"time": _stamp(began), "event": "start", **asked})
    logger = logging.getLogger(LOGGER)
    before = logger.level
    lines.setLevel(min(logging.INFO, logger.getEffectiveLevel()))
    if not logger.isEnabledFor(logging.INFO):
        logger.setLevel(logging.INFO)
    logger.addHandler(lines)
    end: dict[str, Any] = {"event": "end", "outcome": "done"}
    try:
        yield
    except SpinestiffError as error:
        end |= {"outcome": type(error).__name__, "text": str(error)}
        raise
    except BaseException as error:
        # Its words may be anything.
        end |= {"outcome": type(error).__name__}
        raise
    finally:
        logger.removeHandler(lines)
        logger.setLevel(before)
        lines.write({"time": _stamp(datetime.now(UTC)), **end, "seconds": round(time.perf_counter() - start, 3)})
        lines.close()


def versions() -> dict[str, str]:
    """Of this program, Python, the system and the libraries."""
    found = {name: installed(name) or "missing" for name in LIBRARIES}
    return {"spinestiff": program(), "python": sys.version.split()[0], "system": platform.platform(), **found}


class _Lines(logging.Handler):
    """Log records as JSON lines: kept until a step begins, then written to a new file as they come."""

    def __init__(self, path: Path, scrub: re.Pattern[str]) -> None:
        super().__init__()
        self._path, self._scrub, self._waiting = path, scrub, list[str]()
        self._file: TextIO | None = None

    def emit(self, record: logging.LogRecord) -> None:
        extras = {name: getattr(record, name) for name in _EXTRAS if hasattr(record, name)}
        stamp = _stamp(datetime.fromtimestamp(record.created, UTC))
        said = {"level": record.levelname, "logger": record.name, "text": record.getMessage()}
        self.write({"time": stamp, **extras, **said})
        if extras.get("event") == "begin" and self._file is None:
            self._open()

    def write(self, content: dict[str, Any]) -> None:
        if "text" in content:
            content["text"] = self._scrub.sub("…", content["text"])
        line = encodable(json.dumps(content, ensure_ascii=False)) + "\n"
        if self._file is None:
            self._waiting.append(line)
            return
        with suppress(OSError):  # a full disk: results are worth more than their log
            self._file.write(line)
            self._file.flush()

    def close(self) -> None:
        super().close()
        if self._file is not None:
            with suppress(OSError):
                self._file.close()

    def _open(self) -> None:
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self._path.open("x", encoding="utf-8")
            self._file.writelines(self._waiting)
            self._file.flush()
        except OSError:
            self._file = None


def _scrubbed(subject: Subject, names: Iterable[str]) -> re.Pattern[str]:
    """What finds the names that must not be told: of the folder, of all in it but results, the id and others."""
    folder = subject.folder
    paths = [path.relative_to(folder) for path in folder.rglob("*") if path.relative_to(folder).parts[0] != RESULTS]
    inside = {part for path in paths for part in (path.as_posix(), path.name, path.stem)}
    said = (*inside, *names, subject.record.id, str(folder), folder.resolve().name)
    told = {name for name in said if _tells(name)} | {str(folder.resolve())}
    ordered = sorted(map(re.escape, told), key=len, reverse=True)
    return re.compile(rf"(?<!\w)(?:{'|'.join(ordered)})(?!\w)")


def _tells(name: str) -> bool:
    """Whether a name may say who somebody is: no word of this program, and no small number."""
    return len(name) >= _LEAST and name not in _OWN_NAMES and not (name.isdigit() and len(name) <= _LEAST)


def _stamp(moment: datetime) -> str:
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")
