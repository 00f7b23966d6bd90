"""Closed triangle surfaces by lofting: the building blocks of the template's bones and skin.

A surface here is a pair (vertices (n, 3) mm, faces (m, 3)) in world axes, outward oriented. Pieces of one bone may
overlap; each piece is closed by itself.
"""

from __future__ import annotations

import numpy as np

from spinestiff.arrays import Floats, Ints

Surface = tuple[Floats, Ints]


def signed_volume(surface: Surface) -> float:
    """Enclosed volume, mm3; negative if the faces point inwards."""
    vertices, faces = surface
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return float(np.einsum("ti,ti->", a, np.cross(b, c)) / 6.0)


def outward(surface: Surface) -> Surface:
    """The same surface with its faces turned outwards."""
    vertices, faces = surface
    return (vertices, faces[:, ::-1].copy()) if signed_volume(surface) < 0.0 else surface


def loft(rings: Floats) -> Surface:
    """Skin over rings (k, m, 3) that all run the same way round, closed by a fan at each end."""
    k, m, _ = rings.shape
    i, j = np.meshgrid(np.arange(k - 1), np.arange(m), indexing="ij")
    a, b = i * m + j, i * m + (j + 1) % m
    c, d = a + m, b + m
    # Diagonals that mirror each other about the middle of the ring keep a symmetric ring's loft symmetric.
    flip = (j >= m // 2)[..., None]
    first = np.where(flip, np.stack([a, b, c], -1), np.stack([a, b, d], -1))
    second = np.where(flip, np.stack([b, d, c], -1), np.stack([a, d, c], -1))
    ring = np.arange(m)
    bottom = np.stack([np.full(m, k * m), np.roll(ring, -1), ring], -1)
    top = np.stack([np.full(m, k * m + 1), (k - 1) * m + ring, (k - 1) * m + np.roll(ring, -1)], -1)
    faces = np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3), bottom, top])
    vertices = np.vstack([rings.reshape(-1, 3), rings[0].mean(0), rings[-1].mean(0)])
    return outward((vertices, faces.astype(np.int64)))


def tangents(curve: Floats) -> Floats:
    """Unit tangents (n, 3) of a polyline (n, 3)."""
    t = np.gradient(curve, axis=0)
    return t / np.linalg.norm(t, axis=1, keepdims=True)


def tube(curve: Floats, radii: Floats, tall: Floats, sides: int = 8) -> Surface:
    """Elliptic tube along a curve.

    Parameters
    ----------
    curve : (n, 3) mm.
    radii : (n, 2) mm, half sizes across and along ``tall``.
    tall : (3,) or (n, 3), direction of the second half size (made normal to the curve).
    """
    t = tangents(curve)
    up = np.broadcast_to(tall, curve.shape)
    up = up - np.einsum("ni,ni->n", up, t)[:, None] * t
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    across = np.cross(up, t)
    angle = 2.0 * np.pi * (np.arange(sides) + 0.5) / sides
    radii = np.broadcast_to(radii, (len(curve), 2))
    rings = (
        curve[:, None]
        + radii[:, None, :1] * np.cos(angle)[:, None] * across[:, None]
        + radii[:, None, 1:] * np.sin(angle)[:, None] * up[:, None]
    )
    return loft(rings)


def slab(sheet: Floats, thickness: Floats | float) -> Surface:
    """A curved plate: the sheet (k, m, 3) thickened by half ``thickness`` (mm, scalar or (k, m)) to both sides."""
    k, m, _ = sheet.shape
    du, dv = np.gradient(sheet, axis=0), np.gradient(sheet, axis=1)
    normal = np.cross(du, dv)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    half = 0.5 * np.broadcast_to(thickness, (k, m))[..., None] * normal
    vertices = np.concatenate([(sheet + half).reshape(-1, 3), (sheet - half).reshape(-1, 3)])
    index = np.arange(k * m).reshape(k, m)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    upper = np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])
    lower = upper[:, ::-1] + k * m
    rim = np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])
    nxt = np.roll(rim, -1)
    walls = np.concatenate([np.stack([rim, nxt, rim + k * m], -1), np.stack([nxt, nxt + k * m, rim + k * m], -1)])
    surface = (vertices, np.concatenate([upper, lower, walls]).astype(np.int64))
    return outward(_consistent(surface, len(walls)))


