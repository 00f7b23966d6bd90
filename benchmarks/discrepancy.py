"""How far may a person move from what the model says? Learnt from variants of the model, and tested on other kinds.

    python benchmarks/discrepancy.py --scratch FOLDER [--first 0] [--subjects 24]
    python benchmarks/discrepancy.py --learn FOLDER... [--write]
    python benchmarks/discrepancy.py --json | --markdown

The first makes the pairs of ``discrepancy_pairs.py`` in the folder and goes on from what is there; a second process
with other subjects and another folder halves the time. ``--learn`` learns from the pairs of such folders what
``spinestiff.estimation.discrepancy_data`` reads, tests it and prints the figures; ``--write`` stores the data in the
package, the figures in benchmarks/results/discrepancy.json and a picture of the first modes. ``--json`` prints that
file, ``--markdown`` prints it as the tables of docs/discrepancy.md. Needs the extra ``[mesh]``.

Learning. A pair is the vector of truth - model over six sites, vertebrae and channels, each site's part over the size
of the model's motion there. Each pair counts twice, as it is and mirrored, since the template is symmetrical. Of each
kind the second moment is kept (about 0: nobody knows which way a person differs), as modes and a remainder. A pair
whose truth lies farther from the model than the model moves is on another branch (a back that leaves the wall can
buckle): it is counted and not learnt from.

Test. Each kind is left out in turn. With the covariance of the others that an estimate expects, the ratios are
estimated at each pair's own point by generalised least squares with the model's derivatives; the errors are the pair's
own discrepancy and simulated corner errors (0.2 mm a corner, and 0.2 mm a vertebra correlated over two of them). How
often does the 95 % interval of log bending and of log tissue hold the truth? Acquisitions: one push at two forces,
three pushes on a side, all six, and one at any level. The back wall, which no covariance makes up for, is tested and
not pooled with the others.
"""

from __future__ import annotations

import argparse
import datetime
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import discrepancy_pairs
import numpy as np
from discrepancy_pairs import EXPLICIT, FINE_EVERY, GRID, KINDS, LEVELS, ROOT, TRUNK

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.template import Mesh
from spinestiff.arrays import Floats
from spinestiff.estimation.discrepancy import (
    CHANNELS,
    MIRROR,
    SIDES,
    DiscrepancyFrame,
    DiscrepancyModes,
    discrepancy_columns,
    motion_size,
)
from spinestiff.estimation.discrepancy_data import EXPECTED, MODES, DiscrepancyData, KindModes, write_data

RESULTS = Path(__file__).parent / "results" / "discrepancy.json"
DATA = ROOT / "src" / "spinestiff" / "estimation" / "data" / "discrepancy.npz"
FIGURE = ROOT / "docs" / "images" / "discrepancy_modes.png"
PAIRS = "pairs.jsonl"
KIND_MODES = 16
INFLATION, UNTRIED = 1.0, 0.005
TRIED = ((1.0, 0.0), (1.0, 0.3), (2.0, 0.005))
WALL = "one-sided wall"
BUCKLED = 1.0  # difference over motion in a frame
# Of a corner along one axis, and of a vertebra as a whole, correlated over so many of them.
CORNER_SD_MM, SHARED_SD_MM, SHARED_OVER = 0.2, 0.2, 2.0
CORNER_ARM_MM = 18.0  # of a vertebra's corners from its middle, root mean square
DRAWS = 50
NORMAL_95, CHI2_95 = 1.959964, 5.991465
SHOWN_MODES = 4
CHANNEL_NAMES = ("sideways", "upwards", "turn")


