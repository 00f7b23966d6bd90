"""Ten-node tetrahedra that fill the skin and pass through sample points in the bones; built for the template.

The left half is meshed and mirrored, so that the torso answers mirrored loads with mirrored shapes. Steps: sample
points (bones, skin, inside), Delaunay, carve down to the skin, then swaps and moves that raise the smallest angle.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from improve import Tetrahedra, quality, volumes
from scipy.spatial import Delaunay, cKDTree

from spinestiff.anatomy.carving import pinched_corners
from spinestiff.anatomy.meshing import BURIED, GAP, farthest_points, spread_in_bone, under_surface
from spinestiff.anatomy.names import BONES
from spinestiff.anatomy.template.assemble import Skeleton
from spinestiff.anatomy.template.surfaces import Surface, inside, signed_volume
from spinestiff.anatomy.template.trunk_skin import Skin
from spinestiff.anatomy.torso import TET10_EDGES

WANTED_ANGLE = 16.0
VOLUME_TOLERANCE = 0.002  # a share; bending stiffness goes with the square of the cross-section
INSIDE, PLANE, SKIN, PLANE_SKIN, RIM, PLANE_RIM = range(6)
PLANAR = (PLANE, PLANE_SKIN, PLANE_RIM)


@dataclass(frozen=True)
class Spacing:
    """Wanted distances, mm: between points of a bone, on the skin, inside; and how far the corners of the skin are put
    outside it, to make up for the facets' cutting of its curves."""

    bone: float
    skin: float
    inside: float
    outwards: float


@dataclass
class HalfMesh:
    """The left half while it is improved: corners (n, 3), tetrahedra, place of each corner and its bone or -1."""

    points: np.ndarray
    tetrahedra: np.ndarray
    place: np.ndarray
    bone: np.ndarray


def bone_samples(
    surface: Surface, spacing: float, middle: bool, others: np.ndarray, skin: Skin, buried: float
) -> np.ndarray:
    """Points inside a bone, spread out, clear of those in other bones and ``buried`` mm under the skin where the bone
    allows; of a bone in the middle plane those with x >= 0."""
    candidates = under_surface(surface, (1.3, 2.5, 4.0))
    if middle:
        candidates = candidates[candidates[:, 0] >= -1e-9]
        near = candidates[:, 0] < 0.12 * spacing
        candidates[near, 0] = 0.0
        candidates = candidates[near | (candidates[:, 0] > 0.3 * spacing)]
    candidates = candidates[inside(surface, candidates)]
    candidates = np.unique(np.round(candidates, 3), axis=0)
    return spread_in_bone(candidates, skin.depth(candidates) > buried, spacing, others)


Stage = tuple[np.ndarray, int, float]  # candidates, their place, wanted distance


def sample(skeleton: Skeleton, spacing: Spacing) -> HalfMesh:
    """All corner points of the left half."""
    points, place, bones = [], [], []
    for index, name in enumerate(BONES):
        if name.endswith("_R"):
            continue
        middle = not name.endswith("_L")
        others = np.vstack([np.zeros((0, 3)), *points])
        buried = BURIED * spacing.skin
        found = bone_samples(skeleton.surfaces[index], spacing.bone, middle, others, skeleton.skin, buried)
        points.append(found)
        bones.append(np.full(len(found), index))
        place.append(np.where(middle & (found[:, 0] == 0.0), PLANE, INSIDE))
    bony = len(points)
    for candidates, kind, apart in (*skin_stages(skeleton.skin, spacing.skin), *inside_stages(skeleton.skin, spacing)):
        # The skin is sampled whatever bones lie under it: a bone must not come to lie on the boundary.
        near = points if kind in (INSIDE, PLANE) else [np.zeros((0, 3)), *points[bony:]]
        found = farthest_points(candidates, np.vstack(near), apart)
        points.append(found)
        place.append(np.full(len(found), kind))
        bones.append(np.full(len(found), -1))
    return HalfMesh(np.vstack(points), np.zeros((0, 4), dtype=int), np.concatenate(place), np.concatenate(bones))


