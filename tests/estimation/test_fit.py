"""Fits of the short spine: both methods, what a fit tells, failures that end in a status or one clear line."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from spinestiff.anatomy.stiffness import RATIO_BOUNDS, parameter_group
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import EquilibriumError, FitError
from spinestiff.estimation import mode, profiles
from spinestiff.estimation.asked import Start
from spinestiff.estimation.ended import likelihood_rise
from spinestiff.estimation.evaluation import TrialSet
from spinestiff.estimation.fit import fit_stiffness
from spinestiff.estimation.fitted import METHODS, FitEnd
from spinestiff.estimation.known import Known
from spinestiff.estimation.objective import Trial
from spinestiff.estimation.point import WeighedPoint
from spinestiff.estimation.priors import Priors
from spinestiff.estimation.profiles import WIDTH_FACTOR
from spinestiff.estimation.status import FitStatus
from spinestiff.estimation.told import partial_inverse, trial_warnings, unsettled_warnings
from spinestiff.estimation.unknowns import ACTS
from spinestiff.estimation.weighed import WeighedProblem
from spinestiff.imaging.features import VertebraCorners, silhouette_shares, state_features
from spinestiff.imaging.projection import frontal_view
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.supports import three_point_supports

BOUNDS = (0.01, 10.0)


@pytest.fixture(scope="module")
def whole(column, noisy):
    return fit_stiffness(column.problem, noisy, bounds=BOUNDS)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("truth", [{"lateral_bending": 0.3, "tissue": 0.4}, {"lateral_bending": 1.7, "tissue": 0.6}])
def test_eq_8_ratios_are_recovered_without_noise(column, method, truth, known_exactly) -> None:
    trials = column.trials(truth)
    fit = fit_stiffness(
        column.problem, trials, method=method, bounds=BOUNDS, extent="estimate", known=Known(known_exactly)
    )
    assert fit.status is FitStatus.CONVERGED
    assert fit.ratios.values == pytest.approx(list(truth.values()), rel=1e-3)
    assert fit.rmse_mm < 1e-2 < fit.default_rmse_mm
    assert fit.cost.equilibria >= 2 * len(fit.history)


def test_both_methods_and_both_kinds_of_frames(column, whole, noisy) -> None:
    """The paper's fit has no intervals; it sees loaded frames only."""
    paper = fit_stiffness(column.problem, noisy, method="paper", bounds=BOUNDS)
    assert paper.status is FitStatus.CONVERGED
    assert paper.weighed is None
    assert np.isnan(list(paper.intervals95.values())).all()
    assert np.isnan(paper.covariance).all()
    assert len(whole.residuals) == len(paper.residuals) == 2
    # Equal weights are the least squares; the weighed fit explains more by unknowns.
    again = fit_stiffness(column.problem, noisy[1:], method="paper", bounds=BOUNDS)
    assert np.array_equal(paper.ratios.values, again.ratios.values)


def test_a_fit_tells_what_it_found(column, whole, noisy) -> None:
    told = whole.weighed
    assert whole.status is FitStatus.CONVERGED
    assert told.p_value > 0.05
    assert told.acts.shape == (2, len(ACTS))
    assert told.outlying == ()
    assert told.budget is not None
    assert told.changes
    assert whole.likely is told.likely
    for name, (low, high) in whole.intervals95.items():
        assert low < whole.ratios.as_dict()[name] < high
        assert low < column.truth[name] < high
    by_name = {nuisance.name: nuisance for nuisance in told.nuisances}
    force = by_name["force of push 1"]
    assert (force.group, force.act, force.prior_sd) == ("force scale", "force", 0.02)
    assert force.value == pytest.approx(force.standard * 0.02)
    assert all(0.0 < nuisance.sd <= nuisance.prior_sd * (1.0 + 1e-9) for nuisance in told.nuisances)
    # What an act is made of, frame by frame.
    obliquity = [by_name[f"obliquity in {trial.label}"].value for trial in noisy[1:]]
    elastic = by_name["obliquity under pushes from the right"]
    assert told.acts[1, 6] == pytest.approx(elastic.value + obliquity[1])
    assert told.acts[0, 6] == pytest.approx(0.4 * elastic.value + obliquity[0])
    # The truth's 2 degrees at the larger force, to what a sd says.
    assert told.acts[1, 6] == pytest.approx(np.deg2rad(2.0), abs=0.03)
    assert str(whole).startswith("CONVERGED: training RMSE")


