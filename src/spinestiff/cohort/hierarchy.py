"""Estimates of many people as one hierarchy: people differ, and each estimate has an error of a size of its own.

With y_i the log of person i's estimate, s_i the standard deviation of its error, which is known, and x_i covariates,

    y_i = x_i' b + u_i + e_i,   u_i ~ N(0, tau^2),   e_i ~ N(0, s_i^2).

tau is found by restricted maximum likelihood (Patterson and Thompson 1971), its 95 % interval from where the
generalised Q, chi-squared with n - p degrees of freedom at the true tau, leaves 2.5 % on either side (Viechtbauer
2007). Where Q is below the lower of these values even at tau = 0, estimates scatter less than their errors let expect:
tau can't be told then, and its upper end is not known. The coefficients' covariance is that of weighted least squares,
widened by Q / (n - p) where that is above 1, with Student's t of n - p degrees of freedom (Knapp and Hartung 2003). A
person's own mean, given all others, lies between the estimate and what the covariates let expect, the nearer to the
latter the less the estimate tells:

    m_i = x_i' b + w_i (y_i - x_i' b),   w_i = tau^2 / (tau^2 + s_i^2),   var = w_i s_i^2 + (1 - w_i)^2 x_i' Cov(b) x_i,

averaged over tau by its restricted likelihood, so that its uncertainty widens the intervals. So is where further people
are expected: with tau at its most likely alone, that range would be far too narrow wherever it happens to be near 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq, minimize_scalar
from scipy.stats import chi2, ncf, norm, t

from spinestiff.arrays import Floats, read_only
from spinestiff.errors import FitError

_GRID, _AVERAGED = 60, 101
_WIDEST = 20.0
"""Largest tau that is looked at, over the scatter of the estimates and their errors together."""
_SAME = 1e-10
"""Relative size of a singular value below which columns say the same."""
LARGEST_GROUP = 100_000


@dataclass(frozen=True)
class Hierarchy:
    """People's estimates as one hierarchy.

    Attributes
    ----------
    coefficients : (p,) b. covariance : (p, p), with Knapp and Hartung's factor.
    tau : standard deviation between people of the same covariates. tau_low, tau_high : its 95 % interval; tau_high
        None where estimates scatter less than their errors let expect, so that tau can't be told.
    degrees : n - p.
    means : (n,) m_i. sds : (n,) of m_i about person i's own. weights : (n,) w_i; these three averaged over tau.
    taus, shares : (m,) tau and its restricted likelihood, which sums to 1.
    """

    coefficients: Floats
    covariance: Floats
    tau: float
    tau_low: float
    tau_high: float | None
    degrees: int
    means: Floats
    sds: Floats
    weights: Floats
    taus: Floats
    shares: Floats

    def __post_init__(self) -> None:
        for name, shape in (("coefficients", (None,)), ("covariance", (None, None)), ("means", (None,)),
                            ("sds", (None,)), ("weights", (None,)), ("taus", (None,)),
                            ("shares", (None,))):  # fmt: skip
            object.__setattr__(self, name, read_only(name, getattr(self, name), shape, FitError))

    @property
    def half_width(self) -> float:
        """Of a 95 % interval, in standard errors."""
        return float(t.ppf(0.975, self.degrees))

    def at(self, row: ArrayLike) -> tuple[float, float]:
        """What people with these covariates have on average, and its standard error."""
        x = np.asarray(row, dtype=float)
        return float(x @ self.coefficients), float(np.sqrt(x @ self.covariance @ x))

    def reach(self, row: ArrayLike) -> float:
        """Half the width of the range in which 95 % of people with these covariates are expected."""
        sds = np.hypot(self.taus, self.at(row)[1])
        found = brentq(lambda one: float(self.shares @ norm.sf(one / sds)) - 0.025, 0.0, 10.0 * float(sds.max()))
        return float(found)

    def p_value(self, column: int) -> float:
        """Of a coefficient as far from 0, two-sided."""
        statistic = abs(self.coefficients[column]) / np.sqrt(self.covariance[column, column])
        return float(2.0 * t.sf(statistic, self.degrees))


def hierarchy(y: ArrayLike, sds: ArrayLike, design: ArrayLike | None = None) -> Hierarchy:
    """Fit the hierarchy.

    Parameters
    ----------
    y : (n,) estimates. sds : (n,) of their errors. design : (n, p) covariates with a column of ones; None: that alone.

    Raises
    ------
    FitError : fewer than two people more than columns; columns that say the same; an sd that is not above 0.
    """
    y, sds = np.asarray(y, dtype=float), np.asarray(sds, dtype=float)
    x = np.ones((len(y), 1)) if design is None else np.asarray(design, dtype=float)
    n, p = x.shape
    if n < p + 2:
        raise FitError(f"{n} people for {p} coefficients; wanted {p + 2} or more")
    if not (np.all(sds > 0.0) and np.all(np.isfinite(y)) and np.all(np.isfinite(sds))):
        raise FitError("an estimate or its standard deviation is not finite, or no standard deviation is above 0")
    singular = np.linalg.svd(x, compute_uv=False)
    if singular[-1] <= _SAME * singular[0]:
        raise FitError("covariates say the same of these people; leave one of them out")

    def solved(tau: float) -> tuple[Floats, Floats, Floats, float]:
        """Coefficients, inverse of X'WX, weights W and Q."""
        weights = 1.0 / (tau**2 + sds**2)
        inverse = np.linalg.inv((x.T * weights) @ x)
        b = inverse @ ((x.T * weights) @ y)
        return b, inverse, weights, float(weights @ (y - x @ b) ** 2)

    def misfit(tau: float) -> float:
        """Twice the negative restricted log likelihood, up to a constant."""
        _, inverse, weights, q = solved(tau)
        return float(-np.sum(np.log(weights)) - np.linalg.slogdet(inverse)[1] + q)

    residuals = y - x @ np.linalg.lstsq(x, y, rcond=None)[0]
    scale = float(np.sqrt(residuals @ residuals / (n - p)) + sds.min())
    tau = _least(misfit, scale)
    low, high = (_where(lambda one: solved(one)[3], float(chi2.ppf(level, n - p)), scale) for level in (0.975, 0.025))
    b, inverse, _, q = solved(tau)
    covariance = inverse * max(1.0, q / (n - p))
    taus = np.linspace(0.0, max(2.0 * (high or 0.0), scale), _AVERAGED)
    halves = np.array([0.5 * misfit(float(one)) for one in taus])
    likely = np.exp(halves.min() - halves)
    likely /= likely.sum()
    means, squares, own = np.zeros((3, n))
    for one, share in zip(taus, likely):
        at, inverse, _, _ = solved(float(one))
        weight = one**2 / (one**2 + sds**2)
        mean = x @ at + weight * (y - x @ at)
        variance = weight * sds**2 + (1.0 - weight) ** 2 * np.einsum("ij,jk,ik->i", x, inverse, x)
        means, squares, own = means + share * mean, squares + share * (variance + mean**2), own + share * weight
    sds_given_all = np.sqrt(squares - means**2)
    return Hierarchy(b, covariance, tau, low or 0.0, high, n - p, means, sds_given_all, own, taus, likely)


