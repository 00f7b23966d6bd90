"""Do the checks of a result (``study.judgement``) keep silent on sound subjects, and what do they find?

``OMP_NUM_THREADS=1 python benchmarks/judgement.py [--first 1000] [--subjects 200] [--mixed 30] [--jobs 2]
[--keep FOLDER] [--log FILE] [--lines] [--json] [--write]``: sound subjects by corners (``judgement_subjects.py``), ten
seconds each; of the first ``--mixed`` of them each mix-up at growing size. Limits were set on seeds below 100; what is
reported is of others. A line a subject goes to the log, a run that was stopped goes on from it, and FOLDER takes the
subjects. --lines prints what a user reads for each mix-up of one subject, and nothing else.

Mix-ups change what the steps were told; corners, places and forces are then taken through them again. Two things are
not: a refit, which no check but those of the training frames sees (theirs is taken to first order), and instead of a
frontal picture at rest that of the push is mirrored, with its side.
"""

from __future__ import annotations

import argparse
import datetime
import gzip
import hashlib
import json
import pickle
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from judgement_subjects import Estimated, Subject, estimate, make_subject
from kept_rows import begun, prepare

from spinestiff.anatomy.template import template_torso
from spinestiff.errors import SpinestiffError
from spinestiff.estimation.fitted import StiffnessFit
from spinestiff.estimation.objective import make_target, residuals
from spinestiff.imaging.features import VertebraCorners
from spinestiff.imaging.tracking.quality import DOUBTED_QUALITY, usable_corners
from spinestiff.personalise.shape import personalise
from spinestiff.study.judgement import failed, judge
from spinestiff.study.judgement.rest_shape import RestShape
from spinestiff.study.trials import PushSet, push_set
from spinestiff.subject.estimate_outcome import Check
from spinestiff.subject.outcomes import TrackedPush
from spinestiff.subject.records import SubjectRecord

FOUND = 0.9
MAIN = "main"


@dataclass(frozen=True)
class Case:
    """A subject and what the steps made of it, or a mix-up of it."""

    subject: Subject
    shape: RestShape
    pushes: PushSet
    fit: StiffnessFit

    @classmethod
    def of(cls, subject: Subject, estimated: Estimated) -> Case:
        shaped = estimated.shaped
        pushes = push_set(shaped.torso, subject.records, subject.tracked)
        return cls(subject, RestShape.of(shaped), pushes, estimated.fit)

    def checks(self) -> tuple[Check, ...]:
        """The checks of this case; by corners there are no files whose patients could be compared."""
        return judge(record_of(self.subject), self.shape, self.pushes, self.fit, {})

    def told(self, subject: Subject) -> Case:
        """The case with other pushes or corners, on the same torso."""
        pushes = push_set(self.pushes.torso, subject.records, subject.tracked)
        return replace(self, subject=subject, pushes=pushes)


def record_of(subject: Subject) -> SubjectRecord:
    """``subject.json`` of a subject."""
    return SubjectRecord(
        schema_version=1, id="s", age=13.0, sex="female", height_cm=subject.height_cm, pushes=subject.records
    )


# Mix-ups: each takes a case and a size and gives the case as it would be.


def scaled_everywhere(case: Case, factor: float) -> Case:
    """All pixel spacings times ``factor``, personalised anew; a height of 1 / ``factor`` as much comes to the same."""
    rest = {name: (scaled(corners, factor), view) for name, (corners, view) in case.subject.rest.items()}
    return reshaped(case, replace(scaled_pushes(case.subject, factor), rest=rest))


def scaled(corners: VertebraCorners, factor: float) -> VertebraCorners:
    return replace(corners, corners=factor * corners.corners)


def scaled_push(case: Case, factor: float) -> Case:
    """The pixel spacing of the pushes alone."""
    return case.told(scaled_pushes(case.subject, factor))


def scaled_pushes(subject: Subject, factor: float) -> Subject:
    for push in subject.tracked:
        subject = with_corners(subject, push, partial(scaled, factor=factor))
    return subject


def turned_vertebra(case: Case, degrees: float) -> Case:
    """A vertebra's corners turned about their middle in a push."""

    def turned(corners: VertebraCorners) -> VertebraCorners:
        row, angle = chosen(case, len(corners)), np.radians(degrees)
        new = np.array(corners.corners)
        middle = new[row].mean(0)
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        new[row] = middle + (new[row] - middle) @ turn
        return replace(corners, corners=new)

    return case.told(with_corners(case.subject, MAIN, turned))


def displaced_vertebra(case: Case, mm: float) -> Case:
    """A vertebra's corners displaced in a push."""
    return case.told(with_corners(case.subject, MAIN, partial(displaced, case, mm)))


