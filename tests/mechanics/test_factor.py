"""spinestiff.mechanics.factor: the sparse solvers."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
import scipy.sparse as sp

from spinestiff.errors import EquilibriumError
from spinestiff.mechanics import factor as factor_module
from spinestiff.mechanics.cudss import GpuFailure
from spinestiff.mechanics.factor import Analysis, Factor, default_backend

BACKENDS = sorted({default_backend(), "superlu"})
CHOICE = "SPINESTIFF_SOLVER"
ASK = (
    "import os; from spinestiff.mechanics.factor import default_backend; "
    "print(default_backend(), os.environ['MIMALLOC_PURGE_DELAY'])"
)


def _lower(full):
    lower = sp.csc_array(np.tril(full))
    lower.sort_indices()
    return lower.indptr.astype(np.int64), lower.indices.astype(np.int64), lower.data


def _matrix(shift, seed=0, n=25):
    random = np.random.default_rng(seed)
    full = np.where(random.random((n, n)) < 0.2, random.normal(size=(n, n)), 0.0)
    full = np.tril(full, -1)
    return full + full.T + shift * np.eye(n)


@pytest.mark.skipif("rslab" not in BACKENDS, reason="rslab is not installed")
@pytest.mark.parametrize(("before", "expected"), [(None, "-1"), ("25", "25")])
def test_the_solver_keeps_its_memory_unless_told_otherwise(before, expected):
    given = {name: value for name, value in os.environ.items() if name not in ("MIMALLOC_PURGE_DELAY", CHOICE)}
    given |= {} if before is None else {"MIMALLOC_PURGE_DELAY": before}
    said = subprocess.run([sys.executable, "-c", ASK], env=given, capture_output=True, text=True, check=True).stdout
    assert said.split() == ["rslab", expected]


@pytest.mark.parametrize("backend", BACKENDS)
def test_solves_one_and_many_right_hand_sides(backend):
    full = _matrix(6.0)
    indptr, indices, values = _lower(full)
    factor = Analysis(indptr, indices, backend).factor(values)
    rhs = np.random.default_rng(1).normal(size=(25, 3))
    assert factor.solve(rhs) == pytest.approx(np.linalg.solve(full, rhs), rel=1e-12)
    assert factor.solve(rhs[:, 1]) == pytest.approx(np.linalg.solve(full, rhs[:, 1]), rel=1e-12)
    assert factor.multiply(rhs) == pytest.approx(full @ rhs, rel=1e-13)
    assert (factor.solve(np.zeros(25)) == 0.0).all()


@pytest.mark.parametrize("backend", BACKENDS)
def test_no_right_hand_sides_have_no_solutions(backend):
    indptr, indices, values = _lower(_matrix(6.0))
    factor = Analysis(indptr, indices, backend).factor(values)
    assert factor.solve(np.zeros((25, 0))).shape == factor.inverse(np.zeros((25, 0))).shape == (25, 0)


def test_each_column_is_refined_by_its_own_size():
    """A small right-hand side beside a large one is solved as well as alone."""
    full = _matrix(6.0)
    rhs = np.random.default_rng(2).normal(size=(25, 2)) * [1e9, 1.0]

    class Rough:
        """Good to four digits where little is asked."""

        positive_definite = True

        def solve(self, b):
            return np.linalg.solve(full, b) * np.where(np.abs(b).max(axis=0) < 1e3, 1.0001, 1.0)

    lower = sp.csc_array(np.tril(full))
    both = Factor(lower, Rough(), np.ones(25)).solve(rhs)
    assert both == pytest.approx(np.linalg.solve(full, rhs), rel=1e-10)


def test_a_column_that_has_no_solution_is_an_error_beside_large_ones_that_have():
    full = np.diag([1.0, 1.0, 1e-30])

    class Deaf:
        """Leaves the last unknown out."""

        positive_definite = True

        def solve(self, b):
            return b * np.array([1.0, 1.0, 0.0]).reshape(-1, *[1] * (b.ndim - 1))

    lower = sp.csc_array(np.tril(full))
    rhs = np.array([[1e12, 0.0], [0.0, 0.0], [0.0, 1.0]])
    with pytest.raises(EquilibriumError, match=r"singular \(relative residual 1.0e\+00\)"):
        Factor(lower, Deaf(), np.ones(3)).solve(rhs)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("shift", [6.0, 2.0, 0.5, -6.0])
def test_tells_definite_from_indefinite(backend, seed, shift):
    full = _matrix(shift, seed)
    indptr, indices, values = _lower(full)
    definite = bool(np.linalg.eigvalsh(full)[0] > 0.0)
    assert Analysis(indptr, indices, backend).factor(values).positive_definite is definite
    if shift in (6.0, -6.0):
        assert definite is (shift > 0.0)


@pytest.mark.parametrize("backend", BACKENDS)
def test_zero_diagonal_is_solved_and_called_indefinite(backend):
    full = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 2.0], [0.0, 2.0, 5.0]])
    indptr, indices = np.array([0, 2, 4, 5]), np.array([0, 1, 1, 2, 2])
    factor = Analysis(indptr, indices, backend).factor(np.array([0.0, 1.0, 0.0, 2.0, 5.0]))
    rhs = np.array([1.0, -2.0, 0.5])
    assert not factor.positive_definite
    assert factor.solve(rhs) == pytest.approx(np.linalg.solve(full, rhs), rel=1e-12)


@pytest.mark.parametrize("backend", BACKENDS)
def test_one_analysis_serves_many_matrices(backend):
    first, second = _matrix(6.0), _matrix(6.0) * 3.0 - np.eye(25)
    indptr, indices, values = _lower(first)
    analysis = Analysis(indptr, indices, backend)
    rhs = np.ones(25)
    kept = analysis.factor(values)
    again = analysis.factor(_lower(second)[2])
    assert again.solve(rhs) == pytest.approx(np.linalg.solve(second, rhs), rel=1e-12)
    # The earlier factor is not stale.
    assert kept.solve(rhs) == pytest.approx(np.linalg.solve(first, rhs), rel=1e-12)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_singular_matrix_is_an_error_or_flagged_never_an_answer(backend):
    full = np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 2.0]])
    with pytest.raises(EquilibriumError, match="singular"):
        Analysis(np.array([0, 2, 3, 4]), np.array([0, 1, 1, 2]), backend).factor(
            full[[0, 1, 1, 2], [0, 0, 1, 2]]
        ).solve(np.array([1.0, 0.0, 0.0]))


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("seed", range(4))
def test_a_matrix_singular_up_to_rounding_is_an_error_never_an_answer(backend, seed):
    """No pivot is exactly nought, as with a free body's rigid motions: only the residual tells."""
    random = np.random.default_rng(seed)
    root = random.normal(size=(25, 22))
    full = root @ root.T
    indptr, indices, values = _lower(full)
    with pytest.raises(EquilibriumError, match="singular"):
        Analysis(indptr, indices, backend).factor(values).solve(random.normal(size=25))


