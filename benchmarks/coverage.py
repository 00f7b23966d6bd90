"""Do the intervals hold? Subjects of known stiffness, made and estimated by corners alone (``coverage_subjects.py``).

    python benchmarks/coverage.py --acquisition paper --first 0 --count 60 --log FILE
    python benchmarks/coverage.py --summary FILE...

The first makes and estimates subjects and writes one line each as it goes; a log that exists is gone on with. The
second prints how often the truth lies inside, by ratio and jointly, for closed and for open intervals, with the
standard errors of so many subjects. All of it is synthetic.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

if __name__ == "__main__":
    sys.modules["coverage"] = None  # type: ignore[assignment]
else:
    raise ImportError("a command, not the package of this name that numba looks for")

import numpy as np
from coverage_subjects import Acquisition, make_subject
from rich.console import Console
from rich.table import Table
from scipy.stats import chi2, norm

from spinestiff.anatomy.template import template_torso
from spinestiff.errors import SpinestiffError
from spinestiff.estimation.fit import StiffnessFit
from spinestiff.estimation.priors import Priors
from spinestiff.personalise.shape import personalise
from spinestiff.study.assessment import assess
from spinestiff.study.forecasts import forecasts
from spinestiff.study.predictions import Model, predict
from spinestiff.study.trials import Known, fit_pushes, push_set

NAMES = ("lateral_bending", "tissue")
START = {"lateral_bending": 0.07, "tissue": 0.04}


def run_one(seed: int, acquisition: Acquisition, nodes: int, mesh: str) -> dict[str, Any]:
    """A subject made and estimated, as a line of the log."""
    row: dict[str, Any] = {"seed": seed, "acquisition": acquisition, "nodes": nodes, "mesh": mesh}
    began = time.process_time()
    try:
        subject = make_subject(seed, acquisition, nodes)
    except SpinestiffError as error:
        return {**row, "not made": str(error)}
    row |= {"ratios": dict(subject.ratios), "kind": subject.kind, "cobb_deg": round(subject.cobb_deg, 1)}
    row |= {"made_cpu_s": round(time.process_time() - began, 1)}
    began = time.process_time()
    try:
        template = template_torso(subject.height_cm, mesh, age_years=subject.age, sex=subject.sex)
        shaped = personalise(template, subject.rest)
        known = Known(Priors(), shaped.covariance)
        pushes = push_set(shaped.torso, subject.records, subject.tracked, known=known)
        fit = fit_pushes(pushes, NAMES, START, extent="intervals")
        row |= told(fit, subject.ratios)
        predictions = predict(pushes, {"default": Model(), "fit": Model.of(fit)}, {}, lambda line: None, ("default",))
        if fit.weighed is not None and fit.status.usable:
            factor = fit.weighed.tracking_factor
            expected = forecasts(predictions, fit.ratios.as_dict(), fit.standard_nuisances, factor)
            row["held_out"] = [
                {"fit_mm": frame.rmse_mm["fit"], **({} if frame.forecast is None else frame.forecast.model_dump())}
                for frame in assess(predictions, expected)
            ]
    except SpinestiffError as error:
        row["failed"] = str(error)
    return {**row, "cpu_s": round(time.process_time() - began, 1)}


def told(fit: StiffnessFit, truth: dict[str, float] | Any) -> dict[str, Any]:
    """What is asked of an estimate whose truth is known."""
    likely, weighed = fit.likely, fit.weighed
    if likely is None or weighed is None:
        return {"status": fit.status.name}
    at = np.log([truth[name] for name in NAMES])
    best = np.log(fit.ratios.values)
    rises = []
    for i, profile in enumerate(likely.profiles):
        inside = profile.log_ratios[0] <= at[i] <= profile.log_ratios[-1]
        rises.append(float(np.interp(at[i], profile.log_ratios, profile.rise)) if inside else float("inf"))
    joint = float(likely.emulator.phi(at)[0] - likely.emulator.phi(best)[0])
    return {
        "status": fit.status.name,
        "estimate": fit.ratios.as_dict(),
        "low": np.exp(likely.low).tolist(),
        "high": np.exp(likely.high).tolist(),
        "open": (likely.open_low | likely.open_high).tolist(),
        "kinds": list(likely.kinds),
        # Signed root of twice the rise at the truth: a standard normal number, if all is well.
        "z": [float(np.sign(a - b) * np.sqrt(2.0 * max(r, 0.0))) for a, b, r in zip(best, at, rises)],
        "sd": np.sqrt(np.diag(fit.covariance)).tolist(),
        "offset": (best - at).tolist(),
        "joint": 2.0 * joint,
        "p_value": weighed.p_value,
        "tracking_factor": weighed.tracking_factor,
        "outlying": len(weighed.outlying),
        "rmse_mm": fit.rmse_mm,
        "evaluations": len(fit.history),
        "factorisations": fit.cost.factorisations,
    }


def summary(rows: list[dict[str, Any]]) -> None:
    """Coverage with its standard error, bias over sd, and width."""
    made = [row for row in rows if "not made" not in row]
    found = [row for row in made if "z" in row]
    console = Console(width=160)
    console.print(
        f"{len(rows)} seeds, {len(made)} made, {len(found)} estimated, {sum('failed' in r for r in made)} failed"
    )
    table = Table(title="all of it synthetic")
    for column in ("ratio", "intervals", "subjects", "68 %", "95 %", "99.9 %", "bias / sd", "sd of z", "median factor"):
        table.add_column(column)
    for i, name in enumerate(NAMES):
        for kind, chosen in (
            ("all", found),
            ("closed", [row for row in found if not row["open"][i]]),
            ("open", [row for row in found if row["open"][i]]),
        ):
            if not chosen:
                continue
            z = np.array([row["z"][i] for row in chosen])
            width = np.array([np.sqrt(row["high"][i] / row["low"][i]) for row in chosen])
            shares = [_share(np.abs(z) < norm.ppf(0.5 + 0.5 * level)) for level in (0.68, 0.95, 0.999)]
            finite = np.clip(z, -10.0, 10.0)
            numbers = f"{np.median(finite):+.2f}", f"{np.std(finite):.2f}", f"{np.median(width):.2f}"
            table.add_row(name, kind, str(len(chosen)), *shares, *numbers)
    joint = np.array([row["joint"] for row in found])
    levels = [_share(joint < chi2.ppf(level, 2)) for level in (0.68, 0.95, 0.999)]
    table.add_row("both", "joint region", str(len(found)), *levels, "", "", "")
    console.print(table)
    held_out = [frame for row in found for frame in row.get("held_out", []) if "inside95" in frame]
    if held_out:
        corners = np.mean([frame["inside95"] for frame in held_out])
        turns = [(f["cobb_error_deg"], f["cobb_sd_deg"]) for f in held_out if f["cobb_sd_deg"] is not None]
        cobb = _share(np.array([abs(error) < norm.ppf(0.975) * sd for error, sd in turns]))
        fitted, expected = (np.median([frame[key] for frame in held_out]) for key in ("fit_mm", "rmse_mm"))
        console.print(
            f"held-out frames, 95 % intervals: {100.0 * corners:.1f} % of corners of {len(held_out)} frames, "
            f"{cobb} % of Cobb changes; median RMSE {expected:.2f} mm expected, {fitted:.2f} mm by the model alone"
        )
    for key in ("evaluations", "factorisations", "cpu_s", "p_value", "tracking_factor", "rmse_mm"):
        values = [row[key] for row in found if key in row]
        if values:
            quantiles = np.quantile(values, (0.0, 0.05, 0.5, 0.95, 1.0))
            console.print(
                f"{key}: " + ", ".join(f"{value:.3g}" for value in quantiles) + " (least, 5 %, median, 95 %, most)"
            )


def _share(inside: np.ndarray) -> str:
    share = float(np.mean(inside))
    return f"{100.0 * share:.1f} ± {100.0 * np.sqrt(share * (1.0 - share) / len(inside)):.1f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--acquisition", choices=["paper", "three pushes"], default="paper")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--nodes", type=int, default=3000, help="of the truth's mesh")
    parser.add_argument("--mesh", choices=["coarse", "fine"], default="coarse", help="of the estimator")
    parser.add_argument("--log", type=Path)
    parser.add_argument("--summary", type=Path, nargs="+")
    asked = parser.parse_args()
    if asked.summary:
        summary([json.loads(line) for path in asked.summary for line in path.read_text().splitlines()])
        return
    if asked.log is None:
        parser.error("--log FILE is wanted: every subject is written as it is done")
    done = [json.loads(line) for line in asked.log.read_text().splitlines()] if asked.log.is_file() else []
    known = {row["seed"] for row in done}
    for seed in range(asked.first, asked.first + asked.count):
        if seed in known:
            continue
        row = run_one(seed, asked.acquisition, asked.nodes, asked.mesh)
        with asked.log.open("a") as log:
            log.write(json.dumps(row) + "\n")
        print(seed, row.get("not made") or row.get("failed") or row.get("z"), row.get("cpu_s"), flush=True)


if __name__ == "__main__":
    main()
