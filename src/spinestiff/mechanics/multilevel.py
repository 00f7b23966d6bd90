"""Large meshes without factorising them: conjugate gradients, preconditioned on two levels.

The coarse level keeps the bones and the corner nodes of ten-node tetrahedra; a node in the middle of an edge takes the
mean of its two ends. Its matrix P^T K P, P the prolongation, has an eighth of the nodes and is factorised. The fine
level is smoothed by a symmetric Gauss-Seidel sweep before and after. Time and memory grow little faster than the number
of nodes (what is left to factorise is an eighth), where a factorisation's time grows with its square.
"""

from __future__ import annotations

import numba
import numpy as np
import scipy.sparse as sp

from spinestiff.anatomy.torso import TET10_EDGES
from spinestiff.arrays import Floats, Ints
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.factor import Analysis, Factor, symmetric_product
from spinestiff.mechanics.potential import Potential

TWO_LEVEL = "two-level"
# From this many unknowns on (30,000 nodes) two levels cost less than a factorisation (docs/validation.md).
MANY_DOFS = 80_000
STEP_TOLERANCE = 1e-4  # of the linear system of a Newton step
LARGEST_ITERATIONS = 400
PROBE_STEPS = 12


def corner_prolongation(potential: Potential) -> sp.csr_array:
    """(dofs, m) all degrees of freedom from those of bones and free corners: a middle node moves as its ends' mean.

    An end that is tied moves with its bone, to first order about the rest pose.
    """
    torso, bones, free = potential.torso, 6 * potential.bones, potential.unknowns.free
    mesh = torso.tissue
    ends = np.full((len(mesh.rest_positions), 2), -1)
    for middle, (a, b) in enumerate(TET10_EDGES[: mesh.elements.shape[1] - 4], start=4):
        ends[mesh.elements[:, middle]] = mesh.elements[:, [a, b]]
    corner = free[ends[free, 0] < 0]
    own_row, coarse = np.full(len(ends), -1), np.full(len(ends), -1)
    own_row[free], coarse[corner] = bones + 3 * np.arange(len(free)), bones + 3 * np.arange(len(corner))
    arms = np.zeros((len(ends), 3))
    arms[potential.unknowns.tied] = potential.unknowns.tied_points.arms(torso.rest_pose)
    diagonal = np.arange(bones)
    rows, columns, values = [diagonal], [diagonal], [np.ones(bones)]

    def moves_with(nodes: Ints, sources: Ints, share: float) -> None:
        on_bone = mesh.bone_of_node[sources] >= 0
        for i in range(3):
            parts = [(coarse[sources[~on_bone]] + i, np.ones((~on_bone).sum()), ~on_bone)]
            j, k = (i + 1) % 3, (i + 2) % 3
            bone, arm = 6 * mesh.bone_of_node[sources[on_bone]], arms[sources[on_bone]]
            parts += [(bone + i, np.ones(len(bone)), on_bone)]
            parts += [(bone + 3 + j, arm[:, k], on_bone), (bone + 3 + k, -arm[:, j], on_bone)]
            for column, value, which in parts:
                rows.append(own_row[nodes[which]] + i)
                columns.append(column)
                values.append(share * value)

    moves_with(corner, corner, 1.0)
    middle_nodes = free[ends[free, 0] >= 0]
    for end in (0, 1):
        moves_with(middle_nodes, ends[middle_nodes, end], 0.5)
    shape = (potential.dofs, bones + 3 * len(corner))
    return sp.csr_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape)


class TwoLevelAnalysis:
    """What stays the same for all value arrays in one pattern; ``factor`` as ``mechanics.factor.Analysis`` has it.

    Parameters
    ----------
    indptr, indices : compressed columns of the lower triangle, diagonal first.
    prolongation : (n, m) from the coarse level's unknowns to all.
    scale : (n,) units in which unknowns compare.
    """

    def __init__(self, indptr: Ints, indices: Ints, prolongation: sp.csr_array, scale: Floats) -> None:
        n = len(indptr) - 1
        self._indptr, self._indices, self._scale = indptr, indices, scale
        self._scale_of_value = np.repeat(scale, np.diff(indptr)) * scale[indices]
        # Unknowns times their scale on both levels.
        coarse_scale = np.ones(prolongation.shape[1])
        own = np.diff(prolongation.indptr) == 1
        coarse_scale[prolongation.indices[prolongation.indptr[:-1][own]]] = scale[own]
        self._p = sp.csr_array(sp.diags_array(1.0 / scale) @ prolongation @ sp.diags_array(coarse_scale))
        self._shape = (n, n)
        self._coarse: tuple[Ints, Ints, Analysis] | None = None
        self.backend = TWO_LEVEL

    def factor(self, values: Floats) -> TwoLevelFactor:
        """The preconditioner of the matrix with these ``values``.

        Raises
        ------
        EquilibriumError : the coarse matrix is singular or a value is not finite.
        """
        if not np.isfinite(values).all():
            raise EquilibriumError("the stiffness matrix holds a value that is not finite")
        scaled = values * self._scale_of_value
        lower = sp.csc_array((scaled, self._indices, self._indptr), shape=self._shape)
        # P^T K P from the lower triangle alone: K = L + L^T - D.
        half = lower.copy()
        half.data = scaled.copy()
        half.data[self._indptr[:-1]] *= 0.5
        product = self._p.T @ (half @ self._p)
        coarse = sp.csc_array(sp.tril(product + product.T))
        coarse.sort_indices()
        pointers, rows = coarse.indptr.astype(np.int64), coarse.indices.astype(np.int64)
        known = self._coarse
        if known is None or not (np.array_equal(known[0], pointers) and np.array_equal(known[1], rows)):
            known = self._coarse = (pointers, rows, Analysis(pointers, rows))
        return TwoLevelFactor(lower, known[2].factor(coarse.data), self._p, self._scale)


