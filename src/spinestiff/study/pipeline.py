"""The steps from a subject folder to its results; each reads files, writes files and is redone only when needed.

``track`` -> ``personalise`` -> ``estimate`` -> ``assess`` -> ``report``. Results go to ``results/`` in the folder.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from spinestiff.anatomy.files import read_torso, write_torso
from spinestiff.anatomy.stiffness import NMM_PER_NM, StiffnessRatios, stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.errors import FitError, SubjectError
from spinestiff.estimation.fit import FitStep, StiffnessFit, fit_stiffness
from spinestiff.estimation.uncertainty import joint_region_outline
from spinestiff.imaging.features import VertebraCorners
from spinestiff.imaging.projection import XRayView
from spinestiff.imaging.tracking import support_motion, track
from spinestiff.mechanics.equilibrium import Equilibrium
from spinestiff.mechanics.loads import three_point_reactions
from spinestiff.personalise.shape import Personalised, personalise
from spinestiff.study.assessment import FrameAssessment, assess
from spinestiff.study.metrics import SpineTilts, cobb_angle, cobb_change, tilts
from spinestiff.study.results import (
    StepRecord,
    file_digest,
    inputs_digest,
    is_current,
    read_json,
    record_step,
    step_digest,
    write_json,
)
from spinestiff.study.subject import Subject, image_corners, image_supports, read_push, read_rest, read_subject
from spinestiff.study.trials import PushSet, TrackedFrame, TrackedPush, push_set, usable_corners

Observer = Callable[[str], None]
SCHEMA_VERSION = 1
STEPS = ("track", "personalise", "estimate", "assess", "report")
# A reaction that pulls on its support by more than this, N, says that the person would have left it.
PULLING_LIMIT_N = 2.0
OBLIQUITY_LIMIT_DEG = 3.0


@dataclass(frozen=True)
class Settings:
    """What the steps are asked.

    Attributes
    ----------
    mesh : of the estimator, "coarse" or "fine".
    method : "lm" or "lbfgsb". orientation : "procrustes" or "covariance".
    parameters : ratios to estimate.
    """

    mesh: str = "coarse"
    method: str = "lm"
    orientation: str = "procrustes"
    parameters: tuple[str, ...] = ("lateral_bending", "tissue")


@dataclass(frozen=True)
class Visit:
    """A subject with what the earlier steps found, as later steps need it."""

    subject: Subject
    settings: Settings
    truth: Path | None = None

    def file(self, name: str) -> Path:
        return self.subject.results / name


def open_visit(folder: str | Path, settings: Settings | None = None, truth: Path | None = None) -> Visit:
    """Read and check a subject folder for the steps below. Raises SubjectError."""
    return Visit(read_subject(folder), settings or Settings(), truth)


def run_steps(visit: Visit, steps: tuple[str, ...] = STEPS, observer: Observer | None = None, force: bool = False) -> list[str]:
    """Run the steps in order, leaving out those that are current; returns the names of those that ran.

    Raises
    ------
    SpinestiffError : the first step that fails; what was written before stays.
    """
    say = observer or (lambda line: None)
    ran = []
    for step in STEPS:
        if step not in steps:
            continue
        inputs, outputs, settings = _recipe(visit, step)
        for path in inputs:
            if not path.exists():
                raise SubjectError(f"{path}: no such file; run the step that makes it first ({_maker(path)})")
        hashes = inputs_digest(visit.subject.folder, inputs)
        digest = step_digest(hashes, settings)
        if not force and is_current(visit.subject.folder, step, digest):
            say(f"{step}: up to date")
            continue
        began = time.perf_counter()
        _FUNCTIONS[step](visit, lambda line, step=step: say(f"{step}: {line}"))  # type: ignore[misc]
        made = {path.relative_to(visit.subject.folder).as_posix(): file_digest(path) for path in outputs}
        seconds = round(time.perf_counter() - began, 3)
        record_step(visit.subject.folder, step, StepRecord(digest, hashes, settings, seconds, made))
        ran.append(step)
    return ran


def _recipe(visit: Visit, step: str) -> tuple[list[Path], list[Path], dict[str, Any]]:
    """Input files, output files and settings of a step."""
    file, settings, subject = visit.file, visit.settings, visit.subject
    images = [*subject.inputs]
    chosen: dict[str, dict[str, Any]] = {
        "track": {},
        "personalise": {"mesh": settings.mesh},
        "estimate": {
            "method": settings.method,
            "orientation": settings.orientation,
            "parameters": list(settings.parameters),
        },
        "assess": {"truth": None if visit.truth is None else file_digest(visit.truth)},
        "report": {},
    }
    shape = [file("torso.npz"), file("personalised.json")]
    needed = {
        "track": (images, [file("tracked.json")]),
        "personalise": (images, shape),
        "estimate": ([*images[:2], file("tracked.json"), *shape], [file("estimate.json")]),
        "assess": ([*images[:2], file("tracked.json"), *shape, file("estimate.json")], [file("assessment.json")]),
        "report": (
            [*images, file("tracked.json"), *shape, file("estimate.json"), file("assessment.json")],
            [file("report.html")],
        ),
    }
    inputs, outputs = needed[step]
    return inputs, outputs, chosen[step]


def _maker(path: Path) -> str:
    makers = {
        "tracked.json": "track",
        "torso.npz": "personalise",
        "personalised.json": "personalise",
        "estimate.json": "estimate",
        "assessment.json": "assess",
    }
    return f"spinestiff {makers[path.name]}" if path.name in makers else "see docs/subject-folder.md"


def track_step(visit: Visit, say: Observer) -> None:
    """Follow the annotated corners through every push; writes ``tracked.json``."""
    subject, pushes = visit.subject, {}
    for push in subject.pushes:
        frames = read_push(subject, push)
        view = frames[0].view
        first = image_corners(subject, push.image, view)

        def progress(done: int, total: int, name: str = push.id) -> None:
            say(f"push '{name}', frame {done} of {total}")

        tracked = track(frames, first, progress)
        motions = support_motion(frames, image_supports(subject, push.image))
        dropped = [
            next((m.messages()[i] for m in motions if i in m.messages()), "") for i in range(len(frames))
        ]
        for message in filter(None, dropped):
            say(f"push '{push.id}': {message}")
        pushes[push.id] = {
            "view": _view_record(view),
            "millimetres": dict(frames[0].provenance),
            "vertebrae": list(first.vertebrae),
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


def personalise_step(visit: Visit, say: Observer) -> None:
    """Shape the template to the rest radiographs; writes ``torso.npz`` and ``personalised.json``."""
    subject = visit.subject
    template = template_torso(subject.record.height_cm, visit.settings.mesh)
    pictures, provenance = {}, {}
    for name in ("frontal", "lateral"):
        picture = read_rest(subject, name)  # type: ignore[arg-type]
        pictures[name] = (image_corners(subject, f"rest/{name}", picture.view), picture.view)
        provenance[name] = dict(picture.provenance)
    shaped = personalise(template, pictures, say)
    visit.subject.results.mkdir(exist_ok=True)
    write_torso(visit.file("torso.npz"), shaped.torso)
    write_json(visit.file("personalised.json"), _personalised_record(shaped, provenance))


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
    write_json(visit.file("estimate.json"), _estimate_record(visit, pushes, fit))


def assess_step(visit: Visit, say: Observer) -> None:
    """Predict the held-out frames; writes ``assessment.json``."""
    frames, _ = assess_visit(visit, say)
    records: list[dict[str, Any]] = [frame.as_record() for frame in frames]
    write_json(visit.file("assessment.json"), records)


def assess_visit(visit: Visit, say: Observer) -> tuple[tuple[FrameAssessment, ...], PushSet]:
    """The held-out frames' predictions, and the trials they belong to."""
    torso = read_torso(visit.file("torso.npz"))
    pushes = load_pushes(visit, torso)
    truth = read_truth(visit.truth) if visit.truth else None
    return assess(pushes, estimated_ratios(visit, torso), truth, say), pushes


