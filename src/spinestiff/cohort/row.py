"""A participant's row in the tables of a cohort: ``row.json``, the last result that a run makes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from spinestiff.cohort.marker import CohortRecord
from spinestiff.errors import SubjectError
from spinestiff.files import read_text, write_json
from spinestiff.formats import parse_json

CurveKind = Literal["none", "proximal thoracic", "main thoracic", "thoracolumbar/lumbar"]
Sex = Literal["female", "male"]
Positive = Annotated[float, Field(gt=0.0)]


class Stiffness(CohortRecord):
    """A stiffness with its 95 % interval.

    Attributes
    ----------
    unit : as people read it: "kPa", "N m/rad" or, of a ratio, what it is relative to (``wording.titles.ratio_unit``).
    low, high : ends of the interval; None = none was found. open_low, open_high : the end is the fit's bound.
    sd_log : standard deviation of its log; None where the interval has no two closed ends, or the value is at a bound.
    visit_sd_log : of its log from visit to visit of one unchanged person; None = not known.
    """

    value: Positive
    unit: str
    low: float | None = None
    high: float | None = None
    open_low: bool = False
    open_high: bool = False
    sd_log: Positive | None = None
    visit_sd_log: Positive | None = None


class HeldOut(CohortRecord):
    """The frames held out, together.

    Attributes
    ----------
    rmse_mm : by predictor, root of the mean square over the frames for which it has a prediction.
    cobb_error_deg : mean size of the forecast's error of the Cobb change; None without.
    inside95 : share of corner coordinates inside the forecast's 95 % intervals; None without.
    """

    frames: int
    rmse_mm: dict[str, float]
    cobb_error_deg: float | None = None
    inside95: float | None = None


class Row(CohortRecord):
    """``row.json``.

    Attributes
    ----------
    id : as ``subject.json`` has it. age : years.
    cobb_deg : largest angle at rest, above 0 convex to the left. curve : region of its apex; "none" below 10 degrees.
    population : whose ratios the estimate holds as a prior; None: nobody's.
    status : of the estimate. determined : how far the radiographs determine it, or that its method has no intervals.
    failed_checks : by name.
    stiffness : ratios by name and, in plain units, by the names of ``study.wording.titles.PLAIN``.
    training_rmse_mm : corner RMSE over the training frames. p_value : of residuals as large.
    report : file in the results that people read, or None.
    """

    schema_version: Literal[2] = 2
    participant: str
    id: str
    age: Positive
    sex: Sex
    height_cm: Positive
    mass_kg: Positive | None = None
    cobb_deg: float
    curve: CurveKind
    population: str | None = None
    status: str
    determined: str
    failed_checks: tuple[str, ...] = ()
    stiffness: dict[str, Stiffness]
    training_rmse_mm: float
    p_value: float | None = None
    held_out: HeldOut | None = None
    largest_force_n: float
    report: str | None = None


def write_row(path: Path, row: Row) -> None:
    """Write a row. Raises SubjectError if it can't be written."""
    write_json(path, row.model_dump(mode="json"))


def read_row(path: Path) -> Row:
    """Read a row. Raises SubjectError if it is none."""
    text = read_text(path)
    parse_json(text, str(path))
    try:
        return Row.model_validate_json(text, strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise SubjectError(f"{path}: {where}: {first['msg']}") from None
