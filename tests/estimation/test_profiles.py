"""Ends of intervals, the joint region and draws, against the model itself."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from spinestiff.errors import EquilibriumError
from spinestiff.estimation import profiles
from spinestiff.estimation.emulator import FARTHEST_NUISANCES, HIGH, LITTLE_GAIN, Place, tells
from spinestiff.estimation.point import WeighedPoint, WeighedSlope
from spinestiff.estimation.priors import Priors
from spinestiff.estimation.profiles import (
    CLOSE_ENOUGH,
    FARTHEST_STEP,
    WIDTH_FACTOR,
    _likelier,
    _solve_ends,
    likely_ratios,
    region_rise,
    rise_at,
    solved_place,
)
from spinestiff.estimation.status import FitStatus
from spinestiff.estimation.tracing import Profile, Tracer, profile_kind
from spinestiff.estimation.weighed import WeighedFit, Weights, phi, reduced


def sd_of(found):
    model = reduced(found.point, found.slope, found.weights)
    return np.sqrt(np.diag(np.linalg.inv(model.ratios.T @ model.ratios)))


def least_rise(asked, found, i, where):
    """Of psi over the estimate's with log ratio ``i`` given, by Newton steps of the other on the model."""
    assert len(where) == 2
    model, q = reduced(found.point, found.slope, found.weights), np.array(where)
    least, nuisances = model.psi, found.point.nuisances
    j, aside, beside = 1 - i, 0.1, []
    for change in (0.0, aside):
        point, slope = found.point, found.slope
        for _ in range(3):
            point = asked.solve(q + change * np.eye(2)[j], nuisances, point, slope)
            slope = asked.slope(point)
            model = reduced(point, slope, found.weights)
            nuisances = model.nuisances
        beside.append((model.psi, model.log_precision, model.ratios[:, j] @ model.values, model.ratios[:, j]))
    rise, precision, slope_there, column = beside[0]
    gradient = slope_there + (beside[1][1] - precision) / aside
    step = -gradient / (column @ column)
    q[j] += step
    return rise + 0.5 * gradient * step - least, q


@pytest.mark.parametrize("i", [0, 1])
@pytest.mark.parametrize("side", ["low", "high"])
def test_ends_are_where_the_models_profile_has_risen_enough(asked, found, likely, i, side) -> None:
    """psi, least over the other ratio on the model, rises by 3.84/2 there for a width factor of 1, to 8 % of an sd."""
    end = float(getattr(likely, side)[i])
    profile = likely.profiles[i]
    start = profile.others[np.argmin(np.abs(profile.log_ratios - end))].copy()
    start[i] = end
    rise, other = least_rise(asked, found, i, start)
    sd = sd_of(found)[i]
    step = 0.1 * sd * (1.0 if side == "high" else -1.0)
    farther, _ = least_rise(asked, found, i, other + step * np.eye(2)[i])
    steepness = (farther - rise) / step
    wanted = WIDTH_FACTOR**2 * chi2.ppf(0.95, 1)
    assert rise == pytest.approx(0.5 * wanted, abs=0.04 * np.sqrt(wanted))
    assert abs(0.5 * wanted - rise) / abs(steepness) < 0.08 * sd


class Bent:
    """One ratio that does nothing, and a nuisance n whose residual 5 atan(2 (n - 1)) full Gauss-Newton steps overshoot
    farther every time."""

    def __init__(self) -> None:
        self.solved: list[float] = []
        self.trial_set = SimpleNamespace(note=lambda *of: None)

    def solve(self, log_ratios, nuisances, near=None, slope=None, **limits):
        self.solved.append(float(nuisances[0]))
        return WeighedPoint(
            np.array(nuisances), SimpleNamespace(log_ratios=log_ratios), 5.0 * np.arctan(2.0 * (nuisances - 1.0))
        )

    def slope(self, point):
        column = 10.0 / (1.0 + (2.0 * (point.nuisances - 1.0)) ** 2)
        return WeighedSlope(SimpleNamespace(), np.zeros((1, 1)), column[:, None])


