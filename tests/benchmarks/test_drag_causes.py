"""What ``benchmarks/drag_causes.py`` counts, and that its page says it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from programs import benchmark

drag = benchmark("tracking_drag")
causes = benchmark("drag_causes")


def frame(push, number, values):
    nothing = np.full((3, 17), np.nan)
    whole = nothing.copy()
    whole[:, :2] = values
    return drag.Shares(push, number, 5.0, whole, nothing, np.zeros(0), np.zeros(0))


def test_sizes_are_those_of_all_frames_and_of_what_pushes_share():
    one, other, late = frame("a", 1, 0.02), frame("b", 1, -0.01), frame("a", 2, 0.04)
    found = causes.told([[one, other], [late]])
    assert (found["subjects"], found["frames"]) == (2, 3)
    for channel in ("shift along columns", "turn"):
        assert found[channel]["mean"] == pytest.approx(0.05 / 3.0, abs=1e-4)
        assert found[channel]["rms"] == pytest.approx(np.sqrt((4e-4 + 1e-4 + 16e-4) / 3.0), abs=1e-4)
        # Another subject's push is not one of the same person's.
        assert found[channel]["common to pushes"] == pytest.approx(-np.sqrt(2e-4), abs=1e-4)
    assert "shift along rows" not in found


@pytest.mark.parametrize("kind", causes.KINDS)
def test_radiographs_of_each_kind_come_from_its_source(kind):
    from spinestiff.study.synthetic import visit

    usual = visit.frontal_view().source_to_patient
    with causes.showing(kind):
        shown = visit.frontal_view().source_to_patient
    assert shown == (causes.FAR_MM if kind.endswith("far source") else usual) and usual != causes.FAR_MM


def test_the_page_has_the_stored_figures():
    page = (Path(__file__).parents[2] / "docs" / "tracking.md").read_text(encoding="utf-8")
    stored = json.loads(causes.RESULTS.read_text(encoding="utf-8"))
    rows = [line for line in page.splitlines() if line.startswith(("| the whole trunk |", "| all bones |",
            "| vertebrae alone |", "| vertebral bodies alone", "| the same, source 9 m"))]  # fmt: skip
    assert len(rows) == len(causes.KINDS)
    for row, kind in zip(rows, causes.KINDS):
        shift, turn = stored[kind]["shift along columns"], stored[kind]["turn"]
        told = [float(cell.strip().removesuffix(" %")) for cell in row.split("|")[2:-1]]
        wanted = [100.0 * one for one in (shift["mean"], shift["rms"], shift["common to pushes"], turn["rms"])]
        np.testing.assert_allclose(told, wanted, atol=0.051)
