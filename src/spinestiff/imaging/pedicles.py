"""Pedicles: the two marks of a vertebra that lie behind its body, and so tell how it is turned about its own axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.names import THORACIC
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, ShortRepr
from spinestiff.errors import TrackingError
from spinestiff.imaging.features import box_sizes


@dataclass(frozen=True, repr=False)
class PediclePoints(ShortRepr):
    """Centres of pedicles marked in one radiograph.

    Attributes
    ----------
    vertebrae : (Nv,) names, each once.
    points : (Nv, 2, 2) mm on the detector, the patient's left and right pedicle; NaN where one is not seen.

    Raises
    ------
    TrackingError : wrong shapes, or repeated names.
    """

    vertebrae: tuple[str, ...]
    points: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertebrae", tuple(self.vertebrae))
        if len(set(self.vertebrae)) != len(self.vertebrae):
            raise TrackingError("pedicles of a vertebra are given more than once")
        points = np.asarray(self.points, dtype=float)
        if points.shape != (len(self.vertebrae), 2, 2):
            raise TrackingError(f"pedicle points have shape {points.shape}, wanted ({len(self.vertebrae)}, 2, 2)")
        points = points.copy()
        points.flags.writeable = False
        object.__setattr__(self, "points", points)


def pedicle_centres(torso: TorsoModel) -> Floats:
    """(V, 2, 3) mm in the vertebra's frame: the middles of the left and the right pedicle of this torso's vertebrae.

    As the template's bone surfaces have them (``anatomy.template.vertebrae``): at 0.36 (lumbar: 0.30) of the body's
    width plus 2 mm aside, 0.18 of its height above the middle, and 5 mm behind the body's rear wall.
    """
    width, height, depth = box_sizes(torso).T
    share = np.where([name in THORACIC for name in torso.vertebrae], 0.36, 0.30)
    left = np.stack([share * width + 2.0, 0.18 * height, -0.5 * depth - 5.0], -1)
    return np.stack([left, left * [-1.0, 1.0, 1.0]], 1)
