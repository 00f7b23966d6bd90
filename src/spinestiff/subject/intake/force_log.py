"""The force log of a gauge: columns and units found in its header, asked for where they are not told, never guessed."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np

from spinestiff.arrays import Floats, read_only
from spinestiff.errors import SubjectError
from spinestiff.files import read_exported_text
from spinestiff.formats import SEPARATORS, decimal_point, plain_number
from spinestiff.subject.records import GAUGE_LIMIT_N
from spinestiff.words import counted, printable

TIME_UNITS = {"s": 1.0, "ms": 1e-3}
FORCE_UNITS = {"N": 1.0, "kgf": 9.80665, "lbf": 4.4482216152605}
"""Factors to s and N (BIPM SI Brochure; the avoirdupois pound under standard gravity)."""
_TIME_WORDS = {"time", "t", "zeit", "temps", "tiempo", "elapsed", "timestamp"}
_FORCE_WORDS = {"force", "f", "load", "kraft", "last", "fuerza"}
_CLOCK_WORDS = {"uhrzeit", "zeitstempel", "heure", "hora"}
_VALUE_WORDS = {"messwert", "reading", "value", "wert", "valeur", "valor"}
"""Of time and of force, where no other column says so (``_by_units``)."""
_UNIT_WORDS = {"unit", "units", "einheit", "unité", "unidad"}
"""Of a column that tells the unit of each value."""
_COUNT_WORDS = {"sample", "samples", "index", "number", "no", "nr", "n", "nummer", "point"}
"""Of a column that numbers the entries."""
_TIME_AT_END = re.compile(
    r"(?i:[\[(]\s*(?:s|secs?|seconds?|ms|msec|milliseconds?)\s*[\])])$|[\s_](?:s|secs?|seconds?|ms|msec|milliseconds?)$"
)
_FORCE_AT_END = re.compile(r"(?i:[\[(]\s*(?:n|newtons?|kgf|kp|lbf)\s*[\])])$|[\s_](?:N|[Nn]ewtons?|kgf|kp|lbf)$")
"""A unit that ends a column's name, in brackets or by itself."""
_TIME_NAMES = {**dict.fromkeys(("s", "sec", "secs", "second", "seconds"), "s"),
               **dict.fromkeys(("ms", "msec", "millisecond", "milliseconds"), "ms")}  # fmt: skip
_FORCE_NAMES = {**dict.fromkeys(("n", "newton", "newtons"), "N"), **dict.fromkeys(("kgf", "kp"), "kgf"), "lbf": "lbf"}
_OTHER_TIMES = {**dict.fromkeys(("min", "mins", "minute", "minutes"), "min"),
                **dict.fromkeys(("h", "hr", "hrs", "hour", "hours"), "h"),
                **dict.fromkeys(("us", "μs", "usec", "microsecond", "microseconds"), "μs"),
                **dict.fromkeys(("ns", "nanosecond", "nanoseconds"), "ns")}  # fmt: skip
_OTHER_FORCES = {"kn": "kN", "dan": "daN", "mn": "mN", "cn": "cN", "gf": "gf", "ozf": "ozf", "dyn": "dyn",
                 **dict.fromkeys(("kg", "kgs", "kilogram", "kilograms"), "kg"),
                 **dict.fromkeys(("g", "gram", "grams"), "g"), **dict.fromkeys(("oz", "ounce", "ounces"), "oz"),
                 **dict.fromkeys(("lb", "lbs", "pound", "pounds"), "lb")}  # fmt: skip
