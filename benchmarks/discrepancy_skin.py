"""How far a person's skin may move from what the model says: ``discrepancy.SKIN_SD`` and ``SKIN_LENGTH_MM``.

    python benchmarks/discrepancy_skin.py [--subjects N] [--rerun] [--json]

The pairs of ``discrepancy_out_of_plane.py``. Markers on front and flanks of the model ride on the nearest points of the
truth's skin, too; differences of their motion between truth and model over the size of the model's frontal motion, in
root mean square over markers and pushes, and how alike they are by their distance along the skin. No variant lets the
skin slide on what lies under it: that is the prior ``marker_slide``. Prints the stored figures, or makes them anew.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from discrepancy_out_of_plane import KINDS, pairs
from discrepancy_pairs import Bench, Subject, modelled, subject_of
from rich.console import Console
from rich.table import Table

from spinestiff.anatomy.template import template_torso
from spinestiff.arrays import Floats
from spinestiff.errors import SpinestiffError
from spinestiff.estimation.discrepancy import SKIN_LENGTH_MM, SKIN_SD, motion_size
from spinestiff.personalise.skin_surface import nearest_points, skin_surface
from spinestiff.study.synthetic.markers import spread_markers

RESULTS = Path(__file__).parent / "results" / "discrepancy_skin.json"
NAMES = ("to the left", "upwards", "to the front")
MARKERS = 24
STEP_MM = 6.0
BINS_MM = (40, 80, 120, 160, 200, 250, 300, 400)


def of_subject(subject: Subject, cache: Path) -> dict[str, Any]:
    """By kind, relative differences (frames, M, 3), and the markers' places (M, 3) mm on the model."""
    base = Bench(subject.shaped(template_torso(subject.height_cm)))
    model = modelled(base, subject)
    frames = [(frame, state) for frame, state in zip(model.frames, model.states) if frame.use == "grid"]
    found: dict[str, Any] = {}
    for kind in KINDS:
        try:
            found[kind] = _differences(subject, kind, base, frames, cache)
        except SpinestiffError as error:
            print(f"{subject.number} {kind}: {error}")
    return found


def _differences(subject: Subject, kind: str, base: Bench, frames: list[Any], cache: Path) -> tuple[Floats, Floats]:
    found, places = [], np.zeros((MARKERS, 3))
    carried = None
    for truth, true, own, state in pairs(subject, kind, base, frames, cache):
        if carried is None:
            points, _ = spread_markers(own.torso, MARKERS, np.full((1, 3), 1e6))
            places = points.positions(own.torso, own.torso.rest_pose)
            skin = skin_surface(truth.torso, STEP_MM)
            there, _ = nearest_points(truth.torso, skin, places)
            carried = points, there
        points, there = carried
        moved = points.positions(own.torso, state) - places
        truly = there.positions(truth.torso, true) - there.positions(truth.torso, truth.torso.rest_pose)
        found.append((truly - moved) / motion_size(own.motion(state)))
    return np.array(found), places


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Root mean squares by kind and of all alike, and correlations by distance."""
    kinds = {kind: [row[kind] for row in rows if kind in row] for kind in KINDS}
    kinds = {kind: found for kind, found in kinds.items() if found}
    squares = {
        kind: np.mean(np.concatenate([values.reshape(-1, 3) for values, _ in found]) ** 2, axis=0)
        for kind, found in kinds.items()
    }
    own, across = np.zeros((3, len(BINS_MM) - 1)), np.zeros((3, len(BINS_MM) - 1))
    for values, places in (pair for found in kinds.values() for pair in found):
        apart = np.linalg.norm(places[:, None] - places, axis=-1)
        which = np.digitize(apart, BINS_MM) - 1
        for axis in range(3):
            products = np.einsum("fm,fn->mn", values[..., axis], values[..., axis]) / len(values)
            squared = np.mean(values[..., axis] ** 2, axis=0)
            for number in range(len(BINS_MM) - 1):
                inside = (which == number) & (apart > 0.0)
                across[axis, number] += products[inside].sum()
                own[axis, number] += (0.5 * np.add.outer(squared, squared))[inside].sum()
    return {
        "pairs": {kind: len(found) for kind, found in kinds.items()},
        "sd": {kind: np.sqrt(value).round(4).tolist() for kind, value in squares.items()},
        "all": np.sqrt(np.mean(list(squares.values()), axis=0)).round(4).tolist(),
        "bins_mm": list(BINS_MM),
        "correlation": {name: np.round(one / two, 2).tolist() for name, one, two in zip(NAMES, across, own)},
    }


def main() -> None:
    """Print the stored figures, or make them anew."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--subjects", type=int, default=2)
    parser.add_argument("--rerun", action="store_true")
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    if asked.rerun:
        rows = []
        with tempfile.TemporaryDirectory() as cache:
            for number in range(asked.subjects):
                try:
                    rows.append(of_subject(subject_of(number), Path(cache)))
                except SpinestiffError as error:
                    print(f"{number}: {error}")
                if rows:
                    RESULTS.write_text(json.dumps(summary(rows), indent=1) + "\n", encoding="utf-8")
    stored = json.loads(RESULTS.read_text(encoding="utf-8"))
    if asked.json:
        print(json.dumps(stored))
        return
    table = Table("kind", "pairs", *NAMES, title="difference of the skin's motion over the size of the frontal motion")
    for kind, sds in stored["sd"].items():
        table.add_row(kind, str(stored["pairs"][kind]), *(f"{sd:.3f}" for sd in sds))
    table.add_row("all alike", "", *(f"{sd:.3f}" for sd in stored["all"]))
    table.add_row("as the package has it", "", *(f"{sd:.3f}" for sd in SKIN_SD))
    console = Console()
    console.print(table)
    middles = [0.5 * (low + high) for low, high in zip(stored["bins_mm"], stored["bins_mm"][1:])]
    for (name, values), length in zip(stored["correlation"].items(), SKIN_LENGTH_MM):
        expected = [round(float(np.exp(-middle / length)), 2) for middle in middles]
        console.print(f"{name}: alike by {values} in bins at {stored['bins_mm']} mm; the package has {expected}")


if __name__ == "__main__":
    main()
