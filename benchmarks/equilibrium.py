"""What an equilibrium costs, in units of one numeric factorisation of the default model's own tangent.

``python benchmarks/equilibrium.py [--mesh coarse --mesh fine | --spacing 17 --spacing 12.6]
[--solver direct|two-level] [--repeats 3] [--json] [--write]``: a row a mesh, with ``--json`` one list of them and
nothing else, with ``nodes``, ``factorisation_cpu_s`` (absolute), ``linear_factorisation`` (linear tetrahedra, same
nodes) and, as multiples of the former, CPU time of

    rest                from rest at default stiffness, 60 N
    soft                from rest at bending 0.10, tissue 0.01
    warm                the soft state solved again after the tissue ratio grew by 5 %, on the last tangent's factor
    warm_with_gradient  the same with the true tangent at the new state and the adjoint gradient of two ratios
    adjoint, forward6   given the tangent: gradient of two ratios; forward sensitivities of six
    fit                 two ratios from two frames (20 and 40 N)

``other`` is the share of a soft solve that is not factorising. All are CPU seconds of the whole process (all threads),
the median of the repeats. ``rest_cpu_s`` and ``soft_cpu_s`` are the same in seconds, ``peak_gb`` the process's peak
memory so far and ``linear_residual`` the relative residual of the solve behind the gradient, on the true tangent.
Meshes by --spacing come from benchmarks/mesh_convergence.py's cache.
"""

from __future__ import annotations

import argparse
import datetime
import json
import resource
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from elements import linear_torso

from spinestiff.anatomy.stiffness import parameter_group, stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.estimation.fit import fit_stiffness
from spinestiff.estimation.objective import Trial
from spinestiff.imaging.features import VertebraCorners, silhouette_shares, state_features
from spinestiff.imaging.projection import frontal_view
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.factor import default_backend
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.supports import three_point_supports

SIX = ("lateral_bending", "tissue_mu", "tissue_lambda", "lateral_shear", "axial_rotation", "flexion_extension")
RESULTS = Path(__file__).parent / "results" / "equilibrium.json"


def cpu_seconds(action: Callable[[], object], repeats: int) -> float:
    """Median CPU time of ``action`` after one run that is not counted."""
    action()
    times = []
    for _ in range(repeats):
        began = time.process_time()
        action()
        times.append(time.process_time() - began)
    return statistics.median(times)


def factorisation(torso: TorsoModel, repeats: int) -> float:
    """CPU seconds of one numeric factorisation of the default tangent at rest, by the direct solver."""
    problem = EquilibriumProblem(torso, three_point_supports(torso, "left"), backend=default_backend())
    load = rib_push(torso, "left", 8.0, 60.0)
    values = problem.potential.hessian(torso.rest_pose, problem.potential.stiffness(None), problem.all_terms(load))
    return cpu_seconds(lambda: problem.numeric_factor(values), max(repeats, 3))


def measure(torso: TorsoModel, solver: str | None, repeats: int) -> dict[str, Any]:
    """One row of the table."""
    problem = EquilibriumProblem(torso, three_point_supports(torso, "left"), backend=solver)
    load = rib_push(torso, "left", 8.0, 60.0)
    kinds = torso.joints.kinds
    soft = stiffness_ratios({"lateral_bending": 0.10, "tissue": 0.01}, kinds)
    stiffer = soft.with_values([0.10, 0.0105])
    unit, linear = factorisation(torso, repeats), factorisation(linear_torso(torso), repeats)
    rested, tangent = problem.solve_linearised(load, soft)
    # As a loss of image features has it: on the vertebrae's poses, a moment counting as a force at 30 mm.
    weights = np.zeros(problem.potential.dofs)
    poses = np.random.default_rng(0).normal(size=(len(torso.vertebrae), 6)) * [1, 1, 1, 30, 30, 30]
    weights[: 6 * len(torso.bone_names)].reshape(-1, 6)[torso.vertebra_bones] = poses
    six = [parameter_group(name, kinds) for name in SIX]

    def warm_with_gradient() -> None:
        _, there = problem.solve_linearised(load, stiffer, tangent)
        there.adjoint(weights, stiffer.groups)

    costs = {
        "rest": cpu_seconds(lambda: problem.solve(load), repeats),
        "soft": cpu_seconds(lambda: problem.solve(load, soft), repeats),
        "warm": cpu_seconds(lambda: problem.solve(load, stiffer, tangent), repeats),
        "warm_with_gradient": cpu_seconds(warm_with_gradient, repeats),
        "adjoint": cpu_seconds(lambda: tangent.adjoint(weights, stiffer.groups), repeats),
        "forward6": cpu_seconds(lambda: tangent.forward(six), repeats),
        "fit": cpu_seconds(lambda: two_frame_fit(problem, torso, soft), 1),
    }
    found = problem.solve(load, soft)
    return {
        "nodes": len(torso.tissue.rest_positions),
        "solver": solver or problem.backend,
        "factorisation_cpu_s": round(unit, 4),
        "linear_factorisation": round(linear / unit, 3),
        **{name: round(cost / unit, 3) for name, cost in costs.items()},
        "other": round(1.0 - found.factorisations * unit / costs["soft"], 3),
        "soft_factorisations": found.factorisations,
        "linear_residual": linear_residual(problem, tangent, weights, rested, load, soft),
        "rest_cpu_s": round(costs["rest"], 3),
        "soft_cpu_s": round(costs["soft"], 3),
        "peak_gb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2, 2),
    }


