"""Simulated over measured vertebrae on a radiograph (the paper's Figs. 4-5)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from spinestiff.arrays import Floats, read_only
from spinestiff.errors import SpinestiffError
from spinestiff.imaging.features import FEATURE_SHAPE
from spinestiff.study.report.figures import MEASURED_ON_DARK, PERCENTILES, SIMULATED_ON_DARK, STYLE, WHITE_ON_DARK

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PANEL_HEIGHT = 7.0  # inches
NARROWEST_CROP_MM = 150.0
MARGIN_MM = 18.0
SCALE_BAR_MM = 50.0
NO_POINTS = read_only("points", np.zeros((0, 2)), (None, 2), SpinestiffError)


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
