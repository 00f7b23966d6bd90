"""Tables of all participants."""

from __future__ import annotations

import csv
import io
import json
import sqlite3
from types import SimpleNamespace

import pytest

from cohort_runners import row
from spinestiff.cohort import subject_run
from spinestiff.cohort.group import Member, csv_text, read_members, strangers, table
from spinestiff.cohort.ledger import Try, write_last
from spinestiff.cohort.overview import write_overview
from spinestiff.cohort.places import digests_of, place_of
from spinestiff.cohort.row import Stiffness
from spinestiff.cohort.supervisor import run_one, run_participants
from spinestiff.cohort.worker import Task, make_results
from spinestiff.errors import InUseError, SubjectError
from spinestiff.files import file_digest
from spinestiff.study.wording.titles import TIMES_DEFAULT, TIMES_WHOLE
from spinestiff.subject.assessment_outcome import Assessment
from spinestiff.subject.estimate_outcome import Estimate, RatioEstimate, TrainingError


def made_results(cohort, *names, order=None):
    for name in names:
        one = Task(participant=name, source=str(cohort.source), target=str(cohort.target), order=order or cohort.order)
        make_results(one, lambda line: None)


def states(cohort, order=None):
    return [member.state for member in read_members(cohort.source, cohort.target, cohort.participants, order)]


def test_every_participant_has_its_state_and_the_reason(made):
    cohort = made(6, sub_002="refuse")
    made_results(cohort, "sub-001", "sub-003", "sub-004", "sub-006")
    run_one(cohort, 2)
    (cohort.source / "sub-003" / "subject.json").write_text('{"number": 9, "trouble": ""}', encoding="utf-8")
    (cohort.target / "sub-004" / "results" / "report.html").write_text("mine", encoding="utf-8")
    (cohort.source / "sub-006" / "subject.json").write_text('{"number": 9, "trouble": "refuse"}', encoding="utf-8")
    run_one(cohort, 6)
    members = read_members(cohort.source, cohort.target, cohort.participants)
    assert [one.state for one in members] == ["done", "failed", "out of date", "damaged", "not run", "failed"]
    assert members[1].words == "sub-002 can't be estimated"
    assert members[2].words == "was made before its inputs changed"
    assert members[3].words.endswith("sub-004/results/report.html is not as its run left it")
    assert members[5].words == "sub-006 can't be estimated; earlier results are shown"
    assert [one.row is not None for one in members] == [True, False, True, False, False, True]
    assert members[0].report == "sub-001/results/report.html"


def test_results_by_other_settings_than_most_do_not_count(made):
    cohort = made(4)
    other = cohort.order.model_copy(update={"version": "0"})
    made_results(cohort, "sub-001", order=other)
    made_results(cohort, "sub-002", "sub-003", "sub-004")
    assert states(cohort) == ["out of date", "done", "done", "done"]


def test_who_fails_with_new_settings_is_failed_and_only_the_new_ones_count(made):
    cohort = made(3)
    old = cohort.order.model_copy(update={"settings": {**cohort.order.settings, "say": {"mesh": "coarse"}}})
    made_results(cohort, *cohort.participants, order=old)
    for name in ("sub-001", "sub-002"):
        failed = Try(run="1", participant=name, number=1, started="", seconds=1.0, ended="crashed", words="no", host="")
        write_last(place_of(cohort.source, cohort.target, name).last, [failed])
    made_results(cohort, "sub-003")
    assert states(cohort, cohort.order) == ["failed", "failed", "done"]
    assert states(cohort) == ["failed", "failed", "done"]
    assert states(cohort, old) == ["done", "done", "out of date"]
    assert read_members(cohort.source, cohort.target, ("sub-001",))[0].state == "done"
    members = read_members(cohort.source, cohort.target, cohort.participants, cohort.order)
    assert members[0].words == "no; earlier results are shown"
    write_overview(cohort.source, cohort.target, cohort.participants, order=cohort.order)
    content = json.loads((cohort.target / "cohort.json").read_text(encoding="utf-8"))
    assert content["settings"] == cohort.order.settings


