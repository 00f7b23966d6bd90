"""Markers on the skin placed on a torso: from the cameras' system to the torso's, and what of its tissue carries them.

The cameras' axes are those of the body as their owner states them, up to a small turn; their origin is not known. What
tells where they are: markers that the frontal radiograph shows, and that all markers lie on the skin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from spinestiff.anatomy.rotation import cross_matrix, exp_so3
from spinestiff.anatomy.tissue_points import PointsOnTissue
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, Ints, ShortRepr
from spinestiff.errors import RadiographError, SubjectError
from spinestiff.imaging.projection import XRayView
from spinestiff.personalise.skin_surface import SkinSurface, nearest_points, skin_surface

Side = Literal["front", "back", "both"]
STEP_MM = 6.0
# Of a direction to the front: skin of the flanks belongs to front and back.
FLANK = 0.5
# mm at the patient plane, and mm: how well a radiograph shows where a marker is, and how far a torso's skin lies from a
# person's where nobody scanned it.
SHOWN_SD_MM, SKIN_SD_MM = 2.0, 6.0
DEPTHS_MM = np.arange(-300.0, 301.0, 15.0)
FARTHEST_START_MM = 40.0  # so that a single marker off the skin does not choose the depth
ROUNDS = 60
STILL = 1e-5
# What no marker on the trunk has: mm off the skin, mm at the patient plane beside its picture, degrees between the
# cameras' and the body's axes.
MOST_OFF_MM, MOST_BESIDE_MM, MOST_TURNED_DEG = 35.0, 15.0, 12.0
# Off the skin of the other side over off that of the stated one, where the other is taken for meant.
CLEARLY_NEARER = 0.6
EXTENTS = (0.08, 0.7)
"""Shares of the body height between the two markers farthest apart."""


@dataclass(frozen=True, repr=False)
class PlacedMarkers(ShortRepr):
    """Where markers are on a torso.

    Attributes
    ----------
    turn, centre, shift : (3, 3), (3,) mm and (3,) mm; a point p of the cameras' is turn (p - centre) + centre + shift.
    points : (M) of the tissue's boundary, nearest to the placed markers.
    outward : (M, 3) unit, the skin's direction there.
    off_mm : (M,) how far outside the skin the placed markers are.
    """

    turn: Floats
    centre: Floats
    shift: Floats
    points: PointsOnTissue
    outward: Floats
    off_mm: Floats

    def placed(self, positions: Floats) -> Floats:
        """(..., 3) mm, points of the cameras' in the torso's place."""
        return np.asarray((positions - self.centre) @ self.turn.T + self.centre + self.shift)


def place_markers(
    torso: TorsoModel,
    names: Sequence[str],
    positions: Floats,
    shown: tuple[Ints, Floats],
    view: XRayView,
    side: Side,
    turn_sd: float,
) -> PlacedMarkers:
    """Markers of an unloaded frame on a torso at rest.

    Least squares over shift and turn: markers that the radiograph shows against their pictures, all against the skin
    of their ``side``, point to plane, the turn against ``turn_sd``. The depth is first looked for over all of the body.

    Parameters
    ----------
    positions : (M, 3) mm along the body's axes, from the cameras' own origin.
    shown : numbers (S,) of markers and where the radiograph shows them, (S, 2) mm on the detector.
    view : of the radiograph, meeting the torso.
    side : of the trunk, that all markers lie on.
    turn_sd : rad, about each axis, of the stated axes.

    Raises
    ------
    SubjectError : markers of no trunk's extent, or that lie on no skin of this torso.
    """
    _check_extent(positions, 10.0 * torso.height_cm)
    skin = skin_surface(torso, STEP_MM)
    there = _skin_of(skin, side)
    tree = cKDTree(skin.points[there])
    centre = positions.mean(0)
    rows, marks = shown
    wanted = view.to_patient_plane(marks)

    def pictures(placed: Floats) -> tuple[Floats, Floats]:
        seen, slope = view.project_with_jacobian(placed[rows])
        return view.to_patient_plane(seen) - wanted, slope / view.magnification

    def in_picture(depth: float) -> Floats:
        """The shift that meets the pictures, the middle of the markers at a given depth."""
        shift = np.array([0.0, 0.0, depth]) - centre
        for _ in range(3):
            off, slope = pictures(positions + shift)
            level = slope[:, :, :2].reshape(-1, 2)
            shift[:2] -= np.linalg.lstsq(level, off.reshape(-1), rcond=None)[0]
        return shift

    def apart(shift: Floats, on: cKDTree) -> float:
        return float(np.sqrt(np.mean(np.minimum(on.query(positions + shift)[0], FARTHEST_START_MM) ** 2)))

    try:
        starts = [in_picture(depth) for depth in DEPTHS_MM]
        shift = min(starts, key=lambda start: apart(start, tree))
        if side != "both":
            other: Side = "back" if side == "front" else "front"
            beyond = cKDTree(skin.points[_skin_of(skin, other)])
            _check_side(side, other, apart(shift, tree), min(apart(start, beyond) for start in starts))
        turn = np.zeros(3)
        for _ in range(ROUNDS):
            rotation = exp_so3(turn)
            arms = (positions - centre) @ rotation.T
            placed = arms + centre + shift
            nearest = there[tree.query(placed)[1]]
            normals = skin.normals[nearest]
            off, slope = pictures(placed)
            moved = np.concatenate([np.broadcast_to(np.eye(3), (len(arms), 3, 3)), -cross_matrix(arms)], axis=2)
            values = [
                off.reshape(-1) / SHOWN_SD_MM,
                np.einsum("mi,mi->m", normals, placed - skin.points[nearest]) / SKIN_SD_MM,
                turn / max(turn_sd, STILL),
            ]
            slopes = [
                (slope @ moved[rows]).reshape(-1, 6) / SHOWN_SD_MM,
                np.einsum("mi,mij->mj", normals, moved) / SKIN_SD_MM,
                np.eye(6)[3:] / max(turn_sd, STILL),
            ]
            step = -np.linalg.lstsq(np.concatenate(slopes), np.concatenate(values), rcond=None)[0]
            shift, turn = shift + step[:3], turn + step[3:]
            if np.abs(step * [1.0, 1.0, 1.0, 100.0, 100.0, 100.0]).max() < STILL:
                break
    except RadiographError as error:
        raise SubjectError(f"can't be placed in the frontal radiograph ({error}); check unit, axes and shown") from None
    rotation = exp_so3(turn)
    placed = (positions - centre) @ rotation.T + centre + shift
    points, outward = nearest_points(torso, skin, placed)
    left = placed - points.positions(torso, torso.rest_pose)
    _check_place(names, rows, np.linalg.norm(left, axis=1), np.linalg.norm(pictures(placed)[0], axis=1), turn)
    return PlacedMarkers(rotation, centre, shift, points, outward, np.einsum("mi,mi->m", left, outward))


def _skin_of(skin: SkinSurface, side: Side) -> Ints:
    """Numbers of the points of the skin that belong to a side."""
    facing = skin.normals[:, 2] * (1.0 if side == "front" else -1.0)
    return np.flatnonzero(~skin.ends & ((side == "both") | (facing > -FLANK)))


def _check_side(side: Side, other: Side, here: float, there: float) -> None:
    if there < CLEARLY_NEARER * here and here - there > SKIN_SD_MM:
        raise SubjectError(
            f"they lie within {there:.0f} mm of the skin of the {other}, but {here:.0f} mm off that of the {side} "
            "(root mean square); check side and axes"
        )


def _check_extent(positions: Floats, height: float) -> None:
    widest = float(np.linalg.norm(positions[:, None] - positions, axis=-1).max())
    low, high = (share * height for share in EXTENTS)
    if not low <= widest <= high:
        raise SubjectError(
            f"the two farthest apart are {widest:.4g} mm apart, wanted {low:.0f} to {high:.0f} mm on the trunk of a "
            f"body of {0.1 * height:g} cm; check the unit"
        )


def _check_place(names: Sequence[str], rows: Ints, off: Floats, beside: Floats, turn: Floats) -> None:
    for number, found in zip(rows, beside):
        if found > MOST_BESIDE_MM:
            raise SubjectError(
                f"marker '{names[number]}' lies {found:.0f} mm beside its picture in the frontal radiograph when all "
                f"lie on the skin, wanted at most {MOST_BESIDE_MM:g} mm; check shown, axes and side"
            )
    worst = int(np.argmax(off))
    if off[worst] > MOST_OFF_MM:
        raise SubjectError(
            f"marker '{names[worst]}' lies {off[worst]:.0f} mm from the skin when all lie as they lie best, wanted at "
            f"most {MOST_OFF_MM:g} mm; check its place, axes, side and shown, or leave it out"
        )
    turned = float(np.degrees(np.linalg.norm(turn)))
    if turned > MOST_TURNED_DEG:
        raise SubjectError(
            f"the cameras' axes lie {turned:.0f} degrees from the body's when all markers lie on the skin, wanted at "
            f"most {MOST_TURNED_DEG:g}; turn the coordinates to the body, and check axes and shown"
        )
