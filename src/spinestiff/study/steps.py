"""The steps, from what earlier ones left to their own results (``runner`` says when each is run)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from spinestiff.anatomy.files import write_torso
from spinestiff.anatomy.regions import AT, expanded, torso_ratios
from spinestiff.curves.pushes import push_responses
from spinestiff.errors import EquilibriumError, NoMinimum
from spinestiff.estimation.evaluation import FitStep
from spinestiff.estimation.fitted import StiffnessFit
from spinestiff.estimation.forecast import Forecast
from spinestiff.estimation.linear import MOST_PROFILED
from spinestiff.files import write_bytes, write_text
from spinestiff.imaging.features import VertebraCorners
from spinestiff.imaging.pedicles import PediclePoints
from spinestiff.imaging.projection import XRayView
from spinestiff.imaging.tracking import support_motion, track
from spinestiff.observer import Observer
from spinestiff.parallel import in_parallel
from spinestiff.personalise.measured_skin import TrunkSize
from spinestiff.personalise.shape import personalise
from spinestiff.study.assessment import assess, single_ratio
from spinestiff.study.draws import DRAWS_FILE, write_draws
from spinestiff.study.fits import fit_from_coarse, fit_pushes
from spinestiff.study.forecasts import fit_end, forecasts
from spinestiff.study.frame_selection import frame_qualities, propose
from spinestiff.study.judgement import failed, judge_inputs
from spinestiff.study.parameters import parameter_study
from spinestiff.study.predictions import (
    Model,
    Predictions,
    of_equilibria,
    predict,
    predictions_of,
    read_solved,
    stored,
    with_fitted_supports,
    write_solved,
)
from spinestiff.study.sensitivity import sensitivity_study
from spinestiff.study.side_views import marked_pedicles, side_views
from spinestiff.study.starting_torso import SCAN_PICTURE, left_of_shape, skin_scan, starting_torso
from spinestiff.study.subject_body import body_notes, subject_template
from spinestiff.study.summary import (
    ASSESSMENT_FILE,
    ESTIMATE_FILE,
    RESPONSE_FILE,
    assessment_csv,
    estimate_csv,
    response_csv,
)
from spinestiff.study.support_notes import strongest_notes, support_notes
from spinestiff.study.trials import PushSet
from spinestiff.study.truth import compare_with_truth, read_truth
from spinestiff.study.visit import START, Manner, Visit, load_pushes, load_start
from spinestiff.study.wording.estimate import no_estimate
from spinestiff.study.wording.steps import response_lines
from spinestiff.study.written import estimate_record, geometry_record, proposal_record, rest_shape
from spinestiff.subject.annotated_points import image_corners, image_pedicles, image_supports, push_corners
from spinestiff.subject.assessment_outcome import Assessment, Comparison
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.folder import read_identities, read_push, read_rest
from spinestiff.subject.geometry_outcome import GeometryRecord
from spinestiff.subject.image_names import rest_image
from spinestiff.subject.marker_table import read_markers
from spinestiff.subject.marks import check_marks
from spinestiff.subject.outcomes import FrameProposals, Tracked, TrackedPush
from spinestiff.subject.run_record import read_outcome, result_path, write_outcome
from spinestiff.words import counted

# Where a fit starts: the geometric means of Table 4. From the default ratios it gets to the same place in more steps.
USUAL_RATIOS = {"lateral_bending": 0.07, "intervertebral_bending": 0.07, "tissue": 0.04}


def track_step(visit: Visit, say: Observer) -> None:
    """Follow the annotated corners through every push; writes ``tracked.json``.

    Raises
    ------
    SubjectError : marks that a step would refuse, those at rest among them, before anything is followed.
    """
    subject, pushes = visit.subject, {}
    check_marks(subject)
    for push in subject.pushes:
        frames = read_push(subject, push)
        view = frames[0].view
        annotated = push_corners(subject, push, view)

        def progress(done: int, total: int, name: str = push.id) -> None:
            say(f"push '{name}': {done} of {counted(total, 'frame')}")

        tracked = track(frames, annotated, progress)
        marked = image_supports(subject, push.image, view)
        if marked:
            say(f"push '{push.id}': pelvis and shoulder")
        supports = support_motion(frames, marked)
        said: dict[str, object] = {"millimetres": dict(frames[0].provenance), "annotated_frames": list(annotated)}
        said |= {"pedicles": marked_pedicles(subject, push, view), "sides": side_views(subject, push)}
        said |= {"markers": read_markers(subject, push, view)}
        pushes[push.id] = TrackedPush.of(view, tracked, supports, **said)
        for i, frame in enumerate(pushes[push.id].frames):
            if frame.support_note:
                say(f"push '{push.id}' frame {i}: {frame.support_note}")
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
        qualities.append(frame_qualities(push, frames[-1], tracked[push.id]))
    proposals = propose(qualities)
    say("drawing")
    rows = [Row(push, frames[i], tracked[push.id], proposals[i]) for i, push in enumerate(subject.pushes)]
    strip = as_png(draw_strip(rows))
    records = [proposal_record(proposal, push) for push, found in zip(subject.pushes, proposals) for proposal in found]
    write_bytes(visit.file("frames.png"), strip)
    write_outcome(subject, FrameProposals(frames=tuple(records)))


def response_step(visit: Visit, say: Observer) -> None:
    """N per degree of each push and flexibility, without a model; writes ``response.json`` and ``response.csv``."""
    responses = push_responses(visit.subject)
    for line in response_lines(responses):
        say(line)
    write_text(visit.file(RESPONSE_FILE), response_csv(responses))
    write_outcome(visit.subject, responses)


def personalise_step(visit: Visit, say: Observer) -> None:
    """Shape the template to the rest radiographs; writes ``torso.npz``, ``personalised.json``, with a skin scan
    ``skin_scan.png`` and, for the fine mesh, a coarse torso for the estimate to start on, ``torso_coarse.npz``."""
    subject = visit.subject
    scan = skin_scan(visit)
    template = starting_torso(visit)
    pictures: dict[str, tuple[VertebraCorners, XRayView]] = {}
    pedicles: dict[str, PediclePoints] = {}
    provenance: dict[str, dict[str, str]] = {}
    for name in subject.rest_views:
        picture = read_rest(subject, name)
        pictures[name] = (image_corners(subject, rest_image(name), picture.view), picture.view)
        marked = PediclePoints(*image_pedicles(subject, rest_image(name), picture.view))
        if marked.vertebrae:
            pedicles[name] = marked
        provenance[name] = dict(picture.provenance)
    fine = partial(subject_template, subject.record, "fine")
    finer = fine if subject.torso_path is None and visit.settings.mesh == "coarse" else None
    trunk: dict[str, TrunkSize] = {
        level: TrunkSize(size.breadth_mm, size.depth_mm) for level, size in subject.record.trunk.items()
    }
    shape = partial(personalise, pictures=pictures, pedicles=pedicles, trunk=trunk, scan=scan)
    bodies = [partial(shape, template, observer=say, finer=finer)]
    if START not in left_of_shape(visit):
        say("shaping a coarse torso, too, which the estimate starts on")
        bodies.append(partial(shape, subject_template(subject.record, "coarse"), finer=fine))
    shaped, *coarse = in_parallel(lambda body: body(), bodies)
    if subject.torso_path is None:
        shaped = replace(shaped, warnings=(*body_notes(subject.record), *shaped.warnings))
    for warning in shaped.warnings:
        say(warning)
    visit.subject.results.mkdir(exist_ok=True)
    write_torso(visit.file("torso.npz"), shaped.torso)
    for one in coarse:
        write_torso(visit.file(START), one.torso)
    if shaped.scan is not None:
        from spinestiff.anatomy.picture import draw_scan

        draw_scan(shaped.torso, shaped.scan.points, visit.file(SCAN_PICTURE))
    write_outcome(subject, geometry_record(shaped, provenance))


def estimate_step(visit: Visit, say: Observer) -> None:
    """Estimate the ratios from the training frames; writes ``estimate.json`` and ``.csv``, draws of the ratios and of
    all that is not quite known (``posterior.csv``), and the equilibria, ``training.npz``.

    Raises
    ------
    NoMinimum : the fit ended without a minimum; nothing is written. It names the likeliest mistakes.
    """
    pushes = load_pushes(visit, visit.manner)
    geometry = read_outcome(visit.subject, GeometryRecord)
    identities = read_identities(visit.subject)
    checks = judge_inputs(visit.subject.record, rest_shape(geometry), pushes, identities)
    wrong = [check.text for check in failed(checks)]
    for text in wrong:
        say(f"doubtful: {text}")
    try:
        fit = fit_training(visit, pushes, say)
    except NoMinimum as error:
        raise NoMinimum(no_estimate(str(error), wrong)) from None
    if not fit.status.usable:
        raise NoMinimum(no_estimate(fit.status.value, wrong))
    record = estimate_record(visit, pushes, fit, geometry)
    training = pushes.training
    write_solved(
        visit.file("training.npz"),
        of_equilibria(training, fit.equilibria, "fit") | of_equilibria(training, fit.default_equilibria, "default"),
    )
    write_draws(visit.file(DRAWS_FILE), fit)
    write_text(visit.file(ESTIMATE_FILE), estimate_csv(record))
    write_outcome(visit.subject, record)


def parameters_step(visit: Visit, say: Observer) -> None:
    """What the paper's six parameters do, and two ratios against three; writes ``parameters.json``."""
    write_outcome(visit.subject, parameter_study(visit, say))


