"""The reference body's tissue mesh carried to another body: bones with bones, skin with skin, the rest in between."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.sparse import coo_array
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from spinestiff.anatomy.template.assemble import Skeleton
from spinestiff.anatomy.template.trunk_skin import Skin
from spinestiff.anatomy.tetrahedra import dihedral_angles, signed_volumes
from spinestiff.anatomy.torso import TET10_EDGES, TissueMesh
from spinestiff.arrays import Floats, Ints
from spinestiff.errors import TorsoError

SMALLEST_DIHEDRAL_DEG = 4.0  # of a warped mesh; the shipped meshes have 16
REPAIR_DEG = 9.0  # corners of elements flatter than this are moved
BONE_ROOM, SKIN_ROOM = 4.0, 7.0  # mm that a corner in a bone, or on the skin, may move for that
NEIGHBOURS = 8  # vertices of a bone whose shifts a node near it takes


def warped_nodes(mesh: TissueMesh, old: Skeleton, new: Skeleton) -> Floats:
    """Where the nodes of the reference's tissue lie in another body.

    Corners tied to a bone follow the change of the bone's surface, corners on the skin keep their place in the skin's
    rows, those between take the skin's change plus a harmonic share of what the bones add to it; nodes in the middle
    of an edge stay there.

    Parameters
    ----------
    mesh : the reference's, ten-node, edges straight.
    old, new : the reference's skeleton and the other body's.

    Returns
    -------
    (N, 3) mm.

    Raises
    ------
    TorsoError : an element is inverted, or flatter than ``SMALLEST_DIHEDRAL_DEG``.
    """
    tetrahedra = mesh.elements[:, :4]
    corners = np.unique(tetrahedra)
    number = np.full(len(mesh.rest_positions), -1)
    number[corners] = np.arange(len(corners))
    at, t, bone = mesh.rest_positions[corners], number[tetrahedra], mesh.bone_of_node[corners]
    base = with_skin(at, old.skin, new.skin)
    added = np.zeros_like(base)
    for index in np.unique(bone[bone >= 0]).tolist():
        mine = bone == index
        added[mine] = with_bone(at[mine], old.surfaces[index][0], new.surfaces[index][0]) - base[mine]
    skin = np.zeros(len(at), dtype=bool)
    skin[number[np.unique(mesh.boundary_faces()[:, :3])]] = True
    fixed = skin | (bone >= 0)
    moved = base + harmonic(at, t, fixed, added)
    room = np.where(skin, SKIN_ROOM, np.where(bone >= 0, BONE_ROOM, np.inf))
    room[(at[:, 1] < old.skin.y[0] + 1.0) | (at[:, 1] > old.skin.y[-1] - 1.0)] = 0.0  # floor and lid stay flat
    moved = repaired(moved, t, mirror_images(at), room)
    check_quality(moved, t)
    nodes = np.array(mesh.rest_positions)
    nodes[corners] = moved
    for middle, (a, b) in enumerate(TET10_EDGES, start=4):
        nodes[mesh.elements[:, middle]] = 0.5 * (nodes[mesh.elements[:, a]] + nodes[mesh.elements[:, b]])
    return nodes


def with_skin(points: Floats, old: Skin, new: Skin) -> Floats:
    """(n, 3) mm, points that keep their place in the rows of the skin: level, breadth and depth; beyond the first and
    the last row, by as much as before."""
    x, y, z = points.T
    inside = np.clip(y, old.y[0], old.y[-1])
    level = PchipInterpolator(old.y, new.y)(inside)
    was, now = old.row(inside), new.row(level)
    depth = [np.where(z >= was[3], row[1] - row[3], row[3] - row[2]) for row in (was, now)]
    return np.stack([x * now[0] / was[0], level + y - inside, now[3] + (z - was[3]) * depth[1] / depth[0]], -1)


def with_bone(points: Floats, old: Floats, new: Floats) -> Floats:
    """(n, 3) mm, points that move with a bone's vertices (v, 3): by the affine map that fits those best, and by what it
    leaves at those near a point."""
    middle = old.mean(0)
    affine = np.linalg.lstsq(np.column_stack([old - middle, np.ones(len(old))]), new, rcond=None)[0]
    rest = new - np.column_stack([old - middle, np.ones(len(old))]) @ affine
    distance, nearest = cKDTree(old).query(points, k=min(NEIGHBOURS, len(old)))
    weight = 1.0 / (distance + 0.5) ** 2
    weight /= weight.sum(1, keepdims=True)
    moved = np.column_stack([points - middle, np.ones(len(points))]) @ affine
    return np.asarray(moved + np.einsum("nk,nkd->nd", weight, rest[nearest]))


def harmonic(points: Floats, tetrahedra: Ints, fixed: np.ndarray, values: Floats) -> Floats:
    """(n, 3) values at corners: given where ``fixed`` (n,), elsewhere the solution of Laplace's equation on linear
    tetrahedra."""
    p = points[tetrahedra]
    edges = np.swapaxes(p[:, 1:] - p[:, :1], 1, 2)
    inverse = np.linalg.inv(edges)
    gradient = np.concatenate([-inverse.sum(1, keepdims=True), inverse], axis=1)
    volume = np.abs(np.linalg.det(edges)) / 6.0
    local = volume[:, None, None] * gradient @ np.swapaxes(gradient, 1, 2)
    rows = np.broadcast_to(tetrahedra[:, :, None], local.shape)
    columns = np.broadcast_to(tetrahedra[:, None, :], local.shape)
    n = len(points)
    matrix = coo_array((local.ravel(), (rows.ravel(), columns.ravel())), shape=(n, n)).tocsc()
    free = np.flatnonzero(~fixed)
    known = np.flatnonzero(fixed)
    out = np.array(values)
    out[free] = splu(matrix[free][:, free].tocsc()).solve(-(matrix[free][:, known] @ values[known]))
    return out


def mirror_images(points: Floats) -> Ints:
    """(n,) the point that mirrors each one about x = 0: itself in the plane, -1 where there is none."""
    distance, other = cKDTree(points).query(points * [-1.0, 1.0, 1.0])
    return np.where(distance < 1e-3, other, -1)


def repaired(points: Floats, tetrahedra: Ints, mirror: Ints, room: Floats) -> Floats:
    """(n, 3) mm, corners of elements flatter than ``REPAIR_DEG`` moved to where the flattest element around is best.

    Parameters
    ----------
    mirror : (n,) mirror image of each corner, both are moved alike; -1: it has none.
    room : (n,) mm, how far a corner may go.
    """
    home, points = points, np.array(points)
    order = np.argsort(tetrahedra.ravel(), kind="stable")
    starts = np.searchsorted(tetrahedra.ravel()[order], np.arange(len(points) + 1))
    directions = np.array([d for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)], dtype=float) - 1.0
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for _ in range(30):
        worst = _worst_angles(points[tetrahedra])
        bad = np.unique(tetrahedra[worst < REPAIR_DEG])
        bad = bad[(room[bad] > 0.0) & ((mirror[bad] < 0) | (bad <= mirror[bad]))]
        improved = False
        for corner in bad.tolist():
            star = tetrahedra[order[starts[corner] : starts[corner + 1]] // 4]
            p = points[star]
            mine = star == corner
            image = (star == mirror[corner]) & ~mine
            length = np.linalg.norm(p - points[corner], axis=-1)[~mine].mean()
            steps = np.multiply.outer(length * np.array([0.3, 0.1, 0.03, 0.01]), directions).reshape(-1, 3)
            if mirror[corner] == corner:
                steps[:, 0] = 0.0
            steps = steps[np.linalg.norm(points[corner] + steps - home[corner], axis=1) <= room[corner]]
            if not len(steps):
                continue
            trial = p[None] + mine[None, ..., None] * steps[:, None, None]
            trial = trial + image[None, ..., None] * (steps * [-1.0, 1.0, 1.0])[:, None, None]
            reached = _worst_angles(trial).min(1)
            best = int(np.argmax(reached))
            if reached[best] > _worst_angles(p).min() + 0.01:
                points[corner] += steps[best]
                if mirror[corner] not in (-1, corner):
                    points[mirror[corner]] += steps[best] * [-1.0, 1.0, 1.0]
                improved = True
        if not improved:
            break
    return points


def _worst_angles(p: Floats) -> Floats:
    # Smallest dihedral angle of tetrahedra (..., 4, 3), degrees; below 0 where inverted, the more so the deeper.
    volume = signed_volumes(p)
    return np.where(volume > 0.0, dihedral_angles(p).min(-1), 6.0 * volume)


def check_quality(points: Floats, tetrahedra: Ints) -> None:
    """Raise TorsoError where a tetrahedron is inverted or too flat."""
    p = points[tetrahedra]
    volume = signed_volumes(p)
    angle = dihedral_angles(p).min(1)
    inverted, flat = int((volume <= 0.0).sum()), int((angle < SMALLEST_DIHEDRAL_DEG).sum())
    if inverted or flat:
        raise TorsoError(
            f"the tissue mesh does not fit this body: {inverted} of {len(p)} elements are inverted, {flat} have a "
            f"dihedral angle below {SMALLEST_DIHEDRAL_DEG:g} degrees; a body nearer to the usual one is wanted"
        )
