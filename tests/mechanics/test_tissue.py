"""spinestiff.mechanics.tissue: the neo-Hookean element."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.torso import TissueMesh
from spinestiff.errors import TorsoError
from spinestiff.mechanics.tissue import (
    NODE_BARYCENTRICS,
    QUADRATURE,
    element_data,
    element_energies,
    element_gradient_products,
    element_gradients,
    element_hessians,
    projected_element_hessians,
    shape_gradients,
    smallest_nodal_jacobian,
)
from spinestiff.verification.models import box_mesh, shaken, toy_torso


def _case(nodes, seed=3, move=2.0):
    torso = toy_torso(1, nodes)
    data = element_data(torso.tissue)
    return torso, data, torso.node_positions(shaken(torso, seed, move=move))


@pytest.mark.parametrize("nodes", [4, 10])
def test_shape_functions_sum_to_one_and_reproduce_positions(nodes):
    points, weights = QUADRATURE[nodes]
    assert weights.sum() == pytest.approx(1.0, abs=1e-15)
    gradient = shape_gradients(nodes, points)
    # Sum of N is 1 only on the simplex: its derivative along the simplex vanishes.
    total = gradient.sum(1)
    assert total - total[:, :1] == pytest.approx(np.zeros_like(total), abs=1e-14)
    along = np.einsum("qal,ab->qbl", gradient, NODE_BARYCENTRICS[:nodes])
    assert along - along.mean(2, keepdims=True) == pytest.approx(
        np.tile(np.eye(4) - 0.25, (len(points), 1, 1)), abs=1e-14
    )


@pytest.mark.parametrize("nodes", [4, 10])
def test_rest_has_no_energy_and_no_force(nodes):
    torso, data, _ = _case(nodes)
    x = torso.tissue.rest_positions
    energy, smallest = element_energies(x, data.elements, data.gradients, data.weights)
    assert np.abs(energy).max() < 1e-10
    assert smallest == pytest.approx(np.ones(len(smallest)), abs=1e-12)
    assert np.abs(element_gradients(x, data.elements, data.gradients, data.weights)).max() < 1e-11


def _full(pairs):
    """(T, 3 n, 3 n) symmetric matrices from the blocks of node pairs a >= b."""
    n = round((np.sqrt(8 * pairs.shape[1] + 1) - 1) / 2)
    full = np.zeros((len(pairs), n, n, 3, 3))
    for pair, (a, b) in enumerate(zip(*np.tril_indices(n))):
        full[:, a, b] = pairs[:, pair]
        full[:, b, a] = np.swapaxes(pairs[:, pair], 1, 2)
    return full.transpose(0, 1, 3, 2, 4).reshape(len(pairs), 3 * n, 3 * n)


@pytest.mark.parametrize("nodes", [4, 10])
def test_gradient_and_hessian_are_derivatives_of_the_energy(nodes):
    _, data, x = _case(nodes)
    t = len(data.elements)
    mu, lam = np.linspace(0.5, 1.0, t), np.linspace(2.0, 3.0, t)
    direction = np.random.default_rng(2).normal(size=x.shape)

    def energy(h):
        parts, _ = element_energies(x + h * direction, data.elements, data.gradients, data.weights)
        return mu @ parts[:, 0] + lam @ parts[:, 1]

    def slope(h):
        parts = element_gradients(x + h * direction, data.elements, data.gradients, data.weights)
        nodal = mu[:, None, None] * parts[:, 0] + lam[:, None, None] * parts[:, 1]
        return np.sum(nodal * direction[data.elements])

    h = 1e-4
    assert slope(0.0) == pytest.approx((energy(h) - energy(-h)) / (2 * h), rel=1e-7)
    hessian = _full(element_hessians(x, data.elements, data.gradients, data.weights, mu, lam))
    d = direction[data.elements].reshape(t, -1)
    curvature = np.einsum("ti,tij,tj->", d, hessian, d)
    assert curvature == pytest.approx((slope(h) - slope(-h)) / (2 * h), rel=1e-6)
    assert element_gradient_products(x, data.elements, data.gradients, data.weights, direction) == pytest.approx(
        np.einsum(
            "tkai,tai->tk",
            element_gradients(x, data.elements, data.gradients, data.weights),
            direction[data.elements],
        ),
        rel=1e-12,
    )


@pytest.mark.parametrize("nodes", [4, 10])
def test_projected_hessian_equals_the_exact_one_where_nothing_is_negative(nodes):
    _, data, x = _case(nodes, move=0.01)
    torso = toy_torso(1, nodes)
    x = torso.tissue.rest_positions * [1.05, 1.04, 1.06]
    t = len(data.elements)
    mu, lam = np.full(t, 0.7), np.full(t, 1.9)
    exact = element_hessians(x, data.elements, data.gradients, data.weights, mu, lam)
    projected = projected_element_hessians(x, data, mu, lam)
    assert projected == pytest.approx(exact, abs=1e-10 * np.abs(exact).max())


@pytest.mark.parametrize("nodes", [4, 10])
def test_projected_hessian_is_never_negative_and_differs_where_the_exact_one_is(nodes):
    _, data, x = _case(nodes, move=3.0)
    t = len(data.elements)
    mu, lam = np.full(t, 0.02), np.full(t, 0.08)
    projected = _full(projected_element_hessians(x, data, mu, lam))
    assert np.linalg.eigvalsh(projected).min() > -1e-10 * np.abs(projected).max()
    exact = _full(element_hessians(x, data.elements, data.gradients, data.weights, mu, lam))
    assert np.linalg.eigvalsh(exact).min() < -1e-4 * np.abs(exact).max()


@pytest.mark.parametrize("nodes", [4, 10])
def test_an_inverted_element_has_infinite_energy(nodes):
    torso, data, _ = _case(nodes)
    x = torso.tissue.rest_positions * [1.0, 1.0, -1.0]
    energy, smallest = element_energies(x, data.elements, data.gradients, data.weights)
    assert (smallest < 0.0).all()
    assert np.isposinf(energy).all()
    flat = torso.tissue.rest_positions * [1.0, 1.0, 0.0]
    assert np.isposinf(element_energies(flat, data.elements, data.gradients, data.weights)[0]).all()


def test_elements_tied_whole_to_one_bone_are_left_out_and_all_others_kept():
    torso = toy_torso(1, 10)
    tied = torso.tissue.bone_of_node.copy()
    tied[torso.tissue.elements[0]] = 0
    tied[torso.tissue.elements[1]] = 1
    mesh = replace(torso.tissue, bone_of_node=tied)
    kept = element_data(mesh).number
    owner = tied[mesh.elements]
    whole = (owner >= 0).all(1) & (owner == owner[:, :1]).all(1)
    assert not np.isin(np.flatnonzero(whole), kept).any()
    assert len(kept) + whole.sum() == len(mesh.elements)
    assert whole.sum() >= 1


def test_a_rest_shape_inverted_at_a_quadrature_point_is_refused_by_number():
    positions, elements = box_mesh((1, 1, 1), (10.0, 10.0, 10.0), 10)
    positions = positions.copy()
    middle = elements[2, 4]
    corners = positions[elements[2, :4]]
    positions[middle] = corners.mean(0) + 2.5 * (corners.mean(0) - positions[middle])
    t = len(elements)
    mesh = TissueMesh(positions, elements, np.full(len(positions), -1), np.ones(t), np.ones(t))
    with pytest.raises(TorsoError, match=r"tissue element \d+ is inverted in the rest shape"):
        element_data(mesh)


def test_smallest_nodal_jacobian_sees_a_fold_at_a_node():
    positions, elements = box_mesh((1, 1, 1), (10.0, 10.0, 10.0), 10)
    assert smallest_nodal_jacobian(positions, positions * 1.1, elements) == pytest.approx(1.331)
    moved = positions.copy()
    edge = elements[0, 4]
    moved[edge] += 0.45 * (positions[elements[0, 0]] - positions[elements[0, 1]])
    assert smallest_nodal_jacobian(positions, moved, elements) < 0.0


def test_projected_hessian_sets_negative_eigenvalues_of_the_material_tangent_to_zero():
    """One four-node element: dP/dF by differences of P in closed form, its negative part removed."""
    _, data, x = _case(4, move=3.0)
    mu, lam = 0.02, 0.08
    ones = np.ones(len(data.elements))
    found = projected_element_hessians(x, data, mu * ones, lam * ones)

    def stress(f):
        g = np.linalg.inv(f).T
        return mu * (f - g) + lam * np.log(np.linalg.det(f)) * g

    removed = 0
    for t in range(len(data.elements)):
        f = np.einsum("ni,nj->ij", x[data.elements[t]], data.gradients[t, 0])
        h, tangent = 1e-5, np.empty((9, 9))
        for k in range(9):
            step = h * np.eye(9)[k].reshape(3, 3)
            tangent[:, k] = ((stress(f + step) - stress(f - step)) / (2 * h)).ravel()
        values, vectors = np.linalg.eigh(0.5 * (tangent + tangent.T))
        removed += int((values < -1e-4).sum())
        clamped = ((vectors * np.maximum(values, 0.0)) @ vectors.T).reshape(3, 3, 3, 3)
        g = data.gradients[t, 0]
        wanted = data.weights[t, 0] * np.einsum("ijkl,aj,bl->abik", clamped, g, g)[np.tril_indices(4)]
        assert found[t] == pytest.approx(wanted, abs=1e-6 * np.abs(wanted).max())
    assert removed > 3