def _consistent(surface: Surface, walls: int) -> Surface:
    # The rim's walls must run each edge against the plates' direction.
    vertices, faces = surface
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    if len(np.unique(edges, axis=0)) == len(edges):
        return surface
    turned = faces.copy()
    turned[-walls:] = turned[-walls:, ::-1]
    return vertices, turned


def ball(centre: Floats, radii: Floats | float, rows: int = 6, sides: int = 10) -> Surface:
    """An ellipsoid with axes along the world's, half sizes ``radii``; poles along y."""
    latitude = np.linspace(-0.5 * np.pi, 0.5 * np.pi, rows + 2)[1:-1]
    angle = 2.0 * np.pi * (np.arange(sides) + 0.5) / sides
    ring = np.stack([np.cos(angle), np.zeros(sides), np.sin(angle)], -1)
    unit = np.cos(latitude)[:, None, None] * ring + np.sin(latitude)[:, None, None] * np.array([0.0, 1.0, 0.0])
    vertices, faces = loft(unit)
    vertices[-2:] = [[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]]
    return np.asarray(centre) + vertices * np.asarray(radii), faces


def joined(*pieces: Surface) -> Surface:
    """Closed pieces as one surface (they may overlap)."""
    offsets = np.cumsum([0] + [len(v) for v, _ in pieces[:-1]])
    return np.vstack([v for v, _ in pieces]), np.vstack([f + o for (_, f), o in zip(pieces, offsets)])


def mirrored(surface: Surface) -> Surface:
    """The mirror image about the plane x = 0."""
    vertices, faces = surface
    return vertices * np.array([-1.0, 1.0, 1.0]), faces[:, ::-1].copy()


def smooth_curve(points: Floats, n: int) -> Floats:
    """(n, 3) points at equal arc length on the cubic spline through ``points`` (k, 3), chord-length parameter."""
    from scipy.interpolate import CubicSpline

    points = np.asarray(points, dtype=float)
    chord = np.sqrt(np.linalg.norm(np.diff(points, axis=0), axis=1))  # centripetal: no loops at uneven spacing
    spline = CubicSpline(np.concatenate([[0.0], np.cumsum(chord)]), points, bc_type="natural")
    dense = spline(np.linspace(spline.x[0], spline.x[-1], 40 * max(n, 10)))
    return resampled(dense, n)


