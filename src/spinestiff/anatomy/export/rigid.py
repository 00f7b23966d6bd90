"""What programs of rigid bodies need of a torso: mass and inertia of its bones, that it is at rest, numbers as text."""

from __future__ import annotations

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.template.surfaces import signed_volume
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.errors import TorsoError

# About that of whole bones with their marrow. The equilibria here are static: masses only keep other programs content.
BONE_KG_PER_MM3 = 1.3e-6
LEAST_KG = 1e-3


def masses(torso: TorsoModel) -> tuple[Floats, Floats]:
    """Masses (B,) kg, and inertia (B, 3) kg m2 about the bones' axes: of ellipsoids that fill their bounding boxes."""
    mass, inertia = np.full(len(torso.bone_names), LEAST_KG), np.zeros((len(torso.bone_names), 3))
    size = np.full((len(torso.bone_names), 3), 20.0)
    for i, surface in enumerate(torso.bone_surfaces):
        vertices = np.array(surface.vertices)
        mass[i] = max(LEAST_KG, BONE_KG_PER_MM3 * signed_volume((vertices, np.array(surface.faces))))
        size[i] = np.maximum(np.ptp(vertices, axis=0), 5.0)
    square = (0.5e-3 * size) ** 2
    for axis in range(3):
        others = [i for i in range(3) if i != axis]
        inertia[:, axis] = 0.2 * mass * square[:, others].sum(1)
    return mass, inertia


def require_rest(what: str, torso: TorsoModel, state: TorsoState) -> None:
    """Raise TorsoError where a bone or a node is not at rest in ``state``: a format's springs are, as it is written."""
    parts = ("bone_positions", "bone_rotations", "tissue_positions")
    if any(np.abs(getattr(state, part) - getattr(torso.rest_pose, part)).max(initial=0.0) > 1e-9 for part in parts):
        raise TorsoError(f"{what} is written at rest: its springs are at rest as it is written; export without a state")


def numbers(values: Floats) -> str:
    """Numbers for an XML attribute or element, all digits kept."""
    return " ".join(repr(float(v)) for v in np.ravel(values))
