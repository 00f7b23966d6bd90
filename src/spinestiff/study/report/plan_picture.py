"""A plan of further pushes as a picture: how much each single push narrows, and width against radiographs."""

from __future__ import annotations

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from spinestiff.study.report.figures import DEFAULT, FIT, MEASURED, STYLE
from spinestiff.study.wording.plan import TITLES, now_of, push_words, size_of
from spinestiff.subject.plan_outcome import Plan, PlannedView

COLOURS = {"left": MEASURED, "right": FIT}
MARKS = {"left": "o", "right": "s"}


def draw_plan(plan: Plan) -> Figure:
    """Left: the width with one more push, by rib. Right: the width with one push after the other."""
    with rc_context(STYLE):
        figure = Figure(figsize=(10.6, 4.6), layout="constrained")
        single, sequence = figure.subplots(1, 2, sharey=True, width_ratios=(1.0, 1.15))
        _draw_singles(single, plan)
        _draw_sequence(sequence, plan)
        unit = "± degrees" if plan.target == "cobb" else "factor either way"
        single.set_ylabel(f"{TITLES[plan.target]}, 95 %, {unit}")
        handles, labels = single.get_legend_handles_labels()
        more, names = sequence.get_legend_handles_labels()
        figure.legend([*handles, *more], [*labels, *names], loc="outside lower center", ncols=4)
    return figure


def _draw_singles(axis: Axes, plan: Plan) -> None:
    line: PlannedView = "frontal" if any(push.view == "frontal" for push in plan.next) else "frontal+lateral"
    largest = max((push.force_n for push in plan.next), default=0.0)
    for side in COLOURS:
        for force in sorted({push.force_n for push in plan.next}, reverse=True):
            mine = [p for p in plan.next if (p.side, p.force_n) == (side, force)]
            points = sorted((p.level, size_of(p)) for p in mine if p.view == line)
            if points:
                axis.plot(
                    *zip(*points),
                    color=COLOURS[side],
                    marker=MARKS[side],
                    markersize=5.5,
                    markerfacecolor=COLOURS[side] if force == largest else "white",
                    linestyle="-" if force == largest else ":",
                    label=f"{force:g} N from the {side}{_aside(line)}",
                )
    beside = [(p.level, size_of(p)) for p in plan.next if p.view != line]
    if beside:
        levels, sizes = zip(*beside)
        axis.scatter(levels, sizes, s=60, c="#222222", marker="+", linewidths=1.0, zorder=3, label="with a lateral one")
    _draw_now(axis, plan, "")
    axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    axis.set_xlabel("rib")
    axis.set_title("One more push", fontsize=11)


def _draw_sequence(axis: Axes, plan: Plan) -> None:
    steps = plan.sequence
    now = now_of(plan)
    points = [(step.exposures, size_of(step.push)) for step in steps]
    whole = points if now is None else [(0, now), *points]
    axis.plot(*zip(*whole), color="#444444", linewidth=1.4)
    pays = [point for step, point in zip(steps, points) if step.pays]
    rest = [point for step, point in zip(steps, points) if not step.pays]
    if pays:
        axis.plot(*zip(*pays), color="#1d6b3c", marker="o", linestyle="none", label="pays")
    if rest:
        axis.plot(*zip(*rest), color="#8A8A8A", marker="o", linestyle="none", label="hardly narrows")
    for step, (x, y) in zip(steps, points):
        words = push_words(step.push) + _aside(step.push.view)
        axis.annotate(words, (x, y), (3, 6), textcoords="offset points", fontsize=8.5, rotation=48.0)
    _draw_now(axis, plan, "with what was taken so far")
    axis.set_xlim(-0.3, (points[-1][0] if points else 1) * 1.3)
    axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    axis.set_xlabel("further radiographs, unloaded ones included")
    axis.set_title("One push after the other", fontsize=11)


def _aside(view: PlannedView) -> str:
    """What a label says of a view beside the frontal one."""
    return "" if view == "frontal" else " + lateral"


def _draw_now(axis: Axes, plan: Plan, label: str) -> None:
    now = now_of(plan)
    if now is not None:
        axis.axhline(now, color=DEFAULT, linestyle="--", linewidth=1.2, label=label or None)
