"""Ends of intervals that are solved for on the model."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import fsolve

from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.estimation.evaluation import TrialSet
from spinestiff.estimation.fit import fit_stiffness
from spinestiff.estimation.intervals import estimator_offset, inverted_intervals, joint_region, linear_intervals
from spinestiff.estimation.uncertainty import Uncertainty, UncertaintySettings

TRUTH = {"lateral_bending": 0.1, "tissue": 0.03}


def test_inverted_interval_ends_are_ratios_whose_estimates_lie_that_far_off(spine, show, push_by) -> None:
    """If the end were the truth, the estimate would be half a linear interval away in h; checked by an own solve."""
    trials = [
        show(spine, push_by(force), stiffness_ratios(TRUTH, spine.torso.joints.kinds), 2.0) for force in (8.0, 16.0)
    ]
    fit = fit_stiffness(spine, trials, uncertainty=UncertaintySettings(push_height_sd_mm=12.0, motion_sd=0.0))
    trial_set = TrialSet([spine] * 2, trials, fit.ratios.groups, "procrustes", None)
    centre = trial_set.solve(np.log(fit.ratios.values))
    slope = trial_set.slope(centre)
    spread = fit.uncertainty
    sd = np.sqrt(np.diag(spread.covariance))
    for i, sign, end in ((0, 1, fit.intervals.high[0]), (1, -1, fit.intervals.low[1])):
        assert abs(end - centre.log_ratios[i] - sign * spread.half_width[i]) > 0.02 * spread.half_width[i]
        wanted = sign * spread.half_width[i] * spread.covariance[:, i] / sd[i] ** 2
        misses = []
        for other in np.linspace(centre.log_ratios[1 - i] - 1.0, centre.log_ratios[1 - i] + 1.0, 41):
            ratios = np.array([end, other]) if i == 0 else np.array([other, end])
            misses.append(np.abs(estimator_offset(centre, slope, trial_set.solve(ratios)) - wanted).max())
        assert min(misses) < 0.1 * np.abs(wanted).max()


def test_linear_intervals_are_cut_at_the_bounds_and_say_so() -> None:
    spread = Uncertainty(np.diag([0.01, 4.0]), np.full(2, 50.0), {}, 400.0, 0.0)
    found = linear_intervals(np.log([0.1, 0.01]), spread, (np.log(0.005), np.log(5.0)))
    assert found.open_low.tolist() == [False, True]
    assert not found.open_high.any()
    assert found.low[1] == pytest.approx(np.log(0.005))
    assert found.high[0] - found.low[0] == pytest.approx(2.0 * spread.half_width[0])


class Valley:
    """Two picture coordinates: one steep across a valley that bends, one along it that saturates for soft springs."""

    def __init__(self, bend: float, saturation: float) -> None:
        self.bend, self.saturation = bend, saturation
        self.solves = 0

    def seen(self, log_ratios: np.ndarray) -> np.ndarray:
        x, y = log_ratios - np.log([0.1, 0.01])
        return np.array([10.0 * (y + 0.3 * x + self.bend * x**2), np.expm1(self.saturation * x) / self.saturation])

    def solve(self, log_ratios, near=None, slope=None):
        self.solves += 1
        return SimpleNamespace(log_ratios=np.asarray(log_ratios, dtype=float), values=self.seen(log_ratios))

    def slope(self, at):
        x = at.log_ratios[0] - np.log(0.1)
        rows = [[10.0 * (0.3 + 2.0 * self.bend * x), 10.0], [np.exp(self.saturation * x), 0.0]]
        return SimpleNamespace(jacobian=np.array(rows))


LIMITS = (np.log(0.005), np.log(5.0))


def ends(bend: float, sd: float, saturation: float = 0.7):
    """Intervals at (0.1, 0.01) for errors of that size in both coordinates, with what they are made of."""
    valley = Valley(bend, saturation)
    point = valley.solve(np.log([0.1, 0.01]))
    slope = valley.slope(point)
    covariance = sd**2 * np.linalg.inv(slope.jacobian.T @ slope.jacobian)
    spread = Uncertainty(covariance, np.full(2, 50.0), {}, 400.0, 0.0)
    return inverted_intervals(valley, point, slope, spread, LIMITS), valley, point, slope, spread


@pytest.mark.parametrize("bend", [0.0, 0.1, -0.2, 0.5])
def test_ends_are_found_along_a_valley_that_bends(bend: float) -> None:
    """Steps in both ratios at once leave it: the other ratio has to be brought back at each place."""
    found, valley, point, slope, spread = ends(bend, 0.4)
    for i in (0, 1):
        for sign, end in ((-1, found.low[i]), (1, found.high[i])):
            wanted = sign * spread.half_width[i] * spread.covariance[:, i] / spread.covariance[i, i]

            def missed(q: np.ndarray, wanted: np.ndarray = wanted) -> np.ndarray:
                return estimator_offset(point, slope, valley.solve(q)) - wanted

            exact = fsolve(missed, point.log_ratios + wanted)
            assert np.abs(missed(exact)).max() < 1e-6
            assert end == pytest.approx(exact[i], abs=0.05)
    assert not found.open_low.any()
    assert not found.open_high.any()


def test_what_saturates_is_open() -> None:
    """Below some stiffness the picture no longer changes: h never gets as far as the linear interval would have it."""
    found, valley, point, _, spread = ends(0.1, 0.8, 1.75)
    assert found.open_low.tolist() == [True, False]
    assert found.low[0] == LIMITS[0]
    assert not found.open_high.any()
    # The other ratio can't be followed to where that one meets its bound; the joint region says how far it may go.
    assert found.region is not None
    inside = found.region[(found.region[:, 0] > LIMITS[0]) & (found.region[:, 0] < LIMITS[1])]
    assert found.high[1] == pytest.approx(inside[:, 1].max(), abs=0.02)
    # Softer than the bound allows the region goes on, where the other ratio may be larger still.
    assert found.region[:, 0].min() < LIMITS[0]
    assert abs(found.high[1] - linear_intervals(point.log_ratios, spread, LIMITS).high[1]) > 0.05
    assert valley.solves < 60


def outline_misses(region: np.ndarray, valley: Valley, point, slope, spread: Uncertainty) -> np.ndarray:
    """(n,) how far h at each place of an outline is from the edge of the joint region, in shares of its radius."""
    offsets = np.array([estimator_offset(point, slope, valley.solve(q)) for q in region])
    sizes = np.sqrt([spread.distance2(offset) for offset in offsets])
    return sizes / np.sqrt(spread.region_size) - 1.0


@pytest.mark.parametrize("bend", [0.1, -0.2, 0.5])
def test_the_joint_region_follows_the_valley(bend: float) -> None:
    """Its edge is where h has the region's size; the ellipse at the estimate misses that by far more."""
    found, valley, point, slope, spread = ends(bend, 0.4)
    assert found.region is not None
    ellipse = joint_region(point.log_ratios, spread, (), LIMITS)
    assert ellipse is not None
    bent, straight = (np.abs(outline_misses(r, valley, point, slope, spread)) for r in (found.region, ellipse))
    assert np.median(bent) < 0.25 * np.median(straight)
    assert np.median(bent) < 0.3


