"""Pictures of the curve under a push: change of the Cobb angle against force, change of tilt along the spine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from spinestiff.arrays import Floats
from spinestiff.study.report.figures import DEFAULT, FIT, MEASURED, STYLE


@dataclass(frozen=True)
class CurveChange:
    """Change of curve against force in one push.

    Attributes
    ----------
    push : its name.
    measured : role -> (n, 3) force N, change of the Cobb angle and half its 95 % interval, degrees.
    simulated : "default" and "fit" -> (n, 2), with rising force.
    """

    push: str
    measured: Mapping[str, Floats]
    simulated: Mapping[str, Floats]


@dataclass(frozen=True)
class TiltChange:
    """Change of tilt of each vertebra under one force, degrees.

    Attributes
    ----------
    title : which push, frame and force.
    vertebrae : (n,) head to foot.
    measured : (n,).
    simulated : "default" and "fit" -> (n,).
    level : row where the push acts, between vertebrae in fractions; None if outside.
    """

    title: str
    vertebrae: tuple[str, ...]
    measured: Floats
    simulated: Mapping[str, Floats]
    level: float | None = None


_LINES: dict[str, dict[str, Any]] = {
    "default": {"color": DEFAULT, "linestyle": (0, (5, 2)), "linewidth": 1.8, "label": "default stiffness"},
    "fit": {"color": FIT, "linestyle": "-", "linewidth": 2.2, "label": "estimated stiffness"},
}
_POINTS: dict[str, Any] = {
    "linestyle": "none",
    "markersize": 7.5,
    "markeredgecolor": MEASURED,
    "markeredgewidth": 1.4,
    "zorder": 4,
    "clip_on": False,
}
_ROLES: dict[str, dict[str, Any]] = {
    "training": {"marker": "o", "markerfacecolor": MEASURED, "label": "measured, training"},
    "validation": {"marker": "D", "markerfacecolor": "#9CD3F2", "label": "measured, held out"},
    "unused": {"marker": "o", "markerfacecolor": "white", "label": "measured, not used"},
}


def draw_curve_changes(changes: Sequence[CurveChange]) -> Figure:
    """Change of the Cobb angle against force: measured points, default and fitted curves, one panel a push."""
    with rc_context(STYLE):
        figure = Figure(figsize=(max(4.6 * len(changes), 6.4), 4.3), layout="constrained")
        axes = figure.subplots(1, len(changes), squeeze=False, sharey=True)[0]
        handles: dict[str, Any] = {}
        for axis, change in zip(axes, changes):
            for name, style in _LINES.items():
                if name in change.simulated:
                    handles[name] = axis.plot(*change.simulated[name].T, **style)[0]
            for role, style in _ROLES.items():
                points = change.measured.get(role)
                if points is not None and len(points):
                    axis.errorbar(*points.T, fmt="none", ecolor=MEASURED, elinewidth=1.2, zorder=3)
                    handles[role] = axis.plot(*points[:, :2].T, **_POINTS, **style)[0]
            axis.axhline(0.0, color="#999999", linewidth=0.9, zorder=1)
            axis.set_title(f"Push “{change.push}”", fontsize=11)
            axis.set_xlabel("force, N")
            axis.margins(x=0.06)
            axis.set_xlim(left=0.0)
        axes[0].set_ylabel("change of Cobb angle (tilt form), degrees\n← right-convex      left-convex →")
        order = [key for key in ("training", "validation", "unused", "fit", "default") if key in handles]
        figure.legend(handles=[handles[key] for key in order], loc="outside lower center", ncols=3)
    return figure


def draw_tilt_changes(changes: Sequence[TiltChange], columns: int = 4) -> Figure:
    """Change of tilt by level: measured, default and fit, one panel a frame."""
    columns = min(columns, len(changes))
    rows = -(-len(changes) // columns)
    with rc_context(STYLE):
        figure = Figure(figsize=(max(3.0 * columns, 5.0), 4.9 * rows + 0.5), layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False, sharex=True)
        handles: list[Any] = []
        for axis in grid.ravel()[len(changes) :]:
            axis.set_visible(False)
        for axis, change in zip(grid.ravel(), changes):
            level = np.arange(len(change.vertebrae))
            handles = []
            if change.level is not None:
                axis.axhline(change.level, color="#BBBBBB", linewidth=7, alpha=0.45, zorder=1)
            handles += axis.plot(
                change.measured, level, "o:", color=MEASURED, markersize=5.0, linewidth=1.0, zorder=4, label="measured"
            )
            for name in ("fit", "default"):
                if name in change.simulated:
                    handles += axis.plot(change.simulated[name], level, **_LINES[name])
            axis.axvline(0.0, color="#999999", linewidth=0.9, zorder=1)
            axis.set_yticks(level, change.vertebrae, fontsize=8.5)
            axis.set_ylim(len(level) - 0.5, -0.5)
            axis.xaxis.set_major_locator(MaxNLocator(5))
            axis.set_title(change.title, fontsize=10)
            axis.set_xlabel("change of tilt, degrees")
            axis.tick_params(labelbottom=True)
        figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure
