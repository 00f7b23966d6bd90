"""How far tracked vertebra corners are from the truth, beside plain optical flow (docs/tracking.md).

    python benchmarks/tracking.py [--images FOLDER] [--only WORD ...] [--cache FOLDER] [--calibrate] [--json] [--write]

Sequences moved by the mechanical model (benchmarks/tracking_sequences.py) and, with ``--images``, known warps of the
radiographs in a folder with landmarks.csv, images.csv and images/. Errors are in mm at the patient plane, of
every corner that is in the open field, in all frames after the first ("all") and in the last ("last"). ``--cache``
keeps rendered sequences. ``--calibrate`` fits the weights of the predicted error on sequences of odd number and says
how well they do on the others and on each group, flagging above several limits. ``--write`` stores
benchmarks/results/tracking.json.
"""

from __future__ import annotations

import argparse
import datetime
import json
import pickle
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.optimize import minimize
from tracking_sequences import CASES, Moving, modelled, warped

from spinestiff.arrays import Floats
from spinestiff.imaging.features import VertebraCorners
from spinestiff.imaging.tracking import track
from spinestiff.imaging.tracking.flow import dense_flow
from spinestiff.imaging.tracking.following import follow
from spinestiff.imaging.tracking.patches import Body
from spinestiff.imaging.tracking.pictures import Pictures, as_bytes, matched, sampled
from spinestiff.imaging.tracking.quality import DOUBTED_QUALITY, WEIGHTS
from spinestiff.words import counted

Found = dict[str, Any]
RESULTS = Path(__file__).parent / "results" / "tracking.json"
LARGE_MM = 0.5
LK = {"winSize": (21, 21), "maxLevel": 4, "criteria": (3, 30, 0.01)}


def ours(moving: Moving, further: Mapping[int, VertebraCorners] | None = None) -> tuple[Floats, Floats]:
    """Corners (F, Nv, 4, 2) in pixels and quality (F, Nv, 4)."""
    tracked = track(moving.frames, {0: moving.first, **(further or {})})
    view = moving.frames[0].view
    return np.stack([view.pixels(c.corners) for c in tracked]), np.stack([c.quality for c in tracked])


def plain(moving: Moving, step: Callable[[Any, Any, Floats], Floats], match: bool) -> Floats:
    """Corners (F, Nv, 4, 2) carried from frame to frame by flow alone."""
    first = before = as_bytes(moving.frames[0].pixels)
    places = [moving.truth[0]]
    for frame in moving.frames[1:]:
        after = as_bytes(frame.pixels)
        after = matched(after, first) if match else after
        places.append(step(before, after, places[-1].reshape(-1, 2)).reshape(places[-1].shape))
        before = after
    return np.stack(places)


def rigid(moving: Moving) -> Floats:
    """The truth of each vertebra as well as a rigid motion of its first frame has it: what no such tracker can beat."""
    start = moving.truth[0] - moving.truth[0].mean(axis=1, keepdims=True)
    centre = moving.truth.mean(axis=2, keepdims=True)
    a, b = start[..., 0] + 1j * start[..., 1], (moving.truth - centre) @ np.array([1.0, 1.0j])
    turn = np.sum(a.conj() * b, axis=-1, keepdims=True)
    placed = a * turn / np.abs(turn)
    return np.asarray(np.stack([placed.real, placed.imag], axis=-1) + centre)


def both_ends(moving: Moving) -> tuple[Floats, Floats]:
    """As ``ours``, with the last frame annotated as well."""
    last = VertebraCorners(moving.vertebrae, moving.frames[0].view.from_pixels(moving.truth[-1]))
    return ours(moving, {len(moving.frames) - 1: last})


def by_dis(before: Any, after: Any, points: Floats) -> Floats:
    """Points (n, 2) carried by dense flow."""
    return points + sampled(dense_flow(before, after), points)