@dataclass(frozen=True)
class Pair:
    """A pair's frames: model and truth - model (F, 17, 3) mm, derivatives in the log ratios (F, 17, 3, 2), and in
    what an estimate has among its own unknowns (F, 17, 3, E), in standard deviations; turns times 20 mm."""

    kind: str
    subject: int
    frames: tuple[Mapping[str, Any], ...]
    model: Floats
    difference: Floats
    slopes: Floats
    explicit: Floats

    def row(self, use: str, side: str, level: float) -> int:
        return next(i for i, f in enumerate(self.frames) if (f["use"], f["side"], f["level"]) == (use, side, level))

    @property
    def grid(self) -> list[int]:
        """Rows of the learnt sites."""
        return [self.row("grid", *site) for site in GRID]

    @property
    def buckled(self) -> bool:
        """Whether the truth is on another branch in a frame."""
        apart, moved = (np.sum(values**2, axis=(1, 2)) for values in (self.difference, self.model))
        return bool(np.any(apart > BUCKLED**2 * moved))

    def relative(self, rows: Sequence[int]) -> Floats:
        """(R, 17, 3) differences over the size of the model's motion."""
        sizes = [motion_size(self.model[i] / CHANNELS) for i in rows]
        return np.asarray(self.difference[list(rows)] / np.array(sizes)[:, None, None])

    def acquisitions(self) -> dict[str, list[int]]:
        """Rows of the frames of what is tested."""
        half = next(i for i, f in enumerate(self.frames) if f["use"] == "half")
        off = next(i for i, f in enumerate(self.frames) if f["use"] == "off grid")
        full = self.row("grid", self.frames[half]["side"], self.frames[half]["level"])
        threes = {f"three on the {side}": [self.row("grid", side, level) for level in LEVELS] for side in SIDES}
        return {"one push, two forces": [half, full], **threes, "six": self.grid, "any level": [off]}


def pair_of(row: Mapping[str, Any]) -> Pair:
    """A written row."""
    model, truth, slopes = (np.array([f[key] for f in row["frames"]]) for key in ("model", "truth", "slope"))
    slopes = slopes * CHANNELS[:, None]
    return Pair(
        row["kind"],
        row["subject"],
        tuple(row["frames"]),
        model * CHANNELS,
        (truth - model) * CHANNELS,
        slopes[..., :2],
        np.concatenate([slopes[..., 2:] * list(EXPLICIT.values()), TRUNK * slopes[..., 1:2]], axis=-1),
    )


def own_share(pairs: Sequence[Pair]) -> float:
    """Of the variance of relative differences, what full and half force at one site do not share."""
    apart, size = 0.0, 0.0
    for pair in pairs:
        first, second = pair.relative(pair.acquisitions()["one push, two forces"])
        apart += float(np.sum((first - second) ** 2))
        size += float(np.sum(first**2) + np.sum(second**2))
    return apart / size


def learn_kind(pairs: Sequence[Pair]) -> KindModes:
    """Modes of the pairs of one kind, as they are and mirrored."""
    vectors = []
    for pair in pairs:
        here = pair.relative(pair.grid).reshape(len(SIDES), len(LEVELS), len(VERTEBRAE), len(CHANNELS))
        vectors += [here, here[::-1] * MIRROR]
    rows = np.array(vectors).reshape(len(vectors), -1) / np.sqrt(len(vectors))
    _, values, axes = np.linalg.svd(rows, full_matrices=False)
    modes = values[:KIND_MODES, None] * axes[:KIND_MODES]
    left = np.sqrt(np.maximum(np.sum(rows**2, axis=0) - np.sum(modes**2, axis=0), 0.0))
    shape = vectors[0].shape
    return KindModes(len(pairs), modes.reshape(-1, *shape), left.reshape(shape), own_share(pairs))


def learn(pairs: Sequence[Pair], inflation: float, untried: float, made: str = "") -> DiscrepancyData:
    """Everything that the package ships."""
    known = {name: [pair for pair in pairs if pair.kind == name] for name in (*KINDS, *FINE_EVERY)}
    kinds = {name: learn_kind(own) for name, own in known.items() if own}
    return DiscrepancyData(np.array(LEVELS), kinds, inflation, untried, made)


