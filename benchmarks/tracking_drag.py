"""How far tracking is taken along by what lies before and behind a vertebra, and what of that error frames share.

Synthetic subjects of many curves and stiffnesses are radiographed under three pushes, two forces each, and tracked. A
vertebra's error, in the channels of ``estimation.noise`` (shifts along columns and rows, and the turn), over the root
mean square of the frame's shifts along columns, is its *share*. Printed are the shares' size, how alike they are along
the spine, and how alike for the same vertebra in the same frame, in another frame of its push, and under another push:
what two pushes have in common is no chance of a picture. ``estimation.noise`` has the model of it. Printed, too, is the
size of the errors over what tracking predicts, of vertebrae whose drag should be smaller than that, how far
vertebrae lie aside, and what the discs between them truly shear.

``python benchmarks/tracking_drag.py FOLDER [--subjects N] [--first SEED] [--write]`` (a minute a subject; FOLDER keeps
them, and a run goes on with what is there).
"""

from __future__ import annotations

import argparse
import datetime
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import norm

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.arrays import Floats
from spinestiff.errors import SpinestiffError
from spinestiff.estimation.priors import Priors
from spinestiff.files import read_json
from spinestiff.imaging.tracking.quality import LOWEST_QUALITY, error_of
from spinestiff.study.runner import run_steps
from spinestiff.study.synthetic.recipe import Recipe, SyntheticPush
from spinestiff.study.synthetic.spines import CURVES
from spinestiff.study.synthetic.subject import made_by, synthesise, truth_path
from spinestiff.study.visit import open_visit
from spinestiff.subject.outcomes import Tracked
from spinestiff.subject.run_record import read_outcome

RESULTS = Path(__file__).parent / "results" / "tracking_drag.json"
FIRST, SUBJECTS, NODES = 300, 16, 3000
HEIGHT_CM, COBB_DEG, FORCE_N = (140.0, 172.0), (10.0, 65.0), 60.0
BENDING, TISSUE = (0.03, 0.5), (0.025, 0.2)
LEVELS, SHARES = (6.0, 8.0, 10.0), (0.0, 0.5, 1.0)
# Frames in which the spine moved by less (mm, root mean square at the patient plane) say little of shares.
LEAST_MM = 3.0
# One wrong vertebra must not decide; a share beyond this counts as this, and so does an error over the predicted one.
LARGEST, LARGEST_ERROR = 0.08, 8.0
DISTANCES = 9
FAR_MM = 0.6
CHANNELS = ("shift along columns", "shift along rows", "turn")


@dataclass(frozen=True)
class Shares:
    """Of one frame that moved by ``mm``: (3, 17) shares, NaN where a vertebra was not followed, errors over the
    predicted one of a corner along one axis, NaN where drag may be larger, (n,) mm by which followed vertebrae lie
    aside of where they are, and what discs shear, as ``disc_shear``."""

    push: str
    frame: int
    mm: float
    values: Floats
    over_predicted: Floats
    sideways_mm: Floats
    sheared: Floats


def recipe(seed: int) -> Recipe:
    """A subject of this benchmark."""
    random = np.random.default_rng([29, seed])
    bending, tissue = (float(np.exp(random.uniform(*np.log(limits)))) for limits in (BENDING, TISSUE))
    pushes = tuple(
        SyntheticPush(f"rib{level:g}", level, SHARES, ("unused", "training", "training")) for level in LEVELS
    )
    return Recipe(
        seed=seed,
        height_cm=round(float(random.uniform(*HEIGHT_CM)), 0),
        cobb_deg=round(float(random.uniform(*COBB_DEG)) * float(random.choice([-1.0, 1.0])), 1),
        curve=str(random.choice(list(CURVES))),
        force_n=FORCE_N,
        ratios=(bending, tissue),
        pushes=pushes,
        nodes=NODES,
    )


