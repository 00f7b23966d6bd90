"""How much of an estimate's error through rendered radiographs comes from following corners in them?

    python benchmarks/rendered_share.py --log FILE [--first SEED] [--people N]
    python benchmarks/rendered_share.py --summary FILE... [--write]
    python benchmarks/rendered_share.py --json

People of the scenario "rendered, three pushes" of ``coverage.py`` are radiographed, tracked and shaped as there, and
then estimated on the coarse mesh, from the true ratios on, with

    as tracked     what the steps found
    no supports    the same without the measured places of pelvis and shoulder
    reversed       the same, with each error of tracking turned to its opposite
    true motion    corners as marked in the first frame of a push, that move as the vertebrae do
    error model    corners by the error model of ``judgement_subjects``, as campaigns from corners have them: marks,
                   stance, posture and place of each frame are drawn anew, and no supports are measured

Half the difference of the second and the third tells how far tracking's errors scatter an estimate, and their mean less
the fourth how far they draw it to one side whatever their sign. What the fourth is off by belongs to all else:
geometry, mesh, gauge, places, posture and what the body has that the model lacks. z is the signed root of the
likelihood's rise at the truth, as in ``coverage.py``: an error over the standard deviation at the estimate leans to the
stiff side by itself, as the deviation is smaller there. A log that exists is gone on with; needs the extra ``[mesh]``.
A person takes six CPU minutes, most of it for radiographs.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from counted_intervals import NAMES
from coverage_rendered import Rendered, radiographed_person
from coverage_subjects import make_subject
from kept_rows import ROOT, asked_for, begun, code, keep
from told_intervals import told

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.arrays import Floats
from spinestiff.errors import SpinestiffError
from spinestiff.study.fits import fit_pushes
from spinestiff.study.trials import PushSet, known_of, push_set, rig_of
from spinestiff.study.visit import open_visit
from spinestiff.subject.geometry_outcome import GeometryRecord
from spinestiff.subject.outcomes import Tracked, TrackedPush
from spinestiff.subject.run_record import read_outcome

RESULTS = ROOT / "benchmarks" / "results" / "rendered_share.json"
FIRST, PEOPLE, NODES = 61000, 45, 15_000  # of the campaign, and of its truths' meshes
KINDS = ("as tracked", "no supports", "reversed", "true motion", "error model")


def without_supports(found: TrackedPush) -> TrackedPush:
    """A push in whose frames nothing was seen of pelvis and shoulder."""
    told = found.model_dump()
    for frame in told["frames"]:
        frame |= {"obliquity_deg": None, "shoulder_mm": None}
    return TrackedPush.model_validate(told)


def with_errors(found: TrackedPush, true: Floats, times: float) -> TrackedPush:
    """A push whose corners begin where they are and move as ``true`` (F, V, 4, 2) does, mm on the detector, but for
    ``times`` what tracking was off by."""
    told, view = found.model_dump(), found.view.view()
    first = found.corners(0).corners
    rows = [VERTEBRAE.index(name) for name in found.vertebrae]
    for number, (frame, now) in enumerate(zip(told["frames"], true[:, rows])):
        there = first + now - true[0, rows]
        frame["corners_px"] = view.pixels(there + times * (found.corners(number).corners - there)).tolist()
    return TrackedPush.model_validate(told)


def followed(found: TrackedPush, true: Floats) -> dict[str, float]:
    """How well loaded frames were followed: the error of vertebrae's shifts sideways over their motion, as a slope and
    as a root of mean squares, and of their turns, mm and degrees at the patient."""
    rows = [VERTEBRAE.index(name) for name in found.vertebrae]
    seen = np.array([found.corners(i).corners for i in range(len(found.frames))])
    moved, wrong = true[1:, rows] - true[0, rows], seen[1:] - seen[0] - (true[1:, rows] - true[0, rows])
    arms = true[0, rows] - true[0, rows].mean(axis=1, keepdims=True)
    turning = np.stack([-arms[..., 1], arms[..., 0]], axis=-1)
    turning /= np.sum(turning**2, axis=(1, 2), keepdims=True)
    shifts, errors = (change.mean(axis=2)[..., 0] for change in (moved, wrong))
    turns, turned_wrong = (np.degrees(np.sum(turning * change, axis=(2, 3))) for change in (moved, wrong))
    size = found.view.view().magnification
    return {
        "drag": float(np.sum(errors * shifts) / np.sum(shifts**2)),
        "drag_of_turns": float(np.sum(turned_wrong * turns) / np.sum(turns**2)),
        "shift_error_mm": float(np.sqrt(np.mean(errors**2))) / size,
        "turn_error_deg": float(np.sqrt(np.mean(turned_wrong**2))),
    }


def pushes_of(seed: int, folder: Path, person: Rendered) -> dict[str, PushSet]:
    """By kind, on the coarse torso that was shaped to the person's radiographs."""
    visit = open_visit(folder)
    record, tracked = visit.subject.record, read_outcome(visit.subject, Tracked).pushes
    covariance = np.array(read_outcome(visit.subject, GeometryRecord).covariance)
    known = known_of(record, covariance.reshape(6 * len(covariance), -1))
    assert person.coarse is not None
    torso = person.coarse.torso

    def seen(change: Callable[[str, TrackedPush], TrackedPush]) -> PushSet:
        corners = {name: change(name, found) for name, found in tracked.items()}
        return push_set(torso, record.pushes, corners, rig=rig_of(record), known=known)

    modelled = make_subject(seed, "three pushes", NODES).tracked
    makers: tuple[Callable[[str, TrackedPush], TrackedPush], ...] = (
        lambda name, found: found,
        lambda name, found: without_supports(found),
        lambda name, found: without_supports(with_errors(found, person.true[name], -1.0)),
        lambda name, found: without_supports(with_errors(found, person.true[name], 0.0)),
        lambda name, found: modelled[name],
    )
    return dict(zip(KINDS, map(seen, makers), strict=True))


