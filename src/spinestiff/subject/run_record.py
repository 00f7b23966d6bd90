"""The record of a run, ``results/run.json``, and the results that it vouches for: written and read in one place.

A step is redone only when something that it was made from changed. Of ``subject.json`` and ``annotation.json`` only the
part counts that a step uses: a height is no reason to track anew. A result is read only if it is as its step left it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Final, Literal, TypeVar

from pydantic import Field, ValidationError

from spinestiff import __version__
from spinestiff.errors import SubjectError
from spinestiff.files import file_digest, read_text, trouble, write_json
from spinestiff.formats import json_text, parse_json
from spinestiff.subject.folder import Subject
from spinestiff.subject.image_names import PUSH, REST
from spinestiff.subject.outcome_parts import Outcome, OutcomeFile
from spinestiff.subject.program import program, program_of_numbers
from spinestiff.subject.record_reading import complaint_of
from spinestiff.subject.records import ANNOTATION_FILE, RESULTS, SUBJECT_FILE
from spinestiff.words import pasted

RUN_FILE = "run.json"
RUN_SCHEMA: Final = 2
_RUN = f"{RESULTS}/{RUN_FILE}"

F = TypeVar("F", bound=OutcomeFile)


class StepRecord(Outcome):
    """How one step came about.

    Attributes
    ----------
    digest : of all that it depends on.
    inputs : SHA-256 by path relative to the subject folder, or by the name of a part (``PARTS``).
    settings : what the step was asked.
    seconds, cpu_seconds : wall-clock time, and processor time of all threads.
    outputs : SHA-256 by path relative to the subject folder.
    program : that did it (``subject.program``).
    """

    digest: str
    inputs: dict[str, str] = Field(default_factory=dict)
    settings: dict[str, Any] = Field(default_factory=dict)
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    outputs: dict[str, str] = Field(default_factory=dict)
    program: str = ""


class RunRecord(Outcome):
    """``run.json``: every step that ran, and the version of this program that ran last."""

    schema_version: Literal[2] = RUN_SCHEMA
    version: str
    steps: dict[str, StepRecord] = Field(default_factory=dict)


def _pushes(subject: Subject, *fields: str) -> object:
    return [push.model_dump(mode="json", include=set(fields)) for push in subject.pushes]


def _images(subject: Subject, kind: str) -> object:
    images = subject.annotation.images
    return {name: image.model_dump(mode="json") for name, image in images.items() if name.startswith(kind)}


def _frames(subject: Subject) -> object:
    """What tracking looks at: of forces only how many there are, and which is the least, from which markers move."""
    pushes = [
        (push.model_dump(mode="json", include={"id", "frames", "views", "markers"}), push) for push in subject.pushes
    ]
    return [{**known, "count": len(push.forces_n), "least": push.markers and push.unloaded} for known, push in pushes]


def _body(subject: Subject) -> object:
    """What the torso is shaped from, age and sex among it."""
    return subject.record.model_dump(mode="json", exclude={"pushes", "xray", "id", *_SUPPORTS, *_ASKED})


_PERSON = {"age", "sex"}
_SUPPORTS = {"pelvis", "wall", "priors"}
_ASKED = {"parameters", "population"}
"""Settings that are in ``subject.json``: a step that follows them has them among its settings."""

PARTS: Mapping[str, Callable[[Subject], object]] = {
    f"{SUBJECT_FILE}: id": lambda s: s.record.id,
    # Without these two as before there could be any, so that earlier results stay up to date.
    f"{SUBJECT_FILE}: X-ray geometry": lambda s: s.record.xray.model_dump(
        mode="json", exclude={key for key in ("images", "beam") if not getattr(s.record.xray, key)}
    ),
    f"{SUBJECT_FILE}: frames": _frames,
    f"{SUBJECT_FILE}: forces": lambda s: _pushes(s, "id", "forces_n"),
    f"{SUBJECT_FILE}: pushes": lambda s: _pushes(
        s, "id", "frames", "forces_n", "side", "level", "d21_mm", "d31_mm", "views", "markers"
    ),
    f"{SUBJECT_FILE}: roles": lambda s: _pushes(s, "id", "roles"),
    f"{SUBJECT_FILE}: body": _body,
    # In the body, too; records of earlier versions have it apart.
    f"{SUBJECT_FILE}: person": lambda s: s.record.model_dump(mode="json", include=_PERSON),
    f"{SUBJECT_FILE}: supports": lambda s: s.record.model_dump(mode="json", include=_SUPPORTS),
    f"{ANNOTATION_FILE}: rest": lambda s: _images(s, REST),
    f"{ANNOTATION_FILE}: pushes": lambda s: _images(s, PUSH),
}
"""What of the two files a step may depend on, by name."""


def input_digest(subject: Subject, name: str) -> str:
    """SHA-256 of an input: a part of ``PARTS``, else a file or folder relative to the subject folder.

    Raises
    ------
    SubjectError : something can't be read.
    """
    if name in PARTS:
        return hashlib.sha256(json_text(PARTS[name](subject)).encode()).hexdigest()
    return file_digest(subject.folder / name)


def step_digest(inputs: Mapping[str, str], settings: Mapping[str, Any], made_by: str) -> str:
    """One hash of all that a step depends on: its inputs' hashes, its settings and the program that does it."""
    parts = {"inputs": dict(inputs), "settings": dict(settings), "version": made_by}
    return hashlib.sha256(json_text(parts).encode()).hexdigest()


