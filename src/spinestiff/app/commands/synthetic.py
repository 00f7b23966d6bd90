"""``synth`` and ``demo``: subjects of known stiffness."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from spinestiff.app.commands.shared import (
    Acquisition,
    Cobb,
    Curve,
    Height,
    Markers,
    Nodes,
    PushForce,
    Ratios,
    Seed,
    Spine,
    SpineId,
    run_steps_of,
)
from spinestiff.app.findings import print_summary
from spinestiff.app.options import age_limits, among, offering, within
from spinestiff.errors import SubjectError
from spinestiff.formats import plain_number


def synth(
    folder: Annotated[Path, typer.Argument(help="New subject folder; the truth goes beside it.")],
    seed: Seed = 0,
    height: Height = 157.0,
    age: Annotated[float, typer.Option(callback=within("years", age_limits), help="Age, years, 8 to 100.")] = 13.0,
    sex: Annotated[
        str,
        typer.Option(
            callback=among("female", "male"),
            help="female or male.",
            autocompletion=offering("female", "male"),
        ),
    ] = "female",
    cobb: Cobb = None,
    curve: Curve = None,
    force: PushForce = 60.0,
    ratios: Ratios = None,
    spine: Spine = None,
    spine_id: SpineId = None,
    acquisition: Acquisition = "paper",
    nodes: Nodes = None,
    biplanar: Annotated[
        bool, typer.Option("--biplanar", help="Lateral radiographs and marked pedicles in every frame of a push, too.")
    ] = False,
    markers: Markers = None,
) -> None:
    """Make a synthetic subject of known stiffness: DICOM radiographs, force log, annotation."""
    from spinestiff.app.progress import progress
    from spinestiff.study.synthetic.subject import synthesise

    recipe = recipe_of(seed, height, cobb, curve, force, ratios, spine, spine_id, acquisition)
    recipe = replace(recipe, age=age, sex=sex, nodes=nodes, biplanar=biplanar, markers=markers or 0)
    with progress() as say:
        truth = synthesise(folder, recipe, say)
    typer.echo(f"subject: {folder}\ntruth:   {truth}")


def demo(
    out: Annotated[Path, typer.Option(help="Where the synthetic subject goes.")] = Path("spinestiff-demo"),
    seed: Seed = 0,
    height: Height = 157.0,
    cobb: Cobb = None,
    curve: Curve = None,
    force: PushForce = 60.0,
    ratios: Ratios = "0.10,0.04",
    spine: Spine = None,
    spine_id: SpineId = None,
    acquisition: Acquisition = "planned",
) -> None:
    """A synthetic subject from radiographs to report, compared with its truth."""
    from spinestiff.app.progress import progress
    from spinestiff.study.runner import STEPS
    from spinestiff.study.synthetic.subject import made_by, synthesise, truth_path

    recipe = recipe_of(seed, height, cobb, curve, force, ratios, spine, spine_id, acquisition)
    if not made_by(out, recipe):
        with progress() as say:
            synthesise(out, recipe, lambda line: say(f"synth: {line}"))
    print_summary(run_steps_of(out, STEPS, False, truth_path(out), "demo"))


def recipe_of(
    seed: int,
    height: float,
    cobb: float | None,
    curve: str | None,
    force: float,
    ratios: str | None,
    spine: Path | None,
    spine_id: str | None,
    acquisition: str,
) -> Any:
    """The synthetic subject that the options ask for. Raises SubjectError."""
    from spinestiff.study.synthetic.recipe import ACQUISITIONS, Recipe

    if (spine is None) != (spine_id is None):
        raise SubjectError("--spine and --spine-id belong together; give both or none")
    for option, given in {"--cobb": cobb, "--curve": curve}.items():
        if spine is not None and given is not None:
            raise SubjectError(f"{option} {given}: the table of --spine has the rest shape; give one of the two")
    chosen = None
    if ratios is not None:
        found = [plain_number(part) for part in ratios.split(",")]
        if len(found) != 2 or any(map(math.isnan, found)):
            raise SubjectError(f"--ratios {ratios}: wanted two numbers BENDING,TISSUE, e.g. 0.10,0.04")
        chosen = (found[0], found[1])
    real = None if spine is None or spine_id is None else (spine, spine_id)
    if acquisition not in ACQUISITIONS:
        raise SubjectError(f"--acquisition {acquisition}: wanted {' or '.join(ACQUISITIONS)}")
    degrees = Recipe.cobb_deg if cobb is None else cobb
    kind = Recipe.curve if curve is None else curve
    return Recipe(seed, height, degrees, kind, force, chosen, real, ACQUISITIONS[acquisition])
