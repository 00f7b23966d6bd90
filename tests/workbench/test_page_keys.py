"""The workbench in a headless Chromium by keyboard alone, the focus always in sight: no mouse, no script clicks."""

from __future__ import annotations

import shutil
import sys

import numpy as np
import pydicom
import pytest

from annotation_hands import Hands
from bench_page import files, load, text
from chromium import ALT, SHIFT, browser
from hospital import export, headed
from reachable import unfocused
from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.files import read_json
from spinestiff.subject.folder import read_annotation

pytestmark = pytest.mark.skipif(
    browser() is None or sys.platform == "win32", reason="no Chromium to open the page in, or no pipe to drive it by"
)
NAME = "girl-05"
SEEN_PX = 2.0
"""Off by which somebody sees that a corner has to be moved: 1.4 mm of the patient."""
IMAGES = {"rest/frontal": "101500", "rest/lateral": "101630", "push/main": "102200", "push/second": "102800"}
"""What the finished subject has, and when it was taken."""
WHOLE = "document.querySelector('.ends')"
POINTED = """
for (const kind of ['pointerdown', 'pointermove', 'mousedown', 'mousemove', 'touchstart', 'wheel'])
  addEventListener(kind, () => { sessionStorage.pointed += kind; }, true);
"""


@pytest.fixture
def keys(tab):
    """A tab in which every pointer is noted; there has to be none."""
    script = tab.call("Page.addScriptToEvaluateOnNewDocument", source=POINTED)["identifier"]
    yield tab
    assert tab.run("sessionStorage.pointed") is None
    tab.call("Page.removeScriptToEvaluateOnNewDocument", identifier=script)


def reach(tab, selector, backwards=False, most=160):
    """Press Tab until what a selector names has the focus; wherever it is meanwhile, it is seen."""
    tab.until(f"!!document.querySelector({selector!r})")
    for _ in range(most):
        if tab.run(f"document.activeElement.matches({selector!r})"):
            return
        tab.press("Tab", modifiers=SHIFT if backwards else 0)
        # After the last control comes the browser's own part of the window.
        if tab.run("document.activeElement != document.body") and unfocused(tab) is not None:
            held(tab)  # once the page has come to rest
    raise AssertionError(f"{most} times Tab and not at {selector}")


def enter(tab, selector, backwards=False):
    """Reach a control and press Enter; the focus is lost by none."""
    reach(tab, selector, backwards)
    tab.press("Enter")


def go_to(tab, room):
    enter(tab, f"#rooms a[href='#/{room}']", backwards=True)
    tab.until(f"document.querySelector('#rooms [aria-current]')?.hash == '#/{room}'")
    tab.until("document.body.dataset.state == 'open'")
    held(tab)


def held(tab):
    """The focus is somewhere, and is seen."""
    tab.settle()
    assert unfocused(tab) is None


def typed(tab, selector, letters):
    """Reach a field and type; in a list, the first letters of its entry."""
    reach(tab, selector)
    for letter in letters:
        tab.press(letter)


def point(tab, pixel):
    """The cross to a pixel of the radiograph, and a point there."""
    right, down = np.rint(np.array(pixel) - np.array(tab.run("annotation.cursor"))).astype(int)
    for by, there, back in ((right, "ArrowRight", "ArrowLeft"), (down, "ArrowDown", "ArrowUp")):
        tens, ones = divmod(abs(int(by)), 10)
        tab.press(there if by > 0 else back, tens)
        tab.press(there if by > 0 else back, ones, ALT)
    tab.press("Enter")


