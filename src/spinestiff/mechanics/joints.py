"""The six-DoF compliant joint (paper 3.1): energy, gradient and Hessian of all joints at once, in closed form.

A joint has a frame on its parent bone (centre a_p, axes Q_p) and one on its child (a_c, Q_c). With

    d     = Q_p^T (a_c - a_p)          translation in the joint's frame, carried by the parent
    theta = log(Q_p^T Q_c)             rotation vector, the same seen from parent, child or midway

    E = d^T diag(k_x) d / 2 + theta^T diag(k_theta) theta / 2.

The axes of d could also sit halfway between the two frames; the choice enters only through the product of a
rotation and a translation of one joint, and tests/mechanics/test_joints.py states the difference.
NumPy over 67 joints costs less than compiling a kernel for them would.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from spinestiff.anatomy.rotation import cross, cross_matrix, log_so3
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import ParameterGroup
from spinestiff.anatomy.torso import JointTable
from spinestiff.arrays import Floats, Ints
from spinestiff.mechanics.assembly import Configuration, ScaledLaw, Stiffness, Tangent, Unknowns, positive_part

# Local DoF order of a joint: parent dt, dw, child dt, dw.
PARENT_T, PARENT_W, CHILD_T, CHILD_W = (slice(3 * i, 3 * i + 3) for i in range(4))


class JointPose(NamedTuple):
    """Frames of all joints in a state, and the two strains.

    axes : Q_p, (J, 3, 3) world_from_joint. parent_arm, child_arm : (J, 3) mm, bone origin to joint centre.
    gap : a_c - parent bone's origin, (J, 3) mm. translation : d, (J, 3) mm. rotation : theta, (J, 3) rad.
    """

    axes: Floats
    parent_arm: Floats
    child_arm: Floats
    gap: Floats
    translation: Floats
    rotation: Floats


def joint_pose(joints: JointTable, state: TorsoState) -> JointPose:
    """Where the joints are and how far they have moved from rest."""
    parent, child = state.bone_rotations[joints.parent], state.bone_rotations[joints.child]
    axes = parent @ joints.parent_axes
    parent_arm = np.einsum("jab,jb->ja", parent, joints.parent_position)
    child_arm = np.einsum("jab,jb->ja", child, joints.child_position)
    gap = state.bone_positions[joints.child] + child_arm - state.bone_positions[joints.parent]
    transposed = np.swapaxes(axes, -1, -2)
    translation = np.einsum("jab,jb->ja", transposed, gap - parent_arm)
    rotation = log_so3(transposed @ child @ joints.child_axes)
    return JointPose(axes, parent_arm, child_arm, gap, translation, rotation)


def joint_energies(joints: JointTable, state: TorsoState, stiffness: Floats) -> Floats:
    """(J,) N mm, for ``stiffness`` (J, 6)."""
    pose = joint_pose(joints, state)
    strain = np.hstack([pose.translation, pose.rotation])
    return 0.5 * np.einsum("ji,ji->j", stiffness, strain**2)


def joint_gradients(joints: JointTable, state: TorsoState, stiffness: Floats) -> Floats:
    """(J, 12) gradient in parent (dt, dw) and child (dt, dw); linear in ``stiffness`` (J, 6)."""
    pose = joint_pose(joints, state)
    force, moment = _world_force_and_moment(pose, stiffness)
    gradient = np.empty((len(joints), 12))
    gradient[:, PARENT_T] = -force
    gradient[:, PARENT_W] = -cross(pose.gap, force) - moment
    gradient[:, CHILD_T] = force
    gradient[:, CHILD_W] = cross(pose.child_arm, force) + moment
    return gradient


def joint_gradient_shares(joints: JointTable, state: TorsoState, stiffness: Floats) -> Floats:
    """(J, 6, 12) what each stiffness contributes to ``joint_gradients``."""
    pose = joint_pose(joints, state)
    to_joint = np.swapaxes(pose.axes, 1, 2)
    strains = np.zeros((len(joints), 6, 12))
    strains[:, :3] = to_joint @ _centre_jacobian(pose)
    turn = left_jacobian_inverse(pose.rotation) @ to_joint
    strains[:, 3:, PARENT_W], strains[:, 3:, CHILD_W] = -turn, turn
    return (stiffness * np.hstack([pose.translation, pose.rotation]))[:, :, None] * strains


def joint_hessians(joints: JointTable, state: TorsoState, stiffness: Floats) -> Floats:
    """(J, 12, 12) second derivative of the energy after the update R <- exp(dw) R."""
    pose = joint_pose(joints, state)
    return _translation_hessians(pose, stiffness[:, :3]) + _rotation_hessians(pose, stiffness[:, 3:])


class JointLaw(ScaledLaw):
    """All joints of a table, with the stiffness ``Stiffness.joints``."""

    def __init__(self, joints: JointTable) -> None:
        self.joints = joints

    def secant(self, state: TorsoState, stiffness: Stiffness) -> Floats:
        """(J, 6) force over strain of each direction; proportional to the direction's ``Stiffness.joints``."""
        return stiffness.joints

    def hessians(self, state: TorsoState, stiffness: Stiffness) -> Floats:
        """(J, 12, 12) second derivative of the energy of each joint."""
        return joint_hessians(self.joints, state, stiffness.joints)

    def pairs(self, unknowns: Unknowns) -> Ints:
        return np.stack([self.joints.parent, self.joints.child], 1)

    def energy(self, at: Configuration, stiffness: Stiffness) -> tuple[float, float]:
        return float(joint_energies(self.joints, at.state, stiffness.joints).sum()), np.inf

    def add_gradient(self, at: Configuration, stiffness: Stiffness, gradient: Floats) -> None:
        self._add(at, joint_gradients(self.joints, at.state, self.secant(at.state, stiffness)), gradient)

    def add_hessian(
        self, at: Configuration, stiffness: Stiffness, tangent: Tangent, offsets: Ints, project: bool
    ) -> None:
        parent, child = self.joints.parent, self.joints.child
        blocks = self.hessians(at.state, stiffness)
        blocks = positive_part(blocks) if project else blocks
        tangent.add(blocks[:, :6, :6].copy(), parent, parent)
        tangent.add(blocks[:, 6:, 6:].copy(), child, child)
        lower = np.where((parent > child)[:, None, None], blocks[:, :6, 6:], blocks[:, 6:, :6])
        tangent.add(lower, np.maximum(parent, child), np.minimum(parent, child), offsets)

    def add_shares(
        self, at: Configuration, stiffness: Stiffness, groups: Sequence[ParameterGroup], columns: Floats
    ) -> None:
        shares = joint_gradient_shares(self.joints, at.state, self.secant(at.state, stiffness))
        for group, column in zip(groups, columns.T):
            self._add(at, np.einsum("js,jsd->jd", group.joints_of(len(shares)), shares), column)

    def share_products(
        self, at: Configuration, stiffness: Stiffness, groups: Sequence[ParameterGroup], direction: Floats
    ) -> Floats:
        rows = at.unknowns.bone_rows(direction)
        along = np.hstack([rows[self.joints.parent], rows[self.joints.child]])
        shares = joint_gradient_shares(self.joints, at.state, self.secant(at.state, stiffness))
        products = np.einsum("jsd,jd->js", shares, along)
        return np.array([products[group.joints_of(len(products))].sum() for group in groups])

    def _add(self, at: Configuration, rows: Floats, gradient: Floats) -> None:
        bones = at.unknowns.bone_rows(gradient)
        np.add.at(bones, self.joints.parent, rows[:, :6])
        np.add.at(bones, self.joints.child, rows[:, 6:])


