"""What a long step tells whoever prints lines: a terminal, a log, a notebook."""

from __future__ import annotations

from collections.abc import Callable

# Is handed a line for people at a time, by any thread (``parallel``). What is handed data has a name of its own, e.g.
# ``OnFitStep``.
Observer = Callable[[str], None]
