"""What is seen of an equilibrium beside the vertebrae's corners in its frontal radiograph.

Pedicles, in any radiograph, and corners in radiographs from other sides. A pedicle's mark is compared with where the
torso's lies (``imaging.pedicles``), point by point: it lies behind the vertebra's body, so that in a frontal view a
turn about the body's own axis moves it against the corners, which such a turn hardly moves.

And markers on the skin, which ride on the boundary of the tissue, in three dimensions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.tissue_points import PointsOnTissue
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, Ints, ShortRepr
from spinestiff.errors import TrackingError
from spinestiff.estimation.objective import Picture, Residuals, SkinMarkers, Target, Trial, make_target, residuals
from spinestiff.imaging.features import Orientation
from spinestiff.imaging.pedicles import PediclePoints, pedicle_centres


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


@dataclass(frozen=True, repr=False)
class MarkerTarget(ShortRepr):
    """Markers on the skin seen in one frame, P of them; constant during a fit.

    Attributes
    ----------
    trial : under whose load they were seen.
    rows : (P,) which of the sequence's markers. points : what of the tissue carries them.
    z : (P, 3) mm in the torso's place, as seen. outward : (P, 3) unit, the skin's direction at rest.
    resting : (P, 3) mm, the points at rest.
    """

    trial: Trial
    rows: Ints
    points: PointsOnTissue
    z: Floats
    outward: Floats
    resting: Floats


@dataclass(frozen=True, repr=False)
class MarkerResiduals(ShortRepr):
    """Simulated minus seen markers of one frame in one state.

    Attributes
    ----------
    difference : (P, 3) mm. slope : (3 P, dofs), derivative in the state.
    """

    difference: Floats
    slope: csr_array

    def moved(self, directions: Floats) -> Floats:
        """(P, 3, K) derivative of ``difference`` along changes of state dx/dp (dofs, K)."""
        return np.asarray(self.slope @ directions).reshape(len(self.difference), 3, -1)


PictureSight = Target | PedicleTarget
"""What a radiograph shows of one kind."""
PictureResiduals = Residuals | PointResiduals
Sight = PictureSight | MarkerTarget
"""What is seen of one kind."""
SightResiduals = PictureResiduals | MarkerResiduals


OWN = -1


@dataclass(frozen=True)
class FurtherSight:
    """A sight beside those of the frontal radiographs' corners.

    Attributes
    ----------
    trial : number of the trial whose equilibrium it shows. target : what it shows.
    radiograph : numbers of radiographs, and of what cameras saw; the trials' own ones come first, in their order.
    marked : corners with one number here were set by hand in one radiograph, and followed from there; ``OWN``: each
        mark was set by itself; None: nobody marked anything.
    """

    trial: int
    target: Sight
    radiograph: int
    marked: int | None = None

    @property
    def sequence(self) -> str:
        """Frames of one carry the same name here."""
        if isinstance(self.target, MarkerTarget):
            markers = self.target.trial.markers
            assert markers is not None
            return markers.sequence
        return self.target.trial.push


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
    # Numbers that none of the trials' own corners has (``marked_anew``).
    marked = _marked_aside([picture for target in targets for picture in target.trial.further], 2 * count)
    for number, (torso, target) in enumerate(zip(torsos, targets)):
        if _are_seen(target.trial.pedicles):
            found.append(FurtherSight(number, _pedicle_target(torso, target), number, OWN))
        for picture in target.trial.further:
            boxes = make_target(torso, target.trial.seen_in(picture), orientation)
            found.append(FurtherSight(number, boxes, count, next(marked)))
            if _are_seen(picture.pedicles):
                found.append(FurtherSight(number, _pedicle_target(torso, boxes), count, OWN))
            count += 1
        markers = target.trial.markers
        if markers is not None and np.isfinite(markers.positions).any():
            found.append(FurtherSight(number, _marker_target(torso, target.trial, markers), count))
            count += 1
    return tuple(found)


def marked_anew(trials: Sequence[Trial], sequences: Sequence[str]) -> tuple[int | None, ...]:
    """``FurtherSight.marked`` of the trials' own corners, ``sequences`` as ``FurtherSight.sequence``, of each.

    None: what was marked first in its sequence, an unloaded frame before a loaded one, and all that was followed from
    it: its error is the sequence's. What is marked in another frame errs anew, and so does what was followed from
    there.
    """
    by_hand = {(sequences[i], one.label): i for i, one in enumerate(trials) if one.annotated and one.label}
    sources: list[int | None] = []
    for i, (one, sequence) in enumerate(zip(trials, sequences)):
        source: int | None = i if one.annotated else None
        if one.followed_from and not one.annotated:
            # The frame that was marked need not be among these.
            source = by_hand.setdefault((sequence, one.followed_from), len(trials) + i)
        sources.append(source)
    first: dict[str, int] = {}
    for i in sorted(range(len(trials)), key=lambda i: (not trials[i].annotated, trials[i].load.size > 0.0)):
        if (known := sources[i]) is not None:
            first.setdefault(sequences[i], known)
    return tuple(None if source == first.get(sequence) else source for source, sequence in zip(sources, sequences))


def _marked_aside(pictures: Sequence[Picture], number: int) -> Iterator[int]:
    """``FurtherSight.marked``, from ``number`` on, of the corners of each radiograph from another side."""
    by_hand = {(one.sequence, one.label): number + i for i, one in enumerate(pictures) if not one.followed_from}
    for i, one in enumerate(pictures):
        # The radiograph that was marked need not be among these.
        anew = number + len(pictures) + i
        yield by_hand.setdefault((one.sequence, one.followed_from), anew) if one.followed_from else number + i


def sight_residuals(torso: TorsoModel, target: Sight, state: TorsoState) -> SightResiduals:
    """Simulated minus measured, with derivatives."""
    if isinstance(target, Target):
        return residuals(torso, target, state)
    if isinstance(target, MarkerTarget):
        difference = target.points.positions(torso, state) - target.z
        return MarkerResiduals(difference, target.points.jacobian(torso, state))
    view = target.trial.view
    detector, jacobian = view.project_with_jacobian(target.points.positions(state))
    slope = (jacobian / view.magnification) @ target.points.jacobian(state)
    return PointResiduals(view.to_patient_plane(detector) - target.z, slope, target.points.bone)


def _are_seen(pedicles: PediclePoints | None) -> bool:
    """Whether any is marked: one that is not is NaN."""
    return pedicles is not None and bool(np.isfinite(pedicles.points).all(2).any())


def _marker_target(torso: TorsoModel, trial: Trial, markers: SkinMarkers) -> MarkerTarget:
    rows = np.flatnonzero(np.isfinite(markers.positions).all(1))
    points = markers.points[rows]
    resting = points.positions(torso, torso.rest_pose)
    return MarkerTarget(trial, rows, points, markers.positions[rows], markers.outward[rows], resting)


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
