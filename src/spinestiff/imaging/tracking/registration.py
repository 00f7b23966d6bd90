"""A patch found again in another frame, up to brightness and contrast."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from spinestiff.arrays import Floats
from spinestiff.imaging.tracking.patches import Body, turn
from spinestiff.imaging.tracking.pictures import Image, inside, sampled

# Part of a patch that must lie within the image.
FEWEST_SEEN = 0.5
REGISTRATION_ROUNDS = 30
# The largest correction of the flow's motion, in patch sizes: half a vertebra away its neighbour would match.
LARGEST_CORRECTION = 0.25


@dataclass(frozen=True)
class Patch:
    """A body's picture in the first frame at each smoothing: values (n,) and gradients (n, 2)."""

    values: tuple[Floats, ...]
    gradients: tuple[Floats, ...]

    @staticmethod
    def of(body: Body, levels: Sequence[Image]) -> Patch:
        values, gradients = [], []
        for image in levels:
            values.append(sampled(image, body.points))
            ahead = [sampled(image, body.points + 0.5 * e) - sampled(image, body.points - 0.5 * e) for e in np.eye(2)]
            gradient = np.stack(ahead, axis=1)
            if body.normals is not None:
                gradient = body.normals * np.sum(gradient * body.normals, axis=1, keepdims=True)
            gradients.append(gradient)
        return Patch(tuple(values), tuple(gradients))


def corrected(body: Body, patch: Patch, levels: Sequence[Image], pose: Floats) -> tuple[Floats, float]:
    """The pose registered on the first frame's patch, if that correlates better, and its correlation (finest level)."""

    def likeness(at: Floats) -> float:
        there = body.placed(at, body.points)
        seen = inside(there, levels[-1].shape)
        if np.mean(seen) < FEWEST_SEEN:
            return 0.0
        return _correlation(patch.values[-1][seen], sampled(levels[-1], there[seen]))

    trial = pose
    for values, gradients, image in zip(patch.values, patch.gradients, levels):
        trial = _registered(body, values, gradients, image, trial)
    near = np.linalg.norm(trial[1:] - pose[1:]) < LARGEST_CORRECTION * body.size
    before, after = likeness(pose), likeness(trial)
    return (trial, after) if near and after > before - 0.03 else (pose, before)


def _registered(body: Body, values: Floats, gradients: Floats, image: Image, pose: Floats) -> Floats:
    """Robust Gauss-Newton for the pose in which ``image`` shows the patch up to brightness and contrast.

    Inverse compositional (Baker & Matthews 2004): the patch's own gradient stands for the image's, the small motion
    found for the patch is undone on the pose.
    """
    arm = body.points - body.centre
    turned = gradients[:, 1] * arm[:, 0] - gradients[:, 0] * arm[:, 1]
    columns = np.column_stack([turned, gradients, values, np.ones(len(values))])
    for _ in range(REGISTRATION_ROUNDS):
        there = body.placed(pose, body.points)
        within = inside(there, image.shape)
        if np.mean(within) < FEWEST_SEEN:
            break
        seen = sampled(image, there[within])
        # seen = contrast * patch(moved by d) + brightness, linear in (contrast * d, contrast, brightness).
        solution = _robust_fit(columns[within], seen)
        contrast = solution[3]
        if not contrast > 0.0:
            break
        d = solution[:3] / contrast
        pose = _undone(pose, d)
        if np.abs(d[1:]).max() < 0.003 and abs(d[0]) < 1e-4:
            break
    return pose


def _robust_fit(columns: Floats, wanted: Floats) -> Floats:
    """Least squares that gives little weight to what moves otherwise (ribs, soft tissue seen through)."""
    weight: Floats = np.ones(len(wanted))
    solution = np.zeros(columns.shape[1])
    for _ in range(3):
        weighted = columns * weight[:, None]
        normal = weighted.T @ columns
        normal[np.diag_indices_from(normal)] *= 1.0 + 1e-9
        solution = np.asarray(np.linalg.lstsq(normal, weighted.T @ wanted, rcond=None)[0], dtype=np.float64)
        residual = np.abs(wanted - columns @ solution)
        scale = 1.5 * 1.4826 * float(np.median(residual)) + 1e-12
        weight = 1.0 / (1.0 + (residual / scale) ** 2)
    return solution


def _undone(pose: Floats, step: Floats) -> Floats:
    """The pose composed with the inverse of a small motion of the patch about its centre."""
    angle = pose[0] - step[0]
    return np.array([angle, *(pose[1:] - turn(angle) @ step[1:])])


def _correlation(a: Floats, b: Floats) -> float:
    a, b = a - a.mean(), b - b.mean()
    size = np.sqrt((a @ a) * (b @ b))
    return float(a @ b / size) if size > 0.0 else 0.0
