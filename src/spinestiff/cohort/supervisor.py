"""A cohort's participants run side by side, each in a process of its own, watched and tried once more where one fails.

What is there already is left as it is (``marker.examine``). A participant that crashes, hangs or takes too much memory
ends alone. Where there is no room to write, the run stops: every further participant would meet the same.
"""

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
import uuid
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from spinestiff.cohort.ledger import Ledger, Try, now, open_ledger, write_last
from spinestiff.cohort.lock import cohort_lock
from spinestiff.cohort.marker import Order, examine
from spinestiff.cohort.places import CACHE, place_of, sweep
from spinestiff.cohort.worker import ORPHANED, Task, tidy
from spinestiff.errors import OptionError, SubjectError
from spinestiff.files import trouble

MOST_TRIES = 2
"""Of a participant in one run; a refusal of its inputs is not tried again, since they stay the same."""
_POLL_S = 0.1
_STATM = Path("/proc/self/statm")
Stage = Literal["up to date", "waiting", "running", "again", "done", "failed"]
FINAL = ("refused", "in use")
KEPT = "; results that were finished are kept"


@dataclass(frozen=True)
class Limits:
    """What one participant may take: wall-clock seconds and resident memory, MB; None = no limit."""

    seconds: float | None = None
    memory_mb: float | None = None

    def __post_init__(self) -> None:
        if self.memory_mb is not None and not _STATM.exists():
            raise OptionError("--memory: the memory of a process is not told by this system; leave the option out")


@dataclass(frozen=True)
class News:
    """What has become of a participant.

    Attributes
    ----------
    words : the step that it is at, or why it failed. seconds : that its try took.
    """

    participant: str
    stage: Stage
    words: str = ""
    seconds: float = 0.0


@dataclass(frozen=True)
class Summary:
    """What became of the participants, by name, in their order; of those that failed with the reason."""

    up_to_date: tuple[str, ...]
    done: tuple[str, ...]
    failed: dict[str, str]


OnNews = Callable[[News], None]


@dataclass(frozen=True)
class Cohort:
    """A cohort to run.

    Attributes
    ----------
    source : folder with ``participants.tsv`` and a subject folder each. target : where all results go.
    participants : in order. order : what is asked for each.
    """

    source: Path
    target: Path
    participants: tuple[str, ...]
    order: Order

    def __post_init__(self) -> None:
        inside = self.target.resolve().is_relative_to(self.source.resolve())
        if inside or self.source.resolve().is_relative_to(self.target.resolve()):
            raise SubjectError(f"{self.target}: lies in {self.source}, or around it; wanted two folders apart")


@dataclass
class _Running:
    """A process at work."""

    participant: str
    number: int
    process: subprocess.Popen[bytes]
    started: str
    began: float = field(default_factory=time.monotonic)
    told: dict[str, Any] | None = None
    killed: str = ""
    peak_mb: float = 0.0


def run_participants(
    cohort: Cohort,
    jobs: int = 1,
    limits: Limits | None = None,
    news: OnNews | None = None,
    expect: Callable[[float | None], None] | None = None,
) -> Summary:
    """Run every participant whose results are missing, damaged or out of date.

    Parameters
    ----------
    jobs : processes side by side. limits : of each.
    news : is told what becomes of each participant.
    expect : is told once how long a participant took so far, by the ledger, in seconds.

    Raises
    ------
    InUseError : another run is at work on the same output.
    SubjectError : no room to write, in which case all that was finished stays; or the output or its ledger can't be
        written.
    """
    say = news or (lambda one: None)
    run = uuid.uuid4().hex
    with cohort_lock(cohort.target), open_ledger(cohort.target, run, cohort.order) as ledger:
        if expect is not None:
            expect(ledger.usual_seconds())
        return _run(cohort, run, ledger, jobs, limits or Limits(), say)


def run_one(cohort: Cohort, index: int, limits: Limits | None = None, news: OnNews | None = None) -> Summary:
    """Run the one participant in row ``index`` of the table, from 1, beside other such runs; there is no ledger.

    Raises
    ------
    OptionError : no such row. InUseError, SubjectError : as ``run_participants``.
    """
    if not 1 <= index <= len(cohort.participants):
        raise OptionError(f"--index {index}: wanted a row of participants.tsv, 1 to {len(cohort.participants)}")
    alone = Cohort(cohort.source, cohort.target, (cohort.participants[index - 1],), cohort.order)
    with cohort_lock(cohort.target, shared=True):
        return _run(alone, uuid.uuid4().hex, None, 1, limits or Limits(), news or (lambda one: None))


def _run(cohort: Cohort, run: str, ledger: Ledger | None, jobs: int, limits: Limits, say: OnNews) -> Summary:
    current = []
    for participant in cohort.participants:
        place = place_of(cohort.source, cohort.target, participant)
        sweep(place.target)
        found = examine(place, cohort.order)
        if found.state == "current":
            current.append(participant)
            tidy(place)
        say(News(participant, "up to date" if found.state == "current" else "waiting", found.words))
    there = set(current)
    at_work = _Work(cohort, run, ledger, limits, say)
    waiting = deque((participant, 1) for participant in cohort.participants if participant not in there)
    with at_work.watched():
        while waiting or at_work.running:
            while waiting and len(at_work.running) < jobs:
                at_work.start(*waiting.popleft())
            # At once: where there is no room, no other participant has to find that out.
            waiting.extendleft((participant, MOST_TRIES) for participant in at_work.ended())
    order = {participant: place for place, participant in enumerate(cohort.participants)}
    return Summary(
        tuple(current),
        tuple(sorted(at_work.done, key=order.__getitem__)),
        dict(sorted(at_work.failed.items(), key=lambda one: order[one[0]])),
    )


