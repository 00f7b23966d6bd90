"""What takes tracked vertebrae along: radiographs without noise, of the whole trunk and of parts of it.

The first subjects of ``tracking_drag.py`` are radiographed again, each of

    all                 as there
    bones               with skin, muscles, lungs and bowel left out, but for a skin of even tissue
    vertebrae           with skin and vertebrae alone
    bodies              with skin and vertebral bodies alone: arch and processes are pressed flat behind the body
    bodies, far source  the same from a source 9 m away, at which a shift turns nothing against the beam

``python benchmarks/drag_causes.py FOLDER [--subjects N] [--write]`` prints, for shifts along columns and for turns of
vertebrae, what ``tracking_drag.py`` calls their share: its mean, root mean square, and root mean square of what
different pushes have in common (a minute for each subject and kind; FOLDER keeps them).
"""

from __future__ import annotations

import argparse
import datetime
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from tracking_drag import CHANNELS, FIRST, Shares, pairs, recipe, shares

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.errors import SpinestiffError
from spinestiff.imaging.projection import XRayView, frontal_view
from spinestiff.imaging.synthetic import acquisition as acquired
from spinestiff.imaging.synthetic import torso_absorbers as parts
from spinestiff.imaging.synthetic.acquisition import Acquisition
from spinestiff.imaging.synthetic.rendering import Absorber
from spinestiff.study.synthetic import visit as synthetic
from spinestiff.study.synthetic.recipe import Recipe

RESULTS = Path(__file__).parent / "results" / "drag_causes.json"
KINDS = ("all", "bones", "vertebrae", "bodies", "bodies, far source")
SUBJECTS = 4
FAR_MM, BEHIND_MM = 9000.0, 160.0  # of the source from the patient, and of the detector behind that
FLAT_MM = 1.0  # behind a body's box, where what lies farther back is pressed to
PHOTONS = 1000.0  # times the usual ones


def quiet(seed: int, kind: str) -> Recipe:
    """The subject of a seed, radiographed without noise, bowel gas (but for all) and drift."""
    wanted = recipe(seed)
    how: Acquisition = wanted.acquisition
    exposure = replace(how.exposure, photons=PHOTONS * how.exposure.photons, electronic_noise=0.0)
    gas = how.gas if kind == "all" else 0.0
    return replace(wanted, acquisition=replace(how, exposure=exposure, gas=gas, exposure_drift=0.0))


@contextmanager
def showing(kind: str) -> Iterator[None]:
    """Radiographs show these parts of a trunk."""

    def absorbers(torso: TorsoModel, state: TorsoState, seed: int = 0, breath: float = 0.0) -> tuple[Absorber, ...]:
        # Even, as a pattern that stays where it is would take vertebrae along, too.
        found = [replace(parts._skin(torso, state, seed), texture=None)]
        for bone, name in enumerate(torso.bone_names):
            if kind != "bones" and name not in VERTEBRAE:
                continue
            one = parts._bone(torso, state, bone, seed)
            found.append(_flattened(torso, state, bone, one) if kind.startswith("bodies") else one)
        return tuple(found)

    def far(**how: Any) -> XRayView:
        return frontal_view(sid=FAR_MM + BEHIND_MM, source_to_patient=FAR_MM, **how)

    if kind == "all":
        yield
        return
    view = far if kind.endswith("far source") else frontal_view
    with (
        patch.object(acquired, "torso_absorbers", absorbers),
        patch.object(acquired, "bowel", lambda *_: []),
        patch.object(synthetic, "frontal_view", view),
    ):
        yield


def _flattened(torso: TorsoModel, state: TorsoState, bone: int, whole: Absorber) -> Absorber:
    box = torso.vertebra_boxes[VERTEBRAE.index(torso.bone_names[bone])]
    vertices = torso.bone_surfaces[bone].vertices.copy()
    vertices[:, 2] = np.maximum(vertices[:, 2], box[..., 2].min() - FLAT_MM)
    return replace(whole, vertices=vertices @ state.bone_rotations[bone].T + state.bone_positions[bone])


def told(subjects: list[list[Shares]]) -> dict[str, Any]:
    """Sizes of the shares in shifts along columns and in turns."""
    found: dict[str, Any] = {"subjects": len(subjects), "frames": sum(map(len, subjects))}
    for row, channel in enumerate(CHANNELS):
        if channel == "shift along rows":
            continue
        every = np.concatenate([frame.values[row] for frames in subjects for frame in frames])
        products = [a.values[row] * b.values[row] for kind, a, b in pairs(subjects) if kind == "other push"]
        common = float(np.nanmean(products))
        found[channel] = {
            "mean": round(float(np.nanmean(every)), 4),
            "rms": round(float(np.sqrt(np.nanmean(every**2))), 4),
            "common to pushes": round(float(np.sign(common) * np.sqrt(abs(common))), 4),
        }
    return found


def main() -> None:
    """Make, track, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--subjects", type=int, default=SUBJECTS)
    parser.add_argument("--write", action="store_true", help="store the result in benchmarks/results/")
    asked = parser.parse_args()
    result: dict[str, Any] = {
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "subjects": asked.subjects,
    }
    for kind in KINDS:
        found = []
        for seed in range(FIRST, FIRST + asked.subjects):
            folder = asked.folder / f"{kind.replace(', ', '-').replace(' ', '-')}-{seed}"
            try:
                with showing(kind):
                    found.append(shares(folder, quiet(seed, kind)))
            except SpinestiffError as error:
                print(f"{kind} {seed}: {error}", flush=True)
        result[kind] = told(found)
        print(kind, json.dumps(result[kind]), flush=True)
    if asked.write:
        RESULTS.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
