"""What is left of a run that is killed, shares its folder with another, or can't write?

``python benchmarks/interrupted_runs.py [--kills 50] [--seed 0] [--json] [--write]``: on a small synthetic subject

    killed       ``spinestiff run`` killed (SIGKILL) after random times, each time started again on what it left; after
                 the last one a run to the end. Its results are held against those of an undisturbed run: every number
                 but times, every picture and page.
    two at once  two runs with different settings, started together on one folder. One has to be refused, and the
                 results have to be those of the other alone.
    full         a file system with too little room (a small tmpfs, where mounting is allowed) and a limit on the size
                 of files (RLIMIT_FSIZE): one line that says so, and no results that a later run takes for whole
    read-only    results on a read-only mount, where mounting is allowed
    reader gone  the output's reader leaves (a pipe to ``true``), and an output that is closed
"""

from __future__ import annotations

import argparse
import datetime
import hashlib
import json
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from spinestiff.imaging.synthetic.acquisition import Acquisition
from spinestiff.study.synthetic.recipe import Recipe
from spinestiff.study.synthetic.subject import synthesise

RESULTS = Path(__file__).parent / "results"
PROGRAM = [sys.executable, "-c", "from spinestiff.app.start import main; main()"]
LIMIT_BYTES = 200_000
UNREAD = {"reader gone": '(sleep 1; "$@") | true', "closed": '"$@" >&-', "device full": '"$@" > /dev/full'}


def small_subject(folder: Path) -> None:
    """A synthetic subject whose run takes half a minute."""
    recipe = Recipe(seed=3, force_n=30.0, ratios=(0.2, 0.05), shape=(512, 512), mesh="coarse",
                    acquisition=Acquisition(samples=1))  # fmt: skip
    synthesise(folder, recipe)


