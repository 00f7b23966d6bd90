"""What a plan is asked for: its target, the pushes and views that are allowed, the largest force, what it may cost."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Literal

from spinestiff.errors import SubjectError
from spinestiff.subject.plan_outcome import PlannedView, Target

LEAST_LIMIT_N = 5.0
COMFORT_N = 80.0
"""The largest force that is proposed unless another one is given."""
DISCOMFORT_N = (116.0, 25.0)
"""At the chest of women (adults, n = 16), mean and standard deviation: Applied Ergonomics 2021."""
RIBS = (5.0, 6.0, 7.0, 8.0, 9.0, 10.0)
SIDES: tuple[Literal["left", "right"], ...] = ("left", "right")
SHARES = (0.5, 1.0)  # of the largest force
VIEWS: tuple[PlannedView, ...] = ("frontal", "frontal+lateral")
EXPOSURES = 8
MOST_EXPOSURES = 40
ROUNDING = 1e-9  # of a sum of costs
RATIO_OF: Mapping[Target, str] = {
    "bending": "lateral_bending",
    "tissue": "tissue",
    "rotation": "axial_rotation",
}


@dataclass(frozen=True)
class Frame:
    """A torso under a push from ``side`` at rib ``level``, N."""

    side: Literal["left", "right"]
    level: float
    force_n: float

    @property
    def push(self) -> str:
        return f"push from the {self.side} at rib {self.level:g}"

    def __str__(self) -> str:
        return f"{self.force_n:g} N from the {self.side} at rib {self.level:g}"


@dataclass(frozen=True)
class Candidate:
    """What may be taken: a pushed state, and from where it is seen."""

    frame: Frame
    view: PlannedView


@dataclass(frozen=True)
class Wish:
    """What a plan is asked for.

    Attributes
    ----------
    target : "bending", "tissue", "rotation" (about the axis), or "cobb", the Cobb angle under the push ``predicted``.
    limit_n : largest force. exposures : radiographs at most, unloaded ones included, in frontal ones.
    sides, ribs : where to push. views : of a pushed state.
    lateral_cost : of a lateral radiograph, in frontal ones.

    Raises
    ------
    SubjectError : a Cobb angle without the push that it is to be predicted for, or the other way round; a force too
        small to plan with; no push or no view at all; a lateral radiograph that costs nothing; too few exposures for
        any push.
    """

    target: Target = "bending"
    limit_n: float = COMFORT_N
    exposures: float = EXPOSURES
    sides: tuple[Literal["left", "right"], ...] = SIDES
    ribs: tuple[float, ...] = RIBS
    predicted: Frame | None = None
    views: tuple[PlannedView, ...] = VIEWS
    lateral_cost: float = 1.0

    def __post_init__(self) -> None:
        if self.target == "cobb" and self.predicted is None:
            raise SubjectError("a Cobb angle is predicted under a push; give --under SIDE,RIB,FORCE, e.g. right,8,60")
        if self.target != "cobb" and self.predicted is not None:
            raise SubjectError("--under names a push to predict a Cobb angle under; it goes with --target cobb")
        if not LEAST_LIMIT_N <= self.limit_n < math.inf:
            raise SubjectError(f"a largest force of {self.limit_n:g} N; wanted {LEAST_LIMIT_N:g} N or more")
        if not self.sides or not self.ribs:
            raise SubjectError("no side or no rib to push; give at least one of each")
        if not self.views:
            raise SubjectError(f"no view to take; give one of {', '.join(VIEWS)}, or both")
        if not 0.0 < self.lateral_cost < math.inf:
            raise SubjectError(
                f"a lateral radiograph that costs {self.lateral_cost:g} frontal ones; wanted a number above 0"
            )
        # An unloaded and a loaded one of each view.
        least = 2.0 if "frontal" in self.views else 2.0 * (1.0 + self.lateral_cost)
        if not self.exposures >= least - ROUNDING:
            raise SubjectError(
                f"exposures for {self.exposures:g} frontal radiographs; a push seen as {self.views[0]} takes {least:g}"
            )

    @property
    def frames(self) -> list[Frame]:
        """All pushed states."""
        pushes = product(self.sides, self.ribs, SHARES)
        # Down, so that none is above the limit.
        return [Frame(side, rib, math.floor(10.0 * share * self.limit_n + 1e-9) / 10.0) for side, rib, share in pushes]
