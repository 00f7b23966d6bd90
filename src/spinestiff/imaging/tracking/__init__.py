"""Vertebra corners and supports followed through a sequence of radiographs (paper 2.1, 2.2).

As in the paper, frame by frame: the new frame's histogram is matched, dense optical flow (DIS) carries the corners
over. Two things are added, since flow of single points drifts and a corner alone has little texture:

- a vertebra moves as a body: a robust rigid motion in the picture is fitted to the flow over its area;
- that motion is then corrected against the annotated frame (registration of the vertebra's patch), so that errors
  don't add up from frame to frame.

Quality is the predicted error of a corner, calibrated on sequences whose truth is known (docs/tracking.md). Forward and
backward flow alone would not do: they agree where both follow the same wrong thing.

Inside, everything is in pixels (column, row), the first pixel's centre at (0, 0).
"""

from spinestiff.imaging.tracking.supports import (
    OBLIQUITY_LIMIT_DEG,
    SUPPORT_LIMIT_MM,
    SupportMotion,
    support_motion,
)
from spinestiff.imaging.tracking.vertebrae import OnFrame, track

__all__ = ["OBLIQUITY_LIMIT_DEG", "SUPPORT_LIMIT_MM", "OnFrame", "SupportMotion", "support_motion", "track"]
