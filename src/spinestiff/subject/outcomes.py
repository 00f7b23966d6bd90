"""What the radiographs show before a torso is made of them, as files in ``results/``: tracking, frames, responses.

``run_record`` writes and reads them; what later steps find has a module a step, e.g. ``estimate_outcome``.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import degrees, pi
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from spinestiff.arrays import Floats, Ints
from spinestiff.imaging.features import VertebraCorners
from spinestiff.imaging.pedicles import PediclePoints
from spinestiff.imaging.projection import XRayView
from spinestiff.imaging.tracking import SupportMotion
from spinestiff.subject.outcome_parts import Outcome, OutcomeFile, Pair, Vector, ViewRecord
from spinestiff.subject.records import Role, VertebraName


class Measured(Outcome):
    """A measured value with its standard error."""

    value: float
    sd: Annotated[float, Field(gt=0.0)]

    def scaled(self, factor: float) -> Measured:
        """The same in another unit."""
        return Measured(value=self.value * factor, sd=self.sd * factor)


class TrackedFrame(Outcome):
    """One frame of a push. Of supports everything is measured from the push's first frame.

    Attributes
    ----------
    force_n : as files of earlier versions have it; forces are those of ``subject.json``.
    corners_px : (Nv, 4, 2) column, row. quality : (Nv, 4), from 0 to 1.
    support_motion_mm : by support, where it is seen; of a shoulder only across its wall.
    obliquity_deg : turn of the pelvis about the AP axis, +z; above 0 the patient's left side rises. None in the first
        frame, and where fewer than two points of the pelvis are seen.
    shoulder_mm : the shoulder's motion to the patient's left, +x, at the patient plane; None in the first frame, and
        where it is not seen.
    support_note : what moved by more than the paper allows ("the pelvis moved by 3.4 mm, obliquity +2.1 degrees").
    """

    force_n: float | None = None
    corners_px: tuple[tuple[Pair, Pair, Pair, Pair], ...]
    quality: tuple[tuple[float, float, float, float], ...]
    support_motion_mm: dict[str, float] = Field(default_factory=dict)
    obliquity_deg: Measured | None = None
    shoulder_mm: Measured | None = None
    support_note: str = ""

    @property
    def obliquity(self) -> Measured | None:
        """``obliquity_deg`` in rad."""
        return None if self.obliquity_deg is None else self.obliquity_deg.scaled(pi / 180.0)


class MarkedPedicles(Outcome):
    """Pedicles that a person marked in a push's frame: of each vertebra the left and the right one, column, row."""

    frame: int
    vertebrae: tuple[VertebraName, ...]
    centres_px: tuple[tuple[Pair, Pair], ...]

    def points(self, view: XRayView) -> PediclePoints:
        """In mm on the detector of the frame's view."""
        return PediclePoints(self.vertebrae, view.from_pixels(np.array(self.centres_px)))


class SidePicture(Outcome):
    """A frame's radiograph from another side, as a person marked it or as tracking followed it.

    Attributes
    ----------
    frame : of the push. vertebrae : (Nv,) names, head to foot. corners_px : (Nv, 4, 2) column, row.
    quality : (Nv, 4), from 0 to 1, of corners that were followed; None: set by hand.
    followed_from : the frame from which they were, the nearest of those marked by hand; None: set by hand.
    pedicles : marked in it; None without.
    """

    frame: int
    vertebrae: tuple[VertebraName, ...]
    corners_px: tuple[tuple[Pair, Pair, Pair, Pair], ...]
    quality: tuple[tuple[float, float, float, float], ...] | None = None
    followed_from: int | None = None
    pedicles: MarkedPedicles | None = None

    @model_validator(mode="after")
    def _is_one_of_two(self) -> Self:
        if (self.quality is None) != (self.followed_from is None):
            raise ValueError("quality, followed_from: wanted both, of corners that were followed, or none")
        if len(self.corners_px) != len(self.vertebrae):
            raise ValueError(f"corners_px: {len(self.corners_px)} for {len(self.vertebrae)} vertebrae")
        if self.quality is not None and len(self.quality) != len(self.vertebrae):
            raise ValueError(f"quality: {len(self.quality)} for {len(self.vertebrae)} vertebrae")
        return self


