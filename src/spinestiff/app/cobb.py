"""``spinestiff cobb``: angles of a subject's images, or of a file of corners; a table, JSON, a picture."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

from spinestiff.app import tables
from spinestiff.errors import SubjectError

if TYPE_CHECKING:
    from spinestiff.curves.cobb import CobbReading, Curve, Definition
    from spinestiff.curves.corner_files import Side
    from spinestiff.curves.pushes import CobbFrame

REFUSED = 2


def cobb(
    path: Path,
    definition: str,
    as_json: bool,
    noise_px: float | None,
    patient_left: str | None,
    picture: Path | None,
    force: bool = False,
    table: Path | None = None,
) -> int:
    """Print the Cobb angles of a folder or file; the exit status: 0, or 2 if no image could be measured.

    Raises
    ------
    SubjectError : an unknown option's value, a noise in pixels of corners in mm, or a folder or file that can't be
        read.
    """
    from spinestiff.subject.output_places import check_output_apart

    chosen = _definition(definition)
    side = _side(patient_left)
    if picture is not None and table is not None and os.path.realpath(picture) == os.path.realpath(table):
        raise SubjectError(f"--picture and --csv are both {table}; name two files")
    # What is neither is looked for as a folder, unless its name ends as a file's of corners does.
    if path.is_file() or path.suffix.lower() in (".csv", ".json"):
        for out, option in ((picture, "--picture"), (table, "--csv")):
            if out is not None:
                check_output_apart(out, option, inputs=[path], force=force)
        return _of_file(path, chosen, as_json, noise_px, side, picture, table)
    if side is not None:
        raise SubjectError("--patient-left is for files of corners; the radiographs of a subject folder tell it")
    return _of_folder(path, chosen, as_json, noise_px, picture, force, table)


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
    folder: Path,
    definition: Definition,
    as_json: bool,
    noise_px: float | None,
    picture: Path | None,
    force: bool,
    table: Path | None,
) -> int:
    from spinestiff.curves.pushes import cobb_frames, cobb_rows, push_responses
    from spinestiff.study.wording.steps import response_lines
    from spinestiff.subject.folder import read_subject
    from spinestiff.subject.output_places import check_output_beside

    subject = read_subject(folder)
    for out, option in ((picture, "--picture"), (table, "--csv")):
        if out is not None:
            check_output_beside(subject.folder, out, option, force=force)
    for warning in subject.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    frames = cobb_frames(subject, definition, noise_px)
    _draw([frame.reading for frame in frames], picture)
    _write(frames, table)
    if as_json:
        tables.show_json([frame.as_dict() for frame in frames])
    else:
        tables.show(tables.cobb_table(cobb_rows(frames)))
        if len(frames) > 1:
            if definition != "endplate":
                print("N per degree and flexibility are by endplates, whatever the table is by")
            for line in response_lines(push_responses(subject, noise_px=noise_px)):
                print(line)
    return 0


def _of_file(
    path: Path,
    definition: Definition,
    as_json: bool,
    noise_px: float | None,
    side: Side | None,
    picture: Path | None,
    table: Path | None,
) -> int:
    from spinestiff.curves.cobb import read_cobb
    from spinestiff.curves.corner_files import ImageCorners, read_corner_file
    from spinestiff.curves.pushes import CobbFrame

    images = read_corner_file(path).images
    for image in images:
        if noise_px is not None and isinstance(image, ImageCorners) and image.unit == "mm":
            raise SubjectError(f"{path}: {image.image}: its corners are in mm, not pixels; leave out --noise-px")
    readings = [read_cobb(image, definition, noise_px, side) for image in images]
    _draw(readings, picture)
    _write([CobbFrame(reading) for reading in readings], table)
    if as_json:
        tables.show_json([reading.as_dict() for reading in readings])
    else:
        tables.show(readings_table(readings, definition))
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


def _write(frames: Sequence[CobbFrame], path: Path | None) -> None:
    if path is None:
        return
    from spinestiff.curves.angle_csv import angles_csv
    from spinestiff.files import write_text

    write_text(path, angles_csv(frames))


def readings_table(readings: Sequence[CobbReading], definition: Definition) -> Table:
    """A row an image: the largest angle, and that of each region; what all have in common stands in the title."""
    from spinestiff.curves.cobb import DEFINITIONS, REGIONS

    columns = ("status", "largest angle", *(name for _, name in REGIONS.values()))
    title = f"Cobb angles ({DEFINITIONS[definition]}), ± half of the 95 % interval, by corner noise"
    if any(_unsided(reading) for reading in readings):
        title += "\nto the left, to the right: the curve's convex side as seen in the image"
    made = tables.table(title, "image", *columns, left=columns)
    for reading in readings:
        if reading.largest is None:
            made.add_row(escape(reading.image), reading.status)
            continue
        regions = ["-" if curve is None else _cell(reading, curve) for curve in reading.by_region().values()]
        made.add_row(
            escape(reading.image), reading.status, *[tables.stacked(cell) for cell in (_largest(reading), *regions)]
        )
    return made


def _unsided(reading: CobbReading) -> bool:
    """Whether a curve's side is known in the image alone."""
    return reading.largest is not None and reading.patient_left is None and reading.largest.angle.convexity != "none"


def _largest(reading: CobbReading) -> str:
    if reading.largest is None or not _unsided(reading):
        return reading.words(by_what=False)
    return _cell(reading, reading.largest, f"to the {'right' if reading.bulges_right(reading.largest) else 'left'}")


def _cell(reading: CobbReading, curve: Curve, further: str = "") -> str:
    return reading.size_words(curve, further or f"apex {curve.apex}")
