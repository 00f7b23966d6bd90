"""Can this result be right? Checks of an estimate against everything that the steps know beside it (docs/judgement.md).

A wrong input (another person's picture, exchanged forces, kilograms for newtons) ends in a fit like any other: it
converges, has intervals and predicts something. Each check compares two things that have to agree when all is well,
and says in one line what was found, the limit, and the mistakes to look for, the most likely first. Limits were set on
sound subjects and are held against others (``benchmarks/judgement.py``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from spinestiff.estimation.fitted import StiffnessFit
from spinestiff.imaging.dicom.identity import Identity
from spinestiff.study.judgement.fitted_motion import residuals_expected, training_frames
from spinestiff.study.judgement.forces import bending, copies, direction, force_scale, growth, repeated
from spinestiff.study.judgement.identity import identity
from spinestiff.study.judgement.limits import LIMITS, Limits
from spinestiff.study.judgement.rest_and_push import unloaded
from spinestiff.study.judgement.rest_shape import RestShape, length, rest_pictures, sizes
from spinestiff.study.trials import PushSet
from spinestiff.subject.estimate_outcome import Check
from spinestiff.subject.records import SubjectRecord


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
    return (*found, *training_frames(pushes, fit, limits), residuals_expected(record, fit, limits))


def judge_inputs(
    record: SubjectRecord,
    shape: RestShape,
    pushes: PushSet,
    identities: Mapping[str, Identity],
    limits: Limits = LIMITS,
) -> tuple[Check, ...]:
    """Those that need no fit, so that they can be told before it and where it finds nothing."""
    found = [*identity(identities, limits), force_scale(pushes.training, limits)]
    found += judge_motion(record, pushes, limits)
    found += [length(record, shape, limits), sizes(record, shape, limits), *rest_pictures(shape, limits)]
    sd = float(np.clip(shape.corner_sd_mm, limits.least_sd_mm, limits.most_sd_mm))
    for push in record.pushes:
        found += unloaded(pushes, push, sd, limits)
    return tuple(found)


def judge_motion(record: SubjectRecord, pushes: PushSet, limits: Limits = LIMITS) -> tuple[Check, ...]:
    """Those of each push's motion under its forces, for which the template is torso enough."""
    found = []
    for push in record.pushes:
        mine = [trial for trial in pushes.trials if trial.push == push.id]
        bent = bending(pushes, mine)
        found += [growth(push, bent, limits), *repeated(push, bent, limits)]
        found += [direction(pushes, push, mine, limits), copies(pushes, push, mine, limits)]
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
