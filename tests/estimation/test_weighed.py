"""The weighed fit: derivatives of its residuals, what shared errors cost, how its search ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest, multivariate_normal

from spinestiff.errors import EquilibriumError
from spinestiff.estimation import mode
from spinestiff.estimation.mode import search
from spinestiff.estimation.noise import TRACKED
from spinestiff.estimation.point import WeighedPoint
from spinestiff.estimation.priors import Priors
from spinestiff.estimation.profiles import rise_at
from spinestiff.estimation.sights import marked_anew
from spinestiff.estimation.status import FitStatus
from spinestiff.estimation.unknowns import ACTS
from spinestiff.estimation.weighed import WeighedFit, phi, reduced
from spinestiff.imaging.features import VertebraCorners
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.places import SupportPlace


@pytest.fixture(scope="module")
def found(column, asked):
    """Where phi is least: of the search itself."""
    return column.searched(asked)


def sd_of(found):
    model = reduced(found.point, found.slope, found.weights)
    return np.sqrt(np.diag(np.linalg.inv(model.ratios.T @ model.ratios)))


def logs(found):
    return found.point.log_ratios


def with_supports(trials, **supports):
    """Measured ones in the last frame."""
    return [*trials[:-1], replace(trials[-1], supports=supports)]


def displaced(trial, vertebra, by):
    """One vertebra's corners shifted by (2,) mm at the patient plane."""
    corners = trial.corners.corners.copy()
    corners[trial.corners.vertebrae.index(vertebra)] += trial.view.magnification * np.asarray(by)
    return replace(trial, corners=VertebraCorners(trial.corners.vertebrae, corners, trial.corners.quality))


def test_derivatives_in_ratios_and_all_unknowns_against_differences_of_whole_solves(column, noisy) -> None:
    """At ratios and unknowns that are not those at the start; together they reach all acts but that of ribs, which the
    column has none of (tests/estimation/test_evaluation.py)."""
    asked = column.weighed(with_supports(noisy, obliquity=(0.02, 0.005), shoulder=(-1.0, 0.4)))
    assert {unknown.act for unknown in asked.unknowns.each} == {*ACTS} - {"ribs"}
    m = len(asked.unknowns)
    here, nuisances = np.log([0.35, 0.3]), np.random.default_rng(0).normal(0.0, 0.7, m)
    point = asked.solve(here, nuisances)
    slope = asked.slope(point)
    for i in range(2 + m):
        step = 2e-3 * np.eye(2 + m)[i]
        ahead, behind = (asked.solve(here + s * step[:2], nuisances + s * step[2:], point).values for s in (1, -1))
        quotient = (ahead - behind) / 4e-3
        exact = slope.ratios[:, i] if i < 2 else slope.nuisances[:, i - 2]
        assert np.abs(quotient).max() > 1e-4
        assert np.allclose(exact, quotient, atol=2e-4 * np.abs(quotient).max()), i


def test_a_frame_without_force_is_seen_at_rest_whatever_the_ratios(asked) -> None:
    one, other = (asked.solve(np.log(ratios), np.zeros(len(asked.unknowns))) for ratios in ([1.0, 1.0], [0.3, 0.4]))
    still = asked.noise.of(2)
    assert np.array_equal(one.values[still], other.values[still])
    slope = asked.slope(other)
    assert not slope.ratios[still].any()
    assert not slope.nuisances[still].any()
    assert np.abs(one.values - other.values).max() > 1.0


def test_ratios_are_recovered_without_errors(column, clean) -> None:
    for truth, data in ((column.truth, clean), ({"lateral_bending": 1.5, "tissue": 0.7}, None)):
        found = column.searched(column.weighed(data or column.trials(truth)))
        assert found.status is FitStatus.CONVERGED
        assert np.allclose(logs(found), np.log(list(truth.values())), atol=0.02 * sd_of(found))
        assert np.abs(found.point.nuisances).max(initial=0.0) < 0.01


