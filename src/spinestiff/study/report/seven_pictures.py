"""The paper's Figures 2, 4 and 5 for the study: tracked corners under rising force, and models over radiographs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from spinestiff.arrays import Floats
from spinestiff.study.report.figures import FIT, MEASURED, PERCENTILES, STYLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ROW_HEIGHT = 3.4  # inches
TRACKED = "#FF3B30"
BONE_ALPHA = 0.55


@dataclass(frozen=True)
class Shot:
    """A radiograph with what is drawn over it.

    Attributes
    ----------
    title : above it.
    pixels : (H, W) grey values, bone bright.
    mm_per_pixel : at the patient plane, along columns and rows.
    measured : (n, 4, 2) pixels (column, row).
    simulated : (n, 4, 2), or None.
    bones : (h, w) from 0 to 1, the model's bones over the whole picture; None: not drawn.
    """

    title: str
    pixels: np.ndarray
    mm_per_pixel: tuple[float, float]
    measured: Floats
    simulated: Floats | None = None
    bones: Floats | None = None


def draw_sequence(shots: Sequence[Shot]) -> Figure:
    """Radiographs of a push with their tracked corners, from left to right (the paper's Fig. 2)."""
    with rc_context(STYLE):
        figure = Figure(figsize=(3.1 * len(shots), 5.2), layout="constrained")
        axes = figure.subplots(1, len(shots), squeeze=False)[0]
        for axis, shot in zip(axes, shots):
            _picture(axis, shot)
            axis.plot(*shot.measured.reshape(-1, 2).T, ".", color=TRACKED, markersize=3.5)
            axis.set_title(shot.title, fontsize=10)
    return figure


def draw_models(rows: Sequence[tuple[str, Sequence[Shot]]]) -> Figure:
    """A row a subject: its model over the radiographs, each with a plot of the corners beside it (Figs. 4 and 5)."""
    columns = max(len(shots) for _, shots in rows)
    with rc_context(STYLE):
        figure = Figure(figsize=(3.9 * columns + 0.4, ROW_HEIGHT * len(rows) + 0.5), layout="constrained")
        grid = figure.subplots(len(rows), 2 * columns, squeeze=False, width_ratios=[1.25, 1.0] * columns)
        for axes, (name, shots) in zip(grid, rows):
            for number, shot in enumerate(shots):
                over, beside = axes[2 * number], axes[2 * number + 1]
                _picture(over, shot)
                _plot(beside, shot, over)
                over.set_title(shot.title, fontsize=8.5)
            for spare in axes[2 * len(shots) :]:
                spare.set_axis_off()
            axes[0].text(-0.04, 0.5, name, transform=axes[0].transAxes, rotation=90, ha="right", va="center")
        handles = [
            Line2D([], [], color=MEASURED, marker="o", markersize=4, linestyle="none", label="tracked corners"),
            Line2D([], [], color=FIT, marker="x", markersize=5, linestyle="none", label="simulated corners"),
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


def _picture(axis: Axes, shot: Shot) -> None:
    black, white = np.percentile(shot.pixels, PERCENTILES)
    rows, columns = shot.pixels.shape
    place: dict[str, Any] = {
        "extent": (-0.5, columns - 0.5, rows - 0.5, -0.5),
        "aspect": shot.mm_per_pixel[1] / shot.mm_per_pixel[0],
    }
    axis.imshow(shot.pixels, cmap="gray", vmin=black, vmax=max(white, black + 1e-6), interpolation="bilinear", **place)
    if shot.bones is not None:
        colour = np.zeros((*shot.bones.shape, 4))
        colour[..., :3] = (1.0, 0.78, 0.35)
        colour[..., 3] = BONE_ALPHA * np.clip(shot.bones, 0.0, 1.0)
        axis.imshow(colour, interpolation="bilinear", **place)
    axis.set_axis_off()


def _plot(axis: Axes, shot: Shot, over: Axes) -> None:
    scale = np.array(shot.mm_per_pixel)
    measured = shot.measured.reshape(-1, 2) * scale
    axis.plot(*measured.T, "o", color=MEASURED, markersize=2.0)
    everything = measured
    if shot.simulated is not None:
        simulated = shot.simulated.reshape(-1, 2) * scale
        axis.plot(*simulated.T, "x", color=FIT, markersize=2.8, markeredgewidth=0.8)
        everything = np.concatenate([measured, simulated])
    low, high = everything.min(0) - 10.0, everything.max(0) + 10.0
    axis.set_xlim(low[0], high[0])
    axis.set_ylim(high[1], low[1])
    axis.set_aspect("equal")
    axis.tick_params(labelsize=6)
