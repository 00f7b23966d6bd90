"""How repeatable estimates are: visits, or annotators, of the same people, and whether a person has changed.

x = log ratio of a visit. Within a person estimates scatter by what is anew at each visit, or in each annotation of the
same radiographs (``estimation.budget.repeated_sds``); what the model lacks of this person stays the same. From n_i
estimates of person i the within-subject standard deviation is

    s_w^2 = sum_i sum_j (x_ij - mean_i)^2 / sum_i (n_i - 1),

and two estimates of one unchanged person differ by less than 1.96 sqrt(2) s_w in 95 %, the smallest detectable change
(Bland and Altman 1996; here of a log, so that it is a factor).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.stats import chi2, norm

from spinestiff.errors import SubjectError
from spinestiff.study.visit import Visit
from spinestiff.study.wording import number
from spinestiff.subject.outcome_parts import Determination
from spinestiff.subject.outcomes import Estimate
from spinestiff.subject.run_record import read_outcome
from spinestiff.words import counted

TWO_SIDED = float(norm.ppf(0.975))
# Scatter that is as likely as this, or less, is not what the estimates' own errors let expect.
UNLIKELY = 0.01
Verdict = Literal["changed", "no change shown", "can't be told"]


@dataclass(frozen=True)
class VisitRatio:
    """A ratio at one visit.

    Attributes
    ----------
    value : the estimate. sd_log : of its log from visit to visit (annotation to annotation), as the visit itself tells.
    determined : how far its radiographs determine it. doubtful : the result can't be right.
    """

    value: float
    sd_log: float
    determined: Determination
    doubtful: bool


@dataclass(frozen=True)
class VisitEstimate:
    """An estimate of a visit; ``label`` : of the visit, ``subject`` : whose it is."""

    label: str
    subject: str
    ratios: Mapping[str, VisitRatio]


@dataclass(frozen=True)
class Scatter:
    """How a ratio scatters within people.

    Attributes
    ----------
    within_sd_log : s_w. low, high : its 95 % interval. degrees : of freedom.
    expected_sd_log : root mean square of what the visits tell.
    detectable_factor, expected_factor : smallest detectable change, found and expected.
    p_value : of scatter at least as far from what is expected, either way.
    """

    within_sd_log: float
    low: float
    high: float
    degrees: int
    expected_sd_log: float
    detectable_factor: float
    expected_factor: float
    p_value: float


@dataclass(frozen=True)
class Change:
    """A ratio at a visit over that at the first one of the same person.

    Attributes
    ----------
    factor : the one over the other. low, high : its 95 % interval.
    detectable_factor : a change by less would not show.
    """

    subject: str
    name: str
    first: str
    visit: str
    factor: float
    low: float
    high: float
    detectable_factor: float
    verdict: Verdict


@dataclass(frozen=True)
class Repeatability:
    """Of ``visits``: ``scatter`` by ratio, and ``changes`` of each later visit over the first."""

    scatter: Mapping[str, Scatter]
    changes: tuple[Change, ...]
    visits: tuple[VisitEstimate, ...]


def estimate_of(visit: Visit, annotators: bool = False) -> VisitEstimate:
    """What a visit's estimate says; ``annotators`` : of the same radiographs annotated again.

    Raises
    ------
    SubjectError : there is none, or it is by the paper's method, or of an earlier version, which tell no scatter.
    """
    estimate = read_outcome(visit.subject, Estimate)
    sds = estimate.annotation_sd_log if annotators else estimate.visit_sd_log
    if not sds:
        raise SubjectError(
            f"{visit.file(Estimate.FILE)}: does not say how it would scatter from visit to visit; run spinestiff "
            "estimate --redo with --method weighed"
        )
    doubtful = estimate.status == "DOUBTFUL"
    ratios = {
        name: VisitRatio(ratio.value, sds[name], ratio.determined, doubtful) for name, ratio in estimate.ratios.items()
    }
    return VisitEstimate(visit.subject.folder.name, visit.subject.record.id, ratios)


def repeatability(visits: Sequence[VisitEstimate]) -> Repeatability:
    """Scatter and changes of visits, in the order in which they were made.

    Raises
    ------
    SubjectError : no person has two visits, or visits are of different ratios.
    """
    names = tuple(visits[0].ratios) if visits else ()
    for visit in visits:
        if tuple(visit.ratios) != names:
            raise SubjectError(
                f"{visit.label}: has ratios {', '.join(visit.ratios)}, {visits[0].label} has {', '.join(names)}; "
                "estimate the same ones"
            )
    by_subject: dict[str, list[VisitEstimate]] = {}
    for visit in visits:
        by_subject.setdefault(visit.subject, []).append(visit)
    repeated = [found for found in by_subject.values() if len(found) > 1]
    if not repeated:
        raise SubjectError(
            f"{counted(len(visits), 'visit')} of as many subjects; repeatability needs two or more of one (the id in "
            "subject.json says whose a visit is)"
        )
    scatter = {name: _scatter([[visit.ratios[name] for visit in found] for found in repeated]) for name in names}
    changes = [_change(name, found[0], later) for found in repeated for later in found[1:] for name in names]
    return Repeatability(scatter, tuple(changes), tuple(visits))


def _scatter(people: Sequence[Sequence[VisitRatio]]) -> Scatter:
    logs = [np.log([ratio.value for ratio in person]) for person in people]
    squares = float(sum(np.sum((x - x.mean()) ** 2) for x in logs))
    degrees = sum(len(x) - 1 for x in logs)
    expected = float(np.sqrt(np.mean([ratio.sd_log**2 for person in people for ratio in person])))
    within = float(np.sqrt(squares / degrees))
    below = float(chi2.cdf(squares / expected**2, degrees)) if expected > 0.0 else float("nan")
    return Scatter(
        within,
        float(np.sqrt(squares / chi2.ppf(0.975, degrees))),
        float(np.sqrt(squares / chi2.ppf(0.025, degrees))),
        degrees,
        expected,
        float(np.exp(TWO_SIDED * np.sqrt(2.0) * within)),
        float(np.exp(TWO_SIDED * np.sqrt(2.0) * expected)),
        2.0 * min(below, 1.0 - below),
    )


def _change(name: str, first: VisitEstimate, later: VisitEstimate) -> Change:
    before, after = first.ratios[name], later.ratios[name]
    log = float(np.log(after.value / before.value))
    reach = TWO_SIDED * float(np.hypot(before.sd_log, after.sd_log))
    verdict: Verdict = "changed" if abs(log) > reach else "no change shown"
    if any(one.doubtful or one.determined == "not determined" for one in (before, after)):
        verdict = "can't be told"
    ends = float(np.exp(log - reach)), float(np.exp(log + reach))
    return Change(
        first.subject, name, first.label, later.label, float(np.exp(log)), *ends, float(np.exp(reach)), verdict
    )


def repeatability_lines(found: Repeatability) -> list[str]:
    """What it says, in sentences."""
    lines = []
    for name, one in found.scatter.items():
        lines.append(
            f"{name}: two estimates of one unchanged person differ by less than a factor of "
            f"{number(one.detectable_factor)} (95 %, from {counted(one.degrees, 'repetition')}); the estimates' own "
            f"errors let expect {number(one.expected_factor)}"
        )
        if one.p_value < UNLIKELY:
            more = "more" if one.within_sd_log > one.expected_sd_log else "less"
            lines.append(
                f"{name}: estimates scatter {more} than their own errors let expect (p {one.p_value:.2g}): sd of the "
                f"log {number(one.within_sd_log, 2)} against {number(one.expected_sd_log, 2)}"
            )
    lines += [change_words(change) for change in found.changes]
    return lines


def change_words(change: Change) -> str:
    """Whether a ratio changed between two visits."""
    what = f"{change.subject}, {change.name}, {change.first} to {change.visit}"
    interval = f"{number(change.low, 2)} to {number(change.high, 2)}"
    if change.verdict == "changed":
        way = "stiffer" if change.factor > 1.0 else "softer"
        return f"{what}: changed, {way} by a factor of {number(max(change.factor, 1.0 / change.factor))} ({interval})"
    if change.verdict == "can't be told":
        return f"{what}: can't be told; an estimate is doubtful, or its radiographs do not determine the ratio"
    return (
        f"{what}: no change shown ({interval} times as stiff); one by less than a factor of "
        f"{number(change.detectable_factor)} would not show"
    )
