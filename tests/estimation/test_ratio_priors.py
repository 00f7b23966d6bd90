"""What is held of ratios before a fit: its rows, what they do to a fit, and that they are no data."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from spinestiff.anatomy.regions import parameter_groups, torso_ratios
from spinestiff.errors import FitError
from spinestiff.estimation.ended import likelihood_rise
from spinestiff.estimation.fit import fit_stiffness
from spinestiff.estimation.fitted import FitEnd
from spinestiff.estimation.known import Known
from spinestiff.estimation.linear import MOST_PROFILED
from spinestiff.estimation.noise import restricted_factor
from spinestiff.estimation.priors import Priors
from spinestiff.estimation.ratio_priors import POPULATIONS, SMOOTHNESS, RatioPrior, ratio_prior
from spinestiff.estimation.status import FitStatus
from spinestiff.estimation.weighed import WeighedProblem, reduced

BOUNDS = (0.01, 10.0)
PARTS = {"lateral_bending@T9-T12": 0.2, "lateral_bending@lumbar": 0.6, "tissue": 0.4}
KEPT = ("tracking_length", "support_force_n", "marker_mm", "marking_mm", "pedicle_mm")
LEVELS = ("lateral_bending@levels", "tissue")


def held(column, names, smoothness=0.3, population=None):
    return ratio_prior(parameter_groups(column.torso, names), column.torso.joints.kinds, smoothness, population)


@pytest.fixture(scope="module")
def parted(column):
    """Radiographs of a spine whose lumbar part is three times as stiff."""

    class Parted(type(column)):
        def ratios(self, values):
            return torso_ratios(self.torso, dict(values))

    return Parted(column.problem).trials(PARTS, annotation=0.3, tracking=0.12, seed=1)


@pytest.fixture(scope="module")
def by_level(column, parted):
    # Ten ratios of so short a column need tracking that nothing takes along.
    return fit_stiffness(column.problem, parted, LEVELS, bounds=(0.003, 30.0), known=Known(Priors(tracking_drag=0.0)))


def with_prior(asked, prior):
    return WeighedProblem(
        asked.trial_set,
        [(asked.trial_set.problems[0], one.target.trial) for one in asked.noise.seen if not one.target.trial.load.size],
        "procrustes",
        Known(asked.priors),
        prior,
    )


def test_neighbouring_levels_differ_by_so_much(column):
    prior = held(column, LEVELS, 0.5)
    assert list(prior.texts) == [SMOOTHNESS]
    assert prior.rows.shape == (8, 10)
    smooth = np.r_[np.full(9, -2.0), 3.0]
    assert prior.residuals(smooth) == pytest.approx(np.zeros(8))
    step = smooth + np.r_[np.zeros(4), np.ones(5), 0.0]
    assert prior.residuals(step) == pytest.approx(2.0 * np.eye(8)[3])


def test_nothing_is_held_unless_there_are_neighbours_or_it_is_asked_for(column):
    assert held(column, ("lateral_bending", "tissue")) is None
    assert held(column, tuple(PARTS)) is None
    assert held(column, LEVELS, 0.0) is None
    apart = ("lateral_bending@T9-T10", "lateral_bending@T11-T12", "axial_rotation@T10-T11")
    assert held(column, apart) is None
    assert len(held(column, (*apart, "lateral_bending@T10-T11")).rows) == 2


def test_a_population_is_of_the_mean_level(column):
    """Table 4's geometric mean of 0.069 and log sd of 1.38, with the mean's own error."""
    people = POPULATIONS["koutras2025"]
    assert np.exp(people.mean) == pytest.approx(0.0686, abs=1e-4)
    # 2.4469 is Student's t of six degrees of freedom at 95 %, by a table.
    assert people.sd == pytest.approx(1.3810 * np.sqrt(8.0 / 7.0) * 2.4469 / 1.95996, abs=1e-3)
    names = ("lateral_bending", "tissue")
    prior = held(column, names, population="koutras2025")
    assert list(prior.texts) == ["population koutras2025"]
    assert prior.residuals(np.array([people.mean, 7.0])) == pytest.approx([0.0])
    assert prior.residuals(np.array([people.mean - 2.0 * people.sd, 7.0])) == pytest.approx([-2.0])
    # Three of nine levels are thoracic: their log counts a third of the mean.
    parts = held(column, tuple(PARTS), population="koutras2025")
    assert parts.rows[0] * people.sd == pytest.approx([1.0 / 3.0, 2.0 / 3.0, 0.0])
    assert len(held(column, LEVELS, population="koutras2025").rows) == 9
    beside = held(column, ("lateral_bending", "lateral_bending@lumbar"), population="koutras2025")
    assert beside.rows[0] * people.sd == pytest.approx([1.0, 2.0 / 3.0])


@pytest.mark.parametrize(
    ("names", "population", "method", "words"),
    [
        (("lateral_bending", "tissue"), "everyone", "weighed", "unknown population 'everyone'; known are koutras2025"),
        (("tissue",), "koutras2025", "weighed", "leave 9 of 9 levels at their default"),
        (("lateral_bending@lumbar", "tissue"), "koutras2025", "weighed", "leave 3 of 9 levels at their default"),
        (("lateral_bending", "tissue"), "koutras2025", "paper", "method 'paper', which knows no priors"),
    ],
)
def test_populations_that_say_nothing_of_these_ratios_are_refused(column, clean, names, population, method, words):
    with pytest.raises(FitError, match=words):
        fit_stiffness(column.problem, clean, names, method, known=Known(population=population), bounds=BOUNDS)


def test_rows_are_residuals_with_their_slope(column, asked):
    prior = held(column, ("lateral_bending", "tissue"), population="koutras2025")
    problem = with_prior(asked, prior)
    point = problem.solve(np.log([0.5, 0.6]), np.zeros(len(problem.unknowns)))
    assert problem.size == asked.size + 1
    assert point.values[-1] == pytest.approx(
        (np.log(0.5) - POPULATIONS["koutras2025"].mean) / POPULATIONS["koutras2025"].sd
    )
    slope = problem.slope(point)
    assert (slope.ratios[-1] == prior.rows[0]).all()
    assert not slope.nuisances[-1].any()
    # As precision: the one of the data, and the prior's.
    weights = problem.weights(point, slope, None)
    bare = asked.solve(np.log([0.5, 0.6]), np.zeros(len(asked.unknowns)))
    alone = reduced(bare, asked.slope(bare), replace(weights, root=weights.root[: asked.size, : asked.size]))
    both = reduced(point, slope, weights)
    assert both.ratios.T @ both.ratios == pytest.approx(alone.ratios.T @ alone.ratios + prior.rows.T @ prior.rows)


def test_what_is_held_is_no_data(column, asked, found):
    """A prior far off the estimate changes no p-value."""
    there = found.point
    absurd = with_prior(asked, RatioPrior(np.array([[50.0, 0.0]]), np.array([-400.0]), {}))
    point = absurd.solve(there.log_ratios, there.nuisances)
    assert abs(point.values[-1]) > 100.0
    assert absurd.p_value(point, absurd.slope(point)) == pytest.approx(asked.p_value(there, found.slope), rel=1e-3)


def test_what_is_held_of_ratios_leaves_more_of_the_residuals_to_tracking():
    """A residual that only a ratio known to be 0 would take away is tracking's error."""

    class Own:
        def tracking(self, factor, inflation):
            return factor**2 * np.eye(4)

    fixed, values = np.eye(4)[:, :2], np.array([2.5, 0.0, 1.0, -1.0])
    free = restricted_factor(Own(), np.zeros((4, 4)), values, fixed, 0.7, np.ones(4))
    rows = (np.array([[1e3, 0.0]]), np.zeros(1))
    assert restricted_factor(Own(), np.zeros((4, 4)), values, fixed, 0.7, np.ones(4), rows) > 1.2 * free


