"""Which push to take next: the radiographs that would make an estimate narrowest (``estimation.design``).

Candidates are pushes from the sides and at the ribs that are allowed, each at half and at the whole of the largest
force, seen from the front or from the front and the side, with an unloaded radiograph of each push and view first. The
95 % interval that a set of radiographs leaves follows to first order at a few places where the ratios may lie. What is
reported is the mean over the places, of factors the geometric one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from spinestiff.errors import SubjectError
from spinestiff.observer import Observer
from spinestiff.study.planning.scene import Scene
from spinestiff.study.planning.states import MOST_TURN, CarriedPushes, none_carried
from spinestiff.study.planning.widths import ExpectedWidths, Width
from spinestiff.study.planning.wish import RATIO_OF, ROUNDING, Candidate, Frame, Wish
from spinestiff.subject.plan_outcome import Plan, PlannedPush, PlanStep
from spinestiff.words import counted

# An exposure pays if it narrows the log of the interval (or the degrees) by more than this share.
PAYS = 0.03


def make_plan(scene: Scene, wish: Wish, say: Observer = lambda line: None) -> Plan:
    """The best single push, and the best sequence.

    Raises
    ------
    SubjectError : the target is no ratio of the estimate.
    EquilibriumError : the torso can carry no push that is allowed, or not the one whose Cobb angle is wanted.
    """
    if wish.target != "cobb" and RATIO_OF[wish.target] not in scene.names:
        raise SubjectError(
            f"the estimate has no ratio {RATIO_OF[wish.target]} (it has {', '.join(scene.names)}); "
            f"run spinestiff estimate with {RATIO_OF[wish.target]} among its --parameters, or choose another target"
        )
    carried = CarriedPushes(scene, wish, say)
    widths = ExpectedWidths(scene, carried, say)
    return composed(scene, wish, carried, widths, say)


@dataclass(frozen=True)
class _Option:
    """A candidate after what was taken: radiographs that it adds, their cost, what all of them leave."""

    candidate: Candidate
    added: tuple[int, ...]
    cost: float
    width: Width


def composed(
    scene: Scene, wish: Wish, carried: CarriedPushes, widths: ExpectedWidths, say: Observer = lambda line: None
) -> Plan:
    """The plan of a wish that allows no more than the one that ``carried`` was made for; target and costs are its own.

    Raises
    ------
    EquilibriumError : the torso can carry no push of this wish.
    """
    frames = set(wish.frames)
    candidates = [one for one in carried.candidates if one.frame in frames and one.view in wish.views]
    if not candidates:
        raise none_carried(wish)

    def size_of(width: Width) -> float:
        """What is to become small."""
        if wish.target != "cobb":
            return width.logs[scene.names.index(RATIO_OF[wish.target])]
        assert width.degrees is not None
        return width.degrees

    def described(option: _Option) -> PlannedPush:
        frame, width = option.candidate.frame, option.width
        factors = {name: round(float(np.exp(log)), 3) for name, log in zip(scene.names, width.logs)}
        ratio = wish.target != "cobb"
        return PlannedPush(
            side=frame.side,
            level=frame.level,
            force_n=frame.force_n,
            view=option.candidate.view,
            radiographs=len(option.added),
            fits=option.cost <= wish.exposures + ROUNDING,
            expected_factor=factors[RATIO_OF[wish.target]] if ratio else None,
            expected_deg=None if ratio or width.degrees is None else round(width.degrees, 2),
            factors=factors,
        )

    def options(taken: tuple[int, ...], at_most: float) -> list[_Option]:
        """All that add something, in the candidates' order."""
        found = []
        for candidate in candidates:
            added = widths.radiographs(candidate, taken)
            if added and (cost := widths.cost(added, wish.lateral_cost)) <= at_most + ROUNDING:
                found.append(_Option(candidate, added, cost, widths.of((*taken, *added))))
        return found

    def narrowness(one: tuple[PlannedPush, _Option]) -> tuple[float, int]:
        """As it is told, so that of two that come to the same the one with fewer radiographs is the better."""
        push = one[0]
        told = push.expected_deg if push.expected_factor is None else push.expected_factor
        return told or 0.0, push.radiographs

    say("comparing")
    singles = sorted(((described(one), one) for one in options(widths.taken, np.inf)), key=narrowness)
    taken, sequence, first = widths.taken, list[PlanStep](), singles[0][1].added
    size, spent, pays = size_of(widths.of(taken)), 0.0, True
    while True:
        count = len(taken) - len(widths.taken)
        say(f"sequence: {counted(count, 'exposure')}")
        found = options(taken, wish.exposures - spent)
        if not found:
            break
        before = size
        best = min(found, key=lambda one: (size_of(one.width) - before) / one.cost)
        first = first if sequence else best.added
        taken, spent, size = (*taken, *best.added), spent + best.cost, size_of(best.width)
        pays = pays and 1.0 - size / before > PAYS * best.cost
        sequence.append(PlanStep(push=described(best), exposures=count + len(best.added), pays=bool(pays)))
    now = widths.of(widths.taken) if widths.taken else None
    taped = None
    if widths.taped:
        with_tape = widths.of(widths.taken or first, taped=True)
        taped = size_of(with_tape)
        taped = round(taped if wish.target == "cobb" else float(np.exp(taped)), 3)
    notes = [*scene.doubts, *_left_out([frame for frame in carried.left_out if frame in frames])]
    if len(carried.places) < len(scene.places):
        lost = len(scene.places) - len(carried.places)
        notes.append(f"{counted(lost, 'place')} of {len(scene.places)} left out: no equilibrium under what was seen")
    return Plan(
        target=wish.target,
        limit_n=wish.limit_n,
        basis="population" if scene.taken is None else "estimate",
        taken=widths.taken_radiographs,
        now={} if now is None else {n: round(float(np.exp(v)), 3) for n, v in zip(scene.names, now.logs)},
        estimated={name: round(factor, 3) for name, factor in scene.intervals.items()},
        now_deg=None if now is None or now.degrees is None else round(now.degrees, 2),
        next=tuple(push for push, _ in singles),
        sequence=tuple(sequence),
        taped=taped,
        predicted=None
        if wish.predicted is None
        else (wish.predicted.side, wish.predicted.level, wish.predicted.force_n),
        notes=tuple(notes),
    )


def _left_out(frames: Sequence[Frame]) -> list[str]:
    """A line for each side and force."""
    found = []
    for side, force in dict.fromkeys((frame.side, frame.force_n) for frame in frames):
        ribs = [f"{frame.level:g}" for frame in frames if (frame.side, frame.force_n) == (side, force)]
        found.append(
            f"{force:g} N from the {side} at {'rib' if len(ribs) == 1 else 'ribs'} {', '.join(ribs)}: left out; where "
            f"the ratios may lie, the torso can't carry it or vertebrae would turn by more than "
            f"{np.degrees(MOST_TURN):.0f} degrees"
        )
    return found
