"""``spinestiff plan``: what it prints and writes, and what it refuses."""

from __future__ import annotations

import errno
import json
from dataclasses import replace
from inspect import signature
from pathlib import Path
from typing import get_type_hints

import cv2
import pytest

from spinestiff.app.commands import asking
from spinestiff.app.options import push_limits
from spinestiff.app.plan import exposures_of, plan_record, single_pushes, wish_of
from spinestiff.errors import OptionError, SubjectError
from spinestiff.files import read_json, write_json
from spinestiff.study.planning.scene import scene_of
from spinestiff.study.planning.wish import EXPOSURES, MOST_EXPOSURES, RIBS, SIDES, VIEWS, Frame, Wish
from spinestiff.study.report.clinician import next_lines
from spinestiff.study.runner import ALL_STEPS
from spinestiff.study.visit import open_visit
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.folder import read_subject
from spinestiff.subject.plan_outcome import Plan, PlannedPush, PlanStep
from spinestiff.subject.run_record import changed_inputs, is_unchanged, read_outcome, recorded_steps

ALL = ("bending", 80.0, 8, "both", None, None, 500.0)


def wished(**changes):
    names = ("target", "limit_n", "exposures", "side", "ribs", "under", "largest")
    return wish_of(**{**dict(zip(names, ALL)), **changes})


@pytest.fixture
def at_one_place(monkeypatch):
    """Plans as made at one place where the ratios may lie, not at all of them."""

    def scene(visit):
        found = scene_of(visit)
        return replace(found, places=found.places[:1])

    monkeypatch.setattr("spinestiff.app.plan.scene_of", scene)


@pytest.mark.usefixtures("at_one_place", "no_report")
def test_the_list_is_single_pushes_best_first_and_files_are_written(spinestiff, subject):
    ran = spinestiff("plan", subject, "--json-all", "--limit", 30, "--ribs", "6,8", "--side", "left", "--exposures", 4)
    assert ran.status == 0 and "plan: " in ran.err
    whole = json.loads(ran.out)
    found = whole["next"]
    assert {tuple(push) for push in found} == {("side", "level", "force_n", "view", "radiographs", "expected_factor")}
    assert all(push["side"] == "left" for push in found)
    results = subject / "results"
    kept = read_json(results / "plan.json")["next"]
    assert [{name: push[name] for name in found[0]} for push in kept] == found
    assert {(push["level"], push["force_n"], push["view"], push["radiographs"]) for push in kept} == {
        (rib, force, view, count)
        for rib in (6.0, 8.0)
        for force in (15.0, 30.0)
        for view, count in (("frontal", 2), ("frontal+lateral", 4))
    }
    assert found[0]["force_n"] == 30.0
    assert {push["level"] for push in found} == {6.0, 8.0}
    factors = [push["expected_factor"] for push in found]
    assert factors == sorted(factors) != factors[::-1]
    assert factors[0] > 1.0
    assert is_unchanged(read_subject(subject), "plan")
    assert "results/plan.json" in ALL_STEPS["report"].inputs(open_visit(subject))
    assert cv2.imread(str(results / "plan.png")).shape[1] > 1000
    sheet = (results / "protocol.html").read_text(encoding="utf-8")
    assert sheet.count("<td>left</td>") == len(whole["frames"])
    assert whole["now_factor"] == read_json(results / "plan.json")["now"]["lateral_bending"]
    assert "No push above 30 N." in sheet
    # An unloaded radiograph, the best push, and the other force of it.
    best = found[0]
    assert sheet.count(f'<td>left</td><td class="number">{best["level"]:g}</td>') in (2, 3)
    # Three radiographs allow no lateral ones.
    ran = spinestiff("plan", subject, "--json", "--limit", 30, "--ribs", "6,8", "--side", "left", "--exposures", 3)
    assert json.loads(ran.out) == [push for push in found if push["view"] == "frontal"]
    alone = f"{best['level']:g}"
    ran = spinestiff("plan", subject, "--limit", 30, "--ribs", alone, "--side", "left", "--exposures", 3)
    assert ran.status == 0
    assert f"best next: rib {alone} left, 30 N, frontal, expected within a factor of" in ran.out
    assert "with a lateral radiograph beside each: within a factor of" in ran.out
    assert f"sheet to print: {results / 'protocol.html'}" in ran.out
    assert "116 ± 25 N" in ran.out
    # Each plan has a log of its own.
    logs = sorted((results / "logs").glob("*-plan.jsonl"))
    assert len(logs) == len(list((results / "logs").iterdir())) == 3
    first, *between, last = [json.loads(line) for line in logs[-1].read_text(encoding="utf-8").splitlines()]
    settings = first["settings"]
    assert (first["command"], settings["limit_n"], settings["ribs"]) == ("plan", 30.0, [best["level"]])
    events = [(line["event"], line["step"]) for line in between if "event" in line]
    assert events == [("begin", "plan"), ("end", "plan"), ("begin", "report"), ("end", "report")]
    assert any(line["text"] == "plan: comparing" for line in between)
    assert (last["event"], last["outcome"]) == ("end", "done")


