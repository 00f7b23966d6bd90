"""``spinestiff sensitivity``: how an estimate changes with what it was made from, as tables, JSON and a picture."""

from __future__ import annotations

from spinestiff.app import tables
from spinestiff.study.visit import Visit
from spinestiff.study.wording.numbers import fixed, number
from spinestiff.study.wording.sensitivity import (
    TITLES,
    change_title,
    estimator_columns,
    force_cells,
    force_rows,
    ratio_cells,
    ratio_rows,
    sensitivity_lines,
)
from spinestiff.subject.run_record import read_outcome
from spinestiff.subject.sensitivity_outcome import Sensitivity


def read_sensitivity(visit: Visit) -> Sensitivity:
    """What was found of a visit whose refits were made."""
    return read_outcome(visit.subject, Sensitivity)


def show_sensitivity(found: Sensitivity, visit: Visit) -> None:
    """Print it."""
    title = f"Refits on the {found.mesh} mesh, weighed: change of the stiffness, %"
    names = [name.replace("@", "\n@") for name in found.parameters]
    made = tables.table(title, "changed", "by", *names, left=("by",))
    for one in found.refits:
        if one.series != "weighed":
            continue
        if one.what == "nothing":
            made.add_row("as it is (ratio)", "", *[number(one.ratios.get(name)) for name in found.parameters])
            continue
        cells = [fixed(one.stiffness_percent.get(name), 1, True) for name in found.parameters]
        made.add_row(TITLES[one.what], change_title(one), *cells)
    tables.show(made)
    columns = estimator_columns(found)
    title = f"Ratios by estimator, {found.mesh} mesh (equal weights: the paper's)"
    made = tables.table(title, "estimator", *columns)
    for label, ratios in ratio_rows(found):
        made.add_row(label, *ratio_cells(ratios, columns))
    tables.show(made)
    title = "10 % of force, mean of both signs, % (paper's Table 7)"
    made = tables.table(title, "estimator", *columns)
    for label, percent in force_rows(found):
        made.add_row(label, *force_cells(percent, columns))
    tables.show(made)
    for line in sensitivity_lines(found):
        print(line)
    print(f"picture: {visit.file('sensitivity.png')}")
