"""Can a torso be given every spine that subjects are made of? Real spines from CT, procedural curves of 80 degrees.

``python benchmarks/shaping.py --spines CSV [--write] [--jobs 2] [--log FILE] [--mesh coarse fine own]``; a line a torso
goes to the log, and a run that was stopped goes on from it.

Spines are those that ``benchmarks/personalisation.py`` takes, at its body heights (139 to 180 cm). Curves are all kinds
of ``study.synthetic.spines.CURVES`` at ``CURVED``. Each torso is made by ``personalise.placing.place_vertebrae`` from
the coarse and the fine template and from the synthetic subjects' own. Told of each: whether the tissue mesh was kept or
built anew and why, its quality, how far the vertebrae are from where they were wanted, and CPU seconds.
"""

from __future__ import annotations

import argparse
import csv
import datetime
import json
import os
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from kept_rows import begun, prepare

from spinestiff.anatomy.template import MESHES, OWN_MESH, template_torso
from spinestiff.errors import SpinestiffError, SubjectError
from spinestiff.personalise.placing import place_vertebrae
from spinestiff.personalise.quality import SMALLEST_DIHEDRAL_DEG, SMALLEST_J, mesh_quality
from spinestiff.study.synthetic.spines import CURVES, curved_spine, real_spine

# Cobb angle and body height of each kind of curve.
CURVED = ((80.0, 140.0), (-80.0, 175.0))
HEIGHTS_CM = (139.0, 180.0)

# Mesh, kind ("spine" or a curve's), id of the spine or Cobb angle, body height.
Task = tuple[str, str, str, float]


def name_of(task: Task) -> str:
    """As in the log."""
    return f"{task[0]} {task[1]} {task[2]} {task[3]:.1f} cm"


def tasks(table: Path, meshes: Sequence[str]) -> tuple[list[Task], dict[str, str]]:
    """What is made, and by id why a spine of the table is none."""
    with table.open(newline="", encoding="utf-8-sig") as file:
        ids = list(dict.fromkeys(row["id"] for row in csv.DictReader(file)))
    shapes, skipped = [(curve, f"{cobb:g}", height) for curve in CURVES for cobb, height in CURVED], {}
    for number, spine in enumerate(ids):
        height = float(np.random.default_rng([1, number]).uniform(*HEIGHTS_CM))
        try:
            real_spine(template_torso(height), table, spine)
        except SubjectError as error:
            skipped[spine] = str(error).removeprefix(f"{table}: ")
            continue
        shapes.append(("spine", spine, height))
    return [(mesh, *shape) for mesh in meshes for shape in shapes], skipped


def made(table: Path, task: Task) -> dict[str, Any]:
    """One torso's record; "failed" where there is none."""
    mesh, kind, which, height = task
    template, lines = template_torso(height, mesh), []
    began = time.process_time()
    try:
        poses = real_spine(template, table, which) if kind == "spine" else curved_spine(template, float(which), kind)
        torso = place_vertebrae(template, *poses, observer=lines.append)
    except SpinestiffError as error:
        return {"failed": str(error), "cpu_seconds": round(time.process_time() - began, 2)}
    quality = mesh_quality(torso)
    off = np.linalg.norm(torso.rest_pose.bone_positions[torso.vertebra_bones] - poses[0], axis=1).max()
    return {
        "mesh": "rebuilt" if lines else "kept",
        **({"why": lines[0]} if lines else {}),
        "nodes": len(torso.tissue.rest_positions),
        "smallest_j": round(quality.smallest_j, 3),
        "smallest_dihedral_deg": round(quality.smallest_dihedral_deg, 2),
        "off_mm": round(float(off), 3),
        "cpu_seconds": round(time.process_time() - began, 2),
    }


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Counts and the worst of each figure."""
    done = [row for row in rows if "failed" not in row]
    seconds = [row["cpu_seconds"] for row in done]
    return {
        "torsos": len(rows),
        "failures": len(rows) - len(done),
        "rebuilt": sum(row["mesh"] == "rebuilt" for row in done),
        "smallest_j": min(row["smallest_j"] for row in done),
        "smallest_dihedral_deg": min(row["smallest_dihedral_deg"] for row in done),
        "off_mm": max(row["off_mm"] for row in done),
        "cpu_seconds": {"median": round(float(np.median(seconds)), 1), "largest": max(seconds)},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--spines", type=Path, required=True)
    parser.add_argument("--mesh", nargs="+", choices=(*MESHES, OWN_MESH), default=(*MESHES, OWN_MESH))
    parser.add_argument("--write", action="store_true", help="store the result in benchmarks/results/")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--log", type=Path, help="a line a torso; a run that was stopped goes on where it was")
    arguments = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    wanted, skipped = tasks(arguments.spines, arguments.mesh)
    known: dict[str, dict[str, Any]] = {}
    if arguments.log:
        prepare(arguments.log)
        known = {row.pop("name"): row for row in begun(arguments.log)}
    todo = [task for task in wanted if name_of(task) not in known]
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for task, row in zip(todo, pool.map(partial(made, arguments.spines), todo)):
            known[name_of(task)] = row
            if arguments.log:
                with arguments.log.open("a", encoding="utf-8") as log:
                    print(json.dumps({"name": name_of(task), **row}), file=log)
    result: dict[str, Any] = {}
    for mesh in arguments.mesh:
        for what, spines in (("spines", True), ("curves", False)):
            rows = [known[name_of(task)] for task in wanted if task[0] == mesh and (task[1] == "spine") == spines]
            result[f"{mesh}, {what}"] = summary(rows)
            print(f"{mesh}, {what}", json.dumps(result[f"{mesh}, {what}"]))
    failed = {name: row["failed"] for name, row in known.items() if "failed" in row}
    for name, why in failed.items():
        print(f"failed {name}: {why}")
    if arguments.write:
        stored = {
            "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
            "limits": {"smallest_j": SMALLEST_J, "smallest_dihedral_deg": SMALLEST_DIHEDRAL_DEG},
            **result,
            "failed": failed,
            "skipped": skipped,
            "torsos": {name_of(task): known[name_of(task)] for task in wanted},
        }
        path = Path(__file__).parent / "results" / "shaping.json"
        path.write_text(json.dumps(stored, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
