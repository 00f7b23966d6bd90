"""What is compared of each thing that is seen, its channels: a vertebra's shifts and turn, a point's coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinestiff.arrays import Floats, Ints, ShortRepr
from spinestiff.estimation.objective import Target
from spinestiff.estimation.sights import Sight

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