PUSH = PlannedPush(side="left", level=8.0, force_n=30.0, radiographs=2, expected_factor=1.4, factors={})
PLAN = Plan(
    target="bending", limit_n=30.0, basis="estimate", taken=3, now={"lateral_bending": 2.1}, now_deg=None, estimated={},
    next=(PUSH,), sequence=(PlanStep(push=PUSH, exposures=2, pays=True),), taped=None,
)  # fmt: skip


def test_the_json_has_the_sequence_its_frames_and_what_is_expected_of_them():
    aside = PUSH.model_copy(update={"force_n": 15.0, "view": "frontal+lateral", "expected_factor": 1.3})
    last = PUSH.model_copy(update={"side": "right", "expected_factor": 1.29})
    steps = [PlanStep(push=push, exposures=count, pays=pays) for push, count, pays in
             ((PUSH, 2, True), (aside, 5, True), (last, 7, False))]  # fmt: skip
    found = plan_record(PLAN.model_copy(update={"sequence": tuple(steps)}))
    assert (found["target"], found["basis"], found["limit_n"]) == ("bending", "estimate", 30.0)
    assert (found["now_factor"], found["expected_factor"]) == (2.1, 1.3)
    assert [(one["side"], one["force_n"], one["exposures"], one["pays"], one["expected_factor"])
            for one in found["sequence"]] == [
        ("left", 30.0, 2, True, 1.4), ("left", 15.0, 5, True, 1.3), ("right", 30.0, 7, False, 1.29)
    ]  # fmt: skip
    assert [(one["side"], one["level"], one["force_n"], one["view"]) for one in found["frames"]] == [
        ("left", 8.0, 0.0, "frontal"), ("left", 8.0, 0.0, "lateral"), ("left", 8.0, 15.0, "frontal"),
        ("left", 8.0, 15.0, "lateral"), ("left", 8.0, 30.0, "frontal"),
    ]  # fmt: skip
    assert (
        single_pushes(PLAN)
        == found["next"]
        == [
            {"side": "left", "level": 8.0, "force_n": 30.0, "view": "frontal", "radiographs": 2, "expected_factor": 1.4}
        ]
    )
    wide = PUSH.model_copy(update={"view": "frontal+lateral", "radiographs": 4, "fits": False})
    assert single_pushes(PLAN.model_copy(update={"next": (wide, PUSH)})) == found["next"]
    nothing = plan_record(PLAN.model_copy(update={"sequence": (steps[2],)}))
    assert nothing["expected_factor"] is None and nothing["frames"] == []
    angle = PUSH.model_copy(update={"expected_factor": None, "expected_deg": 2.5})
    changes = {"target": "cobb", "now_deg": 4.0, "now": {}, "next": (angle,),
               "sequence": (PlanStep(push=angle, exposures=2, pays=True),)}  # fmt: skip
    found = plan_record(PLAN.model_copy(update=changes))
    assert (found["now_deg"], found["expected_deg"], found["next"][0]["expected_deg"]) == (4.0, 2.5, 2.5)
    assert not {"now_factor", "expected_factor"} & {*found, *found["next"][0], *found["sequence"][0]}


