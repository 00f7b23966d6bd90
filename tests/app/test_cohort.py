"""``spinestiff cohort``: what it prints, its statuses, and a real subject taken through."""

from __future__ import annotations

import json
import logging
import shutil
import sys
import threading

import pytest

from cohort_runners import QUICK, cohort_of
from spinestiff.app.cohort import Shown, _print, duration, order_of, run_cohort
from spinestiff.cohort import subject_run
from spinestiff.cohort.asked import Limits, News, Summary
from spinestiff.cohort.marker import Order, examine
from spinestiff.cohort.overview import refuse_foreign
from spinestiff.cohort.places import place_of
from spinestiff.cohort.row import read_row
from spinestiff.cohort.worker import Task, make_results
from spinestiff.errors import SubjectError
from spinestiff.study.visit import open_visit
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.program import program
from spinestiff.subject.run_record import read_outcome


def test_a_cohort_from_table_to_page(capfd, tmp_path, monkeypatch):
    from pathlib import Path

    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[1]), prepend=":")
    cohort_of(tmp_path / "in", 3, sub_002="refuse")
    order = Order(runner=QUICK, settings={}, version="1")
    assert run_cohort(tmp_path / "in", tmp_path / "out", None, order, jobs=2) == 1
    out, err = capfd.readouterr()
    assert out.splitlines()[:3] == [
        "participants: 2 run, 0 up to date, 1 failed",
        "failed: sub-002: sub-002 can't be estimated",
        "group: 2 done, 1 failed",
    ]
    assert sorted(err.splitlines())[0].startswith("sub-001: done in ")
    assert {path.name for path in (tmp_path / "out").iterdir() if path.is_file()} == {
        "cohort.csv", "cohort.json", "cohort.html", "cohort.lock", "ledger.sqlite",
    }  # fmt: skip
    assert run_cohort(tmp_path / "in", tmp_path / "out", "participant", order, index=1) == 0
    assert capfd.readouterr().out == "participants: 0 run, 1 up to date, 0 failed\n"


def test_settings_count_at_the_group_level_if_they_are_asked_for(spinestiff, capfd, tmp_path):
    source, target = tmp_path / "in", tmp_path / "out"
    cohort_of(source, 1)
    order = Order(runner=QUICK, settings={}, version="1")
    make_results(Task(participant="sub-001", source=str(source), target=str(target), order=order), lambda line: None)
    for given, words in (((), "group: 1 done"), (("--mesh", "fine"), "group: 1 out of date")):
        ran = spinestiff("cohort", str(source), str(target), "group", *given)
        assert (ran.status, ran.out.splitlines()[0]) == (0, words)
    assert run_cohort(source, target, "group", order.model_copy(update={"version": "2"})) == 0
    assert capfd.readouterr().out.splitlines()[0] == "group: 1 out of date"


def test_where_the_reasons_of_many_failures_are_is_told(capfd, tmp_path):
    _print(Summary((), (), {f"sub-{number:03d}": "no" for number in range(25)}), tmp_path)
    last = capfd.readouterr().out.splitlines()[-1]
    assert last == f"and 5 more; last.json in each one's folder in {tmp_path} says why"


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("none", "out"), "none: no such folder; wanted one with participants.tsv"),
        (("in", "out", "everybody"), "level 'everybody': wanted participant or group"),
        (("in", "out", "--index", "1"), "--index 1: runs a single participant; add the level"),
        (("in", "out", "participant", "--index", "1", "--scheduler", "tcp://x:1"), "leave out it or --index"),
        (("in", "out", "group", "--scheduler", "tcp://x:1"), "--scheduler tcp://x:1: runs participants on a cluster"),
        (("in", "out", "participant", "--index", "3"), "--index 3: wanted a row of participants.tsv, 1 to 2"),
        (("in", "in/out"), "wanted two folders apart"),
        (("in", "out", "--mesh", "huge"), "unknown mesh 'huge'"),
        (("in", "out", "--parameters", "all"), "all"),
        (("in", "out", "group"), "has no results of any participant"),
    ],
)
def test_what_is_asked_wrongly_ends_in_one_line(spinestiff, tmp_path, monkeypatch, given, words):
    monkeypatch.chdir(tmp_path)
    cohort_of(tmp_path / "in", 2)
    ran = spinestiff("cohort", *given)
    assert (ran.status, ran.out, len(ran.lines)) == (2, "", 1)
    assert words in ran.err
    assert not (tmp_path / "out").exists()