"""Units that are known in order to refuse a log in them by name. Of a gauge that weighs, kg and lb
may be kgf and lbf; that is for the user to say.
"""
LAST_HEADER = 60
"""Lines within which the header has to be: gauges write some of their own above it."""
NUMBERS_BELOW = 2
"""Lines below a header in one of which its first numbers have to stand."""
MOST_ROWS = 1_000_000
_CLOCK = re.compile(
    r"(?:.*[\sT])?(?P<h>\d{1,2}):(?P<m>[0-5]\d):(?P<s>[0-5]\d)(?:(?:[.,]|:(?=\d{3}\b))(?P<part>\d+))?\s*(?P<half>[AP]M)?Z?",
    re.IGNORECASE,
)
"""A time of day, with a date before it or none: 14:03:22, 2:03:22.5 PM, 2026-03-03T14:03:22,500, 14:03:22:500."""
_MINUTES = re.compile(r"(?P<m>[0-5]?\d):(?P<s>[0-5]\d)[.,](?P<part>\d+)")
"""Minutes and seconds, 03:22.5, as spreadsheets save times of day; without parts of a second they may be hours."""
DAY_S, HOUR_S = 86400.0, 3600.0
NOTHING_N = 0.5
NEVER_BELOW_N = 2.0  # from where on a log without a force below it is told of
"""Forces below count as none: what a hand-held gauge shows in the air."""
BESIDE_S, BESIDE_STEPS = 0.1, 2.0
"""So far, or so many of a log's steps, beyond its ends it still tells a force."""
GAP_S, GAP_STEPS = 0.5, 10.0
"""Entries farther apart than both leave a gap, of which a log tells a force only if it is the same on both sides."""
SAME_N = 2.0
"""Forces that differ by less are the same on both sides of a gap."""
NO_TIMES = ", or, if the log has no times but a steady rate, give --log-rate HZ"
RATES_HZ = (0.1, 100_000.0)
"""Entries a second that a log may have."""


@dataclass(frozen=True)
class LogColumns:
    """Where a log has time and force.

    Attributes
    ----------
    time, force : names of the columns. time_unit, force_unit : of ``TIME_UNITS`` and ``FORCE_UNITS``; None if not told.
    header : line of the header, from 1. at : positions of both columns. separator : of fields.
    first : line of the first row of numbers. fields : in the header. clock : times are times of day.
    rate_hz : entries a second, of a log without times: column ``time`` numbers them, or, if it is "", their order does.
    unit_at : position of a column with the unit of each force; None: there is none, or it is not needed.
    """

    time: str
    force: str
    time_unit: str | None
    force_unit: str | None
    header: int
    at: tuple[int, int]
    separator: str
    first: int
    fields: int
    clock: bool = False
    rate_hz: float | None = None
    unit_at: int | None = None

    @property
    def words(self) -> str:
        """What was found."""
        time, force = (unit or "unit not told" for unit in (self.time_unit, self.force_unit))
        time = f"time in column {_shown(self.time)} ({'times of day' if self.clock else time})"
        if self.rate_hz is not None:
            count = f"numbered in column {_shown(self.time)}, " if self.time else ""
            time = f"entries {count}{self.rate_hz:g} a second"
        return f"{time}, force in column {_shown(self.force)} ({force})"


@dataclass(frozen=True)
class ForceLog:
    """A log: times (N,), s, growing, and forces (N,), N, not negative; ``notes``: what was made of it, a line each."""

    times_s: Floats
    forces_n: Floats
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "times_s", read_only("times_s", self.times_s, np.shape(self.times_s), SubjectError))
        object.__setattr__(self, "forces_n", read_only("forces_n", self.forces_n, self.times_s.shape, SubjectError))

    @property
    def step_s(self) -> float:
        """Between two entries, the median."""
        return float(np.median(np.diff(self.times_s)))

    def at(self, times_s: Floats) -> Floats:
        """Forces at times of the log, between its entries along straight lines, beyond its ends those of the ends."""
        forces: Floats = np.interp(times_s, self.times_s, self.forces_n)
        return np.where(forces < NOTHING_N, 0.0, forces)

    def told(self, times_s: Floats) -> Floats:
        """As ``at``, but NaN where no entry tells a force: beyond an end at which there is one, and in a gap between
        different ones.
        """
        beside, gap = max(BESIDE_S, BESIDE_STEPS * self.step_s), max(GAP_S, GAP_STEPS * self.step_s)
        after = np.searchsorted(self.times_s, times_s)
        low, high = (np.clip(i, 0, len(self.times_s) - 1) for i in (after - 1, after))
        since, until = times_s - self.times_s[low], self.times_s[high] - times_s
        inside = (after > 0) & (after < len(self.times_s))
        far = np.where(inside, since + until > gap, True) & (np.abs(since) > beside) & (np.abs(until) > beside)
        differ = np.abs(self.forces_n[high] - self.forces_n[low]) >= SAME_N
        untold = far & np.where(inside, differ, self.forces_n[low] >= NOTHING_N)
        return np.where(untold, np.nan, self.at(times_s))


