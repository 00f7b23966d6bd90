"""Participants side by side: each ends alone, and a run that is killed is taken up where it was."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from spinestiff.cohort.account import Account
from spinestiff.cohort.asked import Cohort, Limits, silent
from spinestiff.cohort.group import read_members
from spinestiff.cohort.ledger import read_last
from spinestiff.cohort.lock import cohort_lock
from spinestiff.cohort.marker import whole_results
from spinestiff.cohort.places import place_of
from spinestiff.cohort.processes import worker_environment
from spinestiff.cohort.supervisor import run_one, run_participants
from spinestiff.errors import InUseError, OptionError, SubjectError
from spinestiff.files import file_digest
from spinestiff.subject.lock import sole_run

PARENT = """
import sys
from pathlib import Path
from spinestiff.cohort.marker import Order
from spinestiff.cohort.asked import Cohort
from spinestiff.cohort.supervisor import run_participants
order = Order.model_validate_json(sys.argv[3])
names = tuple(sys.argv[4].split(","))
cohort = Cohort(Path(sys.argv[1]), Path(sys.argv[2]), names, order)
run_participants(cohort, 2, news=lambda one: print(one.stage, flush=True))
"""


def last_of(cohort, participant):
    return read_last(place_of(cohort.source, cohort.target, participant).last)


def counted(path):
    return path.read_text(encoding="utf-8").split()


def test_who_fails_fails_alone_and_is_named_after_one_retry(made):
    trouble = {"sub_003": "die", "sub_004": "die once", "sub_005": "bug", "sub_006": "half", "sub_007": "wrong"}
    cohort = made(7, sub_002="refuse", **trouble)
    news = []
    found = run_participants(cohort, 2, news=news.append)
    assert found.done == ("sub-001", "sub-004", "sub-006")
    assert list(found.failed) == ["sub-002", "sub-003", "sub-005", "sub-007"]
    assert found.failed["sub-002"] == "sub-002 can't be estimated"
    assert found.failed["sub-003"].startswith("crashed: its process ended by signal SIGKILL")
    assert found.failed["sub-005"] == "crashed: ValueError: no such thing"
    assert found.failed["sub-007"] == f"{cohort.source}/sub-007/subject.json: wrong"
    tries = {name: len(last_of(cohort, name).tries) for name in cohort.participants}
    assert tries == {"sub-001": 1, "sub-002": 1, "sub-003": 2, "sub-004": 2, "sub-005": 2, "sub-006": 2, "sub-007": 1}
    log = place_of(cohort.source, cohort.target, "sub-005").log.read_text(encoding="utf-8")
    assert "ValueError: no such thing" in log
    assert {one.participant for one in news if one.stage == "again"} == {"sub-003", "sub-004", "sub-005", "sub-006"}
    assert any(one.words == "track: 0" for one in news if one.participant == "sub-001")
    for name in found.done:
        assert whole_results(place_of(cohort.source, cohort.target, name)).state == "current"
    connection = sqlite3.connect(cohort.target / "ledger.sqlite")
    rows = connection.execute("SELECT participant, try, ended FROM tries ORDER BY participant, try").fetchall()
    ended = [
        "done",
        "refused",
        "crashed",
        "crashed",
        "crashed",
        "done",
        "crashed",
        "crashed",
        "crashed",
        "done",
        "refused",
    ]
    assert [one[2] for one in rows] == ended
    assert connection.execute("SELECT how FROM runs").fetchall() == [("ended",)]
    connection.close()


@pytest.mark.skipif(sys.platform != "linux", reason="names that are no UTF-8")
def test_a_name_that_is_no_utf8_ends_its_own_participant_alone(made):
    cohort = made(2)
    odd = os.fsencode(cohort.source / "sub-001") + b"/M\xfcller.dcm"
    os.symlink(b"/nowhere", odd)
    found = run_participants(cohort, 1)
    assert found.done == ("sub-002",)
    assert r"M\udcfcller.dcm: a link to a file that is not there" in found.failed["sub-001"]
    assert last_of(cohort, "sub-001").tries[-1].words == found.failed["sub-001"]
    members = read_members(cohort.source, cohort.target, cohort.participants)
    assert [one.state for one in members] == ["failed", "done"]
    with pytest.raises(SubjectError, match="a name that is no UTF-8; rename the folder"):
        Cohort(cohort.source, Path(f"{cohort.target}-M\udcfcller"), cohort.participants, cohort.order)


def test_only_what_is_missing_or_changed_is_run(made, tmp_path):
    log = tmp_path / "count.txt"
    cohort = made(3, {"count": str(log)})
    assert run_participants(cohort, 2).done == cohort.participants
    before = {name: file_digest(cohort.target / name / "results") for name in cohort.participants}
    assert run_participants(cohort, 2).up_to_date == cohort.participants
    assert sorted(counted(log)) == list(cohort.participants)
    (cohort.source / "sub-002" / "subject.json").write_text('{"number": 9, "trouble": ""}', encoding="utf-8")
    (cohort.target / "sub-003" / "results" / "report.html").write_text("mine", encoding="utf-8")
    found = run_participants(cohort, 2)
    assert (found.up_to_date, found.done) == (("sub-001",), ("sub-002", "sub-003"))
    assert sorted(counted(log)) == ["sub-001", "sub-002", "sub-002", "sub-003", "sub-003"]
    after = {name: file_digest(cohort.target / name / "results") for name in cohort.participants}
    assert [before[name] == after[name] for name in cohort.participants] == [True, False, True]


def test_what_a_run_killed_after_publishing_has_left_is_taken_away(made):
    cohort = made(1)
    run_participants(cohort, 1)
    place = place_of(cohort.source, cohort.target, "sub-001")
    before = sorted(path.name for path in place.target.iterdir())
    place.work.mkdir()
    place.before.mkdir()
    place.task.write_text("{}", encoding="utf-8")
    assert run_participants(cohort, 1).up_to_date == ("sub-001",)
    assert sorted(path.name for path in place.target.iterdir()) == before


@pytest.mark.skipif(os.name == "nt", reason="locks of Unix")
def test_what_another_run_is_at_work_in_is_left_to_it(made):
    cohort = made(1)
    run_participants(cohort, 1)
    place = place_of(cohort.source, cohort.target, "sub-001")
    place.work.mkdir()
    place.task.write_text("{}", encoding="utf-8")
    half = place.target / ".work.json.0000.tmp"
    half.touch()
    with sole_run(place.target, place.lock):
        assert run_one(cohort, 1).up_to_date == ("sub-001",)
        assert place.work.exists() and place.task.exists() and half.exists()
    assert run_one(cohort, 1).up_to_date == ("sub-001",)
    assert not place.work.exists() and not place.task.exists() and not half.exists()


def test_who_hangs_and_who_takes_all_memory_is_ended(made):
    cohort = made(2, sub_001="hang", sub_002="fill")
    found = run_participants(Cohort(cohort.source, cohort.target, ("sub-001",), cohort.order), 1, Limits(seconds=1.0))
    assert found.failed == {"sub-001": "timed out: was not done after 1 s (--minutes)"}
    only = Cohort(cohort.source, cohort.target, ("sub-002",), cohort.order)
    found = run_participants(only, 1, Limits(seconds=100.0, memory_mb=300.0))
    assert found.failed == {"sub-002": "out of memory: took more than 300 MB (--memory)"}
    assert len(last_of(cohort, "sub-002").tries) == 2


@pytest.mark.skipif(sys.platform != "linux", reason="as Linux tells memory")
def test_the_memory_of_a_try_is_not_that_of_whoever_started_it(made):
    cohort = made(1)
    held = b"x" * (800 * 2**20)
    run_participants(cohort, 1)
    del held
    (tried,) = last_of(cohort, "sub-001").tries
    assert 10.0 < tried.peak_mb < 400.0


def test_why_the_first_try_failed_is_written_before_the_second(made):
    cohort = made(1, sub_001="hang")
    told = []

    def stop(one):
        if one.stage == "running" and told:
            raise KeyboardInterrupt
        if one.stage == "again":
            told.append(one.words)

    with pytest.raises(KeyboardInterrupt):
        run_one(cohort, 1, Limits(seconds=1.0), stop)
    assert [one.words for one in last_of(cohort, "sub-001").tries] == told
    assert told == ["timed out: was not done after 1 s (--minutes)"]


def test_a_full_disk_stops_the_run_and_keeps_what_was_finished(made):
    cohort = made(3, sub_002="full")
    words = r"work/results/estimate\.json: can't be written \(the disk is full\); results that were finished are kept$"
    with pytest.raises(SubjectError, match=words):
        run_participants(cohort, 1)
    states = [whole_results(place_of(cohort.source, cohort.target, name)).state for name in cohort.participants]
    assert states == ["current", "missing", "missing"]
    assert not (cohort.target / "sub-003").exists()


def test_who_can_not_be_written_fails_alone_and_is_named(made):
    cohort = made(4)
    cohort.target.mkdir()
    (cohort.target / "sub-001").write_text("no folder", encoding="utf-8")
    (cohort.target / "sub-002" / "log.txt").mkdir(parents=True)
    (cohort.target / "sub-003" / "last.json").mkdir(parents=True)
    news = []
    found = run_participants(cohort, 2, news=news.append)
    assert found.done == ("sub-003", "sub-004")
    assert list(found.failed) == ["sub-001", "sub-002"]
    assert found.failed["sub-001"].startswith(f"{cohort.target / 'sub-001' / 'log.txt'}: can't be written (")
    assert found.failed["sub-002"] == (
        f"{cohort.target / 'sub-002' / 'log.txt'}: found a folder, wanted the name of a file to write"
    )
    warned = {one.participant: one.words for one in news if one.words.startswith("warning: ")}
    there = cohort.target / "sub-003" / "last.json"
    assert warned["sub-003"] == f"warning: {there}: found a folder, wanted the name of a file to write"
    assert [one.stage for one in news if one.participant == "sub-003"][-1] == "done"
    states = [one.state for one in read_members(cohort.source, cohort.target, cohort.participants)]
    assert states == ["not run", "failed", "done", "done"]


@pytest.mark.parametrize("mode", [0o555, 0o000])
def test_a_folder_without_permission_is_one_participant_s(made, mode):
    cohort = made(3)
    run_participants(Cohort(cohort.source, cohort.target, ("sub-001",), cohort.order), 1)
    current, closed = cohort.target / "sub-001", cohort.target / "sub-002"
    (current / "work.json").write_text("{}", encoding="utf-8")
    closed.mkdir()
    (closed / ".last.json.0000.tmp").write_text("half", encoding="utf-8")
    closed.chmod(mode)
    current.chmod(0o555)
    try:
        if os.access(closed, os.W_OK):
            pytest.skip("this account may write everywhere")
        found = run_participants(cohort, 1)
        members = read_members(cohort.source, cohort.target, cohort.participants)
    finally:
        closed.chmod(0o755)
        current.chmod(0o755)
    assert (found.up_to_date, found.done) == (("sub-001",), ("sub-003",))
    assert found.failed == {"sub-002": f"{closed / 'log.txt'}: can't be written (no permission)"}
    assert [one.state for one in members] == ["done", "not run" if mode else "damaged", "done"]


def test_a_read_only_output_is_refused_in_one_line(made, tmp_path):
    cohort = made(1)
    cohort.target.write_text("no folder", encoding="utf-8")
    with pytest.raises(SubjectError, match=r"out: can't be written"):
        run_participants(cohort, 1)


@contextmanager
def parent_of(cohort):
    """A run in a process of its own, killed at the end whatever has come of it."""
    names = ",".join(cohort.participants)
    given = [str(cohort.source), str(cohort.target), cohort.order.model_dump_json(), names]
    with subprocess.Popen([sys.executable, "-c", PARENT, *given], stdout=subprocess.PIPE, text=True) as parent:
        try:
            yield parent
        finally:
            parent.kill()


@pytest.mark.skipif(os.name == "nt", reason="locks and signals of Unix")
def test_a_second_run_is_refused_and_a_dead_one_is_taken_over(made):
    cohort = made(2, sub_002="hang")
    with parent_of(cohort) as first:
        while first.stdout.readline().strip() != "done":
            pass
        with pytest.raises(InUseError, match=rf"spinestiff cohort is at work here \(process {first.pid} on "):
            run_participants(cohort, 1)
        first.kill()
    (cohort.source / "sub-002" / "subject.json").write_text('{"number": 1, "trouble": ""}', encoding="utf-8")
    # The hanging process has ended with its parent, or this one would wait for it in vain.
    found = run_participants(cohort, 2)
    assert (found.up_to_date, found.done, found.failed) == (("sub-001",), ("sub-002",), {})
    connection = sqlite3.connect(cohort.target / "ledger.sqlite")
    tries = connection.execute("SELECT ended FROM tries WHERE participant = 'sub-002' ORDER BY ended DESC").fetchall()
    assert tries == [("lost",), ("done",)]
    assert connection.execute("SELECT how FROM runs ORDER BY how DESC").fetchall() == [("lost",), ("ended",)]
    connection.close()


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="children are told by /proc alone")
def test_a_run_that_is_told_to_end_ends_its_processes(made):
    cohort = made(1, sub_001="hang")
    with parent_of(cohort) as parent:
        while parent.stdout.readline().strip() != "running":
            pass
        time.sleep(0.2)
        listed = Path(f"/proc/{parent.pid}/task/{parent.pid}/children").read_text(encoding="ascii")
        children = [int(one) for one in listed.split()]
        parent.send_signal(signal.SIGTERM)
        assert parent.wait(30) != 0
    assert children
    for child in children:
        with pytest.raises(ProcessLookupError):
            os.kill(child, 0)


def test_a_single_row_is_run_beside_others(made):
    cohort = made(3)
    with cohort_lock(cohort.target, shared=True):
        assert run_one(cohort, 2).done == ("sub-002",)
        with pytest.raises(InUseError, match="single participants by --index"):
            run_participants(cohort, 1)
    assert not (cohort.target / "ledger.sqlite").exists()
    assert last_of(cohort, "sub-002").tries[0].ended == "done"
    assert run_one(cohort, 2).up_to_date == ("sub-002",)
    for index in (0, 4):
        with pytest.raises(OptionError, match=rf"--index {index}: wanted a row of participants.tsv, 1 to 3"):
            run_one(cohort, index)
    with cohort_lock(cohort.target), pytest.raises(InUseError, match=f"process {os.getpid()} on "):
        run_one(cohort, 1)


def test_the_log_of_another_run_at_the_same_participant_is_left_alone(made):
    cohort = made(1, sub_001="bug")
    place = place_of(cohort.source, cohort.target, "sub-001")
    place.target.mkdir(parents=True)
    place.log.write_text("of the first run\n", encoding="utf-8")
    seen = []

    def waits(one):
        if one.stage == "running":
            seen.append(place.log.read_text(encoding="utf-8"))
            first.close()  # its end, for which the second one waits

    with ExitStack() as first:
        first.enter_context(sole_run(place.target, place.lock))
        found = run_one(cohort, 1, news=waits)
    assert found.failed == {"sub-001": "crashed: ValueError: no such thing"}
    assert seen[0] == "of the first run\n"
    # Then it is the log of the second one, and there of its second try.
    log = place.log.read_text(encoding="utf-8")
    assert "first run" not in log and log.count("Traceback") == 1


@pytest.mark.skipif(os.name == "nt", reason="locks of Unix")
def test_who_is_refused_at_a_participant_in_use_leaves_what_the_other_run_found(made):
    cohort = made(1, sub_001="refuse")
    run_one(cohort, 1)
    found = last_of(cohort, "sub-001")
    assert found.tries[-1].words == "sub-001 can't be estimated"
    # The second run's process, as it would be after its wait.
    refused = found.tries[-1].model_copy(update={"run": "second", "ended": "in use", "words": "another run is at work"})
    account = Account(cohort, None, silent)
    assert not account.take(refused)
    assert account.summary().failed == {"sub-001": "another run is at work"}
    assert last_of(cohort, "sub-001") == found


def test_input_and_output_lie_apart(made, tmp_path):
    cohort = made(1)
    for target in (cohort.source, cohort.source / "out", tmp_path):
        with pytest.raises(SubjectError, match="wanted two folders apart"):
            Cohort(cohort.source, target, cohort.participants, cohort.order)


def test_processes_have_a_thread_each_and_share_compiled_kernels(tmp_path, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    for name in ("SPINESTIFF_THREADS", "NUMBA_CACHE_DIR"):
        monkeypatch.delenv(name, raising=False)
    found = worker_environment(tmp_path)
    assert (found["SPINESTIFF_THREADS"], found["OMP_NUM_THREADS"]) == ("1", "3")
    assert "NUMBA_CACHE_DIR" not in found
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert worker_environment(tmp_path)["NUMBA_CACHE_DIR"] == str(tmp_path / "cohort.cache")
