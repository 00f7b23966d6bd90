"""The record of a run, ``results/run.json``: what each step was made from, so that only what changed is redone."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from spinestiff import __version__
from spinestiff.errors import SubjectError
from spinestiff.files import file_digest, json_text, read_json, write_json

RESULTS = "results"
RUN_SCHEMA = 1


def package_version() -> str:
    """The version of spinestiff that runs."""
    return __version__


def step_digest(inputs: Mapping[str, str], settings: Mapping[str, Any]) -> str:
    """One hash of all that a step depends on: its input files' hashes, its settings and this program's version."""
    parts = {"inputs": dict(inputs), "settings": dict(settings), "version": package_version()}
    return hashlib.sha256(json_text(parts).encode()).hexdigest()


@dataclass(frozen=True)
class StepRecord:
    """How one step of the pipeline came about.

    Attributes
    ----------
    digest : from ``step_digest``.
    inputs : SHA-256 by path relative to the subject folder.
    settings : what the step was asked.
    seconds : wall-clock time.
    outputs : SHA-256 by path relative to the subject folder.
    """

    digest: str
    inputs: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    seconds: float = 0.0
    outputs: Mapping[str, str] = field(default_factory=dict)


def record_step(folder: Path, step: str, record: StepRecord) -> None:
    """Write a step into the folder's ``results/run.json`` beside the other steps."""
    steps = {**_recorded_steps(folder), step: asdict(record)}
    write_json(_run_file(folder), {"schema_version": RUN_SCHEMA, "version": package_version(), "steps": steps})


def is_current(folder: Path, step: str, digest: str) -> bool:
    """Whether the step was made from just this (``step_digest``) and its outputs are still as it left them."""
    recorded = _recorded_steps(folder).get(step)
    if not isinstance(recorded, dict) or recorded.get("digest") != digest:
        return False
    outputs = recorded.get("outputs", {})
    return all((folder / name).is_file() and file_digest(folder / name) == sha for name, sha in outputs.items())


def changed_inputs(folder: Path, step: str) -> tuple[str, ...]:
    """Inputs of a recorded step that have changed or gone since it ran, by path relative to ``folder``."""
    recorded = _recorded_steps(folder).get(step)
    inputs = recorded.get("inputs", {}) if isinstance(recorded, dict) else {}
    return tuple(
        name for name, sha in inputs.items() if not (folder / name).exists() or file_digest(folder / name) != sha
    )


def _run_file(folder: Path) -> Path:
    return folder / RESULTS / "run.json"


def _recorded_steps(folder: Path) -> dict[str, Any]:
    # A damaged record only means that the steps are redone.
    try:
        run = read_json(_run_file(folder))
    except SubjectError:
        return {}
    known = isinstance(run, dict) and run.get("schema_version") == RUN_SCHEMA and isinstance(run.get("steps"), dict)
    return run["steps"] if known else {}
