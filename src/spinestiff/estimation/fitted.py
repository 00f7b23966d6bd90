"""What a fit of stiffness ratios gives: the estimate, how well it is known, and what the weighed fit found along."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from spinestiff.anatomy.stiffness import StiffnessRatios
from spinestiff.arrays import Floats, ShortRepr
from spinestiff.estimation.budget import Budget, PriorChange
from spinestiff.estimation.emulator import Place
from spinestiff.estimation.evaluation import FitCost, FitStep
from spinestiff.estimation.kriging import Kriging
from spinestiff.estimation.linear import MOST_PROFILED, Combination
from spinestiff.estimation.objective import Residuals
from spinestiff.estimation.profiles import Likely
from spinestiff.estimation.status import FitStatus
from spinestiff.imaging.features import Orientation
from spinestiff.mechanics.equilibrium import Equilibrium

Method = Literal["weighed", "paper"]
METHODS: tuple[Method, ...] = ("weighed", "paper")


@dataclass(frozen=True)
class NuisanceEstimate:
    """What a fit found of one nuisance parameter, in the unit of its act (``unknowns.ACTS``).

    Attributes
    ----------
    standard : after the fit, in standard deviations before it. value, sd : in the act's unit, where it acts most.
    prior_sd : before the fit, about 0.
    """

    name: str
    group: str
    act: str
    standard: float
    value: float
    sd: float
    prior_sd: float


Outlying = tuple[tuple[str, str, float], ...]
"""Trial, vertebra, by how much its own error is larger than usual."""


@dataclass(frozen=True)
class FitEnd:
    """Where a weighed fit ended, as what is asked of it later needs it.

    Attributes
    ----------
    ratios : by name. nuisances : by name, in prior standard deviations.
    tracking_factor : by which tracking's errors are larger than predicted.
    outlying : vertebrae that count less.
    """

    ratios: Mapping[str, float]
    nuisances: Mapping[str, float]
    tracking_factor: float
    outlying: Outlying = ()

    @classmethod
    def of(cls, fit: StiffnessFit) -> FitEnd:
        """Of a weighed fit."""
        assert fit.weighed is not None
        found = fit.weighed
        return cls(fit.ratios.as_dict(), fit.standard_nuisances, found.tracking_factor, found.outlying)


@dataclass(frozen=True, kw_only=True, repr=False)
class Weighed(ShortRepr):
    """What only the weighed fit tells.

    Attributes
    ----------
    nuisances : all that was not quite known.
    acts : (T, len(ACTS)) of each loaded trial, ``unknowns.ACTS``.
    p_value : of residuals as large, before any scale or weight is fitted; NaN where ratios and
        places of sequences take up all of them.
    tracking_factor : by which tracking's errors are larger than predicted.
    outlying : vertebrae that count less.
    likely : intervals, profiles and draws; None if not asked for. budget, changes : the same.
    held : name -> what was held of the ratios themselves before the fit; empty: they were flat in log.
    data_sd : (P,) standard deviations of the log ratios without that, to first order.
    visit_sd, annotation_sd : (P,) of the log ratios from visit to visit of one person, and from annotation to
        annotation of these radiographs, to first order (``budget.repeated_sds``).
    best_known : the combination of ratios that the data know best, to first order; None where a ratio alone is.
    log_likelihood : of the data at the estimate, with all that is not quite known integrated out to first order.
    places : that intervals come from, the estimate first; empty without profiles.
    tilt : half the log determinant of the nuisances' precision over the log ratios (``weighed``); None where nuisances
        were not integrated out.
    """

    nuisances: tuple[NuisanceEstimate, ...]
    acts: Floats
    p_value: float
    tracking_factor: float
    outlying: Outlying
    likely: Likely | None
    budget: Budget | None
    changes: tuple[PriorChange, ...]
    held: Mapping[str, str]
    data_sd: Floats
    visit_sd: Floats
    annotation_sd: Floats
    best_known: Combination | None
    log_likelihood: float
    places: tuple[Place, ...] = field(repr=False)
    tilt: Kriging | None = field(repr=False)


@dataclass(frozen=True, repr=False)
class StiffnessFit(ShortRepr):
    """Estimated ratios and how well they are known.

    Attributes
    ----------
    ratios : the estimate.
    status : how the fit ended; ``status.value`` holds cause and remedy.
    covariance : (P, P) of the log ratios, to first order; not finite where the data say nothing, or by the paper's fit.
    intervals95 : name -> ends of the 95 % interval of the ratio; NaN where none was asked for.
    open_ends : name -> whether the lower and the upper end is the fit's bound, beyond which the data allow more.
    at_bound : name -> at its bound.
    rmse_mm, default_rmse_mm : training RMSE at the patient plane, fitted and with all ratios 1 (NaN without
        an equilibrium there, or where the fit's start was solved from known states).
    residuals : one a loaded trial, simulated minus measured.
    equilibria, default_equilibria : one a loaded trial.
    history : every evaluation. cost : what it took.
    warnings : what a reader of the result must know.
    weighed : what only the weighed fit tells.
    """

    SHOWN_BY: ClassVar[str] = "spinestiff.estimation.picture:html_of"

    ratios: StiffnessRatios
    status: FitStatus
    covariance: Floats
    intervals95: Mapping[str, tuple[float, float]]
    open_ends: Mapping[str, tuple[bool, bool]]
    at_bound: Mapping[str, bool]
    rmse_mm: float
    default_rmse_mm: float
    residuals: tuple[Residuals, ...] = field(repr=False)
    equilibria: tuple[Equilibrium, ...] = field(repr=False)
    default_equilibria: tuple[Equilibrium, ...] = field(repr=False)
    history: tuple[FitStep, ...] = field(repr=False)
    cost: FitCost
    method: Method
    orientation: Orientation
    bounds: tuple[float, float]
    warnings: tuple[str, ...] = ()
    weighed: Weighed | None = None

    @property
    def names(self) -> tuple[str, ...]:
        return self.ratios.names

    @property
    def profiled(self) -> bool:
        """Whether intervals are from profiles; those of many ratios are to first order (``linear``)."""
        return len(self.names) <= MOST_PROFILED

    @property
    def correlation(self) -> Floats:
        """(P, P) correlation of the log ratios; NaN where the data say nothing."""
        sd = np.sqrt(np.diag(self.covariance))
        with np.errstate(invalid="ignore"):
            return np.asarray(self.covariance / np.outer(sd, sd))

    @property
    def standard_nuisances(self) -> dict[str, float]:
        """Name -> what was found of each nuisance, in its prior's standard deviations."""
        return {} if self.weighed is None else {one.name: one.standard for one in self.weighed.nuisances}

    @property
    def likely(self) -> Likely | None:
        """Intervals, profiles and draws, if asked for."""
        return None if self.weighed is None else self.weighed.likely

    @property
    def default_words(self) -> str:
        """The default's training RMSE, if it has an equilibrium."""
        found = self.default_rmse_mm
        return "default: no equilibrium known" if np.isnan(found) else f"default {found:.2f} mm"

    def __str__(self) -> str:
        lines = [f"{self.status.name}: training RMSE {self.rmse_mm:.2f} mm ({self.default_words})"]
        for name, value in self.ratios.as_dict().items():
            ends = self._ends(name, "95 % ")
            bound = " at bound" if self.at_bound[name] else ""
            lines.append(f"  {name} {value:.4g}{ends}{bound}")
        return "\n".join([*lines, *(f"  warning: {text}" for text in self.warnings)])

    def _facts(self) -> Iterator[str]:
        yield self.status.name
        for name, value in self.ratios.as_dict().items():
            yield f"{name}={value:.4g}{self._ends(name)}"
        yield f"training RMSE {self.rmse_mm:.2f} mm"

    def _ends(self, name: str, what: str = "") -> str:
        """The interval's ends in brackets; nothing where none was asked for."""
        low, high = self.intervals95[name]
        return "" if np.isnan([low, high]).any() else f" ({what}{low:.3g} to {high:.3g})"
