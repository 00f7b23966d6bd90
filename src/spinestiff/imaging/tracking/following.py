"""Patches followed from an annotated frame through those after or before it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from spinestiff.arrays import Floats
from spinestiff.imaging.planar import rotation, turns
from spinestiff.imaging.tracking.flow import dense_flow
from spinestiff.imaging.tracking.patches import Body
from spinestiff.imaging.tracking.pictures import Image, Pictures, as_bytes, inside, levels, matched, sampled
from spinestiff.imaging.tracking.quality import FOUND, Evidence
from spinestiff.imaging.tracking.registration import (
    Patch,
    corrected,
    inner_shift,
    likeness_of_walls,
    scatter,
    settled_at,
)

ROBUST_ROUNDS = 5
# Correlation that a pose one patch size away from its neighbour's motion must gain to be believed.
STRAY_COST = 0.4
# Poses that differ by less (in patch sizes) are corrected to the same place.
SAME_BASIN = 0.04
# Starts to the sides of a vertebra's place, mm: arch and processes beside its walls, which move otherwise when it turns
# about its own axis, may look more like the annotated frame than the walls in their new place do.
ASIDE_MM = (-1.6, -0.8, 0.8, 1.6)
SAME_PLACE_MM = 0.1
# Standard deviation of what a disc shears in the picture, over the distance of its vertebrae's centres: below 0.002 in
# 68 % and 0.006 in 95 % of the discs of synthetic subjects (benchmarks/tracking_drag.py).
SHEAR = 0.007
WIDEST_SHEAR = 5.0  # standard deviations; more costs no more
# Along a vertebra's walls: how sure their correlation is. With half as many the errors sideways were the same in the
# radiographs of 24 synthetic people.
INDEPENDENT_POINTS = 20.0


@dataclass(frozen=True)
class Place:
    """Where a vertebra may be.

    Attributes
    ----------
    pose : (3,) as ``Body`` has it.
    likeness, of_walls : the patch's correlation there, and that of its walls alone.
    """

    pose: Floats
    likeness: float
    of_walls: float

    @property
    def evidence(self) -> float:
        """Log-likelihood of the place among those beside it, up to a constant."""
        return -0.5 * INDEPENDENT_POINTS * float(np.log(1.0 - min(max(self.of_walls, 0.0), 0.9999) ** 2))


def follow(
    pictures: Pictures,
    bodies: Sequence[Body],
    order: Sequence[int],
    chained: bool,
    observer: Callable[[int], None] | None = None,
) -> tuple[Floats, list[list[Evidence | None]]]:
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
    Poses (len(order), n, 3), no motion in the first frame, and for each frame n pieces of evidence; None for a body
    that was not found there or has left the image.
    """
    mm = pictures.mm
    start = as_bytes(pictures.images[order[0]])
    known = levels(pictures.images[order[0]], mm)
    patches = [Patch.of(body, known) for body in bodies]
    poses = np.zeros((len(order), len(bodies), 3))
    seen: list[list[Evidence | None]] = [[None] * len(bodies)]
    # Flow starts from the last frame in which bodies were found: a spoilt frame must not spoil those after it.
    base, found = start, 0
    for k, frame in enumerate(order[1:], 1):
        image = matched(as_bytes(pictures.images[frame]), start)
        here = levels(pictures.images[frame], mm)
        flow = dense_flow(base, image)
        guesses = [_carried(body, pose, flow) for body, pose in zip(bodies, poses[found])]
        poses[k], likeness = _settled(bodies, patches, here, guesses, chained, mm)
        believed = credits(bodies, poses[k], likeness) if chained else likeness
        seen.append(_evidence(bodies, patches, here, poses[k], likeness, believed, mm))
        if 2 * sum(evidence is not None for evidence in seen[-1]) > len(bodies):
            base, found = image, k
        if observer is not None:
            observer(frame)
    return poses, seen


def _evidence(
    bodies: Sequence[Body],
    patches: Sequence[Patch],
    here: Sequence[Image],
    poses: Floats,
    likeness: Floats,
    believed: Floats,
    mm: float,
) -> list[Evidence | None]:
    """What a frame, ``here`` at each smoothing, says of each body in its pose; None for a lost one."""
    present = [
        bool(believed[i] > FOUND and inside(body.placed(poses[i], body.centre[None]), here[0].shape)[0])
        for i, body in enumerate(bodies)
    ]
    shifts = [
        inner_shift(body, patch, here, pose) if there else 0.0
        for body, patch, pose, there in zip(bodies, patches, poses, present)
    ]
    turned = np.abs(_smoothed(np.array(shifts)))
    return [
        Evidence(
            scatter(bodies[i], patches[i], here[-1], pose) * mm,
            float(turned[i]) * mm,
            float(likeness[i]),
        )
        if present[i]
        else None
        for i, pose in enumerate(poses)
    ]


