"""``view`` and ``cobb``: the torso in 3D, and Cobb angles."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from spinestiff.app.annotate import opened
from spinestiff.app.commands.shared import NoOpen, Page, Replace, TorsoFile, run_steps_of
from spinestiff.app.options import noise_limits, offering, within
from spinestiff.errors import SubjectError


def view(
    folder: Annotated[Path | None, typer.Argument(help="Subject folder (docs/subject-folder.md).")] = None,
    torso: TorsoFile = None,
    out: Page = None,
    force: Replace = False,
    no_open: NoOpen = False,
) -> None:
    """Show the torso in 3D in the browser, from rest to full load, measured against simulated."""
    if (folder is None) == (torso is None):
        raise SubjectError("view shows a subject folder or a --torso file; give one of them")
    page = torso_page(torso, out, force) if torso is not None else visit_page(folder, out, force)
    typer.echo(f"view: {page}")
    if not no_open and not opened(page.resolve().as_uri()):
        typer.echo("no browser was found to open it with; open this file in one")


def cobb(
    path: Annotated[Path, typer.Argument(help="Subject folder, or a file of corners (docs/cobb.md).")],
    definition: Annotated[
        str, typer.Option(help="endplate or midline.", autocompletion=offering("endplate", "midline"))
    ] = "endplate",
    json: Annotated[bool, typer.Option("--json", help="Print a JSON list instead of a table.")] = False,
    noise_px: Annotated[
        float | None,
        typer.Option(
            callback=within("pixels", noise_limits, above=True),
            help="Corner noise (sd), pixels; 2 % of the vertebrae's median width if left out.",
        ),
    ] = None,
    patient_left: Annotated[
        str | None,
        typer.Option(
            help="left or right: where in the image the patient's left is, if the file can't tell.",
            autocompletion=offering("left", "right"),
        ),
    ] = None,
    picture: Annotated[Path | None, typer.Option(help="Draw the spines, end vertebrae and angles (PNG).")] = None,
    table: Annotated[Path | None, typer.Option("--csv", help="Write all curves as a CSV, too.")] = None,
    force: Replace = False,
) -> None:
    """Cobb angles of a subject's rest image and tracked frames, or of a file of vertebra corners."""
    from spinestiff.app.cobb import cobb as run_cobb

    status = run_cobb(path, definition, json, noise_px, patient_left, picture, force, table)
    if status:
        raise typer.Exit(status)


def visit_page(folder: Path | None, out: Path | None, force: bool) -> Path:
    """The page of a visit as far as it has come."""
    from spinestiff.files import write_text
    from spinestiff.study.report.viewer.files import write_rest_view
    from spinestiff.study.visit import Settings, Visit, open_visit
    from spinestiff.subject.folder import read_unannotated
    from spinestiff.subject.output_places import check_output_beside
    from spinestiff.subject.records import ANNOTATION_FILE

    folder = folder or Path()
    bare = None if os.path.lexists(folder / ANNOTATION_FILE) else read_unannotated(folder)
    # The template needs no corners, but what subject.json tells.
    visit = open_visit(folder) if bare is None or bare.gaps else Visit(bare, Settings())
    if out is not None:
        check_output_beside(visit.subject.folder, out, "--out", force=force)
    page = visit.file("view.html")
    if visit.file("estimate.json").exists():
        run_steps_of(visit.subject.folder, ("view",), redo=False)
        if out is None:
            return page
        write_text(out, page.read_text(encoding="utf-8"))
        return out
    typer.echo(write_rest_view(visit, out or page))
    return out or page


def torso_page(torso: Path, out: Path | None, force: bool) -> Path:
    """The page of a torso file."""
    from spinestiff.errors import TorsoError
    from spinestiff.files import regular_file
    from spinestiff.study.report.viewer.files import write_torso_view
    from spinestiff.subject.output_places import check_output_apart

    regular_file(torso, TorsoError)
    page = out or torso.with_suffix(".html")
    check_output_apart(page, "--out", inputs=[torso], force=force)
    write_torso_view(torso, page)
    return page
