"""Markers on the skin in the same fit: derivatives, errors, and what they tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import FitError
from spinestiff.estimation.budget import covariance_parts
from spinestiff.estimation.design import design_at
from spinestiff.estimation.discrepancy import SKIN_LENGTH_MM, SKIN_SD, DiscrepancyFrame, motion_size, skin_covariance
from spinestiff.estimation.discrepancy_data import shipped_modes
from spinestiff.estimation.evaluation import TrialSet
from spinestiff.estimation.forecast import forecast
from spinestiff.estimation.known import Known
from spinestiff.estimation.objective import SkinMarkers, Trial
from spinestiff.estimation.priors import Priors
from spinestiff.estimation.weighed import WeighedProblem, reduced
from spinestiff.imaging.features import VertebraCorners, silhouette_shares, state_features
from spinestiff.imaging.projection import frontal_view, lateral_view
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.study.synthetic.markers import spread_markers

LATERAL = lateral_view(centre=(0, 150, 0))
TRUTH = {"lateral_bending": 0.3, "tissue": 0.4}
NAMES = tuple(TRUTH)
PARTS = {
    "markers' own errors",
    "markers' places",
    "turn of the cameras",
    "sway before the cameras",
    "breath under the markers",
}


def state_of(column, trial):
    if not trial.load.size:
        return column.torso.rest_pose
    return column.problem.solve(trial.load, column.ratios(TRUTH)).require().state


@pytest.fixture(scope="module")
def plain(column):
    return column.trials(TRUTH)


@pytest.fixture(scope="module")
def marked(column, plain):
    return [replace(trial, markers=column.markers(state_of(column, trial))) for trial in plain]


@pytest.fixture(scope="module")
def asked_marked(column, marked):
    return column.weighed(marked)


def rows_of(problem, trial):
    return problem.further_rows(trial)


def test_derivatives_of_markers_against_differences_of_whole_solves(column, marked) -> None:
    """In all ratios and unknowns; also in the source's distance, which no camera knows of."""
    asked = column.weighed(marked)
    m, p = len(asked.unknowns), len(NAMES)
    here, nuisances = np.log([0.35, 0.3]), np.random.default_rng(0).normal(0.0, 0.7, m)
    point = asked.solve(here, nuisances)
    slope = asked.slope(point)
    more = np.concatenate([rows_of(asked, i) for i in range(2)])
    assert len(more) == 2 * 3 * len(marked[0].markers.names)
    for i in range(p + m):
        step = 2e-3 * np.eye(p + m)[i]
        ahead, behind = (asked.solve(here + s * step[:p], nuisances + s * step[p:], point).values for s in (1, -1))
        quotient = ((ahead - behind) / 4e-3)[more]
        exact = (slope.ratios[:, i] if i < p else slope.nuisances[:, i - p])[more]
        if i >= p and asked.unknowns.names[i - p] == "source distance":
            assert not exact.any() and not quotient.any()
            continue
        assert np.abs(quotient).max() > 1e-5
        assert np.allclose(exact, quotient, atol=2e-4 * np.abs(quotient).max()), i


def test_markers_take_no_equilibrium_of_their_own_and_leave_the_corners_as_they_were(column, plain, marked) -> None:
    found = []
    for trials in (plain, marked):
        asked = column.weighed(trials)
        point = asked.solve(np.zeros(2), np.zeros(len(asked.unknowns)))
        slope = asked.slope(point)
        found.append((asked, point, slope))
    (less, before, slope), (more, after, wider) = found
    assert less.trial_set.cost.equilibria == more.trial_set.cost.equilibria == 2
    own = less.noise.size
    assert np.array_equal(before.values[:own], after.values[:own])
    assert np.array_equal(slope.ratios[:own], wider.ratios[:own])
    assert set(more.noise.parts) - set(less.noise.parts) == PARTS
    # Neither corners of frontal radiographs nor markers tell of how the patient was turned before the tube.
    assert "turn of the patient" not in more.noise.parts
    for name, part in less.noise.parts.items():
        assert np.array_equal(more.noise.parts[name][:own, :own], part)
        assert not more.noise.parts[name][own:].any()


