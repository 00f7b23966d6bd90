"""A subject at a glance: what is missing, what comes next, what was found."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from spinestiff.curves.changes import change_words
from spinestiff.errors import SpinestiffError
from spinestiff.normal import HALF_WIDTH_95
from spinestiff.study.wording.estimate import badge, headline, told_stiffness
from spinestiff.study.wording.numbers import estimated, interval
from spinestiff.study.wording.titles import stiffness_title
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.folder import Subject, annotatable, annotatable_views, read_annotation, read_unannotated
from spinestiff.subject.gaps import Gap
from spinestiff.subject.image_names import LATERAL, described
from spinestiff.subject.outcomes import Responses
from spinestiff.subject.records import ANNOTATION_FILE, REST_IMAGES, SUBJECT_FILE
from spinestiff.subject.run_record import changed_lately, read_outcome, recorded_steps
from spinestiff.words import push_named, sentence
from spinestiff.workbench.job_table import Job
from spinestiff.workbench.page_words import page_words

STAGES = {
    "broken": "Can't be read",
    "form": "Values are missing",
    "radiographs": "Radiographs are missing",
    "annotate": "To be annotated",
    "roles": "No frames to estimate from",
    "run": "Ready to run",
    "done": "Has a result",
}
"""Where a subject stands."""
SHOWN_STEPS = ("estimate", "report")
"""Steps whose results people look at; their inputs are everything that a person gives."""
NO_PUSH = "There is no push: there can be a plan, and no estimate"
NO_TRAINING = "No frame is used for training: choose some in the values, or have the step Judge the frames propose them"


def card(key: str, folder: Path, job: Job | None) -> dict[str, Any]:
    """A subject as JSON; whatever is wrong with it is told in the card, not raised."""
    about: dict[str, Any] = {"key": key, "name": folder.name, "job": None if job is None else job.record()}
    try:
        return about | _told(read_unannotated(folder))
    except (SpinestiffError, OSError) as error:
        return {**about, "stage": "broken", "stage_words": STAGES["broken"], "missing": [_one_line(error, folder)]}


def _told(subject: Subject) -> dict[str, Any]:
    record, unknown = subject.record, {gap.key for gap in subject.gaps if gap.push is None}
    stage, missing = _stage(subject)
    found = result(subject)
    changed = [] if found is None else stale(subject, changed_lately)
    if stage == "run" and found is not None and "problem" not in found and not changed:
        stage = "done"
    return {
        "id": record.id,
        "age": None if "age" in unknown else record.age,
        "sex": None if "sex" in unknown else record.sex,
        "height_cm": None if "height_cm" in unknown else record.height_cm,
        "pushes": len(record.pushes),
        "stage": stage,
        "stage_words": STAGES[stage],
        "missing": missing,
        "result": found,
        "stale": changed,
    }


def stale(subject: Subject, changed: Callable[[Subject, str], tuple[str, ...]]) -> list[str]:
    """What has changed since estimate and report were made, in words; also where the subject has gaps by now.

    Parameters
    ----------
    subject : as ``read_unannotated`` gives it.
    changed : ``run_record.changed_inputs``, or ``changed_lately`` where old radiographs are not to be read again.
    """
    # Where it can't be read it has changed: nothing is estimated without one.
    with suppress(SpinestiffError):
        subject = replace(subject, annotation=read_annotation(subject.folder / ANNOTATION_FILE))
    names = {name for step in SHOWN_STEPS for name in changed(subject, step)}
    report = recorded_steps(subject).get("report")
    if report is not None and os.path.lexists(subject.image_path(LATERAL)):
        names |= {REST_IMAGES[LATERAL]} - set(report.inputs)
    return sorted(map(in_words, names))


def in_words(name: str) -> str:
    """An input of a step as the page calls it."""
    return name.replace(SUBJECT_FILE, "values").replace(ANNOTATION_FILE, "annotation")


def _stage(subject: Subject) -> tuple[str, list[str]]:
    wanted = [name for name in annotatable(subject.record) if name != LATERAL]
    absent = [name for name in wanted if not os.path.lexists(subject.image_path(name))]
    unmarked, problem = _unmarked(subject)
    missing = [gap_words(subject, gap) for gap in subject.gaps]
    missing += [f"{sentence(described(name))}: no radiograph" for name in absent]
    missing += [f"{sentence(described(name))}: not annotated" for name in unmarked if name not in absent]
    missing += problem
    training = any(push.frames_of("training") for push in subject.pushes)
    if not subject.gaps and not training:
        missing.append(NO_PUSH if not subject.pushes else NO_TRAINING)
    if subject.gaps:
        return "form", missing
    if absent:
        return "radiographs", missing
    if unmarked or problem:
        return "annotate", missing
    return ("run" if training else "roles"), missing


def _unmarked(subject: Subject) -> tuple[list[str], list[str]]:
    """Images that an estimate needs and nobody has annotated, and what is wrong with the annotation."""
    path = subject.folder / ANNOTATION_FILE
    views = [name for name, needed in annotatable_views(subject).items() if needed]
    wanted = (*annotatable(subject.record), *views)
    there = [name for name in wanted if os.path.lexists(subject.image_path(name))]
    if not os.path.lexists(path):
        return there, []
    try:
        marked = read_annotation(path).images
    except SpinestiffError as error:
        return [], [_one_line(error, subject.folder)]
    return [name for name in there if name not in marked], []


def result(subject: Subject) -> dict[str, Any] | None:
    """What an estimate found, as JSON; None where there is none."""
    if not (subject.results / Estimate.FILE).is_file():
        return None
    try:
        estimate = read_outcome(subject, Estimate)
    except SpinestiffError as error:
        return {"problem": _one_line(error, subject.folder)}
    stiffness = [
        {
            "name": name,
            "title": stiffness_title(name),
            "unit": unit,
            "determined": determined,
            "words": estimated(found),
            "interval": "" if found.low is None and found.high is None else interval(found),
            **found.model_dump(include=QUANTITY),
        }
        for name, found, unit, determined in told_stiffness(estimate)
    ]
    return {
        "badge": badge(estimate) + (", quick look" if estimate.quick_look else ""),
        "lines": [*(sentence(line) for line in headline(estimate)), *([QUICK] if estimate.quick_look else [])],
        "stiffness": stiffness,
        "doubts": [f"{check.name}: {check.text}" for check in estimate.failed],
        "rmse_mm": estimate.training_rmse_mm.fit,
        "cobb": cobb(subject),
    }


def cobb(subject: Subject) -> dict[str, Any] | None:
    """The change of the Cobb angle under the largest force, as JSON; None where none was measured."""
    try:
        responses = read_outcome(subject, Responses)
    except SpinestiffError:
        return None
    measured = [(one.force_n, name, one.curve) for name, one in responses.pushes.items() if one.curve is not None]
    if not measured:
        return None
    force, push, curve = max(measured, key=lambda one: one[0])
    upper, lower = curve.levels
    return {
        "push": push,
        "force_n": force,
        "upper_level": upper,
        "lower_level": lower,
        "rest_deg": curve.rest_deg,
        "change_deg": curve.change_deg,
        "change_half_width95_deg": HALF_WIDTH_95 * curve.change_sd_deg,
        "words": f"{change_words(curve.change_deg, curve.change_sd_deg, f'{upper}–{lower}')} under {force:g} N",
    }


QUICK = "A quick look, on a coarse mesh of the tissue: for values to report, run it with the fine one."
QUANTITY = {"value", "low", "high", "open_low", "open_high"}


def gap_words(subject: Subject, gap: Gap) -> str:
    """What is not known, as a person would ask for it."""
    words = gap.words.partition(" (")[0]
    if gap.push is None:
        return "Sex" if gap.key == "sex" else words[0].upper() + words[1:]
    frames = ""
    if gap.frames:
        frames = f", frame {gap.frames[0]}" + (f" to {gap.frames[-1]}" if len(gap.frames) > 1 else "")
    return f"{sentence(push_named(subject.pushes[gap.push].id))}{frames}: {words}"


def _one_line(error: Exception, folder: Path) -> str:
    words = str(error).replace(f" {folder} again", " again").replace(f"{folder}{os.sep}", "")
    return page_words(words.replace(str(folder), "the folder"))
