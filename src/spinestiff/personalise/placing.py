"""A torso brought to given poses of its vertebrae by springs at their box corners; all else follows mechanically."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.errors import EquilibriumError, TorsoError
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import no_load
from spinestiff.mechanics.terms import PointSprings, Term
from spinestiff.observer import Observer
from spinestiff.personalise.prior import pelvis_on_springs, regulariser
from spinestiff.personalise.quality import require_quality
from spinestiff.personalise.rebuild import can_rebuild, skin_of, with_new_tissue, without_tissue

# N/mm of the springs, from loose to tight.
PLACING_PULLS = (3.0, 100.0, 1000.0)
# How far, mm, a vertebra may stay from where it is placed, if its mesh bears no more.
PLACED_MM = 0.5
# N; a geometry needs no equilibrium to the last digit.
SHAPE_TOLERANCE = 1e-3


def place_vertebrae(
    torso: TorsoModel,
    positions: Floats,
    rotations: Floats,
    stiffness: Sequence[float] = PLACING_PULLS,
    *,
    nodes: int | None = None,
    seed: int = 0,
    observer: Observer | None = None,
) -> TorsoModel:
    """The torso with its vertebrae at given 3D poses, ribs, shoulder girdle and tissue carried along, at rest.

    Where the tissue mesh does not bear that, a new one of about as many nodes is built in the carried skin, as in
    ``personalise`` (extra [mesh]).

    Parameters
    ----------
    positions : (V, 3) mm, world positions of the vertebrae's origins.
    rotations : (V, 3, 3) world_from_bone.
    stiffness : N/mm of the springs at the box corners, in rising steps. Where the mesh does not bear a step, the one
        before will do if it leaves less than ``PLACED_MM``.
    nodes : about how many (``rebuild.NODES``) a new mesh has, which is built in any case. seed : of its points.
    observer : is told when a mesh is built.

    Raises
    ------
    EquilibriumError : the vertebrae can't be brought there.
    TorsoError : the mesh does not bear that and no new one can be built.
    """
    problem = EquilibriumProblem(torso, pelvis_on_springs(torso))
    placed, state = torso, torso.rest_pose
    failure: TorsoError | None = None
    for pull in stiffness:
        state = pulled(problem, state, positions, rotations, (pull,))
        if nodes is not None:
            continue
        try:
            moved = torso.rebased(state)
            require_quality(moved)
        except TorsoError as error:
            failure = error
        else:
            placed, failure = moved, None
    if nodes is None:
        off = np.linalg.norm(placed.rest_pose.bone_positions[torso.vertebra_bones] - positions, axis=1).max()
        if failure is None or off <= PLACED_MM:
            return placed
        nodes = len(torso.tissue.rest_positions)
    if not can_rebuild(torso):
        why = f"{failure}: the tissue mesh can't be carried to this spine" if failure else "a new tissue mesh is wanted"
        raise TorsoError(f'{why}; pip install "spinestiff[mesh]" lets one be built')
    if observer and failure:
        observer(f"{failure}; building a new mesh")
    bare, without = without_tissue(torso, state)
    made = with_new_tissue(bare.rebased(without), skin_of(torso, state), torso, state, observer, nodes=nodes, seed=seed)
    require_quality(made)
    return made


def pulled(
    problem: EquilibriumProblem, start: TorsoState, positions: Floats, rotations: Floats, stiffness: Sequence[float]
) -> TorsoState:
    """The state with the vertebrae at given poses and all else in equilibrium with them."""
    torso = problem.torso
    count = len(torso.vertebrae)
    bone = np.repeat(torso.vertebra_bones, 8)
    offset = torso.vertebra_boxes.reshape(-1, 3)
    goal = np.repeat(positions, 8, axis=0) + np.einsum("nij,nj->ni", np.repeat(rotations, 8, axis=0), offset)
    points = PointsOnBones(np.repeat(bone, 3), np.repeat(offset, 3, axis=0))
    directions = np.tile(np.eye(3), (8 * count, 1))
    state = start
    for k in stiffness:
        springs = PointSprings(points, np.repeat(goal, 3, axis=0), directions, np.full(len(points), k))
        state = _relaxed(problem, [springs], state)
    return state


def _relaxed(problem: EquilibriumProblem, terms: Sequence[Term], start: TorsoState) -> TorsoState:
    ratios = regulariser(problem.torso)
    found = problem.with_terms(terms).solve(no_load(), ratios, start, tolerance=SHAPE_TOLERANCE)
    if not found.converged:
        raise EquilibriumError(
            f"the template can't be brought to the radiographs: {found.status.value}; check corners, spacing and height"
        )
    return found.state
