"""Campaigns that keep a line of JSON for each person or subject, and what is summed up of the lines."""

from __future__ import annotations

import argparse
import datetime
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
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


def asked_for(
    doc: str | None,
    stored: Path,
    summed_up: Callable[[Sequence[dict[str, Any]]], Mapping[str, Any]],
    **numbers: int,
) -> argparse.Namespace | None:
    """What a campaign is asked on the command line; None where it was to print or sum up what there is, which is done.

    Parameters
    ----------
    doc : the program's own words. stored : where ``--write`` puts a summary and ``--json`` reads it.
    numbers : further options with whole numbers, and their defaults.
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--log", type=Path, help="where rows are kept; one that is there is gone on with")
    for name, usual in numbers.items():
        parser.add_argument(f"--{name}", type=int, default=usual)
    parser.add_argument("--summary", type=Path, nargs="+", metavar="FILE")
    parser.add_argument("--write", action="store_true", help="store the summary in benchmarks/results/")
    parser.add_argument("--json", action="store_true", help="print what is stored")
    asked = parser.parse_args()
    if asked.json:
        print(stored.read_text(encoding="utf-8") if stored.is_file() else "{}")
    elif asked.summary:
        tell(summed_up(rows_of(asked.summary)), stored if asked.write else None)
    elif asked.log:
        return asked
    else:
        parser.error("wanted --log FILE, --summary FILE... or --json")
    return None
