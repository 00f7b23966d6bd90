"""Do the same inputs give the same results, again and again and on any number of threads?

``python benchmarks/same_results.py [--repeats 20] [--threads 1 2 4] [--mesh fine] [--json] [--write]``: a small
synthetic subject goes from its radiographs to the report, ``spinestiff run`` in a fresh copy of its folder each time.

    repeats  runs at one thread. Every file of results is held against the first run's, byte by byte, but for the times
             that it took (``run.json``, the logs, keys named ``seconds``).
    threads  a run on each number of threads: by how much its ratios and the ends of their intervals differ from those
             at one thread, relative; asked is 1e-6. Files that are not the same are named.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from interrupted_runs import RESULTS, ended, results, small_subject, spinestiff, unlike

from spinestiff import __version__


def ran(subject: Path, place: Path, mesh: str, threads: int) -> Path:
    """A copy of the subject after a run on so many threads."""
    folder = Path(shutil.copytree(subject, place))
    os.environ["SPINESTIFF_THREADS"] = str(threads)
    end = ended(spinestiff("run", folder, "--mesh", mesh))
    if end["status"]:
        raise SystemExit(f"the run on {threads} threads ended with {end['status']}: {end['said']}")
    return folder


def numbers(folder: Path) -> np.ndarray:
    """(n,) ratios and the ends of their intervals."""
    estimate = json.loads((folder / "results" / "estimate.json").read_text(encoding="utf-8"))
    return np.array([ratio[key] for ratio in estimate["ratios"].values() for key in ("value", "low", "high")])


def main() -> None:
    """Run all of it and print what came out."""
    parser = argparse.ArgumentParser(description="the same inputs again and again")
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--mesh", choices=("fine", "coarse"), default="fine")
    parser.add_argument("--json", action="store_true", help="print one line of JSON instead of an indented one")
    parser.add_argument("--write", action="store_true", help="store the figures in results/same_results.json")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary)
        subject = place / "subject"
        small_subject(subject)
        first = ran(subject, place / "first", asked.mesh, 1)
        found: dict[str, Any] = {
            "date": datetime.date.today().isoformat(), "version": __version__, "mesh": asked.mesh,
            "files": len(results(first)), "repeats": 0, "unlike the first": {}, "threads": {},
        }  # fmt: skip
        for k in range(asked.repeats):
            again = ran(subject, place / f"again{k}", asked.mesh, 1)
            if differing := unlike(first, again):
                found["unlike the first"][str(k)] = differing
            found["repeats"] += 1
            shutil.rmtree(again)
        for count in asked.threads:
            other = ran(subject, place / f"threads{count}", asked.mesh, count)
            found["threads"][str(count)] = {
                "relative difference": float(np.abs(numbers(other) / numbers(first) - 1.0).max()),
                "unlike the first": unlike(first, other),
            }
    text = json.dumps(found, indent=None if asked.json else 1)
    print(text)
    if asked.write:
        (RESULTS / "same_results.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
