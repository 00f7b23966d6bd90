"""The workbench in a headless Chromium at 200 % zoom and by finger on a tablet, upright and across."""

from __future__ import annotations

import shutil
import sys

import numpy as np
import pytest

from annotation_hands import Hands
from bench_page import chosen, click, files, fill, go, load, text
from chromium import browser
from fingers import pinch, screen, tap, tap_at, touch
from hospital import export
from reachable import covered, cut, sideways, small
from spinestiff.files import read_json
from spinestiff.subject.folder import read_annotation
from unannotated import drawn

pytestmark = pytest.mark.skipif(
    browser() is None or sys.platform == "win32", reason="no Chromium to open the page in, or no pipe to drive it by"
)
ZOOMED, UPRIGHT, ACROSS = (640, 512, 2), (768, 1024, 1), (1024, 768, 1)
"""A window of 1280 x 1024 pixels at 200 %, and a tablet; width, height and screen pixels to each of them."""
OPENED = "(document.querySelectorAll('details').forEach(one => { one.open = true; }), 1)"
POINTED = """(() => {
  window.mice = [];
  for (const kind of ['pointerdown', 'pointermove', 'pointerup'])
    addEventListener(kind, event => { if (event.pointerType != 'touch') mice.push(kind); }, true);
})()"""


@pytest.fixture
def full(root, finished):
    """Somebody who is not annotated yet, somebody whose steps have run, in two visits, and one to be removed."""
    for name in ("first", "second"):
        shutil.copytree(finished.folder, root / name)
    return root


def annotation(tab, served, name, image):
    """Open the annotation page of a subject at one of its radiographs."""
    tab.loaded = False
    tab.call("Page.navigate", url=f"{served.address.partition('/#')[0]}/annotate/{served.key(name)}/")
    tab.wait(lambda: tab.loaded)
    tab.until("document.body.dataset.state == 'open'", 60)
    tab.run(f"annotation.open('{image}')")
    tab.until("annotation.loaded == annotation.key")
    tab.settle()


def rooms(tab, served, disc):
    """Every room by its name, when it is open, with all that can be opened in it."""
    done, fresh = served.key("first"), served.key("girl")
    steps = ("radiographs", "values", "run", "results")
    for place in ("/", *(f"/subject/{key}/{step}" for key in (done, fresh) for step in steps), "/compare", "/table"):
        go(tab, place)
        tab.run(OPENED)
        yield place.replace(done, "first").replace(fresh, "girl")
    go(tab, f"/subject/{done}/run")
    click(tab, "#start-run")
    tab.until("!!document.querySelector('.live')")
    yield "a job"
    click(tab, "#cancel")
    tab.until("document.querySelector('.live').dataset.state == 'cancelled'")
    go(tab, "/new")
    files(tab, "#files", sorted(disc.iterdir()))
    tab.until("!!document.querySelector('#study')", 60)
    yield "several studies"
    chosen(tab, "#study", "A2")
    tab.until("!!document.querySelector('#make')", 60)
    tab.run(OPENED)
    yield "/new"
    go(tab, "/")
    click(tab, "[aria-label='Remove second']")
    tab.until("!document.querySelector(\"[aria-label='Remove second']\")")
    yield "/ with undo"
    go(tab, "/trash")
    yield "/trash"
    for name, image in (("first", "rest/frontal"), ("first", "push/main"), ("girl", "rest/lateral")):
        annotation(tab, served, name, image)
        tab.run(OPENED)
        yield f"annotation of {name}, {image}"


def studies(folder):
    """An export of two studies, the later one of pictures that may be marked."""
    export(folder / "a", study="1.2.1", AcquisitionDate="20240501", StudyDescription="Whole spine, before treatment")
    export(folder / "b", "lateral", study="1.2.1", time="101400", AcquisitionDate="20240501")
    for name, time in (("c", "103000"), ("d", "103200")):
        export(folder / name, study="1.2.2", time=time, AcquisitionDate="20250612")
    (folder / "README.TXT").write_text("no radiograph", encoding="utf-8")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("window", [ZOOMED, UPRIGHT, ACROSS], ids=["200 %", "upright", "across"])
def test_every_room_shows_all_it_has(tab, full, serve, tmp_path, window):
    """Nothing to be scrolled sideways to, nothing over a control, no words cut, no target too small for a finger."""
    disc, finger, wrong = studies(tmp_path / "disc"), window != ZOOMED, {}
    with serve(full) as served, screen(tab, *window, finger=finger):
        load(tab, served.address)
        assert tab.run("matchMedia('(pointer: coarse)').matches") is finger
        for room in rooms(tab, served, disc):
            found = {"sideways": max(0, sideways(tab)), "covered": covered(tab), "cut": cut(tab)}
            found["small"] = small(tab) if finger else []
            wrong |= {f"{room}, {what}": those for what, those in found.items() if those}
    assert wrong == {}


