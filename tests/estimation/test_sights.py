"""Radiographs from other sides, and pedicles, in the same fit: derivatives, errors, and axial rotation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.state import retract
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import FitError, TrackingError
from spinestiff.estimation.budget import covariance_parts
from spinestiff.estimation.channels import CHANNELS
from spinestiff.estimation.design import design_at
from spinestiff.estimation.discrepancy import (
    OUT_OF_PLANE_SD,
    TURN_ARM_MM,
    DiscrepancyFrame,
    motion_size,
    out_of_plane_columns,
)
from spinestiff.estimation.discrepancy_data import shipped_modes
from spinestiff.estimation.evaluation import TrialSet
from spinestiff.estimation.forecast import forecast
from spinestiff.estimation.known import Known
from spinestiff.estimation.objective import Picture, Trial, make_target
from spinestiff.estimation.priors import Priors
from spinestiff.estimation.sights import PedicleTarget, further_sights, sight_residuals
from spinestiff.estimation.weighed import WeighedProblem, reduced
from spinestiff.imaging.features import VertebraCorners, silhouette_shares, state_features
from spinestiff.imaging.pedicles import PediclePoints
from spinestiff.imaging.projection import frontal_view, lateral_view
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.personalise.pose import posed

LATERAL = lateral_view(centre=(0, 150, 0))
OBLIQUE = posed(frontal_view(centre=(0, 150, 0)), np.zeros(2), 0.0, np.deg2rad(35.0))
TRUTH = {"lateral_bending": 0.3, "tissue": 0.4, "axial_rotation": 0.6}
NAMES = tuple(TRUTH)


def state_of(column, trial, truth):
    if not trial.load.size:
        return column.torso.rest_pose
    return column.problem.solve(trial.load, column.ratios(truth)).require().state


def seen_more(column, trials, views=(LATERAL,), pedicles=True, truth=TRUTH):
    """The same trials with further radiographs and pedicles."""
    found = []
    for trial in trials:
        state = state_of(column, trial, truth)
        further = tuple(
            column.picture(state, view, f"{trial.label} view {i}", f"{trial.push} view {i}", pedicles)
            for i, view in enumerate(views)
        )
        found.append(replace(trial, further=further, pedicles=column.pedicles(state) if pedicles else None))
    return found


@pytest.fixture(scope="module")
def twisted(column):
    """Frontal radiographs of a spine that turns about its axis easily."""
    return column.trials(TRUTH)


@pytest.fixture(scope="module")
def both(column, twisted):
    return seen_more(column, twisted)


@pytest.fixture(scope="module")
def asked_more(column, both):
    return column.weighed(both, names=NAMES)


def sd_of(found):
    model = reduced(found.point, found.slope, found.weights)
    return np.sqrt(np.diag(np.linalg.inv(model.ratios.T @ model.ratios)))


@pytest.mark.parametrize("view", [frontal_view(centre=(0, 150, 0)), LATERAL, OBLIQUE], ids=["front", "side", "oblique"])
def test_pedicles_move_as_their_derivative_says(column, twisted, view) -> None:
    random = np.random.default_rng(1)
    marked = replace(twisted[0], view=view, further=(), pedicles=column.pedicles(column.torso.rest_pose, view))
    corners = column.corners(column.torso.rest_pose, view)
    marked = replace(marked, corners=VertebraCorners(column.torso.vertebrae, corners))
    (one,) = further_sights([column.torso], [make_target(column.torso, marked)], "procrustes")
    assert isinstance(one.target, PedicleTarget)
    assert np.abs(sight_residuals(column.torso, one.target, column.torso.rest_pose).difference).max() < 1e-9
    start = retract(column.torso.rest_pose, 0.05 * random.normal(size=column.torso.rest_pose.dofs))
    step = random.normal(size=column.torso.rest_pose.dofs)
    ahead, behind = (
        sight_residuals(column.torso, one.target, retract(start, sign * 1e-4 * step)).difference for sign in (1, -1)
    )
    quotient = (ahead - behind) / 2e-4
    exact = sight_residuals(column.torso, one.target, start).moved(step[:, None])[..., 0]
    assert np.abs(quotient).max() > 0.5
    assert np.allclose(exact, quotient, atol=1e-6)


def test_derivatives_of_all_that_is_seen_against_differences_of_whole_solves(column, both) -> None:
    """A frontal, a lateral and an oblique radiograph, with pedicles, in all ratios and unknowns."""
    asked = column.weighed(seen_more(column, [replace(t, further=()) for t in both], (LATERAL, OBLIQUE)), names=NAMES)
    m, p = len(asked.unknowns), len(NAMES)
    here, nuisances = np.log([0.35, 0.3, 0.5]), np.random.default_rng(0).normal(0.0, 0.7, m)
    point = asked.solve(here, nuisances)
    slope = asked.slope(point)
    more = np.concatenate([asked.further_rows(i) for i in range(2)])
    # Of both loaded trials nine vertebrae's pedicles, and twice their corners and pedicles.
    assert len(more) == 2 * 9 * (4 + 2 * (3 + 4))
    for i in range(p + m):
        step = 2e-3 * np.eye(p + m)[i]
        ahead, behind = (asked.solve(here + s * step[:p], nuisances + s * step[p:], point).values for s in (1, -1))
        quotient = (ahead - behind) / 4e-3
        exact = slope.ratios[:, i] if i < p else slope.nuisances[:, i - p]
        assert np.abs(quotient[more]).max() > 1e-5
        assert np.allclose(exact, quotient, atol=2e-4 * np.abs(quotient).max()), i


def test_pedicles_of_a_trial_without_names_are_of_its_own_radiograph(column, twisted) -> None:
    marked = column.pedicles(column.torso.rest_pose)
    asked = column.weighed([replace(trial, label="", push="", pedicles=marked) for trial in twisted], names=NAMES)
    assert [one.sequence for one in asked.noise.seen] == 2 * [f"trial {i + 1}" for i in range(len(twisted))]


def test_one_equilibrium_a_trial_whatever_it_shows(column, twisted, both) -> None:
    costs = []
    for trials in (twisted, both):
        asked = column.weighed(trials, names=NAMES)
        asked.solve(np.zeros(3), np.zeros(len(asked.unknowns)))
        costs.append(asked.trial_set.cost.equilibria)
    assert costs == [2, 2]


def test_without_errors_all_is_met_at_the_truth_and_nothing_moves_without_load(column, asked_more) -> None:
    point = asked_more.solve(np.log(list(TRUTH.values())), np.zeros(len(asked_more.unknowns)))
    assert np.abs(point.values[: asked_more.noise.size]).max() < 1e-6
    other = asked_more.solve(np.zeros(3), np.zeros(len(asked_more.unknowns)))
    still = [asked_more.noise.of(2), asked_more.further_rows(2)]
    assert all(np.array_equal(point.values[rows], other.values[rows]) for rows in still)
    assert np.abs(other.values[asked_more.further_rows(1)]).max() > 0.3


def test_what_more_is_seen_tells_of_axial_rotation_and_the_truth_is_found(column, twisted, both) -> None:
    """In one covariance; where the push, marks and stance are known well enough for a turn of 3 degrees."""
    sharp = Priors(push_depth_mm=1.0, direction_deg=0.3, place_yaw_deg=0.1, pedicle_mm=0.1, marking_mm=0.1)
    asked = column.weighed(both, sharp, names=NAMES)
    found = column.searched(asked, (1.0, 1.0, 1.0))
    assert np.allclose(found.point.log_ratios, np.log(list(TRUTH.values())), atol=0.05 * sd_of(found))
    design = design_at(asked, found.point, found.slope)
    own = [np.arange(asked.size)[asked.noise.of(i)] for i in range(3)]
    frontal = replace(design, rows=tuple(own)).ratio_sds([0, 1, 2])
    every = design.ratio_sds(range(6))
    assert every[2] < 0.85 * frontal[2]
    assert (every <= frontal).all()


def test_errors_of_marks_are_each_their_own_and_pedicles_lie_where_they_lie(column, asked_more) -> None:
    noise, p = asked_more.noise, Priors()
    marks, places = noise.parts["marks set by hand"], noise.parts["pedicles' places"]
    assert np.array_equal(marks, np.diag(np.diag(marks)))
    main = slice(0, int(noise.ends[asked_more.trials]))
    assert not marks[main, main].any()
    # Loaded 1: pedicles, lateral corners, lateral pedicles; then the next trials'.
    first, corners, second = (noise.of(asked_more.trials + i) for i in range(3))
    later = noise.of(asked_more.trials + 3)
    assert np.allclose(np.diag(marks)[first], p.pedicle_mm**2)
    assert np.allclose(np.diag(marks)[corners], p.marking_mm**2)
    # The same pedicle in two frames errs alike; left and right are moved outwards together by the person's part alone.
    assert np.allclose(places[first, later], places[first, first], rtol=1e-6)
    # Behind the patient plane pictures are smaller, and what lies off the middle moves with its depth.
    assert places[first, first][0, 0] == pytest.approx(p.pedicles_mm**2 + p.own_pedicle_mm**2, rel=0.05)
    assert places[first, first][0, 2] == pytest.approx(-(p.pedicles_mm**2), rel=0.05)
    assert not places[corners].any()
    assert places[first, second].any()


def test_corners_that_tracking_followed_keep_the_error_of_the_marks_they_came_from(column, both) -> None:
    """And have tracking's own beside; whether the marked radiograph is among these or not."""
    p, count = Priors(), 4 * len(column.torso.vertebrae) * 3 // 4
    rest = both[2].further[0] if not both[2].load.size else both[0].further[0]
    loaded = [trial for trial in both if trial.load.size]
    still = [trial for trial in both if not trial.load.size]
    quality = np.full((9, 4), 0.9)

    def as_followed(trial, start):
        (picture,) = trial.further
        corners = replace(picture.corners, quality=quality)
        return replace(trial, further=(replace(picture, corners=corners, followed_from=start, pedicles=None),))

    for others, start in ((still, still[0].further[0].label), ([replace(still[0], further=())], "another one")):
        asked = column.weighed([*others, *(as_followed(trial, start) for trial in loaded)], names=NAMES)
        marks = asked.noise.parts["marks set by hand"]
        seen = {
            one.target.trial.label: asked.noise.of(i)
            for i, one in enumerate(asked.noise.seen)
            if one.marked is not None and one.sequence == rest.sequence and not isinstance(one.target, PedicleTarget)
        }
        first, second = (seen[trial.further[0].label] for trial in loaded)
        assert first.stop - first.start == count
        assert np.allclose(marks[first, second], p.marking_mm**2 * np.eye(count))
        own = np.diag(asked.noise.tracking())[first]
        assert (own > p.tracking_mm**2).all()
        assert not asked.noise.tracking()[first, second].any()
        # Taken along in all frames alike, but not as in the frontal radiographs.
        drag = asked.noise.drag(np.ones(len(asked.noise.seen)))
        assert drag[first, second].any() and not drag[asked.noise.of(0), first].any()
        if start != "another one":
            base = seen[start]
            assert np.allclose(marks[base, second], p.marking_mm**2 * np.eye(count))
            assert not asked.noise.tracking()[base, base].any()


