"""spinestiff.mechanics.equilibrium: Newton's method for the state of least energy (Eqs. 4-5)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.rotation import exp_so3, log_so3
from spinestiff.anatomy.state import TorsoState, retract
from spinestiff.anatomy.stiffness import RATIO_BOUNDS, stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import EquilibriumError, TorsoError
from spinestiff.mechanics.equilibrium import EquilibriumProblem, SolveStatus
from spinestiff.mechanics.loads import LoadCase, no_load, rib_push
from spinestiff.mechanics.newton import Iterate, Run
from spinestiff.mechanics.places import SupportPlace
from spinestiff.mechanics.supports import SupportKind, three_point_supports
from spinestiff.mechanics.terms import TermBlocks
from spinestiff.verification.blocks import holds
from spinestiff.verification.equilibria import out_of_balance, toy_load, toy_supports
from spinestiff.verification.models import make_torso, shaken, toy_torso


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
    free = problem.free(problem.potential.gradient(found.state, stiffness, terms))
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
    assert found.factorisations >= sum(step.factorised + step.projected for step in found.history) > 0
    assert found.history[-1].residual == found.residual_norm


def test_loads_and_reactions_balance_in_force_and_moment(problem, soft):
    load = toy_load()
    force, moment = out_of_balance(problem.solve(load, soft), load)
    assert np.abs(force).max() < 1e-8
    assert np.abs(moment).max() < 1e-6


def test_reactions_are_named_and_summed_by_name(problem, soft):
    found = problem.solve(toy_load(), soft)
    assert [r.name for r in found.reactions] == ["bone2", "side"]
    assert [r.kind for r in found.reactions] == [SupportKind.HELD, SupportKind.SPRING]
    for what in ("side", SupportKind.SPRING):
        assert found.reaction(what) == pytest.approx(found.reactions[1].force)
    with pytest.raises(EquilibriumError, match="no support 'nothing'; there are held, spring, bone2, side"):
        found.reaction("nothing")
    # The side spring pulls along its own direction alone.
    assert np.cross(found.reactions[1].force, [0.8, 0.0, 0.6]) == pytest.approx(np.zeros(3), abs=1e-12)


def test_held_bones_stay_where_the_start_has_them(torso, problem, soft):
    found = problem.solve(toy_load(), soft)
    assert (found.state.bone_positions[2] == torso.rest_pose.bone_positions[2]).all()
    assert found.state.bone_rotations[2] == pytest.approx(torso.rest_pose.bone_rotations[2], abs=1e-15)


def test_a_torso_held_by_nothing_is_refused_before_solving(torso):
    free = replace(toy_supports(torso, spring=False), held=np.zeros((3, 6), dtype=bool))
    with pytest.raises(EquilibriumError, match="no equilibrium is determined: "):
        EquilibriumProblem(torso, free).solve(toy_load())


def test_a_loose_bone_is_named_before_solving():
    torso = make_torso(np.array([[0.0, 0, 0], [0, 30.0, 0]]), [(0, 1)], np.array([10.0, 10.0, 10.0, 0.0, 0.0, 0.0]))
    held = np.zeros((2, 6), dtype=bool)
    held[0] = True
    push = LoadCase(PointsOnBones(np.array([1]), np.array([[5.0, 5.0, 0.0]])), np.array([[1.0, 2.0, 3.0]]))
    with pytest.raises(EquilibriumError, match=f"{torso.bone_names[1]}.*no stiffness in alpha"):
        EquilibriumProblem(torso, holds(held)).solve(push)


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
    assert found.fault.startswith("stiffness -") and "turns most, along (0.00, 0.00, 1.00)" in found.fault
    # Balanced from the first iteration on, it is still no minimum.
    assert problem.solve(weight, start=found.state).status is SolveStatus.SADDLE


@pytest.mark.parametrize(("soft", "stiffness"), [(40, 100.0), (12, 1000.0), (12, 1.0)])
def test_a_stiff_column_that_topples_beside_soft_ones_is_seen_from_a_tangent_too(soft, stiffness):
    """Begun at a tangent, the end is probed by a few products with it: the one stiff motion has to show there."""
    count = soft + 2
    places = np.zeros((count, 3))
    places[1:, 0] = 30.0 * np.arange(1, count)
    joints = np.tile([1e3, 1e3, 1e3, 1e6, 1e6, 4e3], (count - 1, 1))
    joints[-1] *= stiffness
    torso = make_torso(places, [(0, i) for i in range(1, count)], joints)
    held = np.zeros((count, 6), dtype=bool)
    held[0] = True
    problem = EquilibriumProblem(torso, holds(held))
    weights = np.append(np.linspace(-2.0, 0.9, soft) * 80.0, 1.05 * 80.0 * stiffness)
    tops = np.tile([0.0, 50.0, 0.0], (count - 1, 1)) + torso.joints.child_position
    load = LoadCase(PointsOnBones(np.arange(1, count), tops), np.outer(weights, [0.0, -1.0, 0.0]))
    start = problem.linearise(problem.solve(no_load()), no_load())
    assert problem.solve(load, start=start).status is SolveStatus.SADDLE


def test_once_a_tangent_was_indefinite_steps_lower_the_energy_and_arrive():
    """Mixed steps ran up and down here, 45 projected tangents in 60 iterations."""
    torso = toy_torso(2, 10)
    problem = EquilibriumProblem(torso, toy_supports(torso))
    run = Run(problem, stiffness_ratios({"tissue": 0.1, "lateral_bending": 0.05}, torso.joints.kinds), None, 60, None)
    assert run.newton(toy_load(1200.0), torso.rest_pose).converged
    first = next(i for i, step in enumerate(run.history) if step.projected)
    rough = zip(run.history[first:], run.history[first + 1 :])
    changes = [(after.energy - step.energy) / abs(step.energy) for step, after in rough]
    assert len(changes) > 5
    assert max(changes) < 1e-12
    # A factor serves for several steps.
    assert sum(step.factorised for step in run.history[first:]) < 0.5 * len(changes)


def test_a_second_indefinite_tangent_gets_half_of_the_projection_and_steps_farther():
    problem, weight = _column(1.5)
    run = Run(problem, None, None, 60, None)
    at = Iterate(run, weight, problem.torso.rest_pose)
    force = np.zeros(problem.potential.dofs)
    force[11] = 1.0
    first, second = (run._factor(at, run._hessian(at)) for _ in range(2))
    assert first.factor.positive_definite and second.factor.positive_definite and second.projected
    assert second.solve(force)[11] > 1.5 * first.solve(force)[11] > 0.0


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


@pytest.mark.parametrize("lean", [1e-2, 1e-4, 1e-6])
def test_a_place_beside_a_saddle_is_left_in_few_steps(lean):
    """Just beyond its buckling load a column falls slowly, and projected tangents are far too stiff for it."""
    problem, weight = _column(1.05)
    away = np.zeros(problem.torso.rest_pose.dofs)
    away[11] = lean
    found = problem.solve(weight, start=retract(problem.torso.rest_pose, away))
    assert found.converged
    assert len(found.history) < 15
    angle = np.arctan2(found.state.bone_rotations[1, 1, 0], found.state.bone_rotations[1, 0, 0])
    assert angle == pytest.approx(1.05 * np.sin(angle), rel=1e-8)
    assert angle > 0.3


@pytest.mark.slow
def test_a_pelvis_that_turned_at_once_is_followed_in_few_steps():
    """Elements at the pelvis are nearly flat there, and no factor made at one place is of use at the next."""
    torso = template_torso(157.0, "coarse")
    problem = EquilibriumProblem(torso, three_point_supports(torso, "right", "level"))
    turned = problem.with_place(SupportPlace(np.radians(2.5), 0.0))
    found = turned.solve(rib_push(torso, "right", 8, 30.0), stiffness_ratios({"tissue": 0.1}))
    assert found.converged
    assert any(step.projected for step in found.history)
    assert len(found.history) < 40


@pytest.mark.parametrize("seed", range(6))
def test_energy_never_rises_from_far_starts(torso, problem, seed):
    """The last resort, by itself. Full Newton steps would overshoot here: the line search has to cut some."""
    ratios = stiffness_ratios({"tissue": 0.05, "lateral_bending": 0.1}, torso.joints.kinds)
    far = shaken(torso, seed, turn=0.2, move=1.0)
    positions, rotations = far.bone_positions.copy(), far.bone_rotations.copy()
    positions[-1], rotations[-1] = torso.rest_pose.bone_positions[-1], torso.rest_pose.bone_rotations[-1]
    run = Run(problem, ratios, None, 60, None)
    found = run.descend(toy_load(20.0), TorsoState(positions, rotations, far.tissue_positions))
    assert found.converged
    energies = np.array([step.energy for step in run.history])
    assert len(energies) > 3
    assert (np.diff(energies) <= 1e-12 * np.abs(energies).max()).all()


def test_an_inverted_start_falls_back_to_the_rest_pose(torso, problem, soft):
    rest = torso.rest_pose
    inverted = TorsoState(rest.bone_positions, rest.bone_rotations, -rest.tissue_positions)
    found, direct = (problem.solve(toy_load(), soft, start=s) for s in (inverted, None))
    assert found.converged
    assert found.state.tissue_positions == pytest.approx(direct.state.tissue_positions, abs=1e-9)


def _failing(monkeypatch, times):
    """Run's first ``times`` attempts at the whole load are called stalled; the list of all attempts."""
    tried = []

    def patch(name):
        real = getattr(Run, name)

        def failing(self, load, state, *rest):
            tried.append((name, round(load.size / toy_load().size, 6), state is self.system.torso.rest_pose))
            result = real(self, load, state, *rest)
            whole = sum(share == 1.0 for _, share, _ in tried)
            return replace(result, status=SolveStatus.STALLED) if tried[-1][1] == 1.0 and whole <= times else result

        monkeypatch.setattr(Run, name, failing)

    patch("newton")
    patch("descend")
    return tried


