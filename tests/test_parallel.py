"""Pieces of work side by side: the same results and errors whatever the number of threads."""

from __future__ import annotations

import subprocess
import sys
from contextlib import nullcontext
from threading import Barrier, Event, current_thread
from time import monotonic, sleep

import pytest

from spinestiff.errors import OptionError
from spinestiff.parallel import VARIABLES, in_parallel, own_threads, threads


@pytest.fixture(autouse=True)
def unset(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)


@pytest.mark.parametrize("count", ["1", "4"])
def test_results_come_in_the_order_of_the_pieces(monkeypatch: pytest.MonkeyPatch, count: str) -> None:
    monkeypatch.setenv("SPINESTIFF_THREADS", count)
    assert in_parallel(lambda i: i * i, range(9)) == [i * i for i in range(9)]
    assert in_parallel(lambda i: i, []) == []


def test_pieces_run_at_the_same_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPINESTIFF_THREADS", "3")
    meeting = Barrier(3, timeout=20.0)
    assert len(set(in_parallel(lambda _: (meeting.wait(), current_thread().name)[1], range(3)))) == 3


def test_pieces_of_a_piece_stay_on_its_thread_while_others_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPINESTIFF_THREADS", "2")
    all_at_work = Barrier(2, timeout=20.0)

    def inner(_: int) -> str:
        return current_thread().name

    def outer(_: int) -> tuple[int, set[str]]:
        all_at_work.wait()
        found = own_threads(), {current_thread().name, *in_parallel(inner, range(4))}
        all_at_work.wait()
        return found

    assert [(count, len(names)) for count, names in in_parallel(outer, range(4))] == [(1, 1)] * 4
    assert own_threads() == 2
    assert current_thread().name not in in_parallel(inner, range(4))  # and the caller is free for others again


def test_threads_nobody_needs_are_shared_from_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPINESTIFF_THREADS", "7")
    together = Barrier(3, timeout=20.0)

    def share(_: int) -> int:
        together.wait()
        found = own_threads()
        together.wait()
        return found

    assert in_parallel(share, range(3)) == [2, 2, 2]


@pytest.mark.parametrize("fails", [False, True])
def test_a_piece_that_ends_leaves_its_thread_to_the_others(monkeypatch: pytest.MonkeyPatch, fails: bool) -> None:
    monkeypatch.setenv("SPINESTIFF_THREADS", "2")
    grown = list[bool]()

    def piece(number: int) -> None:
        if number == 0:
            until = monotonic() + 20.0
            while own_threads() < 2 and monotonic() < until:
                sleep(0.001)
            grown.append(own_threads() == 2)
        elif fails:
            raise ValueError("one of them")

    with pytest.raises(ValueError) if fails else nullcontext():
        in_parallel(piece, range(2))
    assert grown == [True]


@pytest.mark.parametrize("count", ["1", "4"])
def test_the_first_piece_that_fails_is_told(monkeypatch: pytest.MonkeyPatch, count: str) -> None:
    monkeypatch.setenv("SPINESTIFF_THREADS", count)

    def fails(i: int) -> int:
        if i in (2, 3):
            raise ValueError(f"piece {i}")
        return i

    with pytest.raises(ValueError, match="piece 2"):
        in_parallel(fails, range(6))


def test_the_environment_says_how_many(monkeypatch: pytest.MonkeyPatch) -> None:
    assert threads() >= 1
    monkeypatch.setenv("OMP_NUM_THREADS", "5")
    assert threads() == 5
    monkeypatch.setenv("SPINESTIFF_THREADS", "3")
    assert threads() == 3
    monkeypatch.setenv("OMP_NUM_THREADS", "7,1")  # OpenMP: 7 on the outermost level
    monkeypatch.delenv("SPINESTIFF_THREADS")
    assert threads() == 7


@pytest.mark.parametrize("said", ["0", "-2", "two", "1.5"])
def test_what_is_no_number_of_threads_is_refused(monkeypatch: pytest.MonkeyPatch, said: str) -> None:
    monkeypatch.setenv("SPINESTIFF_THREADS", said)
    with pytest.raises(OptionError, match=f"SPINESTIFF_THREADS={said}: wanted a whole number above 0"):
        in_parallel(abs, [1])


def test_an_interruption_does_not_wait_for_what_is_at_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPINESTIFF_THREADS", "2")
    go_on, done = Event(), []

    def work(i: int) -> None:
        if i == 0:
            raise KeyboardInterrupt
        go_on.wait(20.0)
        done.append(i)

    try:
        with pytest.raises(KeyboardInterrupt):
            in_parallel(work, range(2))
        assert not done
    finally:
        go_on.set()


BLAS = """
import os

from threadpoolctl import ThreadpoolController

from spinestiff.parallel import blas_on_one_thread, in_parallel
import scipy.linalg  # it loads SciPy's BLAS and NumPy's

blas = ThreadpoolController().select(user_api="blas")


def found(_=None):
    return {one["num_threads"] for one in blas.info()}


def inside(_):
    with blas_on_one_thread():
        return found()


with blas.limit(limits=2):
    with blas_on_one_thread(), blas_on_one_thread():
        assert found() == {1}
    assert found() == {2}
    for count in ("2", "1"):
        os.environ["SPINESTIFF_THREADS"] = count
        assert in_parallel(inside, range(2)) == [{1}, {1}]
        assert found() == {2}
    os.environ["SPINESTIFF_THREADS"] = "2"
    assert in_parallel(found, range(2)) == [{1}, {1}]
    assert found() == {2}
    print("as told")
"""


def test_blas_has_one_thread_inside_whatever_it_had() -> None:
    """In an interpreter of its own: other libraries bring BLAS of theirs, some of which has one thread for ever."""
    done = subprocess.run([sys.executable, "-c", BLAS], capture_output=True, text=True, timeout=120)
    assert done.stdout == "as told\n", done.stderr