@pytest.mark.parametrize("backend", BACKENDS)
def test_values_that_are_not_finite_are_refused(backend):
    with pytest.raises(EquilibriumError, match="not finite"):
        Analysis(np.array([0, 1]), np.array([0]), backend).factor(np.array([np.nan]))


def test_unknown_backend_is_refused_by_name():
    with pytest.raises(EquilibriumError, match="'magic'"):
        Analysis(np.array([0, 1]), np.array([0]), "magic")


def test_the_environment_chooses_the_backend(monkeypatch):
    monkeypatch.setenv("SPINESTIFF_SOLVER", "superlu")
    assert default_backend() == "superlu"
    assert Analysis(np.array([0, 1]), np.array([0])).backend == "superlu"


# The solver on a GPU, without one: what it does not do, the processor does. With one: tests/mechanics/test_cudss.py,
# and all tests above with SPINESTIFF_SOLVER=cudss.


class _Broken:
    """A factor on a GPU that says it is positive definite, whatever it is, and solves as it is told."""

    positive_definite = True

    def __init__(self, solve):
        self.solve = solve


def _gone(rhs):
    raise GpuFailure("the GPU said cudaErrorMemoryAllocation")


def _broken_analysis(monkeypatch, full, factor):
    monkeypatch.setattr(factor_module, "_require_gpu", lambda: None)
    monkeypatch.setattr(factor_module.CudssAnalysis, "factor", factor)
    indptr, indices, values = _lower(full)
    return Analysis(indptr, indices, "cudss").factor(values)