def test_a_failed_start_falls_back_to_rest_then_to_load_steps_then_to_descent(problem, soft, monkeypatch):
    load = toy_load()
    direct = problem.solve(load, soft)
    tried = _failing(monkeypatch, 3)
    start, rest = shaken(problem.torso, 1, 0.01, 0.1), problem.torso.rest_pose
    positions, rotations = start.bone_positions.copy(), start.bone_rotations.copy()
    positions[2], rotations[2] = rest.bone_positions[2], rest.bone_rotations[2]  # the bone that is held
    found = problem.solve(load, soft, start=TorsoState(positions, rotations, start.tissue_positions))
    names, shares, at_rest = zip(*tried)
    assert names == (*["newton"] * 6, "descend")
    assert shares == (1.0, 1.0, 0.25, 0.5, 0.75, 1.0, 1.0)
    assert at_rest == (False, True, True, False, False, False, False)
    assert found.converged
    assert found.state.tissue_positions == pytest.approx(direct.state.tissue_positions, abs=1e-8)
    assert found.factorisations > direct.factorisations


def test_what_fails_to_the_end_is_returned_as_a_failure(problem, soft, monkeypatch):
    _failing(monkeypatch, 9)
    found = problem.solve(toy_load(), soft)
    assert found.status is SolveStatus.STALLED
    with pytest.raises(EquilibriumError, match="no step led to a lower energy"):
        found.require()


