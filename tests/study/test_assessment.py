"""Predictions of held-out frames beside their baselines, on examples whose numbers can be worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from results import tracked_push
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import EquilibriumError, FitError
from spinestiff.estimation.asked import Start
from spinestiff.estimation.channels import Channels
from spinestiff.estimation.forecast import Forecast
from spinestiff.estimation.status import FitStatus
from spinestiff.imaging.features import VertebraCorners, silhouette_shares, state_features, target_features
from spinestiff.imaging.projection import FRONT, LEFT, UP, frontal_view, placed_view
from spinestiff.study import assessment
from spinestiff.study.assessment import assess, change_record, extrapolated, single_ratio
from spinestiff.study.predictions import Model, Solved, predict, predictions_of
from spinestiff.study.trials import push_set
from spinestiff.subject.assessment_outcome import PREDICTORS, Assessment, CobbChangeRecord
from spinestiff.subject.folder import read_subject
from spinestiff.subject.records import PushRecord
from spinestiff.subject.run_record import read_outcome

FORCES = (0.0, 10.0, 20.0, 30.0)
MOVES = (0.0, 1.0, 3.0, 4.0)  # mm to the patient's left at the patient plane
# Through the origin, least squares: (10 * 1 + 20 * 3) / (10^2 + 20^2) = 0.14 mm/N, so 4.2 mm at 30 N.
EXTRAPOLATED = 4.2


@pytest.fixture(scope="module")
def torso():
    return template_torso(157.0, "coarse")


@pytest.fixture(scope="module")
def rest(torso):
    view = frontal_view()
    shares = silhouette_shares(torso, view, torso.rest_pose)
    corners = state_features(torso, view, torso.rest_pose, shares).corners
    return VertebraCorners(torso.vertebrae, corners).selected(torso.vertebrae[2:16])


def shifted(corners, mm):
    return VertebraCorners(corners.vertebrae, corners.corners + [mm * frontal_view().magnification, 0.0])


def tilted(corners, name, degrees):
    """One vertebra turned about its centre; above 0: its left side up (rows grow downward)."""
    quads, row = corners.corners.copy(), corners.vertebrae.index(name)
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    middle = quads[row].mean(0)
    quads[row] = middle + (quads[row] - middle) @ np.array([[c, -s], [s, c]])
    return VertebraCorners(corners.vertebrae, quads)


def make_set(torso, frames):
    push = PushRecord(
        id="main",
        side="right",
        level=8.0,
        d21_mm=400.0,
        d31_mm=200.0,
        frames="main.dcm",
        forces_n=FORCES,
        roles=("unused", "training", "training", "validation"),
    )
    return push_set(torso, [push], {"main": tracked_push(frontal_view(), FORCES, frames)})


@pytest.fixture
def pushes(torso, rest):
    return make_set(torso, [shifted(rest, mm) for mm in MOVES])


def only_the_fit(pushes):
    """The estimate predicts the rest pose, no other model finds an equilibrium; these are tested elsewhere."""
    at_rest = Solved(pushes.torso.rest_pose, np.zeros((0, 3)))
    return predictions_of(pushes, {("main", 3, "fit"): at_rest})


def test_extrapolation_is_linear_in_the_force(torso, pushes):
    (item,) = pushes.of_role("validation")
    names, features = extrapolated(pushes, item)
    assert names == item.trial.corners.vertebrae
    moved = features - np.stack(list(assessment._measured(pushes, pushes.reference("main")).values()))
    assert moved[..., 0] == pytest.approx(np.full((14, 4), EXTRAPOLATED), abs=1e-9)
    assert moved[..., 1] == pytest.approx(np.zeros((14, 4)), abs=1e-9)


def test_the_frame_that_motions_are_measured_from_is_no_prediction(torso, rest):
    """A push without an unloaded frame, of which the least force is held out."""
    forces, roles = (20.0, 30.0, 40.0), ("validation", "training", "training")
    push = PushRecord(
        id="main", side="right", level=8.0, d21_mm=400.0, d31_mm=200.0, frames="main.dcm", forces_n=forces, roles=roles
    )
    frames = [shifted(rest, mm) for mm in (0.0, 1.0, 2.0)]
    found = push_set(torso, [push], {"main": tracked_push(frontal_view(), forces, frames)})
    (item,) = found.of_role("validation")
    assert extrapolated(found, item) is None
    assert predictions_of(found, {}).measured_change(item) is None
    assert predictions_of(found, {}).measured_change(found.training[0]) is not None
    assert any("push 'main' frame 0: held out, but the frame of the least force" in line for line in found.warnings)


def test_extrapolation_takes_each_vertebra_from_the_frames_that_show_it(torso, rest):
    without = rest.selected(tuple(v for v in rest.vertebrae if v not in ("T7", "L2")))
    never = rest.selected(tuple(v for v in rest.vertebrae if v != "L2"))
    frames = [rest, shifted(never, 1.0), shifted(without, 3.0), shifted(rest, 4.0)]
    found = make_set(torso, frames)
    (item,) = found.of_role("validation")
    names, features = extrapolated(found, item)
    assert "L2" not in names
    base = assessment._measured(found, found.reference("main"))
    # T7 is seen at 10 N alone: 0.1 mm/N.
    assert (features[names.index("T7")] - base["T7"])[:, 0] == pytest.approx(np.full(4, 3.0), abs=1e-9)
    assert (features[names.index("T8")] - base["T8"])[:, 0] == pytest.approx(np.full(4, EXTRAPOLATED), abs=1e-9)


def test_extrapolation_knows_the_side_that_is_pushed(torso, rest):
    """Moves of 0.1 and -0.2 mm/N under pushes from the right and the left must not cancel."""

    def record(name, side, *roles):
        forces = tuple(10.0 * i for i in range(len(roles)))
        return PushRecord(id=name, side=side, level=8.0, d21_mm=400.0, d31_mm=200.0, frames=f"{name}.dcm",
                          forces_n=forces, roles=roles)  # fmt: skip

    records = [
        record("right", "right", "unused", "training", "validation"),
        record("left", "left", "unused", "training", "validation"),
        record("low", "left", "unused", "validation"),
    ]
    moves = {"right": (0.0, 1.0, 2.0), "left": (0.0, -2.0, -4.0), "low": (0.0, -1.0)}
    tracked = {
        name: tracked_push(frontal_view(), [10.0 * i for i in range(len(moved))], [shifted(rest, mm) for mm in moved])
        for name, moved in moves.items()
    }

    def predicted(found):
        result = {}
        for item in found.of_role("validation"):
            start = np.stack(list(assessment._measured(found, found.reference(item.push)).values()))
            result[item.push] = float((extrapolated(found, item)[1] - start)[..., 0].mean())
        return result

    both = predicted(push_set(torso, records, tracked))
    # Each push from its own training frame, the low one from the other push of its side.
    assert both == pytest.approx({"right": 2.0, "left": -4.0, "low": -2.0}, abs=1e-9)
    # From the other side alone: reversed.
    other = predicted(push_set(torso, [records[0], records[2]], tracked))
    assert other == pytest.approx({"right": 2.0, "low": -1.0}, abs=1e-9)


def test_extrapolation_from_another_push_goes_by_the_patients_left(torso):
    """The other push's pictures are mirrored, so that its columns grow to the patient's right."""
    tracked, records = {}, []
    for name, columns, roles in (("low", -LEFT, ("unused", "validation")), ("main", LEFT, ("unused", "training"))):
        view = placed_view(
            columns, -UP, -FRONT, sid=1500.0, source_to_patient=1340.0, shape=(64, 64), pixel=5.0, centre=(0, 200, 0)
        )
        shares = silhouette_shares(torso, view, torso.rest_pose)
        at_rest = VertebraCorners(torso.vertebrae, state_features(torso, view, torso.rest_pose, shares).corners)
        moved = at_rest.corners + [columns[0] * view.magnification, 0.0]
        frames = [at_rest, VertebraCorners(torso.vertebrae, moved)]
        tracked[name] = tracked_push(view, (0.0, 10.0), frames)
        records.append(
            PushRecord(id=name, side="right", level=8.0, frames=f"{name}.dcm", forces_n=(0.0, 10.0), roles=roles)
        )
    found = push_set(torso, records, tracked)
    (item,) = found.of_role("validation")
    _, features = extrapolated(found, item)
    seen = np.stack(list(assessment._measured(found, item).values()))
    assert features == pytest.approx(seen, abs=1e-9)


def test_a_training_frame_that_motions_are_measured_from_shows_none(torso, rest):
    """The only training frame of the push has its least force: another push of the side is taken."""
    main, other = {"forces_n": (20.0, 30.0), "roles": ("training", "validation")}, {"forces_n": (0.0, 10.0)}
    other["roles"] = ("unused", "training")
    tracked, records = {}, []
    for name, fields in (("main", main), ("other", other)):
        records.append(PushRecord(id=name, side="right", level=8.0, frames=f"{name}.dcm", **fields))
        tracked[name] = tracked_push(frontal_view(), fields["forces_n"], [rest, shifted(rest, 1.0)])
    found = push_set(torso, records, tracked)
    (item,) = found.of_role("validation")
    _, features = extrapolated(found, item)
    assert features == pytest.approx(np.stack(list(assessment._measured(found, item).values())), abs=1e-9)


def test_without_a_common_vertebra_nothing_is_extrapolated(torso, rest):
    upper, lower = rest.selected(rest.vertebrae[:7]), rest.selected(rest.vertebrae[7:])
    found = make_set(torso, [rest, shifted(upper, 1.0), shifted(upper, 3.0), shifted(lower, 4.0)])
    assert extrapolated(found, found.of_role("validation")[0]) is None


def test_errors_are_those_at_the_patient_plane(pushes):
    (frame,) = assess(only_the_fit(pushes))
    assert (frame.push, frame.frame, frame.force_n) == ("main", 3, 30.0)
    assert frame.rmse_mm["rest"] == pytest.approx(4.0, abs=1e-6)
    assert frame.rmse_mm["extrapolation"] == pytest.approx(0.2, abs=1e-6)
    assert frame.rmse_mm["fit"] == pytest.approx(frame.rmse_mm["rest"])
    assert [frame.rmse_mm[name] for name in ("default", "single_ratio", "truth")] == [None] * 3
    assert set(frame.rmse_mm) == set(PREDICTORS)
    assert "default" not in frame.cobb_change_deg
    assert frame.cobb_change_deg["fit"].tilt == 0.0
    assert frame.cobb_change_deg["measured"].tilt == pytest.approx(0.0, abs=1e-9)


def test_the_measured_change_of_curvature_is_the_tilt_of_the_corners(torso, rest):
    found = only_the_fit(make_set(torso, [rest, rest, rest, tilted(rest, "T3", 6.0)]))
    (frame,) = assess(found)
    change = found.measured_change(found.frames[-1].item)
    # Left side up at the uppermost one, unchanged below: convex to the left, above 0.
    assert change.tilt == pytest.approx(6.0, abs=1e-6)
    assert change.tilt_levels == ("T3", "T4")
    assert frame.cobb_change_deg["measured"] == change_record(change)
    assert frame.cobb_change_deg["measured"].tilt == pytest.approx(change.tilt, abs=5e-4)
    again = CobbChangeRecord.model_validate_json(frame.cobb_change_deg["measured"].model_dump_json())
    assert again == frame.cobb_change_deg["measured"]


def forecast_of(found, errors):
    """One that expects corners ``errors`` (n, 4, 2) mm from those measured, as far as vertebrae are rigid."""
    channels = Channels.of(found.frames[-1].target)
    off = channels.apply(errors)
    return Forecast(channels, np.zeros_like(off), np.eye(len(off)), off)


@pytest.mark.parametrize("columns", [LEFT, -LEFT], ids=["left at growing columns", "right at growing columns"])
def test_a_forecast_turns_the_vertebrae_of_the_unloaded_frame(torso, columns):
    """Where it expects what was measured its change of the angle is that one; where the motion is all unexpected, 0."""
    view = placed_view(
        columns, -UP, -FRONT, sid=1500.0, source_to_patient=1340.0, shape=(64, 64), pixel=5.0, centre=(0.0, 200.0, 0.0)
    )
    shares = silhouette_shares(torso, view, torso.rest_pose)
    rest = VertebraCorners(torso.vertebrae, state_features(torso, view, torso.rest_pose, shares).corners)
    rest = rest.selected(torso.vertebrae[2:16])
    seen = [rest, tilted(rest, "T3", 6.0 * columns[0])]
    forces, roles = (0.0, 10.0, 30.0), ("unused", "training", "validation")
    push = PushRecord(
        id="main", side="right", level=8.0, d21_mm=400.0, d31_mm=200.0, frames="main.dcm", forces_n=forces, roles=roles
    )
    pushes = push_set(torso, [push], {"main": tracked_push(view, forces, [seen[0], seen[1], seen[1]])})
    at_rest = Solved(torso.rest_pose, np.zeros((0, 3)))
    found = predictions_of(pushes, {("main", 2, "fit"): at_rest})
    frame = found.frames[-1]
    measured, before = frame.target.z, target_features(torso, view, seen[0])
    (as_measured,) = assess(found, {("main", 2): forecast_of(found, np.zeros_like(measured))})
    for form in ("signed", "fixed_levels", "tilt"):
        changes = as_measured.cobb_change_deg
        assert getattr(changes["forecast"], form) == pytest.approx(getattr(changes["measured"], form), abs=2e-3)
    assert changes["forecast"].tilt == pytest.approx(6.0, abs=2e-3)
    assert changes["forecast"].tilt_levels == ("T3", "T4")
    (unmoved,) = assess(found, {("main", 2): forecast_of(found, before - measured)})
    assert abs(unmoved.cobb_change_deg["forecast"].tilt) < 0.05  # a turn of 6 degrees to first order
    (half,) = assess(found, {("main", 2): forecast_of(found, 0.5 * (before - measured))})
    assert half.cobb_change_deg["forecast"].tilt == pytest.approx(3.0, abs=0.02)
    assert "forecast" not in assess(found)[0].cobb_change_deg


def test_a_forecast_does_not_see_the_endplates_of_its_frame(torso, rest):
    """One endplate tracked askew, the other the other way: the vertebra has not turned."""
    quads, row = rest.corners.copy(), rest.vertebrae.index("T8")
    height = 2.0 * frontal_view().magnification
    quads[row, :, 1] += height * np.array([1.0, -1.0, 1.0, -1.0])
    askew = only_the_fit(make_set(torso, [rest, rest, rest, VertebraCorners(rest.vertebrae, quads)]))
    (frame,) = assess(askew, {("main", 3): forecast_of(askew, np.zeros_like(askew.frames[-1].target.z))})
    assert abs(frame.cobb_change_deg["measured"].tilt) > 5.0
    assert abs(frame.cobb_change_deg["forecast"].tilt) < 0.3


def test_an_estimate_without_a_prediction_is_a_failure(pushes):
    with pytest.raises(EquilibriumError, match="push 'main' frame 3: no prediction by the estimate"):
        assess(predictions_of(pushes, {}))


def test_a_prediction_that_is_the_truth_has_no_error(torso):
    """The engine's own state as the measured frame: every model that is right has RMSE 0, the others do not."""
    kinds = torso.joints.kinds
    true, wrong = {"lateral_bending": 0.5, "tissue": 0.3}, {"lateral_bending": 1.5, "tissue": 1.5}
    view = frontal_view()
    shares = silhouette_shares(torso, view, torso.rest_pose)
    rest = VertebraCorners(torso.vertebrae, state_features(torso, view, torso.rest_pose, shares).corners)
    blank = make_set(torso, [rest] * 4)
    (item,) = blank.of_role("validation")
    state = blank.problems["main"].solve(item.trial.load, stiffness_ratios(true, kinds)).require().state
    pushed = VertebraCorners(torso.vertebrae, state_features(torso, view, state, shares).corners)
    lines = []
    found = make_set(torso, [rest, rest, rest, pushed])
    models = {
        "default": Model(),
        "fit": Model(stiffness_ratios(wrong, kinds)),
        "truth": Model(stiffness_ratios(true, kinds)),
    }
    (frame,) = assess(predict(found, models, {}, lines.append, everywhere=()))
    assert frame.rmse_mm["truth"] < 1e-4
    assert frame.rmse_mm["fit"] > 10.0 * frame.rmse_mm["truth"]
    assert frame.rmse_mm["rest"] > frame.rmse_mm["fit"] > frame.rmse_mm["default"] > 0.0
    changes = frame.cobb_change_deg
    # Both are of the picture's corners.
    assert changes["measured"].sds is not None
    assert changes["truth"] == changes["measured"].model_copy(update={"sds": None})
    assert changes["truth"].levels == changes["fit"].levels == changes["measured"].levels
    assert changes["measured"].tilt > changes["default"].tilt > changes["fit"].tilt > 0.0
    assert lines == [f"push 'main' frame 3: {name} at 30 N" for name in models]


