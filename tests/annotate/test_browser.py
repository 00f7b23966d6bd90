"""The page in a headless Chromium: propose, drag, keys, undo, reload, frames; nothing leaves the machine."""

from __future__ import annotations

import json
import sys
from contextlib import contextmanager

import cv2
import numpy as np
import pydicom
import pytest

from annotation_hands import Hands
from chromium import ALT, CTRL, SHIFT, Tab, browser
from fingers import touch
from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.curves.cobb import REGIONS, read_cobb
from spinestiff.curves.corner_files import read_corners
from spinestiff.subject.folder import read_annotation
from unannotated import CANARY, MM, drawn

pytestmark = pytest.mark.skipif(
    browser() is None or sys.platform == "win32", reason="no Chromium to open the page in, or no pipe to drive it by"
)

CLICKED = ("T1", "T5", "T9", "L1", "L5")


@pytest.fixture(scope="module")
def tab(tmp_path_factory):
    with Tab(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.fixture
def page(tab, served):
    tab.size(1280, 800)
    tab.theme("light")
    go(tab, served.address)
    yield Page(tab, served)
    # Leaving must not ask whether to.
    tab.until("!window.annotation || document.querySelector('#saved').dataset.state != 'saving'")


def go(tab, address, state="open"):
    tab.loaded = False
    tab.requests.clear()
    tab.complaints.clear()
    tab.call("Page.navigate", url="about:blank")
    tab.wait(lambda: tab.loaded)
    tab.loaded = False
    tab.call("Page.navigate", url=address)
    tab.wait(lambda: tab.loaded)
    tab.until(f"document.body.dataset.state == '{state}'")


def reload(page):
    page.tab.loaded = False
    page.tab.call("Page.reload")
    page.tab.wait(lambda: page.tab.loaded)
    page.tab.until("document.body.dataset.state == 'open'")


class Page(Hands):
    """What a person does on the page, by mouse and by keys."""

    def __init__(self, tab, served):
        super().__init__(tab)
        self.served = served

    def button(self, name):
        self.tab.run(f"document.getElementById('{name}').click()")

    def key(self, key, modifiers=0, times=1):
        self.tab.press(key, times, modifiers)

    def text(self, name):
        return self.tab.run(f"document.getElementById('{name}').innerText")

    def disk(self):
        return read_annotation(self.served.session.annotation_path).images

    def fill(self, image="rest/frontal"):
        """The true corners, without the clicks."""
        marks = json.dumps(drawn(image).named())
        self.tab.run(f"annotation.change(marks => ({{...marks, vertebrae: {marks}}}), 'filled')")
        self.saved()

    def stage(self):
        """Where the picture lies in the window: left, top, width, height."""
        box = self.tab.run("JSON.parse(JSON.stringify(annotation.stage.canvas.getBoundingClientRect()))")
        return [box[name] for name in ("left", "top", "width", "height")]

    def propose(self, image="rest/frontal", look=True):
        self.tab.run("document.querySelector('[data-tool=spine]').click()")
        for pixel in drawn(image).clicks(*CLICKED):
            self.click(pixel)
        self.button("propose")
        self.tab.until(f"Object.keys(annotation.allMarks['{image}']?.vertebrae ?? {{}}).length == 17")
        if look:
            self.key("PageDown", times=17)
        self.saved()


def test_a_few_clicks_and_seventeen_vertebrae_are_on_disk(page):
    page.propose(look=False)
    found = np.array([page.quad(name) for name in VERTEBRAE])
    away_mm = MM * np.linalg.norm(found - drawn("rest/frontal").quads, axis=2)
    assert np.median(away_mm) < 1.0 and np.percentile(away_mm, 95) < 3.0
    # A proposal is none of anybody's marks until each vertebra was looked at.
    assert not page.served.session.annotation_path.exists()
    assert "Rest, frontal: 17 of 17 vertebrae are proposed and not looked at yet" in page.text("missing")
    assert "17 vertebrae, 17 to look at" in page.text("images") and "✓" not in page.text("images")
    page.key("PageDown", times=16)
    page.tab.until("document.getElementById('missing').innerText.includes('frontal: 1 of 17 vertebrae')")
    assert page.text("look-on") == "Next to look at (1 left)"
    assert not page.served.session.annotation_path.exists()
    page.key("l")
    page.saved()
    page.tab.until("!document.getElementById('missing').innerText.includes('frontal')")
    assert list(page.disk()) == ["rest/frontal"] and "✓" in page.text("images")
    np.testing.assert_allclose(page.disk()["rest/frontal"].pixels(), found)
    assert page.tab.complaints == []
    assert "Rest, lateral: no vertebra marked yet" in page.text("missing")
    assert "Rest, frontal" not in page.text("missing")


def test_what_is_pressed_again_and_again_keeps_its_place(page):
    """Where a click went to the next vertebra, another must not rename them: whatever is said, the buttons stay."""

    def places():
        page.tab.until("!annotation.judging")
        page.tab.settle()
        return page.tab.run(
            "['propose', 'look-on', 'clear-spine'].map(name => {"
            " const box = document.getElementById(name).getBoundingClientRect(); return [box.x, box.y, box.height]; })"
        )

    for width in (1280, 1500):
        page.tab.size(width, 800)
        page.button("fit")
        before = places()
        page.propose(look=False)
        assert "°" in page.text("cobb") and places() == before
        page.button("look-on")
        corner = page.quad("T1")[1]
        page.drag(corner, corner + [3.0, -2.0])
        assert page.text("propose") == "Propose the others" and places() == before
        page.button("undo")
        page.button("undo")
        page.button("clear-spine")
        page.saved()


def test_what_was_looked_at_is_known_after_a_reload_an_undo_and_other_names(page):
    page.propose(look=False)
    page.key("PageDown", times=2)
    corner = page.quad("T9")[1]
    page.tab.drag(page.place(corner), page.place(corner + [6.0, -4.0]))
    unseen = [name for name in VERTEBRAE if name not in ("T1", "T2", "T9")]
    assert set(page.tab.run("annotation.unseen")) == set(unseen)
    page.key("z", CTRL)
    assert set(page.tab.run("annotation.unseen")) == set(unseen)  # it was looked at while it was moved
    page.saved()
    reload(page)
    assert page.tab.run("annotation.image.name") == "rest/frontal"
    assert set(page.tab.run("annotation.unseen")) == set(unseen)
    page.tab.run("annotation.visible('T1', false)")
    page.button("names-up")
    names = [VERTEBRAE[VERTEBRAE.index(name) - 1] for name in unseen]
    assert set(page.tab.run("annotation.unseen")) == set(names)


def points(page):
    page.tab.run("document.querySelector('[data-tool=spine]').click()")
    for pixel in drawn("rest/frontal").clicks(*CLICKED):
        page.click(pixel)


def test_a_proposal_after_a_reload_keeps_what_was_put_right_or_asks(page):
    """Nobody knows any longer which of the saved vertebrae were put right: all count as that."""
    tab = page.tab
    page.propose()
    corner = page.quad("T8")[1]
    page.drag(corner, corner + [6.0, -4.0])
    page.saved()
    reload(page)
    tab.run("annotation.open('rest/frontal')")
    tab.until("annotation.loaded == 'rest/frontal'")
    saved = page.marks()["vertebrae"]
    assert page.marks()["spine"] == []
    points(page)
    tab.questions.clear()
    tab.answer = False
    try:
        page.button("propose")
        tab.until("!annotation.busy")
        assert page.marks()["vertebrae"] == saved
        assert page.text("propose") == "Propose all anew" and tab.questions == ["confirm"]
        # A vertebra that is not marked is proposed, all others stay.
        tab.run("annotation.visible('T3', false)")
        assert page.text("propose") == "Propose the others"
        page.button("propose")
        tab.until("!!annotation.marks.vertebrae.T3 && !annotation.busy")
        assert tab.questions == ["confirm"] and tab.run("annotation.unseen") == ["T3"]
        assert {**page.marks()["vertebrae"], "T3": saved["T3"]} == saved
        page.button("undo")
        page.button("undo")
    finally:
        tab.answer = True
    page.button("propose")
    tab.until("annotation.unseen.length == 17")
    assert page.marks()["vertebrae"]["T8"] != saved["T8"]
    page.button("undo")
    assert page.marks()["vertebrae"] == saved
    page.saved()


def test_a_proposal_that_comes_back_by_undo_is_still_to_be_looked_at(page):
    page.propose(look=False)
    first = page.marks()["vertebrae"]
    page.tab.run("annotation.change(marks => ({...marks, spine: marks.spine.slice(0, 4)}), 'one point less')")
    pick(page, "lower", "L1")
    page.button("propose")
    page.tab.until("!annotation.marks.vertebrae.L5 && !annotation.busy")
    for _ in range(3):
        page.button("undo")
    assert page.marks()["vertebrae"] == first and len(page.tab.run("annotation.unseen")) == 17
    page.saved()
    assert not page.served.session.annotation_path.exists()


def pick(page, name, value):
    page.tab.run(
        f"{{ const select = document.getElementById('{name}'); select.value = '{value}';"
        " select.dispatchEvent(new Event('change')); }"
    )


def ends(page):
    return page.tab.run("['upper', 'lower'].map(name => document.getElementById(name).value)")


def test_from_and_to_are_those_of_the_marked_vertebrae_when_it_is_opened_again(page):
    assert ends(page) == ["T1", "L5"]
    marks = json.dumps(drawn("rest/frontal").named(*VERTEBRAE[2:13]))
    page.tab.run(f"annotation.change(marks => ({{...marks, vertebrae: {marks}}}), 'filled')")
    page.saved()
    reload(page)
    page.tab.run("annotation.open('rest/frontal')")
    page.tab.until("annotation.loaded == 'rest/frontal'")
    assert page.tab.run("annotation.marks.spine.length") == 0 and ends(page) == ["T3", "L1"]
    # What nobody has said of another picture begins with what is said of this one.
    page.tab.run("annotation.open('rest/lateral')")
    page.tab.until("annotation.loaded == 'rest/lateral'")
    assert ends(page) == ["T3", "L1"]
    pick(page, "upper", "T2")
    assert ends(page) == ["T2", "L1"]
    page.tab.run("annotation.open('rest/frontal')")
    page.tab.until("annotation.loaded == 'rest/frontal'")
    assert ends(page) == ["T3", "L1"]


def test_points_along_the_spine_keep_their_vertebrae_in_a_draft(page):
    """The point at T1 stays T1's, whatever becomes of that vertebra, and after a reload."""
    page.propose(look=False)
    page.tab.run("annotation.visible('T1', false)")
    page.saved()
    assert ends(page) == ["T1", "L5"]
    reload(page)
    assert page.tab.run("annotation.marks.spine.length") == len(CLICKED) and ends(page) == ["T1", "L5"]
    page.button("names-up")
    assert ends(page) == ["T1", "L4"]
    page.button("undo")
    assert ends(page) == ["T1", "L5"]
    pick(page, "upper", "T4")
    assert ends(page) == ["T4", "L5"]
    page.button("undo")
    page.button("clear-spine")
    assert ends(page) == ["T2", "L5"]
    page.saved()


def test_a_corner_and_a_whole_vertebra_are_dragged(page):
    page.fill()
    before = page.quad("T8")
    page.tab.drag(page.place(before[1]), page.place(before[1] + [6.0, -4.0]))
    after = page.quad("T8")
    np.testing.assert_allclose(after[1] - before[1], [6.0, -4.0], atol=0.06)
    np.testing.assert_array_equal(after[[0, 2, 3]], before[[0, 2, 3]])
    middle = page.quad("L2").mean(axis=0)
    whole = page.quad("L2")
    page.tab.drag(page.place(middle), page.place(middle + [-5.0, 3.0]))
    np.testing.assert_allclose(page.quad("L2") - whole, np.full((4, 2), [-5.0, 3.0]), atol=0.06)
    page.saved()
    np.testing.assert_allclose(page.disk()["rest/frontal"].vertebrae["T8"], after)


def test_a_drag_beside_the_marks_moves_the_picture_and_the_wheel_zooms(page):
    page.fill()
    before, marks = page.place((10, 10)), page.marks()
    page.tab.drag(page.place((60, 300)), page.place((90, 320)))
    after = page.place((10, 10))
    assert np.hypot(*np.subtract(after, before)) > 10.0
    at = page.place((200, 300))
    page.tab.wheel(at, -400.0)
    page.tab.settle()
    np.testing.assert_allclose(page.place((200, 300)), at, atol=1.0)  # the wheel tells whole pixels
    assert np.hypot(*np.subtract(page.place((210, 300)), at)) > 1.5 * 10.0
    assert page.marks() == marks


def test_undo_and_redo_go_through_every_change_and_are_saved(page):
    page.propose()
    proposed = page.marks()
    corner = page.quad("T8")[1]
    page.tab.drag(page.place(corner), page.place(corner + [6.0, -4.0]))
    dragged = page.marks()
    assert dragged != proposed
    page.key("z", CTRL)
    assert page.marks() == proposed
    page.key("y", CTRL)
    assert page.marks() == dragged
    page.button("undo")
    page.button("undo")
    assert page.marks()["vertebrae"] == {} and len(page.marks()["spine"]) == 5
    page.saved()
    assert list(page.disk()) == []
    page.button("redo")
    page.saved()
    page.tab.until("document.querySelector('#saved').dataset.state == 'saved'")
    assert list(page.disk()) == ["rest/frontal"]


def test_the_whole_spine_by_keyboard_alone(page):
    """From the first Tab on: points, proposal, vertebra, corner, three sizes of step, a turn, not visible."""
    tab, key = page.tab, page.key
    for _ in range(60):
        key("Tab")
        if tab.run("document.activeElement.id") == "stage":
            break
    assert tab.run("document.activeElement.id") == "stage"
    assert tab.run("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    key("p")
    for pixel in drawn("rest/frontal").clicks(*CLICKED):
        at = np.array(tab.run("annotation.cursor"))
        right, down = np.rint((pixel - at) / 10.0).astype(int)
        key("ArrowRight" if right > 0 else "ArrowLeft", times=abs(right))
        key("ArrowDown" if down > 0 else "ArrowUp", times=abs(down))
        key("Enter")
    key("o")
    tab.until("Object.keys(annotation.marks.vertebrae).length == 17")
    key("PageDown", times=17)
    key("Home")
    key("PageDown", times=2)
    assert page.text("spoken").startswith("T3: column ")
    key("2")
    assert page.text("spoken").startswith("T3, superior right corner: column ")
    before = page.quad("T3")
    key("ArrowRight", times=2)
    key("ArrowDown", SHIFT)
    key("ArrowUp", ALT, times=3)
    np.testing.assert_allclose(page.quad("T3")[1] - before[1], [2.0, 10.0 - 0.3], atol=0.011)
    np.testing.assert_array_equal(page.quad("T3")[[0, 2, 3]], before[[0, 2, 3]])
    key("0")
    key("e")
    turned = page.quad("T3")
    assert np.hypot(*(turned.mean(axis=0) - (before.sum(axis=0) + [2.0, 9.7]) / 4.0)) < 0.02
    key("Delete")
    assert "T3" not in page.marks()["vertebrae"] and "T3 is marked as not visible" in page.text("spoken")
    key("z", CTRL)
    np.testing.assert_array_equal(page.quad("T3"), turned)
    page.saved()
    np.testing.assert_allclose(page.disk()["rest/frontal"].vertebrae["T3"], turned)
    # No trap: Tab leaves the radiograph.
    key("Tab")
    assert tab.run("document.activeElement.id") != "stage"


def test_the_angle_follows_every_drag_as_spinestiff_cobb_reads_it(page):
    page.fill()
    before = page.text("cobb")
    page.tab.until("annotation.cobb")
    corner = page.quad(page.tab.run("annotation.cobb.upper"))[0]
    page.tab.drag(page.place(corner), page.place(corner + [0.0, 9.0]))
    page.tab.until(f"document.getElementById('cobb').innerText != {json.dumps(before)}")
    page.tab.until("!annotation.judging")
    page.saved()
    (image,) = read_corners(page.served.session.annotation_path)
    wanted = read_cobb(image)
    first, *others = page.text("cobb").split("\n")
    assert first == wanted.words()
    told = [f"{wanted.words(curve)}, {REGIONS[curve.region][1]}" for curve in wanted.curves]
    assert [line for line in told if not line.startswith(first)] == others and others


def test_names_move_up_and_down_and_stop_at_the_ends(page):
    page.fill()
    page.button("names-down")
    assert "end at L5" in page.text("problem")
    page.tab.run("annotation.visible('L5', false)")
    # Its cause is gone, and so is what was said.
    assert page.text("problem") == "" and page.tab.run("document.getElementById('problem').hidden")
    was = page.quad("T1")
    page.button("names-down")
    assert set(page.marks()["vertebrae"]) == set(VERTEBRAE[1:])
    np.testing.assert_array_equal(page.quad("T2"), was)
    page.button("names-up")
    np.testing.assert_array_equal(page.quad("T1"), was)


def test_a_vertebra_comes_back_where_it_was(page):
    page.fill()
    was = page.quad("T6")
    box = (
        "[...document.querySelectorAll('#vertebrae li')].find(li => li.innerText.trim() == 'T6').querySelector('input')"
    )
    page.tab.run(f"{box}.click()")
    assert "T6" not in page.marks()["vertebrae"]
    page.tab.run(f"{box}.click()")
    np.testing.assert_array_equal(page.quad("T6"), was)


def test_a_reload_finds_what_was_saved_and_the_token(page):
    page.fill()
    marks = page.marks()
    assert "#" not in page.tab.run("location.href")
    reload(page)
    assert page.marks()["vertebrae"] == marks["vertebrae"]
    # The first radiograph that is not complete is shown.
    assert page.tab.run("annotation.image.name") == "rest/lateral"


def test_without_the_token_the_page_says_what_to_do(tab, served):
    tab.run("sessionStorage.clear()")
    go(tab, served.address.partition("#")[0], "refused")
    assert "open the address that spinestiff annotate printed last" in tab.run(
        "document.getElementById('problem').innerText"
    )


def test_nothing_is_asked_of_another_host_and_no_word_of_the_dicom_files_is_shown(page):
    page.propose()
    page.tab.run("annotation.open('push/a', 1)")
    page.tab.until("annotation.stage.grey && annotation.frame == 1")
    assert len(page.tab.requests) > 5
    own = page.served.address.partition("#")[0]
    assert [url for url in page.tab.requests if not url.startswith((own, "data:", "about:"))] == []
    for word in CANARY.split("^"):
        assert word not in page.tab.run("document.documentElement.outerHTML")
    assert page.tab.complaints == []


def test_pushed_frames_are_tracked_one_is_corrected_and_tracking_starts_again(page):
    image = "push/a"
    page.tab.run(f"annotation.open('{image}')")
    page.tab.until(f"annotation.image.name == '{image}' && annotation.stage.size[0] > 1")
    page.tab.settle()
    page.fill(image)
    page.button("track")
    page.tab.until(f"annotation.tracking['{image}']?.state == 'done'", 60.0)
    page.button("frame-on")
    page.tab.until("annotation.frame == 1 && annotation.tracked")
    assert "1 (0 to 2), 20 N, training: tracked" in page.text("frame-text")
    still = page.stage()
    quads = {name: np.array(quad) for name, quad in page.tab.run("annotation.tracked.vertebrae").items()}
    truth = drawn(f"{image}/1").named()
    moved = [np.linalg.norm(quads[name] - np.array(truth[name]), axis=1).mean() for name in VERTEBRAE]
    assert np.median(moved) < 2.0
    # What is doubtful is counted, and told by a sign on the radiograph.
    page.tab.run("for (const quality of Object.values(annotation.tracked.quality)) quality.fill(1)")
    page.tab.run("annotation.tracked.quality.T3 = [1, 0.2, 0, 1]; annotation.after()")
    assert ", 2 corners doubtful or lost" in page.text("frame-text")
    page.tab.run("annotation.tracked.quality.T3 = [1, 1, 1, 1]; annotation.after()")
    assert "doubtful" not in page.text("frame-text")
    # Whatever is said, the picture keeps its place and size, frame by frame.
    for frame in (2, 0, 1):
        page.tab.run("annotation.problem('Something that is wrong, in many words. '.repeat(9), () => false)")
        page.tab.run(f"annotation.open('{image}', {frame})")
        page.tab.until(f"annotation.loaded == annotation.key && annotation.frame == {frame}")
        page.tab.settle()
        assert page.stage() == still
    page.tab.run("annotation.problem('', () => false)")
    # A corner is put elsewhere: this vertebra alone becomes a mark of this frame.
    corner = quads["T9"][0]
    page.tab.drag(page.place(corner), page.place(corner + [5.0, 0.0]))
    assert list(page.marks(f"{image}/1")["vertebrae"]) == ["T9"]
    page.tab.until(f"annotation.tracking['{image}'].state == 'running'")
    page.tab.until(f"annotation.tracking['{image}'].state == 'done'", 60.0)
    again = np.array(page.tab.run("annotation.tracked.vertebrae")["T9"])
    np.testing.assert_allclose(again[0], corner + [5.0, 0.0], atol=0.06)
    page.saved()
    assert list(page.disk()[f"{image}/1"].vertebrae) == ["T9"]
    assert "1 corrected" in page.text("frame-text")


def test_supports_and_pedicles_are_points_where_they_belong(page):
    page.fill()
    page.tab.run("document.querySelector('[data-tool=pedicle]').click()")
    middle = page.quad("T9").mean(axis=0)
    page.click(middle + [7.0, 0.0])
    # The other one is taken to lie opposite, until it is put right.
    page.tab.drag(page.place(middle + [-7.0, 0.0]), page.place(middle + [-6.0, 1.0]))
    left, right = np.array(page.marks()["pedicles"]["T9"])
    # The patient's left is on the right of the picture.
    np.testing.assert_allclose(left, middle + [7.0, 0.0], atol=0.06)
    np.testing.assert_allclose(right, middle + [-6.0, 1.0], atol=0.06)
    page.tab.run("annotation.open('push/a')")
    page.tab.until("!!document.querySelector('[data-tool=pelvis]')")
    page.tab.settle()
    page.tab.run("document.querySelector('[data-tool=pelvis]').click()")
    page.click((100, 600))
    page.click((340, 600))
    assert len(page.marks("push/a")["supports"]["pelvis"]) == 2
    page.key("Delete")
    assert len(page.marks("push/a")["supports"]["pelvis"]) == 2  # nothing is selected
    page.click((340, 600))
    page.key("Delete")
    assert len(page.marks("push/a")["supports"]["pelvis"]) == 1


def test_pedicles_are_marked_in_a_frame_under_a_push(page):
    """They go to the tracked vertebra, make no mark of it, start no tracking, and are what the file holds."""
    tab, image = page.tab, "push/a"

    tab.run(f"annotation.open('{image}')")
    tab.until(f"annotation.loaded == '{image}'")
    tab.until(f"!!annotation.tracking['{image}']")  # what the server answers does not come afterwards
    page.fill(image)
    tab.run(f"annotation.open('{image}', 1)")
    tab.until(f"annotation.loaded == '{image}/1'")
    tab.run("document.querySelector('[data-tool=pedicle]').click()")
    middle = np.mean(drawn(f"{image}/1").named()["T9"], axis=0)
    page.click(middle + [7.0, 0.0])
    assert "Track through the frames first" in page.text("problem") and page.marks(f"{image}/1") is None
    quads = drawn(f"{image}/1").named()
    record = json.dumps({"vertebrae": quads, "quality": {name: [1, 1, 1, 1] for name in quads}})
    done = f"{{state: 'done', done: 3, total: 3, error: '', frames: [{record}, {record}, {record}]}}"
    tab.run(f"annotation.tracking = {{'{image}': {done}}}; annotation.after()")
    assert page.text("problem") == ""
    # A vertebra is chosen meanwhile: it stays as it was tracked.
    tab.run("annotation.select({kind: 'vertebra', name: 'T5', part: -1})")
    page.click(middle + [7.0, 0.0])
    page.saved()
    assert f"{image}/1" not in page.disk() and "T9 is only guessed yet" in page.text("missing")
    page.click(middle + [-6.0, 1.0])  # on the guessed one: it is chosen where it lies
    page.saved()
    tab.until("!document.getElementById('missing').innerText.includes('guessed')")
    found = page.disk()[f"{image}/1"]
    assert found.vertebrae == {} and list(found.pedicles) == ["T9"]
    np.testing.assert_allclose(found.pedicles["T9"], [middle + [7.0, 0.0], middle + [-7.0, 0.0]], atol=0.06)
    # Tracking would have been asked for as soon as all was saved.
    tab.run("new Promise(done => setTimeout(done, 300))")
    assert tab.run(f"annotation.tracking['{image}'].state") == "done"
    assert "pedicles of 1 marked" in page.text("frame-text")
    # Names that move in the first frame move here, too.
    tab.run(f"annotation.open('{image}')")
    tab.until(f"annotation.loaded == '{image}'")
    tab.run("annotation.visible('T1', false)")
    page.button("names-up")
    page.saved()
    assert list(page.disk()[f"{image}/1"].pedicles) == ["T8"] and "L5" not in page.disk()[image].vertebrae
    # The lateral radiograph shows no left and right.
    tab.run("annotation.open('rest/lateral')")
    tab.until("annotation.loaded == 'rest/lateral'")
    assert not tab.run("!!document.querySelector('[data-tool=pedicle]')")


def test_pedicles_by_keyboard_and_by_finger(page):
    tab, key = page.tab, page.key
    page.fill()
    tab.run("annotation.stage.canvas.focus()")
    tab.run("annotation.select({kind: 'vertebra', name: 'T9', part: -1})")
    key("d")
    middle = page.quad("T9").mean(axis=0)
    np.testing.assert_allclose(tab.run("annotation.cursor"), middle, atol=0.01)
    key("ArrowRight", ALT, times=7)
    key("Enter")
    pair = np.array(page.marks()["pedicles"]["T9"])
    np.testing.assert_allclose(pair, [middle + [7.0, 0.0], middle - [7.0, 0.0]], atol=0.02)
    # The guess is chosen by its key and moved by the arrows; pedicles are stepped through.
    key("6")
    assert page.text("spoken").startswith("T9, right pedicle: column ")
    key("ArrowRight")
    key("ArrowDown", ALT)
    np.testing.assert_allclose(np.array(page.marks()["pedicles"]["T9"]) - pair, [[0, 0], [1.0, 0.1]], atol=0.011)
    key("PageDown")
    assert page.text("spoken").startswith("T9, right pedicle")
    key("2")
    assert page.text("spoken").startswith("T9, superior right corner")
    # A finger that begins 14 pixels beside a pedicle means it.
    key("Escape")
    before = np.array(page.marks()["pedicles"]["T9"])
    tab.run(f"annotation.stage.zoom(3, annotation.stage.toPlace({before[1].tolist()}))")
    x, y = page.place(before[1])
    tab.run("document.querySelector('[data-tool=pedicle]').click()")
    touch(tab, "Start", (x - 14, y))
    touch(tab, "Move", (x - 4, y))
    touch(tab, "Move", (x - 4, y + 12))
    touch(tab, "End")
    moved = np.array(page.marks()["pedicles"]["T9"]) - before
    np.testing.assert_allclose(moved * tab.run("annotation.stage.scale"), [[0, 0], [10, 12]], atol=0.1)
    page.saved()
    np.testing.assert_allclose(page.disk()["rest/frontal"].pedicles["T9"], before + moved)
    tab.run("annotation.select({kind: 'pedicle', name: 'T9', part: 0})")
    key("Delete")
    assert page.marks()["pedicles"] == {}


def test_the_greys_change_by_slider_and_come_back(page):
    def shown():
        page.tab.settle()
        whole = cv2.imdecode(np.frombuffer(page.tab.picture(), np.uint8), cv2.IMREAD_GRAYSCALE).astype(float)
        box = page.tab.run("JSON.parse(JSON.stringify(document.getElementById('stage').getBoundingClientRect()))")
        return whole[
            round(box["top"]) + 40 : round(box["bottom"]) - 9, round(box["left"]) + 9 : round(box["right"]) - 9
        ]

    natural = shown()
    for name in ("level", "width"):
        slider = f"document.getElementById('{name}')"
        page.tab.run(f"{slider}.focus(); {slider}.value = 80; {slider}.dispatchEvent(new Event('input'))")
        assert np.abs(shown() - natural).mean() > 8.0
        page.button("grey")
        assert np.abs(shown() - natural).mean() < 0.5
    assert natural.max() > 200


def test_another_window_is_told_and_destroys_nothing(page):
    page.fill()
    page.served.session.revision = "another"
    page.tab.run("annotation.clearSpine()")
    page.tab.until("document.getElementById('saved').dataset.state == 'failed'")
    assert "another window or program has changed the annotation" in page.text("saved")
    assert list(page.disk()) == ["rest/frontal"]


def test_fingers_drag_corners_add_points_and_zoom(page):
    tab = page.tab
    page.fill()
    before = page.quad("T9")
    x, y = page.place(before[1])
    # A finger 14 pixels beside a corner means it; the corner moves as the finger does.
    touch(tab, "Start", (x - 14, y))
    touch(tab, "Move", (x - 4, y))
    touch(tab, "Move", (x + 6, y))
    touch(tab, "End")
    scale = tab.run("annotation.stage.scale")
    np.testing.assert_allclose(page.quad("T9")[1] - before[1], [20.0 / scale, 0.0], atol=0.06)
    # Two fingers zoom about their middle and change no mark, though the first of them lay on one.
    marks, (x, y) = page.marks(), page.place(page.quad("L2").mean(axis=0))
    touch(tab, "Start", (x, y))
    touch(tab, "Start", (x, y), (x + 60, y))
    for step in range(1, 7):
        touch(tab, "Move", (x - 10 * step, y), (x + 60 + 10 * step, y))
    touch(tab, "End")
    assert page.marks() == marks
    np.testing.assert_allclose(tab.run("annotation.stage.scale") / scale, 3.0, rtol=0.02)
    np.testing.assert_allclose(page.place(page.quad("L2").mean(axis=0)), [x - 60.0, y], atol=3.0)
    # A tap with a tool sets a point, once.
    tab.run("document.querySelector('[data-tool=spine]').click()")
    at = page.place(page.quad("L2").mean(axis=0))
    touch(tab, "Start", at)
    assert page.marks()["spine"] == []
    touch(tab, "End")
    assert len(page.marks()["spine"]) == 1


def test_a_doubtful_corner_stays_in_sight(page):
    """The pixels at a corner are those of the picture, whether it is doubtful or lost; the sign stands outside."""
    tab, image = page.tab, "push/a"

    def shown(quality):
        quads = json.dumps(drawn(f"{image}/1").named("T9"))
        record = f"{{vertebrae: {quads}, quality: {{T9: {json.dumps(quality)}}}}}"
        done = f"{{state: 'done', done: 3, total: 3, error: '', frames: [{record}, {record}, {record}]}}"
        tab.run(f"annotation.tracking = {{'{image}': {done}}}; annotation.after()")
        tab.settle()
        return cv2.imdecode(np.frombuffer(tab.picture(), np.uint8), cv2.IMREAD_COLOR).astype(int)

    tab.run(f"annotation.open('{image}', 1)")
    tab.until("annotation.loaded == annotation.key && annotation.frame == 1")
    tab.until(f"!!annotation.tracking['{image}']")  # what the server answers does not come afterwards
    tab.run("annotation.stage.zoom(3)")
    plain, told = shown([1, 1, 1, 1]), shown([0.01, 0, 1, 1])
    changed = np.abs(told - plain).max(axis=2) > 8
    corners = drawn(f"{image}/1").named("T9")["T9"]
    for corner in corners[:2]:
        x, y = np.rint(page.place(corner)).astype(int)
        assert not changed[y - 4 : y + 5, x - 4 : x + 5].any()
        assert changed[y - 30 : y + 31, x - 30 : x + 31].sum() > 60
    x, y = np.rint(page.place(corners[2])).astype(int)
    assert not changed[y - 8 : y + 9, x - 8 : x + 9].any()


def test_a_small_screen_shows_controls_and_picture_at_once(page):
    """1024 x 600: nothing has to be scrolled to but what is in the columns beside the picture."""
    tab = page.tab
    tab.size(1024, 600)
    for image in ("rest/frontal", "push/a"):
        tab.run(f"annotation.open('{image}')")
        tab.until("annotation.loaded == annotation.key")
        page.fill(image)
        tab.settle()
        _, top, width, height = page.stage()
        assert width >= 550 and height >= 340 and top + height <= 600, image
        scrolled = "[document.documentElement.scrollWidth, document.documentElement.scrollHeight]"
        assert np.all(np.array(tab.run(scrolled)) <= [1024, 600]), image
        # The tools are one line.
        tops = tab.run("[...document.querySelectorAll('[role=toolbar] button')].map(one => one.offsetTop)")
        assert len(set(tops)) == 1, image
        for name in ("undo", "fit", "propose", "missing"):
            box = tab.run(f"JSON.parse(JSON.stringify(document.getElementById('{name}').getBoundingClientRect()))")
            assert box["width"] > 0 and box["bottom"] <= 601 and box["right"] <= 1024, (image, name)


def test_a_large_picture_is_sent_as_the_screen_shows_it_and_finer_where_it_is_zoomed(page):
    tab = page.tab
    tab.size(700, 420)
    tab.run("annotation.open('push/a')")
    tab.until("annotation.loaded == 'push/a'")
    wide, tall = tab.run("annotation.stage.grey.shown")
    assert wide < 448 and tall < 640
    assert tab.run("annotation.stage.size") == [448, 640]
    assert tab.run("annotation.stage.patches.length") == 0
    tab.run("annotation.stage.zoom(6)")
    tab.until("annotation.stage.patches.length == 1")
    left, top, right, bottom = tab.run("annotation.stage.patches[0].grey.part")
    assert tab.run("annotation.stage.patches[0].grey.shown") == [right - left, bottom - top]
    corner = tab.run("annotation.stage.toPixel([0, 0])")
    assert left <= max(0.0, corner[0]) and top <= max(0.0, corner[1])
    # The other frames are fetched meanwhile, and a flip asks for nothing of the picture.
    tab.until("annotation.pictures.kept.size >= 3")
    asked = len([url for url in tab.requests if "/api/radiograph" in url and "part=" not in url])
    tab.run("annotation.open('push/a', 2)")
    tab.until("annotation.loaded == 'push/a/2'")
    assert len([url for url in tab.requests if "/api/radiograph" in url and "part=" not in url]) == asked
    assert tab.run("annotation.stage.patches.length") == 0


def test_a_server_that_does_not_answer_is_told_and_tried_again(page):
    offline = {"latency": 0, "downloadThroughput": -1, "uploadThroughput": -1}
    page.tab.call("Network.emulateNetworkConditions", offline=True, **offline)
    try:
        page.tab.run(
            f"annotation.change(m => ({{...m, vertebrae: {json.dumps(drawn('rest/frontal').named())}}}), 'filled')"
        )
        page.tab.until("document.getElementById('saved').dataset.state == 'failed'")
        assert "Not saved. The server does not answer" in page.text("saved")
        assert not page.served.session.annotation_path.exists()
    finally:
        page.tab.call("Network.emulateNetworkConditions", offline=False, **offline)
    page.saved()
    assert list(page.disk()) == ["rest/frontal"]


def test_light_and_dark_and_twice_the_size(page):
    """200 % zoom leaves half as many pixels of the style sheet: nothing may hang out of them sideways."""
    tab = page.tab
    page.fill()
    for zoom in (1, 2):
        tab.size(1280 // zoom, 800 // zoom)
        for theme in ("light", "dark"):
            tab.theme(theme)
            tab.settle()
            assert tab.run("document.documentElement.scrollWidth <= innerWidth"), (theme, zoom)
            outside = tab.run(
                "[...document.querySelectorAll('button, select, input, canvas, h1, h2, p, li')].filter(e =>"
                " e.offsetParent && !e.closest('.hidden') && e.getBoundingClientRect().right > innerWidth + 0.5)"
                ".map(e => e.id || e.innerText)"
            )
            assert outside == [], (theme, zoom)
            stage = tab.run("JSON.parse(JSON.stringify(document.getElementById('stage').getBoundingClientRect()))")
            assert stage["height"] > 200 and stage["width"] > 400, (theme, zoom)
            background = tab.run("getComputedStyle(document.body).backgroundColor")
            assert (sum(map(int, background[4:-1].split(","))) < 200) == (theme == "dark")
            assert contrast(tab) == [], (theme, zoom)


def contrast(tab):
    """Words whose contrast with what they stand on is below 4.5 (WCAG 2.2, 1.4.3)."""
    return tab.run(
        """(() => {
        const rgb = (text) => text.match(/[\\d.]+/g).map(Number);
        const light = (c) => { const [r, g, b] = c.map((v) => { v /= 255; return v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4; });
            return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
        const ground = (e) => { for (; e; e = e.parentElement) { const c = rgb(getComputedStyle(e).backgroundColor); if (c[3] !== 0) return c.slice(0, 3); } return [255, 255, 255]; };
        return [...document.querySelectorAll('button:enabled, label, p, h1, h2, small, li, summary, output, b')].filter((e) => {
            if (!e.offsetParent || e.closest('.hidden') || !e.innerText.trim() || e.querySelector('button:disabled')) return false;
            const a = light(rgb(getComputedStyle(e).color).slice(0, 3)), b = light(ground(e));
            return (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05) < 4.5; }).map((e) => e.innerText);
        })()"""  # noqa: E501
    )


def test_every_control_has_a_name_and_state(page):
    nameless = page.tab.run(
        "[...document.querySelectorAll('button, select, input, canvas, progress')].filter(e => !("
        "e.getAttribute('aria-label') || e.innerText || e.closest('label')?.innerText.trim())).map(e => e.outerHTML)"
    )
    assert nameless == []
    page.fill()
    # What is complete and what is not is told in words and by a sign, not by colour alone.
    rows = page.tab.run("[...document.querySelectorAll('#images button')].map(b => b.innerText.replace(/\\s+/g, ' '))")
    assert rows == ["✓ Rest, frontal 17 vertebrae", "○ Rest, lateral nothing marked", "○ Push a nothing marked"]


@contextmanager
def intercepted(tab, answer):
    """``fetch`` of the page is ``answer``: a JavaScript function of the address, its options and the real one."""
    tab.run(f"(window.real = fetch.bind(window), window.fetch = (path, given) => ({answer})(path, given, real), 1)")
    try:
        yield
    finally:
        tab.run("(window.fetch = window.real, 1)")


def test_a_radiograph_that_is_not_there_yet_is_not_marked_on_the_one_before(page):
    """Its picture may take a while, or never come: a click on another's is none of its marks."""
    tab = page.tab
    page.fill()
    held = "(path, given, real) => !path.includes('lateral') ? real(path, given)"
    held += " : new Promise((_, no) => { window.lose = no; })"
    at = page.place((200, 300))

    def click():
        tab.run("document.querySelector('[data-tool=spine]').click()")
        tab.drag(at, at)
        tab.settle()
        return (page.marks("rest/lateral") or {"spine": []})["spine"]

    def shown():
        tab.settle()
        whole = cv2.imdecode(np.frombuffer(tab.picture(), np.uint8), cv2.IMREAD_GRAYSCALE)
        left, top, width, height = (round(value) for value in page.stage())
        return int(whole[top + 9 : top + height - 9, left + 9 : left + width - 9].max())

    with intercepted(tab, held):
        tab.run("(annotation.open('rest/lateral'), 1)")
        assert click() == [] and shown() == 0
        tab.run("(lose(new TypeError('lost')), 1)")
        tab.until("document.getElementById('problem').innerText.includes('does not answer')")
        assert click() == [] and shown() == 0
    tab.run("(annotation.open('rest/lateral'), 1)")
    tab.until("annotation.loaded == 'rest/lateral'")
    assert len(click()) == 1 and shown() > 200
    page.saved()


@pytest.mark.parametrize("shape", [(1.4, 1.0), (1.0, 1.25)])
def test_pixels_that_are_not_square_are_shown_as_the_body_is(page, shape):
    """Picture, marks, angles and the window of four times the size, all in the same proportions."""
    tab = page.tab
    path = page.served.session.subject.folder / "rest/frontal.dcm"
    dataset = pydicom.dcmread(path)
    mm = 0.7 * np.array(shape)
    dataset.ImagerPixelSpacing = [round(mm[1], 3), round(mm[0], 3)]
    dataset.save_as(path)
    reload(page)
    tab.until("annotation.loaded == 'rest/frontal'")
    # All white: what is not the radiograph is black.
    tab.run("annotation.stage.setWindow([-65535, 0]); annotation.stage.fit()")
    tab.settle()
    whole = cv2.imdecode(np.frombuffer(tab.picture(), np.uint8), cv2.IMREAD_GRAYSCALE)
    left, top, width, height = (round(value) for value in page.stage())
    corners = np.array([page.place((-0.5, -0.5)), page.place((447.5, 639.5))])
    # Without the outline of what has the focus, and the letters of the sides.
    for line, first, size, there in (
        (whole[top + height // 2], left, width, corners[:, 0]),
        (whole[:, left + width // 2], top, height, corners[:, 1]),
    ):
        inner = np.array([first + 9, first + size - 9])
        (white,) = np.nonzero(line[inner[0] : inner[1]] > 128)
        np.testing.assert_allclose(inner[0] + white[[0, -1]] + [0, 1], np.clip(there, *inner), atol=1.5)
    wide, tall = corners[1] - corners[0]
    assert wide / tall == pytest.approx(448 * shape[0] / (640 * shape[1]), rel=1e-3)
    assert wide <= width + 1 and tall <= height + 1
    page.fill()
    quad = page.quad("T9")
    # Dragged to where it was pointed at, also where it is zoomed about a place.
    at = page.place(quad.mean(axis=0))
    tab.wheel(at, -300.0)
    tab.settle()
    np.testing.assert_allclose(page.place(quad.mean(axis=0)), at, atol=1.0)
    page.drag(quad[1], quad[1] + [5.0, -3.0])
    np.testing.assert_allclose(page.quad("T9")[1], quad[1] + [5.0, -3.0], atol=0.06)
    # A turn keeps a vertebra's sides as long as they are, and turns each by as much.
    before = page.quad("T9")
    page.tab.run("annotation.select({kind: 'vertebra', name: 'T9', part: -1})")
    page.tab.run("for (let i = 0; i < 20; i++) annotation.turnBy(0.5)")
    was, now = ((np.roll(q, -1, axis=0) - q) * mm for q in (before, page.quad("T9")))
    np.testing.assert_allclose(np.linalg.norm(now, axis=1), np.linalg.norm(was, axis=1), atol=0.1)
    turned = np.degrees(np.arctan2(now[:, 1], now[:, 0]) - np.arctan2(was[:, 1], was[:, 0]))
    np.testing.assert_allclose((turned + 180.0) % 360.0 - 180.0, 10.0, atol=0.5)
    page.saved()


def test_a_screen_of_other_sharpness_shows_marks_where_they_are(page):
    """As where a window goes to another monitor: as wide as before, with more pixels of the screen."""
    tab = page.tab
    page.fill()
    tab.settle()
    size = {"width": 1280, "height": 800, "mobile": False}
    try:
        for ratio in (2, 1):
            tab.call("Emulation.setDeviceMetricsOverride", deviceScaleFactor=ratio, **size)
            tab.until(f"devicePixelRatio == {ratio}")
            tab.run("annotation.select({kind: 'vertebra', name: 'T9', part: -1})")
            tab.settle()
            wide, shown = tab.run("[annotation.stage.canvas.width, annotation.stage.canvas.clientWidth]")
            assert wide == ratio * shown
    finally:
        tab.size(1280, 800)


def test_what_is_exported_is_what_is_marked(page):
    """Not what was saved before: a change that is on its way is waited for, and one that is refused is told."""
    tab = page.tab
    page.fill()
    kept = "async (path, given, real) => { const found = await real(path, given);"
    kept += " if (path.includes('export')) window.exported = await found.clone().text(); return found; }"
    with intercepted(tab, kept):
        tab.run("(annotation.visible('T6', false), document.getElementById('export-csv').click(), 1)")
        tab.until("!!window.exported")
        assert "T5" in tab.run("exported") and "T6" not in tab.run("exported")
        tab.run("(window.exported = '', 1)")
        page.saved()
        page.served.session.revision = "another"
        tab.run("annotation.visible('T5', false)")
        tab.until("document.getElementById('saved').dataset.state == 'failed'")
        page.button("export-csv")
        tab.until("document.getElementById('problem').innerText.includes('another window or program')")
        assert tab.run("exported") == ""


def test_marks_that_were_put_right_while_others_were_refused_are_saved(page):
    tab = page.tab
    refused = "async (path, given, real) => { if (given?.method != 'PUT' || window.told) return real(path, given);"
    refused += " window.told = true; await new Promise(done => { window.answer = done; });"
    refused += ' return new Response(\'{"error": "too many points"}\', {status: 422}); }'
    with intercepted(tab, refused):
        tab.run("annotation.change(marks => ({...marks, spine: [[9, 9]]}), 'filled')")
        tab.until("!!window.answer")
        tab.run("annotation.change(marks => ({...marks, spine: [[9, 9], [10, 10]]}), 'filled')")
        tab.run("new Promise(done => setTimeout(done, 300))")
        tab.run("(answer(), 1)")
        page.saved()
    assert len(page.served.session.marks["rest/frontal"].spine) == 2


@pytest.mark.parametrize("lose", ["throw new TypeError()", "return new Response('', {status: 504})"])
def test_marks_whose_answer_was_lost_are_no_conflict_with_themselves(page, lose):
    """The server wrote them: what is marked meanwhile is saved, and nobody is told of another window."""
    tab = page.tab
    lost = "async (path, given, real) => { const found = await real(path, given);"
    lost += " if (given?.method == 'PUT') window.lost = (window.lost ?? 0) + 1;"
    lost += f" if (given?.method == 'PUT' && lost <= 2) {{ {lose}; }} return found; }}"
    with intercepted(tab, lost):
        tab.run("annotation.change(marks => ({...marks, spine: [[9, 9]]}), 'filled')")
        tab.until("document.getElementById('saved').dataset.state == 'failed'")
        assert len(page.served.session.marks["rest/frontal"].spine) == 1
        tab.run("annotation.change(marks => ({...marks, spine: [[9, 9], [10, 10]]}), 'filled')")
        page.saved()
    assert tab.run("lost") >= 3 and len(page.served.session.marks["rest/frontal"].spine) == 2


def test_tracking_is_asked_for_again_where_the_server_did_not_answer_once(page):
    tab, image = page.tab, "push/a"
    tab.run(f"(annotation.open('{image}'), 1)")
    tab.until(f"annotation.loaded == '{image}' && annotation.tracking['{image}']?.state == 'none'")
    lost = "(path, given, real) => !path.includes('api/track') || window.lost ? real(path, given)"
    lost += " : (window.lost = true, Promise.reject(new TypeError()))"
    with intercepted(tab, lost):
        tab.run(f"annotation.watch('{image}', {{state: 'running', done: 0, total: 3, error: '', frames: []}})")
        assert tab.run("document.getElementById('track').disabled")
        tab.until("!!window.lost")
        tab.until("!document.getElementById('track').disabled", 10.0)
    refused = "async (path, given, real) => !path.includes('api/track') ? real(path, given)"
    refused += ' : new Response(\'{"error": "gone"}\', {status: 404})'
    with intercepted(tab, refused):
        tab.run(f"annotation.watch('{image}', {{state: 'running', done: 0, total: 3, error: '', frames: []}})")
        tab.until("!document.getElementById('track').disabled", 10.0)
        assert page.text("problem") == "gone"


def test_a_correction_that_is_taken_back_is_tracked_no_longer(page):
    tab, image = page.tab, "push/a"
    tab.run(f"(annotation.open('{image}'), 1)")
    tab.until(f"annotation.loaded == '{image}'")
    page.fill(image)
    page.button("track")
    tab.until(f"annotation.tracking['{image}']?.state == 'done'", 60.0)
    page.button("frame-on")
    tab.until(f"annotation.loaded == '{image}/1' && annotation.tracked")
    before = np.array(tab.run("annotation.tracked.vertebrae.T9"))
    tab.drag(page.place(before[0]), page.place(before[0] + [8.0, 0.0]))
    tab.until(f"annotation.tracking['{image}'].state == 'running'")
    tab.until(f"annotation.tracking['{image}'].state == 'done'", 60.0)
    assert np.abs(np.array(tab.run("annotation.seen.vertebrae.T9")) - before).max() > 7.0
    page.key("z", CTRL)
    tab.until(f"annotation.tracking['{image}'].state == 'running'")
    tab.until(f"annotation.tracking['{image}'].state == 'done'", 60.0)
    np.testing.assert_allclose(tab.run("annotation.seen.vertebrae.T9"), before, atol=0.06)
    # Other names that are taken back are tracked likewise.
    page.button("frame-back")
    tab.until(f"annotation.loaded == '{image}'")
    tab.run("annotation.visible('T1', false)")
    for name in ("names-up", "undo"):
        page.button(name)
        tab.until(f"annotation.tracking['{image}'].state == 'running'")
        tab.until(f"annotation.tracking['{image}'].state == 'done'", 60.0)
        tracked = set(tab.run(f"Object.keys(annotation.tracking['{image}'].frames[1].vertebrae)"))
        assert tracked == set(tab.run("Object.keys(annotation.marks.vertebrae)"))


def test_frames_are_tracked_anew_once_the_first_ones_marks_change(page):
    tab, image = page.tab, "push/a"
    tab.run(f"(annotation.open('{image}'), 1)")
    tab.until(f"annotation.loaded == '{image}'")
    page.fill(image)
    page.button("track")
    tab.until(f"annotation.tracking['{image}']?.state == 'done'", 60.0)
    held = "async (path, given, real) => { if (path == 'api/track') await new Promise(done => { window.go = done; });"
    held += " return real(path, given); }"
    corner = page.quad("T9", image)[0]
    with intercepted(tab, held):
        page.drag(corner, corner + [8.0, 0.0])
        tab.until("!!window.go")
        page.button("frame-on")
        tab.until(f"annotation.loaded == '{image}/1' && annotation.tracked")
        tab.until("!annotation.judging")
        assert page.text("frame-text").endswith("training: tracked before the last change, being tracked anew")
        assert page.text("cobb") == "Read once it is tracked."
        tab.run("(go(), 1)")
        tab.until(f"annotation.tracking['{image}'].state == 'done'", 60.0)
    assert "before the last change" not in page.text("frame-text")
    tab.until("annotation.cobb && !annotation.judging")

    def tracked_there():
        return tab.run(f"annotation.tracking['{image}'].frames[0].vertebrae.T9[0]")

    np.testing.assert_allclose(tracked_there(), corner + [8.0, 0.0], atol=0.06)
    # So it is with a change that is taken back. Where nothing can be tracked, nothing is shown, until it can be.
    page.button("undo")
    tab.until(f"annotation.tracking['{image}'].state == 'running'")
    tab.until(f"annotation.tracking['{image}'].state == 'done'", 60.0)
    np.testing.assert_allclose(tracked_there(), corner, atol=0.06)
    few = "Object.fromEntries(Object.entries(marks.vertebrae).slice(0, 7))"
    tab.run(f"annotation.change(marks => ({{...marks, vertebrae: {few}}}), 'only seven')")
    tab.until(f"annotation.tracking['{image}'].state == 'none'")
    assert page.text("problem").endswith("before its first frame is complete: 7 vertebrae, wanted at least 8")
    tab.run(f"(annotation.open('{image}', 1), 1)")
    tab.until(f"annotation.loaded == '{image}/1'")
    assert not tab.run("annotation.tracked") and page.text("frame-text").endswith("training: not tracked yet")
    page.button("undo")
    tab.until(f"annotation.tracking['{image}'].state == 'done'", 60.0)
    np.testing.assert_allclose(tracked_there(), corner, atol=0.06)
    # A reload finds what was tracked from the marks that there are.
    page.saved()
    reload(page)
    tab.run(f"(annotation.open('{image}'), 1)")
    tab.until(f"annotation.tracking['{image}']?.state == 'done'")


def test_no_points_for_a_proposal_come_into_a_later_frame(page):
    """By the key, as by the button."""
    tab, image = page.tab, "push/a"
    tab.run(f"(annotation.open('{image}', 1), 1)")
    tab.until(f"annotation.loaded == '{image}/1'")
    tab.run("document.getElementById('stage').focus()")
    page.key("o")
    page.click((100, 100))
    assert tab.run("annotation.tool") == "move" and page.marks(f"{image}/1") is None
    assert "first frame" in page.text("spoken")


def test_a_vertebra_comes_back_at_no_other_ones_place(page):
    """What was L5 has another name by now: its place is not where the new L5 is."""
    page.fill()
    was = {name: page.quad(name).mean(axis=0) for name in ("L3", "L4", "L5")}
    page.tab.run("annotation.visible('T1', false)")
    page.tab.run("annotation.visible('L5', false)")
    page.button("names-up")
    page.tab.run("annotation.visible('L5', true)")
    # L4 is L3 by now: L5 is the second below it.
    expected = was["L4"] + 2.0 * (was["L4"] - was["L3"])
    assert np.linalg.norm(page.quad("L5").mean(axis=0) - expected) < 0.3 * np.linalg.norm(was["L4"] - was["L3"])
    page.saved()


def test_the_angle_is_that_of_what_was_tracked_last(page):
    """New corners may come while the angle of those before is being read."""
    tab, image = page.tab, "push/a"
    tab.run(f"(annotation.open('{image}', 1), 1)")
    tab.until(f"annotation.loaded == '{image}/1'")
    tab.until(f"!!annotation.tracking['{image}']")  # what the server answers does not come afterwards

    def track(turned):
        quads = {
            name: (np.array(quad) + [turned * row, 0.0]).tolist()
            for row, (name, quad) in enumerate(drawn(f"{image}/1").named().items())
        }
        record = json.dumps({"vertebrae": quads, "quality": {name: [1, 1, 1, 1] for name in quads}})
        done = f"{{state: 'done', done: 3, total: 3, error: '', frames: [{record}, {record}, {record}]}}"
        tab.run(f"annotation.tracking = {{'{image}': {done}}}; annotation.after()")

    held = "async (path, given, real) => { const found = await real(path, given);"
    held += " if (path == 'api/judge' && !window.release) await new Promise(done => { window.release = done; });"
    held += " if (path == 'api/judge') window.judged = JSON.parse(given.body).marks.vertebrae.T9[0]; return found; }"
    tab.until("!annotation.judging")
    with intercepted(tab, held):
        track(0.0)
        tab.until("!!window.release")
        track(2.0)
        tab.run("(release(), 1)")
        tab.until("!annotation.judging")
        tab.run("new Promise(done => setTimeout(done, 300))")
        tab.until("!annotation.judging")
        assert tab.run("judged") == tab.run("annotation.tracked.vertebrae.T9[0]")


def test_an_angle_that_could_not_be_read_is_not_put_down_to_too_few_vertebrae(page):
    page.fill()
    page.tab.until("annotation.cobb && !annotation.judging")
    lost = "(path, given, real) => path == 'api/judge' ? Promise.reject(new TypeError()) : real(path, given)"
    with intercepted(page.tab, lost):
        page.tab.run("annotation.after()")
        page.tab.until("!annotation.cobb && !annotation.judging")
        assert "two vertebrae" not in page.text("cobb") and "does not answer" in page.text("cobb")
    page.saved()


def test_the_address_of_another_start_is_taken_in_a_tab_that_is_open(page):
    """It differs by what stands behind the "#" alone, so that the browser loads nothing by itself."""
    tab = page.tab
    tab.run("(sessionStorage.setItem('spinestiff-token', 'of-a-start-that-is-over-by-now'), 1)")
    tab.loaded = False
    tab.run(f"(location.hash = {json.dumps(page.served.token)}, 1)")
    tab.wait(lambda: tab.loaded)
    tab.until("document.body.dataset.state == 'open'")
    assert "#" not in tab.run("location.href")


def test_no_angle_of_another_radiograph_stands_beside_one(page):
    """The first reading of a radiograph may take a while."""
    tab = page.tab
    page.fill()
    tab.until("annotation.cobb && !annotation.judging")
    assert "°" in page.text("cobb")
    held = "(path, given, real) => path != 'api/judge' ? real(path, given)"
    held += " : new Promise(done => { window.release = () => done(real(path, given)); })"
    with intercepted(tab, held):
        tab.run("(annotation.open('push/a'), 1)")
        tab.until("annotation.loaded == 'push/a'")
        page.fill("push/a")
        tab.until("!!window.release")
        assert "°" not in page.text("cobb")
        tab.run("(release(), 1)")
    tab.until("!annotation.judging && annotation.cobb")
    assert "°" in page.text("cobb")
