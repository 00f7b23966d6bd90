"""What is likely before any image is seen: the torso's elastic energy as a function of its vertebrae alone.

Around a state with tangent K, less each part's negative curvature, and gradient g over all unknowns, of which P picks
the vertebrae's, the energy left when everything else follows is g_c . d + d . S d / 2 with (static condensation; Guyan
1965)

    S = (P K^-1 P^T)^-1,    g_c = S P K^-1 g.

Divided by ``ENERGY_SCALE`` it counts as minus the logarithm of a probability: bones and tissue at ``REGULARISER`` let
neighbouring vertebrae differ from the template by 3 to 5 degrees (one standard deviation) about each axis, 1 to 2 mm
along the spine and 4 to 6 mm across it (benchmarks/carried_bodies.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.rotation import log_so3
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import StiffnessRatios, stiffness_ratios
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, ShortRepr
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.joints import left_jacobian_inverse
from spinestiff.mechanics.loads import no_load
from spinestiff.mechanics.supports import Supports
from spinestiff.mechanics.terms import PointSprings
from spinestiff.personalise.image_terms import Shape

# The regulariser's softness: bones and tissue only have to carry along what no image shows.
REGULARISER = {"everything": 0.05}
# N mm; see above.
ENERGY_SCALE = 75.0
# Springs that hold the pelvis: mm from its origin, N/mm.
PELVIS_ARM, PELVIS_STIFFNESS = 100.0, 0.1
# How far from frontal somebody stands for a frontal radiograph (rad), held by a pair of springs farther out (mm): the
# outlines of round bodies hardly tell yaw, and kyphosis seen aside would pass for scoliosis.
PELVIS_YAW_SD, PELVIS_YAW_ARM = np.deg2rad(3.0), 1000.0
# Design values. Log sizes (width, height, depth; height once the spine's length is the person's) vary from person to
# person and within one; so does, in mm, where pedicles lie (outwards, up, front), and so do tapers.
PERSON_SIZE_SD, OWN_SIZE_SD = np.array([0.08, 0.04, 0.08]), 0.04
PERSON_PEDICLE_SD, OWN_PEDICLE_SD = 2.0, 1.0
PERSON_TAPER_SD, OWN_TAPER_SD = 0.03, 0.03


@dataclass(frozen=True, repr=False)
class ElasticPrior(ShortRepr):
    """The condensed energy over ``ENERGY_SCALE``, around poses.

    Attributes
    ----------
    positions, rotations : (V, 3) mm and (V, 3, 3), where it was condensed.
    gradient : (6V,) in (dt, dw) of each vertebra.
    hessian : (6V, 6V).
    """

    positions: Floats
    rotations: Floats
    gradient: Floats
    hessian: Floats

    def energy(self, shape: Shape) -> float:
        """At other poses, less that where it was condensed."""
        moved = self._moved(shape)
        return float(self.gradient @ moved + 0.5 * moved @ self.hessian @ moved)

    def slope(self, shape: Shape) -> Floats:
        """(6V,) derivative at other poses, in (dt, dw) there."""
        moved = self._moved(shape)
        slope = (self.gradient + self.hessian @ moved).reshape(-1, 6)
        turned = left_jacobian_inverse(moved.reshape(-1, 6)[:, 3:])
        slope[:, 3:] = np.einsum("vji,vj->vi", turned, slope[:, 3:])
        return slope.reshape(-1)

    @property
    def norm(self) -> float:
        """Minus the logarithm of what ``exp(-energy)`` is to be multiplied by to be a probability density, but for what
        all priors of so many vertebrae share: g H^-1 g / 2 - log det(H) / 2."""
        deepest = 0.5 * float(self.gradient @ np.linalg.solve(self.hessian, self.gradient))
        return deepest - 0.5 * float(np.linalg.slogdet(self.hessian)[1])

    def without(self, vertebra: int) -> ElasticPrior:
        """The same energy with one vertebra free to be anywhere, the others held together through where it may be.

        Its own pose keeps next to nothing, 100 mm and 1 rad, so that it stays determined.
        """
        own = np.arange(6 * vertebra, 6 * vertebra + 6)
        rest = np.setdiff1d(np.arange(len(self.gradient)), own)
        across = np.linalg.solve(self.hessian[np.ix_(own, own)], self.hessian[np.ix_(own, rest)])
        hessian, gradient = np.zeros_like(self.hessian), np.zeros_like(self.gradient)
        hessian[np.ix_(rest, rest)] = self.hessian[np.ix_(rest, rest)] - self.hessian[np.ix_(rest, own)] @ across
        hessian[own, own] = np.repeat([1e-4, 1.0], 3)
        gradient[rest] = self.gradient[rest] - across.T @ self.gradient[own]
        return ElasticPrior(self.positions, self.rotations, gradient, hessian)

    def _moved(self, shape: Shape) -> Floats:
        turned = log_so3(shape.rotations @ np.swapaxes(self.rotations, 1, 2))
        return np.concatenate([shape.positions - self.positions, turned], axis=1).reshape(-1)


def elastic_prior(problem: EquilibriumProblem, state: TorsoState) -> ElasticPrior:
    """The prior around a state.

    Raises
    ------
    EquilibriumError : the tangent is singular there.
    """
    potential, torso = problem.potential, problem.torso
    stiffness, terms = potential.stiffness(regulariser(torso)), problem.all_terms(no_load())
    factor = problem.numeric_factor(potential.hessian(state, stiffness, terms, project=True))
    rows = (6 * torso.vertebra_bones[:, None] + np.arange(6)).ravel()
    unit = np.zeros((potential.dofs, len(rows)))
    unit[rows, np.arange(len(rows))] = 1.0
    follows = factor.solve(unit, tolerance=1e-8)  # one refinement fewer; a torso differs by 1e-9 mm
    compliance = follows[rows]
    condensed = np.linalg.inv(0.5 * (compliance + compliance.T))
    gradient = condensed @ (follows.T @ potential.gradient(state, stiffness, terms))
    bones = torso.vertebra_bones
    return ElasticPrior(
        state.bone_positions[bones],
        state.bone_rotations[bones],
        gradient / ENERGY_SCALE,
        0.5 * (condensed + condensed.T) / ENERGY_SCALE,
    )


def regulariser(torso: TorsoModel) -> StiffnessRatios:
    """The ratios under which a torso is moved to its images."""
    return stiffness_ratios(REGULARISER, torso.joints.kinds)


def pelvis_on_springs(torso: TorsoModel, frontal: bool = False) -> Supports:
    """The pelvis held softly: it keeps the torso in place, yet follows the spine where L5 leans otherwise.

    ``frontal`` holds its yaw within ``PELVIS_YAW_SD`` besides.
    """
    arms = PELVIS_ARM * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
    aside = PELVIS_YAW_ARM * np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    offsets = np.concatenate([np.repeat(arms, 3, axis=0), aside])
    points = PointsOnBones(np.full(len(offsets), torso.bone("pelvis")), offsets)
    directions = np.concatenate([np.tile(np.eye(3), (len(arms), 1)), np.tile([0.0, 0.0, 1.0], (2, 1))])
    yaw = 0.5 * ENERGY_SCALE / (PELVIS_YAW_SD * PELVIS_YAW_ARM) ** 2 if frontal else 0.0
    stiffness = np.append(np.full(3 * len(arms), PELVIS_STIFFNESS), [yaw, yaw])
    springs = PointSprings(points, points.positions(torso.rest_pose), directions, stiffness)
    return Supports(np.zeros((len(torso.bone_names), 6), dtype=bool), springs, ("pelvis",) * len(offsets))


def own_precision(count: int) -> Floats:
    """(9, V, V) inverse covariances over the vertebrae of what one is in itself (``image_terms.Shape.own``)."""
    person = np.concatenate([PERSON_SIZE_SD, np.full(3, PERSON_PEDICLE_SD), np.full(3, PERSON_TAPER_SD)])
    own = np.concatenate([np.full(3, OWN_SIZE_SD), np.full(3, OWN_PEDICLE_SD), np.full(3, OWN_TAPER_SD)])
    covariance = person[:, None, None] ** 2 + own[:, None, None] ** 2 * np.eye(count)
    return np.asarray(np.linalg.inv(covariance), dtype=float)
