"""How much commands say: ``--quiet`` leaves out progress, ``-v`` shows what the library logs as well."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from spinestiff.observer import LOGGER


@dataclass(frozen=True)
class Volume:
    """What is wanted on the error stream: ``quiet`` warnings and errors alone, ``verbose`` the library's log, too."""

    quiet: bool = False
    verbose: bool = False


_asked: ContextVar[Volume] = ContextVar("volume", default=Volume())  # noqa: B039 (frozen)


def volume() -> Volume:
    """What the command that runs was asked."""
    return _asked.get()


@contextmanager
def speaking(asked: Volume) -> Iterator[None]:
    """Run a command at this volume."""
    token = _asked.set(asked)
    logger, before = logging.getLogger(LOGGER), logging.getLogger(LOGGER).level
    shown = logging.StreamHandler(sys.stderr)
    shown.setFormatter(logging.Formatter("%(name)s: %(message)s"))
    # What progress shows is not shown twice.
    shown.addFilter(lambda record: not getattr(record, "told", False))
    if asked.verbose:
        logger.addHandler(shown)
        logger.setLevel(logging.DEBUG)
    try:
        yield
    finally:
        logger.removeHandler(shown)
        logger.setLevel(before)
        _asked.reset(token)
