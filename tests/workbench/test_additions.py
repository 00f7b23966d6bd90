"""A subject that is there already, as the page asks for it: more radiographs, a table, pictures, what is stale."""

from __future__ import annotations

import json

import numpy as np
import pydicom
import pytest

from hospital import CANARY, disc, export
from spinestiff.annotate.draft import DraftImage
from spinestiff.files import read_json, write_json
from spinestiff.imaging.dicom.millimetres import Geometry
from spinestiff.imaging.radiograph import read_scans, shrunk
from spinestiff.subject.annotation_record import Annotation
from spinestiff.subject.folder import read_annotation, read_subject, write_annotation
from spinestiff.subject.run_record import record_step, step_record
from unannotated import drawn

TABLE = "file,frame,force_n,side,level,d21_mm,d31_mm,role"


def annotated(folder):
    images = {name: drawn(name) for name in ("rest/frontal", "rest/lateral", "push/a")}
    whole = {name: DraftImage.model_validate({"vertebrae": shown.named()}).whole() for name, shown in images.items()}
    write_annotation(folder, Annotation(schema_version=1, images=whole))


@pytest.fixture
def more(served, tmp_path):
    """An upload with a lateral radiograph, the subject's own push again and a new push of two frames."""
    folder = served.bench.root.path / "girl"
    export(tmp_path / "more" / "I2", "lateral", patient="", time="103000")
    export(tmp_path / "more" / "I8", frames=2, patient="", time="104000")
    (tmp_path / "more" / "I1").write_bytes((folder / "pushes" / "a.dcm").read_bytes())
    upload = served.upload_folder(tmp_path / "more")
    return {"origin": "upload", "key": upload, "subject": served.key(), "study": "A1"}


def test_radiographs_are_looked_at_and_added(served, root, more):
    (root / "girl" / "rest" / "lateral.dcm").unlink()
    before = read_json(root / "girl" / "subject.json")
    look = served.good("POST", "/api/look", more)
    found = {one["name"].rpartition("/")[2]: one for one in look["files"]}
    assert {name: one["use"] for name, one in found.items()} == {"I2": "rest, lateral", "I8": "push-2"}
    assert look["changes"] == ["A lateral radiograph at rest.", "Push-2, 2 frames."]
    assert read_json(root / "girl" / "subject.json") == before
    added = served.good("POST", f"/api/subjects/{served.key()}/radiographs", more)
    assert added["changes"] == look["changes"]
    after = read_json(root / "girl" / "subject.json")
    assert after["pushes"][0] == before["pushes"][0] and after["pushes"][1]["forces_n"] == [None, None]
    there = served.good("GET", f"/api/subjects/{served.key()}/radiographs")
    assert [(one["image"], one["frames"], one["use"]) for one in there["files"]] == [
        ("rest/frontal", 1, "rest, frontal"), ("rest/lateral", 1, "rest, lateral"), ("push/a", 3, "push a"),
        ("push/push-2", 2, "push-2"),
    ]  # fmt: skip
    assert there["rest"] == ["rest/frontal", "rest/lateral"]
    # The annotation page has the new ones, too.
    session = served.good("GET", f"/annotate/{served.key()}/api/session")
    assert [one["name"] for one in session["images"]] == [one["image"] for one in there["files"]]
    status, body = served.json("POST", f"/api/subjects/{served.key()}/radiographs", more)
    assert status == 422 and "nothing new in it" in body["error"]


def test_the_annotation_page_shows_a_radiograph_that_has_come(served, root):
    path, page = root / "girl" / "rest" / "lateral.dcm", f"/annotate/{served.key()}/api/session"
    content = path.read_bytes()
    path.unlink()
    assert len(served.good("GET", page)["images"]) == 2
    path.write_bytes(content)
    assert len(served.good("GET", page)["images"]) == 3


def test_a_table_alone_fills_a_push(served, root):
    key = served.key()
    form = served.good("GET", f"/api/subjects/{key}/form")
    form["values"]["pushes"][0] |= {"forces_n": [0, None, 40], "side": None}
    served.good("PUT", f"/api/subjects/{key}/form", {"values": form["values"], "revision": form["revision"]})
    asked = {"origin": "none", "subject": key, "table": f"{TABLE}\npushes/a.dcm,1,25,left,9,,,\n"}
    look = served.good("POST", "/api/look", asked)
    assert (look["files"], look["changes"]) == ([], ["Values of push a that were open."])
    assert look["notes"] == ["push a, level: stays 8, the table has 9.0"]
    served.good("POST", f"/api/subjects/{key}/radiographs", asked)
    push = read_json(root / "girl" / "subject.json")["pushes"][0]
    assert (push["side"], push["level"], push["forces_n"]) == ("left", 8, [0, 25, 40])
    for table, words in (
        (f"{TABLE}\nI9,0,0,,,,,", "no radiograph 'I9'"),
        (f"{TABLE}\npushes/a.dcm,7,0,,,,,", "has 3 frames"),
        ("x,y", "the table of pushes: "),
        (f"{TABLE}\n" + "#" * 2**20, "more than 1 MB"),
    ):
        status, body = served.json("POST", "/api/look", {**asked, "table": table})
        assert status == 422 and words in body["error"] and "--" not in body["error"], body


