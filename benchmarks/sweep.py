"""Does an equilibrium come out at every stiffness and force that a fit may try?

``OMP_NUM_THREADS=1 python benchmarks/sweep.py [--points 1000] [--body 0 ...] [--json] [--write] [--log FILE]``: a
scrambled Sobol sample of lateral bending, tissue mu and tissue lambda (each 0.0025 to 5, on a log scale) and force (0
to 114 N) over five bodies of ``calibrate_tissue.py`` on the coarse mesh. lambda goes apart from mu, so Poisson's ratio
runs from 0.002 to 0.49997. Every point is solved

    rest    from the rest pose
    warm    from the equilibrium of the point before it, its nearest neighbour among the body's points not yet visited
    linear  from that one's linearisation, where its tangent was factorised to check it: at a tenth of the points

and recorded with status, residual, steps (all; those on a fresh tangent), factorisations, CPU seconds and energy. At a
tenth of the points each state is judged a second time, by the inertia of its true tangent, factorised anew.

Where starts end in different states, the point has several equilibria: it is flagged, with energies and how far they
are apart. Where a start fails or states differ, the load is raised from zero in small steps until it is reached or the
branch ends (``multiplicity.follow_load``). A point with a failed start is named by that: a limit point or an
inversion at a share of the load, or "missed", an equilibrium that the solver did not find.

With ``--log`` a run that was stopped goes on where it was. The point before the first new one is solved again. Bodies
can be run beside each other, each with a log of its own; the logs one after the other are the log of all.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import time
from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from calibrate_tissue import SUBJECTS, Body
from kept_rows import begun, prepare
from multiplicity import SAME_MM, apart, follow_load
from scipy.stats import qmc

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import RATIO_BOUNDS, StiffnessRatios, stiffness_ratios
from spinestiff.mechanics.equilibrium import Equilibrium, EquilibriumProblem
from spinestiff.mechanics.factor import Factor
from spinestiff.mechanics.loads import LoadCase, rib_push
from spinestiff.mechanics.sensitivity import Linearisation

STARTS = ("rest", "warm", "linear")
RATIOS = ("lateral_bending", "tissue_mu", "tissue_lambda")
LARGEST_FORCE_N = 114.0  # of the paper's Table 2
BODIES = (0, 1, 3, 4, 5)  # of SUBJECTS: 139 to 168 cm, three kinds of curve, both sides
CHECKED_EVERY = 10


class Point(NamedTuple):
    """One problem of the sample."""

    number: int
    body: int
    ratios: tuple[float, ...]
    force_n: float


def sample(count: int, seed: int) -> list[Point]:
    """``count`` points, ordered by body and so that neighbours follow each other."""
    bits = int(np.ceil(np.log2(max(count, 2))))
    unit = qmc.Sobol(len(RATIOS) + 2, seed=seed).random_base2(bits)[:count]
    low, high = np.log(RATIO_BOUNDS)
    points = []
    for body in range(len(BODIES)):
        left = np.flatnonzero((unit[:, -1] * len(BODIES)).astype(int) == body)
        at = unit[left[0]] if len(left) else None
        while len(left):
            nearest = int(np.argmin(np.linalg.norm(unit[left, :4] - at[:4], axis=1)))
            at, number = unit[left[nearest]], int(left[nearest])
            left = np.delete(left, nearest)
            ratios = tuple(float(r) for r in np.exp(low + (high - low) * at[:3]))
            points.append(Point(number, body, ratios, float(LARGEST_FORCE_N * at[3])))
    return points


def solved(
    problem: EquilibriumProblem, load: LoadCase, ratios: StiffnessRatios, start: TorsoState | Linearisation | None
) -> tuple[Equilibrium, dict[str, Any]]:
    """An equilibrium, and what it cost."""
    began = time.process_time()
    found = problem.solve(load, ratios, start)
    return found, {
        "status": found.status.name.lower(),
        "residual_n": found.residual_norm,
        "tolerance_n": found.tolerance,
        "steps": found.iterations,
        "fresh_steps": sum(step.factorised for step in found.history),
        "factorisations": found.factorisations,
        "cpu_s": round(time.process_time() - began, 3),
        "energy_nmm": found.energy,
        "smallest_j": round(found.smallest_j, 4),
        "fault": found.fault,
    }


def judged(problem: EquilibriumProblem, found: Equilibrium, load: LoadCase, ratios: StiffnessRatios) -> dict[str, Any]:
    """Whether the true tangent at ``found`` is positive definite, by the inertia of a factor of its own."""
    factor = problem.factorise(found.state, problem.potential.stiffness(ratios), problem.all_terms(load))
    return {"positive_definite": bool(factor.positive_definite)}


def walk(points: list[Point], body: Body, done: set[int]) -> Iterator[dict[str, Any]]:
    """The rows of one body's points, in their order; points that are done are passed over."""
    before: Equilibrium | None = None
    linear: Linearisation | None = None
    for point, after in zip(points, [*points[1:], None]):
        ratios = stiffness_ratios(dict(zip(RATIOS, point.ratios)), body.torso.joints.kinds)
        load = rib_push(body.torso, body.side, body.level, point.force_n)
        if point.number in done:
            if after is not None and after.number not in done:
                before, linear = body.problem.solve(load, ratios), None
            continue
        row, found = solved_from_all(body.problem, load, ratios, before, linear)
        good = [one for one in found if one.converged]
        linear = None
        if good:
            before = min(good, key=lambda one: one.energy)
            if point.number % CHECKED_EVERY == 0:
                factors = [tangent(body.problem, one, load, ratios) for one in good]
                row["tangents_positive_definite"] = [factor.positive_definite for factor in factors]
                if all(row["tangents_positive_definite"]):
                    linear = body.problem.linearise(before, load, ratios)
        yield {
            "number": point.number,
            "subject": BODIES[point.body] + 1,
            **dict(zip(RATIOS, point.ratios)),
            "force_n": point.force_n,
            **row,
        }


