"""What the models make of every frame: each equilibrium is solved once, from the least force up, and stored."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from results import tracked_push
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.curves.changes import change_between
from spinestiff.errors import EquilibriumError, SubjectError
from spinestiff.estimation.evaluation import FOLDED
from spinestiff.estimation.priors import Priors
from spinestiff.estimation.unknowns import ACTS
from spinestiff.imaging.features import VertebraCorners, silhouette_shares, state_features
from spinestiff.imaging.projection import frontal_view
from spinestiff.mechanics.places import SupportPlace
from spinestiff.mechanics.push import Rig
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.study import predictions
from spinestiff.study.predictions import (
    REST,
    STATES_SCHEMA,
    Model,
    Solved,
    of_equilibria,
    predict,
    predicted_acts,
    predictions_of,
    read_solved,
    stored,
    with_fitted_supports,
    write_solved,
)
from spinestiff.study.trials import push_set
from spinestiff.subject.records import PushRecord

ROLES = ("unused", "validation", "training", "unused")
SOFT, STIFF = (stiffness_ratios({"tissue": ratio}) for ratio in (0.1, 2.0))


class Noting:
    """Stands in for an equilibrium problem: notes what it is asked, and moves all bones by a millimetre per newton."""

    def __init__(self, torso, fails=()):
        self.torso, self.fails, self.asked, self.turns = torso, fails, [], []
        self.supports = three_point_supports(torso, "right")

    def with_place(self, place):
        return self

    def solve_linearised(self, load, model, start, largest_turn):
        self.asked.append((round(load.size), model, start))
        self.turns.append(largest_turn)
        rest = self.torso.rest_pose
        state = TorsoState(rest.bone_positions + load.size, rest.bone_rotations, rest.tissue_positions)
        if (round(load.size), model) in self.fails:
            raise EquilibriumError("Newton's steps became too short")
        reactions = [SimpleNamespace(force=np.full(3, load.size))]
        return SimpleNamespace(state=state, reactions=reactions), SimpleNamespace(state=state)


@pytest.fixture(scope="module")
def torso():
    return template_torso(157.0, "coarse")


@pytest.fixture(scope="module")
def rest(torso):
    view = frontal_view()
    shares = silhouette_shares(torso, view, torso.rest_pose)
    seen = state_features(torso, view, torso.rest_pose, shares).corners
    return VertebraCorners(torso.vertebrae, seen).selected(torso.vertebrae[2:16])


def make_set(torso, frames, forces, roles=ROLES, rig=None):
    push = PushRecord(
        id="main", side="right", level=8.0, d21_mm=400.0, d31_mm=200.0, frames="m.dcm", forces_n=forces, roles=roles
    )
    return push_set(torso, [push], {"main": tracked_push(frontal_view(), forces, frames)}, rig=rig or Rig())


def noting(pushes, *fails):
    problem = Noting(pushes.torso, fails)
    return replace(pushes, problems={"main": problem}), problem


def quiet(line):
    pass


def test_every_frame_is_solved_once_from_the_least_force_up(torso, rest):
    pushes, problem = noting(make_set(torso, [rest] * 4, (0.0, 30.0, 10.0, 20.0)))
    lines = []
    found = predict(pushes, {"default": Model(), "fit": Model(SOFT)}, {}, lines.append)
    for model in (None, SOFT):  # in turn or side by side
        assert [force for force, whose, _ in problem.asked if whose is model] == [10, 20, 30]
    # Each model goes on from what it found under the force before.
    starts = [start for _, model, start in problem.asked if model is SOFT]
    states = {p.item.force_n: p.states["fit"] for p in found.frames}
    assert starts[0] is None and starts[1].state is states[10.0] and starts[2].state is states[20.0]
    # A torso that gives way predicts nothing, as it tells the fit nothing.
    assert problem.turns == [FOLDED] * 6
    assert [p.item.frame for p in found.frames] == [1, 2, 3]
    assert set(found.frames[0].states) == {REST, "default", "fit"}
    assert "push 'main' frame 2: default at 10 N" in lines and len(lines) == 6
    np.testing.assert_array_equal(found.frames[0].solved["fit"].reactions, np.full((1, 3), 30.0))


def test_what_is_known_is_not_solved_again(torso, rest):
    pushes, problem = noting(make_set(torso, [rest] * 4, (0.0, 30.0, 10.0, 20.0)))
    known = Solved(torso.rest_pose, np.ones((1, 3)))
    found = predict(pushes, {"fit": Model(SOFT)}, {("main", 2, "fit"): known}, quiet)
    assert [force for force, _, _ in problem.asked] == [20, 30]
    # It is where the next one starts, and it is among what is stored.
    assert problem.asked[0][2] is known.state
    assert stored(found)["main", 2, "fit"] is known
    assert set(stored(found)) == {("main", frame, "fit") for frame in (1, 2, 3)}
    again, problem = noting(pushes)
    predict(again, {"fit": Model(SOFT)}, stored(found), quiet)
    assert problem.asked == []


def test_supports_out_of_reach_cost_one_prediction_and_not_all(torso, rest):
    pushes, _ = noting(make_set(torso, [rest] * 4, (0.0, 30.0, 10.0, 20.0)))
    lines = []
    far = Model(SOFT, {"obliquity under pushes from the right": 100.0})
    assert np.abs(predicted_acts(pushes, pushes.of_role("validation"), far)).max() > 0.5
    found = predict(pushes, {"default": Model(), "fit": far}, {}, lines.append)
    assert all(set(p.states) == {REST, "default"} for p in found.frames)
    assert sum("no prediction by 'fit': supports at an obliquity of" in line for line in lines) == 3


def test_other_models_predict_the_held_out_frames_alone(torso, rest):
    pushes, problem = noting(make_set(torso, [rest] * 4, (0.0, 30.0, 10.0, 20.0)))
    found = predict(pushes, {"fit": Model(SOFT), "truth": Model()}, {}, quiet)
    assert [force for force, model, _ in problem.asked if model is None] == [30]
    assert ["truth" in p.states for p in found.frames] == [True, False, False]
    assert [p.item.role for p in found.of_role("validation", "training")] == ["validation", "training"]


def test_other_models_start_where_the_fit_is_and_go_on_from_their_own_frame_before(torso, rest):
    frames, forces = (rest, rest, rest, rest), (0.0, 20.0, 40.0, 60.0)
    pushes, problem = noting(make_set(torso, frames, forces, ("unused", "validation", "training", "validation")))
    found = predict(pushes, {"truth": Model(STIFF), "fit": Model(SOFT)}, {}, quiet)
    of_fit, own = (found.frames[0].solved[name].state for name in ("fit", "truth"))
    (_, first), (_, second) = [(force, start) for force, model, start in problem.asked if model is STIFF]
    assert first is of_fit and second.state is own
    # Where the fit has none, from rest.
    pushes, problem = noting(make_set(torso, frames, forces, ("unused", "validation", "training", "validation")))
    predict(pushes, {"truth": Model(STIFF)}, {}, quiet)
    assert problem.asked[0] == (20, STIFF, None)


def test_a_model_without_an_equilibrium_is_said_and_left_out(torso, rest):
    pushes, problem = noting(make_set(torso, [rest] * 4, (0.0, 30.0, 10.0, 20.0)), (20, None))
    lines = []
    found = predict(pushes, {"default": Model(), "fit": Model(SOFT)}, {}, lines.append)
    by_force = {p.item.force_n: p for p in found.frames}
    assert set(by_force[20.0].states) == {REST, "fit"} and set(by_force[30.0].states) == {REST, "fit", "default"}
    assert any(line.startswith("push 'main' frame 3: no prediction by 'default': ") for line in lines)
    # The next force starts from the last one that was found.
    last = [start for _, model, start in problem.asked if model is None][-1]
    assert last.state is by_force[10.0].states["default"]


def test_errors_and_boxes_are_those_of_the_state(torso, rest):
    """At rest the boxes lie on the corners that were measured; a millimetre aside they are a millimetre off."""
    pushes = make_set(torso, [rest] * 2, (0.0, 30.0), ("unused", "training"))
    moved = torso.rest_pose.bone_positions + [1.0, 0.0, 0.0]
    aside = TorsoState(moved, torso.rest_pose.bone_rotations, torso.rest_pose.tissue_positions)
    (found,) = predictions_of(pushes, {("main", 1, "fit"): Solved(aside, np.zeros((0, 3)))}).frames
    assert found.rmse(torso, REST) < 1e-6
    assert found.rmse(torso, "fit") == pytest.approx(1.0, abs=0.05)
    assert found.boxes(torso, "fit").shape == (14, 4, 2)
    apart = found.boxes(torso, "fit") - found.target.z
    assert np.sqrt(np.mean(np.sum(apart**2, -1))) == pytest.approx(found.rmse(torso, "fit"), rel=1e-6)


def test_a_change_is_measured_from_the_least_force(torso, rest):
    """Where even the least force is none at rest, the models' change starts from what they make of that frame."""
    bent = VertebraCorners(rest.vertebrae, rest.corners + np.linspace(0.0, 3.0, 14)[:, None, None] ** 2)
    loaded = make_set(torso, [rest, bent], (5.0, 30.0), ("unused", "training"))
    start = TorsoState(torso.rest_pose.bone_positions, torso.rest_pose.bone_rotations, torso.rest_pose.tissue_positions)
    solved = {("main", frame, "fit"): Solved(start, np.zeros((0, 3))) for frame in (0, 1)}
    found = predictions_of(loaded, solved)
    last = found.frames[-1]
    assert found.before(last.item, "fit") is start
    assert found.before(last.item, "default") is None
    assert found.simulated_change(last, "default") is None
    measured = found.measured_change(last.item)
    trials = {t.frame: t.trial for t in loaded.trials}
    assert measured == change_between(trials[1].view, trials[0].corners, trials[1].corners)
    change = found.simulated_change(last, "fit")
    assert (change.signed, change.fixed_levels, change.tilt) == (0.0, 0.0, 0.0)
    assert change.levels == measured.levels
    unloaded = predictions_of(make_set(torso, [rest, bent], (0.0, 30.0), ("unused", "training")), {})
    assert unloaded.before(unloaded.frames[-1].item, "fit") is torso.rest_pose


