"""Viewer files: the page of a visit as far as it has come, and of a torso file."""

from __future__ import annotations

from pathlib import Path

from spinestiff.anatomy.files import read_torso
from spinestiff.files import write_text
from spinestiff.study.predictions import Predictions
from spinestiff.study.report.viewer.page import view_page
from spinestiff.study.report.viewer.scene import Scene, visit_scene
from spinestiff.study.subject_body import subject_template
from spinestiff.study.visit import Visit
from spinestiff.words import pasted


def scene_of(visit: Visit, predictions: Predictions) -> Scene:
    """The scene of a visit with an estimate, with default and estimated stiffness in every frame."""
    record = visit.subject.record
    return visit_scene(record.id, predictions, {p.id: (p.side, p.level) for p in record.pushes})


def write_view(visit: Visit, predictions: Predictions) -> None:
    """Write ``results/view.html`` of a visit with an estimate. Raises SubjectError if it can't be written."""
    write_text(visit.file("view.html"), view_page(scene_of(visit, predictions)))


def write_rest_view(visit: Visit, path: Path) -> str:
    """Write the torso of a visit without an estimate, at rest: the subject's own, or else the template.

    Returns
    -------
    What it shows and what to run for more, in words.
    """
    folder = visit.subject.folder
    if visit.file("torso.npz").is_file():
        torso, shown = visit.torso(), "the subject’s torso at rest"
    else:
        torso, shown = subject_template(visit.subject.record, "coarse"), "the template of the subject’s sizes, at rest"
    # The page may be passed on, and tells no path.
    run = f"spinestiff run {pasted(Path(folder.name))}"
    note = f"No estimate yet: this is {shown}. For pushes and measured vertebrae: {run}"
    write_text(path, view_page(Scene(visit.subject.record.id, torso, note=note)))
    return f"no estimate yet: shows {shown}; for pushes and measured vertebrae: spinestiff run {pasted(folder)}"


def write_torso_view(torso_file: Path, path: Path) -> None:
    """Write the page of a torso file alone, at rest. Raises TorsoError."""
    torso = read_torso(torso_file)
    write_text(path, view_page(Scene(torso_file.name, torso)))