def test_a_failure_names_bone_joint_and_element(problem, soft):
    found = problem.solve(toy_load(), soft, max_iterations=0)
    assert found.status is SolveStatus.ITERATION_LIMIT
    for what in ("force of", "bone", "joint", "element"):
        assert what in found.fault


def test_starts_that_do_not_fit_are_refused(torso, problem, soft):
    rest, load = torso.rest_pose, toy_load()
    with pytest.raises(EquilibriumError, match="the start has 3 bones"):
        problem.solve(load, soft, TorsoState(rest.bone_positions, rest.bone_rotations, rest.tissue_positions[1:]))
    with pytest.raises(EquilibriumError, match="not a tuple"):
        problem.solve(load, soft, (rest.bone_positions, rest.bone_rotations, rest.tissue_positions))
    with pytest.raises(TorsoError, match="no right-handed rotation"):
        problem.solve(load, soft, TorsoState(rest.bone_positions, 1.1 * rest.bone_rotations, rest.tissue_positions))
    # A start on a factor of what holds more could hide an instability.
    held = np.ones_like(problem.supports.held)
    stiffer = EquilibriumProblem(torso, replace(problem.supports, held=held))
    other = stiffer.linearise(stiffer.solve(load, soft), load, soft)
    with pytest.raises(EquilibriumError, match="another problem's"):
        problem.solve(load, soft, other)
    for tolerance in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(EquilibriumError, match="tolerance"):
            problem.solve(load, soft, tolerance=tolerance)


