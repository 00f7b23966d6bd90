"""How repeatable estimates are, and whether somebody changed."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from spinestiff.app.repeat import record_of
from spinestiff.errors import SubjectError
from spinestiff.files import read_json, write_json
from spinestiff.study.repeatability import (
    LEAST_REACH,
    TWO_SIDED,
    VisitEstimate,
    VisitRatio,
    estimate_of,
    repeatability,
)
from spinestiff.study.report.figures import as_png
from spinestiff.study.report.repeat_picture import draw_repeatability
from spinestiff.study.visit import open_visit
from spinestiff.study.wording.repeat import change_words, repeatability_lines
from spinestiff.subject.estimate_outcome import Estimate, RatioEstimate
from spinestiff.subject.outcome_parts import Quantity
from spinestiff.subject.run_record import read_outcome


def visit(subject, number, sd=0.2, known=True, whole=0.5, pushes=(), settings=None, **values):
    ratios = {name: VisitRatio(value, sd, whole, known) for name, value in values.items()}
    return VisitEstimate(f"{subject}-{number}", subject, ratios, pushes, settings or {})


def drawn(people, visits, sd, told, seed=0):
    random = np.random.default_rng(seed)
    return [
        visit(f"p{i}", j, told, bending=float(np.exp(centre + random.normal(0.0, sd))))
        for i, centre in enumerate(random.normal(-2.0, 1.0, people))
        for j in range(visits)
    ]


def test_the_within_subject_sd_is_that_of_an_analysis_of_variance() -> None:
    values = {"a": (0.1, 0.12, 0.09), "b": (0.4, 0.5)}
    found = repeatability([visit(who, i, bending=v) for who, row in values.items() for i, v in enumerate(row)])
    one = found.scatter["bending"]
    logs = [np.log(row) for row in values.values()]
    wanted = np.sqrt(sum(((x - x.mean()) ** 2).sum() for x in logs) / 3)
    assert one.degrees == 3
    assert one.within_sd_log == pytest.approx(wanted)
    assert one.low < wanted < one.high
    assert one.detectable_factor == pytest.approx(np.exp(1.959964 * np.sqrt(2.0) * wanted))
    assert one.expected_sd_log == pytest.approx(0.2)
    assert len(found.changes) == 3


def test_intervals_of_the_within_subject_sd_hold() -> None:
    held = []
    for seed in range(200):
        one = repeatability(drawn(5, 3, 0.3, 0.3, seed)).scatter["bending"]
        held.append(one.low <= 0.3 <= one.high)
    assert 0.9 < np.mean(held) < 0.99


def test_scatter_that_is_not_as_expected_is_told() -> None:
    as_told, more, less = (repeatability(drawn(20, 3, 0.3, told)) for told in (0.3, 0.15, 0.6))
    assert not any("scatter" in line for line in repeatability_lines(as_told))
    assert any("scatter more than their own errors let expect" in line for line in repeatability_lines(more))
    assert any("scatter less than their own errors let expect" in line for line in repeatability_lines(less))


def test_scatter_of_people_known_well_is_not_hidden_by_one_known_badly() -> None:
    """The p-value, what is said and how changes are judged are of one measure: scatter over each estimate's error."""
    random = np.random.default_rng(1)
    visits = [visit(f"p{i}", j, 0.05, bending=float(np.exp(random.normal(0, 0.15)))) for i in range(12) for j in (0, 1)]
    visits += [visit("bad", j, 0.8, bending=value) for j, value in enumerate((1.0, 1.2))]
    found = repeatability(visits)
    one = found.scatter["bending"]
    assert one.within_sd_log < one.expected_sd_log
    assert one.p_value < 0.01 and one.standardised > 1.5
    assert one.wider == one.standardised
    assert any("scatter more than their own errors let expect" in line for line in repeatability_lines(found))
    first = found.changes[0]
    assert first.detectable_factor > np.exp(1.5 * 1.959964 * np.sqrt(2.0) * 0.05)


