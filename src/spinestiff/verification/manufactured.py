"""Checks by a manufactured solution: a wavy finite deformation, the body force it needs, and the error's order.

Errors of a correct element fall with a known power of the element size, for four nodes 2 (displacement) and 1
(gradient), for ten nodes 3 and 2. A fault that leaves a plausible answer seldom leaves the power.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spinestiff.anatomy.grid_mesh import quadratic
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TET10_EDGES
from spinestiff.arrays import Floats, Ints
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import LoadCase
from spinestiff.verification.blocks import holds, young_poisson
from spinestiff.verification.models import box_mesh, make_torso
from spinestiff.verification.oracle import STEP
from spinestiff.verification.outcome import Check, judged

SIDE, WAVE, MU, LAMBDA = 40.0, 0.05, 0.7, 1.9
# Real, or complex for a complex step.
Numbers = NDArray[Any]
ORDERS = {4: (2.0, 1.0), 10: (3.0, 2.0)}
CELLS = {4: (8, 16), 10: (3, 6)}
# How far an observed order of displacement and gradient may be off; both ways, since a solution that is too good is
# no solution of this problem.
SLACK = (0.15, 0.07), (0.15, 0.15)
# Points of the Gauss rule in each direction: of higher degree than the elements' own error.
GAUSS = {4: 2, 10: 3}


def _displacement(x: Numbers) -> Numbers:
    """(n, 3) mm of (n, 3) mm."""
    a = np.pi * x / SIDE
    s, c = np.sin(a), np.cos(a)
    waves = [s[:, 0] * s[:, 1] * c[:, 2], c[:, 0] * s[:, 1] * s[:, 2], s[:, 0] * c[:, 1] * s[:, 2]]
    return WAVE * SIDE * np.stack(waves, -1)


def _gradient(x: Numbers) -> Numbers:
    """(n, 3, 3), F = I + du/dX."""
    a = np.pi * x / SIDE
    s, c = np.sin(a), np.cos(a)
    kinds = ((s, s, c), (c, s, s), (s, c, s))
    f = np.zeros((len(x), 3, 3), dtype=x.dtype)
    for i, kind in enumerate(kinds):
        for j in range(3):
            factors = [kind[m][:, m] if m != j else (c if kind[m] is s else -s)[:, m] for m in range(3)]
            f[:, i, j] = WAVE * np.pi * factors[0] * factors[1] * factors[2]
    return f + np.eye(3)


def _stress(f: Numbers) -> Numbers:
    inverse = np.swapaxes(np.linalg.inv(f), -1, -2)
    return MU * (f - inverse) + LAMBDA * np.log(np.linalg.det(f))[:, None, None] * inverse


def _body_force(x: Floats) -> Floats:
    """(n, 3) N/mm3, minus the divergence of the stress, by a complex step in the place."""
    force = np.zeros_like(x)
    for j in range(3):
        place = x.astype(complex)
        place[:, j] += 1j * STEP
        force -= _stress(_gradient(place))[:, :, j].imag / STEP
    return force


def _rule(points: int) -> tuple[Floats, Floats]:
    """Barycentric points (q, 4) and weights (sum 1): Gauss's rule on a cube, its faces folded to a tetrahedron's."""
    g, w = np.polynomial.legendre.leggauss(points)
    g, w = 0.5 * (g + 1.0), 0.5 * w
    a, b, c = (m.ravel() for m in np.meshgrid(g, g, g, indexing="ij"))
    weight = np.einsum("i,j,k->ijk", w, w, w).ravel() * 6.0 * (1.0 - a) ** 2 * (1.0 - b)
    l1, l2 = a, b * (1.0 - a)
    l3 = c * (1.0 - a) * (1.0 - b)
    return np.stack([1.0 - l1 - l2 - l3, l1, l2, l3], 1), weight


def _shapes(nodes: int, points: Floats) -> Floats:
    """(q, nodes) shape functions at barycentric points."""
    if nodes == 4:
        return points
    middles = [4.0 * points[:, a] * points[:, b] for a, b in TET10_EDGES]
    return np.column_stack([points * (2.0 * points - 1.0), *middles])


def _mesh(cells: int, nodes: int) -> tuple[Floats, Ints]:
    """A cube's mesh, smoothly uneven inside, with straight edges."""
    positions, elements = box_mesh((cells,) * 3, (SIDE,) * 3, 4)
    s = np.sin(np.pi * positions / SIDE)
    positions = positions + 0.06 * SIDE * np.prod(s, axis=1, keepdims=True) * np.array([1.0, -0.7, 0.5])
    return (positions, elements) if nodes == 4 else quadratic(positions, elements)