def others_of(kind: str) -> dict[str, float]:
    """What an estimate expects (``EXPECTED``) on the mesh that a kind speaks of, without that kind."""
    expected = EXPECTED["fine" if kind in FINE_EVERY else "coarse"]
    return {name: share for name, share in expected.items() if name != kind}


def noise(frames: int) -> Floats:
    """(n, n) mm2, covariance of the channels that corner errors give."""
    apart = np.abs(np.subtract.outer(np.arange(17), np.arange(17)))
    arm = CHANNELS[2] / CORNER_ARM_MM
    own = 0.25 * CORNER_SD_MM**2 * np.diag([1.0, 1.0, arm**2])
    shared = SHARED_SD_MM**2 * np.exp(-apart / SHARED_OVER)
    return np.kron(np.eye(frames), np.kron(np.eye(17), own) + np.kron(shared, np.eye(3)))


@dataclass(frozen=True)
class Weighed:
    """A weighed linearised estimate: ``gain`` (2, n) from errors to log ratios, what the pair's discrepancy does to
    them (``bias``, (2,)), and the covariance that is told (2, 2)."""

    gain: Floats
    bias: Floats
    variance: Floats


def weighed(pair: Pair, rows: Sequence[int], modes: DiscrepancyModes) -> Weighed:
    """The estimate from some frames of a pair."""
    frames = [DiscrepancyFrame(pair.frames[i]["side"], pair.frames[i]["level"], pair.model[i] / CHANNELS) for i in rows]
    size = len(rows) * 17 * 3
    learnt = (discrepancy_columns(frames, modes) * CHANNELS[:, None]).reshape(size, -1)
    columns = np.hstack([learnt, pair.explicit[list(rows)].reshape(size, -1)])
    slopes, difference = pair.slopes[list(rows)].reshape(size, 2), pair.difference[list(rows)].ravel()
    solved = np.linalg.solve(noise(len(rows)) + columns @ columns.T, slopes)
    variance = np.linalg.inv(slopes.T @ solved)
    gain = variance @ solved.T
    return Weighed(gain, gain @ difference, variance)


@dataclass(frozen=True)
class Outcome:
    """Of one estimate: share of draws inside the 95 % interval of each log ratio, and inside the joint region;
    standard deviations; the discrepancy's own part of the error over them."""

    inside: Floats
    joint: float
    sd: Floats
    off: Floats


def estimate(pair: Pair, rows: Sequence[int], modes: DiscrepancyModes, random: np.random.Generator) -> Outcome:
    """How often an estimate's intervals hold the truth, over simulated corner errors."""
    found = weighed(pair, rows, modes)
    corners = noise(len(rows))
    drawn = np.linalg.cholesky(corners) @ random.normal(size=(len(corners), DRAWS))
    errors = found.bias[:, None] + found.gain @ drawn
    sd = np.sqrt(np.diag(found.variance))
    inside = np.mean(np.abs(errors) <= NORMAL_95 * sd[:, None], axis=1)
    distance = np.einsum("pd,pq,qd->d", errors, np.linalg.inv(found.variance), errors)
    return Outcome(inside, float(np.mean(distance <= CHI2_95)), sd, found.bias / sd)


def leave_one_out(pairs: Sequence[Pair], inflation: float, untried: float) -> dict[str, dict[str, list[Outcome]]]:
    """By kind and acquisition, estimates with what was learnt from the other kinds."""
    random = np.random.default_rng(discrepancy_pairs.SEED)
    found: dict[str, dict[str, list[Outcome]]] = {}
    data = learn(pairs, inflation, untried)
    for kind in dict.fromkeys(pair.kind for pair in pairs):
        found[kind] = tested(pairs, kind, data.combined(others_of(kind)), random)
    return found


