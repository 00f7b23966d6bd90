"""Checks on the template's whole torso: 49 bones, 67 joints, thousands of elements."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.resources import files

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.rotation import log_so3
from spinestiff.anatomy.state import retract
from spinestiff.anatomy.stiffness import StiffnessRatios, stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.mechanics.equilibrium import Equilibrium, EquilibriumProblem
from spinestiff.mechanics.loads import LoadCase, no_load, rib_push
from spinestiff.mechanics.multilevel import TWO_LEVEL
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.verification.derivatives import taylor_slopes
from spinestiff.verification.energies import GRADIENT_TOLERANCE, HESSIAN_TOLERANCE
from spinestiff.verification.equilibria import out_of_balance
from spinestiff.verification.oracle import EnergyOracle, curvature_along, slope_along
from spinestiff.verification.outcome import GOLD, Check, compared, judged, vanishing

NAMES = {"lateral_bending": 0.3, "tissue": 0.05}


def template() -> Iterator[Check]:
    """Rest without stress, balance, derivatives and connection of the template under the three-point push."""
    torso = template_torso(157.0, "coarse")
    problem = EquilibriumProblem(torso, three_point_supports(torso, "right"))
    load, ratios = rib_push(torso, "right", 7.25, 60.0), stiffness_ratios(NAMES, torso.joints.kinds)
    rest = problem.solve(no_load())
    moved = np.abs(rest.state.bone_positions - torso.rest_pose.bone_positions).max() if rest.converged else np.inf
    yield vanishing("C6 whole torso: no load, no displacement", moved, float(torso.height_cm) * 10.0, 1e-14)

    found = problem.solve(load, ratios).require()
    force, moment = out_of_balance(found, load)
    yield vanishing("C3 whole torso: loads and reactions, force", force, load.size, 1e-10)
    yield vanishing("C3 whole torso: loads and reactions, moment", moment, 100.0 * load.size, 1e-10)
    yield from _by_the_oracle(problem, found, load, ratios)
    yield _by_conjugate_gradients(problem, found, load, ratios)
    iterative = EquilibriumProblem(torso, problem.supports, backend=TWO_LEVEL).solve(load, ratios).require().state
    there, here = (s.tissue_positions - torso.rest_pose.tissue_positions for s in (iterative, found.state))
    yield compared("C7 whole torso: equilibrium without factorising against the direct one", there, here, 1e-8)

    tangent = problem.linearise(found, load, ratios)
    corners = PointsOnBones(np.repeat(torso.vertebra_bones, 8), torso.vertebra_boxes.reshape(-1, 3))
    targets = corners.positions(torso.rest_pose)
    gradient = np.zeros(found.state.dofs)
    rows = gradient[: 6 * len(torso.bone_names)].reshape(-1, 6)
    gaps = corners.positions(found.state) - targets
    np.add.at(rows, corners.bone, np.einsum("pij,pi->pj", corners.jacobian(found.state), gaps))
    adjoint = tangent.adjoint(gradient, ratios.groups)
    yield compared(
        "D1 whole torso: adjoint against forward (Eqs. 6-7)", adjoint, gradient @ tangent.forward(ratios.groups), 1e-10
    )

    direction = np.array([0.6, -0.8])

    def goal(step: float) -> float:
        changed = ratios.with_values(ratios.values * np.exp(step * direction))
        state = problem.solve(load, changed, start=found.state).require().state
        return float(0.5 * np.sum((corners.positions(state) - targets) ** 2))

    without, remainder = taylor_slopes(goal, float(adjoint @ direction), 0.05, 3)
    yield judged("D2 whole torso: slope of the Taylor remainder less 2", np.abs(remainder - 2.0).max(), 0.05)
    yield judged("D2 whole torso: slope without the gradient less 1", np.abs(without - 1.0).max(), 0.05)


def _by_the_oracle(
    problem: EquilibriumProblem, found: Equilibrium, load: LoadCase, ratios: StiffnessRatios
) -> Iterator[Check]:
    """Force and tangent near the pushed torso's balance, along random directions, by the second energy."""
    potential, springs = problem.potential, problem.supports.springs
    held = (springs.points, springs.targets, springs.directions, springs.stiffness)
    stiffness, terms = potential.stiffness(ratios), problem.all_terms(load)
    random = np.random.default_rng(17)
    slopes: list[float] = []
    curvatures: list[float] = []
    for _ in range(2):
        first, second = random.normal(size=(2, potential.dofs))
        for vector in (first, second):
            vector[: 6 * potential.bones].reshape(-1, 6)[:, 3:] *= 0.03
        state = retract(found.state, 0.03 * second)  # in balance the forces would cancel
        oracle = EnergyOracle(problem.torso, state, ratios, (load.points, load.forces), held)
        gradient = potential.gradient(state, stiffness, terms)
        values = potential.hessian(state, stiffness, terms)
        lower = sp.csc_array((values, potential.pattern.indices, potential.pattern.indptr))
        moved = lower @ second + sp.tril(lower, -1).T @ second
        for errors, vector, wanted in (
            (slopes, gradient, slope_along(oracle, first)),
            (curvatures, moved, curvature_along(oracle, first, second)),
        ):
            errors.append(abs(float(vector @ first) - wanted) / float(np.linalg.norm(vector * first)))
    name = "whole torso, pushed, along random directions"
    # Ten times looser than for small models: with places of 500 mm and elements of 20 mm, F is known to 1e-14, and
    # small strains are its difference from the identity.
    yield judged(f"A1 gradient: {name}", np.max(slopes), 10.0 * GRADIENT_TOLERANCE)
    yield judged(f"A2 Hessian: {name}", np.max(curvatures), HESSIAN_TOLERANCE)


