"""The demo's pipeline on several subjects of known stiffness, judged against fixed criteria.

Subjects: the procedural one of ``spinestiff demo`` and, with ``--spines CSV``, the six spines of the table with the
largest coronal curves as rest shapes. All at bending 0.10, tissue 0.04, 60 N; training at 1/3 and 2/3 of the force,
validation at full force and at a second rib. A row holds the corner RMSE by predictor and four verdicts:

    near_oracle     fit <= 1.15 x truth on the estimator's own mesh + 0.2 mm, both held-out frames
    default_worse   default >= 3 x truth, both frames
    beats_baselines fit below rest, default, extrapolation and single ratio at the second rib
    truth_inside    true ratios inside the joint 95 % region

The first and the third are also told of the forecast, the estimate's prediction with the errors that training frames
show.

``python benchmarks/subjects.py FOLDER [--spines CSV] [--write]`` (four to seven minutes a subject, kept in FOLDER);
``--markdown`` instead of FOLDER prints what is stored as the tables of docs/validation.md.
"""

from __future__ import annotations

import argparse
import csv
import datetime
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from spinestiff.anatomy.template import template_torso
from spinestiff.errors import SpinestiffError
from spinestiff.files import read_json
from spinestiff.study.runner import run_steps
from spinestiff.study.synthetic.recipe import Recipe
from spinestiff.study.synthetic.spines import real_spine
from spinestiff.study.synthetic.subject import made_by, synthesise, truth_path
from spinestiff.study.visit import open_visit
from spinestiff.subject.assessment_outcome import Assessment, Comparison
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.outcomes import Tracked
from spinestiff.subject.run_record import read_outcome

RATIOS, FORCE_N = (0.10, 0.04), 60.0
SPINES = 6
RESULTS = Path(__file__).parent / "results" / "subjects.json"
SHOWN = ("rest", "default", "extrapolation", "single_ratio", "fit", "forecast", "fitted_supports", "truth")
BASELINES = ("rest", "default", "extrapolation", "single_ratio")


def most_curved(table: Path, count: int) -> list[tuple[str, float]]:
    """Ids and coronal angles (largest difference of a vertebra's tilt, degrees) of the most curved spines."""
    torso = template_torso(157.0)
    with table.open(newline="", encoding="utf-8") as file:
        ids = dict.fromkeys(row["id"] for row in csv.DictReader(file))
    found = []
    for spine_id in ids:
        try:
            _, frames = real_spine(torso, table, spine_id)
        except SpinestiffError:
            continue
        tilt = np.degrees(np.arctan2(-frames[:, 0, 1], frames[:, 1, 1]))
        found.append((spine_id, float(tilt.max() - tilt.min())))
    return sorted(found, key=lambda entry: -entry[1])[:count]


def run_subject(folder: Path, recipe: Recipe) -> dict[str, object]:
    """Make the subject if it is not there, run all steps, and judge."""
    began = time.perf_counter()
    if not made_by(folder, recipe):
        synthesise(folder, recipe)
    visit = open_visit(folder, truth=truth_path(folder))
    run_steps(visit, ("track", "personalise", "estimate", "assess"))
    estimate, frames = read_outcome(visit.subject, Estimate), read_outcome(visit.subject, Assessment).frames
    errors = {frame.push: frame.rmse_mm for frame in frames}
    missing = {"main", "second"} - set(errors)
    if missing:
        raise SpinestiffError(f"no held-out frame of push {sorted(missing)[0]}: {'; '.join(estimate.notes)}")
    second, predictors = errors["second"], {"fit": "", "forecast": "_forecast"}
    return {
        "subject": folder.name,
        "rest_cobb_deg": round(read_json(truth_path(folder))["rest_cobb_deg"], 1),
        "vertebrae_seen": len(read_outcome(visit.subject, Tracked).pushes["main"].vertebrae),
        "ratios": {name: [ratio.value, ratio.low, ratio.high] for name, ratio in estimate.ratios.items()},
        "rmse_mm": errors,
        "tilt_change_deg": {
            frame.push: {
                name: None if change is None else change.tilt
                for name, change in frame.cobb_change_deg.items()
                if name in ("measured", "fit", "truth")
            }
            for frame in frames
        },
        **{
            f"near_oracle{suffix}": all(_at_most(e[name], 1.15, e["truth"], 0.2) for e in errors.values())
            for name, suffix in predictors.items()
        },
        "default_worse": all(_at_most(e["truth"], 1.0 / 3.0, e["default"]) for e in errors.values()),
        **{
            f"beats_baselines{suffix}": all(_at_most(second[name], 1.0, second[other]) for other in BASELINES)
            for name, suffix in predictors.items()
        },
        "truth_inside": read_outcome(visit.subject, Comparison).inside,
        "seconds": round(time.perf_counter() - began, 1),
    }