def tested(
    pairs: Sequence[Pair], kind: str, modes: DiscrepancyModes, random: np.random.Generator
) -> dict[str, list[Outcome]]:
    """By acquisition, estimates of the pairs of a kind."""
    own: dict[str, list[Outcome]] = {}
    for pair in pairs:
        if pair.kind == kind:
            for name, rows in pair.acquisitions().items():
                own.setdefault(name, []).append(estimate(pair, rows, modes, random))
    return own


def coverage(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Shares of intervals that hold the truth, the sd of log ratios, and how far off the discrepancy brings them."""
    inside, sd, off = (np.array([getattr(o, key) for o in outcomes]) for key in ("inside", "sd", "off"))
    return {
        "estimates": len(outcomes),
        "both": round(float(inside.mean()), 3),
        "lateral_bending": round(float(inside[:, 0].mean()), 3),
        "tissue": round(float(inside[:, 1].mean()), 3),
        "joint": round(float(np.mean([o.joint for o in outcomes])), 3),
        "median_sd": np.median(sd, axis=0).round(3).tolist(),
        "rms_off_over_sd": np.sqrt(np.mean(off**2, axis=0)).round(2).tolist(),
    }


def coverages(found: Mapping[str, Mapping[str, Sequence[Outcome]]]) -> dict[str, Any]:
    """Coverage by kind, and without the wall pooled, of what an estimate does not know as an unknown, and by
    acquisition."""
    names = list(next(iter(found.values())))
    held = {kind: own for kind, own in found.items() if kind != WALL}
    unknown = {kind: own for kind, own in held.items() if kind not in EXPLICIT}
    return {
        "pooled": coverage([o for own in held.values() for some in own.values() for o in some]),
        "pooled_without_unknowns": coverage([o for own in unknown.values() for some in own.values() for o in some]),
        "by_kind": {kind: coverage([o for some in own.values() for o in some]) for kind, own in found.items()},
        "by_acquisition": {name: coverage([o for own in held.values() for o in own[name]]) for name in names},
    }


def sizes(pairs: Sequence[Pair], kind: str) -> dict[str, Any]:
    """RMS difference over RMS motion of the pairs of a kind, at the learnt sites, in all and by channel."""
    own = [pair for pair in pairs if pair.kind == kind]
    ratio = [np.sum(p.difference[p.grid] ** 2, axis=(1, 2)) / np.sum(p.model[p.grid] ** 2, axis=(1, 2)) for p in own]
    by_channel = [np.sum(p.difference[p.grid] ** 2, axis=1) / np.sum(p.model[p.grid] ** 2, axis=1) for p in own]
    return {
        "pairs": len(own),
        "relative": round(float(np.sqrt(np.mean(ratio))), 4),
        "median": round(float(np.sqrt(np.median(ratio))), 4),
        "largest": round(float(np.sqrt(np.max(ratio))), 4),
        "by_channel": dict(zip(CHANNEL_NAMES, np.sqrt(np.mean(by_channel, axis=(0, 1))).round(4).tolist())),
        "own_share": round(own_share(own), 4),
    }


def explained(data: DiscrepancyData, mesh: Mesh) -> dict[str, Any]:
    """Share of the second moment in the first so many modes: of all that an estimate expects, and of a kind in the
    others' modes; and how much of the whole each kind is."""
    shares = EXPECTED[mesh]
    moments = {name: share * data.kinds[name].moment for name, share in shares.items()}
    whole = np.sum(list(moments.values()), axis=0)
    values = np.linalg.eigvalsh(whole)[::-1]
    left_out = {}
    for name in shares:
        others = np.sum([moments[other] for other in shares if other != name], axis=0)
        axes = np.linalg.eigh(others)[1][:, ::-1]
        held = np.cumsum(np.einsum("nk,nm,mk->k", axes, moments[name], axes)) / np.trace(moments[name])
        left_out[name] = {str(count): round(float(held[count - 1]), 3) for count in (4, 8, 12)}
    parts = {name: round(float(np.trace(moment) / np.trace(whole)), 4) for name, moment in moments.items()}
    held = np.cumsum(values) / values.sum()
    return {"by_modes": held[:20].round(4).tolist(), "left_out_kind": left_out, "parts": parts}


def scale_likelihoods(pairs: Sequence[Pair]) -> dict[str, float]:
    """Mean log likelihood of a pair's differences at the learnt sites under what other subjects' pairs of all kinds
    give, relative to one size of the model's motion or to that of each channel (``MODES``, and ``UNTRIED`` on top)."""

    def scales(pair: Pair, each: bool) -> Floats:
        squares = np.mean(pair.model[pair.grid] ** 2, axis=1)
        return np.sqrt(squares if each else np.repeat(squares.sum(axis=1, keepdims=True), len(CHANNELS), axis=1))

    found = {}
    corners = noise(len(GRID))
    for name, each in (("one size", False), ("a size for each channel", True)):
        values, of = [], {}
        for pair in pairs:
            relative = pair.difference[pair.grid] / scales(pair, each)[:, None]
            swapped = relative.reshape(len(SIDES), -1, 17, 3)[::-1].reshape(relative.shape) * MIRROR
            of[id(pair)] = np.stack([relative.ravel(), swapped.ravel()])
        for subject in dict.fromkeys(pair.subject for pair in pairs):
            others = [pair for pair in pairs if pair.subject != subject]
            kinds = [[of[id(pair)] for pair in others if pair.kind == k] for k in dict.fromkeys(p.kind for p in others)]
            rows = np.concatenate([np.concatenate(k) / np.sqrt(2.0 * len(k) * len(kinds)) for k in kinds])
            _, sizes_, axes = np.linalg.svd(rows, full_matrices=False)
            modes = sizes_[:MODES, None] * axes[:MODES]
            diagonal = np.sum(rows**2, axis=0)
            left = (1.0 + UNTRIED) * diagonal - np.sum(modes**2, axis=0)
            moment = modes.T @ modes + np.diag(np.maximum(left, 0.0))
            for pair in pairs:
                if pair.subject == subject:
                    scale = np.repeat(scales(pair, each), 17, axis=0).ravel()
                    factor = np.linalg.cholesky(scale[:, None] * moment * scale + corners)
                    white = np.linalg.solve(factor, pair.difference[pair.grid].ravel())
                    values.append(-0.5 * white @ white - np.sum(np.log(np.diag(factor))))
        found[name] = round(float(np.mean(values)), 1)
    return found


def digest() -> str:
    """Of the code that makes and learns the pairs."""
    patterns = ("benchmarks/discrepancy*.py", "tools/*.py", "src/spinestiff/anatomy/**/*.py")
    patterns += ("src/spinestiff/mechanics/*.py", "src/spinestiff/estimation/discrepancy.py")
    files = [path for pattern in patterns for path in sorted(ROOT.glob(pattern))]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:12]