def test_no_scatter_has_a_probability_of_nothing() -> None:
    found = repeatability([visit("a", 0, 0.02, bending=0.1), visit("a", 1, 0.02, bending=0.2)])
    # A log ratio of 0.69 is 24.5 standard deviations of 0.02 √2.
    assert found.scatter["bending"].p_value == pytest.approx(2.0 * norm.sf(np.log(2.0) / 0.02 / np.sqrt(2.0)) * 2.0)
    assert "(p 0)" not in " ".join(repeatability_lines(found))


def test_an_unchanged_person_is_told_to_have_changed_in_one_of_twenty() -> None:
    changes = repeatability(drawn(600, 2, 0.25, 0.25)).changes
    share = np.mean([change.verdict == "changed" for change in changes])
    assert 0.03 < share < 0.07


def skewed(people, skew, sd=0.2, seed=0):
    """Two visits each, whose estimate's log is (exp(skew z) - 1) / skew of a normal z; its interval has the ends that
    those of z give, its standard deviation is to first order."""
    random = np.random.default_rng(seed)

    def log_of(z):
        return (np.exp(skew * z) - 1.0) / skew

    visits = []
    for i in range(people):
        for j, z in enumerate(random.normal(0.0, sd, 2)):
            low, value, high = (float(np.exp(log_of(at))) for at in (z - TWO_SIDED * sd, z, z + TWO_SIDED * sd))
            first_order = sd * float(np.exp(skew * z))
            one = VisitRatio.of(Quantity(value=value, low=low, high=high), first_order, first_order)
            visits.append(VisitEstimate(f"p{i}-{j}", f"p{i}", {"tissue": one}))
    return visits


@pytest.mark.parametrize("skew", [2.0, -2.0])
def test_skewed_estimates_of_unchanged_people_scatter_as_they_say(skew) -> None:
    """What two intervals of unlike sides say of their difference holds in 95 %; each to first order alone says less."""
    visits = skewed(300, skew)
    found = repeatability(visits)
    assert 0.03 < np.mean([change.verdict == "changed" for change in found.changes]) < 0.07
    inside = np.mean([change.low <= 1.0 <= change.high for change in found.changes])
    assert inside == pytest.approx(np.mean([change.verdict != "changed" for change in found.changes]))
    ratios = [one.ratios["tissue"] for one in visits]
    first_order = [
        replace(one, ratios={"tissue": replace(ratio, below=1.0, above=1.0)}) for one, ratio in zip(visits, ratios)
    ]
    plain = np.mean([change.verdict == "changed" for change in repeatability(first_order).changes])
    assert abs(plain - 0.05) > abs(1.0 - inside - 0.05)


def test_an_interval_says_how_far_an_estimate_is_off_on_either_side() -> None:
    reach = TWO_SIDED * 0.1
    told = Quantity(value=1.0, low=float(np.exp(-2.0 * reach)), high=float(np.exp(0.8 * reach)))
    one = VisitRatio.of(told, 0.1, 0.1)
    assert (one.known, one.below, one.above) == (True, pytest.approx(2.0), pytest.approx(0.8))
    assert (one.sd_on(upper=False), one.sd_on(upper=True)) == (pytest.approx(0.2), pytest.approx(0.08))
    # Of a quarter of it a quarter as far from first order.
    small = VisitRatio.of(told, 0.025, 0.1)
    assert (small.sd_on(upper=False), small.sd_on(upper=True)) == (pytest.approx(0.03125), pytest.approx(0.02375))
    # Of a change, the sides that face each other: upwards the first one's upper and the second one's lower.
    other = replace(one, value=1.9)
    for before, after, sd in ((one, other, np.hypot(0.08, 0.2)), (other, one, np.hypot(0.2, 0.08))):
        visits = [VisitEstimate(f"a-{i}", "a", {"tissue": ratio}) for i, ratio in enumerate((before, after))]
        (change,) = repeatability(visits).changes
        assert change.detectable_factor == pytest.approx(np.exp(TWO_SIDED * sd))
        assert change.low < change.factor < change.high
    skewed_up = replace(one, below=0.5, above=3.0)
    (change,) = repeatability(
        [VisitEstimate(f"a-{i}", "a", {"tissue": ratio}) for i, ratio in enumerate((one, skewed_up))]
    ).changes
    assert np.log(change.high) == pytest.approx(TWO_SIDED * np.hypot(0.2, 0.3))
    assert -np.log(change.low) == pytest.approx(TWO_SIDED * np.hypot(0.08, 0.05))


