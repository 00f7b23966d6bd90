"""Does a plan keep its promise, and what is it worth? Synthetic people, pushed as the paper does and as planned.

    python benchmarks/plan.py --log FILE [--first SEED] [--people 40]
    python benchmarks/plan.py --summary FILE... [--write]
    python benchmarks/plan.py --json

People are those of ``coverage_subjects`` with seeds from 8000 on, with ratios drawn around the geometric means of
Table 4, where ``spinestiff plan`` expects them before any push. Each is pushed in four ways, by forces of at most 80 N:

- "paper": three radiographs at rib 8 of the convex side, at a third, two thirds and all of the force;
- "paper and next": these and the push that a plan proposes next for bending, made from the estimate of these;
- "best three": the three that a plan proposes before any push, from either side;
- "best three, one side": the same from the convex side alone.

Promised is the factor either way of bending's 95 % interval that the plan expects, reached the one of the estimate that
is then made (on the coarse mesh), to first order as a plan's are, and of the estimate's own interval. A log that exists
is gone on with; the rows that are kept are benchmarks/results/plan.jsonl.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from coverage_subjects import COARSE_NODES, START, PlacedPush, Subject, make_subject, seen_by
from kept_rows import asked_for, begun, keep

from spinestiff.errors import FitError, SpinestiffError
from spinestiff.estimation.fitted import StiffnessFit
from spinestiff.estimation.profiles import WIDTH_FACTOR
from spinestiff.mechanics.push import Rig
from spinestiff.personalise.pose import align_view
from spinestiff.study.fits import fit_pushes
from spinestiff.study.planning.proposal import composed, make_plan
from spinestiff.study.planning.scene import Scene, places_of_draws, population_places
from spinestiff.study.planning.states import CarriedPushes
from spinestiff.study.planning.widths import ExpectedWidths
from spinestiff.study.planning.wish import COMFORT_N, Wish
from spinestiff.study.trials import PushSet
from spinestiff.subject.plan_outcome import Plan, PlannedPush, PlannedView

RESULTS = Path(__file__).parent / "results" / "plan.json"
NAMES = ("lateral_bending", "tissue")
# Standard deviation of the true ratios' logs about START: Table 4's bending, and its tissue.
SPREAD = {"lateral_bending": 1.3, "tissue": 0.9}
FIRST, NODES, FRAMES = 8000, COARSE_NODES, 3
PAPER = {
    "main": PlacedPush(
        8.0, ((0.0, "unused"), (1 / 3, "training"), (2 / 3, "training"), (1.0, "training")), force_n=COMFORT_N
    )
}
FRONTAL: tuple[PlannedView, ...] = ("frontal",)
ARMS = ("paper", "paper and next", "best three", "best three, one side")


@dataclass(frozen=True)
class Estimated:
    """A subject's pushes on the torso of its radiographs, and the estimate from them."""

    subject: Subject
    pushes: PushSet
    fit: StiffnessFit


def estimated(seed: int, visit: int, placed: Mapping[str, PlacedPush], ratios: Mapping[str, float]) -> Estimated:
    """A person at a visit with these pushes. Raises SpinestiffError where it can't be pushed or estimated."""
    subject = make_subject(seed, placed, NODES, visit, ratios=ratios)
    pushes = seen_by(subject, "coarse")
    fit = fit_pushes(pushes, NAMES, START, extent="intervals")
    if fit.likely is None:
        raise FitError(f"an estimate without intervals: {fit.status.value}")
    return Estimated(subject, pushes, fit)


def before_any(found: Estimated) -> Scene:
    """What a plan knows before any push."""
    torso = found.pushes.torso
    corners, nominal = found.subject.rest["frontal"]
    view, _ = align_view(torso, torso.rest_pose, nominal, corners)
    return Scene(torso, found.pushes.known, Rig(), view, corners.vertebrae, NAMES, population_places())


def after(found: Estimated) -> Scene:
    """What a plan knows after the pushes of an estimate."""
    likely, weighed, pushes = found.fit.likely, found.fit.weighed, found.pushes
    assert likely is not None
    assert weighed is not None
    seen = max((item.trial.corners.vertebrae for item in pushes.fitted), key=len)
    view, places = pushes.fitted[0].trial.view, places_of_draws(likely.draws[0])
    return Scene(pushes.torso, pushes.known, Rig(), view, seen, NAMES, places, pushes, weighed.tracking_factor)


def placed(proposed: Sequence[PlannedPush]) -> dict[str, PlacedPush]:
    """Proposed radiographs as pushes, each with an unloaded one."""
    forces: dict[tuple[Any, float], list[float]] = {}
    for push in proposed:
        forces.setdefault((push.side, push.level), []).append(push.force_n)
    return {
        f"{side}-{level:g}": PlacedPush(
            level,
            ((0.0, "unused"), *((force / max(own), "training") for force in sorted(own))),
            side,
            max(own),
        )
        for (side, level), own in forces.items()
    }


