"""Participants on a Dask cluster of several processes: the same bytes; what ends on its way is tried again or named."""

from __future__ import annotations

import os
import re
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path

import pytest

from spinestiff.cohort import cluster
from spinestiff.cohort.asked import Cohort, Limits
from spinestiff.cohort.cluster import run_on_cluster
from spinestiff.cohort.cluster_task import Traits
from spinestiff.cohort.ledger import read_last
from spinestiff.cohort.lock import cohort_lock
from spinestiff.cohort.marker import whole_results
from spinestiff.cohort.places import CLUSTER_FILE, place_of
from spinestiff.cohort.supervisor import run_participants
from spinestiff.errors import InUseError, OptionError, SubjectError
from spinestiff.files import regular_files

needs_dask = pytest.mark.skipif(find_spec("distributed") is None, reason="the extra [cluster] is not installed")

PARENT = """
import sys
from pathlib import Path
from spinestiff.cohort.asked import Cohort
from spinestiff.cohort.cluster import run_on_cluster
from spinestiff.cohort.marker import Order
order = Order.model_validate_json(sys.argv[3])
cohort = Cohort(Path(sys.argv[1]), Path(sys.argv[2]), tuple(sys.argv[4].split(",")), order)
run_on_cluster(cohort, sys.argv[5], news=lambda one: print(one.participant, one.stage, one.words, flush=True))
"""
LONGEST_S = 120.0


class Machines:
    """A scheduler and workers, each a process of its own as on a cluster."""

    def __init__(self, folder: Path, ends: ExitStack) -> None:
        self._folder, self._ends = folder, ends
        self._scheduler = self._start("scheduler", "scheduler", "--port", "0", "--no-dashboard", "--no-show")
        self.address = self._told("scheduler", r"Scheduler at:\s+(tcp://\S+)")

    def _start(self, name: str, *words: str, **environment: str) -> subprocess.Popen:
        with (self._folder / f"{name}.log").open("wb") as log:
            command = [sys.executable, "-m", "distributed.cli.dask_" + words[0], "--host", "127.0.0.1", *words[1:]]
            process = subprocess.Popen(
                command, stderr=log, stdout=log, cwd=self._folder, env={**os.environ, **environment},
                start_new_session=True,
            )  # fmt: skip
        self._ends.callback(process.wait)
        self._ends.callback(process.kill)
        return process

    def _told(self, name: str, pattern: str) -> str:
        latest = time.monotonic() + LONGEST_S
        while time.monotonic() < latest:
            if found := re.search(pattern, (self._folder / f"{name}.log").read_text(errors="replace")):
                return found[1]
            time.sleep(0.05)
        raise AssertionError((self._folder / f"{name}.log").read_text(errors="replace"))

    def worker(self, name: str, *given: str, **environment: str) -> subprocess.Popen:
        """A worker with one thread, and no nanny that would start it again."""
        words = ("worker", self.address, "--nthreads", "1", "--no-nanny", "--no-dashboard", "--name", name)
        return self._start(name, *words, "--local-directory", str(self._folder / name), *given, **environment)

    def end_scheduler(self) -> None:
        self._scheduler.kill()


@pytest.fixture
def machines(tmp_path):
    folder = tmp_path / "machines"
    folder.mkdir()
    with ExitStack() as ends:
        found = Machines(folder, ends)
        # A run that waits in vain ends with its scheduler, and the test fails.
        patience = threading.Timer(LONGEST_S, found.end_scheduler)
        patience.start()
        ends.callback(patience.cancel)
        yield found


def results_of(cohort: Cohort) -> dict[str, bytes]:
    """Bytes of each published file, by its path."""
    return {
        path.relative_to(cohort.target).as_posix(): path.read_bytes()
        for name in cohort.participants
        for path in regular_files(cohort.target / name / "results", SubjectError)
    }


def tries_of(cohort: Cohort, participant: str) -> list[tuple[str, ...]]:
    connection = sqlite3.connect(cohort.target / "ledger.sqlite")
    asked = "SELECT try, ended FROM tries WHERE participant = ? ORDER BY rowid"
    found = connection.execute(asked, [participant]).fetchall()
    connection.close()
    return found


class Hearing(list):
    """News of a run; ``at`` calls something once, when a participant gets to a stage."""

    def __init__(self) -> None:
        self._calls = {}

    def at(self, participant, stage, call):
        self._calls[participant, stage] = call

    def __call__(self, one) -> None:
        self.append(one)
        if call := self._calls.pop((one.participant, one.stage), None):
            call()


