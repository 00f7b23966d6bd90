"""benchmarks/cobb_noise.py and cobb_repairs.py: known spines are read as they were made, and what is wrong is told."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from programs import benchmark
from spine_images import image
from spinestiff.anatomy.template import template_torso
from spinestiff.curves.cobb import read_cobb

benchmark("kept_rows")
noise = benchmark("cobb_noise")
repairs = benchmark("cobb_repairs")
# T1 to L5: a curve of 25 degrees between others of 16 and 14.
TILTS = [0, 4, 8, 12, 14, 10, 5, 0, -5, -8, -11, -6, -2, 2, 4, 5, 3]


@pytest.mark.parametrize("curve", ["lumbar", "double"])
def test_a_bent_template_reads_as_it_was_bent(curve):
    seen = noise.seen_from_the_front(template_torso(157.0, "coarse"), 30.0, curve)
    for definition in ("endplate", "midline"):
        found = read_cobb(seen, definition)
        assert found.status == "ok"
        assert abs(found.largest.angle.degrees) == pytest.approx(30.0, abs=0.5)


def test_noise_makes_a_straight_spine_read_too_large_and_a_curve_less_so():
    rng = np.random.default_rng(0)
    straight, curved = (noise.of_image(image(np.linspace(half, -half, 17)), "midline", 20, rng) for half in (0.0, 20.0))
    assert straight["mean_deg"] > straight["without_noise_deg"] + straight["stated_half_width_deg"] / 2.0
    assert straight["below_95_deg"] > straight["mean_deg"]
    assert -0.5 < curved["mean_deg"] - curved["without_noise_deg"] < straight["mean_deg"]
    assert curved["same_end_vertebrae"] > 0.5 > straight["same_end_vertebrae"]


def test_all_angles_of_a_data_set_are_asked_for_and_small_ones_not():
    reading = read_cobb(image(TILTS), "midline")
    angles = [abs(curve.angle.degrees) for curve in reading.curves]
    assert repairs.has_all(reading, np.array([*sorted(angles, reverse=True)[:2], 3.0]))
    assert not repairs.has_all(reading, np.array([max(angles), 9.0, 0.0]))


def test_what_a_reading_did_not_notice_is_named():
    sound = image(TILTS)
    turned = repairs.turned(40.0, 40.0)(sound, np.random.default_rng(1))
    (row,) = np.flatnonzero((turned.corners != sound.corners).any(axis=(1, 2)))
    told = repairs.unnoticed(sound, turned, 12.345)
    assert told == {"levels": [sound.levels[row]], "turned_deg": [40.0], "off_deg": 12.35}
    short = replace(sound, levels=sound.levels[1:], corners=sound.corners[1:])
    assert repairs.unnoticed(sound, short, 1.0) == {"levels": ["T1"], "off_deg": 1.0}


def test_a_folder_without_labels_ends_in_one_line(tmp_path):
    (tmp_path / "images.csv").touch()
    with pytest.raises(SystemExit, match=r"landmarks.csv: no such file; wanted a folder with images.csv"):
        repairs.labelled(tmp_path)


def test_the_page_has_the_stored_figures():
    page = " ".join((Path(__file__).parents[2] / "docs" / "cobb.md").read_text(encoding="utf-8").split())
    stored = json.loads(noise.RESULTS.read_text(encoding="utf-8"))
    for definition in ("endplate", "midline"):
        straight = stored[definition]["straight"]
        assert f"{straight['mean_deg']:.1f}°" in page and f"below {straight['below_95_deg']:.1f}°" in page
    found = json.loads(repairs.RESULTS.read_text(encoding="utf-8"))["as_they_are"]
    assert f"On {found['ok_with_all_angles']} of the {found['ok']} labelled spines" in page
