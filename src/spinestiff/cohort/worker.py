"""One participant in a process of its own: inputs copied, results made, vouched for and published as a whole.

``python -m spinestiff.cohort.worker`` takes one ``Task`` as a line of JSON and tells lines of JSON: ``{"say": words}``
and at last ``{"end": ..., "words": ...}``. It ends as soon as whoever started it has.

However a run ends, the next one finds either whole results or none: a marker is the last file written into results, and
they get their name by one renaming.
"""

from __future__ import annotations

import errno
import importlib
import json
import os
import re
import shutil
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, cast

from pydantic import ValidationError

from spinestiff.cohort.marker import CohortRecord, Marker, Order, digest_of, examine, whole_results
from spinestiff.cohort.places import DONE_FILE, RESULTS, ROW_FILE, Place, digests_of, input_files, place_of
from spinestiff.errors import InUseError, SpinestiffError, SubjectError
from spinestiff.files import read_text, regular_files, trouble, write_json
from spinestiff.formats import parse_json
from spinestiff.observer import Observer
from spinestiff.subject.lock import sole_run

End = Literal["done", "up to date", "refused", "crashed", "out of memory", "no room", "in use"]
Runner = Callable[[Path, str, dict[str, Any], Observer], None]
"""Makes results of a subject folder, a participant's copy: ``runner(folder, participant, settings, say)``.

It writes into ``results/`` there, ``row.json`` at last, and may go on from what a run that was stopped has left.
"""
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG)
"""Of an OSError: others would meet the same."""
LONGEST_WAIT_S = 20.0
"""For another process at the same participant, which may be about to end with the run that started it."""
ORPHANED = 86
"""Exit status where whoever started the process is gone."""


class Task(CohortRecord):
    """One participant to run. ``source``, ``target`` : the cohort's folders."""

    participant: str
    source: str
    target: str
    order: Order

    @property
    def place(self) -> Place:
        """Its folders."""
        return place_of(Path(self.source), Path(self.target), self.participant)


def make_results(task: Task, say: Observer, begun: Callable[[], None] = lambda: None) -> Literal["done", "up to date"]:
    """Make and publish a participant's results, unless they are there.

    Parameters
    ----------
    begun : is called once no other run is at this participant.

    Raises
    ------
    SpinestiffError : what the runner refuses; inputs that can't be read, outputs that can't be written; a participant
        that another run is at.
    OSError : outputs that can't be moved.
    """
    place = task.place
    place.target.mkdir(parents=True, exist_ok=True)
    with _alone(place):
        begun()
        _finish_replacing(place)
        found = examine(place, task.order)
        if found.state == "current":
            tidy(place)
            return "up to date"
        if found.state == "damaged":
            say(f"warning: {found.words}; moved to {_move_aside(place).name}, made again")
        _copy_inputs(place, task, found.marker)
        inputs = digests_of(input_files(place.work))
        results = place.work / RESULTS
        results.mkdir(exist_ok=True)
        runner_of(task.order.runner)(place.work, task.participant, dict(task.order.settings), say)
        _check_row(results, task.participant)
        _vouch(results, task, inputs)
        _publish(place)
    return "done"


@contextmanager
def _alone(place: Place) -> Iterator[None]:
    latest = time.monotonic() + LONGEST_WAIT_S
    with ExitStack() as held:
        while True:
            try:
                held.enter_context(sole_run(place.target, place.lock))
                break
            except InUseError:
                if time.monotonic() > latest:
                    raise
                time.sleep(0.1)
        yield


def runner_of(name: str) -> Runner:
    """The function "module:name". Raises SubjectError where there is none."""
    module, _, function = name.partition(":")
    try:
        return cast(Runner, getattr(importlib.import_module(module), function))
    except (ImportError, AttributeError) as problem:
        raise SubjectError(f"runner '{name}': {problem}; wanted module:function") from None


def recover(place: Place) -> None:
    """Have results stand that a run was just replacing when it was killed; not where another run is at work."""
    with suppress(OSError, InUseError):
        if place.before.exists():
            with sole_run(place.target, place.lock):
                _finish_replacing(place)


def _finish_replacing(place: Place) -> None:
    """Where a run ended while it replaced results: the new ones stand if they were whole, else the old ones."""
    if not place.before.exists():
        return
    # The folder of a run holds its results under the same name as that of the participant.
    if not place.results.exists() and whole_results(replace(place, target=place.work)).state == "current":
        (place.work / RESULTS).rename(place.results)
    if whole_results(place).state == "current":
        shutil.rmtree(place.before)
    else:
        if place.results.exists():
            _move_aside(place)
        place.before.rename(place.results)


def _move_aside(place: Place) -> Path:
    number = 1
    while (aside := place.target / f"aside-{number}").exists():
        number += 1
    place.results.rename(aside)
    return aside


def _copy_inputs(place: Place, task: Task, marker: Marker | None) -> None:
    """The private subject folder: inputs copied anew; results of a run that was stopped, or of earlier inputs, with it.

    What was made by another order is not taken along, since it may hold what this one does not make.
    """
    kept = place.work / RESULTS
    if _task_left(place) != task.order:
        shutil.rmtree(kept, ignore_errors=True)
    start = place.target / "work-results"
    shutil.rmtree(start, ignore_errors=True)
    if kept.is_dir() and not kept.is_symlink():
        kept.rename(start)
    elif marker is not None and marker.order == task.order:
        shutil.copytree(place.results, start, ignore=shutil.ignore_patterns(".*"))
        (start / DONE_FILE).unlink()
    if place.work.is_symlink() or place.work.is_file():
        place.work.unlink()
    elif place.work.exists():
        shutil.rmtree(place.work)
    place.work.mkdir()
    for name, path in input_files(place.source).items():
        copy = place.work / name
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, copy)
    if start.exists():
        start.rename(kept)
        for litter in [path for path in kept.rglob(".*.tmp") if path.is_file()]:
            litter.unlink()
    write_json(place.task, task.order.model_dump(mode="json"))


