"""Do the intervals hold? Subjects of known stiffness, made and estimated by corners alone (``coverage_subjects.py``).

    python benchmarks/coverage.py --scenario NAME... [--logs FOLDER] [--first SEED] [--count N]
    python benchmarks/coverage.py --summary FILE...
    python benchmarks/coverage.py --store [NAME FILE...]
    python benchmarks/coverage.py --json | --rerun FOLDER

The first makes and estimates a scenario's subjects and writes a line each as it goes; a log that exists is gone on
with, and a second process with other seeds and another folder halves the time. Scenarios given together take turns, so
that a body of both is meshed once. Logs are kept in benchmarks/results/coverage, where the next machine goes on with
them. ``--summary`` prints how often the truth lies
inside, by ratio and jointly, for closed and for open intervals and by tercile of the true ratio, with the standard
errors of so many subjects; ``--store`` keeps the figures (of the kept logs, or a scenario's of others) in
benchmarks/results/coverage.json, ``--json`` prints that file, and ``--rerun`` repeats all its scenarios. All of it is
synthetic. Needs the extra ``[mesh]``: every truth has a tissue mesh of its own.

Settings were looked at on the scenarios of seeds below 1000 ("settings"); the others are run once and reported.
"""

from __future__ import annotations

import argparse
import datetime
import hashlib
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

if __name__ == "__main__":
    sys.modules["coverage"] = None  # type: ignore[assignment]  # numba looks for a package of this file's name
else:
    raise ImportError("a command, not the package of this name that numba looks for")

import numpy as np
from coverage_rendered import rendered_subject
from coverage_subjects import Acquisition, Subject, make_subject
from rich.console import Console
from rich.table import Table
from scipy.stats import chi2, norm

from spinestiff.anatomy.template import template_torso
from spinestiff.errors import EquilibriumError, SpinestiffError
from spinestiff.estimation.discrepancy import Mesh
from spinestiff.estimation.fitted import StiffnessFit
from spinestiff.estimation.priors import Priors
from spinestiff.estimation.profiles import CLOSE_ENOUGH, WIDTH_FACTOR, Profile
from spinestiff.personalise.shape import personalise
from spinestiff.study.assessment import assess
from spinestiff.study.forecasts import forecasts
from spinestiff.study.predictions import Model, predict
from spinestiff.study.trials import Known, PushSet, fit_from_coarse, push_set, rise_of

RESULTS = Path(__file__).parent / "results" / "coverage.json"
LOGS = RESULTS.with_suffix("")
DIGITS = 5  # of a log's numbers
ROOT = Path(__file__).parent.parent
NAMES = ("lateral_bending", "tissue")
START = {"lateral_bending": 0.07, "tissue": 0.04}
LEVELS = (0.68, 0.95, 0.999)
# Width factors for which is said how often intervals would hold each ratio, and the joint region both.
FACTORS = (1.0, 1.05, 1.1)
FAR = (-5.0, 5.0)  # z beyond counts as these where they are averaged
FLAGGED = 1e-3  # p-value below which a result is called doubtful


@dataclass(frozen=True)
class Scenario:
    """``nodes`` of the truth's mesh, ``mesh`` that the estimate ends on, seeds from ``first`` on.

    With ``rendered`` through radiographs (``coverage_rendered``), else from corners (``coverage_subjects``).
    """

    acquisition: Acquisition
    nodes: int
    mesh: Mesh
    first: int
    count: int
    rendered: bool = False


SCENARIOS = {
    "coarse pair, three pushes": Scenario("three pushes", 2300, "coarse", 23000, 460),
    "coarse pair, the paper's acquisition": Scenario("paper", 2300, "coarse", 23000, 460),
    "default chain, three pushes": Scenario("three pushes", 15000, "fine", 40000, 140),
    "rendered, three pushes": Scenario("three pushes", 15000, "fine", 60000, 45, rendered=True),
    "settings, three pushes": Scenario("three pushes", 2300, "coarse", 0, 230),
    "settings, the paper's acquisition": Scenario("paper", 2300, "coarse", 500, 230),
    "settings, default chain": Scenario("three pushes", 15000, "fine", 100, 60),
}


