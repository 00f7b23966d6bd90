"""What is seen of an equilibrium beside the vertebrae's corners in its frontal radiograph.

Pedicles, in any radiograph, and corners in radiographs from other sides. A pedicle's mark is compared with where the
torso's lies (``imaging.pedicles``), point by point: it lies behind the vertebra's body, so that in a frontal view a
turn about the body's own axis moves it against the corners, which such a turn hardly moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, Ints, ShortRepr
from spinestiff.errors import TrackingError
from spinestiff.estimation.objective import Residuals, Target, Trial, make_target, residuals
from spinestiff.imaging.features import Orientation
from spinestiff.imaging.pedicles import pedicle_centres


@dataclass(frozen=True, repr=False)
class PedicleTarget(ShortRepr):
    """Marked pedicles of one radiograph, P points; constant during a fit.

    Attributes
    ----------
    boxes : the vertebrae's corners in the same radiograph.
    rows : (P,) the points' vertebrae among the torso's. points : where they are on their bones.
    z : (P, 2) mm at the patient plane, as marked.
    outward : (P,) +1 for a left, -1 for a right pedicle.
    """

    boxes: Target
    rows: Ints
    points: PointsOnBones
    z: Floats
    outward: Floats

    @property
    def trial(self) -> Trial:
        """The radiograph."""
        return self.boxes.trial


@dataclass(frozen=True, repr=False)
class PointResiduals(ShortRepr):
    """Simulated minus marked points of one radiograph in one state.

    Attributes
    ----------
    difference : (P, 2) mm at the patient plane. jacobian : (P, 2, 6), derivative in the pose of the point's own bone.
    bones : (P,).
    """

    difference: Floats
    jacobian: Floats
    bones: Ints

    def moved(self, directions: Floats) -> Floats:
        """(P, 2, K) derivative of ``difference`` along changes of state dx/dp (dofs, K)."""
        columns = 6 * self.bones[:, None] + np.arange(6)
        own = directions[columns.reshape(-1)].reshape(len(self.bones), 6, -1)
        return np.asarray(np.einsum("pic,pck->pik", self.jacobian, own))


Sight = Target | PedicleTarget
"""What a radiograph shows of one kind."""
SightResiduals = Residuals | PointResiduals


@dataclass(frozen=True)
class FurtherSight:
    """A sight beside those of the frontal radiographs' corners.

    Attributes
    ----------
    trial : number of the trial whose equilibrium it shows. target : what it shows.
    radiograph : numbers of radiographs; the trials' own ones come first, in their order.
    """

    trial: int
    target: Sight
    radiograph: int


def further_sights(
    torsos: Sequence[TorsoModel], targets: Sequence[Target], orientation: Orientation
) -> tuple[FurtherSight, ...]:
    """All that trials show beside their own corners.

    Parameters
    ----------
    torsos, targets : of each trial.

    Raises
    ------
    FitError : a radiograph with too few vertebrae.
    TrackingError : corners or pedicles that fit no vertebra of the torso.
    """
    found: list[FurtherSight] = []
    count = len(targets)
    for number, (torso, target) in enumerate(zip(torsos, targets)):
        if target.trial.pedicles is not None:
            found.append(FurtherSight(number, _pedicle_target(torso, target), number))
        for picture in target.trial.further:
            boxes = make_target(torso, target.trial.seen_in(picture), orientation)
            found.append(FurtherSight(number, boxes, count))
            if picture.pedicles is not None:
                found.append(FurtherSight(number, _pedicle_target(torso, boxes), count))
            count += 1
    return tuple(found)


def sight_residuals(torso: TorsoModel, target: Sight, state: TorsoState) -> SightResiduals:
    """Simulated minus measured, with derivatives."""
    if isinstance(target, Target):
        return residuals(torso, target, state)
    view = target.trial.view
    detector, jacobian = view.project_with_jacobian(target.points.positions(state))
    slope = (jacobian / view.magnification) @ target.points.jacobian(state)
    return PointResiduals(view.to_patient_plane(detector) - target.z, slope, target.points.bone)


def _pedicle_target(torso: TorsoModel, boxes: Target) -> PedicleTarget:
    marked = boxes.trial.pedicles
    assert marked is not None
    name = boxes.trial.label or "trial"
    for vertebra in marked.vertebrae:
        if vertebra not in torso.vertebrae:
            raise TrackingError(f"{name}: pedicles name {vertebra}, but this torso has no such vertebra")
    which = np.array([torso.vertebrae.index(vertebra) for vertebra in marked.vertebrae], dtype=np.int64)
    seen = np.isfinite(marked.points).all(2)
    rows = np.repeat(which, 2).reshape(-1, 2)[seen]
    points = PointsOnBones(torso.vertebra_bones[rows], pedicle_centres(torso)[which][seen])
    z = boxes.trial.view.to_patient_plane(marked.points[seen])
    return PedicleTarget(boxes, rows, points, z, np.tile([1.0, -1.0], (len(which), 1))[seen])
