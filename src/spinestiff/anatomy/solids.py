"""Questions to closed surfaces of any origin: what lies inside, points spread over it, what lies where along a ray."""

from __future__ import annotations

import numpy as np

from spinestiff.anatomy.template.surfaces import Surface
from spinestiff.arrays import Floats, Ints


def dense_points(surface: Surface, step: float) -> Floats:
    """Points (n, 3) on a surface about ``step`` mm apart: no point of it lies farther than that from one."""
    corners = surface[0][surface[1]]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(1)
    parts = np.maximum(1, np.ceil(longest / step - 1e-6)).astype(int)
    points = []
    for k in np.unique(parts):
        i, j = np.nonzero(np.add.outer(np.arange(k + 1), np.arange(k + 1)) <= k)
        points.append((np.stack([i, j, k - i - j], -1) / k @ corners[parts == k]).reshape(-1, 3))
    every = np.vstack(points)
    # One a cell: triangles much smaller than the step would crowd.
    return every[first_of_rows(np.floor(every / (0.5 * step)))]


def first_of_rows(rows: Floats) -> Ints:
    """(m,) numbers, growing, of those rows (n, k) that no earlier one equals; a third of ``numpy.unique``'s time."""
    order = np.lexsort(rows.T)
    ordered = rows[order]
    new = np.ones(len(rows), dtype=bool)
    new[1:] = (ordered[1:] != ordered[:-1]).any(1)
    return np.sort(order[new])


def crossings(surface: Surface, points: Floats) -> tuple[Ints, Floats, Floats]:
    """Where vertical lines (along y) through points (n, 3) cross a surface.

    Returns the number of the point, the height y of the crossing in mm, and +1 where the line leaves the solid upwards,
    -1 where it enters; in no order.
    """
    vertices, faces = surface
    flat = vertices[:, [2, 0]]
    # A line through an edge or a vertex would count twice or not at all.
    at = np.asarray(points)[:, [2, 0]] + np.array([1.3e-5, 0.7e-5])
    corners = flat[faces]
    low, high = corners.min(1), corners.max(1)
    cell = float(np.clip(np.median(high - low), 1e-3, None)) * 1.5
    base = flat.min(0)
    wide = int(np.ceil((flat.max(0) - base)[1] / cell)) + 1
    first, last = (np.floor((v - base) / cell).astype(np.int64) for v in (low, high))
    inside = ((at >= base) & (at <= flat.max(0))).all(1)
    some = np.flatnonzero(inside)
    # Few lines through a large surface pass most of its triangles by.
    least, most = at[some].min(0, initial=np.inf), at[some].max(0, initial=-np.inf)
    near = np.flatnonzero(((high >= least) & (low <= most)).all(1))
    first, spans = first[near], (last - first + 1)[near]
    count = spans.prod(1)
    face = np.repeat(np.arange(len(near)), count)
    step = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    keys = (first[face, 0] + step // spans[face, 1]) * wide + first[face, 1] + step % spans[face, 1]
    order = np.argsort(keys, kind="stable")
    keys, face = keys[order], near[face[order]]
    mine = np.floor((at[some] - base) / cell).astype(np.int64) @ np.array([wide, 1])
    start, end = np.searchsorted(keys, mine, "left"), np.searchsorted(keys, mine, "right")
    number: list[Ints] = [np.zeros(0, dtype=np.int64)]
    height: list[Floats] = [np.zeros(0)]
    sense: list[Floats] = [np.zeros(0)]
    for part in np.array_split(np.arange(len(some)), max(1, int((end - start).sum()) // 3_000_000)):
        many = end[part] - start[part]
        p = np.repeat(some[part], many)
        f = face[np.arange(many.sum()) - np.repeat(np.cumsum(many) - many, many) + np.repeat(start[part], many)]
        a, b, c = (flat[faces[f, i]] - at[p] for i in range(3))
        wa, wb, wc = (v[:, 0] * w[:, 1] - v[:, 1] * w[:, 0] for v, w in ((b, c), (c, a), (a, b)))
        area = wa + wb + wc
        hit = ((wa > 0) & (wb > 0) & (wc > 0)) | ((wa < 0) & (wb < 0) & (wc < 0))
        y = vertices[faces[f[hit]], 1]
        number.append(p[hit])
        height.append((wa[hit] * y[:, 0] + wb[hit] * y[:, 1] + wc[hit] * y[:, 2]) / area[hit])
        sense.append(np.sign(area[hit]))
    return np.concatenate(number), np.concatenate(height), np.concatenate(sense)


def enclosed(surface: Surface, points: Floats) -> np.ndarray:
    """(n,) bool, whether points (n, 3) lie in a union of closed, outward pieces."""
    points = np.asarray(points, dtype=float)
    if not len(points):
        return np.zeros(0, dtype=bool)
    number, height, sense = crossings(surface, points)
    above = height > points[number, 1]
    return np.asarray(np.bincount(number[above], sense[above], len(points)) > 0.5)


def exits(surface: Surface, origins: Floats, direction: Floats) -> Floats:
    """(n,) distances along ``direction`` from points (n, 3) to where each leaves the solid; NaN for a point outside.

    Of overlapping pieces it leaves the last one.
    """
    d = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    e = np.cross(d, np.eye(3)[np.argmin(np.abs(d))])
    e /= np.linalg.norm(e)
    turned = np.stack([np.cross(d, e), d, e], -1)
    points = np.asarray(origins, dtype=float) @ turned
    number, height, sense = crossings((surface[0] @ turned, surface[1]), points)
    ahead = height - points[number, 1]
    number, ahead, sense = (v[ahead > 0.0] for v in (number, ahead, sense))
    order = np.lexsort((ahead, number))
    number, ahead, sense = number[order], ahead[order], sense[order]
    # How many pieces each ray is in at first, and still after each crossing: all that come later take it to none.
    pieces = np.bincount(number, sense, len(points))
    depth = np.cumsum(pieces)[number] - np.cumsum(sense)
    out = np.flatnonzero((depth < 0.5) & (pieces[number] > 0.5))
    ray, first = np.unique(number[out], return_index=True)
    found = np.full(len(points), np.nan)
    found[ray] = ahead[out[first]]
    return found
