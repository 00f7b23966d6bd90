"""The whole way on the workbench in a headless Chromium, by mouse and keys: a hospital's export, the form, every mark
of the annotation, a run that is cancelled and one that ends, the report and the next push.

The radiographs are those of a synthetic subject, so that where somebody would click and what is to be found are known.
"""

from __future__ import annotations

import json
import re
import sys

import numpy as np
import pytest

from annotation_hands import Hands
from bench_page import fill, load, pick, press, text, write
from chromium import Tab, browser
from hospital import CANARY, export, headed
from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.files import read_json
from spinestiff.study.synthetic.subject import truth_path
from spinestiff.subject.folder import read_annotation

pytestmark = pytest.mark.skipif(
    browser() is None or sys.platform == "win32", reason="no Chromium to open the page in, or no pipe to drive it by"
)
NAME = "study-017"
SEEN_PX = 2.0
"""Off by which somebody sees that a corner has to be moved: 1.4 mm of the patient."""
FILES = (
    ("SE000003/IM000001", "rest/frontal.dcm", "101500"),
    ("SE000004/IM000001", "rest/lateral.dcm", "101630"),
    ("SE000007/IM000001", "pushes/main.dcm", "102200"),
    ("SE000008/IM000002", "pushes/second.dcm", "102800"),
)


def write_export(folder, subject):
    """A subject's radiographs as they come: nested, with names that say nothing, beside another examination of the same
    patient and files that are no radiographs."""
    study = folder / "DICOM" / "PA000001" / "ST000002"
    for name, source, time in FILES:
        headed(subject / source, study / name, time=time)
    export(folder / "DICOM" / "PA000001" / "ST000001" / "SE000001" / "IM000001", study="1.2.9", time="090000")
    export(study / "SE000001" / "IM000001", Modality="CT", time="101200")
    (folder / "REPORT.PDF").write_bytes(b"%PDF-1.4\n%%EOF\n")
    (folder / "README.TXT").write_text("Viewer: start VIEWER.EXE", encoding="utf-8")
    return folder


def bring_files(tab, folder):
    """Drop the folder, say which examination it is, name the subject."""
    press(tab, "a[href='#/new']")
    tab.until("!!document.querySelector('.drop')")
    middle = tab.run("(r => [r.x + r.width / 2, r.y + 20])(document.querySelector('.drop').getBoundingClientRect())")
    tab.drop(tuple(middle), [folder])
    tab.until("!!document.querySelector('#study')", 60)
    assert "There are several studies" in text(tab)


def name_subject(tab):
    write(tab, "#name", NAME)
    press(tab, "#make")
    tab.until("!!document.querySelector('#f-age')")


def fill_values(tab, known):
    """What the researcher's own notes say."""
    write(tab, "#f-age", f"{known['age']:g}")
    pick(tab, "#f-sex", known["sex"][0])
    write(tab, "#f-height-cm", f"{known['height_cm']:g}")
    for number, push in enumerate(known["pushes"]):
        field = f"#f-pushes-{number}--"
        pick(tab, f"{field}side", push["side"][0])
        for name in ("level", "d21_mm", "d31_mm"):
            write(tab, field + name.replace("_", "-"), f"{push[name]:g}")
        for frame, (force, role) in enumerate(zip(push["forces_n"], push["roles"])):
            write(tab, f"{field}forces-n-{frame}-", f"{force:g}")
            pick(tab, f"{field}roles-{frame}-", role[0])
    tab.until("document.querySelector('.saved').innerText == 'Saved. Everything is filled in.'")


def annotate(tab, number, marks):
    """Six clicks along the spine of a radiograph, a look at each vertebra that is proposed, and a drag of each corner
    that is off; gives how many were."""
    hands = Hands(tab)
    press(tab, f"#images li:nth-child({number + 1}) button")
    tab.until(f"annotation.image == annotation.session.images[{number}] && annotation.loaded == annotation.key")
    image = tab.run("annotation.image.name")
    names = [name for name in VERTEBRAE if name in marks["vertebrae"]]
    press(tab, "[data-tool=spine]")
    for name in (names[i] for i in np.linspace(0, len(names) - 1, 6).round().astype(int)):
        hands.click(np.mean(marks["vertebrae"][name], axis=0))
    for place, name in (("upper", names[0]), ("lower", names[-1])):
        pick(tab, f"#{place}", name)
    press(tab, "#propose")
    tab.until(f"Object.keys(annotation.allMarks['{image}'].vertebrae).length == {len(names)}")
    dragged = 0
    while tab.run("annotation.unseen.length"):
        press(tab, "#look-on")
        name = tab.run("annotation.selection.name")
        for corner, wanted in enumerate(np.array(marks["vertebrae"][name])):
            found = hands.quad(name, image)[corner]
            if np.linalg.norm(found - wanted) > SEEN_PX:
                hands.drag(found, wanted)
                dragged += 1
    for tool, points in marks.get("supports", {}).items():
        if points:
            press(tab, "#fit")
            press(tab, f"[data-tool={tool}]")
            for point in points:
                hands.click(point)
    hands.saved()
    return dragged


