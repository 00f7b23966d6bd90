"""Does a cohort's group level find what was put into its people? Synthetic subjects through ``spinestiff cohort``.

``python benchmarks/cohort_of_forty.py FOLDER [--subjects 40] [--jobs 2] [--write]`` makes subjects of known stiffness
in FOLDER/in, runs ``spinestiff cohort FOLDER/in FOLDER/out`` on them, on the fine mesh, and compares what the cohort
says with what was put in:

    lateral bending  0.10 at 13 years, a factor of 1.2 a year, people about that with a standard deviation of 0.5 in log
    tissue           0.05, 0.4 in log; the same at every age

The factor of 1.2 is there to be found; it is no claim about growth. People are 10 to 16 years old, four of five are
girls, with curves of 10 to 60 degrees of every kind, to either side. Bodies have tissue on a mesh that is not the
estimator's, elastic supports, a gauge with errors, and rib levels as somebody feels them; three pushes, as
``spinestiff plan`` proposes them before any push. A body that can't carry even a small push is left out, and another
one takes its place.

What is made and what is run stays in FOLDER: the same command goes on there after a stop, and with ``--so-far`` tells
the figures of those who were run. ``--write`` keeps them in benchmarks/results/cohort_of_forty.json, ``--json`` prints
that file. A subject takes about five CPU minutes.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import platform
import sqlite3
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal

import numpy as np
from coverage_rendered import bearable
from judgement_subjects import AGES, drawn_height

from spinestiff import __version__
from spinestiff.app.cohort import order_of, run_cohort
from spinestiff.cohort.overview import JSON
from spinestiff.cohort.participants import read_participants
from spinestiff.cohort.places import LEDGER_FILE
from spinestiff.cohort.statistics import FEWEST
from spinestiff.errors import SpinestiffError, SubjectError
from spinestiff.files import whole_folder
from spinestiff.study.synthetic.recipe import PLANNED_PUSHES, Recipe
from spinestiff.study.synthetic.spines import CURVES
from spinestiff.study.synthetic.subject import synthesise, truth_path

RESULTS = Path(__file__).parent / "results" / "cohort_of_forty.json"
STREAM = 23
MIDDLE_AGE = 13.0
COBB_DEG, FORCE_N, GIRLS = (10.0, 60.0), (50.0, 80.0), 0.8
TYPICAL = {"lateral_bending": 0.10, "tissue": 0.05}
BETWEEN_SD = {"lateral_bending": 0.5, "tissue": 0.4}
A_YEAR = {"lateral_bending": 1.2, "tissue": 1.0}
MOST_LEFT_OUT = 2  # times as many as are wanted


def person(seed: int) -> Recipe:
    """The subject of a seed, with the force that was drawn."""
    random = np.random.default_rng([STREAM, seed])
    age = round(float(random.uniform(*AGES)), 1)
    sex: Literal["female", "male"] = "female" if random.uniform() < GIRLS else "male"
    height = drawn_height(random, age, sex)
    bending, tissue = (
        TYPICAL[name] * A_YEAR[name] ** (age - MIDDLE_AGE) * float(np.exp(BETWEEN_SD[name] * random.normal()))
        for name in ("lateral_bending", "tissue")
    )
    return Recipe(
        seed=seed,
        height_cm=round(height, 0),
        cobb_deg=round(float(random.uniform(*COBB_DEG)) * float(random.choice([-1.0, 1.0])), 1),
        curve=str(random.choice(list(CURVES))),
        force_n=round(float(random.uniform(*FORCE_N)), 1),
        ratios=(bending, tissue),
        pushes=PLANNED_PUSHES,
        age=age,
        sex=sex,
        misread=True,
    )


def name_of(seed: int) -> str:
    return f"sub-{seed:02d}"


def number_of(name: str) -> int:
    return int(name.removeprefix("sub-"))


def make(source: Path, seed: int) -> str | None:
    """Make the subject of a seed, if it is not there; why it can't be, else None."""
    folder = source / name_of(seed)
    refused = source / f".{folder.name}.refused"
    if folder.is_dir():
        return None
    if refused.exists():
        return refused.read_text(encoding="utf-8")
    try:
        recipe, _ = bearable(person(seed))
        with whole_folder(folder, SubjectError) as draft:
            # Before the folder, which is there only whole.
            os.replace(synthesise(draft, recipe), truth_path(folder))
    except SpinestiffError as error:
        refused.write_text(str(error), encoding="utf-8")
        return str(error)
    return None


def make_all(source: Path, count: int, jobs: int) -> tuple[list[int], dict[int, str]]:
    """The first seeds from 1 on of which subjects can be made, so many, and why others can't be."""
    source.mkdir(parents=True, exist_ok=True)
    made: list[int] = []
    refused: dict[int, str] = {}
    following = 1
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        while len(made) < count and len(refused) <= MOST_LEFT_OUT * count:
            seeds = range(following, following + count - len(made))
            following = seeds.stop
            for seed, why in zip(seeds, pool.map(make, [source] * len(seeds), seeds)):
                print(f"{name_of(seed)}: {why or 'made'}", file=sys.stderr, flush=True)
                if why is None:
                    made.append(seed)
                else:
                    refused[seed] = why
    return made, refused


def made_so_far(source: Path) -> tuple[list[int], dict[int, str]]:
    """Seeds of the subjects in the table, and why others could not be made."""
    seeds = [number_of(name) for name in read_participants(source)]
    return seeds, {
        number_of(path.name.split(".")[1]): path.read_text(encoding="utf-8") for path in source.glob(".*.refused")
    }


