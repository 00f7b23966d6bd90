"""A picture of spines with their Cobb angles: outlines of the vertebrae, lines of the end vertebrae, angles, apices.

One panel an image, in the image's own proportions. Blue, green and orange are the regions; straight solid lines belong
to the largest curve, dashed ones to the others. Lines run to the curve's hollow side, as they are drawn by hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.arrays import Floats
from spinestiff.curves.cobb import REGIONS, CobbReading, Curve, Region
from spinestiff.errors import SubjectError
from spinestiff.files import write_bytes
from spinestiff.study.report.figures import STYLE, as_png

MOST_PANELS = 48
COLUMNS = 6
PANEL = (3.4, 7.2)  # inches
COLOURS: dict[Region, str] = {
    "proximal_thoracic": "#009E73",
    "main_thoracic": "#0072B2",
    "thoracolumbar_lumbar": "#D55E00",
}
BONE = "#8A8A8A"
# In widths of the image's vertebrae.
REACH, BACK = 2.3, 0.25


def write_picture(readings: Sequence[CobbReading], path: Path) -> None:
    """Write ``draw_readings`` as PNG, whole or not at all.

    Raises
    ------
    SubjectError : not a .png, more images than a page holds, or the file can't be written.
    """
    if path.suffix.lower() != ".png":
        raise SubjectError(f"{path}: wanted a name that ends in .png")
    if len(readings) > MOST_PANELS:
        raise SubjectError(f"{path}: {len(readings)} images, a picture holds {MOST_PANELS}; split the file of corners")
    write_bytes(path, as_png(draw_readings(readings)))


def draw_readings(readings: Sequence[CobbReading]) -> Figure:
    """One panel an image; of a refused one the reason. Raises SubjectError where there is none."""
    if not readings:
        raise SubjectError("no reading of Cobb angles to draw; wanted at least one")
    columns = min(len(readings), COLUMNS)
    rows = -(-len(readings) // columns)
    with rc_context({**STYLE, "axes.grid": False}):
        figure = Figure(figsize=(PANEL[0] * columns + 0.2, PANEL[1] * rows + 0.5), layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False).ravel()
        for axis in grid:
            axis.set_axis_off()
        for axis, reading in zip(grid, readings):
            _draw(axis, reading)
        handles = [Line2D([], [], color=colour, linewidth=2.0, label=REGIONS[n][1]) for n, colour in COLOURS.items()]
        handles.append(Line2D([], [], color="#444444", linestyle="none", marker="D", markersize=5, label="apex"))
        figure.legend(handles=handles, loc="outside lower center", ncols=4)
    return figure


def _draw(axis: Axes, reading: CobbReading) -> None:
    axis.set_title(_title(reading), fontsize=9)
    if reading.corners is None or reading.largest is None:
        reason = fill(reading.warnings[0], 34)
        axis.text(0.5, 0.5, reason, ha="center", va="center", transform=axis.transAxes, fontsize=9)
        return
    corners, levels = reading.corners, reading.levels
    middles = corners.mean(axis=1)
    width = float(np.median(np.hypot(*(corners[:, 1] - corners[:, 0]).T)))
    axis.plot(*middles.T, color=BONE, linewidth=1.0, linestyle=":")
    for level, quad in zip(levels, corners):
        axis.plot(*np.vstack([quad, quad[:1]]).T, color=BONE, linewidth=1.1, solid_joinstyle="round")
        column, row = quad.mean(axis=0)
        axis.text(column, row, level, ha="center", va="center", fontsize=6.0, color="#333333")
    for curve in reading.curves:
        _draw_curve(axis, reading, curve, width)
    axis.set_aspect("equal", anchor="N")
    low, high = corners.reshape(-1, 2).min(0), corners.reshape(-1, 2).max(0)
    axis.set_xlim(low[0] - (REACH + 0.4) * width, high[0] + (REACH + 0.4) * width)
    axis.set_ylim(high[1] + 0.5 * width, low[1] - 0.5 * width)
    if reading.patient_left is not None:
        letters = ("L", "R") if reading.patient_left == "left" else ("R", "L")
        for place, letter in zip((0.02, 0.98), letters):
            axis.text(place, 0.99, letter, ha="center", va="top", transform=axis.transAxes, fontweight="bold")


def _draw_curve(axis: Axes, reading: CobbReading, curve: Curve, width: float) -> None:
    """Lines of the end vertebrae towards the hollow side, the angle between them, and the apex."""
    corners, levels = reading.corners, reading.levels
    assert corners is not None
    i, j = levels.index(curve.angle.upper), levels.index(curve.angle.lower)
    largest = curve is reading.largest
    colour = COLOURS[curve.region]
    hollow = -1.0 if reading.bulges_right(curve) else 1.0
    ends = []
    for quad, rows in ((corners[i], (0, 1)), (corners[j], (3, 2))):
        left, right = quad[list(rows)] if reading.definition == "endplate" else 0.5 * (quad[[0, 1]] + quad[[3, 2]])
        along = (right - left) / np.hypot(*(right - left)) * width * hollow
        outer, inner = (right, left) if hollow > 0 else (left, right)
        line = np.array([inner - BACK * along, outer + (REACH - 1.0) * along])
        axis.plot(*line.T, color=colour, linewidth=2.0 if largest else 1.4, linestyle="-" if largest else (0, (4, 2)))
        ends.append(line[1])
    height = 0.5 * (ends[0][1] + ends[1][1])
    text = f"{abs(curve.angle.degrees):.1f}° ± {curve.half_width_deg:.1f}°\n{curve.angle.upper}–{curve.angle.lower}"
    columns = corners[i : j + 1, :, 0]
    axis.text(
        float(columns.max() if hollow > 0 else columns.min()) + 0.3 * width * hollow,
        height,
        text,
        color=colour,
        ha="left" if hollow > 0 else "right",
        va="center",
        fontsize=10 if largest else 8.5,
        fontweight="bold" if largest else "normal",
    )
    place = _apex_place(reading, curve) - [0.8 * width * hollow, 0.0]
    axis.plot(*place, marker="D", color=colour, markersize=5, markeredgecolor="white")


def _apex_place(reading: CobbReading, curve: Curve) -> Floats:
    """(2,) column and row of the apex, a vertebra or the middle of a disc."""
    assert reading.corners is not None
    places = [VERTEBRAE.index(level) for level in reading.levels]
    wanted = np.mean([VERTEBRAE.index(level) for level in curve.apex.split("-")])
    middles = reading.corners.mean(axis=1)
    return np.array([np.interp(wanted, places, middles[:, k]) for k in (0, 1)])


def _title(reading: CobbReading) -> str:
    if reading.largest is None:
        return f"{reading.image}\nrefused"
    words = f"{reading.image}{'' if reading.status == 'ok' else ' (repaired)'}"
    return f"{words}\n{reading.words()}"
