"""Can this result be right? Checks of an estimate against everything that the steps know beside it (docs/judgement.md).

A wrong input (another person's picture, exchanged forces, kilograms for newtons) ends in a fit like any other: it
converges, has intervals and predicts something. Each check compares two things that have to agree when all is well,
and says in one line what was found, the limit, and the mistakes to look for, the most likely first. Limits were set on
sound subjects and are held against others (``benchmarks/judgement.py``).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from spinestiff.arrays import Floats, Ints
from spinestiff.estimation.fitted import StiffnessFit
from spinestiff.estimation.objective import Residuals, make_target, residuals
from spinestiff.imaging.dicom.identity import Identity
from spinestiff.imaging.features import picture_axes, vertebra_rows
from spinestiff.imaging.tracking.quality import DOUBTED_QUALITY
from spinestiff.personalise.fitness import VertebraFit
from spinestiff.personalise.shape import Personalised
from spinestiff.study.frame_selection import SAME_FORCE
from spinestiff.study.misfit import Explanation, Spines, explanations, motion, moved, rms, spines, strays
from spinestiff.study.trials import PushSet, PushTrial
from spinestiff.subject.estimate_outcome import Check
from spinestiff.subject.records import USUAL_FORCES_N, PushRecord, SubjectRecord

# Corners set aside of a vertebra's four that make it a wrong vertebra rather than a wrong corner.
WRONG_VERTEBRA = 3
# Beyond so many vertebrae it is not their corners.
FEW = 2
# A mistake explains a difference that it lowers to this share of the limit, and of what it was.
EXPLAINED = 0.6
# What usually makes rest and push differ; kinds as in ``misfit.Explanation``.
USUAL = {
    "person": "rest pictures of another person or visit",
    "levels": "levels named differently",
    "mirror": "a mirrored picture",
    "load": "a rest picture under load or forces in another order than the frames",
    "scale": "pixel spacing or distances of one of them",
    "posture": "another posture",
}


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
    load_mm, load_sd : the part of it that is as the push bends the spine.
    stray_mm, stray_sd : the same of one vertebra about its neighbours.
    moved_mm, moved_share : of the training frames' motion about the fitted one: stance, and share of the motion.
    stray_moved_mm, stray_moved_share : the same of one vertebra about its neighbours.
    fall_mm, fall_share : by which the bending may fall from one frame to one of more force, or differ between two of
        the same: absolute, and as a share of the greatest bending of the push.
    against_mm : by which a spine may move against the push.
    p_value : of the fit's residuals, if all errors are as expected.
    """

    force_n: tuple[float, float] = USUAL_FORCES_N
    days_apart: int = 30
    corner_sd_mm: float = 1.5
    least_sd_mm: float = 0.3
    most_sd_mm: float = 1.2
    wrong_vertebrae: int = 0
    length: float = 1.12
    size: float = 1.18
    rest_mm: float = 3.4
    rest_sd: float = 2.0
    load_mm: float = 1.2
    load_sd: float = 1.0
    stray_mm: float = 3.2
    stray_sd: float = 3.0
    moved_mm: float = 1.7
    moved_share: float = 0.15
    stray_moved_mm: float = 1.3
    stray_moved_share: float = 0.1
    fall_mm: float = 0.2
    fall_share: float = 0.03
    against_mm: float = 1.0
    p_value: float = 1e-3

    def rest_limit(self, sd: float) -> float:
        """mm, for corners of this standard deviation."""
        return float(np.hypot(self.rest_mm, self.rest_sd * sd))

    def load_limit(self, sd: float) -> float:
        """mm, for corners of this standard deviation."""
        return float(np.hypot(self.load_mm, self.load_sd * sd))

    def stray_limit(self, sd: float) -> float:
        """mm, for corners of this standard deviation."""
        return float(np.hypot(self.stray_mm, self.stray_sd * sd))


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
    found = judge_inputs(record, shape, pushes, identities, limits)
    return (*found, *_training(pushes, fit, limits), _residuals(fit, limits))


