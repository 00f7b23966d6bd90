"""One subject of the study: made, taken through the whole chain from its radiographs, and what was found of it."""

from __future__ import annotations

import datetime
import hashlib
import logging
import os
import shutil
import time
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.stiffness import DEFAULT_YOUNG_MPA, stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.curves.tilts import cobb_angle, tilts
from spinestiff.errors import EquilibriumError, FitError, SpinestiffError, SubjectError
from spinestiff.files import read_json, read_text, whole_folder, write_json
from spinestiff.formats import json_text
from spinestiff.imaging.features import rmse, silhouette_shares, state_features, target_features, used_corners
from spinestiff.imaging.projection import frontal_view
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import PUSH_DIRECTION, rib_push
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.observer import Observer
from spinestiff.personalise.placing import place_vertebrae
from spinestiff.study.parameters import default_gradients
from spinestiff.study.predictions import REST, Prediction, Predictions
from spinestiff.study.refits import basis_of
from spinestiff.study.runner import run_steps
from spinestiff.study.sensitivity import FORCE, SIGNS, with_force
from spinestiff.study.seven.geometry_error import GeometryError, steps_with
from spinestiff.study.seven.participants import HELD_OUT, LEAST_FORCE_N, MAIN, MOST_TILT_DEG, TABLES_MESH, Participant
from spinestiff.study.steps import stored_predictions
from spinestiff.study.synthetic.recipe import Recipe
from spinestiff.study.synthetic.spines import curved_spine
from spinestiff.study.synthetic.subject import made_by, synthesise, truth_path
from spinestiff.study.visit import Manner, Settings, Visit, open_visit, pushes_on
from spinestiff.subject.annotated_points import image_corners
from spinestiff.subject.assessment_outcome import Assessment, Comparison, HeldOutFrame
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.folder import read_rest
from spinestiff.subject.image_names import FRONTAL
from spinestiff.subject.program import program_of_numbers
from spinestiff.subject.records import SUBJECT_FILE
from spinestiff.subject.run_record import read_outcome, recorded_steps
from spinestiff.subject.study_outcome import FrameOutcome, SubjectOutcome

STEPS = ("track", "personalise", "estimate", "assess")
_log = logging.getLogger(__name__)


def result_file(folder: Path, participant: Participant) -> Path:
    """Where a subject's outcome lies."""
    return folder / f"{participant.name}.json"


def failure_file(folder: Path, participant: Participant) -> Path:
    """Where it lies why the last run found no outcome of a subject."""
    return folder / f"{participant.name}.failed.json"


def note_failure(folder: Path, participant: Participant, settings: Settings, reason: str | None) -> None:
    """Keep why a subject has no outcome, for the page; None takes it away. What can't be written is not kept."""
    path = failure_file(folder, participant)
    try:
        if reason is None:
            path.unlink(missing_ok=True)
        else:
            write_json(path, {"reason": reason, "settings": settings_digest(participant, settings)})
    except (OSError, SpinestiffError) as error:
        _log.warning("%s: can't be written (%s)", path, error)


def stored_failure(folder: Path, participant: Participant, settings: Settings) -> str | None:
    """Why the last run found no outcome with these settings, or None: it found one, or has not come to this subject."""
    path = failure_file(folder, participant)
    if not path.is_file():
        return None
    try:
        found = read_json(path)
    except SpinestiffError:
        return None
    if not isinstance(found, dict) or found.get("settings") != settings_digest(participant, settings):
        return None
    return str(found.get("reason"))


def usable_folder(folder: Path) -> None:
    """Raise SubjectError for the folder of a study that is a file, or a subject folder."""
    if folder.exists() and not folder.is_dir():
        raise SubjectError(f"{folder}: is there already and no folder; choose another one, nothing was written")
    if (folder / SUBJECT_FILE).exists():
        raise SubjectError(f"{folder}: is a subject folder; a study has subject folders inside, choose another one")