def find_columns(path: Path, names: tuple[str, ...] | None = None, rate_hz: float | None = None) -> LogColumns:
    """The columns of time and force in a log.

    Parameters
    ----------
    names : of both columns, where the header does not tell or has several; with ``rate_hz`` of the entries' numbers and
        of the force, or of the force alone.
    rate_hz : entries a second, of a log without times.

    Raises
    ------
    SubjectError : no header with a column of time (but with ``rate_hz``) and one of force, or several; a unit that is
        not read.
    """
    lines = read_exported_text(path).splitlines()
    if rate_hz is not None:
        return _untimed(path, lines, names, rate_hz)
    odd = ""
    for way in (_by_words, _by_units) if names is None else (_by_names(names),):
        found = _header(path, lines, way)
        if found.at is not None:
            return _with_units(path, lines, found)
        odd = odd or found.odd
    if odd:
        raise SubjectError(
            f"{path}: {odd}, wanted numbers of time (or a time of day, h:mm:ss) and force in one of the two lines "
            "below it"
        )
    wanted = "columns of time and force" if names is None else f"columns '{names[0]}' and '{names[-1]}'"
    raise _no_header(path, lines, wanted, "TIME,FORCE")


def _untimed(path: Path, lines: list[str], names: tuple[str, ...] | None, rate_hz: float) -> LogColumns:
    """The columns of a log whose entries follow each other at a rate."""
    for way in (_by_words, _by_units) if names is None else ():
        header = _header(path, lines, way)
        timed = None if header.at is None else _with_units(path, lines, header)
        # Times of day of whole seconds tell the entries of one second not apart.
        if timed is not None and not timed.clock:
            raise SubjectError(f"{path}: column {_shown(timed.time)} has times; leave out --log-rate for this log")
    if names is not None and len(names) == 2 and _says(_tokens(names[0]), "time"):
        raise SubjectError(f"{path}: column {_shown(names[0])} has times; leave out --log-rate for this log")
    found = _header(path, lines, _counted if names is None else _by_names(names), timed=False)
    if found.at is not None:
        return _with_units(path, lines, found, rate_hz)
    if found.odd:
        raise SubjectError(f"{path}: {found.odd}, wanted numbers of force in one of the two lines below it")
    wanted = "a column of force"
    if names is not None:
        wanted = f"column{'s' if len(names) > 1 else ''} {' and '.join(_shown(name) for name in names)}"
    raise _no_header(path, lines, wanted, "FORCE")


def _no_header(path: Path, lines: list[str], wanted: str, columns: str) -> SubjectError:
    """That there is no such header."""
    untold = columns != "FORCE" and any(_counted([line.strip()])[1] for line in lines[:LAST_HEADER])
    for line in lines[:LAST_HEADER]:
        for separator in SEPARATORS:
            cells = _cells(line, separator)
            if len(cells) > 1 and not all(_number(cell, separator) is not None for cell in cells):
                untold = untold or (columns != "FORCE" and bool(_counted(cells)[1]))
                return SubjectError(
                    f"{path}: found the header {_shown(line)}, wanted {wanted}; name them as it does with "
                    f"--log-columns {columns}{NO_TIMES if untold else ''}"
                )
    return SubjectError(
        f"{path}: found no header of fields between commas, semicolons or tabs, wanted {wanted}; write a line such "
        f"as time_s,force_N above the numbers, with the log's own units{NO_TIMES if untold else ''}"
    )


@dataclass(frozen=True)
class _Header:
    """A header's line, from 0, cells, separator, and positions of time (or number; -1: none) and force; ``at`` None:
    none was found, and ``odd`` says what is wrong with one that has such columns, "" if there is none."""

    number: int = 0
    cells: tuple[str, ...] = ()
    separator: str = ""
    at: tuple[int, int] | None = None
    odd: str = ""


_Way = Callable[[Sequence[str]], tuple[list[int], list[int]]]


