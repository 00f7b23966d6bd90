"""More radiographs for a subject that is there: what is new is added, what is there stays."""

from __future__ import annotations

import json
import shutil

import pytest

from hospital import disc, export
from spinestiff.errors import ChangedElsewhere, InUseError, SubjectError
from spinestiff.files import read_json, write_json
from spinestiff.subject.intake import adding, making
from spinestiff.subject.intake.collecting import collect
from spinestiff.subject.intake.push_table import COLUMNS, parse_push_table
from spinestiff.subject.intake.sorting import sort_files
from spinestiff.subject.lock import sole_run

AXES = {"left": "+x", "up": "+z", "front": "-y"}


def content_of(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def rows(*lines):
    return parse_push_table("\n".join([",".join((*COLUMNS, "role")), *lines]), "table")


def added(folder, source, table=None, **person):
    standing = adding.read_standing(folder)
    found = collect([source])[0] if source is not None else ()
    addition = adding.sort_addition(standing, found, table)
    data, notes = adding.added_data(standing, addition, person)
    adding.write_addition(standing, data, addition)
    return addition, data, notes


@pytest.fixture(scope="module")
def pristine(tmp_path_factory):
    """A subject with a frontal radiograph and a push of three frames, of which nothing is known."""
    place = tmp_path_factory.mktemp("adding")
    export(place / "first" / "I1", time="101500")
    export(place / "first" / "I7", frames=3, time="102200")
    sorting = sort_files(collect([place / "first"])[0])
    data = making.subject_data("girl", sorting)
    making.make_folder(place / "girl", data, sorting)
    return place


@pytest.fixture
def girl(pristine, tmp_path):
    return shutil.copytree(pristine / "girl", tmp_path / "girl")


def test_what_is_new_is_added_and_what_is_there_stays(girl, pristine, tmp_path):
    before = content_of(girl)
    shutil.copytree(pristine / "first", tmp_path / "disc" / "a")
    export(tmp_path / "disc" / "b" / "I2", "lateral", time="103000")
    export(tmp_path / "disc" / "b" / "I8", frames=2, time="104000")
    export(tmp_path / "disc" / "b" / "I9", time="104500")
    addition, data, notes = added(girl, tmp_path / "disc", age=13.0)
    assert dict(addition.held) == {"a/I1": "rest/frontal.dcm", "a/I7": "pushes/push-1.dcm"}
    assert "rest/frontal.dcm already, and nothing is overwritten" in addition.sorting.reasons["b/I9"]
    assert "the same image as pushes/push-1.dcm" in addition.sorting.reasons["a/I7"]
    after = content_of(girl)
    assert set(after) - set(before) == {"rest/lateral.dcm", "pushes/push-2.dcm"} and notes == []
    assert after["pushes/push-2.dcm"] == (tmp_path / "disc" / "b" / "I8").read_bytes()
    assert all(after[name] == content for name, content in before.items() if name != "subject.json")
    assert read_json(girl / "subject.json") == data and data["age"] == 13.0
    old = json.loads(before["subject.json"])
    assert data["pushes"][0] == old["pushes"][0] and data["pushes"][1]["forces_n"] == [None, None]


@pytest.mark.parametrize("name", ["I7", "pushes/push-1.dcm"])
def test_a_table_fills_what_is_open_in_a_push_that_is_there(girl, pristine, name):
    values = read_json(girl / "subject.json")
    values["pushes"][0] |= {"side": "left", "forces_n": [0, None, None]}
    (girl / "subject.json").write_text(json.dumps(values), encoding="utf-8")
    table = rows(f"{name},0,5,right,8,400,200,unused", f"{name},1,20,,,,,training", f"{name},2,40,,,,,validation")
    source = pristine / "first" if name == "I7" else None
    addition, data, notes = added(girl, source, table)
    assert list(addition.fills) == [0] and addition.sorting.pushes == ()
    assert data["pushes"] == [
        values["pushes"][0]
        | {"level": 8, "d21_mm": 400, "d31_mm": 200, "forces_n": [0, 20, 40]}
        | {"roles": ["unused", "training", "validation"]}
    ]
    assert notes == [
        "push-1, side: stays left, the table has right",
        "push-1, frame 0: stays 0 N, the table has 5 N",
    ]


def test_a_push_with_another_number_of_forces_is_not_filled(girl):
    values = read_json(girl / "subject.json")
    values["pushes"][0]["forces_n"] = [0, None]
    (girl / "subject.json").write_text(json.dumps(values), encoding="utf-8")
    with pytest.raises(SubjectError, match="push-1 has 2 forces_n, but 3 frames"):
        added(girl, None, rows("pushes/push-1.dcm,2,20,,,,,"))


def test_a_table_names_new_and_old_pushes_side_by_side(girl, tmp_path):
    export(tmp_path / "more" / "I8", frames=2, time="104000")
    table = rows("pushes/push-1.dcm,1,20,,,,,", "I8,0,0,left,5,400,200,", "I8,1,30,,,,,")
    addition, data, _ = added(girl, tmp_path / "more", table)
    assert [push["id"] for push in data["pushes"]] == ["push-1", "left-5"] and list(addition.fills) == [0]
    assert data["pushes"][0]["forces_n"] == [None, 20, None] and data["pushes"][1]["forces_n"] == [0, 30]
    assert (girl / "pushes" / "left-5.dcm").is_file()


def test_a_push_of_single_frames_is_known_again(tmp_path):
    for number in range(3):
        export(tmp_path / "disc" / "S" / f"I{number}", time=f"10250{number}", series="1.2.9", SeriesDescription="push")
    sorting = sort_files(collect([tmp_path / "disc"])[0])
    making.make_folder(tmp_path / "girl", making.subject_data("girl", sorting), sorting)
    table = rows(*(f"S/I{number},0,{10 * number},left,5,400,200," for number in range(3)))
    _, data, _ = added(tmp_path / "girl", tmp_path / "disc", table)
    assert [push["forces_n"] for push in data["pushes"]] == [[0, 10, 20]]
    with pytest.raises(SubjectError, match="has 3 files, and the table's 2 files, not the same"):
        added(tmp_path / "girl", tmp_path / "disc", rows("S/I0,0,0,left,5,,,", "S/I1,0,0,left,5,,,"))


def test_refused_additions_change_nothing(girl, tmp_path, monkeypatch):
    before = content_of(girl)
    standing = adding.read_standing(girl)
    disc(tmp_path / "disc")
    found = collect([tmp_path / "disc"])[0]
    frontal = next(one for one in found if one.frames == 1 and one.view == "frontal")
    with pytest.raises(SubjectError, match=r"rest/frontal\.dcm already"):
        adding.sort_addition(standing, found, None, frontal)
    with pytest.raises(SubjectError, match="is in the subject, but as no push's frame"):
        adding.sort_addition(standing, (), rows("rest/frontal.dcm,0,0,left,5,,,"))
    export(tmp_path / "other" / "I1", patient="P2", PatientName="ROE^RICHARD")
    with pytest.raises(SubjectError, match="of another patient than the subject's"):
        added(girl, tmp_path / "other")
    # Without their patients radiographs tell by pseudonyms.
    nameless = {"PatientIdentityRemoved": "YES", "PatientName": ""}
    mine, other = (collect([export(tmp_path / name, patient=name, **nameless)])[0] for name in ("p-1", "p-2"))
    adding.check_patient(mine, mine)
    with pytest.raises(SubjectError, match="have another pseudonym, or none, than the subject's; make a new"):
        adding.check_patient(mine, other)
    addition = adding.sort_addition(standing, found)
    data, _ = adding.added_data(standing, addition, {})
    with sole_run(girl), pytest.raises(InUseError):
        adding.write_addition(standing, data, addition)
    with monkeypatch.context() as patch:
        patch.setattr(adding, "write_json", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device")))
        with pytest.raises(SubjectError, match=r"can't be added .* nothing was changed"):
            adding.write_addition(standing, data, addition)
    assert content_of(girl) == before
    # A file that nobody named in subject.json is no free place.
    (girl / "pushes" / "push-2.dcm").write_bytes(b"x")
    with pytest.raises(SubjectError, match=r"pushes/push-2\.dcm: is in the subject already"):
        adding.write_addition(standing, data, addition)
    again, _ = adding.added_data(standing, addition, {})
    assert [push["id"] for push in again["pushes"]] == ["push-1", "push-2-2", "push-3"]
    (girl / "subject.json").write_text((girl / "subject.json").read_text() + "\n", encoding="utf-8")
    with pytest.raises(ChangedElsewhere):
        adding.write_addition(standing, again, addition)
    assert not (girl / "rest" / "lateral.dcm").exists() and not list(girl.glob(".adding*"))


def test_only_files_that_were_looked_at_are_copied(girl, tmp_path):
    """Whoever may write where radiographs come from puts no other file into a subject after they were looked at."""
    before, source = content_of(girl), tmp_path / "disc" / "I2"
    found = collect([export(source, "lateral", time="103000")])[0]
    standing = adding.read_standing(girl)
    addition = adding.sort_addition(standing, found)
    data, _ = adding.added_data(standing, addition, {})
    sorting = sort_files([*standing.files, *found])
    source.write_bytes(export(tmp_path / "other", "lateral", patient="P2").read_bytes())
    with pytest.raises(ChangedElsewhere, match=r"^I2: was changed after it was looked at; look at it again$"):
        adding.write_addition(standing, data, addition)
    assert content_of(girl) == before
    with pytest.raises(ChangedElsewhere, match=r"^I2: was changed after it was looked at"):
        making.make_folder(tmp_path / "boy", making.subject_data("boy", sorting), sorting)
    assert {path.name for path in tmp_path.iterdir()} == {"girl", "disc", "other"}


def test_a_view_from_another_side(girl, tmp_path):
    found = [collect([export(tmp_path / f"I{i}", "lateral", time=f"10300{i}")])[0][0] for i in range(2)]
    standing = adding.read_standing(girl)
    view = {"id": "side", "kind": "lateral", "frames": [0, 2], "turned_deg": 5.0}
    for bad, words in (
        ({"frames": [0]}, "has 2 radiographs in 2 files, but names 1 frame"),
        ({"kind": "frontal"}, "a lateral radiograph, wanted a frontal one"),
        ({"frames": [0, 3]}, "found frame 3, but the push has 3 frames"),
        ({"id": "../x"}, "letters"),
        ({"frames": "0"}, "wanted"),
        ({"turned_deg": 60.0}, "less than or equal to 40"),
    ):
        with pytest.raises(SubjectError, match=words):
            adding.add_view(standing, 0, {**view, **bad}, found)
    with pytest.raises(SubjectError, match="no push 1"):
        adding.add_view(standing, 1, view, found)
    assert not (girl / "pushes" / "push-1-side").exists()
    data = adding.add_view(standing, 0, view, found)
    assert data["pushes"][0]["views"] == [{**view, "files": "pushes/push-1-side"}]
    assert read_json(girl / "subject.json") == data
    assert sorted(content_of(girl / "pushes" / "push-1-side")) == ["000.dcm", "001.dcm"]
    assert adding.read_standing(girl).images["pushes/push-1-side/001.dcm"] == "push/push-1/0/side"


def test_skin_markers_come_with_a_table_that_can_be_read(girl):
    standing = adding.read_standing(girl)
    markers = {"unit": "mm", "axes": AXES, "side": "front", "shown": {"a": [20.0, 30.0]}}
    table = "\n".join(["marker,frame,x,y,z", *(f"{name},{frame},1,2,3" for name in "abc" for frame in range(3))])
    for bad, text, words in (
        ({}, "marker,frame", r"pushes/push-1-markers\.csv: "),
        ({}, table[:-10], "no row for frame 2"),
        ({"shown": {"d": [1.0, 2.0]}}, table, "no marker 'd', which is said to be shown; it has a, b, c"),
        ({"unit": "inch"}, table, "the markers: unit"),
        ({"shown": {}}, table, "shown"),
    ):
        with pytest.raises(SubjectError, match=words) as refused:
            adding.add_markers(standing, 0, {**markers, **bad}, text)
        assert str(girl) not in str(refused.value)
    assert not (girl / "pushes" / "push-1-markers.csv").exists()
    data = adding.add_markers(standing, 0, markers, table)
    assert data["pushes"][0]["markers"] == {**markers, "file": "pushes/push-1-markers.csv"}
    with pytest.raises(SubjectError, match="has markers already"):
        adding.add_markers(adding.read_standing(girl), 0, markers, table)
    # Taken out, the table stays where it was, and another one finds a place beside it.
    del data["pushes"][0]["markers"]
    write_json(girl / "subject.json", data)
    data = adding.add_markers(adding.read_standing(girl), 0, markers, table.replace("1,2,3", "4,5,6"))
    assert data["pushes"][0]["markers"]["file"] == "pushes/push-1-markers-2.csv"
    assert "1,2,3" in (girl / "pushes" / "push-1-markers.csv").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("place", "usual", "may_be"),
    [
        ("pushes/a-markers.csv", "pushes/a-markers.csv", True),
        ("pushes/a-markers-12.csv", "pushes/a-markers.csv", True),
        ("pushes/a-markers-2", "pushes/a-markers.csv", False),
        ("pushes/a-markers-b.csv", "pushes/a-markers.csv", False),
        ("pushes/rib-5.5-side-2", "pushes/rib-5.5-side", True),
        ("rest/frontal.dcm", "pushes/a-side.dcm", False),
    ],
)
def test_places_beside_the_usual_one(place, usual, may_be):
    assert adding.is_place(place, usual) is may_be
