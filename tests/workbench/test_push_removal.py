"""A push that is taken out of a subject: what goes with it, what stays, how it comes back, what is refused."""

from __future__ import annotations

import subprocess
import sys

import pytest

from bench_page import click, fill, go, load, text
from chromium import browser
from spinestiff.annotate.draft import DraftImage
from spinestiff.files import read_json, write_json
from spinestiff.subject.annotation_record import Annotation
from spinestiff.subject.folder import read_subject, write_annotation
from spinestiff.subject.lock import sole_run
from spinestiff.subject.run_record import record_step, step_record
from spinestiff.workbench import marks
from unannotated import drawn

SCALE = {"object_mm": 25.4, "object_px": [[10.0, 20.0], [40.0, 20.0]]}
DISTANCES = {"source_detector_mm": 1500.0}
XRAY = {
    "scale": {"push/b": SCALE, "rest/frontal": SCALE},
    "images": {"push/b": DISTANCES, "rest/lateral": DISTANCES},
}
INPUTS = ("subject.json: pushes", "annotation.json: pushes", "rest/frontal.dcm", "rest/lateral.dcm")
HAS_BROWSER = browser() is not None and sys.platform != "win32"


def content_of(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def stale(served):
    address = f"/api/subjects/{served.key()}"
    return served.good("GET", address)["stale"], served.good("GET", f"{address}/results")["stale"]


@pytest.fixture
def girl(root):
    """Annotated, with a second push that init took for one: marked in two frames, a draft and a known length."""
    folder = root / "girl"
    (folder / "pushes" / "b.dcm").write_bytes((folder / "pushes" / "a.dcm").read_bytes())
    values = read_json(folder / "subject.json")
    values["pushes"].insert(0, values["pushes"][0] | {"id": "b", "frames": "pushes/b.dcm", "roles": ["unused"] * 3})
    write_json(folder / "subject.json", values | {"xray": XRAY})
    shown = {"rest/frontal": "rest/frontal", "rest/lateral": "rest/lateral", "push/a": "push/a", "push/b": "push/a",
             "push/b/2": "push/a/2"}  # fmt: skip
    whole = {name: DraftImage.model_validate({"vertebrae": drawn(of).named()}).whole() for name, of in shown.items()}
    write_annotation(folder, Annotation(schema_version=1, images=whole))
    draft = {name: {"vertebrae": drawn("push/a").named(), "spine": [[1.0, 2.0]]} for name in ("push/b", "push/a")}
    write_json(folder / "annotation.draft.json", {"schema_version": 1, "images": draft})
    (folder / "results").mkdir()
    (folder / "results" / "estimate.json").write_text("{}", encoding="utf-8")
    subject = read_subject(folder)
    record_step(subject, "report", step_record(subject, INPUTS, {}), [])
    return folder


def remove(served, push="b"):
    return served.json("POST", f"/api/subjects/{served.key()}/pushes/remove", {"push": push})


def test_a_push_goes_with_its_marks_and_comes_back_with_them(served, girl):
    before = content_of(girl)
    assert stale(served) == ([], [])
    status, said = remove(served)
    assert status == 200, said
    told = " ".join(said["lines"])
    for words in ("Push b was removed", "stay in the folder (pushes/b.dcm)", "34 marked vertebrae", "out of date"):
        assert words in told, told
    after = content_of(girl)
    changed = {"subject.json", "annotation.json", "annotation.draft.json"}
    assert {name for name in before if after.get(name) != before[name]} == changed and set(after) == set(before)
    values = read_json(girl / "subject.json")
    assert [push["id"] for push in values["pushes"]] == ["a"]
    assert values["xray"] == {"scale": {"rest/frontal": SCALE}, "images": {"rest/lateral": DISTANCES}}
    assert set(read_json(girl / "annotation.json")["images"]) == {"rest/frontal", "rest/lateral", "push/a"}
    assert set(read_json(girl / "annotation.draft.json")["images"]) == {"push/a"}
    assert len(read_subject(girl).pushes) == 1
    assert stale(served) == (["annotation: pushes", "values: pushes"],) * 2
    (listed,) = served.good("GET", "/api/trash")["trash"]
    assert (listed["key"], listed["name"], listed["push"], listed["image"]) == (said["trash"], "girl", "b", None)
    assert listed["vertebrae"] == 34
    back = served.good("POST", f"/api/trash/{said['trash']}/restore", {})
    assert back == {"key": served.key(), "trash": None} and stale(served) == ([], [])
    assert {name: read_json(girl / name) for name in changed} == {
        name: marks.parse_json(before[name].decode(), name) for name in changed
    }
    assert served.good("GET", "/api/trash")["trash"] == []
    # For good: what is known of it is gone, its radiographs are not.
    trash = remove(served)[1]["trash"]
    served.good("DELETE", f"/api/trash/{trash}")
    assert (girl / "pushes" / "b.dcm").read_bytes() == before["pushes/b.dcm"]


KILLED = """
import os, sys
from pathlib import Path
from spinestiff.workbench import push_removal
from spinestiff.workbench.rooms import open_root
from spinestiff.workbench.trash import Trash
number, write = int(sys.argv[2]), push_removal.write_changed
def killed(*given):
    global number
    write(*given)
    number -= 1
    if number == 0:
        os._exit(9)
push_removal.write_changed = killed
root = open_root(Path(sys.argv[1]))
Trash(root).remove_push(root.path / "girl", "b")
"""


@pytest.mark.parametrize("number", [1, 2])
def test_whoever_is_killed_while_a_push_is_taken_out_loses_nothing(served, girl, number):
    before = content_of(girl)
    given = [str(served.bench.root.path), str(number)]
    assert subprocess.run([sys.executable, "-c", KILLED, *given], check=False).returncode == 9
    assert content_of(girl) != before
    (trash,) = served.good("GET", "/api/trash")["trash"]
    served.good("POST", f"/api/trash/{trash['key']}/restore", {})
    assert content_of(girl) == before and served.good("GET", "/api/trash")["trash"] == []


def test_what_can_not_be_removed_or_put_back_is_said_and_changes_nothing(served, girl, monkeypatch):
    before = content_of(girl)
    assert remove(served, "c") == (404, {"error": "this push is not there, or no longer"})
    with sole_run(girl):
        assert remove(served)[0] == 409
    values = read_json(girl / "subject.json")
    values["pushes"][0]["roles"] = ["unused", "unused", "validation"]
    write_json(girl / "subject.json", values)
    status, said = remove(served, "a")
    assert status == 422 and "push a can't be removed" in said["error"] and "role training" in said["error"]
    (girl / "subject.json").write_bytes(before["subject.json"])

    def full(path, data):
        if path.name == "annotation.json":
            raise OSError(28, "No space left on device")
        write_json(path, data)

    with monkeypatch.context() as patch:
        patch.setattr(marks, "write_json", full)
        status, said = remove(served)
    assert status == 422 and "the disk is full" in said["error"] and "nothing was changed" in said["error"]
    assert content_of(girl) == before and served.good("GET", "/api/trash")["trash"] == []
    trash = remove(served)[1]["trash"]
    values = read_json(girl / "subject.json")
    write_json(girl / "subject.json", values | {"pushes": [values["pushes"][0] | {"id": "B"}]})
    (girl / "annotation.json").unlink()
    (girl / "annotation.draft.json").unlink()
    status, said = served.json("POST", f"/api/trash/{trash}/restore", {})
    assert status == 422 and "used twice" in said["error"]
    write_json(girl / "subject.json", values | {"id": "somebody-else"})
    status, said = served.json("POST", f"/api/trash/{trash}/restore", {})
    assert status == 422 and "this was taken from 'girl'" in said["error"]
    write_json(girl / "subject.json", values)
    removed = served.good("DELETE", f"/api/subjects/{served.key()}")["trash"]
    status, said = served.json("POST", f"/api/trash/{trash}/restore", {})
    assert status == 422 and "the subject girl is not there" in said["error"]
    served.good("POST", f"/api/trash/{removed}/restore", {})
    place = served.bench.trash.folder / trash / "push.json"
    write_json(place, read_json(place) | {"subject": "../girl"})
    status, said = served.json("POST", f"/api/trash/{trash}/restore", {})
    assert status == 422 and "damaged" in said["error"]
    assert [one["name"] for one in served.good("GET", "/api/trash")["trash"]] == ["a push that can't be put back"]


@pytest.mark.skipif(not HAS_BROWSER, reason="no Chromium to open the page in, or no pipe to drive it by")
def test_the_form_removes_a_push_and_takes_it_back(tab, served, girl):
    place = girl / "subject.json"
    first = read_json(place)
    ids = "[...document.querySelectorAll('.push legend')].map(one => one.innerText).join()"
    saved = "document.querySelector('.saved').innerText.startsWith('Saved')"
    load(tab, served.address)
    go(tab, f"/subject/{served.key()}/values")
    fill(tab, "#f-age", "14")
    tab.until(saved)
    # What is not possible elsewhere stays as it was typed.
    fill(tab, "#f-height-cm", "20")
    click(tab, "[aria-label='Remove this push: b']")
    tab.until(f"{ids} == 'Push a'")
    assert "Push b was removed" in text(tab, "#undo") and "34 marked vertebrae" in text(tab, "#undo")
    assert tab.run("document.querySelector('#f-height-cm').value") == "20"
    tab.until("document.querySelector('.saved').innerText.startsWith('Not saved')")
    fill(tab, "#f-height-cm", "157")
    tab.until(saved)
    assert [push["id"] for push in read_json(place)["pushes"]] == ["a"]
    # Undo goes back step by step, beyond the removal.
    click(tab, "#undo-values")
    tab.until(f"{ids} == 'Push b,Push a'")
    tab.until("document.querySelector('#undo').hidden")
    assert read_json(place) == first | {"age": 14}
    click(tab, "#undo-values")
    tab.wait(lambda: read_json(place) == first)
    # Or at once, by the line that says what was done.
    click(tab, "[aria-label='Remove this push: b']")
    tab.until(f"{ids} == 'Push a'")
    click(tab, "#undo button")
    tab.until(f"{ids} == 'Push b,Push a'")
    assert read_json(place) == first
    click(tab, "[aria-label='Remove this push: b']")
    tab.until(f"{ids} == 'Push a'")
    go(tab, "/trash")
    assert "girl: push b" in text(tab) and "in the subject’s folder still" in text(tab)
    # The value that was not possible, while it was checked.
    assert all("422" in line for line in tab.complaints)


def test_radiographs_of_a_removed_push_may_come_again_under_another_name(served, root):
    content = (root / "girl" / "pushes" / "a.dcm").read_bytes()
    asked = {"origin": "upload", "key": served.upload({"I5": content}), "subject": served.key()}
    assert served.good("POST", "/api/look", asked)["changes"] == []
    assert remove(served, "a")[0] == 200
    card = served.good("GET", f"/api/subjects/{served.key()}")
    assert card["pushes"] == 0 and "There is no push" in " ".join(card["missing"])
    assert served.good("GET", f"/api/subjects/{served.key()}/results")["stale"] == []
    assert served.good("POST", "/api/look", asked)["changes"] == ["Push-1, 3 frames."]
    served.good("POST", f"/api/subjects/{served.key()}/radiographs", asked)
    assert (root / "girl" / "pushes" / "push-1.dcm").read_bytes() == content
    assert (root / "girl" / "pushes" / "a.dcm").read_bytes() == content
