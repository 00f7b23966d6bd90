"""What each radiograph is taken for, and the reason."""

from __future__ import annotations

import re

import pytest

from hospital import trunk
from spinestiff.errors import SubjectError
from spinestiff.subject.intake.push_table import COLUMNS, pushes_of, read_push_table
from spinestiff.subject.intake.sorting import sort_files

BLIND = ("PatientOrientation", "ViewPosition")


def names(sorting):
    rest = [None if one is None else one.name for one in (sorting.frontal, sorting.lateral)]
    return (*rest, [[one.name for one in push.files] for push in sorting.pushes])


def test_views_and_frames_tell_rest_from_pushes(exported):
    found = [
        exported("I9", frames=2, time="104000"),
        exported("I3", "lateral", time="101500"),
        exported("I4", time="101600"),
        exported("I5", frames=3, time="102000"),
    ]
    sorting = sort_files(found)
    assert names(sorting) == ("I4", "I3", [["I5"], ["I9"]])
    assert sorting.pushes[0].forces_n == (None, None, None)
    assert sorting.reasons == {
        "I3": "the only single lateral (PatientOrientation A\\F) radiograph",
        "I4": "the only single frontal (PatientOrientation L\\F) radiograph",
        "I5": "3 frames, frontal (PatientOrientation L\\F)",
        "I9": "2 frames, frontal (PatientOrientation L\\F)",
    }


def test_of_several_the_first_in_time_is_at_rest_and_says_so(exported):
    found = [exported("b", time="102000"), exported("a", time="103000"), exported("c", time="101000")]
    sorting = sort_files(found)
    assert names(sorting) == ("c", None, [])
    assert sorting.reasons["c"] == "the first of 3 single frontal radiographs (PatientOrientation L\\F)"
    assert "name it in --pushes" in sorting.reasons["a"]


def test_a_rest_radiograph_of_the_day_of_the_push_goes_before_others(exported):
    old, new = {"AcquisitionDate": "20251103"}, {"AcquisitionDate": "20261103"}
    push = exported("p", frames=3, time="110000", **new)
    a, b = exported("a", time="100000", **old), exported("b", time="100500", **new)
    sorting = sort_files([a, b, push])
    assert names(sorting) == ("b", None, [["p"]])
    assert sorting.reasons["b"] == ("the only single frontal (PatientOrientation L\\F) radiograph of the day of a push")
    assert sorting.reasons["a"].startswith("single frontal radiograph before the one at rest")
    c = exported("c", time="100200", **new)
    assert names(sort_files([a, b, c, push]))[0] == "c"
    assert names(sort_files([a, b]))[0] == "a"


def test_a_frontal_one_at_rest_of_after_a_push_is_told(exported):
    push, later = exported("p", frames=3, time="110000"), exported("a", time="113000")
    side = exported("s", "lateral", time="114000")
    told = "; but it was taken after a push began: check that it is at rest"
    sorting = sort_files([later, side, push])
    assert names(sorting) == ("a", "s", [["p"]])
    assert sorting.reasons["a"].endswith(told) and told not in sorting.reasons["s"]
    assert told not in sort_files([exported("b", time="105900"), push]).reasons["b"]
    assert told not in sort_files([later, push], frontal=later).reasons["a"]
    # A date on one side alone puts them in no order.
    undated = exported("u", frames=3, time="110000", without=("AcquisitionDate",))
    assert undated.tags.day is None and undated.tags.moment is not None
    assert told not in sort_files([later, undated]).reasons["a"]


def test_words_of_the_series_go_before_time(exported):
    found = [exported("a", time="101000"), exported("b", time="102000", SeriesDescription="AP standing")]
    sorting = sort_files(found)
    assert names(sorting)[0] == "b"
    assert sorting.reasons["b"] == (
        "single frontal (PatientOrientation L\\F) radiograph whose series is called one at rest"
    )
    found = [exported("a", time="101000", SeriesDescription="PUSH 60 N"), exported("b", time="102000")]
    assert names(sort_files(found))[0] == "b"
    sorting = sort_files(found[:1])
    assert names(sorting) == (None, None, [])
    assert sorting.reasons["a"] == "single frontal radiograph whose series is called a push; name it in --pushes"


