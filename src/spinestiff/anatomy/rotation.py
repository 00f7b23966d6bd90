"""Rotations of three-dimensional space: exponential, logarithm and what they need near zero.

Translation and rotation are kept apart (R3 x SO(3)); a rotation is updated from the left, ``R <- exp(w) R``.
"""

from __future__ import annotations

import numpy as np

from spinestiff.arrays import Floats


def cross_matrix(w: Floats) -> Floats:
    """``[w]x`` with ``[w]x v = w x v``. Shapes (..., 3) -> (..., 3, 3)."""
    w = np.asarray(w)
    matrix = np.zeros((*w.shape, 3), dtype=w.dtype)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrix[..., k, j] = w[..., i]
        matrix[..., j, k] = -w[..., i]
    return matrix


def cross(a: Floats, b: Floats) -> Floats:
    """a x b, shapes (..., 3); a tenth of ``numpy.cross``'s time on short arrays."""
    c = np.empty(np.broadcast_shapes(a.shape, b.shape))
    c[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    c[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    c[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return c


def exp_so3(w: Floats) -> Floats:
    """Rotation matrix of a rotation vector (Rodrigues). Shapes (..., 3) rad -> (..., 3, 3)."""
    w = np.asarray(w, dtype=float)
    angle2 = np.sum(w * w, axis=-1)[..., None, None]
    angle = np.sqrt(angle2)
    small = angle2 < 1e-8
    safe = np.where(small, 1.0, angle)
    # Series near zero: the closed forms divide by the angle.
    sine = np.where(small, 1.0 - angle2 / 6.0, np.sin(safe) / safe)
    cosine = np.where(small, 0.5 - angle2 / 24.0, 2.0 * (np.sin(0.5 * safe) / safe) ** 2)
    k = cross_matrix(w)
    return np.eye(3) + sine * k + cosine * (k @ k)


def log_so3(rotation: Floats) -> Floats:
    """Rotation vector of a rotation matrix, its length in [0, pi). Shapes (..., 3, 3) -> (..., 3) rad.

    Accurate to rounding for all angles below pi; at pi itself the axis' sign is arbitrary.
    """
    r = np.asarray(rotation, dtype=float)
    # Twice the sine times the axis; loses the axis near pi, where the symmetric part gives it.
    v = np.stack([r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]], -1)
    sine2 = np.linalg.norm(v, axis=-1)
    cosine2 = np.trace(r, axis1=-2, axis2=-1) - 1.0
    angle = np.arctan2(sine2, cosine2)
    small = sine2 < 1e-6
    ratio = np.where(small & (cosine2 > 0), 0.5 + angle**2 / 12.0, angle / np.where(small, 1.0, sine2))
    w = ratio[..., None] * v
    near_pi = (cosine2 < -1.0) & (sine2 < 1e-2)
    if np.any(near_pi):
        w = np.where(near_pi[..., None], _log_near_pi(r, v, angle), w)
    return w


def _log_near_pi(r: Floats, v: Floats, angle: Floats) -> Floats:
    # (R + R^T)/2 = cos I + (1 - cos) a a^T: the column of the largest diagonal entry holds the axis a.
    cosine = np.cos(angle)[..., None, None]
    outer = (0.5 * (r + np.swapaxes(r, -1, -2)) - cosine * np.eye(3)) / (1.0 - cosine)
    column = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    axis = np.take_along_axis(outer, column[..., None, None], axis=-1)[..., 0]
    axis = axis / np.linalg.norm(axis, axis=-1, keepdims=True)
    sign = np.where(np.sum(axis * v, axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    return sign * angle[..., None] * axis


def mean_rotation(a: Floats, b: Floats) -> Floats:
    """The rotation halfway between two, ``a exp(log(a^T b) / 2)``. Shapes (..., 3, 3)."""
    return a @ exp_so3(0.5 * log_so3(np.swapaxes(a, -1, -2) @ b))
