"""The force logs that ``spinestiff init`` is given: whose each is, what its columns are, where it begins."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any

import typer

from spinestiff.app import questions
from spinestiff.app.progress import progress
from spinestiff.errors import OptionError, SubjectError
from spinestiff.subject.intake import making
from spinestiff.subject.intake.force_log import (
    FORCE_UNITS,
    TIME_UNITS,
    ForceLog,
    find_columns,
    read_force_log,
    with_units,
)
from spinestiff.subject.intake.logged import Logged, at_offset, put_beside
from spinestiff.subject.records import SUBJECT_FILE
from spinestiff.words import counted, push_named

WORTH_TELLING_N = 3.0
"""What the prior of a force's offset covers at 95 % (``estimation.priors``)."""


@dataclass(frozen=True)
class LogOptions:
    """The options of the command that are about logs.

    Attributes
    ----------
    logs, offsets : "FILE" or "PUSH=FILE", "SECONDS" or "PUSH=SECONDS". columns, units : "TIME,FORCE".
    rate_hz : of logs without times, entries a second; with it columns and units may be those of the force alone.
    """

    logs: tuple[str, ...] = ()
    offsets: tuple[str, ...] = ()
    columns: str | None = None
    units: str | None = None
    rate_hz: float | None = None


@dataclass
class Work:
    """A subject in the making: its JSON, and the files of its pushes by number."""

    data: dict[str, Any]
    files: Sequence[Sequence[Path]]
    names: Sequence[tuple[str, ...]]
    logged: dict[int, Logged] = field(default_factory=dict)


def read_logs(work: Work, options: LogOptions, may_ask: bool, told: bool) -> dict[int, list[str]]:
    """Put each log beside its push and write the forces; what was made of the logs, by the number of the push.

    Parameters
    ----------
    told : forces that are known already come from a table of pushes.

    Raises
    ------
    OptionError, SubjectError : options or logs that don't fit the pushes, or can't be read.
    """
    logs, offsets = _by_push(options.logs, work, "--log"), _by_push(options.offsets, work, "--log-offset")
    if set(offsets) - set(logs):
        raise OptionError("--log-offset: belongs to a --log of the same push; give both")
    for option, given in (
        ("--log-columns", options.columns),
        ("--log-units", options.units),
        ("--log-rate", options.rate_hz),
    ):
        if given is not None and not logs:
            raise OptionError(f"{option}: belongs to a --log; give both")
    said = {}
    for number, path in ((number, Path(text)) for number, text in logs.items()):
        push = work.data["pushes"][number]
        if any(force is not None for force in push["forces_n"]):
            again = "" if told else f"; {making.LOG_AGAIN}"
            raise SubjectError(
                f"--log {path}: the forces of {push_named(push['id'])} are known already; leave out either{again}"
            )
        said[number] = _read_log(work, number, path, offsets.get(number), options, may_ask)
    _part_stretches(work, logs, may_ask)
    return said


def _part_stretches(work: Work, logs: Mapping[int, str], may_ask: bool) -> None:
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


def _open_again(work: Work, number: int, other: int, may_ask: bool) -> None:
    one, push = work.logged[number], work.data["pushes"][number]
    (first, last), there = one.stretch_s, push_named(work.data["pushes"][other]["id"])
    why = f"it would lie at {first:.1f} to {last:.1f} s of the log, where {there} lies"
    work.logged[number] = replace(one, match=replace(one.match, determined=False, why=why))
    if may_ask:
        work.logged[number] = _ask_offset(work.logged[number], push["id"])
    push["forces_n"] = work.logged[number].forces_n if work.logged[number].placed else [None] * len(push["forces_n"])


def _by_push(texts: Sequence[str], work: Work, option: str) -> dict[int, str]:
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


def _is_push(name: str, number: int, work: Work) -> bool:
    wanted = PurePosixPath(name.replace("\\", "/")).parts
    inside = (PurePosixPath(file).parts for file in work.names[number])
    return name == work.data["pushes"][number]["id"] or any(
        wanted and (parts[-len(wanted) :] == wanted or parts[:-1][-len(wanted) :] == wanted) for parts in inside
    )


def _read_log(work: Work, number: int, path: Path, offset: str | None, options: LogOptions, may_ask: bool) -> list[str]:
    """Put a log beside a push and say what was made of the log."""
    push = work.data["pushes"][number]
    seconds = None if offset is None else _seconds(offset)
    log, words = _log(path, options, may_ask)
    with progress() as say:
        say(f"init: the log of {push_named(push['id'])} beside the motion in its frames")
        logged = put_beside(log, work.files[number], push["id"], seconds)
    if not logged.placed and may_ask:
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


def _log(path: Path, options: LogOptions, may_ask: bool) -> tuple[ForceLog, str]:
    timed = options.rate_hz is None
    names = None if options.columns is None else _pair(options.columns, "--log-columns", "TIME,FORCE", timed)
    columns = find_columns(path, names, options.rate_hz)
    if options.units is not None:
        units = _pair(options.units, "--log-units", "s,N", timed)
        for unit, known in zip(reversed(units), (FORCE_UNITS, TIME_UNITS)):
            if unit not in known:
                raise OptionError(f"--log-units {options.units[:40]}: found {unit[:20]!r}, wanted {', '.join(known)}")
        columns = with_units(columns, path, units[0] if timed else None, units[-1])
    elif may_ask:
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


def log_lines(name: str, logged: Logged) -> Iterator[str]:
    """What is to be known of a log that was put beside the push of this name."""
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
