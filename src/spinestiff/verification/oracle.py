"""A second, independent implementation of the total energy that takes complex numbers.

It shares no code with ``mechanics``: rotations come from power series, the rotation vector from quaternions, shape
functions from a monomial basis. Being analytic, its derivative is the imaginary part of a complex step, exact to
rounding (Squire and Trapp 1998). It also takes dual numbers over the complex ones, and the slope of a complex step is
a second derivative, as exact.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import StiffnessRatios
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, Ints

Complexes = NDArray[np.complexfloating]
STEP = 1e-30


class Dual(np.lib.mixins.NDArrayOperatorsMixin):
    """An array of numbers value + slope e with e^2 = 0: what is done to it is done to its derivative too.

    Attributes
    ----------
    value, slope : complex arrays of one shape. Plain arrays beside it count as constants.
    """

    def __init__(self, value: Complexes, slope: Complexes) -> None:
        self.value, self.slope = value, slope

    @property
    def shape(self) -> tuple[int, ...]:
        return self.value.shape

    def reshape(self, *shape: int) -> Dual:
        return Dual(self.value.reshape(*shape), self.slope.reshape(*shape))

    def __getitem__(self, key: Any) -> Dual:
        return Dual(self.value[key], self.slope[key])

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **kwargs: Any) -> Any:
        if method != "__call__" or kwargs or ufunc not in _RULES:
            return NotImplemented
        return _RULES[ufunc](*inputs)

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        if function is np.einsum:  # of one dual operand and constants
            rule, *operands = args
            slopes = [x.slope if isinstance(x, Dual) else x for x in operands]
            return Dual(np.einsum(rule, *(_value(x) for x in operands)), np.einsum(rule, *slopes))
        if function not in _LINEAR:
            return NotImplemented
        first, *rest = args
        if isinstance(first, Dual):
            return Dual(function(first.value, *rest, **kwargs), function(first.slope, *rest, **kwargs))
        values, slopes = [_value(x) for x in first], [_slope(x) for x in first]
        return Dual(function(values, *rest, **kwargs), function(slopes, *rest, **kwargs))


def _value(x: Any) -> Any:
    return x.value if isinstance(x, Dual) else x


def _slope(x: Any) -> Any:
    return x.slope if isinstance(x, Dual) else np.zeros_like(x)


def _product(multiply: Any) -> Callable[[Any, Any], Dual]:
    def rule(a: Any, b: Any) -> Dual:
        slope = 0.0
        if isinstance(a, Dual):
            slope = slope + multiply(a.slope, _value(b))
        if isinstance(b, Dual):
            slope = slope + multiply(_value(a), b.slope)
        return Dual(multiply(_value(a), _value(b)), np.asarray(slope))

    return rule


def _function(function: Any, derivative: Callable[[Any], Any]) -> Callable[[Dual], Dual]:
    return lambda a: Dual(function(a.value), derivative(a.value) * a.slope)


def _add(a: Any, b: Any) -> Dual:
    return Dual(_value(a) + _value(b), _slope(a) + _slope(b))


_invert = _function(np.reciprocal, lambda v: -1.0 / v**2)
_RULES: dict[Any, Callable[..., Any]] = {
    np.add: _add,
    np.subtract: lambda a, b: _add(a, -b),
    np.negative: lambda a: Dual(-a.value, -a.slope),
    np.multiply: _product(np.multiply),
    np.matmul: _product(np.matmul),
    np.true_divide: lambda a, b: a * _invert(b) if isinstance(b, Dual) else Dual(a.value / b, a.slope / b),
    np.sqrt: _function(np.sqrt, lambda v: 0.5 / np.sqrt(v)),
    np.log: _function(np.log, lambda v: 1.0 / v),
    np.arctan: _function(np.arctan, lambda v: 1.0 / (1.0 + v**2)),
    np.absolute: lambda a: np.abs(a.value),
}
_LINEAR = (np.sum, np.trace, np.swapaxes, np.stack, np.hstack, np.concatenate)
# What the oracle computes with: complex arrays, or dual ones.
Numbers = Any


def _series(z: Numbers, first: int) -> Numbers:
    # sum_k (-z)^k / (2k + first)!: sin(p)/p for first = 1 and (1 - cos p)/p^2 for first = 2, z = p^2.
    term = 0.0 * z + 1.0 / np.prod(np.arange(1.0, first + 1))
    total = term
    for k in range(1, 25):
        term = -term * z / ((2 * k + first) * (2 * k + first - 1))
        total = total + term
    return total


def _cross(w: Numbers) -> Numbers:
    x, y, z = w[..., 0], w[..., 1], w[..., 2]
    nought = 0.0 * x
    rows = [[nought, -z, y], [z, nought, -x], [-y, x, nought]]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def _choose(condition: NDArray[np.bool_], a: Numbers, b: Numbers) -> Numbers:
    if isinstance(a, Dual) or isinstance(b, Dual):
        return Dual(np.where(condition, _value(a), _value(b)), np.where(condition, _slope(a), _slope(b)))
    return np.where(condition, a, b)


def rotation(w: Numbers) -> Numbers:
    """exp of (n, 3) rotation vectors, analytic in each component."""
    z = np.sum(w * w, axis=-1)[..., None, None]
    k = _cross(w)
    return np.eye(3) + _series(z, 1) * k + _series(z, 2) * (k @ k)


def rotation_vector(r: Numbers) -> Numbers:
    """log of (n, 3, 3) rotations through the quaternion; angles below about 3 rad."""
    real = 0.5 * np.sqrt(1.0 + np.trace(r, axis1=-2, axis2=-1))
    vee = np.stack([r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]], -1)
    imaginary = vee / (4.0 * real[..., None])
    z = np.sum(imaginary * imaginary, axis=-1) / (real * real)
    small = np.abs(z) < 1e-3
    # arctan(sqrt z) / sqrt z, whose root cannot be differentiated at nought.
    near, root = _choose(small, z, 0.0), np.sqrt(_choose(small, 1.0, z))
    series = 0.0 * near
    for k in reversed(range(8)):
        series = series * near + (-1.0) ** k / (2.0 * k + 1.0)
    ratio = _choose(small, series, np.arctan(root) / root)
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


def volume_ratios(rest: Floats, x: Numbers, elements: Ints) -> Numbers:
    """(T, Q) J = det F at the integration points."""
    return _deformation(rest, x, elements)[1]


def tissue_energy(rest: Floats, x: Numbers, elements: Ints, mu: Floats, lam: Floats) -> Numbers:
    """Neo-Hookean energy of all elements, N mm."""
    f, j, volumes = _deformation(rest, x, elements)
    log_j = np.log(j)
    shear = 0.5 * (np.sum(f * f, axis=(-1, -2)) - 3.0) - log_j
    density = mu[:, None] * shear + 0.5 * lam[:, None] * (log_j * log_j)
    return np.sum(density * volumes)


def _deformation(rest: Floats, x: Numbers, elements: Ints) -> tuple[Numbers, Numbers, Floats]:
    """F (T, Q, 3, 3), J (T, Q) and the volumes (T, Q) mm3 of the integration points."""
    n = elements.shape[1]
    order, nodes, points = (1 if n == 4 else 2), _NODES[n], _POINTS[n]
    shape = np.linalg.solve(
        _monomials(nodes, order).T, _monomial_gradients(points, order).transpose(1, 0, 2).reshape(n, -1)
    )
    local = shape.reshape(n, len(points), 3)
    jacobian = np.einsum("tni,nqj->tqij", rest[elements], local)
    f = np.einsum("tni,nqj->tqij", x[elements], local) @ np.linalg.inv(jacobian)
    a, b, c = f[..., 0, :], f[..., 1, :], f[..., 2, :]
    normal = np.stack(
        [b[..., (i + 1) % 3] * c[..., (i + 2) % 3] - b[..., (i + 2) % 3] * c[..., (i + 1) % 3] for i in range(3)], -1
    )
    return f, np.sum(a * normal, -1), np.linalg.det(jacobian) / (6.0 * len(points))


class EnergyOracle:
    """The energy of a torso around a state as an analytic function of ``dx`` (dofs,), complex or real.

    Parameters
    ----------
    torso, state : where.
    ratios : stiffness ratios, None for the defaults.
    forces : dead forces at points of bones, as in a load case; or None.
    node_forces : (M,) free nodes and (M, 3) forces there, as in a load case; or None.
    springs : (points, targets, directions, stiffness) of supports; or None.
    """

    def __init__(
        self,
        torso: TorsoModel,
        state: TorsoState,
        ratios: StiffnessRatios | None = None,
        forces: tuple[PointsOnBones, Floats] | None = None,
        springs: tuple[PointsOnBones, Floats, Floats, Floats] | None = None,
        node_forces: tuple[Ints, Floats] | None = None,
    ) -> None:
        self._torso, self._state, self._forces, self._springs = torso, state, forces, springs
        self._node_forces = node_forces
        self._stiffness = ratios.scale_joints(torso.joints.stiffness) if ratios else torso.joints.stiffness
        mesh = torso.tissue
        moduli = mesh.lame_mu, mesh.lame_lambda
        self._moduli = ratios.scale_tissue(*moduli) if ratios else moduli
        self.parts: tuple[str, ...] = ("joints", "tissue", "loads", "springs")

    def __call__(self, dx: Numbers) -> Numbers:
        torso, state = self._torso, self._state
        b = len(torso.bone_names)
        bones = dx[: 6 * b].reshape(b, 6)
        t = state.bone_positions + bones[:, :3]
        r = rotation(bones[:, 3:]) @ state.bone_rotations
        free = state.tissue_positions + dx[6 * b :].reshape(-1, 3)

        def ride(points: PointsOnBones) -> Numbers:
            return t[points.bone] + np.sum(r[points.bone] * points.offset[:, None, :], axis=-1)

        total = 0j
        if "joints" in self.parts:
            total = total + self._joint_energy(t, r)
        if "tissue" in self.parts and len(torso.tissue.elements):
            tied = torso.tissue.bone_of_node >= 0
            place = np.where(tied, np.cumsum(tied) - 1, tied.sum() + np.cumsum(~tied) - 1)
            x = np.concatenate([ride(torso.tied_nodes), free])[place]
            total = total + tissue_energy(torso.tissue.rest_positions, x, torso.tissue.elements, *self._moduli)
        if "loads" in self.parts and self._forces:
            total = total - np.sum(self._forces[1] * ride(self._forces[0]))
        if "loads" in self.parts and self._node_forces:
            total = total - np.sum(self._node_forces[1] * free[self._node_forces[0]])
        if "springs" in self.parts and self._springs:
            points, targets, directions, k = self._springs
            extension = np.sum(directions * (ride(points) - targets), axis=1)
            total = total + 0.5 * np.sum(k * (extension * extension))
        return total

    def _joint_energy(self, t: Numbers, r: Numbers) -> Numbers:
        j = self._torso.joints
        axes = r[j.parent] @ j.parent_axes
        centre = {
            side: t[bone] + np.sum(r[bone] * position[:, None, :], axis=-1)
            for side, bone, position in (("p", j.parent, j.parent_position), ("c", j.child, j.child_position))
        }
        d = np.sum(axes * (centre["c"] - centre["p"])[:, :, None], axis=1)
        strain = np.hstack([d, rotation_vector(np.swapaxes(axes, -1, -2) @ r[j.child] @ j.child_axes)])
        return 0.5 * np.sum(self._stiffness * (strain * strain))


def complex_step_gradient(function: Callable[[Complexes], Any], at: Floats, which: Sequence[int]) -> Floats:
    """d function / d x_i for the components ``which``, by a complex step."""
    gradient = np.empty(len(which))
    for i, component in enumerate(which):
        z = at.astype(complex)
        z[component] += 1j * STEP
        gradient[i] = function(z).imag / STEP
    return gradient


def slope_along(function: Callable[[Complexes], Any], direction: Floats) -> float:
    """d function . ``direction`` at 0, by a complex step."""
    return float(function(1j * STEP * direction).imag / STEP)


def curvature_along(function: Callable[[Any], Any], first: Floats, second: Floats) -> float:
    """first^T H second at 0: the slope along ``second`` of a complex step along ``first``."""
    return float(function(Dual(1j * STEP * first, second.astype(complex))).slope.imag / STEP)


def hessian_times(function: Callable[[Any], Any], direction: Floats, which: Sequence[int]) -> Floats:
    """(H direction)_i at 0 for the components ``which``."""
    units = np.eye(len(direction))
    return np.array([curvature_along(function, units[i], direction) for i in which])