def test_a_new_subject_takes_a_table(served, root, tmp_path):
    upload = served.upload_folder(disc(tmp_path / "disc"))
    table = f"{TABLE}\nSE000007/IM000001,1,30,left,5,400,200,training\n"
    look = {"origin": "upload", "key": upload, "table": table}
    found = served.good("POST", "/api/look", look)
    uses = {one["name"].rpartition("ST000001/")[2]: one for one in found["files"]}
    assert uses["SE000007/IM000001"]["use"] == "push 1" and uses["SE000008/IM000001"]["use"] == "left out"
    served.good("POST", "/api/subjects", {**look, "name": "new", "person": {}})
    (push,) = read_json(root / "new" / "subject.json")["pushes"]
    assert (push["id"], push["forces_n"], push["d21_mm"]) == ("left-5", [None, 30, None], 400)


def test_a_table_calls_files_by_their_names_whatever_signs_are_in_them(served, tmp_path):
    (tmp_path / "in").mkdir()
    export(tmp_path / "in" / "rest.dcm", time="101000")
    export(tmp_path / "in" / "A&P #1.dcm", frames=2, time="102000")
    look = {"origin": "upload", "key": served.upload_folder(tmp_path / "in")}
    table = f"{TABLE}\nA&P #1.dcm,1,30,left,5,400,200,training\n"
    found = served.good("POST", "/api/look", {**look, "table": table})
    assert {one["name"]: one["use"] for one in found["files"]}["in/A&P #1.dcm"] == "push 1"


def test_words_of_the_command_line_do_not_reach_the_page(served, tmp_path):
    for number in range(2):
        export(tmp_path / "in" / f"I{number}", time=None, without=("SeriesInstanceUID",))
    export(tmp_path / "in" / "I5", frames=2)
    export(tmp_path / "in" / "I6", without=("PatientOrientation",))
    upload = served.upload_folder(tmp_path / "in")
    for choice in ({}, {"frontal": "in/I0"}, {"table": f"{TABLE}\nI5,0,0,,,,,"}):
        look = served.good("POST", "/api/look", {"origin": "upload", "key": upload, **choice})
        assert len(look["files"]) == 4
        assert "--" not in json.dumps(look["files"]), look["files"]
    alone = {"origin": "upload", "key": upload, "table": f"{TABLE}\nI0,0,0,,,,,"}
    status, refused = served.json("POST", "/api/look", alone)
    assert status == 422 and "leave the row out and choose it below" in refused["error"], refused


def test_a_picture_is_pixels_and_nothing_else(served, tmp_path):
    upload = served.upload_folder(disc(tmp_path / "disc"))
    asked = {"origin": "upload", "key": upload}
    names = [one["name"] for one in served.good("POST", "/api/look", asked)["files"]]
    for name in names:
        status, headers, content = served.ask("POST", "/api/look/picture", {**asked, "name": name})
        about = json.loads(headers["x-radiograph"])
        assert status == 200 and headers["cache-control"] == "no-store"
        assert set(about) == {"rows", "columns", "shape", "part", "shown", "window"}
        wide, tall = about["shown"]
        assert wide <= 96 and tall <= 128 and len(content) == 2 * wide * tall
        assert not any(part.encode() in content for part in CANARY.split("^"))
        shown = np.frombuffer(content, "<u2").reshape(tall, wide)
        path = served.bench.uploads.place(upload) / "files" / name
        (scan,), _ = read_scans(path, Geometry())
        assert np.corrcoef(shrunk(scan.pixels[0], 96, 128).ravel(), shown.ravel())[0, 1] > 0.999
    assert served.ask("POST", "/api/look/picture", {**asked, "name": "../secret"})[0] == 404


def test_views_and_markers_by_the_page(served, root, more):
    key = served.key()
    side = [one["name"] for one in served.good("POST", "/api/look", more)["files"] if one["name"].endswith("I2")]
    view = {"id": "side", "kind": "lateral", "frames": [1]}
    for wrong in ({"view": {}}, {"view": {"id": 5}}, {"names": ["x"]}, {"push": 4}):
        status, body = served.json(
            "POST", f"/api/subjects/{key}/views", {**more, "names": side, "push": 0, "view": view, **wrong}
        )
        assert status == 422 and body["error"], body
    served.good("POST", f"/api/subjects/{key}/views", {**more, "names": side, "push": 0, "view": view})
    again = {**more, "names": side, "push": 0, "view": {**view, "id": "again"}}
    status, body = served.json("POST", f"/api/subjects/{key}/views", again)
    assert status == 422 and "the same image as pushes/a-side.dcm, which the subject has" in body["error"]
    table = "\n".join(["marker,frame,x,y,z", *(f"{name},{frame},1,2,3" for name in "abc" for frame in range(3))])
    markers = {"unit": "mm", "axes": {"left": "+x", "up": "+z", "front": "-y"}, "side": "back", "shown": {"a": [9, 9]}}
    for wrong in ({"markers": {}}, {"text": ""}, {"push": 9}):
        sent = {"push": 0, "markers": markers, "text": table, **wrong}
        status, body = served.json("POST", f"/api/subjects/{key}/markers", sent)
        assert status == 422 and str(root) not in body["error"], body
    served.good("POST", f"/api/subjects/{key}/markers", {"push": 0, "markers": markers, "text": table})
    push = read_json(root / "girl" / "subject.json")["pushes"][0]
    assert (push["views"][0]["files"], push["markers"]["file"]) == ("pushes/a-side.dcm", "pushes/a-markers.csv")
    card = served.good("GET", f"/api/subjects/{key}")
    assert "Push a, frame 1, view side: not annotated" in card["missing"]
    rows = served.good("GET", f"/api/subjects/{key}/radiographs")["files"]
    told = {"image": "push/a/1/side", "name": "pushes/a-side.dcm", "frames": 1, "use": "push a, view side"}
    assert told in [{key: value for key, value in row.items() if key != "version"} for row in rows]


