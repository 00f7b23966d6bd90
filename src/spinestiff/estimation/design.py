"""What radiographs tell of the ratios, taken or not, to first order: which push to take next.

Residuals r of all radiographs, those that might be taken among them, are linear in the log ratios q at a place,
r = X q + e, with everything else that is not known in the covariance C of e. A set s of them determines q with
covariance (X_s^T C_ss^-1 X_s)^-1, and a tilt of another radiograph with the variance of its best linear unbiased
prediction (``forecast``). Neither depends on what the radiographs will show: the design with the least variance of what
is asked for is c-optimal (Elfving 1952), where the place is right.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve

from spinestiff.arrays import Floats, Ints, ShortRepr
from spinestiff.estimation.causes import Cause
from spinestiff.estimation.noise import lower_root
from spinestiff.estimation.point import WeighedPoint, WeighedSlope
from spinestiff.estimation.unknowns import Unknowns
from spinestiff.estimation.weighed import WeighedProblem

# Of a log ratio that the radiographs say nothing of; where another radiograph is predicted, as of one anywhere within a
# fit's bounds, as ``forecast`` has it.
LEAST_PRECISION, LEAST_PREDICTING = 1e-6, 0.02


@dataclass(frozen=True, repr=False)
class Design(ShortRepr):
    """Radiographs at one place in ratio space.

    Attributes
    ----------
    covariance : (n, n) of all residuals, with all that is not known but the ratios and what is in the next two.
    nuisances : (n, M) columns of the nuisances.
    turns : (n, k) columns of the patient's turn (``noise.Noise.turns``), which counts in a set of radiographs that
        shows more than corners of frontal ones.
    slopes : (n, P) of the residuals in the log ratios.
    rows : of each radiograph, by its number.
    more : numbers of the radiographs that show more than corners of frontal ones.
    always : rows that count whatever is taken: measured supports, what is held of the ratios.
    """

    covariance: Floats
    nuisances: Floats
    turns: Floats
    slopes: Floats
    rows: tuple[Ints, ...]
    more: frozenset[int]
    always: slice

    def ratio_sds(self, taken: Sequence[int]) -> Floats:
        """(P,) standard deviations of the log ratios from the radiographs ``taken``, by their numbers."""
        return np.asarray(np.sqrt(np.diag(np.linalg.inv(self._precision(taken)[0]))))

    def prediction_sd(self, taken: Sequence[int], unseen: int, weights: Floats) -> float:
        """Standard deviation of ``weights`` (3 Nv,) times what radiograph ``unseen`` shows, as ``taken`` predict it.

        The unseen one's own errors are part of it.
        """
        rows, own = self._rows(taken), self.rows[unseen]
        columns = self._columns(taken)
        precision, root, solved = self._precision(taken, LEAST_PREDICTING)
        across = weights @ self._between(own, rows, columns)
        apart = weights @ self.slopes[own] - across @ solved
        variance = float(weights @ self._between(own, own, columns) @ weights)
        if len(rows):
            variance -= float(across @ cho_solve(root, across))
        return float(np.sqrt(variance + apart @ np.linalg.solve(precision, apart)))

    def _rows(self, taken: Sequence[int]) -> Ints:
        return np.concatenate([*(self.rows[i] for i in taken), np.arange(len(self.slopes))[self.always]])

    def _columns(self, taken: Sequence[int]) -> Floats:
        return self.nuisances if self.more.isdisjoint(taken) else np.concatenate([self.nuisances, self.turns], axis=1)

    def _between(self, a: Ints, b: Ints, columns: Floats) -> Floats:
        return np.asarray(self.covariance[np.ix_(a, b)] + columns[a] @ columns[b].T)

    def _precision(
        self, taken: Sequence[int], least: float = LEAST_PRECISION
    ) -> tuple[Floats, tuple[Floats, bool], Floats]:
        """(P, P), the covariance's factor, and (n of rows, P) the slopes solved with it."""
        rows = self._rows(taken)
        x = self.slopes[rows]
        whole = self._between(rows, rows, self._columns(taken))
        root = (lower_root(whole) if len(rows) else np.zeros((0, 0))), True
        solved = cho_solve(root, x) if len(rows) else x
        return x.T @ solved + least * np.eye(x.shape[1]), root, solved


def design_at(
    problem: WeighedProblem, point: WeighedPoint, slope: WeighedSlope, tracking_factor: float = 1.0
) -> Design:
    """All radiographs of a problem at a place.

    Parameters
    ----------
    tracking_factor : of the size of tracking's errors, as a fit found it.
    """
    turns = np.zeros((problem.size, problem.noise.turns.shape[1]))
    turns[: problem.noise.size] = problem.noise.turns
    covariance = problem.covariance(point, tracking_factor)
    if turns.size:
        covariance -= turns @ turns.T
    return Design(
        covariance,
        slope.nuisances,
        turns,
        slope.ratios,
        problem.radiographs,
        problem.showing_more,
        slice(problem.noise.size, problem.size),
    )


def better_known(design: Design, unknowns: Unknowns, left: Mapping[Cause, float]) -> Design:
    """The same where something is measured that the problem takes as it was before.

    Parameters
    ----------
    unknowns : of the problem.
    left : group of unknowns -> what is left of their standard deviations.
    """
    shares = np.ones(len(unknowns))
    for group, share in left.items():
        shares[unknowns.in_group(group)] = share
    return replace(design, nuisances=design.nuisances * shares)
