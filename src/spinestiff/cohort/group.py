"""All participants of a cohort in one table, as CSV and as JSON: the same bytes from the same results."""

from __future__ import annotations

import csv
import io
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from spinestiff.cohort.ledger import read_last
from spinestiff.cohort.marker import Found, Order, examine_inputs
from spinestiff.cohort.places import RESULTS, ROW_FILE, Place, place_of
from spinestiff.cohort.row import Row, Stiffness, read_row
from spinestiff.curves.corner_csv import FORMULA
from spinestiff.errors import SubjectError
from spinestiff.files import no_folder
from spinestiff.study.wording.titles import TIMES_DEFAULT, TIMES_WHOLE

State = Literal["failed", "damaged", "not run", "out of date", "done"]
STATES: tuple[State, ...] = ("failed", "damaged", "not run", "out of date", "done")
"""Of a participant, what needs a look first."""
PLAIN_COLUMNS = (
    "participant", "state", "words", "id", "age", "sex", "height_cm", "mass_kg", "cobb_deg", "curve", "status",
    "determined", "failed_checks", "largest_force_n", "training_rmse_mm", "p_value", "held_out_frames",
    "held_out_default_mm", "held_out_fit_mm", "held_out_forecast_mm", "held_out_cobb_error_deg", "held_out_inside95",
)  # fmt: skip
_NOBODY = "has no results of any participant; run spinestiff cohort IN OUT participant first"
_OF_A_STIFFNESS = ("", "_low", "_high", "_open", "_sd_log")


@dataclass(frozen=True)
class Member:
    """A participant with its state.

    Attributes
    ----------
    words : why there is no row, or why it does not count. row : of results that are whole, up to date or not.
    order : that they were made by.
    """

    participant: str
    state: State
    words: str = ""
    row: Row | None = None
    order: Order | None = None

    @property
    def report(self) -> str | None:
        """The participant's report relative to the cohort's output, or None."""
        if self.row is None or self.row.report is None:
            return None
        return f"{self.participant}/{RESULTS}/{self.row.report}"


def read_members(
    source: Path, target: Path, participants: Sequence[str], order: Order | None = None
) -> tuple[Member, ...]:
    """What has become of each participant, in their order.

    Results count if they are whole with a row that can be read, made from what the inputs are now,
    and by the settings and version of ``order``.

    Parameters
    ----------
    order : None: that of most whole results; those after which a run failed are only asked where there are no others.
    """
    places = [place_of(source, target, participant) for participant in participants]
    found = [examine_inputs(place) for place in places]
    failures = [_failure(place) for place in places]
    wanted = _usual_order(found, failures) if order is None else order
    than = "most" if order is None else "those asked for"
    return tuple(_member(*one, wanted, than) for one in zip(places, found, failures))


def _usual_order(found: Sequence[Found], failures: Sequence[str]) -> Order | None:
    whole = [(one.marker.order, failure) for one, failure in zip(found, failures) if one.marker is not None]
    asked = [order for order, failure in whole if not failure] or [order for order, _ in whole]
    counts = Counter(map(_key, asked))
    return max(asked, key=lambda order: counts[_key(order)], default=None)


def _key(order: Order) -> str:
    return json.dumps(order.model_dump(mode="json"), sort_keys=True)


def _failure(place: Place) -> str:
    """Why the last run of a participant failed; "" where it did not, or is not known."""
    last = read_last(place.last)
    if last is None or not last.tries or last.tries[-1].ended in ("done", "up to date"):
        return ""
    return last.tries[-1].words


def _member(place: Place, found: Found, failure: str, wanted: Order | None, than: str) -> Member:
    """``wanted`` : by which results count, None where nobody has any. ``than`` : whose it is."""
    participant = place.participant
    if found.marker is None:
        if failure:
            return Member(participant, "failed", failure)
        return Member(participant, "not run" if found.state == "missing" else "damaged", found.words)
    try:
        row = read_row(place.results / ROW_FILE)
    except SubjectError as error:
        if failure:
            return Member(participant, "failed", failure, None, found.marker.order)
        words = f"{error}; take {place.results} away and run spinestiff cohort again"
        if found.state != "current" or found.marker.order != wanted:
            words = found.words or _made_otherwise(than)
        return Member(participant, "out of date", words, None, found.marker.order)
    if found.state == "current" and found.marker.order == wanted:
        return Member(participant, "done", "", row, found.marker.order)
    if failure:
        return Member(participant, "failed", f"{failure}; earlier results are shown", row, found.marker.order)
    return Member(participant, "out of date", found.words or _made_otherwise(than), row, found.marker.order)