def errors(cells: int, nodes: int) -> tuple[float, float]:
    """Relative errors of displacement (L2) and of its gradient (H1 seminorm); infinite where the solve failed.

    Every node is a bone that cannot turn, so that it can carry its share of the body force.
    """
    positions, elements = _mesh(cells, nodes)
    points, weights = _rule(GAUSS[nodes])
    corners = positions[elements[:, :4]]
    places = np.einsum("ql,tli->tqi", points, corners)
    edges = corners[:, 1:] - corners[:, :1]
    volumes = np.linalg.det(edges) / 6.0
    shapes = _shapes(nodes, points)
    shares = np.einsum(
        "t,q,qn,tqi->tni", volumes, weights, shapes, _body_force(places.reshape(-1, 3)).reshape(places.shape)
    )
    forces = np.zeros_like(positions)
    np.add.at(forces, elements, shares)

    n = len(positions)
    torso = make_torso(positions, [], np.zeros(6), (positions, elements), np.arange(n), *young_poisson(MU, LAMBDA))
    held = np.zeros((n, 6), dtype=bool)
    held[:, 3:] = True
    held[:, :3] = np.any((positions < 1e-9) | (positions > SIDE - 1e-9), axis=1, keepdims=True)
    exact = positions + _displacement(positions)
    start = TorsoState(exact, torso.rest_pose.bone_rotations, np.empty((0, 3)))
    load = LoadCase(PointsOnBones(np.arange(n), np.zeros((n, 3))), forces)
    found = EquilibriumProblem(torso, holds(held)).solve(load, start=start)
    if not found.converged:
        return np.inf, np.inf

    moves = (found.state.bone_positions - positions)[elements]
    wanted = _displacement(places.reshape(-1, 3)).reshape(places.shape)
    gap = np.einsum("qn,tni->tqi", shapes, moves) - wanted
    measure = volumes[:, None] * weights
    displacement = np.sqrt(np.sum(measure * np.sum(gap**2, -1)) / np.sum(measure * np.sum(wanted**2, -1)))
    slopes = _slopes(nodes, points, edges)
    f = _gradient(places.reshape(-1, 3)).reshape(*places.shape, 3) - np.eye(3)
    gap_f = np.einsum("tqnj,tni->tqij", slopes, moves) - f
    gradient = np.sqrt(np.sum(measure * np.sum(gap_f**2, (-1, -2))) / np.sum(measure * np.sum(f**2, (-1, -2))))
    return float(displacement), float(gradient)


def _slopes(nodes: int, points: Floats, edges: Floats) -> Floats:
    """(T, q, nodes, 3) gradients of the shape functions, by a complex step in the barycentric coordinates."""
    local = np.empty((len(points), nodes, 3))
    for j in range(3):
        moved = points.astype(complex)
        moved[:, j + 1] += 1j * STEP
        moved[:, 0] -= 1j * STEP
        local[:, :, j] = _shapes(nodes, moved).imag / STEP
    return np.einsum("qnk,tjk->tqnj", local, np.linalg.inv(edges))


def orders() -> Iterator[Check]:
    """Observed orders of convergence against the elements' theory."""
    for (nodes, (coarse, fine)), slack in zip(CELLS.items(), SLACK):
        before, after = errors(coarse, nodes), errors(fine, nodes)
        for norm, wanted, first, second, most in zip(("displacement", "gradient"), ORDERS[nodes], before, after, slack):
            order = np.log2(first / second) / np.log2(fine / coarse) if second > 0.0 else np.inf
            name = f"B7 manufactured solution: order of the {norm} less {wanted:g}, {nodes} nodes"
            yield judged(name, abs(order - wanted), most)


GROUPS = (orders,)