def test_a_patient_who_turns_moves_pedicles_against_corners(column, both) -> None:
    p = Priors(stance_yaw_deg=3.0, place_yaw_deg=2.0)
    asked_more = column.weighed(both, p, names=NAMES)
    noise = asked_more.noise
    turn = noise.parts["turn of the patient"]
    seen, shown = noise.of(0), noise.of(asked_more.trials)
    column_of = turn[shown, shown][:, 0]
    # All pedicles lie 18 mm behind the middle of the body.
    assert np.ptp(column_of[::2]) < 0.1 * np.abs(column_of[::2]).max()
    size = np.deg2rad(np.hypot(p.stance_yaw_deg, p.place_yaw_deg))
    assert np.sqrt(turn[shown, shown][0, 0]) == pytest.approx(18.0 * size, rel=0.05)
    assert np.abs(turn[seen, seen]).max() < 0.1 * turn[shown, shown][0, 0]
    # Another frame of the sequence shares the stance's part.
    later = noise.of(asked_more.trials + 3)
    share = turn[shown, later][0, 0] / turn[shown, shown][0, 0]
    assert share == pytest.approx(p.stance_yaw_deg**2 / (p.stance_yaw_deg**2 + p.place_yaw_deg**2), rel=0.05)


def test_where_only_frontal_corners_are_seen_the_covariance_has_no_further_part(column, twisted, asked_more) -> None:
    plain = column.weighed(twisted, names=NAMES)
    further = {"marks set by hand", "pedicles' places", "turn of the patient"}
    assert set(asked_more.noise.parts) - set(plain.noise.parts) == further
    main = slice(0, plain.noise.size)
    for name in set(plain.noise.parts):
        assert np.array_equal(asked_more.noise.parts[name][main, main], plain.noise.parts[name])