def solved_from_all(
    problem: EquilibriumProblem,
    load: LoadCase,
    ratios: StiffnessRatios,
    before: Equilibrium | None,
    linear: Linearisation | None,
) -> tuple[dict[str, Any], list[Equilibrium]]:
    """What each start gives, how far the states are apart, and the branch of growing load where that is in question."""
    starts = {"rest": None} | ({"warm": before.state} if before else {}) | ({"linear": linear} if linear else {})
    row: dict[str, Any] = {}
    found = []
    for name, start in starts.items():
        one, row[name] = solved(problem, load, ratios, start)
        found.append(one)
    good = [one for one in found if one.converged]
    different = [one for i, one in enumerate(good) if all(apart(one.state, o.state) > SAME_MM for o in good[:i])]
    row["equilibria"] = len(different)
    row["apart_mm"] = max((apart(one.state, o.state) for one in good for o in good), default=0.0)
    if len(good) < len(found) or len(different) > 1:
        branch = follow_load(problem, load, ratios)
        same = [apart(one.state, branch.equilibrium.state) < SAME_MM for one in different]
        row["branch"] = {
            "end": branch.end.name.lower(),
            "share": round(branch.share, 5),
            "least_eigenvalue_to_rest": branch.stiffness,
            "smallest_j": round(branch.equilibrium.smallest_j, 4),
            "energy_nmm": branch.equilibrium.energy,
            "steps": branch.steps,
            "is_number": same.index(True) if any(same) else None,
        }
        row["energies_nmm"] = [one.energy for one in different]
    return row, found


def tangent(problem: EquilibriumProblem, found: Equilibrium, load: LoadCase, ratios: StiffnessRatios) -> Factor:
    """The true tangent at ``found``, factorised anew: its inertia judges the state independently of the solve."""
    return problem.factorise(found.state, problem.potential.stiffness(ratios), problem.all_terms(load))


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Figures over all rows, and every point that is not plain: several equilibria, a failed start, many steps."""
    result: dict[str, Any] = {"points": len(rows)}
    for start in STARTS:
        runs = [row[start] for row in rows if start in row]
        if not runs:
            continue
        result[start] = {
            "solves": len(runs),
            "converged": sum(run["status"] == "converged" for run in runs),
            "largest_residual_to_tolerance": max(
                (run["residual_n"] / run["tolerance_n"] for run in runs if run["status"] == "converged"), default=None
            ),
            **{key: spread([run[key] for run in runs]) for key in ("steps", "fresh_steps", "factorisations", "cpu_s")},
            "total_cpu_s": round(sum(run["cpu_s"] for run in runs), 1),
        }
    failed = [row for row in rows if any(row[start]["status"] != "converged" for start in STARTS if start in row)]
    judged = [one for row in rows for one in row.get("tangents_positive_definite", [])]
    result |= {
        "tangents_judged_again": len(judged),
        "of_them_positive_definite": sum(judged),
        "largest_apart_mm": max((row["apart_mm"] for row in rows if row["equilibria"] == 1), default=0.0),
        "several_equilibria": [row for row in rows if row["equilibria"] > 1],
        "not_converged": [{"name": name(row), **row} for row in failed],
        "unexplained": sum(name(row) == "missed" for row in failed),
        "dearest": sorted(rows, key=lambda row: -max(row[s]["factorisations"] for s in STARTS if s in row))[:10],
    }
    return result


def name(row: dict[str, Any]) -> str:
    """What became of a point with a failed start, by the branch of growing load."""
    end = row["branch"]["end"]
    return f"{end} at {row['branch']['share']:.4f}" if end in ("limit_point", "inversion") else "missed"


def spread(values: list[float]) -> dict[str, float]:
    return {
        "median": float(np.median(values)),
        "p90": round(float(np.percentile(values, 90)), 3),
        "worst": float(np.max(values)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=1000)
    parser.add_argument("--body", type=int, action="append", choices=range(len(BODIES)), help="default: all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--log", type=Path, help="rows as they come; what is there is not done again")
    parser.add_argument("--json", action="store_true", help="print all of the result")
    parser.add_argument("--write", action="store_true", help="store the result in benchmarks/results/")
    arguments = parser.parse_args()
    chosen = arguments.body or range(len(BODIES))
    points = [point for point in sample(arguments.points, arguments.seed) if point.body in chosen]
    rows: list[dict[str, Any]] = []
    if arguments.log is not None:
        prepare(arguments.log)
        rows = begun(arguments.log)
    done = {row["number"] for row in rows}
    if len(done) < len(points):
        bodies = {i: Body(SUBJECTS[BODIES[i]], "coarse") for i in chosen}
        walks = [walk([p for p in points if p.body == i], body, done) for i, body in bodies.items()]
        # In turn, so that a run that is stopped has seen all bodies.
        for row in (row for turn in zip_longest(*walks) for row in turn if row is not None):
            rows.append(row)
            if arguments.log is not None:
                with arguments.log.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row) + "\n")
    result = {
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "seed": arguments.seed,
        "threads": os.environ.get("OMP_NUM_THREADS", "all"),
        "of_points": arguments.points,
        **summary(rows),
    }
    print(json.dumps(result if arguments.json else {k: v for k, v in result.items() if k != "dearest"}, indent=1))
    if arguments.write:
        path = Path(__file__).parent / "results" / "sweep.json"
        path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
