"""``spinestiff phantom``: what it prints and how it ends."""

from __future__ import annotations

import json

import numpy as np
import pytest

from bench_columns import documented, documented_text, pictures
from spinestiff.curves.corner_files import write_corners
from spinestiff.study.phantom import build_phantom


def write(folder, gauge=1.0):
    record = documented()
    stiffness = np.array([joint.stiffness for joint in build_phantom(record).joints])
    folder.mkdir()
    (folder / "phantom.json").write_text(documented_text(), encoding="utf-8")
    write_corners(folder / "corners.csv", pictures(record, stiffness, gauge=gauge))
    return folder


def test_agreement_and_a_wrong_gauge(spinestiff, tmp_path) -> None:
    ran = spinestiff("phantom", write(tmp_path / "good"))
    assert (ran.status, ran.err) == (0, "")
    assert ran.out.startswith("phantom column 1, strip of 0.8 mm\njoint below T12: 263")
    assert "agrees with the bench" in ran.out
    ran = spinestiff("phantom", write(tmp_path / "bad", gauge=1.2))
    assert ran.status == 1
    assert "does NOT agree with the bench" in ran.out


def test_json(spinestiff, tmp_path) -> None:
    ran = spinestiff("phantom", write(tmp_path / "good"), "--json")
    found = json.loads(ran.out)
    assert ran.status == 0 and found["agrees"] is True
    (joints,) = found["comparisons"]
    assert joints["part"] == "joints, mean" and joints["ratio"] == pytest.approx(1.0, abs=0.06)


def test_what_is_no_phantom_ends_in_one_line(spinestiff, tmp_path) -> None:
    ran = spinestiff("phantom", tmp_path / "none")
    assert (ran.status, ran.out, len(ran.lines)) == (2, "", 1)
    assert "no such folder; wanted one with phantom.json and corners.csv" in ran.err