def skin_stages(skin: Skin, h: float) -> list[Stage]:
    """Candidates on the left half of the skin, edges before faces: first the ends and the rims of floor and lid."""
    levels = np.linspace(skin.y[0], skin.y[-1], 240)
    rings = np.array([skin.ring(y, 360) for y in levels])
    left = rings[..., 0] > 0.3 * h
    _, front, back, _, _ = skin.row(levels)
    zero = np.zeros_like(levels)
    outline = np.vstack([np.stack([zero, levels, front], -1), np.stack([zero, levels, back], -1)])
    ends = np.array([[0.0, levels[i], side[i]] for i in (0, -1) for side in (front, back)])
    line = np.linspace(0.0, 1.0, 80)[:, None]
    middle = np.vstack([ends[0] + line * (ends[1] - ends[0]), ends[2] + line * (ends[3] - ends[2])])
    caps = []
    for ring in (rings[0], rings[-1]):
        axis = np.array([0.0, ring[0, 1], ring[:, 2].mean()])
        caps.append((axis + np.linspace(0.0, 1.0, 40)[:, None, None] * (ring - axis)).reshape(-1, 3))
    cap = np.vstack(caps)
    return [
        (ends, PLANE_RIM, 1.0),
        (np.vstack([rings[0][left[0]], rings[-1][left[-1]]]), RIM, h),
        (middle, PLANE_RIM, h),
        (outline, PLANE_SKIN, h),
        (rings[left], SKIN, h),
        (cap[cap[:, 0] > 0.4 * h], RIM, h),
    ]


def inside_stages(skin: Skin, spacing: Spacing) -> list[Stage]:
    """Candidates inside the left half, the middle plane first."""
    axes = np.arange(0.0, 190.0, 6.0), np.arange(skin.y[0], skin.y[-1], 6.0), np.arange(-130.0, 140.0, 6.0)
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    grid = grid[skin.depth(grid) > 0.55 * spacing.skin]
    h = spacing.inside
    return [(grid[grid[:, 0] == 0.0], PLANE, h), (grid[grid[:, 0] > 0.45 * h], INSIDE, h)]


def tetrahedralise(mesh: HalfMesh, skeleton: Skeleton) -> None:
    """Delaunay, carved down to the skin."""
    t = Delaunay(mesh.points, qhull_options="Qbb Qc Qz Q12").simplices
    planar = np.isin(mesh.place, PLANAR)
    t = t[~planar[t].all(1)]
    flip = volumes(mesh.points[t]) < 0.0
    t[flip] = t[flip][:, [1, 0, 2, 3]]
    mesh.tetrahedra = t
    _carve(mesh, skeleton)


def _cover(mesh: HalfMesh, skeleton: Skeleton) -> int:
    # Bones that came to lie on the boundary get a corner of the skin over them; how many were added.
    faces, _ = boundary(mesh.tetrahedra)
    faces = faces[~np.isin(mesh.place, PLANAR)[faces].all(1)]
    bare = np.unique(faces[mesh.bone[faces] >= 0])
    if not len(bare):
        return 0
    dense = skeleton.skin.surface(160, 240)[0][:-2]
    dense = dense[dense[:, 0] > 1.0]
    cover = np.unique(cKDTree(dense).query(mesh.points[bare])[1])
    mesh.points = np.vstack([mesh.points, dense[cover]])
    mesh.place = np.append(mesh.place, np.full(len(cover), SKIN))
    mesh.bone = np.append(mesh.bone, np.full(len(cover), -1))
    return len(cover)


