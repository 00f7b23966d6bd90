"""Patches of an annotated frame that are followed: which pixels, and where a motion takes them.

Everything is in pixels (column, row), the first pixel's centre at (0, 0).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spinestiff.arrays import Floats

# Half width of the band along a vertebra's outline that is registered, in parts of the vertebra's size.
BAND = 0.2
PATCH_POINTS = 3000


@dataclass(frozen=True)
class Body:
    """A patch of the first frame that moves rigidly in the picture. A pose is (angle, shift), (3,) rad and pixels.

    Attributes
    ----------
    centre, size : (2,) and pixels.
    points : (n, 2) of the patch.
    normals : (n, 2) unit, the only direction in which a point tells of motion; None = both.
    """

    centre: Floats
    size: float
    points: Floats
    normals: Floats | None = None

    @staticmethod
    def of_vertebra(quad: Floats) -> Body:
        """A band along the outline (4, 2), in which each point tells of motion across the outline.

        Arch and processes lie behind the body, are brighter than its walls and move otherwise (with axial rotation,
        and by parallax): the middle is left out, and where they cross the endplates they must not count sideways.
        """
        size = np.sqrt(_area(quad))
        grid = _grid(_dilated(quad, BAND * size))
        points = grid[~_within(_dilated(quad, -BAND * size), grid)]
        along = np.roll(quad, -1, axis=0) - quad
        across = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
        distance = np.abs(np.einsum("pki,ki->pk", points[:, None] - quad, across))
        return Body(quad.mean(axis=0), float(size), points, across[np.argmin(distance, axis=1)])

    @staticmethod
    def of_square(centre: Floats, radius: float) -> Body:
        """All around a point."""
        return Body(centre, 2.0 * radius, _grid(centre + radius * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])))

    def placed(self, pose: Floats, points: Floats) -> Floats:
        """Points (n, 2) of the first frame carried along."""
        return self.centre + pose[1:] + (points - self.centre) @ turn(pose[0]).T


def turn(angle: float) -> Floats:
    """Rotation (2, 2) by an angle in rad, from columns towards rows."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine], [sine, cosine]])


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
