"""Further views, pedicles and skin markers in the report: what was seen beside frontal corners, how models meet it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from spinestiff.anatomy.state import TorsoState
from spinestiff.arrays import Floats
from spinestiff.estimation.objective import Residuals, Target, residuals
from spinestiff.estimation.sights import MarkerTarget, PedicleTarget, Sight, further_sights, sight_residuals
from spinestiff.study.misfit import rms
from spinestiff.study.predictions import Prediction, Predictions
from spinestiff.study.report.figures import FIT, MEASURED, STYLE
from spinestiff.study.report.frame_content import MODELS
from spinestiff.study.report.overlay import NO_POINTS, Overlay, Panel, draw_overlay
from spinestiff.study.report.placing import pixel_mm, pixels_of, sides_of, view_of
from spinestiff.study.visit import Visit
from spinestiff.study.wording.numbers import fixed
from spinestiff.subject.folder import read_view
from spinestiff.words import counted

AROUND_MM = 15.0  # around what is drawn of markers
S = TypeVar("S")
ROLES = {"training": "fitted", "validation": "held out", "unused": "not used"}


def beside_rows(predictions: Predictions) -> list[dict[str, object]]:
    """Of every frame under force what else it shows, and its RMS distance to each model, mm; empty where there is none.

    Corners and pedicles in their radiograph at the patient plane; markers in space, their motion since the frame with
    the least force, so that where the cameras were does not count.
    """
    rows: list[dict[str, object]] = []
    for frame in predictions.frames:
        for sight in _sights(predictions, frame):
            found = {name: _error(predictions, frame, sight, name) for name in MODELS}
            rows.append(
                {
                    "frame": f"“{frame.item.push}”, frame {frame.item.frame}, {frame.item.force_n:.0f} N",
                    "role": ROLES[frame.item.role],
                    "what": _what(frame, sight),
                    "cells": [fixed(error, 2) for error in found.values()],
                }
            )
    return rows


def _sights(predictions: Predictions, frame: Prediction) -> list[Sight]:
    found = further_sights([predictions.pushes.torso], [frame.target], predictions.pushes.orientation)
    return [one.target for one in found]


def _what(frame: Prediction, sight: Sight) -> str:
    if isinstance(sight, MarkerTarget):
        return f"{counted(len(sight.rows), 'skin marker')}, their motion"
    where = "the frontal radiograph" if sight.trial.push == frame.item.push else f"view “{view_of(sight.trial.push)}”"
    if isinstance(sight, Target):
        return f"corners of {counted(len(sight.rows), 'vertebra', 'vertebrae')}, {where}"
    return f"{counted(len(sight.rows), 'pedicle')}, {where}"


def _error(predictions: Predictions, frame: Prediction, sight: Sight, model: str) -> float | None:
    state = frame.states.get(model)
    if state is None:
        return None
    if isinstance(sight, MarkerTarget):
        start = predictions.before(frame.item, model)
        motions = None if start is None else _motions(predictions, frame, sight, start, state)
        return None if motions is None else rms(motions[2] - motions[1])
    if isinstance(sight, Target):
        return residuals(predictions.pushes.torso, sight, state).rmse
    return rms(sight_residuals(predictions.pushes.torso, sight, state).difference)


def _motions(
    predictions: Predictions, frame: Prediction, sight: MarkerTarget, start: TorsoState, state: TorsoState
) -> tuple[Floats, Floats, Floats] | None:
    """Places at rest, measured and simulated motion, each (P, 3) mm, of markers seen in the least force's frame too."""
    torso, first = predictions.pushes.torso, predictions.pushes.reference(frame.item.push).trial.markers
    if first is None:
        return None
    before = first.positions[sight.rows]
    both = np.isfinite(before).all(1)
    if not both.any():
        return None
    simulated = sight.points.positions(torso, state) - sight.points.positions(torso, start)
    return sight.resting[both], (sight.z - before)[both], simulated[both]


@dataclass(frozen=True)
class MarkerMotion:
    """Motion of skin markers in one frame, (P, 3) mm: places at rest, measured and simulated motion."""

    title: str
    resting: Floats
    measured: Floats
    simulated: Floats


