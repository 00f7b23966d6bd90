"""benchmarks/variance_budget.py: the whole budget as the tables of docs/estimation.md."""

from __future__ import annotations

import json

import numpy as np
import pytest

from programs import FOLDER, benchmark

budgets = benchmark("variance_budget")


def case(acquisition, together, unknowns):
    rows = {name: {"alone": alone, "without": without} for name, (alone, without) in unknowns.items()}
    return {
        "bending": 0.07, "tissue": 0.04, "acquisition": acquisition, "together": together, "tracking": [0.1, 0.03],
        "unknowns": rows,
    }  # fmt: skip


ROWS = [
    case("one", [0.5, 0.2], {"small": ([0.11, 0.03], [0.49, 0.2]), "large": ([0.4, 0.1], [0.3, 0.1])}),
    case("two", [0.4, 0.1], {"large": ([0.3, 0.05], [0.4, 0.08])}),
]


def cells(text):
    """Cells by the first of each line, table by table."""
    tables = []
    for table in text.split("\n\n"):
        lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]
        tables.append({line[0]: line[1:] for line in lines if set(line[0]) != {"-"}})
    return tables


def test_each_unknown_stands_with_what_it_does_alone_and_with_what_knowing_it_takes_away():
    alone, taken = cells(budgets.markdown(ROWS))
    assert alone["sd of the log, alone"] == ["0.07, 0.04: one", "0.07, 0.04: two"]
    assert alone["all together"] == ["0.50 / 0.20", "0.40 / 0.10"]
    assert alone["tracking's errors"] == ["0.10 / 0.03", "0.10 / 0.03"]
    assert alone["large"] == ["0.40 / 0.10", "0.30 / 0.05"] and alone["small"] == ["0.11 / 0.03", ""]
    # 1 - (0.3 / 0.5)^2, 1 - (0.1 / 0.2)^2, 1 - (0.08 / 0.1)^2
    assert taken["large"] == ["64 / 75", "0 / 36", "0 / 36 to 64 / 75"]
    assert taken["small"] == ["4 / 0", "0 / 0", "0 / 0 to 4 / 0"]
    assert list(taken)[1:] == ["large", "small"]


def test_what_is_stored_has_all_unknowns_in_all_cases_and_fills_the_tables():
    rows = json.loads((FOLDER / "results" / "variance_budget.json").read_text())["rows"]
    alone, taken = cells(budgets.markdown(rows))
    names = {name for row in rows for name in row["unknowns"]}
    assert len(rows) == 15 and names == set(taken) - {"taken away, %"}
    assert all(len(alone[name]) == 15 and "" not in alone[name] for name in names)
    shares = np.array([[float(part) for part in cell.split(" / ")] for cell in taken["trunk size"][:-1]])
    found = [budgets.gain(row, "trunk size") for row in rows]
    assert shares == pytest.approx(np.array(found), abs=0.5)