def test_without_times_nothing_is_guessed_and_the_user_can_say(exported):
    found = [exported("a", time=None), exported("b", time=None)]
    sorting = sort_files(found)
    assert names(sorting)[0] is None
    assert sorting.reasons["a"] == (
        "one of several single frontal radiographs of unknown order; say which is at rest with --frontal"
    )
    named = sort_files(found, frontal=found[1])
    assert names(named)[0] == "b" and named.reasons["b"] == "named by --frontal"
    assert named.reasons["a"] == "single frontal radiograph, but --frontal names another"


def test_a_view_that_nothing_tells_is_left_open(exported):
    found = [exported("a", without=BLIND), exported("b", frames=2, without=BLIND), exported("c", "lateral", frames=2)]
    sorting = sort_files(found)
    assert names(sorting) == (None, None, [["b"]])
    assert sorting.reasons["a"] == "nothing tells its view; name it with --frontal or --lateral, or in --pushes"
    assert sorting.reasons["b"] == "2 frames, its view is not told"
    assert sorting.reasons["c"].startswith("2 frames, but lateral")
    assert names(sort_files(found, lateral=found[0]))[1] == "a"


def test_what_a_picture_looks_like_counts_where_nothing_states_its_view_and_is_called_a_suggestion(exported):
    found = [
        exported("a", pixels=trunk("frontal"), without=BLIND),
        exported("b", pixels=trunk("lateral"), without=BLIND),
        exported("c", pixels=trunk("lateral").repeat(2, axis=0), without=BLIND),
    ]
    sorting = sort_files(found)
    assert names(sorting) == ("a", "b", [["c"]])
    assert re.fullmatch(
        r"looks like a frontal view: a bright band between two fields that are \d+ % darker; a suggestion, since "
        "nothing states its view: look at it",
        sorting.reasons["a"],
    )
    assert re.match(r"looks like a lateral view: one field .*; a suggestion, ", sorting.reasons["b"])
    assert sorting.reasons["c"].startswith("2 frames, its view is not told, but it looks like a lateral view: ")


def test_what_is_stated_goes_before_what_a_picture_looks_like(exported):
    stated = exported("a", "lateral", pixels=trunk("frontal"))
    blind = exported("b", pixels=trunk("lateral"), without=BLIND)
    sorting = sort_files([stated, blind])
    assert names(sorting) == (None, "a", [])
    assert "nothing tells its view; it looks like a lateral view: " in sorting.reasons["b"]
    assert names(sort_files([stated, blind], frontal=blind)) == ("b", "a", [])


def test_what_looks_like_the_other_view_is_told(exported):
    for kind, other in (("frontal", "lateral"), ("lateral", "frontal")):
        one = exported(kind, kind, pixels=trunk(other))
        reason = sort_files([one]).reasons[kind]
        assert f"; but it looks like a {other} view: " in reason and f"check that it is the {kind} one" in reason
        said = exported(f"{kind}-said", pixels=trunk(other), without=BLIND)
        named = sort_files([said], **{kind: said})
        assert named.reasons[said.name].startswith(f"named by --{kind}; but it looks like a {other} view: ")
    right = exported("right", "lateral", pixels=trunk("lateral"))
    assert "but it looks" not in sort_files([right]).reasons["right"]


def test_of_several_that_look_alike_none_is_taken(exported):
    found = [exported(name, pixels=trunk("frontal"), time=time, without=BLIND, SeriesDescription=words)
             for name, time, words in (("a", "101000", "1"), ("b", "102000", "2"))]  # fmt: skip
    sorting = sort_files(found)
    assert names(sorting) == (None, None, [])
    for reason in sorting.reasons.values():
        assert re.search(r"; it looks like a frontal view: .*; name it with --frontal or --lateral, or in --p", reason)
    pushed = exported("c", pixels=trunk("frontal"), without=BLIND, SeriesDescription="push")
    assert names(sort_files([pushed])) == (None, None, [])


