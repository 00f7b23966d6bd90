"""Ends of intervals that are solved for on the model."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.estimation.evaluation import TrialSet
from spinestiff.estimation.fit import fit_stiffness
from spinestiff.estimation.intervals import estimator_offset, linear_intervals
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
