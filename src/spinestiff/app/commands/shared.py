"""What several commands share: options, and steps run with progress."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from spinestiff.app.options import (
    cobb_limits,
    force_limits,
    height_limits,
    marker_limits,
    node_limits,
    offering,
    within,
)
from spinestiff.observer import Observer

Folder = Annotated[Path, typer.Argument(help="Subject folder (docs/subject-folder.md).")]
Force = Annotated[bool, typer.Option("--redo", help="Run even if nothing changed.")]
Mesh = Annotated[
    str,
    typer.Option(
        help="Mesh of the estimate: fine, begun on the coarse one, or coarse alone, a quick look.",
        autocompletion=offering("fine", "coarse"),
    ),
]
Method = Annotated[
    str,
    typer.Option(
        help="weighed (by what is not known) or paper (equal weights, no intervals).",
        autocompletion=offering("weighed", "paper"),
    ),
]
Parameters = Annotated[
    str | None,
    typer.Option(
        help="Ratios to estimate, separated by commas, e.g. lateral_bending@thoracic,lateral_bending@lumbar,tissue "
        "or lateral_bending@levels,tissue (docs/estimation.md). Default: those of subject.json, else "
        "lateral_bending,tissue."
    ),
]
Population = Annotated[
    str | None,
    typer.Option(
        help="Hold other people's bending as a prior: koutras2025, or none. Default: as subject.json says.",
        autocompletion=offering("koutras2025", "none"),
    ),
]
Orientation = Annotated[
    str,
    typer.Option(
        help="Vertebra orientation in the image: procrustes or covariance.",
        autocompletion=offering("procrustes", "covariance"),
    ),
]
Truth = Annotated[Path | None, typer.Option(help="Truth file of a synthetic subject, for comparison only.")]
RefitMesh = Annotated[
    str,
    typer.Option(
        "--mesh",
        help="Mesh of the refits: coarse, or fine, which takes long.",
        autocompletion=offering("coarse", "fine"),
    ),
]
Seed = Annotated[int, typer.Option(help="Of everything random.")]
Height = Annotated[float, typer.Option(callback=within("cm", height_limits), help="Body height, cm.")]
Cobb = Annotated[
    float | None,
    typer.Option(
        callback=within("degrees", cobb_limits),
        help="Rest curve, degrees; above 0 is convex to the left; 12 if left out.",
    ),
]
Curve = Annotated[
    str | None,
    typer.Option(
        help="thoracic, thoracolumbar, lumbar or double; thoracic if left out.",
        autocompletion=offering("thoracic", "thoracolumbar", "lumbar", "double"),
    ),
]
PushForce = Annotated[
    float, typer.Option("--force", callback=within("N", force_limits, above=True), help="Largest push, N.")
]
Ratios = Annotated[str | None, typer.Option(help="True ratios BENDING,TISSUE; drawn by the seed if left out.")]
Spine = Annotated[Path | None, typer.Option(help="Table of real spines, as rest shape instead of --cobb and --curve.")]
Nodes = Annotated[
    int | None,
    typer.Option(
        callback=within("nodes", node_limits),
        help="About how many nodes of a tissue mesh built for this subject alone, by its seed; needs the extra [mesh].",
    ),
]
Markers = Annotated[
    int | None,
    typer.Option(
        callback=within("markers", marker_limits),
        help="So many markers on the skin, seen by cameras in every frame of a push.",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of text.")]
TorsoFile = Annotated[Path | None, typer.Option("--torso", help="A torso file instead of a subject folder.")]
Page = Annotated[Path | None, typer.Option("--out", help="Where the page goes; results/view.html if left out.")]
Replace = Annotated[bool, typer.Option("--force", help="Replace a file that is there; never one that is read.")]
NoOpen = Annotated[bool, typer.Option("--no-open", help="Write the page, don't open it.")]
SpineId = Annotated[str | None, typer.Option(help="Which spine of the table.")]
Acquisition = Annotated[
    str,
    typer.Option(
        help="planned: two ribs far apart, as plans propose; paper: one rib at a third and two thirds of the force.",
        autocompletion=offering("planned", "paper"),
    ),
]


def names_of(given: str | None) -> tuple[str, ...] | None:
    """Names separated by commas."""
    return None if given is None else tuple(name.strip() for name in given.split(","))


def run_steps_of(
    folder: Path, steps: tuple[str, ...], redo: bool, truth: Path | None = None, command: str = "", **settings: Any
) -> Any:
    """Run steps on a subject folder, telling their progress and logging them beside the results; the visit.

    Parameters
    ----------
    command : that asks for them, for the log's name; the last step's if left out.
    """
    with at_work(folder, command or steps[-1], settings, truth, truth=truth is not None, redo=redo) as (visit, say):
        from spinestiff.study.runner import run_steps

        run_steps(visit, steps, say, redo)
    return visit


@contextmanager
def at_work(
    folder: Path, command: str, settings: Mapping[str, Any] | None = None, truth_file: Path | None = None, **asked: Any
) -> Iterator[tuple[Any, Observer]]:
    """The visit of a subject folder that no other command is at, and who takes the lines; logged beside the results.

    Parameters
    ----------
    command : for the log's name. settings : of the visit. asked : what else the log notes.
    """
    from spinestiff.app.progress import progress

    with progress() as say:
        from spinestiff.run_log import run_log
        from spinestiff.study.visit import Settings, open_visit
        from spinestiff.subject.lock import sole_run

        visit = open_visit(folder, Settings(**(settings or {})), truth_file)
        noted = {**visit.settings.as_record(), **asked}
        with sole_run(visit.subject.folder), run_log(visit.subject, command, noted):
            for warning in visit.subject.warnings:
                say(f"warning: {warning}")
            yield visit, say
