"""Joints that stiffen as they turn: a neutral zone, beside the linear law of every joint."""

from __future__ import annotations

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import JointTable
from spinestiff.arrays import Floats
from spinestiff.mechanics.assembly import Configuration, Stiffness
from spinestiff.mechanics.joints import JointLaw, joint_gradient_shares, joint_hessians, joint_pose


class NeutralZone(JointLaw):
    """What turns k theta of some joints into k (theta / theta0)^2 theta beside the law that is there: the energy
    k theta^4 / (4 theta0^2) in each of the ``columns``, ``scale`` times as much.

    Parameters
    ----------
    columns : (J, 6) bool, rotations of the joints' table.
    theta0 : rad.
    scale : makes up for the quadratic part's own factor, with which the joints' stiffness comes here.
    """

    def __init__(self, joints: JointTable, columns: np.ndarray, theta0: float, scale: float) -> None:
        super().__init__(joints)
        self.theta0 = theta0
        self.factor = np.where(columns, scale, 0.0)

    def strains(self, state: TorsoState) -> Floats:
        """(J, 6)."""
        pose = joint_pose(self.joints, state)
        return np.hstack([pose.translation, pose.rotation])

    def entries(self, state: TorsoState, stiffness: Floats) -> Floats:
        """(J, 6) N mm, the energy of each."""
        return 0.25 * self.factor * stiffness * self.strains(state) ** 4 / self.theta0**2

    def energy(self, at: Configuration, stiffness: Stiffness) -> tuple[float, float]:
        return float(self.entries(at.state, stiffness.joints).sum()), np.inf

    def secant(self, state: TorsoState, stiffness: Stiffness) -> Floats:
        """(J, 6) stiffness of a linear law with the same moment, N mm/rad."""
        return self.factor * stiffness.joints * self.strains(state) ** 2 / self.theta0**2

    def hessians(self, state: TorsoState, stiffness: Stiffness) -> Floats:
        """(J, 12, 12) in (dt, dw) of parent and child."""
        secant = self.secant(state, stiffness)
        # theta times its slope, for each direction.
        slopes = joint_gradient_shares(self.joints, state, np.ones_like(secant))
        softer = 2.0 * self.factor * stiffness.joints / self.theta0**2
        return joint_hessians(self.joints, state, secant) + np.einsum("js,jsa,jsb->jab", softer, slopes, slopes)