class SideView(Outcome):
    """A push's radiographs from another side.

    Attributes
    ----------
    id : as in ``subject.json``. view : nominal. millimetres : where they come from.
    pictures : in the order of their frames.
    """

    id: str
    view: ViewRecord
    millimetres: dict[str, str] = Field(default_factory=dict)
    pictures: tuple[SidePicture, ...]

    def corners(self, picture: SidePicture) -> VertebraCorners:
        """In mm on the detector, with their quality."""
        places = self.view.view().from_pixels(np.array(picture.corners_px))
        if picture.quality is None:
            return VertebraCorners(picture.vertebrae, places)
        return VertebraCorners(picture.vertebrae, places, np.array(picture.quality))


class MarkerTracks(Outcome):
    """Markers on the skin under a push, as their table has them.

    Attributes
    ----------
    names : (M,). reference : the frame without force from which motion counts.
    side : of the trunk. shown_px : where that frame's radiograph shows them, column and row, by name.
    frames : of each, (M,) mm along the body's left, up and front, from the cameras' origin; None: not seen.
    """

    names: tuple[str, ...]
    reference: int
    side: Literal["front", "back", "both"]
    shown_px: dict[str, Pair]
    frames: tuple[tuple[Vector | None, ...], ...]

    @property
    def positions(self) -> Floats:
        """(frames, M, 3) mm; NaN: not seen."""
        return np.array([[(np.nan,) * 3 if place is None else place for place in frame] for frame in self.frames])

    @property
    def shown(self) -> tuple[Ints, Floats]:
        """Numbers (S,) of the markers that the radiograph shows, and where, (S, 2) column, row."""
        rows = np.array([self.names.index(name) for name in self.shown_px], dtype=np.int64)
        return rows, np.array(list(self.shown_px.values()))


class TrackedPush(Outcome):
    """A push as tracked.

    Attributes
    ----------
    view : nominal, of its frames. millimetres : where they come from.
    vertebrae : (Nv,) names, head to foot.
    annotated_frames : those whose corners a person set.
    frames : one a radiograph.
    pedicles : as marked, by frame; they are not tracked. sides : the same frames from other sides.
    markers : on the skin, in the same frames; None without.
    """

    view: ViewRecord
    millimetres: dict[str, str] = Field(default_factory=dict)
    vertebrae: tuple[VertebraName, ...]
    annotated_frames: tuple[int, ...] = ()
    frames: tuple[TrackedFrame, ...]
    pedicles: tuple[MarkedPedicles, ...] = ()
    sides: tuple[SideView, ...] = ()
    markers: MarkerTracks | None = None

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        for index, frame in enumerate(self.frames):
            for what, found in (("corners_px", frame.corners_px), ("quality", frame.quality)):
                if len(found) != len(self.vertebrae):
                    raise ValueError(f"frames[{index}].{what}: {len(found)} for {len(self.vertebrae)} vertebrae")
        if not self.frames:
            raise ValueError("frames: found none, wanted one a radiograph")
        if self.markers is not None and len(self.markers.frames) != len(self.frames):
            raise ValueError(f"markers.frames: {len(self.markers.frames)} for {len(self.frames)} radiographs")
        return self

    @classmethod
    def of(
        cls,
        view: XRayView,
        tracked: Sequence[VertebraCorners],
        supports: Sequence[SupportMotion] = (),
        **said: object,
    ) -> Self:
        """The record of a push from its frames' corners on the detector, mm.

        Parameters
        ----------
        supports : what was seen of pelvis and shoulder in these frames.
        said : ``millimetres``, ``annotated_frames``, ``pedicles``, ``sides`` and ``markers``.
        """
        frames = [
            {
                "corners_px": view.pixels(corners.corners).round(3).tolist(),
                "quality": corners.quality.round(3).tolist(),
                "support_motion_mm": {m.name: round(float(m.distance[i]), 3) for m in supports if m.seen[i]},
                "support_note": "; ".join(notes[i] for notes in (m.notes() for m in supports) if i in notes),
                **(_support_places(supports, i) if i > 0 else {}),
            }
            for i, corners in enumerate(tracked)
        ]
        return cls.model_validate(
            {"view": ViewRecord.of(view), "vertebrae": tracked[0].vertebrae, "frames": frames, **said}
        )

    def corners(self, frame: int) -> VertebraCorners:
        """The corners of a frame in mm on the detector, with their quality."""
        found = self.frames[frame]
        return VertebraCorners(
            self.vertebrae, self.view.view().from_pixels(np.array(found.corners_px)), np.array(found.quality)
        )


