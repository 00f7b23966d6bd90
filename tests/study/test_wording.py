"""Numbers as people read them, on examples made by hand."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest

from spinestiff.estimation.causes import Cause
from spinestiff.study.wording.estimate import (
    badge,
    best_known_text,
    combination_lines,
    costly_unknowns,
    factor_lines,
    headline,
    least_known,
    most_costly,
    moved_sd,
    pelvis_lines,
    strongest_priors,
)
from spinestiff.study.wording.numbers import (
    MISSING,
    estimated,
    factor95,
    fixed,
    interval,
    listed,
    number,
    short_span,
    span_in_words,
)
from spinestiff.study.wording.steps import changed, geometry_lines, response_lines, tracking_lines
from spinestiff.study.wording.titles import PLAIN, UNKNOWNS, stiffness_title, unknown_title, within_a_sentence
from spinestiff.subject.estimate_outcome import (
    BudgetRecord,
    CombinationRecord,
    Estimate,
    PlainStiffness,
    PriorChangeRecord,
    RatioEstimate,
    SupportPlaceRecord,
)
from spinestiff.subject.folder import read_subject
from spinestiff.subject.geometry_outcome import GeometryRecord
from spinestiff.subject.outcome_parts import Quantity
from spinestiff.subject.outcomes import (
    AngleResponse,
    Flexibility,
    ForcePerDegree,
    PushResponse,
    Responses,
    Tracked,
    TrackedFrame,
    TrackedPush,
)
from spinestiff.subject.run_record import read_outcome


def quantity(value, low, high, opens=(False, False)):
    return Quantity(value=value, low=low, high=high, open_low=opens[0], open_high=opens[1])


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.2, "0.200"), (0.04567, "0.0457"), (1234.5, "1230"), (-3.0, "−3.00"), (0.0, "0"), (None, MISSING),
        (math.inf, MISSING), (math.nan, MISSING),
    ],
)  # fmt: skip
def test_number(value, text):
    assert number(value) == text


@pytest.mark.parametrize(
    ("value", "text"), [(9.96, "10"), (0.0996, "0.10"), (0.0994, "0.099"), (99.7, "100"), (-0.996, "−1.0")]
)
def test_a_number_that_is_rounded_up_to_a_power_of_ten_has_no_digit_more(value, text):
    assert number(value, 2) == text


@pytest.mark.parametrize(
    ("found", "short", "words"),
    [
        (quantity(3.8, 3.0, 4.8), "3.8", "3.8 kPa, between 3.0 and 4.8 kPa (95 %)"),
        (quantity(3.8, 1.0, 8.0), "1.0 to 8.0", "between 1.0 and 8.0 kPa (95 %), most probably 3.8"),
        (quantity(20.0, 0.3, 98.0), "0.30 to 98", "not fixed by the radiographs: between 0.30 and 98 kPa (95 %)"),
        (quantity(3.8, 0.3, 5.1, (True, False)), "≤ 0.3 to 5.1", "at most 5.1 kPa (95 %), no lower end"),
        (quantity(3.8, 2.0, 50.0, (False, True)), "2.0 to ≥ 50", "at least 2.0 kPa (95 %), no upper end"),
        (
            quantity(3.8, 0.3, 50.0, (True, True)), "≤ 0.3 to ≥ 50",
            "not fixed by the radiographs: anything that the fit allows, 0.3 to 50 kPa",
        ),
        (quantity(3.8, None, None), "3.8", "3.8 kPa, no intervals"),
        (quantity(1.124, 1.096, 1.148), "1.12", "1.12 kPa, between 1.10 and 1.15 kPa (95 %)"),
    ],
)  # fmt: skip
def test_a_span_in_words(found, short, words):
    assert short_span(found) == short and span_in_words(found, "kPa") == words


def told(parameters, determined="determined", **plain):
    """Lines of the headline; ``plain``: quantity and the ratio that scales it."""
    nothing = quantity(1.0, None, None), None
    rows = {
        name: PlainStiffness(**found.model_dump(), unit="kPa", ratio=ratio)
        for name, (found, ratio) in ((name, plain.get(name, nothing)) for name in PLAIN)
    }
    of_one = {**quantity(3.8, 3.0, 4.8).model_dump(), "at_bound": False, "determined": determined}
    ratios = {name: RatioEstimate(**of_one) for name in parameters}
    return headline(SimpleNamespace(plain=rows, parameters=parameters, ratios=ratios))


def test_the_headline_is_in_plain_units_as_far_as_there_are_some():
    closed = quantity(3.8, 3.0, 4.8)
    line = "Young's modulus of the trunk's soft tissue: 3.8 kPa, between 3.0 and 4.8 kPa (95 %)"
    assert told(("tissue",), tissue_young=(closed, "tissue")) == [line]
    times = "times the default stiffness"
    rotation = f"axial rotation of the spine: 3.8 {times}, between 3.0 and 4.8 {times} (95 %)"
    assert told(("tissue", "axial_rotation"), tissue_young=(closed, "tissue")) == [line, rotation]
    # Several ratios that scale one stiffness are not told one by one.
    assert told(("tissue@thorax", "tissue@abdomen"), tissue_young=(closed, None)) == [line]
    # A ratio of a part is told itself where the rest of the stiffness stays at its default, which then has no interval.
    part = rotation.replace("axial rotation of the spine", "lateral bending of the spine, lumbar")
    assert told(("lateral_bending@lumbar", "tissue"), tissue_young=(closed, "tissue")) == [line, part]
    # A ratio of a part beside its whole's is relative to that one.
    beside = ("tissue", "axial_rotation", "axial_rotation@lumbar")
    lumbar = rotation.replace("spine:", "spine, lumbar:").replace(times, "times the ratio of the whole")
    assert told(beside, tissue_young=(closed, "tissue")) == [line, rotation, lumbar]
    assert "not fixed by the radiographs" in told(("tissue",), "not determined", tissue_young=(closed, "tissue"))[0]


@pytest.mark.parametrize(
    ("name", "title", "inside"),
    [
        ("lateral_bending_lumbar", "Lateral bending of a lumbar level", "lateral bending of a lumbar level"),
        ("tissue_young", "Young's modulus of the trunk's soft tissue", "Young's modulus of the trunk's soft tissue"),
        ("lateral_bending@T8-T9", "Lateral bending of the spine, T8-T9", "lateral bending of the spine, T8-T9"),
        ("rib_rotation", "Turning of the ribs on their vertebrae", "turning of the ribs on their vertebrae"),
    ],
)
def test_a_stiffness_has_one_name(name, title, inside):
    assert stiffness_title(name) == title and within_a_sentence(title) == inside


def test_data_that_do_not_determine_a_ratio_are_not_told_by_its_interval():
    found = quantity(3.8, 3.0, 4.8)
    assert short_span(found, "not determined") == "3.0 to 4.8"
    assert span_in_words(found, "kPa", "not determined").startswith("not fixed by the radiographs: ")


@pytest.mark.parametrize(("value", "text"), [(0.05, "0.050"), (0.234, "0.23"), (5.0, "5.0"), (71.4, "71")])
def test_number_of_two_digits(value, text):
    assert number(value, 2) == text


@pytest.mark.parametrize(
    ("value", "text"), [(3.04, "+3.0"), (-0.04, "0.0"), (-1.26, "−1.3"), (np.inf, MISSING), (np.nan, MISSING)]
)
def test_fixed(value, text):
    assert fixed(value, 1, sign=True) == text


@pytest.mark.parametrize(
    ("of", "text"),
    [
        (quantity(0.12, 0.0612, 0.338), "0.061 to 0.34"),
        (quantity(0.12, 0.005, 0.338, (True, False)), "≤ 0.005 to 0.34"),
        (quantity(0.12, 0.0612, 5.0, (False, True)), "0.061 to ≥ 5"),
        (quantity(0.12, 0.005, 5.0, (True, True)), "≤ 0.005 to ≥ 5"),
        (quantity(0.12, None, 0.338), f"{MISSING} to 0.34"),
        (quantity(0.12, 0.0612, None), f"0.061 to {MISSING}"),
        (quantity(0.12, None, None), MISSING),
        (quantity(30.0, 26.64, 35.61), "27 to 36"),
        # As the value, where two digits would make one number of both ends.
        (quantity(1.124, 1.096, 1.148), "1.10 to 1.15"),
    ],
)
def test_interval(of, text):
    assert interval(of) == text


@pytest.mark.parametrize(
    ("of", "text"),
    [
        # A standard deviation of 2 %, of 25 %, and none known.
        (quantity(0.12345, 0.12345 * math.exp(-0.04), 0.12345 * math.exp(0.04)), "0.123"),
        (quantity(0.12345, 0.12345 * math.exp(-0.5), 0.12345 * math.exp(0.5)), "0.12"),
        (quantity(0.12345, 0.12, 0.126, (True, False)), "0.12"),
        (quantity(0.12345, None, 0.13), "0.12"),
        (quantity(0.12345, None, None), "0.12"),
        (quantity(0.005, 0.005, 0.056, (True, False)), "≤ 0.005"),
        (quantity(5.0, 0.2, 5.0, (False, True)), "≥ 5"),
    ],
)
def test_a_value_has_the_digits_that_its_interval_leaves_it(of, text):
    assert estimated(of) == text


@pytest.mark.parametrize(
    ("status", "determined", "word"),
    [
        ("CONVERGED", "determined", "determined"),
        ("CONVERGED", "not determined", "not determined"),
        ("AT_BOUND", "weakly determined", "weakly determined"),
        ("DOUBTFUL", "determined", "doubtful"),
    ],
)
def test_the_badge_is_never_how_the_search_ended(status, determined, word):
    assert badge(SimpleNamespace(status=status, determined=determined, method="weighed")) == word


def test_a_method_without_intervals_determines_nothing():
    estimate = SimpleNamespace(status="CONVERGED", determined="not determined", method="paper")
    assert badge(estimate) == "no intervals"
    assert badge(SimpleNamespace(**{**vars(estimate), "status": "DOUBTFUL"})) == "doubtful"


@pytest.mark.parametrize(
    ("sd", "text"),
    [(0.0, "1.00"), (0.2, "1.48"), (0.4, "2.2"), (2.0, "50"), (4.0, "more than 1000"), (1e3, "more than 1000")],
)
def test_factor95(sd, text):
    assert factor95(sd) == text


def budgeted(**changed):
    rows = {
        "model discrepancy": {"bending": 0.2, "tissue": 0.19},
        "trunk size": {"bending": 0.41, "tissue": 0.05},
        "push height": {"bending": 0.3, "tissue": 0.2},
    }
    return SimpleNamespace(
        **{
            "sd_log": {"bending": 0.4, "tissue": 0.2},
            "sd_log_tracking": {"bending": 0.1, "tissue": 0.04},
            "values": {"bending": 0.1, "tissue": 0.04},
            "budget": [BudgetRecord(name=name, alone=without, without=without) for name, without in rows.items()],
            "best_known": None,
            "supports": [SupportPlaceRecord(push="a", frame=i, obliquity_deg=turn, shoulder_mm=0.0) for i, turn in
                         enumerate((2.44, -0.31))],
            **changed,
        }
    )  # fmt: skip


def test_what_costs_most_and_what_of_it_can_be_measured():
    estimate = budgeted()
    assert most_costly(estimate, "bending").name == "model discrepancy"
    assert most_costly(estimate, "bending", measurable=True).name == "push height"
    assert most_costly(estimate, "tissue", measurable=True).name == "trunk size"
    assert most_costly(budgeted(budget=[]), "tissue") is None
    # Where each is known as well as all together, nothing would be gained.
    assert most_costly(budgeted(sd_log={"bending": 0.2, "tissue": 0.05}), "bending") is None


def test_how_well_the_ratios_are_known_and_how_far_the_pelvis_turned():
    assert factor_lines(budgeted()) == [
        "bending: known within a factor of 2.2 (95 %, to first order), of 1.22 if tracking's errors were the only ones",
        "tissue: known within a factor of 1.48 (95 %, to first order), of 1.08 if tracking's errors were the only ones",
    ]
    assert pelvis_lines(budgeted()) == ["pelvis in the training frames: turned by −0.3° to 2.4°"]
    assert factor_lines(budgeted(sd_log={})) == pelvis_lines(budgeted(supports=[])) == []


def test_unknowns_stand_by_what_they_cost_alone_or_beside_all_others():
    # Shares of the variance: 0.75 of bending if known, 0.94 of tissue if known, 0.44 of bending; none by itself, but
    # the last, which together with others costs nothing.
    rows = {"model discrepancy": (0.2, 0.19), "trunk size": (0.41, 0.05), "push height": (0.3, 0.2)}
    budget = [
        BudgetRecord(name=name, alone={"bending": 0.1, "tissue": 0.04}, without=dict(zip(("bending", "tissue"), row)))
        for name, row in rows.items()
    ]
    budget.append(
        BudgetRecord(
            name="rib joints", alone={"bending": 0.38, "tissue": 0.04}, without={"bending": 0.4, "tissue": 0.2}
        )
    )
    found = [row.name for row in costly_unknowns(budgeted(budget=budget))]
    assert found == ["trunk size", "rib joints", "model discrepancy", "push height"]


def test_other_priors_stand_by_how_far_they_move_or_widen_a_ratio():
    as_it_is = {"bending": 0.4, "tissue": 0.2}

    def prior(name, bending, tissue, sds=as_it_is):
        return PriorChangeRecord(name=name, factor=2.0, ratios={"bending": bending, "tissue": tissue}, sd_log=sds)

    little, moved = prior("little", 0.101, 0.04), prior("moved", 0.1, 0.04 * math.exp(0.1))
    widened = prior("widened", 0.1, 0.04, {"bending": 0.4, "tissue": 0.36})
    estimate = budgeted(prior_changes=[little, moved, widened])
    assert moved_sd(estimate, moved) == pytest.approx(0.5) and moved_sd(estimate, widened) == 0.0
    assert strongest_priors(estimate) == [widened, moved, little]


def test_the_combination_that_is_known_best():
    found = CombinationRecord(exponents={"bending": 0.412, "tissue": 1.0}, value=0.01234, sd_log=0.06)
    assert best_known_text(found) == "bending^0.41 × tissue = 0.012 within a factor of 1.12"
    (line,) = combination_lines(budgeted(best_known=found))
    assert line == "known best, a combination (95 %, to first order): " + best_known_text(found)
    assert combination_lines(budgeted()) == []
    sharp = CombinationRecord(exponents={"a": 1.0, "b": -0.5, "c": 0.04}, value=0.01234, sd_log=0.01)
    text = "A × B^−0.50 = 0.0123 within a factor of 1.02 (powers below 0.1 not shown)"
    assert best_known_text(sharp, str.upper) == text
    assert best_known_text(found, "the {}".format).startswith("(the bending)^0.41 × (the tissue) = ")


def test_no_more_than_two_ratios_are_told_of():
    assert least_known(budgeted(sd_log={"bending": 0.4, "tissue": 0.2, "other": 0.3})) == ["bending", "other"]


def test_every_unknown_has_words(finished):
    """Of a whole fit, and no words are of anything else."""
    named = {row.name for row in read_outcome(read_subject(finished.folder), Estimate).budget}
    assert len(named) > 15 and named < set(UNKNOWNS) == set(get_args(Cause))


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("rib joints", "the stiffness of the ribs' joints"),
        ("tissue's volume", "the tissue's resistance to a change of volume"),
    ],
)
def test_ribs_and_volume_are_told_by_what_would_be_measured(name, words):
    row = BudgetRecord(name=name, alone={}, without={"tissue": 0.1})
    estimate = budgeted(sd_log={"tissue": 0.2}, supports=[], budget=[row])
    assert unknown_title(name) == words
    assert most_costly(estimate, "tissue", measurable=True) is None


@pytest.mark.parametrize(
    ("parts", "text"), [((), ""), (("a",), "a"), (("a", "b"), "a and b"), (("a", "b", "c"), "a, b and c")]
)
def test_listed(parts, text):
    assert listed(parts) == text


def answered(levels, change, force, scatter=None, rest=25.0):
    low, value, high = force
    return AngleResponse(
        levels=levels, frames=(0, 1), rest_deg=rest, change_deg=change, change_sd_deg=0.5, scatter=scatter,
        n_per_degree=ForcePerDegree(value=value, low=low, high=high),
    )  # fmt: skip


def lines_of(**push):
    return response_lines(
        Responses(gauge_scale_sd=0.02, gauge_zero_sd_n=1.5, pushes={"main": PushResponse(force_n=60.0, **push)})
    )


def test_response_lines():
    curve = answered(("T5", "T11"), -17.5, (2.9, 3.4286, 4.12))
    tilt = answered(("T6", "L1"), 19.0, (3.05, 3.158, 3.26), scatter=1.2)
    assert lines_of(tilt=tilt, curve=curve, flexibility=Flexibility(percent=70.0, low=61.0, high=81.2)) == [
        "push 'main': 3.4 (2.9 to 4.1) N per degree of the curve T5–T11, up to 60 N",
        "push 'main': 3.16 (3.05 to 3.26) N per degree of tilt between T6 and L1, the most that any two turned",
        "push 'main': flexibility at 60 N: 70 % (61 to 81 %); 25.0° without force, 17.5° ± 1.0° less under it",
    ]


@pytest.mark.parametrize(
    ("rest", "change", "words"),
    [
        (5.0, -12.0, "12.0° ± 1.0° less under it, past straight to 7.0° the other way"),
        (-5.0, 12.0, "12.0° ± 1.0° less under it, past straight to 7.0° the other way"),
        (5.0, -5.0, "5.0° ± 1.0° less under it"), (5.0, 2.0, "2.0° ± 1.0° more under it"),
    ],
)  # fmt: skip
def test_a_curve_that_a_push_turns_over_is_told(rest, change, words):
    found = changed(answered(("T5", "T11"), change, (2.9, 3.4286, 4.12), rest=rest))
    assert found == f"5.0° without force, {words}"


def test_a_curve_between_other_end_vertebrae_is_told():
    curve, share = answered(("T5", "T11"), -17.5, (2.9, 3.4286, 4.12)), Flexibility(percent=70.0, low=61.0, high=81.2)
    (told,) = lines_of(tilt=curve, curve=curve, flexibility=share, instead_of=("T4", "T11"))[3:]
    assert told == (
        "push 'main': the curve is T5–T11, not the rest picture's T4–T11, of which no frame without force or none "
        "under half of the largest force shows both end vertebrae"
    )


def test_response_lines_of_what_is_not_known():
    curve = answered(("T5", "T11"), 0.3, (47.3, None, None), scatter=3.14, rest=0.4)
    nothing = Flexibility(percent=None, low=None, high=None)
    found = lines_of(tilt=curve, curve=curve, flexibility=nothing)
    assert found[0] == "push 'main': at least 47 N per degree of the curve T5–T11, up to 60 N"
    unknown = "not known, the curve does not stand out from its errors"
    assert found[2] == f"push 'main': flexibility at 60 N: {unknown}; 0.4° without force, 0.3° ± 1.0° more under it"
    assert found[3].startswith("push 'main': the curve is off a straight line over the force by 3.1 times its errors")
    assert found[4].startswith("push 'main': tilt between T5 and T11 is off a straight line")
    assert len(found) == 5
    assert lines_of(missing="no usable frame without force") == [
        "push 'main': no N per degree: no usable frame without force"
    ]


def tracked_push(*qualities):
    """A push of two vertebrae; ``qualities`` are (T5, T6) of each frame, the four corners alike or one by one."""
    quad = [[0.0, 0.0]] * 4
    frames = [
        {"corners_px": [quad, quad], "quality": [one if isinstance(one, list) else [one] * 4 for one in pair]}
        for pair in qualities
    ]
    return TrackedPush.model_construct(
        vertebrae=("T5", "T6"), frames=tuple(TrackedFrame.model_validate(frame, strict=False) for frame in frames)
    )


def test_tracking_is_told_by_what_was_lost_and_what_is_doubtful() -> None:
    whole = tracked_push((1.0, 1.0), (0.9, 0.3))
    some = tracked_push((1.0, 1.0), (0.01, 0.2), (0.0, [0.9, 0.9, 0.9, 0.0]), ([0.5, 0.5, 0.0, 0.0], 0.9))
    assert tracking_lines(Tracked.model_construct(pushes={"a": whole, "b": some})) == [
        "push 'a': 2 frames, 2 vertebrae followed in all of them; 0 of 16 corners are doubtful",
        "push 'b': 4 frames, 1 of 2 vertebrae followed in all; lost: T5 in frames 1, 2, 3; 4 of 32 corners "
        "are doubtful",
    ]


def test_the_geometry_is_told_by_its_fit_and_its_notes() -> None:
    found = GeometryRecord.model_construct(
        rmse_mm={"frontal": 0.812, "lateral": 1.1}, corner_sd_mm=0.4, prior_only=("T1", "T2"), warnings=("a stray one",)
    )
    assert geometry_lines(found) == [
        "torso against the radiographs at rest, RMSE: frontal 0.81 mm, lateral 1.10 mm; corners scatter by 0.40 mm; no "
        "radiograph shows T1 and T2, whose places are the prior's",
        "note: a stray one",
    ]