def test_extent_says_how_much_is_told(column, noisy) -> None:
    estimate, intervals = (
        fit_stiffness(column.problem, noisy, bounds=BOUNDS, extent=extent) for extent in ("estimate", "intervals")
    )
    assert estimate.likely is None
    assert np.isnan(list(estimate.intervals95.values())).all()
    assert np.isfinite(estimate.covariance).all()
    assert intervals.likely is not None
    assert intervals.weighed.budget is None
    assert intervals.weighed.changes == ()
    assert np.array_equal(estimate.ratios.values, intervals.ratios.values)


def test_a_rough_fit_spares_evaluations_and_changes_no_interval(column, noisy) -> None:
    """Of a spine whose joints are a tenth stiffer, as a coarse mesh is; one of other trials is left aside."""
    start = {"lateral_bending": 1.0, "tissue": 0.6}
    joints = replace(column.torso.joints, stiffness=1.1 * column.torso.joints.stiffness)
    stiffer = EquilibriumProblem(replace(column.torso, joints=joints), column.problem.supports)
    rough, fewer = (fit_stiffness(stiffer, trials, bounds=BOUNDS, extent="shape") for trials in (noisy, noisy[:2]))
    alone, led, aside = (
        fit_stiffness(column.problem, noisy, start=Start(start, rough=given), bounds=BOUNDS, extent="intervals")
        for given in (None, rough, fewer)
    )
    assert rough.likely is None
    assert len(rough.weighed.places) > 3
    for name, (low, high) in alone.intervals95.items():
        assert led.intervals95[name] == pytest.approx((low, high), rel=0.05)
        assert aside.intervals95[name] == (low, high)
    assert len(led.history) < len(alone.history) == len(aside.history)


def test_a_finer_fit_takes_how_precise_nuisances_are_from_a_rough_one(column, noisy, monkeypatch) -> None:
    """Also where no intervals are asked for; of other trials it solves for that itself."""
    solved: list[int] = []
    slope = mode._precision_slope
    monkeypatch.setattr(mode, "_precision_slope", lambda *args: solved.append(1) or slope(*args))

    def fit(trials, rough=None):
        solved.clear()
        start = Start({"lateral_bending": 1.0, "tissue": 0.6}, rough=rough)
        found = fit_stiffness(column.problem, trials, start=start, bounds=BOUNDS, extent="estimate")
        return found, len(solved)

    rough, alone = fit(noisy)
    fewer, _ = fit(noisy[:2])
    led, aside = fit(noisy, rough), fit(noisy, fewer)
    assert alone == aside[1] > led[1] == 0
    assert led[0].ratios.values == pytest.approx(rough.ratios.values, rel=1e-3)


def test_the_shape_alone_needs_no_ends_that_agree_closely(column, noisy, monkeypatch) -> None:
    monkeypatch.setattr(profiles, "CLOSE_ENOUGH", 1e-3)
    estimate, shape, intervals = (
        fit_stiffness(column.problem, noisy, bounds=BOUNDS, extent=extent)
        for extent in ("estimate", "shape", "intervals")
    )
    assert np.array_equal(shape.ratios.values, intervals.ratios.values)
    assert len(estimate.history) < len(shape.history) < len(intervals.history)


def test_a_fit_goes_on_where_another_ended(column, noisy, whole, monkeypatch) -> None:
    """At its ratios and nuisances, in one solve of all trials."""
    asked: list[tuple[float, bool]] = []
    solve = WeighedProblem.solve

    def seen(self, log_ratios, nuisances, near=None, slope=None, *args, **kwargs):
        asked.append((float(np.abs(nuisances).max()), slope is not None))
        return solve(self, log_ratios, nuisances, near, slope, *args, **kwargs)

    monkeypatch.setattr(WeighedProblem, "solve", seen)
    on = fit_stiffness(column.problem, noisy, start=Start.at(whole), bounds=BOUNDS, extent="estimate")
    largest = max(map(abs, whole.standard_nuisances.values()))
    assert asked[0] == (pytest.approx(largest), False) and asked[1][1]
    assert len(on.history) < len(whole.history)
    assert on.ratios.values == pytest.approx(whole.ratios.values, rel=1e-3)