def test_covariance_is_positive_and_its_parts_make_it_up(column, asked_more) -> None:
    found = column.searched(asked_more, (1.0, 1.0, 1.0))
    parts = covariance_parts(asked_more, found)
    whole = sum(parts.values())
    assert np.linalg.eigvalsh(whole).min() > 0.0
    rows = slice(0, asked_more.noise.size)
    root = found.weights.root[rows, rows]
    nuisances = found.slope.nuisances[rows]
    assert np.allclose(whole[rows, rows], root @ root.T + nuisances @ nuisances.T, atol=1e-9)


def test_a_forecast_uses_nothing_of_the_unseen_trial(column, both) -> None:
    """Not its pedicles and its lateral radiograph either."""
    asked = column.weighed(both, names=NAMES)
    point = asked.solve(np.log(list(TRUTH.values())), np.zeros(len(asked.unknowns)))
    slope = asked.slope(point)
    (before,) = forecast(asked, point, slope, 1.0, [1])
    values = point.values.copy()
    values[asked.further_rows(1)] += 5.0
    (after,) = forecast(asked, replace(point, values=values), slope, 1.0, [1])
    assert np.array_equal(before.expected, after.expected)
    values[asked.further_rows(0)] += 5.0
    (moved,) = forecast(asked, replace(point, values=values), slope, 1.0, [1])
    assert np.abs(moved.expected - before.expected).max() > 1e-3


