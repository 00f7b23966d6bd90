"""``spinestiff plan``: which push to take next, as a table, as JSON, as a picture and as a sheet to print."""

from __future__ import annotations

import logging
from dataclasses import asdict
from typing import Any, get_args

from spinestiff.app import tables
from spinestiff.errors import OptionError, SpinestiffError
from spinestiff.files import check_writable, write_bytes, write_text
from spinestiff.formats import plain_number
from spinestiff.observer import Observer, heard
from spinestiff.study.planning.proposal import make_plan
from spinestiff.study.planning.scene import scene_of
from spinestiff.study.planning.wish import EXPOSURES, MOST_EXPOSURES, RIBS, ROUNDING, SIDES, VIEWS, Frame, Wish
from spinestiff.study.runner import ALL_STEPS, PUSHES, logged_step, run_steps
from spinestiff.study.visit import Visit
from spinestiff.study.wording.plan import (
    VIEW_WORDS,
    now_of,
    pays,
    plan_lines,
    push_words,
    radiographs_of,
    size_of,
    width,
)
from spinestiff.subject.plan_outcome import Plan, PlannedPush, Target
from spinestiff.subject.records import LEVELS
from spinestiff.subject.run_record import record_step, recorded_steps, step_record, write_outcome

TARGETS = get_args(Target)
SHOWN = 6  # single pushes in the table
_log = logging.getLogger(__name__)


def wish_of(
    target: str,
    limit_n: float,
    exposures: float,
    side: str,
    ribs: str | None,
    under: str | None,
    largest: float,
    views: str = "both",
    lateral_cost: float = 1.0,
) -> Wish:
    """What the options ask for.

    Parameters
    ----------
    exposures, lateral_cost : see ``exposures_of``.

    Raises
    ------
    OptionError : an option that can't be read, or is out of range.
    """
    if target not in TARGETS:
        raise OptionError(f"--target {target}: wanted one of {', '.join(TARGETS)}")
    if side not in (*SIDES, "both"):
        raise OptionError(f"--side {side}: wanted left, right or both")
    predicted = None if under is None else _frame(under, largest)
    if views not in (*VIEWS, "both"):
        raise OptionError(f"--views {views}: wanted {', '.join(VIEWS)} or both")
    return Wish(
        target,  # type: ignore[arg-type]
        limit_n,
        exposures,
        SIDES if side == "both" else (side,),  # type: ignore[arg-type]
        RIBS if ribs is None else _ribs(ribs),
        predicted,
        VIEWS if views == "both" else (views,),  # type: ignore[arg-type]
        lateral_cost,
    )


def exposures_of(
    exposures: int | None, dose: float | None, frame_dose: float | None, lateral_dose: float | None
) -> tuple[float, float]:
    """Frontal radiographs that are asked for or that a dose allows, and what a lateral one costs of them.

    Raises
    ------
    OptionError : both are given; the dose or that of a radiograph is missing, or they allow no push, which takes two
        radiographs.
    """
    if dose is None and frame_dose is None and lateral_dose is None:
        return float(EXPOSURES if exposures is None else exposures), 1.0
    if exposures is not None:
        raise OptionError(f"--exposures {exposures}: --dose stands in its place; give one of the two")
    if dose is None or frame_dose is None:
        raise OptionError("--dose and --frame-dose belong together, --lateral-dose to both; give both or none of them")
    count = min(dose / frame_dose, float(MOST_EXPOSURES))
    if count < 2.0 - ROUNDING:
        raise OptionError(f"--dose {dose:g}: allows {int(count)} of {frame_dose:g}; a push takes 2 radiographs")
    return count, 1.0 if lateral_dose is None else lateral_dose / frame_dose


def _ribs(text: str) -> tuple[float, ...]:
    found = tuple(dict.fromkeys(plain_number(part) for part in text.split(",")))
    if not all(LEVELS[0] <= rib <= LEVELS[1] for rib in found):
        raise OptionError(f"--ribs {text}: wanted ribs from 1 to 12 separated by commas, e.g. 5,7,9")
    return found


def _frame(text: str, largest: float) -> Frame:
    parts = [part.strip() for part in text.split(",")]
    try:
        side, rib, force = parts[0], plain_number(parts[1]), plain_number(parts[2])
    except IndexError:
        side, rib, force = "", 0.0, 0.0
    if len(parts) != 3 or side not in SIDES or not LEVELS[0] <= rib <= LEVELS[1] or not 0.0 < force <= largest:
        raise OptionError(f"--under {text}: wanted SIDE,RIB,FORCE, e.g. right,8,60, up to {largest:g} N")
    return Frame(side, rib, force)  # type: ignore[arg-type]


