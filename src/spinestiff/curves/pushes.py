"""Cobb angles of a subject's images, at rest and in every frame of its pushes, and the N per degree of each push."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from spinestiff.curves.changes import change_between, forms_in_words, tracked_noise
from spinestiff.curves.cobb import CobbReading, Definition, read_cobb_of_view
from spinestiff.curves.response import GAUGE, FrameCorners, GaugeError, push_response
from spinestiff.curves.tilts import NO_SDS, CobbChange, Forms, tilts
from spinestiff.errors import SpinestiffError, SubjectError
from spinestiff.imaging.features import VertebraCorners, picture_axes
from spinestiff.imaging.projection import XRayView
from spinestiff.imaging.tracking.quality import usable_corners
from spinestiff.subject.annotated_points import image_corners
from spinestiff.subject.folder import Subject, read_rest
from spinestiff.subject.image_names import FRONTAL
from spinestiff.subject.outcomes import Responses, Tracked, TrackedPush
from spinestiff.subject.records import PushRecord, SubjectRecord
from spinestiff.subject.run_record import read_outcome, refuse_changed


@dataclass(frozen=True)
class CobbFrame:
    """One frontal image of a subject with its Cobb angles; of a push's frames the change from its least force."""

    reading: CobbReading
    change: CobbChange | None = None

    def as_dict(self) -> dict[str, object]:
        """JSON of the frame: that of the reading and "change_deg", the three forms of the change with their levels."""
        c = self.change
        change = None if c is None else {
            "signed": c.signed, "fixed_levels": c.fixed_levels, "tilt": c.tilt,
            "levels": list(c.levels), "tilt_levels": list(c.tilt_levels),
            "sds": None if c.sds == NO_SDS else c.sds._asdict(),
        }  # fmt: skip
        return {**self.reading.as_dict(), "change_deg": change}


def rest_reading(subject: Subject, definition: Definition = "endplate", noise_px: float | None = None) -> CobbReading:
    """The Cobb angles of the annotated frontal rest image. Raises SubjectError as ``image_corners`` does."""
    rest = read_rest(subject, "frontal")
    corners = image_corners(subject, FRONTAL, rest.view)
    return reading_of(FRONTAL, corners, rest.view, definition, noise_px)


def cobb_frames(
    subject: Subject, definition: Definition = "endplate", noise_px: float | None = None
) -> list[CobbFrame]:
    """The annotated rest image and, once they are tracked, all frames of the pushes.

    A frame that shows no curve, since fewer than two vertebrae were followed, is refused with the reason.

    Parameters
    ----------
    definition : "endplate" or "midline".
    noise_px : standard deviation of each annotated corner's coordinates; None = 2 % of the vertebrae's median width.

    Raises
    ------
    SubjectError : as ``rest_reading``, ``read_outcome`` and ``frame_forces``; marks or radiographs of the pushes have
        changed since they were tracked.
    """
    frames = [CobbFrame(rest_reading(subject, definition, noise_px))]
    if not (subject.results / Tracked.FILE).exists():
        return frames
    refuse_changed(subject, "track")
    for push, found in read_outcome(subject, Tracked).pushes.items():
        forces, view = frame_forces(subject.push(push), found), found.view.view()
        noise = _noise_mm(noise_px, view, view.magnification)
        usable = [usable_corners(found.corners(i)) for i in range(len(found.frames))]
        shown = [index for index, corners in enumerate(usable) if len(corners) > 1]
        least = min(shown, key=lambda index: forces[index], default=0)
        for index, force in enumerate(forces):
            alike = annotated_frame(found, least) == annotated_frame(found, index)
            change = change_between(view, usable[least], usable[index], definition, alike, noise)
            name = f"{push} frame {index}, {force:.0f} N"
            try:
                reading = reading_of(name, usable[index], view, definition, noise_px)
            except SpinestiffError as error:
                reading = CobbReading(name, "refused", (str(error),), definition)
            frames.append(CobbFrame(reading, change))
    return frames


