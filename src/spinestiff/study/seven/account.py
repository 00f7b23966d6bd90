"""Which program found the outcomes of a study, on which day, and how long it took."""

from __future__ import annotations

import heapq
from collections.abc import Sequence

from spinestiff.study.paper import SUBJECTS
from spinestiff.study.seven.goals import Goal
from spinestiff.study.wording.numbers import fixed, listed
from spinestiff.subject.study_outcome import SubjectOutcome
from spinestiff.words import counted

AIM_MINUTES, CORES = 20.0, 2
"""In which the seven are to be found on so many cores."""
MAKE = "make"
TIMED = (MAKE, "track", "personalise", "estimate", "assess", "tables")
"""What of a subject is timed, in order."""
NO_DAY = "day not noted"


def found_by(outcomes: Sequence[SubjectOutcome], present: str) -> str:
    """By which programs and on which days the outcomes were found, and whether that is the present one.

    Parameters
    ----------
    present : ``subject.program.program_of_numbers`` of whoever tells this.
    """
    groups: dict[str, list[SubjectOutcome]] = {}
    for one in outcomes:
        groups.setdefault(one.program, []).append(one)
    if not groups:
        return "Nothing was found yet."
    told = [f"`{program}` ({_who(group)}; {_days(group)})" for program, group in groups.items()]
    words = f"The numbers were found by program {listed(told)}."
    if len(groups) > 1:
        words = f"The subjects were found by differing programs, which may estimate differently. {words}"
    if set(groups) != {present}:
        words += (
            f" The page was written by program `{present}`, which may find other numbers: run without `--page-only`, "
            "the command finds anew what another program found."
        )
    return words


def _who(group: Sequence[SubjectOutcome]) -> str:
    return counted(len(group), "subject") if len(group) >= len(SUBJECTS) else listed(one.name for one in group)


def _days(group: Sequence[SubjectOutcome]) -> str:
    return listed(dict.fromkeys(one.date or NO_DAY for one in group))


def elapsed_minutes(seconds: Sequence[float], workers: int = CORES) -> float:
    """Minutes that pieces of work take, so many at a time on a processor each, the next when one ends; of nothing 0."""
    free = [0.0] * workers
    for one in seconds:
        heapq.heapreplace(free, free[0] + one)
    return max(free) / 60.0


def time_goal(first: Sequence[SubjectOutcome]) -> Goal:
    """That of the seven's time. Without the seconds of making a subject it can be missed and not met."""
    name, wanted = f"time of the seven on {CORES} processors, a subject on each", f"≤ {AIM_MINUTES:g} min"
    if not first:
        return Goal(name, wanted, "nothing to judge by", None)
    minutes, known = elapsed_minutes([_whole(one) for one in first]), not _made_before(first)
    met = minutes <= AIM_MINUTES
    found = f"{'' if known else 'at least '}{fixed(minutes, 0)} min"
    return Goal(name, wanted, found, met if known or not met else None)


def cost_rows(outcomes: Sequence[SubjectOutcome]) -> list[list[str]]:
    """A row a subject: name, day, CPU seconds by step (``TIMED``) and together; the last row has the sums."""
    rows = [[one.name, one.date or "–", *_cells([one])] for one in outcomes]
    return [*rows, ["sum", "", *_cells(outcomes)]]


def _cells(outcomes: Sequence[SubjectOutcome]) -> list[str]:
    by_step = [[one.cpu_seconds[step] for one in outcomes if step in one.cpu_seconds] for step in TIMED]
    return [*(f"{sum(values):,.0f}" if values else "–" for values in by_step), f"{sum(map(_whole, outcomes)):,.0f}"]


def cost_words(first: Sequence[SubjectOutcome]) -> str:
    """The seven's time in sum and against the aim."""
    goal = time_goal(first)
    # Those that are not there would take their time, too.
    met = None if goal.met and len(first) < len(SUBJECTS) else goal.met
    words = (
        f"The aim is {AIM_MINUTES:g} minutes for the seven on {CORES} cores. These {counted(len(first), 'subject')} "
        f"take {sum(map(_whole, first)):,.0f} CPU s in sum; {CORES} at a time on a processor each, in this order, the "
        f"next when one ends, that is {goal.found}. {_VERDICTS[met]}."
    )
    before = _made_before(first)
    if before:
        words += (
            f" Radiographs of {listed(before)} were made by an earlier run than the one that ended them; how long that "
            "took is not known, so that the true sum is larger."
        )
    return words


_VERDICTS = {True: "The aim is met", False: "**The aim is not met**", None: "Whether the aim is met is not known"}


def _made_before(outcomes: Sequence[SubjectOutcome]) -> list[str]:
    return [one.name for one in outcomes if MAKE not in one.cpu_seconds]


def _whole(one: SubjectOutcome) -> float:
    return sum(one.cpu_seconds.values())
