"""Symmetric factorisation on an NVIDIA GPU: the backend "cudss" of ``factor`` (extra [gpu], NVIDIA's cuDSS).

An analysis of cuDSS belongs to one factor at a time, and takes as long as about fifteen factorisations. So a pattern's
analyses are kept when their factors are gone, for the next ones, and there are as many of them as factors that live at
once. Matrices are factorised one by one: several at once (cuDSS's uniform batch) gain little, and come without their
inertia (docs/performance.md).
"""

from __future__ import annotations

import contextlib
import weakref
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spinestiff.arrays import Floats, Ints

Short = NDArray[np.int32]


class GpuFailure(RuntimeError):
    """What the GPU did not do: no GPU, no memory left, or an error of cuDSS."""


def require_gpu() -> None:
    """Raise GpuFailure if there is no GPU, or not what drives it."""
    try:
        from cuda.bindings import runtime
        from nvmath.bindings import cudss
    except ImportError as error:
        raise GpuFailure(f'{error}; pip install "spinestiff[gpu]"') from None
    try:
        (count,) = _done(runtime.cudaGetDeviceCount())
        cudss.get_property(0)
    except (RuntimeError, OSError) as error:
        raise GpuFailure(" ".join(str(error).split())) from None
    if not count:
        raise GpuFailure("no NVIDIA GPU is here")


def kind_of_matrix(cudss: Any) -> tuple[int, ...]:
    """How cuDSS calls compressed rows of a symmetric matrix's upper triangle, numbered from zero."""
    integer, real = cudss.DataType.R_32I, cudss.DataType.R_64F
    kind = (integer, integer, real, cudss.MatrixType.SYMMETRIC, cudss.MatrixViewType.UPPER, cudss.IndexBase.ZERO)
    return tuple(map(int, kind))


def kind_of_vector(cudss: Any) -> tuple[int, ...]:
    """How cuDSS calls a right side and a solution."""
    return int(cudss.DataType.R_64F), int(cudss.Layout.COL_MAJOR)


class CudssAnalysis:
    """One lower-triangular pattern, for many value arrays.

    Parameters
    ----------
    indptr, indices : compressed columns of the lower triangle: the compressed rows of the upper one.
    """

    def __init__(self, indptr: Ints, indices: Ints) -> None:
        self._indptr: Short = indptr.astype(np.int32)
        self._indices: Short = indices.astype(np.int32)
        # Without a lock: what gives a place back may run in the middle of ``factor``, as a factor is collected.
        self._free: list[_Slot] = []

    def factor(self, values: Floats) -> CudssFactor:
        """Factorise the matrix with these ``values`` in the pattern.

        Raises
        ------
        GpuFailure : it can't be done there.
        """
        try:
            slot = self._free.pop()
        except IndexError:
            slot = _Slot(self._indptr, self._indices)
        return CudssFactor(slot, values, self._free.append)


class CudssFactor:
    """A factorised matrix.

    Attributes
    ----------
    positive_definite : whether all eigenvalues are positive, by the inertia, and no pivot had to be changed.
    """

    def __init__(self, slot: _Slot, values: Floats, give_back: Any) -> None:
        self._slot = slot
        self.positive_definite = slot.factorise(values)
        weakref.finalize(self, give_back, slot)

    def solve(self, rhs: Floats) -> Floats:
        """Solution for (n,) or (n, k), one right side at a time. Raises GpuFailure."""
        if rhs.ndim == 1:
            return self._slot.solve(rhs)
        return np.stack([self._slot.solve(column) for column in rhs.T], axis=1)


