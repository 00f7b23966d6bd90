"""Neo-Hookean tissue (paper 3.1) on four- or ten-node tetrahedra: energy, gradient, Hessian of one element.

    Psi = mu/2 (I1 - 3) - mu log J + lambda/2 (log J)^2
    P   = mu (F - F^-T) + lambda log J F^-T
    K_ab = w [ mu (g_a . g_b) I + (mu - lambda log J) h_b h_a^T + lambda h_a h_b^T ],   h = F^-T g,

with g_a the gradient of node a's shape function at rest and w the quadrature weight. The kernels are plain
per-element functions in float64 without shared writes. An inverted point (J <= 0) has infinite energy.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np

from spinestiff.anatomy.points import rotation_second_derivative
from spinestiff.anatomy.stiffness import ParameterGroup
from spinestiff.anatomy.torso import TET10_EDGES, TissueMesh
from spinestiff.arrays import Floats, Ints
from spinestiff.errors import TorsoError
from spinestiff.mechanics.assembly import Configuration, ScaledLaw, Stiffness, Tangent, Unknowns

# Four points, exact for quadratics (Hammer, Marlowe and Stroud 1956); one point for the linear element.
_A, _B = 0.5854101966249685, 0.1381966011250105
QUADRATURE = {
    4: (np.full((1, 4), 0.25), np.array([1.0])),
    10: (np.full((4, 4), _B) + (_A - _B) * np.eye(4), np.full(4, 0.25)),
}
NODE_BARYCENTRICS = np.vstack([np.eye(4), [0.5 * (np.eye(4)[a] + np.eye(4)[b]) for a, b in TET10_EDGES]])


class ElementData(NamedTuple):
    """Constant data of the elements that can deform.

    elements : (T, n) nodes. gradients : (T, Q, n, 3) 1/mm, shape-function gradients at rest. weights : (T, Q) mm3.
    number : (T,) position in the mesh's element list.
    """

    elements: Ints
    gradients: Floats
    weights: Floats
    number: Ints


def shape_gradients(nodes: int, barycentric: Floats) -> Floats:
    """d N_a / d L_i at barycentric points (Q, 4) -> (Q, nodes, 4); L are the barycentric coordinates."""
    q = len(barycentric)
    if nodes == 4:
        return np.broadcast_to(np.eye(4), (q, 4, 4)).copy()
    gradient = np.zeros((q, 10, 4))
    corner = np.arange(4)
    gradient[:, corner, corner] = 4.0 * barycentric - 1.0
    for middle, (a, b) in enumerate(TET10_EDGES, start=4):
        gradient[:, middle, a] = 4.0 * barycentric[:, b]
        gradient[:, middle, b] = 4.0 * barycentric[:, a]
    return gradient


def rest_jacobians(positions: Floats, elements: Ints, barycentric: Floats) -> tuple[Floats, Floats]:
    """Jacobian dX/dL_{1..3} (T, Q, 3, 3) and shape gradients in those coordinates (Q, n, 3)."""
    local = shape_gradients(elements.shape[1], barycentric)
    reduced = local[:, :, 1:] - local[:, :, :1]
    return np.einsum("tni,qnj->tqij", positions[elements], reduced), reduced


def element_data(mesh: TissueMesh) -> ElementData:
    """Quadrature weights and shape gradients of every element that is not tied whole to one bone.

    Raises
    ------
    TorsoError : an element is inverted at a quadrature point in the rest shape.
    """
    deformable = mesh.deformable
    elements = mesh.elements[deformable]
    points, weights = QUADRATURE[elements.shape[1]]
    jacobian, reduced = rest_jacobians(mesh.rest_positions, elements, points)
    determinant = np.linalg.det(jacobian)
    if len(elements) and determinant.min() <= 0.0:
        worst = int(deformable[np.unravel_index(np.argmin(determinant), determinant.shape)[0]])
        raise TorsoError(f"tissue element {worst} is inverted in the rest shape (J = {determinant.min():.3g})")
    gradients = np.einsum("qnj,tqji->tqni", reduced, np.linalg.inv(jacobian))
    return ElementData(elements, np.ascontiguousarray(gradients), determinant * weights / 6.0, deformable)


@numba.njit(cache=True, nogil=True)
def _deformation(x, elements, gradients, t, q, f, g):  # type: ignore[no-untyped-def]
    """F into ``f``, F^-T into ``g``; returns J."""
    for i in range(3):
        f0, f1, f2 = 0.0, 0.0, 0.0
        for a in range(elements.shape[1]):
            own = x[elements[t, a], i]
            f0 += own * gradients[t, q, a, 0]
            f1 += own * gradients[t, q, a, 1]
            f2 += own * gradients[t, q, a, 2]
        f[i, 0], f[i, 1], f[i, 2] = f0, f1, f2
    g[0, 0] = f[1, 1] * f[2, 2] - f[1, 2] * f[2, 1]
    g[0, 1] = f[1, 2] * f[2, 0] - f[1, 0] * f[2, 2]
    g[0, 2] = f[1, 0] * f[2, 1] - f[1, 1] * f[2, 0]
    g[1, 0] = f[2, 1] * f[0, 2] - f[2, 2] * f[0, 1]
    g[1, 1] = f[2, 2] * f[0, 0] - f[2, 0] * f[0, 2]
    g[1, 2] = f[2, 0] * f[0, 1] - f[2, 1] * f[0, 0]
    g[2, 0] = f[0, 1] * f[1, 2] - f[0, 2] * f[1, 1]
    g[2, 1] = f[0, 2] * f[1, 0] - f[0, 0] * f[1, 2]
    g[2, 2] = f[0, 0] * f[1, 1] - f[0, 1] * f[1, 0]
    det = f[0, 0] * g[0, 0] + f[0, 1] * g[0, 1] + f[0, 2] * g[0, 2]
    if det > 0.0:
        for i in range(3):
            for j in range(3):
                g[i, j] /= det
    return det


@numba.njit(cache=True, nogil=True)
def element_energies(x, elements, gradients, weights):  # type: ignore[no-untyped-def]
    """(T, 2) energy per unit mu and per unit lambda, mm3; and (T,) smallest J. Infinite where J <= 0."""
    t_count, q_count = weights.shape
    energy = np.zeros((t_count, 2))
    smallest = np.full(t_count, np.inf)
    f, g = np.empty((3, 3)), np.empty((3, 3))
    for t in range(t_count):
        for q in range(q_count):
            det = _deformation(x, elements, gradients, t, q, f, g)
            smallest[t] = min(smallest[t], det)
            if not det > 0.0:
                energy[t] = np.inf
                break
            log_j = np.log(det)
            i1 = 0.0
            for i in range(3):
                i1 += f[i, 0] * f[i, 0] + f[i, 1] * f[i, 1] + f[i, 2] * f[i, 2]
            energy[t, 0] += weights[t, q] * (0.5 * (i1 - 3.0) - log_j)
            energy[t, 1] += weights[t, q] * 0.5 * log_j * log_j
    return energy, smallest


@numba.njit(cache=True, nogil=True)
def element_gradients(x, elements, gradients, weights):  # type: ignore[no-untyped-def]
    """(T, 2, n, 3) gradient of the energy per unit mu and per unit lambda, mm2."""
    t_count, q_count = weights.shape
    n = elements.shape[1]
    out = np.zeros((t_count, 2, n, 3))
    f, g = np.empty((3, 3)), np.empty((3, 3))
    for t in range(t_count):
        shear, volume = out[t, 0], out[t, 1]
        for q in range(q_count):
            weight = weights[t, q]
            log_j = np.log(_deformation(x, elements, gradients, t, q, f, g))
            for i in range(3):
                for j in range(3):
                    f[i, j] = weight * (f[i, j] - g[i, j])
                    g[i, j] *= weight * log_j
            for a in range(n):
                x0, x1, x2 = gradients[t, q, a, 0], gradients[t, q, a, 1], gradients[t, q, a, 2]
                for i in range(3):
                    shear[a, i] += f[i, 0] * x0 + f[i, 1] * x1 + f[i, 2] * x2
                    volume[a, i] += g[i, 0] * x0 + g[i, 1] * x1 + g[i, 2] * x2
    return out


@numba.njit(cache=True, nogil=True)
def element_gradient_products(x, elements, gradients, weights, direction):  # type: ignore[no-untyped-def]
    """(T, 2) the gradients of ``element_gradients`` times nodal values ``direction`` (N, 3)."""
    t_count, q_count = weights.shape
    out = np.zeros((t_count, 2))
    f, g, u = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for t in range(t_count):
        for q in range(q_count):
            log_j = np.log(_deformation(x, elements, gradients, t, q, f, g))
            u[:] = 0.0
            for a in range(elements.shape[1]):
                for i in range(3):
                    for j in range(3):
                        u[i, j] += direction[elements[t, a], i] * gradients[t, q, a, j]
            out[t, 0] += weights[t, q] * np.sum((f - g) * u)
            out[t, 1] += weights[t, q] * log_j * np.sum(g * u)
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def element_hessians(x, elements, gradients, weights, mu, lam):  # type: ignore[no-untyped-def]
    """(T, n (n + 1) / 2, 3, 3) Hessian blocks of the node pairs a >= b, row by row, in N/mm."""
    t_count, q_count = weights.shape
    n = elements.shape[1]
    out = np.zeros((t_count, n * (n + 1) // 2, 3, 3))
    f, g = np.empty((3, 3)), np.empty((3, 3))
    h = np.empty((n, 3))
    for t in range(t_count):
        for q in range(q_count):
            log_j = np.log(_deformation(x, elements, gradients, t, q, f, g))
            w_mu = weights[t, q] * mu[t]
            w_lam = weights[t, q] * lam[t]
            w_mix = w_mu - w_lam * log_j
            for a in range(n):
                for i in range(3):
                    h[a, i] = (
                        g[i, 0] * gradients[t, q, a, 0]
                        + g[i, 1] * gradients[t, q, a, 1]
                        + g[i, 2] * gradients[t, q, a, 2]
                    )
            pair = 0
            for a in range(n):
                g0, g1, g2 = gradients[t, q, a]
                h0, h1, h2 = h[a]
                for b in range(a + 1):
                    grad = gradients[t, q, b]
                    dot = w_mu * (g0 * grad[0] + g1 * grad[1] + g2 * grad[2])
                    m0, m1, m2 = w_mix * h[b, 0], w_mix * h[b, 1], w_mix * h[b, 2]
                    l0, l1, l2 = w_lam * h[b, 0], w_lam * h[b, 1], w_lam * h[b, 2]
                    block = out[t, pair]
                    block[0, 0] += (m0 + l0) * h0 + dot
                    block[0, 1] += m0 * h1 + l1 * h0
                    block[0, 2] += m0 * h2 + l2 * h0
                    block[1, 0] += m1 * h0 + l0 * h1
                    block[1, 1] += (m1 + l1) * h1 + dot
                    block[1, 2] += m1 * h2 + l2 * h1
                    block[2, 0] += m2 * h0 + l0 * h2
                    block[2, 1] += m2 * h1 + l1 * h2
                    block[2, 2] += (m2 + l2) * h2 + dot
                    pair += 1
    return out


def projected_element_hessians(x: Floats, data: ElementData, mu: Floats, lam: Floats) -> Floats:
    """As ``element_hessians`` with dP/dF's negative eigenvalues set to zero at each quadrature point.

    With F = U diag(s) V^T and c = mu - lambda log J, dP/dF has the eigenvalues mu +- c/(s_i s_j) on
    U (e_i e_j^T +- e_j e_i^T) V^T, and those of diag(mu + c/s_i^2) + lambda (1/s)(1/s)^T on U diag(.) V^T (found as
    Smith, de Goes and Kim 2019 do for isotropic energies). Used only where the exact tangent is indefinite: it keeps
    the step a descent direction but costs iterations.
    """
    blocks = element_hessians(x, data.elements, data.gradients, data.weights, mu, lam)
    _take_negative_out(blocks, x, data.elements, data.gradients, data.weights, mu, lam)
    return np.asarray(blocks)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _take_negative_out(blocks, x, elements, gradients, weights, mu, lam):  # type: ignore[no-untyped-def]
    f, g, u = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    square, v, diagonal, w = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    s, mode = np.empty(3), np.empty((3, 3))
    for t in range(len(elements)):
        for q in range(weights.shape[1]):
            c = mu[t] - lam[t] * np.log(_deformation(x, elements, gradients, t, q, f, g))
            for i in range(3):
                for j in range(3):
                    square[i, j] = f[0, i] * f[0, j] + f[1, i] * f[1, j] + f[2, i] * f[2, j]
            _diagonalise(square, v)
            for j in range(3):
                s[j] = np.sqrt(square[j, j])
                for i in range(3):
                    u[i, j] = (f[i, 0] * v[0, j] + f[i, 1] * v[1, j] + f[i, 2] * v[2, j]) / s[j]
            sign = -1.0 if c > 0.0 else 1.0
            for i in range(3):
                j = (i + 1) % 3
                value = mu[t] - abs(c) / (s[i] * s[j])
                if value < 0.0:
                    for k in range(3):
                        for m in range(3):
                            mode[k, m] = np.sqrt(0.5) * (u[k, i] * v[m, j] + sign * u[k, j] * v[m, i])
                    _add_mode(blocks[t], -value * weights[t, q], mode, gradients[t, q])
            if c < 0.0:
                for i in range(3):
                    for j in range(3):
                        diagonal[i, j] = lam[t] / (s[i] * s[j])
                    diagonal[i, i] += mu[t] + c / s[i] ** 2
                _diagonalise(diagonal, w)
                for i in range(3):
                    if diagonal[i, i] < 0.0:
                        for k in range(3):
                            for m in range(3):
                                mode[k, m] = 0.0
                                for j in range(3):
                                    mode[k, m] += u[k, j] * w[j, i] * v[m, j]
                        _add_mode(blocks[t], -diagonal[i, i] * weights[t, q], mode, gradients[t, q])


@numba.njit(cache=True, nogil=True)
def _add_mode(blocks, size, mode, gradients):  # type: ignore[no-untyped-def]
    """Add ``size`` times the square of a unit change of F, ``mode``, to the blocks of one element's node pairs."""
    moved = np.empty(gradients.shape)
    for a in range(len(gradients)):
        for i in range(3):
            moved[a, i] = mode[i, 0] * gradients[a, 0] + mode[i, 1] * gradients[a, 1] + mode[i, 2] * gradients[a, 2]
    pair = 0
    for a in range(len(gradients)):
        for b in range(a + 1):
            for i in range(3):
                for j in range(3):
                    blocks[pair, i, j] += size * moved[a, i] * moved[b, j]
            pair += 1


