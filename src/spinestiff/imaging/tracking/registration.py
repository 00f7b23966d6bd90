"""A patch found again in another frame, up to brightness and contrast."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spinestiff.arrays import Floats
from spinestiff.imaging.planar import rotation
from spinestiff.imaging.tracking.patches import Body
from spinestiff.imaging.tracking.pictures import Image, inside, sampled

# Part of a patch that must lie within the image.
FEWEST_SEEN = 0.5
FEWEST_POINTS = 30
REGISTRATION_ROUNDS = 30
FIRST_ROBUST_ROUNDS = 3  # later ones start from the weights of the one before
SMALLEST_STEP = 0.003  # pixels
PARTS = 4
# Correlation that registration may cost: it fits robustly, along normals, and correlation asks for neither.
LIKENESS_LEFT = 0.03
# The largest correction of the flow's motion, in patch sizes: half a vertebra away its neighbour would match.
LARGEST_CORRECTION = 0.25


@dataclass(frozen=True)
class Patch:
    """A body's picture in the first frame at each smoothing: values (n,) and gradients (n, 2)."""

    values: tuple[Floats, ...]
    gradients: tuple[Floats, ...]
    inner: Patch | None = None

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
        inner = None if body.inner is None else Patch.of(body.inner, levels)
        return Patch(tuple(values), tuple(gradients), inner)


def corrected(body: Body, patch: Patch, levels: Sequence[Image], pose: Floats) -> tuple[Floats, float]:
    """The pose registered on the first frame's patch, if that correlates better, and its correlation (finest level)."""

    trial = pose
    for values, gradients, image in zip(patch.values, patch.gradients, levels):
        trial = _registered(body, values, gradients, image, trial)
    near = np.linalg.norm(trial[1:] - pose[1:]) < LARGEST_CORRECTION * body.size
    before, after = _likeness(body, patch, levels, pose), _likeness(body, patch, levels, trial)
    return (trial, after) if near and after > before - LIKENESS_LEFT else (pose, before)


def settled_at(body: Body, patch: Patch, levels: Sequence[Image], pose: Floats) -> tuple[Floats, float]:
    """Where a patch settles from a pose near by at the finest level alone, and its correlation there.

    The coarse level would take it to the place that it is held at: both lie within its smoothing.
    """
    found = _registered(body, patch.values[-1], patch.gradients[-1], levels[-1], pose)
    return found, _likeness(body, patch, levels, found)


def likeness_of_walls(body: Body, patch: Patch, levels: Sequence[Image], pose: Floats) -> float:
    """Correlation along a vertebra's walls at the finest level; 0 where too much lies outside the picture.

    Which of two places beside each other is a vertebra's: the arch crosses the endplates and looks more like the
    annotated frame where the vertebra is not, if it turned about its own axis or moved across the beam.
    """
    return _likeness(body, patch, levels, pose, body.walls)


def _likeness(
    body: Body, patch: Patch, levels: Sequence[Image], pose: Floats, kept: NDArray[np.bool_] | None = None
) -> float:
    """Correlation of the patch, or of what is kept, at the finest level; 0 where too much lies outside the picture."""
    points, values = (body.points, patch.values[-1]) if kept is None else (body.points[kept], patch.values[-1][kept])
    there = body.placed(pose, points)
    seen = inside(there, levels[-1].shape)
    if np.count_nonzero(seen) < max(FEWEST_SEEN * len(seen), FEWEST_POINTS):
        return 0.0
    return _correlation(values[seen], sampled(levels[-1], there[seen]))


def scatter(body: Body, patch: Patch, image: Image, pose: Floats) -> Floats:
    """(k,) pixels: standard deviation of the marks by the jackknife, each of the patch's parts left out in turn.

    What covers one side, or moves it otherwise, shows here; noise does too.
    """
    marks = []
    for part in range(PARTS):
        kept = body.parts != part
        found = _registered(body, patch.values[-1], patch.gradients[-1], image, pose, kept)
        marks.append(body.placed(found, body.marks))
    spread = np.array(marks) - np.mean(marks, axis=0)
    return np.asarray(np.sqrt((PARTS - 1) / PARTS * np.sum(spread**2, axis=(0, 2))))


