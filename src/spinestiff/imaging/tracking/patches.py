"""Patches of an annotated frame that are followed: which pixels, and where a motion takes them.

Everything is in pixels (column, row), the first pixel's centre at (0, 0).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spinestiff.arrays import Floats, Ints
from spinestiff.imaging.planar import rotation

# Half width of the band along an outline that is registered, in parts of the vertebra's size. Wider bands follow
# more of what lies before and behind the vertebra and moves otherwise.
BAND = 0.12
PATCH_POINTS = 3000


@dataclass(frozen=True)
class Body:
    """A patch of an annotated frame that moves rigidly in the picture. A pose is (angle, shift), (3,) rad and pixels.

    Attributes
    ----------
    centre, size : (2,) and pixels.
    marks : (k, 2) what is asked for: a vertebra's corners, or a point.
    points : (n, 2) of the patch.
    parts : (n,) int, which of four parts of the patch a point belongs to: a vertebra's sides, a square's quarters.
    normals : (n, 2) unit, the only direction in which a point tells of motion; None = both.
    inner : a patch of what lies before or behind the middle, which moves otherwise when the body turns out of the
        picture's plane; None = there is no such thing.
    """

    centre: Floats
    size: float
    marks: Floats
    points: Floats
    parts: Ints
    normals: Floats | None = None
    inner: Body | None = None

    @staticmethod
    def of_vertebra(quad: Floats) -> Body:
        """A band along the outline (4, 2), in which each point tells of motion across the outline.

        Arch and processes lie behind the body, are brighter than its walls and move otherwise (with axial rotation,
        and by parallax): the middle is left out, and where they cross the endplates they must not count sideways.
        """
        size = float(np.sqrt(_area(quad)))
        grid = _grid(_dilated(quad, BAND * size))
        middle = _within(_dilated(quad, -BAND * size), grid)
        points, centre = grid[~middle], quad.mean(axis=0)
        along = np.roll(quad, -1, axis=0) - quad
        across = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
        side = np.argmin(np.abs(np.einsum("pki,ki->pk", points[:, None] - quad, across)), axis=1)
        inner = Body(centre, size, centre[None], grid[middle], _quarters(grid[middle], centre))
        return Body(centre, size, quad, points, side, across[side], inner)

    @staticmethod
    def of_square(centre: Floats, radius: float) -> Body:
        """All around a point."""
        points = _grid(centre + radius * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]))
        return Body(centre, 2.0 * radius, centre[None], points, _quarters(points, centre))

    @property
    def walls(self) -> NDArray[np.bool_]:
        """(n,) which points of a vertebra lie beside its left or right wall: these alone tell of motion sideways."""
        return np.asarray(self.parts % 2 == 1)

    @property
    def width(self) -> Floats:
        """Unit vector (2,) from one wall of a vertebra to the other."""
        across = self.marks[0] + self.marks[3] - self.marks[1] - self.marks[2]
        return np.asarray(across / np.linalg.norm(across))

    def placed(self, pose: Floats, points: Floats) -> Floats:
        """Points (n, 2) of the first frame carried along."""
        return self.centre + pose[1:] + (points - self.centre) @ rotation(pose[0]).T


def _area(quad: Floats) -> float:
    following = np.roll(quad, -1, axis=0)
    return 0.5 * abs(float(np.sum(quad[:, 0] * following[:, 1] - quad[:, 1] * following[:, 0])))


def _dilated(quad: Floats, margin: float) -> Floats:
    """Corners moved away from the middle by about ``margin`` pixels along both sides."""
    centre = quad.mean(axis=0)
    across, down = 0.5 * (quad[1] + quad[2] - quad[0] - quad[3]), 0.5 * (quad[2] + quad[3] - quad[0] - quad[1])
    sides = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    unit = np.stack([across / np.linalg.norm(across), down / np.linalg.norm(down)])
    return np.asarray(quad + margin * sides @ unit) if np.isfinite(unit).all() else centre + (quad - centre)


def _quarters(points: Floats, centre: Floats) -> Ints:
    """(n,) 0 to 3, by the side of the centre on which points (n, 2) lie."""
    return np.asarray((points[:, 0] > centre[0]) + 2 * (points[:, 1] > centre[1]), dtype=np.int64)


def _within(outline: Floats, points: Floats) -> NDArray[np.bool_]:
    """Whether points (n, 2) lie in a convex outline (4, 2)."""
    edges = np.roll(outline, -1, axis=0) - outline
    relative = points[:, None] - outline
    side = edges[:, 0] * relative[..., 1] - edges[:, 1] * relative[..., 0]
    return np.asarray((side >= 0.0).all(axis=1) | (side <= 0.0).all(axis=1))


def _grid(outline: Floats) -> Floats:
    """Pixels (n, 2) within a convex outline, thinned to a bounded number."""
    low, high = np.floor(outline.min(0)), np.ceil(outline.max(0))
    step = max(1.0, np.sqrt(np.prod(high - low) / PATCH_POINTS))
    column, row = np.meshgrid(np.arange(low[0], high[0] + 1, step), np.arange(low[1], high[1] + 1, step))
    grid = np.stack([column.ravel(), row.ravel()], axis=1)
    return np.asarray(grid[_within(outline, grid)])
