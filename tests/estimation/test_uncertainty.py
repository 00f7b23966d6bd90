"""Intervals hold what they promise, also where errors are shared by corners, frames and neighbouring vertebrae."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.errors import FitError
from spinestiff.estimation.fit import fit_stiffness
from spinestiff.estimation.uncertainty import (
    Nuisance,
    ResidualLayout,
    UncertaintySettings,
    estimator_uncertainty,
    with_nuisances,
)

TRUTH = {"lateral_bending": 0.1, "tissue": 0.03}
V, FRAMES = 17, (1.0, 2.0)
ARMS = np.array([[15.0, 10.0], [-15.0, 10.0], [-15.0, -10.0], [15.0, -10.0]])
QUARTER = np.stack([-ARMS[:, 1], ARMS[:, 0]], -1)
LAYOUT = ResidualLayout(np.tile(np.arange(V), 2), np.repeat([0, 1], V), np.tile(ARMS, (2 * V, 1, 1)))


def rigid(u, v, turn) -> np.ndarray:
    """Residuals (V * 8,) of vertebrae that are shifted (mm) and turned (rad)."""
    z = np.stack([u, v], -1)[:, None, :] + turn[:, None, None] * QUARTER
    return z.reshape(-1)


def toy_jacobian() -> np.ndarray:
    """Two smooth deflections of a column, in proportion to the load; correlation of the estimates -0.99."""
    y = np.linspace(0.0, 1.0, V)
    columns = []
    for size, skew in ((7.0, 0.0), (6.0, 1.0)):
        shape = size * (np.sin(np.pi * y) * (1.0 + 0.5 * skew * (y - 0.4)) + 0.25 * skew * np.sin(2.0 * np.pi * y))
        columns.append(np.concatenate([rigid(f * shape, 0.0 * y, f * np.gradient(shape, 400.0 * y)) for f in FRAMES]))
    return np.stack(columns, 1)


def series(rng, length: float, smooth: bool = False) -> np.ndarray:
    if length == 0.0:
        return rng.standard_normal(V)
    lag = np.abs(np.subtract.outer(np.arange(V), np.arange(V))) / length
    kernel = np.exp(-0.5 * lag**2) if smooth else np.exp(-lag)
    return np.linalg.cholesky(kernel + 1e-8 * np.eye(V)) @ rng.standard_normal(V)


def error(rng, length: float, shared: float, smooth: bool = False) -> np.ndarray:
    """Rest geometry wrong by 1 mm and 0.02 rad in every frame alike, plus tracking errors of each frame."""
    own = [(0.15 * series(rng, 0.0), 0.15 * series(rng, 0.0), 0.005 * series(rng, 0.0)) for _ in FRAMES]
    common = [shared * size * series(rng, length, smooth) for size in (1.0, 1.0, 0.02)]
    return np.concatenate([rigid(*(a + b for a, b in zip(mine, common))) for mine in own])


def coverage(length: float, shared: float, smooth: bool = False, repeats: int = 250) -> np.ndarray:
    """Shares of repeats in which the intervals of both, and the joint region, hold the truth (0, 0)."""
    rng = np.random.default_rng(7)
    jacobian = toy_jacobian()
    found = []
    for _ in range(repeats):
        e = error(rng, length, shared, smooth)
        offset = np.linalg.lstsq(jacobian, e, rcond=None)[0]
        spread = estimator_uncertainty(jacobian, e - jacobian @ offset, LAYOUT)
        found.append([*(np.abs(offset) < spread.half_width), spread.distance2(offset) < spread.region_size])
    return np.mean(found, axis=0)


@pytest.mark.parametrize(
    ("length", "shared", "smooth"),
    [(0.0, 0.0, False), (0.0, 1.0, False), (2.0, 1.0, False), (4.0, 1.0, False), (2.0, 1.0, True), (4.0, 1.0, True)],
)
def test_intervals_and_region_cover_the_truth(length: float, shared: float, smooth: bool) -> None:
    held = coverage(length, shared, smooth)
    assert (held > (0.90 if length < 4.0 else 0.85)).all(), held


def test_white_intervals_would_not() -> None:
    """The usual sigma^2 (J^T J)^-1 on errors shared by neighbours and frames: what this module is for."""
    rng = np.random.default_rng(7)
    jacobian = toy_jacobian()
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    held = []
    for _ in range(200):
        e = error(rng, 2.0, 1.0)
        offset = inverse @ jacobian.T @ e
        left = e - jacobian @ offset
        held.append(np.abs(offset) < 1.96 * np.sqrt(left @ left / (len(left) - 2) * np.diag(inverse)))
    assert (np.mean(held, axis=0) < 0.6).all()


def test_white_corner_errors_are_the_floor() -> None:
    """Without residuals the covariance is sd^2 (J^T J)^-1, and its corner sd is the one asked for."""
    jacobian = toy_jacobian()
    spread = estimator_uncertainty(jacobian, np.zeros(len(jacobian)), LAYOUT, settings=UncertaintySettings(0.4))
    assert np.allclose(spread.covariance, 0.16 * np.linalg.inv(jacobian.T @ jacobian))
    rng = np.random.default_rng(0)
    e = error(rng, 2.0, 1.0)
    left = e - jacobian @ np.linalg.lstsq(jacobian, e, rcond=None)[0]
    full = estimator_uncertainty(jacobian, left, LAYOUT, settings=UncertaintySettings(0.4))
    assert np.linalg.eigvalsh(full.covariance - spread.covariance).min() > -1e-12


def test_channels_keep_sums_of_squares_of_rigid_residuals() -> None:
    rng = np.random.default_rng(1)
    e = error(rng, 0.0, 1.0)
    assert np.sum(LAYOUT.channels(e[:, None]) ** 2) == pytest.approx(e @ e)
    part = ResidualLayout(LAYOUT.vertebra[1:], LAYOUT.trial[1:], LAYOUT.arms[1:])
    assert (part.channels(e[8:, None])[:, 0, 0] == 0.0).all()


def test_a_force_error_moves_the_estimate_as_the_refit_does(spine, show, push_by) -> None:
    """Covariance by sensitivities against fits with the force log off by a little, one ratio."""
    ratios = stiffness_ratios({"lateral_bending": 0.3, "tissue": 0.2}, spine.torso.joints.kinds)
    trials = [show(spine, push_by(force), ratios) for force in (30.0, 60.0)]
    fit = fit_stiffness(spine, trials)
    moved = []
    for factor in (1.01, 0.99):
        wrong = [t.__class__(t.load.scaled(factor), t.corners, t.view, t.label, t.push) for t in trials]
        moved.append(np.log(fit_stiffness(spine, wrong).ratios.values))
    slope = (moved[0] - moved[1]) / 0.02
    part = fit.uncertainty.parts["force of push 1"]
    assert np.allclose(part, 0.02**2 * np.outer(slope, slope), rtol=0.01)
    assert {"residuals", "force of push 1", "push height of push 1"} < set(fit.uncertainty.parts)
    assert len([name for name in fit.uncertainty.parts if name.startswith("place along")]) == 4
    assert np.allclose(sum(fit.uncertainty.parts.values()), fit.uncertainty.covariance)


def test_nuisances_add_up_and_known_ones_raise_the_degrees_of_freedom() -> None:
    jacobian = toy_jacobian()
    rng = np.random.default_rng(3)
    e = error(rng, 2.0, 1.0)
    left = e - jacobian @ np.linalg.lstsq(jacobian, e, rcond=None)[0]
    plain = estimator_uncertainty(jacobian, left, LAYOUT)
    column = jacobian @ np.array([1.0, 2.0])
    known = estimator_uncertainty(jacobian, left, LAYOUT, [Nuisance("n", column, 0.5)])
    assert np.allclose(known.covariance - plain.covariance, 0.25 * np.outer([1, 2], [1, 2]))
    assert (known.dof > plain.dof).all()
    later = with_nuisances(plain, jacobian, [Nuisance("n", column, 0.5)])
    assert np.allclose(later.covariance, known.covariance)
    assert np.allclose(later.dof, known.dof)
    with pytest.raises(FitError, match="given twice"):
        with_nuisances(later, jacobian, [Nuisance("n", column, 0.5)])
    with pytest.raises(FitError, match="3 rows"):
        with_nuisances(plain, jacobian, [Nuisance("m", column[:3], 0.5)])


def test_a_ratio_without_effect_has_no_interval() -> None:
    jacobian = np.column_stack([toy_jacobian(), np.zeros(len(toy_jacobian()))])
    spread = estimator_uncertainty(jacobian, np.ones(len(jacobian)), LAYOUT)
    assert spread.condition == np.inf
    low, high = spread.interval(np.zeros(3))
    assert (low == 0.0).all()
    assert np.isinf(high).all()


def test_bad_requests_are_refused() -> None:
    with pytest.raises(FitError, match="corner_sd_mm"):
        UncertaintySettings(corner_sd_mm=0.0)
    with pytest.raises(FitError, match=">= 0"):
        UncertaintySettings(force_sd=-0.1)
