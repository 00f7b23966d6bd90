"""One run at a time on a subject: two at once would record each other's results as their own."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from spinestiff.errors import InUseError


@contextmanager
def sole_run(folder: Path) -> Iterator[None]:
    """Hold a subject folder for one run; the system lets go of it however the run ends, and nothing is written.

    On Windows, and on file systems without locks, nothing is held.

    Raises
    ------
    InUseError : another run holds it.
    """
    if os.name == "nt":
        yield
        return
    import fcntl

    held = os.open(folder, os.O_RDONLY)
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
