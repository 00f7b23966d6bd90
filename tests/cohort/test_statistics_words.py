"""A cohort's statistics in words."""

from __future__ import annotations

from cohort_runners import row
from spinestiff.cohort.group import Member
from spinestiff.cohort.row import Stiffness
from spinestiff.cohort.statistics import cohort_statistics
from spinestiff.cohort.statistics_words import statistics_lines, statistics_sections
from spinestiff.study.wording.titles import TIMES_DEFAULT


def people(logs, sd, **changes):
    """Participants by the logs of their stiffness over 0.1."""
    members = []
    for number, log in enumerate(logs, 1):
        name, value = f"sub-{number:03d}", 0.1 * 2.0**log
        stiffness = Stiffness(value=value, unit=TIMES_DEFAULT, low=value / 2, high=value * 2, sd_log=sd)
        fields = {"stiffness": {"tissue": stiffness}, **changes}
        members.append(Member(name, "done", "", row(name, number).model_copy(update=fields)))
    return members


def test_a_spread_below_the_intervals_is_not_told_as_known():
    members = people([0.0, 0.01, -0.01, 0.0, 0.02, 0.01], 0.5)
    found = cohort_statistics(members, 1.5)
    assert (found[0].between_low, found[0].between_high) == (0.0, None)
    assert (found[0].person_low, found[0].person_high) == (None, None)
    assert (found[0].needed[0].a_group_low, found[0].needed[0].a_group_high) == (None, None)
    line = statistics_lines(found)[0]
    assert line.endswith("; intervals are wider than the scatter; the spread between people can't be told")
    assert "95 % of people" not in line
    patients = statistics_sections(found, members)[1].tables[0][2][0][1]
    assert patients == f"{found[0].needed[0].a_group}, by intervals alone"


def test_more_patients_than_are_counted_is_not_the_same_as_not_known():
    members = people([-1.0, 0.0, 0.3, 0.1, 1.0, 0.6], 0.1)

    def shown():
        ((header, *cells),) = statistics_sections(cohort_statistics(members, 1.001), members)[1].tables[0][2]
        return header, cells[-1]

    assert shown() == ("× 1.00", "not known")
    for number, member in enumerate(members):
        tissue = member.row.stiffness["tissue"].model_copy(update={"visit_sd_log": 0.3})
        changes = {"stiffness": {"tissue": tissue}}
        members[number] = Member(member.participant, "done", "", member.row.model_copy(update=changes))
    assert shown() == ("× 1.00", "over 100000")


def test_who_is_left_out_is_told_of_each_stiffness():
    members = people([-1.0, 0.0, 0.3, 0.1, 1.0, 0.6, -0.4], 0.1)
    for number, member in enumerate(members):
        tissue = member.row.stiffness["tissue"]
        open_end = tissue.model_copy(update={"sd_log": None if number == 0 else 0.1})
        changes = {"stiffness": {"lateral_bending": open_end, "tissue": tissue}}
        if number == 1:
            changes["population"] = "koutras2025"
        members[number] = Member(member.participant, "done", "", member.row.model_copy(update=changes))
    sentences = statistics_sections(cohort_statistics(members), members)[0].sentences
    bending, tissue = (one for one in sentences if one.startswith("Left out of"))
    assert bending.startswith("Left out of ratio lateral_bending")
    assert bending.endswith(": 1 interval with an open end, 1 with koutras2025 as a prior.")
    assert tissue.startswith("Left out of ratio tissue")
    assert tissue.endswith(": 1 with koutras2025 as a prior.")


def test_why_there_are_no_statistics_names_all_that_leaves_people_out():
    members = people([-1.0, 0.0, 0.3, 0.1, 1.0, 0.6], 0.1, status="DOUBTFUL")
    (line,) = statistics_lines(cohort_statistics(members))
    assert line.startswith("no statistics: they take 5 participants or more")
    assert "up to date and not doubtful" in line


def test_why_effects_are_not_told_together():
    logs = [0.3 * (number % 7) for number in range(15)]
    alike = {"sex": "female", "cobb_deg": 20.0}
    few, many = people(logs[:14], 0.1, **alike), people(logs, 0.1, **alike)
    for members in (few, many):
        for number, member in enumerate(members):
            grown = {"age": 10.0 + 0.5 * number, "height_cm": 140.0 + number}
            members[number] = Member(member.participant, "done", "", member.row.model_copy(update=grown))
    reasons = []
    for members in (few, many):
        (_, _, rows) = statistics_sections(cohort_statistics(members), members)[0].tables[0]
        reasons.append({one[-1] for one in rows})
    assert reasons == [{"takes 15 people"}, {"covariates say the same of these people"}]
