"""GLB for any viewer: skin and bones as shaded surfaces, through trimesh."""

from __future__ import annotations

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.errors import TorsoError

_MM = 1e-3
_SKIN = (222, 200, 186, 70)
# By the first letters of a bone's name; the longest that fits counts.
_COLOURS = {
    "": (227, 218, 201),
    "T": (240, 226, 182),
    "L": (236, 212, 150),
    "pelvis": (214, 190, 150),
    "R": (230, 220, 190),
}


def content(torso: TorsoModel, state: TorsoState) -> bytes:
    """The file: a node a bone by name and "skin"; metres (glTF's unit), y up, z to the patient's front.

    Raises TorsoError for a torso without surfaces.
    """
    if not (torso.bone_surfaces or len(torso.tissue.elements)):
        raise TorsoError("this torso has no surfaces, of bones or of tissue, that a GLB could show")
    import trimesh
    from trimesh.visual.material import PBRMaterial

    scene = trimesh.Scene()

    def add(name: str, vertices: np.ndarray, faces: np.ndarray, colour: tuple[int, ...]) -> None:
        # glTF's default is metal, which looks black without surroundings.
        material = PBRMaterial(
            name=name, baseColorFactor=[*colour, 255][:4], metallicFactor=0.0, roughnessFactor=0.7,
            alphaMode="BLEND" if len(colour) > 3 else "OPAQUE", doubleSided=True,
        )  # fmt: skip
        mesh = trimesh.Trimesh(vertices * _MM, faces, process=False)
        mesh.visual = trimesh.visual.TextureVisuals(material=material)
        _ = mesh.vertex_normals  # exported only where known
        scene.add_geometry(mesh, node_name=name, geom_name=name)

    for i, (name, surface) in enumerate(zip(torso.bone_names, torso.bone_surfaces)):
        colour = _COLOURS[max((key for key in _COLOURS if name.startswith(key)), key=len)]
        add(name, torso.surface_positions(state, i), np.array(surface.faces), colour)
    if len(torso.tissue.elements):
        faces = torso.tissue.boundary_faces()[:, :3]
        used, number = np.unique(faces, return_inverse=True)
        add("skin", torso.node_positions(state)[used], number.reshape(faces.shape), _SKIN)
    return bytes(scene.export(file_type="glb", include_normals=True))