def linear_residual(problem, tangent, rhs, rested, load, ratios) -> float:  # type: ignore[no-untyped-def]
    """Relative residual, moments over 30 mm, of the tangent's solution on a matrix assembled anew."""
    potential = problem.potential
    values = potential.hessian(rested.state, potential.stiffness(ratios), problem.all_terms(load))
    free = rhs.copy()
    free[problem.held] = 0.0
    left = free - problem.numeric_factor(values).multiply(tangent.solve(rhs))
    return float(f"{problem.residual_norm(left) / problem.residual_norm(free):.1e}")


def two_frame_fit(problem, torso, soft):  # type: ignore[no-untyped-def]
    """Two ratios from two noise-free frames of the same mesh."""
    view = frontal_view()
    shares = silhouette_shares(torso, view, torso.rest_pose)
    trials = []
    for force in (20.0, 40.0):
        load = rib_push(torso, "left", 8.0, force)
        corners = state_features(torso, view, problem.solve(load, soft).require().state, shares).corners
        trials.append(Trial(load, VertebraCorners(torso.vertebrae, corners), view, f"{force:.0f} N"))
    return fit_stiffness(problem, trials)


def slopes(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Log-log slope of CPU seconds against nodes, of each solver that was run on two meshes or more."""
    found = {}
    for solver in dict.fromkeys(row["solver"] for row in rows):
        mine = [row for row in rows if row["solver"] == solver]
        nodes = np.log([row["nodes"] for row in mine])
        for key in ("rest_cpu_s", "soft_cpu_s"):
            if len(mine) > 1:
                found[f"{solver} {key}"] = round(float(np.polyfit(nodes, np.log([row[key] for row in mine]), 1)[0]), 2)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print one list of all rows, and nothing else")
    parser.add_argument("--write", action="store_true", help="merge the rows into benchmarks/results/equilibrium.json")
    parser.add_argument("--mesh", action="append", choices=("coarse", "fine"), default=[])
    parser.add_argument("--spacing", action="append", type=float, default=[], help="mm between nodes inside")
    parser.add_argument("--solver", choices=("direct", "two-level"), help="default: by the number of unknowns")
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    torsos = [template_torso(157.0, mesh) for mesh in arguments.mesh]
    if arguments.spacing:
        from mesh_convergence import cache_folder, family_torso

        torsos += [family_torso(spacing, cache_folder()) for spacing in arguments.spacing]
    torsos = torsos or [template_torso(157.0, mesh) for mesh in ("coarse", "fine")]
    solver = default_backend() if arguments.solver == "direct" else arguments.solver
    rows = []
    for torso in torsos:
        rows.append(measure(torso, solver, arguments.repeats))
        if not arguments.json:
            print(json.dumps(rows[-1]), flush=True)
    if arguments.write:
        old = json.loads(RESULTS.read_text(encoding="utf-8"))["rows"] if RESULTS.exists() else []
        new = {(row["nodes"], row["solver"]) for row in rows}
        rows = sorted(
            [*rows, *(row for row in old if (row["nodes"], row["solver"]) not in new)],
            key=lambda row: (row["solver"], row["nodes"]),
        )
        date = datetime.datetime.now(datetime.UTC).date().isoformat()
        result = {"date": date, "slopes": slopes(rows), "rows": rows}
        RESULTS.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(rows, indent=1) if arguments.json else json.dumps(slopes(rows)))


if __name__ == "__main__":
    main()
