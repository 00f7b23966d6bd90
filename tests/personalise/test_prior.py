"""The condensed energy: what the whole torso's energy does when only its vertebrae are told where to be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from spinestiff.anatomy.rotation import exp_so3
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import no_load
from spinestiff.personalise.image_terms import Shape, shape_of
from spinestiff.personalise.placing import pulled
from spinestiff.personalise.prior import (
    ENERGY_SCALE,
    OWN_SIZE_SD,
    PERSON_SIZE_SD,
    elastic_prior,
    own_precision,
    pelvis_on_springs,
    regulariser,
)


@pytest.fixture(scope="module")
def problem(template):
    return EquilibriumProblem(template, pelvis_on_springs(template))


@pytest.fixture(scope="module")
def prior(problem):
    return elastic_prior(problem, problem.torso.rest_pose)


def displaced(shape, move, turn):
    zero = np.zeros((17, 3))
    return Shape(shape.positions + move, exp_so3(turn) @ shape.rotations, zero, zero, zero)


def test_it_is_the_energy_left_when_all_else_follows(problem, prior):
    """Against the engine itself: the vertebrae pulled to new poses, the rest in equilibrium with them."""
    torso = problem.torso
    rest = shape_of(torso, torso.rest_pose)
    random = np.random.default_rng(3)
    smooth = np.sin(np.linspace(0.0, np.pi, 17))[:, None] * [1.0, 0.1, -0.6]
    moved = displaced(rest, smooth + random.normal(0.0, 0.02, (17, 3)), random.normal(0.0, 2e-3, (17, 3)))
    state = pulled(problem, torso.rest_pose, moved.positions, moved.rotations, (1e5,))
    bones = torso.vertebra_bones
    reached = Shape(state.bone_positions[bones], state.bone_rotations[bones], *[np.zeros((17, 3))] * 3)
    stiffness, terms = problem.potential.stiffness(regulariser(torso)), problem.all_terms(no_load())
    energy, _ = problem.potential.energy(state, stiffness, terms)
    # A quadratic energy is half its slope times the way.
    way = np.linalg.solve(prior.hessian, prior.slope(reached) - prior.gradient)
    predicted = 0.5 * float(way @ prior.hessian @ way) * ENERGY_SCALE
    assert energy > 5.0
    assert predicted == pytest.approx(energy, rel=0.02)


def test_at_rest_nothing_pulls_and_every_motion_costs(prior):
    assert np.abs(prior.gradient).max() < 1e-9
    assert np.array_equal(prior.hessian, prior.hessian.T)
    assert np.linalg.eigvalsh(prior.hessian).min() > 0.0


def test_neighbours_differ_by_a_few_degrees_and_mm(prior):
    """The scale of the energy: one standard deviation between neighbours, as the module says."""
    covariance = np.linalg.inv(prior.hessian)
    for upper in range(16):
        difference = np.zeros((6, 102))
        difference[:, 6 * upper : 6 * upper + 6] = np.eye(6)
        difference[:, 6 * upper + 6 : 6 * upper + 12] = -np.eye(6)
        sd = np.sqrt(np.diag(difference @ covariance @ difference.T))
        assert (np.degrees(sd[3:]) > 2.0).all()
        assert (np.degrees(sd[3:]) < 6.0).all()
        assert 0.5 < sd[1] < 2.0


def test_away_from_rest_it_pulls_back(problem, prior):
    """Condensed around another state, the slope there is the one that the first predicts."""
    torso = problem.torso
    rest = shape_of(torso, torso.rest_pose)
    moved = displaced(rest, np.linspace(2.0, 0.0, 17)[:, None] * [1.0, 0.0, 0.0], np.zeros((17, 3)))
    state = pulled(problem, torso.rest_pose, moved.positions, moved.rotations, (1e4,))
    there = elastic_prior(problem, state)
    bones = torso.vertebra_bones
    reached = Shape(state.bone_positions[bones], state.bone_rotations[bones], *[np.zeros((17, 3))] * 3)
    wanted = prior.slope(reached)
    assert np.linalg.norm(there.gradient - wanted) < 0.05 * np.linalg.norm(wanted)


def around(prior, seed):
    """The prior with another middle, of which it has a slope."""
    gradient = 5.0 * np.sqrt(np.diag(prior.hessian)) * np.random.default_rng(seed).normal(size=102)
    return replace(prior, gradient=gradient)


def test_its_slope_is_the_energys_derivative_however_far_a_vertebra_turns(problem, prior):
    prior, random = around(prior, 1), np.random.default_rng(2)
    rest = shape_of(problem.torso, problem.torso.rest_pose)
    there = displaced(rest, random.normal(0.0, 5.0, (17, 3)), random.normal(0.0, 0.4, (17, 3)))
    slope, step = prior.slope(there), 1e-5
    for unknown in range(102):
        way = np.zeros((17, 6))
        way.flat[unknown] = step
        ends = [prior.energy(displaced(there, sign * way[:, :3], sign * way[:, 3:])) for sign in (1.0, -1.0)]
        assert (ends[0] - ends[1]) / (2.0 * step) == pytest.approx(slope[unknown], rel=1e-5, abs=1e-6)


def test_its_norm_makes_a_density_of_it(problem, prior):
    rest = shape_of(problem.torso, problem.torso.rest_pose)
    for one in (prior, around(prior, 3), around(replace(prior, hessian=2.0 * prior.hessian), 4)):
        middle = -np.linalg.solve(one.hessian, one.gradient)
        moved = np.random.default_rng(5).normal(size=(17, 6)) * [1.0, 1.0, 1.0, 0.03, 0.03, 0.03]
        density = multivariate_normal(middle, np.linalg.inv(one.hessian)).logpdf(moved.ravel())
        place = displaced(rest, moved[:, :3], moved[:, 3:])
        assert one.energy(place) + one.norm == pytest.approx(-density - 51.0 * np.log(2.0 * np.pi), rel=1e-9)


def test_one_vertebra_let_go(prior):
    """Its neighbours are still held together, as softly as with it at its best."""
    free = prior.without(8)
    own = np.arange(48, 54)
    rest = np.setdiff1d(np.arange(102), own)
    assert np.linalg.inv(free.hessian[np.ix_(rest, rest)]) == pytest.approx(
        np.linalg.inv(prior.hessian)[np.ix_(rest, rest)], rel=1e-6
    )
    assert not free.hessian[np.ix_(own, rest)].any()
    assert np.diag(free.hessian)[own].tolist() == [1e-4] * 3 + [1.0] * 3


def test_sizes_vary_by_person_and_by_vertebra():
    covariance = np.linalg.inv(own_precision(17))
    assert covariance.shape == (9, 17, 17)
    assert np.diag(covariance[0]) == pytest.approx(np.full(17, PERSON_SIZE_SD[0] ** 2 + OWN_SIZE_SD**2))
    assert covariance[0][3, 9] == pytest.approx(PERSON_SIZE_SD[0] ** 2)