def stored_outcome(folder: Path, participant: Participant, settings: Settings) -> SubjectOutcome | None:
    """What an earlier run by whichever program found of this subject with these settings, or None.

    The outcome alone is read, not the subject's folder; it names its program and day, which a page has to tell.
    """
    path = result_file(folder, participant)
    if not path.is_file():
        return None
    try:
        found = SubjectOutcome.model_validate_json(read_text(path), strict=True)
    except (SpinestiffError, ValueError):
        return None
    return found if found.settings == settings_digest(participant, settings) else None


def known_outcome(folder: Path, participant: Participant, settings: Settings) -> SubjectOutcome | None:
    """``stored_outcome`` where this program (``subject.program_of_numbers``) would find the same, so that a run need
    not find it again; else None."""
    found = stored_outcome(folder, participant, settings)
    return found if found is not None and found.program == program_of_numbers() else None


def settings_digest(participant: Participant, settings: Settings) -> str:
    """Of all that a subject's outcome follows from, but the program."""
    asked = {"mesh": settings.mesh, "participant": asdict(participant), "recipe": participant.recipe().as_record()}
    return hashlib.sha256(json_text(asked).encode()).hexdigest()


def study_subject(
    folder: Path, participant: Participant, settings: Settings, say: Observer, limited: bool = False
) -> SubjectOutcome:
    """Make the subject if it is not there, run the steps that are not up to date, and write what was found.

    Parameters
    ----------
    folder : of the study. limited : the largest force is one that turns no two vertebrae by more than 45 degrees.

    Raises
    ------
    SpinestiffError : it can't be made, tracked or estimated.
    """
    own, seconds = folder / participant.name, dict[str, float]()
    began = time.process_time()
    recipe = participant.recipe(bearable_force(participant) if limited else None)
    if _make(own, recipe, say):
        seconds["make"] = time.process_time() - began
    visit = open_visit(own, settings, truth_path(own))
    # A later geometry has another error: the seed is the subject's, in a stream of its own.
    error = GeometryError(participant.initial_rmse_mm, participant.seed + 10_000)
    run_steps(visit, STEPS, say, known=steps_with(error))
    seconds |= {name: recorded_steps(visit.subject)[name].cpu_seconds for name in STEPS}
    began = time.process_time()
    found = _outcome(visit, participant, recipe, settings, seconds, say)
    seconds["tables"] = time.process_time() - began
    found = found.model_copy(update={"cpu_seconds": {name: round(value, 1) for name, value in seconds.items()}})
    write_json(result_file(folder, participant), found.model_dump(mode="json"))
    return found


def bearable_force(participant: Participant) -> float:
    """The participant's largest force, or less where it would turn two vertebrae by more than 45 degrees, N.

    Raises
    ------
    EquilibriumError : even a small push does.
    """
    recipe = participant.recipe()
    template = template_torso(participant.height_cm, "coarse", age_years=participant.age, sex=participant.sex)
    curve = curved_spine(template, participant.cobb_deg, participant.curve, participant.secondary)
    torso = place_vertebrae(template, *curve)
    side = recipe.side
    assert side is not None
    problem = EquilibriumProblem(torso, three_point_supports(torso, side, "level"))
    ratios = stiffness_ratios({"lateral_bending": participant.bending, "tissue": participant.tissue})
    view = frontal_view()
    shares = silhouette_shares(torso, view, torso.rest_pose)
    before = tilts(VERTEBRAE, state_features(torso, view, torso.rest_pose, shares).corners, view)
    force = recipe.force_n
    while True:
        bent = 2.0 * MOST_TILT_DEG
        try:
            state = torso.rest_pose
            for share in (0.5, 1.0):
                load = rib_push(torso, side, recipe.pushes[0].level, share * force)
                state = problem.solve(load, ratios, state).require().state
            after = tilts(VERTEBRAE, state_features(torso, view, state, shares).corners, view)
            bent = float(np.degrees(np.ptp(after.superior - before.superior)))
        except EquilibriumError:
            pass
        if bent <= MOST_TILT_DEG:
            return round(force, 1)
        force *= float(np.clip(MOST_TILT_DEG / bent, 0.5, 0.9))
        if force < LEAST_FORCE_N:
            raise EquilibriumError(
                f"{participant.name}: {LEAST_FORCE_N:g} N bend it by more than {MOST_TILT_DEG:g} degrees"
            )


