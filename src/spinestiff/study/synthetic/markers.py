"""Markers on the skin of a synthetic subject: where they are put, and where a radiograph shows them."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from spinestiff.anatomy.tissue_points import PointsOnTissue
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.errors import SubjectError
from spinestiff.imaging.projection import XRayView
from spinestiff.personalise.skin_surface import skin_surface, tissue_points

BEAD_SD_MM = 0.5  # of where somebody marks a marker in a radiograph, at the patient plane
# Where markers are: between these vertebrae, not further round than this normal's share to the front (a wall hides the
# back), and off the gauge's pad.
MARKED_BETWEEN, BACKMOST, PAD_MM = ("T3", "L4"), -0.3, 60.0


def spread_markers(torso: TorsoModel, count: int, spots: Floats) -> tuple[PointsOnTissue, Floats]:
    """Markers spread over the front and the flanks of a torso between T3 and L4, off where it is pushed: a wall hides
    the back.

    Parameters
    ----------
    count : of markers. spots : (n, 3) mm, points that are pushed.

    Returns
    -------
    The points, and the skin's outward directions (count, 3).
    """
    skin = skin_surface(torso)
    heights = [torso.rest_pose.bone_positions[torso.bone(name), 1] for name in MARKED_BETWEEN]
    free = ~skin.ends & (skin.normals[:, 2] > BACKMOST) & (skin.points[:, 1] < heights[0])
    free &= (skin.points[:, 1] > heights[1]) & (cKDTree(spots).query(skin.points)[0] > PAD_MM)
    there = np.flatnonzero(free)
    if len(there) < count:
        raise SubjectError(f"{count} markers; this torso's front and flanks have room for {len(there)}")
    # Each as far from those before as can be, the first in the middle of the front.
    chosen = [int(np.argmax(skin.normals[there, 2]))]
    distance = np.full(len(there), np.inf)
    for _ in range(count - 1):
        own = np.linalg.norm(skin.points[there] - skin.points[there[chosen[-1]]], axis=1)
        distance = np.minimum(distance, own)
        chosen.append(int(np.argmax(distance)))
    which = there[chosen]
    return tissue_points(torso, skin, which), skin.normals[which]


def view_of_markers(view: XRayView, places: Floats, random: np.random.Generator) -> Floats:
    """(M, 2) column, row, where somebody marks the pictures of markers at ``places`` (M, 3) mm."""
    seen = view.project(places)
    return view.pixels(seen + random.normal(0.0, BEAD_SD_MM, seen.shape) * view.magnification)