class TwoLevelFactor(Factor):
    """A matrix with its two-level preconditioner; solves are iterative, so that a factor is no cheaper to keep.

    ``positive_definite``: the coarse matrix is, and no direction of negative curvature turned up in a Lanczos probe
    from a random vector.
    """

    iterative = True

    def __init__(self, lower: sp.csc_array, coarse: Factor, prolongation: sp.csr_array, scale: Floats) -> None:
        self._lower, self._coarse, self._p, self._scale = lower, coarse, prolongation, scale
        self._diagonal = lower.data[lower.indptr[:-1]]
        self.positive_definite = coarse.positive_definite and bool((self._diagonal > 0.0).all())
        if self.positive_definite:
            probe = np.random.default_rng(0).normal(size=len(scale))
            self.positive_definite = self._conjugate_gradients(probe, 0.0, PROBE_STEPS)[1]

    def solve(self, rhs: Floats, tolerance: float = 1e-12) -> Floats:
        """Solution for (n,) or (n, k); residual below ``tolerance`` times the right-hand side, scaled, at best 1e-12.

        Raises
        ------
        EquilibriumError : the iteration does not come below 1e-8 (or ``tolerance``, if that is larger).
        """
        columns = rhs.reshape(len(rhs), -1)
        solved = [self._solve(columns[:, i] * self._scale, tolerance) for i in range(columns.shape[1])]
        return (np.stack(solved, 1) * self._scale[:, None]).reshape(rhs.shape)

    def inverse(self, rhs: Floats) -> Floats:
        return self.solve(rhs, STEP_TOLERANCE)

    def _solve(self, b: Floats, tolerance: float) -> Floats:
        size = float(np.abs(b).max(initial=0.0))
        if size == 0.0:
            return np.zeros_like(b)
        x, definite = self._conjugate_gradients(b, max(tolerance, 1e-12) * size, LARGEST_ITERATIONS)
        # The iteration's own residual is a recursion, which loses touch with the true one.
        error = float(np.abs(b - self._product(x)).max())
        if not definite or error > max(tolerance, 1e-8) * size:
            what = "is not positive definite" if not definite else f"leaves a relative residual of {error / size:.1e}"
            raise EquilibriumError(f"the iterative solver found that the stiffness matrix {what}; use a direct solver")
        return x

    def _conjugate_gradients(self, b: Floats, goal: float, limit: int) -> tuple[Floats, bool]:
        x, r = np.zeros_like(b), b.copy()
        p = z = self._precondition(r)
        rz, error = float(r @ z), float(np.abs(b).max())
        for _ in range(limit):
            if error <= goal:
                break
            kp = self._product(p)
            curvature = float(p @ kp)
            if not curvature > 0.0 or not rz > 0.0:
                return x, False
            x += (rz / curvature) * p
            r -= (rz / curvature) * kp
            error = float(np.abs(r).max())
            z = self._precondition(r)
            last, rz = rz, float(r @ z)
            p = z + (rz / last) * p
        return x, True

    def _precondition(self, r: Floats) -> Floats:
        pointers, rows, data = self._lower.indptr, self._lower.indices, self._lower.data
        z = _gauss_seidel(pointers, rows, data, r)
        left = r - self._product(z)
        z += self._p @ self._coarse.inverse(self._p.T @ left)
        left = r - self._product(z)
        z += _gauss_seidel(pointers, rows, data, left)
        return z

    def _product(self, x: Floats) -> Floats:
        return symmetric_product(self._lower.indptr, self._lower.indices, self._lower.data, x)


@numba.njit(cache=True, nogil=True)
def _gauss_seidel(indptr, indices, lower, r):  # type: ignore[no-untyped-def]
    """(D + L)^-T D (D + L)^-1 r for the compressed columns of a lower triangle, diagonal first."""
    z = r.copy()
    n = len(r)
    for column in range(n):
        first = indptr[column]
        z[column] /= lower[first]
        for p in range(first + 1, indptr[column + 1]):
            z[indices[p]] -= lower[p] * z[column]
    for column in range(n - 1, -1, -1):
        first = indptr[column]
        sum_ = lower[first] * z[column]
        for p in range(first + 1, indptr[column + 1]):
            sum_ -= lower[p] * z[indices[p]]
        z[column] = sum_ / lower[first]
    return z
