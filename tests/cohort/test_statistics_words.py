"""A cohort's statistics in words."""

from __future__ import annotations

from cohort_runners import row
from spinestiff.cohort.group import Member
from spinestiff.cohort.row import Stiffness
from spinestiff.cohort.statistics import cohort_statistics
from spinestiff.cohort.statistics_words import statistics_lines, statistics_sections


def people(logs, sd, **changes):
    """Participants by the logs of their stiffness over 0.1."""
    members = []
    for number, log in enumerate(logs, 1):
        name, value = f"sub-{number:03d}", 0.1 * 2.0**log
        stiffness = Stiffness(value=value, unit="", low=value / 2, high=value * 2, sd_log=sd)
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
