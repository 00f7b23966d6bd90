"""Exported torsos as OpenSim and MuJoCo load them: under a small moment their bones turn as ours do, loops and all.

Both programs give forces, stiffnesses or constraints of their own making at the pose of the file; the small turn
follows from those by one linear solve. Ours is the engine's equilibrium of the same bones without tissue.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.export import export_torso
from spinestiff.anatomy.names import BONE_INDEX
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.rotation import log_so3
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.torso import TissueMesh
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import LoadCase
from spinestiff.verification.blocks import holds

MOMENT = np.array([6.0, -4.0, 8.0])  # N mm on T1
WATCHED = ("L3", "T7", "T1", "R6_L", "sternum", "humerus_R")
RELATIVE = 1e-3


@pytest.fixture(scope="module")
def bare():
    """The template's bones and joints without tissue."""
    torso = template_torso(157.0)
    none = TissueMesh(np.zeros((0, 3)), np.zeros((0, 10)), np.zeros(0), np.zeros(0), np.zeros(0))
    rest = torso.rest_pose
    state = TorsoState(rest.bone_positions, rest.bone_rotations, np.zeros((0, 3)))
    return replace(torso, tissue=none, rest_pose=state)


@pytest.fixture(scope="module")
def ours(bare):
    """(len(WATCHED), 3) rad, turns in world axes: a couple of forces on T1, pelvis held."""
    held = np.zeros((len(bare.bone_names), 6), dtype=bool)
    held[BONE_INDEX["pelvis"]] = True
    # M = sum of arm x force with forces that add up to nothing.
    axis = MOMENT / np.linalg.norm(MOMENT)
    across = np.cross(axis, [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    t1 = BONE_INDEX["T1"]
    arms = np.array([across, -across]) * 10.0 @ bare.rest_pose.bone_rotations[t1]
    force = np.cross(axis, across) * np.linalg.norm(MOMENT) / 20.0
    load = LoadCase(PointsOnBones(np.array([t1, t1]), arms), np.array([force, -force]))
    state = EquilibriumProblem(bare, holds(held)).solve(load, tolerance=1e-8).require().state
    chosen = [BONE_INDEX[name] for name in WATCHED]
    turn = state.bone_rotations[chosen] @ np.swapaxes(bare.rest_pose.bone_rotations[chosen], 1, 2)
    found = np.array([log_so3(r) for r in turn])
    assert np.abs(found).max() < 1e-3  # small: all laws of rotation agree
    assert np.abs(found).min(axis=1).max() > 1e-8
    return found


def test_mujoco_loads_it_and_turns_alike(bare, ours, tmp_path):
    mujoco = pytest.importorskip("mujoco", reason="needs MuJoCo (extra [oracles])")
    model = mujoco.MjModel.from_xml_path(str(export_torso(bare, tmp_path / "torso.xml", "mjcf")))
    loops = len(bare.joints) - (len(bare.bone_names) - 1)
    assert model.nbody == 1 + len(bare.bone_names) + loops and model.neq == loops
    assert model.njnt == 6 * len(bare.joints)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for name, position in zip(bare.bone_names, bare.rest_pose.bone_positions):
        assert data.body(name).xpos == pytest.approx(1e-3 * position, abs=1e-9)
    # The welds' Jacobian is MuJoCo's; springs of slides and hinges are diagonal in its coordinates.
    jacobian = _constraints(model, data)
    stiffness = np.zeros(model.nv)
    stiffness[model.jnt_dofadr] = np.asarray(model.jnt_stiffness).reshape(model.njnt, -1)[:, 0]
    turning = {name: np.zeros((3, model.nv)) for name in (*WATCHED, "T1")}
    for name, rows in turning.items():
        mujoco.mj_jacBody(model, data, None, rows, model.body(name).id)
    zero = np.zeros((len(jacobian), len(jacobian)))
    whole = np.block([[np.diag(stiffness), jacobian.T], [jacobian, zero]])
    force = np.concatenate([turning["T1"].T @ (1e-3 * MOMENT), np.zeros(len(jacobian))])
    q = np.linalg.lstsq(whole, force, rcond=1e-13)[0][: model.nv]
    found = np.array([turning[name] @ q for name in WATCHED])
    assert np.abs(found - ours).max() < RELATIVE * np.abs(ours).max()


def _constraints(model, data):
    # (constraints, nv); MuJoCo keeps it dense or sparse, as it likes.
    if data.efc_J.size == data.nefc * model.nv:
        return np.array(data.efc_J).reshape(data.nefc, model.nv)
    rows = np.zeros((data.nefc, model.nv))
    for i in range(data.nefc):
        start, count = data.efc_J_rowadr[i], data.efc_J_rownnz[i]
        rows[i, data.efc_J_colind[start : start + count]] = data.efc_J[start : start + count]
    return rows


def test_opensim_loads_it_and_turns_alike(bare, ours, tmp_path):
    osim = pytest.importorskip("opensim", reason="needs OpenSim (extra [oracles])")
    osim.Logger.setLevelString("Error")
    model = osim.Model(str(export_torso(bare, tmp_path / "torso.osim", "osim")))
    state = model.initSystem()
    bones = len(bare.bone_names)
    assert model.getBodySet().getSize() == bones
    assert model.getForceSet().getSize() == len(bare.joints)
    model.realizeDynamics(state)
    for name, position in zip(bare.bone_names, bare.rest_pose.bone_positions):
        at = model.getBodySet().get(name).getPositionInGround(state)
        assert [at.get(i) for i in range(3)] == pytest.approx(1e-3 * position, abs=1e-9)
    # Each bushing's stiffness over its two bones' coordinates, by differences of the forces that OpenSim computes.
    size = 6 * bones
    hessian = np.zeros((size, size))
    order = _Coordinates(osim, model, state, bare)
    forces = model.getForceSet()
    for j in range(len(bare.joints)):
        bushing = osim.BushingForce.safeDownCast(forces.get(j))
        pair = [6 * int(b) + k for b in (bare.joints.parent[j], bare.joints.child[j]) for k in range(6)]

        def force(bushing=bushing):
            values = bushing.getRecordValues(state)
            return np.array([values.get(i) for i in range(values.size())])

        # Records: force and moment on the first body, then on the second, in the ground.
        columns = []
        for dof in pair:
            plus, minus = (order.at(dof, sign, force) for sign in (1e-6, -1e-6))
            columns.append(-(plus - minus) / 2e-6)
        hessian[np.ix_(pair, pair)] += np.array(columns).T
    free = np.array([i for i in range(size) if i // 6 != BONE_INDEX["pelvis"]])
    load = np.zeros(size)
    load[6 * BONE_INDEX["T1"] + 3 : 6 * BONE_INDEX["T1"] + 6] = 1e-3 * MOMENT
    q = np.zeros(size)
    q[free] = np.linalg.solve(hessian[np.ix_(free, free)], load[free])
    found = np.array([q[6 * BONE_INDEX[name] + 3 : 6 * BONE_INDEX[name] + 6] for name in WATCHED])
    assert np.abs(found - ours).max() < RELATIVE * np.abs(ours).max()


class _Coordinates:
    """Moves one body of an OpenSim model a little: (dt, dw) in the ground's axes, by its free joint's coordinates."""

    def __init__(self, osim, model, state, torso):
        self.model, self.state, self.torso = model, state, torso
        self.sets = []
        for name in torso.bone_names:
            joint = osim.FreeJoint.safeDownCast(model.getJointSet().get(f"{name}_free"))
            kinds = ("Rotation1X", "Rotation2Y", "Rotation3Z", "TranslationX", "TranslationY", "TranslationZ")
            self.sets.append([joint.updCoordinate(getattr(osim.FreeJoint, f"Coord_{kind}")) for kind in kinds])
        self.rest = [[c.getDefaultValue() for c in coordinates] for coordinates in self.sets]

    def at(self, dof, step, ask):
        from spinestiff.anatomy.export.osim import xyz_angles
        from spinestiff.anatomy.rotation import exp_so3

        bone, k = divmod(dof, 6)
        values = list(self.rest[bone])
        if k < 3:
            values[3 + k] += step
        else:
            turned = exp_so3(step * np.eye(3)[k - 3]) @ self.torso.rest_pose.bone_rotations[bone]
            values[:3] = xyz_angles(turned)
        self._set(bone, values)
        found = ask()
        self._set(bone, self.rest[bone])
        return found

    def _set(self, bone, values):
        for coordinate, value in zip(self.sets[bone], values):
            coordinate.setValue(self.state, float(value), False)
        self.model.realizeDynamics(self.state)
