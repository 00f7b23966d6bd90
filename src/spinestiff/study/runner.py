"""The steps from a subject folder to its results, in order; each is redone only when what it was made from changed.

``track`` -> ``response`` -> ``personalise`` -> ``estimate`` -> ``assess`` -> ``report``. Results go to ``results/`` in
the folder.
``view``, the 3D page alone, needs no report; the report brings it along. ``frames`` needs the tracking alone.
``parameters`` and ``sensitivity`` need the estimate; the report shows the latter where it is there and up to date, and
so a plan (``spinestiff plan``), which is asked for anew each time and is no step.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from spinestiff.errors import OptionError, SubjectError
from spinestiff.files import check_writable, file_digest
from spinestiff.observer import Observer, heard
from spinestiff.study import steps as step_functions
from spinestiff.study.draws import DRAWS_FILE
from spinestiff.study.starting_torso import SCAN_PICTURE, left_of_shape
from spinestiff.study.summary import ASSESSMENT_FILE, ESTIMATE_FILE, RESPONSE_FILE
from spinestiff.study.visit import START, Visit
from spinestiff.subject.image_names import rest_image
from spinestiff.subject.program import program, program_of_numbers
from spinestiff.subject.records import ANNOTATION_FILE, RESULTS, SUBJECT_FILE
from spinestiff.subject.run_record import (
    StepRecord,
    changed_outputs,
    changed_program,
    differences,
    is_current,
    is_unchanged,
    record_step,
    recorded_steps,
    result_path,
    step_digest,
    step_record,
    why_stale,
)
from spinestiff.words import pasted

WITHOUT_PUSHES = {"personalise"}
"""Steps for which the rest radiographs are enough."""
STEPS = ("track", "response", "personalise", "estimate", "assess", "report")
ID, PUSHES, ROLES = (f"{SUBJECT_FILE}: {part}" for part in ("id", "pushes", "roles"))
XRAY, FRAMES, FORCES = (f"{SUBJECT_FILE}: {part}" for part in ("X-ray geometry", "frames", "forces"))
BODY, PERSON, SUPPORTS = (f"{SUBJECT_FILE}: {part}" for part in ("body", "person", "supports"))
REST_MARKS, PUSH_MARKS = f"{ANNOTATION_FILE}: rest", f"{ANNOTATION_FILE}: pushes"
SHAPE = ("torso.npz", "personalised.json")
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Step:
    """A step: what it is made from and what it makes.

    Attributes
    ----------
    run : does it.
    parts : of ``subject.json`` and ``annotation.json`` (``subject.run_record.PARTS``).
    images : of "rest" and "push", whose radiographs it reads.
    results : of earlier steps, by file name. makes : names of the files that it may write.
    leaves : those of them that it does not write for this visit. brings : a step that it does on its way.
    also : steps whose outputs it shows if they are up to date, and does without otherwise.
    settings : what of the visit's settings it follows.
    tells : it makes pages or pictures, too, so that it is redone when what they are made by changed.
    """

    run: Callable[[Visit, Observer], None]
    parts: tuple[str, ...]
    images: tuple[str, ...]
    results: tuple[str, ...]
    makes: tuple[str, ...]
    leaves: Callable[[Visit], Collection[str]] = lambda visit: ()
    settings: Callable[[Visit], dict[str, Any]] = lambda visit: {}
    brings: str | None = None
    also: tuple[str, ...] = ()
    tells: bool = False

    def outputs(self, visit: Visit) -> list[str]:
        """Names of the files that it writes for this visit."""
        left = self.leaves(visit)
        return [name for name in self.makes if name not in left]

    def record(self, visit: Visit) -> StepRecord:
        """How it would come about now. Raises SubjectError if an input can't be read."""
        made_by = program() if self.tells else program_of_numbers()
        return step_record(visit.subject, self.inputs(visit), self.settings(visit), made_by)

    def inputs(self, visit: Visit) -> list[str]:
        """Names of all inputs, relative to the subject folder."""
        subject = visit.subject
        names = [*self.parts, *(f"{RESULTS}/{name}" for name in self.results)]
        for step in self.also:
            names += recorded_steps(subject)[step].outputs if is_unchanged(subject, step) else ()
        paths = [subject.image_path(rest_image(view)) for view in subject.rest_views if "rest" in self.images]
        if "push" in self.images:
            paths += [subject.image_path(push.image) for push in subject.pushes]
            paths += [subject.folder / view.files for push in subject.pushes for view in push.views]
            paths += subject.marker_paths
        if BODY in self.parts:
            paths += [path for path in (subject.torso_path, subject.scan_path) if path is not None]
        return [*names, *(path.relative_to(subject.folder).as_posix() for path in paths)]


