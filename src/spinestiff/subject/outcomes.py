"""What the steps find, as files in ``results/``: their schemas. ``run_record`` writes and reads them."""

from __future__ import annotations

from collections.abc import Sequence
from math import degrees, isfinite, pi
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from spinestiff.arrays import Floats, Ints
from spinestiff.imaging.features import Orientation, VertebraCorners
from spinestiff.imaging.pedicles import PediclePoints
from spinestiff.imaging.projection import XRayView
from spinestiff.imaging.tracking import SupportMotion
from spinestiff.subject.outcome_parts import (
    LEAST_FIRST,
    Determination,
    Outcome,
    OutcomeFile,
    Pair,
    PoseRecord,
    Quantity,
    Vector,
    ViewRecord,
    determination,
)
from spinestiff.subject.records import Role, VertebraName


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


class Measured(Outcome):
    """A measured value with its standard error."""

    value: float
    sd: Annotated[float, Field(gt=0.0)]

    def scaled(self, factor: float) -> Measured:
        """The same in another unit."""
        return Measured(value=self.value * factor, sd=self.sd * factor)


class TrackedFrame(Outcome):
    """One frame of a push. Of supports everything is measured from the push's first frame.

    Attributes
    ----------
    force_n : as files of earlier versions have it; forces are those of ``subject.json``.
    corners_px : (Nv, 4, 2) column, row. quality : (Nv, 4), from 0 to 1.
    support_motion_mm : by support, where it is seen; of a shoulder only across its wall.
    obliquity_deg : turn of the pelvis about the AP axis, +z; above 0 the patient's left side rises. None in the first
        frame, and where fewer than two points of the pelvis are seen.
    shoulder_mm : the shoulder's motion to the patient's left, +x, at the patient plane; None in the first frame, and
        where it is not seen.
    support_note : what moved by more than the paper allows ("the pelvis moved by 3.4 mm, obliquity +2.1 degrees").
    """

    force_n: float | None = None
    corners_px: tuple[tuple[Pair, Pair, Pair, Pair], ...]
    quality: tuple[tuple[float, float, float, float], ...]
    support_motion_mm: dict[str, float] = Field(default_factory=dict)
    obliquity_deg: Measured | None = None
    shoulder_mm: Measured | None = None
    support_note: str = ""

    @property
    def obliquity(self) -> Measured | None:
        """``obliquity_deg`` in rad."""
        return None if self.obliquity_deg is None else self.obliquity_deg.scaled(pi / 180.0)


class MarkedPedicles(Outcome):
    """Pedicles that a person marked in a push's frame: of each vertebra the left and the right one, column, row."""

    frame: int
    vertebrae: tuple[VertebraName, ...]
    centres_px: tuple[tuple[Pair, Pair], ...]

    def points(self, view: XRayView) -> PediclePoints:
        """In mm on the detector of the frame's view."""
        return PediclePoints(self.vertebrae, view.from_pixels(np.array(self.centres_px)))


class SidePicture(Outcome):
    """A frame's radiograph from another side, as a person marked it or as tracking followed it.

    Attributes
    ----------
    frame : of the push. vertebrae : (Nv,) names, head to foot. corners_px : (Nv, 4, 2) column, row.
    quality : (Nv, 4), from 0 to 1, of corners that were followed; None: set by hand.
    followed_from : the frame from which they were, the nearest of those marked by hand; None: set by hand.
    pedicles : marked in it; None without.
    """

    frame: int
    vertebrae: tuple[VertebraName, ...]
    corners_px: tuple[tuple[Pair, Pair, Pair, Pair], ...]
    quality: tuple[tuple[float, float, float, float], ...] | None = None
    followed_from: int | None = None
    pedicles: MarkedPedicles | None = None

    @model_validator(mode="after")
    def _is_one_of_two(self) -> Self:
        if (self.quality is None) != (self.followed_from is None):
            raise ValueError("quality, followed_from: wanted both, of corners that were followed, or none")
        if len(self.corners_px) != len(self.vertebrae):
            raise ValueError(f"corners_px: {len(self.corners_px)} for {len(self.vertebrae)} vertebrae")
        if self.quality is not None and len(self.quality) != len(self.vertebrae):
            raise ValueError(f"quality: {len(self.quality)} for {len(self.vertebrae)} vertebrae")
        return self


class SideView(Outcome):
    """A push's radiographs from another side.

    Attributes
    ----------
    id : as in ``subject.json``. view : nominal. millimetres : where they come from.
    pictures : in the order of their frames.
    """

    id: str
    view: ViewRecord
    millimetres: dict[str, str] = Field(default_factory=dict)
    pictures: tuple[SidePicture, ...]

    def corners(self, picture: SidePicture) -> VertebraCorners:
        """In mm on the detector, with their quality."""
        places = self.view.view().from_pixels(np.array(picture.corners_px))
        if picture.quality is None:
            return VertebraCorners(picture.vertebrae, places)
        return VertebraCorners(picture.vertebrae, places, np.array(picture.quality))