def judge_inputs(
    record: SubjectRecord,
    shape: RestShape,
    pushes: PushSet,
    identities: Mapping[str, Identity],
    limits: Limits = LIMITS,
) -> tuple[Check, ...]:
    """Those that need no fit, so that they can be told before it and where it finds nothing."""
    found = [*_identity(identities, limits), _force_scale(pushes.training, limits)]
    for push in record.pushes:
        mine = [trial for trial in pushes.trials if trial.push == push.id]
        bending = _bending(pushes, mine)
        found += [_growth(push, bending, limits), *_repeated(push, bending, limits)]
        found.append(_direction(pushes, push, mine, limits))
    found += [_length(record, shape, limits), _sizes(record, shape, limits), *_rest_pictures(shape, limits)]
    sd = float(np.clip(shape.corner_sd_mm, limits.least_sd_mm, limits.most_sd_mm))
    for push in record.pushes:
        found += _unloaded(pushes, push, sd, limits)
    return tuple(found)


def outlying_notes(fit: StiffnessFit) -> tuple[str, ...]:
    """The vertebrae that count for less in a fit since their own errors are larger than usual: no sign of a mistake."""
    found = () if fit.weighed is None else fit.weighed.outlying
    return tuple(
        f"{label}: {vertebra} counts for less, its own error is {size:.1f} times what is usual"
        for label, vertebra, size in found
    )


def failed(checks: Sequence[Check]) -> tuple[Check, ...]:
    """The checks that say that something is wrong."""
    return tuple(check for check in checks if check.passed is False)


# Whose pictures, and when


def _identity(identities: Mapping[str, Identity], limits: Limits) -> Iterator[Check]:
    """Files are compared pair by pair; nothing that stands in them is said."""
    pairs = list(combinations(identities, 2))
    same = {pair: identities[pair[0]].is_of(identities[pair[1]]) for pair in pairs}
    yield _by_files(
        "same patient",
        {pair: not found for pair, found in same.items() if found is not None},
        len(pairs),
        ("the files name the same patient", "name different patients"),
        "a radiograph in the wrong folder, then for a patient registered twice",
        "a file names no patient, or its patient was taken out",
    )
    days = {pair: identities[pair[0]].days_from(identities[pair[1]]) for pair in pairs}
    most = limits.days_apart
    yield _by_files(
        "same visit",
        {pair: apart > most for pair, apart in days.items() if apart is not None},
        len(pairs),
        (f"the pictures were taken within {most} days", f"were taken more than {most} days apart"),
        "pictures of another visit, then for a wrong date in the X-ray system",
        "a file has no date, or its patient was taken out",
    )


def _by_files(
    name: str, differ: Mapping[tuple[str, str], bool], pairs: int, said: tuple[str, str], look_for: str, missing: str
) -> Check:
    """``differ`` holds the pairs that could be compared; ``said`` is for pairs that agree, and for one that differs."""
    wrong = next((pair for pair, different in differ.items() if different), None)
    if wrong is not None:
        return _check(name, f"{wrong[0]} and {wrong[1]} {said[1]}", None, None, False, look_for)
    if not pairs or len(differ) < pairs:
        return _impossible(name, missing)
    return _check(name, said[0], None, None, True, look_for)


# Forces


def _force_scale(training: Sequence[PushTrial], limits: Limits) -> Check:
    force, (low, high) = max(trial.force_n for trial in training), limits.force_n
    few, many = "kilograms (1 kg is 9.81 N) or pounds (4.45 N)", "newtons multiplied by 4.45 or 9.81 as if"
    causes = f"{few} entered as newtons, then for training frames of too little force"
    if force > high:
        causes = f"{many} they were pounds or kilograms, then for the gauge's range"
    return _check(
        "size of the force",
        f"the largest training force is {force:.3g} N",
        force,
        low if force < low else high,
        low <= force <= high,
        causes,
    )