def _world_force_and_moment(pose: JointPose, stiffness: Floats) -> tuple[Floats, Floats]:
    force = np.einsum("jab,jb->ja", pose.axes, stiffness[:, :3] * pose.translation)
    inverse = left_jacobian_inverse(pose.rotation)
    moment = np.einsum("jab,jcb,jc->ja", pose.axes, inverse, stiffness[:, 3:] * pose.rotation)
    return force, moment


def _centre_jacobian(pose: JointPose) -> Floats:
    """(J, 3, 12) d (a_c - a_p) in world axes, as the parent's joint frame sees it."""
    eye = np.broadcast_to(np.eye(3), (len(pose.gap), 3, 3))
    return np.concatenate([-eye, cross_matrix(pose.gap), eye, -cross_matrix(pose.child_arm)], axis=2)


def _translation_hessians(pose: JointPose, stiffness: Floats) -> Floats:
    # d = Q_p^T (exp(-w_p) y - a), y = t_c + exp(w_c) b - t_p: expand to second order in the update.
    y, b = pose.gap, pose.child_arm
    first = _centre_jacobian(pose)
    spring = np.einsum("jab,jb,jcb->jac", pose.axes, stiffness, pose.axes)
    force = np.einsum("jab,jb->ja", pose.axes, stiffness * pose.translation)
    hessian = np.swapaxes(first, 1, 2) @ spring @ first
    cross_force = cross_matrix(force)
    hessian[:, PARENT_W, PARENT_W] += _symmetric_outer(force, y) - _dot_identity(force, y)
    hessian[:, CHILD_W, CHILD_W] += _symmetric_outer(force, b) - _dot_identity(force, b)
    mixed = [
        (PARENT_W, CHILD_T, cross_force),
        (PARENT_W, PARENT_T, -cross_force),
        (PARENT_W, CHILD_W, _dot_identity(force, b) - b[:, :, None] * force[:, None, :]),
    ]
    return _add_symmetric(hessian, mixed)


