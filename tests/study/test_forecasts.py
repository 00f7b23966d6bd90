"""Frames held out, as an estimate and the training frames let expect them."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.estimation.channels import Channels
from spinestiff.estimation.forecast import Forecast
from spinestiff.study.forecasts import forecast_record
from spinestiff.study.wording import forecast_lines
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
    assert told.cobb_error_deg == pytest.approx(np.degrees(4.0 / 40.0), abs=1e-3)
    assert told.cobb_sd_deg == pytest.approx(np.degrees(np.hypot(1.0 / 40.0, 1.0 / 20.0)), abs=1e-3)
    # One vertebra is 1 mm off in each corner, the other not at all.
    assert told.rmse_mm == pytest.approx(np.sqrt(0.5), abs=1e-3)
