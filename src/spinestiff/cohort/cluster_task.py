"""What a worker of a Dask cluster is asked: what it is, and one try at a participant in a process of its own.

Both functions are run by the worker, in one of its threads. A try's process ends as soon as the worker does, and the
try ends as soon as nobody waits for it any more: the run that asked for it was stopped or killed.
"""

from __future__ import annotations

import json
import socket
import time
from pathlib import Path
from typing import Any

from spinestiff.cohort.asked import Limits, News
from spinestiff.cohort.ledger import Try, now
from spinestiff.cohort.marker import CohortRecord
from spinestiff.cohort.participants import PARTICIPANTS_FILE
from spinestiff.cohort.processes import Processes, usual_memory_mb
from spinestiff.cohort.worker import Task, ended
from spinestiff.errors import SpinestiffError

LONGEST_SIGHT_S = 5.0
"""For a shared file system to show here what was just written elsewhere."""
_ALIVE = ("running", "paused", "closing_gracefully")


class Errand(CohortRecord):
    """One try that a worker is asked for.

    Attributes
    ----------
    worker : the one that was chosen, by the identity that it told. run, number : of the try.
    seconds, memory_mb : limits; where no memory is given, the worker's share.
    topic : under which it tells what it is at.
    """

    task: Task
    worker: str
    run: str
    number: int
    seconds: float | None
    memory_mb: float | None
    topic: str


class Traits(CohortRecord):
    """What a worker tells of itself.

    Attributes
    ----------
    identity : of its process. host : its machine's name. program : version and hash of what it would run.
    sees : whether it finds input and output of this run.
    seconds_left, lifetime : until it ends by ``--lifetime``, and that in all; None where it does not end by itself.
    """

    identity: str
    host: str
    program: str
    sees: bool
    seconds_left: float | None
    lifetime: float | None


def traits(source: str, note: str, run: str) -> str:
    """What the worker is, as JSON of ``Traits``; the file ``note`` in the output names the run."""
    from distributed import get_worker

    from spinestiff.subject.program import program

    worker = get_worker()
    latest = time.monotonic() + LONGEST_SIGHT_S
    while not (sees := _sees(Path(source), Path(note), run)) and time.monotonic() < latest:
        time.sleep(0.5)
    lifetime = None if worker.lifetime is None else float(worker.lifetime)
    passed = time.time() - worker.monitor.proc.create_time()
    return Traits(
        identity=worker.id,
        host=socket.gethostname(),
        program=program(),
        sees=sees,
        seconds_left=None if lifetime is None else lifetime - passed,
        lifetime=lifetime,
    ).model_dump_json()


def _sees(source: Path, note: Path, run: str) -> bool:
    try:
        return (source / PARTICIPANTS_FILE).is_file() and note.read_text(encoding="utf-8").strip() == run
    except (OSError, UnicodeDecodeError):
        return False


def attempt(asked: str) -> str:
    """One try, given as JSON of ``Errand``: JSON of the ``Try`` that came of it, or "" if this is another worker."""
    from distributed import get_worker

    errand = Errand.model_validate_json(asked, strict=True)
    worker = get_worker()
    if worker.id != errand.worker:
        return ""
    key = worker.get_current_task()
    host = socket.gethostname()

    def tell(one: News) -> None:
        worker.log_event(errand.topic, json.dumps({"key": key, "host": host, "say": one.words}))

    limits = Limits(errand.seconds, errand.memory_mb if errand.memory_mb is not None else _share_mb(worker))
    processes = Processes(errand.run, Path(errand.task.target), limits, tell)
    started, began = now(), time.monotonic()
    try:
        processes.start(errand.task, errand.number)
        while _awaited(worker, key):
            for tried in processes.ended():
                return tried.model_dump_json()
        return ""
    except SpinestiffError as error:
        how, words = ended(error)
        return Try(
            run=errand.run, participant=errand.task.participant, number=errand.number, started=started,
            seconds=round(time.monotonic() - began, 3), ended="no room" if how == "no room" else "crashed",
            words=words, host=host,
        ).model_dump_json()  # fmt: skip
    finally:
        processes.end_all()


def _share_mb(worker: Any) -> float | None:
    """Memory for one of the worker's threads, where it has a limit; else for one of so many on this machine."""
    limit = worker.memory_manager.memory_limit
    machine = usual_memory_mb(worker.state.nthreads)
    if not limit or machine is None:
        return machine
    return min(0.9 * limit / 2**20 / worker.state.nthreads, machine)


def _awaited(worker: Any, key: Any) -> bool:
    """Whether the worker goes on and somebody still wants to know what comes of the task."""
    task = worker.state.tasks.get(key)
    return worker.status.name in _ALIVE and task is not None and task.state in ("executing", "long-running")
