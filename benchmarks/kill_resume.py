"""Is anything lost, made twice or left half written when a cohort's run is killed again and again?

``python benchmarks/kill_resume.py [--subjects 1000 --kills 100 --parent-kills 10 --faults 200 --parent-faults 20
--jobs 2] [--seed 0] [--json] [--write]``: a cohort of small subjects, whose results a reduced model makes (a few files
that the inputs decide, in some tens of milliseconds), is run twice:

    undisturbed  once from the start to the end
    disturbed    processes of participants are killed (SIGKILL) at random times, so is the process that started them
                 (then the same command is given again), and every so many calls of the file system that write, name or
                 flush something fail with one of EIO, ENOSPC and EDQUOT, in the participants' processes and in the
                 one that started them. At last the command is given undisturbed.

and then the figures say

    lost         participants without results at the end, or whose results an undisturbed run has not
    duplicated   participants with two rows, or that the ledger knows as done twice
    half_written files of published results that are not as their marker says, seen by a reader that looks at all of
                 them after each kill of the parent and at the end; and temporary files left
    identical    whether the tables and each participant's results have the bytes of the undisturbed run's
"""

from __future__ import annotations

import argparse
import datetime
import errno
import hashlib
import json
import os
import platform
import random
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from spinestiff import __version__
from spinestiff.cohort.asked import Cohort
from spinestiff.cohort.marker import Order, whole_results
from spinestiff.cohort.participants import read_participants
from spinestiff.cohort.places import DONE_FILE, LEDGER_FILE, place_of
from spinestiff.cohort.row import Row, Stiffness, write_row
from spinestiff.cohort.supervisor import run_participants
from spinestiff.errors import SpinestiffError
from spinestiff.files import write_json, write_text

RESULTS = Path(__file__).parent / "results"
RUNNER = "kill_resume:reduced"
FAULTS, PARENT_FAULTS = "KILL_RESUME_FAULTS", "KILL_RESUME_PARENT_FAULTS"
"""Of the environment, for participants' processes and for the one that starts them: file that injected faults are noted
in, and one call in how many fails, e.g. "faults.log:150"."""
ERRORS = (errno.EIO, errno.ENOSPC, errno.EDQUOT)


def reduced(folder: Path, participant: str, settings: dict[str, Any], say: Any) -> None:
    """Stands in for all steps: several files one after the other, each decided by the inputs."""
    number = json.loads((folder / "subject.json").read_text(encoding="utf-8"))["number"]
    draw = random.Random(number)
    for step in ("track", "personalise", "estimate"):
        say(step)
        time.sleep(settings["seconds"] / 3.0)
        draws = [draw.random() for _ in range(200)]
        write_json(folder / "results" / f"{step}.json", {"number": number, "draws": draws})
    write_text(folder / "results" / "figures" / "one.svg", f"<svg>{number}</svg>\n" * 50)
    write_text(folder / "results" / "report.html", f"<p>{participant}</p>\n")
    value, sd = 0.1 * draw.lognormvariate(0.0, 0.4), draw.uniform(0.05, 0.3)
    found = Stiffness(value=value, unit="", low=value / (1 + 2 * sd), high=value * (1 + 2 * sd), sd_log=sd)
    row = Row(
        participant=participant, id=participant, age=draw.uniform(10.0, 16.0), sex=draw.choice(("female", "male")),
        height_cm=draw.uniform(140.0, 180.0), cobb_deg=draw.uniform(-50.0, 50.0), curve="main thoracic",
        status="CONVERGED", determined="determined", stiffness={"lateral_bending": found}, training_rmse_mm=0.5,
        largest_force_n=60.0, report="report.html",
    )  # fmt: skip
    write_row(folder / "results" / "row.json", row)


def fail_now_and_then(asked: str) -> None:
    """Calls of the file system that fail in this process, as ``FAULTS`` of the environment asks."""
    log, _, often = asked.rpartition(":")
    draw = random.Random(os.urandom(8))
    note = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT)

    def failing(name: str) -> None:
        call = getattr(os, name)

        def maybe(*given: Any, **named: Any) -> Any:
            if draw.random() * int(often) < 1.0:
                number = draw.choice(ERRORS)
                os.write(note, f"{name} {errno.errorcode[number]}\n".encode())
                raise OSError(number, os.strerror(number), str(given[0]))
            return call(*given, **named)

        setattr(os, name, maybe)

    for name in ("fsync", "replace", "rename", "mkdir"):
        failing(name)


if FAULTS in os.environ and __name__ != "__main__":
    fail_now_and_then(os.environ[FAULTS])