def _rotation_hessians(pose: JointPose, stiffness: Floats) -> Floats:
    # theta moves as theta' = L e, theta'' = (dL/dtheta [L e]) e with L the inverse left Jacobian of SO(3) and
    # e = Q_p^T (w_c - w_p - w_p x w_c / 2), the last term from the product of two exponentials.
    theta = pose.rotation
    torque = stiffness * theta
    inverse = left_jacobian_inverse(theta)
    curvature = _left_jacobian_inverse_derivative(theta, torque)
    local = np.swapaxes(inverse, 1, 2) @ (stiffness[:, :, None] * inverse)
    bent = np.swapaxes(inverse, 1, 2) @ curvature
    local += 0.5 * (bent + np.swapaxes(bent, 1, 2))
    world = pose.axes @ local @ np.swapaxes(pose.axes, 1, 2)
    moment = np.einsum("jab,jcb,jc->ja", pose.axes, inverse, torque)
    hessian = np.zeros((len(theta), 12, 12))
    hessian[:, PARENT_W, PARENT_W] = world
    hessian[:, CHILD_W, CHILD_W] = world
    return _add_symmetric(hessian, [(PARENT_W, CHILD_W, 0.5 * cross_matrix(moment) - world)])


def left_jacobian_inverse(theta: Floats) -> Floats:
    """L with d log(exp(e) exp(theta)) / d e = L at e = 0: I - [theta]/2 + c [theta]^2. (n, 3) -> (n, 3, 3)."""
    k = cross_matrix(theta)
    c, _ = _jacobian_coefficients(theta)
    return np.eye(3) - 0.5 * k + c[:, None, None] * (k @ k)


def _left_jacobian_inverse_derivative(theta: Floats, w: Floats) -> Floats:
    """G with v^T G e = w . (dL[v] e), L the inverse left Jacobian at ``theta``. (n, 3, 3)."""
    c, slope = _jacobian_coefficients(theta)
    k_theta, k_w = cross_matrix(theta), cross_matrix(w)
    squared_w = np.einsum("nab,nbc,nc->na", k_theta, k_theta, w)
    return (
        0.5 * k_w
        + slope[:, None, None] * theta[:, :, None] * squared_w[:, None, :]
        - c[:, None, None] * (k_w @ k_theta + cross_matrix(cross(w, theta)))
    )


# |B_2k| / (2k)! of the Bernoulli numbers: (1 - (p/2) cot(p/2)) / p^2 = sum_k of these times p^(2k - 2).
_BERNOULLI = (
    1 / 12,
    1 / 720,
    1 / 30240,
    1 / 1209600,
    1 / 47900160,
    691 / 1307674368000,
    1 / 74724249600,
    3617 / 10670622842880000,
)


def _jacobian_coefficients(theta: Floats) -> tuple[Floats, Floats]:
    """c = (1 - (p/2) cot(p/2)) / p^2 and c'(p)/p at p = |theta|."""
    angle2 = np.einsum("ni,ni->n", theta, theta)
    small = angle2 < 0.25
    p2 = np.where(small, 1.0, angle2)
    p = np.sqrt(p2)
    cot = 1.0 / np.tan(0.5 * p)
    c = (1.0 - 0.5 * p * cot) / p2
    slope = (0.25 * (1.0 + cot**2) - 0.5 * cot / p) / p2 - 2.0 * c / p2
    # The closed forms lose their digits towards zero.
    powers = np.where(small, angle2, 0.0)[:, None] ** np.arange(len(_BERNOULLI))
    c_series = powers @ np.array(_BERNOULLI)
    slope_series = powers[:, :-1] @ (2.0 * np.arange(1, len(_BERNOULLI)) * np.array(_BERNOULLI[1:]))
    return np.where(small, c_series, c), np.where(small, slope_series, slope)


def _symmetric_outer(a: Floats, b: Floats) -> Floats:
    outer = a[:, :, None] * b[:, None, :]
    return 0.5 * (outer + np.swapaxes(outer, 1, 2))


def _dot_identity(a: Floats, b: Floats) -> Floats:
    return np.einsum("ji,ji->j", a, b)[:, None, None] * np.eye(3)


def _add_symmetric(hessian: Floats, blocks: list[tuple[slice, slice, Floats]]) -> Floats:
    for row, column, block in blocks:
        hessian[:, row, column] += block
        hessian[:, column, row] += np.swapaxes(block, 1, 2)
    return hessian