def by_lk(before: Any, after: Any, points: Floats) -> Floats:
    """Points (n, 2) carried by pyramidal Lucas-Kanade; what it loses stays where it was."""
    given = points.astype(np.float32)[:, None]
    moved, status, _ = cv2.calcOpticalFlowPyrLK(before, after, given, None, **LK)  # type: ignore[call-overload]
    return np.where(status.reshape(-1, 1) == 1, moved.reshape(-1, 2), points)


PLAIN = {
    "LK": (by_lk, False),
    "LK, matched": (by_lk, True),
    "DIS": (by_dis, False),
    "DIS, matched": (by_dis, True),
}


def figures(moving: Moving, places: Floats, quality: Floats | None = None) -> Found:
    """Errors of a method on a sequence."""
    error = np.linalg.norm(places - moving.truth, axis=-1) * moving.pixel_mm
    visible = moving.visible.copy()
    visible[0] = False
    turned = np.abs(np.angle(np.exp(1j * (_angle(places) - _angle(moving.truth)))))
    found: Found = {
        "median_mm": _percentile(error[visible], 50),
        "p95_mm": _percentile(error[visible], 95),
        "last_median_mm": _percentile(error[-1][visible[-1]], 50),
        "last_p95_mm": _percentile(error[-1][visible[-1]], 95),
        "angle_median_deg": _percentile(np.degrees(turned[visible.all(-1)]), 50),
    }
    if quality is not None:
        flagged = quality < DOUBTED_QUALITY
        large = visible & (error > LARGE_MM)
        hidden = ~moving.visible
        kept = visible & ~flagged
        found |= {
            "kept_p95_mm": _percentile(error[kept], 95),
            "large": int(large.sum()),
            "large_flagged": int((large & flagged).sum()),
            "good": int((visible & ~large).sum()),
            "good_flagged": int((visible & ~large & flagged).sum()),
            "hidden": int(hidden.sum()),
            "hidden_flagged": int((hidden & flagged).sum()),
        }
    return found


def _percentile(values: Floats, share: float) -> float | None:
    return round(float(np.percentile(values, share)), 3) if len(values) else None


def _angle(quads: Floats) -> Floats:
    """Direction (..., ) rad of the line midway between the endplates."""
    along = quads[..., 0, :] + quads[..., 3, :] - quads[..., 1, :] - quads[..., 2, :]
    return np.asarray(np.arctan2(along[..., 1], along[..., 0]))


def pooled(rows: Sequence[Found], errors: Sequence[Floats]) -> Found:
    """All corners of several sequences together: errors (mm) of ours, and how well they were flagged."""
    everything = np.concatenate(errors)
    counts = {
        key: sum(row["methods"]["ours"][key] for row in rows)
        for key in ("large", "large_flagged", "good", "good_flagged", "hidden", "hidden_flagged")
    }
    angles = [row["methods"]["ours"]["angle_median_deg"] for row in rows]
    return {
        "sequences": len(rows),
        "corners": len(everything),
        "median_mm": _percentile(everything, 50),
        "p95_mm": _percentile(everything, 95),
        "worst_angle_median_deg": max(angles),
        **counts,
    }


def sequences(arguments: argparse.Namespace) -> Iterator[tuple[str, int, Moving]]:
    """Kind, number and sequence, one at a time."""
    wanted = [case for case in CASES if not arguments.only or any(word in case.name for word in arguments.only)]
    for case in wanted:
        yield "modelled", case.seed, _cached(arguments.cache, f"case{case.seed}", lambda case=case: modelled(case))
    if arguments.images is not None:
        for number, moving in enumerate(warped(arguments.images)):
            yield "warped", number, moving


def _cached(folder: Path | None, name: str, make: Callable[[], Moving]) -> Moving:
    if folder is None:
        return make()
    path = folder / f"{name}.pickle"
    if path.is_file():
        kept: Moving = pickle.loads(path.read_bytes())
        return kept
    folder.mkdir(parents=True, exist_ok=True)
    moving = make()
    path.write_bytes(pickle.dumps(moving))
    return moving


