"""Frames held out, as an estimate and the training frames let expect them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.template import template_torso
from spinestiff.curves.tilts import tilts
from spinestiff.estimation.channels import Channels
from spinestiff.estimation.forecast import Forecast
from spinestiff.estimation.objective import Trial, make_target
from spinestiff.imaging.features import VertebraCorners, silhouette_shares, state_features
from spinestiff.imaging.projection import FRONT, LEFT, UP, frontal_view, placed_view
from spinestiff.mechanics.loads import no_load
from spinestiff.study.forecasts import forecast_record
from spinestiff.study.wording.steps import forecast_lines
from spinestiff.subject.assessment_outcome import Assessment
from spinestiff.subject.folder import read_subject
from spinestiff.subject.run_record import read_outcome


def test_every_held_out_frame_has_a_forecast_with_intervals(finished) -> None:
    frames = read_outcome(read_subject(finished.folder), Assessment).frames
    assert frames
    for frame in frames:
        found = frame.forecast
        assert frame.rmse_mm["forecast"] == found.rmse_mm
        assert 0.0 < found.sd_mm < 10.0
        assert found.rmse_mm < 4.0 * found.sd_mm
        assert found.inside95 > 0.5
        assert abs(found.cobb_error_deg) < 4.0 * found.cobb_sd_deg


def test_lines_tell_what_was_expected_and_found(finished) -> None:
    frames = read_outcome(read_subject(finished.folder), Assessment).frames
    frame = frames[0].model_copy(
        update={
            "forecast": frames[0].forecast.model_copy(
                update={"rmse_mm": 1.0, "sd_mm": 1.5, "inside95": 0.9, "cobb_error_deg": -2.0, "cobb_sd_deg": 1.0}
            )
        }
    )
    (line,) = forecast_lines([frame])
    assert "expected within 1.5 mm (one sd)" in line
    assert "found 1.0 mm off, 90 % of corners" in line
    upper, lower = frame.cobb_change_deg["measured"].levels
    assert line.endswith(f"; change of the Cobb angle between {upper} and {lower} off by 2.0° (95 %: at most 2.0°)")
    assert forecast_lines([frame.model_copy(update={"forecast": None})]) == []


def test_a_record_without_the_end_vertebrae_tells_no_cobb_change(finished) -> None:
    class Item:
        class trial:
            view = frontal_view()

            class corners:
                vertebrae = ("T5", "T6")

    class Frame:
        item = Item

    basis = np.zeros((2, 3, 4, 2))
    basis[:, 0, :, 0] = 0.5
    channels = Channels(basis, np.array([4, 5]), np.array([40.0, 20.0]))
    forecast = Forecast(channels, np.zeros(6), np.eye(6), np.array([2.0, 0.0, 4.0, 0.0, 0.0, 0.0]))
    assert forecast_record(Frame, forecast, ("T5", "L1")).cobb_error_deg is None
    told = forecast_record(Frame, forecast, ("T5", "T6"))
    # From the patient's left to the feet: the left side sinks.
    assert told.cobb_error_deg == pytest.approx(-np.degrees(4.0 / 40.0), abs=1e-3)
    assert told.cobb_sd_deg == pytest.approx(np.degrees(np.hypot(1.0 / 40.0, 1.0 / 20.0)), abs=1e-3)
    # One vertebra is 1 mm off in each corner, the other not at all.
    assert told.rmse_mm == pytest.approx(np.sqrt(0.5), abs=1e-3)


@pytest.mark.parametrize("columns", [LEFT, -LEFT], ids=["left at growing columns", "right at growing columns"])
def test_a_forecast_errs_in_the_angle_as_angles_are_counted(columns) -> None:
    """Where nothing else is expected the forecast is the model's state, and errs as the model's Cobb angle does."""
    torso = template_torso(157.0, "coarse")
    view = placed_view(
        columns, -UP, -FRONT, sid=1500.0, source_to_patient=1340.0, shape=(64, 64), pixel=5.0, centre=(0.0, 200.0, 0.0)
    )
    rest = torso.rest_pose
    turned = np.array(rest.bone_rotations)
    turned[torso.bone("T5")] = exp_so3(np.array([0.0, 0.0, 0.1])) @ turned[torso.bone("T5")]
    pushed = replace(rest, bone_rotations=turned)
    shares = silhouette_shares(torso, view, rest)
    seen, made = (state_features(torso, view, state, shares) for state in (rest, pushed))
    trial = Trial(no_load(), VertebraCorners(torso.vertebrae, seen.corners), view, "frame", "main", True)
    channels = Channels.of(make_target(torso, trial, "procrustes"))
    found = channels.apply(made.z - seen.z)
    forecast = Forecast(channels, np.zeros_like(found), np.eye(len(found)), found)
    frame = SimpleNamespace(item=SimpleNamespace(trial=trial))
    told = forecast_record(frame, forecast, ("T5", "T11")).cobb_error_deg
    angles = [tilts(torso.vertebrae, one.corners, view).cobb_degrees("T5", "T11") for one in (seen, made)]
    assert told == pytest.approx(angles[1] - angles[0], abs=0.3)
    assert abs(told) == pytest.approx(np.degrees(0.1), abs=0.3)
