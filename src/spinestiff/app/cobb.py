"""``spinestiff cobb``: angles of a subject's images, or of a file of corners; a table, JSON, a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

from spinestiff.app import tables
from spinestiff.errors import SubjectError
from spinestiff.files import check_output

if TYPE_CHECKING:
    from spinestiff.curves.cobb import CobbReading, Curve, Definition
    from spinestiff.curves.corner_files import Side

REFUSED = 2


def cobb(
    path: Path,
    definition: str,
    as_json: bool,
    noise_px: float | None,
    patient_left: str | None,
    picture: Path | None,
    force: bool = False,
) -> int:
    """Print the Cobb angles of a folder or file; the exit status: 0, or 2 if no image could be measured.

    Raises
    ------
    SubjectError : an unknown option's value, or a folder or file that can't be read.
    """
    chosen = _definition(definition)
    side = _side(patient_left)
    # What is neither is looked for as a folder, unless its name ends as a file's of corners does.
    if path.is_file() or path.suffix.lower() in (".csv", ".json"):
        if picture is not None:
            check_output(picture, "--picture", inputs=[path], force=force)
        return _of_file(path, chosen, as_json, noise_px, side, picture)
    if side is not None:
        raise SubjectError("--patient-left is for files of corners; the radiographs of a subject folder tell it")
    return _of_folder(path, chosen, as_json, noise_px, picture, force)


def _definition(name: str) -> Definition:
    from spinestiff.curves.cobb import DEFINITIONS

    for known in DEFINITIONS:
        if name == known:
            return known
    raise SubjectError(f"--definition {name}: wanted {' or '.join(DEFINITIONS)}")


def _side(name: str | None) -> Side | None:
    for known in ("left", "right", None):
        if name == known:
            return known
    raise SubjectError(
        f"--patient-left {name}: wanted left or right, the side of the image where the patient's left is"
    )


def _of_folder(
    folder: Path, definition: Definition, as_json: bool, noise_px: float | None, picture: Path | None, force: bool
) -> int:
    from spinestiff.curves.pushes import cobb_frames, cobb_rows, push_responses
    from spinestiff.study.wording import response_lines
    from spinestiff.subject.folder import check_output_beside, read_subject

    subject = read_subject(folder)
    if picture is not None:
        check_output_beside(subject.folder, picture, "--picture", force=force)
    frames = cobb_frames(subject, definition, noise_px)
    _draw([frame.reading for frame in frames], picture)
    if as_json:
        tables.show_json([frame.as_dict() for frame in frames])
    else:
        tables.show(tables.cobb_table(cobb_rows(frames)))
        if len(frames) > 1:
            for line in response_lines(push_responses(subject)):
                print(line)
    return 0


def _of_file(
    path: Path,
    definition: Definition,
    as_json: bool,
    noise_px: float | None,
    side: Side | None,
    picture: Path | None,
) -> int:
    from spinestiff.curves.cobb import read_cobb
    from spinestiff.curves.corner_files import read_corner_file

    readings = [read_cobb(image, definition, noise_px, side) for image in read_corner_file(path).images]
    _draw(readings, picture)
    if as_json:
        tables.show_json([reading.as_dict() for reading in readings])
    else:
        tables.show(readings_table(readings))
        for reading in readings:
            for warning in reading.warnings:
                word = "refused" if reading.status == "refused" else "warning"
                print(f"{reading.image}: {word}: {warning}")
    return 0 if any(reading.status != "refused" for reading in readings) else REFUSED


def _draw(readings: Sequence[CobbReading], picture: Path | None) -> None:
    if picture is None:
        return
    from spinestiff.study.report.cobb_picture import write_picture

    write_picture(readings, picture)


def readings_table(readings: Sequence[CobbReading]) -> Table:
    """A row an image: the largest angle with its noise and levels, its convexity, and the angle of each region."""
    from spinestiff.curves.cobb import REGIONS

    definition = readings[0].definition
    table = Table(
        title=f"Cobb angles, degrees ({definition} definition; ± 95 % by corner noise)",
        title_justify="left",
        title_style="bold",
    )
    for i, column in enumerate(
        ("image", "status", "largest", "levels", "convexity", *(n for _, n in REGIONS.values()))
    ):
        table.add_column(column, justify="left" if i in (0, 1, 4) else "right")
    for reading in readings:
        largest = reading.largest
        if largest is None:
            table.add_row(escape(reading.image), reading.status)
            continue
        regions = [_cell(curve) for curve in reading.by_region().values()]
        angle = f"{abs(largest.angle.degrees):.1f} ± {largest.half_width_deg:.1f}"
        levels = f"{largest.angle.upper}-{largest.angle.lower}"
        table.add_row(escape(reading.image), reading.status, angle, levels, reading.convexity(largest), *regions)
    return table


def _cell(curve: Curve | None) -> str:
    if curve is None:
        return "-"
    return f"{abs(curve.angle.degrees):.1f} ({curve.angle.upper}-{curve.angle.lower}, apex {curve.apex})"
