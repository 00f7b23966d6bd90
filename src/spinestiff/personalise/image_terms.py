"""Image residuals: where a radiograph shows the vertebrae's corners and pedicles, against where a torso has them.

A vertebra of place t, rotation R, log sizes s and tapers a has the box corner r = (x, y, z) at ``t + R r'`` with

    r' = exp(s) o (x (1 + a_1 sign y), y (1 + a_3 sign z), z (1 + a_2 sign y)):

its upper endplate is a_1 wider and a_2 deeper, its front a_3 higher than its mean. Seen in a view the corner is
compared with the annotated one at the patient plane, in mm. Of two box corners one behind the other in the beam the one
farther out along the vertebra's axis is seen, for every shape anew: in a strong curve it is another one than in the
template. Unlike the features of Eq. 9, which place a box of given
size, corners are compared one by one: only so do they say how large a vertebra is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.rotation import cross_matrix
from spinestiff.anatomy.torso import TorsoModel, TorsoState
from spinestiff.arrays import Floats, Ints, read_only
from spinestiff.errors import TrackingError
from spinestiff.imaging.features import CORNER_UPWARD, VertebraCorners, corner_offsets, seen_axes, vertebra_rows
from spinestiff.imaging.projection import XRayView
from spinestiff.personalise.pose import Stance
from spinestiff.personalise.sizes import pedicle_centres

# What is unknown of a vertebra (15): dt (mm), dw (rad), log width, height and depth, how far its pedicles lie from the
# template's (mm: outwards, up, front), and three tapers.
UNKNOWNS = 15
# Of a view (4): two shifts (mm at the patient plane), roll, yaw (rad).
VIEW_UNKNOWNS = 4


@dataclass(frozen=True)
class PediclePoints:
    """Centres of pedicles marked in one radiograph.

    Attributes
    ----------
    vertebrae : (Nv,) names, each once.
    points : (Nv, 2, 2) mm on the detector, the patient's left and right pedicle; NaN where one is not seen.

    Raises
    ------
    TrackingError : wrong shapes, or repeated names.
    """

    vertebrae: tuple[str, ...]
    points: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertebrae", tuple(self.vertebrae))
        if len(set(self.vertebrae)) != len(self.vertebrae):
            raise TrackingError("pedicles of a vertebra are given more than once")
        points = np.asarray(self.points, dtype=float)
        if points.shape != (len(self.vertebrae), 2, 2):
            raise TrackingError(f"pedicle points have shape {points.shape}, wanted ({len(self.vertebrae)}, 2, 2)")
        points = points.copy()
        points.flags.writeable = False
        object.__setattr__(self, "points", points)


@dataclass(frozen=True)
class Shape:
    """The vertebrae as a fit moves them.

    positions (V, 3) mm, rotations (V, 3, 3), log_sizes (V, 3), pedicles (V, 3) mm, tapers (V, 3): see ``UNKNOWNS``.
    """

    positions: Floats
    rotations: Floats
    log_sizes: Floats
    pedicles: Floats
    tapers: Floats

    @property
    def own(self) -> Floats:
        """(V, 9) what a vertebra is in itself: log sizes, pedicles, tapers."""
        return np.concatenate([self.log_sizes, self.pedicles, self.tapers], axis=1)


@dataclass(frozen=True)
class ImagePoints:
    """Annotated points of one view and what they are on a torso.

    Attributes
    ----------
    view : nominal.
    vertebra : (P,) row of the torso's vertebrae.
    pair : (P, 2, 3) mm in the vertebra's frame, at the template's size: the two box corners that the point may be; a
        pedicle twice.
    upward : (P,) +1 for a corner of the superior, -1 of the inferior endplate; 0 for a pedicle.
    outward : (P,) 0 for a corner; +1 for a left, -1 for a right pedicle.
    measured : (P, 2) mm on the detector.
    """

    view: XRayView
    vertebra: Ints
    pair: Floats
    upward: Floats
    outward: Floats
    measured: Floats

    def __len__(self) -> int:
        return len(self.vertebra)

    def residuals(self, shape: Shape, pose: Floats) -> Floats:
        """(P, 2) mm at the patient plane, simulated less measured, for a pose (4,) of the view."""
        standing = Stance(self.view, pose)
        points, _, _ = self._world(shape, self._seen(shape, standing))
        return np.asarray((self.view.project(standing.moved(points)) - self.measured) / self.view.magnification)

    def linearised(self, shape: Shape, pose: Floats) -> tuple[Floats, Floats, Floats]:
        """Residuals (P, 2), and their derivatives in the vertebra's (P, 2, 15) and in the view's unknowns (P, 2, 4)."""
        standing = Stance(self.view, pose)
        offset = self._seen(shape, standing)
        points, scaled, local = self._world(shape, offset)
        moved = standing.moved(points)
        seen, slope = self.view.project_with_jacobian(moved)
        slope = slope / self.view.magnification
        rotation = shape.rotations[self.vertebra]
        own = np.zeros((len(self), 3, UNKNOWNS))
        own[:, :, :3] = np.eye(3)
        own[:, :, 3:6] = -cross_matrix(points - shape.positions[self.vertebra])
        own[:, :, 6:9] = rotation * scaled[:, None, :]
        own[:, :, 9:12] = rotation * local[:, None, :]
        plain = np.exp(shape.log_sizes[self.vertebra]) * offset * _taper_signs(offset, self.outward)
        own[:, :, 12:] = (rotation * plain[:, None, :])[:, :, [0, 2, 1]]
        residual = (seen - self.measured) / self.view.magnification
        return residual, slope @ (standing.turn @ own), slope @ standing.jacobian(moved)

    def _seen(self, shape: Shape, standing: Stance) -> Floats:
        """(P, 3) mm of each pair the one that makes the silhouette (``imaging.features.silhouette_choice``)."""
        placed = standing.moved(shape.positions)
        axis = seen_axes(self.view, placed, standing.turn @ shape.rotations)[self.vertebra] * self.upward[:, None]
        both = [self._world(shape, self.pair[:, which])[0] for which in (0, 1)]
        height = [np.sum(self.view.project(standing.moved(points)) * axis, axis=1) for points in both]
        return np.where((height[1] > height[0])[:, None], self.pair[:, 1], self.pair[:, 0])

    def _world(self, shape: Shape, offset: Floats) -> tuple[Floats, Floats, Floats]:
        """(P, 3) mm in the world, sized offsets (P, 3), and the directions (P, 3) of a pedicle's own place."""
        which = self.vertebra
        pedicle = np.abs(self.outward)
        local = np.stack([self.outward, pedicle, pedicle], -1)
        tapered = 1.0 + _taper_signs(offset, self.outward) * shape.tapers[which][:, [0, 2, 1]]
        scaled = np.exp(shape.log_sizes[which]) * offset * tapered
        moved = scaled + local * shape.pedicles[which]
        return shape.positions[which] + np.einsum("pij,pj->pi", shape.rotations[which], moved), scaled, local


