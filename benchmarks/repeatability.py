"""Do estimates of one person scatter as their errors let expect? Synthetic people, visits and annotators.

    python benchmarks/repeatability.py --log FILE [--first SEED] [--people 40] [--visits 3] [--annotators 2]
    python benchmarks/repeatability.py --summary FILE... [--write] [--json]

People are those of ``coverage_subjects`` with seeds from 7000 on: truth on meshes of the coarse one's size, three
pushes at the same ribs and of the same force at each visit. Everything else is drawn anew that is not the person's own:
gauge, where the pushes really are, stance, supports, tracking. Each visit is annotated by so many people; the first
one's annotations make a series of visits, all of one visit a series of annotators. The estimator is the coarse one. A
log that exists is gone on with; the rows that are kept are benchmarks/results/repeatability.jsonl.

``--summary`` compares the scatter within people with what the estimates tell (``study.repeatability``) and counts how
often an unchanged person is said to have changed; estimates that do not determine a ratio are left out.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from coverage_subjects import COARSE_NODES, START, make_subject, seen_by
from kept_rows import asked_for, begun, keep

from spinestiff.errors import SpinestiffError
from spinestiff.study.fits import fit_pushes
from spinestiff.study.repeatability import VisitEstimate, VisitRatio, repeatability
from spinestiff.subject.outcome_parts import Quantity

RESULTS = Path(__file__).parent / "results" / "repeatability.json"
NAMES = ("lateral_bending", "tissue")
FIRST, NODES = 7000, COARSE_NODES


def run_one(seed: int, visit: int, annotator: int) -> dict[str, Any]:
    """A person at a visit as an annotator sees it, estimated, as a line of the log."""
    row: dict[str, Any] = {"seed": seed, "visit": visit, "annotator": annotator}
    began = time.process_time()
    try:
        subject = make_subject(seed, "three pushes", NODES, visit, annotator)
        fit = fit_pushes(seen_by(subject, "coarse"), NAMES, START, extent="intervals")
    except SpinestiffError as error:
        return {**row, "failed": str(error)}
    weighed = fit.weighed
    if weighed is None or weighed.likely is None:
        return {**row, "failed": fit.status.name}
    return {
        **row,
        "truth": dict(subject.ratios),
        "estimate": fit.ratios.as_dict(),
        "intervals": {name: list(fit.intervals95[name]) for name in NAMES},
        "open": {name: list(fit.open_ends[name]) for name in NAMES},
        "pushes": [
            [one.side, one.level, force]
            for one in subject.records
            for force, role in zip(one.forces_n, one.roles)
            if role == "training" and force > 0.0
        ],
        "sd_log": dict(zip(NAMES, np.sqrt(np.diag(fit.covariance)).tolist())),
        "visit_sd_log": dict(zip(NAMES, weighed.visit_sd.tolist())),
        "annotation_sd_log": dict(zip(NAMES, weighed.annotation_sd.tolist())),
        "p_value": weighed.p_value,
        "cpu_s": round(time.process_time() - began, 1),
    }


def series(rows: Sequence[dict[str, Any]], of_annotators: bool) -> list[VisitEstimate]:
    """Estimates of each person at all visits, or of each visit by all annotators."""
    found = []
    for row in rows:
        if "failed" in row or (not of_annotators and row["annotator"]):
            continue
        whose = f"{row['seed']}" + (f", visit {row['visit']}" if of_annotators else "")
        number = row["annotator"] if of_annotators else row["visit"]
        sds = row["annotation_sd_log" if of_annotators else "visit_sd_log"]
        ratios = {}
        for name in NAMES:
            (low, high), (open_low, open_high) = row["intervals"][name], row["open"][name]
            told = Quantity(value=row["estimate"][name], low=low, high=high, open_low=open_low, open_high=open_high)
            ratios[name] = VisitRatio.of(told, sds[name], row["sd_log"][name])
        pushes = tuple(sorted((side, level, force) for side, level, force in row["pushes"]))
        found.append(VisitEstimate(f"{whose}, {number}", whose, ratios, pushes))
    return found


def summarised(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Scatter found and expected, and false alarms, by series and ratio."""
    summary: dict[str, Any] = {"failed": sum("failed" in row for row in rows)}
    for key, of_annotators in (("visits", False), ("annotators", True)):
        every = series(rows, of_annotators)
        summary[key] = {}
        for name in NAMES:
            mine = [replace(one, ratios={name: one.ratios[name]}) for one in every]
            people = Counter(one.subject for one in mine if one.ratios[name].known)
            if max(people.values(), default=0) < 2:
                continue
            found = repeatability(mine)
            apart = [abs(float(np.log(change.factor))) for change in found.changes]
            judged = [change.verdict == "changed" for change in found.changes if change.verdict != "can't be told"]
            summary[key][name] = {
                "people": sum(count > 1 for count in people.values()),
                **{k: round(float(v), 4) for k, v in vars(found.scatter[name]).items()},
                "said_to_have_changed": round(float(np.mean(judged)), 4) if judged else None,
                "judged": len(judged),
                "apart": [round(float(q), 4) for q in np.quantile(apart, (0.5, 0.9))],
            }
    return summary


def main() -> None:
    asked = asked_for(__doc__, RESULTS, summarised, first=FIRST, people=40, visits=3, annotators=2)
    if asked is None:
        return
    known = {(row["seed"], row["visit"], row["annotator"]) for row in begun(asked.log)}
    for seed in range(asked.first, asked.first + asked.people):
        for visit in range(asked.visits):
            for annotator in range(asked.annotators):
                if (seed, visit, annotator) in known:
                    continue
                row = run_one(seed, visit, annotator)
                keep(asked.log, row)
                print(seed, visit, annotator, row.get("failed") or row["estimate"], row.get("cpu_s"), flush=True)


if __name__ == "__main__":
    main()
