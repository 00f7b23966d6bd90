"""Vertebra corners followed through a sequence of radiographs, from any annotated frames in both directions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.arrays import Floats
from spinestiff.errors import TrackingError
from spinestiff.imaging.features import CORNERS, FEATURE_SHAPE, VertebraCorners
from spinestiff.imaging.tracking.following import follow
from spinestiff.imaging.tracking.patches import Body
from spinestiff.imaging.tracking.pictures import Pictures, check_inside, inside
from spinestiff.imaging.tracking.quality import predicted_error, quality_of
from spinestiff.words import counted

if TYPE_CHECKING:
    from spinestiff.imaging.radiograph import Radiograph

OnFrame = Callable[[int, int], None]

# Two tracks weigh alike once both are predicted to be off by less.
SMALLEST_MM = 0.02


def track(
    frames: Sequence[Radiograph],
    annotated: Mapping[int, VertebraCorners],
    observer: OnFrame | None = None,
) -> tuple[VertebraCorners, ...]:
    """Corners in every frame, followed from the annotated ones forwards and backwards (paper 2.2).

    Each vertebra comes from the nearest frames in which it is annotated, on either side. Between two of them both
    tracks count, each the more the nearer its annotated frame is and the better its quality.

    Parameters
    ----------
    frames : F radiographs of one view and size, in order of time.
    annotated : corners (mm on the detector) by frame, 0-based; at least one vertebra. Frames may name different ones,
        in any order.
    observer : called with (frames done, frames in all).

    Returns
    -------
    F corners with their quality, all of the same vertebrae: every one that is annotated somewhere, head to foot. What
    is annotated is returned as it is. Quality tells the predicted error (``quality.quality_of``); a vertebra or corner
    that was lost or left the image has quality 0, and its position is then only the last guess.

    Raises
    ------
    TrackingError : no frames, frames of different size or geometry, nothing annotated, an annotated frame that there is
        not, corners outside their frame, or no vertebra found in any other frame.
    """
    pictures = Pictures.of(frames)
    view, shape = frames[0].view, frames[0].pixels.shape
    annotated = {frame: corners for frame, corners in annotated.items() if len(corners)}
    if not annotated:
        raise TrackingError("no annotated frame to track from; wanted at least one")
    for frame, corners in annotated.items():
        if not 0 <= frame < len(frames):
            raise TrackingError(
                f"frame {frame} is annotated, but the sequence has {counted(len(frames), 'frame')}, counted from 0"
            )
        check_inside(view.pixels(corners.corners), shape, frame, corners.vertebrae)
    names = tuple(name for name in VERTEBRAE if any(name in corners.vertebrae for corners in annotated.values()))
    done = {*annotated}

    def advance(frame: int) -> None:
        if frame not in done:
            done.add(frame)
            if observer is not None:
                observer(len(done), len(frames))

    sightings: dict[tuple[int, str], list[_Sighting]] = {}
    for start, marked in annotated.items():
        # Neighbours tell of each other: in whatever order they are marked, they are followed head to foot.
        corners = marked.selected(names)
        for step in (1, -1):
            ends = _ends(start, corners, annotated, len(frames), step)
            order = range(start, max(ends, key=lambda end: abs(end - start)), step)
            moved, errors = _followed(pictures, corners.corners, order, advance)
            for k, frame in enumerate(order[1:], 1):
                error = np.where(inside(view.pixels(moved[k]), shape), errors[k], np.inf)
                for i, name in enumerate(corners.vertebrae):
                    if (ends[i] - frame) * step > 0:
                        sighting = _Sighting(abs(frame - start), moved[k, i], error[i], corners.quality[i])
                        sightings.setdefault((frame, name), []).append(sighting)
    tracked = []
    for frame in range(len(frames)):
        given = annotated.get(frame)
        if given is not None and given.vertebrae == names:
            tracked.append(given)
            continue
        places, qualities = np.zeros((len(names), *FEATURE_SHAPE)), np.zeros((len(names), CORNERS))
        for i, name in enumerate(names):
            if given is not None and name in given.vertebrae:
                row = given.vertebrae.index(name)
                places[i], qualities[i] = given.corners[row], given.quality[row]
            else:
                places[i], qualities[i] = _combined(sightings[frame, name], view.magnification)
        tracked.append(VertebraCorners(names, places, qualities))
    others = [corners for frame, corners in enumerate(tracked) if frame not in annotated]
    if others and not any(corners.usable.any() for corners in others):
        raise TrackingError(
            "no annotated vertebra was found in any other frame; are these frames of one sequence, in order?"
        )
    return tuple(tracked)


@dataclass(frozen=True)
class _Sighting:
    """A vertebra as followed from one annotated frame.

    Attributes
    ----------
    distance : frames in between.
    corners : (4, 2) mm on the detector.
    error : (4,) predicted, mm at the patient plane; infinite if lost.
    given : (4,) quality in the annotated frame.
    """

    distance: int
    corners: Floats
    error: Floats
    given: Floats


def _ends(
    start: int, corners: VertebraCorners, annotated: Mapping[int, VertebraCorners], count: int, step: int
) -> list[int]:
    """For each vertebra the frame before which following it from ``start`` ends: annotated again, or no more frames."""
    ends = []
    for name in corners.vertebrae:
        others = [k for k, other in annotated.items() if (k - start) * step > 0 and name in other.vertebrae]
        ends.append(min(others, key=lambda k: abs(k - start)) if others else (count if step > 0 else -1))
    return ends


def _followed(
    pictures: Pictures, corners: Floats, order: Sequence[int], advance: Callable[[int], None]
) -> tuple[Floats, Floats]:
    """Corners (len(order), Nv, 4, 2), mm on the detector, from those of the first frame (Nv, 4, 2), and their predicted
    errors (len(order), Nv, 4), mm at the patient plane, infinite if lost."""
    bodies = [Body.of_vertebra(quad) for quad in pictures.binned(corners)]
    poses, seen = follow(pictures, bodies, order, chained=True, observer=advance)
    moved = [[body.placed(pose, body.marks) for body, pose in zip(bodies, row)] for row in poses]
    lost = np.full(CORNERS, np.inf)
    errors = [[lost if evidence is None else predicted_error(evidence) for evidence in row] for row in seen]
    return pictures.unbinned(np.array(moved)), np.array(errors)


def _combined(sightings: Sequence[_Sighting], magnification: float) -> tuple[Floats, Floats]:
    """Corners (4, 2) mm on the detector, quality (4,) of a vertebra followed from one or two annotated frames."""
    corners = np.stack([sighting.corners for sighting in sightings])
    variance = np.stack([sighting.error for sighting in sightings]) ** 2
    near = 1.0 / np.array([sighting.distance for sighting in sightings])
    # The nearer one where all are lost.
    weight = near[:, None] * (1.0 / (variance + SMALLEST_MM**2) + 1e-9)
    share = weight / weight.sum(axis=0)
    place = np.einsum("sk,ski->ki", share, corners)
    apart = np.sum((corners - place) ** 2, axis=2) / magnification**2
    own = share**2 * np.where(np.isinf(variance), 0.0, variance)
    error = np.sqrt(np.sum(own + share * apart, axis=0))
    error[np.isinf(variance).all(axis=0)] = np.inf
    return place, quality_of(error) * np.sum(share * [sighting.given for sighting in sightings], axis=0)