def measure(arguments: argparse.Namespace) -> Found:
    """All figures."""
    rows: list[Found] = []
    errors: list[Floats] = []
    for kind, number, moving in sequences(arguments):
        began = time.process_time()
        places, quality = ours(moving)
        seconds = (time.process_time() - began) / (len(moving.frames) - 1)
        row: Found = {
            "sequence": moving.name,
            "kind": kind,
            "calibrates": number % 2 == 1,
            "frames": len(moving.frames),
            "vertebrae": len(moving.vertebrae),
            "cobb_change_deg": round(moving.cobb_change_deg, 1),
            "motion_mm": round(
                float(np.linalg.norm(moving.truth - moving.truth[0], axis=-1).max()) * moving.pixel_mm, 1
            ),
            "seconds_a_frame": round(seconds, 2),
            "methods": {"ours": figures(moving, places, quality), "rigid": figures(moving, rigid(moving))},
        }
        if "turned" in moving.name or "steps" in moving.name:
            row["methods"]["both ends annotated"] = figures(moving, *both_ends(moving))
        for name, (step, match) in PLAIN.items():
            row["methods"][name] = figures(moving, plain(moving, step, match))
        rows.append(row)
        errors.append(np.linalg.norm(places - moving.truth, axis=-1)[1:][moving.visible[1:]] * moving.pixel_mm)
        if not arguments.json:
            print(_line(row), flush=True)
    groups = {
        "modelled, not turned": [k for k, row in enumerate(rows) if row["kind"] == "modelled" and not _turned(row)],
        "turned by 4 degrees": [k for k, row in enumerate(rows) if _turned(row)],
        "warped": [k for k, row in enumerate(rows) if row["kind"] == "warped"],
    }
    return {
        "date": datetime.date.today().isoformat(),
        "pooled": {n: pooled([rows[k] for k in ks], [errors[k] for k in ks]) for n, ks in groups.items() if ks},
        "sequences": rows,
    }


def _turned(row: Found) -> bool:
    return "turned" in row["sequence"]


def _line(row: Found) -> str:
    own = row["methods"]["ours"]
    others = ", ".join(f"{name} {row['methods'][name]['median_mm']}/{row['methods'][name]['p95_mm']}" for name in PLAIN)
    return (
        f"{row['sequence']:32s} {row['cobb_change_deg']:5.1f} deg {row['motion_mm']:5.1f} mm | all {own['median_mm']} "
        f"p95 {own['p95_mm']}, last {own['last_median_mm']} p95 {own['last_p95_mm']}, angle {own['angle_median_deg']} "
        f"| large flagged {own['large_flagged']}/{own['large']}, good {own['good_flagged']}/{own['good']}, "
        f"hidden {own['hidden_flagged']}/{own['hidden']} | {others}"
    )


def _pooled_line(name: str, group: Found) -> str:
    return (
        f"{name:32s} {counted(group['sequences'], 'sequence')}, {counted(group['corners'], 'corner')} | "
        f"all {group['median_mm']} p95 {group['p95_mm']}, angle at most {group['worst_angle_median_deg']} | "
        f"large flagged {group['large_flagged']}/"
        f"{group['large']}, good {group['good_flagged']}/{group['good']}, hidden {group['hidden_flagged']}/"
        f"{group['hidden']}"
    )


# Calibration of the predicted error