def displaced(case: Case, mm: float, corners: VertebraCorners) -> VertebraCorners:
    row, angle = chosen(case, len(corners)), 2.0 * np.pi * (0.37 * case.subject.seed % 1.0)
    new = np.array(corners.corners)
    new[row] += mm * case.subject.tracked[MAIN].view.view().magnification * np.array([np.cos(angle), np.sin(angle)])
    return replace(corners, corners=new)


def renamed_levels(case: Case, step: float) -> Case:
    """The levels of a push named by as much too low (above 0) or too high."""

    def renamed(corners: VertebraCorners) -> VertebraCorners:
        names, shift = corners.vertebrae, int(step)
        kept = range(max(0, -shift), len(names) - max(0, shift))
        taken = list(kept)
        return VertebraCorners(tuple(names[i + shift] for i in kept), corners.corners[taken], corners.quality[taken])

    return case.told(with_corners(case.subject, MAIN, renamed))


def mirrored(case: Case, _: float) -> Case:
    """The pictures of a push mirrored, and its side with them: as a mirrored frontal picture at rest."""
    view = case.subject.tracked[MAIN].view.view()
    middle = view.principal_point[0]

    def flipped(corners: VertebraCorners) -> VertebraCorners:
        new = np.array(corners.corners)[:, [1, 0, 3, 2]]
        new[..., 0] = 2.0 * middle - new[..., 0]
        return VertebraCorners(corners.vertebrae, new, corners.quality[:, [1, 0, 3, 2]])

    subject = with_corners(case.subject, MAIN, flipped)
    other = {"left": "right", "right": "left"}
    records = tuple(r.model_copy(update={"side": other[r.side]}) if r.id == MAIN else r for r in subject.records)
    return case.told(replace(subject, records=records))


def loaded_rest(case: Case, frame: float) -> Case:
    """The frontal rest picture taken in a loaded frame; personalised anew."""
    push = case.subject.tracked[MAIN]
    corners = usable_corners(push.corners(int(frame)))
    marked = replace(corners, quality=np.ones_like(corners.quality))
    rest = {**case.subject.rest, "frontal": (marked, push.view.view())}
    return reshaped(case, replace(case.subject, rest=rest))


def exchanged_forces(case: Case, step: float) -> Case:
    """The forces of the largest frame and of one ``step`` frames before exchanged."""
    record = next(r for r in case.subject.records if r.id == MAIN)
    forces = list(record.forces_n)
    last = len(forces) - 1
    forces[last], forces[last - int(step)] = forces[last - int(step)], forces[last]
    return with_forces(case, tuple(forces))


def forces_times(case: Case, factor: float) -> Case:
    """All forces times ``factor``; the estimated stiffness then grows alike, and nothing else changes."""
    trials = tuple(replace(t, force_n=factor * t.force_n) for t in case.pushes.trials)
    return replace(case, pushes=replace(case.pushes, trials=trials))


def with_forces(case: Case, forces: tuple[float, ...]) -> Case:
    records = tuple(r.model_copy(update={"forces_n": forces}) if r.id == MAIN else r for r in case.subject.records)
    return case.told(replace(case.subject, records=records))


def misread_force(case: Case, factor: float) -> Case:
    """The force of the largest training frame read as ``factor`` times what it was; fitted to first order."""
    changes = []
    last = int(np.argmax([t.force_n for t in case.pushes.training]))
    for i, (item, part) in enumerate(zip(case.pushes.training, case.fit.residuals, strict=True)):
        torso = case.pushes.torso
        start = residuals(torso, make_target(torso, item.trial, case.fit.orientation), torso.rest_pose)
        simulated = part.difference - start.difference  # motion from rest
        changes.append((factor - 1.0) * simulated * (i == last))
    return replace(case, fit=refitted(case, changes))


def lost_vertebra(case: Case, mm: float) -> Case:
    """Tracking puts a vertebra elsewhere in the largest training frame and is sure of it; fitted to first order."""
    changes = []
    last = int(np.argmax([t.force_n for t in case.pushes.training]))
    for i, part in enumerate(case.fit.residuals):
        change = np.zeros(part.difference.shape)
        sure = np.flatnonzero(part.quality >= DOUBTED_QUALITY)
        change[sure[chosen(case, len(sure))]] = mm * np.array([1.0, 0.0]) * (i == last)
        changes.append(change)
    return replace(case, fit=refitted(case, changes))


