"""What a sequence of gigabytes costs: time and memory of the commands that read it.

    python benchmarks/large_sequence.py SUBJECT [--frames 100] [--side 3000] [--write]
    python benchmarks/large_sequence.py --json

``SUBJECT`` is a subject folder as ``spinestiff demo`` leaves it. Its rest radiographs and its first push, enlarged to
``side`` pixels square and each frame repeated until there are as many as asked for, become a new subject by
``spinestiff init``; values and corners are the first one's, and ``track`` and ``run`` on the coarse mesh follow. CPU
seconds and the largest memory of each command on one thread; and how far the corners of the last frame lie from where
the small sequence had them, in its pixels.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pydicom
from kept_rows import measure_once

from spinestiff.files import read_json, write_json
from spinestiff.subject.image_names import FRONTAL, LATERAL, frame_image

RESULTS = Path(__file__).parent / "results" / "large_sequence.json"
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "NUMBA", "RAYON")} | {
    "SPINESTIFF_THREADS": "1"
}


def enlarged(source: Path, place: Path, frames: int, side: int) -> float:
    """A sequence written larger; returns by how much along a side."""
    dataset = pydicom.dcmread(source)
    stored = dataset.pixel_array
    scale = side / stored.shape[1]
    large = [cv2.resize(frame, (side, side), interpolation=cv2.INTER_LINEAR) for frame in stored]
    dataset.Rows = dataset.Columns = side
    dataset.NumberOfFrames = frames
    dataset.ImagerPixelSpacing = [float(pitch) / scale for pitch in dataset.ImagerPixelSpacing]
    dataset.PixelData = b"".join(large[i].tobytes() for i in repeated(frames, len(large)))
    dataset.save_as(place)
    return scale


def repeated(frames: int, few: int) -> list[int]:
    """Which of ``few`` frames each of ``frames`` shows."""
    return [min(few - 1, i * few // frames) for i in range(frames)]


def resized(points: Any, scale: float) -> Any:
    """Pixels (column, row), nested as they may be, in the larger picture; whole numbers are centres."""
    return ((np.asarray(points) + 0.5) * scale - 0.5).tolist()


def measured(*words: str) -> dict[str, float]:
    """A command of the program run to its end: CPU seconds, and memory in GB."""
    program = str(Path(sys.executable).with_name("spinestiff"))
    pid = os.spawnve(os.P_NOWAIT, program, [program, *words], {**os.environ, **ONE_THREAD})
    _, status, used = os.wait4(pid, 0)
    if status:
        raise SystemExit(f"spinestiff {' '.join(words)} ended with status {os.waitstatus_to_exitcode(status)}")
    return {"cpu_s": round(used.ru_utime + used.ru_stime, 1), "gb": round(used.ru_maxrss / 1e6, 2)}


def last_corners(folder: Path, push: str) -> Any:
    """(V, 4, 2) pixels of a push's last frame as tracked."""
    return np.array(read_json(folder / "results" / "tracked.json")["pushes"][push]["frames"][-1]["corners_px"])


def of_subject(small: Path, frames: int, side: int, place: Path) -> dict[str, Any]:
    """What the commands cost of a subject whose first push is enlarged; ``place``: an empty folder."""
    export, made = place / "export", place / "subject"
    export.mkdir()
    for view in ("frontal", "lateral"):
        shutil.copy(small / "rest" / f"{view}.dcm", export)
    record, marked = read_json(small / "subject.json"), read_json(small / "annotation.json")
    push = record["pushes"][0]
    scale = enlarged(small / push["frames"], export / "push.dcm", frames, side)
    found: dict[str, Any] = {
        "frames": frames, "side": side, "gb": round((export / "push.dcm").stat().st_size / 1e9, 2),
        "init": measured("init", str(made), str(export), "--age", "13", "--sex", "female", "--height", "157"),
    }  # fmt: skip
    of = repeated(frames, len(push["forces_n"]))
    own = read_json(made / "subject.json")
    (new,) = own["pushes"]
    new |= {key: push[key] for key in ("side", "level", "d21_mm", "d31_mm")}
    new["forces_n"] = [push["forces_n"][i] for i in of]
    new["roles"] = ["training" if i in (frames // 2, frames - 1) else "unused" for i in range(frames)]
    write_json(made / "subject.json", own)
    corners = marked["images"][frame_image(push["id"])]
    large = {what: {name: resized(at, scale) for name, at in there.items()} for what, there in corners.items()}
    images = {name: marked["images"][name] for name in (FRONTAL, LATERAL)}
    write_json(made / "annotation.json", {**marked, "images": {**images, frame_image(new["id"]): large}})
    found["track"] = measured("track", str(made))
    found["run"] = measured("run", str(made), "--mesh", "coarse")
    apart = last_corners(made, new["id"]) - resized(last_corners(small, push["id"]), scale)
    found["corners_apart_px"] = round(float(np.median(np.linalg.norm(apart, axis=-1)) / scale), 3)
    return found


def of_large(subject: Path, frames: int, side: int) -> dict[str, Any]:
    """The same, in a place of its own."""
    with tempfile.TemporaryDirectory() as place:
        return of_subject(subject, frames, side, Path(place))


if __name__ == "__main__":
    measure_once(__doc__, RESULTS, of_large, place="SUBJECT", frames=100, side=3000)
