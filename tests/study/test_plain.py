"""Stiffness in plain units, beside what the torso has and what was estimated."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.anatomy.regions import torso_ratios
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.estimation.profiles import WIDTH_FACTOR
from spinestiff.study.plain import plain_stiffness
from spinestiff.subject.estimate_outcome import RatioEstimate


@pytest.fixture(scope="module")
def torso():
    return template_torso(157.0, "coarse")


def estimate(value, low, high, opens=(False, False)):
    return RatioEstimate.of(value, (low, high), opens, False)


def test_plain_units(torso):
    """Of bending the spine's mean of each part; of tissue E = mu (3 lambda + 2 mu) / (lambda + mu)."""
    kinds = torso.joints.kinds
    default = plain_stiffness(torso, stiffness_ratios({}, kinds), {})
    mu, lam = float(torso.tissue.lame_mu[0]), float(torso.tissue.lame_lambda[0])
    assert default["tissue_young"].value == pytest.approx(1e3 * mu * (3.0 * lam + 2.0 * mu) / (lam + mu))
    for part in ("lumbar", "thoracic"):
        rows = [k == part for k in kinds]
        wanted = torso.joints.stiffness[rows, 5].mean() / 1e3
        assert default[f"lateral_bending_{part}"].value == pytest.approx(wanted)
    softer = plain_stiffness(torso, stiffness_ratios({"lateral_bending": 0.1, "tissue": 0.02}, kinds), {})
    assert {name: found.unit for name, found in softer.items()} == {
        "lateral_bending_thoracic": "N m/rad",
        "lateral_bending_lumbar": "N m/rad",
        "tissue_young": "kPa",
    }
    for name, found in softer.items():
        assert found.value == pytest.approx(default[name].value * (0.02 if "tissue" in name else 0.1)), name
        assert (found.low, found.high, found.ratio) == (None, None, None)


def test_intervals_are_those_of_the_ratio_that_scales_the_whole(torso):
    estimates = {"lateral_bending": estimate(0.1, 0.08, 0.15), "tissue": estimate(0.02, 0.005, 0.03, (True, False))}
    values = {name: found.value for name, found in estimates.items()}
    found = plain_stiffness(torso, stiffness_ratios(values, torso.joints.kinds), estimates)
    bending, tissue = found["lateral_bending_thoracic"], found["tissue_young"]
    assert (bending.low, bending.high) == pytest.approx((0.8 * bending.value, 1.5 * bending.value))
    assert (bending.ratio, bending.open_low, bending.open_high) == ("lateral_bending", False, False)
    assert (tissue.low, tissue.high) == pytest.approx((0.25 * tissue.value, 1.5 * tissue.value))
    assert (tissue.ratio, tissue.open_low, tissue.open_high) == ("tissue", True, False)


def test_a_ratio_that_scales_a_part_gives_no_interval(torso):
    """The shear modulus alone doesn't scale Young's modulus; flexion doesn't scale lateral bending."""
    estimates = {"tissue_mu": estimate(0.1, 0.05, 0.2), "flexion_extension": estimate(0.1, 0.05, 0.2)}
    values = {name: found.value for name, found in estimates.items()}
    found = plain_stiffness(torso, stiffness_ratios(values, torso.joints.kinds), estimates)
    assert all((plain.ratio, plain.low, plain.high) == (None, None, None) for plain in found.values())


def test_one_ratio_for_all_scales_all(torso):
    estimates = {"everything": estimate(0.5, 0.25, 1.0)}
    found = plain_stiffness(torso, stiffness_ratios({"everything": 0.5}, torso.joints.kinds), estimates)
    for plain in found.values():
        assert plain.ratio == "everything"
        assert (plain.low, plain.high) == pytest.approx((0.5 * plain.value, 2.0 * plain.value))


def test_a_region_has_the_interval_of_its_own_ratio(torso):
    estimates = {"lateral_bending@thoracic": estimate(0.1, 0.08, 0.15), "tissue@thorax": estimate(0.02, 0.01, 0.03)}
    values = {name: found.value for name, found in estimates.items()}
    found = plain_stiffness(torso, torso_ratios(torso, values), estimates)
    thoracic = found["lateral_bending_thoracic"]
    assert (thoracic.low, thoracic.high) == pytest.approx((0.8 * thoracic.value, 1.5 * thoracic.value))
    assert thoracic.ratio == "lateral_bending@thoracic"
    lumbar, tissue = found["lateral_bending_lumbar"], found["tissue_young"]
    assert (lumbar.ratio, lumbar.low, lumbar.high) == (None, None, None)
    # The abdomen's tissue is as it was, so that the mean lies between.
    assert (tissue.ratio, tissue.low) == (None, None)
    default = plain_stiffness(torso, stiffness_ratios({}), {})["tissue_young"].value
    assert 0.05 * default < tissue.value < 0.95 * default


def test_of_several_ratios_the_interval_is_to_first_order(torso):
    """A lumbar level goes with both; a thoracic one with the first alone."""
    estimates = {"lateral_bending": estimate(0.1, 0.08, 0.15), "lateral_bending@lumbar": estimate(2.0, 1.0, 4.0)}
    ratios = torso_ratios(torso, {name: found.value for name, found in estimates.items()})
    covariance = np.array([[0.04, -0.03], [-0.03, 0.09]])
    found = plain_stiffness(torso, ratios, estimates, covariance)
    lumbar = found["lateral_bending_lumbar"]
    factor = np.exp(WIDTH_FACTOR * 1.96 * np.sqrt(0.04 + 0.09 - 2.0 * 0.03))
    assert (lumbar.low, lumbar.high) == pytest.approx((lumbar.value / factor, lumbar.value * factor))
    assert lumbar.ratio is None
    assert found["lateral_bending_thoracic"].ratio == "lateral_bending"
    # Whatever is known of a ratio that scales none of it.
    shear = {**estimates, "lateral_shear": estimate(1.0, 0.01, 90.0)}
    wide = np.full((3, 3), np.inf)
    wide[:2, :2] = covariance
    beside = plain_stiffness(torso, torso_ratios(torso, {n: one.value for n, one in shear.items()}), shear, wide)
    assert beside["lateral_bending_lumbar"] == lumbar
    unknown = plain_stiffness(torso, ratios, estimates, np.full((2, 2), np.inf))["lateral_bending_lumbar"]
    assert (unknown.low, unknown.high) == (None, None)


def test_parts_that_overlap_do_not_stand_for_the_levels_that_none_of_them_has(torso):
    """Two ratios scale T2-T8 both, and none T9 to T12, which stay at their default."""
    names = ("lateral_bending@T1-T8", "lateral_bending@T2-T9")
    estimates = {name: estimate(2.0, 1.5, 3.0) for name in names}
    ratios = torso_ratios(torso, {name: found.value for name, found in estimates.items()})
    found = plain_stiffness(torso, ratios, estimates, np.diag([0.04, 0.04]))["lateral_bending_thoracic"]
    assert (found.ratio, found.low, found.high) == (None, None, None)
    more = {**estimates, "lateral_bending@T9-T12": estimate(2.0, 1.5, 3.0)}
    ratios = torso_ratios(torso, {name: found.value for name, found in more.items()})
    assert plain_stiffness(torso, ratios, more, 0.04 * np.eye(3))["lateral_bending_thoracic"].low is not None
