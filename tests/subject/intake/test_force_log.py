"""Logs of gauges: columns and units found, told or refused, never guessed."""

from __future__ import annotations

import re

import numpy as np
import pytest

from spinestiff.errors import SubjectError
from spinestiff.subject.intake.force_log import ForceLog, find_columns, read_force_log, with_units


@pytest.fixture
def log(tmp_path):
    def write(text):
        path = tmp_path / "gauge.csv"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


def read(path, names=None, units=(None, None)):
    return read_force_log(path, with_units(find_columns(path, names), path, *units))


@pytest.mark.parametrize(
    ("text", "times", "forces"),
    [
        ("time_s,force_n\n0,0\n0.5,10\n", [0.0, 0.5], [0.0, 10.0]),
        ("Time (ms);Force (kgf)\n0;0\n500;1,5\n", [0.0, 0.5], [0.0, 14.709975]),
        ("t [s]\tF [lbf]\n0\t0\n1\t2\n", [0.0, 1.0], [0.0, 8.8964432]),
        ("Gauge M5\nSerial;1\n\nZeit;Kraft\ns;N\n1;2\n2;-0,5\n", [1.0, 2.0], [2.0, 0.0]),
        ("n,load N,peak,time s\n1,0,9,0\n2,4,9,1\n", [0.0, 1.0], [0.0, 4.0]),
        ("s,N\n0,0\n1,2\n,\n\n", [0.0, 1.0], [0.0, 2.0]),
    ],
)
def test_columns_and_units_are_found(log, text, times, forces):
    found = read(log(text), ("time s", "load N") if text.startswith("n,") else None)
    np.testing.assert_allclose(found.times_s, times)
    np.testing.assert_allclose(found.forces_n, forces)
    assert found.notes == ()


@pytest.mark.parametrize("force", ["Load", "Kraft [mV]"])
def test_a_unit_that_is_not_told_is_asked_for(log, force):
    path = log(f"time_s,{force}\n0,0\n1,2\n")
    with pytest.raises(SubjectError, match=re.escape(f"column '{force}' tells no unit; give --log-units s,N")):
        read(path)
    np.testing.assert_allclose(read(path, units=("s", "kgf")).forces_n, [0.0, 19.6133])


@pytest.mark.parametrize("header", ["time_s,force_N", "t_ms,load", "Zeit,Kraft"])
def test_columns_named_in_the_other_order_are_refused(log, header):
    path = log(f"{header}\n0,0\n1,2\n")
    time, force = header.split(",")
    for units in ((None, None), ("s", "N")):
        with pytest.raises(SubjectError, match=f"line 1: column '{force}' is one of force, wanted time; --log-columns"):
            read(path, names=(force, time), units=units)


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ("time_s,Force [kg]", "line 2: column 'Force [kg]' is in kg; convert it to N, kgf or lbf, and write that in"),
        ("time_s,Kraft [daN]", "column 'Kraft [daN]' is in daN; convert it to N, kgf or lbf"),
        ("time_s,Force lbs", "column 'Force lbs' is in lb; convert it"),
        ("time_s,Load (kN)", "column 'Load (kN)' is in kN; convert it"),
        ("Time (min),Load (N)", "column 'Time (min)' is in min; convert it to s or ms"),
        ("Time [µs],Load", "column 'Time [µs]' is in μs; convert it"),
        ("Time,Load\ns,oz", "column 'Load' is in oz; convert it"),
        ("Time,Load kg N", "column 'Load kg N' names several units; rename it"),
    ],
)
def test_another_unit_in_the_header_is_refused_by_name_whatever_is_given(log, header, words):
    path = log(f"Gauge M5\n{header}\n0,0\n1,2\n")
    with pytest.raises(SubjectError, match=re.escape(words)):
        read(path, units=("s", "N"))


def test_lines_above_the_header_that_look_like_one_are_passed_by(log):
    above = "Test time,12:00,Force gauge,FG-500\nStart time,Stop time,Force\n12:00,12:01,none\n"
    for units_row in ("", "s,N\n"):
        found = read(log(above + "Time,Force\n" + units_row + "\n0,0\n1,2\n"), units=("s", "N"))
        np.testing.assert_allclose(found.forces_n, [0.0, 2.0])
    with pytest.raises(SubjectError, match=r"line 1: found the header 'Test time,12:00,Force gauge,FG-500' and below"):
        read(log(above))