def step_record(
    subject: Subject, inputs: Iterable[str], settings: Mapping[str, Any], made_by: str | None = None
) -> StepRecord:
    """The record of a step that is about to run.

    Parameters
    ----------
    made_by : the program that does it; None: ``subject.program.program``, of a step that makes pages or pictures.

    Raises
    ------
    SubjectError : an input can't be read.
    """
    hashes, made_by = {name: input_digest(subject, name) for name in sorted(inputs)}, made_by or program()
    digest = step_digest(hashes, settings, made_by)
    return StepRecord(digest=digest, inputs=hashes, settings=dict(settings), program=made_by)


def record_step(
    subject: Subject,
    step: str,
    record: StepRecord,
    outputs: Iterable[Path],
    seconds: float = 0.0,
    cpu_seconds: float = 0.0,
) -> None:
    """Write a step into ``run.json`` beside the other steps, with the hashes of what it has just written."""
    made = {path.relative_to(subject.folder).as_posix(): file_digest(path) for path in outputs}
    times = {"seconds": round(seconds, 3), "cpu_seconds": round(cpu_seconds, 3)}
    done = record.model_copy(update={"outputs": made, **times})
    run = RunRecord(version=__version__, steps={**recorded_steps(subject), step: done})
    write_json(subject.results / RUN_FILE, run.model_dump(mode="json"))


def recorded_steps(subject: Subject) -> dict[str, StepRecord]:
    """The steps of ``run.json``; none if it is missing, damaged or of another version, so that they are redone.

    Raises
    ------
    SubjectError : it is there and can't be opened, so that nobody knows what would be redone.
    """
    path = subject.results / RUN_FILE
    if not path.is_file():
        return {}
    try:
        path.open("rb").close()
    except OSError as problem:
        raise SubjectError(f"{path}: can't be read ({trouble(problem)})") from None
    try:
        text = read_text(path)
        parse_json(text, str(path))
        return RunRecord.model_validate_json(text, strict=True).steps
    except (SubjectError, ValidationError):
        return {}


def is_current(subject: Subject, step: str, record: StepRecord) -> bool:
    """Whether the step was made from just this and its outputs are still as it left them."""
    recorded = recorded_steps(subject).get(step)
    return recorded is not None and recorded.digest == record.digest and not changed_outputs(subject, step)


def changed_program(subject: Subject, step: str, record: StepRecord) -> str:
    """The program that made a step of the same inputs and settings; "" where more has changed, or nothing."""
    last = recorded_steps(subject).get(step)
    alike = last is not None and (last.inputs, last.settings) == (record.inputs, record.settings)
    return last.program if last is not None and alike and last.program != record.program else ""


def differences(subject: Subject, step: str, record: StepRecord) -> tuple[str, ...]:
    """What of a step is not as when it ran last: names of inputs, settings and outputs; "never run" if it has not."""
    last = recorded_steps(subject).get(step)
    if last is None:
        return ("never run",)
    found = [
        name
        for then, now in ((last.inputs, record.inputs), (last.settings, record.settings))
        for name in dict.fromkeys((*then, *now))
        if then.get(name) != now.get(name)
    ]
    program = ("the program",) if last.program != record.program else ()
    return (*found, *changed_outputs(subject, step), *program)


def changed_inputs(subject: Subject, step: str) -> tuple[str, ...]:
    """Inputs of a recorded step that have changed or gone since it ran, by name."""
    recorded = recorded_steps(subject).get(step)
    return () if recorded is None else _changed(subject, recorded.inputs)


def why_stale(subject: Subject, step: str) -> str:
    """Why the results of a recorded step are not of what is there now, e.g. "made before annotation.json: rest
    changed"; "" if they are."""
    changed = changed_inputs(subject, step)
    if not changed:
        return ""
    # Another program may look at other parts of the same files.
    before = recorded_steps(subject)[step].program
    if before not in (now := (program(), program_of_numbers())):
        return f"made by spinestiff {before}; by this one, {now[0]}, {changed[0]} changed"
    return f"made before {changed[0]} changed"


