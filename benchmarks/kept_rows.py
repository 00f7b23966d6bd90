"""Campaigns that keep a line of JSON for each person or subject, and what is summed up of the lines."""

from __future__ import annotations

import argparse
import datetime
import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

from spinestiff.files import trouble

DIGITS = 5  # of a log's numbers
ROOT = Path(__file__).parent.parent


def rows_of(paths: Iterable[Path]) -> list[dict[str, Any]]:
    """All rows of some logs that were written whole; a last line without an end was not."""
    texts = [path.read_text(encoding="utf-8") for path in paths]
    return [json.loads(line) for text in texts for line in text[: text.rfind("\n") + 1].splitlines()]


def begun(log: Path) -> list[dict[str, Any]]:
    """The rows of a log that a campaign goes on with; none where it begins."""
    return rows_of([log]) if log.is_file() else []


def prepare(log: Path) -> None:
    """Make a log's folder, take away a row that was not written whole, and end the program in one line where the log
    can't be written, before any work for it."""
    with _told(log):
        log.parent.mkdir(parents=True, exist_ok=True)
        new = not log.exists()
        with log.open("ab+") as stream:
            stream.seek(0)
            stream.truncate(stream.read().rfind(b"\n") + 1)
        if new:
            log.unlink()


@contextmanager
def _told(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as problem:
        raise SystemExit(f"{path}: can't be written ({trouble(problem)})") from None


def keep(log: Path, row: Mapping[str, Any]) -> None:
    """Put a row at the end of a log, its numbers with as many digits as a log keeps."""
    with _told(log), log.open("a", encoding="utf-8") as stream:
        stream.write(json.dumps(rounded(row)) + "\n")


def rounded(value: Any) -> Any:
    """A row, or a part of it, with ``DIGITS`` digits."""
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, Mapping):
        return {key: rounded(part) for key, part in value.items()}
    return [rounded(part) for part in value] if isinstance(value, list | tuple) else value


@lru_cache(maxsize=1)
def code() -> str:
    """Hash of what a subject and its estimate are made with."""
    patterns = (
        "benchmarks/coverage_*.py",
        "benchmarks/told_intervals.py",
        "benchmarks/judgement_subjects.py",
        "benchmarks/discrepancy_pairs.py",
        "src/spinestiff/estimation/data/*",
        *(
            f"src/spinestiff/study/{name}.py"
            for name in ("synthetic/elastic_supports", "trials", "visit", "fits", "forecasts", "predictions")
        ),
    )
    rooms = ("anatomy", "mechanics", "estimation", "imaging", "personalise")
    patterns += tuple(f"src/spinestiff/{room}/**/*.py" for room in rooms)
    found = {pattern: sorted(ROOT.glob(pattern)) for pattern in patterns}
    assert all(found.values()), [pattern for pattern, paths in found.items() if not paths]
    files = [path for paths in found.values() for path in paths]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:12]


def tell(summary: Mapping[str, Any], stored: Path | None) -> None:
    """Print a summary with today's date, and store it where that is asked for."""
    text = json.dumps({"date": datetime.datetime.now(datetime.UTC).date().isoformat(), **summary}, indent=1)
    print(text)
    if stored is not None:
        with _told(stored):
            stored.write_text(text + "\n", encoding="utf-8")


def measure_once(
    doc: str | None, stored: Path, measure: Callable[..., Mapping[str, Any]], place: str | None = None, **numbers: int
) -> None:
    """The command line of a program that measures all at once: measure and print, store, or print what is stored.

    Parameters
    ----------
    doc : the program's own words. stored : where ``--write`` puts what was found and ``--json`` reads it.
    measure : gives it, of the path that is called ``place``, if there is one, and of ``numbers``: options with whole
        numbers, and their defaults.
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    if place is not None:
        parser.add_argument("place", type=Path, nargs="?", metavar=place)
    for name, usual in numbers.items():
        parser.add_argument(f"--{name}", type=int, default=usual)
    parser.add_argument("--write", action="store_true", help="store it in benchmarks/results/")
    parser.add_argument("--json", action="store_true", help="print what is stored")
    asked = parser.parse_args()
    if asked.json:
        print(stored.read_text(encoding="utf-8") if stored.is_file() else "{}")
        return
    where = [] if place is None else [asked.place]
    if where == [None]:
        parser.error(f"wanted {place} or --json")
    given = {name: getattr(asked, name) for name in numbers}
    tell({**given, **measure(*where, **given)}, stored if asked.write else None)


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
        for log in asked.summary:
            if not log.is_file():
                parser.error(f"{log}: no such file")
        tell(summed_up(rows_of(asked.summary)), stored if asked.write else None)
    elif asked.log:
        prepare(asked.log)
        return asked
    else:
        parser.error("wanted --log FILE, --summary FILE... or --json")
    return None
