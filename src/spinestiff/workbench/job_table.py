"""Jobs in a table of SQLite, which outlives page and server; nothing of a subject stands in it but its key."""

from __future__ import annotations

import json
import secrets
import sqlite3
import time
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from spinestiff.errors import InUseError, NotThere, SubjectError

State = Literal["waiting", "running", "done", "failed", "cancelled", "lost"]
OPEN: tuple[State, ...] = ("waiting", "running")
LOST_S = 15.0
"""Seconds without a sign of life after which a job's process has ended without a word."""
KEPT = 5000
SHOWN = 50
"""Jobs that the page lists: the latest of a subject, and the latest of all."""
_SCHEMA = """
CREATE TABLE IF NOT EXISTS job (
  id TEXT PRIMARY KEY, subject TEXT NOT NULL, verb TEXT NOT NULL, options TEXT NOT NULL, state TEXT NOT NULL,
  asked REAL NOT NULL, began REAL, ended REAL, beat REAL, status INTEGER, cancel INTEGER NOT NULL DEFAULT 0
);
CREATE UNIQUE INDEX IF NOT EXISTS one_at_a_time ON job(subject) WHERE state IN ('waiting', 'running');
"""


@dataclass(frozen=True)
class Job:
    """A job.

    Attributes
    ----------
    subject : key of the subject. verb, options : what is done (``verbs``).
    asked, began, ended : seconds since 1970. status : exit status of its process.
    cancel : somebody asked for its end.
    """

    id: str
    subject: str
    verb: str
    options: Mapping[str, Any]
    state: State
    asked: float
    began: float | None
    ended: float | None
    status: int | None
    cancel: bool

    def record(self) -> dict[str, Any]:
        """As JSON."""
        return {**vars(self), "options": dict(self.options)}


class JobTable:
    """The table, in a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @contextmanager
    def _open(self) -> Iterator[sqlite3.Connection]:
        try:
            # A connection a call: threads and processes share nothing but the file.
            with closing(sqlite3.connect(self.path, timeout=20.0, isolation_level=None)) as connection:
                connection.row_factory = sqlite3.Row
                yield connection
        except sqlite3.IntegrityError:
            raise
        except sqlite3.Error as problem:
            raise SubjectError(f"the table of jobs can't be used ({problem}); see docs/workbench.md") from None

    def make(self) -> None:
        """The file, if it is not there."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self._open() as table:
            table.executescript(_SCHEMA)

    def add(self, subject: str, verb: str, options: Mapping[str, Any]) -> Job:
        """A job that waits. Raises InUseError where the subject has one that is not over."""
        name = secrets.token_hex(8)
        try:
            with self._open() as table:
                table.execute(
                    "INSERT INTO job (id, subject, verb, options, state, asked) VALUES (?, ?, ?, ?, 'waiting', ?)",
                    (name, subject, verb, json.dumps(dict(options)), time.time()),
                )
                table.execute(
                    "DELETE FROM job WHERE state NOT IN ('waiting', 'running') AND id NOT IN "
                    "(SELECT id FROM job ORDER BY asked DESC LIMIT ?)",
                    (KEPT,),
                )
        except sqlite3.IntegrityError:
            raise InUseError("this subject has a job already; wait for its end, or cancel it") from None
        return self.job(name)

    def job(self, name: str) -> Job:
        """A job. Raises NotThere."""
        if not self.path.exists():
            raise NotThere("there are no jobs yet")
        with self._open() as table:
            row = table.execute("SELECT * FROM job WHERE id = ?", (name,)).fetchone()
        if row is None:
            raise NotThere("this job is not there, or no longer")
        return _job(row)

    def jobs(self, subject: str | None = None, most: int = SHOWN) -> list[Job]:
        """Jobs, the latest first; of one subject or all."""
        if not self.path.exists():
            return []
        with self._open() as table:
            rows = table.execute(
                "SELECT * FROM job WHERE ? IS NULL OR subject = ? ORDER BY asked DESC LIMIT ?", (subject, subject, most)
            ).fetchall()
        return [_job(row) for row in rows]

    def shown(self) -> set[str]:
        """Ids of all jobs that the page can show, and of those that are not over."""
        with self._open() as table:
            rows = table.execute(
                "SELECT id FROM (SELECT id, state, ROW_NUMBER() OVER (ORDER BY asked DESC) AS ago, "
                "ROW_NUMBER() OVER (PARTITION BY subject ORDER BY asked DESC) AS ago_of_subject FROM job) "
                "WHERE ago <= ? OR ago_of_subject <= ? OR state IN ('waiting', 'running')",
                (SHOWN, SHOWN),
            ).fetchall()
        return {row["id"] for row in rows}

    def latest(self) -> dict[str, Job]:
        """The last job of each subject."""
        if not self.path.exists():
            return {}
        with self._open() as table:
            rows = table.execute("SELECT *, MAX(asked) FROM job GROUP BY subject").fetchall()
        return {row["subject"]: _job(row) for row in rows}

    def active(self, subject: str) -> Job | None:
        """The job of a subject that is not over."""
        with self._open() as table:
            row = table.execute(
                "SELECT * FROM job WHERE subject = ? AND state IN ('waiting', 'running')", (subject,)
            ).fetchone()
        return None if row is None else _job(row)

    def take(self, most: int) -> Job | None:
        """The job that has waited longest becomes running, where fewer than ``most`` run."""
        with self._open() as table:
            table.execute("BEGIN IMMEDIATE")
            (running,) = table.execute("SELECT COUNT(*) FROM job WHERE state = 'running'").fetchone()
            row = table.execute("SELECT * FROM job WHERE state = 'waiting' ORDER BY asked LIMIT 1").fetchone()
            if row is None or running >= most:
                table.execute("COMMIT")
                return None
            now = time.time()
            table.execute("UPDATE job SET state = 'running', began = ?, beat = ? WHERE id = ?", (now, now, row["id"]))
            table.execute("COMMIT")
        return self.job(row["id"])

    def ask_cancel(self, name: str) -> None:
        """Have a job ended: at once if it waits, else by its own process."""
        with self._open() as table:
            now = time.time()
            table.execute(
                "UPDATE job SET state = 'cancelled', ended = ? WHERE id = ? AND state = 'waiting'", (now, name)
            )
            table.execute("UPDATE job SET cancel = 1 WHERE id = ? AND state = 'running'", (name,))

    def beat(self, name: str) -> bool:
        """A sign of life; returns whether the job is to go on."""
        with self._open() as table:
            table.execute("UPDATE job SET beat = ? WHERE id = ? AND state = 'running'", (time.time(), name))
            row = table.execute("SELECT state, cancel FROM job WHERE id = ?", (name,)).fetchone()
        return row is not None and row["state"] == "running" and not row["cancel"]

    def end(self, name: str, state: State, status: int | None) -> None:
        """Write how a running job ended."""
        with self._open() as table:
            table.execute(
                "UPDATE job SET state = ?, status = ?, ended = ? WHERE id = ? AND state = 'running'",
                (state, status, time.time(), name),
            )

    def give_up_lost(self) -> None:
        """Running jobs without a sign of life are lost."""
        with self._open() as table:
            now = time.time()
            table.execute(
                "UPDATE job SET state = 'lost', ended = ? WHERE state = 'running' AND beat < ?", (now, now - LOST_S)
            )


def _job(row: sqlite3.Row) -> Job:
    names = ("id", "subject", "verb", "state", "asked", "began", "ended", "status")
    return Job(options=json.loads(row["options"]), cancel=bool(row["cancel"]), **{name: row[name] for name in names})