def test_a_planned_lateral_radiograph_does_not_make_markers_a_view_that_tells_of_the_patients_turn(
    column, marked
) -> None:
    """Radiographs of frontal corners and markers are worth the same whether or not a lateral one might be taken."""
    found = []
    for with_side in (False, True):
        planned = column.trials(TRUTH, forces=(70.0,), push="push 2")
        if with_side:
            states = [(one, state_of(column, one)) for one in planned]
            sides = [column.picture(state, LATERAL, f"{one.label} side", "side", True) for one, state in states]
            planned = [replace(one, further=(side,)) for one, side in zip(planned, sides)]
        asked = column.weighed([*marked, *planned])
        point = asked.solve(np.log(list(TRUTH.values())), np.zeros(len(asked.unknowns)))
        # Of the loaded trials come those of push 1, then that of push 2; the unloaded ones follow likewise.
        taken = [number for trial in (0, 1, 3) for number in asked.shown[trial]]
        assert len(taken) == 6
        assert asked.showing_more == ({asked.shown[2][1], asked.shown[4][1]} if with_side else frozenset())
        found.append(design_at(asked, point, asked.slope(point)).ratio_sds(taken))
    assert np.allclose(*found, rtol=1e-9)


def test_markers_stand_beside_pedicles_and_other_radiographs(column, marked) -> None:
    """Each keeps its own errors: no hand marks a marker, and the patient's turn before a tube moves none."""
    every = []
    for trial in marked:
        state = state_of(column, trial)
        side = column.picture(state, LATERAL, f"{trial.label} side", "side", True)
        every.append(replace(trial, further=(side,), pedicles=column.pedicles(state)))
    whole = column.weighed(every)
    alone = column.weighed([replace(trial, markers=None) for trial in every])
    markers = np.array([one.sequence == "push 1 markers" for one in whole.noise.seen])
    rows = np.concatenate([np.arange(whole.noise.size)[whole.noise.of(i)] for i in np.flatnonzero(markers)])
    assert len(rows) == 9 * len(marked[0].markers.names)
    others = np.setdiff1d(np.arange(whole.noise.size), rows)
    for name, part in alone.noise.parts.items():
        assert np.allclose(whole.noise.parts[name][np.ix_(others, others)], part, rtol=1e-12, atol=1e-9), name
        assert not whole.noise.parts[name][rows].any(), name
    point = whole.solve(np.log(list(TRUTH.values())), np.zeros(len(whole.unknowns)))
    assert np.abs(point.values[: whole.noise.size]).max() < 1e-6
    assert np.isfinite(whole.weights(point, whole.slope(point), None).root).all()


def test_without_errors_all_is_met_at_the_truth_and_markers_tell_more(column, plain, marked) -> None:
    p = Priors(marker_slide=0.02)
    both = column.weighed(marked, p)
    point = both.solve(np.log(list(TRUTH.values())), np.zeros(len(both.unknowns)))
    assert np.abs(point.values[: both.noise.size]).max() < 1e-6
    other = both.solve(np.zeros(2), np.zeros(len(both.unknowns)))
    assert np.array_equal(point.values[rows_of(both, 2)], other.values[rows_of(both, 2)])
    assert np.abs(other.values[rows_of(both, 1)]).max() > 0.5
    sds = []
    for trials in (plain, marked):
        found = column.searched(column.weighed(trials, p))
        model = reduced(found.point, found.slope, found.weights)
        sds.append(np.sqrt(np.diag(np.linalg.inv(model.ratios.T @ model.ratios))))
        assert np.allclose(found.point.log_ratios, np.log(list(TRUTH.values())), atol=0.05 * sds[-1])
    assert (sds[1] < 0.9 * sds[0]).any() and (sds[1] <= sds[0]).all()


def test_only_the_motion_counts(column, marked) -> None:
    """A shift of all frames, as of the cameras' origin, hardly moves the estimate; the same shift of one frame does."""

    def estimate(shifts):
        moved = [
            replace(trial, markers=replace(trial.markers, positions=trial.markers.positions + shift))
            for trial, shift in zip(marked, shifts)
        ]
        return column.searched(column.weighed(moved)).point.log_ratios

    truth = np.log(list(TRUTH.values()))
    everywhere = np.abs(estimate([np.array([4.0, -3.0, 2.0])] * 3) - truth).max()
    once = np.abs(estimate([np.zeros(3), np.array([4.0, -3.0, 2.0]), np.zeros(3)]) - truth).max()
    assert everywhere < 0.2 * once


