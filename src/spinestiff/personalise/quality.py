"""Is a tissue mesh still fit for computing after it was moved to a subject?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.tetrahedra import dihedral_angles
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.errors import TorsoError
from spinestiff.mechanics.tissue import QUADRATURE, rest_jacobians

# The Jacobian at an integration point over the straight-sided element's: 1 undistorted, below 0 inverted.
SMALLEST_J = 0.2
# Degrees; below, an element's stiffness grows beyond all others'.
SMALLEST_DIHEDRAL_DEG = 2.0


@dataclass(frozen=True)
class MeshQuality:
    """The worst element's shape.

    Attributes
    ----------
    smallest_j : Jacobian at an integration point over the straight-sided element's (1 for undistorted elements).
    smallest_dihedral_deg : angle between two faces of an element's corners.
    worst_element : number of the element of the smallest Jacobian.
    """

    smallest_j: float
    smallest_dihedral_deg: float
    worst_element: int

    @property
    def good(self) -> bool:
        """Whether both are within their limits."""
        return self.smallest_j >= SMALLEST_J and self.smallest_dihedral_deg >= SMALLEST_DIHEDRAL_DEG

    def __str__(self) -> str:
        return f"smallest J {self.smallest_j:.2f}, smallest dihedral angle {self.smallest_dihedral_deg:.1f} degrees"


def mesh_quality(torso: TorsoModel) -> MeshQuality:
    """The quality of the torso's tissue at rest, of elements that can deform (not whole in one bone)."""
    mesh = torso.tissue
    deformable = mesh.deformable
    if not len(deformable):
        return MeshQuality(1.0, 60.0, 0)
    elements = mesh.elements[deformable]
    points, _ = QUADRATURE[elements.shape[1]]
    jacobian, _ = rest_jacobians(mesh.rest_positions, elements, points)
    share = np.linalg.det(jacobian) / (6.0 * mesh.corner_volumes()[deformable, None])
    worst = int(np.argmin(share.min(1)))
    angle = float(dihedral_angles(mesh.rest_positions[elements[:, :4]]).min())
    return MeshQuality(float(share.min()), angle, int(deformable[worst]))


def require_quality(torso: TorsoModel) -> MeshQuality:
    """The mesh's quality; raises TorsoError where it is below the limits."""
    found = mesh_quality(torso)
    if not found.good:
        raise TorsoError(
            f"the tissue mesh is too distorted after the fit ({found}; wanted {SMALLEST_J} and "
            f"{SMALLEST_DIHEDRAL_DEG:g} degrees, element {found.worst_element})"
        )
    return found
