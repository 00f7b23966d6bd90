"""How often intervals hold a known truth: the rows of ``coverage.py``'s logs counted, as tables and as Markdown.

A row is a subject. "Inside" of one ratio is told by the ends of its interval, jointly by the rise of the likelihood at
the true ratios with the model solved there (``joint_solved``); what the fit's emulator says of that rise is counted
beside it and labelled so. Shares come with the binomial standard error of so many subjects.
"""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from kept_rows import rows_of
from rich.console import Console
from rich.table import Table
from scipy.stats import binom, chi2, norm

from spinestiff.estimation.profiles import CLOSE_ENOUGH, WIDTH_FACTOR

NAMES = ("lateral_bending", "tissue")
JOINT = "joint"
LEVELS = (0.68, 0.95, 0.999)
# Width factors for which is said how often intervals would hold each ratio, and the joint region both.
FACTORS = (1.0, 1.05, 1.1)
FAR = (-5.0, 5.0)  # z beyond counts as these where they are averaged
FLAGGED = 1e-3  # p-value of the residuals below which a result is called doubtful
SEVERE_DEG = 40.0  # Cobb angle at which the strata of the curve meet
STRATA = ("curve to 40°", "curve 40° to 80°")
THIRDS = ("lowest third", "middle third", "highest third")
KINDS = {
    "": "body as the model",
    "disc centres": "discs that turn farther behind",
    "layers": "layered tissue",
    "stiffening": "discs with a neutral zone",
}
"""What else a body has that the model lacks, by its name in a row."""
FIRST_TOLD = ("coarse pair, three pushes", "coarse pair, the paper's acquisition", "default chain, three pushes")
SHORT_NAMES = {
    "default chain, three pushes": "fine mesh (the default), three from one side",
    "coarse pair, three pushes": "coarse mesh, three from one side",
    "coarse pair, the paper's acquisition": "coarse mesh, one (the paper's)",
}
"""What pages for users call campaigns."""
LEAST_BY_PART = 30  # subjects of a campaign whose parts are told one by one in Markdown
QUANTILES = ("evaluations", "factorisations", "cpu_s", "p_value", "tracking_factor", "rmse_mm")

Row = Mapping[str, Any]
Masks = dict[str, np.ndarray]


def read_logs(paths: Sequence[Path]) -> list[dict[str, Any]]:
    """All lines of some logs, ready to be counted."""
    return countable(rows_of(paths))


