"""The table of pushes: cells, files, frames, and what rows of one push say together."""

from __future__ import annotations

import re

import pytest

from spinestiff.errors import SubjectError
from spinestiff.subject.intake.push_table import COLUMNS, pushes_of, read_push_table

HEADER = ",".join(COLUMNS)


@pytest.fixture
def table(tmp_path):
    def write(*rows, header=HEADER):
        path = tmp_path / "pushes.csv"
        path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
        return path

    return write


def refused(path, found, words):
    with pytest.raises(SubjectError, match=re.escape(words)):
        pushes_of(path, read_push_table(path), found)


def test_a_row_a_frame_with_empty_cells_left_open(table, exported):
    path = table(
        "I7,0,0,right,8.5,400,",
        "I7,1,,,,,",
        "I7,2,41.5,R,,,210",
        "I8,0,0,left,5,400,66",
    )
    one, two = pushes_of(path, read_push_table(path), [exported("x/I7", frames=3), exported("x/I8", frames=2)])
    assert one.shared == {"side": "right", "level": 8.5, "d21_mm": 400.0, "d31_mm": 210.0}
    assert [row.force_n for row in one.rows.values()] == [0.0, None, 41.5]
    assert (two.shared["side"], list(two.rows)) == ("left", [("x/I8", 0)])


def test_a_spreadsheets_semicolons_and_decimal_commas_are_read(table, exported):
    path = table("I7;0;0;right;8,5;400;", "I7;1;41,5;;;;210", header=HEADER.replace(",", ";"))
    (push,) = pushes_of(path, read_push_table(path), [exported("I7", frames=2)])
    assert push.shared == {"side": "right", "level": 8.5, "d21_mm": 400.0, "d31_mm": 210.0}
    assert [row.force_n for row in push.rows.values()] == [0.0, 41.5]


def test_role_and_push_may_be_there(table, exported):
    path = table("I7,0,0,,,,,unused,first", "I7,1,20,,,,,Training,first", header=HEADER + ",role,push")
    (push,) = pushes_of(path, read_push_table(path), [exported("I7", frames=2)])
    assert push.name == "first"
    assert [row.role for row in push.rows.values()] == ["unused", "training"]


def test_single_files_are_one_push_where_they_have_all_in_common(table, exported):
    rows = ["I1,0,0,left,5,400,66", "I2,,30,left,5,400,66", "I3,0,30,left,7,400,120"]
    path = table(*rows)
    found = [exported(f"I{n}") for n in (1, 2, 3)]
    one, two = pushes_of(path, read_push_table(path), found)
    assert [file.name for file in one.files] == ["I1", "I2"] and [file.name for file in two.files] == ["I3"]
    path = table("I1,0,0,,,,,,a", "I2,0,30,left,,,,,a", "I3,0,30,,,,,,b", header=HEADER + ",role,push")
    assert [len(push.files) for push in pushes_of(path, read_push_table(path), found)] == [2, 1]


def test_a_row_may_be_of_all_frames_of_a_file_or_a_folder(table, exported):
    found = [exported("I7", frames=3), exported("s/I1"), exported("s/I2")]
    one, two = pushes_of(
        "t", read_push_table(table("I7,,,left,8,400,200", "I7,0,0,,,,", "I7,1,40,,,,", "s,,,right,6,,", "s,1,30,,,,")),
        found,
    )  # fmt: skip
    assert (one.shared["level"], [row.force_n for row in one.rows.values()]) == (8.0, [0.0, 40.0])
    assert (two.shared["level"], [row.force_n for row in two.rows.values()]) == (6.0, [30.0])
    (alone,) = pushes_of("t", read_push_table(table("I7,,,left,8,400,200")), found)
    assert (alone.shared["level"], [row.force_n for row in alone.rows.values()]) == (8.0, [None])


def test_pushes_with_a_frame_without_force_each_stay_two(table, exported):
    """Of the second nobody knows the distances."""
    rows = ["I1,,0,left,8,400,200", "I2,,40,left,8,400,200", "I3,,0,left,8,,", "I4,,40,left,8,,"]
    found = [exported(f"I{n}") for n in range(1, 5)]
    assert [len(push.files) for push in pushes_of("t", read_push_table(table(*rows)), found)] == [2, 2]


def test_a_row_whose_name_was_forgotten_is_told(table, exported):
    path = table("I1,,0,left,8,400,200,,p", "I2,,40,,,,,,", header=HEADER + ",role,push")
    refused(path, [exported("I1"), exported("I2")], "row 3: I2 may be of the push of row 2 or of another")