def test_an_outlying_vertebra_is_named(column, noisy) -> None:
    corners = noisy[2].corners.corners.copy()
    corners[3] += 8.0
    wrong = replace(noisy[2], corners=VertebraCorners(noisy[2].corners.vertebrae, corners, noisy[2].corners.quality))
    fit = fit_stiffness(column.problem, [*noisy[:2], wrong], bounds=BOUNDS, extent="estimate")
    worst = max(fit.weighed.outlying, key=lambda one: one[2])
    assert worst[:2] == (noisy[2].label, column.torso.vertebrae[3])
    assert worst[2] > 5.0


def test_a_problem_a_trial_is_asked_for_its_own_frames(column, clean, known_exactly) -> None:
    other = EquilibriumProblem(column.torso, column.problem.supports)
    problems = [column.problem, column.problem, other]
    fit = fit_stiffness(problems, clean, bounds=BOUNDS, extent="estimate", known=Known(known_exactly))
    assert fit.ratios.values == pytest.approx(list(column.truth.values()), rel=1e-3)


@pytest.mark.parametrize("method", METHODS)
def test_a_ratio_outside_the_bounds_ends_at_the_bound_and_says_so(column, clean, method) -> None:
    fit = fit_stiffness(column.problem, clean, method=method, bounds=(0.35, 5.0), extent="intervals")
    assert fit.status is FitStatus.AT_BOUND
    assert fit.status.usable
    assert fit.at_bound["lateral_bending"]
    assert fit.ratios.as_dict()["lateral_bending"] == pytest.approx(0.35)
    if method == "weighed":
        assert fit.open_ends["lateral_bending"] == (True, False)
        assert any("lateral_bending: the radiographs also allow ratios below 0.35" in w for w in fit.warnings)


def test_a_covariance_is_infinite_only_where_nothing_is_known() -> None:
    inf = np.inf
    assert partial_inverse(np.diag([4.0, 0.0, 1.0])) == pytest.approx(
        np.array([[0.25, inf, 0.0], [inf, inf, inf], [0.0, inf, 1.0]])
    )
    sum_alone = partial_inverse(np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 2.0]]))
    assert np.isinf(sum_alone).tolist() == [[True] * 3, [True] * 3, [True, True, False]]
    assert sum_alone[2, 2] == pytest.approx(0.5)
    for nothing in (np.zeros((2, 2)), np.full((2, 2), np.nan)):
        assert np.isinf(partial_inverse(nothing)).all()
    rows = np.random.default_rng(0).normal(size=(9, 3)) * [1.0, 30.0, 1e-3]
    assert partial_inverse(rows.T @ rows) == pytest.approx(np.linalg.inv(rows.T @ rows), rel=1e-9)


def test_ratios_that_the_radiographs_cannot_tell_are_named_so(column, clean, known_exactly) -> None:
    """Shear front to back does next to nothing in the frontal plane; all parts beside their whole do nothing new."""
    names = ("lateral_bending", "tissue", "sagittal_shear")
    fit = fit_stiffness(column.problem, clean, names, bounds=BOUNDS, extent="intervals")
    assert fit.status is FitStatus.NOT_IDENTIFIABLE
    # So soft a spine would have shown how far from straight the pushes were.
    low, high = fit.intervals95["sagittal_shear"]
    assert BOUNDS[0] <= low < 0.02
    assert high == pytest.approx(BOUNDS[1])
    assert fit.likely.kinds[2] in ("flat", "one-sided", "at a bound")
    assert fit.ratios.as_dict()["lateral_bending"] == pytest.approx(0.3, rel=0.1)
    assert any("sagittal_shear: the radiographs also allow ratios" in w and "above 10" in w for w in fit.warnings)
    same = ("lateral_bending", "lateral_bending@thoracic", "lateral_bending@lumbar", "tissue")
    twice = fit_stiffness(column.problem, clean, same, bounds=BOUNDS, extent="intervals", known=Known(known_exactly))
    assert twice.status is FitStatus.NOT_IDENTIFIABLE
    assert np.isinf(twice.covariance[:3]).all()
    assert np.isinf(twice.covariance[3]).tolist() == [True, True, True, False]
    once = fit_stiffness(column.problem, clean, same[1:], bounds=BOUNDS, extent="estimate", known=Known(known_exactly))
    assert twice.covariance[3, 3] == pytest.approx(once.covariance[2, 2], rel=0.01)
    assert twice.ratios.values[0] * twice.ratios.values[1:3] == pytest.approx(0.3, rel=0.01)
    for low, high in list(twice.intervals95.values())[:3]:
        assert low == pytest.approx(0.025, rel=0.2)
        assert high == pytest.approx(10.0)


