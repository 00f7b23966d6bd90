"""Parts that several results share: the base of every record, views, poses, and numbers with an interval."""

from __future__ import annotations

from math import inf, log
from typing import ClassVar, Final, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict

from spinestiff.imaging.projection import XRayView

OUTCOME_VERSION: Final = 3
"""Of every file of results. 1 were files without schemas."""
DETERMINED, WEAKLY_DETERMINED = 2.0, 10.0
"""Factors either way of the value: an interval within the first determines it, one within the second does so weakly."""

Determination = Literal["determined", "weakly determined", "not determined"]
LEAST_FIRST: tuple[Determination, ...] = ("not determined", "weakly determined", "determined")
Pair = tuple[float, float]
Vector = tuple[float, float, float]


class Outcome(BaseModel):
    """What every record of a result is: frozen, without unknown keys, without NaN."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class OutcomeFile(Outcome):
    """A record that is a file of its own in ``results/``.

    Attributes
    ----------
    FILE : its name. STEP : the step that writes it.
    schema_version : of this form.
    """

    FILE: ClassVar[str]
    STEP: ClassVar[str]
    schema_version: Literal[3] = OUTCOME_VERSION


class ViewRecord(Outcome):
    """An X-ray view: see ``imaging.projection.XRayView``, whose fields these are."""

    source: Vector
    detector_origin: Vector
    detector_axes: tuple[Vector, Vector]
    pixel_spacing: Pair
    shape: tuple[int, int]
    source_to_patient: float

    @classmethod
    def of(cls, view: XRayView) -> Self:
        """The record of a view."""
        arrays = ("source", "detector_origin", "detector_axes", "pixel_spacing")
        return cls(
            **{name: getattr(view, name).tolist() for name in arrays},
            shape=view.shape,
            source_to_patient=view.source_to_patient,
        )

    def view(self) -> XRayView:
        """The view itself. Raises RadiographError if its geometry is impossible."""
        return XRayView(
            np.array(self.source),
            np.array(self.detector_origin),
            np.array(self.detector_axes),
            np.array(self.pixel_spacing),
            self.shape,
            self.source_to_patient,
        )


class PoseRecord(Outcome):
    """How the patient stood in a picture against its nominal view (``personalise.pose.ViewPose``).

    Attributes
    ----------
    shift_mm : across and along the picture, at the patient plane. roll_deg, yaw_deg : turns.
    rms_mm : what remains between simulated and measured corners, at the patient plane.
    """

    shift_mm: Pair
    roll_deg: float
    yaw_deg: float
    rms_mm: float


class Quantity(Outcome):
    """A number with its 95 % interval.

    Attributes
    ----------
    value : the estimate.
    low, high : ends of the interval; None = none was found.
    open_low, open_high : the end is the fit's bound; what lies beyond is possible, too.
    """

    value: float
    low: float | None
    high: float | None
    open_low: bool = False
    open_high: bool = False

    def scaled(self, factor: float) -> Quantity:
        """The same in another unit, or of what is in proportion to it."""
        ends = [None if end is None else end * factor for end in (self.low, self.high)]
        return Quantity(
            value=self.value * factor, low=ends[0], high=ends[1], open_low=self.open_low, open_high=self.open_high
        )

    @property
    def sd_log(self) -> float:
        """A fourth of the interval's width in log; infinite without two closed ends."""
        if self.low is None or self.high is None or self.low <= 0.0 or self.open_low or self.open_high:
            return inf
        return 0.25 * log(self.high / self.low)

    @property
    def determination(self) -> Determination:
        """How far the data determine the value: by the interval's width in log, with an open end weakly at best."""
        if self.low is None or self.high is None or self.low <= 0.0 or (self.open_low and self.open_high):
            return "not determined"
        half_width = 0.5 * log(self.high / self.low)
        found = determination(half_width)
        return "weakly determined" if found == "determined" and (self.open_low or self.open_high) else found


def determination(half_width: float) -> Determination:
    """How far an interval of this half width in log determines its value."""
    if half_width <= log(DETERMINED):
        return "determined"
    return "weakly determined" if half_width <= log(WEAKLY_DETERMINED) else "not determined"


def finite(value: float) -> float | None:
    """``value``, or None where it is not finite: JSON has no infinity."""
    return float(value) if np.isfinite(value) else None


def nested(array: ArrayLike) -> object:
    """An array as nested lists, what is not finite as None."""
    values = np.asarray(array, dtype=float)
    return finite(float(values)) if values.ndim == 0 else [nested(part) for part in values]