def test_errors_fall_where_standard_deviations_say(column) -> None:
    """Subjects with errors drawn from the priors: squared error over variance is 1 on average."""
    squares = []
    for seed in range(6):
        random = np.random.default_rng(seed)
        place = SupportPlace(np.deg2rad(3.0) * random.normal(), 3.0 * random.normal())
        places = [SupportPlace(share * place.obliquity, share * place.shoulder_mm) for share in (0.67, 1.67)]
        data = column.trials(
            annotation=0.3, tracking=0.12, places=places, gauge=1.0 + 0.02 * random.normal(), seed=100 + seed
        )
        found = column.searched(column.weighed(data))
        squares.append(((logs(found) - np.log(list(column.truth.values()))) / sd_of(found)) ** 2)
    # Chi-squared with about 12 degrees of freedom, smaller by what is known here and not to the fit.
    assert 0.1 < np.mean(squares) < 2.2


def test_tracking_that_is_taken_along_is_expected_in_all_frames_alike(column) -> None:
    """Vertebrae that follow the motion by some percent too much or too little, the same ones in both frames."""
    squares = {0.0: [], 0.1: []}
    for seed in range(6):
        share = 0.1 * np.random.default_rng(seed).normal(size=len(column.torso.vertebrae))
        data = column.trials(tracking=0.05, seed=200 + seed)
        for i, trial in enumerate(data[1:], start=1):
            moved = (trial.corners.corners - data[0].corners.corners).mean(1)[:, 0]
            size = np.sign(moved.sum()) * np.sqrt(np.mean(moved**2))
            wrong = trial.corners.corners + size * share[:, None, None] * [1.0, 0.0]
            corners = VertebraCorners(trial.corners.vertebrae, wrong, trial.corners.quality)
            data[i] = replace(trial, corners=corners)
        for drag, found in squares.items():
            fit = column.searched(column.weighed(data, Priors(tracking_drag=drag)))
            found.append(((logs(fit) - np.log(list(column.truth.values()))) / sd_of(fit)) ** 2)
    assert np.mean(squares[0.1]) < 2.0 < 3.0 < np.mean(squares[0.0])


def test_a_loaded_frame_marked_by_hand_errs_anew(column, noisy) -> None:
    """Its annotation is no more the unloaded frame's; tracking adds nothing."""
    by_hand = [*noisy[:-1], replace(noisy[-1], annotated=True)]
    noise = column.weighed(by_hand).noise
    marked = noise.parts["marks set by hand"]
    last = next(i for i, one in enumerate(noise.seen) if one.target.trial.label == noisy[-1].label)
    wanted = np.zeros(noise.size)
    wanted[noise.of(last)] = Priors().marking_mm ** 2
    assert np.allclose(marked, np.diag(wanted))
    assert not noise.tracking()[noise.of(last)].any()
    assert "marks set by hand" not in column.weighed(noisy).noise.parts


def followed(trials, marked, **sources):
    """Trials of which those ``marked`` were set by hand, others followed from the one that ``sources`` say."""
    return [
        replace(
            trial,
            annotated=i in marked,
            followed_from="" if i in marked else trials[sources.get(f"of{i}", marked[0])].label,
        )
        for i, trial in enumerate(trials)
    ]


def test_what_is_followed_from_a_second_mark_shares_its_error(column) -> None:
    """The frame of 40 N is marked by hand once more, that of 70 N followed from it, and that of 100 N from rest."""
    trials = followed(column.trials(forces=(40.0, 70.0, 100.0)), (0, 1), of2=1)
    assert marked_anew(trials, ["push 1"] * 4) == (None, 1, 1, None)
    asked = column.weighed(trials)
    part, sd = asked.noise.parts["marks set by hand"], Priors().marking_mm
    # The loaded ones come first.
    first, second, other, rest = (asked.noise.of(i) for i in range(4))
    ones = np.eye(first.stop - first.start)
    for a, b in ((first, first), (first, second), (second, second)):
        np.testing.assert_allclose(part[a, b], sd**2 * ones)
    assert not part[:, other].any() and not part[:, rest].any()


