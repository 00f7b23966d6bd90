"""What is safely repairable in a bone's surface, and what is not: closed and outward in the end, or refused by name.

Closed means that the directed edges of all triangles cancel: then what lies inside is well defined (generalised winding
number), whether or not pieces overlap or four triangles share an edge.
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from spinestiff.anatomy.solids import enclosed
from spinestiff.anatomy.template.surfaces import Surface, signed_volume
from spinestiff.arrays import Floats, Ints
from spinestiff.errors import TorsoError
from spinestiff.words import counted

MOST_FACES = 12_000  # of a bone, in the torso; finer ones are thinned
SPECK = 0.02  # share of the bone's size below which a loose piece is dropped
MOST_HOLE = 0.06  # share of the surface that may be closed by a patch
MOST_TURNED = 0.5


def repaired(name: str, surface: Surface) -> tuple[Surface, list[str]]:
    """A closed, outward surface (mm), and in words what was done to get it.

    Raises
    ------
    TorsoError : naming the mesh: flat, a large hole, or no volume.
    """
    notes: list[str] = []
    surface = _merged(surface)
    if len(surface[1]) > MOST_FACES:
        surface = thinned(surface, MOST_FACES)
        notes.append(f"{name}: thinned to {len(surface[1])} triangles")
    surface, dropped = _without_repeats(surface)
    if dropped:
        notes.append(f"{name}: {counted(dropped, 'triangle')} without area or there twice left out")
    if not len(surface[1]):
        raise TorsoError(f"{name} has no triangle with an area")
    surface, specks = _without_specks(surface)
    if specks:
        notes.append(f"{name}: {counted(specks, 'loose speck')} left out")
    surface, turned = _consistent(surface)
    surface, area, holes = _closed(name, surface)
    if holes:
        notes.append(f"{name}: {counted(holes, 'hole')} closed ({area:.1f} mm2)")
    surface, inwards, pieces = _outward(surface)
    if turned:
        notes.append(f"{name}: {counted(turned, 'triangle')} turned round to match the others")
    if inwards:
        which = "it" if inwards == pieces else f"{inwards} of its {pieces} pieces"
        notes.append(f"{name}: {which} faced inwards and was turned")
    extent = np.ptp(surface[0], axis=0)
    if signed_volume(surface) < 1e-4 * max(float(np.prod(extent)), float(extent.max()) ** 3 * 1e-3):
        raise TorsoError(f"{name} encloses no volume; wanted a closed surface")
    return surface, notes


def edges_of(faces: Ints) -> Ints:
    """(3 m, 2) directed edges; edge k belongs to triangle k % m."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def thinned(surface: Surface, most: int) -> Surface:
    """A coarser surface with at most ``most`` triangles: vertices in a cell of a grid become one, at their mean.

    Clustering keeps a closed surface closed (directed edges still cancel).
    """
    vertices, faces = surface
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    cell = float(np.sqrt(2.0 * area / most))
    while True:
        keys = np.floor((vertices - vertices.min(0)) / cell).astype(np.int64)
        _, group, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
        group = group.ravel()
        centre = np.stack([np.bincount(group, vertices[:, i]) / count for i in range(3)], -1)
        coarse, _ = _without_repeats((centre, group[faces]), cancel=True)
        if len(coarse[1]) <= most:
            return coarse
        cell *= 1.15


def _merged(surface: Surface) -> Surface:
    # STL files repeat a vertex in each of its triangles.
    vertices, faces = surface
    size = float(np.ptp(vertices[np.unique(faces)], axis=0).max()) or 1.0
    _, first, number = np.unique(np.round(vertices / (1e-6 * size)), axis=0, return_index=True, return_inverse=True)
    vertices, faces = vertices[first], number.ravel()[faces]
    used, number = np.unique(faces, return_inverse=True)
    return vertices[used], number.reshape(faces.shape)


