"""Participants' processes on this machine: started, listened to, ended at a limit; what came of each as a try."""

from __future__ import annotations

import json
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from spinestiff.cohort.account import KEPT
from spinestiff.cohort.asked import STATM, Limits, News, OnNews
from spinestiff.cohort.ledger import Try, now
from spinestiff.cohort.places import CACHE
from spinestiff.cohort.worker import ORPHANED, Task, ended
from spinestiff.errors import SubjectError
from spinestiff.files import trouble, write_bytes

_POLL_S = 0.1


@dataclass
class _Running:
    """A process at work."""

    participant: str
    number: int
    log: Path
    process: subprocess.Popen[bytes]
    started: str
    began: float = field(default_factory=time.monotonic)
    told: dict[str, Any] | None = None
    over: tuple[str, str] | None = None  # which limit, as how the try ended, and by how much in words
    peak_mb: float = 0.0


class Processes:
    """The processes that one run has at work here."""

    def __init__(self, run: str, target: Path, limits: Limits, say: OnNews) -> None:
        self._run, self._limits, self._say = run, limits, say
        self.running: dict[str, _Running] = {}
        self._unstarted: list[Try] = []
        self._told: queue.Queue[tuple[_Running, dict[str, Any] | None]] = queue.Queue()
        self._environment = worker_environment(target)

    def start(self, task: Task, number: int) -> None:
        """Start a try at a participant; one whose folder can't be written has ended at once.

        Raises
        ------
        SubjectError : no process can be started.
        """
        place = task.place
        try:
            # One that is there may be that of another run, at work on this participant: the process empties it.
            if place.log.is_symlink() or not place.log.is_file() or not os.access(place.log, os.W_OK):
                write_bytes(place.log, b"")
        except SubjectError as problem:
            self._unstarted.append(self._unwritable(task, number, problem))
            return
        try:
            with place.log.open("ab") as log:
                process = subprocess.Popen(
                    [sys.executable, "-P", "-m", "spinestiff.cohort.worker"],
                    stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, env=self._environment,
                    # Ctrl-C is for this process, which ends the others.
                    start_new_session=True,
                )  # fmt: skip
        except OSError as problem:
            raise SubjectError(f"{task.participant}: its process can't be started ({trouble(problem)}){KEPT}") from None
        one = _Running(task.participant, number, place.log, process, now())
        self.running[task.participant] = one
        assert process.stdin is not None
        try:
            process.stdin.write(task.model_dump_json().encode() + b"\n")
            process.stdin.flush()
        except OSError:
            pass  # it ended at once: its status tells
        threading.Thread(target=self._listen, args=(one,), daemon=True).start()
        self._say(News(task.participant, "running"))

    def ended(self) -> list[Try]:
        """Wait a moment; tries that have ended since."""
        found, self._unstarted = self._unstarted, []
        for one in self._heard():
            status = one.process.wait()
            _close(one.process)
            del self.running[one.participant]
            found.append(self._judged(one, status))
        return found

    def _unwritable(self, task: Task, number: int, problem: SubjectError) -> Try:
        """A try that could not begin here: others can, and this one may elsewhere, unless there is no room."""
        how, words = ended(problem)
        return Try(
            run=self._run,
            participant=task.participant,
            number=number,
            started=now(),
            seconds=0.0,
            ended="no room" if how == "no room" else "crashed",
            words=words,
            host=socket.gethostname(),
        )

    def _heard(self) -> list[_Running]:
        """Those that have ended since; those over a limit are killed."""
        over: list[_Running] = []
        latest = time.monotonic() + _POLL_S
        while True:
            try:
                one, told = self._told.get(timeout=max(latest - time.monotonic(), 0.001))
            except queue.Empty:
                break
            if told is None:
                over.append(one)
                break
            if "say" in told:
                self._say(News(one.participant, "running", str(told["say"])))
            else:
                one.told = told
        for one in self.running.values():
            if one not in over:
                self._check(one)
        return over

    def _check(self, one: _Running) -> None:
        seconds, limits = time.monotonic() - one.began, self._limits
        one.peak_mb = max(one.peak_mb, _resident_mb(one.process.pid))
        if one.over is not None:
            return
        if limits.seconds is not None and seconds > limits.seconds:
            one.over = "timed out", f"was not done after {limits.seconds:g} s (--minutes)"
        elif limits.memory_mb is not None and one.peak_mb > limits.memory_mb:
            one.over = "out of memory", f"took more than {limits.memory_mb:.0f} MB (--memory)"
        if one.over is not None:
            _kill(one.process)

    def _judged(self, one: _Running, status: int) -> Try:
        told = one.told or {}
        ended, words = str(told.get("end", "crashed")), str(told.get("words", ""))
        if one.over is not None:
            ended, words = one.over[0], ": ".join(one.over)
        elif one.told is None:
            words = f"crashed: its process ended {_status_words(status)}; {one.log} may tell more"
        elif ended in ("crashed", "out of memory"):
            words = f"{ended}: {words}"
        return Try(
            run=self._run,
            participant=one.participant,
            number=one.number,
            started=one.started,
            seconds=round(time.monotonic() - one.began, 3),
            cpu_seconds=told.get("cpu_seconds"),
            peak_mb=told.get("peak_mb") or round(one.peak_mb, 1) or None,
            ended=ended,
            words=words,
            host=socket.gethostname(),
        )

    def _listen(self, one: _Running) -> None:
        assert one.process.stdout is not None
        for line in one.process.stdout:
            try:
                told = json.loads(line)
            except ValueError:
                continue  # half a line of a process that was killed
            if isinstance(told, dict):
                self._told.put((one, told))
        self._told.put((one, None))

    def end_all(self) -> None:
        """End all of them now."""
        for one in self.running.values():
            _kill(one.process)
        for one in self.running.values():
            one.process.wait()
            _close(one.process)


@contextmanager
def told_to_end() -> Iterator[None]:
    """SIGTERM ends what is done here as Ctrl-C does; in another thread than the main one nothing is changed."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def worker_environment(target: Path) -> dict[str, str]:
    """The environment of the participants' processes: a thread each, unless it says otherwise, and compiled kernels
    where all of them find them: beside the sources, or with the results where nothing can be written there."""
    found = dict(os.environ)
    for name in ("SPINESTIFF_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        found.setdefault(name, "1")
    if not os.access(Path(__file__).parents[1], os.W_OK):
        found.setdefault("NUMBA_CACHE_DIR", str((target / CACHE).resolve()))
    return found


def usual_memory_mb(jobs: int) -> float | None:
    """Memory that one of so many processes side by side may take: its share of nine tenths; None where not told."""
    if not STATM.exists():
        return None
    return 0.9 * os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**20 / jobs


def _interrupt(number: int, frame: object) -> None:
    raise KeyboardInterrupt


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End a process and those that it has started."""
    try:
        if os.name == "nt":
            process.kill()
        else:
            os.killpg(process.pid, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        process.kill()


def _close(process: subprocess.Popen[bytes]) -> None:
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with suppress(OSError):
                pipe.close()


def _resident_mb(pid: int) -> float:
    """Resident memory of a process; 0 where that is not told."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    except (OSError, IndexError, ValueError):
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def _status_words(status: int) -> str:
    if status < 0:
        try:
            name = signal.Signals(-status).name
        except ValueError:
            name = str(-status)
        return f"by signal {name}" + (" (the system may have run out of memory)" if name == "SIGKILL" else "")
    return "with the run that had started it" if status == ORPHANED else f"with status {status}"
