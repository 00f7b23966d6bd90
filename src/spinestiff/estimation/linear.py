"""What a fit knows to first order at the estimate: the combination of ratios that it knows best, and intervals and
draws of ratios that are too many for a profile of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from spinestiff.arrays import Floats
from spinestiff.estimation.emulator import Emulator, Place
from spinestiff.estimation.profiles import CONFIDENCE, DRAWS, WIDTH_FACTOR, Likely, bounded_precision
from spinestiff.estimation.tracing import interval_kind
from spinestiff.estimation.weighed import WeighedFit, reduced

# Up to so many ratios have profiles.
MOST_PROFILED = 4
# A combination that is hardly better known than a ratio alone is not worth its words.
BETTER = 0.8


@dataclass(frozen=True)
class Combination:
    """A product of powers of the ratios.

    Attributes
    ----------
    exponents : (P,), the largest of them 1. value : of the product. sd_log : standard deviation of its log.
    """

    exponents: tuple[float, ...]
    value: float
    sd_log: float


def best_known(log_ratios: Floats, precision: Floats) -> Combination | None:
    """The combination of ratios that is known best; None where one ratio alone is known about as well.

    Parameters
    ----------
    log_ratios : (P,) of the estimate. precision : (P, P) of the log ratios, singular where they can't be told apart.
    """
    if not np.isfinite(precision).all():
        return None
    values, directions = np.linalg.eigh(precision)
    largest = int(np.argmax(np.abs(directions[:, -1])))
    if values[-1] <= 0.0:
        return None
    exponents = directions[:, -1] / directions[largest, -1]
    sd = float(1.0 / (np.sqrt(values[-1]) * abs(directions[largest, -1])))
    # Of a ratio alone, all others free; infinite where others take up all that it does.
    least = np.maximum(values, 1e-12 * values[-1])
    alone = float(np.sqrt((directions**2 / least).sum(axis=1).min()))
    if sd > BETTER * alone:
        return None
    return Combination(tuple(exponents.tolist()), float(np.exp(exponents @ log_ratios)), sd)


def linear_ratios(fit: WeighedFit, visited: Sequence[Place], limits: tuple[float, float]) -> Likely:
    """What the data leave of the ratios if residuals are linear in their logs; no equilibrium is solved.

    Ends and draws beyond the bounds are put at them. There are no profiles and no joint region.

    Parameters
    ----------
    visited : places that the search solved. limits : of the log ratios.
    """
    best = fit.point.log_ratios
    model = reduced(fit.point, fit.slope, fit.weights)
    _, covariance = bounded_precision(model, limits)
    reach = WIDTH_FACTOR * ndtri(0.5 + 0.5 * CONFIDENCE) * np.sqrt(np.diag(covariance))
    low, high = best - reach, best + reach
    open_low, open_high = low <= limits[0], high >= limits[1]
    kinds = tuple(
        interval_kind(*one, limits) for one in zip(best.tolist(), open_low.tolist(), open_high.tolist(), strict=True)
    )
    return Likely(
        low=np.clip(low, *limits),
        high=np.clip(high, *limits),
        open_low=open_low,
        open_high=open_high,
        kinds=kinds,
        profiles=(),
        region=None,
        draws=_draws(fit, covariance, limits),
        effective=float(DRAWS),
        emulator=Emulator([Place(fit.point, fit.slope.light), *visited], fit.weights),
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