def _header(path: Path, lines: list[str], way: _Way, timed: bool = True, places: range = range(LAST_HEADER)) -> _Header:
    """The first line among ``places`` with the columns that ``way`` finds and numbers below; but for ``timed`` that of
    force is enough.

    Without times a line of one number above the header may look like one: one below which another stands is none.

    Raises
    ------
    SubjectError : several such columns.
    """
    odd = ""
    for number in places[: max(0, len(lines) - places.start)]:
        line = lines[number]
        # The force may be the only column of a log without times.
        fewest = 1 if not timed and all(len(_cells(line, separator)) == 1 for separator in SEPARATORS) else 2
        for separator in SEPARATORS:
            cells = tuple(_cells(line, separator))
            if len(cells) < fewest or all(_number(cell, separator) is not None for cell in cells):
                continue
            times, forces = way(cells)
            if not forces or (timed and not times):
                continue
            if not _numbers_follow(lines[number + 1 :], times, forces, separator):
                below = next((one for one in lines[number + 1 :] if one.strip(separator + " \t")), "")
                under = f"and below it {_shown(below)}" if below else "and nothing below it"
                odd = odd or f"line {number + 1}: found the header {_shown(line)} {under}"
                continue
            soon = range(number + 1, number + 1 + NUMBERS_BELOW)
            if not timed and _header(path, lines, way, timed, soon).at is not None:
                continue
            if len(times) > 1 or len(forces) > 1:
                what, which = ("force", forces) if len(forces) > 1 else ("time" if timed else "numbers", times)
                raise SubjectError(
                    f"{path}: line {number + 1}: several columns of {what}: "
                    f"{', '.join(_shown(cells[i]) for i in which)}; give --log-columns "
                    f"{'TIME,FORCE' if timed else 'FORCE, or NUMBER,FORCE'}"
                )
            return _Header(number, cells, separator, (times[0] if times else -1, forces[0]))
    return _Header(odd=odd)


def _numbers_follow(below: Sequence[str], times: list[int], forces: list[int], separator: str) -> bool:
    """Whether one of the next two lines has numbers of time, if there is one, and force; one may hold the units."""
    full = (line for line in below if line.strip(separator + " \t"))
    for line in islice(full, NUMBERS_BELOW):
        cells = dict(enumerate(_cells(line, separator)))
        if (not times or any(_time(cells.get(i, ""), separator) is not None for i in times)) and any(
            _number(cells.get(i, ""), separator) is not None for i in forces
        ):
            return True
    return False


def _with_units(path: Path, lines: list[str], header: _Header, rate_hz: float | None = None) -> LogColumns:
    number, cells, separator = header.number, header.cells, header.separator
    assert header.at is not None
    at = header.at
    units: list[str | None] = []
    first = number + 1
    below = _cells(lines[first], separator) if first < len(lines) else []
    # Some gauges write the units in a line of their own.
    if rate_hz is None:
        has_row = (
            len(below) > max(at) and _time(below[at[0]], separator) is None and _number(below[at[1]], separator) is None
        )
    else:
        words = _tokens(below[at[1]]) if len(below) > at[1] else []
        has_row = bool(words) and all(word in {**_FORCE_NAMES, **_OTHER_FORCES} for word in words)
    first += 1 + has_row
    entries = (_cells(line, separator) for line in lines[first - 1 :])
    entry = next((one for one in entries if len(one) > max(at)), None)
    clock = rate_hz is None and entry is not None and _clock(entry[at[0]]) is not None
    for i, known, others in zip(at, (_TIME_NAMES, _FORCE_NAMES), (_OTHER_TIMES, _OTHER_FORCES)):
        words = _tokens(cells[i]) + (_tokens(below[i]) if has_row else [])
        names = {**known, **others}
        if known is _TIME_NAMES and (clock or rate_hz is not None):
            # "h:mm:ss" in a header names no unit, and numbers of entries have none.
            units.append("s")
            continue
        told = {names[word] for word in words[1 if len(words) > 1 and words[0] in ("t", "f") else 0 :] if word in names}
        if len(told) > 1:
            raise SubjectError(f"{path}: line {number + 1}: column {_shown(cells[i])} names several units; rename it")
        unit = told.pop() if told else None
        what, other = ("time", "force") if known is _TIME_NAMES else ("force", "time")
        if unit is None and _says(words, other) and not _says(words, what):
            raise SubjectError(
                f"{path}: line {number + 1}: column {_shown(cells[i])} is one of {other}, wanted {what}; --log-columns "
                "names time first, then force"
            )
        if unit in others.values():
            wanted = "s or ms" if known is _TIME_NAMES else "N, kgf or lbf"
            raise SubjectError(
                f"{path}: line {number + 1}: column {_shown(cells[i])} is in {unit}; convert it to {wanted}, and write "
                "that in the header"
            )
        units.append(unit)
    unit_at = _unit_column(cells, at[1]) if units[1] is None and entry is not None else None
    if unit_at is not None and entry is not None:
        in_column = {name for word in _tokens(entry[unit_at]) if (name := {**_FORCE_NAMES, **_OTHER_FORCES}.get(word))}
        strange = in_column & set(_OTHER_FORCES.values())
        if strange:
            raise SubjectError(
                f"{path}: column {_shown(cells[unit_at])} says {strange.pop()}; convert the forces to N, kgf or lbf, "
                "and write that there"
            )
        units[1] = in_column.pop() if len(in_column) == 1 else None
        unit_at = unit_at if units[1] is not None else None
    count = cells[at[0]] if at[0] >= 0 else ""
    return LogColumns(
        count, cells[at[1]], units[0], units[1], number + 1, at, separator, first, len(cells), clock, rate_hz, unit_at
    )


