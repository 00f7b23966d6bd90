"""The steps from a subject folder to its results; each reads files, writes files and is redone only when needed.

``track`` -> ``personalise`` -> ``estimate`` -> ``assess`` -> ``report``. Results go to ``results/`` in the folder.
``view``, the 3D page alone, needs only the estimate; the report brings it along.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from spinestiff.anatomy.axes import body_axes
from spinestiff.anatomy.files import read_torso, write_torso
from spinestiff.anatomy.names import BONES
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.errors import FitError, SubjectError
from spinestiff.estimation.fit import FitStep, StiffnessFit, fit_stiffness
from spinestiff.estimation.uncertainty import joint_region_outline
from spinestiff.files import file_digest, inputs_digest, read_json, write_json
from spinestiff.imaging.features import VertebraCorners
from spinestiff.imaging.projection import XRayView
from spinestiff.imaging.tracking import support_motion, track
from spinestiff.mechanics.loads import three_point_reactions
from spinestiff.personalise.fitness import VertebraFit
from spinestiff.personalise.image_terms import PediclePoints
from spinestiff.personalise.scan import SkinScan, read_scan
from spinestiff.personalise.scanned_skin import ScanFit
from spinestiff.personalise.shape import Personalised, personalise
from spinestiff.personalise.skin import TrunkSize
from spinestiff.study.judgement import RestShape, failed, judge
from spinestiff.study.trials import PushSet
from spinestiff.study.visit import (
    Observer,
    Visit,
    assess_visit,
    compare_with_truth,
    load_pushes,
    plain_stiffness,
    support_warnings,
)
from spinestiff.subject.folder import (
    image_corners,
    image_pedicles,
    image_supports,
    push_corners,
    read_identities,
    read_push,
    read_rest,
)
from spinestiff.subject.outcomes import Check
from spinestiff.subject.records import SUBJECT_FILE, SubjectRecord
from spinestiff.subject.run_record import StepRecord, changed_inputs, is_current, record_step, step_digest

SCHEMA_VERSION = 1
# Where a fit starts: the geometric means of Table 4. From the default ratios it gets to the same place in more steps.
USUAL_RATIOS = {"lateral_bending": 0.07, "intervertebral_bending": 0.07, "tissue": 0.04}
OWN_HEIGHT = 0.1  # share by which an own torso's height may differ from the subject's
# Stands for how the fit ended where a check failed: no number is to be read before what the checks say.
DOUBTFUL = "DOUBTFUL"
STEPS = ("track", "personalise", "estimate", "assess", "report")
ALL_STEPS = (*STEPS, "view")


def run_steps(
    visit: Visit, steps: tuple[str, ...] = STEPS, observer: Observer | None = None, force: bool = False
) -> list[str]:
    """Run the steps in order, leaving out those that are current; returns the names of those that ran.

    Raises
    ------
    SpinestiffError : the first step that fails; what was written before stays.
    """
    say = observer or (lambda line: None)
    if "estimate" in steps and not any(push.frames_of("training") for push in visit.subject.pushes):
        path = visit.subject.folder / SUBJECT_FILE
        raise SubjectError(f"{path}: no frame has the role training; spinestiff frames proposes roles")
    ran = []
    for step in ALL_STEPS:
        if step not in steps:
            continue
        inputs, outputs, _ = _recipe(visit, step)
        for path in inputs:
            if not path.exists():
                raise SubjectError(f"{path}: no such file; run the step that makes it first ({_maker(path)})")
            _refuse_stale(visit.subject.folder, path)
        record = _before(visit, step)
        if not force and is_current(visit.subject.folder, step, record.digest):
            say(f"{step}: up to date")
            continue
        # The report writes the view on its way.
        along = _before(visit, "view") if step == "report" else None
        began = time.perf_counter()
        _FUNCTIONS[step](visit, lambda line, step=step: say(f"{step}: {line}"))  # type: ignore[misc]
        seconds = round(time.perf_counter() - began, 3)
        _record(visit, step, replace(record, seconds=seconds), outputs)
        if along is not None:
            _record(visit, "view", along, _recipe(visit, "view")[1])
        ran.append(step)
    return ran


def _before(visit: Visit, step: str) -> StepRecord:
    """The record of a step that is about to run."""
    inputs, _, settings = _recipe(visit, step)
    hashes = inputs_digest(visit.subject.folder, inputs)
    return StepRecord(step_digest(hashes, settings), hashes, settings)


def _record(visit: Visit, step: str, record: StepRecord, outputs: list[Path]) -> None:
    made = {path.relative_to(visit.subject.folder).as_posix(): file_digest(path) for path in outputs}
    record_step(visit.subject.folder, step, replace(record, outputs=made))


def _recipe(visit: Visit, step: str) -> tuple[list[Path], list[Path], dict[str, Any]]:
    """Input files, output files and settings of a step."""
    file, settings, subject = visit.file, visit.settings, visit.subject
    images = [*subject.inputs]
    truth = None if visit.truth is None else file_digest(visit.truth)
    chosen: dict[str, dict[str, Any]] = {
        "track": {},
        "personalise": {"mesh": settings.mesh},
        "estimate": {
            "method": settings.method,
            "orientation": settings.orientation,
            "parameters": list(settings.parameters),
        },
        "assess": {"truth": truth},
        "report": {"truth": truth},
        "view": {},
    }
    shape = [file("torso.npz"), file("personalised.json")]
    shaped = [*shape, *([file("skin_scan.png")] if subject.scan_path else [])]
    assessed = [file("assessment.json"), *([file("comparison.json")] if visit.truth else [])]
    needed = {
        "track": (images, [file("tracked.json")]),
        "personalise": (images, shaped),
        "estimate": ([*images[:2], file("tracked.json"), *shape], [file("estimate.json")]),
        "assess": ([*images[:2], file("tracked.json"), *shape, file("estimate.json")], assessed),
        "report": (
            [*images, file("tracked.json"), *shape, file("estimate.json"), file("assessment.json")],
            [file("report.html"), file("view.html")],
        ),
        "view": ([*images[:2], file("tracked.json"), *shape, file("estimate.json")], [file("view.html")]),
    }
    inputs, outputs = needed[step]
    return inputs, outputs, chosen[step]


MAKERS = {
    "tracked.json": "track",
    "torso.npz": "personalise",
    "personalised.json": "personalise",
    "estimate.json": "estimate",
    "assessment.json": "assess",
}


def _maker(path: Path) -> str:
    return f"spinestiff {MAKERS[path.name]}" if path.name in MAKERS else "see docs/subject-folder.md"


def _refuse_stale(folder: Path, path: Path) -> None:
    """Raise SubjectError if what made a result has changed since."""
    changed = changed_inputs(folder, MAKERS[path.name]) if path.name in MAKERS else ()
    if changed:
        raise SubjectError(f"{path}: was made before {changed[0]} changed; run {_maker(path)} again, or spinestiff run")


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
        pushes[push.id] = {
            "view": _view_record(view),
            "millimetres": dict(frames[0].provenance),
            "vertebrae": list(tracked[0].vertebrae),
            "annotated_frames": list(annotated),
            "frames": [
                {
                    "force_n": force,
                    "corners_px": view.pixels(corners.corners).round(3),
                    "quality": corners.quality.round(3),
                    "dropped": message,
                    "support_motion_mm": {
                        m.name: round(float(m.distance[i]), 3) for m in motions if m.quality[i] > 0.0
                    },
                }
                for i, (force, corners, message) in enumerate(zip(push.forces_n, tracked, dropped))
            ],
        }
    write_json(visit.file("tracked.json"), {"schema_version": SCHEMA_VERSION, "pushes": pushes})


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
    write_json(visit.file("personalised.json"), _personalised_record(shaped, provenance))


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
    """Estimate the ratios from the training frames; writes ``estimate.json``.

    Raises
    ------
    FitError : the fit ended without a minimum; nothing is written.
    """
    torso = read_torso(visit.file("torso.npz"))
    pushes = load_pushes(visit, torso)
    fit = fit_training(visit, pushes, say)
    if not fit.status.usable:
        raise FitError(f"no estimate: {fit.status.value}")
    checks = judge(visit.subject.record, _rest_shape(visit), pushes, fit, read_identities(visit.subject))
    for check in failed(checks):
        say(f"doubtful: {check.name}: {check.text}")
    write_json(visit.file("estimate.json"), _estimate_record(visit, pushes, fit, checks))


def assess_step(visit: Visit, say: Observer) -> None:
    """Predict the held-out frames; writes ``assessment.json`` and, where the truth is given, ``comparison.json``."""
    frames, pushes = assess_visit(visit, say)
    records: list[dict[str, Any]] = [frame.as_record() for frame in frames]
    comparison = compare_with_truth(visit, pushes)
    write_json(visit.file("assessment.json"), records)
    if comparison is not None:
        write_json(visit.file("comparison.json"), comparison)


def report_step(visit: Visit, say: Observer) -> None:
    """Write ``report.html`` and ``view.html``."""
    from spinestiff.study.report.page import write_report

    write_report(visit, say)


def view_step(visit: Visit, say: Observer) -> None:
    """Write ``view.html``."""
    from spinestiff.study.report.viewer.files import write_view

    write_view(visit, say)


_FUNCTIONS: Mapping[str, Callable[[Visit, Observer], None]] = {
    "track": track_step,
    "personalise": personalise_step,
    "estimate": estimate_step,
    "assess": assess_step,
    "report": report_step,
    "view": view_step,
}


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


def _rest_shape(visit: Visit) -> RestShape:
    record = read_json(visit.file("personalised.json"))
    fits = {view: {v: VertebraFit(**fit) for v, fit in seen.items()} for view, seen in record["vertebra_fit"].items()}
    sizes = np.array(list(record["size_scale"].values()))
    return RestShape(record["corner_sd_mm"], record["length_scale"], sizes, fits)


def _estimate_record(visit: Visit, pushes: PushSet, fit: StiffnessFit, checks: tuple[Check, ...]) -> dict[str, Any]:
    training = pushes.training
    last = int(np.argmax([t.force_n for t in training]))
    item, equilibrium = training[last], fit.equilibria[last]
    push = visit.subject.push(item.push)
    f1, f2 = three_point_reactions(item.force_n, push.d21_mm, push.d31_mm)
    shape_warnings = read_json(visit.file("personalised.json")).get("warnings", [])
    warnings = [*visit.subject.warnings, *shape_warnings, *pushes.warnings, *fit.warnings]
    for trial, solved in zip(training, fit.equilibria):
        side = visit.subject.push(trial.push).side
        warnings += [f"{trial.trial.label}: {w}" for w in support_warnings(solved, pushes.torso, side)]
    intervals = fit.intervals95
    outline = (
        joint_region_outline(fit) if len(fit.names) == 2 and np.isfinite(fit.uncertainty.covariance).all() else None
    )
    return {
        "schema_version": SCHEMA_VERSION,
        "status": DOUBTFUL if failed(checks) else fit.status.name,
        "status_text": "; ".join(f"{check.name}: {check.text}" for check in failed(checks)) or fit.status.value,
        "checks": [check.model_dump() for check in checks],
        "ratios": {
            name: {
                "value": value,
                "interval95": [_finite(v) for v in intervals[name]],
                "at_bound": fit.at_bound[name],
            }
            for name, value in fit.ratios.as_dict().items()
        },
        "plain": plain_stiffness(pushes.torso, fit.ratios),
        "covariance_log": [[_finite(v) for v in row] for row in fit.uncertainty.covariance.tolist()],
        "correlation": _finite(float(fit.correlation[0, -1])) if len(fit.names) > 1 else None,
        "condition": _finite(fit.condition),
        "joint_region": outline,
        "joint_region_size": _finite(fit.uncertainty.region_size),
        "training_rmse_mm": {"default": _finite(fit.default_rmse_mm), "fit": fit.rmse_mm},
        "reactions_n": {
            "push": item.trial.label,
            "f3": item.force_n,
            # Above 0 against the push; below 0 a support would have to pull.
            "shoulder": -push.sign * float(equilibrium.reaction("shoulder")[0]),
            "pelvis": -push.sign * float(equilibrium.reaction("pelvis")[0]),
            "eq2_shoulder": f1,
            "eq1_pelvis": f2,
        },
        "history": [
            {"ratios": dict(s.ratios), "loss": _finite(s.loss), "rmse_mm": _finite(s.rmse_mm), "accepted": s.accepted}
            for s in fit.history
        ],
        "parameters": list(fit.names),
        "method": fit.method,
        "orientation": fit.orientation,
        "bounds": list(fit.bounds),
        "poses": {
            name: {"shift_mm": pose.shift, "roll_deg": np.degrees(pose.roll), "rms_mm": pose.rms_mm}
            for name, pose in pushes.poses.items()
        },
        "cost": {
            "equilibria": fit.cost.equilibria,
            "newton_iterations": fit.cost.newton_iterations,
            "factorisations": fit.cost.factorisations,
            "seconds": round(fit.cost.seconds, 3),
        },
        "warnings": warnings,
    }


def _personalised_record(shaped: Personalised, provenance: Mapping[str, Mapping[str, str]]) -> dict[str, Any]:
    return {
        "schema_version": SCHEMA_VERSION,
        "rmse_mm": dict(shaped.rmse_mm),
        "vertebra_rmse_mm": {name: dict(values) for name, values in shaped.vertebra_rmse_mm.items()},
        "vertebra_fit": {
            name: {
                vertebra: {
                    "rmse_mm": fit.rmse_mm,
                    "centre_mm": fit.centre_mm,
                    "angle_deg": fit.angle_deg,
                    "wrong_corners": fit.wrong_corners,
                }
                for vertebra, fit in fits.items()
            }
            for name, fits in shaped.fits.items()
        },
        "prior_only": list(shaped.prior_only),
        "carried": {name: list(motions) for name, motions in shaped.carried.items()},
        "poses": {
            name: {"shift_mm": pose.shift, "roll_deg": np.degrees(pose.roll), "yaw_deg": np.degrees(pose.yaw)}
            for name, pose in shaped.poses.items()
        },
        "length_scale": shaped.length_scale,
        "size_scale": dict(zip(shaped.torso.vertebrae, shaped.size_scale.tolist())),
        "corner_sd_mm": shaped.corner_sd_mm,
        "covariance": {
            "order": ["x_mm", "y_mm", "z_mm", "x_rad", "y_rad", "z_rad"],
            "vertebrae": list(shaped.torso.vertebrae),
            "blocks": [shaped.covariance[i : i + 6, i : i + 6].tolist() for i in range(0, len(shaped.covariance), 6)],
        },
        "mesh": {
            "path": shaped.mesh,
            "nodes": len(shaped.torso.tissue.rest_positions),
            "smallest_j": shaped.quality.smallest_j,
            "smallest_dihedral_deg": shaped.quality.smallest_dihedral_deg,
        },
        "skin_scan": None if shaped.scan is None else _scan_record(shaped.scan),
        "warnings": list(shaped.warnings),
        "views": {name: _view_record(view) for name, view in shaped.views.items()},
        "millimetres": {name: dict(found) for name, found in provenance.items()},
    }


def _scan_record(scan: ScanFit) -> dict[str, Any]:
    return {
        "covered": scan.covered,
        "used": scan.used,
        "before_mm": dict(zip(("median", "p95"), scan.before_mm)),
        "after_mm": dict(zip(("median", "p95"), scan.after_mm)),
        "left_to_template": list(scan.left),
        "held_mm": scan.held_mm,
        "yaw_deg": scan.yaw_deg,
        "tilt_deg": scan.tilt_deg,
        "turned_round": scan.turned_round,
    }


def _view_record(view: XRayView) -> dict[str, Any]:
    return {
        "source": view.source,
        "detector_origin": view.detector_origin,
        "detector_axes": view.detector_axes,
        "pixel_spacing": view.pixel_spacing,
        "shape": list(view.shape),
        "source_to_patient": view.source_to_patient,
    }


def _finite(value: float) -> float | None:
    # JSON has no infinity: an interval without an end is written as null.
    return float(value) if np.isfinite(value) else None
