"""Calibrate the default Young's modulus of the tissue: one number a mesh.

Seven bodies after the paper's Table 2, with Table 4's ratios, are pushed with Table 2's forces. The modulus is the one
at which their median force per degree of curve change is 3.66 N per degree, which Wong et al. (J Clin Med 2024;
13:7809) measured with the same set-up on 21 patients. The curve change is the largest change of tilt between two
vertebrae. Everything else (spread over subjects, sizes of displacement) is left unfitted.

Run ``python benchmarks/calibrate_tissue.py [--mesh coarse|fine]``; it prints the modulus and a row a subject, and with
``--write`` stores them in benchmarks/results/. Copy the modulus into anatomy/stiffness.py whenever element, mesh,
template, joints or supports change. Other readings of the paper have a modulus of their own: ``--pelvis hinge``, and
``--tissue kept|literal``, where the tissue's ratio scales mu alone (search from ``--low 0.05``, ``0.008``).
"""

from __future__ import annotations

import argparse
import datetime
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
from elements import linear_torso
from scipy.optimize import brentq

from spinestiff.anatomy.names import RIBS
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import DEFAULT_POISSON, StiffnessRatios, lame_parameters, stiffness_ratios
from spinestiff.anatomy.template import MESHES, template_torso
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.curves.tilts import CobbChange, SpineTilts, cobb_change, tilts
from spinestiff.imaging.features import silhouette_shares, state_features
from spinestiff.imaging.projection import frontal_view
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import LoadCase, rib_push
from spinestiff.mechanics.supports import PELVES, three_point_supports
from spinestiff.personalise.placing import place_vertebrae
from spinestiff.study import paper
from spinestiff.study.synthetic.spines import CURVES, curved_spine

TARGET_N_PER_DEG = 3.66
# lambda tied to mu on ten-node tetrahedra (the package's); lambda kept at its default; and that on linear tetrahedra.
TISSUES = ("tied", "kept", "literal")
LOWEST_RIB = 10  # the last one that is joined to the sternum


class Row(NamedTuple):
    """Of Tables 2 and 4 of the paper: a subject, its largest push (above 0: towards left curvature) and its ratios."""

    height_cm: float
    cobb_deg: float
    curve: str
    force_n: float
    bending: float
    tissue: float
    age: float = 13.0
    sex: paper.Sex = "female"


SUBJECTS = tuple(Row(*(getattr(one, name) for name in Row._fields)) for one in paper.SUBJECTS)


def apex_level(torso: TorsoModel, curve: str, side: str) -> float:
    """The rib, 1 to 10, whose lateral point lies at the height of the curve's apex.

    Where the paper's pushes acted is not stated; ribs slope, so rib 8 would act on T11.
    """
    spine = torso.rest_pose.bone_positions[torso.vertebra_bones, 1]
    apex = spine[-1] + CURVES[curve][0][0] * (spine[0] - spine[-1])
    rows = [RIBS.index(f"R{i}_{side[0].upper()}") for i in range(1, LOWEST_RIB + 1)]
    ribs = torso.landmarks["rib_lateral"][rows].positions(torso.rest_pose)[:, 1]
    return float(np.interp(-apex, -ribs, np.arange(1, LOWEST_RIB + 1)))


