"""What the report says of held-out frames."""

from __future__ import annotations

import pytest

from spinestiff.study.report.frame_content import comparison_content
from spinestiff.subject.assessment_outcome import Assessment, HeldOutFrame


@pytest.mark.parametrize(
    ("errors", "verdict", "predicted", "uncorrected"),
    [
        ({"fit": 2.5, "forecast": 0.8}, "better", "0.80", "2.50"),
        ({"fit": 0.8, "forecast": 2.5}, "worse", "2.50", "0.80"),
        ({"fit": 1.05, "forecast": None}, "equal", "1.05", ""),
        ({"forecast": None}, "", "", ""),
    ],
)
def test_the_forecast_is_compared_where_there_is_one(
    errors: dict[str, float | None], verdict: str, predicted: str, uncorrected: str
) -> None:
    simple = {"rest": 9.0, "extrapolation": 1.0, "truth": 0.1}
    frame = HeldOutFrame(push="main", frame=2, force_n=60.0, rmse_mm=simple | errors, cobb_change_deg={})
    told = comparison_content(Assessment(frames=(frame,)))
    assert (told["verdict"], told["predicted"], told["uncorrected"]) == (verdict, predicted, uncorrected)
    assert (told["rival"], told["rival_error"]) == ("No model: training motion scaled by force", "1.00")