def evidence(moving: Moving) -> tuple[Floats, Floats]:
    """Terms (n, 3) and errors (n,) in mm of all visible corners that were found."""
    pictures, view = Pictures.of(moving.frames), moving.frames[0].view
    bodies = [Body.of_vertebra(quad) for quad in pictures.binned(view.from_pixels(moving.truth[0]))]
    poses, seen = follow(pictures, bodies, range(len(moving.frames)), chained=True)
    terms, errors = [], []
    for k in range(1, len(moving.frames)):
        for i, found in enumerate(seen[k]):
            if found is None:
                continue
            places = view.pixels(pictures.unbinned(bodies[i].placed(poses[k, i], bodies[i].marks)))
            error = np.linalg.norm(places - moving.truth[k, i], axis=-1) * moving.pixel_mm
            use = moving.visible[k, i]
            terms.append(found.terms()[use])
            errors.append(error[use])
    return np.concatenate(terms), np.concatenate(errors)


def calibrated(terms: Floats, errors: Floats) -> Floats:
    """Weights (3,) under which the errors are likeliest, their squares exponentially distributed."""

    def cost(logarithms: Floats) -> float:
        predicted = terms @ np.exp(logarithms)
        return float(np.mean(2.0 * np.log(predicted) + (errors / predicted) ** 2))

    best = minimize(cost, np.log(WEIGHTS), method="L-BFGS-B", bounds=[(np.log(1e-4), np.log(10.0))] * len(WEIGHTS))
    return np.asarray(np.exp(best.x))


def calibrate(arguments: argparse.Namespace) -> Found:
    """Weights from the sequences of odd number, and how their predictions do on the others and on each group."""
    seen = [(kind, number, moving.name, *evidence(moving)) for kind, number, moving in sequences(arguments)]
    weights = calibrated(*_joined(row for row in seen if row[1] % 2))
    groups = {
        "other half": [row for row in seen if not row[1] % 2],
        "calibrating half": [row for row in seen if row[1] % 2],
        "modelled, not turned": [row for row in seen if row[0] == "modelled" and "turned" not in row[2]],
        "turned by 4 degrees": [row for row in seen if "turned" in row[2]],
        "warped": [row for row in seen if row[0] == "warped"],
    }
    found: Found = {"weights": weights.round(4).tolist()}
    for name, rows in groups.items():
        if not rows:
            continue
        terms, errors = _joined(rows)
        predicted, large = terms @ weights, errors > LARGE_MM
        found[name] = {
            "rms_error_over_predicted": round(float(np.sqrt(np.mean((errors / predicted) ** 2))), 2),
            "large": int(large.sum()),
            "good": int((~large).sum()),
            "flagged_above_mm": {
                f"{limit:.2f}": [int((large & (predicted > limit)).sum()), int((~large & (predicted > limit)).sum())]
                for limit in (0.20, 0.22, 0.24, 0.26, 0.30)
            },
        }
    return found


def _joined(rows: Iterable[tuple[Any, ...]]) -> tuple[Floats, Floats]:
    """Terms (n, 3) and errors (n,) of rows that end with them."""
    terms, errors = zip(*(row[-2:] for row in rows))
    return np.concatenate(terms), np.concatenate(errors)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, help="folder of landmarks.csv, images.csv and images/ to warp")
    parser.add_argument(
        "--only", nargs="*", default=[], metavar="WORD", help="modelled sequences whose name has a word"
    )
    parser.add_argument("--cache", type=Path, help="folder for rendered sequences")
    parser.add_argument("--calibrate", action="store_true")
    parser.add_argument("--json", action="store_true", help="print all figures as JSON instead of a line each")
    parser.add_argument("--write", action="store_true")
    arguments = parser.parse_args()
    # Told before the modelled sequences take their minutes.
    if arguments.images is not None and not (arguments.images / "landmarks.csv").is_file():
        parser.error(f"{arguments.images}: no landmarks.csv in this folder")
    found = calibrate(arguments) if arguments.calibrate else measure(arguments)
    if arguments.json or arguments.calibrate:
        print(json.dumps(found, indent=1))
    else:
        for name, group in found["pooled"].items():
            print(_pooled_line(name, group))
    if arguments.write and not arguments.calibrate:
        RESULTS.write_text(json.dumps(found, indent=1, sort_keys=True) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