def with_units(columns: LogColumns, path: Path, time_unit: str | None, force_unit: str | None) -> LogColumns:
    """Columns with units as the user gives them; None: as the header tells.

    Raises
    ------
    SubjectError : a unit that the header contradicts.
    """
    time_unit = time_unit if columns.rate_hz is None else None
    for given, told, name in ((time_unit, columns.time_unit, columns.time),
                              (force_unit, columns.force_unit, columns.force)):  # fmt: skip
        if given is not None and told is not None and given != told:
            raise SubjectError(f"{path}: column {_shown(name)} is in {told}, but {given} was given; correct either")
    return replace(columns, time_unit=columns.time_unit or time_unit, force_unit=columns.force_unit or force_unit)


def read_force_log(path: Path, columns: LogColumns) -> ForceLog:
    """The log's numbers.

    Raises
    ------
    SubjectError : a unit that is not known, a row without numbers or with more than the header has, times that do not
        grow, fewer than two rows, forces of both signs or beyond the gauge's limit.

    Times of day become seconds from the first entry on; midnight may come between, and a full hour where they tell
    minutes and seconds alone.
    """
    if columns.time_unit is None:
        raise SubjectError(
            f"{path}: column {_shown(columns.time)} tells no unit; give --log-units s,N (or ms; kgf, lbf)"
        )
    if columns.force_unit is None:
        raise SubjectError(
            f"{path}: column {_shown(columns.force)} tells no unit; give --log-units s,N (or s,kgf or s,lbf)"
        )
    rows: list[tuple[int, float, float]] = []
    period = HOUR_S
    lines = read_exported_text(path).splitlines()
    for number, line in enumerate(lines[columns.first - 1 :], columns.first):
        if not line.strip(columns.separator + " \t"):
            continue
        cells = _cells(line, columns.separator)
        if columns.separator == "," and len(cells) > columns.fields and any(cells[columns.fields :]):
            raise SubjectError(
                f"{path}: line {number}: {len(cells)} fields, wanted {columns.fields} as in the header; numbers with "
                "decimal commas need semicolons between the fields"
            )
        when, much = (cells[i] if 0 <= i < len(cells) else "" for i in columns.at)
        time = _clock(when) if columns.clock else _number(when, columns.separator)
        if columns.at[0] < 0:
            time = float(len(rows))
        force = _number(much, columns.separator)
        if columns.unit_at is not None and columns.unit_at < len(cells):
            _check_unit(path, number, cells[columns.unit_at], columns.force_unit)
        if columns.rate_hz is not None and _fields(line, columns) > columns.fields:
            raise SubjectError(
                f"{path}: line {number}: found {_shown(line)}, wanted {counted(columns.fields, 'field')} as in the "
                f"header, line {columns.header}"
            )
        if time is None or force is None:
            wanted = "a time of day and a force" if columns.clock else "numbers of time and force"
            if columns.rate_hz is not None:
                wanted = "numbers of entry and force" if columns.time else "a number of force"
            raise SubjectError(
                f"{path}: line {number}: found {_shown(line)}, wanted {wanted}; take the line out if it is no entry"
            )
        rows.append((number, time, force))
        period = period if _MINUTES.fullmatch(when) else DAY_S
        if len(rows) > MOST_ROWS:
            raise SubjectError(f"{path}: more than {MOST_ROWS} rows; cut the log to the push")
    if len(rows) < 2:
        raise SubjectError(f"{path}: found {len(rows)} rows of numbers, wanted 2 or more")
    step = TIME_UNITS[columns.time_unit] if columns.rate_hz is None else 1.0 / columns.rate_hz
    times = step * np.array([row[1] for row in rows])
    forces = FORCE_UNITS[columns.force_unit] * np.array([row[2] for row in rows])
    notes = []
    if columns.clock:
        began = _cells(lines[rows[0][0] - 1], columns.separator)[columns.at[0]]
        notes.append(f"times of day: the log's seconds count from its first entry, {began[:40]}")
        # Once a day the clock falls by nearly a day, once an hour one of minutes alone by nearly an hour.
        times = times - times[0] + period * np.cumsum(np.diff(times, prepend=times[0]) < -0.5 * period)
        far = np.flatnonzero(np.diff(times) > 0.5 * period)
        if period == HOUR_S and len(far):
            raise SubjectError(
                f"{path}: line {rows[far[0] + 1][0]}: more than half an hour after the entry before, or before it; "
                "wanted times with their hours"
            )
        if times.max() > 0.5 * DAY_S:
            raise SubjectError(f"{path}: the times of day span more than half a day; wanted one log, in order of time")
    backwards = np.flatnonzero(np.diff(times) <= 0.0)
    if len(backwards):
        number = rows[backwards[0] + 1][0]
        same = columns.clock and times[backwards[0] + 1] == times[backwards[0]]
        wanted = (
            "export it with parts of a second, or give --log-rate HZ" if same else "wanted one log, in order of time"
        )
        if columns.rate_hz is not None:
            column = _shown(columns.time)
            raise SubjectError(
                f"{path}: line {number}: the numbers of column {column} do not grow; if it does not number the "
                "entries, give --log-columns FORCE"
            )
        raise SubjectError(f"{path}: line {number}: the time does not grow; {wanted}")
    return _magnitudes(path, times, forces, notes)


