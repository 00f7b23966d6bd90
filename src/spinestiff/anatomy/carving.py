"""What a Delaunay mesh has outside the skin comes off, so that a closed surface is left that nowhere pinches."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from spinestiff.anatomy.solids import enclosed
from spinestiff.anatomy.template.surfaces import Surface
from spinestiff.anatomy.tetrahedra import least_angles, signed_volumes
from spinestiff.arrays import Floats, Ints

_FACES = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]  # of a tetrahedron, outward


def carved(points: Floats, tetrahedra: Ints, on_skin: np.ndarray, skin: Surface, shell: cKDTree) -> Ints:
    """Those (k, 4) of tetrahedra (t, 4) that are the inside of a skin, as one part with a closed boundary.

    Tetrahedra between four corners of the skin come off where they lie outside it or flat on it; no bone is bared.
    Where the boundary would pinch, they stay.

    Parameters
    ----------
    points : (n, 3) mm. on_skin : (n,) bool. skin : closed, mm. shell : of points that lie on it densely.
    """
    corners = points[tetrahedra]
    middle = corners.mean(1)
    depth = shell.query(middle)[0] * np.where(enclosed(skin, middle), 1.0, -1.0)
    angle = least_angles(corners)
    wanted = on_skin[tetrahedra].all(1) & ((depth < -0.5) | (angle < 9.0) & (depth < 6.0) | (angle < 2.0))
    flat = np.abs(signed_volumes(corners)) < 1e-3
    alive = ~wanted
    while True:
        pinched = pinched_corners(tetrahedra[alive], len(points))
        back = ~alive & pinched[tetrahedra].any(1) & ~flat
        if not back.any():
            break
        alive |= back
    alive &= ~flat
    _peel(tetrahedra, alive, wanted, depth)
    # What hangs on by less than a face is no tissue.
    kept = tetrahedra[alive]
    return kept[_largest(kept)]


def _peel(tetrahedra: Ints, alive: np.ndarray, wanted: np.ndarray, depth: Floats) -> None:
    # What is still wanted off goes one by one, from outside inwards, where the boundary stays a closed surface.
    while True:
        kept = np.flatnonzero(alive)
        faces = tetrahedra[kept][:, _FACES].reshape(-1, 3)
        _, first, count = np.unique(np.sort(faces, 1), axis=0, return_index=True, return_counts=True)
        outer = first[count == 1]
        corners = set(faces[outer].ravel().tolist())
        edges = {frozenset(e) for f in faces[outer].tolist() for e in ((f[0], f[1]), (f[1], f[2]), (f[2], f[0]))}
        exposed: dict[int, list[list[int]]] = {}
        for face, owner in zip(faces[outer].tolist(), kept[outer // 4].tolist()):
            if wanted[owner]:
                exposed.setdefault(owner, []).append(face)
        ready = sorted(
            (k for k, bare in exposed.items() if _removable(tetrahedra[k].tolist(), bare, corners, edges)),
            key=lambda k: depth[k],
        )
        touched: set[int] = set()
        for k in ready:
            mine = tetrahedra[k].tolist()
            if touched.isdisjoint(mine):
                alive[k] = False
                touched.update(mine)
        if not ready:
            return


def _removable(corner: list[int], bare: list[list[int]], corners: set[int], edges: set[frozenset[int]]) -> bool:
    # Whether a tetrahedron with faces ``bare`` on the boundary can come off without pinching it.
    if len(bare) == 1:
        return (set(corner) - set(bare[0])).isdisjoint(corners)
    if len(bare) == 2:
        return frozenset(set(corner) - set(bare[0]) & set(bare[1])) not in edges
    return len(bare) == 3  # a tip: its outermost corner goes with it


def _largest(tetrahedra: Ints) -> np.ndarray:
    # (t,) bool, in the largest part that hangs together by faces.
    faces = np.sort(tetrahedra[:, _FACES].reshape(-1, 3), axis=1)
    _, inverse = np.unique(faces, axis=0, return_inverse=True)
    order = np.argsort(inverse.ravel(), kind="stable")
    same = np.flatnonzero(np.diff(inverse.ravel()[order]) == 0)
    a, b = order[same] // 4, order[same + 1] // 4
    graph = coo_array((np.ones(len(a)), (a, b)), shape=(len(tetrahedra), len(tetrahedra)))
    part = connected_components(graph, directed=False)[1]
    return np.asarray(part == np.argmax(np.bincount(part)))


def boundary(tetrahedra: Ints) -> Ints:
    """(s, 3) outward faces that belong to one tetrahedron."""
    faces = tetrahedra[:, _FACES].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, 1), axis=0, return_index=True, return_counts=True)
    return faces[np.sort(first[count == 1])]


def pinched_corners(tetrahedra: Ints, count: int) -> np.ndarray:
    """(count,) bool, corners around which the boundary is more than one fan, or an edge of which has four faces."""
    faces = boundary(tetrahedra)
    f = len(faces)
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], -1).reshape(
        -1, 2
    )  # edge 3 i + k runs from corner k of face i
    low, high = edges.min(1), edges.max(1)
    order = np.lexsort((high, low))
    key = (low * count + high)[order]
    pairs, times = np.unique(key, return_counts=True)
    same = np.flatnonzero(key[1:] == key[:-1])
    rows, columns = [], []
    for end in (0, 1):
        # The slot (face, corner) at the lower or the higher end of each edge, joined across the edge.
        at_low = edges[:, 0] == low
        here = at_low if end == 0 else ~at_low
        slot = np.where(here, np.arange(3 * f), 3 * (np.arange(3 * f) // 3) + (np.arange(3 * f) % 3 + 1) % 3)[order]
        rows.append(slot[same])
        columns.append(slot[same + 1])
    graph = coo_array((np.ones(2 * len(same)), (np.concatenate(rows), np.concatenate(columns))), shape=(3 * f, 3 * f))
    fan = connected_components(graph, directed=False)[1]
    fans = np.unique(np.stack([faces.ravel(), fan], -1), axis=0)[:, 0]
    pinched = np.bincount(fans, minlength=count) > 1
    heavy = pairs[times > 2]
    pinched[heavy // count] = pinched[heavy % count] = True
    return pinched