def _by_conjugate_gradients(
    problem: EquilibriumProblem, found: Equilibrium, load: LoadCase, ratios: StiffnessRatios
) -> Check:
    """The pushed torso's tangent: one solution by factors, one without."""
    potential = problem.potential
    stiffness, terms = potential.stiffness(ratios), problem.all_terms(load)
    values = potential.hessian(found.state, stiffness, terms)
    lower = sp.csc_array((values, potential.pattern.indices, potential.pattern.indptr), shape=(potential.dofs,) * 2)
    free = np.setdiff1d(np.arange(potential.dofs), problem.held)
    full = sp.csr_array(lower + sp.tril(lower, -1).T)[free][:, free]
    right = np.random.default_rng(18).normal(size=potential.dofs)
    right[problem.held] = 0.0
    scale = 1.0 / np.sqrt(full.diagonal())
    scaled = sp.diags_array(scale) @ full @ sp.diags_array(scale)
    answer, stopped = spla.cg(scaled, scale * right[free], rtol=1e-12, maxiter=20_000)
    direct = problem.numeric_factor(values).solve(right)[free]
    name = "C7 whole torso: tangent against conjugate gradients"
    return compared(name, direct, scale * answer, 1e-8) if stopped == 0 else judged(name, np.inf, 1e-8)


GOLD_FILE = "gold.json"
GOLD_TOLERANCE = 1e-6


def gold_values() -> dict[str, float]:
    """Numbers of the shipped model, to be noticed when they change; by name.

    Each stands beside independent checks of the same quantity: meshes A7, joints B4, states C2 and C3, slopes D1 and
    D2. ``tools/rewrite_gold.py`` stores them.
    """
    values: dict[str, float] = {}
    for mesh in ("coarse", "fine"):
        torso = template_torso(157.0, mesh)
        values[f"{mesh} mesh: nodes"] = float(len(torso.tissue.rest_positions))
        values[f"{mesh} mesh: volume, mm3"] = float(torso.tissue.corner_volumes().sum())
    torso = template_torso(157.0, "coarse")
    values["tissue: mu, MPa"] = float(torso.tissue.lame_mu[0])
    values["joints: sum of stiffnesses, N/mm"] = float(torso.joints.stiffness[:, :3].sum())
    problem, load = EquilibriumProblem(torso, three_point_supports(torso, "right")), rib_push(torso, "right", 8.0, 60.0)
    for name, ratios in (("default", None), ("soft", stiffness_ratios(NAMES, torso.joints.kinds))):
        found = problem.solve(load, ratios).require()
        turns = found.state.bone_rotations @ np.swapaxes(torso.rest_pose.bone_rotations, 1, 2)
        tilt = np.rad2deg(log_so3(turns)[torso.vertebra_bones, 2])
        shift = found.state.bone_positions[torso.bone("T8")] - torso.rest_pose.bone_positions[torso.bone("T8")]
        values[f"{name}, 60 N at rib 8: T8 to the left, mm"] = float(shift[0])
        values[f"{name}, 60 N at rib 8: largest difference of tilt, degrees"] = float(tilt.max() - tilt.min())
        values[f"{name}, 60 N at rib 8: shoulder reaction, N"] = float(found.reaction("shoulder")[0])
        values[f"{name}, 60 N at rib 8: energy without the load's, N mm"] = found.energy - load.energy(found.state)
    assert ratios is not None
    gradient = np.zeros(found.state.dofs)
    gradient[6 * torso.bone("T8")] = 1.0
    slopes = problem.linearise(found, load, ratios).adjoint(gradient, ratios.groups)
    for name, slope in zip(ratios.names, slopes):
        values[f"soft, 60 N at rib 8: d T8 to the left / d log {name}, mm"] = float(slope)
    return values


def gold() -> Iterator[Check]:
    """The shipped model's numbers against those stored: a change to be meant, not an error by itself."""
    stored = json.loads(files("spinestiff.verification").joinpath(GOLD_FILE).read_text(encoding="utf-8"))["values"]
    found = gold_values()
    for name in sorted(stored.keys() | found.keys()):
        yield compared(f"gold: {name}", found.get(name, np.nan), stored.get(name, np.nan), GOLD_TOLERANCE, kind=GOLD)


GROUPS = (template, gold)
