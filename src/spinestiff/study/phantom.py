"""A bench phantom estimated as a patient is, and compared with what was measured of its parts (docs/bench-phantom.md).

A joint's bench stiffness k comes from a straight line through its turns under moments, turn = a + M / k. The phantom's
model has these stiffnesses, and the modulus of its rubber, so that a ratio of 1 is the bench value. ``fit_stiffness``
estimates the ratios from the marks in the pictures, with unknowns as large as a bench leaves them. Both intervals are
95 %: the estimate's is ``fit_stiffness``'s own, and ``low`` to ``high`` holds the bench's error as well,

    ln high - ln ratio = sqrt((ln high_fit - ln ratio)^2 + (1.96 sd)^2).
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np

from spinestiff.anatomy.phantom import Column, RubberBlock, phantom_torso
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, ShortRepr
from spinestiff.curves.corner_files import ImageCorners, read_corners
from spinestiff.errors import SpinestiffError, SubjectError
from spinestiff.estimation.fit import fit_stiffness
from spinestiff.estimation.fitted import StiffnessFit
from spinestiff.estimation.known import Known
from spinestiff.estimation.objective import Trial
from spinestiff.estimation.priors import Priors
from spinestiff.estimation.status import FitStatus
from spinestiff.files import no_folder
from spinestiff.imaging.features import VertebraCorners, rmse, silhouette_shares, state_features, target_features
from spinestiff.imaging.projection import XRayView, frontal_view
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import PUSH_DIRECTION, LoadCase, no_load
from spinestiff.mechanics.supports import Supports
from spinestiff.mechanics.terms import PointSprings
from spinestiff.normal import HALF_WIDTH_95
from spinestiff.study.judgement.limits import LIMITS
from spinestiff.study.refits import converged
from spinestiff.study.trials import given_priors
from spinestiff.subject.phantom_record import CORNERS_FILE, PHANTOM_FILE, FrameRecord, JointRecord, PhantomRecord
from spinestiff.subject.record_reading import read_record

PAGE = "docs/bench-phantom.md"
BENCH = Priors(
    force_scale=0.01,
    force_offset_n=0.1,
    direction_deg=1.0,
    push_height_mm=0.5,
    push_depth_mm=2.0,
    breathing_mm=0.0,
    obliquity_deg=0.0,
    shoulder_mm=0.0,
    frame_obliquity_deg=0.0,
    frame_shoulder_mm=0.0,
    place_mm=0.05,
    place_deg=0.02,
    posture_deg=0.0,
    stance_scale=0.005,
    trunk=0.0,
    trunk_taped=0.0,
    rib_joints=0.0,
    tissue_volume=0.5,
    mesh=0.0,
    source_distance=0.005,
    annotation_mm=0.05,
    tracking_shared_mm=0.0,
    level_smoothness=0.0,
)
"""What is not quite known of a phantom on a bench, where nothing breathes, stands anew or gives way."""
F = TypeVar("F")
Verdict = Literal["agrees", "does not agree", "can't be told"]
# Where the fit begins, far from the bench value.
START = 3.0
NAMES = {"lateral_bending": ("joints, mean", "N mm/rad"), "tissue": ("rubber", "MPa")}


@dataclass(frozen=True)
class BenchJoint:
    """Stiffness of the joint below ``block``, N mm/rad, and its relative standard deviation by the line's scatter."""

    block: str
    stiffness: float
    sd: float


@dataclass(frozen=True, kw_only=True)
class BenchComparison:
    """An estimate over the bench value, for ``part`` (the joints' mean, or rubber).

    Attributes
    ----------
    bench, unit : the bench value.
    ratio, fit_low, fit_high : estimate with its 95 % interval, over the bench value.
    bench_sd : relative standard deviation of the bench value.
    low, high : 95 % interval with that as well.
    verdict : whether it holds 1; an interval that has no end within the fit's bounds tells nothing.
    open_low, open_high : the end is the fit's bound; what lies beyond is possible, too.
    """

    part: str
    bench: float
    unit: str
    ratio: float
    fit_low: float
    fit_high: float
    bench_sd: float
    low: float
    high: float
    verdict: Verdict
    open_low: bool
    open_high: bool


