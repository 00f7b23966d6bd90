"""Joints that stiffen as they turn."""

from __future__ import annotations

import numpy as np

from spinestiff.anatomy.state import retract
from spinestiff.anatomy.stiffness import ParameterGroup, StiffnessRatios
from spinestiff.mechanics.assembly import Configuration
from spinestiff.mechanics.neutral_zone import NeutralZone
from spinestiff.mechanics.potential import Potential
from spinestiff.verification.models import toy_torso


def test_derivatives_are_those_of_its_energy() -> None:
    torso, random = toy_torso(), np.random.default_rng(2)
    columns = np.ones((len(torso.joints), 6), dtype=bool)
    law = NeutralZone(torso.joints, columns, 0.05, 1.5)
    potential = Potential(torso, [law])
    stiffness, unknowns = potential.stiffness(None), potential.unknowns
    state = retract(torso.rest_pose, random.normal(0.0, 0.05, potential.dofs))
    step, h = random.normal(0.0, 1.0, potential.dofs), 1e-5

    def gradient(at):
        found = np.zeros(potential.dofs)
        law.add_gradient(Configuration(unknowns, at), stiffness, found)
        return found

    def energy(t):
        return law.energy(Configuration(unknowns, retract(state, t * step)), stiffness)[0]

    np.testing.assert_allclose((energy(h) - energy(-h)) / (2 * h), gradient(state) @ step, rtol=1e-6)
    # The same potential with and without the law; second derivative along the step.
    bare = Potential(torso).hessian(state, stiffness, ())
    matrix = potential.hessian(state, stiffness, ()) - bare
    rows, columns_ = potential.pattern.indices, np.repeat(np.arange(potential.dofs), np.diff(potential.pattern.indptr))
    products = matrix * step[rows] * step[columns_] * np.where(rows == columns_, 1.0, 2.0)
    second = (energy(h) - 2.0 * energy(0.0) + energy(-h)) / h**2
    np.testing.assert_allclose(products.sum(), second, rtol=1e-3)


def test_shares_are_differences_of_gradients() -> None:
    """By log ratios of a joint's directions, which scale the law's stiffness as the linear law's (Eq. 6)."""
    torso, random = toy_torso(), np.random.default_rng(4)
    law = NeutralZone(torso.joints, np.ones((len(torso.joints), 6), dtype=bool), 0.05, 1.5)
    potential = Potential(torso, [law])
    state = retract(torso.rest_pose, random.normal(0.0, 0.05, potential.dofs))
    groups = []
    for name, rows in (("first", [[True], [False]]), ("turns", [[False] * 3 + [True] * 3] * 2)):
        groups.append(ParameterGroup(name, np.broadcast_to(rows, (2, 6))))
    found, h = potential.ratio_gradients(state, potential.stiffness(None), groups), 1e-4
    for group, share in zip(groups, found.T):
        ends = [StiffnessRatios((group,), np.exp([sign * h])) for sign in (1, -1)]
        up, down = (potential.gradient(state, potential.stiffness(ratios), ()) for ratios in ends)
        assert np.abs(share - (up - down) / (2 * h)).max() < 1e-7 * np.abs(share).max()
    plain = Potential(torso).ratio_gradients(state, potential.stiffness(None), groups)
    assert (np.abs(found - plain).max(0) > 0.1 * np.abs(found).max(0)).all()  # else the law's own share is not tested
    direction = random.normal(size=potential.dofs)
    products = potential.ratio_products(state, potential.stiffness(None), groups, direction)
    np.testing.assert_allclose(products, direction @ found, rtol=1e-11)
