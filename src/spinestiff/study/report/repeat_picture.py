"""Repeated estimates as a picture: a panel a ratio, visits side by side, person after person."""

from __future__ import annotations

from textwrap import fill

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from spinestiff.study.repeatability import TWO_SIDED, Repeatability
from spinestiff.study.report.figures import FIT, MEASURED, STYLE, plain_ticks

MOST_NAMED = 24  # visits that are named on the axis
TITLE = "Bars: where 95 % of estimates of an unchanged person lie; squares: changed"
LETTERS_AN_INCH = 10  # of the title, the axis' labels beside it taken off


def draw_repeatability(found: Repeatability) -> Figure:
    """Estimates with the range in which those of an unchanged person lie, and what changed."""
    visits = sorted(found.visits, key=lambda visit: [other.subject for other in found.visits].index(visit.subject))
    subjects = list(dict.fromkeys(visit.subject for visit in visits))
    places = np.arange(len(visits)) + 0.8 * np.array([subjects.index(visit.subject) for visit in visits])
    changed = {(change.name, change.visit) for change in found.changes if change.verdict == "changed"}
    with rc_context(STYLE):
        size = (min(3.2 + 0.42 * len(visits), 14.0), 2.9 * len(found.scatter) + 0.9)
        figure = Figure(figsize=size, layout="constrained")
        axes = figure.subplots(len(found.scatter), 1, squeeze=False, sharex=True)[:, 0]
        for axis, name in zip(axes, found.scatter):
            for place, visit in zip(places, visits):
                ratio = visit.ratios[name]
                down, up = (np.exp(TWO_SIDED * ratio.sd_on(upper)) for upper in (False, True))
                moved = (name, visit.label) in changed
                axis.plot(
                    [place, place], [ratio.value / down, ratio.value * up], color=FIT if moved else MEASURED, lw=1.6
                )
                axis.plot(place, ratio.value, color=FIT if moved else MEASURED, marker="s" if moved else "o", ms=6)
            axis.set_yscale("log")
            plain_ticks(axis, "y")
            axis.set_ylabel(f"ratio, {name}")
            axis.grid(visible=False, axis="x")
        if len(visits) <= MOST_NAMED:
            axes[-1].set_xticks(places, [visit.label for visit in visits], rotation=40, ha="right", fontsize=8.5)
        else:
            axes[-1].set_xticks([])
            axes[-1].set_xlabel(f"{len(visits)} visits of {len(subjects)} people")
        axes[0].set_title(fill(TITLE, int(LETTERS_AN_INCH * size[0])), fontsize=10)
    return figure
