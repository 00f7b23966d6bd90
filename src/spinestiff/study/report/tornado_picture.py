"""Refits of an estimate as a picture: a row for what was changed, a panel a ratio, bars for how its stiffness moves."""

from __future__ import annotations

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from spinestiff.study.report.figures import DEFAULT, FIT, MEASURED, STYLE
from spinestiff.study.wording.numbers import fixed
from spinestiff.study.wording.sensitivity import change_title, tornado_rows
from spinestiff.subject.sensitivity_outcome import Refit, Sensitivity

MOST_PANELS = 4
HALF = 0.36  # height of a row's bars together, over the distance of rows: half of it
SAME = 0.05  # percent that are told as none
ROOM = 0.36  # for a bar's label, over what all bars span
COLOURS = {"−": MEASURED, "+": FIT}


def draw_tornado(found: Sensitivity) -> Figure:
    """Rows with the largest change first; of many ratios the first four."""
    rows = tornado_rows(found)
    names = found.parameters[:MOST_PANELS]
    with rc_context(STYLE):
        size = (2.2 + 4.2 * len(names), 1.2 + 0.62 * max(len(rows), 1))
        figure = Figure(figsize=size, layout="constrained")
        axes = figure.subplots(1, len(names), squeeze=False, sharex=True, sharey=True)[0]
        ends = [one.stiffness_percent[name] for _, own in rows for one in own for name in names]
        low, high = min([*ends, -1.0]), max([*ends, 1.0])
        for axis, name in zip(axes, names):
            for place, (_, refits) in enumerate(rows):
                _draw_row(axis, place, refits, name)
            axis.axvline(0.0, color="#444444", linewidth=1.0)
            axis.set_xlim(low - ROOM * (high - low), high + ROOM * (high - low))
            axis.grid(visible=False, axis="y")
            axis.set_title(name.replace("_", " "), fontsize=11)
            axis.set_xlabel("change of the stiffness, %")
        axes[0].set_yticks(np.arange(len(rows)), [title for title, _ in rows])
        axes[0].set_ylim(len(rows) - 0.4, -0.6)
    return figure


def _draw_row(axis: Axes, place: int, refits: tuple[Refit, ...], name: str) -> None:
    shown = [one for one in refits if name in one.stiffness_percent]
    height = 2.0 * HALF / max(len(shown), 1)
    for i, one in enumerate(shown):
        value = one.stiffness_percent[name]
        middle = place - HALF + (i + 0.5) * height
        by = change_title(one)
        colour = COLOURS.get(by[:1], DEFAULT)
        axis.barh(middle, value, height=0.92 * height, color=colour)
        text = f"{by}: {fixed(value, 1, True)}" if by else fixed(value, 1, True)
        left = value < -SAME
        axis.annotate(
            text,
            (value, middle),
            (-4 if left else 4, 0),
            textcoords="offset points",
            ha="right" if left else "left",
            va="center",
            fontsize=8.5,
        )