def test_the_first_mark_of_a_sequence_is_its_annotation(column) -> None:
    trials = column.trials(forces=(40.0, 70.0))
    sequences = ["push 1"] * 3
    assert marked_anew(trials, sequences) == (None, None, None)
    # A loaded frame alone, marked first though another one has no load; one whose marked frame is not here.
    assert marked_anew(followed(trials, (1,)), sequences) == (None, None, None)
    gone = [replace(trial, annotated=False, followed_from="push 1 frame 9") for trial in trials]
    assert marked_anew(gone, sequences) == (None, None, None)
    assert marked_anew([trials[0], *gone[1:]], sequences) == (None, 4, 4)
    # Another push's are by themselves.
    assert marked_anew(followed(trials, (0, 2)), ["push 1", "push 1", "push 2"]) == (None, None, None)


def test_two_unloaded_frames_may_be_marked_by_hand(column, noisy) -> None:
    """Before and after the push: what differs between them is the hand."""
    trials = [*noisy, replace(noisy[0], label="after")]
    asked = column.weighed(trials)
    found = column.searched(asked)
    assert found.status is FitStatus.CONVERGED
    assert np.abs(found.point.log_ratios - np.log([0.3, 0.4])).max() < 0.5


def test_what_nothing_holds_is_not_measured_against_a_place(column, noisy) -> None:
    """A hinged pelvis turns as the forces have it."""
    supports = column.problem.supports
    held = supports.held.copy()
    held[column.torso.bone("pelvis"), 5] = False
    hinged = replace(column, problem=EquilibriumProblem(column.torso, replace(supports, held=held)))
    measured = with_supports(noisy, obliquity=(np.deg2rad(-3.0), np.deg2rad(0.3)))
    asked = hinged.weighed(measured, replace(Priors(), obliquity_deg=0.0, frame_obliquity_deg=0.0))
    assert asked.size == hinged.weighed(noisy).size
    # Where it is held, a place that it can't have is a contradiction.
    level = column.weighed(measured, replace(Priors(), obliquity_deg=0.0, frame_obliquity_deg=0.0))
    assert level.size > column.weighed(noisy).size


def test_the_first_of_two_searches_need_not_end_close(column, asked, found, monkeypatch) -> None:
    """The second one goes a few tenths of a standard deviation farther, wherever the first one ended."""

    def evaluations(near: float) -> tuple[WeighedFit, int]:
        monkeypatch.setattr(mode, "ROUGHLY_SD", near)
        before = len(asked.trial_set.history)
        return column.estimated(asked), len(asked.trial_set.history) - before

    (ended, few), (closer, more) = evaluations(mode.ROUGHLY_SD), evaluations(mode.CLOSE_SD)
    assert few < more
    assert max(ended.short, closer.short) < mode.CLOSE_SD
    assert (np.abs(logs(ended) - logs(closer)) < 0.01 * sd_of(found)).all()


def test_short_steps_are_taken_until_little_is_left(asked, found, monkeypatch) -> None:
    monkeypatch.setattr(mode, "_mixed", lambda trail, *args: 0.1 * trail[-1][1])
    start = asked.solve(found.point.log_ratios + 0.3, found.point.nuisances, found.point)
    again = search(asked, start, 100)
    assert again.status is FitStatus.CONVERGED
    # Each step goes a tenth of the way, also where little is left of it.
    assert again.short < np.sqrt(2.0 * mode.NEARLY)


def test_a_search_that_goes_to_and_fro_ends_and_tells_how_near_it_is(asked, found, monkeypatch) -> None:
    """Each side's weights promise the same little of the other one, and phi is less there, as where equilibria jump."""
    step = 0.1 * sd_of(found)
    ways, sinking = (sign * step for _ in range(50) for sign in (1.0, -1.0)), iter(np.arange(1000.0, 0.0, -1.0))
    monkeypatch.setattr(mode, "gauss_newton_step", lambda point, *args: (next(ways), point.nuisances, 0.005))
    monkeypatch.setattr(mode, "phi", lambda *args: next(sinking))
    monkeypatch.setattr(mode, "_mixed", lambda *args: None)
    ended = search(asked, found.point, 40)
    assert ended.status is FitStatus.CONVERGED
    assert ended.short == pytest.approx(0.1)
    assert len(ended.visited) == mode.MOST_WANDERED + 1


