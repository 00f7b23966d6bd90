"""How much more a larger trunk resists: ``Priors.trunk_power``, which tissue's resistance goes with.

    python benchmarks/trunk_size.py [--rerun] [--json]

Bodies of three ages are pushed near three ribs, at two pairs of ratios. Then the trunk is made broader or deeper, by
its skin alone (as ``trunk`` in ``subject.json`` does it) or as a body of another mass has it (ribs and skin), and the
tissue ratio is told at which the first body would have moved as far: over the change of the trunk's size this is the
power.
Prints the stored figures, or makes them anew (about two minutes).
"""

from __future__ import annotations

import argparse
import datetime
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.template.body import usual_mass
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.estimation.priors import Priors
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.personalise.measured_skin import TrunkSize, trunk_sizes, with_trunk_sizes

RESULTS = Path(__file__).parent / "results" / "trunk_size.json"
BODIES = ((10.0, "female", 138.0), (13.0, "female", 157.0), (16.0, "male", 174.0))
RATIOS = ((0.03, 0.08), (0.3, 0.3))  # bending, tissue
LEVELS = (5.5, 8.0, 10.0)
FORCE_N = 20.0
AT = ("T4", "T8", "T12", "L3")
CHANGE, MASS_CHANGE = 0.06, 0.15  # relative; of the log
STEP = 0.1  # of the log of the tissue ratio


def rms_motion(torso: TorsoModel, level: float, bending: float, tissue: float) -> float:
    """mm sideways, root mean square over the vertebrae, under a push from the left."""
    problem = EquilibriumProblem(torso, three_point_supports(torso, "left"))
    stiffness = stiffness_ratios({"lateral_bending": bending, "tissue": tissue}, torso.joints.kinds)
    state = problem.solve(rib_push(torso, "left", level, FORCE_N), stiffness).require().state
    moved = (state.bone_positions - torso.rest_pose.bone_positions)[torso.vertebra_bones, 0]
    return float(np.sqrt(np.mean(moved**2)))


def changed_bodies(age: float, sex: str, height: float) -> tuple[TorsoModel, Mapping[str, TorsoModel]]:
    """A body, and the same with another trunk."""

    def of_mass(change: float) -> TorsoModel:
        mass = usual_mass(height, age, sex) * float(np.exp(change))  # type: ignore[arg-type]
        return template_torso(height, age_years=age, sex=sex, mass_kg=mass)  # type: ignore[arg-type]

    base = of_mass(0.0)
    own = trunk_sizes(base, AT)[0]

    def sized(breadth: float, depth: float) -> TorsoModel:
        wanted = {at: TrunkSize(breadth * size.breadth_mm, depth * size.depth_mm) for at, size in own.items()}
        return with_trunk_sizes(base, wanted)

    skins = {
        f"{name} {sign:+.0%}": sized(*(1.0 + sign * np.array(which)))
        for name, which in (("breadth", (1.0, 0.0)), ("depth", (0.0, 1.0)))
        for sign in (-CHANGE, CHANGE)
    }
    return base, {**skins, **{f"mass {sign:+.0%}": of_mass(sign) for sign in (-MASS_CHANGE, MASS_CHANGE)}}


def measured() -> list[dict[str, Any]]:
    """A row each body, ratios, push and change: the trunk's size, and the tissue ratio that stands for it."""
    rows = []
    for body in BODIES:
        base, others = changed_bodies(*body)
        own = trunk_sizes(base, AT)[0]
        for bending, tissue in RATIOS:
            for level in LEVELS:
                moved = rms_motion(base, level, bending, tissue)
                stiffer, softer = (rms_motion(base, level, bending, tissue * float(np.exp(s))) for s in (STEP, -STEP))
                slope = np.log(stiffer / softer) / (2.0 * STEP)
                for name, torso in others.items():
                    now = trunk_sizes(torso, AT)[0]
                    sizes = [
                        [np.log(getattr(now[at], which) / getattr(own[at], which)) for at in AT]
                        for which in ("breadth_mm", "depth_mm")
                    ]
                    breadth, depth = (float(np.mean(one)) for one in sizes)
                    as_tissue = float(np.log(rms_motion(torso, level, bending, tissue) / moved) / slope)
                    rows.append(
                        {"age": body[0], "sex": body[1], "bending": bending, "tissue": tissue, "level": level}
                        | {"change": name, "breadth": round(breadth, 4), "depth": round(depth, 4)}
                        | {"as_tissue": round(as_tissue, 4)}
                    )
                    print(rows[-1], flush=True)
    return rows


def show(stored: Mapping[str, Any]) -> None:
    """Medians and ranges, beside what the prior's powers say."""
    table = Table(title=f"a trunk of another size, as a change of the log of the tissue ratio ({stored['date']})")
    for column in ("change", "breadth", "depth", "as tissue: median (range)", "by the prior's powers"):
        table.add_column(column)
    for change in dict.fromkeys(row["change"] for row in stored["rows"]):
        rows = [row for row in stored["rows"] if row["change"] == change]
        breadth, depth, found = (np.array([row[key] for row in rows]) for key in ("breadth", "depth", "as_tissue"))
        powers = np.median(np.column_stack([breadth, depth]) @ Priors().trunk_power)
        table.add_row(
            change,
            f"{np.median(breadth):+.3f}",
            f"{np.median(depth):+.3f}",
            f"{np.median(found):+.3f} ({found.min():+.3f} to {found.max():+.3f})",
            f"{powers:+.3f}",
        )
    Console().print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rerun", action="store_true", help="measure anew and store")
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    if asked.rerun:
        stored = {"date": datetime.date.today().isoformat(), "rows": measured()}
        RESULTS.write_text(json.dumps(stored, indent=1) + "\n")
    stored = json.loads(RESULTS.read_text())
    if asked.json:
        print(json.dumps(stored, indent=1))
    else:
        show(stored)


if __name__ == "__main__":
    main()
