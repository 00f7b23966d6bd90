"""Bones, joints, boxes and landmarks of the reference body, put together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.names import BONE_INDEX, BONES, JOINTS, RIBS, VERTEBRAE
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.stiffness import DEFAULT_POISSON, DEFAULT_YOUNG_MPA, joint_stiffness, lame_parameters
from spinestiff.anatomy.template import sizes
from spinestiff.anatomy.template.girdle import (
    LeftGirdle,
    clavicle_surface,
    humerus_surface,
    left_girdle,
    scapula_surface,
    sternum_surface,
)
from spinestiff.anatomy.template.pelvis import pelvis_bounds, pelvis_surface
from spinestiff.anatomy.template.ribs import LeftRib, left_ribs, rib_surface
from spinestiff.anatomy.template.skin import Skin, build_skin
from spinestiff.anatomy.template.surfaces import Surface, mirrored, signed_volume, tangents
from spinestiff.anatomy.template.vertebrae import Spine, build_spine, vertebra_boxes, vertebra_surface
from spinestiff.anatomy.torso import BoneSurface, JointTable, TissueMesh, TorsoModel, TorsoState, joint_frames
from spinestiff.arrays import Floats, Ints

_MIRROR = np.array([-1.0, 1.0, 1.0])


@dataclass(frozen=True)
class Skeleton:
    """The reference body's bones in the world.

    Attributes
    ----------
    spine, ribs, girdle, skin : the parts it is made of; ribs and girdle are the left ones.
    positions, rotations : (49, 3), (49, 3, 3) bone frames.
    surfaces : (49,) in world axes.
    """

    spine: Spine
    ribs: tuple[LeftRib, ...]
    girdle: LeftGirdle
    skin: Skin
    positions: Floats
    rotations: Floats
    surfaces: tuple[Surface, ...]


def build_skeleton() -> Skeleton:
    """The reference skeleton and skin."""
    spine = build_spine()
    girdle = left_girdle(spine)
    skin = build_skin(spine, girdle)
    ribs = left_ribs(spine)
    surfaces: dict[str, Surface] = {}
    for i, name in enumerate(VERTEBRAE):
        vertices, faces = vertebra_surface(i)
        surfaces[name] = (vertices @ spine.rotations[i].T + spine.centres[i], faces)
    surfaces["pelvis"], surfaces["sternum"] = pelvis_surface(), sternum_surface(spine)
    left = {f"R{i + 1}": rib_surface(rib, i) for i, rib in enumerate(ribs)}
    left |= {"clavicle": clavicle_surface(girdle), "scapula": scapula_surface(girdle, spine)}
    left |= {"humerus": humerus_surface(girdle)}
    for name, surface in left.items():
        surfaces[f"{name}_L"], surfaces[f"{name}_R"] = surface, mirrored(surface)
    positions = np.array([centroid(surfaces[name]) for name in BONES])
    rotations = np.tile(np.eye(3), (len(BONES), 1, 1))
    positions[: len(VERTEBRAE)], rotations[: len(VERTEBRAE)] = spine.centres, spine.rotations
    positions[BONE_INDEX["pelvis"]] = _pelvis_origin(skin)
    positions[: BONE_INDEX["sternum"] + 1, 0] = 0.0  # exactly in the middle plane
    return Skeleton(spine, ribs, girdle, skin, positions, rotations, tuple(surfaces[name] for name in BONES))


def centroid(surface: Surface) -> Floats:
    """Centre of the enclosed volume, mm."""
    vertices, faces = surface
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    volume = np.einsum("ti,ti->t", a, np.cross(b, c)) / 6.0
    return np.asarray((volume[:, None] * (a + b + c)).sum(0) / 4.0 / signed_volume(surface))


def _pelvis_origin(skin: Skin) -> Floats:
    bottom, top = pelvis_bounds()
    y = 0.5 * (bottom + top)
    _, front, back, _, _ = skin.row(np.array(y))
    return np.array([0.0, y, 0.5 * (float(front) + float(back))])


def _frame(x: Floats) -> Floats:
    # X as given, Y as close to up as it can be (forward for an X that is itself upright), Z to complete it.
    x = x / np.linalg.norm(x)
    hint = np.array([0.0, 1.0, 0.0]) if abs(x[1]) < 0.9 else np.array([0.0, 0.0, 1.0])
    y = hint - (hint @ x) * x
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], -1)


def _joint_place(skeleton: Skeleton, parent: str, child: str, kind: str) -> tuple[Floats, Floats]:
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
        centre, x = _joint_place(skeleton, *joint)
        side = _MIRROR if joint.child.endswith("_R") else 1.0
        centres[j], axes[j] = centre * side, _frame(x * side)
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


def _rearmost(surface: Surface, count: int, apart: float) -> Floats:
    vertices = surface[0][np.argsort(surface[0][:, 2], kind="stable")]
    chosen = [vertices[0]]
    for vertex in vertices[1:]:
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
    wall = {"scapula": _rearmost(surface("scapula"), 2, 40.0)}
    wall |= {name: _rearmost(surface(name), 1, 0.0) for name in rib_names[3:10]}
    pelvis = BONE_INDEX["pelvis"]
    return {
        "rib_lateral": both(lateral),
        "wall": both(wall),
        "humerus_head": both({"humerus": skeleton.girdle.glenohumeral[None]}),
        "pelvis_belt": PointsOnBones(np.array([pelvis]), np.zeros((1, 3))),
    }


def assemble(skeleton: Skeleton, nodes: Floats, elements: Ints, bone_of_node: Ints) -> TorsoModel:
    """The torso from its skeleton and a tissue mesh (as ``TissueMesh``), 157 cm tall."""
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
        vertebra_boxes=vertebra_boxes(),
        bone_surfaces=surfaces,
        landmarks=build_landmarks(skeleton, rest),
        height_cm=sizes.HEIGHT_CM,
    )
