"""What a cohort's own files cost when there are very many participants: ledger, survey of what is done, tables, page.

``python benchmarks/cohort_scale.py [--writes 1000] [--rows 100000] [--participants 3000] [--json] [--write]``

    ledger    participants a second that one run can account for: two transactions each (a try begins, a try ends) and
              last.json, each on the disk before the next, also the transactions alone; size of a ledger with so many
              tries, and how long it takes to open it and to ask it for the usual time
    survey    time to tell of a participant that it is up to date (every input and result is read and hashed), by its
              bytes and by its files
    group     time to put the participants together, and what page and tables grow by; all for one participant
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import platform
import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import kill_resume

from spinestiff import __version__
from spinestiff.cohort.account import Account
from spinestiff.cohort.asked import Cohort, silent
from spinestiff.cohort.ledger import Try, now, open_ledger, take_over
from spinestiff.cohort.marker import Order
from spinestiff.cohort.overview import write_overview
from spinestiff.cohort.places import LEDGER_FILE
from spinestiff.cohort.worker import make_results

RESULTS = Path(__file__).parent / "results"


def timed(call: Callable[[], Any]) -> float:
    """Seconds on the wall."""
    began = time.perf_counter()
    call()
    return time.perf_counter() - began


def a_try(number: int) -> Try:
    return Try(
        run="0" * 32, participant=f"sub-{number:06d}", number=1, started=now(), seconds=400.0 + number % 97,
        cpu_seconds=300.0, peak_mb=900.0, ended="done", words="", host="node-0001",
    )  # fmt: skip


def ledger(folder: Path, writes: int, rows: int) -> dict[str, float]:
    """Figures of the ledger."""
    order = Order(runner="none:none", settings={}, version=__version__)
    with open_ledger(folder, "0" * 32, order) as book:

        def write() -> None:
            for number in range(writes // 2):
                book.begin_try(f"sub-{number:06d}", 1, "node-0001")
                book.end_try(a_try(number))

        seconds = timed(write)
        cohort = Cohort(
            folder / "in", folder / "out", tuple(f"sub-{writes + n:06d}" for n in range(writes // 4)), order
        )
        for name in cohort.participants:
            (cohort.target / name).mkdir(parents=True)
        account = Account(cohort, book, silent)

        def account_for() -> None:
            for number, name in enumerate(cohort.participants):
                account.begin(name, 1, "node-0001")
                account.take(a_try(writes + number))

        accounting = timed(account_for)
    in_bulk = timed(lambda: take_over(folder, map(a_try, range(rows))))

    def reopen() -> None:
        with open_ledger(folder, "1" * 32, order) as book:
            book.usual_seconds()

    return {
        "transactions_per_second": round(2 * (writes // 2) / seconds, 1),
        "participants_per_second": round(len(cohort.participants) / accounting, 1),
        "rows": rows,
        "rows_taken_over_per_second": round(rows / in_bulk),
        "open_and_ask_seconds": round(timed(reopen), 2),
        "megabytes": round((folder / LEDGER_FILE).stat().st_size / 1e6, 1),
    }


def many(folder: Path, participants: int) -> dict[str, Any]:
    """Figures of survey and group level, with the reduced model's results."""
    kill_resume.make(folder / "in", participants)
    names = tuple(f"sub-{number:04d}" for number in range(1, participants + 1))
    cohort = Cohort(folder / "in", folder / "out", names, kill_resume.order_of(0.0))
    with patch("os.fsync"):  # not what is measured here
        for name in names:
            make_results(cohort.task(name), lambda line: None)
    files = [path for place in (folder / "in", folder / "out") for path in place.rglob("*") if path.is_file()]

    def group(count: int) -> list[float]:
        seconds = timed(lambda: write_overview(cohort.source, cohort.target, names[:count], order=cohort.order))
        written = [cohort.target / name for name in ("cohort.html", "cohort.csv", "cohort.json")]
        return [seconds, *(path.stat().st_size / 1e3 for path in written)]

    group(10)  # imports
    fifth, all_ = group(participants // 5), group(participants)
    slopes = [(late - early) / (participants - participants // 5) for early, late in zip(fifth, all_)]
    return {
        "participants": participants,
        "files": len(files),
        "megabytes": round(sum(path.stat().st_size for path in files) / 1e6, 1),
        "survey_ms": round(1e3 * timed(lambda: Account(cohort, None, silent).survey()) / participants, 2),
        "group_ms": round(1e3 * slopes[0], 2),
        "page_kilobytes": round(slopes[1], 2),
        "table_kilobytes": round(slopes[2], 2),
        "json_kilobytes": round(slopes[3], 2),
        "peak_megabytes": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
    }


def hashing(folder: Path) -> float:
    """Megabytes a second that are read and hashed."""
    from spinestiff.files import file_digest

    path = folder / "large"
    path.write_bytes(os.urandom(1 << 20) * 200)
    return round(200 * (1 << 20) / 1e6 / timed(lambda: file_digest(path)))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="what a cohort's own files cost")
    parser.add_argument("--writes", type=int, default=1000)
    parser.add_argument("--rows", type=int, default=100_000)
    parser.add_argument("--participants", type=int, default=3000)
    parser.add_argument("--json", action="store_true", help="print one line of JSON instead of an indented one")
    parser.add_argument("--write", action="store_true", help="store the figures in results/cohort_scale.json")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary)
        (place / "ledger").mkdir()
        figures = {
            "date": datetime.date.today().isoformat(),
            "ledger": ledger(place / "ledger", asked.writes, asked.rows),
            "hashed_megabytes_per_second": hashing(place),
            "many": many(place / "many", asked.participants),
            "machine": f"{platform.machine()}, {os.cpu_count()} processors, other work beside it",
        }
    text = json.dumps(figures, indent=None if asked.json else 1)
    print(text)
    if asked.write:
        (RESULTS / "cohort_scale.json").write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