def test_a_design_counts_radiographs_each_with_its_corners_and_pedicles(asked_more) -> None:
    point = asked_more.solve(np.log(list(TRUTH.values())), np.zeros(len(asked_more.unknowns)))
    slope = asked_more.slope(point)
    design = design_at(asked_more, point, slope)
    assert asked_more.shown == ((0, 3), (1, 4), (2, 5))
    assert [len(rows) for rows in design.rows] == [9 * (3 + 4)] * 6
    assert sorted(np.concatenate(design.rows).tolist()) == list(range(asked_more.noise.size))
    assert design.more == set(range(6))
    for trial, (own, aside) in enumerate(asked_more.shown):
        shown = {*np.arange(asked_more.size)[asked_more.noise.of(trial)], *asked_more.further_rows(trial)}
        assert shown == {*design.rows[own], *design.rows[aside]}
    # All of them are what a fit of all has.
    model = reduced(point, slope, asked_more.as_expected(point))
    wanted = np.sqrt(np.diag(np.linalg.inv(model.ratios.T @ model.ratios)))
    assert np.allclose(design.ratio_sds(range(6)), wanted, rtol=1e-3)


def test_frontal_radiographs_tell_as_much_whether_or_not_lateral_ones_might_be_taken(column, twisted) -> None:
    """A fit of corners in frontal radiographs leaves the patient's turn out."""
    designs = []
    for trials in (twisted, seen_more(column, twisted, pedicles=False)):
        asked = column.weighed(trials, names=NAMES)
        point = asked.solve(np.log(list(TRUTH.values())), np.zeros(len(asked.unknowns)))
        designs.append(design_at(asked, point, asked.slope(point)))
    alone, both = designs
    assert (alone.more, both.more) == (frozenset(), {3, 4, 5})
    assert np.allclose(both.ratio_sds([0, 1, 2]), alone.ratio_sds([0, 1, 2]), rtol=1e-9)
    weights = np.array([0.0, 0.0, 1.0, *np.zeros(24)])
    seen = [design.prediction_sd([0, 2], 1, weights) for design in designs]
    assert seen[0] == pytest.approx(seen[1], rel=1e-9)


def test_what_the_model_lacks_out_of_the_plane_goes_with_the_motion() -> None:
    motion = np.column_stack([np.linspace(0.0, 20.0, 17), np.zeros(17), np.zeros(17)])
    frames = [DiscrepancyFrame("right", 7.5, motion), DiscrepancyFrame("right", 7.5, 0.5 * motion)]
    frames.append(DiscrepancyFrame("left", 7.5, motion))
    modes = shipped_modes("coarse")
    columns = out_of_plane_columns(frames, modes)
    flat = columns.reshape(3, 17 * 3, -1)
    first, half, other = (np.einsum("ik,jk->ij", flat[0], one) for one in flat)
    sds = np.sqrt(np.diag(first)).reshape(17, 3)
    assert np.allclose(sds, motion_size(motion) * OUT_OF_PLANE_SD / [1.0, TURN_ARM_MM, TURN_ARM_MM])
    assert np.allclose(half, 0.5 * (1.0 - modes.own_share) * first)
    assert not other.any()
    neighbours = first.reshape(17, 3, 17, 3)[0, :, 1, :]
    assert np.allclose(neighbours, np.diag(np.diag(neighbours)))
    assert (np.diag(neighbours) > 0.5 * sds[0] ** 2).all()


