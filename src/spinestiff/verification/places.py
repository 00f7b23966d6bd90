"""Checks of equilibria in the place of what is held: turned with the pelvis as a whole, and derivatives (Eqs. 6-7)"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import no_load
from spinestiff.mechanics.places import OBLIQUITY, SupportPlace
from spinestiff.mechanics.supports import SupportKind, Supports
from spinestiff.mechanics.terms import PointSprings
from spinestiff.verification.derivatives import taylor_slopes
from spinestiff.verification.equilibria import SOFT, astray, motion, toy_load
from spinestiff.verification.models import toy_torso
from spinestiff.verification.oracle import EnergyOracle, complex_step_gradient, hessian_times
from spinestiff.verification.outcome import Check, compared, judged, vanishing
from spinestiff.verification.transforms import moved_state

PARAMETERS = ("obliquity", "shoulder")
ASKEW = SupportPlace(obliquity=0.08, shoulder_mm=-4.0)
STEPS = (1e-3, 0.05)  # rad, mm, of differences


def pelvic_torso(seed: int, nodes: int) -> TorsoModel:
    """The toy torso whose last bone is a pelvis."""
    return replace(toy_torso(seed, nodes), bone_names=("upper", "middle", "pelvis"))


def placed_supports(torso: TorsoModel, springs: bool = True) -> Supports:
    """The pelvis held; the first bone on an oblique shoulder's pad and on a wall that stays where it is."""
    held = np.zeros((len(torso.bone_names), 6), dtype=bool)
    held[torso.bone("pelvis")] = True
    kinds = (SupportKind.SHOULDER, SupportKind.WALL) if springs else ()
    count = len(kinds)
    points = PointsOnBones(np.zeros(count, np.int64), np.array([[2.0, -3.0, 1.0], [-4.0, 1.0, -2.0]])[:count])
    directions = np.array([[0.8, 0.0, 0.6], [0.6, 0.0, 0.8]])[:count]
    stiffness = np.array([100.0, 20.0])[:count]
    return Supports(
        held, PointSprings(points, points.positions(torso.rest_pose), directions, stiffness), ("upper",) * count, kinds
    )


def rigid_turn() -> Iterator[Check]:
    """Nothing but the pelvis holds the torso and nothing loads it: it turns with the pelvis as a whole, unstrained."""
    for nodes in (4, 10):
        torso = pelvic_torso(1, nodes)
        rest = torso.rest_pose
        problem = EquilibriumProblem(torso, placed_supports(torso, springs=False))
        placed = problem.with_place(SupportPlace(obliquity=0.3))
        turn = exp_so3(np.array([[0.0, 0.0, 0.3]]))[0]
        about = rest.bone_positions[torso.bone("pelvis")]
        wanted = motion(rest, moved_state(rest, turn, about - turn @ about))
        # From another shape, too: the rest pose, turned, is the answer itself.
        for start, state in (("elsewhere", astray(torso, 0)), ("rest", None)):
            found = placed.solve(no_load(), start=state, tolerance=1e-9).require()
            name = f"pelvis turned, from {start}, {nodes} nodes"
            yield compared(f"C4 place: {name}, motion", motion(rest, found.state), wanted, 1e-9)
            # One bone moved by a tenth of a mm costs about 1 N mm.
            yield vanishing(f"C4 place: {name}, energy, N mm", found.energy, 1.0, 1e-10)
        slope = placed.linearise(found, no_load()).place_derivative()[:, 0]
        axis = np.array([0.0, 0.0, 1.0])
        bones = np.hstack([np.cross(axis, found.state.bone_positions - about), np.tile(axis, (3, 1))])
        rigid = np.concatenate([bones.ravel(), np.cross(axis, found.state.tissue_positions - about).ravel()])
        yield compared(f"D1 place: forward derivative of a rigid turn, {nodes} nodes", slope, rigid, 1e-10)