class _Slot:
    """An analysed pattern on the GPU, with room for one matrix's values and factor, and for one right side."""

    def __init__(self, indptr: Short, indices: Short) -> None:
        from nvmath.bindings import cudss

        self._cudss, self._lock, self._size = cudss, Lock(), len(indptr) - 1
        self._failures = (GpuFailure, cudss.cuDSSError)
        owned = self._owned = _Owned()
        # However it ends: also where it is not made whole.
        weakref.finalize(self, owned.free)
        try:
            self._stream = owned.stream()
            handle = self._handle = owned.keep(cudss.destroy, cudss.create())
            cudss.set_stream(self._handle, self._stream)
            self._settings = owned.keep(cudss.config_destroy, cudss.config_create())
            # Not by way of this object: what frees it must not keep it.
            self._data = owned.keep(lambda data: cudss.data_destroy(handle, data), cudss.data_create(handle))
            rows, columns = owned.copied(indptr, self._stream), owned.copied(indices, self._stream)
            self._values = owned.room(8 * len(indices))
            self._rhs, self._solution = owned.room(8 * self._size), owned.room(8 * self._size)
            self._matrix = owned.keep(
                cudss.matrix_destroy,
                cudss.matrix_create_csr(
                    self._size, self._size, len(indices), rows, 0, columns, self._values, *kind_of_matrix(cudss),
                ),
            )  # fmt: skip
            self._b, self._x = (
                owned.keep(
                    cudss.matrix_destroy,
                    cudss.matrix_create_dn(self._size, 1, self._size, room, *kind_of_vector(cudss)),
                )
                for room in (self._rhs, self._solution)
            )
            self._run(cudss.Phase.ANALYSIS)
        except self._failures as error:
            raise GpuFailure(str(error)) from error

    def factorise(self, values: Floats) -> bool:
        """Whether the matrix with these values is positive definite."""
        with self._lock:
            try:
                self._owned.copy_in(self._values, values, self._stream)
                self._run(self._cudss.Phase.FACTORIZATION)
                said = self._cudss.DataParam
                if (failed := self._said(said.INFO, 1)[0]) != 0:
                    raise GpuFailure(f"cuDSS could not factorise a matrix (info {failed})")
                positive, negative = self._said(said.INERTIA, 2)
                changed = self._said(said.NPIVOTS, 1)[0]
            except self._failures as error:
                raise GpuFailure(str(error)) from error
        return bool(positive == self._size and negative == 0 and changed == 0)

    def solve(self, rhs: Floats) -> Floats:
        found = np.empty(self._size)
        with self._lock:
            try:
                self._owned.copy_in(self._rhs, rhs, self._stream)
                self._run(self._cudss.Phase.SOLVE)
                self._owned.copy_out(found, self._solution, self._stream)
            except self._failures as error:
                raise GpuFailure(str(error)) from error
        return found

    def _run(self, phase: int) -> None:
        self._cudss.execute(self._handle, int(phase), self._settings, self._data, self._matrix, self._x, self._b)
        self._owned.wait(self._stream)

    def _said(self, what: int, count: int) -> Short:
        """Whole numbers that cuDSS keeps of the last factorisation."""
        found, written = np.zeros(count, np.int32), np.zeros(1, np.uint64)
        self._cudss.data_get(self._handle, self._data, int(what), found.ctypes.data, found.nbytes, written.ctypes.data)
        return found


class _Owned:
    """Memory and objects on the GPU, freed together in the reverse order."""

    def __init__(self) -> None:
        from cuda.bindings import runtime

        self._runtime = runtime
        self._last: list[tuple[Any, Any]] = []

    def keep(self, destroy: Any, what: Any) -> Any:
        self._last.append((destroy, what))
        return what

    def free(self) -> None:
        while self._last:
            destroy, what = self._last.pop()
            with contextlib.suppress(Exception):  # CUDA may have ended before
                destroy(what)

    def stream(self) -> int:
        (stream,) = _done(self._runtime.cudaStreamCreate())
        self.keep(self._runtime.cudaStreamDestroy, stream)
        return int(stream)

    def room(self, size: int) -> int:
        (place,) = _done(self._runtime.cudaMalloc(size))
        return int(self.keep(self._runtime.cudaFree, place))

    def copied(self, values: Short, stream: int) -> int:
        place = self.room(values.nbytes)
        self.copy_in(place, values, stream)
        return place

    def copy_in(self, place: int, values: Floats | Short, stream: int) -> None:
        content = np.ascontiguousarray(values)
        kind = self._runtime.cudaMemcpyKind.cudaMemcpyHostToDevice
        _done(self._runtime.cudaMemcpyAsync(place, content.ctypes.data, content.nbytes, kind, stream))
        self.wait(stream)

    def copy_out(self, found: Floats, place: int, stream: int) -> None:
        kind = self._runtime.cudaMemcpyKind.cudaMemcpyDeviceToHost
        _done(self._runtime.cudaMemcpyAsync(found.ctypes.data, place, found.nbytes, kind, stream))
        self.wait(stream)

    def wait(self, stream: int) -> None:
        _done(self._runtime.cudaStreamSynchronize(stream))


def _done(answer: tuple[Any, ...]) -> tuple[Any, ...]:
    """What a call of CUDA's runtime gave. Raises GpuFailure where it failed."""
    error, *found = answer
    if int(error):
        raise GpuFailure(f"the GPU said {getattr(error, 'name', error)}")
    return tuple(found)
