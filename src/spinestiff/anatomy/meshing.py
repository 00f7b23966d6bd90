"""Ten-node tetrahedra between a skin and the bones of one's own anatomy: points, Delaunay, carving, MMG, quality gate.

The mesher is a plug-in (entry points of the group ``spinestiff.meshers``); the one that comes along, "mmg", needs the
extra [mesh]. Shipped torsos need no mesher.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points
from importlib.util import find_spec

import numpy as np
from scipy.spatial import Delaunay, QhullError, cKDTree

from spinestiff.anatomy.carving import boundary, carved
from spinestiff.anatomy.mmg import NO_MMG, VOLUME_TOLERANCE, mmg
from spinestiff.anatomy.names import BONES
from spinestiff.anatomy.solids import dense_points, enclosed, first_of_rows
from spinestiff.anatomy.template.surfaces import Surface, signed_volume
from spinestiff.anatomy.tetrahedra import least_angles, signed_volumes
from spinestiff.anatomy.torso import TET10_EDGES
from spinestiff.arrays import Floats, Ints, ShortRepr
from spinestiff.errors import TorsoError
from spinestiff.observer import Observer
from spinestiff.words import counted

GROUP = "spinestiff.meshers"
DEFAULT_MESHER = "mmg"
SPACINGS_MM = (9.0, 60.0)
LEAST_ANGLE_DEG = 5.0
# Spacings to try one after another, as shares of the wanted one: a mesh's quality depends on its size by chance.
TRIED_SHARES = (1.0, 0.95, 1.04, 0.9, 1.08, 0.86)
# Distances as shares of the spacing inside: along a bone and on the skin, as in the template's fine mesh.
BONE_SHARE, SKIN_SHARE = 1.27, 1.1
DRAWN = 0.7  # of the candidates for points on the skin: the share that a seed leaves
BURIED = 0.16  # of the skin's spacing: how deep a bone's points shall lie, so that no facet bares them
NEAR = 0.11  # of the spacing: nodes this close to a bone ride on it
GAP = 1.0 / 3.0  # of the distance to the next bone: how far a bone's tied nodes reach into the gap between the two


# Takes corner points (n, 3) mm, tetrahedra (t, 4) that fill the torso and the numbers of points that must stay; gives
# better points and tetrahedra with about the same boundary.
Mesher = Callable[[Floats, Ints, Ints], tuple[Floats, Ints]]


@dataclass(frozen=True, repr=False)
class MeshedTissue(ShortRepr):
    """Tissue between skin and bones.

    Attributes
    ----------
    nodes : (N, 3) mm. elements : (T, 10). bone_of_node : (N,), -1 = free.
    mesher : its name. least_angle_deg : the smallest dihedral angle. volume_share : of the skin's volume.
    """

    nodes: Floats
    elements: Ints
    bone_of_node: Ints
    mesher: str
    least_angle_deg: float
    volume_share: float


def refuse_unknown_mesher(name: str) -> None:
    """Whether it can be used here is left to ``find_mesher``.

    Raises
    ------
    TorsoError : neither "mmg" nor offered by an installed package.
    """
    offered = [entry.name for entry in entry_points(group=GROUP)]
    if name != DEFAULT_MESHER and name not in offered:
        raise TorsoError(f"no mesher '{name}'; installed: {', '.join([DEFAULT_MESHER, *sorted(offered)])}")


def refuse_spacing(spacing: float) -> None:
    """Raise TorsoError unless tissue can be meshed with its corners that far apart, mm."""
    low, high = SPACINGS_MM
    if not low <= spacing <= high:
        raise TorsoError(f"spacing {spacing:g} mm; wanted {low:g} to {high:g} mm")


def find_mesher(name: str) -> Mesher:
    """A mesher by name: "mmg", or one that an installed package offers in the group ``spinestiff.meshers``.

    Raises
    ------
    TorsoError : unknown, or what it needs is not installed.
    """
    refuse_unknown_mesher(name)
    offered = {entry.name: entry for entry in entry_points(group=GROUP)}
    if name in offered:
        try:
            loaded: Mesher = offered[name].load()
        except Exception as error:  # somebody else's package
            raise TorsoError(f"mesher '{name}' can't be loaded ({' '.join(str(error).split())[:120]})") from None
        return loaded
    if find_spec("mmgpy") is None:
        raise TorsoError(NO_MMG)
    return mmg


def mesh_tissue(
    surfaces: Mapping[str, Surface],
    skin: Surface,
    spacing: float,
    mesher: str = DEFAULT_MESHER,
    observer: Observer | None = None,
    tried_shares: tuple[float, ...] = TRIED_SHARES,
    seed: int = 0,
) -> MeshedTissue:
    """The tissue inside a skin with nodes in all bones.

    Parameters
    ----------
    surfaces : of the 49 bones, closed, world mm, inside the skin. skin : closed, world mm.
    spacing : wanted distance of corners inside, mm.
    mesher : name of the mesher. observer : is told each try, in words.
    tried_shares : spacings to try until a mesh passes, as shares of the wanted one. Each try draws other points.
    seed : of the points; another one gives another mesh of about as many nodes.

    Raises
    ------
    TorsoError : as ``refuse_spacing``; no mesher; no try passes the quality gate; a bone has too few nodes.
    """
    refuse_spacing(spacing)
    improve, say = find_mesher(mesher), observer or (lambda line: None)
    best: tuple[float, Floats, Ints, float] | None = None
    failures: list[str] = []
    for attempt, size in enumerate(tried_shares):
        now = spacing * size
        say(f"mesh: try {attempt + 1}, {now:.1f} mm between corners")
        try:
            points, tetrahedra, required = starting_mesh(surfaces, skin, now, (seed, attempt))
            kept = points[required]
            points, tetrahedra = improve(points, tetrahedra, required)
        except (TorsoError, QhullError) as error:
            if isinstance(error, TorsoError) and "[mesh]" in str(error):
                raise
            failures.append(" ".join(str(error).split())[:200])
            continue
        if cKDTree(points).query(kept)[0].max() > 1e-6:
            failures.append("the mesher moved points of the bones")
            continue
        volumes = signed_volumes(points[tetrahedra])
        tetrahedra = np.where((volumes < 0.0)[:, None], tetrahedra[:, [1, 0, 2, 3]], tetrahedra)
        share = float(np.abs(volumes).sum() / signed_volume(skin))
        if abs(share - 1.0) > VOLUME_TOLERANCE:
            failures.append(f"the mesh has {share:.1%} of the skin's volume")
            continue
        points = _with_volume(points, tetrahedra, signed_volume(skin), cKDTree(points).query(kept)[1])
        angle = float(least_angles(points[tetrahedra]).min())
        if best is None or angle > best[0]:
            best = (angle, points, tetrahedra, share)
        if angle >= LEAST_ANGLE_DEG:
            break
        failures.append(f"smallest dihedral angle {angle:.1f} degrees")
    if best is None or best[0] < LEAST_ANGLE_DEG:
        why = failures[-1] if failures else "nothing tried"
        raise TorsoError(
            f"no mesh with dihedral angles above {LEAST_ANGLE_DEG:g} degrees in {len(tried_shares)} tries "
            f"(last: {why}); try another --spacing, or a smoother skin"
        )
    angle, points, tetrahedra, share = best
    nodes, elements, bones = tied_quadratic(points, tetrahedra, surfaces, NEAR * spacing)
    counts = np.bincount(bones[bones >= 0], minlength=len(BONES))
    if counts.min() < 3:
        few = BONES[int(np.argmin(counts))]
        raise TorsoError(
            f"{few} has {counted(int(counts.min()), 'node')} of the mesh in it, wanted 3 or more; "
            "use a smaller --spacing"
        )
    return MeshedTissue(nodes, elements, bones, mesher, angle, share)


def starting_mesh(
    surfaces: Mapping[str, Surface], skin: Surface, spacing: float, seed: tuple[int, ...] = (0,)
) -> tuple[Floats, Ints, Ints]:
    """Corner points (n, 3), tetrahedra (t, 4) down to the skin, and the numbers of the points in bones.

    Points in bones, on the skin and inside are drawn from candidates; which of these are there goes by ``seed``.
    """
    rng = np.random.default_rng(seed)
    skin_spacing = SKIN_SHARE * spacing
    shell = dense_points(skin, 0.2 * skin_spacing)
    depth_tree = cKDTree(shell)
    bony: list[Floats] = []
    for name in BONES:
        others = np.vstack([np.zeros((0, 3)), *bony])
        found = _bone_points(surfaces[name], BONE_SHARE * spacing, others, depth_tree, BURIED * skin_spacing, rng)
        if not len(found):
            raise TorsoError(f"{name} is too thin to hold a point of the mesh; is its surface closed?")
        bony.append(found)
    bones = np.vstack(bony)
    # The corners of the skin stand a little outside it: that makes up for the facets' cutting of its curves.
    outer = farthest_points(shell[rng.uniform(size=len(shell)) < DRAWN], np.zeros((0, 3)), skin_spacing)
    normals = _normals(skin, outer)
    outer = outer + 0.0014 * skin_spacing**2 * normals
    step = 0.28 * spacing
    grid = _lattice(skin[0].min(0) - step * rng.uniform(size=3), skin[0].max(0), step)
    grid = grid[enclosed(skin, grid)]
    grid = grid[depth_tree.query(grid)[0] > 0.55 * skin_spacing]
    fill = farthest_points(grid, bones, spacing)
    fill = fill + rng.uniform(-0.06, 0.06, fill.shape) * spacing  # regular points give flat tetrahedra
    points = np.vstack([bones, outer, fill])
    on_skin = np.zeros(len(points), dtype=bool)
    on_skin[len(bones) : len(bones) + len(outer)] = True
    tetrahedra = Delaunay(points, qhull_options="Qbb Qc Qz Q12").simplices.astype(np.int64)
    tetrahedra = carved(points, tetrahedra, on_skin, skin, depth_tree)
    used = np.unique(tetrahedra)
    number = np.full(len(points), -1)
    number[used] = np.arange(len(used))
    required = number[: len(bones)]
    if (required < 0).any():
        raise TorsoError("a point of a bone was carved away; is that bone inside the skin?")
    return points[used], number[tetrahedra], required


def _bone_points(
    surface: Surface, spacing: float, others: Floats, skin: cKDTree, buried: float, rng: np.random.Generator
) -> Floats:
    # Points a little under the surface, spread out, clear of those in other bones, deep under the skin where possible.
    candidates = under_surface(surface, (1.3, 2.5, 4.0), rng)
    candidates = candidates[first_of_rows(np.floor(candidates / 2.0))]
    found = candidates[enclosed(surface, candidates)]
    if not len(found):
        candidates = under_surface(surface, (0.2, 0.5), rng)
        found = candidates[enclosed(surface, candidates)]
        if not len(found):
            return found
    return spread_in_bone(found, skin.query(found)[0] > buried, spacing, others)


def under_surface(surface: Surface, depths: Sequence[float], rng: np.random.Generator | None = None) -> Floats:
    """(n, 3) mm, points ``depths`` mm under each triangle of a closed surface, if it is that thick: under its middle,
    or around that at random."""
    vertices, faces = surface
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-12
    shares = np.full((len(faces), 3), 1.0 / 3.0) if rng is None else rng.dirichlet((2.0, 2.0, 2.0), len(faces))
    places = np.einsum("fc,fcd->fd", shares, corners)
    return np.vstack([places - d * normal for d in depths])


def spread_in_bone(candidates: Floats, deep: np.ndarray, spacing: float, others: Floats) -> Floats:
    """Points of a bone's mesh out of ``candidates`` (n, 3) mm inside it, ``spacing`` apart where it is that large.

    The ``deep`` (n,) under the skin are taken where they are most of them, and those clear of ``others`` (m, 3), points
    of other bones, as far as enough are left.
    """
    if deep.mean() > 0.6:
        candidates = candidates[deep]
    if len(others):
        distance = cKDTree(others).query(candidates)[0]
        for clearance in (0.34, 0.28, 0.22, 0.16, 0.1, 0.0):
            clear = candidates[distance >= clearance * spacing]
            enough = len(clear) > 0.3 * len(candidates)
            if enough and np.ptp(clear, axis=0).max() > 0.6 * np.ptp(candidates, axis=0).max():
                break
        candidates = clear
    start = candidates[[np.argmax(np.linalg.norm(candidates - candidates.mean(0), axis=1))]]
    return np.vstack([start, farthest_points(candidates, start, spacing, least=2)])


def farthest_points(candidates: Floats, chosen: Floats, spacing: float, least: int = 0) -> Floats:
    """Candidates added one by one, each the farthest from all before, until none is ``spacing`` away."""
    added: list[Floats] = []
    if not len(candidates):
        return np.zeros((0, 3))
    # Squared, and one coordinate after another: most of the time of meshing goes here.
    x, y, z = np.ascontiguousarray(candidates.T)
    squared = cKDTree(chosen).query(candidates)[0] ** 2 if len(chosen) else np.full(len(candidates), np.inf)
    while True:
        worst = int(np.argmax(squared))
        if (squared[worst] < spacing**2 and len(added) >= least) or squared[worst] < 1e-18:
            return np.array(added).reshape(-1, 3)
        added.append(candidates[worst])
        np.minimum(squared, (x - x[worst]) ** 2 + (y - y[worst]) ** 2 + (z - z[worst]) ** 2, out=squared)


def _normals(skin: Surface, points: Floats) -> Floats:
    # Unit, outward, of the triangle whose middle is nearest.
    corners = skin[0][skin[1]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-12
    return normal[cKDTree(corners.mean(1)).query(points)[1]]


def _lattice(low: Floats, high: Floats, step: float) -> Floats:
    axes = [np.arange(a, b, step) for a, b in zip(low, high)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def _with_volume(points: Floats, tetrahedra: Ints, volume: float, fixed: Ints) -> Floats:
    # The boundary's corners moved along their normals, all as far, but for the bones' ``fixed`` ones: a trunk's
    # stiffness goes with the cube of its size.
    faces = boundary(tetrahedra)
    points = np.array(points)
    for _ in range(2):
        a, b, c = (points[faces[:, i]] for i in range(3))
        slope = np.zeros_like(points)
        for corner in range(3):
            np.add.at(slope, faces[:, corner], np.cross(b - a, c - a) / 6.0)
        slope[fixed] = 0.0
        size = np.linalg.norm(slope, axis=1)
        points += (volume - signed_volume((points, faces))) / size.sum() * slope / np.maximum(size, 1e-12)[:, None]
    return points


def tied_quadratic(
    points: Floats, tetrahedra: Ints, surfaces: Mapping[str, Surface], near: float
) -> tuple[Floats, Ints, Ints]:
    """Nodes, ten-node elements and the bone of each node.

    What lies in a bone, or within ``near`` mm of its surface, is tied to it; of several bones to the one it lies
    deepest in. Nodes of the skin stay free, and so does the middle of a gap between two bones (``GAP``): tied
    across, it would weld them.
    """
    edges = np.sort(tetrahedra[:, np.array(TET10_EDGES)].reshape(-1, 2), axis=1)
    unique, inverse = np.unique(edges, axis=0, return_inverse=True)
    nodes = np.vstack([points, points[unique].mean(1)])
    elements = np.hstack([tetrahedra, len(points) + inverse.reshape(-1, 6)])
    owner = np.full(len(nodes), -1)
    outside, other = np.full(len(nodes), np.inf), np.full(len(nodes), np.inf)
    reach = near / GAP
    for index, name in enumerate(BONES):
        surface = surfaces[name]
        low, high = surface[0].min(0) - reach, surface[0].max(0) + reach
        close = np.flatnonzero(((nodes >= low) & (nodes <= high)).all(1))
        if not len(close):
            continue
        distance = cKDTree(dense_points(surface, 1.5)).query(nodes[close], distance_upper_bound=2.0 * reach + 20.0)[0]
        distance = np.where(enclosed(surface, nodes[close]), -distance, distance)
        mine = distance < outside[close]
        nearer = close[mine]
        other[nearer] = outside[nearer]
        owner[nearer], outside[nearer] = index, distance[mine]
        other[close[~mine]] = np.minimum(other[close[~mine]], distance[~mine])
    bones = np.where((outside <= near) & (outside <= np.maximum(GAP * other, 0.0)), owner, -1)
    faces = boundary(tetrahedra)
    rim = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    skin = np.zeros(len(nodes), dtype=bool)
    skin[faces] = True
    skin[len(points) :] = np.isin(unique @ [len(points), 1], rim @ [len(points), 1])
    bones[skin] = -1
    return nodes, elements, bones
