"""The page as it is shipped: built from its sources, nothing inline, nothing of another host."""

from __future__ import annotations

import re
from importlib.resources import files

from built import WEB, assert_built_from_its_sources, style_sheet

PAGE = files("spinestiff.annotate") / "page"


def shipped(name):
    return (PAGE / name).read_text(encoding="utf-8")


def test_the_built_page_belongs_to_its_sources():
    """Whoever changes web/annotate or web/shared builds it (CONTRIBUTING.md)."""
    assert_built_from_its_sources("annotate", shipped("annotate.js"))
    assert shipped("index.html") == (WEB / "annotate/index.html").read_text(encoding="utf-8")
    assert shipped("annotate.css") == style_sheet("annotate")


def test_nothing_is_inline_and_nothing_of_another_host():
    html = shipped("index.html")
    assert re.findall(r"<script[^>]*>", html) == ['<script src="annotate.js" defer>']
    assert not re.search(r"<style|\sstyle=|\son\w+=|javascript:", html)
    for name in ("index.html", "annotate.js", "annotate.css"):
        assert not re.search(
            r"https?://|@import|url\(|\beval\(|new Function|innerHTML|document\.write", shipped(name)
        ), name
