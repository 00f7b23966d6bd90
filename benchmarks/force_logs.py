"""How well the offset of a gauge's log is found from how a picture moves.

A log has nothing, a rise to 58 N in 3 s, a hold and a fall, with 0.2 N of noise. A trunk that stiffens (by 30 % of what
it moves) moves by 12 pixels with the force, is seen four times a second in 28 to 35 frames that begin 2 to 4.5 s after
the log, and its motion has noise of 0.15 or 0.5 pixels. Counted of ``--draws`` such sequences each, seeded: whether the
offset is called determined by ``subject.intake.log_match``, whether the 95 % interval holds the true one, and how far
off it is. A third set, with 0.15 pixels of noise, moves by a tenth of its way only within a second of the force.
``docs/from-hospital.md`` quotes it.

    python benchmarks/force_logs.py [--draws 200] [--seed 0] [--write]
    python benchmarks/force_logs.py --json
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from kept_rows import measure_once

from spinestiff.arrays import Floats
from spinestiff.subject.intake.force_log import ForceLog
from spinestiff.subject.intake.log_match import match_log

RESULTS = Path(__file__).parent / "results" / "force_logs.json"
PEAK_N, GAUGE_N = 58.0, 0.2
LOG_S, LOG_STEP_S = 18.0, 0.02
CORNERS_S, SHARES = (0.0, 5.0, 8.0, 12.0, 14.0), (0.0, 0.0, 1.0, 1.0, 0.0)
BEGINS_S, FRAMES, FRAME_S = (2.0, 4.5), (28, 35), 0.25
MOTION_PX, STIFFENING = 12.0, 0.3


@dataclass(frozen=True)
class Case:
    """What a set of sequences has: noise of the motion, pixels, and which share of the motion comes within a second."""

    noise_px: float
    creep: float = 0.0


CASES = {
    "noise of 0.15 pixels": Case(0.15),
    "noise of 0.5 pixels": Case(0.5),
    "noise of 0.15 pixels, a tenth of creep": Case(0.15, 0.1),
}


def log_of(rng: np.random.Generator) -> ForceLog:
    """A gauge's log of a push."""
    times = np.arange(0.0, LOG_S, LOG_STEP_S)
    forces = PEAK_N * np.interp(times, CORNERS_S, SHARES) + GAUGE_N * rng.standard_normal(len(times))
    return ForceLog(times, np.abs(forces))


def motion_of(log: ForceLog, times_s: Floats, case: Case, rng: np.random.Generator) -> Floats:
    """How far the picture has moved since the first frame, pixels."""
    share = log.forces_n / PEAK_N
    at_once, late = share * (1.0 + STIFFENING * (1.0 - share)), np.zeros_like(share)
    for i in range(1, len(late)):  # follows the rest with a time constant of a second
        late[i] = late[i - 1] + log.step_s * (at_once[i] - late[i - 1])
    course = MOTION_PX * ((1.0 - case.creep) * at_once + case.creep * late)
    motion = np.interp(times_s, log.times_s, course) + case.noise_px * rng.standard_normal(len(times_s))
    return np.asarray(motion - motion[0])


def of_case(case: Case, draws: int, seed: int) -> dict[str, Any]:
    """Shares of the sequences, and the offset's error in seconds: of the determined ones mean, rms and largest, and of
    these the share in which frames stay open."""
    rng = np.random.default_rng(seed)
    held, determined, errors, partly = [], [], [], []
    for _ in range(draws):
        log = log_of(rng)
        begins = rng.uniform(*BEGINS_S)
        times = FRAME_S * np.arange(rng.integers(FRAMES[0], FRAMES[1] + 1))
        found = match_log(log, times, motion_of(log, times + begins, case, rng))
        held.append(found.low_s <= begins <= found.high_s)
        determined.append(found.determined)
        errors.append(found.offset_s - begins)
        partly.append(bool(found.uncertain))
    off = np.array(errors)[np.array(determined)]
    return {
        "interval_holds_truth": round(float(np.mean(held)), 4),
        "determined": round(float(np.mean(determined)), 4),
        "with open frames": round(float(np.mean(partly)), 4),
        "error_s": {
            "mean": round(float(off.mean()), 3),
            "rms": round(float(np.sqrt(np.mean(off**2))), 3),
            "largest": round(float(np.abs(off).max()), 3),
        }
        if len(off)
        else None,
    }


def measured(draws: int, seed: int) -> dict[str, Any]:
    """All sets."""
    return {name: of_case(case, draws, seed) for name, case in CASES.items()}


if __name__ == "__main__":
    measure_once(__doc__, RESULTS, measured, draws=200, seed=0)
