"""Supports that push but cannot pull, e.g. the wall behind the back: an active set over springs.

A spring's direction n points away from the obstacle, its target lies on the surface. With the gap g = n . (x - x0) and
the contact force p along n (``Reaction.force`` . n), a consistent state has p >= 0, p = 0 where g > 0, and p = -k g
where the point is pressed in by -g. These are the conditions of least energy with k min(g, 0)^2 / 2 for each spring, so
they do not depend on the order in which springs are let go and caught again.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import StiffnessRatios
from spinestiff.anatomy.torso import TorsoModel
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
        if not supports.of_kind(self.ONE_SIDED).any():
            known = ", ".join(dict.fromkeys(map(str, supports.kinds))) or "none"
            raise EquilibriumError(f"no support of the kind '{self.ONE_SIDED}' to be one-sided; there are {known}")

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
        """Rounds of the active set until no spring is on the wrong side or a solve fails.

        In a round all springs are switched that are on the wrong side; once a set of springs comes back, the one
        farthest off alone.
        """
        springs, unilateral = self.supports.springs, self.supports.of_kind(self.ONE_SIDED)
        state = start.state if isinstance(start, Linearisation) else start
        touching = self._touching(self.torso.rest_pose if state is None else self.placed(self._checked(state)), 0.0)
        seen, one_at_a_time = set[bytes](), False
        for _ in range(MAX_ROUNDS):
            # One run for all rounds: what they cost adds up in it.
            run.system = current = self.with_acting(touching)
            found = super(OneSidedProblem, current)._solved(run, load, start)
            start, gap = found.state, springs.extension(found.state)
            # What a spring that is on the wrong side would do if it were switched, N.
            off = np.where(touching, gap, -gap) * springs.stiffness * unilateral
            wrong = off > found.tolerance
            if not (found.converged and wrong.any()):
                return found
            seen.add(touching.tobytes())
            one_at_a_time = one_at_a_time or (touching ^ wrong).tobytes() in seen
            touching = touching ^ (np.arange(len(off)) == np.argmax(off) if one_at_a_time else wrong)
        raise EquilibriumError(
            f"the supports of the kind '{self.ONE_SIDED}' did not settle within {counted(MAX_ROUNDS, 'round')} of "
            "contact; reduce the force"
        )

    def _touching(self, state: TorsoState, tolerance: float) -> np.ndarray:
        """(S,) bool, springs that are pressed in ``state``, or lie on the wall to within a force of ``tolerance``."""
        springs = self.supports.springs
        return ~self.supports.of_kind(self.ONE_SIDED) | (springs.extension(state) * springs.stiffness <= tolerance)
