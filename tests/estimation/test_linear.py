"""Intervals and draws to first order, beside the covariance and the bounds."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.estimation.linear import best_known, linear_ratios
from spinestiff.estimation.profiles import WIDTH_FACTOR
from spinestiff.estimation.weighed import reduced


@pytest.fixture(scope="module")
def covariance(found):
    model = reduced(found.point, found.slope, found.weights)
    return np.linalg.inv(model.ratios.T @ model.ratios)


def test_ends_lie_at_two_standard_deviations(column, found, covariance, likely):
    linear = linear_ratios(found, (), column.limits)
    reach = WIDTH_FACTOR * 1.96 * np.sqrt(np.diag(covariance))
    assert linear.high - found.point.log_ratios == pytest.approx(reach, rel=0.01)
    assert found.point.log_ratios - linear.low == pytest.approx(reach, rel=0.01)
    assert linear.kinds == ("bounded", "bounded")
    assert (linear.profiles, linear.region) == ((), None)
    # A profile of so well determined ratios is not far from it.
    assert linear.high - linear.low == pytest.approx(likely.high - likely.low, rel=0.25)


def test_ends_beyond_the_bounds_are_open(found, covariance):
    sd, best = np.sqrt(np.diag(covariance)), found.point.log_ratios
    near = (float(best[0] - sd[0]), float(best.max() + 10.0))
    linear = linear_ratios(found, (), near)
    assert linear.low[0] == near[0]
    assert linear.open_low.tolist()[0] is True
    assert linear.open_high.tolist() == [False, False]
    assert linear.kinds[0] == "one-sided"
    assert (linear.draws[0] >= near[0]).all()


def test_an_estimate_at_the_bound_is_told_as_one(found):
    """As of profiles."""
    best = found.point.log_ratios
    assert linear_ratios(found, (), (float(best[0]), float(best.max() + 10.0))).kinds[0] == "at a bound"


def test_draws_spread_as_ratios_and_nuisances_do(column, found, covariance):
    ratios, nuisances = linear_ratios(found, (), column.limits).draws
    assert np.cov(ratios.T) == pytest.approx(WIDTH_FACTOR**2 * covariance, rel=0.2)
    assert ratios.mean(axis=0) == pytest.approx(found.point.log_ratios, abs=0.2 * np.sqrt(np.diag(covariance)).min())
    columns = found.weights.whiten(np.column_stack([found.slope.ratios, found.slope.nuisances]))
    precision = columns.T @ columns
    precision[2:, 2:] += np.eye(len(precision) - 2)
    wanted = np.sqrt(np.diag(np.linalg.inv(precision)))[2:]
    assert nuisances.std(axis=0) == pytest.approx(WIDTH_FACTOR * wanted, rel=0.15)


def test_of_two_that_trade_their_product_is_known_best():
    """Logs known as (1, 1) x to 0.02 and along (1, -1) to 0.5 each way."""
    direction = np.array([1.0, 1.0]) / np.sqrt(2.0)
    other = np.array([1.0, -1.0]) / np.sqrt(2.0)
    precision = np.outer(direction, direction) / 0.02**2 + np.outer(other, other) / 0.5**2
    found = best_known(np.log([0.1, 0.04]), precision)
    assert found.exponents == pytest.approx((1.0, 1.0))
    assert found.value == pytest.approx(0.004)
    # The log of the product is the square root of 2 times the coordinate along the direction.
    assert found.sd_log == pytest.approx(0.02 * np.sqrt(2.0))


def test_a_combination_that_the_data_fix_is_told_where_no_ratio_is():
    found = best_known(np.log([0.1, 0.04]), np.outer([0.5, 1.0], [0.5, 1.0]) / 0.1**2)
    assert found.exponents == pytest.approx((0.5, 1.0))
    assert found.sd_log == pytest.approx(0.1)


@pytest.mark.parametrize("precision", [np.diag([4.0, 100.0]), np.zeros((2, 2)), np.full((2, 2), np.nan)])
def test_no_combination_where_a_ratio_is_known_as_well_or_nothing(precision):
    assert best_known(np.log([0.1, 0.04]), precision) is None
