"""Which frames to train on and which to hold out (paper 2.1): a proposal from what was measured, with reasons in words.

The paper keeps two radiographs of a subject for estimation and one for validation: the best images in which neither
the shoulder nor the pelvis moved. Here each push may give that many, and a frame is judged by its picture alone: where
supports moved, their place is part of what a fit finds or is told. The largest force is held out, since that is the
hardest to predict. The user decides: a proposal changes nothing by itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from spinestiff.estimation.objective import FEWEST_VERTEBRAE
from spinestiff.imaging.image_quality import ImageQuality, image_quality
from spinestiff.imaging.radiograph import Radiograph
from spinestiff.imaging.tracking.quality import error_of, usable_corners
from spinestiff.subject.outcomes import TrackedFrame, TrackedPush
from spinestiff.subject.records import PushRecord, Role
from spinestiff.words import counted

BLURRED = 0.75
"""Sharpness below which a frame is left out. Drawn vertebrae that moved by 1, 2 and 4 mm have 0.91, 0.72 and 0.52."""
SLIGHTLY_BLURRED = 0.9
SATURATED = 0.05
"""Share of the vertebrae's pixels without a grey value of their own, above which a frame is left out."""
NOISY = 2.0
"""Contrast to noise below which a frame is called noisy."""
UNSURE_MM = 1.0
"""Median predicted error of tracked corners above which a frame is left out."""
SMALL_FORCE = 0.15
"""Share of a push's largest force below which a frame tells little about stiffness."""
SAME_FORCE = 0.08
"""Share of a push's largest force within which two frames show the same."""


@dataclass(frozen=True)
class Motion:
    """How a support moved since the push's first frame.

    Attributes
    ----------
    mm : at the patient plane, mean over the support's points; of a shoulder only across its wall (``SupportMotion``).
    degrees : the pelvis' obliquity, above 0 with the patient's left side up; None with fewer than two points seen.
    """

    mm: float
    degrees: float | None


@dataclass(frozen=True)
class FrameQuality:
    """What is known about a frame before anybody chooses.

    Attributes
    ----------
    push, frame, force_n : which one.
    image : sharpness, noise, exposure.
    vertebrae : how many are tracked well enough to be used.
    tracking_mm : median predicted error of their corners, at the patient plane.
    supports : by name, those that are seen; shown, not judged.
    """

    push: str
    frame: int
    force_n: float
    image: ImageQuality
    vertebrae: int
    tracking_mm: float
    supports: Mapping[str, Motion]

    @property
    def moved_mm(self) -> float | None:
        """The most that any support moved."""
        return max((motion.mm for motion in self.supports.values()), default=None)

    @property
    def score(self) -> float:
        """Orders frames under the same force; above is better."""
        sure = 1.0 / (1.0 + self.tracking_mm / UNSURE_MM)
        return self.image.sharpness * sure * min(self.image.contrast_to_noise / NOISY, 2.0)


@dataclass(frozen=True)
class Proposal:
    """A frame's proposed role, and why: "60 N, sharp, supports moved 0.8 mm: validation, the largest force"."""

    quality: FrameQuality
    role: Role
    reason: str


def frame_qualities(push: PushRecord, frames: Sequence[Radiograph], tracked: TrackedPush) -> tuple[FrameQuality, ...]:
    """What can be measured about the frames of a push.

    Parameters
    ----------
    push : its record.
    frames : its F radiographs.
    tracked : its F frames as tracked.
    """
    corners = [usable_corners(tracked.corners(i)) for i in range(len(tracked.frames))]
    images = image_quality(frames, corners)
    return tuple(
        FrameQuality(
            push.id, i, force, images[i], len(corners[i]),
            float(np.median(error_of(corners[i].quality))) if len(corners[i]) else np.inf, _motions(entry),
        )
        for i, (force, entry) in enumerate(zip(push.forces_n, tracked.frames, strict=True))
    )  # fmt: skip


def _motions(frame: TrackedFrame) -> dict[str, Motion]:
    """Of a frame's supports, those that are seen."""
    turned = None if frame.obliquity_deg is None else frame.obliquity_deg.value
    return {name: Motion(mm, turned if name == "pelvis" else None) for name, mm in frame.support_motion_mm.items()}


