"""Sharpness, noise and exposure of vertebrae, each told from the others."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from spinestiff.imaging.features import VertebraCorners
from spinestiff.imaging.image_quality import image_quality
from spinestiff.imaging.projection import frontal_view
from spinestiff.imaging.radiograph import Radiograph

VIEW = frontal_view(sid=1500.0, source_to_patient=1340.0, shape=(420, 200), pixel=(0.4, 0.4))
NAMES = ("T6", "T7", "T8", "T9", "T10")
QUADS = np.array([[[x + 120, y], [x + 60, y], [x + 60, y + 50], [x + 120, y + 50]] for x, y in
                  ((0, 20), (6, 90), (10, 160), (6, 230), (0, 300))], dtype=float)  # fmt: skip
MM = 0.4 * 1340.0 / 1500.0


def bones(seed: int = 4) -> np.ndarray:
    """Vertebrae with bright walls and some structure on soft tissue."""
    random = np.random.default_rng(seed)
    image = 2000.0 + 300.0 * cv2.GaussianBlur(random.normal(0.0, 1.0, VIEW.shape), (0, 0), 40.0) * 40.0
    for quad in QUADS:
        outline = np.rint(quad).astype(np.int32)
        body = np.zeros(VIEW.shape)
        cv2.fillConvexPoly(body, outline, 400.0)
        cv2.polylines(body, [outline], True, 900.0, 3)
        image += body
    texture = cv2.GaussianBlur(random.normal(0.0, 1.0, VIEW.shape), (0, 0), 1.5)
    return cv2.GaussianBlur(image + 300.0 * texture, (0, 0), 0.8)


def quality(*images: np.ndarray, names: tuple[str, ...] = NAMES):
    corners = VertebraCorners(NAMES, VIEW.from_pixels(QUADS)).selected(names)
    frames = [Radiograph(image.astype(np.float32), VIEW) for image in images]
    return image_quality(frames, [corners] * len(frames))


def noisy(image: np.ndarray, sd: float, seed: int = 1) -> np.ndarray:
    return image + np.random.default_rng(seed).normal(0.0, sd, image.shape)


def moved(image: np.ndarray, mm: float) -> np.ndarray:
    """Moving sideways during the exposure."""
    return cv2.blur(image, (max(round(mm / MM), 1), 1))


def test_motion_takes_sharpness_and_nothing_else_does():
    sharp = noisy(bones(), 20.0)
    blurred = [noisy(moved(bones(), mm), 20.0, 2) for mm in (1.0, 2.0, 4.0)]
    found = quality(sharp, *blurred)
    values = [frame.sharpness for frame in found]
    assert values[0] == 1.0
    assert values == sorted(values, reverse=True)
    # What docs/frame-selection.md and study/frame_selection.py say of them.
    assert values[1:] == pytest.approx([0.91, 0.72, 0.52], abs=0.02)
    same = quality(noisy(bones(), 20.0), 3.0 * noisy(bones(), 20.0, 3) + 500.0, noisy(bones(), 60.0, 5))
    assert [frame.sharpness for frame in same] == pytest.approx([1.0, 1.0, 1.0], abs=0.06)
    # Noise has slopes, too; they must not pass for sharpness.
    clean, *grainy = quality(noisy(bones(), 5.0), noisy(bones(), 200.0, 6), noisy(bones(), 300.0, 7))
    assert [frame.contrast_to_noise for frame in grainy] == pytest.approx([1.4, 1.0], abs=0.1)
    assert [frame.sharpness for frame in (clean, *grainy)] == pytest.approx([1.0, 1.0, 1.0], abs=0.05)


def test_a_vertebra_whose_edges_drown_in_noise_leaves_those_of_the_others():
    """Noise from pixel to pixel that no slope rises above, in the first vertebra alone and in all."""
    chequered = 4000.0 * (np.indices(VIEW.shape).sum(axis=0) % 2)
    above = np.arange(VIEW.shape[0])[:, None] < 80
    for frame in quality(*(noisy(bones(), 20.0, seed) + chequered * above for seed in (1, 2, 3))):
        assert frame.sharpness == pytest.approx(1.0, abs=0.06)
    for frame in quality(*(noisy(bones(), 20.0, seed) + chequered for seed in (1, 2, 3))):
        assert np.isnan(frame.sharpness)


def test_noise_is_measured():
    found = quality(noisy(bones(), 20.0), noisy(bones(), 40.0, 2), 2.0 * noisy(bones(), 40.0, 2))
    assert found[0].contrast_to_noise == pytest.approx(2.0 * found[1].contrast_to_noise, rel=0.1)
    assert found[2].contrast_to_noise == pytest.approx(found[1].contrast_to_noise, rel=1e-3)


def test_saturation_is_counted_where_vertebrae_are():
    image = noisy(bones(), 20.0)
    level = np.quantile(image, 0.9)
    clipped, elsewhere = np.minimum(image, level), image.copy()
    elsewhere[380:, :] = image.max()
    plain, over, outside = quality(image, clipped, elsewhere)
    assert plain.saturated < 0.001
    assert over.saturated > 0.1
    assert outside.saturated < 0.001


def test_only_vertebrae_seen_in_a_frame_count():
    image = noisy(bones(), 20.0)
    corners = VertebraCorners(NAMES, VIEW.from_pixels(QUADS))
    lost = np.array(corners.quality)
    lost[:3] = 0.0
    half = VertebraCorners(NAMES, corners.corners, lost)
    none = VertebraCorners(NAMES, corners.corners, 0.0 * lost)
    spoilt = image.copy()
    spoilt[:220] = cv2.GaussianBlur(image[:220], (0, 0), 5.0)  # where the lost ones are
    frames = [Radiograph(pixels.astype(np.float32), VIEW) for pixels in (image, spoilt, image)]
    whole, seen, nothing = image_quality(frames, [corners, half, none])
    assert seen.sharpness == pytest.approx(whole.sharpness, abs=0.02)
    assert np.isnan(nothing.sharpness)
    assert (nothing.contrast_to_noise, nothing.saturated) == (0.0, 0.0)
