"""The shape at rest: length and sizes against the height, and the corners of the rest pictures against each other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from spinestiff.arrays import Floats
from spinestiff.personalise.fitness import VertebraFit
from spinestiff.personalise.shape import Personalised
from spinestiff.study.judgement.limits import Limits
from spinestiff.study.judgement.verdict import check
from spinestiff.subject.estimate_outcome import Check
from spinestiff.subject.records import SubjectRecord

# Corners set aside of a vertebra's four that make it a wrong vertebra rather than a wrong corner.
WRONG_VERTEBRA = 3


@dataclass(frozen=True)
class RestShape:
    """What personalisation found, as far as it is judged.

    Attributes
    ----------
    corner_sd_mm : standard deviation of the annotated corners along one axis, from their residuals.
    length_scale : the spine's length over that of the template of the subject's sizes.
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


def length(record: SubjectRecord, shape: RestShape, limits: Limits) -> Check:
    """Whether the spine is as long as those of this height."""
    found, (passed, limit) = shape.length_scale, _within(shape.length_scale, limits.length)
    what = f"the spine is {found:.3f} times as long as {_compared(record)}"
    if not passed:
        what += f", as usual at {found * record.height_cm:.0f} cm"
    causes = "a wrong height_cm, wrong pixel spacing or distances in all pictures, a level skipped or counted twice"
    return check("length of the spine", what, found, limit, passed, causes)


def sizes(record: SubjectRecord, shape: RestShape, limits: Limits) -> Check:
    """Widths, heights and depths of vertebrae differ from person to person more than all of them together."""
    axes = ("width", "height", "depth")[: 3 if "lateral" in shape.fits else 2]
    medians = np.median(shape.size_scale[:, : len(axes)], axis=0)
    found = float(np.exp(np.log(medians).mean()))
    passed, limit = _within(found, limits.size)
    each = ", ".join(f"{axis} {median:.2f}" for axis, median in zip(axes, medians))
    what = f"the vertebrae are {found:.3f} times as large as {_compared(record)} ({each})"
    causes = "wrong pixel spacing or distances, a wrong height_cm, corners that are not those of the bodies"
    return check("sizes of the vertebrae", what, found, limit, passed, causes)


def _compared(record: SubjectRecord) -> str:
    return f"{'the template' if record.torso is None else 'the own torso'}'s at {record.height_cm:g} cm"


def _within(found: float, factor: float) -> tuple[bool, float]:
    """Whether a ratio lies within a factor of 1, and the limit on its side."""
    return bool(abs(np.log(found)) <= np.log(factor)), factor if found >= 1.0 else 1.0 / factor


def rest_pictures(shape: RestShape, limits: Limits) -> Iterator[Check]:
    """Whether the corners of the rest pictures agree, all together and vertebra by vertebra."""
    yield check(
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
    yield check("vertebrae at rest", found, float(len(wrong)), float(allowed), len(wrong) <= allowed, causes)