def _carve(mesh: HalfMesh, skeleton: Skeleton) -> None:
    # Elements that lie outside the skin, or flat on it, come off; only such between four points of the skin, so that no
    # bone is bared. All at once leaves pinches: what touches one is put back. Then one by one, from the outside
    # inwards, where the boundary stays a closed surface.
    on_skin = np.isin(mesh.place, (SKIN, PLANE_SKIN, RIM, PLANE_RIM))
    p = mesh.points[mesh.tetrahedra]
    depth = skeleton.skin.depth(p.mean(1))
    wanted = on_skin[mesh.tetrahedra].all(1) & (
        (depth < -0.5) | (quality(p) < 9.0) & (depth < 6.0) | (quality(p) < 2.0)
    )
    alive = ~wanted
    while True:
        pinched = pinched_corners(mesh.tetrahedra[alive], len(mesh.points))
        back = ~alive & pinched[mesh.tetrahedra].any(1)
        if not back.any():
            break
        alive |= back
    while True:
        faces, owner = boundary(mesh.tetrahedra[alive])
        owner = np.flatnonzero(alive)[owner]
        corners = set(faces.ravel().tolist())
        edges = {frozenset(e) for f in faces.tolist() for e in ((f[0], f[1]), (f[1], f[2]), (f[2], f[0]))}
        exposed: dict[int, list[list[int]]] = {}
        for face, tetrahedron in zip(faces.tolist(), owner.tolist()):
            exposed.setdefault(tetrahedron, []).append(face)
        ready = sorted(
            (k for k in exposed if wanted[k] and _simple(mesh.tetrahedra[k], exposed[k], corners, edges)),
            key=lambda k: depth[k],
        )
        if not ready:
            break
        touched: set[int] = set()
        for k in ready:
            if touched.isdisjoint(mesh.tetrahedra[k].tolist()):
                alive[k] = False
                touched.update(mesh.tetrahedra[k].tolist())
    t = mesh.tetrahedra[alive]
    used = np.unique(t)
    number = np.full(len(mesh.points), -1)
    number[used] = np.arange(len(used))
    mesh.tetrahedra = number[t]
    mesh.points, mesh.place, mesh.bone = mesh.points[used], mesh.place[used], mesh.bone[used]


def _simple(tetrahedron: np.ndarray, exposed: list[list[int]], corners: set[int], edges: set[frozenset[int]]) -> bool:
    corner = set(tetrahedron.tolist())
    if len(exposed) == 1:
        return (corner - set(exposed[0])).isdisjoint(corners)
    if len(exposed) == 2:
        shared = set(exposed[0]) & set(exposed[1])
        return frozenset(corner - shared) not in edges
    return False


def faces_of(t: np.ndarray) -> np.ndarray:
    return t[:, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]]


