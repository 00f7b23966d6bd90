"""``check``, ``phantom``, ``doctor``: this machine, and a column of known stiffness."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from spinestiff.app.commands.shared import AsJson


def check(
    table: Annotated[bool, typer.Option("--table", help="Print every check with its error.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print every check as a JSON list.")] = False,
) -> None:
    """Check on this machine: derivatives, exact solutions, balance. Exit status 1 if one fails."""
    from spinestiff.app.progress import progress

    with progress() as say:
        from spinestiff.app import tables
        from spinestiff.verification.checks import run_checks
        from spinestiff.verification.outcome import summary

        results = run_checks(lambda done: say(f"check: {done.name}"))
    failed = [result for result in results if not result.passed]
    if json:
        tables.show_json([tables.check_record(result) for result in results])
    else:
        if table or failed:
            tables.show(tables.check_table(results if table else failed))
        typer.echo(f"{'FAILED' if failed else 'passed'}: {summary(results)}")
    if failed:
        raise typer.Exit(1)


def phantom(
    folder: Annotated[Path, typer.Argument(help="Folder with phantom.json and corners.csv (docs/bench-phantom.md).")],
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")] = False,
) -> None:
    """Stiffness of a bench phantom by its pictures, beside what was measured. Exit status 1 if they don't agree."""
    from spinestiff.app.phantom import compare_phantom

    status = compare_phantom(folder, json)
    if status:
        raise typer.Exit(status)


def doctor(json: AsJson = False) -> None:
    """Versions, the solver in use, what each extra is for and what is missing."""
    from spinestiff.app import tables
    from spinestiff.app.doctor import doctor_tables, examine

    found = examine()
    if json:
        tables.show_json(found)
        return
    for shown in doctor_tables(found):
        tables.show(shown)
