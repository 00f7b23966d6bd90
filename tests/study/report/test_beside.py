"""Further views, pedicles and skin markers in the report: what is told of them and what is drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff import plot
from spinestiff.imaging.projection import lateral_view
from spinestiff.study.predictions import Prediction, Predictions, Solved, predictions_of
from spinestiff.study.report.beside import MarkerMotion, beside_pictures, beside_rows, draw_markers, pedicles_in
from spinestiff.study.report.frame_content import MODELS


def test_every_sight_is_told_with_its_distance_to_each_model(beside: Predictions) -> None:
    rows = beside_rows(beside)
    assert [row["what"] for row in rows] == [
        "28 pedicles, the frontal radiograph",
        "corners of 14 vertebrae, view “aside”",
        "28 pedicles, view “aside”",
        "7 skin markers, their motion",
    ]
    assert {(row["frame"], row["role"]) for row in rows} == {("“main”, frame 1, 40 N", "fitted")}
    pedicles, corners, aside, markers = ([float(cell) for cell in row["cells"]] for row in rows)
    # A motion across the frontal picture; the side's radiograph shows what comes nearer as a little larger.
    assert pedicles == pytest.approx([6.0, 3.0, 0.0], abs=0.35)
    for seen in (corners, aside):
        assert seen[0] > 1.5 * seen[1] > 0.0 and seen[2] < 0.05
    # Where the cameras were does not count: only motion does.
    assert markers == pytest.approx([6.0, 3.0, 0.0], abs=0.01)


def test_a_view_and_markers_are_drawn(beside: Predictions) -> None:
    asked = []

    def pixels(push: str, frame: int, view: str) -> np.ndarray:
        asked.append((push, frame, view))
        return np.zeros(lateral_view().shape)

    (view, drawn, alt, below), (markers, figure, said, caption) = beside_pictures(beside, pixels)
    assert asked == [("main", 1, "aside")]
    assert (view, markers) == ("view-aside-main-frame-1", "skin-markers")
    assert "view “aside” of push “main”, frame 1, 40 N" in alt and "estimated stiffness 0.0 mm" in alt
    assert "Of 28 pedicles: rest pose, no motion" in alt and "frame 1, 40 N, fitted: " in below
    assert "“main”, 40 N, fitted: moved by 6.0 mm, the estimate is 0.0 mm off" in said and "true size" in caption
    assert len(figure.axes) == 2
    # Measured pedicles lie where the estimate has them, and elsewhere than at rest.
    marks = [[line.get_xydata() for line in axis.lines if len(line.get_xydata()) == 28] for axis in drawn.axes]
    assert [axis.get_title().partition("\n")[0] for axis in drawn.axes] == list(MODELS.values())
    apart = [np.abs(simulated - measured).max() for simulated, measured in marks]
    assert apart[0] > 1.5 * apart[1] > 0.0 and apart[2] < 0.05
    words = [text.get_text() for text in drawn.legends[0].get_texts()]
    assert words == ["measured", "simulated", "pedicles, measured", "pedicles, simulated"]


def test_the_same_are_drawn_by_a_function(beside: Predictions, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("spinestiff.study.steps.stored_predictions", lambda visit: beside)
    monkeypatch.setattr(
        "spinestiff.study.report.beside.pixels_in", lambda visit: lambda *_: np.zeros(lateral_view().shape)
    )
    view, markers = plot.views_and_markers(None)  # type: ignore[arg-type]
    assert [len(axis.lines) > 0 for figure in (view, markers) for axis in figure.axes] == [True] * 5
    assert [axis.get_xlabel() for axis in markers.axes] == ["mm to the patient’s left", "mm to the front"]


def test_frames_held_out_are_drawn_beside_that_with_the_largest_force(beside: Predictions) -> None:
    def frame(number: int, force: float, role: str) -> Prediction:
        own = beside.frames[0]
        return replace(own, item=replace(own.item, frame=number, force_n=force, role=role))

    shown = replace(
        beside,
        frames=(frame(4, 40.0, "training"), frame(3, 30.0, "validation"), frame(2, 20.0, "training"),
                frame(1, 10.0, "validation")),
    )  # fmt: skip
    *views, (_, figure, said, _) = beside_pictures(shown, lambda *_: np.zeros(lateral_view().shape))
    assert [name for name, *_ in views] == [f"view-aside-main-frame-{number}" for number in (1, 3, 4)]
    captions = [caption.partition(": ")[0] for *_, caption in views]
    assert [caption.rpartition(", ")[2] for caption in captions] == ["held out", "held out", "fitted"]
    assert len(figure.axes) == 6 and said.count("held out: moved") == 2


def test_pedicles_of_the_frontal_radiograph_are_those_that_are_marked_there(beside: Predictions) -> None:
    (frame,) = beside.frames
    found = pedicles_in(beside, frame, "main")
    assert found.measured.shape == (28, 2)
    off = [float(np.abs(found.of(name) - found.measured).max()) for name in MODELS]
    assert off == pytest.approx([6.0, 3.0, 0.0], abs=0.35)
    # Those of the side's radiograph are others, and of a radiograph that there is not there are none.
    assert np.abs(pedicles_in(beside, frame, "main aside").measured - found.measured).max() > 20.0
    none = pedicles_in(beside, frame, "main above")
    assert len(none.measured) == len(none.of("fit")) == 0 and none.words() == ""


def test_ways_are_as_long_as_the_motion_and_sides_are_the_patient_s() -> None:
    rest = np.array([[0.0, 0.0, 0.0], [50.0, 100.0, 40.0]])
    moved = np.array([[6.0, 1.0, 2.0], [6.0, 1.0, 2.0]])
    figure = draw_markers([MarkerMotion("one", rest, moved, 0.5 * moved)] * 2)
    figure.draw_without_rendering()
    front, side, *_ = figure.axes
    # To the right of the page is the patient's left from the front, and the front from the right.
    for axis, along in ((front, 0), (side, 2)):
        *ways, start, measured, simulated = [np.column_stack(line.get_data()) for line in axis.lines]
        np.testing.assert_allclose(start, rest[:, [along, 1]])
        np.testing.assert_allclose(measured - start, moved[:, [along, 1]])
        np.testing.assert_allclose(simulated - start, 0.5 * moved[:, [along, 1]])
        np.testing.assert_allclose(ways, np.stack([start, measured], axis=1))
        assert axis.get_aspect() == 1.0
        ends = np.concatenate([start, measured])[:, 0]
        assert axis.get_xlim() == pytest.approx((ends.min() - 15.0, ends.max() + 15.0))


def test_without_any_nothing_is_told(beside: Predictions) -> None:
    bare = tuple(
        replace(item, trial=replace(item.trial, further=(), pedicles=None, markers=None))
        for item in beside.pushes.trials
    )
    solved = {("main", 1, "fit"): Solved(beside.pushes.torso.rest_pose, np.zeros((0, 3)))}
    plain = predictions_of(replace(beside.pushes, trials=bare), solved)
    assert beside_rows(plain) == [] and beside_pictures(plain, lambda *_: np.zeros((1, 1))) == []
