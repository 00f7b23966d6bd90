"""What a solve gives: its status, its iterations, the equilibrium."""

from __future__ import annotations

import enum
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.arrays import Floats, ShortRepr
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.supports import Reaction, SupportKind


class SolveStatus(enum.Enum):
    """How a solve ended; the text holds cause and remedy."""

    CONVERGED = "converged"
    ITERATION_LIMIT = (
        "not converged within the iteration limit; the load may exceed what this softness can carry: "
        "reduce the force or raise the ratios"
    )
    STALLED = (
        "no step led to a lower energy without folding an element; the state may be a limit point: "
        "reduce the force or start from a nearer state"
    )
    INVERTED_START = "the start state has an inverted element; start from the rest pose"
    SINGULAR = (
        "the stiffness matrix is singular or not finite; the load may be far beyond what the torso carries: "
        "reduce the force or raise the ratios"
    )
    SADDLE = "force balance without stability: the state is no energy minimum; start from a state a little to its side"
    FOLDED = (
        "a bone turned farther than it may, so that the torso gives way under this load; "
        "reduce the force or raise the ratios"
    )
    CANCELLED = "cancelled before an equilibrium was reached; the state is the last good one, to go on from"


@dataclass(frozen=True)
class NewtonStep:
    """One iteration: the state's residual N, energy N mm and smallest J, then the step that was taken from there.

    step : its length, 0 at the end. factorised : whether its tangent was factorised, or an earlier factor used.
    projected : whether the tangent's negative curvature was left out.
    """

    iteration: int
    residual: float
    energy: float
    smallest_j: float
    step: float
    factorised: bool
    projected: bool


@dataclass(frozen=True, repr=False)
class Equilibrium(ShortRepr):
    """The result of a solve; plain data.

    Attributes
    ----------
    state : the last accepted state, an equilibrium only if ``converged``.
    status : how the solve ended.
    energy : N mm, the loads' potential included.
    residual_norm : N, largest unbalanced force (moments over 30 mm).
    tolerance : N, what ``residual_norm`` was asked to reach.
    reactions : what the supports exert.
    history : one entry an iteration, of all attempts. factorisations : numeric factorisations of all attempts.
    smallest_j : smallest volume ratio at the integration points.
    fault : the bone, joint, node or element at fault where the solve failed; empty where it converged.
    """

    SHOWN_BY: ClassVar[str] = "spinestiff.mechanics.picture:html_of_equilibrium"

    state: TorsoState
    status: SolveStatus
    energy: float
    residual_norm: float
    tolerance: float
    reactions: tuple[Reaction, ...]
    history: tuple[NewtonStep, ...] = field(repr=False)
    factorisations: int
    smallest_j: float
    fault: str = ""

    @property
    def converged(self) -> bool:
        return self.status is SolveStatus.CONVERGED

    @property
    def iterations(self) -> int:
        return sum(step.step > 0.0 for step in self.history)

    def require(self) -> Equilibrium:
        """This equilibrium; raises EquilibriumError with cause and remedy unless it converged."""
        if not self.converged:
            raise EquilibriumError(f"{self.status.value} (residual {self.residual_norm:.2e} N; {self.fault})")
        return self

    def reaction(self, what: str | SupportKind) -> Floats:
        """(3,) N, summed force of the supports of a kind, or else of that name; EquilibriumError if there is none."""
        own = [r for r in self.reactions if r.kind == what] or [r for r in self.reactions if r.name == what]
        if not own:
            kinds = dict.fromkeys(str(r.kind) for r in self.reactions)
            known = ", ".join([*kinds, *dict.fromkeys(r.name for r in self.reactions)])
            raise EquilibriumError(f"no support '{what}'; there are {known}")
        return np.sum([r.force for r in own], axis=0)

    def _facts(self) -> Iterator[str]:
        yield self.status.name
        yield f"energy {self.energy:.6g} N mm"
        yield f"residual {self.residual_norm:.1e} N"
        yield f"{self.iterations} iterations"
        if self.fault:
            yield self.fault


# Sees every iteration of a solve; a true answer cancels it.
OnNewtonStep = Callable[[NewtonStep], object]
