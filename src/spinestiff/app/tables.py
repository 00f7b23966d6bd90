"""What commands print: tables for people, JSON for programs."""

from __future__ import annotations

import importlib.metadata
import json
import platform
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from spinestiff.study.wording import NO_INTERVALS, PLAIN, badge, estimated, has_intervals, interval

if TYPE_CHECKING:
    from spinestiff.study.repeatability import Repeatability
    from spinestiff.study.seven.goals import Goal
    from spinestiff.study.seven.tables import PaperTable
    from spinestiff.subject.outcomes import Estimate, FrameProposal, HeldOutFrame
    from spinestiff.verification.outcome import Check

LIBRARIES = (
    "numpy",
    "scipy",
    "numba",
    "rslab",
    "pydantic",
    "pydicom",
    "pylibjpeg-openjpeg",
    "pyjpegls",
    "pillow",
    "opencv-python-headless",
    "scikit-image",
    "matplotlib",
)
EXTRAS = {
    "python-gdcm": "JPEG Lossless radiographs (extra [dicom])",
}


def show(table: Table) -> None:
    """Print a table as wide as it needs where the output is no terminal."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=160)
    console.print(table)


def show_json(data: Any) -> None:
    """Print JSON; nothing that is not finite passes."""
    print(json.dumps(data, indent=1, allow_nan=False))


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold")
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i == 0 else "right")
    return table


def _number(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def repeatability_table(found: Repeatability) -> Table:
    """Within-subject scatter of each ratio, found and expected."""
    columns = ("ratio", "within-subject sd of log", "95 %", "expected", "smallest detectable change", "expected", "p")
    table = _table("Repeatability", *columns)
    for name, one in found.scatter.items():
        ends = f"{one.low:.3f} to {one.high:.3f}"
        factors = (f"× {one.detectable_factor:.3g}", f"× {one.expected_factor:.3g}")
        table.add_row(
            escape(name), f"{one.within_sd_log:.3f}", ends, f"{one.expected_sd_log:.3f}", *factors, f"{one.p_value:.2g}"
        )
    return table


def estimate_table(estimate: Estimate) -> Table:
    """Stiffness in plain units with intervals, and the ratios that it comes from."""
    table = _table(f"Estimate: {badge(estimate)}", "stiffness", "value", "95 % interval", "", "at bound")
    for key, title in PLAIN.items():
        found = estimate.plain[key]
        span = "" if found.low is None and found.high is None else f"{interval(found)} {found.unit}"
        table.add_row(title, f"{estimated(found)} {found.unit}", span, "", "")
    table.add_section()
    for name in estimate.parameters:
        ratio = estimate.ratios[name]
        at_bound = "yes" if ratio.at_bound else "no"
        known = ratio.determined if has_intervals(estimate) else NO_INTERVALS
        table.add_row(f"ratio: {escape(name)}", estimated(ratio), interval(ratio), known, at_bound)
    return table


def assessment_table(frames: Sequence[HeldOutFrame]) -> Table:
    """RMSE of every held-out frame by predictor, and the change of the Cobb angle (tilt form)."""
    names = ("rest", "default", "fit", "forecast", "fitted_supports", "extrapolation", "single_ratio", "truth")
    table = _table(
        "Held-out frames: corner RMSE, mm, and change of tilt, degrees",
        "frame",
        "force N",
        *names,
        "measured",
        "fitted",
    )
    for frame in frames:
        changes = [frame.cobb_change_deg.get(key) for key in ("measured", "fit")]
        table.add_row(
            escape(f"{frame.push} {frame.frame}"),
            f"{frame.force_n:.0f}",
            *[_number(frame.rmse_mm[name]) for name in names],
            *[_number(None if change is None else change.tilt, 1) for change in changes],
        )
    return table


def frames_table(frames: Sequence[FrameProposal]) -> Table:
    """Every frame's quality and support motion, its role in ``subject.json`` and the proposed one."""
    table = _table(
        "Frames: quality, motion of supports since the first frame, roles",
        "push", "frame", "force N", "sharpness", "contrast/noise", "vertebrae", "tracking mm",
        "pelvis", "shoulder", "role", "proposed",
    )  # fmt: skip
    for frame in frames:
        table.add_row(
            escape(f"{frame.push} ({frame.side}, rib {frame.level:g})"),
            str(frame.frame),
            f"{frame.force_n:.0f}",
            _number(frame.sharpness),
            _number(frame.contrast_to_noise, 1),
            str(frame.vertebrae),
            _number(frame.tracking_mm),
            *[_motion(frame.supports.get(name)) for name in ("pelvis", "shoulder")],
            frame.role,
            frame.proposed,
        )
    return table


def _motion(support: Mapping[Any, float | None] | None) -> str:
    if support is None:
        return "not seen"
    turn = support["degrees"]
    return _number(support["mm"], 1) + " mm" + ("" if turn is None else f", {turn:+.1f}°")


def cobb_table(rows: Sequence[tuple[str, str, str, str, str]]) -> Table:
    """Rows of image, Cobb angle with levels, and the three forms of its change."""
    table = _table(
        "Cobb angles, ± half of the 95 % interval; changes above 0: convex to the left",
        "image", "angle", "change: signed", "fixed levels", "tilt",
    )  # fmt: skip
    for row in rows:
        table.add_row(*[escape(cell) for cell in row])
    return table


def paper_table(found: PaperTable) -> Table:
    """A table of the paper, ours beside the paper's lines."""
    table = _table(f"Table {found.number}: {found.title}", "", "", *found.columns, "average")
    last = ""
    for line in found.lines:
        table.add_row("" if line.label == last else line.label, line.whose, *line.cells, line.average)
        last = line.label
    return table


def goals_table(found: Sequence[Goal], title: str) -> Table:
    """What a study is judged by."""
    table = _table(title, "goal", "wanted", "found", "")
    for goal in found:
        table.add_row(goal.name, goal.wanted, goal.found, "" if goal.met is None else "met" if goal.met else "NOT MET")
    return table


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

    table = _table(summary(results), "check", "kind", "error", "tolerance", "")
    for r in results:
        verdict = "passed" if r.passed else "[bold red]FAILED[/bold red]"
        table.add_row(escape(r.name), r.kind, f"{r.error:.1e}", f"{r.tolerance:.0e}", verdict)
    return table


def doctor_table() -> Table:
    """Versions of what is installed, the sparse solver in use and missing extras."""
    from spinestiff import __version__
    from spinestiff.anatomy.template import template_torso
    from spinestiff.mechanics.factor import default_backend
    from spinestiff.parallel import threads

    table = _table("spinestiff doctor", "what", "found")
    table.add_row("spinestiff", __version__)
    table.add_row("Python", f"{sys.version.split()[0]} on {platform.platform()}")
    for name in LIBRARIES:
        table.add_row(name, _installed(name) or "MISSING: pip install it")
    table.add_row("sparse solver in use", default_backend())
    table.add_row("threads", str(threads()))
    for name, use in EXTRAS.items():
        table.add_row(f"{name} (optional)", _installed(name) or f"not installed; needed for {escape(use)}")
    for mesh in ("coarse", "fine"):
        torso = template_torso(157.0, mesh)
        table.add_row(
            f"template mesh '{mesh}'", f"{len(torso.tissue.rest_positions)} nodes, {len(torso.joints)} joints"
        )
    return table


def _installed(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None