@pytest.mark.parametrize(
    ("bend", "sd", "saturation"), [(0.0, 0.4, 0.7), (0.2, 0.4, 0.7), (-0.2, 0.1, 0.7), (0.1, 0.8, 1.75)]
)
def test_region_and_intervals_agree(bend: float, sd: float, saturation: float) -> None:
    """The region holds each end, and is wider by little more than the two quantiles differ."""
    found, _, point, _, spread = ends(bend, sd, saturation)
    assert found.region is not None
    wider = np.sqrt(spread.region_size) / (spread.half_width / np.sqrt(np.diag(spread.covariance)))
    for end, outermost, is_open in (
        (found.low, found.region.min(0), found.open_low),
        (found.high, found.region.max(0), found.open_high),
    ):
        ratio = (outermost - point.log_ratios) / (end - point.log_ratios)
        assert (ratio > 0.98).all()
        assert (ratio < 1.8 * wider)[~is_open].all()


def test_without_ends_the_joint_region_is_chi_square() -> None:
    covariance = np.array([[0.04, -0.05], [-0.05, 0.09]])
    spread = Uncertainty(covariance, np.full(2, 1e7), {}, 400.0, 0.0)
    assert spread.region_size == pytest.approx(5.991, abs=1e-3)
    outline = joint_region(np.log([0.1, 0.01]), spread, (), LIMITS)
    assert outline is not None
    offsets = outline - np.log([0.1, 0.01])
    assert [spread.distance2(row) for row in offsets] == pytest.approx([5.991] * len(offsets), abs=1e-3)
    assert Uncertainty(covariance, np.full(2, 5.0), {}, 400.0, 0.0).region_size > 10.0
    for other in (
        Uncertainty(np.eye(3), np.full(3, 50.0), {}, 1.0, 0.0),
        Uncertainty(np.full((2, 2), np.inf), np.full(2, 4.0), {}, np.inf, 0.0),
    ):
        assert joint_region(np.zeros(len(other.covariance)), other, (), LIMITS) is None
