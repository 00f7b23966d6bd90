"""Can this result be right? Checks of an estimate against everything that the steps know beside it (docs/judgement.md).

A wrong input (another person's picture, exchanged forces, kilograms for newtons) ends in a fit like any other: it
converges, has intervals and predicts something. Each check compares two things that have to agree when all is well, and
says in one line what was found, the limit, and the mistakes to look for, the most likely first. Limits were set on sound
subjects and are held against others (``benchmarks/judgement.py``).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np

from spinestiff.arrays import Floats
from spinestiff.estimation.fit import StiffnessFit
from spinestiff.imaging.dicom.identity import Identity
from spinestiff.imaging.features import picture_axes, vertebra_rows
from spinestiff.imaging.tracking.quality import DOUBTED_QUALITY
from spinestiff.personalise.fitness import VertebraFit
from spinestiff.personalise.shape import Personalised
from spinestiff.study.misfit import explanations, motion, moved, rms, spines, strays
from spinestiff.study.trials import PushSet, PushTrial
from spinestiff.subject.outcomes import Check
from spinestiff.subject.records import PushRecord, SubjectRecord

# Corners set aside of a vertebra's four that make it a wrong vertebra rather than a wrong corner.
WRONG_VERTEBRA = 3


@dataclass(frozen=True)
class Limits:
    """What passes. Lengths in mm at the patient plane; those with ``_sd`` count standard deviations of a corner.

    Attributes
    ----------
    force_n : lowest and highest of the largest training force: pushes in the literature (docs/judgement.md).
    days_apart : between rest and push exposures; a child grows by less than 1 % in that time.
    corner_sd_mm : of the corners in the rest pictures about the shape found.
    least_sd_mm, most_sd_mm : between these, an annotator's own scatter sets the limits below; beyond, it is no longer
        believed to be scatter.
    wrong_vertebrae : of the rest pictures, set aside as a whole.
    length, size : factors by which a spine, and its vertebrae, may differ from the template's at that height.
    rest_mm, rest_sd : of the unloaded spine of a push about the rest torso: posture, and corners.
    stray_mm, stray_sd : the same of one vertebra about its neighbours.
    moved_mm, moved_share : of the training frames' motion about the fitted one: stance, and share of the motion.
    stray_moved_mm, stray_moved_share : the same of one vertebra about its neighbours.
    fall_mm, fall_share : by which the bending may fall from one frame to one of more force: absolute, and as a share
        of the greatest bending of the push.
    against_mm : by which a spine may move against the push.
    """

    force_n: tuple[float, float] = (15.0, 150.0)
    days_apart: int = 30
    corner_sd_mm: float = 1.6
    least_sd_mm: float = 0.3
    most_sd_mm: float = 1.2
    wrong_vertebrae: int = 0
    length: float = 1.13
    size: float = 1.2
    rest_mm: float = 2.0
    rest_sd: float = 2.0
    stray_mm: float = 1.0
    stray_sd: float = 4.0
    moved_mm: float = 1.5
    moved_share: float = 0.2
    stray_moved_mm: float = 1.5
    stray_moved_share: float = 0.1
    fall_mm: float = 0.5
    fall_share: float = 0.03
    against_mm: float = 1.5


LIMITS = Limits()


@dataclass(frozen=True)
class RestShape:
    """What personalisation found, as far as it is judged.

    Attributes
    ----------
    corner_sd_mm : standard deviation of the annotated corners along one axis, from their residuals.
    length_scale : the spine's length over the template's at the subject's height.
    size_scale : (V, 3) width, height and depth of the vertebrae over the template's.
    fits : per view, per vertebra seen: how well it fits.
    """

    corner_sd_mm: float
    length_scale: float
    size_scale: Floats
    fits: Mapping[str, Mapping[str, VertebraFit]]

    @classmethod
    def of(cls, shaped: Personalised) -> RestShape:
        """Of the result of ``personalise``."""
        return cls(shaped.corner_sd_mm, shaped.length_scale, shaped.size_scale, shaped.fits)


def judge(
    record: SubjectRecord,
    shape: RestShape,
    pushes: PushSet,
    fit: StiffnessFit,
    identities: Mapping[str, Identity],
    limits: Limits = LIMITS,
) -> tuple[Check, ...]:
    """All checks of an estimate; those of a push come once for each.

    Parameters
    ----------
    record : ``subject.json``.
    shape : what personalisation found.
    pushes, fit : the trials, and the fit of ``pushes.training`` in that order.
    identities : of the rest pictures and the pushes, by image ("rest/frontal", "push/main").
    limits : what passes.
    """
    found = [*_identity(identities, limits), _force_scale(pushes.training, limits)]
    for push in record.pushes:
        mine = [trial for trial in pushes.trials if trial.push == push.id]
        found += [_growth(pushes, push, mine, limits), _direction(pushes, push, mine, limits)]
    found += [_length(record, shape, limits), _sizes(record, shape, limits), *_rest_pictures(shape, limits)]
    sd = float(np.clip(shape.corner_sd_mm, limits.least_sd_mm, limits.most_sd_mm))
    for push in record.pushes:
        found += _unloaded(pushes, push, sd, limits)
    return (*found, *_training(pushes, fit, limits))


def failed(checks: Sequence[Check]) -> tuple[Check, ...]:
    """The checks that say that something is wrong."""
    return tuple(check for check in checks if check.passed is False)


# Whose pictures, and when


def _identity(identities: Mapping[str, Identity], limits: Limits) -> Iterator[Check]:
    images = list(identities)
    pairs = [(a, b) for i, a in enumerate(images) for b in images[i + 1 :]]
    same = {pair: identities[pair[0]].is_of(identities[pair[1]]) for pair in pairs}
    other = [pair for pair, found in same.items() if found is False]
    if other:
        first, second = other[0]
        text = f"{first} and {second} are of different patients by their files; look for radiographs in the wrong folder"
        yield Check(name="same patient", value=None, limit=None, passed=False, text=text)
    elif any(same.values()) and None not in same.values():
        yield Check(name="same patient", value=None, limit=None, passed=True, text="all files name the same patient")
    else:
        yield _impossible("same patient", "a file names no patient, or its patient was taken out")
    days = {pair: identities[pair[0]].days_from(identities[pair[1]]) for pair in pairs}
    far = [pair for pair, apart in days.items() if apart is not None and apart > limits.days_apart]
    limit = float(limits.days_apart)
    if far:
        first, second = far[0]
        text = (
            f"{first} and {second} were taken more than {limits.days_apart} days apart; look for pictures of another "
            "visit, then for a wrong date in the X-ray system"
        )
        yield Check(name="same visit", value=None, limit=limit, passed=False, text=text)
    elif days and None not in days.values():
        text = f"all pictures were taken within {limits.days_apart} days"
        yield Check(name="same visit", value=None, limit=limit, passed=True, text=text)
    else:
        yield _impossible("same visit", "a file has no date, or its patient was taken out")


# Forces


def _force_scale(training: Sequence[PushTrial], limits: Limits) -> Check:
    force, (low, high) = max(trial.force_n for trial in training), limits.force_n
    limit = low if force < low else high
    if low <= force <= high:
        text = f"the largest training force is {force:.3g} N (usual: {low:g} to {high:g} N)"
    elif force < low:
        text = (
            f"the largest training force is {force:.3g} N, below the usual {low:g} to {high:g} N; look for kilograms "
            "(times 9.81) or pounds (times 4.45) entered as newtons, then for training frames of too little force"
        )
    else:
        text = (
            f"the largest training force is {force:.3g} N, above the usual {low:g} to {high:g} N; look for newtons that "
            "were converted twice, from pounds (divide by 4.45) or kilograms (by 9.81), then for the gauge's range"
        )
    return Check(name="size of the force", value=force, limit=limit, passed=low <= force <= high, text=text)


def _growth(pushes: PushSet, push: PushRecord, trials: Sequence[PushTrial], limits: Limits) -> Check:
    name = "motion grows with force"
    bending = _bending(pushes, trials)
    if bending is None:
        return _impossible(name, f"push '{push.id}' has fewer than two usable frames of different force above the least")
    order = sorted(bending, key=lambda one: one[0].force_n)
    fall, less, more = max(
        ((back - forth, less, more) for (less, back), (more, forth) in combinations(order, 2)
         if more.force_n > less.force_n),
        key=lambda one: one[0],
    )  # fmt: skip
    limit = limits.fall_mm + limits.fall_share * max(mm for _, mm in bending)
    if fall <= limit:
        text = f"push '{push.id}': the spine bends the more, the larger the force"
    else:
        text = (
            f"push '{push.id}': from {less.force_n:g} N (frame {less.frame}) to {more.force_n:g} N (frame {more.frame}) "
            f"the spine bends back by {fall:.1f} mm (limit {limit:.1f}); look for exchanged forces, frames in another "
            "order than forces_n, a patient who moved, lost tracking"
        )
    return Check(name=name, value=max(fall, 0.0), limit=limit, passed=fall <= limit, text=text)


def _bending(pushes: PushSet, trials: Sequence[PushTrial]) -> list[tuple[PushTrial, float]] | None:
    """The frames of a push and how far, mm, the spine bent in each from that of least force, along the largest bending.

    Shifts and turns of the whole picture, as of a patient who gave way, are taken out. None for fewer than two frames
    of different forces beside the reference.
    """
    reference = min(trials, key=lambda trial: trial.force_n, default=None)
    loaded = [trial for trial in trials if reference is not None and trial.force_n > reference.force_n]
    if reference is None or len({trial.force_n for trial in loaded}) < 2:
        return None
    bent = np.full((len(loaded), len(pushes.torso.vertebrae), 4, 2), np.nan)
    for shape, trial in zip(bent, loaded):
        rows, start, end = motion(pushes.torso, trial.trial, reference.trial)
        shape[rows] = end - moved(start, end)
    largest = max(bent, key=_size)
    along = [(reference, 0.0)]
    for trial, shape in zip(loaded, bent):
        both = np.isfinite(shape) & np.isfinite(largest)
        share = float(shape[both] @ largest[both] / (largest[both] @ largest[both]))
        along.append((trial, share * _size(largest)))
    return along


def _size(bent: Floats) -> float:
    return rms(bent[np.isfinite(bent).all((1, 2))])


def _direction(pushes: PushSet, push: PushRecord, trials: Sequence[PushTrial], limits: Limits) -> Check:
    name = "motion along the push"
    least = min(trials, key=lambda trial: trial.force_n, default=None)
    most = max(trials, key=lambda trial: trial.force_n, default=None)
    if least is None or most is None or most.force_n <= least.force_n:
        return _impossible(name, f"push '{push.id}' has no two usable frames of different force")
    left, _ = picture_axes(most.trial.view)
    _, start, end = motion(pushes.torso, most.trial, least.trial)
    along = push.sign * float(((end - start) @ left).mean())
    if along >= -limits.against_mm:
        text = f"push '{push.id}': at {most.force_n:g} N the spine moves by {along:.1f} mm along the push"
    else:
        text = (
            f"push '{push.id}': at {most.force_n:g} N the spine moves by {-along:.1f} mm against the push from the "
            f"{push.side} (limit {limits.against_mm:g}); look for the wrong side in subject.json, mirrored pictures of "
            "the push, forces in reverse order"
        )
    passed = along >= -limits.against_mm
    return Check(name=name, value=max(-along, 0.0), limit=limits.against_mm, passed=passed, text=text)


# The shape at rest


def _length(record: SubjectRecord, shape: RestShape, limits: Limits) -> Check:
    found = shape.length_scale
    passed, limit = _within(found, limits.length)
    text = f"the spine is {found:.3f} times as long as the template's for {record.height_cm:g} cm"
    if not passed:
        own = 100.0 * found * 0.01 * record.height_cm
        text += (
            f" (limit {limit:.2f}), as for {own:.0f} cm; look for a wrong height_cm, pixel spacing or source "
            "distances in all pictures, levels skipped or counted twice"
        )
    return Check(name="length of the spine", value=found, limit=limit, passed=passed, text=text)


def _sizes(record: SubjectRecord, shape: RestShape, limits: Limits) -> Check:
    seen = "width, height and depth" if "lateral" in shape.fits else "width and height"
    median = np.median(shape.size_scale[:, : 3 if "lateral" in shape.fits else 2], axis=0)
    found = float(median[np.argmax(np.abs(np.log(median)))])
    passed, limit = _within(found, limits.size)
    text = f"the vertebrae have {', '.join(f'{v:.2f}' for v in median)} times the template's {seen}"
    if not passed:
        text += (
            f" for {record.height_cm:g} cm (limit {limit:.2f}); look for pixel spacing or source distances, a wrong "
            "height_cm, corners that are not those of the bodies"
        )
    return Check(name="sizes of the vertebrae", value=found, limit=limit, passed=passed, text=text)


def _within(found: float, factor: float) -> tuple[bool, float]:
    """Whether a ratio lies within a factor of 1, and the limit on its side."""
    limit = factor if found >= 1.0 else 1.0 / factor
    return bool(abs(np.log(found)) <= np.log(factor)), limit


def _rest_pictures(shape: RestShape, limits: Limits) -> Iterator[Check]:
    found = shape.corner_sd_mm
    text = f"the corners in the rest pictures scatter by {found:.2f} mm about the shape found"
    passed = found <= limits.corner_sd_mm
    if not passed:
        text += (
            f" (limit {limits.corner_sd_mm:g}); look for a lateral picture of another person or posture, spacing or "
            "distances of one picture, levels named differently in the two"
        )
    yield Check(name="corners at rest", value=found, limit=limits.corner_sd_mm, passed=passed, text=text)
    wrong = [
        f"{vertebra} ({view})"
        for view, fits in shape.fits.items()
        for vertebra, fit in fits.items()
        if fit.wrong_corners >= WRONG_VERTEBRA
    ]
    allowed = limits.wrong_vertebrae
    text = "all vertebrae of the rest pictures agree with each other"
    passed = len(wrong) <= allowed
    if not passed:
        text = (
            f"{', '.join(wrong)}: contradicts the other vertebrae at rest and was set aside; look for corners in another "
            "order, a wrong level, a vertebra marked at the wrong place"
        )
    yield Check(name="vertebrae at rest", value=float(len(wrong)), limit=float(allowed), passed=passed, text=text)


# Rest and push


def _unloaded(pushes: PushSet, push: PushRecord, sd: float, limits: Limits) -> Iterator[Check]:
    names = "rest and push", "vertebrae of the push"
    trials = [trial for trial in pushes.trials if trial.push == push.id]
    reference = min(trials, key=lambda trial: trial.force_n, default=None)
    if reference is None or reference.force_n > 0.0:
        for name in names:
            yield _impossible(name, f"push '{push.id}' has no usable frame without force")
        return
    found = spines(pushes.torso, reference.trial)
    off = pushes.poses[push.id].rms_mm
    limit = float(np.hypot(limits.rest_mm, limits.rest_sd * sd))
    text = f"push '{push.id}': its spine without force lies {off:.2f} mm (RMS) from that of the rest pictures"
    if off > limit:
        loaded = (
            (f"the spine as in frame {t.frame} ({t.force_n:g} N)", spines(pushes.torso, t.trial))
            for t in trials
            if t.force_n > 0.0
        )
        likely = [e for e in explanations(found, loaded) if e.left_mm <= min(limit, 0.6 * off)]
        said = [f"{e.text}: {e.left_mm:.1f} mm would remain" for e in likely[:2]]
        usual = "rest pictures of another person or visit, levels named differently, a mirrored picture, forces in another"
        text += f" (limit {limit:.1f}); look whether " + ", whether ".join(said) if said else f" (limit {limit:.1f})"
        text += f"; {'else look' if said else 'look'} for {usual} order than the frames, another posture"
    yield Check(name=names[0], value=off, limit=limit, passed=off <= limit, text=text)
    if len(found.rows) < 2:
        yield _impossible(names[1], f"push '{push.id}' shows a single vertebra without force")
        return
    stray = strays(found.difference, found.rows)
    worst = int(np.argmax(stray))
    limit = float(np.hypot(limits.stray_mm, limits.stray_sd * sd))
    passed = bool(stray[worst] <= limit)
    text = f"push '{push.id}': {found.vertebrae[worst]} differs most from the rest pictures, by {stray[worst]:.2f} mm"
    if not passed:
        text += (
            f" beside its neighbours (limit {limit:.1f}); look at its corners in the first frame (order, place, level), "
            "then at those in the rest pictures"
        )
    yield Check(name=names[1], value=float(stray[worst]), limit=limit, passed=passed, text=text)


# The fit


def _training(pushes: PushSet, fit: StiffnessFit, limits: Limits) -> Iterator[Check]:
    names = "training frames", "vertebrae in motion"
    fitted, moving, weights = [], [], []
    worst = _Stray(0.0, 1.0, "", "")
    for trial, part in zip(pushes.training, fit.residuals, strict=True):
        if trial.trial.reference is None:
            for name in names:
                yield _impossible(name, f"push '{trial.push}' has no usable frame without force")
            return
        rows, start, end = motion(pushes.torso, trial.trial, pushes.reference(trial.push).trial)
        weight = np.zeros(len(pushes.torso.vertebrae))
        seen = vertebra_rows(pushes.torso, trial.trial.corners)
        weight[seen] = part.weights
        fitted.append(np.mean(np.sum(part.fitted**2, -1), -1))
        moving.append(np.mean(np.sum((end - start) ** 2, -1), -1))
        weights.append((part.weights, weight[rows]))
        sure = np.flatnonzero(part.weights >= DOUBTED_QUALITY)
        if len(sure) > 1:
            limit = float(np.hypot(limits.stray_moved_mm, limits.stray_moved_share * np.sqrt(moving[-1].mean())))
            stray = strays(part.fitted[sure], seen[sure])
            most = int(np.argmax(stray))
            found = _Stray(float(stray[most]), limit, trial.trial.corners.vertebrae[sure[most]], trial.trial.label)
            worst = max(worst, found, key=lambda one: one.off_mm / one.limit)
    off, motion_mm = (
        float(np.sqrt(np.average(np.concatenate(squares), weights=np.concatenate(weight))))
        for squares, weight in ((fitted, [w[0] for w in weights]), (moving, [w[1] for w in weights]))
    )
    limit = float(np.hypot(limits.moved_mm, limits.moved_share * motion_mm))
    passed = off <= limit
    text = f"the fit leaves {off:.2f} mm (RMS) of the training frames' motion of {motion_mm:.1f} mm"
    if not passed:
        text += (
            f" (limit {limit:.1f}); look for exchanged forces, forces of another push, the wrong rib level or side, a "
            "patient who moved or turned, lost tracking"
        )
    yield Check(name=names[0], value=off, limit=limit, passed=passed, text=text)
    if not worst.vertebra:
        yield _impossible(names[1], "no training frame shows two vertebrae that were tracked well")
        return
    passed = worst.off_mm <= worst.limit
    text = f"{worst.frame}: {worst.vertebra} moves most unlike its neighbours, by {worst.off_mm:.2f} mm"
    if not passed:
        text += f" (limit {worst.limit:.1f}); look for lost tracking of it, then at its corners in the annotated frames"
    yield Check(name=names[1], value=worst.off_mm, limit=worst.limit, passed=passed, text=text)


class _Stray(NamedTuple):
    """A vertebra that moves unlike its neighbours."""

    off_mm: float
    limit: float
    vertebra: str
    frame: str


def _impossible(name: str, missing: str) -> Check:
    return Check(name=name, value=None, limit=None, passed=None, text=f"not possible: {missing}")