def _growth(push: PushRecord, bending: Sequence[tuple[PushTrial, float]], limits: Limits) -> Check:
    name = "motion grows with force"
    if len({trial.force_n for trial, _ in bending}) < 3:
        return _impossible(name, f"push '{push.id}' has fewer than two forces above its least in usable frames")
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
    return _check(name, found, max(fall, 0.0), limit, fall <= limit, causes)


def _repeated(push: PushRecord, bending: Sequence[tuple[PushTrial, float]], limits: Limits) -> Iterator[Check]:
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
    yield _check(
        "same force, same bending",
        f"push '{push.id}': at {again.force_n:g} N (frame {again.frame}) the spine is bent by {way + off:.1f} mm, "
        f"where it was bent by {way:.1f} mm before (frame {before.frame}, {before.force_n:g} N)",
        abs(off),
        limit,
        abs(off) <= limit,
        "creep between the frames or friction on the way back (train on frames of one way), a patient who moved, "
        "exchanged forces, lost tracking",
    )


def _bending(pushes: PushSet, trials: Sequence[PushTrial]) -> list[tuple[PushTrial, float]]:
    """The frames of a push and how far, mm, the spine bent in each from that of least force, along the largest bending.

    Shifts and turns of the whole picture, as of a patient who gave way, are taken out. Empty without a loaded frame
    beside that of least force, the reference.
    """
    reference = min(trials, key=lambda trial: trial.force_n, default=None)
    if reference is None or all(trial.force_n == reference.force_n for trial in trials):
        return []
    others = [trial for trial in trials if trial is not reference]
    bent = np.full((len(others), len(pushes.torso.vertebrae), 4, 2), np.nan)
    for shape, trial in zip(bent, others):
        rows, start, end = motion(pushes.torso, trial.trial, reference.trial)
        shape[rows] = end - moved(start, end)
    largest = max(bent, key=_size)
    along = [(reference, 0.0)]
    for trial, shape in zip(others, bent):
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
    against = -push.sign * float(((end - start) @ left).mean())
    where = f"{abs(against):.1f} mm {'against' if against > 0.0 else 'along'} the push from the {push.side}"
    return _check(
        name,
        f"push '{push.id}': at {most.force_n:g} N the spine has moved by {where}",
        max(against, 0.0),
        limits.against_mm,
        against <= limits.against_mm,
        "the wrong side in subject.json, mirrored pictures of the push, forces in reverse order",
    )


# The shape at rest


def _length(record: SubjectRecord, shape: RestShape, limits: Limits) -> Check:
    found, (passed, limit) = shape.length_scale, _within(shape.length_scale, limits.length)
    what = f"the spine is {found:.3f} times as long as {_compared(record)}"
    if not passed:
        what += f", as usual at {found * record.height_cm:.0f} cm"
    causes = "a wrong height_cm, wrong pixel spacing or distances in all pictures, a level skipped or counted twice"
    return _check("length of the spine", what, found, limit, passed, causes)


def _sizes(record: SubjectRecord, shape: RestShape, limits: Limits) -> Check:
    """Widths, heights and depths of vertebrae differ from person to person more than all of them together."""
    axes = ("width", "height", "depth")[: 3 if "lateral" in shape.fits else 2]
    medians = np.median(shape.size_scale[:, : len(axes)], axis=0)
    found = float(np.exp(np.log(medians).mean()))
    passed, limit = _within(found, limits.size)
    each = ", ".join(f"{axis} {median:.2f}" for axis, median in zip(axes, medians))
    what = f"the vertebrae are {found:.3f} times as large as {_compared(record)} ({each})"
    causes = "wrong pixel spacing or distances, a wrong height_cm, corners that are not those of the bodies"
    return _check("sizes of the vertebrae", what, found, limit, passed, causes)


