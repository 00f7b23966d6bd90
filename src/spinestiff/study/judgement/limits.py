"""What passes: the limits of all checks, set on sound subjects (docs/judgement.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinestiff.subject.records import USUAL_FORCES_N

# Beyond so many vertebrae it is not their corners.
FEW = 2


@dataclass(frozen=True)
class Limits:
    """What passes. Lengths in mm at the patient plane; those with ``_sd`` count standard deviations of a corner.

    Attributes
    ----------
    force_n : lowest and highest of the largest training force: pushes in the literature (docs/judgement.md).
    days_apart : between rest and push exposures; a child grows by less than 1 % in that time.
    corner_sd_mm : of the corners in the rest pictures about the shape found.
    least_sd_mm, most_sd_mm : between these, an annotator's own scatter sets the limits below; beyond, it is no longer
        believed to be scatter.
    wrong_vertebrae : of the rest pictures, set aside as a whole.
    length, size : factors by which a spine, and its vertebrae, may differ from the template's at that height.
    rest_mm, rest_sd : of the unloaded spine of a push about the rest torso: posture, and corners.
    load_mm, load_sd : the part of it that is as the push bends the spine.
    stray_mm, stray_sd : the same of one vertebra about its neighbours.
    moved_mm, moved_share : of the training frames' motion about the fitted one: stance, and share of the motion.
    stray_moved_mm, stray_moved_share : the same of one vertebra about its neighbours.
    fall_mm, fall_share : by which the bending may fall from one frame to one of more force, or differ between two of
        the same: absolute, and as a share of the greatest bending of the push.
    against_mm : by which a spine may move against the push.
    same_mm : of the corners of two frames, RMS in the picture: so little is between copies of one picture alone.
    p_value : of the fit's residuals, if all errors are as expected.
    """

    force_n: tuple[float, float] = USUAL_FORCES_N
    days_apart: int = 30
    corner_sd_mm: float = 1.5
    least_sd_mm: float = 0.3
    most_sd_mm: float = 1.2
    wrong_vertebrae: int = 0
    length: float = 1.12
    size: float = 1.18
    rest_mm: float = 3.4
    rest_sd: float = 2.0
    load_mm: float = 1.2
    load_sd: float = 1.0
    stray_mm: float = 3.2
    stray_sd: float = 3.0
    moved_mm: float = 1.7
    moved_share: float = 0.15
    stray_moved_mm: float = 1.3
    stray_moved_share: float = 0.1
    fall_mm: float = 0.2
    fall_share: float = 0.03
    against_mm: float = 1.0
    same_mm: float = 0.002
    p_value: float = 1e-3

    def rest_limit(self, sd: float) -> float:
        """mm, for corners of this standard deviation."""
        return float(np.hypot(self.rest_mm, self.rest_sd * sd))

    def load_limit(self, sd: float) -> float:
        """mm, for corners of this standard deviation."""
        return float(np.hypot(self.load_mm, self.load_sd * sd))

    def stray_limit(self, sd: float) -> float:
        """mm, for corners of this standard deviation."""
        return float(np.hypot(self.stray_mm, self.stray_sd * sd))


LIMITS = Limits()