def _make(folder: Path, recipe: Recipe, say: Observer) -> bool:
    """The subject's folder and its truth, False where they are there; what a stopped run has left is taken away."""
    if folder.is_dir() and not truth_path(folder).exists():
        raise SubjectError(f"{folder}: is no subject of a study; choose another folder, nothing was written")
    if made_by(folder, recipe):
        return False
    for left in folder.parent.glob(f".{folder.name}.*.tmp*"):
        shutil.rmtree(left, ignore_errors=True) if left.is_dir() else left.unlink(missing_ok=True)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with whole_folder(folder, SubjectError) as draft:
        truth = synthesise(draft, recipe, lambda line: say(f"make: {line}"))
        # Before the folder, which is there only whole.
        os.replace(truth, truth_path(folder))
    return True


def _outcome(
    visit: Visit,
    participant: Participant,
    recipe: Recipe,
    settings: Settings,
    seconds: Mapping[str, float],
    say: Observer,
) -> SubjectOutcome:
    estimate, assessment = read_outcome(visit.subject, Estimate), read_outcome(visit.subject, Assessment)
    predictions, truth = stored_predictions(visit), read_json(truth_path(visit.subject.folder))
    pushes = predictions.pushes
    reference = pushes.reference(MAIN).trial
    rest = state_features(pushes.torso, reference.view, pushes.torso.rest_pose, orientation=pushes.orientation).z
    measured = target_features(pushes.torso, reference.view, reference.corners, pushes.orientation)
    rows = [pushes.torso.vertebrae.index(name) for name in reference.corners.vertebrae]
    largest = int(np.argmax(recipe.pushes[0].shares))
    say("tables: gradient of the paper's objective")
    coarse = replace(visit, settings=replace(settings, mesh=TABLES_MESH))
    tissue = estimate.plain["tissue_young"]
    changes, missing = force_changes(coarse, say)
    return SubjectOutcome(
        program=program_of_numbers(),
        date=datetime.datetime.now(datetime.UTC).date().isoformat(),
        settings=settings_digest(participant, settings),
        mesh=settings.mesh,
        name=participant.name,
        age=participant.age,
        sex=participant.sex,
        height_cm=participant.height_cm,
        curve=participant.curve,
        force_n=round(recipe.force_n * PUSH_DIRECTION[recipe.side or "left"], 1),
        cobb_deg=round(truth["rest_cobb_deg"], 2),
        change_deg=truth["pushes"][MAIN][largest]["cobb_change_deg"]["signed"],
        truth=truth["ratios"],
        ratios=estimate.ratios,
        inside=read_outcome(visit.subject, Comparison).inside,
        tissue_kpa=(1000.0 * DEFAULT_YOUNG_MPA * truth["ratios"]["tissue"], tissue.value, tissue.low, tissue.high),
        status=estimate.status,
        failed=tuple(check.name for check in estimate.failed),
        initial_mm=round(rmse(rest[rows], measured), 4),
        rest_cobb_deg=_rest_cobb(visit),
        training_mm={"default": estimate.training_rmse_mm.default, "fit": estimate.training_rmse_mm.fit},
        gradient=default_gradients(basis_of(coarse).pushes("paper")),
        force_percent=changes,
        missing=missing,
        frames=tuple(_frame(predictions, frame, recipe) for frame in assessment.frames),
        cpu_seconds=dict(seconds),
    )


