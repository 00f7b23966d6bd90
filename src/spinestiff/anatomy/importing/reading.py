"""Surfaces from files people have: STL, OBJ, PLY and VTP, with caps, and one line about what can't be read."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Literal

import numpy as np

from spinestiff.anatomy.importing.vtp import VtpError, read_vtp
from spinestiff.anatomy.template.surfaces import Surface
from spinestiff.errors import TorsoError
from spinestiff.files import regular_file

SUFFIXES = (".stl", ".obj", ".ply", ".vtp")
MOST_BYTES = 200_000_000
MOST_VTP_BYTES = 2 * MOST_BYTES  # of a VTP file's numbers once they are read: 8 each, more than most files hold
MOST_FACES = 2_000_000
_PLY_BYTES = {
    name: size
    for size, names in ((1, b"char uchar int8 uint8"), (2, b"short ushort int16 uint16"),
                        (4, b"int uint int32 uint32 float float32"), (8, b"double float64"))
    for name in names.split()
}  # fmt: skip
_ASCII = bytes(range(128)) + b"?" * 128
FARTHEST = 1e7  # of a coordinate, in any unit: beyond it, distances are lost in rounding


def read_surface(path: Path) -> Surface:
    """Vertices (n, 3) of triangles in the file's unit and axes, and triangles (m, 3), as they stand in the file.

    Raises
    ------
    TorsoError : unreadable, empty, too large, not finite, or a triangle names a vertex that isn't there.
    """
    kind = path.suffix.lower()
    if kind not in SUFFIXES:
        raise TorsoError(f"{path.name}: unknown kind of file; wanted one of {', '.join(SUFFIXES)}")
    try:
        size = regular_file(path, TorsoError, name=path.name).st_size
        if size > MOST_BYTES:
            raise TorsoError(f"{path.name} has {size / 1e6:.0f} MB; at most {MOST_BYTES / 1e6:.0f} MB, so thin it out")
        content = path.read_bytes()
    except OSError as error:
        raise TorsoError(f"{path.name}: {(error.strerror or 'unreadable').lower()}") from None
    if not content.strip():
        raise TorsoError(f"{path.name} is empty")
    vertices, faces = _parsed(path, kind, content)
    if not len(vertices) or not len(faces):
        raise TorsoError(f"{path.name} holds no triangles")
    if len(faces) > MOST_FACES:
        raise TorsoError(f"{path.name} has {len(faces):,} triangles; at most {MOST_FACES:,}, so thin it out")
    if faces.min() < 0 or faces.max() >= len(vertices):
        wrong = int(faces.max() if faces.min() >= 0 else faces.min())
        raise TorsoError(f"{path.name}: a triangle names vertex {wrong}, but there are {len(vertices)}, from 0 on")
    used, number = np.unique(faces, return_inverse=True)
    vertices = vertices[used]
    if not np.isfinite(vertices).all():
        raise TorsoError(f"{path.name} has a vertex that is no finite number")
    if np.abs(vertices).max() > FARTHEST:
        raise TorsoError(f"{path.name} has a coordinate of {np.abs(vertices).max():.3g}; wanted below {FARTHEST:g}")
    return vertices, number.reshape(faces.shape)


def _parsed(path: Path, kind: str, content: bytes) -> Surface:
    if kind == ".vtp":
        try:
            return read_vtp(content, MOST_VTP_BYTES)
        except VtpError as error:
            raise TorsoError(f"{path.name} can't be read as VTP: {error}") from None
    # A zero byte is in no text, and in every binary STL.
    if kind == ".stl" and b"\0" in content and len(content) != (whole := _binary_stl_bytes(content)):
        raise TorsoError(
            f"{path.name} has {len(content):,} bytes, but by its number of triangles {whole:,}; copy or export it again"
        )
    import trimesh

    try:
        # From bytes and without a resolver: no material or texture that the file names is looked for.
        plain = io.BytesIO(_plain(content, kind))
        loaded = trimesh.load(plain, file_type=kind[1:], force="mesh", process=False, skip_materials=True)
        vertices = np.asarray(loaded.vertices, dtype=float).reshape(-1, 3)
        faces = np.asarray(loaded.faces, dtype=np.int64).reshape(-1, 3)
    except Exception as error:  # a foreign parser on foreign bytes: whatever it raises, the file is at fault
        corners = _corners_of_faces(content) if kind == ".ply" else set()
        if len(corners) > 1:
            raise TorsoError(
                f"{path.name} has faces of {min(corners)} to {max(corners)} corners, wanted triangles alone, as it "
                "is a binary PLY; make triangles of them in the program that it comes from, or export it as STL or OBJ"
            ) from None
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise TorsoError(f"{path.name} can't be read as {kind[1:].upper()} ({reason})") from None
    # A text PLY that was cut short passes the parser; a polygon gives a triangle or more.
    promised = re.search(rb"^element face (\d{1,12})\s*$", content, re.MULTILINE) if kind == ".ply" else None
    if promised is not None and len(faces) < int(promised[1]):
        raise TorsoError(f"{path.name} says {int(promised[1])} faces, but holds {len(faces)}; copy the file again")
    return vertices, faces


def _corners_of_faces(content: bytes) -> set[int]:
    """Numbers of corners that the faces of a binary PLY have; none where they can't be told, as of a file cut short."""
    head, _, body = content.partition(b"end_header")
    body = body[body.find(b"\n") + 1 :]
    if b"format binary" not in head:
        return set()
    order: Literal["little", "big"] = "big" if b"binary_big_endian" in head else "little"
    elements: list[tuple[int, dict[bytes, list[int]]]] = []  # how many, and the bytes of each one's properties
    corners: set[int] = set()
    at = 0
    try:
        for words in (line.split() for line in head.splitlines()):
            if words[:1] == [b"element"]:
                elements.append((int(words[2]), {}))
            elif words[:1] == [b"property"]:
                elements[-1][1][words[-1]] = [_PLY_BYTES[word] for word in words[1:-1] if word != b"list"]
        for count, properties in elements:
            if all(len(sizes) == 1 for sizes in properties.values()):
                at += count * sum(sizes[0] for sizes in properties.values())
                continue
            for _ in range(count):
                for name, (first, *each) in properties.items():  # of a list its length comes first
                    number = int.from_bytes(body[at : at + first], order) if each else 0
                    at += first + number * sum(each)
                    if name in (b"vertex_index", b"vertex_indices"):
                        corners.add(number)
                if at > len(body):
                    return set()
    except (KeyError, IndexError, ValueError):
        return set()
    return corners


def _binary_stl_bytes(content: bytes) -> int:
    """How long a binary STL is by the number of triangles that it says; 84 at least, what comes before them."""
    return 84 + 50 * int.from_bytes(content[80:84], "little")


def _plain(content: bytes, kind: str) -> bytes:
    """A file with its text in ASCII, others' letters as question marks: they stand in names and comments alone, and
    trimesh reads no other text than UTF-8 without a package that guesses encodings.
    """
    end = len(content)
    if kind == ".stl" and end == _binary_stl_bytes(content):
        end = 80  # binary behind its first line
    elif kind == ".ply" and b"format binary" in content[:1000]:
        end = max(content.find(b"end_header"), 0)
    return content[:end].translate(_ASCII) + content[end:]
