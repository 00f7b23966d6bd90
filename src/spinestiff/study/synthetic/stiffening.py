"""Synthetic subjects whose discs stiffen as they turn, and the ratio that is then their true one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from spinestiff.anatomy.names import INTERVERTEBRAL
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import INTERVERTEBRAL_BENDING, StiffnessRatios, parameter_group
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.errors import EquilibriumError, SubjectError
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.joints import joint_pose
from spinestiff.mechanics.loads import LoadCase
from spinestiff.mechanics.neutral_zone import NeutralZone

LOW, THETA_DEG = (0.3, 0.7), (2.0, 5.0)
"""Range of what is drawn, as the variants of the model have it (docs/discrepancy.md)."""
EQUAL, ROUNDS = 0.01, 8  # of log ratios


@dataclass(frozen=True)
class Stiffening:
    """Intervertebral joints with the moment k (low + (theta / theta0)^2) theta about each axis, k theta in the model.

    Attributes
    ----------
    low : stiffness at rest over the linear joint's. theta_deg : theta0.

    Raises
    ------
    SubjectError : one is outside 0.05 to 1, or 0.5 to 45 degrees.
    """

    low: float
    theta_deg: float

    def __post_init__(self) -> None:
        if not 0.05 <= self.low <= 1.0 or not 0.5 <= self.theta_deg <= 45.0:
            raise SubjectError(
                f"stiffening joints: low {self.low:g}, theta_deg {self.theta_deg:g}; wanted 0.05 to 1 and 0.5 to 45"
            )

    def applied(self, torso: TorsoModel) -> tuple[TorsoModel, NeutralZone]:
        """The torso with its linear part alone, and the law of the rest."""
        columns = np.zeros((len(torso.joints), 6), dtype=bool)
        columns[[kind in INTERVERTEBRAL for kind in torso.joints.kinds], 3:] = True
        joints = replace(torso.joints, stiffness=np.where(columns, self.low, 1.0) * torso.joints.stiffness)
        law = NeutralZone(joints, columns, float(np.deg2rad(self.theta_deg)), 1.0 / self.low)
        return replace(torso, joints=joints), law


def solved_with(
    problem: EquilibriumProblem,
    law: NeutralZone,
    linear: TorsoModel,
    load: LoadCase,
    wanted: StiffnessRatios,
    rounds: int = ROUNDS,
) -> StiffnessRatios:
    """The ratios at which a subject with stiffening joints is solved, so that its true ratios are ``wanted``.

    The true ratio of a group of joints is the energy that its own law stores in them under ``load``, over what linear
    joints of default stiffness store there in the same state. Ratios of tissue are as they are.

    Parameters
    ----------
    problem : of the torso with ``law``. linear : the same with linear joints of default stiffness.
    rounds : solves at most.

    Raises
    ------
    EquilibriumError : no equilibrium, or no such ratios.
    """
    tried, state = wanted, linear.rest_pose
    for _ in range(rounds):
        state = problem.solve(load, tried, state).require().state
        found = _stored(problem.torso, law, linear, state, tried)
        left = np.array(
            [np.log(found[g.name] / w) if g.joints.any() else 0.0 for g, w in zip(wanted.groups, wanted.values)]
        )
        if np.abs(left).max() < EQUAL:
            return tried
        tried = tried.with_values(tried.values * np.exp(-left))
    raise EquilibriumError(f"no ratios at which stiffening joints store as much as linear ones at {wanted.as_dict()}")


def disc_bending(
    torso: TorsoModel, law: NeutralZone, linear: TorsoModel, state: TorsoState, ratios: StiffnessRatios
) -> dict[str, float]:
    """What lateral bending of the discs alone is in a state, over linear discs of default stiffness, in two measures.

    "energy": what they store, over what the linear ones store in the same state. "moment": the sum of
    moment times turn, over that of the linear ones. Where the moment grows with the cube of the turn this is twice the
    first.

    Parameters
    ----------
    torso, law : the body with stiffening joints. linear : with linear joints of default
        stiffness. ratios : of ``torso``.
    """
    discs = parameter_group(INTERVERTEBRAL_BENDING, torso.joints.kinds).joints
    pose = joint_pose(torso.joints, state)
    strains = np.hstack([pose.translation, pose.rotation])
    stiffness = ratios.scale_joints(torso.joints.stiffness)
    quadratic, quartic = 0.5 * strains**2 * stiffness, law.entries(state, stiffness)
    standard = (0.5 * strains**2 * linear.joints.stiffness)[discs].sum()
    return {
        "energy": float((quadratic + quartic)[discs].sum() / standard),
        "moment": float((quadratic + 2.0 * quartic)[discs].sum() / standard),
    }


def _stored(
    torso: TorsoModel, law: NeutralZone, linear: TorsoModel, state: TorsoState, ratios: StiffnessRatios
) -> dict[str, float]:
    pose = joint_pose(torso.joints, state)
    half = 0.5 * np.hstack([pose.translation, pose.rotation]) ** 2
    stiffness = ratios.scale_joints(torso.joints.stiffness)
    own, standard = half * stiffness + law.entries(state, stiffness), half * linear.joints.stiffness
    return {g.name: float(own[g.joints].sum() / standard[g.joints].sum()) for g in ratios.groups if g.joints.any()}
