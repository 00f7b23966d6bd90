"""A plan of further pushes as a sheet for the radiology department, to be printed."""

from __future__ import annotations

from spinestiff import __version__
from spinestiff.study.report.viewer.page import page_environment
from spinestiff.study.wording.plan import NONE_PAYS, plan_lines, radiographs_of
from spinestiff.subject.plan_outcome import Plan
from spinestiff.words import counted


def protocol_page(plan: Plan, subject: str) -> str:
    """The sequence as far as it pays; each push has its unloaded radiographs first, and its forces grow."""
    found = radiographs_of(plan)
    rows = [{"side": side, "rib": f"{rib:g}", "force": f"{force:g}", "view": view} for side, rib, force, view in found]
    page = {
        "subject": subject,
        "limit": f"{plan.limit_n:g}",
        "exposures": counted(len(rows), "radiograph"),
        "pushes": counted(len({(side, rib) for side, rib, *_ in found}), "push", "pushes"),
        "aside": any(row["view"] == "lateral" for row in rows),
        "rows": [{"number": i + 1, **row} for i, row in enumerate(rows)],
        "tape": plan.taped is not None,
        "lines": [line for line in plan_lines(plan) if not line.startswith("note:")],
        "nothing": NONE_PAYS.capitalize(),
        "version": __version__,
    }
    return page_environment().get_template("protocol.html.j2").render(page)
