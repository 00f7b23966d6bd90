"""The page as it is shipped: built from its sources, nothing inline, nothing of another host."""

from __future__ import annotations

import hashlib
import re
from importlib.resources import files
from pathlib import Path

SOURCES = Path(__file__).parents[2] / "web" / "workbench"
PAGE = files("spinestiff.workbench") / "page"


def shipped(name):
    return (PAGE / name).read_text(encoding="utf-8")


def test_the_built_page_belongs_to_its_sources():
    """Whoever changes web/workbench or web/shared builds it; the hash is that of web/workbench/vite.config.ts."""
    names = ["index.html", "package.json", "package-lock.json", "tsconfig.json", "vite.config.ts"]
    names += [f"{folder}/{path.name}" for folder in ("src", "../shared") for path in (SOURCES / folder).iterdir()]
    digest = hashlib.sha256()
    for name in sorted(names):
        digest.update(f"{name}\n".encode() + (SOURCES / name).read_bytes().replace(b"\r\n", b"\n"))
    assert len(names) > 20
    (recorded,) = re.findall(r"^sources sha256 ([0-9a-f]{64})$", shipped("workbench.js"), re.MULTILINE)
    assert recorded == digest.hexdigest(), "run npm ci && npm run build in web/workbench"
    assert shipped("index.html") == (SOURCES / "index.html").read_text(encoding="utf-8")
    styles = [SOURCES / "../shared/base.css", SOURCES / "src/workbench.css"]
    assert shipped("workbench.css") == "".join(path.read_text(encoding="utf-8") for path in styles)


def test_nothing_is_inline_and_nothing_of_another_host():
    html = shipped("index.html")
    assert re.findall(r"<script[^>]*>", html) == ['<script src="/workbench.js" defer>']
    assert not re.search(r"<style|\sstyle=|\son\w+=|javascript:", html)
    for name in ("index.html", "workbench.js", "workbench.css"):
        text = shipped(name).replace("http://www.w3.org/2000/svg", "")
        assert not re.search(r"https?://|@import|url\(|\beval\(|new Function|innerHTML|document\.write", text), name


def test_colours_are_those_of_the_annotation_page():
    colours = re.compile(r"^:root.*?}$", re.MULTILINE | re.DOTALL)
    annotate = SOURCES.parent / "annotate" / "src" / "annotate.css"
    found = colours.findall(shipped("workbench.css"))
    assert len(found) == 2 and found == colours.findall(annotate.read_text(encoding="utf-8"))
