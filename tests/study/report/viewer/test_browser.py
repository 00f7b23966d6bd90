"""The viewer in a headless Chromium: what it draws is what was solved, by mouse, keyboard and without WebGL."""

from __future__ import annotations

import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from chromium import WEBGL, Tab, browser
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.template import template_torso
from spinestiff.imaging.projection import frontal_view
from spinestiff.mechanics.loads import LoadCase
from spinestiff.study.report.viewer.page import view_page
from spinestiff.study.report.viewer.scene import Frame, PushScene, Scene, Step, visit_scene

pytestmark = pytest.mark.skipif(
    browser() is None or sys.platform == "win32", reason="no Chromium to open the viewer in, or no pipe to drive it by"
)

VIEWER = "document.querySelector('[data-viewer]')"


def show(tab, path, scene):
    path.write_text(view_page(scene), encoding="utf-8")
    opened(tab, path)


def opened(tab, path):
    tab.open(path)
    tab.until(f"['drawn', 'no picture'].includes({VIEWER}.dataset.state)", 60.0)
    tab.settle()


def pixels(tab):
    """(rows, columns, 3), what the window shows of the stage."""
    tab.settle()
    whole = cv2.imdecode(np.frombuffer(tab.picture(), np.uint8), cv2.IMREAD_COLOR).astype(int)
    box = tab.run(f"JSON.parse(JSON.stringify({VIEWER}.querySelector('.v-stage').getBoundingClientRect()))")
    return whole[round(box["top"]) + 4 : round(box["bottom"]) - 4, round(box["left"]) + 4 : round(box["right"]) - 4]


def different(a, b):
    """Share of pixels that differ by more than a shade."""
    return float(np.mean(np.abs(a - b).max(-1) > 12))


def bone(tab, name):
    found = tab.run(f"{VIEWER}.viewer.bone('{name}')")
    return np.array(found["place"]), Rotation.from_quat(found["turn"])


def text(tab, role):
    return tab.run(f"{VIEWER}.querySelector('[data-role={role}]').innerText")


@pytest.fixture(scope="module")
def tab(tmp_path_factory):
    with Tab(tmp_path_factory.mktemp("profile"), flags=WEBGL) as one:
        yield one


BEGIN = f"""(() => {{
  const viewer = {VIEWER}, choose = one => one.dispatchEvent(new Event('change'));
  document.activeElement.blur();
  viewer.querySelector('.v-table').open = false;
  for (const box of viewer.querySelectorAll('[data-show]'))
    if (box.checked != box.defaultChecked) box.click();
  for (const role of ['push', 'model']) {{
    const select = viewer.querySelector(`[data-role=${{role}}]`);
    select.selectedIndex = 0;
    choose(select);
  }}
  viewer.viewer.show('front');
  scrollTo(0, 0);
}})()"""


@pytest.fixture(scope="module")
def page(viewed, tmp_path_factory):
    """The file of the finished subject's viewer."""
    path = tmp_path_factory.mktemp("viewer") / "view.html"
    path.write_text(view_page(viewed.scene), encoding="utf-8")
    return path


@pytest.fixture
def shown(tab, viewed, page):
    """The finished subject's viewer as it is when it was opened: drawing it takes longer than most of what is asked."""
    if tab.run("location.href") == page.as_uri():
        tab.run(BEGIN)
        tab.settle()
    else:
        opened(tab, page)
    return viewed


def test_it_draws_without_complaint_or_request(tab, page):
    tab.requests.clear()
    tab.complaints.clear()
    opened(tab, page)
    assert tab.run(f"{VIEWER}.dataset.state") == "drawn"
    assert tab.complaints == []
    assert tab.requests == [page.as_uri()]
    stage = pixels(tab)
    background = stage[-3, 3]
    drawn = np.abs(stage - background).max(-1) > 12
    # The torso fills a good part of the picture, and its middle.
    assert 0.1 < drawn.mean() < 0.8
    rows, columns = np.nonzero(drawn)
    assert abs(columns.mean() / drawn.shape[1] - 0.5) < 0.1 and abs(rows.mean() / drawn.shape[0] - 0.5) < 0.1
    # Nothing is cut off.
    assert not drawn[-1].any() and not drawn[30:, 0].any() and not drawn[30:, -1].any()