# What is not quite known, in frames that a fit has not seen

DEGREE = np.pi / 180.0
ELASTIC = np.sqrt(3.0**2 - 1.0**2) * DEGREE


def with_supports(pushes, **seen):
    """The same set, with the supports of its frames measured: frame -> name -> value and sd."""
    measured = {int(name[1:]): found for name, found in seen.items()}
    trials = tuple(replace(t, trial=replace(t.trial, supports=measured.get(t.frame, {}))) for t in pushes.trials)
    return replace(pushes, trials=trials)


@pytest.fixture(scope="module")
def pushed(torso, rest):
    """Two held-out frames, one of them of less force, and a training frame."""
    return make_set(torso, [rest] * 4, (0.0, 60.0, 40.0, 30.0), ("unused", "validation", "training", "validation"))


def acts_of(pushes, known, *frames):
    items = [next(t for t in pushes.trials if t.frame == frame) for frame in frames]
    return [dict(zip(ACTS, row)) for row in predicted_acts(pushes, items, Model(SOFT, known))]


KNOWN = {
    "obliquity under pushes from the right": 0.5,
    "obliquity in push 'main' frame 2": 2.0,
    "breathing in push 'main' frame 2": 1.0,
    "force of main": -1.5,
    "trunk breadth": 1.0,
}