def test_a_report_that_is_there_shows_the_new_plan(spinestiff, subject, monkeypatch):
    shown = []

    def report(visit, *_):
        shown.append(next_lines(visit, read_outcome(visit.subject, Estimate)))
        for name in ("report.html", "view.html"):
            visit.file(name).write_text(str(len(shown)), encoding="utf-8")

    def fails(*_):
        raise SubjectError("the disk is full")

    monkeypatch.setattr("spinestiff.study.report.page.write_report", report)
    monkeypatch.setattr("spinestiff.app.plan.scene_of", lambda visit: None)
    monkeypatch.setattr("spinestiff.app.plan.make_plan", lambda *_: PLAN)
    assert spinestiff("plan", subject).status == 0
    assert len(shown) == 1 and shown[0][0].startswith("push rib 8 from the left with 30 N")
    assert is_unchanged(read_subject(subject), "report")
    # A plan is no less one for that.
    monkeypatch.setattr("spinestiff.app.plan.make_plan", lambda *_: PLAN.model_copy(update={"taken": 4}))
    monkeypatch.setattr("spinestiff.study.report.page.write_report", fails)
    ran = spinestiff("plan", subject)
    assert ran.status == 0 and "plan: the report does not show this plan yet: the disk is full" in ran.err
    assert is_unchanged(read_subject(subject), "plan")

    # Stopped before its sheet is written, a plan is none.
    def stops(*_):
        raise SubjectError("stopped")

    with monkeypatch.context() as only_here:
        only_here.setattr("spinestiff.app.plan.write_text", stops)
        only_here.setattr("spinestiff.app.plan.make_plan", lambda *_: PLAN.model_copy(update={"taken": 5}))
        assert spinestiff("plan", subject).status == 2
    assert not is_unchanged(read_subject(subject), "plan")
    assert spinestiff("plan", subject).status == 0 and is_unchanged(read_subject(subject), "plan")
    (subject / "results" / "protocol.html").write_text("of another push", encoding="utf-8")
    assert not is_unchanged(read_subject(subject), "plan")
    # Before any report there is none to be made anew.
    (subject / "results" / "run.json").unlink()
    monkeypatch.setattr("spinestiff.app.plan.run_steps", lambda *_: None)
    monkeypatch.setattr("spinestiff.app.plan._write", lambda *_: None)
    assert "report" not in spinestiff("plan", subject).err


def test_a_plan_is_of_the_estimate_and_pushes_that_it_was_made_from(spinestiff, subject, no_report, monkeypatch):
    asked = []
    monkeypatch.setattr("spinestiff.app.plan.make_plan", lambda scene, wish, say: asked.append(wish) or PLAN)
    assert spinestiff("plan", subject, "--limit", 30, "--ribs", 8, "--side", "left", "--views", "frontal").status == 0
    assert asked == [Wish(limit_n=30.0, ribs=(8.0,), sides=("left",), views=("frontal",))]
    path = subject / "subject.json"
    content = read_json(path)
    content["pushes"][0]["level"] += 1.0
    write_json(path, content)
    assert changed_inputs(read_subject(subject), "plan") == ("subject.json: pushes",)
    assert "results/plan.json" not in ALL_STEPS["report"].inputs(open_visit(subject))
    recorded = recorded_steps(read_subject(subject))["plan"]
    assert {"results/estimate.json", "results/posterior.csv", "results/torso.npz"} <= set(recorded.inputs)


def test_options_become_a_wish():
    wish = wished()
    assert (wish.sides, wish.ribs, wish.predicted, wish.views) == (SIDES, RIBS, None, VIEWS)
    assert wished(views="frontal+lateral").views == ("frontal+lateral",)
    wish = wished(target="cobb", side="right", ribs="5, 9.5,5", under="left,8,60")
    assert (wish.sides, wish.ribs, wish.predicted) == (("right",), (5.0, 9.5), Frame("left", 8.0, 60.0))