@lru_cache(maxsize=1)
def code() -> str:
    """Hash of what a subject and its estimate are made with."""
    patterns = (
        "benchmarks/coverage_*.py",
        "benchmarks/judgement_subjects.py",
        "benchmarks/discrepancy_pairs.py",
        "src/spinestiff/estimation/data/*",
        *(f"src/spinestiff/study/{name}.py" for name in ("elastic_supports", "trials", "forecasts", "predictions")),
    )
    rooms = ("anatomy", "mechanics", "estimation", "imaging", "personalise")
    patterns += tuple(f"src/spinestiff/{room}/**/*.py" for room in rooms)
    files = [path for pattern in patterns for path in sorted(ROOT.glob(pattern))]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:12]


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
            found = rendered_subject(seed, scenario.nodes, Path(folder) / "subject")
            yield Made(found.ratios, "", found.cobb_deg, lambda: (found.coarse, found.pushes))
        return
    subject = make_subject(seed, scenario.acquisition, scenario.nodes)
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
    values, known = fit.ratios.as_dict(), fit.standard_nuisances
    expected = forecasts(predictions, values, known, fit.weighed.tracking_factor)
    return [
        {"fit_mm": frame.rmse_mm["fit"], **({} if frame.forecast is None else frame.forecast.model_dump())}
        for frame in assess(predictions, expected)
    ]


def seen_by(subject: Subject, mesh: Mesh) -> PushSet:
    """The subject's pushes on the torso that personalisation makes of it."""
    template = template_torso(subject.height_cm, mesh, age_years=subject.age, sex=subject.sex)
    shaped = personalise(template, subject.rest)
    return push_set(shaped.torso, subject.records, subject.tracked, known=Known(Priors(), shaped.covariance))


def solved_at_truth(pushes: PushSet, fit: StiffnessFit, truth: Mapping[str, float]) -> dict[str, Any]:
    """The rise at the true ratios with the model solved there: far outside a region the emulator says too much."""
    if fit.weighed is None or not fit.status.usable:
        return {}
    try:
        states = [one.state for one in fit.equilibria]
        rise = rise_of(pushes, fit.ratios.as_dict(), fit.standard_nuisances, truth, rmse_mm=fit.rmse_mm, starts=states)
    except EquilibriumError:
        return {"joint_solved": None}
    return {"joint_solved": rise / WIDTH_FACTOR**2}


def told(fit: StiffnessFit, truth: Mapping[str, float]) -> dict[str, Any]:
    """What is asked of an estimate whose truth is known."""
    likely, weighed = fit.likely, fit.weighed
    if likely is None or weighed is None or likely.emulator is None:
        return {"status": fit.status.name, "evaluations": len(fit.history)}
    at = np.log([truth[name] for name in NAMES])
    best = np.log(fit.ratios.values)
    rises = [risen(profile, at[i]) for i, profile in enumerate(likely.profiles)]
    joint = float(likely.emulator.phi(at)[0] - likely.emulator.phi(best)[0])
    return {
        "status": fit.status.name,
        "estimate": fit.ratios.as_dict(),
        "low": np.exp(likely.low).tolist(),
        "high": np.exp(likely.high).tolist(),
        "open": (likely.open_low | likely.open_high).tolist(),
        "kinds": list(likely.kinds),
        # Signed root of twice the rise at the truth, in units of the intervals: standard normal, if all is well.
        "z": [float(np.sign(a - b) * np.sqrt(2.0 * max(r, 0.0)) / WIDTH_FACTOR) for a, b, r in zip(best, at, rises)],
        "joint": 2.0 * joint / WIDTH_FACTOR**2,
        "p_value": weighed.p_value,
        "tracking_factor": weighed.tracking_factor,
        "outlying": len(weighed.outlying),
        "rmse_mm": fit.rmse_mm,
        "evaluations": len(fit.history),
        "factorisations": fit.cost.factorisations,
    }


def risen(profile: Profile, at: float) -> float:
    """A profile's rise over its least, as a parabola between its places and beyond its ends, outside any interval."""
    where, root = profile.log_ratios, np.sqrt(profile.rise - profile.rise.min())
    if where[0] <= at <= where[-1]:
        return float(np.interp(at, where, root) ** 2)
    end, least = (0 if at < where[0] else -1), where[int(np.argmin(root))]
    return float((root[end] * (at - least) / (where[end] - least)) ** 2)


