"""Geometric image features of vertebrae and their derivatives (paper 2.2, 4.1 and Fig. 3, Eqs. 9, 11, 12).

A vertebra is seen as four corners in the picture. They give a centre and an orientation, and these place a reference
box of known width and height; the placed box's corners are the features z. Features of radiographs and of simulated
states go the same way, so that they may differ in shape (annotation, template) and still be compared.

Every feature is in mm at the patient plane: Eq. 9 as printed adds a centre in magnified detector mm to box corners in
anatomical mm. Pictures are left-handed to read (rows grow downwards), so no sign here is written down: what is "up"
and what is "first" follows from the view's ``detector_axes``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, Ints, ShortRepr, read_only
from spinestiff.errors import RadiographError, SpinestiffError, TrackingError
from spinestiff.imaging.planar import cross
from spinestiff.imaging.silhouette import halves, rim_share
from spinestiff.words import counted

if TYPE_CHECKING:
    from spinestiff.imaging.projection import XRayView

Orientation = Literal["procrustes", "covariance"]
ORIENTATIONS: tuple[Orientation, ...] = ("procrustes", "covariance")
# Below this (w^2 - h^2) / (w^2 + h^2) of the reference box the principal axes of four corners carry little or no
# orientation: noise is amplified ten times and more over Procrustes.
NEAR_SQUARE = 0.1
FEWEST_CORNERS = 3
# A picture and a torso of the same person differ in size by far less than this factor; beyond it units are wrong.
SIZE_LIMITS = (0.4, 2.5)
# A vertebra in a picture: this many corners, with (u, v) each. Arrays of features are (V, *FEATURE_SHAPE).
CORNERS = 4
FEATURE_SHAPE = (CORNERS, 2)
# Corner order: (superior 0 or inferior 1, first 0 or second 1).
_LEVEL = np.array([0, 0, 1, 1])
_SIDE = np.array([0, 1, 1, 0])


@dataclass(frozen=True, repr=False)
class VertebraCorners(ShortRepr):
    """Corners of the vertebrae visible in one radiograph.

    Attributes
    ----------
    vertebrae : (Nv,) names, each once.
    corners : (Nv, 4, 2) mm on the detector (u along columns, v along rows), in the order superior-first,
        superior-second, inferior-second, inferior-first; "first" is the patient's left in a frontal and anterior in
        a lateral view.
    quality : (Nv, 4) in 0..1; 0 = not usable. Default 1.

    Raises
    ------
    TrackingError : wrong shapes, unknown or repeated names, quality outside 0..1.
    """

    vertebrae: tuple[str, ...]
    corners: Floats
    quality: Floats = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        names = tuple(self.vertebrae)
        object.__setattr__(self, "vertebrae", names)
        unknown = [name for name in names if name not in VERTEBRAE]
        if unknown:
            raise TrackingError(f"corners name '{unknown[0]}'; wanted vertebrae T1..T12, L1..L5")
        if len(set(names)) != len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise TrackingError(f"corners of {twice} are given more than once")
        n = len(names)
        object.__setattr__(self, "corners", read_only("corners", self.corners, (n, *FEATURE_SHAPE), TrackingError))
        quality = np.ones((n, CORNERS)) if self.quality is None else self.quality
        quality = read_only("corner quality", quality, (n, CORNERS), TrackingError)
        if n and (quality.min() < 0.0 or quality.max() > 1.0):
            raise TrackingError(f"corner quality {quality.min():.3g}..{quality.max():.3g}; wanted 0..1")
        object.__setattr__(self, "quality", quality)

    def __len__(self) -> int:
        return len(self.vertebrae)

    @property
    def usable(self) -> np.ndarray:
        """(Nv, 4) bool, corners with a quality above 0."""
        return np.asarray(self.quality > 0.0)

    def selected(self, names: tuple[str, ...]) -> VertebraCorners:
        """The corners of ``names`` that are here, in this order."""
        which = [self.vertebrae.index(name) for name in names if name in self.vertebrae]
        chosen = tuple(self.vertebrae[i] for i in which)
        return VertebraCorners(chosen, self.corners[which], self.quality[which])


@dataclass(frozen=True, repr=False)
class Features(ShortRepr):
    """Features of a state, V vertebrae of the torso.

    Attributes
    ----------
    z : (V, 4, 2) mm at the patient plane, corners of the placed reference box.
    jacobian : (V, 4, 2, 6), derivative in (dt, dw) of the vertebra's own bone, mm/mm and mm/rad.
    corners : (V, 4, 2) mm on the detector, the silhouette's corners.
    angle : (V,) rad, turn of the box in the picture, from u towards v.
    """

    z: Floats
    jacobian: Floats
    corners: Floats
    angle: Floats


def view_kind(view: XRayView) -> Literal["frontal", "lateral"]:
    """Frontal if the detector faces front or back, lateral if it faces a side.

    Raises
    ------
    RadiographError : the detector faces up or down.
    """
    normal = np.abs(np.cross(view.detector_axes[0], view.detector_axes[1]))
    axis = int(np.argmax(normal))
    if axis == 1:
        raise RadiographError("the detector faces up or down; wanted a frontal or a lateral view")
    return "lateral" if axis == 0 else "frontal"


def picture_axes(view: XRayView) -> tuple[Floats, Floats]:
    """Unit directions (2,) in the picture of "first" (left or anterior) and of "superior", at right angles."""
    axes = np.asarray(view.detector_axes)
    up = axes @ np.array([0.0, 1.0, 0.0])
    up = up / np.linalg.norm(up)
    wanted = axes @ np.array([1.0, 0.0, 0.0] if view_kind(view) == "frontal" else [0.0, 0.0, 1.0])
    first = np.array([-up[1], up[0]])
    return (first if first @ wanted > 0.0 else -first), up


def box_sizes(torso: TorsoModel) -> Floats:
    """(V, 3) mm: left-right width, height and antero-posterior depth of each vertebra's box."""
    box = torso.vertebra_boxes.reshape(-1, 2, 2, 2, 3)
    middle = [box[:, :, 0].mean((1, 2)) - box[:, :, 1].mean((1, 2))]
    middle.append(box[:, 0].mean((1, 2)) - box[:, 1].mean((1, 2)))
    middle.append(box[:, :, :, 0].mean((1, 2)) - box[:, :, :, 1].mean((1, 2)))
    return np.linalg.norm(np.stack(middle, 1), axis=2)


