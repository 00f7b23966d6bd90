"""The same torso seen otherwise: moved, mirrored, renumbered, in other units. Physics must not notice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, Ints
from spinestiff.mechanics.loads import LoadCase

MIRROR = np.diag([-1.0, 1.0, 1.0])
# Swapping corners 1 and 2 turns a mirrored element the right way out again.
_SWAPPED = {4: [0, 2, 1, 3], 10: [0, 2, 1, 3, 6, 5, 4, 7, 9, 8]}


def moved_state(state: TorsoState, turn: Floats, shift: Floats) -> TorsoState:
    """The state as a whole turned by ``turn`` (3, 3) about the world's origin, then shifted by (3,) mm."""
    return TorsoState(
        state.bone_positions @ turn.T + shift, turn @ state.bone_rotations, state.tissue_positions @ turn.T + shift
    )


def moved_torso(torso: TorsoModel, turn: Floats, shift: Floats) -> TorsoModel:
    """The torso with its rest pose moved; what lies in bones' frames stays."""
    tissue = replace(torso.tissue, rest_positions=torso.tissue.rest_positions @ turn.T + shift)
    return replace(torso, rest_pose=moved_state(torso.rest_pose, turn, shift), tissue=tissue)


def mirrored_state(state: TorsoState) -> TorsoState:
    """The state's mirror image in the plane x = 0."""
    return TorsoState(
        state.bone_positions @ MIRROR, MIRROR @ state.bone_rotations @ MIRROR, state.tissue_positions @ MIRROR
    )


def mirrored_torso(torso: TorsoModel) -> TorsoModel:
    """The torso's mirror image; bones' frames and joints' axes stay right-handed."""
    joints = torso.joints
    return replace(
        torso,
        rest_pose=mirrored_state(torso.rest_pose),
        joints=replace(
            joints,
            parent_position=joints.parent_position @ MIRROR,
            child_position=joints.child_position @ MIRROR,
            parent_axes=MIRROR @ joints.parent_axes @ MIRROR,
            child_axes=MIRROR @ joints.child_axes @ MIRROR,
        ),
        tissue=replace(
            torso.tissue,
            rest_positions=torso.tissue.rest_positions @ MIRROR,
            elements=torso.tissue.elements[:, _SWAPPED[torso.tissue.elements.shape[1]]],
        ),
    )


def mirrored_load(load: LoadCase) -> LoadCase:
    """The load's mirror image, on the same bones."""
    return LoadCase(PointsOnBones(load.points.bone, load.points.offset @ MIRROR), load.forces @ MIRROR, load.label)


def renumbered_torso(torso: TorsoModel, bones: Ints, nodes: Ints, elements: Ints, joints: Ints) -> TorsoModel:
    """The torso with item i of each kind taken from place ``order[i]`` of the old order."""
    rest, tissue, table = torso.rest_pose, torso.tissue, torso.joints
    new_bone, new_node = np.argsort(bones), np.argsort(nodes)
    owner = tissue.bone_of_node[nodes]
    owner = np.where(owner >= 0, new_bone[owner], -1)
    positions = tissue.rest_positions[nodes]
    return replace(
        torso,
        bone_names=tuple(torso.bone_names[i] for i in bones),
        rest_pose=TorsoState(rest.bone_positions[bones], rest.bone_rotations[bones], positions[owner < 0]),
        joints=replace(
            table,
            names=tuple(table.names[i] for i in joints),
            kinds=tuple(table.kinds[i] for i in joints),
            parent=new_bone[table.parent[joints]],
            child=new_bone[table.child[joints]],
            **{
                key: getattr(table, key)[joints]
                for key in ("parent_position", "parent_axes", "child_position", "child_axes", "stiffness")
            },
        ),
        tissue=replace(
            tissue,
            rest_positions=positions,
            elements=new_node[tissue.elements[elements]],
            bone_of_node=owner,
            lame_mu=tissue.lame_mu[elements],
            lame_lambda=tissue.lame_lambda[elements],
        ),
    )


def in_units(torso: TorsoModel, length: float) -> TorsoModel:
    """The same torso with 1 mm called ``length`` new units and N kept: stiffnesses change their numbers too."""
    per_mm, per_area = 1.0 / length, 1.0 / length**2
    scaled = torso.scaled(length)
    factors = np.array([per_mm] * 3 + [length] * 3)
    return replace(
        scaled,
        joints=replace(scaled.joints, stiffness=scaled.joints.stiffness * factors),
        tissue=replace(
            scaled.tissue, lame_mu=scaled.tissue.lame_mu * per_area, lame_lambda=scaled.tissue.lame_lambda * per_area
        ),
    )