def refitted(case: Case, changes: Sequence[np.ndarray]) -> StiffnessFit:
    """The fit after its residuals (simulated minus measured) changed: what the ratios can take of it is gone."""
    fit, slopes = case.fit, in_log_ratio(case)
    roots = [np.sqrt(part.quality)[:, None, None] for part in fit.residuals]
    stacked = np.concatenate([(root * change).ravel() for root, change in zip(roots, changes)])
    taken = slopes @ np.linalg.lstsq(slopes, stacked, rcond=1e-6)[0]
    parts, at = [], 0
    for part, root, change in zip(fit.residuals, roots, changes):
        here = taken[at : at + change.size].reshape(change.shape)
        at += change.size
        parts.append(replace(part, difference=part.difference + change - here / np.maximum(root, 1e-6)))
    return replace(fit, residuals=tuple(parts))


def in_log_ratio(case: Case) -> np.ndarray:
    """(n, P) derivative of the fit's stacked, weighed residuals in log ratio, under the forces as told."""
    fit, found = case.fit, []
    for item, part, solved in zip(case.pushes.training, fit.residuals, fit.equilibria, strict=True):
        problem, load = case.pushes.problems[item.push], item.trial.load
        there = problem.solve(load, fit.ratios, solved.state).require()
        slopes = part.along(problem.linearise(there, load, fit.ratios).forward(fit.ratios.groups))
        found.append(np.sqrt(np.repeat(part.quality, 8))[:, None] * slopes)
    return np.concatenate(found)


def other_lateral(case: Case, step: float) -> Case:
    """The levels of the lateral rest picture named one too low (1) or too high (-1); personalised anew."""
    rest = dict(case.subject.rest)
    corners, view = rest["lateral"]
    names, shift = corners.vertebrae, int(step)
    kept = list(range(max(0, -shift), len(names) - max(0, shift)))
    rest["lateral"] = (
        VertebraCorners(tuple(names[i + shift] for i in kept), corners.corners[kept], corners.quality[kept]),
        view,
    )
    return reshaped(case, replace(case.subject, rest=rest))


def reshaped(case: Case, subject: Subject) -> Case:
    """The case with other rest pictures, personalised anew."""
    shaped = personalise(template_torso(subject.height_cm), subject.rest)
    pushes = push_set(shaped.torso, subject.records, subject.tracked)
    return replace(case, subject=subject, shape=RestShape.of(shaped), pushes=pushes)


def with_corners(subject: Subject, push: str, change: Callable[[VertebraCorners], VertebraCorners]) -> Subject:
    """The subject with the corners of every frame of a push changed."""
    tracked = subject.tracked[push]
    corners = [change(tracked.corners(i)) for i in range(len(tracked.frames))]
    return replace(subject, tracked={**subject.tracked, push: TrackedPush.of(tracked.view.view(), corners)})


def chosen(case: Case, count: int) -> int:
    """A vertebra, another in each subject."""
    return (7 * case.subject.seed + 3) % count


@dataclass(frozen=True)
class Mixup:
    """A mistake, its sizes from small to large, the unit of them, and the checks that are to find it."""

    make: Callable[[Case, float], Case]
    sizes: tuple[float, ...]
    unit: str
    checks: tuple[str, ...]


MIXUPS = {
    "all pictures too small": Mixup(
        scaled_everywhere, (0.875, 0.85, 0.825, 0.7), "times",
        ("length of the spine", "sizes of the vertebrae"),
    ),
    "all pictures too large": Mixup(
        scaled_everywhere, (1.15, 1.175, 1.2), "times",
        ("length of the spine", "sizes of the vertebrae"),
    ),
    "pushes too small": Mixup(scaled_push, (0.98, 0.96, 0.94, 0.92, 0.9, 0.85, 0.7), "times", ("rest and push",)),
    "vertebra turned": Mixup(turned_vertebra, (5, 10, 15, 20, 25, 30, 45, 90), "degrees", ("vertebrae of the push",)),
    "vertebra displaced": Mixup(displaced_vertebra, (2, 3, 4, 5, 6, 7, 8, 10), "mm", ("vertebrae of the push",)),
    "levels too low": Mixup(renamed_levels, (1,), "levels", ("rest and push",)),
    "levels too high": Mixup(renamed_levels, (-1,), "levels", ("rest and push",)),
    "lateral levels too low": Mixup(other_lateral, (1,), "levels", ("corners at rest", "vertebrae at rest")),
    "rest mirrored": Mixup(mirrored, (1,), "", ("rest and push", "motion along the push")),
    "rest under load": Mixup(loaded_rest, (1, 3), "of 3 frames", ("rest without load", "rest and push")),
    "forces exchanged": Mixup(exchanged_forces, (1, 2), "frames apart", ("motion grows with force",)),
    "force of a frame misread": Mixup(misread_force, (1.5, 2, 3, 4.45, 9.81), "times", ("training frames",)),
    "vertebra lost": Mixup(lost_vertebra, (1, 1.5, 2, 2.5, 3, 4, 6), "mm", ("vertebrae in motion",)),
    "forces too small": Mixup(forces_times, (0.7, 0.5, 0.3, 0.225, 0.1), "times", ("size of the force",)),
    "forces too large": Mixup(forces_times, (1.5, 2, 3, 4.45, 9.81), "times", ("size of the force",)),
}  # fmt: skip


