"""Calibrate the default Young's modulus of the tissue: one number a mesh.

Seven bodies after the paper's Table 2, with Table 4's ratios, are pushed with Table 2's forces. The modulus is the one
at which their median force per degree of curve change is 3.66 N per degree, which Wong et al. (J Clin Med 2024;
13:7809) measured with the same set-up on 21 patients. The curve change is the largest change of tilt between two
vertebrae. Everything else (spread over subjects, sizes of displacement) is left unfitted.

Run ``python benchmarks/calibrate_tissue.py [--mesh coarse|fine]``; it prints the modulus and a row a subject, and with
``--write`` stores them in benchmarks/results/. Copy the modulus into anatomy/stiffness.py and rebuild the meshes
(tools/build_torso.py) whenever element, mesh or template change.
"""

from __future__ import annotations

import argparse
import datetime
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from spinestiff.anatomy.stiffness import DEFAULT_POISSON, lame_parameters, stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.imaging.features import silhouette_choice, state_features
from spinestiff.imaging.projection import frontal_view
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.personalise.shape import place_vertebrae
from spinestiff.study.metrics import cobb_change, tilts
from spinestiff.study.spines import curved_spine

TARGET_N_PER_DEG = 3.66
LEVELS = {"thoracic": 8.0, "thoracolumbar": 9.0, "lumbar": 10.0}


class Row(NamedTuple):
    """Tables 2 and 4 of the paper: a subject, its largest push (above 0: towards left curvature) and its ratios."""

    height_cm: float
    cobb_deg: float
    curve: str
    force_n: float
    bending: float
    tissue: float


SUBJECTS = (
    Row(157, 11, "thoracic", -59, 0.10, 0.01),
    Row(160, 16, "lumbar", 114, 0.19, 0.02),
    Row(144, 15, "thoracic", -60, 0.02, 0.02),
    Row(146, -10, "thoracic", 79, 0.05, 0.09),
    Row(168, 16, "lumbar", 88, 0.01, 0.11),
    Row(139, 11, "thoracolumbar", -45, 0.06, 0.02),
    Row(165, 7, "thoracic", -92, 0.63, 0.15),
)


class Body:
    """A subject's torso, ready to be pushed at any tissue modulus."""

    def __init__(self, row: Row, mesh: str) -> None:
        template = template_torso(row.height_cm, mesh)
        self.row = row
        self.torso = place_vertebrae(template, *curved_spine(template, row.cobb_deg, row.curve))
        self.side = "right" if row.force_n > 0 else "left"
        self.problem = EquilibriumProblem(self.torso, three_point_supports(self.torso, self.side))
        self.view = frontal_view(centre=(0.0, 200.0, 0.0))
        self.choice = silhouette_choice(self.torso, self.view, self.torso.rest_pose)
        self.state = self.torso.rest_pose

    def response(self, young_mpa: float) -> tuple[float, float]:
        """Change of tilt, degrees, and RMS displacement of the vertebrae, mm, under the largest push."""
        mu = float(self.torso.tissue.lame_mu[0])
        scale = lame_parameters(young_mpa, DEFAULT_POISSON)[0] / mu
        ratios = stiffness_ratios({"lateral_bending": self.row.bending, "tissue": self.row.tissue * scale})
        load = rib_push(self.torso, self.side, LEVELS[self.row.curve], abs(self.row.force_n))
        self.state = self.problem.solve(load, ratios, self.state).require().state
        bones = self.torso.vertebra_bones
        moved = self.state.bone_positions[bones] - self.torso.rest_pose.bone_positions[bones]
        change = cobb_change(self._tilts(self.torso.rest_pose), self._tilts(self.state))
        return change.tilt, float(np.sqrt(np.mean(np.sum(moved**2, axis=1))))

    def _tilts(self, state):  # type: ignore[no-untyped-def]
        corners = state_features(self.torso, self.view, state, self.choice).corners
        return tilts(self.torso.vertebrae, corners, self.view)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mesh", choices=("coarse", "fine"), default="coarse")
    parser.add_argument("--low", type=float, default=0.5, help="MPa, where the search starts")
    parser.add_argument("--high", type=float, default=1.0, help="MPa, where it ends")
    parser.add_argument("--write", action="store_true", help="store the result in benchmarks/results/")
    arguments = parser.parse_args()
    bodies = [Body(row, arguments.mesh) for row in SUBJECTS]

    def newtons_per_degree(young: float) -> list[float]:
        return [abs(body.row.force_n / body.response(young)[0]) for body in bodies]

    def miss(log_young: float) -> float:
        found = float(np.median(newtons_per_degree(float(np.exp(log_young)))))
        print(f"E = {np.exp(log_young):.4f} MPa: median {found:.3f} N per degree", flush=True)
        return found - TARGET_N_PER_DEG

    young = float(np.exp(brentq(miss, np.log(arguments.low), np.log(arguments.high), xtol=2e-3)))
    rows = []
    for body, ratio in zip(bodies, newtons_per_degree(young)):
        tilt, moved = body.response(young)
        rows.append(
            {**body.row._asdict(), "tilt_deg": round(tilt, 2), "n_per_deg": round(ratio, 2), "rms_mm": round(moved, 2)}
        )
        print(rows[-1])
    result = {
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "mesh": arguments.mesh,
        "nodes": len(bodies[0].torso.tissue.rest_positions),
        "young_mpa": round(young, 4),
        "target_n_per_deg": TARGET_N_PER_DEG,
        "subjects": rows,
    }
    print(json.dumps({k: v for k, v in result.items() if k != "subjects"}))
    if arguments.write:
        path = Path(__file__).parent / "results" / f"calibrate_tissue_{arguments.mesh}.json"
        path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
