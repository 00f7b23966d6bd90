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

# Standard deviations (mm, patient plane) of the compared bands: edges against the shading of the vertebrae. Motion by
# a millimetre takes the fine band away and leaves the coarse one.
FINE_MM, MIDDLE_MM, COARSE_MM = 0.35, 0.9, 3.0
AROUND = 1.35
"""A vertebra's outline is looked at to this multiple of its size."""
FEWEST_PIXELS = 60
_TO_SD = 1.4826  # of the median absolute deviation of a normal distribution


@dataclass(frozen=True)
class ImageQuality:
    """Of one frame of a push.

    Attributes
    ----------
    sharpness : fine structures of the vertebrae over the same vertebrae's in the sharpest frame, 0 to 1; NaN if no
        vertebra is seen in both.
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
    vertebrae = list(dict.fromkeys(name for measured in found for name in measured.sharpness))
    table = np.array([[measured.sharpness.get(name, np.nan) for name in vertebrae] for measured in found])
    # The sharpest frame differs a little from vertebra to vertebra, so frames are ranked by the typical ratio.
    sharpness = _typical_ratio(table)
    best = np.nanmax(sharpness, initial=0.0) or 1.0
    return tuple(
        ImageQuality(float(value / best), measured.contrast_to_noise, measured.saturated)
        for value, measured in zip(sharpness, found)
    )


@dataclass(frozen=True)
class _Measured:
    sharpness: dict[str, float]
    contrast_to_noise: float
    saturated: float


def _typical_ratio(table: Floats) -> Floats:
    """(F,) median over vertebrae of each frame's value (F, V) over the vertebra's own mean."""
    ratios = np.full(len(table), np.nan)
    seen = np.isfinite(table)
    means = np.array([table[seen[:, v], v].mean() if seen[:, v].any() else np.nan for v in range(table.shape[1])])
    for i, row in enumerate(table):
        if seen[i].any():
            ratios[i] = np.median(row[seen[i]] / means[seen[i]])
    return ratios


def _measured(frame: Radiograph, corners: VertebraCorners) -> _Measured:
    import cv2

    mm = float((frame.view.pixel_spacing / frame.view.magnification).mean())
    image = np.asarray(frame.pixels, dtype=np.float32)
    fine, middle, coarse = (cv2.GaussianBlur(image, (0, 0), max(s / mm, 0.3)) for s in (FINE_MM, MIDDLE_MM, COARSE_MM))
    ends = image.min(), image.max()
    quads = frame.view.pixels(corners.corners)
    sharpness, structure, noises, saturated, count = {}, [], [], 0, 0
    for name, quad, quality in zip(corners.vertebrae, quads, corners.quality):
        where = _within(quad, image.shape) if (quality > 0.0).any() else None
        if where is None or where[1].sum() < FEWEST_PIXELS:
            continue
        window, mask = where
        noise = _noise(image[window], mask)
        edges = (fine[window] - middle[window])[mask].var() - noise**2 * _passed(max(FINE_MM / mm, 0.3), MIDDLE_MM / mm)
        shading = (middle[window] - coarse[window])[mask].var()
        if shading > 0.0:
            sharpness[name] = float(np.sqrt(max(edges, 0.0) / shading))
        structure.append((middle[window] - coarse[window])[mask].std())
        noises.append(noise)
        values = image[window][mask]
        saturated += int(np.isin(values, ends).sum())
        count += len(values)
    if not count:
        return _Measured({}, 0.0, 0.0)
    contrast = float(np.median(structure) / max(float(np.median(noises)), 1e-9))
    return _Measured(sharpness, min(contrast, 1e6), saturated / count)


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


def _noise(window: NDArray[np.float32], mask: NDArray[np.bool_]) -> float:
    """Standard deviation of white noise, from second differences that slopes and straight edges don't reach."""
    import cv2

    # Immerkaer's mask, Computer Vision and Image Understanding 64 (1996) 300: of noise it has the sixfold deviation.
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    found = cv2.filter2D(window, cv2.CV_32F, kernel)[mask]
    return float(_TO_SD * np.median(np.abs(found)) / 6.0)


def _passed(fine: float, middle: float) -> float:
    """Share of white noise's variance that the difference of two Gaussians (standard deviations in pixels) passes."""
    return (1.0 / fine**2 + 1.0 / middle**2 - 4.0 / (fine**2 + middle**2)) / (4.0 * np.pi)
