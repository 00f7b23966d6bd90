"""A GPU that is none: what ``mechanics.cudss`` calls of CUDA and cuDSS, done in the processor's memory."""

from __future__ import annotations

import ctypes
import enum
import types

import numpy as np
import scipy.sparse as sp

# Other numbers than cuDSS's own, so that none is taken for granted.
ENUMS = {
    "Phase": {"ANALYSIS": 53, "FACTORIZATION": 54, "SOLVE": 55},
    "DataParam": {"INFO": 61, "NPIVOTS": 62, "INERTIA": 63},
    "DataType": {"R_64F": 71, "R_32I": 72},
    "MatrixType": {"SYMMETRIC": 81},
    "MatrixViewType": {"UPPER": 82},
    "IndexBase": {"ZERO": 83},
    "Layout": {"COL_MAJOR": 84},
}


class CuDSSError(Exception):
    """As cuDSS's own, which is no RuntimeError."""


class StandIn:
    """CUDA's runtime and cuDSS.

    Attributes
    ----------
    live : what was made and not freed, by its number or address.
    room : bytes that may be taken at once. fails : phases that end in an error. info : of each factorisation.
    analyses : how many were made.
    """

    def __init__(self) -> None:
        self.live: dict[int, object] = {}
        self.room, self.fails, self.info, self.analyses = 10**9, set(), 0, 0
        self._number = 0

    def modules(self) -> dict[str, types.ModuleType]:
        """As ``sys.modules`` wants them."""
        runtime, cudss = types.ModuleType("cuda.bindings.runtime"), types.ModuleType("nvmath.bindings.cudss")
        runtime.cudaMemcpyKind = types.SimpleNamespace(cudaMemcpyHostToDevice=1, cudaMemcpyDeviceToHost=2)
        for name in ("cudaGetDeviceCount", "cudaMalloc", "cudaFree", "cudaMemcpyAsync", "cudaStreamSynchronize"):
            setattr(runtime, name, getattr(self, name))
        runtime.cudaStreamCreate = lambda: (0, self._made("stream"))
        runtime.cudaStreamDestroy = self.cudaFree
        cudss.cuDSSError = CuDSSError
        for name, values in ENUMS.items():
            setattr(cudss, name, enum.IntEnum(name, values))
        cudss.get_property = lambda which: 0
        cudss.create = lambda: self._made("handle")
        cudss.set_stream = lambda handle, stream: None
        cudss.config_create = lambda: self._made("config")
        cudss.data_create = lambda handle: self._made({})
        cudss.data_destroy = lambda handle, data: self.cudaFree(data)
        cudss.matrix_create_csr = lambda *given: self._made(given)
        cudss.matrix_create_dn = lambda *given: self._made(given)
        cudss.destroy = cudss.config_destroy = cudss.matrix_destroy = self.cudaFree
        cudss.execute, cudss.data_get = self.execute, self.data_get
        above = {name: types.ModuleType(name) for name in ("cuda", "cuda.bindings", "nvmath", "nvmath.bindings")}
        above["cuda.bindings"].runtime, above["nvmath.bindings"].cudss = runtime, cudss
        return above | {"cuda.bindings.runtime": runtime, "nvmath.bindings.cudss": cudss}

    def _made(self, what: object) -> int:
        self._number += 1
        self.live[self._number] = what
        return self._number

    def cudaGetDeviceCount(self):
        return 0, 1

    def cudaMalloc(self, size):
        taken = sum(len(one) for one in self.live.values() if isinstance(one, ctypes.Array))
        if taken + size > self.room:
            return 2, 0
        content = (ctypes.c_char * size)()
        self.live[ctypes.addressof(content)] = content
        return 0, ctypes.addressof(content)

    def cudaFree(self, what):
        del self.live[what]
        return (0,)

    def cudaMemcpyAsync(self, to, of, size, kind, stream):
        assert kind in (1, 2)
        ctypes.memmove(to, of, size)
        return (0,)

    def cudaStreamSynchronize(self, stream):
        return (0,)

    def _read(self, address: int, count: int, kind) -> np.ndarray:
        return np.frombuffer(self.live[address], kind)[:count]

    def execute(self, handle, phase, config, data, matrix, solution, rhs):
        if phase in self.fails:
            raise CuDSSError("INTERNAL_ERROR (6)")
        found = self.live[data]
        n, _, entries, rows, _, columns, values, *kind = self.live[matrix]
        assert kind == [72, 72, 71, 81, 82, 83]
        pattern = (self._read(columns, entries, np.int32), self._read(rows, n + 1, np.int32))
        if phase == 53:
            self.analyses += 1
            found["analysed"] = [part.copy() for part in pattern]
        elif phase == 54:
            assert all(map(np.array_equal, found["analysed"], pattern))
            upper = sp.csr_array((self._read(values, entries, float).copy(), *pattern), shape=(n, n))
            found["full"] = (upper + sp.triu(upper, 1).T).toarray()
        else:
            x = np.linalg.lstsq(found["full"], self._read(self.live[rhs][3], n, float), rcond=None)[0]
            ctypes.memmove(self.live[solution][3], x.ctypes.data, x.nbytes)

    def data_get(self, handle, data, what, place, size, written):
        eigenvalues = np.linalg.eigvalsh(self.live[data]["full"])
        zero = int((np.abs(eigenvalues) < 1e-9).sum())
        signs = [int((eigenvalues > 0.0).sum()), int((eigenvalues < 0.0).sum())]
        said = np.array({61: [self.info], 62: [zero], 63: signs}[what], np.int32)
        assert said.nbytes == size
        ctypes.memmove(place, said.ctypes.data, size)
