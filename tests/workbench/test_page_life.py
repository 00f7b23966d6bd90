"""The workbench's page when things happen around it: a killed server, a second window, a button that is held."""

from __future__ import annotations

import re
import subprocess
import sys
from contextlib import contextmanager

import pytest

from bench_page import chosen, click, files, fill, go, load, press, text
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


def intercept(tab, answer):
    """``fetch`` of the page as ``answer`` makes it, a JavaScript function of the address, its options and the real one,
    until the page is loaded again."""
    tab.run(f"(window.real ??= fetch.bind(window), window.fetch = (path, given) => ({answer})(path, given, real), 1)")


def test_values_that_are_not_saved_yet_are_not_left_behind(tab, root, served):
    """The way to the annotation leaves the page at once, whatever is on its way."""
    load(tab, served.address)
    go(tab, f"/subject/{served.key()}/values")
    intercept(
        tab,
        """async (path, given, real) => {
      if (given?.method == 'PUT') await new Promise(done => { window.release = done; });
      return real(path, given);
    }""",
    )
    fill(tab, "#f-age", "14")
    tab.questions.clear()
    tab.answer = False
    try:
        press(tab, ".way a[href^='/annotate/']")
        tab.wait(lambda: bool(tab.questions))
    finally:
        tab.answer = True
    assert tab.questions == ["beforeunload"] and tab.run("location.pathname") == "/"
    tab.until("!!window.release")
    tab.run("(release(), 1)")
    tab.until("document.querySelector('.saved').innerText.startsWith('Saved')")
    assert read_json(root / "girl" / "subject.json")["age"] == 14
    press(tab, ".way a[href^='/annotate/']")
    tab.until("location.pathname.startsWith('/annotate/') && document.body?.dataset.state == 'open'")
    assert tab.questions == ["beforeunload"]


def test_values_whose_answer_was_lost_are_no_conflict_with_themselves(tab, root, served):
    """The server wrote them: what is typed since then is saved, and nobody has to load the page anew for it."""
    load(tab, served.address)
    go(tab, f"/subject/{served.key()}/values")
    intercept(
        tab,
        """async (path, given, real) => {
      const answer = await real(path, given);
      if (given?.method == 'PUT' && (window.lost = (window.lost ?? 0) + 1) <= 2) throw new TypeError();
      return answer;
    }""",
    )
    fill(tab, "#f-height-cm", "151")
    tab.until("document.querySelector('.saved').innerText.startsWith('Not saved')")
    assert read_json(root / "girl" / "subject.json")["height_cm"] == 151
    fill(tab, "#f-age", "14")
    tab.until("document.querySelector('.saved').innerText.startsWith('Saved')")
    assert tab.run("lost") >= 3
    values = read_json(root / "girl" / "subject.json")
    assert (values["age"], values["height_cm"]) == (14, 151)
    press(tab, "#undo-values")
    tab.until("document.querySelector('#f-age').value == '13'")
    tab.until("document.querySelector('.saved').innerText.startsWith('Saved')")


def test_values_that_can_not_be_saved_are_told_of_in_the_next_room(tab, root, served):
    load(tab, served.address)
    go(tab, f"/subject/{served.key()}/values")
    fill(tab, "#f-height-cm", "151")
    fill(tab, "#f-age", "thirteen")
    go(tab, "/trash")
    tab.until("!document.querySelector('#problem').hidden")
    assert "girl" in text(tab, "#problem") and "one value is not possible" in text(tab, "#problem")
    assert read_json(root / "girl" / "subject.json")["height_cm"] == 157


def test_an_empty_cell_of_a_pasted_column_is_a_frame_without_a_force(tab, root, served):
    """The forces below it stay those of their frames."""
    load(tab, served.address)
    go(tab, f"/subject/{served.key()}/values")
    for column, wanted in (
        ("5\\n\\n35\\n", [5, None, 35]),
        ("\\r\\n12,5\\r\\n41", [None, 12.5, 41]),
        ("1 2;3", [1, 2, 3]),
    ):
        tab.run(f"""(() => {{
          const given = new DataTransfer();
          given.setData('text', '{column}');
          const event = new ClipboardEvent('paste', {{ clipboardData: given, bubbles: true }});
          document.querySelector('[aria-label="Force in frame 0, N"]').dispatchEvent(event);
        }})()""")
        boxes = tab.run("[...document.querySelectorAll('.frames input')].map(one => one.value)")
        assert boxes == ["" if force is None else str(force) for force in wanted]
        tab.until("document.querySelector('.saved').innerText.startsWith('Saved')")
    assert read_json(root / "girl" / "subject.json")["pushes"][0]["forces_n"] == [1, 2, 3]