def _rest_cobb(visit: Visit) -> tuple[float, float]:
    """The signed Cobb angle of the frontal rest radiograph, and that of the torso at rest in it, degrees."""
    torso = visit.torso()
    picture = read_rest(visit.subject, "frontal")
    corners = image_corners(visit.subject, FRONTAL, picture.view)
    rows = [torso.vertebrae.index(name) for name in corners.vertebrae]
    model = state_features(torso, picture.view, torso.rest_pose).corners[rows]
    seen, made = (tilts(corners.vertebrae, found, picture.view) for found in (corners.corners, model))
    return round(cobb_angle(seen).degrees, 2), round(cobb_angle(made).degrees, 2)


def force_changes(visit: Visit, say: Observer) -> tuple[dict[str, float], tuple[str, ...]]:
    """Ratio -> mean change, in percent, of the weighed estimate for 10 % of force (Table 7), on the visit's mesh.

    A sign of which no refit is found does not count, with a line that tells why; without the refit that the others
    are compared with there are no changes.
    """
    basis = basis_of(visit)

    def refit(force: float, start: Mapping[str, float] | None) -> dict[str, float]:
        pushes = pushes_on(with_force(visit, force), basis.torso, Manner.of(basis.estimate))
        return basis.refit(pushes, start).ratios.as_dict()

    there: dict[str, float] | None = None
    changes: dict[str, list[float]] = {}
    missing: list[str] = []
    for sign in (0, *SIGNS):
        what = "the forces as they are" if sign == 0 else f"{sign * 100 * FORCE:+.0f} % of force"
        say(f"tables: refit with {what}")
        try:
            found = refit(1.0 + sign * FORCE, there)
        except FitError as error:
            missing.append(f"Table 7: no refit with {what} ({error})")
            if there is None:
                break
            continue
        there = there or found
        if sign:
            for name, value in found.items():
                changes.setdefault(name, []).append(100.0 * abs(value / there[name] - 1.0))
    return {name: round(float(np.mean(values)), 2) for name, values in changes.items()}, tuple(missing)


def _frame(predictions: Predictions, held_out: HeldOutFrame, recipe: Recipe) -> FrameOutcome:
    found = next(p for p in predictions.frames if (p.item.push, p.item.frame) == (held_out.push, held_out.frame))
    forecast = held_out.forecast
    motions = {
        name: motion_rmse(predictions, found, name) for name in found.solved if name not in (REST, "fitted_supports")
    }
    extrapolation = held_out.rmse_mm["extrapolation"]
    if extrapolation is not None:
        motions["extrapolation"] = extrapolation
    return FrameOutcome(
        push=held_out.push,
        told_n=held_out.force_n,
        true_n=round(HELD_OUT * recipe.force_n, 3),
        rmse_mm=held_out.rmse_mm,
        motion_mm={name: round(value, 4) for name, value in motions.items()},
        cobb_deg=held_out.cobb_change_deg,
        inside95=None if forecast is None else forecast.inside95,
    )


def motion_rmse(predictions: Predictions, found: Prediction, name: str) -> float:
    """Corner RMSE of a model's motion since the push's least force, against what was measured, mm.

    Where the torso's geometry is off, places are, too; how far everything moves shows the stiffness alone.
    """
    pushes, item = predictions.pushes, found.item
    torso, reference = pushes.torso, pushes.reference(item.push).trial
    before = target_features(torso, reference.view, reference.corners, pushes.orientation)
    common = [v for v in item.trial.corners.vertebrae if v in reference.corners.vertebrae]
    now = [item.trial.corners.vertebrae.index(v) for v in common]
    then = [reference.corners.vertebrae.index(v) for v in common]
    start = predictions.before(item, name)
    assert start is not None
    used = used_corners(torso, reference.corners)
    at_rest = state_features(torso, item.trial.view, start, found.target.shares, pushes.orientation, used)
    model = found.boxes(torso, name) - at_rest.z[found.target.rows]
    return rmse(model[now], found.target.z[now] - before[then])