def spinestiff(*arguments: str | Path, before: Callable[[], None] | None = None) -> subprocess.Popen[str]:
    """The program as a process of its own, started."""
    return subprocess.Popen(
        [*PROGRAM, *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=before
    )


def ended(process: subprocess.Popen[str]) -> dict[str, Any]:
    """How a process ended: status, the last line of what it complained of, whether there was a traceback."""
    out, err = process.communicate()
    lines = err.splitlines() or [""]
    return {"status": process.returncode, "said": lines[-1], "traceback": "Traceback" in out + err}


def untimed(value: Any) -> Any:
    """JSON without what depends on the clock."""
    if isinstance(value, dict):
        return {key: untimed(inner) for key, inner in value.items() if key != "seconds"}
    return [untimed(inner) for inner in value] if isinstance(value, list) else value


def results(folder: Path) -> dict[str, str]:
    """What each file in ``results/`` holds, but for times and logs: a hash of it by name."""
    found = {}
    logs = folder / "results" / "logs"
    for path in sorted((folder / "results").rglob("*")):
        if path.is_dir() or path.name == "run.json" or path.parent == logs:
            continue
        content = path.read_bytes()
        if path.suffix == ".json":
            content = json.dumps(untimed(json.loads(content))).encode()
        found[path.relative_to(folder).as_posix()] = hashlib.sha256(content).hexdigest()
    return found


def unlike(folder: Path, other: Path) -> list[str]:
    """Results that two folders don't have alike."""
    one, two = results(folder), results(other)
    return sorted(name for name in one.keys() | two.keys() if one.get(name) != two.get(name))


def killed(sound: Path, place: Path, kills: int, random: np.random.Generator) -> dict[str, Any]:
    """A run that is killed again and again, and its results at last."""
    folder = Path(shutil.copytree(sound, place / "killed", ignore=shutil.ignore_patterns("results")))
    finished, tracebacks = 0, 0
    for _ in range(kills):
        process = spinestiff("run", folder)
        try:
            process.wait(float(random.uniform(0.3, 9.0)))
            finished += 1
            shutil.rmtree(folder / "results", ignore_errors=True)  # it came to its end: from the start again
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
        tracebacks += ended(process)["traceback"]
    last = ended(spinestiff("run", folder))
    litter = sorted(path.name for path in (folder / "results").rglob(".*"))
    return {
        "kills": kills - finished, "runs that ended before": finished, "tracebacks": tracebacks, "last run": last,
        "unlike an undisturbed run": unlike(folder, sound), "temporary files left": len(litter),
    }  # fmt: skip


def at_once(sound: Path, place: Path) -> dict[str, Any]:
    """Two runs with different settings on one folder."""
    folder = Path(shutil.copytree(sound, place / "both", ignore=shutil.ignore_patterns("results")))
    first = spinestiff("run", folder)
    time.sleep(0.05)
    second = spinestiff("run", folder, "--orientation", "covariance")
    said = [ended(process) for process in (second, first)]
    refused = [one for one in said if "another run of spinestiff is at work here" in one["said"]]
    if said[0]["status"] == 0 and said[1]["status"] != 0:  # the second came first
        return {"ends": said, "refused": len(refused), "unlike a run alone": "not compared: the second run came first"}
    return {"ends": said, "refused": len(refused), "unlike a run alone": unlike(folder, sound)}


def without_room(sound: Path, place: Path) -> dict[str, Any]:
    """Full, limited and read-only places; None where the system does not allow to make one."""
    found: dict[str, Any] = {}
    folder = Path(shutil.copytree(sound, place / "limited", ignore=shutil.ignore_patterns("results")))

    def limited() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (LIMIT_BYTES, LIMIT_BYTES))

    found["limit on files"] = {"end": ended(spinestiff("run", folder, before=limited))}
    found["limit on files"]["then"] = ended(spinestiff("run", folder))["status"]
    found["limit on files"]["unlike an undisturbed run"] = unlike(folder, sound)
    for name, options in (("full", "size=200k"), ("read-only", "size=200k,ro")):
        folder = Path(shutil.copytree(sound, place / name, ignore=shutil.ignore_patterns("results")))
        (folder / "results").mkdir()
        mount = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder / "results")]
        if subprocess.run(mount, capture_output=True, check=False).returncode:
            found[name] = None
            continue
        try:
            found[name] = {"end": ended(spinestiff("run", folder))}
        finally:
            subprocess.run(["umount", str(folder / "results")], check=True)
    return found


def unread(sound: Path) -> dict[str, Any]:
    """Outputs whose reader has left, or that are closed."""
    found = {}
    for name, line in UNREAD.items():
        shell = subprocess.run(
            ["bash", "-c", f"set -o pipefail; {line}", "bash", *PROGRAM, "estimate", str(sound)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        lines = [line for line in shell.stderr.splitlines() if "up to date" not in line]
        found[name] = {"status": shell.returncode, "said": " | ".join(lines)}
    return found


def main() -> None:
    """Run all of it and print what came out."""
    parser = argparse.ArgumentParser(description="runs that are disturbed")
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="print one line of JSON instead of an indented one")
    parser.add_argument("--write", action="store_true", help="store the figures in results/interrupted_runs.json")
    asked = parser.parse_args()
    random = np.random.default_rng(asked.seed)
    with tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary)
        sound = place / "sound"
        small_subject(sound)
        began = time.perf_counter()
        undisturbed = ended(spinestiff("run", sound))
        found = {
            "date": datetime.date.today().isoformat(),
            "seed": asked.seed,
            "undisturbed": {**undisturbed, "seconds": round(time.perf_counter() - began, 1)},
            "unread": unread(sound),
            "without room": without_room(sound, place),
            "two at once": at_once(sound, place),
            "killed": killed(sound, place, asked.kills, random),
        }
        text = json.dumps(found, indent=None if asked.json else 1).replace(str(place), "PLACE")
    print(text)
    if asked.write:
        (RESULTS / "interrupted_runs.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
