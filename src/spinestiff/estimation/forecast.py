"""What a radiograph that no fit has seen should show, and how far from that the real one may be.

About the fit's place residuals r = simulated - measured are linear in ratios q, flat, and in what else is not known,
with covariance C of all radiographs, seen and unseen. From those of the seen ones, s, those of an unseen one, u, are
predicted at the fit's ratios, with an error to which the ratios' own adds (universal kriging; Goldberger 1962):

    E r_u = C_us C_ss^-1 r_s,
    V = C_uu - C_us C_ss^-1 C_su + D (X_s^T C_ss^-1 X_s)^-1 D^T,      D = X_u - C_us C_ss^-1 X_s.

Universal kriging would first take its own step to the ratios of the least r_s^T C_ss^-1 r_s. The fit is there, or where
nuisances integrated out put it, or at a bound, where no step leads farther.

So an error that seen and unseen radiographs share (where the patient stood, an annotation, what the model lacks) is
expected again, and only the rest is uncertain. No vertebra of the unseen radiograph is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve

from spinestiff.arrays import Floats, Ints, ShortRepr
from spinestiff.estimation.channels import CHANNELS, Channels
from spinestiff.estimation.noise import lower_root
from spinestiff.estimation.point import WeighedPoint, WeighedSlope
from spinestiff.estimation.weighed import WeighedProblem
from spinestiff.normal import HALF_WIDTH_95

# Of a log ratio, as of one anywhere within a fit's bounds: one that nothing shows must not stop the rest.
LEAST_PRECISION = 0.02


@dataclass(frozen=True, repr=False)
class Forecast(ShortRepr):
    """An unseen radiograph.

    Attributes
    ----------
    channels : of its vertebrae.
    expected : (3 Nv,) mm, channels of simulated minus measured as the seen radiographs let expect them.
    covariance : (3 Nv, 3 Nv) mm^2 of the real ones about them, tracking's errors among it.
    found : (3 Nv,) mm, the real ones.
    """

    channels: Channels
    expected: Floats
    covariance: Floats
    found: Floats

    @property
    def corner_sds(self) -> Floats:
        """(Nv, 4, 2) mm, standard deviations of the corners' coordinates at the patient plane."""
        return np.sqrt(np.einsum("vcki,vcd,vdki->vki", self.channels.basis, self._blocks, self.channels.basis))

    @property
    def corner_errors(self) -> Floats:
        """(Nv, 4, 2) mm, expected minus measured corners, as far as vertebrae are rigid."""
        left = (self.found - self.expected).reshape(-1, CHANNELS)
        return np.einsum("vc,vcki->vki", left, self.channels.basis)

    @property
    def inside95(self) -> float:
        """Share of corner coordinates that lie inside their 95 % intervals."""
        return float(np.mean(np.abs(self.corner_errors) <= HALF_WIDTH_95 * self.corner_sds))

    def turn(self, upper: int, lower: int) -> tuple[float, float, float]:
        """rad, the turn of vertebra ``upper`` against ``lower`` (rows of this radiograph), simulated minus measured:
        expected, standard deviation, found."""
        weights = self.channels.turning(upper, lower)
        sd = float(np.sqrt(weights @ self.covariance @ weights))
        return float(weights @ self.expected), sd, float(weights @ self.found)

    @property
    def _blocks(self) -> Floats:
        count = len(self.channels.rows)
        whole = self.covariance.reshape(count, CHANNELS, count, CHANNELS)
        return np.asarray(whole[np.arange(count), :, np.arange(count)])


def forecast(
    problem: WeighedProblem,
    point: WeighedPoint,
    slope: WeighedSlope,
    tracking_factor: float,
    unseen: Sequence[int],
    inflation: Floats | None = None,
) -> tuple[Forecast, ...]:
    """The unseen ones among the loaded trials of a problem, at the place where a fit of the others ended.

    Parameters
    ----------
    tracking_factor : what the fit found of the size of tracking's errors.
    unseen : their numbers among the loaded trials.
    inflation : (n of channels,) what the fit found of vertebrae's own variance; default 1.
    """
    noise = problem.noise
    covariance = problem.covariance(point, tracking_factor, inflation) + slope.nuisances @ slope.nuisances.T
    values = point.values - slope.nuisances @ point.nuisances
    rows = [np.arange(problem.size)[noise.of(i)] for i in unseen]
    hidden = np.concatenate([*rows, *(problem.further_rows(i) for i in unseen)])
    seen: Ints = np.setdiff1d(np.arange(problem.size), hidden)
    root = lower_root(covariance[np.ix_(seen, seen)]), True
    x, r = slope.ratios[seen], values[seen]
    solved = cho_solve(root, np.column_stack([x, r]))
    precision = x.T @ solved[:, :-1] + LEAST_PRECISION * np.eye(x.shape[1])
    found = []
    for i, own in zip(unseen, rows):
        across = covariance[np.ix_(own, seen)]
        apart = slope.ratios[own] - across @ solved[:, :-1]
        spread = covariance[np.ix_(own, own)] - across @ cho_solve(root, across.T)
        spread = spread + apart @ np.linalg.solve(precision, apart.T)
        mean = across @ solved[:, -1]
        found.append(Forecast(noise.boxes(i), mean, 0.5 * (spread + spread.T), values[own]))
    return tuple(found)