def resampled(curve: Floats, n: int) -> Floats:
    """(n, 3) points at equal arc length on a polyline."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    wanted = np.linspace(0.0, length[-1], n)
    return np.stack([np.interp(wanted, length, curve[:, i]) for i in range(3)], -1)


def arc_length(curve: Floats) -> float:
    """Length of a polyline, mm."""
    return float(np.linalg.norm(np.diff(curve, axis=0), axis=1).sum())


def superellipse(half_width: float, front: float, back: float, exponent: float, sides: int) -> Floats:
    """(sides, 2) points (x, z) of a superellipse that is ``front`` deep towards +z and ``back`` towards -z."""
    angle = 2.0 * np.pi * (np.arange(sides) + 0.5) / sides - 0.5 * np.pi
    c, s = np.cos(angle), np.sin(angle)
    x = half_width * np.sign(c) * np.abs(c) ** (2.0 / exponent)
    z = np.where(s >= 0.0, front, back) * np.sign(s) * np.abs(s) ** (2.0 / exponent)
    return np.stack([x, z], -1)


def inside(surface: Surface, points: Floats) -> np.ndarray:
    """(n,) bool, whether points (n, 3) lie in a union of closed, outward pieces (generalised winding number > 1/2)."""
    vertices, faces = surface
    points = np.asarray(points, dtype=float)
    found = np.zeros(len(points), dtype=bool)
    near = np.flatnonzero(((points >= vertices.min(0)) & (points <= vertices.max(0))).all(1))
    for some in np.array_split(near, max(1, len(near) * len(faces) // 2_000_000)):
        a, b, c = (vertices[faces[:, i]] - points[some][:, None] for i in range(3))
        la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
        triple = np.einsum("pfi,pfi->pf", a, np.cross(b, c))
        dots = (np.einsum("pfi,pfi->pf", u, v) * w for u, v, w in ((a, b, lc), (b, c, la), (c, a, lb)))
        solid = 2.0 * np.arctan2(triple, la * lb * lc + sum(dots))
        found[some] = solid.sum(1) > 2.0 * np.pi
    return found


def meet(one: Surface, other: Surface) -> bool:
    """Whether two closed surfaces cross each other, or one lies inside the other."""
    low = np.maximum(one[0].min(0), other[0].min(0))
    high = np.minimum(one[0].max(0), other[0].max(0))
    if (low > high).any():
        return False
    pairs = ((one, other), (other, one))
    if any(_pierced(edged, faced, low, high) for edged, faced in pairs):
        return True
    # Nothing crosses: a piece lies inside the other surface if one of its vertices does.
    return any(bool(inside(faced, edged[0][_one_of_each_piece(edged)]).any()) for edged, faced in pairs)


def _one_of_each_piece(surface: Surface) -> Ints:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n, a, b = len(surface[0]), surface[1].ravel(), np.roll(surface[1], 1, axis=1).ravel()
    piece = connected_components(coo_array((np.ones(len(a)), (a, b)), shape=(n, n)), directed=False)[1]
    return np.unique(piece, return_index=True)[1]


def _pierced(edged: Surface, faced: Surface, low: Floats, high: Floats) -> bool:
    # Whether an edge of one surface goes through a triangle of the other, inside the box they share.
    vertices, faces = edged
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = edges[edges[:, 0] < edges[:, 1]]  # a closed surface has each in both directions
    start, end = vertices[edges[:, 0]], vertices[edges[:, 1]]
    kept = ((np.minimum(start, end) <= high) & (np.maximum(start, end) >= low)).all(1)
    start, end = start[kept], end[kept]
    triangles = faced[0][faced[1]]
    triangles = triangles[((triangles.min(1) <= high) & (triangles.max(1) >= low)).all(1)]
    if not len(start) or not len(triangles):
        return False
    least, most, lowest, highest = np.minimum(start, end), np.maximum(start, end), triangles.min(1), triangles.max(1)
    overlap = np.ones((len(start), len(triangles)), dtype=bool)
    for axis in range(3):
        overlap &= least[:, None, axis] <= highest[:, axis]
        overlap &= most[:, None, axis] >= lowest[:, axis]
    i, j = np.nonzero(overlap)
    # Moeller and Trumbore 1997.
    along, corner = end[i] - start[i], triangles[j, 0]
    u, v = triangles[j, 1] - corner, triangles[j, 2] - corner
    normal = np.cross(along, v)
    determinant = np.einsum("ni,ni->n", u, normal)
    parallel = np.abs(determinant) < 1e-12
    determinant = np.where(parallel, 1.0, determinant)
    gap = start[i] - corner
    turned = np.cross(gap, u)
    first = np.einsum("ni,ni->n", gap, normal) / determinant
    second = np.einsum("ni,ni->n", along, turned) / determinant
    share = np.einsum("ni,ni->n", v, turned) / determinant
    hit = (first >= 0.0) & (second >= 0.0) & (first + second <= 1.0) & (share >= 0.0) & (share <= 1.0)
    return bool((hit & ~parallel).any())