@dataclass(frozen=True)
class PredictedFrame:
    """A frame that was not fitted: RMSE of its marks' motion since rest, mm, and of that motion itself."""

    image: str
    force_n: float
    motion_mm: float
    rmse_mm: float


@dataclass(frozen=True, repr=False)
class PhantomResult(ShortRepr):
    """What the analysis found.

    Attributes
    ----------
    comparisons : joints, and rubber where there is some.
    predicted : frames that were held out. noise_mm : RMSE that marking alone would leave there.
    p_value : of residuals as large as the fit's.
    status : of the fit. warnings : of the fit.
    """

    name: str
    joints: tuple[BenchJoint, ...]
    comparisons: tuple[BenchComparison, ...]
    predicted: tuple[PredictedFrame, ...]
    noise_mm: float
    p_value: float
    status: str
    warnings: tuple[str, ...]

    @property
    def sound(self) -> bool:
        """Whether the expected errors explain the residuals; if not, no ratio means anything."""
        return self.p_value >= LIMITS.p_value

    @property
    def agrees(self) -> bool:
        """Whether the residuals are sound and every estimate agrees with its bench value."""
        return self.sound and all(one.verdict == "agrees" for one in self.comparisons)


@dataclass(frozen=True, repr=False)
class Phantom(ShortRepr):
    """A phantom, ready for its frames: the model with bench stiffness, on its base, as the pictures see it."""

    record: PhantomRecord
    joints: tuple[BenchJoint, ...]
    problem: EquilibriumProblem
    view: XRayView

    @property
    def torso(self) -> TorsoModel:
        return self.problem.torso


def read_phantom(folder: str | Path) -> tuple[PhantomRecord, tuple[ImageCorners, ...]]:
    """``phantom.json`` and ``corners.csv`` of a folder.

    Raises
    ------
    SubjectError : a file is missing or wrong, or a frame has no corners.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise SubjectError(f"{folder}: {no_folder(folder)}; wanted one with {PHANTOM_FILE} and {CORNERS_FILE}")
    for name in (PHANTOM_FILE, CORNERS_FILE):
        if not os.path.lexists(folder / name):
            raise SubjectError(f"{folder / name}: no such file; write it as {PAGE} shows")
    record = read_record(folder / PHANTOM_FILE, PhantomRecord, PAGE)
    images = read_corners(folder / CORNERS_FILE)
    known = {image.image: image for image in images}
    for frame in record.frames:
        where = f"{folder / CORNERS_FILE}: {frame.image}"
        if frame.image not in known:
            raise SubjectError(f"{where}: no corners of this frame of {PHANTOM_FILE}; there are {', '.join(known)}")
        strange = [level for level in known[frame.image].levels if level not in record.levels]
        if strange:
            raise SubjectError(f"{where}: {strange[0]} is none of the phantom's levels")
    return record, tuple(known[frame.image] for frame in record.frames)


def bench_joint(joint: JointRecord) -> BenchJoint:
    """The stiffness that a joint's turns under weights give.

    Raises
    ------
    SubjectError : turns that do not grow with the moment.
    """
    moments = np.array(joint.moments_nmm)
    design = np.column_stack([np.ones_like(moments), moments])
    turns = np.deg2rad(joint.turns_deg)
    line, *_ = np.linalg.lstsq(design, turns, rcond=None)
    if not line[1] > 0.0:
        raise SubjectError(
            f"{PHANTOM_FILE}: joint below {joint.block}: turns do not grow with the moment; check the signs"
        )
    left = turns - design @ line
    variance = float(left @ left) / (len(turns) - 2) * np.linalg.inv(design.T @ design)[1, 1]
    return BenchJoint(joint.block, float(1.0 / line[1]), float(np.sqrt(variance) / line[1]))


def build_phantom(record: PhantomRecord) -> Phantom:
    """The phantom's model.

    Raises
    ------
    SpinestiffError : sizes that make no column, or measurements that give no stiffness.
    """
    by_block = {joint.block: bench_joint(joint) for joint in record.joints}
    joints = tuple(by_block[level] for level in record.levels)
    rubber = record.rubber
    column = Column(
        levels=record.levels,
        block_mm=record.block_mm,
        gap_mm=record.gap_mm,
        marks_mm=record.marks_mm,
        marks_front_mm=record.marks_front_mm,
        stiffness=tuple(joint.stiffness for joint in joints),
        rubber=None
        if rubber is None
        else RubberBlock(rubber.width_mm, rubber.depth_mm, rubber.young_mpa, rubber.poisson, rubber.spacing_mm),
    )
    torso = phantom_torso(column)
    held = np.zeros((len(torso.bone_names), 6), dtype=bool)
    held[torso.bone("pelvis")] = True
    none = PointsOnBones(np.empty(0, np.int64), np.empty((0, 3)))
    supports = Supports(held, PointSprings(none, np.empty((0, 3)), np.empty((0, 3)), np.empty(0)), ())
    picture = record.picture
    middle = (0.0, float(column.centres[:, 1].mean()), record.marks_front_mm)
    view = frontal_view(
        picture.source_detector_mm,
        picture.source_marks_mm,
        picture.size_px[::-1],
        picture.pixel_mm,
        middle,
    )
    return Phantom(record, joints, EquilibriumProblem(torso, supports), view)


def push_on(torso: TorsoModel, frame: FrameRecord) -> LoadCase:
    """The gauge's force in a frame."""
    if frame.block is None or frame.side is None:
        return no_load()
    bone = np.array([torso.bone(frame.block)])
    aside = -PUSH_DIRECTION[frame.side] * frame.aside_mm
    points = PointsOnBones(bone, np.array([[aside, frame.height_mm, 0.0]]))
    return LoadCase(points, np.array([[PUSH_DIRECTION[frame.side] * frame.force_n, 0.0, 0.0]]), frame.image)


