"""Torsos as an estimate leaves them: with the estimated stiffness, and with draws of what it may be as well."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np

from spinestiff.anatomy.export import FORMATS, export_torso
from spinestiff.anatomy.regions import scaled_torso, torso_ratios
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.errors import SubjectError, TorsoError
from spinestiff.estimation.unknowns import RATIOS, with_unknowns
from spinestiff.files import whole_folder, write_text
from spinestiff.observer import Observer
from spinestiff.study.draws import DRAWS_FILE, read_draws
from spinestiff.study.plain import plain_stiffness
from spinestiff.study.visit import Visit
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.run_record import read_outcome, refuse_changed, result_path
from spinestiff.words import counted

TABLE = "stiffness.csv"
ESTIMATE = "estimate"
PLAIN_COLUMNS = {
    "lateral_bending_thoracic": "thoracic level, N m/rad",
    "lateral_bending_lumbar": "lumbar level, N m/rad",
    "tissue_young": "tissue, kPa",
}


@dataclass(frozen=True)
class Drawn:
    """A subject's torso at default stiffness, and the ratios of each file by its name, the estimate first.

    They are those that were estimated, and what was found with them of unknowns that are ratios themselves
    (``estimation.unknowns.RATIOS``).
    """

    torso: TorsoModel
    ratios: Mapping[str, Mapping[str, float]]


def drawn_ratios(visit: Visit, draws: int) -> Drawn:
    """The estimate, and so many of its equally probable draws, spread over all of them.

    Raises
    ------
    SubjectError : there is no estimate, it is out of date, or has fewer draws.
    """
    subject = visit.subject
    refuse_changed(subject, "personalise", "estimate")
    estimate = read_outcome(subject, Estimate)
    beside = [one for one in estimate.nuisances if one.name in RATIOS.values()]
    found = {ESTIMATE: with_unknowns(estimate.values, {one.name: one.value for one in beside})}
    if draws:
        if estimate.method != "weighed":
            raise SubjectError(
                f"{visit.file(Estimate.FILE)}: is by the paper's method, which has no draws; leave out --draws, or run "
                "spinestiff estimate with --method weighed"
            )
        names = [*estimate.parameters, *(one.name for one in beside)]
        known = read_draws(result_path(subject, DRAWS_FILE, "estimate"), names)
        if draws > len(known):
            raise SubjectError(f"{subject.folder}: has {counted(len(known), 'draw')}; wanted {draws}")
        rows = np.linspace(0, len(known) - 1, draws).round().astype(int)
        for number, row in enumerate(known[rows].tolist(), 1):
            ratios, standard = dict(zip(estimate.parameters, row)), row[len(estimate.parameters) :]
            logs = {one.name: one.prior_sd * value for one, value in zip(beside, standard)}
            found[f"draw-{number:03d}"] = with_unknowns(ratios, logs)
    return Drawn(visit.torso(), found)


def export_drawn(drawn: Drawn, folder: Path, kind: str, say: Observer) -> None:
    """Write a torso a draw for another program, and ``stiffness.csv`` with the ratios and the stiffness of each.

    Raises
    ------
    TorsoError : a format without stiffness, a package that is missing, or the folder is not empty or can't be written;
        then nothing is left there.
    """
    check_format(kind)
    table = StringIO()
    rows = csv.writer(table, lineterminator="\n")
    rows.writerow(["file", *next(iter(drawn.ratios.values())), *PLAIN_COLUMNS.values()])
    with whole_folder(folder, TorsoError) as draft:
        for name, ratios in drawn.ratios.items():
            file = f"{name}{FORMATS[kind].suffix}"
            say(f"export: {file}")
            export_torso(scaled_torso(drawn.torso, ratios), draft / file, kind)
            plain = plain_stiffness(drawn.torso, torso_ratios(drawn.torso, ratios), {})
            values = [*ratios.values(), *(plain[key].value for key in PLAIN_COLUMNS)]
            rows.writerow([file, *(f"{value:.6g}" for value in values)])
        write_text(draft / TABLE, table.getvalue())


def check_format(kind: str) -> None:
    """Raise TorsoError where a format has no stiffness that draws could differ in."""
    if kind not in FORMATS or not FORMATS[kind].has_stiffness:
        able = ", ".join(name for name, found in FORMATS.items() if found.has_stiffness)
        raise TorsoError(f"format '{kind}' has no stiffness to draw; formats with stiffness are {able}")
