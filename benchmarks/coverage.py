"""Do the intervals hold? Subjects of known stiffness, made and estimated by corners alone (``coverage_subjects.py``).

    python benchmarks/coverage.py --scenario NAME... [--logs FOLDER] [--first SEED] [--count N]
    python benchmarks/coverage.py --summary FILE...
    python benchmarks/coverage.py --store [NAME FILE...]
    python benchmarks/coverage.py --json | --markdown [--figures FILE]
    python benchmarks/coverage.py --pairs FILE FILE
    python benchmarks/coverage.py --rerun FOLDER

The first makes and estimates a scenario's subjects and writes a line each as it goes; a log that exists is gone on
with, and a second process with other seeds and another folder halves the time. Scenarios given together take turns, so
that a body of both is meshed once. Logs are kept in benchmarks/results/coverage, where the next machine goes on with
them. ``--summary`` prints how often the truth lies inside, by ratio and jointly, for closed and for open intervals, by
tercile of the true ratio, by curve and by kind of body, with the standard errors of so many subjects
(``counted_intervals.py``). ``--store`` keeps the figures of the kept logs, or a scenario's of others, in
benchmarks/results/coverage.json, ``--json`` prints that file, ``--markdown`` prints it as the first words of the pages,
the table of docs/limits.md and the tables of docs/coverage.md (``--figures`` another such file: earlier estimators' lie
beside their rows and are the tables of docs/coverage-earlier.md), ``--pairs`` prints by how much the estimates of the
same people differ between two logs, and ``--rerun`` repeats the seeds of the kept logs, each made as its row says. All
of it is synthetic.
Needs the extra ``[mesh]``: every truth has a tissue mesh of its own.

Settings were chosen while the scenarios called "settings" were looked at; the seeds of the others are run once and
reported. Which seeds a scenario has is told by its rows, and stored as ``seeds``.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields
from importlib.util import find_spec
from pathlib import Path
from typing import Any

if __name__ == "__main__":
    sys.modules["coverage"] = None  # type: ignore[assignment]  # numba looks for a package of this file's name
else:
    raise ImportError("a command, not the package of this name that numba looks for")

from counted_intervals import NAMES, headline, markdown, paired, read_logs, short_table, show, summarised
from coverage_rendered import radiographed_person, rendered_subject
from coverage_subjects import COARSE_NODES, START, Acquisition, make_subject, seen_by
from kept_rows import code, keep, prepare
from told_intervals import solved_at_truth, told

from spinestiff.anatomy.template import Mesh
from spinestiff.errors import SpinestiffError
from spinestiff.estimation.fitted import FitEnd, StiffnessFit
from spinestiff.estimation.profiles import WIDTH_FACTOR
from spinestiff.study.assessment import assess
from spinestiff.study.fits import fit_from_coarse
from spinestiff.study.forecasts import forecasts
from spinestiff.study.predictions import Model, predict
from spinestiff.study.trials import PushSet

RESULTS = Path(__file__).parent / "results" / "coverage.json"
LOGS = RESULTS.with_suffix("")


@dataclass(frozen=True)
class Scenario:
    """``nodes`` of the truth's mesh, ``mesh`` that the estimate ends on, seeds from ``first`` on.

    With ``rendered`` through radiographs (``coverage_rendered``), else from corners (``coverage_subjects``); ``few``:
    of people with few errors. ``truth``: the true ratios of all, in the order of ``NAMES``; drawn if None.
    """

    acquisition: Acquisition
    nodes: int
    mesh: Mesh
    first: int
    count: int
    rendered: bool = False
    truth: Sequence[float] | None = None
    few: bool = False


SCENARIOS = {
    "coarse pair, three pushes": Scenario("three pushes", COARSE_NODES, "coarse", 43000, 460),
    "coarse pair, the paper's acquisition": Scenario("paper", COARSE_NODES, "coarse", 43000, 460),
    "default chain, three pushes": Scenario("three pushes", 15000, "fine", 42000, 140),
    "rendered, three pushes": Scenario("three pushes", 15000, "fine", 61000, 45, rendered=True),
    "rendered, few errors": Scenario("three pushes", 15000, "fine", 60000, 45, rendered=True, few=True),
    "four frames at Table 4's mean": Scenario(
        "four frames", COARSE_NODES, "coarse", 74000, 30, truth=tuple(START.values())
    ),
    "pushes as planned": Scenario("both sides", COARSE_NODES, "coarse", 72000, 60),
    "settings, three pushes": Scenario("three pushes", COARSE_NODES, "coarse", 0, 230),
    "settings, the paper's acquisition": Scenario("paper", COARSE_NODES, "coarse", 500, 230),
    "settings, default chain": Scenario("three pushes", 15000, "fine", 100, 60),
}


@dataclass(frozen=True)
class Made:
    """A subject's truth, and its pushes as an estimate sees them, on the coarse torso and on the one it ends on."""

    ratios: Mapping[str, float]
    kind: str
    cobb_deg: float
    seen: Callable[[], tuple[PushSet | None, PushSet]]


