"""Held-out frames, and known true ratios, beside the estimate as files in ``results/``: their schemas."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field

from spinestiff.subject.outcome_parts import Outcome, OutcomeFile

PREDICTORS = ("rest", "default", "fit", "forecast", "fitted_supports", "extrapolation", "single_ratio", "truth")
"""Whose errors an assessment tells: the estimate's, beside simpler ones."""


class CobbChangeRecord(Outcome):
    """Change of the Cobb angle from the push's least force (``curves.tilts.CobbChange``), degrees.

    Attributes
    ----------
    signed, fixed_levels, tilt : its three forms.
    levels : end vertebrae of ``fixed_levels``. tilt_levels : those of ``tilt``.
    signed_levels : those of the two angles behind ``signed``, e.g. "T6–T11 to T5–T12".
    sds : standard deviations of the three, by the corners' errors; None: a model's or a forecast's
        (``HeldOutFrame.cobb_sds``).
    """

    signed: float
    fixed_levels: float
    tilt: float
    levels: tuple[str, str]
    tilt_levels: tuple[str, str]
    signed_levels: str = ""
    sds: tuple[float, float, float] | None = None


class ForecastRecord(Outcome):
    """What the estimate and the errors that frames share let expect of a frame (``estimation.forecast``).

    Attributes
    ----------
    rmse_mm, sd_mm : of corners at the patient plane, found and expected.
    inside95 : share of corner coordinates inside their 95 % intervals.
    cobb_error_deg, cobb_sd_deg : expected minus measured turn between the end vertebrae of the Cobb angle, and its
        standard deviation; None where one of them is not seen.
    """

    rmse_mm: float
    sd_mm: float
    inside95: float
    cobb_error_deg: float | None
    cobb_sd_deg: float | None


class HeldOutFrame(Outcome):
    """A frame that the estimate has not seen.

    Attributes
    ----------
    rmse_mm : by predictor (``PREDICTORS``), corner RMSE at the patient plane; None where it makes no prediction.
    cobb_change_deg : "measured" and by predictor, "forecast" among them where there is one.
    forecast : with its intervals; None by the paper's estimator.
    """

    push: str
    frame: int
    force_n: float
    rmse_mm: dict[str, float | None]
    cobb_change_deg: dict[str, CobbChangeRecord | None]
    forecast: ForecastRecord | None = None

    def cobb_sds(self, name: str) -> tuple[float | None, float | None, float | None]:
        """Of a change of the Cobb angle in ``cobb_change_deg`` the standard deviations of ``signed``, ``fixed_levels``
        and ``tilt``, degrees; None where there is none: a forecast has that between fixed levels alone."""
        change = self.cobb_change_deg.get(name)
        if change is None:
            return None, None, None
        expected = self.forecast.cobb_sd_deg if name == "forecast" and self.forecast is not None else None
        return change.sds or (None, expected, None)


class Assessment(OutcomeFile):
    """``assessment.json``: how well the held-out frames are predicted; ``notes`` on the supports in all frames."""

    FILE: ClassVar[str] = "assessment.json"
    STEP: ClassVar[str] = "assess"
    frames: tuple[HeldOutFrame, ...]
    notes: tuple[str, ...] = ()


class Comparison(OutcomeFile):
    """``comparison.json``: the estimate beside known true ratios.

    Attributes
    ----------
    truth : ratio by name.
    distance2 : by how much twice the negative log likelihood is higher at the truth; None = not known.
    inside : ``distance2`` is at most ``region_size``.
    """

    FILE: ClassVar[str] = "comparison.json"
    STEP: ClassVar[str] = "assess"
    truth: dict[str, Annotated[float, Field(gt=0.0)]]
    region_size: float | None
    distance2: float | None
    inside: bool | None