def ended(tab, seconds):
    """Wait until the job that is shown has ended; how."""
    tab.until("document.querySelector('.live')?.dataset.state == 'running'")
    tab.until("!['running', 'waiting'].includes(document.querySelector('.live').dataset.state)", seconds)
    return tab.run("document.querySelector('.live').dataset.state")


def steps_done(tab):
    """The steps that the job which is shown did, in their order, without those whose results were up to date."""
    lines = tab.run("document.querySelector('.live pre').textContent").splitlines()
    told = [match.groups() for line in lines if (match := re.match(r"\s*[\d.]+ s\s+([a-z]+): (.*)", line))]
    return list(dict.fromkeys(step for step, words in told if words != "up to date"))


def assert_whole(results):
    """Everything in the folder can be read to its end, and nothing is left over from writing."""
    for path in (path for path in results.rglob("*") if path.is_file()):
        if path.suffix == ".json":
            read_json(path)
        elif path.suffix == ".jsonl":
            for line in path.read_text(encoding="utf-8").splitlines():
                json.loads(line)
        elif path.suffix == ".npz":
            with np.load(path) as arrays:
                assert all(arrays[name].size for name in arrays)
        else:
            assert path.suffix in (".csv", ".html", ".png"), path


def cancel_in_the_fit(tab):
    """Start the quick estimate and cancel it as soon as it fits."""
    pick(tab, "#o-run-mesh", "coarse")
    press(tab, "#start-run")
    tab.until("document.querySelector('.steps [data-kind=now]')?.innerText == 'Estimate the stiffness'", 120)
    press(tab, "#cancel")
    tab.until("document.querySelector('.live').dataset.state == 'cancelled'")
    tab.until("document.querySelector('h1 .badge').innerText == 'Ready to run'")


def plan(tab, side, ribs):
    """Ask for the next push, on one side, at some ribs, two further radiographs at most."""
    press(tab, "details:has(#start-plan) > summary")
    pick(tab, "#o-plan-side", side)
    write(tab, "#o-plan-ribs", ribs)
    fill(tab, "#o-plan-exposures", "2")
    press(tab, "#start-plan")


