"""What a stance that nobody was told does to motions, by way of the geometry: ``discrepancy_data.STANCE_MM``.

    python benchmarks/discrepancy_stance.py --log FILE [--first N] [--subjects N]
    python benchmarks/discrepancy_stance.py --summary FILE... [--write]
    python benchmarks/discrepancy_stance.py --json

Subjects and pushes of ``discrepancy_pairs.py``. A subject's torso is personalised from corners with an error of
``Priors.annotation_mm``, once by somebody who stands as the views say, once by the same who stands otherwise, with the
same errors (``judgement_subjects.standing``: shift, lean, turn, distance). Compared are the motions under the pushes,
over their size, in root mean square over vertebrae and pushes: of the first torso with the truth, which is what
annotation does, and of the second with the first, which is what the stance does. Both are in proportion to corners'
errors nearly, so the stance counts for as many mm of them. ``--json`` prints what is stored.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from discrepancy_pairs import SEED, Bench, Modelled, Subject, modelled, personalised, subject_of
from kept_rows import asked_for, begun, keep

from spinestiff.anatomy.template import template_torso
from spinestiff.arrays import Floats
from spinestiff.errors import SpinestiffError
from spinestiff.estimation.discrepancy import motion_size
from spinestiff.estimation.priors import Priors

RESULTS = Path(__file__).parent / "results" / "discrepancy_stance.json"
ANNOTATION_MM = Priors().annotation_mm


def of_subject(subject: Subject) -> dict[str, Any]:
    """Relative differences of motion (F,) by what makes them, as a line of the log."""
    began = time.process_time()
    row: dict[str, Any] = {"subject": subject.number}
    try:
        base = Bench(subject.shaped(template_torso(subject.height_cm)))
        model = modelled(base, subject)
        moved = [
            _motions(Bench(_personalised(base, subject.number, stands_otherwise)), subject, model)
            for stands_otherwise in (False, True)
        ]
        row |= {"annotation": _apart(moved[0], model.motions), "stance": _apart(moved[1], moved[0])}
    except SpinestiffError as error:
        row["failed"] = str(error)
    return {**row, "cpu_s": round(time.process_time() - began, 1)}


def _personalised(base: Bench, number: int, stands_otherwise: bool) -> Any:
    marks, stance = (np.random.default_rng([SEED, number, *what.encode()]) for what in ("marks", "stance"))
    return personalised(base.torso, marks, ANNOTATION_MM, stance if stands_otherwise else None)


def _motions(bench: Bench, subject: Subject, model: Modelled) -> list[Floats]:
    found = []
    for frame in model.frames:
        load = bench.load(frame.side, frame.level, frame.force_n)
        found.append(bench.motion(bench.solve(frame.side, load, subject.ratios)))
    return found


def _apart(moved: Sequence[Floats], others: Sequence[Floats]) -> list[float]:
    return [round(motion_size(a - b) / motion_size(b), 5) for a, b in zip(moved, others, strict=True)]


def summarised(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Root mean squares over subjects and pushes, and how many mm of corners' errors the stance counts for."""
    whole = [row for row in rows if "failed" not in row]
    sizes = {key: [float(np.sqrt(np.mean(np.square(row[key])))) for row in whole] for key in ("annotation", "stance")}
    rms = {key: float(np.sqrt(np.mean(np.square(values)))) for key, values in sizes.items()}
    return {
        "subjects": len(whole),
        "failed": len(rows) - len(whole),
        "annotation_mm": ANNOTATION_MM,
        **{key: {"rms": round(rms[key], 4), "median": round(float(np.median(sizes[key])), 4)} for key in sizes},
        "stance_mm": round(ANNOTATION_MM * rms["stance"] / rms["annotation"], 2),
        "stance_mm_of_medians": round(
            ANNOTATION_MM * float(np.median(sizes["stance"]) / np.median(sizes["annotation"])), 2
        ),
    }


def main() -> None:
    asked = asked_for(__doc__, RESULTS, summarised, first=0, subjects=12)
    if asked is None:
        return
    done = {row["subject"] for row in begun(asked.log)}
    for number in range(asked.first, asked.first + asked.subjects):
        if number not in done:
            row = of_subject(subject_of(number))
            keep(asked.log, row)
            print(number, row.get("failed") or [row["annotation"], row["stance"]], row["cpu_s"], flush=True)


if __name__ == "__main__":
    main()