def test_failing_equilibria_shorten_steps_and_never_raise(column, brittle) -> None:
    data = column.trials({"lateral_bending": 0.2, "tissue": 0.2})
    for method in METHODS:
        fit = fit_stiffness(brittle(0.37), data, method=method, bounds=BOUNDS)
        assert fit.ratios.as_dict()["lateral_bending"] >= 0.37
        assert any(np.isnan(step.loss) and not step.accepted for step in fit.history)
        assert fit.rmse_mm < fit.default_rmse_mm
        if method == "weighed":
            assert fit.status is FitStatus.STALLED
            assert not fit.status.usable
            assert fit.likely is None


def test_a_start_that_takes_too_long_is_left_for_one_nearer_to_the_default(column, clean, monkeypatch) -> None:
    real, asked_for = WeighedProblem.solve, []

    def solve(self, log_ratios, *args, most_factorisations=np.inf, **kwargs):
        asked_for.append((np.exp(log_ratios), most_factorisations))
        if len(asked_for) < 3:
            raise EquilibriumError("not converged within the iteration limit")
        return real(self, log_ratios, *args, **kwargs)

    monkeypatch.setattr(WeighedProblem, "solve", solve)
    start = {"lateral_bending": 0.02, "tissue": 0.02}
    fit = fit_stiffness(column.problem, clean, start=start, bounds=BOUNDS, extent="estimate")
    assert [ratios[0] for ratios, _ in asked_for[:3]] == pytest.approx([0.02, 0.02**0.75, 0.02**0.5])
    assert np.isfinite([most for _, most in asked_for[:3]]).all()
    assert fit.status is FitStatus.CONVERGED
    assert np.isnan(fit.history[0].loss)
    assert not fit.history[0].accepted


def test_a_nearer_start_lies_inside_the_bounds(column, clean, monkeypatch) -> None:
    """The default does not, and a way towards it leads out of them."""
    real, asked_for = WeighedProblem.solve, []

    def solve(self, log_ratios, *args, **kwargs):
        asked_for.append(np.exp(log_ratios))
        if len(asked_for) < 4:
            raise EquilibriumError("not converged within the iteration limit")
        return real(self, log_ratios, *args, **kwargs)

    monkeypatch.setattr(WeighedProblem, "solve", solve)
    start, bounds = {"lateral_bending": 0.1, "tissue": 0.1}, (0.01, 0.45)
    fit = fit_stiffness(column.problem, clean, start=start, bounds=bounds, extent="estimate")
    assert asked_for[3] == pytest.approx([0.45, 0.45])
    assert fit.ratios.values == pytest.approx([0.3, 0.4], rel=0.1)


@pytest.mark.parametrize("method", METHODS)
def test_a_fit_goes_on_from_a_bound(column, clean, method, known_exactly) -> None:
    """Back from its log a bound may lie outside itself, by rounding."""
    ended = 0.2, float(np.exp(np.log(3.0)))
    start = dict(zip(("lateral_bending", "tissue"), ended))
    assert ended[1] > 3.0
    bounds = (0.01, 3.0)
    fit = fit_stiffness(
        column.problem, clean, method=method, start=start, bounds=bounds, extent="estimate", known=Known(known_exactly)
    )
    assert fit.status is FitStatus.CONVERGED
    assert fit.ratios.values == pytest.approx([0.3, 0.4], rel=1e-2)


