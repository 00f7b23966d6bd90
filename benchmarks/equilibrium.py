"""What an equilibrium costs, in units of one numeric factorisation of the default model's own tangent.

``python benchmarks/equilibrium.py [--json] [--mesh coarse --mesh fine] [--repeats 3]``: a row a mesh with ``nodes``,
``factorisation_cpu_s`` (absolute) and, as multiples of it, CPU time of

    rest                from rest at default stiffness, 60 N
    soft                from rest at bending 0.10, tissue 0.01
    warm                the soft state solved again after the tissue ratio grew by 5 %
    warm_with_gradient  the same, linearised, with the adjoint gradient of two ratios
    adjoint, forward6   given the factor: gradient of two ratios; forward sensitivities of six
    fit                 two ratios from two frames (20 and 40 N)

All are CPU seconds of the whole process (all threads), the median of the repeats.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable

import numpy as np

from spinestiff.anatomy.stiffness import parameter_group, stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.estimation.fit import fit_stiffness
from spinestiff.estimation.objective import Trial
from spinestiff.imaging.features import VertebraCorners, silhouette_choice, state_features
from spinestiff.imaging.projection import frontal_view
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.supports import three_point_supports

SIX = ("lateral_bending", "tissue_mu", "tissue_lambda", "lateral_shear", "axial_rotation", "flexion_extension")
COLUMNS = ("rest", "soft", "warm", "warm_with_gradient", "adjoint", "forward6", "fit")


def cpu_seconds(action: Callable[[], object], repeats: int) -> float:
    """Median CPU time of ``action`` after one run that is not counted."""
    action()
    times = []
    for _ in range(repeats):
        began = time.process_time()
        action()
        times.append(time.process_time() - began)
    return statistics.median(times)


def measure(mesh: str, repeats: int) -> dict[str, float]:
    """One row of the table."""
    torso = template_torso(157.0, mesh)
    problem = EquilibriumProblem(torso, three_point_supports(torso, "left"))
    load = rib_push(torso, "left", 8.0, 60.0)
    kinds = torso.joints.kinds
    soft = stiffness_ratios({"lateral_bending": 0.10, "tissue": 0.01}, kinds)
    stiffer = soft.with_values([0.10, 0.0105])
    stiffness, terms = problem.potential.stiffness(None), problem.all_terms(load)
    values = problem.potential.hessian(torso.rest_pose, stiffness, terms)
    unit = cpu_seconds(lambda: problem.numeric_factor(values), max(repeats, 5))
    rested = problem.solve(load, soft).require()
    warm = problem.solve(load, stiffer, rested.state).require()
    linear = problem.linearise(warm, load, stiffer)
    # As a loss of image features has it: on the vertebrae's poses, a moment counting as a force at 30 mm.
    weights = np.zeros(problem.potential.dofs)
    poses = np.random.default_rng(0).normal(size=(len(torso.vertebrae), 6)) * [1, 1, 1, 30, 30, 30]
    weights[: 6 * len(torso.bone_names)].reshape(-1, 6)[torso.vertebra_bones] = poses
    six = [parameter_group(name, kinds) for name in SIX]

    def warm_with_gradient() -> None:
        found = problem.solve(load, stiffer, rested.state)
        problem.linearise(found, load, stiffer).adjoint(weights, stiffer.groups)

    costs = {
        "rest": cpu_seconds(lambda: problem.solve(load), repeats),
        "soft": cpu_seconds(lambda: problem.solve(load, soft), repeats),
        "warm": cpu_seconds(lambda: problem.solve(load, stiffer, rested.state), repeats),
        "warm_with_gradient": cpu_seconds(warm_with_gradient, repeats),
        "adjoint": cpu_seconds(lambda: linear.adjoint(weights, stiffer.groups), repeats),
        "forward6": cpu_seconds(lambda: linear.forward(six), repeats),
        "fit": cpu_seconds(lambda: two_frame_fit(problem, torso, soft), 1),
    }
    row: dict[str, float] = {"nodes": len(torso.tissue.rest_positions), "factorisation_cpu_s": round(unit, 4)}
    return {**row, **{name: round(costs[name] / unit, 3) for name in COLUMNS}}


def two_frame_fit(problem, torso, soft):  # type: ignore[no-untyped-def]
    """Two ratios from two noise-free frames of the same mesh."""
    view = frontal_view()
    choice = silhouette_choice(torso, view, torso.rest_pose)
    trials = []
    for force in (20.0, 40.0):
        load = rib_push(torso, "left", 8.0, force)
        corners = state_features(torso, view, problem.solve(load, soft).require().state, choice).corners
        trials.append(Trial(load, VertebraCorners(torso.vertebrae, corners), view, f"{force:.0f} N"))
    return fit_stiffness(problem, trials)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--mesh", action="append", choices=("coarse", "fine"))
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    rows = [measure(mesh, arguments.repeats) for mesh in arguments.mesh or ("coarse", "fine")]
    if arguments.json:
        print(json.dumps(rows, indent=1))
        return
    names = ("nodes", "factorisation_cpu_s", *COLUMNS)
    print("  ".join(f"{name:>19}" for name in names))
    for row in rows:
        print("  ".join(f"{row[name]:>19}" for name in names))


if __name__ == "__main__":
    main()
