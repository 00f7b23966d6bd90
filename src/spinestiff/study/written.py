"""What the steps found as the results that are written: geometry, estimate and proposals of frames as records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from spinestiff.anatomy.torso import TorsoModel
from spinestiff.estimation.discrepancy_data import mesh_size
from spinestiff.estimation.fitted import StiffnessFit
from spinestiff.estimation.profiles import region_rise
from spinestiff.estimation.unknowns import ACTS, PLACING, UNITS
from spinestiff.mechanics.loads import three_point_reactions
from spinestiff.mechanics.push import support_forces
from spinestiff.personalise.fitness import VertebraFit
from spinestiff.personalise.pose import ViewPose
from spinestiff.personalise.scanned_skin import ScanFit
from spinestiff.personalise.shape import Personalised
from spinestiff.study.frame_selection import Proposal
from spinestiff.study.judgement import failed, judge, outlying_notes
from spinestiff.study.judgement.rest_shape import RestShape
from spinestiff.study.plain import plain_stiffness
from spinestiff.study.trials import PushSet, seen_beside
from spinestiff.study.visit import Visit
from spinestiff.subject.estimate_outcome import (
    OF_FRAME,
    BudgetRecord,
    CombinationRecord,
    CostRecord,
    Estimate,
    FitStepRecord,
    NuisanceRecord,
    PriorChangeRecord,
    ProfileRecord,
    RatioEstimate,
    Reactions,
    SupportPlaceRecord,
    TrainingError,
)
from spinestiff.subject.folder import read_identities
from spinestiff.subject.geometry_outcome import GeometryRecord, MeshRecord, ScanFitRecord, VertebraFitRecord
from spinestiff.subject.outcome_parts import LEAST_FIRST, PoseRecord, ViewRecord, finite, nested
from spinestiff.subject.outcomes import FrameProposal
from spinestiff.subject.records import PushRecord

PAPER_NOTE = (
    "the paper's estimator, equal weights with the pelvis level: it has no intervals; spinestiff estimate --method "
    "weighed has"
)


def proposal_record(proposal: Proposal, push: PushRecord) -> FrameProposal:
    """A frame as it was judged, with its role in ``subject.json`` and the proposed one."""
    quality = proposal.quality
    return FrameProposal(
        push=quality.push,
        side=push.side,
        level=push.level,
        frame=quality.frame,
        force_n=quality.force_n,
        sharpness=_rounded(quality.image.sharpness, 3),
        contrast_to_noise=_rounded(quality.image.contrast_to_noise, 2),
        saturated=_rounded(quality.image.saturated, 4),
        vertebrae=quality.vertebrae,
        tracking_mm=_rounded(quality.tracking_mm, 2),
        supports={
            name: {"mm": _rounded(motion.mm, 2), "degrees": _rounded(motion.degrees, 2)}
            for name, motion in quality.supports.items()
        },
        role=push.roles[quality.frame],
        proposed=proposal.role,
        reason=proposal.reason,
    )


def _profiles(fit: StiffnessFit) -> dict[str, ProfileRecord]:
    """Of each ratio, in as many places as it was followed through."""
    if fit.likely is None or not fit.profiled:
        return {}
    return {
        name: ProfileRecord(ratio=np.exp(one.log_ratios).round(8).tolist(), rise=one.rise.round(6).tolist())
        for name, one in zip(fit.names, fit.likely.profiles)
    }


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None or not np.isfinite(value) else round(float(value), digits)


def estimate_record(visit: Visit, pushes: PushSet, fit: StiffnessFit, geometry: GeometryRecord) -> Estimate:
    """The estimate, judged: what the fit found, in plain units too, with every check and note."""
    checks = judge(visit.subject.record, rest_shape(geometry), pushes, fit, read_identities(visit.subject))
    kinds = dict.fromkeys(fit.names) if fit.likely is None else dict(zip(fit.names, fit.likely.kinds))
    data_sd = {} if fit.weighed is None or not fit.weighed.held else dict(zip(fit.names, fit.weighed.data_sd.tolist()))
    ratios = {
        name: RatioEstimate.of(
            value, fit.intervals95[name], fit.open_ends[name], fit.at_bound[name], kinds[name], data_sd.get(name)
        )
        for name, value in fit.ratios.as_dict().items()
    }
    region = None if fit.likely is None else fit.likely.region
    spread = [ratio.determined for ratio in ratios.values()]
    return Estimate(
        status="DOUBTFUL" if failed(checks) else fit.status.name,  # type: ignore[arg-type]
        fit_status=fit.status.name,  # type: ignore[arg-type]
        fit_status_text=fit.status.value,
        determined=next(kind for kind in LEAST_FIRST if kind in spread),
        checks=checks,
        parameters=fit.names,
        ratios=ratios,
        intervals="none" if fit.likely is None else "profile" if fit.profiled else "linear",
        profiles=_profiles(fit),
        interval_rise=0.5 * region_rise(1) if fit.likely is not None and fit.profiled else None,
        population=visit.population,
        held={} if fit.weighed is None else dict(fit.weighed.held),
        data_sd_log=data_sd,
        plain=plain_stiffness(pushes.torso, fit.ratios, ratios, fit.covariance),
        covariance_log=nested(fit.covariance),  # type: ignore[arg-type]
        correlation=finite(float(fit.correlation[0, -1])) if len(fit.names) > 1 else None,
        region=None if region is None else np.exp(region).tolist(),
        region_size=None if region is None else region_rise(len(fit.names)),
        **_weighed(pushes, fit),  # type: ignore[arg-type]
        training_rmse_mm=TrainingError(default=finite(fit.default_rmse_mm), fit=fit.rmse_mm),
        reactions_n=_reactions(visit, pushes, fit),
        history=tuple(
            FitStepRecord(ratios=dict(s.ratios), loss=finite(s.loss), rmse_mm=finite(s.rmse_mm), accepted=s.accepted)
            for s in fit.history
        ),
        method=fit.method,
        mesh=mesh_size(pushes.torso),
        orientation=fit.orientation,
        bounds=fit.bounds,
        poses={name: _pose_record(pose) for name, pose in pushes.poses.items()},
        cost=CostRecord(
            equilibria=fit.cost.equilibria,
            newton_iterations=fit.cost.newton_iterations,
            factorisations=fit.cost.factorisations,
            seconds=round(fit.cost.seconds, 3),
        ),
        notes=(
            *visit.subject.warnings,
            *mesh_notes(pushes.torso, fit.method, visit.subject.torso_path is not None),
            *geometry.warnings,
            *pushes.warnings,
            *fit.warnings,
            *outlying_notes(fit),
            *((PAPER_NOTE,) if fit.method == "paper" else seen_beside(pushes)),
        ),
    )


def mesh_notes(torso: TorsoModel, method: str, own: bool = False) -> tuple[str, ...]:
    """What a coarse tissue mesh means for the ratios, a line; none on a fine one.

    Parameters
    ----------
    method : of the estimate. own : whether the torso is of the subject's own bones, which have but one mesh.
    """
    if mesh_size(torso) == "fine":
        return ()
    text = (
        f"a quick look: the tissue's mesh is coarse ({len(torso.tissue.rest_positions)} nodes). Such a mesh resists "
        "like tissue that is about 6 % stiffer than on the fine one, so the ratio of tissue comes out lower by about "
        "as much, and bending, which trades against it, is off, too"
    )
    if method != "paper":
        text += "; the intervals allow for what meshes of this size differ by"
    finer = "import the bones with a smaller --spacing" if own else "run again without --mesh coarse"
    return (f"{text}. For ratios to report {finer}",)


def _weighed(pushes: PushSet, fit: StiffnessFit) -> dict[str, object]:
    """What only the weighed fit tells, as the record's fields."""
    found = fit.weighed
    if found is None:
        return {}

    def by_name(values: Sequence[float]) -> dict[str, float]:
        return dict(zip(fit.names, values))

    nuisances = [
        NuisanceRecord(
            name=one.name,
            group=one.group,
            unit=UNITS[ACTS.index(one.act)],
            value=one.value,
            sd=one.sd,
            prior_sd=one.prior_sd,
            standard=one.standard,
        )
        for one in found.nuisances
    ]
    obliquity, shoulder = (found.acts[:, ACTS.index(name)] for name in PLACING)
    budget = found.budget
    return {
        "nuisances": tuple(nuisances),
        "supports": tuple(
            SupportPlaceRecord(push=t.push, frame=t.frame, obliquity_deg=float(np.degrees(turn)), shoulder_mm=float(mm))
            for t, turn, mm in zip(pushes.training, obliquity, shoulder)
        ),
        "visit_sd_log": by_name(found.visit_sd.tolist()),
        "annotation_sd_log": by_name(found.annotation_sd.tolist()),
        "sd_log": {} if budget is None else by_name(budget.together),
        "sd_log_tracking": {} if budget is None else by_name(budget.tracking),
        "budget": ()
        if budget is None
        else tuple(
            BudgetRecord(name=row.name, alone=by_name(row.alone), without=by_name(row.without)) for row in budget.rows
        ),
        "prior_changes": tuple(
            PriorChangeRecord(name=c.name, factor=c.factor, ratios=by_name(c.ratios), sd_log=by_name(c.sd))
            for c in found.changes
        ),
        "best_known": None
        if found.best_known is None
        else CombinationRecord(
            exponents=by_name(found.best_known.exponents),
            value=found.best_known.value,
            sd_log=found.best_known.sd_log,
        ),
        "p_value": finite(found.p_value),
        "tracking_factor": found.tracking_factor,
        "outlying": {f"{vertebra}{OF_FRAME}{label}": size for label, vertebra, size in found.outlying},
    }