def test_what_is_held_of_ratios_leaves_more_of_the_residuals_to_outlying_vertebrae(column, clean, found):
    """Ratios that are held far from the estimate take nothing away."""
    known = {field.name: 0.0 for field in fields(Priors) if isinstance(field.default, float)}
    certain = Priors(**(known | dict.fromkeys(("annotation_mm", "tracking_mm"), 0.05) | dict.fromkeys(KEPT, 1.0)))
    asked = column.weighed(clean, certain)
    there = np.log(list(column.truth.values())) + [0.5, -0.8]
    held_there = with_prior(asked, RatioPrior(1e3 * np.eye(2), 1e3 * there, {}))
    sizes = []
    for problem in (asked, held_there):
        point = problem.solve(there, np.zeros(len(problem.unknowns)))
        slope = problem.slope(point)
        weights = problem.weights(point, slope, problem.weights(point, slope, None))
        sizes.append(weights.inflation.max())
    assert sizes[1] > 1.1 * sizes[0], sizes


def test_a_wide_prior_moves_an_estimate_by_what_the_data_leave_open(column, noisy):
    """To first order by the share that the prior has of the precision; the likelihood rises by both."""
    plain, told = (
        fit_stiffness(column.problem, noisy, bounds=BOUNDS, known=Known(population=name), extent="intervals")
        for name in (None, "koutras2025")
    )
    people = POPULATIONS["koutras2025"]
    before, after = (np.log(fit.ratios.as_dict()["lateral_bending"]) for fit in (plain, told))
    precision = 1.0 / plain.covariance[0, 0]
    wanted = (people.mean - before) * people.sd**-2 / (precision + people.sd**-2)
    assert wanted < -0.002
    assert after - before == pytest.approx(wanted, rel=0.4)
    assert told.covariance[0, 0] < plain.covariance[0, 0]
    assert told.weighed.data_sd[0] == pytest.approx(np.sqrt(plain.covariance[0, 0]), rel=0.05)
    assert plain.weighed.held == {}
    assert list(told.weighed.held) == ["population koutras2025"]
    problems = [column.problem] * len(noisy)
    others = {**told.ratios.as_dict(), "lateral_bending": 10.0}
    rises = [
        likelihood_rise(problems, noisy, FitEnd.of(told), others, known=Known(population=name))
        for name in (None, "koutras2025")
    ]
    held_there = ((np.log(10.0) - people.mean) / people.sd) ** 2 - ((after - people.mean) / people.sd) ** 2
    assert rises[1] - rises[0] == pytest.approx(held_there, rel=0.02)