def image_points(
    torso: TorsoModel, view: XRayView, corners: VertebraCorners, pedicles: PediclePoints | None = None
) -> ImagePoints:
    """The usable corners and pedicles of one picture.

    Parameters
    ----------
    torso : whose boxes and pedicles they are.
    view : nominal.

    Raises
    ------
    TrackingError : a vertebra that the torso lacks.
    """
    rows = vertebra_rows(torso, corners)
    used = corners.usable
    vertebra = np.repeat(rows, 4).reshape(-1, 4)[used]
    pair, measured = corner_offsets(torso, view)[rows][used], corners.corners[used]
    upward = np.broadcast_to(CORNER_UPWARD, used.shape)[used]
    outward = np.zeros(len(vertebra))
    if pedicles is not None:
        for name in pedicles.vertebrae:
            if name not in torso.vertebrae:
                raise TrackingError(f"pedicles name {name}, but this torso has no such vertebra")
        which = np.array([torso.vertebrae.index(name) for name in pedicles.vertebrae], dtype=np.int64)
        seen = np.isfinite(pedicles.points).all(2)
        vertebra = np.concatenate([vertebra, np.repeat(which, 2).reshape(-1, 2)[seen]])
        pair = np.concatenate([pair, np.repeat(pedicle_centres(torso)[which][seen][:, None], 2, axis=1)])
        upward = np.concatenate([upward, np.zeros(seen.sum())])
        measured = np.concatenate([measured, pedicles.points[seen]])
        outward = np.concatenate([outward, np.tile([1.0, -1.0], (len(which), 1))[seen]])
    return ImagePoints(view, vertebra, pair, upward, outward, read_only("corners", measured, (None, 2), TrackingError))


def shape_of(torso: TorsoModel, state: TorsoState) -> Shape:
    """The torso's vertebrae in a state, at its own sizes."""
    bones, zero = torso.vertebra_bones, np.zeros((len(torso.vertebrae), 3))
    return Shape(state.bone_positions[bones], state.bone_rotations[bones], zero, zero, zero)


def own_boxes(torso: TorsoModel, shape: Shape) -> Floats:
    """(V, 8, 3) mm, the torso's boxes at a shape's sizes and tapers."""
    boxes = torso.vertebra_boxes
    tapers = shape.tapers[:, None, [0, 2, 1]] * _taper_signs(boxes, np.zeros(boxes.shape[:2]))
    return np.asarray(np.exp(shape.log_sizes)[:, None] * boxes * (1.0 + tapers))


def _taper_signs(offset: Floats, outward: Floats) -> Floats:
    """(..., 3) by which side of the box the tapers of width, height and depth go; 0 for pedicles."""
    up, front = np.sign(offset[..., 1]), np.sign(offset[..., 2])
    return np.stack([up, front, up], -1) * (outward == 0.0)[..., None]
