"""A plan of further pushes as a sheet for the radiology department, to be printed."""

from __future__ import annotations

from spinestiff import __version__
from spinestiff.study.plan_words import NONE_PAYS, pays, plan_lines
from spinestiff.study.report.viewer.page import page_environment
from spinestiff.subject.plan_outcome import Plan
from spinestiff.words import counted


def protocol_page(plan: Plan, subject: str) -> str:
    """The sequence as far as it pays; each push has its unloaded radiograph first, and its forces grow."""
    pushes: dict[tuple[str, float], list[float]] = {}
    for step in pays(plan):
        pushes.setdefault((step.push.side, step.push.level), []).append(step.push.force_n)
    rows = [
        {"side": side, "rib": f"{rib:g}", "force": f"{force:g}"}
        for (side, rib), forces in pushes.items()
        for force in (0.0, *sorted(forces))
    ]
    page = {
        "subject": subject,
        "limit": f"{plan.limit_n:g}",
        "exposures": counted(len(rows), "radiograph"),
        "pushes": counted(len(pushes), "push", "pushes"),
        "rows": [{"number": i + 1, **row} for i, row in enumerate(rows)],
        "tape": plan.taped is not None,
        "lines": [line for line in plan_lines(plan) if not line.startswith("note:")],
        "nothing": NONE_PAYS.capitalize(),
        "version": __version__,
    }
    return page_environment().get_template("protocol.html.j2").render(page)
