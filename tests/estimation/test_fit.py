"""Fits of a planar spring spine: recovery, bounds, both methods, failures that end in a status or one clear line."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from spinestiff.anatomy.stiffness import RATIO_BOUNDS, stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import FitError
from spinestiff.estimation import fit as fitting
from spinestiff.estimation import search as searching
from spinestiff.estimation.evaluation import TrialSet
from spinestiff.estimation.fit import FitStatus, fit_stiffness
from spinestiff.estimation.objective import Trial
from spinestiff.imaging.features import VertebraCorners, silhouette_shares, state_features
from spinestiff.imaging.projection import frontal_view
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.supports import three_point_supports

TRUTH = {"lateral_bending": 0.1, "tissue": 0.03}


@pytest.mark.parametrize("method", fitting.METHODS)
@pytest.mark.parametrize(
    "truth", [TRUTH, {"lateral_bending": 1.7, "tissue": 0.6}, {"lateral_bending": 0.02, "tissue": 2.0}]
)
def test_eq_8_ratios_are_recovered_without_noise(spine, trials, method, truth) -> None:
    fit = fit_stiffness(spine, trials(truth), method=method)
    assert fit.status is FitStatus.CONVERGED
    for name, value in truth.items():
        assert fit.ratios.as_dict()[name] == pytest.approx(value, rel=1e-4)
    assert fit.rmse_mm < 1e-3 < fit.default_rmse_mm
    spread, values = fit.uncertainty, np.log(fit.ratios.values)
    assert spread.distance2(np.log(list(truth.values())) - values) <= spread.region_size
    assert spread.distance2(-values) > spread.region_size


def test_both_methods_reach_one_optimum_and_lm_is_cheaper(spine, trials) -> None:
    noisy = trials(error=0.5)
    lm, lbfgsb = (fit_stiffness(spine, noisy, method=method, intervals="linear") for method in fitting.METHODS)
    assert np.allclose(lm.ratios.values, lbfgsb.ratios.values, rtol=1e-4)
    assert lm.rmse_mm == pytest.approx(lbfgsb.rmse_mm, rel=1e-7)
    assert lm.cost.equilibria < 0.5 * lbfgsb.cost.equilibria
    assert lm.cost.equilibria == 2 * len(lm.history)


def test_one_common_ratio_fits_worse_but_fits(spine, trials) -> None:
    data = trials()
    single = fit_stiffness(spine, data, names=("everything",))
    assert single.status is FitStatus.CONVERGED
    assert 0.03 < single.ratios.values[0] < 0.1
    assert 0.1 < single.rmse_mm < single.default_rmse_mm


def test_a_problem_a_trial(spine, trials, planar_spine_type) -> None:
    other = planar_spine_type(spine.torso)
    fit = fit_stiffness([spine, other], trials())
    assert fit.ratios.values == pytest.approx([0.1, 0.03], rel=1e-4)
    assert other.solves > 3


@pytest.mark.parametrize("method", fitting.METHODS)
def test_a_ratio_outside_the_bounds_ends_at_the_bound_and_says_so(spine, trials, method) -> None:
    fit = fit_stiffness(spine, trials(), method=method, bounds=(0.05, 5.0))
    assert fit.status is FitStatus.AT_BOUND
    assert fit.at_bound == {"lateral_bending": False, "tissue": True}
    assert fit.ratios.as_dict()["tissue"] == pytest.approx(0.05)
    assert 0.06 < fit.ratios.as_dict()["lateral_bending"] < 0.1


def test_ratios_that_the_radiographs_cannot_tell_apart_are_named_so(spine, trials) -> None:
    """Flexion does nothing in the frontal plane; bending with itself under another name does nothing new."""
    flexion = fit_stiffness(spine, trials(), names=("lateral_bending", "tissue", "flexion_extension"))
    assert flexion.status is FitStatus.NOT_IDENTIFIABLE
    assert flexion.condition == np.inf
    assert flexion.intervals95["flexion_extension"] == pytest.approx(RATIO_BOUNDS)
    assert flexion.intervals.open_low.all()
    assert flexion.intervals.open_high.all()
    assert flexion.ratios.as_dict()["lateral_bending"] == pytest.approx(0.1, rel=1e-3)
    twice = fit_stiffness(spine, trials(), names=("everything", "thoracic", "tissue"))
    assert twice.status is FitStatus.NOT_IDENTIFIABLE


def test_failing_equilibria_shorten_steps_and_never_raise(spine, trials, planar_spine_type) -> None:
    brittle = planar_spine_type(spine.torso, fails_below=0.06)
    for method in fitting.METHODS:
        fit = fit_stiffness(brittle, trials(), method=method)
        assert fit.ratios.as_dict()["tissue"] >= 0.06
        assert any(np.isnan(step.loss) for step in fit.history)
        assert fit.rmse_mm < 0.6 * fit.default_rmse_mm
        assert fit.status in (FitStatus.STALLED, FitStatus.ITERATION_LIMIT, FitStatus.CONVERGED)
    lm = fit_stiffness(brittle, trials())
    assert lm.status in (FitStatus.STALLED, FitStatus.ITERATION_LIMIT)


def test_no_equilibrium_at_the_start_is_one_clear_error(spine, trials, planar_spine_type) -> None:
    never = planar_spine_type(spine.torso, fails_below=2.0)
    with pytest.raises(FitError, match="no equilibrium at the start of the fit, 30 N"):
        fit_stiffness(never, trials())
    picky = planar_spine_type(spine.torso, fails_below=1.5)
    fit = fit_stiffness(
        picky, trials({"lateral_bending": 2.5, "tissue": 2.0}), start={"lateral_bending": 3.0, "tissue": 3.0}
    )
    assert np.isnan(fit.default_rmse_mm)
    assert fit.ratios.values == pytest.approx([2.5, 2.0], rel=1e-3)


def test_iteration_limit_is_reported(spine, trials) -> None:
    fit = fit_stiffness(spine, trials(), max_iterations=2)
    assert fit.status is FitStatus.ITERATION_LIMIT
    assert not fit.status.usable
    assert len(fit.history) == 3


def test_history_observer_and_losses(spine, trials) -> None:
    seen = []
    fit = fit_stiffness(spine, trials(error=0.3), observer=seen.append)
    assert tuple(seen) == fit.history
    assert list(fit.loss_history) == sorted(fit.loss_history, reverse=True)
    assert seen[0].ratios == {"lateral_bending": 1.0, "tissue": 1.0}
    assert fit.loss_history[-1] == pytest.approx(0.5 * sum(np.sum(r.values**2) for r in fit.residuals))
    assert fit.cost.seconds > 0.0
    assert "lateral_bending" in str(fit)


def test_a_push_from_the_wrong_side_is_warned_of(spine, trials, push_by) -> None:
    data = trials()
    swapped = [t.__class__(push_by(-f), t.corners, t.view, t.label, t.push) for t, f in zip(data, (30.0, 60.0))]
    fit = fit_stiffness(spine, swapped)
    assert any("against the push" in text for text in fit.warnings)
    assert not fit_stiffness(spine, data).warnings


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"trials": []}, "no trials"),
        ({"method": "newton"}, "newton"),
        ({"names": ("tissue", "tissue")}, "each once"),
        ({"names": ()}, "none"),
        ({"bounds": (0.0, 5.0)}, "bounds"),
        ({"bounds": (2.0, 1.0)}, "bounds"),
        ({"start": {"tissue": 9.0}}, "outside the bounds"),
        ({"start": {"bending": 1.0}}, "bending"),
        ({"problem": "two"}, "2 problems for 1 trials"),
    ],
)
def test_impossible_requests_are_refused(spine, trials, change, text) -> None:
    request = {"problem": spine, "trials": trials(forces=(40.0,))} | change
    if request["problem"] == "two":
        request["problem"] = [spine, spine]
    with pytest.raises(FitError, match=text):
        fit_stiffness(**request)


def test_no_force_is_refused(spine, trials) -> None:
    with pytest.raises(FitError, match="no trial has a force"):
        fit_stiffness(spine, trials(forces=(0.0, 0.0)))


def test_secant_curvature_meets_its_equation_and_is_symmetric(spine, trials) -> None:
    """S s = (J+ - J)^T r+ : what Gauss-Newton leaves out along the step just made."""
    groups = stiffness_ratios(TRUTH, spine.torso.joints.kinds).groups
    trial_set = TrialSet([spine] * 2, trials(error=1.0), groups, "procrustes", None)
    here, there = (trial_set.solve(np.log(values)) for values in ([0.2, 0.06], [0.11, 0.035]))
    before, after = trial_set.slope(here), trial_set.slope(there)
    step = there.log_ratios - here.log_ratios
    curvature = searching._secant(np.eye(2), step, here, before, there, after)
    assert np.allclose(curvature, curvature.T)
    wanted = (after.jacobian - before.jacobian).T @ there.values
    assert np.abs(wanted).min() > 1.0
    assert np.allclose(curvature @ step, wanted)


def test_open_ends_are_warned_of(spine, trials) -> None:
    fit = fit_stiffness(spine, trials(), names=("lateral_bending", "flexion_extension"), start={"lateral_bending": 0.5})
    low, high = RATIO_BOUNDS
    wanted = f"flexion_extension: the radiographs also allow ratios below {low:g} and above {high:g}"
    assert any(wanted in w for w in fit.warnings)


def test_eqs_8_10_on_the_template_torso() -> None:
    """The real engine on the coarse template: adjoint is forward. That ratios come back is examples/02's test."""
    torso = template_torso(157.0)
    problem = EquilibriumProblem(torso, three_point_supports(torso, "right"))
    view = frontal_view(centre=torso.rest_pose.bone_positions[torso.vertebra_bones].mean(0))
    truth = stiffness_ratios({"lateral_bending": 0.1, "tissue": 0.01})
    shares = silhouette_shares(torso, view, torso.rest_pose)
    data = []
    for force in (20.0, 40.0):
        load = rib_push(torso, "right", 7.5, force)
        seen = state_features(torso, view, problem.solve(load, truth).require().state, shares).corners
        data.append(Trial(load, VertebraCorners(torso.vertebrae, seen), view, f"{force:g} N", "push"))
    trial_set = TrialSet([problem] * 2, data, truth.groups, "procrustes", None)
    point = trial_set.solve(np.log([0.3, 0.05]))
    forward, adjoint = trial_set.slope(point).jacobian.T @ point.values, trial_set.gradient(point)
    assert np.abs(adjoint).min() > 1.0
    assert np.allclose(adjoint, forward, rtol=1e-10)


