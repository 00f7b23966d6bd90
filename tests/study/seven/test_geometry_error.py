"""A geometry that is off by as much as the paper's."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.anatomy.rotation import log_so3
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import SubjectError
from spinestiff.study.runner import ALL_STEPS
from spinestiff.study.seven.geometry_error import GeometryError, moved_spine, size_of_error, smooth_errors, steps_with
from spinestiff.study.synthetic.spines import rest_vertebrae


@pytest.fixture(scope="module")
def torso():
    return template_torso(157.0)


@pytest.fixture(scope="module")
def draws(torso):
    """(500, V, 6)"""
    basis = smooth_errors(rest_vertebrae(torso)[0])
    normal = np.random.default_rng(0).normal(size=(500, basis.shape[-1]))
    return np.einsum("vcd,nd->nvc", basis, normal)


def test_neighbours_are_alike_and_others_are_not(draws):
    aside = draws[:, :, 0]
    likeness = np.corrcoef(aside.T)
    assert np.diag(likeness, 1).min() > 0.5
    assert likeness[8, 9] > 0.9 and likeness[8, 13] < 0.3
    # From one vertebra to the next it changes by about half of its size; without likeness that is 1.4 times.
    assert np.abs(np.diff(aside, axis=1)).mean() < 0.6 * np.abs(aside).mean()


def test_where_a_patient_stands_is_no_error(torso, draws):
    height = rest_vertebrae(torso)[0][:, 1]
    for channel in (0, 2):
        slope = np.polyfit(height, draws[:, :, channel].T, 1)
        assert np.abs(slope).max() < 1e-9
    assert np.abs(draws[:, :, 1].mean(axis=1)).max() < 1e-9


def test_vertebrae_turn_as_the_line_through_them(torso, draws):
    height = rest_vertebrae(torso)[0][:, 1]
    for place, turn, sign in ((0, 5, -1.0), (2, 3, 1.0)):
        slope = np.gradient(draws[:, :, place], height, axis=1)
        np.testing.assert_allclose(draws[:, :, turn], sign * slope, atol=1e-12)


def test_a_spine_moves_by_its_motion(torso):
    motion = np.random.default_rng(1).normal(0.0, 0.02, (17, 6))
    positions, rotations = moved_spine(torso, motion)
    before = rest_vertebrae(torso)
    np.testing.assert_allclose(positions - before[0], motion[:, :3], atol=1e-12)
    np.testing.assert_allclose(log_so3(rotations @ before[1].swapaxes(1, 2)), motion[:, 3:], atol=1e-12)


def test_the_size_is_found_at_which_the_rmse_is_what_is_wanted():
    assert size_of_error(lambda size: np.hypot(0.3, 0.5 * size), 2.0) == pytest.approx(2 * np.sqrt(4 - 0.09), abs=1e-2)
    assert size_of_error(lambda size: 2.5 + size, 2.0) == 0.0
    with pytest.raises(SubjectError, match="RMSE 2 mm is not reached by 30 mm aside"):
        size_of_error(lambda size: 0.3, 2.0)


def test_steps_differ_in_personalisation_alone_and_say_so():
    steps = steps_with(GeometryError(2.4, 5))
    assert list(steps) == list(ALL_STEPS)
    assert [name for name in steps if steps[name] is not ALL_STEPS[name]] == ["personalise"]
    assert steps["personalise"].parts == ALL_STEPS["personalise"].parts
