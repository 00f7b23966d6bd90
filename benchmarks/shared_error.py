"""What of an estimate's error comes from tracking, from the rest geometry and mesh, and from the stated pushes?

``python benchmarks/shared_error.py PEOPLE SCRATCH [--only NAME ...] [--few SEED ...] [--write [FILE]]``: PEOPLE holds
synthetic subjects with their truths beside them, as ``cohort_of_forty.py`` and ``spinestiff synth`` make them; those of
``--few``, people with few errors of ``coverage_rendered``, are made there. Each is tracked and personalised
in SCRATCH, and estimated on the fine mesh with

    nothing            known but what its folder says
    torso              the true rest geometry, on the mesh that the radiographs were made from
    torso, corners     and the true corners in place of the tracked ones
    all                and the true forces and ribs

Searches begin at the true ratios; there are no intervals. Printed are the errors of the log ratios, alone and over the
estimate's standard deviation. It goes on from what is in SCRATCH; a subject takes two to four CPU minutes.
"""

from __future__ import annotations

import argparse
import datetime
import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from coverage_rendered import rendered_subject

from spinestiff.arrays import Floats
from spinestiff.errors import SpinestiffError
from spinestiff.files import read_json
from spinestiff.study.fits import fit_pushes
from spinestiff.study.runner import run_steps
from spinestiff.study.synthetic.recipe import Recipe
from spinestiff.study.synthetic.subject import subject_torso, truth_path
from spinestiff.study.trials import known_of, push_set, rig_of
from spinestiff.study.visit import USUAL, open_visit
from spinestiff.subject.geometry_outcome import GeometryRecord
from spinestiff.subject.outcomes import Tracked, TrackedPush
from spinestiff.subject.records import PushRecord
from spinestiff.subject.run_record import read_outcome

RESULTS = Path(__file__).parent / "results" / "shared_error.json"
FEW_NODES = 15_000  # of their truths' meshes, as in coverage.py
GIVEN = {
    "nothing": (),
    "torso": ("torso",),
    "torso, corners": ("torso", "corners"),
    "all": ("torso", "corners", "pushes"),
}


def true_corners(found: TrackedPush, truth: Sequence[Mapping[str, Any]], vertebrae: Sequence[str]) -> TrackedPush:
    """A push with the corners that its radiographs were made from; ``truth`` has them of each frame."""
    rows, told = [vertebrae.index(name) for name in found.vertebrae], found.model_dump()
    for frame, one in zip(told["frames"], truth):
        frame["corners_px"] = np.array(one["corners_px"])[rows].tolist()
    return TrackedPush.model_validate(told)


def true_push(stated: PushRecord, recipe: Mapping[str, Any]) -> PushRecord:
    """A push with the forces and the rib that it was made with."""
    made = next(one for one in recipe["pushes"] if one["id"] == stated.id)
    forces = tuple(round(share * recipe["force_n"], 3) for share in made["shares"])
    return stated.model_copy(update={"forces_n": forces, "level": made["level"]})


def true_torso(recipe: Mapping[str, Any]):  # type: ignore[no-untyped-def]
    """The torso that the radiographs were made from."""
    told = ("seed", "age", "sex", "height_cm", "cobb_deg", "curve", "secondary", "spine", "mesh", "nodes")
    return subject_torso(Recipe(**{name: recipe[name] for name in told}))


def errors(person: Path, scratch: Path) -> dict[str, Any]:
    """Of one person, by what is given.

    Raises
    ------
    SpinestiffError : a step fails.
    """
    folder, truth = scratch / person.name, read_json(truth_path(person))
    if not folder.is_dir():
        shutil.copytree(person, folder)
    visit = open_visit(folder)
    run_steps(visit, ("track", "personalise"))
    tracked, record = read_outcome(visit.subject, Tracked).pushes, visit.subject.record
    covariance = np.array(read_outcome(visit.subject, GeometryRecord).covariance)
    known = known_of(record, covariance.reshape(6 * len(covariance), -1))
    recipe, ratios, found = truth["recipe"], truth["ratios"], {}
    torso = true_torso(recipe)
    for name, given in GIVEN.items():
        seen = dict(tracked)
        if "corners" in given:
            seen = {key: true_corners(one, truth["pushes"][key], truth["vertebrae"]) for key, one in seen.items()}
        pushes = [true_push(push, recipe) if "pushes" in given else push for push in record.pushes]
        own = torso if "torso" in given else visit.torso()
        fit = fit_pushes(push_set(own, pushes, seen, rig=rig_of(record), known=known), USUAL, ratios, extent="estimate")
        off = [float(np.log(fit.ratios.as_dict()[one] / ratios[one])) for one in USUAL]
        sd: Floats = np.sqrt(np.diag(fit.covariance))
        found[name] = {
            "status": fit.status.name,
            "log_error": dict(zip(USUAL, np.round(off, 4).tolist())),
            "over_sd": dict(zip(USUAL, np.round(off / sd, 3).tolist())),
        }
    return {"person": person.name, "ratios": ratios, "given": found}


def summarised(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Means and root mean squares over the people."""
    result: dict[str, Any] = {}
    for name in GIVEN:
        result[name] = {}
        for one in USUAL:
            off, over = (np.array([row["given"][name][key][one] for row in rows]) for key in ("log_error", "over_sd"))
            result[name][one] = {
                "mean_log_error": round(float(off.mean()), 3),
                "rms_log_error": round(float(np.sqrt(np.mean(off**2))), 3),
                "mean_over_sd": round(float(over.mean()), 2),
                "rms_over_sd": round(float(np.sqrt(np.mean(over**2))), 2),
            }
    return result


def main() -> None:
    """Estimate, compare, print."""
    parser = argparse.ArgumentParser(description="what an estimate's error comes from")
    parser.add_argument("people", type=Path)
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--only", nargs="+", help="names of people; else all")
    parser.add_argument("--few", nargs="+", type=int, default=(), metavar="SEED", help="people to be made first")
    parser.add_argument("--write", nargs="?", type=Path, const=RESULTS, metavar="FILE", help="keep what is in SCRATCH")
    asked = parser.parse_args()
    for folder in (asked.people, asked.scratch):
        folder.mkdir(parents=True, exist_ok=True)
    for seed in asked.few:
        person = asked.people / f"sub-{seed}"
        if not truth_path(person).is_file():
            try:
                rendered_subject(seed, FEW_NODES, person)
            except SpinestiffError as error:
                print(f"{person.name}: {error}", flush=True)
    there = sorted(path.name for path in asked.people.iterdir() if truth_path(path).is_file() and path.is_dir())
    for name in asked.only or there:
        kept = asked.scratch / f"{name}.json"
        if kept.is_file():
            continue
        try:
            row = errors(asked.people / name, asked.scratch)
        except SpinestiffError as error:
            print(f"{name}: {error}", flush=True)
            continue
        kept.write_text(json.dumps(row, indent=1) + "\n", encoding="utf-8")
        print(name, {given: one["log_error"] for given, one in row["given"].items()}, flush=True)
    rows = [read_json(path) for path in sorted(asked.scratch.glob("*.json"))]
    date = datetime.datetime.now(datetime.UTC).date().isoformat()
    result = {"date": date, "people": len(rows), "given": summarised(rows) if rows else {}, "rows": rows}
    print(json.dumps(result["given"], indent=1))
    if asked.write is not None:
        asked.write.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
