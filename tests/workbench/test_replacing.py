"""A rest radiograph that gives its place to another file: what goes with it, what comes back, what is refused."""

from __future__ import annotations

import json
import subprocess
import sys
import threading

import numpy as np
import pytest

from hospital import export
from spinestiff.annotate.draft import Draft, DraftImage
from spinestiff.annotate.session import AnnotationSession
from spinestiff.errors import ChangedElsewhere, SubjectError
from spinestiff.files import file_digest, read_json, write_json
from spinestiff.subject.annotation_record import Annotation
from spinestiff.subject.folder import read_subject, write_annotation
from spinestiff.subject.intake.adding import read_standing
from spinestiff.subject.intake.collecting import collect
from spinestiff.subject.lock import sole_run
from spinestiff.subject.run_record import record_step, step_record
from spinestiff.workbench import marks, push_removal, replacing, trash
from spinestiff.workbench.marks import texts_of
from spinestiff.workbench.trash import Trash
from unannotated import drawn

SCALE = {"object_mm": 25.4, "object_px": [[10.0, 20.0], [40.0, 20.0]]}
INPUTS = ("subject.json: pushes", "annotation.json: rest", "rest/frontal.dcm", "rest/lateral.dcm", "pushes/a.dcm")


def content_of(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def girl(root):
    """A subject that is annotated, with a known length in its frontal radiograph and a record of a report."""
    folder = root / "girl"
    images = {name: drawn(name) for name in ("rest/frontal", "rest/lateral", "push/a")}
    whole = {name: DraftImage.model_validate({"vertebrae": shown.named()}).whole() for name, shown in images.items()}
    write_annotation(folder, Annotation(schema_version=1, images=whole))
    draft = {"vertebrae": drawn("rest/lateral").named(), "spine": [[1.0, 2.0]]}
    write_json(folder / "annotation.draft.json", {"schema_version": 1, "images": {"rest/lateral": draft}})
    write_json(
        folder / "subject.json",
        read_json(folder / "subject.json")
        | {"xray": {"scale": {"rest/frontal": SCALE}, "images": {"rest/frontal": {"source_detector_mm": 1500.0}}}},
    )
    (folder / "results").mkdir()
    (folder / "results" / "estimate.json").write_text("{}", encoding="utf-8")
    subject = read_subject(folder)
    record_step(subject, "report", step_record(subject, INPUTS, {}), [])
    return folder


def wish(served, tmp_path, name="I9", kind="frontal", image="rest/frontal", **tags):
    """An upload with one radiograph, and the question what it becomes in the place of a rest one."""
    path = export(tmp_path / "new" / name, kind, **{"patient": "", "time": "114500", **tags})
    key = served.upload({name: path.read_bytes()})
    return {"origin": "upload", "key": key, "subject": served.key(), "replaces": image}, path.read_bytes()


def replaced(served, asked):
    return served.good("POST", f"/api/subjects/{served.key()}/rest", asked)["trash"]


def stale(served):
    address = f"/api/subjects/{served.key()}"
    return served.good("GET", address)["stale"], served.good("GET", f"{address}/results")["stale"]


def test_a_rest_radiograph_is_replaced_and_comes_back_with_its_marks(served, girl, tmp_path):
    before, (asked, new) = content_of(girl), wish(served, tmp_path)
    assert stale(served) == ([], [])
    look = served.good("POST", "/api/look", asked)
    assert [(one["name"], one["use"]) for one in look["files"]] == [("I9", "rest, frontal")]
    told = " ".join(look["changes"])
    for words in ("moves to the trash", "17 marked vertebrae go with it", "annotated from the start", "xray.scale",
                  "xray.images", "Annotations of all other radiographs stay", "out of date"):  # fmt: skip
        assert words in told, told
    assert content_of(girl) == before
    trash = replaced(served, asked)
    assert (girl / "rest" / "frontal.dcm").read_bytes() == new
    annotation, first = read_json(girl / "annotation.json"), json.loads(before["annotation.json"])
    assert set(annotation["images"]) == {"rest/lateral", "push/a"} and "xray" in read_json(girl / "subject.json")
    assert annotation["images"]["push/a"] == first["images"]["push/a"]
    assert read_json(girl / "subject.json")["xray"] == {}
    assert content_of(girl)["annotation.draft.json"] == before["annotation.draft.json"]
    card = served.good("GET", f"/api/subjects/{served.key()}")
    assert card["stage"] == "annotate" and "Rest, frontal: not annotated" in card["missing"]
    assert stale(served) == (["annotation: rest", "rest/frontal.dcm"],) * 2
    listed = served.good("GET", "/api/trash")["trash"]
    assert [(one["key"], one["name"], one["image"], one["vertebrae"]) for one in listed] == [
        (trash, "girl", "rest/frontal", 17)
    ]
    # Back, with its marks; the other one takes its place in the trash, and can come again.
    back = served.good("POST", f"/api/trash/{trash}/restore", {})
    assert back["key"] == served.key() and content_of(girl) == before and stale(served) == ([], [])
    assert [one["key"] for one in served.good("GET", "/api/trash")["trash"]] == [back["trash"]]
    served.good("POST", f"/api/trash/{back['trash']}/restore", {})
    assert (girl / "rest" / "frontal.dcm").read_bytes() == new
    (last,) = served.good("GET", "/api/trash")["trash"]
    served.good("DELETE", f"/api/trash/{last['key']}")
    assert served.good("GET", "/api/trash")["trash"] == []


def test_a_draft_goes_and_comes_with_its_picture(served, girl, tmp_path):
    before, (asked, _) = content_of(girl), wish(served, tmp_path, "I2", "lateral", "rest/lateral")
    trash = replaced(served, asked)
    assert not (girl / "annotation.draft.json").exists()
    served.good("POST", f"/api/trash/{trash}/restore", {})
    assert content_of(girl) == before


def test_the_same_marks_in_another_picture_are_no_reason_to_keep_a_result(served, girl, tmp_path):
    drawn_before = (girl / "annotation.json").read_bytes()
    replaced(served, wish(served, tmp_path)[0])
    (girl / "annotation.json").write_bytes(drawn_before)
    assert stale(served) == (["rest/frontal.dcm"],) * 2


def test_a_page_that_shows_the_picture_before_saves_nothing(served, root, tmp_path):
    """Nobody has saved a mark, so that nothing but the picture tells the page that it is no longer the one."""
    page, there = f"/annotate/{served.key()}/api", f"/api/subjects/{served.key()}/radiographs"
    before = [one["version"] for one in served.good("GET", there)["files"]]
    shown = f"{page}/radiograph?image=rest/frontal&wide=96&tall=128"
    open_, old = served.good("GET", f"{page}/session"), served.ask("GET", shown)[2]
    asked, _ = wish(served, tmp_path)
    replaced(served, asked)
    draft = {"schema_version": 1, "images": {"rest/frontal": {"vertebrae": drawn("rest/frontal").named()}}}
    status, body = served.json("PUT", f"{page}/annotation", {"revision": open_["revision"], "draft": draft})
    assert status == 409 and "reload this page" in body["error"]
    assert not (root / "girl" / "annotation.json").exists()
    assert served.ask("GET", shown)[2] != old
    after = [one["version"] for one in served.good("GET", there)["files"]]
    assert before[0] != after[0] and before[1:] == after[1:]
    again = served.good("GET", f"{page}/session")
    sent = {"revision": again["revision"], "draft": {"schema_version": 1, "images": {}}}
    # Nothing was marked before, and nothing is now.
    assert served.good("PUT", f"{page}/annotation", sent)["revision"] == again["revision"]


def test_an_annotation_that_is_open_elsewhere_notices_the_new_picture(root, served, tmp_path):
    session = AnnotationSession(root / "girl")
    before, old = session.revision, np.array(session.radiographs.frames("rest/frontal")[0].pixels)
    replaced(served, wish(served, tmp_path)[0])
    with pytest.raises(ChangedElsewhere, match="was replaced meanwhile"):
        session.save(Draft(schema_version=1, images={}), before)
    session.reload()
    assert session.revision != before
    new = session.radiographs.frames("rest/frontal")[0].pixels
    assert new.shape != old.shape or not np.array_equal(new, old)


def test_marks_that_are_saved_while_a_radiograph_is_copied_stay(served, girl, tmp_path, monkeypatch):
    session, real = AnnotationSession(girl), replacing.copy_known
    later = session.marks["push/a"].model_copy(update={"supports": {"pelvis": ((9.0, 9.0),)}})
    moved = Draft(schema_version=1, images={**session.marks, "push/a": later})

    def slow(*asked):
        real(*asked)
        session.save(moved, session.revision)

    monkeypatch.setattr(replacing, "copy_known", slow)
    replaced(served, wish(served, tmp_path)[0])
    images = read_json(girl / "annotation.json")["images"]
    assert set(images) == {"rest/lateral", "push/a"} and images["push/a"]["supports"] == {"pelvis": [[9.0, 9.0]]}


@pytest.mark.parametrize("act", ["replace", "remove a push", "return a push"])
def test_a_page_saves_before_or_after_marks_change_places_and_never_between(served, girl, tmp_path, monkeypatch, act):
    trash = served.bench.trash
    source = export(tmp_path / "new" / "I9", "frontal", patient="", time="114500")
    key = trash.remove_push(girl, "a")[0] if act == "return a push" else ""
    session, refused = AnnotationSession(girl), []
    images = {name: image for name, image in session.marks.items() if name != "rest/lateral"}

    def save():
        try:
            session.save(Draft(schema_version=1, images=images), session.revision)
        except ChangedElsewhere as error:
            refused.append(error)

    page = threading.Thread(target=save)

    def slow(folder):
        found = texts_of(folder)
        page.start()
        page.join(0.3)
        return found

    for module in (replacing, push_removal):
        monkeypatch.setattr(module, "texts_of", slow)
    if act == "replace":
        trash.replace(girl, "rest/frontal", source, file_digest(source))
    elif act == "remove a push":
        trash.remove_push(girl, "a")
    else:
        trash.restore(key)
    page.join(20)
    assert len(refused) == 1
    left = {"replace": {"push/a"}, "remove a push": {"rest/frontal"}, "return a push": {"rest/frontal", "push/a"}}
    assert set(read_json(girl / "annotation.json")["images"]) == {*left[act], "rest/lateral"}


def test_what_can_not_take_the_place_is_refused_and_changes_nothing(served, girl, tmp_path, monkeypatch):
    before, address = content_of(girl), f"/api/subjects/{served.key()}/rest"
    asked, _ = wish(served, tmp_path)
    wrong, _ = wish(served, tmp_path, "I2", "lateral")
    several, _ = wish(served, tmp_path, "I3", frames=2)
    same = served.upload({"I1": (girl / "rest" / "frontal.dcm").read_bytes()})
    for body, words in (
        ({**wrong, "frontal": "I2"}, "wanted a frontal radiograph"),
        (wrong, "none of these files is told to take the place"),
        ({**several, "frontal": "I3"}, "one frame"),
        ({**asked, "key": same, "frontal": "I1"}, "the same image as rest/frontal.dcm"),
        ({**asked, "replaces": None}, "wanted replaces"),
        ({**asked, "replaces": "push/a"}, "replaces"),
    ):
        status, said = served.json("POST", address, body)
        assert status == 422 and words in said["error"], said
    with sole_run(girl):
        assert served.json("POST", address, asked)[0] == 409
    served.bench.jobs.ask(served.key(), "report", {})
    status, said = served.json("POST", address, asked)
    assert status == 409 and "has a job" in said["error"]

    def full(path, data):
        if path.name == "annotation.json":
            raise OSError(28, "No space left on device")
        write_json(path, data)

    source = tmp_path / "new" / "I9"
    monkeypatch.setattr(marks, "write_json", full)
    with pytest.raises(SubjectError, match=r"the disk is full.*nothing was changed"):
        served.bench.trash.replace(girl, "rest/frontal", source, file_digest(source))
    assert content_of(girl) == before and served.good("GET", "/api/trash")["trash"] == []
    (girl / "rest" / "lateral.dcm").unlink()
    standing = read_standing(girl)
    with pytest.raises(SubjectError, match=r"has no rest/lateral\.dcm that could be replaced"):
        replacing.choose(standing, (), "rest/lateral", None)


KILLED = """
import os, sys
from pathlib import Path
from spinestiff.workbench import replacing
from spinestiff.workbench.rooms import open_root
from spinestiff.workbench.trash import Trash
number, write = int(sys.argv[4]), replacing.write_changed
def killed(*given):
    global number
    if number == 0:
        os._exit(9)
    write(*given)
    number -= 1
    if number == 0:
        os._exit(9)
replacing.write_changed = killed
root = open_root(Path(sys.argv[1]))
Trash(root).replace(root.path / "girl", "rest/frontal", Path(sys.argv[2]), sys.argv[3])
"""


@pytest.mark.parametrize("number", [0, 1, 2])
def test_whoever_is_killed_while_pictures_change_places_loses_nothing(served, girl, tmp_path, number):
    before, _ = content_of(girl), wish(served, tmp_path)
    source = tmp_path / "new" / "I9"
    given = [str(served.bench.root.path), str(source), file_digest(source), str(number)]
    assert subprocess.run([sys.executable, "-c", KILLED, *given], check=False).returncode == 9
    for draft in (girl / "rest").glob(".*.tmp"):
        draft.unlink()
    (trash,) = served.good("GET", "/api/trash")["trash"]
    served.good("POST", f"/api/trash/{trash['key']}/restore", {})
    assert content_of(girl) == before


def test_what_was_said_comes_back_on_a_disk_that_the_new_radiograph_has_filled(served, girl, tmp_path, monkeypatch):
    before, (asked, _), write_text = content_of(girl), wish(served, tmp_path), marks.write_text

    def smaller(path, data):
        if path.name == "annotation.json":
            raise SubjectError(f"{path.name}: can't be written (the disk is full)")
        write_json(path, data)

    def larger(path, text):
        if list((girl / "rest").glob(".*.tmp")):
            raise SubjectError(f"{path.name}: can't be written (the disk is full)")
        write_text(path, text)

    monkeypatch.setattr(marks, "write_json", smaller)
    monkeypatch.setattr(marks, "write_text", larger)
    status, said = served.json("POST", f"/api/subjects/{served.key()}/rest", asked)
    assert status == 422 and "the disk is full" in said["error"]
    assert content_of(girl) == before and served.good("GET", "/api/trash")["trash"] == []


def test_only_the_file_that_was_looked_at_takes_the_place(served, girl, tmp_path, monkeypatch):
    asked, _ = wish(served, tmp_path)
    served.good("POST", "/api/look", asked)
    gone, before = replaced(served, asked), content_of(girl)
    asked, content = wish(served, tmp_path, "I8")
    served.good("POST", "/api/look", asked)
    other = content[:-2] + bytes(byte ^ 1 for byte in content[-2:])
    (served.bench.uploads.place(asked["key"]) / "files" / "I8").write_bytes(other)
    status, said = served.json("POST", f"/api/subjects/{served.key()}/rest", asked)
    assert status == 409 and said["error"] == "the radiograph: was changed after it was looked at; look at it again"
    # And from the trash, between the look at its patient and the exchange.
    place = served.bench.trash.folder / gone / "frontal.dcm"
    monkeypatch.setattr(trash, "check_patient", lambda *_, **__: place.write_bytes(other))
    assert served.json("POST", f"/api/trash/{gone}/restore", {})[0] == 409
    assert content_of(girl) == before and len(served.good("GET", "/api/trash")["trash"]) == 1


def test_the_radiographs_that_stay_say_whose_the_new_one_must_be(root, tmp_path):
    """The one that goes may be another person's: that is a reason to replace it."""
    folder = root / "girl"
    mine = {"PatientName": "ROE^RICHARD", "PatientBirthDate": "20010101", "patient": "P2"}
    export(folder / "rest" / "lateral.dcm", "lateral", **mine)
    (folder / "pushes" / "a.dcm").unlink()
    export(folder / "pushes" / "a.dcm", frames=3, **mine)
    export(folder / "rest" / "frontal.dcm", patient="P1")
    (found,) = collect([export(tmp_path / "I9", **mine)])[0]
    standing = read_standing(folder)
    assert replacing.choose(standing, [found], "rest/frontal", None).one is found
    (other,) = collect([export(tmp_path / "I8", patient="P1")])[0]
    with pytest.raises(SubjectError, match="of another patient"):
        replacing.choose(standing, [other], "rest/frontal", None)


def test_of_several_one_has_to_be_chosen_and_an_image_twice_is_told(root, tmp_path):
    folder = root / "girl"
    for number in range(2):
        export(tmp_path / "in" / f"I{number}", time=f"10150{number}", patient="")
    (tmp_path / "in" / "I7").write_bytes((folder / "rest" / "lateral.dcm").read_bytes())
    found = collect([tmp_path / "in"])[0]
    standing = read_standing(folder)
    choice = replacing.choose(standing, found, "rest/frontal", None)
    assert choice.one is None and "choose below" in choice.reasons["I1"] and "lateral" in choice.reasons["I7"]
    assert replacing.choose(standing, found, "rest/frontal", found[1]).one is found[1]
    (nameless,) = collect([export(tmp_path / "I8", patient="", without=("PatientOrientation", "ViewPosition"))])[0]
    (folder / "rest" / "lateral.dcm").write_bytes((tmp_path / "I8").read_bytes())
    notes = replacing.choose(read_standing(folder), [nameless], "rest/frontal", None).notes
    assert len(notes) == 1 and "is the same image as rest/lateral.dcm" in notes[0]


def test_what_is_in_the_trash_is_not_put_back_into_another_subject_of_the_name(served, girl, tmp_path):
    trash = replaced(served, wish(served, tmp_path)[0])
    values = read_json(girl / "subject.json")
    write_json(girl / "subject.json", values | {"id": "somebody-else"})
    before = content_of(girl)
    status, body = served.json("POST", f"/api/trash/{trash}/restore", {})
    assert status == 422 and "has the id 'somebody-else', and this was taken from 'girl'" in body["error"]
    assert content_of(girl) == before
    # One of before ids were kept goes by the name alone.
    record = served.bench.trash.folder / trash / "radiograph.json"
    write_json(record, {key: one for key, one in read_json(record).items() if key != "id"})
    served.good("POST", f"/api/trash/{trash}/restore", {})


def test_a_subject_that_is_no_object_is_refused_by_its_name(served, girl):
    write_json(girl / "subject.json", [])
    with pytest.raises(SubjectError, match=r"^subject\.json: wanted an object"):
        served.bench.trash.remove_push(girl, "a")


def test_a_radiograph_in_the_trash_waits_for_its_subject(served, girl, tmp_path):
    trash = replaced(served, wish(served, tmp_path)[0])
    removed = served.good("DELETE", f"/api/subjects/{served.key()}")["trash"]
    status, body = served.json("POST", f"/api/trash/{trash}/restore", {})
    assert status == 422 and "the subject girl is not there" in body["error"]
    served.good("POST", f"/api/trash/{removed}/restore", {})
    # Of a record that somebody has changed nothing is taken.
    place = served.bench.trash.folder / trash / "radiograph.json"
    write_json(place, read_json(place) | {"subject": "../girl"})
    status, body = served.json("POST", f"/api/trash/{trash}/restore", {})
    assert status == 422 and "damaged" in body["error"]
    listed = {one["key"]: one["name"] for one in Trash(served.bench.root).listed()}
    assert "can't be put back" in listed[trash]
