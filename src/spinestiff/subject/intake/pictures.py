"""Whether two radiographs are one picture: by the instance or the file, else by what the pixels show.

A copy without its patient names another instance than the original, and so does a second export by some archives. Their
pixels are the same.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

from spinestiff.errors import RadiographError
from spinestiff.imaging.dicom.export import Exported
from spinestiff.imaging.dicom.millimetres import Geometry
from spinestiff.imaging.dicom.reading import read_scan


class Album:
    """Radiographs that further ones are compared with.

    Pixels are read only where something of the same size is there that is not told to be the same otherwise.
    """

    def __init__(self, files: Iterable[Exported] = ()) -> None:
        self._by_mark: dict[str, Exported] = {}
        self._by_size: dict[tuple[int, int, int], list[Exported]] = {}
        for one in files:
            self.add(one)

    def add(self, one: Exported) -> None:
        """Take in a radiograph; of one picture the first counts."""
        self._by_mark.setdefault(_mark(one), one)
        self._by_size.setdefault(_size(one), []).append(one)

    def same(self, one: Exported) -> Exported | None:
        """The radiograph in here that shows the same picture, every frame and every pixel; None if none does."""
        marked = self._by_mark.get(_mark(one))
        if marked is not None:
            return marked
        alike = self._by_size.get(_size(one), [])
        shown = pixel_digest(one) if alike else ""
        return next((other for other in alike if shown and pixel_digest(other) == shown), None)


def _mark(one: Exported) -> str:
    return one.scan.tags.identity or one.scan.sha256


def _size(one: Exported) -> tuple[int, int, int]:
    return (one.frames, *one.size)


def pixel_digest(one: Exported) -> str:
    """SHA-256 of a radiograph's grey values as they are read, bone bright, whatever its header says of the patient and
    however they are stored; "" where the file is no longer the one that was read."""
    return _digest(one.path, one.scan.sha256)


@lru_cache(maxsize=4096)
def _digest(path: Path, sha256: str) -> str:
    try:
        scan = read_scan(path, Geometry())
        if scan.sha256 != sha256:
            return ""
        digest = hashlib.sha256()
        for frame in scan.pixels:
            digest.update(frame.tobytes())
    except RadiographError:
        return ""
    return digest.hexdigest()