def test_bones_stand_where_the_equilibrium_has_them(tab, shown):
    torso = shown.predictions.pushes.torso
    for model, steps in shown.scene.pushes[0].models.items():
        tab.run(f"{{ const s = {VIEWER}.querySelector('[data-role=model]'); s.value = '{model}';"
                "s.dispatchEvent(new Event('change')); }")  # fmt: skip
        for step in steps:
            tab.run(f"{VIEWER}.viewer.setForce({step.force_n})")
            for name in ("T8", "pelvis", "R9_L"):
                place, turn = bone(tab, name)
                index, told = torso.bone(name), f"{model}, {step.force_n} N, {name}"
                np.testing.assert_allclose(place, step.state.bone_positions[index], atol=1e-3, err_msg=told)
                wanted = step.state.bone_rotations[index]
                np.testing.assert_allclose(turn.as_matrix(), wanted, atol=1e-5, err_msg=told)
            assert text(tab, "force-text") == f"{step.force_n:g} N"


def test_between_two_steps_bones_turn_by_slerp(tab, shown):
    before, after = shown.scene.pushes[0].models["fit"][-2:]
    force = 0.25 * before.force_n + 0.75 * after.force_n
    force = round(2.0 * force) / 2.0
    share = (force - before.force_n) / (after.force_n - before.force_n)
    assert 0.5 < share < 0.9
    tab.run(f"{VIEWER}.viewer.setForce({force})")
    index = shown.predictions.pushes.torso.bone("R9_L")
    place, turn = bone(tab, "R9_L")
    ends = [step.state for step in (before, after)]
    expected = (1 - share) * ends[0].bone_positions[index] + share * ends[1].bone_positions[index]
    np.testing.assert_allclose(place, expected, atol=1e-3)
    rotation = Slerp([0.0, 1.0], Rotation.from_matrix([s.bone_rotations[index] for s in ends]))(share)
    np.testing.assert_allclose(turn.as_matrix(), rotation.as_matrix(), atol=1e-5)
    # Nothing was measured there.
    assert "between" in text(tab, "frame-text") and "–" in text(tab, "facts").split("\n")


def test_the_slider_moves_the_picture_and_the_numbers(tab, shown):
    full = pixels(tab)
    frame = shown.scene.pushes[0].frames[-1]
    assert f"{frame.rmse_mm['fit']:.1f} mm" in text(tab, "facts")
    assert "held out" in text(tab, "frame-text")
    tab.run(f"{VIEWER}.viewer.setForce(0)")
    rest = pixels(tab)
    assert different(full, rest) > 0.02
    assert text(tab, "force-text") == "0 N" and "at rest" in text(tab, "frame-text")
    tab.run(f"{VIEWER}.viewer.setForce({frame.force_n})")
    # Not one pixel but what lies on an edge.
    assert different(full, pixels(tab)) < 1e-3


def test_the_keyboard_reaches_everything(tab, shown):
    tab.run(f"{VIEWER}.querySelector('[data-role=force]').focus()")
    tab.press("Home")
    assert text(tab, "force-text") == "0 N"
    tab.press("ArrowRight", 3)
    assert text(tab, "force-text") == "1.5 N"
    assert "1.5 N, between 0 N and" in tab.run(
        f"{VIEWER}.querySelector('[data-role=force]').getAttribute('aria-valuetext')"
    )
    tab.press("End")
    assert text(tab, "force-text") == "30 N"
    tab.run(f"{VIEWER}.querySelector('canvas').focus()")
    front = pixels(tab)
    assert (text(tab, "side-left"), text(tab, "side-right")) == ("R", "L")
    tab.press("ArrowRight", 9)
    turned = pixels(tab)
    assert different(front, turned) > 0.05
    # The viewer has gone round to the patient's left.
    assert (text(tab, "side-left"), text(tab, "side-right")) == ("A", "P")
    reached = []
    tab.run(f"{VIEWER}.querySelector('canvas').focus()")
    for _ in range(25):
        tab.press("Tab")
        reached.append(tab.run("document.activeElement.dataset.role || document.activeElement.dataset.view "
                               "|| document.activeElement.dataset.show || document.activeElement.tagName"))  # fmt: skip
    assert {"force", "before", "push", "model", "front", "tube", "bones", "simulated", "SUMMARY"} <= set(reached)