class MarkerTracks(Outcome):
    """Markers on the skin under a push, as their table has them.

    Attributes
    ----------
    names : (M,). reference : the frame without force from which motion counts.
    side : of the trunk. shown_px : where that frame's radiograph shows them, column and row, by name.
    frames : of each, (M,) mm along the body's left, up and front, from the cameras' origin; None: not seen.
    """

    names: tuple[str, ...]
    reference: int
    side: Literal["front", "back", "both"]
    shown_px: dict[str, Pair]
    frames: tuple[tuple[Vector | None, ...], ...]

    @property
    def positions(self) -> Floats:
        """(frames, M, 3) mm; NaN: not seen."""
        return np.array([[(np.nan,) * 3 if place is None else place for place in frame] for frame in self.frames])

    @property
    def shown(self) -> tuple[Ints, Floats]:
        """Numbers (S,) of the markers that the radiograph shows, and where, (S, 2) column, row."""
        rows = np.array([self.names.index(name) for name in self.shown_px], dtype=np.int64)
        return rows, np.array(list(self.shown_px.values()))


class TrackedPush(Outcome):
    """A push as tracked.

    Attributes
    ----------
    view : nominal, of its frames. millimetres : where they come from.
    vertebrae : (Nv,) names, head to foot.
    annotated_frames : those whose corners a person set.
    frames : one a radiograph.
    pedicles : as marked, by frame; they are not tracked. sides : the same frames from other sides.
    markers : on the skin, in the same frames; None without.
    """

    view: ViewRecord
    millimetres: dict[str, str] = Field(default_factory=dict)
    vertebrae: tuple[VertebraName, ...]
    annotated_frames: tuple[int, ...] = ()
    frames: tuple[TrackedFrame, ...]
    pedicles: tuple[MarkedPedicles, ...] = ()
    sides: tuple[SideView, ...] = ()
    markers: MarkerTracks | None = None

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        for index, frame in enumerate(self.frames):
            for what, found in (("corners_px", frame.corners_px), ("quality", frame.quality)):
                if len(found) != len(self.vertebrae):
                    raise ValueError(f"frames[{index}].{what}: {len(found)} for {len(self.vertebrae)} vertebrae")
        if not self.frames:
            raise ValueError("frames: found none, wanted one a radiograph")
        if self.markers is not None and len(self.markers.frames) != len(self.frames):
            raise ValueError(f"markers.frames: {len(self.markers.frames)} for {len(self.frames)} radiographs")
        return self

    @classmethod
    def of(
        cls,
        view: XRayView,
        tracked: Sequence[VertebraCorners],
        supports: Sequence[SupportMotion] = (),
        **said: object,
    ) -> Self:
        """The record of a push from its frames' corners on the detector, mm.

        Parameters
        ----------
        supports : what was seen of pelvis and shoulder in these frames.
        said : ``millimetres``, ``annotated_frames``, ``pedicles``, ``sides`` and ``markers``.
        """
        frames = [
            {
                "corners_px": view.pixels(corners.corners).round(3).tolist(),
                "quality": corners.quality.round(3).tolist(),
                "support_motion_mm": {m.name: round(float(m.distance[i]), 3) for m in supports if m.seen[i]},
                "support_note": "; ".join(notes[i] for notes in (m.notes() for m in supports) if i in notes),
                **(_support_places(supports, i) if i > 0 else {}),
            }
            for i, corners in enumerate(tracked)
        ]
        return cls.model_validate(
            {"view": ViewRecord.of(view), "vertebrae": tracked[0].vertebrae, "frames": frames, **said}
        )

    def corners(self, frame: int) -> VertebraCorners:
        """The corners of a frame in mm on the detector, with their quality."""
        found = self.frames[frame]
        return VertebraCorners(
            self.vertebrae, self.view.view().from_pixels(np.array(found.corners_px)), np.array(found.quality)
        )


def _support_places(supports: Sequence[SupportMotion], frame: int) -> dict[str, Measured]:
    """Where a frame shows pelvis and shoulder, as ``TrackedFrame`` has it."""
    found = {}
    for motion in supports:
        if motion.name == "pelvis" and motion.turn_seen[frame]:
            turn, sd = (round(degrees(angle[frame]), 4) for angle in (motion.turn, motion.turn_error))
            found["obliquity_deg"] = Measured(value=turn, sd=sd)
        if motion.name == "shoulder" and motion.seen[frame]:
            across, sd = (round(float(part), 3) for part in (motion.displacement[frame, 0], motion.error[frame]))
            found["shoulder_mm"] = Measured(value=across, sd=sd)
    return found


