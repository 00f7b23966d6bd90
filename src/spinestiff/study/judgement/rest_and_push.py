"""Rest and push: the spine that a push shows without force is that of the rest pictures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from spinestiff.estimation.objective import FEWEST_VERTEBRAE
from spinestiff.study.judgement.limits import FEW, Limits
from spinestiff.study.judgement.verdict import check, impossible
from spinestiff.study.misfit import Explanation, Spines, explanations, motion, moved, rms, shared, spines, strays
from spinestiff.study.trials import PushSet, PushTrial
from spinestiff.subject.estimate_outcome import Check
from spinestiff.subject.records import PushRecord

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


def unloaded(pushes: PushSet, push: PushRecord, sd: float, limits: Limits) -> Iterator[Check]:
    """Whether a push without force shows the spine at rest: as a whole, unbent, and vertebra by vertebra."""
    names = "rest and push", "rest without load", "vertebrae of the push"
    trials = [trial for trial in pushes.trials if trial.push == push.id]
    reference = min(trials, key=lambda trial: trial.force_n, default=None)
    if reference is None or reference.force_n > 0.0:
        for name in names:
            yield impossible(name, f"push '{push.id}' has no usable frame without force")
        return
    found, off = spines(pushes.torso, reference.trial), pushes.poses[push.id].rms_mm
    limit = limits.rest_limit(sd)
    causes = "" if off <= limit else _what_differs(pushes, found, trials, off, limit)
    text = f"push '{push.id}': its spine without force lies {off:.2f} mm (RMS) from that of the rest pictures"
    yield check(names[0], text, off, limit, off <= limit, causes)
    yield _under_load(pushes, push, found, trials, limit, limits.load_limit(sd))
    yield _strays(push, found, sd, limits)


def _under_load(
    pushes: PushSet, push: PushRecord, found: Spines, trials: Sequence[PushTrial], rest_limit: float, limit: float
) -> Check:
    """Whether the rest pictures show the spine as the push bends it rather than as it was before."""
    name = "rest without load"
    least = min(trials, key=lambda trial: trial.force_n)
    alike = [trial for trial in trials if shared(trial.trial, least.trial) >= FEWEST_VERTEBRAE]
    most = max(alike, key=lambda trial: trial.force_n)
    if most.force_n == 0.0:
        few = "" if all(trial.force_n == 0.0 for trial in trials) else f" with {FEWEST_VERTEBRAE} of its vertebrae"
        return impossible(name, f"push '{push.id}' has no usable frame under a force{few}")
    rows, start, end = motion(pushes.torso, most.trial, least.trial)
    bent = end - moved(start, end)
    off = -found.difference[np.isin(found.rows, rows)]
    along = float(np.mean(np.sum(off * bent, -1))) / rms(bent)
    causes = "a rest picture under load, forces in another order than the frames, another posture"
    if rms(off - along * bent / rms(bent)) > rest_limit:
        causes = f"what makes rest and push differ, then for {causes}"
    return check(
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
    return check("vertebrae of the push", text, float(stray[worst]), limit, bool(stray[worst] <= limit), causes)


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
