"""A smooth function of the log ratios through values, and slopes where they are known.

Kriging with a squared-exponential kernel on what a first-order model leaves (Morris, Mitchell and Ylvisaker 1993).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from spinestiff.arrays import Floats

# Correlation length in log ratio: residuals change their course over a factor of seven or so.
LENGTH = 2.0
# Relative variance that keeps places close to each other, which first order has a little wrong, from being at odds.
NUGGET = 1e-4


class Kriging:
    """A smooth function through values, and slopes where they are given.

    Parameters
    ----------
    places : (K, P). values : (K, R). slopes : (K, R, P) or None: of the first place only, 0.
    length : of correlation, in log ratio.
    rising : far from all places the function rises as at the first one; else it is there what it is at the first one.
    slope_noise : variance of what the slopes have beside the function's own, in units of its variance.

    Attributes
    ----------
    log_likelihood : (R,) of what is known, as a Gaussian process of this length and noise and of the likeliest size;
        give or take a constant.
    """

    def __init__(
        self,
        places: Floats,
        values: Floats,
        slopes: Floats | None,
        length: float = LENGTH,
        rising: bool = True,
        slope_noise: float = 0.0,
    ) -> None:
        self._places, self._sloped, self._length = places, slopes is not None, length
        self._base, self._value = places[0], values[0]
        self._slope = np.zeros((values.shape[1], places.shape[1]))
        if slopes is not None and rising:
            self._slope = slopes[0]
        left = values - self._first_order(places)
        targets = left
        if slopes is not None:
            change = slopes - self._slope
            targets = np.concatenate(
                [left, change.transpose(2, 0, 1).reshape(slopes.shape[0] * slopes.shape[2], values.shape[1])]
            )
        kernel = self._covariance(places, True)
        kernel[np.diag_indices_from(kernel)] *= 1.0 + NUGGET
        if slopes is not None:
            sloped = np.arange(len(places), len(kernel))
            kernel[sloped, sloped] += slope_noise
        factor = cho_factor(kernel + NUGGET * np.eye(len(kernel)), lower=True)
        self._solved = cho_solve(factor, targets)
        sizes = np.sum(targets * self._solved, axis=0) / len(kernel)
        with np.errstate(divide="ignore"):
            self.log_likelihood = -0.5 * len(kernel) * np.log(sizes) - np.sum(np.log(np.diag(factor[0])))

    def at(self, where: Floats) -> Floats:
        """(S, R) values at places (S, P)."""
        return np.asarray(self._first_order(where) + self._covariance(where, False) @ self._solved)

    def slopes(self, where: Floats) -> Floats:
        """(S, R, P) of the values at places (S, P); only where slopes were given."""
        count, p = where.shape
        found = self._covariance(where, True)[count:] @ self._solved
        return np.asarray(found.reshape(p, count, -1).transpose(1, 2, 0) + self._slope)

    def _first_order(self, where: Floats) -> Floats:
        return np.asarray(self._value + (where - self._base) @ self._slope.T)

    def _covariance(self, where: Floats, own: bool) -> Floats:
        """Of values (and, for ``own``, slopes) at some places with values and slopes at the known ones."""
        apart = (where[:, None] - self._places[None]) / self._length
        value = np.exp(-0.5 * np.sum(apart**2, axis=2))
        if not self._sloped:
            return np.asarray(value)
        p = apart.shape[2]
        # d/dy k(x, y) = k (x - y) / l^2, d/dx k = -k (x - y) / l^2, d2/dx dy k = k (1 - dd^T) / l^2.
        to_slope = [value * apart[..., j] / self._length for j in range(p)]
        top = np.hstack([value, *to_slope])
        if not own:
            return np.asarray(top)
        rows = [top]
        for i in range(p):
            cross = [value * ((i == j) - apart[..., i] * apart[..., j]) / self._length**2 for j in range(p)]
            rows.append(np.hstack([-value * apart[..., i] / self._length, *cross]))
        return np.vstack(rows)
