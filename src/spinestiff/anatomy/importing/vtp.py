"""VTK's XML polygon files (.vtp), read without VTK: ASCII, base64 and raw data, zlib or none, triangles from polygons.

No entity is expanded, no file named inside is opened, and nothing grows beyond the caps of its caller.
"""

from __future__ import annotations

import base64
import binascii
import re
import xml.etree.ElementTree as ElementTree
import zlib
from typing import Any

import numpy as np

from spinestiff.arrays import Floats, Ints

_APPENDED = re.compile(rb"<AppendedData([^>]*)>\s*_")
_TYPES = {f"{sign}Int{8 * size}": f"{sign[:1].lower() or 'i'}{size}" for sign in ("", "U") for size in (1, 2, 4, 8)}
_TYPES |= {"Float32": "f4", "Float64": "f8"}


class VtpError(ValueError):
    """Not a .vtp file this module reads; the text says why."""


def read_vtp(content: bytes, most_bytes: int) -> tuple[Floats, Ints]:
    """Vertices (n, 3) and triangles (m, 3) of a .vtp file; polygons become fans, strips are unrolled.

    Raises
    ------
    VtpError : damaged, of another kind, or the numbers that are read would take more than ``most_bytes``, 8 each.
    """
    content, appended = _split(content)
    if b"<!DOCTYPE" in content or b"<!ENTITY" in content or b"\0" in content or b"encoding='utf-16" in content.lower():
        raise VtpError("it declares a document type or entities, which no VTK file needs")
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise VtpError(f"no well-formed XML ({error})") from None
    if root.tag != "VTKFile" or root.get("type") != "PolyData":
        raise VtpError("no VTK file of type PolyData")
    reader = _Arrays(root, appended, most_bytes)
    pieces = root.findall("./PolyData/Piece")
    if not pieces:
        raise VtpError("no piece of polygons inside")
    vertices: list[Floats] = []
    faces: list[Ints] = []
    for piece in pieces:
        before = sum(map(len, vertices))
        points = piece.find("Points/DataArray")
        if points is None:
            raise VtpError("no points")
        flat = reader.read(points).astype(float)
        if len(flat) % 3:
            raise VtpError(f"{len(flat)} coordinates, no multiple of three")
        vertices.append(flat.reshape(-1, 3))
        for kind, triangles in (("Polys", _fans), ("Strips", _unrolled)):
            ends, corners = (piece.find(f"{kind}/DataArray[@Name='{name}']") for name in ("offsets", "connectivity"))
            offsets = np.zeros(0, dtype=np.int64) if ends is None else reader.read(ends).astype(np.int64)
            if not len(offsets):
                continue
            if corners is None:
                raise VtpError(f"{kind} without connectivity")
            faces.append(triangles(reader.read(corners).astype(np.int64), offsets) + before)
    if not faces:
        raise VtpError("no polygons")
    return np.vstack(vertices), np.vstack(faces)


def _split(content: bytes) -> tuple[bytes, tuple[bytes, bool]]:
    # Raw data is no XML: it is cut out before the rest is parsed. Also tells whether it is base64.
    found = _APPENDED.search(content)
    if found is None:
        return content, (b"", False)
    end = content.rfind(b"</AppendedData>")
    if end < found.end():
        raise VtpError("its appended data has no end")
    encoded = b"base64" in found.group(1)
    return content[: found.end()] + content[end:], (content[found.end() : end], encoded)


def _fans(connectivity: Ints, offsets: Ints) -> Ints:
    starts = _starts(connectivity, offsets)
    sizes = offsets - starts
    parts = []
    for size in np.unique(sizes[sizes >= 3]):
        corner = connectivity[starts[sizes == size][:, None] + np.arange(size)]
        first = np.repeat(corner[:, :1], size - 2, axis=1)
        parts.append(np.stack([first, corner[:, 1:-1], corner[:, 2:]], -1).reshape(-1, 3))
    return np.vstack(parts) if parts else np.zeros((0, 3), dtype=np.int64)


def _unrolled(connectivity: Ints, offsets: Ints) -> Ints:
    faces = []
    for start, end in zip(_starts(connectivity, offsets).tolist(), offsets.tolist()):
        strip = connectivity[start:end]
        some = np.stack([strip[:-2], strip[1:-1], strip[2:]], -1)
        some[1::2] = some[1::2][:, [1, 0, 2]]
        faces.append(some)
    return np.vstack(faces)


def _starts(connectivity: Ints, offsets: Ints) -> Ints:
    starts = np.concatenate([[0], offsets[:-1]])
    if (offsets < starts).any() or offsets[-1] != len(connectivity) or starts.min() < 0:
        raise VtpError("its polygons' offsets don't fit their corners")
    return starts