def inner_shift(body: Body, patch: Patch, levels: Sequence[Image], pose: Floats) -> float:
    """Pixels, along the body's width, by which the inner patch lies aside of where the pose has it; 0 without one."""
    inner, own = body.inner, patch.inner
    if inner is None or own is None or len(inner.points) < FEWEST_POINTS:
        return 0.0
    found = pose
    for values, gradients, image in zip(own.values, own.gradients, levels):
        found = _registered(inner, values, gradients, image, found)
    return float((found[1:] - pose[1:]) @ rotation(pose[0]) @ body.width)


def _registered(
    body: Body, values: Floats, gradients: Floats, image: Image, pose: Floats, kept: NDArray[np.bool_] | None = None
) -> Floats:
    """Robust Gauss-Newton for the pose in which ``image`` shows the patch (or what is kept) up to brightness, contrast.

    Inverse compositional (Baker & Matthews 2004): the patch's own gradient stands for the image's, the small motion
    found for the patch is undone on the pose.
    """
    points = body.points
    if kept is not None:
        points, values, gradients = points[kept], values[kept], gradients[kept]
    arm = points - body.centre
    turned = gradients[:, 1] * arm[:, 0] - gradients[:, 0] * arm[:, 1]
    columns = np.column_stack([turned, gradients, values, np.ones(len(values))])
    weight: Floats = np.ones(len(points))
    for number in range(REGISTRATION_ROUNDS):
        there = body.placed(pose, points)
        within = inside(there, image.shape)
        if np.count_nonzero(within) < max(FEWEST_SEEN * len(points), FEWEST_POINTS):
            break
        # seen = contrast * patch(moved by d) + brightness, linear in (contrast * d, contrast, brightness).
        reweighted = 1 if number else FIRST_ROBUST_ROUNDS
        solution, weight[within] = _robust_fit(
            columns[within], sampled(image, there[within]), weight[within], reweighted
        )
        contrast = solution[3]
        if not contrast > 0.0:
            break
        d = solution[:3] / contrast
        pose = _undone(pose, d)
        if np.abs(d[1:]).max() < SMALLEST_STEP and abs(d[0]) * body.size < SMALLEST_STEP:
            break
    return pose


def _robust_fit(columns: Floats, wanted: Floats, weight: Floats, rounds: int) -> tuple[Floats, Floats]:
    """Least squares that gives little weight to what moves otherwise (ribs, soft tissue seen through).

    Returns the solution and the weights that its residuals give.
    """
    solution: Floats = np.zeros(columns.shape[1])
    for _ in range(rounds):
        weighted = columns * weight[:, None]
        normal = weighted.T @ columns
        damping = 1e-9 * np.diag(normal) + 1e-12 * normal.max()
        solution = np.asarray(np.linalg.solve(normal + np.diag(damping), weighted.T @ wanted), dtype=np.float64)
        residual = np.abs(wanted - columns @ solution)
        middle = np.partition(residual, len(residual) // 2)[len(residual) // 2]
        weight = 1.0 / (1.0 + (residual / (1.5 * 1.4826 * middle + 1e-12)) ** 2)
    return solution, weight


def _undone(pose: Floats, step: Floats) -> Floats:
    """The pose composed with the inverse of a small motion of the patch about its centre."""
    angle = pose[0] - step[0]
    return np.array([angle, *(pose[1:] - rotation(angle) @ step[1:])])


def _correlation(a: Floats, b: Floats) -> float:
    a, b = a - a.mean(), b - b.mean()
    size = np.sqrt((a @ a) * (b @ b))
    return float(a @ b / size) if size > 0.0 else 0.0
