"""Independent pieces of work on several threads, which factorisations and compiled kernels leave the interpreter to."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from functools import lru_cache
from threading import Lock, local
from typing import TypeVar

from threadpoolctl import ThreadpoolController

from spinestiff.errors import OptionError

VARIABLES = ("SPINESTIFF_THREADS", "OMP_NUM_THREADS")
"""Of the environment: how many threads, the first that is set."""

Piece = TypeVar("Piece")
Result = TypeVar("Result")
_here = local()


def threads() -> int:
    """How many threads work side by side: what the environment says, else as many as there are processors to run on.

    Raises
    ------
    OptionError : SPINESTIFF_THREADS is no whole number above 0.
    """
    for name in VARIABLES:
        said = os.environ.get(name, "").strip()
        if name == VARIABLES[1]:
            said = said.split(",")[0].strip()  # a list is of nested levels, the outermost first
        if said.isdecimal() and int(said) > 0:
            return int(said)
        if said and name == VARIABLES[0]:
            raise OptionError(f"{name}={said}: wanted a whole number above 0, e.g. {name}=2")
    return processors()


def processors() -> int:
    """How many processors this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class _Pieces:
    """Pieces of work that share some threads: each has its own, and an equal part of those that nobody needs."""

    def __init__(self, threads: int, pieces: int) -> None:
        self._threads, self._left, self._lock = threads, pieces, Lock()

    def share(self) -> int:
        """Threads for one piece; it only grows, since no piece is added."""
        return max(1, self._threads // max(self._left, 1))

    def ended(self) -> None:
        with self._lock:
            self._left -= 1


def own_threads() -> int:
    """How many threads may be used for what is computed here: all, inside a piece of work its share of them."""
    pieces: _Pieces | None = getattr(_here, "pieces", None)
    return threads() if pieces is None else pieces.share()


def in_parallel(function: Callable[[Piece], Result], pieces: Iterable[Piece]) -> list[Result]:
    """``function`` of each piece, in their order; results do not depend on the number of threads.

    Threads are never more than there are. While pieces wait, each that runs has one thread; towards the end those that
    are left share what the others no longer need, in nested calls and in factorisations (``own_threads``).

    Raises
    ------
    What ``function`` raises for the first piece, in their order, for which it does.
    """
    todo = list(pieces)
    free = own_threads()
    count = min(free, len(todo))
    if count <= 1:
        return [function(piece) for piece in todo]
    sharing = _Pieces(free, len(todo))

    def one_of_them(piece: Piece) -> Result:
        _here.pieces = sharing
        try:
            return function(piece)
        finally:
            sharing.ended()

    pool = ThreadPoolExecutor(count, "spinestiff")
    wait = True
    try:
        with blas_on_one_thread():
            waiting = [pool.submit(one_of_them, piece) for piece in todo]
            return [one.result() for one in waiting]
    except KeyboardInterrupt:
        wait = False  # for nobody: what is at work ends by itself
        raise
    finally:
        pool.shutdown(wait=wait, cancel_futures=True)


def blas_on_one_thread() -> AbstractContextManager[object]:
    """Inside, BLAS works on the caller's thread, whoever started Python with which settings.

    A solve has thousands of products of vectors, for each of which BLAS would wake all its threads: beside another
    process on two processors the steps of equilibria took 3.8 times as long. The number is that of the process:
    where two threads of a caller's own solve at overlapping times, it may stay at one.
    """
    return nullcontext() if hasattr(_here, "pieces") else _blas().limit(limits=1, user_api="blas")


@lru_cache(maxsize=1)
def _blas() -> ThreadpoolController:
    """The libraries of NumPy and SciPy, each of which has its own."""
    import scipy.linalg  # noqa: F401  (it loads SciPy's)

    return ThreadpoolController()
