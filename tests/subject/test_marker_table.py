"""The table of skin markers: read as it is stated, and one clear line for everything that can be wrong with it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from spinestiff.errors import SubjectError
from spinestiff.imaging.projection import frontal_view
from spinestiff.subject.folder import read_subject, write_subject
from spinestiff.subject.marker_table import read_markers, write_markers

DOCUMENT = (Path(__file__).parents[2] / "docs/subject-folder.md").read_text(encoding="utf-8")
SUBJECT, ANNOTATION = (json.loads(block) for block in re.findall(r"```json\n(.*?)```", DOCUMENT, re.S))
NAMES = ("C7", "m.2", "left-hip")
# Of the example's push with four frames: body's left, up and front, mm.
PLACES = np.arange(36.0).reshape(4, 3, 3)
MARKERS = {
    "file": "pushes/right-8-markers.csv",
    "unit": "mm",
    "axes": {"left": "+x", "up": "+z", "front": "-y"},
    "side": "front",
    "shown": {"C7": [400.0, 300.5]},
}
VIEW = frontal_view()


def rows(places=PLACES, names=NAMES):
    """The table's lines, as of a file whose y runs to the back and whose z runs up."""
    found = ["marker,frame,x,y,z"]
    for frame, there in enumerate(places):
        found += [f"{name},{frame},{left:g},{-front:g},{up:g}" for name, (left, up, front) in zip(names, there)]
    return found


@pytest.fixture
def laid_out(tmp_path):
    def lay_out(lines=None, forces=None, **changes):
        folder = tmp_path / "03"
        for name in ("rest/frontal.dcm", "rest/lateral.dcm", "pushes/right-8.dcm"):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(b"")
        push = {**SUBJECT["pushes"][0], "markers": {**MARKERS, **changes}}
        if forces is not None:
            push["forces_n"] = forces
        (folder / "subject.json").write_text(json.dumps({**SUBJECT, "pushes": [push]}))
        (folder / "annotation.json").write_text(json.dumps(ANNOTATION))
        (folder / "pushes/right-8-markers.csv").write_text("\n".join(rows() if lines is None else lines))
        return folder

    return lay_out


def read(folder):
    subject = read_subject(folder)
    return read_markers(subject, subject.pushes[0], VIEW)


def test_places_come_in_mm_along_the_bodys_axes(laid_out):
    found = read(laid_out())
    assert (found.names, found.reference, found.side) == (NAMES, 0, "front")
    assert np.allclose(found.positions, PLACES)
    numbers, pixels = found.shown
    assert numbers.tolist() == [0] and pixels.tolist() == [[400.0, 300.5]]
    assert np.allclose(read(laid_out(rows(PLACES / 10.0), unit="cm")).positions, PLACES)
    shuffled = [rows()[0], *reversed(rows()[1:])]
    assert np.allclose(read(laid_out(shuffled)).positions, PLACES[:, ::-1])


def test_a_marker_may_be_hidden_in_a_loaded_frame(laid_out):
    lines = ["m.2,2,,," if line.startswith("m.2,2") else line for line in rows()]
    found = read(laid_out(lines)).positions
    assert np.isnan(found[2, 1]).all() and np.isfinite(np.delete(found.reshape(12, 3), 7, axis=0)).all()


def test_the_motion_counts_from_the_first_frame_without_force(laid_out):
    assert read(laid_out(forces=[20, 0, 30, 40])).reference == 1


def test_the_record_is_written_as_it_was_read_and_a_push_without_markers_has_none(laid_out, tmp_path):
    subject = read_subject(laid_out())
    write_subject(tmp_path, subject.record)
    assert json.loads((tmp_path / "subject.json").read_text())["pushes"][0]["markers"] == MARKERS
    bare = subject.pushes[0].model_copy(update={"markers": None})
    assert read_markers(subject, bare, VIEW) is None