def sensitivity_step(visit: Visit, say: Observer) -> None:
    """Refits with one thing changed at a time; writes ``sensitivity.json``, as it goes, and ``sensitivity.png``."""
    from spinestiff.study.report.figures import as_png
    from spinestiff.study.report.tornado_picture import draw_tornado

    found = sensitivity_study(visit, say)
    write_bytes(visit.file("sensitivity.png"), as_png(draw_tornado(found)))


def assess_step(visit: Visit, say: Observer) -> None:
    """Predict all frames by all models, and say how well the held-out ones are met.

    Writes ``predictions.npz``, ``assessment.json`` and ``.csv`` and, where the truth is given, ``comparison.json``.

    Raises
    ------
    EquilibriumError : the estimate has no equilibrium in a held-out frame.
    """
    subject = visit.subject
    estimate = read_outcome(subject, Estimate)
    pushes = load_pushes(visit, Manner.of(estimate))
    fit = estimated_model(estimate, pushes)
    models = {"default": Model(), "fit": fit}
    say("fitting the one-ratio baseline")
    known = read_solved(result_path(subject, "training.npz", "estimate"))
    starts = [known[t.push, t.frame, "fit"].state for t in pushes.training]
    middle = float(np.exp(np.mean(np.log(list(estimate.values.values())))))
    single = single_ratio(pushes, middle, estimate.method, fit.known, starts)
    if single is not None:
        models["single_ratio"] = single
    if visit.truth is not None:
        models["truth"] = Model(torso_ratios(pushes.torso, read_truth(visit.truth)), fit.known)
    predictions = predict(pushes, models, known, say)
    if estimate.method == "weighed":
        predictions = with_fitted_supports(predictions, fit)
    expected: dict[tuple[str, int], Forecast] = {}
    if estimate.tracking_factor is not None:
        say("what the training frames let expect of those held out")
        try:
            expected = forecasts(predictions, fit_end(estimate))
        except EquilibriumError as error:
            say(f"no forecast: {error}")
    assessment = Assessment(frames=assess(predictions, expected), notes=tuple(_support_notes(visit, predictions)))
    comparison = None
    if visit.truth is not None:
        comparison = compare_with_truth(estimate, pushes, visit.truth, starts)
    write_solved(visit.file("predictions.npz"), stored(predictions))
    write_text(visit.file(ASSESSMENT_FILE), assessment_csv(assessment))
    write_outcome(subject, assessment)
    if comparison is None:
        # One of an earlier estimate would be none of this one.
        visit.file(Comparison.FILE).unlink(missing_ok=True)
    else:
        write_outcome(subject, comparison)


