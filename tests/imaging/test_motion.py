"""How far a picture has moved since the first frame."""

from __future__ import annotations

import numpy as np
import pytest

from hospital import shifted, texture
from spinestiff.imaging.motion import motion_course


@pytest.mark.parametrize("shape", [(192, 160), (600, 500)])
def test_a_known_shift_is_found_in_pixels_of_the_file(shape):
    moved = np.array([0.0, 0.0, 2.0, 5.0, 7.5, 7.5, 3.0]) * shape[0] / 192.0
    picture = texture(1, shape)
    rng = np.random.default_rng(0)
    frames = [shifted(picture, by) + 100.0 * rng.standard_normal(shape).astype(np.float32) for by in moved]
    np.testing.assert_allclose(motion_course(frames), moved, atol=0.03 * moved.max())


def test_the_largest_motion_is_above_zero_whichever_way_it_goes():
    picture = texture(2)
    course = motion_course([shifted(picture, by) for by in (0.0, -4.0, 1.0)])
    np.testing.assert_allclose(course, [0.0, 4.0, -1.0], atol=0.2)


def test_brightness_is_no_motion():
    picture = texture(3)
    steeper = 20_000.0 * (picture / 20_000.0) ** 3
    assert np.abs(motion_course([picture, 1.3 * picture, 0.8 * picture + 500.0, steeper])).max() < 0.03


def test_half_a_picture_that_moves_counts_as_its_root_mean_square():
    picture, half = texture(4), texture(4).shape[0] // 2
    moved = shifted(picture, 6.0)
    moved[:half] = picture[:half]
    assert motion_course([picture, moved])[1] == pytest.approx(6.0 / np.sqrt(2.0), rel=0.08)
