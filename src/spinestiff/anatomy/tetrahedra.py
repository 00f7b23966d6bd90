"""Tetrahedra by their corners: volumes and the angles between their faces."""

from __future__ import annotations

import numpy as np

from spinestiff.arrays import Floats


def signed_volumes(p: Floats) -> Floats:
    """(...,) mm3 of tetrahedra with corners (..., 4, 3); below 0 where inverted."""
    a, b, c = (p[..., i, :] - p[..., 0, :] for i in (1, 2, 3))
    return np.einsum("...i,...i->...", a, np.cross(b, c)) / 6.0


def dihedral_angles(p: Floats) -> Floats:
    """(..., 6) degrees, the angles between the faces of tetrahedra with corners (..., 4, 3)."""
    # Normals of the faces opposite each corner, all outward or all inward.
    a, b, c = (p[..., face, :] for face in ([1, 0, 0, 0], [2, 3, 1, 2], [3, 2, 3, 1]))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True) + 1e-30
    first, second = np.triu_indices(4, 1)
    cosine = -np.einsum("...fi,...fi->...f", normal[..., first, :], normal[..., second, :])
    return np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))


def least_angles(p: Floats) -> Floats:
    """(t,) degrees, the smallest dihedral angle of tetrahedra (t, 4, 3), or the smallest supplement of one."""
    angles = dihedral_angles(p)
    return np.minimum(angles, 180.0 - angles).min(-1)