@numba.njit(cache=True, nogil=True)
def _diagonalise(a, v):  # type: ignore[no-untyped-def]
    """Jacobi's rotations: eigenvalues of a symmetric (3, 3) onto its diagonal, eigenvectors into the columns of v."""
    for i in range(3):  # a slice's assignment would take seconds to compile
        for j in range(3):
            v[i, j] = 1.0 if i == j else 0.0
    for _ in range(30):
        if a[0, 1] ** 2 + a[0, 2] ** 2 + a[1, 2] ** 2 <= 1e-32 * (a[0, 0] ** 2 + a[1, 1] ** 2 + a[2, 2] ** 2):
            break
        for p in range(2):
            for q in range(p + 1, 3):
                if a[p, q] == 0.0:
                    continue
                half = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
                tangent = (1.0 if half >= 0.0 else -1.0) / (abs(half) + np.sqrt(half * half + 1.0))
                cosine = 1.0 / np.sqrt(tangent * tangent + 1.0)
                sine = tangent * cosine
                for k in range(3):
                    a[k, p], a[k, q] = cosine * a[k, p] - sine * a[k, q], sine * a[k, p] + cosine * a[k, q]
                for k in range(3):
                    a[p, k], a[q, k] = cosine * a[p, k] - sine * a[q, k], sine * a[p, k] + cosine * a[q, k]
                    v[k, p], v[k, q] = cosine * v[k, p] - sine * v[k, q], sine * v[k, p] + cosine * v[k, q]


