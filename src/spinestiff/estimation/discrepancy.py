"""How far a person's spine may move from what the model says: a covariance learnt from variants of the model.

Relative to the size of the model's own motion, what is learnt is a few modes and a remainder of each entry by itself,
over push site, vertebra and channel (``estimation.discrepancy_data``):

    truth - model = size * sum_s w_s (sqrt(1 - o) sum_k z_k phi_ks + r_s) + size * sqrt(o) sum_k y_k sum_s w_s phi_ks,

with w the weights of the learnt sites in a frame's site, and z, y, r independent. z and r belong to the person, so what
pushes share stays shared; y belongs to the frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from spinestiff.anatomy.names import RIBS, VERTEBRAE
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, Ints, ShortRepr, read_only
from spinestiff.errors import FitError
from spinestiff.imaging.features import picture_axes
from spinestiff.imaging.planar import turns

if TYPE_CHECKING:
    from spinestiff.imaging.projection import XRayView
    from spinestiff.mechanics.loads import LoadCase

SIDES = ("left", "right")
# A turn counts as the shift, mm, that it gives a point at this distance: about that of a vertebra's corners.
TURN_ARM_MM = 20.0
CHANNELS = np.array([1.0, 1.0, TURN_ARM_MM])
# Of a vertebra's pose (dt, dw): what a frontal picture has as shift to the left, upwards and turn; and the rest.
IN_PLANE, OUT_OF_PLANE = (0, 1, 5), (2, 3, 4)
# Of shift to the front and turns about the axes to the left and upwards (times ``TURN_ARM_MM``), over the size of the
# frontal motion, and over how many vertebrae these are alike (``benchmarks/discrepancy_out_of_plane.py``).
OUT_OF_PLANE_SD = np.array([0.06, 0.01, 0.015])
OUT_OF_PLANE_LENGTH = 8.0
# Of the skin's motion to the left, upwards and to the front, over the size of the frontal motion, and mm over which
# each is alike along the skin (``benchmarks/discrepancy_skin.py``).
SKIN_SD = np.array([0.09, 0.07, 0.06])
SKIN_LENGTH_MM = np.array([350.0, 150.0, 120.0])
# Mirroring turns a shift to the left into one to the right, and with it the sense of a turn.
MIRROR = np.array([-1.0, 1.0, -1.0])
LOWEST_LEVEL, HIGHEST_LEVEL = 1.0, 12.0
MOTION_SD = 0.05  # where nothing was learnt


@dataclass(frozen=True, repr=False)
class DiscrepancyFrame(ShortRepr):
    """A loaded frame as the model has it.

    Attributes
    ----------
    side : "left" or "right", the patient's side that is pushed.
    level : rib level of the push, 1 to 12.
    motion : (17, 3) the model's own motion of T1 to L5 from its unloaded state: ``plane_motion``.

    Raises
    ------
    FitError : an unknown side, a level out of range, another number of vertebrae, values that are not finite.
    """

    side: str
    level: float
    motion: Floats

    def __post_init__(self) -> None:
        if self.side not in SIDES:
            raise FitError(f"push side '{self.side}'; wanted 'left' or 'right'")
        if not LOWEST_LEVEL <= self.level <= HIGHEST_LEVEL:
            raise FitError(f"push level {self.level:g}; wanted a rib number from 1 to 12")
        motion = read_only("motion of the vertebrae", self.motion, (len(VERTEBRAE), 3), FitError)
        object.__setattr__(self, "motion", motion)


@dataclass(frozen=True, repr=False)
class DiscrepancyModes(ShortRepr):
    """Covariance of relative differences of motion, as ``discrepancy_columns`` takes it.

    Attributes: as of ``DiscrepancyData`` and ``KindModes``; ``own_share`` is that of the modes alone.
    """

    levels: Floats
    modes: Floats
    remainder: Floats
    own_share: float

    def weights(self, side: str, level: float) -> Floats:
        """(2, S) of the learnt sites in a push: linear between two levels, the outermost level's beyond it."""
        weights = np.zeros((len(SIDES), len(self.levels)))
        for site, unit in enumerate(np.eye(len(self.levels))):
            weights[SIDES.index(side), site] = np.interp(level, self.levels, unit)
        return weights


