"""What a long step tells whoever prints lines: a terminal, a log, a notebook; and Python's logging beside them.

Loggers are named after modules, "spinestiff.study.runner" and the like, and say nothing until a program asks for it
(``logging.basicConfig``): the package's own has a ``NullHandler``.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

# Is handed a line for people at a time, by any thread (``parallel``). What is handed data has a name of its own, e.g.
# ``OnFitStep``.
Observer = Callable[[str], None]
LOGGER = "spinestiff"
"""The logger of the whole package."""


def heard(observer: Observer | None, logger: logging.Logger) -> Observer:
    """An observer whose lines are logged, too: warnings as such, all others as information.

    A record has the attribute ``told`` where somebody was told the line besides, so that it need not be shown twice.
    """

    def say(line: str) -> None:
        level = logging.WARNING if is_warning(line) else logging.INFO
        logger.log(level, "%s", line, extra={"told": observer is not None})
        if observer is not None:
            observer(line)

    return say


def is_warning(line: str) -> bool:
    """Whether a line warns: "warning: ..."."""
    return line.startswith("warning")