def test_a_start_that_moves_what_is_held_is_solved_there_or_not_at_all(torso, problem, soft):
    """The fallbacks begin at rest, where other places would be held."""
    rest, bone = torso.rest_pose, int(np.flatnonzero(problem.supports.held.all(axis=1))[0])
    for far in (0.5, 60.0):
        positions = rest.bone_positions.copy()
        positions[bone, 0] += far
        found = problem.solve(toy_load(), soft, TorsoState(positions, rest.bone_rotations, rest.tissue_positions))
        assert found.state.bone_positions[bone, 0] == positions[bone, 0]
    assert not found.converged


class _NoNumber:
    """An energy whose moment on a bone is not a number."""

    def energy(self, state):
        return 0.0

    def blocks(self, state):
        gradient = np.zeros((1, 6))
        gradient[0, 5] = np.nan
        return TermBlocks(np.array([0]), gradient, np.zeros((1, 6, 6)))


def test_what_is_no_number_is_no_equilibrium(problem):
    found = problem.with_terms([_NoNumber()]).solve(no_load())
    assert not found.converged


def test_an_observer_can_cancel_and_the_last_good_state_is_kept(problem, soft):
    found = problem.solve(toy_load(20.0), soft, observer=lambda step: step.iteration == 1)
    assert found.status is SolveStatus.CANCELLED
    assert len(found.history) == 2
    assert np.isfinite(found.energy)
    assert found.energy < problem.solve(toy_load(20.0), soft, observer=lambda step: True).energy
    assert problem.solve(toy_load(20.0), soft, start=found.state).converged


def test_a_torso_that_gives_way_is_left_where_a_bone_has_turned_too_far():
    problem, weight = _column(1.5)
    lean = np.zeros(problem.torso.rest_pose.dofs)
    lean[11] = 0.01
    leaning = retract(problem.torso.rest_pose, lean)
    toppled = problem.solve(weight, start=leaning)
    assert toppled.converged
    turn = np.linalg.norm(log_so3(toppled.state.bone_rotations[1]))
    folded = problem.solve(weight, start=leaning, largest_turn=0.9 * turn)
    assert folded.status is SolveStatus.FOLDED
    assert folded.iterations < toppled.iterations
    assert problem.solve(weight, start=leaning, largest_turn=1.1 * turn).converged
    with pytest.raises(EquilibriumError, match="gives way under this load"):
        problem.solve_linearised(weight, start=leaning, largest_turn=0.9 * turn)