def annotate(tab, image, marks):
    """Points along the spine, a proposal, a look at each vertebra, arrows for corners that are off; how many were."""
    hands, moved = Hands(tab), 0
    names = [name for name in VERTEBRAE if name in marks["vertebrae"]]
    reach(tab, "#stage")
    tab.press("p")
    for name in (names[i] for i in np.linspace(0, len(names) - 1, 6).round().astype(int)):
        point(tab, np.mean(marks["vertebrae"][name], axis=0))
    for place, name in (("upper", names[0]), ("lower", names[-1])):
        typed(tab, f"#{place}", name)
    enter(tab, "#propose")
    tab.until(f"!annotation.busy && Object.keys(annotation.marks.vertebrae).length == {len(names)}")
    held(tab)
    reach(tab, "#stage", backwards=True)
    while tab.run("annotation.unseen.length"):
        tab.press("l")
        name = tab.run("annotation.selection.name")
        for corner, wanted in enumerate(np.array(marks["vertebrae"][name])):
            off = wanted - hands.quad(name, image)[corner]
            if np.linalg.norm(off) <= SEEN_PX:
                continue
            tab.press(str(corner + 1))
            for by, there, back in ((off[0], "ArrowRight", "ArrowLeft"), (off[1], "ArrowDown", "ArrowUp")):
                tab.press(there if by > 0 else back, round(abs(by)))
            moved += 1
    for tool, points in marks.get("supports", {}).items():
        if points:
            tab.press({"pelvis": "s", "shoulder": "h"}[tool])
            for one in points:
                point(tab, one)
            tab.press("Escape")
    hands.saved()
    return moved


def run_ends(served, results):
    """Stands in for the process of a job: it leaves what the finished subject's run has left."""
    table = served.bench.jobs.table
    job = table.take(1)
    log = served.bench.jobs.log(job.id)
    log.parent.mkdir(parents=True, exist_ok=True)
    log.write_text("  0.1 s  track: following\n  0.2 s  estimate: fitting\n", encoding="utf-8")
    folder = shutil.copytree(results, served.bench.root.subject(job.subject) / "results", dirs_exist_ok=True)
    # As reports have them, a part that scrolls by keys.
    (folder / "view.html").write_text("<div tabindex=0>view</div>", encoding="utf-8")
    table.end(job.id, "done", 0)
    return job


