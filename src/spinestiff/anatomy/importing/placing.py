"""Joints, boxes and landmarks on the surfaces of a user's own bones, by the rules of the template (its assemble.py).

Discs lie midway between facing endplates; a rib's joint with its vertebra is the middle of the costovertebral and
the costotransverse point; its joint with the sternum lies at its front end; the shoulder's joints lie at the
clavicle's ends and in the middle of the humeral head.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from spinestiff.anatomy.importing.repairing import edges_of
from spinestiff.anatomy.importing.tubes import centreline, fitted_sphere
from spinestiff.anatomy.importing.vertebra import MeasuredVertebra, fitted_plane, measure_vertebra
from spinestiff.anatomy.names import BONE_INDEX, BONES, JOINTS, RIBS, SIDES, VERTEBRAE
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.rotation import mean_rotation
from spinestiff.anatomy.solids import dense_points, enclosed, exits
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.template.assemble import centroid, frame_along, rearmost
from spinestiff.anatomy.template.ribs import left_ribs
from spinestiff.anatomy.template.surfaces import Surface, arc_length, tangents
from spinestiff.anatomy.template.vertebrae import build_spine
from spinestiff.arrays import Floats
from spinestiff.errors import TorsoError

MEETING_MM = 8.0  # bones nearer than this meet there; farther ones are joined at the end of the one
FAR_MM = 40.0  # of a 157 cm body: a rib's head this far from its vertebra belongs to another
# A rib without its cartilage ends as far from the sternum as the template's cartilage spans, a whole one no farther
# than it is short. A fifth more is taken and CUT_MM: the template's own spans differ by up to 8 mm (ribs 1 to 4), else
# 12 to 16 %, over its bodies (ages, sexes, curves) of one length of the spine.
RIB_VARIATION = 1.2
CUT_MM = 20.0  # of a 157 cm body: where bone passes into cartilage is no sharp end
NECK_MM = 13.2  # along a floating rib from its head, the point that stands for the costotransverse joint
TRANSVERSE_ARC_MM = (10.0, 60.0)  # where along a rib its tubercle is looked for
MOST_OVERLAP = 0.6  # of neighbouring vertebrae, share of a body's height
STUMP_MM = 45.0  # of the humerus below the middle of its head
HEAD_RADII_MM = (12.0, 34.0)


@dataclass(frozen=True)
class Skeleton:
    """A user's bones in the world and what was measured on them.

    Attributes
    ----------
    surfaces : for each of the 49 bones, closed, world mm.
    vertebrae : for each of the 17 vertebrae.
    centres, axes : (67, 3) mm, (67, 3, 3) world_from_joint.
    humerus_heads : (2, 3) mm, left and right.
    column_mm : length of the spine's polyline from T1's upper endplate to the sacrum's.
    notes : what a person should know.
    """

    surfaces: Mapping[str, Surface]
    vertebrae: Mapping[str, MeasuredVertebra]
    centres: Floats
    axes: Floats
    humerus_heads: Floats
    column_mm: float
    notes: tuple[str, ...]


def place_joints(surfaces: Mapping[str, Surface]) -> tuple[Skeleton, Floats]:
    """All 67 joints of 49 bones.

    The world's origin moves to the middle of the sacral endplate (where it was is returned, (3,) mm), and long humeri
    are cut below their head.

    Raises
    ------
    TorsoError : naming the bone on which a landmark can't be found.
    """
    notes: list[str] = []
    dense = {name: dense_points(surface, 2.5) for name, surface in surfaces.items()}
    vertebrae = _measured(surfaces, dense, notes)
    sacral, sacral_axes = _sacral_endplate(surfaces["pelvis"], vertebrae["L5"])
    column = [vertebrae["T1"].upper, *(v.lower for v in vertebrae.values()), sacral]
    column_mm = float(np.linalg.norm(np.diff(np.array(column), axis=0), axis=1).sum())
    share = column_mm / template_column_mm()
    centres, axes = np.zeros((len(JOINTS), 3)), np.zeros((len(JOINTS), 3, 3))
    facing = [*((v.upper, v.upper_axes) for v in list(vertebrae.values())[1:]), (sacral, sacral_axes)]
    for j, vertebra in enumerate(vertebrae.values()):
        below, below_axes = facing[j]
        centres[j] = 0.5 * (vertebra.lower + below)
        axes[j] = mean_rotation(vertebra.lower_axes, below_axes)
    trees = {name: cKDTree(dense[name]) for name in VERTEBRAE[:13]}
    curves = {name: _rib_curve(name, surfaces[name], trees, share) for name in RIBS}
    for upper, lower in zip(RIBS, RIBS[2:]):
        rise = float((curves[lower][0] - curves[upper][0]) @ vertebrae[f"T{upper[1:-2]}"].axes[:, 1])
        if rise >= 0.0:
            raise TorsoError(f"{upper}: its head lies {rise:.0f} mm below that of {lower}; are their names swapped?")
    surfaces, heads = dict(surfaces), {}
    for side in SIDES:
        name = f"humerus_{side}"
        heads[side] = _humeral_head(name, dense[name], dense[f"scapula_{side}"], share)
        cut = cut_below(surfaces[name], float(heads[side][1] - STUMP_MM * share))
        if cut is not None:
            surfaces[name] = cut
            notes.append(
                f"{name}: shaft cut {STUMP_MM * share:.0f} mm below the head's middle; the arm is no part of the torso"
            )
    clavicles = {side: _clavicle(side, surfaces, dense) for side in SIDES}
    for j, joint in enumerate(JOINTS):
        side = joint.child[-1]
        if joint.kind == "rib_vertebra":
            centre, x = _rib_vertebra(
                joint.child, curves[joint.child], vertebrae[joint.parent], dense[joint.parent], share
            )
        elif joint.kind == "rib_sternum":
            curve = curves[joint.child]
            most = _most_cartilage(joint.child, curve, share)
            centre, note = _meeting(
                joint.child, curve[-1], "sternum", surfaces["sternum"], dense["sternum"], share, most
            )
            x = -tangents(curve)[-1]
            notes += [note] if note else []
        elif joint.kind in ("sternum_clavicle", "clavicle_scapula"):
            medial = joint.kind == "sternum_clavicle"
            other = joint.parent if medial else joint.child
            end = clavicles[side][0 if medial else -1]
            most = FAR_MM * share
            centre, note = _meeting(f"clavicle_{side}", end, other, surfaces[other], dense[other], share, most)
            x = clavicles[side][-1] - clavicles[side][0]
            notes += [note] if note else []
        elif joint.kind == "scapula_humerus":
            centre, x = heads[side], clavicles[side][-1] - clavicles[side][0]
        else:
            continue
        centres[j], axes[j] = centre, frame_along(x)
    moved = {name: (vertices - sacral, faces) for name, (vertices, faces) in surfaces.items()}
    shifted = {name: _shifted(v, sacral) for name, v in vertebrae.items()}
    head = np.array([heads[side] for side in SIDES]) - sacral
    return Skeleton(moved, shifted, centres - sacral, axes, head, column_mm, tuple(notes)), sacral


@lru_cache(maxsize=1)
def template_column_mm() -> float:
    """``Skeleton.column_mm`` of the 157 cm template."""
    torso = template_torso(157.0)
    rest = torso.rest_pose
    boxes = np.einsum("vij,vkj->vki", rest.bone_rotations[:17], torso.vertebra_boxes) + rest.bone_positions[:17, None]
    line = np.vstack([boxes[0, :4].mean(0), boxes[:, 4:].mean(1), np.zeros(3)])  # the origin is the sacral endplate
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def _shifted(v: MeasuredVertebra, by: Floats) -> MeasuredVertebra:
    return MeasuredVertebra(v.centre - by, v.axes, v.box, v.upper - by, v.lower - by, v.upper_axes, v.lower_axes)


def _measured(
    surfaces: Mapping[str, Surface], dense: Mapping[str, Floats], notes: list[str]
) -> dict[str, MeasuredVertebra]:
    # Of volume: the vertices' mean lies where the mesh is dense.
    middles = np.array([centroid(surfaces[name]) for name in VERTEBRAE])
    # Ends: as their neighbours; within, from the vertebra two below to that two above.
    spans = [(max(i - 2, 0), min(i + 2, len(VERTEBRAE) - 1)) for i in range(len(VERTEBRAE))]
    ups = [middles[a] - middles[b] for a, b in spans]
    found = {name: measure_vertebra(name, surfaces[name], up, dense[name]) for name, up in zip(VERTEBRAE, ups)}
    for upper, lower in zip(VERTEBRAE, VERTEBRAE[1:]):
        v, w = found[upper], found[lower]
        overlap = -float((v.lower - w.upper) @ (v.axes[:, 1] + w.axes[:, 1])) / 2.0
        if overlap > MOST_OVERLAP * float(np.linalg.norm(v.upper - v.lower)):
            raise TorsoError(f"{upper} and {lower}: their bodies overlap by {overlap:.0f} mm; is one out of place?")
        if overlap > 2.0:
            notes.append(f"{upper} and {lower}: their bodies overlap by {overlap:.0f} mm; check how they were placed")
    return found


def _sacral_endplate(pelvis: Surface, lowest: MeasuredVertebra) -> tuple[Floats, Floats]:
    # Where rays from L5's lower endplate meet the sacrum.
    width, depth = np.ptp(lowest.box[4:, 0]), np.ptp(lowest.box[4:, 2])
    grid = np.linspace(-0.3, 0.3, 5)
    s, t = (v.ravel() for v in np.meshgrid(grid * width, grid * depth, indexing="ij"))
    down = -lowest.lower_axes[:, 1]
    up = lowest.lower_axes[:, 1]
    centre = lowest.lower
    for _ in range(3):
        starts = centre + np.outer(s, lowest.lower_axes[:, 0]) + np.outer(t, lowest.lower_axes[:, 2])
        # From deep inside the sacrum up and out of it: pieces inside it then don't matter.
        deep = starts + 18.0 * down
        hits = exits(pelvis, deep, up)
        points = deep + hits[:, None] * up
        good = np.isfinite(hits)
        if good.sum() < 8:
            raise TorsoError("pelvis: no sacral endplate found below L5; is the sacrum part of the pelvis?")
        plate, normal = fitted_plane(points[good], lowest.lower_axes[:, 1])
        up, down = normal, -normal
    x = lowest.lower_axes[:, 0]
    y = normal
    x = x - (x @ y) * y
    x /= np.linalg.norm(x)
    # The plate's centre: below L5's along the mean normal.
    along = lowest.lower_axes[:, 1] + y
    at = lowest.lower + along * float((plate - lowest.lower) @ y / (along @ y))
    return at, np.stack([x, y, np.cross(x, y)], -1)


def _rib_curve(name: str, surface: Surface, vertebrae: Mapping[str, cKDTree], share: float) -> Floats:
    # From the head to the front end; ``vertebrae`` by points spread over them.
    curve = centreline(name, surface)
    level = int(name[1:-2])
    gaps = [vertebrae[f"T{level}"].query(curve[end])[0] for end in (0, -1)]
    curve = curve if gaps[0] <= gaps[1] else curve[::-1]
    others = {v: float(tree.query(curve[0])[0]) for v, tree in vertebrae.items()}
    nearest = min(others, key=lambda v: others[v])
    if min(gaps) > FAR_MM * share or abs(VERTEBRAE.index(nearest) + 1 - level) > 1:
        raise TorsoError(
            f"{name}: its head lies {min(gaps):.0f} mm from T{level} and {others[nearest]:.0f} mm from {nearest}; "
            "is its name right?"
        )
    return curve


def _rib_vertebra(
    name: str, curve: Floats, vertebra: MeasuredVertebra, samples: Floats, share: float
) -> tuple[Floats, Floats]:
    level = int(name[1:-2])
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])

    def on_curve(s: Floats | float) -> Floats:
        return np.stack([np.interp(s, arc, curve[:, i]) for i in range(3)], -1)

    if level > 10:
        tubercle = on_curve(NECK_MM * share)
    else:
        side = 1.0 if name.endswith("_L") else -1.0
        lateral = (samples - vertebra.centre) @ vertebra.axes[:, 0] * side
        # The transverse process: what of the vertebra reaches farthest to that side.
        tip = samples[lateral > lateral.max() - 4.0].mean(0)
        s = share * np.linspace(*TRANSVERSE_ARC_MM, 200)
        points = on_curve(np.minimum(s, 0.5 * arc[-1]))
        tubercle = points[np.argmin(np.linalg.norm(points - tip, axis=1))]
    return 0.5 * (curve[0] + tubercle), tubercle - curve[0]


@lru_cache(maxsize=1)
def _template_ribs() -> tuple[tuple[float, float], ...]:
    # (mm, mm) of ribs 1 to 10: length with cartilage, and from the end of the bone straight to the sternum.
    found = []
    for rib in left_ribs(build_spine())[:10]:
        length = arc_length(rib.curve)
        arc = np.linspace(0.0, length, len(rib.curve))
        bony_end = np.array([np.interp(rib.bony * length, arc, rib.curve[:, i]) for i in range(3)])
        found.append((length, float(np.linalg.norm(rib.notch - bony_end))))
    return tuple(found)


def _most_cartilage(name: str, curve: Floats, share: float) -> float:
    # mm, how far from the sternum a rib may end.
    length, span = _template_ribs()[int(name[1:-2]) - 1]
    missing = RIB_VARIATION * length * share - arc_length(curve)
    return max(FAR_MM * share, min((RIB_VARIATION * span + CUT_MM) * share, missing))


def _meeting(
    name: str, end: Floats, other: str, surface: Surface, samples: Floats, share: float, most: float
) -> tuple[Floats, str]:
    # Where the end of a bone meets another: midway to it, or at the end itself where they touch or are far apart.
    gap, nearest = cKDTree(samples).query(end)
    if enclosed(surface, end[None])[0]:
        return end, ""
    if gap <= MEETING_MM * share:
        return 0.5 * (end + samples[nearest]), ""
    if gap > most:
        raise TorsoError(
            f"{name} ends {gap:.0f} mm from {other}; wanted at most {most:.0f} mm; is it whole and in place?"
        )
    return end, f"{name} ends {gap:.0f} mm from {other}: their joint is put at this end"


def _clavicle(side: str, surfaces: Mapping[str, Surface], dense: Mapping[str, Floats]) -> Floats:
    # From the sternum to the scapula.
    curve = centreline(f"clavicle_{side}", surfaces[f"clavicle_{side}"])
    gaps = cKDTree(dense["sternum"]).query(curve[[0, -1]])[0]
    return curve if gaps[0] <= gaps[1] else curve[::-1]


def _humeral_head(name: str, samples: Floats, scapula: Floats, share: float) -> Floats:
    # The sphere under the end of the humerus that faces the scapula.
    top = samples[:, 1].max()
    upper = samples[samples[:, 1] > top - 60.0 * share]
    gap = cKDTree(scapula).query(upper)[0]
    near = upper[gap < np.quantile(gap, 0.7)]
    centre, radius = fitted_sphere(near, tuple(share * r for r in HEAD_RADII_MM))  # type: ignore[arg-type]
    if not np.isfinite(radius) or gap.min() > FAR_MM * share:
        raise TorsoError(f"{name}: no round head found beside the scapula; is the humerus upright and its name right?")
    return centre


def cut_below(surface: Surface, height: float) -> Surface | None:
    """The part of a closed surface above y = ``height``, closed again by a flat lid; None if nothing lies below.

    The lid is a fan, so the section should be about convex, as a shaft's is.
    """
    vertices, faces = surface
    above = vertices[:, 1] >= height
    if above.all():
        return None
    points, kept = [vertices], [faces[above[faces].all(1)]]
    crossing = faces[above[faces].any(1) & ~above[faces].all(1)]
    number: dict[tuple[int, int], int] = {}
    new_points: list[Floats] = []
    new_faces: list[list[int]] = []

    def between(a: int, b: int) -> int:
        key = (min(a, b), max(a, b))
        if key not in number:
            number[key] = len(vertices) + len(new_points)
            t = (height - vertices[key[0], 1]) / (vertices[key[1], 1] - vertices[key[0], 1])
            new_points.append(vertices[key[0]] + t * (vertices[key[1]] - vertices[key[0]]))
        return number[key]

    for face in crossing.tolist():
        ring: list[int] = []
        for i in range(3):
            a, b = face[i], face[(i + 1) % 3]
            if above[a]:
                ring.append(a)
            if above[a] != above[b]:
                ring.append(between(a, b))
        new_faces += [[ring[0], ring[i], ring[i + 1]] for i in range(1, len(ring) - 1)]
    points.append(np.array(new_points))
    kept.append(np.array(new_faces, dtype=np.int64))
    body = np.vstack(kept)
    # The lid: every rim edge of the section, run backwards, to the section's middle.
    directed = edges_of(body)
    low, high = directed.min(1), directed.max(1)
    _, inverse = np.unique(np.stack([low, high], -1), axis=0, return_inverse=True)
    net = np.bincount(inverse.ravel(), np.where(directed[:, 0] < directed[:, 1], 1, -1))
    rim = directed[(net[inverse.ravel()] != 0) & (directed >= len(vertices)).all(1)]
    centre = len(vertices) + len(new_points)
    points.append(np.array(new_points).mean(0)[None])
    lid = np.stack([rim[:, 1], rim[:, 0], np.full(len(rim), centre)], -1)
    every, all_faces = np.vstack(points), np.vstack([body, lid])
    used, renumbered = np.unique(all_faces, return_inverse=True)
    return every[used], renumbered.reshape(all_faces.shape)


def rest_frames(skeleton: Skeleton, pelvis_origin: Floats) -> tuple[Floats, Floats]:
    """(49, 3) mm and (49, 3, 3): vertebrae in their bodies' frames, other bones upright at their centres of volume."""
    positions = np.array([centroid(skeleton.surfaces[name]) for name in BONES])
    rotations = np.tile(np.eye(3), (len(BONES), 1, 1))
    for i, vertebra in enumerate(skeleton.vertebrae.values()):
        positions[i], rotations[i] = vertebra.centre, vertebra.axes
    positions[BONE_INDEX["pelvis"]] = pelvis_origin
    return positions, rotations


