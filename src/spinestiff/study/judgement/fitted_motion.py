"""What a fit leaves of the training frames' motion, and whether the expected errors explain it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from spinestiff.arrays import Floats, Ints
from spinestiff.estimation.fitted import StiffnessFit
from spinestiff.estimation.objective import FEWEST_VERTEBRAE, Residuals, make_target, residuals
from spinestiff.imaging.features import vertebra_rows
from spinestiff.imaging.tracking.quality import DOUBTED_QUALITY
from spinestiff.study.judgement.limits import FEW, Limits
from spinestiff.study.judgement.verdict import check, impossible
from spinestiff.study.misfit import motion, shared, strays
from spinestiff.study.trials import PushSet, PushTrial
from spinestiff.subject.estimate_outcome import Check
from spinestiff.subject.records import SubjectRecord


def training_frames(pushes: PushSet, fit: StiffnessFit, limits: Limits) -> Iterator[Check]:
    """Whether the fit leaves little of the motion: of all frames together, and of single vertebrae."""
    names = "training frames", "vertebrae in motion"
    blind = [trial.push for trial in pushes.training if pushes.reference(trial.push).force_n > 0.0]
    if blind:
        for name in names:
            yield impossible(name, f"push '{blind[0]}' has no usable frame without force")
        return
    moves = [
        _Motion.of(pushes, trial, part)
        for trial, part in zip(pushes.training, fit.residuals, strict=True)
        if shared(trial.trial, pushes.reference(trial.push).trial) >= FEWEST_VERTEBRAE
    ]
    if not moves:
        for name in names:
            yield impossible(
                name, f"no training frame shows {FEWEST_VERTEBRAE} of the vertebrae of its push's frame without force"
            )
        return
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
    yield check(names[0], text, off, limit, off <= limit, causes)
    strange = [one.stray(limits) for one in moves]
    sure = [one for one in strange if one is not None]
    if not sure:
        yield impossible(names[1], "no training frame shows two vertebrae that were tracked well")
        return
    off, limit, vertebra, label = max(sure, key=lambda one: one[0] / one[1])
    text = f"{label}: the fit leaves {off:.2f} mm (RMS) more of the motion of {vertebra} than of its neighbours'"
    causes = f"lost tracking of {vertebra}, then its corners in the annotated frames"
    yield check(names[1], text, off, limit, off <= limit, causes)


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
        return cls(item.trial.label, seen, rows, part.quality[kept], left, moved2)

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


def residuals_expected(record: SubjectRecord, fit: StiffnessFit, limits: Limits) -> Check:
    """Whether all that is not quite known explains what the fit leaves, before any of it is made larger to do so."""
    name, found = "residuals as expected", fit.weighed
    if found is None:
        return impossible(name, "the paper's estimator expects no size of the errors")
    if np.isnan(found.p_value):
        return impossible(name, "no residual is left to judge by: ratios and places in the picture take up all data")
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
    if record.pelvis == "level":
        causes += ", a pelvis that turned (subject.json's 'pelvis' takes it to be level)"
    if by_vertebra and len(by_vertebra) <= FEW:
        causes = f"the corners of {' and '.join(by_vertebra)}, then for {causes}"
    return check(name, text, found.p_value, limits.p_value, passed, causes)


def _at_rest(pushes: PushSet, item: PushTrial) -> Floats:
    """(V, 4, 2) mm, the torso at rest minus what the push's unloaded frame shows of a frame's vertebrae."""
    trial = pushes.reference(item.push).trial
    names = item.trial.corners.vertebrae
    target = make_target(pushes.torso, replace(trial, corners=trial.corners.selected(names)), pushes.orientation)
    found = np.full((len(pushes.torso.vertebrae), 4, 2), np.nan)
    found[target.rows] = residuals(pushes.torso, target, pushes.torso.rest_pose).difference
    return found