def test_a_common_scale_of_stiffness_is_never_known_better_than_the_force(column, known_exactly) -> None:
    """Two pushes with a calibration each know it by the root of two better, one push with two frames does not."""
    priors = replace(known_exactly, force_scale=0.3)
    one = column.trials()
    two = [*column.trials(forces=(40.0,)), *column.trials(forces=(40.0,), bones=(5, 6), push="push 2")]
    for data, pushes in ((one, 1), (two, 2)):
        found = column.searched(column.weighed(data, priors, ("everything",)), (1.0,))
        assert sd_of(found)[0] >= 0.999 * 0.3 / np.sqrt(pushes)
        assert sd_of(found)[0] < 0.4 / np.sqrt(pushes)
    # An offset of 6 N is 15 % of the one frame's 40 N.
    asked = column.weighed(two[:2], replace(known_exactly, force_scale=0.2, force_offset_n=6.0), ("everything",))
    assert sd_of(column.searched(asked, (1.0,)))[0] >= 0.25


def test_an_annotation_error_that_all_frames_share_moves_next_to_nothing(column, clean) -> None:
    before = column.searched(column.weighed(clean))
    everywhere = [displaced(trial, "L1", (0.6, 0.0)) for trial in clean]
    alone = [*clean[:2], displaced(clean[2], "L1", (0.6, 0.0))]
    moved = [
        np.abs(logs(column.searched(column.weighed(data))) - logs(before)) / sd_of(before)
        for data in (everywhere, alone)
    ]
    assert moved[0].max() < 0.03
    assert moved[1].max() > 5.0 * moved[0].max()


def obliquity_of(asked, found):
    """Of the last frame: estimate and standard deviation, rad."""
    row = asked.unknowns.acts[-1, ACTS.index("obliquity")]
    columns = found.weights.whiten(np.column_stack([found.slope.nuisances, found.slope.ratios]))
    prior = np.diag(np.r_[np.ones(len(row)), 0.0, 0.0])
    covariance = np.linalg.inv(columns.T @ columns + prior)[: len(row), : len(row)]
    return row @ found.point.nuisances, float(np.sqrt(row @ covariance @ row))


def test_measured_supports_pull_as_their_standard_deviation_says(column, asked, found, noisy) -> None:
    before, sd = obliquity_of(asked, found)
    measured = before + 0.5 * sd
    for own in (1e-3 * sd, sd, 2.0 * sd, 1e3 * sd):
        other = column.weighed(with_supports(noisy, obliquity=(measured, own)))
        after, left = obliquity_of(other, column.searched(other))
        share = sd**2 / (sd**2 + own**2)
        assert (after - before) / (measured - before) == pytest.approx(share, abs=0.1)
        assert left == pytest.approx(sd * np.sqrt(1.0 - share), abs=0.06 * sd)


def test_what_is_known_exactly_is_no_unknown_and_the_fit_goes_on(column, clean, known_exactly) -> None:
    asked = column.weighed(clean, known_exactly)
    assert len(asked.unknowns) == 0
    found = column.searched(asked)
    assert found.status is FitStatus.CONVERGED
    assert np.exp(logs(found)) == pytest.approx(list(column.truth.values()), rel=1e-3)


def test_a_grossly_wrong_vertebra_is_inflated_and_hardly_moves_the_estimate(column, noisy, asked, found) -> None:
    wrong = [*noisy[:2], displaced(noisy[2], "T12", (6.0, -4.0))]
    other = column.weighed(wrong)
    after = column.searched(other)
    inflation = after.weights.inflation.reshape(-1, 3)[:, 0]
    names = [(i, name) for i in range(3) for name in other.noise.seen[i].target.trial.corners.vertebrae]
    assert {name for name, size in zip(names, inflation) if size > 2.0} == {(1, "T12")}
    assert inflation.max() > 50.0
    assert (found.weights.inflation < 2.0).all()
    assert (np.abs(logs(after) - logs(found)) < 0.5 * sd_of(found)).all()
    assert asked.noise.size == other.noise.size


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_the_size_of_tracking_errors_is_found_from_the_fits_residuals(column, factor) -> None:
    """Corners with errors of ``factor`` times what their quality says."""
    priors = Priors(tracking_mm=0.05, tracking_shared_mm=0.0)
    # Alike in all channels, which are told to differ: the mean of their precisions counts.
    size = 0.1 * np.sqrt(0.5 / np.mean(TRACKED**-2))
    data = [column.trials(tracking=factor * size, seed=seed) for seed in range(4)]
    found = [column.searched(column.weighed(trials, priors)).weights.tracking_factor for trials in data]
    # About 40 free channels in each.
    assert np.exp(np.mean(np.log(found))) == pytest.approx(factor, rel=0.15)