def test_no_equilibrium_at_the_start_is_one_clear_error(column, clean, brittle) -> None:
    for method in METHODS:
        with pytest.raises(FitError, match="no equilibrium at the start of the fit, push 1 100 N"):
            fit_stiffness(brittle(2.0), clean, method=method, bounds=BOUNDS)
    stiff = column.trials({"lateral_bending": 2.5, "tissue": 2.0})
    start = {"lateral_bending": 3.0, "tissue": 3.0}
    fit = fit_stiffness(brittle(1.5), stiff, start=start, bounds=BOUNDS, extent="estimate")
    assert np.isnan(fit.default_rmse_mm)
    assert "(default: no equilibrium known)" in str(fit) and "nan" not in str(fit)
    assert ", default: no equilibrium known" in fit._repr_html_() and "nan mm" not in fit._repr_html_()
    assert fit.default_equilibria == ()
    # A stiff column hardly moves, so that priors count: 2.58 and 1.89.
    assert fit.ratios.values == pytest.approx([2.5, 2.0], rel=0.1)


def test_what_ratios_at_their_bounds_do_not_explain_is_no_chance(column, whole, noisy) -> None:
    """A bound that excludes the truth leaves residuals that no change of the ratios may take away."""
    fit = fit_stiffness(column.problem, noisy, bounds=(0.8, 10.0), extent="intervals")
    assert all(fit.at_bound.values())
    assert fit.rmse_mm > 5.0 * whole.rmse_mm
    assert fit.weighed.p_value < 1e-9 < 0.05 < whole.weighed.p_value


@pytest.mark.parametrize(
    ("odd", "text"),
    [
        ({"extent": "all"}, "unknown extent 'all' of a fit; wanted one of estimate, shape, intervals, everything"),
        (
            {"known": Known(geometry=np.eye(6))},
            "geometry: wanted a covariance of 54 by 54 finite numbers, six a vertebra",
        ),
        (
            {"known": Known(geometry=np.full((54, 54), np.nan))},
            "geometry: wanted a covariance of 54 by 54 finite numbers",
        ),
        ({"start": Start(states=())}, "0 states to start from, wanted one a loaded trial, 2"),
    ],
)
def test_what_does_not_fit_the_trials_is_one_clear_error(column, noisy, odd, text) -> None:
    with pytest.raises(FitError, match=text):
        fit_stiffness(column.problem, noisy, bounds=BOUNDS, **odd)


def test_a_fit_starts_inside_bounds_that_the_default_ratios_are_beyond(column, noisy) -> None:
    fit = fit_stiffness(column.problem, noisy, bounds=(0.01, 0.9), extent="estimate")
    assert fit.history[0].ratios == pytest.approx({"lateral_bending": 0.9, "tissue": 0.9})
    assert fit.status is FitStatus.CONVERGED


def test_an_estimate_that_still_moves_in_the_last_round_says_so(column, noisy, monkeypatch) -> None:
    monkeypatch.setattr(mode, "MOST_TILTS", 1)
    monkeypatch.setattr(mode, "CHANGED_SD", 0.0)
    fit = fit_stiffness(column.problem, noisy, bounds=BOUNDS, extent="estimate")
    (told,) = [line for line in fit.warnings if "integrated out for the last time" in line]
    assert "still moved by 0." in told
    assert not [line for line in fit.warnings if "jumps between equilibria" in line]


def test_a_start_may_be_solved_from_states_that_are_known(column, noisy, whole, monkeypatch) -> None:
    there = Start.at(whole)
    from_states = replace(there, states=[found.state for found in whole.equilibria])
    by_ratios = fit_stiffness(column.problem, noisy, start=there, bounds=BOUNDS, extent="estimate")
    fit = fit_stiffness(column.problem, noisy, start=from_states, bounds=BOUNDS, extent="estimate")
    assert fit.ratios.values == pytest.approx(by_ratios.ratios.values, rel=1e-6)
    assert fit.cost.newton_iterations < by_ratios.cost.newton_iterations
    assert fit.cost.factorisations < by_ratios.cost.factorisations
    assert fit.default_equilibria == () and np.isnan(fit.default_rmse_mm)
    solve = WeighedProblem.solve

    def from_states_never(self, *args, starts=None, **kwargs):
        if starts is not None:
            raise EquilibriumError("no")
        return solve(self, *args, **kwargs)

    monkeypatch.setattr(WeighedProblem, "solve", from_states_never)
    instead = fit_stiffness(column.problem, noisy, start=from_states, bounds=BOUNDS, extent="estimate")
    assert instead.ratios.values == pytest.approx(by_ratios.ratios.values, rel=1e-6)
    assert instead.cost.factorisations > fit.cost.factorisations
    assert np.isnan(instead.history[0].rmse_mm) and not instead.history[0].accepted