def report_step(visit: Visit, say: Observer) -> None:
    """Write ``report.html``."""
    from spinestiff.study.report import write_report

    write_report(visit, say)


_FUNCTIONS: Mapping[str, Callable[[Visit, Observer], None]] = {
    "track": track_step,
    "personalise": personalise_step,
    "estimate": estimate_step,
    "assess": assess_step,
    "report": report_step,
}


def fit_training(visit: Visit, pushes: PushSet, say: Observer) -> StiffnessFit:
    """The fit of the training frames under load."""
    training = [t for t in pushes.of_role("training") if t.force_n > 0.0]

    def progress(step: FitStep) -> None:
        tried = ", ".join(f"{name} {value:.4g}" for name, value in step.ratios.items())
        loss = "no equilibrium" if np.isnan(step.loss) else f"RMSE {step.rmse_mm:.3f} mm, loss {step.loss:.2f} mm2"
        say(f"evaluation {step.iteration}: {tried}: {loss}")

    return fit_stiffness(
        [pushes.problems[t.push] for t in training],
        [t.trial for t in training],
        visit.settings.parameters,
        visit.settings.method,  # type: ignore[arg-type]
        orientation=visit.settings.orientation,  # type: ignore[arg-type]
        observer=progress,
    )


def load_pushes(visit: Visit, torso: TorsoModel) -> PushSet:
    """Trials from ``tracked.json`` on a torso."""
    return push_set(torso, visit.subject.pushes, load_tracked(visit))