def simulated(asked, point, slope, random):
    """Values of channels as the covariance before any scale is fitted has them, and any ratios' motion."""
    n = asked.noise.size
    covariance = (
        asked.noise.constant + asked.moving.discrepancy(point) + asked.moving.drag(point) + asked.noise.tracking()
    )
    seen = np.linalg.cholesky(covariance + 1e-9 * np.eye(n)) @ random.normal(size=n)
    return seen + slope.nuisances @ random.normal(size=slope.nuisances.shape[1]) + slope.ratios @ random.normal(size=2)


def test_p_value_is_uniform_for_errors_as_expected(asked, found) -> None:
    random = np.random.default_rng(5)
    nothing = np.zeros(len(asked.unknowns))
    points = [
        WeighedPoint(nothing, found.point.evaluation, simulated(asked, found.point, found.slope, random))
        for _ in range(150)
    ]
    values = [asked.p_value(point, found.slope) for point in points]
    assert kstest(values, "uniform").pvalue > 0.01


def test_p_value_does_not_count_what_a_sequence_was_placed_by(asked, found) -> None:
    """Shift and turn of a sequence are fitted before the estimate: their wide prior makes no residual likely."""
    random = np.random.default_rng(6)
    placed = np.zeros((asked.size, asked.noise.placed.shape[1]))
    placed[: asked.noise.size] = asked.noise.placed
    assert placed.shape[1] == 3
    nothing = np.zeros(len(asked.unknowns))
    root = np.linalg.cholesky(asked.covariance(found.point))
    seen = [root @ random.normal(size=asked.size) for _ in range(3)]
    first, *moved = (
        [asked.p_value(WeighedPoint(nothing, found.point.evaluation, one + placed @ size), found.slope) for one in seen]
        for size in (np.zeros(3), np.array([30.0, -20.0, 0.05]), np.array([0.0, 0.0, 0.2]))
    )
    for again in moved:
        np.testing.assert_allclose(again, first, rtol=1e-6)
    still = [one - placed @ np.linalg.lstsq(placed, one, rcond=None)[0] for one in seen]
    without = [asked.p_value(WeighedPoint(nothing, found.point.evaluation, one), found.slope) for one in still]
    np.testing.assert_allclose(without, first, rtol=1e-6)


def test_p_value_is_tiny_where_forces_are_swapped(column, noisy, asked, found) -> None:
    assert asked.p_value(found.point, found.slope) > 0.05
    rest, weak, strong = noisy
    swapped = [rest, replace(weak, load=strong.load), replace(strong, load=weak.load)]
    other = column.weighed(swapped)
    after = column.searched(other)
    assert other.p_value(after.point, after.slope) < 1e-6


def test_any_start_ends_at_the_same_place(column, asked, found) -> None:
    """The weights differ in their seventh digit; phi is compared by one fit's."""
    for start in ((0.02, 0.02), (5.0, 5.0), (0.02, 5.0), (5.0, 0.02), (0.3, 0.4)):
        other = column.searched(asked, start)
        assert other.status is FitStatus.CONVERGED
        assert phi(other.point, found.weights) == pytest.approx(phi(found.point, found.weights), abs=1e-6)
        assert (np.abs(logs(other) - logs(found)) < 0.01 * sd_of(found)).all()


