"""The page as it is shipped: built from its sources, nothing inline, nothing of another host."""

from __future__ import annotations

import re
from importlib.resources import files

from built import WEB, assert_built_from_its_sources, style_sheet

PAGE = files("spinestiff.workbench") / "page"


def shipped(name):
    return (PAGE / name).read_text(encoding="utf-8")


def test_the_built_page_belongs_to_its_sources():
    """Whoever changes web/workbench or web/shared builds it (CONTRIBUTING.md)."""
    assert_built_from_its_sources("workbench", shipped("workbench.js"))
    assert shipped("index.html") == (WEB / "workbench/index.html").read_text(encoding="utf-8")
    assert shipped("workbench.css") == style_sheet("workbench")


def test_nothing_is_inline_and_nothing_of_another_host():
    html = shipped("index.html")
    assert re.findall(r"<script[^>]*>", html) == ['<script src="/workbench.js" defer>']
    assert not re.search(r"<style|\sstyle=|\son\w+=|javascript:", html)
    for name in ("index.html", "workbench.js", "workbench.css"):
        text = shipped(name).replace("http://www.w3.org/2000/svg", "")
        assert not re.search(r"https?://|@import|url\(|\beval\(|new Function|innerHTML|document\.write", text), name
