"""spinestiff.mechanics.equilibrium: Newton's method for the state of least energy (Eqs. 4-5)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.torso import TorsoState, retract
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.equilibrium import EquilibriumProblem, SolveStatus
from spinestiff.mechanics.factor import default_backend
from spinestiff.mechanics.loads import LoadCase, no_load
from spinestiff.mechanics.terms import BoneBlocks
from spinestiff.verification.blocks import holds
from spinestiff.verification.equilibria import out_of_balance, toy_load, toy_supports
from spinestiff.verification.models import make_torso, shaken, toy_torso

BACKENDS = sorted({default_backend(), "superlu"})


@pytest.fixture(scope="module")
def torso():
    return toy_torso(1, 10)


@pytest.fixture(scope="module")
def problem(torso):
    return EquilibriumProblem(torso, toy_supports(torso))


@pytest.fixture(scope="module")
def soft(torso):
    return stiffness_ratios({"tissue": 0.2, "lateral_bending": 0.3}, torso.joints.kinds)


def _column(share):
    """A bone on a turning joint under a dead weight of ``share`` of what topples it; see verification.solutions."""
    torso = make_torso(np.zeros((2, 3)), [(0, 1)], np.array([1e3, 1e3, 1e3, 1e6, 1e6, 4e3]))
    held = np.zeros((2, 6), dtype=bool)
    held[0] = True
    weight = LoadCase(PointsOnBones(np.array([1]), np.array([[0.0, 50.0, 0.0]])), np.array([[0.0, -share * 80.0, 0.0]]))
    return EquilibriumProblem(torso, holds(held)), weight


def test_eq4_eq5_solution_has_no_free_force_and_least_energy(problem, soft):
    load = toy_load()
    found = problem.solve(load, soft)
    assert found.converged
    assert found.require() is found
    stiffness, terms = problem.potential.stiffness(soft), problem.all_terms(load)
    free, _ = problem.free_gradient(found.state, stiffness, terms)
    assert problem.residual_norm(free) <= found.tolerance == pytest.approx(max(1e-10 * load.size, 1e-8))
    assert found.energy == problem.potential.energy(found.state, stiffness, terms)[0]
    random = np.random.default_rng(0)
    for size in (1e-3, 1e-1, 1.0):
        away = random.normal(size=problem.potential.dofs) * size
        away[: 6 * problem.potential.bones].reshape(-1, 6)[:, 3:] *= 0.03
        away[problem.held] = 0.0
        assert problem.potential.energy(retract(found.state, away), stiffness, terms)[0] > found.energy


def test_history_tells_every_iteration_and_the_observer_sees_the_same(problem, soft):
    seen = []
    found = problem.solve(toy_load(), soft, observer=seen.append)
    assert tuple(seen) == found.history
    assert [s.iteration for s in found.history] == list(range(len(found.history)))
    assert found.iterations == len(found.history) - 1
    assert found.factorisations >= found.iterations
    assert found.history[-1].residual == found.residual_norm


def test_loads_and_reactions_balance_in_force_and_moment(problem, soft):
    load = toy_load()
    force, moment = out_of_balance(problem.solve(load, soft), load)
    assert np.abs(force).max() < 1e-8
    assert np.abs(moment).max() < 1e-6


def test_reactions_are_named_and_summed_by_name(problem, soft):
    found = problem.solve(toy_load(), soft)
    assert [r.name for r in found.reactions] == ["bone2", "side"]
    assert found.reaction("side") == pytest.approx(found.reactions[1].force)
    with pytest.raises(EquilibriumError, match="no support 'nothing'; there are bone2, side"):
        found.reaction("nothing")
    # The side spring pulls along its own direction alone.
    assert np.cross(found.reactions[1].force, [0.8, 0.0, 0.6]) == pytest.approx(np.zeros(3), abs=1e-12)


def test_held_bones_stay_where_the_start_has_them(torso, problem, soft):
    found = problem.solve(toy_load(), soft)
    assert (found.state.bone_positions[2] == torso.rest_pose.bone_positions[2]).all()
    assert found.state.bone_rotations[2] == pytest.approx(torso.rest_pose.bone_rotations[2], abs=1e-15)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_torso_held_by_nothing_is_no_equilibrium(torso, backend):
    free = replace(toy_supports(torso, spring=False), held=np.zeros((3, 6), dtype=bool))
    found = EquilibriumProblem(torso, free, backend=backend).solve(toy_load())
    assert not found.converged
    with pytest.raises(EquilibriumError):
        found.require()


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_loose_bone_is_singular_and_the_message_says_what_to_look_for(backend):
    torso = make_torso(np.array([[0.0, 0, 0], [0, 30.0, 0]]), [(0, 1)], np.array([10.0, 10.0, 10.0, 0.0, 0.0, 0.0]))
    held = np.zeros((2, 6), dtype=bool)
    held[0] = True
    push = LoadCase(PointsOnBones(np.array([1]), np.array([[5.0, 5.0, 0.0]])), np.array([[1.0, 2.0, 3.0]]))
    found = EquilibriumProblem(torso, holds(held), backend=backend).solve(push)
    assert not found.converged
    with pytest.raises(EquilibriumError, match=r"held by nothing|stability|no lower energy|iteration limit"):
        found.require()


def test_a_status_carries_cause_and_remedy_and_require_exits_with_3(problem, soft):
    found = problem.solve(toy_load(), soft, max_iterations=1)
    assert found.status is SolveStatus.ITERATION_LIMIT
    assert not found.converged
    with pytest.raises(
        EquilibriumError, match=r"iteration limit; .*reduce the force or raise the ratios \(residual"
    ) as error:
        found.require()
    assert error.value.exit_status == 3
    failures = [s for s in SolveStatus if s is not SolveStatus.CONVERGED]
    assert all(";" in s.value and len(s.value) > 40 for s in failures)


def test_eq4_a_column_stands_below_its_critical_load_and_is_a_saddle_above():
    problem, weight = _column(0.99)
    assert problem.solve(weight).converged
    problem, weight = _column(1.01)
    found = problem.solve(weight)
    assert found.status is SolveStatus.SADDLE
    # Balanced from the first iteration on, it is still no minimum.
    assert problem.solve(weight, start=found.state).status is SolveStatus.SADDLE


def test_an_indefinite_start_is_left_by_projected_steps_towards_a_minimum():
    problem, weight = _column(1.3)
    rest = problem.torso.rest_pose
    tilted = TorsoState(
        rest.bone_positions, np.stack([np.eye(3), exp_so3(np.array([0.0, 0.0, 0.02]))]), rest.tissue_positions
    )
    found = problem.solve(weight, start=tilted)
    assert found.converged
    assert any(step.projected for step in found.history)
    assert np.diff([step.energy for step in found.history]).max() <= 1e-9
    # k theta = P L sin(theta), a closed form.
    angle = np.arctan2(found.state.bone_rotations[1, 1, 0], found.state.bone_rotations[1, 0, 0])
    assert 4e3 * angle == pytest.approx(1.3 * 4e3 * np.sin(angle), rel=1e-9)
    assert angle > 0.5


@pytest.mark.parametrize("seed", range(6))
def test_energy_never_rises_from_far_starts(torso, problem, seed):
    """Full Newton steps would overshoot here: the line search has to cut some."""
    ratios = stiffness_ratios({"tissue": 0.05, "lateral_bending": 0.1}, torso.joints.kinds)
    far = shaken(torso, seed, turn=0.3, move=1.5)
    positions, rotations = far.bone_positions.copy(), far.bone_rotations.copy()
    positions[-1], rotations[-1] = torso.rest_pose.bone_positions[-1], torso.rest_pose.bone_rotations[-1]
    seen = []
    problem.solve(
        toy_load(20.0), ratios, start=TorsoState(positions, rotations, far.tissue_positions), observer=seen.append
    )
    first = seen[: 1 + next((i for i, (a, b) in enumerate(zip(seen, seen[1:])) if b.iteration == 0), len(seen) - 1)]
    energies = np.array([step.energy for step in first])
    assert np.isfinite(energies).all()
    assert (np.diff(energies) <= 1e-12 * np.abs(energies).max()).all()


def test_an_inverted_start_falls_back_to_the_rest_pose(torso, problem, soft):
    rest = torso.rest_pose
    inverted = TorsoState(rest.bone_positions, rest.bone_rotations, -rest.tissue_positions)
    found, direct = (problem.solve(toy_load(), soft, start=s) for s in (inverted, None))
    assert found.converged
    assert found.state.tissue_positions == pytest.approx(direct.state.tissue_positions, abs=1e-9)


def test_a_failed_start_falls_back_to_rest_then_to_load_steps(problem, soft, monkeypatch):
    """The order of attempts: given start, rest pose, then quarters of the load, each from the last."""
    tried, real = [], EquilibriumProblem._newton

    def failing(self, load, ratios, state, *rest):
        at_rest = state is self.torso.rest_pose
        tried.append((round(load.size, 6), at_rest))
        result = real(self, load, ratios, state, *rest)
        whole = load.size > 0.99 * toy_load().size
        return replace(result, status=SolveStatus.STALLED) if whole and len(tried) <= 2 else result

    monkeypatch.setattr(EquilibriumProblem, "_newton", failing)
    load = toy_load()
    found = problem.solve(load, soft, start=shaken(problem.torso, 1, 0.01, 0.1))
    sizes = [round(share * load.size, 6) for share in (1.0, 1.0, 0.25, 0.5, 0.75, 1.0)]
    assert tried == list(zip(sizes, [False, True, True, False, False, False]))
    assert found.converged
    monkeypatch.undo()
    assert found.state.tissue_positions == pytest.approx(problem.solve(load, soft).state.tissue_positions, abs=1e-8)
    assert found.factorisations > problem.solve(load, soft).factorisations


def test_load_steps_that_fail_too_return_the_failure(problem, soft, monkeypatch):
    real = EquilibriumProblem._newton
    monkeypatch.setattr(
        EquilibriumProblem, "_newton", lambda self, *a: replace(real(self, *a), status=SolveStatus.STALLED)
    )
    found = problem.solve(toy_load(), soft)
    assert found.status is SolveStatus.STALLED
    with pytest.raises(EquilibriumError, match="line search"):
        found.require()


@pytest.mark.parametrize("tissue", [0.005, 0.02, 0.2, 5.0])
@pytest.mark.parametrize("bending", [0.005, 5.0])
def test_the_whole_range_of_ratios_is_solved(torso, problem, tissue, bending):
    ratios = stiffness_ratios({"tissue": tissue, "lateral_bending": bending}, torso.joints.kinds)
    found = problem.solve(toy_load(5.0), ratios)
    assert found.converged
    assert found.smallest_j > 0.0


def test_more_load_moves_more_and_no_load_nothing(torso, problem, soft):
    ways = [
        np.abs(problem.solve(toy_load(f), soft).state.bone_positions - torso.rest_pose.bone_positions).max()
        for f in (1, 5, 20)
    ]
    assert 0.0 < ways[0] < ways[1] < ways[2]
    still = problem.solve(no_load(), soft)
    assert still.converged
    assert (still.state.bone_positions == torso.rest_pose.bone_positions).all()


class _Pull:
    """A further energy handed in from outside: (x_b - x0)^2 k / 2 of one bone's origin along x."""

    def __init__(self, bone, place, k):
        self.bone, self.place, self.k = bone, place, k

    def energy(self, state):
        return 0.5 * self.k * (state.bone_positions[self.bone, 0] - self.place) ** 2

    def blocks(self, state):
        gradient, hessian = np.zeros((1, 6)), np.zeros((1, 6, 6))
        gradient[0, 0] = self.k * (state.bone_positions[self.bone, 0] - self.place)
        hessian[0, 0, 0] = self.k
        return BoneBlocks(np.array([self.bone]), gradient, hessian)


def test_terms_from_outside_take_part_and_do_not_change_the_problem_they_came_from(torso, problem, soft):
    wanted = torso.rest_pose.bone_positions[0, 0] + 4.0
    pulled = problem.with_terms([_Pull(0, wanted, 1e6)]).solve(no_load(), soft).require()
    assert pulled.state.bone_positions[0, 0] == pytest.approx(wanted, abs=1e-2)
    assert problem.terms == ()
    assert (problem.solve(no_load(), soft).state.bone_positions == torso.rest_pose.bone_positions).all()


def test_a_looser_tolerance_is_taken_at_its_word(problem, soft):
    load = toy_load()
    loose = problem.solve(load, soft, tolerance=1e-2)
    assert loose.converged
    assert loose.residual_norm <= 1e-2
    assert loose.iterations < problem.solve(load, soft).iterations