# The campaign


def subject_of(seed: int, keep: Path | None) -> tuple[Subject, Estimated]:
    """A subject with what the steps made of it, from the folder if it is there."""
    path = None if keep is None else keep / f"{seed}.pkl.gz"
    if path is not None and path.exists():
        kept: Any = pickle.loads(gzip.decompress(path.read_bytes()))
        if isinstance(kept, str):
            raise SpinestiffError(kept)
        return kept  # type: ignore[no-any-return]
    try:
        subject = make_subject(seed)
        made: Any = (subject, estimate(subject))
    except SpinestiffError as error:
        made = str(error)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(gzip.compress(pickle.dumps(made), 1))
    if isinstance(made, str):
        raise SpinestiffError(made)
    return made  # type: ignore[no-any-return]


def row_of(seed: int, mixed: bool, keep: Path | None) -> dict[str, Any]:
    """What the checks say of one sound subject and, if asked, of its mix-ups."""
    began = time.process_time()
    try:
        subject, estimated = subject_of(seed, keep)
    except SpinestiffError as error:
        return {"seed": seed, "error": str(error)}
    case = Case.of(subject, estimated)
    checks = case.checks()
    row = {
        "seed": seed,
        "cobb_deg": round(subject.cobb_deg, 1),
        "annotation_mm": round(subject.annotation_mm, 3),
        "largest_training_n": max(t.force_n for t in case.pushes.training),
        "bending_mm": round(bending(case), 2),
        "checks": [[c.name, c.value, c.limit, c.passed] for c in checks],
        "mixups": dict(mixups(case)) if mixed else None,
    }
    return {**row, "cpu_s": round(time.process_time() - began, 1)}


def mixups(case: Case) -> Iterator[tuple[str, dict[str, list[str]]]]:
    """Of each mix-up and size the names of the checks that fail; "refused" where a step raises."""
    for name, mixup in MIXUPS.items():
        found = {}
        for size in mixup.sizes:
            try:
                found[f"{size:g}"] = sorted({check.name for check in failed(mixup.make(case, size).checks())})
            except SpinestiffError:
                found[f"{size:g}"] = ["refused"]
        yield name, found


def bending(case: Case) -> float:
    """mm (RMS), of the main push's largest frame."""
    from spinestiff.study.misfit import motion, moved, rms

    trials = [t for t in case.pushes.trials if t.push == MAIN]
    most = max(trials, key=lambda t: t.force_n)
    _, start, end = motion(case.pushes.torso, most.trial, case.pushes.reference(MAIN).trial)
    return rms(end - moved(start, end))


def other_rest(rows: Sequence[dict[str, Any]], keep: Path | None) -> dict[str, int]:
    """Each subject's pushes beside the rest torso of the next one: how many are found, of how many."""
    seeds = [row["seed"] for row in rows]
    found = 0
    for seed, other in zip(seeds, [*seeds[1:], seeds[0]]):
        (subject, estimated), (_, others) = subject_of(seed, keep), subject_of(other, keep)
        case = Case.of(subject, estimated)
        pushes = push_set(others.shaped.torso, subject.records, subject.tracked)
        mixed = replace(case, shape=RestShape.of(others.shaped), pushes=pushes)
        found += bool(failed(mixed.checks()))
    return {"found": found, "of": len(seeds)}


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """False alarms, and of each mix-up how many subjects were found at each size."""
    sound = [row for row in rows if "error" not in row]
    alarms = {row["seed"]: [c[0] for c in row["checks"] if c[3] is False] for row in sound}
    by_check: dict[str, dict[str, Any]] = {}
    for row in sound:
        for name, value, limit, passed in row["checks"]:
            entry = by_check.setdefault(name, {"values": [], "alarms": 0, "not_possible": 0})
            if passed is None:
                entry["not_possible"] += 1
            else:
                ratio = abs(np.log(value)) / abs(np.log(limit)) if "spine" in name or "sizes" in name else None
                entry["values"].append(ratio if ratio is not None else value / limit if limit else value)
                entry["alarms"] += not passed
    mixed = [row for row in sound if row["mixups"]]
    found: dict[str, Any] = {}
    for name, mixup in MIXUPS.items():
        sizes = {}
        for size in mixup.sizes:
            those = [row["mixups"][name][f"{size:g}"] for row in mixed]
            sizes[f"{size:g}"] = {
                "found": sum(bool(one) for one in those),
                "by_its_check": sum(bool({*mixup.checks, "refused"} & set(one)) for one in those),
            }
        enough = [s for s in sizes if mixed and sizes[s]["by_its_check"] >= FOUND * len(mixed)]
        found[name] = {"unit": mixup.unit, "checks": mixup.checks, "sizes": sizes, "found_from": (enough or [None])[0]}
    return {
        "subjects": len(sound),
        "not_made": len(rows) - len(sound),
        "false_alarms": sum(bool(names) for names in alarms.values()),
        "false_alarms_of": {str(seed): names for seed, names in alarms.items() if names},
        "checks": {
            name: {
                "alarms": entry["alarms"],
                "not_possible": entry["not_possible"],
                "share_of_limit": None
                if not entry["values"]
                else [round(float(v), 3) for v in np.percentile(entry["values"], (50, 95, 100))],
            }
            for name, entry in by_check.items()
        },
        "mixed": len(mixed),
        "mixups": found,
        "mirrored_by_cobb_deg": mirrored_by_curve(mixed),
    }