def reference_boxes(torso: TorsoModel, view: XRayView) -> Floats:
    """Corners r (V, 4, 2) mm of the reference boxes, centred, upright in the picture (paper 4.1)."""
    first, up = picture_axes(view)
    sizes = box_sizes(torso)
    width = sizes[:, 0] if view_kind(view) == "frontal" else sizes[:, 2]
    height = sizes[:, 1]
    along = (0.5 - _SIDE)[None, :] * width[:, None]
    above = (0.5 - _LEVEL)[None, :] * height[:, None]
    return along[:, :, None] * first + above[:, :, None] * up


def silhouette_shares(torso: TorsoModel, view: XRayView, state: TorsoState) -> Floats:
    """Where between the two box corners of each pair the silhouette has its corner, (V, 4) from -1 to 1.

    In a frontal view the pair is (anterior, posterior), in a lateral one (left, right); 1 is its first, 0 midway. See
    ``imaging.silhouette``; the paper (4.1) takes one of the two, 1 or -1.

    Take them in the rest pose and keep them through a fit: optical flow follows what was annotated in the first frame,
    and features stay smooth.
    """
    middle, half = halves(silhouette_pairs(torso, view))
    bones = torso.vertebra_bones
    beam = np.einsum("vji,vj->vi", state.bone_rotations[bones], state.bone_positions[bones] - view.source)
    return rim_share(middle, half, middle + beam[:, None], depth_axis(view))


