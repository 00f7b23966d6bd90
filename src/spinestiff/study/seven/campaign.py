"""Many subjects of the study, a process each, so many at a time; what is there already is left as it is."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from threading import Thread
from typing import Any

from spinestiff.errors import SpinestiffError
from spinestiff.parallel import VARIABLES
from spinestiff.study.seven.participants import Participant
from spinestiff.study.seven.subject import known_outcome, note_failure, study_subject
from spinestiff.study.visit import Settings
from spinestiff.subject.study_outcome import SubjectOutcome

Study = Callable[[Path, Participant, Settings, Callable[[str], None]], SubjectOutcome]
OnLine = Callable[[str, str], None]
DONE, FAILED, AGAIN = "done", "failed: ", "its process ended before it was done; once more"
MOST_TRIES = 2
"""Of a subject whose process ends by itself in one run; an error that it tells is not tried again."""
ENDED = f"its process ended before it was done, {MOST_TRIES} times (memory, or from outside); run the command again"


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
    """Every subject's outcome; a subject that fails, whatever the error, leaves the others alone, and its reason in a
    file of its own (``subject.failure_file``).

    Parameters
    ----------
    on_line : is told a subject's name and what it is at; "done" or "failed: why" at its end.
    workers : processes at a time, each on one thread; 1: in this process, on all threads.
    study : makes an outcome.
    """
    outcomes, failures, todo = dict[str, SubjectOutcome](), dict[str, str](), list[Participant]()

    def ended(one: Participant, result: SubjectOutcome | str) -> None:
        if isinstance(result, str):
            failures[one.name] = result
        else:
            outcomes[one.name] = result
        note_failure(folder, one, settings, failures.get(one.name))
        on_line(one.name, f"{FAILED}{failures[one.name]}" if one.name in failures else DONE)

    for one in participants:
        known = known_outcome(folder, one, settings)
        if known is None:
            todo.append(one)
        else:
            ended(one, known)
    if workers <= 1 or len(todo) <= 1:
        for one in todo:
            ended(one, _result(study, folder, one, settings, lambda line, name=one.name: on_line(name, line)))  # type: ignore[misc]
    else:
        _in_processes(todo, workers, (study, folder, settings), on_line, ended)
    return Found(outcomes, failures)


def _result(
    study: Study, folder: Path, one: Participant, settings: Settings, say: Callable[[str], None]
) -> SubjectOutcome | str:
    """The outcome, or why there is none."""
    try:
        return study(folder, one, settings, say)
    except SpinestiffError as error:
        return str(error)
    except Exception as error:  # a full disk, no memory, no convergence: the other subjects may still end well
        return " ".join(f"{type(error).__name__}: {error}".split())


@dataclass(frozen=True)
class _Running:
    """A process at work on a subject; what it tells comes out of ``told``."""

    one: Participant
    tries: int
    process: BaseProcess
    told: Connection


def _in_processes(
    todo: Sequence[Participant],
    workers: int,
    asked: tuple[Study, Path, Settings],
    on_line: OnLine,
    ended: Callable[[Participant, SubjectOutcome | str], None],
) -> None:
    """A process of its own for each subject, so that one that dies takes no other with it."""
    context = multiprocessing.get_context("spawn")
    waiting, running = deque((one, 1) for one in todo), dict[Connection, _Running]()
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                one, tries = waiting.popleft()
                told, tell = context.Pipe(duplex=False)
                process = context.Process(target=_work, args=(tell, one, *asked))
                with _one_thread_each():
                    process.start()
                # The end of the pipe is seen only when no other process holds it open.
                tell.close()
                running[told] = _Running(one, tries, process, told)
            for ready in wait(list(running)):
                at = running[ready]  # type: ignore[index]
                try:
                    final, what = at.told.recv()
                except (EOFError, OSError):
                    final, what = True, None
                if not final:
                    on_line(at.one.name, what)
                    continue
                del running[at.told]
                at.process.join()
                at.told.close()
                if what is None and at.tries < MOST_TRIES:
                    on_line(at.one.name, AGAIN)
                    waiting.append((at.one, at.tries + 1))
                else:
                    ended(at.one, ENDED if what is None else what)
    finally:
        for at in running.values():
            at.process.kill()
            at.process.join()


def _work(tell: Any, one: Participant, study: Study, folder: Path, settings: Settings) -> None:
    """What a process does: tell (False, line) as it goes and (True, outcome or why there is none) at its end."""
    # Ctrl-C is for the process that started this one, which ends it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_parent, daemon=True).start()
    tell.send((True, _result(study, folder, one, settings, lambda line: tell.send((False, line)))))


def _end_with_parent() -> None:
    """End this process when the one that started it has, by a signal, too."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


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