@pytest.mark.slow
def test_from_an_export_to_the_results_and_a_plan(keys, finished, serve, tmp_path):
    tab, known = keys, read_json(finished.folder / "subject.json")
    marks = read_json(finished.folder / "annotation.json")["images"]
    for number, (name, time) in enumerate(IMAGES.items()):
        headed(finished.folder / f"{name}.dcm".replace("push/", "pushes/"), tmp_path / "disc" / f"I{number}", time=time)
    export(tmp_path / "disc" / "I9", study="1.2.9", time="090000")
    (tmp_path / "root").mkdir()
    folder = tmp_path / "root" / NAME
    with serve(tmp_path / "root") as served:
        load(tab, served.address)
        # An empty folder: one way on, and the same from the top.
        enter(tab, "#rooms a[href='#/new']")
        tab.until("!!document.querySelector('#drop')")
        held(tab)
        reach(tab, "#drop button.main")
        # The system's dialog, which Enter opens here, can't be driven.
        files(tab, "#files", sorted((tmp_path / "disc").iterdir()))
        tab.until("!!document.querySelector('#study')", 60)
        held(tab)
        reach(tab, "#study")
        # Each press of an arrow chooses: the list keeps the focus, so that the next press counts as well.
        for study, pictures in (("A1", 1), ("A2", 4)):
            tab.press("ArrowDown")
            tab.until(f"document.querySelectorAll('#found tbody tr').length == {pictures}", 60)
            assert tab.run("document.activeElement.value") == study
        typed(tab, "#name", NAME)
        tab.press("Enter")
        tab.until("!!document.querySelector('#f-age')")
        held(tab)

        typed(tab, "#f-age", f"{known['age']:g}")
        typed(tab, "#f-sex", known["sex"][0])
        typed(tab, "#f-height-cm", f"{known['height_cm']:g}")
        for number, push in enumerate(known["pushes"]):
            field = f"#f-pushes-{number}--"
            typed(tab, f"{field}side", push["side"][0])
            for name in ("level", "d21_mm", "d31_mm"):
                typed(tab, field + name.replace("_", "-"), f"{push[name]:g}")
            for frame, (force, role) in enumerate(zip(push["forces_n"], push["roles"])):
                typed(tab, f"{field}forces-n-{frame}-", f"{force:g}")
                typed(tab, f"{field}roles-{frame}-", role[0])
        tab.until("document.querySelector('.saved').innerText == 'Saved. Everything is filled in.'")
        # A button that draws the form anew keeps the focus at its place, closed parts included.
        enter(tab, "#choices > summary")
        enter(tab, "#ratios-choose")
        held(tab)
        enter(tab, "#ratios-usual")
        held(tab)
        assert tab.run("!!document.activeElement.closest('#choices')")
        tab.until("document.querySelector('.saved').innerText == 'Saved. Everything is filled in.'")
        record = read_json(folder / "subject.json")
        for push, wanted in zip(record["pushes"], known["pushes"]):
            given = ("side", "level", "d21_mm", "d31_mm", "forces_n", "roles")
            assert {name: push[name] for name in given} == {name: wanted[name] for name in given}

        enter(tab, "#next", backwards=True)
        tab.until("!!window.annotation && document.body.dataset.state == 'open'")
        images = tab.run("annotation.session.images.map(one => one.name)")
        moved = 0
        for number, (image, wanted) in enumerate(zip(images, IMAGES)):
            if number:
                enter(tab, f"#images li:nth-child({number + 1}) button", backwards=True)
                tab.until(f"annotation.image.name == {image!r} && annotation.loaded == annotation.key")
            moved += annotate(tab, image, marks[wanted])
        assert 0 < moved < 0.3 * 4 * sum(len(one["vertebrae"]) for one in marks.values())
        tab.until("document.querySelector('#missing').innerText.startsWith('✓ Everything a fit needs is marked.')")
        saved = read_annotation(folder / "annotation.json").images
        for image, wanted in zip(images, IMAGES):
            corners, there = marks[wanted]["vertebrae"], saved[image].vertebrae
            away = [np.linalg.norm(np.array(there[name]) - corners[name], axis=1) for name in corners]
            assert np.max(away) <= SEEN_PX, image
        # Frames of a push, to the last of them, where the button goes off.
        enter(tab, "#images li:nth-child(4) button", backwards=True)
        tab.until("annotation.loaded == annotation.key && annotation.image == annotation.session.images[3]")
        enter(tab, "#frame-on")
        tab.until("annotation.loaded == annotation.key && annotation.frame == 1")
        held(tab)
        assert tab.complaints == []

        enter(tab, "#onward")
        tab.until("document.querySelector('h1 .badge')?.innerText == 'Ready to run'")
        enter(tab, "#start-run")
        tab.until("document.querySelector('.live')?.dataset.state == 'waiting'")
        held(tab)
        enter(tab, "#cancel")
        tab.until("document.querySelector('.live').dataset.state == 'cancelled'")
        held(tab)
        enter(tab, "#start-run")
        tab.until("document.querySelector('.live')?.dataset.state == 'waiting'")
        reach(tab, "#cancel")
        run_ends(served, finished.folder / "results")
        tab.until("document.querySelector('.live').dataset.state == 'done'")
        held(tab)
        enter(tab, ".live p a")
        tab.until("!!document.querySelector('iframe')")
        held(tab)
        assert "What was found" in text(tab) and "N m/rad" in text(tab)
        reach(tab, "[role=tab][aria-selected=true]")
        assert tab.run("document.querySelector('iframe').getAttribute('src')").endswith("/report.html")
        tab.press("ArrowRight")
        tab.until("document.querySelector('iframe').getAttribute('src').endsWith('/view.html')")
        # A page that comes takes the focus from one that goes.
        tab.until("performance.getEntriesByName(document.querySelector('iframe').src).length > 0")
        held(tab)
        # Into the page that is shown, and out of it again.
        reach(tab, "iframe")
        reach(tab, "#zip-all")

        enter(tab, ".way a[href$='/run']", backwards=True)
        tab.until("!!document.querySelector('#start-plan')")
        enter(tab, "details:has(#start-plan) > summary")
        typed(tab, "#o-plan-side", "left")
        typed(tab, "#o-plan-ribs", "5, 9")
        enter(tab, "#start-plan")
        tab.until("document.querySelector('.live')?.dataset.state == 'waiting'")
        held(tab)
        job = run_ends(served, finished.folder / "results")
        assert (job.verb, job.options) == ("plan", {"side": "left", "ribs": "5, 9"})
        tab.until("document.querySelector('.live').dataset.state == 'done'")
        for room in ("compare", "table", ""):
            go_to(tab, room)
        # What is removed takes the focus with it nowhere, nor does what comes back, or a question that is not answered.
        enter(tab, f"[aria-label='Remove {NAME}']")
        tab.until("!!document.querySelector('.card.empty')")
        held(tab)
        enter(tab, "#undo button:not(.quiet)", backwards=True)
        tab.until(f"!!document.querySelector(\"[aria-label='Remove {NAME}']\")")
        held(tab)
        enter(tab, f"[aria-label='Remove {NAME}']")
        tab.until("!!document.querySelector('.card.empty')")
        go_to(tab, "trash")
        enter(tab, ".card button:not(.main)")
        tab.until("!!document.querySelector('dialog')")
        held(tab)
        tab.press("Escape")
        tab.until("!document.querySelector('dialog')")
        held(tab)
        enter(tab, ".card button.main", backwards=True)
        tab.until("document.querySelector('#room').innerText.includes('The trash is empty')")
        held(tab)
        assert folder.is_dir() and tab.complaints == []