def state_features(
    torso: TorsoModel,
    view: XRayView,
    state: TorsoState,
    shares: Floats | None = None,
    orientation: Orientation = "procrustes",
    used: np.ndarray | None = None,
) -> Features:
    """Simulated features z(x) of all vertebrae with their derivative (paper 4.1, Eq. 12).

    Parameters
    ----------
    torso, view : what is seen, from where.
    state : its pose.
    shares : (V, 4) from ``silhouette_shares``; default: those of the rest pose, which many states may share.
    orientation : "procrustes" (default) or "covariance" (the paper's SVD).
    used : (V, 4) bool, corners that also the radiograph has (``used_corners``); default all. A box is placed by these
        alone, so that a lost corner does not shift the simulated against the measured box.
    """
    count = len(torso.vertebrae)
    shares = silhouette_shares(torso, view, torso.rest_pose) if shares is None else shares
    shares = read_only("silhouette shares", shares, (count, CORNERS), RadiographError)
    middle, half = halves(silhouette_pairs(torso, view))
    corners = (middle + shares[..., None] * half).reshape(-1, 3)
    points = PointsOnBones(np.repeat(torso.vertebra_bones, CORNERS), corners)
    detector, jacobian = view.project_with_jacobian(points.positions(state))
    seen = view.to_patient_plane(detector).reshape(count, *FEATURE_SHAPE)
    # The patient plane's picture is the detector's, shrunk by the magnification.
    moves = (jacobian / view.magnification) @ points.jacobian(state)
    moves = moves.reshape(count, *FEATURE_SHAPE, 6)
    placed = place_boxes(seen, reference_boxes(torso, view), orientation, used, torso.vertebrae)
    turned = np.einsum("vkic,vki->vc", moves, placed.angle_gradient)
    centre = np.einsum("vkic,vk->vic", moves, placed.centre_weights)
    # z_k = v + R (r_k - r_mean): the turn moves it at right angles to its arm.
    arms = placed.z - placed.centre[:, None, :]
    quarter = np.stack([-arms[..., 1], arms[..., 0]], -1)
    full = centre[:, None] + quarter[..., None] * turned[:, None, None, :]
    return Features(placed.z, full, detector.reshape(count, *FEATURE_SHAPE), placed.angle)


def target_features(
    torso: TorsoModel, view: XRayView, corners: VertebraCorners, orientation: Orientation = "procrustes"
) -> Floats:
    """Measured features z-hat (Nv, 4, 2) mm at the patient plane (paper 4.1), in the order of ``corners.vertebrae``.

    Raises
    ------
    TrackingError : a vertebra that the torso lacks, fewer than three usable corners, corners in mirrored order, or a
        size that fits no vertebra (wrong pixel spacing or distances).
    """
    which = vertebra_rows(torso, corners)
    boxes = reference_boxes(torso, view)[which]
    seen = view.to_patient_plane(corners.corners.reshape(-1, 2)).reshape(-1, *FEATURE_SHAPE)
    check_corners(seen, boxes, corners)
    return place_boxes(seen, boxes, orientation, corners.usable, corners.vertebrae).z


def used_corners(torso: TorsoModel, corners: VertebraCorners) -> np.ndarray:
    """(V, 4) bool of the torso's vertebrae: corners that ``corners`` have; all four of one that they do not name."""
    used = np.ones((len(torso.vertebrae), CORNERS), dtype=bool)
    used[vertebra_rows(torso, corners)] = corners.usable
    return used


def vertebra_rows(torso: TorsoModel, corners: VertebraCorners) -> Ints:
    """(Nv,) rows of the torso's vertebrae that the corners name."""
    for name in corners.vertebrae:
        if name not in torso.vertebrae:
            raise TrackingError(f"corners name {name}, but this torso has no such vertebra")
    return np.array([torso.vertebrae.index(name) for name in corners.vertebrae], dtype=np.int64)


def near_square(boxes: Floats) -> np.ndarray:
    """(V,) bool: |w^2 - h^2| / (w^2 + h^2) of boxes (V, 4, 2) below ``NEAR_SQUARE``."""
    width2 = np.sum((boxes[:, 0] - boxes[:, 1]) ** 2, -1)
    height2 = np.sum((boxes[:, 0] - boxes[:, 3]) ** 2, -1)
    return np.asarray(np.abs(width2 - height2) < NEAR_SQUARE * (width2 + height2))


