"""Whether pelvis and shoulder stayed where they were (paper 2.1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from spinestiff.arrays import Floats, read_only
from spinestiff.errors import TrackingError
from spinestiff.imaging.tracking.following import follow
from spinestiff.imaging.tracking.patches import Body
from spinestiff.imaging.tracking.pictures import Pictures, check_inside
from spinestiff.imaging.tracking.quality import predicted_error, quality_of

if TYPE_CHECKING:
    from spinestiff.imaging.radiograph import Radiograph

SUPPORT_LIMIT_MM = 3.0
"""A support that moved by more (patient plane) makes a frame unfit for use (paper 2.1)."""
DEPTH_OF_SLIDE = 0.4
"""Motion in depth of a shoulder for each mm that it slides along its wall: 0.3 to 0.4 in the template under a push."""
SUPPORT_RADIUS_MM = 15.0


@dataclass(frozen=True)
class SupportMotion:
    """How far a support moved in the picture since the first frame.

    Attributes
    ----------
    name : "pelvis" or "shoulder".
    displacement : (F, 2) mm at the patient plane along columns and rows, mean over the support's points: a pelvis that
        only tilts does not count as moved.
    quality : (F,) in 0..1; 0 = not visible, the displacement means nothing.
    off_axis : how far the support's points lie from the principal ray, over the distance of the source.
    """

    name: str
    displacement: Floats
    quality: Floats
    off_axis: float = 0.0

    def __post_init__(self) -> None:
        displacement = read_only("displacement", self.displacement, (None, 2), TrackingError)
        object.__setattr__(self, "displacement", displacement)
        object.__setattr__(self, "quality", read_only("quality", self.quality, (len(displacement),), TrackingError))

    @property
    def distance(self) -> Floats:
        """(F,) mm that count: a shoulder may slide along its smooth wall, so only its motion across does."""
        counting = self.displacement[:, :1] if self.name == "shoulder" else self.displacement
        return np.asarray(np.linalg.norm(counting, axis=1))

    @property
    def limit(self) -> Floats:
        """(F,) mm: 3, and for a shoulder what its slide may add: with it goes a motion in depth, seen off the axis."""
        slide = np.abs(self.displacement[:, 1]) if self.name == "shoulder" else 0.0 * self.displacement[:, 1]
        return np.asarray(SUPPORT_LIMIT_MM + self.off_axis * DEPTH_OF_SLIDE * slide)

    @property
    def moved(self) -> NDArray[np.bool_]:
        """(F,) whether it is seen to have moved by more than its limit."""
        return np.asarray((self.distance > self.limit) & (self.quality > 0.0))

    def messages(self) -> dict[int, str]:
        """For each frame to be dropped, why."""
        return {
            int(frame): f"frame {frame}: the {self.name} moved by {self.distance[frame]:.1f} mm "
            f"(limit {self.limit[frame]:.1f} mm); the frame is dropped"
            for frame in np.flatnonzero(self.moved)
        }


def support_motion(frames: Sequence[Radiograph], points: Mapping[str, Floats]) -> tuple[SupportMotion, ...]:
    """Motion of pelvis and shoulder through a sequence, where their points are visible (paper 2.1).

    Parameters
    ----------
    frames : F radiographs of one view and size.
    points : (n, 2) pixels (column, row) in frame 0, by support.

    Raises
    ------
    TrackingError : as ``track``; a point outside the first frame.
    """
    if not points:
        return ()
    pictures = Pictures.of(frames)
    groups = {name: np.asarray(where, dtype=float).reshape(-1, 2) for name, where in points.items()}
    for name, where in groups.items():
        check_inside(where, frames[0].pixels.shape, 0, (f"a {name} point",) * len(where))
    owners = np.array([name for name, where in groups.items() for _ in where])
    radius = SUPPORT_RADIUS_MM / pictures.mm
    bodies = [Body.of_square(point, radius) for where in groups.values() for point in pictures.binned(where)]
    poses, seen = follow(pictures, bodies, range(len(frames)), chained=False)
    quality = np.array([[0.0 if e is None else quality_of(predicted_error(e))[0] for e in row] for row in seen])
    quality[0] = 1.0
    shifts = poses[:, :, 1:] * pictures.mm
    view = frames[0].view
    found = []
    for name in groups:
        mine = owners == name
        # Each point alike, as long as it is found: a turn about their middle then is no motion.
        weight = (quality[:, mine] > 0.0) + 1e-12
        mean = np.einsum("fp,fpi->fi", weight / weight.sum(1, keepdims=True), shifts[:, mine])
        away = np.abs(view.to_patient_plane(view.from_pixels(groups[name]))[:, 0]).max()
        found.append(SupportMotion(name, mean, quality[:, mine].max(1), float(away) / view.source_to_patient))
    return tuple(found)
