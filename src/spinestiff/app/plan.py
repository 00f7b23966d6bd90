"""``spinestiff plan``: which push to take next, as a table, as JSON, as a picture and as a sheet to print."""

from __future__ import annotations

from rich.table import Table

from spinestiff.app import tables
from spinestiff.errors import OptionError
from spinestiff.files import write_bytes, write_text
from spinestiff.observer import Observer
from spinestiff.study.plan import RIBS, SIDES, Frame, Wish, make_plan
from spinestiff.study.plan_scene import scene_of
from spinestiff.study.plan_words import plan_lines, push_words, size_of, width
from spinestiff.study.runner import run_steps
from spinestiff.study.visit import Visit
from spinestiff.subject.plan_outcome import Plan
from spinestiff.subject.run_record import recorded_steps, write_outcome

TARGETS = ("bending", "tissue", "cobb")
MOST_EXPOSURES = 40
SHOWN = 6  # single pushes in the table


def wish_of(
    target: str, limit_n: float, exposures: int, side: str, ribs: str | None, under: str | None, largest: float
) -> Wish:
    """What the options ask for.

    Raises
    ------
    OptionError : an option that can't be read, or is out of range.
    """
    if target not in TARGETS:
        raise OptionError(f"--target {target}: wanted one of {', '.join(TARGETS)}")
    if side not in (*SIDES, "both"):
        raise OptionError(f"--side {side}: wanted left, right or both")
    predicted = None if under is None else _frame(under, largest)
    sides = SIDES if side == "both" else (side,)
    return Wish(target, limit_n, exposures, sides, RIBS if ribs is None else _ribs(ribs), predicted)  # type: ignore[arg-type]


def exposures_of(dose: float | None, frame_dose: float | None) -> int:
    """Radiographs that a dose allows.

    Raises
    ------
    OptionError : one of the two is missing, or they allow no push, which takes two radiographs.
    """
    if dose is None or frame_dose is None:
        raise OptionError("--dose and --frame-dose belong together; give both or none")
    count = int(min(dose / frame_dose + 1e-9, MOST_EXPOSURES))
    if count < 2:
        raise OptionError(f"--dose {dose:g}: allows {count} of {frame_dose:g}; a push takes 2 radiographs")
    return count


def _ribs(text: str) -> tuple[float, ...]:
    try:
        found = tuple(dict.fromkeys(float(part) for part in text.split(",")))
    except ValueError:
        found = ()
    if not found or not all(1.0 <= rib <= 12.0 for rib in found):
        raise OptionError(f"--ribs {text}: wanted ribs from 1 to 12 separated by commas, e.g. 5,7,9")
    return found


def _frame(text: str, largest: float) -> Frame:
    parts = [part.strip() for part in text.split(",")]
    try:
        side, rib, force = parts[0], float(parts[1]), float(parts[2])
    except (ValueError, IndexError):
        side, rib, force = "", 0.0, 0.0
    if len(parts) != 3 or side not in SIDES or not 1.0 <= rib <= 12.0 or not 0.0 < force <= largest:
        raise OptionError(f"--under {text}: wanted SIDE,RIB,FORCE, e.g. right,8,60, up to {largest:g} N")
    return Frame(side, rib, force)  # type: ignore[arg-type]


def plan_next(visit: Visit, wish: Wish, say: Observer) -> Plan:
    """Plan, and write ``plan.json``, ``plan.png`` and ``protocol.html`` into ``results/``.

    The torso is shaped first if it has not been.

    Raises
    ------
    SpinestiffError : see ``study.plan.make_plan`` and ``study.plan_scene.scene_of``; or something can't be written.
    """
    from spinestiff.study.report.figures import as_png
    from spinestiff.study.report.plan_picture import draw_plan
    from spinestiff.study.report.protocol import protocol_page

    if "personalise" not in recorded_steps(visit.subject):
        run_steps(visit, ("personalise",), say)
    plan = make_plan(scene_of(visit), wish, lambda line: say(f"plan: {line}"))
    picture, sheet = as_png(draw_plan(plan)), protocol_page(plan, visit.subject.record.id)
    write_outcome(visit.subject, plan)
    write_bytes(visit.file("plan.png"), picture)
    write_text(visit.file("protocol.html"), sheet)
    return plan


def show_plan(plan: Plan, visit: Visit) -> None:
    """Print what was planned."""
    table = Table(title="One more push", title_justify="left", title_style="bold")
    for column in ("push", "exposures", "expected, 95 %"):
        table.add_column(column, justify="left" if column == "push" else "right")
    for push in plan.next[:SHOWN]:
        table.add_row(push_words(push), "2", width(plan, size_of(push)))
    tables.show(table)
    table = Table(title="One push after the other", title_justify="left", title_style="bold")
    for column in ("push", "exposures so far", "expected, 95 %", "pays"):
        table.add_column(column, justify="left" if column == "push" else "right")
    for step in plan.sequence:
        words = width(plan, size_of(step.push))
        table.add_row(push_words(step.push), str(step.exposures), words, "yes" if step.pays else "hardly")
    tables.show(table)
    for line in plan_lines(plan):
        print(line)
    print(f"picture: {visit.file('plan.png')}\nsheet to print: {visit.file('protocol.html')}")