class _Case:
    """A soft torso in equilibrium at a place that is not rest, and a linear goal of its motion."""

    def __init__(self, nodes: int) -> None:
        self.torso = pelvic_torso(1, nodes)
        self.problem = EquilibriumProblem(self.torso, placed_supports(self.torso))
        self.load = toy_load(40.0)
        self.ratios = stiffness_ratios(SOFT, self.torso.joints.kinds)
        # Tighter than the default 1e-10 of the load: differences of solves are taken.
        self.fine = 1e-12 * self.load.size
        askew = self.problem.with_place(ASKEW)
        self.found = askew.solve(self.load, self.ratios, tolerance=self.fine).require()
        self.tangent = askew.linearise(self.found, self.load, self.ratios)
        self.goal = np.random.default_rng(3).normal(size=self.found.state.dofs)

    def moved(self, change: Floats) -> Floats:
        """(dofs,) the motion that a change (2,) of the place brings about, by a solve."""
        place = SupportPlace(ASKEW.obliquity + float(change[0]), ASKEW.shoulder_mm + float(change[1]))
        start = self.found.state
        found = self.problem.with_place(place).solve(self.load, self.ratios, start=start, tolerance=self.fine)
        return motion(start, found.require().state)

    def along(self, direction: Floats) -> Callable[[float], float]:
        """The goal as a function of the step in the place along ``direction``."""
        return lambda step: float(self.goal @ self.moved(step * direction))

    def oracle(self, shoulder_mm: float) -> EnergyOracle:
        """The second energy around the equilibrium, with the pad at ``shoulder_mm``."""
        springs = self.problem.supports.springs
        pads = springs.targets + shoulder_mm * np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
        held = (springs.points, pads, springs.directions, springs.stiffness)
        return EnergyOracle(self.torso, self.found.state, self.ratios, (self.load.points, self.load.forces), held)


def place_derivatives() -> Iterator[Check]:
    """Derivatives in the place, at one that is not rest: by the second energy, each other and whole solves."""
    for nodes in (4, 10):
        case = _Case(nodes)
        forward, adjoint = case.tangent.place_derivative(), case.tangent.place_adjoint(case.goal)
        yield compared(f"D1 place: adjoint against forward, {nodes} nodes", adjoint, case.goal @ forward, 1e-10)

        # What a place changes of the forces, the motion that it brings about undoes.
        dofs = case.problem.potential.dofs
        free, here = np.setdiff1d(np.arange(dofs), case.problem.held).tolist(), case.oracle(ASKEW.shoulder_mm)
        left = [hessian_times(here, column, free) for column in forward.T]
        pelvis = np.eye(dofs)[6 * case.torso.bone("pelvis") + OBLIQUITY]
        turned = float(np.abs(hessian_times(here, pelvis, free)).max())
        yield vanishing(f"D1 place: obliquity by the second energy, {nodes} nodes", left[0], turned, 1e-10)
        ends = [ASKEW.shoulder_mm + change for change in (-0.5, 0.5)]
        before, after = (complex_step_gradient(case.oracle(end), np.zeros(dofs), free) for end in ends)
        name = f"D1 place: shoulder by the second energy, {nodes} nodes"
        yield compared(name, left[1], before - after, 1e-10)

        for i, name in enumerate(PARAMETERS):
            unit = STEPS[i] * np.eye(2)[i]
            total = sum(w * (case.moved(k * unit) - case.moved(-k * unit)) for k, w in ((1, 8 / 12), (2, -1 / 12)))
            name = f"D3 place: d state / d {name} against differences, {nodes} nodes"
            yield compared(name, forward[:, i], total / STEPS[i], 1e-6)

        # With the gradient's signs, so that the two parts do not cancel.
        direction = np.sign(adjoint) * [0.6, 25.0]
        without, remainder = taylor_slopes(case.along(direction), float(adjoint @ direction), 0.02, 5)
        yield judged(f"D2 place: slope of the remainder less 2, {nodes} nodes", np.abs(remainder - 2.0).max(), 0.05)
        yield judged(f"D2 place: slope without the gradient less 1, {nodes} nodes", np.abs(without - 1.0).max(), 0.05)


GROUPS = (rigid_turn, place_derivatives)
