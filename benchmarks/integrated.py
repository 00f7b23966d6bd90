"""Nuisances integrated out or at their most probable: around which of the two does a likelihood lie rightly?

    python benchmarks/integrated.py --log FILE [--first SEED] [--people 12] [--draws 1000]
    python benchmarks/integrated.py --summary FILE... [--write]
    python benchmarks/integrated.py --json

A person of ``coverage_subjects`` is pushed at three ribs and estimated on the coarse mesh, which is the truth's, too.
The estimate's emulator then is a model by itself: residuals over the log ratios, linear in the nuisances. At the
estimate's ratios, taken as true, nuisances are drawn from their priors and errors from the covariance, and phi and psi
(``estimation.weighed``) are found on a grid around, without an equilibrium. Beside the draws, the person's own corners,
which have all the errors of ``coverage.py``, are compared with the true ratios in the same way. So are draws of which
all nuisances and errors are made smaller than the estimate takes them to be, down to none.

z of a ratio is the signed root of twice the rise of its profile at the truth: its mean is the bias in standard
deviations, and 95 % of |z| should lie below 1.96. A person takes about 60 CPU s, 1,000 draws 40 s more.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from counted_intervals import NAMES
from coverage_subjects import START, make_subject, seen_by
from kept_rows import ROOT, asked_for, begun, code, keep
from scipy.interpolate import CubicSpline
from scipy.linalg import solve_triangular

from spinestiff.anatomy.stiffness import RATIO_BOUNDS
from spinestiff.arrays import Floats
from spinestiff.errors import SpinestiffError
from spinestiff.estimation.emulator import Emulator
from spinestiff.study.fits import fit_pushes

RESULTS = ROOT / "benchmarks" / "results" / "integrated.json"
FIRST = 41000
KINDS = ("most probable", "integrated out")
INSIDE = 1.96
# Errors over what the estimate takes them to be, and draws of each; without any all draws are the same.
SMALLER, FEW_DRAWS = (0.75, 0.5, 0.0), 300
# The grid: to so many of the estimate's standard deviations either way, in so many places; a profile is read between
# them by a spline.
REACH, PLACES, BETWEEN = 4.5, 21, 301


def drawn_z(
    emulator: Emulator, truth: Floats, sds: Floats, draws: int, random: np.random.Generator, sizes: Floats | float = 1.0
) -> Floats:
    """(2, P, draws) z of each ratio, with the most probable nuisances and with nuisances integrated out.

    Parameters
    ----------
    truth : (P,) log ratios. sds : (P,) of the grid around.
    sizes : (draws,) or of all, of nuisances and errors over what the estimate takes them to be.
    """
    axes = _axes(truth, truth, sds)
    free, columns = (part[0] for part in emulator.residuals(truth))
    wrong = columns @ random.normal(size=(columns.shape[1], draws)) + random.normal(size=(len(free), draws))
    shown = free[:, None] + sizes * wrong
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(truth))
    phi, precision = np.empty((len(grid), draws)), np.empty(len(grid))
    for row, where in enumerate(grid):
        free, columns = (part[0] for part in emulator.residuals(where))
        left = free[:, None] - shown
        root = np.linalg.cholesky(np.eye(columns.shape[1]) + columns.T @ columns)
        taken = solve_triangular(root, columns.T @ left, lower=True)
        phi[row] = 0.5 * (np.sum(left**2, axis=0) - np.sum(taken**2, axis=0))
        precision[row] = np.log(np.diag(root)).sum()
    shape = (*(len(axis) for axis in axes), draws)
    heights = [phi.reshape(shape), (phi + precision[:, None]).reshape(shape)]
    return np.array([[_signed_roots(axes, height, i, truth[i]) for i in range(len(truth))] for height in heights])


def own_z(emulator: Emulator, best: Floats, truth: Floats, sds: Floats) -> Floats:
    """(2, P) z of each ratio as the person's own radiographs have it, of the two kinds."""
    axes = _axes(best, truth, sds)
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(truth))
    heights = [read(grid).reshape(*(len(axis) for axis in axes), 1) for read in (emulator.phi, emulator.psi)]
    return np.array([[_signed_roots(axes, height, i, truth[i])[0] for i in range(len(truth))] for height in heights])


def _axes(centre: Floats, held: Floats, sds: Floats) -> list[Floats]:
    """Of a grid in log ratios about a centre, as wide that it holds another place."""
    reach = REACH * sds + np.abs(held - centre)
    lines = centre[:, None] + reach[:, None] * np.linspace(-1.0, 1.0, PLACES)
    return [np.unique(np.clip(line, *np.log(RATIO_BOUNDS))) for line in lines]


