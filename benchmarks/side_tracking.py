"""How well corners are followed through radiographs from the side that are marked without force alone.

Subjects of ``spinestiff synth --biplanar --cobb 25 --seed N`` have every lateral frame of their two pushes, of seven
and four frames up to 60 N, marked with an error of 0.3 mm in each coordinate. The marks of all frames under force are
taken away, ``spinestiff track`` follows the corners, and what it finds is compared with the marks that were taken away:
root mean square along an axis at the patient plane, of each frame; beside it how far the spine moved there, by the
marks, as a root mean square less the marks' error, and how many of the marked vertebrae were kept.
``docs/more-views.md`` quotes it.

    python benchmarks/side_tracking.py SCRATCH [--subjects 1] [--write]
    python benchmarks/side_tracking.py --json

Subjects that are in SCRATCH already are not made again; one takes six CPU minutes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from kept_rows import measure_once, rounded

from spinestiff.files import read_json, write_json
from spinestiff.study.runner import run_steps
from spinestiff.study.synthetic.recipe import Recipe
from spinestiff.study.synthetic.subject import synthesise, truth_path
from spinestiff.study.synthetic.visit import ANNOTATION_SD_MM, SIDE
from spinestiff.study.visit import open_visit
from spinestiff.subject.image_names import PushImage
from spinestiff.subject.outcomes import SidePicture, SideView, Tracked
from spinestiff.subject.records import PushRecord
from spinestiff.subject.run_record import read_outcome

RESULTS = Path(__file__).parent / "results" / "side_tracking.json"
COBB_DEG = 25.0
FEWEST = 3
"""Vertebrae of a frame that is used (``study.trials``)."""
Marks = Mapping[str, Sequence[Any]]


def without_marks(folder: Path) -> dict[str, Marks]:
    """Take the lateral marks of frames under force out of a subject's annotation, and give them by image."""
    path = folder / "annotation.json"
    kept = folder / "marks-taken-away.json"
    whole = read_json(path)
    named = {name: PushImage.named(name) for name in whole["images"]}
    names = [name for name, of_push in named.items() if of_push and of_push.view == SIDE and of_push.frame > 0]
    taken = {name: whole["images"].pop(name)["vertebrae"] for name in names}
    if not kept.is_file():
        write_json(kept, taken)
    if names:  # also where a program that was stopped had kept them and not yet taken them away
        write_json(path, whole)
    return {name: dict(marks) for name, marks in read_json(kept).items()}


def of_frame(view: SideView, picture: SidePicture, at_rest: SidePicture, marks: Marks) -> dict[str, Any]:
    """One frame's followed corners beside the marks that were taken away, mm."""
    sight = view.view.view()
    kept, errors, moved = 0, [], []
    first = dict(zip(at_rest.vertebrae, at_rest.corners_px))
    assert picture.quality is not None
    for name, corners, quality in zip(picture.vertebrae, picture.corners_px, picture.quality):
        if name not in marks:
            continue
        usable = np.array(quality) > 0.0
        kept += bool(usable.all())
        by_hand = sight.from_pixels(np.array(marks[name], dtype=float)) / sight.magnification
        found = sight.from_pixels(np.array(corners)) / sight.magnification
        errors.append((found - by_hand)[usable])
        moved.append(by_hand - sight.from_pixels(np.array(first[name])) / sight.magnification)
    off, way = np.concatenate(errors), np.concatenate(moved)
    return {
        "vertebrae": len(set(picture.vertebrae) & set(marks)),
        "kept": kept,
        "error_mm": float(np.sqrt(np.mean(off**2))) if kept >= FEWEST else None,
        "moved_mm": float(np.sqrt(max(np.mean(way**2) - 2.0 * ANNOTATION_SD_MM**2, 0.0))),
    }


def of_push(push: PushRecord, view: SideView, marks: Mapping[str, Marks]) -> Iterator[dict[str, Any]]:
    """Each frame that was followed."""
    at_rest = next(one for one in view.pictures if one.frame == 0)
    for picture in view.pictures:
        if picture.followed_from is not None:
            image = push.view_image(picture.frame, view.id)
            found = of_frame(view, picture, at_rest, marks[image])
            yield {"push": push.id, "force_n": push.forces_n[picture.frame], **found}


def of_subject(folder: Path, seed: int) -> dict[str, Any]:
    """A subject, made where it is not there."""
    if not truth_path(folder).is_file():
        synthesise(folder, Recipe(seed=seed, cobb_deg=COBB_DEG, biplanar=True))
    marks = without_marks(folder)
    visit = open_visit(folder)
    run_steps(visit, ("track",))
    pushes = read_outcome(visit.subject, Tracked).pushes
    rows = [row for push in visit.subject.record.pushes for row in of_push(push, pushes[push.id].sides[0], marks)]
    if len(rows) != len(marks) or not rows:
        raise SystemExit(
            f"{folder}: {len(rows)} frames were followed, wanted the {len(marks)} whose marks were taken away; "
            "delete the folder to have the subject made again"
        )
    return {"seed": seed, "frames": [rounded(row) for row in rows]}


def summarised(subjects: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Least and largest of all frames that are used, and of those up to 20 N and with the largest force."""
    rows = [row for one in subjects for row in one["frames"]]
    largest = max(row["force_n"] for row in rows)

    def ends(name: str, of: Sequence[Mapping[str, Any]]) -> list[float]:
        values = [row[name] for row in of if row[name] is not None]
        return [min(values), max(values)] if values else []

    return {
        "frames": len(rows),
        "error_mm": ends("error_mm", rows),
        "moved_mm": ends("moved_mm", rows),
        "vertebrae": ends("vertebrae", rows),
        "kept_up_to_20_n": ends("kept", [row for row in rows if row["force_n"] <= 20.5]),
        "kept_at_largest_force": ends("kept", [row for row in rows if row["force_n"] == largest]),
    }


def measured(scratch: Path, subjects: int) -> dict[str, Any]:
    """Make, track, compare."""
    if subjects < 1:
        raise SystemExit(f"--subjects {subjects}: wanted 1 or more")
    scratch.mkdir(parents=True, exist_ok=True)
    found = [of_subject(scratch / f"seed-{seed}", seed) for seed in range(subjects)]
    return {**summarised(found), "subjects": found}


if __name__ == "__main__":
    measure_once(__doc__, RESULTS, measured, place="SCRATCH", subjects=1)