def shares(folder: Path, wanted: Recipe) -> list[Shares]:
    """Of all frames of a subject that moved enough; the subject is made and tracked if it is not there."""
    if not made_by(folder, wanted):
        synthesise(folder, wanted)
    visit = open_visit(folder)
    run_steps(visit, ("track",))
    tracked, truth = read_outcome(visit.subject, Tracked), read_json(truth_path(folder))
    found = []
    for name, push in tracked.pushes.items():
        rows = [VERTEBRAE.index(vertebra) for vertebra in push.vertebrae]
        true = np.array([frame["corners_px"] for frame in truth["pushes"][name]])[:, rows]
        seen = np.array([frame.corners_px for frame in push.frames])
        quality = np.array([frame.quality for frame in push.frames])
        followed = quality > 0.0
        view = push.view.view()
        mm = float(np.mean(view.pixel_spacing) / view.magnification)
        for number in range(1, len(seen)):
            moved = 2.0 * mm * (true[number] - true[0]).mean(1)[:, 0]
            size = float(np.sign(moved.sum()) * np.sqrt(np.mean(moved**2)))
            # The annotation's own error is the same in both frames.
            error = mm * channels(seen[number] - seen[0] - (true[number] - true[0]), true[number])
            values = np.full((3, len(VERTEBRAE)), np.nan)
            values[:, rows] = np.where(followed[number].all(1), np.clip(error / size, -LARGEST, LARGEST), np.nan)
            predicted = np.sqrt(0.5 * np.mean(error_of(np.maximum(quality[number], LOWEST_QUALITY)) ** 2, axis=1))
            over = np.full((3, len(VERTEBRAE)), np.nan)
            told = (quality[number] > LOWEST_QUALITY).all(1) & (Priors.tracking_drag * abs(size) < predicted)
            over[:, rows] = np.where(told, np.clip(error / predicted, -LARGEST_ERROR, LARGEST_ERROR), np.nan)
            if abs(size) >= 2.0 * LEAST_MM:
                sideways = 0.5 * np.abs(error[0])[followed[number].all(1)]
                sheared = disc_shear(true[0], true[number])
                found.append(Shares(name, number, abs(size) / 2.0, values, over, sideways, sheared))
    return found


def channels(difference: Floats, corners: Floats) -> Floats:
    """(3, Nv) shifts and turn of differences (Nv, 4, 2) of corners (Nv, 4, 2), orthonormal."""
    arms = corners - corners.mean(axis=1, keepdims=True)
    turn = np.stack([-arms[..., 1], arms[..., 0]], -1)
    turn /= np.linalg.norm(turn, axis=(1, 2))[:, None, None]
    return np.stack([*(0.5 * difference.sum(axis=1).T), np.einsum("vki,vki->v", turn, difference)])


def disc_shear(start: Floats, now: Floats) -> Floats:
    """(Nv - 1,) how far the point midway between two vertebrae is carried to different places across the spine by the
    one and by the other, over their distance; corners (Nv, 4, 2) before and after a motion."""
    before, after = (one.mean(1) for one in (start, now))
    arms, moved = ((one - one.mean(1, keepdims=True)) @ np.array([1.0, 1.0j]) for one in (start, now))
    turn = np.sum(arms.conj() * moved, axis=1)
    turn = turn / np.abs(turn)
    half = 0.5 * np.diff(before, axis=0) @ np.array([1.0, 1.0j])
    gap = np.diff(after, axis=0) @ np.array([1.0, 1.0j]) - (turn[:-1] + turn[1:]) * half
    across = moved[:-1, 0] + moved[:-1, 3] - moved[:-1, 1] - moved[:-1, 2]
    return np.asarray(np.abs((gap * across.conj()).real) / np.abs(across) / (2.0 * np.abs(half)))