def test_psi_is_that_of_nuisances_integrated_out(column, noisy, known_exactly) -> None:
    """Of one nuisance, against a sum over its normal quadrature's places, each with its own equilibrium."""
    asked = column.weighed(noisy, replace(known_exactly, force_scale=0.2))
    found = column.estimated(asked)
    places, shares = np.polynomial.hermite_e.hermegauss(9)
    told, summed = [], []
    for shift in ([0.0, 0.0], [-0.5, 0.2]):
        where = logs(found) + shift
        point = asked.solve(where, np.zeros(1), found.point, found.slope)
        for _ in range(2):
            model = reduced(point, asked.slope(point), found.weights)
            point = asked.solve(where, model.nuisances, point)
        slope = asked.slope(point)
        told.append(reduced(point, slope, found.weights).psi)
        sd = float(np.exp(-reduced(point, slope, found.weights).log_precision))
        heights = [phi(asked.solve(where, point.nuisances + sd * x, point), found.weights) for x in places]
        summed.append(-np.log(sd * np.sum(shares * np.exp(0.5 * places**2 - np.array(heights)))))
    assert told[1] - told[0] == pytest.approx(summed[1] - summed[0], abs=0.003)
    # What the most probable nuisance alone says is off by more.
    precisions = told[1] - told[0] - (min_phi(asked, found, [-0.5, 0.2]) - min_phi(asked, found, [0.0, 0.0]))
    assert abs(precisions) > 0.03


def min_phi(asked, found, shift):
    """phi at the most probable nuisances beside the estimate."""
    point = asked.solve(logs(found) + shift, found.point.nuisances, found.point, found.slope)
    for _ in range(2):
        point = asked.solve(point.log_ratios, reduced(point, asked.slope(point), found.weights).nuisances, point)
    return phi(point, found.weights)


def test_the_estimate_is_where_psi_is_least(column, asked, found) -> None:
    """On the model, a tenth of a standard deviation to all sides; phi alone falls towards where it was least."""
    estimate, rises = column.estimated(asked), []
    sd = sd_of(found)
    for i, sign in ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)):
        where = logs(estimate) + 0.1 * sign * sd[i] * np.eye(2)[i]
        rises.append(rise_at(asked, estimate, where))
    assert min(rises) > 0.0
    # One step of differences of 0.25 in log ratio tells the slope of the log determinant to some percent.
    for above, below in (rises[:2], rises[2:]):
        assert abs(above - below) < 0.5 * (above + below)
    assert phi(found.point, estimate.weights) < phi(estimate.point, estimate.weights) - 1e-3
    assert estimate.tilt is not None and found.tilt is None


def test_a_known_tilt_is_followed_from_the_start(column, asked) -> None:
    """As on a finer mesh: no place beside the end is solved for."""
    estimate = column.estimated(asked)
    start = asked.solve(estimate.point.log_ratios, estimate.point.nuisances, estimate.point)
    again = mode.likeliest(asked, start, 50, tilt=estimate.tilt)
    assert (np.abs(logs(again) - logs(estimate)) < 0.01 * sd_of(estimate)).all()
    assert len(again.visited) < 3


def test_a_tilt_that_does_not_settle_is_told(asked, found, monkeypatch) -> None:
    monkeypatch.setattr(mode, "CHANGED_SD", 0.0)
    monkeypatch.setattr(mode, "MOST_TILTS", 1)
    start = asked.solve(logs(found), found.point.nuisances, found.point)
    ended = mode.likeliest(asked, start, 50)
    assert ended.status is FitStatus.CONVERGED
    assert ended.carried > 0.05 > ended.short


def test_beside_a_limit_the_tilt_is_told_from_inside(column, noisy) -> None:
    limits = (column.limits[0], float(np.log(0.3)))
    asked = replace(column, limits=limits).weighed(noisy)
    first = asked.solve(np.log([0.3, 0.3]), np.zeros(len(asked.unknowns)))
    ended = mode.likeliest(asked, first, 50)
    assert all((place.log_ratios <= limits[1] + 1e-12).all() for place, _ in ended.visited)
    assert ended.tilt is not None and (np.abs(ended.tilt.slopes(logs(ended)[None])) > 0.05).any()