def evaluate(rows: Sequence[Mapping[str, Any]]) -> tuple[dict[str, Any], DiscrepancyData]:
    """The results as they are stored, and the data as they are shipped."""
    made_pairs = [pair_of(row) for row in rows if "failed" not in row]
    pairs = [pair for pair in made_pairs if not pair.buckled]
    made = f"{datetime.datetime.now(datetime.UTC).date().isoformat()}, {digest()}"
    data = learn(pairs, INFLATION, UNTRIED, made)
    failed = [row for row in rows if "failed" in row]
    results = {
        "made": made,
        "pairs": len(pairs),
        "subjects": len({pair.subject for pair in pairs}),
        "failed": {f"{row['subject']} {row['kind']}": row["failed"] for row in failed},
        "buckled": [f"{pair.subject} {pair.kind}" for pair in made_pairs if pair.buckled],
        "cpu_s": round(sum(row["cpu_s"] for row in rows if "cpu_s" in row)),
        "inflation": INFLATION,
        "untried": UNTRIED,
        "kinds": {kind: sizes(pairs, kind) for kind in data.kinds},
        "log_likelihood_of_left_out_subjects": scale_likelihoods([pair for pair in pairs if pair.kind in KINDS]),
        "explained": {mesh: explained(data, mesh) for mesh in EXPECTED},
        "leave_one_kind_out": coverages(leave_one_out(pairs, INFLATION, UNTRIED)),
        "other_settings": [
            {
                "inflation": inflation,
                "untried": untried,
                **_short(coverages(leave_one_out(pairs, inflation, untried))),
            }
            for inflation, untried in TRIED
        ],
    }
    return results, data