def test_the_mouse_turns_the_torso_and_zooms_once_it_was_chosen(tab, shown):
    front = pixels(tab)
    box = tab.run(f"JSON.parse(JSON.stringify({VIEWER}.querySelector('canvas').getBoundingClientRect()))")
    middle = (box["left"] + 0.5 * box["width"], box["top"] + 0.5 * box["height"])
    tab.run("document.activeElement.blur()")
    tab.wheel(middle, 40.0)
    # The page would scroll; the torso does not grow.
    assert different(front, pixels(tab)) < 1e-3
    tab.run("scrollTo(0, 0)")
    tab.drag(middle, (middle[0] + 0.25 * box["height"], middle[1]))
    assert different(front, pixels(tab)) > 0.05
    # A quarter of the height is a quarter of a turn; dragged to the right, the patient's right comes to the front.
    assert (text(tab, "side-left"), text(tab, "side-right")) == ("P", "A")
    assert "Turned" in text(tab, "caption")
    side = pixels(tab)
    tab.wheel(middle, -200.0)
    tab.run("new Promise(done => setTimeout(done, 200))")
    assert different(side, pixels(tab)) > 0.02


def test_views_say_which_side_is_which(tab, shown):
    for view, sides in {"front": "RL", "right": "PA", "rear": "LR", "left": "AP", "tube": "RL"}.items():
        tab.run(f"{VIEWER}.querySelector('[data-view={view}]').click()")
        tab.settle()
        assert text(tab, "side-left") + text(tab, "side-right") == sides, view
        assert len(text(tab, "caption")) > 30, view
        pressed = tab.run(f"[...{VIEWER}.querySelectorAll('[aria-pressed=true]')].map(b => b.dataset.view)")
        assert pressed == [view]
        # The pushed side's arrow points into the torso from there.
        label = tab.run(f"{VIEWER}.querySelector('.v-of-load').getBoundingClientRect().left")
        middle = tab.run(f"(b => (b.left + b.right) / 2)({VIEWER}.querySelector('canvas').getBoundingClientRect())")
        if view in ("front", "rear", "tube"):
            side = shown.scene.pushes[0].side[0].upper()
            assert (label > middle) == (sides.index(side) == 1), view


def test_each_layer_can_be_switched(tab, shown):
    before = pixels(tab)
    for layer in ("bones", "skin", "joints", "levels", "loads", "supports", "measured", "simulated", "rest"):
        toggle = f"{VIEWER}.querySelector('[data-show={layer}]').click()"
        tab.run(toggle)
        assert different(before, pixels(tab)) > 2e-4, layer
        tab.run(toggle)
        assert different(before, pixels(tab)) < 2e-4, layer


def test_measured_and_simulated_lie_on_the_bones_seen_from_the_tube(tab, shown):
    """Seen along the rays, the simulated outlines stand on the model's own vertebrae."""
    tab.run(f"{VIEWER}.querySelector('[data-view=tube]').click()")
    for name in ("bones", "skin", "levels", "loads", "supports", "measured"):
        tab.run(f"{VIEWER}.querySelector('[data-show={name}]').click()")
    lines = np.abs(pixels(tab) - pixels(tab)[-3, 3]).max(-1) > 60
    tab.run(f"{VIEWER}.querySelector('[data-show=simulated]').click()")
    tab.run(f"{VIEWER}.querySelector('[data-show=bones]').click()")
    bones = np.abs(pixels(tab) - pixels(tab)[-3, 3]).max(-1) > 20
    assert lines.sum() > 500
    near = cv2.dilate(bones.astype(np.uint8), np.ones((5, 5))).astype(bool)
    assert np.mean(near[lines]) > 0.97


