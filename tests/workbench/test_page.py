"""The workbench in a headless Chromium: from a hospital's files to a run; nothing leaves the machine."""

from __future__ import annotations

import json
import shutil
import sys

import pytest

from bench_page import chosen, click, files, fill, go, load, pick, text
from chromium import browser
from hospital import disc, export
from spinestiff.annotate.draft import DraftImage
from spinestiff.files import read_json
from spinestiff.subject.annotation_record import Annotation
from spinestiff.subject.folder import write_annotation
from unannotated import CANARY, drawn

pytestmark = pytest.mark.skipif(
    browser() is None or sys.platform == "win32", reason="no Chromium to open the page in, or no pipe to drive it by"
)


def annotate(folder):
    """The marks that an annotator would make."""
    images = {name: drawn(name).named() for name in ("rest/frontal", "rest/lateral", "push/a")}
    whole = {name: DraftImage.model_validate({"vertebrae": marks}).whole() for name, marks in images.items()}
    write_annotation(folder, Annotation(schema_version=1, images=whole))


@pytest.mark.slow
def test_from_files_to_a_run_that_is_cancelled(tab, root, serve, tmp_path):
    """Upload, form with a mistake, annotation page and back, a real run, reload in its middle, cancel, run again."""
    shutil.rmtree(root / "girl" / "results", ignore_errors=True)
    mixed = tmp_path / "disc"
    shutil.copytree(root / "girl", mixed / "PA01" / "deep", ignore=shutil.ignore_patterns("*.json"))
    shutil.rmtree(root / "girl")
    with serve(root, jobs=True) as served:
        load(tab, served.address)
        assert "There is no subject here yet" in text(tab)
        click(tab, "a[href='#/new']")
        tab.until("!!document.querySelector('#files')")
        files(tab, "#files", sorted(path for path in mixed.rglob("*") if path.is_file()))
        tab.until("!!document.querySelector('#make')")
        assert text(tab, "tbody").count("push 1") == 1 and "rest, lateral" in text(tab, "tbody")
        fill(tab, "#name", "girl-05")
        click(tab, "#make")
        tab.until("!!document.querySelector('#f-age')")
        assert tab.run("document.querySelectorAll('.says[data-kind=open]').length") == 8
        for field, value in (
            ("age", "13"),
            ("height-cm", "157"),
            ("pushes-0--level", "8"),
            ("pushes-0--d21-mm", "400"),
        ):
            fill(tab, f"#f-{field}", value)
        fill(tab, "#f-pushes-0--d31-mm", "420")
        tab.until("document.querySelector('.saved').innerText.startsWith('Not saved')")
        assert "d31_mm 420 is not below d21_mm 400" in text(tab)
        fill(tab, "#f-pushes-0--d31-mm", "200")
        for name, value in (("f-sex", "female"), ("f-pushes-0--side", "right"), ("f-pushes-0--roles-1-", "training")):
            choose = f"e.value = '{value}', e.dispatchEvent(new Event('change')), 1"
            tab.run(f"(e => ({choose}))(document.getElementById('{name}'))")
        # A column of a table, pasted.
        tab.run("""(() => {
          const clipboardData = new DataTransfer();
          clipboardData.setData('text', '0\\n20,0\\n40');
          const first = document.getElementById('f-pushes-0--forces-n-0-');
          first.dispatchEvent(new ClipboardEvent('paste', { clipboardData, bubbles: true, cancelable: true }));
        })()""")
        tab.until("document.querySelector('.saved').innerText == 'Saved. Everything is filled in.'")
        record = read_json(root / "girl-05" / "subject.json")
        assert record["pushes"][0]["forces_n"] == [0, 20, 40] and record["pushes"][0]["roles"][1] == "training"
        assert "d31 200 mm" in tab.run("document.querySelector('.push .torso').textContent")
        # What an X-ray distance means, drawn beside its field.
        tab.run("(document.getElementById('f-xray-source-patient-mm').closest('details').open = true, 1)")
        tab.run("(document.getElementById('f-xray-source-patient-mm').focus(), 1)")
        tab.until("document.querySelector('.beam .t-on')?.textContent == 'to the patient ?'")
        # The annotation page of this subject, and back.
        click(tab, ".way a[href^='/annotate/']")
        tab.until("!!window.annotation && document.body.dataset.state == 'open'")
        assert tab.run("annotation.session.images.length") == 3 and tab.run("document.title") == "Annotation"
        fresh = read_json(root / "girl-05" / "subject.json")["pushes"][0]["id"]
        annotate(root / "girl-05")
        marks = read_json(root / "girl-05" / "annotation.json")
        marks["images"][f"push/{fresh}"] = marks["images"].pop("push/a")
        (root / "girl-05" / "annotation.json").write_text(json.dumps(marks), encoding="utf-8")
        click(tab, "#back")
        tab.until("!!document.querySelector('#room')?.innerText.includes('Ready to run')")
        click(tab, ".card a.main")
        click(tab, "#start-run")
        tab.until("document.querySelector('.steps [data-kind=now]')?.innerText.includes('Shape the torso')", 60)
        tab.call("Page.reload")
        tab.until("document.querySelector('.steps [data-kind=now]')?.innerText.includes('Shape the torso')", 60)
        click(tab, "#cancel")
        tab.until("document.querySelector('.live')?.dataset.state == 'cancelled'", 30)
        assert "What was finished before stays" in text(tab)
        tab.until("!document.querySelector('#start-run').disabled")
        click(tab, "#start-run")
        tab.until("document.querySelector('.live')?.dataset.state == 'running'", 30)
        tab.until("document.querySelector('h1 .badge').innerText == 'Running'", 30)
        click(tab, "#cancel")
        tab.until("document.querySelector('.live')?.dataset.state == 'cancelled'", 30)
        assert (root / "girl-05" / "results" / "tracked.json").exists()
        assert tab.complaints == []
        assert all(url.startswith(("http://127.0.0.1:", "data:", "about:")) for url in tab.requests)
        assert not any(word in url for url in tab.requests for word in ("girl", "DOE", *CANARY.split("^")))


