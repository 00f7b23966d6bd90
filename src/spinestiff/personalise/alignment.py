"""The template as one body at the place and the size that annotated radiographs show, before its vertebrae move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from spinestiff.anatomy.rotation import cross_matrix, exp_so3
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.personalise.image_terms import UNKNOWNS, ImagePoints, Shape, shape_of

# How far a body may be from the template's place in a room of known views, mm and rad (about x, y, z), and how far its
# spine's length from the template's at that height (log). As one body the template does not turn about the vertical:
# its kyphosis, seen aside, would pass for the patient's scoliosis. Yaw comes with the vertebrae's own poses.
PLACE_SD, TURN_SD, LENGTH_SD = 50.0, (0.1, 0.0, 0.1), 0.06
COARSE_SDS = (50.0, 16.0)


def aligned(
    template: TorsoModel, points: Sequence[ImagePoints], pose_sd: Floats, known: bool
) -> tuple[TorsoModel, Floats, float]:
    """The template at the spine's length and the body's place, the views' poses, and the length's factor.

    Gauss and Newton with the adjustment's robust loss, over log length, the body's shift and turn (known views)
    and each view's stance (estimated ones).

    Parameters
    ----------
    points : what is annotated in each view. pose_sd : (views, 4) of shift (mm), roll and yaw (rad).
    known : the views are those of one room, exact.
    """
    rest = template.rest_pose
    shape = shape_of(template, rest)
    middle = shape.positions.mean(0)
    body_sd = np.full(7, 0.0)
    body_sd[0] = LENGTH_SD
    if known:
        body_sd[1:4], body_sd[4:] = PLACE_SD, TURN_SD
    sd = np.concatenate([body_sd, pose_sd.ravel()])
    free = np.flatnonzero(sd > 0.0)
    value, turn = np.zeros(len(sd)), np.eye(3)
    for corner_sd in (*COARSE_SDS, COARSE_SDS[-1]):
        for _ in range(8):
            at = _carried(shape, middle, value, turn)
            hessian, slope = np.diag(1.0 / sd[free] ** 2), (value[free] / sd[free] ** 2)
            for number, view in enumerate(points):
                residual, own, nuisance = view.linearised(at, value[7:].reshape(-1, 4)[number])
                weight = np.sqrt((1.0 + np.sum(residual**2, 1) / (4.0 * corner_sd) ** 2) ** -2) / corner_sd
                jacobian = np.zeros((len(view), 2, len(sd)))
                jacobian[:, :, :7] = own @ _rigid(at, middle, value)[view.vertebra]
                jacobian[:, :, 7 + 4 * number : 11 + 4 * number] = nuisance
                scaled = (weight[:, None, None] * jacobian).reshape(-1, len(sd))[:, free]
                hessian += scaled.T @ scaled
                slope += scaled.T @ (weight[:, None] * residual).ravel()
            step = np.zeros(len(sd))
            step[free] = -np.linalg.solve(hessian, slope)
            value = value + step
            turn = exp_so3(step[4:7]) @ turn
            if np.abs(step[free] / sd[free]).max() < 1e-6:
                break
    length = float(np.exp(value[0]))
    torso = template.scaled(length)
    if known:
        torso = moved_whole(torso, turn, value[1:4], length * middle)
    return torso, value[7:].reshape(-1, 4), length


def moved_whole(torso: TorsoModel, turn: Floats, shift: Floats, about: Floats) -> TorsoModel:
    """The torso turned about a place and shifted, mm, as one body."""
    rest = torso.rest_pose
    moved = [(p - about) @ turn.T + about + shift for p in (rest.bone_positions, rest.tissue_positions)]
    return torso.rebased(TorsoState(moved[0], turn @ rest.bone_rotations, moved[1]))


def _carried(shape: Shape, middle: Floats, value: Floats, turn: Floats) -> Shape:
    scale = np.exp(value[0])
    places = scale * (shape.positions - middle) @ turn.T + scale * middle + value[1:4]
    return replace(
        shape,
        positions=places,
        rotations=turn @ shape.rotations,
        log_sizes=np.full_like(shape.log_sizes, value[0]),
    )


def _rigid(shape: Shape, middle: Floats, value: Floats) -> Floats:
    """(V, 15, 7) derivative of a vertebra's unknowns in log length, the body's shift and its turn."""
    slope = np.zeros((len(shape.positions), UNKNOWNS, 7))
    slope[:, :3, 0] = shape.positions - value[1:4]
    slope[:, 6:9, 0] = 1.0
    slope[:, :3, 1:4] = np.eye(3)
    slope[:, :3, 4:] = -cross_matrix(shape.positions - np.exp(value[0]) * middle - value[1:4])
    slope[:, 3:6, 4:] = np.eye(3)
    return slope