def write_table(source: Path, seeds: Sequence[int]) -> None:
    """``participants.tsv``."""
    lines = ["participant_id\tage\tsex"]
    for seed in seeds:
        recipe = person(seed)
        lines.append(f"{name_of(seed)}\t{recipe.age}\t{recipe.sex}")
    (source / "participants.tsv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def of_stiffness(name: str, truth: Mapping[str, float], found: Mapping[str, Any], rows: Mapping[str, Any]) -> Any:
    """What the cohort says of a ratio beside what was put in.

    Parameters
    ----------
    truth : participant -> ratio. found : of the cohort's statistics. rows : participant -> row.
    """
    own = {one: rows[one]["stiffness"][name] for one in truth if one in rows}
    inside = [own[one]["low"] <= truth[one] <= own[one]["high"] for one in own]
    counted = found["shrunken"]
    alone = [np.log(one["value"] / truth[one["participant"]]) for one in counted]
    given = [np.log(one["given_all"] / truth[one["participant"]]) for one in counted]
    held = [one["low"] <= truth[one["participant"]] <= one["high"] for one in counted]
    age = next(one for one in found["alone"] if one["name"].startswith("age"))
    return {
        "put_in": {"typical": TYPICAL[name], "between_sd_log": BETWEEN_SD[name], "a_year": A_YEAR[name]},
        "people": found["people"],
        "left_out": dict(Counter(found["left_out"].values())),
        "inside_own_interval": [sum(inside), len(inside)],
        "typical": [found["mean"], found["mean_low"], found["mean_high"]],
        "between_sd_log": [found["between_sd_log"], found["between_low"], found["between_high"]],
        "a_year": [age["factor"], age["low"], age["high"], age["p_adjusted"]],
        "mean_log_error": float(np.mean(alone)),
        "rms_log_error": {"alone": rms(alone), "given_all": rms(given)},
        "inside_given_all": [sum(held), len(held)],
    }


def rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def costs(ledger: Path) -> dict[str, Any]:
    """CPU time and memory of each participant's last try that ended well."""
    query = "SELECT participant, cpu_seconds, peak_mb, seconds FROM tries WHERE ended = 'done' ORDER BY started"
    with closing(sqlite3.connect(ledger)) as book:
        last = {row[0]: row[1:] for row in book.execute(query)}
    cpu, memory, seconds = (np.array(column, dtype=float) for column in zip(*last.values()))
    return {
        "cpu_s": {"median": float(np.median(cpu)), "least": float(cpu.min()), "most": float(cpu.max())},
        "subjects_per_core_hour": 3600.0 / float(cpu.mean()),
        "seconds": {"median": float(np.median(seconds))},
        "peak_mb": {"median": float(np.median(memory)), "most": float(memory.max())},
        "machine": f"{platform.machine()}, {os.cpu_count()} processors, other work beside it",
    }


def figures(source: Path, target: Path, seeds: Sequence[int], refused: Mapping[int, str]) -> dict[str, Any]:
    """All that is kept."""
    record = json.loads((target / JSON).read_text(encoding="utf-8"))
    rows = {one["participant"]: one["row"] for one in record["participants"] if one["row"] is not None}
    truths = {name_of(s): json.loads(truth_path(source / name_of(s)).read_text(encoding="utf-8")) for s in seeds}
    found = {one["name"]: one for one in record["statistics"]}
    return {
        "date": datetime.date.today().isoformat(),
        "version": __version__,
        "subjects": len(seeds),
        "not_made": {name_of(seed): why for seed, why in refused.items()},
        "state": dict(Counter(one["state"] for one in record["participants"])),
        "status": dict(Counter(row["status"] for row in rows.values())),
        "determined": dict(Counter(row["determined"] for row in rows.values())),
        "stiffness": {
            name: of_stiffness(name, {one: truth["ratios"][name] for one, truth in truths.items()}, found[name], rows)
            for name in TYPICAL
        },
        "cost": costs(target / LEDGER_FILE),
    }


def main() -> None:
    """Make, run, compare, print."""
    parser = argparse.ArgumentParser(description="does a cohort find what was put into its people?")
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--subjects", type=int, default=40)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--so-far", action="store_true", help="make and run nobody")
    parser.add_argument("--write", action="store_true", help=f"keep the figures in {RESULTS.name}")
    parser.add_argument("--json", action="store_true", help="print the kept figures")
    asked = parser.parse_args()
    if asked.json:
        print(json.dumps(json.loads(RESULTS.read_text(encoding="utf-8"))))
        return
    if asked.folder is None:
        parser.error("FOLDER is missing")
    if asked.subjects < FEWEST:
        parser.error(f"--subjects {asked.subjects}: wanted {FEWEST} or more, fewer have no statistics")
    for threads in ("SPINESTIFF_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(threads, "1")
    source, target = asked.folder / "in", asked.folder / "out"
    if asked.so_far:
        seeds, refused = made_so_far(source)
        run_cohort(source, target, "group", order_of({}), usual=True)
    else:
        seeds, refused = make_all(source, asked.subjects, asked.jobs)
        write_table(source, seeds)
        run_cohort(source, target, None, order_of({}), jobs=asked.jobs)
    found = figures(source, target, seeds, refused)
    text = json.dumps(found, indent=1)
    print(text)
    if asked.write:
        RESULTS.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
