"""The plan of the next pushes as a file in ``results/``: its schema."""

from __future__ import annotations

from typing import ClassVar, Literal

from spinestiff.subject.outcome_parts import Outcome, OutcomeFile

Target = Literal["bending", "tissue", "rotation", "cobb"]
PlannedView = Literal["frontal", "frontal+lateral"]
"""What is taken of a pushed state: a frontal radiograph, or a lateral one beside it."""


class PlannedPush(Outcome):
    """A frame of a push that might be taken, and what is expected with it.

    Attributes
    ----------
    side : pushed, the patient's. level : rib. force_n : N. view : what is taken of the pushed state.
    radiographs : that this adds to those before, unloaded ones included. fits : no more than are allowed.
    expected_factor : either way, the 95 % interval of the target ratio once this is taken, too; None where the target
        is an angle.
    expected_deg : either way, of the predicted Cobb angle; None where the target is a ratio.
    factors : the same of all ratios, by name.
    """

    side: Literal["left", "right"]
    level: float
    force_n: float
    view: PlannedView = "frontal"
    radiographs: int
    fits: bool = True
    expected_factor: float | None
    expected_deg: float | None = None
    factors: dict[str, float]


class PlanStep(Outcome):
    """A step of the sequence: ``exposures`` so far, this one's among them; ``pays``: whether it narrows enough."""

    push: PlannedPush
    exposures: int
    pays: bool


class Plan(OutcomeFile):
    """``plan.json``: which push next, and which after it.

    Attributes
    ----------
    target : what is to become narrow. limit_n : the largest force that is proposed.
    basis : where the ratios may lie: "estimate", its draws, or "population", around Table 4's geometric means.
    taken : radiographs that the estimate is made from.
    now : factors of all ratios with those alone, by name, to first order as all that is expected here; empty before any
        push. now_deg : of the predicted Cobb angle.
    estimated : factors of the estimate's own intervals, either way on average, by name; empty before any push.
    next : single pushes, best first, each with an unloaded radiograph of its own; those that don't fit, too.
    sequence : one after the other, each the best after those before.
    taped : the target's factor (or degrees) with a tape around the trunk, now or, before any push, with the best one;
        None: it is taped.
    predicted : side, level and force of the push whose Cobb angle is the target.
    notes : what was left out.
    """

    FILE: ClassVar[str] = "plan.json"
    STEP: ClassVar[str] = "plan"
    target: Target
    limit_n: float
    basis: Literal["estimate", "population"]
    taken: int
    now: dict[str, float]
    now_deg: float | None
    estimated: dict[str, float]
    next: tuple[PlannedPush, ...]
    sequence: tuple[PlanStep, ...]
    taped: float | None
    predicted: tuple[Literal["left", "right"], float, float] | None = None
    notes: tuple[str, ...] = ()
