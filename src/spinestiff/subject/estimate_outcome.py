"""The estimate with its checks and its uncertainty as a file in ``results/``: its schema (``run_record`` writes it)."""

from __future__ import annotations

from math import isfinite
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from spinestiff.anatomy.template import Mesh
from spinestiff.imaging.features import Orientation
from spinestiff.subject.outcome_parts import (
    LEAST_FIRST,
    Determination,
    Outcome,
    OutcomeFile,
    Pair,
    PoseRecord,
    Quantity,
    determination,
)

OF_FRAME = " in "
"""Between a vertebra and its frame, where both name one thing."""


class Check(Outcome):
    """Whether one thing about a result can be right.

    Attributes
    ----------
    name : of the check, e.g. "rest and push"; those of a push come once for each push.
    value, limit : what was found and the bound it was held to, in the unit of ``text``; None where there is none.
    passed : None = not possible, since the data for it are missing; ``text`` says which.
    text : one line; of a failed check the causes to look for, the most likely first.
    """

    name: str
    value: float | None
    limit: float | None
    passed: bool | None
    text: str


class RatioEstimate(Quantity):
    """An estimated ratio.

    Attributes
    ----------
    at_bound : the value itself lies at the fit's bound.
    profile : what the likelihood looks like along it: "bounded", "one-sided", "flat", "at a bound" or "several minima";
        None without intervals.
    """

    at_bound: bool
    profile: str | None = None
    determined: Determination

    @classmethod
    def of(
        cls,
        value: float,
        ends: Pair,
        opens: tuple[bool, bool],
        at_bound: bool,
        profile: str | None = None,
        data_sd_log: float | None = None,
    ) -> Self:
        """From the ends of its interval; what is not finite counts as not found.

        ``data_sd_log``, of the data alone, says how far they determine it where a prior narrows the interval.
        """
        low, high = (float(end) if isfinite(end) else None for end in ends)
        quantity = Quantity(value=value, low=low, high=high, open_low=opens[0], open_high=opens[1])
        known = [quantity.determination, *([] if data_sd_log is None else [determination(2.0 * data_sd_log)])]
        least = next(word for word in LEAST_FIRST if word in known)
        return cls(**quantity.model_dump(), at_bound=at_bound, profile=profile, determined=least)


class PlainStiffness(Quantity):
    """A stiffness in plain units. Its interval is that of the one ratio that scales it as a whole; where several ratios
    scale it, to first order; else none.

    Attributes
    ----------
    unit : "N m/rad" or "kPa".
    ratio : the estimated ratio that scales it, or None.
    """

    unit: str
    ratio: str | None


class Reactions(Outcome):
    """Forces at the supports under the largest training push, N, above 0 against the push, beside Eqs. 1-2.

    Attributes
    ----------
    push : of which frame. f3 : the push.
    shoulder, pelvis : lateral forces in the model.
    pelvis_moment_nm : about the AP axis, N m, above 0 against the push, too; Eqs. 1-2 have none.
    wall_pull : the most that the back wall pulls at one of its points; a real one can't.
    eq2_shoulder, eq1_pelvis : lateral forces by Eqs. 2 and 1; None without the push's distances.
    """

    push: str
    f3: float
    shoulder: float
    pelvis: float
    pelvis_moment_nm: float
    wall_pull: Annotated[float, Field(ge=0.0)]
    eq2_shoulder: float | None
    eq1_pelvis: float | None


class NuisanceRecord(Outcome):
    """What the fit found of something that is not quite known (``estimation.unknowns``).

    Attributes
    ----------
    group : what it is a case of. unit : of value, sd and prior_sd.
    value, sd : after the fit. prior_sd : before it, about 0.
    standard : the value in standard deviations before the fit.
    """

    name: str
    group: str
    unit: str
    value: float
    sd: float
    prior_sd: float
    standard: float


class SupportPlaceRecord(Outcome):
    """Where a training frame's supports were found: the pelvis' obliquity and the shoulder's lateral place."""

    push: str
    frame: int
    obliquity_deg: float
    shoulder_mm: float


class BudgetRecord(Outcome):
    """What one unknown does to the estimate's uncertainty (``estimation.budget.BudgetRow``).

    Attributes
    ----------
    alone, without : standard deviation of each ratio's log, by name.
    """

    name: str
    alone: dict[str, float]
    without: dict[str, float]


class ProfileRecord(Outcome):
    """By how much the negative log likelihood is higher along a ratio, others at their most probable."""

    ratio: tuple[float, ...]
    rise: tuple[float, ...]


class PriorChangeRecord(Outcome):
    """The ratios and the standard deviations of their logs with one prior's standard deviation times ``factor``."""

    name: str
    factor: float
    ratios: dict[str, float]
    sd_log: dict[str, float]


class CombinationRecord(Outcome):
    """A product of powers of the ratios, and the standard deviation of its log, to first order."""

    exponents: dict[str, float]
    value: float
    sd_log: float


class FitStepRecord(Outcome):
    """One evaluation of the fit; without an equilibrium there is no loss."""

    ratios: dict[str, float]
    loss: float | None
    rmse_mm: float | None
    accepted: bool


class CostRecord(Outcome):
    """What the fit took."""

    equilibria: int
    newton_iterations: int
    factorisations: int
    seconds: float


