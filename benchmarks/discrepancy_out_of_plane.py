"""How far a person may move out of the frontal plane from what the model says: ``discrepancy.OUT_OF_PLANE_SD``.

    python benchmarks/discrepancy_out_of_plane.py [--subjects N] [--rerun] [--json]

Pairs of ``discrepancy_pairs.py``, of the kinds that an estimate counts as model discrepancy, under pushes at ribs 5,
7.5 and 10 of each side: differences of shift to the front, of flexion and of axial turn (times 20 mm) between truth and
model, over the size of the model's frontal motion, in root mean square over vertebrae and pushes. The shipped modes
hold none of this; an estimate from more than corners of frontal radiographs needs it. Prints the stored figures, or
makes them anew.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from discrepancy_pairs import (
    MESHES,
    OF_BASE,
    STANDARD_LAW,
    Bench,
    Subject,
    equal_ratios,
    modelled,
    own_body,
    personalised,
    subject_of,
)
from rich.console import Console
from rich.table import Table

from spinestiff.anatomy.rotation import log_so3
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.template import template_torso
from spinestiff.arrays import Floats
from spinestiff.errors import SpinestiffError
from spinestiff.estimation.discrepancy import OUT_OF_PLANE_LENGTH, OUT_OF_PLANE_SD, TURN_ARM_MM, motion_size

RESULTS = Path(__file__).parent / "results" / "discrepancy_out_of_plane.json"
KINDS = ("disc centres", "stiffening", "layers", "other mesh", "geometry", "body")
NAMES = ("shift to the front", "flexion", "axial turn")
FARTHEST = 8  # vertebrae apart, of the correlations


def motion(bench: Bench, state: TorsoState) -> Floats:
    """(17, 3) shift to the front, mm, and turns about the axes to the left and upwards, times ``TURN_ARM_MM``."""
    bones, rest = bench.torso.vertebra_bones, bench.torso.rest_pose
    shift = (state.bone_positions - rest.bone_positions)[bones, 2]
    turn = log_so3(state.bone_rotations[bones] @ np.swapaxes(rest.bone_rotations[bones], 1, 2))
    return np.column_stack([shift, TURN_ARM_MM * turn[:, :2]])


def of_subject(subject: Subject) -> dict[str, list[Any]]:
    """By kind, differences (frames, 17, 3) relative to the size of the frontal motion."""
    base = Bench(subject.shaped(template_torso(subject.height_cm)))
    model = modelled(base, subject)
    frames = [(frame, state) for frame, state in zip(model.frames, model.states) if frame.use == "grid"]
    found: dict[str, list[Any]] = {}
    for kind in KINDS:
        try:
            found[kind] = _differences(subject, kind, base, frames).tolist()
        except SpinestiffError as error:
            print(f"{subject.number} {kind}: {error}")
    return found


def _differences(subject: Subject, kind: str, base: Bench, frames: list[Any]) -> Floats:
    found = []
    for truth, true, own, state in pairs(subject, kind, base, frames):
        found.append((motion(truth, true) - motion(own, state)) / motion_size(own.motion(state)))
    return np.array(found)


def pairs(
    subject: Subject, kind: str, base: Bench, frames: list[Any]
) -> Iterator[tuple[Bench, TorsoState, Bench, TorsoState]]:
    """Of each frame truth and its state, model and its state."""
    random, ratios, own = subject.random(kind), subject.ratios, base
    if kind in OF_BASE:
        truth, _ = OF_BASE[kind](base.torso, random)
        if kind not in STANDARD_LAW:
            ratios, _ = equal_ratios(truth, subject.ratios)
    elif kind == "geometry":
        truth, own = base, Bench(personalised(base.torso, random))
    elif kind == "body":
        body, reference, _ = own_body(subject, random)
        truth, own = Bench(body), Bench(reference)
    else:
        seed = int(random.integers(1, 10**6))
        truth = Bench(subject.shaped(template_torso(subject.height_cm), MESHES[kind], seed))
    for frame, state in frames:
        where = frame.side, frame.level, frame.force_n
        if own is not base:
            state = own.solve(frame.side, own.load(*where), subject.ratios)
        start = state if truth.torso.rest_pose.dofs == state.dofs else None
        yield truth, truth.solve(frame.side, truth.load(*where), ratios, start), own, state


def summary(rows: list[dict[str, list[Any]]]) -> dict[str, Any]:
    """Root mean squares by kind and of all kinds alike, and correlations along the spine by distance."""
    kinds = {kind: np.concatenate([row[kind] for row in rows if kind in row]) for kind in KINDS}
    squares = {kind: np.mean(values**2, axis=(0, 1)) for kind, values in kinds.items()}
    moments = np.mean([np.einsum("fvc,fwc->cvw", v, v) / len(v) for v in kinds.values()], axis=0)
    sds = np.sqrt(np.einsum("cvv->cv", moments))
    correlation = moments / (sds[:, :, None] * sds[:, None])
    along = [[float(np.mean(np.diag(one, k))) for k in range(1, FARTHEST + 1)] for one in correlation]
    return {
        "pairs": {kind: sum(kind in row for row in rows) for kind in KINDS},
        "sd": {kind: np.sqrt(value).round(4).tolist() for kind, value in squares.items()},
        "all": np.sqrt(np.mean(list(squares.values()), axis=0)).round(4).tolist(),
        "correlation": {name: np.round(values, 2).tolist() for name, values in zip(NAMES, along)},
    }


def main() -> None:
    """Print the stored figures, or make them anew."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--subjects", type=int, default=6)
    parser.add_argument("--rerun", action="store_true")
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    if asked.rerun:
        rows = []
        for number in range(asked.subjects):
            try:
                rows.append(of_subject(subject_of(number)))
            except SpinestiffError as error:
                print(f"{number}: {error}")
        RESULTS.write_text(json.dumps(summary(rows), indent=1) + "\n", encoding="utf-8")
    stored = json.loads(RESULTS.read_text(encoding="utf-8"))
    if asked.json:
        print(json.dumps(stored))
        return
    table = Table("kind", "pairs", *NAMES, title="difference over the size of the frontal motion")
    for kind, sds in stored["sd"].items():
        table.add_row(kind, str(stored["pairs"][kind]), *(f"{sd:.3f}" for sd in sds))
    table.add_row("all alike", "", *(f"{sd:.3f}" for sd in stored["all"]))
    table.add_row("as the package has it", "", *(f"{sd:.3f}" for sd in OUT_OF_PLANE_SD))
    console = Console()
    console.print(table)
    for name, values in stored["correlation"].items():
        expected = np.exp(-np.arange(1, FARTHEST + 1) / OUT_OF_PLANE_LENGTH).round(2).tolist()
        console.print(f"{name}: alike by {values} at 1 to {FARTHEST} vertebrae apart; the package has {expected}")


if __name__ == "__main__":
    main()