@pytest.mark.slow
def test_a_hospital_export_becomes_a_report_and_a_plan(tab, serve, radiographed, tmp_path):
    known = read_json(radiographed / "subject.json")
    marks = read_json(radiographed / "annotation.json")["images"]
    truth = read_json(truth_path(radiographed))["ratios"]
    folder, results = tmp_path / "root" / NAME, tmp_path / "root" / NAME / "results"
    (tmp_path / "root").mkdir()
    with serve(tmp_path / "root", jobs=True) as served:
        load(tab, served.address)
        bring_files(tab, write_export(tmp_path / "export", radiographed))
        assert "3 other files are left out" in text(tab) and tab.run("!document.querySelector('#make')")
        pick(tab, "#study", "22")
        tab.until("document.querySelectorAll('tbody tr').length == 4")
        become = tab.run("[...document.querySelectorAll('tbody b')].map(one => one.innerText)")
        assert become == ["rest, frontal", "rest, lateral", "push 1", "push 2"]
        name_subject(tab)
        # The new room begins at its top: where one is, and what comes next.
        assert tab.run("scrollY") == 0 and text(tab, "h1").startswith(NAME)

        fill_values(tab, known)
        record = read_json(folder / "subject.json")
        assert [record[name] for name in ("id", "age", "sex", "height_cm")] == [NAME, 13, "female", 157]
        pushes = {name: f"push/{push['id']}" for name, push in zip(("main", "second"), record["pushes"])}
        for push, wanted in zip(record["pushes"], known["pushes"]):
            given = ("side", "level", "d21_mm", "d31_mm", "forces_n", "roles")
            assert {name: push[name] for name in given} == {name: wanted[name] for name in given}
        tab.until("document.querySelector('#next').innerText == 'Annotate'")
        press(tab, "#next")
        tab.until("!!window.annotation && document.body.dataset.state == 'open'")

        # What the truth calls push "main" the workbench has named by itself.
        images = {"rest/frontal": "rest/frontal", "rest/lateral": "rest/lateral"}
        images |= {pushes[name]: f"push/{name}" for name in pushes}
        assert tab.run("annotation.session.images.map(one => one.name)") == list(images)
        dragged = [annotate(tab, number, marks[wanted]) for number, wanted in enumerate(images.values())]
        assert 0 < sum(dragged) < 0.3 * 4 * sum(len(marks[wanted]["vertebrae"]) for wanted in images.values())
        tab.until("document.querySelector('#missing').innerText.startsWith('✓ Everything a fit needs is marked.')")
        saved = read_annotation(folder / "annotation.json").images
        assert set(saved) == set(images)
        for name, wanted in images.items():
            corners = {level: np.array(quad) for level, quad in marks[wanted]["vertebrae"].items()}
            assert set(saved[name].vertebrae) == set(corners)
            there = saved[name].vertebrae
            away = [np.linalg.norm(np.array(there[level]) - corners[level], axis=1) for level in corners]
            assert np.max(away) <= SEEN_PX and np.median(away) < 0.5 * SEEN_PX
        for image in pushes.values():
            assert set(saved[image].supports) == {"shoulder"}
        assert tab.complaints == []

        press(tab, "#onward")
        tab.until("document.querySelector('h1 .badge')?.innerText == 'Ready to run'")
        cancel_in_the_fit(tab)
        assert "Cancelled. What was finished before stays." in text(tab, ".live")
        assert "Estimate the stiffness: cancelled" in text(tab, ".history")
        assert {path.name for path in results.glob("*.json")} == {
            "personalised.json", "response.json", "run.json", "tracked.json"
        }  # fmt: skip
        assert_whole(results)

        # What was finished is not done again.
        press(tab, "#start-run")
        assert ended(tab, 300.0) == "done"
        assert steps_done(tab) == ["estimate", "assess", "report"]
        assert_whole(results)
        press(tab, ".live p a")
        tab.until("!!document.querySelector('iframe')")
        told = read_json(results / "estimate.json")["ratios"]
        for name, value in truth.items():
            assert told[name]["low"] < value < told[name]["high"]
        found = tab.run("[...document.querySelectorAll('.found li')].map(one => one.innerText)")
        assert "Changed since this was made" not in text(tab)
        # Made on the coarse mesh, which is no result to report.
        assert found.pop().startswith("A quick look, on a coarse mesh") and len(found) == 3
        # Beside the sentences, below them and in the table stand the same digits.
        beside = tab.run("[...document.querySelectorAll('.figure')].map(one => one.childNodes[0].textContent"
                         " + one.childNodes[1].textContent)")  # fmt: skip
        for line, numbers in zip(found, beside):
            assert set(re.findall(r"[\d.]+", numbers)) <= set(re.findall(r"[\d.]+", line))
        shown = tab.run("document.querySelector('.shown a').href")
        with Tab(tmp_path / "second") as window:
            window.call("Page.navigate", url=shown)
            window.until("document.title == 'Stiffness report' && document.readyState == 'complete'")
            report = text(window, "body")
            assert window.complaints == []
        intervals = [re.search(r"between [\d.]+ and [\d.]+ [A-Za-z /]+(?= \(95 %\))", line) for line in found]
        assert all(one and one[0] in report.replace("Between", "between") for one in intervals)

        press(tab, ".way a[href$='/run']")
        plan(tab, "left", "5, 9")
        assert ended(tab, 300.0) == "done"
        press(tab, ".live p a")
        press(tab, "[role=tab][data-name='']")
        best = read_json(results / "plan.json")["sequence"][0]["push"]
        assert best["side"] == "left" and best["level"] in (5.0, 9.0)
        words = f"Best next: rib {best['level']:g} {best['side']}, {best['force_n']:g} N, {best['view']}"
        assert words in text(tab, ".shown") and "out of date" not in text(tab)
        # The plan's job has written the report anew.
        written = (results / "report.html").read_text(encoding="utf-8").lower()
        assert "no further push was planned" not in written and f"push rib {best['level']:g}" in written
        tab.until("[...document.querySelectorAll('.shown img')].every(one => one.complete && one.naturalWidth > 100)")
        assert_whole(results)

        press(tab, "#rooms a[href='#/table']")
        tab.until("!!document.querySelector('tbody td')")
        row = tab.run("[...document.querySelectorAll('tbody tr > *')].map(one => one.innerText)")
        assert row[0] == NAME and row[6:9] == beside
        press(tab, "#rooms a[href='#/']")
        tab.until("!!document.querySelector('.card .found')")
        assert tab.run("[...document.querySelectorAll('.found li')].map(one => one.innerText)")[:-1] == found
        assert text(tab, ".card .badge").endswith(", quick look")
        assert tab.complaints == []
        assert all(url.startswith(("http://127.0.0.1:", "data:", "about:")) for url in tab.requests)
        assert not any(word in url for url in tab.requests for word in (NAME, *CANARY.split("^")))