@numba.njit(cache=True, nogil=True)
def _scatter_elements(data, indptr, hessians, elements, entity, first_dof, arms, bones, offsets):  # type: ignore[no-untyped-def]
    """Add element Hessians (T, pairs, 3, 3) as ``element_hessians``, pulling tied nodes back to their bones.

    A tied node moves by dt - [arm]x dw, so its rows become [K; [arm]x K] and its columns [K, -K [arm]x].
    """
    n = elements.shape[1]
    block = np.empty((6, 6))
    for t in range(len(elements)):
        pair = 0
        for a in range(n):
            for b in range(a + 1):
                node_a, node_b = elements[t, a], elements[t, b]
                row, column = entity[node_a], entity[node_b]
                swap = row < column
                if swap:
                    node_a, node_b, row, column = node_b, node_a, column, row
                rows = 6 if row < bones else 3
                columns = 6 if column < bones else 3
                for i in range(3):
                    for j in range(3):
                        block[i, j] = hessians[t, pair, j, i] if swap else hessians[t, pair, i, j]
                if rows == 6:
                    x, y, z = arms[node_a, 0], arms[node_a, 1], arms[node_a, 2]
                    for j in range(3):
                        block[3, j] = y * block[2, j] - z * block[1, j]
                        block[4, j] = z * block[0, j] - x * block[2, j]
                        block[5, j] = x * block[1, j] - y * block[0, j]
                if columns == 6:
                    x, y, z = arms[node_b, 0], arms[node_b, 1], arms[node_b, 2]
                    for i in range(rows):
                        block[i, 3] = y * block[i, 2] - z * block[i, 1]
                        block[i, 4] = z * block[i, 0] - x * block[i, 2]
                        block[i, 5] = x * block[i, 1] - y * block[i, 0]
                offset = offsets[t, pair]
                pair += 1
                for k in range(columns):
                    base = indptr[first_dof[column] + k] + offset - k
                    if row == column:
                        for r in range(k, rows):
                            # Nodes a and b of one bone couple twice: K_ab and its transpose.
                            data[base + r] += block[r, k] if a == b else block[r, k] + block[k, r]
                    else:
                        for r in range(rows):
                            data[base + r] += block[r, k]


