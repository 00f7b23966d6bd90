"""spinestiff.mechanics.cudss: factorisations on a GPU, or on one that is none (``stand_in_gpu``).

On a machine with one: ``SPINESTIFF_SOLVER=cudss pytest tests/mechanics`` as well.
"""

from __future__ import annotations

import gc
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import scipy.sparse as sp

from mechanics.stand_in_gpu import StandIn
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics import factor as factor_module
from spinestiff.mechanics.cudss import CudssAnalysis, GpuFailure, require_gpu
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.factor import Analysis
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.supports import three_point_supports


@pytest.fixture
def stand_in(monkeypatch):
    there = StandIn()
    for name, module in there.modules().items():
        monkeypatch.setitem(sys.modules, name, module)
    factor_module._require_gpu.cache_clear()
    yield there
    factor_module._require_gpu.cache_clear()


@pytest.fixture(params=["stand-in", "GPU"])
def gpu(request):
    """Either; the stand-in where it is one."""
    if request.param == "stand-in":
        return request.getfixturevalue("stand_in")
    try:
        require_gpu()
    except GpuFailure as error:
        pytest.skip(f"needs an NVIDIA GPU and the extra [gpu] ({error})")
    return None


def matrix(seed, shift=6.0, n=40):
    """Compressed lower triangle, and the whole."""
    random = np.random.default_rng(seed)
    full = np.where(np.random.default_rng(0).random((n, n)) < 0.2, random.normal(size=(n, n)), 0.0)
    full = np.tril(full, -1)
    full = full + full.T + shift * np.eye(n)
    lower = sp.csc_array(np.tril(full))
    lower.sort_indices()
    return lower, full


def test_factors_that_live_at_once_and_analyses_that_are_used_again(gpu):
    (one_lower, one_full), (other_lower, other_full) = matrix(1), matrix(2)
    analysis = CudssAnalysis(one_lower.indptr, one_lower.indices)
    rhs = np.random.default_rng(0).normal(size=(40, 2))
    one, other = analysis.factor(one_lower.data), analysis.factor(other_lower.data)
    for factor, full in ((one, one_full), (other, other_full)):
        assert factor.positive_definite
        assert factor.solve(rhs) == pytest.approx(np.linalg.solve(full, rhs), rel=1e-9)
        assert factor.solve(rhs[:, 1]) == pytest.approx(np.linalg.solve(full, rhs[:, 1]), rel=1e-9)
    assert analysis._free == []
    slot = one._slot
    del one, factor
    gc.collect()
    assert analysis._free == [slot]
    again = analysis.factor(other_lower.data)
    assert again._slot is slot
    assert again.solve(rhs) == pytest.approx(np.linalg.solve(other_full, rhs), rel=1e-9)
    if gpu is not None:
        assert gpu.analyses == 2


def test_nothing_is_left_there(stand_in):
    lower, _ = matrix(1)
    analysis = CudssAnalysis(lower.indptr, lower.indices)
    factor = analysis.factor(lower.data)
    assert stand_in.live
    del factor, analysis
    gc.collect()
    assert stand_in.live == {}


@pytest.mark.parametrize("room", [0, 500, 2000, 3000])
def test_nothing_is_left_of_what_has_no_room(stand_in, room):
    lower, full = matrix(1)
    stand_in.room = room
    with pytest.raises(GpuFailure, match="the GPU said 2"):
        CudssAnalysis(lower.indptr, lower.indices).factor(lower.data)
    gc.collect()
    assert stand_in.live == {}
    # Nor is it missed.
    factor = Analysis(lower.indptr, lower.indices, "cudss").factor(lower.data)
    assert factor.solve(np.ones(40)) == pytest.approx(np.linalg.solve(full, np.ones(40)), rel=1e-9)


@pytest.mark.parametrize("phase", [53, 54, 55])
def test_an_error_there_leaves_it_to_the_processor(stand_in, phase, caplog):
    lower, full = matrix(1)
    stand_in.fails = {phase}
    factor_module._tell.cache_clear()
    factor = Analysis(lower.indptr, lower.indices, "cudss").factor(lower.data)
    assert factor.solve(np.ones(40)) == pytest.approx(np.linalg.solve(full, np.ones(40)), rel=1e-9)
    assert factor.positive_definite
    assert [record.message for record in caplog.records] == [
        "the processor does what the GPU did not: INTERNAL_ERROR (6)"
    ]


def test_two_threads_on_one_pattern(stand_in):
    lowers, fulls = zip(*(matrix(seed) for seed in range(8)))
    analysis = Analysis(lowers[0].indptr, lowers[0].indices, "cudss")
    rhs = np.random.default_rng(0).normal(size=40)

    def solved(number):
        return [analysis.factor(lowers[number].data).solve(rhs) for _ in range(10)]

    with ThreadPoolExecutor(4) as pool:
        for found, full in zip(pool.map(solved, range(8)), fulls):
            assert np.array(found) == pytest.approx(np.tile(np.linalg.solve(full, rhs), (10, 1)), rel=1e-9)
    assert 1 <= stand_in.analyses <= 4


def test_what_cudss_says_that_it_could_not_factorise(stand_in):
    lower, _ = matrix(1)
    stand_in.info = 7
    with pytest.raises(GpuFailure, match="info 7"):
        CudssAnalysis(lower.indptr, lower.indices).factor(lower.data)


def test_what_is_indefinite_or_singular(gpu):
    lower, full = matrix(1, shift=0.5)
    assert np.linalg.eigvalsh(full).min() < 0.0
    assert not CudssAnalysis(lower.indptr, lower.indices).factor(lower.data).positive_definite
    analysis = Analysis(lower.indptr, lower.indices, "cudss")
    indefinite = analysis.factor(lower.data)
    rhs = np.random.default_rng(0).normal(size=40)
    assert not indefinite.positive_definite
    assert indefinite.solve(rhs) == pytest.approx(np.linalg.solve(full, rhs), rel=1e-8)
    column = np.repeat(np.arange(40), np.diff(lower.indptr))
    values = np.where((column == 20) | (lower.indices == 20), 0.0, lower.data)
    with pytest.raises(EquilibriumError, match="singular"):
        analysis.factor(values).solve(rhs)


@pytest.mark.slow
def test_an_equilibrium_is_the_same_on_both():
    try:
        require_gpu()
    except GpuFailure as error:
        pytest.skip(f"needs an NVIDIA GPU and the extra [gpu] ({error})")
    torso = template_torso(157.0, "coarse")
    ratios = stiffness_ratios({"lateral_bending": 0.1, "tissue": 0.03}, torso.joints.kinds)
    load = rib_push(torso, "left", 8.0, 60.0)
    one, other = (
        EquilibriumProblem(torso, three_point_supports(torso, "left"), backend=backend).solve(load, ratios).require()
        for backend in ("rslab", "cudss")
    )
    assert other.state.bone_positions == pytest.approx(one.state.bone_positions, abs=1e-6)
    assert other.factorisations == one.factorisations
