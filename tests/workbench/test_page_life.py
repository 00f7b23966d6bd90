"""The workbench's page when things happen around it: a killed server, a second window, nobody's mouse."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from contextlib import contextmanager

import numpy as np
import pytest

from bench_page import click, fill, go, load, reach, text, typed
from chromium import Tab, browser
from spinestiff.annotate.draft import DraftImage
from spinestiff.files import read_json
from spinestiff.loopback.serving import listening
from spinestiff.subject.annotation_record import Annotation
from spinestiff.subject.folder import read_annotation, read_subject, write_annotation
from unannotated import drawn

pytestmark = pytest.mark.skipif(
    browser() is None or sys.platform == "win32", reason="no Chromium to open the page in, or no pipe to drive it by"
)
PROGRAM = [sys.executable, "-c", "from spinestiff.app.cli import main; main()", "serve"]
SHAPING = "document.querySelector('.steps [data-kind=now]')?.innerText.includes('Shape the torso')"
SPINE = ("T1", "T5", "T9", "L1", "L5")


@contextmanager
def program(root, port):
    """``spinestiff serve`` in a process of its own, and its address; killed at the end."""
    running = subprocess.Popen(
        [*PROGRAM, str(root), "--no-browser", f"--port={port}"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        address = re.fullmatch(r"serve: (\S+)\n", running.stdout.readline()).group(1)
        yield running, address
    finally:
        running.kill()
        running.communicate()


@pytest.mark.slow
def test_a_server_that_is_killed_in_the_middle_of_a_job_and_started_again(tab, root):
    images = {name: drawn(name) for name in ("rest/frontal", "rest/lateral", "push/a")}
    whole = {name: DraftImage.model_validate({"vertebrae": shown.named()}).whole() for name, shown in images.items()}
    write_annotation(root / "girl", Annotation(schema_version=1, images=whole))
    with listening(0) as sock:
        port = sock.getsockname()[1]
    with program(root, port) as (running, address):
        load(tab, address)
        click(tab, ".card a.main")
        click(tab, "#start-run")
        tab.until(SHAPING, 90)
        running.kill()
        running.wait()
        tab.until("document.querySelector('#problem').innerText.includes('The job goes on')")
    with program(root, port) as (_, address):
        # The window that was left open is of another start; the new address shows the job as it goes on.
        tab.until("document.querySelector('#problem').innerText.includes('spinestiff serve printed last')")
        load(tab, address)
        assert "Running" in text(tab)
        click(tab, ".card a.main")
        tab.until(SHAPING, 30)
        click(tab, "#cancel")
        tab.until("document.querySelector('.live')?.dataset.state == 'cancelled'", 30)
    assert (root / "girl" / "results" / "tracked.json").exists()


def test_two_windows_on_one_subject(tab, root, served, tmp_path):
    """What one window has saved the other does not overwrite; a job that one has started the other shows."""
    place = f"/subject/{served.key()}"
    with Tab(tmp_path / "second") as other:
        for window in (tab, other):
            load(window, served.address)
            go(window, f"{place}/values")
        fill(tab, "#f-height-cm", "150")
        tab.until("document.querySelector('.saved').innerText.startsWith('Saved')")
        fill(other, "#f-age", "14")
        other.until("document.querySelector('.saved').innerText.startsWith('Not saved')")
        assert "was changed meanwhile, in another window" in text(other, ".saved")
        values = read_json(root / "girl" / "subject.json")
        assert (values["height_cm"], values["age"]) == (150, 13)
        click(other, "#reload-values")
        other.until("document.querySelector('#f-height-cm').value == '150'")
        fill(other, "#f-age", "14")
        other.until("document.querySelector('.saved').innerText.startsWith('Saved')")
        values = read_json(root / "girl" / "subject.json")
        assert (values["height_cm"], values["age"]) == (150, 14)
        for window in (tab, other):
            go(window, f"{place}/run")
        click(tab, "#start-run")
        tab.until("document.querySelector('.live')?.dataset.state == 'waiting'")
        click(other, "#start-run")
        other.until("document.querySelector('#problem').innerText.includes('has a job already')")
        other.until("document.querySelector('.live')?.dataset.state == 'waiting'")
        click(other, "#cancel")
        for window in (tab, other):
            window.until("document.querySelector('.live')?.dataset.state == 'cancelled'")
    assert len(served.bench.jobs.table.jobs()) == 1


def annotate_by_keys(tab, image):
    """Points along the spine, a proposal, a look at each vertebra."""
    reach(tab, "#stage")
    tab.press("p")
    for pixel in drawn(image).clicks(*SPINE):
        right, down = np.rint((pixel - np.array(tab.run("annotation.cursor"))) / 10.0).astype(int)
        tab.press("ArrowRight" if right > 0 else "ArrowLeft", abs(right))
        tab.press("ArrowDown" if down > 0 else "ArrowUp", abs(down))
        tab.press("Enter")
    tab.press("o")
    tab.until("Object.keys(annotation.marks.vertebrae).length == 17")
    tab.press("PageDown", 17)
    tab.until("document.querySelector('#saved').innerText.startsWith('Saved')")


@pytest.mark.slow
def test_the_whole_way_by_keyboard_alone(tab, root, serve, tmp_path):
    """From an export in a folder to a run: no mouse, no script that clicks; Tab, Enter, letters and arrows."""
    shutil.copytree(root / "girl", tmp_path / "disc", ignore=shutil.ignore_patterns("*.json"))
    shutil.rmtree(root / "girl")
    with serve(root, jobs=True, sources=(tmp_path / "disc",)) as served:
        load(tab, served.address)
        reach(tab, "a[href='#/new']")
        tab.press("Enter")
        reach(tab, "#read-source")
        tab.press("Enter")
        typed(tab, "#name", "girl")
        tab.press("Enter")
        typed(tab, "#f-age", "13")
        typed(tab, "#f-sex", "f")
        typed(tab, "#f-height-cm", "157")
        typed(tab, "#f-pushes-0--side", "r")
        for field, value in (("level", "8"), ("d21-mm", "400"), ("d31-mm", "200")):
            typed(tab, f"#f-pushes-0--{field}", value)
        for frame, (force, role) in enumerate((("0", "u"), ("20", "t"), ("40", "v"))):
            typed(tab, f"#f-pushes-0--forces-n-{frame}-", force)
            typed(tab, f"#f-pushes-0--roles-{frame}-", role)
        tab.until("document.querySelector('.saved').innerText == 'Saved. Everything is filled in.'")
        reach(tab, ".way a[href^='/annotate/']", backwards=True)
        tab.press("Enter")
        tab.until("!!window.annotation && document.body.dataset.state == 'open'")
        push = read_json(root / "girl" / "subject.json")["pushes"][0]
        assert push["roles"] == ["unused", "training", "validation"] and push["forces_n"] == [0, 20, 40]
        annotate_by_keys(tab, "rest/frontal")
        for number, image in ((2, "rest/lateral"), (3, "push/a")):
            reach(tab, f"#images li:nth-child({number}) button", backwards=True)
            tab.press("Enter")
            tab.until(
                f"annotation.image == annotation.session.images[{number - 1}] && annotation.loaded == annotation.key"
            )
            annotate_by_keys(tab, image)
        assert tab.run("annotation.missing") == []
        reach(tab, "#back", backwards=True)
        tab.press("Enter")
        reach(tab, ".card a.main")
        tab.press("Enter")
        reach(tab, "#start-run")
        tab.press("Enter")
        tab.until(SHAPING, 90)
        reach(tab, "#cancel", backwards=True)
        tab.press("Enter")
        tab.until("document.querySelector('.live')?.dataset.state == 'cancelled'", 30)
        assert tab.complaints == []
    marks = read_annotation(root / "girl" / "annotation.json").images
    away = np.linalg.norm(marks["rest/frontal"].pixels() - drawn("rest/frontal").quads, axis=2)
    assert np.median(away) < 4.0 and len(read_subject(root / "girl").annotation.images) == 3


def test_a_step_can_be_clicked_while_the_page_learns_something_new(tab, root, served):
    """The button is down when the subject's state changes; when it is let go, the click still counts."""
    load(tab, served.address)
    go(tab, f"/subject/{served.key()}/values")
    box = tab.run(
        "JSON.parse(JSON.stringify(document.querySelector(\".way a[href$='/run']\").getBoundingClientRect()))"
    )
    held = {"x": box["x"] + 0.5 * box["width"], "y": box["y"] + 0.5 * box["height"], "button": "left", "clickCount": 1}
    tab.call("Input.dispatchMouseEvent", type="mousePressed", buttons=1, **held)
    (root / "girl" / "rest" / "frontal.dcm").unlink()
    tab.run("(document.dispatchEvent(new Event('subject-changed')), 1)")
    tab.until("document.querySelector('h1').innerText.includes('Radiographs are missing')")
    tab.call("Input.dispatchMouseEvent", type="mouseReleased", buttons=0, **held)
    tab.until("location.hash.endsWith('/run')")
