"""The sizes of a person's own vertebrae: boxes, bone surfaces and the tissue tied to them, the rest left smooth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TET10_EDGES, BoneSurface, TissueMesh, TorsoModel
from spinestiff.arrays import Floats, Ints, read_only
from spinestiff.errors import TorsoError

# Factors beyond these belong to another species, or to corners in another unit.
SIZE_LIMITS = (0.5, 2.0)


def resized(torso: TorsoModel, factors: Floats) -> TorsoModel:
    """The torso with each vertebra's body scaled along its own axes (left, up, front), all bones in place.

    Boxes, bone surfaces and the nodes tied to a vertebra are scaled; arch and processes keep their size and go along
    with the body's walls (scaled about its centre, long processes would run into their neighbours). Free nodes follow
    harmonically (the graph Laplacian of the elements' edges), so that the mesh stays smooth. A node in the middle of an
    edge between two bones stays in the middle. Joints and what other bones carry stay.

    Parameters
    ----------
    factors : (V, 3), 0.5 to 2.

    Raises
    ------
    TorsoError : a factor out of range, or an element turned over.
    """
    factors = read_only("size factors", factors, (len(torso.vertebrae), 3), TorsoError)
    low, high = SIZE_LIMITS
    if factors.min() < low or factors.max() > high:
        worst = int(np.argmax(np.abs(np.log(factors)).max(1)))
        raise TorsoError(
            f"{torso.vertebrae[worst]} would be {factors[worst].round(2).tolist()} times its size (width, height, "
            f"depth); wanted {low} to {high}: check corners, pixel spacing and body height"
        )
    bones, rest, mesh = torso.vertebra_bones, torso.rest_pose, torso.tissue
    row_of = np.full(len(torso.bone_names), -1)
    row_of[bones] = np.arange(len(bones))
    half = np.abs(torso.vertebra_boxes).mean(1)

    def grown(offset: Floats, row: Ints) -> Floats:
        # What lies outside the body (arch, processes) goes along with its wall, at its own size.
        within = np.clip(offset, -half[row], half[row])
        return np.asarray((factors[row] - 1.0) * within * (row >= 0)[:, None])

    surfaces = tuple(
        surface
        if row < 0
        else BoneSurface(surface.vertices + grown(surface.vertices, np.full(len(surface.vertices), row)), surface.faces)
        for row, surface in zip(row_of.tolist(), torso.bone_surfaces)
    )
    tied, points = np.flatnonzero(mesh.bone_of_node >= 0), torso.tied_nodes
    moved = np.zeros_like(mesh.rest_positions)
    turn = rest.bone_rotations[points.bone]
    moved[tied] = np.einsum("nij,nj->ni", turn, grown(points.offset, row_of[points.bone]))
    nodes = mesh.rest_positions + spread(mesh, moved, mesh.bone_of_node >= 0)
    return replace(
        torso,
        vertebra_boxes=torso.vertebra_boxes * factors[:, None, :],
        bone_surfaces=surfaces,
        tissue=replace(mesh, rest_positions=nodes),
        rest_pose=TorsoState(rest.bone_positions, rest.bone_rotations, nodes[mesh.free_nodes]),
    )


def spread(mesh: TissueMesh, values: Floats, told: np.ndarray) -> Floats:
    """(N, 3) values of all nodes for those (N, 3) of the nodes that are ``told`` (N,).

    Any other corner has the mean of its neighbours' along edges, a node in an edge's middle that of the edge's ends: so
    straight elements stay straight, also where an edge runs from one bone to another.
    """
    values = np.array(values)
    corner = np.zeros(len(values), dtype=bool)
    corner[mesh.elements[:, :4]] = True
    a, b = np.triu_indices(4, k=1)
    rows, columns = mesh.elements[:, a].ravel(), mesh.elements[:, b].ravel()
    graph = sp.coo_array((np.ones(len(rows)), (rows, columns)), shape=(len(values), len(values))).tocsr()
    graph = graph + graph.T
    graph.data[:] = 1.0
    laplacian = (sp.diags_array(graph.sum(axis=1)) - graph).tocsr()
    free, tied = np.flatnonzero(corner & ~told), np.flatnonzero(corner & told)
    if len(free):
        # Tissue that hangs on no bone stays where it is.
        own = laplacian[free][:, free] + 1e-9 * sp.eye_array(len(free))
        values[free] = spla.splu(sp.csc_matrix(own)).solve(-(laplacian[free][:, tied] @ values[tied]))
    if mesh.elements.shape[1] == 10:
        for middle, (first, second) in enumerate(TET10_EDGES, start=4):
            ends = mesh.elements[:, [first, second]]
            values[mesh.elements[:, middle]] = values[ends].mean(1)
    return values