def rest_shape(geometry: GeometryRecord) -> RestShape:
    """What is judged of the geometry found."""
    fits: dict[str, dict[str, VertebraFit]] = {
        view: {str(name): VertebraFit(**fit.model_dump()) for name, fit in found.items()}
        for view, found in geometry.fits.items()
    }
    sizes = np.array(list(geometry.size_scale.values()))
    return RestShape(geometry.corner_sd_mm, geometry.length_scale, sizes, fits)


def _reactions(visit: Visit, pushes: PushSet, fit: StiffnessFit) -> Reactions:
    training = pushes.training
    last = int(np.argmax([t.force_n for t in training]))
    item, equilibrium = training[last], fit.equilibria[last]
    push = visit.subject.push(item.push)
    f1 = f2 = None
    if push.d21_mm is not None and push.d31_mm is not None:
        f1, f2 = three_point_reactions(item.force_n, push.d21_mm, push.d31_mm)
    found = support_forces(pushes.torso, item.trial.load, equilibrium)
    return Reactions(
        push=item.trial.label,
        f3=item.force_n,
        shoulder=-push.sign * found.shoulder,
        pelvis=-push.sign * found.pelvis,
        pelvis_moment_nm=push.sign * found.pelvis_moment / 1000.0,
        wall_pull=found.wall_pull,
        eq2_shoulder=f1,
        eq1_pelvis=f2,
    )


