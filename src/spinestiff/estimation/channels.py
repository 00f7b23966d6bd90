"""What is compared of each thing that is seen, its channels: a vertebra's shifts and turn, a point's coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinestiff.arrays import Floats, Ints, ShortRepr
from spinestiff.estimation.objective import Target
from spinestiff.estimation.sights import Sight
from spinestiff.imaging.features import FEATURE_SHAPE, place_boxes

CHANNELS = 3  # of a vertebra


@dataclass(frozen=True, repr=False)
class Channels(ShortRepr):
    """From the corners of a radiograph's vertebrae to their channels.

    Attributes
    ----------
    basis : (Nv, 3, 4, 2), orthonormal rows.
    rows : (Nv,) the vertebrae among the torso's.
    arms : (Nv,) mm, what a turn of 1 rad gives the third channel.
    """

    basis: Floats
    rows: Ints
    arms: Floats

    @property
    def each(self) -> int:
        """How many a vertebra has."""
        return CHANNELS

    @classmethod
    def of(cls, target: Target) -> Channels:
        """Of a target's vertebrae."""
        arms = target.z - target.z.mean(axis=1, keepdims=True)
        turn = np.stack([-arms[..., 1], arms[..., 0]], -1)
        sizes = np.linalg.norm(turn, axis=(1, 2))
        turn = turn / sizes[:, None, None]
        shift = np.zeros((2, len(arms), 4, 2))
        shift[0, :, :, 0] = shift[1, :, :, 1] = 0.5
        return cls(np.stack([*shift, turn], axis=1), target.rows, sizes)

    def apply(self, features: Floats) -> Floats:
        """(3 Nv, ...) channels of features (Nv, 4, 2, ...), vertebra by vertebra."""
        found = np.einsum("vcki,vki...->vc...", self.basis, features)
        return found.reshape(CHANNELS * len(self.rows), *features.shape[3:])

    def turning(self, upper: int, lower: int) -> Floats:
        """(3 Nv,) weights of the channels that give the turn of vertebra ``upper`` against ``lower``, rad."""
        weights = np.zeros(CHANNELS * len(self.rows))
        for row, sign in ((upper, 1.0), (lower, -1.0)):
            weights[CHANNELS * row + 2] = sign / self.arms[row]
        return weights


def marking_errors(target: Target, channels: Channels) -> Floats:
    """Change of a target's channels per mm by which the marks of a vertebra lie off.

    Returns
    -------
    (Nv, 3, 11) mm/mm: of marks that are shifted along columns and rows and turned, as channels, then of what that
    leaves of each coordinate of a mark, along the box's edges. A box that all four marks place by Procrustes takes the
    first three alone. Three marks, or principal axes, give it a part of the rest: of the marks' own shape.
    """
    z, (corners, axes) = target.z, FEATURE_SHAPE
    placed = place_boxes(z, z, target.orientation, target.used[target.rows])
    arms = z - placed.centre[:, None]
    turned = np.stack([-arms[..., 1], arms[..., 0]], -1)
    moved = np.einsum("vl,ij->vilj", placed.centre_weights, np.eye(axes))[:, None]
    moved = moved + np.einsum("vki,vlj->vkilj", turned, placed.angle_gradient)
    slopes = np.einsum("vcki,vkilj->vclj", channels.basis, moved)
    told = np.einsum("vclj,vdlj->vcd", slopes, channels.basis)
    left = slopes - np.einsum("vcd,vdlj->vclj", told, channels.basis)
    along = z[:, 1] - z[:, 0]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    edges = np.stack([along, np.stack([-along[:, 1], along[:, 0]], -1)], -1)
    own = np.einsum("vclj,vje->vcle", left, edges).reshape(len(z), CHANNELS, corners * axes)
    # Exact zeros and ones where four marks place a box by Procrustes.
    return np.round(np.concatenate([told, own], axis=2), 12)


@dataclass(frozen=True, repr=False)
class PointChannels(ShortRepr):
    """From points to their channels, which are their coordinates.

    Attributes
    ----------
    rows : (P,) the points' vertebrae among the torso's, or numbers of markers.
    each : how many a point has.
    """

    rows: Ints
    each: int = 2

    def apply(self, features: Floats) -> Floats:
        """(each P, ...) channels of features (P, each, ...), point by point."""
        return np.asarray(features.reshape(self.each * len(self.rows), *features.shape[2:]))


def channels_of(target: Sight) -> Channels | PointChannels:
    """Of what a radiograph or cameras show."""
    if isinstance(target, Target):
        return Channels.of(target)
    return PointChannels(target.rows, target.z.shape[1])