def test_names_are_text_and_titles_say_nothing(tab, root, serve):
    (root / "girl").rename(root / "<img src=x onerror=document.title='gone'>")
    with serve(root) as served:
        load(tab, served.address)
        assert "<img src=x" in text(tab) and tab.run("document.querySelectorAll('#room img').length") == 0
        assert tab.run("document.title") == "spinestiff workbench"
        for place in ("/table", "/trash", "/compare", "/new"):
            go(tab, place)
        assert tab.complaints == [] and tab.run("document.title") == "spinestiff workbench"


def test_a_result_is_shown_in_a_box_that_can_ask_for_nothing(tab, root, serve):
    results = root / "girl" / "results"
    results.mkdir()
    spy = """<p id=t></p><script>(async () => {
      let reached = 'shut';
      try { parent.document; reached = 'open'; } catch {}
      const asked = await fetch('/api/subjects').then(() => 'asked', () => 'refused');
      parent.postMessage([reached, self.origin, asked], '*');
    })()</script>"""
    (results / "report.html").write_text(spy, encoding="utf-8")
    with serve(root) as served:
        load(tab, served.address)
        tab.run("(addEventListener('message', event => { window.told = event.data; }), 1)")
        go(tab, f"/subject/{served.key()}/results")
        tab.until("!!window.told")
        assert tab.run("told") == ["shut", "null", "refused"]


def test_subjects_go_to_the_trash_and_come_back(tab, root, served):
    load(tab, served.address)
    click(tab, "button[aria-label='Remove girl']")
    tab.until("document.querySelector('#room').innerText.includes('There is no subject here yet')")
    assert not (root / "girl").exists()
    click(tab, "#undo button")
    tab.until("document.querySelector('#room').innerText.includes('girl')")
    assert (root / "girl" / "subject.json").exists()


def test_by_keyboard_alone(tab, root, served):
    """Tab reaches everything in order, and Enter follows."""
    load(tab, served.address)
    seen = []
    for _ in range(12):
        tab.press("Tab")
        seen.append(tab.run("document.activeElement.innerText?.trim() || document.activeElement.id"))
    assert seen[:6] == ["To the content", "Subjects", "New subject", "Compare", "Table", "Trash"]
    assert {"girl", "Annotate", "Remove"} <= set(seen)
    outline = tab.run("getComputedStyle(document.activeElement).outlineStyle")
    assert outline == "solid"


def test_nothing_runs_out_of_the_window(tab, root, served):
    """640 pixels are a window of 1280 at 200 % zoom."""
    rooms = (f"/subject/{served.key()}/{room}" for room in ("values", "run", "results"))
    load(tab, served.address)
    try:
        for place in ("/", "/new", "/table", "/trash", *rooms):
            go(tab, place)
            for width in (1280, 640, 360):
                tab.size(width, 800)
                for theme in ("light", "dark"):
                    tab.theme(theme)
                    tab.settle()
                    assert tab.run("document.documentElement.scrollWidth") <= width, (place, width, theme)
                    dark = tab.run("getComputedStyle(document.body).backgroundColor") == "rgb(18, 22, 28)"
                    assert dark == (theme == "dark"), (place, width, theme)
    finally:
        tab.size(1280, 800)
        tab.theme("light")


def test_a_page_of_another_start_says_so(tab, served):
    load(tab, served.address.partition("#")[0] + "#" + "x" * 43, "refused")
    assert "spinestiff serve printed last" in text(tab, "#problem")


def test_read_only_shows_no_way_to_change(tab, root, serve):
    with serve(root, read_only=True) as served:
        load(tab, served.address)
        assert "To be looked at only" in text(tab, "header") and "New subject" not in text(tab, "header")
        assert "Remove" not in text(tab)
        go(tab, f"/subject/{served.key()}/values")
        assert tab.run("[...document.querySelectorAll('#room input, #room select')].every(e => e.disabled)")


def test_an_export_in_a_folder_on_this_machine(tab, root, serve, tmp_path):
    disc(tmp_path / "exports" / "one")
    with serve(root, sources=(tmp_path / "exports" / "one",)) as served:
        load(tab, served.address)
        go(tab, "/new")
        click(tab, "#source + *, label + button")
        tab.until("!!document.querySelector('#make')")
        assert "7 other files are left out" in text(tab)