def _least(function: Callable[[float], float], scale: float) -> float:
    """Where a function of tau is least, from 0 on: the best of a grid, refined between its neighbours."""
    grid = np.concatenate([[0.0], scale * np.geomspace(1e-3, _WIDEST, _GRID)])
    best = int(np.argmin([function(float(tau)) for tau in grid]))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, _GRID)]
    found = minimize_scalar(function, bounds=(low, high), method="bounded", options={"xatol": 1e-9 * scale})
    # Below the grid's first step a spread is none: what is less there is rounding.
    return 0.0 if found.x < grid[1] or function(0.0) <= found.fun else float(found.x)


def _where(falling: Callable[[float], float], wanted: float, scale: float) -> float | None:
    """Where a function that falls with tau has a value; None where it is lower from the start."""
    if falling(0.0) < wanted:
        return None
    high = scale
    while falling(high) > wanted:
        high *= 2.0
    return float(brentq(lambda tau: falling(tau) - wanted, 0.0, high, xtol=1e-9 * scale))


def group_size(
    difference: float, sd: float, paired: bool = False, power: float = 0.8, level: float = 0.05
) -> int | None:
    """How many it takes to see a difference of means, by a two-sided t-test; None for more than ``LARGEST_GROUP``.

    Parameters
    ----------
    difference : of the means. sd : of one value about its mean; of ``paired`` differences, of one difference.
    paired : people are their own comparison; else the number is that of each of two groups.
    power : with which a difference of that size shows. level : with which one shows where there is none.
    """

    def shown(count: int) -> float:
        degrees = count - 1 if paired else 2 * (count - 1)
        shift = abs(difference) / sd * np.sqrt(count if paired else 0.5 * count)
        # Of t squared, both tails at once: SciPy's non-central t has NaN for the far one.
        return float(ncf.sf(t.ppf(1.0 - 0.5 * level, degrees) ** 2, 1, degrees, shift**2))

    low, high = 1, 2
    while shown(high) < power:
        low, high = high, 2 * high
        if low > LARGEST_GROUP:
            return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if shown(middle) >= power else (middle, high)
    return high if high <= LARGEST_GROUP else None