def draw_markers(motions: Sequence[MarkerMotion]) -> Figure:
    """Ways of the markers in true size, seen from the front and from the patient's right, a row a frame."""
    with rc_context(STYLE):
        every = np.concatenate([one.resting + way for one in motions for way in (0.0, one.measured, one.simulated)])
        low, high = every.min(0) - AROUND_MM, every.max(0) + AROUND_MM
        across, up, front = high - low
        height = 8.0 * up / (across + front)
        figure = Figure(figsize=(9.4, (height + 0.9) * len(motions) + 0.5), layout="constrained")
        for row, motion in zip(figure.subplots(len(motions), 2, squeeze=False, width_ratios=(across, front)), motions):
            # From the front the patient's left is on the right; from the right the front is.
            _draw_side(row[0], motion, 0, "mm to the patient’s left", f"{motion.title}, from the front")
            _draw_side(row[1], motion, 2, "mm to the front", "from the patient’s right")
            for axis, along in zip(row, (0, 2)):
                axis.set_xlim(low[along], high[along])
                axis.set_ylim(low[1], high[1])
            row[0].set_ylabel("mm up")
        handles = [
            Line2D([], [], color="#444444", marker="o", markersize=3.0, linestyle="none", label="without force"),
            Line2D([], [], color=MEASURED, linewidth=1.8, marker="o", markersize=4.5, label="measured"),
            Line2D([], [], color=FIT, marker="o", markerfacecolor="none", markersize=8.0, linestyle="none",
                   label="estimated stiffness"),
        ]  # fmt: skip
        figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


def _draw_side(axis: Axes, motion: MarkerMotion, along: int, across: str, title: str) -> None:
    start, measured, simulated = (
        (motion.resting + moved)[:, [along, 1]]
        for moved in (np.zeros_like(motion.resting), motion.measured, motion.simulated)
    )
    for one, other in zip(start, measured):
        axis.plot(*np.stack([one, other]).T, color=MEASURED, linewidth=1.8)
    axis.plot(*start.T, linestyle="none", marker="o", markersize=3.0, color="#444444")
    axis.plot(*measured.T, linestyle="none", marker="o", markersize=4.5, color=MEASURED)
    axis.plot(*simulated.T, linestyle="none", marker="o", markersize=8.0, color=FIT, markerfacecolor="none")
    axis.set_aspect("equal")
    axis.set_xlabel(across)
    axis.set_title(title, fontsize=11)


@dataclass(frozen=True)
class Pedicles:
    """Pedicles of one radiograph, (P, 2) mm at the patient plane: as marked, and by model."""

    measured: Floats = field(default_factory=lambda: NO_POINTS)
    simulated: Mapping[str, Floats] = field(default_factory=dict)

    def of(self, model: str) -> Floats:
        """Those of a model; none where none are marked."""
        return self.simulated.get(model, NO_POINTS)

    def words(self) -> str:
        """Half a sentence on how far off each model's are; empty where none are marked."""
        if not len(self.measured):
            return ""
        errors = (
            f"{MODELS[name].lower()} {fixed(rms(points - self.measured))} mm" for name, points in self.simulated.items()
        )
        return f" Of {counted(len(self.measured), 'pedicle')}: {', '.join(errors)} (RMS)."


def pedicles_in(predictions: Predictions, frame: Prediction, sequence: str) -> Pedicles:
    """Those that are marked in a frame's radiograph.

    Parameters
    ----------
    sequence : the push of the frontal radiograph, else the sequence of a further view (``Picture.sequence``).
    """
    for sight in _sights(predictions, frame):
        if isinstance(sight, PedicleTarget) and sight.trial.push == sequence:
            torso, states = predictions.pushes.torso, frame.states
            simulated = {
                name: sight.z + sight_residuals(torso, sight, states[name]).difference
                for name in MODELS
                if name in states
            }
            return Pedicles(sight.z, simulated)
    return Pedicles()


PixelsOf = Callable[[str, int, str], NDArray[Any]]
"""The grey values of the radiograph of a push's frame in a view."""


def pixels_in(visit: Visit) -> PixelsOf:
    """As the subject's folder has them."""

    def found(push_id: str, frame: int, view: str) -> NDArray[Any]:
        push = visit.subject.push(push_id)
        record = next(one for one in push.views if one.id == view)
        return read_view(visit.subject, push, record)[record.frames.index(frame)].pixels

    return found