def test_a_failed_baseline_fit_makes_no_prediction(pushes, finished, monkeypatch):
    for error in (FitError("no"), EquilibriumError("no")):

        def fails(*args, error=error, **kwargs):
            raise error

        monkeypatch.setattr(assessment, "fit_pushes", fails)
        assert single_ratio(pushes) is None
    monkeypatch.setattr(
        assessment, "fit_pushes", lambda *args, **kwargs: replace(finished.fit, status=FitStatus.STALLED)
    )
    assert single_ratio(pushes) is None
    asked = []
    fit = lambda *args, **kwargs: asked.append((args, kwargs)) or finished.fit  # noqa: E731
    monkeypatch.setattr(assessment, "fit_pushes", fit)
    assert single_ratio(pushes) == Model.of(finished.fit)
    single_ratio(pushes, 0.1, "paper", {"a": 1.0}, ())
    rest = {"extent": "estimate", "close_sd": assessment.SINGLE_SD}
    assert [(args[1:], kwargs) for args, kwargs in asked] == [
        ((("everything",), Start({"everything": start}, known, states), how), rest)
        for start, how, known, states in ((1.0, "weighed", {}, None), (0.1, "paper", {"a": 1.0}, ()))
    ]


def test_no_population_of_other_ratios_is_held_of_the_common_one(pushes, finished, monkeypatch):
    asked = []
    monkeypatch.setattr(assessment, "fit_pushes", lambda *args, **kwargs: asked.append(args[0]) or finished.fit)
    single_ratio(replace(pushes, known=replace(pushes.known, population="koutras2025")))
    assert asked[0].known.population is None
    assert asked[0].known.geometry is pushes.known.geometry


def test_what_is_written_of_a_whole_subject(finished):
    frames = read_outcome(read_subject(finished.folder), Assessment).frames
    assert [(f.push, f.frame, f.force_n) for f in frames] == [("main", 3, 30.0), ("second", 1, 30.0)]
    for frame in frames:
        assert set(frame.rmse_mm) == set(PREDICTORS)
        assert set(frame.cobb_change_deg) == {"measured", "default", "fit", "forecast", "truth"}
        assert all(change is not None for change in frame.cobb_change_deg.values())
        errors = frame.rmse_mm
        assert 0.0 < errors["fit"] < errors["default"] < errors["rest"]
        assert errors["truth"] < errors["default"]
        assert frame.cobb_change_deg["measured"].tilt < 0.0  # pushed from the left