def test_single_frames_of_one_series_are_one_push_in_order_of_time(exported):
    found = [exported(name, time=time, series="1.2.7", InstanceNumber=number) for name, time, number in
             (("x", "102010", 2), ("y", "102000", 1), ("z", "102055", 3), ("later", "103000", 4))]  # fmt: skip
    found.append(exported("rest", time="101000"))
    sorting = sort_files(found)
    assert names(sorting) == ("rest", None, [["y", "x", "z"]])
    assert sorting.pushes[0].times_s == (0.0, 10.0, 55.0)
    assert sorting.reasons["x"] == (
        "frontal, one of 3 of a series within 60 s of each other; a suggestion: parts of one long picture follow each "
        "other so, too"
    )


def test_one_at_rest_is_no_frame_of_a_push_though_it_is_of_its_series(exported):
    found = [exported(name, time=time, series="1.2.7", InstanceNumber=number, SeriesDescription=words) for
             name, time, number, words in (("x", "102000", 1, "AP"), ("y", "102010", 2, "AP standing"),
                                           ("z", "102020", 3, "AP"), ("w", "102030", 4, "AP"))]  # fmt: skip
    assert names(sort_files(found)) == ("y", None, [["z", "w"]])


def test_bending_films_are_neither_at_rest_nor_a_push(exported):
    found = [exported(name, time=time, series="1.2.7", SeriesDescription="WS pa Bending") for name, time in
             (("x", "102000"), ("y", "102030"))]  # fmt: skip
    sorting = sort_files(found)
    assert names(sorting) == (None, None, [])
    why = (
        "single frontal radiograph whose series is called a bending film, which has no force on the ribs; if it is at "
        "rest name it with --frontal, if it shows a push in --pushes"
    )
    assert sorting.reasons == {"x": why, "y": why}
    assert names(sort_files([*found, exported("z", time="103000")])) == ("z", None, [])


def test_a_single_one_is_told_by_when_it_was_taken_against_the_one_at_rest(exported):
    found = [exported("a", time="085000"), exported("b", time="090000", SeriesDescription="WS stehend"),
             exported("c", time="091000"), exported("d", time=None)]  # fmt: skip
    reasons = sort_files(found).reasons
    said = {name: reasons[name].removeprefix("single frontal radiograph ").split()[0] for name in "acd"}
    assert said == {"a": "before", "c": "after", "d": "beside"}


def table_of(tmp_path, found, *rows):
    path = tmp_path / "pushes.csv"
    path.write_text("\n".join([",".join(COLUMNS), *rows]) + "\n")
    return pushes_of(path, read_push_table(path), found)


def test_a_frame_that_the_table_forgot_is_not_taken_for_the_one_at_rest(exported, tmp_path):
    found = [exported(f"p/{i}", time=f"1020{i}0", series="1.2.7") for i in range(4)]
    rows = [f"p/{i},,{20 * i},left,8,400,66" for i in range(3)]
    sorting = sort_files(found, table_of(tmp_path, found, *rows))
    assert names(sorting) == (None, None, [["p/0", "p/1", "p/2"]])
    assert sorting.reasons["p/3"] == (
        "of the series of p/0 and after its beginning, but in no row of the table of pushes; name it there or, if it "
        "is at rest, with --frontal"
    )
    # One that was taken before the push may be at rest, as one may that is called so.
    before = exported("r", time="101000", series="1.2.7")
    assert names(sort_files([*found[:3], before], table_of(tmp_path, found, *rows)))[0] == "r"
    called = exported("r", time="103000", series="1.2.7", SeriesDescription="standing")
    assert names(sort_files([*found[:3], called], table_of(tmp_path, found, *rows)))[0] == "r"


def test_one_of_a_pushs_series_may_be_at_rest_where_it_can(exported, tmp_path):
    """A lateral one, which no push has, and one whose time nothing tells, with a doubt."""
    push = exported("p", frames=3, time="102000", series="1.2.7")
    rows = [f"p,{i},{20 * i},left,8,400,66" for i in range(3)]
    found = [push, exported("l", "lateral", time="103000", series="1.2.7"), exported("r", time=None, series="1.2.7")]
    sorting = sort_files(found, table_of(tmp_path, found, *rows))
    assert names(sorting) == ("r", "l", [["p"]])
    doubt = "; but it is of a push's series, and nothing tells its time: check that it is at rest"
    assert sorting.reasons["r"].endswith(doubt)
    assert "check" not in sorting.reasons["l"]
    found = [push, exported("o", time=None)]
    assert "check" not in sort_files(found, table_of(tmp_path, found, *rows)).reasons["o"]


