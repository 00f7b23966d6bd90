"""The first page: intervals in words, what to distrust, what next; the same Cobb angle as everywhere."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from results import altered, register
from spinestiff.study.report.clinician import (
    LONGEST,
    MOST_DOUBTS,
    clinician_content,
    doubts,
    in_words,
    next_lines,
    other_ends,
    push_row,
    shortened,
    stiffness,
)
from spinestiff.study.report.estimate_content import bending_line
from spinestiff.study.visit import Visit, open_visit
from spinestiff.study.wording.estimate import told_stiffness
from spinestiff.study.wording.numbers import factor95
from spinestiff.subject.assessment_outcome import Assessment
from spinestiff.subject.estimate_outcome import Check, Estimate, PlainStiffness
from spinestiff.subject.outcome_parts import Determination, Quantity
from spinestiff.subject.outcomes import AngleResponse, Flexibility, ForcePerDegree, PushResponse, Responses
from spinestiff.subject.plan_outcome import Plan, PlannedPush, PlanStep
from spinestiff.subject.records import PushRecord
from spinestiff.subject.run_record import read_outcome, record_step, step_record, write_outcome

OPEN = "The radiographs do not fix lateral bending of a thoracic level; "
NO_END = "the radiographs give no"


def quantity(value: float, low: float | None, high: float | None, opens: str = "") -> Quantity:
    return Quantity(value=value, low=low, high=high, open_low="low" in opens, open_high="high" in opens)


@pytest.mark.parametrize(
    ("found", "determined", "words"),
    [
        (quantity(20.0, 17.0, 24.0), "determined", "20 N m/rad, between 17 and 24 N m/rad."),
        (quantity(20.0, 5.3, 32.0), "weakly determined", "Between 5.3 and 32 N m/rad; most probably 20."),
        (quantity(20.0, 2.0, 60.0), "not determined", OPEN + "between 2.0 and 60 N m/rad."),
        (quantity(1.0, 0.4, 5.1, "low"), "weakly determined", f"At most 5.1 N m/rad; {NO_END} lower end."),
        (quantity(1.0, 0.4, 5.1, "high"), "weakly determined", f"At least 0.40 N m/rad; {NO_END} upper end."),
        (
            quantity(20.0, 0.4, 700.0, "low high"), "not determined",
            OPEN + "anything that was allowed fits them, between 0.40 and 700 N m/rad.",
        ),
        (quantity(20.0, None, None), "not determined", "20 N m/rad, without an interval."),
    ],
)  # fmt: skip
def test_intervals_in_words(found: Quantity, determined: Determination, words: str) -> None:
    assert in_words("lateral bending of a thoracic level", found, "N m/rad", determined) == words


def test_a_badge_says_how_far_it_is_known_and_never_how_the_search_ended(finished) -> None:
    estimate = read_outcome(open_visit(finished.folder).subject, Estimate)
    told = {one[0]: one for one in told_stiffness(estimate)}
    name, found, unit, _ = told["lateral_bending_thoracic"]
    for known, good in (("determined", True), ("weakly determined", False), ("not determined", False)):
        shown = stiffness(estimate, name, found, unit, known)
        assert (shown["badge"], shown["good"]) == (known, good)
        doubted = stiffness(failing(estimate), name, found, unit, known)
        assert (doubted["badge"], doubted["good"]) == ("doubtful", False)
        assert doubted["dot"] == (known != "not determined")
        assert "known within" not in doubted["meaning"]
    # The strip's middle is the same place as the ratio's between the fit's bounds; cadaver segments lie above it.
    strip = stiffness(estimate, name, found, unit, "determined")["strip"]
    assert 0.0 <= strip["start"] <= strip["value"] <= strip["end"] <= 100.0
    assert strip["band"][0] < strip["band"][1] and strip["band_text"] == "74 to 103"
    assert "CONVERGED" not in json.dumps(stiffness(estimate, name, found, unit, "determined"))


def failing(estimate: Estimate) -> Estimate:
    """The same with a check that failed."""
    wrong = Check(name="same patient", value=None, limit=None, passed=False, text="two patients")
    return estimate.model_copy(update={"status": "DOUBTFUL", "checks": (wrong,)})


def content_of(visit: Visit) -> dict[str, Any]:
    subject = visit.subject
    return clinician_content(
        visit, read_outcome(subject, Estimate), read_outcome(subject, Assessment), read_outcome(subject, Responses)
    )


def test_a_push_has_its_change_with_levels_and_its_uses(finished) -> None:
    visit = open_visit(finished.folder)
    responses = read_outcome(visit.subject, Responses)
    row = push_row(visit.subject.push("main"), responses)
    curve = responses.pushes["main"].curve
    assert row["what"] == "rib 8 from the left"
    assert row["use"] == "15 and 22.5 N for the estimate; 30 N kept as a test"
    assert row["change"].startswith("30 N: −") and row["change"].endswith(f"({'–'.join(curve.levels)})")
    assert f"± {1.96 * curve.change_sd_deg:.1f}°" in row["change"]
    other = PushRecord(
        id="new", side="right", level=6.0, d21_mm=400.0, d31_mm=200.0, frames="n.dcm", forces_n=(0.0, 30.0),
        roles=("unused", "unused"),
    )  # fmt: skip
    assert push_row(other, responses)["missing"] == "not measured" and push_row(other, responses)["use"] == "not used"


def test_pictures_of_other_end_vertebrae_than_the_table_say_so() -> None:
    per_degree = ForcePerDegree(value=5.0, low=4.0, high=7.0)
    curve = AngleResponse(
        levels=("T6", "T11"), frames=(0, 1), rest_deg=30.0, change_deg=-6.0, change_sd_deg=0.5,
        n_per_degree=per_degree, scatter=None,
    )  # fmt: skip
    seen = PushResponse(
        force_n=30.0, tilt=curve, curve=curve, flexibility=Flexibility(percent=20.0, low=15.0, high=25.0)
    )
    pushes = {"main": seen, "dark": PushResponse(force_n=30.0, missing="no usable frame without force")}
    responses = Responses(gauge_scale_sd=0.02, gauge_zero_sd_n=1.5, pushes=pushes)
    assert other_ends(responses, "main", ("T6", "T11")) == other_ends(responses, "dark", ("T5", "T11")) == ""
    assert other_ends(responses, "main", ("T5", "T11")) == (
        " The pictures keep these end vertebrae; the table keeps those of the radiograph at rest, T6–T11."
    )
    others = {"main": seen.model_copy(update={"instead_of": ("T5", "T11")})}
    assert other_ends(responses.model_copy(update={"pushes": others}), "main", ("T5", "T11")).endswith(
        "the table keeps T6–T11."
    )


def test_what_to_distrust_comes_gravest_first(finished, subject: Path) -> None:
    altered_visit = open_visit(subject)

    def vague(content: dict[str, Any]) -> None:
        content["fit_status"], content["fit_status_text"] = "AT_BOUND", "a ratio lies at its bound"
        content["ratios"]["tissue"]["determined"] = "weakly determined"
        content["ratios"]["lateral_bending"]["determined"] = "determined"
        content["notes"] = ["first note", "second note"]

    altered(subject, Estimate, vague)
    found = doubts(
        read_outcome(altered_visit.subject, Estimate),
        read_outcome(altered_visit.subject, Assessment).model_copy(update={"frames": ()}),
        ("angle may be noise",),
    )
    assert found[0] == "a ratio lies at its bound"
    assert found[1] == "take as a range, not as a number: “Young's modulus of the trunk's soft tissue”"
    assert found[2] == "Cobb angle at rest: angle may be noise"
    assert found[3] == "no radiograph was kept as a test: the prediction is untested"
    assert found.index("first note") > 3 and found.index("second note") > found.index("first note")


def beside_cadavers(value: float, low: float | None, high: float | None, opens: str = "") -> dict[str, Any]:
    found = PlainStiffness(
        value=value, low=low, high=high, open_low="low" in opens, open_high="high" in opens, unit="N m/rad",
        ratio="lateral_bending",
    )  # fmt: skip
    ratios = {"lateral_bending": SimpleNamespace(determined=found.determination)}
    line = bending_line(SimpleNamespace(plain={"lateral_bending_thoracic": found}, ratios=ratios))
    assert line is not None
    return line


@pytest.mark.parametrize(
    ("ends", "reaches", "words"),
    [
        ((None, None), False, "The estimate is about 4.4 times softer than the middle of this range."),
        ((15.0, 30.0), False, "The estimate is about 4.4 times softer than the middle of this range."),
        ((15.0, 76.0), False, "Its 95 % interval reaches this range, so that the two are not to be told apart."),
    ],
)
def test_an_interval_that_is_not_there_reaches_no_cadaver_segments(ends, reaches, words) -> None:
    line = beside_cadavers(20.0, *ends)
    assert (line["reaches"], line["sentence"]) == (reaches, words)


def test_a_determined_value_says_that_its_interval_reaches_cadaver_segments() -> None:
    line = beside_cadavers(60.0, 45.0, 80.0)
    assert line["value"] == "60" and line["reaches"]
    assert line["sentence"].endswith("softer than the middle of this range, but its 95 % interval reaches the range.")
    assert beside_cadavers(90.0, 70.0, 110.0)["sentence"] == "The estimate lies within this range."


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ((20.0, 6.8, 32.0), ("6.8 to 32", "0.12 to 0.56", "at least 2.8 times softer than")),
        ((20.0, 6.8, 90.0), ("6.8 to 90", "0.12 to 1.6", "")),
        ((0.25, 0.25, 0.5, "low"), ("≤ 0.25 to 0.50", "≤ 0.0044 to 0.0087", "at least 180 times softer than")),
        ((500.0, 250.0, 500.0, "high"), ("250 to ≥ 500", "4.4 to ≥ 8.7", "at least 2.8 times stiffer than")),
        ((20.0, 2.0, 200.0, "low high"), ("≤ 2 to ≥ 200", "≤ 0.035 to ≥ 3.5", "")),
    ],
)
def test_what_is_not_determined_is_beside_cadaver_segments_with_its_range_alone(given, told) -> None:
    line = beside_cadavers(*given)
    assert (line["value"], line["per_degree"], line["beside"]) == told and not line["reaches"]
    assert ("By its whole 95 % interval" in line["sentence"]) == bool(line["beside"])


def test_long_lists_and_long_items_are_cut_and_say_so() -> None:
    items = [f"item {i}" for i in range(MOST_DOUBTS + 2)]
    shown = shortened(items, MOST_DOUBTS)
    assert len(shown) == MOST_DOUBTS and shown[0] == "Item 0."
    assert shown[-1] == "3 more points in the engineer’s part."
    assert shortened(items[:MOST_DOUBTS], MOST_DOUBTS)[-1] == f"Item {MOST_DOUBTS - 1}."
    (cut,) = shortened(["word " * 200], 3)
    assert len(cut) < LONGEST + 45 and cut.endswith("word … (whole in the engineer’s part).")
    # After a sentence, or a part of one, that fits.
    first = "the pelvis turned by more than the paper allows"
    for mark in (";", "."):
        (cut,) = shortened([f"{first}{mark} " + "word " * 200], 3)
        assert cut == f"{first[0].upper()}{first[1:]} … (whole in the engineer’s part)."
    (cut,) = shortened(["a; " + "word " * 200], 3)
    assert cut.endswith("word … (whole in the engineer’s part).")


def plan_in(visit: Visit, pays: bool) -> None:
    near = PlannedPush(
        side="left", level=6.0, force_n=60.0, view="frontal", radiographs=2, expected_factor=1.4,
        factors={"lateral_bending": 1.4, "tissue": 1.5},
    )  # fmt: skip
    far = near.model_copy(update={"level": 8.0, "expected_factor": 1.39})
    plan = Plan(
        target="bending", limit_n=60.0, basis="estimate", taken=3, now={"lateral_bending": 2.1, "tissue": 1.9},
        now_deg=None, estimated={}, next=(near, far), taped=None,
        sequence=(PlanStep(push=near, exposures=2, pays=pays), PlanStep(push=far, exposures=4, pays=False)),
    )  # fmt: skip
    write_outcome(visit.subject, plan)
    made_from = step_record(visit.subject, [f"results/{Estimate.FILE}"], {})
    record_step(visit.subject, Plan.STEP, made_from, [visit.file(Plan.FILE)])


def test_what_next_is_the_plan_s_proposal_where_there_is_one(subject: Path) -> None:
    visit = open_visit(subject)
    estimate = read_outcome(visit.subject, Estimate)
    assert next_lines(visit, estimate)[0].startswith("no further push was planned: “spinestiff plan” proposes")
    plan_in(visit, pays=True)
    lines = next_lines(visit, estimate)
    assert lines[0].startswith("push rib 6 from the left with 60 N, frontal, and once without force: ")
    assert lines[0].endswith("lateral bending would be known within a factor of 1.40 instead of a factor of 2.10")
    assert len(lines[0]) <= LONGEST
    assert lines[1] == "further radiographs hardly narrow it after 2 exposures"
    plan_in(visit, pays=False)
    assert next_lines(visit, estimate)[0].startswith("no further radiograph pays")
    path = visit.file(Estimate.FILE)
    path.write_text(path.read_text(encoding="utf-8") + " ", encoding="utf-8")
    register(visit.subject, "estimate", Estimate.FILE)
    assert next_lines(visit, estimate)[0].startswith(
        "the plan that is there is out of date and not shown: results/plan.json was made before"
    )


def test_what_is_worth_measuring_is_told_where_it_helps(finished) -> None:
    visit = open_visit(finished.folder)
    estimate = read_outcome(visit.subject, Estimate)
    name = "tissue"
    row = next(row for row in estimate.budget if row.name == "trunk size")
    vague = {key: one.model_copy(update={"determined": "weakly determined"}) for key, one in estimate.ratios.items()}
    helps = row.model_copy(update={"without": {**row.without, name: 0.5 * estimate.sd_log[name]}})
    others = tuple(one for one in estimate.budget if one.name not in ("trunk size",))
    still = tuple(one.model_copy(update={"without": estimate.sd_log}) for one in others)
    asked = estimate.model_copy(update={"ratios": vague, "budget": (helps, *still)})
    (told,) = [line for line in next_lines(visit, asked) if "tape" in line or "breadth" in line]
    assert told.startswith(
        "measure the trunk’s breadth and depth: soft tissue of the trunk would be known within a factor of"
    )
    # As if it were then known exactly, which no measurement makes it.
    assert told.endswith(f" at best, in place of {factor95(asked.sd_log['tissue'])}")
    nothing = asked.model_copy(update={"budget": still})
    assert not [line for line in next_lines(visit, nothing) if "would be known" in line]


def test_a_doubtful_result_says_so_before_its_numbers(subject: Path) -> None:
    def doubtful(content: dict[str, Any]) -> None:
        content["status"] = "DOUBTFUL"
        content["checks"] = [
            {"name": f"check {i}", "value": 8.0, "limit": 1.0, "passed": False, "text": "look for an error"}
            for i in range(4)
        ]

    altered(subject, Estimate, doubtful)
    found = content_of(open_visit(subject))
    assert found["failed"] == ["Check 0: look for an error.", "3 more points in the engineer’s part."]
    assert found["next"][0] == "Look for the mistakes named above first, and run again."
