"""A command as a job of the workbench: as in a terminal, but it ends when the process that watches over it ends.

The first line of its input is the subject's folder, "." among its arguments; it starts elsewhere (``job_process``).
"""

from __future__ import annotations

import os
import signal
import sys
import threading

ORPHANED = 86


def _end_with_watcher() -> None:
    while os.read(0, 1):
        pass
    # Whatever this command has started ends, too: it leads a group of its own.
    if os.name != "nt" and os.getpgrp() == os.getpid():
        os.killpg(0, signal.SIGKILL)
    os._exit(ORPHANED)


def _folder() -> str:
    """The first line of the input, and no byte more."""
    line = b""
    while (byte := os.read(0, 1)) not in (b"", b"\n"):
        line += byte
    return os.fsdecode(line)


def main() -> None:
    """Run the command that the arguments name."""
    folder = _folder()
    sys.argv[1:] = [folder if argument == "." else argument for argument in sys.argv[1:]]
    threading.Thread(target=_end_with_watcher, daemon=True).start()
    from spinestiff.app.start import main as run

    sys.argv[0] = "spinestiff"
    run()


if __name__ == "__main__":
    main()