def _truth(visit: Visit) -> dict[str, Any]:
    return {"truth": None if visit.truth is None else file_digest(visit.truth)}


def _mesh(visit: Visit) -> dict[str, Any]:
    return {"mesh": visit.settings.mesh}


ALL_STEPS: Mapping[str, Step] = {
    "track": Step(step_functions.track_step, (XRAY, FRAMES, PUSH_MARKS), ("push",), (), ("tracked.json",)),
    "frames": Step(
        step_functions.frames_step,
        (XRAY, PUSHES, ROLES, PUSH_MARKS),
        ("push",),
        ("tracked.json",),
        ("frames.json", "frames.png"),
        tells=True,
    ),
    "response": Step(
        step_functions.response_step,
        (XRAY, FORCES, SUPPORTS, REST_MARKS),
        ("rest",),
        ("tracked.json",),
        ("response.json", RESPONSE_FILE),
    ),
    "personalise": Step(
        step_functions.personalise_step,
        (XRAY, BODY, REST_MARKS),
        ("rest",),
        (),
        (*SHAPE, SCAN_PICTURE, START),
        left_of_shape,
        _mesh,
    ),
    "estimate": Step(
        step_functions.estimate_step,
        (PUSHES, ROLES, BODY, SUPPORTS),
        ("rest", "push"),
        ("tracked.json", *SHAPE),
        ("estimate.json", ESTIMATE_FILE, "training.npz", DRAWS_FILE),
        lambda visit: () if visit.settings.method == "weighed" else (DRAWS_FILE,),
        lambda visit: {
            "method": visit.settings.method,
            "orientation": visit.settings.orientation,
            "parameters": list(visit.parameters),
            "population": visit.population,
        },
    ),
    "parameters": Step(
        step_functions.parameters_step,
        (PUSHES, ROLES, SUPPORTS),
        (),
        ("tracked.json", *SHAPE, "estimate.json"),
        ("parameters.json",),
        settings=_mesh,
    ),
    "sensitivity": Step(
        step_functions.sensitivity_step,
        (PUSHES, ROLES, SUPPORTS),
        (),
        ("tracked.json", *SHAPE, "estimate.json"),
        ("sensitivity.json", "sensitivity.png"),
        settings=_mesh,
        tells=True,
    ),
    "assess": Step(
        step_functions.assess_step,
        (PUSHES, ROLES, SUPPORTS),
        (),
        ("tracked.json", *SHAPE, "estimate.json", "training.npz"),
        ("assessment.json", ASSESSMENT_FILE, "predictions.npz", "comparison.json"),
        lambda visit: () if visit.truth else ("comparison.json",),
        _truth,
    ),
    "report": Step(
        step_functions.report_step,
        (ID, PUSHES, ROLES, BODY, PERSON, SUPPORTS, XRAY, REST_MARKS, PUSH_MARKS),
        ("rest", "push"),
        ("tracked.json", "response.json", *SHAPE, "estimate.json", "assessment.json", "predictions.npz"),
        ("report.html", "view.html"),
        settings=_truth,
        brings="view",
        also=("sensitivity", "plan"),
        tells=True,
    ),
    "view": Step(
        step_functions.view_step,
        (ID, PUSHES, ROLES, SUPPORTS),
        (),
        ("tracked.json", *SHAPE, "estimate.json", "predictions.npz"),
        ("view.html",),
        tells=True,
    ),
}
"""Every step, in the order in which they run."""


