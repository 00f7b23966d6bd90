"""How quickly a large sequence opens on the annotation page, and how many frames a second one flips through.

A synthetic push of ``--frames`` frames of ``--side`` x ``--side`` pixels, 16 bits, uncompressed, in a headless
Chromium on this machine. Opened: from the choice of the push until its first picture is drawn. Flips: each waits until
its frame is drawn; first while the other frames are still fetched, then with all of them there. What else the machine
does counts: its load goes into the result.

    python benchmarks/annotation_page.py [--side 3000] [--frames 100] [--write]
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import uvicorn

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from chromium import Tab
from phantoms import phantom, sixteen_bit
from spinestiff.annotate.server import guarded_application, listening
from spinestiff.annotate.session import AnnotationSession
from spinestiff.files import write_json
from spinestiff.imaging.projection import frontal_view
from spinestiff.imaging.radiograph import write_radiographs

RESULTS = Path(__file__).parent / "results" / "annotation_page.json"
WINDOWS = ((1024, 600), (1440, 900))
AT_ONCE = 30
PUSH = "push/a"
OPEN = f"await annotation.open('{PUSH}', 0); await drawn()"
FLIP = f"await annotation.open('{PUSH}', k); await drawn()"
DRAWN = "const drawn = () => new Promise(done => requestAnimationFrame(() => done()));"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--side", type=int, default=3000)
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--write", action="store_true", help="store it in benchmarks/results/")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "large"
        write_folder(folder, given.side, given.frames)
        rows = [measured(folder, Path(place), window) for window in WINDOWS]
    for row in rows:
        print(row)
    found = {
        "date": datetime.date.today().isoformat(),
        "side": given.side,
        "frames": given.frames,
        "processors": os.cpu_count(),
        "niceness": os.nice(0) if hasattr(os, "nice") else 0,
        "windows": rows,
    }
    if given.write:
        write_json(RESULTS, found)


def write_folder(folder: Path, side: int, count: int) -> None:
    """A spine that straightens from frame to frame."""
    for name in ("rest", "pushes"):
        (folder / name).mkdir(parents=True)
    first, last = (
        cv2.resize(phantom(bend=bend, shape=(640, 640)).pixels, (side, side), interpolation=cv2.INTER_CUBIC)
        for bend in (16.0, 12.0)
    )
    view = frontal_view(shape=(side, side), pixel=450.0 / side)
    frames = np.empty((count, side, side), np.uint16)
    for k in range(count):
        frames[k] = sixteen_bit(first + (last - first) * (k / count))
    write_radiographs(folder / "rest/frontal.dcm", frames[0], view)
    write_radiographs(folder / "pushes/a.dcm", frames, view)
    push = {
        "id": "a", "side": "right", "level": 8, "d21_mm": 400, "d31_mm": 200, "frames": "pushes/a.dcm",
        "forces_n": [60.0 * k / (count - 1) for k in range(count)], "roles": ["unused"] + ["training"] * (count - 1),
    }  # fmt: skip
    record = {"schema_version": 1, "id": "large", "age": 13, "sex": "female", "height_cm": 157, "pushes": [push]}
    (folder / "subject.json").write_text(json.dumps(record), encoding="utf-8")


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """The page's address, as long as it is served."""
    session = AnnotationSession(folder)
    with listening(0) as sock:
        guarded, address = guarded_application(session, sock.getsockname()[1])
        server = uvicorn.Server(uvicorn.Config(guarded, log_level="error", access_log=False, lifespan="off"))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [sock]}, daemon=True)
        thread.start()
        yield address
        server.should_exit = True
        thread.join(timeout=20)


def measured(folder: Path, place: Path, window: tuple[int, int]) -> dict[str, object]:
    """Seconds and flips a second in a window, of a server and a browser that have just started."""
    with served(folder) as address, Tab(place / f"profile{window[0]}", *window) as tab:
        tab.call("Page.navigate", url=address)
        tab.wait(lambda: tab.loaded)
        tab.until("document.body.dataset.state == 'open'")
        opened = tab.run(timed(OPEN))
        count = tab.run("annotation.image.forces.length")
        at_once = tab.run(timed(f"for (let k = 1; k <= {AT_ONCE}; k++) {{ {FLIP} }}"))
        fetched = tab.run(timed("while (annotation.pictures.kept.size < annotation.image.forces.length) await drawn()"))
        flipped = tab.run(timed(f"for (let k = 0; k < {count}; k++) {{ {FLIP} }}"))
        shown = tab.run("annotation.stage.grey.shown")
    return {
        "window": window,
        "shown_px": shown,
        "opened_s": round(opened, 2),
        "flips_per_s_while_fetching": round(AT_ONCE / at_once, 1),
        "all_fetched_s": round(opened + at_once + fetched, 1),
        "flips_per_s": round(count / flipped, 1),
        "load_average": round(os.getloadavg()[0], 1),
    }


def timed(script: str) -> str:
    """A script that gives the seconds which another takes."""
    seconds = "(performance.now() - start) / 1000"
    return f"(async () => {{ {DRAWN} const start = performance.now(); {script}; return {seconds}; }})()"


if __name__ == "__main__":
    main()