def summarised(scenario: str, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The figures of a campaign; shares come with their standard error."""
    made = [row for row in rows if "not made" not in row]
    found = [row for row in made if "z" in row]
    joint = np.array([row["joint"] for row in found])
    entry: dict[str, Any] = {
        "scenario": scenario,
        "subjects": len(found),
        "seeds": [len(rows), SCENARIOS[scenario].count if scenario in SCENARIOS else len(rows)],
        "not_made": len(rows) - len(made),
        "without_estimate": len(made) - len(found),
        "coverage95": {},
        "median_factor": {},
        "bias_sd": {},
    }
    for i, name in enumerate(NAMES):
        z = np.array([row["z"][i] for row in found])
        truth = np.array([row["ratios"][name] for row in found])
        widths = np.array([np.sqrt(row["high"][i] / row["low"][i]) for row in found])
        is_open = np.array([row["open"][i] for row in found], dtype=bool)
        third = np.searchsorted(np.quantile(truth, (1 / 3, 2 / 3)), truth)
        inside = {level: _inside(z, level) for level in LEVELS} | {0.95: np.array([row["inside"][i] for row in found])}
        entry["coverage95"][name] = _share(inside[0.95])[0]
        entry["median_factor"][name] = round(float(np.median(widths)), 3)
        entry["bias_sd"][name] = round(float(np.mean(np.clip(z, *FAR))), 3)
        parts = {"all": np.ones(len(z), dtype=bool), "closed": ~is_open, "open": is_open}
        parts |= {f"{word} third": third == k for k, word in enumerate(("lowest", "middle", "highest"))}
        entry[name] = {
            part: {
                "subjects": int(mask.sum()),
                **{f"{level:.1%}": _share(inside[level][mask]) for level in LEVELS},
                "bias_sd": round(float(np.mean(np.clip(z[mask], *FAR))), 3),
                "median_z": round(float(np.median(z[mask])), 3),
                "sd_of_z": round(float(np.std(np.clip(z[mask], *FAR))), 3),
                "median_factor": round(float(np.median(widths[mask])), 3),
            }
            for part, mask in parts.items()
            if mask.any()
        }
    entry["coverage95"]["joint"] = _share(joint < chi2.ppf(0.95, 2))[0]
    entry["joint"] = {f"{level:.1%}": _share(joint < chi2.ppf(level, 2)) for level in LEVELS}
    # Where nothing was solved at the truth the emulator's word counts; without an equilibrium there it is outside.
    solved = [row.get("joint_solved", row["joint"]) for row in found]
    entry["joint_solved"] = {
        f"{level:.1%}": _share(np.array([one is not None and one < chi2.ppf(level, 2) for one in solved]))
        for level in LEVELS
    }
    entry["coverage95_by_width_factor"] = {
        f"{factor:g}": [
            *(_share(_inside(z * WIDTH_FACTOR / factor, 0.95))[0] for z in np.array([row["z"] for row in found]).T),
            _share(
                np.array([one is not None and one * (WIDTH_FACTOR / factor) ** 2 < chi2.ppf(0.95, 2) for one in solved])
            )[0],
        ]
        for factor in FACTORS
    }
    entry["outside_999"] = int(sum(one is None or one >= chi2.ppf(0.999, 2) for one in solved))
    # Where the truth is the more likely one the search ended in another minimum, or on another equilibrium.
    entry["better_at_truth"] = int(sum(one is not None and one < -2.0 * CLOSE_ENOUGH for one in solved))
    entry["flagged"] = int(sum(row["p_value"] < FLAGGED for row in found))
    frames = [frame for row in found for frame in row.get("held_out", []) if "inside95" in frame]
    turns = [(f["cobb_error_deg"], f["cobb_sd_deg"]) for f in frames if f["cobb_sd_deg"] is not None]
    if frames:
        entry["held_out"] = {
            "frames": len(frames),
            "corners95": round(float(np.mean([frame["inside95"] for frame in frames])), 4),
            "cobb95": _share(np.array([abs(error) < norm.ppf(0.975) * sd for error, sd in turns])),
            "median_rmse_mm": {
                "forecast": round(float(np.median([frame["rmse_mm"] for frame in frames])), 3),
                "fit": round(float(np.median([frame["fit_mm"] for frame in frames])), 3),
            },
        }
    for key in ("evaluations", "factorisations", "cpu_s", "p_value", "tracking_factor", "rmse_mm"):
        entry[key] = [float(f"{v:.4g}") for v in np.quantile([row[key] for row in found], (0.0, 0.05, 0.5, 0.95, 1.0))]
    entry["evaluations_max"] = int(max(row["evaluations"] for row in found))
    entry["code"] = sorted({row.get("code", "") for row in rows})
    entry["date"] = datetime.date.today().isoformat()
    return entry


def _inside(z: np.ndarray, level: float) -> np.ndarray:
    return np.asarray(np.abs(z) < norm.ppf(0.5 + 0.5 * level))


def _share(inside: np.ndarray) -> list[float]:
    """A share and its binomial standard error."""
    if not len(inside):
        return [float("nan"), float("nan")]
    share = float(np.mean(inside))
    return [round(share, 4), round(float(np.sqrt(share * (1.0 - share) / len(inside))), 4)]


def show(entry: dict[str, Any]) -> None:
    """A campaign's figures as tables."""
    console = Console(width=150)
    title = f"{entry['scenario']}: {entry['subjects']} subjects, all of them synthetic"
    table = Table(title=title)
    for column in (
        "ratio",
        "of",
        "subjects",
        *(f"{level:.1%}" for level in LEVELS),
        "mean z",
        "median",
        "sd",
        "factor",
    ):
        table.add_column(column)
    for name in NAMES:
        for part, found in entry[name].items():
            shares = [_percent(found[f"{level:.1%}"]) for level in LEVELS]
            numbers = (f"{found[key]:.2f}" for key in ("bias_sd", "median_z", "sd_of_z", "median_factor"))
            table.add_row(name, part, str(found["subjects"]), *shares, *numbers)
    for key, words in (("joint", "joint region"), ("joint_solved", "joint region, solved at the truth")):
        shares = [_percent(entry[key][f"{level:.1%}"]) for level in LEVELS]
        table.add_row("both", words, str(entry["subjects"]), *shares, "", "", "", "")
    console.print(table)
    console.print(
        f"{entry['seeds'][0]} of {entry['seeds'][1]} seeds; "
        f"{entry['not_made']} not made, {entry['without_estimate']} without an estimate, {entry['outside_999']} "
        f"outside their 99.9 % region, {entry['better_at_truth']} less likely than the truth, "
        f"{entry['flagged']} flagged (p < {FLAGGED:g})"
    )
    if "held_out" in entry:
        console.print("held-out frames:", entry["held_out"])
    for key in ("evaluations", "factorisations", "cpu_s", "p_value", "tracking_factor", "rmse_mm"):
        console.print(f"{key}: {entry[key]} (least, 5 %, median, 95 %, most)")


def _percent(share: list[float]) -> str:
    return f"{100.0 * share[0]:.1f} ± {100.0 * share[1]:.1f}"


def read_logs(paths: Sequence[Path]) -> list[dict[str, Any]]:
    """All lines of some logs, with z and joint rises in units of the present width factor; ends are as they were.

    ``inside`` says which 95 % intervals hold the truth: by their ends, or by z where they had another width factor.
    A profile rises no more than phi itself does where the truth is, so that what was solved there is a bound of z:
    beyond an interval's ends the profile is extrapolated.
    """
    rows = [json.loads(line) for path in paths for line in path.read_text().splitlines()]
    for row in rows:
        before = row.get("width_factor", 1.0) / WIDTH_FACTOR
        for key in ("joint", "joint_solved"):
            if row.get(key) is not None:
                row[key] *= before**2
        if "z" in row:
            solved = row.get("joint_solved")
            most = np.inf if solved is None else np.sqrt(max(solved, 0.0))
            row["z"] = [float(np.clip(before * z, -most, most)) for z in row["z"]]
            ends = [low <= row["ratios"][name] <= high for name, low, high in zip(NAMES, row["low"], row["high"])]
            row["inside"] = ends if before == 1.0 else _inside(np.array(row["z"]), 0.95).tolist()
    return rows


def campaign(names: Sequence[str], first: int | None, count: int | None, folder: Path) -> None:
    """The subjects that the scenarios' logs in a folder lack."""
    folder.mkdir(parents=True, exist_ok=True)
    wanted = []
    for name in names:
        scenario, log = SCENARIOS[name], folder / log_of(name).name
        known = {row["seed"] for row in read_logs([log])} if log.is_file() else set()
        begin = scenario.first if first is None else first
        seeds = range(begin, begin + (count or scenario.count))
        wanted += [(seed, scenario, log) for seed in seeds if seed not in known]
    for seed, scenario, log in sorted(wanted, key=lambda one: one[0]):
        row = run_one(seed, scenario)
        with log.open("a") as stream:
            stream.write(json.dumps(rounded(row)) + "\n")
        print(log.stem, seed, row.get("not made") or row.get("failed") or row.get("z"), row.get("cpu_s"), flush=True)


def rounded(value: Any) -> Any:
    """A row, or a part of it, with as many digits as a log keeps."""
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, Mapping):
        return {key: rounded(part) for key, part in value.items()}
    return [rounded(part) for part in value] if isinstance(value, list | tuple) else value


