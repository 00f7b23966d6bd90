"""Intervals and draws of many ratios to first order at the estimate, where a profile of each would be too dear."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import norm

from spinestiff.arrays import Floats
from spinestiff.estimation.emulator import Emulator, Place
from spinestiff.estimation.profiles import CONFIDENCE, DRAWS, WIDTH_FACTOR, Likely
from spinestiff.estimation.weighed import WeighedFit, reduced

# Up to so many ratios have profiles.
MOST_PROFILED = 4


def linear_ratios(fit: WeighedFit, visited: Sequence[Place], limits: tuple[float, float]) -> Likely:
    """What the data leave of the ratios if residuals are linear in their logs; no equilibrium is solved.

    Ends and draws beyond the bounds are put at them. There are no profiles and no joint region.

    Parameters
    ----------
    visited : places that the search solved. limits : of the log ratios.
    """
    best = fit.point.log_ratios
    model = reduced(fit.point, fit.slope, fit.weights)
    precision = model.ratios.T @ model.ratios + np.eye(len(best)) / (limits[1] - limits[0]) ** 2
    covariance = np.asarray(np.linalg.inv(precision), dtype=float)
    reach = WIDTH_FACTOR * norm.ppf(0.5 + 0.5 * CONFIDENCE) * np.sqrt(np.diag(covariance))
    low, high = best - reach, best + reach
    open_low, open_high = low <= limits[0], high >= limits[1]
    kinds = tuple(
        "flat" if below and above else "one-sided" if below or above else "bounded"
        for below, above in zip(open_low.tolist(), open_high.tolist())
    )
    return Likely(
        np.clip(low, *limits),
        np.clip(high, *limits),
        open_low,
        open_high,
        kinds,
        (),
        None,
        _draws(fit, covariance, limits),
        float(DRAWS),
        Emulator([Place(fit.point, fit.slope.light), *visited], fit.weights),
    )


def _draws(fit: WeighedFit, covariance: Floats, limits: tuple[float, float]) -> tuple[Floats, Floats]:
    """(D, P) log ratios and (D, M) nuisances."""
    random = np.random.default_rng(1)
    model = reduced(fit.point, fit.slope, fit.weights)
    best = fit.point.log_ratios
    normal = random.normal(size=(DRAWS, len(best))) @ np.linalg.cholesky(covariance).T
    ratios = np.clip(best + WIDTH_FACTOR * normal, *limits)
    columns = fit.weights.whiten(fit.slope.nuisances)
    m = columns.shape[1]
    root = np.linalg.cholesky(np.linalg.inv(np.eye(m) + columns.T @ columns) + 1e-12 * np.eye(m))
    own = WIDTH_FACTOR * random.normal(size=(DRAWS, m)) @ root.T
    return ratios, model.nuisances + (ratios - best) @ model.follow.T + own