@needs_dask
def test_a_cluster_makes_the_same_bytes_and_who_fails_fails_alone(made, machines, tmp_path):
    cohort = made(6, sub_002="refuse", sub_003="die", sub_004="die once", sub_005="hang")
    rooms, remarks, news = [], [], Hearing()
    machines.worker("one")
    machines.worker("two")
    other = "import spinestiff.subject.program as p; p.program = lambda: 'other'"
    (tmp_path / "other" / "sitecustomize.py").parent.mkdir()
    (tmp_path / "other" / "sitecustomize.py").write_text(other)
    machines.worker("other", PYTHONPATH=f"{tmp_path / 'other'}:{os.environ['PYTHONPATH']}")
    # Only once all three are known, so that each is met.
    while len(re.findall("Register worker", (tmp_path / "machines" / "scheduler.log").read_text())) < 3:
        time.sleep(0.1)
    found = run_on_cluster(
        cohort, machines.address, None, Limits(seconds=12.0), news, None, rooms.append, remarks.append
    )
    assert found.done == ("sub-001", "sub-004", "sub-006")
    assert list(found.failed) == ["sub-002", "sub-003", "sub-005"]
    assert found.failed["sub-002"] == "sub-002 can't be estimated"
    assert found.failed["sub-003"].startswith("crashed: its process ended by signal SIGKILL")
    assert found.failed["sub-005"] == "timed out: was not done after 12 s (--minutes)"
    assert [tries_of(cohort, f"sub-00{number}") for number in (1, 3, 4)] == [
        [(1, "done")], [(1, "crashed"), (2, "crashed")], [(1, "crashed"), (2, "done")],
    ]  # fmt: skip
    assert any(one.words == "track: 0" for one in news if one.participant == "sub-001")
    assert max(rooms) == 2
    assert len(remarks) == 1 and "runs spinestiff other, this is" in remarks[0]
    assert not (cohort.target / CLUSTER_FILE).exists()
    again = run_on_cluster(Cohort(cohort.source, cohort.target, found.done, cohort.order), machines.address)
    assert (again.up_to_date, again.done) == (found.done, ())
    here = Cohort(cohort.source, tmp_path / "here", found.done, cohort.order)
    run_participants(here, 2)
    assert results_of(here) == results_of(Cohort(cohort.source, cohort.target, found.done, cohort.order))


@needs_dask
@pytest.mark.skipif(os.name == "nt", reason="signals of Unix")
def test_who_loses_a_worker_is_tried_once_more(made, machines):
    cohort = made(2, sub_001="hang", sub_002="hang")
    workers = [machines.worker("one")]
    news = Hearing()

    def end_worker():
        workers[-1].kill()
        workers.append(machines.worker(f"worker{len(workers)}"))

    def mend():
        (cohort.source / "sub-001" / "subject.json").write_text('{"number": 7, "trouble": ""}', encoding="utf-8")

    for name in cohort.participants:
        news.at(name, "running", end_worker)
    news.at("sub-001", "again", mend)
    news.at("sub-002", "again", lambda: news.at("sub-002", "running", end_worker))
    found = run_on_cluster(cohort, machines.address, news=news)
    assert found.done == ("sub-001",)
    assert re.fullmatch(r"its worker tcp://127\.0\.0\.1:\d+ on \S+ ended", found.failed["sub-002"])
    assert tries_of(cohort, "sub-001") == [(1, "lost"), (2, "done")]
    assert tries_of(cohort, "sub-002") == [(1, "lost"), (2, "lost")]
    last = read_last(place_of(cohort.source, cohort.target, "sub-002").last)
    assert [one.ended for one in last.tries] == ["lost", "lost"]
    assert whole_results(place_of(cohort.source, cohort.target, "sub-001")).state == "current"


@needs_dask
@pytest.mark.skipif(os.name == "nt", reason="signals of Unix")
def test_a_worker_whose_lifetime_ends_gives_its_participant_to_the_next(made, machines):
    cohort = made(1, sub_001="hang")
    first = machines.worker("one", "--lifetime", "12s")
    news = Hearing()

    def go_on():
        (cohort.source / "sub-001" / "subject.json").write_text('{"number": 7, "trouble": ""}', encoding="utf-8")
        machines.worker("two")

    news.at("sub-001", "again", go_on)
    assert run_on_cluster(cohort, machines.address, news=news).done == ("sub-001",)
    assert tries_of(cohort, "sub-001") == [(1, "lost"), (2, "done")]
    assert first.wait(60) == 0