def test_nuisances_that_swing_are_brought_to_rest() -> None:
    bent = Bent()
    start = bent.solve(np.zeros(1), np.ones(1))
    fit = WeighedFit(start, bent.slope(start), Weights(np.eye(1), 1.0, np.ones(1)), FitStatus.CONVERGED, ())
    place, height, found = solved_place(bent, fit, np.array([0.3]), np.zeros(1))
    assert found
    model = reduced(place.point, place.slope, fit.weights)
    assert tells(place.point, model, reduced(start, fit.slope, fit.weights).psi)
    assert height == pytest.approx(model.psi)
    assert np.abs(np.diff([0.0, *bent.solved[1:]])).max() <= profiles.LONGEST_STEP + 1e-12


def test_a_place_tells_psi_where_phi_would_gain_little_there() -> None:
    bent = Bent()
    start = bent.solve(np.zeros(1), np.zeros(1))
    weights = Weights(np.eye(1), 1.0, np.ones(1))
    model = reduced(start, bent.slope(start), weights)
    # Of the linear model: the residual r + c d and the nuisance d itself, at its least over d.
    r, c = float(start.values[0]), float(bent.slope(start).nuisances[0, 0])
    least = 0.5 * r**2 / (1.0 + c**2)
    assert model.gain == pytest.approx(phi(start, weights) - least)
    there = replace(start, nuisances=model.nuisances + FARTHEST_NUISANCES[1])
    for high, least in ((0, model.psi - 0.99 * HIGH), (1, model.psi - 1.01 * HIGH)):
        near = replace(start, nuisances=model.nuisances + 0.99 * FARTHEST_NUISANCES[high])
        assert tells(near, replace(model, gain=10.0), least)
        assert tells(there, replace(model, gain=0.99 * LITTLE_GAIN[high]), least)
        assert not tells(there, replace(model, gain=1.01 * LITTLE_GAIN[high]), least)


class Creased(Bent):
    """Beyond a crease residuals jump, so that what derivatives before it promise is not there; beyond another one there
    is no equilibrium."""

    crease, end = 0.4, 0.5

    def solve(self, log_ratios, nuisances, near=None, slope=None, **limits):
        if nuisances[0] > self.end:
            self.solved.append(float(nuisances[0]))
            raise EquilibriumError("none")
        point = super().solve(log_ratios, nuisances)
        return replace(point, values=point.values - 10.0 * (nuisances[0] > self.crease))


@pytest.mark.parametrize("end", [0.5, 2.0])
def test_where_phi_rises_nuisances_are_looked_for_nearer_to_the_best(end) -> None:
    creased = Creased()
    creased.end = end
    weights = Weights(np.eye(1), 1.0, np.ones(1))
    start = Bent().solve(np.zeros(1), np.ones(1))
    fit = WeighedFit(start, creased.slope(start), weights, FitStatus.CONVERGED, ())
    place, height, found = solved_place(creased, fit, np.array([0.3]), np.zeros(1))
    tried = creased.solved
    assert tried[0] == 0.0 and tried[1] == pytest.approx(profiles.LONGEST_STEP)
    assert tried[2] == pytest.approx(profiles.SHORTENED * profiles.LONGEST_STEP)
    lowest = min(
        (n for n in tried if n <= creased.crease), key=lambda n: (5.0 * np.arctan(2.0 * (n - 1.0))) ** 2 + n**2
    )
    assert place.point.nuisances[0] == lowest
    assert len(tried) == 1 + profiles.MOST_AGAIN and not found
    assert height == pytest.approx(reduced(place.point, place.slope, weights).psi)


