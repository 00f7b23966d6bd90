"""``run`` and its steps: ``track``, ``response``, ``personalise``, ``estimate``, ``assess``, ``report``."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from spinestiff.app.commands.shared import (
    AsJson,
    Folder,
    Force,
    Mesh,
    Method,
    Orientation,
    Parameters,
    Population,
    Truth,
    names_of,
    run_steps_of,
)
from spinestiff.app.findings import (
    assessment_record,
    estimate_record,
    print_assessment,
    print_estimate,
    print_geometry,
    print_response,
    print_summary,
    print_tracking,
    show_json,
    summary_record,
)
from spinestiff.app.options import offering


def run(
    folder: Folder,
    mesh: Mesh = "fine",
    method: Method = "weighed",
    orientation: Orientation = "procrustes",
    parameters: Parameters = None,
    population: Population = None,
    truth: Truth = None,
    redo: Force = False,
    json: AsJson = False,
) -> None:
    """All steps: track, response, personalise, estimate, assess, report. Only what changed is redone."""
    from spinestiff.study.runner import STEPS

    asked: dict[str, Any] = {"parameters": names_of(parameters), "population": population}
    asked |= {"mesh": mesh, "method": method, "orientation": orientation}
    visit = run_steps_of(folder, STEPS, redo, truth, "run", **asked)
    show_json(summary_record(visit)) if json else print_summary(visit)


def track(folder: Folder, redo: Force = False) -> None:
    """Follow the annotated vertebra corners through every push."""
    print_tracking(run_steps_of(folder, ("track",), redo))


def response(folder: Folder, redo: Force = False) -> None:
    """N per degree of each push, and flexibility: from the corners alone, without a model."""
    from spinestiff.study.judgement.early import motion_doubts

    visit = run_steps_of(folder, ("response",), redo)
    print_response(visit)
    for text in motion_doubts(visit):
        typer.echo(f"doubtful: {text}")


def personalise(folder: Folder, mesh: Mesh = "fine", redo: Force = False) -> None:
    """Shape the torso to the rest radiographs."""
    print_geometry(run_steps_of(folder, ("personalise",), redo, mesh=mesh))


def estimate(
    folder: Folder,
    method: Method = "weighed",
    orientation: Orientation = "procrustes",
    parameters: Parameters = None,
    population: Population = None,
    redo: Force = False,
    json: AsJson = False,
) -> None:
    """Estimate the stiffness ratios from the training frames."""
    asked: dict[str, Any] = {"parameters": names_of(parameters), "population": population}
    visit = run_steps_of(folder, ("estimate",), redo, method=method, orientation=orientation, **asked)
    show_json(estimate_record(visit)) if json else print_estimate(visit)


def assess(folder: Folder, truth: Truth = None, redo: Force = False, json: AsJson = False) -> None:
    """Predict the held-out frames and compare with baselines."""
    visit = run_steps_of(folder, ("assess",), redo, truth=truth)
    show_json(assessment_record(visit)) if json else print_assessment(visit)


def report(
    folder: Folder,
    truth: Truth = None,
    pdf: Annotated[bool, typer.Option("--pdf", help="Print it to results/report.pdf, too, by a browser.")] = False,
    paper: Annotated[
        str, typer.Option(help="Of the PDF: a4 or letter.", autocompletion=offering("a4", "letter"))
    ] = "a4",
    redo: Force = False,
) -> None:
    """Write the report: a first page for the clinician, then all the rest."""
    from spinestiff.study.report.pdf import check_paper, print_report

    check_paper(paper)
    visit = run_steps_of(folder, ("report",), redo, truth=truth)
    typer.echo(f"report: {visit.file('report.html')}")
    if pdf:
        typer.echo(f"pdf: {print_report(visit.file('report.html'), paper)}")
