"""Results as CSV beside their JSON: ``estimate.csv``, a row a quantity, and ``assessment.csv``, a row a held-out frame.

Comma-separated UTF-8 with a header and points in numbers; an empty field is not known.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence

from spinestiff.subject.assessment_outcome import Assessment
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.outcome_parts import Quantity

ESTIMATE_FILE, ASSESSMENT_FILE = "estimate.csv", "assessment.csv"
"""In ``results/``."""
ESTIMATE_COLUMNS = (
    "quantity", "unit", "value", "low95", "high95", "open_low", "open_high", "determined", "at_bound", "status",
)  # fmt: skip
PREDICTORS = (
    "rest", "default", "fit", "forecast", "fitted_supports", "extrapolation", "single_ratio", "truth",
)  # fmt: skip
SEEN = ("measured", "default", "fit", "truth")
"""Whose change of tilt is told, as far as an assessment has it."""


def estimate_csv(estimate: Estimate) -> str:
    """Stiffness in plain units, then the ratios; ``unit`` of a ratio is empty."""
    rows = [[name, found.unit, *_interval(found), "", "", estimate.status] for name, found in estimate.plain.items()]
    rows += [
        [name, "", *_interval(ratio), ratio.determined, _yes(ratio.at_bound), estimate.status]
        for name, ratio in estimate.ratios.items()
    ]
    return _text(ESTIMATE_COLUMNS, rows)


def assessment_csv(assessment: Assessment) -> str:
    """Corner RMSE by predictor, mm, and change of tilt, degrees."""
    columns = ("push", "frame", "force_n", *(f"rmse_mm_{name}" for name in PREDICTORS))
    rows = []
    for frame in assessment.frames:
        tilts = [getattr(frame.cobb_change_deg.get(name), "tilt", None) for name in SEEN]
        errors = [frame.rmse_mm.get(name) for name in PREDICTORS]
        rows.append([frame.push, frame.frame, frame.force_n, *errors, *tilts])
    return _text((*columns, *(f"tilt_change_deg_{name}" for name in SEEN)), rows)


def _interval(found: Quantity) -> list[object]:
    return [found.value, found.low, found.high, _yes(found.open_low), _yes(found.open_high)]


def _yes(value: bool) -> str:
    return "yes" if value else "no"


def _text(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    written = io.StringIO()
    table = csv.writer(written, lineterminator="\n")
    table.writerow(columns)
    table.writerows(rows)
    return written.getvalue()
