"""``spinestiff inspect`` of a subject folder: what a step would refuse is refused before anything is computed."""

from __future__ import annotations

import shutil

import pytest

from spinestiff.files import read_json, write_json

SCAN = {"file": "nope.ply", "unit": "mm", "axes": {"left": "+x", "up": "+y", "front": "+z"}}


@pytest.fixture
def girl(radiographed, tmp_path):
    """A copy of the subject before any step."""
    return shutil.copytree(radiographed, tmp_path / radiographed.name)


def test_a_sound_subject_passes(spinestiff, girl):
    ran = spinestiff("inspect", girl)
    assert (ran.status, ran.err) == (0, "")
    assert "subject.json" not in ran.out


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"priors": {"nope": 1}}, "nope"),
        ({"priors": {"annotation_mm": 0}}, "annotation_mm"),
        ({"population": "x"}, "unknown population 'x'"),
        ({"torso": "nope.npz"}, "nope.npz"),
        ({"skin_scan": SCAN}, "nope.ply"),
    ],
)
def test_settings_that_a_step_refuses_are_refused(spinestiff, girl, changed, words):
    write_json(girl / "subject.json", read_json(girl / "subject.json") | changed)
    ran = spinestiff("inspect", girl)
    assert ran.status == 2
    told = ran.out + ran.err
    assert words in told and "Traceback" not in told
