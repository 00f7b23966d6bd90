"""What is marked in a subject's radiographs, held against what they show, and that no radiograph counts twice."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np

from spinestiff.errors import SubjectError
from spinestiff.imaging.projection import XRayView
from spinestiff.imaging.radiograph import Radiograph
from spinestiff.subject.annotated_points import image_corners, image_pedicles, image_supports
from spinestiff.subject.folder import Subject, open_push, read_rest, read_view
from spinestiff.subject.image_names import rest_image
from spinestiff.subject.marker_table import read_markers
from spinestiff.subject.records import SUBJECT_FILE, PushRecord


def check_marks(subject: Subject) -> None:
    """Read each radiograph and each table of markers of a subject, and raise SubjectError for what no step takes of
    what is marked.

    Raises
    ------
    SubjectError : as ``annotated_points.image_corners``, ``image_pedicles`` and ``image_supports``; radiographs of
        another number or kind, or one that two pushes use under load; as ``marker_table.read_markers``.
    RadiographError : a radiograph that can't be read.
    """
    for which in subject.rest_views:
        check_marks_in(subject, (rest_image(which),), read_rest(subject, which).view)
    seen: dict[str, tuple[str, str]] = {}
    for push in subject.pushes:
        frames = open_push(subject, push)
        check_marks_in(subject, frame_names(push), frames[0].view)
        read_markers(subject, push, frames[0].view)
        _check_own(subject, push, frames, seen)
        for view in push.views:
            names = tuple(push.view_image(frame, view.id) for frame in view.frames)
            check_marks_in(subject, names, read_view(subject, push, view)[0].view)


def check_marks_in(subject: Subject, names: Sequence[str], view: XRayView) -> None:
    """Raise SubjectError for what no step takes of the marks in these images, which all lie as ``view`` says.

    Images without marks are passed by. A further view from which the patient was turned counts as not turned: that
    exchanges no sides.
    """
    for name in names:
        if name in subject.annotation.images:
            image_corners(subject, name, view)
            image_pedicles(subject, name, view)
            image_supports(subject, name, view)


def _check_own(
    subject: Subject, push: PushRecord, frames: Sequence[Radiograph], seen: dict[str, tuple[str, str]]
) -> None:
    """Raise SubjectError where a radiograph under load is another push's, too; ``seen``: hash -> push, and which."""
    for number, (force, role) in enumerate(zip(push.forces_n, push.roles)):
        if force > 0.0 and role != "unused":
            pixels, name = frames[number].pixels, f"push '{push.id}' frame {number}"
            key = hashlib.sha256(f"{pixels.shape}".encode() + np.ascontiguousarray(pixels).tobytes()).hexdigest()
            other, which = seen.setdefault(key, (push.id, name))
            if other != push.id:
                raise SubjectError(
                    f"{subject.folder / SUBJECT_FILE}: {name} is the same picture as {which}, and would count twice; "
                    "leave one of the two out"
                )


def frame_names(push: PushRecord) -> tuple[str, ...]:
    """Names in the annotation of all frames of a push, the first one's, which has to be marked, first."""
    return tuple(push.frame_image(frame) for frame in range(len(push.forces_n)))
