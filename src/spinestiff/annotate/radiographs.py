"""The radiographs of a subject folder by their names in its annotation, read when they are asked for and kept."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from threading import RLock

from spinestiff.curves.corner_files import Side
from spinestiff.errors import SubjectError
from spinestiff.imaging.dicom.tags import MissingValue
from spinestiff.imaging.features import picture_axes
from spinestiff.imaging.projection import XRayView
from spinestiff.imaging.radiograph import Radiograph
from spinestiff.subject.folder import Subject, check_image_name, open_push, read_rest, read_view
from spinestiff.subject.image_names import PushImage, frame_image, rest_view
from spinestiff.subject.records import REST_IMAGES, ScaleRecord

# Images whose frames stay in memory; a push of 1024 x 1024 has a few megabytes a frame.
KEPT = 3
STAND_IN = ScaleRecord(object_mm=6.0, object_px=((0.0, 0.0), (40.0, 0.0)), plane="detector")
"""A pixel 0.15 mm wide, where millimetres come from a vertebra still to be marked; no length is kept or shown."""
Pictures = tuple[tuple[str, int, int, int], ...]


class KeptRadiographs:
    """The radiographs of a subject; the last few images stay in memory."""

    def __init__(self, subject: Subject) -> None:
        self._subject = subject
        self._lock = RLock()
        self._frames: OrderedDict[str, Sequence[Radiograph]] = OrderedDict()
        self._views: dict[str, XRayView] = {}
        self._without_mm: set[str] = set()

    def frames(self, name: str) -> Sequence[Radiograph]:
        """The radiographs of an image by its name in the annotation; of a push all, whichever frame is named.

        Those of a large file are read one by one, when they are asked for.

        Raises
        ------
        SubjectError : no image of that name. RadiographError : see ``read_radiographs``.
        """
        check_image_name(self._subject, name)
        image = image_of(name)
        with self._lock:
            if image not in self._frames:
                self._frames[image] = self._read(image)
                while len(self._frames) > KEPT:
                    self._frames.popitem(last=False)
            self._frames.move_to_end(image)
            return self._frames[image]

    def view(self, name: str) -> XRayView:
        """The view of an image, kept for good: every change of a mark asks for it. Raises as ``frames``."""
        image = image_of(name)
        with self._lock:
            if image not in self._views:
                self._views[image] = self.frames(name)[0].view
            return self._views[image]

    def has_mm(self, name: str) -> bool:
        """Whether the millimetres of an image's view are its own, and no stand-in's. Raises as ``frames``."""
        with self._lock:
            self.view(name)
            return image_of(name) not in self._without_mm

    def forget(self) -> None:
        """Read all anew from now on."""
        with self._lock:
            self._without_mm.clear()
            self._frames.clear()
            self._views.clear()

    def _read(self, name: str) -> Sequence[Radiograph]:
        xray = self._subject.record.xray
        scale = (xray.scale or {}).get(name)
        if scale is None or scale.vertebra is None:
            return _frames_of(self._subject, name)
        # The vertebra whose width is known is marked here, so that the picture has to be shown without its millimetres.
        others = {key: one for key, one in (xray.scale or {}).items() if key != name}
        try:
            return _frames_of(self._scaled(others), name)
        except MissingValue:
            frames = _frames_of(self._scaled({**others, name: STAND_IN}), name)
            self._without_mm.add(name)
            return frames

    def _scaled(self, scale: dict[str, ScaleRecord]) -> Subject:
        xray = self._subject.record.xray.model_copy(update={"scale": scale})
        return replace(self._subject, record=self._subject.record.model_copy(update={"xray": xray}))


def pictures_on_disk(folder: Path) -> Pictures:
    """What tells the rest radiographs of a subject from others in their places, without reading them: of each that is
    there its name, number in the file system, size and time of change."""
    found = {name: folder / place for name, place in REST_IMAGES.items()}
    there = {name: path.stat() for name, path in found.items() if path.exists()}
    return tuple((name, one.st_ino, one.st_size, one.st_mtime_ns) for name, one in there.items())


def image_of(name: str) -> str:
    """The image that is read for a name of the annotation: of a push's later frame the push's."""
    of_push = PushImage.named(name)
    return frame_image(of_push.push) if of_push and of_push.later else name


def upright(view: XRayView) -> bool:
    """Whether the head is up in the picture."""
    return bool(picture_axes(view)[1][1] <= 0.0)


def first_on(view: XRayView) -> Side:
    """The side of the image where the patient's left, in a lateral image the front, is seen.

    Raises
    ------
    SubjectError : the radiograph stands on its head, for which files of other programs have no words.
    """
    if not upright(view):
        raise SubjectError("the radiograph stands on its head; such corners can't be exchanged")
    return "right" if picture_axes(view)[0][0] > 0.0 else "left"


def _frames_of(subject: Subject, name: str) -> Sequence[Radiograph]:
    of_push = PushImage.named(name)
    if of_push is None:
        return (read_rest(subject, rest_view(name)),)
    push = subject.push(of_push.push)
    if of_push.view is None:
        return open_push(subject, push)
    frame, view = subject.view(name)
    return (read_view(subject, push, view)[view.frames.index(frame)],)