class Body:
    """A subject's torso, ready to be pushed at any tissue modulus."""

    def __init__(self, row: Row, mesh: str, pelvis: str = "level", tissue: str = "tied") -> None:
        template = template_torso(row.height_cm, mesh, age_years=row.age, sex=row.sex)
        self.row, self.tissue = row, tissue
        self.torso = place_vertebrae(template, *curved_spine(template, row.cobb_deg, row.curve))
        if tissue == "literal":
            self.torso = linear_torso(self.torso)
        self.side = "right" if row.force_n > 0 else "left"
        self.level = apex_level(self.torso, row.curve, self.side)
        self.problem = EquilibriumProblem(self.torso, three_point_supports(self.torso, self.side, pelvis))
        self.view = frontal_view(centre=(0.0, 200.0, 0.0))
        self.shares = silhouette_shares(self.torso, self.view, self.torso.rest_pose)
        self.state = self.torso.rest_pose

    def load(self) -> LoadCase:
        """The subject's largest push."""
        return rib_push(self.torso, self.side, self.level, abs(self.row.force_n))

    def ratios(self, tissue: float = 1.0) -> StiffnessRatios:
        """The subject's ratios of Table 4, the default tissue itself ``tissue`` times as stiff."""
        if self.tissue == "tied":
            return stiffness_ratios({"lateral_bending": self.row.bending, "tissue": self.row.tissue * tissue})
        mu = {"tissue_mu": self.row.tissue * tissue, "tissue_lambda": tissue}
        return stiffness_ratios({"intervertebral_bending": self.row.bending, **mu})

    def response(self, young_mpa: float) -> tuple[float, float]:
        """Change of tilt, degrees, and RMS displacement of the vertebrae, mm, under the largest push."""
        mu = float(self.torso.tissue.lame_mu[0])
        ratios = self.ratios(lame_parameters(young_mpa, DEFAULT_POISSON)[0] / mu)
        self.state = self.problem.solve(self.load(), ratios, self.state).require().state
        return self.change(self.state).tilt, self.moved(self.state)

    def moved(self, state: TorsoState) -> float:
        """RMS displacement of the vertebrae from rest, mm."""
        bones = self.torso.vertebra_bones
        moved = state.bone_positions[bones] - self.torso.rest_pose.bone_positions[bones]
        return float(np.sqrt(np.mean(np.sum(moved**2, axis=1))))

    def change(self, state: TorsoState) -> CobbChange:
        """Change of the Cobb angle from rest in its three forms."""
        return cobb_change(self._tilts(self.torso.rest_pose), self._tilts(state))

    def corners(self, state: TorsoState) -> np.ndarray:
        """(17, 4, 2) mm, the vertebrae's corners in the frontal picture, at the patient plane."""
        return state_features(self.torso, self.view, state, self.shares).corners

    def _tilts(self, state: TorsoState) -> SpineTilts:
        return tilts(self.torso.vertebrae, self.corners(state), self.view)


def calibrated(bodies: list[Body], low: float, high: float) -> float:
    """Young's modulus, MPa, at which the bodies' median force per degree is the target."""

    def miss(log_young: float) -> float:
        young = float(np.exp(log_young))
        found = float(np.median([abs(body.row.force_n / body.response(young)[0]) for body in bodies]))
        print(f"E = {young:.4f} MPa: median {found:.3f} N per degree", flush=True)
        return found - TARGET_N_PER_DEG

    # The stiffer end first: its equilibria are where the softer ones start, which from rest cost many times as much.
    return float(np.exp(brentq(miss, np.log(high), np.log(low), xtol=2e-3)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mesh", choices=MESHES, default="coarse")
    parser.add_argument("--pelvis", choices=PELVES, default="level", help="its support")
    parser.add_argument("--tissue", choices=TISSUES, default="tied", help="lambda; literal: kept, linear")
    parser.add_argument("--low", type=float, default=0.1, help="MPa, lower end of the search")
    parser.add_argument("--high", type=float, default=0.3, help="MPa, upper end")
    parser.add_argument("--write", action="store_true", help="store the result in benchmarks/results/")
    arguments = parser.parse_args()
    bodies = [Body(row, arguments.mesh, arguments.pelvis, arguments.tissue) for row in SUBJECTS]
    young = calibrated(bodies, arguments.low, arguments.high)
    rows = []
    for body in bodies:
        tilt, moved = body.response(young)
        found = {"level": round(body.level, 2), "tilt_deg": round(tilt, 2)}
        found |= {"n_per_deg": round(abs(body.row.force_n / tilt), 2), "rms_mm": round(moved, 2)}
        rows.append({**body.row._asdict(), **found})
        print(rows[-1])
    result = {
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "mesh": arguments.mesh,
        "pelvis": arguments.pelvis,
        "tissue": arguments.tissue,
        "nodes": len(bodies[0].torso.tissue.rest_positions),
        "young_mpa": round(young, 4),
        "target_n_per_deg": TARGET_N_PER_DEG,
        "subjects": rows,
    }
    print(json.dumps({k: v for k, v in result.items() if k != "subjects"}))
    if arguments.write:
        readings = [word for word in (arguments.pelvis, arguments.tissue) if word not in ("level", "tied")]
        name = "_".join(("calibrate_tissue", arguments.mesh, *readings))
        path = Path(__file__).parent / "results" / f"{name}.json"
        path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
