"""Symmetric sparse factorisation: analyse a pattern once, factor many value arrays. The only place that knows a solver.

Backends: "rslab" (LDL^T, Bunch-Kaufman, inertia reported), "superlu" (SciPy's LU without row exchanges) and, where it
is asked for, "cudss" (LDL^T on an NVIDIA GPU; what fails there is done by rslab). Without exchanges a symmetric matrix
has U = D L^T, so the signs of U's diagonal are the inertia (Sylvester's law); where SuperLU had to exchange rows the
count does not hold, and the matrix is reported as not positive definite.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from functools import lru_cache
from types import ModuleType
from typing import Protocol

import numba
import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from spinestiff.arrays import Floats, Ints
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.cudss import CudssAnalysis, GpuFailure, require_gpu
from spinestiff.parallel import own_threads

# A free body's six rigid modes pass a factorisation in silence and give |x| ~ 1e15; the residual shows it.
RESIDUAL_LIMIT = 1e-8
# A solution of a very stiff and very soft matrix may leave more than that by rounding alone, but not more than this.
LARGEST_ROUNDING = 1e-5
EPSILON = float(np.finfo(float).eps)
BACKENDS = ("rslab", "superlu", "cudss")
# Of one factorisation; more gain nothing at these sizes. The factor is the same for any number.
MOST_THREADS = 4


_log = logging.getLogger(__name__)


class _Backend(Protocol):
    positive_definite: bool

    def solve(self, rhs: Floats) -> Floats: ...


class Factor:
    """A factorised symmetric matrix.

    Parameters
    ----------
    lower : the matrix's lower triangle, rows and columns times ``scale`` (n,).
    backend : its factor. spare : makes another one, if that fails a right-hand side.

    Attributes
    ----------
    positive_definite : whether all eigenvalues are positive (by inertia).
    iterative : whether a solve costs about as much as the factor.
    """

    iterative = False

    def __init__(
        self, lower: sp.csc_array, backend: _Backend, scale: Floats, spare: Callable[[], _Backend] | None = None
    ) -> None:
        self._lower = lower
        self._backend = backend
        self._spare = spare
        self._scale = scale
        self._largest = float(np.abs(lower.data).max(initial=0.0))
        self.positive_definite = backend.positive_definite

    def multiply(self, x: Floats) -> Floats:
        """The matrix times (n,) or (n, k)."""
        return (self._product((x.T / self._scale).T).T / self._scale).T

    def solve(self, rhs: Floats, tolerance: float = 1e-12) -> Floats:
        """Solution for (n,) or (n, k), refined until each column's residual is below ``tolerance`` of it, scaled.

        Raises
        ------
        EquilibriumError : a residual stays above 1e-8 (or ``tolerance``, if that is larger) and above rounding: the
            matrix is singular to working precision (a bone without support, a mechanism).
        """
        b = (rhs.T * self._scale).T
        size = np.abs(b).max(axis=0, initial=0.0)
        error = np.full_like(size, np.inf)
        best = x = self._solved(b)
        for _ in range(4):
            residual = b - self._product(x)
            found = np.abs(residual).max(axis=0, initial=0.0)
            better = found < error
            if not better.any():
                break
            best, error = np.where(better, x, best), np.where(better, found, error)
            if (error <= tolerance * size).all():
                break
            x = x + self._solved(residual)
        rounding = 16.0 * EPSILON * self._largest * np.abs(best).max(axis=0, initial=0.0)
        solved = error <= max(RESIDUAL_LIMIT, tolerance) * size
        solved |= (error <= rounding) & (rounding <= LARGEST_ROUNDING * size)
        if not solved.all():
            if (spare := self._spare) is not None:
                _tell("a solution left a residual")
                self._take_spare(spare)
                return self.solve(rhs, tolerance)
            relative = np.divide(error, size, out=np.zeros_like(error), where=~solved)
            raise EquilibriumError(
                f"the stiffness matrix is singular (relative residual {relative.max():.1e}): "
                "a part is held by nothing, or a stiffness is zero"
            )
        return (best.T * self._scale).T

    def inverse(self, rhs: Floats) -> Floats:
        """As ``solve``, without a look at the residual: for steps that are judged by what they bring about."""
        return (self._solved((rhs.T * self._scale).T).T * self._scale).T

    def _solved(self, b: Floats) -> Floats:
        if not b.size:
            return b  # no solver takes a block without columns
        spare = self._spare
        if spare is None:
            return self._backend.solve(b)
        try:
            found = self._backend.solve(b)
            if np.isfinite(found).all():
                return found
            _tell("a solution was not finite")
        except GpuFailure as error:
            _tell(str(error))
        return self._take_spare(spare).solve(b)

    def _take_spare(self, spare: Callable[[], _Backend]) -> _Backend:
        self._backend, self._spare = spare(), None
        self.positive_definite = self._backend.positive_definite
        return self._backend

    def _product(self, x: Floats) -> Floats:
        return symmetric_product(self._lower.indptr, self._lower.indices, self._lower.data, x)


def symmetric_product(indptr: Ints, indices: Ints, lower: Floats, x: Floats) -> Floats:
    """A symmetric matrix, given by the compressed columns of its lower triangle, times (n,) or (n, k)."""
    columns = np.ascontiguousarray(x.reshape(len(x), -1))
    return _symmetric_product(indptr, indices, lower, columns).reshape(x.shape)


@numba.njit(cache=True, nogil=True)
def _symmetric_product(indptr, indices, lower, x):  # type: ignore[no-untyped-def]
    y, sums = np.zeros_like(x), np.empty(x.shape[1])
    for column in range(len(indptr) - 1):
        sums[:] = 0.0
        for p in range(indptr[column], indptr[column + 1]):
            row, value = indices[p], lower[p]
            for k in range(x.shape[1]):
                sums[k] += value * x[row, k]
            if row != column:
                for k in range(x.shape[1]):
                    y[row, k] += value * x[column, k]
        for k in range(x.shape[1]):
            y[column, k] += sums[k]
    return y


class Analysis:
    """Ordering and symbolic factorisation of one lower-triangular pattern, for many value arrays.

    Parameters
    ----------
    indptr, indices : compressed columns of the lower triangle.
    backend : "rslab", "superlu" or "cudss"; default: the environment's SPINESTIFF_SOLVER, else rslab where it is
        installed.
    scale : (n,) units in which unknowns compare, e.g. 1 for mm and 1/30 for rad at an arm of 30 mm; default: ones.
    """

    def __init__(self, indptr: Ints, indices: Ints, backend: str | None = None, scale: Floats | None = None) -> None:
        n = len(indptr) - 1
        self._scale = np.ones(n) if scale is None else scale
        self._scale_of_value = np.repeat(self._scale, np.diff(indptr)) * self._scale[indices]
        # Ones, so that no entry of the pattern is dropped as an exact zero.
        self._pattern = sp.csc_array((np.ones(len(indices)), indices, indptr), shape=(n, n))
        self.backend = backend or default_backend()
        if self.backend not in BACKENDS:
            raise EquilibriumError(f"unknown sparse solver '{self.backend}'; wanted one of {', '.join(BACKENDS)}")
        if self.backend != "superlu":
            self._symbolic = _rslab().analyze(sp.csc_matrix(self._pattern), path="ldlt")
        self._gpu = None
        if self.backend == "cudss":
            _require_gpu()
            self._gpu = CudssAnalysis(indptr, indices)

    def factor(self, values: Floats) -> Factor:
        """Factorise the matrix with these ``values`` in the pattern.

        Raises
        ------
        EquilibriumError : a pivot is exactly zero or a value is not finite.
        """
        if not np.isfinite(values).all():
            raise EquilibriumError("the stiffness matrix holds a value that is not finite")
        matrix = self._pattern.copy()
        matrix.data = values * self._scale_of_value
        if self._gpu is not None:
            try:
                return Factor(matrix, self._gpu.factor(matrix.data), self._scale, lambda: self._on_processor(matrix))
            except GpuFailure as error:
                _tell(str(error))
        return Factor(matrix, self._on_processor(matrix), self._scale)

    def _on_processor(self, matrix: sp.csc_array) -> _Backend:
        try:
            if self.backend == "superlu":
                return _SuperLU(matrix)
            return _Rslab(self._symbolic.factor(matrix.data, threads=min(own_threads(), MOST_THREADS)))
        except RuntimeError as error:
            raise EquilibriumError(f"the stiffness matrix is singular ({error}); a part is held by nothing") from error


def default_backend() -> str:
    """The solver in use: SPINESTIFF_SOLVER, else "rslab" where it can be imported, else "superlu"."""
    chosen = os.environ.get("SPINESTIFF_SOLVER")
    if chosen:
        if chosen not in BACKENDS:
            raise EquilibriumError(f"SPINESTIFF_SOLVER names '{chosen}'; wanted one of {', '.join(BACKENDS)}")
        if chosen == "cudss":
            _require_gpu()
        return chosen
    try:
        _rslab()
    except ImportError:
        return "superlu"
    return "rslab"


@lru_cache(maxsize=1)
def _require_gpu() -> None:
    """Raise EquilibriumError without a GPU; asked for once."""
    try:
        require_gpu()
    except GpuFailure as error:
        raise EquilibriumError(f"the sparse solver 'cudss' has no GPU to use: {error}") from None


@lru_cache(maxsize=16)
def _tell(reason: str) -> None:
    """Say once of each reason that the processor did what was asked of the GPU."""
    _log.warning("the processor does what the GPU did not: %s", reason)


def _rslab() -> ModuleType:
    """The module. Its allocator (mimalloc) keeps the memory of a factor that is gone for the next one, unless the
    environment says otherwise: given back to the system it comes back zeroed, at an eighth of a fit's CPU time."""
    os.environ.setdefault("MIMALLOC_PURGE_DELAY", "-1")
    import rslab

    return rslab


class _Rslab:
    def __init__(self, factor) -> None:  # type: ignore[no-untyped-def]
        self._factor = factor
        _, negative, zero = factor.inertia
        self.positive_definite = negative == 0 and zero == 0 and factor.n_perturbed == 0

    def solve(self, rhs: Floats) -> Floats:
        return self._factor.solve(rhs) if rhs.ndim == 1 else self._factor.solve_many(np.ascontiguousarray(rhs))


class _SuperLU:
    def __init__(self, lower: sp.csc_array) -> None:
        full = lower + sp.tril(lower, -1).T
        self._factor = spla.splu(
            sp.csc_matrix(full),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        same = np.array_equal(self._factor.perm_r, self._factor.perm_c)
        self.positive_definite = bool(same and (self._factor.U.diagonal() > 0.0).all())

    def solve(self, rhs: Floats) -> Floats:
        return self._factor.solve(rhs)
