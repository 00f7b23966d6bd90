"""spinestiff.interop.torch: the equilibrium in PyTorch's automatic differentiation."""

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

AT = (np.log(0.3), np.log(0.2), 1.1)


@pytest.fixture(scope="module")
def torch():
    return pytest.importorskip("torch", reason='PyTorch is not installed: pip install "spinestiff[torch]"')


@pytest.fixture(scope="module")
def model():
    torso = toy_torso(1)
    groups = stiffness_ratios({"lateral_bending": 1.0, "tissue": 1.0}, torso.joints.kinds).groups
    return DifferentiableEquilibrium(
        EquilibriumProblem(torso, toy_supports(torso)), toy_load(), groups, load_factor=True
    )


@pytest.fixture
def equilibrium(torch):
    return importlib.import_module("spinestiff.interop.torch").torch_equilibrium


def test_without_torch_the_import_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "spinestiff.interop.torch", raising=False)
    with pytest.raises(ImportError, match=r'needs PyTorch; try: pip install "spinestiff\[torch\]"'):
        importlib.import_module("spinestiff.interop.torch")


@pytest.mark.filterwarnings("ignore:.torch.jit:DeprecationWarning")  # torch's own, in its forward mode
def test_gradcheck_in_reverse_and_forward_mode(torch, equilibrium, model):
    start = model.solve(np.array(AT)).equilibrium.state
    parameters = torch.tensor(AT, dtype=torch.float64, requires_grad=True)
    chosen = 40  # a few nodes: each output costs an adjoint solve

    def function(p):
        pose = equilibrium(model, p, start)
        return pose.positions, pose.rotations, pose.nodes[:chosen:8]

    assert torch.autograd.gradcheck(
        function, parameters, eps=1e-4, atol=1e-6, rtol=1e-5, check_forward_ad=True, check_undefined_grad=False
    )


def test_gradient_of_a_loss_is_the_engines_adjoint(torch, equilibrium, model):
    random = np.random.default_rng(0)
    solution = model.solve(np.array(AT))
    weights = Pose(*(random.normal(size=values.shape) for values in solution.pose))
    parameters = torch.tensor(AT, dtype=torch.float64, requires_grad=True)
    pose = equilibrium(model, parameters)
    loss = sum((torch.as_tensor(w) * p).sum() for w, p in zip(weights, pose))
    loss.backward()
    assert parameters.grad.numpy() == pytest.approx(solution.vjp(weights), rel=1e-12)
    assert [tuple(p.shape) for p in pose] == [v.shape for v in solution.pose]


def test_single_precision_parameters_get_gradients_of_their_kind(torch, equilibrium, model):
    parameters = torch.tensor(AT, dtype=torch.float32, requires_grad=True)
    pose = equilibrium(model, parameters)
    assert pose.positions.dtype == torch.float64
    pose.positions[0, 0].backward()
    assert parameters.grad.dtype == torch.float32
    assert parameters.grad.abs().max() > 0


def test_outputs_that_a_loss_leaves_out_count_as_zero(torch, equilibrium, model):
    parameters = torch.tensor(AT, dtype=torch.float64, requires_grad=True)
    equilibrium(model, parameters).rotations[1, 0, 1].backward()
    solution = model.solve(np.array(AT))
    picked = Pose(*(np.zeros_like(values) for values in solution.pose))
    picked.rotations[1, 0, 1] = 1.0
    assert parameters.grad.numpy() == pytest.approx(solution.vjp(picked), rel=1e-12)


def test_second_derivatives_are_refused(torch, equilibrium, model):
    parameters = torch.tensor(AT, dtype=torch.float64, requires_grad=True)
    with pytest.raises(NotImplementedError, match="first derivatives only"):
        torch.autograd.grad(equilibrium(model, parameters).positions.sum(), parameters, create_graph=True)


def test_no_equilibrium_is_the_engines_error(torch, equilibrium, model):
    with pytest.raises(EquilibriumError):
        equilibrium(model, torch.tensor([0.0, 0.0, 1e4], dtype=torch.float64))