def _task_left(place: Place) -> Order | None:
    try:
        text = read_text(place.task)
        parse_json(text, str(place.task))
        return Order.model_validate_json(text, strict=True)
    except (SubjectError, ValidationError):
        return None


def _check_row(results: Path, participant: str) -> None:
    from spinestiff.cohort.row import read_row

    row = read_row(results / ROW_FILE)
    if row.participant != participant:
        raise SubjectError(f"{results / ROW_FILE}: is the row of '{row.participant}', wanted that of '{participant}'")


def _vouch(results: Path, task: Task, inputs: dict[str, str]) -> None:
    (results / DONE_FILE).unlink(missing_ok=True)
    made = {path.relative_to(results).as_posix(): path for path in regular_files(results, SubjectError)}
    digest = digest_of(task.participant, task.order, inputs)
    marker = Marker(
        participant=task.participant, digest=digest, order=task.order, inputs=inputs, outputs=digests_of(made)
    )
    write_json(results / DONE_FILE, marker.model_dump(mode="json"))


def _publish(place: Place) -> None:
    if place.results.exists():
        place.results.rename(place.before)
    try:
        (place.work / RESULTS).rename(place.results)
    except OSError:
        if place.before.exists():
            place.before.rename(place.results)
        raise
    _settle(place.target)
    tidy(place)


def tidy(place: Place) -> None:
    """Take away what is beside results that are whole and current: working folders, and the results before them."""
    for folder in (place.before, place.work, place.target / "work-results"):
        shutil.rmtree(folder, ignore_errors=True)
    with suppress(OSError):
        place.task.unlink(missing_ok=True)


def _settle(folder: Path) -> None:
    """Have the system write a folder's names to the disk, where it can."""
    if os.name == "nt":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as problem:
        if problem.errno not in (errno.EINVAL, errno.ENOTSUP):  # as some network file systems say of a folder
            raise
    finally:
        os.close(handle)


def ended(error: BaseException) -> tuple[End, str]:
    """How an exception ends a run, and one line about it."""
    chain: list[BaseException] = []
    link: BaseException | None = error
    while link is not None and link not in chain:
        chain.append(link)
        link = link.__cause__ or link.__context__
    words = " ".join(str(error).split())
    if any(isinstance(one, MemoryError) for one in chain):
        return "out of memory", words or "memory ran out"
    for one in chain:
        if isinstance(one, OSError) and one.errno in NO_ROOM:
            return "no room", words if isinstance(error, SpinestiffError) else _named(one)
    if isinstance(error, InUseError):
        return "in use", words
    if isinstance(error, SpinestiffError):
        io_failed = any(isinstance(one, OSError) and one.errno == errno.EIO for one in chain)
        return "crashed" if io_failed else "refused", words
    if isinstance(error, OSError):
        return "crashed", _named(error)
    return "crashed", f"{type(error).__name__}: {words}"


def as_given(words: str, place: Place) -> str:
    """A message about an input's copy as one about the input."""
    work = str(place.work)
    for there in (f"{work}{os.sep}", f"{work}:"):
        words = re.sub(rf"{re.escape(there)}(?!{RESULTS}\b)", lambda found: f"{place.source}{found[0][-1]}", words)
    return words


def _named(problem: OSError) -> str:
    return trouble(problem) if problem.filename is None else f"{problem.filename}: {trouble(problem)}"


def main() -> None:
    """Run the task that standard input names; see the module."""
    # What a library prints goes to the log, so that it can't be taken for what this process tells.
    telling = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    turn = threading.Lock()

    def tell(**what: Any) -> None:
        with turn:
            print(json.dumps(what), file=telling, flush=True)

    task = Task.model_validate_json(sys.stdin.buffer.readline(), strict=True)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    end: End
    try:
        end, words = make_results(task, lambda line: tell(say=line), _empty_log), ""
    except Exception as error:
        end, words = ended(error)
        words = as_given(words, task.place)
        if end == "crashed":
            traceback.print_exc()
    tell(end=end, words=words, **_cost())
    sys.stderr.flush()
    # Whatever a library has left running: the results stand.
    os._exit(0)


def _empty_log() -> None:
    """What earlier runs wrote goes; while another one was at this participant, it was that one's."""
    with suppress(OSError):  # no file
        os.ftruncate(2, 0)


def _end_with_parent() -> None:
    while os.read(0, 1):
        pass
    os._exit(ORPHANED)


def _cost() -> dict[str, float]:
    if os.name == "nt":
        return {}
    import resource

    own, children = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    unit = 2**20 if sys.platform == "darwin" else 2**10
    return {
        "cpu_seconds": round(sum(one.ru_utime + one.ru_stime for one in (own, children)), 3),
        "peak_mb": round(max(_own_peak(own.ru_maxrss), children.ru_maxrss) / unit, 1),
    }


def _own_peak(told: int) -> int:
    """The largest resident memory of this process alone, in the unit of ``told``, its ``ru_maxrss``.

    On Linux that begins with the memory of whoever started the process.
    """
    with suppress(OSError):
        for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1])
    return told


if __name__ == "__main__":
    main()