class _Arrays:
    # Decodes DataArray elements as the file's header says. All share ``left``: how many bytes their numbers may still
    # take, each 8 once it is read.

    def __init__(self, root: ElementTree.Element, appended: tuple[bytes, bool], most_bytes: int) -> None:
        order = {"LittleEndian": "<", "BigEndian": ">"}.get(root.get("byte_order", "LittleEndian"))
        header = {"UInt32": "u4", "UInt64": "u8"}.get(root.get("header_type", "UInt32"))
        compressor = root.get("compressor", "")
        if order is None or header is None:
            raise VtpError("unknown byte order or header type")
        if compressor not in ("", "vtkZLibDataCompressor"):
            raise VtpError(f"packed by {compressor[:40]}; write it uncompressed or with zlib")
        self.order, self.header, self.packed = order, np.dtype(order + header), bool(compressor)
        self.appended, self.encoded = appended
        self.left = most_bytes

    def read(self, array: ElementTree.Element) -> Any:
        numbers = self._read(array)
        self.left -= 8 * len(numbers)
        return numbers

    def _read(self, array: ElementTree.Element) -> Any:
        kind = _TYPES.get(array.get("type", ""))
        if kind is None:
            raise VtpError(f"unknown number type {array.get('type', '')[:20]!r}")
        form = array.get("format", "ascii")
        if form == "ascii":
            words = (array.text or "").split(maxsplit=self.left // 8)
            if 8 * len(words) > self.left:
                raise VtpError("larger than allowed")
            try:
                return np.array([float(word) for word in words])
            except ValueError:
                raise VtpError("its ASCII data holds something that is no number") from None
        dtype = np.dtype(self.order + kind)
        most_bytes = self.left // 8 * dtype.itemsize
        if form == "binary":
            data = self._base64((array.text or "").strip().encode("ascii", "replace"), most_bytes)
        elif form == "appended":
            try:
                offset = int(array.get("offset", "0"))
            except ValueError:
                raise VtpError("an offset is no number") from None
            if not 0 <= offset <= len(self.appended):
                raise VtpError("an offset leads out of the file")
            rest = memoryview(self.appended)[offset:]
            data = self._base64(bytes(rest), most_bytes) if self.encoded else self._raw(rest, most_bytes)
        else:
            raise VtpError(f"unknown data format {form[:20]!r}")
        if len(data) % dtype.itemsize:
            raise VtpError("an array ends inside a number")
        return np.frombuffer(data, dtype)

    def _numbers(self, data: bytes | memoryview, count: int) -> list[int]:
        if len(data) < count * self.header.itemsize:
            raise VtpError("an array ends inside its header")
        return [int(v) for v in np.frombuffer(data, self.header, count)]

    def _base64(self, text: bytes, most_bytes: int) -> bytes:
        # The header may be encoded by itself (always where data is packed) or together with the data.
        size = self.header.itemsize
        if self.packed:
            blocks = self._numbers(_decoded(text[: _encoded_length(size)]), 1)[0]
            if not 0 <= blocks <= most_bytes // 1024 + 1:
                raise VtpError("larger than allowed")
            length = _encoded_length((3 + blocks) * size)
            return self._raw(memoryview(_decoded(text[:length]) + _decoded(text[length:], loose=True)), most_bytes)
        alone = _encoded_length(size)
        if text[:alone].endswith(b"="):
            return self._raw(memoryview(_decoded(text[:alone]) + _decoded(text[alone:], loose=True)), most_bytes)
        return self._raw(memoryview(_decoded(text, loose=True)), most_bytes)

    def _raw(self, data: memoryview, most_bytes: int) -> bytes:
        size = self.header.itemsize
        if not self.packed:
            length = self._numbers(data, 1)[0]
            if length > len(data) - size:
                raise VtpError("an array is cut short")
            if length > most_bytes:
                raise VtpError("larger than allowed")
            return bytes(data[size : size + length])
        blocks = self._numbers(data, 1)[0]
        if not blocks:
            return b""
        if blocks > most_bytes // 1024 + 1:
            raise VtpError("larger than allowed")
        _, block, last, *packed = self._numbers(data, 3 + blocks)
        whole = (blocks - 1) * block + (last or block)
        if whole > most_bytes:
            raise VtpError("larger than allowed")
        at, parts = (3 + blocks) * size, []
        for i, length in enumerate(packed):
            unpacker = zlib.decompressobj()
            wanted = last if last and i == blocks - 1 else block
            try:
                parts.append(unpacker.decompress(bytes(data[at : at + length]), wanted or 1))
            except zlib.error as error:
                raise VtpError(f"a packed block is damaged ({error})") from None
            if len(parts[-1]) != wanted:
                raise VtpError("a packed block is cut short")
            at += length
        return b"".join(parts)


def _encoded_length(size: int) -> int:
    return 4 * -(-size // 3)


def _decoded(text: bytes, loose: bool = False) -> bytes:
    # ``loose``: the text goes on behind the padding (appended data); only what comes before belongs to the array.
    text = b"".join(text.split())
    if loose and (end := text.find(b"=")) >= 0:
        text = text[: _encoded_length(3 * (end // 4) + 1)]
    try:
        return base64.b64decode(text[: len(text) // 4 * 4], validate=True)
    except (binascii.Error, ValueError):
        raise VtpError("its base64 data is damaged") from None
