"""How good a radiograph is where the vertebrae are: sharpness, noise, exposure (paper 2.1: "highest quality").

Vertebrae are compared with themselves in another frame of the same push, so that what they look like drops out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spinestiff.arrays import Floats
from spinestiff.imaging.features import VertebraCorners
from spinestiff.imaging.radiograph import Radiograph

# Standard deviations (mm, patient plane) at which slopes are compared. Motion by a millimetre or two takes those at the
# edges away and leaves those of the vertebrae as a whole.
FINE_MM, COARSE_MM = 0.35, 2.0
AROUND = 1.35
"""A vertebra's outline is looked at to this multiple of its size."""
FEWEST_PIXELS = 60
_TO_SD = 1.4826  # of the median absolute deviation of a normal distribution


@dataclass(frozen=True)
class ImageQuality:
    """Of one frame of a push.

    Attributes
    ----------
    sharpness : slopes at the vertebrae's edges over the same vertebrae's in the sharpest frame, 0 to 1, in the
        direction in which it is least (motion blurs in one); NaN if no vertebra is seen, or none above the noise.
    contrast_to_noise : standard deviation of the vertebrae's structures over that of the noise.
    saturated : share of the vertebrae's pixels at the end of the range of grey values.
    """

    sharpness: float
    contrast_to_noise: float
    saturated: float


def image_quality(frames: Sequence[Radiograph], corners: Sequence[VertebraCorners]) -> tuple[ImageQuality, ...]:
    """Quality of every frame of a push.

    Parameters
    ----------
    frames : F radiographs of one view.
    corners : F corners as tracked, mm on the detector; vertebrae without a usable corner are left out.
    """
    found = [_measured(frame, seen) for frame, seen in zip(frames, corners, strict=True)]
    vertebrae = list(dict.fromkeys(name for measured in found for name in measured.slopes))
    table = np.full((len(found), len(vertebrae), 2), np.nan)
    for row, measured in zip(table, found):
        for name, slopes in measured.slopes.items():
            row[vertebrae.index(name)] = slopes
    sharpness = np.column_stack([_typical_ratio(table[..., direction]) for direction in (0, 1)])
    best = [np.nanmax(column, initial=0.0) or 1.0 for column in sharpness.T]
    return tuple(
        ImageQuality(float((value / best).min()), measured.contrast_to_noise, measured.saturated)
        for value, measured in zip(sharpness, found)
    )


@dataclass(frozen=True)
class _Measured:
    slopes: dict[str, tuple[float, float]]  # along columns and rows, fine over coarse
    contrast_to_noise: float
    saturated: float


def _typical_ratio(table: Floats) -> Floats:
    """(F,) median over vertebrae of each frame's value (F, V) over the vertebra's own mean, where that is above 0."""
    ratios = np.full(len(table), np.nan)
    seen = np.isfinite(table)
    means = np.array([table[seen[:, v], v].mean() if seen[:, v].any() else np.nan for v in range(table.shape[1])])
    for i, row in enumerate(table):
        told = seen[i] & (means > 0.0)
        if told.any():
            ratios[i] = np.median(row[told] / means[told])
    return ratios


def _measured(frame: Radiograph, corners: VertebraCorners) -> _Measured:
    import cv2

    frame = frame.squared()
    mm = float(frame.view.pixel_spacing[0] / frame.view.magnification)
    image = np.asarray(frame.pixels, dtype=np.float32)
    scales = [max(sigma / mm, 0.6) for sigma in (FINE_MM, COARSE_MM)]
    fine, coarse = (cv2.GaussianBlur(image, (0, 0), scale) for scale in scales)
    noise_slope = _noise_slope(scales[0])
    ends = image.min(), image.max()
    quads = frame.view.pixels(corners.corners)
    slopes, structure, noises, saturated, count = {}, [], [], 0, 0
    for name, quad, quality in zip(corners.vertebrae, quads, corners.quality):
        where = _within(quad, image.shape) if (quality > 0.0).any() else None
        if where is None or where[1].sum() < FEWEST_PIXELS:
            continue
        window, mask = where
        noise = _noise(image[window], mask)
        found = [
            [np.mean(np.gradient(blurred[window], axis=axis)[mask] ** 2) for axis in (1, 0)]
            for blurred in (fine, coarse)
        ]
        edges = np.maximum(np.array(found[0]) - noise**2 * noise_slope, 0.0)
        if min(found[1]) > 0.0:
            along, down = np.sqrt(edges / np.array(found[1]))
            slopes[name] = (float(along), float(down))
        structure.append(fine[window][mask].std())
        noises.append(noise)
        values = image[window][mask]
        saturated += int(np.isin(values, ends).sum())
        count += len(values)
    if not count:
        return _Measured({}, 0.0, 0.0)
    contrast = float(np.median(structure) / max(float(np.median(noises)), 1e-9))
    return _Measured(slopes, min(contrast, 1e6), saturated / count)


def _within(quad: Floats, shape: tuple[int, ...]) -> tuple[tuple[slice, slice], NDArray[np.bool_]] | None:
    """The window of the image around a vertebra, and which of its pixels belong to it; None outside the image."""
    import cv2

    outline = quad.mean(axis=0) + AROUND * (quad - quad.mean(axis=0))
    low = np.maximum(np.floor(outline.min(axis=0)).astype(int), 0)
    high = np.minimum(np.ceil(outline.max(axis=0)).astype(int) + 1, np.array(shape[::-1]))
    if (high - low < 3).any():
        return None
    mask = np.zeros((high - low)[::-1], np.uint8)
    cv2.fillConvexPoly(mask, np.rint(outline - low).astype(np.int32), 1)
    return (slice(low[1], high[1]), slice(low[0], high[0])), mask.astype(bool)


def _noise_slope(sigma: float) -> float:
    """Mean squared slope along an axis that white noise of standard deviation 1 keeps under a Gaussian's smoothing.

    Slopes between pixels two apart are less than those of the Gaussian itself, whose square would be three times as
    large where its width is 0.6 pixels.
    """
    import cv2

    middle = int(np.ceil(5.0 * sigma)) + 2
    point = np.zeros((2 * middle + 1, 2 * middle + 1), np.float32)
    point[middle, middle] = 1.0
    return float(np.sum(np.gradient(cv2.GaussianBlur(point, (0, 0), sigma), axis=1) ** 2))


def _noise(window: NDArray[np.float32], mask: NDArray[np.bool_]) -> float:
    """Standard deviation of white noise, from second differences that slopes and straight edges don't reach."""
    import cv2

    # Immerkaer's mask, Computer Vision and Image Understanding 64 (1996) 300: of noise it has the sixfold deviation.
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    found = cv2.filter2D(window, cv2.CV_32F, kernel)[mask]
    return float(_TO_SD * np.median(np.abs(found)) / 6.0)
