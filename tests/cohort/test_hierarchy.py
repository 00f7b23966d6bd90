"""People as a hierarchy, against closed forms, a published meta-analysis and simulated people."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import t

from spinestiff.cohort.hierarchy import LARGEST_GROUP, group_size, hierarchy
from spinestiff.errors import FitError

# BCG vaccine against tuberculosis, 13 trials (Colditz et al. 1994): log relative risks, variances, latitudes.
BCG = np.array([-0.8893, -1.5854, -1.3481, -1.4416, -0.2175, -0.7861, -1.6209, 0.0120, -0.4694, -1.3713, -0.3394,
                0.4459, -0.0173])  # fmt: skip
VARIANCES = np.array([0.3256, 0.1946, 0.4154, 0.0200, 0.0512, 0.0069, 0.2230, 0.0040, 0.0564, 0.0730, 0.0124, 0.5325,
                      0.0714])  # fmt: skip
LATITUDES = np.array([44, 55, 42, 52, 13, 44, 19, 13, 27, 42, 18, 33, 33])


def test_people_alike_in_what_is_known_of_them_have_a_closed_form():
    y, s = np.array([0.1, 0.9, -0.4, 0.5, 0.2]), 0.2
    found = hierarchy(y, np.full(5, s))
    assert found.tau == pytest.approx(np.sqrt(y.var(ddof=1) - s**2), rel=1e-6)
    assert found.coefficients[0] == pytest.approx(y.mean())
    assert found.covariance[0, 0] == pytest.approx(y.var(ddof=1) / 5, rel=1e-6)
    assert found.half_width == pytest.approx(t.ppf(0.975, 4))


def test_a_spread_that_is_only_rounding_is_none():
    """Where the likelihood is flat at 0, its least place is anywhere near: 3e-9 reads as a result."""
    random, none = np.random.default_rng(5), 0
    for _ in range(60):
        sds = random.uniform(0.2, 0.6, 8)
        found = hierarchy(sds * random.normal(size=8), sds)
        none += found.tau == 0.0
        assert found.tau == 0.0 or found.tau > 1e-4
    assert none > 5


def test_scatter_below_the_errors_leaves_the_spread_between_people_open():
    found = hierarchy([0.1, 0.11, 0.09, 0.1], [0.5, 0.5, 0.6, 0.4])
    assert (found.tau, found.tau_low, found.tau_high) == (0.0, 0.0, None)
    assert np.ptp(found.means) < 0.02


def test_a_published_meta_analysis_comes_out_the_same():
    """Viechtbauer (2010), J Stat Softw 36(3): REML, tau^2 0.3132 (0.1197 to 1.1115), mean -0.7145, se 0.1807."""
    found = hierarchy(BCG, np.sqrt(VARIANCES))
    assert found.tau**2 == pytest.approx(0.3132, abs=2e-4)
    assert (found.tau_low**2, found.tau_high**2) == pytest.approx((0.1197, 1.1115), abs=2e-3)
    assert found.coefficients[0] == pytest.approx(-0.7145, abs=2e-4)
    assert np.sqrt(found.covariance[0, 0]) == pytest.approx(0.1807, abs=5e-4)
    moved = hierarchy(BCG, np.sqrt(VARIANCES), np.column_stack([np.ones(13), LATITUDES]))
    assert moved.tau**2 == pytest.approx(0.0764, abs=3e-4)
    assert moved.coefficients == pytest.approx([0.2515, -0.0291], abs=3e-4)


def test_the_less_an_estimate_tells_the_nearer_it_is_drawn_to_the_others():
    random = np.random.default_rng(1)
    sds = np.geomspace(0.02, 2.0, 25)
    found = hierarchy(random.normal(0.0, 0.4, 25) + sds * random.normal(size=25), sds)
    assert np.all(np.diff(found.weights) < 0.0)
    assert found.weights[0] > 0.95 and found.weights[-1] < 0.1
    assert np.all(found.sds <= np.hypot(sds, 0.0) + 0.02)
    assert found.sds[-1] < 0.8


def test_intervals_hold_for_simulated_people():
    """150 cohorts: 95 % within four standard errors of a share, 0.07."""
    random = np.random.default_rng(5)
    inside, spread, own = [], [], []
    for _ in range(150):
        x = np.column_stack([np.ones(25), random.normal(size=25)])
        sds = random.uniform(0.1, 0.6, 25)
        people = x @ [1.0, 0.2] + random.normal(0.0, 0.3, 25)
        found = hierarchy(people + sds * random.normal(size=25), sds, x)
        inside.append(abs(found.coefficients[1] - 0.2) < found.half_width * np.sqrt(found.covariance[1, 1]))
        spread.append(found.tau_low <= 0.3 <= found.tau_high)
        own.append(np.mean(np.abs(found.means - people) < found.half_width * found.sds))
    assert 0.88 < np.mean(inside) <= 1.0
    assert 0.88 < np.mean(spread) <= 1.0
    assert 0.92 < np.mean(own) < 0.98


def test_what_can_not_be_fitted_is_refused():
    with pytest.raises(FitError, match="2 people for 1 coefficients; wanted 3 or more"):
        hierarchy([0.1, 0.2], [0.1, 0.1])
    with pytest.raises(FitError, match="say the same"):
        hierarchy([0.1, 0.2, 0.3, 0.1], [0.1] * 4, np.ones((4, 2)))
    with pytest.raises(FitError, match="no standard deviation is above 0"):
        hierarchy([0.1, 0.2, 0.3], [0.1, 0.0, 0.1])


def test_group_sizes_are_those_of_the_tables():
    """Cohen (1988): d = 0.5 and 0.8, power 0.8, level 0.05 two-sided: 64 and 26 a group, 34 and 15 pairs."""
    assert [group_size(d, 1.0) for d in (0.5, 0.8)] == [64, 26]
    assert [group_size(d, 1.0, paired=True) for d in (0.5, 0.8)] == [34, 15]
    assert group_size(1e-3, 1.0) is None


def test_sizes_of_groups_end_at_the_largest():
    """Of large groups in each 2 (1.95996 + 0.84162)^2 / d^2, from the normal distribution."""
    for d in (0.0140, 0.0126, 0.0125, 0.0121):
        wanted = 2.0 * (1.959964 + 0.841621) ** 2 / d**2
        assert group_size(d, 1.0) == (pytest.approx(wanted, rel=1e-4) if wanted < LARGEST_GROUP else None)


@pytest.mark.parametrize("d", [3.6, 5.0, 6.1, 6.7, 8.3, 9.0, 9.8, 10.7, 20.0, 60.0, 1e3])
def test_few_pairs_have_the_power_that_draws_of_them_have(d):
    """A mean of n differences over its scatter, drawn: the least n at which 80 % lie beyond the edge."""
    random = np.random.default_rng(3)
    for n in range(2, 6):
        values = d + random.normal(size=(100_000, n))
        statistic = np.sqrt(n) * values.mean(axis=1) / values.std(axis=1, ddof=1)
        if np.mean(np.abs(statistic) > t.ppf(0.975, n - 1)) >= 0.8:
            break
    assert group_size(d, 1.0, paired=True) == n
