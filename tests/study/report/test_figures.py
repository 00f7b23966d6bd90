"""Pictures: they show what they are given, in the right place, and the same each time."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.colors import to_hex

from spinestiff.errors import SpinestiffError
from spinestiff.estimation.objective import Trial
from spinestiff.imaging.features import VertebraCorners
from spinestiff.study.predictions import Predictions, predictions_of, stored
from spinestiff.study.report import pictures
from spinestiff.study.report.certainty_pictures import BudgetBars, RatioMap, draw_budget, draw_ratio_map
from spinestiff.study.report.curve_pictures import CurveChange, TiltChange, draw_curve_changes, draw_tilt_changes
from spinestiff.study.report.figures import FIT, MEASURED, MEASURED_ON_DARK, SIMULATED_ON_DARK, as_png, as_svg
from spinestiff.study.report.overlay import Overlay, Panel, draw_overlay
from spinestiff.study.report.pictures import curve_picture, tilt_picture

NAMES = ("T10", "T11", "T12")


def boxes(column: float) -> np.ndarray:
    square = np.array([[-20.0, -10.0], [20.0, -10.0], [20.0, 10.0], [-20.0, 10.0]])
    return square + np.array([[column, 150.0], [column, 180.0], [column, 210.0]])[:, None]


@pytest.fixture
def overlay() -> Overlay:
    pixels = np.random.default_rng(0).random((400, 300))
    panels = (Panel("Default stiffness", boxes(170.0), 7.25), Panel("Estimated stiffness", boxes(152.0), None))
    return Overlay(pixels, NAMES, boxes(150.0), panels, (0.5, 0.5), ("R", "L"), (180.0, 1.0, "60 N"))


@pytest.fixture
def ratio_map() -> RatioMap:
    angle = np.linspace(0.0, 2.0 * np.pi, 40)
    region = np.exp(np.log([0.2, 0.05]) + 0.2 * np.stack([np.cos(angle), np.sin(angle)], 1))
    path = np.array([[1.0, 1.0], [0.3, 0.1], [0.2, 0.05]])
    ends, truth = ((0.17, 0.24), (None, 0.06)), np.array([0.22, 0.06])
    return RatioMap(("bending", "tissue"), np.array([0.2, 0.05]), region, path, (0.005, 5.0), ends, truth)


def lines(axis, colour: str) -> list[np.ndarray]:
    return [line.get_xydata() for line in axis.lines if to_hex(line.get_color()) == colour.lower()]


def test_a_push_of_one_usable_frame_has_no_panel_of_its_curve(beside: Predictions) -> None:
    pushes = beside.pushes
    still = replace(pushes.trials[0], push="still")
    both = {"main": pushes.problems["main"], "still": pushes.problems["main"]}
    drawn = curve_picture(replace(beside, pushes=replace(pushes, problems=both, trials=(*pushes.trials, still))))
    assert drawn is not None
    assert [axis.get_title() for axis in drawn[1].axes] == ["Push “main”"]
    assert "push main: measured" in drawn[2] and "still" not in drawn[2]
    alone = replace(pushes, problems={"still": both["still"]}, trials=(still,))
    assert curve_picture(Predictions(alone, ())) is None


def test_frames_without_vertebrae_in_common_have_no_change_of_tilt(beside) -> None:
    """As where two frames of a push were annotated by hand, each with vertebrae of its own."""
    visit = SimpleNamespace(subject=SimpleNamespace(push=lambda name: SimpleNamespace(level=8.0)))
    drawn = tilt_picture(visit, beside)
    assert drawn is not None and "in 1 frame" in drawn[2]
    first, pushed = beside.pushes.trials
    names = first.trial.corners.vertebrae
    trials = [
        replace(one, trial=Trial(one.trial.load, one.trial.corners.selected(own), one.trial.view, "", one.push))
        for one, own in ((first, names[:5]), (pushed, names[5:]))
    ]
    apart = replace(beside.pushes, trials=tuple(trials))
    assert tilt_picture(visit, predictions_of(apart, stored(beside))) is None


def test_a_lost_corner_changes_no_measured_against_its_simulated_tilt(beside, monkeypatch) -> None:
    """Corners are those of the estimate's states, so measured and simulated changes are the same ones."""
    shown = []
    monkeypatch.setattr(pictures, "draw_tilt_changes", shown.extend)
    seen = beside.pushes.trials[1].trial.corners
    quality = np.ones(seen.corners.shape[:2])
    quality[5, 2] = 0.0
    visit = SimpleNamespace(subject=SimpleNamespace(push=lambda name: SimpleNamespace(level=8.0)))
    tilt_picture(visit, with_corners(beside, VertebraCorners(seen.vertebrae, seen.corners, quality)))
    (change,) = shown
    assert change.simulated["fit"] == pytest.approx(change.measured, abs=1e-6)
    assert abs(change.measured[5]) > 0.02


