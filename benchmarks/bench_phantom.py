"""What a bench phantom's pictures tell of its joints: scatter, intervals, and what these are made of.

Pictures of the phantom that ``docs/bench-phantom.md`` shows are made by a planar chain of hinges that shares no code
with the model (``tests/bench_columns.py``), with marks found to 0.1 mm, and analysed by ``spinestiff phantom``. Found
of ``--sets`` such sets, seeded: scatter of the log of the joints' ratio, half the width of its intervals, and how many
hold 1. Of the first set: half the width with 5 % on the size of motions, force, direction and pushed point, both and
the marks' error left out or smaller; and what is found where the gauge reads 20 % high. With rubber, whose pictures the
model makes itself: how far joints and rubber are known, what a fit costs, and how far the top moves on meshes of four
spacings. The page quotes all of it.

    python benchmarks/bench_phantom.py [--sets 40] [--write]
    python benchmarks/bench_phantom.py --json
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from kept_rows import measure_once, rounded

from spinestiff.arrays import Floats
from spinestiff.curves.corner_files import ImageCorners
from spinestiff.estimation import discrepancy
from spinestiff.imaging.features import silhouette_shares, state_features
from spinestiff.study.phantom import BenchComparison, analyse, build_phantom, push_on
from spinestiff.subject.phantom_record import PhantomRecord

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from bench_columns import documented, pictures

RESULTS = Path(__file__).parent / "results" / "bench_phantom.json"
MARK_MM, GAUGE = 0.1, 1.2
# What is left out of the estimator's errors for the second set of rows.
KNOWN = ("force_scale", "force_offset_n", "direction_deg", "push_height_mm", "push_depth_mm")
RUBBER = {"width_mm": 90.0, "depth_mm": 70.0, "young_mpa": 0.05, "young_sd_mpa": 0.005}
SPACINGS_MM = (60.0, 20.0, 14.0, 10.0)
USUAL_SPACING_MM = 14.0
# A strip of 0.5 mm where the page's has 0.8.
SOFTER = (0.8 / 0.5) ** 3
PUSHED = "T12 right 10"
"""Of the page's frames, the one whose motion with rubber is told."""


def bench_values(record: PhantomRecord) -> Floats:
    """(n,) N mm/rad, what the page's weights and turns give."""
    return np.array([joint.stiffness for joint in build_phantom(record).joints])


def half_width(one: BenchComparison) -> float:
    """Half the width of the estimate's 95 % interval, of the log."""
    return float(0.5 * np.log(one.fit_high / one.fit_low))


def told(one: BenchComparison) -> dict[str, Any]:
    """An estimate over the bench value."""
    return {"ratio": one.ratio, "fit_95": [one.fit_low, one.fit_high], "half_width": half_width(one)}


def of_sets(record: PhantomRecord, sets: int) -> dict[str, Any]:
    """Over sets of pictures whose marks are found anew."""
    stiffness, found = bench_values(record), []
    for seed in range(sets):
        (joints,) = analyse(record, pictures(record, stiffness, seed, MARK_MM)).comparisons
        found.append(joints)
    logs = np.log([one.ratio for one in found])
    return {
        "mean_log": float(logs.mean()),
        "sd_log": float(logs.std(ddof=1)),
        "half_width": {
            "mean": float(np.mean([half_width(one) for one in found])),
            "least": float(min(half_width(one) for one in found)),
            "largest": float(max(half_width(one) for one in found)),
        },
        "hold_1": sum(one.fit_low <= 1.0 <= one.fit_high for one in found),
        "agree": sum(one.verdict == "agrees" for one in found),
    }


def of_parts(record: PhantomRecord) -> dict[str, Any]:
    """What the interval of the first set is made of, and a gauge that reads too high."""
    stiffness = bench_values(record)
    seen = pictures(record, stiffness, 0, MARK_MM)
    known = record.model_copy(update={"errors": {**record.errors, **dict.fromkeys(KNOWN, 0.0)}})
    fine = record.picture.model_copy(update={"corner_sd_mm": 0.2 * MARK_MM})
    better = record.model_copy(update={"picture": fine})

    def width(of: PhantomRecord, motion_sd: float = discrepancy.MOTION_SD) -> float:
        with patch.object(discrepancy, "MOTION_SD", motion_sd):
            (joints,) = analyse(of, seen).comparisons
        return half_width(joints)

    high = analyse(record, pictures(record, stiffness, 0, MARK_MM, GAUGE))
    as_it_is = analyse(record, seen)
    return {
        "first_set": {
            **told(as_it_is.comparisons[0]),
            "predicted": {one.image: [one.motion_mm, one.rmse_mm] for one in as_it_is.predicted},
            "p_value": as_it_is.p_value,
        },
        "half_width": {
            "all errors": width(record),
            "without the model's 5 %": width(record, 0.0),
            "force, direction and point known": width(known),
            "without both": width(known, 0.0),
            "marks found five times as well": width(better),
        },
        "gauge_20_percent_high": {**told(high.comparisons[0]), "verdict": high.comparisons[0].verdict},
    }


def in_rubber(record: PhantomRecord, spacing_mm: float) -> PhantomRecord:
    """The page's phantom with a softer strip in a block of rubber."""
    joints = [
        joint.model_copy(update={"turns_deg": tuple(SOFTER * turn for turn in joint.turns_deg)})
        for joint in record.joints
    ]
    made = {**record.model_dump(mode="json"), "joints": [joint.model_dump(mode="json") for joint in joints]}
    return PhantomRecord.model_validate({**made, "rubber": {**RUBBER, "spacing_mm": spacing_mm}})


def seen_in_rubber(record: PhantomRecord) -> tuple[tuple[ImageCorners, ...], float]:
    """Pictures by the model itself, and how far the top block moves in ``PUSHED``, mm."""
    phantom, random = build_phantom(record), np.random.default_rng(0)
    torso, view = phantom.torso, phantom.view
    shares = silhouette_shares(torso, view, torso.rest_pose)
    top, seen, moved = torso.bone(record.levels[0]), [], 0.0
    for frame in record.frames:
        state = phantom.problem.solve(push_on(torso, frame)).require().state
        if frame.image == PUSHED:
            moved = float(np.linalg.norm(state.bone_positions[top] - torso.rest_pose.bone_positions[top]))
        corners = state_features(torso, view, state, shares).corners
        corners = corners + random.normal(0.0, MARK_MM, corners.shape)
        seen.append(ImageCorners(frame.image, record.levels, view.pixels(corners)[:, [1, 0, 3, 2]]))
    return tuple(seen), moved


def of_rubber(record: PhantomRecord) -> dict[str, Any]:
    """What is known of joints and rubber together, and what the mesh does."""
    moved = {}
    for spacing in SPACINGS_MM:
        _, moved[f"{spacing:g}"] = seen_in_rubber(in_rubber(record, spacing))
    usual = in_rubber(record, USUAL_SPACING_MM)
    seen, _ = seen_in_rubber(usual)
    begun = time.process_time()
    joints, rubber = analyse(usual, seen).comparisons
    took = time.process_time() - begun
    return {
        "joints_n_mm_rad": float(bench_values(usual).mean()),
        "joints": told(joints),
        "rubber": told(rubber),
        "fit_cpu_s": took,
        "moved_mm_at_spacing": moved,
    }


def measured(sets: int) -> dict[str, Any]:
    """All of it."""
    record = documented()
    found = {"of_sets": of_sets(record, sets), **of_parts(record), "in_rubber": of_rubber(record)}
    return dict(rounded(found))


if __name__ == "__main__":
    measure_once(__doc__, RESULTS, measured, sets=40)
