"""benchmarks/judgement_subjects.py: errors of tracked corners have the sizes that were measured."""

from __future__ import annotations

import numpy as np
import pytest

from programs import benchmark

COLUMN = np.array([[-15.0, 10.0], [15.0, 10.0], [15.0, -10.0], [-15.0, -10.0]]) + 25.0 * np.arange(17)[
    :, None, None
] * np.array([0.0, 1.0])


subjects = benchmark("judgement_subjects")
channels = benchmark("tracking_drag").channels


def test_tracking_errors_have_the_sizes_of_the_trackers_channels_and_are_bodies_motions() -> None:
    random, predicted = np.random.default_rng(0), np.full((17, 1), 0.1)
    errors = [subjects._tracking_errors(COLUMN, predicted, random) for _ in range(1000)]
    found = np.stack([channels(error, COLUMN) for error in errors])  # (n, 3, 17)
    spread = np.exp(subjects.PREDICTED_WITHIN**2)
    assert found.std((0, 2)) == pytest.approx(0.1 * spread * subjects.TRACK_CHANNELS, rel=0.04)
    beside = np.array([np.mean(found[:, c, 1:] * found[:, c, :-1]) for c in range(3)]) / found.var((0, 2))
    assert beside == pytest.approx(subjects.TRACK_SHARED * np.exp(-1.0 / subjects.TRACK_LENGTH), abs=0.03)
    for error in errors[:5]:
        assert np.sum(error**2) == pytest.approx(np.sum(channels(error, COLUMN) ** 2))


def test_what_is_taken_along_is_a_share_of_the_motion_sideways() -> None:
    drag = np.stack([np.full(17, 0.01), np.full(17, -0.02)])
    dragged = subjects._dragged(COLUMN, COLUMN - [3.0, 0.0], drag)
    # Shifts are twice the corners' mean as a channel.
    assert channels(dragged, COLUMN) == pytest.approx(np.repeat([[-0.06], [0.0], [0.12]], 17, axis=1))
