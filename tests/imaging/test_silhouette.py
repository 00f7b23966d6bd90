"""The rim's point seen farthest out, against a search over the rim, and its derivative against differences."""

import numpy as np
import pytest

from spinestiff.imaging.silhouette import rim_share, rim_share_slope

FRONTAL, LATERAL = 2, 0


def case(seed: int, depth: int):
    """Middle, half difference and ray of a corner: a vertebra's sizes, seen up to 30 degrees aslant."""
    random = np.random.default_rng(seed)
    middle = random.uniform([15.0, 9.0, 12.0], [25.0, 14.0, 18.0]) * random.choice([-1.0, 1.0], 3)
    middle[depth] = random.uniform(-2.0, 2.0)
    half = random.uniform(-1.0, 1.0, 3)
    half[depth] = random.uniform(10.0, 20.0)
    ray = random.uniform(-0.5, 0.5, 3) * 1000.0
    ray[depth] = 1000.0 * random.choice([-1.0, 1.0])
    return middle, half, ray


@pytest.mark.parametrize("depth", [FRONTAL, LATERAL])
@pytest.mark.parametrize("seed", range(5))
def test_no_point_of_the_rim_is_seen_farther_out(seed: int, depth: int) -> None:
    """Points of the rim, carried along the ray into the plane of the middle, against outwards in half sizes."""
    middle, half, ray = case(seed, depth)
    angle = np.deg2rad(np.arange(-89.0, 89.01, 0.02))
    across = middle.copy()
    across[[1, depth]] = 0.0
    rim = (middle - across) + np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * half
    seen = rim - (rim[:, [depth]] - middle[depth]) / ray[depth] * ray
    others = [axis for axis in range(3) if axis != depth]
    outwards = np.sum(seen[:, others] / middle[others], axis=1)
    best = np.sin(angle[np.argmax(outwards)])
    assert abs(best) > 0.01
    assert rim_share(middle, half, ray, depth) == pytest.approx(best, abs=2e-3)


@pytest.mark.parametrize("depth", [FRONTAL, LATERAL])
def test_the_slope_agrees_with_differences(depth: int) -> None:
    at = [np.stack(parts) for parts in zip(*(case(seed, depth) for seed in range(5)))]
    random = np.random.default_rng(9)
    slopes = tuple(random.normal(size=(5, 3, 4)) for _ in at)
    found = rim_share_slope(*at, depth, slopes)
    assert found.shape == (5, 4)
    for unknown in range(4):
        step = 1e-5
        ahead, behind = (
            rim_share(*(value + sign * step * slope[:, :, unknown] for value, slope in zip(at, slopes)), depth)
            for sign in (1.0, -1.0)
        )
        assert found[:, unknown] == pytest.approx((ahead - behind) / (2.0 * step), rel=1e-6, abs=1e-9)


def test_a_plate_seen_edge_on_shows_the_middle_of_its_rim() -> None:
    middle, half, ray = np.array([20.0, 12.0, 0.0]), np.array([0.0, 0.0, 15.0]), np.array([0.0, 0.0, -900.0])
    assert rim_share(middle, half, ray, FRONTAL) == 0.0
    # Tipped so that the front rises, the upper plate shows it: tan a = 2 * 15 * 0.3 / 24.
    tipped = np.array([0.0, 0.3 * 900.0, -900.0])
    assert rim_share(middle, half, tipped, FRONTAL) == pytest.approx(np.sin(np.arctan(0.375)))
