"""Repeated estimates as a picture: a panel a ratio, visits side by side, person after person."""

from __future__ import annotations

from collections.abc import Mapping
from textwrap import fill

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from spinestiff.study.repeatability import TWO_SIDED, Repeatability, Repeated
from spinestiff.study.report.figures import FIT, MEASURED, STYLE, plain_ticks

MOST_NAMED = 24  # visits that are named on the axis
TITLES: Mapping[Repeated, str] = {
    "visits": "Bars: 95 % by what is new at each visit; squares: changed; hollow: not known",
    "annotators": "Bars: 95 % by annotation alone; squares: disagree; hollow: not known",
}
LETTERS_AN_INCH = 10  # of the title, the axis' labels beside it taken off


def draw_repeatability(found: Repeatability) -> Figure:
    """Estimates with their 95 % interval by what is anew at each visit, or in each annotation, alone, and what changed;
    no interval of one that is not known. Two such estimates are off by both their errors."""
    visits = sorted(found.visits, key=lambda visit: [other.subject for other in found.visits].index(visit.subject))
    subjects = list(dict.fromkeys(visit.subject for visit in visits))
    places = np.arange(len(visits)) + 0.8 * np.array([subjects.index(visit.subject) for visit in visits])
    told = found.scatter.keys() | {change.name for change in found.changes if change.verdict != "can't be told"}
    names = tuple(name for name in visits[0].ratios if name in told) or tuple(visits[0].ratios)
    changed = {(change.name, change.visit) for change in found.changes if change.verdict == "changed"}
    with rc_context(STYLE):
        size = (min(3.2 + 0.42 * len(visits), 14.0), 2.9 * len(names) + 0.9)
        figure = Figure(figsize=size, layout="constrained")
        axes = figure.subplots(len(names), 1, squeeze=False, sharex=True)[:, 0]
        for axis, name in zip(axes, names):
            for place, visit in zip(places, visits):
                ratio = visit.ratios[name]
                moved = (name, visit.label) in changed
                colour = FIT if moved else MEASURED
                if ratio.known:
                    down, up = (np.exp(TWO_SIDED * ratio.sd_on(upper)) for upper in (False, True))
                    axis.plot([place, place], [ratio.value / down, ratio.value * up], color=colour, lw=1.6)
                face = colour if ratio.known else "none"
                axis.plot(place, ratio.value, color=colour, marker="s" if moved else "o", mfc=face, ms=6)
            axis.set_yscale("log")
            plain_ticks(axis, "y")
            axis.set_ylabel(f"ratio, {name}")
            axis.grid(visible=False, axis="x")
        if len(visits) <= MOST_NAMED:
            axes[-1].set_xticks(places, [visit.label for visit in visits], rotation=40, ha="right", fontsize=8.5)
        else:
            axes[-1].set_xticks([])
            axes[-1].set_xlabel(f"{len(visits)} visits of {len(subjects)} people")
        axes[0].set_title(fill(TITLES[found.of], int(LETTERS_AN_INCH * size[0])), fontsize=10)
    return figure
