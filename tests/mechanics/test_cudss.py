"""spinestiff.mechanics.cudss: factorisations on a GPU (also ``SPINESTIFF_SOLVER=cudss pytest tests/mechanics``)."""

from __future__ import annotations

import gc

import numpy as np
import pytest
import scipy.sparse as sp

from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.cudss import CudssAnalysis, GpuFailure, require_gpu
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.factor import Analysis
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.supports import three_point_supports

try:
    require_gpu()
except GpuFailure as error:
    pytest.skip(f"needs an NVIDIA GPU and the extra [gpu] ({error})", allow_module_level=True)


@pytest.fixture(scope="module")
def problems():
    torso = template_torso(157.0, "coarse")
    return {
        backend: EquilibriumProblem(torso, three_point_supports(torso, "left"), backend=backend)
        for backend in ("rslab", "cudss")
    }


@pytest.fixture(scope="module")
def tangents(problems):
    """Values of two tangents of the coarse torso, and their pattern."""
    problem = problems["rslab"]
    pattern, potential = problem.potential.pattern, problem.potential
    ratios = stiffness_ratios({"lateral_bending": 0.1, "tissue": 0.03}, problem.torso.joints.kinds)
    load = rib_push(problem.torso, "left", 8.0, 40.0)
    found = [
        potential.hessian(problem.torso.rest_pose, potential.stiffness(chosen), problem.all_terms(load))
        for chosen in (None, ratios)
    ]
    for values in found:
        values[problem._held_entries], values[problem._held_diagonal] = 0.0, 1.0
    return pattern, found


def full_matrix(pattern, values):
    lower = sp.csc_array((values, pattern.indices, pattern.indptr))
    return lower + sp.tril(lower, -1).T


def test_factors_that_live_at_once_and_analyses_that_are_used_again(tangents):
    pattern, found = tangents
    analysis = CudssAnalysis(pattern.indptr, pattern.indices)
    rhs = np.random.default_rng(0).normal(size=(len(pattern.indptr) - 1, 2))
    one, other = (analysis.factor(values) for values in found)
    for factor, values in ((one, found[0]), (other, found[1])):
        assert factor.positive_definite
        product = full_matrix(pattern, values) @ factor.solve(rhs)
        assert product == pytest.approx(rhs, abs=1e-7)
        assert (full_matrix(pattern, values) @ factor.solve(rhs[:, 1])) == pytest.approx(rhs[:, 1], abs=1e-7)
    assert analysis._free == []
    place = one._place
    del one, factor
    gc.collect()
    assert analysis._free == [place]
    again = analysis.factor(found[1])
    assert again._place is place
    assert again.solve(rhs[:, 0]) == pytest.approx(other.solve(rhs[:, 0]), rel=1e-9, abs=1e-9)


def test_what_is_indefinite_or_singular(tangents):
    pattern, found = tangents
    values = found[0].copy()
    diagonal = pattern.indptr[:-1]
    values[diagonal[100]] *= -5.0
    assert not CudssAnalysis(pattern.indptr, pattern.indices).factor(values).positive_definite
    analysis = Analysis(pattern.indptr, pattern.indices, "cudss")
    indefinite = analysis.factor(values)
    rhs = np.random.default_rng(0).normal(size=len(diagonal))
    assert not indefinite.positive_definite
    assert indefinite.multiply(indefinite.solve(rhs)) == pytest.approx(rhs, abs=1e-7)
    column = np.repeat(np.arange(len(diagonal)), np.diff(pattern.indptr))
    values = found[0].copy()
    values[(column == 200) | (pattern.indices == 200)] = 0.0
    with pytest.raises(EquilibriumError, match="singular"):
        analysis.factor(values).solve(rhs)


def test_an_equilibrium_is_the_same_on_both(problems):
    torso = problems["rslab"].torso
    ratios = stiffness_ratios({"lateral_bending": 0.1, "tissue": 0.03}, torso.joints.kinds)
    load = rib_push(torso, "left", 8.0, 60.0)
    one, other = (problem.solve(load, ratios).require() for problem in problems.values())
    assert other.state.bone_positions == pytest.approx(one.state.bone_positions, abs=1e-6)
    assert other.factorisations == one.factorisations
