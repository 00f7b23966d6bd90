"""Further views, pedicles and skin markers in the report: what is told of them and what is drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from results import tracked_push
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.template import template_torso
from spinestiff.estimation.objective import Picture, SkinMarkers
from spinestiff.imaging.features import VertebraCorners, silhouette_shares, state_features
from spinestiff.imaging.pedicles import PediclePoints, pedicle_centres
from spinestiff.imaging.projection import frontal_view, lateral_view
from spinestiff.study.predictions import Predictions, Solved, predictions_of
from spinestiff.study.report.beside import MarkerMotion, beside_pictures, beside_rows, draw_markers
from spinestiff.study.synthetic import spread_markers
from spinestiff.study.trials import push_set
from spinestiff.subject.records import PushRecord

SEEN = slice(2, 16)
MOVED = np.array([6.0, 0.0, 0.0])
OFFSET = np.array([30.0, -20.0, 10.0])
"""Where the cameras take the origin to be, against the torso's."""


@pytest.fixture(scope="module")
def predictions() -> Predictions:
    """A push that moves the whole torso by ``MOVED``, as the estimate says; the default moves it half as far."""
    torso = template_torso(157.0, "coarse")
    middle = torso.rest_pose.bone_positions[torso.vertebra_bones][[0, -1]].mean(0) * [0.0, 1.0, 0.0]
    views = {"frontal": frontal_view(centre=middle), "lateral": lateral_view(centre=middle)}

    def at(share: float) -> TorsoState:
        rest = torso.rest_pose
        return TorsoState(
            rest.bone_positions + share * MOVED, rest.bone_rotations, rest.tissue_positions + share * MOVED
        )

    def corners(view: str, state: TorsoState) -> VertebraCorners:
        shares = silhouette_shares(torso, views[view], torso.rest_pose)
        seen = state_features(torso, views[view], state, shares).corners
        return VertebraCorners(torso.vertebrae, seen).selected(torso.vertebrae[SEEN])

    def pedicles(state: TorsoState) -> PediclePoints:
        centres = pedicle_centres(torso)[SEEN]
        bones = np.repeat(torso.vertebra_bones[SEEN], 2)
        places = PointsOnBones(bones, centres.reshape(-1, 3)).positions(state)
        seen = views["frontal"].project(places).reshape(-1, 2, 2)
        return PediclePoints(torso.vertebrae[SEEN], seen)

    points, outward = spread_markers(torso, 8, torso.rest_pose.bone_positions[:1])

    def markers(state: TorsoState) -> SkinMarkers:
        names = tuple(f"m{i}" for i in range(8))
        positions = points.positions(torso, state) + OFFSET
        positions[0] = np.nan
        return SkinMarkers(names, positions, points, outward, "main markers")

    states = [at(0.0), at(1.0)]
    push = PushRecord(
        id="main", side="left", level=8.0, d21_mm=400.0, d31_mm=200.0, frames="m.dcm", forces_n=(0.0, 40.0),
        roles=("unused", "training"),
    )  # fmt: skip
    tracked = tracked_push(views["frontal"], push.forces_n, [corners("frontal", state) for state in states])
    pushes = push_set(torso, [push], {"main": tracked})
    trials = []
    for item, state in zip(pushes.trials, states):
        side = Picture(corners("lateral", state), views["lateral"], "side", "main aside")
        trial = replace(item.trial, further=(side,), pedicles=pedicles(state), markers=markers(state))
        trials.append(replace(item, trial=trial))
    pushes = replace(pushes, trials=tuple(trials))
    solved = {
        ("main", 1, name): Solved(at(share), np.zeros((0, 3))) for name, share in (("fit", 1.0), ("default", 0.5))
    }
    return predictions_of(pushes, solved)


def test_every_sight_is_told_with_its_distance_to_each_model(predictions: Predictions) -> None:
    rows = beside_rows(predictions)
    assert [row["what"] for row in rows] == [
        "28 pedicles, the frontal radiograph",
        "corners of 14 vertebrae, view “aside”",
        "7 skin markers, their motion",
    ]
    assert {(row["frame"], row["role"]) for row in rows} == {("“main”, frame 1, 40 N", "fitted")}
    pedicles, corners, markers = ([float(cell) for cell in row["cells"]] for row in rows)
    # A motion across the frontal picture; the side's radiograph shows what comes nearer as a little larger.
    assert pedicles == pytest.approx([6.0, 3.0, 0.0], abs=0.35)
    assert corners[0] > 1.5 * corners[1] > 0.0 and corners[2] < 0.05
    # Where the cameras were does not count: only motion does.
    assert markers == pytest.approx([6.0, 3.0, 0.0], abs=0.01)


def test_a_view_and_markers_are_drawn(predictions: Predictions) -> None:
    asked = []

    def pixels(push: str, frame: int, view: str) -> np.ndarray:
        asked.append((push, frame, view))
        return np.zeros(lateral_view().shape)

    (view, _, alt, _), (markers, figure, said, caption) = beside_pictures(predictions, pixels)
    assert asked == [("main", 1, "aside")]
    assert (view, markers) == ("view-aside-main", "skin-markers")
    assert "view “aside” of push “main”, frame 1, 40 N" in alt and "estimated stiffness 0.0 mm" in alt
    assert "“main”, 40 N: moved by 6.0 mm, the estimate is 0.0 mm off" in said and "true size" in caption
    assert len(figure.axes) == 2


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


def test_without_any_nothing_is_told(predictions: Predictions) -> None:
    bare = tuple(
        replace(item, trial=replace(item.trial, further=(), pedicles=None, markers=None))
        for item in predictions.pushes.trials
    )
    solved = {("main", 1, "fit"): Solved(predictions.pushes.torso.rest_pose, np.zeros((0, 3)))}
    plain = predictions_of(replace(predictions.pushes, trials=bare), solved)
    assert beside_rows(plain) == [] and beside_pictures(plain, lambda *_: np.zeros((1, 1))) == []
