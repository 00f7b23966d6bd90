"""How much variance do residuals show in shapes that no variant of the model has? (``discrepancy``'s ``untried``)

    python benchmarks/untried.py [--rerun [--first SEED] [--count N] [--acquisition paper]] [--json]

Subjects of ``coverage_subjects`` (seeds below 1000) are fitted on the coarse mesh. At the end of each fit the residuals
are held against the covariance that was expected of them, with more or less of it ``untried``: restricted log
likelihood, p-value, the standard deviations of the log ratios and their errors. Prints the sums of what is stored, or
makes rows and adds them (about 40 CPU s a subject; needs the extra ``[mesh]``).
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from coverage_subjects import START, make_subject, seen_by
from rich.console import Console
from rich.table import Table
from scipy.linalg import cholesky, solve_triangular
from scipy.stats import chi2

import spinestiff.estimation.fit as fits
from spinestiff.errors import SpinestiffError
from spinestiff.estimation.discrepancy_data import EXPECTED, shipped_data
from spinestiff.estimation.weighed import WeighedFit, WeighedProblem
from spinestiff.study.fits import fit_pushes

RESULTS = Path(__file__).parent / "results" / "untried.json"
NAMES = ("lateral_bending", "tissue")
# Shares of the variance.
UNTRIED = tuple(0.3 * share**2 for share in (1.0, 0.5, 0.25, 0.12, 0.0))


def searched(seed: int, acquisition: Any) -> tuple[WeighedProblem, WeighedFit, Mapping[str, float], str]:
    """A subject's problem and where its search ended, with the true ratios and what else the body has."""
    subject = make_subject(seed, acquisition, 3000)
    pushes = seen_by(subject, "coarse")
    kept: list[tuple[WeighedProblem, WeighedFit]] = []
    told = fits.told

    def keeping(asked: WeighedProblem, found: WeighedFit, *others: Any) -> Any:
        kept.append((asked, found))
        return told(asked, found, *others)

    fits.told = keeping
    try:
        fit_pushes(pushes, NAMES, START, extent="estimate")
    finally:
        fits.told = told
    return *kept[-1], subject.ratios, subject.kind


def held_against(asked: WeighedProblem, found: WeighedFit, truth: Mapping[str, float], untried: float) -> list[float]:
    """Restricted log likelihood, p-value, standard deviations of both logs and their errors."""
    point, slope = found.point, found.slope
    data, shipped = shipped_data(), asked.moving._modes
    asked.moving._modes = replace(data, untried=untried).combined(EXPECTED["coarse"])
    try:
        own = asked.covariance(point)
    finally:
        asked.moving._modes = shipped
    seen = slice(0, asked.data)
    root = cholesky(own[seen, seen] + slope.nuisances[seen] @ slope.nuisances[seen].T, lower=True)
    free = point.values[seen] - slope.nuisances[seen] @ point.nuisances
    values, fixed = (solve_triangular(root, columns, lower=True) for columns in (free, slope.ratios[seen]))
    q, triangle = np.linalg.qr(fixed)
    left = values - q @ (q.T @ values)
    size = float(left @ left)
    likelihood = -0.5 * size - np.log(np.diag(root)).sum() - np.log(np.abs(np.diag(triangle))).sum()
    sds = np.sqrt(np.diag(np.linalg.inv(triangle.T @ triangle)))
    errors = point.log_ratios - np.linalg.solve(triangle, q.T @ values) - np.log([truth[name] for name in NAMES])
    # The place of a sequence counts here, as it does not in ``WeighedProblem.p_value`` since 2026-11-30.
    p_value = float(chi2.sf(size, asked.data - len(NAMES)))
    return [float(f"{value:.5g}") for value in (likelihood, p_value, *sds, *errors)]


def row_of(seed: int, acquisition: str) -> dict[str, Any]:
    """A subject's row. Raises SpinestiffError where it can't be made or fitted."""
    asked, found, truth, kind = searched(seed, acquisition)
    table = [held_against(asked, found, truth, untried) for untried in UNTRIED]
    return {"seed": seed, "acquisition": acquisition, "kind": kind, "table": table}


def show(rows: Sequence[Mapping[str, Any]]) -> None:
    """Sums and medians over the subjects."""
    found = np.array([row["table"] for row in rows])
    table = Table(title=f"{len(rows)} subjects, all of them synthetic")
    for column in ("untried", "log likelihood, sum", "median p", "rms error / sd: bending, tissue", "median sd of log"):
        table.add_column(column)
    for i, untried in enumerate(UNTRIED):
        likelihood, p_values = found[:, i, 0] - found[:, 0, 0], found[:, i, 1]
        sds, errors = found[:, i, 2:4], found[:, i, 4:6]
        sizes = np.sqrt(np.mean(np.clip(errors / sds, -5.0, 5.0) ** 2, axis=0))
        table.add_row(
            f"{untried:.2g}",
            f"{likelihood.sum():+.1f}",
            f"{np.median(p_values):.3f}",
            f"{sizes[0]:.2f}, {sizes[1]:.2f}",
            "{:.2f}, {:.2f}".format(*np.median(sds, axis=0)),
        )
    Console().print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rerun", action="store_true", help="make rows and add them to what is stored")
    parser.add_argument("--first", type=int, default=1, help="seed to begin with")
    parser.add_argument("--count", type=int, default=8)
    parser.add_argument("--acquisition", default="three pushes", choices=("three pushes", "paper"))
    parser.add_argument("--json", action="store_true", help="print what is stored")
    asked = parser.parse_args()
    rows: list[dict[str, Any]] = json.loads(RESULTS.read_text()) if RESULTS.is_file() else []
    if asked.rerun:
        for seed in range(asked.first, asked.first + asked.count):
            try:
                row = row_of(seed, asked.acquisition)
            except SpinestiffError as error:
                print(seed, error, flush=True)
                continue
            rows = [one for one in rows if (one["seed"], one["acquisition"]) != (seed, asked.acquisition)] + [row]
            RESULTS.write_text(json.dumps(rows, indent=1) + "\n")
            print(seed, row["kind"], row["table"][2], flush=True)
    if asked.json:
        print(json.dumps(rows, indent=1))
    else:
        show(rows)


if __name__ == "__main__":
    main()
