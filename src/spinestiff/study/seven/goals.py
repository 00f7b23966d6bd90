"""What the study is judged by: goals set before it, each with what was found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from spinestiff.study.seven.participants import (
    INITIAL_RMSE_MM,
    INITIAL_RMSE_SPREAD_MM,
    MAIN,
    OTHER_LEVEL,
    OTHER_SIDE,
)
from spinestiff.study.wording.numbers import fixed
from spinestiff.subject.study_outcome import FrameOutcome, SubjectOutcome

RMSE_MM, SHARE, COBB_MEAN_DEG, COBB_WORST_DEG = 3.3, 1 / 3, 2.9, 5.0
INSIDE = (0.90, 0.99)
COBB_FORMS = {
    "fixed_levels": "between fixed levels",
    "signed": "as signed largest angle (the paper's form, its Table 6)",
}
"""Forms of the Cobb angle's change that are judged, in words."""
COBB_PREDICTORS = {"fit": "estimate", "forecast": "forecast"}
"""Whose."""
PUSHES = {MAIN: "the same rib", OTHER_LEVEL: "another rib", OTHER_SIDE: "the other side"}
Form = str


@dataclass(frozen=True)
class Goal:
    """A goal with what was found; ``met`` is None where nothing was."""

    name: str
    wanted: str
    found: str
    met: bool | None


def frames_of(outcomes: Sequence[SubjectOutcome], push: str) -> list[FrameOutcome]:
    """The held-out frames of a push, of the subjects in which it could be used."""
    return [frame for one in outcomes if (frame := one.frame(push)) is not None]


def places(frames: Sequence[FrameOutcome], predictor: str) -> list[float]:
    """Corner RMSE by a predictor, mm."""
    return [value for frame in frames if (value := frame.rmse_mm.get(predictor)) is not None]


def motions(frames: Sequence[FrameOutcome], predictor: str) -> list[float]:
    """Corner RMSE of the motion since the unloaded frame by a predictor, mm."""
    return [frame.motion_mm[predictor] for frame in frames if predictor in frame.motion_mm]


def cobb_errors(frames: Sequence[FrameOutcome], model: str, form: Form = "fixed_levels") -> list[float]:
    """Absolute error of a model's change of the Cobb angle in one of its three forms, degrees."""
    found = []
    for frame in frames:
        measured, simulated = frame.cobb_deg.get("measured"), frame.cobb_deg.get(model)
        if measured is not None and simulated is not None:
            found.append(abs(getattr(simulated, form) - getattr(measured, form)))
    return found


def median(values: Sequence[float]) -> float | None:
    """None of nothing."""
    return float(np.median(values)) if len(values) else None


def mean(values: Sequence[float]) -> float | None:
    """None of nothing."""
    return float(np.mean(values)) if len(values) else None


Errors = Callable[[Sequence[FrameOutcome], str], list[float]]


def medians(errors: Errors, frames: Sequence[FrameOutcome], *predictors: str) -> tuple[float | None, ...]:
    """Each predictor's median error, over the frames that all of them have: a frame that one misses is no one's gain.

    Parameters
    ----------
    errors : ``places`` or ``motions``.
    """
    found = [[errors([frame], name) for name in predictors] for frame in frames]
    common = [values for values in found if all(values)]
    return tuple(median([one[0] for one in column]) for column in zip(*common)) or (None,) * len(predictors)


def coverage(frames: Sequence[FrameOutcome]) -> float | None:
    """Share of held-out corner coordinates inside their 95 % intervals, mean over the frames."""
    return mean([frame.inside95 for frame in frames if frame.inside95 is not None])