def plane_motion(rest: Floats, moved: Floats, view: XRayView) -> Floats:
    """(V, 3) motion of vertebrae in a picture: shift to the patient's left and upwards, mm at the patient plane, and
    turn from left towards up, rad, of the boxes ``rest`` and ``moved`` (V, 4, 2) mm (``imaging.features.Features.z``).
    """
    axes = np.stack(picture_axes(view), axis=1)
    a, b = rest @ axes, moved @ axes
    return np.column_stack([b.mean(axis=1) - a.mean(axis=1), turns(a, b)])


def as_corners(motion: Floats, boxes: Floats, view: XRayView) -> Floats:
    """(V, 4, 2, ...) mm, how the corners of ``boxes`` (V, 4, 2) move in the picture with small motions (V, 3, ...) as
    ``plane_motion`` gives them; the columns of a frame of ``discrepancy_columns`` are such motions."""
    axes = np.stack(picture_axes(view), axis=1)
    arms = (boxes - boxes.mean(axis=1, keepdims=True)) @ axes
    quarter = np.stack([-arms[..., 1], arms[..., 0]], -1)
    moved = motion[:, None, :2] + np.einsum("vki,v...->vki...", quarter, motion[:, 2])
    return np.einsum("ij,vkj...->vki...", axes, moved)


def motion_size(motion: Floats) -> float:
    """mm, root mean square over the vertebrae of a motion (..., 3): shift and turn (times ``TURN_ARM_MM``) together."""
    return float(np.sqrt(np.mean(np.sum((np.asarray(motion) * CHANNELS) ** 2, axis=-1))))


def discrepancy_columns(frames: Sequence[DiscrepancyFrame], modes: DiscrepancyModes) -> Floats:
    """(F, 17, 3, K) C with C C^T the covariance of truth - model of the frames' motions.

    Rows are in the units of ``DiscrepancyFrame.motion`` (mm, mm, rad). Frames pushed at one site differ by the sizes of
    their motions and by their own part; those of other sites share what the modes share.
    """
    if not frames:
        return np.zeros((0, len(VERTEBRAE), 3, 0))
    weights = np.stack([modes.weights(frame.side, frame.level) for frame in frames])
    sizes = np.array([motion_size(frame.motion) for frame in frames])
    followed = np.einsum("f,fas,kasvc->fvck", sizes, weights, modes.modes)
    count, rows = len(frames), len(VERTEBRAE) * len(CHANNELS)
    shape = (count, len(VERTEBRAE), len(CHANNELS), -1)
    used = np.argwhere(weights.any(axis=0))
    # Between two sites, independent parts keep their variance.
    mixed = weights / np.linalg.norm(weights, axis=(1, 2), keepdims=True)
    left = [
        np.einsum("f,r,rq->frq", sizes * mixed[:, side, site], modes.remainder[side, site].ravel(), np.eye(rows))
        for side, site in used
    ]
    own = np.einsum("fg,fvck->fvcgk", np.sqrt(modes.own_share) * np.eye(count), followed)
    parts = [np.sqrt(1.0 - modes.own_share) * followed, *(part.reshape(shape) for part in left), own.reshape(shape)]
    return np.asarray(np.concatenate(parts, axis=-1) / CHANNELS[:, None])


def out_of_plane_columns(frames: Sequence[DiscrepancyFrame], modes: DiscrepancyModes) -> Floats:
    """(F, 17, 3, K) C with C C^T the covariance of truth - model of the frames' motions out of the frontal plane: shift
    to the front (mm), turns about the axes to the left and upwards (rad).

    Each in proportion to the size of the frame's motion, alike along the spine over ``OUT_OF_PLANE_LENGTH``, and shared
    by frames as remainders and modes of ``discrepancy_columns`` are: by those of one site, but for an own part.
    """
    count, rows = len(frames), len(VERTEBRAE)
    apart = np.abs(np.subtract.outer(np.arange(rows), np.arange(rows)))
    root = np.linalg.cholesky(np.exp(-apart / OUT_OF_PLANE_LENGTH))
    sizes = np.array([motion_size(frame.motion) for frame in frames])
    sds = OUT_OF_PLANE_SD / np.array([1.0, TURN_ARM_MM, TURN_ARM_MM])
    found = np.einsum("f,fs,c,vw,cd->fvcsdw", sizes, _sharing(frames, modes), sds, root, np.eye(len(sds)))
    return np.asarray(found.reshape(count, rows, len(sds), -1))


