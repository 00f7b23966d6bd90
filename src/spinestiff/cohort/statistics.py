"""What a cohort says of people: stiffness against age, height, sex, Cobb angle and kind of curve (``hierarchy``).

Everything is computed in logs, so that effects are factors. A participant counts whose results are up to date, not
doubtful and without a population as a prior, and whose interval of that stiffness has two closed ends; of those with
one id, as visits of one person have, the first. What all estimates are wrong by in the same way, as a default of the
model may be, shifts all of them: no number here tells it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from spinestiff.arrays import Floats
from spinestiff.cohort.group import Member, stiffness_kinds
from spinestiff.cohort.hierarchy import Hierarchy, group_size, hierarchy
from spinestiff.cohort.row import Row, Stiffness
from spinestiff.errors import FitError
from spinestiff.study.wording.titles import PLAIN, TIMES_DEFAULT, TIMES_WHOLE

FEWEST = 5
"""People from which there are statistics of a stiffness."""
PEOPLE_A_COVARIATE = 5
"""From so many people for each coefficient all covariates are taken together."""
FACTORS = (1.25, 1.5, 2.0)
"""Differences for which the number of patients is told, unless one is asked for."""
POWER, LEVEL = 0.8, 0.05
_RELATIVE = {TIMES_DEFAULT: "relative to the default", TIMES_WHOLE: "relative to the whole"}


@dataclass(frozen=True)
class Covariate:
    """Something that people differ in.

    Attributes
    ----------
    name : in words, with what one step of it is. values : (n,) in steps, about their mean; of a kind 0 or 1.
    key : of what it is a value. kind : that the 1 stands for; None of a number.
    """

    name: str
    key: str
    values: tuple[float, ...]
    kind: str | None = None

    @property
    def told(self) -> bool:
        """Whether its effect is told: one person alone is no kind. That person's column says that the person is none of
        the usual kind either."""
        return self.kind is None or sum(self.values) > 1.0


@dataclass(frozen=True)
class Effect:
    """By which factor stiffness differs with one step of a covariate.

    Attributes
    ----------
    low, high : 95 % interval. p_value : of a factor as far from 1. p_adjusted : for all effects of this stiffness that
        are told together (Holm 1979).
    """

    name: str
    factor: float
    low: float
    high: float
    p_value: float
    p_adjusted: float


@dataclass(frozen=True)
class Shrunken:
    """A participant's stiffness by itself and given all others.

    Attributes
    ----------
    value, own_low, own_high : as estimated, with the estimate's own 95 % interval. sd_log : of its log.
    given_all, low, high : given all others, with the 95 % interval.
    weight : from 0 (only the others tell) to 1 (only its own radiographs do).
    """

    participant: str
    value: float
    own_low: float
    own_high: float
    sd_log: float
    given_all: float
    low: float
    high: float
    weight: float


@dataclass(frozen=True)
class Needed:
    """How many patients show a difference by ``factor`` with a power of 80 % at a level of 5 %; None: over 100,000.

    Attributes
    ----------
    a_group : in each of two groups of different people. a_group_low, a_group_high : by the interval of the standard
        deviation between people; None, too, where that can't be told. visited_twice : of one group before and after.
    visits_told : whether it is known how estimates scatter from visit to visit; if not, ``visited_twice`` is None.
    """

    factor: float
    a_group: int | None
    a_group_low: int | None
    a_group_high: int | None
    visited_twice: int | None
    visits_told: bool


@dataclass(frozen=True)
class StiffnessStatistics:
    """One stiffness in a cohort.

    Attributes
    ----------
    unit : of values. people : that count. left_out : participants that do not, with the reason.
    mean, mean_low, mean_high : typical (geometric mean), with the 95 % interval.
    between_sd_log, between_low, between_high : standard deviation of people's logs about it, without estimation errors;
        between_high None where the estimates scatter less than their intervals say, so that it can't be told.
    person_low, person_high : where 95 % of people are expected; None likewise.
    alone : of each covariate in a model of its own, with all of its kinds.
    together : in one model; empty with fewer people than that takes.
    shrunken : by participant, by the covariates of ``together`` or, where there are none, by the mean alone.
    """

    name: str
    unit: str
    people: int
    left_out: dict[str, str]
    mean: float
    mean_low: float
    mean_high: float
    between_sd_log: float
    between_low: float
    between_high: float | None
    person_low: float | None
    person_high: float | None
    alone: tuple[Effect, ...]
    together: tuple[Effect, ...]
    shrunken: tuple[Shrunken, ...]
    needed: tuple[Needed, ...]


def cohort_statistics(members: Sequence[Member], difference: float | None = None) -> tuple[StiffnessStatistics, ...]:
    """Statistics of each stiffness that enough participants have; none where there are too few.

    Parameters
    ----------
    difference : factor for which the number of patients is told; None: ``FACTORS``.
    """
    factors = FACTORS if difference is None else (difference,)
    found = (_of_stiffness(name, unit, members, factors) for name, unit in ordered_kinds(members))
    return tuple(one for one in found if one is not None)


def ordered_kinds(members: Sequence[Member]) -> tuple[tuple[str, str], ...]:
    """Names of stiffnesses with their units: those in plain units first, then ratios."""
    there = {kind for member in members for kind in stiffness_kinds(member)}
    plain = [(name, unit) for key in PLAIN for name, unit in sorted(there) if name == key]
    return (*plain, *sorted(there - set(plain)))


def counted_rows(name: str, unit: str, members: Sequence[Member]) -> tuple[list[tuple[Row, Stiffness]], dict[str, str]]:
    """Rows that count for a stiffness in a unit, and why the others do not, by participant."""
    counted: list[tuple[Row, Stiffness]] = []
    people: set[str] = set()
    left_out: dict[str, str] = {}
    for member in members:
        row = member.row
        found = None if row is None else row.stiffness.get(name)
        if row is None or member.state != "done":
            left_out[member.participant] = member.state
        elif row.status == "DOUBTFUL":
            left_out[member.participant] = "doubtful"
        elif row.population is not None:
            # The hierarchy draws estimates towards others: a prior would do so twice.
            left_out[member.participant] = f"with {row.population} as a prior"
        elif found is None:
            left_out[member.participant] = "not estimated"
        elif found.unit != unit:
            left_out[member.participant] = f"its ratio is {_RELATIVE[found.unit]} there"
        elif found.sd_log is None:
            left_out[member.participant] = "interval with an open end"
        elif row.id in people:
            # Estimates of one person share what is that person's own: they are no two people.
            left_out[member.participant] = "of a person who counts already (same id)"
        else:
            people.add(row.id)
            counted.append((row, found))
    return counted, left_out


def covariates(rows: Sequence[Row]) -> tuple[Covariate, ...]:
    """What these people differ in; what all have alike is left out."""
    numbers = {
        "age": ("age, a year more", 1.0, [row.age for row in rows]),
        "height": ("height, 10 cm more", 10.0, [row.height_cm for row in rows]),
        "cobb": ("Cobb angle, 10 degrees more", 10.0, [abs(row.cobb_deg) for row in rows]),
    }
    found = []
    for key, (name, step, values) in numbers.items():
        if np.ptp(values) > 0.0:
            found.append(Covariate(name, key, tuple(((np.array(values) - np.mean(values)) / step).tolist())))
    kinds: Mapping[str, list[str]] = {"sex": [row.sex for row in rows], "curve": [row.curve for row in rows]}
    for key, given in kinds.items():
        usual = most_frequent(given)
        own = [
            Covariate(f"{key}: {kind} against {usual}", key, tuple(float(one == kind) for one in given), kind)
            for kind in sorted(set(given) - {usual})
        ]
        found += own if any(one.told for one in own) else []
    return tuple(found)


def most_frequent(kinds: Sequence[str]) -> str:
    """The kind that most have, the first by name among equals."""
    counts = Counter(kinds)
    return min(counts, key=lambda kind: (-counts[kind], kind))


def design_of(columns: Sequence[Covariate], count: int) -> Floats:
    """(n, p) a column of ones and the covariates."""
    return np.column_stack([np.ones(count), *(np.array(one.values) for one in columns)])


def _of_stiffness(
    name: str, unit: str, members: Sequence[Member], factors: Sequence[float]
) -> StiffnessStatistics | None:
    counted, left_out = counted_rows(name, unit, members)
    if len(counted) < FEWEST:
        return None
    rows = [row for row, _ in counted]
    y = np.log([found.value for _, found in counted])
    sds = np.array([found.sd_log for _, found in counted], dtype=float)
    people = hierarchy(y, sds)
    columns = covariates(rows)
    alone = []
    for column in columns:
        # Kinds of one covariate together: each is told against the usual kind, not against all other people.
        own = [one for one in columns if one.key == column.key]
        if column.told:
            alone.append(_effect(column.name, hierarchy(y, sds, design_of(own, len(y))), 1 + own.index(column)))
    whole = _all_together(y, sds, columns)
    told = [(i, column) for i, column in enumerate(columns, 1) if column.told]
    together = [] if whole is None else [_effect(column.name, whole, i) for i, column in told]
    # By a column of their own the only ones of a kind would be given nobody else.
    given = people if whole is None else hierarchy(y, sds, design_of([column for _, column in told], len(y)))
    mean, error = people.at([1.0])
    reach = people.reach([1.0])
    return StiffnessStatistics(
        name=name,
        unit=unit,
        people=len(counted),
        left_out=left_out,
        mean=float(np.exp(mean)),
        mean_low=float(np.exp(mean - people.half_width * error)),
        mean_high=float(np.exp(mean + people.half_width * error)),
        between_sd_log=people.tau,
        between_low=people.tau_low,
        between_high=people.tau_high,
        person_low=None if people.tau_high is None else float(np.exp(mean - reach)),
        person_high=None if people.tau_high is None else float(np.exp(mean + reach)),
        alone=_holm(alone),
        together=_holm(together),
        shrunken=_shrunken(counted, sds, given),
        needed=tuple(_needed(factor, people, sds, [found for _, found in counted]) for factor in factors),
    )


def _all_together(y: Floats, sds: Floats, columns: Sequence[Covariate]) -> Hierarchy | None:
    told = sum(column.told for column in columns)
    if not told or len(y) < PEOPLE_A_COVARIATE * (1 + told):
        return None
    try:
        return hierarchy(y, sds, design_of(columns, len(y)))
    except FitError:  # covariates that say the same of these people
        return None


def _effect(name: str, found: Hierarchy, column: int) -> Effect:
    value, p_value = float(found.coefficients[column]), found.p_value(column)
    reach = found.half_width * float(np.sqrt(found.covariance[column, column]))
    return Effect(name, float(np.exp(value)), float(np.exp(value - reach)), float(np.exp(value + reach)), p_value, 1.0)


def _holm(effects: Sequence[Effect]) -> tuple[Effect, ...]:
    adjusted, least = {}, 0.0
    for rank, effect in enumerate(sorted(effects, key=lambda one: one.p_value)):
        least = max(least, min((len(effects) - rank) * effect.p_value, 1.0))
        adjusted[effect.name] = least
    return tuple(Effect(one.name, one.factor, one.low, one.high, one.p_value, adjusted[one.name]) for one in effects)


def _shrunken(counted: Sequence[tuple[Row, Stiffness]], sds: Floats, found: Hierarchy) -> tuple[Shrunken, ...]:
    reach = found.half_width * found.sds
    given = zip(sds, np.exp(found.means), np.exp(found.means - reach), np.exp(found.means + reach), found.weights)
    return tuple(
        Shrunken(row.participant, own.value, own.low or own.value, own.high or own.value, *map(float, values))
        for (row, own), values in zip(counted, given, strict=True)
    )


def _needed(factor: float, people: Hierarchy, sds: Floats, found: Sequence[Stiffness]) -> Needed:
    difference = float(np.log(factor))

    def a_group(tau: float) -> int | None:
        # As uncertain estimates weigh less, a person counts by the mean of the information.
        sd = float(np.sqrt(1.0 / np.mean(1.0 / (tau**2 + sds**2))))
        return group_size(difference, sd, power=POWER, level=LEVEL)

    visits = [one.visit_sd_log for one in found if one.visit_sd_log is not None]
    twice = None
    if visits:
        scatter = float(np.sqrt(2.0 * np.mean(np.square(visits))))
        twice = group_size(difference, scatter, paired=True, power=POWER, level=LEVEL)
    if people.tau_high is None:
        return Needed(factor, a_group(people.tau), None, None, twice, bool(visits))
    low, high = a_group(people.tau_low), a_group(people.tau_high)
    return Needed(factor, a_group(people.tau), low, high, twice, bool(visits))