@contextmanager
def made(seed: int, scenario: Scenario) -> Iterator[Made]:
    """The subject of a seed. Raises SpinestiffError where it can't be made."""
    if scenario.rendered:
        with tempfile.TemporaryDirectory() as folder:
            make = rendered_subject if scenario.few else radiographed_person
            found = make(seed, scenario.nodes, Path(folder) / "subject")
            yield Made(found.ratios, found.kind, found.cobb_deg, lambda: (found.coarse, found.pushes))
        return
    truth = None if scenario.truth is None else dict(zip(NAMES, scenario.truth, strict=True))
    subject = make_subject(seed, scenario.acquisition, scenario.nodes, ratios=truth)
    coarse = scenario.mesh == "coarse"

    def seen() -> tuple[PushSet | None, PushSet]:
        return None if coarse else seen_by(subject, "coarse"), seen_by(subject, scenario.mesh)

    yield Made(subject.ratios, subject.kind, subject.cobb_deg, seen)


def run_one(seed: int, scenario: Scenario) -> dict[str, Any]:
    """A subject made and estimated, as a line of the log."""
    row: dict[str, Any] = {"seed": seed, **scenario.__dict__, "code": code(), "width_factor": WIDTH_FACTOR}
    began = time.process_time()
    with ExitStack() as stack:
        try:
            subject = stack.enter_context(made(seed, scenario))
        except SpinestiffError as error:
            return {**row, "not made": str(error)}
        row |= {"ratios": dict(subject.ratios), "kind": subject.kind, "cobb_deg": round(subject.cobb_deg, 1)}
        row |= {"made_cpu_s": round(time.process_time() - began, 1)}
        began = time.process_time()
        try:
            coarse, pushes = subject.seen()
            fit = fit_from_coarse(coarse, pushes, NAMES, START, extent="intervals")
            row |= told(fit, subject.ratios)
            row |= solved_at_truth(pushes, fit, subject.ratios)
            row |= {"held_out": predicted(pushes, fit)}
        except SpinestiffError as error:
            row["failed"] = str(error)
    return {**row, "cpu_s": round(time.process_time() - began, 1)}


def predicted(pushes: PushSet, fit: StiffnessFit) -> list[dict[str, Any]]:
    """What an estimate and its forecasts say of the held-out frames."""
    if fit.weighed is None or not fit.status.usable:
        return []
    models = {"default": Model(), "fit": Model.of(fit)}
    predictions = predict(pushes, models, {}, lambda line: None, ("default",))
    expected = forecasts(predictions, FitEnd.of(fit))
    return [
        {"fit_mm": frame.rmse_mm["fit"], **({} if frame.forecast is None else frame.forecast.model_dump())}
        for frame in assess(predictions, expected)
    ]


Wanted = tuple[int, Scenario, Path]  # a seed, how its subject is made, its log


def wanted(names: Sequence[str], first: int | None, count: int | None, folder: Path) -> list[Wanted]:
    """The scenarios' own seeds, or ``count`` from ``first`` on."""
    found = []
    for name in names:
        scenario = SCENARIOS[name]
        begin = scenario.first if first is None else first
        seeds = range(begin, begin + (count or scenario.count))
        found += [(seed, scenario, folder / log_of(name).name) for seed in seeds]
    return found


def kept(folder: Path) -> list[Wanted]:
    """What the kept logs hold, each seed made as it was made then."""
    keys = [field.name for field in fields(Scenario)]
    return [
        (row["seed"], Scenario(**{key: row[key] for key in keys if key in row}), folder / log_of(name).name)
        for name in SCENARIOS
        if log_of(name).is_file()
        for row in read_logs([log_of(name)])
    ]