def estimated_model(estimate: Estimate, pushes: PushSet) -> Model:
    """What an estimate found, for the torso of these pushes."""
    ratios = torso_ratios(pushes.torso, estimate.values)
    return Model(ratios, {one.name: one.standard for one in estimate.nuisances})


def stored_predictions(visit: Visit) -> Predictions:
    """What ``assess`` found for every frame under force; nothing is solved.

    Raises
    ------
    SubjectError : an earlier step has not run, or its results are not as it left them.
    """
    estimate = read_outcome(visit.subject, Estimate)
    pushes = load_pushes(visit, Manner.of(estimate))
    known = read_solved(result_path(visit.subject, "predictions.npz", "assess"))
    return predictions_of(pushes, known)


def _support_notes(visit: Visit, predictions: Predictions) -> list[str]:
    frames, pushes = [], predictions.pushes
    for frame in predictions.frames:
        if "fit" not in frame.solved:
            continue
        supports = pushes.problems[frame.item.push].supports
        solved, side = frame.solved["fit"], visit.subject.push(frame.item.push).side
        forces = solved.reactions[len(solved.reactions) - len(supports.names) :]
        found = support_notes(pushes.torso, supports, solved.state, forces, side)
        frames.append((frame.item.push, frame.item.frame, frame.item.trial.load.size, found))
    return strongest_notes(frames)


