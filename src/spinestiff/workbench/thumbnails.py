"""A small picture of a radiograph that is no subject's yet: its pixels alone, as the annotation page sends them."""

from __future__ import annotations

from typing import Any

from spinestiff.annotate.pictures import greys
from spinestiff.imaging.dicom.export import Exported
from spinestiff.imaging.dicom.millimetres import Geometry
from spinestiff.imaging.dicom.reading import read_frames, read_scan

WIDE, TALL = 96, 128
"""Pixels: enough to tell a spine from the side from one from the front, too few for a name that is burned in."""


def thumbnail(one: Exported, wide: int = WIDE, tall: int = TALL, part: str = "") -> tuple[bytes, dict[str, Any]]:
    """Grey values of a radiograph's first frame, and their columns, rows and window, as ``annotate.pictures`` gives
    them. Raises RadiographError where the file can no longer be read, or contradicts itself on the shape of pixels.
    """
    within = one.path.parent
    scan = read_frames(one.path, Geometry(), within) or read_scan(one.path, Geometry(), within)
    return greys(scan.pixels[0], scan.aspect, wide, tall, part)