@pytest.mark.parametrize("method", METHODS)
def test_the_iteration_limit_is_reported(column, clean, method) -> None:
    fit = fit_stiffness(column.problem, clean, method=method, bounds=BOUNDS, max_iterations=1)
    assert fit.status is FitStatus.ITERATION_LIMIT
    assert not fit.status.usable
    assert fit.likely is None


def test_history_observer_and_losses(column, noisy) -> None:
    seen = []
    fit = fit_stiffness(column.problem, noisy, observer=seen.append, bounds=BOUNDS, extent="estimate")
    assert tuple(seen) == fit.history
    assert [step.iteration for step in seen] == list(range(len(seen)))
    assert seen[0].ratios == {"lateral_bending": 1.0, "tissue": 1.0}
    accepted = [step for step in seen if step.accepted]
    assert accepted[-1].ratios == pytest.approx(fit.ratios.as_dict())
    assert accepted[-1].rmse_mm == pytest.approx(fit.rmse_mm)
    assert fit.cost.seconds > 0.0
    paper = fit_stiffness(column.problem, noisy, method="paper", bounds=BOUNDS)
    losses = [step.loss for step in paper.history if step.accepted]
    assert losses == sorted(losses, reverse=True)
    assert losses[-1] == pytest.approx(0.5 * sum(np.sum(r.values**2) for r in paper.residuals))


def test_a_search_ends_as_near_as_asked(column, noisy, whole) -> None:
    near = fit_stiffness(column.problem, noisy, bounds=BOUNDS, extent="estimate", close_sd=0.3)
    assert near.status is FitStatus.CONVERGED
    searched = sum(step.accepted for step in whole.history)
    assert len(near.history) < searched
    sds = np.sqrt(np.diag(whole.covariance))
    away = np.abs(np.log(near.ratios.values) - np.log(whole.ratios.values)) / sds
    assert 1e-4 < away.max() < 0.6


def test_a_push_from_the_wrong_side_is_warned_of(column, clean, whole) -> None:
    swapped = [clean[0], *(replace(trial, load=trial.load.scaled(-1.0)) for trial in clean[1:])]
    fit = fit_stiffness(column.problem, swapped, bounds=BOUNDS, extent="estimate", max_iterations=20)
    assert any("against the push" in text for text in fit.warnings)
    assert fit.weighed.p_value < 1e-6
    assert not any("against the push" in text for text in whole.warnings)


def test_the_rise_at_other_ratios_is_that_of_the_interval(column, noisy, whole) -> None:
    """At an end of an interval, with the other ratio as the profile has it: 3.84 for a width factor of 1."""
    profile, end = whole.likely.profiles[0], whole.likely.high[0]
    others = np.array([end, np.interp(end, profile.log_ratios, profile.others[:, 1])])
    loaded = [column.problem] * len(noisy)
    end = FitEnd.of(whole)
    rise = likelihood_rise(loaded, noisy, end, dict(zip(end.ratios, np.exp(others), strict=True)))
    assert rise == pytest.approx(3.84 * WIDTH_FACTOR**2, abs=0.25)
    states = [one.state for one in whole.equilibria]
    again = likelihood_rise(loaded, noisy, end, end.ratios, rmse_mm=1.001 * whole.rmse_mm, starts=states)
    assert again == pytest.approx(0.0, abs=1e-4)


def test_the_rise_is_weighed_as_the_fit_was(column, noisy) -> None:
    """With a vertebra that counts less."""
    corners = noisy[2].corners.corners.copy()
    corners[4] += [2.5, 0.0]
    shown = replace(noisy[2].corners, corners=corners)
    trials = [*noisy[:2], replace(noisy[2], corners=shown)]
    fit = fit_stiffness(column.problem, trials, bounds=BOUNDS, extent="intervals")
    assert [name for _, name, _ in fit.weighed.outlying] == ["L1"]
    end, at = FitEnd.of(fit), np.log(fit.ratios.values) + [0.4, -0.1]
    emulated = 2.0 * float(fit.likely.emulator.psi(at)[0] - fit.likely.emulator.psi(np.log(fit.ratios.values))[0])
    states = [one.state for one in fit.equilibria]
    others = dict(zip(end.ratios, np.exp(at)))
    rise = likelihood_rise([column.problem] * len(trials), trials, end, others, starts=states)
    assert emulated > 1.0
    assert rise == pytest.approx(emulated, rel=0.1)


