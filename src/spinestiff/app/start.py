"""Where the installed program starts: ready for Ctrl-C, closed outputs and readers that left."""

from __future__ import annotations

import codecs
import io
import os
import sys
from contextlib import suppress

from spinestiff.app import INTERRUPTED, READER_LEFT, STOPPED


def main() -> None:
    """Run the command line. Ctrl-C ends it in one line, a reader of its output that left without a word."""
    _open_standard_files()
    # Threads work on pieces (``parallel``); BLAS, which would split small products again, only waits. Before NumPy.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        from spinestiff.app.cli import main as run

        try:
            run()
        finally:
            sys.stdout.flush()
    except KeyboardInterrupt:
        _end(STOPPED, INTERRUPTED)
    except BrokenPipeError:
        _end("", READER_LEFT)
    except OSError as problem:
        from spinestiff.files import trouble

        _end(f"the output: can't be written ({trouble(problem)})", 2)
    except SystemExit as end:
        # typer and rich turn it into a status of their own.
        if isinstance(end.__context__, BrokenPipeError):
            _end("", READER_LEFT)
        raise


def _open_standard_files() -> None:
    """A standard file that was closed is nowhere: else the next file to be opened would be taken for it. One that is
    open takes any text.
    """
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 (until the program's end)
        stream = getattr(sys, name)
        if isinstance(stream, io.TextIOWrapper) and _lacks_signs(stream):
            # Names of files that are no text in this encoding, and signs that a console lacks, are told by their codes.
            stream.reconfigure(errors="backslashreplace")


def _lacks_signs(stream: io.TextIOWrapper) -> bool:
    """Whether writing some text to it would end in an error."""
    utf_8 = codecs.lookup(stream.encoding).name == "utf-8"
    return stream.errors == "strict" or (stream.errors == "surrogateescape" and not utf_8)


def _end(message: str, status: int) -> None:
    """End here: what is still in the output's buffer has nowhere to go, and Python's own end would say so."""
    if message:
        with suppress(OSError):
            print(f"spinestiff: {message}", file=sys.stderr, flush=True)
    os._exit(status)
