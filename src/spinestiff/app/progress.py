"""Progress on a terminal (one live line, one kept line a finished step) and in a log (one line each)."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Lock


@contextmanager
def progress(quiet: bool = False) -> Iterator[Callable[[str], None]]:
    """A function that takes lines "step: what it is doing"; what has no step, or warns, is always kept."""
    from rich.console import Console
    from rich.markup import escape

    console = Console(stderr=True, quiet=quiet, highlight=False)
    began = time.perf_counter()

    def stamped(line: str) -> str:
        return f"[dim]{time.perf_counter() - began:6.1f} s[/dim]  {escape(line)}"

    if not console.is_terminal:
        yield lambda line: console.print(stamped(line), soft_wrap=True)
        return
    last, turn = "", Lock()
    with console.status("") as status:

        def say(line: str) -> None:
            with turn:
                _say(line)

        def _say(line: str) -> None:
            nonlocal last
            if last and last.partition(":")[0] != line.partition(":")[0]:
                console.print(stamped(last), soft_wrap=True)
            if line.startswith("warning") or "up to date" in line:
                console.print(stamped(line), soft_wrap=True)
                line = ""
            last = line
            status.update(escape(line))

        yield say
        if last:
            console.print(stamped(last), soft_wrap=True)
