"""Nearly incompressible cantilevers: the ten-node element does not lock."""

import numpy as np
import pytest

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import LoadCase, no_load
from spinestiff.verification.blocks import holds
from spinestiff.verification.models import box_mesh, make_torso

SIDE, LENGTH, YOUNG = 10.0, 50.0, 1.0
# End deflection over the force, mm/N: displacement-pressure hexahedra of scikit-fem 12.0.2, five cells over a side
# (benchmarks/cantilever_reference.py; four cells give 0.06 % less).
REFERENCE = {0.45: 50.037436, 0.49: 49.736421, 0.4995: 49.658234}


def deflection(cells, nodes, poisson):
    """mm/N of a bar that is clamped at z = 0 and carries a rigid plate at the other end, from the tangent at rest."""
    positions, elements = box_mesh((cells, cells, 5 * cells), (SIDE, SIDE, LENGTH), nodes)
    owner = np.where(positions[:, 2] < 1e-9, 0, np.where(positions[:, 2] > LENGTH - 1e-9, 1, -1))
    ends = np.array([[0.5 * SIDE, 0.5 * SIDE, 0.0], [0.5 * SIDE, 0.5 * SIDE, LENGTH]])
    torso = make_torso(ends, [], np.zeros(6), (positions, elements), owner, YOUNG, poisson)
    held = np.zeros((2, 6), dtype=bool)
    held[0] = True
    problem = EquilibriumProblem(torso, holds(held))
    tangent = problem.linearise(problem.solve(no_load()), no_load())
    pull = LoadCase(PointsOnBones(np.array([1]), np.zeros((1, 3))), np.array([[0.0, 1.0, 0.0]]))
    return tangent.load_derivative(pull)[7]


@pytest.mark.parametrize("poisson", REFERENCE)
def test_ten_node_cantilevers_bend_as_an_independent_solution_does(poisson):
    assert deflection(3, 10, poisson) == pytest.approx(REFERENCE[poisson], rel=0.05)


def test_linear_tetrahedra_with_as_many_nodes_lock():
    assert deflection(6, 4, 0.45) < 0.85 * REFERENCE[0.45]
    assert deflection(6, 4, 0.4995) < 0.2 * REFERENCE[0.4995]
