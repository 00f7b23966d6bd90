"""benchmarks/calibrate_tissue.py: the default modulus is what it found, on the supports that a push has by default."""

from __future__ import annotations

import inspect
import json
from pathlib import Path

import pytest

from spinestiff.anatomy.stiffness import DEFAULT_YOUNG_MPA
from spinestiff.mechanics.supports import three_point_supports

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"


def test_the_default_modulus_is_the_calibrated_one_to_two_digits():
    stored = json.loads((RESULTS / "calibrate_tissue_coarse.json").read_text(encoding="utf-8"))
    assert stored["pelvis"] == inspect.signature(three_point_supports).parameters["pelvis"].default
    assert pytest.approx(float(f"{stored['young_mpa']:.2g}")) == DEFAULT_YOUNG_MPA
