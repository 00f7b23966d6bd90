"""benchmarks/bench_phantom.py: sets of pictures are summed up, errors that are left out narrow the interval."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bench_columns import documented
from programs import benchmark

benchmark("kept_rows")
phantom = benchmark("bench_phantom")


def test_two_sets_are_summed_up_and_hold_the_bench_value():
    found = phantom.of_sets(documented(), 2)
    assert found["hold_1"] == found["agree"] == 2
    assert 0.0 < found["sd_log"] < found["half_width"]["least"] < found["half_width"]["largest"] < 0.1


def test_rubber_softens_the_strip_and_stands_in_the_record():
    record = documented()
    usual = phantom.in_rubber(record, 60.0)
    assert usual.rubber is not None and usual.rubber.spacing_mm == 60.0
    softer = phantom.bench_values(record) / phantom.bench_values(usual)
    assert softer == pytest.approx(phantom.SOFTER, rel=1e-6)


def test_the_page_has_the_stored_figures():
    page = " ".join((Path(__file__).parents[2] / "docs" / "bench-phantom.md").read_text(encoding="utf-8").split())
    stored = json.loads(phantom.RESULTS.read_text(encoding="utf-8"))
    sets, first, widths = stored["of_sets"], stored["first_set"], stored["half_width"]
    assert f"over {sets['hold_1']} sets of such pictures" in page and "all of which held 1" in page
    assert f"scattered by {100 * sets['sd_log']:.1f} %" in page
    assert f"intervals of {100 * sets['half_width']['mean']:.1f} % either way" in page
    assert f"{first['ratio']:.3g} times the bench value" in page
    assert f"Of the example's {100 * widths['all errors']:.1f} %" in page
    rubber = stored["in_rubber"]["moved_mm_at_spacing"]
    assert ", ".join(f"{rubber[key]:.1f}" for key in ("60", "20", "14")) in page