def told(found: Estimated) -> dict[str, Any]:
    """Factors of an estimate, to first order and of its intervals, and whether these hold the truth."""
    fit = found.fit
    sds = dict(zip(NAMES, np.sqrt(np.diag(fit.covariance))))
    told: dict[str, Any] = {
        "pushes": [[r.side, r.level, *r.forces_n] for r in found.subject.records],
        "estimate": fit.ratios.as_dict(),
    }
    for name in NAMES:
        low, high = fit.intervals95[name]
        told[name] = {
            "reached": round(float(np.exp(WIDTH_FACTOR * 1.96 * sds[name])), 4),
            "interval": round(float(np.sqrt(high / low)), 4),
            "open": bool(any(fit.open_ends[name])),
            "inside": bool(low <= found.subject.ratios[name] <= high),
        }
    return told


def run_one(seed: int) -> dict[str, Any]:
    """A person pushed in all four ways, as a line of the log."""
    random, began = np.random.default_rng([23, seed]), time.process_time()
    ratios = {name: float(START[name] * np.exp(random.normal(0.0, SPREAD[name]))) for name in NAMES}
    row: dict[str, Any] = {"seed": seed, "ratios": ratios}
    try:
        paper = estimated(seed, 1, PAPER, ratios)
        row["paper"] = told(paper)
        next_one = make_plan(after(paper), Wish(views=FRONTAL)).next[0]
        found = estimated(seed, 2, {**PAPER, **placed([next_one])}, ratios)
        row["paper and next"] = {**told(found), "promised": next_one.factors}
        scene, either = before_any(paper), Wish(exposures=2 * FRAMES, views=FRONTAL)
        convex = replace(either, sides=(paper.subject.records[0].side,))
        carried = CarriedPushes(scene, either)
        widths = ExpectedWidths(scene, carried)
        for number, (arm, wish) in enumerate((("best three", either), ("best three, one side", convex))):
            pushes, promised = best_of(composed(scene, wish, carried, widths))
            row[arm] = {**told(estimated(seed, 3 + number, placed(pushes), ratios)), "promised": promised}
    except SpinestiffError as error:
        row["failed"] = str(error)
    return {**row, "cpu_s": round(time.process_time() - began, 1)}


def best_of(plan: Plan) -> tuple[list[PlannedPush], dict[str, float]]:
    """The first three radiographs under force of a plan's sequence, and what they promise."""
    steps = plan.sequence[:FRAMES]
    return [step.push for step in steps], dict(steps[-1].push.factors)


def summarised(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Medians by way of pushing, over the people of whom all four are known."""
    whole = [row for row in rows if "failed" not in row]
    found = []
    for arm in ARMS:
        own = [row[arm] for row in whole]
        entry: dict[str, Any] = {"pushes": arm, "people": len(own), "failed": len(rows) - len(whole)}
        for name in NAMES:
            reached = np.array([one[name]["reached"] for one in own])
            widths = np.log([one[name]["interval"] for one in own])
            entry[name] = {
                "reached": _median(reached),
                "interval": _median([one[name]["interval"] for one in own]),
                "open": sum(one[name]["open"] for one in own),
                "inside": sum(one[name]["inside"] for one in own),
                "narrower_than": {
                    other: _narrower(widths, np.log([row[other][name]["interval"] for row in whole]))
                    for other in ARMS
                    if other != arm
                },
            }
            if all("promised" in one for one in own):
                promised = np.array([one["promised"][name] for one in own])
                off = np.log(reached) / np.log(promised)
                entry[name] |= {
                    "promised": _median(promised),
                    "reached_over_promised_width": [round(float(q), 3) for q in np.quantile(off, (0.1, 0.5, 0.9))],
                }
        found.append(entry)
    return found


def _narrower(widths: np.ndarray, others: np.ndarray) -> dict[str, float]:
    """In how many people log widths are below others, and what share of them they are in the median."""
    return {"people": int(np.sum(widths < others)), "share_of_width": _median(widths / others)}


def _median(values: Sequence[float] | np.ndarray) -> float:
    return round(float(np.median(values)), 3) if len(values) else float("nan")


def main() -> None:
    asked = asked_for(__doc__, RESULTS, lambda rows: {"arms": summarised(rows)}, first=FIRST, people=40)
    if asked is None:
        return
    done = {row["seed"] for row in begun(asked.log)}
    for seed in range(asked.first, asked.first + asked.people):
        if seed in done:
            continue
        row = run_one(seed)
        keep(asked.log, row)
        print(seed, row.get("failed") or [row[arm]["lateral_bending"] for arm in ARMS], row["cpu_s"], flush=True)


if __name__ == "__main__":
    main()
