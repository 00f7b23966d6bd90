"""How far pelvis and shoulder moved and turned: a fit may know their place in each frame (paper 2.1).

The points are annotated in a push's first frame, and everything is measured from there. The pelvis' obliquity is its
turn about the world's AP axis, +z: above 0 the patient's left side rises, anticlockwise as seen from the front.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from spinestiff.arrays import Floats, read_only
from spinestiff.errors import TrackingError
from spinestiff.imaging.planar import turns
from spinestiff.imaging.tracking.following import follow
from spinestiff.imaging.tracking.patches import Body
from spinestiff.imaging.tracking.pictures import SHADING_MM, Pictures, check_inside, sampled
from spinestiff.imaging.tracking.quality import predicted_error

if TYPE_CHECKING:
    from spinestiff.imaging.radiograph import Radiograph

SUPPORT_LIMIT_MM = 3.0
"""The paper leaves out frames in which a support moved (2.1); here they are noted from this distance on."""
OBLIQUITY_LIMIT_DEG = 3.0
"""The same of a pelvis that turned."""
DEPTH_OF_SLIDE = 0.4
"""Motion in depth of a shoulder for each mm that it slides along its wall: 0.3 to 0.4 in the template under a push."""
UNSEEN_TURN = float(np.radians(0.5 * OBLIQUITY_LIMIT_DEG))
"""Standard deviation of a turn that no two points show, rad; the limit counts as two."""
SUPPORT_RADIUS_MM = 15.0
FLESH_MM = {"pelvis": 0.6, "shoulder": 0.14}
"""Standard error of a point along an axis, besides what tracking predicts: skin and bowel take its picture along
(docs/tracking.md)."""
SKIN_SHARE = 0.8
"""Of the way from the grey of air to that of the middle of the body: what is darker shows skin's edge."""
LEAST_LEFT = 0.2
"""Share of a patch that has to remain without skin's edge; else it is taken whole."""


@dataclass(frozen=True)
class SupportMotion:
    """How far a support moved and turned in the picture since the first frame.

    Attributes
    ----------
    name : "pelvis" or "shoulder".
    displacement : (F, 2) mm at the patient plane, to the patient's left (+x) and up (+y), of the middle of the
        support's points: a pelvis that turns about it does not count as moved, whether all are seen or not.
    error : (F,) mm, standard error of the displacement along an axis; of a shoulder with what its slide along the wall
        adds, since with it goes a motion in depth, which seems sideways off the beam's axis.
    seen : (F,) bool; where it is False the displacement and its error mean nothing.
    turn : (F,) rad about the AP axis, +z, by the support's points.
    turn_error : (F,) rad, its standard error.
    turn_seen : (F,) bool, whether two points or more are seen; where it is False the turn and its error mean nothing.
    off_axis : how far the support's points lie from the principal ray, over the distance of the source.
    """

    name: str
    displacement: Floats
    error: Floats
    seen: NDArray[np.bool_]
    turn: Floats
    turn_error: Floats
    turn_seen: NDArray[np.bool_]
    off_axis: float

    def __post_init__(self) -> None:
        displacement = read_only("displacement", self.displacement, (None, 2), TrackingError)
        object.__setattr__(self, "displacement", displacement)
        for key, kind in (
            ("error", float), ("seen", bool), ("turn", float), ("turn_error", float), ("turn_seen", bool)
        ):  # fmt: skip
            array = read_only(key, getattr(self, key), (len(displacement),), TrackingError, kind)
            object.__setattr__(self, key, array)

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
        """(F,) whether it is seen to have moved, or a pelvis to have turned, by more than the limit."""
        turned = np.degrees(np.abs(self.turn)) > OBLIQUITY_LIMIT_DEG
        return np.asarray(
            ((self.distance > self.limit) & self.seen) | (turned & self.turn_seen & (self.name == "pelvis"))
        )

    def notes(self) -> dict[int, str]:
        """Of each frame in which it moved, by how much: "the pelvis moved by 3.4 mm, obliquity +2.1 degrees"."""
        return {frame: self._note(frame) for frame in np.flatnonzero(self.moved).tolist()}

    def _note(self, frame: int) -> str:
        words = f"the {self.name} moved by {self.distance[frame]:.1f} mm"
        if self.name == "pelvis" and self.turn_seen[frame]:
            words += f", obliquity {np.degrees(self.turn[frame]):+.1f} degrees"
        return words


