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
from spinestiff.mechanics.contact import solve_with_contact, switched
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import LoadCase, rib_push
from spinestiff.mechanics.supports import SupportKind, Supports, three_point_supports
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
    return EquilibriumProblem(
        torso, Supports(held, springs, tuple(f"point {i}" for i in range(6)), (SupportKind.WALL,) * 6)
    )


def force_on(bone, force, arm=0.0):
    return LoadCase(PointsOnBones(np.array([bone]), np.array([[0.0, arm, 0.0]])), np.array([force], dtype=float))


def together(*loads):
    points = [load.points for load in loads]
    bones, offsets = np.concatenate([p.bone for p in points]), np.vstack([p.offset for p in points])
    return LoadCase(PointsOnBones(bones, offsets), np.vstack([load.forces for load in loads]))


def assert_complementary(found, supports):
    """p >= 0, gap >= 0 up to the spring's own give, p = 0 or the gap is that give."""
    pressure = -switched(supports, found.touching).springs.stiffness * found.gap
    tolerance = found.equilibrium.tolerance
    free = found.one_sided & ~found.touching
    assert (pressure[found.one_sided] >= -tolerance).all()
    assert (found.gap[free] * supports.springs.stiffness[free] >= -tolerance).all()
    held = supports.springs.extension(found.equilibrium.state)
    np.testing.assert_array_equal(held, found.gap)


LOADS = [
    (1, [0.0, 0.0, -3.0], 0.0),
    (3, [0.0, 0.0, 4.0], 0.0),
    (3, [0.0, 0.0, -5.0], 20.0),
    (2, [1.0, 0.5, 3.0], -12.0),
]


@pytest.mark.parametrize("which", [(0, 1), (2,), (2, 3), (0, 3)])
def test_the_set_is_consistent_and_the_only_one(chain, which):
    load = together(*(force_on(*LOADS[i]) for i in which))
    found = solve_with_contact(chain, load)
    assert_complementary(found, chain.supports)
    slowly = solve_with_contact(chain, load, one_at_a_time=True)
    np.testing.assert_array_equal(slowly.touching, found.touching)
    assert slowly.rounds >= found.rounds
    consistent = []
    for bits in itertools.product([False, True], repeat=6):
        acting = np.array(bits)
        trial = chain.with_supports(switched(chain.supports, acting)).solve(load).require()
        gap = chain.supports.springs.extension(trial.state)
        if not (np.where(acting, gap, -gap) * WALL > trial.tolerance).any():
            consistent.append(bits)
    # Springs of zero force may count either way; apart from them the set found is the one of all 64 that holds.
    assert tuple(found.touching.tolist()) in consistent
    for bits in consistent:
        unsure = np.array(bits) != found.touching
        assert np.abs(found.gap[unsure] * WALL).max(initial=0.0) < 1e-6


def test_a_wall_that_is_only_pressed_answers_like_a_bilateral_one(chain):
    load = together(*(force_on(bone, [0.0, 0.0, -3.0]) for bone in (1, 2, 3)))
    found, bilateral = solve_with_contact(chain, load), chain.solve(load).require()
    assert found.touching.all()
    assert found.rounds == 1
    np.testing.assert_array_equal(found.equilibrium.state.bone_positions, bilateral.state.bone_positions)


def test_a_torso_pulled_off_the_wall_is_free_of_it(chain):
    load = force_on(3, [0.0, 0.0, 4.0])
    found = solve_with_contact(chain, load)
    assert not found.touching.any()
    free = chain.with_supports(switched(chain.supports, np.zeros(6, dtype=bool))).solve(load).require()
    np.testing.assert_allclose(found.equilibrium.state.bone_positions, free.state.bone_positions, atol=1e-9)
    assert np.abs(found.equilibrium.reaction("wall")).max() == 0.0


def test_energy_is_least_among_one_sided_states(chain):
    """Against the energy with min(gap, 0), moved at random: an independent statement of the same conditions."""
    load = together(force_on(3, [0.0, 0.0, -5.0], 20.0), force_on(2, [0.0, 0.0, 3.0]))
    found = solve_with_contact(chain, load)
    assert found.touching.any()
    assert not found.touching.all()
    springs, potential = chain.supports.springs, chain.potential
    stiffness = potential.stiffness(None)

    def energy(state):
        pressed = np.minimum(springs.extension(state), 0.0)
        return potential.energy(state, stiffness, [load])[0] + 0.5 * WALL * float(pressed @ pressed)

    state, random = found.equilibrium.state, np.random.default_rng(1)
    free = ~chain.supports.held.ravel()
    for size in (1e-2, 1e-4):
        for _ in range(20):
            step = random.normal(size=24) * np.tile([1, 1, 1, 0.03, 0.03, 0.03], 4) * free
            assert energy(retract(state, size * step)) > energy(state)


def test_a_kind_that_no_support_is_of_is_refused(chain):
    with pytest.raises(EquilibriumError, match="no support of the kind 'shoulder' to be one-sided; there are wall"):
        solve_with_contact(chain, force_on(1, [0.0, 0.0, 1.0]), one_sided=SupportKind.SHOULDER)


def test_springs_that_do_not_settle_are_an_error(chain):
    with pytest.raises(EquilibriumError, match="did not settle within 1 round"):
        solve_with_contact(chain, force_on(3, [0.0, 0.0, 4.0]), max_rounds=1)


def test_the_wall_behind_a_pushed_torso_does_not_pull():
    torso = template_torso(157.0, "coarse")
    problem = EquilibriumProblem(torso, three_point_supports(torso, "right"))
    load, ratios = rib_push(torso, "right", 6.0, 60.0), stiffness_ratios({"lateral_bending": 0.2, "tissue": 0.05})
    bilateral = problem.solve(load, ratios).require()
    pull = [r.force[2] for r in bilateral.reactions if r.kind is SupportKind.WALL]
    assert min(pull) < -0.5  # else nothing is tested
    found = solve_with_contact(problem, load, ratios, bilateral.state)
    assert_complementary(found, problem.supports)
    assert min(r.force[2] for r in found.equilibrium.reactions if r.kind is SupportKind.WALL) >= -1e-6
    assert found.touching[0]  # the shoulder's spring is bilateral and stays
    balance = load.forces.sum(0) + sum(reaction.force for reaction in found.equilibrium.reactions)
    assert np.abs(balance).max() < 1e-6 * load.size