def load_tracked(visit: Visit) -> dict[str, TrackedPush]:
    """``tracked.json`` by push. Raises SubjectError if the file belongs to another subject."""
    record = read_json(visit.file("tracked.json"))
    tracked = {}
    for push in visit.subject.pushes:
        try:
            entry = record["pushes"][push.id]
            view = XRayView(**{**entry["view"], "shape": tuple(entry["view"]["shape"])})
            names = tuple(entry["vertebrae"])
            frames = tuple(
                TrackedFrame(
                    VertebraCorners(names, view.from_pixels(np.array(f["corners_px"])), np.array(f["quality"])),
                    f["dropped"],
                )
                for f in entry["frames"]
            )
        except (KeyError, TypeError, ValueError) as error:
            raise SubjectError(
                f"{visit.file('tracked.json')}: does not fit push '{push.id}' ({error}); run spinestiff track again"
            ) from None
        tracked[push.id] = TrackedPush(view, frames)
    return tracked


def estimated_ratios(visit: Visit, torso: TorsoModel) -> StiffnessRatios:
    """The ratios of ``estimate.json``."""
    record = read_json(visit.file("estimate.json"))
    return stiffness_ratios({name: entry["value"] for name, entry in record["ratios"].items()}, torso.joints.kinds)


def read_truth(path: Path) -> dict[str, float]:
    """True ratios of a synthetic subject's truth file. Raises SubjectError."""
    record = read_json(path)
    try:
        return {str(name): float(value) for name, value in record["ratios"].items()}
    except (KeyError, TypeError, AttributeError, ValueError):
        raise SubjectError(f"{path}: holds no true ratios; wanted the truth file of a synthetic subject") from None


def plain_stiffness(torso: TorsoModel, ratios: StiffnessRatios) -> dict[str, float]:
    """The ratios in plain units: N m/rad of lateral bending a level (thoracic, lumbar) and kPa of Young's modulus."""
    joints = ratios.scale_joints(torso.joints.stiffness)
    kinds = np.array(torso.joints.kinds)
    mu, lam = torso.tissue.lame_mu[0] * ratios.tissue[0], torso.tissue.lame_lambda[0] * ratios.tissue[1]
    return {
        "lateral_bending_thoracic_nm_per_rad": float(joints[kinds == "thoracic", 5].mean() / NMM_PER_NM),
        "lateral_bending_lumbar_nm_per_rad": float(joints[kinds == "lumbar", 5].mean() / NMM_PER_NM),
        "tissue_young_kpa": float(1e3 * mu * (3.0 * lam + 2.0 * mu) / (lam + mu)),
    }


def support_warnings(equilibrium: Equilibrium, torso: TorsoModel, side: str) -> list[str]:
    """What the reactions and the pelvis say against the supports as modelled."""
    found = []
    push = 1.0 if side == "right" else -1.0
    # The shoulder's wall pushes back against the force; a support can't pull.
    shoulder = -push * float(equilibrium.reaction("shoulder")[0])
    if shoulder < -PULLING_LIMIT_N:
        found.append(f"the shoulder's support pulls with {-shoulder:.1f} N")
    pulling = [r for r in equilibrium.reactions if r.name.startswith("wall") and r.force[2] < -PULLING_LIMIT_N]
    if pulling:
        worst = min(pulling, key=lambda r: r.force[2])
        found.append(
            f"the back wall pulls at {len(pulling)} points (most at {worst.name.removeprefix('wall_')}, "
            f"{-worst.force[2]:.1f} N): the back would have left the wall there"
        )
    pelvis = torso.bone("pelvis")
    turn = equilibrium.state.bone_rotations[pelvis] @ torso.rest_pose.bone_rotations[pelvis].T
    obliquity = float(np.degrees(np.arctan2(turn[1, 0], turn[0, 0])))
    if abs(obliquity) > OBLIQUITY_LIMIT_DEG:
        found.append(f"the pelvis tilts by {obliquity:+.1f} degrees (limit {OBLIQUITY_LIMIT_DEG:g})")
    return found


