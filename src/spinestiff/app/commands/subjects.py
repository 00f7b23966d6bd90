"""``init``, ``inspect``, ``annotate``, ``frames``, ``deidentify``: radiographs and what is known of them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from spinestiff.app.annotate import annotate_folder
from spinestiff.app.commands.shared import Folder, at_work
from spinestiff.app.options import (
    among,
    body_mass_limits,
    by_level,
    by_picture,
    distance_limits,
    level_limits,
    offering,
    oldest_limits,
    pixel_limits,
    rate_limits,
    source_limits,
    stature_limits,
    upload_limits,
    within,
)


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
    sex: Annotated[
        str | None,
        typer.Option(
            callback=among("female", "male"), help="female or male.", autocompletion=offering("female", "male")
        ),
    ] = None,
    height: Annotated[
        float | None, typer.Option(callback=within("cm", stature_limits), help="Standing height, cm.")
    ] = None,
    mass: Annotated[
        float | None, typer.Option(callback=within("kg", body_mass_limits, above=True), help="Body mass, kg.")
    ] = None,
    trunk: Annotated[
        list[str] | None,
        typer.Option(
            metavar="LEVEL=BREADTH,DEPTH",
            help="Size of the trunk at the height of a vertebra by tape or caliper, mm, e.g. T9=245,172; may be "
            "repeated.",
        ),
    ] = None,
    side: Annotated[
        str | None,
        typer.Option(
            callback=among("left", "right"),
            help="The patient's side that is pushed: left or right.",
            autocompletion=offering("left", "right"),
        ),
    ] = None,
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
    log_columns: Annotated[
        str | None, typer.Option(help="Names of the logs' columns: TIME,FORCE; with --log-rate FORCE alone will do.")
    ] = None,
    log_units: Annotated[
        str | None, typer.Option(help="Units of the logs: s or ms, then N, kgf or lbf, e.g. s,N.")
    ] = None,
    log_rate: Annotated[
        float | None,
        typer.Option(
            metavar="HZ", callback=within("Hz", rate_limits), help="Entries a second, of logs that have no times."
        ),
    ] = None,
    log_offset: Annotated[
        list[str] | None,
        typer.Option(help="The log's time at the push's first frame, s: SECONDS or PUSH=SECONDS; else it is found."),
    ] = None,
    study: Annotated[str | None, typer.Option(help="Which of several studies, e.g. A1 or A1,A2.")] = None,
    frontal: Annotated[str | None, typer.Option(help="File of the frontal rest radiograph.")] = None,
    lateral: Annotated[str | None, typer.Option(help="File of the lateral rest radiograph.")] = None,
    source_detector: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[PICTURE=]MM",
            help="X-ray source to detector, mm: of all pictures, or of one, e.g. rest/lateral=1500; may be repeated.",
        ),
    ] = None,
    source_patient: Annotated[
        list[str] | None,
        typer.Option(metavar="[PICTURE=]MM", help="X-ray source to patient, mm; of all pictures or of one."),
    ] = None,
    imager_pixel: Annotated[
        list[str] | None,
        typer.Option(metavar="[PICTURE=]MM", help="Pixel at the detector, mm; of all pictures or of one."),
    ] = None,
    orientation: Annotated[
        str | None,
        typer.Option(
            callback=among("standard"),
            help="standard: radiographs without an orientation are shown as usual.",
            autocompletion=offering("standard"),
        ),
    ] = None,
    beam: Annotated[
        str | None,
        typer.Option(
            callback=among("AP", "PA"),
            help="AP or PA: which way the beam goes in frontal radiographs that don't tell.",
            autocompletion=offering("AP", "PA"),
        ),
    ] = None,
    no_questions: Annotated[bool, typer.Option("--no-questions", help="Ask nothing on a terminal.")] = False,
) -> None:
    """Make a subject folder from a hospital's DICOM files; what is not known stays open, and is named."""
    from spinestiff.app.init import Asked, make_subject
    from spinestiff.app.init_logs import LogOptions
    from spinestiff.app.questions import on_terminal
    from spinestiff.subject.intake.making import Given

    person = {"age": age, "sex": sex, "height_cm": height, "mass_kg": mass}
    push = {"side": side, "level": level, "d21_mm": d21, "d31_mm": d31}
    lengths = {
        "source_detector_mm": by_picture("--source-detector", source_detector or (), source_limits),
        "source_patient_mm": by_picture("--source-patient", source_patient or (), source_limits),
        "imager_pixel_mm": by_picture("--imager-pixel", imager_pixel or (), pixel_limits),
    }
    geometry = {**{key: found.pop("", None) for key, found in lengths.items()}, "orientation": orientation}
    geometry["beam"] = beam
    told, of_pushes, of_all = (
        {key: value for key, value in part.items() if value is not None} for part in (person, push, geometry)
    )
    given = Given(told, of_pushes, of_all, lengths, by_level("--trunk", trunk or ()))
    logs = LogOptions(tuple(log or ()), tuple(log_offset or ()), log_columns, log_units, log_rate)
    asked = Asked(given, id, pushes, study, frontal, lateral, logs, not no_questions and on_terminal())
    make_subject(out, sources or [], asked)