@pytest.mark.parametrize(("second", "starts_from"), [(0.25, "second"), (0.1, "estimate"), (2.0, "estimate")])
def test_an_end_is_solved_from_a_place_that_is_much_nearer_than_the_estimate(second, starts_from, monkeypatch) -> None:
    bent, starts = Bent(), []
    start, there = bent.solve(np.zeros(1), np.ones(1)), bent.solve(np.array([second]), np.ones(1))
    fit = WeighedFit(start, bent.slope(start), Weights(np.eye(1), 1.0, np.ones(1)), FitStatus.CONVERGED, ())
    places = [Place(point, bent.slope(point)) for point in (start, there)]
    emulator = SimpleNamespace(
        log_ratios=np.array([place.point.log_ratios for place in places]),
        nuisances=lambda where: (np.ones(1), np.eye(1)),
        psi=lambda where: np.zeros(1),
    )

    def solve(log_ratios, nuisances, near, slope, real=bent.solve, **limits):
        starts.append((near, slope))
        return real(log_ratios, nuisances)

    monkeypatch.setattr(bent, "solve", solve)
    _solve_ends(bent, fit, emulator, places, [np.array([0.4])], np.eye(1), [], CLOSE_ENOUGH)
    near, slope = starts[0]
    assert near is (there if starts_from == "second" else start)
    assert (slope is None) == (starts_from == "second")


def test_nothing_is_looked_for_beside_a_place_without_equilibrium(monkeypatch) -> None:
    bent, tried, failed = Bent(), [], []
    start = bent.solve(np.zeros(1), np.ones(1))
    fit = WeighedFit(start, bent.slope(start), Weights(np.eye(1), 1.0, np.ones(1)), FitStatus.CONVERGED, ())
    places = [Place(start, bent.slope(start))]
    emulator = SimpleNamespace(
        log_ratios=np.zeros((1, 1)), nuisances=lambda where: (np.ones(1), np.eye(1)), psi=lambda where: np.zeros(1)
    )

    def solve(log_ratios, *args, **limits):
        tried.append(float(log_ratios[0]))
        raise EquilibriumError("it folds")

    monkeypatch.setattr(bent, "solve", solve)
    for end in (0.7, 0.8, -0.7):
        ends = [np.array([end])]
        assert _solve_ends(bent, fit, emulator, places, ends, np.eye(1), failed, CLOSE_ENOUGH) == (False, [0])
    assert tried == [0.7, -0.7]
    assert len(places) == 1


def test_nothing_is_looked_for_beside_a_place_whose_nuisances_were_not_found(monkeypatch) -> None:
    bent, failed = Bent(), []
    start = bent.solve(np.zeros(1), np.ones(1))
    fit = WeighedFit(start, bent.slope(start), Weights(np.eye(1), 1.0, np.ones(1)), FitStatus.CONVERGED, ())
    places = [Place(start, bent.slope(start))]
    emulator = SimpleNamespace(
        log_ratios=np.zeros((1, 1)), nuisances=lambda where: (np.zeros(1), np.eye(1)), psi=lambda where: np.zeros(1)
    )
    monkeypatch.setattr("spinestiff.estimation.profiles.MOST_AGAIN", 0)
    solved = []
    for end in (0.7, 0.8, 0.75):
        before = len(bent.solved)
        ends = [np.array([end])]
        assert _solve_ends(bent, fit, emulator, places, ends, np.eye(1), failed, CLOSE_ENOUGH) == (False, [0])
        solved.append(len(bent.solved) - before)
    assert solved == [1, 1, 0]  # a second try
    assert len(places) == 3


def test_no_place_is_solved_twice() -> None:
    """An end at a place that was solved and that the emulator had no use for."""
    bent = Bent()
    start, there = bent.solve(np.zeros(1), np.ones(1)), bent.solve(np.array([0.3]), np.ones(1))
    fit = WeighedFit(start, bent.slope(start), Weights(np.eye(1), 1.0, np.ones(1)), FitStatus.CONVERGED, ())
    places = [Place(point, bent.slope(point)) for point in (start, there)]
    emulator = SimpleNamespace(
        log_ratios=np.zeros((1, 1)), nuisances=lambda where: (np.ones(1), np.eye(1)), psi=lambda where: np.zeros(1)
    )
    before = len(bent.solved)
    # It counts as an end that is not known.
    assert _solve_ends(bent, fit, emulator, places, [np.array([0.3])], np.eye(1), [], CLOSE_ENOUGH) == (False, [0])
    assert len(bent.solved) == before
    _solve_ends(bent, fit, emulator, places, [np.array([0.4])], np.eye(1), [], CLOSE_ENOUGH)
    assert len(bent.solved) > before


