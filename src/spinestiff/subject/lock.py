"""One run at a time on a subject: two at once would record each other's results as their own."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from spinestiff.errors import InUseError


@contextmanager
def sole_run(folder: Path, by: Path | None = None) -> Iterator[None]:
    """Hold a folder, as a subject's, for one run; the system lets go of it however the run ends.

    On Windows, and on file systems without locks, nothing is held.

    Parameters
    ----------
    by : a file that stands for the folder and is made where it is not there: file systems of several machines (NFS)
        lock one opened for writing for all of them. Without, the folder itself is locked, by each machine alone, and
        nothing is written.

    Raises
    ------
    InUseError : another run holds it.
    OSError : the file can't be written.
    """
    if os.name == "nt":
        yield
        return
    import fcntl

    held = os.open(folder, os.O_RDONLY) if by is None else os.open(by, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InUseError(f"{folder}: another run of spinestiff is at work here; wait for its end") from None
        except OSError:
            pass
        yield
    finally:
        os.close(held)