class _Work:
    """The processes of one run."""

    def __init__(self, cohort: Cohort, run: str, ledger: Ledger | None, limits: Limits, say: OnNews) -> None:
        self.cohort, self.run, self.ledger, self.limits, self.say = cohort, run, ledger, limits, say
        self.running: dict[str, _Running] = {}
        self.done: list[str] = []
        self.failed: dict[str, str] = {}
        self._tries: dict[str, list[Try]] = {}
        self._told: queue.Queue[tuple[_Running, dict[str, Any] | None]] = queue.Queue()
        self._environment = worker_environment(cohort.target)

    @contextmanager
    def watched(self) -> Iterator[None]:
        """However this run ends, its processes end with it."""
        with ExitStack() as ends:
            ends.callback(self._end_all)
            if threading.current_thread() is threading.main_thread():
                before = signal.signal(signal.SIGTERM, _interrupt)
                ends.callback(signal.signal, signal.SIGTERM, before)
            yield

    def start(self, participant: str, number: int) -> None:
        """Start a try at a participant."""
        cohort = self.cohort
        place = place_of(cohort.source, cohort.target, participant)
        task = Task(participant=participant, source=str(cohort.source), target=str(cohort.target), order=cohort.order)
        if self.ledger is not None:
            self.ledger.begin_try(participant, number)
        try:
            place.target.mkdir(parents=True, exist_ok=True)
            with place.log.open("wb") as log:
                process = subprocess.Popen(
                    [sys.executable, "-m", "spinestiff.cohort.worker"],
                    stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, env=self._environment,
                    # Ctrl-C is for this process, which ends the others.
                    start_new_session=True,
                )  # fmt: skip
        except OSError as problem:
            raise SubjectError(f"{place.target}: can't be written ({trouble(problem)}){KEPT}") from None
        one = _Running(participant, number, process, now())
        self.running[participant] = one
        assert process.stdin is not None
        try:
            process.stdin.write(task.model_dump_json().encode() + b"\n")
            process.stdin.flush()
        except OSError:
            pass  # it ended at once: its status tells
        threading.Thread(target=self._listen, args=(one,), daemon=True).start()
        self.say(News(participant, "running"))

    def ended(self) -> list[str]:
        """Wait a moment; participants that are to be tried again."""
        again = []
        for one in self._heard():
            process = one.process
            status = process.wait()
            _close(process)
            del self.running[one.participant]
            tried = self._judged(one, status)
            if self.ledger is not None:
                self.ledger.end_try(tried)
            tries = self._tries.setdefault(one.participant, [])
            tries.append(tried)
            if tried.ended != "no room":
                # Before a further try: whatever ends this run from outside leaves why the first one failed.
                write_last(place_of(self.cohort.source, self.cohort.target, one.participant).last, tries)
            if tried.ended in ("done", "up to date"):
                self.done.append(one.participant)
                self.say(News(one.participant, "done", tried.words, tried.seconds))
            elif tried.ended not in FINAL and one.number < MOST_TRIES:
                self.say(News(one.participant, "again", tried.words, tried.seconds))
                again.append(one.participant)
            elif tried.ended == "no room":
                raise SubjectError(f"{tried.words}{KEPT}")
            else:
                self.failed[one.participant] = tried.words
                self.say(News(one.participant, "failed", tried.words, tried.seconds))
        return again

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
                self.say(News(one.participant, "running", str(told["say"])))
            else:
                one.told = told
        for one in self.running.values():
            if one not in over:
                self._check(one)
        return over

    def _check(self, one: _Running) -> None:
        seconds, limits = time.monotonic() - one.began, self.limits
        one.peak_mb = max(one.peak_mb, _resident_mb(one.process.pid))
        if one.killed:
            return
        if limits.seconds is not None and seconds > limits.seconds:
            one.killed = f"timed out: was not done after {limits.seconds:g} s (--minutes)"
        elif limits.memory_mb is not None and one.peak_mb > limits.memory_mb:
            one.killed = f"out of memory: took more than {limits.memory_mb:.0f} MB (--memory)"
        if one.killed:
            _kill(one.process)

    def _judged(self, one: _Running, status: int) -> Try:
        told = one.told or {}
        ended, words = str(told.get("end", "crashed")), str(told.get("words", ""))
        if one.killed:
            ended, words = one.killed.partition(":")[0], one.killed
        elif one.told is None:
            log = place_of(self.cohort.source, self.cohort.target, one.participant).log
            words = f"crashed: its process ended {_status_words(status)}; {log} may tell more"
        elif ended in ("crashed", "out of memory"):
            words = f"{ended}: {words}"
        return Try(
            run=self.run,
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

    def _end_all(self) -> None:
        for one in self.running.values():
            _kill(one.process)
        for one in self.running.values():
            one.process.wait()
            _close(one.process)


def worker_environment(target: Path) -> dict[str, str]:
    """The environment of the participants' processes: a thread each, unless it says otherwise, and compiled kernels
    where all of them find them: beside the sources, or with the results where nothing can be written there."""
    found = dict(os.environ)
    for name in ("SPINESTIFF_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        found.setdefault(name, "1")
    if not os.access(Path(__file__).parents[1], os.W_OK):
        found.setdefault("NUMBA_CACHE_DIR", str((target / CACHE).resolve()))
    return found


def processors() -> int:
    """How many processors this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def usual_memory_mb(jobs: int) -> float | None:
    """Memory that one of so many processes side by side may take: its share of nine tenths; None where not told."""
    if not _STATM.exists():
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
