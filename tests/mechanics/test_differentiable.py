"""spinestiff.mechanics.differentiable: values, jvp and vjp of an equilibrium as a function of parameters."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.differentiable import DifferentiableEquilibrium, Pose
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.verification.equilibria import toy_load, toy_supports
from spinestiff.verification.models import toy_torso

NAMES = {"lateral_bending": 0.3, "tissue": 0.2, "separation": 0.7}
AT = np.append(np.log(list(NAMES.values())), 1.1)


@pytest.fixture(scope="module")
def model():
    torso = toy_torso(1)
    groups = stiffness_ratios(NAMES, torso.joints.kinds).groups
    return DifferentiableEquilibrium(
        EquilibriumProblem(torso, toy_supports(torso)), toy_load(), groups, load_factor=True
    )


@pytest.fixture(scope="module")
def there(model):
    return model.solve(AT)


def random_cotangent(pose, seed=0):
    random = np.random.default_rng(seed)
    return Pose(*(random.normal(size=values.shape) for values in pose))


def product(a, b):
    return sum(float(np.sum(x * y)) for x, y in zip(a, b))


def test_the_pose_is_that_of_a_solve(model, there):
    ratios = stiffness_ratios(NAMES, model.problem.torso.joints.kinds)
    state = model.problem.solve(toy_load().scaled(1.1), ratios).require().state
    for found, wanted in zip(there.pose, (state.bone_positions, state.bone_rotations, state.tissue_positions)):
        assert found == pytest.approx(wanted, abs=1e-9)
    assert model.names == ("log lateral_bending", "log tissue", "log separation", "load factor")


@pytest.mark.parametrize("parameter", range(4))
def test_eq6_jvp_against_differences_of_solves(model, there, parameter):
    h, unit = 1e-3, np.eye(4)[parameter]
    wanted = Pose(*(np.zeros_like(values) for values in there.pose))
    for k, weight in ((1, 8 / 12), (2, -1 / 12)):
        ends = [model.solve(AT + sign * k * h * unit, there.equilibrium.state).pose for sign in (1, -1)]
        wanted = Pose(*(w + weight * (a - b) / h for w, a, b in zip(wanted, *ends)))
    for found, expected in zip(there.jvp(unit), wanted):
        assert np.abs(expected).max() > 1e-4
        assert found == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


def test_jvp_is_linear_in_its_tangent(there):
    units = [there.jvp(unit) for unit in np.eye(4)]
    weights = np.array([0.3, -2.0, 0.7, 1.5])
    for part, found in enumerate(there.jvp(weights)):
        wanted = sum(weight * unit[part] for weight, unit in zip(weights, units))
        assert found == pytest.approx(wanted, abs=1e-10 * np.abs(wanted).max())


@pytest.mark.parametrize("part", range(3))
def test_eq7_vjp_is_the_transpose_of_jvp(there, part):
    cotangent = Pose(*(values * (i == part) for i, values in enumerate(random_cotangent(there.pose, 1 + part))))
    wanted = [product(cotangent, there.jvp(unit)) for unit in np.eye(4)]
    assert there.vjp(cotangent) == pytest.approx(wanted, rel=1e-9)
    assert np.abs(wanted).min() > 1e-6


def test_parameters_without_a_load_factor_and_without_groups(model, there):
    problem, load = model.problem, toy_load().scaled(1.1)
    ratios_only = DifferentiableEquilibrium(problem, load, model.groups).solve(AT[:3])
    cotangent = random_cotangent(there.pose)
    assert ratios_only.vjp(cotangent) == pytest.approx(there.vjp(cotangent)[:3], rel=1e-7)
    factor_only = DifferentiableEquilibrium(problem, toy_load(), (), load_factor=True).solve(np.ones(1))
    assert factor_only.vjp(cotangent)[0] == pytest.approx(product(cotangent, factor_only.jvp(np.ones(1))), rel=1e-9)


def test_the_same_pose_is_not_solved_for_again(model):
    solved = model.solve(AT)
    copies = Pose(*(np.array(values) for values in solved.pose))
    assert model.at(AT.copy(), copies) is solved
    model.solve(AT + 0.1)
    again = model.at(AT, copies)
    assert again is not solved
    assert again.equilibrium.iterations == 0
    cotangent = random_cotangent(solved.pose)
    assert again.vjp(cotangent) == pytest.approx(solved.vjp(cotangent), rel=1e-12)
    assert model.at(AT + 0.1, copies) is not again


def test_wrong_shapes_and_values_end_in_one_line(model, there):
    with pytest.raises(EquilibriumError, match=r"parameters has shape \(3,\), wanted \(4\)"):
        model.solve(AT[:3])
    with pytest.raises(EquilibriumError, match="parameters holds a value that is not finite"):
        model.solve(np.full(4, np.nan))
    for far in (800.0, -800.0):
        with pytest.raises(EquilibriumError, match=rf"^log tissue is {far:g}; wanted from -700 to 700$"):
            model.solve(AT + [0.0, far - AT[1], 0.0, 0.0])
    with pytest.raises(EquilibriumError, match="cotangent of rotations has shape"):
        there.vjp(Pose(there.pose.positions, there.pose.positions, there.pose.nodes))
    with pytest.raises(EquilibriumError, match="tangent has shape"):
        there.jvp(np.ones(5))


def test_no_equilibrium_is_an_error_not_a_pose(model):
    with pytest.raises(EquilibriumError, match="residual"):
        model.solve(AT + [0.0, 0.0, 0.0, 1e4])