def test_what_was_made_before_is_told_to_be_stale(served, root, more):
    folder, key = root / "girl", served.key()
    annotated(folder)
    subject = read_subject(folder)
    (folder / "results").mkdir()
    (folder / "results" / "estimate.json").write_text("{}", encoding="utf-8")
    inputs = ("subject.json: pushes", "annotation.json: rest", "rest/frontal.dcm", "rest/lateral.dcm", "pushes/a.dcm")
    record_step(subject, "report", step_record(subject, inputs, {}), [])

    def stale():
        return (
            served.good("GET", f"/api/subjects/{key}")["stale"],
            served.good("GET", f"/api/subjects/{key}/results")["stale"],
        )

    assert stale() == ([], [])
    marks = read_annotation(folder / "annotation.json")
    served.good("POST", f"/api/subjects/{key}/radiographs", more)
    # Nobody has annotated the new push and its forces are not known: no step would read this subject now.
    assert stale() == (["values: pushes"], ["values: pushes"])
    (folder / "annotation.json").unlink()
    assert stale()[0] == ["annotation: rest", "values: pushes"]
    write_annotation(folder, marks)
    # A lateral radiograph that came later.
    record_step(subject, "report", step_record(subject, inputs[:3], {}), [])
    assert stale()[1] == ["rest/lateral.dcm", "values: pushes"]


def test_single_pictures_become_one_push_in_the_order_of_their_times(served, root, tmp_path):
    for name, time in (("I1", "101000"), ("I2", "104500"), ("I3", "103000")):
        export(tmp_path / "in" / name, time=time, patient="")
    key = served.upload_folder(tmp_path / "in")
    asked = {"origin": "upload", "key": key, "joined": [["in/I2", "in/I3"]]}
    look = served.good("POST", "/api/look", asked)
    uses = {one["name"]: one["use"] for one in look["files"]}
    assert uses == {"in/I1": "rest, frontal", "in/I3": "push 1, frame 0", "in/I2": "push 1, frame 1"}
    # To a subject that is there.
    beside = {**asked, "subject": served.key()}
    assert served.good("POST", "/api/look", beside)["changes"] == ["Push-2, 2 frames."]
    served.good("POST", f"/api/subjects/{served.key()}/radiographs", beside)
    place = root / "girl" / "pushes" / "push-2"
    assert [(place / f"00{i}.dcm").read_bytes() for i in range(2)] == [
        (tmp_path / "in" / name).read_bytes() for name in ("I3", "I2")
    ]
    assert read_json(root / "girl" / "subject.json")["pushes"][1]["forces_n"] == [None, None]
    status, said = served.json("POST", "/api/look", beside)
    assert status == 422 and "in/I2: the same image as pushes/push-2/001.dcm" in said["error"]
    status, said = served.json("POST", "/api/look", {**asked, "joined": [["in/I2", "in/I9"]]})
    assert status == 422 and "no radiograph 'in/I9'" in said["error"]
    # To a new one.
    made = served.good("POST", "/api/subjects", {**asked, "name": "boy", "person": {}})
    assert made["key"] == served.key("boy")
    assert len(read_json(root / "boy" / "subject.json")["pushes"][0]["forces_n"]) == 2


def test_what_files_do_not_tell_of_the_geometry_is_said_until_it_is_given(served, root):
    address = f"/api/subjects/{served.key()}/radiographs"
    assert served.good("GET", address)["lacking"] == []
    for name in ("rest/frontal.dcm", "pushes/a.dcm"):
        dataset = pydicom.dcmread(root / "girl" / name)
        del dataset.ImagerPixelSpacing
        dataset.save_as(root / "girl" / name)
    lacking = [f"{what}: no ImagerPixelSpacing" for what in ("rest, frontal", "push a")]
    assert served.good("GET", address)["lacking"] == lacking
    scale = {"object_mm": 25.4, "object_px": [[100.0, 20.0], [140.0, 20.0]]}
    values = read_json(root / "girl" / "subject.json")
    write_json(root / "girl" / "subject.json", values | {"xray": {"scale": {"rest/frontal": scale}}})
    assert served.good("GET", address)["lacking"] == lacking[1:]
