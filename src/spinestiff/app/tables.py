"""What commands print: tables for people, in a terminal's width, else 80 characters wide, and JSON for programs."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from spinestiff.normal import HALF_WIDTH_95
from spinestiff.study.wording.estimate import (
    badge,
    costly_unknowns,
    halved_or_doubled,
    known_word,
    least_known,
    strongest_priors,
)
from spinestiff.study.wording.numbers import estimated, factor95, fixed, interval, number
from spinestiff.study.wording.titles import PLAIN, unknown_title

if TYPE_CHECKING:
    from spinestiff.study.repeatability import Repeatability
    from spinestiff.study.seven.goals import Goal
    from spinestiff.study.seven.tables import PaperTable
    from spinestiff.subject.assessment_outcome import CobbChangeRecord, HeldOutFrame
    from spinestiff.subject.estimate_outcome import Estimate
    from spinestiff.subject.outcomes import FrameProposal
    from spinestiff.verification.outcome import Check

WIDTH = 80
"""Characters of a line where the output is no terminal."""
LABEL_WIDTH = 20
"""Characters of a label of the paper's tables before it goes on in another line."""
NAME_WIDTH = 24
"""The same of a file's name."""


def show(shown: Table) -> None:
    """Print a table: in a terminal's width, else in ``WIDTH``."""
    _console().print(shown)


def _console() -> Console:
    console = Console()
    return console if console.is_terminal else Console(width=WIDTH)


def show_json(data: Any) -> None:
    """Print JSON; nothing that is not finite passes."""
    print(json.dumps(data, indent=1, allow_nan=False))


def table(title: str, *columns: str, left: Sequence[str] = (), gap: int = 2) -> Table:
    """An empty table without lines between columns. Where a line is too short, words are broken, and numbers are not.

    Parameters
    ----------
    left : columns that are words, besides the first; numbers stand on the right.
    gap : blanks between columns.
    """
    made = Table(
        title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False,
        padding=(0, gap - 1, 0, 0),
    )  # fmt: skip
    lines = max(column.count("\n") for column in columns)
    for i, column in enumerate(columns):
        head = "\n" * (lines - column.count("\n")) + column
        words = i == 0 or column in left
        made.add_column(head, justify="left" if words else "right", overflow="fold", no_wrap=not words)
    return made


def broken(path: str) -> str:
    """A file's path in lines of ``NAME_WIDTH`` characters, as far as its folders and its name are no longer."""
    lines = [""]
    for part in re.findall(r"[^/]*/|[^/]+", path):
        if lines[-1] and len(lines[-1]) + len(part) > NAME_WIDTH:
            lines.append("")
        lines[-1] += part
    return "\n".join(lines)


