"""Corners followed through a push while somebody looks on: in the background, from every frame that is annotated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from threading import Lock, Thread
from typing import Any, Literal

from spinestiff.annotate.radiographs import image_of
from spinestiff.annotate.session import AnnotationSession
from spinestiff.errors import SpinestiffError, SubjectError
from spinestiff.imaging.features import VertebraCorners
from spinestiff.imaging.radiograph import Radiograph
from spinestiff.imaging.tracking import OnFrame, track
from spinestiff.subject.annotated_points import push_corners
from spinestiff.subject.folder import Subject, read_subject
from spinestiff.subject.image_names import PUSH
from spinestiff.subject.outcomes import Tracked
from spinestiff.subject.run_record import changed_inputs, read_outcome
from spinestiff.words import push_named, sentence


@dataclass(frozen=True)
class Following:
    """How far the tracking of a push has come.

    Attributes
    ----------
    state : of the last run. done, total : frames.
    error : why it failed, in one line.
    frames : corners of each frame, mm on the detector; empty until done.
    """

    state: Literal["none", "running", "done", "failed"] = "none"
    done: int = 0
    total: int = 0
    error: str = ""
    frames: tuple[VertebraCorners, ...] = field(default=())


@dataclass(frozen=True)
class _Run:
    """A run from the marks ``starts``, by name of the frame."""

    number: int
    starts: Mapping[str, object]
    found: Following


class Follower:
    """Runs of tracking in the background, one at a time a push; a new start replaces a run that goes on."""

    def __init__(self, session: AnnotationSession) -> None:
        self.session = session
        self._lock = Lock()
        self._runs: dict[str, _Run] = {}

    def state(self, image: str) -> Following:
        """How far the tracking of a push from the present marks has come; without a run from these, what
        ``spinestiff track`` last found."""
        with self._lock:
            run = self._runs.get(image)
        if run is not None and run.starts == _starts(self.session.annotated(), image):
            return run.found
        return self._stored(image)

    def _stored(self, image: str) -> Following:
        folder = self.session.subject.folder
        try:
            subject = read_subject(folder)
            if changed_inputs(subject, "track"):
                return Following()
            pushes = read_outcome(subject, Tracked).pushes
        except SpinestiffError:
            return Following()
        tracked = pushes.get(image.removeprefix(PUSH))
        if tracked is None:
            return Following()
        frames = tuple(tracked.corners(frame) for frame in range(len(tracked.frames)))
        return Following("done", len(frames), len(frames), frames=frames)

    def start(self, image: str) -> Following:
        """Start from the marks as they are now.

        Raises
        ------
        SubjectError : no push, or its first frame is not complete yet.
        """
        if not image.startswith(PUSH):
            raise SubjectError(f"{image} is no push; there is nothing to track")
        frames = self.session.radiographs.frames(image)
        subject = self.session.annotated()
        push = subject.push(image.removeprefix(PUSH))
        if image not in _starts(subject, image):
            lines = self.session.judge.missing(self.session.marks)
            why = next((line.removeprefix(f"{image}: ") for line in lines if line.startswith(f"{image}: ")), "no marks")
            name = sentence(push_named(push.id))
            raise SubjectError(f"{name} can't be tracked before its first frame is complete: {why}")
        annotated = push_corners(subject, push, self.session.radiographs.view(image))
        with self._lock:
            number = self._runs[image].number + 1 if image in self._runs else 1
            running = Following("running", 0, len(frames))
            self._runs[image] = _Run(number, _starts(subject, image), running)
        Thread(target=self._run, args=(image, number, frames, annotated), daemon=True).start()
        return running

    def _run(
        self, image: str, number: int, frames: Sequence[Radiograph], annotated: Mapping[int, VertebraCorners]
    ) -> None:
        def report(found: Following) -> None:
            with self._lock:
                if self._runs[image].number != number:
                    raise _Replaced
                self._runs[image] = replace(self._runs[image], found=found)

        def progress(done: int, total: int) -> None:
            report(Following("running", done, total))

        try:
            tracked = follow(frames, annotated, progress)
            report(Following("done", len(frames), len(frames), frames=tracked))
        except _Replaced:
            return
        except SpinestiffError as error:
            self._fail(image, number, str(error))
        except Exception:
            self._fail(image, number, "tracking broke down; see the terminal")
            raise

    def _fail(self, image: str, number: int, why: str) -> None:
        with self._lock:
            if self._runs[image].number == number:
                self._runs[image] = replace(self._runs[image], found=Following("failed", error=why))


class _Replaced(Exception):
    """A newer run has taken over."""


def follow(
    frames: Sequence[Radiograph], annotated: Mapping[int, VertebraCorners], observer: OnFrame
) -> tuple[VertebraCorners, ...]:
    """Corners in every frame from the annotated ones."""
    return track(frames, annotated, observer)


def _starts(subject: Subject, image: str) -> Mapping[str, object]:
    """What a push is followed from: the vertebrae of its annotated frames, by name."""
    images = subject.annotation.images if subject.annotation else {}
    return {name: one.vertebrae for name, one in images.items() if image_of(name) == image and one.vertebrae}


def following_record(session: AnnotationSession, image: str, found: Following) -> dict[str, Any]:
    """As JSON, corners in pixels."""
    view = session.radiographs.view(image)
    frames = []
    for corners in found.frames:
        quads = view.pixels(corners.corners).round(2)
        frames.append(
            {
                "vertebrae": {name: quad.tolist() for name, quad in zip(corners.vertebrae, quads)},
                "quality": {name: q.round(3).tolist() for name, q in zip(corners.vertebrae, corners.quality)},
            }
        )
    return {"state": found.state, "done": found.done, "total": found.total, "error": found.error, "frames": frames}