def test_a_gb_of_memory_is_1024_mb_wherever_participants_run(tmp_path, monkeypatch):
    asked = []

    def noted(cohort, first, second, *others):
        asked.append(next(one for one in (first, second, *others) if isinstance(one, Limits)))
        return Summary((), (), {})

    for name in ("run_participants", "run_one", "run_on_cluster"):
        monkeypatch.setattr(f"spinestiff.app.cohort.{name}", noted)
    cohort_of(tmp_path / "in", 1)
    order = Order(runner=QUICK, settings={}, version="1")
    for more in ({}, {"index": 1}, {"scheduler": "tcp://x:1"}):
        run_cohort(tmp_path / "in", tmp_path / "out", "participant", order, memory_gb=1.5, **more)
    assert [one.memory_mb for one in asked] == [1536.0, 1536.0, 1536.0]


def test_a_real_subject_goes_through_and_its_row_says_what_its_results_say(finished, tmp_path, monkeypatch):
    """Taken up where a run was stopped after its last step, so that nothing is computed twice."""
    order = order_of({"mesh": "coarse"})
    shutil.copytree(finished.folder, tmp_path / "in" / "girl", ignore=shutil.ignore_patterns("results"))
    place = place_of(tmp_path / "in", tmp_path / "out", "girl")
    shutil.copytree(finished.folder / "results", place.work / "results")
    place.task.write_text(order.model_dump_json(), encoding="utf-8")
    task = Task(participant="girl", source=str(tmp_path / "in"), target=str(tmp_path / "out"), order=order)
    lines = []
    assert make_results(task, lines.append) == "done"
    assert [line for line in lines if not line.endswith("up to date")] == []
    assert examine(place, order).state == "current"
    assert order.version == program()
    row = read_row(place.results / "row.json")
    visit = open_visit(finished.folder)
    estimate = read_outcome(visit.subject, Estimate)
    assert (row.participant, row.id, row.report) == ("girl", visit.subject.record.id, "report.html")
    assert row.stiffness["tissue"].value == estimate.ratios["tissue"].value
    assert row.stiffness["tissue_young"].unit == "kPa"
    assert row.stiffness["tissue"].sd_log == pytest.approx(estimate.ratios["tissue"].sd_log)
    assert row.held_out.frames == 2
    assert row.curve == "main thoracic" and 10.0 < abs(row.cobb_deg) < 16.0
    assert row.largest_force_n == 30.0
    assert row.population is None
    held = {Estimate: estimate.model_copy(update={"population": "koutras2025"})}
    monkeypatch.setattr(subject_run, "read_outcome", lambda *of: held.get(of[1]) or read_outcome(*of))
    assert subject_run.row_of(visit, "girl").population == "koutras2025"


def test_the_run_of_a_participant_is_logged_beside_its_results_and_names_nobody(subject, tmp_path, monkeypatch):
    place = place_of(tmp_path / "in", tmp_path / "out", "Doe_Jane")
    place.target.mkdir(parents=True)
    subject.rename(place.work)
    # One quick step again, and none of the others.
    monkeypatch.setattr(subject_run, "STEPS", ("response",))
    (place.work / "results" / "response.json").unlink()
    lines = []

    def say(line):
        lines.append(line)
        logging.getLogger("spinestiff.study").info("said of Doe_Jane: %s", line)

    for _ in range(2):
        subject_run.run_subject(place.work, "Doe_Jane", {"mesh": "coarse"}, say)
    assert lines[-1] == "response: up to date"
    assert not (place.work / "results" / "logs").exists()
    (log,) = place.logs.glob("*-cohort.jsonl")
    first, *between, last = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]
    assert (first["command"], first["settings"]["mesh"], last["outcome"]) == ("cohort", "coarse", "done")
    assert ("begin", "response") in {(line.get("event"), line.get("step")) for line in between}
    assert any(line["text"].startswith("said of …: response: ") for line in between)
    assert "Doe" not in log.read_text(encoding="utf-8")


