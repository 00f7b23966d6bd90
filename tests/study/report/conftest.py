"""A push that is seen from the side and by cameras, too, for the report and the viewer."""

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
from spinestiff.study.synthetic.markers import spread_markers
from spinestiff.study.trials import push_set
from spinestiff.subject.records import PushRecord

SEEN = slice(2, 16)
MOVED = np.array([6.0, 0.0, 0.0])
OFFSET = np.array([30.0, -20.0, 10.0])
"""Where the cameras take the origin to be, against the torso's."""


@pytest.fixture(scope="session")
def beside() -> Predictions:
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

    def pedicles(view: str, state: TorsoState) -> PediclePoints:
        centres = pedicle_centres(torso)[SEEN]
        bones = np.repeat(torso.vertebra_bones[SEEN], 2)
        places = PointsOnBones(bones, centres.reshape(-1, 3)).positions(state)
        seen = views[view].project(places).reshape(-1, 2, 2)
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
        side = Picture(corners("lateral", state), views["lateral"], "side", "main aside", pedicles("lateral", state))
        own = pedicles("frontal", state)
        trial = replace(item.trial, further=(side,), pedicles=own, markers=markers(state))
        trials.append(replace(item, trial=trial))
    pushes = replace(pushes, trials=tuple(trials))
    supports = pushes.problems["main"].supports
    reactions = np.zeros((int(supports.held.any(1).sum()) + len(supports.names), 3))
    solved = {("main", 1, name): Solved(at(share), reactions) for name, share in (("fit", 1.0), ("default", 0.5))}
    return predictions_of(pushes, solved)
