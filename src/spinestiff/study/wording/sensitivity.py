"""Refits of an estimate in words."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from spinestiff.anatomy.regions import AT
from spinestiff.anatomy.stiffness import INTERVERTEBRAL_BENDING as BENDING
from spinestiff.study.paper import TABLE_7
from spinestiff.study.sensitivity import PAPER_SERIES
from spinestiff.study.wording.numbers import fixed, listed, number
from spinestiff.subject.sensitivity_outcome import Change, Refit, Sensitivity, Series

TITLES: Mapping[Change, str] = {
    "force": "force ±10 %",
    "push level": "push level ±1 rib",
    "corners": "corners' orientation",
    "mesh": "mesh",
    "default modulus": "default modulus ±20 %",
    "geometry": "rest geometry ±1 sd",
}
"""Of what was changed, in the order in which it is changed."""
SERIES: Mapping[Series, str] = {
    "weighed": "weighed, the estimate's ratios",
    "tied": "equal weights, lambda tied to mu",
    "kept": "equal weights, lambda kept at its default",
    "everything": "equal weights, one ratio for every stiffness",
}
# Of two sensitivities, from which one counts as larger.
LARGER = 1.25
# Share of what the force does, up to which it does not matter where a search begins.
LOOSE = 0.5
# Of a change that another one is compared with.
LEAST_PERCENT = 0.1


def change_title(refit: Refit) -> str:
    """By how much, as short as a bar's label is: "+10 %", "+1 rib", "covariance"."""
    if refit.what == "push level":
        return "+1 rib" if refit.by.endswith("lower") else "−1 rib"
    return refit.by.removesuffix(" of its leading mode")


def tornado_rows(found: Sensitivity) -> list[tuple[str, tuple[Refit, ...]]]:
    """What was changed with its refits by the weighed fit, the largest change of a stiffness first."""
    rows = []
    for what, title in TITLES.items():
        own = [one for one in found.refits if (one.series, one.what) == ("weighed", what)]
        refits = tuple(one for one in own if one.stiffness_percent)
        if refits:
            rows.append((title, refits))
    return sorted(rows, key=lambda row: -largest(row[1]))


def largest(refits: Sequence[Refit]) -> float:
    """The largest change of a stiffness among refits, percent."""
    return float(max(abs(value) for one in refits for value in one.stiffness_percent.values()))


def table_7_average(name: str) -> float:
    """Mean over the paper's subjects, percent."""
    return float(np.mean(TABLE_7[name]))


def force_rows(found: Sensitivity) -> list[tuple[str, dict[str, float]]]:
    """Table 7: what was fitted, and the percent of each ratio for 10 % of force; the paper's average last.

    Of ratios of a part each has a row of its own, in the column of its group.
    """
    known = found.force_percent
    rows = [row for series in SERIES if series in known for row in _by_part(SERIES[series], known[series])]
    paper = {name: table_7_average(name) for name in TABLE_7}
    return [*rows, ("Koutras et al. 2025, mean of seven subjects", paper)]


def ratio_rows(found: Sensitivity) -> list[tuple[str, dict[str, float]]]:
    """The estimate of the same frames on the same mesh by each estimator, the paper's (equal weights) among them; rows
    as of ``force_rows``."""
    same = [one for one in found.refits if one.what == "nothing" and one.ratios]
    return [row for one in same for row in _by_part(SERIES[one.series], one.ratios)]


def _by_part(label: str, values: Mapping[str, float]) -> list[tuple[str, dict[str, float]]]:
    whole = {name: value for name, value in values.items() if AT not in name}
    parts = [(f"{label.partition(',')[0]}, {name}", {name: values[name]}) for name in values if AT in name]
    return [(label, whole), *parts] if whole else parts


_COLUMNS: Mapping[str, tuple[str, ...]] = {
    "bending": ("lateral_bending", BENDING),
    "tissue": ("tissue", "tissue_mu"),
    "everything": ("everything",),
}


def estimator_columns(found: Sensitivity) -> dict[str, tuple[str, ...]]:
    """Of tables by estimator, with the groups whose ratios stand in one column: the paper's, then all others that were
    estimated."""
    usual = {group for groups in _COLUMNS.values() for group in groups}
    groups = dict.fromkeys(name.partition(AT)[0] for name in found.parameters)
    return {**_COLUMNS, **{group.replace("_", " "): (group,) for group in groups if group not in usual}}