def check_corners(seen: Floats, boxes: Floats, corners: VertebraCorners) -> None:
    """Raise TrackingError, naming the vertebra, for corners (mm at the patient plane) that are no picture of it."""
    usable = corners.usable
    for name, quad, box, use in zip(corners.vertebrae, seen, boxes, usable):
        if use.sum() < FEWEST_CORNERS:
            raise TrackingError(
                f"{name} has {counted(int(use.sum()), 'usable corner')}, wanted at least {FEWEST_CORNERS}; leave it out"
            )
        c, r = quad[use] - quad[use].mean(0), box[use] - box[use].mean(0)
        size = np.hypot(np.sum(r * c), np.sum(cross(r, c))) / np.sum(r * r)
        # Walking around, every turn of the corners must be the box's: mirrored and crossed orders differ.
        turns = cross(np.roll(quad, -1, 0) - quad, np.roll(quad, -2, 0) - np.roll(quad, -1, 0))
        wanted = cross(box[1] - box[0], box[2] - box[1])
        convex = use[np.arange(4)] & use[np.arange(-3, 1)] & use[np.arange(-2, 2)]
        if (turns * wanted < 0.0)[convex].any():
            raise TrackingError(
                f"corners of {name} are mirrored, crossed or dented; wanted superior-first, superior-second, "
                "inferior-second, inferior-first (first = patient's left, or anterior in a lateral view)"
            )
        if np.sum(r * c) < 0.0:
            raise TrackingError(f"{name} lies upside down in the picture; check the corner order and the orientation")
        if not SIZE_LIMITS[0] < size < SIZE_LIMITS[1]:
            raise TrackingError(
                f"{name} in the picture is {size:.3g} times its size in the model; check pixel spacing and distances"
            )


@dataclass(frozen=True, repr=False)
class PlacedBoxes(ShortRepr):
    """Reference boxes placed on corners.

    Attributes
    ----------
    z : (V, 4, 2) mm, placed corners.
    centre : (V, 2) mm, mean of the used corners; ``z - centre`` is what turns.
    angle : (V,) rad.
    angle_gradient : (V, 4, 2) rad/mm, derivative of the angle in the seen corners.
    centre_weights : (V, 4), derivative of the centre in the seen corners.
    """

    z: Floats
    centre: Floats
    angle: Floats
    angle_gradient: Floats
    centre_weights: Floats


def place_boxes(
    seen: Floats,
    boxes: Floats,
    orientation: Orientation,
    used: np.ndarray | None = None,
    names: tuple[str, ...] = (),
) -> PlacedBoxes:
    """Place reference boxes (V, 4, 2) on seen corners (V, 4, 2), both in mm: z = v + R r (paper 4.1).

    v is the mean of the used corners and R the turn that carries the box's used corners, about their mean, onto them.

    Raises
    ------
    TrackingError : fewer than three used corners, or corners that fall into one point.
    """
    if orientation not in ORIENTATIONS:
        raise RadiographError(f"unknown orientation '{orientation}'; wanted one of {', '.join(ORIENTATIONS)}")
    used = np.ones(seen.shape[:2], dtype=bool) if used is None else np.asarray(used, dtype=bool)
    counts = used.sum(1)
    if len(counts) and counts.min() < FEWEST_CORNERS:
        bad = int(np.argmin(counts))
        raise TrackingError(
            f"{_name(names, bad)} has {counted(int(counts[bad]), 'usable corner')}, wanted at least {FEWEST_CORNERS}"
        )
    weights = used / counts[:, None]
    centre = np.einsum("vk,vki->vi", weights, seen)
    middle = np.einsum("vk,vki->vi", weights, boxes)
    c = (seen - centre[:, None]) * used[..., None]
    r = (boxes - middle[:, None]) * used[..., None]
    angle, gradient = _procrustes(c, r, names)
    if orientation == "covariance":
        complete = counts == CORNERS
        # Three corners have principal axes that are not the box's: they keep the Procrustes angle.
        turned, turned_gradient = _principal(c, boxes, angle)
        angle = np.where(complete, turned, angle)
        gradient = np.where(complete[:, None, None], turned_gradient, gradient)
    cosine, sine = np.cos(angle), np.sin(angle)
    rotation = np.stack([np.stack([cosine, -sine], -1), np.stack([sine, cosine], -1)], -2)
    z = centre[:, None] + np.einsum("vij,vkj->vki", rotation, boxes - middle[:, None])
    return PlacedBoxes(z, centre, angle, gradient, weights)