def _without_repeats(surface: Surface, cancel: bool = False) -> tuple[Surface, int]:
    # Also of two triangles on the same corners only one stays or, where they face each other (``cancel``), none.
    vertices, faces = surface
    corners = np.sort(faces, axis=1)
    distinct = (corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2])
    kept = np.flatnonzero(distinct)
    parity = np.where(
        (np.argsort(faces[kept], axis=1) == [0, 1, 2]).all(1)
        | (np.argsort(faces[kept], axis=1) == [1, 2, 0]).all(1)
        | (np.argsort(faces[kept], axis=1) == [2, 0, 1]).all(1),
        1,
        -1,
    )
    _, first, group = np.unique(corners[kept], axis=0, return_index=True, return_inverse=True)
    if cancel:
        net = np.bincount(group.ravel(), parity)
        chosen = kept[first][net != 0]
        wrong = parity[first][net != 0] * net[net != 0] < 0
        some = faces[chosen].copy()
        some[wrong] = some[wrong][:, ::-1]
    else:
        some = faces[kept[np.sort(first)]]
    used, number = np.unique(some, return_inverse=True)
    return (vertices[used], number.reshape(some.shape)), len(faces) - len(some)


def _neighbours(faces: Ints) -> tuple[Ints, Ints, np.ndarray]:
    # Pairs of triangles that share an edge with no third one, and whether they run it the same way (one is turned).
    directed = edges_of(faces)
    undirected = np.sort(directed, axis=1)
    _, inverse, count = np.unique(undirected, axis=0, return_inverse=True, return_counts=True)
    inverse = inverse.ravel()
    order = np.argsort(inverse, kind="stable")
    order = order[count[inverse[order]] == 2]
    first, second = order[::2], order[1::2]
    same = directed[first, 0] == directed[second, 0]
    return first % len(faces), second % len(faces), same


def _pieces(surface: Surface) -> Ints:
    # (m,) number of the connected piece of each triangle, by shared vertices.
    vertices, faces = surface
    a, b = edges_of(faces).T
    graph = coo_array((np.ones(len(a)), (a, b)), shape=(len(vertices), len(vertices)))
    return connected_components(graph, directed=False)[1][faces[:, 0]]


def _without_specks(surface: Surface) -> tuple[Surface, int]:
    vertices, faces = surface
    piece = _pieces(surface)
    size = np.array(
        [
            float(np.linalg.norm(np.ptp(vertices[faces[piece == p]].reshape(-1, 3), axis=0)))
            for p in range(piece.max() + 1)
        ]
    )
    small = size < SPECK * size.max()
    if not small.any():
        return surface, 0
    some = faces[~small[piece]]
    used, number = np.unique(some, return_inverse=True)
    return (vertices[used], number.reshape(some.shape)), int(small.sum())


def _consistent(surface: Surface) -> tuple[Surface, int]:
    # Neighbours run their common edge in opposite directions; how many triangles had to be turned for that.
    vertices, faces = surface
    first, second, same = _neighbours(faces)
    if not same.any():
        return surface, 0
    m = len(faces)
    graph = coo_array((np.where(same, 2.0, 1.0), (first, second)), shape=(m, m)).tocsr()
    graph = graph.maximum(graph.T).tocsr()
    patch = connected_components(graph, directed=False)[1]
    turn = np.zeros(m, dtype=bool)
    for p in range(patch.max() + 1):
        members = np.flatnonzero(patch == p)
        if len(members) == 1:
            continue
        order, before = breadth_first_order(graph, members[0], directed=False)
        for face in order[1:]:
            turn[face] = turn[before[face]] ^ (graph[face, before[face]] > 1.5)
        if turn[members].mean() > MOST_TURNED:
            turn[members] = ~turn[members]
    faces = faces.copy()
    faces[turn] = faces[turn][:, ::-1]
    return (vertices, faces), int(turn.sum())


def _rim(faces: Ints) -> Ints:
    # Directed edges that no other triangle runs backwards, each as often as it is left over.
    directed = edges_of(faces)
    undirected, inverse = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True)
    net = np.bincount(inverse.ravel(), np.where(directed[:, 0] < directed[:, 1], 1.0, -1.0)).astype(int)
    open_ = np.repeat(np.flatnonzero(net), np.abs(net[net != 0]))
    edges = undirected[open_]
    return np.where((net[open_] > 0)[:, None], edges, edges[:, ::-1])