def test_regions_are_told_apart_where_the_radiographs_show_them(column, parted):
    """One ratio for both leaves residuals that are none of the expected errors."""
    fit = fit_stiffness(column.problem, parted, tuple(PARTS), bounds=BOUNDS, extent="intervals")
    assert fit.status is FitStatus.CONVERGED
    assert fit.profiled
    for name, value in PARTS.items():
        low, high = fit.intervals95[name]
        assert low < value < high, name
    assert fit.intervals95["lateral_bending@T9-T12"][1] < fit.intervals95["lateral_bending@lumbar"][0]
    common = fit_stiffness(column.problem, parted, bounds=BOUNDS, extent="estimate")
    assert fit.weighed.p_value > 0.1 > 0.01 > common.weighed.p_value


def test_levels_are_found_as_smooth_as_is_held(column, parted, by_level):
    fit = by_level
    assert fit.status is FitStatus.CONVERGED
    assert len(fit.names) == 10 > MOST_PROFILED
    assert not fit.profiled
    assert fit.likely.profiles == fit.weighed.changes == ()
    assert fit.weighed.budget is not None
    values = fit.ratios.as_dict()
    for name, value in values.items():
        low, high = fit.intervals95[name]
        true = (
            PARTS["tissue"] if name == "tissue" else 0.2 if "T9-" in name or "T10-" in name or "T11-" in name else 0.6
        )
        assert low < true < high and low < value < high, name
    assert list(fit.weighed.held) == [SMOOTHNESS]
    assert (fit.weighed.data_sd >= 0.99 * np.sqrt(np.diag(fit.covariance))).all()
    assert fit.weighed.data_sd.max() > 3.0
    smoother = Priors(level_smoothness=0.02, tracking_drag=0.0)
    stiff = fit_stiffness(column.problem, parted, LEVELS, bounds=BOUNDS, known=Known(smoother), extent="estimate")
    spread = [np.ptp(np.log(one.ratios.values[:-1])) for one in (fit, stiff)]
    assert spread[1] < 0.3 * spread[0]
    # What the data know best is not what was held.
    known, held = fit.weighed.best_known, stiff.weighed.best_known
    assert held.sd_log > 0.5 * known.sd_log