def _procrustes(c: Floats, r: Floats, names: tuple[str, ...]) -> tuple[Floats, Floats]:
    """Angle = atan2(sum r x c, sum r . c) and its derivative in c, for centred corners."""
    along = np.einsum("vki,vki->v", r, c)
    across = np.sum(cross(r, c), axis=1)
    size2 = along**2 + across**2
    scale = np.einsum("vki,vki->v", r, r) ** 2
    if len(size2) and (size2 <= 1e-12 * scale).any():
        bad = int(np.argmin(size2 / scale))
        raise TrackingError(
            f"the corners of {_name(names, bad)} give no orientation (they fall together or are mirrored)"
        )
    # d across / dc = (-r_y, r_x), d along / dc = r. The r are centred, so the centre's motion drops out.
    quarter = np.stack([-r[..., 1], r[..., 0]], -1)
    gradient = (along[:, None, None] * quarter - across[:, None, None] * r) / size2[:, None, None]
    return np.arctan2(across, along), gradient


def _principal(c: Floats, boxes: Floats, guess: Floats) -> tuple[Floats, Floats]:
    """Angle of the principal axes of C = 1/4 sum c c^T and its derivative in c (paper 4.1, Eq. 12's dR/dC).

    For a symmetric 2 x 2 matrix the SVD's derivative (Papadopoulo & Lourakis 2000) is the closed form
    d angle = ((Cxx - Cyy) dCxy - Cxy (dCxx - dCyy)) / ((Cxx - Cyy)^2 + 4 Cxy^2), singular for a square. The axes are
    known up to quarter turns; the one nearest to ``guess`` (Procrustes) is meant.
    """
    cxx, cyy, cxy = (np.mean(c[..., i] * c[..., j], axis=1) for i, j in ((0, 0), (1, 1), (0, 1)))
    gap2 = (cxx - cyy) ** 2 + 4.0 * cxy**2
    # An exact square has no axes at all: keep the guess's side finite; ``near_square`` flags it.
    gap2 = np.maximum(gap2, 1e-12 * (cxx + cyy) ** 2)
    first = boxes[:, 0] - boxes[:, 1]
    turn = 0.5 * np.arctan2(2.0 * cxy, cxx - cyy) - np.arctan2(first[:, 1], first[:, 0])
    quarters = np.round((guess - turn) / (0.5 * np.pi))
    dxx, dxy = 0.5 * c[..., 0], 0.25 * c[..., ::-1]
    dyy = 0.5 * c[..., 1]
    difference = np.stack([dxx, -dyy], -1)
    gradient = ((cxx - cyy)[:, None, None] * dxy - cxy[:, None, None] * difference) / gap2[:, None, None]
    return turn + quarters * 0.5 * np.pi, gradient


def silhouette_pairs(torso: TorsoModel, view: XRayView) -> Floats:
    """(V, 4, 2, 3) mm in the vertebra's frame: box corners behind one another in the beam, corners in picture order."""
    box = torso.vertebra_boxes.reshape(-1, 2, 2, 2, 3)
    if view_kind(view) == "lateral":
        box = box.swapaxes(2, 3)
    return np.asarray(box[:, _LEVEL, _SIDE])


def depth_axis(view: XRayView) -> int:
    """The axis of an upright vertebra that lies along the beam."""
    return 2 if view_kind(view) == "frontal" else 0


def _name(names: tuple[str, ...], index: int) -> str:
    return names[index] if index < len(names) else f"vertebra {index}"


def rmse(corners: ArrayLike, others: ArrayLike) -> float:
    """sqrt(mean over corners of the squared 2D distance), in the unit of the input.

    This is our reading of the RMSE in the paper's Table 5; the paper prints no formula.

    Parameters
    ----------
    corners, others : (..., 2), the same shape; mm at the patient plane wherever it is reported.

    Raises
    ------
    SpinestiffError : shapes differ, no corner at all, or a value that is not finite.
    """
    a, b = np.asarray(corners, dtype=float), np.asarray(others, dtype=float)
    if a.shape != b.shape or a.ndim < 1 or a.shape[-1] != 2:
        raise SpinestiffError(f"RMSE of corners of shape {a.shape} and {b.shape}; wanted the same shape (..., 2)")
    if a.size == 0:
        raise SpinestiffError("RMSE of no corners at all; wanted at least one")
    squared = np.sum((a - b) ** 2, axis=-1)
    if not np.isfinite(squared).all():
        raise SpinestiffError("RMSE of corners that are not finite")
    return float(np.sqrt(np.mean(squared)))
