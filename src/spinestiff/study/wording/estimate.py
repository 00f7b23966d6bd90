"""An estimate in words: what is known, how well, and what leaves it uncertain."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from spinestiff.anatomy.regions import AT
from spinestiff.study.wording.numbers import NO_INTERVALS, SURE, factor95, fixed, listed, number, span_in_words
from spinestiff.study.wording.titles import (
    IN_PLAIN_UNITS,
    PLAIN,
    UNMEASURABLE,
    ratio_unit,
    stiffness_title,
    within_a_sentence,
)
from spinestiff.subject.estimate_outcome import BudgetRecord, CombinationRecord, Estimate, PriorChangeRecord
from spinestiff.subject.outcome_parts import Determination, Quantity

MOST_TOLD = 2
"""Ratios of which the uncertainty is told in a terminal."""
LEAST_EXPONENT = 0.1
"""Of a ratio in a combination that is worth its name."""
LIKELY_MISTAKES = (
    "forces_n (newtons, one for each frame, in the frames' order), side and level of each push, the corners and names "
    "of the vertebrae (spinestiff annotate shows them), pictures of another patient or visit"
)
"""What to look at where no estimate is found, in the order in which it was the reason."""


def headline(estimate: Estimate) -> list[str]:
    """What was found, in plain units and words, a line a stiffness that was estimated."""
    return [
        f"{within_a_sentence(stiffness_title(name))}: {span_in_words(found, unit, determined)}"
        for name, found, unit, determined in told_stiffness(estimate)
    ]


def told_stiffness(estimate: Estimate) -> list[tuple[str, Quantity, str, Determination | None]]:
    """What is told of an estimate first: name in ``plain``, or of a ratio that is no part of one; value with interval,
    unit, and how far the data determine it."""
    lines: list[tuple[str, Quantity, str, Determination | None]] = [
        (key, found, found.unit, determined_of(estimate, found.ratio))
        for key, found in ((key, estimate.plain[key]) for key in PLAIN)
        if found.ratio is not None or found.low is not None
    ]
    told = {found.ratio for found in estimate.plain.values()}
    # Of ratios that scale a stiffness together, what they make is told.
    together = {
        stem
        for key, found in estimate.plain.items()
        if found.ratio is None and found.low is not None
        for stem in IN_PLAIN_UNITS[key]
    }
    alone = [name for name in estimate.parameters if name not in told and name.partition(AT)[0] not in together]
    return lines + [
        (name, estimate.ratios[name], ratio_unit(name, estimate.parameters), determined_of(estimate, name))
        for name in alone
    ]


def determined_of(estimate: Estimate, name: str | None) -> Determination | None:
    """How far the data determine a ratio; None without one."""
    return None if name is None else estimate.ratios[name].determined


def no_estimate(search: str, wrong: Sequence[str]) -> str:
    """Why there is no estimate, the user's likely mistakes first.

    Parameters
    ----------
    search : how the search ended.
    wrong : what the checks of the inputs found wrong, a text for each.
    """
    if wrong:
        found = f"the inputs do not agree: {'; '.join(wrong)}; then look at {LIKELY_MISTAKES}"
    else:
        found = f"no stiffness explains how this spine moved under these forces; look at {LIKELY_MISTAKES}"
    return f"no estimate: {found}; if all of these are right, the search itself: {search}"


def badge(estimate: Estimate) -> str:
    """The word or two that stand above a result: doubtful, or how far it is determined, if its method tells."""
    return known_word(estimate, estimate.determined)


def known_word(estimate: Estimate, determined: Determination) -> str:
    """The word or two for a stiffness that is ``determined`` so far: doubtful as the whole result is, if it is, and no
    intervals by a method that has none."""
    if estimate.status == "DOUBTFUL":
        return "doubtful"
    return determined if has_intervals(estimate) else NO_INTERVALS


def has_intervals(estimate: Estimate) -> bool:
    """Whether the estimate's method gives intervals."""
    return estimate.method != "paper"


def most_costly(estimate: Estimate, ratio: str, measurable: bool = False) -> BudgetRecord | None:
    """The unknown without which a ratio would be known best; None where knowing none helps or there is no budget."""
    rows = [row for row in estimate.budget if not (measurable and row.name in UNMEASURABLE)]
    best = min(rows, key=lambda row: row.without[ratio], default=None)
    return best if best is not None and best.without[ratio] < estimate.sd_log[ratio] else None