class Tracked(OutcomeFile):
    """``tracked.json``: the vertebra corners of every frame, by push."""

    FILE: ClassVar[str] = "tracked.json"
    STEP: ClassVar[str] = "track"
    pushes: dict[str, TrackedPush]


class FrameProposal(Outcome):
    """What a frame is good for (``spinestiff frames``), and the role that is proposed beside the one it has."""

    push: str
    side: Literal["left", "right"]
    level: float
    frame: int
    force_n: float
    sharpness: float | None
    contrast_to_noise: float | None
    saturated: float | None
    vertebrae: int
    tracking_mm: float | None
    supports: dict[str, dict[Literal["mm", "degrees"], float | None]]
    role: Role
    proposed: Role
    reason: str


class FrameProposals(OutcomeFile):
    """``frames.json``: every frame's quality and proposed role."""

    FILE: ClassVar[str] = "frames.json"
    STEP: ClassVar[str] = "frames"
    frames: tuple[FrameProposal, ...]


class ForcePerDegree(Outcome):
    """N per degree of an angle under one push, its size without a sign.

    Attributes
    ----------
    value : None = the angle did not change beyond its errors, so that only ``low`` is known.
    low, high : 95 % interval; ``high`` is None where ``value`` is.
    """

    value: float | None
    low: float
    high: float | None


class AngleResponse(Outcome):
    """How an angle between two fixed vertebrae answers a push (``curves.response``).

    Attributes
    ----------
    levels : upper and lower vertebra. frames : that it was read in.
    rest_deg : without force, signed. change_deg, change_sd_deg : from there to the largest force, by the corners.
    n_per_degree : over all these frames.
    scatter : of the frames about a straight line over the force, over what their errors explain; above 1 it has
        widened the interval. None with a single loaded frame.
    """

    levels: tuple[VertebraName, VertebraName]
    frames: tuple[int, ...]
    rest_deg: float
    change_deg: float
    change_sd_deg: float
    n_per_degree: ForcePerDegree
    scatter: float | None


class Flexibility(Outcome):
    """By how much of itself the curve became smaller under the largest force; below 0 it grew.

    Attributes
    ----------
    percent, low, high : with the 95 % interval. None where the curve at rest does not stand out from its errors.
    """

    percent: float | None
    low: float | None
    high: float | None


class PushResponse(Outcome):
    """What one push says without a model.

    Attributes
    ----------
    force_n : the largest in a usable frame.
    tilt : of the largest change of tilt between two vertebrae, chosen at that force.
    curve : of the Cobb angle between the end vertebrae of the rest picture.
    missing : why there are no numbers, or empty.
    """

    force_n: float
    tilt: AngleResponse | None = None
    curve: AngleResponse | None = None
    flexibility: Flexibility | None = None
    missing: str = ""

    @model_validator(mode="after")
    def _says_why(self) -> Self:
        if (None in (self.tilt, self.curve, self.flexibility)) != bool(self.missing):
            raise ValueError("missing: wanted a reason where there are no numbers, and only there")
        return self


class Responses(OutcomeFile):
    """``response.json``: what each push says without a model, and the gauge's errors assumed (standard deviations)."""

    FILE: ClassVar[str] = "response.json"
    STEP: ClassVar[str] = "response"
    gauge_scale_sd: float
    gauge_zero_sd_n: float
    pushes: dict[str, PushResponse]


class VertebraFitRecord(Outcome):
    """How well a vertebra fits a rest radiograph (``personalise.fitness.VertebraFit``)."""

    rmse_mm: float
    centre_mm: float
    angle_deg: float
    wrong_corners: int


class MeshRecord(Outcome):
    """The subject's tissue mesh: how it came about, its size and its worst element."""

    path: Literal["kept", "rebuilt", "finer"]
    nodes: int
    smallest_j: float
    smallest_dihedral_deg: float


class ScanRecord(Outcome):
    """How the skin fits its scan (``personalise.scanned_skin.ScanFit``); distances as median and 95th percentile."""

    covered: float
    used: float
    before_mm: Pair
    after_mm: Pair
    left_to_template: tuple[str, ...]
    held_mm: float
    yaw_deg: float
    tilt_deg: float
    turned_round: bool


