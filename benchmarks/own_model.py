"""Are intervals right where nothing is wrong but what an estimate allows for? Radiographs drawn from its own model.

    python benchmarks/own_model.py --log FILE [--first SEED] [--people 40]
    python benchmarks/own_model.py --summary FILE... [--write]
    python benchmarks/own_model.py --json

A person of ``coverage_subjects`` is pushed as the paper has it, at three ribs of one side, or from both sides, and
shaped. Then the measured corners are thrown away, and others are drawn: at the person's true ratios, every unknown of
the estimate from its prior, and every error from the covariance that the estimate has at that place, model discrepancy
among them. So the truth is a member of just what an estimate believes. Where the person stood for a sequence is left as
it was seen: its prior is wide, and a view is placed anew before an estimate sees it.

Intervals are counted as those of ``coverage.py`` are (``counted_intervals.py``). If they hold the truth here and not
there, then the subjects there bring errors that the estimate does not expect, and it is not its approximations that
fail. A log that exists is gone on with; needs the extra ``[mesh]``. A draw takes
11 to 36 CPU s with the paper's acquisition.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from counted_intervals import NAMES, countable, summarised
from coverage_subjects import COARSE_NODES, START, Acquisition, make_subject, seen_by
from kept_rows import asked_for, begun, code, keep
from told_intervals import solved_at_truth, told

from spinestiff.anatomy.regions import parameter_groups
from spinestiff.arrays import Floats
from spinestiff.errors import SpinestiffError
from spinestiff.estimation.asked import weighed_problem
from spinestiff.estimation.objective import residuals
from spinestiff.estimation.profiles import WIDTH_FACTOR
from spinestiff.estimation.weighed import WeighedProblem
from spinestiff.imaging.features import VertebraCorners
from spinestiff.study.fits import fit_pushes
from spinestiff.study.trials import PushSet

RESULTS = Path(__file__).parent / "results" / "own_model.json"
ACQUISITIONS: tuple[Acquisition, ...] = ("paper", "three pushes", "both sides")
FIRST, NODES = 71000, COARSE_NODES
NUISANCES_BY = (0.0, 0.5, 1.0)  # shares of the drawn unknowns, on the way to their equilibria


@dataclass(frozen=True)
class Asked:
    """A person's pushes, the true log ratios and Cobb angle, and the estimate's own model of the pushes."""

    pushes: PushSet
    log_ratios: Floats
    cobb_deg: float
    problem: WeighedProblem


def asked_of(seed: int, acquisition: Acquisition) -> Asked:
    """Raises SpinestiffError where there is no such person."""
    subject = make_subject(seed, acquisition, NODES)
    return asked_with(seen_by(subject, "coarse"), subject.ratios, subject.cobb_deg)


def asked_with(pushes: PushSet, ratios: Mapping[str, float], cobb_deg: float) -> Asked:
    """The estimate's own model of pushes at true ratios."""
    groups = parameter_groups(pushes.torso, NAMES)
    problem = weighed_problem(*pushes.posed(pushes.fitted), groups, pushes.orientation, None, pushes.known)
    return Asked(pushes, np.log([ratios[name] for name in NAMES]), cobb_deg, problem)


def drawn(asked: Asked, random: np.random.Generator) -> PushSet:
    """What the estimate is made from, those under load first, with corners as the estimate's own model draws them."""
    problem, noise = asked.problem, asked.problem.noise
    unknowns = random.normal(size=len(problem.unknowns))
    point, slope = None, None
    for share in NUISANCES_BY:
        point = problem.solve(asked.log_ratios, share * unknowns, point, slope)
        slope = problem.slope(point)
    assert point is not None
    covariance = problem.covariance(point)[: noise.size, : noise.size] - noise.parts["stance"]
    values, vectors = np.linalg.eigh(covariance)
    errors = vectors @ (np.sqrt(np.maximum(values, 0.0)) * random.normal(size=noise.size))
    found = []
    for number, seen in enumerate(noise.seen):
        target, channels, own = seen.target, noise.boxes(number), noise.of(number)
        torso = asked.pushes.torso
        part = (
            point.evaluation.residuals[number]
            if number < len(point.evaluation.residuals)
            else residuals(torso, target, torso.rest_pose)
        )
        # Beside how far the model lies from what was measured: what unknowns do to the picture alone, and the errors.
        more = point.values[own] - channels.apply(part.difference) - errors[own]
        z = target.z + part.difference + np.einsum("vcki,vc->vki", channels.basis, more.reshape(-1, channels.each))
        trial, corners = target.trial, target.trial.corners
        there = corners.corners.copy()
        rows = [corners.vertebrae.index(torso.vertebrae[row]) for row in target.rows]
        there[rows] = trial.view.from_patient_plane(z)
        found.append(replace(trial, corners=VertebraCorners(corners.vertebrae, there, corners.quality)))
    fitted = asked.pushes.fitted
    return replace(asked.pushes, trials=tuple(replace(item, trial=trial) for item, trial in zip(fitted, found)))


def run_one(seed: int, acquisition: Acquisition, asked: Asked) -> dict[str, Any]:
    """An estimate from drawn corners, as a line of the log."""
    truth = dict(zip(NAMES, np.exp(asked.log_ratios).round(6).tolist()))
    row: dict[str, Any] = {"seed": seed, "acquisition": acquisition, "ratios": truth, "kind": ""}
    row |= {"cobb_deg": round(asked.cobb_deg, 1), "code": code(), "width_factor": WIDTH_FACTOR}
    began = time.process_time()
    try:
        pushes = drawn(asked, np.random.default_rng([5, seed, ACQUISITIONS.index(acquisition)]))
        fit = fit_pushes(pushes, NAMES, START, extent="intervals")
        row |= told(fit, truth)
        row |= solved_at_truth(pushes, fit, truth)
    except SpinestiffError as error:
        row["failed"] = str(error)
    return {**row, "cpu_s": round(time.process_time() - began, 1)}


def summed_up(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """How often intervals hold the truth, by acquisition. Ends the program where no row has an interval to count."""
    if not any("z" in row for row in rows):
        raise SystemExit("no row has an interval to count; nothing was written (rows of an older program have none)")
    found = {name: countable([row for row in rows if row["acquisition"] == name]) for name in ACQUISITIONS}
    return {"acquisitions": [summarised(name, own) for name, own in found.items() if any("z" in row for row in own)]}


def main() -> None:
    asked = asked_for(__doc__, RESULTS, summed_up, first=FIRST, people=40)
    if asked is None:
        return
    done = {(row["seed"], row["acquisition"]) for row in begun(asked.log)}
    for acquisition in ACQUISITIONS:
        for seed in range(asked.first, asked.first + asked.people):
            if (seed, acquisition) in done:
                continue
            try:
                row = run_one(seed, acquisition, asked_of(seed, acquisition))
            except SpinestiffError as error:
                row = {"seed": seed, "acquisition": acquisition, "not made": str(error)}
            keep(asked.log, row)
            print(acquisition, seed, row.get("not made") or row.get("failed") or row.get("z"), flush=True)


if __name__ == "__main__":
    main()
