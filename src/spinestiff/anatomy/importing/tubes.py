"""Long bones as simple shapes: the centreline of a rib or a clavicle, the sphere of a humeral head."""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from spinestiff.anatomy.solids import dense_points
from spinestiff.anatomy.template.surfaces import Surface, resampled
from spinestiff.arrays import Floats
from spinestiff.errors import TorsoError

STATIONS = 41


def centreline(name: str, surface: Surface, step: float = 2.0) -> Floats:
    """(STATIONS, 3) mm, equal steps along a bone that is much longer than thick, from one end to the other.

    Distance is measured over the surface from one end; points equally far from it have their mean on the centreline.

    Raises
    ------
    TorsoError : the bone falls into pieces too far apart.
    """
    points = dense_points(surface, step)
    tree = cKDTree(points)
    graph = tree.sparse_distance_matrix(tree, 2.2 * step, output_type="coo_matrix").tocsr()
    piece = connected_components(graph, directed=False)[1]
    main = np.flatnonzero(piece == np.argmax(np.bincount(piece)))
    if len(main) < 0.9 * len(points):
        raise TorsoError(f"{name} is in pieces that don't touch; wanted one bone in one piece")
    points, graph = points[main], graph[main][:, main]
    # Twice across: the farthest point from anywhere is an end, and the farthest from there the other.
    distance = dijkstra(graph, indices=0)
    for _ in range(2):
        distance = dijkstra(graph, indices=int(np.argmax(distance)))
    thick = _thickness(points, distance)
    first = np.flatnonzero(distance <= thick)
    distance = dijkstra(graph, indices=first, min_only=True)
    last = float(np.quantile(distance, 0.999))
    edges = np.linspace(0.0, last, max(8, int(last / (1.5 * step))) + 1)
    bin_ = np.clip(np.digitize(distance, edges) - 1, 0, len(edges) - 2)
    inner = distance > 0.0
    count = np.bincount(bin_[inner], minlength=len(edges) - 1)
    some = count > 0
    means = np.stack(
        [np.bincount(bin_[inner], points[inner, i], len(edges) - 1)[some] / count[some] for i in range(3)], -1
    )
    means = _smoothed(means)
    # Out to the ends, along the direction there, as far as the bone goes.
    ends = []
    for here, inward in ((means[0], means[3]), (means[-1], means[-4])):
        out = (here - inward) / np.linalg.norm(here - inward)
        near = points[np.linalg.norm(points - here, axis=1) < 3.0 * thick]
        reach = float(np.quantile((near - here) @ out, 0.98)) if len(near) else 0.0
        ends.append(here + max(reach, 0.0) * out)
    return resampled(np.vstack([ends[0], means, ends[1]]), STATIONS)


def _thickness(points: Floats, distance: Floats) -> float:
    # Half the typical spread across, from slices of equal distance.
    edges = np.linspace(0.0, distance.max(), 25)
    bin_ = np.digitize(distance, edges)
    spreads = [float(np.linalg.norm(np.std(points[bin_ == b], axis=0))) for b in range(4, 22) if (bin_ == b).sum() > 4]
    return float(np.median(spreads)) if spreads else 3.0


def _smoothed(curve: Floats, rounds: int = 2) -> Floats:
    for _ in range(rounds):
        curve = np.vstack([curve[:1], 0.25 * curve[:-2] + 0.5 * curve[1:-1] + 0.25 * curve[2:], curve[-1:]])
    return curve


def fitted_sphere(
    points: Floats, radii: tuple[float, float], tries: int = 400, within: float = 1.0
) -> tuple[Floats, float]:
    """Centre (3,) and radius, mm, of the sphere with a radius in ``radii`` that most points (n, 3) lie on; NaN if
    there is none.

    Four points at a time give a candidate (fixed seed); its points then give the sphere by least squares.
    """
    rng = np.random.default_rng(0)
    best, count = (points.mean(0), float("nan")), 0
    for _ in range(tries):
        centre, radius = _through(points[rng.choice(len(points), 4, replace=False)])
        if not radii[0] <= radius <= radii[1]:
            continue
        on = int((np.abs(np.linalg.norm(points - centre, axis=1) - radius) < within).sum())
        if on > count:
            best, count = (centre, radius), on
    for _ in range(5 if count else 0):
        off = np.abs(np.linalg.norm(points - best[0], axis=1) - best[1])
        best = _through(points[off < 1.5 * within])
    return best


def _through(points: Floats) -> tuple[Floats, float]:
    # Least-squares sphere, linear in its centre and |centre|^2 - radius^2.
    a = np.column_stack([2.0 * points, np.ones(len(points))])
    solution = np.linalg.lstsq(a, (points**2).sum(1), rcond=None)[0]
    return solution[:3], float(np.sqrt(max(solution[3] + solution[:3] @ solution[:3], 0.0)))
