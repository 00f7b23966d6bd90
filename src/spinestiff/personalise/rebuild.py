"""Tissue meshed anew in a subject's skin around the subject's bones, where the carried mesh is no longer fit for use.

Needs a mesher (extra [mesh]). Bones, joints, boxes and landmarks stay as they are.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from spinestiff.anatomy.importing.carried_skin import refuse_bones_outside
from spinestiff.anatomy.meshing import DEFAULT_MESHER, SKIN_SHARE, SPACINGS_MM, TRIED_SHARES, find_mesher, mesh_tissue
from spinestiff.anatomy.names import BONES
from spinestiff.anatomy.rounding import rounded
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.template.surfaces import Surface
from spinestiff.anatomy.torso import TissueMesh, TorsoModel
from spinestiff.errors import TorsoError
from spinestiff.observer import Observer

# mm between corners inside, of a 157 cm body; nodes of a mesh with that spacing, and how their number falls with it:
# 0.8 to 1.5 times that were found.
SPACING_MM, REFERENCE_HEIGHT_CM = 34.0, 157.0
NODES_AT_SPACING, NODES_POWER = 6150.0, 2.3
NODES = (3_000, 65_000)
# Each try has other points; the first ones have the spacing of the nodes wanted, the last ones others.
AS_MANY_NODES = (*8 * (1.0,), *TRIED_SHARES[1:])


def can_rebuild(torso: TorsoModel) -> bool:
    """Whether the extra [mesh] is installed and the torso has the bones and the tissue that it meshes between."""
    if torso.bone_names != BONES or not torso.bone_surfaces or not len(torso.tissue.elements):
        return False
    try:
        find_mesher(DEFAULT_MESHER)
    except TorsoError:
        return False
    return True


def without_tissue(torso: TorsoModel, state: TorsoState) -> tuple[TorsoModel, TorsoState]:
    """The torso and a state of it with bones and joints alone."""
    none = np.zeros((0, 3))
    mesh = torso.tissue
    empty = replace(
        mesh,
        rest_positions=none,
        elements=np.zeros((0, mesh.elements.shape[1]), dtype=np.int64),
        bone_of_node=np.zeros(0, dtype=np.int64),
        lame_mu=np.zeros(0),
        lame_lambda=np.zeros(0),
    )
    bare = replace(torso, tissue=empty, rest_pose=replace(torso.rest_pose, tissue_positions=none))
    return bare, replace(state, tissue_positions=none)


def skin_of(torso: TorsoModel, state: TorsoState) -> Surface:
    """The boundary of the tissue in a state: the faces' corners (n, 3) mm and triangles (m, 3)."""
    faces = torso.tissue.boundary_faces()[:, :3]
    used, number = np.unique(faces, return_inverse=True)
    return torso.node_positions(state)[used], number.reshape(faces.shape)


def node_spacing(nodes: int, height_cm: float) -> float:
    """Distance in mm of the corners inside a mesh of about so many nodes, in a body of a height in cm.

    Raises
    ------
    TorsoError : it lies outside what is meshed (``meshing.SPACINGS_MM``); says how many nodes a body of this height
        can have.
    """
    at_reference = SPACING_MM * height_cm / REFERENCE_HEIGHT_CM
    spacing = at_reference * (nodes / NODES_AT_SPACING) ** (-1.0 / NODES_POWER)
    if not SPACINGS_MM[0] <= spacing <= SPACINGS_MM[1]:
        most, fewest = (NODES_AT_SPACING * (limit / at_reference) ** -NODES_POWER for limit in SPACINGS_MM)
        raise TorsoError(
            f"a tissue mesh of {nodes} nodes in a body of {height_cm:g} cm has {spacing:.1f} mm between corners, where "
            f"{SPACINGS_MM[0]:g} to {SPACINGS_MM[1]:g} mm can be meshed; choose {math.ceil(fewest)} to "
            f"{math.floor(most)} nodes, or another height"
        )
    return spacing


def with_new_tissue(
    bare: TorsoModel,
    skin: Surface,
    old: TorsoModel,
    state: TorsoState,
    observer: Observer | None = None,
    *,
    nodes: int,
    seed: int = 0,
) -> TorsoModel:
    """A torso without tissue filled anew, free of stress, up to a skin.

    Parameters
    ----------
    bare : bones at rest in their new places. skin : closed, world mm, around them.
    old, state : a torso in the state nearest to that; an element's moduli are those of the old element nearest to it.
    observer : is told each try.
    nodes : about how many (``NODES``). seed : of the mesh's points.

    Raises
    ------
    TorsoError : so few or many nodes make no mesh of a body of this height; a bone sticks out of the skin, or no mesh
        passes the mesher's gate.
    """
    spacing, rest = node_spacing(nodes, bare.height_cm), bare.rest_pose
    surfaces = {
        name: (bare.surface_positions(rest, i), bare.bone_surfaces[i].faces) for i, name in enumerate(bare.bone_names)
    }
    skin = rounded(skin, SKIN_SHARE * spacing)
    refuse_bones_outside(surfaces, skin)
    made = mesh_tissue(surfaces, skin, spacing, observer=observer, tried_shares=AS_MANY_NODES, seed=seed)
    middles = old.node_positions(state)[old.tissue.elements[:, :4]].mean(1)
    nearest = cKDTree(middles).query(made.nodes[made.elements[:, :4]].mean(1))[1]
    tissue = TissueMesh(
        made.nodes,
        made.elements,
        made.bone_of_node,
        old.tissue.lame_mu[nearest],
        old.tissue.lame_lambda[nearest],
    )
    return replace(bare, tissue=tissue, rest_pose=replace(rest, tissue_positions=made.nodes[tissue.free_nodes]))