def inspect(
    path: Annotated[Path, typer.Argument(help="DICOM file, folder of files, or subject folder.")],
    json: Annotated[bool, typer.Option("--json", help="Print a JSON list instead of text.")] = False,
) -> None:
    """What the reader sees in radiographs: frames, millimetres and where they come from, what a fit lacks."""
    from spinestiff.app.inspect import show_inspection

    show_inspection(path, json)


def annotate(
    folder: Folder,
    port: Annotated[int, typer.Option(min=0, max=65535, help="On 127.0.0.1; 0 is any that is free.")] = 0,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Print the address, open nothing.")] = False,
) -> None:
    """Mark the vertebrae's corners in the browser; every change is saved at once."""
    annotate_folder(folder, port, not no_browser)


def serve(
    root: Annotated[Path, typer.Argument(help="Folder of subject folders; made if it is not there.")] = Path(),
    source: Annotated[
        list[Path] | None, typer.Option(help="Folder on this machine that subjects may be made from; may be repeated.")
    ] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="0 is any that is free.")] = 0,
    host: Annotated[str, typer.Option(help="Address to listen on; others than 127.0.0.1 need --proxy.")] = "127.0.0.1",
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Print the address, open nothing.")] = False,
    read_only: Annotated[bool, typer.Option("--read-only", help="Look at everything, change nothing.")] = False,
    jobs: Annotated[int, typer.Option(min=1, max=64, help="Jobs side by side; of one subject one at a time.")] = 1,
    upload_limit: Annotated[
        float, typer.Option(callback=within("GB", upload_limits, above=True), help="Of one upload, GB.")
    ] = 8.0,
    proxy: Annotated[
        str | None, typer.Option(help="Origin of a reverse proxy that checks who asks (docs/workbench.md).")
    ] = None,
    proxy_secret: Annotated[
        Path | None, typer.Option(help="File with the secret that the proxy adds to each request.")
    ] = None,
) -> None:
    """The workbench: everything from radiographs to report on one page in the browser, on this machine alone."""
    from spinestiff.app.serve import serve_folder

    serve_folder(root, source or [], port, host, not no_browser, read_only, jobs, upload_limit, proxy, proxy_secret)


def frames(
    folder: Folder,
    write: Annotated[bool, typer.Option("--write", help="Put the proposed roles into subject.json.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print a JSON list instead of a table.")] = False,
) -> None:
    """Quality and support motion of every frame, and which to train on; writes a picture strip."""
    from spinestiff.app.frames import select_frames, show_frames
    from spinestiff.app.tables import show_json

    with at_work(folder, "frames", write=write) as (visit, say):
        records = select_frames(visit, say, write)
    if json:
        show_json([frame.model_dump(mode="json") for frame in records])
    else:
        show_frames(records, visit.file("frames.png"), write)


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