def test_rows_of_the_table_that_are_no_push_are_refused(exported, tmp_path):
    found = [exported("a", time="101000"), exported("b", "lateral", time="102000")]
    with pytest.raises(
        SubjectError, match=r"^row 2 of the table of pushes: b: lateral \(PatientOrientation A\\F\); pushes"
    ):
        sort_files(found, table_of(tmp_path, found, "b,0,20,left,8,400,66"))
    with pytest.raises(SubjectError, match=r"^row 2 of the table of pushes: a is one radiograph without force, and no"):
        sort_files(found, table_of(tmp_path, found, "a,0,0,left,8,400,66"))
    with pytest.raises(SubjectError, match=r"row 2: d31_mm 410 is not below d21_mm 400; wanted the push between"):
        table_of(tmp_path, found, "a,0,20,left,8,400,410")


def test_the_table_says_what_is_a_push_and_what_is_not(exported, tmp_path):
    path = tmp_path / "pushes.csv"
    path.write_text(
        ",".join(COLUMNS) + ",role\nI5,2,40,left,5,400,66,training\nI5,0,0,,,,,\nS,1,30,left,7,400,99,\nS,0,0,,,,,\n"
    )
    found = [exported("I5", frames=3, time="102000"), exported("I6", frames=2), exported("I4", time="101000"),
             exported("S/b", time="103000"), exported("S/a", time="103010")]  # fmt: skip
    table = pushes_of(path, read_push_table(path), found)
    sorting = sort_files(found, table)
    assert names(sorting) == ("I4", None, [["I5"], ["S/b", "S/a"]])
    first, second = sorting.pushes
    assert (first.forces_n, first.roles) == ((0.0, None, 40.0), ("unused", "unused", "training"))
    assert (second.forces_n, second.roles, second.shared["level"]) == ((0.0, 30.0), None, 7.0)
    assert sorting.reasons["I6"].endswith("but not in the table of pushes")
    assert sorting.reasons["I5"] == "in the table of pushes, rows 3, 2"
    with pytest.raises(SubjectError, match=r"^I5: named as a rest radiograph and in the table of pushes; keep one$"):
        sort_files(found, table, frontal=found[0])
    with pytest.raises(SubjectError, match=r"wanted two$"):
        sort_files(found, table, frontal=found[2], lateral=found[2])


def test_files_of_a_push_that_are_no_sequence_are_refused(exported, tmp_path):
    path = tmp_path / "pushes.csv"
    path.write_text(",".join(COLUMNS) + "\na,0,0,left,5,400,66\nb,0,9,left,5,400,66\n")
    found = [exported("a", time=None, without=("InstanceNumber",)), exported("b", time=None)]
    with pytest.raises(SubjectError, match=r"^row 2 of the table of pushes: the push: neither all acquisition times"):
        sort_files(found, pushes_of(path, read_push_table(path), found))


def test_files_without_times_and_numbers_go_by_their_names_and_it_is_said(exported, tmp_path):
    path = tmp_path / "pushes.csv"
    rows = [f"{name},,{force},left,5,400,66" for name, force in (("s/img10", 30), ("s/img9", 20), ("r/img11", 0))]
    path.write_text("\n".join([",".join(COLUMNS), *rows]))
    found = [exported(name, time=None, without=("InstanceNumber",)) for name in ("s/img10", "s/img9", "r/img11")]
    sorting = sort_files(found, pushes_of(path, read_push_table(path), found))
    (push,) = sorting.pushes
    assert [one.name for one in push.files] == ["r/img11", "s/img9", "s/img10"] and push.forces_n == (0.0, 20.0, 30.0)
    assert sorting.reasons["s/img9"].endswith(
        "in order of the files' names, since no header has an acquisition time or a number: check it"
    )
    sorting = sort_files(found, joined=[found])
    assert names(sorting)[2] == [["r/img11", "s/img9", "s/img10"]]
    assert "in order of the files' names" in sorting.reasons["s/img9"]


