"""The table of what is known before a fit."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from spinestiff.errors import FitError
from spinestiff.estimation.priors import Priors


def test_each_standard_deviation_is_explained() -> None:
    for field in fields(Priors):
        assert field.name in Priors.__doc__


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"force_scale": -0.02}, "prior force_scale -0.02; wanted a finite number from 0"),
        ({"force_scale": "a"}, "prior force_scale a; wanted a finite number from 0"),
        ({"force_scale": (0.1, 0.2)}, "prior force_scale .*; wanted a finite number from 0"),
        ({"trunk_power": (1.2,)}, "prior trunk_power .*; wanted two finite numbers from 0"),
        ({"trunk_power": 1.2}, "prior trunk_power 1.2; wanted two finite numbers from 0"),
        ({"place_mm": np.nan}, "prior place_mm nan"),
        ({"stance_mm": np.inf}, "prior stance_mm inf"),
        ({"trunk_power": (2.0, -1.0)}, "prior trunk_power"),
        ({"annotation_mm": 0.0}, "prior annotation_mm 0; wanted above 0"),
        ({"marking_mm": 0.0}, "prior marking_mm 0; wanted above 0"),
        ({"pedicle_mm": 0.0}, "prior pedicle_mm 0; wanted above 0"),
        ({"tracking_mm": 0.0}, "prior tracking_mm 0"),
        ({"tracking_length": 0.0}, "prior tracking_length 0"),
        ({"support_force_n": 0.0}, "prior support_force_n 0"),
        ({"frame_obliquity_deg": 4.0}, "frame_obliquity_deg 4 is a part of obliquity_deg 3; wanted less"),
        ({"shoulder_mm": 0.5}, "frame_shoulder_mm 1 is a part of shoulder_mm 0.5; wanted less"),
    ],
)
def test_impossible_priors_are_refused(change, text) -> None:
    with pytest.raises(FitError, match=text):
        Priors(**change)


def test_one_prior_is_scaled_and_no_other() -> None:
    twice = Priors().scaled("push_height_mm", 2.0)
    assert twice.push_height_mm == 2.0 * Priors().push_height_mm
    assert twice == Priors(push_height_mm=2.0 * Priors().push_height_mm)
    assert Priors().scaled("breathing_mm", 0.0).breathing_mm == 0.0
