"""Where an output of any command may go: nowhere that a subject folder, this one's or another's, loses something."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from spinestiff.errors import SpinestiffError, SubjectError
from spinestiff.files import check_output
from spinestiff.subject.records import RESULTS, SUBJECT_FILE

READ_AGAIN = (
    "run.json", "tracked.json", "response.json", "frames.json", "torso.npz", "torso_coarse.npz", "personalised.json",
    "training.npz", "estimate.json", "posterior.csv", "predictions.npz", "assessment.json", "comparison.json",
    "plan.json", "parameters.json", "sensitivity.json",
)  # fmt: skip
"""Files in ``results/`` that steps and tables read, and ``torso export``; the rest is for people."""


def check_output_beside(folder: Path, path: Path, option: str, *, force: bool) -> None:
    """Refuse a place for an output of a command that reads the subject in this folder (``files.check_output``).

    Inside the folder only ``results/`` is written to, and there no result that a step reads.

    Raises
    ------
    SubjectError : see ``files.check_output``; a place in another subject's folder that is no place for it there.
    """
    for one in dict.fromkeys((folder, *_subject_folder_of(path))):
        results = one / RESULTS
        inputs = [results / name for name in READ_AGAIN]
        check_output(path, option, inputs=inputs, closed=one, but=results, force=force)


def check_output_apart(
    path: Path,
    option: str,
    *,
    inputs: Iterable[Path] = (),
    force: bool,
    error: type[SpinestiffError] = SubjectError,
) -> None:
    """Refuse a place for an output of a command that reads no subject folder (``files.check_output``); in one that
    the place happens to lie in, nothing is lost either.

    Raises
    ------
    error : see ``files.check_output``. SubjectError : see ``check_output_beside``.
    """
    check_output(path, option, inputs=inputs, force=force, error=error)
    for folder in _subject_folder_of(path):
        check_output_beside(folder, path, option, force=force)


def _subject_folder_of(path: Path) -> list[Path]:
    """The subject folder in which a place lies, if it does."""
    return [folder for folder in Path(os.path.realpath(path)).parents if (folder / SUBJECT_FILE).is_file()][:1]