def propose(pushes: Sequence[Sequence[FrameQuality]]) -> tuple[tuple[Proposal, ...], ...]:
    """A role for each frame of each push.

    Of a push the best frame at each force counts. Its largest force is for validation, and the two below it that lie
    furthest apart (the largest and the one nearest to its half) are for training. A push with one such frame is for
    validation if another push can train, else for training.
    """
    levels = [_levels(frames) for frames in pushes]
    several = any(len(found) >= 2 for found in levels)
    usable = [i for i, found in enumerate(levels) if found]
    lone = None if several or not usable else usable[0]
    left = "none is left to check with" if len(usable) == 1 else "this one trains, another push's checks"
    why = f"no push has frames under two forces; {left}"
    return tuple(
        tuple(_of_push(frames, found, several and len(found) >= 2, why if i == lone else ""))
        for i, (frames, found) in enumerate(zip(pushes, levels))
    )


def _levels(frames: Sequence[FrameQuality]) -> list[FrameQuality]:
    """The best usable frame at each force, from small to large."""
    largest = max(frame.force_n for frame in frames)
    left = [frame for frame in frames if not _unfit(frame, largest)]
    found: list[FrameQuality] = []
    for frame in sorted(left, key=lambda f: -f.force_n):
        if found and found[-1].force_n - frame.force_n <= SAME_FORCE * largest:
            if frame.score > found[-1].score:
                # The level keeps its force, or a run of small steps would end up as one level.
                found[-1] = replace(frame, force_n=found[-1].force_n)
        else:
            found.append(frame)
    return [frames[frame.frame] for frame in reversed(found)]


def _unfit(frame: FrameQuality, largest: float) -> str:
    """Why a frame can't be used, in words; "" = it can."""
    image = frame.image
    if frame.force_n == 0.0:
        return "no force; it shows how the patient stood"
    if frame.force_n < SMALL_FORCE * largest:
        return "too small a force to tell stiffness"
    if frame.vertebrae < FEWEST_VERTEBRAE:
        seen = counted(frame.vertebrae, "vertebra", "vertebrae") if frame.vertebrae else "no vertebrae"
        return f"{seen} could be followed (wanted {FEWEST_VERTEBRAE})"
    if np.isnan(image.sharpness):
        return "no vertebra's edges rise above the noise"
    if image.sharpness < BLURRED:
        return f"blurred (sharpness {image.sharpness:.2f} of the sharpest frame's)"
    if image.saturated > SATURATED:
        return f"{100 * image.saturated:.0f} % of the vertebrae have no grey values of their own (exposure)"
    if not frame.tracking_mm <= UNSURE_MM:
        return f"corners were followed unsurely (by about {frame.tracking_mm:.1f} mm)"
    return ""


def _of_push(
    frames: Sequence[FrameQuality], levels: Sequence[FrameQuality], trains: bool, alone: str
) -> list[Proposal]:
    """``alone`` : why its only frame trains; "" where it does not."""
    largest = max(frame.force_n for frame in frames)
    roles: dict[int, tuple[Role, str]] = {}
    if alone and levels:
        roles[levels[-1].frame] = ("training", alone)
    elif levels:
        roles[levels[-1].frame] = ("validation", "the largest force")
    if trains:
        below = list(levels[:-1])
        roles[below[-1].frame] = ("training", "the largest force below the one held out")
        rest = below[:-1]
        if rest:
            half = min(rest, key=lambda frame: abs(frame.force_n - 0.5 * levels[-1].force_n))
            roles[half.frame] = ("training", "nearest to half of the largest force")
    kept = {frame.frame for frame in levels}
    proposals = []
    for frame in frames:
        role: Role = "unused"
        reason = _unfit(frame, largest)
        if frame.frame in roles:
            role, reason = roles[frame.frame]
        elif frame.frame in kept:
            reason = "two training frames a push are enough"
        elif not reason:
            reason = "another frame under about the same force is better"
        proposals.append(Proposal(frame, role, f"{_described(frame)}: {role}, {reason}"))
    return proposals


def _described(frame: FrameQuality) -> str:
    """E.g. "60 N, sharp, supports moved 0.8 mm"."""
    image = frame.image
    words = [f"{frame.force_n:g} N"]
    if np.isfinite(image.sharpness):
        words.append(
            "sharp" if image.sharpness >= SLIGHTLY_BLURRED else
            "slightly blurred" if image.sharpness >= BLURRED else "blurred"
        )  # fmt: skip
    if 0.0 < image.contrast_to_noise < NOISY:
        words.append("noisy")
    seen = "supports" if len(frame.supports) > 1 else next(iter(frame.supports), "")
    words.append(f"{seen} moved {frame.moved_mm:.1f} mm" if seen else "supports not seen")
    return ", ".join(words)