def test_a_unit_that_the_header_contradicts_is_refused(log):
    path = log("time_s,force_n\n0,0\n1,2\n")
    assert read(path, units=("s", "N")).forces_n[1] == 2.0
    with pytest.raises(SubjectError, match=r"column 'force_n' is in N, but kgf was given; correct either$"):
        read(path, units=("s", "kgf"))
    with pytest.raises(SubjectError, match=r"column 'time_s' is in s, but ms was given"):
        read(path, units=("ms", "N"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a,b\n0,0\n", "found the header 'a,b', wanted columns of time and force"),
        (
            "0,0\n1,1\n",
            "found no header of fields between commas, semicolons or tabs, wanted columns of time and force; write a",
        ),
        (
            "time,force N\n3:22,0\n3:23,1\n",
            "line 1: found the header 'time,force N' and below it '3:22,0', wanted numbers of time (or a time",
        ),
        ("time s,force N\n", "found the header 'time s,force N' and nothing below it, wanted numbers"),
        (
            "time s,force N\n0,0\n1,1\nEnd\n",
            "line 4: found 'End', wanted numbers of time and force; take the line out if",
        ),
        ("time s,force N\n0,0\n1,6_0\n", "line 3: found '1,6_0', wanted numbers of time and force"),
        (
            "time s,force N,force 2 N\n0,0,0\n",
            "line 1: several columns of force: 'force N', 'force 2 N'; give --log-columns",
        ),
        ("time s,force N kgf\n0,0\n1,1\n", "line 1: column 'force N kgf' names several units; rename it"),
        ("time s,force N\n0,0\n1,x\n", "line 3: found '1,x', wanted numbers of time and force"),
        ("time s,force N\n0,0\n1,inf\n", "line 3: found '1,inf', wanted numbers"),
        ("time s,force N\n0,0\n1\n", "line 3: found '1', wanted numbers"),
        ("time s,force N\n0,0\n2,1\n2,3\n", "line 4: the time does not grow"),
        ("time s,force N\n0,0\n", "found 1 rows of numbers, wanted 2 or more"),
        ("time s,force N\n0,-30\n1,30\n", "forces from -30.0 to 30.0 N, wanted one sign"),
        ("time s,force N\n0,0\n1,501\n", "forces up to 501 N, wanted at most 500 N; check the unit"),
        ("", "found no header"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(log, text, words):
    with pytest.raises(SubjectError, match=re.escape(words)):
        read(log(text))


@pytest.mark.parametrize(
    ("entries", "times"),
    [
        (("14:03:22", "14:03:23", "14:04:00"), [0.0, 1.0, 38.0]),
        (("14:03:22.50", "14:03:22,75", "14:03:23:125"), [0.0, 0.25, 0.625]),
        (("2026-03-03T23:59:59.5Z", "2026-03-04T00:00:00Z", "2026-03-04T00:00:01Z"), [0.0, 0.5, 1.5]),
        (("03.03.2026 9:59:59", "03.03.2026 10:00:00", "03.03.2026 10:00:02"), [0.0, 1.0, 3.0]),
        (("11:59:59 AM", "12:00:00 PM", "1:00:00 pm"), [0.0, 1.0, 3601.0]),
        (("3:22.50", "03:22,75", "04:00.0"), [0.0, 0.25, 37.5]),
        (("59:58.5", "59:59.5", "00:00.5"), [0.0, 1.0, 2.0]),
    ],
)
def test_times_of_day_become_seconds_from_the_first_entry(log, entries, times):
    path = log("Uhrzeit Time [h:mm:ss];Kraft [N]\n" + "".join(f"{one};{n}\n" for n, one in enumerate(entries)))
    found = read(path)
    np.testing.assert_allclose(found.times_s, times, atol=1e-9)
    assert found.notes == (f"times of day: the log's seconds count from its first entry, {entries[0]}",)
    assert "(times of day)" in find_columns(path).words
    with pytest.raises(SubjectError, match="is in s, but ms was given"):
        read(path, units=("ms", "N"))


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        (("14:03:22", "14:03:22"), "line 3: the time does not grow; export it with parts of a second"),
        (("14:03:22", "14:03:21"), "line 3: the time does not grow; wanted one log, in order of time"),
        (("03:22.5", "03:21.5"), "line 3: the time does not grow; wanted one log, in order of time"),
        (
            ("59:58.5", "00:00.5", "59:59.5"),
            "line 4: more than half an hour after the entry before, or before it; wanted",
        ),
        (("13:59:58.5", "13:00:00.5"), "line 3: the time does not grow; wanted one log, in order of time"),
        (("14:03:22", "23.5"), "line 3: found '23.5;1', wanted a time of day and a force"),
        (("14:03:22", "14:03"), "line 3: found '14:03;1', wanted a time of day and a force"),
        (("2:03:22 PM", "14:03:23 PM"), "line 3: found '14:03:23 PM;1', wanted a time of day and a force"),
        (("23:59:59", "00:00:00", "23:59:58"), "the times of day span more than half a day; wanted one log"),
        (("24:00:00", "24:00:01"), "found the header 'time;force N' and below it '24:00:00;0', wanted numbers of time"),
        (("14:03", "14:04"), "found the header 'time;force N' and below it '14:03;0', wanted numbers of time"),
    ],
)
def test_times_of_day_that_cannot_be_are_refused(log, entries, words):
    with pytest.raises(SubjectError, match=re.escape(words)):
        read(log("time;force N\n" + "".join(f"{one};{n}\n" for n, one in enumerate(entries))))


@pytest.mark.parametrize("encoding", ["cp1252", "utf-16", "utf-8-sig"])
def test_a_gauge_s_own_letters_are_no_obstacle(log, encoding):
    found = read(log("Prüfgerät\nZeit (s);Kraft (N)\n0;0\n1;2,5\n".encode(encoding)))
    np.testing.assert_allclose(found.forces_n, [0.0, 2.5])
    with pytest.raises(SubjectError, match="is in μs; convert it to s or ms"):
        read(log("Zeit (µs);Kraft (N)\n0;0\n1;2,5\n".encode(encoding)))


@pytest.mark.parametrize("content", [b"PK\x03\x04 and more", b"\xd0\xcf\x11\xe0\xa1\xb1", b"time s,force N\n0,\0\n"])
def test_what_is_no_text_is_to_be_exported_as_csv(log, content):
    with pytest.raises(SubjectError, match=r"gauge\.csv: .*text; export the table as CSV"):
        read(log(content))


def test_decimal_commas_between_commas_are_not_taken_for_fields(log):
    wanted = "line 2: 4 fields, wanted 2 as in the header; numbers with decimal commas need semicolons"
    with pytest.raises(SubjectError, match=re.escape(wanted)):
        read(log("time s,force N\n0,5,15,0\n1,0,20,0\n"))
    np.testing.assert_allclose(read(log("time s,force N\n0,5,,\n1,6,,\n")).forces_n, [5.0, 6.0])


def test_columns_that_are_named_have_to_be_there(log):
    path = log("a,b,c\n0,5,1\n1,6,2\n")
    found = read(path, ("a", "c"), ("s", "N"))
    np.testing.assert_allclose(found.forces_n, [1.0, 2.0])
    with pytest.raises(SubjectError, match=r"wanted columns 'a' and 'd'"):
        read(path, ("a", "d"))


def test_a_gauge_that_counts_pushes_below_zero_is_read_and_said(log):
    found = read(log("time s,force N\n0,0.3\n1,-20\n2,-40\n"))
    np.testing.assert_allclose(found.forces_n, [0.0, 20.0, 40.0])
    assert found.notes == ("forces below 0: the gauge counts a push so; taken as magnitudes",)


def test_a_gauge_whose_zero_is_off_is_told(log):
    found = read(log("time s,force N\n0,-1\n1,29\n2,59\n"))
    assert found.forces_n.tolist() == [0.0, 29.0, 59.0]
    (note,) = found.notes
    assert note.startswith("forces of the other sign, up to 1.0 N, count as none, and the others as they stand")
    assert read(log("time s,force N\n0,-0.4\n1,29\n2,59\n")).notes == ()


def test_a_gauge_that_never_shows_nothing_is_told(log):
    found = read(log("time s,force N\n0,6.2\n1,36.2\n2,66.2\n"))
    assert found.forces_n.tolist() == [6.2, 36.2, 66.2]
    (note,) = found.notes
    assert note.startswith("forces never below 6.2 N: if the gauge does not show 0 without a load, all of them are too")
    assert read(log("time s,force N\n0,1.9\n1,36.2\n2,66.2\n")).notes == ()


def test_between_entries_the_force_is_on_a_line_and_what_is_in_the_air_is_none(log):
    found = read(log("time s,force N\n0,0.3\n1,0.4\n2,20.4\n"))
    np.testing.assert_allclose(found.at(np.array([-1.0, 0.0, 1.0, 1.5, 9.0])), [0.0, 0.0, 0.0, 10.4, 20.4])
    assert found.step_s == 1.0


def test_a_log_tells_no_force_beyond_its_ends_and_in_its_gaps():
    times = np.concatenate([np.arange(0.0, 2.05, 0.1), np.arange(5.0, 7.05, 0.1)])
    log = ForceLog(times, np.interp(times, [1.0, 4.0, 6.0, 7.0], [0.0, 60.0, 60.0, 40.0]))
    asked = np.array([-3.0, 0.05, 2.0, 2.15, 3.0, 4.7, 4.9, 6.0, 7.15, 7.6])
    told = log.told(asked)
    np.testing.assert_array_equal(np.isnan(told), [False, False, False, False, True, True, False, False, False, True])
    np.testing.assert_array_equal(told[~np.isnan(told)], log.at(asked)[~np.isnan(told)])


def test_a_gauge_that_writes_changes_alone_tells_the_force_between_them():
    times = [0.0, 5.0, 5.1, 5.2, 5.3, 9.0, 9.1, 9.2, 15.0]
    log = ForceLog(times, [0.0, 0.0, 20.0, 40.0, 60.0, 60.0, 30.0, 0.0, 0.0])
    asked = np.array([2.5, 5.15, 7.0, 12.0, 16.0])
    np.testing.assert_array_equal(log.told(asked), log.at(asked))


SAUTER = "Nr;Messwert;Einheit;Datum;Uhrzeit\n1;0,0;N;26.11.2026;14:03:01,2\n2;12,5;N;26.11.2026;14:03:01,7\n"


def test_a_log_whose_units_stand_in_a_column_of_their_own(log):
    path = log(SAUTER)
    columns = find_columns(path)
    assert (columns.time, columns.force, columns.force_unit, columns.clock) == ("Uhrzeit", "Messwert", "N", True)
    np.testing.assert_allclose(read(path).times_s, [0.0, 0.5])
    np.testing.assert_allclose(read(path).forces_n, [0.0, 12.5])
    np.testing.assert_allclose(read(log(SAUTER.replace(";N;", ";kgf;"))).forces_n, [0.0, 12.5 * 9.80665])
    other = log(SAUTER.replace("12,5;N", "12,5;kgf"))
    with pytest.raises(SubjectError, match="line 3: a force in 'kgf', wanted N as in the first entry"):
        read(other)
    with pytest.raises(SubjectError, match="column 'Einheit' says kg; convert the forces to N, kgf or lbf"):
        read(log(SAUTER.replace(";N;", ";kg;")))
    with pytest.raises(SubjectError, match="column 'Messwert' tells no unit; give --log-units s,N"):
        read(log(SAUTER.replace(";N;", ";?;")))


@pytest.mark.parametrize("header", ["Dauer [s],Messwert [N]", "Laufzeit (s),Peak N", "Zeit s,Wert\ns,N"])
def test_a_column_of_another_name_is_told_by_its_unit(log, header):
    np.testing.assert_allclose(read(log(f"{header}\n0,0\n1,2\n")).forces_n, [0.0, 2.0])


@pytest.mark.parametrize(
    ("header", "which"),
    [
        ("time s,n,Force N,Peak", "'n', 'Force N'"),
        ("time s,n,Messwert N,Peak", "'n', 'Messwert N'"),
        ("Uhrzeit,Peak [N],Messwert [N],-", "'Peak [N]', 'Messwert [N]'"),
    ],
)
def test_columns_that_may_both_be_the_force_are_asked_for(log, header, which):
    with pytest.raises(SubjectError, match=re.escape(f"several columns of force: {which}; give --log-columns TIME,")):
        find_columns(log(f"{header}\n0,1,0,1\n1,2,4,1\n"))


@pytest.mark.parametrize(
    "text",
    [
        "Uhrzeit;Zeit (s);Kraft (N)\n10:00:00;0;0\n10:00:01;1;2\n",
        "Duration [s];Peak [N]\n12,3;56,7\n\nTime [s];Force [N]\n0;0\n1;2\n",
        "Total sec,Max value,Mean value\n12.3,56.7,1\nTime (s),Force (N),x\n0,0,0\n1,2,0\n",
        "t (s),N,Peak (N)\n0,0,9\n1,2,9\n",
        "Time (s);Unit;Force (N);Unit\n0;s;0;N\n1;s;2;N\n",
        "Time (s),Force (N),Unit ID\n0,0,A17\n1,2,A17\n",
        "Time (unit: s),Force (unit: N)\n0,0\n1,2\n",
    ],
)
def test_what_says_time_and_force_is_read_as_it_stands(log, text):
    found = read(log(text))
    np.testing.assert_allclose(found.times_s, [0.0, 1.0])
    np.testing.assert_allclose(found.forces_n, [0.0, 2.0])


@pytest.mark.parametrize(
    "header",
    ["Index,Force (N),Rate (N/s)", "Point,Load (N),Speed (mm/s)", "Time (s),Value (mm),x", "No,Trial n,Weg mm"],
)
def test_other_quantities_are_not_taken_for_time_or_force(log, header):
    with pytest.raises(SubjectError, match="wanted columns of time and force"):
        find_columns(log(f"{header}\n0,0,0\n1,2,1\n"))


@pytest.mark.parametrize(
    ("text", "names", "times", "words"),
    [
        ("Load (N)\n0\n5\n7\n", None, [0.0, 0.1, 0.2], "entries 10 a second, force in column 'Load (N)' (N)"),
        ("Sample,Load (N)\n4,0\n5,5\n7,7\n", None, [0.4, 0.5, 0.7], "entries numbered in column 'Sample', 10 a second"),
        (
            "a,b (N),c (N)\n4,0,9\n5,5,9\n7,7,9\n",
            ("b (N)",),
            [0.0, 0.1, 0.2],
            "entries 10 a second, force in column 'b",
        ),
        ("a,b,c\ns,N,N\n4,0,9\n5,5,9\n7,7,9\n", ("a", "b"), [0.4, 0.5, 0.7], "entries numbered in column 'a'"),
    ],
)
def test_a_log_without_times_has_a_rate(log, text, names, times, words):
    path = log(text)
    columns = find_columns(path, names, 10.0)
    assert columns.words.startswith(words)
    found = read_force_log(path, columns)
    np.testing.assert_allclose(found.times_s, times)
    np.testing.assert_allclose(found.forces_n, [0.0, 5.0, 7.0])


def test_a_log_without_times_is_told_what_it_lacks(log):
    path = log("Sample,Load (N)\n4,0\n5,5\n")
    with pytest.raises(
        SubjectError, match=r"wanted columns of time and force; .*no times but a steady rate, give --log"
    ):
        find_columns(path)
    with pytest.raises(SubjectError, match=r"wanted a column of force; name them as it does with --log-columns FORCE$"):
        find_columns(log("Sample,Weg\n4,0\n5,5\n"), rate_hz=10.0)
    with pytest.raises(SubjectError, match=r"wanted columns of time and force; .*give --log-rate HZ$"):
        find_columns(log("Load (N)\n4\n5\n"))
    with pytest.raises(SubjectError, match="line 3: the numbers of column 'Sample' do not grow; if it does not number"):
        read_force_log(path, find_columns(log("Sample,Load (N)\n4,0\n4,5\n"), rate_hz=10.0))
    with pytest.raises(SubjectError, match="line 3: found 'x', wanted a number of force"):
        read_force_log(path, find_columns(log("Load (N)\n4\nx\n"), rate_hz=10.0))


@pytest.mark.parametrize(
    ("above", "header"),
    [
        ("Peak force (N),56.7", "Sample,Load (N)"),
        ("Model,ZTA-500N\nPeak(+),56.7N\nForce Unit,N", "No.,Force (N)"),
        ("Max force 56.7 N", "Sample\tLoad (N)"),
        ("", "n,Messwert N"),
        ("", "n;Messwert;Einheit"),
        ("", "N°\tValeur\tUnité"),
    ],
)
def test_lines_above_a_header_and_numbers_of_entries_are_no_forces(log, above, header):
    separator = next(one for one in ";\t," if one in header)
    rows = [separator.join(row) for row in (("1", "0", "N"), ("2", "12", "N"), ("3", "40", "N"))]
    if header.count(separator) == 1:
        rows = [row.rpartition(separator)[0] for row in rows]
    path = log("\n".join([*filter(None, [above]), header, *rows]) + "\n")
    found = read_force_log(path, find_columns(path, rate_hz=10.0))
    np.testing.assert_allclose(found.forces_n, [0.0, 12.0, 40.0])
    np.testing.assert_allclose(found.times_s, [0.1, 0.2, 0.3])


def test_a_rate_is_refused_where_a_log_has_times_or_other_fields(log):
    timed = log("Time (s),Force (N)\n0,0\n0.01,5\n")
    for names in (None, ("Time (s)", "Force (N)")):
        with pytest.raises(SubjectError, match=re.escape("column 'Time (s)' has times; leave out --log-rate")):
            find_columns(timed, names, 10.0)
    path = log("Force gauge (N)\n1;0,5\n2;12,5\n")
    with pytest.raises(SubjectError, match="line 2: found '1;0,5', wanted 1 field as in the header, line 1"):
        read_force_log(path, find_columns(path, rate_hz=10.0))
    # A clock of whole seconds does not part the entries of one second.
    path = log("Uhrzeit;Kraft N\n10:00:00;0\n10:00:00;2\n10:00:01;4\n")
    np.testing.assert_allclose(read_force_log(path, find_columns(path, rate_hz=10.0)).times_s, [0.0, 0.1, 0.2])
