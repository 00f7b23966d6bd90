"""The ledger of a cohort, ``ledger.sqlite``: who ran what, when, for how long, and how it ended.

It is a record for people. What has to be run is told by the participants' markers alone, so that a lost ledger costs
nothing but its history. One process writes it: the one that holds the cohort's lock.
"""

from __future__ import annotations

import getpass
import json
import os
import socket
import sqlite3
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, ValidationError

from spinestiff.cohort.marker import CohortRecord, Order
from spinestiff.cohort.places import LEDGER_FILE
from spinestiff.errors import SubjectError
from spinestiff.files import read_text, write_json
from spinestiff.formats import encodable, parse_json

LEDGER_VERSION = 1
_TABLES = """
CREATE TABLE runs (
    run TEXT PRIMARY KEY, started TEXT NOT NULL, ended TEXT, how TEXT, account TEXT NOT NULL, host TEXT NOT NULL,
    process INTEGER NOT NULL, version TEXT NOT NULL, runner TEXT NOT NULL, settings TEXT NOT NULL
) STRICT;
CREATE TABLE tries (
    run TEXT NOT NULL, participant TEXT NOT NULL, try INTEGER NOT NULL, started TEXT NOT NULL, seconds REAL,
    cpu_seconds REAL, peak_mb REAL, ended TEXT, words TEXT, host TEXT NOT NULL,
    PRIMARY KEY (run, participant, try)
) STRICT;
CREATE INDEX tries_by_participant ON tries (participant);
"""


class Try(CohortRecord):
    """One try at a participant.

    Attributes
    ----------
    run : of the cohort, that it belongs to. number : from 1.
    started : UTC. seconds : wall clock. cpu_seconds, peak_mb : as the process tells itself, MB of 2^20 bytes; None
        where it could not.
    ended : "done", or why not. words : one line; what is no UTF-8 in the name of a file stands there by its code.
    """

    run: str
    participant: str
    number: int
    started: str
    seconds: float
    cpu_seconds: float | None = None
    peak_mb: float | None = None
    ended: str
    words: Annotated[str, AfterValidator(encodable)] = ""
    host: str


class LastRun(CohortRecord):
    """``last.json`` of a participant: the tries of the run that was at it last; the last one counts."""

    schema_version: int = 1
    tries: tuple[Try, ...]


def now() -> str:
    """The time as it is recorded, UTC."""
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())


def write_last(path: Path, tries: Sequence[Try]) -> None:
    """Write how a participant's last run went. Raises SubjectError if it can't be written."""
    write_json(path, LastRun(tries=tuple(tries)).model_dump(mode="json"))


def read_last(path: Path) -> LastRun | None:
    """How a participant's last run went; None where that is not known."""
    try:
        text = read_text(path)
        parse_json(text, str(path))
        return LastRun.model_validate_json(text, strict=True)
    except (SubjectError, ValidationError):
        return None


_KEEP_TRY = "INSERT OR REPLACE INTO tries VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"


def _values(tried: Try) -> tuple[object, ...]:
    return (
        tried.run, tried.participant, tried.number, tried.started, tried.seconds, tried.cpu_seconds, tried.peak_mb,
        tried.ended, tried.words, tried.host,
    )  # fmt: skip


def take_over(target: Path, tries: Iterable[Try]) -> None:
    """Keep tries of runs that had no ledger; what is known already stays one.

    Raises
    ------
    SubjectError : as ``open_ledger``.
    """
    path = target / LEDGER_FILE
    with closing(_connected(path)) as connection, _told(path), connection:
        connection.executemany(_KEEP_TRY, map(_values, tries))


class Ledger:
    """The open ledger of one run."""

    def __init__(self, connection: sqlite3.Connection, path: Path, run: str) -> None:
        self._connection, self._path, self.run = connection, path, run

    def begin_try(self, participant: str, number: int, host: str) -> None:
        """A try begins, on a machine."""
        values = (self.run, participant, number, now(), host)
        self._write("INSERT INTO tries (run, participant, try, started, host) VALUES (?, ?, ?, ?, ?)", [values])

    def end_try(self, tried: Try) -> None:
        """A try has ended."""
        self._write(_KEEP_TRY, [_values(tried)])

    def usual_seconds(self) -> float | None:
        """Median wall-clock time of the tries that made results; None where there are none."""
        with _told(self._path):
            found = [
                seconds for (seconds,) in self._connection.execute("SELECT seconds FROM tries WHERE ended = 'done'")
            ]
        return sorted(found)[len(found) // 2] if found else None

    def end(self, how: str) -> None:
        """The run has ended."""
        self._write("UPDATE runs SET ended = ?, how = ? WHERE run = ?", [(now(), how, self.run)])

    def _write(self, statement: str, rows: Sequence[tuple[object, ...]]) -> None:
        with _told(self._path), self._connection:
            self._connection.executemany(statement, rows)


@contextmanager
def open_ledger(target: Path, run: str, order: Order) -> Iterator[Ledger]:
    """The ledger of the cohort whose results are in ``target``, made if there is none, for a run that begins now.

    Tries that a run before left open have ended with it. A file that is no ledger is moved aside.

    Raises
    ------
    SubjectError : it can't be written, or it is of a later version of this program.
    """
    path = target / LEDGER_FILE
    with closing(_connected(path)) as connection:
        with _told(path), connection:
            connection.execute("UPDATE tries SET ended = 'lost', words = 'ended with its run' WHERE ended IS NULL")
            connection.execute("UPDATE runs SET how = 'lost' WHERE how IS NULL")
            values = (
                run, now(), _account(), socket.gethostname(), os.getpid(), order.version, order.runner,
                json.dumps(order.settings, sort_keys=True),
            )  # fmt: skip
            connection.execute(
                "INSERT INTO runs (run, started, account, host, process, version, runner, settings) "
                "VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
                values,
            )
        ledger = Ledger(connection, path, run)
        try:
            yield ledger
        except BaseException:
            with suppress(SubjectError):
                ledger.end("stopped")
            raise
        ledger.end("ended")


def _account() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError, ImportError):  # a container's number without a name
        return "unknown"


def _connected(path: Path) -> sqlite3.Connection:
    try:
        return _opened(path)
    except sqlite3.DatabaseError as problem:
        if isinstance(problem, sqlite3.OperationalError):
            raise SubjectError(f"{path}: can't be used as a ledger ({problem})") from None
    number = 1
    while (aside := path.with_name(f"ledger-aside-{number}.sqlite")).exists():
        number += 1
    with _told(path):
        path.rename(aside)
        journal = path.with_name(f"{path.name}-journal")
        journal.unlink(missing_ok=True)
        return _opened(path)


def _opened(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(path, timeout=30.0)
    try:
        version = connection.execute("PRAGMA user_version").fetchone()[0]
        if version > LEDGER_VERSION:
            raise SubjectError(f"{path}: a ledger of version {version}, this program knows up to {LEDGER_VERSION}")
        if connection.execute("PRAGMA quick_check").fetchone()[0] != "ok":
            raise sqlite3.DatabaseError("damaged")
        if version == 0:
            connection.executescript(f"BEGIN; {_TABLES} PRAGMA user_version = {LEDGER_VERSION}; COMMIT;")
    except BaseException:
        connection.close()
        raise
    return connection


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Whatever goes wrong with the ledger ends in one line."""
    try:
        yield
    except (sqlite3.Error, OSError) as problem:
        raise SubjectError(f"{path}: can't be written ({problem})") from None