def run_steps(
    visit: Visit,
    steps: tuple[str, ...] = STEPS,
    observer: Observer | None = None,
    force: bool = False,
    known: Mapping[str, Step] = ALL_STEPS,
) -> list[str]:
    """Run the steps in order, leaving out those that are current; returns the names of those that ran.

    A visit without a truth file leaves what was compared with a truth as it is.

    Parameters
    ----------
    steps : names of those wanted. force : run even what is current, and nothing of a run that was stopped is kept.
    known : every step by name, in the order in which they run, with those that others bring or read from.

    Raises
    ------
    OptionError : no such step.
    SpinestiffError : the first step that fails; what was written before stays. Before any step, where results can't be
        written.
    """
    if strange := [name for name in steps if name not in known]:
        raise OptionError(f"no step '{strange[0]}'; wanted some of {', '.join(known)}")
    say = heard(observer, _log)
    if force:
        visit = replace(visit, settings=replace(visit.settings, redo=True))
    if not visit.subject.pushes and set(steps) - WITHOUT_PUSHES:
        path = visit.subject.folder / SUBJECT_FILE
        raise SubjectError(f"{path}: pushes is empty; spinestiff plan says which push to take first")
    if "estimate" in steps and not any(push.frames_of("training") for push in visit.subject.pushes):
        folder = visit.subject.folder
        raise SubjectError(
            f"{folder / SUBJECT_FILE}: no frame has the role training; spinestiff frames {pasted(folder)} proposes "
            "roles, and --write sets them"
        )
    ran: list[str] = []
    for name, step in known.items():
        if name not in steps:
            continue
        for result in step.results:
            _refuse_stale(visit, result, known)
        record = step.record(visit)
        if not force and is_current(visit.subject, name, _as_compared(visit, name, record)):
            say(f"{name}: up to date")
            continue
        _log.debug("%s is made from what changed: %s", name, ", ".join(differences(visit.subject, name, record)))
        if not ran:
            check_writable(visit.subject.results, "results")
        before = changed_program(visit.subject, name, record)
        if before:
            say(f"{name}: was made by spinestiff {before}, this is {record.program}; made again")
        for changed in changed_outputs(visit.subject, name):
            say(f"{name}: {changed} is not as it was written; made again")
        along = None if step.brings is None else known[step.brings].record(visit)
        with logged_step(name):
            began, worked = time.perf_counter(), time.process_time()
            step.run(visit, lambda line, name=name: say(f"{name}: {line}"))  # type: ignore[misc]
            _record(visit, step, name, record, time.perf_counter() - began, time.process_time() - worked)
        if step.brings is not None and along is not None:
            _record(visit, known[step.brings], step.brings, along)
        ran.append(name)
    return ran


@contextmanager
def logged_step(name: str) -> Iterator[None]:
    """Log that a step begins and, unless it fails, its end with its seconds."""
    began = time.perf_counter()
    _log.info("%s begins", name, extra={"event": "begin", "step": name})
    yield
    seconds = round(time.perf_counter() - began, 3)
    _log.info("%s is done", name, extra={"event": "end", "step": name, "seconds": seconds})


def _record(
    visit: Visit, step: Step, name: str, record: StepRecord, seconds: float = 0.0, cpu_seconds: float = 0.0
) -> None:
    outputs = [visit.file(output) for output in step.outputs(visit)]
    record_step(visit.subject, name, record, outputs, seconds, cpu_seconds)


def _as_compared(visit: Visit, name: str, record: StepRecord) -> StepRecord:
    """The record with the truth that the step knew last, where the visit names none and the step would follow it."""
    last = recorded_steps(visit.subject).get(name)
    if visit.truth is not None or last is None or "truth" not in record.settings:
        return record
    settings = {**record.settings, "truth": last.settings.get("truth")}
    return record.model_copy(
        update={"settings": settings, "digest": step_digest(record.inputs, settings, record.program)}
    )


def _refuse_stale(visit: Visit, result: str, known: Mapping[str, Step]) -> None:
    """Raise SubjectError unless a result of an earlier step is there, as written, and made from what is there now."""
    maker = next((name for name, step in known.items() if result in step.makes), None)
    if maker is None:
        raise SubjectError(f"{visit.file(result)}: is made by none of the steps {', '.join(known)}")
    path = result_path(visit.subject, result, maker)
    if why := why_stale(visit.subject, maker):
        raise SubjectError(f"{path}: was {why}; run spinestiff {maker} again, or spinestiff run")
