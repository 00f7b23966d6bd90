"""Headers of JPEG, JPEG-LS and JPEG 2000 streams, read by hand: size, depth, where the stream ends, if it does.

Decoders trust these headers, so they are compared with what the file declares before a decoder sees a byte
(ITU-T T.81 B.2, T.87 C.2, T.800 A.4-A.6).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from spinestiff.errors import RadiographError

_START, _END = b"\xff\xd8", b"\xff\xd9"
_START_2000, _START_OF_TILE = b"\xff\x4f\xff\x51", 0xFF90
_SCAN = 0xDA
_BOX_2000 = b"\x00\x00\x00\x0cjP  "
FILLER = b"\0\xff"
"""Bytes that encoders put behind the end of a frame, to an even length or to that of a buffer."""
_JPEG, _LOSSLESS, _LS = "JPEG", "JPEG Lossless", "JPEG-LS"
# Coding by the frame marker; progressive and arithmetic ones are no DICOM.
_CODINGS = {0xC0: _JPEG, 0xC1: _JPEG, 0xC3: _LOSSLESS, 0xF7: _LS}


@dataclass(frozen=True)
class StreamHeader:
    """What a coded frame says of itself; ``length`` in bytes, without filler behind its end."""

    coding: str
    rows: int
    columns: int
    components: int
    precision: int
    length: int


def starts_stream(fragment: bytes) -> bool:
    """Whether a fragment of pixel data is the first one of a frame."""
    return fragment.startswith((_START, _START_2000, _BOX_2000))


def stream_header(frame: bytes) -> StreamHeader:
    """The header of a coded frame.

    Raises
    ------
    RadiographError : no such stream, a stream cut short, or more than filler behind its end.
    """
    try:
        return _jpeg(frame) if frame[:2] == _START else _jpeg_2000(frame)
    except (struct.error, IndexError):
        raise RadiographError("PixelData: a coded frame is cut short; copy the file again") from None


def _jpeg(frame: bytes) -> StreamHeader:
    at, marker = 2, 0
    found: tuple[str, int, int, int, int] | None = None
    while marker != _SCAN:
        while frame[at : at + 2] == b"\xff\xff":  # fill bytes
            at += 1
        if frame[at] != 0xFF:
            raise RadiographError("PixelData: a coded frame has a damaged header; copy the file again")
        marker, length = frame[at + 1], struct.unpack(">H", frame[at + 2 : at + 4])[0]
        if marker in _CODINGS:
            if found is not None:
                raise RadiographError("PixelData: a coded frame has two sizes in its header; export it uncompressed")
            precision, rows, columns, components = struct.unpack(">BHHB", frame[at + 4 : at + 10])
            found = _CODINGS[marker], rows, columns, components, precision
        elif 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            raise RadiographError("PixelData: progressive or arithmetic JPEG is no DICOM; export it uncompressed")
        at += 2 + length
    if found is None:
        raise RadiographError("PixelData: a coded frame has no size in its header; export it uncompressed")
    # No coding lets these two bytes occur inside a scan.
    return StreamHeader(*found, _length(frame, frame.find(_END, at)))


def _jpeg_2000(frame: bytes) -> StreamHeader:
    start = frame.find(_START_2000)
    if start < 0:
        raise RadiographError("PixelData: a coded frame has no known header; export it uncompressed")
    right, bottom, left, top = struct.unpack(">4I", frame[start + 8 : start + 24])
    components, depth = struct.unpack(">HB", frame[start + 40 : start + 43])
    at = start + 2
    while (marker := struct.unpack(">H", frame[at : at + 2])[0]) != _START_OF_TILE:
        if marker >> 8 != 0xFF:
            raise RadiographError("PixelData: a coded frame has a damaged header; copy the file again")
        at += 2 + struct.unpack(">H", frame[at + 2 : at + 4])[0]
    while struct.unpack(">H", frame[at : at + 2])[0] == _START_OF_TILE:
        length = struct.unpack(">I", frame[at + 6 : at + 10])[0]
        if length == 0:  # the last part, up to the end of the stream
            at = frame.find(_END, at)  # no coded byte lets these two occur
            break
        at += max(length, 12)
    length = _length(frame, at if at >= 0 and frame[at : at + 2] == _END else -1)
    return StreamHeader("JPEG 2000", bottom - top, right - left, components, (depth & 0x7F) + 1, length)


def _length(frame: bytes, end: int) -> int:
    if end < 0:
        raise RadiographError("PixelData: a coded frame is cut short; copy the file again")
    behind = len(frame[end + 2 :].strip(FILLER))
    if behind:
        raise RadiographError(f"PixelData: a coded frame goes on behind its end for {behind} bytes; export it again")
    return end + 2
