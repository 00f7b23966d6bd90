"""Forces: their size, and the motion of a push with them, the way that it pushes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from spinestiff.arrays import Floats
from spinestiff.estimation.objective import FEWEST_VERTEBRAE
from spinestiff.imaging.features import picture_axes, vertebra_rows
from spinestiff.study.frame_selection import SAME_FORCE
from spinestiff.study.judgement.limits import Limits
from spinestiff.study.judgement.verdict import check, impossible
from spinestiff.study.misfit import motion, moved, rms, shared
from spinestiff.study.trials import PushSet, PushTrial
from spinestiff.subject.estimate_outcome import Check
from spinestiff.subject.records import PushRecord


def force_scale(training: Sequence[PushTrial], limits: Limits) -> Check:
    """Whether the largest training force is one that pushes on ribs have."""
    force, (low, high) = max(trial.force_n for trial in training), limits.force_n
    few, many = "kilograms (1 kg is 9.81 N) or pounds (4.45 N)", "newtons multiplied by 4.45 or 9.81 as if"
    causes = f"{few} entered as newtons, then for training frames of too little force"
    if force > high:
        causes = f"{many} they were pounds or kilograms, then for the gauge's range"
    return check(
        "size of the force",
        f"the largest training force is {force:.3g} N",
        force,
        low if force < low else high,
        low <= force <= high,
        causes,
    )


def growth(push: PushRecord, bending: Sequence[tuple[PushTrial, float]], limits: Limits) -> Check:
    """Whether the spine bends the more, the larger the force; ``bending`` as of the function of this name."""
    name = "motion grows with force"
    if len({trial.force_n for trial, _ in bending}) < 3:
        return impossible(name, f"push '{push.id}' has fewer than two forces above its least in usable frames")
    ordered = combinations(sorted(bending, key=lambda one: one[0].force_n), 2)
    falls = [(back - forth, less, more) for (less, back), (more, forth) in ordered if more.force_n > less.force_n]
    fall, less, more = max(falls, key=lambda one: one[0])
    limit = limits.fall_mm + limits.fall_share * max(mm for _, mm in bending)
    found = f"push '{push.id}': the spine bends the more, the larger the force"
    if fall > limit:
        found = (
            f"push '{push.id}': at {more.force_n:g} N (frame {more.frame}) the spine is bent {fall:.1f} mm less than "
            f"at {less.force_n:g} N (frame {less.frame})"
        )
    causes = "exchanged forces, frames in another order than forces_n, a patient who moved, lost tracking"
    return check(name, found, max(fall, 0.0), limit, fall <= limit, causes)


def repeated(push: PushRecord, bending: Sequence[tuple[PushTrial, float]], limits: Limits) -> Iterator[Check]:
    """Frames under a force that the push had reached before, against the frame of about this force on the way up.

    Where the two forces are not quite equal, the way up is followed to the later one. No check for a push whose forces
    only grow.
    """
    ordered = sorted(bending, key=lambda one: one[0].frame)
    up: list[tuple[PushTrial, float]] = []
    found: list[tuple[float, PushTrial, PushTrial, float]] = []
    near = SAME_FORCE * max((trial.force_n for trial, _ in bending), default=0.0)
    for trial, bent in ordered:
        if not up or trial.force_n > up[-1][0].force_n:
            up.append((trial, bent))
            continue
        before = min((one for one, _ in up), key=lambda one: abs(one.force_n - trial.force_n))
        if up[0][0].force_n <= trial.force_n and abs(before.force_n - trial.force_n) <= near:
            way = float(np.interp(trial.force_n, [one.force_n for one, _ in up], [mm for _, mm in up]))
            found.append((bent - way, before, trial, way))
    if not found:
        return
    off, before, again, way = max(found, key=lambda one: abs(one[0]))
    limit = limits.fall_mm + limits.fall_share * max(mm for _, mm in bending)
    yield check(
        "same force, same bending",
        f"push '{push.id}': at {again.force_n:g} N (frame {again.frame}) the spine is bent by {way + off:.1f} mm, "
        f"where it was bent by {way:.1f} mm before (frame {before.frame}, {before.force_n:g} N)",
        abs(off),
        limit,
        abs(off) <= limit,
        "creep between the frames or friction on the way back (train on frames of one way), a patient who moved, "
        "exchanged forces, lost tracking",
    )


def copies(pushes: PushSet, push: PushRecord, trials: Sequence[PushTrial], limits: Limits) -> Check:
    """Whether frames of different force are pictures of their own: two exposures never show the very same corners.

    Forces within ``SAME_FORCE`` of the largest count as one: a fluoroscope may store a picture twice in a row.
    """
    name, shapes = "frames of their own", np.full((len(trials), len(pushes.torso.vertebrae), 4, 2), np.nan)
    for shape, trial in zip(shapes, trials):
        corners = trial.trial.corners
        shape[vertebra_rows(pushes.torso, corners)] = np.where(corners.usable[..., None], corners.corners, np.nan)
    forces = np.array([trial.force_n for trial in trials])
    near, apart = SAME_FORCE * forces.max(initial=0.0), np.full((len(trials), len(trials)), np.inf)
    for i, shape in enumerate(shapes):
        squares = np.sum((shapes - shape) ** 2, axis=-1)
        count = np.isfinite(squares).sum((1, 2))
        told = (count > 0) & (np.abs(forces - forces[i]) > near)
        apart[i, told] = np.sqrt(np.nansum(squares[told], (1, 2)) / count[told])
    least = float(apart.min(initial=np.inf))
    if not np.isfinite(least):
        return impossible(name, f"push '{push.id}' has no two usable frames of different force with a vertebra in both")
    one, other = (trials[int(i)] for i in np.unravel_index(np.argmin(apart), apart.shape))
    found = f"push '{push.id}': no two frames of different force show the same"
    if least <= limits.same_mm:
        found = (
            f"push '{push.id}': frames {one.frame} and {other.frame}, at {one.force_n:g} and {other.force_n:g} N, show "
            "all corners at the same places"
        )
    causes = "a picture stored twice, or one exported in the other's place"
    return check(name, found, least, limits.same_mm, least > limits.same_mm, causes)


def bending(pushes: PushSet, trials: Sequence[PushTrial]) -> list[tuple[PushTrial, float]]:
    """The frames of a push and how far, mm, the spine bent in each from that of least force, along the largest bending.

    Shifts and turns of the whole picture, as of a patient who gave way, are taken out. Frames that show too few of the
    vertebrae of that of least force, the reference, or of those that tell the largest bending, are left out. Empty
    without a loaded frame beside the reference.
    """
    reference = min(trials, key=lambda trial: trial.force_n, default=None)
    if reference is None:
        return []
    others = [
        trial for trial in trials if trial is not reference and shared(trial.trial, reference.trial) >= FEWEST_VERTEBRAE
    ]
    if all(trial.force_n == reference.force_n for trial in others):
        return []
    bent = np.full((len(others), len(pushes.torso.vertebrae), 4, 2), np.nan)
    for shape, trial in zip(bent, others):
        rows, start, end = motion(pushes.torso, trial.trial, reference.trial)
        shape[rows] = end - moved(start, end)
    largest = max(bent, key=_size)
    along = [(reference, 0.0)]
    for trial, shape in zip(others, bent):
        both = np.isfinite(shape) & np.isfinite(largest)
        if both.any((1, 2)).sum() < FEWEST_VERTEBRAE:
            continue
        share = float(shape[both] @ largest[both] / (largest[both] @ largest[both]))
        along.append((trial, share * _size(largest)))
    return along


def _size(bent: Floats) -> float:
    return rms(bent[np.isfinite(bent).all((1, 2))])


def direction(pushes: PushSet, push: PushRecord, trials: Sequence[PushTrial], limits: Limits) -> Check:
    """Whether the spine moves away from the side that is pushed."""
    name = "motion along the push"
    least = min(trials, key=lambda trial: trial.force_n, default=None)
    alike = [] if least is None else [trial for trial in trials if shared(trial.trial, least.trial)]
    most = max(alike, key=lambda trial: trial.force_n, default=None)
    if least is None or most is None or most.force_n <= least.force_n:
        return impossible(name, f"push '{push.id}' has no two usable frames of different force with a vertebra in both")
    left, _ = picture_axes(most.trial.view)
    _, start, end = motion(pushes.torso, most.trial, least.trial)
    against = -push.sign * float(((end - start) @ left).mean())
    where = f"{abs(against):.1f} mm {'against' if against > 0.0 else 'along'} the push from the {push.side}"
    return check(
        name,
        f"push '{push.id}': at {most.force_n:g} N the spine has moved by {where}",
        max(against, 0.0),
        limits.against_mm,
        against <= limits.against_mm,
        "the wrong side in subject.json, mirrored pictures of the push, forces in reverse order",
    )
