"""How notebooks show this package's objects: a small picture beside a table, as HTML."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable
from html import escape
from io import BytesIO
from typing import Any

DPI = 96


def as_html(title: str, rows: Iterable[tuple[str, str]], figure: Any = None) -> str:
    """A table with a title, and a figure to the left of it.

    Parameters
    ----------
    rows : what and how much, as text.
    figure : of matplotlib; None: none.
    """
    cells = "".join(
        f'<tr><td style="text-align:left">{escape(name)}</td><td style="text-align:left">{escape(value)}</td></tr>'
        for name, value in rows
    )
    table = f"<table><caption><b>{escape(title)}</b></caption>{cells}</table>"
    picture = "" if figure is None else f'<img alt="{escape(title)}" src="{_data_address(figure)}">'
    style = "display:flex;gap:1em;align-items:flex-start"
    return f'<div class="spinestiff" style="{style}">{picture}{table}</div>'


def _data_address(figure: Any) -> str:
    stream = BytesIO()
    figure.savefig(stream, format="png", dpi=DPI)
    return "data:image/png;base64," + b64encode(stream.getvalue()).decode("ascii")