def _compared(record: SubjectRecord) -> str:
    return f"{'the template' if record.torso is None else 'the own torso'}'s at {record.height_cm:g} cm"


def _within(found: float, factor: float) -> tuple[bool, float]:
    """Whether a ratio lies within a factor of 1, and the limit on its side."""
    return bool(abs(np.log(found)) <= np.log(factor)), factor if found >= 1.0 else 1.0 / factor


def _rest_pictures(shape: RestShape, limits: Limits) -> Iterator[Check]:
    yield _check(
        "corners at rest",
        f"the corners in the rest pictures scatter by {shape.corner_sd_mm:.2f} mm about the shape found",
        shape.corner_sd_mm,
        limits.corner_sd_mm,
        shape.corner_sd_mm <= limits.corner_sd_mm,
        "a lateral picture of another person or posture, spacing or distances of one picture, levels named differently "
        "in the two",
    )
    wrong = [
        f"{vertebra} ({view})"
        for view, fits in shape.fits.items()
        for vertebra, fit in fits.items()
        if fit.wrong_corners >= WRONG_VERTEBRA
    ]
    found = f"{', '.join(wrong) or 'no vertebra'} contradicts the others in the rest pictures"
    causes = "corners in another order, a vertebra marked at the wrong place, a wrong level"
    allowed = limits.wrong_vertebrae
    yield _check("vertebrae at rest", found, float(len(wrong)), float(allowed), len(wrong) <= allowed, causes)


# Rest and push


def _unloaded(pushes: PushSet, push: PushRecord, sd: float, limits: Limits) -> Iterator[Check]:
    names = "rest and push", "rest without load", "vertebrae of the push"
    trials = [trial for trial in pushes.trials if trial.push == push.id]
    reference = min(trials, key=lambda trial: trial.force_n, default=None)
    if reference is None or reference.force_n > 0.0:
        for name in names:
            yield _impossible(name, f"push '{push.id}' has no usable frame without force")
        return
    found, off = spines(pushes.torso, reference.trial), pushes.poses[push.id].rms_mm
    limit = limits.rest_limit(sd)
    causes = "" if off <= limit else _what_differs(pushes, found, trials, off, limit)
    text = f"push '{push.id}': its spine without force lies {off:.2f} mm (RMS) from that of the rest pictures"
    yield _check(names[0], text, off, limit, off <= limit, causes)
    yield _under_load(pushes, push, found, trials, limit, limits.load_limit(sd))
    yield _strays(push, found, sd, limits)


def _under_load(
    pushes: PushSet, push: PushRecord, found: Spines, trials: Sequence[PushTrial], rest_limit: float, limit: float
) -> Check:
    """Whether the rest pictures show the spine as the push bends it rather than as it was before."""
    name = "rest without load"
    least, most = (pick(trials, key=lambda trial: trial.force_n) for pick in (min, max))
    if most.force_n == 0.0:
        return _impossible(name, f"push '{push.id}' has no usable frame under a force")
    rows, start, end = motion(pushes.torso, most.trial, least.trial)
    bent = end - moved(start, end)
    off = -found.difference[np.isin(found.rows, rows)]
    along = float(np.mean(np.sum(off * bent, -1))) / rms(bent)
    causes = "a rest picture under load, forces in another order than the frames, another posture"
    if rms(off - along * bent / rms(bent)) > rest_limit:
        causes = f"what makes rest and push differ, then for {causes}"
    return _check(
        name,
        f"push '{push.id}': at rest the spine is bent by {abs(along):.2f} mm (RMS) "
        f"{'the way the push bends it' if along >= 0.0 else 'against the way the push bends it'}, at "
        f"{most.force_n:g} N by {rms(bent):.1f} mm",
        max(along, 0.0),
        limit,
        along <= limit,
        causes,
    )