def test_a_second_frontal_radiograph_lacks_what_the_first_does_and_a_lateral_one_the_rest() -> None:
    """On the template, of whose motion in the frontal plane the discrepancy was learnt."""
    torso = template_torso(157.0, "coarse")
    problem, load = EquilibriumProblem(torso, three_point_supports(torso, "right")), rib_push(torso, "right", 8.0, 40.0)
    ratios = stiffness_ratios({"lateral_bending": 0.1, "tissue": 0.05}, torso.joints.kinds)
    state = problem.solve(load, ratios).require().state
    views = frontal_view(), lateral_view()
    shares = [silhouette_shares(torso, view, torso.rest_pose) for view in views]
    front, side = (
        VertebraCorners(torso.vertebrae, state_features(torso, view, state, share).corners)
        for view, share in zip(views, shares)
    )
    again, aside = Picture(front, views[0], "again", "again"), Picture(side, views[1], "aside", "aside")
    trial = Trial(load, front, views[0], "front", further=(again, aside))
    trial_set = TrialSet([problem], [trial], ratios.groups, "procrustes", None)
    asked = WeighedProblem(trial_set, [], "procrustes", Known())
    point = asked.solve(np.log(ratios.values), np.zeros(len(asked.unknowns)), starts=[state])
    found = asked.moving.discrepancy(point)
    first, second, third = (found[np.ix_(rows, rows)] for rows in (np.arange(51) + 51 * i for i in range(3)))
    crossed = found[:51, 51:102]
    # Sideways: the same motion, but for perspective and the little that a turn about the spine moves corners.
    moving = slice(0, 51, 3)
    correlation = np.diag(crossed)[moving] / np.sqrt(np.diag(first)[moving] * np.diag(second)[moving])
    assert correlation.min() > 0.97
    # To the front, in a lateral picture's columns: what was learnt out of the plane, corners' mean counting twice.
    size = motion_size(asked.moving._whole_motion(0, point))
    assert np.sqrt(np.diag(third)[moving]) == pytest.approx(2.0 * size * OUT_OF_PLANE_SD[0], rel=0.1)
    # Up and down all three show.
    upright = slice(1, 51, 3)
    assert np.sqrt(np.diag(third)[upright]) == pytest.approx(np.sqrt(np.diag(first)[upright]), rel=0.35)


def test_marks_that_fit_no_vertebra_are_refused(column, twisted) -> None:
    alone = VertebraCorners(("L1", "L2"), column.corners(column.torso.rest_pose, LATERAL)[4:6])
    picture = column.picture(column.torso.rest_pose, LATERAL, "push 1 rest lateral", "side")
    few = replace(twisted[0], further=(replace(picture, corners=alone),))
    with pytest.raises(FitError, match="push 1 rest lateral shows 2 vertebrae"):
        column.weighed([few, *twisted[1:]])
    strange = replace(twisted[0], pedicles=PediclePoints(("T1",), np.zeros((1, 2, 2))))
    with pytest.raises(TrackingError, match="push 1 rest: pedicles name T1, but this torso has no such vertebra"):
        column.weighed([strange, *twisted[1:]])


def test_the_papers_fit_sees_the_frontal_corners_alone(column, twisted, both) -> None:
    plain, more = (column.trial_set([t for t in trials if t.load.size], NAMES) for trials in (twisted, both))
    assert np.array_equal(plain.solve(np.zeros(3)).values, more.solve(np.zeros(3)).values)


def test_pedicles_of_which_none_is_seen_are_none(column, noisy) -> None:
    """In the frontal radiograph and in one from another side."""
    nothing = PediclePoints(("T10",), np.full((1, 2, 2), np.nan))
    (plain,) = seen_more(column, noisy[:1], pedicles=False)
    blind = replace(plain, pedicles=nothing, further=tuple(replace(one, pedicles=nothing) for one in plain.further))
    one, other = (column.weighed([trial, *noisy[1:]]) for trial in (plain, blind))
    assert np.array_equal(one.noise.constant, other.noise.constant)
    assert one.shown == other.shown


def test_a_vertebra_that_was_followed_aside_may_be_outlying(column, both) -> None:
    """It counts for less wherever the fit's end is read again, and is named with its radiograph."""
    last, start = both[-1], both[0].further[0]
    tracked = replace(last.further[0], followed_from=start.label)
    asked = column.weighed([*both[:-1], replace(last, further=(tracked,))], names=NAMES)
    row = next(i for i, one in enumerate(asked.noise.seen) if one.target.trial.label == tracked.label)
    inflation = np.ones(asked.noise.size)
    inflation[asked.noise.of(row).start + CHANNELS * 2 :][:CHANNELS] = 9.0
    named = asked.outlying(inflation)
    assert named == [(tracked.label, tracked.corners.vertebrae[2], 3.0)]
    np.testing.assert_allclose(asked.inflation(named), inflation)
