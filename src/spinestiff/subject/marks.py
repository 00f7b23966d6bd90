"""What is marked in a subject's radiographs, held against what they show: where it lies, and which way round it is."""

from __future__ import annotations

from collections.abc import Sequence

from spinestiff.imaging.projection import XRayView
from spinestiff.subject.folder import (
    Subject,
    image_corners,
    image_pedicles,
    open_push,
    read_rest,
    read_view,
)
from spinestiff.subject.records import PushRecord


def check_marks(subject: Subject) -> None:
    """Read each radiograph of a subject and raise SubjectError for what no step takes of the marks in it.

    Raises
    ------
    SubjectError : as ``folder.image_corners`` and ``folder.image_pedicles``; radiographs of another number or kind.
    RadiographError : a radiograph that can't be read.
    """
    for which in subject.rest_views:
        check_marks_in(subject, (f"rest/{which}",), read_rest(subject, which).view)
    for push in subject.pushes:
        check_marks_in(subject, frame_names(push), open_push(subject, push)[0].view)
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


def frame_names(push: PushRecord) -> tuple[str, ...]:
    """Names in the annotation of all frames of a push, the first one's, which has to be marked, first."""
    return tuple(push.frame_image(frame) for frame in range(len(push.forces_n)))
