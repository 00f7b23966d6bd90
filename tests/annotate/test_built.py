"""The page as it is shipped: built from its sources, nothing inline, nothing of another host."""

from __future__ import annotations

import hashlib
import re
from importlib.resources import files
from pathlib import Path

SOURCES = Path(__file__).parents[2] / "web" / "annotate"
PAGE = files("spinestiff.annotate") / "page"


def shipped(name):
    return (PAGE / name).read_text(encoding="utf-8")


def test_the_built_page_belongs_to_its_sources():
    """Whoever changes web/annotate builds it (CONTRIBUTING.md); the hash is that of web/annotate/vite.config.ts."""
    names = ["index.html", "package.json", "package-lock.json", "tsconfig.json", "vite.config.ts"]
    names += [f"{folder}/{path.name}" for folder in ("src", "../shared") for path in (SOURCES / folder).iterdir()]
    digest = hashlib.sha256()
    for name in sorted(names):
        digest.update(f"{name}\n".encode() + (SOURCES / name).read_bytes().replace(b"\r\n", b"\n"))
    assert len(names) > 10
    (recorded,) = re.findall(r"^sources sha256 ([0-9a-f]{64})$", shipped("annotate.js"), re.MULTILINE)
    assert recorded == digest.hexdigest(), "run npm ci && npm run build in web/annotate"
    assert shipped("index.html") == (SOURCES / "index.html").read_text(encoding="utf-8")
    assert shipped("annotate.css") == (SOURCES / "src" / "annotate.css").read_text(encoding="utf-8")


def test_nothing_is_inline_and_nothing_of_another_host():
    html = shipped("index.html")
    assert re.findall(r"<script[^>]*>", html) == ['<script src="annotate.js" defer>']
    assert not re.search(r"<style|\sstyle=|\son\w+=|javascript:", html)
    for name in ("index.html", "annotate.js", "annotate.css"):
        assert not re.search(
            r"https?://|@import|url\(|\beval\(|new Function|innerHTML|document\.write", shipped(name)
        ), name
