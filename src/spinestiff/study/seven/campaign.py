"""Many subjects of the study, a process each, so many at a time; what is there already is left as it is."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing.queues import Queue
from pathlib import Path
from threading import Thread
from typing import Any

from spinestiff.errors import SpinestiffError
from spinestiff.parallel import VARIABLES
from spinestiff.study.seven.participants import Participant
from spinestiff.study.seven.subject import known_outcome, study_subject
from spinestiff.study.visit import Settings
from spinestiff.subject.study_outcome import SubjectOutcome

Study = Callable[[Path, Participant, Settings, Callable[[str], None]], SubjectOutcome]
OnLine = Callable[[str, str], None]
DONE, FAILED = "done", "failed: "
ENDED = "its process ended before it was done (memory, or from outside); run the command again"


@dataclass(frozen=True)
class Found:
    """What is known of the subjects that were asked for: outcomes by name, and why others have none."""

    outcomes: Mapping[str, SubjectOutcome]
    failures: Mapping[str, str]


def run_study(
    folder: Path,
    participants: Sequence[Participant],
    settings: Settings,
    on_line: OnLine,
    workers: int,
    study: Study = study_subject,
) -> Found:
    """Every subject's outcome; a subject that fails leaves the others alone.

    Parameters
    ----------
    on_line : is told a subject's name and what it is at; "done" or "failed: why" at its end.
    workers : processes at a time, each on one thread; 1: in this process, on all threads.
    study : makes an outcome.
    """
    outcomes, failures, todo = dict[str, SubjectOutcome](), dict[str, str](), list[Participant]()

    def ended(name: str, result: Callable[[], SubjectOutcome]) -> None:
        try:
            outcomes[name] = result()
        except SpinestiffError as error:
            failures[name] = str(error)
        except BrokenProcessPool:
            failures[name] = ENDED
        on_line(name, f"{FAILED}{failures[name]}" if name in failures else DONE)

    for one in participants:
        known = known_outcome(folder, one, settings)
        if known is None:
            todo.append(one)
        else:
            outcomes[one.name] = known
            on_line(one.name, DONE)
    if workers <= 1 or len(todo) <= 1:
        for one in todo:
            ended(one.name, partial(study, folder, one, settings, partial(on_line, one.name)))
        return Found(outcomes, failures)
    context = multiprocessing.get_context("spawn")
    lines: Queue[tuple[str, str] | None] = context.Queue()
    telling = Thread(target=_tell, args=(lines, on_line), daemon=True)
    telling.start()
    with _one_thread_each(), ProcessPoolExecutor(workers, context, _begin, (lines,)) as pool:
        waiting: Mapping[str, Future[SubjectOutcome]] = {
            one.name: pool.submit(_in_process, study, folder, one, settings) for one in todo
        }
        try:
            for name, future in waiting.items():
                ended(name, future.result)
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    lines.put(None)
    telling.join()
    return Found(outcomes, failures)


_LINES: list[Any] = []


def _begin(lines: Any) -> None:
    _LINES[:] = [lines]


def _in_process(study: Study, folder: Path, one: Participant, settings: Settings) -> SubjectOutcome:
    return study(folder, one, settings, lambda line: _LINES[0].put((one.name, line)))


def _tell(lines: Any, on_line: OnLine) -> None:
    while (line := lines.get()) is not None:
        on_line(*line)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes that start in here work on one thread, and so do the libraries they load."""
    before = {name: os.environ.get(name) for name in VARIABLES}
    os.environ |= dict.fromkeys(VARIABLES, "1")
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