def _short(found: Mapping[str, Any]) -> dict[str, Any]:
    held = {kind: one for kind, one in found["by_kind"].items() if kind != WALL}
    worst = min(held, key=lambda kind: held[kind]["both"])
    pooled = found["pooled"]
    return {
        "both": pooled["both"],
        "joint": pooled["joint"],
        "worst": [worst, found["by_kind"][worst]["both"]],
        "median_sd": pooled["median_sd"],
    }


def draw(data: DiscrepancyData, path: Path) -> None:
    """The first modes on the coarse mesh: shift, rise and turn by vertebra, a line a site."""
    from matplotlib.figure import Figure

    modes = data.combined(EXPECTED["coarse"])
    total = (np.sum(modes.modes**2) + np.sum(modes.remainder**2)) / (1.0 + data.untried)
    figure = Figure(figsize=(9.0, 2.3 * SHOWN_MODES), layout="constrained")
    axes = figure.subplots(SHOWN_MODES, len(CHANNELS), sharey=True, sharex="row")
    colours = ("#c0504d", "#7f7f7f", "#1f5fa8")
    for number, (row, mode) in enumerate(zip(axes, modes.modes), start=1):
        for channel, axis in enumerate(row):
            axis.axvline(0.0, color="0.85", linewidth=0.8)
            for side, style in zip((1, 0), ("-", "--")):
                for site, colour in enumerate(colours):
                    label = f"{SIDES[side]}, rib {data.levels[site]:g}"
                    axis.plot(100.0 * mode[side, site, :, channel], range(17), style, color=colour, label=label)
            axis.set_yticks(range(0, 17, 2), VERTEBRAE[::2], fontsize=7)
            axis.tick_params(axis="x", labelsize=7)
            if number == 1:
                axis.set_title(("sideways", "upwards", "turn (at 20 mm)")[channel], fontsize=9)
        row[0].set_ylabel(f"mode {number}: {np.sum(mode**2) / total:.0%}", fontsize=9)
    for axis in axes[-1]:
        axis.set_xlabel("% of the motion's size", fontsize=8)
    axes[0, 0].invert_yaxis()  # the axes share it
    figure.legend(*axes[0, 0].get_legend_handles_labels(), ncols=6, fontsize=8, loc="outside lower center")
    figure.savefig(path, dpi=90)


