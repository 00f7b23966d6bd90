"""The spine at rest, pushed, and as the estimate predicts it: the pictures of a report's first page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from spinestiff.arrays import Floats, read_only
from spinestiff.curves.changes import forms_in_words
from spinestiff.curves.pushes import reading_of
from spinestiff.errors import SpinestiffError
from spinestiff.imaging.features import FEATURE_SHAPE, state_features, vertebra_rows
from spinestiff.imaging.radiograph import Radiograph
from spinestiff.study.predictions import Prediction, Predictions
from spinestiff.study.report.clinician import other_ends, picture_words
from spinestiff.study.report.figures import MEASURED_ON_DARK, PERCENTILES, SIMULATED_ON_DARK, STYLE, WHITE_ON_DARK
from spinestiff.study.report.frame_content import expected_change
from spinestiff.study.report.placing import pixel_mm, push_arrow, sides_of
from spinestiff.study.trials import PushTrial
from spinestiff.study.visit import Visit
from spinestiff.subject.assessment_outcome import Assessment
from spinestiff.subject.outcomes import Responses
from spinestiff.subject.records import PushRecord

HEIGHT = 5.2  # inches
MARGIN_MM = (75.0, 14.0)
"""Beside and above the spine: room for the lines of the end vertebrae and for the push."""
REACH_MM = 34.0
"""By which the line of an end vertebra goes beyond it."""


@dataclass(frozen=True)
class SpinePicture:
    """One radiograph with the vertebrae of one moment.

    Attributes
    ----------
    pixels : (H, W) grey values, bone bright.
    vertebrae : (n,) names, head to foot. corners : (n, 4, 2) pixels (column, row), superior first, the patient's order.
    measured : (n, 4, 2) corners that were measured, where ``corners`` are a model's; else None.
    ends : upper and lower end vertebra of the Cobb angle.
    mm_per_pixel : at the patient plane, along columns and rows.
    sides : letters at the picture's left and right edge.
    arrow : pushed height (row), direction along columns (+1 or -1) and text; None = no push.
    """

    pixels: np.ndarray
    vertebrae: tuple[str, ...]
    corners: Floats
    measured: Floats | None
    ends: tuple[str, str]
    mm_per_pixel: tuple[float, float]
    sides: tuple[str, str]
    arrow: tuple[float, float, str] | None = None

    def __post_init__(self) -> None:
        shape = (len(self.vertebrae), *FEATURE_SHAPE)
        object.__setattr__(self, "corners", read_only("corners", self.corners, shape, SpinestiffError))
        if self.measured is not None:
            object.__setattr__(self, "measured", read_only("measured", self.measured, shape, SpinestiffError))
        for name in self.ends:
            if name not in self.vertebrae:
                raise SpinestiffError(f"end vertebra {name} is not among those in the picture")


def moments(
    visit: Visit,
    predictions: Predictions,
    films: Mapping[str, Sequence[Radiograph]],
    assessment: Assessment,
    responses: Responses,
) -> list[tuple[str, Figure, str, str]]:
    """The push that tells most, at rest, pushed, and by the estimate: name, figure, alt and caption of each.

    That is the held-out frame with the largest force, or without one the training frame; none where the curve was not
    seen in both radiographs. The angle is that between the end vertebrae before the push; ``responses`` has its own.
    """
    frame = _chosen(predictions)
    change = None if frame is None else predictions.measured_change(frame.item)
    if frame is None or change is None:
        return []
    torso, item, view = predictions.pushes.torso, frame.item, frame.item.trial.view
    start = predictions.pushes.reference(item.push)
    common = tuple(name for name in start.trial.corners.vertebrae if name in item.trial.corners.vertebrae)
    before, after = (one.trial.corners.selected(common) for one in (start, item))
    film = {one.frame: one.pixels for one in films[item.push]}
    record = visit.subject.push(item.push)
    shared = (change.levels, pixel_mm(view), sides_of(view))
    arrow = push_arrow(torso, view, record, item)
    seen, measured = (np.asarray(view.pixels(one.corners)) for one in (before, after))
    pictures = [
        SpinePicture(film[start.frame], common, seen, None, *shared),
        SpinePicture(film[item.frame], common, measured, None, *shared, arrow),
    ]
    reading = reading_of("at rest", before, view)
    force = "without force" if start.force_n == 0.0 else f"under {start.force_n:g} N"
    captions = [
        f"Before this push, {force}. Cobb angle {reading.words()}.{other_ends(responses, item.push, change.levels)}",
        picture_words("pushed", item.force_n, forms_in_words(change)["fixed_levels"], None, None),
    ]
    if "fit" in frame.states:
        shares = frame.target.shares
        found = state_features(torso, view, frame.states["fit"], shares).corners
        simulated = np.asarray(view.pixels(found[vertebra_rows(torso, after)]))
        pictures.append(SpinePicture(film[item.frame], common, simulated, measured, *shared, arrow))
        captions.append(_predicted(predictions, frame, assessment))
    return [
        (
            name,
            figure,
            f"Radiograph with vertebrae and the lines of the Cobb angle, {_where(of, record)}. {caption}",
            caption,
        )
        for name, of, figure, caption in zip(
            ("at-rest", "pushed", "predicted"), (start, item, item), draw_spines(pictures), captions
        )
    ]


def _where(item: PushTrial, push: PushRecord) -> str:
    side = f" from the patient’s {push.side}" if item.force_n > 0.0 else ""
    return f"push “{item.push}”, frame {item.frame}, {item.force_n:.0f} N{side}"


def _chosen(predictions: Predictions) -> Prediction | None:
    frames = predictions.of_role("validation") or predictions.of_role("training")
    return max(frames, key=lambda frame: frame.item.force_n, default=None)


def _predicted(predictions: Predictions, frame: Prediction, assessment: Assessment) -> str:
    torso, item = predictions.pushes.torso, frame.item
    simulated = predictions.simulated_change(frame, "fit")
    words = "" if simulated is None else forms_in_words(simulated)["fixed_levels"]
    for held_out in assessment.frames:
        if (held_out.push, held_out.frame) == (item.push, item.frame):
            words = expected_change(held_out) or words
    kind = "predicted" if item.role == "validation" else "fitted"
    return picture_words(kind, item.force_n, words, frame.rmse(torso, "fit"), frame.rmse(torso, "rest"))


def draw_spines(pictures: Sequence[SpinePicture]) -> tuple[Figure, ...]:
    """A figure each, all cropped and sized alike, without words but names, sides and force."""
    crop = _crop(pictures)
    return tuple(_draw(picture, crop) for picture in pictures)


def _crop(pictures: Sequence[SpinePicture]) -> tuple[float, float, float, float]:
    """Left, right, top and bottom edge, in pixels."""
    every = [found for one in pictures for found in (one.corners, one.measured) if found is not None]
    points = np.concatenate([found.reshape(-1, 2) for found in every])
    margin = np.array(MARGIN_MM) / pictures[0].mm_per_pixel
    rows, columns = pictures[0].pixels.shape
    low = np.clip(points.min(0) - margin, -0.5, [columns - 1.5, rows - 1.5])
    high = np.clip(points.max(0) + margin, low + 1.0, [columns - 0.5, rows - 0.5])
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def _draw(picture: SpinePicture, crop: tuple[float, float, float, float]) -> Figure:
    left, right, top, bottom = crop
    column, row = picture.mm_per_pixel
    with rc_context(STYLE | {"axes.grid": False}):
        figure = Figure(figsize=(HEIGHT * (right - left) * column / ((bottom - top) * row), HEIGHT))
        axis = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        part = picture.pixels[max(int(top), 0) : int(bottom) + 2, max(int(left), 0) : int(right) + 2]
        black, white = np.percentile(part, PERCENTILES)
        axis.imshow(
            part, cmap="gray", vmin=black, vmax=max(white, black + 1e-6) + 0.25 * (white - black), aspect="auto",
            extent=(max(int(left), 0) - 0.5, max(int(left), 0) + part.shape[1] - 0.5,
                    max(int(top), 0) + part.shape[0] - 0.5, max(int(top), 0) - 0.5),
            interpolation="bilinear",
        )  # fmt: skip
        axis.set_axis_off()
        _draw_spine(axis, picture)
        _draw_marks(axis, picture, crop)
        axis.set_xlim(left, right)
        axis.set_ylim(bottom, top)
    return figure


def _draw_spine(axis: Axes, picture: SpinePicture) -> None:
    simulated = picture.measured is not None
    if picture.measured is not None:
        for quad in picture.measured:
            axis.plot(*np.vstack([quad, quad[:1]]).T, color=MEASURED_ON_DARK, linewidth=0.9, linestyle=(0, (2, 1.5)))
    colour = SIMULATED_ON_DARK if simulated else MEASURED_ON_DARK
    for quad in picture.corners:
        axis.plot(*np.vstack([quad, quad[:1]]).T, color=colour, linewidth=1.4, solid_joinstyle="round")
    reach = REACH_MM / picture.mm_per_pixel[0]
    for name, plate in zip(picture.ends, ((0, 1), (3, 2))):
        ends = picture.corners[picture.vertebrae.index(name)][list(plate)]
        along = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0])) * reach
        axis.plot(*np.stack([ends[0] - along, ends[1] + along]).T, color=WHITE_ON_DARK, linewidth=1.3)


def _draw_marks(axis: Axes, picture: SpinePicture, crop: tuple[float, float, float, float]) -> None:
    """Letters of the sides, names of the end vertebrae, and the push."""
    left, right, top, bottom = crop
    column, row = picture.mm_per_pixel
    light: dict[str, Any] = {"color": WHITE_ON_DARK, "fontweight": "bold"}
    for place, letter, side in ((0.03, picture.sides[0], "left"), (0.97, picture.sides[1], "right")):
        axis.text(place, 0.985, letter, ha=side, va="top", fontsize=13, transform=axis.transAxes, **light)
    # Names stand on the side that the push leaves free.
    names_left = picture.arrow is None or picture.arrow[1] < 0.0
    for name in picture.ends:
        height = float(picture.corners[picture.vertebrae.index(name)][:, 1].mean())
        place = left + 3.0 / column if names_left else right - 3.0 / column
        axis.text(place, height, name, ha="left" if names_left else "right", va="center", fontsize=9.5, **light)
    if picture.arrow is not None and top < picture.arrow[0] < bottom:
        height, direction, text = picture.arrow
        tail = left if direction > 0 else right
        length = 22.0 / column * direction
        arrow = {"arrowstyle": "-|>", "color": WHITE_ON_DARK, "linewidth": 2.4, "mutation_scale": 18}
        axis.annotate("", (tail + length, height), (tail, height), arrowprops=arrow)
        side = "left" if direction > 0 else "right"
        axis.text(tail + 0.1 * length, height - 7.0 / row, text, ha=side, va="center", fontsize=11, **light)