def pairs(subjects: list[list[Shares]]) -> Iterator[tuple[str, Shares, Shares]]:
    """All pairs of frames of the same subject, with what they have in common."""
    for frames in subjects:
        for i, a in enumerate(frames):
            for b in frames[i:]:
                yield "same frame" if a is b else "same push" if a.push == b.push else "other push", a, b


def summarised(subjects: list[list[Shares]]) -> dict[str, Any]:
    """Sizes and correlations of the shares, and sizes of the errors sideways."""
    result: dict[str, Any] = {}
    for c, channel in enumerate(CHANNELS):
        entry: dict[str, Any] = {}
        for kind in ("same frame", "same push", "other push"):
            products: list[list[float]] = [[] for _ in range(DISTANCES)]
            for found, a, b in pairs(subjects):
                if found != kind:
                    continue
                for distance in range(DISTANCES):
                    kept = slice(None, len(VERTEBRAE) - distance)
                    for x, y in ((a, b), (b, a)):
                        product = x.values[c][kept] * y.values[c][distance:]
                        products[distance] += product[np.isfinite(product)].tolist()
            means = np.array([np.mean(product) for product in products])
            entry[kind] = {
                "size": round(float(np.sign(means[0]) * np.sqrt(abs(means[0]))), 5),
                "by_distance": np.round(means / means[0], 3).tolist(),
            }
        everything = np.stack([frame.values[c] for frames in subjects for frame in frames])
        with np.errstate(all="ignore"):
            entry["mean_by_vertebra"] = {
                name: None if np.isnan(mean) else round(float(mean), 4)
                for name, mean in zip(VERTEBRAE, np.nanmean(everything, axis=0))
            }
        over = np.concatenate([frame.over_predicted[c] for frames in subjects for frame in frames])
        over = np.abs(over[np.isfinite(over)])
        entry["over_predicted"] = {
            "vertebrae": len(over),
            "size": round(float(np.sqrt(np.mean(over**2))), 3),
            "of_the_median": round(float(np.median(over) / norm.ppf(0.75)), 3),
            "of_97_5_percent": round(float(np.quantile(over, 0.975) / norm.ppf(0.9875)), 3),
        }
        result[channel] = entry
    return result


def aside(subjects: list[list[Shares]]) -> dict[str, float]:
    """How far vertebrae lie aside of where they are, mm: percentiles, and the share of those beyond ``FAR_MM``."""
    errors = np.concatenate([frame.sideways_mm for frames in subjects for frame in frames])
    found = {f"{percent} %": round(float(np.percentile(errors, percent)), 3) for percent in (50, 95, 99)}
    return found | {f"beyond {FAR_MM} mm": round(float(np.mean(errors > FAR_MM)), 4), "vertebrae": len(errors)}


def sheared(subjects: list[list[Shares]]) -> dict[str, float]:
    """Percentiles of what discs truly shear in the picture, over the distance of their vertebrae."""
    found = np.concatenate([frame.sheared for frames in subjects for frame in frames])
    return {f"{percent} %": round(float(np.percentile(found, percent)), 5) for percent in (50, 68, 95, 99)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--subjects", type=int, default=SUBJECTS)
    parser.add_argument("--first", type=int, default=FIRST)
    parser.add_argument("--write", action="store_true", help="store the result in benchmarks/results/")
    asked = parser.parse_args()
    found, failed = [], 0
    for seed in range(asked.first, asked.first + asked.subjects):
        try:
            found.append(shares(asked.folder / f"{seed}", recipe(seed)))
        except SpinestiffError as error:
            failed += 1
            print(f"{seed}: {error}", flush=True)
        else:
            print(f"{seed}: {len(found[-1])} frames", flush=True)
    result = {
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "subjects": len(found),
        "not_made": failed,
        "frames": sum(len(frames) for frames in found),
        "shares": summarised(found),
        "aside_mm": aside(found),
        "disc_shear": sheared(found),
    }
    print(json.dumps(result, indent=1))
    if asked.write:
        RESULTS.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
