"""benchmarks/external.py: what a follower load takes from a joint, and that the page tells what is stored."""

from __future__ import annotations

import importlib
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from spinestiff.anatomy.stiffness import DEFAULT_YOUNG_MPA
from spinestiff.anatomy.template import template_torso

ROOT = Path(__file__).parents[2]
# It reads others of its folder, so that the folder is where a script's own is.
sys.path.insert(0, str(ROOT / "benchmarks"))
try:
    external = importlib.import_module("external")
finally:
    sys.path.remove(str(ROOT / "benchmarks"))
TABLE_4, between, followed, met_between = external.TABLE_4, external.between, external.followed, external.met_between
STORED = json.loads((ROOT / "benchmarks" / "results" / "external.json").read_text(encoding="utf-8"))


def test_a_follower_load_takes_what_a_cables_length_gives() -> None:
    """Two cables of half the force each, through guides 25 mm beside two bodies that turn about the middle between."""
    torso = external.specimen(template_torso(157.0, "coarse"), ("T8", "T9"))
    apart = float(np.linalg.norm(np.diff(torso.rest_pose.bone_positions, axis=0)))

    def energy(turn: float) -> float:
        half = np.array([[np.cos(turn / 2), -np.sin(turn / 2)], [np.sin(turn / 2), np.cos(turn / 2)]])
        upper, lower = (half @ [[-25.0, 25.0], 2 * [apart / 2]], half.T @ [[-25.0, 25.0], 2 * [-apart / 2]])
        return 0.5 * 400.0 * float(np.linalg.norm(upper - lower, axis=0).sum())

    step = 1e-3
    wanted = (energy(step) - 2.0 * energy(0.0) + energy(-step)) / step**2
    for column in (3, 5):
        before, after = (one.joints.stiffness[0, column] for one in (torso, followed(torso, 400.0)))
        assert after - before == pytest.approx(wanted, rel=1e-4)


def test_the_way_from_default_to_table_4() -> None:
    assert between(0.0) == {"lateral_bending": 1.0, "tissue": 1.0}
    assert between(1.0) == pytest.approx(TABLE_4)
    found = met_between(lambda ratios: 1.0 / ratios["tissue"], TABLE_4["tissue"] ** -0.25)
    assert found == pytest.approx(between(0.25), rel=0.01)


def test_the_page_tells_what_is_stored() -> None:
    assert STORED["young_mpa"] == DEFAULT_YOUNG_MPA
    assert STORED["table_4"] == pytest.approx(TABLE_4, rel=1e-3)
    rows = [row for section in STORED.values() if isinstance(section, dict) for row in section.get("rows", ())]
    page = (ROOT / "docs" / "validation.md").read_text(encoding="utf-8")
    assert f"{sum(row['met'] for row in rows)} of {len(rows)} rows are met (bold" in page
    (text,) = re.findall(r"^## Experiments of others.*?(?=^## )", page, re.MULTILINE | re.DOTALL)
    told = text.replace("\u2212", "-")
    for row in rows:
        for number in re.findall(r"-?\d+\.\d+", row["ours"]):
            value = float(number)
            shown = {number, f"{value:.2f}", f"{value:.1f}"} | ({f"{value:.0f}"} if abs(value) > 10.0 else set())
            assert any(re.search(rf"(?<![\d.]){one}(?!\.?\d)", told) for one in shown), (row["what"], number)
    assert all(row["met"] or row["reason"] for row in rows)
