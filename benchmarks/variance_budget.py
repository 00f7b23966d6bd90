"""What each thing that is not quite known adds to the uncertainty of the ratios, to first order.

The reference body (157 cm, coarse mesh, pelvis level, thoracic curve of 15 degrees) at five points of ratio space under
three acquisitions, each with an unloaded frame a push: the standard deviation of the log of each ratio with all
unknowns, with each of them alone beside tracking's errors, and with all but it. Nothing is fitted: the radiographs are
the model's own, and the budget is read at their ratios. The covariance of the rest geometry is that of a
personalisation from corners set within 0.3 mm.

Run ``python benchmarks/variance_budget.py``; it prints the tables of docs/estimation.md in Markdown, and with
``--write`` stores the figures in benchmarks/results/. ``--markdown`` prints what is stored.
"""

from __future__ import annotations

import argparse
import datetime
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import track

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import parameter_group, stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.estimation.budget import Budget, variance_budget
from spinestiff.estimation.evaluation import TrialSet
from spinestiff.estimation.known import Known
from spinestiff.estimation.objective import Trial
from spinestiff.estimation.priors import Priors
from spinestiff.estimation.status import FitStatus
from spinestiff.estimation.weighed import WeighedFit, WeighedProblem
from spinestiff.imaging.features import VertebraCorners, silhouette_shares, state_features
from spinestiff.imaging.projection import XRayView, frontal_view, lateral_view
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import no_load, rib_push
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.personalise.placing import place_vertebrae
from spinestiff.personalise.shape import personalise
from spinestiff.study.planning.scene import POPULATION
from spinestiff.study.synthetic.spines import curved_spine

RESULT = Path(__file__).parent / "results" / "variance_budget.json"
NAMES = ("lateral_bending", "tissue")
# Pushes of (rib level, forces in N), all from the right.
ACQUISITIONS = {
    "R8 20, 40": ((8.0, (20.0, 40.0)),),
    "R8 40, 60": ((8.0, (40.0, 60.0)),),
    "R5, R8, R10 60": ((5.0, (60.0,)), (8.0, (60.0,)), (10.0, (60.0,))),
}
# Tracked corners are as good as this; 0.11 mm predicted.
QUALITY = 0.7


def corners(torso: TorsoModel, view: XRayView, state: TorsoState, quality: float) -> VertebraCorners:
    """What the radiograph of a state shows."""
    shares = silhouette_shares(torso, view, torso.rest_pose)
    found = state_features(torso, view, state, shares).corners
    return VertebraCorners(torso.vertebrae, found, np.full(found.shape[:2], quality))


def budget_of(
    torso: TorsoModel,
    geometry: np.ndarray,
    problem: EquilibriumProblem,
    point: tuple[float, float],
    acquisition: tuple[tuple[float, tuple[float, ...]], ...],
) -> Budget:
    """The budget of the model's own radiographs."""
    view, ratios = frontal_view(), stiffness_ratios(dict(zip(NAMES, point)))
    loaded, still = [], []
    for number, (level, forces) in enumerate(acquisition):
        name, state = f"push {number}", torso.rest_pose
        unloaded = corners(torso, view, state, 1.0)
        still.append((problem, Trial(no_load(), unloaded, view, f"{name} unloaded", name, annotated=True)))
        for force in forces:
            load = rib_push(torso, "right", level, force)
            state = problem.solve(load, ratios, state).require().state
            seen = corners(torso, view, state, QUALITY)
            loaded.append(Trial(load, seen, view, f"{name} {force:g} N", name))
    groups = tuple(parameter_group(name, torso.joints.kinds) for name in NAMES)
    trials = TrialSet([problem] * len(loaded), loaded, groups, "procrustes", None)
    asked = WeighedProblem(trials, still, "procrustes", Known(geometry=geometry))
    at = asked.solve(np.log(point), np.zeros(len(asked.unknowns)))
    slope = asked.slope(at)
    return variance_budget(asked, WeighedFit(at, slope, asked.as_expected(at), FitStatus.CONVERGED, ()))


