"""``spinestiff torso``: import one's own bones, export a torso for other programs, show what is in one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from spinestiff.app.commands.common import PlainNumbers, common
from spinestiff.app.options import (
    age_limits,
    among,
    height_limits,
    kyphosis_limits,
    lordosis_limits,
    mass_limits,
    offering,
    own_height_limits,
    spacing_limits,
    within,
)
from spinestiff.errors import TorsoError

USUAL_FORMAT = "vtu"

torso = typer.Typer(
    name="torso", help="Torsos of one's own bones, and torsos for other programs.", no_args_is_help=True,
    rich_markup_mode=None,
)  # fmt: skip

TorsoFile = Annotated[
    Path | None, typer.Argument(help="Torso file (torso.npz) or personalised subject folder; the template if left out.")
]
# Of the template alone; what is left out is the usual (docs/anatomy.md).
Height = Annotated[
    float | None,
    typer.Option(callback=within("cm", height_limits), help="Body height of the template, cm; 157 if left out."),
]
Age = Annotated[
    float | None, typer.Option(callback=within("years", age_limits), help="Age of the template, years, 8 to 100.")
]
Sex = Annotated[
    str | None,
    typer.Option(
        callback=among("female", "male"),
        help="Sex of the template: female or male.",
        autocompletion=offering("female", "male"),
    ),
]
Mass = Annotated[float | None, typer.Option(callback=within("kg", mass_limits), help="Body mass of the template, kg.")]
Kyphosis = Annotated[
    float | None,
    typer.Option(
        callback=within("degrees", kyphosis_limits), help="Kyphosis T1 to T12 of the template, degrees, 20 to 50."
    ),
]
Lordosis = Annotated[
    float | None,
    typer.Option(
        callback=within("degrees", lordosis_limits), help="Lordosis L1 to S1 of the template, degrees, 35 to 60."
    ),
]
TemplateMesh = Annotated[
    str | None,
    typer.Option(
        "--mesh",
        help="Mesh of the template: coarse, fine, or own (about 15,000 nodes, made in another way).",
        autocompletion=offering("coarse", "fine", "own"),
    ),
]


@torso.command("import", cls=PlainNumbers)
@common
def import_(
    folder: Annotated[Path, typer.Argument(help="Bone meshes: STL, OBJ, PLY, VTP.")],
    out: Annotated[Path, typer.Option(help="New folder for torso.npz, torso.json and torso.png.")],
    mapping: Annotated[Path | None, typer.Option(help="Which file is which bone (docs/your-own-anatomy.md).")] = None,
    unit: Annotated[
        str | None, typer.Option(help="mm, cm or m; found if left out.", autocompletion=offering("mm", "cm", "m"))
    ] = None,
    axes: Annotated[
        str | None, typer.Option(help="Where the files' x, y, z point, e.g. LPS; found if left out.")
    ] = None,
    skin: Annotated[Path | None, typer.Option(help="Closed skin mesh; generated if left out.")] = None,
    spacing: Annotated[
        float, typer.Option(callback=within("mm", spacing_limits), help="Distance of the tissue mesh's corners, mm.")
    ] = 28.0,
    height: Annotated[
        float | None,
        typer.Option(
            callback=within("cm", own_height_limits), help="Body height, cm; from the spine's length if left out."
        ),
    ] = None,
    mesher: Annotated[str, typer.Option(help="mmg (extra [mesh]), or an installed plug-in's name.")] = "mmg",
) -> None:
    """Make a torso of one's own bone meshes; says unit, axes and repairs, and refuses what it can't trust."""
    from spinestiff.anatomy.importing import import_torso
    from spinestiff.app.progress import progress
    from spinestiff.files import check_whole_folder
    from spinestiff.study.imported import write_imported

    check_whole_folder(out, TorsoError)
    with progress() as say:
        found = import_torso(
            folder, mapping=mapping, unit=unit, axes=axes, skin=skin, spacing_mm=spacing, height_cm=height,
            mesher=mesher, observer=say,
        )  # fmt: skip
        say("write: torso, summary and picture")
        write_imported(found, out)
    typer.echo(f"{found.placement}")
    for line in found.repairs:
        typer.echo(f"repaired: {line}")
    for line in found.notes:
        typer.echo(f"note: {line}")
    tissue = found.tissue
    typer.echo(f"mesh: {tissue.mesher}, smallest dihedral angle {tissue.least_angle_deg:.1f} degrees")
    _show(found.torso)
    typer.echo(f"torso: {out / 'torso.npz'}\nlook:  {out / 'torso.png'}")


@torso.command(cls=PlainNumbers)
@common
def export(
    file: TorsoFile = None,
    kind: Annotated[
        str | None,
        typer.Option(
            "--format",
            help="vtu, glb, osim, mjcf, feb or mrk; by the ending of --out if left out, vtu without --out.",
            autocompletion=offering("vtu", "glb", "osim", "mjcf", "feb", "mrk"),
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="The file to write; torso with the format's ending if left out.")
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace a file that is there; never the torso that is read.")
    ] = False,
    height: Height = None,
    age: Age = None,
    sex: Sex = None,
    mass: Mass = None,
    kyphosis: Kyphosis = None,
    lordosis: Lordosis = None,
    mesh: TemplateMesh = None,
    draws: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Of a subject: the torso with its estimated stiffness, and with so many equally probable ones, into a "
            "new folder --out.",
        ),
    ] = None,
) -> None:
    """Write a torso at rest for another program; says what that format leaves out."""
    if draws is not None:
        sizes = {"height": height, "age": age, "sex": sex, "mass": mass, "kyphosis": kyphosis, "lordosis": lordosis}
        given = [name for name, value in {**sizes, "mesh": mesh, "force": force or None}.items() if value is not None]
        if given:
            raise TorsoError(f"--draws are of a subject's own torso, into a new folder; leave out --{given[0]}")
        _export_drawn(file, kind or USUAL_FORMAT, out, draws)
        return
    from spinestiff.anatomy.export import FORMATS, export_torso
    from spinestiff.subject.output_places import check_output_apart, check_output_beside

    kind = _format(kind, out)
    chosen = FORMATS[kind]
    path = out or Path(f"torso{chosen.suffix}")
    if file is not None and file.is_dir():
        check_output_beside(file, path, "--out", force=force)
    else:
        check_output_apart(path, "--out", inputs=[] if file is None else [file], force=force, error=TorsoError)
    found = _torso(file, height=height, age=age, sex=sex, mass=mass, kyphosis=kyphosis, lordosis=lordosis, mesh=mesh)
    export_torso(found, path, kind)
    typer.echo(f"{path}: for {chosen.purpose}; leaves out or changes: {chosen.leaves_out}")
    if file is not None and file.is_dir() and chosen.has_stiffness:
        typer.echo("note: of default stiffness; --draws 0 with --out, a new folder, writes the estimated one")


def _format(kind: str | None, out: Path | None) -> str:
    """The format that --format and the ending of --out name.

    Raises
    ------
    TorsoError : an unknown format; they name two; neither names one.
    """
    from spinestiff.anatomy.export import FORMATS

    if kind is not None and kind not in FORMATS:
        raise TorsoError(f"unknown format '{kind}'; known are {', '.join(FORMATS)}")
    if out is None:
        return kind or USUAL_FORMAT
    named = [name for name, one in FORMATS.items() if out.name.lower().endswith(one.suffix)]
    if kind is None and not named:
        endings = ", ".join(one.suffix for one in FORMATS.values())
        raise TorsoError(f"--out {out}: its ending names no format; wanted one of {endings}, or --format")
    if kind is not None and named and kind != named[0]:
        raise TorsoError(f"--out {out}: ends as a file of format {named[0]}, and --format is {kind}; which one?")
    return kind or named[0]


def _export_drawn(folder: Path | None, kind: str, out: Path | None, draws: int) -> None:
    from spinestiff.anatomy.export import FORMATS
    from spinestiff.app.progress import progress
    from spinestiff.files import check_whole_folder
    from spinestiff.study.drawn import TABLE, check_format, drawn_ratios, export_drawn
    from spinestiff.study.visit import open_visit
    from spinestiff.subject.output_places import check_output_beside
    from spinestiff.words import counted

    if folder is None or not folder.is_dir() or out is None:
        raise TorsoError("--draws are of a subject's estimate; wanted a subject folder, and --out a new folder")
    check_format(kind)
    check_whole_folder(out, TorsoError)
    check_output_beside(folder, out / TABLE, "--out", force=False)
    with progress() as say:
        found = drawn_ratios(open_visit(folder), draws)
        export_drawn(found, out, kind, say)
    chosen = FORMATS[kind]
    typer.echo(f"{out}: {counted(len(found.ratios), 'torso', 'torsos')} and {TABLE}, for {chosen.purpose}")
    typer.echo(f"leaves out or changes: {chosen.leaves_out}")


@torso.command(cls=PlainNumbers)
@common
def show(
    file: TorsoFile = None,
    height: Height = None,
    age: Age = None,
    sex: Sex = None,
    mass: Mass = None,
    kyphosis: Kyphosis = None,
    lordosis: Lordosis = None,
    mesh: TemplateMesh = None,
) -> None:
    """How many bones, joints and nodes a torso has, and how large it is."""
    _show(_torso(file, height=height, age=age, sex=sex, mass=mass, kyphosis=kyphosis, lordosis=lordosis, mesh=mesh))


def _torso(file: Path | None, **template: Any) -> Any:
    """The torso of a file or of a subject folder, or the template of the given sizes."""
    from spinestiff.anatomy.files import read_torso
    from spinestiff.anatomy.template import template_torso

    given = [name for name, value in template.items() if value is not None]
    if file is None:
        return template_torso(
            157.0 if template["height"] is None else template["height"],
            "coarse" if template["mesh"] is None else template["mesh"],
            age_years=template["age"],
            sex=template["sex"],
            mass_kg=template["mass"],
            kyphosis_deg=template["kyphosis"],
            lordosis_deg=template["lordosis"],
        )
    if given:
        raise TorsoError(f"{file} has a size and a mesh of its own; leave out --{given[0]}")
    return read_torso(_personalised(file) if file.is_dir() else file)


def _personalised(folder: Path) -> Path:
    """The torso file of a subject folder; refused where what it was made from has changed since."""
    from spinestiff.subject.folder import read_subject
    from spinestiff.subject.run_record import result_path, why_stale

    subject = read_subject(folder)
    path = result_path(subject, "torso.npz", "personalise")
    if why := why_stale(subject, "personalise"):
        raise TorsoError(f"{path}: was {why}; run spinestiff personalise again")
    return path


def _show(model: Any) -> None:
    from spinestiff.study.imported import torso_facts

    for name, value in torso_facts(model).items():
        typer.echo(f"{name}: {value}")