class GeometryRecord(OutcomeFile):
    """``personalised.json``: how the subject's geometry was found and how well it fits; the torso is ``torso.npz``.

    Attributes
    ----------
    rmse_mm, poses, views, millimetres, fits : by view, "frontal" and "lateral"; ``fits`` by vertebra.
    prior_only : vertebrae that no radiograph shows. carried : vertebra -> motions that the prior determines more.
    length_scale : the spine's length over the template's at the given height.
    size_scale : vertebra -> width, height and depth over the template's at the given height.
    corner_sd_mm : of annotated corners along one axis.
    covariance : (V, 6, 6V) rows of the covariance of (dt mm, dw rad), vertebra by vertebra.
    """

    FILE: ClassVar[str] = "personalised.json"
    STEP: ClassVar[str] = "personalise"
    rmse_mm: dict[str, float]
    poses: dict[str, PoseRecord]
    views: dict[str, ViewRecord]
    millimetres: dict[str, dict[str, str]]
    fits: dict[str, dict[VertebraName, VertebraFitRecord]]
    prior_only: tuple[str, ...]
    carried: dict[str, tuple[str, ...]]
    length_scale: float
    size_scale: dict[str, Vector]
    corner_sd_mm: float
    covariance: tuple[tuple[tuple[float, ...], ...], ...]
    mesh: MeshRecord
    skin_scan: ScanRecord | None
    warnings: tuple[str, ...]


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
    eq2_shoulder, eq1_pelvis : lateral forces by Eqs. 2 and 1.
    """

    push: str
    f3: float
    shoulder: float
    pelvis: float
    pelvis_moment_nm: float
    wall_pull: Annotated[float, Field(ge=0.0)]
    eq2_shoulder: float
    eq1_pelvis: float


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
    outlying : vertebrae whose own errors were larger than usual, and by how much.
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
    method: str
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
    def failed(self) -> tuple[Check, ...]:
        """The checks that failed."""
        return tuple(check for check in self.checks if check.passed is False)

    @property
    def values(self) -> dict[str, float]:
        """Ratio by name, in the order of the fit."""
        return {name: self.ratios[name].value for name in self.parameters}


class CobbChangeRecord(Outcome):
    """Change of the Cobb angle from the push's least force (``curves.tilts.CobbChange``), degrees.

    Attributes
    ----------
    signed, fixed_levels, tilt : its three forms.
    levels : end vertebrae of ``fixed_levels``. tilt_levels : those of ``tilt``.
    signed_levels : those of the two angles behind ``signed``, e.g. "T6–T11 to T5–T12".
    sds : standard deviations of the three, by the corners' errors; None: a model's, which has none.
    """

    signed: float
    fixed_levels: float
    tilt: float
    levels: tuple[str, str]
    tilt_levels: tuple[str, str]
    signed_levels: str = ""
    sds: tuple[float, float, float] | None = None


class ForecastRecord(Outcome):
    """What the estimate and the errors that frames share let expect of a frame (``estimation.forecast``).

    Attributes
    ----------
    rmse_mm, sd_mm : of corners at the patient plane, found and expected.
    inside95 : share of corner coordinates inside their 95 % intervals.
    cobb_error_deg, cobb_sd_deg : expected minus measured turn between the end vertebrae of the Cobb angle, and its
        standard deviation; None where one of them is not seen.
    """

    rmse_mm: float
    sd_mm: float
    inside95: float
    cobb_error_deg: float | None
    cobb_sd_deg: float | None


class HeldOutFrame(Outcome):
    """A frame that the estimate has not seen.

    Attributes
    ----------
    rmse_mm : by predictor, corner RMSE at the patient plane; None where it makes no prediction.
    cobb_change_deg : "measured" and by predictor.
    forecast : with its intervals; None by the paper's estimator.
    """

    push: str
    frame: int
    force_n: float
    rmse_mm: dict[str, float | None]
    cobb_change_deg: dict[str, CobbChangeRecord | None]
    forecast: ForecastRecord | None = None


class Assessment(OutcomeFile):
    """``assessment.json``: how well the held-out frames are predicted; ``notes`` on the supports in all frames."""

    FILE: ClassVar[str] = "assessment.json"
    STEP: ClassVar[str] = "assess"
    frames: tuple[HeldOutFrame, ...]
    notes: tuple[str, ...] = ()


class Comparison(OutcomeFile):
    """``comparison.json``: the estimate beside known true ratios.

    Attributes
    ----------
    truth : ratio by name.
    distance2 : by how much twice the negative log likelihood is higher at the truth; None = not known.
    inside : ``distance2`` is at most ``region_size``.
    """

    FILE: ClassVar[str] = "comparison.json"
    STEP: ClassVar[str] = "assess"
    truth: dict[str, Annotated[float, Field(gt=0.0)]]
    region_size: float | None
    distance2: float | None
    inside: bool | None
