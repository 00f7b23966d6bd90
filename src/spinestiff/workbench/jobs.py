"""The jobs of a served folder: asked for, started one after the other, watched, cancelled."""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from spinestiff.errors import NotThere, SpinestiffError
from spinestiff.workbench.job_process import start_job
from spinestiff.workbench.job_table import LOST_S, Job, JobTable
from spinestiff.workbench.rooms import Root
from spinestiff.workbench.verbs import command_of

LOOK_S = 0.5
LONGEST_READ = 256 * 2**10
"""Bytes of a log at a time."""


class Jobs:
    """The jobs of a folder.

    Parameters
    ----------
    side_by_side : how many may run at once; of one subject never more than one.
    """

    def __init__(self, root: Root, side_by_side: int = 1) -> None:
        self.root, self.side_by_side = root, side_by_side
        self.table = JobTable(root.own / "jobs.sqlite")
        self._looked = time.time()
        self._over = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Take up what waits, from here on."""
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Start no more; what runs goes on."""
        self._over.set()
        if self._thread is not None:
            self._thread.join(timeout=5.0)

    def ask(self, key: str, verb: str, options: Mapping[str, Any]) -> Job:
        """A new job. Raises OptionError, NotThere, or InUseError where the subject has one."""
        command_of(verb, options)
        self.root.subject(key)
        return self.table.add(key, verb, options)

    def log(self, job: str) -> Path:
        """Where the lines of a job are."""
        return self.root.own / "logs" / f"{job}.log"

    def lines(self, job: str, at: int) -> tuple[list[str], int]:
        """Whole lines of a job's log from a place on, and the place after them."""
        path = self.log(job)
        if not path.is_file():
            return [], at
        with path.open("rb") as file:
            file.seek(at)
            content = file.read(LONGEST_READ)
        whole = content.rfind(b"\n") + 1
        return content[:whole].decode("utf-8", "replace").splitlines(), at + whole

    def _watch(self) -> None:
        while not self._over.wait(LOOK_S):
            try:
                self.look()
            except (SpinestiffError, OSError) as problem:
                logging.getLogger("uvicorn.error").error("jobs: %s", type(problem).__name__)

    def look(self) -> None:
        """Start what can be started."""
        now = time.time()
        if now - self._looked < LOST_S:
            self.table.give_up_lost()
        # Else this machine slept, and so did the processes of jobs: each gives a sign of life before the next look.
        self._looked = now
        while (job := self.table.take(self.side_by_side)) is not None:
            try:
                folder = self.root.subject(job.subject)
            except NotThere:
                self.table.end(job.id, "lost", None)
                continue
            log = self.log(job.id)
            log.parent.mkdir(parents=True, exist_ok=True)
            arguments = command_of(job.verb, job.options)
            start_job(self.table.path, job.id, folder, arguments, log)
            self.clear_logs()

    def clear_logs(self) -> None:
        """Delete the logs of jobs that the page can't show any more."""
        # Looked for before the table is asked: a log that comes meanwhile belongs to a job that is kept.
        logs = list((self.root.own / "logs").glob("*.log"))
        shown = self.table.shown()
        for log in logs:
            if log.stem not in shown:
                with contextlib.suppress(OSError):  # it goes at the next start of a job
                    log.unlink()
