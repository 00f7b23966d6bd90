"""Moving the template: vertebrae are pulled, the rest of the torso follows mechanically, and the result is at rest."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.torso import TorsoModel, TorsoState
from spinestiff.arrays import Floats
from spinestiff.errors import EquilibriumError
from spinestiff.imaging.features import VertebraCorners, silhouette_choice
from spinestiff.imaging.projection import XRayView
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import no_load
from spinestiff.mechanics.supports import Supports
from spinestiff.mechanics.terms import BoneTerm, PointSprings
from spinestiff.personalise.image_terms import corner_term
from spinestiff.personalise.pose import ViewPose, align_view

# Image weights, N/mm a feature corner, from loose to tight; the last leaves the regulariser a few hundredths of a mm.
ANNEALING = (0.3, 3.0, 30.0, 300.0)
# The regulariser's softness: bones and tissue only have to carry along what no image shows.
REGULARISER = {"everything": 0.05}
# Springs that hold the pelvis: mm from its origin, N/mm.
PELVIS_ARM, PELVIS_STIFFNESS = 100.0, 0.1
# N; a geometry needs no equilibrium to the last digit.
SHAPE_TOLERANCE = 1e-3

# A lean seen at rest is the person's own (about 3 degrees from one to the next) rather than the stance of the moment
# (about 0.7 degrees): the view takes the roll's share of the variance, 0.7^2 / (0.7^2 + 3^2).
ROLL_SHARE = 0.05

Observer = Callable[[str], None]


@dataclass(frozen=True)
class Personalised:
    """A torso shaped to a subject.

    Attributes
    ----------
    torso : at rest in the subject's shape.
    views : the moved view of each radiograph.
    poses : the estimated pose in each view.
    rmse_mm : corner RMSE at the patient plane in each view.
    vertebra_rmse_mm : per view, per vertebra seen.
    prior_only : vertebrae that no radiograph shows.
    """

    torso: TorsoModel
    views: Mapping[str, XRayView]
    poses: Mapping[str, ViewPose]
    rmse_mm: Mapping[str, float]
    vertebra_rmse_mm: Mapping[str, Mapping[str, float]]
    prior_only: tuple[str, ...]


def personalise(
    template: TorsoModel,
    pictures: Mapping[str, tuple[VertebraCorners, XRayView]],
    observer: Observer | None = None,
) -> Personalised:
    """Shape ``template`` to annotated rest radiographs (paper 3.1; Koutras 2022's approach).

    Minimises image terms plus the elastic energy of joints and tissue, the image weight rising in steps; between
    them each view's pose (two shifts, one roll) is fitted; a lean at rest is mostly left to the torso. The result
    becomes the stress-free rest state.

    Parameters
    ----------
    template : scaled to the subject's height.
    pictures : view name -> annotated corners and nominal view, e.g. "frontal" and "lateral".
    observer : called with a line for each step.

    Raises
    ------
    EquilibriumError : the template can't be moved that far without an element turning over.
    TrackingError : corners that are no picture of this torso.
    """
    problem = EquilibriumProblem(template, _pelvis_on_springs(template))
    state = template.rest_pose
    views = {name: view for name, (_, view) in pictures.items()}
    poses: dict[str, ViewPose] = {}
    for weight in (0.0, *ANNEALING):
        if weight:
            terms = [
                corner_term(template, views[name], corners, silhouette_choice(template, views[name], state), weight)
                for name, (corners, _) in pictures.items()
            ]
            state = _relaxed(problem, terms, state)
        for name, (corners, nominal) in pictures.items():
            views[name], poses[name] = align_view(template, state, nominal, corners, roll_share=ROLL_SHARE)
        if observer:
            fits = ", ".join(f"{name} {pose.rms_mm:.2f} mm" for name, pose in poses.items())
            observer(f"image weight {weight:g} N/mm: {fits}")
    per_vertebra = {
        name: _vertebra_rmse(template, views[name], corners, state) for name, (corners, _) in pictures.items()
    }
    seen = {vertebra for corners, _ in pictures.values() for vertebra in corners.vertebrae}
    return Personalised(
        torso=template.rebased(state),
        views=views,
        poses=poses,
        rmse_mm={name: pose.rms_mm for name, pose in poses.items()},
        vertebra_rmse_mm=per_vertebra,
        prior_only=tuple(v for v in template.vertebrae if v not in seen),
    )


def place_vertebrae(
    torso: TorsoModel, positions: Floats, rotations: Floats, stiffness: Sequence[float] = (3.0, 100.0, 1000.0)
) -> TorsoModel:
    """The torso with its vertebrae at given 3D poses, ribs, shoulder girdle and tissue carried along, at rest.

    Parameters
    ----------
    positions : (V, 3) mm, world positions of the vertebrae's origins.
    rotations : (V, 3, 3) world_from_bone.
    stiffness : N/mm of the springs at the box corners, in rising steps.
    """
    count = len(torso.vertebrae)
    bone = np.repeat(torso.vertebra_bones, 8)
    offset = torso.vertebra_boxes.reshape(-1, 3)
    goal = np.repeat(positions, 8, axis=0) + np.einsum("nij,nj->ni", np.repeat(rotations, 8, axis=0), offset)
    points = PointsOnBones(np.repeat(bone, 3), np.repeat(offset, 3, axis=0))
    directions = np.tile(np.eye(3), (8 * count, 1))
    problem = EquilibriumProblem(torso, _pelvis_on_springs(torso))
    state = torso.rest_pose
    for k in stiffness:
        springs = PointSprings(points, np.repeat(goal, 3, axis=0), directions, np.full(len(points), k))
        state = _relaxed(problem, [springs], state)
    return torso.rebased(state)


def _relaxed(problem: EquilibriumProblem, terms: Sequence[BoneTerm], start: TorsoState) -> TorsoState:
    ratios = stiffness_ratios(REGULARISER, problem.torso.joints.kinds)
    found = problem.with_terms(terms).solve(no_load(), ratios, start, tolerance=SHAPE_TOLERANCE)
    if not found.converged:
        raise EquilibriumError(
            f"the template can't be brought to the radiographs: {found.status.value}; check corners, spacing and height"
        )
    return found.state


def _pelvis_on_springs(torso: TorsoModel) -> Supports:
    """The pelvis held softly: it keeps the torso in place, yet follows the spine where L5 leans otherwise."""
    arms = PELVIS_ARM * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
    offsets = np.repeat(arms, 3, axis=0)
    points = PointsOnBones(np.full(len(offsets), torso.bone("pelvis")), offsets)
    directions = np.tile(np.eye(3), (len(arms), 1))
    stiffness = np.full(len(offsets), PELVIS_STIFFNESS)
    springs = PointSprings(points, points.positions(torso.rest_pose), directions, stiffness)
    return Supports(np.zeros((len(torso.bone_names), 6), dtype=bool), springs, ("pelvis",) * len(offsets))


def _vertebra_rmse(torso: TorsoModel, view: XRayView, corners: VertebraCorners, state: TorsoState) -> dict[str, float]:
    term = corner_term(torso, view, corners, silhouette_choice(torso, view, state), 1.0)
    rms = np.sqrt(np.mean(np.sum(term.residuals(state) ** 2, axis=-1), axis=-1))
    return dict(zip(corners.vertebrae, rms.tolist()))