def _strays(push: PushRecord, found: Spines, sd: float, limits: Limits) -> Check:
    stray = strays(found.difference, found.rows)
    worst, limit = int(np.argmax(stray)), limits.stray_limit(sd)
    name, beyond = found.vertebrae[worst], int((stray > limit).sum())
    text = f"push '{push.id}': against the rest pictures {name} is {stray[worst]:.2f} mm (RMS) off its neighbours"
    causes = f"the corners of {name} in the annotated frames (order, place, level), then in the rest pictures"
    if beyond > FEW:
        text += f", and {beyond - 1} others are beyond the limit"
        causes = "levels named differently, a level skipped or counted twice, then what makes rest and push differ"
    return _check("vertebrae of the push", text, float(stray[worst]), limit, bool(stray[worst] <= limit), causes)


def _what_differs(pushes: PushSet, found: Spines, trials: Sequence[PushTrial], off: float, limit: float) -> str:
    """What to look for where rest and push differ: what would explain it, then what usually does."""
    loaded = (
        (f"frame {trial.frame} ({trial.force_n:g} N)", spines(pushes.torso, trial.trial))
        for trial in trials
        if trial.force_n > 0.0
    )
    likely = [one for one in explanations(found, loaded) if one.left_mm <= EXPLAINED * min(limit, off)]
    best = {one.kind: one for one in reversed(likely)}
    said = [f"{one.text} ({one.left_mm:.1f} mm would remain)" for one in sorted(best.values(), key=_left)]
    return ", ".join([*said, *(text for kind, text in USUAL.items() if kind not in best)])


def _left(one: Explanation) -> float:
    return one.left_mm


# The fit


def _training(pushes: PushSet, fit: StiffnessFit, limits: Limits) -> Iterator[Check]:
    names = "training frames", "vertebrae in motion"
    blind = [trial.push for trial in pushes.training if pushes.reference(trial.push).force_n > 0.0]
    if blind:
        for name in names:
            yield _impossible(name, f"push '{blind[0]}' has no usable frame without force")
        return
    moves = [_Motion.of(pushes, trial, part) for trial, part in zip(pushes.training, fit.residuals, strict=True)]
    weights = np.concatenate([one.weights for one in moves])
    off, far = (
        float(np.sqrt(np.average(np.concatenate([getattr(one, which) for one in moves]), weights=weights)))
        for which in ("left2", "moved2")
    )
    limit = float(np.hypot(limits.moved_mm, limits.moved_share * far))
    text = f"the fit leaves {off:.2f} mm (RMS) of the training frames' motion of {far:.1f} mm"
    causes = (
        "exchanged forces, forces of another push, the wrong rib level or side, a patient who moved or turned, lost "
        "tracking"
    )
    yield _check(names[0], text, off, limit, off <= limit, causes)
    strange = [one.stray(limits) for one in moves]
    sure = [one for one in strange if one is not None]
    if not sure:
        yield _impossible(names[1], "no training frame shows two vertebrae that were tracked well")
        return
    off, limit, vertebra, label = max(sure, key=lambda one: one[0] / one[1])
    text = f"{label}: the fit leaves {off:.2f} mm (RMS) more of the motion of {vertebra} than of its neighbours'"
    causes = f"lost tracking of {vertebra}, then its corners in the annotated frames"
    yield _check(names[1], text, off, limit, off <= limit, causes)


