"""A cohort's statistics in words and tables, for its page and for the terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from spinestiff.cohort.group import Member
from spinestiff.cohort.page import Section
from spinestiff.cohort.statistics import FEWEST, PEOPLE_A_COVARIATE, Effect, Needed, StiffnessStatistics
from spinestiff.study.report.figures import as_png
from spinestiff.study.wording.numbers import number
from spinestiff.study.wording.titles import PLAIN
from spinestiff.words import counted

SHOWN = 4
"""Stiffnesses in the picture at most."""


def title_of(found: StiffnessStatistics) -> str:
    """A stiffness with its unit."""
    name = PLAIN.get(found.name, f"ratio {found.name}")
    return f"{name}, {found.unit}"


def statistics_lines(found: Sequence[StiffnessStatistics]) -> list[str]:
    """What there is to say, a line a stiffness and a line for each effect that shows."""
    if not found:
        wanted = (
            "of different id, up to date and not doubtful, whose stiffness has a closed interval and no population as "
            "a prior"
        )
        return [f"no statistics: they take {FEWEST} participants or more {wanted}"]
    lines = []
    for one in found:
        lines.append(f"{title_of(one)}: {_typical(one)}")
        lines += [f"  {effect.name}: {_effect_words(effect)}" for effect in _told(one) if effect.p_adjusted < 0.05]
    return lines


def statistics_sections(found: Sequence[StiffnessStatistics], members: Sequence[Member]) -> list[Section]:
    """Sections of the page: people and covariates with the picture, and how many patients a difference takes."""
    if not found:
        return [Section("Statistics", (f"{statistics_lines(found)[0].capitalize()}.",))]
    from spinestiff.cohort.picture import draw_statistics

    shown = _unlike([one for one in found if one.name in PLAIN] or found)[:SHOWN]
    picture = as_png(draw_statistics(shown, members, [_short(one) for one in shown]))
    words = (
        "Left: everybody by its own radiographs and given all others; shaded, where the mean (dark) and 95 % of people "
        "(light) are expected. Right: the same people over what they differ in, with the regression on that alone."
    )
    sentences = [f"{title_of(one)}: {_typical(one)}." for one in found]
    sentences += [_left_out(one) for one in found if one.left_out]
    header = ("", "factor", "95 %", "p", "p, adjusted", "together with all others")
    tables = [(f"Effects on {title_of(one)}", header, _effect_rows(one)) for one in shown if one.alone]
    return [
        Section("People and what they differ in", tuple(sentences), tuple(tables), picture, words),
        Section("How many patients", (_POWER,), tuple(map(_power_table, shown))),
    ]


_POWER = (
    "Patients that show a difference in stiffness by a factor with a power of 80 % at a level of 5 % (two-sided t-test "
    "of logs): in each of two groups of different people, where a person counts the less the wider the own interval "
    "is, as in the effects (a test that counts all alike takes more), and of one group visited before and after "
    "something changed everybody's stiffness by that factor, where all count alike. In parentheses, by the 95 % "
    "interval of the spread between people."
)


def _unlike(found: Sequence[StiffnessStatistics]) -> list[StiffnessStatistics]:
    """Of stiffnesses that one ratio scales, whose statistics are the same but for the unit, the first."""
    first: dict[tuple[str, ...], StiffnessStatistics] = {}
    for one in found:
        first.setdefault(tuple(f"{person.participant} {person.sd_log:.6g}" for person in one.shrunken), one)
    return list(first.values())


def _short(one: StiffnessStatistics) -> str:
    return (
        title_of(one).replace("lateral bending of a ", "bending, ").replace("Young's modulus of the trunk's soft ", "")
    )


def _typical(one: StiffnessStatistics) -> str:
    mean = (
        f"{counted(one.people, 'person', 'people')}, typically {number(one.mean)} ({number(one.mean_low)} to "
        f"{number(one.mean_high)})"
    )
    if one.between_high is None or one.person_low is None or one.person_high is None:
        return f"{mean}; intervals are wider than the scatter; the spread between people can't be told"
    between = f"{number(one.between_sd_log, 2)} ({number(one.between_low, 2)} to {number(one.between_high, 2)})"
    span = f"95 % of people between {number(one.person_low, 2)} and {number(one.person_high, 2)}"
    return f"{mean}, {span}; spread between people, sd of the log, {between}"


def _left_out(one: StiffnessStatistics) -> str:
    reasons = Counter(one.left_out.values())
    told = ", ".join(f"{count} {why}" for why, count in sorted(reasons.items()))
    return f"Left out of {title_of(one)}: {told}."


def _told(one: StiffnessStatistics) -> Sequence[Effect]:
    return one.together or one.alone


def _effect_words(effect: Effect) -> str:
    return (
        f"× {number(effect.factor)} ({number(effect.low)} to {number(effect.high)}), p {_p(effect.p_adjusted)} adjusted"
    )


def _effect_rows(one: StiffnessStatistics) -> tuple[tuple[str, ...], ...]:
    together = {effect.name: effect for effect in one.together}
    wanted = PEOPLE_A_COVARIATE * (1 + len(one.alone))
    missing = f"takes {wanted} people" if one.people < wanted else "covariates say the same of these people"
    return tuple(
        (
            effect.name,
            f"× {number(effect.factor)}",
            f"{number(effect.low)} to {number(effect.high)}",
            _p(effect.p_value),
            _p(effect.p_adjusted),
            _effect_words(together[effect.name]) if effect.name in together else missing,
        )
        for effect in one.alone
    )


def _power_table(one: StiffnessStatistics) -> tuple[str, tuple[str, ...], tuple[tuple[str, ...], ...]]:
    header = ("difference", "patients in each of two groups", "patients visited twice")
    return title_of(one), header, tuple(_needed_row(found, one.between_high is not None) for found in one.needed)


def _needed_row(found: Needed, spread_told: bool) -> tuple[str, ...]:
    twice = _count(found.visited_twice) if found.visits_told else "not known"
    if not spread_told:
        return f"× {number(found.factor)}", f"{_count(found.a_group)}, by intervals alone", twice
    span = f"{_count(found.a_group_low)} to {_count(found.a_group_high)}"
    return f"× {number(found.factor)}", f"{_count(found.a_group)} ({span})", twice


def _count(value: int | None) -> str:
    return "over 100000" if value is None else str(value)


def _p(value: float) -> str:
    return "< 0.001" if value < 0.001 else f"{value:.2g}"
