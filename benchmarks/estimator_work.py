"""What the weighed fit costs, and whether it ends at one place from everywhere: many starts, one subject.

The subject is the template on the synthetic subjects' own mesh under one push at rib level 8 from the right, 40 and
60 N, with an unloaded frame; corners are simulated with errors of annotation, tracking, gauge and supports. It is
fitted on the coarse or on the fine template. Starts are log-uniform over the ratios that subjects have. ``python
benchmarks/estimator_work.py [--starts N] [--mesh coarse] [--write]`` prints evaluations, factorisations (apart those of
the start's own equilibria, which are solved from rest) and CPU time of each fit, how far psi (by the best fit's
weights) and the ratios (in standard deviations) lie apart, and what intervals and budget cost on top.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import time
from pathlib import Path

import numpy as np

from spinestiff.anatomy.stiffness import RATIO_BOUNDS, stiffness_ratios
from spinestiff.anatomy.template import MESHES, OWN_MESH, template_torso
from spinestiff.errors import EquilibriumError
from spinestiff.estimation.budget import prior_changes, variance_budget
from spinestiff.estimation.emulator import Place
from spinestiff.estimation.evaluation import FitCost, TrialSet
from spinestiff.estimation.known import Known
from spinestiff.estimation.mode import likeliest
from spinestiff.estimation.objective import Trial
from spinestiff.estimation.profiles import likely_ratios
from spinestiff.estimation.weighed import WeighedFit, WeighedProblem, Weights, phi, reduced
from spinestiff.imaging.features import VertebraCorners, silhouette_shares, state_features
from spinestiff.imaging.projection import frontal_view
from spinestiff.imaging.tracking.quality import quality_of
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import no_load, rib_push
from spinestiff.mechanics.places import SupportPlace
from spinestiff.mechanics.supports import three_point_supports

TRUTH = {"lateral_bending": 0.1, "tissue": 0.04}
STARTS = ((0.0075, 0.84), (0.0075, 0.2))
FORCES, LEVEL, GAUGE = (40.0, 60.0), 8, 1.02
ANNOTATION_MM, TRACKING_MM = 0.3, 0.1
# At the larger force; of the smaller one its share.
OBLIQUITY, SHOULDER_MM = float(np.deg2rad(2.0)), 2.0
LIMITS = (float(np.log(RATIO_BOUNDS[0])), float(np.log(RATIO_BOUNDS[1])))
MOST_EVALUATIONS = 80


def subject(seed: int, mesh: str) -> WeighedProblem:
    """The simulated subject, ready to be fitted on a mesh."""
    torso, model = template_torso(157.0, OWN_MESH), template_torso(157.0, mesh)
    problem, fitted = (EquilibriumProblem(of, three_point_supports(of, "right")) for of in (torso, model))
    view, random, truth = frontal_view(), np.random.default_rng(seed), stiffness_ratios(TRUTH)
    shares = silhouette_shares(torso, view, torso.rest_pose)
    common = ANNOTATION_MM * random.normal(size=(len(torso.vertebrae), 4, 2))
    quality = np.full(common.shape[:2], float(quality_of(np.array(TRACKING_MM))))

    def seen(state, own: float) -> VertebraCorners:
        errors = common + own * random.normal(size=common.shape)
        corners = state_features(torso, view, state, shares).corners + view.magnification * errors
        return VertebraCorners(torso.vertebrae, corners, quality)

    still = Trial(no_load(), seen(torso.rest_pose, 0.0), view, "rest", "push", annotated=True)
    trials = []
    for force in FORCES:
        share = force / max(FORCES)
        placed = problem.with_place(SupportPlace(share * OBLIQUITY, share * SHOULDER_MM))
        state = placed.solve(rib_push(torso, "right", LEVEL, GAUGE * force), truth).require().state
        load = rib_push(model, "right", LEVEL, force)
        trials.append(Trial(load, seen(state, TRACKING_MM), view, f"{force:g} N", "push"))
    trial_set = TrialSet([fitted] * len(trials), trials, truth.groups, "procrustes", None)
    return WeighedProblem(trial_set, [(fitted, still)], "procrustes", Known(), limits=LIMITS)


def fitted(problem: WeighedProblem, ratios: list[float]) -> tuple[WeighedFit | None, dict[str, object]]:
    """A fit from a start, and its work."""
    trial_set = problem.trial_set
    trial_set.cost, trial_set.history[:] = FitCost(), []
    began = time.process_time()
    found, status, first_factorisations = None, "no equilibrium at the start", 0
    try:
        first = problem.solve(np.log(ratios), np.zeros(len(problem.unknowns)))
        first_factorisations = trial_set.cost.factorisations
        found = likeliest(problem, first, MOST_EVALUATIONS)
        status = found.status.name
    except EquilibriumError:
        pass
    return found, {
        "start": [round(value, 5) for value in ratios],
        "status": status,
        "evaluations": len(trial_set.history) + 1,
        "factorisations": trial_set.cost.factorisations,
        "of_the_start": first_factorisations,
        "cpu_s": round(time.process_time() - began, 2),
    }


def _psi(found: WeighedFit, weights: Weights) -> float:
    """At a fit's end, by the weights of another."""
    return phi(found.point, weights) + reduced(found.point, found.slope, weights).log_precision