def landmarks(skeleton: Skeleton, rest: TorsoState) -> dict[str, PointsOnBones]:
    """The named points of ``TorsoModel.landmarks``, by the template's rules."""

    def on(points: Mapping[str, Floats]) -> PointsOnBones:
        bones = np.repeat([BONE_INDEX[name] for name in points], [len(at) for at in points.values()])
        return PointsOnBones.at(rest, bones, np.vstack(list(points.values())))

    vertices = {name: surface[0] for name, surface in skeleton.surfaces.items()}
    outward = {name: 1.0 if name.endswith("_L") else -1.0 for name in BONES}
    lateral = {name: vertices[name][[np.argmax(vertices[name][:, 0] * outward[name])]] for name in RIBS}
    wall = {f"scapula_{side}": rearmost(vertices[f"scapula_{side}"], 2, 40.0) for side in SIDES}
    wall |= {name: rearmost(vertices[name], 1, 0.0) for name in RIBS[6:20]}
    heads = {f"humerus_{side}": at[None] for side, at in zip(SIDES, skeleton.humerus_heads)}
    pelvis = BONE_INDEX["pelvis"]
    belt = {"pelvis": rest.bone_positions[pelvis][None]}
    return {"rib_lateral": on(lateral), "wall": on(wall), "humerus_head": on(heads), "pelvis_belt": on(belt)}