def _loops(edges: Ints) -> list[list[int]]:
    # The rim as closed walks. Every vertex has as many edges in as out, since the rim is a boundary.
    ahead: dict[int, list[int]] = defaultdict(list)
    for a, b in edges.tolist():
        ahead[a].append(b)
    loops = []
    for start in sorted(ahead):
        while ahead[start]:
            walk = [start]
            while ahead[walk[-1]]:
                walk.append(ahead[walk[-1]].pop())
                if walk[-1] == start:
                    break
            loops += _simple(walk[:-1])
    return loops


def _simple(walk: list[int]) -> list[list[int]]:
    # A closed walk cut into loops that pass each vertex once.
    loops: list[list[int]] = []
    path: list[int] = []
    for vertex in walk:
        if vertex in path:
            cut = path.index(vertex)
            loops.append(path[cut:])
            path = path[:cut]
        path.append(vertex)
    return [loop for loop in [*loops, path] if len(loop) > 1]


def _closed(name: str, surface: Surface) -> tuple[Surface, float, int]:
    # Every hole gets a fan around its middle, if that is a small part of the surface.
    vertices, faces = surface
    whole = _area(surface)
    patched, holes = 0.0, 0
    for loop in _loops(_rim(faces)):
        if len(loop) == 2:
            continue  # an edge left over both ways
        patch, area = _fan(vertices, np.array(loop))
        if area > MOST_HOLE * whole:
            where = vertices[loop].mean(0)
            raise TorsoError(
                f"{name} has a hole of {area * 1e-2:.1f} cm2 at ({where[0]:.0f}, {where[1]:.0f}, {where[2]:.0f}) mm, "
                f"{area / whole:.0%} of its surface; at most {MOST_HOLE:.0%} are closed, so close it in the mesh"
            )
        patched, holes = patched + area, holes + 1
        centre = vertices[loop].mean(0)
        faces = np.vstack([faces, np.where(patch < 0, len(vertices), patch)])
        vertices = np.vstack([vertices, centre])
    return (vertices, faces), patched, holes


def _fan(vertices: Floats, loop: Ints) -> tuple[Ints, float]:
    # Triangles that run the loop backwards around a centre (-1), and their area.
    nxt = np.roll(loop, -1)
    centre = vertices[loop].mean(0)
    area = 0.5 * np.linalg.norm(np.cross(vertices[loop] - centre, vertices[nxt] - centre), axis=1).sum()
    return np.stack([nxt, loop, np.full(len(loop), -1)], -1), float(area)


def _area(surface: Surface) -> float:
    a, b, c = (surface[0][surface[1][:, i]] for i in range(3))
    return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def _outward(surface: Surface) -> tuple[Surface, int, int]:
    # Pieces that face inwards are turned, and with each what lies whole inside it: a cavity faces against what is
    # around it, a piece that another one overlaps does not.
    vertices, faces = surface
    piece = _pieces(surface)
    count = int(piece.max()) + 1
    volume = np.array([signed_volume((vertices, faces[piece == p])) for p in range(count)])
    inward = volume < -1e-6 * np.abs(volume).max()
    if not inward.any():
        return surface, 0, count
    turn = np.zeros(count, dtype=bool)
    for p in np.argsort(-np.abs(volume), kind="stable"):
        probes = vertices[faces[piece == p]].mean(1)
        larger = [q for q in range(count) if q != p and abs(volume[q]) > abs(volume[p])]
        around = [q for q in larger if enclosed((vertices, _turned(faces[piece == q], inward[q])), probes).all()]
        turn[p] = turn[around[0]] if around else inward[p]
    faces = faces.copy()
    chosen = turn[piece]
    faces[chosen] = faces[chosen][:, ::-1]
    return (vertices, faces), int(turn.sum()), count


def _turned(faces: Ints, wanted: bool) -> Ints:
    return faces[:, ::-1] if wanted else faces
