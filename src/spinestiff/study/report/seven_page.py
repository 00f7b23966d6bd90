"""The study's page with its pictures, from the outcomes and the subjects' folders."""

from __future__ import annotations

import datetime
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.errors import SpinestiffError, SubjectError
from spinestiff.files import write_bytes, write_text
from spinestiff.imaging.features import state_features, target_features, vertebra_rows
from spinestiff.imaging.projection import XRayView
from spinestiff.imaging.radiograph import Radiograph
from spinestiff.imaging.synthetic.path_length import path_length
from spinestiff.imaging.synthetic.rendering import coarser
from spinestiff.observer import Observer
from spinestiff.personalise.pose import align_view
from spinestiff.study.paper import SUBJECTS
from spinestiff.study.predictions import Predictions
from spinestiff.study.report.figures import as_png
from spinestiff.study.report.placing import pixel_mm
from spinestiff.study.report.seven_pictures import Shot, draw_models, draw_sequence
from spinestiff.study.seven.page import Picture, Pictures, page_text
from spinestiff.study.seven.participants import MAIN, STEPS
from spinestiff.study.steps import stored_predictions
from spinestiff.study.visit import Settings, Visit, open_visit
from spinestiff.study.wording.numbers import listed
from spinestiff.subject.annotated_points import image_corners
from spinestiff.subject.folder import read_push, read_rest
from spinestiff.subject.image_names import FRONTAL
from spinestiff.subject.program import program_of_numbers
from spinestiff.subject.study_outcome import SubjectOutcome

_MODELS = "Models over radiographs and corners: at rest, default, estimate"
SEQUENCE_FIGURE = "2"
FIGURES = {
    SEQUENCE_FIGURE: (range(1, len(SUBJECTS) + 1), "Tracked corners under rising force"),
    "4": (range(1, 5), _MODELS),
    "5": (range(5, len(SUBJECTS) + 1), _MODELS),
}
"""Subjects by number and words of each figure, by the paper's number; Fig. 2 shows the first of them that is there."""
SHADOW_STEP, BONE_MM = 4, 25.0  # pixels of a shadow's pixel; path length that is drawn as solid
LEFT_OUT = ("humerus", "clavicle", "scapula", "sternum")
SEQUENCE = (0.0, 0.5, 1.0)  # shares of a push in Fig. 2


def check_page(page: Path) -> None:
    """Raise SubjectError for a page that is no Markdown file."""
    if page.suffix != ".md" or page.is_dir():
        raise SubjectError(f"--page {page}: wanted the name of a file that ends in .md")


def write_page(
    folder: Path,
    page: Path,
    first: Sequence[SubjectOutcome | None],
    further: Sequence[SubjectOutcome],
    asked: Settings,
    lacking: Mapping[str, str | None],
    say: Observer,
) -> Path:
    """Write the page, and its pictures into ``images`` beside it.

    The page needs the outcomes alone. A subject whose folder is not there, or not as its run left it, is in no picture;
    a picture in which nobody would be stays as an earlier page left it. The page says both.

    Parameters
    ----------
    folder : of the study. first : the seven, None where there is no outcome. further : the others that there are.
    lacking : who has no outcome, as in ``page_text``. say : is told why a subject could not be drawn.

    Raises
    ------
    SubjectError : something can't be written.
    """
    images, shots, undrawn = page.parent / "images", dict[int, tuple[list[Shot], list[Shot]]](), list[str]()
    for number, one in enumerate(first, 1):
        if one is not None:
            try:
                shots[number] = _shots(open_visit(folder / one.name, asked))
            except SpinestiffError as error:
                undrawn.append(one.name)
                say(f"{one.name} is in no picture: {error}")
    shown, kept = list[Picture](), list[str]()
    for figure, (numbers, words) in FIGURES.items():
        path = images / f"study-figure-{figure}.png"
        there = [one for one in numbers if one in shots][: 1 if figure == SEQUENCE_FIGURE else None]
        if there:
            if figure == SEQUENCE_FIGURE:
                drawn = draw_sequence(shots[there[0]][0])
            else:
                drawn = draw_models([(f"# {one}", shots[one][1]) for one in there])
            write_bytes(path, as_png(drawn))
            words = f"{words} ({listed(f'# {one}' for one in there)})"
        elif path.is_file() and any(first[one - 1] is not None for one in numbers):
            kept.append(figure)
        else:
            continue
        shown.append(Picture(figure, os.path.relpath(path, page.parent), words))
    pictures = Pictures(tuple(shown), tuple(kept), tuple(undrawn))
    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    write_text(page, page_text(first, further, pictures, today, program_of_numbers(), asked.mesh, lacking))
    return page