class TrainingError(Outcome):
    """Corner RMSE over the training frames, mm at the patient plane."""

    default: float | None
    fit: float


class Estimate(OutcomeFile):
    """``estimate.json``: the stiffness and how well it is known.

    Attributes
    ----------
    status : DOUBTFUL if a check failed, else ``fit_status``.
    fit_status, fit_status_text : how the search ended, and what that means.
    determined : the least of the ratios' determinations.
    checks : whether the result can be right.
    ratios : by name, in the order of ``parameters``.
    intervals : how those of the ratios were found: from a "profile" of each, "linear" to first order, or "none".
    profiles : by ratio; empty without. interval_rise : at which a 95 % interval of one ratio ends.
    population : whose ratios were held as a prior; None: nobody's.
    held : name -> what was held of the ratios before the fit, which is no data. data_sd_log : standard deviation of
        each ratio's log without it, to first order; empty where nothing was held.
    plain : in plain units, by "lateral_bending_thoracic", "lateral_bending_lumbar", "tissue_young".
    covariance_log : (P, P) of the log ratios; None = not finite. correlation : of the first and the last.
    region : outline of the 95 % joint region of two ratios, (n, 2), not cut at the bounds; None = not drawn.
    region_size : by how much twice the negative log likelihood has risen there.
    nuisances : what was found of all that is not quite known. supports : the same of pelvis and shoulder, by frame.
    budget : by unknown; ``sd_log`` and ``sd_log_tracking``: with all unknowns, and with errors of tracking alone.
    visit_sd_log, annotation_sd_log : standard deviations of the ratios' logs from visit to visit of one person whose
        stiffness stays, and from annotation to annotation of these radiographs, to first order; empty by the paper's
        method.
    prior_changes : other priors, other estimates.
    best_known : the combination of ratios that is known best; None where a ratio alone is.
    p_value : of residuals as large, if all errors are as expected. tracking_factor : by which tracking's were larger.
    outlying : vertebrae whose own errors were larger than usual, and by how much: "T9 in push 'main' frame 2".
    mesh : of the tissue on which the ratios were found; those of a coarse one are not for reporting.
    poses : by push.
    notes : what a reader must know that is no sign of a mistake.
    """

    FILE: ClassVar[str] = "estimate.json"
    STEP: ClassVar[str] = "estimate"
    status: Literal["DOUBTFUL", "CONVERGED", "AT_BOUND", "NOT_IDENTIFIABLE"]
    fit_status: Literal["CONVERGED", "AT_BOUND", "NOT_IDENTIFIABLE"]
    fit_status_text: str
    determined: Determination
    checks: tuple[Check, ...]
    parameters: tuple[str, ...]
    ratios: dict[str, RatioEstimate]
    intervals: Literal["profile", "linear", "none"] = "profile"
    profiles: dict[str, ProfileRecord] = Field(default_factory=dict)
    interval_rise: float | None = None
    population: str | None = None
    held: dict[str, str] = Field(default_factory=dict)
    data_sd_log: dict[str, float] = Field(default_factory=dict)
    plain: dict[str, PlainStiffness]
    covariance_log: tuple[tuple[float | None, ...], ...]
    correlation: float | None
    region: tuple[Pair, ...] | None
    region_size: float | None
    nuisances: tuple[NuisanceRecord, ...] = ()
    supports: tuple[SupportPlaceRecord, ...] = ()
    visit_sd_log: dict[str, float] = Field(default_factory=dict)
    annotation_sd_log: dict[str, float] = Field(default_factory=dict)
    sd_log: dict[str, float] = Field(default_factory=dict)
    sd_log_tracking: dict[str, float] = Field(default_factory=dict)
    budget: tuple[BudgetRecord, ...] = ()
    prior_changes: tuple[PriorChangeRecord, ...] = ()
    best_known: CombinationRecord | None = None
    p_value: float | None = None
    tracking_factor: float | None = None
    outlying: dict[str, float] = Field(default_factory=dict)
    training_rmse_mm: TrainingError
    reactions_n: Reactions
    history: tuple[FitStepRecord, ...]
    method: Literal["weighed", "paper"]
    mesh: Mesh
    orientation: Orientation
    bounds: Pair
    poses: dict[str, PoseRecord]
    cost: CostRecord
    notes: tuple[str, ...]

    @model_validator(mode="after")
    def _names_agree(self) -> Self:
        if set(self.parameters) != set(self.ratios):
            raise ValueError(f"parameters {', '.join(self.parameters)} but ratios {', '.join(self.ratios)}")
        return self

    @property
    def quick_look(self) -> bool:
        """Whether it was made on a coarse mesh, whose ratios are not for reporting."""
        return self.mesh == "coarse"

    @property
    def failed(self) -> tuple[Check, ...]:
        """The checks that failed."""
        return tuple(check for check in self.checks if check.passed is False)

    @property
    def outlying_vertebrae(self) -> tuple[tuple[str, str, float], ...]:
        """Frame, vertebra and factor of each of ``outlying``."""
        parted = [(name.partition(OF_FRAME), factor) for name, factor in self.outlying.items()]
        return tuple((frame, vertebra, factor) for (vertebra, _, frame), factor in parted)

    @property
    def values(self) -> dict[str, float]:
        """Ratio by name, in the order of the fit."""
        return {name: self.ratios[name].value for name in self.parameters}