def with_corners(beside: Predictions, corners: VertebraCorners) -> Predictions:
    """The same with other corners in the frame under force."""
    first, pushed = beside.pushes.trials
    own = Trial(pushed.trial.load, corners, pushed.trial.view, "", pushed.push)
    trials = (first, replace(pushed, trial=own))
    return predictions_of(replace(beside.pushes, trials=trials), stored(beside))


def test_overlay_draws_measured_and_simulated_boxes_where_they_are(overlay: Overlay) -> None:
    figure = draw_overlay(overlay)
    assert len(figure.axes) == 2
    for axis, panel in zip(figure.axes, overlay.panels):
        for colour, wanted in ((MEASURED_ON_DARK, overlay.measured), (SIMULATED_ON_DARK, panel.boxes)):
            drawn = lines(axis, colour)
            assert len(drawn) == 3
            np.testing.assert_array_equal([line[:4] for line in drawn], wanted)
        image = axis.images[0]
        left, right, top, bottom = overlay.crop
        # A pixel's centre has whole coordinates.
        assert image.get_extent() == [left - 0.5, right + 0.5, bottom + 0.5, top - 0.5]
        np.testing.assert_array_equal(image.get_array(), overlay.pixels[top : bottom + 1, left : right + 1])
    titles = [axis.get_title() for axis in figure.axes]
    assert titles == ["Default stiffness\nRMSE 7.2 mm", "Estimated stiffness\nno prediction"]


def test_crop_holds_every_box_and_stays_inside_the_picture(overlay: Overlay) -> None:
    left, right, top, bottom = overlay.crop
    # At 0.5 mm a pixel: 150 mm about the boxes' middle (column 160), and 18 mm above and below them.
    assert (left, right, top, bottom) == (10, 299, 104, 256)
    moved = replace(overlay, measured=boxes(150.0) + [0.0, 170.0])
    assert moved.crop[3] == 399


def test_names_stand_on_the_side_that_the_push_leaves_free(overlay: Overlay) -> None:
    def place(direction: float) -> float:
        axis = draw_overlay(replace(overlay, arrow=(180.0, direction, "60 N"))).axes[0]
        return next(t.get_position()[0] for t in axis.texts if t.get_text() == "T11")

    assert place(1.0) > 250.0 and place(-1.0) < 50.0


def test_panel_of_other_vertebrae_is_refused(overlay: Overlay) -> None:
    with pytest.raises(SpinestiffError, match="panel 'odd' has 2 boxes, wanted 3"):
        replace(overlay, panels=(Panel("odd", boxes(150.0)[:2], 1.0),))


def test_flat_picture_is_drawn(overlay: Overlay) -> None:
    assert as_png(draw_overlay(replace(overlay, pixels=np.zeros((400, 300))))).startswith(b"\x89PNG")


def test_curves_show_all_points_by_role() -> None:
    measured = {
        "training": np.array([[20.0, -3.0, 0.5], [40.0, -6.5, 1.5]]),
        "validation": np.array([[60.0, -9.0, 1.0]]),
    }
    simulated = {"fit": np.array([[0.0, 0.0], [60.0, -9.5]]), "default": np.array([[0.0, 0.0], [60.0, -1.0]])}
    figure = draw_curve_changes([CurveChange("a", measured, simulated), CurveChange("b", measured, {})])
    first, second = figure.axes
    by_mark = {line.get_marker(): line.get_xydata() for line in first.lines}
    np.testing.assert_array_equal(by_mark["o"], measured["training"][:, :2])
    np.testing.assert_array_equal(by_mark["D"], measured["validation"][:, :2])
    bars = [bar for found in first.collections for bar in found.get_segments()]
    np.testing.assert_allclose(bars, [[[20, -3.5], [20, -2.5]], [[40, -8], [40, -5]], [[60, -10], [60, -8]]])
    np.testing.assert_array_equal(lines(first, FIT)[0], simulated["fit"])
    assert lines(second, FIT) == []


def test_tilts_run_from_head_to_foot() -> None:
    change = TiltChange("x", NAMES, np.array([-1.0, 0.0, 2.0]), {"fit": np.array([-0.9, 0.1, 1.8])}, 0.5)
    figure = draw_tilt_changes([change] * 5, columns=4)
    assert sum(axis.get_visible() for axis in figure.axes) == 5
    axis = figure.axes[0]
    low, high = axis.get_ylim()
    assert low > high  # the first vertebra is on top
    assert [label.get_text() for label in axis.get_yticklabels()] == list(NAMES)
    np.testing.assert_array_equal(lines(axis, MEASURED)[0], [[-1.0, 0.0], [0.0, 1.0], [2.0, 2.0]])