def test_what_the_command_line_writes_out_are_the_defaults_of_a_wish():
    usual = {name: one.default for name, one in signature(asking.plan).parameters.items()}
    doses = (usual[f"{of}dose"] for of in ("", "frame_", "lateral_"))
    exposures, lateral_cost = exposures_of(usual["exposures"], *doses)
    one_word = (usual[name] for name in ("side", "ribs", "under"))
    wish = wish_of(
        usual["target"], usual["limit"], exposures, *one_word, push_limits()[1], usual["views"], lateral_cost
    )
    assert wish == Wish()
    told = {name: hint.__metadata__[0] for name, hint in get_type_hints(asking.plan, include_extras=True).items()
            if name in ("exposures", "ribs")}  # fmt: skip
    assert told["exposures"].max == MOST_EXPOSURES and f"default {EXPOSURES}." in told["exposures"].help
    assert f"default {RIBS[0]:g} to {RIBS[-1]:g}." in told["ribs"].help


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"target": "torsion"}, "--target torsion: wanted one of bending, tissue, rotation, cobb"),
        ({"views": "oblique"}, "--views oblique: wanted frontal, frontal+lateral or both"),
        ({"side": "front"}, "--side front: wanted left, right or both"),
        ({"ribs": "5,x"}, "--ribs 5,x: wanted ribs from 1 to 12"),
        ({"ribs": "13"}, "--ribs 13: wanted ribs from 1 to 12"),
        ({"ribs": "1_0"}, "--ribs 1_0: wanted ribs from 1 to 12"),
        ({"ribs": "nan"}, "--ribs nan: wanted ribs from 1 to 12"),
        ({"under": "left,8"}, "--under left,8: wanted SIDE,RIB,FORCE"),
        ({"under": "left,8,900"}, "--under left,8,900: wanted SIDE,RIB,FORCE"),
        ({"under": "up,8,60"}, "--under up,8,60: wanted SIDE,RIB,FORCE"),
        ({"under": "left,8,6_0"}, "--under left,8,6_0: wanted SIDE,RIB,FORCE"),
    ],
)
def test_options_that_say_nothing_are_refused(changes, message):
    with pytest.raises(OptionError) as error:
        wished(**changes)
    assert str(error.value).startswith(message)


def test_a_dose_is_a_number_of_radiographs():
    assert exposures_of(None, None, None, None) == (8.0, 1.0)
    assert exposures_of(5, None, None, None) == (5.0, 1.0)
    assert exposures_of(None, 100.0, 25.0, None) == (4.0, 1.0)
    assert exposures_of(None, 0.3, 0.1, 0.25) == pytest.approx((3.0, 2.5))
    assert exposures_of(None, 1e9, 1.0, 3.0) == (40.0, 3.0)
    assert exposures_of(None, 0.2, 0.1, None)[0] == 2.0
    with pytest.raises(OptionError, match="--exposures 5: --dose stands in its place"):
        exposures_of(5, 100.0, 25.0, None)
    for dose, each, lateral, message in (
        (100.0, None, None, "--dose and --frame-dose belong together"),
        (None, 1.0, None, "--dose and --frame-dose belong together"),
        (None, None, 2.0, "--lateral-dose to both"),
        (30.0, 20.0, None, "--dose 30: allows 1 of 20; a push takes 2 radiographs"),
    ):
        with pytest.raises(OptionError, match=message):
            exposures_of(None, dose, each, lateral)


def test_a_dose_counts_lateral_radiographs_as_they_are(spinestiff, subject):
    """Two frontal ones at 2 and two lateral ones at 5 come to 14."""
    options = ("--limit", 30, "--ribs", 8, "--side", "left", "--dose", 11, "--frame-dose", 2, "--lateral-dose", 5)
    ran = spinestiff("plan", subject, *options, "--views", "frontal+lateral")
    assert ran.status == 2
    assert ran.lines == ["spinestiff: exposures for 5.5 frontal radiographs; a push seen as frontal+lateral takes 7"]


def test_results_that_can_not_be_written_are_told_before_anything_is_done(spinestiff, subject, monkeypatch):
    def refuse(self, *args, **kwargs):
        raise OSError(errno.EROFS, "x", str(self))

    monkeypatch.setattr(Path, "touch", refuse)
    monkeypatch.setattr("spinestiff.app.plan.scene_of", lambda visit: pytest.fail("planned"))
    ran = spinestiff("plan", subject)
    assert ran.status == 2
    assert "results: can't be written (the file system is read-only), but results go there" in ran.lines[-1]


def test_a_force_that_no_gauge_reads_is_refused_before_anything_is_done(spinestiff, tmp_path):
    ran = spinestiff("plan", tmp_path / "nowhere", "--limit", 501)
    assert ran.status == 2
    assert ran.lines == ["spinestiff: --limit 501: wanted 5 to 500 N"]
