"""benchmarks/force_logs.py: motions are what was asked for, and offsets are counted as they are found."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from programs import benchmark

benchmark("kept_rows")
logs = benchmark("force_logs")


def test_a_motion_ends_at_its_size_and_creep_comes_later():
    rng = np.random.default_rng(0)
    log, times = logs.log_of(rng), np.arange(5.0, 12.0, 0.25)
    at_once, crept = (logs.motion_of(log, times, logs.Case(1e-9, creep), rng) for creep in (0.0, 0.1))
    assert at_once[-1] == pytest.approx(logs.MOTION_PX, rel=0.02)
    # A ramp is followed a second late: a tenth of the ramp's slope is missing while it lasts.
    rising = (times > 6.0) & (times < 7.0)
    assert (crept[rising] < at_once[rising] - 0.2).all()
    assert crept[-1] == pytest.approx(at_once[-1], rel=0.02)


def test_offsets_are_found_where_little_disturbs_and_not_where_the_motion_is_noise():
    quiet, loud = (logs.of_case(logs.Case(noise_px), 5, 1) for noise_px in (0.05, 30.0))
    assert (quiet["interval_holds_truth"], quiet["determined"]) == (1.0, 1.0)
    assert quiet["error_s"]["largest"] < 0.1
    assert (loud["determined"], loud["error_s"]) == (0.0, None)


def test_the_page_has_the_stored_figures():
    page = " ".join((Path(__file__).parents[2] / "docs" / "from-hospital.md").read_text(encoding="utf-8").split())
    stored = json.loads(logs.RESULTS.read_text(encoding="utf-8"))
    little, much, crept = (stored[name] for name in logs.CASES)
    assert f"Of {stored['draws']} synthetic sequences each" in page and little["interval_holds_truth"] == 1.0
    assert f"in {100 * much['interval_holds_truth']:.1f} % with 0.5 pixels" in page
    assert f"{100 * much['determined']:.1f} % of them determined" in page
    assert f"{crept['error_s']['largest']:.2f} s at most" in page
