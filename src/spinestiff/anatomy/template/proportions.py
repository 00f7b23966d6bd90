"""Sizes of a body over those of the reference body, as everything procedural takes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.template import sizes
from spinestiff.arrays import Floats


@dataclass(frozen=True)
class Proportions:
    """Sizes over the reference body's, and the angles of the spine.

    Attributes
    ----------
    height_cm : body height.
    spine : lengths of the spine, and of everything along it.
    thorax : lateral and forward, of the bony chest.
    shoulder : of clavicle, scapula and humerus.
    pelvis : lateral.
    chest, waist, hips, neck : (2,) breadth and depth of the skin.
    kyphosis_deg, lordosis_deg, sacral_slope_deg : angles of the spine.
    """

    height_cm: float
    spine: float
    thorax: tuple[float, float]
    shoulder: float
    pelvis: float
    chest: tuple[float, float]
    waist: tuple[float, float]
    hips: tuple[float, float]
    neck: tuple[float, float]
    kyphosis_deg: float = sizes.KYPHOSIS_DEG
    lordosis_deg: float = sizes.LORDOSIS_DEG
    sacral_slope_deg: float = sizes.SACRAL_SLOPE_DEG

    @property
    def pelvis_scale(self) -> Floats:
        """(3,) of the pelvis along x, y, z."""
        return np.array([self.pelvis, self.spine, self.spine])


_SAME = (1.0, 1.0)
REFERENCE = Proportions(sizes.HEIGHT_CM, 1.0, _SAME, 1.0, 1.0, _SAME, _SAME, _SAME, _SAME)
