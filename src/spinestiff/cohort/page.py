"""All participants of a cohort on one page: ``cohort.html``, which asks nothing of any other file or host."""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from spinestiff import __version__
from spinestiff.cohort.group import STATES, Member, common_order, stiffness_of
from spinestiff.cohort.row import Stiffness
from spinestiff.cohort.statistics import ordered_kinds
from spinestiff.study.report.viewer.page import page_environment, source_hash
from spinestiff.study.wording.numbers import fixed, number
from spinestiff.study.wording.titles import TIMES_WHOLE

STATE_WORDS = {state: "damaged results" if state == "damaged" else state for state in STATES}


@dataclass(frozen=True)
class Cell:
    """A cell of the table: what people read and, where that does not sort, what it is sorted by."""

    text: str
    sort: str = ""


@dataclass(frozen=True)
class Line:
    """A participant's row. ``look`` : needs a look, as ``needs_look`` says."""

    member: Member
    state: str
    known: str
    look: bool
    said: str
    cells: tuple[Cell, ...]


@dataclass(frozen=True)
class Section:
    """A part of the page below the table: a heading, sentences, tables and perhaps a picture (PNG)."""

    title: str
    sentences: tuple[str, ...]
    tables: tuple[tuple[str, tuple[str, ...], tuple[tuple[str, ...], ...]], ...] = ()
    picture: bytes | None = None
    words: str = ""

    @property
    def source(self) -> str:
        """The picture as an address."""
        return "" if self.picture is None else f"data:image/png;base64,{base64.b64encode(self.picture).decode()}"


def cohort_page(members: Sequence[Member], sections: Sequence[Section] = ()) -> str:
    """The page: a table of all, what failed first, and sections below it."""
    kinds = ordered_kinds(members)
    ordered = sorted(members, key=lambda member: (STATES.index(member.state), not _doubtful(member)))
    lines = [_line(member, kinds) for member in ordered]
    counts = Counter(member.state for member in members)
    script, style = _shipped("cohort.js"), _shipped("cohort.css")
    policy = (
        f"default-src 'none'; script-src {source_hash(script)}; style-src {source_hash(style)}; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )
    titles = [_title(*kind) for kind in kinds]
    order = common_order(members)
    settings = {} if order is None else {key: _setting(value) for key, value in order.settings.items()}
    page = {
        "policy": policy,
        "script": script,
        "style": style,
        "version": __version__ if order is None else order.version,
        "settings": {key: value for key, value in sorted(settings.items()) if value},
        "total": len(members),
        "states": [(state, STATE_WORDS[state], counts[state]) for state in STATES if counts[state]],
        "known": sorted({line.known for line in lines if line.known}),
        "doubtful": sum(map(_doubtful, members)),
        "columns": ["age", "sex", "height, cm", "Cobb", "curve", *titles, "held out, mm", "checks"],
        "lines": lines,
        "sections": sections,
    }
    return page_environment(Path(__file__).parent).get_template("cohort.html.j2").render(page)


def _title(name: str, unit: str) -> str:
    short = {
        "lateral_bending_thoracic": "bending, thoracic, N m/rad",
        "lateral_bending_lumbar": "bending, lumbar, N m/rad",
        "tissue_young": "tissue, kPa",
    }
    return short.get(name) or f"{name.replace('_', ' ')}, times {'whole' if unit == TIMES_WHOLE else 'default'}"


def _doubtful(member: Member) -> bool:
    return member.row is not None and member.row.status == "DOUBTFUL"


def _line(member: Member, kinds: Sequence[tuple[str, str]]) -> Line:
    row = member.row
    said = member.words
    if row is None:
        empty = Cell("")
        return Line(member, STATE_WORDS[member.state], "", True, said, (empty,) * (len(kinds) + 7))
    known = "doubtful" if _doubtful(member) else row.determined
    held = row.held_out
    forecast = None if held is None else held.rmse_mm.get("forecast", held.rmse_mm.get("fit"))
    default = None if held is None else held.rmse_mm.get("default")
    shown = "" if forecast is None else f"{fixed(forecast)} (default {fixed(default)})"
    cells = (
        Cell(number(row.age), repr(row.age)),
        Cell(row.sex),
        Cell(fixed(row.height_cm, 0), repr(row.height_cm)),
        Cell(f"{fixed(row.cobb_deg, 0, sign=True)}°", repr(abs(row.cobb_deg))),
        Cell(row.curve),
        *(_stiffness_cell(stiffness_of(member, *kind)) for kind in kinds),
        Cell(shown, "" if forecast is None else repr(forecast)),
        Cell("; ".join(row.failed_checks), str(len(row.failed_checks))),
    )
    return Line(member, STATE_WORDS[member.state], known, member.state != "done" or _doubtful(member), said, cells)


def _stiffness_cell(found: Stiffness | None) -> Cell:
    if found is None:
        return Cell("")
    low = "" if found.low is None else f"{'≤ ' if found.open_low else ''}{number(found.low, 2)}"
    high = "" if found.high is None else f"{'≥ ' if found.open_high else ''}{number(found.high, 2)}"
    span = f" ({low} to {high})" if low and high else ""
    return Cell(f"{number(found.value, 2)}{span}", repr(found.value))


def _setting(value: object) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list) else "" if value is None else str(value)


def _shipped(name: str) -> str:
    # Newlines as a browser sees them: the policy's hash is of that text.
    return (files("spinestiff.cohort") / name).read_text(encoding="utf-8").replace("\r\n", "\n")
