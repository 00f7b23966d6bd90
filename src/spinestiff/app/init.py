"""``spinestiff init``: a subject folder from what a hospital exports; what is not known stays open, and is named."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any

import typer
from rich.markup import escape
from rich.table import Table

from spinestiff.app import questions, tables
from spinestiff.app.progress import progress
from spinestiff.errors import OptionError, RadiographError, SubjectError
from spinestiff.files import write_bytes, write_text
from spinestiff.imaging.dicom.export import Exported
from spinestiff.imaging.radiograph import candidates
from spinestiff.subject.gaps import PERSON, PUSH, Gap, check_open_record, gaps_of
from spinestiff.subject.inspection import inspect
from spinestiff.subject.intake import making
from spinestiff.subject.intake.collecting import Refused, Study, by_name, chosen_studies, collect
from spinestiff.subject.intake.force_log import (
    FORCE_UNITS,
    TIME_UNITS,
    ForceLog,
    find_columns,
    read_force_log,
    with_units,
)
from spinestiff.subject.intake.logged import Logged, at_offset, put_beside
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
WORTH_TELLING_N = 3.0
"""What the prior of a force's offset covers at 95 % (``estimation.priors``)."""


@dataclass(frozen=True)
class Asked:
    """The options of the command.

    Attributes
    ----------
    given : values. identifier : of the subject.
    table : of pushes. study, frontal, lateral : which radiographs.
    logs, offsets : "FILE" or "PUSH=FILE", "SECONDS" or "PUSH=SECONDS". columns, units : of logs, "TIME,FORCE".
    rate_hz : of logs without times, entries a second; with it columns and units may be those of the force alone.
    may_ask : on a terminal.
    """

    given: Given
    identifier: str | None = None
    table: Path | None = None
    study: str | None = None
    frontal: str | None = None
    lateral: str | None = None
    logs: tuple[str, ...] = ()
    offsets: tuple[str, ...] = ()
    columns: str | None = None
    units: str | None = None
    rate_hz: float | None = None
    may_ask: bool = False


@dataclass
class _Work:
    """A subject in the making: its JSON, and the files of its pushes by number."""

    data: dict[str, Any]
    files: Sequence[Sequence[Path]]
    names: Sequence[tuple[str, ...]]
    logged: dict[int, Logged] = field(default_factory=dict)


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
    rest = {"rest/frontal": sorting.frontal, "rest/lateral": sorting.lateral}
    pictures = {image: [one.path] for image, one in rest.items() if one is not None}
    for record, push in zip(data["pushes"], sorting.pushes):
        pictures[f"push/{record['id']}"] = [one.path for one in push.files]
    making.check_geometry({}, data, pictures)
    tables.show(_table(sorting, [push["id"] for push in data["pushes"]], chosen, refused, others))
    told, lines = making.person_of(chosen)
    notes += [line for key, line in lines.items() if key not in asked.given.person]
    making.fill(data, Given({key: value for key, value in told.items() if key not in asked.given.person}))
    notes += _contradictions(told, asked.given)
    files = [[one.path for one in push.files] for push in sorting.pushes]
    work = _Work(data, files, [tuple(one.name for one in push.files) for push in sorting.pushes])
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
    data = making.read_open_data(folder, asked.given, bool(asked.logs))
    before = copy.deepcopy(data)
    notes = making.fill(data, asked.given) + making.fill_images(data, asked.given)
    pushes = data["pushes"]
    places = {**REST_IMAGES, **{f"push/{push['id']}": push["frames"] for push in pushes}}
    there = {image: folder / place for image, place in places.items() if (folder / place).exists()}
    pictures: dict[str, list[Path]] = {}
    for image, path in there.items():
        with suppress(RadiographError):  # a folder without any, as the gaps tell
            pictures[image] = list(candidates(path)) if path.is_dir() else [path]
    making.check_geometry(before, data, pictures)
    work = _Work(data, [[folder / push["frames"]] for push in pushes], [(push["frames"],) for push in pushes])
    _ask_and_log(work, asked, notes, lambda: None)
    making.write_filled(folder, data)
    _finish(folder, work, notes)


def _ask_and_log(work: _Work, asked: Asked, notes: list[str], named: Callable[[], None]) -> None:
    """Read the logs and ask for what is open, in this order: no answer is lost where a log is refused."""
    data = work.data
    logs, offsets = _by_push(asked.logs, work, "--log"), _by_push(asked.offsets, work, "--log-offset")
    if set(offsets) - set(logs):
        raise OptionError("--log-offset: belongs to a --log of the same push; give both")
    for option, given in (
        ("--log-columns", asked.columns),
        ("--log-units", asked.units),
        ("--log-rate", asked.rate_hz),
    ):
        if given is not None and not logs:
            raise OptionError(f"{option}: belongs to a --log; give both")
    said = {number: _read_log(work, number, Path(text), offsets.get(number), asked) for number, text in logs.items()}
    _part_stretches(work, logs, asked.may_ask)
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