def skin_covariance(
    frames: Sequence[DiscrepancyFrame], modes: DiscrepancyModes, of: Ints, points: Floats, slide: float
) -> Floats:
    """(3 P, 3 P) mm^2, covariance of truth - model of how points of the skin move in loaded frames, point by point.

    In proportion to the size of the frame's motion, alike along the skin over ``SKIN_LENGTH_MM``, and shared by frames
    as in ``out_of_plane_columns``; independent of the vertebrae's.

    Parameters
    ----------
    of : (P,) frame of each point. points : (P, 3) mm, at rest.
    slide : standard deviation, relative to the frame's motion along each axis, of what no variant of the model shows.
    """
    sizes = np.array([motion_size(frame.motion) for frame in frames])
    sharing = sizes[:, None] * _sharing(frames, modes)
    apart = np.linalg.norm(points[:, None] - points, axis=-1)
    shared = (sharing @ sharing.T)[np.ix_(of, of)]
    found = np.zeros((len(points), 3, len(points), 3))
    for axis, (sd, length) in enumerate(zip(SKIN_SD, SKIN_LENGTH_MM)):
        found[:, axis, :, axis] = (sd**2 + slide**2) * shared * np.exp(-apart / length)
    return found.reshape(3 * len(points), -1)


def _sharing(frames: Sequence[DiscrepancyFrame], modes: DiscrepancyModes) -> Floats:
    """(F, K) rows of length 1 whose products say how alike frames err: those of one site, but for an own part."""
    count = len(frames)
    weights = np.stack([modes.weights(frame.side, frame.level) for frame in frames]).reshape(count, -1)
    mixed = weights[:, weights.any(axis=0)] / np.linalg.norm(weights, axis=1, keepdims=True)
    return np.column_stack([np.sqrt(1.0 - modes.own_share) * mixed, np.sqrt(modes.own_share) * np.eye(count)])


def relative_covariance(motions: Sequence[Floats]) -> Floats:
    """(n, n) mm^2 for torsos of other vertebrae than T1 to L5, of which nothing was learnt: motions of another size."""
    column = MOTION_SD * np.concatenate([*motions, np.zeros(0)])
    return np.outer(column, column)


def pushed_side(load: LoadCase) -> str:
    """The side of a push: its force drives the spine to the other one."""
    return "right" if load.push.total[0] >= 0.0 else "left"


def pushed_site(load: LoadCase, torso: TorsoModel) -> tuple[str, float]:
    """Side and rib level of a push, from the ribs on which its forces act; of another load, the ribs at its height."""
    side, rest = pushed_side(load), torso.rest_pose
    sizes = np.linalg.norm(np.concatenate([load.forces, load.node_forces]), axis=1)
    names = [torso.bone_names[bone] for bone in load.points.bone]
    on_ribs = np.array([sizes[i] if name in RIBS else 0.0 for i, name in enumerate(names)])
    if on_ribs.any():
        levels = [float(name[1:].partition("_")[0]) if name in RIBS else 0.0 for name in names]
        level = float(on_ribs @ levels / on_ribs.sum())
    else:
        heights = np.concatenate([load.points.positions(rest)[:, 1], rest.tissue_positions[load.nodes, 1]])
        height = float(sizes @ heights / max(sizes.sum(), 1e-300))
        rows = [RIBS.index(f"R{i}_{side[0].upper()}") for i in range(1, 13)]
        ribs = torso.landmarks["rib_lateral"][rows].positions(rest)[:, 1]
        # Rib 12 may reach a little higher than rib 11.
        level = float(np.interp(-height, np.maximum.accumulate(-ribs), np.arange(1.0, 13.0)))
    return side, float(np.clip(level, LOWEST_LEVEL, HIGHEST_LEVEL))
