"""The workbench in a headless Chromium: what was found, its report, two subjects side by side."""

from __future__ import annotations

import shutil
import sys

import pytest

from bench_page import go, load, text
from chromium import browser

pytestmark = pytest.mark.skipif(
    browser() is None or sys.platform == "win32", reason="no Chromium to open the page in, or no pipe to drive it by"
)


def test_a_report_in_its_frame_and_two_subjects_side_by_side(tab, finished, serve, tmp_path):
    root = tmp_path / "root"
    for name in ("girl", "sister"):
        shutil.copytree(finished.folder, root / name)
    with serve(root) as served:
        key = served.key("girl")
        load(tab, served.address)
        go(tab, f"/subject/{key}/results")
        assert "What was found" in text(tab) and "N m/rad" in text(tab)
        shown = tab.run("document.querySelector('iframe').getAttribute('src')")
        assert shown.endswith("/report.html")
        assert tab.run("document.title") == "spinestiff workbench"

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
