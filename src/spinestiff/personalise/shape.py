"""The subject's own geometry from annotated rest radiographs (paper 3.1): found, moved to, made the rest state.

The vertebrae's most probable poses and sizes come first (``personalise.adjustment``), under the elastic energy of the
whole torso condensed to them (``personalise.prior``). Then the same engine brings the torso there: springs at box
corners, rising in steps, pull the vertebrae, and ribs, girdle, tissue and skin follow mechanically. The energy is
condensed anew around that state and the vertebrae are adjusted again; what they then need moves them a last time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, ShortRepr
from spinestiff.errors import EquilibriumError, FitError, TorsoError
from spinestiff.imaging.features import VertebraCorners, view_kind
from spinestiff.imaging.pedicles import PediclePoints
from spinestiff.imaging.projection import XRayView
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.observer import Observer
from spinestiff.personalise.adjustment import WRONG_WEIGHT, Adjusted, adjust
from spinestiff.personalise.alignment import aligned, moved_whole
from spinestiff.personalise.fitness import VertebraFit, check_pictures, vertebra_fits
from spinestiff.personalise.image_terms import (
    UNKNOWNS,
    ImagePoints,
    image_points,
    own_boxes,
    shape_of,
)
from spinestiff.personalise.measured_skin import TrunkSize, skin_at_sizes, trunk_misses, with_trunk_sizes
from spinestiff.personalise.placing import pulled
from spinestiff.personalise.pose import ViewPose, posed
from spinestiff.personalise.prior import elastic_prior, pelvis_on_springs
from spinestiff.personalise.quality import MeshQuality, require_quality
from spinestiff.personalise.rebuild import NODES, can_rebuild, skin_of, with_new_tissue, without_tissue
from spinestiff.personalise.scan import SkinScan
from spinestiff.personalise.scanned_skin import ScanFit, with_scan
from spinestiff.personalise.sizes import resized

Geometry = Literal["estimated", "known"]
GEOMETRIES: tuple[Geometry, ...] = ("estimated", "known")
MeshPath = Literal["kept", "rebuilt", "finer"]
# How a patient may stand in a view whose geometry is nominal: standard deviations of shift (mm), roll and yaw (rad). A
# lean seen at rest is the person's own (about 3 degrees from one to the next) rather than the stance of the moment
# (about 0.7 degrees). The frontal view says what is frontal, so only the lateral one has a yaw.
SHIFT_SD, ROLL_SD, YAW_SD = 200.0, np.deg2rad(0.7), np.deg2rad(3.0)
# Log of a spine's length along its vertebrae, over that from end to end, that is worth another adjustment.
SAME_LENGTH = 0.002
# Springs at the box corners that bring the vertebrae to their places, N/mm, from loose to tight.
PULLS = (30.0, 1000.0)
# Beyond this share a vertebra's motion is the prior's more than its own images'.
CARRIED = 0.5

NEW_MESH: Mapping[MeshPath, str] = {
    "rebuilt": "the tissue mesh could not be carried to the subject's shape; a new one was built in the subject's skin",
    "finer": "the coarse tissue mesh could not be carried to the subject's shape; the fine one was used",
}
# mm by which a trunk may miss its tape before somebody is told: a hundredth of it, as which the estimate takes it.
TAPE_MM = 2.0

MOTIONS = ("sideways", "height", "front to back", "sagittal tilt", "axial rotation", "coronal tilt")


@dataclass(frozen=True, repr=False)
class Personalised(ShortRepr):
    """A torso shaped to a subject.

    Attributes
    ----------
    torso : at rest in the subject's shape.
    views : the moved view of each radiograph.
    poses : the estimated pose in each view.
    rmse_mm : corner RMSE at the patient plane in each view, of corners that were not set aside as wrong.
    fits : per view, per vertebra seen: how well it fits.
    prior_only : vertebrae that no radiograph shows.
    carried : vertebra -> its motions (``MOTIONS``) that the prior determines more than its own images do.
    covariance : (6V, 6V) of the vertebrae's (dt mm, dw rad), vertebra by vertebra.
    length_scale : the spine's length over the template's.
    size_scale : (V, 3) width, height and depth of the vertebrae over the template's.
    corner_sd_mm : standard deviation of the annotated corners along one axis, from their residuals.
    quality : of the tissue mesh.
    scan : how the skin fits its scan, if there is one.
    mesh : "kept", the template's mesh was carried along; "rebuilt", a new one was built in the carried skin (extra
        [mesh]); "finer", the finer template's was carried along.
    warnings : what a user should know, a line each.
    """

    torso: TorsoModel
    views: Mapping[str, XRayView]
    poses: Mapping[str, ViewPose]
    rmse_mm: Mapping[str, float]
    fits: Mapping[str, Mapping[str, VertebraFit]]
    prior_only: tuple[str, ...]
    carried: Mapping[str, tuple[str, ...]]
    covariance: Floats
    length_scale: float
    size_scale: Floats
    corner_sd_mm: float
    quality: MeshQuality
    mesh: MeshPath = "kept"
    scan: ScanFit | None = None
    warnings: tuple[str, ...] = field(default=())


def personalise(
    template: TorsoModel,
    pictures: Mapping[str, tuple[VertebraCorners, XRayView]],
    observer: Observer | None = None,
    *,
    pedicles: Mapping[str, PediclePoints] | None = None,
    geometry: Geometry = "estimated",
    finer: Callable[[], TorsoModel] | None = None,
    trunk: Mapping[str, TrunkSize] | None = None,
    scan: SkinScan | None = None,
) -> Personalised:
    """Shape ``template`` to annotated rest radiographs (paper 3.1; Koutras 2022's approach).

    The result becomes the stress-free rest state. Where the tissue mesh can't be moved that far, a new one is built
    in the moved skin if the extra [mesh] is installed.

    Parameters
    ----------
    template : scaled to the subject's height.
    pictures : view name -> annotated corners and nominal view, e.g. "frontal" and "lateral". A frontal one is needed;
        with it alone the sagittal shape stays the template's, and a warning says so.
    observer : called with a line for each step.
    pedicles : by view name, optional; in the frontal view they determine axial rotation.
    geometry : "estimated", the patient may stand otherwise in each view than its geometry says (shift, roll and, in the
        lateral one, yaw); "known", views are exact, as from a calibrated biplanar system.
    finer : makes a template on a finer mesh, tried where this one can't be moved that far and none can be built.
    trunk : optional breadths and depths of the trunk by the bone at whose height they were taken; they move the skin.
    scan : optional surface scan of the trunk; it moves the skin, after the trunk's extents.

    Raises
    ------
    SubjectError : a scan that is none of this body.
    EquilibriumError, TorsoError : no mesh can be moved that far without elements turning over or degenerating.
    FitError : corners that contradict each other.
    TrackingError : corners that are no picture of this torso, or no frontal view.
    """
    if geometry not in GEOMETRIES:
        raise FitError(f"unknown geometry '{geometry}'; wanted one of {', '.join(GEOMETRIES)}")
    check_pictures(template, pictures, pedicles or {})
    fit = _Fit(pictures, pedicles or {}, geometry == "known", trunk or {}, scan, observer or (lambda line: None))
    try:
        return fit.run(template)
    except (EquilibriumError, TorsoError) as error:
        hint = "" if can_rebuild(template) else '; pip install "spinestiff[mesh]" lets a new mesh be built'
        if finer is None:
            raise type(error)(f"{error}; a finer tissue mesh may do{hint}") from None
        fit.say(f"{error}; trying a finer mesh")
        try:
            found = fit.run(finer())
        except (EquilibriumError, TorsoError) as again:
            raise type(again)(
                f"{again}, on the fine mesh too; check corners, spacing, tape and body height{hint}"
            ) from None
        if found.mesh == "rebuilt":
            return found
        fit.say(NEW_MESH["finer"])
        return replace(found, mesh="finer", warnings=(*found.warnings, NEW_MESH["finer"]))


class _Fit:
    """One fit: what was annotated, and the steps from a template to the subject."""

    def __init__(
        self,
        pictures: Mapping[str, tuple[VertebraCorners, XRayView]],
        pedicles: Mapping[str, PediclePoints],
        known: bool,
        trunk: Mapping[str, TrunkSize],
        scan: SkinScan | None,
        say: Observer,
    ) -> None:
        self.pictures, self.pedicles, self.known, self.say = pictures, pedicles, known, say
        self.trunk, self.scan = trunk, scan
        self.names = tuple(pictures)
        sd = np.zeros((len(pictures), 4))
        if not known:
            sd[:, :3] = SHIFT_SD, SHIFT_SD, ROLL_SD
            sd[:, 3] = [YAW_SD if view_kind(view) == "lateral" else 0.0 for _, view in pictures.values()]
        self.pose_sd = sd

    def run(self, template: TorsoModel) -> Personalised:
        base, first, length = self.at_its_length(template)
        points = self.points(base)
        sized = replace(resized(base, np.exp(first.shape.log_sizes)), vertebra_boxes=own_boxes(base, first.shape))
        problem = EquilibriumProblem(sized, pelvis_on_springs(sized))
        state = pulled(problem, sized.rest_pose, first.shape.positions, first.shape.rotations, PULLS)
        self.say("torso moved to the radiographs")
        start = replace(
            first.shape,
            positions=state.bone_positions[sized.vertebra_bones],
            rotations=state.bone_rotations[sized.vertebra_bones],
        )
        prior = elastic_prior(EquilibriumProblem(sized, pelvis_on_springs(sized, frontal=True)), state)
        final = adjust(points, prior, start, first.poses, self.pose_sd, first.corner_sd, self.say)
        before, after = (np.concatenate(found.weights) < WRONG_WEIGHT for found in (first, final))
        if (after & ~before).any():
            # What the first adjustment could explain is not wrong: the energy's new tangent led away from it.
            final = first
        state = pulled(problem, state, final.shape.positions, final.shape.rotations, PULLS[-1:])
        boxes = own_boxes(base, final.shape)

        def finished(moved: TorsoModel, at: TorsoState) -> TorsoModel:
            torso = resized(moved.rebased(at), np.exp(final.shape.log_sizes - first.shape.log_sizes))
            return replace(torso, vertebra_boxes=boxes, height_cm=template.height_cm)

        mesh: MeshPath = "kept"
        new: tuple[str, ...] = ()
        try:
            torso = with_trunk_sizes(finished(sized, state), self.trunk)
            new = self.missed(torso)
            torso, scanned = self.scanned(torso)
            quality = require_quality(torso)
        except TorsoError as error:
            if not can_rebuild(sized):
                raise
            self.say(f"{error}; building a new mesh")
            bare = finished(*without_tissue(sized, state))
            vertices, faces = skin_of(sized, state)
            skin = (skin_at_sizes(bare, vertices, faces, self.trunk), faces)
            nodes = int(np.clip(len(sized.tissue.rest_positions), *NODES))
            torso = self.to_tape(with_new_tissue(bare, skin, sized, state, self.say, nodes=nodes))
            mesh, new = "rebuilt", (NEW_MESH["rebuilt"], *self.missed(torso))
            torso, scanned = self.scanned(torso)
            quality = require_quality(torso)
        self.say(f"{quality}; tissue mesh {mesh}, {len(torso.tissue.rest_positions)} nodes")
        found = self.result(torso, final, points, length, quality, scanned)
        return replace(found, mesh=mesh, warnings=(*found.warnings, *new))

    def at_its_length(self, template: TorsoModel) -> tuple[TorsoModel, Adjusted, float]:
        """The template, its spine as long as the subject's along the vertebrae; the adjustment from there; the factor.

        The rigid template's factor is that of the distances across the spine, of which a curve takes some away (80
        degrees: a tenth).
        """
        base, poses, length = aligned(template, self.points(template), self.pose_sd, self.known)
        first = self.first(base, poses)
        longer = self.straightened(base, first.shape.positions)
        if abs(np.log(longer)) > SAME_LENGTH:
            base, length = base.scaled(longer), longer * length
            if self.known:
                middle = base.rest_pose.bone_positions[base.vertebra_bones].mean(0)
                base = moved_whole(base, np.eye(3), (1.0 / longer - 1.0) * middle, np.zeros(3))
            first = self.first(base, first.poses)
        self.say(f"spine {length:.3f} times the template's length")
        return base, first, length

    def first(self, base: TorsoModel, poses: Floats) -> Adjusted:
        """The adjustment from the template at rest."""
        prior = elastic_prior(EquilibriumProblem(base, pelvis_on_springs(base, frontal=True)), base.rest_pose)
        start = shape_of(base, base.rest_pose)
        return adjust(self.points(base), prior, start, poses, self.pose_sd, observer=self.say)

    def straightened(self, base: TorsoModel, positions: Floats) -> float:
        """Length along the vertebrae that a frontal view shows over that of ``base``, both over their distances.

        It does not know how large the pictures are, only how the spine is bent more or less than that of ``base``.
        """
        shown = {
            name
            for corners, view in self.pictures.values()
            if view_kind(view) == "frontal"
            for name in corners.vertebrae
        }
        rows = [name in shown for name in base.vertebrae]
        own, found = base.rest_pose.bone_positions[base.vertebra_bones][rows], positions[rows]
        if len(own) < 3:
            return 1.0
        along = [np.linalg.norm(np.diff(places, axis=0), axis=1).sum() for places in (own, found)]
        own, found = own - own.mean(0), found - found.mean(0)
        return float(along[1] / along[0] / (np.sum(own * found) / np.sum(own**2)))

    def scanned(self, torso: TorsoModel) -> tuple[TorsoModel, ScanFit | None]:
        """The torso with its skin at the scan, if there is one."""
        if self.scan is None:
            return torso, None
        moved, fit = with_scan(torso, self.scan)
        self.say(str(fit))
        return moved, fit

    def to_tape(self, torso: TorsoModel) -> TorsoModel:
        """A new mesh, whose skin is some mm off, with the skin at the trunk's extents if it bears that."""
        try:
            moved = with_trunk_sizes(torso, self.trunk)
            require_quality(moved)
            return moved
        except TorsoError:
            return torso

    def missed(self, torso: TorsoModel) -> tuple[str, ...]:
        """Where the skin is off the trunk's extents, in words."""
        return tuple(
            f"the skin at {level} is {size.breadth_mm:.0f} by {size.depth_mm:.0f} mm, not "
            f"{self.trunk[level].breadth_mm:g} by {self.trunk[level].depth_mm:g} mm: bones or tissue mesh leave no room"
            for level, (size, miss) in trunk_misses(torso, self.trunk).items()
            if miss > TAPE_MM
        )

    def points(self, base: TorsoModel) -> tuple[ImagePoints, ...]:
        """What is annotated, on the vertebrae of ``base``."""
        return tuple(
            image_points(base, view, corners, self.pedicles.get(name))
            for name, (corners, view) in self.pictures.items()
        )

    def result(
        self,
        torso: TorsoModel,
        final: Adjusted,
        points: Sequence[ImagePoints],
        length: float,
        quality: MeshQuality,
        scanned: ScanFit | None,
    ) -> Personalised:
        views, poses, fits, rmse = {}, {}, {}, {}
        pedicles: dict[str, tuple[str, ...]] = {}
        for name, pose, weights, view in zip(self.names, final.poses, final.weights, points):
            corners, nominal = self.pictures[name]
            shift, roll, yaw = pose[:2], float(pose[2]), float(pose[3])
            views[name] = posed(nominal, shift, roll, yaw)
            marked = weights[view.outward == 0.0]
            aside = view.vertebra[(view.outward != 0.0) & (weights < WRONG_WEIGHT)]
            pedicles[name] = tuple(torso.vertebrae[row] for row in np.unique(aside))
            fits[name], rmse[name] = vertebra_fits(torso, views[name], corners, marked)
            poses[name] = ViewPose(shift, roll, rmse[name], yaw)
        seen = {vertebra for corners, _ in self.pictures.values() for vertebra in corners.vertebrae}
        prior_only = tuple(v for v in torso.vertebrae if v not in seen)
        carried = {
            name: tuple(m for m, s in zip(MOTIONS, share) if s > CARRIED)
            for name, share in zip(torso.vertebrae, final.prior_share)
            if (share > CARRIED).any()
        }
        rows = (UNKNOWNS * np.arange(len(torso.vertebrae))[:, None] + np.arange(6)).ravel()
        return Personalised(
            torso=torso,
            views=views,
            poses=poses,
            rmse_mm=rmse,
            fits=fits,
            prior_only=prior_only,
            carried=carried,
            covariance=final.covariance[np.ix_(rows, rows)],
            length_scale=length,
            size_scale=length * np.exp(final.shape.log_sizes),
            corner_sd_mm=final.corner_sd,
            quality=quality,
            scan=scanned,
            warnings=(*self.warnings(fits, pedicles, prior_only), *(() if scanned is None else scanned.warnings)),
        )

    def warnings(
        self,
        fits: Mapping[str, Mapping[str, VertebraFit]],
        pedicles: Mapping[str, tuple[str, ...]],
        prior_only: tuple[str, ...],
    ) -> tuple[str, ...]:
        """Lines for the user; ``pedicles``: in each view the vertebrae of which one was set aside, or both."""
        kinds = {view_kind(view) for _, view in self.pictures.values()}
        lines = []
        if "lateral" not in kinds:
            lines.append(
                "no lateral radiograph: the sagittal shape (kyphosis, lordosis, depth of the vertebrae) is the "
                "template's, not the subject's"
            )
        if prior_only:
            lines.append(f"{', '.join(prior_only)}: in no radiograph; carried by the neighbours and the template alone")
        others = "the other view and its neighbours" if len(fits) > 1 else "its neighbours"
        for name, found in fits.items():
            for vertebra, fit in found.items():
                if fit.wrong_corners:
                    one = fit.wrong_corners == 1
                    what = "a corner contradicts" if one else f"{fit.wrong_corners} of its corners contradict"
                    lines.append(
                        f"{name}: {vertebra}: {what} {others} ({fit.rmse_mm:.1f} mm off) and "
                        f"{'was' if one else 'were'} set aside; check its annotation"
                    )
            lines += [
                f"{name}: {vertebra}: a pedicle contradicts its corners and its neighbours and was set aside; check "
                "its pedicles"
                for vertebra in pedicles[name]
            ]
        return tuple(lines)
