"""Raise the smallest dihedral angle of a tetrahedral mesh: edge and face swaps, constrained moves.

Quality of an element is the smallest of its dihedral angles and of their supplements, in degrees, so that flat
elements of both kinds score low; inverted ones score below zero.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np

EDGES = tuple(combinations(range(4), 2))
# For each edge the two other corners.
_OTHERS = tuple(tuple(n for n in range(4) if n not in edge) for edge in EDGES)
Moves = Callable[[int, np.ndarray], "np.ndarray | None"]


def volumes(p: np.ndarray) -> np.ndarray:
    """(...,) signed volumes of (..., 4, 3)."""
    a, b, c = (p[..., i, :] - p[..., 0, :] for i in (1, 2, 3))
    return (a * np.cross(b, c)).sum(-1) / 6.0


def quality(p: np.ndarray) -> np.ndarray:
    """(...,) degrees; see the module."""
    p = np.asarray(p, dtype=float)
    e = {(i, j): p[..., j, :] - p[..., i, :] for i, j in EDGES}
    # Outward face normals' angles; face i lies opposite corner i.
    n0 = _cross(e[1, 2], e[1, 3])
    n1 = _cross(e[0, 3], e[0, 2])
    n2 = _cross(e[0, 1], e[0, 3])
    n3 = _cross(e[0, 2], e[0, 1])
    normals = np.stack([n0, n1, n2, n3], -2)
    length = np.sqrt((normals * normals).sum(-1))
    cosine = np.einsum("...ij,...kj->...ik", normals, normals) / np.maximum(
        length[..., :, None] * length[..., None, :], 1e-12
    )
    worst = np.abs(np.stack([cosine[..., i, j] for i, j in EDGES], -1)).max(-1)
    angle = np.rad2deg(np.arccos(np.minimum(worst, 1.0)))
    return np.where(-(n3 * e[0, 3]).sum(-1) > 1e-6, angle, -1.0)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.stack(
        [
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ],
        -1,
    )


class Tetrahedra:
    """A mesh under change: points (n, 3) and elements by number, with the elements around each corner."""

    def __init__(self, points: np.ndarray, elements: np.ndarray) -> None:
        self.points = np.array(points, dtype=float)
        self.elements: dict[int, tuple[int, int, int, int]] = {}
        self.around: list[set[int]] = [set() for _ in range(len(points))]
        self._next = 0
        for element in elements.tolist():
            self._add(tuple(element))

    def array(self) -> np.ndarray:
        """(t, 4) elements."""
        return np.array([self.elements[k] for k in sorted(self.elements)], dtype=np.int64)

    def qualities(self) -> np.ndarray:
        """(t,) degrees, in the order of ``array``."""
        return quality(self.points[self.array()])

    def bad(self, wanted: float) -> list[int]:
        """Numbers of the elements below ``wanted``, worst first."""
        keys = np.array(sorted(self.elements))
        q = self.qualities()
        order = np.argsort(q, kind="stable")
        return [int(keys[i]) for i in order if q[i] < wanted]

    def _add(self, element: tuple[int, ...]) -> None:
        self.elements[self._next] = element  # type: ignore[assignment]
        for corner in element:
            self.around[corner].add(self._next)
        self._next += 1

    def replace(self, old: list[int], new: list[tuple[int, ...]]) -> None:
        """Exchange elements."""
        for key in old:
            for corner in self.elements.pop(key):
                self.around[corner].discard(key)
        for element in new:
            self._add(element)

    def sharing(self, corners: tuple[int, ...]) -> list[int]:
        """Elements around an edge or a face."""
        return sorted(set.intersection(*(self.around[c] for c in corners)))

    def oriented(self, candidates: np.ndarray) -> np.ndarray:
        """Elements (t, 4) turned to positive volume."""
        flip = volumes(self.points[candidates]) < 0.0
        candidates[flip] = candidates[flip][:, [1, 0, 2, 3]]
        return candidates

    def remove_edge(self, a: int, b: int) -> bool:
        """Retriangulate around an inner edge if that raises the worst quality there."""
        old = self.sharing((a, b))
        ring = self._ring(a, b, old)
        if ring is None or len(ring) > 7:
            return False
        before = quality(self.points[[self.elements[k] for k in old]]).min()
        triangles, value = self._best_triangulation(ring, a, b)
        if value <= before + 1e-9:
            return False
        new = [(x, y, z, w) for x, y, z in triangles for w in (a, b)]
        self.replace(old, [tuple(e) for e in self.oriented(np.array(new)).tolist()])
        return True

    def _ring(self, a: int, b: int, old: list[int]) -> list[int] | None:
        follows: dict[int, list[int]] = {}
        for key in old:
            x, y = (c for c in self.elements[key] if c not in (a, b))
            follows.setdefault(x, []).append(y)
            follows.setdefault(y, []).append(x)
        if len(old) < 3 or any(len(v) != 2 for v in follows.values()):
            return None  # on the boundary
        ring = [min(follows)]
        while len(ring) < len(follows):
            ahead = [v for v in follows[ring[-1]] if v not in ring]
            if not ahead:
                return None
            ring.append(ahead[0])
        return ring

    def _best_triangulation(self, ring: list[int], a: int, b: int) -> tuple[list[tuple[int, int, int]], float]:
        # Klincsek's dynamic programme over the ring's polygon.
        n = len(ring)
        triples = list(combinations(range(n), 3))
        corners = np.array([[ring[i], ring[j], ring[k]] for i, j, k in triples])
        side = volumes(self.points[np.column_stack([corners, np.full(len(corners), b)])])
        q = []
        for apex, sign in ((b, 1.0), (a, -1.0)):
            elements = np.column_stack([corners, np.full(len(corners), apex)])
            if sign < 0.0:
                elements = elements[:, [1, 0, 2, 3]]
            q.append(elements)
        # The ring may run either way round; every element must have the same sense.
        total = side[[t in {(0, i, i + 1) for i in range(1, n - 1)} for t in triples]].sum()
        if total < 0.0:
            q = [elements[:, [1, 0, 2, 3]] for elements in q]
        value = np.minimum(quality(self.points[q[0]]), quality(self.points[q[1]]))
        worth = dict(zip(triples, value.tolist()))
        best: dict[tuple[int, int], tuple[float, int]] = {(i, i + 1): (np.inf, -1) for i in range(n - 1)}
        for gap in range(2, n):
            for i in range(n - gap):
                j = i + gap
                best[i, j] = max((min(worth[i, k, j], best[i, k][0], best[k, j][0]), k) for k in range(i + 1, j))
        triangles, stack = [], [(0, n - 1)]
        while stack:
            i, j = stack.pop()
            if j - i > 1:
                k = best[i, j][1]
                triangles.append((ring[i], ring[k], ring[j]))
                stack += [(i, k), (k, j)]
        return triangles, best[0, n - 1][0]

    def remove_face(self, face: tuple[int, int, int]) -> bool:
        """Put an edge in place of an inner face (2 to 3 elements) if that raises the worst quality there."""
        old = self.sharing(face)
        if len(old) != 2:
            return False
        a, b = ((set(self.elements[k]) - set(face)).pop() for k in old)
        if self.sharing((a, b)):
            return False
        before = quality(self.points[[self.elements[k] for k in old]])
        total = volumes(self.points[[self.elements[k] for k in old]]).sum()
        new = np.array([(x, y, a, b) for x, y in combinations(face, 2)])
        size = np.abs(volumes(self.points[new]))
        if abs(size.sum() - total) > 1e-6 * total:
            return False  # the edge would leave the two elements
        new = self.oriented(new)
        if quality(self.points[new]).min() <= before.min() + 1e-9:
            return False
        self.replace(old, [tuple(e) for e in new.tolist()])
        return True

    def swap(self, wanted: float) -> int:
        """Swaps around all elements below ``wanted``; how many were done."""
        done = 0
        for key in self.bad(wanted):
            if key not in self.elements:
                continue
            element = self.elements[key]
            for i, j in EDGES:
                if self.remove_edge(element[i], element[j]):
                    done += 1
                    break
            if key in self.elements:
                for face in combinations(element, 3):
                    if self.remove_face(face):
                        done += 1
                        break
        return done

    def move(self, wanted: float, moves: Moves, rng: np.random.Generator, tries: int = 10) -> int:
        """Move the corners of elements below ``wanted`` where that raises the worst qualities around a corner."""
        corners = sorted({c for key in self.bad(wanted) for c in self.elements[key]})
        return sum(self._move(int(c), moves, rng, tries) for c in rng.permutation(corners))

    def _move(self, corner: int, moves: Moves, rng: np.random.Generator, tries: int) -> bool:
        star = np.array([self.elements[k] for k in sorted(self.around[corner])])
        p = self.points[star]
        here = star == corner
        old = self.points[corner].copy()
        size = np.sqrt(((p - old) ** 2).sum(-1).max())
        steps = size * 0.4 * rng.random(tries) ** 2
        directions = rng.standard_normal((tries, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        wanted = old + steps[:, None] * directions
        wanted[0] = 0.5 * (old + p.reshape(-1, 3).mean(0))
        allowed = [q for q in (moves(corner, w) for w in wanted) if q is not None]
        if not allowed:
            return False
        trial = np.repeat(p[None], len(allowed), 0)
        trial[:, here] = np.array(allowed)[:, None]
        values = np.sort(quality(trial), axis=1)[:, :3]
        before = np.sort(quality(p))[:3]
        best = max(range(len(allowed)), key=lambda i: tuple(values[i]))
        if tuple(values[best]) <= tuple(before):
            return False
        self.points[corner] = allowed[best]
        return True
