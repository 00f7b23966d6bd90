"""``spinestiff init``: a subject folder from what a hospital exports; what is not known stays open, and is named."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

import typer
from rich.markup import escape
from rich.table import Table

from spinestiff.app import questions, tables
from spinestiff.app.init_logs import LogOptions, Work, log_lines, read_logs
from spinestiff.app.progress import progress
from spinestiff.errors import OptionError, RadiographError, SubjectError
from spinestiff.files import write_bytes, write_text
from spinestiff.imaging.dicom.export import Exported
from spinestiff.imaging.radiograph import candidates
from spinestiff.subject.gaps import PERSON, PUSH, Gap, check_open_record, gaps_of
from spinestiff.subject.image_names import frame_image
from spinestiff.subject.inspection import inspect
from spinestiff.subject.intake import making
from spinestiff.subject.intake.collecting import Refused, Study, by_name, chosen_studies, collect
from spinestiff.subject.intake.making import Given
from spinestiff.subject.intake.push_table import pushes_of, read_push_table
from spinestiff.subject.intake.sorting import Sorting, sort_files, uses_of
from spinestiff.subject.lock import sole_run
from spinestiff.subject.records import ANNOTATION_FILE, REST_IMAGES, RESULTS, SUBJECT_FILE
from spinestiff.words import counted, pasted, push_named

SHOWN_ALONE = 3
"""Files of a folder that are left out for one reason: more share a row."""
MOST_FORCES_SHOWN = 12
LEFT_OUT = "left out"


@dataclass(frozen=True)
class Asked:
    """The options of the command.

    Attributes
    ----------
    given : values. identifier : of the subject.
    table : of pushes. study, frontal, lateral : which radiographs.
    logs : of the forces. may_ask : on a terminal.
    """

    given: Given
    identifier: str | None = None
    table: Path | None = None
    study: str | None = None
    frontal: str | None = None
    lateral: str | None = None
    logs: LogOptions = field(default_factory=LogOptions)
    may_ask: bool = False


def make_subject(out: Path, sources: Sequence[Path], asked: Asked) -> None:
    """Make a subject folder, or fill what is open in one, and say what was done and what is open still.

    Raises
    ------
    OptionError, SubjectError, RadiographError : see ``subject.intake``; nothing is written then.
    """
    if not sources:
        _fill_folder(out, asked)
        return
    making.check_place(out, sources)
    identifier = making.identifier_of(out, asked.identifier)
    rows = None if asked.table is None else read_push_table(asked.table)
    with progress() as say:
        found, refused = collect(sources, say)
    chosen, others = chosen_studies(found, asked.study)
    table = None if rows is None or asked.table is None else pushes_of(asked.table, rows, chosen, others, refused)
    frontal, lateral = (
        None if name is None else _one(by_name(name, chosen, option, others, refused), option)
        for name, option in ((asked.frontal, "--frontal"), (asked.lateral, "--lateral"))
    )
    sorting = sort_files(chosen, table, frontal, lateral)
    if not sorting.pushes and sorting.frontal is None and sorting.lateral is None:
        tables.show(_table(sorting, [], chosen, refused, others))
        name, why = next(iter(sorting.reasons.items()), (str(sources[0]), "no radiograph was found"))
        raise SubjectError(f"no radiograph becomes part of the subject, and nothing is written; {name}: {why}")
    data = making.subject_data(identifier, sorting)
    notes = making.fill(data, asked.given)
    making.name_pushes(data, sorting)
    notes += making.fill_images(data, asked.given)
    pictures = {image: [one.path] for image, one in sorting.rest.items()}
    for record, push in zip(data["pushes"], sorting.pushes):
        pictures[frame_image(record["id"])] = [one.path for one in push.files]
    making.check_geometry({}, data, pictures)
    tables.show(_table(sorting, [push["id"] for push in data["pushes"]], chosen, refused, others))
    told, lines = making.person_of(chosen)
    notes += [line for key, line in lines.items() if key not in asked.given.person]
    making.fill(data, Given({key: value for key, value in told.items() if key not in asked.given.person}))
    notes += _contradictions(told, asked.given)
    files = [[one.path for one in push.files] for push in sorting.pushes]
    work = Work(data, files, [tuple(one.name for one in push.files) for push in sorting.pushes])
    _ask_and_log(work, asked, notes, lambda: making.name_pushes(data, sorting))
    with progress() as say:
        say("init: copying the radiographs")
        making.make_folder(out, data, sorting)
    _finish(out, work, notes)


def _fill_folder(folder: Path, asked: Asked) -> None:
    """Fill what is open in a subject folder; nothing else changes."""
    for name, given in (("--pushes", asked.table), ("--study", asked.study), ("--frontal", asked.frontal),
                        ("--lateral", asked.lateral), ("--id", asked.identifier)):  # fmt: skip
        if given is not None:
            raise OptionError(f"{name}: belongs to DICOM files; name those to make a subject from, or leave it out")
    with sole_run(folder) if folder.is_dir() else nullcontext():
        _fill(folder, asked)


def _fill(folder: Path, asked: Asked) -> None:
    data = making.read_open_data(folder, asked.given, bool(asked.logs.logs))
    before = copy.deepcopy(data)
    notes = making.fill(data, asked.given) + making.fill_images(data, asked.given)
    pushes = data["pushes"]
    places = {**REST_IMAGES, **{frame_image(push["id"]): push["frames"] for push in pushes}}
    there = {image: folder / place for image, place in places.items() if (folder / place).exists()}
    pictures: dict[str, list[Path]] = {}
    for image, path in there.items():
        with suppress(RadiographError):  # a folder without any, as the gaps tell
            pictures[image] = list(candidates(path)) if path.is_dir() else [path]
    making.check_geometry(before, data, pictures)
    work = Work(data, [[folder / push["frames"]] for push in pushes], [(push["frames"],) for push in pushes])
    _ask_and_log(work, asked, notes, lambda: None)
    making.write_filled(folder, data)
    _finish(folder, work, notes)


def _ask_and_log(work: Work, asked: Asked, notes: list[str], named: Callable[[], None]) -> None:
    """Read the logs and ask for what is open, in this order: no answer is lost where a log is refused."""
    data = work.data
    said = read_logs(work, asked.logs, asked.may_ask, told=asked.table is not None)
    check_open_record(data)
    if asked.may_ask:
        typer.echo("An empty answer leaves a question open.", err=True)
        questions.ask_open(data, PERSON, "")
        for push in data["pushes"]:
            frames = counted(len(push["forces_n"]), "frame")
            questions.ask_open(push, PUSH, f"{push_named(push['id'])} ({frames}), ")
    named()
    names = [push_named(push["id"]) for push in data["pushes"]]
    notes += [f"log of {names[number]}: {line}" for number, lines in said.items() for line in lines]
    if asked.may_ask:
        for push in data["pushes"]:
            questions.ask_forces(push, lambda: check_open_record(data))


def _one(found: Sequence[Exported], option: str) -> Exported:
    if len(found) != 1 or found[0].frames != 1:
        raise OptionError(f"{option}: found {found[0].name} of several frames or files, wanted one rest radiograph")
    return found[0]


def _contradictions(told: dict[str, Any], given: Given) -> Iterator[str]:
    for key, value in told.items():
        mine = given.person.get(key, value)
        if mine != value and (key != "age" or abs(mine - value) > 1.0):
            yield f"{key}: {mine} as given, though the DICOM header tells {value}; check whose radiographs these are"


def _table(
    sorting: Sorting,
    names: Sequence[str],
    chosen: Sequence[Exported],
    refused: Sequence[Refused],
    others: Sequence[Study],
) -> Table:
    """Every file, what it becomes and why; ``names`` are those of the pushes."""
    made = tables.table("Radiographs", "file", "frames", "time s", "becomes", left=("becomes",))

    def add(name: str, frames: str, time: str, use: str, why: str) -> None:
        made.add_row(escape(tables.broken(name)), frames, time, escape(f"{use}: {why}"))

    becomes = uses_of(sorting, names)
    moments = [one.tags.moment for one in chosen if one.tags.moment is not None]
    for one in sorted(chosen, key=lambda one: (one.name not in becomes, one.tags.moment or 0.0, one.name)):
        time = "" if one.tags.moment is None else f"{one.tags.moment - min(moments):.0f}"
        add(one.name, str(one.frames), time, becomes.get(one.name, LEFT_OUT), sorting.reasons[one.name])
    alike: dict[tuple[str, str], list[Refused]] = {}
    for one_ in refused:
        alike.setdefault((PurePosixPath(one_.name).parent.as_posix(), one_.why), []).append(one_)
    for (folder, why), files in alike.items():
        if len(files) > SHOWN_ALONE:
            add(f"{len(files)} files in {folder}", "", "", LEFT_OUT, why)
        else:
            for left in files:
                add(left.name, "", "", LEFT_OUT, why)
    for study in others:
        add(study.words, "", "", LEFT_OUT, "another study than asked for")
    return made


def _finish(out: Path, work: Work, notes: Sequence[str]) -> None:
    from spinestiff.study.report.figures import as_png
    from spinestiff.study.report.log_picture import draw_log

    for note in notes:
        typer.echo(note)
    for number, logged in work.logged.items():
        name = work.data["pushes"][number]["id"]
        place = out / RESULTS / f"force-log-{name}.png"
        picture = draw_log(push_named(name), logged.log, logged.match, logged.times_s, logged.motion)
        write_bytes(place, as_png(picture))
        write_text(place.with_suffix(".csv"), logged.table())
        for line in log_lines(name, logged):
            typer.echo(line)
        typer.echo(f"  picture: {place}\n  table:   {place.with_suffix('.csv')}")
    typer.echo(f"subject: {out}")
    for push in work.data["pushes"]:
        typer.echo(f"  {_push_words(push)}")
    lacking = [f"{SUBJECT_FILE}: {_gap_line(gap, work)}" for gap in gaps_of(work.data)]
    for one in inspect(out):
        if one.image != SUBJECT_FILE:
            lines = [one.reason] if one.reason else one.missing
            lacking += [f"{one.image}: {line}" for line in lines if ANNOTATION_FILE not in line]
            for warning in one.warnings:
                typer.echo(f"note: {one.image}: {warning}")
    if not work.data["pushes"]:
        typer.echo("note: no pushes were found; without one there is a plan (spinestiff plan), and no estimate")
    elif not any("training" in (push.get("roles") or ()) for push in work.data["pushes"]):
        typer.echo(
            f"note: no frame has a role yet; once it is annotated, spinestiff frames {pasted(out)} proposes them, and "
            "--write sets them"
        )
    if lacking:
        typer.echo("open still, to be known before spinestiff run:")
    for line in lacking:
        typer.echo(f"  {line}")
    typer.echo(f"next: spinestiff annotate {pasted(out)}")


def _push_words(push: dict[str, Any]) -> str:
    forces = force_words(push["forces_n"])
    known = {key: push.get(key) for key in PUSH}
    told = {key: "?" if value is None else value if key == "side" else f"{value:g}" for key, value in known.items()}
    return (
        f"{push_named(push['id'])}: {counted(len(push['forces_n']), 'frame')}, from the {told['side']}, "
        f"rib {told['level']}, d21 {told['d21_mm']} mm, d31 {told['d31_mm']} mm, {forces}"
    )


def _gap_line(gap: Gap, work: Work) -> str:
    logged = None if gap.key != "forces_n" or gap.push is None else work.logged.get(gap.push)
    if logged is None:
        return gap.line
    return gap.line_by_hand if logged.placed else gap.line_beside_log


def force_words(forces: Sequence[float | None]) -> str:
    """Forces, one by one if they are few."""
    if len(forces) <= MOST_FORCES_SHOWN:
        return ", ".join("?" if force is None else f"{force:g}" for force in forces) + " N"
    known = [force for force in forces if force is not None]
    if not known:
        return "? N"
    lacking = f", unknown in {counted(len(forces) - len(known), 'frame')}" if len(known) < len(forces) else ""
    return f"{min(known):g} to {max(known):g} N{lacking}"