def plan_next(visit: Visit, wish: Wish, observer: Observer | None) -> Plan:
    """Plan, and write ``plan.json``, ``plan.png`` and ``protocol.html`` into ``results/``.

    The torso is shaped first if it has not been. A report that is there is made anew, so that it shows this plan.

    Raises
    ------
    SpinestiffError : see ``planning.proposal.make_plan`` and ``planning.scene.scene_of``; also for unwritable files.
    """
    check_writable(visit.subject.results, "results")
    if "personalise" not in recorded_steps(visit.subject):
        run_steps(visit, ("personalise",), observer)
    say = heard(observer, _log)
    with logged_step(Plan.STEP):
        plan = make_plan(scene_of(visit), wish, lambda line: say(f"{Plan.STEP}: {line}"))
        _write(visit, plan, wish)
    if "report" in recorded_steps(visit.subject):
        try:
            run_steps(visit, ("report",), observer)
        except SpinestiffError as problem:
            say(f"{Plan.STEP}: the report does not show this plan yet: {problem}")
    return plan


def _write(visit: Visit, plan: Plan, wish: Wish) -> None:
    from spinestiff.study.report.figures import as_png
    from spinestiff.study.report.plan_picture import draw_plan
    from spinestiff.study.report.protocol import protocol_page

    picture, sheet = as_png(draw_plan(plan)), protocol_page(plan, visit.subject.record.id)
    subject = visit.subject
    # Where an estimate is there, what it was made from and what it made; before any push what shapes the torso, and
    # that there is no push.
    step = "estimate" if plan.basis == "estimate" else "personalise"
    inputs = {*ALL_STEPS[step].inputs(visit), *recorded_steps(subject)[step].outputs, PUSHES}
    record = step_record(subject, inputs, asdict(wish))
    write_outcome(subject, plan)
    write_bytes(visit.file("plan.png"), picture)
    write_text(visit.file("protocol.html"), sheet)
    record_step(subject, Plan.STEP, record, [visit.file(name) for name in (Plan.FILE, "plan.png", "protocol.html")])


def _told(plan: Plan, push: PlannedPush) -> dict[str, Any]:
    names = ("side", "level", "force_n", "view", "radiographs", _size_name(plan))
    return {name: getattr(push, name) for name in names}


def _size_name(plan: Plan) -> str:
    return "expected_deg" if plan.target == "cobb" else "expected_factor"


def single_pushes(plan: Plan) -> list[dict[str, Any]]:
    """Single pushes for programs (docs/plan.md), best first, as far as the radiographs asked for allow them."""
    return [_told(plan, push) for push in plan.next if push.fits]


def plan_record(plan: Plan) -> dict[str, Any]:
    """A whole plan for programs (docs/plan.md); ``plan.json`` holds more of each push."""
    size, worth, columns = _size_name(plan), pays(plan), ("side", "level", "force_n", "view")
    return {
        "target": plan.target,
        "basis": plan.basis,
        "limit_n": plan.limit_n,
        f"now_{size.removeprefix('expected_')}": now_of(plan),
        size: size_of(worth[-1].push) if worth else None,
        "next": single_pushes(plan),
        "sequence": [{**_told(plan, one.push), "exposures": one.exposures, "pays": one.pays} for one in plan.sequence],
        "frames": [dict(zip(columns, one)) for one in radiographs_of(plan)],
    }


def show_plan(plan: Plan, visit: Visit) -> None:
    """Print what was planned."""
    made = tables.table("One more push", "push", "view", "exposures", "expected, 95 %", left=("view",))
    for push in [push for push in plan.next if push.fits][:SHOWN]:
        made.add_row(push_words(push), VIEW_WORDS[push.view], str(push.radiographs), width(plan, size_of(push)))
    tables.show(made)
    columns = ("push", "view", "exposures\nso far", "expected, 95 %", "pays")
    made = tables.table("One push after the other", *columns, left=("view",))
    for step in plan.sequence:
        push, words = step.push, width(plan, size_of(step.push))
        worth = "yes" if step.pays else "hardly"
        made.add_row(push_words(push), VIEW_WORDS[push.view], str(step.exposures), words, worth)
    tables.show(made)
    for line in plan_lines(plan):
        print(line)
    print(f"picture: {visit.file('plan.png')}\nsheet to print: {visit.file('protocol.html')}")
