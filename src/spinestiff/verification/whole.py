"""Checks on the template's whole torso: 49 bones, 67 joints, thousands of elements."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import no_load, rib_push
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.verification.derivatives import taylor_slopes
from spinestiff.verification.equilibria import out_of_balance
from spinestiff.verification.outcome import Check, compared, judged, vanishing

NAMES = {"lateral_bending": 0.3, "tissue": 0.05}


def template() -> Iterator[Check]:
    """Rest without stress, balance, derivatives and connection of the template under the three-point push."""
    torso = template_torso(157.0, "coarse")
    problem = EquilibriumProblem(torso, three_point_supports(torso, "right"))
    load, ratios = rib_push(torso, "right", 7.25, 60.0), stiffness_ratios(NAMES, torso.joints.kinds)
    rest = problem.solve(no_load())
    moved = np.abs(rest.state.bone_positions - torso.rest_pose.bone_positions).max() if rest.converged else np.inf
    yield vanishing("whole torso: no load, no displacement", moved, float(torso.height_cm) * 10.0, 1e-12)

    found = problem.solve(load, ratios).require()
    force, moment = out_of_balance(found, load)
    yield vanishing("whole torso: loads and reactions, force, N", force, float(load.size > 1.0), 1e-8)
    yield vanishing(
        "whole torso: loads and reactions, moment, N mm over 100 mm", moment, 100.0 * (load.size > 1.0), 1e-8
    )

    tangent = problem.linearise(found, load, ratios)
    corners = PointsOnBones(np.repeat(torso.vertebra_bones, 8), torso.vertebra_boxes.reshape(-1, 3))
    targets = corners.positions(torso.rest_pose)
    gradient = np.zeros(found.state.dofs)
    rows = gradient[: 6 * len(torso.bone_names)].reshape(-1, 6)
    gaps = corners.positions(found.state) - targets
    np.add.at(rows, corners.bone, np.einsum("pij,pi->pj", corners.jacobian(found.state), gaps))
    adjoint = tangent.adjoint(gradient, ratios.groups)
    yield compared(
        "whole torso: adjoint against forward (Eqs. 6-7)", adjoint, gradient @ tangent.forward(ratios.groups), 1e-10
    )

    direction = np.array([0.6, -0.8])

    def goal(step: float) -> float:
        changed = ratios.with_values(ratios.values * np.exp(step * direction))
        state = problem.solve(load, changed, start=found.state).require().state
        return float(0.5 * np.sum((corners.positions(state) - targets) ** 2))

    without, remainder = taylor_slopes(goal, float(adjoint @ direction), 0.05, 3)
    yield judged("whole torso: slope of the Taylor remainder less 2", np.abs(remainder - 2.0).max(), 0.05)
    yield judged("whole torso: slope without the gradient less 1", np.abs(without - 1.0).max(), 0.2)


GROUPS = (template,)
