"""A skin of few, large triangles as a smooth one of the same volume: flat triangles make flat elements under them."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.optimize import brentq

from spinestiff.anatomy.template.surfaces import Surface, signed_volume
from spinestiff.arrays import Floats, Ints

# Of the spacing: longer edges are large, and subdivision ends at the finest.
LARGE, FINEST = 0.5, 0.4
ROUNDS = 8  # to the control points whose limit surface passes through the given ones


def rounded(skin: Surface, spacing: float) -> Surface:
    """The skin itself, or a smooth one where more than half of its area is in triangles with an edge above half of
    ``spacing``.

    It is Loop's subdivision of control points between the given vertices and those whose limit surface passes through
    these, such that the volume stays (if none of these has it, the nearest).

    Parameters
    ----------
    skin : closed and outward, mm. spacing : of the mesh's corners on it, mm.
    """
    import trimesh

    vertices, faces = skin
    corners = vertices[faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(1)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    if area[longest > LARGE * spacing].sum() <= 0.5 * area.sum() or not _each_edge_has_two_faces(faces):
        return skin
    times = max(1, int(np.ceil(np.log2(np.average(longest, weights=area) / (FINEST * spacing)))))
    through = _control_points(vertices, faces)
    wanted = signed_volume(skin)

    def surface(share: float) -> Surface:
        control = vertices + share * (through - vertices)
        points, triangles = trimesh.remesh.subdivide_loop(control, np.asarray(faces), iterations=times)
        return np.asarray(points, dtype=float), np.asarray(triangles, dtype=np.int64)

    def excess(share: float) -> float:
        return signed_volume(surface(share)) - wanted

    ends = excess(0.0), excess(1.0)
    if ends[0] * ends[1] > 0.0:
        return surface(float(np.argmin(np.abs(ends))))
    return surface(float(brentq(excess, 0.0, 1.0, xtol=1e-3)))


def _each_edge_has_two_faces(faces: Ints) -> bool:
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return bool((np.unique(edges, axis=0, return_counts=True)[1] == 2).all())


def _control_points(vertices: Floats, faces: Ints) -> Floats:
    # Where a vertex of valence k comes to in the limit of Loop's subdivision (Loop 1987): a mean of it and its
    # neighbours. Inverted by repeated correction, whose smoothness direct inversion lacks.
    edges = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    one, other = edges.T
    count = len(vertices)
    ones = np.ones(2 * len(edges))
    graph = sp.coo_array((ones, (np.r_[one, other], np.r_[other, one])), shape=(count, count)).tocsr()
    valence = np.maximum(np.bincount(edges.ravel(), minlength=count), 1)
    beta = (0.625 - (0.375 + 0.25 * np.cos(2.0 * np.pi / valence)) ** 2) / valence
    weight = 1.0 / (0.375 / beta + valence)
    control = np.array(vertices)
    for _ in range(ROUNDS):
        limit = (1.0 - valence * weight)[:, None] * control + weight[:, None] * (graph @ control)
        control = control + vertices - limit
    return control
