"""A place of the weighed fit: the residuals at one set of ratios and nuisances, and first order around it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from spinestiff.arrays import Floats, ShortRepr
from spinestiff.estimation.evaluation import Evaluation, Slope
from spinestiff.estimation.sights import SightResiduals


@dataclass(frozen=True, repr=False)
class WeighedPoint(ShortRepr):
    """Residuals at one set of log ratios and nuisances.

    Attributes
    ----------
    nuisances : (M,) in units of their priors' standard deviations.
    evaluation : the loaded trials in equilibrium.
    values : (n,) channels of simulated minus measured features, mm, then supports and what is held of the ratios, in
        standard deviations.
    further : what the loaded trials show beside their own corners, in the problem's order.
    """

    nuisances: Floats
    evaluation: Evaluation
    values: Floats
    further: tuple[SightResiduals, ...] = ()

    @property
    def log_ratios(self) -> Floats:
        return self.evaluation.log_ratios


@dataclass(frozen=True, repr=False)
class WeighedSlope(ShortRepr):
    """First order around a point: derivatives (n, P) in log ratio and (n, M) in the nuisances."""

    slope: Slope
    ratios: Floats
    nuisances: Floats

    @property
    def light(self) -> WeighedSlope:
        """The same without tangents and moves of states, which are large."""
        return replace(self, slope=Slope((), ()))
