"""``spinestiff study``: a whole study, from making its subjects to the page about it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from spinestiff.app.commands.common import PlainNumbers, common
from spinestiff.app.options import offering
from spinestiff.app.progress import LONGEST_SILENCE_S, beating
from spinestiff.app.volume import volume

study = typer.Typer(
    name="study", help="Whole studies of synthetic subjects.", no_args_is_help=True, rich_markup_mode=None
)


@study.callback()
def _group() -> None:
    pass


@study.command(cls=PlainNumbers)
@common
def seven(
    folder: Annotated[Path, typer.Argument(help="Folder of the study; what is there already is not made again.")],
    others: Annotated[
        bool, typer.Option("--others", help="Thirty others, drawn from the ranges of the seven, in place of the seven.")
    ] = False,
    mesh: Annotated[
        str,
        typer.Option(
            help="Mesh of the estimates: fine, or coarse, a quick look.", autocompletion=offering("fine", "coarse")
        ),
    ] = "fine",
    workers: Annotated[
        int | None, typer.Option(min=1, max=256, help="Subjects at a time; default a processor each.")
    ] = None,
    page: Annotated[
        Path | None, typer.Option(help="Where the page goes, pictures beside it in images/; default FOLDER/study.md.")
    ] = None,
    page_only: Annotated[
        bool,
        typer.Option(
            "--page-only", help="Write the page from the outcomes that are there, whichever program's; run nothing."
        ),
    ] = False,
    json: Annotated[
        bool,
        typer.Option("--json", help="Print errors by subject as a JSON list; cobb_error_deg is between fixed levels."),
    ] = False,
) -> None:
    """Seven subjects after the paper's, from radiographs to its Tables 2-7 and Figures 2, 4 and 5."""
    from spinestiff.app import tables
    from spinestiff.errors import FitError, SubjectError
    from spinestiff.files import trouble
    from spinestiff.parallel import threads
    from spinestiff.study.report.seven_page import check_page, write_page
    from spinestiff.study.seven.account import found_by, time_goal
    from spinestiff.study.seven.campaign import run_study
    from spinestiff.study.seven.goals import errors_of, goals
    from spinestiff.study.seven.participants import others as thirty
    from spinestiff.study.seven.participants import seven as those_seven
    from spinestiff.study.seven.subject import stored_failure, stored_outcome, study_subject, usable_folder
    from spinestiff.study.seven.tables import paper_tables
    from spinestiff.study.visit import Settings
    from spinestiff.subject.lock import sole_run
    from spinestiff.subject.program import program_of_numbers

    settings = Settings(mesh=mesh)  # type: ignore[arg-type]
    place = page or folder / "study.md"
    usable_folder(folder)
    check_page(place)
    wanted = thirty() if others else those_seven()
    failures: Mapping[str, str] = {}
    if not page_only:
        # The seven bear the paper's forces; others are pushed only as far as they bend.
        way = partial(study_subject, limited=others)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as problem:
            raise SubjectError(f"{folder}: can't be written ({trouble(problem)})") from None
        with sole_run(folder), live([one.name for one in wanted]) as on_line:
            failures = run_study(folder, wanted, settings, on_line, workers or threads(), way).failures
    first = [stored_outcome(folder, one, settings) for one in those_seven()]
    further = [found for one in thirty() if (found := stored_outcome(folder, one, settings)) is not None]
    there = further if others else [found for found in first if found is not None]
    if page_only and not further and not any(first):
        raise SubjectError(
            f"{folder}: has no outcome of a study with --mesh {mesh} and these subjects; wanted the folder of a run of "
            "spinestiff study seven, nothing was written"
        )
    found_names = {found.name for found in (*first, *further) if found is not None}
    asked_for = [*those_seven(), *(thirty() if further or others else ())]
    reasons = {one.name: stored_failure(folder, one, settings) for one in asked_for}
    lacking = {name: why for name, why in reasons.items() if name not in found_names or why is not None}
    written = write_page(
        folder, place, first, further, settings, lacking, lambda line: typer.echo(f"warning: {line}", err=True)
    )
    # Beside JSON, not in it.
    typer.echo(found_by(there, program_of_numbers()), err=json)
    if json:
        tables.show_json([errors_of(found) for found in there])
    else:
        if not others:
            for table in paper_tables(first):
                tables.show_paper_table(table)
        judged = goals(there) if others else (*goals(there), time_goal(there))
        tables.show(tables.goals_table(judged, f"Goals, {len(there)} of {len(wanted)} subjects"))
        typer.echo(f"page: {written}")
    if failures:
        name, cause = next(iter(failures.items()))
        raise FitError(f"{len(failures)} of {len(wanted)} subjects have no result; {name}: {cause}")


@contextmanager
def live(names: Sequence[str]) -> Iterator[Callable[[str, str], None]]:
    """A table with a row a subject and what it is at, on a terminal; in a log a line each."""
    from rich.console import Console
    from rich.live import Live
    from rich.markup import escape
    from rich.table import Table

    console, began = Console(stderr=True, quiet=volume().quiet, highlight=False), time.perf_counter()
    if not console.is_terminal:

        def keep(line: str) -> None:
            console.print(f"{time.perf_counter() - began:7.1f} s  {escape(line)}", soft_wrap=True)

        with beating(keep, lambda: f"{len(names)} subjects, still at work", LONGEST_SILENCE_S) as say:
            yield lambda name, line: say(f"{name}: {line}")
        return
    at: dict[str, tuple[str, float, float]] = dict.fromkeys(names, ("waiting", 0.0, 0.0))

    def shown() -> Table:
        table = Table(box=None, pad_edge=False)
        for column in ("subject", "seconds", "at"):
            table.add_column(column, justify="right" if column == "seconds" else "left", no_wrap=True)
        for name, (line, first, last) in at.items():
            table.add_row(escape(name), f"{last - first:.0f}" if first else "", escape(line))
        return table

    with Live(shown(), console=console, refresh_per_second=4) as screen:

        def on_line(name: str, line: str) -> None:
            now = time.perf_counter()
            at[name] = (line, at[name][1] or now, now)
            screen.update(shown())

        yield on_line