def _shots(visit: Visit) -> tuple[list[Shot], list[Shot]]:
    """Of Fig. 2, and of Figs. 4 and 5."""
    predictions = stored_predictions(visit)
    push = visit.subject.push(MAIN)
    film = read_push(visit.subject, push)
    tracked = [item for item in predictions.pushes.trials if item.push == MAIN]
    sequence = []
    for share in SEQUENCE:
        item = next((one for one in tracked if one.frame == round(share * STEPS)), None)
        if item is not None:
            view = item.trial.view
            pixels = np.asarray(view.pixels(item.trial.corners.corners))
            title = f"{item.force_n:.0f} N"
            sequence.append(Shot(title, film[item.frame].pixels, pixel_mm(view), pixels))
    return sequence, [_at_rest(visit, predictions.pushes.torso), *_held_out(predictions, film)]


def _at_rest(visit: Visit, torso: TorsoModel) -> Shot:
    picture = read_rest(visit.subject, "frontal")
    corners = image_corners(visit.subject, FRONTAL, picture.view)
    view, pose = align_view(torso, torso.rest_pose, picture.view, corners)
    made = state_features(torso, view, torso.rest_pose).z[vertebra_rows(torso, corners)]
    seen = target_features(torso, view, corners)
    title = f"initial pose, RMSE {pose.rms_mm:.1f} mm"
    return _shot(title, picture, view, seen, made, torso, torso.rest_pose)


def _held_out(predictions: Predictions, film: Sequence[Radiograph]) -> list[Shot]:
    torso = predictions.pushes.torso
    frame = next((p for p in predictions.of_role("validation") if p.item.push == MAIN), None)
    if frame is None:
        return []
    found = []
    for name, words in (("default", "default"), ("fit", "optimized")):
        if name in frame.solved:
            title = f"validation, {words}, RMSE {frame.rmse(torso, name):.1f} mm"
            view, state = frame.item.trial.view, frame.solved[name].state
            picture = film[frame.item.frame]
            found.append(_shot(title, picture, view, frame.target.z, frame.boxes(torso, name), torso, state))
    return found


def _shot(
    title: str, picture: Radiograph, view: XRayView, seen: Floats, made: Floats, torso: TorsoModel, state: TorsoState
) -> Shot:
    measured, simulated = (np.asarray(view.pixels(view.from_patient_plane(z))) for z in (seen, made))
    return Shot(title, picture.pixels, pixel_mm(view), measured, simulated, bone_shadow(torso, state, view))


def bone_shadow(torso: TorsoModel, state: TorsoState, view: XRayView) -> Floats:
    """(h, w) from 0 to 1: how much of spine, ribs and pelvis lies along the ray of each pixel of a coarser picture."""
    small = coarser(view, SHADOW_STEP)
    lengths = np.zeros(small.shape)
    for bone, name in enumerate(torso.bone_names):
        if not name.startswith(LEFT_OUT):
            path_length(torso.surface_positions(state, bone), torso.bone_surfaces[bone].faces, small, lengths)
    return np.clip(lengths / BONE_MM, 0.0, 1.0)
