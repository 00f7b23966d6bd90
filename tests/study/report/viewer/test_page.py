"""The viewer's page: one file, one script that the policy names, and nothing from a subject that acts in it."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest

from built import assert_built_from_its_sources
from spinestiff.anatomy.template import template_torso
from spinestiff.mechanics.supports import SupportKind
from spinestiff.study.report.viewer import page
from spinestiff.study.report.viewer.page import component, script_hash, source_hash, view_page
from spinestiff.study.report.viewer.scene import Scene, visit_scene

ROOT = Path(__file__).parents[4]
BUILT = Path(page.__file__).with_name("viewer.js")
HOSTILE = "</script><script>window.hostile = 1</script><img src=x onerror='window.hostile = 1'>\"' &amp; \u2028"


class Elements(HTMLParser):
    """A page's tags, attributes, and the text of its scripts and styles."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.scripts: list[str] = []
        self.styles: list[str] = []
        self.words = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.attributes += [(tag, name, value or "") for name, value in attributes]
        if tag == "script":
            self.scripts.append("")
        if tag == "style":
            self.styles.append("")

    def handle_data(self, data):
        if self.tags and self.tags[-1] == "script" and self.cdata_elem:
            self.scripts[-1] += data
        elif self.tags and self.tags[-1] == "style" and self.cdata_elem:
            self.styles[-1] += data
        else:
            self.words += data

    def all(self, tag, name):
        return [value for t, n, value in self.attributes if (t, n) == (tag, name)]


@pytest.fixture(scope="module")
def html(viewed):
    return view_page(viewed.scene)


def test_the_policy_allows_this_script_and_style_and_nothing_else(html):
    found = Elements(html)
    assert found.tags.count("script") == 2 and found.tags.count("style") == 1
    assert found.all("script", "type") == ["application/json"]
    policy = found.all("meta", "content")[0]
    assert policy == (
        f"default-src 'none'; script-src {source_hash(found.scripts[1])}; style-src {source_hash(found.styles[0])}; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )
    assert source_hash(found.scripts[1]) == script_hash()
    # Styles in attributes and handlers would be refused by it.
    assert not [name for _, name, _ in found.attributes if name == "style" or name.startswith("on")]


def test_nothing_is_asked_of_another_host(html):
    without = html.replace(Elements(html).scripts[1], "")
    assert not re.search(r"https?://|@import|url\(|javascript:", without, re.IGNORECASE)
    assert Elements(html).all("link", "href") == ["data:,"]


def test_the_page_is_small(html, viewed):
    # 25,000 triangles of bone once, and each state's poses and skin.
    assert len(html.encode()) < 1_500_000
    scene = len(component(viewed.scene).data)
    assert scene < 600_000


def test_every_control_has_a_name(html):
    found = Elements(html)
    labels = set(found.all("label", "for"))
    ids = found.all("input", "id")
    assert set(ids) <= labels and ids
    assert found.tags.count("label") >= found.tags.count("input")
    assert found.tags.count("fieldset") == found.tags.count("legend") == 2
    assert len([words for words in found.all("canvas", "aria-label") if len(words) > 40]) == 1
    assert found.all("canvas", "tabindex") == ["0"]


def test_numbers_stand_in_the_text_without_a_script(html, viewed):
    words = " ".join(Elements(html).words.split())
    main = viewed.scene.pushes[0]
    full = main.frames[-1]
    assert f"{full.rmse_mm['fit']:.1f}" in words and "held out" in words
    shoulder = next(i for i, s in enumerate(main.supports) if s.kind is SupportKind.SHOULDER)
    force = main.models["fit"][-1].reactions[shoulder, 0]
    assert f"{abs(force):.1f} to the {'left' if force > 0 else 'right'}" in words


def test_texts_from_files_are_harmless(viewed):
    scene = replace(
        viewed.scene,
        title=HOSTILE,
        note=HOSTILE,
        pushes=tuple(
            replace(p, push=HOSTILE + p.push, frames=tuple(replace(f, role=HOSTILE) for f in p.frames))
            for p in viewed.scene.pushes
        ),
    )
    found = Elements(view_page(scene))
    assert found.tags.count("script") == 2 and "img" not in found.tags
    assert not [name for _, name, _ in found.attributes if name.startswith("on")]
    record = json.loads(found.scripts[0])
    assert record["title"] == HOSTILE and record["pushes"][0]["id"] == HOSTILE + "main"
    assert not re.search(r"[<>&\u2028]", found.scripts[0])


def test_the_legend_names_what_there_is_to_see(beside):
    scene = visit_scene("seen from all sides", beside, {"main": ("left", 8.0)})

    def told(**gone):
        frames = tuple(replace(frame, beside=replace(frame.beside, **gone)) for frame in scene.pushes[0].frames)
        shown = replace(scene, pushes=(replace(scene.pushes[0], frames=frames),))
        return " ".join(Elements(view_page(shown)).words.split())

    for kind in ("Measured", "Simulated"):
        assert f"{kind} vertebrae, pedicles, markers" in told()
        assert f"{kind} vertebrae, pedicles, markers" in told(pedicles={})  # from the side they are seen all the same
        assert f"{kind} vertebrae, markers" in told(pedicles={}, outlines={})
        assert f"{kind} vertebrae, pedicles " in told(markers={})
    assert "rings as simulated" in told() and "rings as simulated" not in told(pedicles={}, outlines={})


def test_a_torso_alone_has_no_slider():
    found = Elements(view_page(Scene("template", template_torso(140.0), note="nothing yet")))
    assert "range" not in found.all("input", "type") and "table" not in found.tags
    assert "tube" not in found.all("button", "data-view")
    assert "nothing yet" in found.words


# The built script


def test_the_built_script_belongs_to_its_sources():
    """Whoever changes web/viewer or web/shared builds it (CONTRIBUTING.md)."""
    assert_built_from_its_sources("viewer", BUILT.read_text(encoding="utf-8"))


def test_the_built_script_asks_for_nothing():
    text = BUILT.read_text(encoding="utf-8")
    # The one address is a name: that of XHTML's elements.
    assert set(re.findall(r"https?://[^\s\"'`]+", text)) == {"http://www.w3.org/1999/xhtml"}
    calls = r"\bfetch\(|XMLHttpRequest|WebSocket|EventSource|sendBeacon|\bWorker\(|importScripts|\beval\(|new Function"
    assert not re.search(calls, text)
    assert not re.search(r"</script|<!--", text, re.IGNORECASE)
    assert len(text.encode()) < 800_000


def test_three_js_keeps_its_licence():
    text, notice = BUILT.read_text(encoding="utf-8"), (ROOT / "NOTICE").read_text(encoding="utf-8")
    for part in (
        "three.js authors",
        "Permission is hereby granted, free of charge",
        'THE SOFTWARE IS PROVIDED "AS IS"',
    ):
        assert part in text and part in notice
