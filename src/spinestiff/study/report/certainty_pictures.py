"""Pictures of how sure a result is: likelihood along each ratio and of both, unknowns' costs, supports."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from spinestiff.arrays import Floats
from spinestiff.study.report.figures import DEFAULT, FIT, MEASURED, STYLE, TRUTH, plain_ticks

HIGHEST = 2.5  # of what is drawn of a profile, in rises of an interval's end


@dataclass(frozen=True)
class ProfileCurve:
    """The likelihood along a ratio.

    Attributes
    ----------
    title : of the ratio, in words.
    curve : (n, 2) ratio and rise of the negative log likelihood.
    limit : the rise at which a 95 % interval ends. ends : of the interval.
    estimate, truth : ratios; None = not known. to : what they are ratios to.
    """

    title: str
    curve: Floats
    limit: float
    ends: tuple[float | None, float | None]
    estimate: float
    truth: float | None = None
    to: str = "the default"


@dataclass(frozen=True)
class SupportPlace:
    """Where pelvis or shoulder was in a frame, degrees or mm.

    Attributes
    ----------
    value : as fitted along or, if ``predicted``, as expected. before : sd of what was known, about 0.
    seen : as tracked, with its standard deviation; None = not seen.
    """

    value: float
    before: float
    seen: tuple[float, float] | None
    predicted: bool


@dataclass(frozen=True)
class RatioMap:
    """What is known about two ratios.

    Attributes
    ----------
    names : (2,) as shown on the axes.
    estimate : (2,).
    region : (n, 2) edge of the 95 % joint region; empty = not available.
    path : (n, 2) accepted steps from the start to the estimate.
    bounds : what the fit was allowed; the axes end there.
    intervals : (2,) ends of each ratio's 95 % interval; None = none was found.
    truth : (2,) true ratios, where known.
    """

    names: tuple[str, str]
    estimate: Floats
    region: Floats
    path: Floats
    bounds: tuple[float, float]
    intervals: tuple[tuple[float | None, float | None], ...] = ()
    truth: Floats | None = None


@dataclass(frozen=True)
class BudgetBars:
    """What unknowns do to the variance of ratios.

    Attributes
    ----------
    unknowns : (n,) in words, the most costly first.
    shares : ratio, in words -> (n, 2) shares of its variance: what the unknown adds alone, what knowing it takes away.
    """

    unknowns: tuple[str, ...]
    shares: Mapping[str, Floats]


def draw_profiles(profiles: Sequence[ProfileCurve]) -> Figure:
    """A panel a ratio: how much less likely other values are, and where the interval ends."""
    with rc_context(STYLE):
        figure = Figure(figsize=(0.8 + 4.2 * len(profiles), 3.7), layout="constrained")
        for axis, profile in zip(figure.subplots(1, len(profiles), squeeze=False)[0], profiles):
            _draw_profile(axis, profile)
        figure.axes[0].set_ylabel("less likely by (negative log likelihood)")
        handles, labels = figure.axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure


def _draw_profile(axis: Axes, profile: ProfileCurve) -> None:
    ratio, rise = profile.curve.T
    low, high = (edge if end is None else end for end, edge in zip(profile.ends, (ratio[0], ratio[-1])))
    inside = np.sort(np.concatenate([ratio[(ratio > low) & (ratio < high)], [low, high]]))
    height = np.interp(np.log(inside), np.log(ratio), rise)
    axis.fill_between(inside, 0.0, height, color=FIT, alpha=0.18, linewidth=0, label="95 % interval")
    axis.plot(ratio, rise, color=FIT, linewidth=2.2, label="profile")
    axis.axhline(profile.limit, color="#444444", linestyle=(0, (5, 2)), linewidth=1.2, label="the interval ends here")
    axis.plot(profile.estimate, 0.0, "o", color=FIT, markersize=8, clip_on=False, zorder=5)
    top = HIGHEST * profile.limit
    shown = ratio[rise <= top]
    if profile.truth is not None:
        # One that is less likely than what is drawn lies on the upper edge.
        true_height = min(float(np.interp(np.log(profile.truth), np.log(ratio), rise)), top)
        shown = np.array([min(shown[0], profile.truth), max(shown[-1], profile.truth)])
        axis.plot(profile.truth, true_height, "*", color=TRUTH, markersize=13, zorder=6, clip_on=False, label="truth")
    axis.set_xscale("log")
    axis.set_xlim(0.9 * shown[0], 1.1 * shown[-1])
    axis.set_ylim(0.0, top)
    plain_ticks(axis, "x")
    axis.set_title(profile.title, fontsize=11)
    axis.set_xlabel(f"ratio to {profile.to}")


def draw_support_places(frames: Sequence[str], places: Mapping[str, Sequence[SupportPlace]]) -> Figure:
    """A panel each for pelvis and shoulder, a row a frame.

    Parameters
    ----------
    frames : (n,) in words. places : what is shown, with its unit -> (n,).
    """
    rows = np.arange(len(frames))
    with rc_context(STYLE):
        figure = Figure(figsize=(2.6 + 3.7 * len(places), 1.5 + 0.42 * len(rows)), layout="constrained")
        axes = figure.subplots(1, len(places), squeeze=False, sharey=True)[0]
        for axis, (title, found) in zip(axes, places.items()):
            before = np.array([place.before for place in found])
            axis.barh(rows, 2.0 * before, 0.62, left=-before, color="#DDDDDD", zorder=1)
            for row, place in zip(rows, found):
                face = "white" if place.predicted else FIT
                axis.plot(place.value, row + 0.12, "o", color=FIT, markerfacecolor=face, markersize=8, zorder=4)
                if place.seen is not None:
                    value, sd = place.seen
                    axis.errorbar(
                        value, row - 0.16, xerr=sd, fmt="s", color=MEASURED, markersize=5, capsize=3, zorder=3
                    )
            axis.axvline(0.0, color="#999999", linewidth=0.9)
            axis.set_xlabel(title)
            axis.set_ylim(len(rows) - 0.4, -0.6)
            axis.grid(visible=False, axis="y")
        axes[0].set_yticks(rows, frames)
        figure.legend(handles=_support_handles(), loc="outside lower center", ncols=2)
    return figure


def _support_handles() -> list[Line2D]:
    return [
        Line2D([], [], color=FIT, marker="o", markersize=8, linestyle="none", label="fitted along (training)"),
        Line2D(
            [], [], color=FIT, marker="o", markerfacecolor="white", markersize=8, linestyle="none",
            label="predicted (held out)",
        ),
        Line2D([], [], color=MEASURED, marker="s", markersize=5, linestyle="none", label="tracked, ± one sd"),
        Line2D([], [], color="#DDDDDD", linewidth=8, label="known before, ± one sd"),
    ]  # fmt: skip


def draw_budget(bars: BudgetBars) -> Figure:
    """Two bars an unknown, one panel a ratio."""
    count, rows = len(bars.shares), np.arange(len(bars.unknowns))
    with rc_context(STYLE):
        figure = Figure(figsize=(2.9 + 3.4 * count, 1.4 + 0.42 * len(rows)), layout="constrained")
        axes = figure.subplots(1, count, squeeze=False, sharey=True)[0]
        handles: list[Any] = []
        for axis, (title, shares) in zip(axes, bars.shares.items()):
            handles = [
                axis.barh(
                    rows - 0.19, 100.0 * shares[:, 0], 0.36, color="#A9A9A9", label="adds where all else is known"
                ),
                axis.barh(rows + 0.19, 100.0 * shares[:, 1], 0.36, color=FIT, label="would go away if it were known"),
            ]
            axis.set_title(title, fontsize=11)
            axis.set_xlabel("percent of the variance")
            axis.set_xlim(0.0, max(1.05 * axis.get_xlim()[1], 5.0))
            axis.set_ylim(len(rows) - 0.5, -0.5)
            axis.grid(visible=False, axis="y")
        axes[0].set_yticks(rows, bars.unknowns)
        figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


def draw_ratio_map(ratios: RatioMap) -> Figure:
    """The 95 % joint region of two ratios on logarithmic axes, and the way the fit took there."""
    with rc_context(STYLE):
        figure = Figure(figsize=(8.4, 4.3), layout="constrained")
        whole, near = figure.subplots(1, 2)
        for axis in (whole, near):
            _draw_region(axis, ratios)
            axis.set_xscale("log")
            axis.set_yscale("log")
            axis.set_xlabel(f"ratio, {ratios.names[0]}")
        whole.set_ylabel(f"ratio, {ratios.names[1]}")
        whole.plot(*ratios.path.T, color="#444444", linewidth=1.2, marker=".", markersize=6, label="accepted steps")
        whole.plot(1.0, 1.0, marker="s", markersize=7, color=DEFAULT, linestyle="none", label="default (1, 1)")
        whole.set_title("Steps of the fit", fontsize=11)
        near.set_title("95 % joint region" if len(ratios.region) else "The estimate", fontsize=11)
        points = [ratios.estimate[None], *([ratios.region] if len(ratios.region) else [])]
        points += [] if ratios.truth is None else [ratios.truth[None]]
        _zoom(near, np.vstack(points), ratios.bounds)
        _zoom(whole, np.vstack([*points, ratios.path, np.ones((1, 2))]), ratios.bounds)
        for axis in (whole, near):
            for which in "xy":
                plain_ticks(axis, which)
        handles, labels = whole.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3)
    return figure


def _draw_region(axis: Axes, ratios: RatioMap) -> None:
    if len(ratios.region):
        axis.fill(*ratios.region.T, facecolor=FIT, alpha=0.18, linewidth=0)
        axis.plot(*np.vstack([ratios.region, ratios.region[:1]]).T, color=FIT, linewidth=1.6, label="95 % joint region")
    for which, (low, high) in enumerate(ratios.intervals):
        if low is not None and high is not None:
            bar = np.tile(ratios.estimate[:, None], 2)
            bar[which] = low, high
            label = "95 % interval of each" if which == 0 else None
            mark = "|" if which == 0 else "_"
            axis.plot(*bar, color=FIT, linewidth=2.2, marker=mark, markersize=12, label=label, zorder=4)
    axis.plot(*ratios.estimate, marker="o", markersize=8, color=FIT, linestyle="none", label="estimate", zorder=5)
    if ratios.truth is not None:
        axis.plot(*ratios.truth, marker="*", markersize=13, color=TRUTH, linestyle="none", label="truth", zorder=6)


def _zoom(axis: Axes, points: Floats, bounds: tuple[float, float]) -> None:
    # A region may run far out of what the fit was allowed; nobody needs to see where it ends.
    points = np.log(np.clip(points, *bounds))
    low, high = points.min(0), points.max(0)
    # At least a factor of 1.3 to each side of the middle, so that a tiny region is seen as tiny.
    middle, half = 0.5 * (low + high), np.maximum(0.62 * (high - low), np.log(1.3))
    limits = np.clip(np.exp([middle - half, middle + half]), *bounds)
    axis.set_xlim(*limits[:, 0])
    axis.set_ylim(*limits[:, 1])