def frame_forces(push: PushRecord, found: TrackedPush) -> tuple[float, ...]:
    """The forces of a push's tracked frames, N, as its record has them by now.

    Raises
    ------
    SubjectError : another number of forces than of frames, since the record was changed after tracking.
    """
    if len(found.frames) != len(push.forces_n):
        raise SubjectError(
            f"push '{push.id}': {len(found.frames)} tracked frames for {len(push.forces_n)} forces_n; "
            "run spinestiff track again"
        )
    return push.forces_n


def annotated_frame(push: TrackedPush, frame: int) -> int:
    """From which frame's annotation a frame's corners come: the nearest one's, which weighs most."""
    return min(push.annotated_frames, key=lambda one: abs(one - frame), default=0)


def gauge_of(record: SubjectRecord) -> GaugeError:
    """The errors of a subject's gauge: ``force_scale`` and ``force_offset_n`` of its priors, or the usual ones."""
    given = record.priors
    return GaugeError(given.get("force_scale", GAUGE.scale), given.get("force_offset_n", GAUGE.zero_n))


def push_responses(subject: Subject, gauge: GaugeError | None = None, noise_px: float | None = None) -> Responses:
    """N per degree and flexibility of every push, from the tracked frames, by endplates; no model is asked.

    Parameters
    ----------
    gauge : its errors; those of the subject's ``priors`` if left out. noise_px : as ``cobb_frames``.

    Raises
    ------
    SubjectError : the pushes have not been tracked, or not as their record has them by now; the rest image can't be
        read.
    """
    gauge = gauge or gauge_of(subject.record)
    tracked = read_outcome(subject, Tracked).pushes
    at_rest = read_rest(subject, "frontal").view
    corners = image_corners(subject, FRONTAL, at_rest)
    rest = tilts(corners.vertebrae, corners.corners, at_rest)
    pushes = {}
    for name, found in tracked.items():
        frames, view = seen_frames(found, frame_forces(subject.push(name), found)), found.view.view()
        pushes[name] = push_response(frames, rest, gauge, _noise_mm(noise_px, view, view.magnification))
    return Responses(gauge_scale_sd=gauge.scale, gauge_zero_sd_n=gauge.zero_n, pushes=pushes)


def seen_frames(push: TrackedPush, forces_n: Sequence[float]) -> list[FrameCorners]:
    """The frames of a push as a clinician sees them, each with its force."""
    view = push.view.view()
    axes = np.stack(picture_axes(view), axis=1)
    found = []
    for index, force in enumerate(forces_n):
        corners = push.corners(index)
        origin = annotated_frame(push, index)
        points = view.to_patient_plane(corners.corners) @ axes
        found.append(FrameCorners(index, force, corners.vertebrae, points, corners.quality, origin))
    return found


def cobb_rows(frames: Sequence[CobbFrame]) -> list[tuple[str, str, str, str, str]]:
    """Image, Cobb angle, and the three forms of its change from the push's least force."""
    rows = []
    for frame in frames:
        forms = dict.fromkeys(Forms._fields, "") if frame.change is None else forms_in_words(frame.change)
        signed, fixed, tilt = (forms[name] for name in Forms._fields)
        rows.append((frame.reading.image, frame.reading.words(), signed, fixed, tilt))
    return rows


def reading_of(
    image: str,
    corners: VertebraCorners,
    view: XRayView,
    definition: Definition = "endplate",
    noise_px: float | None = None,
) -> CobbReading:
    """The Cobb angles of corners on the detector of a frontal view; tracked ones err as their quality says, too."""
    left, up = picture_axes(view)
    noise = _noise_mm(noise_px, view)
    tracking = np.where(corners.quality < 1.0, view.magnification * tracked_noise(corners.quality), 0.0)
    points = corners.corners @ np.stack([left, up], axis=1)
    return read_cobb_of_view(image, corners.vertebrae, points, definition, noise, tracking)


def _noise_mm(noise_px: float | None, view: XRayView, magnification: float = 1.0) -> float | None:
    """On the detector, or with the view's magnification at the patient plane."""
    return None if noise_px is None else noise_px * float(view.pixel_spacing.mean()) / magnification
