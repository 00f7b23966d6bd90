"""Newton's method for the equilibrium of a torso (Eq. 5).

Steps are taken in relative coordinates (``mechanics.kinematics``), where stiff joints stay as they are in large turns.
Three things make them few and cheap:

- *Mixed steps.* What holds the torso from outside is stiff too, and no coordinates make all of it linear. A spring's
  force counts as an unknown of its own, so that the tangent turns the force that the last step predicted, not k times
  the error of second order that a large step leaves (a Hellinger-Reissner form; Magisano, Leonetti and Garcea 2017).
  That unknown is eliminated, the linear system stays the same. The energy may rise for a step.
- *Chord steps.* A factor goes on serving, and learns, as long as that is expected to be cheaper than a new one.
- *Descent.* Once a tangent was indefinite, every step has to lower the energy. It is found by conjugate gradients on
  the tangent itself, which tell where the energy is concave and go down there (Steihaug 1983); their preconditioner, a
  tangent whose negative curvature is projected out, serves for as many steps as it is good enough. Where mixed steps
  end without an equilibrium, the load is applied in steps, and then by descent alone.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.linalg import eigvalsh_tridiagonal

from spinestiff.anatomy.rotation import log_so3
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import StiffnessRatios
from spinestiff.arrays import Floats
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.factor import Factor, symmetric_product
from spinestiff.mechanics.kinematics import Frame
from spinestiff.mechanics.loads import LoadCase
from spinestiff.mechanics.quasi_newton import FrameFactor
from spinestiff.mechanics.result import Equilibrium, NewtonStep, OnNewtonStep, SolveStatus
from spinestiff.mechanics.system import Factorised, System
from spinestiff.mechanics.terms import PredictedSprings
from spinestiff.mechanics.truncated import TruncatedStep, truncated_step

LARGEST_TURN = 0.5  # rad in one step
LARGEST_MOVE = 100.0  # mm in one step
# A step may not bring the smallest J below this share of what it was.
LEAST_J_SHARE = 0.2
# The smallest share of the projection that is added to an indefinite tangent.
LEAST_PROJECTION = 1.0 / 16.0
# Of a step of descent: products with the tangent at most, their gain, and how often a way down is doubled; descent may
# take so many times the iterations of mixed steps, and so many products count as a factorisation.
MOST_PRODUCTS, GAIN, MOST_DOUBLINGS, LONGER, PRODUCTS_A_FACTORISATION = 10, 1e-3, 12, 2, 15
# A fresh factor goes on serving once the residual is below this share of the load, or of what it was.
NEAR = 0.1
# A chord step costs a twentieth of a factorisation and they grow better: a factor is kept while this many may do.
CHORD_STEPS = 25
# A tangent that is wanted at an equilibrium is taken where the residual is below this share of the load: a derivative
# is then as wrong as that.
NEARBY = 1e-6
# A tangent counts as positive definite without a factor of its own if no Ritz value of it against a factorised one is
# below this after so many Lanczos steps from a random vector.
LEAST_RITZ = 0.1
LANCZOS_STEPS = 6


class Run:
    """One solve: its attempts share the observer and the count of what they cost.

    ``always_factorise``: the tangent at an equilibrium is factorised in any case, since it is wanted (``tangent``), or
    one a little before it (``NEARBY``).
    ``largest_turn``: rad; the solve ends where a bone has turned farther from its place at rest.
    ``most_factorisations``: what all attempts may take (``work``); the solve ends after the step that has exceeded it.
    """

    def __init__(
        self,
        system: System,
        ratios: StiffnessRatios | None,
        observer: OnNewtonStep | None,
        max_iterations: int,
        tolerance: float | None,
        always_factorise: bool = False,
        largest_turn: float = np.inf,
        most_factorisations: float = np.inf,
    ) -> None:
        self.system = system
        self.potential = system.potential
        self.stiffness = system.potential.stiffness(ratios)
        self.max_iterations = max_iterations
        self.factorisations = 0
        self._products = 0  # of tangents with vectors, on descent
        self.history: list[NewtonStep] = []
        self.tangent: Factorised | None = None  # at the equilibrium, once it was factorised there or next to it
        self._projection = 1.0  # how much of the projection the next indefinite tangent gets
        if tolerance is not None and not 0.0 < tolerance < np.inf:
            raise EquilibriumError(f"tolerance {tolerance} N; wanted a finite residual above 0")
        self._tolerance = tolerance
        self._observer = observer
        self._end: SolveStatus | None = None  # of the whole solve, whatever else could be tried
        self._always_factorise = always_factorise
        self._largest_turn = largest_turn
        self._most_factorisations = most_factorisations
        system.require_held(self.stiffness)

    @property
    def work(self) -> float:
        """What was done, in units of a factorisation."""
        return self.factorisations + self._products / PRODUCTS_A_FACTORISATION

    def wants_more(self, found: Equilibrium) -> bool:
        return found.status is not SolveStatus.CONVERGED and self._end is None

    def newton(self, load: LoadCase, state: TorsoState, factor: FrameFactor | None = None) -> Equilibrium:
        """Mixed and chord steps."""
        at = Iterate(self, load, state)
        if not at.smallest_j > 0.0:
            return at.ended(SolveStatus.INVERTED_START)
        predicted: Floats | None = None
        springs = self.system.supports.springs
        chord, wanted = Chord(at), self._always_factorise
        self.tangent = None
        for iteration in range(self.max_iterations + 1):
            if at.residual <= at.tolerance:
                return at.ended(self._judged(at, factor), iteration)
            if iteration == self.max_iterations:
                break
            if factor is not None and chord.spent(at):
                at, factor, predicted, self.tangent = chord.best, None, None, None
            elif wanted and at.residual <= NEARBY * load.size:
                # It takes the last steps; so the chord's last ones, which gain least, are spared.
                factor, chord, wanted = self._wanted(at) or factor, Chord(at), False
            fresh = factor is None
            try:
                if factor is None:
                    factor = self._factor(at, self._hessian(at, predicted))
                    if factor.projected:
                        return self._descended(at, iteration, factor)
                    chord = Chord(at)
                y = _capped(-factor.solve(at.force), self.potential.bones)
            except EquilibriumError:
                return at.ended(SolveStatus.SINGULAR, iteration)
            step, there = self._admissible(at, y)
            if there is None:
                return at.ended(SolveStatus.STALLED, iteration)
            predicted = springs.extended(at.state, step * at.frame.to_world(y))
            if end := self._note(iteration, at, step, fresh, False):
                return there.ended(end)
            far = fresh and there.residual > NEAR * max(load.size, at.residual)
            if step < 1.0 or far or factor.factor.iterative:
                factor = None
            else:
                factor.learn(y, there.force - at.force)
                chord.took(there)
            at = there
        return at.ended(SolveStatus.ITERATION_LIMIT, self.max_iterations)

    def in_steps(self, load: LoadCase) -> Equilibrium:
        """The load in four steps; ends with the first that fails, seen under the whole load."""
        state = self.system.placed(self.system.torso.rest_pose)
        for share in (0.25, 0.5, 0.75, 1.0):
            found = self.newton(load.scaled(share), state)
            state = found.state
            if found.status is not SolveStatus.CONVERGED:
                return Iterate(self, load, state).ended(found.status)
        return found

    def descend(self, load: LoadCase, state: TorsoState) -> Equilibrium:
        """Steps that lower the energy."""
        at = Iterate(self, load, state)
        if not at.smallest_j > 0.0:
            return at.ended(SolveStatus.INVERTED_START)
        return self._descended(at)

    def _descended(self, at: Iterate, first: int = 0, factor: FrameFactor | None = None) -> Equilibrium:
        """Down from a place, with iterations counted from ``first``; ``factor``: one made there."""
        bones, last = self.potential.bones, first + LONGER * self.max_iterations
        radius, fresh = np.inf, True
        for iteration in range(first, last + 1):
            if at.residual <= at.tolerance:
                return at.ended(self._judged(at, None), iteration)
            if iteration == last:
                break
            hessian = self._hessian(at)
            try:
                if factor is None:
                    # The ball's radius is in the norm of the factor before.
                    factor, fresh, radius = self._factor(at, hessian), True, np.inf
                way = self._truncated(at, hessian, factor, radius)
                y = _capped(way.y, bones)
            except EquilibriumError:
                return at.ended(SolveStatus.SINGULAR, iteration)
            found = self._line_search(at, y)
            if found is None and fresh:
                return at.ended(SolveStatus.STALLED, iteration)
            if found is None:
                factor = None
                continue
            step, there = found
            if way.concave is not None:
                there = self._slid(there, _capped(way.concave, bones))
            if end := self._note(iteration, at, step, fresh, factor.projected):
                return there.ended(end)
            radius = step * way.size if step < 1.0 else max(radius, 2.0 * way.size)
            # Where elements are nearly flat, a factor made farther back leads to many short steps.
            if way.products == MOST_PRODUCTS or factor.factor.iterative or (step < 1.0 and not fresh):
                factor = None
            at, fresh = there, False
        return at.ended(SolveStatus.ITERATION_LIMIT, last)

    def _truncated(self, at: Iterate, hessian: Floats, factor: FrameFactor, radius: float) -> TruncatedStep:
        pattern, frame = self.potential.pattern, at.frame

        def tangent(y: Floats) -> Floats:
            product = symmetric_product(pattern.indptr, pattern.indices, hessian, frame.to_world(y))
            return frame.pull(self.system.free(product))

        # Where a solve costs as much as a factor, a new factor is the better use of it.
        most = 1 if factor.factor.iterative else MOST_PRODUCTS
        way = truncated_step(at.force, tangent, factor.apply, radius, most, GAIN)
        self._products += way.products
        return way

    def _slid(self, at: Iterate, down: Floats) -> Iterate:
        """As far along a way down as twice the step lowers the energy further."""
        best, step = at, 1.0
        for _ in range(MOST_DOUBLINGS):
            state = at.frame.move(step * down)
            energy, smallest_j = self.potential.energy(state, self.stiffness, at.terms)
            if not (smallest_j > LEAST_J_SHARE * min(1.0, at.smallest_j) and energy < best.energy):
                break
            best, step = Iterate(self, at.load, state, energy, smallest_j), 2.0 * step
        return best

    def tolerance(self, load: LoadCase) -> float:
        return self.system.tolerance(load) if self._tolerance is None else self._tolerance

    def _hessian(self, at: Iterate, predicted: Floats | None = None) -> Floats:
        terms = at.terms
        if predicted is not None:
            springs = self.system.supports.springs
            terms = tuple(PredictedSprings(springs, predicted) if term is springs else term for term in terms)
        return self.potential.hessian(at.state, self.stiffness, terms)

    def _factor(self, at: Iterate, hessian: Floats) -> FrameFactor:
        """A positive definite factor: of the tangent, or of one that is projected."""
        factor = self._numeric(hessian)
        if factor.positive_definite:
            self._projection = 1.0
            return FrameFactor(at.frame, factor, self.system.held)
        # All of the projection is far too stiff on a long way down; while that lasts, half as much is tried each time.
        projected = self.potential.hessian(at.state, self.stiffness, at.terms, project=True)
        while True:
            share, self._projection = self._projection, max(0.5 * self._projection, LEAST_PROJECTION)
            factor = self._numeric(hessian + share * (projected - hessian))
            if factor.positive_definite or share == 1.0:
                break
            self._projection = min(1.0, 2.0 * share)
        return FrameFactor(at.frame, factor, self.system.held, projected=True)

    def _numeric(self, values: Floats) -> Factor:
        self.factorisations += 1
        return self.system.numeric_factor(values)

    def _admissible(self, at: Iterate, y: Floats) -> tuple[float, Iterate | None]:
        # The whole step, or as much of it as no element loses most of its volume over.
        step = 1.0
        for _ in range(30):
            state = at.frame.move(step * y)
            energy, smallest_j = self.potential.energy(state, self.stiffness, at.terms)
            if smallest_j > LEAST_J_SHARE * min(1.0, at.smallest_j) and np.isfinite(energy):
                return step, Iterate(self, at.load, state, energy, smallest_j)
            step *= 0.5
        return 0.0, None

    def _line_search(self, at: Iterate, y: Floats) -> tuple[float, Iterate] | None:
        slope = float(at.force @ y)
        if not slope < 0.0:
            return None
        # Near the solution energy differences drown in rounding; there a smaller residual decides.
        rounding = 1e-12 * (abs(at.energy) + sum(abs(term.energy(at.state)) for term in at.terms))
        step = 1.0
        for _ in range(40):
            state = at.frame.move(step * y)
            energy, smallest_j = self.potential.energy(state, self.stiffness, at.terms)
            if smallest_j > LEAST_J_SHARE * min(1.0, at.smallest_j):
                there = Iterate(self, at.load, state, energy, smallest_j)
                if energy <= at.energy + 1e-4 * step * slope:
                    return step, there
                if energy <= at.energy + rounding and there.residual < at.residual:
                    return step, there
            step *= 0.5
        return None

    def _judged(self, at: Iterate, factor: FrameFactor | None) -> SolveStatus:
        # Force balance is a minimum where the tangent is positive definite. It is if it is near one that is.
        spare = factor if factor is not None and not factor.projected and not self._always_factorise else None
        try:
            if spare is not None and self._least_ritz(at, spare) > LEAST_RITZ:
                return SolveStatus.CONVERGED
        except EquilibriumError:
            pass  # its own factor has to tell
        if factor is not None and self.tangent is not None and factor.factor is self.tangent.factor:
            return SolveStatus.CONVERGED  # it is near this one, by which the last steps were taken
        try:
            self.factorisations += 1
            self.tangent = self.system.tangent(at.state, self.stiffness, at.terms)
        except EquilibriumError:
            return SolveStatus.SADDLE
        return SolveStatus.CONVERGED if self.tangent.factor.positive_definite else SolveStatus.SADDLE

    def _wanted(self, at: Iterate) -> FrameFactor | None:
        """The tangent at a place that is as good as the equilibrium, which is to be left with it; None where it isn't
        positive definite."""
        self.factorisations += 1
        try:
            tangent = self.system.tangent(at.state, self.stiffness, at.terms)
        except EquilibriumError:
            return None
        if not tangent.factor.positive_definite:
            return None
        self.tangent = tangent
        return FrameFactor(at.frame, tangent.factor, self.system.held)

    def _least_ritz(self, at: Iterate, factor: FrameFactor) -> float:
        """Smallest Ritz value of K0^-1 K: about its smallest eigenvalue, which is above 0 where K is as K0 is.

        The coefficients of conjugate gradients on K with K0 as preconditioner give Lanczos' tridiagonal matrix. They
        begin with random forces as large as the square root of each unknown's stiffness, so that stiff and soft motions
        have a like share in them.
        """
        potential, free = self.potential, self.system.free
        pattern, values = potential.pattern, potential.hessian(at.state, self.stiffness, at.terms)
        size = np.sqrt(np.abs(values[pattern.indptr[:-1]]))
        r = at.frame.pull(free(size * np.random.default_rng(0).normal(size=potential.dofs)))
        z = factor.apply(r)
        p, rz = z, float(r @ z)
        if rz == 0.0:
            return np.inf  # nothing can move
        diagonal: list[float] = []
        off: list[float] = []
        carried = 0.0  # beta / alpha of the step before
        while True:
            product = symmetric_product(pattern.indptr, pattern.indices, values, at.frame.to_world(p))
            kp = at.frame.pull(free(product))
            curvature = float(p @ kp)
            if not (curvature > 0.0 and rz > 0.0):
                return 0.0
            alpha = rz / curvature
            diagonal.append(1.0 / alpha + carried)
            if len(diagonal) == LANCZOS_STEPS:
                break
            r = r - alpha * kp
            z = factor.apply(r)
            rz, last = float(r @ z), rz
            if not rz > 1e-24 * last:
                break
            beta = rz / last
            carried = beta / alpha
            off.append(np.sqrt(beta) / alpha)
            p = z + beta * p
        return float(eigvalsh_tridiagonal(diagonal, off).min())

    def _note(self, iteration: int, at: Iterate, step: float, factorised: bool, projected: bool) -> SolveStatus | None:
        self.history.append(NewtonStep(iteration, at.residual, at.energy, at.smallest_j, step, factorised, projected))
        if self._observer and self._observer(self.history[-1]):
            self._end = SolveStatus.CANCELLED
        elif self._end is None and np.isfinite(self._largest_turn) and at.turn > self._largest_turn:
            self._end = SolveStatus.FOLDED
        elif self._end is None and self.work > self._most_factorisations:
            self._end = SolveStatus.ITERATION_LIMIT
        return self._end


class Iterate:
    """A state on the way: energy, smallest J, gradient and frame, each worked out once."""

    def __init__(
        self,
        run: Run,
        load: LoadCase,
        state: TorsoState,
        energy: float | None = None,
        smallest_j: float = np.nan,
    ) -> None:
        self._run, self.load, self.state = run, load, state
        system = run.system
        self.terms = system.all_terms(load)
        if energy is None:
            energy, smallest_j = run.potential.energy(state, run.stiffness, self.terms)
        self.energy, self.smallest_j = energy, smallest_j
        self.tolerance = run.tolerance(load)
        self.residual = np.inf
        if smallest_j > 0.0:
            self.full = run.potential.gradient(state, run.stiffness, self.terms)
            self.gradient = system.free(self.full)
            self.residual = system.residual_norm(self.gradient)

    @cached_property
    def frame(self) -> Frame:
        return self._run.system.kinematics.at(self.state)

    @cached_property
    def force(self) -> Floats:
        """The gradient per relative coordinate."""
        return self.frame.pull(self.gradient)

    @property
    def turn(self) -> float:
        """rad, the largest turn of a bone from its place at rest."""
        rest = self._run.system.torso.rest_pose.bone_rotations
        turns = log_so3(self.state.bone_rotations @ np.swapaxes(rest, 1, 2))
        return float(np.linalg.norm(turns, axis=1).max())

    def ended(self, status: SolveStatus, iteration: int | None = None) -> Equilibrium:
        """The result with this as its last state."""
        run = self._run
        if iteration is not None and (end := run._note(iteration, self, 0.0, False, False)):
            status = status if status is SolveStatus.CONVERGED and end is not SolveStatus.FOLDED else end
        full = self.full if self.smallest_j > 0.0 else np.zeros(run.potential.dofs)
        reactions = run.system.reactions(self.state, full)
        return Equilibrium(
            self.state, status, self.energy, self.residual, self.tolerance, reactions, (), 0, self.smallest_j
        )


class Chord:
    """Steps on one factor: whether to take another or to factorise anew."""

    def __init__(self, start: Iterate) -> None:
        self.best = self._start = start
        self._steps = self._without_gain = 0

    def took(self, there: Iterate) -> None:
        self._steps += 1
        self._without_gain += 1
        if there.residual < self.best.residual or self._steps == 1:
            self.best, self._without_gain = there, 0

    def spent(self, at: Iterate) -> bool:
        """Whether a new factor is expected to be cheaper than to go on."""
        if self._without_gain > 2:
            return True
        if self._steps < 3:
            return False
        rate = np.log(self.best.residual / self._start.residual) / self._steps
        return bool(rate >= 0.0 or np.log(at.tolerance / at.residual) < CHORD_STEPS * rate)


def _capped(direction: Floats, bones: int) -> Floats:
    if not np.isfinite(direction).all():
        raise EquilibriumError("a step is not finite")
    rows = direction[: 6 * bones].reshape(-1, 6)
    turn = np.linalg.norm(rows[:, 3:], axis=1).max(initial=0.0) / LARGEST_TURN
    move = max(np.abs(rows[:, :3]).max(initial=0.0), np.abs(direction[6 * bones :]).max(initial=0.0)) / LARGEST_MOVE
    return direction / max(1.0, turn, move)