@numba.njit(cache=True, nogil=True)
def _add_to_nodes(nodes, elements, parts, mu, lambda_):  # type: ignore[no-untyped-def]
    for t in range(len(elements)):
        for a in range(elements.shape[1]):
            for i in range(3):
                nodes[elements[t, a], i] += mu[t] * parts[t, 0, a, i] + lambda_[t] * parts[t, 1, a, i]


class TissueLaw(ScaledLaw):
    """The tissue of a mesh, with the moduli ``Stiffness.mu`` and ``Stiffness.lambda_`` of its deformable elements."""

    def __init__(self, mesh: TissueMesh) -> None:
        self.data, self.count = element_data(mesh), len(mesh.elements)

    def pairs(self, unknowns: Unknowns) -> Ints:
        a, b = np.tril_indices(self.data.elements.shape[1])
        entities = unknowns.entity[self.data.elements]
        return np.stack([entities[:, a], entities[:, b]], -1).reshape(-1, 2)

    def energy(self, at: Configuration, stiffness: Stiffness) -> tuple[float, float]:
        d = self.data
        energy, smallest = element_energies(at.nodes, d.elements, d.gradients, d.weights)
        j = float(smallest.min(initial=np.inf))
        if not j > 0.0:
            return np.inf, j
        return float(stiffness.mu @ energy[:, 0] + stiffness.lambda_ @ energy[:, 1]), j

    def add_gradient(self, at: Configuration, stiffness: Stiffness, gradient: Floats) -> None:
        at.add_nodal(self._nodal_gradient(at, stiffness), gradient)

    def add_hessian(
        self, at: Configuration, stiffness: Stiffness, tangent: Tangent, offsets: Ints, project: bool
    ) -> None:
        d, of = self.data, at.unknowns
        if project:
            elements = projected_element_hessians(at.nodes, d, stiffness.mu, stiffness.lambda_)
        else:
            elements = element_hessians(at.nodes, d.elements, d.gradients, d.weights, stiffness.mu, stiffness.lambda_)
        arms = np.zeros_like(at.nodes)
        arms[of.tied] = at.tied_arms
        nodes = d.elements.shape[1]
        places = offsets.reshape(len(d.elements), nodes * (nodes + 1) // 2)
        _scatter_elements(
            tangent.values,
            tangent.pattern.indptr,
            elements,
            d.elements,
            of.entity,
            of.first_dof,
            arms,
            of.bones,
            places,
        )
        turning = rotation_second_derivative(self._nodal_gradient(at, stiffness)[of.tied], at.tied_arms)
        np.add.at(tangent.bones[:, 3:, 3:], of.tied_points.bone, turning)

    def add_shares(
        self, at: Configuration, stiffness: Stiffness, groups: Sequence[ParameterGroup], columns: Floats
    ) -> None:
        d = self.data
        parts = element_gradients(at.nodes, d.elements, d.gradients, d.weights)
        for group, column in zip(groups, columns.T):
            if group.mu or group.lambda_:
                at.add_nodal(self._assembled(at, parts, *self._moduli(group, stiffness)), column)

    def share_products(
        self, at: Configuration, stiffness: Stiffness, groups: Sequence[ParameterGroup], direction: Floats
    ) -> Floats:
        d = self.data
        parts = element_gradient_products(at.nodes, d.elements, d.gradients, d.weights, at.nodal_motion(direction))
        moduli = [self._moduli(group, stiffness) for group in groups]
        return np.array([mu @ parts[:, 0] + lambda_ @ parts[:, 1] for mu, lambda_ in moduli])

    def _moduli(self, group: ParameterGroup, stiffness: Stiffness) -> tuple[Floats, Floats]:
        """(T,) each, the moduli that a group scales; zero where it does not."""
        inside = group.elements_of(self.count)[self.data.number]
        return group.mu * inside * stiffness.mu, group.lambda_ * inside * stiffness.lambda_

    def _nodal_gradient(self, at: Configuration, stiffness: Stiffness) -> Floats:
        d = self.data
        parts = element_gradients(at.nodes, d.elements, d.gradients, d.weights)
        return self._assembled(at, parts, stiffness.mu, stiffness.lambda_)

    def _assembled(self, at: Configuration, parts: Floats, mu: Floats, lambda_: Floats) -> Floats:
        """Element gradients per unit mu and lambda (T, 2, n, 3), times the moduli, summed to nodes (N, 3)."""
        nodes = np.zeros_like(at.nodes)
        _add_to_nodes(nodes, self.data.elements, parts, mu, lambda_)
        return nodes


def smallest_nodal_jacobian(rest: Floats, x: Floats, elements: Ints) -> float:
    """The smallest volume ratio J at the elements' nodes, where a ten-node element can fold first."""
    points = NODE_BARYCENTRICS[: elements.shape[1]]
    before, after = (np.linalg.det(rest_jacobians(p, elements, points)[0]) for p in (rest, x))
    return float((after / before).min(initial=np.inf))
