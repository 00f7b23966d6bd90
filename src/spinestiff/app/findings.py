"""What steps found, for people and for programs: responses, estimate, held-out frames."""

from __future__ import annotations

from typing import Any

import typer


def print_tracking(visit: Any) -> None:
    """What came of following the corners, and where to look at them."""
    from spinestiff.study.wording.steps import tracking_lines
    from spinestiff.subject.outcomes import Tracked
    from spinestiff.subject.run_record import read_outcome
    from spinestiff.words import pasted

    for line in tracking_lines(read_outcome(visit.subject, Tracked)):
        typer.echo(line)
    typer.echo(f"to look at them: spinestiff annotate {pasted(visit.subject.folder)}")


def print_geometry(visit: Any) -> None:
    """How well the torso fits the radiographs at rest."""
    from spinestiff.study.wording.steps import geometry_lines
    from spinestiff.subject.geometry_outcome import GeometryRecord
    from spinestiff.subject.run_record import read_outcome

    for line in geometry_lines(read_outcome(visit.subject, GeometryRecord)):
        typer.echo(line)


def print_response(visit: Any) -> None:
    """N per degree and flexibility of each push, without a model."""
    from spinestiff.curves.pushes import push_responses
    from spinestiff.study.wording.steps import response_lines

    typer.echo("Without a model (95 % intervals):")
    for line in response_lines(push_responses(visit.subject)):
        typer.echo(line)


def print_estimate(visit: Any) -> None:
    """What needs no model, then what the data fix best in the model, then each ratio and what it rests on.

    What makes the estimate doubtful stands before all that is the model's.
    """
    from spinestiff.app import tables
    from spinestiff.study.wording.estimate import combination_lines, factor_lines, headline, held_lines, pelvis_lines
    from spinestiff.subject.estimate_outcome import Estimate
    from spinestiff.subject.run_record import read_outcome

    print_response(visit)
    estimate = read_outcome(visit.subject, Estimate)
    for check in estimate.failed:
        typer.echo(f"DOUBTFUL: {check.name}: {check.text}")
    for line in (*combination_lines(estimate), *headline(estimate)):
        typer.echo(line)
    tables.show(tables.estimate_table(estimate))
    for line in (*held_lines(estimate), *factor_lines(estimate)):
        typer.echo(line)
    if estimate.budget:
        tables.show(tables.budget_table(estimate))
    if estimate.prior_changes:
        tables.show(tables.priors_table(estimate))
    for line in pelvis_lines(estimate):
        typer.echo(line)
    if estimate.fit_status != "CONVERGED":
        typer.echo(f"fit: {estimate.fit_status_text}")
    for check in estimate.checks:
        if check.passed is None:
            typer.echo(f"{check.name}: {check.text}")
    for note in estimate.notes:
        typer.echo(f"note: {note}")


def print_assessment(visit: Any) -> None:
    """The held-out frames, and the truth where it is given."""
    from spinestiff.app import tables
    from spinestiff.study.wording.steps import forecast_lines
    from spinestiff.subject.assessment_outcome import Assessment, Comparison
    from spinestiff.subject.run_record import read_outcome

    assessment = read_outcome(visit.subject, Assessment)
    tables.show(tables.assessment_table(assessment.frames))
    for line in forecast_lines(assessment.frames):
        typer.echo(line)
    for note in assessment.notes:
        typer.echo(f"note: {note}")
    inside = read_outcome(visit.subject, Comparison).inside if visit.truth else None
    if inside is not None:
        typer.echo(f"true ratios inside the joint 95 % region: {'yes' if inside else 'no'}")


def print_summary(visit: Any) -> None:
    """All of a run, and where its report lies."""
    print_estimate(visit)
    print_assessment(visit)
    typer.echo(f"report: {visit.file('report.html')}")


def show_json(record: dict[str, Any]) -> None:
    """Print one JSON document."""
    from spinestiff.app import tables

    tables.show_json(record)


def estimate_record(visit: Any) -> dict[str, Any]:
    """The estimate as JSON, as ``results/estimate.json`` has it."""
    from spinestiff.subject.estimate_outcome import Estimate
    from spinestiff.subject.run_record import read_outcome

    found: dict[str, Any] = read_outcome(visit.subject, Estimate).model_dump(mode="json")
    return found


def assessment_record(visit: Any) -> dict[str, Any]:
    """The held-out frames as JSON, as ``results/assessment.json`` has them, with the comparison with a truth."""
    from spinestiff.subject.assessment_outcome import Assessment, Comparison
    from spinestiff.subject.run_record import read_outcome

    found: dict[str, Any] = read_outcome(visit.subject, Assessment).model_dump(mode="json")
    compared = read_outcome(visit.subject, Comparison).model_dump(mode="json") if visit.truth else None
    return {**found, "comparison": compared}


def summary_record(visit: Any) -> dict[str, Any]:
    """All of a run as JSON: what it found, and its files."""
    from spinestiff.subject.outcomes import Responses
    from spinestiff.subject.program import program
    from spinestiff.subject.run_record import read_outcome, recorded_steps

    files = sorted({name for step in recorded_steps(visit.subject).values() for name in step.outputs})
    return {
        "spinestiff": program(),
        "settings": visit.settings.as_record(),
        "response": read_outcome(visit.subject, Responses).model_dump(mode="json"),
        "estimate": estimate_record(visit),
        "assessment": assessment_record(visit),
        "files": [str(visit.subject.folder / name) for name in files],
    }
