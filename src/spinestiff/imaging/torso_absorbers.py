"""What of a torso absorbs X-rays: skin, lungs and bones as closed surfaces in a state."""

from __future__ import annotations

import numpy as np

from spinestiff.anatomy.names import RIBS, SIDES, VERTEBRAE
from spinestiff.anatomy.torso import TorsoModel, TorsoState
from spinestiff.arrays import Floats, Ints
from spinestiff.imaging.rendering import (
    CANCELLOUS_BONE,
    CORTICAL_BONE,
    LUNG,
    SOFT_TISSUE,
    Absorber,
    Texture,
)

# mm of cortex; a vertebra's is thin, a rib is little but cortex. Flat bones stay solid: their two walls meet.
_VERTEBRA_SHELL = 0.8
_RIB_SHELL = 1.0
_LUNG_RIBS = range(2, 10)
_LUNG_RING = 24


def torso_absorbers(torso: TorsoModel, state: TorsoState, seed: int = 0) -> tuple[Absorber, ...]:
    """Skin, two lungs and every bone of ``torso`` in ``state``.

    Bones carry a texture that moves with them; the skin's muscles and bowel stay in the world, as they hardly follow
    the spine. ``seed`` decides the patterns and so the person.
    """
    bodies = [_skin(torso, state, seed)]
    bodies += [_lung(torso, state, side) for side in SIDES if f"R{_LUNG_RIBS[-1]}_{side}" in torso.bone_names]
    bodies += [_bone(torso, state, bone, seed) for bone in range(len(torso.bone_surfaces))]
    return tuple(bodies)


def _skin(torso: TorsoModel, state: TorsoState, seed: int) -> Absorber:
    faces = torso.tissue.boundary_faces()
    if faces.shape[1] == 6:
        a, b, c, ab, bc, ca = faces.T
        faces = np.vstack([np.column_stack(t) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    used, corners = np.unique(faces, return_inverse=True)
    vertices = torso.node_positions(state)[used]
    return Absorber(
        vertices, corners.reshape(-1, 3), SOFT_TISSUE, texture=Texture(0.1, 45.0, seed + 1000), smoothing=6.0
    )


def _bone(torso: TorsoModel, state: TorsoState, bone: int, seed: int) -> Absorber:
    name = torso.bone_names[bone]
    vertices, faces = torso.surface_positions(state, bone), torso.bone_surfaces[bone].faces
    shell = _VERTEBRA_SHELL if name in VERTEBRAE else _RIB_SHELL if name in RIBS else 0.0
    texture = Texture(0.8, 7.0, seed + bone, state.bone_positions[bone], state.bone_rotations[bone])
    return Absorber(vertices, faces, CANCELLOUS_BONE, shell, CORTICAL_BONE, texture)


def _lung(torso: TorsoModel, state: TorsoState, side: str) -> Absorber:
    """A closed tube of rings inside the ribs of one side, one ring a level, capped at both ends."""
    sign = 1.0 if side == "L" else -1.0
    rings = [_lung_ring(torso, state, side, sign, level) for level in _LUNG_RIBS]
    apex, base = rings[0].mean(axis=0) + [0.0, 12.0, 0.0], rings[-1].mean(axis=0) + [0.0, 22.0, 0.0]
    # The diaphragm bulges into the chest: the base's cap stands higher than its ring.
    vertices = np.vstack([*rings, apex, base])
    faces = _tube_faces(len(rings), _LUNG_RING)
    corners = vertices[faces]
    volume = np.einsum("mi,mi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    return Absorber(vertices, faces if volume > 0.0 else faces[:, ::-1], LUNG, smoothing=4.0)


def _lung_ring(torso: TorsoModel, state: TorsoState, side: str, sign: float, level: int) -> Floats:
    """(24, 3) mm: an oval between the mediastinum and the rib that lies at this level's height."""
    bone = torso.bone(f"T{level}")
    centre = state.bone_positions[bone]
    ribs = np.vstack([torso.surface_positions(state, torso.bone(f"R{i}_{side}")) for i in range(1, 11)])
    near = ribs[np.abs(ribs[:, 1] - centre[1]) < 14.0]
    outer = np.max(sign * (near[:, 0] - centre[0])) - 9.0
    back, front = np.min(near[:, 2]) + 10.0, np.max(near[:, 2]) - 12.0
    inner = min(24.0, 0.5 * outer)
    angle = 2.0 * np.pi * np.arange(_LUNG_RING) / _LUNG_RING
    # A superellipse: lungs fill the chest's corners better than an ellipse does.
    across, along = (np.sign(f) * np.abs(f) ** 0.7 for f in (np.cos(angle), np.sin(angle)))
    x = centre[0] + sign * (0.5 * (inner + outer) + 0.5 * (outer - inner) * across)
    z = 0.5 * (back + front) + 0.5 * (front - back) * along
    return np.column_stack([x, np.full(_LUNG_RING, centre[1]), z])


def _tube_faces(rings: int, around: int) -> Ints:
    i, j = np.meshgrid(np.arange(rings - 1), np.arange(around), indexing="ij")
    a, b = (i * around + j).ravel(), (i * around + (j + 1) % around).ravel()
    c, d = a + around, b + around
    wall = np.vstack([np.column_stack([a, b, d]), np.column_stack([a, d, c])])
    here = np.arange(around)
    after, last = (here + 1) % around, (rings - 1) * around
    top = np.column_stack([np.full(around, rings * around), after, here])
    bottom = np.column_stack([np.full(around, rings * around + 1), last + here, last + after])
    return np.vstack([wall, top, bottom])