def test_files_with_times_of_content_alone_go_by_these(exported):
    """Names that tell another order would give each force to the wrong frame."""
    found = [exported(name, time=None, without=("InstanceNumber",), ContentTime=time)
             for name, time in (("a", "101040"), ("b", "101020"), ("c", "101000"))]  # fmt: skip
    sorting = sort_files(found, joined=[found])
    assert names(sorting)[2] == [["c", "b", "a"]]
    assert sorting.reasons["a"].endswith("in order of the times of their content: check it")


def test_single_pictures_are_one_push_where_the_user_says_so(exported):
    """Each of a series of its own, minutes apart: nothing tells that they belong together."""
    found = [exported(name, time=time) for name, time in
             (("rest", "101000"), ("x", "103500"), ("y", "102000"), ("z", "102800"))]  # fmt: skip
    assert names(sort_files(found)) == ("rest", None, [])
    sorting = sort_files(found, joined=[found[1:]])
    assert names(sorting) == ("rest", None, [["y", "z", "x"]])
    (push,) = sorting.pushes
    assert push.forces_n == (None,) * 3 and push.times_s == (0.0, 480.0, 900.0)
    assert sorting.reasons["z"] == "chosen, with 2 more, as one push; in order of time"
    # The first may be the one that would have been at rest.
    assert names(sort_files(found, joined=[found[:2]])) == ("y", None, [["rest", "x"]])
    # Without times by their numbers, beside what is found by itself.
    found = [exported(name, time=None, InstanceNumber=number) for name, number in (("n2", 2), ("n1", 1))]
    sorting = sort_files([*found, exported("I5", frames=2)], joined=[found])
    assert names(sorting)[2] == [["I5"], ["n1", "n2"]] or names(sorting)[2] == [["n1", "n2"], ["I5"]]
    assert sorting.reasons["n1"].endswith("in order of the numbers in their headers")


def test_pictures_that_can_be_no_push_are_refused(exported, tmp_path):
    found = [exported("a", time=None, without=("InstanceNumber",)), exported("b", time=None)]
    side, several, front = exported("c", "lateral"), exported("d", frames=2), exported("e", time="102000")
    other = exported("f", time="102100")
    for joined, words in (
        ([found], "^these pictures can't be one push: neither all acquisition times"),
        ([[front]], "has 2 or more"),
        ([[front, side]], "^c: lateral .*; pushes are seen from the front"),
        ([[front, several]], "^d: 2 frames; a push is one such file"),
        ([[front, other], [other, front]], "wanted it in one place"),
    ):
        with pytest.raises(SubjectError, match=words):
            sort_files([*found, side, several, front, other], joined=joined)
    with pytest.raises(SubjectError, match=r"^e: chosen for a push and for something else"):
        sort_files([front, other], frontal=front, joined=[[front, other]])
    path = tmp_path / "pushes.csv"
    path.write_text(",".join(COLUMNS) + "\nd,0,0,left,5,400,66\ne,0,9,left,5,400,67\n")
    table = pushes_of(path, read_push_table(path), [several, front])
    with pytest.raises(SubjectError, match=r"^e: chosen for a push and in the table of pushes; keep one"):
        sort_files(
            [several, front, exported("f", time="102100")], table, joined=[[front, exported("f", time="102100")]]
        )


def test_a_radiograph_at_rest_that_states_the_other_view_is_refused(exported):
    front, side = exported("I1"), exported("I2", "lateral")
    for named in ({"frontal": side}, {"lateral": front}):
        (wanted, one) = next(iter(named.items()))
        with pytest.raises(SubjectError, match=rf"{one.name}: named as the {wanted} radiograph at rest, but it states"):
            sort_files([front, side], **named)
    # What the series is called is no statement of its picture's.
    lacking = ("PatientOrientation", "ViewPosition")
    called = exported("I3", without=lacking, SeriesDescription="lateral")
    assert called.view == "lateral" and sort_files([front, called], frontal=called).frontal is called
