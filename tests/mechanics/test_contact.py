"""spinestiff.mechanics.contact: supports that push but cannot pull."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import retract
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics import contact
from spinestiff.mechanics.contact import OneSidedProblem
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import LoadCase, no_load, rib_push
from spinestiff.mechanics.places import SupportPlace
from spinestiff.mechanics.supports import SupportKind, Supports, switched, three_point_supports
from spinestiff.mechanics.terms import PointSprings
from spinestiff.verification.models import make_torso

WALL = 50.0  # N/mm
SPRINGS = np.array([4.0, 1e3, 1e3, 2e4, 2e4, 2e4])


@pytest.fixture(scope="module")
def chain():
    """Four bones in a row, the first one held, three of them next to a wall at z = 0 with two points each."""
    torso = make_torso(np.outer(np.arange(4.0) * 30.0, [0.0, 1.0, 0.0]), [(0, 1), (1, 2), (2, 3)], SPRINGS)
    held = np.zeros((4, 6), dtype=bool)
    held[0] = True
    points = PointsOnBones(np.repeat([1, 2, 3], 2), np.tile([[0.0, 5.0, 0.0], [0.0, -5.0, 0.0]], (3, 1)))
    targets = points.positions(torso.rest_pose)
    springs = PointSprings(points, targets, np.tile([0.0, 0.0, 1.0], (6, 1)), np.full(6, WALL))
    return OneSidedProblem(
        torso, Supports(held, springs, tuple(f"point {i}" for i in range(6)), (SupportKind.WALL,) * 6)
    )


class Everything(set):
    """A set that holds everything."""

    def __contains__(self, _):
        return True


def force_on(bone, force, arm=0.0):
    return LoadCase(PointsOnBones(np.array([bone]), np.array([[0.0, arm, 0.0]])), np.array([force], dtype=float))


def together(*loads):
    points = [load.points for load in loads]
    bones, offsets = np.concatenate([p.bone for p in points]), np.vstack([p.offset for p in points])
    return LoadCase(PointsOnBones(bones, offsets), np.vstack([load.forces for load in loads]))


def pressures(problem, found):
    """(S,) N, of each spring along its normal: what it exerts on the torso."""
    springs = problem.supports.springs
    forces = np.array([reaction.force for reaction in found.reactions[-len(springs.stiffness) :]])
    return np.sum(springs.directions * forces, axis=1)


def assert_complementary(problem, found):
    """Of the wall p >= 0 and p = k max(-gap, 0): it acts where a point presses in, and there alone."""
    springs, wall = problem.supports.springs, problem.supports.of_kind(SupportKind.WALL)
    pressed = springs.stiffness * np.maximum(-springs.extension(found.state), 0.0)
    np.testing.assert_allclose(pressures(problem, found)[wall], pressed[wall], atol=2.0 * found.tolerance)


LOADS = [
    (1, [0.0, 0.0, -3.0], 0.0),
    (3, [0.0, 0.0, 4.0], 0.0),
    (3, [0.0, 0.0, -5.0], 20.0),
    (2, [1.0, 0.5, 3.0], -12.0),
]


@pytest.mark.parametrize("which", [(0, 1), (2,), (2, 3), (0, 3)])
def test_the_set_is_consistent_and_the_only_one(chain, which):
    load = together(*(force_on(*LOADS[i]) for i in which))
    found = chain.solve(load).require()
    assert_complementary(chain, found)
    acting, consistent = pressures(chain, found) > 0.0, []
    for bits in itertools.product([False, True], repeat=6):
        trial = EquilibriumProblem(chain.torso, switched(chain.supports, np.array(bits))).solve(load).require()
        gap = chain.supports.springs.extension(trial.state)
        if not (np.where(bits, gap, -gap) * WALL > trial.tolerance).any():
            consistent.append(np.array(bits))
    # Springs of zero force may count either way; apart from them the set found is the one of all 64 that holds.
    gap = chain.supports.springs.extension(found.state)
    assert consistent
    for bits in consistent:
        assert np.abs(gap[bits != acting] * WALL).max(initial=0.0) < 1e-6


def test_springs_are_switched_one_by_one_where_a_set_comes_back(chain, monkeypatch):
    """Both ways end on the same springs: here a set counts as seen from the first round on."""
    load = together(*(force_on(*LOADS[i]) for i in (2, 3)))
    together_ = chain.solve(load).require()
    monkeypatch.setattr(contact, "set", Everything, raising=False)
    slowly = chain.solve(load).require()
    np.testing.assert_array_equal(pressures(chain, slowly) > 0.0, pressures(chain, together_) > 0.0)
    assert len(slowly.history) > len(together_.history)


def test_a_wall_that_is_only_pressed_answers_like_a_bilateral_one(chain):
    load = together(*(force_on(bone, [0.0, 0.0, -3.0]) for bone in (1, 2, 3)))
    found, bilateral = (one.solve(load).require() for one in (chain, EquilibriumProblem(chain.torso, chain.supports)))
    assert (pressures(chain, found) > 0.0).all()
    np.testing.assert_array_equal(found.state.bone_positions, bilateral.state.bone_positions)


def test_a_torso_pulled_off_the_wall_is_free_of_it(chain):
    load = force_on(3, [0.0, 0.0, 4.0])
    found = chain.solve(load).require()
    assert (pressures(chain, found) == 0.0).all()
    free = EquilibriumProblem(chain.torso, switched(chain.supports, np.zeros(6, dtype=bool))).solve(load).require()
    np.testing.assert_allclose(found.state.bone_positions, free.state.bone_positions, atol=1e-9)
    assert np.abs(found.reaction("wall")).max() == 0.0


def test_energy_is_least_among_one_sided_states(chain):
    """Against the energy with min(gap, 0), moved at random: an independent statement of the same conditions."""
    load = together(force_on(3, [0.0, 0.0, -5.0], 20.0), force_on(2, [0.0, 0.0, 3.0]))
    found = chain.solve(load).require()
    assert 0 < (pressures(chain, found) > 0.0).sum() < 6
    springs, potential = chain.supports.springs, chain.potential
    stiffness = potential.stiffness(None)

    def energy(state):
        pressed = np.minimum(springs.extension(state), 0.0)
        return potential.energy(state, stiffness, [load])[0] + 0.5 * WALL * float(pressed @ pressed)

    random, free = np.random.default_rng(1), ~chain.supports.held.ravel()
    for size in (1e-2, 1e-4):
        for _ in range(20):
            step = random.normal(size=24) * np.tile([1, 1, 1, 0.03, 0.03, 0.03], 4) * free
            assert energy(retract(found.state, size * step)) > energy(found.state)


def test_springs_that_do_not_settle_are_an_error(chain, monkeypatch):
    monkeypatch.setattr(contact, "MAX_ROUNDS", 1)
    with pytest.raises(EquilibriumError, match="did not settle within 1 round"):
        chain.solve(force_on(3, [0.0, 0.0, 4.0]))


# On a torso


@pytest.fixture(scope="module")
def pushed():
    """A torso whose wall pushes only, a push under which a bilateral one pulls, and the equilibrium."""
    torso = template_torso(157.0, "coarse")
    problem = OneSidedProblem(torso, three_point_supports(torso, "right"))
    load, ratios = rib_push(torso, "right", 6.0, 60.0), stiffness_ratios({"lateral_bending": 0.2, "tissue": 0.05})
    return problem, load, ratios, problem.solve(load, ratios).require()


def wall_forces(found):
    return np.array([r.force[2] for r in found.reactions if r.kind is SupportKind.WALL])


def test_a_one_sided_problem_finds_the_active_set(pushed):
    problem, load, ratios, found = pushed
    bilateral = EquilibriumProblem(problem.torso, problem.supports)
    assert wall_forces(bilateral.solve(load, ratios).require()).min() < -0.5  # else nothing is tested
    assert_complementary(problem, found)
    assert (wall_forces(found) == 0.0).any()
    assert [r.name for r in found.reactions[1:]] == list(problem.supports.names)
    # What all rounds took, not the last one alone.
    assert abs(pressures(problem, found)[0]) > 1.0  # the shoulder's spring is bilateral and stays
    balance = load.forces.sum(0) + sum(reaction.force for reaction in found.reactions)
    assert np.abs(balance).max() < 1e-6 * load.size
    last = bilateral.with_supports(switched(problem.supports, pressures(problem, found) != 0.0))
    assert found.factorisations > last.solve(load, ratios, found.state).factorisations
    assert len(found.history) > found.iterations - 1 > 1


def test_it_starts_from_the_springs_that_touch_in_its_start(pushed):
    problem, load, ratios, found = pushed
    again = problem.solve(load, ratios, found.state).require()
    assert again.iterations <= 1
    tangent = problem.linearise(found, load, ratios)
    softer = stiffness_ratios({"lateral_bending": 0.19, "tissue": 0.05})
    assert problem.solve(load, softer, tangent).require().factorisations <= 1


def test_its_derivatives_hold_the_springs_that_touch(pushed):
    problem, load, ratios, found = pushed
    rows = 6 * problem.torso.bone("T8") + np.arange(3)
    slope = problem.linearise(found, load, ratios).forward(ratios.groups)[rows]
    _, again = problem.solve_linearised(load, ratios, found.state)
    np.testing.assert_allclose(again.forward(ratios.groups)[rows], slope, rtol=1e-6, atol=1e-9)
    step, measured = 1e-4, []
    for i in range(2):
        places = []
        for sign in (1.0, -1.0):
            values = np.array(ratios.values) * np.exp(sign * step * np.eye(2)[i])
            other = stiffness_ratios({"lateral_bending": values[0], "tissue": values[1]})
            moved = problem.solve(load, other, found.state).require().state
            places.append(moved.bone_positions[problem.torso.bone("T8")])
        measured.append((places[0] - places[1]) / (2.0 * step))
    np.testing.assert_allclose(slope, np.transpose(measured), rtol=1e-4, atol=1e-5)
    # On all springs the derivative is another one: the wall would hold the back.
    bilateral = EquilibriumProblem(problem.torso, problem.supports)
    solved = bilateral.solve(load, ratios).require()
    other = bilateral.linearise(solved, load, ratios).forward(ratios.groups)[rows]
    assert np.abs(other - slope).max() > 1e-2


def test_elsewhere_its_wall_is_as_one_sided(pushed):
    problem, load, ratios, found = pushed
    there = problem.with_place(SupportPlace(np.radians(2.0), 2.0))
    moved = there.solve(load, ratios, found.state).require()
    assert wall_forces(moved).min() >= -1e-6
    assert there.linearise(moved, load, ratios).place_derivative().shape == (problem.potential.dofs, 2)


def test_unloaded_it_rests_against_its_wall(pushed):
    problem, *_ = pushed
    rest = problem.solve(no_load()).require()
    assert rest.iterations == 0
    assert problem.linearise(rest, no_load()).system.supports.springs.stiffness.min() > 0.0


def test_a_problem_without_a_wall_is_refused(pushed):
    torso = pushed[0].torso
    with pytest.raises(EquilibriumError, match="no support of the kind 'wall' to be one-sided; there are shoulder"):
        OneSidedProblem(torso, three_point_supports(torso, "right", wall=False))


def test_a_solve_that_fails_says_so(pushed):
    problem, load, ratios, _ = pushed
    failed = problem.solve(load.scaled(100.0), ratios, max_iterations=2)
    assert not failed.converged
    assert failed.fault
