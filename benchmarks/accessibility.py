"""What axe-core finds wrong with the workbench's rooms, the annotation page, the report and the 3D viewer.

axe-core (Deque Systems, from npm: ``npm ci`` in ``web/workbench``) checks each page in a headless Chromium against its
rules, WCAG 2.2 A and AA among them, in light and dark and, narrow, as on a telephone. ``SUBJECT`` is a subject folder
whose steps have run, as ``spinestiff demo`` leaves it; it is copied.

    python benchmarks/accessibility.py SUBJECT [--write] [--axe FILE]
    python benchmarks/accessibility.py --json
"""

from __future__ import annotations

import argparse
import datetime
import json
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from workbench_way import served

from bench_page import go, load
from chromium import WEBGL, Tab

RESULTS = Path(__file__).parent / "results" / "accessibility.json"
AXE = Path(__file__).parents[1] / "web" / "workbench" / "node_modules" / "axe-core" / "axe.min.js"
THEMES, WIDE, NARROW = ("light", "dark"), (1280, 800), (400, 800)
SERIOUS = ("serious", "critical")
ROOMS = ("/", "/new", "/compare", "/table", "/trash")
STEPS = ("radiographs", "values", "run", "results")


def pages(tab: Tab, root: Path, subject: Path) -> Iterator[tuple[str, Callable[[], None]]]:
    """Each page by name, and what opens it."""
    for name in ("first", "second"):
        shutil.copytree(subject, root / name)
    with served(root) as client:
        load(tab, client.address)
        key = client.key("first")
        for place in (*ROOMS, *(f"/subject/{key}/{step}" for step in STEPS)):
            yield f"workbench {place.replace(key, 'KEY')}", lambda place=place: go(tab, place)  # type: ignore[misc]
        origin = client.address.partition("/?")[0].partition("#")[0].rstrip("/")
        yield "annotation page", lambda: opened(tab, f"{origin}/annotate/{key}/")
    for name, file in (("report", "report.html"), ("viewer", "view.html")):
        yield name, lambda file=file: tab.open(subject / "results" / file)  # type: ignore[misc]


def opened(tab: Tab, address: str) -> None:
    """Go to an address and wait until it has loaded."""
    tab.loaded = False
    tab.call("Page.navigate", url=address)
    tab.wait(lambda: tab.loaded)
    tab.settle()


def checked(tab: Tab, axe: str) -> dict[str, Any]:
    """What axe-core says of the page that is open."""
    if not tab.run("typeof axe == 'object' && !!axe.run"):
        tab.run(axe + "; 1")
    kept = "({id: one.id, impact: one.impact, help: one.help, places: one.nodes.map(node => node.target.join(' '))})"
    return dict(
        tab.run(
            "axe.run(document, {iframes: false}).then(found => ({"
            f"violations: found.violations.map(one => {kept}), passed: found.passes.length, "
            "undecided: found.incomplete.map(one => one.id)}))"
        )
    )


def measured(subject: Path, axe: Path) -> dict[str, Any]:
    """Every page in every theme and width."""
    source, rows = axe.read_text(encoding="utf-8"), []
    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as place,
        Tab(Path(place) / "profile", flags=WEBGL) as tab,
    ):
        for name, enter in pages(tab, Path(place) / "root", subject):
            enter()
            for theme in THEMES:
                for width, height in (WIDE, NARROW):
                    tab.theme(theme)
                    tab.size(width, height)
                    tab.settle()
                    rows.append({"page": name, "theme": theme, "width": width, **checked(tab, source)})
            print(name, [len(row["violations"]) for row in rows if row["page"] == name], flush=True)
        version = tab.run("axe.version")
    serious = [row for row in rows if any(one["impact"] in SERIOUS for one in row["violations"])]
    return {
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "axe_core": version,
        "checks": len(rows),
        "checks_with_serious_violations": len(serious),
        "checks_with_any_violation": sum(bool(row["violations"]) for row in rows),
        "rows": rows,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("subject", type=Path, nargs="?")
    parser.add_argument("--axe", type=Path, default=AXE)
    parser.add_argument("--write", action="store_true", help="store what is found in benchmarks/results/")
    parser.add_argument("--json", action="store_true", help="print what is stored")
    asked = parser.parse_args()
    if asked.json:
        print(RESULTS.read_text(encoding="utf-8") if RESULTS.is_file() else "{}")
        return
    if asked.subject is None or not asked.axe.is_file():
        parser.error("wanted a subject folder, and axe-core (npm ci in web/workbench, or --axe FILE)")
    for name in ("report.html", "view.html"):
        if not (asked.subject / "results" / name).is_file():
            parser.error(f"{asked.subject}: no results/{name}; wanted a subject whose steps have run (spinestiff run)")
    found = measured(asked.subject, asked.axe)
    print(json.dumps(found if not asked.write else {k: v for k, v in found.items() if k != "rows"}, indent=1))
    if asked.write:
        RESULTS.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
