"""What a cohort says of people, from made-up rows."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm, t, ttest_ind

from cohort_runners import row
from spinestiff.cohort.group import Member
from spinestiff.cohort.page import cohort_page
from spinestiff.cohort.picture import draw_statistics
from spinestiff.cohort.row import Stiffness
from spinestiff.cohort.statistics import Effect, _holm, cohort_statistics, covariates
from spinestiff.cohort.statistics_words import statistics_sections, title_of
from spinestiff.study.wording.titles import TIMES_DEFAULT, TIMES_WHOLE


def people(count, effect=0.0, seed=0, **changes):
    """Participants whose stiffness grows by ``effect`` (log) a year."""
    random = np.random.default_rng(seed)
    members = []
    for number in range(count):
        name = f"sub-{number:03d}"
        age, sd = float(random.uniform(10.0, 16.0)), float(random.uniform(0.05, 0.3))
        log = effect * (age - 13.0) + random.normal(0.0, 0.2) + random.normal(0.0, sd)
        value = 0.1 * float(np.exp(log))
        ends = {"low": value / 2, "high": value * 2}
        stiffness = Stiffness(value=value, unit=TIMES_DEFAULT, **ends, sd_log=sd, visit_sd_log=0.1)
        fields = {"age": age, "height_cm": float(random.uniform(140.0, 180.0)), "stiffness": {"tissue": stiffness}}
        fields["sex"] = "male" if number % 3 == 0 else "female"
        members.append(Member(name, "done", "", row(name, number).model_copy(update={**fields, **changes})))
    return members


def test_an_effect_is_found_as_a_factor_and_nothing_else_is():
    (found,) = cohort_statistics(people(60, effect=0.15, seed=1))
    assert found.people == 60
    effects = {one.name: one for one in found.together}
    assert set(effects) == {
        "age, a year more", "height, 10 cm more", "Cobb angle, 10 degrees more", "sex: male against female",
    }  # fmt: skip
    age = effects.pop("age, a year more")
    assert age.low < np.exp(0.15) < age.high
    assert age.p_adjusted < 0.001
    assert all(one.p_adjusted > 0.05 for one in effects.values())
    assert found.between_low < np.hypot(0.2, 0.15 * 6 / np.sqrt(12)) < found.between_high
    assert found.person_low < found.mean_low < found.mean < found.mean_high < found.person_high


def test_shrunken_values_lie_between_the_estimate_and_the_others():
    (found,) = cohort_statistics(people(12, age=13.0, height_cm=160.0, sex="female", cobb_deg=20.0))
    assert (found.alone, found.together) == ((), ())
    for one in found.shrunken:
        low, high = sorted((one.value, found.mean))
        assert low * 0.98 <= one.given_all <= high * 1.02
        assert one.low < one.given_all < one.high
    weights = [one.weight for one in sorted(found.shrunken, key=lambda one: one.sd_log)]
    assert weights == sorted(weights, reverse=True)


def test_95_percent_of_people_are_where_they_are_expected():
    """Where people differ less than estimates err, too, and REML often ends at no difference at all."""
    random = np.random.default_rng(2)
    alike = people(30, age=13.0, height_cm=160.0, sex="female", cobb_deg=20.0)
    inside = []
    for _ in range(60):
        members = []
        for member in alike:
            sd = float(random.uniform(0.1, 0.3))
            value = float(np.exp(random.normal(0.0, 0.1) + random.normal(0.0, sd)))
            stiffness = Stiffness(value=value, unit=TIMES_DEFAULT, low=value / 2, high=value * 2, sd_log=sd)
            row = member.row.model_copy(update={"stiffness": {"tissue": stiffness}})
            members.append(Member(member.participant, "done", "", row))
        (found,) = cohort_statistics(members)
        if found.person_low is not None:
            inside.append(np.diff(norm.cdf(np.log([found.person_low, found.person_high]) / 0.1))[0])
    assert len(inside) > 50 and min(inside) > 0.6
    assert 0.93 < np.mean(inside) < 0.99


def test_who_does_not_count_is_left_out_with_the_reason():
    members = people(11)
    reasons = {}
    open_end = members[0].row.stiffness["tissue"].model_copy(update={"sd_log": None})
    changes = [
        (Member("sub-000", "done", "", members[0].row.model_copy(update={"stiffness": {"tissue": open_end}})),
         "interval with an open end"),
        (Member("sub-001", "done", "", members[1].row.model_copy(update={"status": "DOUBTFUL"})), "doubtful"),
        (Member("sub-002", "out of date", "", members[2].row), "out of date"),
        (Member("sub-003", "failed", "no"), "failed"),
        (Member("sub-004", "done", "", members[4].row.model_copy(update={"stiffness": {}})), "not estimated"),
        (Member("sub-005", "done", "", members[5].row.model_copy(update={"population": "koutras2025"})),
         "with koutras2025 as a prior"),
    ]  # fmt: skip
    for number, (member, why) in enumerate(changes):
        members[number] = member
        reasons[member.participant] = why
    (found,) = cohort_statistics(members)
    assert (found.people, found.left_out) == (5, reasons)
    assert cohort_statistics(members[:10]) == ()


def test_ratios_to_the_whole_and_to_the_default_are_not_pooled():
    """About 1 against about 0.1: together they were one population of people who differ by a factor of ten."""
    members = people(13)
    for number in (0, 3, 4, 6, 7, 9):
        tissue = members[number].row.stiffness["tissue"]
        beside = {"tissue": tissue.model_copy(update={"value": 10.0 * tissue.value, "unit": TIMES_WHOLE})}
        row = members[number].row.model_copy(update={"stiffness": beside})
        members[number] = Member(members[number].participant, "done", "", row)
    default, whole = cohort_statistics(members)
    assert (default.unit, default.people, whole.unit, whole.people) == (TIMES_DEFAULT, 7, TIMES_WHOLE, 6)
    assert default.mean_high < 0.3 < whole.mean_low
    assert default.left_out["sub-000"] == "its ratio is relative to the whole there"
    assert whole.left_out["sub-001"] == "its ratio is relative to the default there"
    assert set(default.left_out) == {person.participant for person in whole.shrunken}
    assert [title_of(one) for one in (default, whole)] == [
        "ratio tissue, times the default stiffness", "ratio tissue, times the ratio of the whole",
    ]  # fmt: skip
    figure = draw_statistics((default, whole), members, ("", ""))
    # The picture shows the intervals that the rows have.
    drawn = [path.vertices[:, 1] for lines in figure.axes[0].collections for path in lines.get_paths()]
    for person in default.shrunken:
        own = members[int(person.participant.removeprefix("sub-"))].row.stiffness["tissue"]
        assert (person.own_low, person.own_high) == (own.low, own.high)
        assert any(np.allclose(ends[:2], (own.low, own.high)) for ends in drawn)
    page = cohort_page(members)
    assert "tissue, times default" in page and "tissue, times whole" in page


def test_visits_of_one_person_are_not_as_many_people():
    once = people(8)
    named = [(f"{one.participant}-{visit}", one.row) for one in once for visit in ("a", "b", "c")]
    visits = [Member(name, "done", "", row.model_copy(update={"participant": name})) for name, row in named]
    doubtful = visits[0].row.model_copy(update={"status": "DOUBTFUL"})
    visits[0] = Member(visits[0].participant, "done", "", doubtful)
    (alone,), (found,) = cohort_statistics(once), cohort_statistics(visits)
    assert found.people == 8
    assert (found.mean_low, found.mean_high, found.alone) == (alone.mean_low, alone.mean_high, alone.alone)
    assert found.left_out["sub-000-a"] == "doubtful"
    assert "sub-000-b" not in found.left_out
    assert found.left_out["sub-000-c"] == found.left_out["sub-007-b"] == "of a person who counts already (same id)"
    assert cohort_statistics([one for one in visits if one.row.id in ("sub-001", "sub-002")]) == ()


def test_all_covariates_together_take_people_enough():
    assert cohort_statistics(people(24))[0].together == ()
    assert len(cohort_statistics(people(25))[0].together) == 4


def test_a_kind_of_one_person_and_what_all_have_alike_are_no_covariates():
    rows = [member.row for member in people(6, age=12.0)]
    rows[0] = rows[0].model_copy(update={"curve": "thoracolumbar/lumbar"})
    assert {one.key for one in covariates(rows)} == {"height", "cobb", "sex"}
    rows[1] = rows[1].model_copy(update={"curve": "thoracolumbar/lumbar"})
    names = [one.name for one in covariates(rows)]
    assert "curve: thoracolumbar/lumbar against main thoracic" in names


def test_a_kind_alone_is_told_against_the_usual_one_and_not_against_all_others():
    """Both kinds are alike, and people of a third have four times their stiffness."""
    kinds = ["main thoracic"] * 10 + ["none"] * 8 + ["thoracolumbar/lumbar"] * 8
    members = people(len(kinds), age=13.0, height_cm=160.0, sex="female", cobb_deg=20.0)
    for number, (member, kind) in enumerate(zip(members, kinds)):
        stiffness = member.row.stiffness["tissue"]
        value = stiffness.value * (4.0 if kind == "thoracolumbar/lumbar" else 1.0)
        changes = {"curve": kind, "stiffness": {"tissue": stiffness.model_copy(update={"value": value})}}
        members[number] = Member(member.participant, "done", "", member.row.model_copy(update=changes))
    (found,) = cohort_statistics(members)
    none, lumbar = found.alone
    assert none.name == "curve: none against main thoracic"
    assert none.low < 1.0 < none.high and 0.7 < none.factor < 1.4
    assert lumbar.low < 4.0 < lumbar.high
    assert [one.factor for one in found.alone] == pytest.approx([one.factor for one in found.together])


def test_the_only_one_of_a_kind_is_not_counted_with_the_usual_one():
    """Kinds that two or more have are told as they would be without that person, who is twenty times as stiff."""
    kinds = ["main thoracic"] * 6 + ["none"] * 5
    members = people(len(kinds) + 1, age=13.0, height_cm=160.0, sex="female", cobb_deg=20.0)
    for number, (member, kind) in enumerate(zip(members, [*kinds, "thoracolumbar/lumbar"])):
        stiffness = member.row.stiffness["tissue"]
        value = stiffness.value * (20.0 if kind == "thoracolumbar/lumbar" else 1.0)
        changes = {"curve": kind, "stiffness": {"tissue": stiffness.model_copy(update={"value": value})}}
        members[number] = Member(member.participant, "done", "", member.row.model_copy(update=changes))
    (found,), (without,) = cohort_statistics(members), cohort_statistics(members[:-1])
    assert [one.name for one in found.alone] == ["curve: none against main thoracic"]
    assert found.alone[0].factor == pytest.approx(without.alone[0].factor, rel=1e-6)
    assert found.alone[0].high == pytest.approx(without.alone[0].high, rel=1e-6)


def test_the_only_one_of_a_kind_is_drawn_towards_the_others_and_takes_no_place_among_covariates():
    kinds = ["main thoracic"] * 6 + ["none"] * 5 + ["thoracolumbar/lumbar"]
    members = people(len(kinds), age=13.0, height_cm=160.0, sex="female", cobb_deg=20.0)
    for number, (member, kind) in enumerate(zip(members, kinds)):
        stiffness = member.row.stiffness["tissue"].model_copy(update={"sd_log": 1.0 if number == 11 else 0.1})
        changes = {"curve": kind, "stiffness": {"tissue": stiffness}}
        members[number] = Member(member.participant, "done", "", member.row.model_copy(update=changes))
    (found,) = cohort_statistics(members)
    assert [one.name for one in found.together] == ["curve: none against main thoracic"]
    alone = found.shrunken[-1]
    usual = float(np.exp(np.mean([np.log(one.value) for one in found.shrunken[:6]])))
    assert alone.weight < 0.2
    assert abs(np.log(alone.given_all / usual)) < 0.3 * abs(np.log(alone.value / usual))


def test_patients_needed_fall_with_the_difference_and_rise_with_the_spread():
    (found,) = cohort_statistics(people(30))
    assert [one.factor for one in found.needed] == [1.25, 1.5, 2.0]
    assert found.needed[0].a_group > found.needed[1].a_group > found.needed[2].a_group > 2
    one = found.needed[0]
    assert one.a_group_low <= one.a_group <= one.a_group_high
    # 0.1 from visit to visit: 0.141 of a difference of two, log 1.25 is 1.58 of those.
    assert one.visited_twice == 6
    assert [one.factor for one in cohort_statistics(people(30), 1.1)[0].needed] == [1.1]
    unknown = people(30)
    stiffness = [member.row.stiffness["tissue"].model_copy(update={"visit_sd_log": None}) for member in unknown]
    unknown = [
        Member(member.participant, "done", "", member.row.model_copy(update={"stiffness": {"tissue": one}}))
        for member, one in zip(unknown, stiffness)
    ]
    assert cohort_statistics(unknown)[0].needed[0].visited_twice is None


def test_patients_of_two_groups_are_counted_for_a_test_that_weighs_them():
    """Where a few are known badly, as many as are told have the power by a weighted mean, and not by a plain one."""
    members = []
    for number, member in enumerate(people(30)):
        sd = 1.5 if number % 3 == 0 else 0.2
        tissue = member.row.stiffness["tissue"].model_copy(update={"sd_log": sd})
        changes = {"stiffness": {"tissue": tissue}}
        members.append(Member(member.participant, "done", "", member.row.model_copy(update=changes)))
    (found,) = cohort_statistics(members, 1.5)
    count, tau, rng = found.needed[0].a_group, found.between_sd_log, np.random.default_rng(3)
    weighed, plain = [], []
    for _ in range(1000):
        sds = np.hypot(tau, np.where(rng.random((2, count)) < 1.0 / 3.0, 1.5, 0.2))
        logs = rng.normal([[0.0], [np.log(1.5)]], sds)
        first, second = np.average(logs, axis=1, weights=sds**-2)
        error = np.sqrt((1.0 / (sds**-2).sum(axis=1)).sum())
        weighed.append(abs(second - first) > t.ppf(0.975, 2 * count - 2) * error)
        plain.append(ttest_ind(*logs).pvalue < 0.05)
    assert np.mean(weighed) == pytest.approx(0.8, abs=0.06) and np.mean(plain) < 0.6
    assert "counts the less the wider the own interval is" in statistics_sections((found,), members)[1].sentences[0]


def test_visits_of_one_group_are_counted_for_a_test_that_counts_all_alike():
    """As the page says: where a few scatter more from visit to visit, a plain test of the differences has the power."""
    members = []
    for number, member in enumerate(people(30)):
        tissue = member.row.stiffness["tissue"].model_copy(update={"visit_sd_log": 0.6 if number % 3 == 0 else 0.05})
        changes = {"stiffness": {"tissue": tissue}}
        members.append(Member(member.participant, "done", "", member.row.model_copy(update=changes)))
    (found,) = cohort_statistics(members, 1.25)
    count, rng = found.needed[0].visited_twice, np.random.default_rng(3)
    sds = np.sqrt(2.0) * np.where(rng.random((4000, count)) < 1.0 / 3.0, 0.6, 0.05)
    changes = np.log(1.25) + sds * rng.normal(size=sds.shape)
    statistic = np.sqrt(count) * changes.mean(axis=1) / changes.std(axis=1, ddof=1)
    assert np.mean(np.abs(statistic) > t.ppf(0.975, count - 1)) == pytest.approx(0.8, abs=0.04)
    words = statistics_sections((found,), members)[1].sentences[0]
    assert "where all count alike" in words.partition("of one group visited")[2]


def test_holm_by_hand():
    effects = [Effect(name, 1.0, 0.5, 2.0, p, 1.0) for name, p in (("a", 0.03), ("b", 0.01), ("c", 0.02), ("d", 0.9))]
    assert [one.p_adjusted for one in _holm(effects)] == pytest.approx([0.06, 0.04, 0.06, 0.9])
