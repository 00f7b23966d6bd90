"""VTU for ParaView: tissue and bones in one grid, through meshio."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel


def content(torso: TorsoModel, state: TorsoState) -> bytes:
    """The file: nodes of tissue and vertices of bones (mm), displacement from rest, bone, Lame's parameters.

    Cells are tetrahedra of tissue (``bone`` = -1), triangles of bones, and a vertex at each joint (``bone`` = -2).
    """
    import meshio

    tissue, rest = torso.tissue, torso.rest_pose
    places, moved, owner = [torso.node_positions(state)], [torso.node_positions(rest)], [tissue.bone_of_node]
    kind = "tetra10" if tissue.elements.shape[1] == 10 else "tetra"
    count = len(tissue.elements)
    cells: list[tuple[str, np.ndarray]] = [(kind, tissue.elements)] if count else []
    # One array a cell block, in the order of the blocks.
    data: dict[str, list[np.ndarray]] = {"bone": [], "lame_mu_mpa": [], "lame_lambda_mpa": []}

    def describe(bones: np.ndarray, mu: np.ndarray, lambda_: np.ndarray) -> None:
        for key, values in zip(data, (bones, mu, lambda_)):
            data[key].append(values)

    if count:
        describe(np.full(count, -1), tissue.lame_mu, tissue.lame_lambda)
    before = len(places[0])
    faces, bones = [], []
    for i, surface in enumerate(torso.bone_surfaces):
        places.append(torso.surface_positions(state, i))
        moved.append(torso.surface_positions(rest, i))
        owner.append(np.full(len(surface.vertices), i))
        faces.append(surface.faces + before)
        bones.append(np.full(len(surface.faces), i))
        before += len(surface.vertices)
    if faces:
        cells.append(("triangle", np.vstack(faces)))
        none = np.zeros(len(cells[-1][1]))
        describe(np.concatenate(bones), none, none)
    joints = torso.joints
    if len(joints):
        arms = np.einsum("jik,jk->ji", state.bone_rotations[joints.parent], joints.parent_position)
        places.append(state.bone_positions[joints.parent] + arms)
        arms = np.einsum("jik,jk->ji", rest.bone_rotations[joints.parent], joints.parent_position)
        moved.append(rest.bone_positions[joints.parent] + arms)
        owner.append(np.full(len(joints), -2))
        cells.append(("vertex", before + np.arange(len(joints))[:, None]))
        none = np.zeros(len(joints))
        describe(np.full(len(joints), -2), none, none)
    points = np.vstack(places)
    mesh = meshio.Mesh(
        points,
        cells,
        point_data={"displacement_mm": points - np.vstack(moved), "bone_of_node": np.concatenate(owner)},
        cell_data=data,
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "torso.vtu"
        mesh.write(path)
        return path.read_bytes()
