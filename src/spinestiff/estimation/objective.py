"""How far simulated vertebrae are from measured ones, and the derivatives of that (paper 4.1-4.2, Eqs. 8-12)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.tissue_points import PointsOnTissue
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, Ints, ShortRepr, read_only
from spinestiff.errors import FitError
from spinestiff.imaging.features import (
    FEATURE_SHAPE,
    Orientation,
    VertebraCorners,
    near_square,
    reference_boxes,
    silhouette_shares,
    state_features,
    target_features,
    used_corners,
    vertebra_rows,
)
from spinestiff.imaging.pedicles import PediclePoints
from spinestiff.imaging.projection import XRayView
from spinestiff.mechanics.loads import LoadCase
from spinestiff.words import counted

# With fewer the fit would rest on a short piece of the spine.
FEWEST_VERTEBRAE = 3


@dataclass(frozen=True, repr=False)
class Picture(ShortRepr):
    """Another radiograph of what a trial shows, from another side: the same equilibrium under the same force.

    Attributes
    ----------
    corners : of vertebrae.
    view : where source and detector were.
    label : for messages, e.g. "push 1 frame 3 lateral".
    sequence : radiographs of one carry the same name here: the patient stood alike before this detector.
    pedicles : marked in it.
    followed_from : label of the radiograph in which the corners were set by hand and from which tracking followed them;
        empty: set by hand in this one.
    """

    corners: VertebraCorners
    view: XRayView
    label: str
    sequence: str
    pedicles: PediclePoints | None = None
    followed_from: str = ""


@dataclass(frozen=True, repr=False)
class SkinMarkers(ShortRepr):
    """Markers on the skin, as cameras saw them under a trial's load.

    Attributes
    ----------
    names : (M,), the same in all frames of a sequence.
    positions : (M, 3) mm in the torso's place; NaN: not seen in this frame.
    points : (M) what of the torso's tissue carries them.
    outward : (M, 3) unit, the skin's direction there at rest.
    sequence : frames of one carry the same name here: the same markers before the same cameras.

    Raises
    ------
    FitError : wrong shapes, or a marker of which only some coordinates are there.
    """

    names: tuple[str, ...]
    positions: Floats
    points: PointsOnTissue
    outward: Floats
    sequence: str

    def __post_init__(self) -> None:
        shape = (len(self.names), 3)
        positions = np.array(self.positions, dtype=float)
        if positions.shape != shape or len(self.points) != len(self.names):
            raise FitError(
                f"{counted(len(self.names), 'marker')}, but positions of shape {positions.shape} and "
                f"{counted(len(self.points), 'point')} of the tissue; wanted three coordinates and a point of each"
            )
        seen = np.isfinite(positions)
        if (seen.any(1) != seen.all(1)).any():
            name = self.names[int(np.argmax(seen.any(1) != seen.all(1)))]
            raise FitError(f"marker '{name}' has some coordinates but not all; wanted three, or three times NaN")
        positions.flags.writeable = False
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "outward", read_only("outward directions", self.outward, shape, FitError))


@dataclass(frozen=True, repr=False)
class Trial(ShortRepr):
    """One radiograph under a known load (a term of Eq. 8), and what else is known of the same equilibrium.

    Attributes
    ----------
    load : the push.
    corners : the vertebrae's corners in the radiograph.
    view : where source and detector were.
    label : for messages, e.g. "push 1 frame 3".
    push : frames of one push carry the same name here; they share the error of the gauge and of the pushed point.
        Default: the label, so that every trial is its own push.
    annotated : the corners were set by hand in this radiograph; others' were tracked.
    followed_from : label of the frame from whose corners tracking followed these; empty: from those that were set by
        hand first of the push, or set by hand here.
    supports : measured "obliquity" (rad) and "shoulder" (mm), see ``mechanics.places.SupportPlace``, each with its
        standard deviation.
    tracked : vertebrae of an annotated radiograph that were tracked all the same, as nobody marked them in it.
    pedicles : marked in this radiograph. further : other radiographs of the same equilibrium. markers : on the skin,
        under the same load. Only the weighed fit makes use of them.
    """

    load: LoadCase
    corners: VertebraCorners
    view: XRayView
    label: str = ""
    push: str = ""
    annotated: bool = False
    supports: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    pedicles: PediclePoints | None = None
    further: tuple[Picture, ...] = ()
    markers: SkinMarkers | None = None
    followed_from: str = ""
    tracked: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.push:
            object.__setattr__(self, "push", self.label)
        for name, (value, sd) in self.supports.items():
            if name not in ("obliquity", "shoulder") or not (np.isfinite(value) and 0.0 < sd < np.inf):
                raise FitError(
                    f"{self.label or 'trial'}: support '{name}' at {value:g} with sd {sd:g}; wanted obliquity or "
                    "shoulder, finite, with an sd above 0"
                )

    def seen_in(self, picture: Picture) -> Trial:
        """A further radiograph as a trial by itself, under the same load."""
        return replace(
            self,
            corners=picture.corners,
            view=picture.view,
            label=picture.label,
            push=picture.sequence,
            annotated=not picture.followed_from,
            supports={},
            pedicles=picture.pedicles,
            further=(),
            markers=None,
            followed_from=picture.followed_from,
            tracked=(),
        )


@dataclass(frozen=True, repr=False)
class Target(ShortRepr):
    """What a trial's radiograph asks of a state; constant during a fit.

    Attributes
    ----------
    trial : where it comes from.
    rows : (Nv,) the visible vertebrae among the torso's.
    bones : (Nv,) their bones.
    z : (Nv, 4, 2) mm at the patient plane, measured features z-hat.
    quality : (Nv,) mean of a vertebra's usable corners.
    shares : (V, 4) from ``silhouette_shares`` in the rest pose.
    used : (V, 4) bool, corners that place the boxes.
    orientation : "procrustes" or "covariance".
    """

    trial: Trial
    rows: Ints
    bones: Ints
    z: Floats
    quality: Floats
    shares: Floats
    used: np.ndarray
    orientation: Orientation


@dataclass(frozen=True, repr=False)
class Residuals(ShortRepr):
    """Simulated minus measured features of one trial in one state.

    Attributes
    ----------
    difference : (Nv, 4, 2) mm at the patient plane, z - z-hat.
    jacobian : (Nv, 4, 2, 6), derivative in the pose of the vertebra's own bone.
    bones, quality : (Nv,), as in ``Target``.
    """

    difference: Floats
    jacobian: Floats
    bones: Ints
    quality: Floats

    @property
    def values(self) -> Floats:
        """(8 Nv,) mm, the differences in one row."""
        return self.difference.reshape(-1)

    @property
    def loss(self) -> float:
        """L = 1/2 sum |z-hat - z|^2, mm^2 (Eq. 9)."""
        return 0.5 * float(np.sum(self.values**2))

    @property
    def rmse(self) -> float:
        """Root of the mean, over corners, of the squared distance in the picture, mm."""
        return float(np.sqrt(np.mean(np.sum(self.difference**2, axis=2))))

    def gradient(self, dofs: int) -> Floats:
        """dL/dx (dofs,), what the adjoint needs (Eqs. 10-11).

        Eq. 11 as printed has the opposite sign: the derivative of 1/2 |z-hat - z|^2 is -(z-hat - z)^T dz.
        """
        blocks = np.einsum("vki,vkic->vc", self.difference, self.jacobian)
        gradient = np.zeros(dofs)
        np.add.at(gradient, self._columns.reshape(-1), blocks.reshape(-1))
        return gradient

    def along(self, directions: Floats) -> Floats:
        """(8 Nv, P) derivative of ``values`` along changes of state dx/dp (dofs, P)."""
        return self.moved(directions).reshape(-1, directions.shape[1])

    def moved(self, directions: Floats) -> Floats:
        """(Nv, 4, 2, P) derivative of ``difference`` along changes of state dx/dp (dofs, P)."""
        own = directions[self._columns.reshape(-1)].reshape(len(self.bones), 6, -1)
        return np.asarray(np.einsum("vkic,vcp->vkip", self.jacobian, own))

    @property
    def _columns(self) -> Ints:
        return np.asarray(6 * self.bones[:, None] + np.arange(6), dtype=np.int64)


def make_target(torso: TorsoModel, trial: Trial, orientation: Orientation = "procrustes") -> Target:
    """Measured features of a trial, with the silhouette as in ``torso``'s rest pose.

    Raises
    ------
    FitError : too few vertebrae.
    TrackingError : too few usable corners of a vertebra, or corners that fit no vertebra of the torso.
    """
    corners, name = trial.corners, trial.label or "trial"
    if len(corners) < FEWEST_VERTEBRAE:
        raise FitError(
            f"{name} shows {counted(len(corners), 'vertebra', 'vertebrae')}; wanted at least {FEWEST_VERTEBRAE}"
        )
    z = target_features(torso, trial.view, corners, orientation)
    rows = vertebra_rows(torso, corners)
    quality = np.sum(corners.quality, axis=1) / np.maximum(corners.usable.sum(1), 1)
    shares = silhouette_shares(torso, trial.view, torso.rest_pose)
    return Target(
        trial,
        read_only("rows", rows, (None,), FitError, np.int64),
        read_only("bones", torso.vertebra_bones[rows], (None,), FitError, np.int64),
        read_only("targets", z, (len(rows), *FEATURE_SHAPE), FitError),
        read_only("quality", quality, (len(rows),), FitError),
        shares,
        used_corners(torso, corners),
        orientation,
    )


def residuals(torso: TorsoModel, target: Target, state: TorsoState) -> Residuals:
    """z(x) - z-hat of the visible vertebrae of one trial (Eq. 9), with derivatives (Eq. 12)."""
    found = state_features(torso, target.trial.view, state, target.shares, target.orientation, target.used)
    rows = target.rows
    difference = found.z[rows] - target.z
    return Residuals(difference, found.jacobian[rows], target.bones, target.quality)


def undetermined_vertebrae(torso: TorsoModel, target: Target) -> tuple[str, ...]:
    """Visible vertebrae whose orientation by covariance means little (near-square box); none for Procrustes."""
    if target.orientation != "covariance":
        return ()
    square = near_square(reference_boxes(torso, target.trial.view))[target.rows]
    return tuple(name for name, flag in zip(target.trial.corners.vertebrae, square) if flag)


def root_mean_square(parts: Sequence[Residuals]) -> float:
    """RMSE in mm over all corners of several trials."""
    squares = np.concatenate([np.sum(part.difference**2, axis=2).reshape(-1) for part in parts])
    return float(np.sqrt(squares.mean()))
