"""Pictures to look for burned-in text in: the whole image, and its edges and corners enlarged with local contrast."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

BAND = 0.14
"""Height of the top and the bottom band, as a share of the image's; systems write into the corners."""
_WIDTH, _THUMB, _GAP, _TITLE = 1500, 640, 8, 30

Grey = NDArray[np.uint8]


def inspection_row(frames: NDArray[np.generic], title: str) -> Grey:
    """One image as a row of a sheet: the whole, and beside it the top band over the bottom band.

    Parameters
    ----------
    frames : (F, H, W) stored values. Of several frames the largest and the smallest value of each pixel are shown, so
        that text in any frame shows.
    title : printed above; holds no patient data.
    """
    pictures = [("", frames[0])]
    if len(frames) > 1:
        pictures = [("largest of all frames", frames.max(axis=0)), ("smallest of all frames", frames.min(axis=0))]
    return np.concatenate([_row(picture, ", ".join(filter(None, (title, what)))) for what, picture in pictures])


def sheet(rows: Sequence[Grey]) -> bytes:
    """Rows one above the other, as a PNG file."""
    import cv2

    return cv2.imencode(".png", np.concatenate(rows))[1].tobytes()


def _row(picture: NDArray[np.generic], title: str) -> Grey:
    import cv2

    shown = _stretched(picture, 0.0)
    height = max(round(BAND * len(shown)), 1)
    # Local contrast shows text of any grey on any ground.
    equalise = cv2.createCLAHE(clipLimit=8.0, tileGridSize=(4, 16))
    whole = _fitted(_stretched(picture, 0.5), _THUMB, _THUMB)
    room = _WIDTH - _THUMB - 3 * _GAP
    bands = [
        _fitted(np.asarray(equalise.apply(band), np.uint8), room, (_THUMB - _GAP) // 2)
        for band in (shown[:height], shown[-height:])
    ]
    row = np.full((_TITLE + _THUMB + _GAP, _WIDTH), 255, np.uint8)
    row[_TITLE : _TITLE + whole.shape[0], _GAP : _GAP + whole.shape[1]] = whole
    for index, band in enumerate(bands):
        top = _TITLE + index * ((_THUMB - _GAP) // 2 + _GAP)
        left = _THUMB + 2 * _GAP
        row[top : top + band.shape[0], left : left + band.shape[1]] = band
    text = f"{title}: whole image; top and bottom {100 * BAND:.0f} % enlarged"
    cv2.putText(row, text, (_GAP, 21), cv2.FONT_HERSHEY_SIMPLEX, 0.55, 0, 1, cv2.LINE_AA)
    return row


def _stretched(picture: NDArray[np.generic], left_out: float) -> Grey:
    """Grey from the smallest to the largest value, but for a percentage left out at each end."""
    values = picture.astype(np.float32)
    low, high = np.percentile(values, [left_out, 100.0 - left_out])
    return np.asarray(np.clip((values - low) * (255.0 / max(high - low, 1e-6)), 0.0, 255.0), dtype=np.uint8)


def _fitted(picture: Grey, width: int, height: int) -> Grey:
    """The picture at its own proportions in a box."""
    import cv2

    scale = min(width / picture.shape[1], height / picture.shape[0])
    size = max(int(picture.shape[1] * scale), 1), max(int(picture.shape[0] * scale), 1)
    smaller = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(picture, size, interpolation=smaller), dtype=np.uint8)