def show(tab, image):
    """Tap a radiograph of the list."""
    tap(tab, f"#images li:nth-child({image}) button")
    tab.until(f"annotation.image == annotation.session.images[{image - 1}] && annotation.loaded == annotation.key")
    tab.settle()


@pytest.mark.slow
@pytest.mark.parametrize("window", [UPRIGHT, ACROSS], ids=["upright", "across"])
def test_a_radiograph_is_annotated_by_finger(tab, full, serve, window):
    """From the start page: points, a proposal, a look at each, a corner dragged, zoom, frames of a push, and back."""
    with serve(full) as served, screen(tab, *window, finger=True):
        load(tab, served.address)
        tap(tab, "#room a[href^='/annotate/']")
        tab.until("!!window.annotation && document.body.dataset.state == 'open'")
        tab.run(POINTED)
        hands = Hands(tab)
        # Tools, frames and the whole picture are in sight at once, one below the other.
        show(tab, 3)
        tab.run("(scrollTo(0, 0), 1)")
        boxes = tab.run("['.work > .bar', '#frames', '.stage'].map(one => document.querySelector(one)."
                        "getBoundingClientRect()).map(box => [box.top, box.bottom])")  # fmt: skip
        (_, tools), (above, frames), (top, bottom) = boxes
        assert tools <= above and frames <= top and bottom <= window[1] and bottom - top > 350
        tops = tab.run("[...document.querySelectorAll('[role=toolbar] button')].map(one => one.offsetTop)")
        assert len(set(tops)) == 1
        for button, frame in (("#frame-on", 1), ("#frame-on", 2), ("#frame-back", 1)):
            tap(tab, button)
            tab.until(f"annotation.frame == {frame} && annotation.loaded == annotation.key")

        show(tab, 1)
        tap(tab, "[data-tool=spine]")
        for pixel in drawn("rest/frontal").clicks("T1", "T5", "T9", "L1", "L5"):
            tap_at(tab, hands.place(pixel))
        assert len(hands.marks()["spine"]) == 5
        tap(tab, "#propose")
        tab.until("!annotation.busy && Object.keys(annotation.marks.vertebrae).length == 17")
        for left in range(16, -1, -1):
            tap(tab, "#look-on")
            assert tab.run("annotation.unseen.length") == left
        tab.run("(document.querySelector('#stage').scrollIntoView({block: 'end'}), 1)")
        tap(tab, "#fit")
        before = hands.quad("T9")
        x, y = hands.place(before[1])
        touch(tab, "Start", (x, y))
        touch(tab, "Move", (x + 6, y))
        touch(tab, "Move", (x + 12, y + 4))
        touch(tab, "End")
        scale = tab.run("annotation.stage.scale")
        np.testing.assert_allclose(hands.quad("T9")[1] - before[1], np.array([12.0, 4.0]) / scale, atol=0.06)
        marks = hands.marks()
        pinch(tab, hands.place(hands.quad("L1").mean(axis=0)), (60.0, 180.0))
        np.testing.assert_allclose(tab.run("annotation.stage.scale") / scale, 3.0, rtol=0.05)
        for button, factor in (("#closer", 1.25), ("#further", 0.8), ("#further", 0.8)):
            was = tab.run("annotation.stage.scale")
            tap(tab, button)
            np.testing.assert_allclose(tab.run("annotation.stage.scale") / was, factor)
        tap(tab, "#fit")
        np.testing.assert_allclose(tab.run("annotation.stage.scale"), scale)
        assert hands.marks() == marks
        hands.saved()
        saved = read_annotation(full / "girl" / "annotation.json").images["rest/frontal"].vertebrae
        np.testing.assert_allclose(saved["T9"], hands.quad("T9"))
        assert tab.run("mice") == []
        tap(tab, "#back")
        tab.until("!!document.querySelector('.card')")