def mirrored_by_curve(rows: Sequence[dict[str, Any]]) -> dict[str, list[int]]:
    """By size of the curve: of how many mirrored ones how many were found."""
    result = {}
    for low, high in ((0, 10), (10, 15), (15, 20), (20, 30), (30, 60)):
        those = [bool(row["mixups"]["rest mirrored"]["1"]) for row in rows if low <= abs(row["cobb_deg"]) < high]
        result[f"{low} to {high}"] = [sum(those), len(those)]
    return result


def code_digest() -> str:
    """SHA-256 over what the figures depend on: the package and this campaign."""
    here = Path(__file__).parent
    files = [*sorted((here.parent / "src" / "spinestiff").rglob("*.py")), *sorted(here.glob("judgement*.py"))]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def lines(seed: int, keep: Path | None) -> None:
    """What a user reads of each mix-up of a subject, at its largest size."""
    subject, estimated = subject_of(seed, keep)
    case = Case.of(subject, estimated)
    print(f"seed {seed}: Cobb {subject.cobb_deg:.0f} degrees, {subject.height_cm:g} cm, bending {bending(case):.1f} mm")
    for name, mixup in MIXUPS.items():
        print(f"\n{name} {mixup.sizes[-1]:g} {mixup.unit}")
        try:
            for check in failed(mixup.make(case, mixup.sizes[-1]).checks()):
                print(f"  {check.name}: {check.text}")
        except SpinestiffError as error:
            print(f"  refused: {error}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=1000, help="seed of the first subject")
    parser.add_argument("--subjects", type=int, default=200)
    parser.add_argument("--mixed", type=int, default=30, help="so many of them are mixed up")
    parser.add_argument("--jobs", type=int, default=1, choices=(1, 2))
    parser.add_argument("--keep", type=Path, help="folder for the subjects made")
    parser.add_argument("--log", type=Path, help="rows as they come; what is there is not done again")
    parser.add_argument("--lines", action="store_true", help="what a user reads of the first subject mixed up")
    parser.add_argument("--json", action="store_true", help="print all of the result")
    parser.add_argument("--write", action="store_true", help="store the result in benchmarks/results/")
    arguments = parser.parse_args()
    if arguments.lines:
        lines(arguments.first, arguments.keep)
        return
    rows: list[dict[str, Any]] = []
    if arguments.log is not None:
        prepare(arguments.log)
        rows = begun(arguments.log)
    done = {row["seed"] for row in rows}
    seeds = [s for s in range(arguments.first, arguments.first + arguments.subjects) if s not in done]
    mixed = [s < arguments.first + arguments.mixed for s in seeds]
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for row in pool.map(row_of, seeds, mixed, [arguments.keep] * len(seeds)):
            rows.append(row)
            if arguments.log is not None:
                with arguments.log.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row) + "\n")
    result = {
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "first_seed": arguments.first,
        "code": code_digest(),
        **summary(rows),
    }
    if arguments.keep is not None:
        result["rest_of_another"] = other_rest([r for r in rows if r.get("mixups")], arguments.keep)
    print(json.dumps(result if arguments.json else {k: v for k, v in result.items() if k != "checks"}, indent=1))
    if arguments.write:
        path = Path(__file__).parent / "results" / "judgement.json"
        path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