def _signed_roots(axes: Sequence[Floats], height: Floats, i: int, truth: float) -> Floats:
    """(draws,) of twice the rise at the truth of ratio i's profile, positive where its least lies above the truth."""
    profile = height.min(axis=tuple(j for j in range(len(axes)) if j != i))
    spline, between = CubicSpline(axes[i], profile), np.linspace(axes[i][0], axes[i][-1], BETWEEN)
    read = spline(between)
    rise = np.maximum(spline(truth) - read.min(axis=0), 0.0)
    return np.asarray(np.sign(between[np.argmin(read, axis=0)] - truth) * np.sqrt(2.0 * rise))


def run_one(seed: int, draws: int) -> dict[str, Any]:
    """A person as a line of the log."""
    began = time.process_time()
    row: dict[str, Any] = {"seed": seed, "draws": draws, "code": code()}
    try:
        subject = make_subject(seed, "three pushes", None)
        fit = fit_pushes(seen_by(subject, "coarse"), NAMES, START, extent="intervals")
    except SpinestiffError as error:
        return {**row, "not made": str(error)}
    likely = fit.likely
    if likely is None:
        return {**row, "not made": fit.status.value}
    sds = (likely.high - likely.low) / (2.0 * INSIDE)
    best, truth = np.log(fit.ratios.values), np.log([subject.ratios[name] for name in NAMES])
    z = drawn_z(likely.emulator, best, sds, draws, np.random.default_rng([41, seed]))
    few = np.repeat(SMALLER, [FEW_DRAWS if size else 1 for size in SMALLER])
    smaller = drawn_z(likely.emulator, best, sds, len(few), np.random.default_rng([43, seed]), few)[1]
    row["smaller errors"] = {f"{size:g}": smaller[:, few == size].mean(axis=1).tolist() for size in SMALLER}
    for kind, own, persons in zip(KINDS, z, own_z(likely.emulator, best, truth, sds)):
        row[kind] = {
            "own_z": persons.tolist(),
            "mean_z": own.mean(axis=1).tolist(),
            "sd_of_z": own.std(axis=1).tolist(),
            "inside95": (np.abs(own) < INSIDE).mean(axis=1).tolist(),
        }
    return {**row, "ratios": fit.ratios.as_dict(), "cpu_s": round(time.process_time() - began, 1)}


def _over_people(each: Sequence[Any]) -> dict[str, list[float | None]]:
    """By ratio the mean and its standard error, which one person alone has not."""
    values = np.array(each)
    errors = values.std(axis=0, ddof=1) / np.sqrt(len(values)) if len(values) > 1 else [None] * values.shape[1]
    means = values.mean(axis=0)
    return {
        name: [round(float(mean), 4), None if error is None else round(float(error), 4)]
        for name, mean, error in zip(NAMES, means, errors)
    }


def summed_up(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Means over people, with the standard errors of so many people. Ends the program where there is none."""
    found = [row for row in rows if KINDS[0] in row]
    if not found:
        raise SystemExit("no row has figures; nothing was written")
    result: dict[str, Any] = {"people": len(found), "draws": sum(row["draws"] for row in found)}
    for kind in KINDS:
        keys = ("mean_z", "sd_of_z", "inside95", "own_z")
        result[kind] = {key: _over_people([row[kind][key] for row in found]) for key in keys}
    result["smaller errors, mean z"] = {
        f"{size:g}": _over_people([row["smaller errors"][f"{size:g}"] for row in found]) for size in SMALLER
    }
    moved = [np.subtract(row[KINDS[1]]["own_z"], row[KINDS[0]]["own_z"]) for row in found]
    result["own_z_moved"] = _over_people(moved)
    return {**result, "code": sorted({row["code"] for row in found})}


def main() -> None:
    asked = asked_for(__doc__, RESULTS, summed_up, first=FIRST, people=12, draws=1000)
    if asked is None:
        return
    done = {row["seed"] for row in begun(asked.log)}
    for seed in range(asked.first, asked.first + asked.people):
        if seed not in done:
            row = run_one(seed, asked.draws)
            keep(asked.log, row)
            print(seed, row.get("not made") or {kind: row[kind]["mean_z"] for kind in KINDS}, flush=True)


if __name__ == "__main__":
    main()
