"""A cohort's statistics as a picture: people by themselves and given all others, and over what they differ in."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from spinestiff.cohort.group import Member
from spinestiff.cohort.hierarchy import hierarchy
from spinestiff.cohort.row import Row
from spinestiff.cohort.statistics import Shrunken, StiffnessStatistics, counted_rows
from spinestiff.study.report.figures import FIT, MEASURED, STYLE, plain_ticks

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_NAMED = 45
FARTHEST_LOG = 2.2  # of an interval's end from its estimate, as far as the picture shows it
_GREY = "#9AA3AD"
_AXES = (("age", "age, years"), ("height", "height, cm"), ("cobb", "Cobb angle, degrees"), ("sex", ""), ("curve", ""))


def draw_statistics(found: Sequence[StiffnessStatistics], members: Sequence[Member], titles: Sequence[str]) -> Figure:
    """The picture; ``titles`` of the stiffnesses with their units."""
    with rc_context(STYLE):
        figure = Figure(figsize=(19.0, 4.4 * len(found) + 0.5), layout="constrained")
        grid = figure.subplots(len(found), 1 + len(_AXES), squeeze=False, width_ratios=[1.9, 1, 1, 1, 0.7, 1.1])
        for axes, one, title in zip(grid, found, titles):
            rows = {row.participant: row for row, _ in counted_rows(one.name, one.unit, members)[0]}
            limits = _limits(one)
            _people(axes[0], one, title)
            for axis, (key, name) in zip(axes[1:], _AXES):
                _against(axis, one, rows, key)
                axis.set_xlabel(name)
            for axis in axes:
                axis.set_yscale("log")
                axis.set_ylim(*limits)
                plain_ticks(axis, "y")
        marks = [
            Line2D([], [], color=_GREY, marker="o", lw=1.4, label="by its own radiographs, 95 %"),
            Line2D([], [], color=FIT, marker="D", lw=0, label="given all others"),
            Line2D([], [], color=MEASURED, lw=2.0, label="people on average, 95 %"),
        ]
        grid[0][0].legend(handles=marks, loc="upper left", fontsize=8.5)
    return figure


def _limits(found: StiffnessStatistics) -> tuple[float, float]:
    """Of the axis: all estimates and their intervals, those that are hardly known cut."""
    values, lows, highs = np.log([(one.value, one.own_low, one.own_high) for one in found.shrunken]).T
    low = float(np.maximum(lows, values - FARTHEST_LOG).min()) - 0.1
    high = float(np.minimum(highs, values + FARTHEST_LOG).max()) + 0.1
    return float(np.exp(low)), float(np.exp(high + 0.12 * (high - low)))


def _people(axis: Axes, found: StiffnessStatistics, title: str) -> None:
    """Everybody in the order of what is known of them given all others."""
    ordered = sorted(found.shrunken, key=lambda one: one.given_all)
    places = np.arange(len(ordered))
    if found.person_low is not None and found.person_high is not None:
        axis.axhspan(found.person_low, found.person_high, color=MEASURED, alpha=0.07, lw=0)
    axis.axhspan(found.mean_low, found.mean_high, color=MEASURED, alpha=0.18, lw=0)
    axis.axhline(found.mean, color=MEASURED, lw=1.6)
    _both(axis, places, ordered)
    axis.set_ylabel(title)
    axis.set_xlim(-0.8, len(ordered) - 0.2)
    axis.grid(visible=False, axis="x")
    if len(ordered) <= MOST_NAMED:
        axis.set_xticks(
            places, [one.participant for one in ordered], rotation=90, fontsize=min(7.5, 315.0 / len(ordered))
        )
    else:
        axis.set_xticks([])
        axis.set_xlabel(f"{len(ordered)} participants")


def _both(axis: Axes, places: Sequence[float] | np.ndarray, people: Sequence[Shrunken]) -> None:
    """Estimates with their intervals, and where all others draw them."""
    value, given = np.array([one.value for one in people]), np.array([one.given_all for one in people])
    size = 4.0 if len(people) <= MOST_NAMED else 2.2
    axis.vlines(
        places, [one.own_low for one in people], [one.own_high for one in people], color=_GREY, lw=size / 4.0, zorder=2
    )
    axis.vlines(places, value, given, color=FIT, lw=size / 4.0, zorder=3)
    axis.plot(places, value, "o", color=_GREY, ms=size, zorder=3)
    axis.plot(places, given, "D", color=FIT, ms=0.9 * size, zorder=4)


def _against(axis: Axes, found: StiffnessStatistics, rows: dict[str, Row], key: str) -> None:
    """Everybody over a covariate, with the regression on it alone."""
    people = [rows[one.participant] for one in found.shrunken]
    y = np.log([one.value for one in found.shrunken])
    sds = np.array([one.sd_log for one in found.shrunken])
    if key in ("sex", "curve"):
        _by_kind(axis, found.shrunken, [row.sex if key == "sex" else row.curve for row in people], y, sds)
        return
    numbers = {"age": [row.age for row in people], "height": [row.height_cm for row in people],
               "cobb": [abs(row.cobb_deg) for row in people]}  # fmt: skip
    x = np.array(numbers[key])
    _both(axis, x, found.shrunken)
    if np.ptp(x) == 0.0:
        return
    middle = x.mean()
    line = hierarchy(y, sds, np.column_stack([np.ones(len(x)), x - middle]))
    ends = np.linspace(x.min(), x.max(), 60)
    at = [line.at([1.0, place - middle]) for place in ends]
    mean, reach = np.array([one for one, _ in at]), line.half_width * np.array([error for _, error in at])
    axis.plot(ends, np.exp(mean), color=MEASURED, lw=2.0, zorder=5)
    axis.fill_between(ends, np.exp(mean - reach), np.exp(mean + reach), color=MEASURED, alpha=0.18, lw=0)


def _by_kind(axis: Axes, people: Sequence[Shrunken], given: Sequence[str], y: np.ndarray, sds: np.ndarray) -> None:
    kinds = sorted(set(given))
    for number, kind in enumerate(kinds):
        mine = [i for i, one in enumerate(given) if one == kind]
        spread = np.linspace(-0.3, 0.3, len(mine)) if len(mine) > 1 else np.zeros(1)
        _both(axis, number + spread, [people[i] for i in mine])
        if len(mine) > 2:
            mean = hierarchy(y[mine], sds[mine])
            middle, error = mean.at([1.0])
            low, high = np.exp(middle - mean.half_width * error), np.exp(middle + mean.half_width * error)
            axis.fill_between([number - 0.4, number + 0.4], low, high, color=MEASURED, alpha=0.18, lw=0)
            axis.plot([number - 0.4, number + 0.4], [np.exp(middle)] * 2, color=MEASURED, lw=2.0, zorder=5)
    axis.set_xlim(-0.6, len(kinds) - 0.4)
    names = [f"{_broken(kind)}\n({given.count(kind)})" for kind in kinds]
    axis.set_xticks(range(len(kinds)), names, fontsize=8)
    axis.grid(visible=False, axis="x")


def _broken(kind: str) -> str:
    """On lines as short as there is room for."""
    parts = kind.replace("thoracolumbar/", "thoraco-\nlumbar/\n")
    return parts.replace("proximal ", "proximal\n").replace("main ", "main\n")
