"""spinestiff.interop.jax: the equilibrium in JAX's automatic differentiation."""

from __future__ import annotations

import importlib
import sys

import numpy as np
import pytest

from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.differentiable import DifferentiableEquilibrium, Pose
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.verification.equilibria import toy_load, toy_supports
from spinestiff.verification.models import toy_torso

AT = np.array([np.log(0.3), np.log(0.2), 1.1])


@pytest.fixture(scope="module")
def jax():
    module = pytest.importorskip("jax", reason='JAX is not installed: pip install "spinestiff[jax]"')
    before = module.config.jax_enable_x64
    module.config.update("jax_enable_x64", True)
    yield module
    module.config.update("jax_enable_x64", before)


@pytest.fixture(scope="module")
def model():
    torso = toy_torso(1)
    groups = stiffness_ratios({"lateral_bending": 1.0, "tissue": 1.0}, torso.joints.kinds).groups
    return DifferentiableEquilibrium(
        EquilibriumProblem(torso, toy_supports(torso)), toy_load(), groups, load_factor=True
    )


@pytest.fixture(scope="module")
def pose_of(jax, model):
    start = model.solve(AT).equilibrium.state
    return importlib.import_module("spinestiff.interop.jax").jax_equilibrium(model, start)


@pytest.fixture(scope="module")
def weights(model):
    random = np.random.default_rng(0)
    return Pose(*(random.normal(size=values.shape) for values in model.solve(AT).pose))


def weighted(weights, pose):
    return sum((w * p).sum() for w, p in zip(weights, pose))


def test_without_jax_the_import_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "jax", None)
    monkeypatch.delitem(sys.modules, "spinestiff.interop.jax", raising=False)
    with pytest.raises(ImportError, match=r'needs JAX; try: pip install "spinestiff\[jax\]"'):
        importlib.import_module("spinestiff.interop.jax")


def test_gradient_of_a_loss_is_the_engines_adjoint_and_agrees_with_differences(jax, model, pose_of, weights):
    loss = lambda p: weighted(weights, pose_of(p))  # noqa: E731
    found = np.asarray(jax.grad(loss)(AT))
    assert found == pytest.approx(model.solve(AT).vjp(weights), rel=1e-12)
    h = 1e-4
    differences = [(float(loss(AT + h * e)) - float(loss(AT - h * e))) / (2 * h) for e in np.eye(3)]
    assert found == pytest.approx(differences, rel=1e-5)


def test_the_derivative_is_that_of_its_own_point_when_others_are_solved_between(jax, model, pose_of, weights):
    _, pull_back = jax.vjp(pose_of, AT)
    pose_of(AT + 0.3)
    (found,) = pull_back(weights)
    assert np.asarray(found) == pytest.approx(model.solve(AT).vjp(weights), rel=1e-9)


def test_under_jit_and_vmap(jax, model, pose_of, weights):
    loss = lambda p: weighted(weights, pose_of(p))  # noqa: E731
    both = np.stack([AT, AT + 0.1])
    values, slopes = jax.jit(jax.vmap(jax.value_and_grad(loss)))(both)
    for p, value, slope in zip(both, values, slopes):
        solution = model.solve(p)
        assert float(value) == pytest.approx(float(weighted(weights, solution.pose)), rel=1e-9)
        assert np.asarray(slope) == pytest.approx(solution.vjp(weights), rel=1e-7)


def test_no_equilibrium_is_an_error_that_says_why(jax, pose_of):
    with pytest.raises(Exception, match="EquilibriumError"):
        jax.block_until_ready(pose_of(np.array([0.0, 0.0, 1e4])))


def test_thirty_two_bits_are_refused(jax, model):
    from spinestiff.interop.jax import jax_equilibrium as equilibrium

    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(EquilibriumError, match="64 bits"):
            equilibrium(model)
    finally:
        jax.config.update("jax_enable_x64", True)
