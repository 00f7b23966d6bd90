"""The paper's Tables 2 to 7 in its layout: a column a subject, ours beside the paper's."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from spinestiff.study.paper import SUBJECTS, TABLE_3, TABLE_5, TABLE_6, TABLE_7
from spinestiff.study.seven.participants import MAIN, TABLES_MESH, TISSUE_SCALE
from spinestiff.study.wording.numbers import fixed, interval
from spinestiff.subject.estimate_outcome import RatioEstimate
from spinestiff.subject.study_outcome import SubjectOutcome

PAPER, OURS, TRUTH = "paper", "ours", "truth"
NOTHING = "–"
GRADIENTS = {
    "lateral_shear": "Lateral translation k_v,x",
    "flexion_extension": "Flexion/extension k_v,α",
    "axial_rotation": "Axial rotation k_v,β",
    "intervertebral_bending": "Lateral bending k_v,γ",
    "tissue_mu": "Lamé parameter μ",
    "tissue_lambda": "Lamé parameter λ",
}
RATIOS = {"lateral_bending": "Intervertebral lateral bending k_v,γ", "tissue": "Lamé parameter μ"}
SENSITIVITY = {
    "lateral_bending": ("intervertebral_bending", "Intervertebral lateral bending"),
    "tissue": ("tissue_mu", "Lamé parameter μ"),
}
"""Our ratios, each with the paper's, by its name here and as printed."""
Values = Sequence[float | None]


@dataclass(frozen=True)
class Line:
    """A line of a table: what it tells, whose it is, a text a subject, and the average's.

    Attributes
    ----------
    values : the numbers behind the cells, None where there is none; empty for a line of words.
    mean : of those that count, and for some tables of their sizes; None: of nothing.
    """

    label: str
    whose: str
    cells: tuple[str, ...]
    average: str
    values: tuple[float | None, ...] = ()
    mean: float | None = None


@dataclass(frozen=True)
class PaperTable:
    """A table with the paper's number; columns are the subjects' heads."""

    number: int
    title: str
    columns: tuple[str, ...]
    lines: tuple[Line, ...]


Seven = Sequence[SubjectOutcome | None]
"""A place for each of the paper's subjects; None where there is no outcome yet."""


def _line(label: str, whose: str, values: Values, digits: int, absolute: bool = False, sign: bool = False) -> Line:
    """``absolute``: the average is that of the sizes, as in Tables 2, 3 and 6; ``sign``: a + before what is above 0."""
    cells = tuple(NOTHING if v is None else fixed(v, digits, sign) for v in values)
    average = _mean(values, absolute)
    shown = NOTHING if average is None else fixed(average, digits)
    return Line(label, whose, cells, shown, tuple(values), average)


def _mean(values: Values, absolute: bool) -> float | None:
    known = [abs(v) if absolute else v for v in values if v is not None]
    return float(np.mean(known)) if known else None


def _beside(
    label: str, printed: Values, ours: Line, digits: int, whose: str = PAPER, absolute: bool = False, sign: bool = False
) -> Line:
    """A line that has a number for every subject, averaged over those for which ours beside it has one, too."""
    line = _line(label, whose, printed, digits, absolute, sign)
    average = _mean([v for v, own in zip(printed, ours.values) if own is not None], absolute)
    return replace(line, average=NOTHING if average is None else fixed(average, digits), mean=average)


def _words(label: str, whose: str, values: Sequence[str | None]) -> Line:
    return Line(label, whose, tuple(v or NOTHING for v in values), NOTHING)


def _of(outcomes: Seven, value: Callable[[SubjectOutcome], float | None]) -> list[float | None]:
    return [None if one is None else value(one) for one in outcomes]


def _columns() -> tuple[str, ...]:
    return tuple(f"# {number}" for number in range(1, len(SUBJECTS) + 1))


def table_2(outcomes: Seven) -> PaperTable:
    """Who they are."""
    lines: list[Line] = []
    numbers: Mapping[str, tuple[str, int, bool, Callable[[SubjectOutcome], float]]] = {
        "Age": ("age", 0, False, lambda one: one.age),
        "Height (cm)": ("height_cm", 0, False, lambda one: one.height_cm),
        "Init Cobb (deg)": ("cobb_deg", 0, True, lambda one: one.cobb_deg),
        "Change Cobb (deg)": ("change_deg", 0, True, lambda one: one.change_deg),
        "Max force (N)": ("force_n", 0, True, lambda one: one.force_n),
    }
    words: Mapping[str, tuple[str, Callable[[SubjectOutcome], str]]] = {
        "Gender": ("sex", lambda one: one.sex),
        "Scoliosis Curve": ("curve", lambda one: one.curve),
    }
    for label in (
        "Age",
        "Gender",
        "Height (cm)",
        "Init Cobb (deg)",
        "Scoliosis Curve",
        "Change Cobb (deg)",
        "Max force (N)",
    ):
        if label in words:
            name, text = words[label]
            lines.append(_words(label, PAPER, [getattr(one, name) for one in SUBJECTS]))
            lines.append(_words(label, OURS, [None if one is None else text(one) for one in outcomes]))
        else:
            name, digits, sign, value = numbers[label]
            ours = _line(label, OURS, _of(outcomes, value), digits, True, sign)
            printed = [getattr(one, name) for one in SUBJECTS]
            lines += [_beside(label, printed, ours, digits, absolute=True, sign=sign), ours]
    return PaperTable(2, "Main characteristics of the subjects", _columns(), tuple(lines))


