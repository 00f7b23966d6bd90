"""``spinestiff``: from radiographs and a force log to a stiffness report, a verb a step.

Heavy imports stay inside the commands, so that ``--help`` is quick. Exit status: 0 done, 1 a check failed, 2 bad
input, 3 no equilibrium or no estimate.
"""

from __future__ import annotations

import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from spinestiff import __version__
from spinestiff.app import INTERRUPTED, STOPPED
from spinestiff.app.annotate import annotate_folder, opened
from spinestiff.app.options import (
    cobb_limits,
    difference_limits,
    distance_limits,
    dose_limits,
    force_limits,
    height_limits,
    level_limits,
    marker_limits,
    memory_limits,
    minute_limits,
    node_limits,
    noise_limits,
    oldest_limits,
    pixel_limits,
    push_limits,
    source_limits,
    stature_limits,
    within,
)
from spinestiff.app.study import study
from spinestiff.app.torso import torso
from spinestiff.errors import SpinestiffError, SubjectError, SubjectGaps

app = typer.Typer(
    name="spinestiff",
    help="Stiffness of spine and torso, with its uncertainty, from radiographs taken under measured pushes.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

Folder = Annotated[Path, typer.Argument(help="Subject folder (docs/subject-folder.md).")]
Force = Annotated[bool, typer.Option("--redo", help="Run even if nothing changed.")]
Mesh = Annotated[
    str, typer.Option(help="Mesh of the estimate: fine, begun on the coarse one, or coarse alone, a quick look.")
]
Method = Annotated[str, typer.Option(help="weighed (by what is not known) or paper (equal weights, no intervals).")]
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
    typer.Option(help="Hold other people's bending as a prior: koutras2025, or none. Default: as subject.json says."),
]
Orientation = Annotated[str, typer.Option(help="Vertebra orientation in the image: procrustes or covariance.")]
Truth = Annotated[Path | None, typer.Option(help="Truth file of a synthetic subject, for comparison only.")]
RefitMesh = Annotated[str, typer.Option("--mesh", help="Mesh of the refits: coarse, or fine, which takes long.")]
Seed = Annotated[int, typer.Option(help="Of everything random.")]
Height = Annotated[float, typer.Option(callback=within("cm", height_limits), help="Body height, cm.")]
Cobb = Annotated[
    float,
    typer.Option(callback=within("degrees", cobb_limits), help="Rest curve, degrees; above 0 is convex to the left."),
]
Curve = Annotated[str, typer.Option(help="thoracic, thoracolumbar, lumbar or double.")]
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
TorsoFile = Annotated[Path | None, typer.Option("--torso", help="A torso file instead of a subject folder.")]
Page = Annotated[Path | None, typer.Option("--out", help="Where the page goes; results/view.html if left out.")]
Replace = Annotated[bool, typer.Option("--force", help="Replace a file that is there; never one that is read.")]
NoOpen = Annotated[bool, typer.Option("--no-open", help="Write the page, don't open it.")]
SpineId = Annotated[str | None, typer.Option(help="Which spine of the table.")]
Acquisition = Annotated[
    str,
    typer.Option(
        help="planned: two ribs, as spinestiff plan proposes; paper: one rib at a third and two thirds of the force."
    ),
]


app.add_typer(torso, name="torso")
app.add_typer(study, name="study")


def main() -> None:
    """Run the command line; every known failure ends in one line and its exit status."""
    warnings.showwarning = lambda message, *_, **__: _complain(f"warning: {message}")
    try:
        app()
    except SubjectGaps as error:
        for line in error.lines:
            _complain(line)
        sys.exit(error.exit_status)
    except SpinestiffError as error:
        _complain(str(error))
        sys.exit(error.exit_status)
    except SystemExit as end:
        # Typer turns Ctrl-C into this status without a word.
        if end.code == INTERRUPTED:
            _complain(STOPPED)
        raise
    except OSError as error:
        from spinestiff.files import trouble

        if error.filename is None:  # of the output: whoever reads or writes files names them
            raise
        _complain(f"{error.filename}: can't be read or written ({trouble(error)})")
        sys.exit(2)


def _complain(message: str) -> None:
    print("spinestiff: " + " ".join(message.split()), file=sys.stderr)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(__version__)
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