def _part_stretches(work: _Work, logs: Mapping[int, str], may_ask: bool) -> None:
    """Two pushes of one log can't lie on the same stretch of it: neither place is known then, but one that is given."""
    given = [number for number, logged in work.logged.items() if logged.placed and logged.match.given]
    for others in (given, list(work.logged)):
        placed = {number: work.logged[number] for number in others if work.logged[number].placed}
        found = [number for number, logged in work.logged.items() if logged.placed and not logged.match.given]
        for number in found:
            one = work.logged[number]
            same = [
                other
                for other, there in placed.items()
                if other != number
                and Path(logs[number]).resolve() == Path(logs[other]).resolve()
                and one.on_the_stretch_of(there)
            ]
            if same:
                _open_again(work, number, same[0], may_ask)


def _open_again(work: _Work, number: int, other: int, may_ask: bool) -> None:
    one, push = work.logged[number], work.data["pushes"][number]
    (first, last), there = one.stretch_s, push_named(work.data["pushes"][other]["id"])
    why = f"it would lie at {first:.1f} to {last:.1f} s of the log, where {there} lies"
    work.logged[number] = replace(one, match=replace(one.match, determined=False, why=why))
    if may_ask:
        work.logged[number] = _ask_offset(work.logged[number], push["id"])
    push["forces_n"] = work.logged[number].forces_n if work.logged[number].placed else [None] * len(push["forces_n"])


def _by_push(texts: Sequence[str], work: _Work, option: str) -> dict[int, str]:
    """Values "VALUE" or "PUSH=VALUE" by the number of the push."""
    found: dict[int, str] = {}
    count = len(work.data["pushes"])
    for text in texts:
        name, equals, value = text.rpartition("=")
        numbers = [i for i in range(count) if not equals or _is_push(name, i, work)]
        if not equals and count != 1:
            known = ", ".join(push["id"] for push in work.data["pushes"])
            many = counted(count, "push", "pushes")
            raise OptionError(f"{option} {text}: found {many} ({known}), wanted one; say which: {option} PUSH={text}")
        if len(numbers) > 1:
            raise OptionError(f"{option} {text}: '{name}' names {len(numbers)} pushes; write more of the file's path")
        if not numbers:
            known = ", ".join(push["id"] for push in work.data["pushes"])
            raise OptionError(f"{option} {text}: no push '{name}'; wanted one of {known}, or the name of its file")
        if numbers[0] in found:
            raise OptionError(
                f"{option}: given twice for {push_named(work.data['pushes'][numbers[0]]['id'])}; wanted once"
            )
        found[numbers[0]] = value
    return found


def _is_push(name: str, number: int, work: _Work) -> bool:
    wanted = PurePosixPath(name.replace("\\", "/")).parts
    inside = (PurePosixPath(file).parts for file in work.names[number])
    return name == work.data["pushes"][number]["id"] or any(
        wanted and (parts[-len(wanted) :] == wanted or parts[:-1][-len(wanted) :] == wanted) for parts in inside
    )


def _read_log(work: _Work, number: int, path: Path, offset: str | None, asked: Asked) -> list[str]:
    """Put a log beside a push and say what was made of the log."""
    push = work.data["pushes"][number]
    if any(force is not None for force in push["forces_n"]):
        again = "" if asked.table is not None else f"; {making.LOG_AGAIN}"
        raise SubjectError(
            f"--log {path}: the forces of {push_named(push['id'])} are known already; leave out either{again}"
        )
    seconds = None if offset is None else _seconds(offset)
    log, words = _log(path, asked)
    with progress() as say:
        say(f"init: the log of {push_named(push['id'])} beside the motion in its frames")
        logged = put_beside(log, work.files[number], push["id"], seconds)
    if not logged.placed and asked.may_ask:
        logged = _ask_offset(logged, push["id"])
    work.logged[number] = logged
    if logged.placed:
        push["forces_n"] = logged.forces_n
    return [words, *log.notes]


