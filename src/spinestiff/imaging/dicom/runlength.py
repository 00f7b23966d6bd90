"""RLE Lossless (PS3.5 Annex G): runs of bytes, one segment a byte of the pixel, no more than what is declared."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from spinestiff.errors import RadiographError
from spinestiff.imaging.dicom.streams import FILLER

MOST_TAKEN = 1
"""Bytes that end a segment and are the same as the filler behind it. Runs have no end mark, so filler could stand for
pixels that were cut off; a picture seldom ends in two bytes that are the filler's."""
_NOTHING = b"\x80"


def decode_rle(frame: bytes, rows: int, columns: int, width: int) -> NDArray[np.uint8 | np.uint16]:
    """(rows, columns) unsigned pixels of ``width`` bytes.

    Raises
    ------
    RadiographError : another number of segments, or segments that hold more or less than the declared size.
    """
    if len(frame) < 64:
        raise RadiographError("PixelData: a coded frame is cut short; copy the file again")
    segments, *offsets = struct.unpack("<16I", frame[:64])
    if segments != width:
        raise RadiographError(
            f"PixelData: found a coded frame of {segments} bytes a pixel, wanted {width}; export it again"
        )
    bounds = [*offsets[:segments], len(frame)]
    if bounds[0] < 64 or any(low >= high for low, high in zip(bounds, bounds[1:])):
        raise RadiographError("PixelData: a coded frame has segments out of order; copy the file again")
    # The first segment holds the most significant bytes.
    planes = [_segment(frame[low:high], rows * columns) for low, high in zip(bounds, bounds[1:])]
    pixels = np.stack(planes[::-1], axis=-1).view(f"<u{width}")
    return pixels.reshape(rows, columns)


def _segment(coded: bytes, count: int) -> NDArray[np.uint8]:
    found = bytearray()
    # A run or a literal of one byte takes two; what takes more is no picture.
    at, end = 0, min(len(coded), 2 * count + 2)
    while len(found) < count and at < end:
        head = coded[at]
        if head < 128:
            found += coded[at + 1 : at + 2 + head]
            at += 2 + head
        elif head > 128:
            found += coded[at + 1 : at + 2] * (257 - head)
            at += 2
        else:
            at += 1
    if len(found) != count:
        raise RadiographError(f"PixelData: found a coded frame of {len(found)} pixels, wanted {count}; export it again")
    behind = coded[at:]
    if behind.strip(FILLER + _NOTHING):
        raise RadiographError(
            f"PixelData: found a coded frame of more than {count} pixels, wanted {count}; export it again"
        )
    if len(behind) > 1 and at - len(coded[:at].rstrip(behind[:1])) > MOST_TAKEN:
        raise RadiographError("PixelData: a coded frame is cut short and filled up; copy the file again")
    return np.frombuffer(bytes(found), dtype=np.uint8)