def test_an_estimate_with_an_open_interval_or_none_is_not_known() -> None:
    closed = {"value": 1.0, "low": 0.8, "high": 1.3}
    assert VisitRatio.of(Quantity(**closed), 0.1, 0.2).known
    assert not VisitRatio.of(Quantity(**closed), 0.1, 0.2, sound=False).known
    for end in ("low", "high"):
        assert not VisitRatio.of(Quantity(**closed, **{f"open_{end}": True}), 0.1, 0.2).known
        assert not VisitRatio.of(Quantity(**{**closed, end: None}), 0.1, 0.2).known
    assert not VisitRatio.of(Quantity(value=1.0, low=0.01, high=90.0), 0.1, 2.0).known
    # An end at the estimate itself does not make it exact.
    assert VisitRatio.of(Quantity(value=1.0, low=1.0, high=1.3), 0.1, 0.2).below == LEAST_REACH


def test_a_change_is_told_in_words() -> None:
    found = repeatability([visit("a", 0, bending=0.1), visit("a", 1, bending=0.25), visit("a", 2, bending=0.12)])
    large, small = found.changes
    assert (large.verdict, small.verdict) == ("changed", "no change shown")
    assert large.factor == pytest.approx(2.5)
    assert large.low < 2.5 < large.high
    lines = repeatability_lines(found)
    assert "a, bending, a-0 to a-1: changed, stiffer by a factor of 2.50 (1.4 to 4.4)" in lines
    assert any(
        "a-0 to a-2: no change shown" in line and "less than a factor of 1.74 would not" in line for line in lines
    )
    softer = repeatability([visit("a", 0, bending=0.25), visit("a", 1, bending=0.1)])
    assert "changed, softer by a factor of 2.50 (1.4 to 4.4)" in repeatability_lines(softer)[-1]
    disagreeing = repeatability(softer.visits, "annotators")
    assert repeatability_lines(disagreeing)[-1].endswith("annotation explains, a factor of 2.50 (1.4 to 4.4)")


def test_a_ratio_of_which_the_radiographs_say_nothing_has_no_interval_of_its_change(tmp_path) -> None:
    """Its error in log is 1000: the end of an interval was infinite, and the file could not be written."""
    nothing = visit("a", 1, sd=1000.0, known=False, whole=1000.0, bending=1.0)
    found = repeatability([visit("a", 0, bending=0.1), nothing])
    (change,) = found.changes
    assert (change.low, change.high, change.detectable_factor) == (None, None, None)
    assert change.verdict == "can't be told" and change.factor == pytest.approx(10.0)
    write_json(tmp_path / "repeat.json", record_of(found))
    assert "can't be told" in repeatability_lines(found)[-1]
    draw_repeatability(found)


