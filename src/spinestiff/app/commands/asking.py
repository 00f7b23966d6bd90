"""``plan``, ``parameters``, ``sensitivity``, ``repeat``: what is asked of an estimate that is there."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from spinestiff.app.commands.shared import Folder, Force, RefitMesh, at_work, run_steps_of
from spinestiff.app.options import dose_limits, offering, push_limits, within


def plan(
    folder: Folder,
    target: Annotated[
        str,
        typer.Option(
            help="What is to become narrow: bending, tissue, rotation or cobb.",
            autocompletion=offering("bending", "tissue", "rotation", "cobb"),
        ),
    ] = "bending",
    limit: Annotated[
        float, typer.Option(callback=within("N", push_limits), help="Largest force to propose, N.")
    ] = 80.0,
    exposures: Annotated[
        int | None, typer.Option(min=2, max=40, help="Further radiographs at most, unloaded ones included; default 8.")
    ] = None,
    dose: Annotated[
        float | None,
        typer.Option(
            callback=within("of any unit", dose_limits, above=True),
            help="Dose at most, in place of --exposures; together with --frame-dose.",
        ),
    ] = None,
    frame_dose: Annotated[
        float | None,
        typer.Option(
            callback=within("of any unit", dose_limits, above=True),
            help="Dose of one radiograph, in the unit of --dose.",
        ),
    ] = None,
    lateral_dose: Annotated[
        float | None,
        typer.Option(
            callback=within("of any unit", dose_limits, above=True),
            help="Dose of one lateral radiograph, in the unit of --dose; default that of --frame-dose.",
        ),
    ] = None,
    side: Annotated[
        str,
        typer.Option(help="Where to push: left, right or both.", autocompletion=offering("left", "right", "both")),
    ] = "both",
    ribs: Annotated[str | None, typer.Option(help="Ribs to push, e.g. 5,7,9; default 5 to 10.")] = None,
    views: Annotated[
        str,
        typer.Option(
            help="Radiographs of a pushed state: frontal, frontal+lateral or both (compared).",
            autocompletion=offering("frontal", "frontal+lateral", "both"),
        ),
    ] = "both",
    under: Annotated[
        str | None, typer.Option(help="With --target cobb: the push it is predicted under, SIDE,RIB,FORCE.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print single pushes as a JSON list, the best first.")] = False,
    json_all: Annotated[
        bool, typer.Option("--json-all", help="Print JSON: single pushes, the sequence, its frames and widths.")
    ] = False,
) -> None:
    """Which push to take next, and when further ones no longer pay; writes a picture and a sheet to print."""
    from spinestiff.app.plan import exposures_of, plan_next, plan_record, show_plan, single_pushes, wish_of
    from spinestiff.app.tables import show_json

    budget, lateral_cost = exposures_of(exposures, dose, frame_dose, lateral_dose)
    wish = wish_of(target, limit, budget, side, ribs, under, push_limits()[1], views, lateral_cost)
    with at_work(folder, "plan", **asdict(wish)) as (visit, say):
        found = plan_next(visit, wish, say)
    if json or json_all:
        show_json(plan_record(found) if json_all else single_pushes(found))
    else:
        show_plan(found, visit)


def parameters(
    folder: Folder,
    mesh: RefitMesh = "coarse",
    redo: Force = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> None:
    """What six stiffness parameters do to the spine, the paper's gradients, and two ratios against three."""
    from spinestiff.app.parameters import read_parameters, show_parameters
    from spinestiff.app.tables import show_json

    found = read_parameters(run_steps_of(folder, ("parameters",), redo, mesh=mesh))
    if json:
        show_json(found.model_dump(mode="json"))
    else:
        show_parameters(found)


def sensitivity(
    folder: Folder,
    mesh: RefitMesh = "coarse",
    redo: Force = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> None:
    """Refits with force, push level, corners, mesh, default modulus and geometry changed; writes a picture."""
    from spinestiff.app.sensitivity import read_sensitivity, show_sensitivity
    from spinestiff.app.tables import show_json

    visit = run_steps_of(folder, ("sensitivity",), redo, mesh=mesh)
    found = read_sensitivity(visit)
    if json:
        show_json(found.model_dump(mode="json"))
    else:
        show_sensitivity(found, visit)


def repeat(
    folders: Annotated[list[Path], typer.Argument(metavar="FOLDER...", help="Subject folders, one a visit, in order.")],
    annotators: Annotated[
        bool, typer.Option("--annotators", help="The same radiographs, annotated again, are in the folders.")
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for repeat.json and repeat.png.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """Repeatability over visits or annotators of the same people (same id), and whether somebody changed."""
    from spinestiff.app import tables
    from spinestiff.app.repeat import compare_visits, record_of, show_repeatability

    found = compare_visits(folders, out, annotators)
    if json:
        tables.show_json(record_of(found))
    else:
        show_repeatability(found, out)
