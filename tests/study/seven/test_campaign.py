"""Many subjects, a process each."""

from __future__ import annotations

import os

import pytest

from spinestiff import __version__
from spinestiff.errors import EquilibriumError
from spinestiff.files import write_json
from spinestiff.parallel import threads
from spinestiff.study.seven.campaign import ENDED, run_study
from spinestiff.study.seven.participants import seven
from spinestiff.study.seven.subject import result_file, settings_digest
from spinestiff.study.visit import Settings
from study_outcomes import outcome

SETTINGS = Settings(mesh="coarse")
FIRST = seven()[:3]


def made(folder, participant, settings, say):
    """Stands for a whole chain: the second subject can't be made, and the number of threads is told as its age."""
    say("making")
    if participant.name == "subject-2":
        raise EquilibriumError("no equilibrium")
    found = outcome(int(participant.name[-1]), age=float(threads()))
    found = found.model_copy(update={"version": __version__, "settings": settings_digest(participant, settings)})
    write_json(result_file(folder, participant), found.model_dump(mode="json"))
    return found


def killed(folder, participant, settings, say):
    os._exit(9)


def run(folder, workers, study=made):
    lines = []
    found = run_study(folder, FIRST, SETTINGS, lambda name, line: lines.append((name, line)), workers, study)
    return found, lines


@pytest.mark.parametrize("workers", [1, 2])
def test_a_subject_that_fails_leaves_the_others_alone(tmp_path, workers):
    found, lines = run(tmp_path, workers)
    assert set(found.outcomes) == {"subject-1", "subject-3"}
    assert found.failures == {"subject-2": "no equilibrium"}
    assert ("subject-2", "failed: no equilibrium") in lines
    assert {("subject-1", "making"), ("subject-1", "done"), ("subject-3", "done")} <= set(lines)


def test_processes_have_one_thread_each_and_leave_the_environment_as_it_was(tmp_path, monkeypatch):
    monkeypatch.setenv("SPINESTIFF_THREADS", "3")
    found, _ = run(tmp_path, 2)
    assert found.outcomes["subject-1"].age == 1.0
    assert threads() == 3
    again, _ = run(tmp_path / "new", 1)
    assert again.outcomes["subject-1"].age == 3.0


def test_what_is_there_is_not_made_again(tmp_path):
    run(tmp_path, 1)
    found, lines = run(tmp_path, 1, killed if False else made)
    assert ("subject-1", "making") not in lines
    assert ("subject-2", "making") in lines
    assert found.outcomes["subject-1"].name == "subject-1"


def test_what_was_made_otherwise_is_made_again(tmp_path):
    run(tmp_path, 1)
    path = result_file(tmp_path, FIRST[0])
    path.write_text(path.read_text().replace(__version__, "0.0.1"))
    result_file(tmp_path, FIRST[2]).write_text("{")
    _, lines = run(tmp_path, 1)
    assert ("subject-1", "making") in lines and ("subject-3", "making") in lines
    other = Settings(mesh="fine")
    lines = []
    run_study(tmp_path, FIRST[:1], other, lambda name, line: lines.append((name, line)), 1, made)
    assert ("subject-1", "making") in lines


def test_a_process_that_ends_by_itself_is_told(tmp_path):
    found, _ = run(tmp_path, 2, killed)
    assert found.outcomes == {}
    assert set(found.failures.values()) == {ENDED}
