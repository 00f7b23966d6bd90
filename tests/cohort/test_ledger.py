"""The ledger: what it keeps, and what is done with one that is none."""

from __future__ import annotations

import sqlite3

import pytest

from spinestiff.cohort.ledger import Try, open_ledger, read_last, take_over, write_last
from spinestiff.cohort.marker import Order
from spinestiff.errors import SubjectError

ORDER = Order(runner="a:b", settings={"mesh": "fine"}, version="1")


def tried(**changes):
    fields = {"run": "r1", "participant": "sub-01", "number": 1, "started": "2026-01-01T00:00:00Z", "seconds": 5.0}
    return Try(**{**fields, "ended": "done", "host": "here", **changes})


def rows(path, what):
    connection = sqlite3.connect(path / "ledger.sqlite")
    found = connection.execute(what).fetchall()
    connection.close()
    return found


def test_a_try_is_open_until_it_ends_and_lost_with_its_run(tmp_path):
    with open_ledger(tmp_path, "r1", ORDER) as ledger:
        ledger.begin_try("sub-01", 1, "here")
        ledger.begin_try("sub-02", 1, "here")
        assert rows(tmp_path, "SELECT ended FROM tries") == [(None,), (None,)]
        ledger.end_try(tried())
    with open_ledger(tmp_path, "r2", ORDER) as ledger:
        found = rows(tmp_path, "SELECT participant, ended FROM tries ORDER BY 1")
        assert found == [("sub-01", "done"), ("sub-02", "lost")]
        assert ledger.usual_seconds() == 5.0
    assert rows(tmp_path, "SELECT run, how, settings FROM runs") == [
        ("r1", "ended", '{"mesh": "fine"}'),
        ("r2", "ended", '{"mesh": "fine"}'),
    ]


def test_a_run_that_raises_has_stopped(tmp_path):
    with pytest.raises(KeyboardInterrupt), open_ledger(tmp_path, "r1", ORDER):
        raise KeyboardInterrupt
    assert rows(tmp_path, "SELECT how FROM runs") == [("stopped",)]


def test_tries_that_are_known_are_taken_over_once(tmp_path):
    for _ in range(2):
        take_over(tmp_path, [tried(), tried(number=2, ended="crashed")])
    assert rows(tmp_path, "SELECT try, ended FROM tries ORDER BY 1") == [(1, "done"), (2, "crashed")]


def test_a_file_that_is_no_ledger_is_moved_aside(tmp_path):
    (tmp_path / "ledger.sqlite").write_bytes(b"no database at all, but a longer text " * 40)
    with open_ledger(tmp_path, "r1", ORDER) as ledger:
        ledger.begin_try("sub-01", 1, "here")
    assert (tmp_path / "ledger-aside-1.sqlite").read_bytes().startswith(b"no database")
    assert rows(tmp_path, "SELECT participant FROM tries") == [("sub-01",)]


def test_a_ledger_of_a_later_version_is_left_alone(tmp_path):
    connection = sqlite3.connect(tmp_path / "ledger.sqlite")
    connection.execute("PRAGMA user_version = 7")
    connection.close()
    with pytest.raises(SubjectError, match="a ledger of version 7"), open_ledger(tmp_path, "r1", ORDER):
        raise AssertionError("was opened")


def test_how_the_last_run_went_is_read_back_and_nonsense_is_not(tmp_path):
    path = tmp_path / "last.json"
    assert read_last(path) is None
    write_last(path, [tried(), tried(number=2)])
    assert [one.number for one in read_last(path).tries] == [1, 2]
    path.write_text("{", encoding="utf-8")
    assert read_last(path) is None