def test_nuisances_are_eliminated_as_a_covariance_would(asked, found) -> None:
    """Least squares over nuisances with priors equals generalised least squares with their covariance added."""
    model = reduced(found.point, found.slope, found.weights)
    root = found.weights.root
    covariance = root @ root.T + found.slope.nuisances @ found.slope.nuisances.T
    free = found.point.values - found.slope.nuisances @ found.point.nuisances
    wanted = found.slope.ratios.T @ np.linalg.solve(covariance, np.column_stack([found.slope.ratios, free]))
    assert np.allclose(model.ratios.T @ np.column_stack([model.ratios, model.values]), wanted, rtol=1e-6, atol=1e-6)
    moved = free + found.slope.ratios @ [0.1, -0.2]
    columns = np.vstack([found.weights.whiten(found.slope.nuisances), np.eye(len(asked.unknowns))])
    best = np.linalg.lstsq(columns, -np.r_[found.weights.whiten(moved), np.zeros(len(asked.unknowns))], rcond=None)[0]
    assert np.allclose(model.nuisances + model.follow @ [0.1, -0.2], best, atol=1e-9)


def test_a_search_that_runs_out_of_evaluations_has_not_converged(column, asked) -> None:
    for limit in (1, 2):
        ended = column.searched(asked, max_evaluations=limit)
        assert ended.status is FitStatus.ITERATION_LIMIT
        assert not ended.status.usable


def test_a_search_among_failing_equilibria_stalls(column, noisy, brittle) -> None:
    """Above the minimum nothing fails, below it all: the last step has nowhere to go."""
    own = replace(column, problem=brittle(0.37))
    ended = own.searched(own.weighed(column.trials({"lateral_bending": 0.2, "tissue": 0.2})))
    assert ended.status is FitStatus.STALLED
    assert np.exp(logs(ended))[0] >= 0.37


@pytest.fixture
def jumping(asked, found, monkeypatch):
    """Where any step from beside the minimum goes, phi is larger by 1: as where a crease appears."""

    def solve(*args, real=asked.solve, **kwargs):
        point = real(*args, **kwargs)
        return replace(point, values=point.values + 0.5 * np.sign(point.values))

    def begun(sds: float) -> WeighedFit:
        start = asked.solve(logs(found) + sds * sd_of(found) * [1.0, 0.0], found.point.nuisances, found.point)
        monkeypatch.setattr(asked, "solve", solve)
        return mode.search(asked, start, 50)

    return begun


def test_a_search_beside_a_jump_settles_where_little_is_left_to_gain(jumping) -> None:
    ended = jumping(0.02)
    assert ended.status is FitStatus.CONVERGED
    assert 0.0 < ended.short < 0.1
    assert len(ended.visited) == 1


def test_a_search_beside_a_jump_ends_within_a_quarter_of_an_sd_once_all_was_tried(jumping) -> None:
    ended = jumping(0.07)
    assert ended.status is FitStatus.CONVERGED
    assert 0.1 < ended.short < 0.25
    # The emulator's places, and steps down to the shortest.
    assert len(ended.visited) > 1


def test_a_search_where_phi_is_rough_ends_and_tells_how_near_it_is(asked, found, monkeypatch) -> None:
    """Small jumps all over the place: steps that promise much are refused at every length."""

    def solve(log_ratios, *args, real=asked.solve, **kwargs):
        point = real(log_ratios, *args, **kwargs)
        rough = 0.004 * (1.0 + np.round(np.sin(30.0 * log_ratios)).sum())
        return replace(point, values=point.values + rough * np.sign(point.values))

    start = asked.solve(logs(found) + 2.0 * sd_of(found), found.point.nuisances, found.point)
    monkeypatch.setattr(asked, "solve", solve)
    ended = mode.search(asked, start, 50)
    assert ended.status is FitStatus.CONVERGED
    assert 0.12 < ended.short < 1.0
    assert (np.abs(logs(ended) - logs(found)) < 0.5 * ended.short * sd_of(found)).all()


