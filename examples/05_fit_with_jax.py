"""Fit stiffness ratios by JAX's optimiser: the equilibrium is a function with a gradient, also under ``jit``.

The torso is pushed with 40 N. Where its vertebrae lie, which a radiograph would show, is made from known ratios.

Needs the extra: pip install "spinestiff[jax]". Run: python examples/05_fit_with_jax.py
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.optimize import minimize

import spinestiff as ss

jax.config.update("jax_enable_x64", True)

truth = {"lateral_bending": 0.1, "tissue": 0.05}
torso = ss.template_torso(height_cm=157, mesh="coarse")
problem = ss.EquilibriumProblem(torso, ss.three_point_supports(torso, side="right"))
load = ss.rib_push(torso, side="right", level=8, force_n=40)

# Parameters are logarithms of ratios; each scales the stiffnesses of its group.
model = ss.DifferentiableEquilibrium(problem, load, ss.stiffness_ratios(truth).groups)
vertebrae = torso.vertebra_bones
measured = jnp.asarray(model.solve(np.log(list(truth.values()))).pose.positions[vertebrae])

# Where the fit starts, and the state there: the quickest start for all that follow.
begin = jnp.log(jnp.array([0.3, 0.1]))
equilibrium = ss.jax_equilibrium(model, model.solve(np.asarray(begin)).equilibrium.state)


def loss(log_ratios: jax.Array) -> jax.Array:
    """Mean square distance of the vertebrae from where they were measured, mm^2."""
    value = ((equilibrium(log_ratios).positions[vertebrae] - measured) ** 2).sum(1).mean()
    jax.debug.print("loss {:10.2e} mm^2, ratios {}", value, jnp.exp(log_ratios))
    return value


fit = minimize(loss, begin, method="BFGS", tol=1e-8, options={"maxiter": 40})
found = dict(zip(truth, jnp.exp(fit.x).tolist()))
for name, value in truth.items():
    print(f"{name}: true {value:g}, found {found[name]:.5f}")
print(f"{int(fit.nfev)} evaluations, loss {float(loss(begin)):.1f} -> {float(fit.fun):.1e} mm^2")
