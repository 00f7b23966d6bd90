"""A picture strip of a subject's frames: every push a row, every frame with its role, force, supports and quality."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from spinestiff.imaging.radiograph import Radiograph
from spinestiff.imaging.tracking.quality import usable_corners
from spinestiff.study.frame_selection import FrameQuality, Proposal
from spinestiff.study.report.figures import MEASURED_ON_DARK, PERCENTILES, STYLE
from spinestiff.subject.outcomes import TrackedPush
from spinestiff.subject.records import PushRecord
from spinestiff.words import counted

COLOURS = {"training": "#0072B2", "validation": "#D55E00", "unused": "#8A8A8A"}
MARGIN_MM = (75.0, 20.0)
"""Beside and above the spine: ribs and where the force acts are seen."""
HEIGHT, NARROWEST, WIDEST = 5.4, 2.5, 24.0  # inches


@dataclass(frozen=True)
class Row:
    """A push: its record, frames as read and tracked, and what is proposed."""

    push: PushRecord
    frames: Sequence[Radiograph]
    tracked: TrackedPush
    proposals: Sequence[Proposal]


def draw_strip(rows: Sequence[Row]) -> Figure:
    """All pushes, one below the other; each frame cropped alike within a push."""
    most = max(len(row.frames) for row in rows)
    crops = [_crop(row) for row in rows]
    shape = max(_aspect(row, crop) for row, crop in zip(rows, crops))
    width = min(max(HEIGHT * 0.75 * shape, NARROWEST), WIDEST / most)
    with rc_context(STYLE | {"axes.grid": False}):
        figure = Figure(figsize=(width * most + 0.3, HEIGHT * len(rows) + 0.1))
        grid = figure.subplots(len(rows), most, squeeze=False)
        figure.subplots_adjust(left=0.01, right=0.99, bottom=0.01, top=1.0 - 0.95 / (HEIGHT * len(rows)), wspace=0.04,
                               hspace=0.30)  # fmt: skip
        for row, crop, axes in zip(rows, crops, grid):
            for axis in axes:
                axis.set_axis_off()
            for index, axis in enumerate(axes[: len(row.frames)]):
                _draw(axis, row, index, crop)
    return figure


def _crop(row: Row) -> tuple[int, int, int, int]:
    """First and last column and row that hold all corners of all frames, and a margin."""
    view = row.frames[0].view
    corners = [usable_corners(row.tracked.corners(i)).corners for i in range(len(row.frames))]
    points = view.pixels(np.concatenate([found.reshape(-1, 2) for found in corners]))
    margin = np.array(MARGIN_MM) * view.magnification / view.pixel_spacing
    last = np.array(view.shape[::-1]) - 1
    if not len(points):
        return 0, int(last[0]), 0, int(last[1])
    low = np.clip(np.floor(points.min(0) - margin), 0, last - 1).astype(int)
    high = np.clip(np.ceil(points.max(0) + margin), low + 1, last).astype(int)
    return int(low[0]), int(high[0]), int(low[1]), int(high[1])


def _aspect(row: Row, crop: tuple[int, int, int, int]) -> float:
    spacing = row.frames[0].view.pixel_spacing
    return float((crop[1] - crop[0]) * spacing[0] / ((crop[3] - crop[2]) * spacing[1]))


def _draw(axis: Axes, row: Row, index: int, crop: tuple[int, int, int, int]) -> None:
    left, right, top, bottom = crop
    frame, proposal = row.frames[index], row.proposals[index]
    quality, colour = proposal.quality, COLOURS[proposal.role]
    picture = frame.pixels[top : bottom + 1, left : right + 1]
    black, white = np.percentile(picture, PERCENTILES)
    axis.imshow(
        picture, cmap="gray", vmin=black, vmax=max(white, black + 1e-6), aspect=_ratio(frame),
        extent=(left - 0.5, right + 0.5, bottom + 0.5, top - 0.5), interpolation="bilinear",
    )  # fmt: skip
    for quad in frame.view.pixels(usable_corners(row.tracked.corners(index)).corners):
        closed = np.concatenate([quad, quad[:1]])
        axis.plot(closed[:, 0], closed[:, 1], color=MEASURED_ON_DARK, linewidth=0.9)
    axis.set_xlim(left - 0.5, right + 0.5)
    axis.set_ylim(bottom + 0.5, top - 0.5)
    axis.axhline(top - 0.5, color=colour, linewidth=9.0, clip_on=True)
    name = f"{row.push.id}, from the {row.push.side}\n" if index == 0 else "\n"
    role = f"frame {index}, {quality.force_n:g} N: {proposal.role}"
    axis.set_title(f"{name}{role}\n{_lines(quality)}", fontsize=9, pad=4, loc="left", color="#222222")


def _ratio(frame: Radiograph) -> float:
    spacing = frame.view.pixel_spacing
    return float(spacing[1] / spacing[0])


def _lines(quality: FrameQuality) -> str:
    supports = [
        f"{name} {motion.mm:.1f} mm" + (f", {motion.degrees:+.1f}°" if motion.degrees is not None else "")
        for name, motion in quality.supports.items()
    ]
    sharp = f"sharpness {quality.image.sharpness:.2f}" if np.isfinite(quality.image.sharpness) else "sharpness unknown"
    first = f"{sharp}, {counted(quality.vertebrae, 'vertebra', 'vertebrae')}"
    return "\n".join([first, *supports] + [""] * (2 - len(supports)))
