"""Dead loads on the template: what the pelvis bears, and how far the torso falls over.

The coarse template pushed from the right at rib 8 with all three forces of Eqs. 1 and 2 (``Rig(pelvis="dead-loads")``),
at four pairs of bending and tissue ratios, with 20, 40 and 60 N, each from the equilibrium before. Told of each: the
pelvis' force and its moments about the front-to-back axis and the vertical, about its origin, and how far T1 moves
sideways. ``docs/mechanics.md`` quotes it.

    python benchmarks/dead_loads.py [--write]
    python benchmarks/dead_loads.py --json
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from kept_rows import measure_once, rounded

from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.push import PushSite, Rig, push_heights, push_load, push_problem

RESULTS = Path(__file__).parent / "results" / "dead_loads.json"
RIG, SIDE, LEVEL = Rig("dead-loads"), "right", 8.0
HEIGHT_CM = 157.0
RATIOS = ((1.0, 1.0), (0.3, 0.3), (0.1, 0.1), (0.1, 0.05))  # bending, tissue
FORCES_N = (20.0, 40.0, 60.0)


def rows(torso: TorsoModel) -> Iterator[dict[str, Any]]:
    """What the pelvis bears under each force, N and N m, and T1's way to the side, mm.

    Raises
    ------
    EquilibriumError : no equilibrium.
    """
    shoulder, pelvis, push = push_heights(torso, SIDE, LEVEL)
    site = PushSite(SIDE, LEVEL, shoulder - pelvis, shoulder - push)
    problem = push_problem(torso, SIDE, RIG)
    t1 = torso.vertebra_bones[0]
    for bending, tissue in RATIOS:
        ratios = stiffness_ratios({"lateral_bending": bending, "tissue": tissue}, torso.joints.kinds)
        state = None
        for force in FORCES_N:
            found = problem.solve(push_load(torso, site, force, RIG), ratios, state).require()
            state = found.state
            (held,) = (one for one in found.reactions if one.name == "pelvis")
            yield {
                "bending": bending,
                "tissue": tissue,
                "force_n": force,
                "pelvis_force_n": float(np.linalg.norm(held.force)),
                "front_to_back_n_m": float(held.moment[2] / 1e3),
                "vertical_n_m": float(held.moment[1] / 1e3),
                "t1_mm": float(abs(state.bone_positions[t1, 0] - torso.rest_pose.bone_positions[t1, 0])),
            }


def measured() -> dict[str, Any]:
    """All rows, and how high above the pelvis' origin the push acts."""
    torso = template_torso(HEIGHT_CM, "coarse")
    load = rib_push(torso, SIDE, LEVEL, 1.0)
    height = np.abs(load.forces[:, 0]) @ load.points.positions(torso.rest_pose)[:, 1]
    above = float(height - torso.rest_pose.bone_positions[torso.bone("pelvis"), 1])
    return {"push_above_pelvis_mm": round(above, 1), "rows": [rounded(row) for row in rows(torso)]}


if __name__ == "__main__":
    measure_once(__doc__, RESULTS, measured)
