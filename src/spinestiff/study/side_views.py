"""What was marked in the frames of a push and in its radiographs from other sides, and what is followed from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from spinestiff.errors import TrackingError
from spinestiff.imaging.features import VertebraCorners
from spinestiff.imaging.projection import XRayView
from spinestiff.imaging.tracking import track
from spinestiff.personalise.pose import posed
from spinestiff.subject.annotated_points import image_corners, image_pedicles
from spinestiff.subject.folder import Subject, read_view
from spinestiff.subject.outcome_parts import ViewRecord
from spinestiff.subject.outcomes import MarkedPedicles, SidePicture, SideView
from spinestiff.subject.records import PushRecord

if TYPE_CHECKING:
    from spinestiff.imaging.radiograph import Radiograph


def marked_pedicles(subject: Subject, push: PushRecord, view: XRayView) -> list[MarkedPedicles]:
    """Of the frames of a push in which a person marked any. Raises SubjectError as ``image_pedicles``."""
    found = []
    for frame in range(len(push.forces_n)):
        if push.frame_image(frame) in subject.annotation.images:
            marked = _pedicles(subject, push.frame_image(frame), view, frame)
            if marked is not None:
                found.append(marked)
    return found


def side_views(subject: Subject, push: PushRecord) -> list[SideView]:
    """The radiographs of a push from other sides, read and with what was marked in them.

    Corners that nobody marked in a radiograph are followed from those of its view that somebody did.

    Raises
    ------
    SubjectError, RadiographError : they can't be read, or what was marked is no picture of vertebrae.
    TrackingError : corners can't be followed.
    """
    found = []
    for record in push.views:
        radiographs = read_view(subject, push, record)
        view = posed(radiographs[0].view, np.zeros(2), 0.0, float(np.deg2rad(record.turned_deg)))
        order = sorted(range(len(record.frames)), key=lambda number: record.frames[number])
        frames = [record.frames[number] for number in order]
        names = [push.view_image(frame, record.id) for frame in frames]
        marked = {
            number: image_corners(subject, name, view)
            for number, name in enumerate(names)
            if name in subject.annotation.images
        }
        corners = followed_view(
            [radiographs[number] for number in order], marked, f"push '{push.id}' view '{record.id}'"
        )
        pictures = []
        for number, (frame, name) in enumerate(zip(frames, names)):
            said: dict[str, object] = {
                "frame": frame,
                "vertebrae": corners[number].vertebrae,
                "corners_px": view.pixels(corners[number].corners).round(3).tolist(),
            }
            if number in marked:
                said["pedicles"] = _pedicles(subject, name, view, frame)
            else:
                said["quality"] = corners[number].quality.round(3).tolist()
                said["followed_from"] = frames[min(marked, key=lambda other: abs(other - number))]
            pictures.append(SidePicture.model_validate(said))
        millimetres = dict(radiographs[0].provenance)
        found.append(
            SideView(id=record.id, view=ViewRecord.of(view), millimetres=millimetres, pictures=tuple(pictures))
        )
    return found


def followed_view(
    frames: Sequence[Radiograph], marked: Mapping[int, VertebraCorners], label: str
) -> Sequence[VertebraCorners]:
    """Corners in each radiograph of a view, in order of the push's frames: as marked, else followed by ``track``.

    Raises
    ------
    TrackingError : as ``track``, with what to do.
    """
    if len(marked) == len(frames):
        return [marked[number] for number in range(len(frames))]
    try:
        tracked = track(frames, marked)
    except TrackingError as error:
        raise TrackingError(f"{label}: {error}; or mark the corners in each of its radiographs") from None
    # A frame that somebody marked has just what was marked in it.
    return [marked.get(number, corners) for number, corners in enumerate(tracked)]


def _pedicles(subject: Subject, name: str, view: XRayView, frame: int) -> MarkedPedicles | None:
    names, points = image_pedicles(subject, name, view)
    if not names:
        return None
    return MarkedPedicles.model_validate(
        {"frame": frame, "vertebrae": names, "centres_px": view.pixels(points).round(3).tolist()}
    )
