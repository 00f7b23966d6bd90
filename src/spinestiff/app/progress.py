"""Progress on a terminal (one live line, one kept line a finished step) and in a log (one line each).

However long a step takes, there is a sign of life every few seconds: on a terminal the time since the last line counts
on, in a log a line says what is still at work.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING

from spinestiff.app.volume import volume
from spinestiff.observer import is_warning

if TYPE_CHECKING:
    from rich.console import Console

LONGEST_SILENCE_S = 5.0
BEGINNING = "starting"


@contextmanager
def progress() -> Iterator[Callable[[str], None]]:
    """A function that takes lines "step: what it is doing"; what has no step, or warns, is always kept.

    With ``--quiet`` only warnings are shown.
    """
    from rich.console import Console
    from rich.markup import escape

    console = Console(stderr=True, highlight=False)
    began = time.perf_counter()

    def keep(line: str) -> None:
        stamp = f"[dim]{time.perf_counter() - began:6.1f} s[/dim]  "
        console.print(stamp + escape(line), soft_wrap=True)

    if volume().quiet:
        yield lambda line: keep(line) if is_warning(line) else None
    elif console.is_terminal:
        with _live(console, keep) as say:
            yield say
    else:
        with _log(keep) as say:
            yield say


@contextmanager
def beating(keep: Callable[[str], None], words: Callable[[], str], longest_s: float) -> Iterator[Callable[[str], None]]:
    """A function that keeps lines; where none came for so long, ``words`` are kept as well."""
    turn, ended = Lock(), Event()
    shown = time.perf_counter()

    def say(line: str) -> None:
        nonlocal shown
        with turn:
            shown = time.perf_counter()
            keep(line)

    def beat() -> None:
        # A little before the time is up: a busy interpreter may keep this thread waiting.
        while not ended.wait(max(shown + 0.9 * longest_s - time.perf_counter(), 0.01)):
            if time.perf_counter() >= shown + 0.9 * longest_s:
                say(words())

    watch = Thread(target=beat, daemon=True)
    watch.start()
    try:
        yield say
    finally:
        ended.set()
        watch.join()


@contextmanager
def _log(keep: Callable[[str], None]) -> Iterator[Callable[[str], None]]:
    last, since = BEGINNING, time.perf_counter()

    def words() -> str:
        return f"still at it for {time.perf_counter() - since:.0f} s: {last}"

    with beating(keep, words, LONGEST_SILENCE_S) as show:

        def say(line: str) -> None:
            nonlocal last, since
            last, since = line, time.perf_counter()
            show(line)

        yield say


@contextmanager
def _live(console: Console, keep: Callable[[str], None]) -> Iterator[Callable[[str], None]]:
    from rich.text import Text

    last, since, turn = "", time.perf_counter(), Lock()

    class Line:
        """The last line, and for how long it has been the last."""

        def __rich__(self) -> Text:
            waited = time.perf_counter() - since
            counted = f"  {waited:.0f} s" if waited >= 1.0 else ""
            return Text((last or BEGINNING) + counted, overflow="ellipsis", no_wrap=True)

    with console.status(Line()):

        def say(line: str) -> None:
            nonlocal last, since
            with turn:
                if last and last.partition(":")[0] != line.partition(":")[0]:
                    keep(last)
                if is_warning(line) or "up to date" in line:
                    keep(line)
                    line = ""
                last, since = line, time.perf_counter()

        yield say
        if last:
            keep(last)
