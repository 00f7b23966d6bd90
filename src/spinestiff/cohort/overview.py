"""What all participants of a cohort say together, written: tables, statistics, a picture and one page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

from spinestiff import __version__
from spinestiff.cohort.group import (
    PLAIN_COLUMNS,
    STATES,
    common_order,
    csv_text,
    members_record,
    read_members,
    refuse_nobody,
    refuse_nowhere,
    strangers,
)
from spinestiff.cohort.ledger import Try, read_last, take_over
from spinestiff.cohort.lock import cohort_lock
from spinestiff.cohort.marker import Order
from spinestiff.cohort.page import cohort_page
from spinestiff.cohort.places import place_of, sweep
from spinestiff.cohort.statistics import cohort_statistics
from spinestiff.cohort.statistics_words import statistics_lines, statistics_sections
from spinestiff.cohort.worker import recover
from spinestiff.errors import SubjectError
from spinestiff.files import trouble, write_bytes, write_json, write_text

CSV, JSON, PAGE, PICTURE = "cohort.csv", "cohort.json", "cohort.html", "cohort.png"
_MADE_BY = b'<meta name="generator" content="spinestiff '
_START = 4000
"""Bytes of a file that tell whose it is."""


def refuse_foreign(target: Path) -> None:
    """Raise SubjectError where the folder has a file of somebody else's by the name of one that ``write_overview``
    replaces or takes away."""
    for name, is_ours in ((CSV, _our_table), (JSON, _our_record), (PAGE, _our_page)):
        path = target / name
        if not path.exists():
            continue
        try:
            with path.open("rb") as file:
                ours = is_ours(file.read(_START))
        except OSError as problem:
            raise SubjectError(f"{path}: can't be read ({trouble(problem)}), and cohort would replace it") from None
        if not ours:
            raise SubjectError(
                f"{path}: does not begin as cohort writes it, which would replace it; move it away, or choose another "
                "folder"
            )
    picture = target / PICTURE
    # A picture tells nothing of whose it is; ours is written after the tables.
    if picture.exists() and not (target / JSON).exists():
        raise SubjectError(f"{picture}: cohort would replace it; move it away, or choose another folder")


def _our_table(start: bytes) -> bool:
    """By its first columns, as a spreadsheet may have stored them again."""
    header = start.decode("utf-8-sig", "replace").partition("\n")[0].replace('"', "").replace(";", ",")
    return header.startswith(",".join(PLAIN_COLUMNS[:4]))


def _our_record(start: bytes) -> bool:
    """By its first key, however it is set out."""
    return start.decode("utf-8-sig", "replace").lstrip("{ \r\n\t").startswith('"participants"')


def _our_page(start: bytes) -> bool:
    return _MADE_BY in start


def write_overview(
    source: Path,
    target: Path,
    participants: Sequence[str],
    difference: float | None = None,
    order: Order | None = None,
) -> list[str]:
    """Write the tables of a cohort; lines that say what is in them.

    Parameters
    ----------
    difference : as ``cohort_statistics`` has it. order : by which results count, as ``read_members`` has it.

    Raises
    ------
    InUseError : a run is at work on them. SubjectError : nobody was run; a file that is there is somebody else's
        (``refuse_foreign``); a file can't be written.
    """
    refuse_nowhere(target)
    refuse_foreign(target)
    with cohort_lock(target):
        sweep(target)
        for participant in participants:
            recover(place_of(source, target, participant))
        members = read_members(source, target, participants, order)
        refuse_nobody(members, target)
        common = common_order(members)
        found = cohort_statistics(members, difference)
        sections = statistics_sections(found, members)
        record = {
            "schema_version": 1,
            "version": __version__,
            "settings": None if common is None else common.settings,
            "participants": members_record(members),
            "statistics": [asdict(one) for one in found],
        }
        take_over(target, _last_tries(source, target, participants))
        write_text(target / CSV, csv_text(members))
        write_json(target / JSON, record)
        (target / PICTURE).unlink(missing_ok=True)
        for section in sections:
            if section.picture is not None:
                write_bytes(target / PICTURE, section.picture)
        write_text(target / PAGE, cohort_page(members, sections))
    counts = Counter(member.state for member in members)
    lines = ["group: " + ", ".join(f"{counts[state]} {state}" for state in reversed(STATES) if counts[state])]
    unknown = strangers(target, participants)
    if unknown:
        lines.append(f"left out, since participants.tsv does not name them: {', '.join(unknown[:10])}")
    lines += statistics_lines(found)
    return [*lines, f"tables: {target / CSV}, {target / JSON}", f"page: {target / PAGE}"]


def _last_tries(source: Path, target: Path, participants: Sequence[str]) -> Iterator[Try]:
    for participant in participants:
        last = read_last(place_of(source, target, participant).last)
        yield from () if last is None else last.tries
