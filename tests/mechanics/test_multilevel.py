"""spinestiff.mechanics.multilevel: conjugate gradients on two levels in place of a factorisation."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.anatomy.torso import TET10_EDGES
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.multilevel import TWO_LEVEL, corner_prolongation
from spinestiff.verification.equilibria import toy_load, toy_supports
from spinestiff.verification.models import toy_torso


@pytest.fixture(scope="module")
def torso():
    return toy_torso(2, 10)


@pytest.fixture(scope="module")
def problems(torso):
    return tuple(EquilibriumProblem(torso, toy_supports(torso), backend=name) for name in (None, TWO_LEVEL))


def _tangent(problem):
    rest = problem.torso.rest_pose
    return problem.potential.hessian(rest, problem.potential.stiffness(None), problem.all_terms(toy_load()))


def test_a_middle_node_moves_as_the_mean_of_its_ends(torso, problems):
    potential, mesh, rest = problems[0].potential, torso.tissue, torso.rest_pose
    p = corner_prolongation(potential)
    assert p.shape[0] == potential.dofs > p.shape[1]
    random = np.random.default_rng(0)
    moved = p @ random.normal(size=p.shape[1])
    rows = moved[: 6 * potential.bones].reshape(-1, 6)
    nodes = np.zeros_like(mesh.rest_positions)
    nodes[potential.unknowns.free] = moved[6 * potential.bones :].reshape(-1, 3)
    bone = mesh.bone_of_node[potential.unknowns.tied]
    nodes[potential.unknowns.tied] = rows[bone, :3] + np.cross(
        rows[bone, 3:], mesh.rest_positions[potential.unknowns.tied] - rest.bone_positions[bone]
    )
    checked = 0
    for middle, (a, b) in enumerate(TET10_EDGES, start=4):
        free = mesh.elements[mesh.bone_of_node[mesh.elements[:, middle]] < 0]
        assert nodes[free[:, middle]] == pytest.approx(0.5 * (nodes[free[:, a]] + nodes[free[:, b]]), abs=1e-12)
        checked += len(free)
    assert checked > 100


def test_solutions_are_those_of_a_factorisation(problems):
    direct, iterative = (problem.numeric_factor(_tangent(problem)) for problem in problems)
    assert iterative.positive_definite
    rhs = np.random.default_rng(0).normal(size=(problems[0].potential.dofs, 2))
    rhs[problems[0].held] = 0.0
    expected = direct.solve(rhs)
    assert iterative.solve(rhs) == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())
    assert iterative.solve(rhs[:, 0]) == pytest.approx(expected[:, 0], abs=1e-9 * np.abs(expected).max())
    assert iterative.inverse(rhs[:, 0]) == pytest.approx(expected[:, 0], abs=1e-2 * np.abs(expected).max())
    assert not iterative.solve(0.0 * rhs).any()


def test_an_indefinite_matrix_is_noticed_and_not_solved(problems):
    values = _tangent(problems[1])
    diagonal = problems[1].potential.pattern.indptr[:-1]
    middle = len(diagonal) // 2
    values[diagonal[middle]] *= -1.0
    factor = problems[1].numeric_factor(values)
    assert not factor.positive_definite
    with pytest.raises(EquilibriumError, match="not positive definite"):
        factor.solve(np.ones(len(diagonal)))
    values[diagonal[middle]] = np.nan
    with pytest.raises(EquilibriumError, match="not finite"):
        problems[1].numeric_factor(values)


def test_a_residual_that_the_iteration_only_believes_is_not_believed(problems, monkeypatch):
    """Conjugate gradients update their residual, which can lose touch with the true one."""
    factor = problems[1].numeric_factor(_tangent(problems[1]))
    iterate = factor._conjugate_gradients

    def drifted(b, goal, limit):
        x, definite = iterate(b, goal, limit)
        return x * (1.0 + 1e-6), definite

    rhs = np.ones(problems[0].potential.dofs)
    factor.solve(rhs)
    monkeypatch.setattr(factor, "_conjugate_gradients", drifted)
    with pytest.raises(EquilibriumError, match=r"leaves a relative residual of \d\.\de-0[67]"):
        factor.solve(rhs)


def test_equilibria_and_gradients_are_the_same(torso, problems):
    load = toy_load(5.0)
    found = [problem.solve_linearised(load) for problem in problems]
    assert found[1][0].state.tissue_positions == pytest.approx(found[0][0].state.tissue_positions, abs=1e-9)
    rhs = np.random.default_rng(1).normal(size=problems[0].potential.dofs)
    expected = found[0][1].solve(rhs)
    assert found[1][1].solve(rhs) == pytest.approx(expected, abs=1e-8 * np.abs(expected).max())
