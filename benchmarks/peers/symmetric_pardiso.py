"""MKL Pardiso for one symmetric pattern: analysed once, Cholesky for every value array, upper triangle only."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from pypardiso.pardiso_wrapper import PyPardisoSolver

ANALYSE_AND_FACTOR, FACTOR, SOLVE = 12, 22, 33
POSITIVE_DEFINITE = 2


class SymmetricPardiso:
    """A symmetric positive definite matrix's free block, given the values of the whole matrix.

    Parameters
    ----------
    pattern : the whole matrix, compressed rows; the values of later ones are in the same order.
    free : degrees of freedom that are solved for.
    """

    def __init__(self, pattern: sp.csr_matrix, free: NDArray[np.int64]) -> None:
        row = np.repeat(np.arange(pattern.shape[0]), np.diff(pattern.indptr))
        number = np.full(pattern.shape[0], -1)
        number[free] = np.arange(len(free))
        row, column = number[row], number[pattern.indices]
        kept = np.flatnonzero((row >= 0) & (column >= row))
        order = np.lexsort((column[kept], row[kept]))
        self._entries = kept[order]
        counts = np.bincount(row[self._entries], minlength=len(free))
        indptr = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        indices = column[self._entries].astype(np.int32)
        self._upper = sp.csr_matrix((np.zeros(len(indices)), indices, indptr), shape=(len(free),) * 2)
        self._solver = PyPardisoSolver(mtype=POSITIVE_DEFINITE)
        self._analysed = False
        self.factorisations = 0

    def factor(self, values: NDArray[np.float64]) -> None:
        """Factorise the matrix with these values."""
        self._upper.data = values[self._entries]
        self._solver.set_phase(FACTOR if self._analysed else ANALYSE_AND_FACTOR)
        self._solver._call_pardiso(self._upper, np.zeros(self._upper.shape[0]))
        self._analysed = True
        self.factorisations += 1

    def solve(self, rhs: NDArray[np.float64]) -> NDArray[np.float64]:
        """Solution on the free degrees of freedom by the last factor."""
        self._solver.set_phase(SOLVE)
        return self._solver._call_pardiso(self._upper, np.ascontiguousarray(rhs))

    def product(self, values: NDArray[np.float64], x: NDArray[np.float64]) -> NDArray[np.float64]:
        """The free block with these values times ``x``."""
        upper = sp.csr_matrix((values[self._entries], self._upper.indices, self._upper.indptr), self._upper.shape)
        return upper @ x + upper.T @ x - upper.diagonal() * x

    def solve_near(self, values: NDArray[np.float64], rhs: NDArray[np.float64], accuracy: float) -> NDArray[np.float64]:
        """Solution for other ``values`` than those factorised: conjugate gradients with the last factor.

        Near an equilibrium the last Newton step's factor is so close that two or three products replace a
        factorisation; ``accuracy`` is the relative residual on the new values.
        """
        upper = sp.csr_matrix((values[self._entries], self._upper.indices, self._upper.indptr), self._upper.shape)
        lower, diagonal = upper.T.tocsr(), upper.diagonal()
        x = self.solve(rhs)
        residual = rhs - (upper @ x + lower @ x - diagonal * x)
        direction, old = np.zeros_like(x), 1.0
        for _ in range(50):
            if np.linalg.norm(residual) <= accuracy * np.linalg.norm(rhs):
                return x
            preconditioned = self.solve(residual)
            new = float(residual @ preconditioned)
            direction = preconditioned + new / old * direction if direction.any() else preconditioned
            product = upper @ direction + lower @ direction - diagonal * direction
            step = new / float(direction @ product)
            x, residual, old = x + step * direction, residual - step * product, new
        raise RuntimeError("conjugate gradients with the last factor did not converge")