def test_what_is_not_known_has_not_changed_and_does_not_scatter() -> None:
    seen = [visit("a", 0, bending=0.1), visit("a", 1, bending=4.0, known=False), visit("a", 2, bending=0.1)]
    found = repeatability(seen)
    assert [change.verdict for change in found.changes] == ["can't be told", "no change shown"]
    assert (found.scatter["bending"].left_out, found.scatter["bending"].within_sd_log) == (1, 0.0)
    assert "bending: 1 estimate left out: doubtful, not determined, or not pushed alike" in repeatability_lines(found)
    alone = repeatability(seen[:2])
    assert not alone.scatter
    assert "can't be told" in repeatability_lines(alone)[-1]
    (axes,) = draw_repeatability(alone).axes
    assert axes.get_ylabel() == "ratio, bending"
    # A bar of the one that is known, a mark of each.
    assert [len(line.get_xdata()) for line in axes.lines] == [2, 1, 1]


def test_scatter_is_judged_by_what_each_person_tells() -> None:
    """People of quite different standard deviations: one in a hundred is said to scatter otherwise."""
    random, told = np.random.default_rng(5), 0
    for _ in range(400):
        visits = []
        for i, sd in enumerate((0.1, 0.2, 0.4, 0.9)):
            visits += [visit(f"p{i}", j, sd, bending=float(np.exp(random.normal(0.0, sd)))) for j in range(3)]
        found = repeatability(visits).scatter["bending"]
        told += found.p_value < 0.05
        assert found.expected_sd_log == pytest.approx(np.sqrt(np.mean(np.square((0.1, 0.2, 0.4, 0.9)))))
    assert 0.02 < told / 400 < 0.09


def test_changes_are_judged_by_the_scatter_that_is_found() -> None:
    calm, wild = (drawn(15, 3, sd, 0.2, 3) for sd in (0.2, 0.6))
    plain, wider = (repeatability(visits).scatter["bending"].wider for visits in (calm, wild))
    assert plain == 1.0
    assert wider == pytest.approx(3.0, rel=0.3)
    (change, *_) = repeatability(wild).changes
    others = repeatability(wild[3:]).scatter["bending"].wider
    assert change.detectable_factor == pytest.approx(np.exp(1.959964 * np.sqrt(2.0) * 0.2 * others))
    # A change of one's own is none.
    alone = repeatability([visit("a", 0, bending=0.1), visit("a", 1, bending=1.0)])
    assert alone.scatter["bending"].wider > 1.0
    assert alone.changes[0].verdict == "changed"


def test_pushes_that_differ_leave_what_the_model_lacks_in_the_difference() -> None:
    at = (("right", 8.0, 40.0), ("right", 8.0, 60.0))
    near = (("right", 7.5, 45.0), ("right", 7.5, 55.0))
    for other, alike in ((near, True), ((("left", 8.0, 40.0), at[1]), False), (at[:1], False)):
        visits = [visit("a", 0, pushes=at, bending=0.1), visit("a", 1, pushes=other, bending=0.25)]
        found = repeatability(visits)
        (change,) = found.changes
        assert change.alike == alike and ("bending" in found.scatter) == alike
        assert change.verdict == ("changed" if alike else "no change shown")
        assert ("(not pushed alike)" in repeatability_lines(repeatability(visits))[-1]) != alike


def test_pushes_are_paired_with_those_of_the_other_visit_that_they_are_like() -> None:
    at = (("left", 6.0, 40.0), ("right", 8.0, 40.0), ("right", 8.0, 60.0), ("right", 9.0, 40.0))
    # In the order of side, rib and force none of the right side's is beside its like.
    moved = (("left", 6.0, 40.0), ("right", 7.5, 60.0), ("right", 8.0, 44.0), ("right", 8.5, 38.0))
    # Both at 40 N have one partner alone, the same.
    short = (("left", 6.0, 40.0), ("right", 8.0, 60.0), ("right", 8.0, 60.0), ("right", 9.0, 40.0))
    for other, alike in ((moved, True), (at[::-1], True), (short, False)):
        for before, after in ((at, other), (other, at)):
            visits = [visit("a", 0, pushes=before, bending=0.1), visit("a", 1, pushes=after, bending=0.25)]
            found = repeatability(visits)
            assert found.changes[0].alike == alike and ("bending" in found.scatter) == alike


