"""benchmarks/dead_loads.py: the pelvis bears what the lines of force leave, and the page has it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from programs import benchmark
from spinestiff.anatomy.template import template_torso

benchmark("kept_rows")
dead = benchmark("dead_loads")


def test_the_pelvis_bears_no_force_and_a_moment_that_goes_with_the_square(monkeypatch):
    monkeypatch.setattr(dead, "RATIOS", ((1.0, 1.0),))
    monkeypatch.setattr(dead, "FORCES_N", (10.0, 20.0))
    small, large = dead.rows(template_torso(157.0, "coarse"))
    assert small["pelvis_force_n"] < 1e-6 and large["pelvis_force_n"] < 1e-6
    assert large["front_to_back_n_m"] / small["front_to_back_n_m"] == pytest.approx(4.0, rel=0.05)
    assert large["vertical_n_m"] / small["vertical_n_m"] == pytest.approx(2.0, rel=0.05)
    assert large["t1_mm"] > 1.8 * small["t1_mm"] > 0.0


def test_the_page_has_the_stored_table():
    page = (Path(__file__).parents[2] / "docs" / "mechanics.md").read_text(encoding="utf-8")
    stored = json.loads(dead.RESULTS.read_text(encoding="utf-8"))["rows"]
    for bending, tissue in dead.RATIOS:
        (cells,) = re.findall(rf"^\| {bending:g}, {tissue:g} \| (.+) \|$", page, re.MULTILINE)
        rows = [row for row in stored if (row["bending"], row["tissue"]) == (bending, tissue)]
        wanted = [f"{row['front_to_back_n_m']:.2f}, {row['vertical_n_m']:.2f}; {row['t1_mm']:.0f} mm" for row in rows]
        assert cells.split(" | ") == wanted