def test_settings_that_there_are_not_are_refused_before_anything_runs():
    with pytest.raises(SubjectError, match="unknown method"):
        order_of({"method": "best"})


def test_a_subject_folder_is_no_place_for_a_cohort(spinestiff, tmp_path):
    cohort_of(tmp_path / "in", 1)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "subject.json").write_text("{}", encoding="utf-8")
    ran = spinestiff("cohort", str(tmp_path / "in"), str(tmp_path / "out"))
    assert ran.status == 2
    assert "out: is a subject folder; a cohort has a folder for each participant, name another one" in ran.err
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["subject.json"]


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("cohort.csv", "participant,state\nA,Ohio\n", "does not begin as cohort writes it"),
        ("cohort.csv", "", "does not begin as cohort writes it"),
        ("cohort.json", '{"name": "girls", "participants": []}', "does not begin as cohort writes it"),
        ("cohort.html", "<html><body>ours</body></html>", "does not begin as cohort writes it"),
        ("cohort.png", "a picture", "cohort would replace it; move it away"),
    ],
)
def test_nobody_elses_table_is_replaced(spinestiff, tmp_path, name, content, words):
    cohort_of(tmp_path / "in", 1)
    (tmp_path / "out").mkdir()
    own = tmp_path / "out" / name
    own.write_text(content, encoding="utf-8")
    for level in ((), ("participant",), ("group",)):
        ran = spinestiff("cohort", str(tmp_path / "in"), str(tmp_path / "out"), *level)
        assert (ran.status, ran.out, len(ran.lines)) == (2, "", 1)
        assert f"{name}: {words}" in ran.err
    assert own.read_text(encoding="utf-8") == content
    assert [path.name for path in (tmp_path / "out").iterdir()] == [name]


def test_own_tables_are_replaced_as_a_spreadsheet_or_another_program_has_stored_them(tmp_path):
    (tmp_path / "cohort.csv").write_text('\ufeff"participant";"state";"words";"id"\r\n', encoding="utf-8")
    (tmp_path / "cohort.json").write_text('{"participants":[],\r\n"schema_version":1}', encoding="utf-8")
    (tmp_path / "cohort.html").write_text('<meta name="generator" content="spinestiff 0.0.1">', encoding="utf-8")
    (tmp_path / "cohort.png").write_bytes(b"")
    refuse_foreign(tmp_path)
    (tmp_path / "cohort.html").unlink()  # a run that was killed between picture and page
    refuse_foreign(tmp_path)
    refuse_foreign(tmp_path / "nowhere")


def test_news_may_come_while_the_table_is_drawn():
    shown, drawn, failed = Shown(20_000, 2, lambda line: None), threading.Event(), []
    shown.expect(60.0)

    def draw():
        try:
            while not drawn.is_set():
                shown.headline(), shown.rows()
        except (RuntimeError, KeyError) as error:
            failed.append(error)

    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    thread = threading.Thread(target=draw)
    try:
        thread.start()
        for number in range(20_000):
            shown.news(News(f"s{number}", "running" if number % 100 == 0 else "waiting"))
    finally:
        drawn.set()
        thread.join()
        sys.setswitchinterval(before)
    assert failed == []


def test_the_time_left_is_that_of_who_is_left():
    shown = Shown(4, 2, lambda line: None)
    for number in range(4):
        shown.news(News(f"s{number}", "waiting"))
    assert shown.seconds_left() is None
    shown.expect(60.0)
    assert shown.seconds_left() == pytest.approx(120.0)
    shown.news(News("s0", "running"))
    shown.news(News("s0", "done", "", 10.0))
    assert shown.seconds_left() == pytest.approx(15.0)
    shown.news(News("s1", "failed", "no", 1.0))
    assert shown.headline().startswith("1 done, 1 failed, 2 waiting, 0 s passed, about 10 s left")
    shown.room(0)
    assert shown.headline() == "1 done, 1 failed, 2 waiting for workers, 0 s passed"
    shown.room(1)
    assert shown.seconds_left() == pytest.approx(20.0)
    assert [row[:3] for row in shown.rows()] == [("s0", "done", ""), ("s1", "failed", "no")]
    assert [duration(one) for one in (45.2, 720.0, 12000.0)] == ["45 s", "12 min", "3 h 20 min"]