def test_nothing_but_the_ratios_may_be_unknown(column, clean) -> None:
    """Intervals of a fit without nuisances."""
    acting = ("force_scale", "force_offset_n", "direction_deg", "push_height_mm", "push_depth_mm", "breathing_mm")
    acting += ("obliquity_deg", "shoulder_mm", "frame_obliquity_deg", "frame_shoulder_mm", "trunk", "rib_joints")
    acting += ("tissue_volume", "mesh", "source_distance")
    priors = Priors(**dict.fromkeys(acting, 0.0))
    fit = fit_stiffness(column.problem, clean, bounds=BOUNDS, known=Known(priors))
    assert not fit.weighed.nuisances
    low, high = fit.intervals95["tissue"]
    assert low < 0.4 < high < 0.5


def test_an_estimate_whose_equilibria_are_not_found_again_has_no_rise(column, noisy, whole) -> None:
    """A soft spine may have two under one push."""
    end = FitEnd.of(whole)
    with pytest.raises(EquilibriumError, match=r"not found again: corners off by .* mm, in the fit by"):
        likelihood_rise([column.problem] * len(noisy), noisy, end, end.ratios, rmse_mm=1.05 * whole.rmse_mm)


def test_ends_that_were_not_solved_are_told(column, clean, whole, monkeypatch) -> None:
    assert whole.likely.settled
    monkeypatch.setattr(profiles, "MOST_ROUNDS", 0)
    fit = fit_stiffness(column.problem, clean, bounds=BOUNDS, extent="intervals")
    assert not fit.likely.settled
    assert any("an end of the intervals, or a place between, is interpolated" in text for text in fit.warnings)
    assert not any("interpolated" in text for text in whole.warnings)


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
        ({"problem": "two"}, "2 problems for 3 trials"),
    ],
)
def test_impossible_requests_are_refused(column, clean, change, text) -> None:
    request = {"problem": column.problem, "trials": clean} | change
    if request["problem"] == "two":
        request["problem"] = [column.problem] * 2
    with pytest.raises(FitError, match=text):
        fit_stiffness(**request)


def test_no_force_is_refused(column, clean) -> None:
    with pytest.raises(FitError, match="no trial has a force"):
        fit_stiffness(column.problem, clean[:1])


def test_trials_of_one_label_are_refused(column, clean) -> None:
    """What is found of a frame is told by its label; of two alike one would be lost."""
    with pytest.raises(FitError, match=f"2 trials have the label '{clean[1].label}'"):
        fit_stiffness(column.problem, [*clean, clean[1]])


def test_default_bounds_are_those_of_the_ratios(column, clean) -> None:
    assert fit_stiffness(column.problem, clean, method="paper", max_iterations=1).bounds == RATIO_BOUNDS


def test_eqs_8_10_on_the_template_torso() -> None:
    """The coarse template: adjoint is forward. That ratios come back is examples/02's test."""
    torso = template_torso(157.0)
    problem = EquilibriumProblem(torso, three_point_supports(torso, "right"))
    view = frontal_view(centre=torso.rest_pose.bone_positions[torso.vertebra_bones].mean(0))
    shares = silhouette_shares(torso, view, torso.rest_pose)
    seen = state_features(torso, view, torso.rest_pose, shares).corners
    load = rib_push(torso, "right", 7.5, 40.0)
    data = [Trial(load, VertebraCorners(torso.vertebrae, seen), view, "40 N", "push")]
    groups = tuple(parameter_group(name, torso.joints.kinds) for name in ("lateral_bending", "tissue"))
    trial_set = TrialSet([problem], data, groups, "procrustes", None)
    point = trial_set.solve(np.log([0.3, 0.05]))
    forward = trial_set.jacobian(point, trial_set.slope(point)).T @ point.values
    adjoint = trial_set.gradient(point)
    assert np.abs(adjoint).min() > 1.0
    assert np.allclose(adjoint, forward, rtol=1e-8)


