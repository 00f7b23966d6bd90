"""Joints against MuJoCo: hinges, slides and balls with a stiffness, whose energies are ours where one turn axis is free
or three are alike. The other program gives forces; a root finder looks for where they balance."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize as so

mujoco = pytest.importorskip("mujoco", reason="needs MuJoCo (extra [oracles])")


def _model(chain, joint):
    """Nested bodies; each stands at its joint, its bone half a length above; ``joint(i)`` writes body i's joints."""
    n, half = len(chain.stiffness), 0.5 * chain.length
    inner = ""
    for i in reversed(range(n)):
        place = f"0 {half if i == 0 else chain.length} 0"
        mass = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
        inner = f'<body name="b{i + 1}" pos="{place}">{mass}{joint(chain.stiffness[i])}{inner}</body>'
    text = f'<mujoco><option gravity="0 0 0"/><worldbody>{inner}</worldbody></mujoco>'
    return mujoco.MjModel.from_xml_string(text)


def _planar(k):
    slides = "".join(
        f'<joint type="slide" axis="{axis}" stiffness="{s}"/>' for axis, s in (("1 0 0", k[0]), ("0 1 0", k[1]))
    )
    return slides + f'<joint type="hinge" axis="0 0 1" stiffness="{k[5]}"/>'


def _hinge(k):
    return f'<joint type="hinge" axis="0 0 1" stiffness="{k[5]}"/>'


def _slide(k):
    return f'<joint type="slide" axis="0 1 0" stiffness="{k[1]}"/>'


def _ball(k):
    slides = "".join(
        f'<joint type="slide" axis="{axis}" stiffness="{s}"/>'
        for axis, s in (("1 0 0", k[0]), ("0 1 0", k[1]), ("0 0 1", k[2]))
    )
    return slides + f'<joint type="ball" stiffness="{k[3]}"/>'


def _balanced(model, force, point, torque=(0.0, 0.0, 0.0)):
    """Data at balance under a dead ``force`` at ``point`` (frame of the last body) and a ``torque`` of the world."""
    data = mujoco.MjData(model)
    last = model.nbody - 1

    def unbalanced(dq):
        data.qpos[:] = base
        mujoco.mj_integratePos(model, data.qpos, dq, 1.0)
        mujoco.mj_forward(model, data)
        place = data.xpos[last] + data.xmat[last].reshape(3, 3) @ point
        applied = np.zeros(model.nv)
        mujoco.mj_applyFT(model, data, np.array(force, float), np.array(torque, float), place, last, applied)
        return data.qfrc_passive + applied

    base = data.qpos.copy()
    # Positions are advanced in pieces, so that turns of balls stay small coordinates.
    size = np.abs(model.jnt_stiffness).max()
    for _ in range(60):
        left = unbalanced(np.zeros(model.nv))
        slope = np.atleast_2d(so.approx_fprime(np.zeros(model.nv), unbalanced, 1e-7))
        step = -np.linalg.solve(slope, left)
        step /= max(1.0, 2.0 * np.abs(step).max())
        moved = base.copy()
        mujoco.mj_integratePos(model, moved, step, 1.0)
        base = moved
        if np.abs(step).max() < 1e-13:
            break
    left = unbalanced(np.zeros(model.nv))
    assert np.abs(left).max() < 1e-8 * size
    return data


def _bones(data, chain):
    turns = data.xmat[1:].reshape(-1, 3, 3)
    return data.xpos[1:] + turns @ np.array([0.0, 0.5 * chain.length, 0.0]), turns


def _same(chain, data, tolerance):
    places, turns = _bones(data, chain)
    moves = np.abs(chain.positions - chain.length * np.arange(len(chain.positions))[:, None] * [0, 1, 0]).max()
    assert np.abs(places - chain.positions[1:]).max() < tolerance * moves
    assert np.abs(turns - chain.rotations[1:]).max() < tolerance * max(np.abs(chain.rotations - np.eye(3)).max(), 1e-3)


def _point(chain):
    return chain.arm + [0.0, 0.5 * chain.length, 0.0]


def test_a_hinge_under_a_force_at_an_arm(hinge):
    # Our other five axes are stiff, MuJoCo's are rigid: a joint of 1e5 N/mm gives 4e-3 mm under 400 N.
    data = _balanced(_model(hinge, _hinge), hinge.force, _point(hinge))
    angle = np.arctan2(hinge.rotations[1][1, 0], hinge.rotations[1][0, 0])
    assert data.qpos[0] == pytest.approx(angle, rel=3e-4)
    with_all = _balanced(_model(hinge, _planar), hinge.force, _point(hinge))
    _same(hinge, with_all, 1e-8)


def test_a_slider_along_its_axis(slider):
    data = _balanced(_model(slider, _slide), slider.force, _point(slider))
    assert data.qpos[0] == pytest.approx(150.0 / 40.0, rel=1e-9)
    _same(slider, data, 1e-8)


def test_a_planar_chain_under_an_end_force(planar_chain):
    _same(planar_chain, _balanced(_model(planar_chain, _planar), planar_chain.force, _point(planar_chain)), 1e-8)


def test_a_planar_chain_under_an_end_moment(wound_chain):
    chain, moment = wound_chain
    data = _balanced(_model(chain, _planar), np.zeros(3), _point(chain), (0.0, 0.0, moment))
    assert data.qpos[2::3].sum() == pytest.approx(moment * np.sum(1.0 / chain.stiffness[:, 5]), rel=1e-9)
    _same(chain, data, 1e-8)


def test_a_chain_in_space_of_joints_alike_about_all_axes(spatial_chain):
    _same(spatial_chain, _balanced(_model(spatial_chain, _ball), spatial_chain.force, _point(spatial_chain)), 1e-8)
    assert np.abs(spatial_chain.rotations[-1] - np.eye(3)).max() > 0.5
