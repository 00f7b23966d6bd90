"""Results in ``results/`` as their step would have left them: named in ``run.json`` with their hashes."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from spinestiff.subject.folder import Subject, read_subject
from spinestiff.subject.outcomes import OutcomeFile
from spinestiff.subject.run_record import StepRecord, record_step, recorded_steps


def register(subject: Subject, step: str, *names: str) -> None:
    """Say in ``run.json`` that a step wrote what lies in ``results/`` under these names, and keep the rest of it."""
    known = recorded_steps(subject).get(step, StepRecord(digest="by hand"))
    others = [subject.folder / path for path in known.outputs]
    record_step(subject, step, known, sorted({*others, *(subject.results / name for name in names)}))


def altered(folder: Path, kind: type[OutcomeFile], change: Callable[[Any], None]) -> Subject:
    """A subject folder whose result was changed by ``change(content)``, as if its step had written it so."""
    subject = read_subject(folder)
    path = subject.results / kind.FILE
    content = json.loads(path.read_text(encoding="utf-8"))
    change(content)
    path.write_text(json.dumps(content), encoding="utf-8")
    register(subject, kind.STEP, kind.FILE)
    return subject