def test_a_turn_of_the_cameras_is_an_unknown(column, marked) -> None:
    turn = exp_so3(np.deg2rad([0.0, 0.0, 4.0]))
    middle = marked[0].markers.positions.mean(0)
    turned = [
        replace(trial, markers=replace(trial.markers, positions=(trial.markers.positions - middle) @ turn.T + middle))
        for trial in marked
    ]
    off = {}
    for sd in (12.0, 0.0):
        p = Priors(marker_turn_deg=sd, marker_slide=0.0, marker_breath_mm=0.0)
        off[sd] = np.abs(
            column.searched(column.weighed(turned, p)).point.log_ratios - np.log(list(TRUTH.values()))
        ).max()
    assert off[12.0] < 0.5 * off[0.0]


def test_errors_of_markers_are_shared_as_they_are(asked_marked, marked) -> None:
    noise, p = asked_marked.noise, Priors()
    first, second, still = (noise.of(asked_marked.trials + i) for i in range(3))
    count = first.stop - first.start
    own, places = noise.parts["markers' own errors"], noise.parts["markers' places"]
    assert np.allclose(np.diag(own)[first], p.marker_mm**2) and np.array_equal(own, np.diag(np.diag(own)))
    assert np.allclose(places[first, second], p.marker_place_mm**2 * np.eye(count))
    assert np.allclose(places[first, still], places[first, first])
    breath, sway = noise.parts["breath under the markers"], noise.parts["sway before the cameras"]
    forward = np.tile([0.0, 0.0, 1.0], count // 3)
    assert np.allclose(breath[first, first], p.marker_breath_mm**2 * np.outer(forward, forward))
    assert not breath[first, second].any() and not sway[first, second].any()
    z = marked[1].markers.positions
    arms = z - np.concatenate([trial.markers.positions for trial in marked]).mean(0)
    yaw, roll = np.deg2rad(p.place_yaw_deg), np.deg2rad(p.place_deg)
    expected = p.place_mm**2 + (yaw * arms[0, 2]) ** 2 + (roll * arms[0, 1]) ** 2
    assert sway[first, first][0, 0] == pytest.approx(expected, rel=1e-9)
    turn = noise.parts["turn of the cameras"]
    size = np.deg2rad(p.marker_turn_deg)
    assert turn[first, first][0, 0] == pytest.approx(size**2 * (arms[0, 1] ** 2 + arms[0, 2] ** 2))
    # It turns the motion: what two frames share differs by it.
    resting = (
        marked[0].markers.positions - marked[0].markers.positions[0] + arms[0] - (z - marked[0].markers.positions)[0]
    )
    assert turn[first, still][0, 0] == pytest.approx(size**2 * (arms[0, 1:] @ resting[0, 1:]))


def test_a_marker_that_is_not_seen_in_a_frame_is_left_out_of_it_alone(column, marked, asked_marked) -> None:
    positions = marked[1].markers.positions.copy()
    positions[2] = np.nan
    gone = [marked[0], replace(marked[1], markers=replace(marked[1].markers, positions=positions)), marked[2]]
    asked = column.weighed(gone)
    assert len(rows_of(asked, 0)) == len(rows_of(asked_marked, 0)) - 3
    assert len(rows_of(asked, 1)) == len(rows_of(asked_marked, 1))
    kept = np.delete(np.arange(len(rows_of(asked_marked, 0))), [6, 7, 8])
    places, whole = asked.noise.parts["markers' places"], asked_marked.noise.parts["markers' places"]
    assert np.array_equal(
        places[np.ix_(rows_of(asked, 0), rows_of(asked, 1))],
        whole[np.ix_(rows_of(asked_marked, 0)[kept], rows_of(asked_marked, 1))],
    )
    nothing = replace(marked[1].markers, positions=np.full(positions.shape, np.nan))
    bare = column.weighed([marked[0], replace(marked[1], markers=nothing), marked[2]])
    assert len(rows_of(bare, 0)) == 0


def test_markers_with_half_a_place_or_other_points_are_refused(column, marked) -> None:
    there = marked[0].markers
    half = there.positions.copy()
    half[1, 2] = np.nan
    with pytest.raises(FitError, match="marker 'm1' has some coordinates but not all"):
        replace(there, positions=half)
    with pytest.raises(FitError, match="wanted three coordinates and a point of each"):
        SkinMarkers(there.names, there.positions[:-1], there.points, there.outward, "s")


def test_a_forecast_uses_no_markers_of_the_unseen_trial(asked_marked) -> None:
    point = asked_marked.solve(np.log(list(TRUTH.values())), np.zeros(len(asked_marked.unknowns)))
    slope = asked_marked.slope(point)
    (before,) = forecast(asked_marked, point, slope, 1.0, [1])
    moved = []
    for trial in (1, 0):
        values = point.values.copy()
        values[rows_of(asked_marked, trial)] += np.arange(len(rows_of(asked_marked, trial))) % 7
        (after,) = forecast(asked_marked, replace(point, values=values), slope, 1.0, [1])
        moved.append(np.abs(after.expected - before.expected).max())
    assert moved[0] == 0.0 < moved[1]


def test_covariance_is_positive_and_its_parts_make_it_up(column, asked_marked) -> None:
    found = column.searched(asked_marked)
    whole = sum(covariance_parts(asked_marked, found).values())
    assert set(covariance_parts(asked_marked, found)) > PARTS
    assert np.linalg.eigvalsh(whole).min() > 0.0


def test_the_skins_discrepancy_goes_with_the_motion_and_fades_along_the_skin() -> None:
    modes = shipped_modes("coarse")
    frames = [DiscrepancyFrame("left", 8.0, size * np.ones((17, 3)) * [1.0, 0.2, 0.01]) for size in (1.0, 2.0)]
    points = np.array([[0.0, 0.0, 0.0], [0.0, 90.0, 0.0], [0.0, 0.0, 0.0]])
    found = skin_covariance(frames, modes, np.array([0, 0, 1]), points, 0.1).reshape(3, 3, 3, 3)
    sds = np.hypot(SKIN_SD, 0.1) * motion_size(frames[0].motion)
    assert np.allclose(np.diag(found[0, :, 0]), sds**2)
    assert np.allclose(np.diag(found[0, :, 1]), sds**2 * np.exp(-90.0 / SKIN_LENGTH_MM))
    assert np.allclose(np.diag(found[0, :, 2]), 2.0 * sds**2 * (1.0 - modes.own_share))
    assert np.allclose(np.diag(found[2, :, 2]), 4.0 * sds**2)
    assert not found[0, 0, 0, 1:].any()


def test_on_a_whole_torso_the_skin_lacks_what_it_is_said_to() -> None:
    torso = template_torso(157.0, "coarse")
    problem = EquilibriumProblem(torso, three_point_supports(torso, "right"))
    view = frontal_view()
    points, outward = spread_markers(torso, 6, np.full((1, 3), 1e4))
    names = tuple(f"m{i}" for i in range(6))
    shares = silhouette_shares(torso, view, torso.rest_pose)
    trials = []
    for force in (0.0, 20.0):
        load = rib_push(torso, "right", 8.0, force)
        state = problem.solve(load).require().state
        markers = SkinMarkers(names, points.positions(torso, state), points, outward, "markers")
        corners = VertebraCorners(torso.vertebrae, state_features(torso, view, state, shares).corners)
        trials.append(Trial(load, corners, view, f"{force:g} N", "main", not force, markers=markers))
    trial_set = TrialSet([problem], trials[1:], (), "procrustes", None)
    asked = WeighedProblem(trial_set, [(problem, trials[0])], "procrustes", Known())
    point = asked.solve(np.zeros(0), np.zeros(len(asked.unknowns)))
    found = asked.moving.discrepancy(point)
    size = motion_size(asked.moving._whole_motion(0, point))
    rows = asked.further_rows(0)
    assert len(rows) == 18
    assert np.allclose(np.diag(found)[rows], np.tile((size * np.hypot(SKIN_SD, Priors().marker_slide)) ** 2, 6))
    assert not found[np.ix_(rows, asked.further_rows(1))].any()
    assert not found[np.ix_(rows, np.arange(asked.noise.size)[asked.noise.of(0)])].any()