def report_step(visit: Visit, say: Observer) -> None:
    """Write ``report.html`` and ``view.html``."""
    from spinestiff.study.report.page import write_report

    write_report(visit, stored_predictions(visit), say)


def view_step(visit: Visit, say: Observer) -> None:
    """Write ``view.html``."""
    from spinestiff.study.report.viewer.files import write_view

    write_view(visit, stored_predictions(visit))


def fit_training(visit: Visit, pushes: PushSet, say: Observer) -> StiffnessFit:
    """The fit of the training frames under load, begun on the coarse torso where there is one."""

    def progress(step: FitStep) -> None:
        values = step.ratios.values()
        tried = ", ".join(f"{name} {value:.4g}" for name, value in step.ratios.items())
        if len(values) > MOST_PROFILED:
            tried = f"{len(values)} ratios from {min(values):.4g} to {max(values):.4g}"
        loss = "no equilibrium" if np.isnan(step.rmse_mm) else f"RMSE {step.rmse_mm:.3f} mm"
        beside = "" if step.accepted else " (not a step of the fit)"  # an interval's end, or refused
        say(f"evaluation {step.iteration}{beside}: {tried}: {loss}")

    names = expanded(pushes.torso, visit.parameters)
    method, usual = visit.settings.method, usual_ratios(names)
    coarse = load_start(visit, visit.manner)
    try:
        return fit_from_coarse(coarse, pushes, names, usual, method, progress, say)
    except NoMinimum as error:
        say(f"no fit from there ({error}); starting from the default ratios")
        return fit_pushes(pushes, names, None, method, progress)


def usual_ratios(names: Sequence[str]) -> dict[str, float]:
    """Where a fit of these ratios starts; that of a part beside its whole is relative to it and starts at 1."""
    stems = {name: name.partition(AT)[0] for name in names}
    return {
        name: USUAL_RATIOS[stem]
        for name, stem in stems.items()
        if stem in USUAL_RATIOS and (name == stem or stem not in names)
    }