def test_held_out_frames_take_what_they_share_and_no_frame_s_own_part(pushed):
    full, training, less = acts_of(pushed, KNOWN, 1, 2, 3)
    assert full["obliquity"] == pytest.approx(0.5 * ELASTIC)
    assert less["obliquity"] == pytest.approx(0.5 * 0.5 * ELASTIC)
    assert training["obliquity"] == pytest.approx(0.5 * ELASTIC * 40.0 / 60.0 + 2.0 * DEGREE)
    assert [found["force"] for found in (full, training, less)] == pytest.approx([-0.03] * 3)
    assert [found["tissue"] for found in (full, training, less)] == pytest.approx([0.072] * 3)
    assert [found["height"] for found in (full, training, less)] == [0.0, 2.0, 0.0]
    assert full["shoulder"] == 0.0


def test_a_push_from_the_other_side_shares_neither_supports_nor_gauge(pushed, torso, rest):
    push = PushRecord(
        id="other", side="left", level=8.0, d21_mm=400.0, d31_mm=200.0, frames="o.dcm", forces_n=(0.0, 60.0),
        roles=("unused", "training"),
    )  # fmt: skip
    other = push_set(torso, [push], {"other": tracked_push(frontal_view(), (0.0, 60.0), [rest, rest])})
    (found,) = acts_of(other, KNOWN, 1)
    assert {name for name, value in found.items() if value} == {"tissue"}


