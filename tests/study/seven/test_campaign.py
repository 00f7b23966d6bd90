"""Many subjects, a process each."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from spinestiff.parallel import threads
from spinestiff.study.seven.campaign import AGAIN, ENDED, run_study
from spinestiff.study.seven.participants import seven
from spinestiff.study.seven.subject import failure_file, result_file, stored_failure
from spinestiff.study.visit import Settings
from spinestiff.subject.program import program_of_numbers
from study_outcomes import outcome
from study_runners import made, one_killed, unforeseen, without_memory

SETTINGS = Settings(mesh="coarse")
FIRST = seven()[:3]


def run(folder, workers, study=made):
    lines = []
    found = run_study(folder, FIRST, SETTINGS, lambda name, line: lines.append((name, line)), workers, study)
    return found, lines


def test_subjects_that_fail_leave_the_others_alone(tmp_path):
    found, lines = run(tmp_path, 1)
    assert set(found.outcomes) == {"subject-1", "subject-3"}
    assert found.failures == {"subject-2": "no equilibrium"}
    assert ("subject-2", "failed: no equilibrium") in lines
    assert {("subject-1", "making"), ("subject-1", "done"), ("subject-3", "done")} <= set(lines)


def test_why_a_subject_failed_is_kept_until_it_no_longer_does(tmp_path):
    run(tmp_path, 1)
    assert [stored_failure(tmp_path, one, SETTINGS) for one in FIRST] == [None, "no equilibrium", None]
    failure_file(tmp_path, FIRST[0]).write_text("{")
    assert stored_failure(tmp_path, FIRST[0], SETTINGS) is None
    assert stored_failure(tmp_path, FIRST[1], Settings(mesh="fine")) is None
    run_study(tmp_path, FIRST[1:2], SETTINGS, lambda name, line: None, 1, lambda *asked: outcome(2))
    assert stored_failure(tmp_path, FIRST[1], SETTINGS) is None and not failure_file(tmp_path, FIRST[1]).exists()


def test_a_reason_that_can_not_be_written_is_no_failure_of_the_others(tmp_path):
    failure_file(tmp_path, FIRST[1]).mkdir()
    found, _ = run(tmp_path, 1)
    assert set(found.outcomes) == {"subject-1", "subject-3"} and set(found.failures) == {"subject-2"}


def test_errors_that_were_not_foreseen_are_failures_of_their_subjects_alone(tmp_path):
    found, _ = run(tmp_path, 1, unforeseen)
    assert set(found.outcomes) == {"subject-3"}
    assert found.failures == {
        "subject-1": "MemoryError: no room for an array",
        "subject-2": "OSError: [Errno 28] No space left on device",
    }


def test_so_it_is_with_a_process_each_on_one_thread_and_the_environment_stays_as_it_was(tmp_path, monkeypatch):
    monkeypatch.setenv("SPINESTIFF_THREADS", "3")
    found, lines = run(tmp_path, 2, without_memory)
    assert found.failures == {"subject-1": "MemoryError: no room for an array", "subject-2": "no equilibrium"}
    assert [name for name, line in lines if line == "making"].count("subject-2") == 1
    assert {("subject-2", "failed: no equilibrium"), ("subject-3", "making"), ("subject-3", "done")} <= set(lines)
    assert {name: one.age for name, one in found.outcomes.items()} == {"subject-3": 1.0}
    assert threads() == 3
    again, _ = run(tmp_path / "new", 1)
    assert again.outcomes["subject-1"].age == 3.0


def test_what_is_there_is_not_made_again(tmp_path):
    run(tmp_path, 1)
    found, lines = run(tmp_path, 1)
    assert ("subject-1", "making") not in lines
    assert ("subject-2", "making") in lines
    assert found.outcomes["subject-1"].name == "subject-1"


def test_what_was_made_otherwise_is_made_again(tmp_path):
    run(tmp_path, 1)
    path = result_file(tmp_path, FIRST[0])
    path.write_text(path.read_text().replace(program_of_numbers(), "0.0.1+another"))
    result_file(tmp_path, FIRST[2]).write_text("{")
    _, lines = run(tmp_path, 1)
    assert ("subject-1", "making") in lines and ("subject-3", "making") in lines
    other = Settings(mesh="fine")
    lines = []
    run_study(tmp_path, FIRST[:1], other, lambda name, line: lines.append((name, line)), 1, made)
    assert ("subject-1", "making") in lines


def test_what_other_sources_of_the_same_version_made_is_made_again(tmp_path, monkeypatch):
    run(tmp_path, 1)
    version = program_of_numbers().partition("+")[0]
    for module in ("spinestiff.study.seven.subject", "study_runners"):
        monkeypatch.setattr(f"{module}.program_of_numbers", lambda: f"{version}+another")
    found, lines = run(tmp_path, 1)
    assert ("subject-1", "making") in lines and ("subject-3", "making") in lines
    assert found.outcomes["subject-1"].program == f"{version}+another"


def test_a_process_that_ends_by_itself_is_tried_once_more_and_takes_no_other_with_it(tmp_path):
    found, lines = run(tmp_path, 3, one_killed)
    assert set(found.outcomes) == {"subject-2", "subject-3"}
    assert found.failures == {"subject-1": ENDED}
    assert [line for line in lines if line[1] == AGAIN].count(("subject-1", AGAIN)) == 1
    assert ("subject-2", AGAIN) in lines and ("subject-3", AGAIN) not in lines


@pytest.mark.skipif(os.name == "nt", reason="signals")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_processes_end_with_the_one_that_started_them(tmp_path, number):
    script = tmp_path / "script.py"
    script.write_text(
        """
import sys, time
from pathlib import Path
from spinestiff.study.seven.campaign import run_study
from spinestiff.study.seven.participants import seven
from spinestiff.study.visit import Settings

def asleep(folder, one, settings, say):
    (folder / one.name).touch()
    time.sleep(100)

if __name__ == "__main__":
    run_study(Path(sys.argv[1]), seven()[:2], Settings(), print, 2, asleep)
"""
    )
    # Whoever holds its output open is still there.
    parent = subprocess.Popen(
        [sys.executable, str(script), str(tmp_path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    try:
        latest = time.monotonic() + 60
        while not all((tmp_path / one.name).exists() for one in FIRST[:2]) and time.monotonic() < latest:
            time.sleep(0.05)
        assert all((tmp_path / one.name).exists() for one in FIRST[:2])
        parent.send_signal(number)
        parent.communicate(timeout=120)
    finally:
        parent.kill()
