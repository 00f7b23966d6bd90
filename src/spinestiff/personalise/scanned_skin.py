"""The skin brought to a scan: a smooth displacement along its normals, bones unmoved, the rest left alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from scipy.spatial import cKDTree

from spinestiff.anatomy.solids import dense_points, enclosed
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, Ints
from spinestiff.errors import SubjectError, TorsoError
from spinestiff.personalise.measured_skin import with_moved_skin
from spinestiff.personalise.registration import LAST_MM, Matches, matches, register
from spinestiff.personalise.scan import SkinScan
from spinestiff.personalise.skin_surface import SkinSurface, skin_surface

ROUNDS = 6
# mm: what scanner, breath and a straight-edged mesh leave between scan and skin; points three times as far count half.
SCATTER_MM = 3.0
# How many points speak for themselves: neighbours on a scan err together. mm2 of skin for each.
INDEPENDENT_MM2 = 400.0
# mm, the usual difference of displacement over any distance (the energy of a membrane has no length of its own), and mm
# over which the displacement fades where there is no scan.
BEND_MM, FADE_MM = 12.0, 90.0
COVER_MM = 4.0  # that every bone keeps, or what it has if that is less
BONE_STEP_MM, FINE_BONE_STEP_MM = 10.0, 5.0
HALVINGS = 12
NEAR_BONE_MM = 50.0
# Of how far a corner's way changes the cover: where it is less, as over an edge, moving it is no remedy.
LEAST_HELP = 0.5
HELD_WEIGHT = 100.0
COVERED_MM = 15.0  # a piece of skin is covered where the scan has a point that far beside it
LEAST_COVERED = 0.5  # of a part of the skin, or it counts as left to the template
# mm between scan and skin that no trunk has: median of the scan's points on the placed, and on the fitted skin.
MOST_BEFORE_MM, MOST_AFTER_MM = 25.0, 6.0
MOST_MOVED_MM = 60.0  # of a corner of the skin
SIDES = ("front", "back", "left side", "right side")
LEVELS = (("shoulders", "T4"), ("chest", "T12"), ("waist", "L5"))
LOWEST = "hips"


@dataclass(frozen=True)
class ScanFit:
    """How a skin scan and the skin agree.

    Attributes
    ----------
    covered : share of the skin that the scan covers.
    before_mm, after_mm : median and 95th percentile of the distance from the scan's points to the skin, as it was and
        as it became.
    used : share of the scan's points that face the skin; the others (arms, head) are left out.
    left : parts of the skin that stay with the template, as "front" or "left side of chest and waist".
    held_mm : how far under the skin's least cover of bones the scan reaches at most; 0 = nowhere.
    yaw_deg, tilt_deg : turn of the scan about the vertical, and its lean.
    turned_round : whether the scan's triangles faced inward.
    points : (n, 3) mm, the points that were used, in the torso's place.
    """

    covered: float
    before_mm: tuple[float, float]
    after_mm: tuple[float, float]
    used: float
    left: tuple[str, ...]
    held_mm: float
    yaw_deg: float
    tilt_deg: float
    turned_round: bool
    points: Floats

    def __str__(self) -> str:
        """Place and distances in a line."""
        (before, before95), (after, after95) = self.before_mm, self.after_mm
        return (
            f"skin scan turned by {self.yaw_deg:.0f} degrees, {100.0 * self.covered:.0f} % of the skin covered; "
            f"scan to skin {before:.1f} mm (95 %: {before95:.1f}) before, {after:.1f} mm ({after95:.1f}) after"
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should know, a line each."""
        lines = []
        if self.left:
            left = "; ".join(self.left)
            lines.append(f"skin scan: covers {100.0 * self.covered:.0f} % of the skin; left to the template: {left}")
        if self.held_mm > 1.0:
            lines.append(
                f"skin scan: reaches up to {self.held_mm:.0f} mm under the least cover of a bone; the skin was held "
                f"{COVER_MM:g} mm off, and the bones there may not be the subject's"
            )
        return tuple(lines)