def _support_places(supports: Sequence[SupportMotion], frame: int) -> dict[str, Measured]:
    """Where a frame shows pelvis and shoulder, as ``TrackedFrame`` has it."""
    found = {}
    for motion in supports:
        if motion.name == "pelvis" and motion.turn_seen[frame]:
            turn, sd = (round(degrees(angle[frame]), 4) for angle in (motion.turn, motion.turn_error))
            found["obliquity_deg"] = Measured(value=turn, sd=sd)
        if motion.name == "shoulder" and motion.seen[frame]:
            across, sd = (round(float(part), 3) for part in (motion.displacement[frame, 0], motion.error[frame]))
            found["shoulder_mm"] = Measured(value=across, sd=sd)
    return found


class Tracked(OutcomeFile):
    """``tracked.json``: the vertebra corners of every frame, by push."""

    FILE: ClassVar[str] = "tracked.json"
    STEP: ClassVar[str] = "track"
    pushes: dict[str, TrackedPush]


class FrameProposal(Outcome):
    """What a frame is good for (``spinestiff frames``), and the role that is proposed beside the one it has."""

    push: str
    side: Literal["left", "right"]
    level: float
    frame: int
    force_n: float
    sharpness: float | None
    contrast_to_noise: float | None
    saturated: float | None
    vertebrae: int
    tracking_mm: float | None
    supports: dict[str, dict[Literal["mm", "degrees"], float | None]]
    role: Role
    proposed: Role
    reason: str


class FrameProposals(OutcomeFile):
    """``frames.json``: every frame's quality and proposed role."""

    FILE: ClassVar[str] = "frames.json"
    STEP: ClassVar[str] = "frames"
    frames: tuple[FrameProposal, ...]


class ForcePerDegree(Outcome):
    """N per degree of an angle under one push, its size without a sign.

    Attributes
    ----------
    value : None = the angle did not change beyond its errors, so that only ``low`` is known.
    low, high : 95 % interval; ``high`` is None where ``value`` is.
    """

    value: float | None
    low: float
    high: float | None


class AngleResponse(Outcome):
    """How an angle between two fixed vertebrae answers a push (``curves.response``).

    Attributes
    ----------
    levels : upper and lower vertebra. frames : that it was read in.
    rest_deg : without force, signed. change_deg, change_sd_deg : from there to the largest force, by the corners.
    n_per_degree : over all these frames.
    scatter : of the frames about a straight line over the force, over what their errors explain; above 1 it has
        widened the interval. None with a single loaded frame.
    """

    levels: tuple[VertebraName, VertebraName]
    frames: tuple[int, ...]
    rest_deg: float
    change_deg: float
    change_sd_deg: float
    n_per_degree: ForcePerDegree
    scatter: float | None


class Flexibility(Outcome):
    """By how much of itself the curve became smaller under the largest force; below 0 it grew.

    Attributes
    ----------
    percent, low, high : with the 95 % interval. None where the curve at rest does not stand out from its errors.
    """

    percent: float | None
    low: float | None
    high: float | None


class PushResponse(Outcome):
    """What one push says without a model.

    Attributes
    ----------
    force_n : the largest in a frame that shows the curve's end vertebrae.
    tilt : of the largest change of tilt between two vertebrae, chosen at that force.
    curve : of the Cobb angle between the end vertebrae of the rest picture's largest angle.
    instead_of : those end vertebrae where too few frames show both, so that ``curve`` is between others.
    missing : why there are no numbers, or empty.
    """

    force_n: float
    tilt: AngleResponse | None = None
    curve: AngleResponse | None = None
    flexibility: Flexibility | None = None
    instead_of: tuple[VertebraName, VertebraName] | None = None
    missing: str = ""

    @model_validator(mode="after")
    def _says_why(self) -> Self:
        if (None in (self.tilt, self.curve, self.flexibility)) != bool(self.missing):
            raise ValueError("missing: wanted a reason where there are no numbers, and only there")
        return self


class Responses(OutcomeFile):
    """``response.json``: what each push says without a model, and the gauge's errors assumed (standard deviations)."""

    FILE: ClassVar[str] = "response.json"
    STEP: ClassVar[str] = "response"
    gauge_scale_sd: float
    gauge_zero_sd_n: float
    pushes: dict[str, PushResponse]
