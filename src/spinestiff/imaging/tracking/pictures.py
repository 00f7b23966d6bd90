"""The pixels of a sequence in the form that tracking takes: checked, square, binned, matched, filtered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from spinestiff.arrays import Floats
from spinestiff.errors import TrackingError

if TYPE_CHECKING:
    from spinestiff.imaging.projection import XRayView
    from spinestiff.imaging.radiograph import Radiograph

Image = NDArray[np.float32]

# Pictures finer than this (mm at the patient plane) are binned first: noise shrinks and flow needs its time.
FINEST_MM = 0.3
# Standard deviations in mm at the patient plane: what is registered, coarse then fine, and the shading taken off.
SMOOTHING_MM = (1.2, 0.3)
SHADING_MM = 3.0


@dataclass(frozen=True)
class Pictures:
    """The frames' pixels, square, and binned by a whole factor where they are finer than tracking needs.

    Attributes
    ----------
    images : (F) of (H, W), in standard deviations of the first.
    view : of the frames with square pixels.
    factor : such pixels along the side of a bin.
    """

    images: tuple[Image, ...]
    view: XRayView
    factor: int

    @property
    def mm(self) -> float:
        """A bin's side at the patient plane."""
        return float(self.view.pixel_spacing[0] / self.view.magnification) * self.factor

    @staticmethod
    def of(frames: Sequence[Radiograph]) -> Pictures:
        if not frames:
            raise TrackingError("no frames to track through; wanted at least the annotated one")
        first = frames[0]
        view = first.squared().view
        factor = max(1, int(FINEST_MM * view.magnification / float(view.pixel_spacing[0])))
        images = []
        for number, frame in enumerate(frames):  # once: frames of a large file are read when they are asked for
            _check_frame(number, frame, first)
            images.append(block_means(frame.squared().pixels, factor))
        middle, spread = images[0].mean(), images[0].std()
        if not spread > 0.0:
            raise TrackingError("the first frame is one grey value; wanted a radiograph")
        return Pictures(tuple((image - middle) / spread for image in images), view, factor)

    def binned(self, detector_mm: Floats) -> Floats:
        """Positions on the detector, mm, to positions in ``images``."""
        return np.asarray((self.view.pixels(detector_mm) - 0.5 * (self.factor - 1)) / self.factor)

    def unbinned(self, bins: Floats) -> Floats:
        """Inverse of ``binned``."""
        return self.view.from_pixels(bins * self.factor + 0.5 * (self.factor - 1))


def block_means(pixels: Image, factor: int) -> Image:
    """Means over squares of ``factor`` pixels; what fills none at the last edges is left out."""
    if factor == 1:
        return np.asarray(pixels, dtype=np.float32)
    rows, columns = (n // factor for n in pixels.shape)
    blocks = pixels[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor)
    return np.asarray(blocks.mean(axis=(1, 3)), dtype=np.float32)


def as_bytes(image: Image) -> NDArray[np.uint8]:
    """The image's own middle range of grey values as 0..255, the form that flow takes."""
    low, high = np.percentile(image, [0.5, 99.5])
    return np.asarray(np.clip(np.rint((image - low) * (255.0 / max(high - low, 1e-9))), 0, 255), dtype=np.uint8)


def matched(image: NDArray[np.uint8], reference: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The image with the reference's histogram (paper 2.2)."""
    from skimage.exposure import match_histograms

    matched = np.rint(match_histograms(image, reference))
    return np.asarray(np.clip(matched, 0, 255), dtype=np.uint8)


def levels(image: Image, mm: float) -> list[Image]:
    """Structures between noise and soft-tissue shading, which does not move with the bones; coarse, then fine."""
    import cv2

    shading = cv2.GaussianBlur(image, (0, 0), SHADING_MM / mm)
    return [np.asarray(cv2.GaussianBlur(image, (0, 0), sigma / mm) - shading, np.float32) for sigma in SMOOTHING_MM]


def sampled(image: Image, points: Floats) -> Floats:
    """Values (n,) or (n, c) at points (n, 2), linear between pixels, the border's beyond it."""
    column = np.clip(points[:, 0], 0.0, image.shape[1] - 1.001)
    row = np.clip(points[:, 1], 0.0, image.shape[0] - 1.001)
    j, i = column.astype(np.intp), row.astype(np.intp)
    extra = (slice(None),) + (None,) * (image.ndim - 2)
    a, b = (column - j)[extra], (row - i)[extra]
    upper = (1.0 - a) * image[i, j] + a * image[i, j + 1]
    lower = (1.0 - a) * image[i + 1, j] + a * image[i + 1, j + 1]
    return np.asarray((1.0 - b) * upper + b * lower)


def inside(points: Floats, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Whether points (..., 2) lie on an image of that shape."""
    rows, columns = shape
    return np.asarray((points >= -0.5).all(-1) & (points[..., 0] <= columns - 0.5) & (points[..., 1] <= rows - 0.5))


def check_inside(points: Floats, shape: tuple[int, ...], frame: int, names: Sequence[str]) -> None:
    """Raise TrackingError, naming what lies outside frame number ``frame``."""
    for name, within in zip(names, inside(points, shape)):
        if not np.all(within):
            raise TrackingError(f"{name} lies outside frame {frame} of {shape[1]} columns and {shape[0]} rows")


def _check_frame(number: int, frame: Radiograph, first: Radiograph) -> None:
    if frame.pixels.shape != first.pixels.shape:
        raise TrackingError(
            f"frame {number} has shape {frame.pixels.shape}, frame 0 {first.pixels.shape}; wanted one size"
        )
    if not np.allclose(frame.view.pixel_spacing, first.view.pixel_spacing) or not np.isclose(
        frame.view.magnification, first.view.magnification
    ):
        raise TrackingError(
            f"frame {number} has another pixel spacing or magnification than frame 0; wanted one geometry"
        )
