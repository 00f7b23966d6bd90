"""The small pose of the patient in a view: two shifts and a roll in the picture plane, and a yaw about the vertical."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from spinestiff.anatomy.rotation import cross_matrix, exp_so3
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.errors import TrackingError
from spinestiff.imaging.features import (
    VertebraCorners,
    silhouette_shares,
    state_features,
    target_features,
    used_corners,
    vertebra_rows,
)
from spinestiff.imaging.planar import rotation, turns
from spinestiff.imaging.projection import XRayView


@dataclass(frozen=True)
class ViewPose:
    """How a view was moved to meet the torso: shift (2,) mm at the patient plane, roll and yaw in rad.

    ``rms_mm`` is what remains at the patient plane: between the placed boxes of simulated and measured features after
    ``align_view``, between corners as marked, those set aside left out, after ``personalise``.
    """

    shift: Floats
    roll: float
    rms_mm: float
    yaw: float = 0.0


def posed(nominal: XRayView, shift: Floats, roll: float, yaw: float) -> XRayView:
    """The view in which the patient stands elsewhere: turned by ``yaw``, then rolled and shifted (``XRayView.moved``).

    A yaw above 0 turns the patient to the left about the vertical through the middle of the patient plane. The anatomy
    keeps its world coordinates: source and detector take the opposite motion together.
    """
    if yaw:
        back = exp_so3(np.array([0.0, -yaw, 0.0]))
        pivot = nominal.source + nominal.source_to_patient * nominal.normal
        nominal = replace(
            nominal,
            source=pivot + back @ (nominal.source - pivot),
            detector_origin=pivot + back @ (nominal.detector_origin - pivot),
            detector_axes=nominal.detector_axes @ back.T,
        )
    return nominal.moved(shift, roll)


class Stance:
    """Where the patient's points are in the room of a nominal view, for a pose (4,): two shifts, roll, yaw.

    Seen in the nominal view they look as the unmoved points do in the ``posed`` one.

    Attributes
    ----------
    turn : (3, 3) rotation of the patient: the yaw, then the roll.
    """

    def __init__(self, nominal: XRayView, pose: Floats) -> None:
        axes = nominal.detector_axes
        self._pivot = nominal.source + nominal.source_to_patient * nominal.normal
        self._shift = pose[:2] @ axes
        self._axes = axes
        self._ray = np.cross(axes[0], axes[1])
        roll = exp_so3(pose[2] * self._ray)
        self.turn = roll @ exp_so3(np.array([0.0, pose[3], 0.0]))
        self._vertical = roll @ np.array([0.0, 1.0, 0.0])

    def moved(self, points: Floats) -> Floats:
        """(P, 3) mm in the room."""
        return np.asarray((points - self._pivot) @ self.turn.T + self._pivot + self._shift)

    def unmoved(self, points: Floats) -> Floats:
        """(P, 3) mm, points of the room as the patient has them: inverse of ``moved``."""
        return np.asarray((points - self._pivot - self._shift) @ self.turn + self._pivot)

    def jacobian(self, moved: Floats) -> Floats:
        """(P, 3, 4), derivative of ``moved`` points in the pose."""
        turned = moved - self._pivot - self._shift
        slope = np.empty((len(moved), 3, 4))
        slope[:, :, :2] = self._axes.T
        slope[:, :, 2:] = -cross_matrix(turned) @ np.stack([self._ray, self._vertical], 1)
        return slope


def align_view(
    torso: TorsoModel,
    state: TorsoState,
    nominal: XRayView,
    corners: VertebraCorners,
    shares: Floats | None = None,
    roll_share: float = 1.0,
) -> tuple[XRayView, ViewPose]:
    """The nominal view, moved so that the simulated features of ``state`` meet the measured ones best.

    ``XRayView.moved`` carries a picture of the patient plane by a plane rigid motion q -> Q q + shift, so the best
    motion is that of two point sets (Procrustes); points off the patient plane need a few rounds.

    ``roll_share`` is how much of the best roll the view takes; the rest is left to the torso, as its own lean.

    Raises
    ------
    TrackingError : no vertebra to align by, or corners that are no picture of this torso.
    """
    if not len(corners):
        raise TrackingError("no vertebra is left to say where the patient stood; check annotation and tracking")
    shares = silhouette_shares(torso, nominal, state) if shares is None else shares
    rows, used = vertebra_rows(torso, corners), used_corners(torso, corners)
    shift, roll, view = np.zeros(2), 0.0, nominal
    for _ in range(8):
        seen = state_features(torso, view, state, shares, used=used).z[rows].reshape(-1, 2)
        target = target_features(torso, view, corners).reshape(-1, 2)
        wanted, _ = _rigid_motion(seen, target, None)
        best = roll + wanted
        turn, move = _rigid_motion(seen, target, roll_share * best - roll)
        if abs(turn) < 1e-9 and np.abs(move).max() < 1e-7:
            break
        # q -> Q(turn) (Q(roll) q + shift) + move
        shift, roll = rotation(turn) @ shift + move, roll + turn
        view = nominal.moved(shift, roll)
    seen = state_features(torso, view, state, shares, used=used).z[rows]
    residual = seen - target_features(torso, view, corners)
    return view, ViewPose(shift, roll, float(np.sqrt(np.mean(np.sum(residual**2, -1)))))


def _rigid_motion(seen: Floats, target: Floats, turn: float | None) -> tuple[float, Floats]:
    """The turn (the best one, or the given one) and the shift after it that bring one point set to the other."""
    if turn is None:
        turn = float(turns(seen, target))
    return turn, target.mean(0) - rotation(turn) @ seen.mean(0)