def make(folder: Path, count: int) -> None:
    """A cohort of so many small subjects."""
    names = [f"sub-{number:04d}" for number in range(1, count + 1)]
    for number, name in enumerate(names):
        (folder / name / "rest").mkdir(parents=True)
        (folder / name / "subject.json").write_text(json.dumps({"number": number}), encoding="utf-8")
        (folder / name / "rest" / "frontal.dcm").write_bytes(random.Random(number).randbytes(20_000))
    (folder / "participants.tsv").write_text("participant_id\n" + "\n".join(names) + "\n", encoding="utf-8")


def order_of(seconds: float) -> Order:
    return Order(runner=RUNNER, settings={"seconds": seconds}, version=__version__)


def as_parent(source: Path, target: Path, jobs: int, seconds: float) -> None:
    """What ``spinestiff cohort`` does, with the reduced model."""
    from spinestiff.cohort.overview import write_overview

    if PARENT_FAULTS in os.environ:
        fail_now_and_then(os.environ[PARENT_FAULTS])
    try:
        participants = read_participants(source)
        summary = run_participants(Cohort(source, target, participants, order_of(seconds)), jobs)
        write_overview(source, target, participants, order=order_of(seconds))
    except SpinestiffError as error:
        sys.exit(f"stopped: {error}")
    sys.exit(3 if summary.failed else 0)


