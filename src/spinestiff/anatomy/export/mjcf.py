"""MuJoCo: a tree of bodies whose joints are three springy slides and three springy hinges, loops closed by welds."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections import deque

import numpy as np

from spinestiff.anatomy.export.rigid import masses, numbers, require_rest
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats

_M = 1e-3
_GHOST_KG = 1e-4
ROOT = "pelvis"


def content(torso: TorsoModel, state: TorsoState) -> bytes:
    """The file, at rest: MuJoCo's springs are at rest in the pose that is written.

    The first bone of the tree (the pelvis, where there is one) is fixed to the world. Slides and hinges act in the
    joint's frame, slides first. A joint that would close a loop ends on a small body of its own, welded to its bone.

    Raises
    ------
    TorsoError : a state that is not rest.
    """
    require_rest("MJCF", torso, state)
    rest, table = torso.rest_pose, torso.joints
    names = torso.bone_names
    root = names.index(ROOT) if ROOT in names else 0
    order, edge, reversed_ = _tree(torso, root)
    document = ElementTree.Element("mujoco", model="spinestiff_torso")
    ElementTree.SubElement(document, "compiler", angle="radian", autolimits="true")
    ElementTree.SubElement(document, "option", gravity="0 0 0", timestep="0.0001", integrator="implicit")
    world = ElementTree.SubElement(document, "worldbody")
    equality = ElementTree.SubElement(document, "equality")
    mass, inertia = masses(torso)
    centre = PointsOnBones(table.parent, table.parent_position).positions(rest)
    axes = rest.bone_rotations[table.parent] @ table.parent_axes
    bodies: dict[int, ElementTree.Element] = {}

    def place(element: ElementTree.Element, inner: int, outer: int | None) -> None:
        # Position and turn of a bone in the body that holds it.
        at, turn = rest.bone_positions[inner], rest.bone_rotations[inner]
        if outer is not None:
            at = rest.bone_rotations[outer].T @ (at - rest.bone_positions[outer])
            turn = rest.bone_rotations[outer].T @ turn
        element.set("pos", numbers(_M * at))
        element.set("quat", numbers(quaternion(turn)))

    def springs(element: ElementTree.Element, bone: int, j: int, label: str) -> None:
        # In the frame of the body that moves; the joint's axes coincide at rest.
        at = rest.bone_rotations[bone].T @ (centre[j] - rest.bone_positions[bone])
        for kind, first, scale in (("slide", 0, 1.0 / _M), ("hinge", 3, _M)):
            for k in range(3):
                axis = rest.bone_rotations[bone].T @ axes[j][:, k]
                ElementTree.SubElement(
                    element, "joint", name=f"{label}_{'xyz'[k] if first == 0 else ('alpha', 'beta', 'gamma')[k]}",
                    type=kind, axis=numbers(axis), pos=numbers(_M * at),
                    stiffness=repr(float(scale * table.stiffness[j, first + k])),
                )  # fmt: skip

    def body(parent: ElementTree.Element, name: str, kg: float, moment: Floats) -> ElementTree.Element:
        element = ElementTree.SubElement(parent, "body", name=name)
        ElementTree.SubElement(element, "inertial", pos="0 0 0", mass=repr(float(kg)), diaginertia=numbers(moment))
        return element

    for bone in order:
        j = edge[bone]
        outer = None if j < 0 else int(table.parent[j] if not reversed_[bone] else table.child[j])
        element = body(world if outer is None else bodies[outer], names[bone], mass[bone], inertia[bone])
        place(element, bone, outer)
        if j >= 0:
            springs(element, bone, j, table.names[j])
        bodies[bone] = element
    for j in sorted(set(range(len(table))) - {j for j in edge.values() if j >= 0}):
        # The loop: a small body where the child is, sprung to the parent and welded to the child.
        child, parent = int(table.child[j]), int(table.parent[j])
        ghost = body(bodies[parent], f"{names[child]}_at_{names[parent]}", _GHOST_KG, np.full(3, 1e-7))
        place(ghost, child, parent)
        springs(ghost, child, j, table.names[j])
        ElementTree.SubElement(
            equality, "weld", body1=names[child], body2=ghost.get("name", ""), solref="0.0004 1",
            solimp="0.9999 0.9999 0.001",
        )  # fmt: skip
    ElementTree.indent(document)
    return ElementTree.tostring(document) + b"\n"


def _tree(torso: TorsoModel, root: int) -> tuple[list[int], dict[int, int], dict[int, bool]]:
    # Bones in the order of a breadth-first walk over the joints, the joint each hangs on (-1 = none), and whether
    # that joint's child is the holder.
    table = torso.joints
    edge, reversed_ = {root: -1}, {root: False}
    order, queue = [root], deque([root])
    while queue or len(order) < len(torso.bone_names):
        if not queue:  # a part of its own: fixed to the world, too
            start = next(b for b in range(len(torso.bone_names)) if b not in edge)
            edge[start], reversed_[start] = -1, False
            order.append(start)
            queue.append(start)
        here = queue.popleft()
        for j in range(len(table)):
            for mine, other, turned in (
                (table.parent[j], table.child[j], False),
                (table.child[j], table.parent[j], True),
            ):
                if int(mine) == here and int(other) not in edge:
                    edge[int(other)], reversed_[int(other)] = j, turned
                    order.append(int(other))
                    queue.append(int(other))
    return order, edge, reversed_


def quaternion(rotation: Floats) -> Floats:
    """(4,) w, x, y, z of a rotation (3, 3)."""
    r = np.asarray(rotation)
    # From the symmetric matrix whose largest eigenvector is the quaternion: no branches, no small divisors.
    k = np.array(
        [
            [r[0, 0] + r[1, 1] + r[2, 2], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [0.0, r[0, 0] - r[1, 1] - r[2, 2], r[1, 0] + r[0, 1], r[0, 2] + r[2, 0]],
            [0.0, 0.0, r[1, 1] - r[0, 0] - r[2, 2], r[2, 1] + r[1, 2]],
            [0.0, 0.0, 0.0, r[2, 2] - r[0, 0] - r[1, 1]],
        ]
    )
    vector = np.linalg.eigh(k + np.triu(k, 1).T)[1][:, -1]
    return vector if vector[0] >= 0.0 else -vector
