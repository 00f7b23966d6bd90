"""benchmarks/carried_bodies.py: what is measured of skins and lengths, and that the page has it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from programs import benchmark
from scans import body, errors
from spinestiff.imaging.features import silhouette_shares, state_features
from spinestiff.imaging.projection import frontal_view

benchmark("kept_rows")
carried = benchmark("carried_bodies")
PAGE = Path(__file__).parents[2] / "docs" / "personalisation.md"


def test_a_heavier_body_is_farther_from_the_usual_one_and_its_own_scan_nowhere():
    assert np.percentile(errors(body(46.0), body(46.0)), 95) < 0.5
    assert carried.told(errors(body(46.0), body(60.0)))[0] > 8.0
    assert carried.told(np.arange(101.0)) == [50.0, 95.0]


def test_corners_have_the_noise_that_was_asked_for():
    torso, view = body(46.0), frontal_view()
    exact = state_features(torso, view, torso.rest_pose, silhouette_shares(torso, view, torso.rest_pose)).corners
    off = carried.seen(torso, view, np.random.default_rng(2)).corners - exact
    assert np.std(off / view.magnification) == pytest.approx(carried.NOISE_MM, rel=0.2)


def test_a_steeper_curve_takes_more_height_and_neighbours_differ_by_degrees_and_mm():
    """tests/personalise/test_prior.py holds every pair's turn between 2 and 6 degrees and its shift up below 2 mm."""
    assert 0.04 < carried.height_lost(60.0) < carried.height_lost(80.0) < 0.15
    found = carried.neighbours()
    assert 2.0 < found["turn_deg"][0] <= found["turn_deg"][1] <= found["turn_deg"][2] < 6.0
    assert 0.5 < found["up_mm"][0] < found["up_mm"][2] < 2.0 < found["front_mm"][2]


def test_the_page_has_the_stored_figures():
    page = PAGE.read_text(encoding="utf-8")
    stored = json.loads(carried.RESULTS.read_text(encoding="utf-8"))
    for name, row in stored["skin"].items():
        (cells,) = re.findall(rf"^\| {re.escape(name)} \| (.+) \|$", page, re.MULTILINE)
        assert cells == " | ".join(f"{row[when][0]:.1f} / {row[when][1]:.1f}" for when in ("before_mm", "after_mm"))
    least, largest = stored["length"]["ends"]
    assert f"{least:.3f} to {largest:.3f}" in " ".join(page.split())
