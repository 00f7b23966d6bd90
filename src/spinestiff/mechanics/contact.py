"""Supports that push but cannot pull, e.g. the wall behind the back: an active set over springs.

A spring's direction n points away from the obstacle, its target lies on the surface. With the gap g = n . (x - x0) and
the contact force p along n (``Reaction.force`` . n), a consistent state has p >= 0, p = 0 where g > 0, and p = -k g
where the point is pressed in by -g. These are the conditions of least energy with k min(g, 0)^2 / 2 for each spring, so
they do not depend on the order in which springs are let go and caught again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import StiffnessRatios
from spinestiff.arrays import Floats, ShortRepr, read_only
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.equilibrium import Equilibrium, EquilibriumProblem
from spinestiff.mechanics.loads import LoadCase
from spinestiff.mechanics.supports import SupportKind, Supports


@dataclass(frozen=True, repr=False)
class ContactEquilibrium(ShortRepr):
    """An equilibrium with one-sided supports.

    Attributes
    ----------
    equilibrium : on the springs that touch; the reactions of the others are zero.
    problem : the problem it solves, to linearise it (exact as long as no point comes or goes).
    one_sided, touching : (S,) bool, springs of the supports that cannot pull, and springs that act.
    gap : (S,) mm, n . (x - x0); below 0 where a point presses in.
    rounds : equilibria solved.
    """

    equilibrium: Equilibrium
    problem: EquilibriumProblem
    one_sided: np.ndarray
    touching: np.ndarray
    gap: Floats
    rounds: int

    def __post_init__(self) -> None:
        count = len(self.gap)
        for key in ("one_sided", "touching"):
            object.__setattr__(self, key, read_only(key, getattr(self, key), (count,), EquilibriumError, bool))
        object.__setattr__(self, "gap", read_only("gap", self.gap, (count,), EquilibriumError))


def switched(supports: Supports, acting: np.ndarray) -> Supports:
    """The supports with zero stiffness where ``acting`` (S,) is False."""
    springs = supports.springs
    return replace(supports, springs=replace(springs, stiffness=np.where(acting, springs.stiffness, 0.0)))


def solve_with_contact(
    problem: EquilibriumProblem,
    load: LoadCase,
    ratios: StiffnessRatios | None = None,
    start: TorsoState | None = None,
    one_sided: SupportKind = SupportKind.WALL,
    max_rounds: int = 40,
    one_at_a_time: bool = False,
) -> ContactEquilibrium:
    """The equilibrium in which springs of the kind ``one_sided`` push but do not pull.

    Springs that pull are released and released ones that the torso has run into are engaged, until none is left of
    either kind: all of them in a round, or, asked for or where a set of springs comes back, the one farthest off.

    Raises
    ------
    EquilibriumError : no spring is of that kind, an equilibrium in between is not found, or the springs do not
        settle within ``max_rounds``.
    """
    supports = problem.supports
    unilateral = supports.of_kind(one_sided)
    if not unilateral.any():
        known = ", ".join(dict.fromkeys(map(str, supports.kinds))) or "none"
        raise EquilibriumError(f"no support of the kind '{one_sided}' to be one-sided; there are {known}")
    stiffness = supports.springs.stiffness
    touching, seen, state = np.ones(len(unilateral), dtype=bool), set[bytes](), start
    for rounds in range(1, max_rounds + 1):
        current = problem.with_supports(switched(supports, touching))
        found = current.solve(load, ratios, state).require()
        state = found.state
        gap = supports.springs.extension(state)
        # What a spring that is on the wrong side would do if it were switched, N.
        off = np.where(touching, gap, -gap) * stiffness * unilateral
        wrong = off > found.tolerance
        if not wrong.any():
            return ContactEquilibrium(found, current, unilateral, touching, gap, rounds)
        seen.add(touching.tobytes())
        one_at_a_time = one_at_a_time or (touching ^ wrong).tobytes() in seen
        touching = touching ^ (np.arange(len(off)) == np.argmax(off) if one_at_a_time else wrong)
    raise EquilibriumError(
        f"the supports of the kind '{one_sided}' did not settle within {max_rounds} rounds of contact; reduce the force"
    )
