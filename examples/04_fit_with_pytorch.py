"""Fit stiffness ratios by PyTorch's optimiser: the equilibrium is an operation whose gradient PyTorch asks for.

The torso is pushed with 40 N. Where its vertebrae lie, which a radiograph would show, is made from known ratios.

Needs the extra: pip install "spinestiff[torch]". Run: python examples/04_fit_with_pytorch.py
"""

import numpy as np
import torch

import spinestiff as ss

truth = {"lateral_bending": 0.1, "tissue": 0.05}
torso = ss.template_torso(height_cm=157, mesh="coarse")
problem = ss.EquilibriumProblem(torso, ss.three_point_supports(torso, side="right"))
load = ss.rib_push(torso, side="right", level=8, force_n=40)

# Parameters are logarithms of ratios; each scales the stiffnesses of its group.
groups = ss.stiffness_ratios(truth).groups
model = ss.DifferentiableEquilibrium(problem, load, groups)
vertebrae = torch.from_numpy(torso.vertebra_bones.copy())
measured = torch.tensor(model.solve(np.log(list(truth.values()))).pose.positions)[vertebrae]

# Where the fit starts, and the state there: the quickest start for all that follow.
log_ratios = torch.tensor(np.log([0.3, 0.1]), requires_grad=True)
start = model.solve(log_ratios.detach().numpy()).equilibrium.state
optimiser = torch.optim.LBFGS([log_ratios], max_iter=40, tolerance_grad=1e-8, line_search_fn="strong_wolfe")
losses: list[float] = []


def loss() -> torch.Tensor:
    """Mean square distance of the vertebrae from where they were measured, mm^2."""
    optimiser.zero_grad()
    pose = ss.torch_equilibrium(model, log_ratios, start)
    value = ((pose.positions[vertebrae] - measured) ** 2).sum(1).mean()
    value.backward()
    losses.append(float(value.detach()))
    tried = ", ".join(f"{group.name} {ratio:.4f}" for group, ratio in zip(groups, log_ratios.detach().exp().tolist()))
    print(f"evaluation {len(losses):2d}: loss {losses[-1]:10.2e} mm^2, {tried}")
    return value


optimiser.step(loss)
found = dict(zip(truth, log_ratios.detach().exp().tolist()))
for name, value in truth.items():
    print(f"{name}: true {value:g}, found {found[name]:.5f}")
