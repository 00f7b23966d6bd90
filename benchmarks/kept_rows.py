"""Campaigns that keep a line of JSON for each person or subject, and what is summed up of the lines."""

from __future__ import annotations

import datetime
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any


def rows_of(paths: Iterable[Path]) -> list[dict[str, Any]]:
    """All rows of some logs."""
    return [json.loads(line) for path in paths for line in path.read_text().splitlines()]


def begun(log: Path) -> list[dict[str, Any]]:
    """The rows of a log that a campaign goes on with; none where it begins."""
    return rows_of([log]) if log.is_file() else []


def keep(log: Path, row: Mapping[str, Any]) -> None:
    """Put a row at the end of a log."""
    with log.open("a") as stream:
        stream.write(json.dumps(row) + "\n")


def tell(summary: Mapping[str, Any], stored: Path | None) -> None:
    """Print a summary with today's date, and store it where that is asked for."""
    text = json.dumps({"date": datetime.datetime.now(datetime.UTC).date().isoformat(), **summary}, indent=1)
    print(text)
    if stored is not None:
        stored.write_text(text + "\n", encoding="utf-8")
