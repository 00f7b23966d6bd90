"""A push's forces from the log of its gauge, for the form: as ``spinestiff init --log``, and nothing is written."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from spinestiff.errors import SpinestiffError, SubjectError
from spinestiff.files import write_text
from spinestiff.study.report.figures import as_png
from spinestiff.study.report.log_picture import draw_log
from spinestiff.subject.folder import Subject, check_radiograph_path
from spinestiff.subject.intake.force_log import FORCE_UNITS, TIME_UNITS, find_columns, read_force_log, with_units
from spinestiff.subject.intake.logged import put_beside
from spinestiff.subject.outcome_parts import finite
from spinestiff.words import push_named
from spinestiff.workbench.page_words import page_words


@dataclass(frozen=True)
class LogWish:
    """What somebody says of a log: names of its columns and their units, and its time at the first frame, s.

    ``rate_hz`` : of one without times, entries a second; the name of the column of force suffices then.
    """

    columns: tuple[str, ...] | None = None
    time_unit: str | None = None
    force_unit: str | None = None
    offset_s: float | None = None
    rate_hz: float | None = None


def forces_of_log(subject: Subject, number: int, text: str, wish: LogWish) -> dict[str, Any]:
    """The forces of a push's frames, how well they are known, and a picture of log and motion, as JSON.

    Raises
    ------
    SpinestiffError : no such push, no log, units that are not told, frames without times.
    """
    if not 0 <= number < len(subject.pushes):
        raise SubjectError(f"the request: no push {number}")
    if wish.columns is not None and len(wish.columns) < 2 and wish.rate_hz is None:
        raise SubjectError("the log: give the names of both columns, or, if it has no times, its entries a second")
    push = subject.pushes[number]
    check_radiograph_path(subject, push.image)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        write_text(path, text)
        try:
            columns = find_columns(path, wish.columns, wish.rate_hz)
            time_unit, force_unit = wish.time_unit or columns.time_unit, wish.force_unit or columns.force_unit
            for what, unit, known in (("time", time_unit, TIME_UNITS), ("force", force_unit, FORCE_UNITS)):
                if unit not in known:
                    raise SubjectError(f"{columns.words}; say the unit of {what}: {' or '.join(known)}")
            columns = with_units(columns, path, str(time_unit), str(force_unit))
            log = read_force_log(path, columns)
        except SpinestiffError as error:
            raise type(error)(_for_a_form(str(error), path)) from None
    try:
        logged = put_beside(log, [subject.folder / push.frames], push.id, wish.offset_s)
    except SpinestiffError as error:
        raise type(error)(str(error).replace(str(subject.folder), "the subject")) from None
    match = logged.match
    against = f"the given time: {match.against}" if match.against else ""
    picture = as_png(draw_log(push_named(push.id), log, match, logged.times_s, logged.motion))
    return {
        "columns": columns.words,
        "notes": [*log.notes, *filter(None, [against, logged.doubt, *logged.untold])],
        "placed": logged.placed,
        "forces_n": logged.forces_n if logged.placed else None,
        "given": match.given,
        "why": match.why,
        "offset_s": finite(match.offset_s),
        "low_s": finite(match.low_s),
        "high_s": finite(match.high_s),
        "open_n": finite(match.open_n),
        "explained": finite(match.explained),
        "picture": "data:image/png;base64," + base64.b64encode(picture).decode("ascii"),
    }


def _for_a_form(words: str, path: Path) -> str:
    """A message of the command line as the page says it."""
    return page_words(words.replace(f"{path}: ", "the log: ").replace(str(path), "the log"))