def campaign(starts: int, seed: int, mesh: str) -> dict[str, object]:
    """All fits, compared with the first of the least phi, and the uncertainty's work there."""
    problem, random = subject(seed, mesh), np.random.default_rng(seed + 1)
    fits, records = [], []
    for _ in range(starts):
        ratios = [float(np.exp(random.uniform(*np.log(ends)))) for ends in STARTS]
        found, record = fitted(problem, ratios)
        print(record, flush=True)
        fits.append(found)
        records.append(record)
    ended = [(found, record) for found, record in zip(fits, records) if found is not None and found.status.usable]
    best = min((found for found, _ in ended), key=lambda found: _psi(found, found.weights))
    model = reduced(best.point, best.slope, best.weights)
    sd = np.sqrt(np.diag(np.linalg.inv(model.ratios.T @ model.ratios)))
    for found, record in ended:
        record["psi_over_least"] = _psi(found, best.weights) - _psi(best, best.weights)
        record["apart_sd"] = float(np.abs((found.point.log_ratios - best.point.log_ratios) / sd).max())
    trial_set = problem.trial_set
    trial_set.cost, trial_set.history[:] = FitCost(), []
    began = time.process_time()
    likely, places = likely_ratios(problem, best, [Place(*place) for place in best.visited])
    variance_budget(problem, best)
    prior_changes(problem, best, places)
    names = list(TRUTH)
    work = {
        "evaluations": len(trial_set.history),
        "factorisations": trial_set.cost.factorisations,
        "cpu_s": round(time.process_time() - began, 2),
    }

    def spread(what: str) -> dict[str, float]:
        values = [record[what] for record in records if record["status"] == "CONVERGED"]
        return {"median": float(np.median(values)), "worst": float(np.max(values))}

    return {
        "date": datetime.date.today().isoformat(),
        "load_average": [round(value, 1) for value in os.getloadavg()],
        "mesh": mesh,
        "truth": TRUTH,
        "estimate": dict(zip(names, np.exp(best.point.log_ratios).round(5).tolist())),
        "sd_of_log": dict(zip(names, sd.round(4).tolist())),
        "interval95": {
            name: np.exp([low, high]).round(5).tolist() for name, low, high in zip(names, likely.low, likely.high)
        },
        "kinds": dict(zip(names, likely.kinds)),
        "starts": starts,
        "statuses": {name: [r["status"] for r in records].count(name) for name in {str(r["status"]) for r in records}},
        "fit": {what: spread(what) for what in ("evaluations", "factorisations", "of_the_start", "cpu_s")},
        "psi_over_least": max(float(str(record["psi_over_least"])) for _, record in ended),
        "apart_sd": max(float(str(record["apart_sd"])) for _, record in ended),
        "uncertainty": work,
        "fits": records,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--mesh", choices=MESHES, default="coarse", help="that the subject is fitted on")
    parser.add_argument("--write", action="store_true", help="to results/estimator_work.json, _fine.json")
    options = parser.parse_args()
    result = campaign(options.starts, options.seed, options.mesh)
    print(json.dumps({key: value for key, value in result.items() if key != "fits"}, indent=1))
    if options.write:
        end = "" if options.mesh == "coarse" else f"_{options.mesh}"
        path = Path(__file__).parent / "results" / f"estimator_work{end}.json"
        path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
