"""A second, independent implementation of the total energy that takes complex numbers.

It shares no code with ``mechanics``: rotations come from power series, the rotation vector from quaternions, shape
functions from a monomial basis. Being analytic, its derivative is the imaginary part of a complex step, exact to
rounding (Squire and Trapp 1998); second derivatives are central differences of those, exact to about 1e-11.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.stiffness import StiffnessRatios
from spinestiff.anatomy.torso import TorsoModel, TorsoState
from spinestiff.arrays import Floats, Ints

Complexes = NDArray[np.complex128]
STEP = 1e-30
# Sixth-order central difference of the gradient.
DIFFERENCE_STEP = 2e-3
DIFFERENCE_WEIGHTS = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}


def _series(z: Complexes, first: int) -> Complexes:
    # sum_k (-z)^k / (2k + first)!: sin(p)/p for first = 1 and (1 - cos p)/p^2 for first = 2, z = p^2.
    term = np.ones_like(z) / np.prod(np.arange(1.0, first + 1))
    total = term.copy()
    for k in range(1, 25):
        term = -term * z / ((2 * k + first) * (2 * k + first - 1))
        total = total + term
    return total


def _cross(w: Complexes) -> Complexes:
    k = np.zeros((*w.shape[:-1], 3, 3), dtype=w.dtype)
    k[..., 0, 1], k[..., 0, 2], k[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    return k - np.swapaxes(k, -1, -2)


def rotation(w: Complexes) -> Complexes:
    """exp of (n, 3) rotation vectors, analytic in each component."""
    z = np.sum(w * w, axis=-1)[..., None, None]
    k = _cross(w)
    return np.eye(3) + _series(z, 1) * k + _series(z, 2) * (k @ k)


def rotation_vector(r: Complexes) -> Complexes:
    """log of (n, 3, 3) rotations through the quaternion; angles below about 3 rad."""
    real = 0.5 * np.sqrt(1.0 + np.trace(r, axis1=-2, axis2=-1))
    vee = np.stack([r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]], -1)
    imaginary = vee / (4.0 * real[..., None])
    z = np.sum(imaginary**2, axis=-1) / real**2
    root = np.sqrt(z + 0j)
    small = np.abs(z) < 1e-3
    powers = np.where(small, z, 0.0)[..., None] ** np.arange(8)
    series = powers @ (np.array([1, -1, 1, -1, 1, -1, 1, -1]) / (2.0 * np.arange(8) + 1.0))
    ratio = np.where(small, series, np.arctan(root) / np.where(small, 1.0, root))
    return 2.0 * (ratio / real)[..., None] * imaginary


def _monomials(p: Floats, order: int) -> Floats:
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    one = np.ones_like(x)
    linear = [one, x, y, z]
    return np.stack(linear if order == 1 else [*linear, x * x, y * y, z * z, x * y, y * z, x * z], -1)


def _monomial_gradients(p: Floats, order: int) -> Floats:
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    o, i = np.zeros_like(x), np.ones_like(x)
    dx, dy, dz = [o, i, o, o], [o, o, i, o], [o, o, o, i]
    if order == 2:
        dx += [2 * x, o, o, y, o, z]
        dy += [o, 2 * y, o, x, z, o]
        dz += [o, o, 2 * z, o, y, x]
    return np.stack([np.stack(d, -1) for d in (dx, dy, dz)], -1)


_CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
_NODES = {
    4: _CORNERS,
    10: np.vstack([_CORNERS, [[0.5, 0, 0], [0.5, 0.5, 0], [0, 0.5, 0], [0, 0, 0.5], [0.5, 0, 0.5], [0, 0.5, 0.5]]]),
}
_S = (5.0 - np.sqrt(5.0)) / 20.0
_POINTS = {4: np.full((1, 3), 0.25), 10: _S + (1.0 - 4.0 * _S) * np.vstack([np.zeros(3), np.eye(3)])}


def tissue_energy(rest: Floats, x: Complexes, elements: Ints, mu: Floats, lam: Floats) -> complex:
    """Neo-Hookean energy of all elements, N mm."""
    n = elements.shape[1]
    order, nodes, points = (1 if n == 4 else 2), _NODES[n], _POINTS[n]
    shape = np.linalg.solve(
        _monomials(nodes, order).T, _monomial_gradients(points, order).transpose(1, 0, 2).reshape(n, -1)
    )
    local = shape.reshape(n, len(points), 3)
    jacobian = np.einsum("tni,nqj->tqij", rest[elements], local)
    f = np.einsum("tni,nqj->tqij", x[elements], local) @ np.linalg.inv(jacobian)
    a, b, c = f[..., 0, :], f[..., 1, :], f[..., 2, :]
    j = np.sum(
        a
        * np.stack(
            [b[..., (i + 1) % 3] * c[..., (i + 2) % 3] - b[..., (i + 2) % 3] * c[..., (i + 1) % 3] for i in range(3)],
            -1,
        ),
        -1,
    )
    log_j = np.log(j)
    density = (
        0.5 * mu[:, None] * (np.sum(f * f, axis=(-1, -2)) - 3.0) - mu[:, None] * log_j + 0.5 * lam[:, None] * log_j**2
    )
    return complex(np.sum(density * np.linalg.det(jacobian)) / (6.0 * len(points)))


class EnergyOracle:
    """The energy of a torso around a state as an analytic function of ``dx`` (dofs,), complex or real.

    Parameters
    ----------
    torso, state : where.
    ratios : stiffness ratios, None for the defaults.
    forces : dead forces at points, as in a load case; or None.
    springs : (points, targets, directions, stiffness) of supports; or None.
    """

    def __init__(
        self,
        torso: TorsoModel,
        state: TorsoState,
        ratios: StiffnessRatios | None = None,
        forces: tuple[PointsOnBones, Floats] | None = None,
        springs: tuple[PointsOnBones, Floats, Floats, Floats] | None = None,
    ) -> None:
        self._torso, self._state, self._forces, self._springs = torso, state, forces, springs
        self._stiffness = ratios.scale_joints(torso.joints.stiffness) if ratios else torso.joints.stiffness
        self._tissue = ratios.tissue if ratios else (1.0, 1.0)
        self.parts: tuple[str, ...] = ("joints", "tissue", "loads", "springs")

    def __call__(self, dx: Complexes) -> complex:
        torso, state = self._torso, self._state
        b = len(torso.bone_names)
        bones = np.asarray(dx)[: 6 * b].reshape(b, 6)
        t = state.bone_positions + bones[:, :3]
        r = rotation(bones[:, 3:]) @ state.bone_rotations
        free = state.tissue_positions + np.asarray(dx)[6 * b :].reshape(-1, 3)

        def ride(points: PointsOnBones) -> Complexes:
            return t[points.bone] + np.sum(r[points.bone] * points.offset[:, None, :], axis=-1)

        total = 0j
        if "joints" in self.parts:
            total += self._joint_energy(t, r)
        if "tissue" in self.parts and len(torso.tissue.elements):
            x = np.empty(torso.tissue.rest_positions.shape, dtype=complex)
            tied = torso.tissue.bone_of_node >= 0
            x[tied], x[~tied] = ride(torso.tied_nodes), free
            mu, lam = self._tissue[0] * torso.tissue.lame_mu, self._tissue[1] * torso.tissue.lame_lambda
            total += tissue_energy(torso.tissue.rest_positions, x, torso.tissue.elements, mu, lam)
        if "loads" in self.parts and self._forces:
            total -= np.sum(self._forces[1] * ride(self._forces[0]))
        if "springs" in self.parts and self._springs:
            points, targets, directions, k = self._springs
            total += 0.5 * np.sum(k * np.sum(directions * (ride(points) - targets), axis=1) ** 2)
        return complex(total)

    def _joint_energy(self, t: Complexes, r: Complexes) -> complex:
        j = self._torso.joints
        axes = r[j.parent] @ j.parent_axes
        centre = {
            side: t[bone] + np.sum(r[bone] * position[:, None, :], axis=-1)
            for side, bone, position in (("p", j.parent, j.parent_position), ("c", j.child, j.child_position))
        }
        d = np.sum(axes * (centre["c"] - centre["p"])[:, :, None], axis=1)
        theta = rotation_vector(np.swapaxes(axes, -1, -2) @ r[j.child] @ j.child_axes)
        return complex(0.5 * np.sum(self._stiffness * np.hstack([d, theta]) ** 2))


def complex_step_gradient(function: Callable[[Complexes], complex], at: Floats, which: Sequence[int]) -> Floats:
    """d function / d x_i for the components ``which``, by a complex step."""
    gradient = np.empty(len(which))
    for i, component in enumerate(which):
        z = at.astype(complex)
        z[component] += 1j * STEP
        gradient[i] = function(z).imag / STEP
    return gradient


def hessian_times(function: Callable[[Complexes], complex], direction: Floats, which: Sequence[int]) -> Floats:
    """(H direction)_i at 0: sixth-order central difference of complex-step gradients."""
    total = np.zeros(len(which))
    for k, weight in DIFFERENCE_WEIGHTS.items():
        at = k * DIFFERENCE_STEP * direction
        total += weight * (complex_step_gradient(function, at, which) - complex_step_gradient(function, -at, which))
    return total / DIFFERENCE_STEP
