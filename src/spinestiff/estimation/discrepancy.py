"""What the model lacks, as a covariance of its motions (docs/discrepancy.md)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spinestiff.arrays import Floats, Ints
from spinestiff.mechanics.loads import LoadCase

MOTION_SD = 0.05


def discrepancy_covariance(
    loads: Sequence[LoadCase], rows: Sequence[Ints], motions: Sequence[Floats], vertebrae: Sequence[int]
) -> Floats:
    """(n, n) mm^2, covariance of the loaded frames' channels: motions that are too large, and more so up the spine."""
    ends = np.concatenate([[0], np.cumsum([len(m) for m in motions])])
    columns = np.zeros((int(ends[-1]), 2 * len(motions)))
    for i, (own, motion, count) in enumerate(zip(rows, motions, vertebrae)):
        height = np.repeat(1.0 - 2.0 * own / max(count - 1, 1), 3)
        columns[ends[i] : ends[i + 1], 0] = MOTION_SD * motion
        columns[ends[i] : ends[i + 1], 1] = MOTION_SD * motion * height
    return np.asarray(columns @ columns.T)
