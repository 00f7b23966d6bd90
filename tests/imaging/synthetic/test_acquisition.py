"""Sequences: what moves, what stays, what lies behind lead."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.names import RIBS, VERTEBRAE
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import retract
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.errors import RadiographError
from spinestiff.imaging.projection import frontal_view
from spinestiff.imaging.synthetic.acquisition import Acquisition, Gauge, acquire
from spinestiff.imaging.synthetic.bowel import bowel
from spinestiff.imaging.synthetic.breathing import Breathing, breathed
from spinestiff.imaging.synthetic.collimation import Collimation
from spinestiff.imaging.synthetic.detector import AIR_GREY, Exposure
from spinestiff.imaging.synthetic.gauge import PAD_RADIUS, gauge_pad
from spinestiff.imaging.synthetic.materials import Material
from spinestiff.imaging.synthetic.path_length import path_length
from spinestiff.mechanics.loads import rib_push

VIEW = frontal_view(shape=(200, 200), pixel=2.1)
STILL = Acquisition(breathing=None, gas=0.0, bowel_motion=0.0, exposure_drift=0.0, samples=1)


@pytest.fixture(scope="module")
def torso() -> TorsoModel:
    return template_torso(157.0)


def frames(torso: TorsoModel, count: int = 1, **how: object) -> np.ndarray:
    keys = {key: how.pop(key) for key in ("seed", "person", "gauge") if key in how}
    states = [torso.rest_pose] * count
    return np.stack(list(acquire(torso, states, VIEW, replace(STILL, **how), **keys))).astype(float)  # type: ignore[arg-type]


def push_points(torso: TorsoModel) -> PointsOnBones:
    bone = torso.bone("R8_L")
    place = torso.surface_positions(torso.rest_pose, bone)
    return PointsOnBones.at(torso.rest_pose, np.array([bone]), place[[np.argmax(place[:, 0])]])


def test_breathing_lifts_ribs_and_sternum_by_millimetres_and_leaves_vertebrae(torso: TorsoModel) -> None:
    rest = torso.rest_pose
    state = breathed(torso, rest, 3.0)
    spine = torso.vertebra_bones
    np.testing.assert_array_equal(state.bone_positions[spine], rest.bone_positions[spine])
    np.testing.assert_array_equal(state.bone_rotations[spine], rest.bone_rotations[spine])
    np.testing.assert_array_equal(state.tissue_positions, rest.tissue_positions)

    def way(name: str, pick: object) -> np.ndarray:
        bone = torso.bone(name)
        before, after = (torso.surface_positions(s, bone) for s in (rest, state))
        away = np.linalg.norm(before - rest.bone_positions[torso.bone("T" + name[1:].split("_")[0])], axis=1)
        return np.asarray((after - before)[pick(away)])  # type: ignore[operator]

    for name in [n for n in RIBS if 2 <= int(n[1:].split("_")[0]) <= 10]:
        front, head = way(name, np.argmax), way(name, np.argmin)
        assert 2.0 < front[1] < 4.0
        assert np.linalg.norm(head) < 0.5
    # Bucket handle: the side of a lower rib rises and goes outward, on both sides alike.
    outward = [way(f"R8_{side}", lambda away: np.argsort(away)[len(away) // 2])[0] for side in "LR"]
    assert outward[0] > 0.1
    assert outward[1] == pytest.approx(-outward[0], abs=0.05)
    sternum = state.bone_positions[torso.bone("sternum")] - rest.bone_positions[torso.bone("sternum")]
    assert 2.0 < sternum[1] < 4.0
    assert sternum[2] > 0.2  # forward: pump handle


def test_a_sequence_breathes(torso: TorsoModel) -> None:
    breathing = Breathing(rise=3.0, diaphragm=8.0, period=1.0)
    quiet = Exposure(photons=1e9, electronic_noise=0.0)
    moving = frames(torso, 3, breathing=breathing, exposure=quiet)
    held = frames(torso, 3, exposure=quiet)
    spine = np.rint(VIEW.pixels(VIEW.project(torso.rest_pose.bone_positions[torso.bone("L4")]))).astype(int)
    around = np.s_[spine[1] - 8 : spine[1] + 8, spine[0] - 8 : spine[0] + 8]
    change = np.abs(moving[1] - moving[0])
    assert np.abs(held[1] - held[0]).max() < 40.0
    assert change.max() > 1000.0
    assert change[around].max() < 0.05 * change.max()
    phases = [breathing.phase(t, 0.3) for t in (0.0, 0.5, 1.0)]
    assert phases[0] == pytest.approx(-phases[1]) == pytest.approx(phases[2])


def test_the_seeds_decide_everything(torso: TorsoModel) -> None:
    how = {"breathing": Breathing(), "gas": 1.0, "bowel_motion": 2.0, "exposure_drift": 0.06}
    first = frames(torso, 2, seed=5, **how)
    np.testing.assert_array_equal(first, frames(torso, 2, seed=5, **how))
    assert np.abs(first - frames(torso, 2, seed=6, **how)).max() > 100.0
    # Noise and the body's textures alone: nothing moves, nothing drifts, no gas.
    still = frames(torso, 2, seed=5, exposure=Exposure(photons=1e4))
    assert (still[0] != still[1]).mean() > 0.9
    assert (still != frames(torso, 2, seed=6, exposure=Exposure(photons=1e4))).mean() > 0.9
    quiet = Exposure(photons=1e9, electronic_noise=0.0)
    change = np.abs(frames(torso, person=5, exposure=quiet) - frames(torso, person=9, exposure=quiet))[0]
    spine = np.rint(VIEW.pixels(VIEW.project(torso.rest_pose.bone_positions[torso.bone("T8")]))).astype(int)
    assert change[spine[1] - 5 : spine[1] + 5, spine[0] - 4 : spine[0] + 4].max() > 100.0
    assert change[60:100, 60:80].max() > 200.0  # a lung


def test_exposure_wanders_from_frame_to_frame(torso: TorsoModel) -> None:
    assert np.ptp(np.median(frames(torso, 4), axis=(1, 2))) < 100.0
    drift = np.median(frames(torso, 4, exposure_drift=0.1), axis=(1, 2))
    assert 200.0 < np.ptp(drift) < 8000.0 * 0.6


def test_bubbles_are_air_inside_the_belly_and_move(torso: TorsoModel) -> None:
    still, moved = (bowel(torso, torso.rest_pose, 3, 1.0, motion, np.random.default_rng(1))[1] for motion in (0.0, 4.0))
    again = bowel(torso, torso.rest_pose, 3, 1.0, 0.0, np.random.default_rng(2))[1]
    np.testing.assert_array_equal(still.vertices, again.vertices)
    way = np.linalg.norm(moved.vertices - still.vertices, axis=1)
    assert 2.0 < np.median(way) < 12.0
    assert still.density < -0.9
    assert path_length(still.vertices, still.faces, VIEW).min() > -1e-9
    skin = torso.node_positions(torso.rest_pose)
    assert (still.vertices > skin.min(axis=0)).all()
    assert (still.vertices < skin.max(axis=0)).all()
    (contents,) = bowel(torso, torso.rest_pose, 3, 0.0, 1.0, np.random.default_rng(1))
    assert contents.texture is not None
    assert abs(contents.density) < 0.1


def test_the_pad_lies_outside_the_skin_and_moves_with_the_rib(torso: TorsoModel) -> None:
    points, push = push_points(torso), np.array([[-1.0, 0.0, 0.0]])
    rest = torso.rest_pose
    cushion, plate, rod = gauge_pad(torso, rest, points, push)
    rib = points.positions(rest)[0]
    assert cushion.vertices[:, 0].min() > rib[0] + 5.0
    assert plate.vertices[:, 0].min() > cushion.vertices[:, 0].min()
    assert rod.vertices[:, 0].max() > plate.vertices[:, 0].max() + 100.0
    assert np.ptp(plate.vertices[:, 1]) == pytest.approx(2.0 * PAD_RADIUS)
    assert plate.material == Material.ALUMINIUM
    for body in (cushion, plate, rod):
        assert path_length(body.vertices, body.faces, VIEW).min() > -1e-9
    dx = np.zeros(rest.dofs)
    dx[6 * points.bone[0] + 1] = 7.0
    moved = gauge_pad(torso, retract(rest, dx), points, push)[1]
    assert moved.vertices[:, 1].mean() - plate.vertices[:, 1].mean() == pytest.approx(7.0)
    picture, without = frames(torso, gauge=Gauge(points, push))[0], frames(torso)[0]
    column, row = np.rint(VIEW.pixels(VIEW.project(plate.vertices.mean(axis=0)))).astype(int)
    assert picture[row, column] > without[row, column] + 1000.0


@pytest.mark.parametrize(("level", "share"), [(8.0, 0.0), (8.25, 0.25), (8.5, 0.5)])
def test_the_pad_lies_where_the_force_acts(torso: TorsoModel, level: float, share: float) -> None:
    load, rest = rib_push(torso, "left", level, 40.0), torso.rest_pose
    upper, lower = load.points.positions(rest)[:, 1]
    plate = gauge_pad(torso, rest, load.points, load.forces)[1]
    assert plate.vertices[:, 1].mean() == pytest.approx(upper + share * (lower - upper))


def test_nothing_but_scatter_comes_behind_the_blades(torso: TorsoModel) -> None:
    blades = Collimation(top=100.0, left=60.0)
    quiet = Exposure(photons=1e9, scatter_fraction=0.0, haze=0.0, electronic_noise=0.0)
    shut = frames(torso, collimation=blades, exposure=quiet)[0]
    full = frames(torso, exposure=quiet)[0]
    first, last = blades.field(VIEW)
    row, column = int(first[1]), int(first[0])
    np.testing.assert_allclose(shut[row + 4 :, column + 4 :], full[row + 4 :, column + 4 :], atol=60.0)
    open_air = np.zeros_like(full, dtype=bool)
    open_air[:, : column - 4] = full[:, : column - 4] < AIR_GREY + 100.0
    assert open_air.sum() > 500
    np.testing.assert_allclose(shut[open_air], AIR_GREY + 8000.0 * np.log(1e3), atol=200.0)  # unexposed is white
    np.testing.assert_allclose(last, 199.5)
    t1 = VIEW.pixels(VIEW.project(torso.rest_pose.bone_positions[torso.bone(VERTEBRAE[0])]))
    assert t1[1] < first[1]


def test_blades_out_of_the_picture_change_nothing_and_closed_ones_are_refused() -> None:
    np.testing.assert_array_equal(Collimation().open_beam(VIEW), 1.0)
    with pytest.raises(RadiographError, match="leaves nothing"):
        Collimation(left=300.0, right=300.0).field(VIEW)
    with pytest.raises(RadiographError, match="wanted 0 mm or more"):
        Collimation(top=-1.0)
    # Of numbers and NaN, the order in which they stand says which is the least.
    with pytest.raises(RadiographError, match="wanted 0 mm or more"):
        Collimation(right=np.nan)


@pytest.mark.parametrize(
    "change", [{"gas": -1.0}, {"exposure_drift": np.nan}, {"frame_time": -0.1}, {"bowel_motion": -1}]
)
def test_impossible_acquisitions_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(RadiographError, match="wanted 0 or more"):
        Acquisition(**change)  # type: ignore[arg-type]


@pytest.mark.parametrize("change", [{"rise": -1.0}, {"period": 0.0}, {"diaphragm": np.nan}])
def test_impossible_breathing_is_refused(change: dict[str, float]) -> None:
    with pytest.raises(RadiographError, match="breathing by"):
        Breathing(**change)
