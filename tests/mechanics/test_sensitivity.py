"""spinestiff.mechanics.sensitivity: implicit differentiation of an equilibrium (Eqs. 6-7)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.errors import EquilibriumError, TorsoError
from spinestiff.mechanics import newton
from spinestiff.mechanics.equilibrium import EquilibriumProblem, SolveStatus
from spinestiff.mechanics.loads import LoadCase
from spinestiff.verification.blocks import holds
from spinestiff.verification.equilibria import toy_load, toy_supports
from spinestiff.verification.models import make_torso, shaken, toy_torso

NAMES = {"lateral_bending": 0.3, "tissue": 0.2, "separation": 0.7}


@pytest.fixture(scope="module", params=[4, 10])
def case(request):
    torso = toy_torso(1, request.param)
    problem, load = EquilibriumProblem(torso, toy_supports(torso)), toy_load()
    ratios = stiffness_ratios(NAMES, torso.joints.kinds)
    found = problem.solve(load, ratios).require()
    return problem, load, ratios, found, problem.linearise(found, load, ratios)


def _positions(state):
    return np.concatenate([state.bone_positions.ravel(), state.tissue_positions.ravel()])


def _moves(dofs, bones):
    return np.concatenate([dofs[: 6 * bones].reshape(-1, 6)[:, :3].ravel(), dofs[6 * bones :]])


def test_eq6_forward_sensitivity_against_differences_of_solves(case):
    problem, load, ratios, found, tangent = case
    forward, h = tangent.forward(ratios.groups), 1e-3
    for i in range(len(NAMES)):
        total = 0.0
        for k, weight in ((1, 8 / 12), (2, -1 / 12)):
            ends = [
                problem.solve(
                    load, ratios.with_values(ratios.values * np.exp(s * k * h * np.eye(3)[i])), start=found.state
                )
                for s in (1, -1)
            ]
            total = total + weight * (_positions(ends[0].require().state) - _positions(ends[1].require().state))
        wanted = total / h
        assert np.abs(_moves(forward[:, i], 3) - wanted).max() < 1e-6 * np.abs(wanted).max()


@pytest.mark.parametrize("share", [0.0, newton.NEARBY, 1e-3])
def test_a_tangent_that_is_wanted_is_taken_a_little_before_the_equilibrium(case, monkeypatch, share):
    """It takes the last steps; a derivative is about as wrong as its residual was, and no solve takes longer."""
    problem, load, ratios, _, tangent = case
    softer = ratios.with_values(0.7 * ratios.values)
    monkeypatch.setattr(newton, "NEARBY", 0.0)
    by_chord, _ = problem.solve_linearised(load, softer, tangent)
    monkeypatch.setattr(newton, "NEARBY", share)
    there, near = problem.solve_linearised(load, softer, tangent)
    assert there.residual_norm <= there.tolerance
    assert there.factorisations == by_chord.factorisations
    assert there.iterations <= by_chord.iterations - (2 if share else 0)
    wanted = problem.linearise(by_chord, load, softer).forward(ratios.groups)
    off = np.abs(near.forward(ratios.groups) - wanted).max() / np.abs(wanted).max()
    assert off < max(share, 1e-9)


def test_eq7_adjoint_equals_forward(case):
    _, _, ratios, _, tangent = case
    forward = tangent.forward(ratios.groups)
    gradient = np.random.default_rng(0).normal(size=forward.shape[0])
    assert tangent.adjoint(gradient, ratios.groups) == pytest.approx(gradient @ forward, rel=1e-10)
    assert np.abs(gradient @ forward).min() > 1e-3


def test_eq6_a_group_is_the_sum_of_its_parts(case):
    problem, _, _, _, tangent = case
    kinds = problem.torso.joints.kinds
    whole = tangent.forward(stiffness_ratios({"tissue": 1.0}, kinds).groups)
    parts = tangent.forward(stiffness_ratios({"tissue_mu": 1.0, "tissue_lambda": 1.0}, kinds).groups)
    assert parts.sum(1) == pytest.approx(whole[:, 0], abs=1e-10 * np.abs(whole).max())


def test_groups_of_another_torso_are_told(case):
    problem, _, _, _, tangent = case
    other = stiffness_ratios({"lateral_bending": 1.0}, problem.torso.joints.kinds[:1]).groups
    gradient = np.ones(len(tangent.forward()))
    for asked in (lambda: tangent.forward(other), lambda: tangent.adjoint(gradient, other)):
        with pytest.raises(TorsoError, match="'lateral_bending' names 1 joints, the torso has 2"):
            asked()


def test_raising_every_stiffness_is_lowering_the_load(case):
    """E = k E0(x) - F x: d x / d log k = -d x / d log F. Holds only without support springs."""
    problem, load, _, _, _ = case
    torso = problem.torso
    bare = EquilibriumProblem(torso, toy_supports(torso, spring=False))
    everything = stiffness_ratios({"everything": 0.4}, torso.joints.kinds)
    tangent = bare.linearise(bare.solve(load, everything).require(), load, everything)
    by_load = tangent.load_derivative(load)
    assert tangent.forward(everything.groups)[:, 0] == pytest.approx(-by_load, abs=1e-9 * np.abs(by_load).max())
    assert np.abs(by_load).max() > 0.1


def test_all_columns_of_one_solve_are_those_of_each(case):
    _, load, ratios, _, tangent = case
    changes = (load, load.scaled(-0.3))
    together = tangent.forward(ratios.groups, changes)
    apart = [tangent.forward(ratios.groups), *(tangent.load_derivative(change)[:, None] for change in changes)]
    np.testing.assert_allclose(together, np.hstack(apart), rtol=1e-9, atol=1e-12 * np.abs(together).max())
    assert tangent.forward().shape == (len(together), 0)


def test_held_degrees_of_freedom_do_not_move(case):
    problem, load, ratios, _, tangent = case
    assert (tangent.forward(ratios.groups)[problem.held] == 0.0).all()
    assert (tangent.load_derivative(load)[problem.held] == 0.0).all()
    assert (tangent.solve(np.ones(problem.potential.dofs))[problem.held] == 0.0).all()


def test_no_derivative_at_a_state_that_has_not_converged(case):
    problem, load, ratios, _, _ = case
    short = problem.solve(load, ratios, max_iterations=1)
    with pytest.raises(EquilibriumError, match="iteration limit"):
        problem.linearise(short, load, ratios)


def test_no_derivative_at_a_loosely_converged_state(case):
    problem, load, ratios, _, _ = case
    loose = problem.solve(load, ratios, tolerance=1e-3 * load.size)
    assert loose.converged
    assert loose.residual_norm > 1e-8 * load.size
    with pytest.raises(EquilibriumError, match=r"^no derivative at a residual of .*: solve to a smaller tolerance$"):
        problem.linearise(loose, load, ratios)


def test_no_derivative_where_load_ratios_or_state_are_others(case):
    problem, load, ratios, found, _ = case
    elsewhere = replace(found, state=shaken(problem.torso, 1, 0.01, 0.1))
    for wrong in ((found, load.scaled(1.001), ratios), (found, load, None), (elsewhere, load, ratios)):
        with pytest.raises(EquilibriumError, match="do not belong together"):
            problem.linearise(*wrong)


def test_no_derivative_at_a_saddle_that_calls_itself_converged():
    torso = make_torso(np.zeros((2, 3)), [(0, 1)], np.array([1e3, 1e3, 1e3, 1e6, 1e6, 4e3]))
    held = np.zeros((2, 6), dtype=bool)
    held[0] = True
    # More than k / L = 80 N on a column: force balance, but no minimum.
    weight = LoadCase(PointsOnBones(np.array([1]), np.array([[0.0, 50.0, 0.0]])), np.array([[0.0, -81.0, 0.0]]))
    problem = EquilibriumProblem(torso, holds(held))
    saddle = problem.solve(weight)
    assert saddle.status is SolveStatus.SADDLE
    with pytest.raises(EquilibriumError, match="no energy minimum"):
        problem.linearise(replace(saddle, status=SolveStatus.CONVERGED), weight)


def test_a_linearisation_knows_its_state(case):
    problem, _, _, found, tangent = case
    assert tangent.belongs_to(found.state)
    assert not tangent.belongs_to(problem.torso.rest_pose)


def test_the_tangent_at_the_state_is_used_not_that_of_the_last_iteration(case):
    """A tangent kept from the last Newton step is wrong by the last step's size; this one is exact."""
    problem, load, ratios, found, tangent = case
    stiffness, terms = problem.potential.stiffness(ratios), problem.all_terms(load)
    rhs = np.random.default_rng(5).normal(size=problem.potential.dofs)
    rhs[problem.held] = 0.0
    again = problem.factorise(found.state, stiffness, terms)
    assert again.multiply(tangent.solve(rhs)) == pytest.approx(rhs, abs=1e-9)