def markdown(results: Mapping[str, Any]) -> str:
    """The stored figures as the tables of docs/discrepancy.md."""
    lines = ["| kind | pairs | relative | sideways, up, turn | own | left out: bending, tissue |", "|---" * 6 + "|"]
    left_out = results["leave_one_kind_out"]
    for kind, own in results["kinds"].items():
        channels = ", ".join(f"{value:.0%}" for value in own["by_channel"].values())
        lines.append(f"| {kind} | {own['pairs']} | {own['relative']:.1%} | {channels} | {own['own_share']:.2f} | ")
        lines[-1] += f"{_shares(left_out['by_kind'][kind])} |"
    lines += ["", "| mesh | 1, 4, 8, 12, 20 modes hold | parts |", "|---" * 3 + "|"]
    for mesh, found in results["explained"].items():
        held = ", ".join(f"{found['by_modes'][count - 1]:.0%}" for count in (1, 4, 8, 12, 20))
        parts = ", ".join(f"{kind} {share:.0%}" for kind, share in found["parts"].items())
        lines.append(f"| {mesh} | {held} | {parts} |")
    lines += ["", "| tested | estimates | both | bending | tissue | joint region | median sd of the logs |"]
    lines.append("|---" * 7 + "|")
    tested = {"all but the wall": left_out["pooled"], "but for unknowns": left_out["pooled_without_unknowns"]}
    for name, found in (tested | left_out["by_acquisition"]).items():
        joint, sds = f"{found['joint']:.1%}", ", ".join(f"{sd:.2f}" for sd in found["median_sd"])
        lines.append(f"| {name} | {found['estimates']} | {found['both']:.1%} | {found['lateral_bending']:.1%} | ")
        lines[-1] += f"{found['tissue']:.1%} | {joint} | {sds} |"
    lines += ["", "| inflation | untried | pooled, worst | median sd |", "|---" * 4 + "|"]
    for one in results["other_settings"]:
        worst, sds = "{} {:.1%}".format(*one["worst"]), ", ".join(f"{sd:.2f}" for sd in one["median_sd"])
        lines.append(f"| {one['inflation']:g} | {one['untried']:g} | {one['both']:.1%}, {worst} | {sds} |")
    return "\n".join(lines)


def _shares(found: Mapping[str, Any]) -> str:
    return f"{found['lateral_bending']:.1%}, {found['tissue']:.1%}"


def show(results: Mapping[str, Any]) -> None:
    """What was learnt and how it was tested, in lines."""
    print(f"{results['pairs']} pairs of {results['subjects']} subjects")
    for kind, found in results["kinds"].items():
        tested_kind = results["leave_one_kind_out"]["by_kind"][kind]
        print(f"{kind:16s} {found['pairs']:4d} pairs, {found['relative']:7.1%} of motion, left out: {tested_kind}")
    print("pooled:", results["leave_one_kind_out"]["pooled"])
    print("without unknowns:", results["leave_one_kind_out"]["pooled_without_unknowns"])
    for setting in results["other_settings"]:
        print(setting)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scratch", type=Path, help="folder of pairs to make; a run goes on from it")
    parser.add_argument("--first", type=int, default=0, help="number of the first subject to make pairs of")
    parser.add_argument("--subjects", type=int, default=24, help="to make pairs of")
    parser.add_argument("--learn", type=Path, nargs="+", metavar="FOLDER", help="with pairs")
    parser.add_argument("--write", action="store_true", help="store data, results and picture")
    parser.add_argument("--json", action="store_true", help="print what is stored")
    parser.add_argument("--markdown", action="store_true", help="print it as tables")
    asked = parser.parse_args()
    if asked.json or asked.markdown:
        stored = json.loads(RESULTS.read_text(encoding="utf-8"))
        print(json.dumps(stored, indent=1) if asked.json else markdown(stored))
    elif asked.scratch:
        asked.scratch.mkdir(parents=True, exist_ok=True)
        discrepancy_pairs.run(asked.scratch / PAIRS, asked.first, asked.subjects)
    elif asked.learn:
        rows = [row for folder in asked.learn for row in discrepancy_pairs.read(folder / PAIRS)]
        made = {row["kind"] for row in rows if "failed" not in row}
        lacking = [kind for kind in (*KINDS, *FINE_EVERY) if kind not in made]
        if lacking:
            parser.error(f"no pairs of the kinds {', '.join(lacking)} in {', '.join(map(str, asked.learn))}; make more")
        results, data = evaluate(rows)
        show(results)
        if asked.write:
            DATA.parent.mkdir(exist_ok=True)
            write_data(DATA, data)
            RESULTS.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
            draw(data, FIGURE)
    else:
        parser.error("wanted --scratch, --learn, --json or --markdown")


if __name__ == "__main__":
    main()
