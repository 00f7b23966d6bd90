"""OpenSim 4: every bone a free body, every joint a BushingForce between two offset frames."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import numpy as np

from spinestiff.anatomy.export.rigid import masses, numbers
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats

_M = 1e-3
_LOCKED = 1e-9  # cos y, below which x and z turn about the same axis
_COORDINATES = ("rx", "ry", "rz", "tx", "ty", "tz")


def xyz_angles(rotation: Floats) -> Floats:
    """(3,) rad, body-fixed x-y-z angles of a rotation (3, 3): R = Rx Ry Rz; z = 0 where y is a right angle."""
    y = np.arcsin(np.clip(rotation[0, 2], -1.0, 1.0))
    if np.hypot(rotation[1, 2], rotation[2, 2]) < _LOCKED:
        return np.array([np.arctan2(rotation[2, 1], rotation[1, 1]), y, 0.0])
    return np.array([np.arctan2(-rotation[1, 2], rotation[2, 2]), y, np.arctan2(-rotation[0, 1], rotation[0, 0])])


def content(torso: TorsoModel, state: TorsoState) -> bytes:
    """The file. Gravity is off; bones stand where they are in ``state``; every coordinate is free."""
    document = ElementTree.Element("OpenSimDocument", Version="40000")
    model = ElementTree.SubElement(document, "Model", name="spinestiff_torso")
    _text(model, "credits", "Written by spinestiff: bones and compliant joints of a torso, without its soft tissue.")
    _text(model, "gravity", "0 0 0")
    _text(model, "length_units", "meters")
    _text(model, "force_units", "N")
    ground = ElementTree.SubElement(model, "Ground", name="ground")
    del ground
    bodies = _objects(model, "BodySet", "bodyset")
    joints = _objects(model, "JointSet", "jointset")
    forces = _objects(model, "ForceSet", "forceset")
    mass, inertia = masses(torso)
    for i, name in enumerate(torso.bone_names):
        body = ElementTree.SubElement(bodies, "Body", name=name)
        _text(body, "mass", repr(float(mass[i])))
        _text(body, "mass_center", "0 0 0")
        _text(body, "inertia", numbers(np.concatenate([inertia[i], np.zeros(3)])))
        joint = ElementTree.SubElement(joints, "FreeJoint", name=f"{name}_free")
        _text(joint, "socket_parent_frame", "/ground")
        _text(joint, "socket_child_frame", f"/bodyset/{name}")
        coordinates = ElementTree.SubElement(joint, "coordinates")
        values = [*xyz_angles(state.bone_rotations[i]), *(_M * state.bone_positions[i])]
        for which, value in zip(_COORDINATES, values):
            coordinate = ElementTree.SubElement(coordinates, "Coordinate", name=f"{name}_{which}")
            _text(coordinate, "default_value", repr(float(value)))
    table = torso.joints
    for j in range(len(table)):
        name = table.names[j].replace("-", "_to_")
        force = ElementTree.SubElement(forces, "BushingForce", name=name)
        _text(force, "socket_frame1", "parent")
        _text(force, "socket_frame2", "child")
        frames = ElementTree.SubElement(force, "frames")
        for side, bone in (("parent", table.parent[j]), ("child", table.child[j])):
            frame = ElementTree.SubElement(frames, "PhysicalOffsetFrame", name=side)
            _text(frame, "socket_parent", f"/bodyset/{torso.bone_names[bone]}")
            _text(frame, "translation", numbers(_M * getattr(table, f"{side}_position")[j]))
            _text(frame, "orientation", numbers(xyz_angles(getattr(table, f"{side}_axes")[j])))
        # N mm/rad to N m/rad, N/mm to N/m.
        _text(force, "rotational_stiffness", numbers(_M * table.stiffness[j, 3:]))
        _text(force, "translational_stiffness", numbers(table.stiffness[j, :3] / _M))
        _text(force, "rotational_damping", "0 0 0")
        _text(force, "translational_damping", "0 0 0")
    ElementTree.indent(document)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(document) + b"\n"


def _text(parent: ElementTree.Element, tag: str, text: str) -> None:
    ElementTree.SubElement(parent, tag).text = text


def _objects(model: ElementTree.Element, tag: str, name: str) -> ElementTree.Element:
    return ElementTree.SubElement(ElementTree.SubElement(model, tag, name=name), "objects")