@pytest.mark.parametrize("shape", [(1.0, 1.2), (1.25, 1.0)])
def test_both_ends_of_a_known_length_by_keys(keys, root, serve, shape):
    """Near an end in the whole radiograph, then exactly in the enlarged part, whatever shape pixels have."""
    tab, place = keys, root / "girl" / "subject.json"
    path = root / "girl" / "rest" / "frontal.dcm"
    dataset = pydicom.dcmread(path)
    dataset.ImagerPixelSpacing = [round(shape[1] * 0.8, 3), round(shape[0] * 0.8, 3)]
    dataset.save_as(path)
    with serve(root) as served:
        load(tab, served.address)
        enter(tab, ".card h2 a")
        enter(tab, "#xray > summary")
        enter(tab, "#scale-add")
        typed(tab, "#f-xray-scale-rest-frontal-object-mm", "25.4")
        enter(tab, ".pick")
        tab.until("document.querySelector('.picked').innerText.startsWith('First end')")
        reach(tab, ".ends")
        # The picture has 448 columns and 640 rows, the cross begins in its middle.
        for large, small in (("ArrowLeft", "ArrowUp"), ("ArrowRight", "ArrowDown")):
            tab.press(large, 3)
            tab.press("Enter")
            tab.until("document.activeElement.matches('.near')")
            held(tab)
            tab.press(small, 2)
            tab.press(small, 5, ALT)
            tab.press("Enter")
            tab.until("document.activeElement.matches('.ends:not(.near)')")
            held(tab)
        length = {"object_mm": 25.4, "object_px": [[194.0, 317.5], [224.0, 320.0]]}
        tab.wait(lambda: read_json(place).get("xray", {}).get("scale") == {"rest/frontal": length})
        # Both pictures have the shape that the body has, and the first end is where it is marked.
        for which, columns, rows in ((0, 448, 640), (1, 160, 160)):
            wide, tall = tab.run(f"[...document.querySelectorAll('.ends')].map(c => [c.width, c.height])[{which}]")
            assert wide / tall == pytest.approx(columns * shape[0] / (rows * shape[1]), rel=0.01)
        at = "[194.5 / 448 * c.width, 318 / 640 * c.height, 1, 1]"
        tab.run(f"(c => {{ window.seen = [...c.getContext('2d').getImageData(...{at}).data]; }})({WHOLE})")
        assert tab.run("seen") == [255, 204, 0, 255]
        assert tab.complaints == []


def test_a_push_that_is_removed_takes_the_focus_nowhere(keys, root, serve):
    tab = keys
    with serve(root) as served:
        load(tab, served.address)
        enter(tab, ".card h2 a")
        enter(tab, "[aria-label='Remove this push: a']")
        tab.until("!document.querySelector('#push-0')")
        tab.until("document.activeElement.matches('h1')")
        held(tab)
        enter(tab, "#undo button:not(.quiet)", backwards=True)
        tab.until("!!document.querySelector('#push-0')")
        held(tab)
        assert tab.complaints == []
