"""Radiographs as the page shows them: 16-bit grey values of a whole frame or a part, no finer than the screen."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spinestiff.annotate.session import AnnotationSession
from spinestiff.errors import SubjectError
from spinestiff.imaging.features import picture_axes, view_kind
from spinestiff.imaging.radiograph import Radiograph, shrunk

GREY_LEVELS = 65535
LEAST_SIDE, MOST_SIDE = 16, 8192
"""Of a picture that is sent, pixels."""
WINDOW = (1.0, 99.8)
"""Percentiles of the grey values between which a radiograph is shown at first."""


def frame_of(session: AnnotationSession, image: str, frame: int) -> Radiograph:
    """A frame of an image, counted from 0. Raises SubjectError if there is none; RadiographError as ``read_push``."""
    frames = session.radiographs.frames(image)
    if not 0 <= frame < len(frames):
        raise SubjectError(f"{image} has no frame {frame}; wanted 0 to {len(frames) - 1}")
    return frames[frame]


def picture(
    radiograph: Radiograph, wide: int = MOST_SIDE, tall: int = MOST_SIDE, part: str = ""
) -> tuple[bytes, dict[str, Any]]:
    """Grey values of a frame, little endian, row by row, and what the page needs to know of them and of the view.

    Parameters
    ----------
    wide, tall : the most columns and rows that are sent; where there are more, means of them are.
    part : "left,top,right,bottom", whole pixels, the last two not in it; "": the whole frame.

    Raises
    ------
    SubjectError : a part outside the frame, a side of no sensible size.
    """
    across, down = radiograph.view.pixel_spacing
    grey, about = greys(radiograph.pixels, float(down / across), wide, tall, part)
    first, up = picture_axes(radiograph.view)
    return grey, {
        **about,
        "kind": view_kind(radiograph.view),
        "first": first.tolist(),
        "up": up.tolist(),
    }


def greys(
    pixels: NDArray[np.float32], aspect: float, wide: int = MOST_SIDE, tall: int = MOST_SIDE, part: str = ""
) -> tuple[bytes, dict[str, Any]]:
    """Grey values of pixels (H, W) that are ``aspect`` times as high as wide, and what the page needs to know of them
    alone. Other parameters and errors as of ``picture``."""
    if not (LEAST_SIDE <= wide <= MOST_SIDE and LEAST_SIDE <= tall <= MOST_SIDE):
        raise SubjectError(f"a picture of {wide} x {tall} pixels; wanted {LEAST_SIDE} to {MOST_SIDE}")
    left, top, right, bottom = _box(part, pixels.shape)
    # Of the whole frame: parts of it are shown beside each other.
    low, high = float(pixels.min()), float(pixels.max())
    shown = pixels[top:bottom, left:right]
    shown = shrunk(shown, wide, tall)
    grey = np.rint((shown - low) * np.float32(GREY_LEVELS / max(high - low, 1e-9))).astype("<u2")
    step = max(1, max(grey.shape) // 512)
    return grey.tobytes(), {
        "rows": pixels.shape[0],
        "columns": pixels.shape[1],
        # Of a pixel, width and height over the shorter of both.
        "shape": [max(1.0, 1.0 / aspect), max(1.0, aspect)],
        "part": [left, top, right, bottom],
        "shown": [grey.shape[1], grey.shape[0]],
        "window": np.percentile(grey[::step, ::step], WINDOW).tolist(),
    }


def _box(part: str, shape: tuple[int, ...]) -> tuple[int, int, int, int]:
    rows, columns = shape
    if not part:
        return 0, 0, columns, rows
    if not re.fullmatch(r"\d{1,5}(,\d{1,5}){3}", part):
        raise SubjectError("a part of a radiograph is left,top,right,bottom")
    left, top, right, bottom = (int(number) for number in part.split(","))
    if not (left < right <= columns and top < bottom <= rows):
        raise SubjectError(f"a part {part} outside the radiograph of {columns} columns, {rows} rows")
    return left, top, right, bottom