def test_a_row_that_cannot_be_read_is_out_of_date_and_stops_nobody(made):
    cohort = made(2)
    made_results(cohort, *cohort.participants)
    results = cohort.target / "sub-001" / "results"
    content = json.loads((results / "row.json").read_text(encoding="utf-8"))
    (results / "row.json").write_text(json.dumps({**content, "age": "ten"}), encoding="utf-8")
    marker = json.loads((results / "done.json").read_text(encoding="utf-8"))
    marker["outputs"]["row.json"] = digests_of({"row.json": results / "row.json"})["row.json"]
    (results / "done.json").write_text(json.dumps(marker), encoding="utf-8")
    first, second = read_members(cohort.source, cohort.target, cohort.participants, cohort.order)
    assert (first.state, first.row, second.state) == ("out of date", None, "done")
    assert first.words.startswith(f"{results / 'row.json'}: age: ")
    assert first.words.endswith(f"; take {results} away and run spinestiff cohort again")
    # Made by another version, it is made again by a further run; and a run that failed since says why.
    later = cohort.order.model_copy(update={"version": "9.9"})
    assert read_members(cohort.source, cohort.target, cohort.participants, later)[0].words.startswith("made with other")
    name, why = "sub-001", "tracking failed: no corners"
    failed = Try(run="1", participant=name, number=1, started="", seconds=1.0, ended="failed", words=why, host="")
    write_last(place_of(cohort.source, cohort.target, name).last, [failed])
    first = read_members(cohort.source, cohort.target, cohort.participants, later)[0]
    assert (first.state, first.words, first.row) == ("failed", why, None)


def test_the_table_holds_numbers_as_they_are_and_no_formula():
    stiffness = {
        "tissue": Stiffness(value=0.1, unit=TIMES_DEFAULT, low=0.05, high=0.2, sd_log=0.3),
        "tissue_young": Stiffness(value=3.0, unit="kPa", low=1.0, high=9.0, open_low=True, open_high=True),
        "lateral_bending_lumbar": Stiffness(value=1 / 3, unit="N m/rad"),
    }
    members = [
        Member("a", "done", "", row("a", 1).model_copy(update={"stiffness": stiffness})),
        Member("b", "failed", "=1+2, or so"),
    ]
    first, second = list(csv.DictReader(io.StringIO(csv_text(members))))
    assert [first[name] for name in ("participant", "state", "tissue", "tissue_sd_log")] == ["a", "done", "0.1", "0.3"]
    assert first["tissue_young_kPa_open"] == "low+high"
    assert first["lateral_bending_lumbar_Nm_per_rad"] == repr(1 / 3)
    assert first["lateral_bending_lumbar_Nm_per_rad_low"] == ""
    assert (second["words"], second["age"], second["tissue"]) == ("'=1+2, or so", "", "")
    part = Stiffness(value=1.2, unit=TIMES_WHOLE)
    members.append(Member("c", "done", "", row("c", 2).model_copy(update={"stiffness": {"tissue": part}})))
    *others, third = csv.DictReader(io.StringIO(csv_text(members)))
    assert (third["tissue"], third["tissue_of_whole"]) == ("", "1.2")
    assert [one["tissue_of_whole"] for one in others] == ["", ""]
    header, rows = table(members)
    assert len(set(header)) == len(header)
    assert {len(cells) for cells in rows} == {len(header)}


def test_the_same_results_give_the_same_bytes(made):
    cohort = made(7, sub_007="refuse")
    run_participants(cohort, 2)
    names = ("cohort.csv", "cohort.json", "cohort.html", "cohort.png")
    found = []
    for _ in range(2):
        lines = write_overview(cohort.source, cohort.target, cohort.participants)
        found.append([file_digest(cohort.target / name) for name in names])
    assert found[0] == found[1]
    assert lines[0] == "group: 6 done, 1 failed"
    content = json.loads((cohort.target / "cohort.json").read_text(encoding="utf-8"))
    assert [one["state"] for one in content["participants"]] == ["done"] * 6 + ["failed"]
    assert content["statistics"][0]["people"] == 6


def test_tries_of_single_rows_reach_the_ledger(made):
    cohort = made(1)
    run_one(cohort, 1)
    for _ in range(2):
        write_overview(cohort.source, cohort.target, cohort.participants)
    connection = sqlite3.connect(cohort.target / "ledger.sqlite")
    assert connection.execute("SELECT participant, ended FROM tries").fetchall() == [("sub-001", "done")]
    connection.close()


