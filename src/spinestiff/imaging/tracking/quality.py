"""How far a tracked corner can be trusted: its error, predicted from what tracking saw (docs/tracking.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinestiff.arrays import Floats
from spinestiff.imaging.features import VertebraCorners

# Correlation with the annotated frame up to which a patch counts as lost.
FOUND = 0.25
# The predicted error (mm) that halves quality: with it quality is an inverse variance, for weights.
HALVING_MM = 0.17
# Below this a corner is doubtful (0.26 mm predicted): most errors above 0.5 mm are, few others (docs/tracking.md).
DOUBTED_QUALITY = 0.3
# Corners tracked worse than this, by about 1.2 mm, count as lost.
LOWEST_QUALITY = 0.02
# Fewer corners that are not lost leave a vertebra's orientation to chance.
FEWEST_CORNERS = 3
# Error by the evidence: fitted on sequences of known truth (benchmarks/tracking.py --calibrate).
WEIGHTS = np.array([0.453, 0.034, 0.205])
WEIGHTS.setflags(write=False)


@dataclass(frozen=True)
class Evidence:
    """What tracking saw of a body in a frame, in mm at the patient plane.

    Attributes
    ----------
    scatter : (k,) of its marks, by the jackknife over parts of the patch: what covers a side, and noise.
    turned : motion of what lies before or behind the body against its outline: the body turned out of the picture's
        plane or moved across the beam, and its corners, which lie at different depths, moved against each other.
    likeness : correlation with the annotated frame.
    """

    scatter: Floats
    turned: float
    likeness: float

    def terms(self) -> Floats:
        """(k, 3), each of which explains a part of the error: two in mm, and how unlike the patch has become."""
        unlike = np.sqrt(max(1.0 - self.likeness, 0.0))
        shared = (self.turned, unlike)
        return np.column_stack([self.scatter, *(np.full(len(self.scatter), value) for value in shared)])


def predicted_error(evidence: Evidence) -> Floats:
    """(k,) mm, root mean square of a mark's distance from the truth."""
    return np.asarray(evidence.terms() @ WEIGHTS)


def quality_of(error: Floats) -> Floats:
    """Quality in 0..1 of predicted errors in mm: 1 for none, 1/2 at ``HALVING_MM``, 0 for infinite ones."""
    return np.asarray(1.0 / (1.0 + (error / HALVING_MM) ** 2))


def error_of(quality: Floats) -> Floats:
    """Predicted errors in mm of qualities; inverse of ``quality_of``, infinite for 0."""
    with np.errstate(divide="ignore"):
        return np.asarray(HALVING_MM * np.sqrt(1.0 / np.asarray(quality, dtype=float) - 1.0))


def usable_corners(corners: VertebraCorners) -> VertebraCorners:
    """The vertebrae with enough well-tracked corners, with all their corners.

    A vertebra is followed as a body, so that a worse corner lies off only as far as the body's turn does, which the
    others' places have as well. Placed by the others alone, the box would differ from that of the frames in which all
    four are well tracked by what the marks' shape differs from the box's.
    """
    keep = np.flatnonzero((corners.quality >= LOWEST_QUALITY).sum(1) >= FEWEST_CORNERS)
    return corners.selected(tuple(corners.vertebrae[i] for i in keep))