def with_scan(torso: TorsoModel, scan: SkinScan) -> tuple[TorsoModel, ScanFit]:
    """The torso with its skin at the scan, and how well it fits.

    The scan is placed on the skin (``registration.register``). Then the skin's corners move along their normals by the
    smooth displacement that fits the scan's points best, by weighted least squares with robust weights: no bone loses
    its cover, and where there is no scan the displacement fades to none. Free tissue follows harmonically.

    Raises
    ------
    SubjectError : the scan can't be placed, or stays far from this skin.
    TorsoError : tissue that is turned over.
    """
    place = register(scan, torso)
    placed = place.placed(scan)
    skin = skin_surface(torso)
    first = matches(skin, placed, LAST_MM)
    before = _spread_of(first.off)
    if before[0] > MOST_BEFORE_MM:
        raise SubjectError(_refusal(scan.name, before[0], MOST_BEFORE_MM, "as it lies best"))
    nodes, directions = skin.corners
    along, held_mm = _displacement(torso, skin, placed, nodes, directions)
    if np.abs(along).max() > MOST_MOVED_MM:
        raise SubjectError(
            f"skin scan: {scan.name} would move the skin by {np.abs(along).max():.0f} mm, wanted at most "
            f"{MOST_MOVED_MM:g} mm; check whose scan it is, its unit and axes, or leave it out"
        )
    along = _outside_bones(torso, skin, nodes, along, directions)
    moved = np.zeros_like(torso.tissue.rest_positions)
    moved[nodes] = along[:, None] * directions
    after = _spread_of(matches(skin.moved(moved[skin.faces]), placed, LAST_MM).off)
    if after[0] > MOST_AFTER_MM:
        raise SubjectError(_refusal(scan.name, after[0], MOST_AFTER_MM, "after the fit"))
    try:
        fitted = with_moved_skin(torso, nodes, moved)
    except TorsoError as error:
        raise TorsoError(
            f"the skin can't come to the scan {scan.name}: the bones, which it doesn't move, leave no room for the "
            f"tissue between ({error}); check the scan or leave it out"
        ) from None
    after_skin = skin_surface(fitted)
    last = matches(after_skin, placed, LAST_MM)
    covered, left = _coverage(fitted, after_skin, placed, last)
    return fitted, ScanFit(
        covered=covered,
        before_mm=before,
        after_mm=_spread_of(last.off),
        used=len(last.scan) / len(scan.points),
        left=left,
        held_mm=held_mm,
        yaw_deg=place.yaw_deg,
        tilt_deg=place.tilt_deg,
        turned_round=place.inside_out,
        points=placed.points[last.scan],
    )


def _refusal(name: str, found: float, wanted: float, when: str) -> str:
    return (
        f"skin scan: the skin lies {found:.1f} mm from {name} {when} (median), wanted at most {wanted:g} mm; "
        "check whose scan it is, its unit and axes, or leave it out"
    )


def _spread_of(off: Floats) -> tuple[float, float]:
    return float(np.median(np.abs(off))), float(np.percentile(np.abs(off), 95.0))


def _displacement(
    torso: TorsoModel, skin: SkinSurface, scan: SkinScan, nodes: Ints, directions: Floats
) -> tuple[Floats, float]:
    """Displacement (K,) mm of the corners along their directions, and how far the scan reaches under the cover."""
    row = np.full(len(torso.tissue.rest_positions), -1)
    row[nodes] = np.arange(len(nodes))
    smooth = _smoothness(torso, skin, row)
    bones = _bone_points(torso, skin)
    least = np.minimum(_cover(skin.points, skin.normals, skin.tree, bones)[0], COVER_MM)
    along = np.zeros(len(nodes))
    held = np.zeros(len(bones), dtype=bool)
    reached = 0.0
    for _ in range(ROUNDS):
        now = _moved(skin, row, along, directions)
        found = matches(now, scan, LAST_MM)
        if not len(found.scan):
            break
        normal = now.normals[found.skin]
        rows = _rows(skin, row, found.skin, normal, directions)
        # Distances from the skin as it was, along the normals it has now.
        wanted = np.einsum("ni,ni->n", scan.points[found.scan] - skin.points[found.skin], normal)
        robust = (1.0 + (found.off / (3.0 * SCATTER_MM)) ** 2) ** -1
        faced = skin.area[np.unique(found.skin)].sum()
        weight = min(1.0, faced / INDEPENDENT_MM2 / len(found.scan)) * robust / SCATTER_MM**2
        hessian = (rows.T @ sp.diags_array(weight) @ rows + smooth).tocsc()
        slope = rows.T @ (weight * wanted)
        free = spla.spsolve(hessian, slope)
        along = free
        for _ in range(ROUNDS):
            bent = _moved(skin, row, along, directions)
            depth, nearest = _cover(bent.points, bent.normals, cKDTree(bent.points), bones)
            short = depth < least - 0.05
            reached = max(reached, float((least - depth)[short].max(initial=0.0))) if along is free else reached
            held |= short
            if not short.any():
                break
            mine = np.flatnonzero(held)
            side = bent.normals[nearest[mine]]
            stops = _rows(skin, row, nearest[mine], side, directions)
            useful = stops.sum(axis=1) > LEAST_HELP
            mine, side, stops = mine[useful], side[useful], stops[useful]
            until = least[mine] + np.einsum("ni,ni->n", bones[mine] - skin.points[nearest[mine]], side)
            stiff = HELD_WEIGHT / SCATTER_MM**2
            along = spla.spsolve((hessian + stiff * stops.T @ stops).tocsc(), slope + stiff * (stops.T @ until))
    return along, reached