def test_a_solve_ends_after_as_many_factorisations_as_it_may_take():
    problem, weight = _column(1.5)
    lean = np.zeros(problem.torso.rest_pose.dofs)
    lean[11] = 0.01
    leaning = retract(problem.torso.rest_pose, lean)
    needed = problem.solve(weight, start=leaning).factorisations
    assert needed > 2
    given_up = problem.solve(weight, start=leaning, most_factorisations=needed - 1)
    assert given_up.status is SolveStatus.ITERATION_LIMIT
    assert given_up.factorisations < needed
    with pytest.raises(EquilibriumError, match="not converged"):
        problem.solve_linearised(weight, start=leaning, most_factorisations=needed - 1)
    # Products with the tangent count, too.
    run = Run(problem, None, None, 60, None, most_factorisations=2.5)
    assert run.newton(weight, leaning).status is SolveStatus.ITERATION_LIMIT
    assert run.factorisations == 2 < 2.5 < run.work < 2.5 + 10 / 15
    # What has come to rest by the last of them is at rest.
    assert problem.solve(weight, start=leaning, most_factorisations=needed).converged


def test_a_linearisation_near_by_saves_factorisations(problem, soft):
    load = toy_load()
    near = problem.linearise(problem.solve(load, soft), load, soft)
    stiffer = soft.with_values(1.05 * soft.values)
    warm, cold = (problem.solve(load, stiffer, start=start) for start in (near, None))
    assert warm.converged
    assert warm.factorisations < cold.factorisations
    assert warm.state.tissue_positions == pytest.approx(cold.state.tissue_positions, abs=1e-8)


def test_other_springs_share_the_pattern_and_other_holds_are_refused(torso, problem, soft):
    springs = replace(problem.supports.springs, stiffness=2.0 * problem.supports.springs.stiffness)
    other = problem.with_supports(replace(problem.supports, springs=springs))
    direct = EquilibriumProblem(torso, other.supports).solve(toy_load(), soft)
    assert other.solve(toy_load(), soft).state.bone_positions == pytest.approx(direct.state.bone_positions, abs=1e-8)
    assert np.abs(direct.state.bone_positions - problem.solve(toy_load(), soft).state.bone_positions).max() > 1e-6
    with pytest.raises(EquilibriumError, match="other degrees of freedom"):
        problem.with_supports(replace(problem.supports, held=~problem.supports.held))


def test_supports_of_bones_that_there_are_not_are_refused(torso, problem):
    supports = problem.supports
    for rows, bones in ((supports.held[:-1], 2), (np.vstack([supports.held, supports.held[:1]]), 4)):
        with pytest.raises(TorsoError, match=f"^supports hold {bones} bones, but the torso has 3$"):
            EquilibriumProblem(torso, replace(supports, held=rows))
    far = replace(supports.springs, points=PointsOnBones(np.array([3]), np.zeros((1, 3))))
    for build in (lambda s: EquilibriumProblem(torso, s), problem.with_supports):
        with pytest.raises(TorsoError, match=r"^a support's spring holds bone 3, but the torso has 3$"):
            build(replace(supports, springs=far))


def test_a_load_on_what_the_torso_lacks_is_refused(torso, problem, soft):
    nodes, last = len(torso.tissue.free_nodes), len(torso.tissue.free_nodes) - 1
    found = problem.solve(no_load(), soft).require()
    for load, what in (
        (LoadCase(PointsOnBones(np.array([3]), np.zeros((1, 3))), np.ones((1, 3))), "bone 3, but the torso has 3"),
        (replace(no_load(), nodes=[nodes], node_forces=np.ones((1, 3))), f"free node {nodes}, but .* has {nodes}"),
    ):
        for use in (problem.solve, lambda load, ratios: problem.linearise(found, load, ratios)):
            with pytest.raises(TorsoError, match=f"^a load acts on {what}$"):
                use(load, soft)
    assert problem.solve(replace(no_load(), nodes=[last], node_forces=np.full((1, 3), 1e-3)), soft).converged


@pytest.mark.parametrize("tissue", [RATIO_BOUNDS[0], 0.02, 0.2, RATIO_BOUNDS[1]])
@pytest.mark.parametrize("bending", RATIO_BOUNDS)
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
        return TermBlocks(np.array([self.bone]), gradient, hessian)


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