def _settled(
    bodies: Sequence[Body],
    patches: Sequence[Patch],
    here: Sequence[Image],
    guesses: Sequence[Floats],
    chained: bool,
    mm: float,
) -> tuple[Floats, Floats]:
    """Poses (n, 3) and correlations (n,) after correction; a pixel is ``mm``.

    Where flow lost a vertebra (it takes the neighbour for it, or what crosses it), the motion of the one beside it is
    a better start. Sweeps in both directions carry it on. Vertebrae look alike, so likeness alone does not decide: a
    pose far from where the one beside would carry it must be that much more like the first frame. Of the places near
    by at which each may then settle the likeliest are taken (``likeliest_places``).
    """
    settled = [corrected(body, patch, here, pose) for body, patch, pose in zip(bodies, patches, guesses)]
    if not chained:
        return np.stack([pose for pose, _ in settled]), np.array([likeness for _, likeness in settled])
    order = range(len(bodies))
    for sweep, beside in ((order[1:], -1), (order[-2::-1], 1)):
        for i in sweep:
            guess = _as_beside(bodies[i], bodies[i + beside], settled[i + beside][0])
            held = settled[i]
            # A start near by leads to the same place.
            if _apart(bodies[i], guess, held[0]) < SAME_BASIN * bodies[i].size:
                continue
            trial = corrected(bodies[i], patches[i], here, guess)
            if _credit(trial, guess, bodies[i]) > _credit(held, guess, bodies[i]):
                settled[i] = trial
    places = [_beside(body, patch, here, held, mm) for body, patch, held in zip(bodies, patches, settled)]
    chosen = likeliest_places(bodies, places)
    return np.stack([place.pose for place in chosen]), np.array([place.likeness for place in chosen])


def _beside(body: Body, patch: Patch, here: Sequence[Image], held: tuple[Floats, float], mm: float) -> list[Place]:
    """Places near by at which a patch settles, the one that is held first."""
    pose, _ = held
    sideways = rotation(pose[0]) @ body.width / mm
    found = [held]
    for aside in ASIDE_MM:
        place = settled_at(body, patch, here, pose + [0.0, *(aside * sideways)])
        if all(_apart(body, place[0], other) > SAME_PLACE_MM / mm for other, _ in found):
            found.append(place)
    return [Place(*place, likeness_of_walls(body, patch, here, place[0])) for place in found]


def likeliest_places(bodies: Sequence[Body], places: Sequence[Sequence[Place]]) -> list[Place]:
    """One place of each body: the likeliest all together, by their walls and by what discs between them shear.

    Discs hardly shear: bodies side by side carry the point in the middle between them to the same place across the
    spine. Dynamic programming finds the best of all combinations.
    """
    total = np.array([place.evidence for place in places[0]])
    before: list[np.ndarray] = []
    for upper, lower, above, below in zip(bodies, bodies[1:], places, places[1:]):
        middle = 0.5 * (upper.centre + lower.centre)[None]
        # Marked on one place by mistake, two vertebrae still are as large as they are.
        apart = max(float(np.linalg.norm(lower.centre - upper.centre)), 0.5 * upper.size)
        hangs = np.array([upper.placed(place.pose, middle)[0] for place in above])
        stands = np.array([lower.placed(place.pose, middle)[0] for place in below])
        across = np.array([rotation(place.pose[0]) @ upper.width for place in above])
        shear = np.einsum("abi,ai->ab", hangs[:, None] - stands, across) / (SHEAR * apart)
        joined = total[:, None] - 0.5 * np.minimum(np.abs(shear), WIDEST_SHEAR) ** 2
        before.append(joined.argmax(axis=0))
        total = joined.max(axis=0) + [place.evidence for place in below]
    last = int(total.argmax())
    chosen = [last]
    for choice in reversed(before):
        chosen.append(int(choice[chosen[-1]]))
    return [found[i] for found, i in zip(places, reversed(chosen))]


def _as_beside(body: Body, beside: Body, pose: Floats) -> Floats:
    """The pose of a body that moves as one piece with the one beside it."""
    return np.array([pose[0], *(beside.placed(pose, body.centre[None])[0] - body.centre)])


def _apart(body: Body, one: Floats, other: Floats) -> float:
    """Largest distance (pixels) between a body's marks in two poses."""
    return float(np.linalg.norm(body.placed(one, body.marks) - body.placed(other, body.marks), axis=1).max())


def _smoothed(shifts: Floats) -> Floats:
    """(n,) the median of each value and the two on either side: neighbours turn alike, what crosses them differs."""
    padded = np.pad(shifts, 2, mode="edge")
    return np.asarray(np.median([padded[i : i + len(shifts)] for i in range(5)], axis=0))


def _credit(found: tuple[Floats, float], expected: Floats, body: Body) -> float:
    """Likeness of a found pose, less what it costs to lie away from where it is expected."""
    pose, likeness = found
    return likeness - STRAY_COST * min(1.0, float(np.linalg.norm(pose[1:] - expected[1:])) / body.size)


def credits(bodies: Sequence[Body], poses: Floats, likeness: Floats) -> Floats:
    """(n,) likeness, less what it costs to lie away from where the one beside that is more like itself has it.

    A vertebra that a blade half covers resembles its neighbour, a whole vertebra away.
    """
    believed = likeness.copy()
    for i, body in enumerate(bodies):
        beside = max((j for j in (i - 1, i + 1) if 0 <= j < len(bodies)), key=lambda j: likeness[j], default=None)
        if beside is not None:
            expected = _as_beside(body, bodies[beside], poses[beside])
            believed[i] = _credit((poses[i], float(likeness[i])), expected, body)
    return believed


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
    angle = float(turns(relative, there, weight))
    return np.array([angle, *(share @ there - rotation(angle) @ (share @ relative) - body.centre)])