def test_annotations_agree_or_not_and_nobody_changes() -> None:
    visits = [visit("a", 0, bending=0.1), visit("a", 1, bending=0.25), visit("a", 2, bending=0.11)]
    lines = repeatability_lines(repeatability(visits, "annotators"))
    assert "from two annotations of the same radiographs" in lines[0]
    assert lines[-2].endswith("annotations disagree by more than annotation explains, a factor of 2.50 (1.4 to 4.4)")
    assert "annotations agree" in lines[-1]
    assert not any("changed" in line for line in lines)


def test_settings_that_differ_are_refused() -> None:
    visits = [visit("a", i, settings={"mesh": mesh}, bending=0.1) for i, mesh in enumerate(("fine", "coarse"))]
    with pytest.raises(SubjectError, match="a-1: mesh is coarse, in a-0 of the same id fine"):
        repeatability(visits)


def test_labels_tell_visits_of_one_name_apart() -> None:
    first, second = (replace(visit("a", 0, bending=0.1), label=f"/data/{when}/anna") for when in ("january", "march"))
    assert [one.label for one in repeatability([first, second]).visits] == ["january/anna", "march/anna"]


def test_a_name_with_dollars_is_no_formula() -> None:
    visits = [replace(visit("a", i, bending=0.1), label=f"/data/{when}$_$") for i, when in enumerate(("may", "june"))]
    assert as_png(draw_repeatability(repeatability(visits)))


def test_visits_that_can_not_be_compared_are_refused() -> None:
    with pytest.raises(SubjectError, match="needs two or more of one"):
        repeatability([visit("a", 0, bending=0.1), visit("b", 0, bending=0.1)])
    with pytest.raises(SubjectError, match="a-1: has ratios tissue, a-0 has bending"):
        repeatability([visit("a", 0, bending=0.1), visit("a", 1, tissue=0.1)])


def pictured(number, rest="r", push="p", marks="m", subject="a", value=0.1):
    one = visit(subject, number, bending=value)
    return replace(one, rest_pictures=frozenset({rest}), push_pictures=frozenset({push}), marks=marks)


def test_a_copy_is_no_second_visit() -> None:
    with pytest.raises(SubjectError, match="a-1: a push has the same radiographs as in a-0: a copy is no second visit"):
        repeatability([pictured(0), pictured(1, marks="other")])
    # Pictures at rest may serve two visits.
    assert repeatability([pictured(0), pictured(1, push="q")]).changes
    # Another person's hashes are not compared.
    three = [pictured(0), pictured(1, push="q"), pictured(0, subject="b"), pictured(1, push="q", subject="b")]
    assert len(repeatability(three).changes) == 2


def test_annotations_are_of_the_same_pictures_and_differ() -> None:
    with pytest.raises(SubjectError, match="a-1: other radiographs than in a-0; --annotators compares"):
        repeatability([pictured(0), pictured(1, push="q", marks="n")], "annotators")
    with pytest.raises(SubjectError, match="a-2: the annotation is that of a-1, corner by corner"):
        repeatability([pictured(0), pictured(1, marks="n"), pictured(2, marks="n")], "annotators")
    assert repeatability([pictured(0), pictured(1, marks="n")], "annotators").changes


def test_who_has_no_second_visit_is_named() -> None:
    found = repeatability([visit("a", 0, bending=0.1), visit("b", 0, bending=0.3), visit("a", 1, bending=0.1)])
    (line,) = [line for line in repeatability_lines(found) if line.startswith("b-0")]
    assert "compared with nothing: no other visit has its id 'b'" in line


