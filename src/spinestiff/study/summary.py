"""Results as CSV beside their JSON: ``response.csv``, ``estimate.csv`` and ``assessment.csv``.

Comma-separated UTF-8 with a header and points in numbers; an empty field is not known.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence

from spinestiff.normal import HALF_WIDTH_95
from spinestiff.study.wording.estimate import known_word
from spinestiff.subject.assessment_outcome import PREDICTORS, Assessment, HeldOutFrame
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.outcome_parts import Quantity
from spinestiff.subject.outcomes import Responses

RESPONSE_FILE, ESTIMATE_FILE, ASSESSMENT_FILE = "response.csv", "estimate.csv", "assessment.csv"
"""In ``results/``."""
ESTIMATE_COLUMNS = (
    "quantity", "unit", "value", "low95", "high95", "open_low", "open_high", "determined", "at_bound", "status",
)  # fmt: skip
RESPONSE_COLUMNS = (
    "push", "force_n", "quantity", "unit", "value", "low95", "high95", "upper_level", "lower_level", "rest_deg",
    "change_deg", "change_half_width95_deg", "instead_of", "missing",
)  # fmt: skip
SEEN = ("measured", "default", "fit", "forecast", "truth")
"""Whose change of the Cobb angle is told, as far as an assessment has it."""
FORMS = {"tilt": "tilt_levels", "fixed_levels": "levels", "signed": "signed_levels"}
"""Forms of that change (``curves.tilts.CobbChange``), and what names the vertebrae between which it is."""


def response_csv(responses: Responses) -> str:
    """What each push says without a model: N per degree of the curve and of the largest tilt, and flexibility."""
    rows: list[dict[str, object]] = []
    for name, found in responses.pushes.items():
        push: dict[str, object] = {"push": name, "force_n": found.force_n}
        if found.missing:
            rows.append({**push, "missing": found.missing})
        for quantity, angle in (("curve", found.curve), ("tilt", found.tilt)):
            if angle is not None:
                (upper, lower), n = angle.levels, angle.n_per_degree
                rows.append({
                    **push, "quantity": quantity, "unit": "N/degree", "value": n.value, "low95": n.low,
                    "high95": n.high, "upper_level": upper, "lower_level": lower, "rest_deg": angle.rest_deg,
                    "change_deg": angle.change_deg, "change_half_width95_deg": HALF_WIDTH_95 * angle.change_sd_deg,
                    "instead_of": "-".join(found.instead_of) if found.instead_of and quantity == "curve" else None,
                })  # fmt: skip
        if (share := found.flexibility) is not None:
            ends = {"value": share.percent, "low95": share.low, "high95": share.high}
            rows.append({**push, "quantity": "flexibility", "unit": "%", **ends})
    return _text(RESPONSE_COLUMNS, [[row.get(column) for column in RESPONSE_COLUMNS] for row in rows])


def estimate_csv(estimate: Estimate) -> str:
    """A row a quantity: stiffness in plain units, then the ratios; ``unit`` of a ratio is empty.

    ``determined`` is "doubtful" throughout a doubtful estimate, "no intervals" by a method without, and empty for a
    stiffness without an interval that no single ratio scales: it was not estimated as a whole, or its ratios can't be
    told apart.
    """
    rows = []
    for name, found in estimate.plain.items():
        ratio = None if found.ratio is None else estimate.ratios[found.ratio]
        known, bound = "", ""
        if ratio is not None:
            known, bound = known_word(estimate, ratio.determined), _yes(ratio.at_bound)
        elif found.low is not None:
            known = known_word(estimate, found.determination)
        rows.append([name, found.unit, *_interval(found), known, bound, estimate.status])
    rows += [
        [name, "", *_interval(ratio), known_word(estimate, ratio.determined), _yes(ratio.at_bound), estimate.status]
        for name, ratio in estimate.ratios.items()
    ]
    return _text(ESTIMATE_COLUMNS, rows)


def assessment_csv(assessment: Assessment) -> str:
    """A row a held-out frame: corner RMSE by predictor, mm; change of the Cobb angle in three forms, degrees, with half
    width and levels."""
    columns = ["push", "frame", "force_n", *(f"rmse_mm_{name}" for name in PREDICTORS)]
    columns += [column for name in SEEN for form in FORMS for column in _change_columns(form, name)]
    rows = []
    for frame in assessment.frames:
        errors = [frame.rmse_mm.get(name) for name in PREDICTORS]
        changes = [cell for name in SEEN for cell in _change_cells(frame, name)]
        rows.append([frame.push, frame.frame, frame.force_n, *errors, *changes])
    return _text(columns, rows)


def _change_columns(form: str, name: str) -> tuple[str, str, str]:
    return f"{form}_change_deg_{name}", f"{form}_change_half_width95_deg_{name}", f"{form}_change_of_{name}"


def _change_cells(frame: HeldOutFrame, name: str) -> list[object]:
    """Of each form value, half the width of its 95 % interval, where it has one, and levels."""
    change = frame.cobb_change_deg.get(name)
    if change is None:
        return [None] * (3 * len(FORMS))
    sds = dict(zip(("signed", "fixed_levels", "tilt"), frame.cobb_sds(name)))
    cells: list[object] = []
    for form, levels in FORMS.items():
        sd, between = sds[form], getattr(change, levels)
        width = None if sd is None else HALF_WIDTH_95 * sd
        cells += [getattr(change, form), width, between if isinstance(between, str) else "–".join(between)]
    return cells


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
