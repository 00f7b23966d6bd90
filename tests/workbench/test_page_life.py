"""The workbench's page when things happen around it: a killed server, a second window, a button that is held."""

from __future__ import annotations

import re
import subprocess
import sys
from contextlib import contextmanager

import pytest

from bench_page import click, fill, go, load, text
from chromium import Tab, browser
from spinestiff.annotate.draft import DraftImage
from spinestiff.files import read_json
from spinestiff.loopback.serving import listening
from spinestiff.subject.annotation_record import Annotation
from spinestiff.subject.folder import write_annotation
from unannotated import drawn

pytestmark = pytest.mark.skipif(
    browser() is None or sys.platform == "win32", reason="no Chromium to open the page in, or no pipe to drive it by"
)
PROGRAM = [sys.executable, "-c", "from spinestiff.app.cli import main; main()", "serve"]
SHAPING = "document.querySelector('.steps [data-kind=now]')?.innerText.includes('Shape the torso')"


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


def test_saved_is_said_of_what_was_typed_last(tab, root, served):
    """A value is typed while the one before is on its way."""
    load(tab, served.address)
    go(tab, f"/subject/{served.key()}/values")
    tab.run("""(() => {
      const real = window.fetch;
      window.asked = window.answered = 0;
      window.fetch = async (place, given) => {
        if (given?.method != 'PUT') return real(place, given);
        window.asked++;
        const answer = await real(place, given);
        await new Promise(done => setTimeout(done, 700));
        window.answered++;
        return answer;
      };
    })()""")
    fill(tab, "#f-age", "14")
    tab.until("asked == 1")
    fill(tab, "#f-height-cm", "151")
    tab.until("answered == 1")
    tab.settle()
    assert not text(tab, ".saved").startswith("Saved")
    tab.until("document.querySelector('.saved').innerText.startsWith('Saved')")
    values = read_json(root / "girl" / "subject.json")
    assert (values["age"], values["height_cm"]) == (14, 151)
