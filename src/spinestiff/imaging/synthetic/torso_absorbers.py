"""What of a torso absorbs X-rays: skin, organs and bones as closed surfaces in a state."""

from __future__ import annotations

import numpy as np

from spinestiff.anatomy.names import LUMBAR, RIBS, VERTEBRAE
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.imaging.synthetic.materials import Material
from spinestiff.imaging.synthetic.organs import lungs, muscles, trachea
from spinestiff.imaging.synthetic.rendering import Absorber
from spinestiff.imaging.synthetic.texture import Texture

# mm of cortex. Vertebral walls 0.4 to 0.6 and endplates 0.6 to 1.0 (adult measurements, from memory); a rib is little
# but cortex, and the two walls of flat bones nearly meet.
_WALL, _ENDPLATE, _PROCESS = 0.5, 0.55, 0.4
_RIB_SHELL, _OTHER_SHELL = 0.8, 0.9
# Bone mineral inside, of a cortical bone's: a fifth to a quarter of a child's vertebral body is bone.
_CANCELLOUS = {"vertebra": 0.11, "rib": 0.22, "other": 0.2}
_TRABECULAE = 3.2  # mm, coarsest clumps of trabeculae that a radiograph shows; the finest are a quarter of it


def torso_absorbers(torso: TorsoModel, state: TorsoState, seed: int = 0, breath: float = 0.0) -> tuple[Absorber, ...]:
    """Skin, muscles, airways, lungs with vessels, and every bone of ``torso`` in ``state``.

    Bones carry a texture that moves with them; the skin's muscles and bowel stay in the world, as they hardly follow
    the spine.

    Parameters
    ----------
    seed : decides the patterns and so the person.
    breath : mm that the diaphragm stands lower than at rest.
    """
    bodies = [_skin(torso, state, seed), *muscles(torso, state), *trachea(torso, state)]
    bodies += lungs(torso, state, seed, breath)
    bodies += [_bone(torso, state, bone, seed) for bone in range(len(torso.bone_surfaces))]
    return tuple(bodies)


def skin_surface(torso: TorsoModel, state: TorsoState) -> tuple[Floats, np.ndarray]:
    """The torso's outside: vertices (n, 3) mm and faces (m, 3)."""
    faces = torso.tissue.boundary_faces()
    if faces.shape[1] == 6:
        a, b, c, ab, bc, ca = faces.T
        faces = np.vstack([np.column_stack(t) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    used, corners = np.unique(faces, return_inverse=True)
    return torso.node_positions(state)[used], corners.reshape(-1, 3)


def _skin(torso: TorsoModel, state: TorsoState, seed: int) -> Absorber:
    vertices, faces = skin_surface(torso, state)
    return Absorber(vertices, faces, texture=Texture(0.07, 30.0, seed + 1000), smoothing=3.5)


def _bone(torso: TorsoModel, state: TorsoState, bone: int, seed: int) -> Absorber:
    name = torso.bone_names[bone]
    surface = torso.bone_surfaces[bone]
    kind = "vertebra" if name in VERTEBRAE else "rib" if name in RIBS else "other"
    shell: Floats | float = {"rib": _RIB_SHELL, "other": _OTHER_SHELL}.get(kind, 0.0)
    if kind == "vertebra":
        shell = _vertebral_cortex(surface.vertices, torso.vertebra_boxes[VERTEBRAE.index(name)])
    grain = _TRABECULAE * (1.3 if name in LUMBAR else 1.0)
    texture = Texture(0.55, grain, seed + bone, state.bone_positions[bone], state.bone_rotations[bone])
    return Absorber(
        torso.surface_positions(state, bone), surface.faces, Material.BONE,
        _CANCELLOUS[kind], shell, 1.0 - _CANCELLOUS[kind], texture, 1.5 if kind == "other" else 0.0,
    )  # fmt: skip


def _vertebral_cortex(vertices: Floats, box: Floats) -> Floats:
    """Cortex (n,) mm of a vertebra's surface in its own frame: thicker where the body's endplates are."""
    low, high = box.min(axis=0), box.max(axis=0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    u = np.abs(vertices - middle) / half
    endplate = (u[:, 1] > 0.9) & (u[:, 1] < 1.2) & (u[:, 0] < 1.1) & (u[:, 2] < 1.1)
    return np.where(endplate, _ENDPLATE, np.where(vertices[:, 2] < low[2] - 6.0, _PROCESS, _WALL))
