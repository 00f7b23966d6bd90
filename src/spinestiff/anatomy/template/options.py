"""Choices the paper leaves open, as changes of a torso's joints: where discs turn, how scapulae rest, T12-L1's row."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from spinestiff.anatomy.names import INTERVERTEBRAL
from spinestiff.anatomy.stiffness import NMM_PER_NM, TABLE_1
from spinestiff.anatomy.torso import JointTable, TorsoModel, joint_frames
from spinestiff.errors import TorsoError

Thoracolumbar = Literal["lumbar", "thoracic"]
DISC_SHIFT_RANGE_MM = (0.0, 15.0)
THORACOLUMBAR_JOINT = "L1-T12"
SCAPULOTHORACIC = "scapulothoracic"  # the kind of the added joints; no row of Table 1
SCAPULA_RIB = 5  # the scapula lies on ribs 2 to 7


def with_options(
    torso: TorsoModel,
    disc_shift_mm: float = 0.0,
    scapulothoracic_n_per_mm: float = 0.0,
    thoracolumbar: Thoracolumbar = "lumbar",
) -> TorsoModel:
    """The torso with its joints as chosen; the same torso for the defaults. Parameters: ``template_torso``.

    Raises
    ------
    TorsoError : a value out of range.
    """
    low, high = DISC_SHIFT_RANGE_MM
    if not low <= disc_shift_mm <= high:
        raise TorsoError(f"shift of the disc centres {disc_shift_mm:g} mm; wanted {low:g} to {high:g} mm backwards")
    if not 0.0 <= scapulothoracic_n_per_mm <= 1e4:
        raise TorsoError(f"scapulothoracic stiffness {scapulothoracic_n_per_mm:g} N/mm; wanted 0 (none) to 10000 N/mm")
    if thoracolumbar not in INTERVERTEBRAL:
        raise TorsoError(f"T12-L1 in group '{thoracolumbar}'; wanted {' or '.join(INTERVERTEBRAL)}")
    joints = torso.joints
    if disc_shift_mm:
        joints = _shifted_discs(joints, disc_shift_mm)
    if THORACOLUMBAR_JOINT in joints.names and joints.kinds[joints.names.index(THORACOLUMBAR_JOINT)] != thoracolumbar:
        joints = _regrouped(joints, thoracolumbar)
    torso = torso if joints is torso.joints else replace(torso, joints=joints)
    return _with_scapular_springs(torso, scapulothoracic_n_per_mm) if scapulothoracic_n_per_mm else torso


def _shifted_discs(joints: JointTable, shift: float) -> JointTable:
    # Z of an intervertebral joint points forwards.
    moved = np.array([kind in INTERVERTEBRAL for kind in joints.kinds])[:, None] * shift
    return replace(
        joints,
        parent_position=joints.parent_position - moved * joints.parent_axes[:, :, 2],
        child_position=joints.child_position - moved * joints.child_axes[:, :, 2],
    )


def _regrouped(joints: JointTable, kind: str) -> JointTable:
    row = joints.names.index(THORACOLUMBAR_JOINT)
    kinds, stiffness = list(joints.kinds), np.array(joints.stiffness)
    kinds[row] = kind
    stiffness[row] = np.array(TABLE_1[kind]) * ([1.0] * 3 + [NMM_PER_NM] * 3)
    return replace(joints, kinds=tuple(kinds), stiffness=stiffness)


def _with_scapular_springs(torso: TorsoModel, stiffness: float) -> TorsoModel:
    # One joint a side between the nearest points of blade and rib; X from rib to blade, which glides and turns freely.
    from scipy.spatial import cKDTree

    rest, joints = torso.rest_pose, torso.joints
    rib, scapula = torso.bone(f"R{SCAPULA_RIB}_L"), torso.bone("scapula_L")
    on_rib, on_blade = (torso.surface_positions(rest, bone) for bone in (rib, scapula))
    distance, nearest = cKDTree(on_rib).query(on_blade)
    blade = int(np.argmin(distance))
    ends = np.stack([on_rib[nearest[blade]], on_blade[blade]])
    centres, axes = [], []
    for mirror in ([1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]):
        first, second = ends * mirror
        x = (second - first) / np.linalg.norm(second - first)
        y = np.array([0.0, 1.0, 0.0]) - x[1] * x
        y /= np.linalg.norm(y)
        centres.append(0.5 * (first + second))
        axes.append(np.stack([x, y, np.cross(x, y)], -1))
    names = [f"R{SCAPULA_RIB}_{side}" for side in "LR"], [f"scapula_{side}" for side in "LR"]
    parent, child = (np.array([torso.bone(name) for name in some]) for some in names)
    frames = joint_frames(rest, parent, child, np.array(centres), np.array(axes))
    row = [stiffness, 0.0, 0.0, 0.0, 0.0, 0.0]
    return replace(
        torso,
        joints=JointTable(
            names=joints.names + tuple(f"{a}-{b}" for a, b in zip(*names)),
            kinds=joints.kinds + (SCAPULOTHORACIC,) * 2,
            parent=np.append(joints.parent, parent),
            child=np.append(joints.child, child),
            stiffness=np.vstack([joints.stiffness, row, row]),
            **{key: np.concatenate([getattr(joints, key), frames[key]]) for key in frames},
        ),
    )