def test_nobody_is_no_group_and_strangers_are_named(made):
    cohort = made(2)
    with pytest.raises(SubjectError, match="has no results of any participant"):
        write_overview(cohort.source, cohort.target, cohort.participants)
    made_results(cohort, "sub-001", "sub-002")
    assert strangers(cohort.target, ["sub-002"]) == ("sub-001",)
    lines = write_overview(cohort.source, cohort.target, ("sub-002",))
    assert "left out, since participants.tsv does not name them: sub-001" in lines
    with pytest.raises(InUseError), _held(cohort):
        write_overview(cohort.source, cohort.target, cohort.participants)


def _held(cohort):
    from spinestiff.cohort.lock import cohort_lock

    return cohort_lock(cohort.target)


def test_a_row_of_the_paper_s_estimate_is_determined_to_no_degree(monkeypatch):
    ratio = RatioEstimate.of(0.05, (float("nan"),) * 2, (False, False), False)
    given = {"status": "CONVERGED", "determined": "not determined", "ratios": {"tissue": ratio}, "plain": {}}
    estimate = Estimate.model_construct(
        **given, method="paper", checks=(), training_rmse_mm=TrainingError(default=1.0, fit=0.5)
    )
    found = {Estimate: estimate, Assessment: Assessment(frames=())}
    monkeypatch.setattr(subject_run, "read_outcome", lambda subject, kind: found[kind])
    monkeypatch.setattr(subject_run, "rest_reading", lambda subject: SimpleNamespace(largest=None))
    push = SimpleNamespace(forces_n=(0.0, 40.0), roles=("training", "training"))
    record = SimpleNamespace(id="a", age=12.0, sex="female", height_cm=150.0, mass_kg=None, pushes=(push,))
    row = subject_run.row_of(SimpleNamespace(subject=SimpleNamespace(record=record)), "sub-01")
    assert (row.determined, row.stiffness["tissue"].sd_log) == ("no intervals", None)


def test_a_row_says_what_a_ratio_is_relative_to(monkeypatch):
    ratio = RatioEstimate.of(1.2, (0.8, 1.8), (False, False), False)
    found: dict = {Assessment: Assessment(frames=())}
    monkeypatch.setattr(subject_run, "read_outcome", lambda subject, kind: found[kind])
    monkeypatch.setattr(subject_run, "rest_reading", lambda subject: SimpleNamespace(largest=None))
    push = SimpleNamespace(forces_n=(0.0, 40.0), roles=("training", "training"))
    record = SimpleNamespace(id="a", age=12.0, sex="female", height_cm=150.0, mass_kg=None, pushes=(push,))
    units = {}
    for names in (("tissue@thorax",), ("tissue", "tissue@thorax")):
        found[Estimate] = Estimate.model_construct(
            status="CONVERGED", determined="determined", ratios=dict.fromkeys(names, ratio), plain={}, method="weighed",
            checks=(), visit_sd_log={}, training_rmse_mm=TrainingError(default=1.0, fit=0.5), p_value=None,
        )  # fmt: skip
        row = subject_run.row_of(SimpleNamespace(subject=SimpleNamespace(record=record)), "sub-01")
        units[names] = {name: one.unit for name, one in row.stiffness.items()}
    assert units == {
        ("tissue@thorax",): {"tissue@thorax": TIMES_DEFAULT},
        ("tissue", "tissue@thorax"): {"tissue": TIMES_DEFAULT, "tissue@thorax": TIMES_WHOLE},
    }


def test_a_row_of_a_ratio_that_nothing_shows_knows_no_scatter_from_visit_to_visit():
    """As of joints that a torso does not have: 0 to first order, which is no scatter."""
    ratio = RatioEstimate.of(1.0, (0.0025, 5.0), (True, True), False)
    estimate = Estimate.model_construct(ratios={"rib_vertebra": ratio}, visit_sd_log={"rib_vertebra": 0.0})
    assert subject_run._stiffness(ratio, TIMES_DEFAULT, estimate, "rib_vertebra").visit_sd_log is None
