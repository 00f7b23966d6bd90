"""The covariance of what is seen: its parts' structure, and what finds the size of tracking's errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.state import TorsoState, retract
from spinestiff.estimation.channels import CHANNELS, Channels
from spinestiff.estimation.noise import (
    DRAG_LENGTH,
    DRAG_OWN,
    DRAG_TURN,
    TRACKED,
    USUAL,
    Noise,
    Seen,
    restricted_factor,
)
from spinestiff.estimation.objective import make_target, residuals
from spinestiff.estimation.priors import Priors
from spinestiff.imaging.features import VertebraCorners, target_features

SEQUENCES = ("a", "a", "a", "b", "b")
ANNOTATED = (True, False, False, True, False)


@pytest.fixture(scope="module")
def targets(column, noisy):
    """Of two sequences; two frames lack vertebrae at their ends."""
    rest, first, second = noisy
    names = column.torso.vertebrae
    trials = [rest, first, second, rest, second]
    seen = [names, names[1:], names, names, names[:-2]]
    cut = [replace(t, corners=t.corners.selected(kept)) for t, kept in zip(trials, seen)]
    return [make_target(column.torso, trial) for trial in cut]


def noise_of(column, targets, priors=None, geometry=None, annotated=ANNOTATED) -> Noise:
    still = [residuals(column.torso, target, column.torso.rest_pose) for target in targets]
    seen = [Seen(*one) for one in zip(targets, SEQUENCES, annotated, strict=False)]
    return Noise(seen, still, geometry, priors or Priors())


@pytest.fixture(scope="module")
def noise(column, targets) -> Noise:
    return noise_of(column, targets)


def labels(noise):
    """Radiograph, vertebra and channel of each row."""
    return [
        (i, int(row), c) for i, channels in enumerate(noise.channels) for row in channels.rows for c in range(CHANNELS)
    ]


def test_channels_are_shifts_and_turn(column, targets) -> None:
    channels = Channels.of(targets[0])
    flat = channels.basis.reshape(-1, CHANNELS, 8)
    assert np.allclose(flat @ np.swapaxes(flat, 1, 2), np.eye(CHANNELS))
    z = targets[0].z
    shifted = channels.apply(np.broadcast_to([3.0, -2.0], z.shape)).reshape(-1, CHANNELS)
    assert np.allclose(shifted, [6.0, -4.0, 0.0])
    arms = z - z.mean(1, keepdims=True)
    turned = channels.apply(0.01 * np.stack([-arms[..., 1], arms[..., 0]], -1)).reshape(-1, CHANNELS)
    assert np.allclose(turned[:, :2], 0.0, atol=1e-12)
    assert np.allclose(turned[:, 2], 0.01 * np.linalg.norm(arms, axis=(1, 2)))
    both = channels.apply(np.stack([z, 2.0 * z], -1))
    assert np.allclose(both[:, 1], 2.0 * channels.apply(z))


def test_all_parts_are_symmetric_and_no_variance_is_negative(column, targets) -> None:
    random = np.random.default_rng(0)
    root = random.normal(size=(6 * len(column.torso.vertebrae), 12))
    noise = noise_of(column, targets, geometry=0.01 * root @ root.T)
    assert set(noise.parts) == {"annotation", "place in the picture", "posture", "stance", "rest geometry"}
    for part in (*noise.parts.values(), noise.tracking(), noise.tracking(1.7, random.uniform(1.0, 4.0, noise.size))):
        assert part.shape == (noise.size, noise.size)
        assert np.allclose(part, part.T, atol=1e-12)
        values = np.linalg.eigvalsh(part)
        assert values.max() > 0.0
        assert values.min() > -1e-9 * values.max()
    assert np.linalg.eigvalsh(noise.constant + noise.tracking()).min() > 0.0
    assert np.allclose(noise.constant, sum(noise.parts.values()))


def test_an_annotation_error_is_one_for_a_vertebra_of_a_sequence(noise) -> None:
    found = labels(noise)
    wanted = [
        [0.09 * (SEQUENCES[i] == SEQUENCES[j] and (row, c) == (other, d)) for j, other, d in found]
        for i, row, c in found
    ]
    assert np.allclose(noise.parts["annotation"], wanted)


@pytest.mark.parametrize("orientation", ["procrustes", "covariance"])
def test_an_annotation_error_moves_a_box_as_its_marks_place_it(column, noisy, orientation) -> None:
    """Two frames of a sequence, the marks of one turned; in that one a vertebra has three. Against differences."""
    names, view = column.torso.vertebrae, noisy[0].view
    # Of the boxes' own shape.
    marks = target_features(column.torso, view, noisy[0].corners)
    angle = 0.2
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    quality = np.ones(marks.shape[:2])
    quality[2, 1] = 0.0

    def seen(step=0.0):
        first, second = (view.from_patient_plane(one) for one in (marks + step, (marks + step) @ turn))
        first, second = VertebraCorners(names, first), VertebraCorners(names, second, quality)
        trials = [replace(noisy[0], corners=one) for one in (first, second)]
        return [make_target(column.torso, trial, orientation) for trial in trials]

    targets = seen()
    noise = noise_of(column, targets, annotated=(True, True))

    def moved(step):
        return np.concatenate(
            [channels.apply(one.z - old.z) for channels, one, old in zip(noise.channels, seen(step), targets)]
        )

    # Shifts are the picture's in both frames, all else turns with the vertebra.
    shift = np.zeros((marks.size, noise.size))
    for number, where in enumerate(np.ndindex(marks.shape)):
        step = np.zeros(marks.shape)
        step[where] = 1e-4
        shift[number] = moved(step) / 1e-4
    first, second = (shift[:, noise.of(i)] for i in range(2))
    each = len(names) * CHANNELS
    found = noise.parts["annotation"] / Priors().annotation_mm ** 2
    np.testing.assert_allclose(found[:each, :each], first.T @ first, atol=1e-4)
    np.testing.assert_allclose(found[each:, each:], second.T @ second, atol=1e-4)
    turns = np.arange(2, each, CHANNELS)
    np.testing.assert_allclose(found[turns, each + turns], (first.T @ second)[turns, turns], atol=1e-4)
    gain = np.diag(found)[each + turns]
    assert (np.delete(gain, 2) > 1.05).all() == (orientation == "covariance")
    assert gain[2] > 1.05


@pytest.mark.parametrize(
    ("part", "groups", "size"),
    [
        ("place in the picture", range(5), (0.5, 0.5, np.deg2rad(0.1), 0.0)),
        ("stance", (0, 0, 0, 1, 1), (20.0, 20.0, np.deg2rad(3.0), 0.02)),
    ],
)
def test_a_picture_or_a_sequence_moves_as_a_whole(noise, targets, part, groups, size) -> None:
    """The variance of any combination of channels is that of random whole motions."""
    covariance, combination = noise.parts[part], np.random.default_rng(1).normal(size=noise.size)
    variance = 0.0
    for group in set(groups):
        for axis in range(4):
            moved = []
            for one, channels, own in zip(targets, noise.channels, groups):
                z = one.z
                turned, larger = np.stack([-z[..., 1], z[..., 0]], -1), np.zeros(z.shape) + z.mean(1, keepdims=True)
                step = np.zeros(z.shape) + np.eye(2)[axis] if axis < 2 else (turned, larger)[axis - 2]
                moved.append((own == group) * size[axis] * channels.apply(step))
            variance += float(combination @ np.concatenate(moved)) ** 2
    assert combination @ covariance @ combination == pytest.approx(variance, rel=1e-9)
    rank = np.linalg.matrix_rank(covariance, tol=1e-9 * np.abs(covariance).max())
    assert rank == len(set(groups)) * np.count_nonzero(size)


def test_a_posture_is_the_same_where_an_end_vertebra_is_lost(column, noisy, noise) -> None:
    lost = replace(noisy[2], corners=noisy[2].corners.selected(noisy[2].corners.vertebrae[1:]))
    fewer = column.weighed([*noisy[:2], lost]).noise
    whole = column.weighed(noisy).noise
    # Loaded frames of 40 and 100 N, then the unloaded one; of the second the uppermost vertebra is gone.
    kept = np.delete(np.arange(whole.size), np.arange(CHANNELS) + whole.of(1).start)
    np.testing.assert_allclose(fewer.parts["posture"], whole.parts["posture"][np.ix_(kept, kept)], atol=1e-12)


def test_rest_geometry_is_what_a_wrong_rest_pose_shows_in_all_frames(column, targets) -> None:
    """Against features of a torso whose vertebrae lie elsewhere; differences."""
    torso, random = column.torso, np.random.default_rng(2)
    wrong = random.normal(size=(len(torso.vertebrae), 6)) * [1.0, 1.0, 1.0, 0.02, 0.02, 0.02]
    noise = noise_of(column, targets, geometry=np.outer(wrong, wrong))
    step = np.zeros((len(torso.bone_names), 6))
    step[torso.vertebra_bones] = wrong
    whole = np.zeros(torso.rest_pose.dofs)
    whole[: step.size] = step.ravel()

    def shown(state: TorsoState):
        parts = [residuals(torso, target, state).difference for target in targets]
        return np.concatenate([channels.apply(part) for channels, part in zip(noise.channels, parts)])

    moved = (shown(retract(torso.rest_pose, 1e-4 * whole)) - shown(retract(torso.rest_pose, -1e-4 * whole))) / 2e-4
    assert np.abs(moved).max() > 1.0
    covariance = noise.parts["rest geometry"]
    assert np.allclose(covariance, np.outer(moved, moved), atol=1e-5 * np.abs(covariance).max())


def test_tracking_errors_are_a_frames_own_partly_shared_with_neighbours(noise) -> None:
    found = labels(noise)
    # 0.1 mm predicted for each corner along both axes together.
    own, shared = np.maximum(0.1**2, 0.5 * (TRACKED * 0.1) ** 2), 0.05**2
    wanted = [
        [
            (i == j and c == d and not ANNOTATED[i])
            * (own[c] * (row == other) + shared * np.exp(-abs(row - other) / 2.0))
            for j, other, d in found
        ]
        for i, row, c in found
    ]
    assert np.allclose(noise.tracking(), wanted)
    assert np.allclose(noise.tracking(2.0), 4.0 * np.array(wanted))
    inflation = np.ones(noise.size)
    inflation[-CHANNELS:] = 9.0
    more = noise.tracking(1.0, inflation) - noise.tracking()
    assert np.allclose(np.diag(more)[-CHANNELS:], 8.0 * own)
    assert np.count_nonzero(np.abs(more) > 1e-12) == CHANNELS


def test_tracked_vertebrae_of_a_frame_that_is_marked_in_part_have_tracking_errors(column, targets, noise) -> None:
    """Of the marked frame of sequence "b" all but one vertebra were tracked from elsewhere."""
    of, marked = 3, targets[3].trial.corners.vertebrae[1]
    names = tuple(name for name in targets[3].trial.corners.vertebrae if name != marked)
    in_part = make_target(column.torso, replace(targets[3].trial, tracked=names))
    found = noise_of(column, [*targets[:of], in_part, *targets[of + 1 :]])
    wanted = noise_of(column, targets, annotated=(True, False, False, False, False))
    left = labels(noise).index((of, int(targets[3].rows[1]), 0)) + np.arange(CHANNELS)
    rows = np.setdiff1d(np.arange(noise.size), left)
    motions = np.ones(len(targets))
    for one, other in ((found.tracking(), wanted.tracking()), (found.drag(motions), wanted.drag(motions))):
        assert not one[left].any()
        np.testing.assert_allclose(one[np.ix_(rows, rows)], other[np.ix_(rows, rows)])


def test_lost_corners_do_not_count_in_a_vertebras_error(column, targets) -> None:
    trial = targets[1].trial
    quality = trial.corners.quality.copy()
    quality[2, 0] = 0.0
    quality[3, 0] = 0.1  # 0.51 mm
    seen = replace(trial, corners=VertebraCorners(trial.corners.vertebrae, trial.corners.corners, quality))
    alone = Priors(tracking_shared_mm=0.0)
    noise = noise_of(column, [make_target(column.torso, seen)], alone, annotated=[False])
    own = np.diag(noise.tracking()).reshape(-1, CHANNELS)[:, 0]
    assert own[2] == pytest.approx(own[0])
    assert own[3] == pytest.approx(TRACKED[0] ** 2 * 0.5 * (3 * 0.1**2 + 0.51**2) / 4.0)


def test_own_errors_are_the_most_probable_ones(noise) -> None:
    """Of a sum of own errors and all the rest: own covariance times the whole's inverse times what was found."""
    random = np.random.default_rng(3)
    inflation = np.repeat(random.uniform(1.0, 4.0, noise.size // CHANNELS), CHANNELS)
    found = random.normal(size=noise.size)
    whole = noise.constant + noise.tracking(1.5, inflation) + 1e-3 * np.eye(noise.size)
    own = np.diag(noise.tracking(1.5, inflation) - noise.tracking(1.5, np.zeros(noise.size)))
    errors = noise.own_errors(np.linalg.solve(whole, found), 1.5, inflation)
    assert np.allclose(errors, own * np.linalg.solve(whole, found))


def test_only_a_vertebra_with_unusual_errors_is_inflated(noise) -> None:
    size = np.sqrt(np.diag(noise.tracking(2.0, np.ones(noise.size)) - noise.tracking(2.0, np.zeros(noise.size))))
    errors = 1.0 * size
    rows = slice(noise.of(1).start + 6, noise.of(1).start + 9)
    errors[rows] = 10.0 * size[rows]
    found = noise.inflation(errors, 2.0)
    wanted = np.ones(noise.size)
    wanted[rows] = (10.0 / USUAL) ** 2
    assert np.allclose(found, wanted)
    errors[noise.of(0)] = 5.0  # annotated: no own error to inflate
    assert np.allclose(noise.inflation(errors, 2.0), wanted)


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_restricted_likelihood_finds_how_large_tracking_errors_are(noise, factor) -> None:
    """On simulated channels, with six columns that have no prior: ten simulations, their geometric mean within 10 %."""
    random = np.random.default_rng(4)
    rest = noise.constant + 1e-6 * np.eye(noise.size)
    root = np.linalg.cholesky(rest + noise.tracking(factor))
    fixed, nothing = random.normal(size=(noise.size, 6)), np.ones(noise.size)
    found = []
    for _ in range(10):
        values = root @ random.normal(size=noise.size) + fixed @ random.normal(0.0, 50.0, 6)
        found.append(restricted_factor(noise, rest, values, fixed, 0.7, nothing))
    # 60 channels tell a log to about 1/sqrt(2 x 60), ten simulations to 0.03.
    assert np.exp(np.mean(np.log(found))) == pytest.approx(factor, rel=0.1)
    assert restricted_factor(noise, rest, values, fixed, 0.0, nothing) == 1.0


def test_drag_is_alike_in_all_tracked_frames_and_grows_with_their_motion(column, targets, noise) -> None:
    p = Priors()
    moved = np.array([3.0, 10.0, -20.0, 4.0, 30.0])
    found = labels(noise)
    sizes = {0: 1.0, 2: DRAG_TURN}

    def expected(i, row, c, j, other, d) -> float:
        if c != d or c not in sizes or ANNOTATED[i] or ANNOTATED[j]:
            return 0.0
        own, length = DRAG_OWN[c // 2], DRAG_LENGTH[c // 2]
        alike = own * (row == other) + (1.0 - own) * np.exp(-(((row - other) / length) ** 2))
        return float(p.tracking_drag**2 * sizes[c] ** 2 * alike * moved[i] * moved[j])

    drag = noise.drag(moved)
    assert np.allclose(drag, [[expected(*a, *b) for b in found] for a in found])
    assert np.linalg.eigvalsh(drag).min() > -1e-12
    assert not noise_of(column, targets, Priors(tracking_drag=0.0)).drag(moved).any()
