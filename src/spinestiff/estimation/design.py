"""What radiographs tell of the ratios, taken or not, to first order: which push to take next.

Residuals r of all radiographs, those that might be taken among them, are linear in the log ratios q at a place,
r = X q + e, with everything else that is not known in the covariance C of e. A set s of them determines q with
covariance (X_s^T C_ss^-1 X_s)^-1, and a tilt of another radiograph with the variance of its best linear unbiased
prediction (``forecast``). Neither depends on what the radiographs will show: the design with the least variance of what
is asked for is c-optimal (Elfving 1952), where the place is right.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from spinestiff.arrays import Floats, Ints, ShortRepr
from spinestiff.estimation.weighed import WeighedPoint, WeighedProblem, WeighedSlope

# Of a log ratio that the radiographs say nothing of; where another radiograph is predicted, as of one anywhere within a
# fit's bounds, as ``forecast`` has it.
LEAST_PRECISION, LEAST_PREDICTING = 1e-6, 0.02


@dataclass(frozen=True, repr=False)
class Design(ShortRepr):
    """Radiographs at one place in ratio space.

    Attributes
    ----------
    covariance : (n, n) of all residuals, with all that is not known but the ratios.
    slopes : (n, P) of the residuals in the log ratios.
    rows : of each trial, the loaded ones first, then those without load: those of its corners, then of all else that
        it shows.
    always : rows that count whatever is taken: measured supports, what is held of the ratios.
    """

    covariance: Floats
    slopes: Floats
    rows: tuple[Ints, ...]
    always: slice

    def ratio_sds(self, taken: Sequence[int]) -> Floats:
        """(P,) standard deviations of the log ratios from the radiographs ``taken``, by their numbers."""
        return np.asarray(np.sqrt(np.diag(np.linalg.inv(self._precision(self._rows(taken))[0]))))

    def prediction_sd(self, taken: Sequence[int], unseen: int, weights: Floats) -> float:
        """Standard deviation of ``weights`` (3 Nv,) times what radiograph ``unseen`` shows, as ``taken`` predict it.

        The unseen one's own errors are part of it.
        """
        rows, own = self._rows(taken), self.rows[unseen]
        precision, root, solved = self._precision(rows, LEAST_PREDICTING)
        across = weights @ self.covariance[own][:, rows]
        apart = weights @ self.slopes[own] - across @ solved
        variance = float(weights @ self.covariance[np.ix_(own, own)] @ weights)
        if len(rows):
            variance -= float(across @ cho_solve(root, across))
        return float(np.sqrt(variance + apart @ np.linalg.solve(precision, apart)))

    def _rows(self, taken: Sequence[int]) -> Ints:
        return np.concatenate([*(self.rows[i] for i in taken), np.arange(len(self.slopes))[self.always]])

    def _precision(self, rows: Ints, least: float = LEAST_PRECISION) -> tuple[Floats, tuple[Floats, bool], Floats]:
        """(P, P), the covariance's factor, and (n of rows, P) the slopes solved with it."""
        x = self.slopes[rows]
        root = cho_factor(self.covariance[np.ix_(rows, rows)], lower=True) if len(rows) else (np.zeros((0, 0)), True)
        solved = cho_solve(root, x) if len(rows) else x
        return x.T @ solved + least * np.eye(x.shape[1]), root, solved


def design_at(
    problem: WeighedProblem,
    point: WeighedPoint,
    slope: WeighedSlope,
    tracking_factor: float = 1.0,
    known_better: Mapping[str, float] | None = None,
) -> Design:
    """All radiographs of a problem at a place.

    Parameters
    ----------
    tracking_factor : of the size of tracking's errors, as a fit found it.
    known_better : group of unknowns -> what is left of their standard deviations where something is measured that the
        problem takes as it was before.
    """
    left = np.ones(len(problem.unknowns))
    for group, share in (known_better or {}).items():
        left[problem.unknowns.in_group(group)] = share
    columns = slope.nuisances * left
    covariance = problem.covariance(point, tracking_factor) + columns @ columns.T
    numbers = np.arange(problem.size)
    rows = tuple(np.concatenate([numbers[problem.noise.of(i)], problem.further_rows(i)]) for i in range(problem.trials))
    return Design(covariance, slope.ratios, rows, slice(problem.noise.size, problem.size))
