"""Bones, joints, boxes and landmarks of a body, put together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from spinestiff.anatomy.names import BONE_INDEX, BONES, JOINTS, RIBS, VERTEBRAE
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import DEFAULT_POISSON, DEFAULT_YOUNG_MPA, joint_stiffness, lame_parameters
from spinestiff.anatomy.template.girdle import (
    LeftGirdle,
    clavicle_surface,
    humerus_surface,
    left_girdle,
    scapula_surface,
    sternum_surface,
)
from spinestiff.anatomy.template.pelvis import pelvis_surface
from spinestiff.anatomy.template.proportions import REFERENCE, Proportions
from spinestiff.anatomy.template.ribs import LeftRib, left_ribs, rib_surface
from spinestiff.anatomy.template.surfaces import Surface, meet, mirrored, signed_volume, tangents
from spinestiff.anatomy.template.trunk_skin import COVER, Skin, build_skin, covering, fitted_skin
from spinestiff.anatomy.template.vertebrae import Spine, build_spine, vertebra_boxes, vertebra_surface
from spinestiff.anatomy.torso import BoneSurface, JointTable, TissueMesh, TorsoModel, joint_frames
from spinestiff.arrays import Floats, Ints
from spinestiff.errors import TorsoError

SCAPULA_CLEAR = 2.9  # mm between points of scapula and ribs, as in the reference body
_MIRROR = np.array([-1.0, 1.0, 1.0])


@dataclass(frozen=True)
class Skeleton:
    """A body's bones in the world.

    Attributes
    ----------
    size : the body's sizes over the reference's.
    spine, ribs, girdle, skin : the parts it is made of; ribs and girdle are the left ones.
    positions, rotations : (49, 3), (49, 3, 3) bone frames.
    surfaces : (49,) in world axes.
    """

    size: Proportions
    spine: Spine
    ribs: tuple[LeftRib, ...]
    girdle: LeftGirdle
    skin: Skin
    positions: Floats
    rotations: Floats
    surfaces: tuple[Surface, ...]


def build_skeleton(size: Proportions = REFERENCE) -> Skeleton:
    """Skeleton and skin of a body; the reference's without ``size``.

    Raises
    ------
    TorsoError : the sizes do not go together.
    """
    spine = build_spine(size)
    girdle = left_girdle(spine, size)
    ribs = left_ribs(spine, size)
    surfaces: dict[str, Surface] = {}
    for i, name in enumerate(VERTEBRAE):
        vertices, faces = vertebra_surface(i)
        surfaces[name] = (size.spine * vertices @ spine.rotations[i].T + spine.centres[i], faces)
    surfaces["pelvis"], surfaces["sternum"] = pelvis_surface(size), sternum_surface(spine, size)
    left = {f"R{i + 1}": rib_surface(rib, i, size) for i, rib in enumerate(ribs)}
    left |= {"clavicle": clavicle_surface(girdle, size), "humerus": humerus_surface(girdle, size)}
    left["scapula"] = _scapula_behind([left[f"R{i + 1}"] for i in range(9)], girdle, spine, size)
    for name, surface in left.items():
        surfaces[f"{name}_L"], surfaces[f"{name}_R"] = surface, mirrored(surface)
    skin = build_skin(build_spine(), left_girdle(build_spine()))
    if size != REFERENCE:
        spines, girdles = (build_spine(), spine), (left_girdle(build_spine()), girdle)
        skin = fitted_skin(skin, spines, girdles, size)
        skin = covering(skin, np.vstack([surface[0] for surface in surfaces.values()]), size.spine * COVER)
    positions = np.array([centroid(surfaces[name]) for name in BONES])
    rotations = np.tile(np.eye(3), (len(BONES), 1, 1))
    positions[: len(VERTEBRAE)], rotations[: len(VERTEBRAE)] = spine.centres, spine.rotations
    positions[BONE_INDEX["pelvis"]] = _pelvis_origin(skin, surfaces["pelvis"])
    positions[: BONE_INDEX["sternum"] + 1, 0] = 0.0  # exactly in the middle plane
    return Skeleton(size, spine, ribs, girdle, skin, positions, rotations, tuple(surfaces[name] for name in BONES))


def _scapula_behind(ribs: list[Surface], girdle: LeftGirdle, spine: Spine, size: Proportions) -> Surface:
    # The arm's joints are given, but the blade glides: as far back as keeps it clear of the ribs.
    tree = cKDTree(np.vstack([rib[0] for rib in ribs]))
    for behind in np.arange(0.0, 40.0, 1.0):
        surface = scapula_surface(girdle, spine, size, float(behind))
        near = tree.query(surface[0])[0].min() < SCAPULA_CLEAR * size.spine
        if not near and not any(meet(surface, rib) for rib in ribs):
            return surface
    raise TorsoError("no room for the scapulae behind the ribs of this body")


def centroid(surface: Surface) -> Floats:
    """Centre of the enclosed volume, mm."""
    vertices, faces = surface
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    volume = np.einsum("ti,ti->t", a, np.cross(b, c)) / 6.0
    return np.asarray((volume[:, None] * (a + b + c)).sum(0) / 4.0 / signed_volume(surface))


def _pelvis_origin(skin: Skin, pelvis: Surface) -> Floats:
    bottom, top = float(pelvis[0][:, 1].min()), float(pelvis[0][:, 1].max())
    y = 0.5 * (bottom + top)
    _, front, back, _, _ = skin.row(np.array(y))
    return np.array([0.0, y, 0.5 * (float(front) + float(back))])


def frame_along(x: Floats) -> Floats:
    """(3, 3) axes: X as given, Y as near to up as it can be (forward where X itself is upright), Z to complete them."""
    x = x / np.linalg.norm(x)
    hint = np.array([0.0, 1.0, 0.0]) if abs(x[1]) < 0.9 else np.array([0.0, 0.0, 1.0])
    y = hint - (hint @ x) * x
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], -1)


def _joint_place(skeleton: Skeleton, child: str, kind: str) -> tuple[Floats, Floats]:
    # World centre and the X axis of a joint of the left side.
    girdle = skeleton.girdle
    clavicle = girdle.acromioclavicular - girdle.sternoclavicular
    if kind == "sternum_clavicle":
        return girdle.sternoclavicular, clavicle
    if kind == "clavicle_scapula":
        return girdle.acromioclavicular, clavicle
    if kind == "scapula_humerus":
        return girdle.glenohumeral, clavicle
    rib = skeleton.ribs[int(child[1:-2]) - 1]
    if kind == "rib_vertebra":
        return 0.5 * (rib.head + rib.tubercle), rib.tubercle - rib.head
    return rib.notch, -tangents(rib.curve)[-1]


def joint_places(skeleton: Skeleton) -> tuple[Floats, Floats]:
    """World centres (67, 3) mm and axes (67, 3, 3) world_from_joint of all joints."""
    centres, axes = np.zeros((len(JOINTS), 3)), np.zeros((len(JOINTS), 3, 3))
    for j, joint in enumerate(JOINTS):
        if joint.child in VERTEBRAE:
            level = VERTEBRAE.index(joint.child)
            centres[j], axes[j] = skeleton.spine.discs[level], skeleton.spine.disc_rotations[level]
            continue
        centre, x = _joint_place(skeleton, joint.child, joint.kind)
        side = _MIRROR if joint.child.endswith("_R") else 1.0
        centres[j], axes[j] = centre * side, frame_along(x * side)
    return centres, axes


def build_joints(skeleton: Skeleton, rest: TorsoState) -> JointTable:
    """All 67 joints with their default stiffness."""
    parent = np.array([BONE_INDEX[joint.parent] for joint in JOINTS])
    child = np.array([BONE_INDEX[joint.child] for joint in JOINTS])
    frames = joint_frames(rest, parent, child, *joint_places(skeleton))
    kinds = tuple(joint.kind for joint in JOINTS)
    return JointTable(
        names=tuple(str(joint) for joint in JOINTS),
        kinds=kinds,
        parent=parent,
        child=child,
        stiffness=joint_stiffness(),
        **frames,
    )


def rearmost(vertices: Floats, count: int, apart: float) -> Floats:
    """Up to ``count`` of the vertices (n, 3) that lie farthest back, ``apart`` mm from each other."""
    ordered = vertices[np.argsort(vertices[:, 2], kind="stable")]
    chosen = [ordered[0]]
    for vertex in ordered[1:]:
        if len(chosen) < count and min(np.linalg.norm(vertex - c) for c in chosen) >= apart:
            chosen.append(vertex)
    return np.array(chosen)


def build_landmarks(skeleton: Skeleton, rest: TorsoState) -> dict[str, PointsOnBones]:
    """Named points; see ``TorsoModel.landmarks``."""

    def both(left: dict[str, Floats]) -> PointsOnBones:
        # Left then right of each bone; the right side mirrors the left exactly.
        bones, points = [], []
        for name, at in left.items():
            for side, mirror in (("L", 1.0), ("R", _MIRROR)):
                bones += [BONE_INDEX[f"{name}_{side}"]] * len(at)
                points.append(at * mirror)
        return PointsOnBones.at(rest, np.array(bones), np.vstack(points))

    def surface(name: str) -> Surface:
        return skeleton.surfaces[BONE_INDEX[f"{name}_L"]]

    rib_names = [name[:-2] for name in RIBS[::2]]
    lateral = {name: surface(name)[0][[np.argmax(surface(name)[0][:, 0])]] for name in rib_names}
    wall = {"scapula": rearmost(surface("scapula")[0], 2, 40.0)}
    wall |= {name: rearmost(surface(name)[0], 1, 0.0) for name in rib_names[3:10]}
    pelvis = BONE_INDEX["pelvis"]
    return {
        "rib_lateral": both(lateral),
        "wall": both(wall),
        "humerus_head": both({"humerus": skeleton.girdle.glenohumeral[None]}),
        "pelvis_belt": PointsOnBones(np.array([pelvis]), np.zeros((1, 3))),
    }


def assemble(skeleton: Skeleton, nodes: Floats, elements: Ints, bone_of_node: Ints) -> TorsoModel:
    """The torso from its skeleton and a tissue mesh (as ``TissueMesh``)."""
    rest = TorsoState(skeleton.positions, skeleton.rotations, nodes[bone_of_node < 0])
    mu, lambda_ = lame_parameters(DEFAULT_YOUNG_MPA, DEFAULT_POISSON)
    count = len(elements)
    surfaces = tuple(
        BoneSurface((vertices - position) @ rotation, faces)
        for (vertices, faces), position, rotation in zip(skeleton.surfaces, skeleton.positions, skeleton.rotations)
    )
    return TorsoModel(
        bone_names=BONES,
        rest_pose=rest,
        joints=build_joints(skeleton, rest),
        tissue=TissueMesh(nodes, elements, bone_of_node, np.full(count, mu), np.full(count, lambda_)),
        vertebra_boxes=skeleton.size.spine * vertebra_boxes(),
        bone_surfaces=surfaces,
        landmarks=build_landmarks(skeleton, rest),
        height_cm=skeleton.size.height_cm,
    )