def analyse(record: PhantomRecord, images: Sequence[ImageCorners]) -> PhantomResult:
    """Estimate the phantom's stiffness from its pictures and compare it with the bench.

    Parameters
    ----------
    images : corners of the record's frames, in their order.

    Raises
    ------
    SpinestiffError : see ``build_phantom`` and ``fit_stiffness``; an error that the priors do not know; a held-out
        frame that shows no block of the picture without a push.
    """
    _refuse_unlike(record, images)
    phantom = build_phantom(record)
    trials = [_trial(phantom, frame, image) for frame, image in zip(record.frames, images)]
    fitted = [trial for frame, trial in zip(record.frames, trials) if frame.use == "fit"]
    names = ("lateral_bending",) if record.rubber is None else ("lateral_bending", "tissue")
    known = {"tracking_mm": record.picture.corner_sd_mm, **record.errors}
    fit = converged(
        fit_stiffness(
            phantom.problem,
            fitted,
            names,
            start=dict.fromkeys(names, START),
            known=Known(given_priors(known, BENCH, f"{PHANTOM_FILE}: errors"), taped=True),
            extent="intervals",
        )
    )
    assert fit.weighed is not None
    mean = float(np.mean([joint.stiffness for joint in phantom.joints]))
    bench = {"lateral_bending": (mean, _joints_sd(record, phantom.joints))}
    if record.rubber is not None:
        bench["tissue"] = (record.rubber.young_mpa, record.rubber.young_sd_mpa / record.rubber.young_mpa)
    return PhantomResult(
        record.name,
        phantom.joints,
        tuple(_comparison(name, fit, *bench[name]) for name in names),
        tuple(_predicted(phantom, fit, record, trials)),
        # Two marks each, at rest and under load; a box is placed by the four of its block.
        float(np.sqrt(2.0) * _rmse_of_marking(record.picture.corner_sd_mm)),
        fit.weighed.p_value,
        fit.status.name,
        fit.warnings,
    )


def _refuse_unlike(record: PhantomRecord, images: Sequence[ImageCorners]) -> None:
    """Raise SubjectError where a held-out frame shows no block whose motion since rest can be told."""
    rest = _rest_of(record, images)
    for frame, image in zip(record.frames, images):
        if frame.use == "predict" and frame.force_n > 0.0 and set(image.levels).isdisjoint(rest.levels):
            raise SubjectError(
                f"{CORNERS_FILE}: {image.image}: shows {', '.join(image.levels)}, and '{rest.image}', the picture "
                f"without a push that its motion is counted from, {', '.join(rest.levels)}; mark a block that both show"
            )