def test_an_upload_that_is_given_up_is_no_problem_of_the_next_room(tab, root, served, tmp_path):
    (tmp_path / "I1").write_bytes(bytes(1000))
    load(tab, served.address)
    go(tab, "/new")
    intercept(
        tab,
        """(path, given, real) => given?.method != 'PUT' ? real(path, given) : new Promise((_, no) => {
      window.sending = true;
      given.signal.addEventListener('abort', () => no(given.signal.reason));
    })""",
    )
    files(tab, "#files", [tmp_path / "I1"])
    tab.until("!!window.sending")
    go(tab, "/trash")
    tab.run("new Promise(done => setTimeout(done, 300))")
    assert tab.run("document.querySelector('#problem').hidden"), text(tab, "#problem")


def test_cards_are_asked_for_again_where_the_server_did_not_answer_once(tab, root, served):
    load(tab, served.address)
    go(tab, "/trash")
    intercept(
        tab,
        """async (path, given, real) => {
      if (path != '/api/subjects') return real(path, given);
      window.asked = (window.asked ?? 0) + 1;
      if (asked == 2) throw new TypeError('lost');
      const found = await (await real(path, given)).json();
      if (asked == 1) found.subjects[0].job = { id: '1', state: 'running', ended: null };
      return new Response(JSON.stringify(found));
    }""",
    )
    go(tab, "/")
    assert "Running" in text(tab)
    tab.until("asked >= 3 && !document.querySelector('#room').innerText.includes('Running')", 20)


def test_of_two_comparisons_the_one_that_is_chosen_is_shown(tab, root, served):
    """Though the other's answer comes last."""
    load(tab, served.address)
    go(tab, "/trash")
    intercept(
        tab,
        """async (path, given, real) => {
      const ratio = { name: 'x', title: 'X', words: '1', interval: '', unit: '', value: 1, low: null, high: null };
      const result = { badge: 'determined', lines: [], stiffness: [ratio], doubts: [], rmse_mm: 1 };
      const card = name => ({ key: name, name, id: name, stage: 'done', missing: [], pushes: 1, result });
      if (path == '/api/subjects') return new Response(JSON.stringify({ subjects: ['ann', 'bea', 'cleo'].map(card) }));
      if (!path.endsWith('/results')) return real(path, given);
      if (path.includes(window.hold)) await new Promise(done => { window.release = done; });
      if (path.includes(window.lose)) throw new TypeError('lost');
      return new Response(JSON.stringify({ pages: [], ticket: 't' }));
    }""",
    )
    go(tab, "/compare/ann/cleo")
    tab.run("(window.hold = 'bea', 1)")
    chosen(tab, "#second", "bea")
    tab.until("!!window.release")
    chosen(tab, "#first", "cleo")
    chosen(tab, "#second", "ann")
    pair = "[...document.querySelectorAll('.pair section')].map(one => one.getAttribute('aria-label')).join()"
    tab.until(f"{pair} == 'cleo,ann'")
    tab.run("(release(), 1)")
    tab.run("new Promise(done => setTimeout(done, 200))")
    assert tab.run(pair) == "cleo,ann"
    # Nothing of others is shown where the answer does not come.
    tab.run("(window.hold = undefined, window.lose = 'bea', 1)")
    chosen(tab, "#second", "bea")
    tab.until("!document.querySelector('#problem').hidden")
    assert tab.run(pair) == ""


def test_of_two_answers_about_a_subject_the_last_question_counts(tab, root, served):
    key = served.key()
    load(tab, served.address)
    go(tab, f"/subject/{key}/values")
    intercept(
        tab,
        f"""async (path, given, real) => {{
      if (path != '/api/subjects/{key}' || window.release) return real(path, given);
      const found = await (await real(path, given)).json();
      await new Promise(done => {{ window.release = done; }});
      return new Response(JSON.stringify({{ ...found, stage_words: 'As it was before' }}));
    }}""",
    )
    tab.run("(document.dispatchEvent(new Event('subject-changed')), 1)")
    tab.until("!!window.release")
    tab.run("(document.dispatchEvent(new Event('subject-changed')), 1)")
    tab.run("new Promise(done => setTimeout(done, 500))")
    tab.run("(release(), 1)")
    tab.run("new Promise(done => setTimeout(done, 300))")
    assert "As it was before" not in text(tab, "h1")


def test_the_way_to_the_content_stays_in_the_room(tab, root, served):
    load(tab, served.address)
    go(tab, "/new")
    tab.run("(document.querySelector('.skip').focus(), 1)")
    tab.press("Enter")
    tab.run("new Promise(done => setTimeout(done, 300))")
    assert text(tab, "h1") == "New subject" and tab.run("document.activeElement.id") == "room"


def test_the_address_of_another_start_is_taken_in_a_window_that_is_open(tab, root, served):
    load(tab, served.address)
    tab.run("(sessionStorage.setItem('spinestiff-token', 'of-a-start-that-is-over-by-now'), 1)")
    tab.loaded = False
    tab.run(f"(location.hash = '{served.token}', 1)")
    tab.wait(lambda: tab.loaded)
    tab.until("document.body.dataset.state == 'open'")
    assert "girl" in text(tab)