def test_what_is_written_is_read_again(laid_out):
    folder = laid_out()
    places = PLACES.copy()
    places[3, 2] = np.nan
    write_markers(folder / MARKERS["file"], NAMES, places[..., [0, 2, 1]] * [1.0, -1.0, 1.0])
    assert np.array_equal(read(folder).positions, places, equal_nan=True)


def changed(old, new):
    return [line.replace(old, new) for line in rows()]


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (changed("marker,frame", "name,frame"), "row 1: columns name,frame,x,y,z, wanted marker,frame,x,y,z"),
        ([line.replace(",", "|") for line in rows()], "row 1: columns marker|frame|x|y|z, wanted marker,frame"),
        ([*rows(), "C7,0,1,2"], "row 14: 4 fields, wanted 5"),
        (changed("C7", "C 7"), "row 2: found marker 'C 7', wanted 1 to 32 letters"),
        ([*rows(), "C7,4,1,2,3"], "row 14: found frame '4', but the push has 4 frames, counted from 0"),
        ([*rows(), "C7,1.0,1,2,3"], "row 14: found frame '1.0'"),
        ([*rows(), "C7,1,1,2,3"], "row 14: marker 'C7' is there twice in frame 1"),
        (rows()[:-1], "marker 'left-hip' has no row for frame 3; wanted one for each of the push's 4 frames"),
        (changed("C7,2", "c7,2"), "marker 'C7' has no row for frame 2"),
        (changed("C7,2,18", "C7,2,nan"), "row 8: found x,y,z nan,-20,19, wanted three finite numbers"),
        (changed("C7,2,18", "C7,2,"), "row 8: found x,y,z ,-20,19, wanted three finite numbers"),
        (["C7,0,,,", *rows()[2:]], "row 1: columns"),
        ([rows()[0], "C7,0,,,", *rows()[2:]], "marker 'C7' is not seen in frame 0, the one without force"),
        (rows(PLACES[:, :2]), "found 2 markers, wanted 3 to 60"),
        (changed("m.2,3,30", "m.2,3,300"), "marker 'm.2' moves by 2.. mm from frame 0 to frame 3, wanted at most 150"),
    ],
)
def test_impossible_tables_are_refused(laid_out, lines, words):
    with pytest.raises(SubjectError) as refusal:
        read(laid_out(lines))
    text = str(refusal.value)
    assert "right-8-markers.csv" in text and "\n" not in text
    assert re.search(words if ".." in words else re.escape(words), text), text


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"unit": "inch"}, "pushes[0].markers.unit: found 'inch', wanted 'mm', 'cm' or 'm'"),
        ({"axes": {"left": "-x", "up": "+z", "front": "-y"}}, "shows the body in a mirror"),
        ({"side": "left"}, "pushes[0].markers.side: found 'left', wanted 'front', 'back' or 'both'"),
        ({"shown": {}}, "pushes[0].markers.shown: found {}, wanted"),
        (
            {"shown": {"m" * 33: [1.0, 2.0]}},
            f"markers.shown: found marker '{'m' * 33}', wanted 1 to 32 letters (A to Z)",
        ),
        ({"shown": {"-m": [1.0, 2.0]}}, "markers.shown: found marker '-m', wanted 1 to 32 letters (A to Z)"),
        (
            {"shown": {"X": [1.0, 2.0]}},
            "markers.shown: names 'X', which pushes/right-8-markers.csv has not; wanted one",
        ),
        (
            {"shown": {"C7": [4000.0, 2.0]}},
            "markers.shown: found a marker at column 4000, row 2, wanted it in the image",
        ),
        ({"file": "../other.csv"}, "markers.file: found '../other.csv', wanted a path inside the subject folder"),
        ({"file": "other.csv"}, "other.csv: no such file; wanted the table of skin markers"),
        ({"forces": [10, 20, 30, 40]}, "markers: no frame is without force, the least is 10 N"),
    ],
)
def test_impossible_statements_are_refused(laid_out, changes, words):
    with pytest.raises(SubjectError) as refusal:
        read(laid_out(**changes))
    assert words in str(refusal.value)
