"""What makes skin markers differ from the right model, as a covariance (as ``noise`` has that of radiographs).

Where a marker sits on the skin, and where the cameras' system lies against the torso, is not known: each marker may be
off by centimetres, alike in all frames of its sequence, so that its motion from the unloaded frame is what counts. The
cameras' axes may be turned, which turns that motion. In each frame the patient has swayed as a whole and breathed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.rotation import cross_matrix
from spinestiff.arrays import Floats, ShortRepr
from spinestiff.estimation.causes import Cause
from spinestiff.estimation.priors import Priors
from spinestiff.estimation.sights import MarkerTarget


@dataclass(frozen=True, repr=False)
class SeenMarkers(ShortRepr):
    """A frame's markers among all channels of a fit.

    Attributes
    ----------
    target : the markers. sequence : frames of one carry the same name here.
    channels : where their coordinates are, marker by marker.
    """

    target: MarkerTarget
    sequence: str
    channels: slice


def marker_parts(frames: Sequence[SeenMarkers], size: int, priors: Priors) -> dict[Cause, Floats]:
    """(n, n) mm^2 by cause, n = ``size`` channels; nothing where no markers are seen."""
    if not frames:
        return {}
    p = priors
    own = np.zeros(size)
    places: dict[tuple[str, int, int], Floats] = {}
    swayed, breathed = [], []
    centres = {
        name: np.concatenate([frame.target.z for frame in frames if frame.sequence == name]).mean(0)
        for name in dict.fromkeys(frame.sequence for frame in frames)
    }
    turns = {name: np.zeros((size, 3)) for name in centres}
    for frame in frames:
        target, rows = frame.target, frame.channels
        count = 3 * len(target.rows)
        own[rows] = p.marker_mm
        for number, row in enumerate(target.rows):
            for axis in range(3):
                column = places.setdefault((frame.sequence, int(row), axis), np.zeros(size))
                column[rows.start + 3 * number + axis] = p.marker_place_mm
        # A turn of rad about each axis, of what was seen: it turns the motion with the places.
        about = -cross_matrix(target.z - centres[frame.sequence]).reshape(count, 3)
        turns[frame.sequence][rows] = np.deg2rad(p.marker_turn_deg) * about
        as_one = np.zeros((size, 6))
        as_one[rows, :3] = p.place_mm * np.tile(np.eye(3), (len(target.rows), 1))
        as_one[rows, 3:] = about * np.deg2rad([p.place_deg, p.place_yaw_deg, p.place_deg])
        swayed.append(as_one)
        breath = np.zeros((size, 1))
        breath[rows, 0] = p.marker_breath_mm * target.outward.reshape(-1)
        breathed.append(breath)
    return {
        "markers' own errors": np.diag(own**2),
        "markers' places": _outer([column[:, None] for column in places.values()]),
        "turn of the cameras": _outer(list(turns.values())),
        "sway before the cameras": _outer(swayed),
        "breath under the markers": _outer(breathed),
    }


def _outer(columns: Sequence[Floats]) -> Floats:
    every = np.concatenate(columns, axis=1)
    return np.asarray(every @ every.T)