def test_frames_are_stepped_through(tab, shown):
    click = f"{VIEWER}.querySelector('[data-role={{}}]').click()"
    seen = [tab.run(f"{VIEWER}.dataset.frame")]
    for _ in range(4):
        tab.run(click.format("before"))
        seen.append(tab.run(f"{VIEWER}.dataset.frame"))
    assert seen == ["3", "2", "1", "0", "0"]
    assert tab.run(f"{VIEWER}.querySelector('[data-role=before]').disabled")
    tab.run(click.format("after"))
    assert tab.run(f"{VIEWER}.dataset.frame") == "1"


def test_another_push_brings_its_own_frames(tab, shown):
    tab.run(f"{{ const s = {VIEWER}.querySelector('[data-role=push]'); s.value = 'second';"
            "s.dispatchEvent(new Event('change')); }")  # fmt: skip
    second = shown.scene.pushes[1]
    assert f"{second.frames[-1].rmse_mm['fit']:.1f} mm" in text(tab, "facts")
    step = second.models["fit"][-1]
    index = shown.predictions.pushes.torso.bone("T8")
    np.testing.assert_allclose(bone(tab, "T8")[0], step.state.bone_positions[index], atol=1e-3)


def test_the_picture_lies_on_no_row_of_the_table_however_far_one_scrolls(tab, shown):
    tab.run(f"{VIEWER}.querySelector('.v-table').open = true")
    tab.run("document.body.style.paddingBottom = '2000px'")
    below = (
        "(() => { const box = one => document.querySelector(one).getBoundingClientRect(); "
        "return box('.v-table').top - box('.v-stage').bottom; })()"
    )
    for share in (0.0, 0.2, 0.4, 0.6, 0.8, 1.0):
        tab.run(f"scrollTo(0, {share} * (box => box.top + scrollY + box.height)("
                "document.querySelector('.v-table').getBoundingClientRect()))")  # fmt: skip
        assert tab.run(below) >= 0.0, share
    tab.run("document.body.style.paddingBottom = ''; scrollTo(0, 0)")


def test_dark_and_narrow(tab, shown):
    light = pixels(tab)
    tab.theme("dark")
    dark = pixels(tab)
    assert light[-3, 3].min() > 200 and dark[-3, 3].max() < 60
    tab.theme("light")
    tab.size(390, 844)
    tab.settle()
    assert tab.run("document.documentElement.scrollWidth") <= 390
    stage = pixels(tab)
    assert 0.08 < np.mean(np.abs(stage - stage[-3, 3]).max(-1) > 12) < 0.8
    tab.size(1280, 800)


def test_pedicles_markers_and_further_views_are_drawn_and_seen_from_their_sides(tab, beside, tmp_path):
    def without(scene, **parts):
        (push,) = scene.pushes
        frames = tuple(replace(frame, beside=replace(frame.beside, **parts)) for frame in push.frames)
        return replace(scene, pushes=(replace(push, frames=frames),))

    scene = visit_scene("seen from all sides", beside, {"main": ("left", 8.0)})
    marked = without(scene, outlines={})
    pedicles = without(marked, markers={})
    counts = {"front": [], "right": []}
    for shown in (without(pedicles, pedicles={}), pedicles, marked, scene):
        show(tab, tmp_path / "view.html", shown)
        for layer in ("bones", "skin", "levels", "loads", "supports", "simulated"):
            tab.run(f"{VIEWER}.querySelector('[data-show={layer}]').click()")
        for side, found in counts.items():
            tab.run(f"{VIEWER}.querySelector('[data-view={side}]').click()")
            stage = pixels(tab)
            found.append(int((np.abs(stage - stage[-3, 3]).max(-1) > 60).sum()))
    # Whatever is shown, letters say which side is which.
    letters, pedicles, crosses, outlines = counts["right"]
    assert pedicles == letters and letters + 50 < crosses < outlines - 500
    frontal, pedicles, crosses, aside = counts["front"]
    assert letters + 500 < frontal < pedicles - 50 and pedicles < crosses - 50 and aside == crosses


