"""``cohort``: many subjects."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from spinestiff.app.commands.shared import Mesh, Method, Orientation, Parameters, Population, names_of
from spinestiff.app.options import difference_limits, memory_limits, minute_limits, offering, within


def cohort(
    context: typer.Context,
    source: Annotated[Path, typer.Argument(metavar="IN", help="Folder with participants.tsv and a folder a subject.")],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="Folder for all results; IN is only read.")],
    level: Annotated[
        str | None,
        typer.Argument(
            metavar="[participant|group]",
            help="Run the subjects, or put them together; both if left out.",
            autocompletion=offering("participant", "group"),
        ),
    ] = None,
    mesh: Mesh = "fine",
    method: Method = "weighed",
    orientation: Orientation = "procrustes",
    parameters: Parameters = None,
    population: Population = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, max=4096, help="Subjects side by side; as many as processors if left out.")
    ] = None,
    index: Annotated[
        int | None, typer.Option(help="Only the subject in this row of participants.tsv, from 1 (docs/cohort.md).")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Subjects on the workers of this Dask scheduler, e.g. tcp://host:8786 (extra [cluster]).",
        ),
    ] = None,
    minutes: Annotated[
        float,
        typer.Option(
            callback=within("minutes", minute_limits, above=True), help="Time limit of a subject, wall clock."
        ),
    ] = 240.0,
    memory: Annotated[
        float | None,
        typer.Option(
            callback=within("GB", memory_limits, above=True),
            help="Memory limit of a subject, GB of 1024 MB, on Linux; its share of the machine's if left out.",
        ),
    ] = None,
    difference: Annotated[
        float | None,
        typer.Option(
            callback=within("times", difference_limits, above=True),
            help="How many patients it takes to see stiffness differ by this factor, e.g. 1.5.",
        ),
    ] = None,
) -> None:
    """Many subjects, each in a process of its own, and all of them on one page. Exit status 1 if one fails."""
    from spinestiff.app.cohort import order_of, run_cohort

    asked: dict[str, Any] = {"mesh": mesh, "method": method, "orientation": orientation, "population": population}
    asked["parameters"] = None if parameters is None else list(names_of(parameters) or ())
    sources = (context.get_parameter_source(name) for name in asked)
    usual = all(one is None or one.name == "DEFAULT" for one in sources)
    order = order_of(asked)
    status = run_cohort(source, target, level, order, jobs, index, minutes, memory, difference, usual, scheduler)
    if status:
        raise typer.Exit(status)
