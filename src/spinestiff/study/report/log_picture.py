"""A gauge's log beside the radiographs of its push: force and motion of the picture against time, frames marked."""

from __future__ import annotations

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from spinestiff.arrays import Floats
from spinestiff.study.report.figures import FIT, MEASURED, STYLE
from spinestiff.subject.intake.force_log import ForceLog
from spinestiff.subject.intake.log_match import LogMatch

MARGIN_S = 2.0
"""Of the log, shown before and after the frames."""


def draw_log(name: str, log: ForceLog, match: LogMatch, times_s: Floats, motion: Floats) -> Figure:
    """Force above, motion below. Without an offset each has its own time.

    Parameters
    ----------
    name : of the push. times_s, motion : (F,) of its frames.
    """
    placed = bool(np.isfinite(match.offset_s)) and (match.determined or match.given)
    with rc_context(STYLE):
        figure = Figure(figsize=(9.0, 5.4), layout="constrained")
        force, moved = figure.subplots(2, 1, sharex=placed, height_ratios=(1.3, 1.0))
        force.plot(log.times_s, log.forces_n, color="#444444", linewidth=1.1, label="the gauge's log")
        shown = times_s + match.offset_s if placed else times_s
        if placed:
            at, open_still = match.forces_n.copy(), list(match.uncertain)
            at[open_still] = 0.5 * (match.forces_low_n + match.forces_high_n)[open_still]
            spread = np.stack([at - match.forces_low_n, match.forces_high_n - at])
            force.errorbar(
                shown, at, yerr=np.maximum(spread, 0.0), fmt="o", color=FIT, markersize=4.5, capsize=2.5,
                linewidth=1.0, label="force of each frame, with what the offset leaves open",
            )  # fmt: skip
            for axis in (force, moved):
                for time in shown:
                    axis.axvline(time, color="#BBBBBB", linewidth=0.5, zorder=0)
            low, high = min(log.times_s[0], shown[0]), max(log.times_s[-1], shown[-1])
            force.set_xlim(max(low, shown[0] - MARGIN_S) - 0.1, min(high, shown[-1] + MARGIN_S) + 0.1)
        moved.plot(shown, motion, color=MEASURED, marker="o", markersize=4.5, linewidth=1.0)
        for index, (x, y) in enumerate(zip(shown, motion)):
            if len(shown) <= 24 or index % 5 == 0:
                moved.annotate(str(index), (x, y), (0, 6), textcoords="offset points", fontsize=8, ha="center")
        force.set_ylabel("force, N")
        moved.set_ylabel("motion since frame 0, px")
        moved.set_xlabel("time of the log, s" if placed else "time since frame 0, s")
        if not placed:
            force.set_xlabel("time of the log, s")
        moved.margins(y=0.18)
        figure.legend(*force.get_legend_handles_labels(), loc="outside lower center", ncols=2)
        figure.suptitle(f"{name}: {_title(match, placed)}", fontsize=11)
    return figure


def _title(match: LogMatch, placed: bool) -> str:
    if not placed:
        return "the log's time at frame 0 is not determined"
    if match.given:
        return f"frame 0 at {match.offset_s:.2f} s of the log, as given"
    return f"frame 0 at {match.offset_s:.2f} s of the log (95 %: {match.low_s:.2f} to {match.high_s:.2f} s)"
