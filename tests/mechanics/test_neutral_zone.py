"""Joints that stiffen as they turn."""

from __future__ import annotations

import numpy as np

from spinestiff.anatomy.state import retract
from spinestiff.mechanics.assembly import Place
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
        law.add_gradient(Place(unknowns, at), stiffness, found)
        return found

    def energy(t):
        return law.energy(Place(unknowns, retract(state, t * step)), stiffness)[0]

    np.testing.assert_allclose((energy(h) - energy(-h)) / (2 * h), gradient(state) @ step, rtol=1e-6)
    # The same potential with and without the law; second derivative along the step.
    bare = Potential(torso).hessian(state, stiffness, ())
    matrix = potential.hessian(state, stiffness, ()) - bare
    rows, columns_ = potential.pattern.indices, np.repeat(np.arange(potential.dofs), np.diff(potential.pattern.indptr))
    products = matrix * step[rows] * step[columns_] * np.where(rows == columns_, 1.0, 2.0)
    second = (energy(h) - 2.0 * energy(0.0) + energy(-h)) / h**2
    np.testing.assert_allclose(products.sum(), second, rtol=1e-3)
