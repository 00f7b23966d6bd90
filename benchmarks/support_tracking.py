"""How well the pelvis' obliquity and the shoulder's place are measured (docs/tracking.md).

    python benchmarks/support_tracking.py [--json] [--write]

A torso of known stiffness is pushed while its pelvis turns and its shoulder's pad moves by known amounts, and is
radiographed. The tops of the iliac wings and the humeral head are marked in the first frame, each off by 2 mm, and
followed. Errors are those of a frame's obliquity and lateral place, in all frames after the first. ``--write`` stores
benchmarks/results/support_tracking.json.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.imaging.projection import frontal_view
from spinestiff.imaging.radiograph import Radiograph
from spinestiff.imaging.synthetic.acquisition import Acquisition, Gauge, acquire
from spinestiff.imaging.tracking import support_motion
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.places import SupportPlace
from spinestiff.mechanics.supports import three_point_supports

RESULTS = Path(__file__).parent / "results" / "support_tracking.json"
FRAMES, MARK_SD_MM = 5, 2.0
RATIOS = {"lateral_bending": 0.1, "tissue": 0.05}
WING_MM = 75.0  # beside the midline from there on


@dataclass(frozen=True)
class Case:
    """A push from the right whose last frame has this obliquity (degrees), shoulder place (mm) and force (N)."""

    seed: int
    obliquity: float
    shoulder: float
    force: float
    level: float


# FLESH_MM (imaging/tracking/supports.py) was set on these.
CASES = (
    Case(1, 4.0, 4.0, 60.0, 8.0),
    Case(2, -2.0, 2.0, 40.0, 8.0),
    Case(3, 0.0, 0.0, 60.0, 6.0),
    Case(4, 3.0, -3.0, 50.0, 10.0),
    Case(5, 1.0, 1.0, 20.0, 8.0),
    Case(6, -4.0, 4.0, 60.0, 9.0),
    Case(11, 3.5, 4.0, 60.0, 8.0),
    Case(12, -3.0, 2.0, 40.0, 7.0),
    Case(13, 0.0, 0.0, 60.0, 6.0),
    Case(14, 2.0, -3.0, 50.0, 10.0),
    Case(15, 1.0, 1.0, 20.0, 8.0),
    Case(16, -4.0, 3.0, 60.0, 9.0),
)


def wing_tops(torso: TorsoModel) -> PointsOnBones:
    """The highest points of the left and the right iliac wing."""
    pelvis = torso.bone("pelvis")
    vertices = torso.surface_positions(torso.rest_pose, pelvis)
    sides = [vertices[sign * vertices[:, 0] > WING_MM] for sign in (1.0, -1.0)]
    tops = np.stack([side[np.argmax(side[:, 1])] for side in sides])
    return PointsOnBones.at(torso.rest_pose, np.array([pelvis, pelvis]), tops)


def measured(torso: TorsoModel, case: Case) -> Floats:
    """(FRAMES - 1, 6): obliquity as it was, found and its error, degrees; shoulder alike, mm."""
    spine = torso.rest_pose.bone_positions[torso.vertebra_bones]
    view = frontal_view(pixel=0.417, centre=(0.0, 0.5 * float(spine[0, 1] + spine[-1, 1]), 0.0))
    problem, ratios = EquilibriumProblem(torso, three_point_supports(torso, "right")), stiffness_ratios(RATIOS)
    shares, state, states = np.linspace(0.0, 1.0, FRAMES), torso.rest_pose, []
    for share in shares:
        place = SupportPlace(float(np.radians(case.obliquity * share)), case.shoulder * float(share))
        push = rib_push(torso, "right", case.level, case.force * float(share))
        state = problem.with_place(place).solve(push, ratios, state).require().state
        states.append(state)
    gauge = Gauge(push.points, push.forces)
    pictures = acquire(torso, states, view, Acquisition(), person=case.seed, seed=case.seed, gauge=gauge)
    frames = [Radiograph(picture.astype(np.float32), view) for picture in pictures]
    random, rest = np.random.default_rng(case.seed), torso.rest_pose
    marks = {"pelvis": wing_tops(torso), "shoulder": torso.landmarks["humerus_head"][[0]]}
    points = {}
    for name, where in marks.items():
        places = view.project(where.positions(rest))
        off = random.normal(0.0, MARK_SD_MM * view.magnification, places.shape)
        points[name] = view.pixels(places + off)
    pelvis, shoulder = support_motion(frames, points)
    if not (pelvis.turn_seen.all() and shoulder.seen.all()):
        raise SystemExit(f"seed {case.seed}: a support was lost")
    found = [case.obliquity * shares, np.degrees(pelvis.turn), np.degrees(pelvis.turn_error)]
    found += [case.shoulder * shares, shoulder.displacement[:, 0], shoulder.error]
    return np.stack(found, axis=1)[1:]


def summary(name: str, unit: str, rows: Floats) -> dict[str, object]:
    """Of rows (n, 3) of true, found and standard error."""
    error = rows[:, 1] - rows[:, 0]
    return {
        "what": name,
        "unit": unit,
        "frames": len(rows),
        "rms": round(float(np.sqrt(np.mean(error**2))), 3),
        "largest": round(float(np.abs(error).max()), 3),
        "mean_standard_error": round(float(rows[:, 2].mean()), 3),
        "rms_over_standard_error": round(float(np.sqrt(np.mean((error / rows[:, 2]) ** 2))), 2),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print everything as JSON")
    parser.add_argument("--write", action="store_true", help=f"store {RESULTS.name}")
    options = parser.parse_args()
    torso = template_torso(157.0, "coarse")
    rows = np.concatenate([measured(torso, case) for case in CASES])
    found = [summary("obliquity", "degrees", rows[:, :3]), summary("shoulder", "mm", rows[:, 3:])]
    text = json.dumps(found, indent=1)
    if options.write:
        RESULTS.write_text(text + "\n", encoding="utf-8")
    if options.json:
        print(text)
    else:
        for entry in found:
            print(", ".join(f"{key} {value}" for key, value in entry.items()))


if __name__ == "__main__":
    main()