def _pose_record(pose: ViewPose) -> PoseRecord:
    return PoseRecord(
        shift_mm=tuple(pose.shift.tolist()),
        roll_deg=float(np.degrees(pose.roll)),
        yaw_deg=float(np.degrees(pose.yaw)),
        rms_mm=pose.rms_mm,
    )


def geometry_record(shaped: Personalised, provenance: Mapping[str, Mapping[str, str]]) -> GeometryRecord:
    """The geometry as it was found; ``provenance`` says for each view where its millimetres come from."""
    covariance = shaped.covariance
    return GeometryRecord(
        rmse_mm=dict(shaped.rmse_mm),
        poses={name: _pose_record(pose) for name, pose in shaped.poses.items()},
        views={name: ViewRecord.of(view) for name, view in shaped.views.items()},
        millimetres={name: dict(found) for name, found in provenance.items()},
        fits={
            view: {
                name: VertebraFitRecord(
                    rmse_mm=fit.rmse_mm,
                    centre_mm=fit.centre_mm,
                    angle_deg=fit.angle_deg,
                    wrong_corners=fit.wrong_corners,
                )
                for name, fit in fits.items()
            }
            for view, fits in shaped.fits.items()
        },  # type: ignore[arg-type]
        prior_only=shaped.prior_only,
        carried={name: tuple(motions) for name, motions in shaped.carried.items()},
        length_scale=shaped.length_scale,
        size_scale={name: tuple(row) for name, row in zip(shaped.torso.vertebrae, shaped.size_scale.tolist())},
        corner_sd_mm=shaped.corner_sd_mm,
        covariance=covariance.reshape(-1, 6, covariance.shape[1]).tolist(),  # type: ignore[arg-type]
        mesh=MeshRecord(
            path=shaped.mesh,
            nodes=len(shaped.torso.tissue.rest_positions),
            smallest_j=shaped.quality.smallest_j,
            smallest_dihedral_deg=shaped.quality.smallest_dihedral_deg,
        ),
        skin_scan=None if shaped.scan is None else _scan_record(shaped.scan),
        warnings=shaped.warnings,
    )


def _scan_record(scan: ScanFit) -> ScanFitRecord:
    return ScanFitRecord(
        covered=scan.covered,
        used=scan.used,
        before_mm=scan.before_mm,
        after_mm=scan.after_mm,
        left_to_template=scan.left,
        held_mm=scan.held_mm,
        yaw_deg=scan.yaw_deg,
        tilt_deg=scan.tilt_deg,
        turned_round=scan.turned_round,
    )
