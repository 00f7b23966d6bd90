"""``spinestiff cohort``: all subjects of a table, each in a process of its own, and what they say together."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from spinestiff.app.progress import beating
from spinestiff.app.volume import volume
from spinestiff.cohort.asked import Cohort, Limits, News, Summary
from spinestiff.cohort.cluster import run_on_cluster
from spinestiff.cohort.marker import Order
from spinestiff.cohort.participants import read_participants
from spinestiff.cohort.processes import usual_memory_mb
from spinestiff.cohort.supervisor import run_one, run_participants
from spinestiff.errors import OptionError
from spinestiff.parallel import processors
from spinestiff.subject.program import program
from spinestiff.subject.records import SUBJECT_FILE
from spinestiff.words import counted

LEVELS = ("participant", "group")
FAILED = 1
"""Exit status where a participant failed."""
MOST_SHOWN = 20
GB_IN_MB = 1024.0
"""As a MB of a process, in the ledger and in messages, is 2^20 bytes."""
LOG_SILENCE_S = 30.0
"""After which a log tells how far all are: a cohort takes hours."""
_RECENT = 12


def order_of(settings: dict[str, Any]) -> Order:
    """What is asked for each participant. Raises SubjectError for settings that there are not."""
    from spinestiff.cohort.subject_run import RUNNER, settings_of

    settings_of(settings)
    return Order(runner=RUNNER, settings=settings, version=program())


def run_cohort(
    source: Path,
    target: Path,
    level: str | None,
    order: Order,
    jobs: int | None = None,
    index: int | None = None,
    minutes: float | None = None,
    memory_gb: float | None = None,
    difference: float | None = None,
    usual: bool = False,
    scheduler: str | None = None,
) -> int:
    """Run the levels that are asked for and print what came out; the exit status.

    Parameters
    ----------
    memory_gb : that a participant may take, in 2^30 bytes.
    usual : ``order`` holds no setting that was asked for: the group level alone takes the results as most were made.
    scheduler : address of a Dask scheduler whose workers run the participants; None runs them here.

    Raises
    ------
    SpinestiffError : an option, the table of participants, another run at work, no room to write.
    """
    if level not in (None, *LEVELS):
        raise OptionError(f"level '{level}': wanted {' or '.join(LEVELS)}; both are run if it is left out")
    if index is not None and level != "participant":
        raise OptionError(f"--index {index}: runs a single participant; add the level: participant --index {index}")
    if scheduler is not None and (index is not None or level == "group"):
        what = "--index" if index is not None else "group"
        raise OptionError(f"--scheduler {scheduler}: runs participants on a cluster; leave out it or {what}")
    if (target / SUBJECT_FILE).is_file():
        raise OptionError(
            f"{target}: is a subject folder; a cohort has a folder for each participant, name another one"
        )
    from spinestiff.cohort.overview import refuse_foreign, write_overview

    refuse_foreign(target)
    cohort = Cohort(source, target, read_participants(source), order)
    status = 0
    if level != "group":
        summary = _run(cohort, jobs, index, None if minutes is None else 60.0 * minutes, memory_gb, scheduler)
        _print(summary, target)
        status = FAILED if summary.failed else 0
    if level != "participant":
        for line in write_overview(source, target, cohort.participants, difference, None if level and usual else order):
            print(line)
    return status


def _run(
    cohort: Cohort,
    jobs: int | None,
    index: int | None,
    seconds: float | None,
    memory_gb: float | None,
    scheduler: str | None,
) -> Summary:
    asked_mb = None if memory_gb is None else GB_IN_MB * memory_gb
    if scheduler is not None:
        with live(len(cohort.participants), 0) as shown:
            return run_on_cluster(
                cohort, scheduler, jobs, Limits(seconds, asked_mb), shown.news, shown.expect, shown.room, shown.remark
            )
    count = len(cohort.participants) if index is None else 1
    side_by_side = min(jobs or processors(), count)
    limits = Limits(seconds, usual_memory_mb(side_by_side) if asked_mb is None else asked_mb)
    with live(count, side_by_side) as shown:
        if index is None:
            return run_participants(cohort, side_by_side, limits, shown.news, shown.expect)
        return run_one(cohort, index, limits, shown.news)


def _print(summary: Summary, target: Path) -> None:
    print(f"participants: {len(summary.done)} run, {len(summary.up_to_date)} up to date, {len(summary.failed)} failed")
    for name, words in list(summary.failed.items())[:MOST_SHOWN]:
        print(f"failed: {name}: {words}")
    if len(summary.failed) > MOST_SHOWN:
        print(f"and {len(summary.failed) - MOST_SHOWN} more; last.json in each one's folder in {target} says why")


class Shown:
    """What a live table shows of a run: who is at work at what, what has ended, how long it may still take."""

    def __init__(
        self, count: int, jobs: int, keep: Callable[[str], None], remark: Callable[[str], None] | None = None
    ) -> None:
        self._count, self._keep = count, keep
        self.jobs, self.remark = jobs, remark or keep
        self._stages: dict[str, News] = {}
        self._began: dict[str, float] = {}
        self._recent: list[News] = []
        self._seconds: list[float] = []
        self._usual: float | None = None
        self._start = time.monotonic()
        # News come while another thread draws.
        self._lock = threading.Lock()

    def expect(self, usual: float | None) -> None:
        """How long a participant took in earlier runs."""
        self._usual = usual

    def room(self, jobs: int) -> None:
        """How many participants can be at work at a time, from now on."""
        self.jobs = jobs

    def news(self, one: News) -> None:
        """Take what has become of a participant."""
        with self._lock:
            before = self._stages.get(one.participant)
            self._stages[one.participant] = one
            if one.stage == "running" and (before is None or before.stage != "running"):
                self._began[one.participant] = time.monotonic()
            if one.stage in ("done", "failed", "again"):
                self._recent = [*self._recent[1 - _RECENT :], one]
            if one.stage == "done":
                self._seconds.append(one.seconds)
        if one.stage in ("done", "failed", "again"):
            self._keep(f"{one.participant}: {_words(one)}")
        if one.stage == "running" and one.words.startswith("warning"):
            self._keep(f"{one.participant}: {one.words}")

    def count_of(self, *stages: str) -> int:
        """How many participants are at one of these stages."""
        return sum(one.stage in stages for _, one in self._known())

    def seconds_left(self) -> float | None:
        """By the mean of those done in this run, else the median of earlier ones; None where nothing tells it."""
        usual = sum(self._seconds) / len(self._seconds) if self._seconds else self._usual
        if usual is None or self.jobs == 0:
            return None
        passed = [
            min(time.monotonic() - self._began[name], usual) for name, one in self._known() if one.stage == "running"
        ]
        left = usual * (self.count_of("waiting", "running", "again")) - sum(passed)
        return max(left, 0.0) / self.jobs

    def headline(self) -> str:
        """One line: counts and the time left."""
        counts = [
            (self.count_of("done"), "done"), (self.count_of("up to date"), "up to date"),
            (self.count_of("failed"), "failed"), (self.count_of("running"), "running"),
            (self.count_of("waiting", "again"), "waiting" if self.jobs else "waiting for workers"),
        ]  # fmt: skip
        left = self.seconds_left()
        parts = [f"{count} {word}" for count, word in counts if count]
        passed = f"{duration(time.monotonic() - self._start)} passed"
        return ", ".join([*parts, passed, *([] if left is None else [f"about {duration(left)} left"])])

    def rows(self) -> list[tuple[str, str, str, str]]:
        """Participant, stage, words and time: those that ended last, then those at work."""
        ended = [(one.participant, one.stage, one.words, duration(one.seconds)) for one in self._recent]
        running = [
            (name, "running", one.words, duration(time.monotonic() - self._began[name]))
            for name, one in self._known()
            if one.stage == "running"
        ]
        return [*ended, *running]

    def _known(self) -> list[tuple[str, News]]:
        with self._lock:
            return list(self._stages.items())


def _words(one: News) -> str:
    took = duration(one.seconds)
    if one.stage == "done":
        return f"done in {took}"
    return f"{'tried again' if one.stage == 'again' else 'failed'} after {took}: {one.words}"


def duration(seconds: float) -> str:
    """ "45 s", "12 min", "3 h 20 min"."""
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60} min"


@contextmanager
def live(count: int, jobs: int) -> Iterator[Shown]:
    """A table that follows the run on a terminal; in a log a line for each participant that ends."""
    from rich.console import Console, Group
    from rich.live import Live
    from rich.markup import escape
    from rich.progress_bar import ProgressBar
    from rich.table import Table

    console = Console(stderr=True, quiet=volume().quiet, highlight=False)
    if not console.is_terminal:
        shown = Shown(count, jobs, lambda line: say(line))
        with beating(lambda line: console.print(escape(line), soft_wrap=True), shown.headline, LOG_SILENCE_S) as say:
            yield shown
        return
    shown = Shown(count, jobs, lambda line: None, lambda line: console.print(escape(line), soft_wrap=True))
    marks = {"done": "[green]done[/green]", "failed": "[bold red]failed[/bold red]", "again": "[yellow]again[/yellow]"}

    class Picture:
        def __rich__(self) -> Group:
            table = Table(title=f"{counted(count, 'participant')}, {shown.jobs} at a time", title_justify="left")
            for column in ("participant", "", "", "time"):
                table.add_column(column, no_wrap=True, overflow="ellipsis")
            for name, stage, words, took in shown.rows():
                table.add_row(escape(name), marks.get(stage, stage), escape(words), took)
            ended = shown.count_of("done", "failed", "up to date")
            return Group(table, ProgressBar(total=count, completed=ended), escape(shown.headline()))

    with Live(Picture(), console=console, refresh_per_second=2):
        yield shown
