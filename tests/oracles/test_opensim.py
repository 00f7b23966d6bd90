"""Joints against OpenSim's BushingForce where the two laws coincide: about one axis, its Euler angles are our rotation
vector. OpenSim gives accelerations of bodies of unit mass; a root finder looks for where they vanish."""

from __future__ import annotations

import numpy as np
import pytest

osim = pytest.importorskip("opensim", reason="needs OpenSim (extra [oracles])")


class _Planar:
    """A chain of bodies in the plane of x and y, bushings between them, a dead force and moment on the last."""

    def __init__(self, chain, moment=0.0):
        osim.Logger.setLevelString("Error")
        self.chain = chain
        model = osim.Model()
        model.setGravity(osim.Vec3(0))
        none = osim.Vec3(0)
        below = model.getGround()
        self.joints, self.bodies, self.bushings = [], [], []
        for i, k in enumerate(chain.stiffness):
            body = osim.Body(f"b{i}", 1.0, none, osim.Inertia(1.0))
            model.addBody(body)
            # A planar joint hinders nothing in the plane; it stands where the bone's origin rests.
            start = osim.Vec3(0, chain.length * (i + 1), 0)
            joint = osim.PlanarJoint(f"j{i}", model.getGround(), start, none, body, none, none)
            model.addJoint(joint)
            frames = []
            for name, bone, side in (("upper", below, 0.5), ("lower", body, -0.5)):
                place = osim.Transform(osim.Vec3(0, side * chain.length, 0))
                frames.append(osim.PhysicalOffsetFrame(f"{name}{i}", bone, place))
                bone.addComponent(frames[-1])
            stiffness = osim.Vec3(*k[:3].tolist()), osim.Vec3(*k[3:].tolist())
            bushing = osim.BushingForce(f"k{i}", *frames, *stiffness, none, none)
            model.addForce(bushing)
            self.joints.append(joint)
            self.bodies.append(body)
            self.bushings.append(bushing)
            below = body
        pull = osim.PrescribedForce("pull", self.bodies[-1])
        pull.setForceIsInGlobalFrame(True)
        pull.setPointIsInGlobalFrame(False)
        constants = [osim.Constant(float(v)) for v in (*chain.force, *chain.arm, 0.0, 0.0, moment)]
        pull.setForceFunctions(*constants[:3])
        pull.setPointFunctions(*constants[3:6])
        pull.setTorqueFunctions(*constants[6:])
        model.addForce(pull)
        model.finalizeConnections()
        self.model, self.state = model, model.initSystem()

    def unbalanced(self, q):
        """Generalised accelerations at q (3 n,): turn, x, y of each body, and forces of the size of the stiffness."""
        for joint, (turn, x, y) in zip(self.joints, q.reshape(-1, 3)):
            for which, value in zip(
                (osim.PlanarJoint.Coord_RotationZ, osim.PlanarJoint.Coord_TranslationX,
                 osim.PlanarJoint.Coord_TranslationY), (turn, x, y),
            ):  # fmt: skip
                joint.updCoordinate(which).setValue(self.state, float(value), False)
        self.model.realizeAcceleration(self.state)
        udot = self.state.getUDot()
        return np.array([udot.get(i) for i in range(udot.size())])

    def balanced(self):
        """Bones' places and turns (n,) about z."""
        n = len(self.chain.stiffness)
        q = np.zeros(3 * n)
        size = np.abs(self.chain.stiffness[:, :2]).max()
        for _ in range(80):
            left = self.unbalanced(q)
            steps = np.tile([1e-7, 1e-5, 1e-5], n)
            slope = np.stack(
                [
                    (self.unbalanced(q + h * e) - self.unbalanced(q - h * e)) / (2 * h)
                    for h, e in zip(steps, np.eye(3 * n))
                ],
                axis=1,
            )
            step = -np.linalg.solve(slope, left)
            q = q + step / max(1.0, np.abs(step[::3]).max() / 0.3)
            if np.abs(step).max() < 1e-13:
                break
        assert np.abs(self.unbalanced(q)).max() < 1e-9 * size
        turn, x, y = q.reshape(-1, 3).T
        rest = self.chain.length * np.arange(1, n + 1)
        return np.column_stack([x, rest + y]), turn


def _same(chain, places, turns, tolerance):
    ours = np.unwrap(np.arctan2(chain.rotations[1:, 1, 0], chain.rotations[1:, 0, 0]))
    moves = chain.positions - chain.length * np.arange(len(chain.positions))[:, None] * [0, 1, 0]
    assert np.abs(places - chain.positions[1:, :2]).max() < tolerance * np.abs(moves).max()
    assert np.abs(turns - ours).max() < tolerance * max(np.abs(ours).max(), 1e-3)


def test_a_hinge_under_a_force_at_an_arm(hinge):
    _same(hinge, *_Planar(hinge).balanced(), 1e-8)


def test_a_slider_along_its_axis(slider):
    _same(slider, *_Planar(slider).balanced(), 1e-8)


def test_a_planar_chain_under_an_end_force(planar_chain):
    _same(planar_chain, *_Planar(planar_chain).balanced(), 1e-8)


def test_a_planar_chain_under_an_end_moment(wound_chain):
    chain, moment = wound_chain
    _same(chain, *_Planar(chain, moment).balanced(), 1e-8)


def test_the_energy_of_a_turned_and_shifted_joint(planar_chain):
    """What is stored, not only what it exerts: the same number in both programs at the same places."""
    from spinestiff.anatomy.state import TorsoState
    from spinestiff.mechanics.joints import joint_energies
    from spinestiff.verification.models import make_torso

    other = _Planar(planar_chain)
    n = len(planar_chain.stiffness)
    rest = np.zeros((n + 1, 3))
    rest[:, 1] = planar_chain.length * np.arange(n + 1)
    torso = make_torso(rest, [(i, i + 1) for i in range(n)], planar_chain.stiffness)
    state = TorsoState(planar_chain.positions, planar_chain.rotations, np.empty((0, 3)))
    ours = joint_energies(torso.joints, state, planar_chain.stiffness)
    turns = np.unwrap(np.arctan2(planar_chain.rotations[1:, 1, 0], planar_chain.rotations[1:, 0, 0]))
    moves = (planar_chain.positions - rest)[1:, :2]
    other.unbalanced(np.column_stack([turns, moves]).ravel())
    theirs = [bushing.computePotentialEnergy(other.state) for bushing in other.bushings]
    assert ours == pytest.approx(theirs, rel=1e-10)