def started(source: Path, target: Path, asked: argparse.Namespace, faults: dict[str, str]) -> subprocess.Popen[bytes]:
    """The parent as a process of its own."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path[1:]])}
    environment = {name: value for name, value in environment.items() if name not in (FAULTS, PARENT_FAULTS)} | faults
    command = [sys.executable, __file__, "--as-parent", str(source), str(target)]
    command += ["--jobs", str(asked.jobs), "--seconds", str(asked.seconds)]
    return subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def children(pid: int) -> list[int]:
    """Processes that a process has started."""
    try:
        return [int(one) for one in Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()]
    except OSError:
        return []


def half_written(target: Path, participants: tuple[str, ...]) -> list[str]:
    """Published results that are not as their marker says."""
    places = [place_of(target, target, name) for name in participants]
    return [place.participant for place in places if whole_results(place).state == "damaged"]


def contents(folder: Path, participants: tuple[str, ...]) -> dict[str, str]:
    """A hash of each result and table, by its path."""
    paths = [folder / name for name in ("cohort.csv", "cohort.json", "cohort.html")]
    paths += [path for name in participants for path in (folder / name / "results").rglob("*")]
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in paths
        if path.is_file()
    }


def disturb(source: Path, target: Path, logs: Path, asked: argparse.Namespace, undisturbed: float) -> dict[str, Any]:
    """Run the cohort under kills and faults until all that was asked for has happened, then to its end."""
    draw = random.Random(asked.seed)
    participants = read_participants(source)
    kills, parents, starts, torn = 0, 0, 0, set()
    said: Counter[str] = Counter()
    harmed: Counter[str] = Counter()
    unmended: set[str] = set()
    log, parents_log = logs / "faults.log", logs / "parent_faults.log"
    faults = {FAULTS: f"{log}:{asked.every}", PARENT_FAULTS: f"{parents_log}:{asked.parent_every}"}

    def noted(log: Path) -> int:
        return len(log.read_text(encoding="ascii").splitlines()) if log.exists() else 0

    # So that all of it happens while about four fifths of the participants are run for the first time.
    pace = 0.8 * undisturbed / (asked.kills + asked.parent_kills + 1)
    while True:
        enough = kills >= asked.kills and parents >= asked.parent_kills
        enough = enough and noted(log) >= asked.faults and noted(parents_log) >= asked.parent_faults
        process = started(source, target, asked, {} if enough else faults)
        starts += 1
        while process.poll() is None:
            time.sleep(draw.uniform(0.0, 2.0) * pace)
            if enough or process.poll() is not None:
                continue
            if parents < asked.parent_kills and kills >= (parents + 1) * asked.kills / (asked.parent_kills + 1):
                process.kill()
                parents += 1
                process.wait()
                broken = set(half_written(target, participants))
                unmended &= broken
                torn |= broken - unmended
            elif kills < asked.kills and (found := children(process.pid)):
                os.kill(draw.choice(found), signal.SIGKILL)
                kills += 1
        error = process.stderr.read().decode() if process.stderr is not None else ""
        if process.returncode > 0:
            lines = error.splitlines()
            stopped = len(lines) == 1 and lines[0].startswith("stopped: ")
            failed = "participants failed" if process.returncode == 3 else lines[-1]
            said["stopped, in one line" if stopped else failed] += 1
        if enough:
            break
        if process.returncode == 0:
            # All done before enough has happened: some are damaged, and have to be made again.
            for name in draw.sample(participants, max(1, len(participants) // 4)):
                harmed[name] += 1
                unmended.add(name)
                path = target / name / "results" / draw.choice(("estimate.json", "row.json", DONE_FILE))
                path.write_bytes(path.read_bytes()[:-10])
    return {
        "kills": kills, "parent_kills": parents, "io_faults": noted(log), "parent_io_faults": noted(parents_log),
        "starts": starts, "said": dict(said),
        "torn": sorted(torn), "harmed": harmed, "last_status": process.returncode,
    }  # fmt: skip


def done_twice(target: Path, harmed: Counter[str]) -> int:
    """Participants that the ledger knows as done more often than once, and once for each time they were damaged."""
    connection = sqlite3.connect(target / LEDGER_FILE)
    rows = connection.execute("SELECT participant, count(*) FROM tries WHERE ended = 'done' GROUP BY participant")
    found = sum(count > 1 + harmed[name] for name, count in rows)
    connection.close()
    return found


def litter(target: Path) -> list[str]:
    """Temporary files and working folders left, by their names in the output."""
    left = [path for path in target.rglob("*.tmp") if not any(part.startswith("aside-") for part in path.parts)]
    left += [*target.glob("*/work*"), *target.glob("*/results-before")]
    return sorted(path.relative_to(target).as_posix() for path in left)


def main() -> None:
    """Run both and print what came out."""
    parser = argparse.ArgumentParser(description="a cohort's run that is killed again and again")
    parser.add_argument("--subjects", type=int, default=1000)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--parent-kills", type=int, default=10)
    parser.add_argument("--faults", type=int, default=200)
    parser.add_argument("--parent-faults", type=int, default=20)
    parser.add_argument("--every", type=int, default=100, help="one call of the file system in so many fails")
    parser.add_argument("--parent-every", type=int, default=150, help="the same of the process that starts the others")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=0.03, help="that the reduced model sleeps")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="print one line of JSON instead of an indented one")
    parser.add_argument("--write", action="store_true", help="store the figures in results/kill_resume.json")
    parser.add_argument("--as-parent", nargs=2, type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.as_parent is not None:
        as_parent(*asked.as_parent, asked.jobs, asked.seconds)
    with tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary)
        source = place / "in"
        make(source, asked.subjects)
        participants = read_participants(source)
        began = time.perf_counter()
        whole = started(source, place / "whole", asked, {})
        status = whole.wait()
        undisturbed = time.perf_counter() - began
        if status:
            raise SystemExit(whole.stderr.read().decode() if whole.stderr is not None else "")
        began = time.perf_counter()
        happened = disturb(source, place / "torn", place, asked, undisturbed)
        disturbed = time.perf_counter() - began
        wanted, found = contents(place / "whole", participants), contents(place / "torn", participants)
        table = (place / "torn" / "cohort.csv").read_text(encoding="utf-8").splitlines()[1:]
        rows = Counter(line.split(",")[0] for line in table)
        lost = {name.split("/")[0] for name in wanted.keys() - found.keys()}
        torn, left = {*happened["torn"], *half_written(place / "torn", participants)}, litter(place / "torn")
        figures = {
            "date": datetime.date.today().isoformat(),
            "subjects": asked.subjects,
            "kills": happened["kills"],
            "parent_kills": happened["parent_kills"],
            "io_faults": happened["io_faults"],
            "parent_io_faults": happened["parent_io_faults"],
            "lost": len(lost | {line.split(",")[0] for line in table if line.split(",")[1] != "done"}),
            "duplicated": sum(count > 1 for count in rows.values()) + done_twice(place / "torn", happened["harmed"]),
            "half_written": len(torn) + len(left),
            "identical": wanted == found,
            "torn": sorted(torn),
            "left": left,
            "damaged_on_purpose": happened["harmed"].total(),
            "starts": happened["starts"],
            "said": happened["said"],
            "last_status": happened["last_status"],
            "undisturbed_seconds": round(undisturbed, 1),
            "disturbed_seconds": round(disturbed, 1),
            "jobs": asked.jobs,
            "seed": asked.seed,
            "machine": f"{platform.machine()}, {os.cpu_count()} processors",
        }
    text = json.dumps(figures, indent=None if asked.json else 1)
    print(text)
    if asked.write:
        (RESULTS / "kill_resume.json").write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
