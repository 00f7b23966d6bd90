"""A surface scan of the trunk as points with outward directions, in mm along the body's axes as its owner states them.

Unit and axes are never guessed: what is stated has to agree with the size of the body, or the scan is refused.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from spinestiff.anatomy.axes import DIRECTIONS, MM, Unit
from spinestiff.anatomy.importing.reading import read_surface
from spinestiff.arrays import Floats, ShortRepr, read_only
from spinestiff.errors import SubjectError, TorsoError

# Shares of the body height that a scan with some of the trunk on it may extend: from a part of the back to a whole body
# with its arms spread.
EXTENTS = {"up": (0.15, 1.1), "left": (0.10, 1.1), "front": (0.02, 0.5)}
# mm2 over the squared body height in mm: a scan with less surface is of a hand, or of nothing.
LEAST_AREA = 0.02
POINT_AREA = 120.0  # mm2 of surface that a point stands for
MOST_POINTS = 20_000
NEIGHBOURS = 9  # over which directions are averaged: triangles of a noisy scan point anywhere


@dataclass(frozen=True, repr=False)
class SkinScan(ShortRepr):
    """Points spread evenly over a scanned surface.

    Attributes
    ----------
    points : (n, 3) mm along the body's left, up and front, from the scan's own origin.
    normals : (n, 3) unit, to the side that the triangles' order says is outside.
    name : of the file.

    Raises
    ------
    TorsoError : arrays of other shapes, or not finite.
    """

    points: Floats
    normals: Floats
    name: str = "scan"

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", read_only("scan points", self.points, (None, 3), TorsoError))
        shape = (len(self.points), 3)
        object.__setattr__(self, "normals", read_only("scan normals", self.normals, shape, TorsoError))


def read_scan(path: Path, unit: Unit, body_from_scan: Floats, height_cm: float) -> SkinScan:
    """The scan of a file.

    Parameters
    ----------
    path : STL, OBJ, PLY or VTP; open, in parts, with holes, as it comes from the scanner.
    unit : of the file's coordinates.
    body_from_scan : (3, 3) as ``body_axes`` gives it.
    height_cm : of the body, which the scan's extents are held against.

    Raises
    ------
    SubjectError : the file can't be read, or the stated unit or axes contradict the body.
    """
    try:
        vertices, faces = read_surface(path)
    except TorsoError as error:
        raise SubjectError(f"skin scan: {error}") from None
    places = MM[unit] * vertices @ body_from_scan.T
    _check_extents(path.name, unit, np.ptp(places, axis=0), 10.0 * height_cm)
    corners = places[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * np.linalg.norm(normal, axis=1)
    if area.sum() < LEAST_AREA * (10.0 * height_cm) ** 2:
        raise SubjectError(
            f"skin scan: {path.name} has {1e-2 * area.sum():.0f} cm2 of surface, too little for the trunk of a body of "
            f"{height_cm:g} cm; check the unit ({unit}) and what was scanned"
        )
    return _spread_points(corners, normal, area, path.name)


def _check_extents(name: str, unit: str, extents: Floats, height: float) -> None:
    found = dict(zip(DIRECTIONS, extents.tolist()))
    for what, (low, high) in EXTENTS.items():
        if not low * height <= found[what] <= high * height:
            raise SubjectError(
                f"skin scan: {name} extends {found[what]:.4g} mm along {what}, wanted {low * height:.0f} to "
                f"{high * height:.0f} mm for a body of {0.1 * height:g} cm; check unit ({unit}) and axes"
            )
    if found["front"] > found["left"]:
        raise SubjectError(
            f"skin scan: {name} is deeper ({found['front']:.0f} mm along front) than broad ({found['left']:.0f} mm "
            "along left), which no trunk is; check the axes"
        )


def _spread_points(corners: Floats, normal: Floats, area: Floats, name: str) -> SkinScan:
    # Chosen by area, always the same: triangles of scanners differ a hundredfold in size.
    count = int(min(area.sum() / POINT_AREA, MOST_POINTS))
    rng = np.random.default_rng(0)
    face = np.searchsorted(np.cumsum(area) / area.sum(), (np.arange(count) + rng.random(count)) / count)
    face = np.minimum(face, len(area) - 1)
    share = np.sort(rng.random((count, 2)), axis=1)
    share = np.stack([share[:, 0], share[:, 1] - share[:, 0], 1.0 - share[:, 1]], -1)
    points = np.einsum("ni,nij->nj", share, corners[face])
    own = normal[face] / np.maximum(np.linalg.norm(normal[face], axis=1, keepdims=True), 1e-300)
    near = own[cKDTree(points).query(points, k=min(NEIGHBOURS, count))[1].reshape(count, -1)]
    # Only what looks to the same side: a hand's back says nothing about its palm.
    alike = np.einsum("nki,ni->nk", near, own) > 0.0
    mean = np.einsum("nk,nki->ni", alike, near)
    return SkinScan(points, mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-300), name)