def _estimate_record(visit: Visit, pushes: PushSet, fit: StiffnessFit) -> dict[str, Any]:
    training = [t for t in pushes.of_role("training") if t.force_n > 0.0]
    last = int(np.argmax([t.force_n for t in training]))
    item, equilibrium = training[last], fit.equilibria[last]
    push = visit.subject.push(item.push)
    f1, f2 = three_point_reactions(item.force_n, push.d21_mm, push.d31_mm)
    warnings = [*visit.subject.warnings, *pushes.warnings, *fit.warnings]
    for trial, solved in zip(training, fit.equilibria):
        side = visit.subject.push(trial.push).side
        warnings += [f"{trial.trial.label}: {w}" for w in support_warnings(solved, pushes.torso, side)]
    intervals = fit.intervals95
    outline = joint_region_outline(fit) if len(fit.names) == 2 and np.isfinite(fit.uncertainty.covariance).all() else None
    return {
        "schema_version": SCHEMA_VERSION,
        "status": fit.status.name,
        "status_text": fit.status.value,
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
            "shoulder": abs(float(equilibrium.reaction("shoulder")[0])),
            "pelvis": abs(float(equilibrium.reaction("pelvis")[0])),
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


def cobb_rows(visit: Visit) -> list[tuple[str, str, str, str, str]]:
    """Image, Cobb angle with its levels, and the three forms of its change from the push's least force.

    Frames of pushes appear once they are tracked.
    """
    subject = visit.subject
    rest = read_rest(subject, "frontal")
    corners = image_corners(subject, "rest/frontal", rest.view)
    rows = [("rest/frontal", str(cobb_angle(tilts(corners.vertebrae, corners.corners, rest.view))), "", "", "")]
    if not visit.file("tracked.json").exists():
        return rows
    for push, found in load_tracked(visit).items():
        forces = subject.push(push).forces_n
        before = _usable_tilts(found, int(np.argmin(forces)))
        for index, force in enumerate(forces):
            after = _usable_tilts(found, index)
            change = cobb_change(before, after)
            forms = [f"{value:+.1f}" for value in (change.signed, change.fixed_levels, change.tilt)]
            rows.append((f"{push} frame {index}, {force:.0f} N", str(cobb_angle(after)), forms[0], forms[1], forms[2]))
    return rows


def _usable_tilts(push: TrackedPush, index: int) -> SpineTilts:
    corners = usable_corners(push.frames[index].corners)
    return tilts(corners.vertebrae, corners.corners, push.view)


def truth_in_region(visit: Visit) -> bool | None:
    """Whether the 95 % joint region of ``estimate.json`` holds the true ratios; None without truth or region."""
    record = read_json(visit.file("estimate.json"))
    covariance, size = record["covariance_log"], record["joint_region_size"]
    if visit.truth is None or size is None or any(v is None for row in covariance for v in row):
        return None
    truth = read_truth(visit.truth)
    offset = np.array([np.log(truth[name] / entry["value"]) for name, entry in record["ratios"].items()])
    order = list(record["ratios"])
    matrix = np.array(covariance)
    if record["parameters"] != order:
        which = [record["parameters"].index(name) for name in order]
        matrix = matrix[np.ix_(which, which)]
    return bool(offset @ np.linalg.solve(matrix, offset) <= size)


def _personalised_record(shaped: Personalised, provenance: Mapping[str, Mapping[str, str]]) -> dict[str, Any]:
    return {
        "schema_version": SCHEMA_VERSION,
        "rmse_mm": dict(shaped.rmse_mm),
        "vertebra_rmse_mm": {name: dict(values) for name, values in shaped.vertebra_rmse_mm.items()},
        "prior_only": list(shaped.prior_only),
        "poses": {
            name: {"shift_mm": pose.shift, "roll_deg": np.degrees(pose.roll)} for name, pose in shaped.poses.items()
        },
        "views": {name: _view_record(view) for name, view in shaped.views.items()},
        "millimetres": {name: dict(found) for name, found in provenance.items()},
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