def run_one(seed: int) -> dict[str, Any]:
    """A person as a line of the log."""
    row: dict[str, Any] = {"seed": seed, "code": code()}
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "subject"
        try:
            person = radiographed_person(seed, NODES, folder)
            tracked = read_outcome(open_visit(folder).subject, Tracked).pushes
            pushes = {name: followed(found, person.true[name]) for name, found in tracked.items()}
            row |= {"ratios": dict(person.ratios), "kind": person.kind, "followed": pushes}
            for kind, seen in pushes_of(seed, folder, person).items():
                found = told(fit_pushes(seen, NAMES, person.ratios, extent="intervals"), person.ratios)
                if "z" not in found:
                    return {**row, "not made": f"{kind}: the estimate is {found['status']}"}
                row[kind] = {key: found[key] for key in ("estimate", "z", "joint", "p_value")}
        except SpinestiffError as error:
            return {**row, "not made": str(error)}
    return row


def _told(values: Sequence[Sequence[float]]) -> dict[str, list[float | None]]:
    """By ratio the mean over people and its standard error, which one person alone has not."""
    found = np.array(values)
    errors = found.std(axis=0, ddof=1) / np.sqrt(len(found)) if len(found) > 1 else [None] * len(NAMES)
    return {
        name: [round(float(mean), 3), None if error is None else round(float(error), 3)]
        for name, mean, error in zip(NAMES, found.mean(axis=0), errors)
    }


def summed_up(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Means over people. Ends the program where there is none."""
    found = [row for row in rows if KINDS[-1] in row]
    if not found:
        raise SystemExit("no row has figures; nothing was written")
    z = {kind: [row[kind]["z"] for row in found] for kind in KINDS}
    apart = {
        f"{first} less {second}": _told(np.subtract(z[first], z[second]).tolist())
        for first, second in (
            ("as tracked", "no supports"),
            ("no supports", "true motion"),
            ("reversed", "true motion"),
            ("true motion", "error model"),
        )
    }
    frames = [one for row in found for one in row["followed"].values()]
    return {
        "seeds": sorted(row["seed"] for row in found),
        "not_made": sorted(row["seed"] for row in rows if "not made" in row),
        "mean_z": {kind: _told(values) for kind, values in z.items()},
        "z_apart": apart,
        "median_p_value": {kind: round(float(np.median([row[kind]["p_value"] for row in found])), 3) for kind in KINDS},
        "followed_median": {key: round(float(np.median([one[key] for one in frames])), 4) for key in frames[0]},
        "code": sorted({row["code"] for row in found}),
    }


def main() -> None:
    asked = asked_for(__doc__, RESULTS, summed_up, first=FIRST, people=PEOPLE)
    if asked is None:
        return
    if find_spec("mmgpy") is None:
        raise SystemExit('the truths\' meshes need pip install -e ".[mesh]"')
    done = {row["seed"] for row in begun(asked.log)}
    for seed in range(asked.first, asked.first + asked.people):
        if seed not in done:
            row = run_one(seed)
            keep(asked.log, row)
            print(
                seed, row.get("not made") or {kind: np.round(row[kind]["z"], 2).tolist() for kind in KINDS}, flush=True
            )


if __name__ == "__main__":
    main()
