"""Collimation: four blades near the source that keep the beam off what need not be seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from spinestiff.arrays import Floats
from spinestiff.errors import RadiographError
from spinestiff.imaging.projection import XRayView

_LEAK = 1e-3  # of lead blades
_PENUMBRA = 1.2  # mm at the detector, standard deviation: blades stand near the focal spot


@dataclass(frozen=True)
class Collimation:
    """How far the blades reach into the picture, mm at the detector from its edges; 0 for a blade outside.

    Attributes
    ----------
    top, bottom, left, right : edges of the picture: rows and columns as they are stored.

    Raises
    ------
    RadiographError : a negative distance, or NaN.
    """

    top: float = 0.0
    bottom: float = 0.0
    left: float = 0.0
    right: float = 0.0

    def __post_init__(self) -> None:
        if not all(edge >= 0.0 for edge in (self.top, self.bottom, self.left, self.right)):
            raise RadiographError(f"collimation {self}; wanted 0 mm or more from each edge")

    def field(self, view: XRayView) -> tuple[Floats, Floats]:
        """First and last open place, (column, row) in pixels. Raises RadiographError if nothing is open."""
        first = np.array([self.left, self.top]) / view.pixel_spacing - 0.5
        last = np.array(view.shape[::-1]) - 0.5 - np.array([self.right, self.bottom]) / view.pixel_spacing
        if (last - first < 1.0).any():
            raise RadiographError(f"collimation {self} leaves nothing of {view.shape[0]} x {view.shape[1]} pixels")
        return first, last

    def open_beam(self, view: XRayView) -> Floats:
        """(H, W) share of the beam that passes: 1 inside, a thousandth behind lead, a soft edge between."""
        first, last = self.field(view)
        shares = []
        for axis, near, far in ((0, self.left, self.right), (1, self.top, self.bottom)):
            at = np.arange(view.shape[1 - axis], dtype=float)
            width = _PENUMBRA / view.pixel_spacing[axis] * np.sqrt(2.0)
            share = np.ones_like(at)
            if near > 0.0:
                share *= 0.5 + 0.5 * erf((at - first[axis]) / width)
            if far > 0.0:
                share *= 0.5 + 0.5 * erf((last[axis] - at) / width)
            shares.append(share)
        return _LEAK + (1.0 - _LEAK) * shares[1][:, None] * shares[0]
