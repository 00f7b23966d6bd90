"""The steps, from what earlier ones left to their own results (``runner`` says when each is run)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from spinestiff.anatomy.axes import body_axes
from spinestiff.anatomy.files import read_torso, write_torso
from spinestiff.anatomy.names import BONES
from spinestiff.anatomy.stiffness import StiffnessRatios, stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.errors import FitError, SubjectError
from spinestiff.estimation.fit import FitStep, StiffnessFit, fit_stiffness
from spinestiff.files import write_bytes
from spinestiff.imaging.features import VertebraCorners
from spinestiff.imaging.projection import XRayView
from spinestiff.imaging.tracking import support_motion, track
from spinestiff.mechanics.loads import three_point_reactions
from spinestiff.observer import Observer
from spinestiff.personalise.fitness import VertebraFit
from spinestiff.personalise.image_terms import PediclePoints
from spinestiff.personalise.measured_skin import TrunkSize
from spinestiff.personalise.pose import ViewPose
from spinestiff.personalise.scan import SkinScan, read_scan
from spinestiff.personalise.scanned_skin import ScanFit
from spinestiff.personalise.shape import Personalised, personalise
from spinestiff.study.assessment import assess, single_ratio
from spinestiff.study.frame_selection import Proposal, frame_qualities, propose
from spinestiff.study.judgement import RestShape, failed, judge
from spinestiff.study.plain import plain_stiffness
from spinestiff.study.predictions import (
    Predictions,
    of_equilibria,
    predict,
    predictions_of,
    read_solved,
    stored,
    write_solved,
)
from spinestiff.study.support_notes import support_notes
from spinestiff.study.trials import PushSet
from spinestiff.study.truth import compare_with_truth, read_truth
from spinestiff.study.visit import Visit, load_pushes
from spinestiff.subject.folder import (
    image_corners,
    image_pedicles,
    image_supports,
    push_corners,
    read_identities,
    read_push,
    read_rest,
)
from spinestiff.subject.outcomes import (
    Assessment,
    Comparison,
    CostRecord,
    Determination,
    Estimate,
    FitStepRecord,
    FrameProposal,
    FrameProposals,
    GeometryRecord,
    MeshRecord,
    PoseRecord,
    RatioEstimate,
    Reactions,
    ScanRecord,
    Tracked,
    TrackedPush,
    TrainingError,
    VertebraFitRecord,
    ViewRecord,
    finite,
    nested,
)
from spinestiff.subject.records import PushRecord, SubjectRecord
from spinestiff.subject.run_record import read_outcome, result_path, write_outcome

# Where a fit starts: the geometric means of Table 4. From the default ratios it gets to the same place in more steps.
USUAL_RATIOS = {"lateral_bending": 0.07, "intervertebral_bending": 0.07, "tissue": 0.04}
LEAST_FIRST: tuple[Determination, ...] = ("not determined", "weakly determined", "determined")
OWN_HEIGHT = 0.1  # share by which an own torso's height may differ from the subject's


def track_step(visit: Visit, say: Observer) -> None:
    """Follow the annotated corners through every push; writes ``tracked.json``."""
    subject, pushes = visit.subject, {}
    for push in subject.pushes:
        frames = read_push(subject, push)
        view = frames[0].view
        annotated = push_corners(subject, push, view)

        def progress(done: int, total: int, name: str = push.id) -> None:
            say(f"push '{name}', frame {done} of {total}")

        tracked = track(frames, annotated, progress)
        motions = support_motion(frames, image_supports(subject, push.image))
        dropped = [next((m.messages()[i] for m in motions if i in m.messages()), "") for i in range(len(frames))]
        for message in filter(None, dropped):
            say(f"push '{push.id}': {message}")
        pushes[push.id] = TrackedPush.of(
            view,
            push.forces_n,
            tracked,
            dropped,
            [
                {m.name: round(float(m.distance[i]), 3) for m in motions if m.quality[i] > 0.0}
                for i in range(len(frames))
            ],
            millimetres=dict(frames[0].provenance),
            annotated_frames=list(annotated),
        )
    write_outcome(subject, Tracked(pushes=pushes))


def frames_step(visit: Visit, say: Observer) -> None:
    """Judge every frame and propose its role; writes ``frames.json`` and ``frames.png``."""
    from spinestiff.study.report.figures import as_png
    from spinestiff.study.report.frame_strip import Row, draw_strip

    subject, tracked = visit.subject, read_outcome(visit.subject, Tracked).pushes
    qualities, frames = [], []
    for push in subject.pushes:
        say(f"looking at push '{push.id}'")
        frames.append(read_push(subject, push))
        points = image_supports(subject, push.image)
        qualities.append(frame_qualities(push, frames[-1], tracked[push.id], points))
    proposals = propose(qualities)
    say("drawing")
    rows = [Row(push, frames[i], tracked[push.id], proposals[i]) for i, push in enumerate(subject.pushes)]
    strip = as_png(draw_strip(rows))
    records = [_proposal_record(proposal, push) for push, found in zip(subject.pushes, proposals) for proposal in found]
    write_bytes(visit.file("frames.png"), strip)
    write_outcome(subject, FrameProposals(frames=tuple(records)))


def _proposal_record(proposal: Proposal, push: PushRecord) -> FrameProposal:
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


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None or not np.isfinite(value) else round(float(value), digits)


def subject_template(record: SubjectRecord, mesh: str) -> TorsoModel:
    """The torso that a subject's radiographs shape: of the subject's own sizes where the mass is known, else the
    reference body scaled to the height.

    Raises
    ------
    TorsoError : the template has no body of this age and mass.
    """
    if record.mass_kg is None:
        return template_torso(record.height_cm, mesh)
    return template_torso(record.height_cm, mesh, age_years=record.age, sex=record.sex, mass_kg=record.mass_kg)


def personalise_step(visit: Visit, say: Observer) -> None:
    """Shape the template to the rest radiographs; writes ``torso.npz``, ``personalised.json`` and, with a skin scan,
    ``skin_scan.png``."""
    subject = visit.subject
    scan = skin_scan(visit)
    template = starting_torso(visit)
    pictures: dict[str, tuple[VertebraCorners, XRayView]] = {}
    pedicles: dict[str, PediclePoints] = {}
    provenance: dict[str, dict[str, str]] = {}
    for name in subject.rest_views:
        picture = read_rest(subject, name)
        pictures[name] = (image_corners(subject, f"rest/{name}", picture.view), picture.view)
        marked = PediclePoints(*image_pedicles(subject, f"rest/{name}", picture.view))
        if marked.vertebrae:
            pedicles[name] = marked
        provenance[name] = dict(picture.provenance)
    from_template = subject.torso_path is None and visit.settings.mesh == "coarse"
    finer = partial(subject_template, subject.record, "fine") if from_template else None
    trunk: dict[str, TrunkSize] = {
        level: TrunkSize(size.breadth_mm, size.depth_mm) for level, size in subject.record.trunk.items()
    }
    shaped = personalise(template, pictures, say, pedicles=pedicles, finer=finer, trunk=trunk, scan=scan)
    for warning in shaped.warnings:
        say(warning)
    visit.subject.results.mkdir(exist_ok=True)
    write_torso(visit.file("torso.npz"), shaped.torso)
    if shaped.scan is not None:
        from spinestiff.study.report.torso_picture import draw_scan

        draw_scan(shaped.torso, shaped.scan.points, visit.file("skin_scan.png"))
    write_outcome(subject, _geometry_record(shaped, provenance))


def skin_scan(visit: Visit) -> SkinScan | None:
    """The subject's skin scan in mm along the body's axes, if there is one.

    Raises
    ------
    SubjectError : it can't be read, or its stated unit or axes contradict the body.
    """
    record, path = visit.subject.record.skin_scan, visit.subject.scan_path
    if record is None or path is None:
        return None
    axes = body_axes(record.axes.left, record.axes.up, record.axes.front)
    return read_scan(path, record.unit, axes, visit.subject.record.height_cm)


def starting_torso(visit: Visit) -> TorsoModel:
    """The torso that is shaped to the radiographs: of the subject's own bones, or the template.

    Raises
    ------
    SubjectError : the own torso isn't of the subject's height or bones.
    """
    record, own = visit.subject.record, visit.subject.torso_path
    if own is None:
        return subject_template(record, visit.settings.mesh)
    torso = read_torso(own)
    if torso.bone_names != BONES:
        raise SubjectError(f"{own}: has {len(torso.bone_names)} bones; wanted the 49 of spinestiff torso import")
    if not abs(torso.height_cm / record.height_cm - 1.0) < OWN_HEIGHT:
        raise SubjectError(
            f"{own}: is of a body of {torso.height_cm:.0f} cm, but subject.json says {record.height_cm:g} cm; "
            "import it with --height, or use the right bones"
        )
    return torso


def estimate_step(visit: Visit, say: Observer) -> None:
    """Estimate the ratios from the training frames; writes ``estimate.json`` and the equilibria, ``training.npz``.

    Raises
    ------
    FitError : the fit ended without a minimum; nothing is written.
    """
    pushes = load_pushes(visit, visit.settings.orientation)  # type: ignore[arg-type]
    fit = fit_training(visit, pushes, say)
    if not fit.status.usable:
        raise FitError(f"no estimate: {fit.status.value}")
    geometry = read_outcome(visit.subject, GeometryRecord)
    record = _estimate_record(visit, pushes, fit, geometry)
    training = pushes.training
    write_solved(
        visit.file("training.npz"),
        of_equilibria(training, fit.equilibria, "fit") | of_equilibria(training, fit.default_equilibria, "default"),
    )
    write_outcome(visit.subject, record)


def assess_step(visit: Visit, say: Observer) -> None:
    """Predict all frames by all models, and say how well the held-out ones are met.

    Writes ``predictions.npz``, ``assessment.json`` and, where the truth is given, ``comparison.json``.

    Raises
    ------
    EquilibriumError : the estimate has no equilibrium in a held-out frame.
    """
    subject = visit.subject
    estimate = read_outcome(subject, Estimate)
    pushes = load_pushes(visit, estimate.orientation)
    models: dict[str, StiffnessRatios | None] = {"default": None, "fit": estimated_ratios(estimate, pushes)}
    say("fitting the one-ratio baseline")
    single = single_ratio(pushes, float(np.exp(np.mean(np.log(list(estimate.values.values()))))))
    if single is not None:
        models["single_ratio"] = single
    if visit.truth is not None:
        models["truth"] = stiffness_ratios(read_truth(visit.truth), pushes.torso.joints.kinds)
    known = read_solved(result_path(subject, "training.npz", "estimate"))
    predictions = predict(pushes, models, known, say)
    assessment = Assessment(frames=assess(predictions), notes=tuple(_support_notes(visit, predictions)))
    comparison = None if visit.truth is None else compare_with_truth(estimate, pushes, visit.truth)
    write_solved(visit.file("predictions.npz"), stored(predictions))
    write_outcome(subject, assessment)
    if comparison is None:
        # One of an earlier estimate would be none of this one.
        visit.file(Comparison.FILE).unlink(missing_ok=True)
    else:
        write_outcome(subject, comparison)


def estimated_ratios(estimate: Estimate, pushes: PushSet) -> StiffnessRatios:
    """The ratios of an estimate, for the torso of these pushes."""
    return stiffness_ratios(estimate.values, pushes.torso.joints.kinds)


def stored_predictions(visit: Visit) -> Predictions:
    """What ``assess`` found for every frame under force; nothing is solved.

    Raises
    ------
    SubjectError : an earlier step has not run, or its results are not as it left them.
    """
    pushes = load_pushes(visit, read_outcome(visit.subject, Estimate).orientation)
    known = read_solved(result_path(visit.subject, "predictions.npz", "assess"))
    return predictions_of(pushes, known)


def _support_notes(visit: Visit, predictions: Predictions) -> list[str]:
    notes, pushes = [], predictions.pushes
    for frame in predictions.frames:
        if "fit" not in frame.solved:
            continue
        supports = pushes.problems[frame.item.push].supports
        solved, side = frame.solved["fit"], visit.subject.push(frame.item.push).side
        forces = solved.reactions[len(solved.reactions) - len(supports.names) :]
        found = support_notes(pushes.torso, supports, solved.state, forces, side)
        notes += [f"{frame.item.trial.label}: {note}" for note in found]
    return notes


def report_step(visit: Visit, say: Observer) -> None:
    """Write ``report.html`` and ``view.html``."""
    from spinestiff.study.report.page import write_report

    write_report(visit, stored_predictions(visit), say)


def view_step(visit: Visit, say: Observer) -> None:
    """Write ``view.html``."""
    from spinestiff.study.report.viewer.files import write_view

    write_view(visit, stored_predictions(visit))


def fit_training(visit: Visit, pushes: PushSet, say: Observer) -> StiffnessFit:
    """The fit of the training frames under load."""
    training = pushes.training

    def progress(step: FitStep) -> None:
        tried = ", ".join(f"{name} {value:.4g}" for name, value in step.ratios.items())
        loss = "no equilibrium" if np.isnan(step.loss) else f"RMSE {step.rmse_mm:.3f} mm, loss {step.loss:.2f} mm2"
        say(f"evaluation {step.iteration}: {tried}: {loss}")

    def fit(start: Mapping[str, float] | None) -> StiffnessFit:
        return fit_stiffness(
            [pushes.problems[t.push] for t in training],
            [t.trial for t in training],
            visit.settings.parameters,
            visit.settings.method,  # type: ignore[arg-type]
            start=start,
            orientation=visit.settings.orientation,  # type: ignore[arg-type]
            observer=progress,
        )

    try:
        return fit({name: value for name, value in USUAL_RATIOS.items() if name in visit.settings.parameters})
    except FitError:
        say("no fit from the usual ratios; starting from the default ones")
        return fit(None)


def _estimate_record(visit: Visit, pushes: PushSet, fit: StiffnessFit, geometry: GeometryRecord) -> Estimate:
    checks = judge(visit.subject.record, rest_shape(geometry), pushes, fit, read_identities(visit.subject))
    ends, opens = fit.intervals95, zip(fit.intervals.open_low, fit.intervals.open_high)
    ratios = {
        name: RatioEstimate.of(value, ends[name], (bool(low), bool(high)), fit.at_bound[name])
        for (name, value), (low, high) in zip(fit.ratios.as_dict().items(), opens)
    }
    spread = [ratio.determined for ratio in ratios.values()]
    return Estimate(
        status="DOUBTFUL" if failed(checks) else fit.status.name,  # type: ignore[arg-type]
        fit_status=fit.status.name,  # type: ignore[arg-type]
        fit_status_text=fit.status.value,
        determined=next(kind for kind in LEAST_FIRST if kind in spread),
        checks=checks,
        parameters=fit.names,
        ratios=ratios,
        plain=plain_stiffness(pushes.torso, fit.ratios, ratios),
        covariance_log=nested(fit.uncertainty.covariance),  # type: ignore[arg-type]
        correlation=finite(float(fit.correlation[0, -1])) if len(fit.names) > 1 else None,
        condition=finite(fit.condition),
        region=None if fit.intervals.region is None else np.exp(fit.intervals.region).tolist(),
        region_size=finite(fit.uncertainty.region_size),
        training_rmse_mm=TrainingError(default=finite(fit.default_rmse_mm), fit=fit.rmse_mm),
        reactions_n=_reactions(visit, pushes, fit),
        history=tuple(
            FitStepRecord(ratios=dict(s.ratios), loss=finite(s.loss), rmse_mm=finite(s.rmse_mm), accepted=s.accepted)
            for s in fit.history
        ),
        method=fit.method,
        orientation=fit.orientation,
        bounds=fit.bounds,
        poses={name: _pose_record(pose) for name, pose in pushes.poses.items()},
        cost=CostRecord(
            equilibria=fit.cost.equilibria,
            newton_iterations=fit.cost.newton_iterations,
            factorisations=fit.cost.factorisations,
            seconds=round(fit.cost.seconds, 3),
        ),
        notes=(*visit.subject.warnings, *geometry.warnings, *pushes.warnings, *fit.warnings),
    )


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
    f1, f2 = three_point_reactions(item.force_n, push.d21_mm, push.d31_mm)
    return Reactions(
        push=item.trial.label,
        f3=item.force_n,
        shoulder=-push.sign * float(equilibrium.reaction("shoulder")[0]),
        pelvis=-push.sign * float(equilibrium.reaction("pelvis")[0]),
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


def _geometry_record(shaped: Personalised, provenance: Mapping[str, Mapping[str, str]]) -> GeometryRecord:
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


def _scan_record(scan: ScanFit) -> ScanRecord:
    return ScanRecord(
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
