"""All subjects of a served folder as one CSV table: who, how far, stiffness and change of the Cobb angle."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import Any

from spinestiff.curves.corner_csv import FORMULA
from spinestiff.study.wording.titles import TIMES_DEFAULT, TIMES_WHOLE

COLUMNS = ("subject", "id", "state", "changed_since", "sex", "age", "height_cm", "pushes", "result")
ENDS = ("", "_low95", "_high95", "_open")
COBB = ("push", "force_n", "upper_level", "lower_level", "rest_deg", "change_deg", "change_half_width95_deg")
"""Of the Cobb angle, under the largest force."""


def overview_csv(cards: Sequence[dict[str, Any]]) -> str:
    """A row a subject, from cards (``cards.card``); a cell is empty where nothing is known.

    ``..._open`` names ends of an interval that the radiographs do not close: "low", "high" or both.
    """
    results = [card.get("result") or {} for card in cards]
    told = [{(one["name"], one["unit"]): one for one in result.get("stiffness", ())} for result in results]
    kinds = list(dict.fromkeys(kind for found in told for kind in found))
    names = [f"{name}_{_unit(unit)}" for name, unit in kinds]
    written = io.StringIO()
    table = csv.writer(written, lineterminator="\n")
    table.writerow([*COLUMNS, *(f"{name}{end}" for name in names for end in ENDS), *(f"cobb_{name}" for name in COBB)])
    for card, result, found in zip(cards, results, told):
        plain = [
            card["name"], card.get("id"), card["stage_words"], "; ".join(card.get("stale") or ()), card.get("sex"),
            card.get("age"), card.get("height_cm"), card.get("pushes"), result.get("badge"),
        ]  # fmt: skip
        cells = [cell for kind in kinds for cell in _stiffness(found.get(kind))]
        cobb = result.get("cobb") or {}
        table.writerow([_cell(one) for one in [*plain, *cells, *(cobb.get(name) for name in COBB)]])
    return written.getvalue()


def _unit(unit: str) -> str:
    known = {TIMES_DEFAULT: "ratio", TIMES_WHOLE: "ratio_of_whole"}
    return known.get(unit) or unit.replace(" ", "").replace("/", "_per_")


def _stiffness(one: dict[str, Any] | None) -> list[Any]:
    if one is None:
        return [None] * len(ENDS)
    ends = "+".join(end for end in ("low", "high") if one[f"open_{end}"])
    return [one["value"], one["low"], one["high"], ends]


def _cell(value: Any) -> Any:
    """A cell that no spreadsheet takes for a formula."""
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA) else value