@pytest.mark.parametrize(("low", "text"), [(1.0048, "1.005 to"), (1.3, "1.3 to"), (0.9996, "0.9996 to")])
def test_an_end_beside_one_says_on_which_side_it_lies(low, text) -> None:
    visits = [
        VisitEstimate(f"v-{i}", "v", {"tissue": VisitRatio(value, 0.05, 0.05)}) for i, value in enumerate((0.1, 0.12))
    ]
    (change,) = repeatability(visits).changes
    assert f"({text} " in change_words(replace(change, verdict="changed", factor=1.2, low=low, high=1.5))


def test_one_repetition_gives_no_factor() -> None:
    two = [visit("a", 0, bending=0.1), visit("a", 1, bending=0.1)]
    assert repeatability_lines(repeatability(two))[0].startswith("bending: one repetition tells nothing of how far two")
    three = repeatability_lines(repeatability([*two, visit("a", 2, bending=0.11)]))
    assert "factor of 1.16 (95 %, from 2 repetitions)" in three[0]
    assert not any("tells nothing" in line for line in three)


def test_what_was_held_of_the_ratios_is_told_beside_their_changes() -> None:
    """A level changes by a factor of 3 where levels are held to be alike: the change's interval does not hold that."""
    levels, own, alike = 17, 0.4, 0.3
    apart = np.diff(np.eye(levels), axis=0) / alike
    gain = np.linalg.inv(np.eye(levels) / own**2 + apart.T @ apart) / own**2
    sd = own * float(np.sqrt((gain @ gain.T)[8, 8]))
    found = float(np.exp(np.log(3.0) * gain[8, 8]))
    visits = [visit("a", 0, sd, level=1.0), visit("a", 1, sd, level=found)]
    assert repeatability(visits).changes[0].high < 3.0
    assert not any(line.startswith("note") for line in repeatability_lines(repeatability(visits)))
    told = repeatability_lines(repeatability([replace(one, held=("level smoothness",)) for one in visits]))
    assert told[-1].startswith("note: the fits held of the ratios: level smoothness. That pulls the estimates of all")
    assert [line for line in told if line.startswith("note")] == told[-1:]


def test_an_estimate_says_what_was_held_of_its_ratios(tmp_path, monkeypatch) -> None:
    ratio = RatioEstimate.of(0.1, (0.08, 0.125), (False, False), at_bound=False)
    sds = {"tissue": 0.1}
    estimate = SimpleNamespace(
        ratios={"tissue": ratio}, status="CONVERGED", orientation="procrustes", population=None,
        visit_sd_log=sds, annotation_sd_log=sds, sd_log=sds, held={"level smoothness": "the logs ..."},
    )  # fmt: skip
    record = SimpleNamespace(
        id="a", pushes=(), sex="female", pelvis="estimated", wall="bilateral", priors={}, trunk={}, skin_scan=None
    )
    opened = SimpleNamespace(subject=SimpleNamespace(folder=tmp_path, record=record), file=tmp_path.joinpath)
    module = "spinestiff.study.repeatability"
    monkeypatch.setattr(f"{module}.read_outcome", lambda *_: estimate)
    monkeypatch.setattr(f"{module}.refuse_changed", lambda *_: None)
    monkeypatch.setattr(f"{module}.recorded_steps", lambda _: {"personalise": SimpleNamespace(settings={})})
    monkeypatch.setattr(f"{module}.input_digest", lambda *_: "")
    found = estimate_of(opened)
    assert found.held == ("level smoothness",) and found.ratios["tissue"].known


def test_a_picture_is_drawn_of_few_and_of_many() -> None:
    for visits in (drawn(2, 2, 0.3, 0.3), drawn(30, 3, 0.3, 0.3)):
        assert len(as_png(draw_repeatability(repeatability(visits)))) > 5000