def test_a_gpu_that_is_asked_for_and_not_there_is_told(monkeypatch):
    def none():
        raise GpuFailure("no NVIDIA GPU is here")

    factor_module._require_gpu.cache_clear()
    monkeypatch.setattr(factor_module, "require_gpu", none)
    monkeypatch.setenv(CHOICE, "cudss")
    with pytest.raises(EquilibriumError, match="'cudss' has no GPU to use: no NVIDIA GPU is here"):
        default_backend()
    with pytest.raises(EquilibriumError, match="no NVIDIA GPU is here"):
        Analysis(*_lower(_matrix(6.0))[:2], "cudss")
    factor_module._require_gpu.cache_clear()


@pytest.mark.parametrize("shift", [6.0, 0.5])
def test_a_matrix_that_the_gpu_does_not_factorise(monkeypatch, shift):
    def fails(self, values):
        raise GpuFailure("the GPU said cudaErrorMemoryAllocation")

    full = _matrix(shift)
    factor = _broken_analysis(monkeypatch, full, fails)
    rhs = np.random.default_rng(1).normal(size=(25, 2))
    assert factor.solve(rhs) == pytest.approx(np.linalg.solve(full, rhs), rel=1e-9)
    assert factor.positive_definite == (np.linalg.eigvalsh(full).min() > 0.0)


@pytest.mark.parametrize(
    "solve", [_gone, lambda rhs: np.full_like(rhs, np.nan), lambda rhs: 0.9 * rhs], ids=["fails", "nan", "wrong"]
)
@pytest.mark.parametrize("shift", [6.0, 0.5])
def test_a_right_side_that_the_gpu_does_not_solve(monkeypatch, solve, shift):
    full = _matrix(shift)
    factor = _broken_analysis(monkeypatch, full, lambda self, values: _Broken(solve))
    rhs = np.random.default_rng(1).normal(size=25)
    assert factor.solve(rhs) == pytest.approx(np.linalg.solve(full, rhs), rel=1e-9)
    # Nor is what it said of the matrix believed any longer.
    assert factor.positive_definite == (np.linalg.eigvalsh(full).min() > 0.0)
    assert factor.inverse(rhs) == pytest.approx(np.linalg.solve(full, rhs), rel=1e-6)


def test_a_singular_matrix_on_a_gpu_is_told_as_one_on_the_processor(monkeypatch):
    full = _matrix(6.0)
    full[3], full[:, 3] = 0.0, 0.0
    factor = _broken_analysis(monkeypatch, full, lambda self, values: _Broken(lambda rhs: rhs))
    with pytest.raises(EquilibriumError, match="singular"):
        factor.solve(np.ones(25))


@pytest.mark.parametrize("solve", [_gone, lambda rhs: np.full_like(rhs, np.nan)], ids=["fails", "nan"])
def test_a_step_that_the_gpu_does_not_solve(monkeypatch, solve):
    """Nobody looks at its residual."""
    full = _matrix(6.0)
    factor = _broken_analysis(monkeypatch, full, lambda self, values: _Broken(solve))
    assert factor.inverse(np.ones(25)) == pytest.approx(np.linalg.solve(full, np.ones(25)), rel=1e-9)
