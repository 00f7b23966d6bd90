"""A plan of further pushes in words."""

from __future__ import annotations

from spinestiff.study.planning.wish import DISCOMFORT_N, RATIO_OF
from spinestiff.study.wording.numbers import fixed, number
from spinestiff.subject.plan_outcome import Plan, PlannedPush, PlanStep
from spinestiff.words import counted

NONE_PAYS = "no further radiograph pays: the best one narrows it by less than 3 % an exposure"
TITLES = {
    "bending": "lateral bending",
    "tissue": "tissue",
    "rotation": "axial rotation",
    "cobb": "predicted Cobb angle",
}
VIEW_WORDS = {"frontal": "frontal", "frontal+lateral": "frontal and lateral"}


def push_words(push: PlannedPush) -> str:
    """E.g. "rib 8 right, 60 N"."""
    return f"rib {push.level:g} {push.side}, {push.force_n:g} N"


def taken_words(push: PlannedPush) -> str:
    """The same with its view, e.g. "rib 8 right, 60 N, frontal"."""
    return f"{push_words(push)}, {VIEW_WORDS[push.view]}"


def size_of(push: PlannedPush) -> float:
    """The target's factor, or degrees, expected once a push is taken."""
    return push.expected_deg if push.expected_factor is None else push.expected_factor  # type: ignore[return-value]


def now_of(plan: Plan) -> float | None:
    """The same with what was taken so far; None before any push."""
    return plan.now_deg if plan.target == "cobb" else plan.now.get(RATIO_OF[plan.target])


def width(plan: Plan, size: float) -> str:
    """E.g. "within a factor of 1.8" or "within 2.1°"."""
    return f"within {fixed(size)}°" if plan.target == "cobb" else f"within a factor of {number(size)}"


def pays(plan: Plan) -> tuple[PlanStep, ...]:
    """The steps that are worth it; none where what was taken already says as much."""
    return tuple(step for step in plan.sequence if step.pays)


def radiographs_of(plan: Plan) -> list[tuple[str, float, float, str]]:
    """Side, rib, force and "frontal" or "lateral" of each radiograph of the sequence as far as it pays, in the order in
    which they are taken: each push has its unloaded ones first, and its forces grow."""
    views: dict[tuple[str, float], dict[float, set[str]]] = {}
    for step in pays(plan):
        push = step.push
        for force in (0.0, push.force_n):
            views.setdefault((push.side, push.level), {}).setdefault(force, set()).update(push.view.split("+"))
    return [
        (side, rib, force, view)
        for (side, rib), forces in views.items()
        for force in sorted(forces)
        for view in sorted(forces[force])
    ]


def other_view(plan: Plan, push: PlannedPush) -> PlannedPush | None:
    """The same single push seen otherwise; None where one view alone was planned with."""
    same = (one for one in plan.next if (one.side, one.level, one.force_n) == (push.side, push.level, push.force_n))
    return next((one for one in same if one.view != push.view), None)


def plan_lines(plan: Plan) -> list[str]:
    """What a plan says, in sentences."""
    what, found = TITLES[plan.target], []
    if plan.predicted is not None:
        side, level, force = plan.predicted
        what = f"{what} under {force:g} N from the {side} at rib {level:g}"
    now = now_of(plan)
    if now is None:
        found.append(f"{what}, before any push: for ratios around the geometric means of the paper's Table 4")
    else:
        own = plan.estimated.get(RATIO_OF.get(plan.target, ""))
        beside = "" if own is None else f"; the estimate's own interval: {width(plan, own)}"
        found.append(f"{what}: now {width(plan, now)} (95 %, to first order, as all that is expected here{beside})")
    mean, sd = DISCOMFORT_N
    always = [
        f"forces up to {plan.limit_n:g} N; women called a push at the chest uncomfortable at {mean:g} ± {sd:g} N "
        "(adults, n = 16)",
        *(f"note: {note}" for note in plan.notes),
    ]
    tape = []
    if plan.taped is not None:
        with_what = "with the best push" if now is None else "and no further push"
        tape = [f"with a tape around the trunk {with_what}: {width(plan, plan.taped)}"]
    worth = pays(plan)
    if not worth:
        return [*found, NONE_PAYS, *(tape if now is not None else ()), *always]
    best, last = plan.sequence[0].push, worth[-1]
    found.append(f"best next: {taken_words(best)}, expected {width(plan, size_of(best))}")
    other = other_view(plan, best)
    if other is not None:
        seen = "with a lateral radiograph beside each" if best.view == "frontal" else "with frontal radiographs alone"
        found.append(
            f"{seen}: {width(plan, size_of(other))} ({other.radiographs} in place of {best.radiographs} exposures)"
        )
    until = f"{counted(last.exposures, 'exposure')} ({width(plan, size_of(last.push))})"
    if len(worth) < len(plan.sequence):
        found.append(f"further radiographs hardly narrow it after {until}")
    else:
        found.append(f"every step pays up to {until}")
    return [*found, *tape, *always]