@dataclass(frozen=True)
class _Motion:
    """What the fit leaves of a training frame's motion.

    Attributes
    ----------
    label : of the frame.
    vertebrae, rows, weights : (n,) of the vertebrae that the frame and its unloaded one show.
    left : (n, 4, 2) mm, simulated minus measured motion.
    moved2 : (n,) mm^2, mean squared motion of a vertebra's corners.
    """

    label: str
    vertebrae: tuple[str, ...]
    rows: Ints
    weights: Floats
    left: Floats
    moved2: Floats

    @classmethod
    def of(cls, pushes: PushSet, item: PushTrial, part: Residuals) -> _Motion:
        names = item.trial.corners.vertebrae
        rows, start, end = motion(pushes.torso, item.trial, pushes.reference(item.push).trial)
        kept = [i for i, row in enumerate(vertebra_rows(pushes.torso, item.trial.corners)) if row in rows]
        seen = tuple(names[i] for i in kept)
        moved2 = np.mean(np.sum((end - start) ** 2, -1), -1)
        left = part.difference[kept] - _at_rest(pushes, item)[rows]
        return cls(item.trial.label, seen, rows, part.weights[kept], left, moved2)

    @property
    def left2(self) -> Floats:
        """(n,) mm^2, mean square over a vertebra's corners."""
        return np.asarray(np.mean(np.sum(self.left**2, -1), -1))

    def stray(self, limits: Limits) -> tuple[float, float, str, str] | None:
        """Of the vertebra that is most unlike its neighbours: mm, limit, name, frame; of those tracked well."""
        sure = np.flatnonzero(self.weights >= DOUBTED_QUALITY)
        if len(sure) < 2:
            return None
        found = strays(self.left[sure], self.rows[sure])
        worst = int(np.argmax(found))
        limit = float(np.hypot(limits.stray_moved_mm, limits.stray_moved_share * np.sqrt(self.moved2.mean())))
        return float(found[worst]), limit, self.vertebrae[sure[worst]], self.label


def _residuals(fit: StiffnessFit, limits: Limits) -> Check:
    """Whether all that is not quite known explains what the fit leaves, before any of it is made larger to do so."""
    name, found = "residuals as expected", fit.weighed
    if found is None:
        return _impossible(name, "the paper's estimator expects no size of the errors")
    passed = found.p_value >= limits.p_value
    by_vertebra: dict[str, list[str]] = {}
    for label, vertebra, _ in found.outlying:
        by_vertebra.setdefault(vertebra, []).append(label)
    outlying = [f"{vertebra} ({', '.join(labels)})" for vertebra, labels in by_vertebra.items()]
    text = (
        f"the expected errors explain {'the' if passed else 'no such'} residuals (p = {found.p_value:.2g}); tracking's "
        f"errors are {found.tracking_factor:.2f} times what tracking expects, and "
        f"{'outlying are ' + ', '.join(outlying) if outlying else 'no vertebra is outlying'}"
    )
    causes = (
        "exchanged forces, forces of another push, the wrong rib level or side, a patient who moved, rest pictures of "
        "another posture, lost tracking"
    )
    if by_vertebra and len(by_vertebra) <= FEW:
        causes = f"the corners of {' and '.join(by_vertebra)}, then for {causes}"
    return _check(name, text, found.p_value, limits.p_value, passed, causes)


def _at_rest(pushes: PushSet, item: PushTrial) -> Floats:
    """(V, 4, 2) mm, the torso at rest minus what the push's unloaded frame shows of a frame's vertebrae."""
    trial = pushes.reference(item.push).trial
    names = item.trial.corners.vertebrae
    target = make_target(pushes.torso, replace(trial, corners=trial.corners.selected(names)), pushes.orientation)
    found = np.full((len(pushes.torso.vertebrae), 4, 2), np.nan)
    found[target.rows] = residuals(pushes.torso, target, pushes.torso.rest_pose).difference
    return found


def _check(name: str, found: str, value: float | None, limit: float | None, passed: bool, look_for: str) -> Check:
    """One line: what was found and, where it did not pass, the limit and the causes."""
    if not passed:
        said = "" if limit is None else f" (limit {limit:.3g})"
        found = f"{found}{said}; look for {look_for}"
    return Check(name=name, value=value, limit=limit, passed=passed, text=found)


def _impossible(name: str, missing: str) -> Check:
    return Check(name=name, value=None, limit=None, passed=None, text=f"not possible: {missing}")