def campaign(asked: Sequence[Wanted]) -> None:
    """The subjects that their logs lack."""
    logs = {log for *_, log in asked}
    for log in logs:
        prepare(log)
    known = {(log, row["seed"]) for log in logs if log.is_file() for row in read_logs([log])}
    for seed, scenario, log in sorted(asked, key=lambda one: one[0]):
        if (log, seed) in known:
            continue
        row = run_one(seed, scenario)
        keep(log, row)
        print(log.stem, seed, row.get("not made") or row.get("failed") or row.get("z"), row.get("cpu_s"), flush=True)


def log_of(name: str) -> Path:
    """Where a scenario's rows are kept."""
    return LOGS / f"{name.replace(' ', '_').replace(',', '').replace(chr(39), '')}.jsonl"


def stored(path: Path = RESULTS) -> list[dict[str, Any]]:
    """The stored campaigns."""
    found: list[dict[str, Any]] = json.loads(path.read_text()) if path.is_file() else []
    return found


def counted(name: str, logs: Sequence[Path]) -> dict[str, Any]:
    """A scenario's figures from its logs."""
    return summarised(name, read_logs(logs), SCENARIOS[name].count)


def store(entry: dict[str, Any]) -> None:
    """Keep a campaign's figures in the place of those of the same scenario."""
    others = [one for one in stored() if one["scenario"] != entry["scenario"]]
    order = list(SCENARIOS)
    entries = sorted([*others, entry], key=lambda one: order.index(one["scenario"]))
    RESULTS.write_text(json.dumps(entries, indent=1) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", choices=list(SCENARIOS), nargs="+")
    parser.add_argument("--first", type=int, help="seed to begin with, of the scenario's own if left out")
    parser.add_argument("--count", type=int, help="seeds, those of the scenario if left out")
    parser.add_argument("--logs", type=Path, default=LOGS, metavar="FOLDER")
    parser.add_argument("--summary", type=Path, nargs="+", metavar="FILE")
    parser.add_argument("--store", nargs="*", metavar=("SCENARIO", "FILE"))
    parser.add_argument("--pairs", type=Path, nargs=2, metavar="FILE")
    parser.add_argument("--json", action="store_true", help="print what is stored")
    parser.add_argument("--markdown", action="store_true", help="print it as the pages have it")
    parser.add_argument("--figures", type=Path, default=RESULTS, metavar="FILE", help="what these two print")
    parser.add_argument(
        "--rerun", type=Path, metavar="FOLDER", help="repeat the seeds of the kept logs, logs in a folder"
    )
    asked = parser.parse_args()
    if (asked.scenario or asked.rerun) and find_spec("mmgpy") is None:
        parser.error('the truths\' meshes need pip install -e ".[mesh]"')
    if asked.figures != RESULTS and not asked.figures.is_file():
        parser.error(f"{asked.figures}: no such file")
    if asked.json:
        print(json.dumps(stored(asked.figures), indent=1))
    elif asked.markdown:
        found = stored(asked.figures)
        print(headline(found), "\n".join(short_table(found)), markdown(found), sep="\n\n")
    elif asked.summary:
        show(summarised("logs", read_logs(asked.summary)))
    elif asked.store:
        name, *paths = asked.store
        if name not in SCENARIOS or not paths:
            parser.error(f"--store wants one of {', '.join(SCENARIOS)}, and logs")
        store(counted(name, [Path(path) for path in paths]))
    elif asked.store is not None:
        entries = [counted(name, [log_of(name)]) for name in SCENARIOS if log_of(name).is_file()]
        RESULTS.write_text(json.dumps(entries, indent=1) + "\n")
        for entry in entries:
            show(entry)
    elif asked.pairs:
        try:
            print(json.dumps(paired(*(read_logs([log]) for log in asked.pairs)), indent=1))
        except (OSError, ValueError) as error:
            parser.error(str(error))
    elif asked.rerun:
        campaign(kept(asked.rerun))
        for name in SCENARIOS:
            if log_of(name).is_file():
                show(counted(name, [asked.rerun / log_of(name).name]))
    elif asked.scenario:
        campaign(wanted(asked.scenario, asked.first, asked.count, asked.logs))
    else:
        parser.error("wanted --scenario, --summary, --store, --json, --markdown, --pairs or --rerun")


if __name__ == "__main__":
    main()
