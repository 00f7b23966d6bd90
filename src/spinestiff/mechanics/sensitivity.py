"""Implicit differentiation of an equilibrium (Eqs. 6-7).

With the force f = -dE/dx and the tangent K = d2E/dx2 = -df/dx, equilibrium at all k gives

    K dx/dk = df/dk = -d(dE/dx)/dk                                   (Eq. 6, forward)
    (dx/dk)^T g = -(d(dE/dx)/dk)^T u   with   K u = g                (Eq. 7, adjoint)

for log ratios k = log xi, which scale a force share f_xi by itself: d(dE/dx)/d log xi = -f_xi. The place of what is
held is such a parameter, too. The pad of a shoulder acts as a force that grows with its motion. A held degree of
freedom h that moves by dh takes the free ones x along, K dx = -K_h dh, with K_h its column of the tangent.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spinestiff.anatomy.state import TorsoState, state_digest
from spinestiff.anatomy.stiffness import ParameterGroup, StiffnessRatios
from spinestiff.arrays import Floats
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.factor import symmetric_product
from spinestiff.mechanics.loads import LoadCase
from spinestiff.mechanics.places import held_pelvis, shoulder_force
from spinestiff.mechanics.quasi_newton import FrameFactor
from spinestiff.mechanics.result import Equilibrium
from spinestiff.mechanics.system import Factorised, System
from spinestiff.mechanics.terms import Term

# Above this relative residual a derivative is as wrong as the state (measured: error ~ residual).
LARGEST_RELATIVE_RESIDUAL = 1e-8
LINEAR_RESIDUAL = 1e-10


class Linearisation:
    """The factorised true tangent at one converged equilibrium.

    ``tangent``: that tangent, if the caller has just factorised it (``EquilibriumProblem.solve_linearised``).

    Raises
    ------
    EquilibriumError : the equilibrium has not converged, its residual exceeds 1e-8 of the load, or its tangent
        is not positive definite.
    """

    def __init__(
        self,
        system: System,
        equilibrium: Equilibrium,
        load: LoadCase,
        ratios: StiffnessRatios | None,
        tangent: Factorised | None = None,
    ) -> None:
        equilibrium.require()
        self._system = system
        self._state = equilibrium.state
        self._digest = state_digest(equilibrium.state)
        self._stiffness = system.potential.stiffness(ratios)
        terms = system.all_terms(load)
        gradient = system.potential.gradient(self._state, self._stiffness, terms)
        residual = system.residual_norm(system.free(gradient))
        limit = max(LARGEST_RELATIVE_RESIDUAL * load.size, system.tolerance(load))
        if residual > limit:
            loose = equilibrium.residual_norm > limit
            why = "solve to a smaller tolerance" if loose else "the state, load and ratios do not belong together"
            raise EquilibriumError(f"no derivative at a residual of {residual:.1e} N under {load.size:.0f} N: {why}")
        self._hessian, self._factor = tangent or system.tangent(self._state, self._stiffness, terms)
        if not self._factor.positive_definite:
            raise EquilibriumError("no derivative at a state that is no energy minimum (indefinite tangent)")

    @property
    def state(self) -> TorsoState:
        return self._state

    @property
    def system(self) -> System:
        return self._system

    def new_frame_factor(self) -> FrameFactor:
        """The factor, for use at other states (``EquilibriumProblem.solve``). Each learns for itself."""
        frame = self._system.kinematics.at(self._state)
        return FrameFactor(frame, self._factor, self._system.held)

    def solve(self, rhs: Floats) -> Floats:
        """K^-1 rhs, (dofs,) or (dofs, k); rows of held DoFs are zero."""
        return self._factor.solve(self._system.free(rhs), LINEAR_RESIDUAL)

    def forward(
        self, groups: Sequence[ParameterGroup] = (), changes: Sequence[Term] = (), place: bool = False
    ) -> Floats:
        """(dofs, P + n + 2) d x / d each of several parameters (Eq. 6); one solve for all of them, none for none.

        Parameters
        ----------
        groups : P, by the log ratio of each.
        changes : n, by s for a load that grows as load + s * change.
        place : by obliquity, rad, and shoulder, mm, of ``mechanics.places.SupportPlace``, the last two columns.

        Raises
        ------
        EquilibriumError : ``place`` of a pelvis that is free to turn.
        """
        potential = self._system.potential
        if not (groups or changes or place):
            return np.zeros((potential.dofs, 0))
        gradients = [potential.ratio_gradients(self._state, self._stiffness, groups)] if groups else []
        gradients += [potential.term_gradient(change, self._state)[:, None] for change in changes]
        gradients += [one[:, None] for one in self._place_gradients()] if place else []
        columns = -self.solve(np.hstack(gradients))
        if place:
            columns[held_pelvis(self._system.torso, self._system.supports), -2] = 1.0
        return columns

    def adjoint(self, gradient: Floats, groups: Sequence[ParameterGroup]) -> Floats:
        """(P,) d L / d log ratio for ``gradient`` = dL/dx, (dofs,) (Eq. 7). One solve for any number of groups."""
        products = self._system.potential.ratio_products
        return -products(self._state, self._stiffness, groups, self.solve(gradient))

    def load_derivative(self, change: Term) -> Floats:
        """(dofs,) d x / d s for a load that grows as load + s * ``change``."""
        return -self.solve(self._system.potential.term_gradient(change, self._state))

    def place_derivative(self) -> Floats:
        """(dofs, 2) d x / d (obliquity rad, shoulder mm) of ``mechanics.places.SupportPlace`` (Eq. 6).

        Raises
        ------
        EquilibriumError : the pelvis is free to turn.
        """
        return self.forward(place=True)

    def place_adjoint(self, gradient: Floats) -> Floats:
        """(2,) d L / d (obliquity rad, shoulder mm) for ``gradient`` = dL/dx, (dofs,) (Eq. 7)."""
        turned, pushed = self._place_gradients()
        u = self.solve(gradient)
        own = gradient[held_pelvis(self._system.torso, self._system.supports)]
        return np.array([own - turned @ u, -pushed @ u])

    def _place_gradients(self) -> tuple[Floats, Floats]:
        """(dofs,) each: d(dE/dx)/d obliquity with all but the pelvis as it is, and d(dE/dx)/d shoulder."""
        system = self._system
        unit = np.zeros(system.potential.dofs)
        unit[held_pelvis(system.torso, system.supports)] = 1.0
        pattern = system.potential.pattern
        turned = symmetric_product(pattern.indptr, pattern.indices, self._hessian, unit)
        return turned, system.potential.term_gradient(shoulder_force(system.supports), self._state)

    def belongs_to(self, state: TorsoState) -> bool:
        """Whether this is the linearisation at ``state``."""
        return state_digest(state) == self._digest