@app.command()
def synth(
    folder: Annotated[Path, typer.Argument(help="New subject folder; the truth goes beside it.")],
    seed: Seed = 0,
    height: Height = 157.0,
    cobb: Cobb = 12.0,
    curve: Curve = "thoracic",
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
    from spinestiff.study.synthetic import synthesise

    recipe = _recipe(seed, height, cobb, curve, force, ratios, spine, spine_id, acquisition)
    recipe = replace(recipe, nodes=nodes, biplanar=biplanar, markers=markers or 0)
    with progress() as say:
        truth = synthesise(folder, recipe, say)
    typer.echo(f"subject: {folder}\ntruth:   {truth}")


@app.command()
def inspect(
    path: Annotated[Path, typer.Argument(help="DICOM file, folder of files, or subject folder.")],
    json: Annotated[bool, typer.Option("--json", help="Print a JSON list instead of text.")] = False,
) -> None:
    """What the reader sees in radiographs: frames, millimetres and where they come from, what a fit lacks."""
    from spinestiff.app.inspect import show_inspection

    show_inspection(path, json)


@app.command()
def init(
    out: Annotated[Path, typer.Argument(help="New subject folder; or one that is not complete, without SOURCE.")],
    sources: Annotated[
        list[Path] | None, typer.Argument(metavar="SOURCE...", help="DICOM files, or folders with some in them.")
    ] = None,
    pushes: Annotated[
        Path | None,
        typer.Option(help="Table, a row a frame: file,frame,force_n,side,level,d21_mm,d31_mm; and perhaps role,push."),
    ] = None,
    id: Annotated[str | None, typer.Option(help="Of the subject; default the folder's name.")] = None,
    age: Annotated[
        float | None, typer.Option(callback=within("years", oldest_limits, above=True), help="Age, years.")
    ] = None,
    sex: Annotated[str | None, typer.Option(help="female or male.")] = None,
    height: Annotated[
        float | None, typer.Option(callback=within("cm", stature_limits), help="Standing height, cm.")
    ] = None,
    side: Annotated[str | None, typer.Option(help="The patient's side that is pushed: left or right.")] = None,
    level: Annotated[
        float | None,
        typer.Option(callback=within("ribs", level_limits), help="Rib that is pushed; 8.5 lies between two."),
    ] = None,
    d21: Annotated[
        float | None, typer.Option(callback=within("mm", distance_limits), help="From shoulder to pelvis support, mm.")
    ] = None,
    d31: Annotated[
        float | None, typer.Option(callback=within("mm", distance_limits), help="From shoulder support to push, mm.")
    ] = None,
    log: Annotated[
        list[str] | None, typer.Option(help="Force log of a push: FILE, or PUSH=FILE where there are several pushes.")
    ] = None,
    log_columns: Annotated[str | None, typer.Option(help="Names of the logs' columns: TIME,FORCE.")] = None,
    log_units: Annotated[
        str | None, typer.Option(help="Units of the logs: s or ms, then N, kgf or lbf, e.g. s,N.")
    ] = None,
    log_offset: Annotated[
        list[str] | None,
        typer.Option(help="The log's time at the push's first frame, s: SECONDS or PUSH=SECONDS; else it is found."),
    ] = None,
    study: Annotated[str | None, typer.Option(help="Which of several studies, e.g. A1 or A1,A2.")] = None,
    frontal: Annotated[str | None, typer.Option(help="File of the frontal rest radiograph.")] = None,
    lateral: Annotated[str | None, typer.Option(help="File of the lateral rest radiograph.")] = None,
    source_detector: Annotated[
        float | None,
        typer.Option(callback=within("mm", source_limits, above=True), help="X-ray source to detector, mm."),
    ] = None,
    source_patient: Annotated[
        float | None,
        typer.Option(callback=within("mm", source_limits, above=True), help="X-ray source to patient, mm."),
    ] = None,
    imager_pixel: Annotated[
        float | None, typer.Option(callback=within("mm", pixel_limits, above=True), help="Pixel at the detector, mm.")
    ] = None,
    orientation: Annotated[
        str | None, typer.Option(help="standard: radiographs without an orientation are shown as usual.")
    ] = None,
    no_questions: Annotated[bool, typer.Option("--no-questions", help="Ask nothing on a terminal.")] = False,
) -> None:
    """Make a subject folder from a hospital's DICOM files; what is not known stays open, and is named."""
    from spinestiff.app.init import Asked, make_subject
    from spinestiff.app.options import one_of
    from spinestiff.app.questions import on_terminal
    from spinestiff.subject.intake.making import Given

    one_of("--sex", sex, "female", "male")
    one_of("--side", side, "left", "right")
    one_of("--orientation", orientation, "standard")
    person = {"age": age, "sex": sex, "height_cm": height}
    push = {"side": side, "level": level, "d21_mm": d21, "d31_mm": d31}
    xray = {"source_detector_mm": source_detector, "source_patient_mm": source_patient}
    geometry = {**xray, "imager_pixel_mm": imager_pixel, "orientation": orientation}
    given = Given(
        *({key: value for key, value in part.items() if value is not None} for part in (person, push, geometry))
    )
    asked = Asked(given, id, pushes, study, frontal, lateral, tuple(log or ()), tuple(log_offset or ()), log_columns,
                  log_units, not no_questions and on_terminal())  # fmt: skip
    make_subject(out, sources or [], asked)


@app.command()
def annotate(
    folder: Folder,
    port: Annotated[int, typer.Option(min=0, max=65535, help="On 127.0.0.1; 0 is any that is free.")] = 0,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Print the address, open nothing.")] = False,
) -> None:
    """Mark the vertebrae's corners in the browser; every change is saved at once."""
    annotate_folder(folder, port, not no_browser)


@app.command()
def track(folder: Folder, redo: Force = False) -> None:
    """Follow the annotated vertebra corners through every push."""
    _steps(folder, ("track",), redo)


@app.command()
def frames(
    folder: Folder,
    write: Annotated[bool, typer.Option("--write", help="Put the proposed roles into subject.json.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print a JSON list instead of a table.")] = False,
) -> None:
    """Quality and support motion of every frame, and which to train on; writes a picture strip."""
    from spinestiff.app.frames import select_frames, show_frames
    from spinestiff.app.progress import progress
    from spinestiff.app.tables import show_json
    from spinestiff.study.visit import open_visit
    from spinestiff.subject.lock import sole_run

    visit = open_visit(folder)
    with sole_run(visit.subject.folder), progress(quiet=json) as say:
        records = select_frames(visit, say, write)
    if json:
        show_json([frame.model_dump(mode="json") for frame in records])
    else:
        show_frames(records, visit.file("frames.png"), write)


@app.command()
def response(folder: Folder, redo: Force = False) -> None:
    """N per degree of each push, and flexibility: from the corners alone, without a model."""
    _print_response(_steps(folder, ("response",), redo))


@app.command()
def personalise(folder: Folder, mesh: Mesh = "fine", redo: Force = False) -> None:
    """Shape the torso to the rest radiographs."""
    _steps(folder, ("personalise",), redo, mesh=mesh)


@app.command()
def estimate(
    folder: Folder,
    method: Method = "weighed",
    orientation: Orientation = "procrustes",
    parameters: Parameters = None,
    population: Population = None,
    redo: Force = False,
) -> None:
    """Estimate the stiffness ratios from the training frames."""
    asked: dict[str, Any] = {"parameters": _names(parameters), "population": population}
    _print_estimate(_steps(folder, ("estimate",), redo, method=method, orientation=orientation, **asked))


@app.command()
def plan(
    folder: Folder,
    target: Annotated[
        str, typer.Option(help="What is to become narrow: bending, tissue, rotation or cobb.")
    ] = "bending",
    limit: Annotated[
        float, typer.Option(callback=within("N", push_limits), help="Largest force to propose, N.")
    ] = 80.0,
    exposures: Annotated[
        int, typer.Option(min=2, max=40, help="Further radiographs at most, unloaded ones included.")
    ] = 8,
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
    side: Annotated[str, typer.Option(help="Where to push: left, right or both.")] = "both",
    ribs: Annotated[str | None, typer.Option(help="Ribs to push, e.g. 5,7,9; default 5 to 10.")] = None,
    views: Annotated[
        str, typer.Option(help="Radiographs of a pushed state: frontal, frontal+lateral or both (compared).")
    ] = "both",
    under: Annotated[
        str | None, typer.Option(help="With --target cobb: the push it is predicted under, SIDE,RIB,FORCE.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print single pushes, best first, as a JSON list.")] = False,
) -> None:
    """Which push to take next, and when further ones no longer pay; writes a picture and a sheet to print."""
    from spinestiff.app.plan import exposures_of, plan_next, show_plan, wish_of
    from spinestiff.app.progress import progress
    from spinestiff.app.tables import show_json
    from spinestiff.study.visit import open_visit
    from spinestiff.subject.lock import sole_run

    budget, lateral_cost = float(exposures), 1.0
    if any(given is not None for given in (dose, frame_dose, lateral_dose)):
        budget, lateral_cost = exposures_of(dose, frame_dose, lateral_dose)
    wish = wish_of(target, limit, budget, side, ribs, under, push_limits()[1], views, lateral_cost)
    visit = open_visit(folder)
    with sole_run(visit.subject.folder), progress(quiet=json) as say:
        found = plan_next(visit, wish, say)
    if json:
        show_json([push.model_dump(mode="json") for push in found.next])
    else:
        show_plan(found, visit)


@app.command()
def parameters(
    folder: Folder,
    mesh: RefitMesh = "coarse",
    redo: Force = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> None:
    """What six stiffness parameters do to the spine, the paper's gradients, and two ratios against three."""
    from spinestiff.app.parameters import read_parameters, show_parameters
    from spinestiff.app.tables import show_json

    found = read_parameters(_steps(folder, ("parameters",), redo, quiet=json, mesh=mesh))
    if json:
        show_json(found.model_dump(mode="json"))
    else:
        show_parameters(found)


@app.command()
def sensitivity(
    folder: Folder,
    mesh: RefitMesh = "coarse",
    redo: Force = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> None:
    """Refits with force, push level, corners, mesh, default modulus and geometry changed; writes a picture."""
    from spinestiff.app.sensitivity import read_sensitivity, show_sensitivity
    from spinestiff.app.tables import show_json

    visit = _steps(folder, ("sensitivity",), redo, quiet=json, mesh=mesh)
    found = read_sensitivity(visit)
    if json:
        show_json(found.model_dump(mode="json"))
    else:
        show_sensitivity(found, visit)


@app.command()
def assess(folder: Folder, truth: Truth = None, redo: Force = False) -> None:
    """Predict the held-out frames and compare with baselines."""
    _assess(_steps(folder, ("assess",), redo, truth=truth))


@app.command()
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


@app.command()
def report(
    folder: Folder,
    truth: Truth = None,
    pdf: Annotated[bool, typer.Option("--pdf", help="Print it to results/report.pdf, too, by a browser.")] = False,
    paper: Annotated[str, typer.Option(help="Of the PDF: a4 or letter.")] = "a4",
    redo: Force = False,
) -> None:
    """Write the report: a first page for the clinician, then all the rest."""
    from spinestiff.study.report.pdf import check_paper, print_report

    check_paper(paper)
    visit = _steps(folder, ("report",), redo, truth=truth)
    typer.echo(f"report: {visit.file('report.html')}")
    if pdf:
        typer.echo(f"pdf: {print_report(visit.file('report.html'), paper)}")


@app.command()
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
    page = _torso_page(torso, out, force) if torso is not None else _visit_page(folder, out, force)
    typer.echo(f"view: {page}")
    if not no_open and not opened(page.resolve().as_uri()):
        typer.echo("no browser was found to open it with; open this file in one")


@app.command()
def run(
    folder: Folder,
    mesh: Mesh = "fine",
    method: Method = "weighed",
    orientation: Orientation = "procrustes",
    parameters: Parameters = None,
    population: Population = None,
    truth: Truth = None,
    redo: Force = False,
) -> None:
    """All steps: track, response, personalise, estimate, assess, report. Only what changed is redone."""
    from spinestiff.study.runner import STEPS

    asked: dict[str, Any] = {"parameters": _names(parameters), "population": population}
    asked |= {"mesh": mesh, "method": method, "orientation": orientation}
    visit = _steps(folder, STEPS, redo, truth, **asked)
    _summary(visit)


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Where the synthetic subject goes.")] = Path("spinestiff-demo"),
    seed: Seed = 0,
    height: Height = 157.0,
    cobb: Cobb = 12.0,
    curve: Curve = "thoracic",
    force: PushForce = 60.0,
    ratios: Ratios = "0.10,0.04",
    spine: Spine = None,
    spine_id: SpineId = None,
    acquisition: Acquisition = "planned",
) -> None:
    """A synthetic subject from radiographs to report, compared with its truth."""
    from spinestiff.app.progress import progress
    from spinestiff.study.runner import STEPS
    from spinestiff.study.synthetic import made_by, synthesise, truth_path

    recipe = _recipe(seed, height, cobb, curve, force, ratios, spine, spine_id, acquisition)
    if not made_by(out, recipe):
        with progress() as say:
            synthesise(out, recipe, lambda line: say(f"synth: {line}"))
    _summary(_steps(out, STEPS, False, truth=truth_path(out)))


@app.command()
def cohort(
    context: typer.Context,
    source: Annotated[Path, typer.Argument(metavar="IN", help="Folder with participants.tsv and a folder a subject.")],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="Folder for all results; IN is only read.")],
    level: Annotated[
        str | None,
        typer.Argument(metavar="[participant|group]", help="Run the subjects, or put them together; both if left out."),
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
            help="Memory limit of a subject, on Linux; its share of the machine's if left out.",
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
    asked["parameters"] = None if parameters is None else list(_names(parameters) or ())
    sources = (context.get_parameter_source(name) for name in asked)
    usual = all(one is None or one.name == "DEFAULT" for one in sources)
    status = run_cohort(source, target, level, order_of(asked), jobs, index, minutes, memory, difference, usual)
    if status:
        raise typer.Exit(status)


@app.command()
def cobb(
    path: Annotated[Path, typer.Argument(help="Subject folder, or a file of corners (docs/cobb.md).")],
    definition: Annotated[str, typer.Option(help="endplate or midline.")] = "endplate",
    json: Annotated[bool, typer.Option("--json", help="Print a JSON list instead of a table.")] = False,
    noise_px: Annotated[
        float | None,
        typer.Option(
            callback=within("pixels", noise_limits, above=True),
            help="Corner noise (sd), pixels; 2 % of the vertebrae's width if left out.",
        ),
    ] = None,
    patient_left: Annotated[
        str | None,
        typer.Option(help="left or right: where in the image the patient's left is, if the file can't tell."),
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


@app.command()
def check(
    json: Annotated[bool, typer.Option("--json", help="Print a JSON list instead of a table.")] = False,
) -> None:
    """Check on this machine: derivatives, exact solutions, balance. Exit status 1 if one fails."""
    from spinestiff.app import tables
    from spinestiff.app.progress import progress
    from spinestiff.verification.checks import run_checks

    with progress(quiet=json) as say:
        results = run_checks(lambda done: say(f"check: {done.name}"))
    if json:
        tables.show_json([tables.check_record(result) for result in results])
    else:
        tables.show(tables.check_table(results))
    if not all(result.passed for result in results):
        raise typer.Exit(1)


@app.command()
def phantom(
    folder: Annotated[Path, typer.Argument(help="Folder with phantom.json and corners.csv (docs/bench-phantom.md).")],
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")] = False,
) -> None:
    """Stiffness of a bench phantom by its pictures, beside what was measured. Exit status 1 if they don't agree."""
    from spinestiff.app.phantom import compare_phantom

    status = compare_phantom(folder, json)
    if status:
        raise typer.Exit(status)


@app.command()
def deidentify(
    source: Annotated[Path, typer.Argument(metavar="IN", help="DICOM file or folder.")],
    out: Annotated[Path, typer.Argument(help="New folder; nothing is overwritten.")],
    key: Annotated[Path | None, typer.Option(help="Key file, for the same pseudonyms again; made if missing.")] = None,
    burned_in_ok: Annotated[bool, typer.Option("--burned-in-ok", help="Burned-in text was looked at.")] = False,
) -> None:
    """Copy radiographs without their patients; says what to look at. Exit status 2 if one is refused."""
    from spinestiff.app.deidentify import deidentify_files
    from spinestiff.app.progress import progress

    with progress() as say:
        lines, refused = deidentify_files(source, out, key, burned_in_ok, say)
    typer.echo("\n".join(lines))
    if refused:
        raise typer.Exit(2)


@app.command()
def doctor() -> None:
    """Versions, the solver in use, and what is missing."""
    from spinestiff.app import tables

    tables.show(tables.doctor_table())


def _recipe(
    seed: int,
    height: float,
    cobb: float,
    curve: str,
    force: float,
    ratios: str | None,
    spine: Path | None,
    spine_id: str | None,
    acquisition: str,
) -> Any:
    from spinestiff.study.synthetic import ACQUISITIONS, Recipe

    if (spine is None) != (spine_id is None):
        raise SubjectError("--spine and --spine-id belong together; give both or none")
    chosen = None
    if ratios is not None:
        try:
            bending, tissue = (float(part) for part in ratios.split(","))
        except ValueError:
            raise SubjectError(f"--ratios {ratios}: wanted two numbers BENDING,TISSUE, e.g. 0.10,0.04") from None
        chosen = (bending, tissue)
    real = None if spine is None or spine_id is None else (spine, spine_id)
    if acquisition not in ACQUISITIONS:
        raise SubjectError(f"--acquisition {acquisition}: wanted {' or '.join(ACQUISITIONS)}")
    return Recipe(seed, height, cobb, curve, force, chosen, real, ACQUISITIONS[acquisition])


def _visit_page(folder: Path | None, out: Path | None, force: bool) -> Path:
    """The page of a visit as far as it has come."""
    from spinestiff.files import write_text
    from spinestiff.study.report.viewer.files import write_rest_view
    from spinestiff.study.visit import open_visit
    from spinestiff.subject.folder import check_output_beside

    visit = open_visit(folder or Path())
    if out is not None:
        check_output_beside(visit.subject.folder, out, "--out", force=force)
    page = visit.file("view.html")
    if visit.file("estimate.json").exists():
        _steps(visit.subject.folder, ("view",), redo=False)
        if out is None:
            return page
        write_text(out, page.read_text(encoding="utf-8"))
        return out
    typer.echo(write_rest_view(visit, out or page))
    return out or page


def _torso_page(torso: Path, out: Path | None, force: bool) -> Path:
    from spinestiff.errors import TorsoError
    from spinestiff.files import check_output, regular_file
    from spinestiff.study.report.viewer.files import write_torso_view

    regular_file(torso, TorsoError)
    page = out or torso.with_suffix(".html")
    check_output(page, "--out", inputs=[torso], force=force)
    write_torso_view(torso, page)
    return page


def _names(given: str | None) -> tuple[str, ...] | None:
    """Names separated by commas."""
    return None if given is None else tuple(name.strip() for name in given.split(","))


def _steps(
    folder: Path, steps: tuple[str, ...], redo: bool, truth: Path | None = None, quiet: bool = False, **settings: Any
) -> Any:
    from spinestiff.app.progress import progress
    from spinestiff.study.runner import run_steps
    from spinestiff.study.visit import Settings, open_visit
    from spinestiff.subject.lock import sole_run

    visit = open_visit(folder, Settings(**settings), truth)
    with sole_run(visit.subject.folder), progress(quiet=quiet) as say:
        for warning in visit.subject.warnings:
            say(f"warning: {warning}")
        run_steps(visit, steps, say, redo)
    return visit


def _assess(visit: Any) -> None:
    from spinestiff.app import tables
    from spinestiff.study.wording import forecast_lines
    from spinestiff.subject.outcomes import Assessment, Comparison
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


def _print_response(visit: Any) -> None:
    from spinestiff.study.wording import response_lines
    from spinestiff.subject.outcomes import Responses
    from spinestiff.subject.run_record import read_outcome

    typer.echo("Without a model (95 % intervals):")
    for line in response_lines(read_outcome(visit.subject, Responses)):
        typer.echo(line)


def _print_estimate(visit: Any) -> None:
    from spinestiff.app import tables
    from spinestiff.study.wording import headline, held_lines, uncertainty_lines
    from spinestiff.subject.outcomes import Estimate
    from spinestiff.subject.run_record import read_outcome

    estimate = read_outcome(visit.subject, Estimate)
    for check in estimate.failed:
        typer.echo(f"DOUBTFUL: {check.name}: {check.text}")
    for line in headline(estimate):
        typer.echo(line)
    tables.show(tables.estimate_table(estimate))
    for line in (*held_lines(estimate), *uncertainty_lines(estimate)):
        typer.echo(line)
    if estimate.fit_status != "CONVERGED":
        typer.echo(f"fit: {estimate.fit_status_text}")
    for check in estimate.checks:
        if check.passed is None:
            typer.echo(f"{check.name}: {check.text}")
    for note in estimate.notes:
        typer.echo(f"note: {note}")


def _summary(visit: Any) -> None:
    _print_response(visit)
    _print_estimate(visit)
    _assess(visit)
    typer.echo(f"report: {visit.file('report.html')}")


if __name__ == "__main__":
    main()