class CurvedValley:
    """Two log ratios whose residuals make a narrow, bent valley: the far end is the minimum."""

    def solve(self, log_ratios, *_):
        a, b = log_ratios
        values = np.array([100.0 * (b + 0.15 * a**2 + 0.05 * a**3), 0.3 * (a + 2.0), 1.0])
        return SimpleNamespace(
            log_ratios=np.asarray(log_ratios), values=values, loss=0.5 * values @ values, rmse=np.linalg.norm(values)
        )

    def slope(self, point):
        a, _ = point.log_ratios
        return SimpleNamespace(jacobian=np.array([[100.0 * (0.3 * a + 0.15 * a**2), 100.0], [0.3, 0.0], [0.0, 0.0]]))

    def __init__(self):
        self.evaluations = 0

    def note(self, *_):
        self.evaluations += 1


def test_a_curved_valley_is_followed_along_its_floor(monkeypatch) -> None:
    """A refused step says how the floor bends; straight steps alone take three times as many evaluations."""

    def search():
        valley = CurvedValley()
        start = valley.solve(np.array([1.5, -0.5]))
        point, _, status = searching.levenberg_marquardt(valley, start, (-8.0, 8.0), 800)
        assert status is FitStatus.CONVERGED
        assert point.log_ratios == pytest.approx([-2.0, -0.2], abs=1e-3)
        return valley.evaluations

    bent = search()
    assert bent < 120
    monkeypatch.setattr(searching, "_arc", lambda point, slope, limits, damping, *_: searching._damped_step(
        point, slope, limits, 4.0 * max(damping, 3e-3), None
    ))  # fmt: skip
    straight = search()
    assert straight > 3 * bent