def log_of(name: str) -> Path:
    """Where a scenario's rows are kept."""
    return LOGS / f"{name.replace(' ', '_').replace(',', '').replace(chr(39), '')}.jsonl"


def stored() -> list[dict[str, Any]]:
    """The stored campaigns, in the order of ``SCENARIOS``."""
    found: list[dict[str, Any]] = json.loads(RESULTS.read_text()) if RESULTS.is_file() else []
    order = list(SCENARIOS)
    return sorted(found, key=lambda entry: order.index(entry["scenario"]))


def store(entry: dict[str, Any]) -> None:
    """Keep a campaign's figures in the place of those of the same scenario."""
    others = [one for one in stored() if one["scenario"] != entry["scenario"]]
    RESULTS.write_text(json.dumps([*others, entry], indent=1) + "\n")
    RESULTS.write_text(json.dumps(stored(), indent=1) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", choices=list(SCENARIOS), nargs="+")
    parser.add_argument("--first", type=int, help="seed to begin with, of the scenario's own if left out")
    parser.add_argument("--count", type=int, help="seeds, those of the scenario if left out")
    parser.add_argument("--logs", type=Path, default=LOGS, metavar="FOLDER")
    parser.add_argument("--summary", type=Path, nargs="+", metavar="FILE")
    parser.add_argument("--store", nargs="*", metavar=("SCENARIO", "FILE"))
    parser.add_argument("--json", action="store_true", help="print what is stored")
    parser.add_argument("--rerun", type=Path, metavar="FOLDER", help="repeat all that is stored, logs in a folder")
    asked = parser.parse_args()
    if (asked.scenario or asked.rerun) and find_spec("mmgpy") is None:
        parser.error('the truths\' meshes need pip install -e ".[mesh]"')
    if asked.json:
        print(json.dumps(stored(), indent=1))
    elif asked.summary:
        show(summarised("logs", read_logs(asked.summary)))
    elif asked.store:
        name, *paths = asked.store
        if name not in SCENARIOS or not paths:
            parser.error(f"--store wants one of {', '.join(SCENARIOS)}, and logs")
        store(summarised(name, read_logs([Path(path) for path in paths])))
    elif asked.store is not None:
        for name in SCENARIOS:
            if log_of(name).is_file():
                store(summarised(name, read_logs([log_of(name)])))
                show(summarised(name, read_logs([log_of(name)])))
    elif asked.rerun:
        names = [entry["scenario"] for entry in stored()]
        campaign(names, None, None, asked.rerun)
        for name in names:
            show(summarised(name, read_logs([asked.rerun / log_of(name).name])))
    elif asked.scenario:
        campaign(asked.scenario, asked.first, asked.count, asked.logs)
    else:
        parser.error("wanted --scenario, --summary, --store, --json or --rerun")


if __name__ == "__main__":
    main()