def _ask_offset(logged: Logged, name: str) -> Logged:
    def read(text: str) -> Logged:
        try:
            return at_offset(logged, name, questions.number(text, -math.inf, math.inf))
        except SubjectError as problem:
            raise ValueError(str(problem)) from None

    times = logged.log.times_s
    typer.echo(f"{push_named(name)}: where the log begins is not determined: {logged.match.why}", err=True)
    question = f"{push_named(name)}, time of the log at its first frame in s ({times[0]:g} to {times[-1]:g})"
    return questions.asked(question, read) or logged


def _log(path: Path, asked: Asked) -> tuple[ForceLog, str]:
    timed = asked.rate_hz is None
    names = None if asked.columns is None else _pair(asked.columns, "--log-columns", "TIME,FORCE", timed)
    columns = find_columns(path, names, asked.rate_hz)
    if asked.units is not None:
        units = _pair(asked.units, "--log-units", "s,N", timed)
        for unit, known in zip(reversed(units), (FORCE_UNITS, TIME_UNITS)):
            if unit not in known:
                raise OptionError(f"--log-units {asked.units[:40]}: found {unit[:20]!r}, wanted {', '.join(known)}")
        columns = with_units(columns, path, units[0] if timed else None, units[-1])
    elif asked.may_ask:
        time_unit, force_unit = columns.time_unit, columns.force_unit
        if time_unit is None:
            time_unit = _ask_unit(path, columns.time, TIME_UNITS)
        if force_unit is None:
            force_unit = _ask_unit(path, columns.force, FORCE_UNITS)
        columns = with_units(columns, path, time_unit, force_unit)
        if not questions.confirmed(f"{path.name}: {columns.words}; is that right"):
            raise OptionError(
                f"--log {path}: columns and units were not confirmed; say them with --log-columns and --log-units"
            )
    return read_force_log(path, columns), columns.words


def _ask_unit(path: Path, column: str, known: dict[str, float]) -> str | None:
    def read(text: str) -> str:
        if text not in known:
            raise ValueError(f"wanted {' or '.join(known)}")
        return text

    return questions.asked(f"{path.name}: unit of column '{column}', {' or '.join(known)}", read)


def _pair(text: str, option: str, wanted: str, both: bool) -> tuple[str, str] | tuple[str]:
    """Of time and force, or, but for ``both``, of the force alone."""
    parts = [part.strip() for part in text.split(",")]
    if not all(parts) or not (len(parts) == 2 or (len(parts) == 1 and not both)):
        raise OptionError(f"{option} {text[:40]}: wanted {wanted}{'' if both else ' or ' + wanted.partition(',')[2]}")
    return (parts[0], parts[1]) if len(parts) == 2 else (parts[0],)


def _seconds(text: str) -> float:
    if "," in text:
        raise OptionError(f"--log-offset: found {text[:40]!r}, wanted a decimal point, as in 12.5")
    try:
        return questions.number(text, -1e9, 1e9)
    except ValueError as problem:
        raise OptionError(f"--log-offset: {problem}; wanted the log's time at the first frame, s") from None


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


def _finish(out: Path, work: _Work, notes: Sequence[str]) -> None:
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
        for line in _log_lines(name, logged):
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


def _gap_line(gap: Gap, work: _Work) -> str:
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


def _log_lines(name: str, logged: Logged) -> Iterator[str]:
    match = logged.match
    if logged.doubt:
        yield f"log of {push_named(name)}: {logged.doubt}: check the forces"
    for line in logged.untold:
        yield f"log of {push_named(name)}: {line}: left open; the others are filled in"
    if not logged.placed:
        yield (
            f"log of {push_named(name)}: where it begins is not determined: {match.why}; give the log's time at the "
            f"first frame with --log-offset"
        )
        return
    explained = ""
    if math.isfinite(match.explained):
        explained = f"; the force explains {100.0 * max(match.explained, 0.0):.0f} % of the picture's motion"
    if match.given:
        yield f"log of {push_named(name)}: first frame at {match.offset_s:.2f} s of the log, as given{explained}"
        if match.against:
            yield (
                f"  warning: {match.against}; look at the picture, and correct the forces in {SUBJECT_FILE} if the "
                f"offset is wrong ({making.LOG_AGAIN})"
            )
        return
    yield (
        f"log of {push_named(name)}: first frame at {match.offset_s:.2f} s of the log, 95 % {match.low_s:.2f} to "
        f"{match.high_s:.2f} s, found from the motion{explained}, and the offset leaves "
        f"{'another' if match.uncertain else 'a'} frame's force open by at most ± {match.open_n:.1f} N; look at the "
        "picture"
    )
    if match.open_n > WORTH_TELLING_N:
        yield (
            f"  that is more than the usual prior holds; write priors.force_offset_n {0.5 * match.open_n:.1f} into "
            f"{SUBJECT_FILE}"
        )