def test_a_change_that_is_told_is_drawn_whoever_has_the_scatter() -> None:
    """Tissue scatters by one person; bending changed in another, who was not pushed alike and so tells no scatter."""
    open_end, known = VisitRatio(0.1, 0.2, 0.5, known=False), VisitRatio(0.1, 0.05, 0.1)
    moved = VisitRatio(0.5, 0.05, 0.1)
    other = (("left", 8.0, 40.0),)
    visits = [
        VisitEstimate("a-0", "a", {"bending": open_end, "tissue": known}),
        VisitEstimate("a-1", "a", {"bending": known, "tissue": known}),
        VisitEstimate("b-0", "b", {"bending": known, "tissue": known}),
        VisitEstimate("b-1", "b", {"bending": moved, "tissue": known}, other),
    ]
    found = repeatability(visits)
    assert list(found.scatter) == ["tissue"]
    assert ("b", "bending", "changed") in [(one.subject, one.name, one.verdict) for one in found.changes]
    assert [axes.get_ylabel() for axes in draw_repeatability(found).axes] == ["ratio, bending", "ratio, tissue"]


def test_the_title_says_what_bars_and_squares_are() -> None:
    """A bar is of one estimate: that of another one of an unchanged person ends in it in 83 %, not in 95 %."""
    visits = [visit("a", i, bending=0.1 + 0.4 * i) for i in range(2)]
    titles = [draw_repeatability(repeatability(visits, of)).axes[0].get_title() for of in ("visits", "annotators")]
    first, second = (" ".join(title.split()) for title in titles)
    assert "by what is new at each visit; squares: changed" in first
    assert "by annotation alone; squares: disagree" in second


@pytest.mark.parametrize("visits", [2, 3, 12, 40])
def test_the_title_is_whole_whatever_the_number_of_visits(visits) -> None:
    found = repeatability([visit("a", i, lateral_bending=0.1 + 0.01 * i) for i in range(visits)])
    figure = draw_repeatability(found)
    figure.canvas.draw()
    title, whole = figure.axes[0].title.get_window_extent(), figure.bbox
    assert whole.x0 <= title.x0 and title.x1 <= whole.x1 and title.y1 <= whole.y1


def test_another_annotation_moves_an_estimate_by_what_the_geometry_does_to_motions(finished) -> None:
    """Marks alone move it by hundredths of its own standard deviation only."""
    estimate = read_outcome(open_visit(finished.folder).subject, Estimate)
    for name, whole in estimate.sd_log.items():
        assert 0.04 * whole < estimate.annotation_sd_log[name] < estimate.visit_sd_log[name]


def test_a_visit_tells_how_it_scatters(finished) -> None:
    opened = open_visit(finished.folder)
    estimate = read_outcome(opened.subject, Estimate)
    found, again = estimate_of(opened), estimate_of(opened, annotators=True)
    assert (found.label, found.subject) == (str(finished.folder.resolve()), opened.subject.record.id)
    assert [force for *_, force in found.pushes] == [15.0, 22.5]
    assert found.settings["mesh"] == "coarse"
    assert (len(found.rest_pictures), len(found.push_pictures)) == (2, 2) and found.marks
    for name, ratio in found.ratios.items():
        assert 0.0 < again.ratios[name].sd_log < ratio.sd_log < estimate.sd_log[name] == ratio.whole_sd_log
        assert ratio.value == estimate.ratios[name].value


def test_an_estimate_out_of_date_is_refused(subject) -> None:
    content = read_json(subject / "annotation.json")
    content["images"]["push/main"]["vertebrae"]["T7"][0][0] += 0.25
    write_json(subject / "annotation.json", content)
    with pytest.raises(SubjectError, match=r"results of track were made before annotation.json: pushes changed"):
        estimate_of(open_visit(subject))


def test_an_estimate_by_the_papers_method_tells_no_scatter(subject, monkeypatch) -> None:
    opened = open_visit(subject)
    plain = read_outcome(opened.subject, Estimate).model_copy(update={"visit_sd_log": {}})
    monkeypatch.setattr("spinestiff.study.repeatability.read_outcome", lambda *_: plain)
    with pytest.raises(SubjectError, match="does not say how it would scatter"):
        estimate_of(opened)