def test_a_torso_alone_is_drawn(tab, tmp_path):
    tab.complaints.clear()
    show(tab, tmp_path / "torso.html", Scene("template", template_torso(157.0)))
    stage = pixels(tab)
    assert tab.complaints == [] and np.mean(np.abs(stage - stage[-3, 3]).max(-1) > 12) > 0.1


def test_a_hostile_name_stays_text(tab, viewed, tmp_path):
    tab.complaints.clear()
    hostile = "</script><script>window.hostile = 1</script><img src=x onerror='window.hostile = 1'>"
    pushes = tuple(replace(p, push=f"{hostile}{p.push}") for p in viewed.scene.pushes)
    show(tab, tmp_path / "hostile.html", replace(viewed.scene, title=hostile, note=hostile, pushes=pushes))
    assert tab.run(f"{VIEWER}.dataset.state") == "drawn"
    assert tab.run("window.hostile === undefined")
    assert hostile in tab.run("document.querySelector('h1').innerText")
    assert tab.complaints == []


def test_the_policy_is_in_force(tab, viewed, tmp_path):
    path = tmp_path / "changed.html"
    html = view_page(viewed.scene).replace("</main>", "</main><script>window.foreign = 1</script>")
    path.write_text(html, encoding="utf-8")
    tab.complaints.clear()
    tab.open(path)
    assert tab.run("window.foreign === undefined")
    assert any("Content Security Policy" in line for line in tab.complaints)


def test_without_webgl_the_numbers_remain(viewed, tmp_path):
    with Tab(tmp_path / "profile", flags=("--disable-3d-apis",)) as tab:
        show(tab, tmp_path / "view.html", viewed.scene)
        assert tab.run(f"{VIEWER}.dataset.state") == "no picture"
        assert "can’t draw in 3D" in text(tab, "message")
        tab.run(f"{VIEWER}.viewer.setForce(0)")
        assert text(tab, "force-text") == "0 N"
        step = viewed.scene.pushes[0].models["fit"][0]
        np.testing.assert_allclose(
            bone(tab, "T8")[0], step.state.bone_positions[viewed.predictions.pushes.torso.bone("T8")], atol=1e-3
        )


def test_frames_of_nearly_the_same_force_are_all_stepped_through(tab, tmp_path):
    """A gauge tells a force that is held to a tenth of a newton; the slider's steps are wider."""
    torso = template_torso(157.0)
    rest, nothing = torso.rest_pose, np.zeros((0, 4, 2))
    forces = (0.0, 10.0, 30.0, 30.2)
    push = PushScene(
        "main",
        "right",
        8.0,
        frontal_view(),
        LoadCase(PointsOnBones([torso.bone("R8_R")], [[0.0, 0.0, 0.0]]), [[1.0, 0.0, 0.0]]),
        (),
        tuple(Frame(i, force, "training", (), nothing, {"fit": 1.0}) for i, force in enumerate(forces)),
        {"fit": tuple(Step(force, i, rest, (), nothing, np.zeros((0, 3))) for i, force in enumerate(forces))},
    )
    show(tab, tmp_path / "view.html", Scene("template", torso, (push,)))
    seen = [tab.run(f"{VIEWER}.dataset.frame + ', ' + {VIEWER}.dataset.force")]
    for role in ["before"] * 3 + ["after"] * 3:
        tab.run(f"{VIEWER}.querySelector('[data-role={role}]').click()")
        seen.append(tab.run(f"{VIEWER}.dataset.frame + ', ' + {VIEWER}.dataset.force"))
    assert seen == ["3, 30.2", "2, 30", "1, 10", "0, 0", "1, 10", "2, 30", "3, 30.2"]