def _at_most(error: float | None, factor: float, other: float | None, more: float = 0.0) -> bool:
    """Whether an error is at most so many times another; not where a predictor made none."""
    return error is not None and other is not None and error <= factor * other + more


def markdown(rows: list[dict[str, Any]]) -> str:
    """The errors and the estimates as tables."""
    lines = ["| subject | rest Cobb | frame | " + " | ".join(name.replace("_", " ") for name in SHOWN) + " |"]
    lines.append("|---" * (3 + len(SHOWN)) + "|")
    made = [row for row in rows if "failed" not in row]
    for row in made:
        for push, frame in (("main", "full force"), ("second", "second rib")):
            who = (row["subject"], f"{row['rest_cobb_deg']:+.1f}°") if push == "main" else ("", "")
            found = [row["rmse_mm"][push][name] for name in SHOWN]
            errors = ["-" if one is None else f"{one:.2f}" for one in found]
            lines.append("| " + " | ".join((*who, frame, *errors)) + " |")
    names = {"lateral_bending": "bending", "tissue": "tissue"}
    verdicts = ("near_oracle", "near_oracle_forecast", "default_worse", "beats_baselines", "truth_inside")
    lines += ["", "| subject | " + " | ".join(f"{names[name]}, 95 %" for name in names) + " | "]
    lines[-1] += " | ".join(name.replace("_", " ") for name in verdicts) + " |"
    lines.append("|---" * (1 + len(names) + len(verdicts)) + "|")
    for row in made:
        found = ["{:.3g}, {:.2g} to {:.2g}".format(*row["ratios"][name]) for name in names]
        said = ["yes" if row[name] else "no" for name in verdicts]
        lines.append("| " + " | ".join((row["subject"], *found, *said)) + " |")
    return "\n".join([*lines, *(f"\n{row['subject']}: {row['failed']}" for row in rows if "failed" in row)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--spines", type=Path)
    parser.add_argument("--write", action="store_true", help="store the result in benchmarks/results/")
    parser.add_argument("--markdown", action="store_true", help="print what is stored as tables")
    arguments = parser.parse_args()
    if arguments.markdown:
        print(markdown(json.loads(RESULTS.read_text(encoding="utf-8"))["subjects"]))
        return
    if arguments.folder is None:
        parser.error("FOLDER or --markdown is wanted")
    recipes = {"demo": Recipe(seed=0, ratios=RATIOS, force_n=FORCE_N)}
    if arguments.spines:
        for number, (spine_id, angle) in enumerate(most_curved(arguments.spines, SPINES), start=1):
            print(f"spine {number}: {spine_id}, coronal angle {angle:.1f} degrees", flush=True)
            recipes[f"spine{number}"] = Recipe(
                seed=number, ratios=RATIOS, force_n=FORCE_N, spine=(arguments.spines, spine_id)
            )
    rows = []
    for name, recipe in recipes.items():
        try:
            rows.append(run_subject(arguments.folder / name, recipe))
        except SpinestiffError as error:
            rows.append({"subject": name, "failed": str(error)})
        print(json.dumps(rows[-1]), flush=True)
    if arguments.write:
        result = {"date": datetime.datetime.now(datetime.UTC).date().isoformat(), "subjects": rows}
        RESULTS.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
