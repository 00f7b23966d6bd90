"""benchmarks/rendered_frames.py: a frame is timed, and the exposure is what it says."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from programs import benchmark

benchmark("kept_rows")
frames = benchmark("rendered_frames")


def test_a_small_frame_is_timed_and_blur_takes_away_what_is_fine():
    assert 0.0 < frames.seconds(1, (64, 64)) < 60.0
    assert frames.transfer(1e-6) == pytest.approx(1.0)
    # A Gaussian where the period is long against a pixel.
    assert frames.transfer(0.1) == pytest.approx(np.exp(-2.0 * (np.pi * 0.2 * 0.1) ** 2), abs=0.001)


def test_more_tissue_lets_less_through(monkeypatch):
    usual = frames.photons_a_mm2()
    monkeypatch.setattr(frames, "TISSUE_MM", 150.0)
    assert frames.photons_a_mm2() > 2.0 * usual > 0.0


def test_the_page_has_the_stored_figures():
    page = (Path(__file__).parents[2] / "docs" / "synthetic-radiographs.md").read_text(encoding="utf-8")
    stored = json.loads(frames.RESULTS.read_text(encoding="utf-8"))
    assert f"{stored['cpu_s_a_frame']:.1f} s of CPU time" in page
    assert f"{round(stored['photons_a_mm2'], -2):,.0f} a mm² behind 200 mm of tissue" in page
    assert f"{stored['transfer_at_1_period_a_mm']:.2f} at 1 period a mm" in page
