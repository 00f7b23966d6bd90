"""Equilibrium as a differentiable function of parameters, without any framework: values, jvp and vjp.

The parameters p are the log ratios of groups of stiffnesses and, where wanted, a factor on the load. Outputs are the
pose: positions t (B, 3) and rotations R (B, 3, 3) of bones, positions of free tissue nodes (F, 3). The engine's
degrees of freedom turn a bone from the left, so with K dx/dp = -G (Eq. 6) and dx = (dt, w, dn)

    dR = [w]x R,          <C, dR> = w . axial(C R^T),   axial(M) = (M32 - M23, M13 - M31, M21 - M12),

which turns cotangents C of rotation matrices into the moments that Eq. 7's adjoint takes.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from spinestiff.anatomy.rotation import cross_matrix
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import ParameterGroup, StiffnessRatios
from spinestiff.arrays import Floats, read_only
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.equilibrium import Equilibrium, EquilibriumProblem
from spinestiff.mechanics.loads import LoadCase
from spinestiff.mechanics.sensitivity import Linearisation

LARGEST_LOG = 700.0  # of a ratio; from 710 on no double holds it, nor the inverse


class Pose(NamedTuple):
    """Bone positions (B, 3) mm, bone rotations (B, 3, 3), free nodes (F, 3) mm; or tangents or cotangents of them."""

    positions: Floats
    rotations: Floats
    nodes: Floats


class DifferentiableEquilibrium:
    """The map from parameters to the pose in equilibrium. Holds no state between calls but its last solution.

    Parameters
    ----------
    problem, load : what is solved.
    groups : the stiffnesses that parameter i scales by exp(p_i).
    load_factor : whether one more parameter, the last, is a factor on the load (1 = the load as given).
    """

    def __init__(
        self, problem: EquilibriumProblem, load: LoadCase, groups: Sequence[ParameterGroup], load_factor: bool = False
    ) -> None:
        self.problem, self.load, self.groups, self.load_factor = problem, load, tuple(groups), load_factor
        self._last: SolvedPose | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """(P,) what each parameter is."""
        return (*(f"log {group.name}" for group in self.groups), *(("load factor",) if self.load_factor else ()))

    def solve(self, parameters: Floats, start: TorsoState | Linearisation | None = None) -> SolvedPose:
        """The equilibrium at ``parameters`` (P,), found from ``start`` (as in ``EquilibriumProblem.solve``).

        Raises
        ------
        EquilibriumError : wrong number of parameters, a value that is not finite, a ratio that no number holds, or no
            equilibrium.
        """
        parameters = read_only("parameters", parameters, (len(self.names),), EquilibriumError)
        for group, value in zip(self.groups, parameters.tolist()):
            if abs(value) > LARGEST_LOG:
                limits = f"from {-LARGEST_LOG:g} to {LARGEST_LOG:g}"
                raise EquilibriumError(f"log {group.name} is {value:g}; wanted {limits}")
        self._last = SolvedPose(self, parameters, start)
        return self._last

    def at(self, parameters: Floats, pose: Pose) -> SolvedPose:
        """The equilibrium at ``parameters`` from a pose that ``solve`` gave; free if it was the last one.

        For frameworks that keep nothing but arrays between a function's value and its derivative.
        """
        last = self._last
        if last is not None and all(map(np.array_equal, (last.parameters, *last.pose), (parameters, *pose))):
            return last
        return self.solve(parameters, TorsoState(*pose))

    def case(self, parameters: Floats) -> tuple[LoadCase, StiffnessRatios | None]:
        """Load and ratios at ``parameters`` (P,)."""
        count = len(self.groups)
        load = self.load.scaled(float(parameters[count])) if self.load_factor else self.load
        return load, StiffnessRatios(self.groups, np.exp(parameters[:count])) if count else None


class SolvedPose:
    """One equilibrium, and its derivatives. The tangent is factorised when the first derivative is asked for.

    Attributes
    ----------
    parameters : (P,). equilibrium : converged. pose : its state as three arrays.
    """

    def __init__(
        self, model: DifferentiableEquilibrium, parameters: Floats, start: TorsoState | Linearisation | None
    ) -> None:
        self.model, self.parameters = model, parameters
        load, ratios = model.case(parameters)
        self.equilibrium: Equilibrium = model.problem.solve(load, ratios, start=start).require()
        state = self.equilibrium.state
        self.pose = Pose(state.bone_positions, state.bone_rotations, state.tissue_positions)

    def jvp(self, tangent: Floats) -> Pose:
        """Tangents of the pose for a ``tangent`` (P,) of the parameters (Eq. 6): one solve."""
        tangent = read_only("tangent", tangent, self.parameters.shape, EquilibriumError)
        problem, count = self.model.problem, len(self.model.groups)
        _, ratios = self.model.case(self.parameters)
        stiffness = problem.potential.stiffness(ratios)
        shares = problem.potential.ratio_gradients(self.equilibrium.state, stiffness, self.model.groups)
        moved = -self.tangent.solve(shares @ tangent[:count])
        if self.model.load_factor:
            moved = moved + tangent[count] * self._per_load
        bones = moved[: 6 * problem.potential.bones].reshape(-1, 6)
        turned = cross_matrix(bones[:, 3:]) @ self.pose.rotations
        return Pose(bones[:, :3].copy(), turned, moved[bones.size :].reshape(-1, 3).copy())

    def vjp(self, cotangent: Pose) -> Floats:
        """(P,) derivative of <cotangent, pose> by the adjoint (Eq. 7): one solve for any number of groups."""
        positions, rotations, nodes = (
            read_only(f"cotangent of {name}", value, own.shape, EquilibriumError)
            for name, value, own in zip(Pose._fields, cotangent, self.pose)
        )
        m = rotations @ np.swapaxes(self.pose.rotations, 1, 2)
        axial = np.stack([m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]], 1)
        gradient = np.concatenate([np.hstack([positions, axial]).ravel(), nodes.ravel()])
        derivative = self.tangent.adjoint(gradient, self.model.groups)
        return np.append(derivative, self._per_load @ gradient) if self.model.load_factor else derivative

    @cached_property
    def tangent(self) -> Linearisation:
        """The factorised tangent; also the quickest start for a solve near by."""
        return self.model.problem.linearise(self.equilibrium, *self.model.case(self.parameters))

    @cached_property
    def _per_load(self) -> Floats:
        """(dofs,) d x / d load factor."""
        return self.tangent.load_derivative(self.model.load)