def test_a_search_where_slopes_are_rough_ends_once_enough_was_refused(asked, found, monkeypatch) -> None:
    """Each promises a little that there is not: many steps are refused, and short ones lead nowhere."""

    def places(seed: int, most: int) -> int:
        random, real = np.random.default_rng(seed), asked.slope

        def slope(point):
            found = real(point)
            wrong = 0.01 * np.outer(point.values, random.uniform(-1.0, 1.0, size=2))
            return replace(found, ratios=found.ratios + wrong)

        with monkeypatch.context() as patch:
            patch.setattr(asked, "slope", slope)
            patch.setattr(mode, "MOST_REFUSED", most)
            ended = mode.search(asked, start, 80)
        assert ended.status is FitStatus.CONVERGED
        assert ended.short < 0.25
        assert (np.abs(logs(ended) - logs(found)) < 0.08 * sd_of(found)).all()
        return len(ended.visited)

    start = asked.solve(logs(found) + sd_of(found), found.point.nuisances, found.point)
    longer, ended = (sum(places(seed, most) for seed in (1, 2, 3, 5)) for most in (mode.MOST_REFUSED, 1))
    assert longer > 1.4 * ended


def test_a_search_beside_a_jump_stalls_where_much_is_left_to_gain(jumping) -> None:
    ended = jumping(1.0)
    assert ended.status is FitStatus.STALLED
    assert ended.short > 0.1


def test_a_place_without_equilibrium_is_not_tried_again(column, asked, monkeypatch) -> None:
    """The emulator leads to it after a step was refused; the search goes on with a shorter one."""
    nowhere, tried = np.log([0.011, 0.012]), []

    def solve(log_ratios, *args, real=asked.solve, **kwargs):
        tried.append(tuple(log_ratios))
        if np.array_equal(log_ratios, nowhere):
            raise EquilibriumError("it folds")
        point = real(log_ratios, *args, **kwargs)
        # The first step is refused.
        return replace(point, values=10.0 * point.values) if len(tried) == 2 else point

    monkeypatch.setattr(asked, "solve", solve)
    monkeypatch.setattr(mode, "_guided", lambda places, weights, limits, tilt: (nowhere, places[0].point.nuisances))
    ended = column.searched(asked)
    assert tried.count(tuple(nowhere)) == 1
    assert ended.status is FitStatus.CONVERGED


def test_a_ratio_outside_the_limits_ends_at_them(column, clean) -> None:
    narrow = replace(column, limits=(np.log(0.5), np.log(5.0)))
    ended = narrow.searched(narrow.weighed(clean))
    assert ended.status is FitStatus.CONVERGED
    assert logs(ended).min() == pytest.approx(np.log(0.5), abs=1e-9)


def test_small_steps_are_mixed_with_those_before(found) -> None:
    """Steps that fall short or swing, by a factor of their own along each direction, end where they would vanish.

    A step that grows leads away from there, and goes far; so does one that creeps.
    """
    count = found.slope.ratios.shape[1] + found.slope.nuisances.shape[1]
    random = np.random.default_rng(0)

    for factor, wanted in ((-0.1, mode.MOST_SHARE), (0.01, mode.MOST_SHARE), (0.25, 4.0), (1.5, 1.0 / 1.5)):
        before = random.normal(size=count)
        trail = [(np.zeros(count), before), (before, (1.0 - factor) * before)]
        assert np.allclose(mode._mixed(trail, found.slope, found.weights), wanted * trail[1][1]), factor
    for factors in ([0.5, 1.5], [0.3, 0.8, 1.6]):
        directions = random.normal(size=(count, len(factors)))
        left, trail, place = np.ones(len(factors)), [], np.zeros(count)
        for _ in range(1 + len(factors)):
            trail.append((place, directions @ (factors * left)))
            place, left = place + trail[-1][1], (1.0 - np.array(factors)) * left
        end = directions @ np.ones(len(factors))
        assert np.allclose(trail[-1][0] + mode._mixed(trail, found.slope, found.weights), end, atol=1e-6), factors


def test_the_likelihood_is_that_of_the_residuals_with_unknowns_integrated_out(asked, found) -> None:
    point, slope = found.point, found.slope
    free = point.values - slope.nuisances @ point.nuisances
    covariance = found.weights.root @ found.weights.root.T + slope.nuisances @ slope.nuisances.T
    expected = multivariate_normal(cov=covariance, allow_singular=False).logpdf(free)
    assert asked.log_likelihood(point, slope, found.weights) == pytest.approx(expected, rel=1e-9)
