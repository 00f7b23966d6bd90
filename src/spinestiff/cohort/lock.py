"""One run at a time on a cohort's output, or many that each take a participant of their own.

The lock is the system's, on a file that says who holds it: it is free as soon as its owner has ended, however that
came about, and the next run takes it over.
"""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from spinestiff.cohort.places import LOCK_FILE
from spinestiff.errors import InUseError, SubjectError
from spinestiff.files import trouble
from spinestiff.words import printable

_LONGEST = 200


@contextmanager
def cohort_lock(target: Path, shared: bool = False) -> Iterator[None]:
    """Hold a cohort's output for one run.

    On Windows, and on file systems without locks, nothing is held.

    Parameters
    ----------
    shared : beside others that hold it so, each with participants of its own.

    Raises
    ------
    InUseError : another run holds it.
    SubjectError : nothing can be written there.
    """
    path = target / LOCK_FILE
    try:
        target.mkdir(parents=True, exist_ok=True)
        held = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as problem:
        raise SubjectError(f"{target}: can't be written ({trouble(problem)})") from None
    try:
        if os.name != "nt":
            _take(target, held, shared)
        if not shared:
            _sign(target, held)
        yield
    finally:
        os.close(held)


def _take(target: Path, held: int, shared: bool) -> None:
    import fcntl

    try:
        fcntl.flock(held, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        try:
            # Only beside others that share it: then nobody has signed.
            fcntl.flock(held, fcntl.LOCK_SH | fcntl.LOCK_NB)
            owner = "single participants by --index"
        except BlockingIOError:
            owner = os.read(held, _LONGEST).decode("utf-8", "replace").strip()
        raise InUseError(
            f"{target}: another run of spinestiff cohort is at work here ({printable(owner, _LONGEST)}); "
            "wait for its end"
        ) from None
    except OSError:
        pass  # a file system without locks


def _sign(target: Path, held: int) -> None:
    """Say in the file whose it is, for whoever is refused."""
    began = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime())
    words = f"process {os.getpid()} on {socket.gethostname()} since {began}\n"
    try:
        os.ftruncate(held, 0)
        os.write(held, words.encode()[:_LONGEST])
    except OSError as problem:
        raise SubjectError(f"{target / LOCK_FILE}: can't be written ({trouble(problem)})") from None