def test_a_place_as_likely_as_the_estimate_is_told() -> None:
    where = WeighedPoint(np.zeros(1), SimpleNamespace(log_ratios=np.log([0.5, 0.02])), np.zeros(1))
    likely = SimpleNamespace(effective=500.0, settled=True, likelier=where)
    ended = SimpleNamespace(short=0.0, carried=0.0, status=FitStatus.CONVERGED)
    (warning,) = unsettled_warnings(ended, likely, ("lateral_bending", "tissue"))
    assert warning.startswith("lateral_bending 0.5, tissue 0.02 explains the radiographs about as well")
    likely.likelier = None
    assert unsettled_warnings(ended, likely, ("lateral_bending", "tissue")) == []


def test_draws_that_hang_on_few_places_are_told() -> None:
    likely = SimpleNamespace(effective=40.2, settled=True, likelier=None)
    (warning,) = unsettled_warnings(
        SimpleNamespace(short=0.0, carried=0.0, status=FitStatus.CONVERGED), likely, ("tissue",)
    )
    assert warning == "the draws are worth no more than 40 independent ones; take the intervals"


def test_an_estimate_beside_a_jump_is_told_with_how_near_it_is() -> None:
    def ended(short, status=FitStatus.CONVERGED):
        return SimpleNamespace(short=short, carried=0.0, status=status)

    # With intervals or without any.
    for likely in (SimpleNamespace(effective=500.0, settled=True, likelier=None), None):
        (warning,) = unsettled_warnings(ended(0.09), likely, ("tissue",))
        assert "jumps between equilibria" in warning
        assert warning.endswith("settled to 0.09 standard deviations")
        assert not unsettled_warnings(ended(0.03), likely, ("tissue",))
        assert not unsettled_warnings(ended(0.09), likely, ("tissue",), close_sd=0.1)
    assert not unsettled_warnings(ended(3.0, FitStatus.STALLED), None, ("tissue",))
    assert not unsettled_warnings(None, None, ("tissue",))


def stood_elsewhere(trial, by):
    """The patient by (2,) mm elsewhere before the detector."""
    return replace(
        trial, corners=replace(trial.corners, corners=trial.corners.corners + trial.view.magnification * np.array(by))
    )


@pytest.mark.parametrize("aside", [-20.0, 20.0])
def test_where_the_patient_stood_is_no_motion_against_the_push(column, noisy, aside) -> None:
    """What a frame shows is compared with the unloaded one of its push, and with the torso at rest without one."""
    moved = [stood_elsewhere(trial, (aside, 0.0)) for trial in noisy]
    fit = fit_stiffness(column.problem, moved, start=column.truth, bounds=BOUNDS, extent="estimate", close_sd=0.1)
    assert fit.warnings == ()
    wrong = [replace(trial, load=trial.load.scaled(-1.0)) for trial in noisy]
    for trials in (wrong, wrong[1:]):
        asked = column.weighed(trials)
        default = asked.trial_set.solve(np.zeros(2))
        found = trial_warnings(asked, default, default)
        assert [text.partition(":")[0] for text in found] == ["push 1 40 N", "push 1 100 N"]
        assert all("moved against the push" in text for text in found)


def test_priors_that_leave_no_covariance_are_one_clear_line(column, noisy) -> None:
    for priors in (Priors(annotation_mm=1e-6), Priors(annotation_mm=1e-6, tracking_factor=0.0)):
        with pytest.raises(FitError, match=r"contradict each other.*far too small, e\.g\. annotation_mm"):
            fit_stiffness(
                column.problem, noisy, start=column.truth, known=Known(priors), bounds=BOUNDS, extent="estimate"
            )


def test_a_fit_without_intervals_prints_none(column, whole, noisy) -> None:
    paper = fit_stiffness(column.problem, noisy[1:], method="paper", bounds=BOUNDS, max_iterations=2)
    for text in (str(paper), repr(paper)):
        assert "nan" not in text and "tissue" in text
    assert "(95 % " in str(whole)