@pytest.mark.slow
@pytest.mark.parametrize("window", [UPRIGHT, ACROSS], ids=["upright", "across"])
def test_the_rooms_by_finger(tab, full, serve, tmp_path, window):
    """Taps lead through every room, make a subject, fill in values, start a run and cancel it, remove the subject."""
    disc = studies(tmp_path / "disc")
    with serve(full) as served, screen(tab, *window, finger=True):
        load(tab, served.address)
        tab.run(POINTED)
        tap(tab, "#rooms a[href='#/new']")
        tab.until("!!document.querySelector('#files')")
        files(tab, "#files", sorted(disc.iterdir()))
        # A list of the system's can't be tapped here.
        tab.until("!!document.querySelector('#study')", 60)
        chosen(tab, "#study", "A2")
        tap(tab, "[aria-label='Mark c']")
        tap(tab, "[aria-label='Mark d']")
        tap(tab, "#join")
        tab.until("document.querySelector('#found tbody').innerText.includes('push 1')", 60)
        tap(tab, "#name")
        tab.call("Input.insertText", text="boy")
        tap(tab, "#make")
        tab.until("!!document.querySelector('#f-age')")
        for field, value in (("#f-age", "14"), ("#f-pushes-0--d21-mm", "400")):
            tap(tab, field)
            tab.call("Input.insertText", text=value)
        tab.until("document.querySelector('.saved').innerText.startsWith('Saved')")
        values = read_json(full / "boy" / "subject.json")
        assert values["age"] == 14 and values["pushes"][0]["d21_mm"] == 400
        tap(tab, ".way a[href$='/run']")
        tap(tab, "#start-run")
        tap(tab, "#cancel")
        tab.until("document.querySelector('.live').dataset.state == 'cancelled'")
        tap(tab, "#room details > summary")
        for room, there in (("compare", ".pair"), ("table", "tbody td"), ("trash", "h1"), ("", ".card")):
            tap(tab, f"#rooms a[href='#/{room}']")
            tab.until(f"document.querySelector('#rooms [aria-current]')?.hash == '#/{room}'")
            tab.until(f"document.body.dataset.state == 'open' && !!document.querySelector('#room {there}')")
        tap(tab, "[aria-label='first'] h2 a")
        tab.until("!!document.querySelector('.tabs')")
        assert "What was found" in text(tab)
        tap(tab, "[role=tab]:last-child")
        tap(tab, "#looked")
        assert tab.run("!document.querySelector('#zip-bare').disabled")
        tap(tab, "#rooms a[href='#/']")
        tap(tab, "[aria-label='Remove boy']")
        tap(tab, "#undo button")
        tab.until("!!document.querySelector(\"[aria-label='Remove boy']\")")
        assert tab.run("mice") == [] and tab.complaints == []


OVERLAPS = """(() => {
  const found = [], picture = document.querySelector('.push .torso'), whole = picture.getBoundingClientRect();
  const words = [...picture.querySelectorAll('text')].map(one => [one.textContent, one.getBoundingClientRect()]);
  const inside = (x, y, box) => x > box.left && x < box.right && y > box.top && y < box.bottom;
  words.forEach(([said, box], i) => {
    if (box.left < whole.left || box.right > whole.right || box.top < whole.top) found.push(`${said}: outside`);
    for (const [other, its] of words.slice(i + 1))
      if (box.left < its.right && its.left < box.right && box.top < its.bottom && its.top < box.bottom)
        found.push(`${said}: ${other}`);
    for (const shape of picture.querySelectorAll('path, rect')) {
      const to = shape.getScreenCTM(), its = shape.getBoundingClientRect();
      const thick = 0.5 * to.a * (parseFloat(getComputedStyle(shape).strokeWidth) || 0);
      const wide = {left: box.left - thick, right: box.right + thick, top: box.top - thick, bottom: box.bottom + thick};
      if (its.right < wide.left || its.left > wide.right || its.bottom < wide.top || its.top > wide.bottom) continue;
      for (let at = 0, long = shape.getTotalLength(); at <= long; at += 0.5) {
        const place = shape.getPointAtLength(at).matrixTransform(to);
        if (inside(place.x, place.y, wide)) { found.push(`${said}: ${shape.parentNode.getAttribute('class')}`); break; }
      }
    }
  });
  return found;
})()"""

USUAL = (("2", "30.25", "312.5"), ("3", "65.6", "400"), ("8", "200", "380.5"), ("12", "310.5", "1200.5"))
"""Pushed rib, d31 and d21."""


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_words_of_the_small_torso_stand_apart(tab, root, serve, side):
    """From each other and from what is drawn, whatever value is being filled in."""
    found = {}
    with serve(root) as served:
        load(tab, served.address)
        go(tab, f"/subject/{served.key()}/values")
        chosen(tab, "#f-pushes-0--side", side)
        fill(tab, "#f-pushes-0--forces-n-2-", "102.5")
        for level, d31, d21 in USUAL:
            for name, value in (("level", level), ("d31-mm", d31), ("d21-mm", d21)):
                fill(tab, f"#f-pushes-0--{name}", value)
                tab.settle()
                if over := tab.run(OVERLAPS):
                    found[level, d31, d21, name] = over
            assert f"d31 {d31} mm" in tab.run("document.querySelector('.push .torso').textContent")
    assert found == {}