def force_cells(percent: Mapping[str, float], columns: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
    """A row of the table of forces."""
    return _cells(percent, columns, fixed)


def ratio_cells(ratios: Mapping[str, float], columns: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
    """A row of the table of ratios."""
    return _cells(ratios, columns, number)


def _cells(
    values: Mapping[str, float], columns: Mapping[str, tuple[str, ...]], shown: Callable[[float], str]
) -> tuple[str, ...]:
    told = {name.partition(AT)[0]: shown(value) for name, value in values.items()}
    return tuple(next((told[group] for group in groups if group in told), "") for groups in columns.values())


def sensitivity_lines(found: Sensitivity) -> list[str]:
    """What the refits say, in sentences."""
    lines = []
    rows = tornado_rows(found)
    if rows:
        moved = [name for name in found.parameters if any(name in one.percent for _, own in rows for one in own)]
        each = [_largest(name, rows) for name in moved]
        lines.append(f"largest change of each stiffness: {'; '.join(each)}")
    intervals = [
        f"{name} {'≤ ' if low else ''}{_apart(ends[0], value)} to {'≥ ' if high else ''}{_apart(ends[1], value)}"
        for name, value in found.estimate.items()
        for ends, (low, high) in [(found.interval95.get(name), found.open_ends.get(name, (False, False)))]
        if ends is not None
    ]
    if intervals:
        lines.append(f"for comparison, the estimate's own 95 % interval about its value: {'; '.join(intervals)}")
    modulus = [one for one in found.refits if one.what == "default modulus" and one.ratios]
    for one in modulus[-1:]:
        for name, percent in one.percent.items():
            if abs(percent - one.stiffness_percent[name]) > 0.5:
                lines.append(
                    f"another default modulus changes what a ratio is a ratio to: {one.by} changes {name} by "
                    f"{fixed(percent, 0, True)} %, and its stiffness in kPa by "
                    f"{fixed(one.stiffness_percent[name], 1, True)} %"
                )
    lines += force_lines(found)
    failed = [one for one in found.refits if not one.ratios]
    lines += [f"no estimate with {_shown(one)}: {one.note}" for one in failed]
    bounded = [one for one in found.refits if one.at_bound]
    lines += [f"{', '.join(one.at_bound)} at a bound of the fit with {_shown(one)}" for one in bounded]
    return [*lines, *(f"note: {note}" for note in found.notes)]


def _largest(name: str, rows: Sequence[tuple[str, tuple[Refit, ...]]]) -> str:
    refits = [one for _, own in rows for one in own if name in one.stiffness_percent]
    most = max(refits, key=lambda one: abs(one.stiffness_percent[name]))
    return f"{name} {fixed(most.stiffness_percent[name], 0, True)} % ({_shown(most)})"


def _apart(one: float, other: float) -> str:
    return f"{fixed(100.0 * (one / other - 1.0), 0, True)} %"


def _shown(one: Refit) -> str:
    what = "nothing changed" if one.what == "nothing" else f"{one.what} {one.by}".strip()
    return what if one.series == "weighed" else f"{what}, {SERIES[one.series]}"


def force_lines(found: Sensitivity) -> list[str]:
    """Why 10 % of force is as many percent of stiffness as it is."""
    known, lines = found.force_percent, []
    if "everything" in known:
        (name,) = PAPER_SERIES["everything"]
        lines.append(
            f"with every stiffness scaled, 10 % of force is {fixed(known['everything'][name])} % of stiffness: force "
            "and stiffness enter an equilibrium by their ratio alone"
        )
    if "weighed" in known:
        each = listed(f"{name} {fixed(percent)} %" for name, percent in known["weighed"].items())
        lines.append(
            "ratios that don't scale everything (rib cage, girdle, other directions of the spine's joints stay) make "
            f"up for the rest between them: by the weighed fit {each}"
        )
    if "tied" in known and "kept" in known:
        lines += _lambda_lines(found)
    return lines


def _lambda_lines(found: Sensitivity) -> list[str]:
    """What a lambda that stays at its default does, by equal weights."""
    tied, kept = found.force_percent["tied"], found.force_percent["kept"]
    paper = f"(the paper: bending {fixed(table_7_average(BENDING))} %, mu {fixed(table_7_average('tissue_mu'))} %)"
    both = (
        f"by equal weights bending {fixed(tied[BENDING])} % and tissue {fixed(tied['tissue'])} % with lambda tied to "
        f"mu, bending {fixed(kept[BENDING])} % and mu {fixed(kept['tissue_mu'])} % with lambda kept at its default "
        f"{paper}"
    )
    loose = [one for one in found.refits if one.what == "start" and _is_loose(one, found.force_percent[one.series])]
    if loose:
        ends = [
            f"{SERIES[one.series]}: a search begun at other ratios ends elsewhere, "
            f"{listed(f'{name} {fixed(value, 0, True)} %' for name, value in one.percent.items())}, so that its row is "
            "known no better than that"
            for one in loose
        ]
        return [both, *ends, "what a lambda that stays does to mu's sensitivity can't be told here by equal weights"]
    of_mu = _times(kept["tissue_mu"], tied["tissue"])
    of_bending = _times(kept[BENDING], tied[BENDING])
    if of_mu > LARGER:
        verdict = "a lambda that stays makes mu more sensitive here"
    elif of_mu < 1.0 / LARGER:
        verdict = "a lambda that stays makes mu less sensitive here"
    else:
        verdict = "a lambda that stays hardly changes how sensitive mu is here"
    verdict += f", {number(of_mu, 2)} times tissue's with lambda tied"
    if of_bending > LARGER:
        verdict += ", and bending more: it takes over what lambda does not follow"
    elif of_bending < 1.0 / LARGER:
        verdict += ", and bending less"
    return [both, verdict]


def _is_loose(again: Refit, force: Mapping[str, float]) -> bool:
    """Whether where a search begins moves a ratio by more than half of what 10 % of force does to it."""
    return any(abs(value) > LOOSE * force.get(name, 0.0) for name, value in again.percent.items())


def _times(one: float, other: float) -> float:
    return one / max(other, LEAST_PERCENT)