def _rest_of(record: PhantomRecord, of_frames: Sequence[F]) -> F:
    """Of something for each frame, that of the fitted frame without force from which motions are counted."""
    return next(one for frame, one in zip(record.frames, of_frames) if frame.use == "fit" and frame.force_n == 0.0)


def _rmse_of_marking(sd: float) -> float:
    # Of a box placed by four marks with that error along each axis: two shifts and a turn remain of eight numbers.
    return float(np.sqrt(3.0 / 4.0) * sd)


def _joints_sd(record: PhantomRecord, joints: Sequence[BenchJoint]) -> float:
    """Relative standard deviation of the joints' mean stiffness."""
    stiffness, own = np.array([(joint.stiffness, joint.sd) for joint in joints]).T
    return float(np.hypot(np.linalg.norm(stiffness * own) / stiffness.sum(), record.bench_scale_sd))


def _trial(phantom: Phantom, frame: FrameRecord, image: ImageCorners) -> Trial:
    if image.unit == "mm":
        raise SubjectError(f"{CORNERS_FILE}: {image.image}: corners in mm; wanted pixels")
    # As seen from the front: the phantom's left is on the right of the picture.
    quads = image.corners[:, [1, 0, 3, 2]]
    try:
        corners = VertebraCorners(image.levels, phantom.view.from_pixels(quads))
        target_features(phantom.torso, phantom.view, corners)
    except SpinestiffError as problem:
        raise SubjectError(f"{CORNERS_FILE}: {image.image}: {problem}") from None
    # One gauge and one camera for all frames: they share their errors.
    return Trial(push_on(phantom.torso, frame), corners, phantom.view, image.image, push="bench")


def _comparison(name: str, fit: StiffnessFit, bench: float, bench_sd: float) -> BenchComparison:
    ratio = fit.ratios.as_dict()[name]
    fit_low, fit_high = fit.intervals95[name]
    down, up = (float(np.hypot(np.log(end / ratio), HALF_WIDTH_95 * bench_sd)) for end in (fit_low, fit_high))
    low, high = float(ratio * np.exp(-down)), float(ratio * np.exp(up))
    verdict: Verdict = "agrees" if low <= 1.0 <= high else "does not agree"
    opens = fit.open_ends[name]
    if any(opens) or fit.status is not FitStatus.CONVERGED:
        verdict = "can't be told"
    part, unit = NAMES[name]
    return BenchComparison(
        part=part,
        bench=bench,
        unit=unit,
        ratio=ratio,
        fit_low=fit_low,
        fit_high=fit_high,
        bench_sd=bench_sd,
        low=low,
        high=high,
        verdict=verdict,
        open_low=opens[0],
        open_high=opens[1],
    )


def _predicted(
    phantom: Phantom, fit: StiffnessFit, record: PhantomRecord, trials: Sequence[Trial]
) -> list[PredictedFrame]:
    torso, view = phantom.torso, phantom.view
    at_rest = _rest_of(record, trials)
    shares = silhouette_shares(torso, view, torso.rest_pose)
    model_rest = state_features(torso, view, torso.rest_pose, shares).z
    found = []
    for frame, trial in zip(record.frames, trials):
        if frame.use != "predict" or frame.force_n == 0.0:
            continue
        both = tuple(name for name in trial.corners.vertebrae if name in at_rest.corners.vertebrae)
        rows = [torso.vertebrae.index(name) for name in both]
        state = phantom.problem.solve(trial.load, fit.ratios).require().state
        model = (state_features(torso, view, state, shares).z - model_rest)[rows]
        measured = _placed(phantom, trial, both) - _placed(phantom, at_rest, both)
        found.append(
            PredictedFrame(frame.image, frame.force_n, rmse(measured, np.zeros_like(measured)), rmse(model, measured))
        )
    return found


def _placed(phantom: Phantom, trial: Trial, names: tuple[str, ...]) -> Floats:
    return target_features(phantom.torso, phantom.view, trial.corners.selected(names))