def _outside_bones(torso: TorsoModel, skin: SkinSurface, nodes: Ints, along: Floats, directions: Floats) -> Floats:
    """The displacement (K,) mm, taken back by halves around every bone point that it would leave outside the skin.

    The cover is held at points of the skin; over an edge between two faces a bone may still come through.
    """
    row = np.full(len(torso.tissue.rest_positions), -1)
    row[nodes] = np.arange(len(nodes))
    rest, faces = torso.tissue.rest_positions, torso.tissue.boundary_faces()[:, :3]
    bones = _bone_points(torso, skin, FINE_BONE_STEP_MM)
    bones = bones[enclosed((rest, faces), bones)]
    along = np.array(along)
    for _ in range(HALVINGS):
        moved = np.array(rest)
        moved[nodes] += along[:, None] * directions
        bare = bones[~enclosed((moved, faces), bones)]
        if not len(bare):
            break
        _, nearest = skin.tree.query(bare)
        around = np.unique(row[skin.faces[skin.face[nearest]]])
        along[around[around >= 0]] *= 0.5
    return along


def _rows(skin: SkinSurface, row: Ints, points: Ints, normals: Floats, directions: Floats) -> sp.csr_array:
    """(n, K): how far points of the skin move along given normals by a displacement of the corners."""
    columns = row[skin.faces[skin.face[points]]]
    known = columns >= 0
    share = skin.share[points] * np.einsum("nki,ni->nk", directions[columns], normals)
    number = np.broadcast_to(np.arange(len(points))[:, None], columns.shape)
    shape = (len(points), len(directions))
    return sp.csr_array((share[known], (number[known], columns[known])), shape=shape)


def _moved(skin: SkinSurface, row: Ints, along: Floats, directions: Floats) -> SkinSurface:
    """The skin's points displaced with their corners; directions turned with their faces."""
    columns = row[skin.faces]
    shift = np.where((columns >= 0)[..., None], (along[:, None] * directions)[columns], 0.0)
    return skin.moved(shift)


def _smoothness(torso: TorsoModel, skin: SkinSurface, row: Ints) -> sp.csr_array:
    """(K, K) energy of a displacement: of a membrane over skin's faces, with a spring that fades it."""
    corners = torso.tissue.rest_positions[skin.faces]
    columns = row[skin.faces]
    edge = np.stack([corners[:, 2] - corners[:, 1], corners[:, 0] - corners[:, 2], corners[:, 1] - corners[:, 0]], 1)
    twice = np.linalg.norm(np.cross(edge[:, 0], edge[:, 1]), axis=1)
    local = np.einsum("fai,fbi->fab", edge, edge) / (2.0 * twice[:, None, None])
    local += np.eye(3) * (twice / 6.0 / FADE_MM**2)[:, None, None]
    rows, others = np.broadcast_to(columns[:, :, None], local.shape), np.broadcast_to(columns[:, None, :], local.shape)
    known = (rows >= 0) & (others >= 0)
    size = int(row.max()) + 1
    return sp.csr_array((local[known] / BEND_MM**2, (rows[known], others[known])), shape=(size, size))


def _bone_points(torso: TorsoModel, skin: SkinSurface, step: float = BONE_STEP_MM) -> Floats:
    """(n, 3) mm, points of the bones that lie near the skin."""
    every = np.vstack(
        [
            dense_points((torso.surface_positions(torso.rest_pose, bone), surface.faces), step)
            for bone, surface in enumerate(torso.bone_surfaces)
        ]
    )
    distance, nearest = skin.tree.query(every, distance_upper_bound=NEAR_BONE_MM)
    near = np.isfinite(distance)
    near[near] &= ~skin.ends[nearest[near]]
    return every[near]


def _cover(points: Floats, normals: Floats, tree: cKDTree, bones: Floats) -> tuple[Floats, Ints]:
    """How deep (n,) mm bone points lie under the skin's nearest point, and which that is."""
    _, nearest = tree.query(bones)
    return np.einsum("ni,ni->n", points[nearest] - bones, normals[nearest]), nearest


def _coverage(torso: TorsoModel, skin: SkinSurface, scan: SkinScan, found: Matches) -> tuple[float, tuple[str, ...]]:
    """The share of the skin that the scan covers, and the parts of it that it doesn't."""
    on = ~skin.ends
    distance = cKDTree(scan.points[found.scan]).query(skin.points[on])[0]
    area, covered = skin.area[on], distance < COVERED_MM
    normal, height = skin.normals[on], skin.points[on, 1]
    across = np.abs(normal[:, 0]) > np.abs(normal[:, 2])
    side = np.where(across, np.where(normal[:, 0] > 0.0, 2, 3), np.where(normal[:, 2] > 0.0, 0, 1))
    stops = [torso.rest_pose.bone_positions[torso.bone(name), 1] for _, name in LEVELS]
    level = (height[:, None] < np.array(stops)).sum(1)
    names = (*(name for name, _ in LEVELS), LOWEST)
    left = []
    for which, said in enumerate(SIDES):
        parts = [(side == which) & (level == number) & (area > 0.0) for number in range(len(names))]
        bare = [
            name
            for name, part in zip(names, parts)
            if part.any() and area[part & covered].sum() < LEAST_COVERED * area[part].sum()
        ]
        if bare:
            left.append(said if len(bare) == len(names) else f"{said} of {' and '.join(bare)}")
    return float(area[covered].sum() / area.sum()), tuple(left)
