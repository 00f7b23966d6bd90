"""Image residuals: where a radiograph shows the vertebrae's corners and pedicles, against where a torso has them.

A vertebra of place t, rotation R, log sizes s and tapers a has the box corner r = (x, y, z) at ``t + R r'`` with

    r' = exp(s) o (x (1 + a_1 sign y), y (1 + a_3 sign z), z (1 + a_2 sign y)):

its upper endplate is a_1 wider and a_2 deeper, its front a_3 higher than its mean. Seen in a view the corner is
compared with the annotated one at the patient plane, in mm. Between two box corners, one behind the other in the beam,
the silhouette's corner lies as deep as the rim is seen farthest out (``imaging.silhouette``), for every shape anew.
Unlike the features of Eq. 9, which place a box of given size, corners are compared one by one: only so do they say how
large a vertebra is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from spinestiff.anatomy.rotation import cross_matrix
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, Ints, ShortRepr, read_only
from spinestiff.errors import TrackingError
from spinestiff.imaging.features import VertebraCorners, depth_axis, silhouette_pairs, vertebra_rows
from spinestiff.imaging.pedicles import PediclePoints, pedicle_centres
from spinestiff.imaging.projection import XRayView
from spinestiff.imaging.silhouette import halves, rim_share, rim_share_slope
from spinestiff.personalise.pose import Stance

# What is unknown of a vertebra (15): dt (mm), dw (rad), log width, height and depth, how far its pedicles lie from the
# template's (mm: outwards, up, front), and three tapers.
UNKNOWNS = 15
# Of a view (4): two shifts (mm at the patient plane), roll, yaw (rad).
VIEW_UNKNOWNS = 4


@dataclass(frozen=True, repr=False)
class Shape(ShortRepr):
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


class _Seen(NamedTuple):
    """Pairs of box corners as a view sees them: middle, half of the difference and ray to the middle (P, 3), mm in the
    vertebra's frame, and where between the two the silhouette's corner lies (P,)."""

    middle: Floats
    half: Floats
    ray: Floats
    share: Floats

    @property
    def point(self) -> Floats:
        """(P, 3) mm in the vertebra's frame: the silhouette's corner, or the pedicle."""
        return np.asarray(self.middle + self.share[:, None] * self.half)


@dataclass(frozen=True, repr=False)
class ImagePoints(ShortRepr):
    """Annotated points of one view and what they are on a torso.

    Attributes
    ----------
    view : nominal.
    vertebra : (P,) row of the torso's vertebrae.
    pair : (P, 2, 3) mm in the vertebra's frame, at the template's size: the two box corners between which the
        silhouette's lies; a pedicle twice.
    outward : (P,) 0 for a corner; +1 for a left, -1 for a right pedicle.
    measured : (P, 2) mm on the detector.
    """

    view: XRayView
    vertebra: Ints
    pair: Floats
    outward: Floats
    measured: Floats

    def __len__(self) -> int:
        return len(self.vertebra)

    def residuals(self, shape: Shape, pose: Floats) -> Floats:
        """(P, 2) mm at the patient plane, simulated less measured, for a pose (4,) of the view."""
        standing = Stance(self.view, pose)
        arm = _turned(shape.rotations[self.vertebra], self._seen(shape, standing).point)
        moved = standing.moved(shape.positions[self.vertebra] + arm)
        return np.asarray((self.view.project(moved) - self.measured) / self.view.magnification)

    def linearised(self, shape: Shape, pose: Floats) -> tuple[Floats, Floats, Floats]:
        """Residuals (P, 2), and their derivatives in the vertebra's (P, 2, 15) and in the view's unknowns (P, 2, 4)."""
        standing, rotation = Stance(self.view, pose), shape.rotations[self.vertebra]
        there = self._seen(shape, standing)
        arm = _turned(rotation, there.point)
        moved = standing.moved(shape.positions[self.vertebra] + arm)
        seen, slope = self.view.project_with_jacobian(moved)
        slope = slope / self.view.magnification
        # All unknowns: what they do to a point in its vertebra's frame, then to the frame.
        changed = rotation @ self._slopes(there, shape, standing)
        changed[:, :, :3] += np.eye(3)
        changed[:, :, 3:6] -= cross_matrix(arm)
        changed = slope @ (standing.turn @ changed)
        changed[:, :, UNKNOWNS:] += slope @ standing.jacobian(moved)
        residual = (seen - self.measured) / self.view.magnification
        return residual, changed[:, :, :UNKNOWNS], changed[:, :, UNKNOWNS:]

    def _seen(self, shape: Shape, standing: Stance) -> _Seen:
        middle, half = halves(self._sized(shape)[0])
        middle = middle + self._pedicle_ways * shape.pedicles[self.vertebra]
        beams = shape.positions - standing.unmoved(self.view.source[None])
        ray = middle + _turned(np.swapaxes(shape.rotations, 1, 2), beams)[self.vertebra]
        share, corner = np.zeros(len(self)), self.outward == 0.0
        share[corner] = rim_share(middle[corner], half[corner], ray[corner], depth_axis(self.view))
        return _Seen(middle, half, ray, share)

    def _sized(self, shape: Shape) -> tuple[Floats, Floats]:
        """(P, 2, 3) mm each: the pairs at the shape's sizes, and what a taper of 1 adds to them."""
        plain = np.exp(shape.log_sizes[self.vertebra])[:, None] * self.pair
        tapering = plain * _taper_signs(plain, self.outward[:, None])
        return plain + tapering * shape.tapers[self.vertebra][:, None, [0, 2, 1]], tapering

    @property
    def _pedicle_ways(self) -> Floats:
        """(P, 3) directions of outwards, up and front for a pedicle, 0 for a corner."""
        pedicle = np.abs(self.outward)
        return np.stack([self.outward, pedicle, pedicle], -1)

    def _slopes(self, there: _Seen, shape: Shape, standing: Stance) -> Floats:
        """(P, 3, 19) derivative of ``there.point`` in the unknowns of vertebra and view."""
        sized, tapering = self._sized(shape)
        pairs = np.zeros((len(self), 2, 3, UNKNOWNS + VIEW_UNKNOWNS))
        pairs[..., 6:9] = sized[..., None] * np.eye(3)
        pairs[..., 9:12] = self._pedicle_ways[:, None, :, None] * np.eye(3)
        pairs[..., 12:15] = tapering[..., None] * np.eye(3)[:, [0, 2, 1]]
        middle, half = 0.5 * (pairs[:, 0] + pairs[:, 1]), 0.5 * (pairs[:, 0] - pairs[:, 1])
        source = self.view.source[None]
        beams = np.zeros_like(middle)
        beams[:, :, :3] = np.eye(3)
        beams[:, :, 3:6] = cross_matrix(shape.positions - standing.unmoved(source))[self.vertebra]
        beams[:, :, UNKNOWNS:] = standing.turn.T @ standing.jacobian(source)
        ray = middle + np.swapaxes(shape.rotations, 1, 2)[self.vertebra] @ beams
        corner = self.outward == 0.0
        share = np.zeros((len(self), 1, UNKNOWNS + VIEW_UNKNOWNS))
        share[corner, 0] = rim_share_slope(
            there.middle[corner],
            there.half[corner],
            there.ray[corner],
            depth_axis(self.view),
            (middle[corner], half[corner], ray[corner]),
        )
        return np.asarray(middle + there.share[:, None, None] * half + there.half[..., None] * share)


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
    pair, measured = silhouette_pairs(torso, view)[rows][used], corners.corners[used]
    outward = np.zeros(len(vertebra))
    if pedicles is not None:
        for name in pedicles.vertebrae:
            if name not in torso.vertebrae:
                raise TrackingError(f"pedicles name {name}, but this torso has no such vertebra")
        which = np.array([torso.vertebrae.index(name) for name in pedicles.vertebrae], dtype=np.int64)
        seen = np.isfinite(pedicles.points).all(2)
        vertebra = np.concatenate([vertebra, np.repeat(which, 2).reshape(-1, 2)[seen]])
        pair = np.concatenate([pair, np.repeat(pedicle_centres(torso)[which][seen][:, None], 2, axis=1)])
        measured = np.concatenate([measured, pedicles.points[seen]])
        outward = np.concatenate([outward, np.tile([1.0, -1.0], (len(which), 1))[seen]])
    return ImagePoints(view, vertebra, pair, outward, read_only("corners", measured, (None, 2), TrackingError))


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


def _turned(rotations: Floats, vectors: Floats) -> Floats:
    """(n, 3) vectors under rotations (n, 3, 3), each its own."""
    return np.asarray(np.einsum("nij,nj->ni", rotations, vectors))