def table_3(outcomes: Seven) -> PaperTable:
    """Gradients of the paper's objective."""
    lines = []
    for name, label in GRADIENTS.items():
        ours = _line(label, OURS, _of(outcomes, lambda one, name=name: one.gradient[name]), 1, True)  # type: ignore[misc]
        lines += [_beside(label, TABLE_3[name], ours, 1, absolute=True), ours]
    title = f"Gradient of the objective in six parameters, at the default (ours on the {TABLES_MESH} mesh)"
    return PaperTable(3, title, _columns(), tuple(lines))


def table_4(outcomes: Seven) -> PaperTable:
    """Ratios."""
    lines = []
    printed = {"lateral_bending": [one.bending for one in SUBJECTS], "tissue": [one.tissue for one in SUBJECTS]}
    for name, label in RATIOS.items():
        scale = TISSUE_SCALE if name == "tissue" else 1.0
        found: list[RatioEstimate | None] = [None if one is None else one.ratios[name] for one in outcomes]
        ours = _line(label, OURS, [None if one is None else one.value for one in found], 3)
        lines.append(_beside(label, printed[name], ours, 2))
        lines.append(_beside(label, [scale * value for value in printed[name]], ours, 3, TRUTH))
        lines.append(ours)
        spans = tuple(NOTHING if one is None else interval(one) for one in found)
        lines.append(Line(label, "ours, 95 %", spans, NOTHING))
    return PaperTable(4, "Parameter ratios", _columns(), tuple(lines))


def _main(one: SubjectOutcome, predictor: str) -> float | None:
    frame = one.frame(MAIN)
    return None if frame is None else frame.rmse_mm.get(predictor)


def table_5(outcomes: Seven) -> PaperTable:
    """RMSE."""
    found: Mapping[str, Callable[[SubjectOutcome], float | None]] = {
        "Initial pose": lambda one: one.initial_mm,
        "Training poses, default params": lambda one: one.training_mm["default"],
        "Training poses, optimized params": lambda one: one.training_mm["fit"],
        "Validation pose, default params": lambda one: _main(one, "default"),
        "Validation pose, optimized params": lambda one: _main(one, "fit"),
    }
    lines = []
    for label, values in TABLE_5.items():
        ours = _line(label, OURS, _of(outcomes, found[label]), 2)
        lines += [_beside(label, values, ours, 2), ours]
    beside = {
        "forecast": "Validation pose, forecast",
        "extrapolation": "Validation pose, tracking extrapolated by force",
        "single_ratio": "Validation pose, a single ratio",
        "truth": "Validation pose, true ratios",
    }
    for name, label in beside.items():
        lines.append(_line(label, OURS, _of(outcomes, lambda one, name=name: _main(one, name)), 2))  # type: ignore[misc]
    return PaperTable(5, "RMSE (mm) between measured and simulated features", _columns(), tuple(lines))


def _cobb(one: SubjectOutcome, model: str, form: str) -> float | None:
    frame = one.frame(MAIN)
    change = None if frame is None else frame.cobb_deg.get(model)
    return None if change is None else float(getattr(change, form))


def table_6(outcomes: Seven) -> PaperTable:
    """Cobb angles: the paper's signed largest angle, then the same between the rest picture's end vertebrae, and the
    largest change of tilt."""
    models = {
        "Diff in validation pose (measured)": "measured",
        "Diff in validation pose (default params)": "default",
        "Diff in validation pose (optimized params)": "fit",
    }
    forms = (("signed", OURS), ("fixed_levels", "ours, fixed levels"), ("tilt", "ours, tilt"))
    lines = []
    for label, values in TABLE_6.items():
        ours = []
        if label not in models:
            ours.append(_line(label, OURS, _of(outcomes, lambda one: one.rest_cobb_deg[0]), 1, True, True))
        else:
            for form, words in forms:
                found = _of(outcomes, lambda one, form=form, model=models[label]: _cobb(one, model, form))  # type: ignore[misc]
                ours.append(_line(label, words, found, 1, True, True))
        lines += [_beside(label, values, ours[0], 0, absolute=True, sign=True), *ours]
    forecast = "Diff in validation pose (forecast)"
    for form, words in forms:
        found = _of(outcomes, lambda one, form=form: _cobb(one, "forecast", form))  # type: ignore[misc]
        lines.append(_line(forecast, words, found, 1, True, True))
    return PaperTable(6, "Cobb angle (deg)", _columns(), tuple(lines))


def table_7(outcomes: Seven) -> PaperTable:
    """Sensitivity to the force."""
    lines = []
    for name, (theirs, label) in SENSITIVITY.items():
        ours = _line(label, OURS, _of(outcomes, lambda one, name=name: one.force_percent.get(name)), 1)  # type: ignore[misc]
        lines += [_beside(label, TABLE_7[theirs], ours, 1), ours]
    title = f"Change of the ratios, %, for 10 % of force (ours on the {TABLES_MESH} mesh)"
    return PaperTable(7, title, _columns(), tuple(lines))


def paper_tables(outcomes: Seven) -> tuple[PaperTable, ...]:
    """Tables 2 to 7."""
    return tuple(make(outcomes) for make in (table_2, table_3, table_4, table_5, table_6, table_7))
