"""Supports that push but cannot pull, e.g. the wall behind the back: an active set over springs.

A spring's direction n points away from the obstacle, its target lies on the surface. With the gap g = n . (x - x0) and
the contact force p along n (``Reaction.force`` . n), a consistent state has p >= 0, p = 0 where g > 0, and p = -k g
where the point is pressed in by -g. These are the conditions of least energy with k min(g, 0)^2 / 2 for each spring, so
they do not depend on the order in which springs are let go and caught again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import StiffnessRatios
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, ShortRepr, read_only
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.assembly import Law
from spinestiff.mechanics.equilibrium import Equilibrium, EquilibriumProblem, OnNewtonStep
from spinestiff.mechanics.loads import LoadCase
from spinestiff.mechanics.newton import Run
from spinestiff.mechanics.sensitivity import Linearisation
from spinestiff.mechanics.supports import SupportKind, Supports
from spinestiff.mechanics.terms import Term
from spinestiff.words import counted

MAX_ROUNDS = 40


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


class OneSidedProblem(EquilibriumProblem):
    """A torso whose wall pushes but does not pull, solved and linearised like any other problem.

    Each solve finds the springs of the wall that touch, from those that touch in its start on. Its reactions are zero
    where the wall is left. A linearisation holds the springs that touch in its equilibrium, and is exact as long as no
    point comes or goes.

    Raises
    ------
    EquilibriumError : no support is a wall (and in a solve: the springs do not settle).
    """

    ONE_SIDED: ClassVar[SupportKind] = SupportKind.WALL

    def __init__(
        self,
        torso: TorsoModel,
        supports: Supports,
        terms: Sequence[Term] = (),
        backend: str | None = None,
        laws: Sequence[Law] = (),
    ) -> None:
        super().__init__(torso, supports, terms, backend, laws)
        _springs_of(supports, self.ONE_SIDED)

    def linearise(
        self, equilibrium: Equilibrium, load: LoadCase, ratios: StiffnessRatios | None = None
    ) -> Linearisation:
        """The tangent on the springs that touch; see ``EquilibriumProblem.linearise``."""
        touching = self._touching(equilibrium.state, equilibrium.tolerance)
        return super(OneSidedProblem, self.with_acting(touching)).linearise(equilibrium, load, ratios)

    def solve_linearised(
        self,
        load: LoadCase,
        ratios: StiffnessRatios | None = None,
        start: TorsoState | Linearisation | None = None,
        observer: OnNewtonStep | None = None,
        largest_turn: float = np.inf,
        most_factorisations: float = np.inf,
    ) -> tuple[Equilibrium, Linearisation]:
        """``solve`` and ``linearise``. Raises EquilibriumError where no equilibrium was found."""
        found = self.solve(
            load, ratios, start, observer, largest_turn=largest_turn, most_factorisations=most_factorisations
        ).require()
        return found, self.linearise(found, load, ratios)

    def _solved(self, run: Run, load: LoadCase, start: TorsoState | Linearisation | None) -> Equilibrium:
        def solve(touching: np.ndarray, begin: TorsoState | Linearisation | None) -> Equilibrium:
            current = self.with_acting(touching)
            # One run for all rounds: what they cost adds up in it.
            run.system = current
            return super(OneSidedProblem, current)._solved(run, load, begin)

        state = start.state if isinstance(start, Linearisation) else start
        first = self._touching(self.torso.rest_pose if state is None else self.placed(self._checked(state)), 0.0)
        return _settled(self.supports, self.ONE_SIDED, solve, first, start).equilibrium

    def _touching(self, state: TorsoState, tolerance: float) -> np.ndarray:
        """(S,) bool, springs that are pressed in ``state``, or lie on the wall to within a force of ``tolerance``."""
        springs = self.supports.springs
        return ~self.supports.of_kind(self.ONE_SIDED) | (springs.extension(state) * springs.stiffness <= tolerance)


def solve_with_contact(
    problem: EquilibriumProblem,
    load: LoadCase,
    ratios: StiffnessRatios | None = None,
    start: TorsoState | None = None,
    one_sided: SupportKind = SupportKind.WALL,
    max_rounds: int = MAX_ROUNDS,
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
    _springs_of(supports, one_sided)

    def solve(touching: np.ndarray, begin: TorsoState | Linearisation | None) -> Equilibrium:
        return problem.with_acting(touching).solve(load, ratios, begin).require()

    everywhere = np.ones(len(supports.names), dtype=bool)
    settled = _settled(supports, one_sided, solve, everywhere, start, max_rounds, one_at_a_time)
    final = problem.with_acting(settled.touching)
    return ContactEquilibrium(
        settled.equilibrium, final, supports.of_kind(one_sided), settled.touching, settled.gap, settled.rounds
    )


def _springs_of(supports: Supports, kind: SupportKind) -> np.ndarray:
    """(S,) bool, springs of a kind; raises EquilibriumError if there is none."""
    found = supports.of_kind(kind)
    if not found.any():
        known = ", ".join(dict.fromkeys(map(str, supports.kinds))) or "none"
        raise EquilibriumError(f"no support of the kind '{kind}' to be one-sided; there are {known}")
    return found


@dataclass(frozen=True)
class _Settled:
    """Where the rounds ended: the equilibrium, the springs that act in it, their gaps (S,) mm, and how many rounds."""

    equilibrium: Equilibrium
    touching: np.ndarray
    gap: Floats
    rounds: int


def _settled(
    supports: Supports,
    one_sided: SupportKind,
    solve: Callable[[np.ndarray, TorsoState | Linearisation | None], Equilibrium],
    touching: np.ndarray,
    start: TorsoState | Linearisation | None,
    max_rounds: int = MAX_ROUNDS,
    one_at_a_time: bool = False,
) -> _Settled:
    """Rounds of the active set, from ``touching`` on, until no spring is on the wrong side or a solve fails.

    Raises
    ------
    EquilibriumError : the springs do not settle.
    """
    unilateral, stiffness, seen = supports.of_kind(one_sided), supports.springs.stiffness, set[bytes]()
    for rounds in range(1, max_rounds + 1):
        found = solve(touching, start)
        start = found.state
        gap = supports.springs.extension(found.state)
        # What a spring that is on the wrong side would do if it were switched, N.
        off = np.where(touching, gap, -gap) * stiffness * unilateral
        wrong = off > found.tolerance
        if not (found.converged and wrong.any()):
            return _Settled(found, touching, gap, rounds)
        seen.add(touching.tobytes())
        one_at_a_time = one_at_a_time or (touching ^ wrong).tobytes() in seen
        touching = touching ^ (np.arange(len(off)) == np.argmax(off) if one_at_a_time else wrong)
    raise EquilibriumError(
        f"the supports of the kind '{one_sided}' did not settle within {counted(max_rounds, 'round')} of contact; "
        "reduce the force"
    )