def reference_body() -> tuple[TorsoModel, np.ndarray]:
    """A curved torso, and how uncertain a personalisation leaves its vertebrae's poses, (6V, 6V)."""
    template = template_torso(157.0, "coarse")
    torso = place_vertebrae(template, *curved_spine(template, 15.0, "thoracic"))
    noise = np.random.default_rng(0)
    pictures = {}
    for name, view in (("frontal", frontal_view()), ("lateral", lateral_view())):
        seen = corners(torso, view, torso.rest_pose, 1.0)
        moved = seen.corners + noise.normal(0.0, 0.3 * view.magnification, seen.corners.shape)
        pictures[name] = (VertebraCorners(seen.vertebrae, moved), view)
    return torso, personalise(template, pictures).covariance


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="store the figures")
    parser.add_argument("--markdown", action="store_true", help="print what is stored")
    asked = parser.parse_args()
    if asked.markdown:
        stored = json.loads(RESULT.read_text())
        print(markdown(stored["rows"]))
        return
    torso, geometry = reference_body()
    problem = EquilibriumProblem(torso, three_point_supports(torso, "right"))
    cases = [(point, name) for point in POPULATION for name in ACQUISITIONS]
    rows = []
    for point, name in track(cases, "budgets"):
        budget = budget_of(torso, geometry, problem, point, ACQUISITIONS[name])
        rows.append(
            {
                "bending": point[0],
                "tissue": point[1],
                "acquisition": name,
                "together": [round(value, 4) for value in budget.together],
                "tracking": [round(value, 4) for value in budget.tracking],
                "unknowns": {
                    row.name: {
                        "alone": [round(value, 4) for value in row.alone],
                        "without": [round(value, 4) for value in row.without],
                    }
                    for row in budget.rows
                },
            }
        )
    print(markdown(rows))
    if asked.write:
        found = {"date": datetime.date.today().isoformat(), "names": NAMES, "priors": vars(Priors()), "rows": rows}
        RESULT.write_text(json.dumps(found, indent=1) + "\n")


def markdown(rows: Sequence[Mapping[str, Any]]) -> str:
    """Two tables of log bending / log tissue, an unknown a row and a case a column: the standard deviations with it
    and tracking's errors alone, and the share of the variance, in percent, that knowing it takes away.

    The unknown that takes away most stands first; the last column of the second table has the least and the most.
    """
    names = list(dict.fromkeys(name for row in rows for name in row["unknowns"]))
    gains = {name: np.array([gain(row, name) for row in rows]) for name in names}  # (cases, 2)
    names.sort(key=lambda name: -gains[name].max())
    cases = [f"{row['bending']:g}, {row['tissue']:g}: {row['acquisition']}" for row in rows]
    sds = {"all together": [row["together"] for row in rows], "tracking's errors": [row["tracking"] for row in rows]}
    sds |= {name: [row["unknowns"].get(name, {"alone": None})["alone"] for row in rows] for name in names}
    lines = _head(["sd of the log, alone", *cases])
    lines += [
        _line(name, *("" if one is None else _pair(one, ".2f") for one in values)) for name, values in sds.items()
    ]
    lines += ["", *_head(["taken away, %", *cases, "least to most"])]
    for name in names:
        ends = [_pair(end, ".0f") for end in (gains[name].min(0), gains[name].max(0))]
        lines.append(_line(name, *(_pair(one, ".0f") for one in gains[name]), " to ".join(ends)))
    return "\n".join(lines)


def gain(row: Mapping[str, Any], name: str) -> list[float]:
    """Percent of each log ratio's variance that knowing an unknown takes away in a case; 0 where it is none there."""
    found = row["unknowns"].get(name)
    if found is None:
        return [0.0 for _ in NAMES]
    return [100.0 * (1.0 - (without / all_) ** 2) for without, all_ in zip(found["without"], row["together"])]


def _pair(values: Sequence[float], form: str) -> str:
    return " / ".join(f"{value + 0.0:{form}}" for value in values)


def _head(columns: Sequence[str]) -> list[str]:
    return [_line(*columns), "|" + "---|" * len(columns)]


def _line(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
