"""What repeated estimates say of scatter and change, in sentences."""

from __future__ import annotations

from spinestiff.study.repeatability import UNLIKELY, Change, Repeatability, Repeated
from spinestiff.study.wording.numbers import number
from spinestiff.words import counted


def repeatability_lines(found: Repeatability) -> list[str]:
    """What it says, in sentences."""
    what = "visit" if found.of == "visits" else "annotation"
    lines = [
        f"{one.label}: compared with nothing: no other {what} has its id {one.subject!r}; where it is the same "
        "person's, give both one id in subject.json"
        for one in found.alone
    ]
    who = "of one unchanged person" if found.of == "visits" else "from two annotations of the same radiographs"
    for name, one in found.scatter.items():
        lines.append(
            f"{name}: two estimates {who} differ by less than a factor of {number(one.detectable_factor)} (95 %, from "
            f"{counted(one.degrees, 'repetition')}); the estimates' own errors let expect {number(one.expected_factor)}"
            if one.degrees > 1
            else f"{name}: one repetition tells nothing of how far two estimates {who} differ; their own errors "
            f"let expect less than a factor of {number(one.expected_factor)} (95 %)"
        )
        if one.left_out:
            lines.append(
                f"{name}: {counted(one.left_out, 'estimate')} left out: doubtful, not determined, or not pushed alike"
            )
        if one.p_value < UNLIKELY:
            more = "more" if one.standardised > 1.0 else "less"
            lines.append(
                f"{name}: estimates scatter {more} than their own errors let expect (p {one.p_value:.2g}): "
                f"{number(one.standardised, 2)} times as far, each by its own error"
            )
    lines += [change_words(change, found.of) for change in found.changes]
    held = dict.fromkeys(name for visit in found.visits for name in visit.held)
    if held and found.of == "visits":
        lines.append(
            f"note: the fits held of the ratios: {', '.join(held)}. That pulls the estimates of all visits the same "
            "way: a change comes out smaller than it is, one of a single level is spread over its neighbours, and the "
            "intervals of changes do not allow for it"
        )
    return lines


def change_words(change: Change, of: Repeated = "visits") -> str:
    """Whether a ratio changed between two visits, or two annotations disagree."""
    what = f"{change.subject}, {change.name}, {change.first} to {change.visit}"
    if not change.alike:
        what += " (not pushed alike)"
    if change.verdict == "can't be told" or change.low is None or change.high is None:
        return f"{what}: can't be told; an estimate is doubtful, or its radiographs do not determine the ratio"
    ends = (change.factor, change.low, change.high)
    factor, low, high = ends if change.factor >= 1.0 else (1.0 / ends[0], 1.0 / ends[2], 1.0 / ends[1])
    size = f"a factor of {number(factor)} ({_beside_one(low)} to {_beside_one(high)})"
    if of == "annotators":
        found = "disagree by more than annotation explains" if change.verdict == "changed" else "agree"
        return f"{what}: annotations {found}, {size}"
    if change.verdict == "changed":
        return f"{what}: changed, {'stiffer' if change.factor > 1.0 else 'softer'} by {size}"
    return (
        f"{what}: no change shown ({_beside_one(change.low)} to {_beside_one(change.high)} times as stiff); one by "
        f"less than a factor of {number(change.detectable_factor)} would not show"
    )


def _beside_one(factor: float) -> str:
    """With two digits, and with as many more as it takes to say on which side of 1 it lies."""
    texts = (number(factor, digits) for digits in range(2, 7))
    return next((text for text in texts if float(text) != 1.0), number(factor, 2))
