"""Plane geometry of pictures: cross products, rotations, and by how much a figure has turned."""

from __future__ import annotations

import numpy as np

from spinestiff.arrays import Floats


def cross(a: Floats, b: Floats) -> Floats:
    """The third component of the cross product of vectors (..., 2)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def rotation(angle: float) -> Floats:
    """(2, 2) rotation by an angle in rad, from the first axis towards the second."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine], [sine, cosine]])


def turns(start: Floats, end: Floats, weights: Floats | None = None) -> Floats:
    """(...,) rad by which figures of n points (..., n, 2) turn, by least squares, each about its own centre.

    atan2(sum w a x b, sum w a . b) of points a before and b after, from their centres: the planar case of Procrustes'
    problem (Gower and Dijksterhuis 2004). ``weights``: (n,), of each point; all alike if left out.
    """
    share = np.full(start.shape[-2], 1.0 / start.shape[-2]) if weights is None else weights / weights.sum()
    a, b = (figure - np.expand_dims(share @ figure, -2) for figure in (start, end))
    return np.asarray(np.arctan2(cross(a, b) @ share, np.sum(a * b, axis=-1) @ share))
