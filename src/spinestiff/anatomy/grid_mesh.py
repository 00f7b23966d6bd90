"""Tetrahedra over a grid of boxes: each box cut into six along the orders in which one can walk its axes (Kuhn)."""

from __future__ import annotations

import itertools

import numpy as np

from spinestiff.anatomy.torso import TET10_EDGES
from spinestiff.arrays import Floats, Ints

_KUHN = [[0, *np.cumsum([1 << axis for axis in order]).tolist()] for order in itertools.permutations(range(3))]


def grid_mesh(x: Floats, y: Floats, z: Floats, left_out: np.ndarray | None = None) -> tuple[Floats, Ints]:
    """Positions (N, 3) mm and elements (T, 4) of the boxes between rising grid lines.

    Parameters
    ----------
    x, y, z : mm, the lines.
    left_out : (len(x) - 1, len(y) - 1, len(z) - 1) bool, boxes without elements; nodes of these alone are dropped.
    """
    shape = (len(x), len(y), len(z))
    positions = np.stack(np.meshgrid(x, y, z, indexing="ij"), -1).reshape(-1, 3)
    number = np.arange(len(positions)).reshape(shape)
    nx, ny, nz = (n - 1 for n in shape)
    corners = np.stack(
        [number[i : nx + i, j : ny + j, k : nz + k].ravel() for k in (0, 1) for j in (0, 1) for i in (0, 1)], 1
    )
    if left_out is not None:
        corners = corners[~left_out.ravel()]
    elements = np.concatenate([corners[:, kuhn] for kuhn in _KUHN])
    edges = np.linalg.det(positions[elements[:, 1:]] - positions[elements[:, :1]])
    elements[edges < 0] = elements[edges < 0][:, [0, 2, 1, 3]]
    if left_out is None:
        return positions, elements
    used, inverse = np.unique(elements, return_inverse=True)
    return positions[used], inverse.reshape(elements.shape)


def quadratic(positions: Floats, elements: Ints) -> tuple[Floats, Ints]:
    """Ten-node elements from four-node ones by adding the middles of edges."""
    edges = np.sort(elements[:, np.array(TET10_EDGES)].reshape(-1, 2), axis=1)
    unique, inverse = np.unique(edges, axis=0, return_inverse=True)
    middles = 0.5 * positions[unique].sum(1)
    return np.vstack([positions, middles]), np.hstack([elements, len(positions) + inverse.reshape(-1, 6)])