def changed_lately(subject: Subject, step: str) -> tuple[str, ...]:
    """Like ``changed_inputs``, but a file that is older than the step is taken to be as it was, and not read; what
    can't be read has changed."""
    recorded = recorded_steps(subject).get(step)
    if recorded is None:
        return ()
    # Later steps write their own into the record; inputs were hashed before the step began.
    made = [path for path in (subject.folder / name for name in (*recorded.outputs, _RUN)) if path.is_file()]
    since = min(path.stat().st_mtime_ns for path in made) - int(1e9 * recorded.seconds)
    late = {
        name: sha for name, sha in recorded.inputs.items() if name in PARTS or _younger(subject.folder / name, since)
    }
    return tuple(name for name, sha in late.items() if _readable_digest(subject, name) != sha)


def _readable_digest(subject: Subject, name: str) -> str:
    """``input_digest``, or "" of what is not there or can't be read."""
    try:
        return input_digest(subject, name)
    except SubjectError:
        return ""


def _younger(path: Path, since_ns: int) -> bool:
    """Whether a file, or one in a folder, was written at that time or after it; also where it is not there."""
    if not path.exists():
        return True
    inside = path.iterdir() if path.is_dir() else ()
    return any(one.lstat().st_mtime_ns >= since_ns for one in (path, *inside))


def refuse_changed(subject: Subject, *steps: str) -> None:
    """Raise SubjectError if an input of one of these steps has changed since it ran."""
    for step in steps:
        if why := why_stale(subject, step):
            raise SubjectError(
                f"{subject.results}: results of {step} were {why}; run spinestiff {step} again, or spinestiff run"
            )


def changed_outputs(subject: Subject, step: str) -> tuple[str, ...]:
    """Outputs of a recorded step that have changed or gone since it ran, by path relative to the subject folder."""
    recorded = recorded_steps(subject).get(step)
    return () if recorded is None else _changed(subject, recorded.outputs)


def is_unchanged(subject: Subject, step: str) -> bool:
    """Whether a step has run, and its inputs and outputs are as they were then."""
    ran = step in recorded_steps(subject)
    return ran and not changed_inputs(subject, step) and not changed_outputs(subject, step)


def _changed(subject: Subject, hashes: Mapping[str, str]) -> tuple[str, ...]:
    there = {name: name in PARTS or (subject.folder / name).exists() for name in hashes}
    return tuple(name for name, sha in hashes.items() if not there[name] or input_digest(subject, name) != sha)


def result_path(subject: Subject, name: str, step: str) -> Path:
    """The path of a result that is as its step left it.

    Raises
    ------
    SubjectError : there is none, or it is not what the step wrote: edited, truncated, copied from elsewhere.
    """
    path = subject.results / name
    again = f"spinestiff {step} {pasted(subject.folder)}"
    if not path.is_file():
        raise SubjectError(f"{path}: no such file; run the step that makes it first ({again})")
    recorded = recorded_steps(subject).get(step)
    key = path.relative_to(subject.folder).as_posix()
    if recorded is None or key not in recorded.outputs:
        raise SubjectError(f"{path}: {subject.results / RUN_FILE} does not say how it was made; run {again} again")
    if file_digest(path) != recorded.outputs[key]:
        raise SubjectError(f"{path}: was changed after spinestiff {step} had written it; run {again} again")
    return path


def write_outcome(subject: Subject, outcome: OutcomeFile) -> None:
    """Write a result into the subject's ``results/``; whole or not at all."""
    write_json(subject.results / outcome.FILE, outcome.model_dump(mode="json"))


def read_outcome(subject: Subject, kind: type[F]) -> F:
    """A result of the subject.

    Raises
    ------
    SubjectError : see ``result_path``; or it is of another version of this program, or no such result at all.
    """
    path = result_path(subject, kind.FILE, kind.STEP)
    again = f"run spinestiff {kind.STEP} {subject.folder} again"
    text = read_text(path)
    content = parse_json(text, str(path))
    version = content.get("schema_version") if isinstance(content, dict) else None
    wanted = kind.model_fields["schema_version"].default
    if version != wanted:
        raise SubjectError(f"{path}: found schema_version {version!r}, wanted {wanted}; {again}")
    try:
        return kind.model_validate_json(text, strict=True)
    except ValidationError as error:
        raise SubjectError(f"{path}: {complaint_of(error)}; {again}") from None