def test_single_files_that_leave_all_open_are_one_push(table, exported):
    found = [exported("I1"), exported("I2")]
    (push,) = pushes_of("t", read_push_table(table("I1,,0,,,,", "I2,,30,,,,")), found)
    assert len(push.files) == 2 and push.shared == {}


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (["s/I1,,0,left,5,,", "s/I2,,30,,,,"], "row 3: s/I2 may be of the push of row 2 or of another, since cells"),
        (["s/I1,,0,left,,,", "s/I2,,30,left,5,,"], "row 3: s/I2 may be of the push of row 2 or of another"),
        (["I7,0,0,left,5,400,66", "I7,,60,,,,"], "row 3: frame: found nothing, but I7 has 3 frames; wanted which"),
        (["I7,,,left,5,,", "I7,,,left,5,,"], "row 3: I7, frame 0 is in row 2 already; keep one"),
        (["s,,60,left,5,,"], "row 2: frame: found nothing, but s has 2 frames"),
        (["I7,0,-1,left,5,400,66"], "row 2: force_n: found '-1', wanted 0 to 500 N, or nothing"),
        (['I7,0,0,left,5,"400,5",66'], "row 2: d21_mm: found '400,5', wanted 30 to 1000 mm, with a decimal point"),
        (["I7,0,nan,left,5,400,66"], "row 2: force_n: found 'nan', wanted 0 to 500 N"),
        (["I7,0,0,left,5,400,66", "I7,1,0,up,5,400,66"], "row 3: side: found 'up', wanted left, right, or nothing"),
        (["I7,0,0,left,13,400,66"], "row 2: level: found '13', wanted 1 to 12 ribs"),
        (["I7,x,0,left,5,400,66"], "row 2: frame: found 'x', wanted a whole number, the first frame being 0"),
        (["I7,3,0,left,5,400,66"], "row 2: frame 3, but I7 has 3 frames, from 0 on"),
        (["I9,0,0,left,5,400,66"], "row 2: no radiograph 'I9' in the sources; there are I7, s/I1, s/I2, I8"),
        ([",0,0,left,5,400,66"], "row 2: file: found nothing"),
        (["I7,0,0,,,,", "I7,1,5,,,,", "I7,1,6,,,,"], "row 4: I7, frame 1 is in row 3 already; keep one"),
        (["I7,0,0,left,5,400,66", "I7,1,5,right,5,400,66"], "side: found left (row 2) and right (row 3) for frames"),
        (["s,2,0,left,5,400,66"], "row 2: frame 2, but s has 2 frames"),
        (["s,0,0,left,5,400,66", "s/I1,0,0,right,5,400,66"], "row 3: s/I1 is part of another push already"),
        ([], "no rows; wanted one for each frame"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_with_its_row(table, exported, rows, words):
    found = [exported("I7", frames=3), exported("s/I1"), exported("s/I2"), exported("I8")]
    refused(table(*rows), found, words)


def test_a_name_that_no_push_may_have_is_said_with_its_row(table, exported):
    path = table("I7,0,0,left,5,400,66,,a", "I7,1,5,left,5,400,66,,große Kurve", header=HEADER + ",role,push")
    refused(path, [exported("I7", frames=3)], "row 3: push: found 'große Kurve', wanted 1 to 64 letters")


def test_rows_of_a_file_of_several_frames_stand_alone(table, exported):
    found = [exported("I7", frames=3), exported("I1")]
    path = table("I7,0,0,,,,,,a", "I1,0,0,,,,,,a", header=HEADER + ",role,push")
    refused(path, found, "row 2: I7 is in a push of several files, one of which has several frames")


@pytest.mark.parametrize("header", ["file,frame,force_n", HEADER + ",colour", HEADER + ",role,role"])
def test_other_columns_are_refused_with_those_that_are_wanted(table, header):
    with pytest.raises(
        SubjectError, match=re.escape("wanted file,frame,force_n,side,level and perhaps d21_mm,d31_mm,role,push")
    ):
        read_push_table(table("I7,0,0", header=header))


def test_distances_that_nobody_knows_need_no_columns(table, exported):
    path = table("I7,0,0,right,8", "I7,1,41.5,,", header="file,frame,force_n,side,level")
    (push,) = pushes_of(path, read_push_table(path), [exported("I7", frames=2)])
    assert push.shared == {"side": "right", "level": 8.0}
    path = table("I7,0,0,right,400", header="file,frame,force_n,side,d21_mm")
    with pytest.raises(SubjectError, match="lacking: level"):
        read_push_table(path)


@pytest.mark.parametrize("coding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_a_table_is_read_in_the_codings_of_spreadsheets(tmp_path, exported, coding):
    path = tmp_path / "pushes.csv"
    path.write_bytes(f"{HEADER}\nRücken,0,0,right,8,400,210\nRücken,1,41.5,,,,\n".encode(coding))
    (push,) = pushes_of(path, read_push_table(path), [exported("Rücken", frames=2)])
    assert [row.force_n for row in push.rows.values()] == [0.0, 41.5]