def test_ratio_map_shows_estimate_truth_and_path(ratio_map: RatioMap) -> None:
    whole, near = draw_ratio_map(ratio_map).axes
    for axis in (whole, near):
        marks = {line.get_marker(): line.get_xydata() for line in axis.lines}
        np.testing.assert_array_equal(marks["o"], [[0.2, 0.05]])
        np.testing.assert_array_equal(marks["*"], [[0.22, 0.06]])
        assert axis.get_xscale() == axis.get_yscale() == "log"
    assert any(len(line.get_xydata()) == 3 for line in whole.lines)
    assert whole.get_xlim()[1] > 1.0 > near.get_xlim()[1]


def test_ratio_map_ends_at_the_bounds_of_the_fit(ratio_map: RatioMap) -> None:
    huge = np.exp(20.0 * np.log(ratio_map.region))
    for axis in draw_ratio_map(replace(ratio_map, region=huge)).axes:
        assert axis.get_xlim()[0] >= 0.8 * 0.005 and axis.get_xlim()[1] <= 5.0 / 0.8


def test_ratio_map_without_region_or_truth(ratio_map: RatioMap) -> None:
    bare = replace(ratio_map, region=np.empty((0, 2)), truth=None)
    assert not draw_ratio_map(bare).axes[1].patches


def test_budget_bars_stand_at_their_unknowns_the_most_costly_on_top() -> None:
    shares = {"Bending": np.array([[0.1, 0.4], [0.3, 0.0]]), "Tissue": np.array([[0.7, 0.72], [0.0, 0.02]])}
    figure = draw_budget(BudgetBars(("trunk", "gauge"), shares))
    assert [axis.get_title() for axis in figure.axes] == ["Bending", "Tissue"]
    for axis, rows in zip(figure.axes, shares.values()):
        alone, gain = axis.containers
        np.testing.assert_allclose([bar.get_width() for bar in alone], 100.0 * rows[:, 0])
        np.testing.assert_allclose([bar.get_width() for bar in gain], 100.0 * rows[:, 1])
        for bars, colour in ((alone, "#a9a9a9"), (gain, FIT.lower())):
            assert {to_hex(bar.get_facecolor()) for bar in bars} == {colour}
        assert axis.get_xlim()[1] >= 100.0 * rows.max() and axis.get_ylim()[0] > axis.get_ylim()[1]
        for row, (above, below) in enumerate(zip(alone, gain)):
            assert above.get_y() + above.get_height() == pytest.approx(row - 0.01, abs=1e-9)
            assert below.get_y() == pytest.approx(row + 0.01, abs=1e-9)
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == ["trunk", "gauge"]


def test_files_are_the_same_each_time_and_hold_no_date(ratio_map: RatioMap) -> None:
    first, second = (as_svg(draw_ratio_map(ratio_map)) for _ in range(2))
    assert first == second
    assert ElementTree.fromstring(first).tag.endswith("svg")
    assert b"date" not in first.lower().split(b"<g")[0]
    pictures = [as_png(draw_ratio_map(ratio_map)) for _ in range(2)]
    assert pictures[0] == pictures[1]
    assert b"tEXt" not in pictures[0] and b"tIME" not in pictures[0]


def test_no_global_state_is_left() -> None:
    from matplotlib import rcParams

    before = dict(rcParams)
    as_svg(draw_tilt_changes([TiltChange("x", NAMES, np.zeros(3), {})]))
    assert dict(rcParams) == before


def test_overlay_draws_pedicles_where_they_are_and_shows_them_all(overlay: Overlay) -> None:
    seen, made = np.array([[130.0, 150.0], [170.0, 90.0]]), np.array([[135.0, 152.0], [178.0, 91.0]])
    panels = tuple(replace(panel, pedicles=made) for panel in overlay.panels)
    figure = draw_overlay(replace(overlay, panels=panels, pedicles=seen))
    for axis in figure.axes:
        for colour, wanted in ((MEASURED_ON_DARK, seen), (SIMULATED_ON_DARK, made)):
            np.testing.assert_array_equal(lines(axis, colour)[-1], wanted)
        assert axis.get_ylim()[1] < 90.0 - 30.0
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert words == ["measured", "simulated", "pedicles, measured", "pedicles, simulated"]
    with pytest.raises(SpinestiffError, match="panel 'Default stiffness' has 0 pedicles, wanted 2"):
        replace(overlay, pedicles=seen)