def test_measured_supports_of_a_held_out_frame_count_as_far_as_they_are_sure(pushed):
    """The frame's own degree about what the compliance says, beside a measurement: the mean by their precisions."""
    expected, sd = 0.5 * ELASTIC, 0.5 * DEGREE
    seen = with_supports(pushed, f1={"obliquity": (3.0 * DEGREE, sd), "shoulder": (-2.0, 1e-6)})
    (found,) = acts_of(seen, KNOWN, 1)
    assert found["obliquity"] == pytest.approx(expected + (3.0 * DEGREE - expected) / (1.0 + 0.5**2))
    # Nothing is known of this side's shoulder.
    assert found["shoulder"] == pytest.approx(-2.0)
    # What a fit has seen of a frame is in what it found, and is not counted again.
    fitted = with_supports(pushed, f2={"obliquity": (9.0 * DEGREE, sd)})
    (training,), (before,) = acts_of(fitted, KNOWN, 2), acts_of(pushed, KNOWN, 2)
    assert training["obliquity"] == before["obliquity"]


def test_default_stiffness_is_pushed_as_the_gauge_says_on_a_level_pelvis(pushed):
    seen = with_supports(pushed, f1={"obliquity": (3.0 * DEGREE, 0.5 * DEGREE)})
    (found,) = acts_of(seen, {}, 1)
    assert not any(found.values())


@pytest.mark.slow
def test_fitted_supports_stand_beside_and_change_no_prediction(torso, rest, monkeypatch):
    """A held-out frame whose pelvis turned by 2.5 degrees: its prediction knows nothing of it."""
    forces, roles = (0.0, 20.0, 30.0), ("unused", "training", "validation")
    pushes = make_set(torso, [rest] * 3, forces, roles)
    (item,) = pushes.of_role("validation")
    problem = pushes.problems["main"].with_place(SupportPlace(2.5 * DEGREE, 0.0))
    state = problem.solve(item.trial.load, SOFT).require().state
    shares = silhouette_shares(torso, frontal_view(), torso.rest_pose)
    seen = VertebraCorners(torso.vertebrae, state_features(torso, frontal_view(), state, shares).corners)
    pushes = make_set(torso, [rest, rest, seen.selected(rest.vertebrae)], forces, roles)
    alone = predict(pushes, {"fit": Model(SOFT, {"force of main": 0.0})}, {}, quiet)
    both = with_fitted_supports(alone, Model(SOFT, {"force of main": 0.0}))
    (before,), (after,) = alone.of_role("validation"), both.of_role("validation")
    assert after.solved["fit"] is before.solved["fit"]
    turn = after.states["fitted_supports"].bone_rotations[torso.bone("pelvis")] @ (
        torso.rest_pose.bone_rotations[torso.bone("pelvis")].T
    )
    assert np.degrees(np.arctan2(turn[1, 0], turn[0, 0])) == pytest.approx(2.5, abs=0.1)
    assert after.rmse(torso, "fitted_supports") < 0.1 < 1.0 < after.rmse(torso, "fit")
    with monkeypatch.context() as patch:
        patch.setattr(predictions, "FITTED_ROUNDS", 1)
        (unsettled,) = with_fitted_supports(alone, Model(SOFT, {"force of main": 0.0})).of_role("validation")
        assert "fitted_supports" not in unsettled.solved
    known = dict.fromkeys(("obliquity_deg", "frame_obliquity_deg", "shoulder_mm", "frame_shoulder_mm"), 0.0)
    held = replace(pushes, known=replace(pushes.known, priors=Priors(**known)))
    (without,) = with_fitted_supports(replace(alone, pushes=held), Model(SOFT)).of_role("validation")
    assert "fitted_supports" not in without.solved