def support_motion(frames: Sequence[Radiograph], points: Mapping[str, Floats]) -> tuple[SupportMotion, ...]:
    """Motion and turn of pelvis and shoulder through a sequence, where their points are visible (paper 2.1).

    Parameters
    ----------
    frames : F radiographs of one frontal view and size.
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
    view = frames[0].view
    places = {name: view.from_pixels(where) for name, where in groups.items()}
    bodies = [Body.of_square(point, radius) for where in places.values() for point in pictures.binned(where)]
    bodies = [_under_the_skin(body, pictures) for body in bodies]
    poses, evidence = follow(pictures, bodies, range(len(frames)), chained=False)
    # A point's error is predicted as a distance; half of its square belongs to each axis.
    sds = np.array([[np.inf if e is None else float(predicted_error(e)[0]) for e in row] for row in evidence])
    sds = np.hypot(sds / np.sqrt(2.0), [FLESH_MM[name] for name in owners])
    sds[0] = np.array([FLESH_MM[name] for name in owners])
    to_world = view.detector_axes[:, :2]
    shifts = poses[:, :, 1:] * pictures.mm @ to_world
    found = []
    for name, where in places.items():
        mine = owners == name
        spots = view.to_patient_plane(where)
        turns = [_turn(spots @ to_world, moved, sd) for moved, sd in zip(shifts[:, mine], sds[:, mine])]
        turn, turn_error = np.array([each or (0.0, 0.0) for each in turns]).T
        turn_seen = np.array([each is not None for each in turns])
        allowed = np.where(turn_seen, turn_error, UNSEEN_TURN)
        mean, error = _middle(spots @ to_world, shifts[:, mine], sds[:, mine], turn, allowed)
        seen = np.isfinite(sds[:, mine]).any(axis=1)
        away = float(np.abs(spots[:, 0]).max()) / view.source_to_patient
        if name == "shoulder":
            # What the limit allows for counts as two standard errors.
            error = np.hypot(error, 0.5 * away * DEPTH_OF_SLIDE * np.abs(mean[:, 1]))
        found.append(SupportMotion(name, mean, error, seen, turn, turn_error, turn_seen, away))
    return tuple(found)


def _under_the_skin(body: Body, pictures: Pictures) -> Body:
    """The part of a patch that shows the body, not the edge of the skin: high in contrast, and it moves otherwise."""
    import cv2

    image = pictures.images[0]
    reach = int(np.ceil(2.0 * SHADING_MM / pictures.mm))
    smooth = cv2.GaussianBlur(image, (0, 0), SHADING_MM / pictures.mm)
    darkest = np.asarray(cv2.erode(smooth, np.ones((reach, reach))), dtype=np.float32)
    air, flesh = np.percentile(image, 1.0), np.median(image)
    kept = sampled(darkest, body.points) > air + SKIN_SHARE * (flesh - air)
    if np.mean(kept) < LEAST_LEFT:
        return body
    return replace(body, points=body.points[kept], parts=body.parts[kept])


def _middle(start: Floats, shifts: Floats, sds: Floats, turn: Floats, turn_error: Floats) -> tuple[Floats, Floats]:
    """Shift (F, 2) of the middle of points (n, 2) that moved by (F, n, 2), and its standard error along an axis (F,).

    Each point that is found counts alike: a turn about their middle then is no motion. Where some are lost, the others'
    middle lies elsewhere, and what the turn (F,), with its error, moves it by is no motion either.
    """
    found = np.isfinite(sds)
    count = np.maximum(found.sum(axis=1), 1)
    mean = np.where(found[..., None], shifts, 0.0).sum(axis=1) / count[:, None]
    away = found @ start / count[:, None] - start.mean(axis=0)
    cos, sin = np.cos(turn) - 1.0, np.sin(turn)
    turned = np.stack([cos * away[:, 0] - sin * away[:, 1], sin * away[:, 0] + cos * away[:, 1]], axis=1)
    error = np.linalg.norm(np.where(found, sds, 0.0), axis=1) / count
    return mean - turned, np.hypot(error, turn_error * np.linalg.norm(away, axis=1))


def _turn(start: Floats, shifts: Floats, sds: Floats) -> tuple[float, float] | None:
    """Turn (rad, anticlockwise) that carries points (n, 2) along by weighted least squares, and its standard error.

    None unless two are found, at different places.
    """
    found = np.isfinite(sds)
    if not found.any() or not np.ptp(start[found], axis=0).any():
        return None
    weight = 1.0 / sds[found] ** 2
    old, new = start[found], (start + shifts)[found]
    arms = old - weight @ old / weight.sum()
    return float(turns(old, new, weight)), float((weight @ (arms**2).sum(axis=1)) ** -0.5)
