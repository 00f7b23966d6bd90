"""Pictures of a subject's results: spines over radiographs, curves, the joint region of the ratios.

Every function returns a Matplotlib figure that belongs to no window; ``as_png`` and ``as_svg`` turn it into bytes that
are the same for the same figure. Colours (Okabe and Ito's, told apart with any colour vision) mean the same everywhere:
blue is measured, orange is the fit, grey is the default. Marks and line styles differ too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from spinestiff.arrays import Floats, read_only
from spinestiff.errors import SpinestiffError
from spinestiff.imaging.features import FEATURE_SHAPE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INK = "#18202A"
MEASURED, FIT, DEFAULT, TRUTH = "#0072B2", "#D55E00", "#6E6E6E", INK
# The same hues, lighter, over the dark of a radiograph.
MEASURED_ON_DARK, SIMULATED_ON_DARK, WHITE_ON_DARK = "#56C1FF", "#FFA530", "#FEFEFE"
PNG_DPI = 130
PANEL_HEIGHT = 7.0  # inches
NARROWEST_CROP_MM = 150.0
MARGIN_MM = 18.0
PERCENTILES = (1.0, 99.7)  # of the crop's grey values, black to white
SCALE_BAR_MM = 50.0
LABEL_GAP = 0.04  # inches between tick labels
NO_POINTS = read_only("points", np.zeros((0, 2)), (None, 2), SpinestiffError)
STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 10.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "text.color": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.edgecolor": "#444444",
    "axes.grid": True,
    "grid.color": "#E3E3E3",
    "grid.linewidth": 0.8,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "svg.fonttype": "path",
    "svg.hashsalt": "spinestiff",
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
}


@dataclass(frozen=True)
class Panel:
    """One simulated spine over the radiograph.

    Attributes
    ----------
    title : e.g. "Estimated stiffness".
    boxes : (n, 4, 2) pixels (column, row), the simulated boxes of the measured vertebrae.
    rmse_mm : corner RMSE at the patient plane; None = no prediction.
    pedicles : (p, 2) pixels, simulated.
    """

    title: str
    boxes: Floats
    rmse_mm: float | None
    pedicles: Floats = field(default_factory=lambda: NO_POINTS)

    def __post_init__(self) -> None:
        object.__setattr__(self, "boxes", read_only("boxes", self.boxes, (None, *FEATURE_SHAPE), SpinestiffError))
        object.__setattr__(self, "pedicles", read_only("pedicles", self.pedicles, (None, 2), SpinestiffError))


@dataclass(frozen=True)
class Overlay:
    """A radiograph with measured boxes, to be drawn once for each panel.

    Attributes
    ----------
    pixels : (H, W) grey values, bone bright.
    vertebrae : (n,) names, head to foot.
    measured : (n, 4, 2) pixels (column, row).
    panels : what is drawn over it.
    mm_per_pixel : at the patient plane, along columns and rows.
    sides : letters at the picture's left and right edge, e.g. ("R", "L") or ("P", "A").
    arrow : pushed height (row), direction along columns (+1 or -1) and text; None = no push.
    pedicles : (p, 2) pixels, measured; each panel has as many.
    """

    pixels: np.ndarray
    vertebrae: tuple[str, ...]
    measured: Floats
    panels: tuple[Panel, ...]
    mm_per_pixel: tuple[float, float]
    sides: tuple[str, str]
    arrow: tuple[float, float, str] | None = None
    pedicles: Floats = field(default_factory=lambda: NO_POINTS)

    def __post_init__(self) -> None:
        shape = (len(self.vertebrae), *FEATURE_SHAPE)
        object.__setattr__(self, "measured", read_only("measured", self.measured, shape, SpinestiffError))
        pedicles = read_only("pedicles", self.pedicles, (None, 2), SpinestiffError)
        object.__setattr__(self, "pedicles", pedicles)
        for panel in self.panels:
            if panel.boxes.shape != shape:
                raise SpinestiffError(f"panel '{panel.title}' has {len(panel.boxes)} boxes, wanted {shape[0]}")
            if panel.pedicles.shape != pedicles.shape:
                found, wanted = len(panel.pedicles), len(pedicles)
                raise SpinestiffError(f"panel '{panel.title}' has {found} pedicles, wanted {wanted}")

    @property
    def crop(self) -> tuple[int, int, int, int]:
        """First and last column, first and last row of what is shown: all boxes and a margin, inside the picture."""
        boxes = np.concatenate([self.measured, *(panel.boxes for panel in self.panels)]).reshape(-1, 2)
        points = np.concatenate([boxes, self.pedicles, *(panel.pedicles for panel in self.panels)])
        margin = MARGIN_MM / np.array(self.mm_per_pixel)
        low, high = points.min(0) - margin, points.max(0) + margin
        lacking = 0.5 * (NARROWEST_CROP_MM / self.mm_per_pixel[0] - (high[0] - low[0]))
        if lacking > 0.0:
            low[0], high[0] = low[0] - lacking, high[0] + lacking
        rows, columns = self.pixels.shape
        last = np.array([columns, rows]) - 1
        low = np.clip(np.floor(low), 0, last - 1)
        high = np.clip(np.ceil(high), low + 1, last)
        return int(low[0]), int(high[0]), int(low[1]), int(high[1])


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


def as_png(figure: Figure) -> bytes:
    """The figure as PNG."""
    return _saved(figure, "png", {"Software": None})


def as_svg(figure: Figure) -> bytes:
    """The figure as SVG, letters as outlines, without a date."""
    return _saved(figure, "svg", {"Date": None, "Creator": None, "Format": None, "Type": None})


def _saved(figure: Figure, kind: str, metadata: dict[str, None]) -> bytes:
    stream = BytesIO()
    with rc_context(STYLE):
        part_tick_labels(figure)
        figure.savefig(stream, format=kind, dpi=PNG_DPI, metadata=metadata)
    return stream.getvalue()


def part_tick_labels(figure: Figure) -> None:
    """Hide each tick label that would touch the one before it; the tick itself stays."""
    figure.draw_without_rendering()
    for axes in figure.axes:
        for side, along in ((axes.xaxis, 0), (axes.yaxis, 1)):
            last = -np.inf
            labels = [tick.label1 for tick in side.get_major_ticks() if tick.label1.get_text()]
            boxes = [(label, label.get_window_extent()) for label in labels if label.get_visible()]
            for label, box in sorted(boxes, key=lambda found: found[1].min[along]):
                touches = box.min[along] < last + LABEL_GAP * figure.dpi
                label.set_visible(not touches)
                last = last if touches else box.max[along]


def draw_overlay(overlay: Overlay) -> Figure:
    """The simulated over the measured boxes on the radiograph, one panel beside the other (the paper's Figs. 4-5)."""
    left, right, top, bottom = overlay.crop
    spacing = overlay.mm_per_pixel
    aspect = (right - left) * spacing[0] / ((bottom - top) * spacing[1])
    width = max(PANEL_HEIGHT * aspect, 2.3)
    count = len(overlay.panels)
    picture = overlay.pixels[top : bottom + 1, left : right + 1]
    black, white = np.percentile(picture, PERCENTILES)
    with rc_context(STYLE):
        figure = Figure(figsize=(count * width + 0.15 * (count + 1), PANEL_HEIGHT + 0.95))
        axes = figure.subplots(1, count, squeeze=False)[0]
        figure.subplots_adjust(left=0.01, right=0.99, bottom=0.05, top=0.93, wspace=0.03)
        for index, (axis, panel) in enumerate(zip(axes, overlay.panels)):
            axis.imshow(
                picture,
                cmap="gray",
                vmin=black,
                vmax=max(white, black + 1e-6) + 0.25 * (white - black),
                extent=(left - 0.5, right + 0.5, bottom + 0.5, top - 0.5),
                aspect=spacing[1] / spacing[0],
                interpolation="bilinear",
            )
            axis.set_axis_off()
            _draw_boxes(axis, overlay, panel)
            _draw_marks(axis, overlay, first=index == 0)
            axis.set_xlim(left - 0.5, right + 0.5)
            axis.set_ylim(bottom + 0.5, top - 0.5)
            error = "no prediction" if panel.rmse_mm is None else f"RMSE {panel.rmse_mm:.1f} mm"
            axis.set_title(f"{panel.title}\n{error}", fontsize=11, pad=5)
        handles = [
            Line2D([], [], color=MEASURED_ON_DARK, marker="o", markersize=4, linewidth=1.4, label="measured"),
            Line2D([], [], color=SIMULATED_ON_DARK, linewidth=3.0, label="simulated"),
        ]
        if len(overlay.pedicles):
            handles.append(Line2D([], [], **_PEDICLES_MEASURED, label="pedicles, measured"))
            handles.append(Line2D([], [], **_PEDICLES_SIMULATED, label="pedicles, simulated"))
        # A narrow picture has room for two beside each other.
        columns = len(handles) if count > 1 else 2
        figure.legend(handles=handles, loc="lower center", ncols=columns, fontsize=10.5, borderaxespad=0.15)
    return figure


def _draw_boxes(axis: Axes, overlay: Overlay, panel: Panel) -> None:
    for simulated, measured in zip(panel.boxes, overlay.measured):
        closed = np.vstack([simulated, simulated[:1]])
        axis.plot(*closed.T, color=SIMULATED_ON_DARK, linewidth=2.3, solid_joinstyle="round")
        closed = np.vstack([measured, measured[:1]])
        axis.plot(*closed.T, color=MEASURED_ON_DARK, linewidth=0.9, marker="o", markersize=2.6)
    if len(overlay.pedicles):
        axis.plot(*panel.pedicles.T, **_PEDICLES_SIMULATED)
        axis.plot(*overlay.pedicles.T, **_PEDICLES_MEASURED)


_PEDICLES_MEASURED: dict[str, Any] = {
    "color": MEASURED_ON_DARK, "linestyle": "none", "marker": "x", "markersize": 5.0, "markeredgewidth": 1.3,
}  # fmt: skip
_PEDICLES_SIMULATED: dict[str, Any] = {
    "color": SIMULATED_ON_DARK, "linestyle": "none", "marker": "o", "markersize": 7.5, "markeredgewidth": 1.8,
    "markerfacecolor": "none",
}  # fmt: skip


def _draw_marks(axis: Axes, overlay: Overlay, first: bool) -> None:
    """Letters of the sides, names of every other level, a scale bar and the push."""
    left, right, top, bottom = overlay.crop
    column, row = overlay.mm_per_pixel
    light: dict[str, Any] = {"color": WHITE_ON_DARK, "fontsize": 10, "fontweight": "bold"}
    for place, letter, side in ((0.0, overlay.sides[0], "left"), (1.0, overlay.sides[1], "right")):
        axis.text(place, 1.008, letter, ha=side, va="bottom", fontweight="bold", transform=axis.transAxes)
    if overlay.arrow is not None:
        height, direction, text = overlay.arrow
        if top < height < bottom:
            tail = left if direction > 0 else right
            length = 22.0 / column * direction
            arrow = {"arrowstyle": "-|>", "color": WHITE_ON_DARK, "linewidth": 2.2, "mutation_scale": 16}
            axis.annotate("", (tail + length, height), (tail, height), arrowprops=arrow)
            place = tail + 0.1 * length
            side = "left" if direction > 0 else "right"
            axis.text(place, height - 7.0 / row, text, ha=side, va="center", **light)
    if not first:
        return
    # Names stand on the side that the push leaves free, the scale bar on the other.
    names_left = overlay.arrow is None or overlay.arrow[1] < 0.0
    for name, box in zip(overlay.vertebrae, overlay.measured):
        place = left + 4.0 / column if names_left else right - 4.0 / column
        height = float(box[:, 1].mean())
        side = "left" if names_left else "right"
        axis.text(place, height, name, color=WHITE_ON_DARK, fontsize=7.5, ha=side, va="center")
    length, height = SCALE_BAR_MM / column, bottom - 7.0 / row
    start = right - 5.0 / column - length if names_left else left + 5.0 / column
    axis.plot([start, start + length], [height, height], color=WHITE_ON_DARK, linewidth=3, solid_capstyle="butt")
    above = height - 3.0 / row
    axis.text(start, above, f"{SCALE_BAR_MM:g} mm", color=WHITE_ON_DARK, fontsize=8.5, ha="left", va="bottom")


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
        figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


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
        near.set_title("95 % joint region", fontsize=11)
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


# Marks within a decade, for axes up to so many decades.
_TICKS = (
    (0.12, tuple(np.arange(1.0, 10.0, 0.2))),
    (0.3, tuple(np.arange(1.0, 10.0, 0.5))),
    (0.7, (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0)),
    (2.0, (1.0, 2.0, 5.0)),
    (np.inf, (1.0,)),
)


def plain_ticks(axis: Axes, which: str) -> None:
    """Plain numbers, as many as have room, along a logarithmic axis "x" or "y" whose limits are set."""
    side, limits = (axis.xaxis, axis.get_xlim()) if which == "x" else (axis.yaxis, axis.get_ylim())
    decades = float(np.log10(limits[1] / limits[0]))
    subs = next(marks for widest, marks in _TICKS if decades <= widest)
    side.set_major_locator(LogLocator(subs=subs, numticks=8))
    side.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
    side.set_minor_formatter(NullFormatter())