def _number(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def repeatability_table(found: Repeatability) -> Table:
    """Within-subject scatter of each ratio, found and expected, and the smallest change that would show."""
    columns = ("ratio", "sd of log", "95 %", "expected", "smallest\nchange", "\nexpected", "p")
    made = table("Repeatability: scatter within a subject", *columns)
    for name, one in found.scatter.items():
        ends = f"{one.low:.3f} to {one.high:.3f}"
        # One repetition would say "no change is too small" of two estimates that happen to agree.
        found_factor = f"× {one.detectable_factor:.3g}" if one.degrees > 1 else "-"
        factors = (found_factor, f"× {one.expected_factor:.3g}")
        made.add_row(
            escape(name.replace("_", " ")),
            f"{one.within_sd_log:.3f}",
            ends,
            f"{one.expected_sd_log:.3f}",
            *factors,
            f"{one.p_value:.2g}",
        )
    return made


def estimate_table(estimate: Estimate) -> Table:
    """Stiffness in plain units with intervals, and the ratios that it comes from."""
    made = table(f"Estimate: {badge(estimate)}", "stiffness", "value", "95 % interval", "", left=("",))
    for key, title in PLAIN.items():
        found = estimate.plain[key]
        span = "" if found.low is None and found.high is None else interval(found)
        made.add_row(title, estimated(found), span, found.unit)
    made.add_section()
    for name in estimate.parameters:
        ratio = estimate.ratios[name]
        known = known_word(estimate, ratio.determined) + (", at bound" if ratio.at_bound else "")
        made.add_row(f"ratio: {escape(name)}", estimated(ratio), interval(ratio), known)
    return made


MOST_UNKNOWNS, MOST_PRIORS = 8, 6
"""Rows of the variance budget and of other priors that a terminal shows; ``estimate.json`` has all."""


def budget_table(estimate: Estimate) -> Table:
    """What each unknown does to the ratios that are known least: factors with it alone, and if it were known."""
    names = least_known(estimate)
    heads = (head for name in names for head in (f"{_stacked_name(name)}\nalone", "if\nknown"))
    title = "Uncertainty: factor (95 %) by each unknown alone, and if it were known"
    made = table(title, "unknown", *heads)
    rows = costly_unknowns(estimate)
    for row in rows[:MOST_UNKNOWNS]:
        factors = (factor95(sds[name]) for name in names for sds in (row.alone, row.without))
        made.add_row(unknown_title(row.name), *factors)
    _others(made, len(rows) - MOST_UNKNOWNS)
    return made


def priors_table(estimate: Estimate) -> Table:
    """The ratios that are known least, with their factors, with one prior's standard deviation halved or doubled."""
    names = least_known(estimate)
    made = table(
        "With a prior's standard deviation halved or doubled: ratio (factor, 95 %)",
        "unknown", "its\nprior", *(_stacked_name(name) for name in names), left=("its\nprior",),
    )  # fmt: skip
    made.add_row("all as they are", "", *(_with_factor(estimate.values[name], estimate.sd_log[name]) for name in names))
    rows = strongest_priors(estimate)
    for row in rows[:MOST_PRIORS]:
        cells = (_with_factor(row.ratios[name], row.sd_log[name]) for name in names)
        made.add_row(unknown_title(row.name), halved_or_doubled(row), *cells)
    _others(made, len(rows) - MOST_PRIORS)
    return made


def _with_factor(ratio: float, sd_log: float) -> str:
    return f"{number(ratio, 2)} ({factor95(sd_log)})"


def _stacked_name(name: str) -> str:
    """A ratio's name as narrow as its words."""
    return escape(name.replace("_", "\n").replace("@", "\n@"))


def _others(made: Table, count: int) -> None:
    if count > 0:
        made.add_row(f"{count} more, that change less, in estimate.json")


PREDICTORS = {
    "rest": "rest", "default": "de-\nfault", "fit": "fit", "forecast": "fore-\ncast",
    "fitted_supports": "fitted\nsupp.", "extrapolation": "extra-\npol.", "single_ratio": "one\nratio", "truth": "truth",
}  # fmt: skip
"""Columns of the held-out frames' table, by the name of the predictor."""


def assessment_table(frames: Sequence[HeldOutFrame]) -> Table:
    """RMSE of every held-out frame by predictor, and the change of the Cobb angle (tilt form), as seen
    (with its 95 % half width) and by the fit, each with its levels.
    """
    names = [name for name in PREDICTORS if any(frame.rmse_mm[name] is not None for frame in frames)]
    made = table(
        "Held-out frames: corner RMSE, mm, and change of tilt, degrees",
        "frame", "N", *(PREDICTORS[name] for name in names), "tilt,\nseen", "tilt,\nfit",
        gap=1,
    )  # fmt: skip
    for frame in frames:
        changes = [frame.cobb_change_deg.get(key) for key in ("measured", "fit")]
        made.add_row(
            escape(f"{frame.push} {frame.frame}"),
            f"{frame.force_n:.0f}",
            *[_number(frame.rmse_mm[name]) for name in names],
            *[_tilt(change) for change in changes],
        )
    return made


def _tilt(change: CobbChangeRecord | None) -> str:
    if change is None:
        return "-"
    error = "" if change.sds is None else f"±{fixed(HALF_WIDTH_95 * change.sds[2], 1)}"
    return f"{change.tilt:.1f}{error}\n{'–'.join(change.tilt_levels)}"


def frames_table(frames: Sequence[FrameProposal]) -> Table:
    """Every frame's quality and support motion, its role in ``subject.json`` and the proposed one."""
    made = table(
        "Frames: quality, motion of supports since the first frame (mm), roles",
        "frame", "N", "sharp-\nness", "contr./\nnoise", "ver-\ntebrae", "track.\nmm", "pelvis", "shoul-\nder",
        "role", "proposed", gap=1,
    )  # fmt: skip
    for frame in frames:
        made.add_row(
            escape(f"{frame.push} {frame.frame}"),
            f"{frame.force_n:.0f}",
            _number(frame.sharpness),
            _number(frame.contrast_to_noise, 1),
            str(frame.vertebrae),
            _number(frame.tracking_mm),
            *[_motion(frame.supports.get(name)) for name in ("pelvis", "shoulder")],
            frame.role,
            frame.proposed,
        )
    return made


def _motion(support: Mapping[Any, float | None] | None) -> str:
    if support is None:
        return "-"
    turn = support["degrees"]
    return _number(support["mm"], 1) + ("" if turn is None else f", {turn:+.1f}°")


def cobb_table(rows: Sequence[tuple[str, str, str, str, str]]) -> Table:
    """Rows of image, Cobb angle with levels, and the three forms of its change, each with its levels below it."""
    columns = ("angle", "change: signed", "fixed levels", "tilt")
    made = table(
        "Cobb angles, ± half of the 95 % interval; changes above 0: convex to the left",
        "image", *columns, left=columns, gap=1,
    )  # fmt: skip
    for row in rows:
        made.add_row(*[escape(stacked(cell)) for cell in row])
    return made


def stacked(cell: str) -> str:
    """ "12.0° ± 4.0° (T5–L1, endplates)" with a line for each of what is in brackets."""
    first, bracket, rest = cell.partition(" (")
    return f"{first}\n({rest.replace(', ', ',' + chr(10))}" if bracket else cell


def show_paper_table(found: PaperTable) -> None:
    """Print a table of the paper, ours beside the paper's lines: in parts where a line is too short for all subjects,
    each part with the labels of all lines."""
    console = _console()
    unlimited = console.options.update_width(10 * WIDTH)
    for count in range(1, len(found.columns) + 2):
        parts = paper_parts(found, count)
        if all(console.measure(part, options=unlimited).maximum <= console.width for part in parts):
            break
    for part in parts:
        console.print(part)


def paper_parts(found: PaperTable, count: int) -> list[Table]:
    """A table of the paper in ``count`` parts of as many columns each, or fewer in the last."""
    heads = (*found.columns, "average")
    size = -(-len(heads) // count)
    parts = []
    for first in range(0, len(heads), size):
        part = slice(first, first + size)
        made = table(f"Table {found.number}: {found.title}", "", "", *heads[part], left=("",), gap=1)
        made.columns[0].max_width = LABEL_WIDTH
        last = ""
        for line in found.lines:
            made.add_row("" if line.label == last else line.label, line.whose, *(*line.cells, line.average)[part])
            last = line.label
        parts.append(made)
    return parts


def goals_table(found: Sequence[Goal], title: str) -> Table:
    """What a study is judged by."""
    made = table(title, "goal", "wanted", "found", "", left=("wanted", "found"))
    for goal in found:
        made.add_row(goal.name, goal.wanted, goal.found, "" if goal.met is None else "met" if goal.met else "NOT MET")
    return made


def check_record(check: Check) -> dict[str, Any]:
    """One check as JSON; an error that is not finite is written as text."""
    error = float(check.error)
    finite = error == error and abs(error) != float("inf")
    return {
        "name": check.name,
        "kind": check.kind,
        "error": error if finite else str(error),
        "tolerance": float(check.tolerance),
        "passed": bool(check.passed),
    }


def check_table(results: Sequence[Check]) -> Table:
    """All checks with their errors; the title counts what passed, each kind by itself."""
    from spinestiff.verification.outcome import summary

    made = table(summary(results), "check", "kind", "error", "tolerance", "", left=("kind",))
    for r in results:
        verdict = "passed" if r.passed else "[bold red]FAILED[/bold red]"
        made.add_row(escape(r.name), r.kind, f"{r.error:.1e}", f"{r.tolerance:.0e}", verdict)
    return made
