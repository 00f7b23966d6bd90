"""Markers on the skin under a push: the table of their places, read strictly (docs/subject-folder.md).

A row a marker and frame. Nothing is filled in: a marker has a row in every frame, an empty one where it was not seen.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from spinestiff.anatomy.axes import MM, body_axes
from spinestiff.arrays import Floats
from spinestiff.errors import SubjectError
from spinestiff.files import read_text, write_text
from spinestiff.formats import parse_csv, plain_number
from spinestiff.imaging.projection import XRayView
from spinestiff.subject.annotated_points import check_inside
from spinestiff.subject.folder import Subject
from spinestiff.subject.outcomes import MarkerTracks
from spinestiff.subject.record_reading import WANTED_MARKER
from spinestiff.subject.records import MARKER_NAME, SUBJECT_FILE, MarkersRecord, PushRecord
from spinestiff.words import counted, printable

COLUMNS = ("marker", "frame", "x", "y", "z")
FEWEST, MOST = 3, 60
LARGEST_BYTES = 2**20
MOST_MOVED_MM = 150.0
"""Of a marker from the unloaded frame: twice what anybody's trunk does under a push."""


def read_markers(subject: Subject, push: PushRecord, view: XRayView) -> MarkerTracks | None:
    """The markers of a push in mm along the body's axes, and where the radiograph shows them; None without markers.

    Parameters
    ----------
    view : nominal, of the push's radiographs.

    Raises
    ------
    SubjectError : the table can't be read; markers or frames that are missing, twice there or move too far; ``shown``
        names no marker, or a place outside the picture.
    """
    record = push.markers
    if record is None:
        return None
    path = subject.folder / record.file
    names, places = _table(path, len(push.forces_n))
    axes = body_axes(record.axes.left, record.axes.up, record.axes.front)
    places = MM[record.unit] * places @ axes.T
    _check_motion(path, names, places, push.unloaded, record)
    where = f"{subject.folder / SUBJECT_FILE}: push '{push.id}': markers.shown"
    for name, pixel in record.shown.items():
        if name not in names:
            raise SubjectError(f"{where}: names '{name}', which {record.file} has not; wanted one of {_some(names)}")
        check_inside(where, "marker", np.array([pixel]), view, "leave out a marker that is not in it")
    return MarkerTracks.model_validate(
        {
            "names": names,
            "reference": push.unloaded,
            "side": record.side,
            "shown_px": {name: list(pixel) for name, pixel in record.shown.items()},
            "frames": [
                [None if np.isnan(place).any() else place.round(4).tolist() for place in frame] for frame in places
            ],
        }
    )


def marker_names(path: Path, frames: int) -> tuple[str, ...]:
    """Names of the markers in a table of a push with so many frames. Raises SubjectError as ``read_markers``."""
    return _table(path, frames)[0]


def write_markers(path: Path, names: tuple[str, ...], places: Floats) -> None:
    """Write a table of places (frames, M, 3); NaN: not seen."""
    lines = [",".join(COLUMNS)]
    for frame, there in enumerate(places):
        for name, place in zip(names, there):
            texts = ["", "", ""] if np.isnan(place).any() else [f"{value:.3f}" for value in place]
            lines.append(",".join([name, str(frame), *texts]))
    write_text(path, "\n".join(lines) + "\n")


def _table(path: Path, frames: int) -> tuple[tuple[str, ...], Floats]:
    """Names, and places (frames, M, 3) as written; NaN: not seen."""
    found: dict[tuple[str, int], list[float]] = {}
    for line, (name, frame, *place) in parse_csv(
        read_text(path, LARGEST_BYTES), str(path), COLUMNS, numbers=("x", "y", "z")
    ):
        where = f"{path}: row {line}"
        if not re.fullmatch(MARKER_NAME, name):
            raise SubjectError(f"{where}: found marker {name[:40]!r}, wanted {WANTED_MARKER}")
        if not re.fullmatch(r"[0-9]{1,4}", frame) or int(frame) >= frames:
            raise SubjectError(
                f"{where}: found frame {frame[:40]!r}, but the push has {counted(frames, 'frame')}, counted from 0"
            )
        key = (name, int(frame))
        if key in found:
            raise SubjectError(f"{where}: marker '{name}' is there twice in frame {int(frame)}; wanted it once")
        found[key] = _numbers(where, place)
    names = tuple(dict.fromkeys(name for name, _ in found))
    if not FEWEST <= len(names) <= MOST:
        raise SubjectError(f"{path}: found {counted(len(names), 'marker')}, wanted {FEWEST} to {MOST}")
    for name in names:
        lacking = [frame for frame in range(frames) if (name, frame) not in found]
        if lacking:
            raise SubjectError(
                f"{path}: marker '{name}' has no row for frame {lacking[0]}; wanted one for each of the push's "
                f"{counted(frames, 'frame')}, with x, y and z empty where it was not seen"
            )
    return names, np.array([[found[name, frame] for name in names] for frame in range(frames)])


def _numbers(where: str, texts: list[str]) -> list[float]:
    if not any(texts):
        return [math.nan] * 3
    numbers = [plain_number(text) for text in texts]
    if not all(map(math.isfinite, numbers)):
        raise SubjectError(
            f"{where}: found x,y,z {printable(','.join(texts))}, wanted three finite numbers, or all three empty"
        )
    return numbers


def _check_motion(path: Path, names: tuple[str, ...], places: Floats, start: int, record: MarkersRecord) -> None:
    unseen = np.isnan(places[start]).any(1)
    if unseen.any():
        raise SubjectError(
            f"{path}: marker '{names[int(np.argmax(unseen))]}' is not seen in frame {start}, the one without force "
            "from which motion counts; leave the marker out"
        )
    moved = np.nan_to_num(np.linalg.norm(places - places[start], axis=-1))
    frame, worst = np.unravel_index(int(np.argmax(moved)), moved.shape)
    if moved[frame, worst] > MOST_MOVED_MM:
        raise SubjectError(
            f"{path}: marker '{names[worst]}' moves by {moved[frame, worst]:.0f} mm from frame {start} to frame "
            f"{frame}, wanted at most {MOST_MOVED_MM:g} mm; check the unit ({record.unit}) and whether names were "
            "swapped"
        )


def _some(names: tuple[str, ...]) -> str:
    return ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
