"""Patches followed from an annotated frame through those after or before it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from spinestiff.arrays import Floats
from spinestiff.imaging.tracking.flow import dense_flow
from spinestiff.imaging.tracking.patches import Body, turn
from spinestiff.imaging.tracking.pictures import Image, Pictures, as_bytes, inside, levels, matched, sampled
from spinestiff.imaging.tracking.quality import LOST, quality_of
from spinestiff.imaging.tracking.registration import Patch, corrected

ROBUST_ROUNDS = 5
# Correlation that a pose one patch size away from its neighbour's motion must gain to be believed.
STRAY_COST = 0.4


def follow(
    pictures: Pictures,
    bodies: Sequence[Body],
    order: Sequence[int],
    chained: bool,
    observer: Callable[[int], None] | None = None,
) -> tuple[Floats, Floats]:
    """Bodies carried from the frame in which they are known through others, one after the other.

    Parameters
    ----------
    pictures : the sequence.
    bodies : n patches, known in frame ``order[0]``.
    order : frames from the known one on, forwards or backwards in time.
    chained : whether the bodies lie along a spine, one beside the other.
    observer : called with each frame that is done.

    Returns
    -------
    Poses (len(order), n, 3) and quality (len(order), n); in the first frame no motion, and 1.
    """
    mm = pictures.mm
    start = as_bytes(pictures.images[order[0]])
    known = levels(pictures.images[order[0]], mm)
    patches = [Patch.of(body, known) for body in bodies]
    poses, quality = np.zeros((len(order), len(bodies), 3)), np.ones((len(order), len(bodies)))
    # Flow starts from the last frame in which bodies were found: a spoilt frame must not spoil those after it.
    base, found = start, 0
    for k, frame in enumerate(order[1:], 1):
        image = matched(as_bytes(pictures.images[frame]), start)
        here = levels(pictures.images[frame], mm)
        forward, backward = dense_flow(base, image), dense_flow(image, base)
        guesses = [_carried(body, pose, forward) for body, pose in zip(bodies, poses[found])]
        poses[k], likeness = _settled(bodies, patches, here, guesses, chained)
        for i, body in enumerate(bodies):
            trip = _round_trip(body, poses[found, i], poses[k, i], backward) * mm
            visible = inside(body.placed(poses[k, i], body.centre[None]), image.shape)[0]
            quality[k, i] = visible * quality_of(likeness[i], trip)
        if np.median(quality[k]) > LOST:
            base, found = image, k
        if observer is not None:
            observer(frame)
    return poses, quality


def _settled(
    bodies: Sequence[Body],
    patches: Sequence[Patch],
    here: Sequence[Image],
    guesses: Sequence[Floats],
    chained: bool,
) -> tuple[Floats, Floats]:
    """Poses (n, 3) and correlations (n,) after correction.

    Where flow lost a vertebra (it takes the neighbour for it, or what crosses it), the motion of the one beside it is
    a better start. Sweeps in both directions carry it on. Vertebrae look alike, so likeness alone does not decide: a
    pose far from where the one beside would carry it must be that much more like the first frame.
    """
    settled = [corrected(body, patch, here, pose) for body, patch, pose in zip(bodies, patches, guesses)]
    order = range(len(bodies)) if chained else range(0)
    for sweep, beside in ((order[1:], -1), (order[-2::-1], 1)):
        for i in sweep:
            centre, pose = bodies[i].centre, settled[i + beside][0]
            guess = np.array([pose[0], *(bodies[i + beside].placed(pose, centre[None])[0] - centre)])
            held, trial = settled[i], corrected(bodies[i], patches[i], here, guess)
            if _credit(trial, guess, bodies[i]) > _credit(held, guess, bodies[i]):
                settled[i] = trial
    return np.stack([pose for pose, _ in settled]), np.array([likeness for _, likeness in settled])


def _credit(found: tuple[Floats, float], expected: Floats, body: Body) -> float:
    """Likeness of a found pose, less what it costs to lie away from where it is expected."""
    pose, likeness = found
    return likeness - STRAY_COST * min(1.0, float(np.linalg.norm(pose[1:] - expected[1:])) / body.size)


def _carried(body: Body, pose: Floats, flow: Image) -> Floats:
    """The pose after the body moved with the flow: the rigid motion that most of its points agree on."""
    here = body.placed(pose, body.points)
    there = here + sampled(flow, here)
    weight: Floats = np.ones(len(here))
    for _ in range(ROBUST_ROUNDS):
        pose = _rigid_fit(body, there, weight)
        distance = np.linalg.norm(there - body.placed(pose, body.points), axis=1)
        scale = max(1.5 * float(np.median(distance)), 0.1)
        weight = 1.0 / (1.0 + (distance / scale) ** 2) ** 2
    return pose


def _rigid_fit(body: Body, there: Floats, weight: Floats) -> Floats:
    """Pose that brings the body's points nearest to ``there`` (n, 2) by weighted least squares."""
    share = weight / weight.sum()
    relative = body.points - body.centre
    middle, target = share @ relative, share @ there
    a, b = relative - middle, there - target
    angle = np.arctan2(share @ (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), share @ np.sum(a * b, axis=1))
    return np.array([angle, *(target - turn(angle) @ middle - body.centre)])


def _round_trip(body: Body, before: Floats, after: Floats, backward: Image) -> float:
    """Median distance (pixels) by which backward flow from the new place misses the old one."""
    there = body.placed(after, body.points)
    back = there + sampled(backward, there)
    return float(np.median(np.linalg.norm(back - body.placed(before, body.points), axis=1)))
