"""How far the picture has moved since the first frame: one number a frame, from dense optical flow."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from spinestiff.arrays import Floats
from spinestiff.imaging.tracking.flow import dense_flow
from spinestiff.imaging.tracking.pictures import as_bytes, block_means, matched

LONGEST_SIDE = 256
"""Pixels of the picture that flow sees: a push moves the trunk by some of them, and noise is averaged away."""
CELL = 8
"""Of these pixels, along a cell in which the flow is averaged."""
PLAINEST = 0.5
"""Cells with less texture than this share of the median tell no motion."""


def motion_course(frames: Iterable[NDArray[np.float32]]) -> Floats:
    """(F,) motion of the picture since the first frame, pixels: the course of the pattern that moves most.

    The flow from the first frame to each other one, averaged in cells, is split into patterns by singular values. The
    first one's course is returned, its size the root mean square over the cells, its sign such that the largest
    motion is above 0. What moves otherwise, as the diaphragm under a push, counts as far as it goes along with it.

    Parameters
    ----------
    frames : (H, W) each, of one size; each is taken once.
    """
    small = []
    for frame in frames:
        factor = max(1, -(-max(frame.shape) // LONGEST_SIDE))
        small.append(as_bytes(block_means(frame, factor)))
    first = small[0]
    flows = [np.zeros((*first.shape, 2), np.float32)]
    flows += [dense_flow(first, matched(frame, first)) for frame in small[1:]]
    cells = np.stack([_cells(flow) for flow in flows])
    rows, columns = np.gradient(first.astype(float))
    texture = _cells(np.hypot(rows, columns)[..., None])[..., 0]
    kept = cells[:, texture >= PLAINEST * np.median(texture)].reshape(len(small), -1).astype(float)
    left, sizes, _ = np.linalg.svd(kept, full_matrices=False)
    course: Floats = left[:, 0] * sizes[0] * factor / np.sqrt(kept.shape[1] / 2.0)
    course = course - course[0]
    return course if course[np.argmax(np.abs(course))] >= 0.0 else -course


def _cells(field: NDArray[np.floating]) -> Floats:
    """Means (R, C, K) over cells of a field (H, W, K); what fills no cell at the edges is left out."""
    side = min(CELL, *field.shape[:2])
    rows, columns = (n // side for n in field.shape[:2])
    blocks = field[: rows * side, : columns * side].reshape(rows, side, columns, side, -1)
    return np.asarray(blocks.mean(axis=(1, 3)), dtype=float)