def countable(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Lines of logs with z and joint rises in units of the present width factor; ends are as they were.

    ``inside`` says which 95 % intervals hold the truth: by their ends, or by z where they had another width factor.
    A profile rises no more than phi itself does where the truth is, so that what was solved there is a bound of z:
    beyond an interval's ends the profile is extrapolated.
    """
    found = [dict(row) for row in rows]
    for row in found:
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
    return found


def parts(rows: Sequence[Row]) -> dict[str, Masks]:
    """Which of n subjects belong to each part of a campaign: masks (n,), by ratio and ``JOINT``.

    Parts are all subjects; those whose interval is closed (jointly: both intervals) and open; thirds by the true ratio
    (jointly: of each ratio); strata of the curve; kinds of body that there are.
    """
    cobb = np.abs([row["cobb_deg"] for row in rows])
    kind = np.array([row["kind"] for row in rows])
    opens = np.array([row["open"] for row in rows], dtype=bool)
    everybody: Masks = {"all": np.ones(len(rows), dtype=bool)}
    common: Masks = {STRATA[0]: cobb < SEVERE_DEG, STRATA[1]: cobb >= SEVERE_DEG}
    common |= {title: kind == name for name, title in KINDS.items()}
    thirds = {name: _thirds(np.array([row["ratios"][name] for row in rows])) for name in NAMES}
    found = {
        name: {**everybody, "closed": ~opens[:, i], "open": opens[:, i], **thirds[name], **common}
        for i, name in enumerate(NAMES)
    }
    by_each = {f"{third} of {name}": mask for name in NAMES for third, mask in thirds[name].items()}
    found[JOINT] = {**everybody, "closed": ~opens.any(1), "open": opens.any(1), **by_each, **common}
    return {what: {part: mask for part, mask in masks.items() if mask.any()} for what, masks in found.items()}


def summarised(scenario: str, rows: Sequence[Row], planned: int | None = None) -> dict[str, Any]:
    """The figures of a campaign of so many ``planned`` seeds (None: no more than there are rows)."""
    made = [row for row in rows if "not made" not in row]
    found = [row for row in made if "z" in row]
    of = parts(found)
    # Where nothing was solved at the truth the emulator's word counts; without an equilibrium there it is outside.
    rise = np.array(
        [np.inf if one is None else one for one in (row.get("joint_solved", row["joint"]) for row in found)]
    )
    told = np.array([row["joint"] for row in found])
    entry: dict[str, Any] = {
        "scenario": scenario,
        "subjects": len(found),
        "seeds": seed_ranges(rows),
        "planned": len(rows) if planned is None else planned,
        "not_made": len(rows) - len(made),
        "without_estimate": len(made) - len(found),
        "coverage95": {},
        "median_factor": {},
        "bias_sd": {},
        "misses": {},
    }
    for i, name in enumerate(NAMES):
        z = np.array([row["z"][i] for row in found])
        near = np.clip(z, *FAR)
        widths = np.array([np.sqrt(row["high"][i] / row["low"][i]) for row in found])
        inside = {level: _inside(z, level) for level in LEVELS} | {0.95: np.array([row["inside"][i] for row in found])}
        entry[name] = {
            part: {
                "subjects": int(mask.sum()),
                **{_level(level): _share(inside[level][mask]) for level in LEVELS},
                "bias_sd": round(float(np.mean(near[mask])), 3),
                "median_z": round(float(np.median(z[mask])), 3),
                "sd_of_z": round(float(np.std(near[mask])), 3),
                "rms_z": round(float(np.sqrt(np.mean(z[mask] ** 2))), 3),
                "median_factor": round(float(np.median(widths[mask])), 3),
            }
            for part, mask in of[name].items()
        }
        everybody = entry[name]["all"]
        entry["coverage95"][name] = everybody[_level(0.95)][0]
        entry["median_factor"][name] = everybody["median_factor"]
        entry["bias_sd"][name] = everybody["bias_sd"]
        missed = ~inside[0.95]
        entry["misses"][name] = {
            "abs_z": sorted(np.abs(z[missed]).round(2).tolist()),
            "chance": float(f"{binom.cdf(len(z) - missed.sum(), len(z), 0.95):.3g}"),
        }
    entry[JOINT], entry["joint_by_emulator"] = (
        {
            part: {
                "subjects": int(mask.sum()),
                **{_level(level): _share(rises[mask] < chi2.ppf(level, 2)) for level in LEVELS},
            }
            for part, mask in masks.items()
        }
        for rises, masks in ((rise, of[JOINT]), (told, {"all": of[JOINT]["all"]}))
    )
    entry["coverage95"][JOINT] = entry[JOINT]["all"][_level(0.95)][0]
    z = np.array([row["z"] for row in found])
    entry["coverage95_by_width_factor"] = {
        f"{factor:g}": [
            *(_share(_inside(column * WIDTH_FACTOR / factor, 0.95))[0] for column in z.T),
            _share(rise * (WIDTH_FACTOR / factor) ** 2 < chi2.ppf(0.95, 2))[0],
        ]
        for factor in FACTORS
    }
    entry["outside_999"] = int(np.sum(rise >= chi2.ppf(0.999, 2)))
    # Where the truth is the more likely one the search ended in another minimum, or on another equilibrium.
    entry["better_at_truth"] = int(np.sum(rise < -2.0 * CLOSE_ENOUGH))
    entry["flagged"] = int(sum(row["p_value"] < FLAGGED for row in found))
    entry |= held_out(found)
    for key in QUANTILES:
        entry[key] = [float(f"{v:.4g}") for v in np.quantile([row[key] for row in found], (0.0, 0.05, 0.5, 0.95, 1.0))]
    entry["evaluations_max"] = int(max(row["evaluations"] for row in found))
    codes = [row.get("code", "") for row in rows]
    entry["code"] = {one: codes.count(one) for one in sorted(set(codes), key=lambda one: -codes.count(one))}
    entry["date"] = datetime.date.today().isoformat()
    return entry


def held_out(rows: Sequence[Row]) -> dict[str, Any]:
    """What forecasts of held-out frames were worth; empty where no frame was forecast."""
    frames = [frame for row in rows for frame in row.get("held_out", []) if "inside95" in frame]
    turns = [(f["cobb_error_deg"], f["cobb_sd_deg"]) for f in frames if f["cobb_sd_deg"] is not None]
    if not frames:
        return {}
    found = {
        "frames": len(frames),
        "corners95": round(float(np.mean([frame["inside95"] for frame in frames])), 4),
        "cobb95": _share(np.array([abs(error) < norm.ppf(0.975) * sd for error, sd in turns])),
        "median_rmse_mm": {
            "forecast": round(float(np.median([frame["rmse_mm"] for frame in frames])), 3),
            "fit": round(float(np.median([frame["fit_mm"] for frame in frames])), 3),
        },
    }
    return {"held_out": found}


def seed_ranges(rows: Sequence[Row]) -> list[list[int]]:
    """First and last seed of each unbroken range of the rows' seeds, in order."""
    ranges: list[list[int]] = []
    for seed in sorted({row["seed"] for row in rows}):
        if ranges and seed == ranges[-1][1] + 1:
            ranges[-1][1] = seed
        else:
            ranges.append([seed, seed])
    return ranges


def paired(rows: Sequence[Row], others: Sequence[Row]) -> dict[str, Any]:
    """The same people twice, otherwise estimated or on another mesh: ``rows`` less ``others`` where both have an
    estimate. Mean of each, and mean difference with its standard error, of z and of the estimate's log, by ratio.
    """
    estimates = [{row["seed"]: row for row in each if "z" in row} for each in (rows, others)]
    seeds = sorted(estimates[0].keys() & estimates[1].keys())
    if len(seeds) < 2:
        raise ValueError(f"{len(seeds)} people have an estimate in both; wanted two or more")
    found: dict[str, Any] = {"subjects": len(seeds)}
    for k, name in enumerate(NAMES):
        z = np.array([[each[seed]["z"][k] for each in estimates] for seed in seeds])
        logs = np.log([[each[seed]["estimate"][name] for each in estimates] for seed in seeds])
        found[name] = {"mean_z": np.clip(z, *FAR).mean(0).round(4).tolist()}
        for key, values in (("z", np.clip(z, *FAR)), ("log", logs)):
            apart = values[:, 0] - values[:, 1]
            error = apart.std(ddof=1) / np.sqrt(len(seeds))
            found[name][f"difference_{key}"] = [round(float(value), 4) for value in (apart.mean(), error)]
    return found


def _thirds(values: np.ndarray) -> Masks:
    """Of values that are not all the same; else there are none."""
    if len(values) and values.min() == values.max():
        return {}
    third = np.searchsorted(np.quantile(values, (1 / 3, 2 / 3)), values)
    return {word: third == k for k, word in enumerate(THIRDS)}


def _inside(z: np.ndarray, level: float) -> np.ndarray:
    return np.asarray(np.abs(z) < norm.ppf(0.5 + 0.5 * level))


def _share(inside: np.ndarray) -> list[float]:
    """A share and its binomial standard error."""
    if not len(inside):
        return [float("nan"), float("nan")]
    share = float(np.mean(inside))
    return [round(share, 6), round(float(np.sqrt(share * (1.0 - share) / len(inside))), 6)]


def _level(level: float) -> str:
    return f"{level:.1%}"


def _percent(share: Sequence[float]) -> str:
    return f"{100.0 * share[0]:.1f} ± {100.0 * share[1]:.1f}"


def show(entry: Row) -> None:
    """A campaign's figures as tables in a terminal."""
    console = Console(width=150)
    table = Table(title=f"{entry['scenario']}: {entry['subjects']} subjects, all of them synthetic")
    for column in ("ratio", "of", "subjects", *(_level(level) for level in LEVELS), "mean z", "median", "sd", "factor"):
        table.add_column(column)
    for name in NAMES:
        for part, found in entry[name].items():
            numbers = (f"{found[key]:.2f}" for key in ("bias_sd", "median_z", "sd_of_z", "median_factor"))
            table.add_row(name, part, str(found["subjects"]), *_shares(found), *numbers)
        table.add_section()
    for key, words in ((JOINT, "both"), ("joint_by_emulator", "both, by the emulator")):
        for part, found in entry[key].items():
            table.add_row(words, part, str(found["subjects"]), *_shares(found), "", "", "", "")
    console.print(table)
    console.print(
        f"{sum(last - first + 1 for first, last in entry['seeds'])} of {entry['planned']} seeds; "
        f"{entry['not_made']} not made, {entry['without_estimate']} without an estimate, {entry['outside_999']} "
        f"outside their 99.9 % region, {entry['better_at_truth']} less likely than the truth, "
        f"{entry['flagged']} flagged (p < {FLAGGED:g})"
    )
    if "held_out" in entry:
        console.print("held-out frames:", entry["held_out"])
    for key in QUANTILES:
        console.print(f"{key}: {entry[key]} (least, 5 %, median, 95 %, most)")


def _shares(found: Row) -> list[str]:
    return [_percent(found[_level(level)]) for level in LEVELS]


def markdown(entries: Sequence[Row]) -> str:
    """The campaigns' figures as the tables of docs/coverage.md: all of them in one, then each that is large by part."""
    columns = ("scenario", "subjects", "bending 68 %, 95 %", "tissue 68 %, 95 %", "joint 68 %, 95 %")
    columns += ("mean z: bending, tissue", "sd of z", "median factor", "outside 99.9 %", "flagged")
    lines = [*_head(columns)]
    for entry in entries:
        two = [entry[name]["all"] for name in NAMES]
        shares = [
            ", ".join(_rounded(one[_level(level)]) for level in LEVELS[:2]) for one in (*two, entry[JOINT]["all"])
        ]
        numbers = [", ".join(f"{one[key]:.2f}" for one in two) for key in ("bias_sd", "sd_of_z")]
        factors = ", ".join(f"{one['median_factor']:.3g}" for one in two)
        counts = [str(entry[key]) for key in ("outside_999", "flagged")]
        lines.append(_line(entry["scenario"], str(entry["subjects"]), *shares, *numbers, factors, *counts))
    for entry in entries:
        if entry["subjects"] < LEAST_BY_PART:
            continue
        lines += ["", f"**{entry['scenario'].capitalize()}**, {entry['subjects']} subjects:", "", *by_part(entry)]
        lines += ["", *misses(entry)] if "misses" in entry else []  # figures stored before 2026-11-27 have none
    return "\n".join(lines)


def short_table(entries: Sequence[Row]) -> list[str]:
    """Lines of a Markdown table for users: how many truths 95 % intervals hold."""
    found = {one["scenario"]: one for one in entries}
    lines = _head(("mesh, pushes", "subjects", "bending", "tissue", "both (joint region)"))
    for name, words in SHORT_NAMES.items():
        if name in found:
            inside = [str(_held(found[name], of)) for of in (*NAMES, JOINT)]
            lines.append(_line(words, str(found[name]["subjects"]), *inside))
    return lines


def headline(entries: Sequence[Row]) -> str:
    """What pages say first: of the campaigns with three pushes, with the paper's single one and on the fine mesh; ""
    where one is missing."""
    found = {one["scenario"]: one for one in entries}
    if not found.keys() >= set(FIRST_TOLD):
        return ""
    three, single, fine = (
        [found[name]["subjects"], *(_held(found[name], of) for of in (*NAMES, JOINT))] for name in FIRST_TOLD
    )
    return (
        f"**Of {three[0]} synthetic subjects under three pushes the 95 % interval holds the true value in {three[1]} "
        f"(lateral bending) and {three[2]} (tissue), of {single[0]} under the paper's single push in {single[1]} and "
        f"{single[2]}; the joint region of both ratios holds it in {three[3]} and {single[3]}. These are estimates on "
        f"the coarse mesh. On the fine mesh, which is the default, it holds bending in {fine[1]}, tissue in "
        f"{fine[2]} and both in {fine[3]} of {fine[0]}.**"
    )


def _held(entry: Row, name: str) -> int:
    """How many truths the 95 % intervals of a ratio, or the joint regions, hold."""
    return round(entry["coverage95"][name] * entry["subjects"])


def by_part(entry: Row) -> list[str]:
    """Lines of a Markdown table: 95 % coverage by part with its standard error and number, and z of each ratio."""
    lines = _head(
        ("subjects", "bending 95 %", "tissue 95 %", "joint 95 %", "bending: mean, rms z", "tissue: mean, rms z")
    )
    for part, joint in entry[JOINT].items():
        cells, spreads = [], []
        for name in NAMES:
            # Thirds of the other ratio are no part of this one's table.
            found = entry[name].get(part.removesuffix(f" of {name}"))
            cells.append("" if found is None else _of(found))
            spreads.append("" if found is None else f"{found['bias_sd']:.2f}, {found['rms_z']:.2f}")
        lines.append(_line(part.replace("lateral_bending", "bending"), *cells, _of(joint), *spreads))
    return lines


def misses(entry: Row) -> list[str]:
    """Lines of a Markdown list: how far beyond their 95 % intervals the truths lie, how often chance alone has so few
    inside or fewer, and what other width factors would make of the coverage."""
    lines = [
        f"- Misses of {name.replace('lateral_bending', 'bending')}: {len(found['abs_z'])} (absolute z "
        f"{', '.join(f'{z:.2f}' for z in found['abs_z']) or 'none'}); exact intervals have so many or more in "
        f"{100.0 * found['chance']:.3g} % of such campaigns."
        for name, found in entry["misses"].items()
    ]
    factors = (
        f"{factor}: {', '.join(f'{100.0 * share:.1f}' for share in shares)} %"
        for factor, shares in entry["coverage95_by_width_factor"].items()
    )
    return [*lines, f"- Bending, tissue and joint by width factor, by z alone: {'; '.join(factors)}."]


def _of(found: Row) -> str:
    return f"{_percent(found[_level(0.95)])} of {found['subjects']}"


def _rounded(share: Sequence[float]) -> str:
    return f"{100.0 * share[0]:.1f} %"


def _head(columns: Sequence[str]) -> list[str]:
    return [_line(*columns), "|" + "---|" * len(columns)]


def _line(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"
