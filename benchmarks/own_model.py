"""Are intervals right where nothing is wrong but what an estimate allows for? Radiographs drawn from its own model.

    python benchmarks/own_model.py --log FILE [--first SEED] [--people 6] [--draws 5]
    python benchmarks/own_model.py --summary FILE... [--write]
    python benchmarks/own_model.py --json

A person of ``coverage_subjects`` is pushed from one side or from both, and shaped. Then the measured corners are thrown
away, and others are drawn: at the person's true ratios, every unknown of the estimate from its prior, and every error
from the covariance that the estimate has at that place, model discrepancy among them. So the truth is a member of just
what an estimate believes. Where the person stood for a sequence is left as it was seen: its prior is wide, and a view
is placed anew before an estimate sees it.

If z, the error of a log ratio over its standard deviation, has a root mean square of 1 here and not in ``coverage.py``,
then the subjects there bring errors that the estimate does not expect, and it is not its approximations that fail. A
log that exists is gone on with; needs the extra ``[mesh]``. About 20 CPU s a draw.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from coverage_subjects import Acquisition, make_subject
from kept_rows import asked_for, begun, keep

from spinestiff.anatomy.regions import parameter_groups
from spinestiff.anatomy.template import template_torso
from spinestiff.arrays import Floats
from spinestiff.errors import SpinestiffError
from spinestiff.estimation.evaluation import TrialSet
from spinestiff.estimation.fit import fit_stiffness
from spinestiff.estimation.objective import Trial, residuals
from spinestiff.estimation.priors import Priors
from spinestiff.estimation.weighed import WeighedProblem
from spinestiff.imaging.features import VertebraCorners
from spinestiff.personalise.shape import personalise
from spinestiff.study.trials import Known, PushSet, push_set

RESULTS = Path(__file__).parent / "results" / "own_model.json"
NAMES = ("lateral_bending", "tissue")
START = {"lateral_bending": 0.07, "tissue": 0.04}
ACQUISITIONS: tuple[Acquisition, ...] = ("three pushes", "both sides")
FIRST, NODES = 71000, 2300
NORMAL_95, CHI2_95 = 1.959964, 5.991465
NUISANCES_BY = (0.0, 0.5, 1.0)  # shares of the drawn unknowns, on the way to their equilibria


@dataclass(frozen=True)
class Asked:
    """A person's pushes, the true log ratios, and the estimate's own model of them."""

    pushes: PushSet
    log_ratios: Floats
    problem: WeighedProblem


def asked_of(seed: int, acquisition: Acquisition) -> Asked:
    """Raises SpinestiffError where there is no such person."""
    subject = make_subject(seed, acquisition, NODES)
    template = template_torso(subject.height_cm, "coarse", age_years=subject.age, sex=subject.sex)
    shaped = personalise(template, subject.rest)
    pushes = push_set(shaped.torso, subject.records, subject.tracked, known=Known(Priors(), shaped.covariance))
    return asked_with(pushes, subject.ratios)


def asked_with(pushes: PushSet, ratios: Mapping[str, float]) -> Asked:
    """The estimate's own model of pushes at true ratios."""
    both = [(pushes.problems[item.push], item.trial) for item in pushes.fitted]
    loaded = [one for one in both if one[1].load.size > 0.0]
    still = [one for one in both if one[1].load.size == 0.0]
    groups = parameter_groups(pushes.torso, NAMES)
    trial_set = TrialSet([p for p, _ in loaded], [t for _, t in loaded], groups, pushes.orientation, None)
    known = pushes.known
    problem = WeighedProblem(trial_set, still, pushes.orientation, known.priors, known.geometry, known.taped)
    return Asked(pushes, np.log([ratios[name] for name in NAMES]), problem)


def drawn(asked: Asked, random: np.random.Generator) -> list[Trial]:
    """The trials, those under load first, with corners as the estimate's own model draws them."""
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
    return found


def run_one(seed: int, acquisition: Acquisition, asked: Asked, draw: int) -> dict[str, Any]:
    """An estimate from drawn corners, as a line of the log."""
    row: dict[str, Any] = {"seed": seed, "acquisition": acquisition, "draw": draw}
    began, pushes = time.process_time(), asked.pushes
    try:
        trials = drawn(asked, np.random.default_rng([5, seed, ACQUISITIONS.index(acquisition), draw]))
        problems = [pushes.problems[item.push] for item in pushes.fitted]
        fit = fit_stiffness(
            problems,
            trials,
            NAMES,
            start=START,
            orientation=pushes.orientation,
            priors=pushes.known.priors,
            geometry=pushes.known.geometry,
            taped=pushes.known.taped,
            extent="estimate",
        )
    except SpinestiffError as error:
        return {**row, "failed": str(error)}
    assert fit.weighed is not None
    errors = np.log(fit.ratios.values) - asked.log_ratios
    row |= {
        "errors": errors.round(4).tolist(),
        "sds": np.sqrt(np.diag(fit.covariance)).round(4).tolist(),
        "joint": round(float(errors @ np.linalg.solve(fit.covariance, errors)), 3),
        "p_value": round(fit.weighed.p_value, 4),
    }
    return {**row, "cpu_s": round(time.process_time() - began, 1)}


def summarised(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Root mean squares of z and shares inside, by acquisition."""
    found = []
    for acquisition in ACQUISITIONS:
        mine = [row for row in rows if row["acquisition"] == acquisition]
        own = [row for row in mine if "failed" not in row]
        if not own:
            continue
        z = np.array([np.array(row["errors"]) / row["sds"] for row in own])
        joint = np.array([row["joint"] for row in own])
        found.append(
            {
                "acquisition": acquisition,
                "estimates": len(own),
                "failed": len(mine) - len(own),
                "people": len({row["seed"] for row in own}),
                "rms_z": {name: round(float(v), 3) for name, v in zip(NAMES, np.sqrt(np.mean(z**2, axis=0)))},
                "mean_z": {name: round(float(v), 3) for name, v in zip(NAMES, z.mean(axis=0))},
                "inside95": {
                    **{name: int(v) for name, v in zip(NAMES, (np.abs(z) <= NORMAL_95).sum(axis=0))},
                    "joint": int((joint <= CHI2_95).sum()),
                },
                "mean_joint": round(float(joint.mean()), 3),
                "median_p_value": round(float(np.median([row["p_value"] for row in own])), 3),
            }
        )
    return found


def main() -> None:
    asked = asked_for(__doc__, RESULTS, lambda rows: {"acquisitions": summarised(rows)}, first=FIRST, people=6, draws=5)
    if asked is None:
        return
    done = {(row["seed"], row["acquisition"], row["draw"]) for row in begun(asked.log)}
    for seed in range(asked.first, asked.first + asked.people):
        for acquisition in ACQUISITIONS:
            todo = [draw for draw in range(asked.draws) if (seed, acquisition, draw) not in done]
            if not todo:
                continue
            try:
                person = asked_of(seed, acquisition)
            except SpinestiffError as error:
                print(seed, acquisition, error, flush=True)
                continue
            for draw in todo:
                row = run_one(seed, acquisition, person, draw)
                keep(asked.log, row)
                print(row, flush=True)


if __name__ == "__main__":
    main()