def _made_otherwise(than: str) -> str:
    return f"made with other settings or by another version than {than}; run spinestiff cohort again"


def strangers(target: Path, participants: Sequence[str]) -> tuple[str, ...]:
    """Folders of results in a cohort's output that are of nobody in its table."""
    known = set(participants)
    try:
        there = sorted(path.parent.name for path in target.glob(f"*/{RESULTS}") if path.is_dir())
    except OSError:
        return ()
    return tuple(name for name in there if name not in known)


def table(members: Sequence[Member]) -> tuple[list[str], list[list[str]]]:
    """Header and rows of ``cohort.csv``, texts as they are written."""
    kinds = sorted({kind for member in members for kind in stiffness_kinds(member)})
    header = [*PLAIN_COLUMNS, *(f"{name}{_unit(unit)}{part}" for name, unit in kinds for part in _OF_A_STIFFNESS)]
    rows = [_plain_cells(member) for member in members]
    for member, cells in zip(members, rows):
        for name, unit in kinds:
            cells += _stiffness_cells(stiffness_of(member, name, unit))
    return header, rows


def stiffness_kinds(member: Member) -> list[tuple[str, str]]:
    """What is told of a participant: names with units. A ratio in another unit is another one."""
    return [] if member.row is None else [(name, found.unit) for name, found in member.row.stiffness.items()]


def stiffness_of(member: Member, name: str, unit: str) -> Stiffness | None:
    """A participant's stiffness; None also where it has one of that name in another unit."""
    found = None if member.row is None else member.row.stiffness.get(name)
    return found if found is not None and found.unit == unit else None


def csv_text(members: Sequence[Member]) -> str:
    """``cohort.csv``."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    header, rows = table(members)
    writer.writerow(header)
    writer.writerows(rows)
    return stream.getvalue()


def members_record(members: Sequence[Member]) -> list[dict[str, Any]]:
    """The participants as JSON."""
    return [
        {
            "participant": member.participant,
            "state": member.state,
            "words": member.words,
            "report": member.report,
            "row": None if member.row is None else member.row.model_dump(mode="json"),
        }
        for member in members
    ]


def common_order(members: Sequence[Member]) -> Order | None:
    """The settings of the results that count; None where there are none."""
    return next((member.order for member in members if member.state == "done"), None)


def _unit(unit: str) -> str:
    """The end of a column's name; none of a ratio to the default."""
    known = {TIMES_DEFAULT: "", TIMES_WHOLE: "_of_whole"}
    return known.get(unit, f"_{unit.replace(' ', '').replace('/', '_per_')}")


def _plain_cells(member: Member) -> list[str]:
    row = member.row
    if row is None:
        return [member.participant, member.state, _guarded(member.words), *[""] * (len(PLAIN_COLUMNS) - 3)]
    held = row.held_out
    rmse = {} if held is None else held.rmse_mm
    return [
        member.participant, member.state, _guarded(member.words), row.id, _text(row.age), row.sex, _text(row.height_cm),
        _text(row.mass_kg), _text(row.cobb_deg), row.curve, row.status, row.determined,
        _guarded("; ".join(row.failed_checks)), _text(row.largest_force_n), _text(row.training_rmse_mm),
        _text(row.p_value), "" if held is None else str(held.frames), _text(rmse.get("default")),
        _text(rmse.get("fit")),
        _text(rmse.get("forecast")), _text(None if held is None else held.cobb_error_deg),
        _text(None if held is None else held.inside95),
    ]  # fmt: skip


def _stiffness_cells(found: Stiffness | None) -> list[str]:
    if found is None:
        return [""] * len(_OF_A_STIFFNESS)
    ends = [name for name, open_ in (("low", found.open_low), ("high", found.open_high)) if open_]
    return [_text(found.value), _text(found.low), _text(found.high), "+".join(ends), _text(found.sd_log)]


def _text(value: float | None) -> str:
    return "" if value is None else repr(float(value))


def _guarded(text: str) -> str:
    """Text that no spreadsheet takes for a formula."""
    return f"'{text}" if text.startswith(FORMULA) else text


def refuse_nowhere(target: Path) -> None:
    """Raise SubjectError where a cohort's output is not there, as after a typing error."""
    if not target.is_dir():
        raise SubjectError(f"{target}: {no_folder(target)}, so it {_NOBODY}")


def refuse_nobody(members: Sequence[Member], target: Path) -> None:
    """Raise SubjectError where no participant was ever run."""
    if all(member.state == "not run" for member in members):
        raise SubjectError(f"{target}: {_NOBODY}")
