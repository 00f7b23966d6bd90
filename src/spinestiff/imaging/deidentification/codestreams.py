"""JPEG, JPEG-LS and JPEG 2000 streams without their comments: coded pixels pass unchanged, text beside them doesn't."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass

from spinestiff.errors import RadiographError

_SOI, _EOI, _SOS = 0xD8, 0xD9, 0xDA
_COM, _APP = 0xFE, range(0xE0, 0xF0)
# Frame headers of JPEG (all but DHT, JPG and DAC, which share their range) and JPEG-LS; they hold the size.
_FRAME = {0xF7, *range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
# DHT, DAC, DQT, DNL, DRI and the parameters of JPEG-LS: what decoding needs.
_TABLES = {0xC4, 0xCC, 0xDB, 0xDC, 0xDD, 0xF8}
# Where coded data end: 0xFF before a byte below 0x80 is stuffed data, D0 to D7 are restarts inside them.
_END_OF_DATA = re.compile(rb"\xff[\x80-\xcf\xd8-\xfe]")

_J2K_START, _J2K_END, _J2K_TILE, _J2K_DATA = b"\xff\x4f\xff\x51", b"\xff\xd9", 0xFF90, 0xFF93
_J2K_COM = 0xFF64
# CAP, SIZ, COD, COC, TLM, PLM, PLT, QCD, QCC, RGN, POC, PPM, PPT, CRG (ISO/IEC 15444-1, Annex A).
_J2K_KNOWN = {0xFF50, 0xFF51, 0xFF52, 0xFF53, *range(0xFF55, 0xFF59), *range(0xFF5C, 0xFF62), 0xFF63}


@dataclass(frozen=True)
class Codestream:
    """A coded frame without comments, application data and what trails behind its end.

    Attributes
    ----------
    content : the stream, of even length as DICOM wants it.
    rows, columns, components : as its header says.
    """

    content: bytes
    rows: int
    columns: int
    components: int


def without_comments(stream: bytes) -> Codestream:
    """A JPEG, JPEG-LS or JPEG 2000 stream with nothing in it but what decoding needs.

    Raises
    ------
    RadiographError : no such stream, one that is cut short, or one with parts that can't be told from a comment.
    """
    try:
        if stream[:2] == bytes((0xFF, _SOI)):
            return _jpeg(stream)
        if stream[:4] == _J2K_START:
            return _jpeg_2000(stream)
    except (struct.error, IndexError):
        raise RadiographError("a coded frame is cut short; copy the file again") from None
    raise RadiographError("a coded frame has no known header; export it uncompressed")


def _even(content: bytes) -> bytes:
    return content + b"\0" * (len(content) % 2)


def _jpeg(stream: bytes) -> Codestream:
    kept, at = [stream[:2]], 2
    size: tuple[int, int, int] | None = None
    while True:
        if stream[at] != 0xFF:
            raise RadiographError("a coded frame holds bytes between its segments; export it uncompressed")
        marker = stream[at + 1]
        if marker == 0xFF:  # fill
            at += 1
            continue
        if marker == _EOI:
            if size is None:
                raise RadiographError("a coded frame has no size in its header; export it uncompressed")
            return Codestream(_even(b"".join(kept) + bytes((0xFF, _EOI))), *size)
        (length,) = struct.unpack(">H", stream[at + 2 : at + 4])
        segment = stream[at : at + 2 + length]
        if len(segment) < 2 + length or length < 2:
            raise RadiographError("a coded frame is cut short; copy the file again")
        at += len(segment)
        if marker in _FRAME:
            rows, columns = struct.unpack(">2H", segment[5:9])
            size = rows, columns, segment[9]
        elif marker == _SOS:
            end = _END_OF_DATA.search(stream, at)
            if end is None:
                raise RadiographError("a coded frame is cut short; copy the file again")
            segment += stream[at : end.start()]
            at = end.start()
        elif marker == _COM or marker in _APP:
            continue
        elif marker not in _TABLES:
            raise RadiographError(f"a coded frame has an unknown segment ({marker:02X}); export it uncompressed")
        kept.append(segment)


def _jpeg_2000(stream: bytes) -> Codestream:
    """The main header without comments, and the tile-parts as they are if theirs hold none."""
    right, bottom, left, top = struct.unpack(">4I", stream[8:24])
    (components,) = struct.unpack(">H", stream[40:42])
    kept, at = [stream[:2]], 2
    while True:
        marker, length = struct.unpack(">2H", stream[at : at + 4])
        if marker == _J2K_TILE:
            break
        if marker != _J2K_COM:
            if marker not in _J2K_KNOWN:
                raise RadiographError(f"a coded frame has an unknown segment ({marker:04X}); export it uncompressed")
            kept.append(stream[at : at + 2 + length])
        at += 2 + length
    end = _end_of_tiles(stream, at)
    return Codestream(_even(b"".join(kept) + stream[at:end] + _J2K_END), bottom - top, right - left, components)


def _end_of_tiles(stream: bytes, at: int) -> int:
    """Index of the end marker; what trails behind it is not passed on."""
    while stream[at : at + 2] != _J2K_END:
        marker, _, _, length = struct.unpack(">HHHI", stream[at : at + 10])
        if marker != _J2K_TILE:
            raise RadiographError("a coded frame holds bytes between its tiles; export it uncompressed")
        _check_tile_header(stream, at + 12)
        if length == 0:  # the last tile-part may leave its length open: it ends with the stream
            end = stream.rfind(_J2K_END, at)
            if end < 0 or stream[end + 2 :].strip(b"\0"):
                raise RadiographError("a coded frame doesn't say where it ends; export it uncompressed")
            return end
        at += length
        if length < 14 or at + 2 > len(stream):
            raise RadiographError("a coded frame is cut short; copy the file again")
    return at


def _check_tile_header(stream: bytes, at: int) -> None:
    while (marker := struct.unpack(">H", stream[at : at + 2])[0]) != _J2K_DATA:
        if marker not in _J2K_KNOWN:
            raise RadiographError("a coded frame has comments inside its tiles; export it uncompressed")
        at += 2 + int(struct.unpack(">H", stream[at + 2 : at + 4])[0])