LINEAR = "intervals: to first order at the estimate, as there are too many ratios for a profile of each"


def held_lines(estimate: Estimate) -> list[str]:
    """How intervals of many ratios were found, what was held of ratios before the fit, and what the data say alone."""
    lines = [LINEAR] if estimate.intervals == "linear" else []
    lines += [f"held before the fit, no data: {name}: {text}" for name, text in estimate.held.items()]
    if estimate.data_sd_log:
        least, most = (pick(estimate.data_sd_log.items(), key=lambda item: item[1]) for pick in (min, max))
        told = [f"{name} within a factor of {factor95(sd)}" for name, sd in dict.fromkeys((least, most))]
        lines.append(f"the radiographs without it (95 %, to first order): {listed(told)}")
    return lines


def best_known_text(found: CombinationRecord, title: Callable[[str], str] = str) -> str:
    """The combination of ratios that is known best, "bending^0.4 × tissue = 0.014 within a factor of 1.12"."""
    powers = []
    for name, exponent in found.exponents.items():
        if abs(exponent) >= LEAST_EXPONENT:
            words = title(name)
            words = f"({words})" if " " in words else words
            powers.append(words if round(exponent, 2) == 1.0 else f"{words}^{fixed(exponent, 2)}")
    less = "" if len(powers) == len(found.exponents) else f" (powers below {LEAST_EXPONENT:g} not shown)"
    digits = 3 if found.sd_log < SURE else 2
    return f"{' × '.join(powers)} = {number(found.value, digits)} within a factor of {factor95(found.sd_log)}{less}"


def combination_lines(estimate: Estimate) -> list[str]:
    """The combination of ratios that the data fix best, a line; none where a single ratio is known as well."""
    if estimate.best_known is None:
        return []
    return [f"known best, a combination (95 %, to first order): {best_known_text(estimate.best_known)}"]


def least_known(estimate: Estimate) -> list[str]:
    """The two ratios that are known least, the least first; none without a variance budget."""
    return sorted(estimate.sd_log, key=lambda name: -estimate.sd_log[name])[:MOST_TOLD]


def factor_lines(estimate: Estimate) -> list[str]:
    """How well the ratios that are known least are known, with all unknowns and with tracking's errors alone."""
    return [
        f"{name}: known within a factor of {factor95(estimate.sd_log[name])} (95 %, to first order), of "
        f"{factor95(estimate.sd_log_tracking[name])} if tracking's errors were the only ones"
        for name in least_known(estimate)
    ]


def costly_unknowns(estimate: Estimate) -> list[BudgetRecord]:
    """The variance budget's unknowns by the largest share of a least known ratio's variance that they cost, by
    themselves or beside all others, the largest first."""

    def cost(row: BudgetRecord) -> float:
        return max(
            max(row.alone[name] ** 2 - estimate.sd_log_tracking[name] ** 2, sd**2 - row.without[name] ** 2) / sd**2
            for name, sd in ((name, estimate.sd_log[name]) for name in least_known(estimate))
        )

    return sorted(estimate.budget, key=cost, reverse=True)


def moved_sd(estimate: Estimate, change: PriorChangeRecord) -> float:
    """By how many of its standard deviations another prior moves a ratio's log, the most of any ratio."""
    return max(
        abs(math.log(change.ratios[name] / value)) / estimate.sd_log[name] for name, value in estimate.values.items()
    )


def strongest_priors(estimate: Estimate) -> list[PriorChangeRecord]:
    """Priors halved and doubled by how far they move a ratio or change its standard deviation, the most first."""

    def effect(change: PriorChangeRecord) -> float:
        widened = (abs(change.sd_log[name] / sd - 1.0) for name, sd in estimate.sd_log.items())
        return max(moved_sd(estimate, change), *widened)

    return sorted(estimate.prior_changes, key=effect, reverse=True)


def halved_or_doubled(change: PriorChangeRecord) -> str:
    """What was done to a prior's standard deviation, in a word."""
    return "halved" if change.factor < 1.0 else "doubled"


def pelvis_lines(estimate: Estimate) -> list[str]:
    """How far the pelvis turned in the training frames, a line; none where it was held level."""
    turns = [place.obliquity_deg for place in estimate.supports]
    if not any(turns):
        return []
    return [f"pelvis in the training frames: turned by {fixed(min(turns))}° to {fixed(max(turns), 1)}°"]
