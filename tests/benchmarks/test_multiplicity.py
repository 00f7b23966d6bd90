"""benchmarks/multiplicity.py: several equilibria under one load, and where a branch ends."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

from programs import benchmark
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import LoadCase
from spinestiff.mechanics.supports import Supports
from spinestiff.mechanics.terms import PointSprings
from spinestiff.verification.blocks import holds
from spinestiff.verification.equilibria import toy_load, toy_supports
from spinestiff.verification.models import make_torso, toy_torso

multiplicity = benchmark("multiplicity")
BranchEnd, apart, equilibria = multiplicity.BranchEnd, multiplicity.apart, multiplicity.equilibria
follow_load, least_eigenvalue = multiplicity.follow_load, multiplicity.least_eigenvalue

# A toggle: a bar at SLANT above the horizontal, its foot on a turning joint, its tip held sideways by a spring.
SLANT, LENGTH, SPRING, TURNING = 0.4, 100.0, 20.0, 50.0
TIP = LENGTH * np.array([np.cos(SLANT), np.sin(SLANT), 0.0])


def _force(angle):
    """The downward force at the tip with which the bar rests at ``angle``, N."""
    moment = SPRING * LENGTH**2 * (np.cos(angle) - np.cos(SLANT)) * np.sin(angle) + TURNING * (SLANT - angle)
    return moment / (LENGTH * np.cos(angle))


def _energy(angle, force):
    spring = 0.5 * SPRING * LENGTH**2 * (np.cos(angle) - np.cos(SLANT)) ** 2
    return spring + 0.5 * TURNING * (angle - SLANT) ** 2 + force * LENGTH * np.sin(angle)


SNAP = -minimize_scalar(lambda a: -_force(a), bounds=(0.0, SLANT), method="bounded", options={"xatol": 1e-12}).fun


@pytest.fixture(scope="module")
def toggle():
    torso = make_torso(np.zeros((2, 3)), [(0, 1)], np.array([1e3, 1e3, 1e3, 1e6, 1e6, TURNING]))
    held = np.ones((2, 6), dtype=bool)
    held[1, 5] = False
    tip = PointsOnBones(np.array([1]), TIP[None])
    springs = PointSprings(tip, TIP[None], np.array([[1.0, 0.0, 0.0]]), np.array([SPRING]))
    return EquilibriumProblem(torso, Supports(held, springs, ("tip",)))


def _push(force):
    return LoadCase(PointsOnBones(np.array([1]), TIP[None]), np.array([[0.0, -force, 0.0]]))


def _angle(equilibrium):
    x = equilibrium.state.bone_rotations[1] @ TIP
    return np.arctan2(x[1], x[0])


def test_both_wells_of_a_toggle_are_found_and_ordered_by_energy(toggle):
    force = 0.5 * SNAP
    snapped, upright = (brentq(lambda a: _force(a) - force, *ends) for ends in ((-1.2, -SLANT), (0.2, SLANT)))
    found = equilibria(toggle, _push(force))
    assert [_angle(one) for one in found] == pytest.approx([snapped, upright], abs=1e-9)
    below, above = (one.energy for one in found)
    assert above - below == pytest.approx(_energy(upright, force) - _energy(snapped, force), rel=1e-9)
    assert apart(found[0].state, found[1].state) == pytest.approx(2 * 30 * np.sin((upright - snapped) / 2), rel=1e-9)


def test_known_equilibria_are_kept_and_not_counted_twice(toggle):
    load = _push(0.5 * SNAP)
    both = equilibria(toggle, load)
    again = equilibria(toggle, load, known=both, pushes=2)
    assert [id(one) for one in again] == [id(one) for one in both]


def test_one_equilibrium_where_there_is_one(toggle):
    assert len(equilibria(toggle, _push(3.0 * SNAP))) == 1


def test_a_branch_ends_where_the_toggle_snaps(toggle):
    branch = follow_load(toggle, _push(2.0 * SNAP))
    assert branch.end is BranchEnd.LIMIT_POINT
    assert branch.share == pytest.approx(0.5, abs=3e-5)
    assert branch.share <= 0.5
    assert 0.0 < branch.stiffness < 0.02
    assert _angle(branch.equilibrium) > 0.0


def test_a_branch_below_the_limit_point_reaches_the_load_and_stays_upright(toggle):
    branch = follow_load(toggle, _push(0.99 * SNAP))
    assert branch.end is BranchEnd.REACHED
    assert branch.share == 1.0
    assert _force(_angle(branch.equilibrium)) == pytest.approx(0.99 * SNAP, rel=1e-9)
    assert branch.equilibrium.require() is branch.equilibrium


def test_least_eigenvalue_against_dense_algebra():
    torso = toy_torso(1, 10)
    problem = EquilibriumProblem(torso, toy_supports(torso))
    load = toy_load()
    linear = problem.linearise(problem.solve(load), load)
    inverse = linear.solve(np.eye(problem.potential.dofs))
    size = np.ones(problem.potential.dofs)
    size[:18].reshape(3, 6)[:, 3:] = 30.0
    expected = 1.0 / np.linalg.eigvalsh(size[:, None] * inverse * size).max()
    assert least_eigenvalue(problem, linear) == pytest.approx(expected, rel=1e-3)


def test_a_mechanism_is_refused(toggle):
    torso = make_torso(np.zeros((2, 3)), [(0, 1)], np.zeros(6))
    held = np.zeros((2, 6), dtype=bool)
    held[0] = True
    problem = EquilibriumProblem(torso, Supports(held, toggle.supports.springs, ("tip",)))
    with pytest.raises(EquilibriumError, match="bone1"):
        equilibria(problem, _push(1.0))


@pytest.mark.parametrize("share", [0.9, 1.05, 4 / 3, 2.0])
def test_a_straight_column_ends_at_its_critical_load_and_raises_nothing(share):
    """At the critical load the tangent is singular to working precision, which is no error but the answer."""
    bones, stiffness = 8, 12e3
    places = np.array([[0.0, 100.0 * i, 0.0] for i in range(bones)])
    springs = np.array([1e3, 1e3, 1e3, stiffness, 1e6, 0.8 * stiffness])
    torso = make_torso(places, [(i, i + 1) for i in range(bones - 1)], springs)
    held = np.zeros((bones, 6), dtype=bool)
    held[0] = True
    problem = EquilibriumProblem(torso, holds(held))

    def weight(force):
        return LoadCase(PointsOnBones(np.array([bones - 1]), np.zeros((1, 3))), np.array([[0.0, -force, 0.0]]))

    def stable(force):
        return problem.solve(weight(force)).converged

    low, high = 0.01, 1000.0
    for _ in range(30):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    branch = follow_load(problem, weight(share * low))
    if share < 1.0:
        assert branch.end is BranchEnd.REACHED
        assert 0.0 < branch.stiffness < 0.5
    else:
        assert branch.end is BranchEnd.LIMIT_POINT
        assert branch.share * share == pytest.approx(1.0, rel=5e-3)
        assert branch.stiffness < 0.05
