"""The workbench in a headless Chromium: a run that ends, its report, the next push, two subjects side by side."""

from __future__ import annotations

import json
import shutil
import sys

import pytest

from bench_page import chosen, click, fill, go, load, text
from chromium import browser
from spinestiff.files import read_json

pytestmark = pytest.mark.skipif(
    browser() is None or sys.platform == "win32", reason="no Chromium to open the page in, or no pipe to drive it by"
)


def to_its_end(tab, button, most_s):
    """Start a job and wait until it has ended well."""
    click(tab, button)
    tab.until("document.querySelector('.live')?.dataset.state == 'running'", 30)
    tab.until("!['running', 'waiting'].includes(document.querySelector('.live').dataset.state)", most_s)
    assert tab.run("document.querySelector('.live').dataset.state") == "done", text(tab)


@pytest.mark.slow
def test_from_a_run_to_its_report_and_the_next_push(tab, finished, serve, tmp_path):
    """A force is corrected, so that the estimate and all that follows is made again; what was tracked stays."""
    root = tmp_path / "root"
    for name in ("girl", "sister"):
        shutil.copytree(finished.folder, root / name)
    record = read_json(root / "girl" / "subject.json")
    record["pushes"][0]["forces_n"][1] += 0.1
    (root / "girl" / "subject.json").write_text(json.dumps(record), encoding="utf-8")
    before = read_json(root / "girl" / "results" / "estimate.json")["ratios"]
    with serve(root, jobs=True) as served:
        key = served.key("girl")
        load(tab, served.address)
        go(tab, f"/subject/{key}/run")
        chosen(tab, "#o-run-mesh", "coarse")
        to_its_end(tab, "#start-run", 240.0)
        after = read_json(root / "girl" / "results" / "estimate.json")["ratios"]
        assert after != before

        go(tab, f"/subject/{key}/results")
        assert "What was found" in text(tab) and "N m/rad" in text(tab)
        shown = tab.run("document.querySelector('iframe').getAttribute('src')")
        assert shown.endswith("/report.html")
        page = tab.run(f"fetch('{shown}').then(answer => answer.text())")
        assert "Stiffness of spine and trunk" in page and "<title>Stiffness report</title>" in page
        assert tab.run("document.title") == "spinestiff workbench"

        go(tab, f"/subject/{key}/run")
        fill(tab, "#o-plan-exposures", "2")
        to_its_end(tab, "#start-plan", 240.0)
        go(tab, f"/subject/{key}/results")
        click(tab, "[role=tab][data-name='']")
        assert "Which push next" in text(tab) and "out of date" not in text(tab, ".shown")
        # The plan's job has written the report anew.
        report = (root / "girl" / "results" / "report.html").read_text(encoding="utf-8").lower()
        assert "no further push was planned" not in report
        assert "push rib " in report or "no further radiograph pays" in report
        tab.until("[...document.querySelectorAll('.shown img')].every(one => one.complete && one.naturalWidth > 100)")
        assert tab.run("document.querySelectorAll('.shown img').length") >= 1

        go(tab, "/table")
        rows = tab.run("[...document.querySelectorAll('tbody tr')].map(row => row.innerText)")
        assert len(rows) == 2 and all(" to " in row for row in rows)
        go(tab, "/compare")
        tab.until("document.querySelectorAll('.pair iframe').length == 2")
        assert {tab.run(f"document.querySelector('#{one}').value") for one in ("first", "second")} == {
            key,
            served.key("sister"),
        }
        assert tab.complaints == []
        assert all(url.startswith(("http://127.0.0.1:", "data:", "about:")) for url in tab.requests)