def _fields(line: str, columns: LogColumns) -> int:
    """Of an entry that are not empty; of a header without a separator, between any but commas, which may be decimal."""
    separators = tuple(one for one in SEPARATORS if one != ",") if columns.fields == 1 else (columns.separator,)
    return max(sum(map(bool, _cells(line, separator))) for separator in separators)


def _check_unit(path: Path, line: int, cell: str, wanted: str) -> None:
    """Raise SubjectError for an entry in another unit than the first."""
    if cell and {_FORCE_NAMES.get(word) for word in _tokens(cell)} != {wanted}:
        raise SubjectError(f"{path}: line {line}: a force in {_shown(cell)}, wanted {wanted} as in the first entry")


def _magnitudes(path: Path, times: Floats, forces: Floats, notes: list[str]) -> ForceLog:
    """Forces as magnitudes: some gauges count compression below 0."""
    high, low = float(forces.max()), float(forces.min())
    slack = max(2.0, 0.05 * max(high, -low))
    if high > slack and low < -slack:
        raise SubjectError(
            f"{path}: forces from {low:.1f} to {high:.1f} N, wanted one sign: a push, and no pull; set the gauge's zero"
        )
    other = min(high, -low)
    if other > NOTHING_N:
        notes = [
            *notes,
            f"forces of the other sign, up to {other:.1f} N, count as none, and the others as they stand: look whether "
            "the gauge shows 0 without a load",
        ]
    if -low > high:
        forces, high = -forces, -low
        notes = [*notes, "forces below 0: the gauge counts a push so; taken as magnitudes"]
    if high > GAUGE_LIMIT_N:
        raise SubjectError(f"{path}: forces up to {high:.0f} N, wanted at most {GAUGE_LIMIT_N:g} N; check the unit")
    least = float(forces.min())
    if least > NEVER_BELOW_N:
        notes = [
            *notes,
            f"forces never below {least:.1f} N: if the gauge does not show 0 without a load, all of them are too large "
            "by as much; if the log begins under load, it tells no frame without force",
        ]
    return ForceLog(times, np.maximum(forces, 0.0), tuple(notes))