def test_a_far_end_that_is_given_up_wants_no_further_round() -> None:
    """The way to it was tried, twice, and has no equilibrium."""
    bent = Bent()
    start = bent.solve(np.zeros(1), np.ones(1))
    fit = WeighedFit(start, bent.slope(start), Weights(np.eye(1), 1.0, np.ones(1)), FitStatus.CONVERGED, ())
    emulator = SimpleNamespace(log_ratios=np.zeros((1, 1)))
    failed, before = [np.array([FARTHEST_STEP])] * 2, len(bent.solved)
    places = [Place(start, bent.slope(start))]
    assert _solve_ends(bent, fit, emulator, places, [np.array([3.0])], np.eye(1), failed, CLOSE_ENOUGH) == (False, [0])
    assert len(bent.solved) == before


def test_ends_lie_about_two_standard_deviations_apart(found, likely) -> None:
    width = (likely.high - likely.low) / (2.0 * 1.96 * sd_of(found))
    assert ((width > 0.7) & (width < 1.5)).all()
    assert ((likely.low < found.point.log_ratios) & (found.point.log_ratios < likely.high)).all()
    assert likely.kinds == ("bounded", "bounded")
    assert not likely.open_low.any()
    assert not likely.open_high.any()


def test_profiles_rise_from_the_estimate_to_both_sides(found, likely) -> None:
    for i, profile in enumerate(likely.profiles):
        assert (np.diff(profile.log_ratios) > 0.0).all()
        assert np.array_equal(profile.others[:, i], profile.log_ratios)
        lowest = int(np.argmin(profile.rise))
        assert profile.log_ratios[lowest] == pytest.approx(found.point.log_ratios[i], abs=0.2 * sd_of(found)[i])
        assert profile.rise[lowest] == pytest.approx(0.0, abs=0.02)
        assert (np.diff(profile.rise[: lowest + 1]) < 0.0).all()
        assert (np.diff(profile.rise[lowest:]) > 0.0).all()