def test_folders_that_are_dropped_come_whole(tab, root, served, tmp_path):
    """A browser gives a folder's entries a hundred at a time, and a file without a folder as well."""
    disc(tmp_path / "CD" / "one")
    for number in range(230):
        (tmp_path / "CD" / f"NOTE{number:03d}.TXT").write_text("x")
    (tmp_path / "alone.txt").write_text("x")
    load(tab, served.address)
    go(tab, "/new")
    box = tab.run("(r => [r.x + r.width / 2, r.y + 20])(document.querySelector('.drop').getBoundingClientRect())")
    tab.drop(tuple(box), [tmp_path / "CD", tmp_path / "alone.txt"])
    tab.until("!!document.querySelector('#make')", 60)
    assert "238 other files are left out" in text(tab)
    assert tab.run("[...document.querySelectorAll('details li')].at(-1).textContent") == "and 38 more"
    assert tab.run("'over' in document.querySelector('.drop').dataset") is False
    assert tab.complaints == []


def test_of_two_choices_the_last_counts_though_its_answer_comes_first(tab, root, served, tmp_path):
    export(tmp_path / "CD" / "I1", study="1.2.8")
    export(tmp_path / "CD" / "I2", study="1.2.9")
    export(tmp_path / "CD" / "I3", "lateral", study="1.2.9")
    load(tab, served.address)
    go(tab, "/new")
    files(tab, "#files", sorted((tmp_path / "CD").iterdir()))
    tab.until("!!document.querySelector('#study')", 60)
    tab.run("""(() => {
      const real = window.fetch;
      window.looks = 0;
      window.fetch = async (place, given) => {
        if (!String(place).endsWith('/look')) return real(place, given);
        const late = !window.looks++, answer = await real(place, given);
        if (late) await new Promise(done => setTimeout(() => { window.wasLate = true; done(); }, 800));
        return answer;
      };
    })()""")
    pick(tab, "#study", "22")
    tab.until("window.wasLate")
    tab.settle()
    assert tab.run("looks") == 2 and tab.run("document.querySelector('#study').value") == "A2"
    assert [name in text(tab, "tbody") for name in ("I1", "I2", "I3")] == [False, True, True]
    assert tab.complaints == []


def test_a_job_that_fails_without_a_message_shows_what_it_said(tab, root, served):
    load(tab, served.address)
    go(tab, f"/subject/{served.key()}/run")
    click(tab, "#start-run")
    tab.until("document.querySelector('.live')?.dataset.state == 'waiting'")
    jobs = served.bench.jobs
    job = jobs.table.take(1)
    log = jobs.log(job.id)
    log.parent.mkdir(parents=True, exist_ok=True)
    log.write_text("Traceback (most recent call last):\nKeyError: 'T13'\n", encoding="utf-8")
    jobs.table.end(job.id, "failed", 1)
    tab.until("document.querySelector('.live').dataset.state == 'failed'")
    assert "It failed; what it said last is below." in text(tab, ".live") and "KeyError: 'T13'" in text(tab, ".live")


def test_what_a_plan_is_asked_is_chosen_on_the_page(tab, root, served):
    load(tab, served.address)
    go(tab, f"/subject/{served.key()}/run")
    tab.run("(document.querySelector('#start-plan').closest('details').open = true, 1)")
    under = "document.querySelector('#o-plan-under-1').closest('p').checkVisibility() == false"
    assert tab.run(under) is True
    chosen(tab, "#o-plan-target", "cobb")
    tab.until(f"!({under})")
    click(tab, "#start-plan")
    tab.until("document.querySelector('#problem').innerText.includes('Under which push: wanted e.g. right,8,60')")
    chosen(tab, "#o-plan-under-0", "left")
    fill(tab, "#o-plan-under-1", "8,5")
    fill(tab, "#o-plan-under-2", "60")
    chosen(tab, "#o-plan-side", "left")
    fill(tab, "#o-plan-ribs", "5, 7")
    click(tab, "#start-plan")
    tab.until("document.querySelector('.live')?.dataset.state == 'waiting'")
    (job,) = served.bench.jobs.table.jobs()
    assert job.options == {"target": "cobb", "under": "left,8.5,60", "side": "left", "ribs": "5, 7"}
    served.bench.jobs.table.ask_cancel(job.id)
    go(tab, "/")
    go(tab, f"/subject/{served.key()}/run")
    # What belongs to an angle is not sent with another target.
    tab.run("(document.querySelector('#start-plan').closest('details').open = true, 1)")
    chosen(tab, "#o-plan-target", "cobb")
    fill(tab, "#o-plan-under-1", "8")
    fill(tab, "#o-plan-under-2", "60")
    chosen(tab, "#o-plan-target", "tissue")
    tab.until("!document.querySelector('#start-plan').disabled")
    click(tab, "#start-plan")
    tab.wait(lambda: len(served.bench.jobs.table.jobs()) == 2)
    assert {"target": "tissue"} in [one.options for one in served.bench.jobs.table.jobs()]
