"""A command as a job of the workbench: as in a terminal, but it ends when the process that watches over it ends."""

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


def main() -> None:
    """Run the command that the arguments name."""
    threading.Thread(target=_end_with_watcher, daemon=True).start()
    from spinestiff.app.start import main as run

    sys.argv[0] = "spinestiff"
    run()


if __name__ == "__main__":
    main()