@needs_dask
@pytest.mark.skipif(os.name == "nt", reason="locks and signals of Unix")
@pytest.mark.parametrize("ending", [signal.SIGKILL, signal.SIGINT])
def test_what_a_run_that_was_ended_has_left_is_taken_up(made, machines, tmp_path, ending):
    cohort = made(3, {"count": str(tmp_path / "count.txt")}, sub_002="hang")
    machines.worker("one")
    given = [str(cohort.source), str(cohort.target), cohort.order.model_dump_json(), ",".join(cohort.participants)]
    command = [sys.executable, "-c", PARENT, *given, machines.address]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as parent:
        try:
            while parent.stdout.readline() != "sub-002 running track: 1\n":
                assert parent.poll() is None
            with pytest.raises(InUseError, match=rf"is at work here \(process {parent.pid} on "):
                run_on_cluster(cohort, machines.address)
            parent.send_signal(ending)
            parent.wait(60)
        finally:
            parent.kill()
    (cohort.source / "sub-002" / "subject.json").write_text('{"number": 1, "trouble": ""}', encoding="utf-8")
    # The hanging process was ended by its worker, or this one would wait for it in vain.
    found = run_on_cluster(cohort, machines.address)
    assert (found.up_to_date, found.done, found.failed) == (("sub-001",), ("sub-002", "sub-003"), {})
    assert tries_of(cohort, "sub-002") == [(1, "lost"), (1, "done")]
    assert sorted((tmp_path / "count.txt").read_text().split()) == ["sub-001", "sub-002", "sub-002", "sub-003"]


@needs_dask
def test_a_scheduler_that_goes_ends_the_run_in_one_line(made, machines):
    cohort = made(2, sub_002="hang")
    machines.worker("one")
    news = Hearing()
    news.at("sub-002", "running", machines.end_scheduler)
    words = rf"^--scheduler {machines.address}: the scheduler has gone; results that were finished are kept; give the"
    with pytest.raises(SubjectError, match=words):
        run_on_cluster(cohort, machines.address, news=news)
    assert whole_results(place_of(cohort.source, cohort.target, "sub-001")).state == "current"
    with cohort_lock(cohort.target):
        pass


@needs_dask
def test_a_worker_that_does_not_see_the_folders_gets_nobody(made, machines):
    cohort = made(1)
    (cohort.source / "participants.tsv").unlink()
    remarks = []
    machines.worker("blind")

    def stop(line):
        remarks.append(line)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_on_cluster(cohort, machines.address, remark=stop)
    words = f"does not see {cohort.source} and {cohort.target} as this machine does; it gets no participant"
    assert remarks[0].startswith("warning: worker tcp://") and remarks[0].endswith(words)
    assert not (cohort.target / "sub-001").exists()


def test_a_worker_that_is_about_to_end_gets_nobody_who_takes_longer(made):
    def gets(usual, seconds_left, lifetime, busy=0, **otherwise):
        told = Traits(
            identity="", host="", program="", sees=True, seconds_left=seconds_left, lifetime=lifetime
        )  # fmt: skip
        ends = None if seconds_left is None else time.monotonic() + seconds_left
        worker = cluster._Worker("here", 2, None, told, ends, busy=busy, **otherwise)
        return cluster._Cluster(None, "there", made_one, "run", Limits(), None, usual)._free(worker)

    made_one = made(1)
    assert gets(None, 10.0, 3600.0) and gets(60.0, 90.0, 3600.0) and gets(60.0, None, None, busy=1)
    assert not gets(60.0, 70.0, 3600.0)
    # No worker lives long enough: tries go on where the one before was cut off.
    assert gets(3000.0, 70.0, 3600.0)
    assert not gets(60.0, None, None, busy=2) and not gets(60.0, None, None, unfit="no")


@needs_dask
@pytest.mark.parametrize("address", ["here", "http://x", "nowhere://x:1"])
def test_what_is_no_address_is_asked_by_no_client(made, monkeypatch, address):
    def asked(*_, **__):
        raise AssertionError("a client was made, which would take long to end")

    monkeypatch.setattr("distributed.Client", asked)
    with pytest.raises(OptionError, match=rf"--scheduler {address}: no Dask scheduler answers there \("):
        run_on_cluster(made(1), address)


def test_a_scheduler_that_does_not_answer_and_a_missing_extra_are_told_in_one_line(made, monkeypatch):
    cohort = made(1)
    if find_spec("distributed") is not None:
        monkeypatch.setattr(cluster, "CONNECT_S", 1.0)
        for address in ("tcp://127.0.0.1:9", "nowhere://x", "here"):
            with pytest.raises(
                OptionError, match=rf"^--scheduler {address}: no Dask scheduler answers there \(.*host:8786$"
            ):
                run_on_cluster(cohort, address)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(OptionError, match=r"^--scheduler: needs the extra: pip install 'spinestiff\[cluster\]'$"):
        run_on_cluster(cohort, "tcp://127.0.0.1:9")
    assert not cohort.target.exists()