def beside_pictures(predictions: Predictions, pixels: PixelsOf) -> list[tuple[str, Figure, str, str]]:
    """Of each view and of markers the frames held out and that with the largest force: name, figure, alt, caption."""
    return [*_view_pictures(predictions, pixels), *_marker_pictures(predictions)]


def _view_pictures(predictions: Predictions, pixels: PixelsOf) -> list[tuple[str, Figure, str, str]]:
    seen: dict[str, list[tuple[Prediction, Target]]] = {}
    for frame in predictions.frames:
        for sight in _sights(predictions, frame):
            if isinstance(sight, Target):
                seen.setdefault(sight.trial.push, []).append((frame, sight))
    found = []
    for sequence, sights in seen.items():
        for frame, sight in _worth_showing(sights):
            view, item = sight.trial.view, frame.item
            shown = pixels(item.push, item.frame, view_of(sequence))
            pedicles = pedicles_in(predictions, frame, sequence)
            panels = tuple(
                Panel(
                    MODELS[name],
                    pixels_of(view, sight.z + part.difference),
                    part.rmse,
                    pixels_of(view, pedicles.of(name)),
                )
                for name, part in _compared(predictions, frame, sight).items()
            )
            overlay = Overlay(
                shown,
                sight.trial.corners.vertebrae,
                pixels_of(view, sight.z),
                panels,
                pixel_mm(view),
                sides_of(view),
                pedicles=pixels_of(view, pedicles.measured),
            )
            where = f"view “{view_of(sequence)}” of push “{item.push}”, frame {item.frame}, {item.force_n:.0f} N"
            errors = ", ".join(f"{panel.title.lower()} {fixed(panel.rmse_mm)} mm" for panel in panels)
            alt = f"Radiograph, {where}, with measured and simulated vertebra boxes. RMSE: {errors}.{pedicles.words()}"
            caption = (
                f"{where[0].upper()}{where[1:]}, {ROLES[item.role]}: vertebrae as measured (blue) and simulated "
                "(orange)."
            )
            name = f"view-{view_of(sequence)}-{item.push}-frame-{item.frame}"
            found.append((name, draw_overlay(overlay), alt, caption))
    return found


def _worth_showing(seen: Sequence[tuple[Prediction, S]]) -> list[tuple[Prediction, S]]:
    """Of one push, in the order of forces: the frames held out, which test the estimate, and the largest force."""
    ordered = sorted(seen, key=lambda one: one[0].item.force_n)
    return [one for one in ordered if one[0].item.role == "validation" or one is ordered[-1]]


def _compared(predictions: Predictions, frame: Prediction, sight: Target) -> dict[str, Residuals]:
    torso, states = predictions.pushes.torso, frame.states
    return {name: residuals(torso, sight, states[name]) for name in MODELS if name in states}


def _marker_pictures(predictions: Predictions) -> list[tuple[str, Figure, str, str]]:
    seen: dict[str, list[tuple[Prediction, MarkerMotion]]] = {}
    for frame in predictions.frames:
        for sight in _sights(predictions, frame):
            start, state = predictions.before(frame.item, "fit"), frame.states.get("fit")
            if not isinstance(sight, MarkerTarget) or start is None or state is None:
                continue
            motions = _motions(predictions, frame, sight, start, state)
            if motions is not None:
                title = f"“{frame.item.push}”, {frame.item.force_n:.0f} N, {ROLES[frame.item.role]}"
                seen.setdefault(frame.item.push, []).append((frame, MarkerMotion(title, *motions)))
    shown = [motion for one in seen.values() for _, motion in _worth_showing(one)]
    if not shown:
        return []
    words = [
        f"{one.title}: moved by {fixed(rms(one.measured))} mm, the estimate is "
        f"{fixed(rms(one.simulated - one.measured))} mm off (RMS)"
        for one in shown
    ]
    alt = f"Motion of skin markers in {counted(len(shown), 'frame')}, measured and simulated; {'; '.join(words)}."
    caption = (
        "Markers on the skin in the frames held out and under the largest force, in true size: from where they were "
        "without force to where they were seen (blue), and where the estimate takes them (orange)."
    )
    return [("skin-markers", draw_markers(shown), alt, caption)]