def boundary(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Boundary faces (s, 3) outward and the tetrahedron of each."""
    faces = faces_of(t).reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, 1), axis=0, return_index=True, return_counts=True)
    chosen = np.sort(first[count == 1])
    return faces[chosen], chosen // 4


def improve(mesh: HalfMesh, skeleton: Skeleton, rng: np.random.Generator, wanted: float, roam: float) -> None:
    """Swaps and moves until no element is below ``wanted`` degrees or nothing helps; corners of the skin stay within
    ``roam`` mm."""
    work = Tetrahedra(mesh.points, mesh.tetrahedra)
    home = mesh.points.copy()

    def moves(corner: int, point: np.ndarray) -> np.ndarray | None:
        if mesh.place[corner] >= PLANE_SKIN and np.linalg.norm(point - home[corner]) > roam:
            return None  # corners of the skin stay spread out
        return _allowed(mesh, skeleton, corner, point)

    stale, last = 0, (0, 0.0)
    for _ in range(400):
        work.swap(wanted)
        work.move(wanted, moves, rng)
        bad = work.bad(wanted)
        if not bad or stale >= 6:
            break
        now = (-len(bad), round(float(work.qualities().min()), 2))
        stale, last = (stale + 1, last) if now <= last and last[0] else (0, now)
        if stale in (3, 6):
            _peel(work, mesh, bad)
    mesh.points, mesh.tetrahedra = work.points, work.array()


def _peel(work: Tetrahedra, mesh: HalfMesh, bad: list[int]) -> None:
    # Bad elements with two faces on the skin come off: the edge between those faces is flipped.
    faces, _ = boundary(work.array())
    exposed = {frozenset(f) for f in faces.tolist()}
    outer = {frozenset(e) for f in faces.tolist() for e in ((f[0], f[1]), (f[1], f[2]), (f[2], f[0]))}
    corners = set(faces.ravel().tolist())
    for key in bad:
        element = work.elements[key]
        mine = [list(f) for f in combinations(element, 3) if frozenset(f) in exposed]
        skin = all(mesh.place[c] >= PLANE_SKIN for c in element)
        planar = any(all(mesh.place[c] in PLANAR for c in f) for f in mine)
        if len(mine) == 2 and skin and not planar and _simple(np.array(element), mine, corners, outer):
            work.replace([key], [])
            outer |= {frozenset(e) for e in combinations(element, 2)}


def _allowed(mesh: HalfMesh, skeleton: Skeleton, corner: int, point: np.ndarray) -> np.ndarray | None:
    place, bone, skin = mesh.place[corner], mesh.bone[corner], skeleton.skin
    if place in PLANAR:
        point[0] = 0.0
    if bone >= 0:
        if float(skin.depth(point)) < min(8.0, float(skin.depth(mesh.points[corner]))):
            return None
        return point if inside(skeleton.surfaces[bone], point[None])[0] else None
    if place in (INSIDE, PLANE):
        return point if float(skin.depth(point)) > 8.0 and point[0] >= 0.0 else None
    if place in (RIM, PLANE_RIM):
        return None
    if not skin.y[0] < point[1] < skin.y[-1]:
        return None
    return _onto_skin(skin, point)


def _onto_skin(skin: Skin, points: np.ndarray) -> np.ndarray:
    reach = _reach(skin, points)[..., None]
    centre = np.stack([0.0 * points[..., 0], points[..., 1], skin.row(points[..., 1])[3]], -1)
    return centre + (points - centre) / reach


def _reach(skin: Skin, points: np.ndarray) -> np.ndarray:
    # 1 on the skin, 0 in the middle of a row.
    x, y, z = np.moveaxis(points, -1, 0)
    w, f, b, c, n = skin.row(y)
    return ((np.abs(x) / w) ** n + (np.abs(z - c) / np.where(z >= c, f - c, c - b)) ** n) ** (1.0 / n)


def _gap(skin: Skin, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    # Distance (to first order) from points outwards to the skin, and the skin's normal there.
    step = 0.2 * np.eye(3)
    slope = np.stack([_reach(skin, points + h) - _reach(skin, points - h) for h in step], -1) / 0.4
    size = np.linalg.norm(slope, axis=-1, keepdims=True)
    return (1.0 - _reach(skin, points)) / size[..., 0], slope / size


def fit_skin(mesh: HalfMesh, skin: Skin, most: float, rounds: int = 8) -> None:
    """Move the skin's corners outwards or inwards, by at most ``most`` mm a round, until its facets lie on the skin on
    average: no region of the body gains or loses volume to the facets. A move that would spoil an element is left out.
    """
    n = 5
    i, j = np.nonzero(np.add.outer(np.arange(n), np.arange(n)) < n)
    samples = np.stack([i + 1.0 / 3.0, j + 1.0 / 3.0], -1) / n
    i, j = np.nonzero(np.add.outer(np.arange(n), np.arange(n)) < n - 1)
    samples = np.vstack([samples, np.stack([i + 2.0 / 3.0, j + 2.0 / 3.0], -1) / n])
    samples = np.column_stack([samples, 1.0 - samples.sum(1)])
    faces, _ = boundary(mesh.tetrahedra)
    level = mesh.points[:, 1][faces]
    cap = (np.abs(level - skin.y[0]) < 1e-6).all(1) | (np.abs(level - skin.y[-1]) < 1e-6).all(1)
    faces = faces[~cap & ~np.isin(mesh.place, PLANAR)[faces].all(1)]
    corners = np.unique(faces)
    work = Tetrahedra(mesh.points, mesh.tetrahedra)
    for _ in range(rounds):
        p = work.points[faces]
        points = np.einsum("qk,fkd->fqd", samples, p)
        gap, normal = _gap(skin, points)
        area = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        weight = np.maximum(np.einsum("fqd,fd->fq", normal, area), 0.0)
        wanted = np.bincount(faces.ravel(), np.einsum("fq,fq,qk->fk", gap, weight, samples).ravel(), len(mesh.points))
        wanted /= np.maximum(np.bincount(faces.ravel(), (weight @ samples).ravel(), len(mesh.points)), 1e-9)
        normal = np.zeros_like(work.points)
        normal[corners] = _gap(skin, work.points[corners])[1]
        normal[np.isin(mesh.place, PLANAR), 0] = 0.0
        normal[np.isin(mesh.place, (RIM, PLANE_RIM)), 1] = 0.0
        move = np.clip(wanted, -most, most)[:, None] * normal
        for corner in corners.tolist():
            star = np.array([work.elements[k] for k in sorted(work.around[corner])])
            p = work.points[star]
            before = quality(p).min()
            old = work.points[corner].copy()
            p[star == corner] = old + move[corner]
            if quality(p).min() >= min(before, 10.0):
                work.points[corner] = old + move[corner]
    mesh.points = work.points


def mirror(mesh: HalfMesh, names: tuple[str, ...] = BONES) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Both halves: corners, tetrahedra, bone of each corner."""
    n = len(mesh.points)
    points = mesh.points.copy()
    plane = np.isin(mesh.place, PLANAR)
    points[plane, 0] = 0.0
    other = np.where(plane, np.arange(n), n + np.cumsum(~plane) - 1)
    both = np.vstack([points, points[~plane] * [-1.0, 1.0, 1.0]])
    right = np.where(mesh.bone >= 0, opposite_bones(names)[mesh.bone], -1)
    t = np.vstack([mesh.tetrahedra, other[mesh.tetrahedra][:, [1, 0, 2, 3]]])
    return both, t, np.concatenate([mesh.bone, right[~plane]])


def opposite_bones(names: tuple[str, ...]) -> np.ndarray:
    """(n,) index of each bone's counterpart on the other side; its own for a bone in the middle."""
    other = {"L": "R", "R": "L"}
    return np.array([names.index(n[:-1] + other[n[-1]]) if n[-2:] in ("_L", "_R") else i for i, n in enumerate(names)])


def quadratic(
    points: np.ndarray, t: np.ndarray, bone: np.ndarray, skeleton: Skeleton, near: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes, ten-node elements and bone of each node: what lies in a bone, or within ``near`` mm of its surface, is
    tied to it; of several bones to the one it lies deepest in. Nodes of the skin stay free, and so does the middle half
    of a gap between two bones (``GAP``): tied across, it would weld them."""
    edges = np.sort(t[:, np.array(TET10_EDGES)].reshape(-1, 2), axis=1)
    unique, inverse = np.unique(edges, axis=0, return_inverse=True)
    nodes = np.vstack([points, points[unique].mean(1)])
    elements = np.hstack([t, len(points) + inverse.reshape(-1, 6)])
    owner, outside, other = nearest_bones(nodes, skeleton, near / GAP)
    bones = np.where((outside <= near) & (outside <= np.maximum(GAP * other, 0.0)), owner, -1)
    faces, _ = boundary(t)
    skin = np.zeros(len(nodes), dtype=bool)
    skin[faces] = True
    rim = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    skin[len(points) :] = np.isin(unique @ [len(points), 1], rim @ [len(points), 1])
    bones[skin] = -1
    sampled = np.flatnonzero(bone >= 0)
    bones[sampled] = bone[sampled]
    return nodes, elements, bones


def nearest_bones(nodes: np.ndarray, skeleton: Skeleton, reach: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For each node the bone it lies deepest in or nearest to, how far outside it lies, and how far outside the next
    bone, mm.

    Below 0: inside; infinite beyond ``reach``. Mirrored nodes get mirrored answers.
    """
    left = nodes * np.where(nodes[:, :1] < 0.0, -1.0, 1.0) ** np.array([1.0, 0.0, 0.0])
    owner = np.full(len(nodes), -1)
    outside, other = np.full(len(nodes), np.inf), np.full(len(nodes), np.inf)
    for index, name in enumerate(BONES):
        surface = skeleton.surfaces[index]
        low, high = surface[0].min(0) - reach, surface[0].max(0) + reach
        close = np.flatnonzero(((left >= low) & (left <= high)).all(1))
        distance = cKDTree(_dense(surface)).query(left[close], distance_upper_bound=reach)[0]
        distance = np.where(inside(surface, left[close]), -distance, distance)
        # The middle plane belongs to neither side.
        mine = distance < outside[close]
        if name[-2:] in ("_L", "_R"):
            mine &= left[close, 0] >= 1e-6
        nearer = close[mine]
        other[nearer] = outside[nearer]
        owner[nearer], outside[nearer] = index, distance[mine]
        other[close[~mine]] = np.minimum(other[close[~mine]], distance[~mine])
    right = (nodes[:, 0] < 0.0) & (owner >= 0)
    owner[right] = opposite_bones(BONES)[owner[right]]
    return owner, outside, other


def _dense(surface: Surface, step: float = 1.0) -> np.ndarray:
    # Points of a surface, at most ``step`` mm apart.
    p = surface[0][surface[1]]
    longest = np.linalg.norm(p - np.roll(p, 1, axis=1), axis=2).max(1)
    parts = np.maximum(1, np.ceil(longest / step - 1e-6)).astype(int)
    points = []
    for k in np.unique(parts):
        i, j = np.nonzero(np.add.outer(np.arange(k + 1), np.arange(k + 1)) <= k)
        points.append((np.stack([i, j, k - i - j], -1) / k @ p[parts == k]).reshape(-1, 3))
    return np.unique(np.vstack(points).round(6), axis=0)


def half_mesh(skeleton: Skeleton, spacing: Spacing, seed: int, tries: int = 5) -> HalfMesh:
    """The left half, improved; where a pocket outside the skin could not be carved, anew with the next seed.

    Raises
    ------
    ValueError : its volume is not the skin's with any of ``tries`` seeds: another spacing is wanted.
    """
    wanted = signed_volume(skeleton.skin.surface(160, 240))
    for attempt in range(tries):
        mesh = _half_mesh(skeleton, spacing, np.random.default_rng(seed + attempt))
        volume = 2.0 * volumes(mesh.points[mesh.tetrahedra]).sum()
        if abs(volume / wanted - 1.0) <= VOLUME_TOLERANCE:
            return mesh
    raise ValueError(f"{spacing} gives {volume * 1e-6:.2f} l inside a skin of {wanted * 1e-6:.2f} l")


def _half_mesh(skeleton: Skeleton, spacing: Spacing, rng: np.random.Generator) -> HalfMesh:
    skin, out = skeleton.skin, spacing.outwards
    wide = replace(skin, half_width=skin.half_width + out, front=skin.front + out, back=skin.back - out)
    grown = replace(skeleton, skin=wide)
    mesh = sample(grown, spacing)
    for _ in range(5):
        tetrahedralise(mesh, grown)
        if not _cover(mesh, grown):
            break
    improve(mesh, grown, rng, WANTED_ANGLE, 0.3 * spacing.skin)
    for _ in range(3):
        # Swaps have freed elements outside the skin that could not come off before.
        _carve(mesh, grown)
        fit_skin(mesh, skin, 0.1 * spacing.skin)
        improve(mesh, skeleton, rng, WANTED_ANGLE, 0.0)
    return mesh
