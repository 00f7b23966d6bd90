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

PANEL_HEIGHT = 4.4  # inches
MARGIN_MM, NARROWEST_MM = 18.0, 170.0  # of what is shown around the corners
TRACKED = "#FF3B30"
BONE, BONE_ALPHA = (1.0, 0.78, 0.35), 0.55


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
    window = _window(shots)
    wide = PANEL_HEIGHT * _aspect(window)
    with rc_context(STYLE):
        figure = Figure(figsize=(wide * len(shots) + 0.2, PANEL_HEIGHT + 0.4), layout="constrained")
        axes = figure.subplots(1, len(shots), squeeze=False)[0]
        for axis, shot in zip(axes, shots):
            _picture(axis, shot, window)
            axis.plot(*_mm(shot, shot.measured), ".", color=TRACKED, markersize=4.0)
            axis.set_title(shot.title, fontsize=10)
    return figure


def draw_models(rows: Sequence[tuple[str, Sequence[Shot]]]) -> Figure:
    """A row a subject: its model over the radiographs, each with a plot of the corners beside it (Figs. 4 and 5)."""
    columns = max(len(shots) for _, shots in rows)
    windows = [_window(shots) for _, shots in rows]
    wide = PANEL_HEIGHT * max(_aspect(window) for window in windows)
    with rc_context(STYLE):
        size = (columns * (1.85 * wide + 0.5) + 0.4, (PANEL_HEIGHT + 0.35) * len(rows) + 0.5)
        figure = Figure(figsize=size, layout="constrained")
        grid = figure.subplots(len(rows), 2 * columns, squeeze=False, width_ratios=[1.0, 0.85] * columns)
        for axes, (name, shots), window in zip(grid, rows, windows):
            for number, shot in enumerate(shots):
                over, beside = axes[2 * number], axes[2 * number + 1]
                _picture(over, shot, window)
                _corners(beside, shot, window)
                over.set_title(shot.title, fontsize=9, loc="left")
            for spare in axes[2 * len(shots) :]:
                spare.set_axis_off()
            axes[0].text(-0.04, 0.5, name, transform=axes[0].transAxes, rotation=90, ha="right", va="center")
        handles = [
            Line2D([], [], color=MEASURED, marker="o", markersize=4, linestyle="none", label="tracked corners"),
            Line2D([], [], color=FIT, marker="x", markersize=5, linestyle="none", label="simulated corners"),
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


def _mm(shot: Shot, corners: Floats) -> Floats:
    """(2, 4 n) mm from the picture's first pixel."""
    return np.asarray(corners.reshape(-1, 2) * shot.mm_per_pixel).T


def _window(shots: Sequence[Shot]) -> tuple[float, float, float, float]:
    """Left, right, top and bottom of what is shown of all of them, mm."""
    corners = [_mm(shot, found) for shot in shots for found in (shot.measured, shot.simulated) if found is not None]
    low, high = np.hstack(corners).min(axis=1) - MARGIN_MM, np.hstack(corners).max(axis=1) + MARGIN_MM
    lacking = max(0.0, 0.5 * (NARROWEST_MM - (high[0] - low[0])))
    return float(low[0] - lacking), float(high[0] + lacking), float(low[1]), float(high[1])


def _aspect(window: tuple[float, float, float, float]) -> float:
    left, right, top, bottom = window
    return (right - left) / (bottom - top)


def _picture(axis: Axes, shot: Shot, window: tuple[float, float, float, float]) -> None:
    black, white = np.percentile(shot.pixels, PERCENTILES)
    rows, columns = shot.pixels.shape
    across, down = shot.mm_per_pixel
    place: dict[str, Any] = {
        "extent": (-0.5 * across, (columns - 0.5) * across, (rows - 0.5) * down, -0.5 * down),
        "interpolation": "bilinear",
    }
    axis.imshow(shot.pixels, cmap="gray", vmin=black, vmax=max(white, black + 1e-6), **place)
    if shot.bones is not None:
        colour = np.zeros((*shot.bones.shape, 4))
        colour[..., :3] = BONE
        colour[..., 3] = BONE_ALPHA * np.clip(shot.bones, 0.0, 1.0)
        axis.imshow(colour, **place)
    axis.set_axis_off()
    _limited(axis, window)


def _corners(axis: Axes, shot: Shot, window: tuple[float, float, float, float]) -> None:
    axis.plot(*_mm(shot, shot.measured), "o", color=MEASURED, markersize=2.4)
    if shot.simulated is not None:
        axis.plot(*_mm(shot, shot.simulated), "x", color=FIT, markersize=3.2, markeredgewidth=0.9)
    _limited(axis, window)
    axis.set_yticklabels([])
    axis.set_xticklabels([])


def _limited(axis: Axes, window: tuple[float, float, float, float]) -> None:
    left, right, top, bottom = window
    axis.set_xlim(left, right)
    axis.set_ylim(bottom, top)
    axis.set_aspect("equal")