@pytest.mark.slow
@pytest.mark.parametrize("pelvis", ["level", "hinge"])
def test_a_shoulder_alone_is_fitted_where_the_pelvis_is_no_unknown(torso, rest, pelvis):
    """A held-out frame whose shoulder gave way by 4 mm."""
    forces, roles = (0.0, 20.0, 30.0), ("unused", "training", "validation")
    rig = Rig(pelvis)
    pushes = make_set(torso, [rest] * 3, forces, roles, rig=rig)
    (item,) = pushes.of_role("validation")
    problem = pushes.problems["main"].with_place(SupportPlace(0.0, 4.0))
    state = problem.solve(item.trial.load, SOFT).require().state
    shares = silhouette_shares(torso, frontal_view(), torso.rest_pose)
    seen = VertebraCorners(torso.vertebrae, state_features(torso, frontal_view(), state, shares).corners)
    pushes = make_set(torso, [rest, rest, seen.selected(rest.vertebrae)], forces, roles, rig=rig)
    pushes = replace(pushes, known=replace(pushes.known, priors=Priors(obliquity_deg=0.0, frame_obliquity_deg=0.0)))
    model = Model(SOFT, {"force of main": 0.0})
    (found,) = with_fitted_supports(predict(pushes, {"fit": model}, {}, quiet), model).of_role("validation")
    assert found.rmse(torso, "fitted_supports") < 0.3 * found.rmse(torso, "fit")


# Stored


@pytest.fixture
def some(torso):
    random, rest = np.random.default_rng(1), torso.rest_pose
    states = [
        TorsoState(rest.bone_positions + random.normal(size=3), rest.bone_rotations, rest.tissue_positions / 3.0)
        for _ in range(2)
    ]
    return {
        ("main", 2, "fit"): Solved(states[0], random.normal(size=(20, 3))),
        ("a, \"b'\n", 0, "default"): Solved(states[1], np.zeros((0, 3))),
    }


def test_equilibria_come_back_bit_for_bit(some, tmp_path):
    path = tmp_path / "results" / "training.npz"
    write_solved(path, some)
    found = read_solved(path)
    assert set(found) == set(some)
    for key, solved in some.items():
        np.testing.assert_array_equal(found[key].reactions, solved.reactions)
        for name in ("bone_positions", "bone_rotations", "tissue_positions"):
            np.testing.assert_array_equal(getattr(found[key].state, name), getattr(solved.state, name))
    before = path.read_bytes()
    write_solved(path, dict(reversed(found.items())))
    assert path.read_bytes() == before
    write_solved(path, {})
    assert read_solved(path) == {}


def test_a_fit_without_default_equilibria_gives_none():
    assert of_equilibria([SimpleNamespace(push="a", frame=1)], [], "default") == {}


def damaged(path, some, how):
    write_solved(path, some)
    content = path.read_bytes()
    if how == "half":
        path.write_bytes(content[: len(content) // 2])
    elif how == "bits":
        # Amid the compressed arrays, where the archive's own list still stands.
        middle = len(content) // 2
        path.write_bytes(content[:middle] + bytes(255 - value for value in content[middle : middle + 64])
                         + content[middle + 64 :])  # fmt: skip
    elif how == "other arrays":
        np.savez(path, keys=np.array(json.dumps({"schema": STATES_SCHEMA, "keys": [["main", 1, "fit"]]})))
    elif how == "another schema":
        np.savez(path, keys=np.array(json.dumps({"schema": "spinestiff-states-99", "keys": []})))
    elif how == "no header":
        np.savez(path, keys=np.array("[]"))
    elif how == "wrong shapes":
        arrays = {f"0_{name}": np.zeros(3) for name in ("bone_positions", "bone_rotations", "tissue_positions")}
        header = {"schema": STATES_SCHEMA, "keys": [["main", 1, "fit"]]}
        np.savez(path, keys=np.array(json.dumps(header)), **arrays, **{"0_reactions": np.zeros((0, 3))})
    else:
        path.write_bytes(how)


@pytest.mark.parametrize(
    "how",
    ["half", "bits", "other arrays", "another schema", "no header", "wrong shapes", b"", b"PK", b"{}", b"\x93NUMPY"],
)
def test_a_file_that_holds_no_equilibria_is_one_line(some, tmp_path, how):
    path = tmp_path / "training.npz"
    damaged(path, some, how)
    with pytest.raises(SubjectError) as caught:
        read_solved(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and message.endswith("; run spinestiff run")
    assert "\n" not in message and message.count(str(path)) == 1


def test_a_missing_file_is_one_line(tmp_path):
    with pytest.raises(SubjectError, match=r"none\.npz: holds no equilibria"):
        read_solved(tmp_path / "none.npz")