def test_the_regions_outline_has_risen_by_the_joint_limit(asked, found, likely) -> None:
    assert region_rise(2) == pytest.approx(WIDTH_FACTOR**2 * chi2.ppf(0.95, 2))
    outline = likely.region
    assert np.allclose(outline[0], outline[-1])
    for where in outline[:: len(outline) // 4]:
        assert rise_at(asked, found, where) == pytest.approx(WIDTH_FACTOR**2 * 5.991, abs=0.6)
    # The joint region reaches farther than either interval.
    assert (outline.min(0) < likely.low).all()
    assert (outline.max(0) > likely.high).all()


def test_rise_is_0_at_the_estimate(asked, found) -> None:
    assert rise_at(asked, found, found.point.log_ratios) == pytest.approx(0.0, abs=1e-4)


def test_a_rise_that_takes_too_many_factorisations_is_given_up(asked, found, monkeypatch) -> None:
    monkeypatch.setattr(profiles, "MOST_FACTORISATIONS", 0)
    with pytest.raises(EquilibriumError, match="iteration limit"):
        rise_at(asked, found, found.point.log_ratios - 1.0)


def test_draws_are_those_of_the_posterior(found, likely) -> None:
    """Quantiles of each ratio and the correlation, against sums over a grid."""
    sd, best = sd_of(found), found.point.log_ratios
    axes = [best[i] + sd[i] * np.linspace(-5.0, 5.0, 81) for i in (0, 1)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
    weight = np.exp((likely.emulator.psi(best) - likely.emulator.psi(grid)) / WIDTH_FACTOR**2)
    weight /= weight.sum()
    ratios, nuisances = likely.draws
    assert likely.effective > 500.0
    for i in (0, 1):
        order = np.argsort(grid[:, i], kind="stable")
        cumulative = np.cumsum(weight[order])
        for level in (0.1, 0.5, 0.9):
            exact = grid[order, i][np.searchsorted(cumulative, level)]
            # 500 draws: 0.06 to 0.08 sd by chance; a grid step is 0.125.
            assert np.quantile(ratios[:, i], level) == pytest.approx(exact, abs=0.25 * WIDTH_FACTOR * sd[i])
        inside, exactly = ((r[:, i] > likely.low[i]) & (r[:, i] < likely.high[i]) for r in (ratios, grid))
        assert inside.mean() == pytest.approx(weight[exactly].sum(), abs=0.03)
        # An interval is of the profile.
        assert weight[exactly].sum() == pytest.approx(0.95, abs=0.03), weight[exactly].sum()
    centred = grid - weight @ grid
    covariance = centred.T @ (weight[:, None] * centred)
    correlation = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
    assert np.corrcoef(ratios.T)[0, 1] == pytest.approx(correlation, abs=0.1)
    assert nuisances.shape == (500, len(found.point.nuisances))


def test_drawn_nuisances_spread_as_the_fit_says(found, likely) -> None:
    columns = found.weights.whiten(np.column_stack([found.slope.nuisances, found.slope.ratios]))
    m = len(found.point.nuisances)
    covariance = np.linalg.inv(columns.T @ columns + np.diag(np.r_[np.ones(m), 0.0, 0.0]))[:m, :m]
    spread = np.std(likely.draws[1], axis=0)
    assert np.allclose(spread, np.sqrt(np.diag(covariance)), rtol=0.2)
    assert np.allclose(likely.draws[1].mean(0), found.point.nuisances, atol=0.25)


def ended(column, trials, names=("lateral_bending", "tissue"), start=(1.0, 1.0)):
    asked = column.weighed(trials, names=names)
    found = column.estimated(asked, start)
    return likely_ratios(asked, found, [Place(*place) for place in found.visited])[0]


def test_what_the_pictures_do_not_show_is_flat(column, clean) -> None:
    """Vertebrae shear front to back next to nothing under a push from the side."""
    likely = ended(column, clean, ("lateral_bending", "sagittal_shear"))
    assert likely.kinds == ("bounded", "flat")
    assert (likely.open_low[1], likely.open_high[1]) == (True, True)
    assert (likely.low[1], likely.high[1]) == pytest.approx(column.limits)


def test_a_hole_between_places_is_solved_and_not_drawn_from(column, clean) -> None:
    """Flexion is known to one side: at first the emulator has places far lower than the estimate."""
    priors = Priors(tissue_volume=0.0, rib_joints=0.0)
    asked = column.weighed(clean, priors, names=("lateral_bending", "flexion_extension"))
    found = column.estimated(asked)
    likely, _ = likely_ratios(asked, found, [Place(*place) for place in found.visited])
    assert likely.kinds == ("bounded", "one-sided")
    assert (likely.open_low[1], likely.open_high[1]) == (False, True)
    for profile in likely.profiles:
        assert profile.rise.min() > -0.1
    heights = likely.emulator.psi(likely.draws[0]) - likely.emulator.psi(found.point.log_ratios)
    assert heights.min() > -0.1


def test_tissue_too_soft_to_be_felt_is_known_to_one_side(column) -> None:
    likely = ended(column, column.trials({"lateral_bending": 1.0, "tissue": 0.03}, annotation=0.2, tracking=0.1))
    assert likely.kinds[1] in ("one-sided", "at a bound")
    assert likely.open_low[1]
    assert not likely.open_high[1]
    assert likely.high[1] > np.log(0.03)


def test_a_profile_that_hardly_rises_is_followed_to_the_bounds(found, likely) -> None:
    """Bounds 60 standard deviations off, beyond which nothing is known: no profile ends in between."""
    limits = (-60.0 * float(sd_of(found).max()), 60.0 * float(sd_of(found).max()))
    emulator = SimpleNamespace(psi=lambda where: 1e-4 * np.sum(np.atleast_2d(where) ** 2, axis=1))
    tracer = Tracer(emulator, np.zeros(2), np.diag(sd_of(found) ** 2), limits, np.zeros((1, 2)))
    for i in range(2):
        profile = tracer.profile(i, 1.92)
        assert (profile.log_ratios[0], profile.log_ratios[-1]) == limits
        assert tracer.end(profile, i, 1.0, 1.92)[1]


GRID = np.stack(np.meshgrid(np.linspace(-2.0, 2.0, 81), np.linspace(-4.0, 4.0, 41)), -1).reshape(-1, 2)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("others", [GRID, None], ids=["many scouts", "one scout"])
def test_an_interval_holds_a_valley_beside_the_estimates(sign, others) -> None:
    """Of two normal valleys the other, 1 higher, is 5 and 6 standard deviations off: both belong to the interval."""

    def height(where):
        own = np.sum((np.atleast_2d(where) / [0.2, 0.5]) ** 2, axis=1)
        beside = 2.0 + np.sum(((np.atleast_2d(where) - [sign, 3.0]) / [0.3, 0.5]) ** 2, axis=1)
        return -np.logaddexp(-0.5 * own, -0.5 * beside)

    scouts = np.array([[1.05 * sign, 3.1]]) if others is None else others
    tracer = Tracer(SimpleNamespace(psi=height), np.zeros(2), np.diag([0.04, 0.25]), (-6.0, 6.0), scouts)
    profile = tracer.profile(0, 1.92)
    assert np.interp(sign, profile.log_ratios, profile.rise) == pytest.approx(1.0, abs=0.1) or others is None
    (near, _), (far, _) = (tracer.end(profile, 0, side, 1.92) for side in (-sign, sign))
    assert near[0] == pytest.approx(-sign * 0.2 * np.sqrt(2.0 * 1.92), abs=0.01)
    assert far == pytest.approx([sign * (1.0 + 0.3 * np.sqrt(2.0 * 0.92)), 3.0], abs=0.01)


def test_a_likelier_place_is_one_that_phi_itself_says_is(found, likely, places) -> None:
    assert likely.likelier is None
    assert _likelier(places, found.weights) is None
    worst = max(places, key=lambda place: phi(place.point, found.weights))
    assert _likelier([worst, *places], found.weights) is places[0].point


def test_one_ratio_alone_has_an_interval_and_no_region(column, noisy) -> None:
    likely = ended(column, noisy, ("everything",), (1.0,))
    assert likely.kinds == ("bounded",)
    assert likely.region is None
    assert likely.draws[0].shape == (500, 1)


def curve(height):
    at = np.linspace(-2.0, 2.0, 41)
    return Profile(at, at[:, None], height(at) - height(at).min())


@pytest.mark.parametrize(
    ("height", "best", "opens", "word"),
    [
        (lambda x: 2.0 * x**2, 0.0, (False, False), "bounded"),
        (lambda x: 0.05 * x**2, 0.0, (False, False), "flat"),
        (lambda x: 2.0 * x**2, 0.0, (True, True), "flat"),
        (lambda x: 2.0 * x**2, 0.0, (True, False), "one-sided"),
        (lambda x: 2.0 * x**2, 0.0, (False, True), "one-sided"),
        (lambda x: 2.0 * x**2, -3.0, (True, False), "at a bound"),
        (lambda x: 2.0 * x**2, -3.0, (True, True), "flat"),
        (lambda x: (x**2 - 1.0) ** 2 + 0.1 * x, -1.0, (False, False), "several minima"),
        # The ridge is higher than an interval's end, and of the other valley the floor alone lies below that.
        (lambda x: 12.0 * (x**2 - 1.0) ** 2 + 0.9 * (x + 1.0), -1.0, (False, False), "several minima"),
        (lambda x: 0.05 * (x**2 - 1.0) ** 2 + x**2, 0.0, (False, False), "bounded"),
    ],
)
def test_a_profile_gets_its_word(height, best, opens, word) -> None:
    assert profile_kind(curve(height), best, *opens, (-3.0, 3.0), 1.92) == word


def test_an_estimate_at_a_limit_has_its_word(column, clean) -> None:
    narrow = replace(column, limits=(float(np.log(0.35)), float(np.log(5.0))))
    likely = ended(narrow, clean)
    assert likely.kinds[0] == "at a bound"
    assert likely.low[0] == pytest.approx(np.log(0.35))