def goals(outcomes: Sequence[SubjectOutcome]) -> tuple[Goal, ...]:
    """All but that of time (``account.time_goal``), for these subjects.

    The Cobb angle's goals are judged in two forms, the paper's among them, by the estimate's model and by the forecast;
    the intervals' at each place as well.
    """
    main = frames_of(outcomes, MAIN)
    fit, default = mean(places(main, "fit")), mean(places(main, "default"))
    share = None if fit is None or not default else fit / default
    initial = mean([one.initial_mm for one in outcomes])
    found = [
        _goal("geometry's RMSE at rest, mean", f"{INITIAL_RMSE_MM} ± {INITIAL_RMSE_SPREAD_MM} mm", initial, " mm", 2,
              lambda v: abs(v - INITIAL_RMSE_MM) <= INITIAL_RMSE_SPREAD_MM),
        _goal("RMSE of the validation frame, mean", f"≤ {RMSE_MM} mm", fit, " mm", 2, lambda v: v <= RMSE_MM),
        _goal("the same over the default's", "≤ 1/3", share, "", 2, lambda v: v <= SHARE),
    ]  # fmt: skip
    for form, words in COBB_FORMS.items():
        for predictor, whose in COBB_PREDICTORS.items():
            errors, name = cobb_errors(main, predictor, form), f"error of the Cobb angle's change {words}, {whose}"
            found += [
                _goal(f"{name}, mean", f"≤ {COBB_MEAN_DEG}°", mean(errors), "°", 1, lambda v: v <= COBB_MEAN_DEG),
                _goal(f"{name}, worst", f"≤ {COBB_WORST_DEG:g}°", max(errors, default=None), "°", 1,
                      lambda v: v <= COBB_WORST_DEG),
            ]  # fmt: skip
    groups = {"all held-out frames": [frame for one in outcomes for frame in one.frames]}
    for where, frames in (groups | {words: frames_of(outcomes, push) for push, words in PUSHES.items()}).items():
        inside = coverage(frames)
        found.append(
            _goal(f"corners inside their 95 % intervals, {where}", "90 to 99 %",
                  None if inside is None else 100 * inside, " %", 1, lambda v: INSIDE[0] <= v / 100 <= INSIDE[1])
        )  # fmt: skip
    for push in (OTHER_LEVEL, OTHER_SIDE):
        frames = frames_of(outcomes, push)
        motion = f"median RMSE of the motion at {PUSHES[push]}, estimate against"
        found += [
            _below(f"median RMSE at {PUSHES[push]}, forecast against tracking extrapolated by force",
                   *medians(places, frames, "forecast", "extrapolation")),
            _below(f"median RMSE at {PUSHES[push]}, estimate against tracking extrapolated by force",
                   *medians(places, frames, "fit", "extrapolation")),
            _below(f"{motion} tracking extrapolated by force", *medians(motions, frames, "fit", "extrapolation")),
            _below(f"{motion} a single ratio", *medians(motions, frames, "fit", "single_ratio")),
        ]  # fmt: skip
    return tuple(found)


def errors_of(one: SubjectOutcome) -> dict[str, object]:
    """A subject's errors in the validation frame, as JSON; None where there is no such frame.

    ``cobb_error_deg`` is of the Cobb angle's change between the end vertebrae of the curve at rest,
    ``cobb_error_signed_deg`` of it in the paper's form, the signed largest angle.
    """
    main, models = frames_of([one], MAIN), ("default", "fit")

    def cobb(form: Form) -> dict[str, float | None]:
        errors = {name: mean(cobb_errors(main, name, form)) for name in models}
        return {name: None if value is None else round(value, 3) for name, value in errors.items()}

    return {
        "subject": one.name,
        "rmse_mm": {name: mean(places(main, name)) for name in models},
        "cobb_error_deg": cobb("fixed_levels"),
        "cobb_error_signed_deg": cobb("signed"),
    }


def _goal(name: str, wanted: str, value: float | None, unit: str, digits: int, met: Callable[[float], bool]) -> Goal:
    if value is None:
        return Goal(name, wanted, "nothing to judge by", None)
    return Goal(name, wanted, f"{fixed(value, digits)}{unit}", bool(met(value)))


def _below(name: str, ours: float | None, others: float | None) -> Goal:
    if ours is None or others is None:
        return Goal(name, "below", "nothing to judge by", None)
    return Goal(name, f"below {fixed(others, 2)} mm", f"{fixed(ours, 2)} mm", ours < others)