def _unit_column(cells: Sequence[str], force: int) -> int | None:
    """The column with each force's unit: the next one to the right that is called so, else the last to the left."""
    called = [i for i, cell in enumerate(cells) if i != force and set(_tokens(cell)) <= _UNIT_WORDS and _tokens(cell)]
    return next((i for i in called if i > force), called[-1] if called else None)


def _by_names(names: tuple[str, ...]) -> _Way:
    """Columns of these names: of time, or numbers, and of force, or of force alone."""

    def way(cells: Sequence[str]) -> tuple[list[int], list[int]]:
        found = [[i for i, cell in enumerate(cells) if cell.casefold() == name.strip().casefold()] for name in names]
        if len(found) == 1:
            return [], found[0]
        return (found[0], found[1]) if all(found) else ([], [])

    return way


def _by_words(cells: Sequence[str]) -> tuple[list[int], list[int]]:
    """Columns that say time and force, or begin with a unit of either."""
    columns = list(enumerate(map(_tokens, cells)))
    times = [i for i, words in columns if _says(words, "time")]
    forces = [i for i, words in columns if i not in times and _says(words, "force")]
    if [cells[i] for i in forces] == ["n"]:  # that may number the entries
        forces += [i for i, cell in enumerate(cells) if i not in times and _FORCE_AT_END.search(cell)]
    return times, forces


def _by_units(cells: Sequence[str]) -> tuple[list[int], list[int]]:
    """Columns of other names: of times of day, with a unit at their end, or of values."""
    times, forces = _by_words(cells)
    times = times or [i for i, cell in enumerate(cells) if set(_tokens(cell)) & _CLOCK_WORDS]
    times = times or [i for i, cell in enumerate(cells) if _TIME_AT_END.search(cell)]
    said = [i for i in forces if set(_tokens(cells[i])) & _FORCE_WORDS]
    ended = [i for i, cell in enumerate(cells) if i not in times and _FORCE_AT_END.search(cell)]
    values = [i for i, cell in enumerate(cells) if i not in times and _is_value(_tokens(cell))]
    return times, said or ended or values or forces


def _counted(cells: Sequence[str]) -> tuple[list[int], list[int]]:
    """Columns of numbers of entries, and of force."""
    _, forces = _by_units(cells)
    numbers = [i for i, cell in enumerate(cells) if i not in forces and set(_tokens(cell)) & _COUNT_WORDS]
    return numbers, forces


def _is_value(words: list[str]) -> bool:
    """Whether a column's name says value and no more, but for a unit of force."""
    others = [word for word in words if word not in _FORCE_NAMES]
    return len(others) == 1 and others[0] in _VALUE_WORDS


def _says(words: list[str], what: str) -> bool:
    """Whether a column of these words is one of ``what``, "time" or "force"."""
    own, units = (_TIME_WORDS, _TIME_NAMES) if what == "time" else (_FORCE_WORDS, _FORCE_NAMES)
    return any(word in own for word in words) or bool(words and words[0] in units)


def _cells(line: str, separator: str) -> list[str]:
    try:
        return [cell.strip() for cell in next(csv.reader(io.StringIO(line), delimiter=separator), [])]
    except csv.Error:
        return []


def _number(text: str, separator: str) -> float | None:
    """A number, with a decimal comma where commas do not separate fields."""
    value = plain_number(decimal_point(text, separator))
    return value if math.isfinite(value) else None


def _time(text: str, separator: str) -> float | None:
    """A number or a time of day."""
    return _number(text, separator) if (found := _clock(text)) is None else found


def _clock(text: str) -> float | None:
    """A time of day, s after midnight."""
    if found := _MINUTES.fullmatch(text):
        return 60.0 * int(found["m"]) + float(f"{found['s']}.{found['part']}")
    found = _CLOCK.fullmatch(text)
    if found is None:
        return None
    hours, half = int(found["h"]), (found["half"] or "").upper()
    if (half and not 1 <= hours <= 12) or hours > 23:
        return None
    hours = hours % 12 + 12 * (half == "PM") if half else hours
    return 3600.0 * hours + 60.0 * int(found["m"]) + float(f"{found['s']}.{found['part'] or 0}")


def _tokens(text: str) -> list[str]:
    return re.findall(r"[^\W\d_]+", text.casefold())


def _shown(text: str) -> str:
    return repr(printable(text))
