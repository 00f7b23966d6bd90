"""Joints that stiffen as they turn: a neutral zone, beside the linear law of every joint."""

from __future__ import annotations

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import JointTable
from spinestiff.arrays import Floats, Ints
from spinestiff.mechanics.assembly import Law, Place, Stiffness, Tangent, Unknowns, positive_part
from spinestiff.mechanics.joints import joint_gradient_shares, joint_gradients, joint_hessians, joint_pose


class NeutralZone(Law):
    """What turns k theta of some joints into k (theta / theta0)^2 theta beside the law that is there: the energy
    k theta^4 / (4 theta0^2) in each of the ``columns`` (J, 6) of the joints' table, ``scale`` times as much.

    ``scale`` (J, 6) makes up for the quadratic part's own factor, with which the joints' stiffness comes here.
    """

    def __init__(self, joints: JointTable, columns: np.ndarray, theta0: float, scale: float) -> None:
        self.joints, self.theta0 = joints, theta0
        self.factor = np.where(columns, scale, 0.0)

    def pairs(self, unknowns: Unknowns) -> Ints:
        return np.stack([self.joints.parent, self.joints.child], 1)

    def strains(self, state: TorsoState) -> Floats:
        """(J, 6)."""
        pose = joint_pose(self.joints, state)
        return np.hstack([pose.translation, pose.rotation])

    def entries(self, state: TorsoState, stiffness: Floats) -> Floats:
        """(J, 6) N mm."""
        return 0.25 * self.factor * stiffness * self.strains(state) ** 4 / self.theta0**2

    def energy(self, at: Place, stiffness: Stiffness) -> tuple[float, float]:
        return float(self.entries(at.state, stiffness.joints).sum()), np.inf

    def add_gradient(self, at: Place, stiffness: Stiffness, gradient: Floats) -> None:
        rows = joint_gradients(self.joints, at.state, self._secant(at.state, stiffness))
        bones = at.unknowns.bone_rows(gradient)
        np.add.at(bones, self.joints.parent, rows[:, :6])
        np.add.at(bones, self.joints.child, rows[:, 6:])

    def add_hessian(self, at: Place, stiffness: Stiffness, tangent: Tangent, offsets: Ints, project: bool) -> None:
        secant = self._secant(at.state, stiffness)
        blocks = joint_hessians(self.joints, at.state, secant)
        # theta times its slope, for each direction.
        slopes = joint_gradient_shares(self.joints, at.state, np.ones_like(secant))
        softer = 2.0 * self.factor * stiffness.joints / self.theta0**2
        blocks = blocks + np.einsum("js,jsa,jsb->jab", softer, slopes, slopes)
        blocks = positive_part(blocks) if project else blocks
        parent, child = self.joints.parent, self.joints.child
        tangent.add(blocks[:, :6, :6].copy(), parent, parent)
        tangent.add(blocks[:, 6:, 6:].copy(), child, child)
        lower = np.where((parent > child)[:, None, None], blocks[:, :6, 6:], blocks[:, 6:, :6])
        tangent.add(lower, np.maximum(parent, child), np.minimum(parent, child), offsets)

    def _secant(self, state: TorsoState, stiffness: Stiffness) -> Floats:
        return self.factor * stiffness.joints * self.strains(state) ** 2 / self.theta0**2
